"""The controller as the log's witness: whether the tree that it saw last is found in a folder of logs.

A start names id, size and root of its log's tree; the controller keeps the three before it moves and tells them when
the next session opens. They are found where a log of this id has this root at this size and holds the start that was
sent with them. A log that a crash has cut off between the record that authorised the start and the one that says that
it left counts too, and that is said. What a crash, or anybody, has cut off behind them is not missed here.

A log is looked into only where its record 0 says the id. If certificates lead from its key to that of the session that
runs, the tree is the one of a checkpoint that its key has signed, found by the log's index (``signed_start.py``): that
takes as long whatever the log holds. Only where nobody vouches for its key the tree is made anew, from front to back, a
chunk at a time: whoever puts another log in its place can sign it with a key of his own, but cannot give it that root.
Nothing in the folder that is foreign, damaged or not ours is an error.
"""

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Final

from cutgate.config.load import InputError
from cutgate.config.ours import open_ours
from cutgate.runtime.audit.container.scan import walk
from cutgate.runtime.audit.container.stored import Scan
from cutgate.runtime.audit.directory import signed_head
from cutgate.runtime.audit.judge import parse_object
from cutgate.runtime.audit.records import AuditOpen, AuditPermit
from cutgate.runtime.audit.signed_start import CUT_OFF, SoughtStart
from cutgate.runtime.audit.signing.log_key import PublicLogKey
from cutgate.runtime.audit.signing.note import NoteError
from cutgate.runtime.audit.signing.signatures import key_of
from cutgate.runtime.audit.tree import Tree

BEGINNING: Final = 1 << 18
"""Bytes of a file in which record 0 is looked for; a session writes it within the first 20 kB."""
BACK_MAX: Final = 256
"""Sessions before the one that runs whose keys are looked at: those since the last start."""


@dataclass(frozen=True, slots=True)
class WitnessFound:
    """What was found.

    Attributes:
        log: name of the log in which it is; None where it is in none.
        reason: why it is in none, or what is missing behind it; empty if it is there whole.
    """

    log: str | None
    reason: str


def look_up(directory: Path, log_id: bytes, size: int, root: bytes) -> WitnessFound:
    """Whether the tree that the controller saw last is that of a log here.

    It reads as long as the disk takes; call it in a thread of its own. Never raises for what stands in the folder.

    Args:
        directory: of the logs.
        log_id: of the log, as its record 0 has it in hex.
        size: records in the tree.
        root: of the tree at this size, 32 bytes.
    """
    name, reason = log_id.hex(), ""
    for path in _by_name(directory.glob("*.mcap"), name):
        try:
            with os.fdopen(open_ours(path), "rb") as file:
                if _log_id(file) != name:
                    continue
                key = _key_vouched_for(directory, file)
                told = SoughtStart(key, name, size, root).look(file) if key else _missing(file, size, root)
        except (OSError, InputError) as error:
            if name[:8] not in path.name:
                continue
            told = f"cannot be read: {error}"
        if told in ("", CUT_OFF):
            return WitnessFound(path.name, told)
        reason = reason or f"{path.name}: {told}"
    return WitnessFound(None, reason or f"no log {name} is in {directory}")


def _by_name(paths: Iterable[Path], log_id: str) -> list[Path]:
    """Those first whose name a session of this id gives; a copy may have any name."""
    return sorted(paths, key=lambda path: (log_id[:8] not in path.name, path.name))


def _log_id(file: BinaryIO) -> object:
    """The id in record 0; None where the file does not begin as a log does."""
    return _record_0(file).get("log_id")


def _record_0(file: BinaryIO) -> dict[str, Any]:
    """What record 0 says; nothing where the file does not begin as a log does."""
    file.seek(0)
    first = next(walk(BytesIO(file.read(BEGINNING)), Scan()), None)
    if first is None or first.topic != AuditOpen.TOPIC:
        return {}
    return parse_object(first.data) or {}


def _key_vouched_for(directory: Path, file: BinaryIO) -> PublicLogKey | None:
    """The log's key, if certificates lead from it to the key of the session that runs; else None."""
    try:
        key = key_of(_record_0(file))
    except NoteError:
        return None
    for other in _keys_back(directory) if key else ():
        if other == key or (key and other.epoch < key.epoch):
            return key if other == key else None
    return None


def _keys_back(directory: Path) -> Iterator[PublicLogKey]:
    """The key of the session that runs, the one that certified it, and so on back, as each log names the one before."""
    try:
        head, after = signed_head(directory), None
        name = head.log if head and not head.closed else None
        for _ in range(BACK_MAX):
            if not isinstance(name, str) or Path(name).name != name:
                return
            with os.fdopen(open_ours(directory / name), "rb") as file:
                opened = _record_0(file)
            key = key_of(opened)
            if key is None or (after and not key.certifies(after)):
                return
            yield key
            after, name = key, opened.get("previous_log")
    except (OSError, InputError, NoteError):
        return


def _missing(file: BinaryIO, size: int, root: bytes) -> str:
    """What this log lacks of them; empty if nothing, ``CUT_OFF`` where it ends before it says that the start left."""
    found, tree, authorised = Scan(), Tree(), False
    sent = {"kind": "start", "stage": "sent", "log_size": size, "log_root": root.hex()}
    for message in walk(file, found):
        if message.topic == AuditPermit.TOPIC:
            record = parse_object(message.data) or {}
            if tree.size >= size > 0 and {key: record.get(key) for key in sent} == sent:
                return ""
            stage = (record.get("kind"), record.get("stage"))
            authorised = tree.size < size and stage == ("start", "authorised")
        tree.append(message.covered)
        if tree.size == size and tree.root != root:
            return f"its tree has the root {tree.root.hex()} at size {size}, not {root.hex()}"
    cut_off = not (found.finished or found.problems)
    if tree.size >= size and authorised and cut_off:
        return CUT_OFF
    behind = f"; {found.problems[0]}" if found.problems else ""
    if not tree.size >= size:
        return f"it has {tree.size} records, the controller saw {size}{behind}"
    return f"it holds no start that was sent with its tree of size {size}{behind}"
