"""What a registration is known by: its content, however its file is written."""

import hashlib
import json
import math
import struct
from copy import deepcopy
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config.load import InputError
from cutgate.config.model import Site
from cutgate.protocol.times import since_1970_us
from cutgate.runtime.kinematics.landmarks import CheckPoints
from cutgate.runtime.plan.load import load_registration, registration_from_bytes
from cutgate.runtime.plan.registration import checked

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


POINTS = [
    {"id": "condyle", "ct_mm": [1, -2.5, 0], "robot_mm": [2.5, -2.75, 2]},
    {"id": "épine", "ct_mm": [0.1, 0, 7], "robot_mm": [1, 2, 3]},
]


def of_points(said):
    """Bytes of the digest that stand behind all others, by another way."""
    content = struct.pack("<H", len(said))
    for point in said:
        name = point["id"].encode()
        numbers = (*point["ct_mm"], *point["robot_mm"])
        content += struct.pack("<H", len(name)) + name + struct.pack("<6d", *(x or 0.0 for x in numbers))
    return content


def test_check_points_are_part_of_the_digest_and_where_there_are_none_it_is_as_it_was():
    assert read(SAID | {"check_points": []}).digest == read(SAID).digest
    numbers = [float(x) for row in SAID["R_T_CT"][:3] for x in row] + [SAID["residual_rms_mm"]]
    begin = b"cutgate/registration/1" + struct.pack("<13dq", *numbers, since_1970_us(read(SAID).created))
    texts = [text.encode() for text in (SAID["id"], SAID["ct_id"])]
    whole = begin + b"".join(struct.pack("<H", len(text)) + text for text in texts) + of_points(POINTS)
    assert read(SAID | {"check_points": POINTS}).digest == hashlib.sha256(whole).digest()
    assert read(SAID | {"check_points": POINTS}).place == read(SAID).place


@pytest.mark.parametrize(
    "points",
    [
        POINTS[:1],
        POINTS[::-1],
        [POINTS[0] | {"id": "condylf"}, POINTS[1]],
        [POINTS[0] | {"ct_mm": [1, -2.5, 1e-9]}, POINTS[1]],
        [POINTS[0] | {"robot_mm": [2.5, -2.75, -2]}, POINTS[1]],
        [POINTS[0] | {"ct_mm": POINTS[0]["robot_mm"], "robot_mm": POINTS[0]["ct_mm"]}, POINTS[1]],
    ],
)
def test_other_check_points_make_another_one_of_it(points):
    assert read(SAID | {"check_points": points}).digest != read(SAID | {"check_points": POINTS}).digest


def test_the_residual_of_a_check_point_is_what_the_site_is_told():
    site = Site(check_point_tolerance_mm=1.5, check_points_min=1)
    found = checked(read(SAID | {"check_points": POINTS}), site)
    assert (found.tolerance_mm, found.least) == (1.5, 1)
    assert [one.id for one in found.points] == ["condyle", "épine"]
    assert found.points[0].residual_mm == 0.0
    assert found.points[1].residual_mm == pytest.approx(math.dist((1.6, -0.25, 9.0), (1, 2, 3)))
    assert checked(read(SAID), site) == checked(None, site) == CheckPoints((), 1.5, 1)


TURN = 0.4
RIGHT = [
    [math.cos(TURN), -math.sin(TURN), 0, 480],
    [math.sin(TURN), math.cos(TURN), 0, 30],
    [0, 0, 1, 210],
    [0, 0, 0, 1],
]
WRONG = {
    "inverted": np.linalg.inv,
    "transposed": lambda r: np.block([[r[:3, :3].T, r[:3, 3:]], [r[3:]]]),
    "LPS for RAS": lambda r: r @ np.diag([-1.0, -1.0, 1.0, 1.0]),
    "translated in metres": lambda r: np.block([[r[:3, :3], r[:3, 3:] / 1000], [r[3:]]]),
    "3 mm aside": lambda r: r + np.array([[0, 0, 0, 3], [0] * 4, [0] * 4, [0] * 4]),
}


@pytest.mark.parametrize("mistake", WRONG)
def test_check_points_find_every_mistake_that_leaves_the_file_sound(mistake):
    """Three landmarks about a knee; a registration that is right leaves them where they were touched."""
    right = np.array(RIGHT)
    landmarks = np.array([[12.0, -31.0, 40.0, 1.0], [-38.0, 5.0, 22.0, 1.0], [8.0, 44.0, -12.0, 1.0]])
    touched = landmarks @ right.T
    said = SAID | {
        "check_points": [
            {"id": f"P{k}", "ct_mm": list(ct), "robot_mm": list(at)}
            for k, (ct, at) in enumerate(zip(landmarks[:, :3], touched[:, :3], strict=True))
        ]
    }
    assert not checked(read(said | {"R_T_CT": right.tolist()}), Site()).outside
    found = checked(read(said | {"R_T_CT": WRONG[mistake](right).tolist()}), Site())
    assert found.outside


BAD_POINTS = [
    (POINTS[0], "check_points", "must be a list"),
    ([POINTS[0], POINTS[0]], "check_points.1.id is condyle", "another name than check_points.0 has"),
    ([POINTS[0] | {"id": ""}], "check_points.0.id", "at least 1 character"),
    ([POINTS[0] | {"id": "x" * 65}], "check_points.0.id", "at most 64 characters"),
    ([POINTS[0] | {"id": 7}], "check_points.0.id is 7", "write it in quotes"),
    ([POINTS[0] | {"ct_mm": [1, 2]}], "check_points.0.ct_mm.2", "add check_points.0.ct_mm.2"),
    ([POINTS[0] | {"ct_mm": [1, 2, 3, 4]}], "check_points.0.ct_mm", "at most 3 items"),
    ([POINTS[0] | {"ct_mm": [1, 2, "3"]}], "check_points.0.ct_mm.2", "write the number without quotes"),
    ([POINTS[0] | {"ct_mm": [1, 2, True]}], "check_points.0.ct_mm.2", "number"),
    ([POINTS[0] | {"robot_mm": [1, 2, 100_000.1]}], "check_points.0.robot_mm.2", "<= 100000"),
    ([POINTS[0] | {"weight": 1}], "check_points.0.weight", "known keys here (id, ct_mm, robot_mm)"),
    ([{"id": "a", "ct_mm": [1, 2, 3]}], "check_points.0.robot_mm", "missing"),
    ([{**POINTS[0], "id": f"P{k}"} for k in range(101)], "check_points", "at most 100 items"),
    (None, "check_points", "list"),
]


@pytest.mark.parametrize(("points", "key", "bound"), BAD_POINTS)
def test_check_points_that_are_none_are_refused_naming_the_point_and_the_bound(points, key, bound):
    with pytest.raises(InputError) as caught:
        read(SAID | {"check_points": points})
    assert key in str(caught.value)
    assert bound in str(caught.value)


def test_as_many_check_points_are_read_as_there_may_be():
    points = [{**POINTS[0], "id": f"P{k}"} for k in range(100)]
    assert len(read(SAID | {"check_points": points}).check_points) == 100


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
