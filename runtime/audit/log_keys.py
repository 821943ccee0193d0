"""The key of a log directory: where it is kept, which epoch signs the next session, and that none signs two.

The file holds one key, that of the next session. As soon as a session's record 0 is durable, the key after it takes its
place in the file. Where a session was cut short in between, HEAD's log names the epoch that the file still holds: then
that one has been used, and is replaced before anything else. A file that is older than the directory was put back, from
a backup perhaps, and is refused: its epochs have signed already.

The first session of a directory enrols a key: it makes one in the user's state directory, outside the log directory,
so that whoever takes or rewrites the logs does not hold it too.
"""

import os
import pwd
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Final

from cutgate.config.durable import create_durably, left_over
from cutgate.config.load import InputError
from cutgate.config.ours import read_ours
from cutgate.runtime.audit.container.scan import walk
from cutgate.runtime.audit.container.stored import Scan
from cutgate.runtime.audit.directory import HEAD, Previous, signed_head
from cutgate.runtime.audit.disk import Disk
from cutgate.runtime.audit.judge import parse_object
from cutgate.runtime.audit.records import AuditOpen
from cutgate.runtime.audit.signing.log_key import (
    FILE_MAX,
    FIRST_EPOCH,
    KEY_BYTES,
    SERIES_BYTES,
    LogKey,
    PublicLogKey,
)
from cutgate.runtime.audit.signing.note import NoteError
from cutgate.runtime.audit.signing.signatures import key_of
from cutgate.runtime.audit.witness import BEGINNING

ENROLLED_HERE: Final = "enrolled here"
ENROLLED_ANEW: Final = "enrolled anew: no key before it certifies it"
PUBLIC_SUFFIX: Final = ".pub"
_KEYS: Final = Path("cutgate") / "log-keys"
_CONTINUE: Final = "if the key is lost, enrol a new one: cutgate key new --log FILE --continues {directory}, then name it with --log-key"
_OTHER: Final = "name this log directory's own key with --log-key, or another log directory with --log-dir"


@dataclass(frozen=True, slots=True)
class HeldKey:
    """The key that signs a session.

    Attributes:
        key: the session's.
        path: the file of the log directory's next key.
        enrolled: why nobody certified this key; None where the one before did.
        made: it was made just now.
        note: what is not as it should be; None if all is.
    """

    key: LogKey
    path: Path
    enrolled: str | None = None
    made: bool = False
    note: str | None = None

    def noted(self, previous: Previous) -> Previous:
        """What is said of the session before, with what the key tells of it."""
        return replace(previous, note="; ".join(filter(None, (previous.note, self.note))) or None)


def held_key(directory: Path, previous: Previous, key_file: Path | None, disk: Disk) -> HeldKey:
    """The key for the next session of a log directory that is locked.

    Args:
        directory: of the logs.
        previous: what it says of the session before.
        key_file: the key's file; None for where the first session has put it.
        disk: the disk operations.

    Raises:
        InputError: there is none, it is not ours or another directory's, it is older than the directory, or the file
            cannot be written.
    """
    if previous.series is None:
        _unsigned(directory, previous)
        return _enrolled(key_file)
    path = key_file or default_path(previous.series)
    for file in left_over(path):
        file.unlink(missing_ok=True)
    held = HeldKey(_read(path, directory), path)
    _belongs(held, directory, previous)
    used = previous.epoch or 0
    if held.key.epoch == used:
        held = replace(held, key=put_following(held, disk))
    if held.key.epoch > used + 1:
        missing = f"sessions {used + 1} to {held.key.epoch - 1} of this log directory are missing from it"
        held = replace(held, note=missing)
    return held if held.key.certificate else replace(held, enrolled=ENROLLED_ANEW)


def key_in_log(path: Path) -> PublicLogKey | None:
    """The key that a log's record 0 names; None where there is none, or no log."""
    try:
        if not path.is_file():
            return None
        with path.open("rb") as file:
            first = next(walk(BytesIO(file.read(BEGINNING)), Scan()), None)
        if first is None or first.topic != AuditOpen.TOPIC:
            return None
        return key_of(parse_object(first.data) or {})
    except (OSError, NoteError):
        return None


def _unsigned(directory: Path, previous: Previous) -> None:
    """Raises InputError where HEAD names no series and its log does: else a series would end by a line taken out of HEAD."""
    key = key_in_log(directory / previous.log) if previous.log else None
    if key is not None:
        bound = f"{key.series.hex()}, as {previous.log} names it"
        remedy = "restore HEAD from a backup, or name another log directory with --log-dir"
        raise InputError(directory / HEAD, "series", "missing", bound, remedy)


def check_key(directory: Path, key_file: Path | None) -> None:
    """Refuses what ``held_key`` would, for who does not hold the lock; nothing is made or changed.

    Raises:
        InputError: as ``held_key``.
    """
    head = signed_head(directory)
    if head is None or head.series is None:
        _unsigned(directory, Previous(log=head.log if head else None))
        if key_file is not None:
            _unused(key_file)
        return
    path = key_file or default_path(head.series)
    _belongs(HeldKey(_read(path, directory), path), directory, Previous(series=head.series, epoch=head.epoch))


def put_following(held: HeldKey, disk: Disk) -> LogKey:
    """Put the next session's key in the file, in the place of this one's; it is on the disk when this returns.

    Raises:
        InputError: it cannot be written.
    """
    following = held.key.following(os.urandom(KEY_BYTES))
    try:
        disk.replace(disk.prepare(held.path), following.encode())
    except OSError as error:
        raise _unwritten(held.path, error) from None
    return following


def new_log_key(path: Path, *, series: bytes | None = None, epoch: int = FIRST_EPOCH) -> LogKey:
    """A new key in a new file, and its public half beside it; nobody certifies it.

    Args:
        path: of the key; nothing stands there.
        series: of a log directory that has lost its key; drawn if not given.
        epoch: of its next session.

    Raises:
        InputError: something stands there, or it cannot be written.
    """
    key = LogKey(series or os.urandom(SERIES_BYTES), epoch, os.urandom(KEY_BYTES))
    try:
        create_durably(path, key.encode())
        create_durably(public_path(path), key.public.encode(), ours=False)
    except FileExistsError as error:
        where = Path(error.filename or path)
        raise InputError(where, "", None, "exists and is never overwritten", "name another file") from None
    except OSError as error:
        raise _unwritten(path, error) from None
    return key


def to_continue(directory: Path) -> tuple[bytes, int]:
    """Series and epoch of the next session of a log directory, whose key is lost or too old.

    Raises:
        InputError: no session was signed in it, or HEAD is not ours or cannot be read.
    """
    head = signed_head(directory)
    if head is None or head.series is None or head.epoch is None:
        bound = "HEAD of a log directory in which a session was signed"
        remedy = "leave --continues away where none was, or name the log directory"
        raise InputError(directory, "log directory", None, bound, remedy)
    return head.series, head.epoch + 1


def public_path(path: Path) -> Path:
    """Where the public half of a key stands when it is made."""
    return path.with_name(path.name + PUBLIC_SUFFIX)


def default_path(series: bytes) -> Path:
    """Where a log directory's key is kept if nothing else is said: in the user's state directory.

    Raises:
        InputError: there is none.
    """
    given = os.environ.get("XDG_STATE_HOME", "")
    base = Path(given) if Path(given).is_absolute() else _home() / ".local" / "state"
    return base / _KEYS / f"{series.hex()}.key"


def _home() -> Path:
    try:
        home = os.environ.get("HOME") or pwd.getpwuid(os.geteuid()).pw_dir
    except KeyError:
        home = ""
    if not Path(home).is_absolute():
        remedy = "name the log directory's key with --log-key, or set XDG_STATE_HOME"
        raise InputError(
            "the user's state directory", "", None, "neither HOME nor the system names one", remedy
        )
    return Path(home)


def _enrolled(key_file: Path | None) -> HeldKey:
    """The key of a directory that has none yet."""
    if key_file is None:
        series = os.urandom(SERIES_BYTES)
        path = default_path(series)
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise _unwritten(path, error) from None
        return HeldKey(new_log_key(path, series=series), path, ENROLLED_HERE, made=True)
    return HeldKey(_unused(key_file), key_file, ENROLLED_HERE)


def _unused(key_file: Path) -> LogKey:
    """A key that has signed nothing yet, for a directory's first session."""
    key = _read(key_file, None)
    if key.epoch != FIRST_EPOCH or key.certificate:
        bound = f"epoch {FIRST_EPOCH}, for a log directory in which no session was signed yet"
        remedy = "make one for this directory with: cutgate key new --log FILE"
        raise InputError(key_file, "epoch", key.epoch, bound, remedy)
    return key


def _read(path: Path, directory: Path | None) -> LogKey:
    try:
        data = read_ours(path, FILE_MAX, secret=True)
    except FileNotFoundError:
        remedy = (
            _CONTINUE.format(directory=directory)
            if directory
            else "make one with: cutgate key new --log FILE"
        )
        raise InputError(path, "", None, "there is no such log key", remedy) from None
    try:
        return LogKey.parse(data)
    except ValueError as error:
        raise InputError(path, "", None, f"no log key: {error}", "restore the file") from None


def _belongs(held: HeldKey, directory: Path, previous: Previous) -> None:
    """Raises InputError unless the key is this directory's, and of a session that is still to come or was the last."""
    key, series, used = held.key, previous.series, previous.epoch or 0
    if series is not None and key.series != series:
        raise InputError(
            held.path, "series", key.series.hex(), f"{series.hex()}, as {directory / HEAD} says", _OTHER
        )
    if not key.epoch >= used:
        bound = (
            f"at least {used}: the last session in {directory} has that, and an older key has signed already"
        )
        remedy = f"an old file was put back; {_CONTINUE.format(directory=directory)}"
        raise InputError(held.path, "epoch", key.epoch, bound, remedy)


def _unwritten(path: Path, error: OSError) -> InputError:
    reason = f"cannot be written ({error.strerror})"
    return InputError(
        path, "", None, reason, "free the disk, or name a file that can be written with --log-key"
    )
