"""Which joint an arm that stands too near to a limit is told to move, how far and which way."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from cutgate.runtime.verification.approach.decision import verify
from cutgate.runtime.verification.approach.model import StartJoints
from cutgate.runtime.verification.approach.standing import standing
from cutgate.runtime.verification.bounds.geometry import canonical
from cutgate.runtime.verification.problem import ArmCalibration, Deadband
from tests.runtime.verification.approach.cuts import MIDDLE, cut, random_case
from tests.runtime.verification.cases import DEG


def told(verdict, stands):
    """The joints after the moves that the sentences ask for."""
    moved = np.array(stands, float)
    for sentence in verdict.reasons:
        match = re.search(r"move q(\d) by [+-][\d.]+ (deg|mm), to (-?[\d.]+) (deg|mm)$", sentence)
        if match:
            moved[int(match[1])] = float(match[3]) * (1.0 if match[4] == "mm" else DEG)
    return moved


@pytest.mark.parametrize("far", [0.0, 0.3, -0.3], ids=["at its limit", "inside", "beyond"])
@pytest.mark.parametrize("end", ["lower", "upper"])
@pytest.mark.parametrize("joint", range(5))
def test_an_arm_at_a_limit_is_told_which_joint_to_move_and_may_begin_there(joint, end, far):
    arm, stands = cut(), MIDDLE.copy()
    limit = getattr(arm, end)[joint]
    stands[joint] = limit + far * (1.0 if joint == 2 else DEG) * (1.0 if end == "lower" else -1.0)
    tolerances = {"tolerance_mm": 0.5, "tolerance_rad": 0.5 * DEG}
    verdict = verify(arm, StartJoints(stands, 10_000, **tolerances))
    assert not verdict.admissible
    assert len(verdict.reasons) == 1
    assert f"move q{joint} by {'+' if end == 'lower' else '-'}" in verdict.reasons[0]
    moved = told(verdict, stands)
    assert verify(arm, StartJoints(moved, 10_000, **tolerances)).admissible
    short = stands + (moved - stands) * 0.95 if joint > 1 else moved
    assert joint <= 1 or not verify(arm, StartJoints(short, 10_000, **tolerances)).admissible


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_after_the_moves_that_it_is_told_no_arm_stands_too_near_to_a_limit(seed):
    """Both elbows, calibrated arms, several joints at once, shoulders of less and of more than a turn."""
    rng = np.random.default_rng(seed)
    case = random_case(seed, spinning=bool(rng.integers(2)))
    assume(case is not None)
    made, start = case
    part = rng.choice([-0.01, 0.0, 0.001, 0.5, 0.999, 1.0, 1.01], 5)
    stands = made.lower + part * (made.upper - made.lower)
    verdict = verify(made, replace(start, joints=stands))
    assume(verdict.legs and not re.search("no place|stand.*elsewhere", str(verdict.reasons)))
    after = verify(made, replace(start, joints=told(verdict, stands)))
    assert not any(leg.at_start for leg in after.legs), (verdict.reasons, after.reasons)


def test_where_no_place_keeps_the_deadband_no_move_is_named():
    arm, stands = cut(deadband=Deadband(460.0, 2 * DEG)), MIDDLE.copy()
    verdict = verify(arm, StartJoints(stands, 10_000))
    assert any(
        "q1 at 72.500 deg" in r and "no place of it keeps 460 mm at the wrist centre" in r
        for r in verdict.reasons
    )
    assert any("q2 at 250.000 mm" in r and "no place of it keeps 460 mm" in r for r in verdict.reasons)


def test_where_next_to_no_place_is_left_no_move_is_named():
    """The slide has 10.001 mm, 5 mm are kept from either end."""
    narrow = cut().upper.copy()
    narrow[2] = 60.001
    verdict = verify(cut(upper=narrow), StartJoints(np.array([*MIDDLE[:2], 52.0, *MIDDLE[3:]]), 10_000))
    assert "must be kept: let the arm start from elsewhere" in standing_of(cut(upper=narrow), 2, 52.0)[0]
    assert not verdict.admissible


def test_an_arm_without_workspace_or_without_a_place_that_is_reported_is_told_no_move():
    """An offset leaves the elbow no angle; limits of the shoulder that begin beyond every joints frame."""
    folded = cut(calibration=ArmCalibration(joint_offset=np.array([0.0, -146.0 * DEG, 0.0, 0.0, 0.0])))
    assert standing_of(folded, 2, 52.0) == ()
    far = {"lower": cut().lower.copy(), "upper": cut().upper.copy()}
    far["lower"][0], far["upper"][0] = 3000 * DEG, 3100 * DEG
    (said,) = standing_of(cut(**far), 0, 3050 * DEG)
    assert "no place of it keeps 5 mm" in said
    far["lower"][0], far["upper"][0] = -0.2 * DEG, 0.2 * DEG
    (said,) = standing_of(cut(**far), 0, 0.0)
    assert "no place of it keeps 5 mm" in said


def standing_of(given_problem, joint, value):
    """What is said of the middle with one joint elsewhere."""
    stands = MIDDLE.copy()
    stands[joint] = value
    return standing(canonical(given_problem)[0], stands, 0.0, 0.0, roll_held=False)


@pytest.mark.parametrize("joint", [0, 3])
def test_an_arm_beyond_what_a_joints_frame_carries_is_told_to_come_back_first(joint):
    """The limits allow it, and from 2600 deg it may unwind."""
    wide = {"lower": cut().lower.copy(), "upper": cut().upper.copy()}
    wide["lower"][joint], wide["upper"][joint] = -36000 * DEG, 36000 * DEG
    arm, stands = cut(**wide), MIDDLE.copy()
    stands[joint] = 2610 * DEG
    verdict = verify(arm, StartJoints(stands, 10_000))
    assert not verdict.admissible
    (reason,) = verdict.reasons
    assert (
        f"q{joint} at 2610.000 deg, its limits are [-36000, 36000] deg, and it is surely reported within +-2600 deg"
        in reason
    )
    moved = told(verdict, stands)
    assert moved[joint] == pytest.approx(2600 * DEG, abs=0.2 * DEG)
    assert verify(arm, StartJoints(moved, 10_000)).admissible
