"""What was said is found again in the frames it was said in, whatever was lost of the rest; nothing else is claimed."""

import json
from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cutgate.protocol.candump import RawFrame
from cutgate.protocol.frames import (
    FRAMES,
    IDS,
    TRANSFER_IDS,
    ControllerHeartbeat,
    Joints01,
    Progress,
    RuntimeHeartbeat,
    RuntimeStop,
    encode_frame,
)
from cutgate.protocol.records import (
    RECORDS,
    Collect,
    Limits,
    NonceRequest,
    Open,
    Path,
    PathBlock,
    Reply,
    Tool,
    pack,
    session_digest,
    session_tag,
    split,
)
from cutgate.protocol.states import ControllerState, Purpose, Refusal, RuntimeCode, StopCause, StopCode
from cutgate.protocol.transfer import Transfer
from cutgate.runtime.review.decoding import NAMES, Decoding, transfer_of
from cutgate.runtime.review.told import json_line, text_line
from cutgate.runtime.review.wording import fields_of_record
from tests.protocol.sessions import OPEN
from tests.protocol.strategies import records
from tests.protocol.test_candump import frames as any_frames

TAG = session_tag(session_digest(OPEN))
MS = 1_000_000


def segments(record, session=TAG, sequence=1, *, fd=False):
    """The frames of one record, without the other side's flow controls."""
    channel = type(record).CHANNEL
    ours, theirs = (TRANSFER_IDS[side][channel] for side in (type(record).SENDER, type(record).SENDER.peer))
    sender, receiver = Transfer(ours, theirs, fd=fd), Transfer(theirs, ours, fd=fd)
    sender.send(pack(record, session, sequence), now_s=0.0)
    found = []
    while sender.sending:
        for can_id, data in sender.outgoing():
            found.append((can_id, data, fd))
            receiver.feed(data)
        for _, data in receiver.outgoing():
            sender.feed(data)
    return found


def said(parts, interface="can0"):
    return [
        RawFrame(number * MS, interface, can_id, data, is_fd=fd)
        for number, (can_id, data, fd) in enumerate(parts)
    ]


def single(frame, counter, tag=TAG):
    return (*encode_frame(frame, counter % 256, tag), False)


def heard(frames, direction=None):
    decoding = Decoding()
    found = [one for frame in frames for one in decoding.take(frame, direction)]
    return found + list(decoding.end()), decoding.counts


def names(found):
    return [one.name for one in found]


def notes(found):
    return [note for one in found for note in one.notes]


BEAT = RuntimeHeartbeat(RuntimeCode.INHIBIT, epoch=0)
ANSWER = ControllerHeartbeat(ControllerState.OPEN, 0, StopCause.NONE, False, True, False)
OPENING = segments(OPEN, session=0)


# ---------------------------------------------------------------- all of it is found


def in_its_place(record):
    kind = type(record)
    return TAG if kind.INSIDE_SESSION else 0


sent = records([kind for kind in RECORDS.values() if kind is not PathBlock])


@settings(max_examples=25)
@given(st.lists(sent, min_size=1, max_size=6), st.data(), st.booleans())
def test_records_are_put_together_however_their_segments_are_mixed(given_records, data, fd):
    numbers = Counter()
    queues = {}
    for record in given_records:
        can_id = TRANSFER_IDS[type(record).SENDER][type(record).CHANNEL]
        numbers[can_id, in_its_place(record)] += 1
        parts = segments(record, in_its_place(record), numbers[can_id, in_its_place(record)], fd=fd)
        queues.setdefault(can_id, []).extend(parts)
    mixed = []
    while any(queues.values()):
        can_id = data.draw(st.sampled_from(sorted(can_id for can_id, queue in queues.items() if queue)))
        mixed.append(queues[can_id].pop(0))
    found, counts = heard(said(mixed))
    assert sorted(names(found)) == sorted(type(record).__name__ for record in given_records)
    by_name = {}
    for record in given_records:
        by_name.setdefault(type(record).__name__, []).append(list(fields_of_record(record)))
    for one in found:
        expected = by_name[one.name].pop(0)
        assert [field for field in one.fields if field.name != "request"] == expected
    assert not [note for note in notes(found) if "again" not in note and "comes after" not in note]
    assert counts["segments"] == len(mixed)


def test_a_record_has_the_time_of_its_last_segment_and_tells_how_many_there_were():
    parts = segments(Limits((0,) * 5, (1,) * 5, (1,) * 5))
    (_, one), _ = heard(said([single(BEAT, 0, 0), *parts]))
    assert (one.time_ns, one.began_ns, one.segments) == (len(parts) * MS, MS, len(parts))
    assert (one.sender, one.can_id, one.numbers) == ("controller", 0x641, (TAG, 1))


def test_single_frames_are_named_with_their_sender_and_fields():
    found, counts = heard(said([*OPENING, single(BEAT, 0), single(ANSWER, 0), single(Progress(3, 4), 0)]))
    assert [(one.name, one.sender) for one in found[1:]] == [
        ("RuntimeHeartbeat", "runtime"), ("ControllerHeartbeat", "controller"), ("Progress", "controller")
    ]  # fmt: skip
    assert notes(found) == []
    assert counts["unchecked"] == 0
    assert "state OPEN" in map(str, found[2].fields)


def test_the_poses_of_a_block_are_told_and_looked_at():
    path = Path.quantised(
        [(float(x), 0, 0) for x in range(300)],
        [(0, 0, 1)] * 300,
        feed_mm_s=10,
        tool_length_mm=160,
        elbow="right",
    )
    blocks = split(path.body())
    parts = [part for number, block in enumerate(blocks, 1) for part in segments(block, sequence=number)]
    found, _ = heard(said(parts))
    assert [str(one.fields[-1]) for one in found] == ["poses 0..197", "poses 198..299"]
    assert notes(found) == []
    wrong = PathBlock(**(vars(blocks[0]) | {"block_crc32": 1}))
    assert "CRC-32 does not match" in notes(heard(said(segments(wrong)))[0])[0]


def test_a_reply_names_the_request():
    (one,) = heard(said(segments(Reply(Open.TYPE, 1, Refusal.ACCEPTED, StopCause.NONE, 0))))[0]
    assert "request Open" in map(str, one.fields)


# ---------------------------------------------------------------- what is wrong is told in its place


@given(st.integers(1, 40), st.integers(0, 255))
def test_single_frames_that_were_lost_are_counted(missing, first):
    found, _ = heard(
        said(
            [
                *OPENING,
                single(BEAT, first),
                single(BEAT, first + 1 + missing),
                single(BEAT, first + 2 + missing),
            ]
        )
    )
    told = notes(found)
    assert len(told) == 1
    if missing < 3:
        assert told == [f"{missing} lost before it"]
    else:
        assert told == [f"out of sequence: counter {(first + 1 + missing) % 256} comes after {first}"]
    assert found[2].notes


def test_a_frame_that_comes_twice_and_another_under_its_counter():
    found, _ = heard(
        said(
            [
                *OPENING,
                single(BEAT, 5),
                single(BEAT, 5),
                single(RuntimeHeartbeat(RuntimeCode.READY, epoch=0), 5),
            ]
        )
    )
    assert notes(found) == ["repeated", "another frame under the same counter 5"]


@given(st.integers(0, 63))
def test_a_damaged_frame_is_named_and_its_damage_told(bit):
    can_id, data, _ = single(ANSWER, 7)
    wrong = bytearray(data)
    wrong[bit // 8] ^= 1 << bit % 8
    found, _ = heard(said([*OPENING, (can_id, bytes(wrong), False)]))
    assert found[-1].name == "ControllerHeartbeat"
    assert any("CRC WRONG" in note for note in found[-1].notes)


def test_without_a_session_that_opened_crcs_are_not_judged_and_counted():
    found, counts = heard(said([single(BEAT, 0), single(BEAT, 1), single(BEAT, 4)]))
    assert notes(found) == ["2 lost before it"]
    assert counts["unchecked"] == 3
    _, counts = heard(said([single(RuntimeStop(StopCode.STOP, StopCause.NONE), 0, 0)]))
    assert counts["unchecked"] == 0


def test_any_record_of_a_session_tells_its_tag():
    found, counts = heard(said([*segments(Collect()), single(BEAT, 0)]))
    assert (notes(found), counts["unchecked"]) == ([], 0)


def test_counters_begin_anew_with_a_session():
    other = Open(**(vars(OPEN) | {"runtime_nonce": b"another".ljust(16)}))
    tag = session_tag(session_digest(other))
    parts = [*OPENING, single(BEAT, 9), *segments(other, 0, 2), single(BEAT, 0, tag), single(BEAT, 1, tag)]
    assert notes(heard(said(parts))[0]) == []


@given(st.data())
def test_a_record_of_which_a_segment_is_lost_is_not_told_and_the_next_one_is(data):
    first, second = segments(OPEN, 0, 1), segments(Collect(), TAG, 2)
    place = data.draw(st.integers(0, len(first) - 1))
    found, counts = heard(said(first[:place] + first[place + 1 :] + second))
    assert [name for name in names(found) if name] == ["Collect"]
    lost = [one for one in found if not one.name]
    assert len(lost) == 1
    assert "Open" in lost[0].may_be
    assert counts["records"] == 1


def test_segments_without_a_beginning_are_told_once_and_counted():
    first = segments(OPEN, 0, 1)
    found, counts = heard(said(first[5:]))
    assert len(found) == 1
    assert found[0].notes[0].startswith("segment ignored")
    assert counts["stray segments"] == len(first) - 6


def test_a_record_that_is_interrupted_by_another_is_told():
    found, _ = heard(said([*OPENING[:3], *segments(OPEN, 0, 2)]))
    assert names(found) == ["", "Open"]
    assert notes(found) == ["record lost: another one begins after 3 of its segments"]


def test_what_is_left_half_said_at_the_end_is_told():
    found, _ = heard(said(OPENING[:4]))
    assert notes(found) == ["the frames end in the middle of a record, after 4 of its segments"]
    assert found[0].time_ns == 3 * MS
    assert "Open" in found[0].may_be


def test_a_record_that_is_none_is_unknown_with_its_bytes():
    sender = Transfer(0x600, 0x601)
    sender.send(b"\x00\x01", now_s=0.0)
    (one,) = heard(said([(can_id, data, False) for can_id, data in sender.outgoing()]))[0]
    assert (one.name, one.fields[0].value) == ("unknown", "0001")
    assert one.notes == ("record is 2 bytes, must be 16..4095",)


def test_a_record_on_the_wrong_channel_or_of_the_wrong_side_is_told():
    parts = [(0x601, data, fd) for _, data, fd in segments(Collect())]
    assert "never sent by the controller" in notes(heard(said(parts))[0])[0]
    parts = [(0x640, data, fd) for _, data, fd in segments(Collect())]
    assert "does not belong on the bulk channel" in notes(heard(said(parts))[0])[0]


@pytest.mark.parametrize(
    ("numbers", "told"),
    [
        ((1, 2, 3), []), ((1, 3), ["1 record lost before it: 3 comes after 1"]), ((1, 4), ["2 records lost before it: 4 comes after 1"]),
        ((2, 2), ["record 2 again"]), ((3, 1), ["out of sequence: record 1 comes after 3"]),
    ],
)  # fmt: skip
def test_records_that_are_missing_are_told(numbers, told):
    parts = [part for number in numbers for part in segments(NonceRequest(Purpose.START), sequence=number)]
    assert notes(heard(said(parts))[0]) == told


def test_a_flow_control_is_counted_and_told_where_it_does_not_say_continue():
    frames = said(
        [
            (0x601, bytes.fromhex(data), False)
            for data in ("302000cccccccccc", "31cccccccccccccc", "32cccccccccccccc")
        ]
    )
    found, counts = heard(frames)
    assert notes(found) == ["flow control: wait", "flow control: too long for me"]
    assert counts["flow controls"] == 3


def test_buses_are_kept_apart():
    first, second = said(segments(Tool(1)), "can0"), said(segments(Tool(2)), "can1")
    mixed = [frame for pair in zip(first, second, strict=True) for frame in pair]
    found, _ = heard(mixed)
    assert [(one.interface, one.name) for one in found] == [("can0", "Tool"), ("can1", "Tool")]
    assert notes(found) == []


def test_who_speaks_in_the_name_of_a_side_is_told_where_the_direction_is_known():
    frame = said([*OPENING, single(BEAT, 0)])[-1:]
    assert "in the name of the runtime" in notes(heard(frame, "received")[0])[0]
    assert notes(heard(frame, "sent")[0]) == []
    answer = said([single(ANSWER, 0)])
    assert "in the name of the controller" in notes(heard(answer, "sent")[0])[0]


@pytest.mark.parametrize(
    ("frame", "name", "told"),
    [
        (RawFrame(0, "x", 0x123, b"\1"), "unknown", "data 01"),
        (RawFrame(0, "x", 0x080, bytes(8), is_extended=True), "unknown", "kind extended"),
        (RawFrame(0, "x", 0x080, bytes(8), is_fd=True), "unknown", "kind FD"),
        (RawFrame(0, "x", 0x080, is_remote=True, remote_length=8), "unknown", "remote 8"),
        (RawFrame(0, "x", 4, bytes(8), is_error=True), "bus error", "class 0x4"),
    ],
)
def test_what_is_not_ours_is_unknown(frame, name, told):
    (one,), _ = heard([frame])
    assert (one.name, one.sender) == (name, "unknown")
    assert told in map(str, one.fields)


def test_a_frame_of_ours_of_another_length_is_named():
    (one,), _ = heard([RawFrame(0, "x", IDS[Joints01], b"\1\2")])
    assert (one.name, one.notes) == ("Joints01", ("Joints01 is 2 bytes, must be 8",))


# ---------------------------------------------------------------- whatever comes


@settings(max_examples=60)
@given(st.lists(any_frames() | st.builds(
    RawFrame, st.just(0), st.just("x"), st.sampled_from(sorted({*FRAMES, 0x600, 0x601, 0x640, 0x641})), st.binary(max_size=8)
), max_size=30))  # fmt: skip
def test_any_frames_are_told_on_a_line_each(frames):
    found, counts = heard(frames)
    assert counts["frames"] == len(frames)
    for one in found:
        assert text_line(one, 0, interfaces=True).count("\n") == 1
        document = json.loads(json_line(one, 0))
        assert document["message"] in {*NAMES, "unknown", "bus error", None}
    single_ones = [one for one in found if not one.segments and one.name]
    assert len(single_ones) == sum(
        frame.is_error
        or frame.is_extended
        or frame.is_remote
        or frame.can_id not in (0x600, 0x601, 0x640, 0x641)
        for frame in frames
    )


def test_a_transfer_of_the_log_itself_is_told_by_name():
    one = transfer_of(
        {"direction": "sent", "channel": "control", "record": "Permit", "length": 9, "sha256": "ab"}, 5, "x"
    )
    assert (one.name, one.sender, one.can_id, one.may_be) == ("Permit", "runtime", 0x600, {"Permit"})
    assert list(map(str, one.fields)) == ["length 9", "sha256 ab"]
    assert transfer_of({}, 5, "x").sender == "controller"


def test_the_names_are_those_of_all_messages():
    assert {"Permit", "ControllerHeartbeat", "PathBlock", "OtherVersion"} <= NAMES
    assert len(NAMES) == len(FRAMES) + len(RECORDS) + 1
