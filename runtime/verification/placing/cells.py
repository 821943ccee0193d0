"""Squares of a map of bone positions: what is proved of every place in them, not of their middles alone.

The map of one yaw and lift is covered by squares. One is *admissible* if `decide` proves the path admissible with the bone
anywhere within the disc about its middle, quantised anew; *inadmissible* if one pose violates the arm, the slide or the roll
by more than that disc makes up for. Everything else is *unknown*, and parted into four, until little is left.

The squares lie on the lattice of the grid: one as large as the step has a position in its middle, larger ones hold several,
and a smaller one lies in the square of one position. So position and square never contradict each other.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, Final, NamedTuple

import numpy as np

from cutgate.protocol.arrays import Bools, Floats, Ints, Vector
from cutgate.runtime.verification.decide import Around, Displacement
from cutgate.runtime.verification.placing.freedom import Placing, Reserve
from cutgate.runtime.verification.placing.guidance import moved, pivot_of
from cutgate.runtime.verification.placing.room import Room
from cutgate.runtime.verification.placing.tolerated import LONGEST_POSES, as_looked_at
from cutgate.runtime.verification.problem import Problem

UNKNOWN_MAX: Final = 0.05
"""Squares are parted until no more than this part of what is not proved inadmissible is unknown, at each yaw and lift ..."""

FINEST_MM: Final = 1.0
"""... or they are no larger than this, ..."""

SHRINKS, SHRINKS_MM = 0.8, 32.0
"""... or, where they are no larger than this, what is unknown keeps more than such a part of its area: it is no rim, ..."""

WORK: Final = 300_000_000
"""... or so many poses have been looked at, over the whole map: some ten seconds of one core, whatever the path. On a map of
many positions it may be more: ..."""

PART: Final = 4
"""... one look at the path for so many of them."""

SQUARE: Final = 3000
"""Work of a square beside that of its poses."""

FIRST_MM: Final = 128.0
"""The first squares are at least this large."""

ROOMY_MM: Final = 2.5
"""Where so much is spared, a look at fewer poses mostly proves it."""

WIDER: Final = 1.0 + 1e-9
"""A disc about a square is taken larger by this for what rounds its middle and its corners."""


class State(IntEnum):
    """What is proved of a square."""

    UNKNOWN = 0
    INADMISSIBLE = 1
    ADMISSIBLE = 2


PARTED: Final = -1
"""Of a position's square: one state here and another there."""


class PathAtYaw:
    """One path at one yaw, to be looked at at many displacements and lifts.

    Attributes:
        placing: what its poses ask of a shift; where there is no `room` the turns of shoulder and roll count as well.
        room: the poses themselves, or None where turns of shoulder or roll are to be chosen, or there are too many.
    """

    def __init__(self, problem: Problem, yaw_deg: float) -> None:
        turned = moved(problem, yaw_deg, pivot_of(problem), (0.0, 0.0, 0.0))
        free = replace(turned, branch=None)
        self._looked_at = as_looked_at(free)
        self._uncut = replace(free, deadband=self._looked_at.deadband)
        usable = len(problem.tips_mm) <= LONGEST_POSES
        self.room = Room.of(replace(self._looked_at, deadband=problem.deadband)) if usable else None
        self.placing = Placing(turned, Reserve(), roll=self.room is None)

    def __len__(self) -> int:
        """Poses that one look at it takes."""
        return len(self._looked_at.tips_mm)

    def shifts(self, xy_mm: Floats, lift_mm: float) -> Floats:
        """Displacements (k, 2) and a lift in slide coordinates."""
        g = self.placing.geometry
        return xy_mm * (1.0, g.side) - lift_mm * g.tilt

    def slide_short_mm(self, lift_mm: float) -> float:
        """How much less than its deadband the slide keeps at a lift; negative where it keeps more."""
        low, high = self.placing.lift_mm
        return max(low - lift_mm, lift_mm - high)

    def holds(self, place_mm: Vector, radius_mm: float, *, roomy: bool = False) -> bool:
        """Whether it is proved that the path is admissible at every place within a level disc.

        Args:
            place_mm: displacement of its middle, and the lift.
            radius_mm: of the disc.
            roomy: whether there is enough room that long segments may well do uncut, which is tried first then.
        """
        by, error = np.array(place_mm), Displacement(radius_mm, level=True)
        paths = (self._uncut, self._looked_at) if roomy else (self._looked_at,)
        return any(Around(replace(path, tips_mm=path.tips_mm + by)).holds(error) for path in paths)

    def states(self, middles_mm: Floats, side_mm: float, lift_mm: float) -> Ints:
        """What is proved of squares of one size, middles (k, 2): `State`, shape (k,)."""
        out = np.full(len(middles_mm), State.UNKNOWN, dtype=np.int64)
        if self.slide_short_mm(lift_mm) > self.placing.pad_mm:
            out[:] = State.INADMISSIBLE
            return out
        radius = side_mm / math.sqrt(2.0) * WIDER
        shifts = self.shifts(middles_mm, lift_mm)
        size = self.placing.at_once
        for i in range(0, len(out), size):
            part = slice(i, i + size)
            excluded, _ = self.placing.excluded(shifts[part], np.full(len(shifts[part]), radius))
            out[part][excluded] = State.INADMISSIBLE
        if self.room is not None:
            self._look_closer(self.room, (middles_mm, shifts), radius, lift_mm, out)
        return out

    def _look_closer(
        self, room: Room, places: tuple[Floats, Floats], radius_mm: float, lift_mm: float, out: Ints
    ) -> None:
        """At all poses, for squares that are still unknown."""
        middles, shifts = places
        open_ = np.flatnonzero(out == State.UNKNOWN)
        spare = room.spare_mm(shifts[open_], radius_mm)
        worth = spare > 0.0
        for k, much in zip(open_[worth].tolist(), (spare[worth] > ROOMY_MM).tolist(), strict=True):
            if self.holds((float(middles[k, 0]), float(middles[k, 1]), lift_mm), radius_mm, roomy=much):
                out[k] = State.ADMISSIBLE
        rest = open_[~worth]
        arm, roll = room.violated(room.attained(shifts[rest], radius_mm), np.full(len(rest), radius_mm))
        out[rest[arm | roll]] = State.INADMISSIBLE


class Lattice(NamedTuple):
    """Squares of a map: level by level half as large, the first ones of whole steps.

    Attributes:
        corner_mm: least x and y of the map.
        size: columns and rows of the grid's positions.
        step_mm: of the grid.
        first: how many steps a square of level 0 is long: a power of two.
    """

    corner_mm: tuple[float, float]
    size: tuple[int, int]
    step_mm: float
    first: int

    @classmethod
    def over(cls, x_mm: Sequence[float], y_mm: Sequence[float], step_mm: float) -> Lattice:
        """Over the squares of all positions."""
        half, size = step_mm / 2.0, (len(x_mm), len(y_mm))
        needed = min(FIRST_MM / step_mm, max(size))
        first = 1 << max(0, math.ceil(math.log2(needed))) if needed > 1.0 else 1
        return cls((x_mm[0] - half, y_mm[0] - half), size, step_mm, first)

    @property
    def whole(self) -> int:
        """The level of squares as large as the step: from it on all lie in the square of one position."""
        return self.first.bit_length() - 1

    def side_mm(self, level: int) -> float:
        """Of a square."""
        return math.ldexp(self.first * self.step_mm, -level)

    def all_first(self) -> Ints:
        """Columns and rows of the squares of level 0, shape (k, 2)."""
        columns, rows = (-(-n // self.first) for n in self.size)
        i, j = np.meshgrid(np.arange(columns), np.arange(rows))
        return np.stack((i.ravel(), j.ravel()), axis=1)

    def middles_mm(self, squares: Ints, level: int) -> Floats:
        """Of squares (k, 2)."""
        out: Floats = np.array(self.corner_mm) + (squares + 0.5) * self.side_mm(level)
        return out

    def parted(self, squares: Ints) -> Ints:
        """Each into four."""
        quarters = np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
        out: Ints = (2 * squares[:, None, :] + quarters).reshape(-1, 2)
        return out

    def inside(self, squares: Ints, level: int) -> tuple[Bools, Bools]:
        """Whether squares (k, 2) lie in the map, wholly, and in part."""
        scale = self.first / (1 << level)  # steps, exactly: a power of two
        size = np.array(self.size)
        whole, part = (squares + 1) * scale <= size, squares * scale < size
        return whole[:, 0] & whole[:, 1], part[:, 0] & part[:, 1]

    def cut(self, squares: Ints, level: int, states: Ints) -> Iterator[tuple[Ints, Ints]]:
        """What of squares lies in the map, as such of this level and finer ones: level, column and row, and their states."""
        while len(squares):
            whole, part = self.inside(squares, level)
            yield np.insert(squares[whole], 0, level, axis=1), states[whole]
            rest = part & ~whole
            squares, states, level = self.parted(squares[rest]), np.repeat(states[rest], 4), level + 1


@dataclass(frozen=True, slots=True)
class Squares:
    """The map of one yaw and lift in squares that do not overlap and cover it.

    Attributes:
        yaw_deg, lift_mm: of the map.
        lattice: where its squares lie.
        where: level, column and row of each, shape (k, 3).
        states: `State` of each, shape (k,).
    """

    yaw_deg: float
    lift_mm: float
    lattice: Lattice
    where: Ints
    states: Ints

    @property
    def sides_mm(self) -> Floats:
        """Of each."""
        out: Floats = np.ldexp(self.lattice.first * self.lattice.step_mm, -self.where[:, 0])
        return out

    @property
    def middles_mm(self) -> Floats:
        """Of each, shape (k, 2)."""
        out: Floats = np.array(self.lattice.corner_mm) + (self.where[:, 1:] + 0.5) * self.sides_mm[:, None]
        return out

    @property
    def smaller(self) -> Bools:
        """Which ones are smaller than the step, and known."""
        out: Bools = (self.where[:, 0] > self.lattice.whole) & (self.states != State.UNKNOWN)
        return out

    def area_mm2(self, state: State) -> float:
        """Of all in a state."""
        return float((self.sides_mm[self.states == state] ** 2).sum())

    @property
    def unknown_share(self) -> float:
        """Unknown, of what is not proved inadmissible."""
        unknown, admissible = self.area_mm2(State.UNKNOWN), self.area_mm2(State.ADMISSIBLE)
        return unknown / (unknown + admissible) if unknown else 0.0

    def of_positions(self) -> tuple[Ints, Bools]:
        """For each position of the grid, rows of y and in them x.

        Returns:
            What is proved of its whole square: a `State`, or `PARTED`; and whether the
            position itself lies in an admissible one, (rows, columns) each.
        """
        nothing = -2
        (columns, rows), whole = self.lattice.size, self.lattice.whole
        whole_of = np.full((rows, columns), nothing, dtype=np.int64)
        itself = np.zeros((rows, columns), dtype=np.bool_)
        level, i, j = self.where.T
        for k in np.flatnonzero(level <= whole):
            n = 1 << (whole - int(level[k]))
            whole_of[j[k] * n : (j[k] + 1) * n, i[k] * n : (i[k] + 1) * n] = self.states[k]
        itself[whole_of == State.ADMISSIBLE] = True
        fine = np.flatnonzero(level > whole)
        by = level[fine] - whole
        x, y = i[fine] >> by, j[fine] >> by
        for state in State:
            here = self.states[fine] == state
            found = np.zeros((rows, columns), dtype=np.bool_)
            found[y[here], x[here]] = True
            whole_of = np.where(found, np.where(whole_of == nothing, int(state), PARTED), whole_of)
        # the position is a corner of the innermost four of its square
        half = np.left_shift(1, by - 1)
        corner = np.all(
            [
                (v == m * 2 * half + half) | (v == m * 2 * half + half - 1)
                for v, m in ((i[fine], x), (j[fine], y))
            ],
            axis=0,
        )
        good = corner & (self.states[fine] == State.ADMISSIBLE)
        itself[y[good], x[good]] = True
        return whole_of, itself


class Quadtree:
    """The squares of one yaw and lift while they are parted: level by level, so that whoever judges them, they are the same.

    Attributes:
        level: of the open ones.
        open: squares to be judged, shape (k, 2).
    """

    def __init__(self, yaw_deg: float, lift_mm: float, lattice: Lattice) -> None:
        self.yaw_deg, self.lift_mm, self.lattice = yaw_deg, lift_mm, lattice
        self.level, self.open = 0, lattice.all_first()
        self._found: list[tuple[Ints, Ints]] = []
        self._admissible_mm2 = 0.0
        self._unknown_mm2 = math.inf

    def judged(self, states: Ints) -> None:
        """What is proved of the open ones: known ones are kept, the others parted, or kept as well where it is enough."""
        side, known = self.lattice.side_mm(self.level), states != State.UNKNOWN
        self._keep(self.open[known], states[known])
        self.open = self.open[~known]
        unknown = len(self.open) * side * side
        enough = unknown <= UNKNOWN_MAX * (unknown + self._admissible_mm2)
        stays = side <= SHRINKS_MM and unknown > SHRINKS * self._unknown_mm2
        self._unknown_mm2 = unknown
        if self.level >= self.lattice.whole and (enough or stays or side <= FINEST_MM):
            self.end()
        else:
            parted, self.level = self.lattice.parted(self.open), self.level + 1
            self.open = parted[self.lattice.inside(parted, self.level)[1]]

    def end(self) -> None:
        """What is open stays unknown."""
        self._keep(self.open, np.full(len(self.open), State.UNKNOWN, dtype=np.int64))
        self.open = self.open[:0]

    def done(self) -> Squares:
        """All of them."""
        where, states = (np.concatenate(part) for part in zip(*self._found, strict=True))
        return Squares(self.yaw_deg, self.lift_mm, self.lattice, where, states)

    def _keep(self, squares: Ints, states: Ints) -> None:
        for where, these in self.lattice.cut(squares, self.level, states):
            self._found.append((where, these))
            sides = np.ldexp(self.lattice.first * self.lattice.step_mm, -where[these == State.ADMISSIBLE, 0])
            self._admissible_mm2 += float((sides**2).sum())


def everywhere(yaw_deg: float, lift_mm: float, lattice: Lattice, state: State) -> Squares:
    """One state for the whole map."""
    growing = Quadtree(yaw_deg, lift_mm, lattice)
    growing.judged(np.full(len(growing.open), state, dtype=np.int64))
    return growing.done()


def summary(squares: Iterable[Squares]) -> list[dict[str, Any]]:
    """Of each yaw and lift, for the document: areas, and the squares that are admissible or unknown; all else is not."""
    out = []
    for one in squares:
        listed = {
            state: np.column_stack((one.middles_mm, one.sides_mm))[one.states == state].round(6).tolist()
            for state in (State.ADMISSIBLE, State.UNKNOWN)
        }
        out.append(
            {
                "yaw_deg": one.yaw_deg,
                "lift_mm": one.lift_mm,
                **{f"{state.name.lower()}_mm2": round(one.area_mm2(state), 3) for state in reversed(State)},
                "unknown_share": round(one.unknown_share, 6),
                "admissible": listed[State.ADMISSIBLE],
                "unknown": listed[State.UNKNOWN],
            }
        )
    return out
