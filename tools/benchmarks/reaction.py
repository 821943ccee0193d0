"""How soon a fault stops the arm: hub, runtime and controller as processes, the faulty side played by this one."""

import math
import multiprocessing
import multiprocessing.forkserver
import os
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import median, quantiles
from typing import Any

import can
from pages import Rows
from paths import EXAMPLES

from cutgate.config.key import load_key, new_key_file
from cutgate.config.load import load_robot
from cutgate.config.records import calibration_record, limits_record, tool_record
from cutgate.firmware_sim.console import ConsoleCommand
from cutgate.firmware_sim.hil.hub import hub_process
from cutgate.firmware_sim.kinematics import as_joints
from cutgate.firmware_sim.loop import Options, Process
from cutgate.firmware_sim.state import Controller, Holdings, Identity, Memory
from cutgate.protocol import records
from cutgate.protocol.codes import KEY_BYTES, fingerprint
from cutgate.protocol.e2e import protect
from cutgate.protocol.endpoint import Endpoint
from cutgate.protocol.frames import (
    DATA_IDS,
    IDS,
    ControllerFault,
    ControllerHeartbeat,
    Frame,
    Joint4,
    Progress,
    RuntimeHeartbeat,
    RuntimeStop,
    decode_frame,
)
from cutgate.protocol.link import Accepted
from cutgate.protocol.parameters import counts_nearest
from cutgate.protocol.port import Passed, Port
from cutgate.protocol.records import Side
from cutgate.protocol.states import ControllerState, Refusal, RuntimeCode, StopCause, StopCode

sys.path.insert(0, str(Path(__file__).parents[2]))
from cutgate.runtime.conform.bench import Bench
from cutgate.runtime.conform.failures import DeviationError, HaltError
from cutgate.runtime.conform.heard import Standstill
from cutgate.runtime.conform.sample import LONG
from cutgate.runtime.interlock.state import Phase
from tests.system import harness
from tests.system.children import Script

HEARTBEAT_S, TIMEOUT_S = 0.02, 0.1
TIMING = records.Timing(20, 100, 120, 2000, 500, 200, 0, 25)
CYCLE = "20 ms, one cycle"
LOST = "120 ms, time-out and one cycle"
TRIALS, TRIALS_CUTTING, TRIALS_RUNTIME = 50, 25, 8
TRIES = 4
"""So often is a trial repeated on a machine that stood still."""
SETTLE_S = 0.06
"""After a fault frame the joints are looked at for so long: three samples."""


def times_of(took: list[float]) -> tuple[str, str, str]:
    """Median, 99 %, greatest."""
    late = quantiles(took, n=100, method="inclusive")[98]
    return tuple(f"{value * 1e3:.2f} ms" for value in (median(took), late, max(took)))  # type: ignore[return-value]


# ---------------------------------------------------------------- the controller


class Moving(Standstill):
    """What the suite watches for, of an arm that is meant to move: the controller's heartbeat alone."""

    def take(self, item: Any) -> None:
        """What arrived."""
        if isinstance(item, Accepted) and isinstance(item.frame, ControllerHeartbeat):
            self.state = item.frame


class Tester(Bench):
    """The tester of ``cutgate conform`` on a simulated plant: it lets it cut."""

    def begin(self) -> None:
        """Forget what the trial before has heard and said; the arm may move."""
        self.standstill = Moving()
        super().begin()

    def sample(self, poses: int | None = None) -> Any:
        """A path that takes longer than any trial."""
        return super().sample(LONG if poses is None else poses)

    def idle(self, _say: Callable[[str], None]) -> None:
        """A session, heartbeats going."""
        self.open()

    def cutting(self, say: Callable[[str], None]) -> None:
        """Permitted, held, started, and the arm on its path."""
        say("release")
        permit = self.permitted()
        say("hold")
        self._need(lambda: (self.state is not None and self.state.device_pressed) or None)
        answer = self.ask(self.start(permit))
        if answer is None or answer.refusal is not Refusal.ACCEPTED:
            raise DeviationError("the start was refused")
        self.code = RuntimeCode.CUT
        self._need(lambda: any(moved.fraction or moved.segment for moved in self._progress()) or None)

    def _progress(self) -> Iterator[Progress]:
        frames = (heard.item.frame for heard in self.heard[-20:] if isinstance(heard.item, Accepted))
        return (frame for frame in frames if isinstance(frame, Progress))

    def _need(self, found: Callable[[], object]) -> None:
        if self.until(found, self.reply_s) is None:
            raise DeviationError("the controller did not follow")

    def again(self) -> None:
        """End whatever session there is, and let the controller come to rest."""
        self.endpoint.abort()
        if self.endpoint.link.is_open:
            self.stop(StopCause.OPERATOR_QUIT, StopCode.END)
            self.port.flush()
        self.endpoint.end_session()
        self.begin()
        until_s = time.monotonic() + HEARTBEAT_S
        while time.monotonic() < until_s:
            self.port.bus.recv(timeout=HEARTBEAT_S)

    def beat(self) -> tuple[int, bytes]:
        """The heartbeat that would go out now, its counter used up."""
        return self.encoded(RuntimeHeartbeat(self.code, self.epoch))


def _stop(tester: Tester) -> None:
    tester.stop_now()


def _corrupt(tester: Tester) -> None:
    for _ in range(3):
        tester.inject(IDS[RuntimeHeartbeat], bytes(8))


def _gap(tester: Tester) -> None:
    can_id, data = tester.beat()
    skipped = (data[2] + 100) % 256
    tester.inject(can_id, protect(data[3:], skipped, DATA_IDS[can_id], tester.endpoint.link.tag))


def _unlisted(tester: Tester) -> None:
    can_id = IDS[RuntimeStop]
    tester.inject(can_id, protect(bytes(5), 0, DATA_IDS[can_id], tester.endpoint.link.tag))


def _silence(tester: Tester) -> None:
    """A last heartbeat, and nothing more: the clock runs from here."""
    tester.inject(*tester.beat())


WRONGS: dict[str, tuple[Callable[[Tester], None], StopCause, str]] = {
    "stop frame": (_stop, StopCause.OPERATOR_STOP, CYCLE),
    "third corrupt frame": (_corrupt, StopCause.CORRUPTION, CYCLE),
    "counter gap": (_gap, StopCause.SEQUENCE_ERROR, CYCLE),
    "stop frame with a code that is not listed": (_unlisted, StopCause.PROTOCOL_VIOLATION, CYCLE),
    "silence, from the last heartbeat": (_silence, StopCause.HEARTBEAT_LOST, LOST),
}


@dataclass(frozen=True)
class Stopped:
    """From the wrong to the fault frame, and to the last frame that still showed a movement, s."""

    fault_s: float
    moved_s: float


def provoke(
    tester: Tester, wrong: Callable[[Tester], None], cause: StopCause, *, settle_s: float
) -> Stopped | None:
    """Do the wrong and look on, for so long after the fault frame; None if the controller had another cause."""
    shown: dict[int, Frame] = {}
    fault_s = moved_s = math.nan
    wrong(tester)
    began, until = time.perf_counter(), math.inf
    while (now := time.perf_counter()) < until:
        message = tester.port.bus.recv(timeout=min(1.0, until - now))
        took = time.perf_counter() - began
        if message is None:
            if math.isnan(fault_s):
                raise TimeoutError("the controller did not stop")
            break
        can_id, data = message.arbitration_id, bytes(message.data)
        if can_id == IDS[ControllerFault] and math.isnan(fault_s):
            fault = decode_frame(can_id, data)
            if not isinstance(fault, ControllerFault) or fault.cause is not cause:
                return None
            fault_s, until = took, time.perf_counter() + settle_s
        elif 0x300 <= can_id <= IDS[Progress]:
            place = _place(can_id, data)
            moved_s = took if shown.get(can_id, place) != place else moved_s
            shown[can_id] = place
    return Stopped(fault_s, 0.0 if math.isnan(moved_s) else moved_s)


def _place(can_id: int, data: bytes) -> Frame:
    """What the frame shows of where the arm is: the tag of a sample is another one each time."""
    frame = decode_frame(can_id, data)
    return replace(frame, tag=0) if isinstance(frame, Joint4) else frame


@contextmanager
def a_controller() -> Iterator[tuple[Tester, Callable[[str], None]]]:
    """A bus with a simulated controller, each in a process of its own, a tester, and the controller's terminal."""
    with tempfile.TemporaryDirectory(prefix="cutgate-") as name:
        socket, key = Path(name) / "bus.sock", Path(name) / "bench.key"
        new_key_file(key, os.urandom(KEY_BYTES))
        command = [sys.executable, "-m", "cutgate.firmware_sim", "--robot", str(EXAMPLES / "robot.toml")]
        command += ["--key", str(key), "--interface", "cutgate", "--channel", str(socket)]
        with (
            hub_process(socket),
            can.Bus(interface="cutgate", channel=str(socket)) as bus,
            subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, bufsize=0
            ) as controller,
        ):
            poller = select.poll()
            poller.register(bus.fileno(), select.POLLIN)

            def say(word: str) -> None:
                assert controller.stdin is not None
                controller.stdin.write(f"{word}\n".encode())

            try:
                tester = Tester(
                    bus,
                    load_key(key),
                    TIMING,
                    reply_s=2.0,
                    clock=time.monotonic,
                    wait=lambda seconds: poller.poll(seconds * 1000.0) and None,
                    random=os.urandom,
                )
                tester.hello()
                yield tester, say
            finally:
                controller.terminate()


def _controller(state: Callable[[Tester, Callable[[str], None]], None], trials: int, *, moves: bool) -> Rows:
    yield ("fault", "trials", "median", "99 %", "max", *["last movement shown, max"] * moves, "bound")
    with a_controller() as (tester, say):
        for name, (wrong, cause, bound) in WRONGS.items():
            found: list[Stopped] = []
            count = trials // 2 if bound == LOST else trials
            for _ in range(TRIES * count):
                if len(found) == count:
                    break
                # A machine that stood still has stopped the session before the fault did: once more.
                with suppress(TimeoutError, DeviationError, HaltError):
                    tester.again()
                    state(tester, say)
                    stopped = provoke(tester, wrong, cause, settle_s=SETTLE_S * moves)
                    found += [] if stopped is None else [stopped]
            if len(found) < count:
                raise RuntimeError(
                    f"{name}: the controller did as expected in {len(found)} of {TRIES * count} trials"
                )
            took = times_of([stopped.fault_s for stopped in found])
            moved = f"{max(stopped.moved_s for stopped in found) * 1e3:.2f} ms"
            yield (name, str(count), *took, *[moved] * moves, bound)


def controller_idle() -> Rows:
    """From the frame to the controller's fault frame, in a session without a path. The same table decides as below."""
    yield from _controller(Tester.idle, TRIALS, moves=False)


def controller_cutting() -> Rows:
    """From the frame to the controller's fault frame, and to the last frame of joints or progress that shows a movement.

    The arm is on its path, the enabling device held, every heartbeat says CUT. Joints and progress come with each
    heartbeat; 0 ms: none of those after the fault differs from the one before.
    """
    yield from _controller(Tester.cutting, TRIALS_CUTTING, moves=True)


# ---------------------------------------------------------------- the runtime

SITE = """schema = "cutgate.site/1"
[approach]
approach_clearance_mm = 0.5
[log]
checkpoint_deadline_ms = 1000
chunk_period_ms = 100
"""
PATIENCE_S = 20.0


@dataclass
class Seen:
    """When what passed the controller's port, by this process's clock."""

    stop: tuple[float, StopCause] | None = None
    cutting_s: float = math.inf
    sent_s: dict[int, float] = field(default_factory=dict)

    def record(self, passed: Passed) -> None:
        """The first stop or heartbeat that says INHIBIT; when CUTTING was first sent, and each identifier last."""
        now_s, can_id = time.perf_counter(), passed.can_id
        if passed.direction == "sent":
            self.sent_s[can_id] = now_s
        if can_id not in WATCHED:
            return
        match decode_frame(can_id, passed.data):
            case RuntimeStop(cause=cause) | RuntimeHeartbeat(code=RuntimeCode.INHIBIT, cause=cause):
                self.stop = self.stop or (now_s, cause)
            case ControllerHeartbeat(state=ControllerState.CUTTING):
                self.cutting_s = min(self.cutting_s, now_s)


WATCHED = {IDS[kind] for kind in (RuntimeStop, RuntimeHeartbeat, ControllerHeartbeat)}


class Stage:
    """A runtime in a process of its own, against a simulated controller in this one."""

    def __init__(self, rig: harness.Rig, bus: can.BusABC, script: Script | None) -> None:
        robot = load_robot(EXAMPLES / "robot.toml").value
        limits, calibration, tool = (
            made(robot).body() for made in (limits_record, calibration_record, tool_record)
        )
        stands = tuple(counts_nearest(float(part), "joint") for part in harness.STANDS.split(","))
        key = load_key(rig.folder / "site.key")
        endpoint = Endpoint(
            Side.CONTROLLER, key, heartbeat_s=HEARTBEAT_S, timeout_s=TIMEOUT_S, transfer_timeout_s=2.0
        )
        self.seen, self.bus = Seen(), bus
        self.controller = Process(
            Controller.powered_up(
                Identity("SIM-1", fingerprint(key)),
                Holdings(limits, calibration, tool),
                Memory(),
                os.urandom(16),
            ),
            Port(bus, endpoint, self.seen.record),
            rig.folder / "memory.json",
            options=Options(joints=as_joints(records.joints_to_memory(stands))),
            say=lambda _text: None,
        )
        self.runtime = rig.run(script=script)
        self._poller = select.poll()
        self._poller.register(bus.fileno(), select.POLLIN)

    def until(self, so: Callable[[], bool]) -> None:
        """Turn the controller until it is so. Raises TimeoutError if it does not come to that."""
        until_s = time.perf_counter() + PATIENCE_S
        while not so():
            if time.perf_counter() > until_s or self.runtime._exit_code(0) is not None:
                raise TimeoutError(self.runtime.told)
            self._poller.poll(1000.0 * self.controller._wait_s())
            self.controller.run_cycle()

    def says(self, words: str) -> Callable[[], bool]:
        """Whether the runtime has said so."""

        def said() -> bool:
            self.runtime.listen()
            return any(words in line for line in self.runtime.lines)

        return said

    def cutting(self) -> None:
        """Permitted, held, started, and the arm on its path."""
        self.until(self.says("permitted:"))
        self.controller.act(ConsoleCommand.HOLD)
        self.until(self.says("enabling device is held"))
        self.runtime.say("start")
        self.until(lambda: self.controller.arm.state.progress > (0, 0.0))
        self.seen.stop = None  # heartbeats say INHIBIT until there is a permit

    def latency(self, wrong: Callable[["Stage"], float], cause: StopCause) -> float | None:
        """From the moment that the wrong names to the runtime's first sign of a stop, s; None for another cause."""
        began_s = wrong(self)
        self.until(lambda: self.seen.stop is not None)
        assert self.seen.stop is not None
        return self.seen.stop[0] - began_s if self.seen.stop[1] is cause else None


def _fault(stage: Stage) -> float:
    stage.controller.act(ConsoleCommand.ESTOP)
    stage.controller.port.flush()
    return stage.seen.sent_s[IDS[ControllerFault]]


def _silent(stage: Stage) -> float:
    stage.controller._silent = True
    return stage.seen.sent_s[IDS[ControllerHeartbeat]]


def _noise(stage: Stage) -> float:
    for _ in range(3):
        stage.bus.send(
            can.Message(arbitration_id=IDS[ControllerHeartbeat], data=bytes(8), is_extended_id=False)
        )
    return time.perf_counter()


def _deviates(stage: Stage) -> float:
    """From the next sample on q0 is 5 deg off."""
    stage.controller.arm.drift(time.monotonic() - 5.0)
    before_s = stage.seen.sent_s[IDS[Joint4]]
    stage.until(lambda: stage.seen.sent_s[IDS[Joint4]] > before_s)
    return stage.seen.sent_s[IDS[Joint4]]


def _says_stop(stage: Stage) -> float:
    began_s = time.perf_counter()
    stage.runtime.say("stop")
    return began_s


def _disk(stage: Stage) -> float:
    """The disk answers nothing from the step in which the runtime learned of CUTTING."""
    return stage.seen.cutting_s


SILENT_DISK = Script(disk_stops_at=Phase.CUTTING)
RUNTIME_WRONGS: dict[str, tuple[Callable[[Stage], float], StopCause, str]] = {
    "the controller's fault frame": (_fault, StopCause.EMERGENCY_STOP, CYCLE),
    "third corrupt frame": (_noise, StopCause.CORRUPTION, CYCLE),
    "joints 5 deg off the path, from the sample": (_deviates, StopCause.TRACKING_DEVIATION, CYCLE),
    "the command `stop`, from its line": (_says_stop, StopCause.OPERATOR_STOP, CYCLE),
    "silence, from the controller's last heartbeat": (_silent, StopCause.HEARTBEAT_LOST, LOST),
    "silent disk, from CUTTING": (
        _disk,
        StopCause.AUDIT_FAILED,
        "1120 ms: chunk 100, deadline 1000, one cycle",
    ),
}


def runtime_cutting() -> Rows:
    """From the fault to the runtime's stop frame, or its first heartbeat that says INHIBIT, at the controller's port.

    The arm is on its path. Disk: the oldest unwritten record waits `chunk_period_ms`, then `checkpoint_deadline_ms`
    (here at their lowest, 100 and 1000).
    """
    yield ("fault", "trials", "median", "99 %", "max", "bound")
    # Each runtime is forked from a server that has this module already, or it would import it anew.
    multiprocessing.get_context("forkserver").set_forkserver_preload(["tests.system.children", __name__])
    multiprocessing.forkserver.ensure_running()
    for name, (wrong, cause, bound) in RUNTIME_WRONGS.items():
        took: list[float] = []
        with tempfile.TemporaryDirectory() as folder, harness.Rig(Path(folder)) as rig:
            (rig.folder / "site.toml").write_text(SITE, encoding="utf-8")
            with can.Bus(interface="cutgate", channel=str(rig.channel)) as bus:
                while len(took) < TRIALS_RUNTIME:
                    found = _trial(rig, bus, wrong, cause)
                    took += [] if found is None else [found]
        yield (name, str(len(took)), *times_of(took), bound)


def _trial(
    rig: harness.Rig, bus: can.BusABC, wrong: Callable[[Stage], float], cause: StopCause
) -> float | None:
    """One session up to the stop; None if this machine stood still and something else stopped it first."""
    stage = Stage(rig, bus, SILENT_DISK if wrong is _disk else None)
    try:
        stage.cutting()
        return stage.latency(wrong, cause)
    except TimeoutError:
        return None
    finally:
        stage.runtime.end()
        rig.children.remove(stage.runtime)
        Port(bus, stage.controller.port.endpoint).discard()
