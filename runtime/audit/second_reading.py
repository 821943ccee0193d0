"""The second way of reading a log: the reader of the ``mcap`` library, which viewers use, must find the same in it."""

from collections.abc import Iterator
from hashlib import sha256
from struct import Struct
from typing import Any, BinaryIO, Final

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, get_chunk_data_stream

from cutgate.runtime.audit.chain import GENESIS, covered_in, follow, of_channel
from cutgate.runtime.audit.container.raw import PREFIX
from cutgate.runtime.audit.container.stored import Scan

READ_TWICE_MAX: Final = 64 << 20
"""Bytes of the largest attachment that is read a second way: the stock reader takes it into memory."""
_U1, _U2, _U4, _U8 = (Struct(form).unpack_from for form in ("<B", "<H", "<I", "<Q"))


def read_again(file: BinaryIO, found: Scan, head: bytes) -> tuple[str, tuple[str, ...]]:
    """Whether the stock reader, linearly and by index, reads what we read; and what it was not asked.

    Args:
        file: the log.
        found: what the scan has found in it: a finished log without problems.
        head: of the chain over its messages as the scan read them.

    Returns:
        What differs, empty if nothing does; and notes of what was not read again.
    """
    large = next((entry for entry in found.attachments if entry.size > READ_TWICE_MAX), None)
    if large is not None:
        size = f"attachment {large.name} has {large.size} bytes"
        return "", (f"{size}: a log is read a second way only up to {READ_TWICE_MAX}, this one was not",)
    attached = [(entry.name, entry.sha256) for entry in found.attachments]
    chunks, way = sha256(), "linearly"
    try:
        same = _linearly(file, chunks) == (head, attached)
        if same:
            way = "by index"
            same = _by_index(file) == (chunks.digest(), attached)
    except Exception as error:  # noqa: BLE001 - whatever the reader dislikes, the log is not sound
        return f"read {way}, the file gives an error: {type(error).__name__}", ()
    return "" if same else f"read {way}, the file gives other records", ()


def _linearly(file: BinaryIO, chunks: Any) -> tuple[bytes, list[tuple[str, str]]]:
    """Head of the chain and digest of each attachment, from front to back; the chunks' contents go into ``chunks``."""
    head, attached = GENESIS, []
    schemas: dict[int, Schema] = {}
    channels: dict[int, bytes] = {}
    file.seek(0)
    for record in _Records(file, emit_chunks=True, validate_crcs=True).records:
        if isinstance(record, Attachment):
            attached.append((record.name, sha256(record.data).hexdigest()))
        if not isinstance(record, Chunk):
            continue
        chunks.update(sha256(record.data).digest())
        for part in _parts(record):
            if isinstance(part, Message):
                stamps = (part.log_time, part.publish_time, part.sequence)
                head = follow(head, covered_in(channels[part.channel_id], *stamps, part.data))
            elif isinstance(part, Schema):
                schemas[part.id] = part
            elif isinstance(part, Channel):
                schema = schemas[part.schema_id]
                channels[part.id] = of_channel(part.topic, part.message_encoding, schema.name, schema.data)
    return head, attached


class _Records(StreamReader):
    """The stock reader without message indexes: it would read millions of numbers of which nothing is asked here."""

    def _read_record(self, opcode: int, length: int) -> McapRecord | None:
        return None if opcode == Opcode.MESSAGE_INDEX else super()._read_record(opcode, length)


def _parts(chunk: Chunk) -> Iterator[McapRecord]:
    """The records of a chunk, as ``breakup_chunk`` of the library gives them, each read by the library."""
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    content = _Content(stream.read(size))
    while content.count < size:
        opcode, length = content.read1(), content.read8()
        if opcode == Opcode.MESSAGE:
            yield Message.read(content, length)
        elif opcode == Opcode.CHANNEL:
            yield Channel.read(content)
        elif opcode == Opcode.SCHEMA:
            yield Schema.read(content)
        else:
            content.read(length)


class _Content(ReadDataStream):
    """The library's stream over bytes in memory: a number costs no read of a file, which took half of the reading."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    @property
    def count(self) -> int:
        return self._at

    def read(self, length: int) -> bytes:
        at = self._at
        self._at = end = at + length
        if end > len(self._data):
            raise EndOfFile
        return self._data[at:end]

    def read1(self) -> int:
        at = self._at
        self._at = at + 1
        value: int = _U1(self._data, at)[0]
        return value

    def read2(self) -> int:
        at = self._at
        self._at = at + 2
        value: int = _U2(self._data, at)[0]
        return value

    def read4(self) -> int:
        at = self._at
        self._at = at + 4
        value: int = _U4(self._data, at)[0]
        return value

    def read8(self) -> int:
        at = self._at
        self._at = at + 8
        value: int = _U8(self._data, at)[0]
        return value


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
