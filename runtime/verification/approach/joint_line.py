"""A joint line: all joints linear in one parameter, decided for all its points."""

from __future__ import annotations

import math
from typing import Final, Literal

import numpy as np

from cutgate.protocol.arrays import Floats
from cutgate.protocol.parameters import ROTATION_DEG_STANDS
from cutgate.runtime.verification.approach.curve import Curve, Least, enclose
from cutgate.runtime.verification.approach.model import LegName, LegVerdict, StartJoints
from cutgate.runtime.verification.approach.sentences import outside_of_limits, shortfall
from cutgate.runtime.verification.bounds.enclosures import HALF_TURN
from cutgate.runtime.verification.bounds.geometry import EPSILON, MIRRORED, ROUNDINGS, Geometry
from cutgate.runtime.verification.branch import goes
from cutgate.runtime.verification.steps import Steps
from cutgate.runtime.verification.verdict import Boundary
from cutgate.runtime.workspace.planar import SIDES

AT_END: Final = 1e-6
"""A worst place so near to an end of its line is that end's."""


def joint_line(
    geometry: Geometry, start: StartJoints, name: LegName, pose: Floats, *, roll_held: bool
) -> Steps[LegVerdict]:
    """Decide the line between the start joints and a pose's joints.

    Args:
        geometry: of the cut.
        start: where the arm stands, and how far from there it may begin.
        name: ``approach`` begins at the start joints, ``retract`` ends there.
        pose: reported joints of entry or exit, shape (5,).
        roll_held: whether the cut holds a declared roll.
    """
    reported = np.stack((start.joints, pose) if name == "approach" else (pose, start.joints))
    line = reported * geometry.signs + geometry.offset
    lower, upper = _limits(geometry)
    inside = bool(((lower <= line) & (line <= upper)).all()) and not geometry.workspace.empty
    values = _linear(geometry, line)
    if roll_held and geometry.lower[4] <= 0.0:  # as for the cut: below a vertical tool there is no stop
        del values["pitch_min"]
    if inside:
        values |= yield from _sides(geometry, line, geometry.arm_mm + start.tolerance_mm)
    undefined: dict[str, Least | None] = {} if inside else dict.fromkeys(SIDES)
    boundaries = {}
    for source, least in {**undefined, **values}.items():
        shown = MIRRORED.get(source, source) if geometry.side < 0.0 else source
        boundaries[shown] = _boundary(shown, least, geometry, start)
    outside = [] if inside else outside_of_limits(geometry, line, lower, upper)
    reasons = [text for _, text in outside]
    reasons += [shortfall(b, name) for b in boundaries.values() if b.violated]
    return LegVerdict(name, boundaries, tuple(reasons), _of_the_start(name, boundaries, outside))


def _limits(geometry: Geometry) -> tuple[Floats, Floats]:
    """Where both joints of a line must lie, true and canonical: then all of the line does."""
    lower, upper = geometry.lower.copy(), geometry.upper.copy()
    lower[1], upper[1] = geometry.workspace.q1_lo, geometry.workspace.q1_hi
    for joint in (0, 3):  # where a joints frame can carry them
        low, high = goes(geometry, joint, ROTATION_DEG_STANDS)
        lower[joint], upper[joint] = max(lower[joint], low), min(upper[joint], high)
    return lower, upper


def _of_the_start(
    name: LegName, boundaries: dict[str, Boundary], outside: list[tuple[int, str]]
) -> frozenset[str]:
    """Those of a leg's sentences that speak of the start joints."""
    start = 0 if name == "approach" else 1
    found = {text for end, text in outside if end == start}
    alone = len(found) == len(outside)  # else what is not defined is not for its sake alone
    found |= {
        shortfall(b, name)
        for b in boundaries.values()
        if b.violated and (alone if b.fraction is None else abs(b.fraction - start) <= AT_END)
    }
    return frozenset(found)


def _linear(geometry: Geometry, line: Floats) -> dict[str, Least]:
    """Slide, roll and pitch: the range of a linear joint is that of its ends."""
    found = {}
    for joint, low, high in (
        (2, "bottom", "top"),
        (3, "roll_min", "roll_max"),
        (4, "pitch_min", "pitch_max"),
    ):
        value = line[:, joint]
        pad = geometry.pad_mm if joint == 2 else ROUNDINGS * EPSILON * (8.0 + float(np.abs(value).max()))
        for side, margin in ((low, value - geometry.lower[joint]), (high, geometry.upper[joint] - value)):
            at = int(np.argmin(margin))
            found[side] = Least(float(margin[at]), float(margin[at]) - pad, float(at))
    return found


def _sides(geometry: Geometry, line: Floats, target_mm: float) -> Steps[dict[str, Least]]:
    """Distance to the four arcs; from a full turn on a limit's arc counts within half a turn of the limit."""
    curve = Curve.of(geometry, line)
    parts: dict[str, tuple[float, float] | None] = dict.fromkeys(SIDES, (0.0, 1.0))
    if geometry.workspace.full_revolution:
        parts["left"] = _part_above(line[:, 0], float(geometry.upper[0]) - HALF_TURN)
        parts["right"] = _part_above(-line[:, 0], -float(geometry.lower[0]) - HALF_TURN)
    found = {}
    for (name, part), arc in zip(parts.items(), geometry.arcs, strict=True):
        if part is not None:
            concentric = name in {"inner", "outer"}
            found[name] = yield from enclose(curve, arc, part, target_mm, concentric=concentric)
    return found


def _part_above(ends: Floats, bound: float) -> tuple[float, float] | None:
    """Where a linear quantity with these ends (2,) is at least the bound; None where nowhere."""
    first, last = float(ends[0]), float(ends[1])
    if min(first, last) >= bound:
        return 0.0, 1.0
    if not max(first, last) >= bound:
        return None
    crossing = (bound - first) / (last - first)
    return (crossing, 1.0) if last > first else (0.0, crossing)


def _boundary(name: str, least: Least | None, geometry: Geometry, start: StartJoints) -> Boundary:
    """In mm or deg; undefined, hence violated, where nothing was enclosed."""
    angular = name.startswith(("roll", "pitch"))
    unit: Literal["mm", "deg"] = "deg" if angular else "mm"
    scale = math.degrees(1.0) if angular else 1.0
    kept = geometry.wrist_rad + start.tolerance_rad if angular else geometry.arm_mm + start.tolerance_mm
    deadband = kept * scale
    if least is None or not (math.isfinite(least.attained) and math.isfinite(least.certified)):
        return Boundary(name, unit, None, None, None, None, None, deadband, violated=True)
    clearance, proven = least.attained * scale, least.certified * scale
    return Boundary(
        name, unit, clearance, proven, None, least.fraction, None, deadband, violated=not proven >= deadband
    )
