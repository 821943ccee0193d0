"""Rigid transforms and great circles."""

import math

import numpy as np
import pytest

from cutgate.runtime.kinematics.pose import (
    slerp,
    transform_poses,
    turn_about_vertical,
    turn_angles,
)


def random_rigid(rng):
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    out = np.eye(4)
    out[:3, :3] = q * np.sign(np.linalg.det(q))
    out[:3, 3] = rng.normal(0, 300, 3)
    return out


def test_transforms_that_do_not_commute_are_applied_in_order():
    rng = np.random.default_rng(1)
    a, b = random_rigid(rng), random_rigid(rng)
    tips, axes = rng.normal(0, 50, (5, 3)), rng.normal(size=(5, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    once = transform_poses(a @ b, tips, axes)
    twice = transform_poses(a, *transform_poses(b, tips, axes))
    other = transform_poses(b, *transform_poses(a, tips, axes))
    np.testing.assert_allclose(once[0], twice[0], atol=1e-9)
    np.testing.assert_allclose(once[1], twice[1], atol=1e-12)
    assert np.abs(once[0] - other[0]).max() > 1
    np.testing.assert_allclose(np.linalg.norm(once[1], axis=1), 1.0, atol=1e-15)


def test_poses_are_moved_by_a_quarter_turn_and_a_shift_and_stay_what_they_were():
    transform = np.array(
        [[0.0, -1.0, 0.0, 1.0], [1.0, 0.0, 0.0, 2.0], [0.0, 0.0, 1.0, 3.0], [0.0, 0.0, 0.0, 1.0]]
    )
    tips, axes = np.array([[5.0, 6.0, 7.0], [0.0, 0.0, 0.0]]), np.array([[0.6, 0.0, 0.8], [0.0, 0.6, 0.8]])
    kept = tips.copy(), axes.copy()
    there, turned = transform_poses(transform, tips, axes)
    np.testing.assert_array_equal(there, [[-5.0, 7.0, 10.0], [1.0, 2.0, 3.0]])
    np.testing.assert_allclose(turned, [[0.0, 0.6, 0.8], [-0.6, 0.0, 0.8]], atol=1e-15)
    np.testing.assert_array_equal((tips, axes), kept)


def test_an_axis_that_a_transform_stretches_within_its_tolerance_is_of_length_1_again():
    transform = np.diag((1.0 + 4e-7, 1.0, 1.0, 1.0))
    _, axes = transform_poses(transform, np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]]))
    np.testing.assert_array_equal(axes, [[1.0, 0.0, 0.0]])


def test_a_turn_about_the_vertical_keeps_the_vertical():
    turn = turn_about_vertical(0.7)
    tips, axes = transform_poses(turn, np.array([[0.0, 0.0, 7.0]]), np.array([[1.0, 0.0, 0.0]]))
    np.testing.assert_allclose(tips[0], (0.0, 0.0, 7.0), atol=1e-12)
    np.testing.assert_allclose(axes[0], (math.cos(0.7), math.sin(0.7), 0.0), atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 0.3, math.pi / 2, 3.1])
def test_a_great_circle_turns_at_constant_rate_between_its_ends(angle):
    first = np.array([[0.36, 0.48, 0.8]])
    side = np.cross(first, [[0.0, 0.0, 1.0]])
    side /= np.linalg.norm(side)
    second = first * math.cos(angle) + side * math.sin(angle)
    theta = turn_angles(first, second)
    assert theta[0] == pytest.approx(angle, abs=1e-15, rel=1e-12)
    np.testing.assert_array_equal(slerp(first, second, theta, np.zeros(1)), first)
    np.testing.assert_array_equal(slerp(first, second, theta, np.ones(1)), second)
    for s in (0.1, 0.5, 0.8):
        at = slerp(first, second, theta, np.full(1, s))
        assert np.linalg.norm(at) == pytest.approx(1.0, abs=1e-12)
        assert turn_angles(first, at)[0] == pytest.approx(s * angle, abs=1e-12)
