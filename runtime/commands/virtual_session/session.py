"""A session of our runtime on a bus in virtual time: the loop, the tables, the verification and the log that a cut has.

Nothing runs beside it: the verification is done when it is asked for, and the disk is waited for, while no time passes.
"""

import os
from contextlib import ExitStack, suppress
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any, Final, Self

import can

from cutgate.config.exits import STOPPED
from cutgate.config.key import load_key
from cutgate.config.signals import wake_pipe
from cutgate.config.terminal import CommandReader
from cutgate.protocol.codes import fingerprint
from cutgate.runtime.audit.commit import InTurn
from cutgate.runtime.audit.log import Clock, Paths
from cutgate.runtime.audit.log_keys import new_log_key
from cutgate.runtime.audit.reading import reading
from cutgate.runtime.commands.in_virtual_time import BenchInVirtualTime, InputPaths, LogRead
from cutgate.runtime.commands.session_view import run_document, stopped
from cutgate.runtime.commands.virtual_session.in_place import VerifierInPlace, WitnessInPlace
from cutgate.runtime.interlock.phases import ENDED, ENDINGS, PHASES, STOPPING
from cutgate.runtime.interlock.state import (
    DeviceCycle,
    Effect,
    Event,
    Interlock,
    OperatorCommand,
    Phase,
    Refused,
)
from cutgate.runtime.session.check import Answer, Check
from cutgate.runtime.session.conduct import Given, put_together
from cutgate.runtime.session.job import make_job, read_files
from cutgate.runtime.session.new_log import new_log
from cutgate.runtime.session.withdrawal import listed_before
from cutgate.runtime.session.withdrawn import refusal
from cutgate.runtime.verification.advice import Guidance
from cutgate.runtime.verification.asked import BEST

BUS_NAME: Final = "virtual time/runtime"
END_S: Final = 10.0
"""So much time passes at most until a session that a test leaves running has come to its end."""


class Lines:
    """What the operator would read: one line for each phase, refusal and note."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def step(
        self, before: Interlock, _event: Event, after: Interlock, effects: tuple[Effect, ...], _now_s: float
    ) -> None:
        """One step of the interlock."""
        self.lines += [f"{one.command} refused: {one.reason}" for one in effects if isinstance(one, Refused)]
        announced = PHASES[after.phase].announced
        if after.phase is not before.phase and announced:
            reason = f": {after.reason}" if after.phase in STOPPING else ""
            self.lines.append(announced + reason)

    def verdict(self, answer: Answer) -> None:
        """The verdict."""
        self.lines.append(str(answer.document["verdict"]))

    def guidance(self, found: Guidance | None, note: str) -> None:
        """Where to move the bone."""
        self.lines.append(note if found is None else str(found))

    def progress(self, segment: int, segments: int) -> None:
        """The controller is on this segment: nothing is said of it."""

    def note(self, text: str) -> None:
        """One line."""
        self.lines.append(text)


class VirtualSession:
    """A session that has begun, on a bus in virtual time.

    Args:
        virtual: the bus.
        files: what it reads; None as the bus's tests say.
        fd: bulk records in CAN FD frames.

    Attributes:
        lines: what the operator would have read.
        log: its audit log.

    Raises:
        InputError: a file is refused; no session has begun.
    """

    def __init__(
        self, virtual: BenchInVirtualTime, files: InputPaths | None = None, *, fd: bool = False
    ) -> None:
        paths = files or virtual.files
        read = read_files(paths.plan, paths.robot, paths.registration, paths.site, None)
        secret = load_key(paths.key)
        now = datetime.fromtimestamp(virtual.utc_ns() / 1e9, UTC)
        job = make_job(read, now=now, key_fingerprint=fingerprint(secret))
        number = len(virtual.sessions) + 1
        directory = virtual.folder / (f"logs-{number}" if number > 1 else "logs")
        directory.mkdir()
        log_key, log_id = virtual.folder / f"{directory.name}.key", virtual.random(16)
        new_log_key(log_key)
        log = new_log(
            directory,
            read,
            job.path,
            BUS_NAME,
            BEST,
            None,
            log_id=log_id,
            log_key=log_key,
            clock=Clock(virtual.utc_ns, virtual.monotonic_ns),
            committer=InTurn,
        )
        listed = listed_before(log)
        against = refusal(listed, read.prepared.digests, read.registration, read.settings.clock_skew_s)
        bus = virtual.open("runtime", fd=fd)
        self._view, self._virtual, self._paths = (
            Lines(),
            virtual,
            Paths(log.path, log.candump_path, False, ""),
        )
        self.lines, self.log = self._view.lines, log.path
        self._stack = ExitStack()
        terminal, self._typing = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._wake, writing = wake_pipe()
        for descriptor in (terminal, self._typing, self._wake, writing):
            self._stack.callback(os.close, descriptor)
        check = Check(job, read.prepared.robot, read.placed)
        self._conducted = put_together(
            Given(
                read,
                check,
                Interlock(replace(job, withdrawal=against)),
                secret,
                bus,
                BUS_NAME,
                log,
                log_id,
                listed,
                fd,
            ),
            self._view,
            VerifierInPlace(job.path),
            WitnessInPlace(directory),
            CommandReader(terminal, OperatorCommand),
            now=lambda: datetime.fromtimestamp(virtual.utc_ns() / 1e9, UTC),
            clock=virtual.now_s,
            random=virtual.random,
        )
        self._session = self._conducted.session
        self._conducted.begin()
        self._session.begin(self._wake)
        self._closed = False
        virtual.join(bus, self._turn, self._wait_s, self)

    # ------------------------------------------------------------ as it goes

    @property
    def phase(self) -> Phase:
        """Where it stands."""
        return self._session.state.phase

    def type(self, command: str) -> None:
        """A line at the runtime's terminal; it is heard in the next cycle."""
        os.write(self._typing, f"{command}\n".encode())

    def permitted(self, timeout_s: float = 20.0) -> Self:
        """Let time pass until the cut is permitted. Raises AssertionError where the session stops instead."""
        return self._reach(Phase.PERMITTED, timeout_s)

    def start(self) -> Self:
        """Wait for the permit, hold the enabling device of the simulated controller, say start."""
        self.permitted()
        self._until_device(DeviceCycle.RELEASED)
        self._virtual.type("hold")
        self._until_device(DeviceCycle.PRESSED)
        self.type("start")
        return self

    def cut(self, timeout_s: float = 20.0) -> Self:
        """As ``start``, and let time pass until the controller says that it cuts; raises as ``permitted``."""
        self.start()
        return self._reach(Phase.CUTTING, timeout_s)

    def ended(self, timeout_s: float = 600.0) -> int:
        """Let time pass until its end: 0 cut completed, 1 not admitted, 3 stopped or fault."""
        self._virtual.until(lambda: self.phase in ENDED, timeout_s)
        return self._close()

    # ------------------------------------------------------------ what has become of it

    @property
    def document(self) -> dict[str, Any] | None:
        """What ``cutgate run --json`` would print; None before its end."""
        if not self._closed:
            return None
        session = self._session
        return run_document(session.state, session.answer, self._paths, stopped(session))

    @property
    def cause(self) -> str:
        """The cause of its stop; NONE for a cut that was completed, empty before its end."""
        return str((self.document or {}).get("cause", ""))

    @property
    def summary(self) -> str:
        """How it ended, in a few words."""
        document = self.document
        if document is None:
            return f"running ({self.phase})"
        return str(document["outcome"]) + ("" if self.cause == "NONE" else f" {self.cause}")

    def close(self) -> int | None:
        """End it, by quitting where it still runs: its exit code; None where it did."""
        if self.phase in ENDED:
            return self._close()
        self._session.interrupt("")
        self._virtual.until(lambda: self.phase in ENDED, END_S)
        self._close()
        return None

    def read(self) -> LogRead:
        """Why its log is not whole, empty where it is; its records, each with its topic."""
        with reading(self.log) as log:
            return log.report.reasons, [
                (topic, record) for topic in sorted(log.topics) for record in log.one_by_one(topic)
            ]

    # ------------------------------------------------------------ its loop

    def _turn(self) -> None:
        if self.phase not in ENDED:
            self._session.run_cycle(self._session.ready(self._wake, 0.0))
        else:
            with suppress(can.CanError):  # last words that the bus had no room for; else silence says it
                self._conducted.port.flush()

    def _wait_s(self) -> float:
        return self._session.wait_s

    def _reach(self, phase: Phase, timeout_s: float) -> Self:
        self._virtual.until(lambda: self.phase in {phase, *STOPPING, *ENDED}, timeout_s)
        if self.phase is not phase:
            raise AssertionError(f"not {phase}, but {self.phase}: {self._session.state.reason}")
        return self

    def _until_device(self, cycle: DeviceCycle) -> None:
        self._virtual.until(lambda: self._session.state.device is cycle)

    def _close(self) -> int:
        if not self._closed:
            self._session.guidance(self._wake)
            self._paths = self._conducted.close(self._view, clean=True)
            self._closed = True
            self._stack.close()
        return ENDINGS[self.phase].exit_code if self._paths.closed else STOPPED
