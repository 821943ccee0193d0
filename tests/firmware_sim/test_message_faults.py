"""What becomes of frames on their way: nothing but what the line says, as often as it says, and again the same."""

from collections import Counter

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.firmware_sim import message_faults
from cutgate.firmware_sim.fault_language import MESSAGES, parse_fault
from cutgate.firmware_sim.message_faults import MessageFaults
from cutgate.protocol.frames import IDS, ControllerHeartbeat, Joints01, RuntimeHeartbeat
from cutgate.protocol.states import ControllerState
from cutgate.protocol.wire import Side

BEAT, ASKED, JOINTS = IDS[ControllerHeartbeat], IDS[RuntimeHeartbeat], IDS[Joints01]
CUTTING, OPEN = ControllerState.CUTTING, ControllerState.OPEN
CYCLE_S = 0.01


def message(number, can_id=BEAT, length=8, **how):
    data = number.to_bytes(4, "big").ljust(length, b"\xff")[:length] if length else b""
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False, **how)


def content(one):
    return one.arbitration_id, bytes(one.data)


def played(lines, sent, *, state=CUTTING, sender=Side.CONTROLLER):
    """What arrives of these, one sent each 10 ms, and how often each fault has happened."""
    faults = MessageFaults(map(parse_fault, lines))
    arrived, now_s = [], 0.0
    for one in sent:
        arrived += faults.late(sender, now_s)
        arrived += faults.passing(one, sender, state, now_s)
        now_s += CYCLE_S
    while faults.next_due_s < float("inf"):
        now_s = faults.next_due_s
        arrived += faults.late(sender, now_s)
    return arrived, list(faults.done.values())


def numbers(arrived):
    return [int.from_bytes(one.data[:4], "big") for one in arrived]


def test_one_is_lost_and_no_other():
    arrived, done = played(["lose ControllerHeartbeat"], map(message, range(5)))
    assert (numbers(arrived), done) == ([1, 2, 3, 4], [1])


def test_as_many_are_lost_as_are_said():
    arrived, done = played(["lose ControllerHeartbeat x3"], map(message, range(5)))
    assert (numbers(arrived), done) == ([3, 4], [3])


def test_nothing_happens_to_another_message_in_another_state_or_to_a_frame_that_is_not_ours():
    others = [
        message(1, JOINTS),
        message(2, 0x123),
        can.Message(arbitration_id=BEAT, is_extended_id=True, data=b"12345678"),
        can.Message(arbitration_id=BEAT, is_extended_id=False, is_remote_frame=True, dlc=8),
        can.Message(arbitration_id=BEAT, is_error_frame=True, is_extended_id=False),
    ]
    assert played(["lose ControllerHeartbeat p=1"], others) == (others, [0])
    beats = [message(1)]
    assert played(["lose ControllerHeartbeat @cutting p=1"], beats, state=OPEN) == (beats, [0])
    assert played(["lose ControllerHeartbeat @cutting p=1"], beats, state=CUTTING) == ([], [1])


def test_what_is_delayed_is_overtaken():
    arrived, _ = played(["delay ControllerHeartbeat by 25ms"], map(message, range(5)))
    assert numbers(arrived) == [1, 2, 0, 3, 4]


def test_a_delay_is_drawn_between_its_bounds():
    faults = MessageFaults([parse_fault("delay any by 5..50ms p=1")])
    dues = set()
    for number in range(200):
        assert faults.passing(message(number), Side.RUNTIME, CUTTING, 0.0) == []
        dues.add(faults.next_due_s)
    while faults.next_due_s < float("inf"):
        dues.add(faults.next_due_s)
        assert faults.late(Side.CONTROLLER, 1.0) == []
        assert len(faults.late(Side.RUNTIME, faults.next_due_s)) == 1
    assert min(dues) >= 0.005
    assert max(dues) <= 0.050
    assert max(dues) - min(dues) > 0.03


@pytest.mark.parametrize(
    ("line", "order"),
    [
        ("repeat any", [0, 0, 1, 2]),
        ("repeat any by 15ms", [0, 1, 0, 2]),
        ("replay any", [0, 1, 0, 2]),
        ("replay any by 500ms", [0, 1, 2, 0]),
        ("reorder any", [1, 0, 2]),
        ("reorder any x2", [1, 0, 2]),
    ],
)
def test_in_this_order_they_arrive(line, order):
    assert numbers(played([line], map(message, range(3)))[0]) == order


def test_a_pair_is_swapped_each_time():
    assert numbers(played(["reorder any p=1"], map(message, range(6)))[0]) == [1, 0, 3, 2, 5, 4]


def test_what_waits_for_a_next_one_that_never_comes_arrives_at_last():
    assert numbers(played(["reorder any"], [message(7)])[0]) == [7]


def test_one_is_replayed_only_by_its_own_sender():
    faults = MessageFaults([parse_fault("replay any p=1")])
    theirs, ours = message(1), message(2)
    assert faults.passing(theirs, Side.CONTROLLER, CUTTING, 0.0) == [theirs]
    assert faults.passing(ours, Side.RUNTIME, CUTTING, 0.0) == [ours]
    assert faults.passing(ours, Side.RUNTIME, CUTTING, 0.0) == [ours, ours]


@given(st.integers(1, 8), st.integers(0, 2**32 - 1))
def test_what_is_corrupted_differs_in_one_to_three_bits(length, seed):
    before = message(0x5A5A5A5A, length=length)
    (after,), done = played([f"corrupt any seed={seed}"], [before])
    changed = int.from_bytes(before.data, "big") ^ int.from_bytes(after.data, "big")
    assert 1 <= changed.bit_count() <= 3
    assert (len(after.data), after.arbitration_id, done) == (length, BEAT, [1])


@given(st.sampled_from([*range(1, 9), 12, 20, 64]), st.integers(0, 99))
def test_what_is_shortened_has_a_length_that_a_frame_can_have(length, seed):
    before = message(1, length=length, is_fd=length > 8)
    (after,), _ = played([f"shorten any seed={seed}"], [before])
    assert len(after.data) < length
    assert bytes(before.data).startswith(bytes(after.data))
    assert after.is_fd == before.is_fd
    after._check()


@pytest.mark.parametrize("action", ["corrupt", "shorten"])
def test_of_an_empty_frame_nothing_can_be_changed(action):
    empty = message(0, length=0)
    assert played([f"{action} any"], [empty]) == ([empty], [0])


def test_what_is_misaddressed_goes_elsewhere():
    ids = {one.arbitration_id for one in played(["misaddress any p=1"], map(message, range(300)))[0]}
    assert ids == {*MESSAGES["any"], 0x123} - {BEAT}


@given(
    st.sampled_from(["corrupt any p=0.5", "lose any p=0.3", "delay any by 0..90ms p=0.5"]), st.integers(0, 99)
)
def test_a_line_does_the_same_whatever_stands_beside_it(line, seed):
    sent = [message(number, can_id) for number in range(40) for can_id in (BEAT, JOINTS)]
    alone = played([f"{line} seed={seed}"], sent)
    beside = played([f"lose RuntimeHeartbeat p=0.5 seed={seed}", f"{line} seed={seed}"], sent)
    assert [content(one) for one in beside[0]] == [content(one) for one in alone[0]]


def test_of_many_as_many_happen_as_are_likely():
    _, (done,) = played(["lose any p=0.1 seed=11"], map(message, range(2000)))
    assert 150 < done < 250


@given(
    st.lists(
        st.sampled_from(
            ["delay any by 0..70ms p=0.4 seed=1", "reorder any p=0.5 seed=2", "reorder Joints01 p=1"]
        ),
        unique=True,
    ),
    st.lists(st.sampled_from([BEAT, JOINTS, 0x123]), max_size=30),
)
def test_what_is_only_late_arrives_once_each(lines, ids):
    sent = [message(number, can_id) for number, can_id in enumerate(ids)]
    arrived, _ = played(lines, sent)
    assert Counter(map(content, arrived)) == Counter(map(content, sent))


@given(st.integers(0, 6), st.integers(1, 4))
def test_what_is_repeated_arrives_twice_and_the_rest_once(frames, times):
    arrived, (done,) = played([f"repeat any x{times}"], map(message, range(frames)))
    assert done == min(frames, times)
    assert Counter(numbers(arrived)) == {number: 2 if number < done else 1 for number in range(frames)}


def test_to_a_frame_one_thing_happens_and_each_time_is_told():
    told = []
    faults = MessageFaults(
        map(parse_fault, ("lose ControllerHeartbeat", "repeat any x2")), lambda *one: told.append(one)
    )
    sent = list(map(message, range(4)))
    arrived = [faults.passing(one, Side.CONTROLLER, CUTTING, 0.0) for one in sent]
    assert [numbers(ones) for ones in arrived] == [[], [1, 1], [2, 2], [3]]
    assert [(str(fault), times, one) for fault, times, one in told] == [
        ("lose ControllerHeartbeat", 1, sent[0]),
        ("repeat any x2", 1, sent[1]),
        ("repeat any x2", 2, sent[2]),
    ]


def test_of_too_many_that_are_late_the_newest_are_lost_and_counted(monkeypatch):
    monkeypatch.setattr(message_faults, "LATE_MAX", 3)
    faults = MessageFaults([parse_fault("delay any by 10ms p=1")])
    for number in range(5):
        faults.passing(message(number), Side.CONTROLLER, CUTTING, 0.0)
    assert (numbers(faults.late(Side.CONTROLLER, 1.0)), faults.overflowed) == ([0, 1, 2], 2)


def test_the_frame_that_was_sent_is_never_altered():
    sent = message(5)
    before = content(sent)
    for action in ("corrupt", "shorten", "misaddress", "repeat"):
        played([f"{action} any p=1"], [sent])
    assert content(sent) == before
