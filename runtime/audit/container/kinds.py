"""The kinds of record that a session writes, and one of them from and to its bytes."""

import struct
from io import BytesIO
from typing import Any, Final

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

from cutgate.runtime.audit.container.raw import PREFIX, BrokenError

KINDS: Final[dict[int, Any]] = {
    Opcode.HEADER: Header, Opcode.FOOTER: Footer, Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel,
    Opcode.MESSAGE: Message, Opcode.MESSAGE_INDEX: MessageIndex, Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex, Opcode.STATISTICS: Statistics, Opcode.METADATA: Metadata,
    Opcode.METADATA_INDEX: MetadataIndex, Opcode.SUMMARY_OFFSET: SummaryOffset, Opcode.DATA_END: DataEnd,
}  # fmt: skip
"""Records that are read as a whole. Chunks, the messages in them and attachments are read by their parts."""
_BY_PARTS: Final[dict[int, str]] = {
    Opcode.CHUNK: "a chunk where none belongs",
    Opcode.ATTACHMENT: "an attachment where none belongs",
}


def decode(opcode: int, content: bytes, offset: int) -> McapRecord:
    """A record from its content.

    Args:
        opcode: its kind.
        content: its bytes behind opcode and length.
        offset: where it stands, for the text of an error.

    Raises:
        BrokenError: of another kind, damaged, or not in its canonical form.
    """
    kind = KINDS.get(opcode)
    if kind is None:
        what = _BY_PARTS.get(opcode) or f"of unknown kind {opcode:#04x}"
        raise BrokenError(f"the record at offset {offset} is {what}")
    stream = ReadDataStream(BytesIO(content))
    try:
        record: McapRecord = kind.read(stream, len(content)) if kind is Message else kind.read(stream)
        again = encoded(record)
    except (McapError, ValueError, struct.error, OverflowError, MemoryError) as error:
        raise BrokenError(f"the record at offset {offset} cannot be read ({type(error).__name__})") from None
    if again[PREFIX:] != content:
        raise BrokenError(f"the record at offset {offset} is damaged or not in its canonical form")
    return record


def encoded(record: McapRecord) -> bytes:
    """The whole record as it is written."""
    builder = RecordBuilder()
    record.write(builder)
    written: bytes = builder.end()  # type: ignore[no-untyped-call]
    return written


def misplaced(record: McapRecord, offset: int, where: str) -> str:
    """What is said of a record that may not stand there."""
    return f"the record at offset {offset} ({type(record).__name__}) does not belong into {where}"
