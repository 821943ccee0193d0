"""Where the bone could stand: the smallest margin of the whole path over a grid of bone positions.

A position is the new registration ``Trans(x, y, lift) * Rz(yaw about pivot) * R_T_CT``. It counts as
admissible only if the certified method admits the moved and re-quantised path. Positions at which one pose
alone is proved to violate the arm or the slide are excluded without it: that is what makes the map fast.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, Literal

import numpy as np

from cutgate.protocol.arrays import Floats, Vector
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.bounds.geometry import MIRRORED_SIDES
from cutgate.runtime.verification.placing.freedom import Placing, Reserve
from cutgate.runtime.verification.placing.guidance import Quantise, guide, moved, pivot_of, unchanged_by_moves
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.verdict import Boundary, Verdict
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

    def __len__(self) -> int:
        return len(self.x_mm) * len(self.y_mm) * len(self.yaw_deg) * len(self.lift_mm)


@dataclass(frozen=True, slots=True)
class Position:
    """One position of the bone and what decides there.

    Attributes:
        x_mm, y_mm, yaw_deg, lift_mm: the move of the registration, robot frame.
        admissible: whether the certified method admits the moved path.
        checked: by ``certified``, or excluded by one ``pose``, which is proof enough that it is inadmissible.
        limiting: boundary with the smallest clearance per deadband, or ``speed_qN``.
        unit: mm or deg, or that of the joint's speed.
        clearance: of that boundary, proven; attained at a pose where that excludes; None if undefined.
            For a speed or acceleration the largest one on the path.
        bound: the deadband to be kept, or the speed not to be exceeded.
        ratio: clearance per deadband, or limit per speed; at least 1 where admissible; None if undefined.
    """

    x_mm: float
    y_mm: float
    yaw_deg: float
    lift_mm: float
    admissible: bool
    checked: Literal["certified", "pose"]
    limiting: str
    unit: str
    clearance: float | None
    bound: float
    ratio: float | None


RATES: Final = ("speed", "acceleration")
"""Limiting names that begin so are rates: the largest one of a joint, where less is better."""

COLUMNS: Final = tuple(Position.__dataclass_fields__)
"""Of the CSV file and of each position in the JSON document."""


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


def excluded(problem: Problem, grid: Grid, yaw_deg: float, lift_mm: float) -> list[Position | Vector]:
    """All displacements of one yaw and lift: judged where one pose excludes them, else still to be judged.

    Returns:
        For each displacement, rows of y and in them x, its position, or ``(x, y, lift)`` where it is open.
    """
    placing = _placing(problem, yaw_deg)
    g = placing.geometry
    x, y = (v.ravel() for v in np.meshgrid(grid.x_mm, grid.y_mm))
    shifts = np.stack((x, g.side * y), axis=1) - lift_mm * g.tilt
    low, high = placing.lift_mm
    slide, short = max((("bottom", low - lift_mm), ("top", lift_mm - high)), key=lambda end: end[1])
    blocks = [placing.nearest_sides(shifts[i : i + BLOCK]) for i in range(0, len(shifts), BLOCK)]
    clearance, side = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    out: list[Position | Vector] = []
    for i in range(len(x)):
        name, least = SIDES[side[i]], float(clearance[i])
        name = MIRRORED_SIDES.get(name, name) if g.side < 0.0 else name
        if placing.keep_mm - short < least:
            name, least = slide, placing.keep_mm - short
        if least < placing.keep_mm - placing.pad_mm:
            ratio = least / placing.keep_mm
            where = (float(x[i]), float(y[i]), yaw_deg, lift_mm)
            out.append(Position(*where, False, "pose", name, "mm", least, placing.keep_mm, ratio))
        else:
            out.append((float(x[i]), float(y[i]), lift_mm))
    return out


def judged(problem: Problem, quantise: Quantise, yaw_deg: float, translation_mm: Vector) -> Position:
    """One position by the certified method, on the moved and re-quantised path."""
    path = moved(problem, yaw_deg, pivot_of(problem), translation_mm)
    tips, axes = quantise(path.tips_mm, path.axes)
    verdict = certified.verify(replace(path, tips_mm=tips, axes=axes, branch=None))
    x, y, lift = translation_mm
    return _position((x, y, yaw_deg, lift), verdict)


def _position(where: tuple[float, float, float, float], verdict: Verdict) -> Position:
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
        )
    known = worst.certified is not None
    return Position(
        *where, verdict.admissible, "certified", worst.name, worst.unit, worst.certified, worst.deadband,
        _ratio(worst) if known else None,
    )  # fmt: skip


def _ratio(boundary: Boundary) -> float:
    """Clearance per deadband, to compare over units; undefined ones last."""
    return math.inf if boundary.certified is None else boundary.certified / boundary.deadband


def reach_document(
    problem: Problem,
    grid: Grid,
    positions: Sequence[Position],
    made_for: dict[str, Any],
    begun: GridStart | None = None,
) -> dict[str, Any]:
    """The map as one JSON document, ``cutgate.reach/1``.

    Args:
        problem: the path where the bone stands now.
        grid: what was asked.
        positions: all of it.
        made_for: plan, robot, registration and digests.
        begun: what chose the height; None where it was asked for.
    """
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
        },
        "positions": [asdict(p) for p in positions],
    }


def outline(problem: Problem) -> Iterator[tuple[str, Floats]]:
    """The four arcs of the planar workspace of the wrist centre, robot frame, each shape (n, 2), mm."""
    g = Placing(problem, Reserve(), roll=False).geometry
    for name, arc in zip(SIDES, g.arcs, strict=True):
        angles = arc.start + np.linspace(0.0, min(arc.span, 2.0 * math.pi), 181)
        points = np.stack((arc.x + arc.radius * np.cos(angles), arc.y + arc.radius * np.sin(angles)), axis=1)
        yield MIRRORED_SIDES.get(name, name) if g.side < 0.0 else name, points * (1.0, g.side)
