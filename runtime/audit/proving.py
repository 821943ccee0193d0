"""Making the proof of one record from its log: in one pass, with a chunk and a few hashes in memory at a time.

The log is held to its chain and to every signature on the way: what is proven is what a session wrote, up to the
checkpoint that the proof names. That is the first that covers the record; behind it nothing is read.
"""

from dataclasses import replace
from io import SEEK_END
from pathlib import Path
from typing import Any, Final

from cutgate.config.load import InputError, check_size, open_input, read_bytes, unreadable
from cutgate.runtime.audit.chain import GENESIS, LINKED, follow
from cutgate.runtime.audit.container.scan import walk
from cutgate.runtime.audit.container.stored import Scan, Stored
from cutgate.runtime.audit.judge import parse_object
from cutgate.runtime.audit.reading import SIZE_MAX
from cutgate.runtime.audit.records import AuditOpen
from cutgate.runtime.audit.signing import note as notes
from cutgate.runtime.audit.signing.checkpoint import Checkpoint
from cutgate.runtime.audit.signing.log_key import PublicLogKey
from cutgate.runtime.audit.signing.note import NoteError
from cutgate.runtime.audit.signing.proof import LOG_ID, RecordProof
from cutgate.runtime.audit.signing.signatures import Signatures
from cutgate.runtime.audit.signing.signer import SIDECAR_MAX, Sidecar, sidecar_of
from cutgate.runtime.audit.tree import ProvingTree
from cutgate.runtime.audit.trust import NOBODY, Trust, TrustAnswer, key_chain
from cutgate.runtime.audit.writer import ENCODING

_VERIFY: Final = "see what `cutgate audit verify` says of it"


class Proving:
    """The records of a log, one after the other, and the proof of one of them once a checkpoint covers it.

    Args:
        index: number of the record that is to be proven.

    Attributes:
        wrong: the first record that breaks chain or signatures, or is none of a signed log; empty if none does.
        proof: by the last checkpoint so far that covers the record; None before there is one.
    """

    def __init__(self, index: int) -> None:
        self.wrong = ""
        self.proof: RecordProof | None = None
        self._index = index
        self._head = GENESIS
        self._tree = ProvingTree(index)
        self._signatures = Signatures()
        self._covered = b""

    @property
    def size(self) -> int:
        """Records so far."""
        return self._tree.size

    @property
    def signed(self) -> int:
        """Records that the last checkpoint covers."""
        return self._signatures.covered

    @property
    def key(self) -> PublicLogKey | None:
        """The key that signs the log, as record 0 names it; None where it names none."""
        return self._signatures.key

    def take(self, message: Stored) -> None:
        """The next record, if nothing is wrong so far."""
        number, topic = self.size, message.topic
        linked = topic.startswith(LINKED)
        record = (parse_object(message.data) or {}) if linked else {}
        told = self._follows(message, record)
        if told:
            self.wrong = f"record {number} ({topic}): {told}"
            return
        self._signatures.take(number, topic, record, self._tree)
        self.wrong = self._signatures.wrong
        if self.wrong:
            return
        if number == self.signed > self._index:  # it is a checkpoint: its size is its own number
            self._prove(record["note"])
        covered = message.covered
        if number == self._index:
            self._covered = covered
        self._head = follow(self._head, covered)
        self._tree.append(covered)

    def close(self, sidecar: Sidecar) -> str:
        """The log has ended, and this stands beside it: what is wrong with its checkpoint; empty if nothing is."""
        tree, verifier = self._tree, self._signatures.verifier
        try:
            named = Checkpoint.parse(notes.verify(sidecar.checkpoint, verifier), verifier.name)
        except NoteError as error:
            return f"it is not this log's: {error}"
        if (named.size, named.hash) != (tree.size, tree.root):
            return (
                f"it signs a tree of {named.size} records with the root {named.hash.hex()}, "
                f"the log's has {tree.size} and {tree.root.hex()}"
            )
        self._prove(sidecar.checkpoint)
        return ""

    def _follows(self, message: Stored, record: dict[str, Any]) -> str:
        """Why this is not the next record of a signed log; empty if it is."""
        number = self.size
        if (message.sequence, message.channel.encoding) != (number, ENCODING):
            return f"its sequence is {message.sequence}, its encoding {message.channel.encoding}"
        if message.topic.startswith(LINKED) and record.get("prev") != self._head.hex():
            return "it does not follow from the records before it"
        if number == 0 and not (
            message.topic == AuditOpen.TOPIC and LOG_ID.fullmatch(str(record.get("log_id")))
        ):
            return f"it must be {AuditOpen.TOPIC} and name the log by 32 hexadecimal digits"
        return ""

    def _prove(self, checkpoint: str) -> None:
        """By a checkpoint that the log's key has signed; what witnesses have signed of it is no part of the proof."""
        verifier = self._signatures.verifier
        note = notes.alone(checkpoint, verifier)
        self.proof = RecordProof(self._covered, self._index, self._tree.proof, note, verifier.public)


def prove(path: Path, index: int, trust: Trust = NOBODY, *, latest: bool = False) -> RecordProof:
    """The proof of one record of a log.

    Args:
        path: of the log.
        index: number of the record, from 0.
        trust: the key that whoever verifies the proof has pinned, and those between it and the log's.
        latest: by the last checkpoint instead of the first that covers it: of a closed log by the one beside it.

    Raises:
        InputError: a file cannot be read; the log is not signed, or not sound up to the checkpoint; it has no such
            record, or none that is signed; no certificates lead from the pinned key to the log's.
    """
    found, log = Scan(), Proving(index)
    with open_input(path) as file:
        check_size(path, file.seek(0, SEEK_END), SIZE_MAX, "it is no session's log; name another file")
        try:
            for message in walk(file, found):
                log.take(message)
                if log.wrong or log.key is None or (log.proof and not latest):
                    break
        except OSError as error:
            raise unreadable(path, error) from None
    if log.wrong or found.problems:
        raise InputError(path, "", None, log.wrong or found.problems[0], _VERIFY)
    if log.size and log.key is None:
        remedy = "it was written before logs were signed: nobody can prove it"
        raise InputError(path, "record 0", "without a key", "the record 0 of a signed log", remedy)
    if found.finished and index < log.size:
        _at_end(path, log)
    if log.proof is None:
        raise _not_proven(path, found, log, index)
    return replace(log.proof, keys=_keys(path, log.key, trust))


def _at_end(path: Path, log: Proving) -> None:
    """What stands beside a log that has ended in order signs all of it."""
    file = sidecar_of(path)
    if not file.exists():
        return
    data = read_bytes(file, SIDECAR_MAX, "it is no log's signature; restore it")
    try:
        told = log.close(Sidecar.parse(data))
    except ValueError as error:
        told = str(error)
    if told:
        raise InputError(file, "", None, told, "restore it from a copy")


def _not_proven(path: Path, found: Scan, log: Proving, index: int) -> InputError:
    """Why there is no proof of a record of a log that is sound as far as it goes."""
    place = f"record {index}"
    early = "" if found.finished else "; the log ends early"
    if not index < log.size:
        last = f"its last record is {log.size - 1}" if log.size else "it has no record"
        return InputError(path, place, None, f"there is no such record: {last}{early}", "name another one")
    remedy = "what stands behind is not signed, and nobody can prove it"
    if found.finished:
        remedy = f"restore {sidecar_of(path).name} beside it, which signs the whole log"
    told = f"no checkpoint covers it: the last one covers {log.signed} records{early}"
    return InputError(path, place, None, told, remedy)


def _keys(path: Path, key: PublicLogKey | None, trust: Trust) -> tuple[PublicLogKey, ...]:
    """The keys from the pinned one to the log's; none where that is the pinned one, or where none is pinned."""
    pinned, step = trust.pinned, key_chain(key, trust)
    if step.answer is TrustAnswer.NO:
        raise InputError(
            path, step.name, None, step.text, "pin another key, or put the logs between beside it"
        )
    if pinned is None or key is None or pinned.epoch == key.epoch:
        return ()
    known = {**(trust.certified or {}), pinned.epoch: replace(pinned, certificate=None), key.epoch: key}
    return tuple(known[epoch] for epoch in range(pinned.epoch, key.epoch + 1))
