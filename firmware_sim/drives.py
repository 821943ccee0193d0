"""The joints' drives: how the measured joints follow the commanded ones, and how they come to rest.

Each joint is a servo of the second order, critically damped, with the same bandwidth w for all of them as on machine
tools, so that what the command draws as a line stays one: the measured joints are 2 / w behind the commanded ones, on the
same path. Where the command stops, they come to rest at it, along what was commanded already, after 2 / w of their speed
and without overshoot; after 7 / w less than one part in a hundred of the speed is left. A joint accelerates no faster than
its limit: where the command asks for more, it falls behind what an unlimited joint would do, and a drive that has fallen
behind that by more than its bound trips.

Without power the brakes stop each joint by itself at its acceleration limit, wherever that leaves the path.

Pure: time comes in as `dt_s`, in seconds of the plant.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, Self

from cutgate.firmware_sim.kinematics import Joints, as_joints
from cutgate.firmware_sim.plant import PlantState, Visited
from cutgate.protocol.records import Limits

BANDWIDTH_RAD_S: Final = 40.0
"""Of the position loop, 6.4 Hz: the arm is 50 ms behind, and stands 175 ms after its command does."""
RAMPS_S: Final = 0.2
"""Where no acceleration limits are given, a joint takes so long to its speed limit."""
CYCLE_S: Final = 0.005
"""The drives hear a command so often, in seconds of the plant."""
TRIPS_RAD: Final = math.radians(0.2)
TRIPS_MM: Final = 0.4
"""A joint that is further from what an unlimited one would do trips: within the runtime's least usual tolerances."""
SETTLES_S: Final = 2.0
"""Whatever its speed was, an arm whose command stands still for so long stands as well."""
AT_REST: Final = 1e-6
"""rad, mm and a second: an arm that is so near to its command, and so slow, stands there."""
TIME_SCALE_MAX: Final = 10.0
"""A plant that is faster would need more steps in one cycle of the loop than there is time for."""


class JointMotion(NamedTuple):
    """One joint: position in rad or mm, speed in that a second."""

    position: float
    speed: float


@dataclass(frozen=True, slots=True)
class DriveState:
    """Where the drives are.

    Attributes:
        actual: each joint.
        ideal: where it would be without a limit of its acceleration.
    """

    actual: tuple[JointMotion, ...]
    ideal: tuple[JointMotion, ...]

    @classmethod
    def standing(cls, joints: Joints) -> Self:
        """At rest."""
        each = tuple(JointMotion(joint, 0.0) for joint in joints)
        return cls(each, each)

    @property
    def joints(self) -> Joints:
        """Where the joints are, rad and mm."""
        q0, q1, q2, q3, q4 = (joint.position for joint in self.actual)
        return q0, q1, q2, q3, q4


@dataclass(frozen=True, slots=True)
class Drives:
    """The drives of an arm.

    Attributes:
        acceleration: each joint's limit, rad/s2 and mm/s2.
        bandwidth: of every joint, rad/s.
    """

    acceleration: Joints
    bandwidth: float = BANDWIDTH_RAD_S

    @classmethod
    def of(cls, limits: Limits) -> Self:
        """Those of an arm with these limits."""
        given = limits.acceleration
        return cls(as_joints(given if given is not None else limits.speed / RAMPS_S))

    @property
    def lag_s(self) -> float:
        """How far behind the command the arm is while it moves, and how long a part of its speed it brakes for."""
        return 2.0 / self.bandwidth

    def follow(self, state: DriveState, before: Joints, command: Joints, dt_s: float) -> DriveState:
        """The state `dt_s` later, while the command goes from ``before`` to ``command`` at constant speed."""
        if dt_s <= 0.0:
            return state
        each = zip(state.actual, state.ideal, before, command, self.acceleration, strict=True)
        actual, ideal = [], []
        for joint, free, start, end, limit in each:
            speed = (end - start) / dt_s
            actual.append(_followed(joint, start, speed, self.bandwidth, limit, dt_s))
            ideal.append(_followed(free, start, speed, self.bandwidth, math.inf, dt_s))
        return _at_rest(DriveState(tuple(actual), tuple(ideal)), command)

    def brake(self, state: DriveState, dt_s: float) -> DriveState:
        """The state `dt_s` later without power: each joint slows down by itself."""
        slowed = tuple(
            _braked(joint, limit, dt_s) for joint, limit in zip(state.actual, self.acceleration, strict=True)
        )
        return DriveState(slowed, slowed)

    def tripped(self, state: DriveState) -> str:
        """The drive that has fallen behind by more than its bound, with value and bound; empty if none has."""
        for joint, (actual, ideal) in enumerate(zip(state.actual, state.ideal, strict=True)):
            behind, bound = abs(actual.position - ideal.position), TRIPS_MM if joint == 2 else TRIPS_RAD
            if not behind <= bound:
                scale, unit = (1.0, "mm") if joint == 2 else (math.degrees(1.0), "deg")
                return (
                    f"the drive of q{joint} is {behind * scale:.3f} {unit} behind, at most {bound * scale:.3f} {unit}: "
                    f"more is asked of it than its acceleration limit, {self.acceleration[joint] * scale:.3f} {unit}/s2"
                )
        return ""


def _followed(
    joint: JointMotion, start: float, speed: float, bandwidth: float, limit: float, dt_s: float
) -> JointMotion:
    """One joint after `dt_s`: exactly what the servo does, or at its acceleration limit where that asks for more.

    Args:
        joint: as it is.
        start: where the command is.
        speed: how fast the command goes on from there.
        bandwidth: rad/s.
        limit: of its acceleration.
        dt_s: seconds of the plant.
    """
    # Around the place that it would hold behind a command that has always moved so: y'' + 2 w y' + w^2 y = 0.
    off = joint.position - start + 2.0 * speed / bandwidth
    rate = joint.speed - speed + bandwidth * off
    fades = math.exp(-bandwidth * dt_s)
    left = (off + rate * dt_s) * fades
    after = JointMotion(
        start + speed * dt_s - 2.0 * speed / bandwidth + left, speed + rate * fades - bandwidth * left
    )
    faster = after.speed - joint.speed
    if abs(faster) <= limit * dt_s:
        return after
    pushed = math.copysign(limit, faster)
    return JointMotion(
        joint.position + (joint.speed + 0.5 * pushed * dt_s) * dt_s, joint.speed + pushed * dt_s
    )


def _braked(joint: JointMotion, limit: float, dt_s: float) -> JointMotion:
    stands_after_s = abs(joint.speed) / limit
    slows_s = min(dt_s, stands_after_s)
    slower = joint.speed - math.copysign(limit * slows_s, joint.speed)
    mean = 0.5 * (joint.speed + slower)
    return JointMotion(joint.position + mean * slows_s, slower if dt_s < stands_after_s else 0.0)


def _at_rest(state: DriveState, command: Joints) -> DriveState:
    """The same, or standing at the command exactly where nothing is left of distance and speed."""
    near = all(
        abs(joint.position - place) <= AT_REST and abs(joint.speed) <= AT_REST
        for joint, place in zip(state.actual, command, strict=True)
    )
    return DriveState.standing(command) if near else state


class DrivenArm:
    """The measured arm behind the commanded one.

    Args:
        drives: its drives.
        command: where it stands, which is where it is commanded to.

    Attributes:
        state: where its joints are.
        powered: without power the brakes are on.
    """

    def __init__(self, drives: Drives, command: PlantState) -> None:
        self._drives = drives
        self.powered = True
        self.stand(command)

    def stand(self, command: PlantState) -> None:
        """It is there, and at rest."""
        self.state = DriveState.standing(command.joints)
        self._time_s = 0.0
        self._commanded = deque([(0.0, command)])

    @property
    def seen(self) -> PlantState:
        """What was commanded when the command was where the measured joints are now."""
        return self._commanded[0][1]

    @property
    def at_rest(self) -> bool:
        """Whether it stands, and where it is commanded to."""
        return self.state == DriveState.standing(self._commanded[-1][1].joints)

    def follow(self, before: Joints, command: PlantState, dt_s: float) -> Visited:
        """The command has gone on from there in `dt_s`, seconds of the plant; where the joints are now."""
        if self.powered:
            self.state = self._drives.follow(self.state, before, command.joints, dt_s)
        else:
            self.state = self._drives.brake(self.state, dt_s)
        self._time_s += dt_s
        self._commanded.append((self._time_s, command))
        while self._commanded[1][0] <= self._time_s - self._drives.lag_s:  # the last one is of now
            self._commanded.popleft()
        return Visited(self.seen.leg, self.seen.segment, self.state.joints)

    def settle(self, command: PlantState, dt_s: float) -> tuple[Visited, ...]:
        """The command stands still for `dt_s`; where the joints were meanwhile."""
        if self.at_rest and self.seen == command:
            return ()
        steps = math.ceil(min(dt_s, SETTLES_S) / CYCLE_S)
        return tuple(self.follow(command.joints, command, min(dt_s, SETTLES_S) / steps) for _ in range(steps))

    def weaken(self, part: float) -> None:
        """The drives have so much of their acceleration left, in (0, 1]."""
        q0, q1, q2, q3, q4 = (part * limit for limit in self._drives.acceleration)
        self._drives = replace(self._drives, acceleration=(q0, q1, q2, q3, q4))

    def tripped(self) -> str:
        """The drive that has fallen behind by more than its bound; empty if none has."""
        return self._drives.tripped(self.state) if self.powered else ""
