"""How wrong a registration may be: within which errors of where the bone stands every placement is admissible.

Proved, not tried: one look at each pose (`decide`) with the error added to the way that the path may be from it. Long segments
are cut for it, for one look proves little of them. What is said is a lower bound; the bone may well have more room.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cutgate.protocol.arrays import Vector
from cutgate.runtime.kinematics.pose import slerp, turn_angles
from cutgate.runtime.verification.decide import Around, Displacement
from cutgate.runtime.verification.placing.guidance import pivot_of
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.verdict import Verdict

PIECE_MM: Final = 2.0
"""Longer segments are cut into pieces of this ..."""

POSES_MAX: Final = 10_000
"""... but into no more poses than this in all; a path of more is taken as it is."""

STEP_MM, STEP_DEG = 0.01, 0.01
"""What is said is in whole steps of this."""

YAW_MAX_DEG: Final = 90.0
"""No larger turn is looked for ..."""

FIRST_TURN: Final = 100
"""... and in so many steps first."""

LONGEST_POSES: Final = 100_000
"""Of a longer path nothing is said: the time that it takes is bounded."""

QUANTISED_MM, QUANTISED_RAD = 0.001, 1e-8
"""A path is quantised anew where the bone stands otherwise: no tip and no axis moves by more. It is a tolerance of the path."""


@dataclass(frozen=True, slots=True)
class Tolerated:
    """Errors within which every placement is proved admissible, in the same joint branch.

    Attributes:
        ball_mm: any translation up to this alone.
        yaw_deg: any turn about the vertical through the pivot alone, either way.
        both_ball_mm, both_yaw_deg: both at once.
        pivot_mm: where that vertical is: through the mean tip.
    """

    ball_mm: float
    yaw_deg: float
    both_ball_mm: float
    both_yaw_deg: float
    pivot_mm: Vector

    @property
    def text(self) -> str:
        """In a sentence."""
        return (
            f"Still admissible with the bone up to {self.both_ball_mm:.2f} mm and {self.both_yaw_deg:.2f} deg about the vertical "
            f"from where it is registered; alone up to {self.ball_mm:.2f} mm, or {self.yaw_deg:.2f} deg (proved)."
        )


def tolerated(problem: Problem, verdict: Verdict) -> Tolerated | None:
    """What errors of its registration an admitted path tolerates.

    Args:
        problem: what was verified.
        verdict: the certified method's answer to it.

    Returns:
        None where the path is not admitted or longer than `LONGEST_POSES`, and where one look proves nothing: shoulder
        or roll may turn by a revolution, or the path comes too near to a boundary.
    """
    if not verdict.admissible or verdict.method != "certified" or len(problem.tips_mm) > LONGEST_POSES:
        return None
    around, pivot = Around(as_looked_at(problem)), pivot_of(problem)

    def holds(ball_mm: float, yaw_deg: float) -> bool:
        return around.holds(Displacement(ball_mm, math.radians(yaw_deg), pivot[:2]))

    if not holds(0.0, 0.0):
        return None
    room = math.floor(_room_mm(verdict) / STEP_MM)
    ball = _largest(lambda steps: holds(steps * STEP_MM, 0.0), room, first=room) * STEP_MM
    widest = round(YAW_MAX_DEG / STEP_DEG)
    yaw = _largest(lambda steps: holds(0.0, steps * STEP_DEG), widest, first=FIRST_TURN) * STEP_DEG
    parts = _largest(lambda n: holds(n / PARTS * ball, n / PARTS * yaw), PARTS, first=PARTS // 2)
    both = (_down(parts / PARTS * ball, STEP_MM), _down(parts / PARTS * yaw, STEP_DEG))
    return Tolerated(round(ball, 2), round(yaw, 2), *both, pivot)


PARTS: Final = 256
"""Both at once are looked for in so many parts of what each may be alone."""


def as_looked_at(problem: Problem) -> Problem:
    """The path as one look at each pose takes it wherever the bone stands: its long segments cut, re-quantising allowed for."""
    return _refined(_quantised(problem))


def _room_mm(verdict: Verdict) -> float:
    """No translation is tolerated beyond what is left to a boundary."""
    left = (
        b.clearance - b.deadband
        for b in verdict.boundaries.values()
        if b.unit == "mm" and b.clearance is not None
    )
    return min(left, default=0.0)


def _largest(holds: Callable[[int], bool], most: int, *, first: int) -> int:
    """The largest whole number up to ``most`` for which it holds, as it does for all below and for 0; ``first`` is tried first."""
    low, high = 0, max(min(first, most), 1)
    while high <= most and holds(high):
        low, high = high, max(2 * high, 2)
    high = min(high, most + 1)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _down(value: float, step: float) -> float:
    """To whole steps, never up."""
    return round(math.floor(value / step) * step, 2)


def _quantised(problem: Problem) -> Problem:
    """The same path, with what quantising it anew may do to it as a further tolerance."""
    kept = problem.deadband
    wider = replace(
        kept,
        path_tolerance_mm=kept.path_tolerance_mm + QUANTISED_MM,
        path_tolerance_rad=kept.path_tolerance_rad + QUANTISED_RAD,
    )
    return replace(problem, deadband=wider)


def _refined(problem: Problem) -> Problem:
    """The same path, its long segments cut."""
    step, theta = np.diff(problem.tips_mm, axis=0), turn_angles(problem.axes[:-1], problem.axes[1:])
    way = np.sqrt(np.einsum("ij,ij->i", step, step)) + problem.tool_length_mm * theta
    pieces = np.maximum(np.ceil(way / PIECE_MM), 1.0)
    if not len(step) < pieces.sum() <= POSES_MAX:
        return problem
    counts = pieces.astype(np.int64)
    segment = np.repeat(np.arange(len(step)), counts)
    s = (np.arange(len(segment)) - np.repeat(np.cumsum(counts) - counts, counts)) / counts[segment]
    tips = np.append(problem.tips_mm[segment] + s[:, None] * step[segment], problem.tips_mm[-1:], axis=0)
    axes = slerp(problem.axes[segment], problem.axes[segment + 1], theta[segment], s)
    axes = np.append(axes / np.linalg.norm(axes, axis=1, keepdims=True), problem.axes[-1:], axis=0)
    return replace(problem, tips_mm=tips, axes=axes)
