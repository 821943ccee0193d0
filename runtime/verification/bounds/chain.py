"""The path as one chain of intervals whose joint angles are unwrapped continuously.

Rules of unwrapping, in order:

1. Of an interval the bearing's sweep is known where its chord passes the column further off than its sagitta: then it is the
   angle between the bearings at its ends. The azimuth's always is, but for an axis that passes the vertical.
2. An interval of which it is not known is split, down to `SMALLEST_SPLIT`; a certificate's cuts are taken as they are.
3. Where it stays unknown anywhere, ``winding_known`` is False, and no bound of a joint that depends on it is given.
4. Whole revolutions are added to the angle of every place, so that it follows the sweeps; nothing accumulates.

Example:
    ``stroke`` is that of `problem`; backward through the column no bearing can be followed.

    >>> from dataclasses import replace
    >>> from cutgate.runtime.verification.bounds.geometry import canonical
    >>> chain = build(*canonical(stroke))
    >>> len(chain), chain.winding_known
    (1, True)
    >>> through = np.array([[-80.0, 0.0, 120.0], [-80.0, 0.0, 120.0]]) + [[100.0, 0.0, 0.0], [-100.0, 0.0, 0.0]]
    >>> build(*canonical(replace(stroke, tips_mm=through))).winding_known
    False
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from cutgate.protocol.arrays import Bools, Floats, Ints
from cutgate.runtime.kinematics.arm import REVOLUTION
from cutgate.runtime.verification.bounds.geometry import Geometry, Segments
from cutgate.runtime.verification.bounds.points import Points, at, at_poses, join
from cutgate.runtime.verification.effort import Effort

BLOCK = 8192
"""Intervals worked off at once: few enough for the cache, many enough for numpy."""

SMALLEST_SPLIT = 2.0**-20
"""No piece is split below this part of its segment in the search for the winding."""

SPLIT = 3
"""Work of looking at a piece for that, as `Effort` counts it."""


@dataclass(frozen=True, slots=True)
class Intervals:
    """Parts of segments with their attained ends; arrays over m intervals.

    Attributes:
        segment: segment numbers.
        s0: fraction where the interval starts.
        s1: fraction where it ends.
        a: attained values at s0, unwrapped.
        b: attained values at s1, unwrapped continuously from a.
        bound: lower bounds inherited from the parent, shape (m, columns).
    """

    segment: Ints
    s0: Floats
    s1: Floats
    a: Points
    b: Points
    bound: Floats

    def __len__(self) -> int:
        return len(self.segment)

    def take(self, index: Ints) -> Intervals:
        """The intervals at an index."""
        return Intervals(
            self.segment[index],
            self.s0[index],
            self.s1[index],
            self.a.take(index),
            self.b.take(index),
            self.bound[index],
        )


def merge(parts: list[Intervals]) -> Intervals:
    """Concatenate intervals."""
    if len(parts) == 1:
        return parts[0]
    return Intervals(
        np.concatenate([p.segment for p in parts]),
        np.concatenate([p.s0 for p in parts]),
        np.concatenate([p.s1 for p in parts]),
        join([p.a for p in parts]),
        join([p.b for p in parts]),
        np.concatenate([p.bound for p in parts]),
    )


@dataclass(frozen=True, slots=True)
class Chain:
    """Consecutive intervals of the whole path.

    Attributes:
        segment: segment of each interval, shape (m,).
        s0: its first fraction.
        s1: its last fraction.
        points: attained, unwrapped values at the m + 1 places between them.
        winding_known: whether the winding about the column is known everywhere.
    """

    segment: Ints
    s0: Floats
    s1: Floats
    points: Points
    winding_known: bool

    def __len__(self) -> int:
        return len(self.segment)

    @property
    def poses(self) -> Points:
        """The programmed poses alone, without the places where segments were split."""
        if len(self) == self.segment[-1] + 1:
            return self.points
        return self.points.take(np.append(np.flatnonzero(self.s0 == 0.0), len(self)))

    @property
    def start(self) -> tuple[float, float]:
        """q0 and q3 at the first pose, rad."""
        return float(self.points.shoulder[0]), float(self.points.roll[0])

    @property
    def shoulder(self) -> tuple[float, float]:
        """Least and largest q0 at the places, rad."""
        q0 = self.points.shoulder
        return float(q0.min()), float(q0.max())

    @property
    def starts_inside(self) -> bool:
        """Whether the first pose lies in the planar workspace."""
        return bool(self.points.inside[0])

    def intervals(self, start: int, stop: int, columns: int) -> Intervals:
        """A block of the chain."""
        return Intervals(
            self.segment[start:stop],
            self.s0[start:stop],
            self.s1[start:stop],
            self.points.take(slice(start, stop)),
            self.points.take(slice(start + 1, stop + 1)),
            np.full((stop - start, columns), -np.inf),
        )


def sagitta(geometry: Geometry, phi: Floats) -> Floats:
    """How far the wrist centre leaves its chord while the axis turns by phi, mm: at most l phi^2 / 8."""
    return geometry.stretch * geometry.tool_mm / 8.0 * phi * phi


def distance_from_column(first: Floats, second: Floats) -> Floats:
    """Smallest distance of straight segments (n, 2) from the origin, mm."""
    step = second - first
    square = np.einsum("ij,ij->i", step, step)
    t = -np.einsum("ij,ij->i", first, step) / np.where(square > 0.0, square, 1.0)
    foot = first + np.clip(t, 0.0, 1.0)[:, None] * step
    out: Floats = np.sqrt(np.einsum("ij,ij->i", foot, foot))
    return out


def sweep(first: Floats, second: Floats) -> Floats:
    """Signed angle from directions (..., 2) to directions (..., 2), in -pi..pi."""
    cross = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    out: Floats = np.arctan2(cross, np.einsum("...i,...i->...", first, second))
    return out


def build(geometry: Geometry, segments: Segments, effort: Effort | None = None) -> Chain:
    """Evaluate all poses and unwrap bearing and azimuth along the path.

    The bearing's sweep over an interval is the angle between its ends if the hull of its curve leaves
    the column out; intervals of which that is not known are split until it is.

    Raises:
        EffortSpentError: splitting takes more work than what bounds it.
    """
    chain = _whole(geometry, segments)
    while True:
        if effort is not None:
            effort.spend(SPLIT * len(chain))
        sag = sagitta(geometry, segments.theta[chain.segment] * (chain.s1 - chain.s0))
        size = _lengths(chain.points.centre) + sag
        splittable = (chain.s1 - chain.s0 > SMALLEST_SPLIT) & (size > geometry.pad_mm)
        split = np.flatnonzero(_unclear(geometry, segments, chain) & splittable)
        if len(split) == 0:
            return _unwrapped(geometry, segments, chain)
        chain = _split(geometry, segments, chain, split, (chain.s0[split] + chain.s1[split]) / 2)


def cut(geometry: Geometry, segments: Segments, segment: Ints, fraction: Floats) -> Chain:
    """The chain whose segments are cut at given places and nowhere else.

    Args:
        geometry: canonical arm.
        segments: the path.
        segment: segment of each cut, ascending, shape (k,).
        fraction: its fraction, in 0..1, ascending within a segment, shape (k,).

    Raises:
        ValueError: the cuts are out of order or out of the path.
    """
    inside = (fraction > 0.0) & (fraction < 1.0) & (segment >= 0) & (segment < len(segments))
    ascending = (np.diff(segment) > 0) | ((np.diff(segment) == 0) & (np.diff(fraction) > 0.0))
    if not (inside.all() and ascending.all()):
        raise ValueError(f"{len(segment)} cuts must lie inside the {len(segments)} segments, in order")
    chain = _whole(geometry, segments)
    new = at(geometry, segments, segment, fraction)
    points = _insert(chain.points, segment + 1, new)
    starts, ends = np.insert(chain.s0, segment + 1, fraction), np.insert(chain.s1, segment, fraction)
    pieces = Chain(np.insert(chain.segment, segment, segment), starts, ends, points, winding_known=False)
    return _unwrapped(geometry, segments, pieces)


def _whole(geometry: Geometry, segments: Segments) -> Chain:
    """Every segment one interval; nothing unwrapped yet."""
    n = len(segments)
    points = join([at_poses(geometry, segments, slice(i, i + BLOCK)) for i in range(0, n + 1, BLOCK)])
    return Chain(np.arange(n, dtype=np.int64), np.zeros(n), np.ones(n), points, winding_known=False)


def _split(geometry: Geometry, segments: Segments, chain: Chain, rows: Ints, middle: Floats) -> Chain:
    """Cut intervals in two, each at a fraction of its segment."""
    new = at(geometry, segments, chain.segment[rows], middle)
    return Chain(
        np.insert(chain.segment, rows, chain.segment[rows]),
        np.insert(chain.s0, rows + 1, middle),
        np.insert(chain.s1, rows, middle),
        _insert(chain.points, rows + 1, new),
        winding_known=False,
    )


def _insert(points: Points, where: Ints, new: Points) -> Points:
    return Points(
        *(np.insert(getattr(points, f.name), where, getattr(new, f.name), axis=0) for f in fields(Points))
    )


def _unclear(geometry: Geometry, segments: Segments, chain: Chain) -> Bools:
    """Intervals that may pass the column on either side."""
    gap = distance_from_column(chain.points.centre[:-1], chain.points.centre[1:])
    sag = sagitta(geometry, segments.theta[chain.segment] * (chain.s1 - chain.s0))
    return ~(gap > sag + geometry.pad_mm)


def _lengths(centre: Floats) -> Floats:
    step = centre[1:] - centre[:-1]
    out: Floats = np.sqrt(np.einsum("ij,ij->i", step, step))
    return out


def _unwrapped(geometry: Geometry, segments: Segments, chain: Chain) -> Chain:
    """Follow bearing and azimuth continuously from interval to interval."""
    points = chain.points
    bearing = _unwrap(points.bearing, sweep(points.centre[:-1], points.centre[1:]))
    azimuth = _unwrap(points.azimuth, sweep(points.axis_xy[:-1], points.axis_xy[1:]))
    winding_known = not bool(_unclear(geometry, segments, chain).any())
    return replace(
        chain, points=replace(points, bearing=bearing, azimuth=azimuth), winding_known=winding_known
    )


def _unwrap(raw: Floats, steps: Floats) -> Floats:
    """Add whole turns so that the angle follows its steps; whole numbers, so nothing accumulates."""
    turns = np.cumsum(np.rint((steps - np.diff(raw)) / REVOLUTION))
    return raw + REVOLUTION * np.concatenate(([0.0], turns))


def halve(
    geometry: Geometry, segments: Segments, parents: Intervals, bounds: Floats, where: Floats
) -> Intervals:
    """Cut intervals in two at a fraction of each, unwrapping the new points from their left ends."""
    cut = parents.s0 + where * (parents.s1 - parents.s0)
    middle = at(geometry, segments, parents.segment, cut)
    a = parents.a
    bearing = _follow(a.bearing, sweep(a.centre, middle.centre), middle.bearing)
    azimuth = _follow(a.azimuth, sweep(a.axis_xy, middle.axis_xy), middle.azimuth)
    middle = replace(middle, bearing=bearing, azimuth=azimuth)
    return Intervals(
        np.concatenate((parents.segment, parents.segment)),
        np.concatenate((parents.s0, cut)),
        np.concatenate((cut, parents.s1)),
        join([a, middle]),
        join([middle, parents.b]),
        np.concatenate((bounds, bounds)),
    )


def _follow(start: Floats, step: Floats, raw: Floats) -> Floats:
    return raw + REVOLUTION * np.rint((start + step - raw) / REVOLUTION)
