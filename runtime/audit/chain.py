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


@dataclass(frozen=True, slots=True)
class Link:
    """What the chain covers of one message. Times in nanoseconds."""

    topic: str
    encoding: str
    schema_name: str
    schema: bytes
    log_time: int
    publish_time: int
    sequence: int
    data: bytes


def advance(head: bytes, link: Link) -> bytes:
    """The head after this message, 32 bytes."""
    parts = (
        head,
        _counted(link.topic.encode()),
        _counted(link.encoding.encode()),
        _counted(link.schema_name.encode()),
        sha256(link.schema).digest(),
        struct.pack("<QQI", link.log_time, link.publish_time, link.sequence),
        _counted(link.data),
    )
    return sha256(b"".join(parts)).digest()


def _counted(data: bytes) -> bytes:
    return struct.pack("<Q", len(data)) + data
