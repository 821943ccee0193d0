"""How many intervals the search looks at: a few a segment, whatever the path; never more than it says."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cutgate.runtime.verification import certified
from cutgate.runtime.verification.problem import Deadband
from tests.runtime.verification.cases import DEG, WIDE, axis, problem, wrist_path
from tests.runtime.verification.random_paths import random_paths

LEVEL = axis(90 * DEG, 0.0)
A_LOT = 5000


def limits(q0_deg, q1_deg):
    lower, upper = np.array([0.0, 0.0, -1e4, -WIDE, 0.0]), np.array([0.0, 0.0, 1e4, WIDE, math.pi])
    (lower[0], upper[0]), (lower[1], upper[1]) = np.multiply(q0_deg, DEG), np.multiply(q1_deg, DEG)
    return {"lower": lower, "upper": upper}


@pytest.mark.parametrize("seed", range(4))
def test_random_paths_take_a_few_looks_a_segment_and_never_more_than_announced(seed):
    looks, segments = [], []
    for path in random_paths(np.random.default_rng([20260601, seed]), (9, 40), 250):
        found = certified.verify(path).evaluations
        assert max(found.arm, found.wrist) <= found.worst_case
        looks.append(found.arm)
        segments.append(len(path.tips_mm) - 1)
    assert np.median(np.divide(looks, segments)) < 40


def test_an_axis_that_passes_0003_deg_from_the_vertical_is_decided_early():
    """The roll needs 1194 rad/s of 2: nothing is gained by knowing that to 0.01 rad/s."""
    lean = math.tan(0.003 * DEG)
    ends = np.array([[-0.4, lean, 1.0], [0.4, lean, 1.0]])
    tips, axes = wrist_path([[600.0, 0.0, 0.0]] * 2, ends / np.linalg.norm(ends, axis=1, keepdims=True))
    tiny = Deadband(1.0, 0.001 * DEG)
    verdict = certified.verify(problem(tips, axes, deadband=tiny, **limits((-170, 170), (5, 170))))
    assert not verdict.speed[3].ok
    assert verdict.evaluations.arm < A_LOT


@pytest.mark.parametrize(("seed", "number"), [(34, 6), (33, 5), (9, 14), (9, 0), (15, 22), (6, 27)])
def test_acceleration_limits_that_are_missed_or_lost_out_of_reach_are_decided_early(seed, number):
    rng = np.random.default_rng([77, seed])
    paths = random_paths(rng, (9, 40), 250)
    for _ in range(number + 1):  # each path has the next five limits
        limits_of = 10.0 ** rng.uniform(-1, 3, 5) * (1.0, 1.0, 100.0, 1.0, 1.0)
    verdict = certified.verify(replace(paths[number], acceleration=limits_of))
    assert not verdict.admissible
    assert verdict.evaluations.arm < A_LOT


@pytest.mark.parametrize("far", [1000.0, -1000.0])
def test_a_shoulder_of_a_full_turn_that_leaves_the_reach_is_decided_early(far):
    tips, axes = wrist_path([[0.8 * far, 0.0, 0.0], [far, 0.0, 0.0]], LEVEL)
    verdict = certified.verify(problem(tips, axes, **limits((-181, 181), (10, 100))))
    assert verdict.boundaries["outer"].clearance < -100
    assert verdict.evaluations.arm < A_LOT


def test_a_turn_in_no_time_is_refused_by_name():
    """A tool of no length, a tip at rest, an axis that turns: the segment is planned to take no time."""
    tips = np.array([[600.0, 0.0, 100.0]] * 3)
    turning = axis(1.0, np.array([0.0, 0.0, 0.5]))
    verdict = certified.verify(problem(tips, turning, tool_length_mm=0.0))
    assert not verdict.admissible
    assert len(verdict.reasons) == 1
    assert verdict.reasons[0].startswith("segment 1 turns the tool axis by 24.0")
    assert "in no time" in verdict.reasons[0]
    still = certified.verify(problem(tips, turning[[0, 0, 0]], tool_length_mm=0.0))
    assert still.admissible, still.reasons


def test_a_path_that_leaves_the_reach_between_its_poses_lies_in_no_branch():
    """Both poses can be reached; between them the wrist crosses the hole of radius 900 cos 50 deg = 578."""
    tips, axes = wrist_path([[-600.0, -300.0, 0.0], [600.0, -300.0, 0.0]], LEVEL)
    branches = [
        certified.verify(problem(tips, axes, **limits(q0, (10, 100)))).branch
        for q0 in ((-170, 170), (-400, 400))
    ]
    assert branches == [None, None]
