"""What becomes of the answer: one line, one JSON document, and what a permit binds."""

from __future__ import annotations

import math
from typing import Any, Final

from cutgate.protocol import records
from cutgate.protocol.arrays import Floats
from cutgate.protocol.records import joints_to_counts
from cutgate.runtime.verification.approach.model import ApproachVerdict, LegName, StartJoints, StraightLines
from cutgate.runtime.verification.verdict import Boundary

SCHEMA: Final = "cutgate.approach/1"


def summary(verdict: ApproachVerdict) -> str:
    """The smallest margin per deadband, or what is lacking, in one line."""
    if not verdict.admissible:
        return "; ".join(verdict.reasons)
    found = worst(verdict)
    if found is None:
        return "every leg keeps every deadband"
    leg, b = found
    return f"every leg keeps every deadband; tightest is {b.name} on the {leg}, {b.certified:.3f} {b.unit} with {b.deadband:g} {b.unit} required"


def worst(verdict: ApproachVerdict) -> tuple[LegName, Boundary] | None:
    """The boundary with the least margin per deadband, and its leg; an undefined one is the worst."""

    def margin(entry: tuple[LegName, Boundary]) -> float:
        b = entry[1]
        return -math.inf if b.certified is None else b.certified / b.deadband

    entries = [(leg.name, b) for leg in verdict.legs for b in leg.boundaries.values()]
    return min(entries, key=margin, default=None)


def bound(verdict: ApproachVerdict | StraightLines, speed_percent: int) -> records.Approach | None:
    """What a permit binds; None where approach or retract, or of the straight lines one, is not admissible."""
    if not verdict.admissible or verdict.entry is None or verdict.exit is None:
        return None
    return records.Approach(
        entry_um=verdict.entry_um,
        exit_um=verdict.exit_um,
        entry_joints_u=joints_to_counts(verdict.entry),
        exit_joints_u=joints_to_counts(verdict.exit),
        speed_percent=speed_percent,
    )


def document(verdict: ApproachVerdict, start: StartJoints) -> dict[str, Any]:
    """The answer and what it was made for as one JSON document (``cutgate.approach/1``); undefined values are None.

    Joints are (deg, deg, mm, deg, deg).
    """
    return {
        "schema": SCHEMA,
        "verdict": "admissible" if verdict.admissible else "inadmissible",
        "clearance_um": start.clearance_um,
        "start_tolerance_mm": start.tolerance_mm,
        "start_tolerance_deg": math.degrees(start.tolerance_rad),
        "start_joints": shown(start.joints),
        "entry_um": verdict.entry_um,
        "exit_um": verdict.exit_um,
        "entry_joints": None if verdict.entry is None else shown(verdict.entry),
        "exit_joints": None if verdict.exit is None else shown(verdict.exit),
        "legs": {
            leg.name: {
                b.name: {
                    "unit": b.unit,
                    "clearance": b.clearance,
                    "certified": b.certified,
                    "deadband": b.deadband,
                    "fraction": b.fraction,
                    "violated": b.violated,
                }
                for b in leg.boundaries.values()
            }
            for leg in verdict.legs
        },
        "reasons": list(verdict.reasons),
    }


def shown(joints: Floats) -> list[float | None]:
    """Joints in deg, deg, mm, deg, deg; None for any that is not finite."""
    values = [float(q) if joint == 2 else math.degrees(float(q)) for joint, q in enumerate(joints)]
    return [value if math.isfinite(value) else None for value in values]
