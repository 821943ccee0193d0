"""Slide and pitch: their extremes over a segment are closed form, nothing is bisected.

With theta s = phi, the height is ``z = p_z + s dp_z + l (u_z cos phi + v_z sin phi)`` and the pitch that
of the great circle; both have their extremes at the ends or where a sine takes a known value.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cutgate.protocol.arrays import Floats, Ints
from cutgate.runtime.verification.bounds.geometry import Geometry, Segments
from cutgate.runtime.verification.bounds.points import Points, at

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


def extremes(geometry: Geometry, segments: Segments, poses: Points) -> Extremes:
    """Find the extremes of height and pitch.

    Args:
        geometry: canonical arm.
        segments: the path, n segments.
        poses: the n + 1 evaluated poses.
    """
    height, pitch = poses.height, poses.pitch
    bulge = geometry.tool_mm * segments.theta**2 / 8.0 + geometry.pad_mm
    low, high = np.minimum(height[:-1], height[1:]) - bulge, np.maximum(height[:-1], height[1:]) + bulge
    swing = segments.theta / 2.0
    mean = (pitch[:-1] + pitch[1:]) / 2.0
    turning = segments.theta > 0.0
    rows = np.flatnonzero(
        turning
        & (
            (low < height.min())
            | (high > height.max())
            | (mean - swing <= pitch.min())
            | (mean + swing >= pitch.max())
        )
    )
    numbers = np.minimum(np.arange(len(height)), len(segments) - 1)
    segment = [numbers]
    fraction = [np.arange(len(height)) - numbers + 0.0]
    heights, pitches = [height], [pitch]
    for s in _critical(geometry, segments, rows):
        inner = np.flatnonzero((s > 0.0) & (s < 1.0))
        points = at(geometry, segments, rows[inner], s[inner])
        segment.append(rows[inner])
        fraction.append(s[inner])
        heights.append(points.height)
        pitches.append(points.pitch)
    where, place = np.concatenate(segment), np.concatenate(fraction)
    z, q4 = np.concatenate(heights), np.concatenate(pitches)

    def extreme(values: Floats, index: np.intp) -> Extreme:
        return Extreme(float(values[index]), int(where[index]), float(place[index]))

    return Extremes(
        lowest=extreme(z, np.argmin(z)),
        highest=extreme(z, np.argmax(z)),
        least_pitch=extreme(q4, np.argmin(q4)),
        most_pitch=extreme(q4, np.argmax(q4)),
        pad_mm=geometry.pad_mm,
        pad_rad=PITCH_PAD,
    )


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
