"""Rigid transforms and great circles."""

import math

import numpy as np
import pytest

from cutgate.runtime.kinematics.pose import (
    rigid_defect,
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


def changed(row, column, value):
    out = np.eye(4)
    out[row, column] = value
    return out


@pytest.mark.parametrize(
    ("matrix", "said"),
    [
        (np.eye(3), "shape"),
        (changed(0, 3, math.nan), "finite"),
        (changed(3, 0, 1e-9), "last row"),
        (changed(3, 3, 2.0), "last row"),
        (changed(0, 0, 1.00001), "orthonormal"),
        (changed(0, 1, 0.01), "orthonormal"),
        (changed(2, 2, -1.0), "reflection"),
    ],
)
def test_what_is_not_rigid_is_refused_and_named(matrix, said):
    assert said in rigid_defect(matrix)
    with pytest.raises(ValueError, match="not a rigid transform"):
        transform_poses(matrix, np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]))


def test_a_turn_about_the_vertical_keeps_its_pivot():
    pivot = np.array([10.0, -4.0, 7.0])
    turn = turn_about_vertical(0.7, pivot)
    assert rigid_defect(turn) is None
    tips, axes = transform_poses(turn, pivot[None, :], np.array([[1.0, 0.0, 0.0]]))
    np.testing.assert_allclose(tips[0], pivot, atol=1e-12)
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
