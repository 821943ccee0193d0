"""The controller's own kinematics of the arm: joints to pose and back, with its calibration.

Joints are what the controller reports, `(q0, q1, q2, q3, q4)` in rad, rad, mm, rad, rad; the true ones are
`reported + offset`. With true joints, links a0 and a1, slide tilt (tx, ty) and tool length l:

    wrist centre  w_xy = (a0 cos q0 + a1 cos(q0 + q1), a0 sin q0 + a1 sin(q0 + q1)) + q2 (tx, ty),  w_z = q2
    tool axis     u = (sin q4 cos p, sin q4 sin p, cos q4),  p = q0 + q1 + q3, from the tip toward the holder
    tip           t = w - l u

Written from these formulas alone, without a look at the runtime's kinematics, so that a mistake there is noticed.
"""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from cutgate.protocol.arrays import Floats
from cutgate.protocol.parameters import ROTATION_DEG_GOES
from cutgate.protocol.records import Calibration, Elbow

Joints = tuple[float, float, float, float, float]
Vector3 = tuple[float, float, float]

VERTICAL_SIN: Final = 1e-9
"""|sin q4| below which the axis is vertical and roll has no meaning."""
GOES_RAD: Final = math.radians(ROTATION_DEG_GOES)
"""How far, either way, shoulder and roll may go: the bus must always be able to report them."""
FOLLOW_STEP_RAD: Final = 0.3
"""`follow` halves a step until no joint turns by more, so that the nearest revolution is the right one."""
_FOLLOW_DEPTH: Final = 40


class KinematicsError(ValueError):
    """A pose that this arm cannot take, or joints that cannot be followed to it."""


class OutOfReachError(KinematicsError):
    """The wrist centre lies outside what the two links can span."""


class SingularError(KinematicsError):
    """The tool axis is vertical, so that the roll is not determined."""


class Pose(NamedTuple):
    """Tip, mm, and unit tool axis in the robot frame."""

    tip: Vector3
    axis: Vector3


@dataclass(frozen=True, slots=True)
class ControllerArm:
    """The true arm.

    Attributes:
        upper_mm: true upper link a0.
        forearm_mm: true forearm a1.
        tool_mm: wrist centre to tip.
        right: whether the elbow is a right one, q1 > 0.
        offset: true minus reported joints, rad and mm.
        tilt: lean of the slide toward +x and +y, mm of shift per mm of slide.
        hold_roll_rad: the reported q3 held where the axis is vertical; None where that is refused.
    """

    upper_mm: float
    forearm_mm: float
    tool_mm: float
    right: bool
    offset: Joints = (0.0, 0.0, 0.0, 0.0, 0.0)
    tilt: tuple[float, float] = (0.0, 0.0)
    hold_roll_rad: float | None = None


def calibrated_arm(
    calibration: Calibration, *, tool_mm: float, elbow: Elbow, hold_roll_rad: float | None = None
) -> ControllerArm:
    """The true arm that a calibration record describes."""
    q0, q1, q2, q3, q4 = (float(value) for value in calibration.joint_offset)
    return ControllerArm(
        upper_mm=calibration.upper_mm + calibration.upper_link_error_mm,
        forearm_mm=calibration.forearm_mm + calibration.forearm_link_error_mm,
        tool_mm=tool_mm,
        right=elbow == "right",
        offset=(q0, q1, q2, q3, q4),
        tilt=(float(calibration.slide_tilt[0]), float(calibration.slide_tilt[1])),
        hold_roll_rad=hold_roll_rad,
    )


def forward(arm: ControllerArm, joints: Joints) -> Pose:
    """The pose that reported joints bring about."""
    q0, q1, q2, q3, q4 = (reported + offset for reported, offset in zip(joints, arm.offset, strict=True))
    heading = q0 + q1 + q3
    axis = (math.sin(q4) * math.cos(heading), math.sin(q4) * math.sin(heading), math.cos(q4))
    wrist = (
        arm.upper_mm * math.cos(q0) + arm.forearm_mm * math.cos(q0 + q1) + q2 * arm.tilt[0],
        arm.upper_mm * math.sin(q0) + arm.forearm_mm * math.sin(q0 + q1) + q2 * arm.tilt[1],
        q2,
    )
    x, y, z = (w - arm.tool_mm * u for w, u in zip(wrist, axis, strict=True))
    return Pose((x, y, z), axis)


def inverse(arm: ControllerArm, pose: Pose) -> Joints:
    """The reported joints of a pose on the arm's elbow, q0 and q3 in (-pi, pi].

    Raises:
        OutOfReachError: the links cannot span to the wrist centre; NaN counts as out of reach.
        SingularError: vertical axis and no held roll.
    """
    (tip_x, tip_y, tip_z), (axis_x, axis_y, axis_z) = pose
    slide = tip_z + arm.tool_mm * axis_z
    x = tip_x + arm.tool_mm * axis_x - slide * arm.tilt[0]
    y = tip_y + arm.tool_mm * axis_y - slide * arm.tilt[1]
    radius = math.hypot(x, y)
    far = (arm.upper_mm + arm.forearm_mm - radius) * (arm.upper_mm + arm.forearm_mm + radius)
    near = (radius - arm.upper_mm + arm.forearm_mm) * (radius + arm.upper_mm - arm.forearm_mm)
    if not (far >= 0.0 and near >= 0.0):
        raise OutOfReachError(
            f"wrist centre at radius {radius:.6f} mm is out of reach, must be in "
            f"[{abs(arm.upper_mm - arm.forearm_mm):.6f}, {arm.upper_mm + arm.forearm_mm:.6f}]"
        )
    elbow = 2.0 * math.atan2(
        math.sqrt(far), math.sqrt(near)
    )  # half-angle form: exact near straight and folded
    elbow = elbow if arm.right else -elbow
    shoulder = math.atan2(y, x) - math.atan2(
        arm.forearm_mm * math.sin(elbow), arm.upper_mm + arm.forearm_mm * math.cos(elbow)
    )
    level = math.hypot(axis_x, axis_y)
    if level >= VERTICAL_SIN:
        roll = wrap(math.atan2(axis_y, axis_x) - shoulder - elbow - arm.offset[3])
    elif arm.hold_roll_rad is not None:
        roll = arm.hold_roll_rad
    else:
        raise SingularError(
            "tool axis is vertical: the roll is not determined; tilt the path or hold the roll"
        )
    return (
        wrap(shoulder - arm.offset[0]),
        elbow - arm.offset[1],
        slide - arm.offset[2],
        roll,
        math.atan2(level, axis_z) - arm.offset[4],
    )


def inverse_many(arm: ControllerArm, tips_mm: Floats, axes: Floats) -> Floats:
    """`inverse` of many poses at once.

    Args:
        arm: the arm.
        tips_mm: tips, mm, shape (n, 3).
        axes: unit axes, shape (n, 3).

    Returns:
        Joints, rad and mm, shape (n, 5); a row is NaN in full where the pose is out of reach, and its q3 is NaN where
        the axis is vertical and no roll is held.
    """
    slide = tips_mm[:, 2] + arm.tool_mm * axes[:, 2]
    x = tips_mm[:, 0] + arm.tool_mm * axes[:, 0] - slide * arm.tilt[0]
    y = tips_mm[:, 1] + arm.tool_mm * axes[:, 1] - slide * arm.tilt[1]
    radius = np.hypot(x, y)
    far = (arm.upper_mm + arm.forearm_mm - radius) * (arm.upper_mm + arm.forearm_mm + radius)
    near = (radius - arm.upper_mm + arm.forearm_mm) * (radius + arm.upper_mm - arm.forearm_mm)
    reachable = (far >= 0.0) & (near >= 0.0)
    elbow = 2.0 * np.arctan2(np.sqrt(np.where(reachable, far, 0.0)), np.sqrt(np.where(reachable, near, 1.0)))
    elbow = elbow if arm.right else -elbow
    shoulder = np.arctan2(y, x) - np.arctan2(
        arm.forearm_mm * np.sin(elbow), arm.upper_mm + arm.forearm_mm * np.cos(elbow)
    )
    level = np.hypot(axes[:, 0], axes[:, 1])
    held = math.nan if arm.hold_roll_rad is None else arm.hold_roll_rad
    roll = wrap_many(np.arctan2(axes[:, 1], axes[:, 0]) - shoulder - elbow - arm.offset[3])
    joints = np.column_stack(
        (
            wrap_many(shoulder - arm.offset[0]),
            elbow - arm.offset[1],
            slide - arm.offset[2],
            np.where(level >= VERTICAL_SIN, roll, held),
            np.arctan2(level, axes[:, 2]) - arm.offset[4],
        )
    )
    joints[~reachable] = np.nan
    return joints


def wrap(angle_rad: float) -> float:
    """The same direction in (-pi, pi]."""
    return angle_rad - math.tau * math.ceil((angle_rad - math.pi) / math.tau)


def wrap_many(angles_rad: Floats) -> Floats:
    """`wrap` of each."""
    wrapped: Floats = angles_rad - math.tau * np.ceil((angles_rad - math.pi) / math.tau)
    return wrapped


def on_nearest_revolutions(joints: Joints, previous: Joints) -> Joints:
    """The same pose with q0 and q3 on the revolutions nearest to the joints before."""
    q0, q1, q2, q3, q4 = joints
    return (
        previous[0] + wrap(q0 - previous[0]),
        q1,
        q2,
        previous[3] + wrap(q3 - previous[3]),
        q4,
    )


def angle_between(start: Vector3, end: Vector3) -> float:
    """The angle between two unit vectors, exact for small and for large ones."""
    apart = math.dist(start, end)
    together = math.hypot(*(a + b for a, b in zip(start, end, strict=True)))
    return 2.0 * math.atan2(apart, together)


def interpolate(start: Pose, end: Pose, fraction: float) -> Pose:
    """The pose at a fraction of a segment: tip on the line, axis at constant rate on the great circle.

    At 0 and 1 it is exactly the start and the end. The axes must be less than half a revolution apart.
    """
    if fraction in {0.0, 1.0}:
        return end if fraction else start
    x, y, z = (a + fraction * (b - a) for a, b in zip(start.tip, end.tip, strict=True))
    angle_rad = angle_between(start.axis, end.axis)
    if angle_rad < 1e-7:  # sin x = x to the last bit
        weight_start, weight_end = 1.0 - fraction, fraction
    else:
        weight_start, weight_end = math.sin((1.0 - fraction) * angle_rad), math.sin(fraction * angle_rad)
    u = tuple(weight_start * a + weight_end * b for a, b in zip(start.axis, end.axis, strict=True))
    length = math.hypot(*u)
    return Pose((x, y, z), (u[0] / length, u[1] / length, u[2] / length))


def follow(arm: ControllerArm, start: Pose, end: Pose, joints: Joints) -> Joints:
    """The joints at a segment's end, followed continuously from those at its start.

    Raises:
        OutOfReachError: the segment leaves the reach.
        SingularError: it runs through the vertical.
        KinematicsError: a joint jumps however short the step.
    """
    at, step = 0.0, 1.0
    while at < 1.0:
        to = min(1.0, at + step)
        reached = on_nearest_revolutions(inverse(arm, interpolate(start, end, to)), joints)
        if largest_rotation(joints, reached) <= FOLLOW_STEP_RAD:
            at, joints, step = to, reached, 2.0 * step
        else:
            step /= 2.0
            if step < 2.0**-_FOLLOW_DEPTH:
                raise KinematicsError(
                    f"a joint jumps at fraction {at:.9f} of the segment: it cannot be followed"
                )
    return joints


def largest_rotation(a: Joints, b: Joints) -> float:
    """The largest difference of a turning joint, rad."""
    return max(abs(a[0] - b[0]), abs(a[1] - b[1]), abs(a[3] - b[3]), abs(a[4] - b[4]))


def as_joints(values: Floats) -> Joints:
    """Five numbers of an array as joints."""
    q0, q1, q2, q3, q4 = (float(value) for value in values)
    return q0, q1, q2, q3, q4


def outside_text(joints: Joints) -> str:
    """The joints that go beyond what a joints frame reports, one revolution to spare, in deg; empty if none does.

    The slide and the joints whose limits are narrow by themselves never do.
    """
    return ", ".join(
        f"q{joint} = {math.degrees(joints[joint]):.6f} deg is beyond +-{ROTATION_DEG_GOES} deg, what the bus reports "
        "with one revolution to spare"
        for joint in (0, 3)
        if not abs(joints[joint]) <= GOES_RAD
    )


def limit_text(joints: Joints, lower: Joints, upper: Joints) -> str:
    """The joints that are not inside their limits, in deg and mm; empty if all are."""
    found = []
    for joint, (value, low, high) in enumerate(zip(joints, lower, upper, strict=True)):
        if not low <= value <= high:
            scale, unit = (1.0, "mm") if joint == 2 else (math.degrees(1.0), "deg")
            found.append(
                f"q{joint} = {value * scale:.6f} {unit} is outside [{low * scale:.6f}, {high * scale:.6f}]"
            )
    return ", ".join(found)
