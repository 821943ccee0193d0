"""The printed planar distance: the facts that pin our reading of equations (16)-(21)."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cutgate.runtime.library.printed import march_on_printed, printed_distance, printed_sides
from cutgate.runtime.verification import certified, stocco
from cutgate.runtime.verification.problem import Arm
from cutgate.runtime.verification.stocco import march
from cutgate.runtime.workspace.distance import signed_distance
from cutgate.runtime.workspace.planar import PlanarWorkspace
from tests.runtime.verification.cases import DEG, WIDE
from tests.runtime.verification.table_1 import TABLE_1, annulus, zigzag
from tests.runtime.workspace.test_planar import FAMILIES, FULL, workspace

PAPER = workspace(500, 500, (-60, 60), (0, 150))


def grid(space, step):
    """Points on a square grid over the whole reach."""
    reach = space.radius(space.q1_lo)
    line = np.arange(-reach + step / 2, reach, step)
    return np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)


def shares(space, step=4.0):
    """Unreachable share of what D accepts, rejected share of what is reachable, and the largest D unreachable."""
    points = grid(space, step)
    d, inside = printed_distance(points, space), space.inside(points)
    wrong = (d > 0.0) & ~inside
    return (
        wrong.sum() / (d > 0.0).sum(),
        ((d <= 0.0) & inside).sum() / inside.sum(),
        d[wrong].max(initial=0.0),
    )


def reachable(space, rng, n):
    q0, q1 = rng.uniform(space.q0_lo, space.q0_hi, n), rng.uniform(space.q1_lo, space.q1_hi, n)
    x = space.a0 * np.cos(q0) + space.a1 * np.cos(q0 + q1)
    points = np.stack((x, space.a0 * np.sin(q0) + space.a1 * np.sin(q0 + q1)), axis=1)
    return points[space.inside(points)]


def test_a_seventh_of_the_area_the_paper_accepts_is_unreachable():
    wrong, rejected, largest = shares(PAPER)
    assert wrong == pytest.approx(0.136, abs=0.001)
    assert rejected == 0.0
    assert 195.0 < largest < 200.0


def test_the_largest_distance_at_an_unreachable_point_is_200_mm_behind_the_robot():
    azimuth = np.array([-120.0, -119.9, -120.1]) * math.pi / 180
    points = 800.0 * np.stack((np.cos(azimuth), np.sin(azimuth)), axis=1)
    d = printed_distance(points, PAPER)
    assert not PAPER.inside(points).any()
    assert d[1] == pytest.approx(200.0, abs=1.0)
    assert d[2] < 0.0
    step = 1e-9 * np.array([[-math.sin(azimuth[0]), math.cos(azimuth[0])]])
    assert printed_distance(points[:1] + step * 800.0, PAPER)[0] == pytest.approx(200.0, abs=1e-5)


@pytest.mark.parametrize(
    ("span", "share"), [(120, 0.0), (180, 0.0), (230, 0.056), (250, 0.131), (300, 0.361)]
)
def test_a_shoulder_span_over_a_half_turn_rejects_reachable_points(span, share):
    _, rejected, _ = shares(workspace(500, 500, (-span / 2, span / 2), (0, 150)))
    assert rejected == pytest.approx(share, abs=0.003)


@pytest.mark.parametrize(
    ("space", "wrong", "rejected"),
    [
        (workspace(500, 300, (-60, 60), (0, 180)), 0.217, 0.0),
        (workspace(300, 500, (-60, 60), (0, 180)), 0.089, 0.018),
        (workspace(500, 500, (-60, 60), (25, 150)), 0.127, 0.0),
        (workspace(450, 450, (-80, 80), (0, 145)), 0.006, 0.0),
    ],
    ids=["short forearm", "long forearm", "no full extension", "the example robot"],
)
def test_other_arms_fail_in_other_shares(space, wrong, rejected):
    found = shares(space)
    assert found[0] == pytest.approx(wrong, abs=0.002)
    assert found[1] == pytest.approx(rejected, abs=0.002)


def test_on_reachable_points_it_never_exceeds_the_exact_distance():
    rng = np.random.default_rng(0)
    for _ in range(1000):
        bend = np.sort(rng.uniform(0, math.pi, 2))
        bend = np.where(rng.random(2) < 0.3, (0.0, math.pi), bend)
        centre, half = rng.uniform(-3, 3), rng.uniform(0.02, 3.1)
        space = PlanarWorkspace(*rng.uniform(150, 600, 2), centre - half, centre + half, *bend)
        points = reachable(space, rng, 400)
        assert (printed_distance(points, space) <= signed_distance(points, space) + 1e-9).all()


@given(seed=st.integers(0, 10_000))
@settings(deadline=None, max_examples=40)
def test_a_march_whose_start_is_proven_inside_never_leaves_the_reach(seed):
    rng = np.random.default_rng(seed)
    centre, half = rng.uniform(-3, 3), rng.uniform(0.3, 3.1)
    space = PlanarWorkspace(
        *rng.uniform(250, 600, 2), centre - half, centre + half, 0.0, rng.uniform(1.5, math.pi)
    )
    turn = rng.normal(0, 150, 2)
    length = float(np.hypot(*turn))
    for start in reachable(space, rng, 4):

        def distance(place, start=start):
            return printed_distance((start + turn * place / length)[None], space)

        if march(length, 5.0, distance).admitted:
            line = start + np.linspace(0, 1, 300)[:, None] * turn
            assert signed_distance(line, space).min() >= 5.0


@pytest.mark.parametrize("name", FULL)
def test_without_shoulder_limits_only_the_circles_count_and_it_is_exact(name):
    space = FULL[name]
    points = reachable(space, np.random.default_rng(1), 500)
    assert np.isposinf(printed_sides(points, space)[:, 2:]).all()
    np.testing.assert_allclose(printed_distance(points, space), signed_distance(points, space), atol=1e-9)


@pytest.mark.parametrize("name", FAMILIES | FULL)
@pytest.mark.parametrize("point", [(math.nan, 0.0), (0.0, math.nan)])
def test_what_is_not_a_number_stays_that(name, point):
    assert math.isnan(printed_distance(np.array([point]), (FAMILIES | FULL)[name])[0])


def sweeping(azimuths_deg, radius):
    """The arm the printed equations are wrong about, with a path of its wrist centre on a circle."""
    t = np.asarray(azimuths_deg) * DEG
    centres = np.stack((radius * np.cos(t), radius * np.sin(t), np.full(len(t), 100.0)), axis=1)
    return annulus(
        centres,
        arm=Arm(500.0, 500.0, "right"),
        lower=np.array([-60 * DEG, 0.0, -1e4, -WIDE, 0.0]),
        upper=np.array([60 * DEG, 150 * DEG, 1e4, WIDE, math.pi]),
    )


def test_the_printed_distance_admits_a_path_that_is_nowhere_reachable_and_no_verdict_does():
    path = sweeping([-118.0, -115.0, -112.0], 800.0)
    run = march_on_printed(path)
    assert run.admitted
    assert run.values.min() > 100.0
    assert not stocco.verify(path).admissible
    assert not certified.verify(path).admissible


def test_inside_the_reach_both_marches_admit_and_the_printed_one_takes_no_longer_steps():
    path = sweeping([50.0, 20.0, 30.0], 600.0)
    run, verdict = march_on_printed(path), stocco.verify(path)
    assert run.admitted
    assert verdict.admissible
    assert run.evaluations >= verdict.evaluations.arm
    assert run.worst_case == verdict.evaluations.worst_case


def test_the_printed_march_of_the_unlimited_arm_is_the_exact_one():
    for rho, phi, count, _ in TABLE_1:
        assert march_on_printed(annulus(zigzag(rho, phi))).evaluations == count


def test_the_printed_march_refuses_bad_numbers_and_denies_an_arm_without_workspace():
    with pytest.raises(ValueError, match="finite"):
        march_on_printed(annulus([[500.0, 0.0, 0.0], [500.0, math.nan, 0.0]]))
    empty = sweeping([0.0, 1.0], 600.0)
    empty = replace(empty, lower=empty.lower + np.array([3.0, 0, 0, 0, 0]))
    assert not march_on_printed(empty).admitted
