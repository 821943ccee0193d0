"""The negative suite, one case at a time, for a controller that tests name."""

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import can
import pytest

from cutgate.config.key import load_key
from cutgate.config.load import load_site
from cutgate.config.model import Site
from cutgate.config.refusal import InputError
from cutgate.runtime.commands.conform import approved_records, bench_on, open_unused_bus
from cutgate.runtime.commands.in_virtual_time import BusInVirtualTime
from cutgate.runtime.conform.bench import Bench
from cutgate.runtime.conform.failures import HaltError
from cutgate.runtime.conform.suite import CaseVerdict, Result, Suite
from cutgate.runtime.conform.table import cases

NAMES: Final = tuple(case.name for case in cases())
"""Of all cases, in their order."""


def bench_in(virtual: BusInVirtualTime) -> Bench:
    """In front of a controller on a bus in virtual time: a conversation to any place, and the negative suite's."""
    settings = load_site(virtual.site).value if virtual.site else Site()
    bus = virtual.open("tester")
    return bench_on(
        bus,
        load_key(virtual.key),
        settings,
        fd=False,
        clock=virtual.now_s,
        wait=partial(virtual.wait, bus),
        random=virtual.random,
    )


@dataclass(frozen=True)
class ConformTarget:
    """A controller under test. Its plant is disconnected: axes and cutter have no power.

    Attributes:
        interface, channel: its bus, as python-can names them.
        key: its pre-shared key.
        robot: the approved robot.toml, which it must report; None leaves that case out.
        site: heartbeat, time-out and reply time; None for the defaults.
        fd: bulk records in CAN FD frames.
    """

    interface: str
    channel: str
    key: Path
    robot: Path | None = None
    site: Path | None = None
    fd: bool = False


class ConformSuite:
    """The suite in front of one controller, for as long as the tests of a process last.

    Args:
        bench: the conversation with it.
        robot: the approved robot.toml, which it must report; None leaves that case out.

    Raises:
        InputError: the robot file is refused, or no controller is heard.
    """

    def __init__(self, bench: Bench, robot: Path | None = None) -> None:
        self._cases = {case.name: case for case in cases(approved_records(robot))}
        self._approves = robot is not None
        self._suite = Suite(bench)
        try:
            bench.hello()
        except HaltError as error:
            raise InputError("bus", "", None, str(error), "start the controller, then the tests") from None

    def judge(self, name: str) -> Result | None:
        """What came of a case; None for one that needs the approved robot file, where there is none."""
        case = self._cases[name]
        if case.approved and not self._approves:
            return None
        return self._suite.judge(case)


@contextmanager
def in_front_of(target: ConformTarget) -> Iterator[ConformSuite]:
    """The suite in front of a controller on a bus; whatever ends it, the controller is told to stop.

    Raises:
        InputError: key, files or bus are refused, a session is under way, or no controller is heard.
    """
    settings = load_site(target.site).value if target.site else Site()
    key, rate = load_key(target.key), settings.bus.bitrate_bit_s
    bus = open_unused_bus(target.interface, target.channel, fd=target.fd, bitrate_bit_s=rate)
    try:
        bench = bench_on(bus, key, settings, fd=target.fd)
        yield ConformSuite(bench, target.robot)
        with suppress(can.CanError):
            bench.stop_now()
    finally:
        bus.shutdown()


class ConformCase:
    """One case of the suite, as a test calls it.

    Args:
        suite: in front of the controller.
        name: of the case.
    """

    def __init__(self, suite: ConformSuite, name: str) -> None:
        self._suite, self.name = suite, name

    def __call__(self) -> Result:
        """Run it: returns what came where it has passed, fails the test or skips it otherwise."""
        begun_s = time.monotonic()
        result = self._suite.judge(self.name)
        if result is None:
            pytest.skip("NOT RUN: needs the approved robot file; name it with --cutgate-robot")
        if result.verdict is CaseVerdict.NOT_RUN:
            pytest.skip(f"NOT RUN: {result.came.removeprefix('not run: ')}")
        if result.verdict is CaseVerdict.FAIL:
            case = result.case
            pytest.fail(
                f"FAIL: {case.name} (docs/protocol.md: {case.requirement})\n  sent      {case.sent}\n"
                f"  expected  {case.expected}\n  came      {result.came}\n"
                f"  after     {time.monotonic() - begun_s:.1f} s",
                pytrace=False,
            )
        return result
