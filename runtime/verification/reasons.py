"""Sentences for people: what is not kept, where, by how much, and what to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from runtime.verification.verdict import Boundary, SpeedLine

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


def sentences(boundaries: Mapping[str, Boundary], speed: Sequence[SpeedLine], elbow: str) -> tuple[str, ...]:
    """One sentence for each violated boundary and each joint that is too fast or accelerates too much."""
    left = [name for name, b in boundaries.items() if b.clearance is not None and b.clearance < 0.0]
    broken = [_boundary(b, elbow, left) for b in boundaries.values() if b.violated]
    return (*broken, *(_speed(line) for line in speed if not line.ok))


def _boundary(b: Boundary, elbow: str, left: Sequence[str]) -> str:
    remedy = _REMEDY.get(b.name) or _SIDES[b.name, elbow]
    if b.clearance is None or b.certified is None:
        return (
            f"{b.name}: not defined or not bounded on this path (singular, or out of reach), "
            f"needs {b.deadband:.6g} {b.unit}; cure the other boundaries first, then {remedy}"
        )
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


def _speed(line: SpeedLine) -> str:
    unit = _SPEED_UNIT[line.joint] + ("2" if line.quantity == "acceleration" else "")
    if line.peak is None:
        return f"joint {line.joint}: {line.quantity} not bounded on this path, limit {line.limit:.6g} {unit}; cure the boundaries first"
    return (
        f"joint {line.joint}: needs up to {line.peak:.6g} {unit} in segment {line.segment}, "
        f"limit {line.limit:.6g} {unit}; reduce the feed or move the bone away from the singular position"
    )
