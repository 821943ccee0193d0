"""A bus with faults is a bus: what is sent and received passes through them, and its failures stay its own."""

import math
from collections import deque

import can
import pytest

from cutgate.firmware_sim.fault_language import parse_fault
from cutgate.firmware_sim.faulty_bus import FaultyBus
from cutgate.protocol.frames import ControllerHeartbeat, encode_frame
from cutgate.protocol.port import RETRY_S
from cutgate.protocol.states import ControllerState, StopCause
from cutgate.protocol.wire import Side


class PlainBus(can.BusABC):
    """A bus in memory: what arrives is put there, what is sent is kept, and it has as much room as is said."""

    def __init__(self):
        self.arriving, self.sent, self.room, self.ended = deque(), [], math.inf, 0
        self.channel_info = "plain"
        super().__init__(channel="plain")

    def fileno(self):
        return 77

    def send(self, msg, timeout=None):
        if len(self.sent) >= self.room:
            raise can.CanTimeoutError("full")
        self.sent.append(msg)

    def recv(self, timeout=None):
        self.asked_s = timeout
        return self.arriving.popleft() if self.arriving else None

    def shutdown(self):
        self.ended += 1
        super().shutdown()


class Clock:
    def __init__(self):
        self.now_s = 50.0

    def __call__(self):
        return self.now_s


def heartbeat(state, counter=0):
    frame = ControllerHeartbeat(state, 1, StopCause.NONE, False, True, False)
    can_id, data = encode_frame(frame, counter, 0)
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False)


def message(number, can_id=0x300):
    return can.Message(arbitration_id=can_id, data=bytes([number]), is_extended_id=False)


@pytest.fixture
def plain():
    bus = PlainBus()
    yield bus
    bus.shutdown()


@pytest.fixture
def clock():
    return Clock()


def faulty(plain, clock, *lines, **how):
    return FaultyBus(plain, map(parse_fault, lines), clock=clock, **how)


def test_without_a_fault_everything_passes_as_it_is(plain, clock):
    with faulty(plain, clock) as bus:
        sent, arriving = message(1), message(2)
        bus.send(sent)
        plain.arriving.append(arriving)
        assert bus.recv(timeout=0) is arriving
        assert bus.recv(timeout=0) is None
        assert plain.sent == [sent]
        assert (bus.fileno(), bus.late_wait_s(), bus.channel_info) == (77, math.inf, "plain with faults")
    assert plain.ended == 1


def test_what_is_sent_and_what_arrives_is_lost(plain, clock):
    with faulty(plain, clock, "lose Joints01 x2") as bus:
        bus.send(message(1))
        plain.arriving.extend([message(2), message(3)])
        assert bus.recv(timeout=0) is None
        assert bus.recv(timeout=0).data == b"\x03"
        assert plain.sent == []


def test_what_is_late_leaves_and_arrives_with_the_next_call_after_its_time(plain, clock):
    with faulty(plain, clock, "delay Joints01 by 30ms p=1") as bus:
        bus.send(message(1))
        plain.arriving.append(message(2))
        assert bus.recv(timeout=0) is None
        assert bus.late_wait_s() == pytest.approx(0.03)
        clock.now_s += 0.031
        assert bus.late_wait_s() == 0.0
        assert bus.recv(timeout=0).data == b"\x02"
        assert [one.data for one in plain.sent] == [b"\x01"]
        assert bus.late_wait_s() == math.inf


def test_nobody_waits_longer_in_recv_than_until_what_is_late(plain, clock):
    with faulty(plain, clock, "delay Joints01 by 30ms") as bus:
        bus.send(message(1))
        plain.arriving.append(message(5, 0x123))
        bus.recv(timeout=9.0)
        assert plain.asked_s == pytest.approx(0.03)
        clock.now_s += 1.0
        plain.arriving.append(message(6, 0x123))
        bus.recv(timeout=9.0)
        assert plain.asked_s == pytest.approx(9.0)
        plain.arriving.append(message(7, 0x123))
        bus.recv()
        assert plain.asked_s is None


def test_several_that_arrive_at_once_are_read_one_after_the_other(plain, clock):
    with faulty(plain, clock, "repeat Joints01") as bus:
        plain.arriving.append(message(1))
        assert [bus.recv(timeout=0).data, bus.late_wait_s(), bus.recv(timeout=0).data] == [
            b"\x01",
            0.0,
            b"\x01",
        ]
        assert bus.recv(timeout=0) is None


def test_a_full_queue_is_a_full_queue_and_nothing_is_lost(plain, clock):
    with faulty(plain, clock, "repeat Joints01") as bus:
        plain.room = 1
        bus.send(message(1), timeout=0)  # once; the second time waits
        assert bus.late_wait_s() == RETRY_S
        with pytest.raises(can.CanTimeoutError):
            bus.send(message(2), timeout=0)
        assert bus.recv(timeout=0) is None
        plain.room = math.inf
        bus.send(message(2), timeout=0)
        assert [one.data for one in plain.sent] == [b"\x01", b"\x01", b"\x02"]


def test_the_state_is_that_of_the_heartbeats_before_anything_happens_to_them(plain, clock):
    lose = "lose ControllerHeartbeat @cutting p=1"
    for side in Side:
        plain.sent.clear()
        with faulty(plain, clock, lose, side=side) as bus:
            passed = []
            for state in (
                ControllerState.OPEN,
                ControllerState.CUTTING,
                ControllerState.CUTTING,
                ControllerState.DONE,
            ):
                if side is Side.CONTROLLER:
                    bus.send(heartbeat(state))
                    passed = plain.sent
                else:
                    plain.arriving.append(heartbeat(state))
                    passed += [one for one in [bus.recv(timeout=0)] if one is not None]
            assert len(passed) == 2


def test_the_state_may_be_told(plain, clock):
    told = ControllerState.OPEN
    with faulty(plain, clock, "lose any @cutting p=1", controller_state=lambda: told) as bus:
        bus.send(heartbeat(ControllerState.CUTTING))
        told = ControllerState.CUTTING
        bus.send(message(1))
        assert len(plain.sent) == 1


@pytest.mark.parametrize("data", [b"", b"1234567", b"\xff" * 8])
def test_a_heartbeat_that_cannot_be_read_says_no_state(plain, clock, data):
    with faulty(plain, clock, "lose any @cutting") as bus:
        bus.send(heartbeat(ControllerState.CUTTING))
        assert plain.sent == []
        wrong = can.Message(
            arbitration_id=heartbeat(ControllerState.OPEN).arbitration_id, data=data, is_extended_id=False
        )
        bus.send(wrong)
        assert plain.sent == [wrong]


def test_the_failure_of_the_bus_is_raised_as_it_is(plain, clock, monkeypatch):
    failure = can.CanOperationError("down")

    def fails(*_arguments, **_how):
        raise failure

    with faulty(plain, clock, "repeat any") as bus:
        monkeypatch.setattr(plain, "send", fails)
        monkeypatch.setattr(plain, "recv", fails)
        for call in (lambda: bus.send(message(1)), lambda: bus.recv(timeout=0)):
            with pytest.raises(can.CanOperationError) as raised:
                call()
            assert raised.value is failure
