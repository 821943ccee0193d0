"""What the simulated controller remembers, what can happen to it and what it answers."""

from dataclasses import dataclass, field
from enum import Enum, auto

from firmware_sim.approach import Ends
from protocol import records
from protocol.states import ControllerState, FaultCode, Purpose, Refusal, RuntimeCode, StopCause, StopCode


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
class Session:
    """One session with one runtime. ``live`` is false once a stop has voided it."""

    tag: int
    digest: bytes
    registration: bytes
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
    session: Session | None = None
    issued: Issued | None = None
    permit: records.Permit | None = None
    permit_issued_at_s: float = 0.0
    device: DeviceCycle = DeviceCycle.UNSEEN
    cut_ordered: bool = False
    """The runtime's heartbeat has said CUT since the start; without it nothing moves."""
    started_at_s: float = 0.0
    heartbeat_fresh: bool = False
    measured_u: tuple[int, ...] | None = None
    """Reported joints, 1e-6 deg | mm; None until measured since the last stop."""
    withdrawn: frozenset[bytes] = frozenset()
    """Digests of registrations that may never be permitted again; survives reboots."""
    last_registration: bytes | None = None

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
    """A checked runtime heartbeat. ``fresh`` is the link's word: its echo proves that it is young."""

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
class Fault:
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
class Tick:
    """Time passes."""


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
    | Fault
    | InputsChanged
    | BoneMoved
    | LimitsChanged
    | JointsMeasured
    | PathFinished
    | Tick
)


# ---------------------------------------------------------------- effects


@dataclass(frozen=True)
class Send:
    """A record to the runtime; ``session`` is the tag it is sent under."""

    record: records.Record
    session: int
    bulk: bool = False


@dataclass(frozen=True)
class SendFault:
    """A fault frame, at once."""

    code: FaultCode
    cause: StopCause


@dataclass(frozen=True)
class OpenLink:
    """Single frames are protected with this session tag from now on."""

    session: Session


@dataclass(frozen=True)
class CloseLink:
    """No session: single frames are ignored, announcements go out."""


@dataclass(frozen=True)
class AbortTransfers:
    """Void every transfer in progress, both directions."""


@dataclass(frozen=True)
class Persist:
    """Write the withdrawn list to non-volatile memory before the next event is looked at."""

    withdrawn: frozenset[bytes]


Effect = Send | SendFault | OpenLink | CloseLink | AbortTransfers | Persist
