"""What must not change the answer: direction, subdivision, the cell's heading, the mirror, the unit of length."""

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from cutgate.runtime.verification import certified
from cutgate.runtime.verification.problem import ArmCalibration
from tests.oracle.dense import Dense
from tests.runtime.verification.cases import mirrored, turned
from tests.runtime.verification.judge import GAP, judged
from tests.runtime.verification.random_paths import random_paths

SEEDS = range(3)
SWAPPED = {"left": "right", "right": "left", "roll_min": "roll_max", "roll_max": "roll_min"}


@dataclass(frozen=True)
class Asked:
    """A random problem, its verdict, the same problem in the branch that it chose, and whether it stays within reach."""

    problem: object
    verdict: object
    chosen: object
    inside: bool


@cache
def drawn(seed):
    """Random problems, calibrated or not, within reach or not."""
    out = []
    for problem in random_paths(np.random.default_rng([20260301, seed]), (5, 12), 100):
        case = judged(problem, 40)
        branch = case.verdict.branch
        turns = None if branch is None else (branch.q0_turns, branch.roll_turns)
        out.append(Asked(problem, case.verdict, replace(problem, branch=turns), case.inside))
    assert sum(asked.inside for asked in out) > 8
    return out


def same(asked, two, *, tolerance=GAP, names=None, scale=1.0):
    """Equal verdicts, and values equal within what both brackets leave open; out of the reach both refuse.

    Verdicts may differ where a bracket ends at its deadband.
    """
    one = asked.verdict
    if not asked.inside:
        assert one.admissible is two.admissible is False
        return
    close = 0
    assert set(two.boundaries) == {(names or {}).get(name, name) for name in one.boundaries}
    for name, b in one.boundaries.items():
        other, k = two.boundaries[(names or {}).get(name, name)], 1.0 if b.unit == "deg" else scale
        if b.clearance is None or other.clearance is None:
            assert b.violated
            assert other.violated
            continue
        if not (name.startswith("roll") and wide(one)):
            assert other.clearance == pytest.approx(k * b.clearance, abs=k * tolerance), name
            assert other.certified == pytest.approx(k * b.certified, abs=k * tolerance), name
        if b.certified - tolerance < b.deadband < b.clearance + tolerance:
            close += 1
        else:
            assert other.violated is b.violated, name
    assert (one.branch is None) is (two.branch is None)
    if close == 0 and [line.ok for line in one.speed] == [line.ok for line in two.speed]:
        assert two.admissible is one.admissible


def wide(verdict):
    """Whether the roll's bracket may be wider: near the singular positions."""
    return any(verdict.boundaries[name].violated for name in ("inner", "outer", "wrist_singularity"))


def turns_at_the_end(problem):
    """The branch of a path, counted at its last pose."""
    dense = Dense(problem, 80)
    turns = []
    for joint, k in zip((0, 3), problem.branch, strict=True):
        last = dense.unwrapped(joint, k)[-1] - problem.calibration.joint_offset[joint]
        turns.append(math.ceil((last - math.pi) / (2 * math.pi)))
    return tuple(turns)


@pytest.mark.parametrize("seed", SEEDS)
def test_reversal(seed):
    for asked in drawn(seed):
        branch = turns_at_the_end(asked.chosen) if asked.chosen.branch else None
        tips, axes = asked.problem.tips_mm[::-1], asked.problem.axes[::-1]
        same(asked, certified.verify(replace(asked.problem, tips_mm=tips, axes=axes, branch=branch)))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("parts", [2, 7])
def test_subdivision_of_the_segments(seed, parts):
    for asked in drawn(seed):
        problem = asked.problem
        dense, n = Dense(problem, 2), len(problem.tips_mm) - 1
        tips, axes = dense.poses(np.repeat(np.arange(n), parts), np.tile(np.arange(parts) / parts, n))
        tips, axes = np.vstack((tips, problem.tips_mm[-1:])), np.vstack((axes, problem.axes[-1:]))
        same(asked, certified.verify(replace(asked.chosen, tips_mm=tips, axes=axes)))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("angle", [0.3, math.pi, -2.0])
def test_turning_the_cell_about_the_first_joint(seed, angle):
    """Limits and the slide's tilt turn along; the roll stays as it is, the shoulder's turns are counted afresh."""
    for asked in drawn(seed):
        two = certified.verify(turned(asked.problem, angle))
        same(asked, two)
        if asked.inside and asked.verdict.branch is not None:
            assert two.branch.roll_turns == asked.verdict.branch.roll_turns


@pytest.mark.parametrize("seed", SEEDS)
def test_the_mirror_image_swaps_left_and_right_and_the_ends_of_the_roll(seed):
    """Elbow, ty and the offsets of q0, q1, q3 change sign with the image, and so do the turns of the branch."""
    for asked in drawn(seed):
        two = certified.verify(mirrored(asked.problem))
        same(asked, two, tolerance=1e-9, names=SWAPPED)
        one = asked.verdict
        assert (one.branch is None) is (two.branch is None)
        if one.branch is not None:
            assert (one.branch.q0_turns, one.branch.roll_turns) == (
                -two.branch.q0_turns,
                -two.branch.roll_turns,
            )


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("k", [0.5, 4.0])
def test_another_unit_of_length(seed, k):
    """All lengths times k, speeds in mm besides: clearances in mm times k, angles as they are."""
    for asked in drawn(seed):
        problem = asked.problem
        c, d = problem.calibration, problem.deadband
        mm = np.array([1.0, 1.0, k, 1.0, 1.0])
        larger = replace(
            problem,
            tips_mm=problem.tips_mm * k,
            feed_mm_s=problem.feed_mm_s * k,
            tool_length_mm=problem.tool_length_mm * k,
            arm=replace(
                problem.arm, upper_mm=problem.arm.upper_mm * k, forearm_mm=problem.arm.forearm_mm * k
            ),
            lower=problem.lower * mm,
            upper=problem.upper * mm,
            speed=problem.speed * mm,
            deadband=replace(d, arm_mm=d.arm_mm * k, path_tolerance_mm=d.path_tolerance_mm * k),
            calibration=replace(
                c,
                upper_link_error_mm=c.upper_link_error_mm * k,
                forearm_link_error_mm=c.forearm_link_error_mm * k,
                joint_offset=c.joint_offset * mm,
                residual_mm=c.residual_mm * k,
            ),
        )
        same(asked, certified.verify(larger), scale=k, tolerance=GAP * max(1.0, 1.0 / k))


@pytest.mark.parametrize("seed", SEEDS)
def test_zero_calibration_is_bit_identical_to_none(seed):
    zero = ArmCalibration(0.0, 0.0, np.zeros(5), np.zeros(2), 0.0, 0.0)
    for asked in drawn(seed):
        none = replace(asked.problem, calibration=ArmCalibration())
        assert certified.verify(none) == certified.verify(replace(asked.problem, calibration=zero))
