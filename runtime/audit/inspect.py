"""Judging a log: structure, chain, attachments, raw frames, and whether two ways of reading it agree.

A log is OK only if every rule holds. What is missing, at the end or beside it, makes it INCOMPLETE, anything
inconsistent TAMPERED, and a file that is no log of ours UNREADABLE. A log that nobody signed, as before 0.2, is never
OK: whoever takes the signatures away must not get what an old log gets. Without a pinned key the log's own is believed,
and that is said.

A log is read once from front to back, a chunk at a time. What is kept of it is where its records stand, those of
streamed topics (frames, tracking, timing) apart.
"""

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field, replace
from enum import IntEnum
from hashlib import sha256
from io import SEEK_END, BytesIO
from typing import Any, BinaryIO, Final

from cutgate.runtime.audit.container.raw import PIECE
from cutgate.runtime.audit.container.scan import walk
from cutgate.runtime.audit.container.stored import Scan
from cutgate.runtime.audit.judge import Judge, missing, parse_object
from cutgate.runtime.audit.records import STREAMED
from cutgate.runtime.audit.second_reading import read_again
from cutgate.runtime.audit.signing.log_key import PublicLogKey
from cutgate.runtime.audit.signing.signer import Sidecar
from cutgate.runtime.audit.trust import (
    CHAIN,
    KEY_CHAIN,
    NOBODY,
    REPLAY,
    SIGNATURES,
    STEPS,
    STRUCTURE,
    TREE,
    WITNESS,
    Trust,
    TrustAnswer,
    TrustStep,
    key_chain,
    witnessed,
)
from cutgate.runtime.audit.writer import PROFILE

OLD_FORM: Final = "nothing of it is signed: it is of a version before logs were (old form)"
_SHOWN: Final = 20
_CANDUMP: Final = "candump_sha256"


class Status(IntEnum):
    """The judgement; its number is the exit code of ``cutgate audit verify``."""

    OK = 0
    INCOMPLETE = 1
    TAMPERED = 2
    UNREADABLE = 3


@dataclass(frozen=True, slots=True)
class Report:
    """What was found.

    Attributes:
        status: the judgement.
        reasons: why it is not OK; the first names the first bad record. Empty if it is OK.
        notes: what was not checked.
        log_id: from record 0; empty if there is none.
        messages: whole messages.
        head: the chain's head over them, hex.
        dropped_bytes: bytes after the last whole record.
        root: of the tree of all messages, hex.
        key: that signs the log, as its record 0 names it; None if nothing is signed.
        signed: messages that a checkpoint in the log signs, or the signature of the closed file.
        steps: what was asked, in the order of ``trust``.
    """

    status: Status
    reasons: tuple[str, ...]
    notes: tuple[str, ...]
    log_id: str
    messages: int
    head: str
    dropped_bytes: int
    root: str
    key: PublicLogKey | None
    signed: int
    steps: tuple[TrustStep, ...]

    @property
    def headline(self) -> str:
        """The judgement in a few words: never OK without whose key, and which anchor."""
        if self.status is Status.OK:
            chain, witness = (self.step(name) for name in (KEY_CHAIN, WITNESS))
            whose = "from the log itself" if chain.answer is TrustAnswer.NOT_CHECKED else "pinned"
            anchor = "no anchor given" if witness.answer is TrustAnswer.NOT_CHECKED else witness.text
            fingerprint = self.key.fingerprint if self.key else ""
            return f"OK (signed, key {fingerprint} {whose}; {anchor})"
        old = self.status is Status.INCOMPLETE and self.key is None and self.messages > 0
        return f"{self.status.name} (unsigned, old form)" if old else self.status.name

    def tampered(self, reason: str) -> "Report":
        """The same, with what was found besides."""
        return replace(self, status=Status.TAMPERED, reasons=(*self.reasons, reason))

    def document(self) -> dict[str, Any]:
        """For JSON: the fields, keys and roots in hex."""
        key = self.key and {
            "series": self.key.series.hex(),
            "epoch": self.key.epoch,
            "public_key": self.key.public.hex(),
            "fingerprint": self.key.fingerprint,
        }
        steps = [{"step": step.name, "answer": step.answer.value, "text": step.text} for step in self.steps]
        return {
            **asdict(replace(self, key=None, steps=())),
            "key": key,
            "steps": steps,
            "status": self.status.name,
            "headline": self.headline,
        }

    def step(self, name: str) -> TrustStep:
        """The answer of this name."""
        return next(step for step in self.steps if step.name == name)


@dataclass(frozen=True)
class Log:
    """A log that has been read: its structure, where its records stand, and the judgement.

    Records and attachments are read from the file when they are asked for.
    """

    scan: Scan
    report: Report
    file: BinaryIO = field(repr=False)
    places: tuple[tuple[str, int, int], ...] = field(repr=False)
    """Topic, offset and size of each record whose topic is not streamed, in file order."""
    streamed: frozenset[str] = frozenset()
    """Topics that are, of which there are records."""

    @property
    def topics(self) -> frozenset[str]:
        """Of which there are records."""
        return self.streamed | {topic for topic, _, _ in self.places}

    def each(self, *topics: str) -> Iterator[tuple[str, bytes]]:
        """Topic and data of every record of these topics, in file order; streamed ones are looked for in the whole file."""
        if not STREAMED.isdisjoint(topics):
            for message in walk(self.file, Scan()):
                if message.topic in topics:
                    yield message.topic, message.data
            return
        for topic, offset, size in self.places:
            if topic in topics:
                self.file.seek(offset)
                yield topic, self.file.read(size)

    def of(self, topic: str) -> list[dict[str, Any]]:
        """The records of one topic, in file order, as parsed JSON; an empty object for what is none."""
        return list(self.one_by_one(topic))

    def one_by_one(self, topic: str) -> Iterator[dict[str, Any]]:
        """As ``of``, each only while it is looked at: a session has millions of frames."""
        return (parse_object(data) or {} for _, data in self.each(topic))


def verify_log(
    log: bytes | BinaryIO,
    candump: bytes | BinaryIO | None = None,
    sidecar: bytes | None = None,
    trust: Trust = NOBODY,
) -> Report:
    """Judge a log; arguments and errors as ``read_log``."""
    return read_log(log, candump, sidecar, trust).report


def read_log(
    log: bytes | BinaryIO,
    candump: bytes | BinaryIO | None = None,
    sidecar: bytes | None = None,
    trust: Trust = NOBODY,
) -> Log:
    """Read and judge a log. What is wrong with it is said, never raised.

    Args:
        log: the MCAP file, seekable; it must stay open while the result is used.
        candump: the file of raw frames beside it, or None if it is not there.
        sidecar: the signature beside it, or None if it is not there.
        trust: what the reviewer has from elsewhere.

    Raises:
        OSError: a file cannot be read.
    """
    file, frames = _opened(log), None if candump is None else _opened(candump)
    found, judge = Scan(), Judge(trust.anchors)
    for message in walk(file, found):
        judge.take(message)
    judge.signatures.end(judge.count, judge.last_topic)
    wrong = _Found()
    _rules(judge, found, wrong)
    notes = _second_reading(file, found, judge, wrong)
    damaged, lost = _candump(judge.last, frames)
    wrong.add(STRUCTURE, damaged)
    altered, unsigned = _signature(file, found, judge, sidecar)
    wrong.add(SIGNATURES, altered)
    checkpoint = None if altered or sidecar is None else Sidecar.parse(sidecar).checkpoint
    steps = _steps(judge, wrong, unsigned, trust, checkpoint)
    absent = [*missing(found, judge), *lost, *unsigned]
    if not found.mcap or not _ours(found):
        status, reasons = Status.UNREADABLE, ["this is not an audit log of cutgate", *found.problems]
    elif wrong.texts:
        status, reasons = Status.TAMPERED, wrong.texts
    elif absent:
        status, reasons = Status.INCOMPLETE, absent
    else:
        status, reasons = Status.OK, []
    whole = sidecar is not None and not altered and found.finished
    report = Report(
        status=status,
        reasons=tuple(reasons[:_SHOWN]),
        notes=notes,
        log_id=_text(judge.first, "log_id"),
        messages=judge.count,
        head=judge.head.hex(),
        dropped_bytes=0 if found.torn_at is None else found.size - found.torn_at,
        root=judge.roots.tree.root.hex(),
        key=judge.signatures.key,
        signed=judge.count if whole else judge.signatures.covered,
        steps=steps,
    )
    return Log(found, report, file, tuple(judge.places), frozenset(judge.streamed))


def _rules(judge: Judge, found: Scan, wrong: "_Found") -> None:
    """What the rules over the records find, the first bad record first."""
    wrong.add(CHAIN if judge.unlinked else STRUCTURE, judge.problems)
    wrong.add(TREE, filter(None, [judge.roots.wrong]))
    wrong.add(STRUCTURE, judge.content(found))
    wrong.add(SIGNATURES, filter(None, [judge.signatures.wrong]))


def _second_reading(file: BinaryIO, found: Scan, judge: Judge, wrong: "_Found") -> tuple[str, ...]:
    """What the stock reader finds in a log that is sound so far; and what it was not asked."""
    sound = not wrong.texts
    wrong.add(STRUCTURE, found.problems)
    if not (found.finished and sound):
        return ()
    unread, notes = read_again(file, found, judge.head)
    wrong.add(STRUCTURE, filter(None, [unread]))
    return notes


class _Found:
    """What is wrong, in its order, and the first of each step."""

    def __init__(self) -> None:
        self.texts: list[str] = []
        self.first: dict[str, str] = {}

    def add(self, step: str, texts: Iterable[str]) -> None:
        """Of this step; an empty list of texts says nothing."""
        for text in texts:
            self.texts.append(text)
            self.first.setdefault(step, text)


def _steps(
    judge: Judge, wrong: _Found, unsigned: list[str], trust: Trust, checkpoint: str | None
) -> tuple[TrustStep, ...]:
    """Every step's answer, in their order; what the reviewer's own key and anchors find wrong comes last."""
    key = judge.signatures.key
    chain, witness = key_chain(key, trust), witnessed(trust, judge.anchors, checkpoint)
    for step in (chain, witness):
        wrong.add(step.name, [step.text] if step.answer is TrustAnswer.NO else ())
    by = "" if key is None else f"key {key.fingerprint}, epoch {key.epoch}, of record 0"
    sound = {
        STRUCTURE: (TrustAnswer.YES, f"{judge.count} records"),
        CHAIN: (TrustAnswer.YES, f"head {judge.head.hex()}"),
        TREE: (TrustAnswer.YES, f"root {judge.roots.tree.root.hex()}"),
        SIGNATURES: (TrustAnswer.NOT_CHECKED, unsigned[0]) if unsigned else (TrustAnswer.YES, by),
        KEY_CHAIN: (chain.answer, chain.text),
        WITNESS: (witness.answer, witness.text),
        REPLAY: (TrustAnswer.NOT_CHECKED, "cutgate audit replay decides again"),
    }
    return tuple(
        TrustStep(name, TrustAnswer.NO, wrong.first[name])
        if name in wrong.first
        else TrustStep(name, *sound[name])
        for name in STEPS
    )


def _signature(
    file: BinaryIO, found: Scan, judge: Judge, sidecar: bytes | None
) -> tuple[list[str], list[str]]:
    """Whether the signature beside the log is of it: what is wrong, and what is missing."""
    signatures = judge.signatures
    if signatures.key is None:
        return [], ([OLD_FORM] if judge.count else [])
    if sidecar is None:
        covered = f"the first {signatures.covered} of {judge.count} records are signed"
        return [], [
            f"the signature of the closed log is not beside it: {covered}" if found.finished else covered
        ]
    try:
        signed = Sidecar.parse(sidecar)
    except ValueError as error:
        return [f"the signature beside it cannot be read: {error}"], []
    file.seek(0)
    digest = sha256()
    while data := file.read(PIECE):
        digest.update(data)
    told = signatures.sidecar(signed, judge.count, judge.roots.tree.root, found.size, digest.digest())
    return [told] if told else [], []


def _opened(data: bytes | BinaryIO) -> BinaryIO:
    return BytesIO(data) if isinstance(data, bytes) else data


def _ours(found: Scan) -> bool:
    """Whether the header, as far as it is there, is one of ours."""
    return found.header is None or found.header.profile == PROFILE


def _candump(closed: dict[str, Any] | None, candump: BinaryIO | None) -> tuple[list[str], list[str]]:
    """Whether the raw frames are those the close record names: what is wrong, and what is missing."""
    if closed is None or _CANDUMP not in closed:
        return [], []
    if candump is None:
        return [], ["the file of raw frames, whose SHA-256 the close record names, is not beside the log"]
    size, recorded = candump.seek(0, SEEK_END), closed.get("candump_bytes")
    if isinstance(recorded, int) and size != recorded:  # not read in vain, however large it is
        return [
            f"the file of raw frames beside the log has {size} bytes, the close record names {recorded}"
        ], []
    candump.seek(0)
    digest = sha256()
    while data := candump.read(PIECE):
        digest.update(data)
    if digest.hexdigest() != closed[_CANDUMP]:
        return ["the file of raw frames beside the log is not the one the close record names"], []
    return [], []


def _text(record: dict[str, Any] | None, key: str) -> str:
    value = (record or {}).get(key)
    return value if isinstance(value, str) else ""
