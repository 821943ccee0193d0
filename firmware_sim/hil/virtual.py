"""Controller, runtime and script on a bus in virtual time: minutes of them take a moment, and the same one each time.

Nothing here is a process and nothing waits: time passes while the script reads from its bus with a time-out, or says so.
The runtime's side joins by itself (``join``): nothing of the simulated controller imports it.
"""

import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Final, Protocol

import can

from cutgate.config.key import load_key
from cutgate.config.load import load_robot, load_site
from cutgate.config.model import Site
from cutgate.config.records import calibration_record, limits_record, tool_record
from cutgate.firmware_sim import memory
from cutgate.firmware_sim.bus.medium.bits import Rates
from cutgate.firmware_sim.bus.virtual_time import NOT_PACED, VirtualTime, VirtualTimeBus
from cutgate.firmware_sim.command import joints_at_power_up
from cutgate.firmware_sim.console import ConsoleCommand
from cutgate.firmware_sim.fault_language import Fault, MessageFault, parse_fault
from cutgate.firmware_sim.faults import FaultSpec
from cutgate.firmware_sim.faulty_bus import FaultyBus
from cutgate.firmware_sim.hil import health
from cutgate.firmware_sim.hil.child import HilTimeoutError
from cutgate.firmware_sim.hil.health import HealthFinding
from cutgate.firmware_sim.hil.inputs import HilFiles
from cutgate.firmware_sim.loop import Options, Process
from cutgate.firmware_sim.state import Controller, Holdings, Identity
from cutgate.protocol.codes import fingerprint
from cutgate.protocol.endpoint import Endpoint
from cutgate.protocol.port import Port
from cutgate.protocol.states import ControllerState
from cutgate.protocol.wire import Side

CYCLE_S: Final = 0.005
"""So often a loop looks at everything, whether or not a frame has come."""
QUEUE_FRAMES: Final = 256
"""Of each node where frames take no time: nothing but a burst of a script's waits in it."""
TRANSFER_TIMEOUT_S: Final = 2.0
NONCE_BYTES: Final = 16


class RepeatableGenerator:
    """Random bytes that are the same in every run."""

    def __init__(self, seed: int) -> None:
        self._state = seed

    def __call__(self, size: int) -> bytes:
        """So many."""
        out = bytearray()
        while len(out) < size:
            self._state = (self._state * 6364136223846793005 + 1442695040888963407) % (1 << 64)
            out += (self._state >> 32).to_bytes(4, "big")
        return bytes(out[:size])


class VirtualController:
    """The simulated controller in virtual time.

    Attributes:
        process: its loop, with the table's state.
        lines: what it has shown to the person beside it.
    """

    def __init__(self, process: Process, lines: list[str]) -> None:
        self.process, self.lines = process, lines

    @property
    def state(self) -> ControllerState:
        """The controller's own, whatever it says on the bus."""
        return self.process.controller.state

    def type(self, command: str) -> None:
        """One operator command at its terminal. Raises ValueError for what is none."""
        self.process.act(ConsoleCommand(command))


class JoinedSession(Protocol):
    """A session of a runtime in virtual time, as the health check asks it."""

    @property
    def document(self) -> dict[str, Any] | None:
        """What ``run --json`` would print; None before its end."""

    @property
    def summary(self) -> str:
        """How it ended, in a few words."""

    @property
    def log(self) -> Path:
        """Its audit log."""

    def close(self) -> int | None:
        """End it: its exit code; None where the test has not brought it to its end."""

    def read(self) -> tuple[Iterable[str], Iterable[tuple[str, Mapping[str, Any]]]]:
        """Why its log is not whole, empty where it is; its records, each with its topic."""


class VirtualRig:
    """A bus and a clock of its own.

    Args:
        folder: where logs and the controller's memory are kept.
        files: what sessions read.
        faults: of the test's markers.
        rates: of the bus; without them frames take no time.
        queue_frames: frames that each node's transmit queue holds.

    Attributes:
        time: of everything on this bus.
        key, site: of the files, for whoever takes the runtime's place.
        random: bytes for him that are the same in every run.
        sessions: of a runtime that have joined; closed with this.
        faults_used: those that a controller was started with.
        findings: what the health check has found, once this is closed.
    """

    def __init__(
        self,
        folder: Path,
        files: HilFiles,
        faults: tuple[Fault, ...] = (),
        *,
        rates: Rates = NOT_PACED,
        queue_frames: int = QUEUE_FRAMES,
    ) -> None:
        self.time = VirtualTime(rates, queue_frames=queue_frames)
        self.folder, self.files, self._faults = folder, files, faults
        self.key, self.site = files.key, files.site
        self.random = RepeatableGenerator(2)
        self.sessions: list[JoinedSession] = []
        self.faults_used: list[Fault] = []
        self.findings: list[HealthFinding] = []
        self._began_utc_ns = (
            time.time_ns() // 1000 * 1000 - self.time.now_ns
        )  # whole microseconds, as logs hold
        self._controllers: list[VirtualController] = []
        self._buses: list[can.BusABC] = []
        self._stands_still = False
        self._closed = False

    # ------------------------------------------------------------ time

    def now_s(self) -> float:
        """Monotonic seconds of this bus."""
        return self.time.clock()

    def monotonic_ns(self) -> int:
        """The same in nanoseconds."""
        return self.time.now_ns

    def utc_ns(self) -> int:
        """The time of day: the computer's as this was made, and what has passed here since."""
        return self._began_utc_ns + self.time.now_ns

    def run(self, seconds: float) -> None:
        """Let so much time pass."""
        self.time.run(seconds)

    def until(self, condition: Callable[[], bool], timeout_s: float = 20.0) -> None:
        """Let time pass until it holds. Raises HilTimeoutError where it does not in time."""
        if not self.time.until(condition, timeout_s):
            raise HilTimeoutError(f"the condition did not hold within {timeout_s:g} s of virtual time")

    # ------------------------------------------------------------ who is on the bus

    def open(self, name: str = "script", *, fd: bool = False) -> VirtualTimeBus:
        """One more node, closed after the test; ``recv(timeout)`` lets time pass for everybody."""
        bus = self.time.join(name, fd=fd)
        self._buses.append(bus)
        return bus

    def controller(
        self,
        *faults: str | Fault,
        time_scale: float = 1.0,
        joints: str | None = None,
        fd: bool = False,
        dynamics: bool = False,
    ) -> VirtualController:
        """The simulated controller, with the faults of the markers and these.

        Args:
            *faults: lines of the fault language.
            time_scale: the plant's seconds in one of the clock.
            joints: where the arm stands, q0,q1,q2,q3,q4 in deg and mm; None as ``cutgate_files`` says.
            fd: bulk records in CAN FD frames.
            dynamics: the joints follow their command by drives with mass.
        """
        chosen = [parse_fault(one) if isinstance(one, str) else one for one in (*self._faults, *faults)]
        self.faults_used += [one for one in chosen if one not in self.faults_used]
        bus = self.open("controller", fd=fd)
        of_messages = [one for one in chosen if isinstance(one, MessageFault)]
        faulty = FaultyBus(bus, of_messages, clock=self.time.clock)
        self._buses.append(faulty)
        limits = limits_record(load_robot(self.files.robot).value)
        options = Options(
            time_scale,
            joints=joints_at_power_up(self.files.joints if joints is None else joints, limits),
            faults=tuple(one for one in chosen if isinstance(one, FaultSpec)),
            dynamics=dynamics,
        )
        lines: list[str] = []
        process = self._process(Port(faulty, self._endpoint(fd)), options, lines)
        faulty.controller_state = lambda: process.controller.state
        turn = lambda: None if self._stands_still else process.run_cycle()  # noqa: E731 - of one line
        self.time.add(bus, turn, lambda: CYCLE_S)
        self._controllers.append(VirtualController(process, lines))
        return self._controllers[-1]

    def type(self, command: str) -> None:
        """One operator command at the controller that was started last. Raises LookupError without one."""
        if not self._controllers:
            raise LookupError("no simulated controller was started: call cutgate_virtual.controller()")
        self._controllers[-1].type(command)

    def join(
        self,
        bus: can.BusABC,
        turn: Callable[[], None],
        wait_s: Callable[[], float],
        session: JoinedSession | None = None,
    ) -> None:
        """One more program on this bus: a controller of your own, or a runtime.

        Args:
            bus: of ``open``; a frame there wakes it.
            turn: one cycle of its loop.
            wait_s: so long it would wait after that if nothing arrives; it looks every 5 ms all the same.
            session: where it is a session of a runtime.
        """
        assert isinstance(bus, VirtualTimeBus)  # noqa: S101 - one that was opened here
        self.time.add(bus, turn, lambda: min(CYCLE_S, wait_s()))
        if session is not None:
            self.sessions.append(session)

    def wait(self, bus: can.BusABC, seconds: float) -> None:
        """Let time pass until this node has something to read, at most so long."""
        assert isinstance(bus, VirtualTimeBus)  # noqa: S101 - one that was opened here
        self.time.until(lambda: bool(bus.inbox), seconds)

    def close(self) -> None:
        """Sessions are ended and judged, then everybody leaves. Once is enough."""
        if self._closed:
            return
        self._closed = True
        for session in self.sessions:
            self.findings += _judged(session)
        for bus in reversed(self._buses):
            bus.shutdown()
        self._buses.clear()

    @property
    def summary(self) -> str:
        """How the sessions ended."""
        return ", ".join(session.summary for session in self.sessions)

    @property
    def logs(self) -> list[Path]:
        """Of the sessions."""
        return [session.log for session in self.sessions]

    def _process(self, port: Port, options: Options, lines: list[str]) -> Process:
        robot, key = load_robot(self.files.robot).value, load_key(self.files.key)
        holdings = Holdings(
            limits=limits_record(robot).body(),
            calibration=calibration_record(robot).body(),
            tool=tool_record(robot).body(),
        )
        random, memory_file = RepeatableGenerator(1), self.folder / "virtual-memory.json"
        return Process(
            Controller.powered_up(
                Identity("SIM-VIRTUAL", fingerprint(key)),
                holdings,
                memory.load(memory_file, now_us=0),
                random(NONCE_BYTES),
            ),
            port,
            memory_file,
            options=options,
            say=lines.append,
            clock=self.time.clock,
            random=random,
            sleep=self._sleep,
        )

    def _sleep(self, seconds: float) -> None:
        """The controller's loop stands still, everybody else goes on."""
        self._stands_still = True
        self.time.run(seconds)
        self._stands_still = False

    def _endpoint(self, fd: bool) -> Endpoint:
        site = load_site(self.files.site).value if self.files.site else Site()
        timing = site.timing
        return Endpoint(
            Side.CONTROLLER,
            load_key(self.files.key),
            heartbeat_s=timing.heartbeat_ms / 1000,
            timeout_s=timing.timeout_ms / 1000,
            transfer_timeout_s=TRANSFER_TIMEOUT_S,
            fd=fd,
        )


def _judged(session: JoinedSession) -> list[HealthFinding]:
    """End it; what its outcome and its log say."""
    code = session.close()
    reasons, records = session.read()
    findings = [
        *health.of_outcome(session.document, code),
        *health.of_log(list(reasons), records),
    ]
    return health.but_the_tests_end(findings, unfinished=code is None)
