"""The records of the conversation: announce, open, upload, nonce, permit, start, reset, replies.

A sound session, in its order (``>`` from the runtime, ``<`` from the controller; heartbeats go on beside it)::

    <  Announce                                outside a session, again and again
    >  Open, signed                            <  Opened, signed, with the tag of the session; or Reply: why not
    >  Collect                                 <  Limits, Calibration, Tool
    >  PathBlock, one after the other          <  BlockStored for each, then PathStored with the digest
    >  NonceRequest(PERMIT)                    <  Nonce, with the epoch
    >  Permit, signed                          <  Reply
    >  NonceRequest(START)                     <  Nonce
    >  Start, signed                           <  Reply

A request is answered by one Reply that names its type and sequence. ``Acknowledge``, signed, says that the operator has
seen the cause that stands; ``Reset``, signed under a nonce of its own, leaves a latched fault; ``Withdraw``, signed, makes
a registration one that may never be permitted again. A stop voids every nonce and permit and starts a new epoch, so that
the next request begins with its NonceRequest again.

What is signed carries a code that only a holder of the key can make (``codes``); everything else may be anybody's. So a
Reply, a receipt and a Nonce enable nothing: that a permit, a start or a reset was accepted is believed by the heartbeat.

Every record checks itself when it is made, so one that exists can be sent, and ``parse`` gives it back or raises
:class:`RecordError`; the endpoint fills in the code of a signed one::

    >>> from cutgate.protocol.states import Purpose
    >>> request = NonceRequest(Purpose.START)
    >>> request.body().hex(), NonceRequest.parse(request.body()) == request
    ('02', True)
    >>> Acknowledge(epoch=0, cause=99)
    Traceback (most recent call last):
    cutgate.protocol.wire.RecordError: ...
"""

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Final, Self

from cutgate.protocol.path import TURNS_MAX, ElbowCode
from cutgate.protocol.states import ControllerState, Refusal, StopCause
from cutgate.protocol.wire import (
    I16,
    I64,
    U8,
    U16,
    U32,
    U64,
    Ascii16,
    Block,
    CauseCode,
    Channel,
    Counts5,
    Digest32,
    Flag,
    LogId16,
    Mac16,
    Nested,
    Nonce16,
    PurposeCode,
    Record,
    RecordError,
    RefusalCode,
    Side,
    StateCode,
    digest,
)

PROTOCOL_VERSION = 4

PLANT_SPEED_PERMILLE_MAX = 1_000_000

NO_MAC = bytes(16)
"""Stands in a record that is not signed yet."""
NO_TIME: Final = 0
"""Stands for the time of a registration that has none."""
AGE_UNKNOWN: Final = 0xFFFF_FFFF
"""Nobody knows how long ago it was."""


@dataclass(frozen=True)
class OtherVersion(Record):
    """An Announce or Open of another protocol version, of which nothing but the version was read."""

    TYPE: ClassVar[int] = 0
    SENDER: ClassVar[Side] = Side.CONTROLLER
    CHANNEL: ClassVar[Channel] = Channel.CONTROL

    request_type: U8
    protocol_version: U16


@dataclass(frozen=True)
class Announce(Record):
    """The controller is there: who it is and which boot this is."""

    TYPE: ClassVar[int] = 0x01
    SENDER: ClassVar[Side] = Side.CONTROLLER
    CHANNEL: ClassVar[Channel] = Channel.CONTROL
    OUTSIDE_SESSION: ClassVar[bool] = True
    INSIDE_SESSION: ClassVar[bool] = False

    protocol_version: U16
    firmware_version: Ascii16
    serial: Ascii16
    announce_nonce: Nonce16
    """New at power-up and with every session that was opened: an OPEN that names it opens once."""
    plant_speed_permille: U32
    """Seconds of the plant in 1000 of the clock: 1000 on a real controller, anything else only in simulation."""
    state: StateCode
    cause: CauseCode

    @property
    def identity_digest(self) -> bytes:
        """What never changes while the controller is powered, for OPEN to name, since this record carries no code.

        SHA-256 of the body with nonce, state and cause as after a first power-up, 32 bytes.
        """
        lasting = replace(
            self, announce_nonce=bytes(16), state=ControllerState.INHIBITED, cause=StopCause.NONE
        )
        return digest(b"cutgate/identity/1" + lasting.body())

    @property
    def time_scale(self) -> float:
        """Seconds of the plant in one of the clock."""
        return self.plant_speed_permille / 1000

    def check(self) -> None:
        """Refuse a plant that stands still or runs faster than any simulation may."""
        if not 1 <= self.plant_speed_permille <= PLANT_SPEED_PERMILLE_MAX:
            raise RecordError(
                f"Announce.plant_speed_permille is {self.plant_speed_permille}, "
                f"must be in 1..{PLANT_SPEED_PERMILLE_MAX}"
            )


@dataclass(frozen=True)
class Timing(Block):
    """The constants both sides must agree on; the controller refuses values outside its own bounds.

    Kept by both sides as it stands on the wire, and read in the units that each name says.
    """

    heartbeat_ms: U16
    timeout_ms: U16
    permit_lifetime_s: U16
    start_lifetime_ms: U16
    start_tolerance_um: U16
    start_tolerance_mdeg: U16
    approach_clearance_um: U32
    approach_speed_percent: U16

    @property
    def heartbeat_s(self) -> float:
        """Period of both sides' heartbeats."""
        return self.heartbeat_ms / 1000

    @property
    def timeout_s(self) -> float:
        """Without a fresh heartbeat for so long the gate closes."""
        return self.timeout_ms / 1000

    @property
    def start_lifetime_s(self) -> float:
        """From the start's nonce to START."""
        return self.start_lifetime_ms / 1000

    @property
    def start_tolerance_mm(self) -> float:
        """Wrist centre off the bound start joints."""
        return self.start_tolerance_um / 1000

    @property
    def start_tolerance_deg(self) -> float:
        """Rotary joints off the bound start joints."""
        return self.start_tolerance_mdeg / 1000

    @property
    def approach_clearance_mm(self) -> float:
        """Entry and exit pose beyond everything that is cut."""
        return self.approach_clearance_um / 1000


@dataclass(frozen=True)
class SignedRecord(Record):
    """A record whose last field is its message authentication code."""

    DOMAIN: ClassVar[bytes]

    def canonical(self, session_digest: bytes = b"", sequence: int | None = None) -> bytes:
        """What is signed: the domain's name, a zero byte, session and sequence, and the body without its code.

        Args:
            session_digest: 32 bytes; empty for OPEN, which has no session yet.
            sequence: with which it is sent; None for OPEN.
        """
        counted = b"" if sequence is None else sequence.to_bytes(4, "little")
        return self.DOMAIN + b"\0" + session_digest + counted + self.body()[: -len(NO_MAC)]

    @property
    def code(self) -> bytes:
        """The message authentication code, 16 bytes."""
        return self.body()[-len(NO_MAC) :]

    def with_mac(self, mac: bytes) -> Self:
        """The same record with this code."""
        return replace(self, mac=mac)  # type: ignore[call-arg]


@dataclass(frozen=True)
class TreeHead(Block):
    """How far an audit log was, by its hash tree (RFC 6962): what the controller keeps of it as its witness."""

    log_id: LogId16
    size: U64
    """Records of the log; 0 where there is none."""
    root: Digest32


NO_TREE_HEAD: Final = TreeHead(bytes(16), 0, bytes(32))
"""Stands where no log is named."""


@dataclass(frozen=True)
class Open(SignedRecord):
    """The runtime asks for a session, and names all that it holds for. It opens once, for the announce nonce is used up."""

    TYPE: ClassVar[int] = 0x02
    SENDER: ClassVar[Side] = Side.RUNTIME
    CHANNEL: ClassVar[Channel] = Channel.CONTROL
    OUTSIDE_SESSION: ClassVar[bool] = True
    INSIDE_SESSION: ClassVar[bool] = False
    DOMAIN: ClassVar[bytes] = b"cutgate/open/1"

    protocol_version: U16
    announce_nonce: Nonce16
    runtime_nonce: Nonce16
    identity_digest: Digest32
    registration_digest: Digest32
    place_digest: Digest32
    """Of the registration's transform alone: another id or time does not bring back what was withdrawn."""
    registration_time_us: I64
    """Since 1970, UTC; NO_TIME for a registration without one."""
    configuration_digest: Digest32
    verifier_version: Ascii16
    timing: Annotated[Timing, Nested(Timing)]
    mac: Mac16 = NO_MAC


@dataclass(frozen=True)
class Opened(SignedRecord):
    """The session is open; sent with its tag. A refusal is a Reply.

    `log` is that of the last start that was accepted. `withdrawal_due` says that the bone moved, or that a registration
    was withdrawn, and that no Withdraw has told the barrier yet; `motion_age_s`, whole seconds, how long ago that was.
    `registration` is what the controller's own list says of the registration that OPEN names, `barrier_us` its barrier.
    """

    TYPE: ClassVar[int] = 0x03
    SENDER: ClassVar[Side] = Side.CONTROLLER
    CHANNEL: ClassVar[Channel] = Channel.CONTROL
    DOMAIN: ClassVar[bytes] = b"cutgate/opened/1"

    epoch: U8
    state: StateCode
    cause: CauseCode
    log: Annotated[TreeHead, Nested(TreeHead)] = NO_TREE_HEAD
    withdrawal_due: Flag = 0
    motion_age_s: U32 = AGE_UNKNOWN
    registration: RefusalCode = Refusal.ACCEPTED
    barrier_us: I64 = NO_TIME
    mac: Mac16 = NO_MAC


@dataclass(frozen=True)
class Collect(Record):
    """Asks for Limits, Calibration and Tool, which come on the bulk channel."""

    TYPE: ClassVar[int] = 0x04
    SENDER: ClassVar[Side] = Side.RUNTIME
    CHANNEL: ClassVar[Channel] = Channel.CONTROL


@dataclass(frozen=True)
class BlockStored(Record):
    """The controller has stored this block; the next one may come."""

    TYPE: ClassVar[int] = 0x21
    SENDER: ClassVar[Side] = Side.CONTROLLER
    CHANNEL: ClassVar[Channel] = Channel.BULK

    index: U16


@dataclass(frozen=True)
class PathStored(Record):
    """The digest of what the controller has stored, or its refusal and the pose that is at fault."""

    TYPE: ClassVar[int] = 0x22
    SENDER: ClassVar[Side] = Side.CONTROLLER
    CHANNEL: ClassVar[Channel] = Channel.BULK

    digest: Digest32
    refusal: RefusalCode
    pose: U32


@dataclass(frozen=True)
class NonceRequest(Record):
    """Asks for a nonce; the new one voids the old."""

    TYPE: ClassVar[int] = 0x05
    SENDER: ClassVar[Side] = Side.RUNTIME
    CHANNEL: ClassVar[Channel] = Channel.CONTROL

    purpose: PurposeCode


@dataclass(frozen=True)
class Nonce(Record):
    """The controller's nonce, and the epoch in which it is good."""

    TYPE: ClassVar[int] = 0x06
    SENDER: ClassVar[Side] = Side.CONTROLLER
    CHANNEL: ClassVar[Channel] = Channel.CONTROL

    purpose: PurposeCode
    nonce: Nonce16
    epoch: U8


@dataclass(frozen=True)
class Branch(Block):
    """The joint branch in which the whole path stays."""

    elbow: ElbowCode
    q0_turns: I16
    roll_turns: I16

    def check(self) -> None:
        """Refuse turns no joint has."""
        for name, turns in (("q0_turns", self.q0_turns), ("roll_turns", self.roll_turns)):
            if not abs(turns) <= TURNS_MAX:
                raise RecordError(f"Branch.{name} is {turns}, must be within +-{TURNS_MAX}")


@dataclass(frozen=True)
class Approach(Block):
    """Between the start joints and the cut, there and back: joint line, then straight along the tool axis.

    The joints at entry and exit follow from the rest; they are bound so that both sides' kinematics must agree on
    the lines that were verified, full turns included.
    """

    entry_um: U32
    """The entry pose is so far from the first pose along its axis, toward the holder."""
    exit_um: U32
    """The exit pose likewise from the last pose."""
    entry_joints_u: Counts5
    exit_joints_u: Counts5
    speed_percent: U8
    """Of each joint's speed limit, on the joint lines."""

    def check(self) -> None:
        """Refuse a speed that is none or beyond the limits."""
        if not 1 <= self.speed_percent <= 100:
            raise RecordError(f"Approach.speed_percent is {self.speed_percent}, must be in 1..100")


@dataclass(frozen=True)
class Permit(SignedRecord):
    """The permission to enter cutting mode, for exactly what it names. `lifetime_s` runs from the nonce on.

    `start_joints_u` are the measured joints from which the approach was verified.
    """

    TYPE: ClassVar[int] = 0x07
    SENDER: ClassVar[Side] = Side.RUNTIME
    CHANNEL: ClassVar[Channel] = Channel.CONTROL
    DOMAIN: ClassVar[bytes] = b"cutgate/permit/1"

    nonce: Nonce16
    announce_nonce: Nonce16
    session_digest: Digest32
    serial: Ascii16
    protocol_version: U16
    epoch: U8
    limits_digest: Digest32
    calibration_digest: Digest32
    tool_digest: Digest32
    path_digest: Digest32
    registration_digest: Digest32
    configuration_digest: Digest32
    verifier_version: Ascii16
    start_joints_u: Counts5
    branch: Annotated[Branch, Nested(Branch)]
    approach: Annotated[Approach, Nested(Approach)]
    lifetime_s: U16
    log: Annotated[TreeHead, Nested(TreeHead)] = NO_TREE_HEAD
    """Up to the record that authorised this permit."""
    mac: Mac16 = NO_MAC

    @property
    def digest(self) -> bytes:
        """SHA-256 of domain and body without its code: what a Start names."""
        return digest(self.canonical())


@dataclass(frozen=True)
class Start(SignedRecord):
    """The order to cut under a permit."""

    TYPE: ClassVar[int] = 0x08
    SENDER: ClassVar[Side] = Side.RUNTIME
    CHANNEL: ClassVar[Channel] = Channel.CONTROL
    DOMAIN: ClassVar[bytes] = b"cutgate/start/1"

    nonce: Nonce16
    epoch: U8
    session_digest: Digest32
    permit_digest: Digest32
    start_joints_u: Counts5
    log: Annotated[TreeHead, Nested(TreeHead)] = NO_TREE_HEAD
    """Up to the record that authorised this start: the permit's log, further on. The controller is its witness."""
    mac: Mac16 = NO_MAC


@dataclass(frozen=True)
class Reset(SignedRecord):
    """Leaves a latched fault of this cause, after it was acknowledged. Starts nothing."""

    TYPE: ClassVar[int] = 0x09
    SENDER: ClassVar[Side] = Side.RUNTIME
    CHANNEL: ClassVar[Channel] = Channel.CONTROL
    DOMAIN: ClassVar[bytes] = b"cutgate/reset/1"

    nonce: Nonce16
    epoch: U8
    session_digest: Digest32
    cause: CauseCode
    mac: Mac16 = NO_MAC


@dataclass(frozen=True)
class Acknowledge(SignedRecord):
    """The operator has seen this cause, which stands since this epoch."""

    TYPE: ClassVar[int] = 0x0A
    SENDER: ClassVar[Side] = Side.RUNTIME
    CHANNEL: ClassVar[Channel] = Channel.CONTROL
    DOMAIN: ClassVar[bytes] = b"cutgate/acknowledge/1"

    epoch: U8
    cause: CauseCode
    mac: Mac16 = NO_MAC


@dataclass(frozen=True)
class Withdraw(SignedRecord):
    """The session's registration was withdrawn, or the bone has moved: only a registration later than the barrier counts.

    `place_digest` is that of the withdrawn place, zeros where none in particular is meant. Answered also in a session that
    a stop has voided.
    """

    TYPE: ClassVar[int] = 0x0B
    SENDER: ClassVar[Side] = Side.RUNTIME
    CHANNEL: ClassVar[Channel] = Channel.CONTROL
    DOMAIN: ClassVar[bytes] = b"cutgate/withdraw/1"

    place_digest: Digest32
    barrier_us: I64
    """Since 1970, UTC: when the runtime learned of it, and as much later as clocks may differ."""
    mac: Mac16 = NO_MAC


NO_PLACE: Final = bytes(32)
"""Stands for no place in particular."""


@dataclass(frozen=True)
class Reply(Record):
    """The controller's answer to a request, named by its type and sequence. Session 0 when none is open."""

    TYPE: ClassVar[int] = 0x0C
    SENDER: ClassVar[Side] = Side.CONTROLLER
    CHANNEL: ClassVar[Channel] = Channel.CONTROL
    OUTSIDE_SESSION: ClassVar[bool] = True

    request_type: U8
    request_sequence: U32
    refusal: RefusalCode
    cause: CauseCode
    detail: U32


def session_digest(request: Open) -> bytes:
    """What names a session: SHA-256 over its domain and the body of its OPEN without the code, 32 bytes.

    The code follows from the body and the key, and an OPEN with another one opens nothing: covering it as well would
    tell no two sessions apart that this does not.
    """
    return digest(b"cutgate/session/2" + request.body()[: -len(NO_MAC)])


def session_tag(named: bytes) -> int:
    """The first four bytes of the session's digest, little endian: virtual bytes of every single frame."""
    return int.from_bytes(named[:4], "little")


def opens(request: Open) -> bool:
    """Whether this OPEN may open a session: tag 0 means "no session", so the runtime draws another nonce."""
    return session_tag(session_digest(request)) != 0
