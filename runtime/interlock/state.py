"""What the interlock remembers, what can happen to it and what it orders."""

from dataclasses import dataclass, field
from enum import Enum, StrEnum, auto
from functools import cached_property
from typing import Final

from cutgate.protocol import records
from cutgate.protocol.states import (
    WITHDRAWING,
    ControllerState,
    FaultCode,
    Purpose,
    Refusal,
    StopCause,
    StopCode,
)
from cutgate.runtime.interlock.tracking import (
    Deviation,
    Nearest,
    ReferenceTrajectory,
    TrackingMonitor,
    TrackingTolerance,
)
from cutgate.runtime.kinematics.landmarks import NONE_ASKED, CheckPoints


class Phase(StrEnum):
    """Where the conversation stands. Only CUTTING and STARTING let the arm move."""

    WAITING = auto()
    """No controller has announced itself."""
    OPENING = auto()
    HELD = auto()
    """The controller carries a stop cause or a latched fault; the operator acknowledges and resets."""
    NONCE_RESET = auto()
    AUTHORISING_RESET = auto()
    RESETTING = auto()
    COLLECTING = auto()
    UPLOADING = auto()
    VERIFYING = auto()
    ADMITTED = auto()
    """The path is proved; the permissives for the permit are awaited."""
    NONCE_PERMIT = auto()
    AUTHORISING_PERMIT = auto()
    """The decision is being made durable; nothing has left."""
    PERMITTING = auto()
    PERMITTED = auto()
    NONCE_START = auto()
    AUTHORISING_START = auto()
    STARTING = auto()
    CUTTING = auto()
    FINISHING = auto()
    """The controller reports the end of the retract; joints measured since then must show the arm back at its start."""
    STOPPING = auto()
    """A stop has left; the controller's confirmation is awaited for a bounded time."""
    DONE = auto()
    REFUSED = auto()
    STOPPED = auto()


class OperatorCommand(StrEnum):
    """What the operator can say."""

    START = auto()
    STOP = auto()
    ACKNOWLEDGE = auto()
    RESET = auto()
    WITHDRAW = auto()
    CONFIRM = auto()
    """A warning, which is named."""
    QUIT = auto()


class DeviceCycle(Enum):
    """The enabling device since the permit: seen released, then pressed."""

    UNSEEN = auto()
    RELEASED = auto()
    PRESSED = auto()


@dataclass(frozen=True)
class Deadlines:
    """How long this side waits for whom, from the site's configuration; the controller need not know."""

    announce_wait_s: float
    reply_timeout_s: float
    transfer_timeout_s: float
    verify_timeout_s: float
    operator_wait_s: float
    commit_deadline_s: float
    stop_confirm_s: float


@dataclass(frozen=True)
class Job:
    """What this run is about: fixed before the session opens, bound into the permit."""

    limits: bytes
    calibration: bytes
    tool: bytes
    """Approved parameter records (canonical bytes); the controller's must equal them."""
    path: bytes
    registration: bytes
    configuration: bytes
    """SHA-256 digests."""
    verifier: str
    branch: records.Branch
    timing: records.Timing
    """What both sides keep, as OPEN asks for it."""
    deadlines: Deadlines
    tracking: TrackingTolerance
    serial: str | None = None
    registration_age_s: float = 0.0
    """At the first event; it grows from there."""
    registration_max_age_s: float | None = None
    registration_residual_mm: float | None = None
    registration_max_residual_mm: float | None = None
    check_points: CheckPoints = NONE_ASKED
    place: bytes = records.NO_PLACE
    """Digest of where the registration says that the bone is; NO_PLACE for a plan in robot coordinates."""
    registration_time_us: int = records.NO_TIME
    """When it was made, since 1970, UTC; NO_TIME where there is none."""
    prepared_us: int = records.NO_TIME
    """When the job was made, by this computer's clock, since 1970, UTC."""
    withdrawal: str = ""
    """Why the registration must not be used, as this site's own list says; empty where it may."""
    simulation_allowed_by: str = ""
    """Who said that the controller may be a simulation; empty where nobody did. Never the controller itself."""
    key_fingerprint: str = ""
    """Of the key that signs: a controller that holds another one refuses, and the two are to be compared."""

    @cached_property
    def path_digest(self) -> bytes:
        """SHA-256 of the path, taken once: a path of a million poses is 20 MB."""
        return records.digest(self.path)

    @property
    def blocks(self) -> int:
        """In how many blocks the path is uploaded."""
        return -(-len(self.path) // records.BLOCK_BYTES)


@dataclass(frozen=True)
class SessionIdentity:
    """The session that an OPEN names."""

    request: records.Open
    """As the table builds it, without its code."""
    serial: str
    time_scale: float = 1.0
    """Seconds of the plant in one of the clock; 1 on a real controller."""

    @cached_property
    def digest(self) -> bytes:
        """Names the session, 32 bytes."""
        return records.session_digest(self.request)

    @property
    def tag(self) -> int:
        """The digest's first four bytes."""
        return records.session_tag(self.digest)

    @property
    def announce_nonce(self) -> bytes:
        """The controller's, which this OPEN uses up."""
        return self.request.announce_nonce


@dataclass(frozen=True)
class ControllerView:
    """The controller as its last accepted heartbeat shows it."""

    state: ControllerState
    cause: StopCause
    epoch: int
    device_pressed: bool
    emergency_stop_clear: bool
    cutting_mode: bool


@dataclass(frozen=True)
class Collected:
    """Canonical record bytes as received."""

    limits: bytes | None = None
    calibration: bytes | None = None
    tool: bytes | None = None

    @property
    def complete(self) -> bool:
        """All three have arrived."""
        return None not in (self.limits, self.calibration, self.tool)


@dataclass(frozen=True)
class UploadedPath:
    """The controller's word on the uploaded path."""

    digest: bytes
    refusal: Refusal
    pose: int


@dataclass(frozen=True)
class CutVerdict:
    """A verdict on cut, approach and retract, and what it was made for."""

    request: int
    admissible: bool
    path: bytes
    limits: bytes
    calibration: bytes
    tool: bytes
    start_joints_u: tuple[int, ...]
    """Measured joints from which the approach was verified, 1e-6 deg | mm."""
    reason: str
    approach: records.Approach | None
    """What the permit binds; None unless approach and retract are admissible."""
    approach_reason: str
    trajectory: ReferenceTrajectory | None = None
    """Where the arm is when, by what was verified; without it nothing is permitted."""
    to_confirm: tuple[str, ...] = ()
    """Codes of the warnings that the operator must confirm before a permit."""


@dataclass(frozen=True)
class LogHealth:
    """The audit log as the shell last saw it."""

    writable: bool = False
    reserved_bytes: int = 0
    """0 until the file system has answered."""
    needed_bytes: int = 1


WITNESS: Final = "WITNESS"
"""What the operator confirms where the log that the controller saw last is not found."""


@dataclass(frozen=True)
class WitnessSought:
    """Whether the log that the controller saw last is here, and what is to be said of it."""

    found: bool
    text: str


@dataclass(frozen=True)
class Interlock:
    """The whole state of the runtime's decisions."""

    job: Job
    phase: Phase = Phase.WAITING
    since_s: float = 0.0
    """When this phase was entered."""
    began_s: float | None = None
    """When the first event came."""
    announced_version: int | None = None
    """Of the protocol, by the controller's last announcement."""
    session: SessionIdentity | None = None
    opened: records.Opened | None = None
    """What the controller said when it opened the session."""
    witness: WitnessSought | None = None
    held_on: StopCause = StopCause.NONE
    """The cause that the session was opened on, until the controller lets go of it: any stop brings it back."""
    epoch: int = 0
    controller: ControllerView | None = None
    heartbeat_fresh: bool = False
    collected: Collected = field(default_factory=Collected)
    block: int = 0
    stored: UploadedPath | None = None
    verdict: CutVerdict | None = None
    confirmed: frozenset[str] = frozenset()
    """Codes of the warnings that the operator has confirmed."""
    nonce: bytes | None = None
    permit: records.Permit | None = None
    nonce_at_s: float = 0.0
    """When the permit's nonce was asked for; its lifetime counts from here on this side."""
    token: int = 0
    """Names the record whose durability is awaited; each is used once."""
    device: DeviceCycle = DeviceCycle.UNSEEN
    joints_u: tuple[int, ...] | None = None
    """Measured joints, 1e-6 deg | mm."""
    measured_s: float = 0.0
    """They are no older than this."""
    tracking: TrackingMonitor | None = None
    """Holds the arm against the verified path from the start on, as long as it may move."""
    nearest: Nearest | None = field(default=None, compare=False)
    """What the last sample of the moving arm was held against; for the log alone, nothing is decided by it."""
    log: LogHealth = field(default_factory=LogHealth)
    registration_withdrawn: bool = False
    """In this session; what an earlier one withdrew stands in the job."""
    withdraw_due: bool = False
    """A Withdraw of this session's registration has left; the controller's Reply to it is awaited."""
    withdraw_sent_s: float = 0.0
    """When it left last."""
    barrier_us: int = records.NO_TIME
    """Of the last Withdraw that left, since 1970, UTC: only a registration later than it counts."""
    acknowledged: StopCause = StopCause.NONE
    """The controller's cause that the operator acknowledged in this session; what a reset names."""
    cause: StopCause = StopCause.NONE
    """First-out."""
    reason: str = ""
    answer_due: bool = False
    """The stop is the controller's answer to a signed record; the Reply with its reason is on the way."""
    stops_sent: frozenset[StopCause] = frozenset()
    """The causes for which a stop has left."""

    def told(self, cause: StopCause) -> StopCause:
        """What the controller is told of a cause, under this side's code or before it: no withdrawal that is only claimed.

        Else whoever forges a fault frame withdraws a registration, by the mouth of a holder of the key.
        """
        claimed = cause in WITHDRAWING and not self.registration_withdrawn
        return StopCause.PROTOCOL_VIOLATION if claimed else cause


# ---------------------------------------------------------------- events


@dataclass(frozen=True)
class Announced:
    """A controller without a session announces itself; ``nonce`` is ours, fresh."""

    announce: records.Announce
    nonce: bytes


@dataclass(frozen=True)
class OtherVersionAnnounced:
    """A controller announces itself that speaks another version of the protocol."""

    version: int


@dataclass(frozen=True)
class SessionOpened:
    """Somebody says that our OPEN was accepted; ``authentic``: a holder of the key says so."""

    opened: records.Opened
    authentic: bool


@dataclass(frozen=True)
class ParameterReceived:
    """Limits, calibration or tool."""

    record: records.Limits | records.Calibration | records.Tool


@dataclass(frozen=True)
class BlockConfirmed:
    """The controller has block ``index`` of the path."""

    index: int


@dataclass(frozen=True)
class PathConfirmed:
    """The controller has the whole path and has judged it."""

    stored: UploadedPath


@dataclass(frozen=True)
class VerdictReady:
    """The worker's verdict."""

    verdict: CutVerdict


@dataclass(frozen=True)
class NonceReceived:
    """A nonce for one purpose."""

    purpose: Purpose
    nonce: bytes
    epoch: int


@dataclass(frozen=True)
class ReplyReceived:
    """An answer to one of our requests. It carries no code: it may deny, and enables nothing."""

    request_type: int
    refusal: Refusal
    cause: StopCause


@dataclass(frozen=True)
class HeartbeatReceived:
    """A checked controller heartbeat; ``fresh`` says its echo proves it young."""

    view: ControllerView
    fresh: bool


@dataclass(frozen=True)
class Crowd:
    """Most of the frames that are heard are neither side's, and they are many.

    Attributes:
        can_id, is_extended: the identifier of most of them.
        frames_per_s: with this identifier.
        percent: of all frames that are heard.
    """

    can_id: int
    is_extended: bool
    frames_per_s: int
    percent: int

    def __str__(self) -> str:
        name = f"0x{self.can_id:08X}" if self.is_extended else f"0x{self.can_id:03X}"
        return (
            f"{self.percent} % of the frames on the bus had identifier {name}, which is neither side's "
            f"({self.frames_per_s} a second): find the node that sends it, it leaves others no room"
        )


@dataclass(frozen=True)
class HeartbeatLost:
    """No fresh heartbeat within the time-out.

    Attributes:
        paused_ms: how long this side's own loop stood still meanwhile, at the longest; 0 where it kept its time.
        crowd: who takes the bus for himself; None where nobody does.
    """

    paused_ms: int = 0
    crowd: Crowd | None = None


@dataclass(frozen=True)
class FaultReceived:
    """A fault frame, which carries no code: its cause is claimed. ``paused_ms`` and ``crowd`` as of `HeartbeatLost`."""

    code: FaultCode
    cause: StopCause
    paused_ms: int = 0
    crowd: Crowd | None = None


@dataclass(frozen=True)
class JointsMeasured:
    """Where the arm stands: reported joints, 1e-6 deg | mm, measured at ``measured_s`` at the earliest."""

    joints_u: tuple[int, ...]
    measured_s: float


@dataclass(frozen=True)
class ProgressReported:
    """How far the cut is, as the controller says; ``fraction`` of the segment in counts of 1/65535."""

    segment: int
    fraction: int


@dataclass(frozen=True)
class RecordDurable:
    """The record named by ``token`` has reached the disk; ``log`` is the tree up to it."""

    token: int
    log: records.TreeHead


@dataclass(frozen=True)
class WithdrawalSent:
    """A Withdraw has left with this barrier, since 1970, UTC."""

    barrier_us: int


@dataclass(frozen=True)
class LogChanged:
    """The audit log's health."""

    log: LogHealth


@dataclass(frozen=True)
class Failed:
    """Something the shell found; the session stops with this cause."""

    cause: StopCause
    reason: str


@dataclass(frozen=True)
class Gone:
    """Nothing can be waited for any more: the bus or the program itself has failed. The session is over."""

    cause: StopCause
    reason: str


@dataclass(frozen=True)
class CommandGiven:
    """An operator command; ``what`` it is about, where it names something: a warning, or the signal that says quit."""

    command: OperatorCommand
    what: str = ""


@dataclass(frozen=True)
class Tick:
    """Time passes."""


Event = (
    Announced
    | OtherVersionAnnounced
    | SessionOpened
    | WitnessSought
    | ParameterReceived
    | BlockConfirmed
    | PathConfirmed
    | VerdictReady
    | NonceReceived
    | ReplyReceived
    | HeartbeatReceived
    | HeartbeatLost
    | FaultReceived
    | JointsMeasured
    | ProgressReported
    | RecordDurable
    | WithdrawalSent
    | LogChanged
    | Failed
    | Gone
    | CommandGiven
    | Tick
)


# ---------------------------------------------------------------- effects


@dataclass(frozen=True)
class Send:
    """A record to the controller. What is to be signed gets its code from the shell, on its way out.

    `sequence`: with which it left, which the code covers; the shell's to say.
    """

    record: records.Record
    sequence: int | None = None


@dataclass(frozen=True)
class SendBlock:
    """Block ``index`` of the path."""

    index: int


@dataclass(frozen=True)
class SendStop:
    """A stop frame, at once."""

    code: StopCode
    cause: StopCause


@dataclass(frozen=True)
class SendWithdraw:
    """Withdraw this place; the shell knows the time and so the barrier, and answers ``WithdrawalSent``.

    Attributes:
        place: its digest; NO_PLACE where nobody knows which it was.
        motion_age_s: how long ago the bone moved; None where that is now, or nobody knows.
    """

    place: bytes
    motion_age_s: int | None = None


@dataclass(frozen=True)
class SeekWitness:
    """Look up the log that the controller saw last, then answer ``WitnessSought``."""

    log: records.TreeHead


@dataclass(frozen=True)
class UseSession:
    """Records carry this session from now on."""

    session: SessionIdentity


@dataclass(frozen=True)
class OpenLink:
    """Heartbeats flow and are supervised from now on."""

    session: SessionIdentity


@dataclass(frozen=True)
class Verify:
    """Prove the uploaded path, and the approach from the measured joints, against the collected records."""

    request: int
    start_joints_u: tuple[int, ...]


@dataclass(frozen=True)
class Commit:
    """Make the decision durable, then answer ``RecordDurable(token)``."""

    token: int
    purpose: Purpose
    record: records.Record


@dataclass(frozen=True)
class Withheld:
    """A durable decision that no longer applies: it is recorded, nothing leaves."""

    token: int


@dataclass(frozen=True)
class Refused:
    """An operator command that does not apply now, with the reason to show."""

    command: OperatorCommand
    reason: str


@dataclass(frozen=True)
class Dropped:
    """An answer to something that is not pending."""

    what: str


Effect = (
    Send
    | SendBlock
    | SendStop
    | SendWithdraw
    | SeekWitness
    | UseSession
    | OpenLink
    | Verify
    | Commit
    | Withheld
    | Refused
    | Dropped
    | Deviation
)
"""What the table orders; Withheld, Refused, Dropped and Deviation are for the log and for people."""
