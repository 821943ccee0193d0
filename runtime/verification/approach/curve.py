"""Where the wrist centre goes on a joint line, and how near it comes to a clipped arc: enclosed, not sampled."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from cutgate.protocol.arrays import Floats
from cutgate.runtime.verification.bounds.geometry import EPSILON, ROUNDINGS, Geometry
from cutgate.runtime.verification.steps import Steps
from cutgate.runtime.workspace.planar import Arc, distance_to_arc, segment_to_arc

GAP_MM: Final = 0.008
"""Proven and attained distance this close; the promise is 0.01 mm."""
SMALLEST: Final = 2.0**-40
"""No interval is split below this part of the line."""
BUDGET: Final = 200_000
"""Intervals looked at for one arc of one line; the rest stays undecided, which is refused."""
BLOCK: Final = 1024
"""So many of them in one step: under a millisecond."""


@dataclass(frozen=True, slots=True)
class Least:
    """Least clearance of one boundary on a joint line, mm or rad, and where it is attained."""

    attained: float
    certified: float
    fraction: float


@dataclass(frozen=True, slots=True)
class Curve:
    """The wrist centre over a joint line, slide coordinates.

    Attributes:
        links: a0, a1, mm.
        angles: bearings of the two links at 0, rad, shape (2,).
        rates: their change up to 1, rad.
        bend: bound on |c''|, mm.
        pad: bound on the rounding of a computed distance, mm.
    """

    links: Floats
    angles: Floats
    rates: Floats
    bend: float
    pad: float

    @classmethod
    def of(cls, geometry: Geometry, line: Floats) -> Curve:
        """The curve of a line of true joints, shape (2, 5)."""
        space = geometry.workspace
        links = np.array((space.a0, space.a1))
        bearings = np.cumsum(line[:, :2], axis=1)
        rates = bearings[1] - bearings[0]
        turned = ROUNDINGS * EPSILON * float(np.abs(line[:, :2]).sum(axis=1).max())
        pad = geometry.pad_mm + turned * float(links.sum())
        return cls(links, bearings[0], rates, float(links @ (rates * rates)), pad)

    def __call__(self, t: Floats) -> Floats:
        """Places (n, 2) at fractions (n,)."""
        angles = self.angles + t[:, None] * self.rates
        out: Floats = np.stack((np.cos(angles) @ self.links, np.sin(angles) @ self.links), axis=1)
        return out


def enclose(
    curve: Curve, arc: Arc, part: tuple[float, float], target_mm: float, *, concentric: bool
) -> Steps[Least]:
    """The least distance to a clipped arc over a part of the curve, decided at the target.

    Intervals whose bound lies below the target, or too far below the least distance found, are halved. Of arcs about
    the column (``concentric``) the ends of an interval bound it as well: the elbow is linear, hence the distance
    from the column is monotone, and no point comes nearer to the circle.
    """
    a, b = np.array(part[:1]), np.array(part[1:])
    best, place, proven, spent = math.inf, part[0], np.float64(math.inf), 0
    while len(a):
        spent += len(a)
        bound = np.empty(len(a))
        for i in range(0, len(a), BLOCK):
            these = slice(i, i + BLOCK)
            bound[these], found, at = looked_at(curve, arc, a[these], b[these], concentric=concentric)
            if found < best:
                best, place = found, at
            yield
        wanting = (bound < best - GAP_MM) | ((bound < target_mm) & (best >= target_mm))
        wanting &= (b - a > SMALLEST) & (spent <= BUDGET)
        proven = np.minimum(proven, bound[~wanting].min(initial=math.inf))  # keeps a NaN
        a, b = a[wanting], b[wanting]
        middle = (a + b) / 2.0
        a, b = np.concatenate((a, middle)), np.concatenate((middle, b))
    return Least(best, float(np.minimum(proven, best)), place)


def looked_at(
    curve: Curve, arc: Arc, a: Floats, b: Floats, *, concentric: bool
) -> tuple[Floats, float, float]:
    """Lower bounds of the distance on intervals, the least distance found at some places of them, and where."""
    pa, pb = curve(a), curve(b)
    chord, nearest = segment_to_arc(pa, pb, arc)
    bound = chord - curve.bend / 8.0 * (b - a) ** 2
    if concentric:
        off = [np.abs(np.hypot(p[:, 0], p[:, 1]) - arc.radius) for p in (pa, pb)]
        bound = np.maximum(bound, np.minimum(*off))
    tried = np.concatenate((a, b, a + nearest * (b - a)))
    found = distance_to_arc(curve(tried), arc)
    at = int(np.argmin(found))
    return bound - curve.pad, float(found[at]), float(tried[at])
