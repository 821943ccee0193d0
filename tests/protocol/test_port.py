"""An endpoint on a bus: bounded reading, everything shown to the recorder, errors handed on."""

import can
import pytest

from cutgate.protocol import port as ports
from cutgate.protocol import records
from cutgate.protocol.endpoint import Endpoint
from cutgate.protocol.frames import IDS, ControllerHeartbeat, RuntimeHeartbeat
from cutgate.protocol.link import Discarded, Violation
from cutgate.protocol.port import READ_FRAMES_MAX, Passed, Port
from cutgate.protocol.records import Side
from cutgate.protocol.states import RuntimeCode, StopCause
from tests.protocol.sessions import DIGEST, KEY

NOW = 10.0
BEAT = RuntimeHeartbeat(RuntimeCode.INHIBIT, 0, StopCause.NONE)


class Bus:
    """What waits is read; what is sent is kept."""

    def __init__(self, *waiting):
        self.waiting = list(waiting)
        self.sent = []
        self.broken = False

    def recv(self, timeout):
        assert timeout == 0
        if self.broken:
            raise can.CanOperationError("gone")
        return self.waiting.pop(0) if self.waiting else None

    def send(self, message, timeout):
        assert timeout == 0
        if self.broken:
            raise can.CanOperationError("gone")
        self.sent.append(message)


def message(can_id, data=bytes(8), **flags):
    return can.Message(arbitration_id=can_id, data=data, **({"is_extended_id": False} | flags))


def port(*waiting, recorder=None):
    endpoint = Endpoint(Side.RUNTIME, KEY, heartbeat_s=0.02, timeout_s=0.1, transfer_timeout_s=1.0)
    return Port(Bus(*waiting), endpoint, recorder)


def test_what_waits_is_read_and_judged():
    made = port(message(0x123), message(IDS[ControllerHeartbeat]), message(IDS[RuntimeHeartbeat]))
    first, second = made.read(NOW)
    assert first == Discarded("no session")
    assert isinstance(second, Violation)
    assert made.read(NOW) == []


def test_a_turn_reads_a_bounded_number_of_frames():
    made = port(*[message(IDS[ControllerHeartbeat])] * (READ_FRAMES_MAX + 1))
    assert len(made.read(NOW)) == READ_FRAMES_MAX
    assert len(made.read(NOW)) == 1


def test_what_came_while_nobody_looked_is_thrown_away_and_counted(monkeypatch):
    seen = []
    made = port(*[message(IDS[RuntimeHeartbeat])] * 7, recorder=seen.append)
    monkeypatch.setattr(ports, "DISCARD_FRAMES_MAX", 5)
    assert made.discard() == 5
    assert made.discard() == 2
    assert len(seen) == 7


def test_everything_that_passes_is_shown_to_the_recorder():
    seen = []
    made = port(
        message(0x18FF0001, b"\1\2", is_extended_id=True),
        message(0x123, b"", is_remote_frame=True, dlc=2),
        message(0x124, bytes(12), is_fd=True),
        message(0x20, bytes(8), is_error_frame=True),
        recorder=seen.append,
    )
    made.read(NOW)
    made.endpoint.send_frame(BEAT, NOW)
    assert made.flush()
    sent = bytes(made.bus.sent[0].data)
    assert seen == [
        Passed("received", 0x18FF0001, b"\1\2", True, False, False, False),
        Passed("received", 0x123, b"", False, True, False, False),
        Passed("received", 0x124, bytes(12), False, False, False, True),
        Passed("received", 0x20, bytes(8), False, False, True, False),
        Passed("sent", IDS[RuntimeHeartbeat], sent, False, False, False, False),
    ]


def test_only_what_is_queued_is_sent():
    made = port()
    made.flush()
    assert made.bus.sent == []
    made.endpoint.send_frame(BEAT, NOW)
    assert made.flush()
    assert made.flush()
    assert [(m.arbitration_id, m.is_extended_id, m.is_fd) for m in made.bus.sent] == [
        (IDS[RuntimeHeartbeat], False, False)
    ]


def test_with_fd_bulk_frames_leave_with_bit_rate_switch_and_the_recorder_sees_it():
    seen = []
    made = Port(
        Bus(),
        Endpoint(Side.RUNTIME, KEY, heartbeat_s=0.02, timeout_s=0.1, transfer_timeout_s=1.0, fd=True),
        seen.append,
    )
    made.endpoint.send_frame(BEAT, NOW)
    made.endpoint.send_record(records.split(bytes(100))[0], NOW, session=1)
    assert made.flush()
    sent = [(m.arbitration_id, m.is_fd, m.bitrate_switch, len(m.data)) for m in made.bus.sent]
    assert sent == [(IDS[RuntimeHeartbeat], False, False, 8), (0x640, True, True, 64)]
    assert [(passed.is_fd, passed.bit_rate_switch) for passed in seen] == [(False, False), (True, True)]


def test_a_bus_that_fails_says_so_whatever_is_asked_of_it():
    seen = []
    made = port(recorder=seen.append)
    made.bus.broken = True
    made.endpoint.send_frame(BEAT, NOW)
    for act in (lambda: made.read(NOW), made.discard, made.flush):
        with pytest.raises(can.CanError):
            act()
    assert seen == []


def test_the_two_sides_understand_each_other_on_a_bus_of_python_can():
    def side(which):
        bus = can.Bus(interface="virtual", channel="test-port", ignore_config=True)
        made = Port(bus, Endpoint(which, KEY, heartbeat_s=0.02, timeout_s=0.1, transfer_timeout_s=1.0))
        made.endpoint.use_session(DIGEST)
        made.endpoint.open_link(NOW)
        return made

    runtime, controller = side(Side.RUNTIME), side(Side.CONTROLLER)
    try:
        runtime.endpoint.send_frame(BEAT, NOW)
        runtime.flush()
        (item,) = controller.read(NOW)
        assert item.frame.code is RuntimeCode.INHIBIT
        assert runtime.read(NOW) == []
    finally:
        runtime.bus.shutdown()
        controller.bus.shutdown()
