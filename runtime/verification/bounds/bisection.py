"""Branch and bound over the path: how small does each quantity become, and where.

All open intervals are worked off in numpy blocks, last in first out, so that memory stays bounded.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

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
from cutgate.runtime.verification.bounds.first_look import FirstLook, Looks
from cutgate.runtime.verification.bounds.geometry import Geometry, Segments
from cutgate.runtime.verification.bounds.minima import INTERVAL, ROUND, Aim, Minima
from cutgate.runtime.verification.bounds.points import Points, at
from cutgate.runtime.verification.effort import Effort
from cutgate.runtime.workspace.distance import signed_sides
from cutgate.runtime.workspace.planar import segment_to_arc

SMALLEST = 2.0**-40
"""No interval is split below this part of its segment."""

COARSE = 2.0**-10
"""Where the arm or the singularity has lost its deadband the wrist is not followed finer than this."""


@dataclass(frozen=True, slots=True)
class Survey:
    """Minima attained value and proven bound of each column; arrays of shape (COLUMNS,).

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


def budget(segments: int) -> int:
    """Intervals that a survey may look at before it splits no more and leaves the rest undecided."""
    return 64 * segments + 200_000


BESIDE = (1.0, 1 / 8, 1 / 64)
"""Parts of a segment to both sides of a place."""


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
    path: Chain | FirstLook,
    scope: Scope,
    aim: Aim,
    effort: Effort | None = None,
) -> Survey:
    """Enclose the minimum of every wanted column over the whole path.

    Raises:
        EffortSpentError: the work is more than what bounds it.
        TouchesError: a first look does not tell what lies inside the workspace.
    """
    best, cuts = Minima(), _Cuts()
    certified = np.full(COLUMNS, np.inf)
    allowed, spent = budget(len(segments)), 0
    stack: list[Intervals] = []
    begun = _begun((geometry, segments, path), scope, aim, best, effort)
    asked, roots = scope, begun.rest()
    scope = replace(scope, wanted=begun.lacking)
    while True:
        if stack:
            parts = _pop(stack)
            if spent > allowed:  # undecided: what the parents proved must do
                certified = np.minimum(certified, parts.bound.min(axis=0))
                cuts.add(parts, np.ones(len(parts), dtype=np.bool_))
                continue
        elif (root := next(roots, None)) is not None:
            parts = root
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
    if begun.looked_at:
        _narrowed(geometry, segments, asked, aim, best)
    bound = np.minimum(np.minimum(certified, begun.proven), best.value)
    spent, most = spent + begun.looked_at, allowed + begun.most + 4 * BLOCK
    return Survey(best.value, bound, best.segment, best.fraction, spent, most, *cuts.sorted())


def _narrowed(geometry: Geometry, segments: Segments, scope: Scope, aim: Aim, best: Minima) -> None:
    """Where an arc's deadband is missed: the foot of the arc on the chords beside the place, so that it is said by how much."""
    for column in range(ROLL_MIN):
        for part in BESIDE:
            if not 0.0 < best.value[column] < aim.target[column]:
                break
            segment, s = int(best.segment[column]), float(best.fraction[column])
            before = (segment, s) if s > 0.0 else (max(segment - 1, 0), 1.0)
            rows = np.array([segment, before[0]])
            s0, s1 = np.array([s, max(before[1] - part, 0.0)]), np.array([min(s + part, 1.0), before[1]])
            first, last = (at(geometry, segments, rows, end).centre for end in (s0, s1))
            place = s0 + segment_to_arc(first, last, geometry.arcs[column])[1] * (s1 - s0)
            found = attained(geometry, scope, at(geometry, segments, rows, place))
            best.offer(column, found[:, column : column + 1], rows, place)


def _begun(
    whole: tuple[Geometry, Segments, Chain | FirstLook],
    scope: Scope,
    aim: Aim,
    best: Minima,
    effort: Effort | None,
) -> Looks | _Unseen:
    """What is known before anything is bounded closely."""
    geometry, segments, path = whole
    if isinstance(path, FirstLook):
        return Looks(path, scope, aim, best, effort)
    return _Unseen(geometry, segments, path, scope, best)


class _Unseen:
    """A path at which nobody has looked, in the form of `Looks`."""

    def __init__(
        self, geometry: Geometry, segments: Segments, chain: Chain, scope: Scope, best: Minima
    ) -> None:
        _of_the_poses(geometry, segments, chain, scope, best)
        self.chain = chain
        self.lacking = scope.wanted
        self.proven = np.full(COLUMNS, np.inf)
        self.looked_at = 0
        self.most = len(chain)

    def rest(self) -> Iterator[Intervals]:
        """All of it, block by block."""
        return (
            self.chain.intervals(i, min(i + BLOCK, self.most), COLUMNS) for i in range(0, self.most, BLOCK)
        )


def _of_the_poses(geometry: Geometry, segments: Segments, chain: Chain, scope: Scope, best: Minima) -> None:
    """What the programmed poses attain, and some accelerations, so that most intervals need no closer look."""
    for i in range(0, len(chain) + 1, BLOCK):
        points = chain.points.take(slice(i, i + BLOCK))
        row = np.minimum(np.arange(i, i + len(points)), len(chain) - 1)
        last = np.arange(i, i + len(points)) == len(chain)
        place = np.where(last, chain.s1[row], chain.s0[row])
        best.offer(0, attained(geometry, scope, points), chain.segment[row], place)
    if scope.wanted[ACCELERATION:].any():
        some, halfway = np.array([0, len(segments) // 2]), np.array([0.5, 0.5])
        rates = -np.abs(joint_accelerations(geometry, segments, some, halfway))
        best.offer(ACCELERATION, np.where(scope.wanted[ACCELERATION:], rates, np.inf), some, halfway)


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
