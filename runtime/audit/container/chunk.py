"""The content of one chunk: its messages, and the schemas and channels that stand before them.

Messages stand in chunks only. Each chunk's checksum, sizes and times are those of its content; a schema or channel is
given once, and before the first message that needs it.
"""

import struct
import zlib
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, McapRecord, Schema

from cutgate.runtime.audit.chain import of_channel
from cutgate.runtime.audit.container.kinds import decode, misplaced
from cutgate.runtime.audit.container.raw import HEAD, PREFIX, BrokenError, Budget
from cutgate.runtime.audit.container.stored import ChannelInfo, Stored

_CHUNK: Final = struct.Struct("<QQQIIQ")
"""First and last time, size, checksum, length of the compression's name (none), length of the content."""
_MESSAGE: Final = struct.Struct("<HIQQ")
"""Channel, sequence, log and publish time."""
_ENTRY: Final = struct.Struct("<QQ")
"""Of a message index: time and place."""


class Definitions:
    """The schemas and channels of a file so far."""

    def __init__(self, budget: Budget) -> None:
        self.channels: dict[int, ChannelInfo] = {}
        self._schemas: dict[int, Schema] = {}
        self._budget = budget

    def add(self, opcode: int, content: bytes, offset: int) -> McapRecord:
        """A schema or channel, from its content; ``offset`` is its place in the chunk.

        Raises:
            BrokenError: it is none, is given twice, or names no schema.
        """
        record = decode(opcode, content, offset)
        self._budget.remember(PREFIX + len(content))
        if isinstance(record, Schema):
            _new(self._schemas, record, "schema")
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            schema = self._schemas.get(record.schema_id)
            if schema is None:
                raise BrokenError(f"channel {record.topic} names no schema")
            _new(self.channels, record, "channel")
            kind = (record.topic, record.message_encoding, schema.name, schema.data)
            self.channels[record.id] = ChannelInfo(*kind, of_channel(*kind))
        else:
            raise BrokenError(misplaced(record, offset, "a chunk"))
        return record


def _new(known: dict[int, Any], record: Schema | Channel, what: str) -> None:
    if record.id in known or record.id == 0:
        raise BrokenError(f"{what} {record.id} is given twice or has no number")


class Chunk(NamedTuple):
    """A chunk that is sound in itself.

    Attributes:
        messages: in its order.
        defined: the schemas and channels that it gives.
        first, last: the times of its messages, nanoseconds.
        size: of its content, bytes.
        entries: of each of its channels the entries of the message index that must follow.
    """

    messages: list[Stored]
    defined: list[McapRecord]
    first: int
    last: int
    size: int
    entries: dict[int, list[bytes]]

    def indexes(self) -> Iterator[tuple[int, bytes]]:
        """Of each channel the content of the message index that must follow."""
        for channel, entries in self.entries.items():
            body = b"".join(entries)
            yield channel, struct.pack("<HI", channel, len(body)) + body

    def summary_index(
        self, offset: int, length: int, offsets: dict[int, int], indexes_length: int
    ) -> ChunkIndex:
        """What the summary holds of it.

        Args:
            offset: of the chunk's record in the file.
            length: of this record, bytes.
            offsets: of the message index of each channel.
            indexes_length: of all of these, bytes.
        """
        return ChunkIndex(
            message_start_time=self.first,
            message_end_time=self.last,
            chunk_start_offset=offset,
            chunk_length=length,
            message_index_offsets=offsets,
            message_index_length=indexes_length,
            compression="",
            compressed_size=self.size,
            uncompressed_size=self.size,
        )


def parse_chunk(data: bytes, offset: int, definitions: Definitions) -> Chunk:
    """A chunk from its content.

    Args:
        data: the record's content.
        offset: of the content in the file.
        definitions: what the chunks before it have defined; goes on with what this one does.

    Raises:
        BrokenError: a rule is broken.
    """
    if len(data) < _CHUNK.size:
        raise BrokenError("it is too short to be one")
    first, last, size, crc, compression, length = _CHUNK.unpack_from(data)
    content = data[_CHUNK.size :]
    if compression or not size == length == len(content):
        raise BrokenError("it is not stored as it is")
    if crc != zlib.crc32(content):
        raise BrokenError("its checksum is wrong")
    parts = _Parts(content, offset + _CHUNK.size, definitions)
    messages = list(parts.messages())
    times = [message.log_time for message in messages]
    if not times or (first, last) != (min(times), max(times)):
        raise BrokenError("its times are not those of its messages")
    return Chunk(messages, parts.defined, first, last, size, parts.entries)


class _Parts:
    """The records of a chunk's content, which stands at ``place`` in the file."""

    def __init__(self, content: bytes, place: int, definitions: Definitions) -> None:
        self.content = content
        self.place = place
        self.definitions = definitions
        self.defined: list[McapRecord] = []
        self.entries: dict[int, list[bytes]] = {}

    def messages(self) -> Iterator[Stored]:
        at, end = 0, len(self.content)
        while at < end:
            if end - at < PREFIX:
                raise BrokenError(f"a record runs over the end, {at} bytes in")
            opcode, size = HEAD.unpack_from(self.content, at)
            stop = at + PREFIX + size
            if stop > end:
                raise BrokenError(f"a record runs over the end, {at} bytes in")
            if opcode == Opcode.MESSAGE:
                yield self._message(at, stop)
            else:
                self.defined.append(self.definitions.add(opcode, self.content[at + PREFIX : stop], at))
            at = stop

    def _message(self, at: int, stop: int) -> Stored:
        data_at = at + PREFIX + _MESSAGE.size
        if data_at > stop:
            raise BrokenError(f"the record at offset {at} cannot be read (a message that is too short)")
        channel_id, sequence, log_time, publish_time = _MESSAGE.unpack_from(self.content, at + PREFIX)
        channel = self.definitions.channels.get(channel_id)
        if channel is None:
            raise BrokenError(f"message {sequence} names no channel")
        self.entries.setdefault(channel_id, []).append(_ENTRY.pack(log_time, at))
        data = self.content[data_at:stop]
        return Stored(channel, log_time, publish_time, sequence, data, self.place + data_at)
