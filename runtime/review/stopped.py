"""After a stop: what stopped it, where the arm is, whether the stop is confirmed, and what to do next.

The running session and a log of it say the same: both come here with what they know. Nothing is decided.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from cutgate.protocol import records
from cutgate.protocol.frames import FRACTION_MAX
from cutgate.protocol.records import RecordError, joints_to_memory
from cutgate.protocol.states import StopCause
from cutgate.runtime.interlock.phases import MOVING
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.kinematics.arm import TrueArm

C = StopCause
WORDS: Final[dict[StopCause, str]] = {
    C.NONE: "Nobody named a cause.",
    C.OPERATOR_STOP: "The operator said stop.",
    C.OPERATOR_QUIT: "The operator left: quit, Ctrl-C, or a signal that ends programs.",
    C.EMERGENCY_STOP: "The emergency stop was pressed.",
    C.DEVICE_RELEASED: "The enabling device was released while the arm could move.",
    C.HEARTBEAT_LOST: "One side did not hear the other in time.",
    C.SEQUENCE_ERROR: "Frames on the bus were lost, repeated or out of order.",
    C.CORRUPTION: "Frames on the bus were damaged.",
    C.LOOP_STALLED: "A program stood still for longer than the time-out: its computer was too busy, or it was suspended.",
    C.SECOND_NODE: "Somebody else spoke on the bus in the name of one side.",
    C.LIMITS_CHANGED: "The controller's joint limits are no longer those that were verified.",
    C.CALIBRATION_CHANGED: "The controller's calibration or tool is no longer what was verified.",
    C.PATH_CHANGED: "The path that the controller holds is no longer the verified one.",
    C.REGISTRATION_WITHDRAWN: "The registration was withdrawn.",
    C.BONE_MOVED: "The bone has moved.",
    C.PEER_REBOOTED: "The controller started anew during the session.",
    C.TRACKING_DEVIATION: "The arm was not where the verified path allows.",
    C.AUDIT_FAILED: "The audit log could not be written any more.",
    C.LIMIT_EXCEEDED: "The controller found a joint beyond its limits.",
    C.TRANSFER_FAILED: "An exchange with the controller did not come to its end.",
    C.PROTOCOL_VIOLATION: "One side did what the protocol does not allow.",
    C.AUTHENTICATION_FAILED: "A message's code did not fit: the two sides hold different keys, or somebody else sent it.",
    C.PERMIT_EXPIRED: "Nobody started within the permit's lifetime.",
    C.INTERNAL_ERROR: "A program itself failed.",
    C.BUS_FAILED: "The bus failed.",
    C.NOT_ADMITTED: "The session was not admitted.",
    C.SESSION_ENDED: "The session had ended.",
}
"""What stopped it, in plain words."""

PRIORITY: Final = "give the program its priority (docs/timing.md)"
BUS: Final = (f"Look at cable, termination and power of the bus; on a busy computer {PRIORITY}.",)
REGISTER: Final = ("Register the bone anew: this registration is never permitted again.",)
APPROVE: Final = ("Compare the controller's settings with robot.toml, and approve the right ones.",)
MAKER: Final = ("Keep the log, and show it to whoever maintains the program.",)
NEXT: Final[dict[StopCause, tuple[str, ...]]] = {
    C.NONE: MAKER,
    C.OPERATOR_STOP: ("Find out why stop was said.",),
    C.OPERATOR_QUIT: (),
    C.EMERGENCY_STOP: ("Find out why it was pressed; release it once that is cured.",),
    C.DEVICE_RELEASED: (
        "Hold the enabling device for the whole cut; if nobody let go, look at it and its cable.",
    ),
    C.HEARTBEAT_LOST: BUS,
    C.SEQUENCE_ERROR: BUS,
    C.CORRUPTION: BUS,
    C.LOOP_STALLED: (f"End what else keeps the computer busy, or {PRIORITY}.",),
    C.SECOND_NODE: ("Find whatever else sends on this bus, and take it off.",),
    C.LIMITS_CHANGED: APPROVE,
    C.CALIBRATION_CHANGED: APPROVE,
    C.PATH_CHANGED: ("Find out who else writes to the controller.",),
    C.REGISTRATION_WITHDRAWN: REGISTER,
    C.BONE_MOVED: ("Fix the bone.", *REGISTER),
    C.PEER_REBOOTED: ("Look at the controller's power supply.",),
    C.TRACKING_DEVIATION: ("Look at drives, brakes and load of the joint that the reason names.",),
    C.AUDIT_FAILED: (
        "Look at what the reason names: free or replace the disk of the log directory, or keep others out of it.",
    ),
    C.LIMIT_EXCEEDED: ("Look at the drives; move the arm inside its limits by the controller's own means.",),
    C.TRANSFER_FAILED: (*BUS, "Where the reason names a setting, compare it on both sides."),
    C.PROTOCOL_VIOLATION: MAKER,
    C.AUTHENTICATION_FAILED: (
        "Give both sides the same key file; if they have it, find who else sends on this bus.",
    ),
    C.PERMIT_EXPIRED: ("Have the enabling device at hand, and say start in time.",),
    C.INTERNAL_ERROR: MAKER,
    C.BUS_FAILED: ("Look at the bus's interface and its cable, and bring it up again.",),
    C.NOT_ADMITTED: (),
    C.SESSION_ENDED: (),
}
"""What to do about each cause."""


@dataclass(frozen=True)
class Stopped:
    """What is known of a stop.

    Attributes:
        cause: first-out.
        reason: what was found.
        phase: of the session as it was stopped.
        at_rest: the controller's last heartbeat says that it inhibits motion.
        latched: it says that this is a latched fault.
        standing: the cause that it carries until somebody acknowledges it.
        progress: segment and counts of 1/65535 of it, as last reported.
        joints_u: last measured reported joints, 1e-6 deg | mm.
    """

    cause: StopCause
    reason: str
    phase: str
    at_rest: bool
    latched: bool
    standing: StopCause
    progress: tuple[int, int] | None = None
    joints_u: tuple[int, ...] | None = None


@dataclass(frozen=True)
class Way:
    """What the arm was to do, as bound by the permit: record bytes, and how far the entry lies beyond the first pose."""

    path: bytes
    calibration: bytes
    tool: bytes
    entry_um: int


def stop_document(stopped: Stopped, permitted: Way | None) -> dict[str, Any]:
    """What is told after a stop.

    Args:
        stopped: what is known.
        permitted: None where nothing was permitted, or its records cannot be had.
    """
    place = _place(stopped, permitted) if stopped.phase in MOVING else None
    return {
        "cause": stopped.cause.name,
        "text": WORDS[stopped.cause],
        "reason": stopped.reason,
        "while": stopped.phase,
        "moving": stopped.phase in MOVING,
        "where": place,
        "confirmed": stopped.at_rest,
        "next": [*_safe(stopped), *_withdraw(place), *NEXT[stopped.cause], *_again(stopped)],
    }


SAFE: Final = (
    "Release the enabling device.",
    "Press the emergency stop: nobody has confirmed that the arm stands.",
)
"""What comes before everything else where nobody has confirmed the stop."""


def _safe(stopped: Stopped) -> tuple[str, ...]:
    if stopped.at_rest:
        return ()
    return SAFE if stopped.phase in MOVING else SAFE[:1]


DEPTH_LEAST_MM: Final = 0.05
"""What is less is shown as 0.0."""
OUT: Final = "withdraw it along its axis by the controller's own means, before anything else."


def _withdraw(place: dict[str, Any] | None) -> tuple[str, ...]:
    """Before and after the cut the arm may be beside the bone, on a joint line: there its axis leads anywhere."""
    depth_mm = place and place["depth_mm"]
    if not place or not depth_mm or depth_mm < DEPTH_LEAST_MM:
        return ()
    if place["leg"] == CUT:
        return (f"The tip is {depth_mm:.1f} mm below the entry plane: the tool is in the bone, {OUT}",)
    on = {APPROACH: "The arm was on its approach", RETRACT: "The path is cut and the arm was on its retract"}
    return (
        f"{on.get(place['leg'], 'It is not known how far the arm came')}: if the tool is in the bone, {OUT}",
    )


def _again(stopped: Stopped) -> tuple[str, ...]:
    """A new session is needed after every stop; what it must say first depends on the controller."""
    whole = "; it cuts the path from its beginning" if stopped.phase in MOVING else ""
    if stopped.standing is StopCause.NONE and stopped.latched:
        return (f"Start a new session and say reset{whole}.",)
    if stopped.standing is StopCause.NONE:
        asked = "" if stopped.at_rest else "; say acknowledge, and reset, when it asks for them"
        return (f"Start a new session{whole}{asked}.",)
    acts = "say acknowledge, then reset" if stopped.latched else "say acknowledge"
    return (f"Start a new session and {acts}{whole}.",)


def _place(stopped: Stopped, permitted: Way | None) -> dict[str, Any] | None:
    if permitted is None:
        return None
    try:
        path = records.Path.parse(permitted.path)
        calibration, tool = (
            records.Calibration.parse(permitted.calibration),
            records.Tool.parse(permitted.tool),
        )
    except RecordError:
        return None
    done = _done(path, stopped.progress)
    tip = _tip(path, calibration, tool, permitted.entry_um, stopped.joints_u)
    return {"leg": _leg(stopped, len(path) - 1), **done, **tip}


APPROACH, CUT, RETRACT = "approach", "cut", "retract"


def _leg(stopped: Stopped, segments: int) -> str | None:
    """Which part of its way the arm was on: progress stands at the path's first point on the approach, then at its last.

    None where no progress of this path was reported although the arm may be on it.
    """
    progress = stopped.progress
    if stopped.phase == Phase.FINISHING or progress == (segments - 1, FRACTION_MAX):
        return RETRACT
    if stopped.phase == Phase.STARTING or progress == (0, 0):
        return APPROACH
    return CUT if progress is not None and 0 <= progress[0] < segments else None


def _done(path: records.Path, progress: tuple[int, int] | None) -> dict[str, Any]:
    """How much of the tip's path is cut, as the controller reported it."""
    lengths = np.linalg.norm(np.diff(path.tips_mm, axis=0), axis=1)
    segments = len(lengths)
    if progress is None or not 0 <= progress[0] < segments:
        return dict.fromkeys(("segment", "percent", "to_go_mm")) | {"segments": segments}
    segment, part = progress[0], progress[1] / FRACTION_MAX
    whole, to_go = float(lengths.sum()), float(lengths[segment + 1 :].sum() + (1.0 - part) * lengths[segment])
    done = 1.0 - to_go / whole if whole > 0.0 else (segment + part) / segments
    return {"segment": segment, "segments": segments, "percent": 100.0 * done, "to_go_mm": to_go}


def _tip(
    path: records.Path,
    calibration: records.Calibration,
    tool: records.Tool,
    entry_um: int,
    joints_u: tuple[int, ...] | None,
) -> dict[str, Any]:
    """The tip by the measured joints, and how far it is below the plane through the entry, along the first pose's tool."""
    if joints_u is None:
        return {"tip_mm": None, "depth_mm": None}
    arm = TrueArm(
        calibration.upper_mm + calibration.upper_link_error_mm,
        calibration.forearm_mm + calibration.forearm_link_error_mm,
        1.0 if path.elbow == "right" else -1.0,
        calibration.joint_offset,
        calibration.slide_tilt,
    )
    (tip,), _ = arm.pose(joints_to_memory(joints_u)[None], tool.length_mm)
    axis = path.axes[0]
    entry = path.tips_mm[0] + axis * entry_um / 1000.0
    return {"tip_mm": [float(value) for value in tip], "depth_mm": float((entry - tip) @ axis)}
