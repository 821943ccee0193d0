"""The bus as a whole: order, time, errors, queues, who leaves and who comes back."""

import random
from dataclasses import FrozenInstanceError, fields
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.firmware_sim.bus.frame import BusFrame
from cutgate.firmware_sim.bus.medium.bits import Rates, frame_bits
from cutgate.firmware_sim.bus.medium.confinement import Counters, NodeState
from cutgate.firmware_sim.bus.medium.errors import CASES, Injection, WireFault
from cutgate.firmware_sim.bus.medium.medium import Carried, Changed, Destroyed, Medium, QueueRoom
from tests.firmware_sim.bus.medium.frames import EXTENDED, FD, SWITCH, classic, flexible, of
from tests.oracle.can_errors import signalled
from tests.oracle.can_wire import encoded, winners

RATES = Rates(1_000_000, 5_000_000)
BIT_NS = 1000
S = NodeState
E = WireFault


def bus(nodes=2, **options):
    medium = Medium(RATES, **options)
    for name in "abcdefgh"[:nodes]:
        medium.join(name)
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


@pytest.mark.parametrize("kind", WireFault)
@pytest.mark.parametrize("seers", [{1}, {1, 2}, {1, 2, 3}], ids=str)
def test_what_each_counts_of_an_error_and_who_keeps_the_frame_is_what_the_flags_on_a_wire_make_of_it(
    kind, seers
):
    medium = bus(4)
    for node in medium.nodes.values():
        node.counters = Counters(20, 20)
    medium.inject(Injection(kind, receivers=frozenset(number + 1 for number in seers)))
    medium.offer(1, of(5, b"x"), 0)
    events = medium.advance(medium.next_ns) + medium.advance(medium.next_ns)
    sender, *receivers = signalled(kind.value, seers, 3)
    assert isinstance(events[-1], Destroyed)
    assert medium.nodes[1].counters == Counters(20 + sender[0], 20)
    kept = [number for number, (_, taken) in enumerate(receivers, start=2) if taken]
    assert [node.counters for node in list(medium.nodes.values())[1:]] == [
        Counters(20, 19 if taken else 20 + counted) for counted, taken in receivers
    ]
    assert [number for event in carried(events) for number in event.receivers] == kept
    assert [number for number, node in medium.nodes.items() if node.tally.received] == kept
    assert not any(event.sent for event in carried(events))


def test_a_receiver_that_is_broken_itself_is_passive_before_it_has_sent_a_good_sender_off():
    medium = bus(3)
    medium.inject(Injection(E.CRC, receivers=frozenset({3}), count=1000))
    for number in range(10):
        medium.offer(1, of(number), 0)
    events = all_of(medium)
    assert [event.receivers for event in carried(events)] == [(2,)] * 10
    assert [medium.nodes[number].state for number in (1, 2, 3)] == [
        S.ERROR_WARNING,
        S.ERROR_ACTIVE,
        S.ERROR_PASSIVE,
    ]
    assert medium.totals.error_frames == 15


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
    medium.join("late")
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


def test_a_passive_sender_lets_the_others_go_first_after_an_error_as_well():
    medium = bus(3)
    medium.nodes[1].counters = Counters(130)
    medium.inject(Injection(E.CRC))
    medium.offer(1, of(1), 0)
    medium.advance(0)
    medium.offer(2, of(2), 1)
    assert [event.frame.number for event in carried(all_of(medium))] == [2, 1]


def test_only_so_many_errors_are_kept_to_come():
    medium = bus()
    assert medium.inject(Injection(E.BIT, count=1))
    assert all(medium.inject(Injection(E.BIT, number=99)) for _ in range(255))
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


def off_in(medium):
    """Send node 1 off; when."""
    medium.inject(Injection(E.BIT, senders=frozenset({1}), count=32))
    medium.offer(1, of(5), 0)
    while medium.nodes[1].state is not S.BUS_OFF:
        events = medium.advance(medium.next_ns)
    return events[0].at_ns


def back_at(runs, restart_ns):
    """Eleven recessive bits after eleven, counted run by run; what is left of a run is lost."""
    missing = 128
    for start_ns, end_ns in runs:
        since_ns = max(start_ns, restart_ns)
        seen = max(0, end_ns - since_ns) // (11 * BIT_NS)
        if seen >= missing:
            return since_ns + missing * 11 * BIT_NS
        missing -= seen
    raise AssertionError


@pytest.mark.parametrize("seed", range(30))
def test_it_comes_back_after_as_many_times_eleven_recessive_bits_as_the_wire_has_had(seed):
    """A frame ends with 8 recessive bits, an error frame as well; the next frame breaks the run behind it."""
    draw = random.Random(seed)
    pause_ns, gap_bits = draw.choice([0, 10**5, draw.randint(0, 10**6)]), draw.choice([0, 5, 11, 30, 200])
    medium = bus(3, restart_ns=pause_ns)
    off_ns = now_ns = off_in(medium)
    since_ns, runs, events = off_ns + 12 * BIT_NS, [], []
    while medium.nodes[1].state is S.BUS_OFF:
        if draw.random() < 0.05:
            medium.inject(Injection(draw.choice([E.CRC, E.BIT])))
        if not medium.nodes[2].queue:
            medium.offer(2, of(5, bytes(draw.randint(0, 8))), now_ns + draw.randint(0, gap_bits) * BIT_NS)
        now_ns = medium.next_ns
        events = medium.advance(now_ns)
        if not events:
            runs.append((since_ns, now_ns))
        for event in events:
            if isinstance(event, Carried | Destroyed):
                since_ns = event.at_ns + (12 if isinstance(event, Destroyed) else -8) * BIT_NS
    assert events[:1] == [
        Changed(back_at([*runs, (since_ns, 10**12)], off_ns + pause_ns), 1, S.ERROR_ACTIVE, Counters())
    ]
    medium.offer(2, of(6), now_ns)
    assert {event.receivers for event in carried(all_of(medium))} == {(1, 3)}


def test_each_comes_back_in_its_own_time():
    medium = bus(3, restart_ns=10**6)
    off_in(medium)
    medium.inject(Injection(E.BIT, senders=frozenset({2}), count=32))
    medium.offer(2, of(5), 0)
    events = all_of(medium)
    times = {(event.node, event.state): event.at_ns for event in events if isinstance(event, Changed)}
    assert times[2, S.ERROR_ACTIVE] - times[2, S.BUS_OFF] == 10**6 + 1408 * BIT_NS
    assert times[1, S.ERROR_ACTIVE] < times[2, S.ERROR_ACTIVE]


def test_where_a_bit_takes_no_time_the_way_back_takes_next_to_none():
    medium = Medium(Rates(10**15), restart_ns=0)
    for name in "ab":
        medium.join(name)
    off_ns = off_in(medium)
    assert off_ns == 0
    assert [event.at_ns for event in medium.advance(128) if isinstance(event, Changed)] == [128]


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


def test_talkers_are_bounded():
    medium = bus(queue_frames=5000)
    for number in (*range(4096 + 3), 1):
        medium.offer(1, of(number, flags=EXTENDED), 0)
    all_of(medium)
    frames = {number: talker.frames for (_, number), talker in medium.totals.talkers.items()}
    assert frames == dict.fromkeys(range(4096), 1) | {1: 2, -1: 3}


# ---------------------------------------------------------------- whatever happens


@pytest.mark.parametrize("seed", range(40))
def test_whatever_happens_nothing_is_lost_without_a_word_and_frames_never_overlap(seed):
    """Each frame that was queued is sent, or its node went off or never had anybody to hear it; ends never overlap."""
    draw = random.Random(seed)
    medium = bus(
        draw.randint(2, 5), queue_frames=draw.randint(1, 10), restart_ns=draw.choice([None, 0, 10**7])
    )
    now_ns, queued, sent, off = 0, 0, 0, 0
    ends, history = [], []
    for _ in range(300):
        now_ns += draw.choice([0, 10**4, 10**5, 10**6])
        before = {node.number: len(node.queue) for node in medium.nodes.values()}
        events = medium.advance(now_ns)
        history += events
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
    assert_counted(medium, history)


def assert_counted(medium, events):
    """Every count is that of the events."""
    destroyed = [event for event in events if isinstance(event, Destroyed)]
    for number, node in medium.nodes.items():
        assert node.tally.sent == sum(event.sent and number in event.senders for event in carried(events))
        assert node.tally.received == sum(number in event.receivers for event in carried(events))
        assert node.tally.errors == sum(number in event.senders for event in destroyed)
    whole = [frame_bits(event.frame).ns(RATES) + 3 * BIT_NS for event in carried(events) if event.sent]
    assert (medium.totals.frames, medium.totals.error_frames) == (len(whole), len(destroyed))
    assert medium.totals.busy_ns >= sum(whole) + len(destroyed) * (20 + 3) * BIT_NS
    talkers = medium.totals.talkers
    for number, node in medium.nodes.items():
        those = [talker for (who, _), talker in talkers.items() if who == number]
        assert node.tally.busy_ns == sum(talker.busy_ns for talker in those)
        assert node.tally.sent + node.tally.errors == sum(talker.frames for talker in those)


def test_what_keeps_the_bus_busy_is_booked_to_whose_it_is():
    medium = bus(3)
    medium.offer(1, of(5), 0)
    medium.offer(2, of(6, b"x"), 0)
    medium.offer(2, of(7, b"y"), 0)
    medium.inject(Injection(E.FORM, number=7))
    all_of(medium)
    took = {
        number: (frame_bits(of(number, data)).nominal + 3) * BIT_NS
        for number, data in ((5, b""), (6, b"x"), (7, b"y"))
    }
    wrong = took[7] + (20 - 9) * BIT_NS
    assert {key: talker.busy_ns for key, talker in medium.totals.talkers.items()} == {
        (1, 5): took[5],
        (2, 6): took[6],
        (2, 7): took[7] + wrong,
    }
    assert medium.totals.busy_ns == sum(took.values()) + wrong
    assert [node.tally.busy_ns for node in medium.nodes.values()] == [took[5], took[6] + took[7] + wrong, 0]


@pytest.mark.parametrize(
    "event",
    [
        Carried(0, of(1), (1,), (2,)),
        Destroyed(0, E.BIT, of(1), (1,)),
        QueueRoom(1, 1),
        Changed(0, 1, S.BUS_OFF, Counters()),
    ],
    ids=lambda event: type(event).__name__,
)
def test_what_has_happened_is_not_altered(event):
    with pytest.raises(FrozenInstanceError):
        setattr(event, fields(event)[0].name, 2)
    assert not hasattr(event, "__dict__")  # there are thousands a second
