"""Joints to pose and back."""

import math

import numpy as np
import pytest

from cutgate.runtime.kinematics.arm import TrueArm, turns, wrap


def arm(side, *, offset=0.0, tilt=0.0):
    return TrueArm(450.0, 380.0, side, np.full(5, offset), np.full(2, tilt))


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("offset", "tilt"), [(0.0, 0.0), (0.03, 0.015)])
def test_inverse_kinematics_undoes_forward_kinematics(side, offset, tilt):
    rng = np.random.default_rng(5)
    q = rng.uniform((-3.1, 0.1, -200, -3.1, 0.1), (3.1, 3.0, 200, 3.1, 3.0), (500, 5))
    q[:, 1] *= side
    made = arm(side, offset=offset, tilt=tilt)
    tips, axes = made.pose(q, 170.0)
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1.0, atol=1e-12)
    back = made.joints(tips, axes, 170.0)
    np.testing.assert_allclose(
        np.remainder(back - q + math.pi, 2 * math.pi)[:, [0, 1, 3, 4]], math.pi, atol=1e-8
    )
    np.testing.assert_allclose(back[:, 2], q[:, 2], atol=1e-9)


def test_the_documented_pose_by_hand():
    tips, axes = arm(1.0).pose(
        np.array([[math.pi / 2, math.pi / 2, 100.0, -math.pi / 2, math.pi / 2]]), 160.0
    )
    np.testing.assert_allclose(axes[0], (0.0, 1.0, 0.0), atol=1e-12)  # p = 90 deg
    np.testing.assert_allclose(tips[0], (-380.0, 450.0 - 160.0, 100.0), atol=1e-9)


def test_a_right_elbow_lies_to_the_right_of_the_line_from_shoulder_to_wrist():
    q = np.array([[0.4, 0.9, 0.0, 0.0, math.pi / 2]])
    tips, axes = arm(1.0).pose(q, 0.0)
    del axes
    elbow = 450.0 * np.array([math.cos(0.4), math.sin(0.4)])
    assert np.linalg.det(np.stack((tips[0, :2], elbow))) < 0


def test_the_leaning_slide_shifts_the_wrist_by_its_true_height():
    q = np.array([[0.1, 0.5, 120.0, 0.0, 1.0]])
    straight, _ = arm(1.0).pose(q, 0.0)
    leaning, _ = arm(1.0, tilt=0.01).pose(q, 0.0)
    np.testing.assert_allclose(leaning - straight, [[1.2, 1.2, 0.0]], atol=1e-9)


def test_out_of_reach_has_no_joints():
    level = np.array([[1.0, 0.0, 0.0]])
    for x in (1000.0, 20.0):
        q = arm(1.0).joints(np.array([[x, 0.0, 0.0]]), level, 0.0)
        assert np.isnan(q[0, [0, 1, 3]]).all()
        assert np.isfinite(q[0, [2, 4]]).all()


@pytest.mark.parametrize(
    ("degrees", "whole"),
    [(0, 0), (180, 0), (180.001, 1), (-180, -1), (-179.9, 0), (540, 1), (541, 2), (720, 2)],
)
def test_turns_are_counted_from_the_half_open_turn(degrees, whole):
    angle = np.array([math.radians(degrees)])
    assert turns(angle)[0] == whole
    assert -math.pi < wrap(angle)[0] <= math.pi
