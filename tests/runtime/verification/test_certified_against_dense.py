"""The certified method against an independent dense reference: ten thousand random segments.

The rules stand in `judge.py`; `make test-long` runs them over a million segments.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cutgate.runtime.verification import certified
from cutgate.runtime.verification.verdict import ARM_BOUNDARIES
from tests.oracle.dense import Dense
from tests.runtime.verification import judge
from tests.runtime.verification.cases import DEG, random_problem
from tests.runtime.verification.random_paths import random_paths, with_deadband
from tests.seeds import seeds

SEEDS = range(40)
SEGMENTS = 250
"""Of each seed: 10 000 in all, not half of them in every run."""


@cache
def tally(seed):
    """A share of the random segments, judged once for all rules."""
    return judge.share([20260101, seed], SEGMENTS)


@pytest.mark.parametrize("seed", seeds(18, 22))
@pytest.mark.parametrize("rule", [rule.__name__ for rule in judge.RULES])
def test_the_gate_against_dense_sampling(seed, rule):
    assert [(where, what) for broken, where, what in tally(seed).wrong if broken == rule] == []


@pytest.mark.slow
def test_the_random_segments_are_as_many_and_as_various_as_promised():
    whole = judge.Tally()
    for seed in SEEDS:
        whole.add(tally(seed))
    assert whole.segments == len(SEEDS) * SEGMENTS >= 10_000
    assert 0.35 < whole.admitted / whole.paths < 0.75
    assert whole.sharpened > whole.paths / 4
    assert whole.undecided > 50  # brackets that straddle a deadband of a path that another boundary refuses


def test_the_random_paths_cover_what_they_must():
    drawn = [p for seed in range(8) for p in random_paths(np.random.default_rng(seed), (9, 40), 250)]
    turns = np.concatenate([Dense(p, 2).turn for p in drawn]) / DEG
    spans = np.array([p.upper[0] - p.lower[0] for p in drawn]) / DEG
    still = [np.linalg.norm(np.diff(p.tips_mm, axis=0), axis=1) == 0.0 for p in drawn]
    same = [s & (np.diff(p.axes, axis=0) == 0.0).all(axis=1) for s, p in zip(still, drawn, strict=True)]
    behind = [np.abs(np.diff(np.arctan2(p.tips_mm[:, 1], p.tips_mm[:, 0]))).max() > 6.0 for p in drawn]
    starts = [Dense(p, 2).inside[0] for p in drawn]
    assert 160 < turns.max() <= 170 + 1e-6
    assert {(p.arm.elbow, np.sign(p.arm.upper_mm - p.arm.forearm_mm)) for p in drawn} >= {
        (elbow, sign) for elbow in ("left", "right") for sign in (-1, 0, 1)
    }
    assert spans.min() < 4
    assert ((spans > 359) & (spans < 360)).any()
    assert (spans > 400).any()
    assert np.concatenate(same).any()
    assert (np.concatenate(still) & ~np.concatenate(same)).any()
    assert any(behind)
    assert 0.5 < np.mean(starts) < 1.0
    assert any(p.calibration.slide_tilt.any() and p.calibration.residual_mm for p in drawn)
    assert {round(p.deadband.arm_mm, 4) for p in drawn} == {1e-4, 0.01, 1.0, 5.0}
    bends = [sorted(np.abs((p.lower[1], p.upper[1]))) for p in drawn]
    assert {(low == 0.0, high > np.pi - 1e-9) for low, high in bends} == {
        (a, b) for a in (0, 1) for b in (0, 1)
    }


@pytest.mark.parametrize("seed", range(4))
def test_a_slide_that_leans_far_more_than_it_may(seed):
    """Up to 0.7, where 0.02 is allowed: what the shear does to lengths is then no longer small."""
    assert judge.share([20260105, seed], 150, lean=0.7).wrong == []


@pytest.mark.parametrize("seed", range(2))
def test_a_boundary_is_violated_exactly_from_its_clearance_on(seed):
    """Whatever the place and the boundary: a deadband a little above its clearance refuses, below it not."""
    tried = 0
    for problem in random_paths(np.random.default_rng([20260104, seed]), (2, 9), 60):
        verdict = certified.verify(problem)
        errors = verdict.deadband_arm_mm - problem.deadband.arm_mm
        for name in ARM_BOUNDARIES:
            b = verdict.boundaries.get(name)
            if b is None or verdict.branch is None or b.certified is None or b.certified - errors <= 0.02:
                continue
            tried += 1
            for needed, violated in ((b.clearance + 1e-9, True), (b.certified - 6e-4, False)):
                again = certified.verify(with_deadband(problem, needed - errors, problem.deadband.wrist_rad))
                assert again.boundaries[name].violated is violated, (name, needed, again.boundaries[name])
    assert tried > 40


@pytest.mark.parametrize("seed", range(3))
def test_a_shoulder_that_leaves_its_unwrapped_limits_is_bounded_from_below(seed):
    """The branch is asked for, so the path may leave its limit: the bound then holds outside as well."""
    rng = np.random.default_rng([20260103, seed])
    left = 0
    for _ in range(12):
        problem = random_problem(rng, calibrated=False, segments=4, spinning=True, wide=True)
        free = Dense(problem, 150)
        q0 = free.unwrapped(0, 0)
        lower, upper = problem.lower.copy(), problem.upper.copy()
        upper[0] = (q0.min() + q0.max()) / 2
        lower[0] = upper[0] - 6.4
        cut = replace(problem, upper=upper, lower=lower, branch=(0, 0))
        verdict, dense = certified.verify(cut), Dense(cut, 150)
        b = verdict.boundaries.get("left")
        if not dense.inside.all() or b is None or b.certified is None:
            continue
        left += 1
        assert not verdict.admissible
        assert b.certified <= dense.least_unwrapped_sides(0)[0] + judge.ORACLE
        assert verdict.branch is None
    assert left > 3


def test_tiny_deadbands_near_the_limits_admit_nothing_that_touches():
    rng = np.random.default_rng(11)
    admitted = 0
    for _ in range(40):
        problem = with_deadband(random_problem(rng, calibrated=False, segments=2), 1e-4, 1e-4 * DEG)
        case = judge.judged(problem, 100)
        if case.verdict.admissible:
            admitted += 1
            assert case.inside
            assert min(case.margins.values()) > 0
    assert admitted > 10
