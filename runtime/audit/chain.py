"""The hash chain over every message of a log, in file order.

    h_n = SHA-256(h_{n-1} | topic | encoding | schema name | SHA-256(schema) | times | sequence | data)

Texts and data are preceded by their length (64 bit, little endian), so that no two different messages give the
same bytes. ``/audit/`` records carry h_{n-1} inside their data, and so are bound to everything before them.
"""

import struct
from dataclasses import dataclass
from hashlib import sha256
from typing import Final

GENESIS: Final = bytes(32)
"""The head before the first message."""
LINKED: Final = "/audit/"
"""Topics whose records carry ``prev``."""
_STAMPS: Final = struct.Struct("<QQIQ")
"""Times, sequence, and the length of the data."""


@dataclass(frozen=True, slots=True)
class ChainLink:
    """What the chain covers of one message. Times in nanoseconds."""

    topic: str
    encoding: str
    schema_name: str
    schema: bytes
    log_time: int
    publish_time: int
    sequence: int
    data: bytes


def advance(head: bytes, link: ChainLink) -> bytes:
    """The head after this message, 32 bytes."""
    channel = of_channel(link.topic, link.encoding, link.schema_name, link.schema)
    return advance_in(channel, head, link.log_time, link.publish_time, link.sequence, link.data)


def of_channel(topic: str, encoding: str, schema_name: str, schema: bytes) -> bytes:
    """What the chain covers of a message beside the message itself: the same for all of one channel."""
    texts = (topic.encode(), encoding.encode(), schema_name.encode())
    return b"".join((*map(_counted, texts), sha256(schema).digest()))


def advance_in(
    channel: bytes, head: bytes, log_time: int, publish_time: int, sequence: int, data: bytes
) -> bytes:
    """As ``advance``, for a message of the channel that ``of_channel`` gave."""
    return sha256(
        b"".join((head, channel, _STAMPS.pack(log_time, publish_time, sequence, len(data)), data))
    ).digest()


def _counted(data: bytes) -> bytes:
    return struct.pack("<Q", len(data)) + data
