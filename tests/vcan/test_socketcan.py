"""The bus on real SocketCAN, where the kernel has `vcan0`."""

import os
import subprocess
import sys

import can
import pytest

from cutgate.config.bus import LatchingSocketcanBus, default_interface, has_socketcan, open_bus
from tests.vcan.interfaces import ip

pytestmark = [
    pytest.mark.processes,
    pytest.mark.skipif(not has_socketcan(), reason="the kernel has no vcan0"),
]

WAIT_S = 20.0
ECHO = """
from cutgate.config.bus import open_bus
with open_bus("socketcan", "vcan0") as bus:
    print("ready", flush=True)
    for _ in range(200):
        message = bus.recv(20.0)
        message.arbitration_id += 1
        bus.send(message, timeout=20.0)
"""


def frame(number, data=b"", **options):
    return can.Message(arbitration_id=number, data=data, is_extended_id=False, **options)


def test_vcan0_is_the_default_where_the_kernel_has_it():
    assert default_interface() == ("socketcan", "vcan0")
    assert not has_socketcan("nocan9")


def test_two_processes_exchange_frames_in_order():
    with (
        open_bus("socketcan", "vcan0") as bus,
        subprocess.Popen([sys.executable, "-c", ECHO], stdout=subprocess.PIPE, text=True) as echo,
    ):
        assert echo.stdout.readline() == "ready\n"
        for index in range(200):
            bus.send(frame(0x100, index.to_bytes(8, "big")))
            got = bus.recv(WAIT_S)
            assert (got.arbitration_id, int.from_bytes(got.data, "big")) == (0x101, index)
        assert echo.wait(WAIT_S) == 0


def test_a_burst_of_a_thousand_frames_waits_for_its_reader():
    with open_bus("socketcan", "vcan0") as sender, open_bus("socketcan", "vcan0") as receiver:
        assert isinstance(receiver, LatchingSocketcanBus)
        assert receiver.receive_buffer_bytes >= 1000 * 800 or os.geteuid() != 0
        count = 1000 if os.geteuid() == 0 else 100
        for index in range(count):
            sender.send(frame(0x200, index.to_bytes(8, "big")), timeout=WAIT_S)
        got = [receiver.recv(WAIT_S) for _ in range(count)]
        assert [int.from_bytes(m.data, "big") for m in got] == list(range(count))
        assert sender.recv(0) is None


def test_fd_frames_reach_only_a_bus_opened_with_fd():
    with (
        open_bus("socketcan", "vcan0", fd=True) as sender,
        open_bus("socketcan", "vcan0") as classic,
        open_bus("socketcan", "vcan0", fd=True) as flexible,
    ):
        sender.send(frame(1, bytes(64), is_fd=True, bitrate_switch=True))
        sender.send(frame(2))
        assert [flexible.recv(WAIT_S).arbitration_id for _ in range(2)] == [1, 2]
        assert classic.recv(WAIT_S).arbitration_id == 2


def test_an_interface_that_fails_raises_every_time_until_opened_anew(own_interface):
    with open_bus("socketcan", own_interface) as bus:
        ip("set", own_interface, "down")
        for _ in range(3):
            with pytest.raises(can.CanOperationError):
                bus.recv(WAIT_S)
        with pytest.raises(can.CanOperationError, match="not opened anew"):
            bus.send(frame(1))
    ip("set", own_interface, "up")
    with open_bus("socketcan", own_interface) as bus:
        bus.send(frame(1))
        assert bus.recv(0) is None
