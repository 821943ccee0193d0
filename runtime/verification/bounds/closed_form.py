"""Slide and pitch: their extremes over a segment are closed form, nothing is bisected.

With theta s = phi, the height is ``z = p_z + s dp_z + l (u_z cos phi + v_z sin phi)`` and the pitch that
of the great circle; both have their extremes at the ends or where a sine takes a known value.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cutgate.protocol.arrays import Bools, Floats, Ints
from cutgate.runtime.kinematics.pose import slerp
from cutgate.runtime.verification.bounds.geometry import EPSILON, Geometry, Segments

PITCH_PAD = 1e-11
"""Bound on the rounding of the smallest pitch m, rad. Within theta of its place the axes' horizontal parts, of which
the place is computed (`_peak`), are at most m + theta, so it is known to some epsilon (m + theta)^2 / theta and lies
within theta: that changes m by at most some epsilon (m + theta), whatever m is."""


@dataclass(frozen=True, slots=True)
class Extreme:
    """A smallest or largest value of the path and its place."""

    value: float
    segment: int
    fraction: float


@dataclass(frozen=True, slots=True)
class Extremes:
    """Height (mm) and pitch (rad) over the whole path, with the bound on their rounding."""

    lowest: Extreme
    highest: Extreme
    least_pitch: Extreme
    most_pitch: Extreme
    pad_mm: float
    pad_rad: float


def extremes(geometry: Geometry, segments: Segments, height: Floats, pitch: Floats) -> Extremes:
    """Find the extremes of height and pitch.

    Args:
        geometry: canonical arm.
        segments: the path, n segments.
        height: of the wrist centre at the poses, shape (n + 1,).
        pitch: q4 there, shape (n + 1,).
    """
    theta, up = segments.theta, segments.axis[:, 2]
    at: Ints = np.flatnonzero(theta > 0.0)
    fraction = heights = pitches = np.zeros(0)
    if len(at):
        square = theta * theta * 0.125
        # the vertical part of the axis leaves its chord by no more than the axis does
        exceed = _may_exceed(height, geometry.tool_mm * square + geometry.pad_mm) | _may_exceed(
            up, square + 8.0 * EPSILON
        )
        rows = np.flatnonzero((theta > 0.0) & exceed)
        at, fraction = np.tile(rows, 4), np.concatenate(_critical(geometry, segments, rows))
        inner = np.flatnonzero((fraction > 0.0) & (fraction < 1.0))
        at, fraction = at[inner], fraction[inner]
        heights, pitches = _evaluated(geometry, segments, at, fraction)

    def extreme(of_poses: Floats, between: Floats, sign: float) -> Extreme:
        pose = int(np.argmin(sign * of_poses))
        last = len(segments) - 1
        best = Extreme(float(of_poses[pose]), min(pose, last), float(max(pose - last, 0)))
        if len(between):
            i = int(np.argmin(sign * between))
            if sign * between[i] < sign * best.value:
                return Extreme(float(between[i]), int(at[i]), float(fraction[i]))
        return best

    return Extremes(
        lowest=extreme(height, heights, 1.0),
        highest=extreme(height, heights, -1.0),
        least_pitch=extreme(pitch, pitches, 1.0),
        most_pitch=extreme(pitch, pitches, -1.0),
        pad_mm=geometry.pad_mm,
        pad_rad=PITCH_PAD,
    )


def _may_exceed(values: Floats, most: Floats) -> Bools:
    """Segments that may go beyond what all poses have, as they leave the values at their ends by this at most."""
    low, high = np.minimum(values[1:], values[:-1]), np.maximum(values[1:], values[:-1])
    out: Bools = (low - most <= values.min()) | (high + most >= values.max())
    return out


def _evaluated(geometry: Geometry, segments: Segments, rows: Ints, s: Floats) -> tuple[Floats, Floats]:
    """Height and pitch at fractions of segments."""
    tip = segments.tip[rows, 2]
    tip = tip + s * (segments.tip[rows + 1, 2] - tip)
    axis = slerp(segments.axis[rows], segments.axis[rows + 1], segments.theta[rows], s)
    sine = np.hypot(axis[:, 0], axis[:, 1])
    return tip + geometry.tool_mm * axis[:, 2], np.arctan2(sine, axis[:, 2])


def _critical(geometry: Geometry, segments: Segments, rows: Ints) -> list[Floats]:
    """Fractions where z' = 0 (two) and where the great circle is highest and lowest."""
    theta = segments.theta[rows]
    u, v = segments.axis[rows], segments.axis[rows + 1]
    tangent = (v - np.cos(theta)[:, None] * u) / np.sin(theta)[:, None]
    peak = _peak(u, tangent)
    rise = segments.tip[rows + 1, 2] - segments.tip[rows, 2]
    swing = geometry.tool_mm * theta * np.hypot(u[:, 2], tangent[:, 2])
    with np.errstate(divide="ignore", invalid="ignore"):
        sine = np.arcsin(rise / swing)  # NaN where the height is monotone
    angles = (peak + sine, peak + np.pi - sine, peak, peak + np.pi)
    return [np.mod(angle, 2.0 * np.pi) / theta for angle in angles]


def _peak(u: Floats, tangent: Floats) -> Floats:
    """Angle from u along its great circle to where that is highest: cos and sin as u_z to t_z.

    Near the vertical t_z is nothing but rounding; there it comes of the horizontal parts, as u.t = 0.
    """
    level = np.einsum("ij,ij->i", u[:, :2], tangent[:, :2])
    steep = np.abs(u[:, 2]) > 0.5
    rise = np.where(steep, -level / np.where(steep, u[:, 2], 1.0), tangent[:, 2])
    out: Floats = np.arctan2(rise, u[:, 2])
    return out
