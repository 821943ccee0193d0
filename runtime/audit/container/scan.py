"""Reading a log strictly, a chunk at a time: every byte is accounted for, and what is wrong is said, never raised.

Rules, in the order in which they are asked. The file starts with the magic bytes and a header. Each record of
the file is one this program writes, in its canonical form (read and written again it gives the same bytes), and no
larger than a session writes it. Messages stand in chunks only; each chunk's checksum, sizes and times are those of
its content, and its message indexes follow it. The summary is exactly the one that the data section gives. A file
that ends early is torn: everything before is kept.

What is in memory at a time is one chunk, and what the file says of itself; never the file.

    found = Scan()
    for message in walk(file, found):
        head = message.advance(head)
    found.problems  # empty for a sound file; whole only now
"""

from collections.abc import Iterator
from io import SEEK_END, BytesIO
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import DataEnd, Footer, Header, Metadata, MetadataIndex

from cutgate.runtime.audit.container.attachment import read_attachment
from cutgate.runtime.audit.container.chunk import Chunk, Definitions, parse_chunk
from cutgate.runtime.audit.container.kinds import decode, misplaced
from cutgate.runtime.audit.container.raw import (
    HEAD,
    MAGIC,
    PREFIX,
    BrokenError,
    Budget,
    Raw,
    RecordReader,
    TornError,
)
from cutgate.runtime.audit.container.stored import Scan, Stored
from cutgate.runtime.audit.container.summary import Expected, Group, SummaryFound


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
    reader = RecordReader(file, found.size)
    try:
        yield from _Scanner(reader, found).messages()
    except TornError as torn:
        found.torn_at = torn.offset
        file.seek(max(len(MAGIC), found.size - len(MAGIC)))
        # A file with both ends was finished: then a length is wrong, and nothing is missing.
        if file.read(len(MAGIC)) == MAGIC:
            found.problems.append(f"the record at offset {torn.offset} is longer than the file")
    except BrokenError as broken:
        if reader.ends_in_zeros():
            found.torn_at, found.zeros = reader.begun, True
        else:
            found.problems.append(str(broken))


def scan(data: bytes) -> Scan:
    """Read a whole file that is in memory, with all its messages. Never raises."""
    found = Scan()
    found.messages = list(walk(BytesIO(data), found))
    return found


class _Scanner:
    """The walk through one file, from front to back: header, data section, summary, footer."""

    def __init__(self, reader: RecordReader, found: Scan) -> None:
        self.reader = reader
        self.found = found
        self.budget = Budget()
        self.definitions = Definitions(self.budget)
        self.summary = Expected(Group)

    def messages(self) -> Iterator[Stored]:
        first = self.reader.next()
        header = decode(first.opcode, self.reader.content(first), first.offset)
        if not isinstance(header, Header):
            raise BrokenError(f"the record at offset {first.offset} is no header")
        self.found.header = header
        yield from self._data_section()
        self._summary()
        self.found.finished = True

    def _data_section(self) -> Iterator[Stored]:
        while True:
            raw = self.reader.next()
            if raw.opcode == Opcode.CHUNK:
                yield from self._chunk(raw)
            elif raw.opcode == Opcode.ATTACHMENT:
                self._attachment(raw)
            else:
                record = decode(raw.opcode, self.reader.content(raw), raw.offset)
                if isinstance(record, DataEnd):
                    break
                if not isinstance(record, Metadata):
                    raise BrokenError(misplaced(record, raw.offset, "the data section"))
                self.budget.remember(raw.length)
                self.found.metadata.append(record)
                self.summary.add(MetadataIndex(offset=raw.offset, length=raw.length, name=record.name))
        if record.data_section_crc != raw.crc:
            raise BrokenError("the data section's checksum is wrong")

    def _attachment(self, raw: Raw) -> None:
        entry = read_attachment(self.reader, raw, self.budget)
        self.found.attachments.append(entry)
        self.summary.add(entry.summary_index(raw.offset, raw.length))

    def _chunk(self, raw: Raw) -> Iterator[Stored]:
        place = f"chunk at offset {raw.offset}"
        data = self.reader.content(raw)
        try:
            chunk = parse_chunk(data, raw.offset + PREFIX, self.definitions)
        except BrokenError as broken:
            raise BrokenError(f"{place}: {broken}") from None
        self.summary.take_chunk(chunk)
        yield from chunk.messages
        self._indexes(raw, place, chunk)

    def _indexes(self, raw: Raw, place: str, chunk: Chunk) -> None:
        """The message indexes that follow a chunk, one for each of its channels."""
        offsets: dict[int, int] = {}
        begin = self.reader.at
        for channel, expected in chunk.indexes():
            index = self.reader.next()
            if index.opcode != Opcode.MESSAGE_INDEX or self.reader.content(index) != expected:
                raise BrokenError(f"{place}: the index at offset {index.offset} is not that of its messages")
            offsets[channel] = index.offset
        self.summary.add(chunk.summary_index(raw.offset, raw.length, offsets, self.reader.at - begin))

    def _summary(self) -> None:
        """The groups that the data section gives, their offsets, and the footer; the file ends behind it."""
        found = SummaryFound(self.summary, self.reader.at, self.budget)
        while True:
            raw = self.reader.next()
            content = self.reader.content(raw)
            record = decode(raw.opcode, content, raw.offset)
            whole = HEAD.pack(raw.opcode, raw.size) + content
            if isinstance(record, Footer):
                break
            found.take(raw, record, whole)
        found.close(record, whole)
        left = self.found.size - self.reader.at
        tail = self.reader.take(min(PREFIX, left), raw.offset)  # more than the magic bytes tells enough
        if tail != MAGIC:
            if MAGIC.startswith(tail):
                raise TornError(raw.offset + raw.length)
            raise BrokenError(f"the file does not end with the footer at offset {raw.offset}")
