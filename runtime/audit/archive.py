"""Moving old sessions to another folder, so that nothing is lost or doubled whatever is cut short in between.

A session's files are copied, synced and compared by their SHA-256; then its stub is written beside the other logs
(``stub.py``); only then the files are removed, the log last. Each of these is durable before the next begins, none
overwrites anything, and all are done under the folder's lock. Whoever asks again after a cut finds either the log, or
log and stub, or the stub alone, and goes on from there.

``plan`` decides and does nothing else.
"""

import contextlib
import os
from base64 import b64encode
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Final, NamedTuple

from cutgate.config.durable import left_over, replace_durably, sync_folder, write_all
from cutgate.config.load import InputError
from cutgate.config.ours import open_ours, read_ours
from cutgate.config.screen import printable
from cutgate.runtime.audit.container.scan import walk
from cutgate.runtime.audit.container.stored import Scan
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.proving import prove
from cutgate.runtime.audit.reading import candump_of
from cutgate.runtime.audit.series import SeriesFound
from cutgate.runtime.audit.series_facts import FolderSession
from cutgate.runtime.audit.signing import note as notes
from cutgate.runtime.audit.signing.note import VerifierKey
from cutgate.runtime.audit.signing.proof import RecordProof
from cutgate.runtime.audit.signing.signer import sidecar_of
from cutgate.runtime.audit.stub import STUB_MAX, MovedFile, Stub, stub_name

PART: Final = 1 << 20
"""So many bytes are copied at a time."""
_MAKE: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
_MODE: Final = 0o600
_COMPARE: Final = "compare the two; if the other one is of no use, move it away, and ask again"


class Kept(NamedTuple):
    """A session that was asked for and stays; ``wrong``: because it, or its place among the others, is not sound."""

    session: FolderSession
    why: str
    wrong: bool


@dataclass(frozen=True, slots=True)
class ArchivePlan:
    """What is moved, oldest first, and what stays though it was asked for."""

    moved: tuple[FolderSession, ...]
    kept: tuple[Kept, ...]


def plan(
    found: SeriesFound,
    *,
    keep: int | None = None,
    before_ns: int | None = None,
    named: frozenset[str] = frozenset(),
) -> ArchivePlan:
    """Which sessions are moved.

    Args:
        found: what the folder is.
        keep: so many stay, the newest; None where their time decides.
        before_ns: what was opened earlier is moved, UTC nanoseconds.
        named: logs that the next session looks into.
    """
    ordered = [one.session for one in found.joined if one.placed]
    wrong = {finding.file: finding.code for finding in found.findings if finding.status is Status.TAMPERED}
    last = len(ordered) - 1
    seen = max((at for at, one in enumerate(ordered) if one.starts), default=last)
    asked = [
        (at, one)
        for at, one in enumerate(ordered)
        if not one.archived and (at <= last - keep if keep is not None else one.opened_ns < (before_ns or 0))
    ]
    moved: list[FolderSession] = []
    kept = [
        Kept(one.session, "it is TAMPERED, and has no place among the others", wrong=True)
        for one in found.joined
        if not one.placed and one.session.status is Status.TAMPERED
    ]
    for at, one in asked:
        why = _stays(at, one, last, seen, wrong, named)
        if why is None:
            moved.append(one)
        else:
            kept.append(why)
    return ArchivePlan(tuple(moved), tuple(kept))


def _stays(
    at: int, one: FolderSession, last: int, seen: int, wrong: dict[str, str], named: frozenset[str]
) -> Kept | None:
    """Why a session stays; None if it does not."""
    rules = (
        (at == last, "it is the newest", False),
        (
            at >= seen,
            "the last start was in it or before it, and a controller may still name that",
            False,
        ),
        (one.file in named, "WITHDRAWN names it, and the next session looks into it", False),
        (one.status not in (Status.OK, Status.INCOMPLETE), f"it is {one.status.name}", True),
        (one.file in wrong, f"its place among the others is not sound: {wrong.get(one.file)}", True),
    )
    return next((Kept(one, why, is_wrong) for holds, why, is_wrong in rules if holds), None)


# ---------------------------------------------------------------- moving


def files_of_session(log: Path) -> tuple[Path, ...]:
    """The log, and what stands beside it of its session."""
    return (log, *(path for path in (candump_of(log), sidecar_of(log)) if os.path.lexists(path)))


def archive(folder: Path, session: FolderSession, target: Path) -> Stub:
    """Move one session's files; the stub is left in their place.

    Args:
        folder: of the logs, locked.
        session: as it was read, OK or INCOMPLETE.
        target: the other folder; it is there.

    Raises:
        InputError: something else stands in the way, or a file is not ours or has changed.
        OSError: an error of the disk; what was not removed yet is still there.
    """
    log = folder / session.file
    proof, record = _proven(log, session)
    moved = tuple(copied(path, target) for path in files_of_session(log))
    stub = Stub(
        session.file, session.status, session.closed, session.size, session.root or "", session.head,
        session.last_ns, proof, record, printable(str(target.absolute())), moved,
    )  # fmt: skip
    left = stub.encode()
    _held_to(left, session)
    _left_behind(folder / stub_name(session.file), left)
    removed(folder, stub, target)
    return stub


def _left_behind(path: Path, data: bytes) -> None:
    """The stub, which is there as a whole or not at all, wherever this is cut short."""
    for file in left_over(path):
        file.unlink()
    if os.path.lexists(path):
        raise InputError(path, "", None, "is there already", "see what `audit verify` says of the folder")
    replace_durably(path, data)


def _held_to(left: bytes, session: FolderSession) -> None:
    """What stands in the place of a log says what the log said, and verifies: read as it will be read.

    Raises:
        InputError: it does not, so the log stays.
    """
    try:
        found, _ = Stub.parse(left).session()
    except ValueError as error:
        reason = f"cannot be told by a stub: {error}"
        raise InputError(session.file, "", None, reason, "see what `audit verify` says of it") from None
    for name in (
        "file",
        "status",
        "log_id",
        "key",
        "previous",
        "enrolled",
        "closed",
        "size",
        "root",
        "head",
        "last_ns",
    ):
        if getattr(found, name) != getattr(session, name):
            what = f"its stub says another {name} than the log"
            raise InputError(session.file, "", None, what, "see what `audit verify` says of it")


def removed(folder: Path, stub: Stub, target: Path) -> tuple[str, ...]:
    """Remove what a stub names and is still here, once it is certain that the copy is the same; the names.

    Raises:
        InputError: the copy is not there or another one, or the file has changed.
        OSError: an error of the disk.
    """
    left = [entry for entry in reversed(stub.moved) if os.path.lexists(folder / entry.name)]
    for entry in left:
        for path in (target / entry.name, folder / entry.name):
            if not os.path.lexists(path):
                raise InputError(path, "", None, "no such file", "name the folder that it was archived to")
            found = _digest(path)
            if found != (entry.size, entry.sha256):
                bound = f"SHA-256 {entry.sha256}, as {stub_name(stub.log)} has it"
                raise InputError(path, "", f"SHA-256 {found[1]}", bound, _COMPARE)
        (folder / entry.name).unlink()
        sync_folder(folder)
    return tuple(entry.name for entry in left)


def copied(source: Path, target: Path) -> MovedFile:
    """Copy a file into a folder; it is there, synced and the same, when this returns. Never overwrites.

    Raises:
        InputError: another file of this name is there, the copy differs, or the source is not ours.
        OSError: it cannot be read or written; nothing is left of the copy.
    """
    copy = target / source.name
    for file in left_over(copy):
        file.unlink()
    if not os.path.lexists(copy):
        _copy(source, copy)
    size, digest = _digest(source)
    if _digest(copy) != (size, digest):
        raise InputError(copy, "", "there, and another file", f"not there, or the same as {source}", _COMPARE)
    return MovedFile(source.name, size, digest)


def _copy(source: Path, copy: Path) -> None:
    """The bytes under a fresh name, then the name: what has the name is whole."""
    fresh = copy.with_name(f".{copy.name}.{os.urandom(8).hex()}.new")
    descriptor = os.open(fresh, _MAKE, _MODE)
    try:
        try:
            for part in _parts(source):
                write_all(descriptor, part)
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        _name(fresh, copy)
    except BaseException:
        with contextlib.suppress(OSError):  # whoever asks again removes it
            fresh.unlink()
        raise
    sync_folder(copy.parent)


def _name(fresh: Path, copy: Path) -> None:
    """Give a file its name, which nothing has; a file system without hard links cannot be asked both at once."""
    try:
        os.link(fresh, copy, follow_symlinks=False)
    except OSError:
        if os.path.lexists(copy):
            raise
        fresh.rename(copy)
    else:
        fresh.unlink()


def _parts(path: Path) -> Iterator[bytes]:
    with os.fdopen(open_ours(path), "rb") as file:
        while part := file.read(PART):
            yield part


def _digest(path: Path) -> tuple[int, str]:
    """Bytes and SHA-256."""
    size, digest = 0, sha256()
    for part in _parts(path):
        size += len(part)
        digest.update(part)
    return size, digest.hexdigest()


def _proven(log: Path, session: FolderSession) -> tuple[str | None, bytes | None]:
    """The proof of record 0; or record 0 itself, where no checkpoint signs it."""
    if session.signed:  # one that was cut before its first checkpoint has no proof
        proof = prove(log, 0, latest=True)
        return replace(proof, checkpoint=_by_the_log_alone(proof)).encode().decode(), None
    with os.fdopen(open_ours(log), "rb") as file:
        first = next(walk(file, Scan()))
        return None, first.covered


def _by_the_log_alone(proof: RecordProof) -> str:
    """The checkpoint without the lines of witnesses, which stand in the signature that is moved."""
    note = notes.parse(proof.checkpoint)
    key = VerifierKey(note.text.partition("\n")[0], proof.public)
    (own, *_) = (data for name, key_id, data in note.signatures if (name, key_id) == (key.name, key.id))
    return f"{note.text}\n\u2014 {key.name} {b64encode(key.id + own).decode()}\n"


def read_stub(path: Path) -> Stub:
    """A stub in a folder that is locked.

    Raises:
        InputError: it is not ours, or no stub.
    """
    try:
        return Stub.parse(read_ours(path, STUB_MAX))
    except ValueError as error:
        raise InputError(
            path, "", None, f"no stub of an archived log: {error}", "restore it from a backup"
        ) from None


def withdrawn_by(lines: Sequence[str]) -> frozenset[str]:
    """The logs that lines of 0.1.0 name, which have no place: the next session looks for it in them."""
    return frozenset(fields[1] for fields in map(str.split, lines) if len(fields) == 2)
