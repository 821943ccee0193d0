"""Raw frames are read along line by line, and what both sides said on the control channel is put together again."""

from io import BytesIO

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.protocol import candump
from cutgate.protocol.wire import Side
from cutgate.runtime.audit.recomputed.raw_frames import LINE_BYTES_MAX, RawFrames, WholeRecord, is_logged
from cutgate.runtime.audit.records import CanFrame, Time
from tests.runtime.audit.recomputed.coded import carried

T_NS = 1_790_000_000_123_456_789


def line(can_id, data, time_ns=T_NS, **options):
    return candump.line(time_ns, "vcan0", can_id, data, **options).encode()


def read(data):
    found = []
    raw = RawFrames(BytesIO(data), found.append)
    frames = []
    while (frame := raw.next()) is not None:
        frames.append(frame)
    return raw, frames, found


@given(st.binary(min_size=1, max_size=300), st.binary(min_size=1, max_size=300), st.data())
def test_what_both_sides_said_is_put_together_however_it_was_interleaved(ours, theirs, data):
    queues = [carried(ours, Side.RUNTIME), carried(theirs, Side.CONTROLLER)]
    text = b""
    while any(queues):
        queue = data.draw(st.sampled_from([queue for queue in queues if queue]))
        text += line(*queue.pop(0))
    _, frames, found = read(text)
    assert not frames
    assert {(one.side, one.payload) for one in found} == {(Side.RUNTIME, ours), (Side.CONTROLLER, theirs)}


def test_a_whole_record_is_given_before_the_frame_behind_it_with_its_line_and_time():
    frames = carried(bytes(40), Side.RUNTIME)
    text = b"".join(line(*frame) for frame in frames) + line(0x080, bytes(8))
    found = []
    raw = RawFrames(BytesIO(b"skipped" + text), found.append)  # from the beginning, wherever the file stands
    assert raw.next() is None
    raw = RawFrames(BytesIO(text), found.append)
    assert raw.next().can_id == 0x080
    assert found == [WholeRecord(Side.RUNTIME, bytes(40), len(frames), T_NS // 1000)]
    assert raw.line == len(frames) + 1


def test_a_record_that_was_given_up_and_frames_of_other_kinds_disturb_nothing():
    half, whole = carried(bytes(90), Side.RUNTIME)[:4], carried(b"whole" * 9, Side.RUNTIME)
    others = [
        line(0x600, bytes(64), is_fd=True),
        line(0x600, b"\x05other\xcc\xcc", is_fd=True),
        line(0x600, b"", is_remote=True),
        line(0x600, b""),
        line(0x640, bytes(8)),
        line(0x641, bytes(64), is_fd=True),
    ]
    text = b"".join([*(line(*frame) for frame in half), *others, *(line(*frame) for frame in whole)])
    _, frames, found = read(text)
    assert not frames
    assert [one.payload for one in found] == [b"whole" * 9]


def test_everything_but_frames_of_transfers_is_a_frame_of_the_log():
    text = (
        line(0x080, bytes(8)) + line(0x600, bytes(8), is_extended=True) + line(0x600, b"\x01", is_error=True)
    )
    _, frames, _ = read(text)
    assert [frame.can_id for frame in frames] == [0x080, 0x600, 0x600]


@pytest.mark.parametrize("text", [b"what\n", line(0x080, bytes(7))[:-2] + b"\n", b"\n", b"x" * 10_000])
@pytest.mark.parametrize("behind", [line(0x080, bytes(8)), b""])
def test_nothing_is_read_behind_what_is_no_frame(text, behind):
    text = text if behind else text.removesuffix(b"\n") or b"("
    raw, frames, _ = read(line(0x080, bytes(8)) + text + behind)
    assert len(frames) == 1
    assert raw.broken.startswith("line 2 of the raw frames: ")
    assert raw.next() is None


def test_no_more_than_a_line_is_read_at_a_time():
    class Watched(BytesIO):
        def readline(self, size=-1):
            assert 0 < size <= LINE_BYTES_MAX
            return super().readline(size)

    raw = RawFrames(Watched(line(0x080, bytes(8)) * 3), lambda _: None)
    assert [raw.next() is not None for _ in range(4)] == [True, True, True, False]


RECORD = CanFrame(stamp=Time.of(T_NS), direction="sent", id=0x080, dlc=8, data=bytes(range(8)).hex())


@pytest.mark.parametrize(
    "changes",
    [
        {"stamp": Time.of(T_NS + 1000)}, {"id": 0x081}, {"data": bytes(8).hex()}, {"is_rtr": True},
        {"is_extended": True}, {"is_error": True},
    ],
    ids=str,
)  # fmt: skip
def test_a_record_is_of_a_frame_if_time_identifier_kind_and_data_agree(changes):
    frame = candump.parse(line(0x080, bytes(range(8))).decode())
    assert is_logged(frame, RECORD)
    assert is_logged(frame, RECORD.model_copy(update={"direction": "received", "stamp": Time.of(T_NS - 700)}))
    assert not is_logged(frame, RECORD.model_copy(update=changes))


@pytest.mark.parametrize("extended", [True, False])
def test_of_an_error_its_class_counts(extended):
    frame = candump.parse(line(0x080, bytes(8), is_error=True).decode())
    changes = {"is_error": True, "is_extended": extended, "data": bytes(8).hex()}
    for can_id in (0x080, 0x2000_0080):
        assert is_logged(frame, RECORD.model_copy(update=changes | {"id": can_id}))
