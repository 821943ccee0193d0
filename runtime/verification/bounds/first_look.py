"""A path looked at as a whole, cheap: where the least values can lie, so that little is bounded closely.

Rules, in order:

1. Every segment is looked at (`look`). What keeps as much as is needed (`Looks._needed`) is done with.
2. The rest is cut into `PARTS` and looked at again, `DEPTH` times; then it is bounded closely (`bisection`).
3. Where the joints cannot be followed, the tool may stand vertical, or the wrist centre may pass the column, there is no
   first look: all of the path is bounded closely (`chain`). Of a short path the parts of the segments are tried before.
4. So it is where the path may touch a boundary of the workspace (`TouchesError`): a path that begins inside and
   touches none stays inside, and distances need no sign.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from cutgate.protocol.arrays import Floats, Ints
from cutgate.runtime.kinematics.arm import REVOLUTION
from cutgate.runtime.verification.bounds.chain import Chain, Intervals
from cutgate.runtime.verification.bounds.closed_form import Extremes, extremes
from cutgate.runtime.verification.bounds.enclosures import ACCELERATION, COLUMNS, LEFT, ROLL_MIN, Scope
from cutgate.runtime.verification.bounds.geometry import Geometry, Segments
from cutgate.runtime.verification.bounds.look import Look, TouchesError
from cutgate.runtime.verification.bounds.minima import INTERVAL, ROUND, Aim, Minima
from cutgate.runtime.verification.bounds.pieces import PARTS, Pieces
from cutgate.runtime.verification.effort import Effort

BLOCK: Final = 2048
"""Pieces looked at in one go: rows of numbers that the processor keeps close."""

DEPTH: Final = 2
"""So often what keeps too little is cut and looked at again."""

PARTED_MAX: Final = BLOCK // PARTS
"""Where the segments themselves are too long to follow the joints, those of no longer paths are cut at once."""

Making = Callable[[Segments, slice, tuple[Floats, Floats]], Pieces]


@dataclass(frozen=True, slots=True)
class FirstLook:
    """A path of which every segment was looked at, and found to be one whose joints can be followed.

    Attributes:
        geometry, segments: the path.
        accelerations: whether they are bounded.
        make: the pieces of a block.
        looks: what each block begins with, and the look itself where it is the only one.
        start: q0 and q3 at the first pose, rad.
        shoulder: least and largest q0 at the poses, rad.
        height: of the wrist centre at the poses, mm, shape (n + 1,).
        pitch: q4 likewise, rad.
    """

    geometry: Geometry
    segments: Segments
    accelerations: bool
    make: Making
    looks: tuple[tuple[slice, tuple[Floats, Floats]], ...]
    only: Look | None
    start: tuple[float, float]
    shoulder: tuple[float, float]
    height: Floats
    pitch: Floats

    winding_known = True
    starts_inside = True

    def __len__(self) -> int:
        return len(self.segments)

    @classmethod
    def of(cls, geometry: Geometry, segments: Segments, *, accelerations: bool) -> FirstLook | None:
        """Look at the whole path; None where that is not enough anywhere, or it does not start in the workspace."""
        if geometry.workspace.empty:
            return None
        found = cls._of(geometry, segments, accelerations, Pieces.whole)
        if found is None and len(segments) <= PARTED_MAX:
            found = cls._of(geometry, segments, accelerations, Pieces.parted)
        return found

    @classmethod
    def _of(
        cls, geometry: Geometry, segments: Segments, accelerations: bool, make: Making
    ) -> FirstLook | None:
        n, follow, looks, ends = len(segments), _start(geometry, segments), [], []
        for i in range(0, n, BLOCK):
            part = slice(i, min(i + BLOCK, n))
            looks.append((part, follow))
            look = Look(geometry, segments, make(segments, part, follow))
            with np.errstate(all="ignore"):
                if not (look.follows() and (i or _inside(geometry, look))):
                    return None
            q0, _, z, q3, q4 = look.joints
            follow = (q0[:, -1:], q3[:, -1:])
            step = 1 if make == Pieces.whole else PARTS
            poses = slice(step if i else 0, None, step)
            ends.append((z[0, poses], q4[0, poses], float(q0.min()), float(q0.max())))
        heights, pitches, least, most = zip(*ends, strict=True)
        only = look if len(looks) == 1 else None
        if only is not None:
            with np.errstate(all="ignore"):
                only.bound(accelerations=accelerations)
        height, pitch = (a[0] if only else np.concatenate(a) for a in (heights, pitches))
        start = (float(looks[0][1][0][0, 0]), float(looks[0][1][1][0, 0]))
        return cls(
            geometry,
            segments,
            accelerations,
            make,
            tuple(looks),
            only,
            start,
            (min(least), max(most)),
            height,
            pitch,
        )

    @property
    def parts(self) -> int:
        """Pieces of each segment that were looked at."""
        return 1 if self.make == Pieces.whole else PARTS

    def all(self) -> Iterator[Look]:
        """The looks at all segments, block by block; made anew where there is more than one.

        Raises:
            TouchesError: one is not found again: what it would have said must not be left out.
        """
        if self.only is not None:
            yield self.only
            return
        for part, follow in self.looks:
            pieces = self.make(self.segments, part, follow)
            look = _looked(self.geometry, self.segments, pieces, accelerations=self.accelerations)
            if look is None:
                raise TouchesError
            yield look


class Looks:
    """Looks at a path for one survey, at all segments first, then at what keeps too little.

    Attributes:
        proven: what is proved of each column of the pieces closed so far, shape (COLUMNS,).
        whole: what the first look proves of each column, shape (COLUMNS,).
        lacking: columns of which the first look does not prove enough, shape (COLUMNS,).
        looked_at: number of pieces so far.
        most: so many it can become.
    """

    def __init__(self, path: FirstLook, scope: Scope, aim: Aim, best: Minima, effort: Effort | None) -> None:
        self.path = path
        self.scope = scope
        self.aim = aim
        self.best = best
        self.effort = effort
        self.looked_at = 0
        self.most = len(path) * path.parts * (1 + PARTS + PARTS * PARTS)
        self.proven = np.full(COLUMNS, np.inf)
        self.columns = np.flatnonzero(scope.wanted).tolist()
        self.least = [self._kept(look, self.columns) for look in path.all()]
        self.whole, needed = np.minimum.reduce(self.least), self._needed(self.columns)
        self.lacking = ~(self.whole >= needed) & scope.wanted
        if not self.lacking.any():
            self.proven = self.whole

    def rest(self) -> Iterator[Intervals]:
        """Intervals of which the lacking columns have to be bounded closely; what is closed goes into `proven`.

        Raises:
            TouchesError: the path may touch a boundary.
        """
        if not self.lacking.any():
            return
        for look, least in zip(self.path.all(), self.least, strict=True):
            if self.path.only is None:  # it was made anew
                look.offer(self.columns, self.scope, self.aim, self.best)
            yield from self._open(look, least, self.columns, DEPTH)

    def _kept(self, look: Look, columns: list[int]) -> Floats:
        self.looked_at += look.hertz.size
        if self.effort is not None:
            self.effort.spend(ROUND + INTERVAL * look.hertz.size)
        return look.offer(columns, self.scope, self.aim, self.best)

    def _open(self, look: Look, least: Floats, columns: list[int], depth: int) -> Iterator[Intervals]:
        """Close what can be closed of a look, and look again at the rest."""
        needed = self._needed(columns)
        short = [column for column in columns if not least[column] >= needed[column]]
        rows = look.short(short, needed)
        for column in short:
            least[column] = look.rest(column, rows)
        self.proven = np.minimum(self.proven, least)
        cut = depth > 0 and max(short, default=0) < ACCELERATION  # parts say nothing of accelerations
        size = BLOCK // PARTS if cut else BLOCK
        for i in range(0, len(rows), size):
            some = rows[i : i + size]
            finer = self._finer(look, some) if cut else None
            if finer is not None:
                yield from self._open(finer, self._kept(finer, short), short, depth - 1)
            elif all(look.shown[column].flat[some].min() > 0.0 for column in self._bounding(short)):
                yield look.intervals(some)
            else:
                raise TouchesError

    def _finer(self, look: Look, rows: Ints) -> Look | None:
        """Another look at some of the pieces, cut."""
        pieces = look.pieces.cut(self.path.segments, rows, look.joints)
        finer = _looked(self.path.geometry, self.path.segments, pieces, accelerations=False)
        if finer is not None:
            finer.inherit(look, rows)
        return finer

    def _bounding(self, columns: list[int]) -> list[int]:
        """Those of some columns that bound the workspace."""
        most = LEFT if self.path.geometry.workspace.full_revolution else ROLL_MIN
        return [column for column in columns if column < most]

    def _needed(self, columns: list[int]) -> Floats:
        """What a bound must reach: close to the least value found; the target where that keeps it; and more than nothing."""
        best, target = self.best.value, self.aim.target
        needed = np.maximum(self.aim.enough(best), np.where(best >= target, target, -np.inf))
        for column in self._bounding(columns):
            needed[column] = max(needed[column], self.path.geometry.pad_mm)
        return needed


def _start(geometry: Geometry, segments: Segments) -> tuple[Floats, Floats]:
    """q0 and q3 at the first pose, counted as `points.Points` counts them; anything where it is out of reach."""
    (tx, ty, tz), (ux, uy, uz) = segments.tip[0].tolist(), segments.axis[0].tolist()
    tool, (lean_x, lean_y), space = geometry.tool_mm, geometry.tilt.tolist(), geometry.workspace
    z = tz + tool * uz
    x, y = tx + tool * ux - lean_x * z, ty + tool * uy - lean_y * z
    cosine = (x * x + y * y - space.a0 * space.a0 - space.a1 * space.a1) / (2.0 * space.a0 * space.a1)
    q1 = math.acos(max(-1.0, min(cosine, 1.0)))
    q0 = math.atan2(y, x) - math.atan2(space.a1 * math.sin(q1), space.a0 + space.a1 * cosine)
    return np.full((1, 1), q0), np.full((1, 1), math.atan2(uy, ux) - q0 - q1)


def _inside(geometry: Geometry, look: Look) -> bool:
    """Whether the first pose lies in the planar workspace."""
    space = geometry.workspace
    q0, q1 = (float(q[0, 0]) for q in look.joints[:2])
    return space.q1_lo <= q1 <= space.q1_hi and (q0 - space.q0_lo) % REVOLUTION <= space.q0_hi - space.q0_lo


def extremes_of(geometry: Geometry, segments: Segments, path: FirstLook | Chain) -> Extremes:
    """`extremes` of a path whose poses have been evaluated."""
    poses = path if isinstance(path, FirstLook) else path.poses
    return extremes(geometry, segments, poses.height, poses.pitch)


def _looked(geometry: Geometry, segments: Segments, pieces: Pieces, *, accelerations: bool) -> Look | None:
    look = Look(geometry, segments, pieces)
    with np.errstate(all="ignore"):
        if not look.follows():
            return None
        look.bound(accelerations=accelerations)
    return look
