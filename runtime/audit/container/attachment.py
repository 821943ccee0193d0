"""One attachment, a piece of its bytes after the other: name, size, digest and checksum, never the whole of it."""

import struct
import zlib
from hashlib import sha256
from typing import Final

from cutgate.runtime.audit.container.raw import PIECE, PREFIX, BrokenError, Budget, Raw, RecordReader
from cutgate.runtime.audit.container.stored import StoredAttachment

_TIMES: Final = struct.Struct("<QQ")
"""Log and create time."""
_CRC: Final = 4
"""Bytes of the checksum at its end."""


def read_attachment(reader: RecordReader, raw: Raw, budget: Budget) -> StoredAttachment:
    """Log and create time, name, media type, length, bytes, checksum.

    Raises:
        BrokenError: it is not what it says of itself.
        TornError: the file ends early.
    """
    return _Attachment(reader, raw, budget).read()


class _Attachment:
    """The fields of one attachment, in their order, and the checksum over them."""

    def __init__(self, reader: RecordReader, raw: Raw, budget: Budget) -> None:
        self.reader = reader
        self.offset = raw.offset
        self.end = raw.offset + raw.length - _CRC
        self.budget = budget
        self.crc = 0

    @property
    def place(self) -> str:
        return f"the record at offset {self.offset}"

    def read(self) -> StoredAttachment:
        log_time, create_time = _TIMES.unpack(self.field(_TIMES.size))
        try:
            name, media_type = self.text(), self.text()
        except UnicodeDecodeError:
            raise BrokenError(f"{self.place} cannot be read (a name that is no UTF-8)") from None
        size = int.from_bytes(self.field(8), "little")
        offset, digest = self.reader.at, sha256()
        if offset + size != self.end:
            raise self.damaged()
        while self.reader.at < self.end:
            digest.update(self.field(min(PIECE, self.end - self.reader.at)))
        if int.from_bytes(self.reader.take(_CRC, self.offset), "little") != self.crc:
            raise self.damaged()
        self.budget.remember(PREFIX)
        file = self.reader.file
        return StoredAttachment(
            name, media_type, log_time, create_time, size, digest.hexdigest(), offset, file
        )

    def field(self, size: int) -> bytes:
        """So many bytes."""
        if not size <= self.end - self.reader.at:
            raise BrokenError(f"{self.place} cannot be read (an attachment longer than its record)")
        data = self.reader.take(size, self.offset)
        self.crc = zlib.crc32(data, self.crc)
        return data

    def text(self) -> str:
        """A text behind its length."""
        size = int.from_bytes(self.field(4), "little")
        self.budget.remember(size)
        return self.field(size).decode()

    def damaged(self) -> BrokenError:
        return BrokenError(f"{self.place} is damaged or not in its canonical form")
