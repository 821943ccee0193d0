"""What runs inside the processes of a system test, and the ways a test bends it.

A program starts either in a fresh interpreter, as a user starts it, or in a process forked from a server that has
imported it already: the same program, 1.5 s earlier. Only a forked runtime can be bent by a :class:`Script`.
"""

import fcntl
import itertools
import multiprocessing
import os
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from cutgate.config.durable import Replacement
from cutgate.firmware_sim import command
from cutgate.firmware_sim.__main__ import main as controller_side
from cutgate.protocol.port import Port
from cutgate.runtime.audit import log as audit_log
from cutgate.runtime.audit.disk import Reservation, SystemDisk
from cutgate.runtime.commands import app, run
from cutgate.runtime.interlock import permissives, table
from cutgate.runtime.interlock.state import Effect, Event, Interlock, Phase, SendBlock
from cutgate.runtime.interlock.tracking import TrackingMonitor
from cutgate.runtime.session import conduct, prover, worker

SECOND_BLOCK = "second block"
MOVING = "moving"
HALF_THE_CUT = "half the cut"
SIDE_FILE_BYTES = 8
LISTEN_S = 0.05
"""A rig's bus is known to be free: the forked controller listens less long before it speaks."""


@dataclass(frozen=True)
class Script:
    """How this runtime differs from an ordinary one.

    Attributes:
        at: a phase, SECOND_BLOCK, MOVING or HALF_THE_CUT; there the process sends itself ``number``.
        sent: not on reaching it, but once the frames of that turn have left.
        number: the signal.
        synced: file that holds the log's size as of its last successful sync.
        sync_s: how long every sync takes.
        unsynced: no sync does anything.
        disk_stops_at: from this phase on no sync answers any more.
        space_unanswered: the reservation of space is never answered.
        blind: names of permissives that this defective runtime takes as true.
        disk_step: the process sends itself ``number`` at this step of the disk: each operation is one before and one
            after it, counted from 0.
        turn: the process sends itself ``number`` after so many times of giving frames to the bus.
        verifier: a program, as text, that runs in place of the verification process.
        unwatched: this defective runtime does not hold measured joints against the verified path either.
    """

    at: str | None = None
    sent: bool = False
    number: int = signal.SIGKILL
    synced: Path | None = None
    sync_s: float = 0.0
    unsynced: bool = False
    disk_stops_at: Phase | None = None
    space_unanswered: bool = False
    blind: tuple[str, ...] = ()
    unwatched: bool = False
    disk_step: int | None = None
    turn: int | None = None
    verifier: str = ""


def serve(streams: Sequence[Connection], program: str, arguments: list[str], script: Script | None) -> None:
    """The body of a forked process: be ``program`` on these three streams."""
    for descriptor, stream in enumerate(streams):
        os.dup2(stream.fileno(), descriptor)
        stream.close()
    sys.stdin = open(0, closefd=False)  # noqa: SIM115 - lives as long as the process
    sys.stdout = open(1, "w", buffering=1, closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", buffering=1, closefd=False)  # noqa: SIM115
    sys.argv = [program, *arguments]
    if program == "cutgate.runtime.cli":
        script = script or Script()
        worker.launch = replaced(script.verifier) if script.verifier else Forked
        bend(script)
        sys.exit(app.execute(arguments))
    command.LISTEN_S = LISTEN_S  # type: ignore[misc]
    sys.exit(controller_side(arguments))


FOREGROUND, BACKGROUND = signal.SIGUSR1, signal.SIGUSR2
"""What a shell is told to do with its job."""


def serve_a_job(
    streams: Sequence[Connection], program: str, arguments: list[str], script: Script | None
) -> None:
    """The body of a shell whose one job is ``program``, in the foreground of the terminal on the first stream.

    It ends with its job's exit code. A hang-up it passes on, as shells do.
    """
    terminal = streams[0].fileno()
    os.setsid()
    fcntl.ioctl(terminal, termios.TIOCSCTTY, 0)
    mine = (FOREGROUND, BACKGROUND, signal.SIGHUP)
    signal.pthread_sigmask(signal.SIG_BLOCK, {*mine, signal.SIGCHLD, signal.SIGTTOU})
    job = os.fork()
    os.setpgid(job, job)  # by both: whoever comes first
    if job == 0:
        os.tcsetpgrp(terminal, os.getpid())
        signal.pthread_sigmask(signal.SIG_SETMASK, ())
        serve(streams, program, arguments, script)
    code = None
    while code is None:
        match signal.sigwait({*mine, signal.SIGCHLD}):
            case signal.SIGHUP:
                os.killpg(job, signal.SIGHUP)
            case signal.SIGCHLD:
                ended, status = os.waitpid(job, os.WNOHANG)
                code = os.waitstatus_to_exitcode(status) if ended else None
            case number:  # as Ctrl-Z and fg or bg: what waits for the terminal begins to wait anew
                os.killpg(job, signal.SIGSTOP)
                os.waitpid(job, os.WUNTRACED)
                os.tcsetpgrp(terminal, job if number == FOREGROUND else os.getpgrp())
                os.killpg(job, signal.SIGCONT)
    os._exit(code if code >= 0 else 128 - code)


def replaced(verifier: str) -> Callable[[int, int], worker.StartedProcess]:
    """Another program in place of the verification process."""

    def launch(path: int, line: int) -> worker.StartedProcess:
        command = [sys.executable, "-c", verifier]
        return subprocess.Popen(
            command, bufsize=0, stdin=path, stdout=line, stderr=subprocess.PIPE, start_new_session=True
        )

    return launch


class Forked:
    """The verification process too is forked instead of started anew; it keeps nothing but its own two descriptors."""

    stderr = None

    def __init__(self, path: int, line: int) -> None:
        context = multiprocessing.get_context("fork")
        self._process = context.Process(target=self._run, args=(path, line), daemon=True)
        self._process.start()
        self.pid = self._process.pid or 0

    @staticmethod
    def _run(path: int, line: int) -> None:
        os.setsid()
        os.dup2(path, 0)
        os.dup2(line, 1)
        os.closerange(3, os.sysconf("SC_OPEN_MAX"))
        prover.main()

    def poll(self) -> int | None:
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        self._process.join(timeout)
        if self._process.exitcode is None:
            raise subprocess.TimeoutExpired("verifier", timeout or 0.0)
        return self._process.exitcode

    def kill(self) -> None:
        self._process.kill()


def bend(script: Script) -> None:
    """Put the script's disk, view and bus port in place of the ordinary ones."""
    trap, disk, turns = Trap(script), BentDisk(script), Steps(script.turn, script.number)
    audit_log.SystemDisk = lambda: disk  # type: ignore[misc, assignment]

    class View(run.SessionView):
        def step(
            self,
            before: Interlock,
            event: Event,
            after: Interlock,
            effects: tuple[Effect, ...],
            now_s: float,
        ) -> None:
            super().step(before, event, after, effects, now_s)
            if after.phase is script.disk_stops_at:
                disk.stopped.set()
            trap.step(before, after, effects)

        def progress(self, segment: int, segments: int) -> None:
            super().progress(segment, segments)
            if segment > 1:
                trap.reached(MOVING)
            if 2 * segment >= segments:
                trap.reached(HALF_THE_CUT)

    class BentPort(Port):
        def flush(self) -> bool:
            left = super().flush()
            trap.flushed()
            turns.step()
            return left

    run.SessionView, conduct.Port = View, BentPort  # type: ignore[misc]
    for name in script.blind:
        permissive: Any = getattr(permissives, name)
        table.FOR_START = tuple(asked for asked in table.FOR_START if asked is not permissive)
    if script.unwatched:
        TrackingMonitor.sample = lambda monitor, *_sample: (monitor, None)  # type: ignore[method-assign]


class Trap:
    """Sends the signal at the scripted moment, once."""

    def __init__(self, script: Script) -> None:
        self._script = script
        self._armed = False
        self._sprung = False

    def step(self, before: Interlock, after: Interlock, effects: tuple[Effect, ...]) -> None:
        if after.phase is not before.phase or after.phase is Phase.WAITING:
            self.reached(after.phase)
        if SendBlock(1) in effects:
            self.reached(SECOND_BLOCK)

    def reached(self, name: str) -> None:
        if name != self._script.at or self._sprung:
            return
        if self._script.sent:
            self._armed = True
        else:
            self._spring()

    def flushed(self) -> None:
        if self._armed:
            self._armed = False
            self._spring()

    def _spring(self) -> None:
        self._sprung = True
        os.kill(os.getpid(), self._script.number)


class Steps:
    """Counts steps, and sends this process the signal at the one given."""

    def __init__(self, at: int | None, number: int) -> None:
        self._at, self._number = at, number
        self._counted = itertools.count()

    def step(self) -> None:
        if next(self._counted) == self._at:
            os.kill(os.getpid(), self._number)

    @contextmanager
    def around(self) -> Iterator[None]:
        """An operation: a step before it, and one after it."""
        self.step()
        yield
        self.step()


class BentDisk(SystemDisk):
    """The system's disk, slowed down or stopped, noting how far the log was synced."""

    def __init__(self, script: Script) -> None:
        self.stopped = threading.Event()
        self._script = script
        self._steps = Steps(script.disk_step, script.number)
        self._log = -1
        self._note = (
            os.open(script.synced, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600) if script.synced else -1
        )

    def create(self, path: Path) -> int:
        with self._steps.around():
            descriptor = super().create(path)
        if path.suffix == ".mcap":
            self._log = descriptor
        return descriptor

    def reserve(self, descriptor: int, path: Path, size: int) -> Reservation:
        if self._script.space_unanswered:
            never()
        with self._steps.around():
            return super().reserve(descriptor, path, size)

    def write(self, descriptor: int, data: memoryview) -> int:
        with self._steps.around():
            return super().write(descriptor, data)

    def trim(self, descriptor: int) -> None:
        with self._steps.around():
            super().trim(descriptor)

    def close(self, descriptor: int) -> None:
        with self._steps.around():
            super().close(descriptor)

    def sync_directory(self, directory: Path) -> None:
        with self._steps.around():
            super().sync_directory(directory)

    def prepare(self, path: Path) -> Replacement:
        with self._steps.around():
            return super().prepare(path)

    def replace(self, prepared: Replacement, data: bytes) -> None:
        with self._steps.around():
            super().replace(prepared, data)

    def sync(self, descriptor: int) -> None:
        if self.stopped.is_set():
            never()
        if self._script.unsynced:
            return
        size = os.fstat(descriptor).st_size
        time.sleep(self._script.sync_s)
        with self._steps.around():
            super().sync(descriptor)
        if descriptor == self._log and self._note >= 0:
            os.pwrite(self._note, size.to_bytes(SIDE_FILE_BYTES, "little"), 0)


def never() -> None:
    """What a disk does that does not answer."""
    threading.Event().wait()


def synced_bytes(note: Path) -> int:
    """How much of the log was durable when this was called."""
    return int.from_bytes(note.read_bytes()[:SIDE_FILE_BYTES], "little") if note.exists() else 0


def fork(
    streams: tuple[int, int, int],
    program: str,
    arguments: list[str],
    script: Script | None,
    body: Callable[..., None] = serve,
) -> BaseProcess:
    """Start a program with these as its standard input, output and error; the streams stay the caller's."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tests.system.children"])
    ends = [
        Connection(os.dup(stream), writable=number > 0, readable=number == 0)
        for number, stream in enumerate(streams)
    ]
    process = context.Process(target=body, args=(ends, program, arguments, script))
    with _one_at_a_time:
        process.start()
    for end in ends:
        end.close()
    return process


def exit_code(process: BaseProcess, timeout_s: float) -> int | None:
    """The exit code of a forked process, negative for a signal; None if it still runs then."""
    if not wait([process.sentinel], timeout_s):
        return None
    with _one_at_a_time:
        process.join(0)
        return process.exitcode


_one_at_a_time = threading.Lock()
"""``Process.start`` looks after all processes of this module, which must not happen while another thread does."""
