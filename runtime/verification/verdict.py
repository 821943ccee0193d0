"""What a verifier answers. Boundaries are in mm or deg, as they are shown to people."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Unit = Literal["mm", "deg"]
Method = Literal["certified", "stocco"]
Quantity = Literal["speed", "acceleration"]

ARM_BOUNDARIES = ("inner", "outer", "left", "right", "top", "bottom")
"""Distances of the wrist centre, mm."""

WRIST_BOUNDARIES = ("roll_min", "roll_max", "pitch_min", "pitch_max", "wrist_singularity")
"""Angles, deg."""

BOUNDARIES = ARM_BOUNDARIES + WRIST_BOUNDARIES


@dataclass(frozen=True, slots=True)
class JointBranch:
    """The joint branch of the whole path: ``q = wrap(q) + 360 deg * turns`` at the first pose."""

    elbow: Literal["right", "left"]
    q0_turns: int
    roll_turns: int


@dataclass(frozen=True, slots=True)
class Winding:
    """What whole turns do for shoulder or roll, as the controller reports it.

    Attributes:
        joint: ``q0`` or ``q3``.
        least_deg: least angle found along the path in turn 0.
        most_deg: the largest.
        lower_deg: the joint's limits.
        upper_deg: the upper one.
        first: least turn that keeps the path within them, and within what a joints frame carries.
        last: the largest; less than ``first`` where no turn does.
    """

    joint: Literal["q0", "q3"]
    least_deg: float
    most_deg: float
    lower_deg: float
    upper_deg: float
    first: int
    last: int

    def range_deg(self, turns: int) -> tuple[float, float]:
        """Least and largest angle along the path in these turns."""
        return self.least_deg + 360.0 * turns, self.most_deg + 360.0 * turns

    @property
    def feasible(self) -> str:
        """The turns that fit, for people."""
        if self.first > self.last:
            return "none"
        return f"{self.first}" if self.first == self.last else f"{self.first} to {self.last}"


@dataclass(frozen=True, slots=True)
class Evaluations:
    """How many times a distance was evaluated for the arm and for the wrist; the bounds for the arm.

    ``best_case`` is the fewest with which the published march can admit, Stocco 2001, eq. (14); None for other methods.
    """

    arm: int
    wrist: int
    worst_case: int
    best_case: int | None = None


@dataclass(frozen=True, slots=True)
class Boundary:
    """The worst place of one boundary.

    Attributes:
        name: one of `BOUNDARIES`.
        unit: of all values here.
        clearance: smallest value found, attained at ``segment``, ``fraction``; None if undefined.
        certified: proven lower bound for the whole path; None if undefined.
        segment: index of the segment of the worst place.
        fraction: place in the segment, 0..1.
        tip_length_mm: arc length along the tip path to the worst place.
        deadband: what must be kept, residuals and tolerances included.
        violated: not (certified >= deadband).
    """

    name: str
    unit: Unit
    clearance: float | None
    certified: float | None
    segment: int | None
    fraction: float | None
    tip_length_mm: float | None
    deadband: float
    violated: bool


@dataclass(frozen=True, slots=True)
class SpeedLine:
    """Largest joint speed or acceleration at the planned feed; ``peak`` None if unbounded.

    Speeds in rad/s or mm/s; accelerations, inside the segments, in rad/s2 or mm/s2. ``peak`` is a proven bound, but
    for an acceleration above its limit the largest one found.
    """

    joint: int
    limit: float
    peak: float | None
    segment: int | None
    ok: bool
    quantity: Quantity = "speed"


@dataclass(frozen=True, slots=True)
class Verdict:
    """The whole answer; ``reasons`` says in sentences what keeps the path from being admitted.

    ``acceleration`` is empty where no limits are given; ``windings`` has shoulder and roll as far as they can be followed.
    """

    method: Method
    admissible: bool
    tip_length_mm: float
    wrist_length_mm: float
    axis_angle_rad: float
    deadband_arm_mm: float
    deadband_wrist_rad: float
    branch: JointBranch | None
    evaluations: Evaluations
    boundaries: dict[str, Boundary]
    speed: tuple[SpeedLine, ...]
    reasons: tuple[str, ...]
    acceleration: tuple[SpeedLine, ...] = ()
    windings: tuple[Winding, ...] = ()
