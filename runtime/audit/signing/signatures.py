"""The rule on what is signed of a log, one record after the other.

    signatures = Signatures()
    for record in the log, in its order:
        signatures.take(number, topic, record, tree of all records before it)
    signatures.end(last topic)
    signatures.wrong  # empty where the rule is kept

Record 0 names the key that signs the log. A checkpoint signs the tree of all records before itself, under the log's own
origin. A chunk ends in one, so behind the last of them stands nothing, or the close record alone, which the sidecar
signs. What a permit or start names of the tree is what a checkpoint signed. A log whose record 0 names no key is of
0.1.0 or before: nothing of it is signed.
"""

from typing import Any, Final

from cutgate.runtime.audit.records import AuditCheckpoint, AuditClose, AuditPermit
from cutgate.runtime.audit.signing import note
from cutgate.runtime.audit.signing.checkpoint import Checkpoint, origin_of
from cutgate.runtime.audit.signing.log_key import (
    CERTIFICATE_BYTES,
    EPOCH_MAX,
    FIRST_EPOCH,
    KEY_BYTES,
    SERIES_BYTES,
    PublicLogKey,
)
from cutgate.runtime.audit.signing.note import NoteError, VerifierKey
from cutgate.runtime.audit.signing.signer import Sidecar
from cutgate.runtime.audit.tree import Tree

_CHECKPOINT: Final = AuditCheckpoint.TOPIC
_PERMIT: Final = AuditPermit.TOPIC
"""Looked up once: an attribute of a model's class takes its time, and this is asked of every record."""
KEY_FIELDS: Final = ("series", "epoch", "public_key", "certificate", "enrolled")
"""Fields of record 0 that a log before signatures has none of."""


def key_of(record: dict[str, Any]) -> PublicLogKey | None:
    """The key that a record 0 names; None where it names none, as before logs were signed.

    Raises:
        NoteError: what it says is no key.
    """
    if not any(name in record for name in KEY_FIELDS):
        return None
    epoch = record.get("epoch")
    if not (isinstance(epoch, int) and FIRST_EPOCH <= epoch <= EPOCH_MAX):
        raise NoteError(f"its epoch is {epoch!r}, must be {FIRST_EPOCH} to {EPOCH_MAX}")
    certificate = None
    if "certificate" in record:
        certificate = _bytes(record, "certificate", CERTIFICATE_BYTES)
    series, public = _bytes(record, "series", SERIES_BYTES), _bytes(record, "public_key", KEY_BYTES)
    return PublicLogKey(series, epoch, public, certificate)


def _bytes(record: dict[str, Any], name: str, size: int) -> bytes:
    text = record.get(name)
    try:
        data = bytes.fromhex(text) if isinstance(text, str) else b""
    except ValueError:
        data = b""
    if len(data) != size or data.hex() != text:
        raise NoteError(f"its {name} must be {2 * size} hexadecimal digits")
    return data


class Signatures:
    """The rule, record by record.

    Attributes:
        key: that signs the log; None where nothing is signed.
        covered: records that the last good checkpoint signs.
        wrong: the first thing that breaks the rule, with its record; empty if nothing does.
    """

    def __init__(self) -> None:
        self.key: PublicLogKey | None = None
        self.covered = 0
        self.wrong = ""
        self._origin = ""
        self._sizes: set[int] = set()
        self._last: int | None = None
        """Number of the last checkpoint."""

    @property
    def verifier(self) -> VerifierKey:
        """The key under the log's name; only where there is one."""
        assert self.key is not None  # noqa: S101 - asked for only then
        return VerifierKey(self._origin, self.key.public)

    def take(self, number: int, topic: str, record: dict[str, Any], tree: Tree) -> None:
        """The next record, and the tree of all before it."""
        if number == 0:
            self._opened(record)
        if self.key is None or self.wrong:
            return
        told = ""
        if topic == _CHECKPOINT:
            told = self._checkpoint(record, tree)
            self._last = number
        elif topic == _PERMIT and record.get("stage") == "sent" and "log_size" in record:
            size = record["log_size"]
            signed = isinstance(size, int) and size in self._sizes
            told = "" if signed else f"it names a tree of size {size}, which no checkpoint signs"
        if told:
            self.wrong = f"record {number} ({topic}): {told}; {self._first_unsigned}"

    def end(self, count: int, last_topic: str) -> None:
        """The log has so many records, the last of this topic."""
        if self.key is None or self.wrong or count <= 1:
            return
        signed = 1 if self._last is None else self._last + 1
        if count - signed > (last_topic == AuditClose.TOPIC):
            self.wrong = (
                f"behind record {signed - 1} no checkpoint signs the {count - signed} records that follow; "
                f"{self._first_unsigned}"
            )

    def sidecar(self, sidecar: Sidecar, count: int, root: bytes, size: int, sha256: bytes) -> str:
        """What is wrong with the signature beside a closed log; empty if nothing is.

        Args:
            sidecar: what stands there.
            count: records of the whole tree.
            root: its root.
            size: of the file, bytes.
            sha256: of the file.
        """
        try:
            tree = Checkpoint.parse(note.verify(sidecar.checkpoint, self.verifier), self._origin)
            file = Checkpoint.parse(note.verify(sidecar.file, self.verifier), f"{self._origin}/file")
        except NoteError as error:
            return f"the signature beside it is not this log's: {error}; {self._first_unsigned}"
        if tree.size > count:
            return (
                f"it was closed with {tree.size} records, {count} are there: those from {count} on are gone; "
                f"{self._first_unsigned}"
            )
        if (tree.size, tree.hash) != (count, root):
            return f"its records are not those that were signed when it was closed; {self._first_unsigned}"
        if (file.size, file.hash) != (size, sha256):
            return (
                f"its file is not the one that was signed when it was closed ({size} bytes, signed were "
                f"{file.size}): all records are, so index, summary or attachments were changed"
            )
        return ""

    @property
    def _first_unsigned(self) -> str:
        return f"record {self.covered} is the first without a valid signature"

    def _opened(self, record: dict[str, Any]) -> None:
        log_id = record.get("log_id")
        self._origin = origin_of(log_id) if isinstance(log_id, str) else ""
        try:
            self.key = key_of(record)
        except NoteError as error:
            self.wrong = f"record 0: {error}; {self._first_unsigned}"

    def _checkpoint(self, record: dict[str, Any], tree: Tree) -> str:
        try:
            text = record.get("note")
            signed = note.verify(text if isinstance(text, str) else "", self.verifier)
            found = Checkpoint.parse(signed, self._origin)
        except NoteError as error:
            return str(error)
        stated = (record.get("size"), record.get("root"))
        if stated != (found.size, found.hash.hex()):
            return "its size and root are not those of its note"
        if (found.size, found.hash) != (tree.size, tree.root):
            return f"it signs another tree than that of the {tree.size} records before it"
        self.covered = tree.size
        self._sizes.add(tree.size)
        return ""
