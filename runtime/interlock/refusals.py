"""What the controller's refusals mean to the operator, and what to do: a sentence for each code."""

from types import MappingProxyType
from typing import Final

from cutgate.protocol.states import Refusal

_ANEW: Final = "start a new session"
_CHANGED: Final = f"changed in the controller since this session read or stored it: {_ANEW}"
_OTHERWISE: Final = f"is not the one that this session was opened with: {_ANEW}"
_STOPPED: Final = f"a stop came in between: {_ANEW}"

MEANING: Final = MappingProxyType(
    {
        Refusal.ACCEPTED: f"it says so and opens none: {_ANEW}",
        Refusal.PROTOCOL_VERSION: "use a controller and a runtime of the same protocol version",
        Refusal.SESSION_IN_USE: "it is in another session: end that one first",
        Refusal.TIMING_OUT_OF_BOUNDS: "its own bounds are narrower than what site.toml asks for: take timing, lifetimes, "
        "tolerances and approach from the controller's data",
        Refusal.ANNOUNCE_NONCE: f"it has started anew, or opened a session, since it announced itself: {_ANEW}",
        Refusal.WRONG_SESSION: f"this belongs to another session: {_ANEW}",
        Refusal.WRONG_SERIAL: "another controller answers than the one that announced itself: leave one on the bus",
        Refusal.NOT_IN_STATE: f"its state does not allow this: {_ANEW}",
        Refusal.VOIDED_BY_STOP: _STOPPED,
        Refusal.LATCHED_FAULT: f"a fault is latched: {_ANEW}, say acknowledge, then reset",
        Refusal.UNACKNOWLEDGED_STOP: "its stop is not acknowledged: say acknowledge first, in a new session if this one ends",
        Refusal.HEARTBEAT_STALE: "it does not hear this computer in time: check the bus, and what else runs here",
        Refusal.EMERGENCY_STOP: "the emergency stop is still pressed: release it, then try again",
        Refusal.NO_NONCE: f"it has given no nonce for this: {_ANEW}",
        Refusal.NONCE_MISMATCH: f"it has given another nonce since: {_ANEW}",
        Refusal.NONCE_EXPIRED: "the record was durable too late: try again; if it stays so, the log directory's disk is slow",
        Refusal.MAC_INVALID: "the two key files differ: compare what `cutgate key fingerprint FILE` says on both sides, "
        "and give both the same file",
        Refusal.EPOCH: _STOPPED,
        Refusal.NO_PERMIT: f"it holds no permit: {_ANEW}",
        Refusal.PERMIT_EXPIRED: f"the permit is older than permit_lifetime_s: {_ANEW}",
        Refusal.LIMITS_DIGEST: f"a joint limit {_CHANGED}",
        Refusal.CALIBRATION_DIGEST: f"the calibration {_CHANGED}",
        Refusal.TOOL_DIGEST: f"the tool {_CHANGED}",
        Refusal.PATH_DIGEST: f"the path {_CHANGED}; if it stays so, have its memory looked at",
        Refusal.REGISTRATION_DIGEST: f"the registration {_OTHERWISE}",
        Refusal.CONFIGURATION_DIGEST: f"the configuration {_OTHERWISE}",
        Refusal.VERIFIER: f"the verifier {_OTHERWISE}",
        Refusal.REGISTRATION_WITHDRAWN: "this registration was withdrawn: register the bone anew",
        Refusal.START_JOINTS: f"the arm has moved since it was verified: leave it at rest and {_ANEW}",
        Refusal.BRANCH: f"the joint branch is not that of its path: {_ANEW}",
        Refusal.DEVICE_NOT_RELEASED_AND_PRESSED: "release the enabling device, then hold it, then say start",
        Refusal.NOT_AT_START: f"the arm has moved since the permit: move it back to where it stood, or {_ANEW}",
        Refusal.PATH_MALFORMED: f"it could not read the path: {_ANEW}; if it stays so, compare the versions of both sides",
        Refusal.POSE_OUTSIDE_LIMITS: "move the bone so that every pose lies inside the controller's limits, then register "
        "and verify again",
        Refusal.WRONG_ELBOW: "its elbow is on the other side: correct elbow in robot.toml, or name this robot's file",
        Refusal.TOOL_LENGTH: "the path is made for another tool: mount that one, or correct tool.length_mm in robot.toml",
        Refusal.JOINTS_BEYOND_WIRE: "a pose turns a joint further than a joint frame can report: take other turns (--q0-turns, "
        "--roll-turns), or part the path",
        Refusal.PERMIT_MISMATCH: f"it holds another permit: {_ANEW}",
        Refusal.APPROACH: "entry or exit are not where its own kinematics put them, or outside its limits: lower "
        "approach_clearance_mm or move the bone; if it stays so, have its calibration looked at",
        Refusal.APPROACH_SPEED: f"approach_speed_percent {_OTHERWISE}",
        Refusal.WRONG_CAUSE: "another cause stands by now: read it, then try again",
        Refusal.MEMORY_FULL: "it remembers as many registrations as it can: give it a new key, when none of them is needed",
        Refusal.MEMORY_FAILED: "its memory cannot be written: have it repaired",
        Refusal.IDENTITY_DIGEST: "somebody else has announced himself in its name, or changed what it said on the way: leave "
        "one controller on the bus, and look what else is on it",
        Refusal.WITHDRAWAL_DUE: "the bone moved, or a registration was withdrawn, and it does not know yet from when on one "
        f"counts: {_ANEW}, which tells it",
        Refusal.REGISTRATION_TOO_EARLY: "this registration is not surely later than the last time that the bone moved or a "
        "registration was withdrawn: register the bone anew",
        Refusal.LOG_NOT_CONTINUED: f"the start does not name the audit log that its permit named, further on: {_ANEW}; if it "
        "stays so, have the runtime looked at",
    }
)  # fmt: skip
"""Of every refusal: what is wrong, where the code does not say it, and what to do."""


def told(refusal: Refusal) -> str:
    """The code, what it means and what to do."""
    return f"{refusal.name}: {MEANING[refusal]}"
