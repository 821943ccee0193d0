"""What makes a problem unfit to be verified at all. Fail closed: any doubt is a defect."""

from __future__ import annotations

import math

import numpy as np

from cutgate.runtime.kinematics.pose import dot, lengths, turn_angles
from cutgate.runtime.verification.bounds.geometry import LARGEST_TURN
from cutgate.runtime.verification.problem import Problem

UNIT_TOLERANCE = 1e-6

FACING = 0.0
"""Of neighbouring axes whose product is above this none turns by anywhere near as much as would be too much."""


def defects(problem: Problem) -> tuple[str, ...]:
    """Sentences that name what is wrong with the numbers; empty if they can be verified."""
    arrays = {
        "tips_mm": (problem.tips_mm, (len(problem.tips_mm), 3)),
        "axes": (problem.axes, (len(problem.tips_mm), 3)),
        "lower limits": (problem.lower, (5,)),
        "upper limits": (problem.upper, (5,)),
        "speed limits": (problem.speed, (5,)),
        "joint offsets": (problem.calibration.joint_offset, (5,)),
        "slide tilt": (problem.calibration.slide_tilt, (2,)),
    }
    if problem.acceleration is not None:
        arrays["acceleration limits"] = (problem.acceleration, (5,))
    found = [
        f"{name} have shape {array.shape}, not {shape}"
        for name, (array, shape) in arrays.items()
        if array.shape != shape
    ]
    if len(problem.tips_mm) < 1:
        found.append("the path has no pose")
    if found:
        return tuple(found)
    found += [
        f"{name} are not all finite" for name, (array, _) in arrays.items() if not np.isfinite(array).all()
    ]
    found += bad_numbers(problem)
    if not found:
        found += _bad_axes(problem)
    return tuple(found)


def bad_numbers(problem: Problem) -> list[str]:
    """Sentences that name what is wrong with the single numbers."""
    calibration, deadband = problem.calibration, problem.deadband
    positive = {
        "feed_mm_s": problem.feed_mm_s,
        "upper link": problem.arm.upper_mm + calibration.upper_link_error_mm,
        "forearm": problem.arm.forearm_mm + calibration.forearm_link_error_mm,
        "arm deadband": deadband.arm_mm,
        "wrist deadband": deadband.wrist_rad,
        "smallest speed limit": float(problem.speed.min()),
    }
    if problem.acceleration is not None:
        positive["smallest acceleration limit"] = float(problem.acceleration.min())
    not_negative = {
        "tool_length_mm": problem.tool_length_mm,
        "residual_mm": calibration.residual_mm,
        "residual_rad": calibration.residual_rad,
        "path_tolerance_mm": deadband.path_tolerance_mm,
        "path_tolerance_rad": deadband.path_tolerance_rad,
    }
    found = [
        f"{name} is {x}, must be finite and above 0" for name, x in positive.items() if not 0.0 < x < math.inf
    ]
    found += [
        f"{name} is {x}, must be finite and at least 0"
        for name, x in not_negative.items()
        if not 0.0 <= x < math.inf
    ]
    if problem.hold_roll is not None and not math.isfinite(problem.hold_roll):
        found.append(f"the held roll is {problem.hold_roll}, must be finite")
    return found


def _bad_axes(problem: Problem) -> list[str]:
    found = []
    off = np.abs(lengths(problem.axes) - 1.0)
    if not off.max() <= UNIT_TOLERANCE:
        found.append(
            f"the tool axis of pose {int(off.argmax())} is not a unit vector (off by {off.max():.3g})"
        )
    facing = dot(problem.axes[:-1], problem.axes[1:])
    if problem.tool_length_mm > 0.0 and facing.min(initial=1.0) > FACING:
        return found
    turn = turn_angles(problem.axes[:-1], problem.axes[1:])
    if not turn.max(initial=0.0) <= LARGEST_TURN:
        found.append(
            f"segment {int(turn.argmax())} turns the tool axis by {math.degrees(turn.max()):.3f} deg, "
            "at most 179 deg have a defined great circle: add a pose between"
        )
    # Segment time is max(|dp|, l theta) / feed; a turn in no time has no speed that could be bounded.
    resting = (problem.tips_mm[1:] == problem.tips_mm[:-1]).all(axis=1) & (problem.tool_length_mm == 0.0)
    timeless = np.flatnonzero(resting & (turn > 0.0))
    if timeless.size:
        found.append(
            f"segment {int(timeless[0])} turns the tool axis by {math.degrees(turn[timeless[0]]):.3f} deg in no "
            "time: its tip rests and the tool is 0 mm long; move the tip there, or give the tool its length"
        )
    return found
