"""Checkpoints of a log's tree, https://c2sp.org/tlog-checkpoint: three lines, as a signed note.

    cutgate/<log id>
    <records, decimal>
    <root of the tree, base64>

A log is a tree of its own: the first line, its origin, and the name of the key that signs it are the same. The whole
file is signed in the same form: the origin goes on with ``/file``, the number is that of its bytes, and the hash is its
SHA-256. So that neither is taken for the other, the origin is asked for when it is read.
"""

import re
from base64 import b64decode, b64encode
from dataclasses import dataclass
from typing import Final

from cutgate.runtime.audit.signing.note import NoteError

HASH_BYTES: Final = 32
FILE: Final = "/file"
_LINES: Final = re.compile(r"([^\n]+)\n(0|[1-9][0-9]{0,18})\n([A-Za-z0-9+/]{43}=)\n")


def origin_of(log_id: str) -> str:
    """Origin and key name of a log; ``log_id`` as record 0 has it."""
    return f"cutgate/{log_id}"


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """So much there is, and this is its hash: a tree's size and root, or a file's size and SHA-256.

    Attributes:
        origin: what it is of.
        size: records, or bytes.
        hash: 32 bytes.
    """

    origin: str
    size: int
    hash: bytes

    @property
    def text(self) -> str:
        """The three lines."""
        return f"{self.origin}\n{self.size}\n{b64encode(self.hash).decode()}\n"

    @classmethod
    def parse(cls, text: str, origin: str) -> "Checkpoint":
        """From its three lines, of this origin and in their one form.

        Raises:
            NoteError: it is none, or of another origin.
        """
        lines = _LINES.fullmatch(text)
        if lines is None:
            raise NoteError("a checkpoint is three lines: origin, size, and hash")
        found = cls(lines[1], int(lines[2]), b64decode(lines[3]))
        if found.text != text:
            raise NoteError("its hash is not in its one form")
        if found.origin != origin:
            raise NoteError(f"its origin is {found.origin!r}, must be {origin!r}")
        return found
