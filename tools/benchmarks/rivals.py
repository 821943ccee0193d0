"""What the certified method is compared with: dense sampling, and the fewest evaluations of a distance."""

import math
from collections.abc import Callable

import numpy as np
from paths import sampled

from cutgate.protocol.arrays import Floats
from cutgate.runtime.verification.problem import Problem

GRID_MM = 0.01


def dense(problem: Problem, step_mm: float) -> Floats:
    """Smallest margin of each joint at samples at most ``step_mm`` apart along the tip, rad and mm, shape (5,).

    What a careful engineer would write instead: vectorised inverse kinematics. It proves nothing between.
    """
    lengths = np.linalg.norm(np.diff(problem.tips_mm, axis=0), axis=1)
    tips, axes = sampled(problem, np.maximum(1, np.ceil(lengths / step_mm)).astype(np.int64))
    wrist = tips + problem.tool_length_mm * axes
    a0, a1 = problem.arm.upper_mm, problem.arm.forearm_mm
    cosine = (np.square(wrist[:, :2]).sum(axis=1) - a0 * a0 - a1 * a1) / (2 * a0 * a1)
    q1 = np.arccos(cosine)
    q0 = np.arctan2(wrist[:, 1], wrist[:, 0]) - np.arctan2(a1 * np.sin(q1), a0 + a1 * cosine)
    roll = np.arctan2(axes[:, 1], axes[:, 0]) - q0 - q1
    q3 = np.mod(roll + np.pi, 2 * np.pi) - np.pi
    joints = np.stack((q0, q1, wrist[:, 2], q3, np.arccos(axes[:, 2])), axis=1)
    margin: Floats = np.minimum(joints - problem.lower, problem.upper - joints).min(axis=0)
    return margin


def inverse_kinematics(problem: Problem) -> tuple[Floats, ...]:
    """The joints at each pose, rad and mm, shape (n,) each: contiguous arrays, no more than that. K of the tables."""
    tip, axis = np.array(problem.tips_mm.T, order="C"), np.array(problem.axes.T, order="C")
    x, y, z = tip + problem.tool_length_mm * axis
    a0, a1 = problem.arm.upper_mm, problem.arm.forearm_mm
    cosine = (x * x + y * y - a0 * a0 - a1 * a1) / (2 * a0 * a1)
    q1 = np.arccos(cosine)
    q0 = np.arctan2(y, x) - np.arctan2(a1 * np.sin(q1), a0 + a1 * cosine)
    roll = np.arctan2(axis[1], axis[0]) - q0 - q1
    return q0, q1, z, np.mod(roll + np.pi, 2 * np.pi) - np.pi, np.arccos(axis[2])


class AlongThePath:
    """D of the paper's annulus along a path of wrist centres: distance to the nearer circle, by arc length."""

    def __init__(self, problem: Problem) -> None:
        centres = (problem.tips_mm + problem.tool_length_mm * problem.axes)[:, :2]
        ends = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(centres, axis=0), axis=1))))
        self.length = float(ends[-1])
        self.place = np.linspace(0.0, self.length, math.ceil(self.length / GRID_MM) + 1)
        r = np.hypot(*(np.interp(self.place, ends, centres[:, i]) for i in (0, 1)))
        inner = abs(problem.arm.upper_mm - problem.arm.forearm_mm)
        self.values = np.minimum(r - inner, problem.arm.upper_mm + problem.arm.forearm_mm - r)

    def __call__(self, place: float) -> float:
        """D at one arc length."""
        return float(np.interp(place, self.place, self.values))


def optimal_cover(d: AlongThePath, keep_mm: float) -> int:
    """The fewest evaluations with which any method that knows D only where it looks can admit a path.

    One evaluation proves D >= keep over the arc length D - keep to both sides. Their near ends grow along the
    path, as D is 1-Lipschitz, so the greedy choice is best: the farthest place whose near end is covered.
    """
    near, far = d.place - (d.values - keep_mm), d.place + (d.values - keep_mm)
    covered, count = 0.0, 0
    while covered < d.length:
        last = int(np.searchsorted(near, covered, side="right")) - 1
        if last < 0 or not far[last] > covered:
            raise ValueError(f"the path does not keep {keep_mm:g} mm at {covered:.2f} mm of its length")
        covered, count = float(far[last]), count + 1
    return count


def bisection(d: Callable[[float], float], keep_mm: float, start: float, end: float) -> int:
    """Evaluations of a search that looks at the middle, then at what that leaves open to the left and right."""
    middle = (start + end) / 2
    proved = d(middle) - keep_mm
    count = 1
    if middle - proved > start:
        count += bisection(d, keep_mm, start, middle - proved)
    if middle + proved < end:
        count += bisection(d, keep_mm, middle + proved, end)
    return count
