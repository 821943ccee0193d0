"""The frames of a log: all of them from the raw frames that its close record names, else those that it holds itself."""

import json
from io import BytesIO
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.protocol.candump import RawFrame, parse
from cutgate.runtime.audit import records
from cutgate.runtime.audit.inspect import read_log
from cutgate.runtime.review.recorded_frames import (
    LINE_MAX,
    TRANSFER_FRAMES,
    SessionFrames,
    direction_of,
    lines,
)
from tests.runtime.audit.build import forge, small_log

SESSIONS = Path(__file__).parents[2] / "compat" / "0.1.0" / "sessions"
(CUT,) = SESSIONS.glob("*-eea20e88.mcap")
DATA, RAW = CUT.read_bytes(), CUT.with_suffix(".candump.log").read_bytes()


def frames_of(data, raw):
    return SessionFrames(read_log(BytesIO(data), raw), None if raw is None else BytesIO(raw))


def recorded(data=DATA):
    return read_log(data).of("/can/frame")


def test_every_raw_frame_comes_once_in_its_order():
    frames = frames_of(DATA, RAW)
    assert frames.whole
    assert "".join(frame.line for _, frame in frames.each()).encode() == RAW
    assert "SHA-256 its close record names" in frames.source


def test_single_frames_have_the_direction_of_their_record_and_transfers_that_of_their_identifier():
    found = list(frames_of(DATA, RAW).each())
    single = [way for way, frame in found if frame.can_id not in TRANSFER_FRAMES]
    assert single == [record["direction"] for record in recorded()]
    assert {(way, frame.can_id) for way, frame in found if frame.can_id in TRANSFER_FRAMES} == {
        ("sent", 0x600), ("received", 0x601), ("sent", 0x640), ("received", 0x641),
    }  # fmt: skip


def test_a_stranger_in_the_name_of_the_runtime_was_received():
    """The identifier would say that the runtime has sent it."""

    def received(record):
        if isinstance(record, records.CanFrame) and record.id == 0x080:
            return record.model_copy(update={"direction": "received"})
        return record

    frames = frames_of(forge(DATA, received), RAW)
    assert frames.whole
    assert {way for way, frame in frames.each() if frame.can_id == 0x080} == {"received"}


@pytest.mark.parametrize("raw", [None, b"", RAW[:-1], RAW + b"\n", RAW.replace(b"080#", b"081#", 1)])
def test_without_the_raw_frames_of_the_close_record_the_logs_own_are_given(raw):
    frames = frames_of(DATA, raw)
    assert not frames.whole
    found = list(frames.each())
    assert [(way, frame.can_id, frame.data.hex()) for way, frame in found] == [
        (record["direction"], record["id"], record["data"]) for record in recorded()
    ]
    assert {frame.interface for _, frame in found} == {"bus.sock"}
    assert "single frames of the log itself" in frames.source
    assert ("not beside it" in frames.source) == (raw is None)


def test_times_of_the_logs_own_frames_are_to_the_nanosecond():
    found = [frame.time_ns for _, frame in frames_of(DATA, None).each()]
    assert found == [record["stamp"]["sec"] * 10**9 + record["stamp"]["nsec"] for record in recorded()]
    assert all(before <= after for before, after in pairwise(found))


def test_a_log_that_broke_off_has_its_own_frames():
    (crashed,) = SESSIONS.glob("*-0fbca8e4.mcap")
    frames = frames_of(crashed.read_bytes(), crashed.with_suffix(".candump.log").read_bytes())
    assert not frames.whole
    assert len(list(frames.each())) > 50


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b'"id":128', b'"id":"x"'), (b'"id":128', b'"id":9999'), (b'"data":"', b'"data":"zz'),
        (b'"direction":"sent"', b'"direction":"else"'), (b'"dlc":8', b'"dlc":{}'),
            (b'{"sec":1', b'{"sec":-1'), (b'{"sec":1', b'{"sec":1000000000001'),
    ],
)  # fmt: skip
def test_records_that_are_no_frames_are_left_out_and_counted(old, new):
    class Altered:
        """The log, with what one record says altered: the chain would not let a file say so."""

        def __init__(self):
            self.log = read_log(BytesIO(DATA))
            self.left = 1

        def each(self, topic):
            for name, data in self.log.each(topic):
                changed = data.replace(old, new, 1) if self.left else data
                self.left -= changed != data
                yield name, changed

        def of(self, topic):
            return self.log.of(topic)

    frames = SessionFrames(Altered(), None)
    assert len(list(frames.each())) == len(recorded()) - 1
    assert frames.strange == 1


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ((("bus", "socketcan/vcan0"),), "vcan0"),
        ((("other", "x"),), "can0"),
        ((("bus", "a b"),), "can0"),
        ((), "can0"),
    ],
)
def test_the_bus_is_named_by_record_0(tmp_path, options, name):
    said = tuple(records.Option(name=key, value=value) for key, value in options)
    frame = records.CanFrame(
        stamp=records.Time(sec=1, nsec=2),
        direction="sent",
        id=1,
        is_extended=True,
        is_rtr=True,
        dlc=0,
        data="",
    )

    def edit(record):
        if isinstance(record, records.AuditOpen):
            return record.model_copy(update={"simulation": said})
        return frame if isinstance(record, records.AuditOperator) else record

    data = forge(small_log(tmp_path, decisions=1).log.read_bytes(), edit)
    ((way, found),) = frames_of(data, None).each()
    assert (way, found) == ("sent", RawFrame(1_000_000_002, name, 1, is_extended=True, is_remote=True))


@pytest.mark.parametrize(
    ("line", "way"),
    [
        ("080#00", "sent"),
        ("081#00", "received"),
        ("00000080#00", "received"),
        ("20000080#00", "received"),
        ("7FF#", "received"),
    ],
)
def test_the_direction_of_an_identifier(line, way):
    assert direction_of(parse(f"(1.0) can0 {line}")) == way


# ---------------------------------------------------------------- lines of a file


@given(st.lists(st.text("ab\r", max_size=700)), st.booleans(), st.none() | st.integers(0, 3000))
def test_lines_are_those_of_the_file_and_of_bounded_length(texts, ends, end):
    data = "\n".join(texts).encode() + b"\n" * ends
    expected = [line[:LINE_MAX] for line in BytesIO(data[:end])]
    assert list(lines(BytesIO(data), end)) == expected


def test_a_record_of_a_frame_is_read_as_the_model_says():
    first = json.loads(next(data for _, data in read_log(BytesIO(DATA)).each("/can/frame")))
    assert set(first) == {"stamp", "direction", "id", "is_rtr", "is_extended", "is_error", "dlc", "data"}
