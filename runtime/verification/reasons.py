"""Sentences for people: what is not kept, where, by how much, and what to do."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from cutgate.protocol.parameters import ROTATION_DEG_GOES
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
    "wrist_singularity": "tilt the registration, or declare hold_roll_when_vertical for a path of constant vertical axis",
}
_SIDES = {
    ("left", "right"): "move the bone toward o1, the elbow's place at q0's upper limit",
    ("right", "right"): "move the bone away from o2, the elbow's place at q0's lower limit",
    ("left", "left"): "move the bone away from o1, the elbow's place at q0's upper limit",
    ("right", "left"): "move the bone toward o2, the elbow's place at q0's lower limit",
}
_SPEED_UNIT = ("rad/s", "rad/s", "mm/s", "rad/s", "rad/s")


def sentences(boundaries: Mapping[str, Boundary], rates: Sequence[SpeedLine], elbow: str) -> tuple[str, ...]:
    """One sentence for each boundary that is known to be violated and each rate known to be too high; one for the rest."""
    broken = [b for b in boundaries.values() if b.violated]
    found = [b for b in broken if b.clearance is not None and b.clearance < b.deadband]
    left = [b.name for b in found if b.clearance is not None and b.clearance < 0.0]
    known = [b for b in broken if b.clearance is not None]
    out = [_boundary(b, elbow, left) for b in known]
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


def _boundary(b: Boundary, elbow: str, left: Sequence[str]) -> str:
    assert b.clearance is not None and b.certified is not None  # noqa: S101, PT018 - known boundaries alone
    remedy = _REMEDY.get(b.name) or _SIDES[b.name, elbow]
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


def held_beyond(held_rad: float) -> str:
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
