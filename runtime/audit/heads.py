"""The chain's head of a log that another session has left, for the record 0 that follows on it."""

import json
import struct
from io import SEEK_END, BytesIO
from typing import BinaryIO, Final, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.records import Chunk, Message
from mcap.stream_reader import breakup_chunk

from cutgate.runtime.audit.chain import GENESIS, LINKED, ChainLink, advance, follow
from cutgate.runtime.audit.container.raw import MAGIC, PREFIX, RECORD_MAX
from cutgate.runtime.audit.container.scan import walk
from cutgate.runtime.audit.container.stored import Scan
from cutgate.runtime.audit.tree import Tree

SUMMARY_MAX: Final = 64 << 20
"""Bytes of the largest summary that is read; an hour of cutting has 2 MB of it."""
_ENDING: Final = 20 + len(MAGIC)
"""What a footer says, first where the summary begins; and the last magic bytes."""
_DISLIKES: Final = (
    McapError, ValueError, LookupError, TypeError, struct.error, OverflowError, RecursionError, MemoryError,
)  # fmt: skip
"""What the stock reader raises on a file that is none."""


class Recoverable(NamedTuple):
    """What is left of a log: the chain's head, and size and root of the tree, over all whole chunks."""

    head: bytes
    size: int
    root: bytes


def recoverable(file: BinaryIO) -> Recoverable:
    """What is left of a log that was cut short; the start of chain and tree if nothing is.

    Raises:
        OSError: the file cannot be read.
    """
    head, tree = GENESIS, Tree()
    for message in walk(file, Scan()):
        covered = message.covered
        head = follow(head, covered)
        tree.append(covered)
    return Recoverable(head, tree.size, tree.root)


def recoverable_head(file: BinaryIO) -> str:
    """The chain's head of ``recoverable``, in hex."""
    return recoverable(file).head.hex()


def closing_head(file: BinaryIO) -> str:
    """The chain's head of a log that was closed, in hex: read off its end, from the last record that is linked on.

    What stands before the last chunk is not looked at; ``inspect`` does that.

    Raises:
        ValueError: it does not end as a closed log does.
        OSError: the file cannot be read.
    """
    try:
        head = _linked_on(file)
    except _DISLIKES as error:
        raise ValueError(f"it does not end as a closed log does ({type(error).__name__}: {error})") from None
    if head is None:
        raise ValueError("it does not end as a closed log does (nothing in its last chunk is linked on)")
    return head.hex()


def _linked_on(file: BinaryIO) -> bytes | None:
    """The head after the last chunk, from the first ``prev`` in it; None where there is none."""
    size = file.seek(0, SEEK_END)
    file.seek(max(0, size - _ENDING))
    (start,) = struct.unpack("<Q", file.read(_ENDING)[:8])
    if not size - SUMMARY_MAX <= start < size:
        raise ValueError("its summary is larger than any that a session writes")
    file.seek(0)
    summary = SeekingReader(file, record_size_limit=RECORD_MAX).get_summary()
    last = max(summary.chunk_indexes if summary else (), key=lambda index: index.chunk_start_offset)
    if summary is None or not PREFIX < last.chunk_length <= RECORD_MAX:
        raise ValueError("its last chunk is longer than any that a session writes")
    file.seek(last.chunk_start_offset + PREFIX)
    chunk = Chunk.read(ReadDataStream(BytesIO(file.read(last.chunk_length - PREFIX))))
    head: bytes | None = None
    for message in breakup_chunk(chunk, validate_crc=True):
        if not isinstance(message, Message):
            continue
        channel = summary.channels[message.channel_id]
        schema = summary.schemas[channel.schema_id]
        link = ChainLink(
            channel.topic, channel.message_encoding, schema.name, schema.data,
            message.log_time, message.publish_time, message.sequence, message.data,
        )  # fmt: skip
        if head is None and channel.topic.startswith(LINKED):
            head = bytes.fromhex(json.loads(message.data)["prev"])
        if head is not None:
            head = advance(head, link)
    return head
