"""Arcs and helices as chords, each no further off than a tolerance."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from cutgate.protocol.arrays import Floats

RADIUS_MM: Final = 0.02
"""Start and end of an arc may be this far from one circle: files round coordinates."""
RADIUS_MAX_MM: Final = 1e6


class CircleError(ValueError):
    """No arc: what was found, and what would be one."""

    def __init__(self, found: str, bound: str) -> None:
        super().__init__(f"{found}, must be {bound}")
        self.found = found
        self.bound = bound


@dataclass(frozen=True, slots=True)
class CircularMove:
    """From ``start`` to ``end`` about an axis, counter-clockwise seen against its normal; along it at a constant rate.

    Attributes:
        start, end, centre: mm; the centre may lie anywhere on the axis.
        normal: unit, right-handed.
        turns: whole turns beyond the first arrival at ``end``.
        whole: where start and end are the same point of the circle: a whole turn instead of none.
    """

    start: Floats
    end: Floats
    centre: Floats
    normal: Floats
    turns: int = 0
    whole: bool = True

    def chords(self, tolerance_mm: float, most: int) -> tuple[Floats, float]:
        """Points that follow ``start``, the last of them ``end`` itself, and how far the arc is from their chords.

        A chord over an angle d is off the circle by ``r (1 - cos(d / 2))``; where radius and height change at a
        constant rate on the way, points of the same angle differ by no more, since the chord is linear in both.
        A difference of the two radii is part of what is returned.

        Args:
            tolerance_mm: of each chord.
            most: so many points at most.

        Returns:
            Shape (n, 3) mm, and mm.

        Raises:
            CircleError: no circle goes through start and end, or more points than ``most``.
        """
        u, v, radii = self._frame()
        radius, off = float(max(radii)), float(abs(radii[0] - radii[1]))
        if not (0.0 < radius <= RADIUS_MAX_MM):
            raise CircleError(f"radius {radius:.6g} mm", f"over 0 and at most {RADIUS_MAX_MM:g} mm")
        if not (off <= RADIUS_MM):
            found = f"{radii[0]:.6g} mm from the centre at its start and {radii[1]:.6g} mm at its end"
            raise CircleError(found, f"the same within {RADIUS_MM:g} mm")
        sweep = self._sweep(u, v)
        step = 2.0 * math.acos(max(0.0, 1.0 - tolerance_mm / radius))
        count = max(1, math.ceil(sweep / step))
        if not (count <= most):
            raise CircleError(f"{count} chords", f"<= {most}, what is left of the pose limit")
        along = np.linspace(0.0, 1.0, count + 1)[1:, None]
        angle = sweep * along
        lengths = radii[0] + (radii[1] - radii[0]) * along
        height = (self.end - self.start) @ self.normal
        base = self.centre + ((self.start - self.centre) @ self.normal) * self.normal
        points = base + lengths * (np.cos(angle) * u + np.sin(angle) * v) + (height * along) * self.normal
        points[-1] = self.end
        return points, tolerance_mm + off

    def _frame(self) -> tuple[Floats, Floats, tuple[float, float]]:
        """Directions at angles 0 (of the start) and 90 deg, and the radii of start and end."""
        flat = [
            p - self.centre - ((p - self.centre) @ self.normal) * self.normal for p in (self.start, self.end)
        ]
        radii = (float(np.linalg.norm(flat[0])), float(np.linalg.norm(flat[1])))
        u = flat[0] / radii[0] if radii[0] else flat[0]
        return u, np.cross(self.normal, u), radii

    def _sweep(self, u: Floats, v: Floats) -> float:
        """Angle of the whole arc, rad."""
        to_end = self.end - self.centre
        angle = math.atan2(float(to_end @ v), float(to_end @ u)) % math.tau
        at_start = math.tau - 1e-9 < angle or angle < 1e-9
        first = (math.tau if self.whole else 0.0) if at_start else angle
        return first + math.tau * self.turns
