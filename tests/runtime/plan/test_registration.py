"""What a registration is known by: its content, however its file is written."""

import hashlib
import json
import struct
from copy import deepcopy
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config.load import InputError
from cutgate.runtime.plan.load import load_registration, registration_from_bytes

BEGINNING = datetime(1970, 1, 1, tzinfo=UTC)
SAID = {
    "schema": "cutgate.registration/1",
    "id": "knee 7",
    "R_T_CT": [[1, 0, 0, 1.5], [0, 1, 0, -0.25], [0, 0, 1, 2], [0, 0, 0, 1]],
    "residual_rms_mm": 0.31,
    "created_utc": "2026-11-28T10:20:30.000123Z",
    "ct_id": "CT-µ",
}


def read(said, **layout):
    return registration_from_bytes(Path("r.json"), json.dumps(said, **layout).encode())


def by_hand(said):
    """The same digest from the document, by another way: struct instead of arrays."""
    numbers = [float(x) for row in said["R_T_CT"][:3] for x in row] + [float(said["residual_rms_mm"])]
    moment = datetime.strptime(said["created_utc"], "%Y-%m-%dT%H:%M:%S.%fZ").replace(tzinfo=UTC)
    seconds = int(moment.replace(microsecond=0).timestamp())
    content = b"cutgate/registration/1" + struct.pack(
        "<13dq", *(x or 0.0 for x in numbers), seconds * 10**6 + moment.microsecond
    )
    for text in (said["id"], said.get("ct_id", "")):
        data = text.encode("utf-8")
        content += struct.pack("<H", len(data)) + data
    return hashlib.sha256(content).digest()


def test_the_digest_is_the_same_by_another_way():
    assert read(SAID).digest == by_hand(SAID)
    unlinked = {name: value for name, value in SAID.items() if name != "ct_id"}
    assert read(unlinked).digest == by_hand(unlinked)
    assert read(SAID).digest.hex() == ("7328d9b02ad3263279aaa37bef7c44522d8706aaae7a5e3821fa6cce7daa9ef0")


@given(
    texts=st.tuples(*[st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=200)] * 2),
    at=st.integers(-(10**15), 10**16).map(lambda us: BEGINNING + timedelta(microseconds=us)),
    residual=st.floats(0, 100),
    offset=st.floats(-1000, 1000),
)
def test_it_is_so_for_every_text_time_and_number(texts, at, residual, offset):
    said = deepcopy(SAID) | {"id": texts[0], "ct_id": texts[1], "residual_rms_mm": residual}
    said["created_utc"] = at.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    said["R_T_CT"][1][3] = offset
    assert read(said).digest == by_hand(said)


@pytest.mark.parametrize(
    "changes",
    [
        {"created_utc": "2026-11-28T10:20:30.000123+00:00"},
        {"R_T_CT": [[1.0, -0.0, 0, 15e-1], [0, 1, -0.0, -2.5e-1], [0, -0.0, 1, 2.00], [0, 0, 0, 1]]},
        {"ct_id": "CT-\u00b5"},
    ],
)
@pytest.mark.parametrize("layout", [{}, {"indent": 4}, {"ensure_ascii": False}, {"sort_keys": True}])
def test_however_it_is_written_it_is_the_same(changes, layout):
    assert read(SAID | changes, **layout).digest == read(SAID).digest


@pytest.mark.parametrize(
    "changes",
    [
        {"id": "knee 8"},
        {"id": "knee 7C", "ct_id": "T-µ"},
        {"ct_id": "CT"},
        {"residual_rms_mm": 0.32},
        {"created_utc": "2026-11-28T10:20:30.000124Z"},
        {"created_utc": "2026-11-28T10:20:31.000123Z"},
        {"R_T_CT": [[1, 0, 0, 1.5000000000000002], *SAID["R_T_CT"][1:]]},
    ],
)
def test_whatever_else_it_says_is_another_one(changes):
    assert read(SAID | changes).digest != read(SAID).digest


def test_a_residual_of_minus_nothing_is_none():
    assert read(SAID | {"residual_rms_mm": -0.0}).digest == read(SAID | {"residual_rms_mm": 0}).digest


@pytest.mark.parametrize("fraction", [".1234567", ",0000000"])
def test_a_time_finer_than_is_told_apart_is_refused(tmp_path, fraction):
    """In a file; a log of 0.1.0 may hold one."""
    said = SAID | {"created_utc": f"2026-11-28T10:20:30{fraction}Z"}
    file = tmp_path / "r.json"
    file.write_text(json.dumps(said))
    with pytest.raises(InputError) as caught:
        load_registration(file)
    assert str(caught.value) == (
        f"{file}: created_utc is {said['created_utc']}, must be at most six digits behind the second; "
        "leave the other digits out"
    )
    assert read(said)


def test_a_time_to_the_microsecond_is_read(tmp_path):
    file = tmp_path / "r.json"
    file.write_text(json.dumps(SAID))
    assert load_registration(file).value.created.microsecond == 123


@pytest.mark.parametrize("name", ["id", "ct_id"])
def test_half_a_surrogate_pair_is_refused(name):
    with pytest.raises(InputError, match="must be a valid string"):
        read(SAID | {name: "knee \ud800"})
