"""What makes a log believed, in the order in which it is asked: each is yes, no, or not checked.

structure, chain, tree, signatures, key chain, witness, replay. A log is OK only if none is no; what was not checked is
said in the same breath.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from cutgate.runtime.audit.signing import note
from cutgate.runtime.audit.signing.log_key import PublicLogKey, chained
from cutgate.runtime.audit.signing.note import NoteError, VerifierKey

STEPS: Final = ("structure", "chain", "tree", "signatures", "key chain", "witness", "replay")
STRUCTURE, CHAIN, TREE, SIGNATURES, KEY_CHAIN, WITNESS, REPLAY = STEPS


NOT_FOUND: Final = """\
What no verification of a log can find:
- a session that the holder of its key rewrote before anybody else saw its root: the key of a session lives in the memory
  of its process alone, but a process that is not ours from the beginning signs what it likes;
- words that the program itself put into an operator's mouth at the time;
- a key that was copied while it lay on the disk, between two sessions: who has it can sign the next session in its place.
  A disk, a snapshot or a backup keeps old key files; each signs one session only, which has been signed already;
- the last log, cut off behind a START and called a crash, before a later session or the controller names it.
Take the root of a log somewhere else (--anchor), pin a key (--public-key), and keep the controller's memory: it names the
log of the last start."""


class TrustAnswer(StrEnum):
    """Of one step."""

    YES = "yes"
    NO = "no"
    NOT_CHECKED = "not checked"


@dataclass(frozen=True, slots=True)
class TrustStep:
    """One step's answer, and what it says."""

    name: str
    answer: TrustAnswer
    text: str

    def __str__(self) -> str:
        return f"{self.name}: {self.answer}{', ' if self.text else ''}{self.text}"


@dataclass(frozen=True, slots=True)
class Trust:
    """What a reviewer trusts beside the log.

    Attributes:
        pinned: the key that he has from elsewhere; None where he believes the log's own.
        certified: keys that the logs beside this one name, by epoch, in its series.
        anchors: roots of the tree, or heads of the chain, that he has from elsewhere, 32 bytes each.
        cosigners: keys of witnesses that must have cosigned the closed log's checkpoint.
        doubled: of epochs for which the logs beside it name several keys, which logs do; none of these keys is believed.
    """

    pinned: PublicLogKey | None = None
    certified: Mapping[int, PublicLogKey] | None = None
    anchors: tuple[bytes, ...] = ()
    cosigners: tuple[VerifierKey, ...] = ()
    doubled: Mapping[int, str] | None = None


NOBODY: Final = Trust()


def key_chain(key: PublicLogKey | None, trust: Trust) -> TrustStep:
    """Whether the key that signs a log is the pinned one, or one that it certifies.

    Args:
        key: of the log; None where it is not signed.
        trust: the pinned key, and those between it and the log's.
    """
    pinned = trust.pinned
    if pinned is None:
        return TrustStep(KEY_CHAIN, TrustAnswer.NOT_CHECKED, "no key is pinned; name one with --public-key")
    pinned_key = f"the pinned key {pinned.fingerprint} (epoch {pinned.epoch})"
    if key is None:
        return TrustStep(
            KEY_CHAIN, TrustAnswer.NO, f"{pinned_key} has signed nothing of it: record 0 is the first without"
        )
    if (key.series, key.epoch, key.public) == (pinned.series, pinned.epoch, pinned.public):
        return TrustStep(KEY_CHAIN, TrustAnswer.YES, f"signed by {pinned_key}")
    twice = min((epoch for epoch in trust.doubled or {} if pinned.epoch < epoch < key.epoch), default=None)
    told = _unconnected(key, pinned, trust.certified or {})
    if twice is not None and key.series == pinned.series:
        told = (
            f"epoch {twice} has two keys, of the logs {(trust.doubled or {})[twice]}: "
            "see which of them `audit verify` of their folder calls doubled, and move it out"
        )
    if told:
        return TrustStep(
            KEY_CHAIN, TrustAnswer.NO, f"{pinned_key} does not vouch for its key {key.fingerprint}: {told}"
        )
    return TrustStep(KEY_CHAIN, TrustAnswer.YES, f"certified from {pinned_key} to epoch {key.epoch}")


def witnessed(trust: Trust, found: Mapping[bytes, int], checkpoint: str | None) -> TrustStep:
    """Whether everything that a reviewer has from elsewhere is of this log.

    Args:
        trust: his anchors, and the witnesses whose cosignatures he asks for.
        found: the anchors that are this log's, with the last record that each covers.
        checkpoint: the note over the closed log's tree, verified by the log's key; None where there is none.
    """
    told = []
    for anchor in trust.anchors:
        if anchor not in found:
            text = f"the anchor {anchor.hex()} is no root of its tree and no head of its chain"
            return TrustStep(WITNESS, TrustAnswer.NO, text)
        told.append(f"anchor {anchor.hex()} at record {found[anchor]}")
    for key in trust.cosigners:
        try:
            note.verify(checkpoint or "", key)
        except NoteError as error:
            return TrustStep(WITNESS, TrustAnswer.NO, f"not cosigned by {key.name}: {error}")
        told.append(f"cosigned by {key.name}")
    if not told:
        return TrustStep(
            WITNESS, TrustAnswer.NOT_CHECKED, "no anchor is given; name roots or heads with --anchor"
        )
    return TrustStep(WITNESS, TrustAnswer.YES, ", ".join(told))


def _unconnected(key: PublicLogKey, pinned: PublicLogKey, certified: Mapping[int, PublicLogKey]) -> str:
    """Why no certificates lead from the pinned key to this one; empty if they do."""
    if key.series != pinned.series:
        return f"it is of the series {key.series.hex()}, the pinned one of {pinned.series.hex()}"
    if key.epoch == pinned.epoch:
        return "it is another key of the same epoch"
    if key.epoch < pinned.epoch:
        return f"it is of epoch {key.epoch}, and a key certifies later ones only; pin an earlier one"
    between = range(pinned.epoch + 1, key.epoch)
    missing = len(between) - sum(1 for epoch in certified if epoch in between)
    if missing:  # an epoch is as large as record 0 says: what is looked at is bounded by what is there
        first = next(epoch for epoch in between if epoch not in certified)
        return (
            f"the certificate of epoch {first} is missing ({missing} in all); they stand in the logs "
            "of the same log directory, which must lie beside it"
        )
    if chained(pinned, (*(certified[epoch] for epoch in between), key)) is None:
        return "a certificate between them is missing or of another key"
    return ""
