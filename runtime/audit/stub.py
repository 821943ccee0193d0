"""What an archived session leaves in its folder: enough that the folder is still a chain that can be verified.

    stub = {"schema": "cutgate.archived/1", "log": name, "status": ..., "closed": ..., "size": ..., "root": ..., "head": ...,
            "last_ns": ..., "proof": text, "place": folder, "moved": [{"name", "size", "sha256"}, ...]}

It stands beside the other logs as ``<stem>.archived``. ``proof`` is the proof of record 0 (``signing/proof.py``) by the
signature of the closed log, or by the last checkpoint of one that crashed: so record 0, with its key, certificate and
what it says of the session before, is that session's, and what the checkpoint covers is signed by it. Where nothing was
signed, ``record`` holds the bytes of record 0 instead. All else is what the archiving program says; the next session's
record 0 names size, root and head too.
"""

import json
import re
from base64 import b64decode, b64encode
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from cutgate.config.load import InputError, read_bytes
from cutgate.runtime.audit.chain import parts_of
from cutgate.runtime.audit.folder import LOG_SUFFIX, STUB_SUFFIX, count, of_stub, text
from cutgate.runtime.audit.inspect import OLD_FORM, Status
from cutgate.runtime.audit.judge import parse_object
from cutgate.runtime.audit.records import AuditOpen
from cutgate.runtime.audit.series_facts import FolderSession
from cutgate.runtime.audit.series_rules import worst
from cutgate.runtime.audit.signing.log_key import PublicLogKey
from cutgate.runtime.audit.signing.proof import ProofError, RecordProof, why_false
from cutgate.runtime.audit.signing.signatures import key_of

SCHEMA: Final = "cutgate.archived/1"
STUB_MAX: Final = 1 << 20
"""Bytes of the largest stub that is read; a session's has some 6 kB."""
MOVED_MAX: Final = 8
"""Files of one session."""
_STATUSES: Final = {status.name: status for status in (Status.OK, Status.INCOMPLETE)}
"""What a log may be that is archived."""
_DIGEST: Final = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True, slots=True)
class MovedFile:
    """A file that was moved: its name, bytes, and SHA-256 in hex."""

    name: str
    size: int
    sha256: str


@dataclass(frozen=True, slots=True)
class Stub:
    """What is left of a session.

    Attributes:
        log: name of its file.
        status: what it was judged to be when it was archived.
        closed: it was closed in order.
        size, root, head: of everything in it, in hex.
        last_ns: UTC of its last record.
        proof: of record 0; None where nothing is signed.
        record: the bytes that chain and tree cover of record 0, where there is no proof.
        place: the folder that it was moved to, as it was named.
        moved: its files, the log first.
    """

    log: str
    status: Status
    closed: bool
    size: int
    root: str
    head: str
    last_ns: int
    proof: str | None
    record: bytes | None
    place: str
    moved: tuple[MovedFile, ...]

    def encode(self) -> bytes:
        """The file's content."""
        content: dict[str, Any] = {"schema": SCHEMA, **asdict(self), "status": self.status.name}
        content["record"] = None if self.record is None else b64encode(self.record).decode()
        kept = {key: value for key, value in content.items() if value is not None}
        return json.dumps(kept, indent=1).encode() + b"\n"

    @classmethod
    def parse(cls, data: bytes) -> "Stub":
        """Raises ValueError for anything else."""
        content = parse_object(data)
        if content is None or content.get("schema") != SCHEMA:
            raise ValueError(f"it is no JSON of the schema {SCHEMA}")
        log, root, head, place = (text(content, key) for key in ("log", "root", "head", "place"))
        size, last_ns = count(content, "size"), count(content, "last_ns")
        status, closed = _STATUSES.get(str(content.get("status"))), content.get("closed")
        proof, record = content.get("proof"), content.get("record")
        if not (_is_name(log) and _is_digest(root) and _is_digest(head) and isinstance(place, str)):
            raise ValueError("it does not name log, root, head and place")
        if size is None or last_ns is None or status is None or not isinstance(closed, bool):
            raise ValueError("it does not say size, time and status")
        if (proof is None) is (record is None) or not isinstance(proof or record, str):
            raise ValueError("it must hold either a proof of record 0 or record 0 itself")
        known = b64decode(record, validate=True) if isinstance(record, str) else None
        return cls(
            str(log),
            status,
            closed,
            size,
            str(root),
            str(head),
            last_ns,
            proof,
            known,
            place,
            _moved(content),
        )

    def session(self) -> tuple[FolderSession, str]:
        """What it says of the session, as far as that holds, and why it is not OK.

        Raises:
            ValueError: what it says contradicts itself: nobody archived such a session.
        """
        opened, covered, whole = self._opened()
        try:
            key = key_of(opened)
        except ValueError as error:
            raise ValueError(f"record 0: {error}") from None
        log_id = text(opened, "log_id")
        if not log_id or (self.proof is None) is not (key is None or not covered):
            raise ValueError("record 0 names a key that has signed nothing of it, or no log")
        if self.proof is not None and key is not None and self._proof.public != key.public:
            raise ValueError("another key has signed it than the one that record 0 names")
        if self.proof is not None and self._proof.log_id != log_id:
            raise ValueError(f"its checkpoint is of the log {self._proof.log_id}, record 0 of {log_id}")
        reason = (
            "" if whole else f"the first {covered} of {self.size} records are signed" if key else OLD_FORM
        )
        derived = Status.OK if whole and self.closed else Status.INCOMPLETE
        status = worst([derived, self.status])
        session = of_stub(
            self.log, opened, log_id=log_id, status=status, closed=self.closed, size=self.size,
            root=self.root, head=self.head, last_ns=self.last_ns, key=key,
        )  # fmt: skip
        return session, reason or ("" if status is Status.OK else "it was INCOMPLETE when it was archived")

    @property
    def _proof(self) -> RecordProof:
        return RecordProof.parse((self.proof or "").encode())

    def _opened(self) -> tuple[dict[str, Any], int, bool]:
        """Record 0, how many records are signed, and whether that is all of them."""
        if self.proof is None:
            found, covered, whole = parts_of(self.record or b""), 0, False
        else:
            try:
                proof = self._proof
                false, named, found = why_false(proof, None), proof.named, proof.record
            except ProofError as error:
                raise ValueError(f"its proof: {error}") from None
            if false:
                raise ValueError(f"its proof: {false}")
            if proof.index != 0 or named.size > self.size:
                raise ValueError(
                    f"its proof is of record {proof.index} of {named.size}, must be 0 of at most {self.size}"
                )
            covered, whole = named.size, named.size == self.size
            if whole and named.hash.hex() != self.root:
                raise ValueError(f"its root is {self.root}, signed is {named.hash.hex()}")
        opened = parse_object(found.data)
        if found.topic != AuditOpen.TOPIC or found.sequence != 0 or opened is None:
            raise ValueError(f"the record that it holds is no {AuditOpen.TOPIC}")
        return opened, covered, whole


def stub_name(log: str) -> str:
    """The name of the stub of this log."""
    return log.removesuffix(LOG_SUFFIX) + STUB_SUFFIX


def key_in_stub(path: Path) -> PublicLogKey | None:
    """The key of the log that a stub stands for; None where it is none, or nothing was signed."""
    try:
        session, _ = Stub.parse(read_bytes(path, STUB_MAX, "it is no stub of an archived log")).session()
    except (InputError, ValueError):
        return None
    return session.key


def _is_name(name: object) -> bool:
    return isinstance(name, str) and name.endswith(LOG_SUFFIX) and Path(name).name == name


def _is_digest(value: object) -> bool:
    return isinstance(value, str) and _DIGEST.fullmatch(value) is not None


def _moved(content: dict[str, Any]) -> tuple[MovedFile, ...]:
    entries = content.get("moved")
    if not isinstance(entries, list) or not 0 < len(entries) <= MOVED_MAX:
        raise ValueError("it does not name the files that were moved")
    found = []
    for entry in entries:
        known = entry if isinstance(entry, dict) else {}
        name, size, digest = text(known, "name"), count(known, "size"), known.get("sha256")
        if (
            name is None
            or Path(name).name != name
            or name in ("", "..")
            or size is None
            or not _is_digest(digest)
        ):
            raise ValueError("it does not name the files that were moved, with size and SHA-256")
        found.append(MovedFile(name, size, str(digest)))
    return tuple(found)
