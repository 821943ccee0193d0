"""A planar arm of two turning joints whose boundary is only sampled, certified with a rigorous error bound.

    python examples/planar_2r.py

Both joints have limits of their own; the elbow may bend to either side. A path must stay on one side, because it
could change only through the straight or folded elbow; each side whose limits allow it is tried. For one side the
joint map is open away from the singular elbow, so the boundary of the workspace lies in the image of the joint
rectangle's four edges: two circles about the shoulder and two about the elbow's outermost places. These four curves
are all that is sampled. Nothing here knows about clipped arcs; membership is inverse kinematics.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cutgate.protocol.arrays import Bools, Floats
from cutgate.runtime.library.other_arms import (
    ArmPath,
    Decision,
    Polyline,
    SampledBoundary,
    certify,
    sample_curve,
)

Range = tuple[float, float]

REVOLUTION = 2.0 * math.pi
ROUNDING = 1e-9
"""Of one mm of reach, as for the exact distance: see `cutgate.runtime.workspace.distance.ROUNDING`."""


@dataclass(frozen=True, slots=True)
class Planar2R:
    """The arm.

    Attributes:
        a0: upper link, mm.
        a1: forearm, mm.
        q0: shoulder limits, rad; infinite if the shoulder turns without end.
        q1: elbow limits, rad, within +-pi; 0 is the straight elbow.

    Raises:
        ValueError: empty limits; elbow limits outside +-pi; a finite shoulder span of a turn or more, whose winding a
            distance of places cannot see.
    """

    a0: float
    a1: float
    q0: Range
    q1: Range

    def __post_init__(self) -> None:
        if not (0.0 < self.a0 < math.inf and 0.0 < self.a1 < math.inf):
            raise ValueError(f"links are {self.a0} and {self.a1} mm, must be finite and over zero")
        if not (self.unlimited or 0.0 <= self.q0[1] - self.q0[0] < REVOLUTION):
            raise ValueError(
                f"shoulder limits are {self.q0} rad, must span 0 to under a turn, or be infinite"
            )
        if not -math.pi <= self.q1[0] <= self.q1[1] <= math.pi:
            raise ValueError(f"elbow limits are {self.q1} rad, must be in order and within +-pi")

    @property
    def unlimited(self) -> bool:
        """Whether the shoulder turns without end."""
        return self.q0 == (-math.inf, math.inf)

    def sides(self) -> Iterator["Side"]:
        """The elbow's sides that the limits leave, right (q1 >= 0) first."""
        lo, hi = self.q1
        if hi > 0.0:
            yield Side(self, 1.0, (max(lo, 0.0), hi))
        if lo < 0.0:
            yield Side(self, -1.0, (lo, min(hi, 0.0)))

    def place(self, q0: Floats, q1: Floats) -> Floats:
        """Wrist places (n, 2) of joints."""
        x = self.a0 * np.cos(q0) + self.a1 * np.cos(q0 + q1)
        y = self.a0 * np.sin(q0) + self.a1 * np.sin(q0 + q1)
        return np.stack(np.broadcast_arrays(x, y), axis=-1)


@dataclass(frozen=True, slots=True)
class Side:
    """One side of the elbow: sign +1 right, -1 left, and the limits it leaves."""

    arm: Planar2R
    sign: float
    bend: Range

    def radius(self, q1: float) -> float:
        """Distance of the wrist from the shoulder at an elbow angle, mm."""
        return float(np.linalg.norm(self.arm.place(np.zeros(1), np.array([q1]))))

    def inside(self, points: Floats) -> Bools:
        """Membership by inverse kinematics: one elbow angle, then one shoulder angle modulo a turn."""
        arm = self.arm
        square = np.einsum("ij,ij->i", points, points)
        with np.errstate(invalid="ignore"):
            q1 = self.sign * np.arccos((square - arm.a0**2 - arm.a1**2) / (2.0 * arm.a0 * arm.a1))
            fits: Bools = (q1 >= self.bend[0]) & (q1 <= self.bend[1])
            if not arm.unlimited:
                offset = np.arctan2(arm.a1 * np.sin(q1), arm.a0 + arm.a1 * np.cos(q1))
                q0 = np.arctan2(points[:, 1], points[:, 0]) - offset
                fits &= np.mod(q0 - arm.q0[0], REVOLUTION) <= arm.q0[1] - arm.q0[0]
        return fits

    def distance(self, spacing_mm: float) -> SampledBoundary:
        """The signed distance, its boundary sampled at most ``spacing_mm`` apart."""
        arm, (c, d) = self.arm, self.bend
        lo, hi = (0.0, REVOLUTION) if arm.unlimited else arm.q0
        edges = [self._edge((lo, q1), (hi, q1), self.radius(q1), spacing_mm) for q1 in (c, d)]
        if not arm.unlimited:
            edges += [self._edge((q0, c), (q0, d), arm.a1, spacing_mm) for q0 in (lo, hi)]
        return SampledBoundary(np.concatenate(edges), spacing_mm, self.inside, ROUNDING * (arm.a0 + arm.a1))

    def _edge(self, first: Range, last: Range, radius: float, spacing_mm: float) -> Floats:
        """Samples of one edge of the joint rectangle, a circle of the given radius: its speed per rad."""
        (q0, q1), bend, sweep = first, last[1] - first[1], last[0] - first[0]
        return sample_curve(
            lambda t: self.arm.place(q0 + t * sweep, q1 + t * bend),
            0.0, 1.0, radius * (sweep + bend), spacing_mm,
        )  # fmt: skip


def verify(arm: Planar2R, path: ArmPath, deadband_mm: float, spacing_mm: float) -> dict[str, Decision]:
    """One decision for each side of the elbow; the path is admissible if one of them is."""
    return {
        "right" if side.sign > 0 else "left": certify(path, side.distance(spacing_mm), deadband_mm)
        for side in arm.sides()
    }


def main() -> None:
    """Certifies one path, on each side of the elbow, at three spacings of the boundary's samples."""
    arm = Planar2R(
        420.0, 380.0, (math.radians(-70), math.radians(110)), (math.radians(-120), math.radians(140))
    )
    path = Polyline(np.array([[480.0, -330.0], [620.0, -200.0], [770.0, 170.0], [520.0, 60.0]]))
    print("deadband 5 mm; path of three strokes, mm:", [round(float(v), 1) for v in path.lengths])
    for spacing in (20.0, 2.0, 0.2):
        for elbow, found in verify(arm, path, 5.0, spacing).items():
            print(
                f"samples {spacing:4g} mm apart, {elbow:>5} elbow: {found.outcome:12} certified {found.certified:7.2f} mm, "
                f"attained {found.attained:7.2f} mm, {found.evaluations} evaluations"
            )


if __name__ == "__main__":
    main()
