"""Hub, simulated controller and runtime as processes, driven by the words their users would say.

Nothing here sleeps: every wait is for a line, a frame or an exit, and is bounded. A bound is not an expectation;
it is what a test may take on the slowest machine before it counts as hung.
"""

import json
import os
import re
import secrets
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from datetime import UTC, datetime
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Self

import can

from cutgate.config.bus import LOCAL_INTERFACE, open_bus
from cutgate.config.key import load_key, new_key_file
from cutgate.firmware_sim.hil import inputs
from cutgate.protocol import records
from cutgate.protocol.codes import KEY_BYTES, PresharedKey, SessionCodes
from cutgate.protocol.frames import (
    CONTROL_IDS,
    IDS,
    ControllerHeartbeat,
    Frame,
    Joint4,
    Joints01,
    Joints23,
    Progress,
    RuntimeHeartbeat,
    decode_frame,
)
from cutgate.runtime.audit.inspect import Log
from tests.logs import judged
from tests.system import children
from tests.system.children import Script

WAIT_S = 20.0
END_S = 10.0
ROOT = Path(__file__).parents[2]
ROBOT = ROOT / "examples" / "robot.toml"
SITE = inputs.SITE
HEARTBEAT_S, TIMEOUT_S = 0.05, 1.0
IN_TIME = round(TIMEOUT_S / HEARTBEAT_S) + 2
"""Heartbeats of the controller: those of the time-out, the one that was due with the last it heard, and one more turn."""
STANDS, POSES = inputs.STANDS, inputs.POSES
FAST = 30
"""Time scale at which the short path of 36 mm takes 0.6 s; at scale 1 it outlasts every test."""
SAFE = ("INHIBITED", "FAULT")


class HungError(AssertionError):
    """What was waited for did not come; the message shows everything that did."""


# ---------------------------------------------------------------- one process


class Child:
    """A process, the words it is told and the lines it says.

    Attributes:
        lines: what it has said so far, line by line.
        document: its standard output, where that is kept apart from the lines.
    """

    def __init__(
        self,
        name: str,
        process: subprocess.Popen[bytes] | BaseProcess,
        words: int,
        streams: tuple[int, ...],
        apart: int | None,
    ) -> None:
        self.name = name
        self.pid = process.pid or 0
        self.lines: list[str] = []
        self.document = ""
        self._process = process
        self._words = words
        self._rest = dict.fromkeys(streams, b"")
        self._apart = apart
        self._seen = 0

    def say(self, word: str) -> None:
        """Type one word."""
        self.type(f"{word}\n".encode())

    def type(self, keys: bytes) -> None:
        """Press keys."""
        with suppress(BrokenPipeError):  # it has ended meanwhile: its exit code tells
            os.write(self._words, keys)

    def signal(self, number: int) -> None:
        """Send it a signal."""
        os.kill(self.pid, number)

    @property
    def stopped(self) -> bool:
        """Whether SIGSTOP has taken effect."""
        return Path(f"/proc/{self.pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] == "T"

    def ctrl_c(self) -> None:
        """What a terminal does: SIGINT to it and everything it has started. Only for a fresh interpreter."""
        os.killpg(self.pid, signal.SIGINT)

    @property
    def job(self) -> int:
        """The process number of its one child: of a shell's job."""
        return int(Path(f"/proc/{self.pid}/task/{self.pid}/children").read_text(encoding="ascii"))

    @property
    def in_background(self) -> bool:
        """Whether the terminal of a shell's job belongs to the shell."""
        stat = Path(f"/proc/{self.job}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        group, foreground = stat[2], stat[5]
        return group != foreground

    def fill(self) -> None:
        """Nobody reads any more what it says, and what lies between is full: its next word waits for ever."""
        for descriptor in (1, 2):
            # Opened anew, for its own O_NONBLOCK: the flag of an open file is everybody's who shares it.
            name = f"/proc/{self.pid}/fd/{descriptor}"
            stream = os.open(name, os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
            with suppress(BlockingIOError):
                while True:
                    os.write(stream, b"." * 4096)
            os.close(stream)

    def deaf(self) -> int:
        """Its exit code, with nobody reading what it says."""
        code = self._exit_code(WAIT_S)
        if code is None:
            raise HungError(f"{self.name} did not end; before, it said\n{self.told}")
        return code

    def hang_up(self) -> None:
        """Whoever reads what it says goes away; of a terminal, both ways."""
        for stream in self._rest:
            os.close(stream)
        if self._words in self._rest:
            self._words = os.open(os.devnull, os.O_WRONLY | os.O_CLOEXEC)
        self._rest = {}

    def line(self, pattern: str) -> str:
        """The next line that matches; lines before it are passed over."""
        until_s = time.monotonic() + WAIT_S
        while True:
            while self._seen < len(self.lines):
                text = self.lines[self._seen]
                self._seen += 1
                if re.search(pattern, text):
                    return text
            if not self._rest or not self._read(until_s):
                raise HungError(f"{self.name} did not say {pattern!r}; it said\n{self.told}")

    def exit(self, cues: Mapping[str, Callable[[], None]] | None = None) -> int:
        """Everything it still says, then its exit code; negative for a signal.

        Args:
            cues: what to do on a line that matches.
        """
        until_s = time.monotonic() + WAIT_S
        while self._rest and self._read(until_s):
            for text in self.lines[self._seen :]:
                self._seen += 1
                for pattern, act in (cues or {}).items():
                    if re.search(pattern, text):
                        act()
        code = self._exit_code(max(0.1, until_s - time.monotonic()))
        if code is None:
            raise HungError(f"{self.name} did not end; it said\n{self.told}")
        assert "Traceback" not in self.told, self.told
        return code

    @property
    def told(self) -> str:
        """Everything it has said."""
        return "\n".join([*self.lines, self.document])

    def listen(self) -> None:
        """Take what has been said so far, without waiting."""
        while self._rest and self._read(0.0):
            pass

    def _read(self, until_s: float) -> bool:
        """Take what arrives until then; whether anything did. A stream at its end is closed."""
        left_s = max(0.0, until_s - time.monotonic())
        poller = select.poll()  # select() cannot take descriptors from 1024 on
        for stream in self._rest:
            poller.register(stream, select.POLLIN)
        ready = [stream for stream, _ in poller.poll(left_s * 1000.0)]
        for stream in ready:
            try:
                data = os.read(stream, 65536)
            except OSError:  # of a terminal that nobody holds open any more
                data = b""
            if stream == self._apart:
                self.document += data.decode()
            else:
                *lines, self._rest[stream] = (self._rest[stream] + data).split(b"\n")
                self.lines += [line.decode().rstrip() for line in lines]
            if not data:
                del self._rest[stream]
                if stream != self._words:
                    os.close(stream)
        return bool(ready)

    def _exit_code(self, timeout_s: float) -> int | None:
        if isinstance(self._process, BaseProcess):
            return children.exit_code(self._process, timeout_s)
        with suppress(subprocess.TimeoutExpired):
            return self._process.wait(timeout_s)
        return None

    def end(self) -> None:
        """Make sure that it is gone, and the job of a shell with it."""
        if self._exit_code(0) is None:
            with suppress(ProcessLookupError):  # it has just ended
                if self._words in self._rest:
                    os.killpg(self.job, signal.SIGKILL)
                self.signal(signal.SIGKILL)
        self._exit_code(END_S)
        for stream in {self._words, *self._rest}:
            os.close(stream)
        self._rest = {}


def start(
    name: str,
    program: str,
    arguments: list[str],
    *,
    apart: bool,
    fresh: bool,
    script: Script | None,
    terminal: bool = False,
) -> Child:
    """Start a program, in a fresh interpreter or forked.

    Args:
        name: in messages.
        program: a module.
        arguments: its arguments.
        apart: keep its standard output from its lines.
        fresh: in a fresh interpreter, as a user starts it.
        script: how it is bent.
        terminal: as the one job of a shell on a terminal of its own.
    """
    process: subprocess.Popen[bytes] | BaseProcess
    if terminal:
        mine, slave = os.openpty()
        process = children.fork((slave,) * 3, program, arguments, script, children.serve_a_job)
        os.close(slave)
        return Child(name, process, mine, (mine,), None)
    words_read, words = os.pipe2(os.O_CLOEXEC)
    output, output_write = os.pipe2(os.O_CLOEXEC)
    messages, messages_write = os.pipe2(os.O_CLOEXEC)
    theirs = (words_read, output_write, messages_write)
    if fresh:
        assert script is None, "a fresh interpreter runs the program as it is"
        command = [sys.executable, "-m", program, *arguments]
        process = subprocess.Popen(
            command,
            stdin=words_read,
            stdout=output_write,
            stderr=messages_write,
            cwd=ROOT,
            start_new_session=True,  # as a terminal would, so that Ctrl-C can be typed to the whole of it
        )
    else:
        process = children.fork(theirs, program, arguments, script)
    for stream in theirs:
        os.close(stream)
    return Child(name, process, words, (output, messages), output if apart else None)


# ---------------------------------------------------------------- the bus


class Observer:
    """One more client of the bus, that writes down every frame; ``at_once`` sees each the moment it arrives."""

    def __init__(self, interface: str, channel: str) -> None:
        self.frames: list[can.Message] = []
        self.at_once: Callable[[can.Message], None] = lambda _message: None
        self.bus = open_bus(interface, channel, fd=True)
        self._changed = threading.Condition()
        self._ended = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._ended:
            try:
                message = self.bus.recv(timeout=0.1)
            except can.CanOperationError:
                return
            if message is not None:
                self.at_once(message)
                with self._changed:
                    self.frames.append(message)
                    self._changed.notify_all()

    def frame(self, wanted: Callable[[can.Message], bool], *, after: int = 0) -> can.Message:
        """The first such frame from index ``after`` on; waits for it."""
        until_s = time.monotonic() + WAIT_S
        with self._changed:
            while True:
                for message in self.frames[after:]:
                    if wanted(message):
                        return message
                after = max(after, len(self.frames))
                left_s = until_s - time.monotonic()
                if left_s <= 0.0 or not self._changed.wait(left_s):
                    raise HungError(f"no such frame among {len(self.frames)}")

    def single(
        self, kind: type[Frame], wanted: Callable[[Any], bool] = lambda _frame: True, *, after: int = 0
    ) -> can.Message:
        """The first frame of this kind that is wanted."""
        return self.frame(lambda message: is_kind(message, kind) and wanted(decoded(message)), after=after)

    def all(self, kind: type[Frame]) -> list[tuple[float, Any]]:
        """Every frame of this kind so far, with its time on the bus, s."""
        return [(m.timestamp, decoded(m)) for m in list(self.frames) if is_kind(m, kind)]

    def beats(
        self, kind: type[ControllerHeartbeat | RuntimeHeartbeat], *, after: int, before: can.Message
    ) -> int:
        """How many heartbeats one side sent in between: its own measure of time, whatever else the machine does."""
        frames = list(self.frames)
        end = next(number for number, message in enumerate(frames) if message is before)
        return sum(is_kind(message, kind) for message in frames[after:end])

    def records(self, can_id: int) -> list[records.Envelope]:
        """Every whole record that was sent on a transfer identifier."""
        return list(_reassembled([m.data for m in list(self.frames) if m.arbitration_id == can_id]))

    def close(self) -> None:
        """Leave the bus."""
        self._ended = True
        self._thread.join(END_S)
        self.bus.shutdown()


def is_kind(message: can.Message, kind: type[Frame]) -> bool:
    """Whether the identifier is this frame's."""
    return not message.is_error_frame and message.arbitration_id == IDS[kind]


def decoded(message: can.Message) -> Any:
    """The frame in a message."""
    return decode_frame(message.arbitration_id, bytes(message.data))


def begins(message: can.Message, kind: type[records.Record]) -> bool:
    """Whether this is the ISO-TP first frame of such a record: length 4 + 12 bit, then the record's type."""
    sent_on = CONTROL_IDS[kind.SENDER]
    return message.arbitration_id == sent_on and message.data[0] >> 4 == 1 and message.data[2] == kind.TYPE


def moved_after(rig: "Rig", stopped_s: float) -> bool:
    """Whether any joint moved after this moment on the bus."""
    kinds = (Joints01, Joints23, Joint4)
    frames = [m for m in list(rig.bus.frames) if m.timestamp > stopped_s]
    return any(len({_joints(m) for m in frames if is_kind(m, kind)}) > 1 for kind in kinds)


def _joints(message: can.Message) -> tuple[int, ...]:
    """What a frame of joints says of them, without its tag."""
    return tuple(value for name, value in vars(decoded(message)).items() if name.startswith("q"))


def _reassembled(frames: list[bytearray]) -> Iterator[records.Envelope]:
    """ISO-TP put together again, for frames of one sender that arrive in order; what breaks off is left out."""
    length, data = 0, b""
    for frame in frames:
        kind = frame[0] >> 4
        if kind == 0:
            length, data = frame[0] & 0xF, bytes(frame[1:])
        elif kind == 1:
            length, data = (frame[0] & 0xF) << 8 | frame[1], bytes(frame[2:])
        elif kind == 2:
            data += bytes(frame[1:])
        if kind != 3 and 0 < length <= len(data):
            yield records.unpack(data[:length])
            length = 0


# ---------------------------------------------------------------- the whole


class Rig:
    """A bus with whatever a test starts on it; leaving the block ends all of it.

    Attributes:
        folder: plan, registration, robot, site, keys and logs.
        interface, channel: the bus; on the local virtual one it is a hub of the rig's own, any other one is there.
        bus: an observer of every frame.
    """

    def __init__(self, folder: Path, interface: str = LOCAL_INTERFACE, channel: str = "") -> None:
        self.folder = folder
        self.interface, self.channel = interface, channel
        self.children: list[Child] = []
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        write_inputs(self.folder)
        try:
            if self.interface == LOCAL_INTERFACE:
                self._serve()
            self.bus = Observer(self.interface, self.channel)
            self._stack.callback(self.bus.close)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_error: object) -> None:
        for child in reversed(self.children):
            child.end()
        self._stack.close()

    def _serve(self) -> None:
        # Not in the folder: a socket's path has at most 107 bytes.
        place = self._stack.enter_context(tempfile.TemporaryDirectory(prefix="cutgate-"))
        self.channel = str(Path(place) / "bus.sock")
        self.hub = self._start("hub", "cutgate.firmware_sim", ["bus", "serve", "--socket", self.channel])
        self.hub.line("serving on")

    def _start(self, name: str, program: str, arguments: list[str], **how: Any) -> Child:
        child = start(name, program, arguments, **{"apart": False, "fresh": False, "script": None, **how})
        self.children.append(child)
        return child

    @property
    def _where(self) -> list[str]:
        return ["--interface", self.interface, "--channel", self.channel]

    def sim(
        self,
        *faults: str,
        scale: float = 1,
        key: str = "site.key",
        robot: Path = ROBOT,
        joints: str | None = STANDS,
        fd: bool = False,
        fresh: bool = False,
        ready: bool = True,
        more: Sequence[str] = (),
    ) -> Child:
        """The simulated controller, with these options besides, ready for a session unless told otherwise."""
        options = ["--robot", str(robot), "--key", str(self.folder / key), "--time-scale", str(scale)]
        options += [f"--joints={joints}"] if joints is not None else []
        options += [word for fault in faults for word in ("--fault", fault)]
        options += ["--fd"] * fd + list(more)
        child = self._start(
            "controller", "cutgate.firmware_sim", ["sim", *options, *self._where], fresh=fresh
        )
        if ready:
            child.line("enabling device released")
        return child

    def run(
        self,
        *,
        plan: Path | None = None,
        registration: str = "registration.json",
        robot: Path = ROBOT,
        key: str = "site.key",
        logs: str = "logs",
        json: bool = False,
        fd: bool = False,
        fresh: bool = False,
        terminal: bool = False,
        script: Script | None = None,
        more: Sequence[str] = (),
    ) -> Child:
        """The runtime, with these options besides."""
        here = self.folder
        options = [
            "--robot",
            str(robot),
            "--registration",
            str(here / registration),
            "--key",
            str(here / key),
        ]
        options += ["--site", str(here / "site.toml"), "--log-dir", str(here / logs), *self._where]
        options += ["--json"] * json + ["--fd"] * fd + list(more)
        return self._start(
            "runtime",
            "cutgate.runtime.cli",
            ["run", str(plan or here / "plan.json"), *options],
            apart=True,
            fresh=fresh,
            terminal=terminal,
            script=script,
        )

    def conform(self, case: str) -> Child:
        """One case of the negative suite, in a fresh interpreter."""
        options = ["--plant-disconnected", "--only", case, "--key", str(self.folder / "site.key")]
        options += ["--site", str(self.folder / "site.toml"), "--out", str(self.folder / "report.json")]
        return self._start("tester", "cutgate.runtime.cli", ["conform", *options, *self._where], fresh=True)

    # ------------------------------------------------------------ a session's usual way

    def permitted(self, *faults: str, scale: float = 1, **how: Any) -> tuple[Child, Child]:
        """Controller and runtime, permitted, with the enabling device still released."""
        run, sim = self.run(**how), self.sim(*faults, scale=scale)
        run.line("permitted:")
        return sim, run

    def cutting(self, *, scale: float = 1, **how: Any) -> tuple[Child, Child]:
        """Controller and runtime, with the arm moving."""
        sim, run = self.permitted(scale=scale, **how)
        self.begin(sim, run)
        return sim, run

    def begin(self, sim: Child, run: Child) -> None:
        """Hold the enabling device, say start, and see the arm move."""
        mark = len(self.bus.frames)
        sim.say("hold")
        run.line("enabling device is held")
        run.say("start")
        run.line("cutting$")
        self.bus.single(Progress, lambda progress: progress.fraction > 0, after=mark)

    def at_rest(self, sim: Child) -> str:
        """The controller's state once it is without a session and announces itself again."""
        self.bus.frame(lambda m: begins(m, records.Announce), after=len(self.bus.frames))
        return state_of(sim)

    def until(self, condition: Callable[[], object]) -> None:
        """Wait for something that only the system shows."""
        until_s = time.monotonic() + WAIT_S
        while not condition():
            if time.monotonic() > until_s:
                for child in self.children:
                    child.listen()
                raise HungError("\n".join(f"{child.name} said\n{child.told}" for child in self.children))
            select.poll().poll(10.0)

    # ------------------------------------------------------------ what is left behind

    def logs(self, folder: str = "logs") -> list[Path]:
        """The logs, oldest first."""
        return sorted((self.folder / folder).glob("*.mcap"), key=lambda path: path.stat().st_ctime_ns)

    def log(self) -> Log:
        """The last log, read and judged."""
        return judged(self.logs()[-1])


def state_of(sim: Child) -> str:
    """The controller's last word on its state, with its cause in brackets if there is one."""
    sim.listen()
    said = [line.removeprefix("state ") for line in sim.lines if line.startswith("state ")]
    return re.split("[:;]", said[-1])[0]


def session_codes(rig: Rig) -> SessionCodes:
    """What the last OPEN on the bus and the site's key make of the session."""
    request = next(
        e.record for e in reversed(rig.bus.records(CONTROL_IDS[0])) if isinstance(e.record, records.Open)
    )
    return PresharedKey(load_key(rig.folder / "site.key")).session(records.session_digest(request))


# ---------------------------------------------------------------- inputs


def write_inputs(folder: Path) -> None:
    """A short shallow path, its registration, a site and two keys."""
    (folder / "plan.json").write_text(json.dumps(inputs.short_plan()), encoding="utf-8")
    register(folder, "registration")
    (folder / "site.toml").write_text(SITE, encoding="utf-8")
    for name in ("site.key", "wrong.key"):
        if not (folder / name).exists():
            new_key_file(folder / name, secrets.token_bytes(KEY_BYTES))


def register(
    folder: Path, name: str, shift_mm: tuple[float, float, float] = (0, 0, 0), *, now: bool = False
) -> str:
    """Write a registration, taken now or long ago; its file's name."""
    written = registration(name, shift_mm)
    if now:
        written["created_utc"] = f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%S.%fZ}"
    (folder / f"{name}.json").write_text(json.dumps(written), encoding="utf-8")
    return f"{name}.json"


def registration(name: str, shift_mm: tuple[float, float, float] = (0, 0, 0)) -> dict[str, object]:
    """A registration that only shifts; another name makes other bytes, therefore another digest."""
    return {
        "schema": "cutgate.registration/1",
        "id": name,
        "R_T_CT": [[*row[:3], by] for row, by in zip(inputs.UNIT, (*shift_mm, 1), strict=True)],
        "residual_rms_mm": 0.1,
        "created_utc": "2026-01-01T00:00:00Z",
    }
