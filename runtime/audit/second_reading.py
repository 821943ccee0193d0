"""The second way of reading a log: the reader of the ``mcap`` library, which viewers use, must find the same in it."""

from hashlib import sha256
from typing import Any, BinaryIO, Final

from mcap.data_stream import ReadDataStream
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk

from cutgate.runtime.audit.container.raw import PREFIX
from cutgate.runtime.audit.container.stored import Scan

READ_TWICE_MAX: Final = 64 << 20
"""Bytes of the largest attachment that is read a second way: the stock reader takes it into memory."""


def read_again(file: BinaryIO, found: Scan, read: bytes) -> tuple[str, tuple[str, ...]]:
    """Whether the stock reader, linearly and by index, reads what we read; and what it was not asked.

    Args:
        file: the log.
        found: what the scan has found in it: a finished log without problems.
        read: the digest of its messages (``add_message``) as the scan read them.

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
        same = _linearly(file, chunks) == (read, attached)
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
        if isinstance(record, Attachment):
            attached.append((record.name, sha256(record.data).hexdigest()))
        if not isinstance(record, Chunk):
            continue
        chunks.update(sha256(record.data).digest())
        for part in breakup_chunk(record, validate_crc=True):
            if isinstance(part, Channel):
                channels[part.id] = part
            elif isinstance(part, Message):
                add_message(messages, channels[part.channel_id].topic, part.sequence, part.data)
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


def add_message(digest: Any, topic: str, sequence: int, data: bytes) -> None:
    """One message into the digest of all."""
    digest.update(b"%d %d %d %b%b" % (len(topic), sequence, len(data), topic.encode(), data))
