"""The commit thread: writes bytes, syncs them, reports how far the log is durable. Nothing else.

Durable means: synced, and found again under its name as it was written (``written``). The disk may take its time or
never answer; whoever hands bytes over never waits for it. After the first error the descriptor is abandoned: nothing
is written, synced or finished any more, because a second fsync may report success for bytes that the first one lost.
"""

import contextlib
import os
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Final

from cutgate.config.durable import Replacement
from cutgate.runtime.audit.directory import HEAD_MAX
from cutgate.runtime.audit.disk import Disk, Reservation
from cutgate.runtime.audit.tree import EMPTY
from cutgate.runtime.audit.written import LostError, Written, identify


@dataclass(frozen=True, slots=True)
class Durable:
    """Everything up to ``offset`` of the log is on the disk, and with it the record named by ``token``.

    Attributes:
        token: of the commit; None where it has no name.
        offset: bytes of the log.
        size, root: of the tree of all records up to the commit's last one; of the empty tree where it has no name.
    """

    token: int | None
    offset: int
    size: int
    root: bytes


@dataclass(frozen=True, slots=True)
class LogFailed:
    """The log cannot be written any more. Reported once."""

    reason: str


@dataclass(frozen=True, slots=True)
class Reserved:
    """The answer to a reservation; its ``size`` is less than ``asked`` where there is no space."""

    asked: int
    reservation: Reservation


@dataclass(frozen=True, slots=True)
class Closed:
    """The log is complete, durable and closed."""


Event = Durable | LogFailed | Reserved | Closed


@dataclass(frozen=True, slots=True)
class Append:
    """Bytes for the log and for the file of raw frames.

    A ``token`` asks for a sync and a report, which repeats size and root of the tree that these bytes complete.
    """

    log: bytes
    frames: bytes
    token: int | None = None
    size: int = 0
    root: bytes = EMPTY


SIDECAR_BYTES: Final = 2048
"""What is reserved for a log's signature; it has some 600."""
UNNAMED: Final = Append(b"", b"")
"""Whose report it is where no commit has a name."""


@dataclass(frozen=True, slots=True)
class ReserveSpace:
    """Space for so many more bytes of log and of raw frames, and for what closing writes beside them."""

    log: int
    frames: int

    @property
    def size(self) -> int:
        """In all, bytes."""
        return self.log + self.frames


@dataclass(frozen=True, slots=True)
class Finish:
    """The last bytes, the signature of so many bytes with this SHA-256, and what the directory's HEAD is to say then."""

    log: bytes
    frames: bytes
    sidecar: Callable[[int, bytes], bytes]
    head: bytes


Job = Append | ReserveSpace | Finish


@dataclass(frozen=True, slots=True)
class LogFiles:
    """The open files of one log, each with its name, and the directory's.

    Attributes:
        log, frames: the log, with record 0 in it, and the raw frames.
        locked: holds the directory's lock, under this name.
        head: what will take HEAD's place when the log is closed.
        sidecar: what will be the log's signature then.
    """

    log: Written
    frames: Written
    locked: tuple[int, Path]
    head: Replacement
    sidecar: Replacement


class Committer:
    """The thread and its two queues. One other thread talks to it; none of these calls waits for the disk."""

    def __init__(self, disk: Disk, files: LogFiles) -> None:
        self._disk = disk
        self._log, self._frames = files.log, files.frames
        self._locked = files.locked
        self._head, self._sidecar = files.head, files.sidecar
        self._jobs: SimpleQueue[Job] = SimpleQueue()
        self._events: deque[Event] = deque()
        self._wake_read, self._wake_write = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._begin()

    def _begin(self) -> None:
        # A daemon: a disk that never answers must not keep the process from ending.
        self._thread = Thread(target=self._run, name="audit-commit", daemon=True)
        self._thread.start()

    def submit(self, job: Job) -> None:
        """Hand a job over."""
        self._jobs.put(job)

    def fileno(self) -> int:
        """Readable while events wait."""
        return self._wake_read

    def events(self) -> list[Event]:
        """What the thread has reported since the last call."""
        with contextlib.suppress(BlockingIOError):
            while os.read(self._wake_read, 4096):
                pass
        found = []
        while self._events:
            found.append(self._events.popleft())
        return found

    def join(self, timeout_s: float) -> bool:
        """Wait for the thread's end, at most so long; whether it has ended."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def discard(self) -> None:
        """Give up what was to take a file's place; nothing is closed in order any more."""
        self._head.discard()
        self._sidecar.discard()

    def release(self) -> None:
        """Close the wake pipe; only after ``join`` said True."""
        os.close(self._wake_read)
        os.close(self._wake_write)

    # ------------------------------------------------------------ the thread

    def _run(self) -> None:
        while not self._done(self._next()):
            pass

    def _done(self, jobs: Sequence[Job]) -> bool:
        """Do the jobs; whether they were the last: the log is closed, or has failed."""
        try:
            ended = self._work(jobs)
        except Exception as error:  # noqa: BLE001 - a thread must not die while its owner believes it runs
            self._report(LogFailed(_reason(error)))
            self.discard()
            ended = True
        if ended:
            for file in (self._log, self._frames):
                with contextlib.suppress(
                    OSError
                ):  # the outcome is reported already; this only frees the number
                    self._disk.close(file.descriptor)
        return ended

    def _next(self) -> list[Job]:
        """All jobs that wait, at least one: a slow disk syncs once for many."""
        jobs = [self._jobs.get()]
        with contextlib.suppress(Empty):
            while True:
                jobs.append(self._jobs.get_nowait())
        return jobs

    def _work(self, jobs: Sequence[Job]) -> bool:
        """Do the jobs; whether the log is closed."""
        appended = [job for job in jobs if not isinstance(job, ReserveSpace)]
        self._append(appended)
        for job in jobs:
            if isinstance(job, ReserveSpace):
                self._report(Reserved(job.size, self._reserve(job)))
            elif isinstance(job, Finish):
                self._finish(job)
                return True
        return False

    def _append(self, jobs: Sequence[Append | Finish]) -> None:
        data = b"".join(job.log for job in jobs)
        named = [job for job in jobs if isinstance(job, Append) and job.token is not None]
        self._check(enabling=False)
        if data:
            self._log.append(data)
        if data or named:
            self._log.sync()
            self._check(enabling=bool(named))
            for job in named or (UNNAMED,):
                self._report(Durable(job.token, self._log.size, job.size, job.root))
        # Raw frames come second: no enabling record waits for them.
        self._frames.append(b"".join(job.frames for job in jobs))

    def _check(self, *, enabling: bool) -> None:
        """What was written is there, in the directory that is locked. Raises LostError or OSError."""
        identify(*self._locked)
        self._log.check(enabling=enabling)
        self._frames.check(enabling=enabling)

    def _reserve(self, job: ReserveSpace) -> Reservation:
        """No space is an answer, not a failure: nothing that was written is lost."""
        try:
            found = (
                self._log.reserve(job.log),
                self._frames.reserve(job.frames),
                self._disk.reserve(self._head.descriptor, self._log.path, HEAD_MAX),
                self._disk.reserve(self._sidecar.descriptor, self._log.path, SIDECAR_BYTES),
            )
        except OSError as error:
            return Reservation(_short_of(job.size, self._log.path), reserved=False, how=_reason(error))
        seen = [reservation for reservation in found if not reservation.reserved]
        if seen:  # one file system: what is free, is free once
            return min(seen, key=lambda reservation: reservation.size)
        return Reservation(job.size, reserved=True, how=found[0].how)

    def _finish(self, job: Finish) -> None:
        self._log.trim()
        self._frames.trim()
        self._log.sync()
        self._frames.sync()
        self._check(enabling=True)
        self._disk.replace(self._sidecar, job.sidecar(self._log.size, self._log.sha256))
        self._disk.replace(self._head, job.head)
        self._report(Closed())

    def _report(self, event: Event) -> None:
        self._events.append(event)
        # A full pipe is readable already.
        with contextlib.suppress(BlockingIOError):
            os.write(self._wake_write, b"\0")


def _short_of(asked: int, path: Path) -> int:
    """How much is free where so much could not be reserved: less, whatever becomes free meanwhile, and not nothing.

    0 is what stands for an answer that has not come yet.
    """
    try:
        free = os.statvfs(path.parent)
    except OSError:
        return 1
    return max(1, min(free.f_bavail * free.f_frsize, asked - 1))


def _reason(error: Exception) -> str:
    if isinstance(error, LostError):
        return str(error)
    if isinstance(error, OSError) and error.errno is not None:
        return f"{os.strerror(error.errno)} (error {error.errno})"
    return f"{type(error).__name__}: {error}"


class InTurn(Committer):
    """The same without a thread: a job is done as it is handed over, for sessions in virtual time."""

    def _begin(self) -> None:
        self._ended = False

    def submit(self, job: Job) -> None:
        """Do a job; whoever hands it over waits for the disk."""
        self._ended = self._ended or self._done([job])

    def join(self, timeout_s: float) -> bool:  # noqa: ARG002 - nothing is waited for
        """Whether the last job was done."""
        return self._ended
