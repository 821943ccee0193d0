"""Reading a log strictly, a chunk at a time: every byte is accounted for, and what is wrong is said, never raised.

Rules, in the order in which they are asked. The file starts with the magic bytes and a header. Each record of
the file is one this program writes, in its canonical form (read and written again it gives the same bytes), and no
larger than a session writes it. Messages stand in chunks only; each chunk's checksum, sizes and times are those of
its content, and its message indexes follow it. The summary is exactly the one that the data section gives. A file
that ends early is torn: everything before is kept.

What is in memory at a time is one chunk, and what the file says of itself; never the file.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from hashlib import sha256
from io import SEEK_END, BytesIO
from typing import Any, BinaryIO, Final

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
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

from cutgate.runtime.audit.chain import Link, advance_in, of_channel

MAGIC: Final = b"\x89MCAP0\r\n"
PREFIX: Final = 9
"""Bytes before a record's content: opcode and 64-bit length."""
RECORD_MAX: Final = 16 << 20
"""Bytes of the largest record that is read, attachments apart; a session closes its chunks at 1 MiB."""
REMEMBERED_MAX: Final = 16 << 20
"""Bytes of schemas, channels, metadata and attachments' names that are remembered; a session has some 50 kB."""
ZEROS_MAX: Final = 64 << 20
"""So many zeros at the end of a file are taken for what a loss of power left: more than the largest chunk."""
PIECE: Final = 1 << 20
"""So much of an attachment is in memory at a time."""

KINDS: Final[dict[int, Any]] = {
    Opcode.HEADER: Header, Opcode.FOOTER: Footer, Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel,
    Opcode.MESSAGE: Message, Opcode.MESSAGE_INDEX: MessageIndex, Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex, Opcode.STATISTICS: Statistics, Opcode.METADATA: Metadata,
    Opcode.METADATA_INDEX: MetadataIndex, Opcode.SUMMARY_OFFSET: SummaryOffset, Opcode.DATA_END: DataEnd,
}  # fmt: skip
"""Records that are read as a whole. Chunks, the messages in them and attachments are read by their parts."""
SUMMARY: Final = (
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
)
"""The groups of the summary, in their order."""

_WHOLE: Final[dict[int, str]] = {
    Opcode.CHUNK: "a chunk where none belongs",
    Opcode.ATTACHMENT: "an attachment where none belongs",
}
_PREFIX: Final = struct.Struct("<BQ")
_CHUNK: Final = struct.Struct("<QQQIIQ")
"""First and last time, size, checksum, length of the compression's name (none), length of the content."""
_MESSAGE: Final = struct.Struct("<HIQQ")
"""Channel, sequence, log and publish time."""
_ENTRY: Final = struct.Struct("<QQ")
"""Of a message index: time and place."""


@dataclass(frozen=True, slots=True)
class ChannelInfo:
    """What a channel and its schema say of each of their messages."""

    topic: str
    encoding: str
    schema_name: str
    schema: bytes
    covered: bytes
    """What the chain covers of all this."""


@dataclass(slots=True)
class Stored:
    """One message with what its channel and schema say. Times in nanoseconds."""

    channel: ChannelInfo
    log_time: int
    publish_time: int
    sequence: int
    data: bytes
    offset: int
    """Of its data in the file."""

    @property
    def topic(self) -> str:
        """Its topic."""
        return self.channel.topic

    @property
    def link(self) -> Link:
        """What the chain covers of it."""
        channel = self.channel
        return Link(
            channel.topic, channel.encoding, channel.schema_name, channel.schema,
            self.log_time, self.publish_time, self.sequence, self.data,
        )  # fmt: skip

    def advance(self, head: bytes) -> bytes:
        """The chain's head after this message."""
        stamps = (self.log_time, self.publish_time, self.sequence)
        return advance_in(self.channel.covered, head, *stamps, self.data)


@dataclass(frozen=True, slots=True)
class StoredAttachment:
    """One attachment: what is said of it, and where its bytes stand."""

    name: str
    media_type: str
    log_time: int
    create_time: int
    size: int
    sha256: str
    offset: int
    """Of its bytes in the file."""
    file: BinaryIO = field(repr=False)

    @property
    def data(self) -> bytes:
        """Its bytes, read from the file."""
        self.file.seek(self.offset)
        return self.file.read(self.size)


@dataclass
class Scan:
    """What a file holds, as far as it has been read.

    Attributes:
        mcap: it starts as an MCAP file does.
        size: of the file, bytes.
        attachments, metadata: in file order.
        messages: in file order, where ``scan`` has collected them.
        finished: data section, summary and footer are there to the last byte.
        torn_at: offset of the first byte that is not a whole record, if the file ends early.
        zeros: it ends early in nothing but zeros, as a file system leaves it after a loss of power.
        problems: what is inconsistent, each with its place; a sound file has none.
    """

    mcap: bool = True
    size: int = 0
    header: Header | None = None
    attachments: list[StoredAttachment] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    messages: list[Stored] = field(default_factory=list)
    finished: bool = False
    torn_at: int | None = None
    zeros: bool = False
    problems: list[str] = field(default_factory=list)

    def attachment(self, name: str) -> StoredAttachment | None:
        """The first attachment of this name, or None."""
        return next((entry for entry in self.attachments if entry.name == name), None)


@dataclass(frozen=True, slots=True)
class _Raw:
    """A record whose content has not been read yet."""

    opcode: int
    offset: int
    size: int
    """Of its content."""
    crc: int
    """Of everything before it."""

    @property
    def length(self) -> int:
        """With opcode and length field."""
        return PREFIX + self.size


class _Bad(Exception):  # noqa: N818 - it never leaves this module
    """A rule is broken; the text says which and where."""


class _Torn(Exception):  # noqa: N818
    """The bytes end inside the record at ``offset``."""

    def __init__(self, offset: int) -> None:
        super().__init__(offset)
        self.offset = offset


def walk(file: BinaryIO, found: Scan) -> Iterator[Stored]:
    """The messages of a file, in its order, a chunk at a time; ``found`` is filled on the way, and whole at the end.

    Args:
        file: seekable.
        found: a new one.

    Raises:
        OSError: the file cannot be read.
    """
    found.size = file.seek(0, SEEK_END)
    file.seek(0)
    if file.read(len(MAGIC)) != MAGIC:
        found.mcap = False
        found.problems.append("the file does not start as an MCAP file")
        return
    scanner = _Scanner(file, found)
    try:
        yield from scanner.messages()
    except _Torn as torn:
        found.torn_at = torn.offset
        file.seek(max(len(MAGIC), found.size - len(MAGIC)))
        # A file with both ends was finished: then a length is wrong, and nothing is missing.
        if file.read(len(MAGIC)) == MAGIC:
            found.problems.append(f"the record at offset {torn.offset} is longer than the file")
    except _Bad as bad:
        if scanner.ends_in_zeros():
            found.torn_at, found.zeros = scanner.begun, True
        else:
            found.problems.append(str(bad))


def scan(data: bytes) -> Scan:
    """Read a whole file that is in memory, with all its messages. Never raises."""
    found = Scan()
    found.messages = list(walk(BytesIO(data), found))
    return found


class _Scanner:
    """The walk through one file, from front to back."""

    def __init__(self, file: BinaryIO, found: Scan) -> None:
        self.file = file
        self.found = found
        self.at = len(MAGIC)
        self.begun = self.at
        """Where the record begins that is being read."""
        self.crc = zlib.crc32(MAGIC)
        self.remembered = 0
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.known: dict[int, ChannelInfo] = {}
        self.counts: dict[int, int] = {}
        self.times: tuple[int, int] | None = None
        self.groups = {int(opcode): _Group(opcode) for opcode in SUMMARY}

    def messages(self) -> Iterator[Stored]:
        first = self._next()
        if first is None:
            raise _Torn(len(MAGIC))
        header = self._decode(first)
        if not isinstance(header, Header):
            raise _Bad(f"the record at offset {first.offset} is no header")
        self.found.header = header
        while True:
            raw = self._next()
            if raw is None:
                raise _Torn(self.found.size)
            if raw.opcode == Opcode.CHUNK:
                yield from self._chunk(raw)
            elif raw.opcode == Opcode.ATTACHMENT:
                self._attachment(raw)
            else:
                record = self._decode(raw)
                if isinstance(record, DataEnd):
                    break
                if not isinstance(record, Metadata):
                    raise _Bad(_misplaced(record, raw.offset, "the data section"))
                self._remember(raw.length)
                self.found.metadata.append(record)
                self._index(MetadataIndex(offset=raw.offset, length=raw.length, name=record.name))
        if record.data_section_crc != raw.crc:
            raise _Bad("the data section's checksum is wrong")
        self._summary()
        self.found.finished = True

    # ------------------------------------------------------------ the file's bytes

    def _next(self) -> _Raw | None:
        """The next record, its content not read yet; None at the end of the file."""
        offset, left, crc = self.at, self.found.size - self.at, self.crc
        self.begun = offset
        if not left:
            return None
        if left < PREFIX:
            raise _Torn(offset)
        opcode, size = _PREFIX.unpack(self._take(PREFIX, offset))
        if left - PREFIX < size:
            raise _Torn(offset)
        return _Raw(opcode, offset, size, crc)

    def _take(self, count: int, record: int) -> bytes:
        """The next bytes; ``record`` is the offset of the record that they belong to."""
        self.file.seek(self.at)
        data = self.file.read(count)
        if len(data) < count:  # somebody has cut the file meanwhile
            raise _Torn(record)
        self.at += count
        self.crc = zlib.crc32(data, self.crc)
        return data

    def ends_in_zeros(self) -> bool:
        """Whether the record that is being read ends in zeros, and nothing but zeros follow it to the file's end."""
        size = self.found.size
        if not size - self.at <= ZEROS_MAX:
            return False
        self.file.seek(min(self.at - 1, size - PREFIX))  # fewer are as good as a changed byte
        return not any(any(piece) for piece in iter(lambda: self.file.read(PIECE), b""))

    def _content(self, raw: _Raw) -> bytes:
        if not raw.size <= RECORD_MAX:
            raise _Bad(
                f"the record at offset {raw.offset} has {raw.size} bytes, a session writes at most {RECORD_MAX}"
            )
        return self._take(raw.size, raw.offset)

    def _decode(self, raw: _Raw) -> McapRecord:
        return _decode(raw.opcode, self._content(raw), raw.offset)

    def _remember(self, size: int) -> None:
        self.remembered += size
        if not self.remembered <= REMEMBERED_MAX:
            raise _Bad(
                "it holds more schemas, channels, metadata and attachments than any session writes: "
                f"over {REMEMBERED_MAX} bytes without their content"
            )

    # ------------------------------------------------------------ data section

    def _attachment(self, raw: _Raw) -> None:
        """Log and create time, name, media type, length, bytes, checksum: one piece of the bytes after the other."""
        place = f"the record at offset {raw.offset}"
        end = raw.offset + raw.length - 4
        crc = 0

        def field_of(size: int) -> bytes:
            nonlocal crc
            if not size <= end - self.at:
                raise _Bad(f"{place} cannot be read (an attachment longer than its record)")
            data = self._take(size, raw.offset)
            crc = zlib.crc32(data, crc)
            return data

        def text() -> str:
            size = int.from_bytes(field_of(4), "little")
            self._remember(size)
            return field_of(size).decode()

        log_time, create_time = _ENTRY.unpack(field_of(_ENTRY.size))
        try:
            name, media_type = text(), text()
        except UnicodeDecodeError:
            raise _Bad(f"{place} cannot be read (a name that is no UTF-8)") from None
        size = int.from_bytes(field_of(8), "little")
        if self.at + size != end:
            raise _Bad(f"{place} is damaged or not in its canonical form")
        offset, digest = self.at, sha256()
        while self.at < end:
            digest.update(field_of(min(PIECE, end - self.at)))
        if int.from_bytes(self._take(4, raw.offset), "little") != crc:
            raise _Bad(f"{place} is damaged or not in its canonical form")
        self._remember(PREFIX)
        self.found.attachments.append(
            StoredAttachment(
                name, media_type, log_time, create_time, size, digest.hexdigest(), offset, self.file
            )
        )
        self._index(
            AttachmentIndex(
                offset=raw.offset,
                length=raw.length,
                log_time=log_time,
                create_time=create_time,
                data_size=size,
                name=name,
                media_type=media_type,
            )
        )

    def _chunk(self, raw: _Raw) -> Iterator[Stored]:
        place = f"chunk at offset {raw.offset}"
        data = self._content(raw)
        if len(data) < _CHUNK.size:
            raise _Bad(f"{place}: it is too short to be one")
        first, last, size, crc, compression, length = _CHUNK.unpack_from(data)
        content = data[_CHUNK.size :]
        if compression or not size == length == len(content):
            raise _Bad(f"{place}: it is not stored as it is")
        if crc != zlib.crc32(content):
            raise _Bad(f"{place}: its checksum is wrong")
        indexes: dict[int, list[bytes]] = {}
        try:
            messages = list(self._parts(content, raw.offset + PREFIX + _CHUNK.size, indexes))
        except _Bad as bad:
            raise _Bad(f"{place}: {bad}") from None
        times = [message.log_time for message in messages]
        if not times or (first, last) != (min(times), max(times)):
            raise _Bad(f"{place}: its times are not those of its messages")
        self.times = (
            (first, last) if self.times is None else (min(self.times[0], first), max(self.times[1], last))
        )
        yield from messages
        self._indexes(raw, place, indexes, (first, last), size)

    def _indexes(
        self, chunk: _Raw, place: str, indexes: dict[int, list[bytes]], times: tuple[int, int], size: int
    ) -> None:
        """The message indexes that follow a chunk, one for each of its channels."""
        offsets: dict[int, int] = {}
        begin = self.at
        for channel, entries in indexes.items():
            raw = self._next()
            if raw is None:
                raise _Torn(self.at)
            body = b"".join(entries)
            expected = struct.pack("<HI", channel, len(body)) + body
            if raw.opcode != Opcode.MESSAGE_INDEX or self._content(raw) != expected:
                raise _Bad(f"{place}: the index at offset {raw.offset} is not that of its messages")
            offsets[channel] = raw.offset
        self._index(
            ChunkIndex(
                message_start_time=times[0],
                message_end_time=times[1],
                chunk_start_offset=chunk.offset,
                chunk_length=chunk.length,
                message_index_offsets=offsets,
                message_index_length=self.at - begin,
                compression="",
                compressed_size=size,
                uncompressed_size=size,
            )
        )

    def _parts(self, content: bytes, place: int, indexes: dict[int, list[bytes]]) -> Iterator[Stored]:
        """The messages of a chunk's content, which stands at ``place`` in the file."""
        at, end = 0, len(content)
        while at < end:
            if end - at < PREFIX:
                raise _Bad(f"a record runs over the end, {at} bytes in")
            opcode, size = _PREFIX.unpack_from(content, at)
            stop = at + PREFIX + size
            if stop > end:
                raise _Bad(f"a record runs over the end, {at} bytes in")
            if opcode == Opcode.MESSAGE:
                data_at = at + PREFIX + _MESSAGE.size
                if data_at > stop:
                    raise _Bad(f"the record at offset {at} cannot be read (a message that is too short)")
                channel_id, sequence, log_time, publish_time = _MESSAGE.unpack_from(content, at + PREFIX)
                channel = self.known.get(channel_id)
                if channel is None:
                    raise _Bad(f"message {sequence} names no channel")
                self.counts[channel_id] = self.counts.get(channel_id, 0) + 1
                indexes.setdefault(channel_id, []).append(_ENTRY.pack(log_time, at))
                yield Stored(
                    channel, log_time, publish_time, sequence, content[data_at:stop], place + data_at
                )
            else:
                self._define(opcode, content[at + PREFIX : stop], at)
            at = stop

    def _define(self, opcode: int, content: bytes, offset: int) -> None:
        """A schema or channel, which stands before its first message."""
        record = _decode(opcode, content, offset)
        self._remember(PREFIX + len(content))
        if isinstance(record, Schema):
            _register(self.schemas, record, "schema")
        elif isinstance(record, Channel):
            schema = self.schemas.get(record.schema_id)
            if schema is None:
                raise _Bad(f"channel {record.topic} names no schema")
            _register(self.channels, record, "channel")
            kind = (record.topic, record.message_encoding, schema.name, schema.data)
            self.known[record.id] = ChannelInfo(*kind, of_channel(*kind))
        else:
            raise _Bad(_misplaced(record, offset, "a chunk"))
        self._index(record)

    # ------------------------------------------------------------ summary

    def _summary(self) -> None:
        """The groups that the data section gives, their offsets, and the footer."""
        start, crc = self.at, 0
        groups: list[_Group] = []
        offsets: list[SummaryOffset] = []
        for raw, record, whole in self._rest():
            if isinstance(record, Footer):
                self._close(groups, offsets)
                self._footer(raw, record, start, groups[-1].end, zlib.crc32(whole[:-4], crc))
                return
            crc = zlib.crc32(whole, crc)
            if isinstance(record, SummaryOffset):
                self._remember(raw.length)
                offsets.append(record)
            elif offsets:
                raise _Bad("the summary's offsets are not those of its groups")
            elif groups and groups[-1].opcode == raw.opcode:
                groups[-1].put(whole)
            elif len(groups) < len(SUMMARY):
                groups.append(_Group(raw.opcode, raw.offset))
                groups[-1].put(whole)
            else:
                raise _Bad("the summary is not that of the data section")

    def _close(self, groups: list["_Group"], offsets: list[SummaryOffset]) -> None:
        if [group.said for group in groups] != self._said():
            raise _Bad("the summary is not that of the data section")
        if offsets != [group.summary_offset for group in groups]:
            raise _Bad("the summary's offsets are not those of its groups")

    def _rest(self) -> Iterator[tuple[_Raw, McapRecord, bytes]]:
        """The records that follow, whole; the file does not end before the last of them that is asked for."""
        while (raw := self._next()) is not None:
            content = self._content(raw)
            yield raw, _decode(raw.opcode, content, raw.offset), _PREFIX.pack(raw.opcode, raw.size) + content
        raise _Torn(self.found.size)

    def _footer(self, raw: _Raw, footer: Footer, start: int, offsets: int, crc: int) -> None:
        """It points at the summary and its offsets, and the file ends behind it."""
        if (footer.summary_start, footer.summary_offset_start) != (start, offsets):
            raise _Bad("the footer does not point at the summary")
        if footer.summary_crc != crc:
            raise _Bad("the summary's checksum is wrong")
        tail = self._take(min(len(MAGIC) + 1, self.found.size - self.at), raw.offset)
        if tail != MAGIC:
            if MAGIC.startswith(tail):
                raise _Torn(raw.offset + raw.length)
            raise _Bad(f"the file does not end with the footer at offset {raw.offset}")

    def _index(self, record: McapRecord) -> None:
        """What the summary must say, in its group."""
        content = _encoded(record)
        self.groups[content[0]].put(content)

    def _said(self) -> list[tuple[int, int, bytes]]:
        """What each group of the summary must be."""
        first, last = self.times or (0, 0)
        self._index(
            Statistics(
                attachment_count=len(self.found.attachments),
                channel_count=len(self.channels),
                channel_message_counts=self.counts,
                chunk_count=self.groups[Opcode.CHUNK_INDEX].count,
                message_count=sum(self.counts.values()),
                message_start_time=first,
                message_end_time=last,
                metadata_count=len(self.found.metadata),
                schema_count=len(self.schemas),
            )
        )
        return [group.said for group in self.groups.values() if group.count]


@dataclass(slots=True)
class _Group:
    """Records of one kind that follow each other in the summary, as one digest: there may be millions."""

    opcode: int
    start: int = 0
    count: int = 0
    length: int = 0
    digest: Any = field(default_factory=sha256)

    def put(self, record: bytes) -> None:
        """One more record."""
        self.count += 1
        self.length += len(record)
        self.digest.update(record)

    @property
    def end(self) -> int:
        """Where the next group stands."""
        return self.start + self.length

    @property
    def said(self) -> tuple[int, int, bytes]:
        """What it holds: equal to another's if all records are."""
        return self.opcode, self.length, self.digest.digest()

    @property
    def summary_offset(self) -> SummaryOffset:
        """What the summary says of where it stands."""
        return SummaryOffset(group_opcode=self.opcode, group_start=self.start, group_length=self.length)


def _decode(opcode: int, content: bytes, offset: int) -> McapRecord:
    kind = KINDS.get(opcode)
    if kind is None:
        raise _Bad(
            f"the record at offset {offset} is {_WHOLE.get(opcode) or f'of unknown kind {opcode:#04x}'}"
        )
    stream = ReadDataStream(BytesIO(content))
    try:
        record: McapRecord = kind.read(stream, len(content)) if kind is Message else kind.read(stream)
        again = _encoded(record)
    except (McapError, ValueError, struct.error, OverflowError, MemoryError) as error:
        raise _Bad(f"the record at offset {offset} cannot be read ({type(error).__name__})") from None
    if again[PREFIX:] != content:
        raise _Bad(f"the record at offset {offset} is damaged or not in its canonical form")
    return record


def _encoded(record: McapRecord) -> bytes:
    """The whole record as it is written."""
    builder = RecordBuilder()
    record.write(builder)
    written: bytes = builder.end()  # type: ignore[no-untyped-call]
    return written


def _register(known: dict[int, Any], record: Any, what: str) -> None:
    if record.id in known or record.id == 0:
        raise _Bad(f"{what} {record.id} is given twice or has no number")
    known[record.id] = record


def _misplaced(record: McapRecord, offset: int, where: str) -> str:
    return f"the record at offset {offset} ({type(record).__name__}) does not belong into {where}"
