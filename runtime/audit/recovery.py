"""A finalised copy of a log that a crash, a loss of power or a full disk has cut. Pure: bytes in, bytes out.

    told = what_is_told(log, name, digest, software)
    for piece in copied(log, told):
        write it

Every complete chunk and attachment is kept byte for byte, whatever the topics of its records; the torn tail is dropped.
Message indexes, summary and footer are made anew, in the canonical form that ``container/scan.py`` reads, for another
place in the file and a cut within them change nothing of the content. What the copy says of itself (``recovered.py``)
stands behind the log's own metadata, before all records.

Only what a crash leaves is copied: a log that is finished, a copy, and one in which anything is inconsistent are not.
"""

import zlib
from collections.abc import Callable, Iterator
from typing import Final

from mcap.opcode import Opcode
from mcap.records import DataEnd, MetadataIndex

from cutgate.runtime.audit.container.chunk import Definitions, parse_chunk
from cutgate.runtime.audit.container.kinds import encoded
from cutgate.runtime.audit.container.raw import HEAD, MAGIC, PIECE, Budget, Raw, RecordReader
from cutgate.runtime.audit.container.summary import Expected, KeptGroup, footer_of, offsets_of
from cutgate.runtime.audit.inspect import Log, Status
from cutgate.runtime.audit.records import AuditClose
from cutgate.runtime.audit.recovered import RECOVERED, Recovered, is_copy, told_by
from cutgate.runtime.audit.writer import METADATA


def refused(log: Log) -> tuple[str, str] | None:
    """Why a log is not recovered, and what to do; None if it is to be.

    Asked in this order: what is no log, or altered, is neither finished nor a copy of anything.
    """
    return next(((text(log), remedy) for holds, text, remedy in _REFUSALS if holds(log)), None)


def _of_what(log: Log) -> str:
    told = told_by(log.scan.metadata)
    return f"it is a recovered copy{f' of {told.original}' if told else ''}, and no log that was cut"


def _closed(log: Log) -> bool:
    return any(topic == AuditClose.TOPIC for topic, _, _ in log.places)


_REFUSALS: Final[tuple[tuple[Callable[[Log], bool], Callable[[Log], str], str], ...]] = (
    (
        lambda log: log.report.status is Status.UNREADABLE,
        lambda log: log.report.reasons[0],
        "name a session's .mcap file",
    ),
    (
        lambda log: log.report.status is Status.TAMPERED,
        lambda log: f"it is altered, not cut: {log.report.reasons[0]}",
        "nothing of it is copied; keep it as evidence, and take the log from a backup",
    ),
    (
        lambda log: is_copy(log.scan.metadata),
        _of_what,
        "read it as it is (audit show, audit replay); what can still be recovered is in the original",
    ),
    (
        lambda log: log.report.status is Status.OK,
        lambda _log: "it is whole: there is nothing to recover",
        "read it as it is",
    ),
    (
        lambda log: log.scan.finished and _closed(log),
        lambda log: f"it is finished, and what is missing was not in it: {log.report.reasons[0]}",
        "read it as it is, or put that file beside it again, under the log's name (.candump.log, .signature.json)",
    ),
    (
        lambda log: log.scan.finished,
        lambda log: f"its file is finished, no end of it was cut off: {log.report.reasons[0]}",
        "read it as it is (audit show, audit replay)",
    ),
    (
        lambda log: not log.report.messages,
        lambda _log: "it was cut before its record 0 was whole: there is nothing to recover",
        "no session can have enabled anything by then; leave the file where it is",
    ),
)
"""Of each: whether it holds, what is said, and the remedy."""


def what_is_told(log: Log, original: str, digest: str, software: str) -> Recovered:
    """What the copy of a log says of itself.

    Args:
        log: one that is not refused.
        original: name of its file.
        digest: SHA-256 of its file, hex.
        software: what makes the copy.
    """
    report = log.report
    return Recovered(original, digest, log.scan.size, report.dropped_bytes, report.messages, software)


def copied(log: Log, told: Recovered) -> Iterator[bytes]:
    """The copy, piece by piece: a chunk, part of an attachment, a group of the summary.

    Args:
        log: one that is not refused; its file is read again.
        told: what the copy says of itself.

    Raises:
        BrokenError, TornError: the file is not what it was when the log was read, or its summary is larger than that
            of any session.
        OSError: it cannot be read.
    """
    return _Copy(log, told).pieces()


def agrees(copy: Log, log: Log, told: Recovered) -> bool:
    """Whether a copy, read back, holds what was read of the log, and is judged as a copy must be."""
    read, found = copy.report, log.report
    return (
        read.status is Status.INCOMPLETE
        and copy.scan.finished
        and told_by(copy.scan.metadata) == told
        and (read.messages, read.head, read.log_id) == (found.messages, found.head, found.log_id)
        and _attached(copy) == _attached(log)
    )


def _attached(log: Log) -> list[tuple[object, ...]]:
    return [
        (entry.name, entry.media_type, entry.log_time, entry.create_time, entry.sha256)
        for entry in log.scan.attachments
    ]


class _Copy:
    """The copy that is being made: where it has come to, its checksum, and the summary of what it holds."""

    def __init__(self, log: Log, told: Recovered) -> None:
        found = log.scan
        self._end = found.size - log.report.dropped_bytes
        self._reader = RecordReader(log.file, self._end)
        self._definitions = Definitions(Budget())
        self._attachments = iter(found.attachments)
        self._told = told
        self._summary = Expected(KeptGroup)
        self._at = 0
        self._crc = 0

    def pieces(self) -> Iterator[bytes]:
        yield self._put(MAGIC)
        while self._reader.at < self._end:
            raw = self._reader.next()
            if raw.opcode == Opcode.DATA_END:  # it was cut in its summary, which is made anew
                break
            yield from self._record(raw)
        yield from self._ending()

    def _put(self, data: bytes) -> bytes:
        self._at += len(data)
        self._crc = zlib.crc32(data, self._crc)
        return data

    def _record(self, raw: Raw) -> Iterator[bytes]:
        """One of the data section; the message indexes are made anew, behind their chunk."""
        if raw.opcode == Opcode.ATTACHMENT:
            yield from self._attachment(raw)
            return
        content = self._reader.content(raw)
        if raw.opcode == Opcode.MESSAGE_INDEX:
            return
        offset = self._at
        yield self._put(HEAD.pack(raw.opcode, raw.size) + content)
        if raw.opcode == Opcode.CHUNK:
            yield from self._indexes(content, offset)
        elif raw.opcode == Opcode.METADATA:
            yield from self._metadata(offset)

    def _attachment(self, raw: Raw) -> Iterator[bytes]:
        self._summary.add(next(self._attachments).summary_index(self._at, raw.length))
        yield self._put(HEAD.pack(raw.opcode, raw.size))
        end = self._reader.at + raw.size
        while self._reader.at < end:
            yield self._put(self._reader.take(min(PIECE, end - self._reader.at), raw.offset))

    def _indexes(self, content: bytes, offset: int) -> Iterator[bytes]:
        """The message indexes of the chunk that has been written, whose record stands at this offset."""
        chunk = parse_chunk(content, offset, self._definitions)  # where its messages stand nobody asks
        self._summary.take_chunk(chunk)
        offsets, begin = {}, self._at
        for channel, body in chunk.indexes():
            offsets[channel] = self._at
            yield self._put(HEAD.pack(Opcode.MESSAGE_INDEX, len(body)) + body)
        self._summary.add(chunk.summary_index(offset, begin - offset, offsets, self._at - begin))

    def _metadata(self, offset: int) -> Iterator[bytes]:
        """The log's own have been written, and stand at this offset; those of the copy follow."""
        self._summary.add(MetadataIndex(offset=offset, length=self._at - offset, name=METADATA))
        record = encoded(self._told.metadata())
        self._summary.add(MetadataIndex(offset=self._at, length=len(record), name=RECOVERED))
        yield self._put(record)

    def _ending(self) -> Iterator[bytes]:
        """The end of the data section, the summary, the footer, the last magic bytes."""
        yield self._put(encoded(DataEnd(self._crc)))
        groups, start = self._summary.close(), self._at
        offsets, end = offsets_of(groups, start)
        self._crc = 0
        for group in groups:
            yield self._put(bytes(group.data))
        yield self._put(b"".join(map(encoded, offsets)))
        yield self._put(encoded(footer_of(start, end, self._crc)))
        yield MAGIC
