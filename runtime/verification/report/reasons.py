"""Sentences for people: what is not kept, where, by how much, and what to do."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from cutgate.protocol.parameters import ROTATION_DEG_GOES
from cutgate.runtime.verification.bounds.geometry import VERTICAL
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.verdict import Boundary, SpeedLine, Winding

_REMEDY = {
    "inner": "move the bone away from the column",
    "outer": "move the bone toward the column",
    "top": "move the bone down",
    "bottom": "move the bone up",
    "roll_min": "turn the bone so that the roll grows, or part the path",
    "roll_max": "turn the bone so that the roll shrinks, or part the path",
    "pitch_min": "tilt the registration so that the tool leans more",
    "pitch_max": "tilt the registration so that the tool leans less",
    "wrist_singularity": "tilt the registration so that the tool keeps further from the vertical",
}
_SIDES = {
    ("left", "right"): "move the bone toward o1, the elbow's place at q0's upper limit",
    ("right", "right"): "move the bone away from o2, the elbow's place at q0's lower limit",
    ("left", "left"): "move the bone away from o1, the elbow's place at q0's upper limit",
    ("right", "left"): "move the bone toward o2, the elbow's place at q0's lower limit",
}
_SPEED_UNIT = ("rad/s", "rad/s", "mm/s", "rad/s", "rad/s")


def sentences(
    problem: Problem, boundaries: Mapping[str, Boundary], rates: Sequence[SpeedLine]
) -> tuple[str, ...]:
    """One sentence for each boundary that is known to be violated and each rate known to be too high; one for the rest."""
    remedies = _REMEDY | _sides(problem.arm.elbow) | _when_upright(problem, boundaries)
    broken = [b for b in boundaries.values() if b.violated]
    found = [b for b in broken if b.clearance is not None and b.clearance < b.deadband]
    left = [b.name for b in found if b.clearance is not None and b.clearance < 0.0]
    known = [b for b in broken if b.clearance is not None]
    out = [_boundary(b, remedies[b.name], left) for b in known]
    out += [_rate(line) for line in rates if not line.ok and line.peak is not None]
    undefined = [b.name for b in broken if b.clearance is None]
    undefined += [
        f"{line.quantity} of joint {line.joint}" for line in rates if not line.ok and line.peak is None
    ]
    if undefined:
        first = ", ".join(left or [b.name for b in found])
        remedy = f"cure {first} first" if first else "move the bone, or tilt the registration"
        why = "not defined or not bounded on this path (singular, or out of reach)"
        out.append(f"{', '.join(undefined)}: {why}; {remedy}")
    return tuple(out)


def _sides(elbow: str) -> dict[str, str]:
    return {name: remedy for (name, side), remedy in _SIDES.items() if side == elbow}


def _when_upright(problem: Problem, boundaries: Mapping[str, Boundary]) -> dict[str, str]:
    """What to do about a tool that is meant to be vertical, by what is declared and by how vertical it is.

    Meant to be is one that keeps nearer to the vertical than the wrist's deadband all along the path. Held, it must point
    upward and find no stop there.
    """
    level, height = np.hypot(problem.axes[:, 0], problem.axes[:, 1]), problem.axes[:, 2]
    off_deg = math.degrees(float(np.arctan2(level, height).max()))
    declared, exact = problem.hold_roll is not None, bool((level < VERTICAL).all())
    if declared and exact:
        return dict.fromkeys(
            ("roll_min", "roll_max"), "declare another hold_roll_deg: the roll is held there"
        )
    kept_deg = boundaries["wrist_singularity"].deadband
    stop = float(problem.lower[4] + problem.calibration.joint_offset[4])
    if not (off_deg < kept_deg and stop <= 0.0):
        return {}
    lean = f"tilt the registration until the tool leans by {kept_deg:g} deg or more"
    cure = "declare hold_roll_when_vertical"
    if not exact:
        cure = (
            f"the tool is {off_deg:.3g} deg from vertical and counts as vertical below {math.degrees(VERTICAL):.2g} deg: "
            f"give it the axis 0 0 1 in the robot frame, exactly (a rotation that keeps it has 0 0 1 as third row and "
            f"column)" + ("" if declared else f", and {cure}")
        )
    return dict.fromkeys(("pitch_min", "wrist_singularity"), f"{cure}, or {lean}")


def _boundary(b: Boundary, remedy: str, left: Sequence[str]) -> str:
    assert b.clearance is not None and b.certified is not None  # noqa: S101, PT018 - known boundaries alone
    place = f"at {b.tip_length_mm:.3f} mm of the tip path (segment {b.segment}, fraction {b.fraction:.6f})"
    if b.clearance >= b.deadband and left:
        return (
            f"{b.name}: not enclosed where the path leaves the reach, proven {b.certified:.6f} {b.unit}, "
            f"needs {b.deadband:.6g} {b.unit}; cure {', '.join(left)} first"
        )
    if b.clearance >= b.deadband:
        return (
            f"{b.name}: undecided, the clearance lies between {b.certified:.6f} and {b.clearance:.6f} {b.unit} "
            f"and needs {b.deadband:.6g} {b.unit} {place}; {remedy}"
        )
    return (
        f"{b.name}: clearance {b.clearance:.6f} {b.unit}, needs {b.deadband:.6g} {b.unit} {place}; {remedy}"
    )


FRAME = f"+-{ROTATION_DEG_GOES} deg, what a joints frame carries with one revolution to spare"


def roll_out_of_frame(held_rad: float) -> str:
    """Why a declared roll cannot be held."""
    return f"the roll is held at {math.degrees(held_rad):.3f} deg, must be within {FRAME}; declare another hold_roll_deg"


def unfit(winding: Winding, turns: int | None) -> str:
    """Why a joint cannot take these turns, None for those that come nearest; empty where it can.

    Its range on the path, the limit, and which turns it can take.
    """
    if winding.first <= winding.last if turns is None else winding.first <= turns <= winding.last:
        return ""
    limits = f"its limits [{winding.lower_deg:.6g}, {winding.upper_deg:.6g}] deg"
    low, high = max(winding.lower_deg, -ROTATION_DEG_GOES), min(winding.upper_deg, ROTATION_DEG_GOES)
    if low > high:
        return f"{winding.joint}: {limits} lie beyond {FRAME}; correct the limits"
    if turns is None:
        nearest = round(((low + high) - (winding.least_deg + winding.most_deg)) / 720.0)
        (least, most), taken = winding.range_deg(nearest), ""
    else:
        (least, most), taken = winding.range_deg(turns), f" where its turns are {turns}"
    bound = FRAME if winding.lower_deg <= least and most <= winding.upper_deg else limits
    remedy = "no turns fit: part the path or move the bone"
    if winding.first <= winding.last:
        remedy = f"turns that fit: {winding.feasible}"
    return f"{winding.joint} goes from {least:.3f} to {most:.3f} deg on the path{taken}, must stay within {bound}; {remedy}"


def _rate(line: SpeedLine) -> str:
    unit = _SPEED_UNIT[line.joint] + ("2" if line.quantity == "acceleration" else "")
    return (
        f"joint {line.joint}: needs up to {line.peak:.6g} {unit} in segment {line.segment}, "
        f"limit {line.limit:.6g} {unit}; reduce the feed or move the bone away from the singular position"
    )
