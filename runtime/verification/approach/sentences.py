"""What a joint line lacks, in sentences: where, by how much and what to do."""

from __future__ import annotations

import math

import numpy as np

from cutgate.protocol.arrays import Floats
from cutgate.runtime.verification.approach.model import LegName
from cutgate.runtime.verification.bounds.geometry import Geometry
from cutgate.runtime.verification.verdict import Boundary


def shortfall(b: Boundary, leg: LegName) -> str:
    """What a boundary of a joint line lacks, where, and what to do."""
    at_pose = b.fraction == (1.0 if leg == "approach" else 0.0)
    remedy = "lower approach_clearance_mm or move the bone" if at_pose else "let the arm start from elsewhere"
    needs = f"needs {b.deadband:.6g} {b.unit}"
    if b.clearance is None or b.certified is None:
        return f"{b.name}: not defined on this line, {needs}; {remedy}"
    place = f"at fraction {b.fraction:.6f} of the line"
    if b.clearance >= b.deadband:
        return (
            f"{b.name}: undecided, the clearance lies between {b.certified:.6f} and {b.clearance:.6f} {b.unit} "
            f"and {needs} {place}; {remedy}"
        )
    return f"{b.name}: clearance {b.clearance:.6f} {b.unit}, {needs} {place}; {remedy}"


def outside_of_limits(
    geometry: Geometry, line: Floats, lower: Floats, upper: Floats
) -> list[tuple[int, str]]:
    """The joints whose ends are not where they may go, as the controller reports them, each with which end it is."""
    reported = (line - geometry.offset) * geometry.signs
    low, high = np.sort(((np.stack((lower, upper)) - geometry.offset) * geometry.signs), axis=0)
    found = []
    for joint in range(5):
        for end in range(2):
            if lower[joint] <= line[end, joint] <= upper[joint]:
                continue
            scale, unit = (1.0, "mm") if joint == 2 else (math.degrees(1.0), "deg")
            value, least, most = (float(x) * scale for x in (reported[end, joint], low[joint], high[joint]))
            text = f"q{joint} is {value:.6f} {unit} at its {('beginning', 'end')[end]}, must be in [{least:.6g}, {most:.6g}]"
            found.append((end, text))
    return found
