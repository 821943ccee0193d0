"""Random plans that the runtime verifies and the simulated arm executes, from the same records to the last bit."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cutgate.firmware_sim.approach import BoundApproach
from cutgate.firmware_sim.drives import CYCLE_S, Drives, DriveState
from cutgate.firmware_sim.kinematics import Joints, calibrated_arm, inverse, largest_rotation
from cutgate.firmware_sim.mechanical import IN_MM, Approached, LeastDistances, MechanicalLimits
from cutgate.firmware_sim.plant import Leg, Plant, PlantState, StoredPath
from cutgate.protocol.records import Calibration, Limits, Path, PathCodes
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.problem import ArmCalibration, Deadband
from cutgate.runtime.verification.verdict import Verdict
from tests.runtime.verification.random_paths import random_path

FASTEST = 1e4
"""deg/s, mm/s: the feed alone sets the pace, so that no place is left out for a joint's speed."""


ACCELERATION = (5.0, 5.0, 1000.0, 10.0, 10.0)
"""rad/s2, mm/s2: the example robot's."""


class Plan(NamedTuple):
    """A plan that keeps inside of every limit, as both sides have it."""

    limits: Limits
    calibration: Calibration
    path: Path
    verdict: Verdict


def random_plan(rng: np.random.Generator, segments: int) -> Plan | None:
    """One that the runtime follows in its limits; None where it does not."""
    drawn = random_path(rng, segments)
    in_deg = np.array([math.degrees(1.0), math.degrees(1.0), 1.0, math.degrees(1.0), math.degrees(1.0)])
    found = drawn.calibration
    limits = Limits.quantised(
        q_min_deg=list(drawn.lower * in_deg),
        q_max_deg=list(np.minimum(drawn.upper * in_deg, [math.inf, 180.0, math.inf, math.inf, 180.0])),
        speed_deg_s=[FASTEST] * 5,
    )
    calibration = Calibration.quantised(
        upper_link_mm=drawn.arm.upper_mm,
        forearm_link_mm=drawn.arm.forearm_mm,
        upper_link_error_mm=found.upper_link_error_mm,
        forearm_link_error_mm=found.forearm_link_error_mm,
        joint_offset_deg=list(found.joint_offset * in_deg),
        slide_tilt_mrad=list(found.slide_tilt * 1000.0),
    )
    header = {"feed_mm_s": drawn.feed_mm_s, "tool_length_mm": drawn.tool_length_mm, "elbow": drawn.arm.elbow}
    path = Path.quantised(drawn.tips_mm, drawn.axes, **header)
    tips, axes = PathCodes.parse(path.body()).decoded(0, len(drawn.tips_mm))
    problem = replace(
        drawn,
        tips_mm=tips,
        axes=axes,
        tool_length_mm=path.tool_length_mm,
        arm=replace(drawn.arm, upper_mm=calibration.upper_mm, forearm_mm=calibration.forearm_mm),
        lower=limits.q_min,
        upper=limits.q_max,
        speed=limits.speed,
        deadband=Deadband(1e-3, 1e-5),
        calibration=ArmCalibration(
            calibration.upper_link_error_mm,
            calibration.forearm_link_error_mm,
            calibration.joint_offset,
            calibration.slide_tilt,
        ),
    )
    verdict = certified.verify(problem)
    if verdict.branch is None or any(not (b.certified or 0.0) > 0.0 for b in verdict.boundaries.values()):
        return None
    turns = {"q0_turns": verdict.branch.q0_turns, "roll_turns": verdict.branch.roll_turns}
    return Plan(limits, calibration, Path.quantised(drawn.tips_mm, drawn.axes, **header, **turns), verdict)


def _at_its_start(plan: Plan) -> tuple[StoredPath, BoundApproach, Joints]:
    """The plan as the arm executes it, and the joints at its first pose."""
    path = StoredPath.of(plan.path.body())
    arm = calibrated_arm(plan.calibration, tool_mm=path.tool_length_mm, elbow=path.elbow)
    q0, q1, q2, q3, q4 = inverse(arm, path.pose(0))
    first = (q0 + math.tau * path.q0_turns, q1, q2, q3 + math.tau * path.roll_turns, q4)
    return path, BoundApproach(first, first, first, 0, 0, 1.0), first


def least_while_cutting(plan: Plan, true: Calibration | None = None) -> dict[str, Approached]:
    """How near the true arm comes to each boundary: it cuts the plan to its end by the calibration that is reported.

    Args:
        plan: what is cut.
        true: the arm as it is; the reported one where not given.
    """
    path, approach, first = _at_its_start(plan)
    plant, state = Plant(plan.limits, plan.calibration), PlantState(first, Leg.CUT)
    distances = LeastDistances(MechanicalLimits.of(plan.limits, plan.calibration, true or plan.calibration))
    distances.add((first,), 0)
    while state.leg is Leg.CUT:
        done = plant.advance(state, path, approach, dt_s=1.0, moving=True, cutter=True)
        assert done.fault is None or done.state.leg is not Leg.CUT, done.fault
        for leg, segment, joints in done.visited:
            if leg is Leg.CUT:
                distances.add((joints,), segment)
        state = done.state
    return distances.least


def least_with_mass(plan: Plan, feed_mm_s: float) -> tuple[dict[str, Approached], float] | None:
    """As ``least_while_cutting``, of an arm whose joints follow by drives; None where one of them trips.

    Args:
        plan: what is cut.
        feed_mm_s: at another feed.

    Returns:
        How near it comes to each boundary, and the highest speed of a turning joint, deg/s.
    """
    path, approach, first = _at_its_start(plan)
    path.feed_mm_s = feed_mm_s
    plant, state = Plant(plan.limits, plan.calibration), PlantState(first, Leg.CUT)
    drives = Drives(ACCELERATION)
    driven = DriveState.standing(first)
    distances = LeastDistances(MechanicalLimits.of(plan.limits, plan.calibration, plan.calibration))
    fastest_rad_s = 0.0
    while driven.joints != state.joints or state.leg is Leg.CUT:
        before = state.joints
        if state.leg is Leg.CUT:
            state = plant.advance(state, path, approach, dt_s=CYCLE_S, moving=True, cutter=True).state
        if state.leg is not Leg.CUT:
            state = replace(state, joints=before)  # the last part of a cycle is beyond the cut
        fastest_rad_s = max(fastest_rad_s, largest_rotation(before, state.joints) / CYCLE_S)
        driven = drives.follow(driven, before, state.joints, CYCLE_S)
        distances.add((driven.joints,), state.segment)
        if drives.tripped(driven):
            return None
    return distances.least, math.degrees(fastest_rad_s)


def too_near(
    plan: Plan, least: dict[str, Approached], tolerance: float, tolerance_deg: float | None = None
) -> list[tuple[str, float, float]]:
    """The boundaries that the arm came nearer to than was certified, less the tolerance; with both values.

    Args:
        plan: what was cut.
        least: how near the arm came to each.
        tolerance: mm, and deg if no other is given.
        tolerance_deg: of roll and pitch.
    """
    return [
        (name, least[name].distance, boundary.certified)
        for name, boundary in plan.verdict.boundaries.items()
        if name in least
        and boundary.certified is not None
        and not least[name].distance
        >= boundary.certified - (tolerance if name in IN_MM or tolerance_deg is None else tolerance_deg)
    ]


def shifted(calibration: Calibration, **counts: int | tuple[int, ...]) -> Calibration:
    """The calibration with these fields further by so many counts."""
    added = {
        name: tuple(a + b for a, b in zip(getattr(calibration, name), by, strict=True))
        if isinstance(by, tuple)
        else getattr(calibration, name) + by
        for name, by in counts.items()
    }
    return replace(calibration, **added)
