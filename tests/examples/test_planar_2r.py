"""The sampled planar arm against the exact workspace, and against trying the joints."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cutgate.runtime.library.other_arms import Polyline
from cutgate.runtime.workspace.distance import signed_distance
from cutgate.runtime.workspace.planar import PlanarWorkspace
from examples.planar_2r import Planar2R, main, verify
from tests.runtime.workspace.test_planar import FAMILIES, FULL

DEG = math.pi / 180
UNLIMITED = (-math.inf, math.inf)


def like(space, sign=1.0):
    """The arm of an exact right-elbow workspace, or its mirror image."""
    q0 = UNLIMITED if space.full_revolution else (space.q0_lo, space.q0_hi)
    q1 = (space.q1_lo, space.q1_hi)
    if sign < 0:
        q0, q1 = (-q0[1], -q0[0]), (-q1[1], -q1[0])
    return Planar2R(space.a0, space.a1, q0, q1)


@given(
    name=st.sampled_from(sorted(FAMILIES | FULL)),
    sign=st.sampled_from([1.0, -1.0]),
    spacing=st.floats(0.5, 30.0),
    seed=st.integers(0, 1000),
)
@settings(deadline=None, max_examples=60)
def test_the_sampled_distance_is_off_the_exact_one_by_at_most_its_stated_error(name, sign, spacing, seed):
    space = (FAMILIES | FULL)[name]
    (side,) = like(space, sign).sides()
    distance = side.distance(spacing)
    points = np.random.default_rng(seed).uniform(-1050, 1050, (300, 2))
    exact = signed_distance(points, space)
    assert distance.error <= spacing / 2 + 1e-5
    assert (np.abs(distance(points * (1.0, sign)) - exact) <= distance.error).all()


@given(
    links=st.tuples(st.floats(100, 600), st.floats(100, 600)),
    middle=st.floats(-3, 3),
    span=st.floats(0.05, 6.2),
    bend=st.tuples(st.floats(0.02, math.pi), st.floats(0.02, math.pi)),
    seed=st.integers(0, 1000),
)
@settings(deadline=None, max_examples=60)
def test_an_elbow_that_bends_both_ways_has_the_workspace_of_each_side(links, middle, span, bend, seed):
    q0 = (middle - span / 2, middle + span / 2)
    arm = Planar2R(*links, q0, (-bend[0], bend[1]))
    right, left = arm.sides()
    points = np.random.default_rng(seed).uniform(-sum(links), sum(links), (200, 2))
    exact = signed_distance(points, PlanarWorkspace(*links, *q0, 0.0, bend[1]))
    mirrored = signed_distance(points * (1, -1), PlanarWorkspace(*links, -q0[1], -q0[0], 0.0, bend[0]))
    for side, true in ((right, exact), (left, mirrored)):
        distance = side.distance(5.0)
        assert (np.abs(distance(points) - true) <= distance.error).all()


def reach(arm, sign, points):
    """Distance of each joint to its limits, by the law of cosines, one elbow; negative out of reach. (n,)."""
    r2 = (points**2).sum(axis=1)
    with np.errstate(invalid="ignore"):
        q1 = sign * np.arccos((r2 - arm.a0**2 - arm.a1**2) / (2 * arm.a0 * arm.a1))
        inner = sign * np.arccos((r2 + arm.a0**2 - arm.a1**2) / (2 * arm.a0 * np.sqrt(r2)))
    q0 = np.arctan2(points[:, 1], points[:, 0]) - inner
    middle = (arm.q0[0] + arm.q0[1]) / 2
    q0 = middle + np.angle(np.exp(1j * (q0 - middle)))
    return np.nan_to_num(
        np.minimum.reduce((q0 - arm.q0[0], arm.q0[1] - q0, q1 - arm.q1[0], arm.q1[1] - q1)), nan=-1.0
    )


@given(seed=st.integers(0, 10_000))
@settings(deadline=None, max_examples=80)
def test_an_admitted_path_has_joints_on_that_side_everywhere(seed):
    rng = np.random.default_rng(seed)
    arm = Planar2R(420.0, 380.0, (-70 * DEG, 110 * DEG), (-120 * DEG, 140 * DEG))
    path = Polyline(rng.uniform(-100, 700, 2) + np.cumsum(rng.normal(0, 80, (4, 2)), axis=0))
    samples = path.at(np.repeat(np.arange(3), 300), np.tile(np.linspace(0, 1, 300), 3))
    for elbow, found in verify(arm, path, 2.0, 2.0).items():
        margins = reach(arm, 1.0 if elbow == "right" else -1.0, samples)
        if found.admissible:
            assert margins.min() > 0.0
        if found.outcome == "inadmissible" and found.attained < -2.0:
            assert margins.min() < 0.01


def test_a_path_that_would_have_to_change_the_elbow_on_its_way_is_not_admitted():
    arm = Planar2R(420.0, 380.0, (-40 * DEG, 40 * DEG), (-120 * DEG, 120 * DEG))
    r = 600.0
    ends = [np.array([[r * math.cos(a), r * math.sin(a)]] * 2) for a in (70 * DEG, -70 * DEG)]
    admitted = [{e for e, c in verify(arm, Polyline(end), 2.0, 1.0).items() if c.admissible} for end in ends]
    assert admitted == [{"right"}, {"left"}]
    both = Polyline(np.concatenate((ends[0][:1], [[r, 0.0]], ends[1][:1])))
    assert not any(c.admissible for c in verify(arm, both, 2.0, 1.0).values())


@pytest.mark.parametrize(
    "wrong",
    [
        (0.0, 300.0, (0, 1), (0, 1)),
        (300.0, math.nan, (0, 1), (0, 1)),
        (300.0, math.inf, (0, 1), (0, 1)),
        (300.0, 300.0, (1, 0), (0, 1)),
        (300.0, 300.0, (0, 6.3), (0, 1)),
        (300.0, 300.0, (math.nan, 1), (0, 1)),
        (300.0, 300.0, (-math.inf, 1), (0, 1)),
        (300.0, 300.0, (0, 1), (1, 0)),
        (300.0, 300.0, (0, 1), (0, 3.2)),
        (300.0, 300.0, (0, 1), (math.nan, 1)),
    ],
)
def test_an_arm_without_usable_limits_is_refused(wrong):
    with pytest.raises(ValueError, match="must"):
        Planar2R(*wrong)


def test_an_elbow_that_cannot_bend_leaves_nothing_to_admit():
    assert not list(Planar2R(300.0, 300.0, (0, 1), (0, 0)).sides())


def test_the_example_shows_what_finer_samples_decide(capsys):
    main()
    shown = capsys.readouterr().out
    assert [shown.count(word) for word in ("undecided", " admissible", "inadmissible")] == [1, 2, 3]
