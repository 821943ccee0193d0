"""Which turn of the shoulder and of the roll the whole path stays in."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cutgate.runtime.kinematics.arm import TURN, turns
from cutgate.runtime.verification.geometry import Geometry


@dataclass(frozen=True, slots=True)
class Candidate:
    """One choice of whole turns for a lifted joint.

    Attributes:
        shift: added to the canonical lifted angle, rad, a multiple of a turn.
        turns: the turns reported, ``q = wrap(q) + 360 deg * turns`` at the first pose.
        fits: whether the attained range lies within the limits.
        margin: smaller distance of the attained range to the limits, rad.
    """

    shift: float
    turns: int
    fits: bool
    margin: float


def candidates(
    geometry: Geometry, joint: int, start: float, reach: tuple[float, float], asked: int | None
) -> list[Candidate]:
    """All turns that keep a joint's range within its limits, smallest turns first.

    Args:
        geometry: canonical arm.
        joint: 0 (shoulder) or 3 (roll).
        start: lifted canonical angle at the first pose, rad.
        reach: least and largest lifted angle over the path, rad.
        asked: turns to take whatever they are worth, or None for all that fit.

    Returns:
        At least one; where none fits the one that comes nearest, with ``fits`` False.
    """
    lower, upper = float(geometry.lower[joint]), float(geometry.upper[joint])

    def reported(shift: float) -> int:
        return int(turns(np.float64(geometry.side * (start + shift - geometry.offset[joint]))))  # type: ignore[arg-type]

    def candidate(whole: int) -> Candidate:
        shift = TURN * whole
        margin = min(reach[0] + shift - lower, upper - reach[1] - shift)
        return Candidate(shift, reported(shift), margin >= 0.0, margin)

    if asked is not None:
        return [candidate(round(geometry.side * (asked - reported(0.0))))]
    first, last = math.ceil((lower - reach[0]) / TURN), math.floor((upper - reach[1]) / TURN)
    if first > last:
        nearest = round(((lower + upper) / 2 - (reach[0] + reach[1]) / 2) / TURN)
        around = [candidate(nearest + k) for k in (-1, 0, 1)]
        return [max(around, key=lambda c: (c.margin, -abs(c.turns)))]
    return sorted((candidate(k) for k in range(first, last + 1)), key=lambda c: (abs(c.turns), -c.margin))


def choose(options: list[Candidate], deadband: float, others: float) -> Candidate:
    """The candidate with the largest worst margin per deadband; ties to the smallest turns.

    Args:
        options: sorted by turns.
        deadband: of the joint, rad.
        others: worst margin per deadband of all other boundaries, which caps what a choice can win.
    """
    return max(options, key=lambda c: (min(c.margin / deadband, others), -abs(c.turns), c.margin))
