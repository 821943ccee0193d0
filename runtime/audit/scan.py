"""Reading a log strictly: every byte is accounted for, and what is wrong is said, never raised.

Rules, in the order in which they are asked. The file starts with the magic bytes and a header. Each record of
the file is one this program writes, in its canonical form (read and written again it gives the same bytes).
Messages stand in chunks only; each chunk's checksum, sizes and times are those of its content, and its message
indexes follow it. The summary is exactly the one that the data section gives. A file that ends early is torn:
everything before is kept.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any, Final

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from cutgate.runtime.audit.chain import GENESIS, Link, advance

MAGIC: Final = b"\x89MCAP0\r\n"
PREFIX: Final = 9
"""Bytes before a record's content: opcode and 64-bit length."""

KINDS: Final[dict[int, Any]] = {
    Opcode.HEADER: Header, Opcode.FOOTER: Footer, Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel,
    Opcode.MESSAGE: Message, Opcode.CHUNK: Chunk, Opcode.MESSAGE_INDEX: MessageIndex,
    Opcode.CHUNK_INDEX: ChunkIndex, Opcode.ATTACHMENT: Attachment, Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.STATISTICS: Statistics, Opcode.METADATA: Metadata, Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.SUMMARY_OFFSET: SummaryOffset, Opcode.DATA_END: DataEnd,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Stored:
    """One message with what its channel and schema say."""

    link: Link
    offset: int
    """Of its chunk in the file."""

    @property
    def topic(self) -> str:
        """Its topic."""
        return self.link.topic


@dataclass
class Scan:
    """What a file holds.

    Attributes:
        mcap: it starts as an MCAP file does.
        messages: in file order.
        attachments, metadata: in file order.
        finished: data section, summary and footer are there to the last byte.
        torn_at: offset of the first byte that is not a whole record, if the file ends early.
        problems: what is inconsistent, each with its place; a sound file has none.
    """

    mcap: bool = True
    header: Header | None = None
    messages: list[Stored] = field(default_factory=list)
    attachments: list[Attachment] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    finished: bool = False
    torn_at: int | None = None
    problems: list[str] = field(default_factory=list)

    def attachment(self, name: str) -> bytes | None:
        """The attachment's bytes, or None."""
        return next((entry.data for entry in self.attachments if entry.name == name), None)


@dataclass(frozen=True, slots=True)
class _Raw:
    opcode: int
    offset: int
    record: McapRecord
    length: int
    """With opcode and length field."""


class _Bad(Exception):  # noqa: N818 - it never leaves this module
    """A rule is broken; the text says which and where."""


class _Torn(Exception):  # noqa: N818
    """The bytes end inside the record at ``offset``."""

    def __init__(self, offset: int) -> None:
        super().__init__(offset)
        self.offset = offset


def scan(data: bytes) -> Scan:
    """Read a whole file. Never raises."""
    found = Scan()
    if not data.startswith(MAGIC):
        found.mcap = False
        found.problems.append("the file does not start as an MCAP file")
        return found
    try:
        _Scanner(data, found).run()
    except _Torn as torn:
        found.torn_at = torn.offset
        # A file with both ends was finished: then a length is wrong, and nothing is missing.
        if data[len(MAGIC) :].endswith(MAGIC):
            found.problems.append(f"the record at offset {torn.offset} is longer than the file")
    except _Bad as bad:
        found.problems.append(str(bad))
    return found


def recoverable_head(data: bytes) -> str:
    """The chain's head over all whole chunks, in hex; the start of the chain if there are none."""
    head = GENESIS
    for message in scan(data).messages:
        head = advance(head, message.link)
    return head.hex()


class _Scanner:
    """The walk through one file."""

    def __init__(self, data: bytes, found: Scan) -> None:
        self.data = data
        self.found = found
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.expected: list[McapRecord] = []
        self.attachment_indexes: list[AttachmentIndex] = []
        self.metadata_indexes: list[MetadataIndex] = []
        self.chunk_indexes: list[ChunkIndex] = []
        self.counts: dict[int, int] = {}

    def run(self) -> None:
        records = _records(self.data, len(MAGIC), len(self.data))
        first = next(records, None)
        if first is None:
            raise _Torn(len(MAGIC))
        if not isinstance(first.record, Header):
            raise _Bad(f"the record at offset {first.offset} is no header")
        self.found.header = first.record
        end = self._data_section(records)
        self._summary(end, records)
        self.found.finished = True

    # ------------------------------------------------------------ data section

    def _data_section(self, records: Iterator[_Raw]) -> _Raw:
        for raw in records:
            record = raw.record
            if isinstance(record, DataEnd):
                if record.data_section_crc != zlib.crc32(self.data[: raw.offset]):
                    raise _Bad("the data section's checksum is wrong")
                return raw
            if isinstance(record, Chunk):
                self._chunk(raw, record, records)
            elif isinstance(record, Attachment):
                self._attachment(raw, record)
            elif isinstance(record, Metadata):
                self.found.metadata.append(record)
                self.metadata_indexes.append(
                    MetadataIndex(offset=raw.offset, length=raw.length, name=record.name)
                )
            else:
                raise _Bad(_misplaced(raw, "the data section"))
        raise _Torn(len(self.data))

    def _attachment(self, raw: _Raw, record: Attachment) -> None:
        self.found.attachments.append(record)
        self.attachment_indexes.append(
            AttachmentIndex(
                offset=raw.offset,
                length=raw.length,
                log_time=record.log_time,
                create_time=record.create_time,
                data_size=len(record.data),
                name=record.name,
                media_type=record.media_type,
            )
        )

    def _chunk(self, raw: _Raw, chunk: Chunk, records: Iterator[_Raw]) -> None:
        place = f"chunk at offset {raw.offset}"
        if chunk.compression or chunk.uncompressed_size != len(chunk.data):
            raise _Bad(f"{place}: it is not stored as it is")
        if chunk.uncompressed_crc != zlib.crc32(chunk.data):
            raise _Bad(f"{place}: its checksum is wrong")
        indexes: dict[int, MessageIndex] = {}
        times: list[int] = []
        try:
            messages = list(self._content(raw, chunk, indexes, times))
        except _Bad as bad:
            raise _Bad(f"{place}: {bad}") from None
        if not times or (chunk.message_start_time, chunk.message_end_time) != (min(times), max(times)):
            raise _Bad(f"{place}: its times are not those of its messages")
        self.found.messages += messages
        offsets: dict[int, int] = {}
        length = 0
        for expected in indexes.values():
            index = next(records, None)
            if index is None:
                raise _Torn(raw.offset + raw.length + length)
            if index.record != expected:
                raise _Bad(f"{place}: the index at offset {index.offset} is not that of its messages")
            offsets[expected.channel_id] = index.offset
            length += index.length
        self.chunk_indexes.append(
            ChunkIndex(
                message_start_time=chunk.message_start_time,
                message_end_time=chunk.message_end_time,
                chunk_start_offset=raw.offset,
                chunk_length=raw.length,
                message_index_offsets=offsets,
                message_index_length=length,
                compression="",
                compressed_size=len(chunk.data),
                uncompressed_size=len(chunk.data),
            )
        )

    def _content(
        self, chunk_raw: _Raw, chunk: Chunk, indexes: dict[int, MessageIndex], times: list[int]
    ) -> Iterator[Stored]:
        try:
            for raw in _records(chunk.data, 0, len(chunk.data)):
                record = raw.record
                if isinstance(record, Schema):
                    _register(self.schemas, record, "schema")
                elif isinstance(record, Channel):
                    if record.schema_id not in self.schemas:
                        raise _Bad(f"channel {record.topic} names no schema")
                    _register(self.channels, record, "channel")
                elif isinstance(record, Message):
                    times.append(record.log_time)
                    index = indexes.setdefault(record.channel_id, MessageIndex(record.channel_id, []))
                    index.records.append((record.log_time, raw.offset))
                    yield Stored(self._link(record), chunk_raw.offset)
                else:
                    raise _Bad(_misplaced(raw, "a chunk"))
        except _Torn as torn:
            raise _Bad(f"a record runs over the end, {torn.offset} bytes in") from None

    def _link(self, message: Message) -> Link:
        channel = self.channels.get(message.channel_id)
        if channel is None:
            raise _Bad(f"message {message.sequence} names no channel")
        self.counts[channel.id] = self.counts.get(channel.id, 0) + 1
        schema = self.schemas[channel.schema_id]
        return Link(
            topic=channel.topic,
            encoding=channel.message_encoding,
            schema_name=schema.name,
            schema=schema.data,
            log_time=message.log_time,
            publish_time=message.publish_time,
            sequence=message.sequence,
            data=message.data,
        )

    # ------------------------------------------------------------ summary

    def _summary(self, data_end: _Raw, records: Iterator[_Raw]) -> None:
        start = data_end.offset + data_end.length
        found: list[_Raw] = []
        footer: _Raw | None = None
        for raw in records:
            if isinstance(raw.record, Footer):
                footer = raw
                break
            found.append(raw)
        if footer is None or not isinstance(footer.record, Footer):
            raise _Torn(len(self.data))
        expected = self._expected_summary()
        groups = [raw for raw in found if not isinstance(raw.record, SummaryOffset)]
        offsets = [raw for raw in found if isinstance(raw.record, SummaryOffset)]
        if [raw.record for raw in groups] != expected:
            raise _Bad("the summary is not that of the data section")
        if [raw.record for raw in offsets] != _summary_offsets(groups) or found != groups + offsets:
            raise _Bad("the summary's offsets are not those of its groups")
        self._footer(start, footer, footer.record, offsets)

    def _expected_summary(self) -> list[McapRecord]:
        times = [message.link.log_time for message in self.found.messages]
        statistics = Statistics(
            attachment_count=len(self.attachment_indexes),
            channel_count=len(self.channels),
            channel_message_counts=self.counts,
            chunk_count=len(self.chunk_indexes),
            message_count=len(times),
            message_start_time=min(times, default=0),
            message_end_time=max(times, default=0),
            metadata_count=len(self.metadata_indexes),
            schema_count=len(self.schemas),
        )
        return [
            *self.schemas.values(),
            *self.channels.values(),
            statistics,
            *self.chunk_indexes,
            *self.attachment_indexes,
            *self.metadata_indexes,
        ]

    def _footer(self, start: int, raw: _Raw, footer: Footer, offsets: list[_Raw]) -> None:
        end = raw.offset + raw.length
        if footer.summary_start != start or footer.summary_offset_start != offsets[0].offset:
            raise _Bad("the footer does not point at the summary")
        if footer.summary_crc != zlib.crc32(self.data[start : end - 4]):
            raise _Bad("the summary's checksum is wrong")
        tail = self.data[end:]
        if tail != MAGIC:
            if MAGIC.startswith(tail):
                raise _Torn(end)
            raise _Bad(f"the file does not end with the footer at offset {raw.offset}")


def _records(data: bytes, start: int, end: int) -> Iterator[_Raw]:
    """The records of ``data[start:end]``, each whole and canonical. Raises _Torn or _Bad."""
    at = start
    while at < end:
        if end - at < PREFIX:
            raise _Torn(at)
        opcode, size = struct.unpack_from("<BQ", data, at)
        length = PREFIX + size
        if end - at < length:
            raise _Torn(at)
        yield _Raw(opcode, at, _decode(opcode, data[at : at + length], at), length)
        at += length


def _decode(opcode: int, data: bytes, offset: int) -> McapRecord:
    kind = KINDS.get(opcode)
    if kind is None:
        raise _Bad(f"the record at offset {offset} is of unknown kind {opcode:#04x}")
    stream = ReadDataStream(BytesIO(data[PREFIX:]))
    try:
        record: McapRecord = kind.read(stream, len(data) - PREFIX) if kind is Message else kind.read(stream)
        builder = RecordBuilder()
        record.write(builder)
        again: bytes = builder.end()  # type: ignore[no-untyped-call]
    except (McapError, ValueError, struct.error, OverflowError, MemoryError) as error:
        raise _Bad(f"the record at offset {offset} cannot be read ({type(error).__name__})") from None
    if again != data:
        raise _Bad(f"the record at offset {offset} is damaged or not in its canonical form")
    return record


def _register(known: dict[int, Any], record: Any, what: str) -> None:
    if record.id in known or record.id == 0:
        raise _Bad(f"{what} {record.id} is given twice or has no number")
    known[record.id] = record


def _summary_offsets(groups: list[_Raw]) -> list[McapRecord]:
    """One per group of equal records, in file order."""
    offsets: list[SummaryOffset] = []
    for raw in groups:
        if offsets and offsets[-1].group_opcode == raw.opcode:
            offsets[-1].group_length += raw.length
        else:
            offsets.append(
                SummaryOffset(group_opcode=raw.opcode, group_start=raw.offset, group_length=raw.length)
            )
    return list(offsets)


def _misplaced(raw: _Raw, where: str) -> str:
    return f"the record at offset {raw.offset} ({type(raw.record).__name__}) does not belong into {where}"
