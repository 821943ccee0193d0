"""A log's bytes, one record of the file after the other; what stands in a record is for others to judge.

What is in memory at a time is one record, and never more than ``RECORD_MAX`` of it.
"""

import zlib
from struct import Struct
from typing import BinaryIO, Final, NamedTuple

MAGIC: Final = b"\x89MCAP0\r\n"
HEAD: Final = Struct("<BQ")
"""What a record begins with: opcode and length of its content."""
PREFIX: Final = HEAD.size
"""Bytes before a record's content."""
RECORD_MAX: Final = 16 << 20
"""Bytes of the largest record that is read, attachments apart; a session closes its chunks at 1 MiB."""
REMEMBERED_MAX: Final = 16 << 20
"""Bytes of schemas, channels, metadata and attachments' names that are remembered; a session has some 50 kB."""
ZEROS_MAX: Final = 64 << 20
"""So many zeros at the end of a file are taken for what a loss of power left: more than the largest chunk."""
PIECE: Final = 1 << 20
"""So much of an attachment, or of zeros, is in memory at a time."""


class BrokenError(Exception):
    """A rule is broken; the text says which and where."""


class TornError(Exception):
    """The bytes end inside the record at ``offset``."""

    def __init__(self, offset: int) -> None:
        self.offset = offset


class Raw(NamedTuple):
    """A record whose content has not been read yet."""

    opcode: int
    offset: int
    size: int
    """Of its content."""
    crc: int
    """Of everything before it."""

    @property
    def length(self) -> int:
        """With opcode and length field."""
        return PREFIX + self.size


class RecordReader:
    """A file from front to back, beginning behind its magic bytes.

    Attributes:
        at: place of the next byte.
        begun: where the record begins that is being read.
        crc: checksum of everything before ``at``.
    """

    def __init__(self, file: BinaryIO, size: int) -> None:
        self.file = file
        self.size = size
        self.at = self.begun = len(MAGIC)
        self.crc = zlib.crc32(MAGIC)

    def next(self) -> Raw:
        """The next record, its content not read yet.

        Raises:
            TornError: the file ends before it, or in it.
        """
        offset, crc = self.at, self.crc
        self.begun = offset
        opcode, size = HEAD.unpack(self.take(PREFIX, offset))
        if self.size - self.at < size:
            raise TornError(offset)
        return Raw(opcode, offset, size, crc)

    def take(self, count: int, record: int) -> bytes:
        """The next bytes; ``record`` is the offset of the record that they belong to.

        Raises:
            TornError: there are fewer.
        """
        self.file.seek(self.at)
        data = self.file.read(count)
        if len(data) < count:  # somebody has cut the file meanwhile
            raise TornError(record)
        self.at += count
        self.crc = zlib.crc32(data, self.crc)
        return data

    def content(self, raw: Raw) -> bytes:
        """The content of the record that ``next`` gave.

        Raises:
            BrokenError: it is larger than any that a session writes.
            TornError: it ends early.
        """
        if not raw.size <= RECORD_MAX:
            raise BrokenError(
                f"the record at offset {raw.offset} has {raw.size} bytes, a session writes at most {RECORD_MAX}"
            )
        return self.take(raw.size, raw.offset)

    def ends_in_zeros(self) -> bool:
        """Whether the record that is being read ends in zeros, and nothing but zeros follow it to the file's end."""
        if not self.size - self.at <= ZEROS_MAX:
            return False
        self.file.seek(min(self.at - 1, self.size - PREFIX))  # fewer are as good as a changed byte
        return not any(any(piece) for piece in iter(lambda: self.file.read(PIECE), b""))


class Budget:
    """What a file may say of itself: it is remembered until the end, and so bounded."""

    def __init__(self) -> None:
        self.remembered = 0

    def remember(self, size: int) -> None:
        """So many bytes more.

        Raises:
            BrokenError: over the bound.
        """
        self.remembered += size
        if not self.remembered <= REMEMBERED_MAX:
            raise BrokenError(
                "it holds more schemas, channels, metadata and attachments than any session writes: "
                f"over {REMEMBERED_MAX} bytes without their content"
            )
