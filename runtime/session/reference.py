"""The reference trajectory of the arm, for the tracking monitor, from what this side itself has verified.

From entry to exit it is known before the session opens (`between`), whatever the number of poses; the joint lines at
its ends are put to it once the start joints are measured (`from_start`), step by step between two cycle of the loop.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from cutgate.protocol import records
from cutgate.protocol.arrays import Bools, Floats, Ints
from cutgate.protocol.records import joints_to_memory
from cutgate.runtime.interlock.tracking import CHORD_MM, CHORD_RAD, ReferenceTrajectory
from cutgate.runtime.kinematics.arm import REVOLUTION, TrueArm, turns
from cutgate.runtime.kinematics.pose import slerp, turn_angles
from cutgate.runtime.verification.bounds.geometry import VERTICAL
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.steps import Steps

PIECE_MM: Final = 2.0
PIECE_RAD: Final = math.radians(1.0)
"""First pieces of a segment; halved where the joints bend more than a chord may."""
HALVINGS: Final = 16
KNOT_S: Final = 0.005
"""Knots that lie closer in time are left out where the chord allows: a look costs by the knots within its reach."""
THINNINGS: Final = 8
AGREE: Final = np.array(
    (math.radians(0.01), math.radians(0.01), 0.01, math.radians(0.01), math.radians(0.01))
)
"""How far the joints at entry and exit may be from those that the permit binds."""
ROWS: Final = 1 << 15
"""Knots or poses copied in one step: well under a millisecond."""
_CHORD: Final = np.array((CHORD_RAD, CHORD_RAD, CHORD_MM, CHORD_RAD, CHORD_RAD))


@dataclass(frozen=True, slots=True, eq=False)
class Between:
    """The trajectory from entry to exit; its times count from the entry.

    Attributes:
        times_s: as in `ReferenceTrajectory`, shape (m,).
        joints: likewise, shape (m, 5).
        poses_s: likewise.
        links_mm: likewise.
        speed: of each joint on the joint lines, rad/s and mm/s, shape (5,).
    """

    times_s: Floats
    joints: Floats
    poses_s: Floats
    links_mm: tuple[float, float]
    speed: Floats


def between(problem: Problem, bound: records.Approach) -> Between:
    """The trajectory from entry to exit.

    Args:
        problem: the verified cut, with its joint branch.
        bound: approach and retract as the permit binds them.

    Raises:
        ValueError: the joints along the path are not those that were verified.
    """
    tips, axes = _with_entry_and_exit(problem, bound)
    theta = turn_angles(axes[:-1], axes[1:])
    length_mm = np.maximum(np.linalg.norm(np.diff(tips, axis=0), axis=1), problem.tool_length_mm * theta)
    pieces = np.maximum(np.ceil(np.maximum(length_mm / PIECE_MM, theta / PIECE_RAD)), 1.0).astype(np.int64)
    pieces, joints = _followed(problem, tips, axes, theta, pieces)
    joints = _in_branch(problem, joints, int(pieces[0]))
    _agree(joints, bound)
    seconds = np.repeat(length_mm / problem.feed_mm_s / pieces, pieces)
    times_s = np.concatenate(([0.0], np.cumsum(seconds)))
    kept = _kept(times_s, joints)
    calibration = problem.calibration
    return Between(
        times_s=times_s[kept],
        joints=joints[kept],
        poses_s=times_s[np.cumsum(pieces)[: len(problem.tips_mm)]],
        links_mm=(
            problem.arm.upper_mm + calibration.upper_link_error_mm,
            problem.arm.forearm_mm + calibration.forearm_link_error_mm,
        ),
        speed=problem.speed * bound.speed_percent / 100.0,
    )


def from_start(inner: Between, start_joints_u: tuple[int, ...]) -> Steps[ReferenceTrajectory]:
    """The whole trajectory: from the start joints to the entry, through the cut, and from the exit back to them.

    Args:
        inner: from entry to exit.
        start_joints_u: where the arm stands, 1e-6 deg | mm.
    """
    start, knots = joints_to_memory(start_joints_u), len(inner.times_s)
    there_s, back_s = (float((np.abs(inner.joints[at] - start) / inner.speed).max()) for at in (0, -1))
    times_s, joints, poses_s = np.zeros(knots + 2), np.empty((knots + 2, 5)), np.empty(len(inner.poses_s))
    joints[[0, -1]] = start
    for i in range(0, max(knots, len(poses_s)), ROWS):
        these = slice(i, i + ROWS)
        times_s[1:-1][these] = inner.times_s[these] + there_s
        joints[1:-1][these] = inner.joints[these]
        poses_s[these] = inner.poses_s[these] + there_s
        yield
    times_s[-1] = times_s[-2] + back_s
    return ReferenceTrajectory(times_s, joints, poses_s, inner.links_mm)


def _with_entry_and_exit(problem: Problem, bound: records.Approach) -> tuple[Floats, Floats]:
    tips, axes = problem.tips_mm, problem.axes
    entry, leaving = (
        tips[pose] + length_um / 1000.0 * axes[pose]
        for pose, length_um in ((0, bound.entry_um), (-1, bound.exit_um))
    )
    return np.vstack((entry, tips, leaving)), np.vstack((axes[:1], axes, axes[-1:]))


def _followed(
    problem: Problem, tips: Floats, axes: Floats, theta: Floats, pieces: Ints
) -> tuple[Ints, Floats]:
    """Joints at the ends of all pieces, followed continuously, and how many pieces each segment needs.

    Halfway along every piece the exact joints are compared with the chord's; a full turn lost shows there as well.

    Raises:
        ValueError: a pose without joints, or joints that bend more than any piece can follow.
    """
    for _ in range(HALVINGS):
        segment = np.repeat(np.arange(len(pieces)), 2 * pieces)
        first = np.repeat(np.cumsum(2 * pieces) - 2 * pieces, 2 * pieces)
        fraction = (np.arange(len(segment)) - first) / np.repeat(2.0 * pieces, 2 * pieces)
        tip = tips[segment] + fraction[:, None] * (tips[segment + 1] - tips[segment])
        axis = slerp(axes[segment], axes[segment + 1], theta[segment], fraction)
        joints = _joints(problem, np.vstack((tip, tips[-1:])), np.vstack((axis, axes[-1:])))
        if not np.isfinite(joints).all():
            raise ValueError("the verified path has a place without joints")
        bend = np.abs(joints[1::2] - (joints[:-1:2] + joints[2::2]) / 2.0) > _CHORD
        wanting = np.unique(segment[::2][bend.any(axis=1)])
        if len(wanting) == 0:
            return pieces, joints[::2]
        pieces = pieces.copy()
        pieces[wanting] *= 2
    raise ValueError(f"the verified path bends too much to be followed on segment {int(wanting[0]) - 1}")


def _joints(problem: Problem, tips: Floats, axes: Floats) -> Floats:
    """Reported joints of consecutive poses, roll and shoulder without jumps, shape (k, 5)."""
    found = problem.calibration
    arm = TrueArm(
        problem.arm.upper_mm + found.upper_link_error_mm,
        problem.arm.forearm_mm + found.forearm_link_error_mm,
        1.0 if problem.arm.elbow == "right" else -1.0,
        found.joint_offset,
        found.slide_tilt,
    )
    joints = arm.joints(tips, axes, problem.tool_length_mm)
    for joint in (0, 3):
        joints[:, joint] = np.unwrap(joints[:, joint])
    return joints


def _kept(times_s: Floats, joints: Floats) -> Bools:
    """The knots that are needed: both ends, one each KNOT_S, and every one off the chord between its neighbours."""
    kept = np.diff(np.floor(times_s / KNOT_S), prepend=-1.0) > 0.0
    kept[[0, -1]] = True
    for _ in range(THINNINGS):
        chord = np.stack([np.interp(times_s, times_s[kept], joints[kept, j]) for j in range(5)], axis=1)
        off = (np.abs(joints - chord) > _CHORD).any(axis=1)
        if not off.any():
            return kept
        kept |= off
    return np.ones_like(kept)


def _in_branch(problem: Problem, joints: Floats, first_pose: int) -> Floats:
    """The same joints with the full turns of the branch at the first pose, or with the held roll."""
    if problem.branch is None:
        raise ValueError("the cut names no joint branch")
    for joint, asked in ((0, problem.branch[0]), (3, problem.branch[1])):
        joints[:, joint] += REVOLUTION * (asked - turns(joints[first_pose : first_pose + 1, joint]))
    level = np.hypot(problem.axes[:, 0], problem.axes[:, 1])
    if problem.hold_roll is not None and (level < VERTICAL).all():
        joints[:, 3] = problem.hold_roll
    return joints


def _agree(joints: Floats, bound: records.Approach) -> None:
    ends = (("entry", 0, bound.entry_joints_u), ("exit", -1, bound.exit_joints_u))
    for name, at, counts in ends:
        off = np.abs(joints[at] - joints_to_memory(counts))
        if not (off <= AGREE).all():
            raise ValueError(
                f"the trajectory's joints at the {name} are not the verified ones: off by {off.tolist()}"
            )
