"""The first pose in joints, against the controller's own kinematics; and how far off the arm is."""

import math

import numpy as np
import pytest

from firmware_sim.plant import Plant, StoredPath
from protocol import records
from runtime.session.start import StartPose
from tests.firmware_sim.arms import CALIBRATED, NOMINAL, WIDE, line_path, tilted


@pytest.mark.parametrize("calibration", [NOMINAL, CALIBRATED])
@pytest.mark.parametrize("elbow", ["right", "left"])
@pytest.mark.parametrize(("q0_turns", "roll_turns"), [(0, 0), (1, -2), (-3, 1)])
def test_it_is_where_the_controller_puts_the_arm(calibration, elbow, q0_turns, roll_turns):
    path = line_path(
        (500.0, 40.0, 100.0), (450.0, 120.0, 60.0), elbow=elbow, q0_turns=q0_turns, roll_turns=roll_turns
    )
    start = StartPose.of(path, calibration, None)
    theirs = Plant(WIDE, calibration).place_at_first_pose(StoredPath.of(path)).joints
    np.testing.assert_allclose(start.joints, theirs, atol=1e-9)
    assert start.counts == records.joints_to_counts(np.array(theirs))


def test_a_vertical_axis_holds_the_declared_roll():
    path = records.Path.quantised(
        [(500.0, 0.0, 100.0), (510.0, 0.0, 100.0)],
        tilted((0.0, 0.0)),
        feed_mm_s=10.0,
        tool_length_mm=160.0,
        elbow="right",
    )
    assert StartPose.of(path, NOMINAL, 0.25).joints[3] == 0.25
    tilted_path = line_path((500.0, 0.0, 100.0), (510.0, 0.0, 100.0))
    assert StartPose.of(tilted_path, NOMINAL, 0.25).joints[3] != 0.25


def test_an_arm_at_the_start_is_at_distance_zero():
    start = StartPose.of(line_path((500.0, 0.0, 100.0), (510.0, 0.0, 100.0)), CALIBRATED, None)
    assert start.distance(start.joints) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("joint", "off", "tip_mm", "angle_deg"),
    [(0, math.radians(1.0), None, 1.0), (2, 0.7, 0.7, 0.0), (3, math.radians(-2.0), None, 2.0)],
)
def test_each_joint_counts(joint, off, tip_mm, angle_deg):
    start = StartPose.of(line_path((500.0, 0.0, 100.0), (510.0, 0.0, 100.0)), NOMINAL, None)
    measured = start.joints.copy()
    measured[joint] += off
    distance_mm, turned_deg = start.distance(measured)
    assert turned_deg == pytest.approx(angle_deg, abs=1e-9)
    assert distance_mm > 0.0
    if tip_mm is not None:
        assert distance_mm == pytest.approx(tip_mm, abs=1e-9)


def test_a_whole_turn_off_is_far_although_the_tip_is_there():
    start = StartPose.of(line_path((500.0, 0.0, 100.0), (510.0, 0.0, 100.0)), NOMINAL, None)
    measured = start.joints.copy()
    measured[3] += math.tau
    distance_mm, turned_deg = start.distance(measured)
    assert distance_mm < 1e-9
    assert turned_deg == pytest.approx(360.0)


def test_a_pose_out_of_reach_has_no_counts_and_admits_nothing():
    start = StartPose.of(line_path((5000.0, 0.0, 100.0), (5010.0, 0.0, 100.0)), NOMINAL, None)
    with pytest.raises(records.RecordError):
        _ = start.counts
    assert not any(value <= 1e9 for value in start.distance(np.zeros(5)))
