"""The proof that one record is in a log: a text of a few lines, https://c2sp.org/tlog-proof, for who has no log.

    c2sp.org/tlog-proof@v1
    extra <base64 of what follows>
    index <number of the record, decimal>
    <the hashes from the record's sibling to the root's child, base64, a line each>

    <a checkpoint of the log that covers the record: a signed note>

What the specification leaves to us, ``extra``, is the record and the keys that lead to the one that signed the checkpoint:

    "cutgate/proof/1" | n | series and first epoch, if n > 0 | key of the first epoch | n times: key, certificate | record

n is the number of certificates, 32 bit; the series has 16 bytes, the epoch 32 bit, each key 32 bytes, each certificate
64; numbers are little endian. The keys are of epochs that follow each other, each certified by the one before it, and
the last one is that of the log. The record is what chain and tree cover of it (``chain.py``), to the end.

There is one form of every proof, and nothing in it that may be passed over: a byte that is changed makes another proof.
"""

import re
import struct
from base64 import b64decode, b64encode
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

from cutgate.runtime.audit.chain import Covered, parts_of
from cutgate.runtime.audit.signing import note as notes
from cutgate.runtime.audit.signing.checkpoint import Checkpoint, origin_of
from cutgate.runtime.audit.signing.log_key import (
    CERTIFICATE_BYTES,
    EPOCH_MAX,
    FIRST_EPOCH,
    KEY_BYTES,
    SERIES_BYTES,
    PublicLogKey,
    chained,
)
from cutgate.runtime.audit.signing.note import NoteError, VerifierKey
from cutgate.runtime.audit.tree import leaf_hash, root_of

SUFFIX: Final = ".tlog-proof"
RECORD_MAX: Final = 16 << 20
"""Bytes of the largest record that is proven: no chunk has more."""
CERTIFICATES_MAX: Final = 1 << 16
"""Sessions from the key that is trusted to the log: twenty a day for nine years."""
_DEPTH_MAX: Final = 64
_DOMAIN: Final = b"cutgate/proof/1"
_COUNT: Final = struct.Struct("<I")
_FIRST: Final = struct.Struct(f"<{SERIES_BYTES}sI")
_CERTIFIED: Final = struct.Struct(f"<{KEY_BYTES}s{CERTIFICATE_BYTES}s")
PROOF_MAX: Final = 32 << 20
"""Bytes of the largest proof that is read: with the largest record and as many certificates it has 31 million."""
_LINES: Final = re.compile(
    r"c2sp\.org/tlog-proof@v1\n"
    r"extra ([A-Za-z0-9+/]+={0,2})\n"
    r"index (0|[1-9][0-9]{0,18})\n"
    rf"((?:[A-Za-z0-9+/]{{43}}=\n){{0,{_DEPTH_MAX}}})\n"
)
LOG_ID: Final = re.compile(r"[0-9a-f]{32}")
_ORIGIN: Final = re.compile(re.escape(origin_of("")) + LOG_ID.pattern)


class ProofError(ValueError):
    """It is no proof, or cannot be made one; the text says why."""


@dataclass(frozen=True, slots=True)
class RecordProof:
    """One record, and all that it takes to verify that it is in a log that was signed.

    Attributes:
        covered: what chain and tree cover of the record.
        index: its number, from 0.
        beside: the hashes from its sibling to the root's child, 32 bytes each.
        checkpoint: a signed note of the log's tree that covers it.
        public: the key that signed the note, 32 bytes.
        keys: of following epochs, the first trusted, the last the one that signed; none where there is no certificate.
    """

    covered: bytes
    index: int
    beside: tuple[bytes, ...]
    checkpoint: str
    public: bytes
    keys: tuple[PublicLogKey, ...] = ()

    def encode(self) -> bytes:
        """The text.

        Raises:
            ProofError: a proof holds no record of this size, or not so many certificates.
        """
        count = max(0, len(self.keys) - 1)
        if not len(self.covered) <= RECORD_MAX:
            raise ProofError(f"a record of {len(self.covered)} bytes, at most {RECORD_MAX} can be proven")
        if not count <= CERTIFICATES_MAX:
            raise ProofError(
                f"{count} certificates, a proof holds at most {CERTIFICATES_MAX}; pin a key of a later epoch"
            )
        if any(key.certificate is None for key in self.keys[1:]):
            raise ProofError("a key that nobody certified stands behind others")
        parts = [_DOMAIN, _COUNT.pack(count)]
        if count:
            first = self.keys[0]
            parts += (_FIRST.pack(first.series, first.epoch), first.public)
        else:
            parts.append(self.public)
        parts.extend(_CERTIFIED.pack(key.public, key.certificate or b"") for key in self.keys[1:])
        extra = b64encode(b"".join((*parts, self.covered))).decode()
        hashes = "".join(f"{b64encode(one).decode()}\n" for one in self.beside)
        lines = f"c2sp.org/tlog-proof@v1\nextra {extra}\nindex {self.index}\n{hashes}\n"
        return (lines + self.checkpoint).encode()

    @classmethod
    def parse(cls, data: bytes) -> "RecordProof":
        """From its text, in its one form; nothing of it is verified.

        Raises:
            ProofError: it is none.
        """
        if not len(data) <= PROOF_MAX:
            raise ProofError(f"a proof has at most {PROOF_MAX} bytes, this one {len(data)}")
        try:
            text = data.decode()
        except UnicodeDecodeError as error:
            raise ProofError(f"byte {error.start} is no UTF-8") from None
        lines = _LINES.match(text)
        if lines is None:
            raise ProofError(
                "it begins otherwise than a proof: its name and version, extra, index, hashes, an empty line"
            )
        extra = _Extra(_decoded(lines[1], "extra"))
        hashes = lines[3].split("\n")[:-1]
        proof = cls(
            extra.covered,
            int(lines[2]),
            tuple(_decoded(one, f"hash {number}") for number, one in enumerate(hashes)),
            text[lines.end() :],
            extra.public,
            extra.keys,
        )
        proof.record  # noqa: B018 - raises
        proof.named  # noqa: B018
        return proof

    @property
    def record(self) -> Covered:
        """The record's parts.

        Raises:
            ProofError: it has none.
        """
        try:
            return parts_of(self.covered)
        except ValueError as error:
            raise ProofError(f"its record is none: {error}") from None

    @property
    def named(self) -> Checkpoint:
        """What its checkpoint names, whether or not it is signed.

        Raises:
            ProofError: it is no checkpoint of a log, or others have signed it as well.
        """
        try:
            note = notes.parse(self.checkpoint)
            origin = note.text.partition("\n")[0]
            named = Checkpoint.parse(note.text, origin)
        except NoteError as error:
            raise ProofError(f"its checkpoint is none: {error}") from None
        if not _ORIGIN.fullmatch(origin):
            raise ProofError(f"its checkpoint is of {origin!r}, must be of {origin_of('<log id>')}")
        if len(note.signatures) != 1:
            raise ProofError(
                f"its checkpoint has {len(note.signatures)} signatures, must have the log's alone"
            )
        return named

    @property
    def log_id(self) -> str:
        """Of the log, as its record 0 has it in hex. Raises as ``named``."""
        return self.named.origin.removeprefix(origin_of(""))


class _Extra:
    """What stands in ``extra``, taken from its beginning."""

    def __init__(self, data: bytes) -> None:
        self._rest = memoryview(data)
        if self._bytes(len(_DOMAIN)) != _DOMAIN:
            raise ProofError(f"its extra does not begin with {_DOMAIN.decode()}")
        (count,) = _COUNT.unpack(self._bytes(_COUNT.size))
        if not count <= CERTIFICATES_MAX:
            raise ProofError(f"it names {count} certificates, a proof holds at most {CERTIFICATES_MAX}")
        self.keys = self._keys(count) if count else ()
        self.public = self.keys[-1].public if count else self._bytes(KEY_BYTES)
        if not len(self._rest) <= RECORD_MAX:
            raise ProofError(f"its record has {len(self._rest)} bytes, a proof's at most {RECORD_MAX}")
        self.covered = bytes(self._rest)

    def _keys(self, count: int) -> tuple[PublicLogKey, ...]:
        series, first = _FIRST.unpack(self._bytes(_FIRST.size))
        if not FIRST_EPOCH <= first <= EPOCH_MAX - count:
            raise ProofError(f"its first epoch is {first}, must be {FIRST_EPOCH} to {EPOCH_MAX - count}")
        keys = [PublicLogKey(series, first, self._bytes(KEY_BYTES))]
        for epoch in range(first + 1, first + count + 1):
            public, certificate = _CERTIFIED.unpack(self._bytes(_CERTIFIED.size))
            keys.append(PublicLogKey(series, epoch, public, certificate))
        return tuple(keys)

    def _bytes(self, size: int) -> bytes:
        taken, self._rest = self._rest[:size], self._rest[size:]
        if len(taken) != size:
            raise ProofError("its extra ends early")
        return bytes(taken)


def _decoded(text: str, what: str) -> bytes:
    """From base64 in its one form."""
    try:
        data = b64decode(text)
    except ValueError:
        data = b""
    if b64encode(data).decode() != text:
        raise ProofError(f"its {what} is no base64 in its one form")
    return data


def why_false(proof: RecordProof, pinned: PublicLogKey | None) -> str:
    """Why a proof does not show that the record is in a log that was signed; empty where it does.

    Asked in this order: tree, signature, certificates, the pinned key.

    Args:
        proof: that was parsed.
        pinned: the key that is trusted; None where the proof's own first key is to be taken for it.
    """
    return _not_in_tree(proof) or _not_signed(proof) or _not_certified(proof, pinned)


def _not_in_tree(proof: RecordProof) -> str:
    named, index, record = proof.named, proof.index, proof.record
    if record.sequence != index:
        return f"the record says that its number is {record.sequence}, the proof that it is {index}"
    if not index < named.size:
        return f"record {index} is not among the {named.size} that the checkpoint covers"
    root = root_of(leaf_hash(proof.covered), index, named.size, proof.beside)
    if root is None:
        return (
            f"{len(proof.beside)} hashes are not those beside record {index} in a tree of {named.size} records: "
            "it takes more or fewer"
        )
    if root != named.hash:
        return f"with this record the tree's root is {root.hex()}, the checkpoint names {named.hash.hex()}"
    return ""


def _not_signed(proof: RecordProof) -> str:
    try:
        notes.verify(proof.checkpoint, VerifierKey(proof.named.origin, proof.public))
    except NoteError as error:
        return f"the checkpoint is not signed by the key that the proof names: {error}"
    return ""


def _not_certified(proof: RecordProof, pinned: PublicLogKey | None) -> str:
    keys = proof.keys
    if keys and chained(keys[0], keys[1:]) is None:
        bad = next(one for before, one in pairwise(keys) if not before.certifies(one))
        return f"the key of epoch {bad.epoch} is not certified by the one before it"
    if pinned is None:
        return ""
    return _pinned_elsewhere(pinned, keys) if keys else _pinned_alone(pinned, proof.public)


def _pinned_alone(pinned: PublicLogKey, public: bytes) -> str:
    """Why a pinned key is not the one that signed; empty if it is."""
    if pinned.public == public:
        return ""
    return (
        f"the pinned key (epoch {pinned.epoch}) is not the one that signed the log, and the proof holds no "
        "certificates that lead from it to that one"
    )


def _pinned_elsewhere(pinned: PublicLogKey, keys: tuple[PublicLogKey, ...]) -> str:
    """Why a pinned key is none of these, each of which certifies the next; empty if it is one."""
    first, last = keys[0], keys[-1]
    own = {key.epoch: key.public for key in keys}.get(pinned.epoch)
    rules = (
        (
            pinned.series == last.series,
            f"the pinned key is of the series {pinned.series.hex()}, the log of {last.series.hex()}",
        ),
        (
            pinned.epoch <= last.epoch,
            f"the pinned key is of epoch {pinned.epoch}, the log of epoch {last.epoch}: keys certify later ones",
        ),
        (
            pinned.epoch >= first.epoch,
            f"its certificates begin with the key of epoch {first.epoch}, the pinned key is of epoch {pinned.epoch}",
        ),
        (pinned.public == own, f"its key of epoch {pinned.epoch} is another one than the pinned key"),
    )
    return next((told for holds, told in rules if not holds), "")
