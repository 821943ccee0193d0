"""Points touched in both frames, and how far a rigid transform leaves them apart. Lengths in mm."""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from cutgate.config.constants import CONSTANTS
from cutgate.protocol.arrays import Floats

TOLERANCE_MM: Final = CONSTANTS["check_point_tolerance_mm"].default
LEAST: Final = int(CONSTANTS["check_points_min"].default)


class PointResidual(NamedTuple):
    """A point and how far it is off where the transform puts it, mm."""

    id: str
    residual_mm: float


def residuals_mm(transform: Floats, from_mm: Floats, to_mm: Floats) -> Floats:
    """How far each point is off after the transform. Shapes (4, 4), (n, 3), (n, 3) -> (n,)."""
    moved = from_mm @ transform[:3, :3].T + transform[:3, 3]
    out: Floats = np.linalg.norm(moved - to_mm, axis=1)
    return out


@dataclass(frozen=True)
class CheckPoints:
    """Landmarks that were touched with the probe and not used for the fit, and what a site asks of them.

    Attributes:
        points: each with its residual.
        tolerance_mm: the largest residual that is allowed.
        least: how many there must be.
    """

    points: tuple[PointResidual, ...] = ()
    tolerance_mm: float = TOLERANCE_MM
    least: int = LEAST

    @property
    def missing(self) -> int:
        """How many more there must be."""
        return max(0, self.least - len(self.points))

    @property
    def outside(self) -> tuple[PointResidual, ...]:
        """Those that are not within the tolerance; one whose residual is not known is not."""
        return tuple(one for one in self.points if not self.within(one))

    @property
    def worst(self) -> PointResidual | None:
        """The one that is furthest off; None where there is none."""
        return max(self.points, key=_off, default=None)

    def within(self, one: PointResidual) -> bool:
        """Whether a point is where the transform puts it, to the tolerance."""
        return bool(0.0 <= one.residual_mm <= self.tolerance_mm)


NONE_ASKED: Final = CheckPoints()
"""Where a site says nothing of them, and a registration has none."""


def _off(one: PointResidual) -> float:
    return math.inf if math.isnan(one.residual_mm) else one.residual_mm
