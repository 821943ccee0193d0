"""The rigid fit: right without noise, optimal with it, the same as another program's, and told apart from a mirror image."""

import math

import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813 - as its manual does
from hypothesis import given
from hypothesis import strategies as st

from cutgate.runtime.plan.registrations.fit import rigid_fit, spread_mm
from tests.runtime.plan.registrations.itk_files import rotation

SEEDS = st.integers(0, 2**32 - 1)


def case(seed, noise_mm, least=3):
    """Landmarks about a bone, a random rigid motion, and where they were touched."""
    rng = np.random.default_rng(seed)
    ct = rng.uniform(-60.0, 60.0, (int(rng.integers(least, 12)), 3))
    turn, shift = rotation(*rng.uniform(-2.0, 2.0, 3)), rng.uniform(-800.0, 800.0, 3)
    return ct, ct @ turn.T + shift + rng.normal(0.0, noise_mm, ct.shape), turn, shift


@given(seed=SEEDS)
def test_without_noise_the_motion_itself_is_found(seed):
    ct, robot, turn, shift = case(seed, 0.0, least=4)
    found = rigid_fit(ct, robot)
    if spread_mm(ct) > 5.0:
        np.testing.assert_allclose(found.transform[:3, :3], turn, atol=1e-9)
        np.testing.assert_allclose(found.transform[:3, 3], shift, atol=1e-7)
    assert found.rms_mm < 1e-9
    assert found.scale == pytest.approx(1.0)
    assert not found.mirrored


@given(seed=SEEDS, noise_mm=st.floats(0.01, 5.0))
def test_it_is_a_rotation_and_no_neighbour_of_it_fits_better(seed, noise_mm):
    ct, robot, _, _ = case(seed, noise_mm)
    found = rigid_fit(ct, robot)
    turn, shift = found.transform[:3, :3], found.transform[:3, 3]
    np.testing.assert_allclose(turn.T @ turn, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1.0)

    def squares(r, t):
        return float(((ct @ r.T + t - robot) ** 2).sum())

    best = squares(turn, shift)
    assert found.rms_mm == pytest.approx(math.sqrt(best / len(ct)))
    np.testing.assert_allclose(found.residuals_mm, np.linalg.norm(ct @ turn.T + shift - robot, axis=1))
    rng = np.random.default_rng(seed)
    for size in (1e-3, 1e-2, 0.1, 3.0):
        for _ in range(4):
            by, moved = rng.normal(0.0, size, 3), rng.normal(0.0, 10.0 * size, 3)
            assert squares(rotation(*by) @ turn, shift + moved) >= best * (1.0 - 1e-12)


@given(seed=SEEDS, noise_mm=st.floats(0.0, 3.0))
def test_another_program_finds_the_same(seed, noise_mm):
    """By Horn's quaternions."""
    ct, robot, _, _ = case(seed, noise_mm, least=5)
    horn = sitk.LandmarkBasedTransformInitializer(
        sitk.VersorRigid3DTransform(), ct.ravel().tolist(), robot.ravel().tolist()
    )
    found = rigid_fit(ct, robot)
    there = [horn.TransformPoint(point) for point in ct.tolist()]
    theirs = float(np.linalg.norm(np.array(there) - robot) / math.sqrt(len(ct)))
    assert found.rms_mm == pytest.approx(theirs, abs=1e-5)


@given(seed=SEEDS, noise_mm=st.floats(0.0, 1.0), axis=st.integers(0, 2))
def test_a_mirror_image_is_told_where_the_landmarks_do_not_lie_in_a_plane(seed, noise_mm, axis):
    ct, robot, _, _ = case(seed, noise_mm, least=6)
    right = rigid_fit(ct, robot)
    if right.flatness_mm < 10.0:
        return
    assert not right.mirrored
    reversed_axis = np.ones(3)
    reversed_axis[axis] = -1.0
    wrong = rigid_fit(ct * reversed_axis, robot)
    assert wrong.mirrored
    assert wrong.mirrored_rms_mm == pytest.approx(right.rms_mm, rel=1e-6, abs=1e-8)


@given(seed=SEEDS, factor=st.floats(0.001, 1000.0))
def test_the_scale_that_would_fit_is_found(seed, factor):
    ct, robot, _, _ = case(seed, 0.0)
    assert rigid_fit(ct, factor * robot).scale == pytest.approx(factor, rel=1e-6)


@given(seed=SEEDS, mirror=st.booleans(), noise_mm=st.floats(0.0, 3.0))
def test_the_scale_is_that_of_least_squares_under_the_rotation_that_was_found(seed, mirror, noise_mm):
    """Of a mirror image as well, whose best rotation is a bad one."""
    ct, robot, _, _ = case(seed, noise_mm, least=5)
    robot = robot * (1, 1, -1) if mirror else robot
    found = rigid_fit(ct, robot)
    turned = (ct - ct.mean(axis=0)) @ found.transform[:3, :3].T
    assert found.scale == pytest.approx(float((turned * robot).sum() / (turned * turned).sum()), rel=1e-9)


@given(seed=SEEDS, off_mm=st.floats(0.0, 50.0))
def test_the_spread_is_the_distance_from_the_nearest_line(seed, off_mm):
    """Points two by two at either side of a line, so far off it; longer along it than across."""
    rng = np.random.default_rng(seed)
    along = np.repeat((-100.0, 100.0), 2)
    side = np.tile((-off_mm, off_mm), 2)
    points = np.column_stack((along, side, np.zeros(4))) @ rotation(*rng.uniform(-2, 2, 3)).T
    assert spread_mm(points + rng.uniform(-500, 500, 3)) == pytest.approx(off_mm, abs=1e-6)


def test_two_points_have_no_spread():
    assert spread_mm(np.array([[0.0, 0, 0], [5.0, 1.0, 7.0]])) == pytest.approx(0.0, abs=1e-12)
