"""Certifying a continuous path against any `Distance`: the way to other manipulators.

Stocco 2001 calls workspaces without closed-form boundary the "more difficult cases" and lets D be numeric. Two
things make that safe: a Lipschitz bound, so that values at points say something about what lies between them, and a
bound on the error of the values themselves. The gate itself knows one kind of arm and uses
`cutgate.runtime.verification.certified`; docs/other-arms.md shows two others.

A boundary that is known as curves only is sampled: a curve of speed at most v over a parameter range T, cut into N
equal steps, has its samples at most h = v T / N of arc apart, so each of its points lies within h / 2 of a
sample, and each sample lies on it. The distance to the samples therefore exceeds the distance to the curve by at most h / 2
and never falls below it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from cutgate.protocol.arrays import Bools, Floats, Ints
from cutgate.runtime.workspace.distance import signed_distance
from cutgate.runtime.workspace.planar import PlanarWorkspace

Outcome = Literal["admissible", "inadmissible", "undecided"]

BLOCK = 1024
"""Intervals bisected together."""

PAIRS = 2_000_000
"""Pairs of point and sample held in memory at once."""

EPSILON = float(np.finfo(np.float64).eps)


class Distance(Protocol):
    """A distance to the nearest boundary of a workspace, exact or numeric.

    The true signed distance is positive only inside, and a ball of that radius round a point inside is inside.
    What is computed may be off by a stated bound. Unit: mm, or whatever the path is measured in.
    """

    @property
    def lipschitz(self) -> float:
        """Bound on the change of the true distance per unit moved."""
        ...  # pragma: no cover

    @property
    def error(self) -> float:
        """Bound on how far a computed distance is from the true one, rounding included."""
        ...  # pragma: no cover

    def __call__(self, points: Floats) -> Floats:
        """Signed distances (n,) of points (n, d); NaN where undefined."""
        ...  # pragma: no cover


ROUNDING = 1e-9
"""Error of the exact planar distance per mm of reach. Rounding moves an arc by a few epsilon of the reach, and
membership by most where the elbow is nearly straight: epsilon ** (2 / 3), 4e-11, of the reach."""


@dataclass(frozen=True, slots=True)
class ExactPlanar:
    """The exact distance of one planar elbow branch as a `Distance`, for points within twice the reach."""

    workspace: PlanarWorkspace

    @property
    def lipschitz(self) -> float:
        """A distance to a set is 1-Lipschitz, and so is a signed one."""
        return 1.0

    @property
    def error(self) -> float:
        """Rounding alone, mm."""
        return ROUNDING * (self.workspace.a0 + self.workspace.a1)

    def __call__(self, points: Floats) -> Floats:
        """Signed distances, mm. Shape (n, 2) -> (n,)."""
        return signed_distance(points, self.workspace)


class ArmPath(Protocol):
    """A continuous path of n segments, each with a parameter 0..1."""

    @property
    def lengths(self) -> Floats:
        """How far each segment moves at most, (n,): between fractions s and t at most ``length * |t - s|``."""
        ...  # pragma: no cover

    def at(self, segment: Ints, fraction: Floats) -> Floats:
        """Points (m, d) at segment numbers (m,) and fractions (m,)."""
        ...  # pragma: no cover


@dataclass(frozen=True, slots=True, eq=False)
class Polyline:
    """Straight lines between points (n + 1, d), n >= 1."""

    points: Floats

    @property
    def lengths(self) -> Floats:
        """Euclidean lengths, (n,)."""
        out: Floats = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        return out

    def at(self, segment: Ints, fraction: Floats) -> Floats:
        """Points (m, d)."""
        first, second = self.points[segment], self.points[segment + 1]
        out: Floats = first + fraction[:, None] * (second - first)
        return out


@dataclass(frozen=True, slots=True)
class Decision:
    """What is known of the smallest true distance on a path.

    Attributes:
        outcome: ``undecided`` is not admitted.
        attained: least value computed; the true minimum is at most ``attained + distance.error``. None if none.
        certified: proven lower bound of the true minimum. None if there is none.
        segment: where ``attained`` was found.
        fraction: place in that segment, 0..1.
        evaluations: points at which the distance was computed.
        reason: what keeps the path from being admitted; empty if nothing does.
    """

    outcome: Outcome
    attained: float | None
    certified: float | None
    segment: int | None
    fraction: float | None
    evaluations: int
    reason: str

    @property
    def admissible(self) -> bool:
        """Whether every point of the continuous path is proven to keep the deadband."""
        return self.outcome == "admissible"


def certify(
    path: ArmPath,
    distance: Distance,
    deadband: float,
    *,
    tolerance: float = 0.1,
    most_evaluations: int = 100_000,
) -> Decision:
    """Decide for all points of a continuous path whether the distance keeps the deadband.

    Between neighbours with values a and b, moved h apart at most, no true value is below
    ``(a + b - lipschitz * h) / 2 - error``. Intervals are bisected, lowest bound first, until every bound is within
    ``tolerance`` of the least value, or within a hundredth of it where that straddles the deadband.

    Args:
        path: continuous, at least one segment.
        distance: with its Lipschitz constant and error bound.
        deadband: > 0, in the distance's unit.
        tolerance: > 0, same unit.
        most_evaluations: effort after which what is proven so far counts.

    Returns:
        Admissible only if proven. Anything not finite, and values that contradict the stated bounds, are undecided.
    """
    lengths, slope = path.lengths, distance.lipschitz
    stated = np.append(lengths, (slope, distance.error, deadband, tolerance))
    if not (len(lengths) > 0 and (np.isfinite(stated) & (stated >= 0.0)).all()):
        return _unknown("path, bounds, deadband and tolerance must be finite and not negative", 0)
    if not (deadband > 0.0 and tolerance > 0.0):
        return _unknown("deadband and tolerance must be over zero", 0)
    evaluations = len(lengths) + 1
    if not evaluations <= most_evaluations:
        return _unknown(f"{evaluations} points are over the {most_evaluations} evaluations allowed", 0)
    table, reach = _whole_segments(path, distance, len(lengths))
    while True:
        a, b = table[:, 3], table[:, 4]
        if not np.isfinite(table).all():
            return _unknown("the distance is not a finite number somewhere on the path", evaluations)
        # Rounding: of points interpolated, of values added and of their bounds, a few epsilon each.
        error = distance.error + 64.0 * EPSILON * (slope * reach + float(np.abs(table[:, 3:]).max()))
        moved = slope * lengths[table[:, 0].astype(np.int64)] * (table[:, 2] - table[:, 1])
        if not (np.abs(b - a) <= moved + 2.0 * error).all():
            return _unknown("the distance changes faster than its stated bounds allow", evaluations)
        bounds = (a + b - moved) / 2.0 - error
        certified, least = float(bounds.min()), float(table[:, 3:].min())
        straddles = certified < deadband <= least + error
        wanted = least - error - (tolerance / 100.0 if straddles else tolerance)
        lowest = np.argsort(bounds)[: min(BLOCK, most_evaluations - evaluations)]
        chosen = lowest[bounds[lowest] < wanted]
        if not len(chosen):
            return _decided(table, certified, error, deadband, evaluations)
        table = np.concatenate((np.delete(table, chosen, axis=0), _halves(table[chosen], path, distance)))
        evaluations += len(chosen)


def _whole_segments(path: ArmPath, distance: Distance, pieces: int) -> tuple[Floats, float]:
    """Rows (segment, first and last fraction, value at each) of all segments, and the largest coordinate."""
    segment = np.arange(pieces)
    points = path.at(np.append(segment, pieces - 1), np.append(np.zeros(pieces), 1.0))
    values = distance(points)
    table: Floats = np.stack((segment, np.zeros(pieces), np.ones(pieces), values[:-1], values[1:]), axis=1)
    return table, float(np.abs(points).max())


def _halves(rows: Floats, path: ArmPath, distance: Distance) -> Floats:
    """Both halves of each interval, the middle evaluated. Shape (m, 5) -> (2 m, 5)."""
    middle = (rows[:, 1] + rows[:, 2]) / 2.0
    value = distance(path.at(rows[:, 0].astype(np.int64), middle))
    before, after = rows.copy(), rows.copy()
    before[:, 2], before[:, 4] = middle, value
    after[:, 1], after[:, 3] = middle, value
    return np.concatenate((before, after))


def _decided(table: Floats, certified: float, error: float, deadband: float, evaluations: int) -> Decision:
    row, side = divmod(int(np.argmin(table[:, 3:])), 2)
    least = float(table[row, 3 + side])
    outcome: Outcome = "undecided"
    reason = (
        f"the smallest distance is between {certified:.6g} and {least + error:.6g}, which straddles the "
        f"deadband {deadband:.6g}: lower the distance's error bound or allow more evaluations"
    )
    if certified >= deadband:
        outcome, reason = "admissible", ""
    elif least + error < deadband:
        outcome = "inadmissible"
        reason = f"the distance is at most {least + error:.6g} where {deadband:.6g} is required"
    place = int(table[row, 0]), float(table[row, 1 + side])
    return Decision(outcome, least, certified, *place, evaluations, reason)


def _unknown(reason: str, evaluations: int) -> Decision:
    return Decision("undecided", None, None, None, None, evaluations, reason)


Curve = Callable[[Floats], Floats]
"""Points (n, d) of a curve at parameters (n,)."""


def sample_curve(curve: Curve, first: float, last: float, speed: float, spacing: float) -> Floats:
    """Points of a curve, both ends included, at most ``spacing`` of arc apart. Shape (n, d).

    Args:
        curve: moves at most ``speed`` per unit of its parameter.
        first: start of the parameter range.
        last: end of it.
        speed: bound on the curve's speed.
        spacing: > 0.
    """
    steps = max(1, math.ceil(speed * (last - first) / spacing))
    return curve(np.linspace(first, last, steps + 1))


@dataclass(frozen=True, slots=True, eq=False)
class SampledBoundary:
    """The signed distance to a boundary given by samples, with its error.

    Attributes:
        samples: points of curves that together hold the whole boundary, (m, d).
        spacing: largest arc between neighbouring samples.
        inside: membership, points (n, d) -> (n,), off by at most ``rounding`` in distance.
        rounding: of samples, distances and membership.
    """

    samples: Floats
    spacing: float
    inside: Callable[[Floats], Bools]
    rounding: float

    @property
    def lipschitz(self) -> float:
        """Of the true signed distance."""
        return 1.0

    @property
    def error(self) -> float:
        """Half the spacing and the rounding; see the module's derivation."""
        return self.spacing / 2.0 + self.rounding

    def __call__(self, points: Floats) -> Floats:
        """Distance to the nearest sample, negative outside; NaN stays NaN. Shape (n, d) -> (n,)."""
        nearest = np.empty(len(points))
        rows = max(1, PAIRS // len(self.samples))
        for start in range(0, len(points), rows):
            block = points[start : start + rows]
            square = np.zeros((len(block), len(self.samples)))
            for axis in range(points.shape[1]):
                square += np.square(block[:, axis, None] - self.samples[None, :, axis])
            nearest[start : start + rows] = np.sqrt(square.min(axis=1))
        return np.where(self.inside(points), nearest, -nearest)
