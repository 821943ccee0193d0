"""Judging a log: structure, chain, attachments, raw frames, and whether two ways of reading it agree.

A log is OK only if every rule holds. What is missing, at the end or beside it, makes it INCOMPLETE, anything
inconsistent TAMPERED, and a file that is no log of ours UNREADABLE. Without signatures this finds damage and careless
changes; whoever recomputes the whole chain is found by ``replay`` or not at all.

A log is read once from front to back, a chunk at a time. What is kept of it is where its records stand, frames apart.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from hashlib import sha256
from io import SEEK_END, BytesIO
from typing import Any, BinaryIO, Final

from mcap.data_stream import ReadDataStream
from mcap.reader import make_reader
from mcap.records import Attachment as StockAttachment
from mcap.records import Channel, Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk

from cutgate.runtime.audit.chain import GENESIS, LINKED
from cutgate.runtime.audit.container.raw import PIECE, PREFIX
from cutgate.runtime.audit.container.scan import walk
from cutgate.runtime.audit.container.stored import Scan, Stored
from cutgate.runtime.audit.records import Attachment, CanFrame, Close, Open
from cutgate.runtime.audit.writer import ENCODING, METADATA, PROFILE

KEPT_MAX: Final = 1_000_000
"""Records beside frames whose place is kept; a session has thousands."""
READ_TWICE_MAX: Final = 64 << 20
"""Bytes of the largest attachment that is read a second way: the stock reader takes it into memory."""
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
        return (_parse(data) or {} for _, data in self.each(topic))


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
    found, judge = Scan(), _Judge()
    for message in walk(file, found):
        judge.take(message)
    content = [*judge.problems, *judge.content(found)]
    if found.zeros and judge.last_topic == Close.TOPIC:
        content.append("zeros stand behind its close record")
    unread, notes = ("", ()) if content or not found.finished else _two_readings(file, found, judge)
    missing = _missing(found, judge)
    damaged, absent = _candump(judge.last, frames)
    tampered = [*content, *found.problems, *([unread] if unread else []), *damaged]
    missing += absent
    if not found.mcap or not _ours(found):
        status, reasons = Status.UNREADABLE, ["this is not an audit log of cutgate", *found.problems]
    elif tampered:
        status, reasons = Status.TAMPERED, tampered
    elif missing:
        status, reasons = Status.INCOMPLETE, missing
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


class _Judge:
    """The rules over the records, one record after the other.

    Attributes:
        head: the chain's head over all records so far.
        count: records so far.
        read: digest of topic, sequence and data of all of them.
        first, last: parsed record 0 and the last one; None where it is no JSON object, or none.
        places: topic, offset and size of each record that is no frame.
        problems: the first record whose place in the chain is wrong.
    """

    def __init__(self) -> None:
        self.head = GENESIS
        self.count = 0
        self.read = sha256()
        self.first: dict[str, Any] | None = None
        self.last: dict[str, Any] | None = None
        self.last_topic = ""
        self.places: list[tuple[str, int, int]] = []
        self.problems: list[str] = []
        self._first_topic: str | None = None
        self._opens = 0
        self._closes = 0
        self._close: tuple[int, dict[str, Any] | None] = (0, None)
        self._after_close: tuple[int, str] | None = None
        self._attached: list[tuple[Any, ...]] = []
        self._too_many = False

    def take(self, message: Stored) -> None:
        """The next record."""
        number, topic = self.count, message.topic
        record = _parse(message.data)
        if not self.problems:
            self._follows(number, message, record)
        self.head = message.advance(self.head)
        self.count += 1
        _add(self.read, topic, message.sequence, message.data)
        if number == 0:
            self.first, self._first_topic = record, topic
        self.last, self.last_topic = record, topic
        if self._closes == 1 and self._after_close is None:
            self._after_close = (number, topic)
        if topic != CanFrame.TOPIC:
            self._keep(number, message, record)

    def _follows(self, number: int, message: Stored, record: dict[str, Any] | None) -> None:
        place = f"record {number} ({message.topic})"
        if record is None:
            self.problems.append(f"{place}: it is not a JSON object")
        elif message.sequence != number:
            self.problems.append(f"{place}: its sequence is {message.sequence}")
        elif message.channel.encoding != ENCODING:
            self.problems.append(f"{place}: its encoding is not {ENCODING}")
        elif message.topic.startswith(LINKED) and record.get("prev") != self.head.hex():
            self.problems.append(f"{place}: it does not follow from the records before it")

    def _keep(self, number: int, message: Stored, record: dict[str, Any] | None) -> None:
        topic = message.topic
        if not len(self.places) < KEPT_MAX:
            self._too_many = True
            return
        self.places.append((topic, message.offset, len(message.data)))
        if topic == Open.TOPIC:
            self._opens += 1
        elif topic == Close.TOPIC:
            self._closes += 1
            if self._closes == 1:
                self._close = (number, record)
        elif topic == Attachment.TOPIC:
            self._attached.append(
                tuple((record or {}).get(key) for key in ("name", "media_type", "sha256", "size"))
            )

    def content(self, found: Scan) -> Iterator[str]:
        """What the records say of the file and what the file holds, side by side."""
        if self.count and self._first_topic != Open.TOPIC:
            yield f"record 0 is {self._first_topic}, must be {Open.TOPIC}"
        for topic, times in ((Open.TOPIC, self._opens), (Close.TOPIC, self._closes)):
            if times > 1:
                yield f"{topic} is there {times} times"
        if self._closes:
            count = (self._close[1] or {}).get("message_count")
            if self._after_close is not None:
                number, topic = self._after_close
                yield f"record {number} ({topic}) stands after the close record"
            elif count != self.count:
                yield f"the close record counts {count} messages, the file holds {self.count}"
        if self._too_many:
            yield f"it holds over {KEPT_MAX} records beside frames; no session writes so many"
        yield from self._attachments(found)
        if self.count and [(entry.name, entry.metadata.get("log_id")) for entry in found.metadata] != [
            (METADATA, (self.first or {}).get("log_id"))
        ]:
            yield "the file's metadata are not those of record 0"

    def _attachments(self, found: Scan) -> Iterator[str]:
        """Every record of an attachment has its attachment; in a closed file the other way round as well."""
        recorded = self._attached
        stored = [(entry.name, entry.media_type, entry.sha256, entry.size) for entry in found.attachments]
        for number, (record, entry) in enumerate(zip(recorded, stored, strict=False)):
            if record != entry:
                yield f"attachment {number} ({entry[0]}) is not what its record says"
        if len(recorded) > len(stored):
            yield f"attachment {recorded[len(stored)][0]} has a record but is not there"
        if found.finished and len(stored) > len(recorded):
            yield f"attachment {stored[len(recorded)][0]} has no record"


def _missing(found: Scan, judge: _Judge) -> list[str]:
    missing = []
    if not found.finished:
        missing.append(
            f"the file ends early: record {judge.count - 1} is the last whole one"
            if judge.count
            else "the file ends before its first record"
        )
    if found.zeros:
        missing.append("it ends in zeros, as a file system leaves it after a loss of power")
    if judge.last_topic != Close.TOPIC:
        missing.append("there is no close record: the session did not end in order")
    return missing


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


# ---------------------------------------------------------------- the stock reader


def _two_readings(file: BinaryIO, found: Scan, judge: _Judge) -> tuple[str, tuple[str, ...]]:
    """Whether the stock reader, linearly and by index, reads what we read; and what it was not asked."""
    large = next((entry for entry in found.attachments if entry.size > READ_TWICE_MAX), None)
    if large is not None:
        size = f"attachment {large.name} has {large.size} bytes"
        return "", (f"{size}: a log is read a second way only up to {READ_TWICE_MAX}, this one was not",)
    attached = [(entry.name, entry.sha256) for entry in found.attachments]
    chunks, way = sha256(), "linearly"
    try:
        same = _linearly(file, chunks) == (judge.read.digest(), attached)
        if same:
            way = "by index"
            same = _by_index(file) == (chunks.digest(), attached)
    except Exception as error:  # noqa: BLE001 - whatever the reader dislikes, the log is not sound
        return f"read {way}, the file gives an error: {type(error).__name__}", ()
    return "" if same else f"read {way}, the file gives other records", ()


def _linearly(file: BinaryIO, chunks: Any) -> tuple[bytes, list[tuple[str, str]]]:
    """Digest of all messages and of each attachment, from front to back; the chunks' contents go into ``chunks``."""
    messages, attached = sha256(), []
    channels: dict[int, Channel] = {}
    file.seek(0)
    for record in StreamReader(file, emit_chunks=True, validate_crcs=True).records:
        if isinstance(record, StockAttachment):
            attached.append((record.name, sha256(record.data).hexdigest()))
        if not isinstance(record, Chunk):
            continue
        chunks.update(sha256(record.data).digest())
        for part in breakup_chunk(record, validate_crc=True):
            if isinstance(part, Channel):
                channels[part.id] = part
            elif isinstance(part, Message):
                _add(messages, channels[part.channel_id].topic, part.sequence, part.data)
    return messages.digest(), attached


def _by_index(file: BinaryIO) -> tuple[bytes, list[tuple[str, str]]]:
    """Digest of the chunks' contents and of each attachment, as the summary finds them."""
    file.seek(0)
    reader = make_reader(file, validate_crcs=True)
    summary = reader.get_summary()
    chunks = sha256()
    for index in summary.chunk_indexes if summary else ():
        file.seek(index.chunk_start_offset + PREFIX)
        chunks.update(sha256(Chunk.read(ReadDataStream(file)).data).digest())
    return chunks.digest(), [
        (entry.name, sha256(entry.data).hexdigest()) for entry in reader.iter_attachments()
    ]


def _add(digest: Any, topic: str, sequence: int, data: bytes) -> None:
    """One message into the digest of all."""
    digest.update(b"%d %d %d " % (len(topic), sequence, len(data)))
    digest.update(topic.encode())
    digest.update(data)


# ---------------------------------------------------------------- records


def _refuse(text: str) -> Any:
    raise ValueError(text)


_JSON: Final = json.JSONDecoder(parse_constant=_refuse)
"""NaN and infinity are not JSON."""


def _parse(data: bytes) -> dict[str, Any] | None:
    """The JSON object, or None."""
    try:
        content = _JSON.decode(data.decode("utf-8", "surrogatepass"))
    except (ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None


def _text(record: dict[str, Any] | None, key: str) -> str:
    value = (record or {}).get(key)
    return value if isinstance(value, str) else ""
