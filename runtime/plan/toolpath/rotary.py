"""Conventions of rotary words: which tool axis in the workpiece stands for two machine angles, and how it turns.

In each of them one angle tilts the axis away from z and the other turns it about z, so that they are the polar angle
t and (up to sign and offset) the azimuth p of the unit vector u on a sphere.

How far a turn at constant rates is from a great circle. Let t and p be linear over a piece with parameter s in 0..1,
with changes a and c. On the sphere u has the speed v, ``v^2 = a^2 + c^2 sin^2 t``, and

    u'' = -v^2 u + T,   T orthogonal to u,   |T|^2 = c^2 cos^2 t (c^2 sin^2 t + 4 a^2).

The great circle g through the same ends, at a constant rate w, the angle between the ends, has ``g'' = -w^2 g``. For
``e = u - g`` therefore ``e'' + w^2 e = (w^2 - v^2) u + T`` with e = 0 at both ends. The Green's function of that is
positive for w < pi and its integral is at most ``(sec(w/2) - 1) / w^2``, so that

    |e| <= (sec(w/2) - 1) / w^2 * sqrt(max (w^2 - v^2)^2 + max |T|^2)

at equal parameter, and the angle between u and g is ``2 asin(|e| / 2)``.
"""

import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

Axis = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class RotaryConvention:
    """Two rotary axes of a table: the first tilts it about X or Y, the second turns it about Z on top of that.

    Attributes:
        name: as a person declares it.
        tilt, turn: letters of the words.
        formula: the tool axis in the workpiece.
    """

    name: str
    tilt: str
    turn: str
    formula: str

    def axis(self, tilt_deg: float, turn_deg: float) -> Axis:
        """The tool axis in the workpiece, of length 1.

        With A: ``Rz(-C) Rx(-A) (0, 0, 1) = (sin A sin C, sin A cos C, cos A)``.
        With B: ``Rz(-C) Ry(-B) (0, 0, 1) = (-sin B cos C, sin B sin C, cos B)``.
        """
        t, p = math.radians(tilt_deg), math.radians(turn_deg)
        sine = math.sin(t)
        if self.tilt == "A":
            return sine * math.sin(p), sine * math.cos(p), math.cos(t)
        return -sine * math.cos(p), sine * math.sin(p), math.cos(t)

    def pieces(
        self, start: tuple[float, float], end: tuple[float, float], tolerance_deg: float, most: int
    ) -> tuple[list[Axis], float] | None:
        """Axes at equal parts of a move, between which great circles replace the turn.

        Args:
            start: angles of tilt and turn, deg.
            end: the same; the way between them is linear.
            tolerance_deg: between the axis and the great circle's, at every parameter.
            most: pieces.

        Returns:
            The axis at the end of each piece, and what the bound says, deg; None if it needs more than ``most``.
        """
        rates = (math.radians(end[0] - start[0]), math.radians(end[1] - start[1]))
        count = max(1, math.ceil(min(math.hypot(*rates), most + 1.0)))
        while count <= most:
            angles = [_between(start, end, k / count) for k in range(count + 1)]
            axes = [self.axis(*angle) for angle in angles]
            a, c = rates[0] / count, rates[1] / count
            bound_deg = max(
                deviation_deg(math.radians(angles[k][0]), a, c, angle_between(axes[k], axes[k + 1]))
                for k in range(count)
            )
            if bound_deg <= tolerance_deg:
                return axes[1:], bound_deg
            finer = math.ceil(count * math.sqrt(min(bound_deg / tolerance_deg, 1e12)))
            count = max(count + 1, finer)
        return None


CONVENTIONS: Final = MappingProxyType(
    {
        one.name: one
        for one in (
            RotaryConvention("xyzac", "A", "C", "Rz(-C) Rx(-A) (0, 0, 1)"),
            RotaryConvention("xyzbc", "B", "C", "Rz(-C) Ry(-B) (0, 0, 1)"),
        )
    }
)
"""What may be declared, by name: tables that tilt about X or Y and turn about Z (LinuxCNC's table-rotary-tilting)."""


def deviation_deg(tilt_rad: float, a: float, c: float, w: float) -> float:
    """The bound of this module's head for one piece, deg.

    Args:
        tilt_rad: t at the piece's start.
        a: change of t over the piece, rad.
        c: change of p, rad.
        w: angle between the axes at its ends, rad.
    """
    if not (w <= 1.0):
        return 180.0
    middle, half = tilt_rad + 0.5 * a, 0.5 * abs(a)
    # |sin| and |cos| change by no more than the angle does.
    sine = abs(math.sin(middle))
    low, high = max(0.0, sine - half), min(1.0, sine + half)
    cosine = min(1.0, abs(math.cos(middle)) + half)
    radial = max(a * a + (c * high) ** 2 - w * w, w * w - a * a - (c * low) ** 2)
    across = abs(c) * cosine * math.hypot(c * high, 2.0 * a)
    # (sec x - 1) / (4 x^2) <= (1 + x^2 / 2) / 8 for x = w / 2 up to 1/2.
    distance = math.hypot(radial, across) * (1.0 + 0.125 * w * w) / 8.0
    return math.degrees(2.0 * math.asin(min(1.0, 0.5 * distance)))


def angle_between(first: Axis, second: Axis) -> float:
    """Of two axes, rad."""
    x, y, z = first
    u, v, w = second
    cross = math.hypot(y * w - z * v, z * u - x * w, x * v - y * u)
    return math.atan2(cross, x * u + y * v + z * w)


def _between(start: tuple[float, float], end: tuple[float, float], along: float) -> tuple[float, float]:
    if along >= 1.0:
        return end
    return start[0] + along * (end[0] - start[0]), start[1] + along * (end[1] - start[1])
