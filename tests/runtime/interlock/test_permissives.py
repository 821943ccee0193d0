"""Each permissive on its own: it alone fails, says why and what to do, and anything undefined denies."""

import math
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from cutgate.protocol import records
from cutgate.protocol.states import ControllerState, Refusal, StopCause
from cutgate.runtime.interlock import permissives as p
from cutgate.runtime.interlock.refusals import MEANING
from cutgate.runtime.interlock.state import DeviceCycle
from cutgate.runtime.kinematics.landmarks import NONE_ASKED, PointResidual
from tests.altering import altered
from tests.runtime.interlock.builders import CALIBRATION, JOB, MISSED, NOW, READY, START_JOINTS, VERDICT

STANDS = "not withdrawn, and later than every withdrawal"


TIME_US = JOB.registration_time_us
TOO_EARLY = "one of 2026-09-21 14:13:20 UTC is not surely later than the last withdrawal"
FROM = "what is taken from 2026-09-21 14:13:21 UTC on counts"
NOT_TOLD = "the bone moved before this session, and the controller is not yet told from when on one counts"
WITNESSED = "the log that it saw last is found, or the operator has confirmed"


def _off(joint: int, by: int) -> tuple[int, ...]:
    return tuple(count + by * (index == joint) for index, count in enumerate(START_JOINTS))


def points(*residuals_mm):
    return tuple(PointResidual(f"P{k}", off_mm) for k, off_mm in enumerate(residuals_mm))


CHECKED = "at least 2, each within 2 mm"


ALONE = [
    # one field, another value, the permissive that alone fails, what it shows, its bound
    ("announced_version", 3, p.protocol_version, "3", "4"),
    ("session.serial", "SIM-2", p.serial_number, "SIM-2", "SIM-1"),
    *(
        (
            "session.time_scale",
            scale,
            p.plant_speed,
            scale,
            "1, no simulation is allowed",
        )
        for scale in (0.0, -1.0, 0.001, 0.999, 1.001, 60.0, 1000.0, 1000.1, math.inf, math.nan)
    ),
    ("job.limits", b"other", p.limits_approved, None, None),
    ("job.calibration", b"other", p.calibration_approved, None, None),
    ("job.tool", b"other", p.tool_approved, None, None),
    (
        "stored.refusal",
        Refusal.POSE_OUTSIDE_LIMITS,
        p.path_accepted,
        "POSE_OUTSIDE_LIMITS at pose 0",
        "accepted",
    ),
    ("stored.digest", bytes(32), p.path_digest, "0" * 16, None),
    ("verdict.admissible", False, p.verdict_admissible, "admissible", "admissible"),
    ("verdict.path", b"v" * 32, p.verdict_current, "76" * 8, JOB.path_digest.hex()[:16]),
    ("verdict.limits", bytes(32), p.verdict_current, None, None),
    ("verdict.calibration", bytes(32), p.verdict_current, None, None),
    ("verdict.tool", bytes(32), p.verdict_current, None, None),
    ("job.registration_age_s", 3540.1, p.registration_age, 3600.1, "<= 3600 s"),
    ("job.registration_age_s", math.nan, p.registration_age, math.nan, "<= 3600 s"),
    ("job.registration_age_s", -61.0, p.registration_age, -1.0, "<= 3600 s"),
    ("began_s", None, p.registration_age, "not known", "<= 3600 s"),
    ("job.registration_residual_mm", 1.01, p.registration_residual, 1.01, "<= 1 mm"),
    ("job.registration_residual_mm", -0.01, p.registration_residual, -0.01, "<= 1 mm"),
    ("job.registration_residual_mm", math.nan, p.registration_residual, math.nan, "<= 1 mm"),
    ("job.registration_residual_mm", None, p.registration_residual, "not known", "<= 1 mm"),
    ("job.check_points.points", (), p.check_points, "none", CHECKED),
    ("job.check_points.points", points(0.5), p.check_points, "P0 is 0.5 mm off", CHECKED),
    (
        "job.check_points.points",
        points(0.5, 2.01),
        p.check_points,
        "of 2 the worst, P1 is 2.01 mm off",
        CHECKED,
    ),
    ("job.check_points.points", points(-0.1, 0.0), p.check_points, None, CHECKED),
    (
        "job.check_points.points",
        points(math.nan, 0.0),
        p.check_points,
        "of 2 the worst, P0 is nan mm off",
        CHECKED,
    ),
    (
        "job.check_points.points",
        points(math.inf, 0.0),
        p.check_points,
        "of 2 the worst, P0 is inf mm off",
        CHECKED,
    ),
    ("job.check_points.tolerance_mm", 1.0, p.check_points, None, "at least 2, each within 1 mm"),
    ("job.check_points.least", 3, p.check_points, None, "at least 3, each within 2 mm"),
    (
        "verdict.to_confirm",
        ("CUT_TINY", "LIMITS_IN_RADIANS"),
        p.warnings_confirmed,
        "waits for CUT_TINY, LIMITS_IN_RADIANS",
        "each one that asks for it",
    ),
    ("registration_withdrawn", True, p.registration_stands, "withdrawn", STANDS),
    (
        "job.withdrawal",
        "the same place was withdrawn",
        p.registration_stands,
        "the same place was withdrawn",
        STANDS,
    ),
    (
        "opened.registration",
        Refusal.REGISTRATION_WITHDRAWN,
        p.registration_stands,
        "withdrawn at the controller",
        STANDS,
    ),
    (
        "opened.registration",
        Refusal.REGISTRATION_TOO_EARLY,
        p.registration_stands,
        f"{TOO_EARLY} that the controller knows",
        STANDS,
    ),
    (
        "opened.registration",
        Refusal.MEMORY_FAILED,
        p.registration_stands,
        f"{TOO_EARLY} that the controller knows",
        STANDS,
    ),
    (
        "opened.barrier_us",
        TIME_US,
        p.registration_stands,
        f"{TOO_EARLY} that the controller knows; {FROM}",
        STANDS,
    ),
    ("opened.barrier_us", TIME_US + 59_000_000, p.registration_stands, None, STANDS),
    ("opened.withdrawal_due", 1, p.registration_stands, NOT_TOLD, STANDS),
    ("barrier_us", TIME_US, p.registration_stands, f"{TOO_EARLY} that the controller knows; {FROM}", STANDS),
    ("witness", None, p.controllers_witness, "being looked up", WITNESSED),
    ("witness", MISSED, p.controllers_witness, "no log is there", WITNESSED),
    ("log.writable", False, p.log_writable, "failed", "writable"),
    ("log.reserved_bytes", 1999, p.log_space, 1999.0, ">= 2000 bytes"),
    ("log.reserved_bytes", 0, p.log_space, 0.0, ">= 2000 bytes"),
    ("heartbeat_fresh", False, p.heartbeat_fresh, "stale or never seen", "fresh within 100 ms"),
    ("controller.cause", StopCause.BONE_MOVED, p.no_stop_cause, "BONE_MOVED", "NONE"),
    ("controller.emergency_stop_clear", False, p.emergency_stop, "pressed", "clear"),
    ("controller.epoch", 4, p.epoch_current, "4", "3"),
    ("controller.state", ControllerState.LOADED, p.cutting_mode, "LOADED", "PERMITTED"),
    ("controller.cutting_mode", False, p.cutting_mode, "PERMITTED", "PERMITTED"),
    ("permit", None, p.permit_alive, "not known", "<= 120 s"),
    ("nonce_at_s", NOW - 120.1, p.permit_alive, 120.1, "<= 120 s"),
    ("nonce_at_s", NOW + 0.1, p.permit_alive, -0.1, "<= 120 s"),
    ("nonce_at_s", math.nan, p.permit_alive, math.nan, "<= 120 s"),
    (
        "controller.device_pressed",
        False,
        p.device_cycled,
        "pressed",
        "released, then pressed, after the permit",
    ),
    ("device", DeviceCycle.RELEASED, p.device_cycled, "released", "released, then pressed, after the permit"),
    ("device", DeviceCycle.UNSEEN, p.device_cycled, "held since before the permit, or not seen", None),
    ("joints_u", _off(0, 31_832), p.start_distance, 0.5000160, "<= 0.5 mm"),
    ("joints_u", _off(0, -31_832), p.start_distance, 0.5000160, "<= 0.5 mm"),
    ("joints_u", _off(1, 63_663), p.start_distance, 0.5000081, "<= 0.5 mm"),
    ("joints_u", _off(2, 500_001), p.start_distance, 0.500001, "<= 0.5 mm"),
    ("joints_u", _off(2, -500_001), p.start_distance, 0.500001, "<= 0.5 mm"),
    ("joints_u", _off(3, 200_001), p.start_angle, 0.200001, "<= 0.2 deg"),
    ("joints_u", _off(3, 360_000_000), p.start_angle, 360.0, "<= 0.2 deg"),
    ("joints_u", _off(4, -200_001), p.start_angle, 0.200001, "<= 0.2 deg"),
    ("verdict.approach", None, p.approach_admissible, "every leg keeps every deadband", None),
    ("verdict.trajectory", None, p.trajectory_known, "none", "known: the moving arm is held against it"),
    ("measured_s", NOW - 0.101, p.joints_age, 0.101, "<= 0.1 s"),
    ("measured_s", NOW + 0.001, p.joints_age, -0.001, "<= 0.1 s"),
    ("measured_s", -math.inf, p.joints_age, math.inf, "<= 0.1 s"),
    ("measured_s", math.nan, p.joints_age, math.nan, "<= 0.1 s"),
]


def _name(evaluate: p.Evaluate) -> str:
    return evaluate(READY, NOW).name


@pytest.mark.parametrize("which", [p.FOR_PERMIT, p.FOR_START, p.FOR_RESET, p.COLLECTED, p.FINAL])
def test_all_hold_in_the_baseline_state(which):
    assert p.failing(which, READY, NOW) == ()
    assert p.all_hold(which, READY, NOW)
    assert all(one.bound and one.remedy and str(one) for one in p.evaluate(which, READY, NOW))


@pytest.mark.parametrize(
    ("field", "value", "evaluate", "shown", "bound"),
    ALONE,
    ids=[f"{number}-{field}={value!r:.110}" for number, (field, value, *_) in enumerate(ALONE)],
)
def test_each_permissive_fails_alone(field, value, evaluate, shown, bound):
    state = altered(READY, field, value)

    failing = p.failing(p.FOR_START, state, NOW)

    assert [one.name for one in failing] == [_name(evaluate)]
    (one,) = failing
    assert (one.value is None) != (one.text is None), "a number or a text, never both"
    if isinstance(shown, float):
        assert one.value == pytest.approx(shown, nan_ok=True)
    elif shown is not None:
        assert one.text == shown
    assert one.bound == bound if bound is not None else one.bound
    assert one.remedy
    assert one.remedy in str(one)
    assert one.bound in str(one)


def test_a_latched_controller_alone_denies_the_permit():
    state = altered(READY, "controller.state", ControllerState.FAULT)
    assert [one.name for one in p.failing(p.FOR_PERMIT, state, NOW)] == [_name(p.not_latched)]
    assert _name(p.not_latched) in {one.name for one in p.failing(p.FOR_START, state, NOW)}


def test_the_table_above_leaves_no_permissive_out():
    assert {evaluate for *_, evaluate, _, _ in ALONE} | {p.not_latched} == set(p.FOR_START)
    assert len(set(p.FOR_START)) == len(p.FOR_START)
    assert len({_name(one) for one in p.FOR_START}) == len(p.FOR_START), "names are unique"


@pytest.mark.parametrize(
    ("field", "evaluates"),
    [
        ("announced_version", [p.protocol_version]),
        ("session", [p.serial_number, p.plant_speed]),
        ("opened", [p.registration_stands, p.controllers_witness]),
        ("collected.limits", [p.limits_approved]),
        ("collected.calibration", [p.calibration_approved]),
        ("collected.tool", [p.tool_approved]),
        ("stored", [p.path_accepted, p.path_digest]),
        (
            "verdict",
            [
                p.verdict_admissible,
                p.verdict_current,
                p.approach_admissible,
                p.trajectory_known,
            ],
        ),
        ("joints_u", [p.joints_age]),
        (
            "controller",
            [
                p.no_stop_cause,
                p.not_latched,
                p.emergency_stop,
                p.epoch_current,
                p.cutting_mode,
                p.device_cycled,
            ],
        ),
    ],
)
def test_what_was_never_seen_does_not_hold(field, evaluates):
    state = altered(READY, field, None)
    for evaluate in evaluates:
        one = evaluate(state, NOW)
        assert one.holds is False
        assert one.text
        assert one.value is None


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"q_max_u": (80_000_000, 140_000_000, 450_000_000, 170_000_000, 110_000_000)}, "q1 upper limit is 140 deg, approved: "),
        ({"speed_u": (1, 2, 3, 4, 5)}, "; q4 speed limit is"),
        ({"speed_u": (1, 2, 3, 4, 5), "q_max_u": (80_000_000, 140_000_000, 450_000_000, 170_000_000, 110_000_000)}, "; q3 speed limit is "),
        ({"speed_u": (1, 2, 3, 4, 5), "q_max_u": (80_000_000, 140_000_000, 450_000_000, 170_000_000, 110_000_000)}, " (and 1 more: audit show has all)"),
    ],
)  # fmt: skip
def test_other_limits_are_told_with_both_values(changes, told):
    other = replace(records.Limits.parse(READY.collected.limits), **changes)
    state = altered(READY, "collected.limits", other.body())
    one = p.limits_approved(state, NOW)
    assert not one.holds
    assert told in one.text
    assert ("more" in one.text) is (one.text.count("approved: ") == 5 and len(changes) > 1)
    assert p.limits_approved(READY, NOW).text == "equal"
    assert p.limits_approved(altered(READY, "collected.limits", None), NOW).text == "not received"


@pytest.mark.parametrize("age_s", [0.11, -0.01, math.inf, math.nan])
def test_an_old_measurement_is_not_the_arm_now(age_s):
    state = replace(READY, measured_s=NOW - age_s)
    assert p.measured_now(state, NOW) is None
    for which in (p.FOR_PERMIT, p.FOR_START):
        assert [one.name for one in p.failing(which, state, NOW)] == [_name(p.joints_age)]


@pytest.mark.parametrize("age_s", [0.0, 0.1])
def test_a_measurement_is_the_arm_now_up_to_the_time_out(age_s):
    assert p.measured_now(replace(READY, measured_s=0.0), age_s) == START_JOINTS
    assert p.measured_now(replace(READY, measured_s=NOW), NOW + age_s / 2) == START_JOINTS


def test_the_links_are_as_long_as_they_were_calibrated():
    """Both links sweep what the shoulder turns by, the forearm what the elbow adds to it."""
    long = replace(CALIBRATION, upper_link_error_u=7_000_000, forearm_link_error_u=3_000_000)
    one_deg = records.UNIT
    turned, _ = p.start_offset(long, (one_deg, 2 * one_deg, 0, 0, 0), (0,) * 5)
    assert turned == pytest.approx(math.radians(1) * 457.0 + math.radians(3) * 453.0)


def test_joints_of_another_number_are_no_measurement():
    with pytest.raises(ValueError, match="zip"):
        p.start_offset(CALIBRATION, (0,) * 6, (0,) * 5)


def test_what_was_judged_stays_as_it_was():
    with pytest.raises(FrozenInstanceError):
        p.start_distance(READY, NOW).holds = True


def test_an_undefined_time_denies_whatever_depends_on_it():
    assert {one.name for one in p.failing(p.FOR_START, READY, math.nan)} == {
        _name(p.registration_age),
        _name(p.permit_alive),
        _name(p.joints_age),
    }


def test_the_registration_grows_older_during_the_session():
    assert p.registration_age(READY, NOW).value == 160.0
    assert p.registration_age(READY, NOW + 3440.0).holds
    assert not p.registration_age(READY, NOW + 3440.1).holds


def test_without_a_configured_bound_the_age_is_shown_and_holds():
    one = p.registration_age(altered(READY, "job.registration_max_age_s", None), NOW)
    assert (one.holds, one.text, one.bound) == (True, "100 s", "no bound is configured")


@pytest.mark.parametrize(("residual_mm", "text"), [(3.5, "3.5 mm"), (None, "not known")])
def test_without_a_configured_bound_the_residual_is_shown_and_holds(residual_mm, text):
    without = altered(READY, "job.registration_max_residual_mm", None)
    one = p.registration_residual(altered(without, "job.registration_residual_mm", residual_mm), NOW)
    assert (one.holds, one.text, one.bound) == (True, text, "no bound is configured")


def test_without_check_points_that_are_asked_for_none_is_missed_and_one_that_is_there_counts():
    asked = altered(READY, "job.check_points", NONE_ASKED)
    one = p.check_points(asked, NOW)
    assert (one.holds, one.text, one.bound) == (True, "none", "each within 2 mm")
    assert not p.check_points(altered(asked, "job.check_points.points", points(2.5)), NOW).holds


def test_what_to_do_about_check_points_depends_on_what_is_wrong_with_them():
    missing = p.check_points(altered(READY, "job.check_points.least", 5), NOW)
    assert missing.remedy.startswith("touch 3 more landmarks with the probe and write them into check_points")
    off = p.check_points(altered(READY, "job.check_points.points", points(5.0, 9.0)), NOW)
    assert off.remedy.startswith(
        "touch the point again; if it stays off, check the registration's units, direction"
    )
    hostile = (PointResidual("\x1b[2J\n", 5.0), PointResidual("P", 0.0))
    assert p.check_points(altered(READY, "job.check_points.points", hostile), NOW).text == (
        "of 2 the worst, \\x1b[2J\\n is 5 mm off"
    )


def test_each_warning_is_confirmed_by_its_own_code_and_the_remedy_names_the_rest():
    two = altered(READY, "verdict.to_confirm", ("CUT_TINY", "LIMITS_IN_RADIANS"))
    one = p.warnings_confirmed(altered(two, "confirmed", frozenset({"CUT_TINY", "CUT_HUGE"})), NOW)
    assert (one.holds, one.text) == (False, "waits for LIMITS_IN_RADIANS")
    assert one.remedy.endswith("say confirm LIMITS_IN_RADIANS")
    both = altered(two, "confirmed", frozenset({"CUT_TINY", "LIMITS_IN_RADIANS"}))
    confirmed = p.warnings_confirmed(both, NOW)
    assert (confirmed.holds, confirmed.text) == (True, "confirmed: CUT_TINY, LIMITS_IN_RADIANS")
    assert p.unconfirmed(altered(two, "verdict", None)) == ()
    unknown = p.warnings_confirmed(altered(two, "verdict", None), NOW)
    assert (unknown.holds, unknown.text) == (False, "not verified")
    assert p.warnings_confirmed(READY, NOW).text == "none waits"


@pytest.mark.parametrize("field", ["opened.barrier_us", "barrier_us"])
def test_a_registration_must_be_later_than_every_barrier(field):
    assert p.registration_stands(altered(READY, field, TIME_US - 1), NOW).holds
    both = altered(altered(READY, "opened.barrier_us", TIME_US - 1), "barrier_us", TIME_US - 2)
    assert p.registration_stands(both, NOW).holds
    for one, other in (("opened.barrier_us", "barrier_us"), ("barrier_us", "opened.barrier_us")):
        said = p.registration_stands(
            altered(altered(READY, one, TIME_US + 60_000_000), other, TIME_US - 1), NOW
        )
        assert not said.holds
        assert said.text.endswith("what is taken from 2026-09-21 14:14:21 UTC on counts"), (
            "the later of the two"
        )


def test_without_a_time_no_registration_is_later_than_a_barrier():
    undated = altered(READY, "job.registration_time_us", records.NO_TIME)
    assert p.registration_stands(undated, NOW).holds, "nothing was ever withdrawn"
    for barrier_us in (TIME_US, -1):
        said = p.registration_stands(altered(undated, "opened.barrier_us", barrier_us), NOW)
        assert not said.holds
        assert said.text.startswith("one without a time is not surely later than the last withdrawal")


@pytest.mark.parametrize("time_us", [TIME_US, records.NO_TIME])
def test_a_barrier_that_lies_ahead_tells_that_a_clock_was_wrong_and_what_mends_that(time_us):
    """To register again would be refused as well. No barrier is told more than an hour ahead of a clock."""
    for opened in ({}, {"opened.registration": Refusal.REGISTRATION_WITHDRAWN}):
        state = altered(READY, "job.registration_time_us", time_us)
        for field, value in opened.items():
            state = altered(state, field, value)
        hour_us = JOB.prepared_us + 3_600_000_000
        near = p.registration_stands(altered(state, "opened.barrier_us", hour_us), NOW)
        ahead = p.registration_stands(altered(state, "opened.barrier_us", hour_us + 1), NOW)
        for said in (near, ahead):
            assert not said.holds
            assert said.text.endswith("; what is taken from 2026-09-21 15:14:21 UTC on counts")
        assert near.remedy == "the bone may have moved: register it again"
        assert ahead.remedy == (
            "a clock was set wrong as it was withdrawn, or this one is: set it right; where it is, that goes only with a new "
            "key and memory of the controller (docs/controllers.md, Keys)"
        )


def test_a_motion_without_a_session_is_over_once_the_controller_is_told_a_barrier():
    due = altered(READY, "opened.withdrawal_due", 1)
    assert p.registration_stands(altered(due, "barrier_us", TIME_US - 1), NOW).holds
    assert not p.registration_stands(altered(due, "barrier_us", TIME_US), NOW).holds
    earlier = altered(due, "opened.barrier_us", TIME_US - 1)
    assert p.registration_stands(earlier, NOW).text == NOT_TOLD, "an older barrier is none of this motion's"


def test_what_is_withdrawn_at_the_controller_stays_so_however_late_it_was_registered():
    withdrawn = altered(READY, "opened.registration", Refusal.REGISTRATION_WITHDRAWN)
    said = p.registration_stands(altered(withdrawn, "opened.barrier_us", TIME_US - 1), NOW)
    assert (said.holds, said.text) == (
        False,
        "withdrawn at the controller; what is taken from 2026-09-21 14:13:20 UTC on counts",
    )


@pytest.mark.parametrize(
    ("time_us", "shown"),
    [
        (0, "1970-01-01 00:00:00 UTC"),
        (999_999, "1970-01-01 00:00:00 UTC"),
        (-1, "1969-12-31 23:59:59 UTC"),
        ((1 << 63) - 1, "9223372036854775807 us since 1970"),
        (-(1 << 63), "-9223372036854775808 us since 1970"),
    ],
)
def test_any_time_that_a_record_can_hold_is_shown(time_us, shown):
    assert p.utc(time_us) == shown


def test_a_controller_that_saw_no_log_is_no_witness():
    none = altered(altered(READY, "opened.log", records.NO_TREE_HEAD), "witness", None)
    judged = p.controllers_witness(none, NOW)
    assert (judged.holds, judged.text) == (True, "it has seen no start yet")
    for field, value in (("size", 1), ("log_id", b"l" * 16), ("root", b"r" * 32)):
        assert not p.controllers_witness(altered(none, f"opened.log.{field}", value), NOW).holds


def test_a_log_that_is_missed_is_confirmed_by_its_own_word_alone_and_the_log_shows_it():
    missed = altered(READY, "witness", MISSED)
    assert p.awaiting_confirmation(missed) == ("WITNESS",)
    assert not p.controllers_witness(altered(missed, "confirmed", frozenset({"CUT_TINY"})), NOW).holds
    confirmed = altered(missed, "confirmed", frozenset({"WITNESS"}))
    judged = p.controllers_witness(confirmed, NOW)
    assert (judged.holds, judged.text) == (True, "confirmed: no log is there")
    assert p.awaiting_confirmation(confirmed) == ()
    early = altered(altered(READY, "witness", None), "confirmed", frozenset({"WITNESS"}))
    assert not p.controllers_witness(early, NOW).holds, "it was not shown"
    found = altered(READY, "confirmed", frozenset({"WITNESS"}))
    assert p.controllers_witness(found, NOW).text == "found in earlier.mcap"
    warned = altered(missed, "verdict.to_confirm", ("CUT_TINY",))
    assert p.awaiting_confirmation(warned) == ("CUT_TINY", "WITNESS")
    assert p.awaiting_confirmation(altered(READY, "witness", None)) == ()
    assert p.unrecoverable(missed, NOW) == ()


SIMULATION = altered(READY, "job.simulation_allowed_by", "site.toml")


@pytest.mark.parametrize("scale", [0.001, 1.0, 60.0, 1000.0])
def test_a_simulated_plant_runs_at_any_speed_where_the_site_allows_it_and_the_log_shows_both(scale):
    judged = p.plant_speed(altered(SIMULATION, "session.time_scale", scale), NOW)
    assert judged.holds is True
    assert (judged.value, judged.bound) == (scale, "up to 1000, a simulation is allowed by site.toml")


@pytest.mark.parametrize("scale", [0.0, -1.0, 1000.1, math.inf, math.nan])
def test_no_speed_that_is_none_is_allowed_in_a_simulation(scale):
    assert p.plant_speed(altered(SIMULATION, "session.time_scale", scale), NOW).holds is False


def test_a_plant_that_keeps_the_clock_s_time_needs_no_word_of_the_site():
    judged = p.plant_speed(READY, NOW)
    assert (judged.holds, judged.value, judged.bound) == (True, 1.0, "1, no simulation is allowed")


def test_who_is_refused_for_its_speed_is_told_how_a_simulation_is_allowed():
    remedy = p.plant_speed(altered(READY, "session.time_scale", 50.0), NOW).remedy
    assert "simulated = true under [controller] in site.toml" in remedy
    assert "--allow-simulated" in remedy
    allowed = altered(READY, "job.simulation_allowed_by", "site.toml")
    too_fast = p.plant_speed(altered(allowed, "session.time_scale", 2000.0), NOW)
    assert not too_fast.holds
    assert "simulated" not in too_fast.remedy, "it is allowed already"


@pytest.mark.parametrize("which", [p.IDENTITY, p.FOR_RESET, p.COLLECTED, p.FOR_PERMIT, p.FOR_START])
def test_another_speed_than_the_clock_s_is_refused_wherever_something_is_enabled(which):
    assert p.all_hold(which, READY, NOW)
    assert not p.all_hold(which, altered(READY, "session.time_scale", 50.0), NOW)


def test_any_controller_will_do_where_no_serial_number_is_configured():
    state = altered(altered(READY, "job.serial", None), "session.serial", "SIM-9")
    assert p.serial_number(state, NOW).holds
    assert not p.serial_number(replace(state, session=None), NOW).holds


@pytest.mark.parametrize("field", ["verdict", "joints_u", "collected.calibration"])
def test_an_arm_of_which_nothing_is_known_stands_nowhere(field):
    state = altered(READY, field, None)
    for evaluate in (p.start_distance, p.start_angle):
        one = evaluate(state, NOW)
        assert (one.holds, one.value, one.text) == (False, None, "not known")


@pytest.mark.parametrize(
    "value", [np.float64("nan"), math.nan, math.inf, -0.1], ids=["numpy", "nan", "inf", "less"]
)
def test_a_value_that_is_undefined_or_none_is_not_at_most_its_bound(value):
    assert p._at_most("some", value, 0.5, "mm", "none").holds is False


def test_numpy_numbers_hold_as_python_numbers_do():
    """A comparison of numpy floats is not the object True; taken literally it would never hold."""
    assert p._at_most("some", np.float64(0.5), 0.5, "mm", "none").holds is True


@pytest.mark.parametrize(
    ("field", "value", "holds"),
    [
        ("joints_u", _off(2, 500_000), True),
        ("joints_u", _off(0, 31_830), True),
        ("joints_u", _off(1, -63_661), True),
        ("joints_u", _off(3, 200_000), True),
        ("joints_u", _off(4, -200_000), True),
        ("nonce_at_s", NOW - 120.0, True),
        ("log.reserved_bytes", 2000, True),
    ],
)
def test_the_bound_itself_is_inside(field, value, holds):
    assert p.all_hold(p.FOR_START, altered(READY, field, value), NOW) is holds


def test_only_the_object_true_counts_as_holding():
    def nearly(_state, _now_s):
        return p.Permissive("nearly", 1, None, "1", "True", "none")

    assert not p.all_hold((nearly,), READY, NOW)
    assert [one.name for one in p.failing((nearly,), READY, NOW)] == ["nearly"]


def test_hopeless_is_what_no_act_can_cure():
    assert p.unrecoverable(READY, NOW) == ()
    inadmissible = replace(READY, verdict=replace(VERDICT, admissible=False))
    assert [one.name for one in p.unrecoverable(inadmissible, NOW)] == [_name(p.verdict_admissible)]
    for curable in (
        replace(READY, heartbeat_fresh=False),
        replace(READY, controller=None),
        altered(READY, "controller.emergency_stop_clear", False),
    ):
        assert p.unrecoverable(curable, NOW) == ()
        assert not p.all_hold(p.FOR_PERMIT, curable, NOW)


HOPELESS = [
    (field, value, evaluate)
    for field, value, evaluate, *_ in ALONE
    if evaluate
    in set(p.COLLECTED)
    | {p.path_accepted, p.path_digest, p.verdict_admissible, p.verdict_current, p.approach_admissible}
    | {p.registration_age, p.registration_residual, p.check_points, p.registration_stands, p.log_writable}
]


@pytest.mark.parametrize(
    ("field", "value", "evaluate"), HOPELESS, ids=[f"{field}={value!r:.110}" for field, value, _ in HOPELESS]
)
def test_what_no_act_can_cure_is_not_waited_for(field, value, evaluate):
    assert [one.name for one in p.unrecoverable(altered(READY, field, value), NOW)] == [_name(evaluate)]


def test_what_only_follows_from_another_failure_is_not_told_beside_it():
    """A path that is inadmissible has neither approach nor trajectory, and nobody can do anything about those."""
    none = altered(altered(READY, "verdict.approach", None), "verdict.trajectory", None)
    assert [one.name for one in p.unrecoverable(none, NOW)] == [_name(p.approach_admissible)]
    refused = altered(none, "verdict.admissible", False)
    assert [one.name for one in p.unrecoverable(refused, NOW)] == [_name(p.verdict_admissible)]
    assert _name(p.trajectory_known) in {one.name for one in p.failing(p.FOR_PERMIT, refused, NOW)}


def test_a_reset_needs_the_same_controller_at_rest_and_the_log():
    assert set(p.FOR_RESET) == {
        p.protocol_version,
        p.serial_number,
        p.plant_speed,
        p.log_writable,
        p.heartbeat_fresh,
        p.no_stop_cause,
        p.emergency_stop,
        p.epoch_current,
    }


def test_space_is_hopeless_only_after_the_file_system_has_answered():
    assert p.unrecoverable(altered(READY, "log.reserved_bytes", 0), NOW) == ()
    assert [one.name for one in p.unrecoverable(altered(READY, "log.reserved_bytes", 1), NOW)] == [
        _name(p.log_space)
    ]


def test_what_holds_is_shown_without_a_remedy():
    one = p.start_distance(READY, NOW)
    assert str(one) == "measured wrist centre to the verified start: 0 (required: <= 0.5 mm)"


def test_every_list_is_part_of_the_next():
    assert set(p.IDENTITY) < set(p.COLLECTED) < set(p.FOR_PERMIT) < set(p.FOR_START)
    assert set(p.FINAL) < set(p.FOR_PERMIT)
    assert set(p.FOR_RESET) < set(p.FOR_PERMIT)
    assert JOB.registration_max_age_s is not None


def remedy(evaluate, **changes):
    """What is to be done, in this state."""
    state = READY
    for field, value in changes.items():
        state = altered(state, field.replace("__", "."), value)
    one = evaluate(state, NOW)
    assert not one.holds
    return one.remedy


def test_a_remedy_fits_what_stands_and_not_only_what_is_missing():
    pressed = {"controller__emergency_stop_clear": False}
    assert remedy(p.emergency_stop, **pressed) == "release the emergency stop"
    assert "bus" in remedy(p.emergency_stop, controller=None)
    assert remedy(p.device_cycled, device=DeviceCycle.RELEASED) == "hold it"
    assert remedy(p.device_cycled, device=DeviceCycle.UNSEEN) == "release it, then hold it"
    stopped = {"controller__cause": StopCause.EMERGENCY_STOP}
    assert remedy(p.no_stop_cause, **stopped) == "say acknowledge"
    assert remedy(p.no_stop_cause, **stopped, **pressed) == "release the emergency stop, then say acknowledge"
    assert remedy(p.no_stop_cause, controller__cause=StopCause.BONE_MOVED, **pressed) == "say acknowledge"


def test_a_path_that_the_controller_refuses_is_cured_by_what_it_was_refused_for():
    for refusal in (
        Refusal.POSE_OUTSIDE_LIMITS,
        Refusal.TOOL_LENGTH,
        Refusal.WRONG_ELBOW,
        Refusal.PATH_MALFORMED,
    ):
        assert remedy(p.path_accepted, stored__refusal=refusal) == MEANING[refusal]
    assert "move the bone" in MEANING[Refusal.POSE_OUTSIDE_LIMITS]
    assert "move the bone" not in MEANING[Refusal.TOOL_LENGTH]
    assert "upload" in remedy(p.path_accepted, stored=None)


def test_a_clearance_of_nothing_is_not_to_be_lowered():
    for clearance_mm, lowered in ((10.0, True), (0.5, True), (0.0, False)):
        there = {"job__timing__approach_clearance_um": round(clearance_mm * 1000)}
        said = remedy(p.approach_admissible, verdict__approach=None, **there)
        assert ("lower approach_clearance_mm" in said) is lowered


def test_what_only_follows_goes_by_the_names_that_logs_have():
    assert {permissive(READY, NOW).name for permissive in p.FOLLOWS} == p.FOLLOWING
