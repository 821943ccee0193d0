"""Judging a log: structure, chain, attachments, raw frames, and whether two ways of reading it agree.

A log is OK only if every rule holds. What is missing, at the end or beside it, makes it INCOMPLETE, anything
inconsistent TAMPERED, and a file that is no log of ours UNREADABLE. Without signatures this finds damage and careless
changes; whoever recomputes the whole chain is found by ``replay`` or not at all.

A log is read once from front to back, a chunk at a time. What is kept of it is where its records stand, frames apart.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from hashlib import sha256
from io import SEEK_END, BytesIO
from typing import Any, BinaryIO, Final

from cutgate.runtime.audit.container.raw import PIECE
from cutgate.runtime.audit.container.scan import walk
from cutgate.runtime.audit.container.stored import Scan
from cutgate.runtime.audit.judge import Judge, missing, parse_object
from cutgate.runtime.audit.records import AuditClose, CanFrame
from cutgate.runtime.audit.second_reading import read_again
from cutgate.runtime.audit.writer import PROFILE

_SHOWN: Final = 20
_CANDUMP: Final = "candump_sha256"


class Status(IntEnum):
    """The judgement; its number is the exit code of ``cutgate audit verify``."""

    OK = 0
    INCOMPLETE = 1
    TAMPERED = 2
    UNREADABLE = 3


@dataclass(frozen=True, slots=True)
class Report:
    """What was found.

    Attributes:
        status: the judgement.
        reasons: why it is not OK; the first names the first bad record. Empty if it is OK.
        notes: what was not checked.
        log_id: from record 0; empty if there is none.
        messages: whole messages.
        head: the chain's head over them, hex.
        dropped_bytes: bytes after the last whole record.
    """

    status: Status
    reasons: tuple[str, ...]
    notes: tuple[str, ...]
    log_id: str
    messages: int
    head: str
    dropped_bytes: int

    @property
    def headline(self) -> str:
        """The judgement in a few words; no signature is ever claimed."""
        return "OK (unsigned)" if self.status is Status.OK else self.status.name


@dataclass(frozen=True)
class Log:
    """A log that has been read: its structure, where its records stand, and the judgement.

    Records and attachments are read from the file when they are asked for.
    """

    scan: Scan
    report: Report
    file: BinaryIO = field(repr=False)
    places: tuple[tuple[str, int, int], ...] = field(repr=False)
    """Topic, offset and size of each record that is no frame, in file order."""

    def each(self, *topics: str) -> Iterator[tuple[str, bytes]]:
        """Topic and data of every record of these topics, in file order; frames are looked for in the whole file."""
        if CanFrame.TOPIC in topics:
            for message in walk(self.file, Scan()):
                if message.topic in topics:
                    yield message.topic, message.data
            return
        for topic, offset, size in self.places:
            if topic in topics:
                self.file.seek(offset)
                yield topic, self.file.read(size)

    def of(self, topic: str) -> list[dict[str, Any]]:
        """The records of one topic, in file order, as parsed JSON; an empty object for what is none."""
        return list(self.one_by_one(topic))

    def one_by_one(self, topic: str) -> Iterator[dict[str, Any]]:
        """As ``of``, each only while it is looked at: a session has millions of frames."""
        return (parse_object(data) or {} for _, data in self.each(topic))


def verify_log(log: bytes | BinaryIO, candump: bytes | BinaryIO | None = None) -> Report:
    """Judge a log; arguments and errors as ``read_log``."""
    return read_log(log, candump).report


def read_log(log: bytes | BinaryIO, candump: bytes | BinaryIO | None = None) -> Log:
    """Read and judge a log. What is wrong with it is said, never raised.

    Args:
        log: the MCAP file, seekable; it must stay open while the result is used.
        candump: the file of raw frames beside it, or None if it is not there.

    Raises:
        OSError: a file cannot be read.
    """
    file, frames = _opened(log), None if candump is None else _opened(candump)
    found, judge = Scan(), Judge()
    for message in walk(file, found):
        judge.take(message)
    content = [*judge.problems, *judge.content(found)]
    if found.zeros and judge.last_topic == AuditClose.TOPIC:
        content.append("zeros stand behind its close record")
    unread, notes = (
        ("", ()) if content or not found.finished else read_again(file, found, judge.read.digest())
    )
    damaged, lost = _candump(judge.last, frames)
    absent = [*missing(found, judge), *lost]
    tampered = [*content, *found.problems, *([unread] if unread else []), *damaged]
    if not found.mcap or not _ours(found):
        status, reasons = Status.UNREADABLE, ["this is not an audit log of cutgate", *found.problems]
    elif tampered:
        status, reasons = Status.TAMPERED, tampered
    elif absent:
        status, reasons = Status.INCOMPLETE, absent
    else:
        status, reasons = Status.OK, []
    report = Report(
        status=status,
        reasons=tuple(reasons[:_SHOWN]),
        notes=notes,
        log_id=_text(judge.first, "log_id"),
        messages=judge.count,
        head=judge.head.hex(),
        dropped_bytes=0 if found.torn_at is None else found.size - found.torn_at,
    )
    return Log(found, report, file, tuple(judge.places))


def _opened(data: bytes | BinaryIO) -> BinaryIO:
    return BytesIO(data) if isinstance(data, bytes) else data


def _ours(found: Scan) -> bool:
    """Whether the header, as far as it is there, is one of ours."""
    return found.header is None or found.header.profile == PROFILE


def _candump(closed: dict[str, Any] | None, candump: BinaryIO | None) -> tuple[list[str], list[str]]:
    """Whether the raw frames are those the close record names: what is wrong, and what is missing."""
    if closed is None or _CANDUMP not in closed:
        return [], []
    if candump is None:
        return [], ["the file of raw frames, whose SHA-256 the close record names, is not beside the log"]
    size, recorded = candump.seek(0, SEEK_END), closed.get("candump_bytes")
    if isinstance(recorded, int) and size != recorded:  # not read in vain, however large it is
        return [
            f"the file of raw frames beside the log has {size} bytes, the close record names {recorded}"
        ], []
    candump.seek(0)
    digest = sha256()
    while data := candump.read(PIECE):
        digest.update(data)
    if digest.hexdigest() != closed[_CANDUMP]:
        return ["the file of raw frames beside the log is not the one the close record names"], []
    return [], []


def _text(record: dict[str, Any] | None, key: str) -> str:
    value = (record or {}).get(key)
    return value if isinstance(value, str) else ""
