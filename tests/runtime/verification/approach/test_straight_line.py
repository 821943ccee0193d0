"""The lines along the tool: entry and exit pose, and what the controller makes of them by itself."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cutgate.firmware_sim.approach import own_ends
from cutgate.firmware_sim.kinematics import calibrated_arm
from cutgate.firmware_sim.path_check import PathCheck
from cutgate.protocol import records
from cutgate.runtime.verification.approach import report
from cutgate.runtime.verification.approach.decision import joint_lines, verify
from cutgate.runtime.verification.approach.model import StartJoints
from cutgate.runtime.verification.approach.straight_line import (
    first_and_last_joints,
    roll_is_held,
    standoff_um,
    straight_line,
    straight_lines,
)
from cutgate.runtime.verification.problem import Arm, ArmCalibration
from cutgate.runtime.verification.steps import finished
from tests.firmware_sim.arms import CALIBRATED, LIMITS, NOMINAL, TOOL, TOOL_MM, WIDE, line_path
from tests.oracle.dense import Dense
from tests.runtime.verification.approach.cuts import MIDDLE, cut, random_case, straight_margins, vertical
from tests.runtime.verification.cases import DEG, axis, problem, wrist_path


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_entry_and_exit_joints_bring_the_tool_there_on_the_branch_of_the_cut(seed):
    case = random_case(seed, segments=2)
    if case is None:
        return
    made, start = case
    verdict = verify(made, start)
    if not verdict.admissible:
        return
    for pose, out_um, joints in ((0, verdict.entry_um, verdict.entry), (-1, verdict.exit_um, verdict.exit)):
        at_pose = first_and_last_joints(made)[pose]
        _, dense, turns = straight_margins(made, pose, out_um, at_pose)
        true = joints + made.calibration.joint_offset
        np.testing.assert_allclose(true[[1, 4]], dense.samples.q[-1, [1, 4]], atol=1e-7)
        assert true[2] == pytest.approx(dense.samples.q[-1, 2], abs=1e-6)  # joints are bound in 1e-6 deg | mm
        assert true[0] == pytest.approx(dense.unwrapped(0, turns[0])[-1], abs=1e-7)
        assert true[3] == pytest.approx(dense.unwrapped(3, turns[1])[-1], abs=1e-6)
        standoff = (made.tips_mm[pose] + out_um / 1000 * made.axes[pose] - made.tips_mm) @ made.axes[pose]
        assert start.clearance_um / 1000 - 1e-9 <= standoff.min() <= start.clearance_um / 1000 + 0.001 + 1e-9
    first = Dense(made, per_segment=60)
    assert made.branch is not None
    np.testing.assert_allclose(
        first_and_last_joints(made)[:, 0] + made.calibration.joint_offset[0],
        first.unwrapped(0, made.branch[0])[[0, -1]],
        atol=1e-7,
    )


def test_a_vertical_tool_is_approached_with_its_held_roll():
    verdict = verify(vertical(0.4), StartJoints(MIDDLE, 10_000))
    assert verdict.admissible, verdict.reasons
    assert verdict.entry[[3, 4]] == pytest.approx([0.4, 0.0], abs=1e-8)
    assert verdict.exit[[3, 4]] == pytest.approx([0.4, 0.0], abs=1e-8)
    assert all("pitch_min" not in leg.boundaries for leg in verdict.legs)
    assert (verdict.entry_um, verdict.exit_um) == (10_000, 20_000)


def test_a_vertical_tool_without_a_held_roll_has_no_approach():
    assert not verify(vertical(None), StartJoints(MIDDLE, 10_000)).admissible


def test_a_straight_leg_that_leaves_the_slides_travel_is_refused_with_its_sentence():
    high = replace(cut(), upper=np.array([80 * DEG, 145 * DEG, 300.0, 170 * DEG, 110 * DEG]))
    verdict = verify(high, StartJoints(MIDDLE, 60_000))
    assert any("pose to the first pose: top: " in reason for reason in verdict.reasons)
    assert any("last pose to the exit pose: top: " in reason for reason in verdict.reasons)
    assert any("lower approach_clearance_mm or move the bone" in reason for reason in verdict.reasons)


def test_a_straight_leg_keeps_the_joint_speeds():
    slow = replace(cut(), feed_mm_s=5_000.0)
    verdict = verify(slow, StartJoints(MIDDLE, 10_000))
    reasons = verdict.reasons
    assert not verdict.admissible
    assert not any(b.violated for leg in verdict.legs for b in leg.boundaries.values())
    assert any("straight line" in reason and "joint 2: needs up to" in reason for reason in reasons)
    assert not any("joint line" in reason for reason in reasons)


def of_both(path, calibration, limits, clearance_um, hold_roll=None):
    """What the runtime binds, and what the controller comes to by itself."""
    check = PathCheck(path, limits, calibration, TOOL, hold_roll)
    assert check.run().detail == ""
    arm = calibrated_arm(calibration, tool_mm=TOOL_MM, elbow=path.elbow, hold_roll_rad=hold_roll)
    theirs = own_ends(path, arm, limits, check.first_joints, check.last_joints, clearance_um=clearance_um)
    mine = problem(
        path.tips_mm,
        path.axes,
        branch=(path.q0_turns, path.roll_turns),
        arm=Arm(calibration.upper_mm, calibration.forearm_mm, path.elbow),
        lower=limits.q_min,
        upper=limits.q_max,
        hold_roll=hold_roll,
        calibration=ArmCalibration(
            calibration.upper_link_error_mm,
            calibration.forearm_link_error_mm,
            calibration.joint_offset,
            calibration.slide_tilt,
        ),
    )
    middle = (limits.q_min + limits.q_max) / 2
    return report.bound(verify(mine, StartJoints(middle, clearance_um)), 25), theirs


@pytest.mark.parametrize("calibration", [NOMINAL, CALIBRATED], ids=["nominal", "calibrated"])
@pytest.mark.parametrize("elbow", ["right", "left"])
@pytest.mark.parametrize(("q0_turns", "roll_turns"), [(0, 0), (1, -2), (-3, 1)])
@pytest.mark.parametrize("clearance_um", [0, 25_000])
def test_the_controller_comes_to_the_same_entry_and_exit(
    calibration, elbow, q0_turns, roll_turns, clearance_um
):
    sides = {
        "right": WIDE,
        "left": replace(WIDE, q_min_u=_elbow(WIDE.q_min_u, -180), q_max_u=_elbow(WIDE.q_max_u, 0)),
    }
    turns = {"q0_turns": q0_turns, "roll_turns": roll_turns}
    path = line_path((500.0, 40.0, 100.0), (450.0, 120.0, 60.0), elbow=elbow, **turns)
    bound, theirs = of_both(path, calibration, sides[elbow], clearance_um)
    assert (bound.entry_um, bound.exit_um) == (theirs.entry_um, theirs.exit_um)
    np.testing.assert_allclose(bound.entry_joints_u, theirs.entry_joints_u, atol=2)
    np.testing.assert_allclose(bound.exit_joints_u, theirs.exit_joints_u, atol=2)


def _elbow(joints_u, deg):
    return (joints_u[0], deg * records.UNIT, *joints_u[2:])


def test_the_controller_holds_the_roll_of_a_vertical_tool_on_the_way_as_well():
    path = line_path((500.0, 0.0, 100.0), (520.0, 0.0, 100.0), polar=(0, 0), azimuth=(0, 0))
    bound, theirs = of_both(path, NOMINAL, LIMITS, 10_000, hold_roll=0.4)
    assert (theirs.entry_um, theirs.exit_um) == (bound.entry_um, bound.exit_um) == (10_000, 10_000)
    assert theirs.entry_joints_u[3] == bound.exit_joints_u[3] == round(math.degrees(0.4) * 1e6)
    np.testing.assert_allclose(bound.exit_joints_u, theirs.exit_joints_u, atol=2)


def test_the_straight_lines_are_known_before_it_is_known_where_the_arm_stands():
    lines = straight_lines(cut(), 10_000)
    whole = verify(cut(), StartJoints(MIDDLE, 10_000))
    assert (lines.inward, lines.outward) == whole.legs[1:3]
    assert lines.admissible
    assert report.bound(lines, 25) == report.bound(whole, 25)
    far = straight_lines(cut(), 500_000)
    assert not far.admissible
    assert report.bound(far, 25) is None
    nowhere = straight_lines(cut(), -1)
    assert report.bound(nowhere, 25) is None
    assert finished(joint_lines(nowhere, StartJoints(MIDDLE, 10_000))) is nowhere


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"branch": None}, "the cut names no joint branch"),
        (
            {"tips_mm": cut().tips_mm + 2000.0},
            "the cut's first or last pose has no joints: cure the cut first",
        ),
        ({"tips_mm": cut().tips_mm * math.nan}, "not all finite"),
    ],
)
def test_a_cut_without_branch_or_joints_has_no_straight_lines(changes, text):
    refused = straight_lines(replace(cut(), **changes), 10_000)
    assert not refused.admissible
    assert (refused.legs, refused.entry, refused.exit, refused.entry_um, refused.exit_um) == (
        (),
        None,
        None,
        0,
        0,
    )
    assert any(text in reason for reason in refused.reasons)


def test_past_the_column_no_joints_are_followed():
    tips, axes = wrist_path([[-400.0, 0.0, 100.0], [400.0, 0.0, 100.0]], axis(1.0, 0.2))
    through = problem(tips, axes, branch=(0, 0))
    assert np.isnan(first_and_last_joints(through)).all()
    assert np.isnan(first_and_last_joints(replace(cut(), branch=None))).all()


def test_entry_and_exit_stand_clear_of_everything_that_is_cut():
    """Along the tool by the clearance from the highest tip, rounded up to whole um."""
    tips = np.array([[500.0, 0.0, 100.0], [510.0, 0.0, 107.0001], [520.0, 0.0, 104.0]])
    path = problem(tips, np.tile([0.0, 0.0, 1.0], (3, 1)), branch=(0, 0))
    assert [standoff_um(path, pose, 500) for pose in (0, 1, -1)] == [7_501, 500, 3_501]


def test_one_end_of_the_cut_without_joints_is_one_too_many():
    tips = cut().tips_mm.copy()
    for pose in (0, -1):
        far = tips.copy()
        far[pose] += 2000.0
        assert not straight_lines(replace(cut(), tips_mm=far), 10_000).admissible
        assert straight_lines(replace(cut(), tips_mm=far), 10_000).reasons == (
            "the cut's first or last pose has no joints: cure the cut first",
        )


def test_a_roll_is_held_where_it_is_declared_and_the_tool_vertical_throughout():
    assert roll_is_held(vertical(0.4))
    assert roll_is_held(vertical(0.0))
    assert not roll_is_held(vertical(None))
    for lean in ((1e-9, 0.0, 1.0), (0.0, 1e-9, 1.0), (-1e-9, 0.0, 1.0)):
        assert not roll_is_held(replace(vertical(0.4), axes=np.array([vertical(0.4).axes[0], lean])))
    assert roll_is_held(replace(vertical(0.4), axes=np.array([vertical(0.4).axes[0], (9e-10, 0.0, 1.0)])))
    assert not roll_is_held(cut(hold_roll=0.4))


@pytest.mark.parametrize("held", [0.0, 0.4, -1.0])
def test_a_held_roll_is_that_of_both_poses(held):
    assert first_and_last_joints(vertical(held))[:, 3].tolist() == [held, held]


@pytest.mark.parametrize("turns", [-2, -1, 0, 1, 2])
def test_the_branch_is_that_of_the_first_pose_whatever_the_last_one_is(turns):
    around = np.radians([-170.0, -100.0, 0.0, 100.0, 190.0])
    centres = np.stack((500 * np.cos(around), 500 * np.sin(around), np.full(5, 250.0)), axis=1)
    tips, axes = wrist_path(centres, axis(30 * DEG, around))
    wide = {
        "lower": np.array([-60.0, 0.0, 50.0, -60.0, 0.0]),
        "upper": np.array([60.0, 2.5, 450.0, 60.0, 1.9]),
    }
    first, last = first_and_last_joints(problem(tips, axes, branch=(turns, turns), **wide))
    for joint in (0, 3):
        assert -math.pi < first[joint] - turns * 2 * math.pi <= math.pi
    assert last[0] - first[0] == pytest.approx(2 * math.pi, abs=1e-9)
    assert last[3] - first[3] == pytest.approx(0.0, abs=1e-9)


def test_a_straight_line_is_verified_in_the_turns_in_which_the_cut_meets_it():
    """Where the shoulder has turned on, its limits are met in that turn: the exit's line is followed there."""
    high = np.array([80.0 * DEG, 145 * DEG, 450, 170 * DEG, 110 * DEG])
    low = np.array([-80.0 * DEG, 0.0, 50.0, -170 * DEG, 0.0])
    joints = first_and_last_joints(cut())[0]
    leg, outer = straight_line(cut(), "entry", 0, 10_000, joints)
    other, beyond = straight_line(
        cut(lower=low, upper=high), "entry", 0, 10_000, np.add(joints, (2 * math.pi, 0, 0, 0, 0))
    )
    assert not leg.violated
    assert other.reasons
    assert np.abs(beyond - outer)[0] == pytest.approx(2 * math.pi, abs=1e-6)


def test_joints_at_entry_and_exit_are_what_a_permit_carries():
    lines = straight_lines(cut(), 10_000)
    for joints in (lines.entry, lines.exit):
        np.testing.assert_array_equal(records.joints_to_memory(records.joints_to_counts(joints)), joints)


def test_without_a_branch_the_joints_are_unknown_numbers_of_their_shape():
    unknown = first_and_last_joints(replace(cut(), branch=None))
    assert unknown.shape == (2, 5)
    assert np.isnan(unknown).all()
