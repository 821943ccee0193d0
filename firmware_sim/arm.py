"""The simulated arm as the loop sees it: where it stands, what it executes, and which joints the bus hears.

No bus, no clock: time comes in as an argument. :meth:`PlantArm.load` follows every change of the stored path,
:meth:`PlantArm.begin` an accepted start, and after that :meth:`PlantArm.move` is called once a cycle.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

from cutgate.firmware_sim.approach import BoundApproach
from cutgate.firmware_sim.drives import CYCLE_S, DrivenArm, Drives
from cutgate.firmware_sim.kinematics import GOES_RAD, Joints
from cutgate.firmware_sim.mechanical import LeastDistances, MechanicalLimits
from cutgate.firmware_sim.plant import Leg, Plant, PlantFault, PlantState, StoredPath, Visited
from cutgate.firmware_sim.state import Holdings
from cutgate.protocol.records import Calibration, Limits, Permit
from cutgate.protocol.states import StopCause

OFF_START_DEG = 2.0
DRIFT_DEG_S = 1.0
RUSH = 3.0
WEAK = 0.01


class PlantArm:
    """The arm: plant, joints, the path and the legs it executes, and what is wrong with it.

    Args:
        holdings: what the controller holds at power-up.
        joints: where it stands then, rad and mm; the middle of its limits where not given.
        hold_roll_rad: the q3 held by a path of vertical axis throughout, where the robot declares one.
        time_scale: seconds of the plant in one of the clock.
        true_calibration: the arm as it is, where it is another one than is reported.
        dynamics: whether the joints follow their command by drives with mass; else they are where they are commanded to.

    Attributes:
        state: where it is commanded to be.
        plant: how it moves.
        path: what it executes, None without a stored path.
        executed: how many segments of the cut it has executed since the start.
        speed_ratio: the highest joint speed since the start, over its limit.
        measured: the joints at the end of the cycle before.
        driven: the drives behind the command, None without dynamics.
        frozen: the joints that the bus hears instead of the true ones, with a fault.
        mechanical: where the true arm's limit switches are.
        distances: how near the true arm has come to each limit while it cut, since the start.
    """

    def __init__(
        self,
        holdings: Holdings,
        *,
        joints: Joints | None = None,
        hold_roll_rad: float | None = None,
        time_scale: float = 1.0,
        true_calibration: Calibration | None = None,
        dynamics: bool = False,
    ) -> None:
        self._hold_roll_rad = hold_roll_rad
        self._true_calibration = true_calibration
        self._time_scale = time_scale
        self._rush = 1.0
        self._drifts_since_s: float | None = None
        self._drifted_rad = 0.0
        self.frozen: Joints | None = None
        self.load(holdings)
        self.state = PlantState(joints or middle_of(self.plant.limits))
        self.driven = DrivenArm(Drives.of(self.plant.limits), self.state) if dynamics else None
        self.measured = self.state.joints
        self.executed, self.speed_ratio = 0, 0.0
        self.distances = LeastDistances(self.mechanical)

    @property
    def reading(self) -> Joints:
        """What the encoders read, rad and mm."""
        return self.driven.state.joints if self.driven else self.state.joints

    @property
    def seen(self) -> PlantState:
        """How far the measured arm has come."""
        return self.driven.seen if self.driven else self.state

    @property
    def done(self) -> bool:
        """Whether it stands at the start joints again, having executed every leg."""
        return self.state.done and (self.driven is None or self.driven.at_rest)

    def load(self, holdings: Holdings) -> None:
        """The stored path has changed; the arm keeps its place, and what was to be executed is void."""
        self.plant = Plant(
            limits=Limits.parse(holdings.limits),
            calibration=Calibration.parse(holdings.calibration),
            hold_roll_rad=self._hold_roll_rad,
        )
        reported = self.plant.calibration
        self.mechanical = MechanicalLimits.of(self.plant.limits, reported, self._true_calibration or reported)
        self.path = StoredPath.of(holdings.path) if holdings.path is not None else None
        self._approach: BoundApproach | None = None

    def begin(self, permit: Permit) -> None:
        """The start was accepted: from where the arm stands along the permitted legs."""
        self._approach = BoundApproach.of(permit)
        self.state = PlantState(self.reading)
        if self.driven:
            self.driven.stand(self.state)
        self.measured = self.state.joints
        self.executed, self.speed_ratio = 0, 0.0
        self.distances = LeastDistances(self.mechanical)

    def move(self, gap_s: float, *, moving: bool, cutter: bool) -> PlantFault | None:
        """One cycle of motion. ``done`` says afterwards that it stands at the start joints again.

        Args:
            gap_s: seconds of the clock since the cycle before.
            moving: whether motion is allowed; without it the arm stands at once, or its drives brake along the path.
            cutter: whether the cutter is switched on.

        Returns:
            Why the arm stopped by itself, None if it did not.
        """
        before, fault = self.measured, None
        plant_s = gap_s * self._time_scale
        parts = max(1, math.ceil(plant_s / CYCLE_S)) if self.driven and moving else 1
        for _ in range(parts):
            fault = fault or self._part(gap_s / parts, moving=moving, cutter=cutter)
        self.measured = self.reading
        return fault or self.plant.too_fast(before, self.measured, plant_s) or self._tripped()

    def _part(self, gap_s: float, *, moving: bool, cutter: bool) -> PlantFault | None:
        """A part of a cycle: the command goes on, and the drives behind it."""
        assert self.path is not None and self._approach is not None  # noqa: S101, PT018 - a start was accepted
        before = self.state.joints
        advance = self.plant.advance(
            self.state,
            self.path,
            self._approach,
            dt_s=gap_s if moving else 0.0,
            moving=moving,
            cutter=cutter,
            time_scale=self._time_scale * self._rush,
        )
        self.state = advance.state
        self.executed += len(advance.executed)
        self.speed_ratio = max(self.speed_ratio, advance.speed_ratio)
        visited = advance.visited
        if self.driven and moving:
            visited = (self.driven.follow(before, self.state, gap_s * self._time_scale),)
        elif self.driven:
            visited = self.driven.settle(self.state, gap_s * self._time_scale)
        return advance.fault or self._visit(visited)

    def settle(self, gap_s: float) -> None:
        """A cycle without a command: the drives come to rest where they were commanded to."""
        if self.driven:
            self._visit(self.driven.settle(self.state, gap_s * self._time_scale))
            self.measured = self.reading

    def _tripped(self) -> PlantFault | None:
        tripped = self.driven.tripped() if self.driven else ""
        return PlantFault(StopCause.TRACKING_DEVIATION, tripped) if tripped else None

    def _visit(self, visited: Sequence[Visited]) -> PlantFault | None:
        """The true arm has been there; a fault if a limit switch tripped."""
        for leg, segment, (q0, q1, q2, q3, q4) in visited:
            reading = (q0 + self._drifted_rad, q1, q2, q3, q4)
            if leg is Leg.CUT:
                self.distances.add((reading,), segment)
            tripped = self.mechanical.tripped(reading)
            if tripped:
                return PlantFault(StopCause.LIMIT_EXCEEDED, f"limit switch of the true arm: {tripped}")
        return None

    def reported(self, now_s: float) -> Joints:
        """The joints as the bus hears them; others than the controller goes by only with a fault."""
        q0, q1, q2, q3, q4 = self.frozen or self.reading
        if self._drifts_since_s is not None:
            self._drifted_rad = math.radians(DRIFT_DEG_S) * (now_s - self._drifts_since_s)
        return q0 + self._drifted_rad, q1, q2, q3, q4

    # ------------------------------------------------------------ what can be wrong with it

    def push_aside(self) -> None:
        """It stands 2 deg in q0 off where it stood."""
        q0, q1, q2, q3, q4 = self.state.joints
        self.state = replace(self.state, joints=(q0 + math.radians(OFF_START_DEG), q1, q2, q3, q4))
        if self.driven:
            self.driven.stand(self.state)

    def drift(self, now_s: float) -> None:
        """From now on q0 creeps away from where the controller believes it to be."""
        self._drifts_since_s = now_s

    def freeze(self) -> None:
        """The bus hears these joints from now on, wherever the arm goes."""
        self.frozen = self.reading

    def weaken(self) -> None:
        """From now on its drives, if it has any, have a hundredth of their acceleration."""
        if self.driven:
            self.driven.weaken(WEAK)

    def power(self, *, on: bool) -> None:
        """Without power its drives, if it has any, brake; with it again they hold the arm where it stands."""
        if self.driven:
            self.driven.powered = on
            if on:
                self.state = PlantState(self.reading)
                self.driven.stand(self.state)

    def rush(self) -> None:
        """From now on the plant runs three times as fast as it says."""
        self._rush = RUSH


def middle_of(limits: Limits) -> Joints:
    """Each joint in the middle of its limits; a turning joint with half a revolution left on either side of 0 at 0.

    Of limits beyond what a joints frame reports, in the middle of the part where the joint may go; if there is any.
    """

    def middle(joint: int, low: float, high: float) -> float:
        if joint != 2 and low <= GOES_RAD and high >= -GOES_RAD:
            low, high = max(low, -GOES_RAD), min(high, GOES_RAD)
        return 0.0 if joint != 2 and low <= -math.pi and math.pi <= high else (low + high) / 2.0

    q0, q1, q2, q3, q4 = (
        middle(joint, float(limits.q_min[joint]), float(limits.q_max[joint])) for joint in range(5)
    )
    return q0, q1, q2, q3, q4
