"""Approach and retract: what is admitted keeps every deadband on every leg, and nothing else is refused."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cutgate.runtime.verification.approach import report
from cutgate.runtime.verification.approach.decision import verify
from cutgate.runtime.verification.approach.model import StartJoints
from cutgate.runtime.verification.approach.straight_line import first_and_last_joints
from cutgate.runtime.verification.problem import Arm, ArmCalibration, Deadband
from tests.runtime.verification.approach.cuts import (
    ARCS,
    MIDDLE,
    cut,
    line_margins,
    random_case,
    spinning,
    straight_margins,
)
from tests.runtime.verification.cases import DEG


def sampled_leg(made, start, verdict, leg):
    """Margins of a leg at samples, whether all of them are inside, and how far the wrist moves between two."""
    ends = {"approach": (start.joints, verdict.entry), "retract": (verdict.exit, start.joints)}
    if leg.name in ends:
        return line_margins(made, *ends[leg.name])
    pose, length_um = (0, verdict.entry_um) if leg.name == "entry" else (-1, verdict.exit_um)
    sampled, dense, _ = straight_margins(made, pose, length_um, first_and_last_joints(made)[pose])
    return sampled, bool(dense.inside.all()), length_um / 1000 / 99


def agrees_with(b, sampled, step_mm, *, joint_line):
    """What is certified is true; what is attained on a joint line is the least, but for the survey's gap."""
    least = float(np.min(sampled))
    assert b.violated is not (b.certified >= b.deadband)
    assert b.certified <= least + 1e-6, b
    if joint_line and math.isfinite(least):
        slack = step_mm if b.name in ARCS else 1e-6
        assert b.clearance - 0.01 <= least <= b.clearance + slack, b
        assert b.clearance - b.certified <= 0.01


@given(st.integers(0, 2**32 - 1), st.booleans())
@settings(max_examples=40, deadline=None)
def test_an_approach_is_admitted_exactly_where_dense_sampling_keeps_every_deadband(seed, spinning):
    case = random_case(seed, spinning=spinning, segments=2)
    verdict = verify(*case) if case else None
    if verdict is None or not verdict.legs:
        return
    for leg in verdict.legs:
        joint_line = leg.name in {"approach", "retract"}
        if not np.isfinite([*verdict.entry, *verdict.exit]).all():
            assert not verdict.admissible
            return
        sampled, inside, step_mm = sampled_leg(*case, verdict, leg)
        if not inside:
            assert leg.reasons
            continue
        for b in leg.boundaries.values():
            if b.certified is not None:
                agrees_with(b, sampled[b.name], step_mm, joint_line=joint_line)
        if joint_line:
            assert bool(leg.reasons) is any(b.violated for b in leg.boundaries.values())
    assert verdict.admissible is not any(leg.reasons for leg in verdict.legs)


def test_the_middle_of_the_limits_is_a_start_for_the_example():
    verdict = verify(cut(), StartJoints(MIDDLE, 10_000, 0.5, 0.2 * DEG))
    assert verdict.admissible
    assert verdict.reasons == ()
    assert [leg.name for leg in verdict.legs] == ["approach", "entry", "exit", "retract"]
    assert "tightest is" in report.summary(verdict)
    for leg in (verdict.legs[0], verdict.legs[3]):
        assert "wrist_singularity" not in leg.boundaries
        assert leg.boundaries["top"].deadband == 5.5
        assert leg.boundaries["roll_min"].deadband == pytest.approx(2.2)
    assert "wrist_singularity" in verdict.legs[1].boundaries
    assert verdict.legs[1].boundaries["top"].deadband == 5.0


def test_residuals_and_tolerances_widen_the_deadbands_of_every_leg():
    arm = cut(
        calibration=ArmCalibration(residual_mm=0.3, residual_rad=0.1 * DEG),
        deadband=Deadband(5.0, 2 * DEG, path_tolerance_mm=0.2, path_tolerance_rad=0.05 * DEG),
    )
    verdict = verify(arm, StartJoints(MIDDLE, 10_000))
    for leg in verdict.legs:
        assert leg.boundaries["inner"].deadband == pytest.approx(5.5)
        assert leg.boundaries["pitch_min"].deadband == pytest.approx(2.15)


@pytest.mark.parametrize("turns", [-1, 0, 1])
def test_a_roll_that_must_unwind_turns_on_the_joint_line(turns):
    start = MIDDLE.copy()
    start[3] = 400 * DEG
    verdict = verify(replace(spinning(), branch=(0, turns)), StartJoints(start, 10_000))
    assert verdict.admissible
    assert verdict.entry[3] / DEG == pytest.approx(-54.103025 + 360 * turns, abs=1e-3)
    ends = (400.0, verdict.entry[3] / DEG)
    assert verdict.legs[0].boundaries["roll_max"].clearance == pytest.approx(700 - max(ends))
    assert verdict.legs[0].boundaries["roll_min"].clearance == pytest.approx(700 + min(ends))


def test_the_mirrored_arm_has_the_mirrored_verdict():
    mirror = np.array([-1.0, -1.0, 1.0, -1.0, 1.0])
    right = cut(
        calibration=ArmCalibration(
            joint_offset=np.array([0.01, 0.02, 1.0, 0.03, 0.01]), slide_tilt=np.array([0.01, 0.02])
        )
    )
    left = replace(
        right,
        tips_mm=right.tips_mm * (1, -1, 1),
        axes=right.axes * (1, -1, 1),
        arm=Arm(450.0, 450.0, "left"),
        lower=np.where(mirror < 0, -right.upper, right.lower),
        upper=np.where(mirror < 0, -right.lower, right.upper),
        calibration=ArmCalibration(
            joint_offset=right.calibration.joint_offset * mirror, slide_tilt=np.array([0.01, -0.02])
        ),
    )
    start = np.array([0.4, 1.2, 200.0, -1.0, 0.8])
    one, other = (verify(p, StartJoints(q, 7_000)) for p, q in ((right, start), (left, start * mirror)))
    np.testing.assert_allclose(one.entry * mirror, other.entry, atol=2e-8)
    swap = {"left": "right", "right": "left", "roll_min": "roll_max", "roll_max": "roll_min"}
    for a, b in zip(one.legs, other.legs, strict=True):
        for name, boundary in a.boundaries.items():
            twin = b.boundaries[swap.get(name, name)]
            assert twin.certified == pytest.approx(boundary.certified, abs=1e-5), (a.name, name)


@pytest.mark.parametrize(
    ("field", "value", "text"),
    [
        ("joints", np.array([0.0, 1.0, math.nan, 0.0, 1.0]), "start joints"),
        ("joints", np.zeros(4), "start joints"),
        ("clearance_um", -1, "approach_clearance is -1"),
        ("tolerance_mm", math.nan, "start_tolerance_mm is nan"),
        ("tolerance_rad", math.inf, "start_tolerance is inf"),
    ],
)
def test_a_start_that_is_none_is_refused(field, value, text):
    verdict = verify(cut(), replace(StartJoints(MIDDLE, 10_000), **{field: value}))
    assert (verdict.admissible, verdict.legs, verdict.entry) == (False, (), None)
    assert text in verdict.reasons[0]
    assert report.bound(verdict, 25) is None


def test_a_cut_without_a_branch_or_joints_has_no_approach():
    for bad, text in (
        (replace(cut(), branch=None), "no joint branch"),
        (replace(cut(), tips_mm=cut().tips_mm + 2000.0), "no joints"),
        (replace(cut(), tips_mm=cut().tips_mm * math.nan), "not all finite"),
    ):
        verdict = verify(bad, StartJoints(MIDDLE, 10_000))
        assert not verdict.admissible
        assert text in verdict.reasons[0]


def test_a_start_too_near_to_a_limit_is_told_once_which_joint_to_move():
    start = StartJoints(np.array([*MIDDLE[:2], 52.0, *MIDDLE[3:]]), 10_000)
    (reason,) = verify(cut(), start).reasons
    assert reason.startswith("the arm stands with q2 at 52.000 mm")
    assert "move q2 by +3.01 mm" in reason


def test_what_is_lacking_elsewhere_is_said_of_its_leg():
    high = replace(cut(), upper=np.array([80 * DEG, 145 * DEG, 300.0, 170 * DEG, 110 * DEG]))
    reasons = verify(high, StartJoints(MIDDLE, 60_000)).reasons
    legs = [reason.split(":")[0] for reason in reasons]
    assert "joint line from the start joints to the entry pose" in legs
    assert "straight line from the entry pose to the first pose" in legs
    assert "straight line from the last pose to the exit pose" in legs
    assert "joint line from the exit pose to the start joints" in legs


def test_what_is_lacking_elsewhere_is_said_beside_the_move_of_a_joint():
    high = replace(cut(), upper=np.array([80 * DEG, 145 * DEG, 300.0, 170 * DEG, 110 * DEG]))
    start = StartJoints(np.array([*MIDDLE[:2], 52.0, *MIDDLE[3:]]), 60_000)
    first, *others = verify(high, start).reasons
    assert "move q2 by +3.01 mm" in first
    assert any(reason.startswith("straight line from the entry pose") for reason in others)
    assert any(
        reason.startswith("joint line from the start joints to the entry pose: top") for reason in others
    )
    assert not any("bottom" in reason for reason in others)
