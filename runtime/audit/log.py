"""The audit log of one session: what the session's loop calls.

One thread calls it. No call waits for the disk but ``create``, which runs before a session opens, and ``close``,
which waits for a bounded time.
"""

import contextlib
import importlib.metadata
import json
import os
import platform
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Final, Self

import numpy as np

from cutgate.config.constants import CONSTANTS
from cutgate.config.load import InputError
from cutgate.runtime.audit import records
from cutgate.runtime.audit.commit import (
    Append,
    Closed,
    Committer,
    Durable,
    Event,
    Finish,
    LogFailed,
    LogFiles,
    ReserveSpace,
)
from cutgate.runtime.audit.directory import (
    HEAD,
    LOCK,
    Head,
    Listed,
    Previous,
    check_clock,
    lock,
    previous_session,
    remove_left_over,
    withdrawn_list,
)
from cutgate.runtime.audit.disk import Disk, SystemDisk
from cutgate.runtime.audit.writer import LogWriter

CHUNK_SHARE: Final = 0.8
"""A chunk is handed over at this share of its period, so that it is written within the whole of it."""
_PACKAGES: Final = (
    "cutgate",
    "mcap",
    "numpy",
    "pydantic",
    "python-can",
    "can-isotp",
    "cantools",
    "cryptography",
)


@dataclass(frozen=True, slots=True)
class Clock:
    """The two clocks, nanoseconds."""

    utc_ns: Callable[[], int] = time.time_ns
    monotonic_ns: Callable[[], int] = time.monotonic_ns


@dataclass(frozen=True, slots=True)
class OpenInfo:
    """What record 0 says of the program and of who runs it; ``simulation`` holds options only a simulation has."""

    software: str
    verifier: str
    simulation: tuple[tuple[str, str], ...] = ()
    account: str | None = None
    host: str | None = None
    operator: str | None = None


@dataclass(frozen=True, slots=True)
class Paths:
    """Where the log ended up, and whether it is whole.

    Attributes:
        log: the MCAP file.
        candump: the raw frames beside it.
        closed: the log is complete and durable.
        reason: why not; empty if it is.
    """

    log: Path
    candump: Path
    closed: bool
    reason: str


class AuditLog:
    """A log that is being written. Make one with ``create``.

    Attributes:
        path: the MCAP file.
        candump_path: the raw frames beside it.
        hand_over_after_s: so long a record waits in memory at most.
        previous: what the directory says of the session before.
        listed: how the list of withdrawn registrations stands, for HEAD; whoever adds to it says so here.
    """

    def __init__(
        self,
        path: Path,
        candump_path: Path,
        *,
        writer: LogWriter,
        committer: Committer,
        locked: int,
        clock: Clock,
        chunk_period_s: float,
        previous: Previous,
        listed: Listed,
    ) -> None:
        self.path = path
        self.previous = previous
        self.listed = listed
        self.candump_path = candump_path
        self._writer = writer
        self._committer = committer
        self._locked = locked
        self._clock = clock
        self.hand_over_after_s = CHUNK_SHARE * chunk_period_s
        self._failure = ""
        self._finished = False
        self._closed = False
        self._waiting_since_s: float | None = None
        self._pending: deque[tuple[int, float]] = deque()  # end offset in the file, when handed over
        self._handed = 0
        self._durable = 0
        self._frames: list[bytes] = []
        self._frames_hash = sha256()
        self._frames_bytes = 0

    @classmethod
    def create(
        cls,
        directory: Path,
        *,
        log_id: str,
        opened: OpenInfo,
        disk: Disk | None = None,
        clock: Clock | None = None,
        chunk_period_s: float = CONSTANTS["chunk_period_ms"].default / 1000,
    ) -> Self:
        """Lock the directory, make the files and write record 0. Waits for the disk; call it before a session.

        Args:
            directory: where logs are kept; made if it is missing.
            log_id: names this log; hex.
            opened: what record 0 says of the program.
            disk: the disk operations.
            clock: the clocks.
            chunk_period_s: the longest time a record waits in memory.

        Raises:
            InputError: the directory cannot be used, another session holds it, what decides in it is not ours or not
                whole, or the clock is behind the time at which a session was closed there.
        """
        disk = disk or SystemDisk()
        clock = clock or Clock()
        locked = lock(directory)
        try:
            remove_left_over(directory)
            listed = Listed.of(withdrawn_list(directory))
            previous = previous_session(directory)
            check_clock(directory, previous, clock.utc_ns())
            files = _create_files(disk, directory, log_id, clock.utc_ns(), previous, listed, locked)
        except InputError:
            os.close(locked)
            raise
        except OSError as error:
            os.close(locked)
            reason = error.strerror or str(error)
            raise InputError(
                directory, "log directory", reason, "a directory that can be written", "free the disk"
            ) from None
        log = cls(
            files.log[1],
            files.frames[1],
            writer=LogWriter(log_id, {"software": opened.software}),
            committer=Committer(disk, files),
            locked=locked,
            clock=clock,
            chunk_period_s=chunk_period_s,
            previous=previous,
            listed=listed,
        )
        log.write(_open_record(log_id, opened, files.frames[1].name, previous))
        # Some viewers show nothing of a file without attachments; and a replay on another machine needs it.
        log.attach("environment.json", "application/json", _environment())
        log.commit(None)
        return log

    # ------------------------------------------------------------ writing

    def write(
        self, record: records.LogRecord, *, log_time_ns: int | None = None, monotonic_ns: int | None = None
    ) -> None:
        """Add a record. A decision closes its chunk and is handed over at once.

        After a failure nothing is kept: ``events`` has said so.

        Args:
            record: any of ``records.MODELS``.
            log_time_ns: UTC nanoseconds; now if not given.
            monotonic_ns: monotonic nanoseconds; now if not given.
        """
        if self._stopped:
            return
        self._writer.add(
            record,
            log_time_ns=self._clock.utc_ns() if log_time_ns is None else log_time_ns,
            monotonic_ns=self._clock.monotonic_ns() if monotonic_ns is None else monotonic_ns,
        )
        self._wait()
        if isinstance(record, records.AuditDecision):
            self.commit(None)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Add an attachment and the record of its digest."""
        if self._stopped:
            return
        self._writer.attach(name, media_type, data, log_time_ns=self._clock.utc_ns())
        digest = sha256(data).hexdigest()
        self.write(records.AuditAttachment(name=name, media_type=media_type, sha256=digest, size=len(data)))

    def raw_frame(self, line: bytes) -> None:
        """Add a frame to the file of raw frames: its line of ``protocol.candump``."""
        if self._stopped:
            return
        self._frames.append(line)
        self._frames_hash.update(line)
        self._frames_bytes += len(line)
        self._wait()

    def commit(self, token: int | None) -> None:
        """Hand over everything written so far; ``events`` says when it is durable.

        Args:
            token: names the commit in its ``Durable`` event, which then has size and root of the tree of everything
                written so far; None asks for no name.
        """
        if self._stopped:
            return
        self._writer.close_chunk()
        self._hand_over(token)

    def tick(self, now_s: float) -> None:
        """Hand over what has waited long enough; call it in every cycle of the loop.

        Args:
            now_s: the monotonic clock.
        """
        since_s = self._waiting_since_s
        if since_s is not None and not (now_s - since_s < self.hand_over_after_s):
            self.commit(None)

    def reserve(self, log: int, frames: int) -> None:
        """Ask for space for so many more bytes of log and of raw frames; a ``Reserved`` event answers."""
        if not self._stopped:
            self._committer.submit(ReserveSpace(log, frames))

    # ------------------------------------------------------------ what came of it

    def events(self) -> list[Event]:
        """What the commit thread has reported since the last call; never waits."""
        if self._closed:
            return []
        found = self._committer.events()
        for event in found:
            if isinstance(event, Durable):
                self._durable = event.offset
                while self._pending and self._pending[0][0] <= self._durable:
                    self._pending.popleft()
            elif isinstance(event, LogFailed):
                self._failure = event.reason
                self._frames.clear()
        return found

    def fileno(self) -> int:
        """Readable while events wait."""
        return self._committer.fileno()

    @property
    def writable(self) -> bool:
        """No failure has been reported, and the log is not closed."""
        return not self._stopped

    @property
    def size(self) -> int:
        """Bytes of log handed over so far."""
        return self._handed

    def oldest_pending_s(self, now_s: float) -> float:
        """How long the oldest bytes that are handed over but not durable have waited; 0 if there are none.

        Args:
            now_s: the monotonic clock.
        """
        return now_s - self._pending[0][1] if self._pending else 0.0

    # ------------------------------------------------------------ the end

    def close(
        self,
        *,
        final_state: str,
        verdict: str | None = None,
        outcome: str | None = None,
        clean: bool,
        bus: records.BusCounts | None = None,
        timeout_s: float = CONSTANTS["checkpoint_deadline_ms"].default / 1000,
    ) -> Paths:
        """Write the close record, end the file and wait for the disk, at most ``timeout_s``.

        A log that has failed is left as it is. One whose disk does not answer in time is not closed, and the
        directory stays locked until the process ends.
        """
        if self._closed:
            raise RuntimeError("this log is closed already")
        self.events()
        if not self._stopped:
            self._finish(final_state, verdict, outcome, bus, clean=clean)
        ended = self._committer.join(timeout_s)
        found = self.events()
        self._closed = True
        if ended:
            self._committer.release()
            os.close(self._locked)
        closed = any(isinstance(event, Closed) for event in found)
        reason = "" if closed else self._failure or f"the disk did not answer within {timeout_s:g} s"
        return Paths(self.path, self.candump_path, closed, reason)

    def _finish(
        self,
        final_state: str,
        verdict: str | None,
        outcome: str | None,
        bus: records.BusCounts | None,
        *,
        clean: bool,
    ) -> None:
        now_ns = self._clock.utc_ns()
        self.write(
            records.AuditClose(
                final_state=final_state,
                verdict=verdict,
                outcome=outcome,
                clean=clean,
                message_count=self._writer.count + 1,
                candump_sha256=self._frames_hash.hexdigest(),
                candump_bytes=self._frames_bytes,
                bus=bus,
            ),
            log_time_ns=now_ns,
        )
        self._writer.finish()
        head = Head(
            self.path.name,
            self._writer.head.hex(),
            closed=True,
            listed=self.listed,
            time_ns=max(now_ns, self.previous.time_ns or 0),
        )
        self._finished = True
        self._committer.submit(Finish(self._writer.take(), b"".join(self._frames), head.encode()))

    # ------------------------------------------------------------ inside

    @property
    def _stopped(self) -> bool:
        return bool(self._failure) or self._finished or self._closed

    @property
    def _now_s(self) -> float:
        return self._clock.monotonic_ns() / 1e9

    def _wait(self) -> None:
        if self._waiting_since_s is None:
            self._waiting_since_s = self._now_s

    def _hand_over(self, token: int | None) -> None:
        data = self._writer.take()
        job = Append(data, b"".join(self._frames))
        if token is not None:
            tree = self._writer.tree
            job = replace(job, token=token, size=tree.size, root=tree.root)
        self._committer.submit(job)
        self._frames.clear()
        self._waiting_since_s = None
        if data:
            self._handed += len(data)
            self._pending.append((self._handed, self._now_s))


def cpu_dispatch() -> tuple[str, ...]:
    """The SIMD extensions numpy uses on this machine."""
    extensions = np.show_config(mode="dicts")["SIMD Extensions"]
    return (*extensions.get("baseline", ()), *extensions.get("found", ()))


def _create_files(
    disk: Disk,
    directory: Path,
    log_id: str,
    utc_ns: int,
    previous: Previous,
    listed: Listed,
    locked: int,
) -> LogFiles:
    """The two files, HEAD marked open, the next HEAD prepared, all names durable. Raises OSError."""
    moment = datetime.fromtimestamp(utc_ns // 1_000_000_000, UTC)
    name = f"{moment:%Y%m%dT%H%M%SZ}-{log_id[:8]}"
    path, candump = directory / f"{name}.mcap", directory / f"{name}.candump.log"
    made: list[int] = []
    try:
        made.extend(disk.create(file) for file in (path, candump))
        opened = Head(path.name, previous.head, closed=False, listed=listed, time_ns=previous.time_ns)
        disk.replace(disk.prepare(directory / HEAD), opened.encode())
        head = disk.prepare(directory / HEAD)
        disk.sync_directory(directory)
    except OSError:
        for descriptor in made:
            with contextlib.suppress(OSError):
                disk.close(descriptor)
        raise
    return LogFiles((made[0], path), (made[1], candump), (locked, directory / LOCK), head)


def _open_record(log_id: str, opened: OpenInfo, candump: str, previous: Previous) -> records.AuditOpen:
    return records.AuditOpen(
        log_id=log_id,
        software=opened.software,
        verifier=opened.verifier,
        numpy=np.__version__,
        cpu_dispatch=cpu_dispatch(),
        candump=candump,
        previous_log=previous.log,
        previous_head=previous.head,
        previous_crashed=previous.crashed,
        previous_note=previous.note,
        simulation=tuple(records.Option(name=name, value=value) for name, value in opened.simulation),
        account=opened.account,
        host=opened.host,
        operator=opened.operator,
    )


def _environment() -> bytes:
    """Interpreter, machine and versions of the packages that matter, as JSON."""
    packages = {}
    for package in _PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            packages[package] = importlib.metadata.version(package)
    content = {"python": platform.python_version(), "machine": platform.machine(), "packages": packages}
    return json.dumps(content, sort_keys=True).encode()
