"""Fixtures of the bus tests."""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import can
import pytest

from cutgate.firmware_sim.hil.hub import virtual_bus

__all__ = ["virtual_bus"]


@pytest.fixture
def place() -> Iterator[Path]:
    """A directory short enough for a socket's path."""
    with tempfile.TemporaryDirectory(prefix="cutgate-") as directory:
        yield Path(directory)


@pytest.fixture
def join() -> Iterator[Callable[..., can.BusABC]]:
    """Opens a bus the way every python-can program does; closed after the test."""
    with ExitStack() as stack:

        def open_one(path: Path, **options: object) -> can.BusABC:
            bus = can.Bus(interface="cutgate", channel=str(path), ignore_config=True, **options)
            stack.callback(bus.shutdown)
            return bus

        yield open_one
