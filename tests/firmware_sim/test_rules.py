"""Every reason to refuse: a case that passes, one field of it altered, and the one reason that is given."""

import math
from dataclasses import FrozenInstanceError, replace

import pytest

from cutgate.config.constants import REGISTRATIONS_MAX
from cutgate.firmware_sim.rules import (
    ACKNOWLEDGE_RULES,
    OPEN_RULES,
    PERMIT_RULES,
    REGISTRATION_RULES,
    RESET_RULES,
    START_RULES,
    WITHDRAW_RULES,
    RequestCase,
    at_start,
    first_refusal,
)
from cutgate.firmware_sim.state import Awaiting, DeviceCycle, LimitsChanged, Memory
from cutgate.firmware_sim.table import step
from cutgate.protocol import records
from cutgate.protocol.states import ControllerState, Purpose, Refusal, StopCause
from tests.altering import altered
from tests.firmware_sim import controllers
from tests.firmware_sim.controllers import (
    ASKED,
    CUTTING,
    CYCLED,
    ENDS,
    LOADED,
    NOW,
    OPEN,
    OPENED,
    OTHER_LIMITS,
    PATH,
    PERMIT,
    PERMIT_CASE,
    PERMIT_LOG,
    PERMIT_NONCE,
    PLACE,
    POWERED_UP,
    REGISTERED_US,
    REGISTRATION,
    RESET_CASE,
    START_CASE,
    START_JOINTS,
    START_LOG,
    STARTING,
    changed,
    decide,
    replies,
)

OTHER = bytes(32)
OTHER_BYTES = OTHER_LIMITS.body()
FLIPPED_PATH = PATH.body()[:-1] + bytes([PATH.body()[-1] ^ 1])


def _moved(joints_u: tuple[int, ...], joint: int, by: int) -> tuple[int, ...]:
    return tuple(count + by * (index == joint) for index, count in enumerate(joints_u))


def _joints(joint: int, by: int) -> tuple[int, ...]:
    return _moved(START_JOINTS, joint, by)


JUST_OUTSIDE = (31_832, 63_663, 500_001, 200_001, 200_001)
"""0.5 mm at the wrist centre is 0.031831 deg of the shoulder with both links, 0.063662 deg of the elbow."""
JUST_INSIDE = (31_830, 63_661, 500_000, 200_000, 200_000)

OFF_START = [
    ("controller.measured_u", None, Refusal.START_JOINTS),
    *(
        ("controller.measured_u", _joints(joint, sign * off), Refusal.START_JOINTS)
        for joint, off in enumerate(JUST_OUTSIDE)
        for sign in (1, -1)
    ),
    ("controller.measured_u", _joints(3, 360_000_000), Refusal.START_JOINTS),
]

HOLDINGS = [
    ("controller.holdings.limits", OTHER_BYTES, Refusal.LIMITS_DIGEST),
    ("controller.holdings.calibration", b"other", Refusal.CALIBRATION_DIGEST),
    ("controller.holdings.tool", b"other", Refusal.TOOL_DIGEST),
    ("controller.holdings.path", FLIPPED_PATH, Refusal.PATH_DIGEST),
    ("controller.holdings.path", None, Refusal.PATH_DIGEST),
    ("controller.memory.withdrawal_due", True, Refusal.WITHDRAWAL_DUE),
    ("controller.memory.withdrawn", frozenset({OTHER, PLACE}), Refusal.REGISTRATION_WITHDRAWN),
    ("controller.memory.earlier", frozenset({OTHER, REGISTRATION}), Refusal.REGISTRATION_WITHDRAWN),
    ("controller.memory.barrier_us", REGISTERED_US, Refusal.REGISTRATION_TOO_EARLY),
    ("controller.memory.barrier_us", REGISTERED_US + 1, Refusal.REGISTRATION_TOO_EARLY),
]

ALIVE = [
    ("controller.heartbeat_fresh", False, Refusal.HEARTBEAT_STALE),
    ("controller.inputs.emergency_stop_clear", False, Refusal.EMERGENCY_STOP),
    ("controller.issued", None, Refusal.NO_NONCE),
    ("controller.issued.nonce", b"newer".ljust(16), Refusal.NONCE_MISMATCH),
    ("request.nonce", b"older".ljust(16), Refusal.NONCE_MISMATCH),
    ("now_s", NOW - 0.1, Refusal.NONCE_EXPIRED),
    ("now_s", math.nan, Refusal.NONCE_EXPIRED),
    ("authentic", False, Refusal.MAC_INVALID),
    ("controller.session.live", False, Refusal.VOIDED_BY_STOP),
    ("controller.session", None, Refusal.VOIDED_BY_STOP),
    ("request.session_digest", OTHER, Refusal.WRONG_SESSION),
    ("controller.session.digest", OTHER, Refusal.WRONG_SESSION),
]

PERMIT_CASES = [
    *HOLDINGS,
    *ALIVE,
    ("request.announce_nonce", bytes(16), Refusal.ANNOUNCE_NONCE),
    ("controller.session.announce_nonce", bytes(16), Refusal.ANNOUNCE_NONCE),
    ("request.serial", "SIM-2", Refusal.WRONG_SERIAL),
    ("controller.identity.serial", "SIM-2", Refusal.WRONG_SERIAL),
    ("request.protocol_version", 1, Refusal.PROTOCOL_VERSION),
    ("controller.state", ControllerState.FAULT, Refusal.LATCHED_FAULT),
    ("controller.cause", StopCause.BONE_MOVED, Refusal.UNACKNOWLEDGED_STOP),
    *(
        ("controller.state", state, Refusal.NOT_IN_STATE)
        for state in ControllerState
        if state not in (ControllerState.LOADED, ControllerState.FAULT)
    ),
    ("controller.issued.purpose", Purpose.START, Refusal.NO_NONCE),
    ("controller.issued.purpose", Purpose.RESET, Refusal.NO_NONCE),
    ("now_s", NOW + 120.1, Refusal.NONCE_EXPIRED),
    ("request.epoch", 2, Refusal.EPOCH),
    ("controller.epoch", 2, Refusal.EPOCH),
    ("request.limits_digest", OTHER, Refusal.LIMITS_DIGEST),
    ("request.calibration_digest", OTHER, Refusal.CALIBRATION_DIGEST),
    ("request.tool_digest", OTHER, Refusal.TOOL_DIGEST),
    ("request.path_digest", OTHER, Refusal.PATH_DIGEST),
    ("request.registration_digest", OTHER, Refusal.REGISTRATION_DIGEST),
    ("controller.session.registration", OTHER, Refusal.REGISTRATION_DIGEST),
    ("request.configuration_digest", OTHER, Refusal.CONFIGURATION_DIGEST),
    ("controller.session.configuration", OTHER, Refusal.CONFIGURATION_DIGEST),
    ("request.verifier_version", "cutgate other", Refusal.VERIFIER),
    ("controller.session.verifier", "cutgate other", Refusal.VERIFIER),
    ("request.lifetime_s", 121, Refusal.TIMING_OUT_OF_BOUNDS),
    ("controller.session.permit_lifetime_s", 600.0, Refusal.TIMING_OUT_OF_BOUNDS),
    ("request.log", records.NO_TREE_HEAD, Refusal.LOG_NOT_CONTINUED),
    ("request.log.size", 0, Refusal.LOG_NOT_CONTINUED),
    ("request.branch.elbow", "left", Refusal.BRANCH),
    ("request.branch.q0_turns", 1, Refusal.BRANCH),
    ("request.branch.roll_turns", 0, Refusal.BRANCH),
    *OFF_START,
    *(
        ("request.start_joints_u", _joints(joint, sign * off), Refusal.START_JOINTS)
        for joint, off in enumerate(JUST_OUTSIDE)
        for sign in (1, -1)
    ),
    # measured and bound alike, but beyond the controller's own limits
    ("both.start_joints", _joints(2, -50_000_001), Refusal.START_JOINTS),
    ("controller.holdings.ends", None, Refusal.APPROACH),
    ("request.approach.entry_um", ENDS.entry_um + 2, Refusal.APPROACH),
    ("request.approach.entry_um", ENDS.entry_um - 2, Refusal.APPROACH),
    ("request.approach.exit_um", ENDS.exit_um + 2, Refusal.APPROACH),
    ("request.approach.exit_um", ENDS.exit_um - 2, Refusal.APPROACH),
    *(
        (
            f"request.approach.{end}_joints_u",
            _moved(getattr(ENDS, f"{end}_joints_u"), joint, by),
            Refusal.APPROACH,
        )
        for end in ("entry", "exit")
        for joint in range(5)
        for by in (10_001, -10_001, 360_000_000)
    ),
    *(
        (f"both.{end}", _moved(getattr(ENDS, f"{end}_joints_u"), 3, 360_000_000), Refusal.APPROACH)
        for end in ("entry", "exit")
    ),
    ("request.approach.speed_percent", 26, Refusal.APPROACH_SPEED),
    ("request.approach.speed_percent", 24, Refusal.APPROACH_SPEED),
    ("controller.session.approach_speed_percent", 100, Refusal.APPROACH_SPEED),
]

START_CASES = [
    *HOLDINGS,
    *ALIVE,
    ("controller.permit", None, Refusal.NO_PERMIT),
    *(
        ("controller.state", state, Refusal.NOT_IN_STATE)
        for state in ControllerState
        if state is not ControllerState.PERMITTED
    ),
    ("controller.issued.purpose", Purpose.PERMIT, Refusal.NO_NONCE),
    ("now_s", NOW + 2.1, Refusal.NONCE_EXPIRED),
    ("request.epoch", 2, Refusal.EPOCH),
    ("controller.permit_issued_at_s", NOW - 120.1, Refusal.PERMIT_EXPIRED),
    ("controller.permit_issued_at_s", NOW + 0.1, Refusal.PERMIT_EXPIRED),
    ("controller.permit_issued_at_s", math.nan, Refusal.PERMIT_EXPIRED),
    ("request.permit_digest", OTHER, Refusal.PERMIT_MISMATCH),
    ("controller.permit.configuration_digest", OTHER, Refusal.PERMIT_MISMATCH),
    ("request.start_joints_u", _joints(0, 1), Refusal.START_JOINTS),
    ("controller.awaiting", Awaiting(STARTING, Memory(log=START_LOG)), Refusal.NOT_IN_STATE),
    ("request.log.log_id", b"m" * 16, Refusal.LOG_NOT_CONTINUED),
    ("request.log.size", PERMIT_LOG.size, Refusal.LOG_NOT_CONTINUED),
    ("request.log.size", PERMIT_LOG.size - 1, Refusal.LOG_NOT_CONTINUED),
    ("request.log", records.NO_TREE_HEAD, Refusal.LOG_NOT_CONTINUED),
    ("controller.device", DeviceCycle.UNSEEN, Refusal.DEVICE_NOT_RELEASED_AND_PRESSED),
    ("controller.device", DeviceCycle.RELEASED, Refusal.DEVICE_NOT_RELEASED_AND_PRESSED),
    *((field, value, Refusal.NOT_AT_START) for field, value, _ in OFF_START),
]

RESET_CASES = [
    *ALIVE,
    *(
        ("controller.state", state, Refusal.NOT_IN_STATE)
        for state in ControllerState
        if state is not ControllerState.FAULT
    ),
    ("controller.cause", StopCause.SECOND_NODE, Refusal.UNACKNOWLEDGED_STOP),
    ("controller.issued.purpose", Purpose.START, Refusal.NO_NONCE),
    ("now_s", NOW + 2.1, Refusal.NONCE_EXPIRED),
    ("request.epoch", 3, Refusal.EPOCH),
    *(
        ("request.cause", cause, Refusal.WRONG_CAUSE)
        for cause in StopCause
        if cause is not StopCause.SECOND_NODE
    ),
    ("controller.memory.latched", StopCause.AUDIT_FAILED, Refusal.WRONG_CAUSE),
]


def _twin(case, field, value):
    """``both`` alters what is bound and what the controller holds alike: only its limits are left to refuse."""
    whose, _, end = field.partition(".")
    if whose != "both":
        return changed(case, field, value)
    if end == "start_joints":
        return changed(changed(case, "request.start_joints_u", value), "controller.measured_u", value)
    held = changed(case, f"controller.holdings.ends.{end}_joints_u", value)
    return changed(held, f"request.approach.{end}_joints_u", value)


ALL = [
    *((PERMIT_CASE, PERMIT_RULES, *one) for one in PERMIT_CASES),
    *((START_CASE, START_RULES, *one) for one in START_CASES),
    *((RESET_CASE, RESET_RULES, *one) for one in RESET_CASES),
]
PASSING = [(PERMIT_CASE, PERMIT_RULES), (START_CASE, START_RULES), (RESET_CASE, RESET_RULES)]
NAMES = ["permit", "start", "reset"]


@pytest.mark.parametrize(("case", "rules"), PASSING, ids=NAMES)
def test_the_unaltered_case_passes(case, rules):
    assert first_refusal(rules, case) is Refusal.ACCEPTED
    after, effects = decide(case)
    assert replies(effects) == [Refusal.ACCEPTED]
    assert after.state is not case.controller.state


@pytest.mark.parametrize(
    ("case", "rules", "field", "value", "refusal"),
    ALL,
    ids=[
        f"{number}-{type(case.request).__name__}-{refusal.name}-{field}"
        for number, (case, _, field, _, refusal) in enumerate(ALL)
    ],
)
def test_one_altered_field_is_refused_with_its_own_reason(case, rules, field, value, refusal):
    twin = _twin(case, field, value)

    assert first_refusal(rules, twin) is refusal

    after, effects = decide(twin)
    assert replies(effects) == [refusal]
    assert not after.may_move
    assert after.issued is None, "a refused request uses its nonce up"
    if refusal is Refusal.MAC_INVALID:
        assert (after.state, after.permit) == (ControllerState.FAULT, None)
    else:
        expected = vars(replace(twin.controller, issued=None))
        assert vars(after) == expected, "identity first: the altered field may be NaN"


OPEN_CASE = RequestCase(POWERED_UP, OPEN, NOW, authentic=True)
ACKNOWLEDGE_CASE = RequestCase(
    controllers.OPEN_LATCHED, records.Acknowledge(2, StopCause.SECOND_NODE), NOW, authentic=True
)
WITHDRAW_CASE = RequestCase(OPENED, records.Withdraw(PLACE, REGISTERED_US), NOW, authentic=True)
ALMOST_FULL = frozenset(number.to_bytes(32, "big") for number in range(1, REGISTRATIONS_MAX))
OPEN_CASES = [
    ("request.protocol_version", 3, Refusal.PROTOCOL_VERSION),
    ("request.protocol_version", 5, Refusal.PROTOCOL_VERSION),
    ("request", records.OtherVersion(records.Open.TYPE, 3), Refusal.PROTOCOL_VERSION),
    (
        "request",
        records.OtherVersion(records.Open.TYPE, records.PROTOCOL_VERSION),
        Refusal.PROTOCOL_VERSION,
    ),
    ("controller.session", OPENED.session, Refusal.SESSION_IN_USE),
    ("authentic", False, Refusal.MAC_INVALID),
    ("request.announce_nonce", bytes(16), Refusal.ANNOUNCE_NONCE),
    ("controller.announce_nonce", bytes(16), Refusal.ANNOUNCE_NONCE),
    ("request.identity_digest", OTHER, Refusal.IDENTITY_DIGEST),
    ("controller.identity.serial", "SIM-2", Refusal.IDENTITY_DIGEST),
    ("controller.identity.plant_speed_permille", 2000, Refusal.IDENTITY_DIGEST),
    *(
        (f"request.timing.{name}", value, Refusal.TIMING_OUT_OF_BOUNDS)
        for name, values in {
            "heartbeat_ms": (4, 101, 34),
            "timeout_ms": (79, 1001),
            "permit_lifetime_s": (9, 601),
            "start_lifetime_ms": (499, 5001),
            "start_tolerance_um": (49, 2001),
            "start_tolerance_mdeg": (19, 1001),
            "approach_clearance_um": (200_001,),
            "approach_speed_percent": (0, 101),
        }.items()
        for value in values
    ),
    ("controller.memory.withdrawn", ALMOST_FULL | {OTHER}, Refusal.MEMORY_FULL),
]
ACKNOWLEDGE_CASES = [
    ("authentic", False, Refusal.MAC_INVALID),
    ("request.epoch", 1, Refusal.EPOCH),
    ("request.epoch", 3, Refusal.EPOCH),
    ("controller.epoch", 3, Refusal.EPOCH),
    ("controller.session", None, Refusal.VOIDED_BY_STOP),
    ("controller.session.live", False, Refusal.VOIDED_BY_STOP),
    *(
        ("request.cause", cause, Refusal.WRONG_CAUSE)
        for cause in StopCause
        if cause is not StopCause.SECOND_NODE
    ),
]
WITHDRAW_CASES = [
    ("authentic", False, Refusal.MAC_INVALID),
    ("request.place_digest", records.digest(b"another place"), Refusal.WRONG_SESSION),
    ("controller.session.place", records.digest(b"another place"), Refusal.WRONG_SESSION),
    ("controller.session", None, Refusal.WRONG_SESSION),
]
WITHOUT_NONCE = [
    *((OPEN_CASE, OPEN_RULES, *one) for one in OPEN_CASES),
    *((ACKNOWLEDGE_CASE, ACKNOWLEDGE_RULES, *one) for one in ACKNOWLEDGE_CASES),
    *((WITHDRAW_CASE, WITHDRAW_RULES, *one) for one in WITHDRAW_CASES),
]


@pytest.mark.parametrize(
    ("case", "rules", "field", "value", "refusal"),
    WITHOUT_NONCE,
    ids=[f"{number}-{one[-1].name}-{one[2]}" for number, one in enumerate(WITHOUT_NONCE)],
)
def test_one_altered_field_of_a_request_without_a_nonce_is_refused(case, rules, field, value, refusal):
    assert first_refusal(rules, case) is Refusal.ACCEPTED
    assert first_refusal(rules, altered(case, field, value)) is refusal


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("controller.memory.withdrawn", ALMOST_FULL),
        ("controller.memory.withdrawn", ALMOST_FULL | {PLACE}),
        ("controller.memory.earlier", ALMOST_FULL | {OTHER}),
        ("request.timing.approach_clearance_um", 200_000),
        ("request.timing.timeout_ms", 80),
    ],
)
def test_the_bounds_of_an_open_are_inside(field, value):
    assert first_refusal(OPEN_RULES, altered(OPEN_CASE, field, value)) is Refusal.ACCEPTED


def test_a_nonce_that_makes_the_tag_of_no_session_is_refused(monkeypatch):
    monkeypatch.setattr("firmware_sim.rules.records.opens", lambda _request: False)
    assert first_refusal(OPEN_RULES, OPEN_CASE) is Refusal.WRONG_SESSION


def test_of_two_reasons_against_an_open_the_earlier_one_is_given():
    """Only a holder of the key learns more than that a session is in use, or which version is spoken."""
    assert [refusal for refusal, _ in OPEN_RULES] == [
        Refusal.PROTOCOL_VERSION,
        Refusal.SESSION_IN_USE,
        Refusal.MAC_INVALID,
        Refusal.ANNOUNCE_NONCE,
        Refusal.IDENTITY_DIGEST,
        Refusal.WRONG_SESSION,
        Refusal.TIMING_OUT_OF_BOUNDS,
        Refusal.MEMORY_FULL,
    ]


def test_what_nobody_says_is_authentic_is_not():
    assert not RequestCase(OPENED, None, NOW).authentic
    for rules in (OPEN_RULES, PERMIT_RULES, START_RULES, RESET_RULES, ACKNOWLEDGE_RULES, WITHDRAW_RULES):
        assert not dict(rules)[Refusal.MAC_INVALID](RequestCase(OPENED, None, NOW))


@pytest.mark.parametrize("live", [True, False])
def test_a_withdrawal_of_no_place_in_particular_is_of_any_session_live_or_not(live):
    case = altered(WITHDRAW_CASE, "controller.session.live", live)
    assert first_refusal(WITHDRAW_RULES, case) is Refusal.ACCEPTED
    case = altered(case, "request.place_digest", records.NO_PLACE)
    assert first_refusal(WITHDRAW_RULES, case) is Refusal.ACCEPTED


@pytest.mark.parametrize(
    ("registered_us", "barrier_us", "refusal"),
    [
        (REGISTERED_US, records.NO_TIME, Refusal.ACCEPTED),
        (records.NO_TIME, records.NO_TIME, Refusal.ACCEPTED),
        (REGISTERED_US, REGISTERED_US - 1, Refusal.ACCEPTED),
        (REGISTERED_US, REGISTERED_US, Refusal.REGISTRATION_TOO_EARLY),
        (records.NO_TIME, 1, Refusal.REGISTRATION_TOO_EARLY),
        (-1, records.NO_TIME, Refusal.ACCEPTED),
        (-1, 1, Refusal.REGISTRATION_TOO_EARLY),
    ],
)
def test_only_a_registration_later_than_the_barrier_counts(registered_us, barrier_us, refusal):
    for case, rules in ((PERMIT_CASE, PERMIT_RULES), (START_CASE, START_RULES)):
        twin = altered(case, "controller.session.registration_time_us", registered_us)
        twin = altered(twin, "controller.memory.barrier_us", barrier_us)
        assert first_refusal(rules, twin) is refusal
        assert first_refusal(REGISTRATION_RULES, twin) is refusal


def test_a_withdrawn_registration_that_is_too_early_as_well_is_said_to_be_withdrawn():
    memory = Memory(withdrawn=frozenset({PLACE}), barrier_us=REGISTERED_US)
    case = altered(PERMIT_CASE, "controller.memory", memory)
    assert first_refusal(REGISTRATION_RULES, case) is Refusal.REGISTRATION_WITHDRAWN


def test_a_start_may_be_one_record_further_on_than_its_permit():
    assert START_LOG.size == PERMIT_LOG.size + 1
    case = changed(START_CASE, "request.log.size", PERMIT_LOG.size + 100)
    assert first_refusal(START_RULES, case) is Refusal.ACCEPTED


@pytest.mark.parametrize("clear", [True, False])
@pytest.mark.parametrize("cause", [StopCause.EMERGENCY_STOP, StopCause.BONE_MOVED])
def test_an_emergency_stop_is_acknowledged_once_it_is_released(cause, clear):
    case = altered(ACKNOWLEDGE_CASE, "request.cause", cause)
    case = altered(altered(case, "controller.cause", cause), "controller.inputs.emergency_stop_clear", clear)
    pressed = cause is StopCause.EMERGENCY_STOP and not clear
    assert first_refusal(ACKNOWLEDGE_RULES, case) is (Refusal.EMERGENCY_STOP if pressed else Refusal.ACCEPTED)


@pytest.mark.parametrize(
    ("rules", "cases"),
    [
        (PERMIT_RULES, PERMIT_CASES),
        (START_RULES, START_CASES),
        (RESET_RULES, RESET_CASES),
        (OPEN_RULES, [*OPEN_CASES, (Refusal.WRONG_SESSION,)]),
        (ACKNOWLEDGE_RULES, [*ACKNOWLEDGE_CASES, (Refusal.EMERGENCY_STOP,)]),
        (WITHDRAW_RULES, WITHDRAW_CASES),
    ],
    ids=[*NAMES, "open", "acknowledge", "withdraw"],
)
def test_no_reason_is_left_untested(rules, cases):
    assert {refusal for refusal, _ in rules} == {refusal for *_, refusal in cases}
    assert len({refusal for refusal, _ in rules}) == len(rules), "each rule has a reason of its own"


@pytest.mark.parametrize(
    ("case", "rules"), [*PASSING, (OPEN_CASE, OPEN_RULES), (ACKNOWLEDGE_CASE, ACKNOWLEDGE_RULES)]
)
def test_without_a_code_that_fits_nothing_else_is_looked_at(case, rules):
    """What the record says, configuration and verifier included, is bound by the code; the endpoint judges it."""
    twin = replace(case, authentic=False, now_s=math.nan)
    assert first_refusal(rules, twin) is Refusal.MAC_INVALID


@pytest.mark.parametrize("joint", range(5))
@pytest.mark.parametrize("sign", [1, -1])
def test_the_arm_stands_at_the_bound_start_joints_within_the_tolerance(joint, sign):
    measured = _joints(joint, sign * JUST_INSIDE[joint])
    for case, rules in ((PERMIT_CASE, PERMIT_RULES), (START_CASE, START_RULES)):
        assert first_refusal(rules, changed(case, "controller.measured_u", measured)) is Refusal.ACCEPTED


@pytest.mark.parametrize("joint", [0, 3])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_joint_without_limits_stands_and_goes_where_the_bus_surely_reports_it(joint, sign):
    """A cut leaves a revolution to spare; from where the arm stands it only comes back."""
    limits = records.Limits.parse(PERMIT_CASE.controller.holdings.limits)
    lower, upper = (
        tuple(end * 36_000_000_000 if j == joint else bound for j, bound in enumerate(bounds))
        for end, bounds in ((-1, limits.q_min_u), (1, limits.q_max_u))
    )
    wide = changed(
        PERMIT_CASE, "controller.holdings.limits", replace(limits, q_min_u=lower, q_max_u=upper).body()
    )

    def at(place, degrees):
        joints = START_JOINTS if place == "start_joints" else getattr(ENDS, f"{place}_joints_u")
        return _twin(wide, f"both.{place}", _moved(joints, joint, sign * degrees * 1_000_000 - joints[joint]))

    assert at_start(at("start_joints", 2600))
    assert not at_start(at("start_joints", 2601))
    own_approach = dict(PERMIT_RULES)[Refusal.APPROACH]
    for end in ("entry", "exit"):
        assert own_approach(at(end, 2261))
        assert not own_approach(at(end, 2262))


@pytest.mark.parametrize("by", [1, -1])
@pytest.mark.parametrize("end", ["entry", "exit"])
def test_entry_and_exit_agree_within_the_rounding_of_either_side(end, by):
    case = changed(PERMIT_CASE, f"request.approach.{end}_um", getattr(ENDS, f"{end}_um") + by)
    assert first_refusal(PERMIT_RULES, case) is Refusal.ACCEPTED
    for joint in range(5):
        joints = _moved(getattr(ENDS, f"{end}_joints_u"), joint, by * 10_000)
        case = changed(PERMIT_CASE, f"request.approach.{end}_joints_u", joints)
        assert first_refusal(PERMIT_RULES, case) is Refusal.ACCEPTED


@pytest.mark.parametrize(
    ("case", "rules", "field", "value"),
    [
        (PERMIT_CASE, PERMIT_RULES, "now_s", NOW + 120.0),
        (PERMIT_CASE, PERMIT_RULES, "request.log.size", 1),
        (START_CASE, START_RULES, "now_s", NOW + 2.0),
        (START_CASE, START_RULES, "controller.permit_issued_at_s", NOW - 120.0),
    ],
)
def test_the_bound_itself_is_inside(case, rules, field, value):
    assert first_refusal(rules, changed(case, field, value)) is Refusal.ACCEPTED


def test_a_permit_is_refused_the_second_time():
    after, _ = decide(PERMIT_CASE)
    _, effects = decide(replace(PERMIT_CASE, controller=after))
    assert replies(effects) == [Refusal.NOT_IN_STATE]


def test_a_start_is_refused_the_second_time_and_does_not_disturb_the_cut():
    after, effects = decide(replace(START_CASE, controller=CUTTING))
    assert replies(effects) == [Refusal.NOT_IN_STATE]
    assert after == CUTTING


def test_a_start_is_refused_while_another_one_waits_for_the_memory():
    waiting, _ = step(CYCLED, STARTING, NOW)
    case = replace(START_CASE, controller=waiting)
    assert first_refusal(START_RULES, case) is Refusal.NOT_IN_STATE


def test_a_start_without_a_permit_is_refused_whatever_else_holds():
    for controller in (LOADED, ASKED):
        _, effects = decide(replace(START_CASE, controller=controller))
        assert replies(effects) == [Refusal.NO_PERMIT]


def test_a_changed_limit_voids_the_permit_by_its_stop():
    """The digest rule stands behind it, for a change that no event announced."""
    stopped, _ = step(CYCLED, LimitsChanged(OTHER_BYTES), NOW)
    _, effects = decide(replace(START_CASE, controller=stopped))
    assert replies(effects) == [Refusal.VOIDED_BY_STOP]


def test_the_permit_s_nonce_serves_no_start():
    case = replace(START_CASE, controller=replace(CYCLED, issued=ASKED.issued))
    case = changed(case, "request.nonce", PERMIT_NONCE)
    assert first_refusal(START_RULES, case) is Refusal.NO_NONCE


def test_an_accepted_start_still_names_the_permit_that_was_accepted():
    assert records.digest(PERMIT.canonical()) == START_CASE.request.permit_digest
    assert START_CASE.controller.permit is not None


R = Refusal
WITHOUT_ITS_SESSION = {R.VOIDED_BY_STOP, R.WRONG_SESSION, R.NONCE_EXPIRED}
OF_ITS_REGISTRATION = {R.REGISTRATION_WITHDRAWN, R.REGISTRATION_TOO_EARLY}
WITHOUT_ITS_NONCE = {R.NO_NONCE, R.NONCE_MISMATCH, R.NONCE_EXPIRED}
OF_THE_SESSION = {R.REGISTRATION_DIGEST, R.CONFIGURATION_DIGEST, R.VERIFIER, R.TIMING_OUT_OF_BOUNDS}
MISSING = [
    (PERMIT_CASE, PERMIT_RULES, "controller.holdings.path", {R.PATH_DIGEST, R.BRANCH}),
    (PERMIT_CASE, PERMIT_RULES, "controller.issued", WITHOUT_ITS_NONCE),
    (
        PERMIT_CASE,
        PERMIT_RULES,
        "controller.session",
        WITHOUT_ITS_SESSION
        | OF_ITS_REGISTRATION
        | OF_THE_SESSION
        | {R.ANNOUNCE_NONCE, R.APPROACH_SPEED, R.START_JOINTS},
    ),
    (START_CASE, START_RULES, "controller.holdings.path", {R.PATH_DIGEST}),
    (START_CASE, START_RULES, "controller.issued", WITHOUT_ITS_NONCE),
    (
        START_CASE,
        START_RULES,
        "controller.session",
        WITHOUT_ITS_SESSION | OF_ITS_REGISTRATION | {R.PERMIT_EXPIRED, R.NOT_AT_START},
    ),
    (RESET_CASE, RESET_RULES, "controller.issued", WITHOUT_ITS_NONCE),
    (RESET_CASE, RESET_RULES, "controller.session", WITHOUT_ITS_SESSION),
    (ACKNOWLEDGE_CASE, ACKNOWLEDGE_RULES, "controller.session", {R.VOIDED_BY_STOP}),
    (WITHDRAW_CASE, WITHDRAW_RULES, "controller.session", {R.WRONG_SESSION}),
]


@pytest.mark.parametrize(
    ("case", "rules", "field", "denied"),
    MISSING,
    ids=[f"{type(case.request).__name__}-{field}" for case, _, field, _ in MISSING],
)
def test_every_rule_on_its_own_denies_where_its_subject_is_missing(case, rules, field, denied):
    """Not only the first that refuses."""
    twin = changed(case, field, None)
    assert {refusal for refusal, holds in rules if holds(twin) is False} == denied
    assert {refusal for refusal, holds in rules if holds(twin) is True} == {one for one, _ in rules} - denied


def test_a_case_stays_as_it_was():
    with pytest.raises(FrozenInstanceError):
        PERMIT_CASE.now_s = NOW + 1
