"""Every precondition of permit and start, by name, with its value, its bound and what to do.

A permissive is a function of the interlock's state and the time; all are evaluated, so that a person sees every
reason at once. Comparisons ask "inside?": anything unknown or undefined does not hold.
"""

import math
from collections.abc import Callable
from datetime import timedelta

from cutgate.config.constants import CLOCK_SKEW_MAX_S
from cutgate.config.screen import printable
from cutgate.protocol import records
from cutgate.protocol.differences import Parameters, differences
from cutgate.protocol.states import ControllerState, Refusal, StopCause
from cutgate.protocol.times import BEGINNING
from cutgate.runtime.interlock.permissive import Permissive
from cutgate.runtime.interlock.refusals import MEANING
from cutgate.runtime.interlock.state import WITNESS, DeviceCycle, Interlock
from cutgate.runtime.kinematics.landmarks import CheckPoints

Evaluate = Callable[[Interlock, float], Permissive]


def _fact(name: str, holds: bool, text: str, bound: str, remedy: str) -> Permissive:
    return Permissive(name, holds, None, text, bound, remedy)


def _at_most(name: str, value: float | None, bound: float, unit: str, remedy: str) -> Permissive:
    if value is None:
        return Permissive(name, False, None, "not known", f"<= {bound:g} {unit}", remedy)
    # bool, for a comparison of numpy floats is no bool and would never count as True
    return Permissive(name, bool(0.0 <= value <= bound), value, None, f"<= {bound:g} {unit}", remedy)


def _short(digest: bytes | None) -> str:
    return digest.hex()[:16] if digest is not None else "not received"


def _digest(data: bytes | None) -> bytes | None:
    return records.digest(data) if data is not None else None


# ---------------------------------------------------------------- identity


def protocol_version(state: Interlock, _now_s: float) -> Permissive:
    version = state.announced_version
    return _fact(
        "protocol version",
        version == records.PROTOCOL_VERSION,
        str(version) if version is not None else "no controller",
        str(records.PROTOCOL_VERSION),
        "use a controller and a runtime of the same protocol version",
    )


def serial_number(state: Interlock, _now_s: float) -> Permissive:
    serial = state.session.serial if state.session else None
    return _fact(
        "controller serial number",
        serial is not None and state.job.serial in (None, serial),
        serial or "no controller",
        state.job.serial or "any (none is configured)",
        "connect the controller named in site.toml, or correct [controller] serial",
    )


def plant_speed(state: Interlock, _now_s: float) -> Permissive:
    """What a controller announces about itself loosens nothing: another speed than 1 counts only where the site allows."""
    scale, allowed_by = state.session.time_scale if state.session else None, state.job.simulation_allowed_by
    fastest = records.PLANT_SPEED_PERMILLE_MAX / 1000
    where_no_bone_is = (
        "; where no bone and no robot is, say simulated = true under [controller] in site.toml, or run with "
        "--allow-simulated"
    )
    return Permissive(
        "speed of the plant, times the clock's",
        scale is not None and (scale == 1.0 or (allowed_by != "" and 0.0 < scale <= fastest)),
        scale,
        None if scale is not None else "no controller",
        f"up to {fastest:g}, a simulation is allowed by {allowed_by}"
        if allowed_by
        else "1, no simulation is allowed",
        f"connect a controller whose plant keeps the time of its clock{'' if allowed_by else where_no_bone_is}",
    )


# ---------------------------------------------------------------- what the controller holds

DIFFERENCES_SHOWN = 5
"""One for each joint."""


def _equals_approved(
    name: str, kind: type[Parameters], received: bytes | None, approved: bytes
) -> Permissive:
    return _fact(
        f"controller's {name} equal the approved",
        received is not None and received == approved,
        _compared(kind, received, approved),
        "equal",
        f"compare robot.toml with the controller's {name}; approve the right ones",
    )


def _compared(kind: type[Parameters], received: bytes | None, approved: bytes) -> str:
    """The values that differ, as many as a line holds, and how many more do."""
    if received is None:
        return "not received"
    if received == approved:
        return "equal"
    try:
        found = differences(kind.parse(received), kind.parse(approved))
    except records.RecordError:
        return f"{_short(_digest(received))}, approved {_short(_digest(approved))}"
    more = f" (and {len(found) - DIFFERENCES_SHOWN} more: audit show has all)"
    return "; ".join(found[:DIFFERENCES_SHOWN]) + (more if len(found) > DIFFERENCES_SHOWN else "")


def limits_approved(state: Interlock, _now_s: float) -> Permissive:
    return _equals_approved("joint limits", records.Limits, state.collected.limits, state.job.limits)


def calibration_approved(state: Interlock, _now_s: float) -> Permissive:
    return _equals_approved(
        "calibration values", records.Calibration, state.collected.calibration, state.job.calibration
    )


def tool_approved(state: Interlock, _now_s: float) -> Permissive:
    return _equals_approved("tool data", records.Tool, state.collected.tool, state.job.tool)


def path_accepted(state: Interlock, _now_s: float) -> Permissive:
    stored = state.stored
    accepted = stored is not None and stored.refusal is Refusal.ACCEPTED
    text, remedy = "not uploaded", "upload it: start a new session"
    if stored is not None:
        text = "accepted" if accepted else f"{stored.refusal.name} at pose {stored.pose}"
        remedy = remedy if accepted else MEANING[stored.refusal]
    return _fact(
        "controller's own check of the path",
        accepted,
        text,
        "accepted",
        remedy,
    )


def path_digest(state: Interlock, _now_s: float) -> Permissive:
    return _fact(
        "digest of the stored path",
        state.stored is not None and state.stored.digest == state.job.path_digest,
        _short(state.stored.digest if state.stored else None),
        _short(state.job.path_digest),
        "the controller stored other bytes than were sent: start a new session",
    )


# ---------------------------------------------------------------- the proof


def verdict_admissible(state: Interlock, _now_s: float) -> Permissive:
    verdict = state.verdict
    return _fact(
        "verdict",
        verdict is not None and verdict.admissible,
        verdict.reason if verdict else "not verified",
        "admissible",
        "move the bone as the guidance says, register again, start a new session",
    )


def verdict_current(state: Interlock, _now_s: float) -> Permissive:
    verdict, collected = state.verdict, state.collected
    made_for = (verdict.path, verdict.limits, verdict.calibration, verdict.tool) if verdict else None
    held = (
        state.job.path_digest,
        _digest(collected.limits),
        _digest(collected.calibration),
        _digest(collected.tool),
    )
    return _fact(
        "verdict was made for what the controller holds",
        made_for == held,
        _short(verdict.path if verdict else None),
        _short(held[0]),
        "verify again: start a new session",
    )


def approach_admissible(state: Interlock, _now_s: float) -> Permissive:
    verdict = state.verdict
    lower = "lower approach_clearance_mm " if state.job.timing.approach_clearance_mm > 0.0 else ""
    return _fact(
        "approach and retract",
        verdict is not None and verdict.approach is not None,
        verdict.approach_reason if verdict else "not verified",
        "every deadband kept between start joints and cut",
        f"let the arm start from elsewhere, {lower}or move the bone; start a new session",
    )


def trajectory_known(state: Interlock, _now_s: float) -> Permissive:
    known = state.verdict is not None and state.verdict.trajectory is not None
    return _fact(
        "reference trajectory",
        known,
        "known" if known else "none",
        "known: the moving arm is held against it",
        "as for approach and retract; without it nothing can be watched",
    )


def warnings_confirmed(state: Interlock, _now_s: float) -> Permissive:
    """What looks wrong with the files may be meant: the operator has seen each warning, and says so of each."""
    awaited = unconfirmed(state)
    return _fact(
        "warnings confirmed",
        state.verdict is not None and not awaited,
        _of_warnings(state, awaited),
        "each one that asks for it",
        "check what the warning says; only if it is meant, say "
        + (", ".join(f"confirm {code}" for code in awaited) or "confirm with its code"),
    )


def _of_warnings(state: Interlock, awaited: tuple[str, ...]) -> str:
    """What waits; else what was confirmed, so that whoever reads why it was allowed sees what was overruled."""
    if state.verdict is None:
        return "not verified"
    if awaited:
        return f"waits for {', '.join(awaited)}"
    return f"confirmed: {', '.join(state.verdict.to_confirm)}" if state.verdict.to_confirm else "none waits"


def unconfirmed(state: Interlock) -> tuple[str, ...]:
    """Codes of the warnings that still wait for the operator."""
    found = state.verdict.to_confirm if state.verdict else ()
    return tuple(code for code in found if code not in state.confirmed)


# ---------------------------------------------------------------- registration


def registration_age(state: Interlock, now_s: float) -> Permissive:
    name, remedy = "age of the registration", "register the bone again"
    bound = state.job.registration_max_age_s
    if bound is None:
        return _fact(name, True, f"{state.job.registration_age_s:.0f} s", "no bound is configured", remedy)
    age_s = None if state.began_s is None else state.job.registration_age_s + now_s - state.began_s
    return _at_most(name, age_s, bound, "s", remedy)


def registration_residual(state: Interlock, _now_s: float) -> Permissive:
    name, remedy = "residual of the registration", "register the bone again"
    residual, bound = state.job.registration_residual_mm, state.job.registration_max_residual_mm
    if bound is None:
        text = "not known" if residual is None else f"{residual:g} mm"
        return _fact(name, True, text, "no bound is configured", remedy)
    return _at_most(name, residual, bound, "mm", remedy)


def check_points(state: Interlock, _now_s: float) -> Permissive:
    """What finds an inverse, a flip or metres in a registration while the path still fits."""
    asked = state.job.check_points
    return _fact(
        "check points of the registration",
        not asked.missing and not asked.outside,
        _of_check_points(asked),
        (f"at least {asked.least}, " if asked.least else "") + f"each within {asked.tolerance_mm:g} mm",
        CHECK_POINTS_MISSING.format(asked.missing) if asked.missing else CHECK_POINT_OFF,
    )


CHECK_POINTS_MISSING = (
    "touch {} more landmarks with the probe and write them into check_points of the registration, or register again with them "
    "held out of the fit (cutgate register, docs/files.md)"
)
CHECK_POINT_OFF = (
    "touch the point again; if it stays off, check the registration's units, direction and frame (LPS or RAS), or "
    "register the bone again"
)


def _of_check_points(asked: CheckPoints) -> str:
    """How many there are, and the worst of them."""
    worst = asked.worst
    if worst is None:
        return "none"
    off = f"{printable(worst.id)} is {worst.residual_mm:g} mm off"
    return off if len(asked.points) == 1 else f"of {len(asked.points)} the worst, {off}"


def registration_stands(state: Interlock, _now_s: float) -> Permissive:
    against = _against_registration(state)
    return _fact(
        "registration stands",
        not against,
        against or "not withdrawn",
        "not withdrawn, and later than every withdrawal",
        CLOCK_WRONG if _ahead(state) else "the bone may have moved: register it again",
    )


CLOCK_WRONG = (
    "a clock was set wrong as it was withdrawn, or this one is: set it right; where it is, that goes only with a new key and "
    "memory of the controller (docs/controllers.md, Keys)"
)


def _barriers(state: Interlock) -> list[int]:
    """What the controller says and what it was told in this session, where they are times."""
    opened_us = state.opened.barrier_us if state.opened else records.NO_TIME
    return [barrier for barrier in (opened_us, state.barrier_us) if barrier != records.NO_TIME]


def _ahead(state: Interlock) -> bool:
    """Whether nothing that is registered now would count."""
    return max(_barriers(state), default=state.job.prepared_us) - state.job.prepared_us > AHEAD_MAX_US


def _against_registration(state: Interlock) -> str:
    """Why the registration must not be used, by this site's list, this session and the controller's list; else empty."""
    opened, time_us = state.opened, state.job.registration_time_us
    if state.job.withdrawal or state.registration_withdrawn:
        return state.job.withdrawal or "withdrawn"
    if opened is None:
        return "the controller has not yet said what it knows of it"
    barriers = _barriers(state)
    from_when = f"; what is taken from {utc(max(barriers) + SECOND_US)} on counts" if barriers else ""
    if opened.registration is Refusal.REGISTRATION_WITHDRAWN:
        return f"withdrawn at the controller{from_when}"
    if opened.withdrawal_due and state.barrier_us == records.NO_TIME:
        return (
            "the bone moved before this session, and the controller is not yet told from when on one counts"
        )
    late_enough = not barriers or (time_us != records.NO_TIME and time_us > max(barriers))
    if late_enough and opened.registration is Refusal.ACCEPTED:
        return ""
    which = "without a time" if time_us == records.NO_TIME else f"of {utc(time_us)}"
    return f"one {which} is not surely later than the last withdrawal that the controller knows{from_when}"


SECOND_US = 1_000_000
AHEAD_MAX_US = CLOCK_SKEW_MAX_S * SECOND_US
"""No barrier is told further ahead: the largest ``clock_skew_s``."""


def utc(time_us: int) -> str:
    """A time as people read it, in whole seconds.

    Args:
        time_us: since 1970, UTC.
    """
    try:
        return f"{BEGINNING + timedelta(microseconds=time_us):%Y-%m-%d %H:%M:%S %Z}"
    except OverflowError:  # the controller may say anything
        return f"{time_us} us since 1970"


# ---------------------------------------------------------------- the audit log


def log_writable(state: Interlock, _now_s: float) -> Permissive:
    return _fact(
        "audit log",
        state.log.writable,
        "writable" if state.log.writable else "failed",
        "writable",
        "free or replace the disk of the log directory, then start a new session",
    )


def log_space(state: Interlock, _now_s: float) -> Permissive:
    return Permissive(
        "space reserved for the audit log",
        state.log.reserved_bytes >= 2 * state.log.needed_bytes,
        float(state.log.reserved_bytes),
        None,
        f">= {2 * state.log.needed_bytes} bytes",
        "free space in the log directory, then start a new session",
    )


def controllers_witness(state: Interlock, _now_s: float) -> Permissive:
    """The controller keeps how far the log was at the last start: a log that is gone or was cut off does not pass unseen."""
    return _fact("controller's witness", *_of_witness(state))


def _of_witness(state: Interlock) -> tuple[bool, str, str, str]:
    bound = "the log that it saw last is found, or the operator has confirmed"
    find = f"bring that log back, or find out who took it; only if it is meant, say confirm {WITNESS}"
    if state.opened is None:
        return False, "not known", bound, "wait for the session"
    if state.opened.log == records.NO_TREE_HEAD:
        return True, "it has seen no start yet", bound, find
    if state.witness is None:
        return False, "being looked up", bound, "wait for the disk"
    confirmed = not state.witness.found and WITNESS in state.confirmed
    text = f"confirmed: {state.witness.text}" if confirmed else state.witness.text
    return state.witness.found or confirmed, text, bound, find


def awaiting_confirmation(state: Interlock) -> tuple[str, ...]:
    """What the operator was shown and may confirm: the warnings, and a log that was not found."""
    missed = state.witness is not None and not state.witness.found and WITNESS not in state.confirmed
    return (*unconfirmed(state), *((WITNESS,) if missed else ()))


# ---------------------------------------------------------------- the controller now


def heartbeat_fresh(state: Interlock, _now_s: float) -> Permissive:
    return _fact(
        "controller's heartbeat",
        state.heartbeat_fresh,
        "fresh" if state.heartbeat_fresh else "stale or never seen",
        f"fresh within {state.job.timing.timeout_ms} ms",
        "check the bus and the controller",
    )


def no_stop_cause(state: Interlock, _now_s: float) -> Permissive:
    view = state.controller
    return _fact(
        "controller's stop cause",
        view is not None and view.cause is StopCause.NONE,
        view.cause.name if view else "not known",
        "NONE",
        "release the emergency stop, then say acknowledge"
        if view is not None and view.cause is StopCause.EMERGENCY_STOP and not view.emergency_stop_clear
        else "say acknowledge",
    )


def not_latched(state: Interlock, _now_s: float) -> Permissive:
    view = state.controller
    return _fact(
        "controller's fault latch",
        view is not None and view.state is not ControllerState.FAULT,
        view.state.name if view else "not known",
        "not FAULT",
        "acknowledge the cause, then say reset",
    )


def emergency_stop(state: Interlock, _now_s: float) -> Permissive:
    view = state.controller
    if view is None:
        return _fact("emergency stop", False, "not known", "clear", "check the bus and the controller")
    clear = view.emergency_stop_clear
    remedy = "release the emergency stop"
    return _fact("emergency stop", clear, "clear" if clear else "pressed", "clear", remedy)


def epoch_current(state: Interlock, _now_s: float) -> Permissive:
    view = state.controller
    return _fact(
        "epoch",
        view is not None and view.epoch == state.epoch,
        str(view.epoch) if view else "not known",
        str(state.epoch),
        "a stop came in between: start a new session",
    )


# ---------------------------------------------------------------- where the arm stands


def start_offset(
    calibration: records.Calibration, measured_u: tuple[int, ...], bound_u: tuple[int, ...]
) -> tuple[float, float]:
    """How far an arm that begins at the measured joints can be off the verified joint line, wherever on it.

    Returns:
        Wrist centre, mm (a0 |d0| + a1 |d0 + d1| bounds it at every elbow angle), and the turning joint furthest
        off, deg.
    """
    d0, d1, d2, d3, d4 = ((a - b) / records.UNIT for a, b in zip(measured_u, bound_u, strict=True))
    upper_mm = calibration.upper_mm + calibration.upper_link_error_mm
    forearm_mm = calibration.forearm_mm + calibration.forearm_link_error_mm
    swept_mm = upper_mm * math.radians(abs(d0)) + forearm_mm * math.radians(abs(d0 + d1))
    return math.hypot(swept_mm, d2), max(map(abs, (d0, d1, d3, d4)))


def measured_now(state: Interlock, now_s: float) -> tuple[int, ...] | None:
    """The measured joints, unless they may be older than the heartbeat's time-out, whenever they came."""
    young = 0.0 <= now_s - state.measured_s <= state.job.timing.timeout_s
    return state.joints_u if young else None


def joints_age(state: Interlock, now_s: float) -> Permissive:
    return _at_most(
        "age of the measured joints",
        None if state.joints_u is None else now_s - state.measured_s,
        state.job.timing.timeout_s,
        "s",
        "check bus and controller: its joints are missing, or come late",
    )


def _off_start(state: Interlock) -> tuple[float, float] | tuple[None, None]:
    calibration = state.collected.calibration
    if state.joints_u is None or calibration is None or state.verdict is None:
        return None, None
    return start_offset(records.Calibration.parse(calibration), state.joints_u, state.verdict.start_joints_u)


def start_distance(state: Interlock, _now_s: float) -> Permissive:
    return _at_most(
        "measured wrist centre to the verified start",
        _off_start(state)[0],
        state.job.timing.start_tolerance_mm,
        "mm",
        "move the arm back to where it stood at verification, or start a new session",
    )


def start_angle(state: Interlock, _now_s: float) -> Permissive:
    return _at_most(
        "measured joints to the verified start",
        _off_start(state)[1],
        state.job.timing.start_tolerance_deg,
        "deg",
        "move the arm back to where it stood at verification, or start a new session",
    )


# ---------------------------------------------------------------- only for the start


def cutting_mode(state: Interlock, _now_s: float) -> Permissive:
    view = state.controller
    return _fact(
        "controller is permitted",
        view is not None and view.state is ControllerState.PERMITTED and view.cutting_mode,
        view.state.name if view else "not known",
        "PERMITTED",
        "wait for the permit",
    )


def permit_alive(state: Interlock, now_s: float) -> Permissive:
    age_s = now_s - state.nonce_at_s if state.permit is not None else None
    return _at_most(
        "age of the permit",
        age_s,
        state.job.timing.permit_lifetime_s,
        "s",
        "start a new session from verification",
    )


def device_cycled(state: Interlock, _now_s: float) -> Permissive:
    pressed = state.controller is not None and state.controller.device_pressed
    text, remedy = {
        DeviceCycle.UNSEEN: ("held since before the permit, or not seen", "release it, then hold it"),
        DeviceCycle.RELEASED: ("released", "hold it"),
        DeviceCycle.PRESSED: ("pressed", "hold it"),
    }[state.device]
    return _fact(
        "enabling device",
        pressed and state.device is DeviceCycle.PRESSED,
        text,
        "released, then pressed, after the permit",
        remedy,
    )


IDENTITY: tuple[Evaluate, ...] = (protocol_version, serial_number, plant_speed)
"""Judged as soon as a controller has announced itself."""

FOR_RESET: tuple[Evaluate, ...] = (
    *IDENTITY,
    log_writable,
    heartbeat_fresh,
    no_stop_cause,
    emergency_stop,
    epoch_current,
)
"""A latched fault is left only when its cause was acknowledged and nothing new has come."""

COLLECTED: tuple[Evaluate, ...] = (
    *IDENTITY,
    limits_approved,
    calibration_approved,
    tool_approved,
    registration_stands,
)
"""Judged as soon as the controller's records are complete; none can come true later in the session."""

FINAL: tuple[Evaluate, ...] = (
    *COLLECTED,
    path_accepted,
    path_digest,
    verdict_admissible,
    verdict_current,
    approach_admissible,
    trajectory_known,
    registration_age,
    registration_residual,
    check_points,
    log_writable,
    log_space,
)
"""No operator act can cure these within the session."""

AT_START: tuple[Evaluate, ...] = (start_distance, start_angle)
"""Where the arm begins, and where it must be back at the end; how old the joints may be is judged beside it."""

FOR_PERMIT: tuple[Evaluate, ...] = (
    *FINAL,
    warnings_confirmed,
    controllers_witness,
    heartbeat_fresh,
    no_stop_cause,
    not_latched,
    emergency_stop,
    epoch_current,
    joints_age,
    *AT_START,
)

FOR_START: tuple[Evaluate, ...] = (
    *FOR_PERMIT,
    cutting_mode,
    permit_alive,
    device_cycled,
)


def evaluate(which: tuple[Evaluate, ...], state: Interlock, now_s: float) -> tuple[Permissive, ...]:
    """Every permissive of ``which`` as it stands at ``now_s``."""
    return tuple(permissive(state, now_s) for permissive in which)


def all_hold(which: tuple[Evaluate, ...], state: Interlock, now_s: float) -> bool:
    """True only if each one holds."""
    return all(permissive.holds is True for permissive in evaluate(which, state, now_s))


def failing(which: tuple[Evaluate, ...], state: Interlock, now_s: float) -> tuple[Permissive, ...]:
    """Those that do not hold, in the order of the list."""
    return tuple(permissive for permissive in evaluate(which, state, now_s) if permissive.holds is not True)


FOLLOWS: dict[Evaluate, Evaluate] = {
    approach_admissible: verdict_admissible,
    trajectory_known: approach_admissible,
}
"""What fails only because another one does: a person need not read it."""
FOLLOWING: frozenset[str] = frozenset({"approach and retract", "reference trajectory"})
"""Their names, as logs have them."""


def unrecoverable(state: Interlock, now_s: float) -> tuple[Permissive, ...]:
    """Those for the permit that do not hold and never will, without what only follows; the file system may still answer."""
    unanswered = {log_space} if state.log.reserved_bytes == 0 else set()
    judged = {permissive: permissive(state, now_s) for permissive in FINAL if permissive not in unanswered}
    broken = {permissive for permissive, found in judged.items() if found.holds is not True}
    return tuple(
        judged[permissive]
        for permissive in FINAL
        if permissive in broken and FOLLOWS.get(permissive) not in broken
    )
