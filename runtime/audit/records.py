"""What the log holds: one frozen model per topic, stored as JSON beside its flattened JSON Schema.

A value that is not defined is left out (never null), a number is never NaN or infinite, times are
``{sec, nsec}``. Every ``/audit/`` record carries ``prev``, the chain's head before it, and the two clocks;
the log fills these in (``chain.py``, ``log.py``).
"""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, ClassVar, Final, Literal, Protocol, Self, TypeVar

from pydantic import BaseModel, ConfigDict

from cutgate.protocol import records as wire
from cutgate.protocol.link import Statistics

NANOSECONDS: Final = 1_000_000_000

Disposition = Literal["decided", "authorised", "sent", "acknowledged", "withheld"]
"""``authorised``: the record is made, nothing has left. Only ``sent`` says that it left."""
Stage = Literal["authorised", "sent", "acknowledged", "refused", "withheld"]


def title_of(model: type) -> str:
    """What a model is called in the log: there `AuditPermit` is the record of a permit, and there is no other."""
    return model.__name__.removeprefix("Audit")


class Entry(BaseModel):
    """Part of a record: frozen, closed, finite."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, strict=True, model_title_generator=title_of
    )


class Time(Entry):
    """A time or duration: whole seconds and nanoseconds."""

    sec: int
    nsec: int

    @classmethod
    def of(cls, nanoseconds: int) -> Self:
        """The time of a count of nanoseconds."""
        sec, nsec = divmod(nanoseconds, NANOSECONDS)
        return cls(sec=sec, nsec=nsec)

    @property
    def nanoseconds(self) -> int:
        """The count of nanoseconds."""
        return self.sec * NANOSECONDS + self.nsec


ZERO: Final = Time(sec=0, nsec=0)
_JSON: Final = json.JSONEncoder(allow_nan=False, ensure_ascii=False, separators=(",", ":"))


class LogRecord(Entry):
    """One message of the log."""

    TOPIC: ClassVar[str]

    def encode(self) -> bytes:
        """The JSON that is stored: undefined keys absent, no NaN, UTF-8.

        Raises:
            ValueError: a number is not finite.
        """
        content = self.model_dump(mode="json", exclude_none=True)
        return _JSON.encode(content).encode()


Kind = TypeVar("Kind", bound=LogRecord)
"""Any one kind of record."""


class AuditRecord(LogRecord):
    """A record of the chain. ``prev`` and the clocks are filled in by the log."""

    prev: str = ""
    utc: Time = ZERO
    monotonic: Time = ZERO


class Option(Entry):
    """A setting and its value in words."""

    name: str
    value: str


class AuditOpen(AuditRecord):
    """Record 0: what this log is, what wrote it, and what came before it."""

    TOPIC: ClassVar[str] = "/audit/open"

    log_id: str
    software: str
    verifier: str
    transitions_sha256: str | None = None
    """Of the frozen tables that this program's steps are held against; absent in logs before them."""
    numpy: str
    cpu_dispatch: tuple[str, ...]
    """SIMD extensions numpy found; with another set its last bits may differ."""
    candump: str
    """Name of the file of raw frames beside the log."""
    previous_log: str | None = None
    previous_head: str | None = None
    """Head of the previous session's chain; after a crash the last recoverable one."""
    previous_size: int | None = None
    previous_root: str | None = None
    """Of its tree, likewise; absent where it is not known, as before logs were signed."""
    previous_epoch: int | None = None
    previous_crashed: bool
    previous_note: str | None = None
    simulation: tuple[Option, ...] = ()
    """Options that only a simulation has, such as a time scale."""
    account: str | None = None
    """The user of the process, as the operating system knows him."""
    host: str | None = None
    operator: str | None = None
    """As he called himself."""
    series: str | None = None
    epoch: int | None = None
    public_key: str | None = None
    """The log directory's sessions, this one's number, and the key that signs this log; absent before logs were signed."""
    certificate: str | None = None
    """The signature of the key of the epoch before; absent where this key was enrolled."""
    enrolled: str | None = None
    """Why nobody certified this key."""


class AuditCheckpoint(AuditRecord):
    """The log's tree of all records before this one, as a signed note (``signing.checkpoint``)."""

    TOPIC: ClassVar[str] = "/audit/checkpoint"

    size: int
    root: str
    note: str


class PermissiveValue(Entry):
    """One permissive as it stood: ``value`` or ``text``, its bound and what to do."""

    name: str
    holds: bool
    value: float | None = None
    text: str | None = None
    bound: str
    remedy: str

    @classmethod
    def of(cls, permissive: "PermissiveLike") -> Self:
        """From the interlock's permissive. A number that is not finite is kept as text."""
        value, text = permissive.value, permissive.text
        if value is not None and not math.isfinite(value):
            value, text = None, text or str(value)
        return cls(
            name=permissive.name,
            holds=permissive.holds,
            value=value,
            text=text,
            bound=permissive.bound,
            remedy=permissive.remedy,
        )


class PermissiveLike(Protocol):
    """What the interlock's permissive looks like from here."""

    @property
    def name(self) -> str: ...  # noqa: D102 - as in PermissiveValue
    @property
    def holds(self) -> bool: ...  # noqa: D102
    @property
    def value(self) -> float | None: ...  # noqa: D102
    @property
    def text(self) -> str | None: ...  # noqa: D102
    @property
    def bound(self) -> str: ...  # noqa: D102
    @property
    def remedy(self) -> str: ...  # noqa: D102


class AuditDecision(AuditRecord):
    """One step of the interlock."""

    TOPIC: ClassVar[str] = "/audit/decision"

    sequence: int
    session: str | None = None
    event: str
    from_state: str
    to_state: str
    disposition: Disposition
    effects: tuple[str, ...] = ()
    permissives: tuple[PermissiveValue, ...] = ()
    first_out: str | None = None
    """First cause of a stop."""
    reason: str | None = None
    token: int | None = None
    """Names the commit that an enabling decision waits for."""


class AuditCollected(AuditRecord):
    """A parameter record of the controller against the site's approved one."""

    TOPIC: ClassVar[str] = "/audit/collected"

    kind: Literal["limits", "calibration", "tool"]
    sha256: str
    matches_approved: bool
    difference: str | None = None


class AuditVerdict(AuditRecord):
    """A verdict: the contract's document as text, and its key fields flat."""

    TOPIC: ClassVar[str] = "/audit/verdict"

    document: str
    """``cutgate.verdict/1`` as JSON text."""
    verdict: Literal["admissible", "inadmissible"]
    method: str
    verifier: str
    path_sha256: str
    limits_sha256: str
    calibration_sha256: str
    tool_sha256: str
    registration_sha256: str
    poses: int
    evaluations_arm: int
    evaluations_wrist: int
    worst_boundary: str | None = None
    """The boundary whose certified clearance exceeds its deadband least, in deadbands."""
    worst_certified: float | None = None
    elbow: str | None = None
    q0_turns: int | None = None
    roll_turns: int | None = None
    elapsed_ms: float | None = None
    reason: str | None = None

    @classmethod
    def of(cls, document: Mapping[str, Any], *, verifier: str, tool_sha256: str, reason: str = "") -> Self:
        """From the contract's verdict document."""
        branch = document["branch"] or {}
        worst = min(boundaries_of(document), key=_margin, default=None)
        return cls(
            document=json.dumps(document, allow_nan=False, separators=(",", ":")),
            verdict=document["verdict"],
            method=document["method"],
            verifier=verifier,
            path_sha256=document["digests"]["path"],
            limits_sha256=document["digests"]["limits"],
            calibration_sha256=document["digests"]["calibration"],
            tool_sha256=tool_sha256,
            registration_sha256=document["digests"]["registration"],
            poses=document["path"]["poses"],
            evaluations_arm=document["evaluations"]["arm"],
            evaluations_wrist=document["evaluations"]["wrist"],
            worst_boundary=worst.name if worst else None,
            worst_certified=worst.certified if worst else None,
            elbow=branch.get("elbow"),
            q0_turns=branch.get("q0_turns"),
            roll_turns=branch.get("roll_turns"),
            elapsed_ms=document.get("elapsed_ms"),
            reason=reason or None,
        )


class AuditBoundary(AuditRecord):
    """One boundary's worst place; undefined values are left out and ``violated`` is true."""

    TOPIC: ClassVar[str] = "/audit/boundary"

    name: str
    unit: Literal["mm", "deg"]
    clearance: float | None = None
    certified: float | None = None
    deadband: float
    segment: int | None = None
    fraction: float | None = None
    tip_length_mm: float | None = None
    violated: bool


def boundaries_of(document: Mapping[str, Any]) -> tuple[AuditBoundary, ...]:
    """The boundaries of the contract's verdict document, in its order.

    The document's own ``deadband`` of a boundary, where given, goes before the deadband of its unit.
    """
    deadband = {"mm": document["deadband"]["arm_mm"], "deg": document["deadband"]["wrist_deg"]}
    return tuple(
        AuditBoundary(
            name=name,
            unit=entry["unit"],
            clearance=entry["clearance"],
            certified=entry["certified"],
            deadband=entry.get("deadband", deadband[entry["unit"]]),
            segment=entry["segment"],
            fraction=entry["fraction"],
            tip_length_mm=entry["tip_length_mm"],
            violated=entry["violated"],
        )
        for name, entry in document["boundaries"].items()
    )


def _margin(boundary: AuditBoundary) -> float:
    """Certified clearance in deadbands; an undefined one is the worst."""
    return -math.inf if boundary.certified is None else boundary.certified / boundary.deadband


class AuditApproach(AuditRecord):
    """The verdict on approach and retract, and what a permit binds of them; only beside an admissible verdict."""

    TOPIC: ClassVar[str] = "/audit/approach"

    document: str
    """``cutgate.approach/1`` as JSON text."""
    verdict: Literal["admissible", "inadmissible"]
    start_joints_u: tuple[int, ...]
    """Measured joints it was verified from, 1e-6 deg | mm."""
    entry_um: int
    exit_um: int
    entry_joints_u: tuple[int, ...] = ()
    exit_joints_u: tuple[int, ...] = ()
    speed_percent: int | None = None
    """Empty and absent where it is inadmissible: nothing is bound."""
    worst_leg: str | None = None
    worst_boundary: str | None = None
    """The boundary whose certified clearance exceeds its deadband least, in deadbands, and its leg."""
    worst_certified: float | None = None
    reason: str | None = None

    @classmethod
    def of(
        cls,
        document: Mapping[str, Any],
        *,
        start_joints_u: tuple[int, ...],
        bound: wire.Approach | None,
        reason: str = "",
    ) -> Self:
        """From the document, and what the permit binds where it is admissible."""
        entries = [
            (leg, name, entry)
            for leg, boundaries in document["legs"].items()
            for name, entry in boundaries.items()
        ]
        worst = min(entries, key=lambda entry: _ratio(entry[2]), default=None)
        return cls(
            document=json.dumps(document, allow_nan=False, separators=(",", ":")),
            verdict=document["verdict"],
            start_joints_u=start_joints_u,
            entry_um=document["entry_um"],
            exit_um=document["exit_um"],
            entry_joints_u=bound.entry_joints_u if bound else (),
            exit_joints_u=bound.exit_joints_u if bound else (),
            speed_percent=bound.speed_percent if bound else None,
            worst_leg=worst[0] if worst else None,
            worst_boundary=worst[1] if worst else None,
            worst_certified=worst[2]["certified"] if worst else None,
            reason=reason or None,
        )


def _ratio(entry: Mapping[str, Any]) -> float:
    """Certified clearance in deadbands; an undefined one is the worst."""
    certified = entry["certified"]
    return -math.inf if certified is None else float(certified / entry["deadband"])


class AuditGuidance(AuditRecord):
    """Where to move the bone, after an inadmissible verdict; for people, it decides nothing.

    Logs of 0.1.0 hold it in the verdict's document.
    """

    TOPIC: ClassVar[str] = "/audit/guidance"

    document: str | None = None
    """``guidance`` of ``cutgate.verdict/1`` as JSON text; absent where none came in time."""
    note: str | None = None
    """Why it is absent."""

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> Self:
        """From the contract's verdict document."""
        found = document["guidance"]
        text = None if found is None else json.dumps(found, allow_nan=False, separators=(",", ":"))
        return cls(document=text, note=document.get("guidance_note"))


class AuditPermit(AuditRecord):
    """A permit, start or reset on its way. ``authorised`` alone never means that it left."""

    TOPIC: ClassVar[str] = "/audit/permit"

    kind: Literal["permit", "start", "reset"]
    stage: Stage
    token: int | None = None
    nonce: str | None = None
    path_sha256: str | None = None
    limits_sha256: str | None = None
    calibration_sha256: str | None = None
    tool_sha256: str | None = None
    registration_sha256: str | None = None
    configuration_sha256: str | None = None
    record: str | None = None
    """The canonical record that is authenticated, in hex."""
    log_size: int | None = None
    log_root: str | None = None
    """What was sent names the log's tree of so many records, with this root in hex; here from version 4 on."""
    code: str | None = None
    """The authentication code that was sent, in hex."""
    sequence: int | None = None
    """With which it was sent, which the code covers."""
    reply: str | None = None
    reason: str | None = None


class AuditSession(AuditRecord):
    """The session with the controller, once it has opened: what every code in it is checked by, beside the key."""

    TOPIC: ClassVar[str] = "/audit/session"

    session: str
    """Its digest, in hex."""
    open: str
    opened: str
    """OPEN and OPENED as they crossed the bus: the whole record with its envelope and its code, in hex."""
    key_fingerprint: str | None = None
    """Of the pre-shared key, as people compare it."""


class AuditWitness(AuditRecord):
    """The tree that the last start named which the controller accepted, as it tells it; and whether it is found here."""

    TOPIC: ClassVar[str] = "/audit/witness"

    log_id: str
    log_size: int
    log_root: str
    found: bool
    log: str | None = None
    """Name of the log in which it is found."""
    reason: str | None = None
    """Why it is not; or what is missing behind it."""


class AuditController(AuditRecord):
    """The controller's reported state, whenever it changes."""

    TOPIC: ClassVar[str] = "/audit/controller"

    state: str
    cause: str
    epoch: int
    device_pressed: bool
    emergency_stop_clear: bool
    cutting_mode: bool
    fresh: bool


class AuditFault(AuditRecord):
    """A fault, the controller's or our own."""

    TOPIC: ClassVar[str] = "/audit/fault"

    source: Literal["controller", "runtime"]
    code: str
    cause: str
    detail: str | None = None


class AuditOperator(AuditRecord):
    """A word of the operator, and whether it was taken."""

    TOPIC: ClassVar[str] = "/audit/operator"

    word: str
    what: str | None = None
    accepted: bool
    reason: str | None = None


class AuditProcess(AuditRecord):
    """A process of the session. The arguments hold names of key files, never keys."""

    TOPIC: ClassVar[str] = "/audit/process"

    role: str
    pid: int
    argv: tuple[str, ...] = ()


class AuditAttachment(AuditRecord):
    """An attachment's digest: readers skip the checksum of the attachment itself."""

    TOPIC: ClassVar[str] = "/audit/attachment"

    name: str
    media_type: str
    sha256: str
    size: int


class BusCounts(Entry):
    """What this side's link has counted of the controller's single frames (``cutgate.protocol.link.Statistics``)."""

    accepted: int
    losses: int
    repetitions: int
    crc_failures: int
    outside_session: int
    stale_heartbeats: int

    @classmethod
    def of(cls, statistics: Statistics) -> Self:
        """As the link counts them."""
        return cls(**asdict(statistics))


class AuditClose(AuditRecord):
    """The last record; ``prev`` is the chain's head over everything before it."""

    TOPIC: ClassVar[str] = "/audit/close"

    final_state: str
    verdict: str | None = None
    outcome: str | None = None
    clean: bool
    """The session came to its end; not a crash, not an internal error."""
    message_count: int
    """All messages of the file, this one included."""
    candump_sha256: str
    candump_bytes: int
    bus: BusCounts | None = None
    """Absent where no session was held, and in logs of 0.1."""


class CanFrame(LogRecord):
    """A single frame; the fields of ROS ``can_msgs/Frame``, data in hex."""

    TOPIC: ClassVar[str] = "/can/frame"

    stamp: Time
    direction: Literal["received", "sent"]
    id: int
    is_rtr: bool = False
    is_extended: bool = False
    is_error: bool = False
    dlc: int
    data: str


class CanTransfer(LogRecord):
    """One reassembled record of an ISO-TP channel."""

    TOPIC: ClassVar[str] = "/can/transfer"

    stamp: Time
    direction: Literal["received", "sent"]
    channel: str
    record: str
    length: int
    sha256: str


class TrackingSample(LogRecord):
    """One measured sample of the moving arm beside the nearest place of the reference trajectory, as it was judged."""

    TOPIC: ClassVar[str] = "/tracking"

    leg: Literal["approach", "entry", "cut", "exit", "retract"]
    """Of the nearest place."""
    reference_s: float
    """Seconds of the trajectory to there, from its start."""
    segment: int | None = None
    fraction: float | None = None
    """Of the path, there; absent outside the cut."""
    q0_deviation_deg: float
    q1_deviation_deg: float
    q2_deviation_mm: float
    q3_deviation_deg: float
    q4_deviation_deg: float
    """Measured less reference."""
    tip_distance_mm: float
    """Of the measured tip from the reference trajectory's."""
    wrist_deviation_mm: float
    """A bound of the wrist centre's distance from the reference, at every elbow angle: that is judged, and each turning joint."""
    wrist_tolerance_mm: float
    joint_tolerance_deg: float
    age_ms: float | None = None
    """The sample is no older; absent where nothing proves its age."""


class LoopTiming(LogRecord):
    """How the runtime's loop, the bus and the disk keep their time, in a cycle that has sent a heartbeat."""

    TOPIC: ClassVar[str] = "/timing"

    heartbeat_age_ms: float
    """What the time-out counts: since the sending of the heartbeat that the controller echoed last."""
    timeout_ms: float
    round_trip_ms: float | None = None
    """From that sending to the echo; absent before the first."""
    heartbeat_late_ms: float
    """Between when a heartbeat was due and the cycle that made it."""
    longest_gap_ms: float
    """The longest from one cycle's begin to the next, since the record before."""
    commit_ms: float | None = None
    """From handing over to durable, of the last commit; absent before the first."""
    waiting_ms: float
    waiting_bytes: int
    """Of the log, handed over and not durable: for how long, and how many."""


STREAMED: Final = frozenset({CanFrame.TOPIC, TrackingSample.TOPIC, LoopTiming.TOPIC})
"""Topics with records by the second: of these no reader keeps where each one stands."""

MODELS: Final[tuple[type[LogRecord], ...]] = (
    AuditOpen, AuditCheckpoint, AuditDecision, AuditCollected, AuditVerdict, AuditBoundary, AuditApproach, AuditGuidance, AuditPermit, AuditSession, AuditWitness, AuditController, AuditFault, AuditOperator, AuditProcess, AuditAttachment, AuditClose,
    CanFrame, CanTransfer, TrackingSample, LoopTiming,
)  # fmt: skip
"""Every model, one per topic."""
