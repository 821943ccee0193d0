"""A short path that any arm of this kind can cut, made from what the controller itself reports.

It stands in the middle of the joint limits and moves the slide only. It is for a plant that is disconnected: it knows
no bone, and nothing about it is verified beyond the joint limits.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cutgate.protocol import records
from cutgate.protocol.arrays import Floats
from cutgate.protocol.parameters import ROTATION_DEG_GOES, UNIT, Calibration, Limits, Tool, joints_to_counts
from cutgate.protocol.path import Elbow
from cutgate.protocol.records import Path, RecordError
from cutgate.runtime.kinematics.arm import REVOLUTION, TrueArm, turns

STEP_MM: Final = 0.02
FEED_MM_S: Final = 1.0
SHORT: Final = 3
LONG: Final = 250
"""Poses of a path that takes two blocks."""
OUTSIDE_MM: Final = 20.0
TILT_MIN_RAD: Final = math.radians(2.0)


@dataclass(frozen=True)
class Reported:
    """What the controller reports of itself."""

    limits: Limits
    calibration: Calibration
    tool: Tool

    @property
    def elbow(self) -> Elbow:
        """The elbow that the limits of q1 allow."""
        return "right" if self.limits.q_min_u[1] >= 0 else "left"

    @property
    def arm(self) -> TrueArm:
        """The true arm, by the runtime's kinematics."""
        found = self.calibration
        return TrueArm(
            upper_mm=found.upper_mm + found.upper_link_error_mm,
            forearm_mm=found.forearm_mm + found.forearm_link_error_mm,
            side=1.0 if self.elbow == "right" else -1.0,
            offset=found.joint_offset,
            tilt=found.slide_tilt,
        )


@dataclass(frozen=True)
class Sample:
    """A path and the joints at its first and last pose, rad and mm, shape (5,)."""

    path: Path
    first: Floats
    last: Floats


def sample(reported: Reported, poses: int = SHORT) -> Sample:
    """A path of so many poses, straight down the slide.

    Raises:
        RecordError: the middle of the limits is no place for it (vertical tool, values beyond the codes).
    """
    joints = np.repeat(_middle(reported.limits)[np.newaxis], poses, axis=0)
    joints[:, 2] -= STEP_MM * np.arange(poses)
    tips, axes = reported.arm.pose(joints, reported.tool.length_mm)
    if not np.all(np.hypot(axes[:, 0], axes[:, 1]) >= math.sin(TILT_MIN_RAD)):
        raise RecordError("the tool is vertical in the middle of the limits: its roll is not determined")
    path = Path.quantised(
        tips,
        axes,
        feed_mm_s=FEED_MM_S,
        tool_length_mm=reported.tool.length_mm,
        elbow=reported.elbow,
        q0_turns=int(turns(joints[:1, 0])[0]),
        roll_turns=int(turns(joints[:1, 3])[0]),
    )
    return Sample(path, joints[0], joints[-1])


def _middle(limits: Limits) -> Floats:
    """The middle of each joint's limits; a turning joint with half a turn left on either side of 0 stands at 0.

    Of limits beyond what a joints frame reports, the middle of the part where a joint may go.
    """
    turning, goes = np.array([True, False, False, True, False]), math.radians(ROTATION_DEG_GOES)
    low = np.where(turning, np.maximum(limits.q_min, -goes), limits.q_min)
    high = np.where(turning, np.minimum(limits.q_max, goes), limits.q_max)
    free = (low <= -math.pi) & (high >= math.pi) & turning
    return np.where(free, 0.0, (low + high) / 2.0)


def outside_limits(good: Sample, reported: Reported) -> Path:
    """The same path with its last pose 20 mm above the slide's upper limit."""
    poses = good.path.poses.copy()
    wrist_mm = good.last[2]
    poses[-1, 2] += round(1000.0 * (float(reported.limits.q_max[2]) - float(wrist_mm) + OUTSIDE_MM))
    return replace(good.path, pose_bytes=poses.tobytes())


def other_elbow(good: Sample) -> Path:
    """The same poses, named for the other elbow."""
    return replace(good.path, elbow="left" if good.path.elbow == "right" else "right")


def other_tool(good: Sample) -> Path:
    """The same poses, made for a tool 1 mm longer."""
    return replace(good.path, tool_length_u=good.path.tool_length_u + UNIT)


def approach(good: Sample, reported: Reported, *, clearance_um: int, speed_percent: int) -> records.Approach:
    """Entry and exit of the path as a permit binds them (docs/protocol.md, Approach and retract)."""
    path, ends = good.path, []
    for pose, joints in ((0, good.first), (-1, good.last)):
        along = (path.tips_mm - path.tips_mm[pose]) @ path.axes[pose]
        distance_um = math.ceil(clearance_um + 1000.0 * float(along.max()))
        retracted = path.tips_mm[pose] + distance_um / 1000.0 * path.axes[pose]
        found = reported.arm.joints(retracted[np.newaxis], path.axes[pose][np.newaxis], path.tool_length_mm)[
            0
        ]
        for joint in (0, 3):
            found[joint] += REVOLUTION * round((joints[joint] - found[joint]) / REVOLUTION)
        if not np.all((reported.limits.q_min <= found) & (found <= reported.limits.q_max)):
            raise RecordError("the sample path's entry or exit is outside the joint limits")
        ends.append((distance_um, joints_to_counts(found)))
    (entry_um, entry), (exit_um, leaving) = ends
    return records.Approach(entry_um, exit_um, entry, leaving, speed_percent)
