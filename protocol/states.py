"""The codes and enumerations both sides of the bus share.

The codes of stop and fault frames, which nothing but a CRC protects, are code words of the first-order Reed-Muller code
RM(1, 4): any two of them, and each of them and 0x0000 or 0xFFFF, differ in at least eight bits, so that no small
corruption turns one into another. What the heartbeats say is covered by their tag.
"""

from enum import IntEnum, unique
from typing import Final

EPOCHS: Final = 32
"""The epoch, which counts stops, is taken modulo this: it has five bits in every heartbeat, a byte in records."""


@unique
class RuntimeCode(IntEnum):
    """What the runtime's heartbeat asks for, three bits. The controller moves only while the last fresh one says CUT."""

    INHIBIT = 1
    READY = 2
    CUT = 4


@unique
class ControllerState(IntEnum):
    """What the controller's heartbeat reports, three bits; 0 is never sent."""

    INHIBITED = 1
    """No session: power-up, or a stop ended it."""
    OPEN = 2
    """A session is open; no path is stored."""
    LOADED = 3
    """A path is stored whole and has passed the controller's own checks."""
    PERMITTED = 4
    """Cutting mode: the cutter may spin up. No motion."""
    CUTTING = 5
    """The arm moves along the stored path."""
    DONE = 6
    """The path's end was reached; cutting mode is off."""
    FAULT = 7
    """Latched; left only by an authenticated reset after the cause was acknowledged."""


@unique
class StopCode(IntEnum):
    """What a runtime stop frame asks for. Anything else on that identifier stops as well."""

    STOP = 0x55AA
    """Protective stop: permit, nonces and transfers are void."""
    END = 0x3CC3
    """Orderly end of a session. While the arm moves it is a STOP."""


@unique
class FaultCode(IntEnum):
    """What a controller fault frame reports."""

    STOPPED = 0x6699
    """A protective stop; a new session may be opened."""
    LATCHED = 0x5AA5
    """A latched fault; see ControllerState.FAULT."""


@unique
class StopCause(IntEnum):
    """Why motion is inhibited. Five bits: it travels in every controller heartbeat until acknowledged."""

    NONE = 0
    OPERATOR_STOP = 1
    OPERATOR_QUIT = 2
    EMERGENCY_STOP = 3
    DEVICE_RELEASED = 4
    HEARTBEAT_LOST = 5
    SEQUENCE_ERROR = 6
    CORRUPTION = 7
    LOOP_STALLED = 8
    SECOND_NODE = 9
    LIMITS_CHANGED = 10
    CALIBRATION_CHANGED = 11
    PATH_CHANGED = 12
    REGISTRATION_WITHDRAWN = 13
    BONE_MOVED = 14
    PEER_REBOOTED = 15
    TRACKING_DEVIATION = 16
    AUDIT_FAILED = 17
    LIMIT_EXCEEDED = 18
    TRANSFER_FAILED = 19
    PROTOCOL_VIOLATION = 20
    AUTHENTICATION_FAILED = 21
    PERMIT_EXPIRED = 22
    INTERNAL_ERROR = 23
    BUS_FAILED = 24
    NOT_ADMITTED = 25
    SESSION_ENDED = 26


LATCHING = frozenset(
    {
        StopCause.SECOND_NODE,
        StopCause.AUDIT_FAILED,
        StopCause.AUTHENTICATION_FAILED,
        StopCause.INTERNAL_ERROR,
        StopCause.LIMIT_EXCEEDED,
    }
)
"""Causes that latch: only acknowledge and then an authenticated reset leave them."""

WITHDRAWING = frozenset({StopCause.REGISTRATION_WITHDRAWN, StopCause.BONE_MOVED})
"""Causes after which the registration may never be permitted again, where only a holder of the key can have said so."""


def claimable(cause: StopCause) -> StopCause:
    """What a stop frame of the runtime says of a cause, for it carries no code: never that something is withdrawn.

    That is told by the heartbeat and by Withdraw. So a stop frame that names it is a stranger's.
    """
    return StopCause.OPERATOR_STOP if cause in WITHDRAWING else cause


@unique
class Purpose(IntEnum):
    """What a nonce was asked for; it serves for nothing else."""

    PERMIT = 1
    START = 2
    RESET = 3


@unique
class Refusal(IntEnum):
    """The controller's answer to a request: accepted, or the first reason against it."""

    ACCEPTED = 0
    PROTOCOL_VERSION = 1
    SESSION_IN_USE = 2
    TIMING_OUT_OF_BOUNDS = 3
    ANNOUNCE_NONCE = 4
    WRONG_SESSION = 5
    WRONG_SERIAL = 6
    NOT_IN_STATE = 7
    VOIDED_BY_STOP = 8
    LATCHED_FAULT = 9
    UNACKNOWLEDGED_STOP = 10
    HEARTBEAT_STALE = 11
    EMERGENCY_STOP = 12
    NO_NONCE = 13
    NONCE_MISMATCH = 14
    NONCE_EXPIRED = 15
    MAC_INVALID = 16
    EPOCH = 17
    NO_PERMIT = 18
    PERMIT_EXPIRED = 19
    LIMITS_DIGEST = 20
    CALIBRATION_DIGEST = 21
    TOOL_DIGEST = 22
    PATH_DIGEST = 23
    REGISTRATION_DIGEST = 24
    CONFIGURATION_DIGEST = 25
    VERIFIER = 26
    REGISTRATION_WITHDRAWN = 27
    START_JOINTS = 28
    BRANCH = 29
    DEVICE_NOT_RELEASED_AND_PRESSED = 30
    NOT_AT_START = 31
    PATH_MALFORMED = 32
    POSE_OUTSIDE_LIMITS = 33
    WRONG_ELBOW = 34
    TOOL_LENGTH = 35
    JOINTS_BEYOND_WIRE = 36
    PERMIT_MISMATCH = 37
    APPROACH = 38
    APPROACH_SPEED = 39
    WRONG_CAUSE = 40
    MEMORY_FULL = 41
    MEMORY_FAILED = 42
    IDENTITY_DIGEST = 43
    WITHDRAWAL_DUE = 44
    REGISTRATION_TOO_EARLY = 45
    LOG_NOT_CONTINUED = 46
