"""What one test has started: a bus, a controller, a runtime; how it ended, and what is kept of it."""

import json
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Self

import can

from cutgate.config.bus import LOCAL_INTERFACE, open_bus
from cutgate.config.interpreter import program
from cutgate.config.screen import printable
from cutgate.firmware_sim.bus.ask import counts, let_err
from cutgate.firmware_sim.console import ConsoleCommand
from cutgate.firmware_sim.fault_language import Fault, MessageFault, parse_fault
from cutgate.firmware_sim.faulty_bus import FaultyBus
from cutgate.firmware_sim.hil import health
from cutgate.firmware_sim.hil.child import WAIT_S, HilProcess, HilTimeoutError, environment
from cutgate.firmware_sim.hil.health import HealthFinding
from cutgate.firmware_sim.hil.hub import hub_process
from cutgate.firmware_sim.hil.inputs import HilFiles
from cutgate.firmware_sim.hil.kept import REPORT_S
from cutgate.protocol.wire import Side

TIME_SCALE: Final = 30.0
"""At which the short path takes about a second."""


@dataclass
class HilBus:
    """A virtual bus of its own; every frame on it is written to ``candump``."""

    channel: str
    candump: Path
    interface: str = LOCAL_INTERFACE
    _opened: list[can.BusABC] = field(default_factory=list)

    def open(self, *faults: str | MessageFault, side: Side = Side.CONTROLLER, fd: bool = False) -> can.BusABC:
        """One more node on it, closed after the test; with faults in between, both ways.

        Args:
            *faults: lines of the fault language, of messages alone.
            side: whose node it is, where there are faults.
            fd: whether CAN FD frames are sent and received.
        """
        bus = open_bus(self.interface, self.channel, fd=fd)
        self._opened.append(bus)
        read = [parse_fault(one) if isinstance(one, str) else one for one in faults]
        if not read:
            return bus
        wrong = [str(one) for one in read if not isinstance(one, MessageFault)]
        if wrong:
            raise ValueError(f"{wrong[0]} is a fault of the simulated controller, no bus has it")
        faulty = FaultyBus(bus, (one for one in read if isinstance(one, MessageFault)), side=side)
        self._opened.append(faulty)
        return faulty

    def inject(self, error: str, **of: int) -> str:
        """Let errors of the wire come, on a bus that has one (``cutgate_wire``); what the hub answers.

        Args:
            error: which one, as ``cutgate bus inject`` names it.
            **of: ``identifier``, ``sender``, ``receiver``, ``skip``, ``count``, as there.

        Raises:
            ValueError: the hub refuses; the text says why.
        """
        answer = let_err(Path(self.channel), {"error": error, **of})
        if answer.startswith("refused"):
            raise ValueError(answer)
        return answer

    def counts(self) -> dict[str, Any]:
        """What the hub has counted since it began, as ``cutgate bus stat --json`` prints it."""
        return counts(Path(self.channel))

    def close(self) -> None:
        """Every node that was opened here leaves."""
        for bus in reversed(self._opened):
            bus.shutdown()
        self._opened.clear()


@dataclass
class HilSession:
    """A session of our runtime.

    Attributes:
        process: the runtime; type operator commands at it, expect its lines.
        logs: the folder of its audit log.
    """

    process: HilProcess
    logs: Path

    def permitted(self, timeout_s: float = WAIT_S) -> Self:
        """Wait until it says that it has permitted the cut. Raises HilTimeoutError where it does not."""
        __tracebackhide__ = True
        self.process.expect("permitted:", timeout_s)
        return self

    def ended(self, timeout_s: float = WAIT_S) -> int:
        """Wait for its end: 0 cut completed, 1 not admitted, 2 refused input, 3 stopped or fault."""
        return self.process.exit_code(timeout_s)

    @property
    def document(self) -> dict[str, Any] | None:
        """What ``cutgate run --json`` printed at its end; None where it printed nothing whole."""
        try:
            read = json.loads(self.process.document)
        except ValueError:
            return None
        return read if isinstance(read, dict) else None

    @property
    def cause(self) -> str:
        """The cause of its stop; NONE for a cut that was completed, empty before its end."""
        return str((self.document or {}).get("cause", ""))

    @property
    def log(self) -> Path | None:
        """The session's log; None where none was begun."""
        return max(self.logs.glob("*.mcap"), key=lambda path: path.stat().st_ctime_ns, default=None)

    @property
    def summary(self) -> str:
        """How it ended, in a few words."""
        document = self.document
        if document is None:
            return "running" if self.process.running else "no session"
        cause = document.get("cause")
        return str(document.get("outcome")) + ("" if cause in (None, "NONE") else f" {cause}")


class HilOperator:
    """The persons at both terminals: what they type goes to the session, or to the simulated controller, of this test."""

    def __init__(self, rig: "HilRig") -> None:
        self._rig = rig

    def type(self, command: str) -> None:
        """One operator command, at the terminal that knows it; anything else at the runtime's."""
        at_controller = command in frozenset(map(str, ConsoleCommand))
        process = self._rig.controller_process if at_controller else self._rig.runtime_process
        process.type(command)

    def start(self) -> None:
        """Wait for the permit, hold the enabling device, say start, and wait until that is sent."""
        __tracebackhide__ = True
        runtime = self._rig.runtime_process
        runtime.expect("permitted:")
        self.type(ConsoleCommand.HOLD)
        runtime.expect("enabling device is held")
        self.type("start")
        runtime.expect("start sent$")

    def cut(self) -> None:
        """As ``start``, and wait until the controller says that it cuts."""
        __tracebackhide__ = True
        self.start()
        self._rig.runtime_process.expect("cutting$")


class HilClock:
    """Real time."""

    def now_s(self) -> float:
        """Monotonic seconds."""
        return time.monotonic()

    def until(self, condition: Callable[[], object], timeout_s: float = WAIT_S) -> None:
        """Wait until it holds, asked a hundred times a second. Raises HilTimeoutError where it does not in time."""
        until_s = self.now_s() + timeout_s
        while not condition():
            if self.now_s() > until_s:
                raise HilTimeoutError(f"the condition did not hold within {timeout_s:g} s")
            time.sleep(0.01)


class HilRig:
    """Everything that one test has started, ended with it.

    Args:
        folder: of the test, new and empty; logs, frames and what the programs said are kept there.
        files: what sessions read.
        faults: of the test's markers.
        wire: how the bus is served, as ``cutgate bus serve`` takes it; without it frames are carried at once.

    Attributes:
        faults_used: those that a controller was started with.
        findings: what the health check has found, once the rig is closed.
    """

    def __init__(
        self, folder: Path, files: HilFiles, faults: Sequence[Fault], wire: Sequence[str] = ()
    ) -> None:
        self.folder, self.files, self.faults, self.wire = folder, files, tuple(faults), tuple(wire)
        self.sessions: list[HilSession] = []
        self.controllers: list[HilProcess] = []
        self.faults_used: list[Fault] = []
        self.findings: list[HealthFinding] = []
        self.operator = HilOperator(self)
        self._bus: HilBus | None = None
        self._stack = ExitStack()
        self._closed = False

    # ------------------------------------------------------------ what tests start

    @property
    def bus(self) -> HilBus:
        """The bus of this test; its hub is started when it is first asked for."""
        if self._bus is None:
            # Not in the test's folder: a socket's path has at most 107 bytes.
            place = self._stack.enter_context(tempfile.TemporaryDirectory(prefix="cutgate-"))
            path, candump = Path(place) / "bus.sock", self.folder / "bus.candump.log"
            self._stack.enter_context(hub_process(path, *self.wire, log=candump))
            self._bus = HilBus(str(path), candump)
        return self._bus

    def controller(
        self,
        *faults: str | Fault,
        time_scale: float = TIME_SCALE,
        joints: str | None = None,
        fd: bool = False,
        more: Sequence[str] = (),
    ) -> HilProcess:
        """Start the simulated controller, with the faults of the markers and these, and wait until it is on the bus.

        Args:
            *faults: lines of the fault language.
            time_scale: the plant's seconds in one of the clock.
            joints: where the arm stands, q0,q1,q2,q3,q4 in deg and mm; None as ``cutgate_files`` says.
            fd: bulk records in CAN FD frames.
            more: further options of ``cutgate sim``.
        """
        stands = self.files.joints if joints is None else joints
        chosen = [parse_fault(one) if isinstance(one, str) else one for one in (*self.faults, *faults)]
        self.faults_used += [one for one in chosen if one not in self.faults_used]
        options = ["--robot", str(self.files.robot), "--key", str(self.files.key)]
        options += ["--time-scale", f"{time_scale:g}", *self._where, *["--fd"] * fd]
        options += [] if stands is None else [f"--joints={stands}"]
        options += [part for one in chosen for part in ("--fault", str(one))]
        process = self._start("controller", program("cutgate.firmware_sim", "sim", *options, *more))
        self.controllers.append(process)
        process.expect("enabling device released")
        return process

    def session(
        self, files: HilFiles | None = None, *, fd: bool = False, more: Sequence[str] = ()
    ) -> HilSession:
        """Start our runtime on this test's bus.

        Args:
            files: what it reads; None as ``cutgate_files`` says.
            fd: bulk records in CAN FD frames.
            more: further options of ``cutgate run``.
        """
        chosen = files or self.files
        logs = self.folder / f"logs-{len(self.sessions) + 1}" if self.sessions else self.folder / "logs"
        options = ["--robot", str(chosen.robot), "--registration", str(chosen.registration)]
        options += ["--site", str(chosen.site), "--key", str(chosen.key), "--log-dir", str(logs), "--json"]
        command = program("cutgate.runtime.cli", "run", str(chosen.plan), *options, *self._where)
        session = HilSession(self._start("runtime", [*command, *["--fd"] * fd, *more], document=True), logs)
        self.sessions.append(session)
        return session

    @property
    def controller_process(self) -> HilProcess:
        """The simulated controller that was started last. Raises LookupError without one."""
        if not self.controllers:
            raise LookupError("no simulated controller was started: ask for the fixture cutgate_controller")
        return self.controllers[-1]

    @property
    def runtime_process(self) -> HilProcess:
        """The runtime that was started last. Raises LookupError without one."""
        if not self.sessions:
            raise LookupError(
                "no session was started: ask for the fixture cutgate_session or cutgate_runtime"
            )
        return self.sessions[-1].process

    @property
    def _where(self) -> list[str]:
        return ["--interface", self.bus.interface, "--channel", self.bus.channel]

    def _start(self, name: str, command: Sequence[str], *, document: bool = False) -> HilProcess:
        process = HilProcess(name, command, environment(self.folder / "state"), document=document)
        self._stack.callback(process.end)
        return process

    # ------------------------------------------------------------ the end, and what was healthy

    def close(self) -> None:
        """End everything, the last first, and judge the sessions. Once is enough."""
        if self._closed:
            return
        self._closed = True
        ended = [
            HealthFinding("controller-ended", one.told[-500:]) for one in self.controllers if not one.running
        ]
        unfinished = [session.process.running for session in self.sessions]
        if self._bus is not None:
            self._bus.close()
        self._stack.close()
        for number, process in enumerate((*self.controllers, *(one.process for one in self.sessions))):
            (self.folder / f"{number}-{process.name}.txt").write_text(process.told + "\n", encoding="utf-8")
        self.findings = ended
        for session, running in zip(self.sessions, unfinished, strict=True):
            self.findings += _judged(session, unfinished=running)

    @property
    def summary(self) -> str:
        """How the sessions of this test ended."""
        return ", ".join(session.summary for session in self.sessions)

    @property
    def logs(self) -> list[Path]:
        """Of the sessions of this test."""
        return [log for session in self.sessions if (log := session.log) is not None]


def _judged(session: HilSession, *, unfinished: bool) -> list[HealthFinding]:
    """What the session's outcome and its log say."""
    findings = health.of_outcome(session.document, None if unfinished else session.ended())
    log = session.log
    if log is None:
        return findings
    return health.but_the_tests_end([*findings, *_of_log(log)], unfinished=unfinished)


def _of_log(log: Path) -> list[HealthFinding]:
    """What the runtime's own programs find in the log: whether it is whole, and its records."""
    judged = _printed("audit", "verify", str(log), "--json")
    records = _printed("audit", "export", str(log), "--to", "jsonl")
    try:
        reasons = json.loads(judged)["reasons"]
        read = [json.loads(line) for line in records.splitlines()]
    except (ValueError, KeyError):  # no whole document, or one of a file that cannot be read
        return [HealthFinding("log", f"it cannot be read: {printable((judged or records)[-500:])}")]
    return health.of_log(reasons, [(record["topic"], record["data"]) for record in read])


def _printed(*arguments: str) -> str:
    """What one of the runtime's programs prints about a log; whatever it has to say where it fails."""
    try:
        done = subprocess.run(  # noqa: S603 - our own program
            program("cutgate.runtime.cli", *arguments),
            capture_output=True,
            text=True,
            check=False,
            timeout=REPORT_S,
        )
    except subprocess.TimeoutExpired:
        return f"{' '.join(arguments[:2])} did not end within {REPORT_S:g} s"
    return done.stdout or done.stderr
