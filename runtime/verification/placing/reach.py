"""Where the bone could stand: the smallest margin of the whole path over a grid of bone positions.

A position is the new registration ``Trans(x, y, lift) * Rz(yaw about pivot) * R_T_CT``. It counts as
admissible only if the certified method admits the moved and re-quantised path. Positions at which one pose
alone is proved to violate the arm or the slide are excluded without it: that is what makes the map fast.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from cutgate.protocol.arrays import Bools, Floats, Ints, Vector
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.bounds.geometry import MIRRORED, Geometry
from cutgate.runtime.verification.placing.cells import PARTED, PathAtYaw, Squares, State, summary
from cutgate.runtime.verification.placing.freedom import Placing, Reserve
from cutgate.runtime.verification.placing.guidance import Quantise, guide, moved, pivot_of, unchanged_by_moves
from cutgate.runtime.verification.placing.room import Room
from cutgate.runtime.verification.placing.tolerated import QUANTISED_RAD
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.verdict import Boundary, Verdict
from cutgate.runtime.workspace.distance import side_distances
from cutgate.runtime.workspace.planar import SIDES

SCHEMA: Final = "cutgate.reach/1"

BLOCK: Final = 4096
"""Displacements looked at in one go."""


@dataclass(frozen=True, slots=True)
class Grid:
    """Positions to judge: every combination of displacement, yaw about the pivot and lift."""

    step_mm: float
    x_mm: tuple[float, ...]
    y_mm: tuple[float, ...]
    yaw_deg: tuple[float, ...]
    lift_mm: tuple[float, ...]

    @property
    def layers(self) -> list[tuple[float, float]]:
        """Every yaw with every lift."""
        return [(yaw, lift) for yaw in self.yaw_deg for lift in self.lift_mm]

    def __len__(self) -> int:
        return len(self.x_mm) * len(self.y_mm) * len(self.yaw_deg) * len(self.lift_mm)


Cell = Literal["admissible", "inadmissible", "unknown", "parted"]

_Place = tuple[float, float, float, float]
_Asked = tuple[Sequence[_Place], Sequence[Cell]]

CELLS: Final[dict[int, Cell]] = {
    State.ADMISSIBLE: "admissible",
    State.INADMISSIBLE: "inadmissible",
    State.UNKNOWN: "unknown",
    PARTED: "parted",
}
"""What is proved of the square of a position: of all of it, or of its parts one or another."""

TILTS: Final = ("pitch_min", "pitch_max", "wrist_singularity")
ROLLS: Final = ("roll_min", "roll_max")


@dataclass(frozen=True, slots=True)
class Position:
    """One position of the bone and what decides there.

    Attributes:
        x_mm, y_mm, yaw_deg, lift_mm: the move of the registration, robot frame.
        admissible: whether the certified method admits the moved path.
        checked: by ``certified``; or excluded by one ``pose``, which is proof enough that it is inadmissible; or ``proved``
            admissible by one look at each segment, alone or with all of a square.
        limiting: boundary with the smallest clearance per deadband, or ``speed_qN``.
        unit: mm or deg, or that of the joint's speed.
        clearance: of that boundary, proven, at least that; attained at a pose where that excludes; None if undefined.
            For a speed or acceleration the largest one on the path.
        bound: the deadband to be kept, or the speed not to be exceeded.
        ratio: clearance per deadband, or limit per speed; at least 1 where admissible; None if undefined.
        cell: what is proved of every place in the square of the step about it.
    """

    x_mm: float
    y_mm: float
    yaw_deg: float
    lift_mm: float
    admissible: bool
    checked: Literal["certified", "pose", "proved"]
    limiting: str
    unit: str
    clearance: float | None
    bound: float
    ratio: float | None
    cell: Cell = "unknown"


RATES: Final = ("speed", "acceleration")
"""Limiting names that begin so are rates: the largest one of a joint, where less is better."""

COLUMNS: Final = tuple(Position.__dataclass_fields__)
"""Of the CSV file and of each position in the JSON document."""


class Surveyed(NamedTuple):
    """A map.

    Attributes:
        positions: of the grid, in the order yaw, lift, y, x.
        squares: for each yaw and lift what is proved between them.
        middles: for each yaw and lift what decides in the middles of its `Squares.smaller` ones.
    """

    positions: list[Position]
    squares: list[Squares]
    middles: list[list[Position]]


def grid_of(problem: Problem, step_mm: float, yaw_deg: Sequence[float], lift_mm: Sequence[float]) -> Grid:
    """The grid that covers every displacement after which the arm might reach all poses.

    Displacements are whole steps, so that the bone's present place is one of them.

    Args:
        problem: the path where the bone stands now.
        step_mm: distance of neighbouring displacements.
        yaw_deg: turns about the vertical through the pivot.
        lift_mm: displacements along z.
    """
    low, high = np.zeros(2), np.zeros(2)
    for yaw in yaw_deg:
        placing = _placing(problem, yaw)
        a, b = placing.domain
        for lift in lift_mm:
            lean = lift * placing.geometry.tilt
            ends = np.stack((a + lean, b + lean)) * (1.0, placing.geometry.side)
            if (a <= b).all():
                low, high = np.minimum(low, ends.min(axis=0)), np.maximum(high, ends.max(axis=0))

    def ticks(axis: int) -> tuple[float, ...]:
        first, last = math.floor(low[axis] / step_mm), math.ceil(high[axis] / step_mm)
        return tuple(round(k * step_mm, 6) for k in range(first, last + 1))

    return Grid(step_mm, ticks(0), ticks(1), tuple(yaw_deg), tuple(lift_mm))


@dataclass(frozen=True, slots=True)
class GridStart:
    """Where a map begins that nobody told at which height.

    Attributes:
        yaw_deg: a turn that is needed at this height; 0 without one.
        lift_mm: the height.
        chosen_by: ``present`` height of the bone, ``guidance``, or what the ``slide`` needs where guidance knows no move.
        move_mm: guidance's translation, verified; None without one.
    """

    yaw_deg: float
    lift_mm: float
    chosen_by: Literal["present", "guidance", "slide"]
    move_mm: Vector | None = None


def start(problem: Problem, quantise: Quantise) -> GridStart:
    """The present height where the path is admissible there, else that of the move that guidance would show.

    Without such a move it is the middle of what the slide allows, in whole mm, or the present height where it fits.
    """
    verdict = certified.verify(problem)
    found = guide(problem, verdict, quantise)
    if found is not None and found.verified and found.translation_mm is not None:
        return GridStart(found.yaw_deg, found.translation_mm[2], "guidance", found.translation_mm)
    least, most = _placing(problem, 0.0).lift_mm
    if verdict.admissible or least <= 0.0 <= most or least > most:
        return GridStart(0.0, 0.0, "present")
    return GridStart(0.0, float(round((least + most) / 2.0)), "slide")


def _placing(problem: Problem, yaw_deg: float) -> Placing:
    return Placing(moved(problem, yaw_deg, pivot_of(problem), (0.0, 0.0, 0.0)), Reserve(), roll=False)


def unrecoverable(problem: Problem, verdict: Verdict) -> Boundary | None:
    """The boundary that no position cures, as no move and no turn about the vertical changes it; or None."""
    names = unchanged_by_moves(problem, verdict)
    return min((verdict.boundaries[name] for name in names), key=_ratio, default=None)


class PositionJudge:
    """What decides at positions of one yaw.

    A position in a square that is proved admissible is; others one pose may exclude, one look may prove admissible, and the
    rest is verified as a whole. How much room there is where that is proved is read off the poses (`Room`).

    Args:
        problem: the path where the bone stands now.
        plane: at the yaw.
        verdict: of the path where the bone stands now: what no move changes.
        quantise: what the wire does to poses.
    """

    def __init__(self, problem: Problem, plane: PathAtYaw, verdict: Verdict, quantise: Quantise) -> None:
        self._problem, self._plane, self._verdict, self._quantise = problem, plane, verdict, quantise
        # nothing changes the tilt of the tool but how it is quantised
        self._tilts: list[Boundary] = [
            verdict.boundaries[name] for name in TILTS if name in verdict.boundaries
        ]
        self._room = plane.room if all(b.certified is not None for b in self._tilts) else None

    def positions(
        self, yaw_deg: float, lift_mm: float, places_mm: Floats, proved: Bools, cells: Sequence[Cell]
    ) -> list[Position]:
        """Positions in their order.

        Args:
            yaw_deg: of the plane.
            lift_mm: of all of them.
            places_mm: displacements, shape (k, 2).
            proved: which ones are proved admissible, shape (k,).
            cells: what is proved of the square of each.
        """
        out: dict[int, Position] = {}
        where = [(x, y, yaw_deg, lift_mm) for x, y in places_mm.tolist()]
        shifts = self._plane.shifts(places_mm, lift_mm)
        open_ = np.arange(len(where))
        if self._room is not None:
            open_ = np.flatnonzero(~proved)
        self._by_the_sample(out, (where, cells), shifts, open_)
        open_ = np.array([k for k in open_.tolist() if k not in out], dtype=np.int64)
        admissible = np.flatnonzero(proved).tolist() if self._room is not None else []
        if self._room is not None and len(open_):
            self._by_a_pose(self._room, out, (where, cells), shifts, open_)
            for k in open_.tolist():
                x, y, _, _ = where[k]
                if k not in out and self._plane.holds((x, y, lift_mm), 0.0):
                    admissible.append(k)
        if self._room is not None and admissible:
            self._read_off(self._room, out, (where, cells), shifts, np.array(sorted(admissible)))
        for k in open_.tolist():
            if k not in out:
                x, y, _, _ = where[k]
                out[k] = judged(self._problem, self._quantise, yaw_deg, (x, y, lift_mm), cells[k])
        return [out[k] for k in range(len(where))]

    def _by_the_sample(self, out: dict[int, Position], asked: _Asked, shifts: Floats, open_: Ints) -> None:
        """Where one of a few poses excludes them, or the slide does."""
        placing, g, (where, cells) = self._plane.placing, self._plane.placing.geometry, asked
        if len(open_) == 0:
            return
        lift_mm, (low, high) = where[0][3], placing.lift_mm
        slide, short = max((("bottom", low - lift_mm), ("top", lift_mm - high)), key=lambda end: end[1])
        some = shifts[open_]
        blocks = [placing.nearest_sides(some[i : i + BLOCK]) for i in range(0, len(some), BLOCK)]
        clearance, side = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
        for k, least, number in zip(open_.tolist(), clearance.tolist(), side.tolist(), strict=True):
            name = _named(SIDES[number], g)
            if placing.keep_mm - short < least:
                name, least = slide, placing.keep_mm - short  # noqa: PLW2901 - the nearer of two
            if least < placing.keep_mm - placing.pad_mm:
                ratio = least / placing.keep_mm
                at: _Place = where[k]
                out[k] = Position(*at, False, "pose", name, "mm", least, placing.keep_mm, ratio, cells[k])

    def _by_a_pose(
        self, room: Room, out: dict[int, Position], asked: _Asked, shifts: Floats, open_: Ints
    ) -> None:
        """Where one of all poses excludes them."""
        (where, cells), g = asked, room.geometry
        found = room.attained(shifts[open_])
        arm, roll = room.violated(found, np.zeros(len(open_)))
        nearest = np.argmin(side_distances(found.place, g.workspace), axis=1).tolist()
        for i, k in enumerate(open_.tolist()):
            if arm[i] and not (roll[i] and found.roll_rad[i] / g.wrist_rad < found.arm_mm[i] / g.arm_mm):
                least, name, unit, keep = float(found.arm_mm[i]), SIDES[nearest[i]], "mm", g.arm_mm
            elif roll[i]:
                least, unit, keep = math.degrees(found.roll_rad[i]), "deg", math.degrees(g.wrist_rad)
                name = "roll_max" if found.toward_upper[i] else "roll_min"
            else:
                continue
            at: _Place = where[k]
            name = _named(name, g)
            out[k] = Position(*at, False, "pose", name, unit, least, keep, least / keep, cells[k])

    def _read_off(
        self, room: Room, out: dict[int, Position], asked: _Asked, shifts: Floats, rows: Ints
    ) -> None:
        """How much is kept at least where the path is proved admissible; of what is proved that is the deadband itself."""
        (where, cells), g, plane = asked, room.geometry, self._plane
        low, high = plane.placing.lift_mm
        wire, lift_mm = room.wire_mm, where[0][3]
        slide = [("bottom", g.arm_mm + lift_mm - low - wire), ("top", g.arm_mm + high - lift_mm - wire)]
        keep_deg = math.degrees(g.wrist_rad)
        constant = [(value / g.arm_mm, name, "mm", value, g.arm_mm) for name, value in slide]
        for b in self._tilts:
            value = (b.certified or 0.0) - math.degrees(QUANTISED_RAD)
            constant.append((value / b.deadband, b.name, b.unit, value, b.deadband))
        steady = min(constant)
        kept = room.kept(shifts[rows], np.full(len(rows), steady[0]))
        arm = np.argmin(kept.arm_mm, axis=0)
        least = kept.arm_mm[arm, np.arange(len(rows))]
        roll = np.where(np.isnan(kept.roll_rad), g.wrist_rad, kept.roll_rad)
        ends = kept.toward_upper.tolist()
        for i, k in enumerate(rows.tolist()):
            ratio, name, unit, value, keep = min(
                steady,
                (least[i] / g.arm_mm, SIDES[arm[i]], "mm", float(least[i]), g.arm_mm),
                (roll[i] / g.wrist_rad, ROLLS[ends[i]], "deg", math.degrees(roll[i]), keep_deg),
            )
            if name != steady[1]:
                name = _named(name, g)
            ratio, value = max(float(ratio), 1.0), max(value, keep)
            at: _Place = where[k]
            out[k] = Position(*at, True, "proved", name, unit, value, keep, ratio, cells[k])


def _named(canonical: str, geometry: Geometry) -> str:
    """A boundary of the arm as given."""
    return MIRRORED.get(canonical, canonical) if geometry.side < 0.0 else canonical


def judged(
    problem: Problem,
    quantise: Quantise,
    yaw_deg: float,
    translation_mm: Vector,
    cell: Cell = "unknown",
) -> Position:
    """One position by the certified method, on the moved and re-quantised path."""
    path = moved(problem, yaw_deg, pivot_of(problem), translation_mm)
    tips, axes = quantise(path.tips_mm, path.axes)
    verdict = certified.verify(replace(path, tips_mm=tips, axes=axes, branch=None))
    x, y, lift = translation_mm
    return _position((x, y, yaw_deg, lift), verdict, cell)


def _position(where: tuple[float, float, float, float], verdict: Verdict, cell: Cell = "unknown") -> Position:
    """What decides: a boundary that is known and violated, one that is undefined, a speed, or the tightest."""
    worst = min(verdict.boundaries.values(), key=_ratio)
    undefined = [b for b in verdict.boundaries.values() if b.certified is None]
    fast = [line for line in (*verdict.speed, *verdict.acceleration) if not line.ok]
    if not worst.violated and undefined:
        worst = undefined[0]
    if not worst.violated and fast:
        line = fast[0]
        unit = ("mm/s" if line.joint == 2 else "rad/s") + ("2" if line.quantity == "acceleration" else "")
        ratio = None if not line.peak else line.limit / line.peak
        return Position(
            *where,
            verdict.admissible,
            "certified",
            f"{line.quantity}_q{line.joint}",
            unit,
            line.peak,
            line.limit,
            ratio,
            cell,
        )
    known = worst.certified is not None
    return Position(
        *where, verdict.admissible, "certified", worst.name, worst.unit, worst.certified, worst.deadband,
        _ratio(worst) if known else None, cell,
    )  # fmt: skip


def _ratio(boundary: Boundary) -> float:
    """Clearance per deadband, to compare over units; undefined ones last."""
    return math.inf if boundary.certified is None else boundary.certified / boundary.deadband


def reach_document(
    problem: Problem, grid: Grid, found: Surveyed, made_for: dict[str, Any], begun: GridStart | None = None
) -> dict[str, Any]:
    """The map as one JSON document, ``cutgate.reach/1``.

    Args:
        problem: the path where the bone stands now.
        grid: what was asked.
        found: all of it.
        made_for: plan, robot, registration and digests.
        begun: what chose the height; None where it was asked for.
    """
    positions = found.positions
    return {
        "schema": SCHEMA,
        **made_for,
        "pivot_mm": list(pivot_of(problem)),
        "lift_chosen_by": begun.chosen_by if begun else "asked",
        "guidance": {"translation_mm": list(begun.move_mm), "yaw_deg": begun.yaw_deg}
        if begun and begun.move_mm
        else None,
        "grid": {
            "step_mm": grid.step_mm,
            **{name: list(getattr(grid, name)) for name in ("x_mm", "y_mm", "yaw_deg", "lift_mm")},
        },
        "counts": {
            "positions": len(positions),
            "admissible": sum(p.admissible for p in positions),
            "certified": sum(p.checked == "certified" for p in positions),
            "excluded_by_a_pose": sum(p.checked == "pose" for p in positions),
            "proved": sum(p.checked == "proved" for p in positions),
        },
        "cells": summary(found.squares),
        "positions": [asdict(p) for p in positions],
    }


def outline(problem: Problem) -> Iterator[tuple[str, Floats]]:
    """The four arcs of the planar workspace of the wrist centre, robot frame, each shape (n, 2), mm."""
    g = Placing(problem, Reserve(), roll=False).geometry
    for name, arc in zip(SIDES, g.arcs, strict=True):
        angles = arc.start + np.linspace(0.0, min(arc.span, 2.0 * math.pi), 181)
        points = np.stack((arc.x + arc.radius * np.cos(angles), arc.y + arc.radius * np.sin(angles)), axis=1)
        yield _named(name, g), points * (1.0, g.side)
