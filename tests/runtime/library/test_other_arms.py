"""Certifying a path against any distance: proven values only, and every doubt denies."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cutgate.runtime.library.other_arms import ExactPlanar, Polyline, SampledBoundary, certify, sample_curve
from cutgate.runtime.workspace.distance import signed_distance
from tests.runtime.workspace.test_planar import FAMILIES, FULL

SPACE = FAMILIES["equal links"]
INSIDE = np.array([[500.0, 250.0], [700.0, 100.0], [600.0, 300.0]])


@dataclass
class Disc:
    """The distance inside a disc of radius 100 about the origin, exact or distorted on request."""

    lipschitz: float = 1.0
    error: float = 0.0
    noise: object = None
    asked: list = field(default_factory=list)

    def __call__(self, points):
        self.asked.extend(points.tolist())
        d = 100.0 - np.linalg.norm(points, axis=1)
        return d if self.noise is None else d + self.noise(points)


def chord(height, half=60.0):
    """A straight path at a distance of ``height`` from the centre: clearance 100 - hypot(half, height)."""
    return Polyline(np.array([[-half, height], [half, height]]))


class Backward(Polyline):
    """A path that states one negative length."""

    def __init__(self):
        super().__init__(np.array([[0.0, 0.0], [50.0, 0.0], [60.0, 0.0]]))

    @property
    def lengths(self):
        return np.array([50.0, -10.0])


def dense(path, parts=400):
    segments = np.repeat(np.arange(len(path.lengths)), parts + 1)
    return path.at(segments, np.tile(np.linspace(0, 1, parts + 1), len(path.lengths)))


@given(seed=st.integers(0, 10_000), name=st.sampled_from(sorted(FAMILIES | FULL)), corners=st.integers(2, 5))
@settings(deadline=None, max_examples=120)
def test_the_true_minimum_lies_between_certified_and_attained(seed, name, corners):
    space = (FAMILIES | FULL)[name]
    rng = np.random.default_rng(seed)
    path = Polyline(rng.uniform(-900, 900, 2) + np.cumsum(rng.normal(0, 60, (corners, 2)), axis=0))
    distance = ExactPlanar(space)
    found = certify(path, distance, 5.0)
    sampled = signed_distance(dense(path), space).min()
    assert found.certified <= sampled
    assert found.certified <= found.attained
    assert found.attained <= sampled + 0.2
    there = path.at(np.array([found.segment]), np.array([found.fraction]))
    assert signed_distance(there, space)[0] == pytest.approx(found.attained, abs=1e-9)
    assert found.attained - found.certified <= 0.1 + 4 * distance.error
    if found.admissible:
        assert sampled >= 5.0
    if found.outcome == "inadmissible":
        assert found.attained < 5.0


@given(seed=st.integers(0, 10_000), error=st.sampled_from([0.01, 1.0, 8.0]), deadband=st.floats(1.0, 40.0))
@settings(deadline=None, max_examples=120)
def test_values_off_by_no_more_than_the_stated_error_never_admit_what_violates_the_deadband(
    seed, error, deadband
):
    rng = np.random.default_rng(seed)
    path = Polyline(rng.uniform(-80, 80, (4, 2)))
    distance = Disc(error=error, noise=lambda points: rng.uniform(-error, error, len(points)))
    found = certify(path, distance, deadband)
    least = 100.0 - np.linalg.norm(path.points, axis=1).max()
    assert found.certified <= least <= found.attained + error
    assert found.admissible <= (least >= deadband)
    assert (found.outcome == "inadmissible") <= (least < deadband)


@pytest.mark.parametrize("shortfall", [1e-2, 2e-3])
def test_it_decides_close_to_the_deadband_on_both_sides(shortfall):
    least = 100.0 - math.hypot(60.0, 10.0)
    assert certify(chord(10.0), Disc(), least - shortfall).admissible
    assert certify(chord(10.0), Disc(), least + shortfall).outcome == "inadmissible"


def test_a_dip_between_the_points_is_found():
    path = Polyline(np.array([[40.0, -30.0], [40.0, 30.0]]) * 2)

    class Outside(Disc):
        def __call__(self, points):
            return np.linalg.norm(points, axis=1) - 70.0

    found = certify(path, Outside(), 15.0)
    assert found.outcome == "inadmissible"
    assert found.attained == pytest.approx(10.0, abs=0.1)
    assert found.fraction == pytest.approx(0.5)


def test_what_the_error_bound_leaves_open_is_undecided_and_says_so():
    least = 100.0 - math.hypot(60.0, 10.0)
    found = certify(chord(10.0), Disc(error=0.5), least - 0.3)
    assert (found.outcome, found.admissible) == ("undecided", False)
    assert found.certified < least - 0.3 <= found.attained + 0.5
    assert "straddles" in found.reason
    assert certify(chord(10.0), Disc(error=0.5), least - 1.01).admissible


def test_effort_is_bounded_and_what_was_proven_by_then_counts():
    along = Polyline(np.array([[-5e4, 0.0], [5e4, 0.0]]))

    @dataclass
    class Wall:
        lipschitz: float = 1.0
        error: float = 0.0
        count: int = 0

        def __call__(self, points):
            self.count += len(points)
            return 10.0 - points[:, 1]

    for most in (2, 3, 500, 9_000, 30_000):
        wall = Wall()
        found = certify(along, wall, 5.0, most_evaluations=most)
        assert found.evaluations == wall.count <= most
        assert found.certified <= 10.0
        assert found.outcome == ("admissible" if most == 30_000 else "undecided")
    assert certify(along, Wall(), 5.0, most_evaluations=1).evaluations == 0


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("where", [0, 1, 2, 5])
def test_a_value_that_is_not_a_finite_number_denies_wherever_it_appears(bad, where):
    count = iter(range(10_000))

    def noise(points):
        return np.array([bad if next(count) == where else 0.0 for _ in points])

    found = certify(chord(10.0), Disc(noise=noise), 30.0)
    assert found.outcome == "undecided"
    assert (found.attained, found.certified) == (None, None)
    assert "finite" in found.reason


@pytest.mark.parametrize(
    "change",
    [
        {"deadband": math.nan}, {"deadband": 0.0}, {"deadband": -1.0}, {"deadband": math.inf},
        {"tolerance": math.nan}, {"tolerance": 0.0},
        {"distance": Disc(lipschitz=math.nan)}, {"distance": Disc(lipschitz=-1.0)},
        {"distance": Disc(error=math.nan)}, {"distance": Disc(error=-1.0)}, {"distance": Disc(error=math.inf)},
        {"path": Polyline(np.array([[0.0, 0.0], [math.nan, 0.0]]))},
        {"path": Polyline(np.array([[0.0, 0.0], [math.inf, 0.0]]))},
        {"path": Polyline(np.zeros((1, 2)))}, {"path": Backward()},
    ],
)  # fmt: skip
def test_numbers_that_mean_nothing_deny(change):
    values = {"path": chord(10.0), "distance": Disc(), "deadband": 5.0} | change
    found = certify(**values)
    assert not found.admissible
    assert (found.certified, found.evaluations) == (None, 0)


def test_values_that_contradict_the_stated_lipschitz_bound_deny():
    assert certify(chord(10.0), Disc(), 30.0).admissible
    found = certify(chord(10.0), Disc(lipschitz=0.2), 30.0)
    assert found.outcome == "undecided"
    assert "faster" in found.reason


def test_a_path_that_stands_still_is_judged_where_it_stands():
    for x, outcome in ((90.0, "admissible"), (96.0, "inadmissible")):
        found = certify(Polyline(np.array([[x, 0.0], [x, 0.0]])), Disc(), 5.0)
        assert (found.outcome, found.evaluations) == (outcome, 2)


def test_reversed_paths_have_the_same_answer():
    path = Polyline(INSIDE)
    one, two = (certify(p, ExactPlanar(SPACE), 5.0) for p in (path, replace(path, points=INSIDE[::-1])))
    assert one.outcome == two.outcome == "admissible"
    assert one.attained == pytest.approx(two.attained, abs=0.11)


@given(radius=st.floats(1.0, 900.0), spacing=st.floats(0.5, 50.0), seed=st.integers(0, 1000))
@settings(deadline=None, max_examples=60)
def test_a_sampled_curve_is_off_by_at_most_half_the_spacing(radius, spacing, seed):
    def circle(t):
        return radius * np.stack((np.cos(t), np.sin(t)), axis=1)

    samples = sample_curve(circle, 0.0, 2 * math.pi, radius, spacing)
    gaps = np.linalg.norm(np.diff(samples, axis=0), axis=1)
    assert gaps.max() <= spacing + 1e-9
    distance = SampledBoundary(samples, spacing, lambda p: np.linalg.norm(p, axis=1) <= radius, 1e-9)
    points = np.random.default_rng(seed).uniform(-1.2 * radius, 1.2 * radius, (200, 2))
    true = radius - np.linalg.norm(points, axis=1)
    assert (np.abs(distance(points) - true) <= distance.error).all()


def test_points_are_taken_in_blocks_with_the_same_answer(monkeypatch):
    samples = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    distance = SampledBoundary(samples, 0.1, lambda p: p[:, 0] > 0.0, 0.0)
    points = np.random.default_rng(1).uniform(-1, 1, (33, 3))
    whole = distance(points)
    monkeypatch.setattr("cutgate.runtime.library.other_arms.PAIRS", 120)
    np.testing.assert_array_equal(distance(points), whole)
    assert np.isnan(distance(np.full((1, 3), math.nan))).all()
