"""A six-joint elbow arm with a spherical wrist, certified through the distance interface.

    python examples/six_joint_arm.py

Joints: q1 base yaw, q2 shoulder (from the horizontal, up positive), q3 elbow (relative, negative: elbow up), q4 forearm
roll, q5 wrist pitch, q6 tool spin; the wrist's three axes meet in the wrist centre. No product's data.

Two distances, one after the other on the same continuous path (tip straight, tool axis on a great circle):

- `ArmDistance`, mm: how far the wrist centre may move before q1, q2 or q3 meets a limit. In the vertical half
  plane through the wrist centre, shoulder and elbow are a planar arm, so its exact distance serves; the yaw limits are two
  vertical half planes; the base axis, where yaw is undefined, is kept ``axis_mm`` away.
- `WristDistance`, rad: q5, the angle between forearm and tool, against its limits, a cone about the forearm. The
  lower limit is over zero, so the wrist never passes its singularity and q4 stays continuous.

The forearm turns as the wrist centre moves. With rho the distance from the base axis and psi = q2 + q3 the forearm's
elevation, a move dw has a part t across the half plane and a part p in it, at right angles. Across: the azimuth turns by
t / rho. In the plane w = a2 e(q2) + a3 e(psi); multiplying dw by e(q2) leaves -a3 sin(q3) dpsi, so
abs(dpsi) <= p / (a3 abs(sin q3)). The forearm's direction f = (cos psi cos q1, cos psi sin q1, sin psi) has
abs(df)^2 = (cos psi dq1)^2 + dpsi^2 <= max(1 / rho, 1 / (a3 abs(sin q3)))^2 abs(dw)^2. The largest value over the
workspace, `SixJointArm.turn_per_mm`, is finite because base axis and straight elbow are excluded; an arm whose limits do not
exclude them is refused. It holds along a path whose every point is inside, which is what the first decision proves.

Not shown here: limits of q4 and q6 (taken as unlimited), joint speeds, calibration, collisions of the links.
"""

import math
from dataclasses import dataclass

import numpy as np

from cutgate.protocol.arrays import Floats, Ints
from cutgate.runtime.kinematics.pose import slerp, turn_angles
from cutgate.runtime.library.other_arms import Decision, ExactPlanar, certify
from cutgate.runtime.workspace.distance import signed_distance
from cutgate.runtime.workspace.planar import PlanarWorkspace

Range = tuple[float, float]

LEAST_SINE = 0.05
"""An elbow nearer to straight or folded than this sine is singular."""


@dataclass(frozen=True, slots=True)
class SixJointArm:
    """The arm; lengths mm, angles rad.

    Raises:
        ValueError: the limits do not keep the singular positions out.
    """

    base_mm: float = 380.0
    upper_mm: float = 420.0
    forearm_mm: float = 400.0
    tool_mm: float = 180.0
    yaw: Range = (math.radians(-150), math.radians(150))
    shoulder: Range = (math.radians(-20), math.radians(115))
    elbow: Range = (math.radians(-145), math.radians(-15))
    pitch: Range = (math.radians(8), math.radians(115))
    axis_mm: float = 100.0

    def __post_init__(self) -> None:
        lo, hi = self.elbow
        if not (-math.pi < lo <= hi < 0.0 and min(-math.sin(lo), -math.sin(hi)) >= LEAST_SINE):
            raise ValueError(f"elbow limits are {self.elbow} rad: must keep sin q3 <= -{LEAST_SINE}")
        if not self.axis_mm > 0.0:
            raise ValueError(f"axis_mm is {self.axis_mm}: must keep the wrist centre off the base axis")
        if not 0.0 < self.pitch[0] <= self.pitch[1] < math.pi:
            raise ValueError(f"pitch limits are {self.pitch} rad: must lie within 0 and pi, ends excluded")
        if not 0.0 <= self.yaw[1] - self.yaw[0] < 2.0 * math.pi:
            raise ValueError(f"yaw limits are {self.yaw} rad: must span less than a turn")

    @property
    def turn_per_mm(self) -> float:
        """Largest turn of the forearm per mm of wrist centre inside the workspace, rad / mm."""
        sine = min(-math.sin(q3) for q3 in self.elbow)
        return max(1.0 / self.axis_mm, 1.0 / (self.forearm_mm * sine))

    @property
    def half_plane(self) -> PlanarWorkspace:
        """Shoulder and elbow as a right-elbow planar arm, turned upside down: places (rho, base_mm - z)."""
        return PlanarWorkspace(
            self.upper_mm,
            self.forearm_mm,
            -self.shoulder[1],
            -self.shoulder[0],
            -self.elbow[1],
            -self.elbow[0],
        )

    def forearm(self, wrist: Floats) -> Floats:
        """Direction of the forearm at wrist centres (n, 3), unit, (n, 3); NaN out of reach."""
        rho, z = np.hypot(wrist[:, 0], wrist[:, 1]), wrist[:, 2] - self.base_mm
        square = rho * rho + z * z
        a2, a3 = self.upper_mm, self.forearm_mm
        with np.errstate(invalid="ignore", divide="ignore"):
            bend = np.arccos((square - a2 * a2 - a3 * a3) / (2.0 * a2 * a3))
            shoulder = np.arctan2(z, rho) + np.arctan2(a3 * np.sin(bend), a2 + a3 * np.cos(bend))
            psi = shoulder - bend
            flat = np.cos(psi) / rho
        return np.stack((flat * wrist[:, 0], flat * wrist[:, 1], np.sin(psi)), axis=1)


@dataclass(frozen=True, slots=True)
class ArmDistance:
    """How far the wrist centre, the first three of (n, 6), is from the limits of q1, q2, q3, mm."""

    arm: SixJointArm

    @property
    def lipschitz(self) -> float:
        """Every term is the distance to a set in space or to its image under a map that shortens."""
        return 1.0

    @property
    def error(self) -> float:
        """Rounding alone, mm."""
        return ExactPlanar(self.arm.half_plane).error

    def __call__(self, points: Floats) -> Floats:
        """Smallest of the four terms, (n, 6) -> (n,)."""
        arm, (x, y, z) = self.arm, points[:, :3].T
        rho = np.hypot(x, y)
        planar = signed_distance(np.stack((rho, arm.base_mm - z), axis=1), arm.half_plane)
        middle, half = (arm.yaw[0] + arm.yaw[1]) / 2.0, (arm.yaw[1] - arm.yaw[0]) / 2.0
        off = np.abs(np.angle(np.exp(1j * (np.arctan2(y, x) - middle))))
        to_yaw = rho * np.sin(np.clip(half - off, -math.pi / 2.0, math.pi / 2.0))
        smallest: Floats = np.minimum.reduce((planar, to_yaw, rho - arm.axis_mm))
        return smallest


@dataclass(frozen=True, slots=True)
class WristDistance:
    """How far q5 is from its limits, rad; in the metric turn of the axis + turn_per_mm * mm of wrist centre."""

    arm: SixJointArm

    @property
    def lipschitz(self) -> float:
        """An angle between two directions changes by at most what both turn."""
        return 1.0

    @property
    def error(self) -> float:
        """Rounding alone, rad; the elbow's sine is at least LEAST_SINE."""
        return 1e-9

    def pitch(self, points: Floats) -> Floats:
        """q5 of wrist centres and axes (n, 6): the tool points against the axis, from the holder to the tip."""
        return turn_angles(self.arm.forearm(points[:, :3]), -points[:, 3:])

    def __call__(self, points: Floats) -> Floats:
        """Distance to the nearer limit, (n, 6) -> (n,)."""
        q5 = self.pitch(points)
        nearer: Floats = np.minimum(q5 - self.arm.pitch[0], self.arm.pitch[1] - q5)
        return nearer


@dataclass(frozen=True, slots=True, eq=False)
class PosePath:
    """Tips (n + 1, 3) on straight lines, unit axes (n + 1, 3) from tip to holder on great circles.

    A segment's length is ``per_mm`` times what the wrist centre moves at most plus ``per_rad`` times the axis' turn.
    """

    tips: Floats
    axes: Floats
    tool_mm: float
    per_mm: float
    per_rad: float

    @property
    def lengths(self) -> Floats:
        """At most what a segment moves, (n,)."""
        theta = turn_angles(self.axes[:-1], self.axes[1:])
        step = np.linalg.norm(np.diff(self.tips, axis=0), axis=1)
        out: Floats = self.per_mm * (step + self.tool_mm * theta) + self.per_rad * theta
        return out

    def at(self, segment: Ints, fraction: Floats) -> Floats:
        """Wrist centre and axis, (m, 6)."""
        tip = self.tips[segment] + fraction[:, None] * (self.tips[segment + 1] - self.tips[segment])
        first, second = self.axes[segment], self.axes[segment + 1]
        axis = slerp(first, second, turn_angles(first, second), fraction)
        return np.concatenate((tip + self.tool_mm * axis, axis), axis=1)


@dataclass(frozen=True, slots=True)
class Found:
    """Both decisions; the wrist's is None where the arm's was not given, which it needs."""

    arm: Decision
    wrist: Decision | None

    @property
    def admissible(self) -> bool:
        """Whether both are."""
        return self.arm.admissible and self.wrist is not None and self.wrist.admissible


def verify(arm: SixJointArm, tips: Floats, axes: Floats, deadband_mm: float, deadband_rad: float) -> Found:
    """Certifies a path of tips and axes, arm first."""
    found = certify(PosePath(tips, axes, arm.tool_mm, 1.0, 0.0), ArmDistance(arm), deadband_mm)
    if not found.admissible:
        return Found(found, None)
    path = PosePath(tips, axes, arm.tool_mm, arm.turn_per_mm, 1.0)
    return Found(found, certify(path, WristDistance(arm), deadband_rad, tolerance=math.radians(0.1)))


def pocket(x: float, y: float, z: float, lean_deg: float) -> tuple[Floats, Floats]:
    """A helix 40 mm wide and 50 mm deep round a place, the tool leaning and nodding by 8 deg with each turn."""
    turn = np.linspace(0.0, 16.0 * math.pi, 385)
    depth = -50.0 * turn / turn[-1]
    tips = np.stack((x + 20.0 * np.cos(turn), y + 20.0 * np.sin(turn), z + depth), axis=1)
    lean = math.radians(lean_deg) + math.radians(8.0) * np.sin(turn)
    axes = np.stack((-np.sin(lean), np.zeros_like(lean), np.cos(lean)), axis=1)
    return tips, axes


def main() -> None:
    """Certifies a pocket, and refuses it twice: moved outward, and with the tool along the forearm."""
    arm = SixJointArm()
    print(f"forearm turns at most {math.degrees(arm.turn_per_mm):.3f} deg per mm of wrist centre")
    cases = {"as planned": (600.0, 120.0, 210.0, 5.0), "200 mm further out": (800.0, 120.0, 210.0, 5.0),
             "tool along the forearm": (600.0, 120.0, 210.0, 30.0)}  # fmt: skip
    for name, place in cases.items():
        found = verify(arm, *pocket(*place), 5.0, math.radians(2.0))
        print(f"{name}: {'admissible' if found.admissible else 'refused'}")
        for part, decision, unit in (("arm", found.arm, 1.0), ("wrist", found.wrist, math.degrees(1.0))):
            if decision is None or decision.certified is None:
                continue
            proven = decision.certified * unit
            print(
                f"  {part:5} {decision.outcome:12} certified {proven:7.2f} {'mm' if unit == 1.0 else 'deg'}, "
                f"{decision.evaluations} evaluations"
            )


if __name__ == "__main__":
    main()
