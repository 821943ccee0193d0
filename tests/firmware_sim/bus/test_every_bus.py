"""The suite for every bus: python-can's `virtual`, the hub at once and at a wire's pace, and the bus in virtual time.

Real SocketCAN: tests/vcan/test_every_bus.py.
"""

import tempfile
from contextlib import ExitStack
from pathlib import Path
from uuid import uuid4

import can
import pytest

from cutgate.firmware_sim.bus.medium.bits import Rates
from cutgate.firmware_sim.bus.virtual_time import VirtualTime
from cutgate.firmware_sim.hil.hub import hub_process
from tests.firmware_sim.bus.every_bus import BusSuite


@pytest.fixture
def opened():
    """Closed after the test."""
    with ExitStack() as stack:
        yield lambda bus: stack.callback(bus.shutdown) and bus


class TestVirtualOfPythonCan(BusSuite):
    @pytest.fixture
    def join(self, opened):
        channel = str(uuid4())

        def one(*, fd=False, **options):
            protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
            return opened(can.Bus(interface="virtual", channel=channel, protocol=protocol, **options))

        return one


class Hub(BusSuite):
    arguments = ()

    @pytest.fixture(scope="class")
    @classmethod
    def hub(cls):
        """One for all tests of a class: each leaves it as it was."""
        with tempfile.TemporaryDirectory(prefix="cutgate-") as directory:
            path = Path(directory) / "bus.sock"
            with hub_process(path, *cls.arguments):
                yield path

    @pytest.fixture
    def join(self, hub, opened):
        return lambda **options: opened(
            can.Bus(interface="cutgate", channel=str(hub), ignore_config=True, **options)
        )


@pytest.mark.processes
class TestHubAtOnce(Hub):
    pass


@pytest.mark.processes
class TestHubOfAWire(Hub):
    arguments = ("--bitrate", "1M", "--fd", "5M")


class TestVirtualTime(BusSuite):
    threads = False

    @pytest.fixture
    def join(self, opened):
        time = VirtualTime(Rates(1_000_000, 5_000_000))
        count = iter(range(100))

        def one(*, can_filters=None, **options):
            bus = opened(time.join(f"node {next(count)}", **options))
            bus.set_filters(can_filters)
            return bus

        return one
