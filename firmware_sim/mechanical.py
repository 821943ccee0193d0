"""How near the true arm comes to its mechanical limits: limit switches, and the distance to every boundary.

The encoders read what the controller goes by; the arm itself stands at `reading + offset` of its true calibration. A
limit switch sits where the limit was set up, which is `limit + offset` of the calibration that is reported. Where both
calibrations are one, a switch trips exactly where the reading reaches its limit.

The distance to a boundary of the plane is found by moving a joint: the boundary `outer` is every place that the wrist
centre takes with the elbow at its stretched limit, whatever the shoulder; `left` every place with the shoulder at its
upper limit, whatever the elbow. The nearest of them is searched for. No formula of the runtime stands here, so that one
that is wrong there is noticed.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from cutgate.firmware_sim.kinematics import (
    ControllerArm,
    Joints,
    as_joints,
    calibrated_arm,
    forward,
    limit_text,
)
from cutgate.protocol.arrays import Floats
from cutgate.protocol.records import Calibration, Elbow, Limits

FIRST_STEPS: Final = 64
"""Steps of the first search along a boundary; each further one looks between the neighbours of the nearest place."""
NEXT_STEPS: Final = 32
SEARCHES: Final = 6
"""Of half a turn the last step is then 1e-7 rad, and the distance found too long by less than 1e-3 mm."""
ROWS_MAX: Final = 256
"""So many places are kept before they are judged, all at once."""

Plane = NDArray[np.complex128]
"""Places in the plane of the links, mm, as x + iy."""
IN_MM: Final = ("inner", "outer", "left", "right", "top", "bottom")


@dataclass(frozen=True)
class MechanicalLimits:
    """Where the true arm ends.

    Attributes:
        arm: the true arm, without a tool.
        believed: the arm as the controller believes it to be, by the reported calibration.
        lower: true joints at the lower limit switches, rad and mm; q1 no further than straight or folded.
        upper: the same of the upper ones.
    """

    arm: ControllerArm
    believed: ControllerArm
    lower: Joints
    upper: Joints

    @classmethod
    def of(cls, limits: Limits, reported: Calibration, true: Calibration) -> Self:
        """The switches were set up with the reported calibration; the arm is another one if ``true`` is."""
        elbow: Elbow = "right" if limits.q_min_u[1] >= 0 else "left"
        lower, upper = limits.q_min + reported.joint_offset, limits.q_max + reported.joint_offset
        least, most = (0.0, math.pi) if elbow == "right" else (-math.pi, 0.0)
        lower[1], upper[1] = max(lower[1], least), min(upper[1], most)
        arm, believed = (calibrated_arm(one, tool_mm=0.0, elbow=elbow) for one in (true, reported))
        return cls(arm, believed, as_joints(lower), as_joints(upper))

    def tripped(self, reading: Joints) -> str:
        """The limit switches that have tripped, with true joint and place of the switch; empty if none has."""
        q0, q1, q2, q3, q4 = (joint + offset for joint, offset in zip(reading, self.arm.offset, strict=True))
        return limit_text((q0, q1, q2, q3, q4), self.lower, self.upper)

    def distances(self, readings: Floats) -> dict[str, Floats]:
        """The true arm's distance to every boundary, negative outside of it.

        Args:
            readings: what the encoders read, rad and mm, shape (n, 5).

        Returns:
            Each boundary's distances, shape (n,): of the wrist centre in mm, of roll and pitch in deg. Infinite for a
            shoulder limit that is half a turn away, where the shoulder may turn once round or further.
        """
        q0, q1, q2, q3, q4 = (readings + np.array(self.arm.offset)).T
        low, high = self.lower, self.upper
        stretched, folded = (low[1], high[1]) if self.arm.right else (high[1], low[1])
        turned = np.maximum(q0 - math.pi, low[0]), np.minimum(q0 + math.pi, high[0])
        bent = np.full_like(q1, low[1]), np.full_like(q1, high[1])
        here = self._wrist(q0, q1)
        outer = self._nearest(here, turned, lambda shoulder: self._wrist(shoulder, stretched))
        inner = self._nearest(here, turned, lambda shoulder: self._wrist(shoulder, folded))
        left = self._nearest(here, bent, lambda elbow: self._wrist(high[0], elbow))
        right = self._nearest(here, bent, lambda elbow: self._wrist(low[0], elbow))
        far = math.pi if high[0] - low[0] >= math.tau else math.inf
        return {
            "inner": np.copysign(inner, np.abs(folded) - np.abs(q1)),
            "outer": np.copysign(outer, np.abs(q1) - np.abs(stretched)),
            "left": np.where(high[0] - q0 < far, np.copysign(left, high[0] - q0), math.inf),
            "right": np.where(q0 - low[0] < far, np.copysign(right, q0 - low[0]), math.inf),
            "top": high[2] - q2,
            "bottom": q2 - low[2],
            "roll_min": np.degrees(q3 - low[3]),
            "roll_max": np.degrees(high[3] - q3),
            "pitch_min": np.degrees(q4 - low[4]),
            "pitch_max": np.degrees(high[4] - q4),
            "wrist_singularity": np.degrees(np.minimum(q4, math.pi - q4)),
        }

    def _wrist(self, q0: Floats | float, q1: Floats | float) -> Plane:
        """The wrist centre of true joints in the plane of the links, mm."""
        shoulder: Plane = np.exp(np.multiply(1j, q0))
        elbow: Plane = np.exp(np.multiply(1j, q1))
        return shoulder * (self.arm.upper_mm + self.arm.forearm_mm * elbow)

    @staticmethod
    def _nearest(here: Plane, between: tuple[Floats, Floats], place: Callable[[Floats], Plane]) -> Floats:
        """The distance to the nearest of the places, shape (n,), mm; ``between``: the joint's ends, shape (n,) each."""
        low, high = between
        steps = FIRST_STEPS
        for _ in range(SEARCHES):
            joint = low + np.linspace(0.0, 1.0, steps + 1)[:, np.newaxis] * (high - low)
            away = np.abs(place(joint) - here)
            nearest = np.argmin(away, axis=0)
            column = np.arange(len(here))
            low = joint[np.maximum(nearest - 1, 0), column]
            high = joint[np.minimum(nearest + 1, steps), column]
            steps = NEXT_STEPS
        out: Floats = away[nearest, column]
        return out


class Approached(NamedTuple):
    """How near the true arm came to a boundary, and where.

    Attributes:
        distance: mm or deg.
        segment: of the cut.
    """

    distance: float
    segment: int


class LeastDistances:
    """How near the true arm has come to each boundary while it cut.

    Args:
        limits: where it ends.
    """

    def __init__(self, limits: MechanicalLimits) -> None:
        self._limits = limits
        self._rows: list[Joints] = []
        self._segments: list[int] = []
        self._least: dict[str, Approached] = {}
        self._off_mm = 0.0

    def add(self, readings: Sequence[Joints], segment: int) -> None:
        """The encoders have read this on a segment of the cut, rad and mm."""
        self._rows += readings
        self._segments += [segment] * len(readings)
        if len(self._rows) >= ROWS_MAX:
            self._judge()

    @property
    def least(self) -> dict[str, Approached]:
        """Each boundary's least distance so far; empty before the cut, and without a boundary that never was near."""
        self._judge()
        return dict(self._least)

    @property
    def off_mm(self) -> float:
        """How far the wrist centre has been from where the controller's own calibration has it."""
        self._judge()
        return self._off_mm

    def _judge(self) -> None:
        if not self._rows:
            return
        for name, distances in self._limits.distances(np.array(self._rows)).items():
            at = int(np.argmin(distances))
            found = Approached(float(distances[at]), self._segments[at])
            if math.isfinite(found.distance):
                self._least[name] = min(found, self._least.get(name, found))
        if self._limits.believed != self._limits.arm:
            self._off_mm = max(self._off_mm, *(self._off(row) for row in self._rows))
        self._rows.clear()
        self._segments.clear()

    def _off(self, reading: Joints) -> float:
        return math.dist(forward(self._limits.arm, reading).tip, forward(self._limits.believed, reading).tip)


def distances_text(least: dict[str, Approached]) -> str:
    """The least distances in words, with their units and segments."""
    return ", ".join(
        f"{name} {found.distance:.3f} {'mm' if name in IN_MM else 'deg'} (segment {found.segment})"
        for name, found in least.items()
    )
