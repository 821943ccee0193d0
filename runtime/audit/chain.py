"""What is covered of each message of a log, and the hash chain over it, in file order.

    covered = topic | encoding | schema name | SHA-256(schema) | times | sequence | data
    h_n = SHA-256(h_{n-1} | covered)

Texts and data are preceded by their length (64 bit, little endian), so that no two different messages give the
same bytes. ``/audit/`` records carry h_{n-1} inside their data, and so are bound to everything before them. The tree
(``tree.py``) has the same bytes as its leaves: they are made by ``covered_in`` and nowhere else.
"""

import struct
from dataclasses import dataclass
from hashlib import sha256
from typing import Final, NamedTuple

GENESIS: Final = bytes(32)
"""The head before the first message."""
LINKED: Final = "/audit/"
"""Topics whose records carry ``prev``."""
_DIGEST: Final = 32
_LENGTH: Final = struct.Struct("<Q")
_STAMPS: Final = struct.Struct("<QQIQ")
"""Times, sequence, and the length of the data."""


@dataclass(frozen=True, slots=True)
class ChainLink:
    """What is covered of one message. Times in nanoseconds."""

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
    return follow(head, covered(link))


def follow(head: bytes, covered: bytes) -> bytes:
    """As ``advance``, for a message of which these bytes are covered."""
    return sha256(head + covered).digest()


def covered(link: ChainLink) -> bytes:
    """The bytes that chain and tree cover of a message."""
    channel = of_channel(link.topic, link.encoding, link.schema_name, link.schema)
    return covered_in(channel, link.log_time, link.publish_time, link.sequence, link.data)


def of_channel(topic: str, encoding: str, schema_name: str, schema: bytes) -> bytes:
    """What is covered of a message beside the message itself: the same for all of one channel."""
    texts = (topic.encode(), encoding.encode(), schema_name.encode())
    return b"".join((*map(_counted, texts), sha256(schema).digest()))


def covered_in(channel: bytes, log_time: int, publish_time: int, sequence: int, data: bytes) -> bytes:
    """As ``covered``, for a message of the channel that ``of_channel`` gave."""
    return b"".join((channel, _STAMPS.pack(log_time, publish_time, sequence, len(data)), data))


class Covered(NamedTuple):
    """The parts of the bytes that are covered of one message. Times in nanoseconds."""

    topic: str
    encoding: str
    schema_name: str
    schema_sha256: bytes
    log_time: int
    publish_time: int
    sequence: int
    data: bytes


def parts_of(covered: bytes) -> Covered:
    """The parts of what ``covered_in`` gives.

    Raises:
        ValueError: no message gives these bytes.
    """
    texts, rest = [], covered
    try:
        for _ in range(3):
            text, rest = _taken(rest)
            texts.append(text.decode())
        schema, rest = rest[:_DIGEST], rest[_DIGEST:]
        log_time, publish_time, sequence, size = _STAMPS.unpack_from(rest)
    except (struct.error, UnicodeDecodeError):
        raise ValueError("it ends early, or its topic, encoding or schema name is no UTF-8") from None
    data = rest[_STAMPS.size :]
    if size != len(data):
        raise ValueError(f"{len(data)} bytes of data follow, it names {size}")
    topic, encoding, schema_name = texts
    return Covered(topic, encoding, schema_name, schema, log_time, publish_time, sequence, data)


def _taken(data: bytes) -> tuple[bytes, bytes]:
    """What is preceded by its length, and what follows it. Raises struct.error where the length is not there."""
    (size,) = _LENGTH.unpack_from(data)
    end = _LENGTH.size + size
    return data[_LENGTH.size : end], data[end:]


def _counted(data: bytes) -> bytes:
    return _LENGTH.pack(len(data)) + data
