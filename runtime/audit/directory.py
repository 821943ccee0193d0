"""The log directory: one session at a time, the head of the last one, and what must not get lost beside the logs.

``LOCK`` is held while a session runs. ``HEAD`` says what came last: ``open`` while a log is being written, so that
the next session sees a crash, and ``closed`` with the chain's head afterwards; the latest time at which a session was
closed, which no clock may be behind; and how the list of withdrawn registrations stood, which is nothing that may get
shorter unnoticed. ``WITHDRAWN`` is that list. All of them decide,
and are believed only if they are ours.
"""

import contextlib
import fcntl
import json
import os
import stat
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Any, BinaryIO, Final

from cutgate.config.durable import left_over, replace_durably
from cutgate.config.load import InputError
from cutgate.config.ours import open_ours, read_ours, user
from cutgate.runtime.audit.heads import closing_head, recoverable
from cutgate.runtime.audit.signing.log_key import SERIES_BYTES
from cutgate.runtime.audit.signing.signer import SUFFIX

LOCK: Final = "LOCK"
HEAD: Final = "HEAD"
WITHDRAWN: Final = "WITHDRAWN"
HEAD_MAX: Final = 4096
"""Bytes of HEAD, and what is reserved for the next one."""
LIST_MAX: Final = 10_000_000
"""Bytes of the list, some 200 to an entry."""
TIME_MAX: Final = (1 << 63) - 1
"""Nanoseconds since 1970, to the year 2262."""
_SET_CLOCK: Final = (
    "set the clock; or, if it was wrong when that session was closed, name another folder with --log-dir, "
    "once it is certain that no registration that was withdrawn here is used again"
)
_FREE: Final = "free it, or name another with --log-dir"
_RESTORE: Final = (
    "restore HEAD and WITHDRAWN from a backup; or name another folder with --log-dir, "
    "once it is certain that no registration that was withdrawn here is used again"
)


@dataclass(frozen=True, slots=True)
class Listed:
    """How the list of withdrawn registrations stood: so many lines, with this SHA-256. Lines are only ever added."""

    lines: int = 0
    sha256: str = sha256().hexdigest()

    @classmethod
    def of(cls, data: bytes) -> "Listed":
        """The list as it stands."""
        return cls(data.count(b"\n"), sha256(data).hexdigest())

    def begins(self, data: bytes) -> bool:
        """Whether a list begins with what stood there."""
        lines = data.splitlines(keepends=True)
        return len(lines) >= self.lines and Listed.of(b"".join(lines[: self.lines])) == self


@dataclass(frozen=True, slots=True)
class Head:
    """What HEAD holds.

    Attributes:
        log: the last session's log.
        head: the chain's head at its end; while it is open, that of the session before.
        closed: it was closed in order.
        listed: the list of withdrawn registrations; None in a HEAD of 0.1.0, which did not say.
        time_ns: UTC nanoseconds of the last record of the session that was closed last; while a log is open, that of
            a session before. None where none was ever named, as until 0.1.
        size, root: of the log's tree, root in hex, as ``head`` is of its chain.
        series, epoch: of the log directory, 16 bytes, and the number of the session that has written the log; None
            where logs are not signed.
        before: while it is open, the log of the session before and its epoch.
    """

    log: str
    head: str | None
    closed: bool
    listed: Listed | None = None
    time_ns: int | None = None
    size: int | None = None
    root: str | None = None
    series: bytes | None = None
    epoch: int | None = None
    before: tuple[str | None, int | None] = (None, None)

    def encode(self) -> bytes:
        """The file's content."""
        content: dict[str, Any] = {
            "schema": "cutgate.head/1",
            "log": self.log,
            "state": "closed" if self.closed else "open",
            "head": self.head,
        }
        if self.listed is not None:
            content["withdrawn"] = {"lines": self.listed.lines, "sha256": self.listed.sha256}
        if self.time_ns is not None:
            content["time_ns"] = self.time_ns
        if self.series is not None:
            content |= {
                "series": self.series.hex(),
                "epoch": self.epoch,
                "size": self.size,
                "root": self.root,
            }
        if self.series is not None and not self.closed:
            content["before"] = {"log": self.before[0], "epoch": self.before[1]}
        return json.dumps(content).encode() + b"\n"

    @classmethod
    def parse(cls, data: bytes) -> "Head":
        """Raises ValueError for anything else."""
        try:
            content = json.loads(data)
            log, head, state = content["log"], content["head"], content["state"]
            listed, time_ns = content.get("withdrawn"), content.get("time_ns")
            listed = None if listed is None else Listed(listed["lines"], listed["sha256"])
            size, root, series, epoch = (content.get(key) for key in ("size", "root", "series", "epoch"))
            series = None if series is None else bytes.fromhex(series)
            before = content.get("before") or {}
            before = (before.get("log"), before.get("epoch"))
        except (KeyError, TypeError, AttributeError, RecursionError) as error:
            raise ValueError(f"{type(error).__name__}: {error}") from None
        named = (
            isinstance(log, str) and Path(log).name == log not in ("", "..") and isinstance(head, str | None)
        )
        signed = series is None or (len(series) == SERIES_BYTES and _number(epoch) and epoch is not None)
        signed = signed and _number(size) and isinstance(root, str | None)
        signed = signed and isinstance(before[0], str | None) and _number(before[1])
        counted = listed is None or (isinstance(listed.lines, int) and isinstance(listed.sha256, str))
        timed = time_ns is None or (isinstance(time_ns, int) and 0 <= time_ns <= TIME_MAX)
        if not (named and counted and timed and signed):
            raise ValueError("not a head")
        return cls(log, head, state == "closed", listed, time_ns, size, root, series, epoch, before)


def _number(value: Any) -> bool:
    """Whether it is a count, or absent."""
    return value is None or (isinstance(value, int) and not isinstance(value, bool) and value >= 0)


@dataclass(frozen=True, slots=True)
class Previous:
    """What the directory says of the session before; ``time_ns``, ``size``, ``root`` and ``series`` as in ``Head``.

    Attributes:
        epoch: the last one that a record 0 of this directory names, or may name.
    """

    log: str | None = None
    head: str | None = None
    crashed: bool = False
    note: str | None = None
    time_ns: int | None = None
    size: int | None = None
    root: str | None = None
    series: bytes | None = None
    epoch: int | None = None


# ---------------------------------------------------------------- one session at a time


def lock(directory: Path) -> int:
    """Make the directory if it is missing and lock it; the descriptor that holds the lock.

    Raises:
        InputError: it cannot be made or written, others may delete what is in it, or another session holds it.
    """
    try:
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = directory.stat()
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(
            directory, "log directory", reason, "a directory that can be written", _FREE
        ) from None
    check_ours(directory, found)
    descriptor = open_ours(directory / LOCK, os.O_RDWR | os.O_CREAT)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise InputError(
            directory, "log directory", "in use", "free of any running session", "end the other session"
        ) from None
    return descriptor


def in_use(directory: Path) -> bool:
    """Whether a session holds this directory now; of a folder that is no log directory, no. Whose it is does not matter.

    Raises:
        InputError: the lock cannot be looked at.
    """
    path = directory / LOCK
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        finally:
            os.close(descriptor)
    except FileNotFoundError:
        return False
    except BlockingIOError:
        return True
    except OSError as error:
        told = f"whether a session is writing here cannot be told ({error.strerror})"
        raise InputError(path, "", None, told, "copy log and raw frames to a folder of their own") from None
    return False


def check_ours(directory: Path, found: os.stat_result) -> None:
    """Refuses a log directory of somebody else, or one in which others may delete.

    Raises:
        InputError: names owner and mode.
    """
    if found.st_uid != os.geteuid() or (found.st_mode & 0o022 and not found.st_mode & stat.S_ISVTX):
        value = f"of {user(found.st_uid)}, mode {stat.S_IMODE(found.st_mode):04o}"
        bound = f"of {user(os.geteuid())} and not writable by others, who could delete what must not get lost"
        raise InputError(
            directory, "log directory", value, bound, "chmod 700, or name another with --log-dir"
        )


def check_head(directory: Path, now_ns: int) -> None:
    """Refuses a clock that is behind what HEAD says, by looking at nothing else: for who does not hold the lock.

    Raises:
        InputError: the clock is behind, or HEAD is not ours.
    """
    try:
        head = _read_head(directory)
    except (FileNotFoundError, ValueError):
        return  # nothing says what the clock could be behind
    check_clock(directory, Previous(time_ns=head.time_ns), now_ns)


def remove_left_over(directory: Path) -> None:
    """Remove what a session that was cut short had prepared to put in a file's place; only under the lock."""
    for name in (HEAD, WITHDRAWN, f"*{SUFFIX}"):
        for file in left_over(directory / name):
            with contextlib.suppress(OSError):  # it is in nobody's way
                file.unlink()


# ---------------------------------------------------------------- the session before


def previous_session(directory: Path) -> Previous:
    """What came before, and whether its log is still what HEAD says; read under the lock.

    Raises:
        InputError: HEAD is not ours.
    """
    try:
        head = _read_head(directory)
    except FileNotFoundError:
        return Previous()
    except ValueError as error:
        return Previous(crashed=True, note=f"HEAD could not be read: {error}")
    found = _closed(directory, head) if head.closed else _crashed(directory, head)
    return replace(found, time_ns=head.time_ns, series=head.series)


def check_clock(directory: Path, previous: Previous, now_ns: int) -> None:
    """No session runs with a clock that is behind: its times would lie before those of records that are there.

    Args:
        directory: the log directory.
        previous: what it says of the session before.
        now_ns: the clock, UTC nanoseconds.

    Raises:
        InputError: the clock is behind. Nothing is raised where nothing says what it could be behind.
    """
    then_ns = previous.time_ns
    if then_ns is not None and not now_ns >= then_ns:
        bound = f"at least {_utc(then_ns)}, when a session was closed here"
        raise InputError(directory / HEAD, "this computer's clock", _utc(now_ns), bound, _SET_CLOCK)


def _utc(time_ns: int) -> str:
    second, rest = divmod(time_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(second, UTC):%Y-%m-%dT%H:%M:%S}.{rest:09d}Z"


def _closed(directory: Path, head: Head) -> Previous:
    try:
        with _log(directory, head) as file:
            found = closing_head(file)
    except (OSError, ValueError, InputError) as error:
        note = f"{head.log} is not what HEAD says: {_why(error)}"
    else:
        other = f"{head.log} is not what HEAD says: it ends in head {found}, not {head.head}"
        note = "" if found == head.head else other
    return Previous(head.log, head.head, note=note or None, size=head.size, root=head.root, epoch=head.epoch)


def _crashed(directory: Path, head: Head) -> Previous:
    """The session that was cut short; where it left no record at all, the one before it."""
    try:
        with _log(directory, head) as file:
            found = recoverable(file)
    except (OSError, ValueError, InputError) as error:
        note = f"its log could not be read: {_why(error)}"
        return Previous(head.log, head.head, crashed=True, note=note, epoch=head.epoch)
    if head.series is not None and not found.size:
        log, epoch = head.before
        note = f"{head.log} was begun, and cut short before its first record"
        return Previous(log, head.head, note=note, size=head.size, root=head.root, epoch=epoch)
    root = found.root.hex()
    return Previous(head.log, found.head.hex(), crashed=True, size=found.size, root=root, epoch=head.epoch)


@contextlib.contextmanager
def _log(directory: Path, head: Head) -> Iterator[BinaryIO]:
    with os.fdopen(open_ours(directory / head.log), "rb") as file:
        yield file


def _why(error: Exception) -> str:
    return error.strerror if isinstance(error, OSError) and error.strerror else str(error)


def signed_head(directory: Path) -> Head | None:
    """What HEAD says, for who does not hold the lock; None where there is none, or none that can be read.

    Raises:
        InputError: HEAD is not ours.
    """
    try:
        return _read_head(directory)
    except (OSError, ValueError):
        return None


def _read_head(directory: Path) -> Head:
    """Raises FileNotFoundError, InputError, or ValueError for what is no HEAD."""
    return Head.parse(read_ours(directory / HEAD, HEAD_MAX))


# ---------------------------------------------------------------- the list of withdrawn registrations


def withdrawn_list(directory: Path) -> bytes:
    """The list, if it is whole: it begins with everything that stood there when HEAD was written.

    Raises:
        InputError: it is missing, shorter, altered or not ours; or nothing says any more what stood there.
    """
    file = directory / WITHDRAWN
    try:
        data = read_ours(file, LIST_MAX)
    except FileNotFoundError:
        data = None
    try:
        listed = _read_head(directory).listed
    except (FileNotFoundError, ValueError) as error:
        if _has_logs(directory):
            lost = "missing" if isinstance(error, FileNotFoundError) else f"no head ({error})"
            bound = "there where logs are: it tells whether the list of withdrawn registrations is whole"
            raise InputError(directory / HEAD, "HEAD", lost, bound, _RESTORE) from None
        listed = None
    if listed is not None and not listed.begins(data or b""):
        found = "missing" if data is None else f"{Listed.of(data).lines} lines that are not those"
        bound = f"whole: at least the {listed.lines} lines that stood there before"
        raise InputError(file, "list of withdrawn registrations", found, bound, _RESTORE)
    return data or b""


def extend_list(directory: Path, line: bytes, known: Listed | None = None) -> Listed:
    """Add a line to the list; it is on the disk, and HEAD says so, when this returns.

    Where the list is not whole any more, the line is added to what is there, and HEAD goes on missing the rest.

    Args:
        directory: the log directory, locked by this session.
        line: with its end.
        known: how the list stood when the session began, whatever became of HEAD meanwhile; None if nobody knows.

    Returns:
        How the list stands for HEAD.

    Raises:
        InputError: the list or HEAD is not ours.
        OSError: it cannot be written.
    """
    try:
        before = read_ours(directory / WITHDRAWN, LIST_MAX)
    except FileNotFoundError:
        before = b""
    replace_durably(directory / WITHDRAWN, before + line)
    listed = Listed.of(before + line)
    if known is not None and not known.begins(before):
        return known
    try:
        head = _read_head(directory)
    except (FileNotFoundError, ValueError):
        return listed
    if head.listed is not None and not head.listed.begins(before):
        return head.listed
    replace_durably(directory / HEAD, replace(head, listed=listed).encode())
    return listed


def _has_logs(directory: Path) -> bool:
    """Whether a session has written here; one that was cut short before HEAD left only empty files."""
    return any(file.lstat().st_size > 0 for file in directory.glob("*.mcap"))
