"""The quantities that are compared with their deadbands, and the form in which people read them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cutgate.protocol.arrays import Floats
from cutgate.runtime.kinematics.pose import dot, lengths
from cutgate.runtime.verification.bounds.chain import BLOCK
from cutgate.runtime.verification.bounds.closed_form import Extreme, Extremes
from cutgate.runtime.verification.bounds.enclosures import ACCELERATION, SPEED
from cutgate.runtime.verification.bounds.geometry import VERTICAL, Geometry, Segments, errors
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.verdict import (
    BOUNDARIES,
    Boundary,
    Evaluations,
    Method,
    Quantity,
    SpeedLine,
    Unit,
    Verdict,
)
from cutgate.runtime.workspace.planar import SIDES

GAUSS_LEGENDRE = (
    (-0.8611363115940526, 0.3478548451374538),
    (-0.3399810435848563, 0.6521451548625461),
    (0.3399810435848563, 0.6521451548625461),
    (0.8611363115940526, 0.3478548451374538),
)
"""Nodes and weights of four points on -1..1."""


@dataclass(frozen=True, slots=True)
class Enclosed:
    """One enclosed quantity in mm or rad; infinite where undefined."""

    attained: float
    certified: float
    segment: int
    fraction: float


def boundary(
    name: str, value: Enclosed | None, arm_mm: float, wrist_rad: float, tip_at: Floats | tuple[()]
) -> Boundary:
    """Bring an enclosed value into the form people read: mm or deg, null where undefined.

    Args:
        name: the boundary.
        value: enclosed quantity, mm or rad, or None if undefined.
        arm_mm: deadband of the arm.
        wrist_rad: deadband of the wrist.
        tip_at: tip path length at each pose, mm.
    """
    angular = name not in {*SIDES, "top", "bottom"}
    deadband = math.degrees(wrist_rad) if angular else arm_mm
    unit: Unit = "deg" if angular else "mm"
    if value is None or not (math.isfinite(value.certified) and math.isfinite(value.attained)):
        return Boundary(name, unit, None, None, None, None, None, deadband, violated=True)
    scale = 180.0 / math.pi if angular else 1.0
    i, s = value.segment, value.fraction
    along = float(tip_at[i] + s * (tip_at[i + 1] - tip_at[i]))
    clearance, certified = value.attained * scale, value.certified * scale
    return Boundary(
        name, unit, clearance, certified, i, s, along, deadband, violated=not certified >= deadband
    )


def rates(problem: Problem) -> list[tuple[Quantity, int, Floats]]:
    """What is limited at the planned feed: quantity, first column of its joints, limits (5,)."""
    out: list[tuple[Quantity, int, Floats]] = [("speed", SPEED, problem.speed)]
    if problem.acceleration is not None:
        out.append(("acceleration", ACCELERATION, problem.acceleration))
    return out


def held_roll(problem: Problem, limits: Extremes) -> float | None:
    """The roll at which a tool that stays exactly vertical is held, where the robot declares one."""
    upright = limits.most_pitch.value < VERTICAL or limits.least_pitch.value > math.pi - VERTICAL
    return problem.hold_roll if upright else None


def azimuth_defined(limits: Extremes) -> bool:
    """Whether the axis is nowhere vertical, so that its azimuth is defined."""
    return limits.least_pitch.value > VERTICAL and limits.most_pitch.value < math.pi - VERTICAL


def slide_and_pitch(geometry: Geometry, limits: Extremes, held: float | None) -> dict[str, Enclosed]:
    """Distances of slide and pitch to their limits, in closed form, rad and mm.

    Args:
        geometry: canonical arm.
        limits: extremes of height and pitch over the path.
        held: roll of a tool held vertical; the singularity and a lower pitch limit of zero then do not count.
    """
    lowest, highest, least, most = limits.lowest, limits.highest, limits.least_pitch, limits.most_pitch
    singular = least if least.value <= math.pi - most.value else most

    def value(attained: float, pad: float, place: Extreme) -> Enclosed:
        return Enclosed(float(attained), float(attained - pad), place.segment, place.fraction)

    values = {
        "top": value(geometry.upper[2] - highest.value, limits.pad_mm, highest),
        "bottom": value(lowest.value - geometry.lower[2], limits.pad_mm, lowest),
        "pitch_min": value(least.value - geometry.lower[4], limits.pad_rad, least),
        "pitch_max": value(geometry.upper[4] - most.value, limits.pad_rad, most),
        "wrist_singularity": value(min(least.value, math.pi - most.value), limits.pad_rad, singular),
    }
    if held is not None:
        del values["wrist_singularity"]
        if geometry.lower[4] <= 0.0:
            del values["pitch_min"]
    return values


def refused(problem: Problem, wrong: tuple[str, ...], method: Method) -> Verdict:
    """The verdict on a problem whose numbers cannot be verified: every boundary undefined, hence violated."""
    arm, wrist = np.add(errors(problem), (problem.deadband.arm_mm, problem.deadband.wrist_rad)).tolist()
    nothing = {name: boundary(name, None, arm, wrist, ()) for name in BOUNDARIES}
    unknown = {
        quantity: tuple(
            SpeedLine(j, float(limit), None, None, False, quantity) for j, limit in enumerate(limits)
        )
        for quantity, _, limits in rates(problem)
    }
    return Verdict(
        method=method,
        admissible=False,
        tip_length_mm=0.0,
        wrist_length_mm=0.0,
        axis_angle_rad=0.0,
        deadband_arm_mm=arm,
        deadband_wrist_rad=wrist,
        branch=None,
        evaluations=Evaluations(0, 0, 0),
        boundaries=nothing,
        speed=unknown["speed"],
        acceleration=unknown.get("acceleration", ()),
        reasons=wrong,
    )


def wrist_length(segments: Segments, tool_mm: float) -> float:
    """Length of the wrist-centre path, mm, by four-point Gauss-Legendre per segment, `BLOCK` at a time."""
    parts = (slice(i, i + BLOCK) for i in range(0, len(segments), BLOCK))
    return sum(_wrist_length(segments, part, tool_mm) for part in parts)


def wrist_lengths(segments: Segments, tool_mm: float) -> Floats:
    """The same of each segment, mm, shape (n,)."""
    parts = (slice(i, i + BLOCK) for i in range(0, len(segments), BLOCK))
    return np.concatenate(
        [
            sum((weight * found for weight, found in _wrist_steps(segments, part, tool_mm)), 0.0)
            for part in parts
        ]
    )


def _wrist_length(segments: Segments, part: slice, tool_mm: float) -> float:
    """Of some segments."""
    total = 0.0
    for weight, found in _wrist_steps(segments, part, tool_mm):
        total += weight * float(found.sum())
    return total


def _wrist_steps(segments: Segments, part: slice, tool_mm: float) -> Iterator[tuple[float, Floats]]:
    """Weights, and how far the wrist centre would go in each of some segments at the rate it has at one node, mm.

    With u and v the axes at the ends of one, the axis turned by phi changes by (cos(phi) v - cos(theta - phi) u) / sin(theta).
    """
    theta = segments.theta[part]
    after = slice(part.start + 1, part.start + len(theta) + 1)
    step = segments.tip[after] - segments.tip[part.start : after.stop - 1]
    if not theta.any():
        yield 1.0, lengths(step)
        return
    sine = np.where(theta > 0.0, np.sin(theta), 1.0)
    steady = dot(step, step) + (tool_mm * theta) ** 2
    along_u, along_v = dot(step, segments.axis[part.start : after.stop - 1]), dot(step, segments.axis[after])
    turned = [np.cos((node + 1.0) / 2.0 * theta) for node, _ in GAUSS_LEGENDRE]
    double = 2.0 * tool_mm * theta / sine
    for (_, weight), phi, rest in zip(GAUSS_LEGENDRE, turned, reversed(turned), strict=True):
        square = steady + double * (phi * along_v - rest * along_u)
        yield weight / 2.0, np.sqrt(np.maximum(square, 0.0))
