"""What is asked of an approach and a retract, and what is answered."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from cutgate.protocol.arrays import Floats
from cutgate.protocol.records import joints_to_memory
from cutgate.runtime.verification.bounds.geometry import Geometry
from cutgate.runtime.verification.verdict import Boundary

LegName = Literal["approach", "entry", "exit", "retract"]


@dataclass(frozen=True, slots=True)
class StartJoints:
    """Where the arm stands, and how the site wants it to come and go.

    Attributes:
        joints: measured reported joints, rad and mm, shape (5,).
        clearance_um: entry and exit beyond everything that is cut.
        tolerance_mm: how far the wrist centre may be off the start joints' when it begins.
        tolerance_rad: how far a turning joint may be.
    """

    joints: Floats
    clearance_um: int
    tolerance_mm: float = 0.0
    tolerance_rad: float = 0.0

    @classmethod
    def of(
        cls, joints_u: tuple[int, ...], *, clearance_um: int, tolerance_mm: float, tolerance_deg: float
    ) -> StartJoints:
        """From joints in counts of 1e-6 deg | mm, as a permit binds them."""
        return cls(joints_to_memory(joints_u), clearance_um, tolerance_mm, math.radians(tolerance_deg))


@dataclass(frozen=True, slots=True)
class LegVerdict:
    """One line of the four: each boundary's worst place, and in sentences what it lacks.

    ``at_start`` are those of the sentences that speak of the start joints.
    """

    name: LegName
    boundaries: dict[str, Boundary]
    reasons: tuple[str, ...]
    at_start: frozenset[str] = frozenset()

    @property
    def violated(self) -> bool:
        """Whether it lacks anything."""
        return bool(self.reasons) or any(b.violated for b in self.boundaries.values())


@dataclass(frozen=True, slots=True)
class ApproachVerdict:
    """The answer. ``admissible`` only if every leg keeps every deadband.

    Attributes:
        admissible: whether the arm may go this way.
        entry_um: from the first pose along its axis to the entry pose.
        exit_um: from the last pose likewise.
        entry: reported joints at the entry pose, in the cut's branch; None where there are none.
        exit: the same at the exit pose.
        legs: in the order of motion; empty where nothing could be verified.
        reasons: sentences of all legs.
    """

    admissible: bool
    entry_um: int
    exit_um: int
    entry: Floats | None
    exit: Floats | None
    legs: tuple[LegVerdict, ...]
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class StraightLines:
    """Entry and exit with the lines between them and the cut: all that does not depend on where the arm stands.

    Attributes:
        geometry: of the cut.
        roll_held: whether the cut holds a declared roll.
        entry_um: as in `ApproachVerdict`.
        exit_um: likewise.
        entry: likewise; NaN where there are none.
        exit: likewise.
        inward: from the entry pose to the first pose.
        outward: from the last pose to the exit pose.
    """

    geometry: Geometry
    roll_held: bool
    entry_um: int
    exit_um: int
    entry: Floats
    exit: Floats
    inward: LegVerdict
    outward: LegVerdict

    @property
    def admissible(self) -> bool:
        """Whether both lines keep every deadband; the joint lines are another question."""
        return not any(leg.violated for leg in (self.inward, self.outward))


def refused(reasons: tuple[str, ...]) -> ApproachVerdict:
    """Not admissible, and nothing is verified."""
    return ApproachVerdict(False, 0, 0, None, None, (), reasons)


def not_at_least_0(name: str, value: float) -> list[str]:
    """A sentence about a number that is not finite and at least 0."""
    return [] if 0.0 <= value < math.inf else [f"{name} is {value}, must be finite and at least 0"]
