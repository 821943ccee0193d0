"""Which way the bone must move: a hint for each boundary, and one combined, verified translation.

A hint cures the worst place of one boundary to first order; it says nothing of the rest of the path. The
combined translation is searched on the poses alone, by arithmetic that proves nothing, and is then
shown only with what the certified method says of the moved and re-quantised path.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from runtime.verification import certified
from runtime.verification.defects import defects
from runtime.verification.geometry import Geometry, canonical
from runtime.verification.points import Points, at
from runtime.verification.problem import Problem
from runtime.verification.search import smallest_translation
from runtime.verification.verdict import Boundary, Verdict
from runtime.workspace.planar import SIDES, nearest_on_arc

Floats = NDArray[np.float64]
Vector = tuple[float, float, float]
Quantise = Callable[[Floats, Floats], tuple[Floats, Floats]]

RESERVES_MM = (0.2, 0.5, 2.0)
"""Beyond the deadband the moved path keeps this; the next is tried where the certified method says no."""

RESERVE_DEG = 0.1
"""The same for turns."""

STEP_MM = 0.1
"""Translations are shown, and verified, in whole steps of this."""

ON_THE_ARC_MM = 1e-6
"""Nearer than this the difference to the arc has no direction."""

_NOT_CURED = ("pitch_min", "pitch_max", "wrist_singularity")


@dataclass(frozen=True, slots=True)
class Move:
    """First-order cure of one boundary's worst place alone."""

    boundary: str
    kind: Literal["move", "turn"]
    direction: Vector
    distance_mm: float | None = None
    angle_deg: float | None = None


@dataclass(frozen=True, slots=True)
class Guidance:
    """One combined move of the bone, in the robot frame.

    ``translation_mm`` is None when no translation was found; ``verified`` is True only if the
    moved and re-quantised path was admitted by the certified method.
    """

    translation_mm: Vector | None
    yaw_deg: float
    pivot_mm: Vector
    moves: tuple[Move, ...]
    predicted_clearance_mm: float | None
    verified: bool
    text: str


def guide(problem: Problem, verdict: Verdict, quantise: Quantise) -> Guidance | None:
    """Say how to move the bone so that an inadmissible path becomes admissible.

    Args:
        problem: what was verified.
        verdict: the certified method's answer to it.
        quantise: what the wire does to poses, (tips, axes) -> (tips, axes).

    Returns:
        None where there is nothing to cure, or where the numbers themselves are unfit.
    """
    if verdict.admissible or defects(problem):
        return None
    geometry, segments = canonical(problem)
    moves = []
    for b in verdict.boundaries.values():
        if b.violated and b.clearance is not None and b.segment is not None and b.fraction is not None:
            place = at(geometry, segments, np.array([b.segment]), np.array([b.fraction]))
            moves.append(_hint(geometry, b, place))
    translation, clearance, text = _combined(problem, verdict, quantise)
    x, y, z = (float(v) for v in problem.tips_mm.mean(axis=0))
    return Guidance(
        translation_mm=translation,
        yaw_deg=0.0,
        pivot_mm=(x, y, z),
        moves=tuple(moves),
        predicted_clearance_mm=clearance,
        verified=translation is not None,
        text=text,
    )


def _combined(
    problem: Problem, verdict: Verdict, quantise: Quantise
) -> tuple[Vector | None, float | None, str]:
    """The smallest translation found that the certified method admits, its clearance, and a sentence."""
    fixed = [name for name in _NOT_CURED if name in verdict.boundaries and verdict.boundaries[name].violated]
    if fixed:
        return None, None, f"no translation changes {', '.join(fixed)}: tilt the registration"
    for reserve in RESERVES_MM:
        found = smallest_translation(problem, reserve)
        if found is None:
            break
        shift = np.round(np.round(found / STEP_MM) * STEP_MM, 3)
        tips, axes = quantise(problem.tips_mm + shift, problem.axes)
        moved = certified.verify(replace(problem, tips_mm=tips, axes=axes, branch=None))
        if moved.admissible:
            least = min(
                b.certified for b in moved.boundaries.values() if b.unit == "mm" and b.certified is not None
            )
            x, y, z = (round(float(v), 3) for v in shift)
            beyond = least - moved.deadband_arm_mm
            return (
                (x, y, z),
                least,
                f"the whole moved path keeps at least {beyond:.2f} mm beyond the arm deadband",
            )
    return (
        None,
        None,
        "no translation found that makes the whole path admissible: turn the bone, or part the path",
    )


def _hint(geometry: Geometry, b: Boundary, place: Points) -> Move:
    """Direction and amount for one boundary's worst place, in the robot frame."""
    lacking = max(b.deadband - (b.clearance or 0.0), 0.0)
    if b.name in SIDES:
        return Move(b.name, "move", _away(geometry, b, place), distance_mm=lacking + RESERVES_MM[0])
    if b.name in {"top", "bottom"}:
        up = 1.0 if b.name == "bottom" else -1.0
        return Move(b.name, "move", (0.0, 0.0, up), distance_mm=lacking + RESERVES_MM[0])
    return Move(b.name, "turn", _turn(geometry, b.name, place), angle_deg=lacking + RESERVE_DEG)


def _away(geometry: Geometry, b: Boundary, place: Points) -> Vector:
    """Away from the nearest place of the arc; toward it from outside."""
    mirrored = {"left": "right", "right": "left"}
    name = mirrored.get(b.name, b.name) if geometry.side < 0 else b.name
    arc = geometry.arcs[SIDES.index(name)]
    inward = place.centre[0] - nearest_on_arc(place.centre, arc)[0]
    if (b.clearance or 0.0) < 0.0:
        inward = -inward
    length = math.hypot(*inward)
    if not length > ON_THE_ARC_MM:  # on the arc itself: along its radius, inward for the right elbow
        outward = place.centre[0] - (arc.x, arc.y)
        inward = outward if name in {"inner", "right"} else -outward
        length = max(math.hypot(*inward), ON_THE_ARC_MM)
    return (float(inward[0] / length), geometry.side * float(inward[1] / length), 0.0)


def _turn(geometry: Geometry, name: str, place: Points) -> Vector:
    """Axis of a turn: the vertical for the roll, the horizontal across the tool for the pitch."""
    if name.startswith("roll"):
        return (0.0, 0.0, 1.0 if name == "roll_min" else -1.0)
    azimuth = geometry.side * float(place.azimuth[0])
    more = name == "pitch_min" or (name == "wrist_singularity" and float(place.pitch[0]) < math.pi / 2.0)
    sign = 1.0 if more else -1.0
    return (-sign * math.sin(azimuth), sign * math.cos(azimuth), 0.0)
