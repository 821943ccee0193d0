"""Why the controller refuses: one ordered table of rules per request, first match answers.

Each rule is a predicate that must hold ("inside?"), so that anything undefined denies.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from cutgate.config.constants import CONSTANTS, REGISTRATIONS_MAX, TIMEOUT_HEARTBEATS
from cutgate.firmware_sim.approach import agrees, inside, start_offset
from cutgate.firmware_sim.reports import announcement
from cutgate.firmware_sim.state import Controller, DeviceCycle
from cutgate.protocol import records
from cutgate.protocol.parameters import ROTATION_DEG_STANDS
from cutgate.protocol.path import PathHeader
from cutgate.protocol.records import digest
from cutgate.protocol.states import ControllerState, Purpose, Refusal, StopCause


@dataclass(frozen=True)
class RequestCase:
    """A request and what it is judged against. ``authentic``: a holder of the key made it, as the endpoint says."""

    controller: Controller
    request: Any
    now_s: float
    authentic: bool = False


Rule = tuple[Refusal, Callable[[RequestCase], bool]]


def first_refusal(rules: tuple[Rule, ...], case: RequestCase) -> Refusal:
    """The first rule that does not hold, else ACCEPTED."""
    return next((refusal for refusal, holds in rules if not holds(case)), Refusal.ACCEPTED)


def _made_by_a_key_holder(case: RequestCase) -> bool:
    return case.authentic


def _session_digest(case: RequestCase) -> bytes | None:
    return case.controller.session.digest if case.controller.session else None


def _nonce_lifetime_s(case: RequestCase, purpose: Purpose) -> float:
    session = case.controller.session
    if session is None:
        return math.nan  # which no age is within
    return session.permit_lifetime_s if purpose is Purpose.PERMIT else session.start_lifetime_s


def _nonce_rules(purpose: Purpose) -> tuple[Rule, ...]:
    def issued(case: RequestCase) -> bool:
        return case.controller.issued is not None and case.controller.issued.purpose is purpose

    def matches(case: RequestCase) -> bool:
        nonce = case.controller.issued
        return nonce is not None and nonce.nonce == case.request.nonce

    def alive(case: RequestCase) -> bool:
        nonce = case.controller.issued
        return nonce is not None and 0.0 <= case.now_s - nonce.at_s <= _nonce_lifetime_s(case, purpose)

    return (
        (Refusal.NO_NONCE, issued),
        (Refusal.NONCE_MISMATCH, matches),
        (Refusal.NONCE_EXPIRED, alive),
    )


def _path_as_permitted(case: RequestCase) -> bool:
    path = case.controller.holdings.path
    return path is not None and digest(path) == _permit(case).path_digest


def _permit(case: RequestCase) -> records.Permit:
    """The permit in question: the one asked for, or for a start the one accepted."""
    if isinstance(case.request, records.Permit):
        return case.request
    assert case.controller.permit is not None  # noqa: S101 - NO_PERMIT stands before in the table
    return case.controller.permit


def _not_withdrawn(case: RequestCase) -> bool:
    session, memory = case.controller.session, case.controller.memory
    return (
        session is not None
        and session.place not in memory.withdrawn
        and session.registration not in memory.earlier
    )


def _later_than_the_barrier(case: RequestCase) -> bool:
    """A registration without a time is never later than a barrier, for NO_TIME is 0 and a barrier more."""
    session, barrier_us = case.controller.session, case.controller.memory.barrier_us
    return session is not None and (
        barrier_us == records.NO_TIME or session.registration_time_us > barrier_us
    )


REGISTRATION_RULES: tuple[Rule, ...] = (
    (Refusal.REGISTRATION_WITHDRAWN, _not_withdrawn),
    (Refusal.REGISTRATION_TOO_EARLY, _later_than_the_barrier),
)
"""What the controller's own list says of the registration that the session's OPEN names; OPENED tells it."""

# What the controller has stored is hashed anew for every permit and again for every start.
HOLDINGS_RULES: tuple[Rule, ...] = (
    (Refusal.LIMITS_DIGEST, lambda c: digest(c.controller.holdings.limits) == _permit(c).limits_digest),
    (
        Refusal.CALIBRATION_DIGEST,
        lambda c: digest(c.controller.holdings.calibration) == _permit(c).calibration_digest,
    ),
    (Refusal.TOOL_DIGEST, lambda c: digest(c.controller.holdings.tool) == _permit(c).tool_digest),
    (Refusal.PATH_DIGEST, _path_as_permitted),
    (Refusal.WITHDRAWAL_DUE, lambda c: not c.controller.memory.withdrawal_due),
    *REGISTRATION_RULES,
)

ALIVE_RULES: tuple[Rule, ...] = (
    (Refusal.HEARTBEAT_STALE, lambda c: c.controller.heartbeat_fresh),
    (Refusal.EMERGENCY_STOP, lambda c: c.controller.inputs.emergency_stop_clear),
)


def _same_branch(case: RequestCase) -> bool:
    stored = case.controller.holdings.path
    if stored is None:
        return False
    path = PathHeader.of(stored)
    return bool(case.request.branch == records.Branch(path.elbow, path.q0_turns, path.roll_turns))


def at_start(case: RequestCase) -> bool:
    """The arm stands at the bound start joints, within the start tolerance and inside its limits."""
    session, measured_u = case.controller.session, case.controller.measured_u
    holdings = case.controller.holdings
    if session is None or measured_u is None:
        return False
    bound_u = _permit(case).start_joints_u
    off_mm, off_deg = start_offset(records.Calibration.parse(holdings.calibration), measured_u, bound_u)
    return (
        inside(records.Limits.parse(holdings.limits), bound_u, within_deg=ROTATION_DEG_STANDS)
        and 0.0 <= off_mm <= session.start_tolerance_mm
        and 0.0 <= off_deg <= session.start_tolerance_deg
    )


def _own_approach(case: RequestCase) -> bool:
    """Entry and exit are where the controller's own kinematics put them, and inside its limits."""
    holdings, bound = case.controller.holdings, case.request.approach
    limits = records.Limits.parse(holdings.limits)
    return agrees(holdings.ends, bound) and inside(limits, bound.entry_joints_u, bound.exit_joints_u)


def _announce_nonce_as_opened(case: RequestCase) -> bool:
    session = case.controller.session
    return session is not None and case.request.announce_nonce == session.announce_nonce


def _registration_as_opened(case: RequestCase) -> bool:
    session = case.controller.session
    return session is not None and case.request.registration_digest == session.registration


def _configuration_as_opened(case: RequestCase) -> bool:
    session = case.controller.session
    return session is not None and case.request.configuration_digest == session.configuration


def _verifier_as_opened(case: RequestCase) -> bool:
    session = case.controller.session
    return session is not None and case.request.verifier_version == session.verifier


def _lifetime_as_opened(case: RequestCase) -> bool:
    session = case.controller.session
    return session is not None and case.request.lifetime_s == session.permit_lifetime_s


def _speed_as_opened(case: RequestCase) -> bool:
    session = case.controller.session
    return session is not None and case.request.approach.speed_percent == session.approach_speed_percent


def _permit_alive(case: RequestCase) -> bool:
    session = case.controller.session
    age_s = case.now_s - case.controller.permit_issued_at_s
    return session is not None and 0.0 <= age_s <= session.permit_lifetime_s


def _log_goes_on(case: RequestCase) -> bool:
    """The record that authorised the start stands in the permit's log, further on."""
    permitted, started = _permit(case).log, case.request.log
    return bool(started.log_id == permitted.log_id and started.size > permitted.size)


def _timing_within_bounds(case: RequestCase) -> bool:
    timing: records.Timing = case.request.timing
    values = {
        "heartbeat_ms": timing.heartbeat_ms,
        "timeout_ms": timing.timeout_ms,
        "permit_lifetime_s": timing.permit_lifetime_s,
        "start_lifetime_ms": timing.start_lifetime_ms,
        "start_tolerance_mm": timing.start_tolerance_um / 1000,
        "start_tolerance_deg": timing.start_tolerance_mdeg / 1000,
        "approach_clearance_mm": timing.approach_clearance_um / 1000,
        "approach_speed_percent": timing.approach_speed_percent,
    }
    return timing.timeout_ms >= TIMEOUT_HEARTBEATS * timing.heartbeat_ms and all(
        CONSTANTS[name].holds(value) for name, value in values.items()
    )


def _has_room(case: RequestCase) -> bool:
    """A session whose place could not be remembered as withdrawn is refused; none is forgotten for it."""
    return len(case.controller.memory.withdrawn | {case.request.place_digest}) <= REGISTRATIONS_MAX


def _place_of_the_session(case: RequestCase) -> bool:
    session = case.controller.session
    return session is not None and case.request.place_digest in (session.place, records.NO_PLACE)


def _same_version(case: RequestCase) -> bool:
    own = case.controller.identity.protocol_version
    return isinstance(case.request, records.Open) and case.request.protocol_version == own


def _live(case: RequestCase) -> bool:
    return case.controller.session is not None and case.controller.session.live


def _permitted_and_not_starting(case: RequestCase) -> bool:
    return case.controller.state is ControllerState.PERMITTED and case.controller.awaiting is None


OPEN_RULES: tuple[Rule, ...] = (
    (Refusal.PROTOCOL_VERSION, _same_version),
    (Refusal.SESSION_IN_USE, lambda c: c.controller.session is None),
    (Refusal.MAC_INVALID, _made_by_a_key_holder),
    (Refusal.ANNOUNCE_NONCE, lambda c: c.request.announce_nonce == c.controller.announce_nonce),
    (
        Refusal.IDENTITY_DIGEST,
        lambda c: c.request.identity_digest == announcement(c.controller).identity_digest,
    ),
    (Refusal.WRONG_SESSION, lambda c: records.opens(c.request)),
    (Refusal.TIMING_OUT_OF_BOUNDS, _timing_within_bounds),
    (Refusal.MEMORY_FULL, _has_room),
)
"""The version is read before the rest, which another one may lay out otherwise."""

PERMIT_RULES: tuple[Rule, ...] = (
    (Refusal.MAC_INVALID, _made_by_a_key_holder),
    (Refusal.VOIDED_BY_STOP, _live),
    (Refusal.WRONG_SESSION, lambda c: c.request.session_digest == _session_digest(c)),
    (Refusal.ANNOUNCE_NONCE, _announce_nonce_as_opened),
    (Refusal.WRONG_SERIAL, lambda c: c.request.serial == c.controller.identity.serial),
    (
        Refusal.PROTOCOL_VERSION,
        lambda c: c.request.protocol_version == c.controller.identity.protocol_version,
    ),
    (Refusal.LATCHED_FAULT, lambda c: c.controller.state is not ControllerState.FAULT),
    (Refusal.UNACKNOWLEDGED_STOP, lambda c: c.controller.cause is StopCause.NONE),
    (Refusal.NOT_IN_STATE, lambda c: c.controller.state is ControllerState.LOADED),
    *ALIVE_RULES,
    *_nonce_rules(Purpose.PERMIT),
    (Refusal.EPOCH, lambda c: c.request.epoch == c.controller.epoch),
    *HOLDINGS_RULES,
    # What OPEN named as well must be the same.
    (Refusal.REGISTRATION_DIGEST, _registration_as_opened),
    (Refusal.CONFIGURATION_DIGEST, _configuration_as_opened),
    (Refusal.VERIFIER, _verifier_as_opened),
    (Refusal.TIMING_OUT_OF_BOUNDS, _lifetime_as_opened),
    (Refusal.LOG_NOT_CONTINUED, lambda c: c.request.log.size > 0),
    (Refusal.BRANCH, _same_branch),
    (Refusal.APPROACH, _own_approach),
    (Refusal.APPROACH_SPEED, _speed_as_opened),
    (Refusal.START_JOINTS, at_start),
)

START_RULES: tuple[Rule, ...] = (
    (Refusal.MAC_INVALID, _made_by_a_key_holder),
    (Refusal.VOIDED_BY_STOP, _live),
    (Refusal.WRONG_SESSION, lambda c: c.request.session_digest == _session_digest(c)),
    (Refusal.NO_PERMIT, lambda c: c.controller.permit is not None),
    (Refusal.NOT_IN_STATE, _permitted_and_not_starting),
    *ALIVE_RULES,
    *_nonce_rules(Purpose.START),
    (Refusal.EPOCH, lambda c: c.request.epoch == c.controller.epoch),
    (Refusal.PERMIT_EXPIRED, _permit_alive),
    (Refusal.PERMIT_MISMATCH, lambda c: c.request.permit_digest == _permit(c).digest),
    (Refusal.START_JOINTS, lambda c: c.request.start_joints_u == _permit(c).start_joints_u),
    (Refusal.LOG_NOT_CONTINUED, _log_goes_on),
    *HOLDINGS_RULES,
    (Refusal.DEVICE_NOT_RELEASED_AND_PRESSED, lambda c: c.controller.device is DeviceCycle.PRESSED),
    (Refusal.NOT_AT_START, at_start),
)
"""Judged when it arrives, and again once the start's log is durable in the controller's memory."""

RESET_RULES: tuple[Rule, ...] = (
    (Refusal.MAC_INVALID, _made_by_a_key_holder),
    (Refusal.VOIDED_BY_STOP, _live),
    (Refusal.WRONG_SESSION, lambda c: c.request.session_digest == _session_digest(c)),
    (Refusal.NOT_IN_STATE, lambda c: c.controller.state is ControllerState.FAULT),
    (Refusal.UNACKNOWLEDGED_STOP, lambda c: c.controller.cause is StopCause.NONE),
    *ALIVE_RULES,
    *_nonce_rules(Purpose.RESET),
    (Refusal.EPOCH, lambda c: c.request.epoch == c.controller.epoch),
    (Refusal.WRONG_CAUSE, lambda c: c.request.cause is c.controller.memory.latched),
)
"""A reset leaves a latched fault once its cause was acknowledged. It never starts motion."""

ACKNOWLEDGE_RULES: tuple[Rule, ...] = (
    (Refusal.MAC_INVALID, _made_by_a_key_holder),
    (Refusal.VOIDED_BY_STOP, _live),
    (Refusal.EPOCH, lambda c: c.request.epoch == c.controller.epoch),
    (Refusal.WRONG_CAUSE, lambda c: c.request.cause is c.controller.cause),
    (
        Refusal.EMERGENCY_STOP,
        lambda c: c.request.cause is not StopCause.EMERGENCY_STOP or c.controller.inputs.emergency_stop_clear,
    ),
)
"""Only the cause that stands, once it is gone; the operator has to have seen it."""

WITHDRAW_RULES: tuple[Rule, ...] = (
    (Refusal.MAC_INVALID, _made_by_a_key_holder),
    (Refusal.WRONG_SESSION, _place_of_the_session),
)
"""Also in a session that a stop has voided: a withdrawal enables nothing."""
