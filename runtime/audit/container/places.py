"""Where a log's chunks stand, without reading them: by its index, or where a crash has left none, from record to record.

The index is as long as the log has chunks, some 150 bytes each. Without one, the length before each record leads to the
next: of a chunk nothing is read but that, and of what follows it the numbers of the channels that it has messages of.
"""

from collections.abc import Iterator
from io import SEEK_END
from typing import BinaryIO, Final, NamedTuple

from mcap.opcode import Opcode
from mcap.records import ChunkIndex, Footer, SummaryOffset

from cutgate.runtime.audit.container.chunk import Chunk, Definitions, parse_chunk
from cutgate.runtime.audit.container.kinds import decode
from cutgate.runtime.audit.container.raw import HEAD, MAGIC, PREFIX, RECORD_MAX, BrokenError, RecordReader

FOOTER: Final = PREFIX + 20
"""Bytes of the footer."""
OFFSETS_MAX: Final = 1 << 12
"""Bytes of the offsets of a summary's groups; six groups have 156."""
INDEX_MAX: Final = 64 << 20
"""Bytes of the largest index that is read; an hour of cutting has 2 MB of it."""
RECORDS_MAX: Final = 1 << 20
"""Records of a file without an index that are looked at; an hour of cutting has some 40 000."""
_OF_DATA: Final = (
    Opcode.HEADER,
    Opcode.METADATA,
    Opcode.ATTACHMENT,
    Opcode.CHUNK,
    Opcode.MESSAGE_INDEX,
    Opcode.DATA_END,
)
"""Records of the file before its summary."""
_CHANNEL: Final = 2
"""Bytes of the number of a message index's channel, with which it begins."""


class ChunkPlace(NamedTuple):
    """Offset of a chunk, and the channels of its messages; None where a cut leaves that unknown."""

    offset: int
    channels: frozenset[int] | None


def by_index(file: BinaryIO) -> Iterator[ChunkPlace]:
    """The chunks that the summary of a finished file names, in file order.

    Raises:
        BrokenError: the file has no summary, or none that a session writes.
        OSError: it cannot be read.
    """
    size = file.seek(0, SEEK_END)
    end = size - FOOTER - len(MAGIC)
    footer = next(_records(file, end, end + FOOTER, FOOTER), None) if end > 0 else None
    file.seek(max(0, size - len(MAGIC)))
    if not isinstance(footer, Footer) or file.read() != MAGIC:
        raise BrokenError("the file has no footer")
    for entry in _records(file, footer.summary_offset_start, end, OFFSETS_MAX):
        if isinstance(entry, SummaryOffset) and entry.group_opcode == Opcode.CHUNK_INDEX:
            group_end = entry.group_start + entry.group_length
            if not group_end <= end:
                raise BrokenError("the index of its chunks runs over the summary")
            for index in _records(file, entry.group_start, group_end, INDEX_MAX):
                if not isinstance(index, ChunkIndex):
                    raise BrokenError("the index of its chunks holds something else")
                yield ChunkPlace(index.chunk_start_offset, frozenset(index.message_index_offsets))


def _records(file: BinaryIO, start: int, end: int, bound: int) -> Iterator[object]:
    """The records from here to there, in their canonical form."""
    if not 0 <= end - start <= bound:
        raise BrokenError(f"its summary has a part of {end - start} bytes, must be 0 to {bound}")
    file.seek(start)
    data, at = file.read(end - start), 0
    while at < len(data):
        if len(data) - at < PREFIX:
            raise BrokenError("a record of its summary runs over the end")
        opcode, length = HEAD.unpack_from(data, at)
        yield decode(opcode, data[at + PREFIX : at + PREFIX + length], start + at)
        at += PREFIX + length


def by_hops(file: BinaryIO) -> Iterator[ChunkPlace]:
    """The whole chunks of a file, from its beginning to the end of its data, or to where it was cut.

    Raises:
        BrokenError: what follows is no record, or there are more than any session writes.
        OSError: it cannot be read.
    """
    offset: int | None = None
    channels: set[int] = set()
    for at, opcode, channel in _heads(file):
        if opcode == Opcode.MESSAGE_INDEX:
            channels.add(channel)
            continue
        if offset is not None:
            yield ChunkPlace(offset, frozenset(channels))
        offset, channels = at if opcode == Opcode.CHUNK else None, set()
    if offset is not None:
        yield ChunkPlace(offset, None)


def _heads(file: BinaryIO) -> Iterator[tuple[int, int, int]]:
    """Of each whole record up to the end of the data its offset, its kind, and the two bytes that it begins with."""
    reader = RecordReader(file, file.seek(0, SEEK_END))
    for _ in range(RECORDS_MAX):
        at = reader.at
        file.seek(at)
        head = file.read(PREFIX + _CHANNEL)
        if len(head) < PREFIX:
            return
        opcode, size = HEAD.unpack_from(head)
        if opcode not in _OF_DATA:
            reader.at = at + PREFIX
            if reader.ends_in_zeros():
                return
            raise BrokenError(
                f"the record at offset {at} is of kind {opcode:#04x}, which no session writes there"
            )
        if not size <= reader.size - at - PREFIX:
            return
        yield at, opcode, int.from_bytes(head[PREFIX:], "little")
        if opcode == Opcode.DATA_END:
            return
        reader.at = at + PREFIX + size
    raise BrokenError(f"it holds over {RECORDS_MAX} records; no session writes so many")


def chunk_at(file: BinaryIO, offset: int, definitions: Definitions) -> Chunk:
    """The chunk at this offset.

    Raises:
        BrokenError: there is none that is sound.
        OSError: it cannot be read.
    """
    file.seek(offset)
    head = file.read(PREFIX)
    opcode, size = HEAD.unpack(head) if len(head) == PREFIX else (0, 0)
    if opcode != Opcode.CHUNK or not size <= RECORD_MAX:
        raise BrokenError(f"there is no chunk at offset {offset}")
    try:
        return parse_chunk(file.read(size), offset + PREFIX, definitions)
    except BrokenError as broken:
        raise BrokenError(f"chunk at offset {offset}: {broken}") from None


def cut_in_zeros(file: BinaryIO, offset: int) -> bool:
    """Whether the chunk at this offset ends in zeros, and nothing else follows: a loss of power leaves that."""
    reader = RecordReader(file, file.seek(0, SEEK_END))
    file.seek(offset)
    reader.at = offset + PREFIX + HEAD.unpack(file.read(PREFIX))[1]
    return reader.ends_in_zeros()
