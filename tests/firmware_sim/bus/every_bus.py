"""What a program may rely on, whatever bus it has: one suite for python-can's own, for ours and for the kernel's."""

import threading
from itertools import pairwise
from pathlib import Path

import can
import pytest

from cutgate.config.load import load_robot
from cutgate.config.records import limits_record
from cutgate.protocol.endpoint import Endpoint, RecordReceived
from cutgate.protocol.port import Port
from cutgate.protocol.records import Side
from tests.protocol.sessions import DIGEST, KEY

WAIT_S = 20.0
QUIET_S = 0.05
"""So long is waited where nothing must come."""


def frame(number=1, data=b"", **options):
    return can.Message(arbitration_id=number, data=data, is_extended_id=False, **options)


def received(bus, count):
    got = []
    while len(got) < count:
        message = bus.recv(WAIT_S)
        assert message is not None, f"{len(got)} of {count} frames"
        got.append(message)
    return got


class BusSuite:
    """A subclass has a fixture ``join`` that opens one more bus on the same wire, with python-can's options."""

    threads = True
    """Whether one thread may send while another receives."""

    def test_a_frame_reaches_every_other_and_not_its_sender(self, join):
        buses = [join() for _ in range(3)]
        buses[0].send(frame(0x123, b"abc"))
        for other in buses[1:]:
            (got,) = received(other, 1)
            assert (got.arbitration_id, bytes(got.data)) == (0x123, b"abc")
        assert buses[0].recv(QUIET_S) is None

    def test_own_frames_come_back_where_they_are_asked_for(self, join):
        bus, _other = join(receive_own_messages=True), join()
        bus.send(frame(0x10))
        assert received(bus, 1)[0].arbitration_id == 0x10

    @pytest.mark.parametrize(
        "message",
        [
            frame(0x7FF, bytes(range(8))),
            frame(0),
            can.Message(arbitration_id=0x1FFFFFFF, is_extended_id=True, data=b"\x01"),
            can.Message(arbitration_id=0x5, is_extended_id=False, is_remote_frame=True, dlc=8),
            frame(0x1, bytes(64), is_fd=True, bitrate_switch=True),
            frame(0x1, bytes(range(12)), is_fd=True),
        ],
    )
    def test_a_frame_arrives_as_it_was_sent(self, join, message):
        sender, receiver = join(fd=True), join(fd=True)
        sender.send(message)
        (got,) = received(receiver, 1)
        assert got.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)

    def test_frames_of_one_sender_arrive_complete_and_in_order(self, join):
        sender, receiver = join(), join()
        sent = [frame(index % 0x700, index.to_bytes(4, "big")) for index in range(300)]
        if self.threads:
            thread = threading.Thread(
                target=lambda: [sender.send(message, timeout=WAIT_S) for message in sent]
            )
            thread.start()
            got = received(receiver, len(sent))
            thread.join(WAIT_S)
        else:
            got = []
            for message in sent:
                sender.send(message)
                got += received(receiver, 1)
        assert [(m.arbitration_id, bytes(m.data)) for m in got] == [
            (m.arbitration_id, bytes(m.data)) for m in sent
        ]
        assert all(one.timestamp <= two.timestamp for one, two in pairwise(got))

    def test_filters_leave_out_what_they_do_not_name(self, join):
        sender, receiver = join(), join(can_filters=[{"can_id": 2, "can_mask": 0x7FF, "extended": False}])
        for number in (1, 2, 3, 2):
            sender.send(frame(number, bytes([number])), timeout=WAIT_S)
        assert [m.arbitration_id for m in received(receiver, 2)] == [2, 2]
        assert receiver.recv(QUIET_S) is None

    def test_recv_gives_up_in_time(self, join):
        bus = join()
        assert bus.recv(0) is None
        assert bus.recv(QUIET_S) is None

    def test_who_has_left_disturbs_nobody(self, join):
        one, two, gone = join(), join(), join()
        gone.shutdown()
        one.send(frame(7))
        assert received(two, 1)[0].arbitration_id == 7

    @pytest.mark.parametrize("fd", [False, True])
    def test_a_record_crosses_it_with_flow_control_and_all(self, join, fd):
        buses = {side: join(fd=fd) for side in Side}
        now_s, ports = 0.0, {}
        for side, bus in buses.items():
            endpoint = Endpoint(side, KEY, heartbeat_s=0.02, timeout_s=0.1, transfer_timeout_s=WAIT_S, fd=fd)
            endpoint.use_session(DIGEST)
            ports[side] = Port(bus, endpoint)
        record = limits_record(load_robot(Path("example")).value)
        ports[Side.CONTROLLER].endpoint.send_record(record, now_s)
        whole = []
        for _ in range(2000):
            ports[Side.CONTROLLER].flush()
            whole += [item for item in self.read(ports[Side.RUNTIME]) if isinstance(item, RecordReceived)]
            ports[Side.RUNTIME].flush()
            self.read(ports[Side.CONTROLLER])
            if whole:
                break
        assert whole[0].record == record

    def read(self, port):
        """What comes, waited for a little."""
        message = port.bus.recv(0.005)
        if message is None:
            return []
        items = port.endpoint.receive(
            message.arbitration_id,
            bytes(message.data),
            is_extended=message.is_extended_id,
            is_fd=message.is_fd,
            now_s=0.0,
        )
        return [*items, *port.read(0.0)]
