"""What is said beside a verdict that does not admit: how the bone must move, whether the other elbow would do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from cutgate.protocol.arrays import Vector


@dataclass(frozen=True, slots=True)
class Move:
    """First-order cure of one boundary's worst place alone."""

    boundary: str
    kind: Literal["move", "turn"]
    direction: Vector
    distance_mm: float | None = None
    angle_deg: float | None = None


@dataclass(frozen=True, slots=True)
class Guidance:
    """One combined move of the bone, in the robot frame.

    The new registration is ``Trans(translation) * Rz(yaw about pivot) * R_T_CT``.

    Attributes:
        translation_mm: None when no move was found.
        yaw_deg: turn about the vertical through the pivot, before the translation.
        pivot_mm: the mean tip.
        moves: a hint for each violated boundary.
        predicted_clearance_mm: smallest proven clearance of the arm after the move.
        verified: whether the moved and re-quantised path was admitted by the certified method.
        text: what was found and proved, in sentences.
        none_possible: True if it is proved that no translation alone makes the path admissible, False
            if one does, None if neither is known.
        at_least_mm: with a translation alone: proved length of the shortest that keeps the reserve; rounded down.
        reserve_mm: what that proof keeps beyond the deadband of arm and slide.
        reserve_deg: and beyond that of the roll.
    """

    translation_mm: Vector | None
    yaw_deg: float
    pivot_mm: Vector
    moves: tuple[Move, ...]
    predicted_clearance_mm: float | None
    verified: bool
    text: str
    none_possible: bool | None = None
    at_least_mm: float | None = None
    reserve_mm: float | None = None
    reserve_deg: float | None = None

    @property
    def settled(self) -> bool:
        """Whether a verified move is shown, or that no translation helps is proved; else only `text` says anything."""
        return self.verified or self.none_possible is True


@dataclass(frozen=True, slots=True)
class OtherElbow:
    """The answer.

    Attributes:
        elbow: the configuration asked about.
        q1_deg: the limits it was taken to have, those of this one mirrored.
        admissible: None where it is not proved.
        text: the same in a sentence.
    """

    elbow: Literal["right", "left"]
    q1_deg: tuple[float, float]
    admissible: bool | None
    text: str

    @property
    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "elbow": self.elbow,
            "q1_deg": list(self.q1_deg),
            "admissible": self.admissible,
            "text": self.text,
        }
