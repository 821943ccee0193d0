"""The path's first pose in joints, and how far measured joints are from it."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from protocol import records
from runtime.kinematics.arm import TURN, TrueArm
from runtime.verification.problem import Floats

VERTICAL_SIN = 1e-9


@dataclass(frozen=True)
class StartPose:
    """Reported joints at the first pose on the path's branch, (rad, rad, mm, rad, rad)."""

    arm: TrueArm
    tool_length_mm: float
    joints: Floats

    @classmethod
    def of(cls, path: records.Path, calibration: records.Calibration, hold_roll_rad: float | None) -> Self:
        """From the uploaded path and the controller's calibration. NaN joints where it is out of reach."""
        arm = TrueArm(
            upper_mm=calibration.upper_mm + calibration.upper_link_error_mm,
            forearm_mm=calibration.forearm_mm + calibration.forearm_link_error_mm,
            side=1.0 if path.elbow == "right" else -1.0,
            offset=calibration.joint_offset,
            tilt=calibration.slide_tilt,
        )
        joints = arm.joints(path.tips_mm[:1], path.axes[:1], path.tool_length_mm)[0]
        joints[[0, 3]] += TURN * np.array([path.q0_turns, path.roll_turns])
        if hold_roll_rad is not None and bool(np.hypot(path.axes[0, 0], path.axes[0, 1]) < VERTICAL_SIN):
            joints[3] = hold_roll_rad
        return cls(arm, path.tool_length_mm, joints)

    @property
    def counts(self) -> tuple[int, ...]:
        """The joints in counts of 1e-6 deg | mm. Raises RecordError where the pose is out of reach."""
        return records.joints_to_counts(self.joints)

    def distance(self, measured: Floats) -> tuple[float, float]:
        """Distance of measured joints (5,): of the tip, mm, and of the rotary joint furthest off, deg."""
        tips, _ = self.arm.pose(np.array([measured, self.joints]), self.tool_length_mm)
        turned = np.abs(measured - self.joints)[[0, 1, 3, 4]]
        return float(np.linalg.norm(tips[0] - tips[1])), float(np.degrees(np.max(turned)))
