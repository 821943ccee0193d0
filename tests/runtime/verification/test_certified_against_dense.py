"""The certified method against an independent dense reference on random arms, limits and paths."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from runtime.verification import certified
from runtime.verification.problem import Arm, Calibration, Deadband
from runtime.verification.verdict import ARM_BOUNDARIES
from tests.oracle.dense import Dense
from tests.runtime.verification.cases import DEG, random_problem

SEEDS = range(11)
CASES = 16
ORACLE_MM = 2e-5
"""What the reference's sampled distance to an arc may be off."""


def draw(seed):
    """A dozen random problems of one seed; the seed is in the test's name."""
    rng = np.random.default_rng([20260101, seed])
    return [
        random_problem(rng, segments=int(rng.integers(1, 9)), wide=rng.random() < 0.2) for _ in range(CASES)
    ]


@cache
def judged(seed):
    """The problems of a seed with their verdicts and the dense reference."""
    return [(p, certified.verify(p), Dense(p, 80)) for p in draw(seed)]


def margins(problem, verdict, dense):
    found = dict(dense.margins)
    if verdict.branch is not None:
        found |= dense.roll(verdict.branch.roll_turns)
    return found


@pytest.mark.parametrize("seed", SEEDS)
def test_bounds_hold_at_every_sampled_pose_and_admitted_paths_keep_the_deadband_everywhere(seed):
    for case, (problem, verdict, dense) in enumerate(judged(seed)):
        sampled = margins(problem, verdict, dense)
        for name, b in verdict.boundaries.items():
            where = (case, name, b)
            if b.clearance is None:
                assert b.violated, where
                continue
            assert b.certified <= b.clearance, where
            assert b.violated is not (b.certified >= b.deadband), where
            if name not in sampled:
                continue
            least = np.nanmin(sampled[name])
            assert b.certified <= least + ORACLE_MM, where
            if verdict.admissible:
                assert least >= b.deadband - ORACLE_MM, where
            if dense.inside.all():
                assert b.clearance <= least + 0.011, where
        if verdict.admissible:
            assert dense.inside.all()
        elif not dense.inside.all():
            assert verdict.branch is None


@pytest.mark.parametrize("seed", SEEDS)
def test_clearances_are_attained_at_the_place_reported_and_enclosed_to_a_hundredth(seed):
    for case, (problem, verdict, dense) in enumerate(judged(seed)):
        if not dense.inside.all():
            continue
        named = [b for b in verdict.boundaries.values() if b.clearance is not None]
        kept = all(not verdict.boundaries[n].violated for n in ("inner", "outer", "wrist_singularity"))
        place = Dense(problem, 1)
        place.segment, place.s = np.array([b.segment for b in named]), np.array([b.fraction for b in named])
        there = place._margins(*place.poses(place.segment, place.s))
        for i, b in enumerate(named):
            if not b.name.startswith("roll"):
                assert there[b.name][i] == pytest.approx(b.clearance, abs=ORACLE_MM), (case, b)
            if kept or not b.name.startswith("roll"):
                assert b.clearance - b.certified <= 0.01, (case, b)


@pytest.mark.parametrize("seed", SEEDS)
def test_speeds_bound_every_sampled_speed(seed):
    for case, (problem, verdict, dense) in enumerate(judged(seed)):
        if not dense.inside.all():
            continue
        turn = np.arccos(np.clip((problem.axes[1:] * problem.axes[:-1]).sum(axis=1), -1, 1))
        step = np.linalg.norm(np.diff(problem.tips_mm, axis=0), axis=1)
        seconds = np.maximum(step, problem.tool_length_mm * turn) / problem.feed_mm_s
        seconds[seconds == 0.0] = np.inf
        q = np.stack((dense.q0, dense.q[:, 1], dense.q[:, 2], dense.q3, dense.q[:, 4]), axis=1)
        rate = np.abs(np.diff(q.reshape(len(seconds), 80, 5), axis=1)).max(axis=1) * 79 / seconds[:, None]
        for line in verdict.speed:
            if line.peak is None:
                assert not line.ok
            else:
                assert rate[:, line.joint].max() <= line.peak * (1 + 1e-6) + 1e-6, (case, line)
                assert line.ok is (line.peak <= line.limit)


@pytest.mark.parametrize("seed", range(2))
def test_a_boundary_is_violated_exactly_from_its_clearance_on(seed):
    """Whatever the place and the boundary: the deadband a little above its clearance refuses, below it not."""
    for case, problem in enumerate(draw(seed)[:8]):
        verdict = certified.verify(problem)
        rest = problem.calibration.residual_mm
        for name in ARM_BOUNDARIES:
            b = verdict.boundaries[name]
            if verdict.branch is None or b.certified is None or b.certified - rest <= 0.02:
                continue
            for needed, violated in ((b.clearance + 1e-9, True), (b.certified - 6e-4, False)):
                deadband = replace(problem.deadband, arm_mm=needed - rest)
                again = certified.verify(replace(problem, deadband=deadband)).boundaries[name]
                assert again.violated is violated, (case, name, needed, again)


def same(one, two, tolerance=0.0101, rename=None):
    """Equal clearances; those of the roll up to whole turns, which are counted from the first pose."""
    rename = rename or {}
    if min(b.clearance if b.clearance is not None else -1 for b in one.boundaries.values()) < 0:
        return
    for name, b in one.boundaries.items():
        other = two.boundaries[rename.get(name, name)]
        off = b.clearance - other.clearance
        if name.startswith("roll"):
            off = math.remainder(off, 360.0)
            if one.boundaries["outer"].violated or one.boundaries["inner"].violated:
                continue  # near the singular positions the bracket of the roll may be wider
        assert abs(off) <= tolerance, (b, other)


@pytest.mark.parametrize("seed", range(2))
def test_reversal_changes_nothing(seed):
    for problem in draw(seed):
        back = replace(problem, tips_mm=problem.tips_mm[::-1], axes=problem.axes[::-1])
        one, two = certified.verify(problem), certified.verify(back)
        if one.branch is None or two.branch is None:
            assert one.admissible is two.admissible is False
        else:
            same(one, two)


@pytest.mark.parametrize("seed", range(2))
def test_rotation_about_the_first_axis_with_its_limits_changes_nothing(seed):
    for problem in draw(seed):
        angle = 1.1
        c, s = math.cos(angle), math.sin(angle)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        add = np.array([angle, 0.0, 0.0, 0.0, 0.0])
        tilt = turn[:2, :2] @ problem.calibration.slide_tilt
        moved = replace(
            problem,
            tips_mm=problem.tips_mm @ turn.T,
            axes=problem.axes @ turn.T,
            lower=problem.lower + add,
            upper=problem.upper + add,
            calibration=replace(problem.calibration, slide_tilt=tilt),
        )
        one, two = certified.verify(problem), certified.verify(moved)
        if (
            one.branch is not None
            and two.branch is not None
            and one.branch.roll_turns == two.branch.roll_turns
        ):
            same(one, two)
        else:
            assert (one.branch is None) is (two.branch is None)


@pytest.mark.parametrize("seed", range(2))
def test_the_mirror_image_swaps_left_and_right_and_the_ends_of_the_roll(seed):
    flip = np.array([-1.0, -1.0, 1.0, -1.0, 1.0])
    swap = {"left": "right", "right": "left", "roll_min": "roll_max", "roll_max": "roll_min"}
    for problem in draw(seed):
        found = problem.calibration
        lower, upper = problem.lower * flip, problem.upper * flip
        image = replace(
            problem,
            arm=Arm(
                problem.arm.upper_mm,
                problem.arm.forearm_mm,
                "left" if problem.arm.elbow == "right" else "right",
            ),
            tips_mm=problem.tips_mm * (1, -1, 1),
            axes=problem.axes * (1, -1, 1),
            lower=np.minimum(lower, upper),
            upper=np.maximum(lower, upper),
            calibration=replace(
                found, joint_offset=found.joint_offset * flip, slide_tilt=found.slide_tilt * (1, -1)
            ),
        )
        one, two = certified.verify(problem), certified.verify(image)
        same(one, two, 1e-9, swap)
        assert (one.branch is None) is (two.branch is None)
        if one.branch is not None:
            assert (one.branch.q0_turns, one.branch.roll_turns) == (
                -two.branch.q0_turns,
                -two.branch.roll_turns,
            )


def test_tiny_deadbands_near_the_limits_admit_nothing_that_touches():
    rng = np.random.default_rng(11)
    admitted = 0
    for _ in range(25):
        problem = replace(
            random_problem(rng, calibrated=False, segments=2),
            deadband=Deadband(1e-4, 1e-4 * DEG),
            calibration=Calibration(),
            speed=np.full(5, 1e9),
        )
        verdict = certified.verify(problem)
        if verdict.admissible:
            admitted += 1
            dense = Dense(problem, 300)
            assert dense.inside.all()
            assert min(np.nanmin(m) for m in margins(problem, verdict, dense).values()) > 0
    assert admitted > 10


@pytest.mark.parametrize("seed", range(4))
def test_a_shoulder_of_more_than_a_turn_is_followed_continuously(seed):
    rng = np.random.default_rng([20260102, seed])
    counted = 0
    for case in range(16):
        problem = random_problem(
            rng, segments=int(rng.integers(2, 9)), spinning=True, wide=rng.random() < 0.5
        )
        verdict, dense = certified.verify(problem), Dense(problem, 150)
        if verdict.branch is None:
            assert not verdict.admissible
            continue
        sides = dense.lifted_sides(verdict.branch.q0_turns)
        q0 = dense.lifted(0, verdict.branch.q0_turns)
        assert dense.lo[0] - 1e-9 <= q0.min() <= q0.max() <= dense.hi[0] + 1e-9, case
        for name in ("left", "right"):
            least = sides[name].min()
            if name not in verdict.boundaries:
                assert least > verdict.deadband_arm_mm, (case, name)
                continue
            b = verdict.boundaries[name]
            counted += 1
            assert b.certified <= least + ORACLE_MM, (case, b)
            if verdict.admissible:
                assert least >= b.deadband - ORACLE_MM
    assert counted > 3


@pytest.mark.parametrize("seed", range(3))
def test_a_shoulder_that_leaves_its_lifted_limits_is_bounded_from_below(seed):
    """The branch is asked for, so the path may leave its limit: the bound then holds outside as well."""
    rng = np.random.default_rng([20260103, seed])
    left = 0
    for _ in range(12):
        problem = random_problem(rng, calibrated=False, segments=4, spinning=True, wide=True)
        free = Dense(problem, 150)
        q0 = free.lifted(0, 0)
        short = np.array([*problem.upper])
        short[0] = (q0.min() + q0.max()) / 2
        lower = np.array([*problem.lower])
        lower[0] = short[0] - 6.4
        cut = replace(problem, upper=short, lower=lower, branch=(0, 0))
        verdict, dense = certified.verify(cut), Dense(cut, 150)
        b = verdict.boundaries.get("left")
        if not dense.inside.all() or b is None or b.certified is None:
            continue
        left += 1
        assert not verdict.admissible
        assert b.certified <= dense.lifted_sides(0)["left"].min() + ORACLE_MM
        assert verdict.branch is None
    assert left > 3
