"""Branch and bound over the path: how small does each quantity become, and where.

All open intervals are worked off in numpy blocks, last in first out, so that memory stays bounded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cutgate.protocol.arrays import Bools, Floats, Ints
from cutgate.runtime.verification.bounds.acceleration import joint_accelerations
from cutgate.runtime.verification.bounds.chain import BLOCK, Chain, Intervals, halve, merge
from cutgate.runtime.verification.bounds.enclosures import (
    ACCELERATION,
    COLUMNS,
    LEFT,
    OUTER,
    ROLL_MIN,
    SPEED,
    Scope,
    attained,
    lower_bounds,
)
from cutgate.runtime.verification.bounds.geometry import Geometry, Segments
from cutgate.runtime.verification.bounds.points import Points
from cutgate.runtime.verification.effort import Effort
from cutgate.runtime.workspace.distance import signed_sides

SMALLEST = 2.0**-40
"""No interval is split below this part of its segment."""

COARSE = 2.0**-10
"""Where the arm or the singularity has lost its deadband the wrist is not followed finer than this."""


@dataclass(frozen=True, slots=True)
class Aim:
    """How far to refine each column; arrays of shape (COLUMNS,).

    Attributes:
        gap: bounds this close below the least attained value are close enough ...
        share: ... and so are those within this part of it ...
        missed: ... or within this part, once it has missed its target.
        target: the value to keep; while a bound is below and the attained value above it, go on ...
        fine: ... until they are this close: undecided.
    """

    gap: Floats
    share: Floats
    missed: Floats
    target: Floats
    fine: Floats

    def enough(self, best: Floats) -> Floats:
        """What a bound must reach where only closeness to the least attained value counts, shape (COLUMNS,)."""
        size = np.abs(np.where(np.isfinite(best), best, 0.0))
        part = np.where(best < self.target, self.missed, self.share)
        out: Floats = best - np.maximum(self.gap, part * size)
        return out


@dataclass(frozen=True, slots=True)
class Survey:
    """Least attained value and proven bound of each column; arrays of shape (COLUMNS,).

    Attributes:
        attained: infinite where nothing was attained.
        certified: minus infinity where nothing is proven.
        segment: where ``attained`` was found.
        fraction: place in that segment.
        evaluations: intervals bounded.
        budget: at most as many could have been.
        cut_segment: where segments were cut into the intervals that prove the bounds, in order: segment ...
        cut_fraction: ... and place in it, shape (k,) each.
    """

    attained: Floats
    certified: Floats
    segment: Ints
    fraction: Floats
    evaluations: int
    budget: int
    cut_segment: Ints
    cut_fraction: Floats


ROUND, INTERVAL = 5000, 6
"""Work of each round of a survey and of each interval in it, as `Effort` counts it."""


def budget(segments: int) -> int:
    """Intervals that a survey may look at before it splits no more and leaves the rest undecided."""
    return 64 * segments + 200_000


class _Best:
    """Least attained value of each column and its place."""

    def __init__(self) -> None:
        self.value = np.full(COLUMNS, np.inf)
        self.segment = np.zeros(COLUMNS, dtype=np.int64)
        self.fraction = np.zeros(COLUMNS)

    def offer(self, first: int, values: Floats, segment: Ints, fraction: Floats) -> None:
        """Take values (m, columns) of the columns from ``first`` on where they are smaller."""
        if len(values) == 0:
            return
        rows = np.argmin(values, axis=0)
        for i, row in enumerate(rows):
            if values[row, i] < self.value[first + i]:
                self.value[first + i] = values[row, i]
                self.segment[first + i] = segment[row]
                self.fraction[first + i] = fraction[row]


class _Cuts:
    """Where the intervals that need no closer look begin, but for those that begin with their segment."""

    def __init__(self) -> None:
        self.segment: list[Ints] = [np.zeros(0, dtype=np.int64)]
        self.fraction: list[Floats] = [np.zeros(0)]

    def add(self, parts: Intervals, closed: Bools) -> None:
        """Take the beginnings of closed intervals."""
        rows = np.flatnonzero(closed & (parts.s0 > 0.0))
        self.segment.append(parts.segment[rows])
        self.fraction.append(parts.s0[rows])

    def sorted(self) -> tuple[Ints, Floats]:
        """All of them in the order of the path."""
        segment, fraction = np.concatenate(self.segment), np.concatenate(self.fraction)
        order = np.lexsort((fraction, segment))
        return segment[order], fraction[order]


def survey(
    geometry: Geometry,
    segments: Segments,
    chain: Chain,
    scope: Scope,
    aim: Aim,
    effort: Effort | None = None,
) -> Survey:
    """Enclose the minimum of every wanted column over the whole path.

    Raises:
        EffortSpentError: the work is more than what bounds it.
    """
    best = _of_the_poses(geometry, segments, chain, scope)
    certified = np.full(COLUMNS, np.inf)
    cuts = _Cuts()
    allowed, spent = budget(len(segments)), 0
    stack: list[Intervals] = []
    roots = iter(range(0, len(chain), BLOCK))
    while True:
        if stack:
            parts = _pop(stack)
            if spent > allowed:  # undecided: what the parents proved must do
                certified = np.minimum(certified, parts.bound.min(axis=0))
                cuts.add(parts, np.ones(len(parts), dtype=np.bool_))
                continue
        elif (start := next(roots, None)) is not None:
            parts = chain.intervals(start, min(start + BLOCK, len(chain)), COLUMNS)
        else:
            break
        if effort is not None:
            effort.spend(ROUND + INTERVAL * len(parts))
        spent += len(parts)
        floor = np.maximum(aim.enough(best.value), np.minimum(aim.target, best.value))
        bounds, rates, cut = lower_bounds(geometry, segments, scope, parts, floor)
        best.offer(SPEED, rates, parts.segment, (parts.s0 + parts.s1) / 2)
        open_rows = _open(geometry, scope, parts, bounds, (best.value, aim))
        if spent > allowed:
            open_rows[:] = False
        closed = bounds[~open_rows]
        if len(closed):
            certified = np.minimum(certified, closed.min(axis=0))
            cuts.add(parts, ~open_rows)
        rows = np.flatnonzero(open_rows)
        if len(rows):
            children = halve(geometry, segments, parts.take(rows), bounds[rows], cut[rows])
            middle = children.a.take(slice(len(rows), None))
            place = children.s0[len(rows) :]
            best.offer(0, attained(geometry, scope, middle), children.segment[: len(rows)], place)
            stack.append(children)
    bound = np.minimum(certified, best.value)
    most = allowed + len(chain) + 4 * BLOCK
    return Survey(best.value, bound, best.segment, best.fraction, spent, most, *cuts.sorted())


def _of_the_poses(geometry: Geometry, segments: Segments, chain: Chain, scope: Scope) -> _Best:
    """What the programmed poses attain, and some accelerations, so that most intervals need no closer look."""
    best = _Best()
    for i in range(0, len(chain) + 1, BLOCK):
        points = chain.points.take(slice(i, i + BLOCK))
        at = np.minimum(np.arange(i, i + len(points)), len(chain) - 1)
        last = np.arange(i, i + len(points)) == len(chain)
        place = np.where(last, chain.s1[at], chain.s0[at])
        best.offer(0, attained(geometry, scope, points), chain.segment[at], place)
    if scope.wanted[ACCELERATION:].any():
        some, halfway = np.array([0, len(segments) // 2]), np.array([0.5, 0.5])
        rates = -np.abs(joint_accelerations(geometry, segments, some, halfway))
        best.offer(ACCELERATION, np.where(scope.wanted[ACCELERATION:], rates, np.inf), some, halfway)
    return best


def _pop(stack: list[Intervals]) -> Intervals:
    """Take intervals off the stack, up to about one block."""
    taken = [stack.pop()]
    size = len(taken[0])
    while stack and size + len(stack[-1]) <= BLOCK:
        taken.append(stack.pop())
        size += len(taken[-1])
    whole = merge(taken)
    if len(whole) > 2 * BLOCK:
        keep = np.arange(len(whole))
        stack.append(whole.take(keep[BLOCK:]))
        whole = whole.take(keep[:BLOCK])
    return whole


def _open(
    geometry: Geometry, scope: Scope, parts: Intervals, bounds: Floats, known: tuple[Floats, Aim]
) -> Bools:
    """Which intervals must be split: the bound is too far below, or a deadband is not yet decided."""
    best, aim = known
    straddles = (bounds < aim.target) & (best >= aim.target) & (bounds < best - aim.fine)
    wanting = ((bounds < aim.enough(best)) | straddles) & ~scope.undefined
    if (best[:ROLL_MIN] < 0.0).any():  # outside the reach no bracket is asked for
        within = bounds[:, :ROLL_MIN].min(axis=1, keepdims=True) >= 0.0
        wanting[:, :ROLL_MIN] &= within
    if (best[:LEFT] < 0.0).any():  # out of the annulus no joint angle exists, and no enclosure of one
        wanting[:, ROLL_MIN:] = False
    width = parts.s1 - parts.s0
    followed = (width > COARSE) | (_keeps(geometry, parts.a) & _keeps(geometry, parts.b))
    wanting[:, ROLL_MIN:] &= (parts.a.inside & parts.b.inside & followed)[:, None]
    out: Bools = wanting.any(axis=1) & (width > SMALLEST)
    return out


def _keeps(geometry: Geometry, points: Points) -> Bools:
    """Whether arm and singularity keep their deadbands, so that the roll is well defined."""
    sides = signed_sides(points.distances, points.inside, full_revolution=geometry.workspace.full_revolution)
    radial = (sides[:, : OUTER + 1] >= geometry.arm_mm).all(axis=1)
    tilted: Bools = np.minimum(points.pitch, np.pi - points.pitch) >= geometry.wrist_rad
    return radial & tilted
