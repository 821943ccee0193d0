"""The controller's own check of a stored path, before it accepts it: every pose within its limits, on its elbow.

It does not repeat the runtime's verification of the continuous path. It is the second opinion of the side that
moves, from its own limits and its own kinematics, on every pose of the bytes it has stored.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from cutgate.firmware_sim.kinematics import (
    GOES_RAD,
    VERTICAL_SIN,
    Joints,
    KinematicsError,
    Pose,
    as_joints,
    calibrated_arm,
    follow,
    inverse,
    inverse_many,
    limit_text,
    outside_text,
    wrap_many,
)
from cutgate.protocol.arrays import Bools, Floats
from cutgate.protocol.records import UNIT, Calibration, Limits, PathCodes, RecordError, Tool
from cutgate.protocol.states import Refusal

SURE_STEP_RAD: Final = 1.0
"""Between poses further apart in q0 the nearest revolution is not taken on trust; the segment is followed."""


class PathVerdict(NamedTuple):
    """ACCEPTED, or the first reason against a path.

    Attributes:
        refusal: the answer.
        pose: the first pose it is about; 0 where it is about the header.
        detail: value and bound as text; empty when accepted.
    """

    refusal: Refusal
    pose: int
    detail: str


class PathCheck:
    """A check that is done in parts, so that heartbeats go on meanwhile: `while not check.step(512): ...`.

    Args:
        path: the path as stored; its poses are judged here, part by part.
        limits: the controller's limits; the sign of its q1 limits is its elbow.
        calibration: its calibration.
        tool: the mounted tool.
        hold_roll_rad: the q3 held by a path of vertical axis throughout, where the robot declares one.
    """

    def __init__(
        self,
        path: PathCodes,
        limits: Limits,
        calibration: Calibration,
        tool: Tool,
        hold_roll_rad: float | None = None,
    ) -> None:
        self._path = path
        self._limits = limits
        self._arm = calibrated_arm(
            calibration, tool_mm=tool.length_mm, elbow=path.elbow, hold_roll_rad=hold_roll_rad
        )
        self._vertical = _is_vertical(path.decoded(0, 1)[1])[0]
        self._next = 0
        self._before: Floats  # the joints at the last pose that was checked
        self._first: Joints | None = None
        self._last: Joints | None = None
        self.verdict: PathVerdict | None = self._check_header(tool)

    @property
    def path(self) -> PathCodes:
        """What is checked."""
        return self._path

    @property
    def first_joints(self) -> Joints | None:
        """Reported joints at the first pose, on the path's branch; None until found inside the limits."""
        return self._first

    @property
    def last_joints(self) -> Joints | None:
        """Reported joints at the last pose, followed from the first; None unless the path is accepted."""
        return self._last

    def step(self, max_poses: int) -> bool:
        """Check at most so many more poses; whether the check is done and `verdict` stands."""
        if self.verdict is not None:
            return True
        begin, end = self._next, min(self._next + max_poses, len(self._path))
        self.verdict = self._check_poses(begin, end)
        self._next = end
        if self.verdict is None and end == len(self._path):
            self.verdict = PathVerdict(Refusal.ACCEPTED, 0, "")
            self._last = as_joints(self._before)
        return self.verdict is not None

    def run(self) -> PathVerdict:
        """Check all that is left at once."""
        while self.verdict is None:
            self.step(len(self._path))
        return self.verdict

    def _check_header(self, tool: Tool) -> PathVerdict | None:
        path, low, high = self._path, self._limits.q_min_u[1], self._limits.q_max_u[1]
        if not (low >= 0 if path.elbow == "right" else high <= 0):
            detail = f"path for the {path.elbow} elbow, q1 limits are [{low / UNIT}, {high / UNIT}] deg"
            return PathVerdict(Refusal.WRONG_ELBOW, 0, detail)
        if path.tool_length_u != tool.length_u:
            detail = f"path for a tool of {path.tool_length_mm} mm, mounted is one of {tool.length_mm} mm"
            return PathVerdict(Refusal.TOOL_LENGTH, 0, detail)
        return None

    def _check_poses(self, begin: int, end: int) -> PathVerdict | None:
        try:
            self._path.judge(begin, end)
        except RecordError as error:
            return PathVerdict(Refusal.PATH_MALFORMED, 0, str(error))
        tips, axes = self._path.decoded(begin, end)
        joints = inverse_many(self._arm, tips, axes)
        broken = self._unwind(joints, begin)
        inside = np.all((joints >= self._limits.q_min) & (joints <= self._limits.q_max), axis=1)
        reported = np.all(np.abs(joints[:, [0, 3]]) <= GOES_RAD, axis=1)
        vertical = _is_vertical(axes)
        wrong = ~(inside & reported & (vertical == self._vertical))
        if begin == 0 and not wrong[0]:
            self._first = as_joints(joints[0])
        self._before = joints[-1]
        if not np.any(wrong):
            return None
        row = int(np.argmax(wrong))
        if inside[row] and not reported[row]:
            return PathVerdict(Refusal.JOINTS_BEYOND_WIRE, begin + row, outside_text(as_joints(joints[row])))
        detail = broken.get(row) or self._why(joints[row], vertical=bool(vertical[row]))
        return PathVerdict(Refusal.POSE_OUTSIDE_LIMITS, begin + row, detail)

    def _unwind(self, joints: Floats, begin: int) -> dict[int, str]:
        """Put q0 and q3 of these rows on the revolutions that follow continuously from the pose before, in place.

        The azimuth of the axis sweeps less than half a revolution on a great circle, so its nearest one is certain. q0 is
        certain where it changes little; elsewhere the segment is followed. q3 = azimuth - q0 - q1 with both.

        Returns:
            Rows that cannot be reached continuously, with the reason; they are NaN from there on.
        """
        back = 1 if begin else 0  # the pose before the first row
        axes = self._path.decoded(begin - back, begin + len(joints))[1]
        rows = np.vstack((self._before, joints)) if back else joints.copy()
        if not back:
            rows[0, 0] += math.tau * self._path.q0_turns
            rows[0, 3] += math.tau * self._path.roll_turns
        change = wrap_many(np.diff(rows[:, 0]))
        broken = {}
        for row in np.flatnonzero(np.abs(change) > SURE_STEP_RAD):
            try:
                change[row] = self._followed_change(begin - back + int(row), float(rows[row, 0]))
            except KinematicsError as error:
                change[row] = math.nan
                broken[int(row) + 1 - back] = str(error)
        q0 = _on_revolution_near(rows[:, 0], np.cumsum(np.concatenate((rows[:1, 0], change))))
        if not self._vertical:
            azimuth = np.arctan2(axes[:, 1], axes[:, 0])
            swept = np.cumsum(np.concatenate((rows[:1, 3], wrap_many(np.diff(azimuth)))))
            q3 = swept - (q0 - q0[0]) - (rows[:, 1] - rows[0, 1])
            joints[:, 3] = _on_revolution_near(rows[:, 3], q3)[back:]
        joints[:, 0] = q0[back:]
        return broken

    def _followed_change(self, segment: int, q0_start: float) -> float:
        """How far q0 turns on a segment, followed along it."""
        start, end = (self._pose(index) for index in (segment, segment + 1))
        first = inverse(self._arm, start)
        joints = (q0_start, *first[1:])
        return follow(self._arm, start, end, joints)[0] - q0_start

    def _pose(self, index: int) -> Pose:
        return pose_of(self._path, index)

    def _why(self, joints: Floats, *, vertical: bool) -> str:
        if vertical and (not self._vertical or self._arm.hold_roll_rad is None):
            return "tool axis is vertical: the roll is not determined"
        if not np.all(np.isfinite(joints)):
            return "wrist centre is out of reach of the links"
        text = limit_text(as_joints(joints), as_joints(self._limits.q_min), as_joints(self._limits.q_max))
        return text or "tool axis leaves the vertical on which the roll is held"


def pose_of(path: PathCodes, index: int) -> Pose:
    """One pose of a path, index from its end if negative."""
    index %= len(path)
    (tip,), (axis,) = (part.tolist() for part in path.decoded(index, index + 1))
    return Pose(tuple(tip), tuple(axis))


def _is_vertical(axes: Floats) -> Bools:
    vertical: Bools = np.hypot(axes[:, 0], axes[:, 1]) < VERTICAL_SIN
    return vertical


def _on_revolution_near(angles: Floats, near: Floats) -> Floats:
    """The same directions, moved by full revolutions to lie nearest to the given angles: no rounding adds up."""
    moved: Floats = angles + math.tau * np.round((near - angles) / math.tau)
    return moved
