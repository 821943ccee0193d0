"""The controller's own approach and retract: where they begin and end by its own kinematics, and what a permit binds.

Between the start joints and the entry pose, and between the exit pose and the start joints, all joints are linear in
one parameter; between entry and first pose, and last pose and exit, the tip moves straight along the tool axis.
Joint limits are a box, so a joint line stays inside them if its two ends do.
"""

import math
from dataclasses import dataclass
from typing import Final, Self

from cutgate.firmware_sim.kinematics import (
    ControllerArm,
    Joints,
    KinematicsError,
    Pose,
    as_joints,
    follow,
    limit_text,
    outside_text,
)
from cutgate.firmware_sim.path_check import pose_of
from cutgate.protocol import records
from cutgate.protocol.parameters import ROTATION_DEG_GOES
from cutgate.protocol.records import UNIT, Calibration, Limits, PathCodes, joints_to_counts, joints_to_memory

ROUNDING_UM: Final = 1
"""Both sides round the distances up to whole um; the last bit of a product may put one of them on the next."""
PART_POSES: Final = 4096
AGREEMENT: Final = 0.01
"""deg, mm: within this the runtime's joints at entry and exit must be the controller's own."""


@dataclass(frozen=True)
class Ends:
    """Entry and exit of a stored path; joints on the path's branch, 1e-6 deg | mm."""

    entry_um: int
    exit_um: int
    entry_joints_u: tuple[int, ...]
    exit_joints_u: tuple[int, ...]


def standoff_um(path: PathCodes, pose: Pose, clearance_um: int) -> int:
    """From a pose along its axis to the clearance beyond every tip of the path, up to whole um.

    In parts: large temporary arrays would cost ten times the arithmetic, in one cycle of the loop.
    """
    parts = (path.poses[at : at + PART_POSES, :3] / 1000.0 for at in range(0, len(path), PART_POSES))
    farthest_mm = max(float(((tips_mm - pose.tip) @ pose.axis).max()) for tips_mm in parts)
    return math.ceil(clearance_um + 1000.0 * farthest_mm)


def pose_at_standoff(pose: Pose, distance_um: int) -> Pose:
    """The pose so far from another one along its tool axis, toward the holder."""
    (x, y, z), (i, j, k) = pose
    mm = distance_um / 1000.0
    return Pose((x + mm * i, y + mm * j, z + mm * k), pose.axis)


def own_ends(
    path: PathCodes, arm: ControllerArm, limits: Limits, first: Joints, last: Joints, *, clearance_um: int
) -> Ends:
    """Entry and exit, followed from the joints at the path's first and last pose.

    Raises:
        KinematicsError: one of them is out of reach, outside the limits, or cannot be followed to.
    """
    found = []
    for name, index, joints in (("entry", 0, first), ("exit", -1, last)):
        pose = pose_of(path, index)
        distance_um = standoff_um(path, pose, clearance_um)
        try:
            reached = follow(arm, pose, pose_at_standoff(pose, distance_um), joints)
        except KinematicsError as error:
            raise KinematicsError(
                f"{name} pose, {distance_um / 1000:.3f} mm along the tool: {error}"
            ) from None
        text = limit_text(reached, as_joints(limits.q_min), as_joints(limits.q_max)) or outside_text(reached)
        if text:
            raise KinematicsError(f"{name} pose, {distance_um / 1000:.3f} mm along the tool: {text}")
        found.append((distance_um, joints_to_counts(reached)))
    return Ends(found[0][0], found[1][0], found[0][1], found[1][1])


def agrees(own: Ends | None, bound: records.Approach) -> bool:
    """Whether a permit's entry and exit are the controller's own."""
    if own is None:
        return False
    joints = (
        *zip(own.entry_joints_u, bound.entry_joints_u, strict=True),
        *zip(own.exit_joints_u, bound.exit_joints_u, strict=True),
    )
    return (
        abs(own.entry_um - bound.entry_um) <= ROUNDING_UM
        and abs(own.exit_um - bound.exit_um) <= ROUNDING_UM
        and all(abs(a - b) <= AGREEMENT * UNIT for a, b in joints)
    )


def inside(limits: Limits, *joints_u: tuple[int, ...], within_deg: int = ROTATION_DEG_GOES) -> bool:
    """Whether joints, and with them every joint line between them, lie inside the limits, and where the bus reports them."""
    return all(
        low <= count <= high
        for joints in joints_u
        for low, count, high in zip(limits.q_min_u, joints, limits.q_max_u, strict=True)
    ) and all(abs(joints[joint]) <= within_deg * UNIT for joints in joints_u for joint in (0, 3))


def start_offset(
    calibration: Calibration, measured_u: tuple[int, ...], bound_u: tuple[int, ...]
) -> tuple[float, float]:
    """How far an arm that begins at the measured joints can be off the bound joint line, wherever on it.

    Returns:
        Wrist centre, mm (a0 |d0| + a1 |d0 + d1| bounds it at every elbow angle), and the turning joint furthest off, deg.
    """
    q0, q1, q2, q3, q4 = ((a - b) / UNIT for a, b in zip(measured_u, bound_u, strict=True))
    swept_mm = (calibration.upper_mm + calibration.upper_link_error_mm) * math.radians(abs(q0))
    swept_mm += (calibration.forearm_mm + calibration.forearm_link_error_mm) * math.radians(abs(q0 + q1))
    return math.hypot(swept_mm, q2), max(abs(q0), abs(q1), abs(q3), abs(q4))


@dataclass(frozen=True)
class BoundApproach:
    """What the plant executes before and after the cut: exactly what the permit binds.

    Attributes:
        start: joints where the arm stands and whereto it returns, rad and mm.
        entry: joints at the entry pose.
        exit: joints at the exit pose.
        entry_um: from the first pose to the entry pose.
        exit_um: from the last pose to the exit pose.
        speed: part of the joint speed limits on the joint lines, in (0, 1].
    """

    start: Joints
    entry: Joints
    exit: Joints
    entry_um: int
    exit_um: int
    speed: float

    @classmethod
    def of(cls, permit: records.Permit) -> Self:
        """The approach of an accepted permit."""
        bound = permit.approach
        start, entry, leave = (
            as_joints(joints_to_memory(counts))
            for counts in (permit.start_joints_u, bound.entry_joints_u, bound.exit_joints_u)
        )
        return cls(start, entry, leave, bound.entry_um, bound.exit_um, bound.speed_percent / 100.0)
