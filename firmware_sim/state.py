"""What the simulated controller remembers, what can happen to it and what it answers."""

import math
from dataclasses import dataclass, field, replace
from enum import Enum, auto
from typing import Self

from cutgate.firmware_sim.approach import Ends
from cutgate.protocol import records
from cutgate.protocol.states import (
    ControllerState,
    FaultCode,
    Purpose,
    Refusal,
    RuntimeCode,
    StopCause,
    StopCode,
)


@dataclass(frozen=True)
class Identity:
    """What makes this controller this one, for as long as it is powered.

    The key itself is the endpoint's, which says of every record whether its code fits.
    """

    serial: str
    key_fingerprint: str
    protocol_version: int = records.PROTOCOL_VERSION
    plant_speed_permille: int = 1000


@dataclass(frozen=True)
class Holdings:
    """The bytes the controller holds. Digests are always computed anew from these, never remembered."""

    limits: bytes
    calibration: bytes
    tool: bytes
    path: bytes | None = None
    ends: Ends | None = None
    """Entry and exit of the stored path by the controller's own kinematics; None where it cannot reach them."""


@dataclass(frozen=True)
class Memory:
    """What a loss of power does not take away.

    Attributes:
        withdrawn: digests of the places of registrations that may never be permitted again.
        earlier: digests of whole registrations that were withdrawn before places were remembered.
        barrier_us: only a registration later than this counts, UTC microseconds since 1970; NO_TIME without a barrier.
        withdrawal_due: the bone moved, or a registration was withdrawn, and no Withdraw of a later session has told the
            barrier yet.
        log: how far the runtime's log was at the last start that was accepted.
        latched: the first-out cause of a latched fault, NONE without one.
    """

    withdrawn: frozenset[bytes] = frozenset()
    earlier: frozenset[bytes] = frozenset()
    barrier_us: int = records.NO_TIME
    withdrawal_due: bool = False
    log: records.TreeHead = records.NO_TREE_HEAD
    latched: StopCause = StopCause.NONE

    def with_motion(self, place: bytes | None) -> "Memory":
        """The bone is elsewhere, or this place was withdrawn; None where no session names a place."""
        withdrawn = self.withdrawn if place is None else self.withdrawn | {place}
        return replace(self, withdrawn=withdrawn, withdrawal_due=True)

    def with_barrier(self, place: bytes, barrier_us: int, *, settles: bool) -> "Memory":
        """As a Withdraw says; NO_PLACE withdraws none in particular. A barrier is never lowered.

        Args:
            place: its digest.
            barrier_us: UTC microseconds since 1970.
            settles: nothing has happened since that it may not know of.
        """
        named = frozenset() if place == records.NO_PLACE else frozenset({place})
        return replace(
            self,
            withdrawn=self.withdrawn | named,
            barrier_us=max(self.barrier_us, barrier_us),
            withdrawal_due=self.withdrawal_due and not settles,
        )


@dataclass(frozen=True)
class ControllerSession:
    """One session with one runtime, by the OPEN that asked for it.

    Attributes:
        live: false once a stop has voided it.
        withdrawn: the bone moved in it, or its runtime withdrew: settled by a Withdraw of the next session alone, and the
            same level in later heartbeats is no news.
    """

    tag: int
    digest: bytes
    announce_nonce: bytes
    registration: bytes
    place: bytes
    registration_time_us: int
    configuration: bytes
    verifier: str
    permit_lifetime_s: float
    start_lifetime_s: float
    start_tolerance_mm: float
    start_tolerance_deg: float
    approach_clearance_um: int
    approach_speed_percent: int
    heartbeat_s: float
    timeout_s: float
    live: bool = True
    withdrawn: bool = False

    @classmethod
    def of(cls, request: records.Open) -> Self:
        """What an OPEN that passed every rule agrees on."""
        named, timing = records.session_digest(request), request.timing
        return cls(
            tag=records.session_tag(named),
            digest=named,
            announce_nonce=request.announce_nonce,
            registration=request.registration_digest,
            place=request.place_digest,
            registration_time_us=request.registration_time_us,
            configuration=request.configuration_digest,
            verifier=request.verifier_version,
            permit_lifetime_s=timing.permit_lifetime_s,
            start_lifetime_s=timing.start_lifetime_s,
            start_tolerance_mm=timing.start_tolerance_mm,
            start_tolerance_deg=timing.start_tolerance_deg,
            approach_clearance_um=timing.approach_clearance_um,
            approach_speed_percent=timing.approach_speed_percent,
            heartbeat_s=timing.heartbeat_s,
            timeout_s=timing.timeout_s,
        )


@dataclass(frozen=True)
class Issued:
    """A nonce given out: it serves once, for one purpose, until a newer one or a stop voids it."""

    nonce: bytes
    purpose: Purpose
    at_s: float


class DeviceCycle(Enum):
    """How far the enabling device has come since the permit: it must be seen released, then pressed."""

    UNSEEN = auto()
    RELEASED = auto()
    PRESSED = auto()


@dataclass(frozen=True)
class Inputs:
    """Wired inputs. The enabling device is released and the emergency stop is clear at power-up."""

    device_pressed: bool = False
    emergency_stop_clear: bool = True


@dataclass(frozen=True)
class Controller:
    """The whole state of the controller's decisions."""

    identity: Identity
    holdings: Holdings
    announce_nonce: bytes
    """What an OPEN must name; another one with every session that is opened, so that an OPEN opens once."""
    state: ControllerState = ControllerState.INHIBITED
    cause: StopCause = StopCause.NONE
    """First-out: the first stop cause since the last acknowledgement."""
    epoch: int = 0
    inputs: Inputs = field(default_factory=Inputs)
    session: ControllerSession | None = None
    issued: Issued | None = None
    permit: records.Permit | None = None
    permit_issued_at_s: float = 0.0
    device: DeviceCycle = DeviceCycle.UNSEEN
    cut_ordered: bool = False
    """The runtime's heartbeat has ordered CUT since the start; without it nothing moves."""
    started_at_s: float = 0.0
    heartbeat_fresh: bool = False
    measured_u: tuple[int, ...] | None = None
    """Reported joints, 1e-6 deg | mm; None until measured since the last stop."""
    moved_at_s: float | None = None
    """When the bone moved, or a registration was withdrawn, while this is due; None after a power-up."""
    memory: Memory = Memory()
    """What must not be forgotten, from the moment in which it happens."""
    written: Memory | None = None
    """What non-volatile memory is known to hold; where it differs, it is written again and again."""
    awaiting: "Awaiting | None" = None
    """The request whose answer waits for non-volatile memory."""

    @classmethod
    def powered_up(
        cls, identity: Identity, holdings: Holdings, memory: Memory, announce_nonce: bytes
    ) -> Self:
        """At power-up, with what non-volatile memory holds: a fault that was latched still is."""
        latched = memory.latched is not StopCause.NONE
        state = ControllerState.FAULT if latched else ControllerState.INHIBITED
        return cls(identity, holdings, announce_nonce, state, memory.latched, memory=memory, written=memory)

    @property
    def may_move(self) -> bool:
        """Motion is a level: cutting state, a live session and a fresh heartbeat that says CUT."""
        return (
            self.state is ControllerState.CUTTING
            and self.cut_ordered
            and self.heartbeat_fresh
            and self.session is not None
            and self.session.live
        )

    @property
    def cutting_mode(self) -> bool:
        """The cutter may spin only while permitted or cutting."""
        return self.state in (ControllerState.PERMITTED, ControllerState.CUTTING)

    def motion_age_s(self, now_s: float) -> int:
        """How long ago it was that the bone moved, whole seconds, rather too few than too many; AGE_UNKNOWN if unknown."""
        age_s = math.nan if self.moved_at_s is None else now_s - self.moved_at_s
        return math.floor(min(age_s, records.AGE_UNKNOWN)) if age_s >= 0.0 else records.AGE_UNKNOWN


# ---------------------------------------------------------------- events


@dataclass(frozen=True)
class OpenReceived:
    """A runtime asks for a session.

    Attributes:
        request: what it asks for; of another protocol version nothing but that.
        sequence: which a reply names.
        authentic: whether its code fits.
        fresh: the next announce nonce, from the operating system's generator.
    """

    request: records.Open | records.OtherVersion
    sequence: int
    authentic: bool
    fresh: bytes


@dataclass(frozen=True)
class CollectReceived:
    """The runtime asks for limits, calibration and tool."""


@dataclass(frozen=True)
class PathChecked:
    """A path arrived whole and the controller's own kinematics have judged every pose, entry and exit."""

    path: bytes
    refusal: Refusal
    pose: int
    ends: Ends | None


@dataclass(frozen=True)
class NonceRequested:
    """The runtime asks for a nonce; ``fresh`` comes from the operating system's generator."""

    purpose: Purpose
    fresh: bytes


@dataclass(frozen=True)
class PermitReceived:
    """A permit, not yet believed. ``authentic``: its code fits, as of everything that is signed."""

    permit: records.Permit
    sequence: int
    authentic: bool


@dataclass(frozen=True)
class StartReceived:
    """A start, not yet believed."""

    start: records.Start
    sequence: int
    authentic: bool


@dataclass(frozen=True)
class ResetReceived:
    """A reset, not yet believed."""

    reset: records.Reset
    sequence: int
    authentic: bool


@dataclass(frozen=True)
class AcknowledgeReceived:
    """The operator has seen the cause."""

    acknowledge: records.Acknowledge
    sequence: int
    authentic: bool


@dataclass(frozen=True)
class WithdrawReceived:
    """The runtime withdraws a registration, or tells from when on one counts again."""

    withdraw: records.Withdraw
    sequence: int
    authentic: bool


@dataclass(frozen=True)
class HeartbeatReceived:
    """A checked runtime heartbeat: a holder of the key made it. ``fresh``: its echo proves to the link that it is young."""

    code: RuntimeCode
    epoch: int
    cause: StopCause
    fresh: bool


@dataclass(frozen=True)
class HeartbeatLost:
    """No fresh heartbeat within the time-out."""


@dataclass(frozen=True)
class StopReceived:
    """A stop frame, which may be anybody's; a malformed one counts as STOP."""

    code: StopCode
    cause: StopCause


@dataclass(frozen=True)
class FaultArisen:
    """Something the shell found: a link violation, a stalled loop, a failed transfer, a second node."""

    cause: StopCause


@dataclass(frozen=True)
class InputsChanged:
    """The wired inputs as read."""

    inputs: Inputs


@dataclass(frozen=True)
class BoneMoved:
    """The bone-motion sensor has spoken."""


@dataclass(frozen=True)
class LimitsChanged:
    """Somebody changed a joint limit at the controller."""

    limits: bytes


@dataclass(frozen=True)
class JointsMeasured:
    """Where the arm stands: reported joints, 1e-6 deg | mm."""

    joints_u: tuple[int, ...]


@dataclass(frozen=True)
class PathFinished:
    """The plant has executed the last segment and stands at the start joints again."""


@dataclass(frozen=True)
class Persisted:
    """Non-volatile memory holds this, and would after a loss of power."""

    memory: Memory


@dataclass(frozen=True)
class PersistFailed:
    """Non-volatile memory could not be written; it holds what it held, or what it was to hold."""


@dataclass(frozen=True)
class Tick:
    """Time passes."""


@dataclass(frozen=True)
class Awaiting:
    """A request that passed every rule and is carried out, or answered, once ``memory`` is durable."""

    event: StartReceived | ResetReceived | WithdrawReceived
    memory: Memory


Event = (
    OpenReceived
    | CollectReceived
    | PathChecked
    | NonceRequested
    | PermitReceived
    | StartReceived
    | ResetReceived
    | AcknowledgeReceived
    | WithdrawReceived
    | HeartbeatReceived
    | HeartbeatLost
    | StopReceived
    | FaultArisen
    | InputsChanged
    | BoneMoved
    | LimitsChanged
    | JointsMeasured
    | PathFinished
    | Persisted
    | PersistFailed
    | Tick
)


# ---------------------------------------------------------------- effects


@dataclass(frozen=True)
class Send:
    """A record to the runtime; ``session`` is the tag it is sent under."""

    record: records.Record
    session: int


@dataclass(frozen=True)
class SendFault:
    """A fault frame, at once."""

    code: FaultCode
    cause: StopCause


@dataclass(frozen=True)
class OpenLink:
    """Records and single frames carry this session's tag and codes from now on."""

    session: ControllerSession


@dataclass(frozen=True)
class CloseLink:
    """No session: single frames are ignored, announcements go out."""


@dataclass(frozen=True)
class AbortTransfers:
    """Void every transfer in progress, both directions."""


@dataclass(frozen=True)
class Persist:
    """Write non-volatile memory once everything before has left; answered by Persisted or PersistFailed."""

    memory: Memory


Effect = Send | SendFault | OpenLink | CloseLink | AbortTransfers | Persist
