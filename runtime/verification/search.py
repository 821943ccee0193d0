"""Look for the smallest translation of the bone, on the poses alone.

Height and plane part: the slide needs a height within an interval, the plane a shift of all wrist
centres. Rings of growing radius find where a shift fits, a shrinking pattern then shortens it. Worst
poses stand for all of them; those that turn out worse are taken in. Nothing here is proof.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from runtime.kinematics.arm import TURN, elbow_angle, shoulder_offset
from runtime.verification.chain import BLOCK, sweep
from runtime.verification.geometry import VERTICAL, Geometry, canonical
from runtime.verification.points import Points, at_poses, join
from runtime.verification.problem import Problem
from runtime.workspace.distance import signed_sides
from runtime.workspace.planar import distance_to_arc

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SAMPLE = 160
DIRECTIONS = 48
GROWTH = 1.2
SMALLEST_RING_MM = 1.0
FINEST_MM = 0.02
ROUNDS = 6


def smallest_translation(problem: Problem, reserve_mm: float) -> Floats | None:
    """Smallest translation after which all poses keep their deadbands and a reserve.

    Args:
        problem: an inadmissible path, with usable numbers.
        reserve_mm: beyond the arm deadband.

    Returns:
        Shape (3,), robot frame, mm; None if none was found.
    """
    geometry, segments = canonical(problem)
    if geometry.workspace.empty:
        return None
    n = len(segments.tip)
    poses = join([at_poses(geometry, segments, slice(i, i + BLOCK)) for i in range(0, n, BLOCK)])
    lift = _height(geometry, poses, reserve_mm)
    if lift is None:
        return None
    centres = poses.centre - lift * geometry.tilt
    steps = sweep(poses.axis_xy[:-1], poses.axis_xy[1:])
    azimuth = poses.azimuth[0] + np.concatenate(([0.0], np.cumsum(steps)))
    rolling = problem.hold_roll is None or bool((np.sin(poses.pitch) >= VERTICAL).any())
    field = _Field(geometry, centres, azimuth if rolling else None, poses, reserve_mm)
    shift = field.smallest()
    if shift is None:
        return None
    return np.array((shift[0], geometry.side * shift[1], lift))


def _height(geometry: Geometry, poses: Points, reserve_mm: float) -> float | None:
    """The smallest lift that brings all heights into the slide's range."""
    keep = geometry.arm_mm + reserve_mm
    least = float(geometry.lower[2]) + keep - float(poses.height.min())
    most = float(geometry.upper[2]) - keep - float(poses.height.max())
    if not least <= most:
        return None
    return min(max(0.0, least), most)


class _Field:
    """How well a planar shift of all wrist centres fits, right elbow."""

    def __init__(
        self, geometry: Geometry, centres: Floats, azimuth: Floats | None, poses: Points, reserve_mm: float
    ) -> None:
        self.geometry = geometry
        self.centres = centres
        self.azimuth = azimuth
        self.widening = poses.widening
        self.reserve_mm = reserve_mm
        even = np.linspace(0, len(centres) - 1, min(SAMPLE, len(centres))).astype(np.int64)
        angles = np.arange(16) * TURN / 16
        extreme = np.argmax(centres @ np.stack((np.cos(angles), np.sin(angles))), axis=0)
        self.sample: Ints = np.unique(np.concatenate((even, extreme)))

    def smallest(self) -> Floats | None:
        """The smallest shift that fits all poses; poses that object are taken into the sample."""
        for _ in range(ROUNDS):
            shift = self._smallest_for_sample()
            if shift is None:
                return None
            margin, worst = self._margins(shift[None, :], np.arange(len(self.centres)))
            if margin[0] >= 0.0:
                return shift
            self.sample = np.unique(np.concatenate((self.sample, worst)))
        return None

    def _smallest_for_sample(self) -> Floats | None:
        starts = self._rings()
        if starts is None:
            return None
        found = [self._shorten(start) for start in starts]
        return min(found, key=lambda shift: math.hypot(*shift))

    def _rings(self) -> list[Floats] | None:
        """The first ring on which shifts fit, and a few of them, well apart."""
        zero = np.zeros((1, 2))
        if self._fits(zero)[0]:
            return [zero[0]]
        angles = np.arange(DIRECTIONS) * TURN / DIRECTIONS
        unit = np.stack((np.cos(angles), np.sin(angles)), axis=1)
        away = float(np.hypot(*self.centres.mean(axis=0)))
        radius = SMALLEST_RING_MM
        while radius <= away + self.geometry.workspace.a0 + self.geometry.workspace.a1:
            margin, _ = self._margins(radius * unit, self.sample)
            if (margin >= 0.0).any():
                order = np.argsort(-margin)[: DIRECTIONS // 8]
                return [radius * unit[i] for i in order if margin[i] >= 0.0]
            radius *= GROWTH
        return None

    def _shorten(self, shift: Floats) -> Floats:
        """Shorten a shift that fits: toward zero, and sideways along the edge of what fits."""
        step = max(math.hypot(*shift) / 4.0, FINEST_MM)
        angles = np.arange(16) * TURN / 16
        unit = np.stack((np.cos(angles), np.sin(angles)), axis=1)
        while step >= FINEST_MM:
            options = np.concatenate((shift + step * unit, shift + 0.5 * step * unit))
            length = np.hypot(options[:, 0], options[:, 1])
            shorter = options[length < math.hypot(*shift) - 1e-3 * step]
            fitting = shorter[self._fits(shorter)] if len(shorter) else shorter
            if len(fitting):
                shift = fitting[np.argmin(np.hypot(fitting[:, 0], fitting[:, 1]))]
            else:
                step /= 2.0
        return shift

    def _fits(self, shifts: Floats) -> NDArray[np.bool_]:
        margin, _ = self._margins(shifts, self.sample)
        return margin >= 0.0

    def _margins(self, shifts: Floats, rows: Ints) -> tuple[Floats, Ints]:
        """Worst margin beyond the deadband of each shift (k,), mm, and the worst poses of the first."""
        space = self.geometry.workspace
        points = (self.centres[rows][None, :, :] + shifts[:, None, :]).reshape(-1, 2)
        distances = np.stack([distance_to_arc(points, arc) for arc in self.geometry.arcs], axis=1)
        inside = space.inside(points)
        signed = signed_sides(distances, inside, full_turn=space.full_turn)[:, : 2 if space.full_turn else 4]
        arm = signed.min(axis=1).reshape(len(shifts), len(rows)) - self.geometry.arm_mm - self.reserve_mm
        worst = [rows[np.argmin(arm[0])]]
        margin = arm.min(axis=1)
        if self.azimuth is not None:
            roll = self._roll(points, rows, len(shifts))
            worst += [rows[np.argmin(roll[0])], rows[np.argmax(roll[0])]]
            margin = np.minimum(margin, self._roll_margin(roll))
        return np.where(np.isnan(margin), -np.inf, margin), np.array(worst)

    def _roll(self, points: Floats, rows: Ints, shifts: int) -> Floats:
        """Continuous roll at each pose for each shift, shape (shifts, rows)."""
        space = self.geometry.workspace
        r = np.hypot(points[:, 0], points[:, 1])
        elbow = elbow_angle(r, space.a0, space.a1)
        heading = np.arctan2(points[:, 1], points[:, 0]) - shoulder_offset(elbow, space.a0, space.a1) + elbow
        azimuth = self.azimuth[rows] if self.azimuth is not None else np.zeros(len(rows))
        return azimuth - np.unwrap(heading.reshape(shifts, len(rows)), axis=1)

    def _roll_margin(self, roll: Floats) -> Floats:
        """Margin of the roll range in its best turn beyond the deadband, as an arc of the forearm, mm."""
        g = self.geometry
        lower, upper = float(g.lower[3]), float(g.upper[3])
        spare = self.widening[np.isfinite(self.widening)].max(initial=0.0)
        least, most = roll.min(axis=1) - spare, roll.max(axis=1) + spare
        shift = TURN * np.rint(((lower + upper) - (least + most)) / (2.0 * TURN))
        margin = np.minimum(least + shift - lower, upper - most - shift) - g.wrist_rad
        out: Floats = margin * g.workspace.a1 - self.reserve_mm
        return out
