"""Which turn of the shoulder and of the roll the whole path stays in."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cutgate.protocol.parameters import ROTATION_DEG_GOES
from cutgate.runtime.kinematics.arm import REVOLUTION, turns
from cutgate.runtime.verification.bounds.geometry import Geometry
from cutgate.runtime.verification.verdict import Winding

GOES_RAD = math.radians(ROTATION_DEG_GOES)
"""How far, either way, a reported joint may go: whatever its limits, a joints frame must always be able to carry it."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """One choice of whole turns for an unwrapped joint.

    Attributes:
        shift: added to the canonical unwrapped angle, rad, a multiple of a turn.
        turns: the turns reported, ``q = wrap(q) + 360 deg * turns`` at the first pose.
        fits: whether the attained range lies within the limits, and the enclosed one where the joint may go.
        margin: smaller distance of the attained range to the limits, rad.
    """

    shift: float
    turns: int
    fits: bool
    margin: float


def goes(geometry: Geometry, joint: int, most_deg: float = ROTATION_DEG_GOES) -> tuple[float, float]:
    """Where shoulder or roll may go whatever its limits, as a true joint of the canonical arm, rad."""
    offset, most = float(geometry.offset[joint]), math.radians(most_deg)
    return offset - most, offset + most


def confined(geometry: Geometry, joint: int) -> bool:
    """Whether its limits alone keep a joint where it may go."""
    low, high = goes(geometry, joint)
    return low <= float(geometry.lower[joint]) and float(geometry.upper[joint]) <= high


def candidates(
    geometry: Geometry,
    joint: int,
    start: float,
    reach: tuple[float, float],
    asked: int | None,
    proven: tuple[float, float] | None = None,
) -> list[Candidate]:
    """All turns that keep a joint's range within its limits and where it may go, smallest turns first.

    Args:
        geometry: canonical arm.
        joint: 0 (shoulder) or 3 (roll).
        start: unwrapped canonical angle at the first pose, rad.
        reach: least and largest unwrapped angle over the path, rad.
        asked: turns to take whatever they are worth, or None for all that fit.
        proven: finite bounds that enclose ``reach``; it itself if left out.

    Returns:
        At least one; where none fits the one that comes nearest, with ``fits`` False.
    """
    lower, upper = float(geometry.lower[joint]), float(geometry.upper[joint])
    low, high = goes(geometry, joint)
    least, most = reach if proven is None else proven

    def candidate(whole: int) -> Candidate:
        shift = REVOLUTION * whole
        margin = min(reach[0] + shift - lower, upper - reach[1] - shift)
        reports = low <= least + shift and most + shift <= high
        return Candidate(shift, reported(geometry, joint, start + shift), margin >= 0.0 and reports, margin)

    if asked is not None:
        return [candidate(round(geometry.side * (asked - reported(geometry, joint, start))))]
    first = math.ceil(max(lower - reach[0], low - least) / REVOLUTION)
    last = math.floor(min(upper - reach[1], high - most) / REVOLUTION)
    if first > last:
        middle = (max(lower, low) + min(upper, high)) / 2
        nearest = round((middle - (reach[0] + reach[1]) / 2) / REVOLUTION)
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


def winding(geometry: Geometry, joint: int, start: float, reach: tuple[float, float]) -> Winding:
    """What whole turns do for a joint, as the controller reports it.

    Args:
        geometry: canonical arm.
        joint: 0 (shoulder) or 3 (roll).
        start: unwrapped canonical angle at the first pose, rad.
        reach: least and largest unwrapped angle over the path, rad.
    """
    away = 360.0 * reported(geometry, joint, start)
    offset = float(geometry.offset[joint])

    def shown(*angles: float) -> list[float]:
        return sorted(math.degrees(geometry.side * (angle - offset)) for angle in angles)

    least, most = (angle - away for angle in shown(*reach))
    lower, upper = shown(float(geometry.lower[joint]), float(geometry.upper[joint]))
    low, high = max(lower, -ROTATION_DEG_GOES), min(upper, ROTATION_DEG_GOES)
    return Winding(
        joint="q0" if joint == 0 else "q3",
        least_deg=least,
        most_deg=most,
        lower_deg=lower,
        upper_deg=upper,
        first=math.ceil((low - least) / 360.0),
        last=math.floor((high - most) / 360.0),
    )


def reported(geometry: Geometry, joint: int, angle: float) -> int:
    """The whole turns of a canonical angle, as the joint is reported."""
    return int(turns(np.float64(geometry.side * (angle - geometry.offset[joint]))))  # type: ignore[arg-type]
