"""The verdict as one JSON document (``cutgate.verdict/1``). NaN and infinity do not exist in it."""

import json
import math
from dataclasses import dataclass
from typing import Any, Final

from cutgate.runtime.verification.advice import Guidance, Move, OtherElbow
from cutgate.runtime.verification.verdict import Boundary, SpeedLine, Verdict

SCHEMA: Final = "cutgate.verdict/1"


@dataclass(frozen=True, slots=True)
class Digests:
    """What the verdict was made for, SHA-256 each, 32 bytes."""

    path: bytes
    limits: bytes
    calibration: bytes
    registration: bytes


def verdict_document(
    verdict: Verdict,
    *,
    poses: int,
    guidance: Guidance | None,
    digests: Digests,
    elapsed_ms: float,
    other_elbow: OtherElbow | None = None,
) -> dict[str, Any]:
    """The verdict as ``verify --json`` prints it; undefined values are None.

    Args:
        verdict: what the verifier answered.
        poses: how many poses the path has.
        guidance: how to move the bone, where it was computed; one that is not settled leaves null and a note.
        digests: of the records and files the verdict was made for.
        elapsed_ms: of the verification alone.
        other_elbow: whether the other elbow would admit the path, where that was asked.
    """
    return {
        "schema": SCHEMA,
        "verdict": "admissible" if verdict.admissible else "inadmissible",
        "method": verdict.method,
        "path": {
            "poses": poses,
            "tip_length_mm": _number(verdict.tip_length_mm),
            "wrist_length_mm": _number(verdict.wrist_length_mm),
            "axis_angle_deg": _degrees(verdict.axis_angle_rad),
        },
        "deadband": {
            "arm_mm": _number(verdict.deadband_arm_mm),
            "wrist_deg": _degrees(verdict.deadband_wrist_rad),
        },
        "branch": verdict.branch
        and {
            "elbow": verdict.branch.elbow,
            "q0_turns": int(verdict.branch.q0_turns),
            "roll_turns": int(verdict.branch.roll_turns),
        },
        "evaluations": {
            "arm": int(verdict.evaluations.arm),
            "wrist": int(verdict.evaluations.wrist),
            "worst_case": int(verdict.evaluations.worst_case),
            "best_case": _integer(verdict.evaluations.best_case),
        },
        "boundaries": {name: _boundary(boundary) for name, boundary in verdict.boundaries.items()},
        "speed": _speed(verdict),
        "acceleration": [_rate(line) for line in verdict.acceleration],
        "other_elbow": other_elbow and other_elbow.document,
        **guidance_entries(guidance),
        "digests": {
            "path": digests.path.hex(),
            "limits": digests.limits.hex(),
            "calibration": digests.calibration.hex(),
            "registration": digests.registration.hex(),
        },
        "elapsed_ms": _number(elapsed_ms),
    }


def document_text(document: dict[str, Any]) -> str:
    """The document as JSON text.

    Raises:
        ValueError: a number in it is not finite.
    """
    return json.dumps(document, allow_nan=False, indent=2)


def _boundary(boundary: Boundary) -> dict[str, Any]:
    """One boundary's worst place."""
    return {
        "unit": boundary.unit,
        "clearance": _number(boundary.clearance),
        "certified": _number(boundary.certified),
        "segment": _integer(boundary.segment),
        "fraction": _number(boundary.fraction),
        "tip_length_mm": _number(boundary.tip_length_mm),
        "violated": bool(boundary.violated),
    }


def _speed(verdict: Verdict) -> list[dict[str, Any]]:
    """Each joint's largest speed. A joint that accelerates too much is not ok either: the lines decide together."""
    hasty = {line.joint for line in verdict.acceleration if not line.ok}
    return [{**_rate(line), "ok": bool(line.ok and line.joint not in hasty)} for line in verdict.speed]


def _rate(line: SpeedLine) -> dict[str, Any]:
    """One joint's largest speed or acceleration."""
    return {
        "joint": int(line.joint),
        "limit": _number(line.limit),
        "peak": _number(line.peak),
        "segment": _integer(line.segment),
        "ok": bool(line.ok),
    }


def guidance_entries(guidance: Guidance | None, note: str = "") -> dict[str, Any]:
    """``guidance``; null where none is settled, and with what is known instead, or ``note``, as ``guidance_note``."""
    if guidance is not None and guidance.settled:
        return {"guidance": guidance_document(guidance)}
    known = note if guidance is None else guidance.text
    return {"guidance": None, **({"guidance_note": known} if known else {})}


def guidance_document(guidance: Guidance) -> dict[str, Any]:
    """The combined move and each boundary's own; what is not known of other translations is absent."""
    proved = {
        "none_possible": guidance.none_possible,
        "at_least_mm": guidance.at_least_mm,
        "reserve_mm": guidance.reserve_mm,
        "reserve_deg": guidance.reserve_deg,
    }
    return {
        "translation_mm": None if guidance.translation_mm is None else _vector(guidance.translation_mm),
        "yaw_deg": _number(guidance.yaw_deg),
        "pivot_mm": _vector(guidance.pivot_mm),
        "moves": [_move(move) for move in guidance.moves],
        "predicted_clearance_mm": _number(guidance.predicted_clearance_mm),
        "verified": bool(guidance.verified),
        **{key: value for key, value in proved.items() if value is not None},
    }


def _move(move: Move) -> dict[str, Any]:
    """One boundary's cure: a distance for a move, an angle for a turn."""
    amount = (
        {"distance_mm": _number(move.distance_mm)}
        if move.kind == "move"
        else {"angle_deg": _number(move.angle_deg)}
    )
    return {"boundary": move.boundary, "kind": move.kind, "direction": _vector(move.direction), **amount}


def _vector(vector: tuple[float, float, float]) -> list[float | None]:
    return [_number(value) for value in vector]


def _number(value: float | None) -> float | None:
    """A plain finite float; None for anything undefined."""
    return float(value) if value is not None and math.isfinite(value) else None


def _degrees(value_rad: float) -> float | None:
    return _number(math.degrees(value_rad))


def _integer(value: int | None) -> int | None:
    return None if value is None else int(value)
