"""What the simulated controller remembers, what can happen to it and what it answers."""

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
    """What makes this controller this one, for as long as it is powered."""

    serial: str
    key: bytes
    boot_nonce: bytes
    protocol_version: int = records.PROTOCOL_VERSION


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
        named: digests of all registrations that accepted OPENs have named since the bone last moved. An OPEN carries
            no key, so that the last one alone could have been anybody's.
        withdrawn: digests of registrations that may never be permitted again.
        latched: the first-out cause of a latched fault, NONE without one.
    """

    named: frozenset[bytes] = frozenset()
    withdrawn: frozenset[bytes] = frozenset()
    latched: StopCause = StopCause.NONE

    def naming(self, registration: bytes) -> "Memory":
        """With this registration named, unless it is known already."""
        known = registration in self.named | self.withdrawn
        return self if known else replace(self, named=self.named | {registration})

    @property
    def all_withdrawn(self) -> "Memory":
        """Every registration that was named is withdrawn."""
        return replace(self, named=frozenset(), withdrawn=self.withdrawn | self.named)


@dataclass(frozen=True)
class ControllerSession:
    """One session with one runtime. ``live`` is false once a stop has voided it."""

    tag: int
    digest: bytes
    registration: bytes
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
    memory: Memory = Memory()
    """What must not be forgotten, from the moment in which it happens."""
    written: Memory | None = None
    """What non-volatile memory is known to hold; where it differs, it is written again and again."""
    awaiting: "Awaiting | None" = None
    """The request whose answer waits for non-volatile memory."""

    @classmethod
    def powered_up(cls, identity: Identity, holdings: Holdings, memory: Memory) -> Self:
        """At power-up, with what non-volatile memory holds: a fault that was latched still is."""
        latched = memory.latched is not StopCause.NONE
        state = ControllerState.FAULT if latched else ControllerState.INHIBITED
        return cls(identity, holdings, state, memory.latched, memory=memory, written=memory)

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


# ---------------------------------------------------------------- events


@dataclass(frozen=True)
class OpenReceived:
    """A runtime asks for a session; ``session`` is what it would be."""

    request: records.Open
    sequence: int


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
    """A permit, not yet believed."""

    permit: records.Permit
    sequence: int


@dataclass(frozen=True)
class StartReceived:
    """A start, not yet believed."""

    start: records.Start
    sequence: int


@dataclass(frozen=True)
class ResetReceived:
    """A reset, not yet believed."""

    reset: records.Reset
    sequence: int


@dataclass(frozen=True)
class AcknowledgeReceived:
    """The operator has seen the cause."""

    cause: StopCause
    sequence: int


@dataclass(frozen=True)
class HeartbeatReceived:
    """A checked runtime heartbeat. ``fresh``: its echo proves to the link that it is young."""

    code: RuntimeCode
    epoch: int
    cause: StopCause
    fresh: bool


@dataclass(frozen=True)
class HeartbeatLost:
    """No fresh heartbeat within the time-out."""


@dataclass(frozen=True)
class StopReceived:
    """A stop frame; a malformed one counts as STOP."""

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
    """A request that passed every rule and is answered once ``memory`` is durable."""

    event: OpenReceived | ResetReceived
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
    """Single frames are protected with this session tag from now on."""

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
