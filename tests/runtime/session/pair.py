"""A runtime and a simulated controller, joined by a bus in memory, turned one after the other in virtual time.

Nothing here waits: the disk answers when the test says so, verification is done in place, both loops see one clock.
"""

import os
import select
import socket
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from typing import Any
from unittest import mock

import can

from cutgate.config.model import Robot
from cutgate.config.signals import wake_pipe
from cutgate.config.terminal import CommandReader
from cutgate.firmware_sim import memory
from cutgate.firmware_sim.console import ConsoleCommand as ConsoleWord
from cutgate.firmware_sim.faults import FaultSpec
from cutgate.firmware_sim.kinematics import as_joints
from cutgate.firmware_sim.loop import Options, Process
from cutgate.firmware_sim.state import Controller, Holdings, Identity, Memory
from cutgate.protocol import records
from cutgate.protocol.codes import fingerprint
from cutgate.protocol.endpoint import Endpoint, RecordReceived
from cutgate.protocol.frames import BULK_IDS, CONTROL_IDS
from cutgate.protocol.port import Port
from cutgate.protocol.records import Side
from cutgate.protocol.states import StopCause
from cutgate.protocol.times import since_1970_us
from cutgate.runtime.audit import log as audit_log
from cutgate.runtime.audit import names
from cutgate.runtime.audit.commit import InTurn, Job, LogFailed, LogFiles
from cutgate.runtime.audit.configuration import SIMULATED
from cutgate.runtime.audit.inspect import Log
from cutgate.runtime.audit.log import AuditLog, OpenInfo, Paths
from cutgate.runtime.audit.log import Clock as LogClock
from cutgate.runtime.audit.recomputed.transitions import transitions_sha256
from cutgate.runtime.audit.replay import Replay, replay
from cutgate.runtime.audit.written import LostError
from cutgate.runtime.interlock.phases import ENDED
from cutgate.runtime.interlock.state import (
    Collected,
    CutVerdict,
    DeviceCycle,
    Interlock,
    OperatorCommand,
    Phase,
)
from cutgate.runtime.interlock.state import Job as SessionJob
from cutgate.runtime.session import prover
from cutgate.runtime.session.check import Answer as Own
from cutgate.runtime.session.check import Check
from cutgate.runtime.session.job import VERIFIER, InputFiles, make_job, read_files
from cutgate.runtime.session.journal import Journal
from cutgate.runtime.session.loop import Session
from cutgate.runtime.session.messages import Answer, Bound, Claim, Request, framed
from cutgate.runtime.session.withdrawn import Withdrawal, barrier
from cutgate.runtime.session.witness import WitnessSearch
from cutgate.runtime.session.worker import Line, Worker
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.advice import Guidance
from cutgate.runtime.verification.plausibility import Placed
from cutgate.runtime.verification.steps import Steps, finished
from tests.logs import create, judged
from tests.runtime.audit.build import LOG_ID, WatchedDisk, inputs
from tests.runtime.session.wire import CONTROLLER, RUNTIME, Clock, Wire

KEY = bytes(range(32))
CYCLE_S = 0.005
SKEW_S = 60.0
NOW = datetime(2026, 9, 21, 14, 30, tzinfo=UTC)
ADMISSIBLE_MM, INADMISSIBLE_MM = 500.0, 850.0
STANDS = (-40_000_000, 95_000_000, 265_000_000, -50_000_000, 32_000_000)
"""Where the arm stands at power-up, 1e-6 deg | mm: a few degrees from the entry, so that nobody waits for it."""

# ---------------------------------------------------------------- disk


@dataclass
class Disk(WatchedDisk):
    """Files that are never synced for real; what a sync would have covered is kept.

    ``answers`` False: the disk never answers again. ``delay_s``: it takes that long for each job.
    """

    clock: Clock = field(default_factory=Clock)
    answers: bool = True
    delay_s: float = 0.0
    log: int | None = None

    def create(self, path: Path) -> int:
        made = super().create(path)
        self.log = made if self.log is None else self.log
        return made

    def sync(self, descriptor: int) -> None:
        self._before("sync")
        self.synced[descriptor] = os.fstat(descriptor).st_size

    def sync_directory(self, directory: Path) -> None:
        pass

    @property
    def durable(self) -> int:
        """How many bytes of the log are safe."""
        return self.synced.get(self.log, 0) if self.log is not None else 0


class TurnByTurn(InTurn):
    """The commit thread's work, done when the disk answers in virtual time instead of in a thread."""

    def __init__(self, disk: Disk, files: LogFiles) -> None:
        super().__init__(disk, files)
        self._disk_in_time = disk
        self._waiting: deque[tuple[float, Job]] = deque()

    def submit(self, job: Job) -> None:
        self._waiting.append((self._disk_in_time.clock() + self._disk_in_time.delay_s, job))
        self.work()

    def work(self) -> None:
        """Do what the disk has had time for."""
        disk = self._disk_in_time
        while disk.answers and not self._ended and self._waiting and self._waiting[0][0] <= disk.clock():
            _, job = self._waiting.popleft()
            try:
                self._ended = self._work([job])
            except (OSError, LostError) as error:
                self._report(
                    LogFailed(str(error) if isinstance(error, LostError) else os.strerror(error.errno))
                )
                self._head.discard()
                self._ended = True
            if self._ended:
                for file in (self._log, self._frames):
                    os.close(file.descriptor)

    def events(self) -> list[Any]:
        self.work()
        return super().events()

    def join(self, timeout_s: float) -> bool:
        if self._disk_in_time.answers and timeout_s > 0.0:
            self._disk_in_time.clock.now_s += self._disk_in_time.delay_s
        self.work()
        return self._ended


# ---------------------------------------------------------------- worker, view, generator


_environment = cache(audit_log._environment)
"""What the log says of interpreter and packages: asked once, for a thousand sessions."""


@cache
def _answers(request: Request) -> tuple[Answer, ...]:
    return tuple(prover.answers(request))


def answers(request: Request) -> list[Answer]:
    """What the verification process answers; each path is verified once for all tests."""
    return [
        said.model_copy(update={"request": request.number}) for said in _answers(replace(request, number=0))
    ]


def claim_of(verdict: CutVerdict) -> Claim:
    """What a verification process says that has found this."""
    named = {name: getattr(verdict, name).hex() for name in ("path", "limits", "calibration", "tool")}
    return Claim(
        request=verdict.request,
        admissible=verdict.admissible,
        **named,
        start_joints_u=verdict.start_joints_u,
        approach=Bound.of(verdict.approach),
    )


PLACED: dict[bytes, Placed] = {}
"""How the bone of each job was registered, by the registration's digest."""


@cache
def check_of(job: SessionJob, robot: Robot) -> Check:
    """The runtime's own verification of a job, made once for all tests."""
    return Check(job, robot, PLACED.get(job.registration))


class Altered(Check):
    """The runtime's own verification gone wrong: another verdict than it has found."""

    def __init__(self, check: Check, altered: Callable[[Own], Own]) -> None:
        self._check, self._altered = check, altered

    def request(self, *asked: Any) -> Request:
        return self._check.request(*asked)

    def steps(self, request: int, start_joints_u: tuple[int, ...]) -> Steps[Own]:
        return self._altered((yield from self._check.steps(request, start_joints_u)))


class NoProcess:
    """Stands for a process that is not there."""

    pid, stderr = 4242, None

    def poll(self) -> int | None:
        return None

    def wait(self, timeout: float | None = None) -> int:
        return 0

    def kill(self) -> None:
        """Nothing to kill."""


class Prover(Worker):
    """The verification process without the process: what it says crosses a socket all the same."""

    def __init__(self) -> None:
        ours, self._theirs = socket.socketpair()
        super().__init__(NoProcess(), Line(ours))
        self.answer: Callable[[Request], Iterable[Answer | bytes] | None] = answers
        self.asked: list[Request] = []

    @classmethod
    def start(cls, path: bytes = b"") -> "Prover":
        """As the runtime would start it."""
        return cls()

    def submit(self, request: Request) -> None:
        self.asked.append(request)
        self.give(*(self.answer(request) or ()))

    def give(self, *said: Answer | bytes) -> None:
        """It says this."""
        for each in said:
            self._theirs.sendall(each if isinstance(each, bytes) else framed(each.model_dump_json().encode()))

    def die(self) -> None:
        """It ends."""
        self._theirs.close()
        self.answer = lambda _request: None

    def close(self) -> None:
        self._theirs.close()
        super().close()


class InPlace(WitnessSearch):
    """The look-up without its thread: its answer is heard in the next cycle."""

    def begin(self, log: records.TreeHead) -> None:
        self._run(log)


@dataclass
class Notes:
    """A view that remembers."""

    notes: list[str] = field(default_factory=list)
    phases: list[Phase] = field(default_factory=list)
    effects: list[Any] = field(default_factory=list)
    verdicts: list[Own] = field(default_factory=list)
    guided: list[tuple[Guidance | None, str]] = field(default_factory=list)
    segments: list[tuple[int, int]] = field(default_factory=list)

    def step(
        self, before: Interlock, _event: Any, after: Interlock, effects: tuple[Any, ...], _now: float
    ) -> None:
        if after.phase is not before.phase:
            self.phases.append(after.phase)
        self.effects += effects

    def verdict(self, answer: Own) -> None:
        self.verdicts.append(answer)

    def guidance(self, found: Guidance | None, note: str) -> None:
        self.guided.append((found, note))

    def progress(self, segment: int, segments: int) -> None:
        self.segments.append((segment, segments))

    def note(self, text: str) -> None:
        self.notes.append(text)


class Generator:
    """Random bytes that are the same in every run."""

    def __init__(self, name: str) -> None:
        self._name, self._count = name, 0

    def __call__(self, size: int) -> bytes:
        self._count += 1
        return sha256(f"{self._name} {self._count}".encode()).digest()[:size]


# ---------------------------------------------------------------- inputs


@cache
def _job(directory: Path, bone_x_mm: float) -> tuple[InputFiles, SessionJob]:
    i = inputs(bone_x_mm)
    for name, data in (
        ("plan.csv", i.plan),
        ("robot.toml", i.robot.data),
        ("registration.json", i.registration),
    ):
        (directory / name).write_bytes(data)
    files = read_files(
        directory / "plan.csv",
        directory / "robot.toml",
        directory / "registration.json",
        None,
        None,
        allow_simulated=True,
    )
    job = make_job(files, now=NOW)
    if files.placed is not None:
        PLACED[job.registration] = files.placed
    return files, job


def job_of(tmp_path_factory: Any, bone_x_mm: float = ADMISSIBLE_MM) -> tuple[InputFiles, SessionJob]:
    """Input files and their job; read once for all tests."""
    directory = tmp_path_factory.getbasetemp() / f"inputs-{bone_x_mm:g}"
    directory.mkdir(exist_ok=True)
    return _job(directory, bone_x_mm)


def request_of(tmp_path_factory: Any, bone_x_mm: float = ADMISSIBLE_MM, number: int = 5) -> Request:
    """What the verification process is asked."""
    files, job = job_of(tmp_path_factory, bone_x_mm)
    held = Collected(job.limits, job.calibration, job.tool)
    return check_of(job, files.robot.value).request(number, STANDS, held)


# ---------------------------------------------------------------- the pair


class Terminal:
    """A pipe that somebody types into."""

    def __init__(self, words: Any) -> None:
        self._reading, self._writing = os.pipe2(os.O_NONBLOCK)
        self.reader = CommandReader(self._reading, words)

    def type(self, text: str) -> None:
        os.write(self._writing, f"{text}\n".encode())

    def hang_up(self) -> None:
        os.close(self._writing)
        self._writing = -1

    def close(self) -> None:
        for descriptor in (self._reading, self._writing):
            if descriptor >= 0:
                os.close(descriptor)


class Pair:
    """Two loops, one bus, one clock. ``fd``: the sides whose bulk records travel in FD frames."""

    def __init__(
        self, directory: Path, files: InputFiles, job: SessionJob, fd: Collection[Side] = ()
    ) -> None:
        self.directory, self.files, self.job = directory, files, job
        self.fd = fd
        self.clock = self._clock()
        self.disk = Disk(clock=self.clock)
        self.wire = self._wire()
        self.memory_file = directory / "memory.json"
        self.said: list[str] = []
        self.boots = 0
        self.sessions = 0
        self.listed: tuple[Withdrawal, ...] = ()
        self.closing: list[Callable[[], None]] = [node.shutdown for node in self.wire.nodes.values()]
        self.options = Options(time_scale=4.0, joints=as_joints(records.joints_to_memory(STANDS)))
        self.runtime_runs = self.controller_runs = True
        self.strangers: list[Stranger] = []
        self.cycle_s = CYCLE_S
        self.session: Session | None = None
        self.power_up()

    def _clock(self) -> Clock:
        return Clock()

    def _wire(self) -> Wire:
        return Wire(self.clock, durable=lambda: self.disk.durable)

    # ------------------------------------------------------------ set-up

    def power_up(self, *faults: str, serial: str = "SIM-1", **options: Any) -> None:
        """A controller with nothing but its memory file, and with these faults to come."""
        self.boots += 1
        self.options = replace(self.options, faults=tuple(map(FaultSpec.parse, faults)), **options)
        self.controller_terminal = Terminal(ConsoleWord)
        self.closing.append(self.controller_terminal.close)
        holdings = Holdings(self.job.limits, self.job.calibration, self.job.tool)
        random = Generator(f"controller {self.boots}")
        self.process = Process(
            Controller.powered_up(
                Identity(serial, fingerprint(KEY)),
                holdings,
                memory.load(self.memory_file, self.clock.utc_ns() // 1000),
                random(16),
            ),
            Port(self.wire.nodes[CONTROLLER], self._endpoint(Side.CONTROLLER)),  # type: ignore[arg-type]
            self.memory_file,
            options=self.options,
            commands=self.controller_terminal.reader,
            say=self.said.append,
            clock=self.clock,
            random=random,
            sleep=self._stand_still,
        )

    def latch(self, cause: StopCause) -> None:
        """The controller has woken up with a latched fault."""
        memory.save(self.memory_file, Memory(latched=cause))
        old = self.controller
        self.process.controller = Controller.powered_up(
            old.identity,
            old.holdings,
            memory.load(self.memory_file, self.clock.utc_ns() // 1000),
            old.announce_nonce,
        )

    def _stand_still(self, seconds: float) -> None:
        """The controller sleeps; everybody else goes on."""
        self.controller_runs = False
        self.run(seconds)
        self.controller_runs = True

    def _endpoint(self, side: Side) -> Endpoint:
        timing, deadlines = self.job.timing, self.job.deadlines
        return Endpoint(
            side,
            KEY,
            heartbeat_s=timing.heartbeat_s,
            timeout_s=timing.timeout_s,
            transfer_timeout_s=deadlines.reply_timeout_s,
            fd=side in self.fd,
        )

    def begin(self, job: SessionJob | None = None) -> "Pair":
        """A new session of the runtime, with a log of its own."""
        self.job = job or self.job
        self.sessions += 1
        self.disk.log = None
        self.log = self._log()
        self.closing.append(partial(_let_go, self.log))
        self.journal = Journal(self.log, "vcan0", self.job.timing)
        self.prover, self.notes = Prover(), Notes()
        self.terminal = Terminal(OperatorCommand)
        self.closing += [self.prover.close, self.terminal.close]
        self.wire.nodes[RUNTIME].inbox.clear()
        self.session = Session(
            Interlock(self.job),
            check=check_of(self.job, self.files.robot.value),
            port=Port(self.wire.nodes[RUNTIME], self._endpoint(Side.RUNTIME), self.journal.frame),  # type: ignore[arg-type]
            journal=self.journal,
            worker=self.prover,
            view=self.notes,
            commands=self.terminal.reader,
            log_id=self.log_id,
            barrier_us=self._barrier_us,
            witness=InPlace(self.directory / "logs"),
            checkpoint_deadline_s=5.0,
            clock=self.clock,
            random=Generator(f"runtime {self.sessions}"),
        )
        self.wake = wake = wake_pipe()
        self.closing += [lambda: os.close(wake[0]), lambda: os.close(wake[1])]
        self.journal.processes(self.prover.pid)
        self.session.begin(wake[0])
        return self

    def verdict_altered(self, altered: Callable[[CutVerdict], CutVerdict]) -> "Pair":
        """The runtime's own verification and the verification process both go wrong, and in the same way."""
        assert self.session is not None
        check = Altered(
            self.session._verifying._check, lambda own: replace(own, verdict=altered(own.verdict))
        )
        self.session._verifying._check = check
        self.prover.answer = lambda request: [
            claim_of(finished(check.steps(request.number, request.start_joints_u)).verdict)
        ]
        return self

    def _barrier_us(self, motion_age_s: int | None) -> int:
        now = datetime.fromtimestamp(self.clock.utc_ns() / 1e9, UTC)
        return since_1970_us(barrier(now, motion_age_s, self.files.registration, self.listed, SKEW_S))

    @property
    def log_id(self) -> bytes:
        return bytes.fromhex(f"{self.sessions:08x}{LOG_ID[8:]}")

    def _log(self) -> AuditLog:
        allowed_by = self.files.simulation_allowed_by
        options = ((SIMULATED, f"allowed by {allowed_by}"),) if allowed_by else ()
        with mock.patch.object(audit_log, "_environment", _environment):
            log = create(
                self.directory / "logs",
                log_id=self.log_id.hex(),
                opened=OpenInfo("cutgate 0.1.0", VERIFIER, options, transitions_sha256=transitions_sha256()),
                disk=self.disk,
                clock=LogClock(self.clock.utc_ns, self.clock.monotonic_ns),
                committer=TurnByTurn,
            )
        i = self.files
        assert i.prepared.registration is not None
        for name, data in (
            ("plan.csv", i.prepared.plan.data),
            ("registration.json", i.prepared.registration.data),
            (names.ROBOT, i.robot.data),
            *(((names.SITE, i.site.data),) if i.site else ()),
            (names.PATH, self.job.path),
        ):
            log.attach(name, "application/octet-stream", data)
        return log

    # ------------------------------------------------------------ time

    def run_cycle(self) -> None:
        """Time passes, then the controller turns, then the runtime."""
        self.clock.now_s += self.cycle_s
        if self.controller_runs:
            self.process.run_cycle(_readable(self.controller_terminal.reader.descriptor))
        for stranger in self.strangers:
            stranger.speak()
        if self.runtime_runs and self.session is not None and self.phase not in ENDED:
            self.session.run_cycle(_readable(self.terminal.reader.descriptor, self.prover.fileno()))

    def run(self, seconds: float) -> "Pair":
        """Turn for so long."""
        until_s = self.clock() + seconds - 1e-9
        while self.clock() < until_s:
            self.run_cycle()
        return self

    def until(
        self, condition: Callable[[], bool], limit_s: float = 10.0, act: Callable[[], None] = lambda: None
    ) -> "Pair":
        """Turn until it is so, acting before each turn; it must be within the limit."""
        until_s = self.clock() + limit_s
        while not condition():
            assert self.clock() < until_s, (
                f"not so in {limit_s} s: {self.phase} {self.state.reason} {self.said}"
            )
            act()
            self.run_cycle()
        return self

    # ------------------------------------------------------------ the way to a place

    def to(self, *phases: Phase, limit_s: float = 10.0) -> "Pair":
        """Turn until the session is in one of these phases, doing what a patient operator does on the way."""
        if self.session is None:
            self.begin()
        return self.until(lambda: self.phase in phases, limit_s, self._lead)

    def _lead(self) -> None:
        """Release the enabling device, hold it, say start: whatever comes next."""
        if self.phase is not Phase.PERMITTED:
            return
        match self.state.device:
            case DeviceCycle.UNSEEN:
                self.controller_terminal.type("release")
            case DeviceCycle.RELEASED:
                self.controller_terminal.type("hold")
            case DeviceCycle.PRESSED:
                self.terminal.type("start")

    def say(self, word: str) -> "Pair":
        """The operator says a word; it is heard in this turn."""
        self.terminal.type(word)
        self.run_cycle()
        return self

    def end(self, limit_s: float = 10.0) -> Phase:
        """Turn until the session has ended; how."""
        self.to(*ENDED, limit_s=limit_s)
        return self.phase

    # ------------------------------------------------------------ what has become of it

    @property
    def state(self) -> Interlock:
        assert self.session is not None
        return self.session.state

    @property
    def phase(self) -> Phase:
        return self.state.phase

    @property
    def controller(self) -> Controller:
        return self.process.controller

    def close(self, *, clean: bool = True) -> Paths:
        """Close the session's log as the command does."""
        assert self.session is not None
        verdict = self.session.answer.document["verdict"] if self.session.answer else None
        self.paths = self.journal.close(
            self.state, verdict, self.session._port.endpoint.link.statistics, clean=clean
        )
        return self.paths

    def read(self) -> Log:
        """The closed log, judged."""
        return judged(self.paths.log)

    def replayed(self) -> Replay:
        return replay(self.read(), certified.verify, verifier=VERIFIER)


class Stranger:
    """Another node that speaks as a runtime does, straight into the controller's ears, and hears what it answers."""

    def __init__(self, pair: Pair, session: bytes | None = None) -> None:
        self._pair = pair
        self.endpoint = pair._endpoint(Side.RUNTIME)
        self.endpoint.use_session(session)
        self.endpoint._sent = dict.fromkeys(self.endpoint._sent, 1000)  # beyond what the session has used
        self.heard: list[Any] = []
        pair.wire.rules.append(self._listen)
        pair.strangers.append(self)

    def _listen(self, message: can.Message) -> list[can.Message]:
        if message.arbitration_id in (CONTROL_IDS[CONTROLLER], BULK_IDS[CONTROLLER]):
            self.heard += self.endpoint.receive(
                message.arbitration_id, bytes(message.data), now_s=self._pair.clock()
            )
        return [message]

    def say(self, record: Any) -> None:
        self.endpoint.send_record(record, self._pair.clock())

    def speak(self, most: int | None = None) -> int:
        """Put what may leave into the controller's ears, at most so many frames."""
        frames = self.endpoint.outgoing()[:most]
        for can_id, data in frames:
            self._pair.wire.nodes[CONTROLLER].put(can_id, data)
        return len(frames)

    @property
    def replies(self) -> list[records.Reply]:
        found = [item.record for item in self.heard if isinstance(item, RecordReceived)]
        return [record for record in found if isinstance(record, records.Reply)]


def _readable(*descriptors: int | None) -> set[int]:
    wanted = [descriptor for descriptor in descriptors if descriptor is not None]
    poller = select.poll()  # select() cannot take descriptors from 1024 on
    for descriptor in wanted:
        poller.register(descriptor, select.POLLIN)
    return {descriptor for descriptor, _ in poller.poll(0)}


def _let_go(log: AuditLog) -> None:
    """A test that stops in the middle of a session leaves a log that holds its directory and two files."""
    if not log._closed:
        log.close(final_state="left open", clean=False, timeout_s=0.2)


@contextmanager
def pair_of(directory: Path, files: InputFiles, job: SessionJob, fd: Collection[Side] = ()) -> Iterator[Pair]:
    """A pair whose descriptors are closed at the end."""
    pair = Pair(directory, files, job, fd)
    try:
        yield pair
    finally:
        for close in pair.closing:
            close()
