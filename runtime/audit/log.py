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
from functools import cached_property, partial
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
from cutgate.runtime.audit.log_keys import HeldKey, held_key, put_following
from cutgate.runtime.audit.signing.signer import Signer, sidecar_of
from cutgate.runtime.audit.writer import LogWriter
from cutgate.runtime.audit.written import Written

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
    transitions_sha256: str | None = None


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
        held: the key that signs it, and where it came from.
        commit_s: how long the last commit took, from handing over to being told that it is durable; None before the first.
    """

    def __init__(
        self,
        path: Path,
        candump_path: Path,
        *,
        writer: LogWriter,
        signer: Signer,
        held: HeldKey,
        committer: Committer,
        locked: int,
        clock: Clock,
        chunk_period_s: float,
        previous: Previous,
        listed: Listed,
        written: int,
    ) -> None:
        self.path = path
        self.held = held
        self._signer = signer
        self.previous = previous
        self.listed = listed
        self.candump_path = candump_path
        self._writer = writer
        self._committer = committer
        self._locked = locked
        self._clock = clock
        self.hand_over_after_s = CHUNK_SHARE * chunk_period_s
        self.commit_s: float | None = None
        self._failure = ""
        self._finished = False
        self._closed = False
        self._waiting_since_s: float | None = None
        self._pending: deque[tuple[int, float]] = deque()  # end offset in the file, when handed over
        self._handed = self._durable = written
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
        key_file: Path | None = None,
        disk: Disk | None = None,
        clock: Clock | None = None,
        chunk_period_s: float = CONSTANTS["chunk_period_ms"].default / 1000,
        committer: Callable[[Disk, LogFiles], Committer] = Committer,
    ) -> Self:
        """Lock the directory, make the files and write record 0. Waits for the disk; call it before a session.

        The order is what counts: HEAD says that a log is open; record 0, which names the session's key, is durable;
        the next session's key takes the place of this one's, which lives on in memory alone; only then comes the
        second record. Whatever is cut short in between, no key signs two sessions and no epoch is left out.

        Args:
            directory: where logs are kept; made if it is missing.
            log_id: names this log; hex.
            opened: what record 0 says of the program.
            key_file: of the log directory's key; None for where its first session has put it.
            disk: the disk operations.
            clock: the clocks.
            chunk_period_s: the longest time a record waits in memory.
            committer: who writes and syncs the files.

        Raises:
            InputError: the directory cannot be used, another session holds it, what decides in it is not ours or not
                whole, the clock is behind the time at which a session was closed there, or its key cannot be had.
        """
        disk = disk or SystemDisk()
        clock = clock or Clock()
        locked = lock(directory)
        try:
            remove_left_over(directory)
            listed = Listed.of(withdrawn_list(directory))
            previous = previous_session(directory)
            check_clock(directory, previous, clock.utc_ns())
            held = held_key(directory, previous, key_file, disk)
            previous = held.noted(previous)
            begun = _Begun(log_id, opened, held, previous, listed, clock)
            files, writer = begun.files(disk, directory, locked)
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
            files.log.path,
            files.frames.path,
            writer=writer,
            signer=begun.signer,
            held=held,
            committer=committer(disk, files),
            locked=locked,
            clock=clock,
            chunk_period_s=chunk_period_s,
            previous=previous,
            listed=listed,
            written=files.log.size,
        )
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
                written so far, as the checkpoint signs it that is written with it; None asks for no name.
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
                if self._pending and self._pending[0][0] <= self._durable:
                    self.commit_s = self.oldest_pending_s(self._now_s)
                while self._pending and self._pending[0][0] <= self._durable:
                    self._pending.popleft()
            elif isinstance(event, LogFailed):
                self._failure = event.reason
                self._frames.clear()
        return found

    def utc_ns(self) -> int:
        """The time of day by the log's clock, nanoseconds since 1970."""
        return self._clock.utc_ns()

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

    @property
    def waiting_bytes(self) -> int:
        """Bytes that are handed over but not known to be durable."""
        return self._handed - self._durable

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
        self._writer.close_chunk()
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
        tree, key = self._writer.tree, self.held.key
        head = Head(
            self.path.name,
            self._writer.head.hex(),
            closed=True,
            listed=self.listed,
            time_ns=max(now_ns, self.previous.time_ns or 0),
            size=tree.size,
            root=tree.root.hex(),
            series=key.series,
            epoch=key.epoch,
        )
        self._finished = True
        sign = partial(self._signer.sidecar, tree.size, tree.root)
        self._committer.submit(Finish(self._writer.take(), b"".join(self._frames), sign, head.encode()))

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
            size, root = self._writer.signed
            job = replace(job, token=token, size=size, root=root)
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


@dataclass(frozen=True)
class _Begun:
    """A log that begins: its files, with record 0 alone in them, and the key of the next session in this one's place."""

    log_id: str
    opened: OpenInfo
    held: HeldKey
    previous: Previous
    listed: Listed
    clock: Clock

    @cached_property
    def signer(self) -> Signer:
        """Signs it."""
        return Signer(self.held.key, self.log_id)

    def files(self, disk: Disk, directory: Path, locked: int) -> tuple[LogFiles, LogWriter]:
        """The files, all names durable and HEAD marked open, and what goes on writing. Raises OSError, InputError."""
        moment = datetime.fromtimestamp(self.clock.utc_ns() // 1_000_000_000, UTC)
        name = f"{moment:%Y%m%dT%H%M%SZ}-{self.log_id[:8]}"
        log, frames = directory / f"{name}.mcap", directory / f"{name}.candump.log"
        with contextlib.ExitStack() as undone:
            made = []
            for path in (log, frames):
                descriptor = disk.create(path)
                undone.callback(_close, disk, descriptor)
                made.append(Written(disk, descriptor, path))
            disk.replace(disk.prepare(directory / HEAD), self._head(log.name).encode())
            head = disk.prepare(directory / HEAD)
            undone.callback(head.discard)
            sidecar = disk.prepare(sidecar_of(log))
            undone.callback(sidecar.discard)
            disk.sync_directory(directory)
            writer = LogWriter(self.log_id, {"software": self.opened.software}, self.signer)
            now = {"log_time_ns": self.clock.utc_ns(), "monotonic_ns": self.clock.monotonic_ns()}
            writer.add(self._record_0(frames.name), **now)
            writer.close_chunk(signed=False)
            made[0].append(writer.take())
            made[0].sync()
            put_following(self.held, disk)
            undone.pop_all()
        return LogFiles(made[0], made[1], (locked, directory / LOCK), head, sidecar), writer

    def _head(self, log: str) -> Head:
        before, key = self.previous, self.held.key
        return Head(
            log, before.head, closed=False, listed=self.listed, time_ns=before.time_ns, size=before.size,
            root=before.root, series=key.series, epoch=key.epoch, before=(before.log, before.epoch),
        )  # fmt: skip

    def _record_0(self, candump: str) -> records.AuditOpen:
        opened, previous, key = self.opened, self.previous, self.held.key.public
        return records.AuditOpen(
            log_id=self.log_id,
            software=opened.software,
            verifier=opened.verifier,
            transitions_sha256=opened.transitions_sha256,
            numpy=np.__version__,
            cpu_dispatch=cpu_dispatch(),
            candump=candump,
            previous_log=previous.log,
            previous_head=previous.head,
            previous_size=previous.size,
            previous_root=previous.root,
            previous_epoch=previous.epoch,
            previous_crashed=previous.crashed,
            previous_note=previous.note,
            simulation=tuple(records.Option(name=name, value=value) for name, value in opened.simulation),
            account=opened.account,
            host=opened.host,
            operator=opened.operator,
            series=key.series.hex(),
            epoch=key.epoch,
            public_key=key.public.hex(),
            certificate=key.certificate.hex() if key.certificate else None,
            enrolled=self.held.enrolled,
        )


def _close(disk: Disk, descriptor: int) -> None:
    with contextlib.suppress(OSError):  # why it is given up is known already
        disk.close(descriptor)


def _environment() -> bytes:
    """Interpreter, machine and versions of the packages that matter, as JSON."""
    packages = {}
    for package in _PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            packages[package] = importlib.metadata.version(package)
    content = {"python": platform.python_version(), "machine": platform.machine(), "packages": packages}
    return json.dumps(content, sort_keys=True).encode()
