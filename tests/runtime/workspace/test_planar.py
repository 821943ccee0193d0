"""The exact workspace against sampling of the joint rectangle, on families of arms."""

import math

import numpy as np
import pytest

from cutgate.runtime.workspace.distance import side_distances, signed_distance, signed_sides
from cutgate.runtime.workspace.planar import (
    Arc,
    PlanarWorkspace,
    distance_to_arc,
    nearest_on_arc,
    segment_to_arc,
)

DEG = math.pi / 180


def workspace(a0, a1, q0, q1):
    return PlanarWorkspace(a0, a1, q0[0] * DEG, q0[1] * DEG, q1[0] * DEG, min(q1[1] * DEG, math.pi))


FAMILIES = {
    "equal links": workspace(500, 500, (-60, 60), (0, 150)),
    "short forearm": workspace(500, 300, (-60, 60), (0, 180)),
    "long forearm": workspace(300, 500, (-60, 60), (0, 180)),
    "no full extension": workspace(400, 450, (-100, 80), (25, 140)),
    "narrow": workspace(400, 450, (10, 12), (25, 140)),
    "over a half turn": workspace(400, 450, (-130, 120), (10, 150)),
    "thin gap": workspace(400, 450, (-179.9, 179.9), (10, 150)),
    "across the cut": workspace(400, 450, (150, 260), (10, 150)),
    "small bend": workspace(400, 450, (-50, 70), (60, 61)),
}
FULL = {
    "full turn": workspace(400, 450, (-180, 180), (10, 150)),
    "two turns": workspace(550, 450, (-360, 360), (0, 180)),
}


def brute(points, space, n=1500):
    """Distance to the boundary from dense samples of the sides of the joint rectangle."""

    def place(q0, q1):
        return np.stack(
            (
                space.a0 * np.cos(q0) + space.a1 * np.cos(q0 + q1),
                space.a0 * np.sin(q0) + space.a1 * np.sin(q0 + q1),
            ),
            axis=-1,
        )

    q0 = np.linspace(space.q0_lo, min(space.q0_hi, space.q0_lo + 2 * math.pi), n)
    q1 = np.linspace(space.q1_lo, space.q1_hi, n)
    sides = [place(q0, space.q1_hi), place(q0, space.q1_lo), place(space.q0_hi, q1), place(space.q0_lo, q1)]
    return np.stack([np.linalg.norm(points[:, None] - side, axis=2).min(axis=1) for side in sides], axis=1)


def solvable(points, space):
    """Membership by trying: intersect the two links' circles and look at the joints."""
    r = np.linalg.norm(points, axis=1)
    cosine = (r**2 - space.a0**2 - space.a1**2) / (2 * space.a0 * space.a1)
    with np.errstate(invalid="ignore"):
        q1 = np.arccos(cosine)
    q0 = np.arctan2(points[:, 1], points[:, 0]) - np.arctan2(
        space.a1 * np.sin(q1), space.a0 + space.a1 * np.cos(q1)
    )
    fits = np.zeros(len(points), dtype=bool)
    for turn in range(-3, 4):
        fits |= (q0 + 2 * math.pi * turn >= space.q0_lo) & (q0 + 2 * math.pi * turn <= space.q0_hi)
    return fits & (q1 >= space.q1_lo) & (q1 <= space.q1_hi)


def scatter(seed, n=400):
    return np.random.default_rng(seed).uniform(-1050, 1050, (n, 2))


@pytest.mark.parametrize("name", FAMILIES | FULL)
def test_distances_agree_with_dense_sampling_of_the_boundary(name):
    space = (FAMILIES | FULL)[name]
    points = scatter(1)
    mine, sampled = side_distances(points, space), brute(points, space)
    assert (mine <= sampled + 1e-9).all()
    assert (sampled <= np.hypot(mine, 4.0) + 1e-9).all()  # samples at most 8 mm apart
    np.testing.assert_array_equal(space.inside(points), solvable(points, space))


@pytest.mark.parametrize("name", FAMILIES | FULL)
def test_the_signed_distance_is_positive_inside_and_at_most_one_steep(name):
    space = (FAMILIES | FULL)[name]
    points = scatter(2, 4000)
    d = signed_distance(points, space)
    assert ((d > 0) == space.inside(points)).all()
    near = points + np.random.default_rng(3).normal(0, 20, points.shape)
    moved = np.linalg.norm(near - points, axis=1)
    assert (np.abs(signed_distance(near, space) - d) <= moved + 1e-9).all()


@pytest.mark.parametrize("name", FAMILIES)
def test_a_disc_of_the_distance_round_a_reachable_point_is_reachable(name):
    space = FAMILIES[name]
    points = scatter(4, 3000)
    points = points[space.inside(points)]
    radius = signed_distance(points, space) - 1e-7
    angle = np.random.default_rng(5).uniform(0, 2 * math.pi, len(points))
    edge = points + radius[:, None] * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    assert space.inside(edge).all()


def test_the_unreachable_wedge_of_the_printed_equations_lies_outside():
    space = FAMILIES["equal links"]
    start = 800 * np.array([[math.cos(-120 * DEG), math.sin(-120 * DEG)]])
    assert not space.inside(start)[0]
    assert signed_distance(start, space)[0] < 0


@pytest.mark.parametrize("name", FAMILIES | FULL)
def test_the_segment_minimum_agrees_with_sampling_the_segment(name):
    space = (FAMILIES | FULL)[name]
    first, second = scatter(6, 150), scatter(7, 150)
    second[:20] = first[:20]  # of length zero
    second[20:60] = first[20:60] + (second[20:60] - first[20:60]) * 1e-3
    t = np.linspace(0, 1, 1201)
    for arc in space.arcs:
        d, where = segment_to_arc(first, second, arc)
        line = first[:, None, :] + t[None, :, None] * (second - first)[:, None, :]
        sampled = distance_to_arc(line.reshape(-1, 2), arc).reshape(len(first), -1).min(axis=1)
        assert (d <= sampled + 1e-9).all()
        assert (sampled <= d + np.linalg.norm(second - first, axis=1) / 2400 + 1e-9).all()
        there = first + where[:, None] * (second - first)
        np.testing.assert_allclose(distance_to_arc(there, arc), d, atol=1e-9)


def test_a_crossing_between_distant_ends_has_distance_zero():
    circle = Arc(0.0, 0.0, 100.0, 0.0, 7.0)
    d, where = segment_to_arc(np.array([[0.0, 0.0]]), np.array([[5000.0, 0.0]]), circle)
    assert d[0] == pytest.approx(0.0, abs=1e-9)
    assert where[0] == pytest.approx(0.02)


def test_an_arc_of_no_extent_is_a_point():
    point = Arc(0.0, 0.0, 100.0, 0.3, 0.0)
    there = 100 * np.array([math.cos(0.3), math.sin(0.3)])
    for x in scatter(8, 30):
        assert distance_to_arc(x[None, :], point)[0] == pytest.approx(np.linalg.norm(x - there), abs=1e-6)


def test_what_is_not_a_number_stays_that():
    nan = np.array([[math.nan, 0.0]])
    d, _ = segment_to_arc(nan, np.zeros((1, 2)), FAMILIES["narrow"].arcs[0])
    assert math.isnan(d[0])
    assert math.isnan(distance_to_arc(nan, FAMILIES["narrow"].arcs[1])[0])
    assert not FAMILIES["narrow"].inside(nan)[0]


@pytest.mark.parametrize("name", FAMILIES | FULL)
def test_the_nearest_place_is_at_the_distance(name):
    space = (FAMILIES | FULL)[name]
    points = scatter(9, 100)
    for arc in space.arcs:
        gap = np.linalg.norm(points - nearest_on_arc(points, arc), axis=1)
        np.testing.assert_allclose(gap, distance_to_arc(points, arc), atol=1e-6)


@pytest.mark.parametrize(
    "space",
    [
        workspace(500, 500, (10, -10), (0, 150)),
        workspace(500, 500, (-10, 10), (150, 0)),
        workspace(500, 500, (-10, 10), (-20, 10)),
        workspace(0, 500, (-10, 10), (0, 10)),
        workspace(500, math.nan, (-10, 10), (0, 10)),
        workspace(500, 500, (math.nan, 10), (0, 10)),
    ],
)
def test_limits_that_leave_nothing_hold_nothing(space):
    assert space.empty
    assert not space.inside(scatter(1)).any()


def test_outside_only_the_nearest_side_is_negative():
    distances = np.array([[5.0, 3.0, 2.0, 9.0], [5.0, 3.0, 2.0, 9.0]])
    inside = np.array([True, False])
    np.testing.assert_array_equal(
        signed_sides(distances, inside, full_revolution=False), [[5, 3, 2, 9], [5, 3, -2, 9]]
    )
    np.testing.assert_array_equal(
        signed_sides(distances, inside, full_revolution=True), [[5, 3, 2, 9], [5, -3, 2, 9]]
    )
