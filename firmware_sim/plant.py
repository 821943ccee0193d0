"""The simulated arm: it executes approach, stored path and retract, no faster than feed and joint limits allow.

Pure: time comes in as `dt_s`, the state goes in and out as a value. With a time scale the plant's own time runs
faster than the clock; feed and joint speeds keep their limits in the plant's time.
"""

import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import Final, NamedTuple, Self

import numpy as np

from cutgate.firmware_sim.approach import BoundApproach, pose_at_standoff
from cutgate.firmware_sim.kinematics import (
    ControllerArm,
    Joints,
    KinematicsError,
    Pose,
    angle_between,
    as_joints,
    calibrated_arm,
    interpolate,
    inverse,
    largest_rotation,
    limit_text,
    on_nearest_revolutions,
)
from cutgate.protocol.path import HEADER_BYTES, POSE_BYTES, PathHeader, decode_axes
from cutgate.protocol.records import BLOCK_BYTES, Calibration, Limits, block_of_pose
from cutgate.protocol.states import StopCause

STEP_MM: Final = 5.0
"""The joints are computed at least so often along the path."""
STEP_RAD: Final = math.radians(2.0)
STEP_TURN_RAD: Final = 0.1
"""A step in which a joint turns further is halved: its speed is then the speed everywhere on it."""
SHORTEST_STEP: Final = 2.0**-30
OFF_PATH_MM: Final = 1.0
"""An arm further from its place on the path than this, or than OFF_PATH_RAD, does not move."""
OFF_PATH_RAD: Final = math.radians(0.5)


MEASURED: Final = 1e-6
"""Rounding of a measured joint, rad or mm."""


class BlockError(Exception):
    """A block of the stored path no longer has the CRC-32 with which it was received."""


class StoredPath:
    """The path as it lies in the controller's memory: blocks, each checked again whenever it is read for execution.

    Args:
        path: the header of the path as it was stored.
        blocks: the stored blocks, in order.
        crc32s: their CRC-32s as received.
    """

    def __init__(self, path: PathHeader, blocks: Sequence[bytes | bytearray], crc32s: Sequence[int]) -> None:
        self.elbow = path.elbow
        self.q0_turns = path.q0_turns
        self.roll_turns = path.roll_turns
        self.feed_mm_s = path.feed_mm_s
        self.tool_length_mm = path.tool_length_mm
        self._poses = path.count
        self._blocks = blocks
        self._crc32s = crc32s
        self._decoded: dict[int, list[Pose]] = {}

    @classmethod
    def of(cls, body: bytes) -> Self:
        """The stored path of canonical bytes, in the blocks that the wire would carry."""
        blocks = [body[at : at + BLOCK_BYTES] for at in range(0, len(body), BLOCK_BYTES)]
        return cls(PathHeader.of(body), blocks, [zlib.crc32(block) for block in blocks])

    def __len__(self) -> int:
        """How many poses."""
        return self._poses

    def pose(self, index: int) -> Pose:
        """One pose, from its block in memory.

        Raises:
            BlockError: the block has changed.
        """
        block = block_of_pose(index)
        if block not in self._decoded:
            # A segment may begin in one block and end in the next: two are kept.
            self._decoded = {block: self._decode(block), **dict(list(self._decoded.items())[:1])}
        return self._decoded[block][index - _first_pose(block)]

    def _decode(self, block: int) -> list[Pose]:
        stored = bytes(self._blocks[block])
        if zlib.crc32(stored) != self._crc32s[block]:
            raise BlockError(
                f"stored path block {block} of {len(self._blocks)} does not have its CRC-32 any more"
            )
        header = HEADER_BYTES if block == 0 else 0
        codes = np.frombuffer(stored, dtype="<i4", offset=header).reshape(-1, POSE_BYTES // 4)
        tips, axes = (codes[:, :3] / 1000.0).tolist(), decode_axes(codes[:, 3:]).tolist()
        return [Pose(tuple(tip), tuple(axis)) for tip, axis in zip(tips, axes, strict=True)]


def _first_pose(block: int) -> int:
    """The first pose that lies in a block."""
    return max(0, (BLOCK_BYTES * block - HEADER_BYTES) // POSE_BYTES)


class Leg(IntEnum):
    """The motion after START, in this order."""

    APPROACH = 0
    """Joint line: start joints to the entry pose."""
    ENTRY = 1
    """Straight: entry to the first pose."""
    CUT = 2
    EXIT = 3
    """Straight: last pose to the exit pose."""
    RETRACT = 4
    """Joint line: exit pose back to the start joints."""


@dataclass(frozen=True, slots=True)
class PlantState:
    """Where the arm is.

    Attributes:
        joints: reported joints, rad and mm.
        leg: what it executes.
        segment: the path's segment it is on: the first before the cut, the last after it.
        fraction: how far along the leg, in the cut along the segment, 0 to 1.
        moving: whether it moved in the last step.
        cutter: whether the cutter turns.
        done: whether it stands at the start joints again, having executed every leg.
    """

    joints: Joints
    leg: Leg = Leg.APPROACH
    segment: int = 0
    fraction: float = 0.0
    moving: bool = False
    cutter: bool = False
    done: bool = False

    @property
    def progress(self) -> tuple[int, float]:
        """Segment and fraction of the cut: 0 and 0 before it, the last and 1 after it."""
        return self.segment, self.fraction if self.leg is Leg.CUT else float(self.leg > Leg.CUT)


@dataclass(frozen=True, slots=True)
class PlantFault:
    """Why the arm stopped by itself."""

    cause: StopCause
    detail: str


class Visited(NamedTuple):
    """A place at which the arm was, at the end of a part of a leg that it took at once."""

    leg: Leg
    segment: int
    joints: Joints


class Advance(NamedTuple):
    """What one step did.

    Attributes:
        state: the new state.
        executed: the segments of the cut completed in this step, in order, without a gap to those before.
        speed_ratio: the highest joint speed in the step over its limit, in the plant's time; at most 1.
        slowed: whether the joint speed limits held the feed below the planned one.
        fault: why the arm stopped by itself, None if it did not.
        visited: where it was in the step, in order, the last of them where it is now; empty if it stood.
    """

    state: PlantState
    executed: range
    speed_ratio: float
    slowed: bool
    fault: PlantFault | None
    visited: tuple[Visited, ...] = ()


class _Stretch(NamedTuple):
    """A leg, or one segment of the cut, under execution.

    Attributes:
        joints: those at a fraction of it, given the joints just before.
        time_s: planned.
        longest_step: the joints are computed at least so often, as a fraction.
    """

    joints: Callable[[float, Joints], Joints]
    time_s: float
    longest_step: float


class _Step(NamedTuple):
    """A part of a stretch that the arm can take at once."""

    fraction: float
    joints: Joints
    time_s: float
    speed_ratio: float
    slowed: bool


@dataclass(frozen=True)
class Plant:
    """The simulated arm with its limits.

    Attributes:
        limits: position and speed limits of the reported joints.
        calibration: the true arm.
        hold_roll_rad: the q3 held by a path of vertical axis throughout, where the robot declares one.
    """

    limits: Limits
    calibration: Calibration
    hold_roll_rad: float | None = None

    @cached_property
    def bounds(self) -> tuple[Joints, Joints, Joints]:
        """The lowest and the highest joints, and their greatest speeds: rad and mm, and of a second."""
        limits = self.limits
        return as_joints(limits.q_min), as_joints(limits.q_max), as_joints(limits.speed)

    def advance(
        self,
        state: PlantState,
        path: StoredPath,
        approach: BoundApproach,
        *,
        dt_s: float,
        moving: bool,
        cutter: bool,
        time_scale: float = 1.0,
    ) -> Advance:
        """The state `dt_s` seconds of the clock later.

        Args:
            state: the state now.
            path: the path being executed.
            approach: how it gets there and back, as permitted.
            dt_s: seconds, >= 0.
            moving: whether motion is allowed; without it the arm stands at once.
            cutter: whether the cutter is switched on.
            time_scale: seconds of the plant in one of the clock, > 0.

        Raises:
            ValueError: a negative or non-finite time.
        """
        budget_s = dt_s * time_scale
        if not (0.0 <= budget_s < math.inf and time_scale > 0.0):
            raise ValueError(f"dt_s = {dt_s}, time_scale = {time_scale}: must be finite, >= 0 and > 0")
        standing = replace(state, moving=False, cutter=cutter)
        if state.done or not moving or budget_s == 0.0:
            return Advance(standing, range(state.segment, state.segment), 0.0, False, None)
        return _Motion(self, path, approach, standing).run(budget_s)

    def too_fast(self, before: Joints, after: Joints, plant_s: float) -> PlantFault | None:
        """A fault if a measured joint turned faster than its limit between two cycles, whoever moved it."""
        *_, speed = self.bounds
        for joint, (old, new, limit) in enumerate(zip(before, after, speed, strict=True)):
            if not abs(new - old) <= limit * plant_s + MEASURED:
                return PlantFault(
                    StopCause.LIMIT_EXCEEDED,
                    f"q{joint} moved by {abs(new - old):.6f} in {plant_s:.6f} s, at most {limit:.6f} a second",
                )
        return None

    def _arm(self, path: StoredPath) -> ControllerArm:
        return calibrated_arm(
            self.calibration, tool_mm=path.tool_length_mm, elbow=path.elbow, hold_roll_rad=self.hold_roll_rad
        )


class _Motion:
    """One step under way: moves along stretch after stretch until the time is spent, the end or a fault."""

    def __init__(self, plant: Plant, path: StoredPath, approach: BoundApproach, state: PlantState) -> None:
        self._arm = plant._arm(path)  # noqa: SLF001 - same module
        self._lower, self._upper, self._speed = plant.bounds
        self._path = path
        self._approach = approach
        self._begin = state.segment
        self._state = state
        self._completed = state.segment
        self._ratio = 0.0
        self._slowed = False
        self._visited: list[Visited] = []
        self._under_way: tuple[tuple[Leg, int], _Stretch] | None = None
        """What is under execution, and the leg and segment that it is."""

    def run(self, left_s: float) -> Advance:
        """Move for that many seconds of the plant."""
        fault = None
        spent_s = 1e-6 * left_s
        try:
            fault = self._off_path()
            while fault is None and left_s > spent_s and not self._state.done:
                step = self._next_step(self._stretch(), left_s)
                if step is None:
                    break
                fault = self._outside(step.joints)
                if fault is None:
                    left_s -= step.time_s
                    self._take(step)
        except KinematicsError as error:
            fault = PlantFault(StopCause.LIMIT_EXCEEDED, f"{self._place}: {error}")
        except BlockError as error:
            fault = PlantFault(StopCause.PATH_CHANGED, str(error))
        state = replace(self._state, moving=fault is None and not self._state.done)
        executed = range(self._begin, self._completed)
        return Advance(state, executed, self._ratio, self._slowed, fault, tuple(self._visited))

    @property
    def _place(self) -> str:
        leg = self._state.leg
        return f"segment {self._state.segment}" if leg is Leg.CUT else leg.name.lower()

    # ---------------------------------------------------------- the legs

    def _stretch(self) -> _Stretch:
        """What is under execution; made once for all steps along it."""
        place = self._state.leg, self._state.segment
        if self._under_way is None or self._under_way[0] != place:
            self._under_way = place, self._new_stretch()
        return self._under_way[1]

    def _new_stretch(self) -> _Stretch:
        """The legs as a table."""
        bound, path, index = self._approach, self._path, self._state.segment
        match self._state.leg:
            case Leg.APPROACH:
                return self._joint_line(bound.start, bound.entry)
            case Leg.ENTRY:
                first = path.pose(0)
                return self._straight(pose_at_standoff(first, bound.entry_um), first)
            case Leg.CUT:
                return self._straight(path.pose(index), path.pose(index + 1))
            case Leg.EXIT:
                last = path.pose(len(path) - 1)
                return self._straight(last, pose_at_standoff(last, bound.exit_um))
            case _:  # retract
                return self._joint_line(bound.exit, bound.start)

    def _straight(self, start: Pose, end: Pose) -> _Stretch:
        """Tip on a line, axis on a great circle, at the path's feed."""
        angle_rad = angle_between(start.axis, end.axis)
        longest_mm = max(math.dist(start.tip, end.tip), self._path.tool_length_mm * angle_rad)
        steps = max(1.0, math.ceil(longest_mm / STEP_MM), math.ceil(angle_rad / STEP_RAD))

        def joints(fraction: float, near: Joints) -> Joints:
            return on_nearest_revolutions(inverse(self._arm, interpolate(start, end, fraction)), near)

        return _Stretch(joints, longest_mm / self._path.feed_mm_s, 1.0 / steps)

    def _joint_line(self, start: Joints, end: Joints) -> _Stretch:
        """All joints linear in one parameter, the slowest at the bound part of its speed limit; no revolution is left out."""
        slowest_s = max(abs(b - a) / v for a, b, v in zip(start, end, self._speed, strict=True))
        steps = max(1.0, math.ceil(2.0 * largest_rotation(start, end) / STEP_TURN_RAD))

        def joints(fraction: float, _near: Joints) -> Joints:
            if fraction in {0.0, 1.0}:
                return end if fraction else start
            q0, q1, q2, q3, q4 = (a + fraction * (b - a) for a, b in zip(start, end, strict=True))
            return q0, q1, q2, q3, q4

        return _Stretch(joints, slowest_s / self._approach.speed, 1.0 / steps)

    # ---------------------------------------------------------- moving along them

    def _next_step(self, stretch: _Stretch, left_s: float) -> _Step | None:
        """The longest part, of those tried, that fits the time left; None if none does."""
        at = self._state.fraction
        size = min(1.0 - at, stretch.longest_step)
        reserve = 1.0 - 1e-9  # for rounding; a part whose time is not proportional needs more the next time
        while size > SHORTEST_STEP:
            step = self._part(stretch, 1.0 if at + size > 1.0 - SHORTEST_STEP else at + size)
            if largest_rotation(step.joints, self._state.joints) > STEP_TURN_RAD:
                size *= 0.5
            elif step.time_s > left_s:
                size *= reserve * left_s / step.time_s
                reserve = 0.95
            else:
                return step
        if largest_rotation(step.joints, self._state.joints) > STEP_TURN_RAD:
            raise KinematicsError(f"a joint jumps at fraction {at:.9f}: the path runs through a singularity")
        return None

    def _part(self, stretch: _Stretch, to: float) -> _Step:
        joints = stretch.joints(to, self._state.joints)
        planned_s = (to - self._state.fraction) * stretch.time_s
        at_limits_s = max(
            abs(new - old) / speed
            for new, old, speed in zip(joints, self._state.joints, self._speed, strict=True)
        )
        time_s = max(planned_s, at_limits_s)
        ratio = at_limits_s / time_s if time_s > 0.0 else 0.0
        return _Step(to, joints, time_s, ratio, at_limits_s > planned_s)

    def _take(self, step: _Step) -> None:
        self._ratio = max(self._ratio, step.speed_ratio)
        self._slowed = self._slowed or step.slowed
        self._state = replace(self._state, joints=step.joints, fraction=step.fraction)
        self._visited.append(Visited(self._state.leg, self._state.segment, step.joints))
        if step.fraction == 1.0:
            self._state = self._next_stretch(self._state)

    def _next_stretch(self, state: PlantState) -> PlantState:
        """At the end of one stretch: the next segment, the next leg, or done."""
        if state.leg is Leg.RETRACT:
            return replace(state, done=True)
        if state.leg is Leg.CUT:
            self._completed = state.segment + 1
            if self._completed < len(self._path) - 1:
                return replace(state, segment=self._completed, fraction=0.0)
        return replace(state, leg=Leg(state.leg + 1), fraction=0.0)

    def _off_path(self) -> PlantFault | None:
        """A fault if the arm is not where its progress says, whatever the leg."""
        place = self._stretch().joints(self._state.fraction, self._state.joints)
        slide_mm = abs(place[2] - self._state.joints[2])
        angle_rad = largest_rotation(place, self._state.joints)
        if slide_mm <= OFF_PATH_MM and angle_rad <= OFF_PATH_RAD:
            return None
        return PlantFault(
            StopCause.TRACKING_DEVIATION,
            f"the arm is {slide_mm:.3f} mm and {math.degrees(angle_rad):.3f} deg off its place on {self._place}, "
            f"at most {OFF_PATH_MM} mm and {math.degrees(OFF_PATH_RAD):.3f} deg",
        )

    def _outside(self, joints: Joints) -> PlantFault | None:
        text = limit_text(joints, self._lower, self._upper)
        if not text:
            return None
        return PlantFault(StopCause.LIMIT_EXCEEDED, f"{self._place}: {text}")
