"""What signs one log: checkpoints while it grows, and the whole file once it is closed.

    sidecar = {"schema": "cutgate.signature/1", "checkpoint": note, "file": note}

The sidecar stands beside the log. Its checkpoint covers all records, the close record among them; its other note the
file's bytes, so that index and summary, which no record covers, are signed too.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cutgate.runtime.audit.signing import note
from cutgate.runtime.audit.signing.checkpoint import FILE, Checkpoint, origin_of
from cutgate.runtime.audit.signing.log_key import LogKey

SCHEMA: Final = "cutgate.signature/1"
SUFFIX: Final = ".signature.json"
SIDECAR_MAX: Final = 2 * note.NOTE_MAX
"""Bytes of the largest sidecar that is read; a session's has 600."""


def sidecar_of(log: Path) -> Path:
    """Where the signature of a closed log stands: beside it."""
    return log.with_suffix(SUFFIX)


class Signer:
    """Signs the log of this id with this key; the secret is in its memory alone.

    Args:
        key: of the session.
        log_id: hex, as record 0 has it.
    """

    def __init__(self, key: LogKey, log_id: str) -> None:
        self.key = key.public
        self._secret = key.private
        self._origin = origin_of(log_id)

    def checkpoint(self, size: int, root: bytes) -> str:
        """The note over a tree of so many records with this root."""
        return note.sign(Checkpoint(self._origin, size, root).text, self._origin, self._secret)

    def sidecar(self, size: int, root: bytes, file_bytes: int, file_sha256: bytes) -> bytes:
        """The sidecar of a closed log: of its whole tree, and of its file's bytes."""
        whole = Checkpoint(self._origin + FILE, file_bytes, file_sha256).text
        return Sidecar(self.checkpoint(size, root), note.sign(whole, self._origin, self._secret)).encode()


@dataclass(frozen=True, slots=True)
class Sidecar:
    """Two notes, neither verified: over the whole tree, and over the file's bytes."""

    checkpoint: str
    file: str

    def encode(self) -> bytes:
        """The file's content."""
        content = {"schema": SCHEMA, "checkpoint": self.checkpoint, "file": self.file}
        return json.dumps(content, ensure_ascii=False, indent=1).encode() + b"\n"

    @classmethod
    def parse(cls, data: bytes) -> "Sidecar":
        """Raises ValueError for anything else."""
        if not len(data) <= SIDECAR_MAX:
            raise ValueError(f"it has {len(data)} bytes, at most {SIDECAR_MAX}")
        try:
            content = json.loads(data)
        except (ValueError, RecursionError):
            raise ValueError("it is not JSON") from None
        if not isinstance(content, dict) or content.get("schema") != SCHEMA:
            raise ValueError(f"its schema must be {SCHEMA!r}")
        checkpoint, file = content.get("checkpoint"), content.get("file")
        if not (isinstance(checkpoint, str) and isinstance(file, str)):
            raise ValueError("it must hold two notes, checkpoint and file")  # noqa: TRY004 - as all else that is wrong
        return cls(checkpoint, file)
