"""The fields of what crosses the bus in words: every count has a unit, and every value is one that JSON has."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.protocol.frames import (
    FRAMES,
    ControllerHeartbeat,
    Joints01,
    Joints23,
    Progress,
    decode_frame,
    encode_frame,
)
from cutgate.protocol.records import RECORDS, Limits, Tool, Withdraw
from cutgate.protocol.states import ControllerState, StopCause
from cutgate.protocol.wire import Nested, layout
from cutgate.runtime.review.wording import (
    COUNTS,
    JOINT_COUNTS,
    Field,
    fields_of_frame,
    fields_of_record,
    moment,
)
from tests.protocol.strategies import blocks, path_blocks, records


def names_of(kind):
    """The fields of a record and of what is nested in it."""
    for name, codec in layout(kind):
        yield from names_of(codec.kind) if isinstance(codec, Nested) else [name]


@pytest.mark.parametrize("kind", RECORDS.values(), ids=lambda kind: kind.__name__)
def test_every_count_of_a_record_has_a_unit(kind):
    counts = {name for name in names_of(kind) if name.endswith("_u")}
    assert counts <= COUNTS.keys() | JOINT_COUNTS.keys()


def test_no_unit_is_of_a_field_that_is_none():
    fields = {name for kind in RECORDS.values() for name in names_of(kind)}
    assert COUNTS.keys() | JOINT_COUNTS.keys() <= fields


@given(records() | path_blocks() | blocks(Limits))
def test_every_record_is_told_field_by_field(record):
    found = list(fields_of_record(record))
    json.dumps({field.key: field.value for field in found}, allow_nan=False)
    assert len({field.key for field in found}) == len(found)
    told = {field.name.split(".")[0].removesuffix("_u") for field in found}
    assert told == {name.removesuffix("_u") for name, _ in layout(type(record))}
    for field in found:
        assert str(field).startswith(field.name)


def test_counts_are_told_in_their_unit():
    found = {field.name: (field.value, field.unit) for field in fields_of_record(Tool(160_500_000))}
    assert found == {"length": (160.5, "mm")}
    limits = Limits(
        (-80_000_000, 0, 50_000_000, 0, 0),
        (1, 2, 3, 4, 5),
        (57_295_779, 1, 200_000_000, 1, 1),
        (1, 1, 7_000_000, 1, 1),
    )
    texts = list(map(str, fields_of_record(limits)))
    for text in (
        "q_min.q0 -80 deg",
        "q_min.q2 50 mm",
        "speed.q0 57.295779 deg/s",
        "speed.q2 200 mm/s",
        "acceleration.q2 7 mm/s2",
    ):
        assert text in texts


@given(st.integers(-(2**63), 2**63 - 1))
def test_a_time_is_a_date_or_a_count(time_us):
    told = moment(time_us)
    assert told.endswith("Z") == (0 <= time_us < 1 << 57)


def test_times_of_records_are_dates():
    told = {field.name: field.value for field in fields_of_record(Withdraw(bytes(32), 1_790_000_000_123_456))}
    assert told["barrier_us"] == "2026-09-21T14:13:20.123456Z"
    assert {field.name: field.value for field in fields_of_record(Withdraw(bytes(32), 0))}[
        "barrier_us"
    ] == "none"


@st.composite
def signals(draw):
    """Any single frame, by its signals."""
    can_id = draw(st.sampled_from(sorted(FRAMES)))
    data = draw(st.binary(min_size=8, max_size=8))
    try:
        frame = decode_frame(can_id, data)
    except ValueError:
        return None
    return frame, data


@given(signals())
def test_every_signal_of_a_frame_is_told_but_what_protects_it(found):
    if found is None:
        return
    frame, data = found
    fields = fields_of_frame(frame, data)
    assert {field.name for field in fields} == set(vars(frame))
    json.dumps({field.key: field.value for field in fields}, allow_nan=False)


@pytest.mark.parametrize(
    ("frame", "texts"),
    [
        (Joints01(14_500, -1), ["q0 72.5 deg", "q1 -0.005 deg"]),
        (Joints23(25_001, 0), ["q2 250.01 mm", "q3 0 deg"]),
        (Progress(7, 32768), ["segment 7", "fraction 0.500008"]),
        (
            ControllerHeartbeat(ControllerState.CUTTING, 3, StopCause.NONE, True, False, True, echo=4, tag=0xAB),
            ["tag 0xab", "echo 4", "state CUTTING", "epoch 3", "cause NONE", "device_pressed PRESSED", "emergency_stop_ok PRESSED", "cutting_mode ON"],
        ),
    ],
    ids=lambda value: type(value).__name__,
)  # fmt: skip
def test_signals_are_words_and_units(frame, texts):
    _, data = encode_frame(frame, 5, 6)
    assert sorted(map(str, fields_of_frame(frame, data))) == sorted(texts)


@pytest.mark.parametrize(
    ("field", "text", "key"),
    [
        (Field("x", 1.25, "mm/s"), "x 1.25 mm/s", "x_mm_s"), (Field("x", "", ""), 'x ""', "x"), (Field("x", 0), "x 0", "x"),
        (Field("x", "ab" * 64), f"x {'ab' * 64}", "x"), (Field("x", "ab" * 65), "x 65 bytes", "x"),
    ],
)  # fmt: skip
def test_a_field_is_told_in_few_words(field, text, key):
    assert (str(field), field.key) == (text, key)
