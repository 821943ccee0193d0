"""The negative suite, one case at a time, for a controller that tests name."""

import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

import can
import pytest

from cutgate.config.key import load_key
from cutgate.config.load import load_site
from cutgate.config.model import Site
from cutgate.config.refusal import InputError
from cutgate.runtime.commands.conform import approved_records, bench_on, open_unused_bus
from cutgate.runtime.conform.failures import HaltError
from cutgate.runtime.conform.suite import CaseVerdict, Result, Suite
from cutgate.runtime.conform.table import cases

NAMES: Final = tuple(case.name for case in cases())
"""Of all cases, in their order."""


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
        target: which controller.

    Raises:
        InputError: key, files or bus are refused, a session is under way, or no controller is heard.
    """

    def __init__(self, target: ConformTarget) -> None:
        settings = load_site(target.site).value if target.site else Site()
        self._cases = {case.name: case for case in cases(approved_records(target.robot))}
        self._approves = target.robot is not None
        key = load_key(target.key)
        rate = settings.bus.bitrate_bit_s
        self._bus = open_unused_bus(target.interface, target.channel, fd=target.fd, bitrate_bit_s=rate)
        self._bench = bench_on(self._bus, key, settings, fd=target.fd)
        self._suite = Suite(self._bench)

    def __enter__(self) -> Self:
        try:
            self._bench.hello()
        except HaltError as error:
            self._bus.shutdown()
            raise InputError("bus", "", None, str(error), "start the controller, then the tests") from None
        return self

    def __exit__(self, *_error: object) -> None:
        with suppress(can.CanError):  # whatever ended the tests, the controller is told to stop
            self._bench.stop_now()
        self._bus.shutdown()

    def judge(self, name: str) -> Result | None:
        """What came of a case; None for one that needs the approved robot file, where there is none."""
        case = self._cases[name]
        if case.approved and not self._approves:
            return None
        return self._suite.judge(case)


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
