"""The bus as a whole: order, time, errors, queues, who leaves and who comes back."""

import random
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.firmware_sim.bus.frame import BusFrame
from cutgate.firmware_sim.bus.medium import medium as module
from cutgate.firmware_sim.bus.medium.bits import Rates, frame_bits
from cutgate.firmware_sim.bus.medium.confinement import Counters, NodeState
from cutgate.firmware_sim.bus.medium.errors import CASES, Injection, WireFault
from cutgate.firmware_sim.bus.medium.medium import Carried, Changed, Destroyed, Medium, QueueRoom
from tests.firmware_sim.bus.medium.frames import FD, SWITCH, classic, flexible, of
from tests.oracle.can_wire import encoded, winners

RATES = Rates(1_000_000, 5_000_000)
BIT_NS = 1000
S = NodeState
E = WireFault


def bus(nodes=2, **options):
    medium = Medium(RATES, **options)
    for name in "abcdefgh"[:nodes]:
        medium.join(name, 0)
    return medium


def all_of(medium, until_ns=10**12):
    """Everything that happens when nothing more is offered; a loop without an end ends here."""
    events = []
    for _ in range(100_000):
        if medium.next_ns is None or medium.next_ns > until_ns:
            return events
        events += medium.advance(medium.next_ns)
    raise AssertionError("it never ends")


def carried(events):
    return [event for event in events if isinstance(event, Carried)]


def only(kind, events):
    (found,) = [event for event in events if isinstance(event, kind)]
    return found


# ---------------------------------------------------------------- time and order


@given(classic() | flexible())
def test_a_frame_takes_as_long_as_its_bits(frame):
    medium = bus()
    assert medium.offer(1, frame, 5)
    (event,) = carried(all_of(medium))
    wire = encoded(frame)
    assert event.at_ns == 5 + (len(wire.bits) - len(wire.fast) + 9) * BIT_NS + len(wire.fast) * 200
    assert (event.frame, event.senders, event.receivers, event.sent) == (frame, (1,), (2,), True)


@given(
    st.lists(
        classic(), min_size=2, max_size=6, unique_by=lambda frame: winners([frame, frame]) and frame.number
    )
)
def test_of_those_that_begin_at_once_the_wire_decides_each_time_who_sends(frames):
    medium = bus(len(frames) + 1)
    for number, frame in enumerate(frames, start=1):
        medium.offer(number, frame, 0)
    sent = [event.frame for event in carried(all_of(medium))]
    left = list(frames)
    for frame in sent:
        first = winners(left)
        assert [left[index] for index in first] == [frame]
        left.remove(frame)
    assert not left


def test_what_is_on_the_wire_is_not_interrupted_and_the_intermission_lies_between():
    medium = bus(3)
    low, high = of(0x700, bytes(8)), of(0x001)
    medium.offer(1, low, 0)
    medium.advance(10 * BIT_NS)
    medium.offer(2, high, 10 * BIT_NS)
    medium.offer(1, of(0x002), 11 * BIT_NS)
    first, second, third = carried(all_of(medium))
    assert [event.frame.number for event in (first, second, third)] == [0x700, 0x001, 0x002]
    assert first.at_ns == frame_bits(low).nominal * BIT_NS
    assert second.at_ns == first.at_ns + (3 + frame_bits(high).nominal) * BIT_NS
    assert medium.nodes[1].tally.lost_arbitration == 1


def test_a_queue_is_first_in_first_out_and_full_at_its_depth():
    medium = bus(queue_frames=3)
    numbers = [0x300, 0x200, 0x100]
    assert [medium.offer(1, of(number), 0) for number in numbers] == [True] * 3
    assert not medium.offer(1, of(0), 0)
    assert medium.nodes[1].tally.refused == 1
    events = all_of(medium)
    assert [event.frame.number for event in carried(events)] == numbers
    assert [event for event in events if isinstance(event, QueueRoom)] == [QueueRoom(1, 1)] * 3


def test_a_busy_bus_carries_its_bit_rate():
    medium, frame = bus(), of(0x123, b"12345678")
    now_ns, count = 0, 0
    while now_ns < 10**9:
        while medium.offer(1, frame, now_ns):
            pass
        now_ns = medium.next_ns
        count += len(carried(medium.advance(now_ns)))
    bits = count * (frame_bits(frame).nominal + 3)
    assert 0.999 < bits / 1e6 <= 1.001
    assert 0.999 < medium.totals.busy_ns / 1e9 <= 1.001


def test_the_same_frame_of_two_is_sent_once_and_both_believe_it():
    medium = bus(3)
    for number in (1, 2):
        medium.offer(number, of(5, b"x"), 0)
    event = only(Carried, all_of(medium))
    assert (event.senders, event.receivers) == ((1, 2), (3,))
    assert [medium.nodes[number].tally.sent for number in (1, 2)] == [1, 1]


def test_other_data_under_one_identifier_destroys_both_until_both_are_off():
    medium = bus(3)
    medium.offer(1, of(5, b"x"), 0)
    medium.offer(2, of(5, b"y"), 0)
    events = all_of(medium)
    assert not carried(events)
    assert len([event for event in events if isinstance(event, Destroyed)]) == 32
    assert [medium.nodes[number].state for number in (1, 2, 3)] == [S.BUS_OFF, S.BUS_OFF, S.ERROR_ACTIVE]


# ---------------------------------------------------------------- errors


@pytest.mark.parametrize("kind", WireFault)
def test_after_an_error_the_frame_is_sent_again(kind):
    medium = bus(3)
    assert medium.inject(Injection(kind, number=5))
    medium.offer(1, of(5, b"x"), 0)
    events = all_of(medium)
    failed, last = only(Destroyed, events), carried(events)[-1]
    assert (failed.kind, failed.senders, last.sent) == (kind, (1,), True)
    assert medium.totals.error_frames == medium.nodes[1].tally.errors == 1
    assert medium.nodes[1].counters == Counters(8 - 1, 0)
    whole = frame_bits(of(5, b"x")).nominal
    where = CASES[kind].from_end
    assert failed.at_ns == (whole // 2 if where is None else whole - where) * BIT_NS or where is None
    assert last.at_ns == failed.at_ns + (12 + 8 + 3 + whole) * BIT_NS


@pytest.mark.parametrize(
    ("kind", "seen_by", "twice"),
    [
        (E.LAST_BUT_ONE, frozenset({3}), (2,)),
        (E.LAST, None, (2, 3)),
        (E.CRC, frozenset({3}), ()),
        (E.BIT, None, ()),
    ],
)
def test_an_error_at_the_very_end_gives_a_frame_twice(kind, seen_by, twice):
    medium = bus(3)
    medium.inject(Injection(kind, receivers=seen_by))
    medium.offer(1, of(5), 0)
    arrived = [number for event in carried(all_of(medium)) for number in event.receivers]
    assert sorted(arrived) == sorted([2, 3, *twice])


def test_an_error_that_only_a_passive_node_sees_destroys_nothing_and_loses_it_the_frame():
    medium = bus(3)
    medium.nodes[3].counters = Counters(0, 128)
    medium.inject(Injection(E.CRC, receivers=frozenset({3})))
    medium.offer(1, of(5), 0)
    event = only(Carried, all_of(medium))
    assert (event.receivers, medium.totals.error_frames) == ((2,), 0)
    assert medium.nodes[3].counters.receive == 128


def test_without_anybody_to_acknowledge_a_node_goes_on_trying_and_is_never_off():
    medium = bus(1)
    medium.offer(1, of(5), 0)
    events = all_of(medium, 10**8)
    assert not carried(events)
    assert {event.kind for event in events if isinstance(event, Destroyed)} == {E.ACK}
    assert medium.nodes[1].counters == Counters(128)
    medium.join("late", 10**8)
    event = only(Carried, all_of(medium))
    assert event.receivers == (2,)


def test_a_passive_sender_lets_the_others_go_first():
    medium = bus(3)
    medium.nodes[1].counters = Counters(130)
    for number in (1, 2):  # two each: after its first the passive one has to wait
        medium.offer(1, of(number), 0)
        medium.offer(2, of(0x100 + number), 0)
    numbers = [event.frame.number for event in carried(all_of(medium))]
    assert numbers == [1, 0x101, 2, 0x102]
    medium = bus(3)
    medium.nodes[1].counters = Counters(140)
    medium.offer(1, of(1), 0)
    medium.offer(1, of(2), 0)
    first, second = carried(all_of(medium))
    assert second.at_ns - first.at_ns == (3 + 8 + frame_bits(of(2)).nominal) * BIT_NS


def test_only_so_many_errors_are_kept_to_come(monkeypatch):
    monkeypatch.setattr(module, "INJECTIONS_MAX", 2)
    medium = bus()
    assert medium.inject(Injection(E.BIT, count=1))
    assert medium.inject(Injection(E.BIT, number=99))
    assert not medium.inject(Injection(E.BIT))
    medium.offer(1, of(5), 0)
    all_of(medium)
    assert medium.inject(Injection(E.BIT))  # one has happened


# ---------------------------------------------------------------- off and back


def gone_off(medium):
    medium.inject(Injection(E.BIT, senders=frozenset({1}), count=32))
    medium.offer(1, of(5), 0)
    medium.offer(1, of(6), 0)
    return all_of(medium, 10**8)


def test_a_node_that_is_off_neither_sends_nor_hears_and_its_queue_is_lost():
    medium = bus(3)
    events = gone_off(medium)
    states = [event.state for event in events if isinstance(event, Changed)]
    assert states == [S.ERROR_WARNING, S.ERROR_PASSIVE, S.BUS_OFF]
    assert not carried(events)
    assert not medium.nodes[1].queue
    assert not medium.offer(1, of(7), 10**8)
    medium.offer(2, of(8), 10**8)
    assert only(Carried, all_of(medium)).receivers == (3,)
    assert medium.next_ns is None


def test_it_comes_back_after_its_pause_and_128_times_eleven_recessive_bits():
    medium = bus(2, restart_ns=10**6)
    events = gone_off(medium)
    off, back = [event for event in events if isinstance(event, Changed)][-2:]
    assert back.at_ns - off.at_ns == 10**6 + 1408 * BIT_NS
    assert (back.state, back.counters) == (S.ERROR_ACTIVE, Counters())
    assert QueueRoom(1, 10) in events
    assert medium.offer(1, of(7), back.at_ns)
    assert only(Carried, all_of(medium)).frame.number == 7


def test_on_a_busy_bus_each_frame_counts_once_towards_the_way_back():
    medium = bus(3, restart_ns=10**6)
    medium.inject(Injection(E.BIT, senders=frozenset({1}), count=32))
    medium.offer(1, of(5), 0)
    now_ns, frames = 0, 0
    while medium.nodes[1].state is not S.BUS_OFF:
        now_ns = medium.next_ns
        medium.advance(now_ns)
    now_ns += 10**6
    medium.advance(now_ns)
    while medium.nodes[1].state is S.BUS_OFF:
        while medium.offer(2, of(5, bytes(8)), now_ns):
            pass
        now_ns = medium.next_ns
        frames += len(carried(medium.advance(now_ns)))
    assert 126 <= frames <= 129


# ---------------------------------------------------------------- who takes part


def test_what_a_node_had_queued_goes_after_it_has_left():
    medium = bus(3)
    medium.offer(1, of(5), 0)
    medium.leave(1)
    assert only(Carried, all_of(medium)).receivers == (2, 3)
    assert set(medium.nodes) == {2, 3}


def test_who_has_left_hears_and_acknowledges_nothing():
    medium = bus(3)
    medium.offer(2, of(5), 0)
    medium.offer(2, of(6), 0)
    medium.leave(2)
    medium.offer(1, of(7), 0)
    assert {event.receivers for event in carried(all_of(medium))} == {(1, 3), (3,)}


def test_a_node_that_leaves_with_nobody_left_is_forgotten():
    medium = bus(1)
    medium.offer(1, of(5), 0)
    medium.advance(0)
    medium.leave(1)
    all_of(medium)
    assert not medium.nodes
    assert medium.next_ns is None


def test_a_node_that_leaves_while_it_is_off_does_not_come_back():
    medium = bus(2, restart_ns=10**9)
    gone_off(medium)
    medium.leave(1)
    assert not all_of(medium)


def test_talkers_are_bounded(monkeypatch):
    monkeypatch.setattr(module, "TALKERS_MAX", 2)
    medium = bus()
    for number in (1, 2, 3, 4, 1):
        medium.offer(1, of(number), 0)
    all_of(medium)
    assert {key: talker.frames for key, talker in medium.totals.talkers.items()} == {
        (1, 1): 2,
        (1, 2): 1,
        (1, -1): 2,
    }


# ---------------------------------------------------------------- whatever happens


@pytest.mark.parametrize("seed", range(40))
def test_whatever_happens_nothing_is_lost_without_a_word_and_frames_never_overlap(seed):
    """Each frame that was queued is sent, or its node went off or never had anybody to hear it; ends never overlap."""
    draw = random.Random(seed)
    medium = bus(
        draw.randint(2, 5), queue_frames=draw.randint(1, 10), restart_ns=draw.choice([None, 0, 10**7])
    )
    now_ns, queued, sent, off = 0, 0, 0, 0
    ends = []
    for _ in range(300):
        now_ns += draw.choice([0, 10**4, 10**5, 10**6])
        before = {node.number: len(node.queue) for node in medium.nodes.values()}
        events = medium.advance(now_ns)
        off += sum(before[e.node] for e in events if isinstance(e, Changed) and e.state is S.BUS_OFF)
        sent += sum(len(e.senders) for e in carried(events) if e.sent)
        ends += [(e.at_ns, frame_bits(e.frame).ns(RATES)) for e in carried(events) if e.sent]
        if draw.random() < 0.2:
            receivers = draw.choice([None, frozenset({1})])
            kind = draw.choice([*WireFault])
            medium.inject(Injection(kind, receivers=receivers, count=draw.randint(1, 12)))
        flags = draw.choice([0, FD | SWITCH])
        data = bytes(draw.choice([0, 4, 8]))
        frame = BusFrame(draw.randrange(4), flags, len(data), data)
        queued += medium.offer(draw.randint(1, len(medium.nodes)), frame, now_ns)
    waiting = sum(len(node.queue) for node in medium.nodes.values())
    assert queued - off <= sent + waiting <= queued
    assert all(later - took >= earlier + 3 * BIT_NS for (earlier, _), (later, took) in pairwise(ends))
