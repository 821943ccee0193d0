"""The suite for every bus, on real SocketCAN."""

from contextlib import ExitStack

import pytest

from cutgate.config.bus import SOCKETCAN_CHANNEL, LatchingSocketcanBus, has_socketcan
from tests.firmware_sim.bus.every_bus import BusSuite

pytestmark = [
    pytest.mark.processes,
    pytest.mark.skipif(not has_socketcan(), reason="the kernel has no vcan0"),
]


class TestSocketcan(BusSuite):
    @pytest.fixture
    def join(self):
        with ExitStack() as stack:

            def one(**options):
                bus = LatchingSocketcanBus(SOCKETCAN_CHANNEL, **options)
                stack.callback(bus.shutdown)
                return bus

            yield one
