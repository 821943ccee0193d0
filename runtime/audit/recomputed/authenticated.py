"""Whether the codes of a session are those of a holder of its key: checked again from its log, months later.

    found = check_codes(log, candump, load_review_key(path))
    found.answer, found.line  # "yes", "codes: yes (pre-shared key): OPEN, OPENED, 1 permit, 1 start, ..."

What is checked, in the log's order: OPEN and OPENED as ``/audit/session`` has them; every permit, start and reset that
left; the tags of every heartbeat and joint sample (``tags.py``). With the raw frames beside the log each frame in it must
be one of theirs, and every record of the control channel is put together again (``raw_frames.py``): so acknowledge and
withdraw are checked, which the log does not hold, and whether what it holds is what crossed the bus.

The answer is "no" for what the log itself claims:

- a code of OPEN, OPENED, permit, start or reset in it that does not fit; likewise a record or a heartbeat that left;
- a heartbeat or joint sample that came, does not fit, and was acted on: this side's next heartbeat left, and before it
  the log names no fault for which it would have been refused;
- more damaged frames of the controller than this side counted;
- raw frames that are not the log's, or a record under this side's name in them that the log does not know, unless it
  names a second node, or that this side stood still;
- a permit without the session in which it left.

What anybody on the bus can do is only told: frames and records that do not fit, and that this side refused. They are not
damage to the log. A log of before 0.2 holds neither OPEN nor OPENED, and is not checked.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from typing import BinaryIO, Final, Literal

from cutgate.config.load import InputError
from cutgate.config.refusal import shown
from cutgate.config.session_keys import SessionKeys
from cutgate.protocol import records as wire
from cutgate.protocol.codes import SessionCodes
from cutgate.protocol.states import StopCause
from cutgate.protocol.wire import Channel, Side
from cutgate.runtime.audit.container.scan import walk
from cutgate.runtime.audit.container.stored import Scan, Stored
from cutgate.runtime.audit.inspect import Log
from cutgate.runtime.audit.recomputed.opening import (
    NOT_OURS,
    Judged,
    Opening,
    as_record,
    judge_opening,
    opening_of,
)
from cutgate.runtime.audit.recomputed.raw_frames import RawFrames, WholeRecord, is_logged
from cutgate.runtime.audit.recomputed.tags import OURS, Tags, enables
from cutgate.runtime.audit.records import (
    AuditClose,
    AuditFault,
    AuditPermit,
    AuditSession,
    CanFrame,
    CanTransfer,
)
from cutgate.runtime.audit.signed import canonical

Answer = Literal["yes", "no", "not checked"]
Held = Literal["pre-shared key", "session keys"]
COUNTED: Final[Mapping[str, str]] = {
    "OPEN": "",
    "OPENED": "",
    "permit": "permits",
    "start": "starts",
    "reset": "resets",
    "acknowledge": "acknowledgements",
    "withdraw": "withdrawals",
    "heartbeat sent": "heartbeats sent",
    "heartbeat received": "heartbeats received",
    "joint sample": "joint samples",
}
"""What has a code or tag, one and many of it; a session has one OPEN and OPENED."""
TAGGED: Final = ("heartbeat sent", "heartbeat received", "joint sample")
SHOWN: Final = 20
TRANSFERS_MAX: Final = 1 << 16
"""Control records that left in one session; a long one has some hundred."""
SEQUENCE_MAX: Final = (1 << 32) - 1
SIGNED: Final[Mapping[str, type[wire.Permit | wire.Start | wire.Reset]]] = {
    "permit": wire.Permit,
    "start": wire.Start,
    "reset": wire.Reset,
}
REFUSING: Final = frozenset(
    cause.name
    for cause in (StopCause.AUTHENTICATION_FAILED, StopCause.SEQUENCE_ERROR, StopCause.LOOP_STALLED)
)
"""Faults of this side for which a frame that came before was not acted on."""
_BEGINNING: Final = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True)
class CodesFound:
    """What was found.

    Attributes:
        answer: whether every code that was checked fits; "not checked" where none could be.
        key: what they were checked with.
        checked: how many fit, by what they are of.
        wrong: what does not fit, the first one first, ``SHOWN`` at most: where, when and why.
        wrong_count: how many do not.
        notes: what was refused by this side, and what could not be checked.
    """

    answer: Answer
    key: Held
    checked: Mapping[str, int] = field(default_factory=dict)
    wrong: tuple[str, ...] = ()
    wrong_count: int = 0
    notes: tuple[str, ...] = ()

    @property
    def line(self) -> str:
        """All of it in one line."""
        counted = ", ".join(_counted(name, count) for name, count in self.checked.items() if count)
        told = [self.wrong[0]] if self.wrong else []
        if self.wrong_count > 1:
            told.append(f"{self.wrong_count - 1} more do not fit")
        if counted:
            told.append(f"{counted} fit" if self.wrong else counted)
        return f"codes: {self.answer} ({self.key}): {'; '.join([*told, *self.notes])}"


def check_codes(log: Log, candump: BinaryIO | None, key: bytes | SessionKeys) -> CodesFound:
    """Check every code of a session.

    Args:
        log: the log as read.
        candump: the raw frames beside it, seekable; None where they are not there.
        key: the pre-shared key, 32 bytes, or the session's keys alone.

    Raises:
        InputError: the key is of another session or another pair: nothing is told of the log by it.
        OSError: a file cannot be read.
    """
    held: Held = "session keys" if isinstance(key, SessionKeys) else "pre-shared key"
    if isinstance(key, SessionKeys) and key.log_id != log.report.log_id:
        remedy = "name the keys that were made of this log, or the pre-shared key"
        raise InputError("--key", "log_id", key.log_id, f"{shown(log.report.log_id)}, this log's", remedy)
    try:
        opening = opening_of(log)
    except ValueError as error:
        return _no(held, str(error))
    if opening is None:
        return _without_session(log, held)
    judged = judge_opening(opening, key)
    if judged.codes is None:
        return _no(held, *judged.wrong)
    return _Checking(log, opening, judged, judged.codes, candump).found(held)


def _no(held: Held, *wrong: str) -> CodesFound:
    notes = ("not checked: everything else, for without its OPEN the session's keys are not known",)
    return CodesFound("no", held, {}, wrong, len(wrong), notes)


def _without_session(log: Log, held: Held) -> CodesFound:
    """A log of before 0.2, or of no session; or one out of which it was taken."""
    for record in log.one_by_one(AuditPermit.TOPIC):
        if record.get("code") is not None:
            return _no(held, f"{AuditSession.TOPIC} is missing, and a permit, start or reset left")
    why = "it holds no OPEN and OPENED: no session was opened, or it is of before 0.2"
    return CodesFound("not checked", held, notes=(f"they cannot be checked, for {why}",))


@dataclass
class _Unfit:
    """Frames that came and do not fit, since this side's last heartbeat: the first one, and how many."""

    first: str
    count: int = 1


class _Checking:
    """One log, from its first record to its last, and the raw frames beside it."""

    def __init__(
        self, log: Log, opening: Opening, judged: Judged, codes: SessionCodes, candump: BinaryIO | None
    ) -> None:
        self._log = log
        self._opening = opening
        self._codes = codes
        self._tags = Tags(codes)
        self._raw = None if candump is None else RawFrames(candump, self._whole)
        self._wrong: list[str] = list(judged.wrong)
        self._wrong_count = len(judged.wrong)
        self._checked = Counter({"OPEN": int(judged.opens), "OPENED": int(judged.answers)})
        self._transfers: set[bytes] = set()
        """SHA-256 of the control records that left."""
        self._seen: set[bytes] = set()
        """Those of them, and of OPENED, that are whole in the raw frames."""
        self._waiting: dict[str, bytes] = {}
        """What left last of each kind, and has not been answered."""
        self._answered: dict[bytes, str] = {}
        """What left and was answered: so it left whole."""
        self._unfit: _Unfit | None = None
        self._stopped_for = ""
        """A frame that this side refused since its last heartbeat: so the next one must not enable."""
        self._refused: list[str] = []
        self._refused_count = 0
        self._unknown: list[str] = []
        """Whole records under this side's name that the log does not know."""
        self._open = self._stalled = self._second_node = self._apart = False
        self._counted_damaged: int | None = None
        self._other_opened = 0

    # ------------------------------------------------------------ one record of the log after the other

    def found(self, held: Held) -> CodesFound:
        """Read everything; what came of it."""
        for number, message in enumerate(walk(self._log.file, Scan())):
            try:
                self._record(number, message)
            except ValueError as error:
                self._say(number, message, f"cannot be read: {error}")
        self._end()
        answer: Answer = "no" if self._wrong_count else "yes"
        notes = tuple(self._notes())
        return CodesFound(answer, held, self._counts(), tuple(self._wrong), self._wrong_count, notes)

    def _record(self, number: int, message: Stored) -> None:
        match message.topic:
            case CanFrame.TOPIC:
                self._frame(number, message)
            case AuditSession.TOPIC:
                self._open = True
            case AuditPermit.TOPIC:
                self._permit(number, message)
            case CanTransfer.TOPIC:
                self._transfer(as_record(CanTransfer, message.data))
            case AuditFault.TOPIC:
                self._fault(as_record(AuditFault, message.data))
            case AuditClose.TOPIC:
                bus = as_record(AuditClose, message.data).bus
                self._counted_damaged = None if bus is None else bus.crc_failures

    def _say(self, number: int, message: Stored, what: str) -> None:
        self._say_of(f"record {number} ({message.topic}), {when(message.log_time // 1000)}: {what}")

    def _say_of(self, what: str) -> None:
        self._wrong_count += 1
        if len(self._wrong) < SHOWN:
            self._wrong.append(what)

    def _permit(self, number: int, message: Stored) -> None:
        """A permit, start or reset that left has its code; one that was answered has left whole."""
        record = as_record(AuditPermit, message.data)
        if record.stage in ("acknowledged", "refused") and record.kind in self._waiting:
            self._answered[self._waiting.pop(record.kind)] = record.kind
        if record.stage != "sent":
            return
        kind, sequence = SIGNED[record.kind], record.sequence
        if sequence is None or not 0 <= sequence <= SEQUENCE_MAX:
            raise ValueError("it names no sequence with which it left")
        signed = kind.parse(
            canonical(record).removeprefix(kind.DOMAIN + b"\0") + bytes.fromhex(record.code or "")
        )
        if signed.canonical() != canonical(record) or not self._codes.authentic(signed, sequence):
            self._say(number, message, f"the {record.kind}: {NOT_OURS}")
            return
        self._checked[record.kind] += 1
        digest = wire.digest(wire.pack(signed, self._codes.tag, sequence))
        if digest in self._transfers:
            self._waiting[record.kind] = digest
        else:
            self._say(number, message, f"no {CanTransfer.TOPIC} is of the {record.kind} that left")

    def _transfer(self, record: CanTransfer) -> None:
        if record.direction == "sent" and record.channel == Channel.CONTROL.name.lower():
            if not len(self._transfers) < TRANSFERS_MAX:
                raise ValueError(f"more than {TRANSFERS_MAX} control records left; no session has so many")
            self._transfers.add(bytes.fromhex(record.sha256))

    def _fault(self, record: AuditFault) -> None:
        """What came before a fault of this side for which it refuses was not acted on."""
        if record.source != "runtime":
            return
        self._stalled |= record.cause == StopCause.LOOP_STALLED.name
        self._second_node |= record.cause == StopCause.SECOND_NODE.name
        if record.cause in REFUSING:
            self._not_acted_on()

    def _not_acted_on(self) -> None:
        if self._unfit is not None:
            self._refused_count += self._unfit.count
            self._refused.append(self._unfit.first)
            del self._refused[1:]
            self._stopped_for = self._unfit.first
        self._unfit = None

    def _frame(self, number: int, message: Stored) -> None:
        record = as_record(CanFrame, message.data)
        line = self._along(number, message, record)
        if not self._open:
            return
        left = record.direction == "sent"
        if left and record.id == OURS:
            self._went_on(record)
        unfit = self._tags.take(record)
        if unfit and left:
            self._say(number, message, f"{unfit}{line}")
        elif unfit and self._unfit is not None:
            self._unfit.count += 1
        elif unfit:
            place = f"record {number} ({message.topic}), {when(message.log_time // 1000)}"
            self._unfit = _Unfit(f"{place}: {unfit}{line}")

    def _went_on(self, record: CanFrame) -> None:
        """This side's next heartbeat: what does not fit, and was not refused, it has acted on."""
        if self._unfit is not None:
            self._say_of(f"{self._unfit.first}, and the session went on")
            self._wrong_count += self._unfit.count - 1
        elif self._stopped_for and enables(record):
            self._say_of(f"{self._stopped_for}, and the session went on although this side refused it")
        self._unfit, self._stopped_for = None, ""

    # ------------------------------------------------------------ the raw frames

    def _along(self, number: int, message: Stored, record: CanFrame) -> str:
        """The raw frame of this record, and its line; the first that is another one is said, and none is looked at after."""
        if self._raw is None or self._apart:
            return ""
        frame = self._raw.next()
        if frame is not None and is_logged(frame, record):
            return f" (line {self._raw.line} of the raw frames)"
        self._apart = True
        if frame is not None or self._log.scan.finished:
            here = f"line {self._raw.line} of the raw frames" if frame else "their end"
            self._say(number, message, f"the raw frames have another frame there: {here}")
        return ""

    def _whole(self, record: WholeRecord) -> None:
        """A record of the control channel in the raw frames."""
        place = f"line {record.line} of the raw frames, {when(record.time_us)}"
        digest = sha256(record.payload).digest()
        try:
            read = wire.unpack(record.payload, sender=record.side, channel=Channel.CONTROL)
        except wire.RecordError:
            if record.side is Side.RUNTIME:
                self._unknown.append(place)
                del self._unknown[1:]
            return
        if record.side is Side.CONTROLLER:
            self._from_controller(read, digest)
            return
        known = digest in self._transfers
        if known:
            self._seen.add(digest)
        self._judge(place, read, known=known)

    def _from_controller(self, read: wire.Envelope, digest: bytes) -> None:
        if digest == self._opening.answer_sha256:
            self._seen.add(digest)
        elif isinstance(read.record, wire.Opened):
            self._other_opened += not self._codes.authentic(read.record, read.sequence)

    def _judge(self, place: str, read: wire.Envelope, *, known: bool) -> None:
        """A record under this side's name, known to the log or not.

        The code of OPEN covers no sequence, and anybody can say it again.
        """
        record, what = read.record, f"{place}: the {type(read.record).__name__}"
        signed = (
            record if isinstance(record, wire.SignedRecord) and not isinstance(record, wire.Open) else None
        )
        fits = signed is not None and read.session == self._codes.tag
        fits = fits and signed is not None and self._codes.authentic(signed, read.sequence)
        if known and signed is not None and not fits:
            self._say_of(f"{what} that left: {NOT_OURS}")
        elif known and isinstance(record, wire.Acknowledge | wire.Withdraw):
            self._checked[type(record).__name__.lower()] += 1
        elif fits and not known and self._log.scan.finished:
            self._say_of(f"{what}: a holder of the key made it, and the log does not know it")
        elif not known:
            self._unknown.append(what)
            del self._unknown[1:]

    # ------------------------------------------------------------ the end

    def _end(self) -> None:
        self._not_acted_on()  # this side was silent from there on
        damaged = self._tags.damaged
        if self._counted_damaged is not None and damaged > self._counted_damaged and not self._stalled:
            self._say_of(
                f"{damaged} frames of the controller are damaged, this side counted {self._counted_damaged}"
            )
        if self._raw is None:
            return
        if not self._apart and self._raw.next() is not None and self._log.scan.finished:
            self._say_of(f"line {self._raw.line} of the raw frames: a frame that the log does not know")
        while self._raw.next() is not None:  # records may be among what follows
            pass
        if not self._log.scan.finished:
            return
        if self._raw.broken:
            self._say_of(self._raw.broken)
        if self._unknown and not (self._second_node or self._stalled):
            self._say_of(f"{self._unknown[0]}: a record under this side's name that the log does not know")
        opening = {self._opening.request_sha256: "OPEN", self._opening.answer_sha256: "OPENED"}
        for digest, name in (opening | self._answered).items():
            if digest not in self._seen:
                self._say_of(f"the raw frames do not hold the {name} that the log holds")

    def _counts(self) -> dict[str, int]:
        tags = self._tags
        self._checked.update(dict(zip(TAGGED, (tags.sent, tags.came, tags.samples), strict=True)))
        return {name: self._checked[name] for name in COUNTED}

    def _notes(self) -> list[str]:
        """What is told, and changes nothing."""
        notes = []
        if self._refused_count:
            notes.append(
                f"refused by this side, as it must: frames that came and do not fit ({self._refused_count}), "
                f"the first: {self._refused[0]}"
            )
        if self._other_opened:
            notes.append(f"refused by this side, as it must: OPENED with a wrong code ({self._other_opened})")
        if self._second_node:
            notes.append("a second node spoke under this side's name, and stopped the session")
        if self._unknown and self._stalled:
            notes.append(f"not checked: {self._unknown[0]}, for this side stood still and looked at nothing")
        if self._tags.damaged:
            notes.append(f"not checked: frames that came damaged ({self._tags.damaged})")
        if self._raw is None:
            notes.append(
                "not checked: acknowledge and withdraw, and whether the log's frames are the raw ones: they are not there"
            )
        elif not self._log.scan.finished:
            notes.append("not checked: what log or raw frames have lost at their end")
        elif partly := len(self._transfers - self._seen):
            notes.append(f"not checked: control records that did not leave whole ({partly})")
        return notes


def _counted(name: str, count: int) -> str:
    """So many of these."""
    many = COUNTED[name]
    return f"{count} {name if count == 1 else many}" if many else name


def when(time_us: int) -> str:
    """A time of a log as people read it, UTC."""
    try:
        return f"{_BEGINNING + timedelta(microseconds=time_us):%Y-%m-%dT%H:%M:%S.%fZ}"
    except OverflowError:
        return f"{time_us} us since 1970"
