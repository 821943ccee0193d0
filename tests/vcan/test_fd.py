"""Bulk records in CAN FD frames on real SocketCAN."""

import socket

import pytest

from cutgate.config.bus import has_socketcan, open_bus
from cutgate.protocol.endpoint import Endpoint, RecordReceived
from cutgate.protocol.path import Assembly, split
from cutgate.protocol.port import Port
from cutgate.protocol.records import BlockStored, Side
from tests.protocol.sessions import DIGEST, KEY

pytestmark = [
    pytest.mark.processes,
    pytest.mark.skipif(not has_socketcan(), reason="the kernel has no vcan0"),
]

PATH = bytes(range(256)) * 80  # 1022 poses of no path
WAIT_S = 20.0


def side(which, bus, seen):
    endpoint = Endpoint(which, KEY, heartbeat_s=0.02, timeout_s=0.1, transfer_timeout_s=WAIT_S, fd=True)
    endpoint.use_session(DIGEST)
    return Port(bus, endpoint, seen.append)


def test_a_socket_opened_with_fd_asks_the_kernel_for_fd_frames():
    for fd in (False, True):
        with open_bus("socketcan", "vcan0", fd=fd) as bus:
            asked = bus.socket.getsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES)
            assert bool(asked) is fd


def test_an_upload_in_frames_of_64_bytes_arrives_whole():
    seen, assembly = [], Assembly()
    with open_bus("socketcan", "vcan0", fd=True) as one, open_bus("socketcan", "vcan0", fd=True) as other:
        runtime, controller = side(Side.RUNTIME, one, seen), side(Side.CONTROLLER, other, [])
        for block in split(PATH):
            runtime.endpoint.send_record(block, 0.0)
        turns = 0
        while not assembly.complete:
            runtime.flush()
            for item in controller.read(0.0):
                assert isinstance(item, RecordReceived)
                assembly = assembly.add(item.record)
                controller.endpoint.send_record(BlockStored(item.record.index), 0.0)
            controller.flush()
            runtime.read(0.0)
            turns += 1
            assert turns < 1000
    assert assembly.data == PATH
    assert all(passed.is_fd and passed.bit_rate_switch for passed in seen)
    assert max(len(passed.data) for passed in seen) == 64
