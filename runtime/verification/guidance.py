"""Which way the bone must move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Vector = tuple[float, float, float]


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

    ``translation_mm`` is None when no translation was found; ``verified`` is True only if the
    moved and re-quantised path was admitted by the certified method.
    """

    translation_mm: Vector | None
    yaw_deg: float
    pivot_mm: Vector
    moves: tuple[Move, ...]
    predicted_clearance_mm: float | None
    verified: bool
    text: str
