"""The bus in virtual time: programs take turns, and time passes when all of them wait."""

import os
import select

import can
import pytest

from cutgate.firmware_sim.bus.frame import BusFrame
from cutgate.firmware_sim.bus.medium.bits import Rates, frame_bits
from cutgate.firmware_sim.bus.medium.errors import Injection, WireFault
from cutgate.firmware_sim.bus.medium.medium import Carried
from cutgate.firmware_sim.bus.virtual_time import START_S, TURN_S, VirtualTime

RATES = Rates(1_000_000)


def message(number=1, data=b""):
    return can.Message(arbitration_id=number, data=data, is_extended_id=False)


@pytest.fixture
def time():
    made, joined = VirtualTime(RATES), []
    join = made.join

    def remembered(*names, **options):
        joined.append(join(*names, **options))
        return joined[-1]

    made.join = remembered
    yield made
    for bus in joined:
        bus.shutdown()


def test_a_bus_that_was_left_is_left_for_good(time):
    one, two = time.join("one"), time.join("two")
    descriptor = one.fileno()
    one.shutdown()
    assert one._is_shutdown  # else python-can shuts it down again when it is collected
    assert set(time.medium.nodes) == {two.number}
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(descriptor)
    with pytest.raises(can.CanOperationError, match="shut down"):
        one.fileno()


def test_its_descriptor_is_for_poll_alone_and_never_has_anything(time):
    one, two = time.join("one"), time.join("two")
    two.send(message())
    time.run(1.0)
    assert select.select([one], [], [], 0) == ([], [], [])
    assert not os.get_blocking(one.fileno())
    assert not os.get_inheritable(one.fileno())


def test_a_bus_is_classic_or_fd_and_says_so(time):
    assert time.join("one").protocol is can.CanProtocol.CAN_20
    assert time.join("two", fd=True).protocol is can.CanProtocol.CAN_FD


def test_the_clock_is_that_of_the_frames_and_of_the_medium(time):
    one, two = time.join("one"), time.join("two")
    one.send(message(5))
    assert (time.now_ns, time.clock()) == (1000 * 10**9, 1000.0)
    took_ns = frame_bits(BusFrame(5)).nominal * 1000
    assert two.recv(1.0).timestamp == (1000 * 10**9 + took_ns) / 10**9
    assert one.recv(0) is None  # its own only where it asks for it
    time.run(2.0)
    assert time.now_ns == 1002 * 10**9 + took_ns


def test_a_queue_is_as_deep_as_it_is_made():
    time = VirtualTime(RATES, queue_frames=3)
    one = time.join("one")
    for _ in range(3):
        one.send(message())
    with pytest.raises(can.CanTimeoutError):
        one.send(message())
    one.shutdown()


def test_nothing_passes_unless_somebody_waits(time):
    one, two = time.join("one"), time.join("two")
    one.send(message(5))
    assert two.recv(0) is None
    assert time.clock() == START_S
    assert two.recv(1.0).arbitration_id == 5
    assert time.clock() == pytest.approx(START_S + frame_bits(BusFrame(5)).nominal / 1e6)
    assert two.recv(1.0) is None
    assert time.clock() == pytest.approx(START_S + 1.0, abs=1e-3)
    with pytest.raises(can.CanOperationError, match="needs a timeout"):
        two.recv(None)


def test_a_loop_turns_when_it_has_waited_and_when_a_frame_comes(time):
    one, two = time.join("one"), time.join("two")
    turns = []

    def turn():
        turns.append(round(time.clock() - START_S, 6))
        while two.recv(0) is not None:
            pass

    time.add(two, turn, lambda: 0.25)
    time.run(0.6)
    assert turns == [0.0, 0.25, 0.5]
    one.send(message(5))
    time.run(0.1)
    assert turns[3] == pytest.approx(0.6, abs=0.0002)
    time.remove(two)
    time.run(1.0)
    assert len(turns) == 4


def test_a_loop_that_never_waits_does_not_stop_the_clock(time):
    bus, turns = time.join("busy"), []
    time.add(bus, lambda: turns.append(1), lambda: 0.0)
    time.run(0.1)
    assert len(turns) == pytest.approx(0.1 / TURN_S, abs=2)
    assert time.clock() == pytest.approx(START_S + 0.1)


def test_until_says_whether_it_came_about(time):
    assert not time.until(lambda: False, 0.5)
    assert time.until(lambda: time.clock() > START_S + 0.6 - 1e-9, 0.1)


def test_the_condition_is_asked_when_something_was_heard_not_when_a_frame_begins(time):
    one, _two = time.join("one"), time.join("two")
    time.run(0.25)  # the bus has long been free
    one.send(message(5))
    began_ns, asked_ns = time.now_ns, []
    assert not time.until(lambda: asked_ns.append(time.now_ns), 0.5)
    end_ns = began_ns + frame_bits(BusFrame(5)).ns(RATES)
    assert asked_ns == [began_ns, end_ns, began_ns + 500_000_000]


def test_a_full_queue_and_a_bus_that_was_left_say_so(time):
    one, _two = time.join("one"), time.join("two")
    for _ in range(10):
        one.send(message(), timeout=5.0)
    with pytest.raises(can.CanTimeoutError, match="queue of one is full"):
        one.send(message(), timeout=5.0)
    one.shutdown()
    one.shutdown()
    for call in (lambda: one.send(message()), lambda: one.recv(0)):
        with pytest.raises(can.CanOperationError, match="was shut down"):
            call()


def test_fd_frames_and_own_frames_come_to_those_who_asked(time):
    one, two, classic = (
        time.join("one", fd=True, receive_own_messages=True),
        time.join("two", fd=True),
        time.join("classic"),
    )
    one.send(can.Message(arbitration_id=1, is_extended_id=False, is_fd=True, data=bytes(12)))
    time.run(0.01)
    assert two.recv(0).is_fd
    assert not one.recv(0).is_rx
    assert classic.recv(0) is None
    with pytest.raises(can.CanOperationError, match="fd=True"):
        classic.send(can.Message(arbitration_id=1, is_fd=True, is_extended_id=False))


def test_a_watcher_sees_everything_and_a_node_hears_of_its_own_state(time):
    seen = []
    time.watchers.append(seen.append)
    one, two = time.join("one"), time.join("two")
    time.medium.inject(Injection(WireFault.BIT, count=12))
    one.send(message(5))
    time.run(0.1)
    assert [event.frame.number for event in seen if isinstance(event, Carried)] == [5]
    assert one.recv(0).is_error_frame
    assert two.recv(0).arbitration_id == 5
    time.medium.inject(Injection(WireFault.BIT, count=12))
    one.send(message(5))
    one.shutdown()
    time.run(0.1)  # whoever has left is told nothing
    assert two.recv(0).arbitration_id == 5


def test_a_node_comes_back_after_its_pause():
    time = VirtualTime(RATES, restart_s=0.5)
    one, two = time.join("one"), time.join("two")
    time.medium.inject(Injection(WireFault.BIT, count=32))
    one.send(message(5))
    time.run(0.4)
    with pytest.raises(can.CanTimeoutError):
        one.send(message(6))
    time.run(0.4)
    one.send(message(6))
    assert two.recv(0.1).arbitration_id == 6
    for bus in (one, two):
        bus.shutdown()


def test_filters_leave_out_what_they_do_not_name_and_no_error(time):
    one, two = time.join("one"), time.join("two")
    two.set_filters([{"can_id": 2, "can_mask": 0x7FF, "extended": False}])
    for number in (1, 2, 3):
        one.send(message(number))
    assert two.recv(1.0).arbitration_id == 2
    assert two.recv(0.1) is None
    assert two.fileno() != one.fileno()
    time.leave(two.number)
    time.leave(two.number)


def test_unpaced_a_frame_takes_no_time():
    time = VirtualTime()
    one, two = time.join("one"), time.join("two")
    for number in range(10):
        one.send(message(number))
    time.run(0.0001)
    assert [two.recv(0).arbitration_id for _ in range(10)] == list(range(10))
    for bus in (one, two):
        bus.shutdown()


def test_what_ends_at_the_moment_of_a_turn_is_heard_in_it(time):
    one, two, turns = time.join("one"), time.join("two"), []
    time.run(0.25)
    begun_ns, takes_ns, wait_ns = time.now_ns, frame_bits(BusFrame(5)).ns(RATES), 100_000_000
    time.add(two, lambda: turns.append((time.now_ns - begun_ns, len(two.inbox))), lambda: wait_ns / 1e9)
    time.run((wait_ns - takes_ns) / 1e9)
    one.send(message(5))
    time.run(takes_ns / 1e9)
    assert turns == [(0, 0), (wait_ns, 1)]
