"""Joint accelerations inside the segments, against differences of independently computed joints."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cutgate.runtime.verification import certified
from cutgate.runtime.verification.bounds import acceleration, chain, enclosures, motion
from cutgate.runtime.verification.bounds.geometry import canonical
from tests.oracle.dense import Dense
from tests.runtime.verification.cases import DEG, WIDE, axis, problem, random_problem, wrist_path

GENTLE = np.full(5, 1e9)


def differenced(case, per_segment=401):
    """Largest |q''| of each joint, rad/s2 and mm/s2, by central differences of the reference's joints."""
    dense, n = Dense(case, 2), len(case.tips_mm) - 1
    segment, s = np.repeat(np.arange(n), per_segment), np.tile(np.linspace(0, 1, per_segment), n)
    q = dense.joints(*dense.poses(segment, s))[1].reshape(n, per_segment, 5)
    for joint in (0, 3):
        q[:, :, joint] = np.unwrap(q[:, :, joint], axis=1)
    h = dense.seconds / (per_segment - 1)
    return (np.abs(np.diff(q, n=2, axis=1)).max(axis=1) / h[:, None] ** 2).max(axis=0)


def peaks(verdict):
    return verdict.acceleration


@pytest.mark.parametrize("seed", range(40))
def test_the_peak_bounds_every_difference_and_is_nearly_reached(seed):
    rng = np.random.default_rng([20260301, seed])
    case = replace(random_problem(rng, segments=int(rng.integers(1, 5))), acceleration=GENTLE)
    verdict = certified.verify(case)
    if verdict.branch is None or any(
        b.violated for n, b in verdict.boundaries.items() if n in {"inner", "outer"}
    ):
        return
    found = differenced(case)
    for line in peaks(verdict):
        assert line.peak is not None
        assert line.peak >= found[line.joint] * (1 - 2e-3) - 1e-6, (seed, line, found)


@pytest.mark.parametrize("seed", range(40))
def test_with_a_limit_near_the_peak_the_bracket_is_narrow(seed):
    rng = np.random.default_rng([20260302, seed])
    case = random_problem(rng, calibrated=False, segments=2)
    verdict = certified.verify(case)
    if not verdict.admissible:
        return
    found = differenced(case)
    if not (found > 1e-6).all():
        return
    refused = certified.verify(replace(case, acceleration=found * 0.95))
    admitted = certified.verify(replace(case, acceleration=found * 1.02))
    for line in peaks(refused):
        assert not line.ok
        assert 0.95 * found[line.joint] < line.peak <= found[line.joint] * (1 + 2e-3) + 1e-9, (line, found)
    assert admitted.admissible, (found, admitted.reasons)


@pytest.mark.parametrize("seed", range(20))
def test_the_formula_agrees_with_differences_at_one_place(seed):
    rng = np.random.default_rng([20260303, seed])
    case = random_problem(rng, calibrated=bool(seed % 2), segments=1)
    dense = Dense(case, 2)
    if not dense.inside.all():
        return
    geometry, segments = canonical(case)
    s, h = 0.4, 1e-3
    exact = acceleration.joint_accelerations(geometry, segments, np.zeros(1, dtype=np.int64), np.array([s]))[
        0
    ]
    _, q = dense.joints(*dense.poses(np.zeros(3, dtype=int), np.array([s - h, s, s + h])))
    q[:, [0, 3]] = np.unwrap(q[:, [0, 3]], axis=0)
    numeric = geometry.side * np.diff(q, n=2, axis=0)[0] / h**2 / segments.seconds[0] ** 2
    numeric[[2, 4]] *= geometry.side
    assert exact == pytest.approx(numeric, rel=1e-3, abs=1e-3)


@pytest.mark.parametrize("seed", range(60))
def test_the_terms_bound_second_and_third_derivatives_on_every_interval(seed):
    """Sampled on intervals from whole segments down to a sixteenth, in units of the interval."""
    rng = np.random.default_rng([20260304, seed])
    case = random_problem(rng, calibrated=bool(seed % 2), segments=3, wide=bool(seed % 3))
    geometry, segments = canonical(case)
    pieces = chain.cut(
        geometry, segments, np.array([1] * 3 + [2] * 15), np.r_[0.25:1:0.25, np.arange(1, 16) / 16]
    )
    parts = pieces.intervals(0, len(pieces), enclosures.COLUMNS)
    known = (
        motion.motion_of(geometry, segments, parts),
        motion.angles_of(geometry, segments, parts, motion.motion_of(geometry, segments, parts)),
    )
    second, third, _ = acceleration._derivatives(geometry, parts, *known)
    n = 41
    s = parts.s0[:, None] + (parts.s1 - parts.s0)[:, None] * np.linspace(0, 1, n)
    exact = acceleration.joint_accelerations(geometry, segments, np.repeat(parts.segment, n), s.ravel())
    exact = exact.reshape(len(parts), n, 5) * (known[0].seconds ** 2)[:, None, None]
    jerk = np.abs(np.diff(exact, axis=1)).max(axis=1) * (n - 1)
    defined = np.isfinite(exact).all(axis=(1, 2)) & np.isfinite(second).all(axis=1)
    assert (np.abs(exact).max(axis=1) <= second * (1 + 1e-9) + 1e-9)[defined].all()
    assert (jerk <= third * (1 + 1e-9) + 1e-9)[defined].all()


def test_a_segment_that_takes_no_time_accelerates_nothing():
    tips, axes = wrist_path([[600, 0, 100], [600, 0, 100], [600, 50, 100]], axis(1.0, 0.3))
    geometry, segments = canonical(problem(tips, axes))
    found = acceleration.joint_accelerations(geometry, segments, np.array([0, 1]), np.array([0.5, 0.5]))
    assert (found[0] == 0.0).all()
    assert found[1, 0] != 0.0


def test_a_wrist_swinging_round_at_constant_rate_pulls_the_slide_as_a_pendulum():
    """Tip at rest, axis turning by pi/2 in the plane of the column at l theta / feed: |z''| is l (theta/T)^2 cos q4."""
    start, end = 20 * DEG, 110 * DEG
    limits = np.full(5, 1e6)
    case = problem(
        np.repeat([[500.0, 0.0, 200.0]], 2, axis=0),
        axis([start, end], [math.pi, math.pi]),
        lower=np.array([-160 * DEG, 0.0, -1000.0, -WIDE, 0.0]),
        upper=np.array([160 * DEG, 150 * DEG, 1000.0, WIDE, 170 * DEG]),
        speed=np.full(5, 1e6),
        acceleration=limits,
    )
    rate = case.feed_mm_s / case.tool_length_mm
    peak = 160.0 * rate**2 * math.cos(start)
    slide = peaks(certified.verify(case))[2]
    assert peak <= slide.peak <= peak + 0.006 * limits[2]
    for part, ok in ((1.001, True), (0.999, False)):
        tight = np.array([1e6, 1e6, peak * part, 1e6, 1e6])
        verdict = certified.verify(replace(case, acceleration=tight))
        assert peaks(verdict)[2].ok is ok
        assert verdict.admissible is ok
        if not ok:
            assert any("joint 2: needs up to" in r and "mm/s2" in r for r in verdict.reasons)


def test_straight_motion_along_the_slide_accelerates_nothing():
    tips, axes = wrist_path([[600, 0, 100], [600, 0, 300]], axis(1.0, 0.3))
    verdict = certified.verify(problem(tips, axes, acceleration=np.full(5, 1e-6)))
    assert verdict.admissible, verdict.reasons
    assert all(line.peak <= 1e-6 for line in peaks(verdict))


def test_a_resting_path_accelerates_nothing():
    tips, axes = wrist_path([[600, 0, 100]] * 3, axis(1.0, 0.3))
    verdict = certified.verify(problem(tips, axes, acceleration=np.full(5, 1e-6)))
    assert verdict.admissible, verdict.reasons


def test_no_acceleration_lines_without_limits_and_unusable_limits_are_refused():
    tips, axes = wrist_path([[600, 0, 100], [600, 50, 100]], axis(1.0, 0.3))
    case = problem(tips, axes)
    assert certified.verify(case).acceleration == ()
    for bad in (np.array([1.0, 1.0, 0.0, 1.0, 1.0]), np.array([1.0, 1.0, math.nan, 1.0, 1.0]), np.ones(4)):
        verdict = certified.verify(replace(case, acceleration=bad))
        assert not verdict.admissible
        assert any("acceleration limit" in reason for reason in verdict.reasons)


def test_a_held_roll_does_not_accelerate():
    tips, axes = wrist_path([[500, 0, 100], [600, 200, 100]], axis(0.0, 0.0))
    case = problem(tips, axes, hold_roll=0.0, acceleration=np.full(5, 100.0))
    verdict = certified.verify(case)
    assert verdict.admissible, verdict.reasons
    assert peaks(verdict)[3].peak == 0.0


def test_a_pass_beside_the_column_is_refused_by_its_acceleration_alone():
    """A chord near the inner circle at 50 mm/s: slow enough for the speeds, too sudden for the acceleration."""
    tips, axes = wrist_path([[-400, 120, 100], [400, 120, 100]], axis(1.2, 0.0))
    case = problem(
        tips,
        axes,
        feed_mm_s=50.0,
        lower=np.array([-WIDE, 0.0, 50.0, -WIDE, 0.0]),
        upper=np.array([WIDE, 175 * DEG, 450.0, WIDE, 110 * DEG]),
        speed=np.full(5, 300.0),
    )
    assert certified.verify(case).admissible
    limit = differenced(case)[0]
    assert not certified.verify(
        replace(case, acceleration=np.array([limit * 0.99, 1e6, 1e6, 1e6, 1e6]))
    ).admissible
    assert certified.verify(
        replace(case, acceleration=np.array([limit * 1.01, 1e6, 1e6, 1e6, 1e6]))
    ).admissible
