"""What the controller reports of itself: limits, calibration, tool. Counts of 1e-6 of the unit.

Signed 64-bit counts of 1e-6 deg, mm, mrad, deg/s, mm/s: the decimals of a configuration file are exact, and the
bytes are the same on every machine. In memory the properties give rad and mm. Order of joints: q0, q1 (deg),
q2 (mm), q3, q4 (deg).
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Decimal
from typing import ClassVar, Self

import numpy as np

from cutgate.protocol.arrays import Floats
from cutgate.protocol.wire import I64, Channel, Counts2, Counts5, Record, RecordError, Side

UNIT = 1_000_000
"""Counts in one deg, mm, mrad, deg/s, mm/s."""

NOT_GIVEN = (0, 0, 0, 0, 0)
"""Accelerations a controller does not report."""

SLIDE_MM_MAX = 5_242
"""The slide travel that a joints frame can report."""
ROTATION_DEG_MAX = 36_000
"""Stands for an unlimited joint."""
ROTATION_DEG_REPORTED = 2_621
"""The angle, either way, that a joints frame can report."""
ROTATION_DEG_GOES = ROTATION_DEG_REPORTED - 360
"""How far, either way, a cut may turn a joint: what a frame can report, with one revolution to spare."""
ROTATION_DEG_STANDS = 2_600
"""How far, either way, a joint may stand where an approach begins and a retract ends: it only comes back from there."""
SLIDE_TILT_MRAD_MAX = 20
LENGTH_MM_MAX = 10_000


def _counts(value: float, name: str, rounding: str) -> int:
    """Counts of 1e-6 of the unit. The shortest decimal of the number is taken, so file decimals are exact."""
    if not math.isfinite(value):
        raise RecordError(f"{name} is {value!r}, must be finite")
    return int((Decimal(repr(float(value))) * UNIT).to_integral_value(rounding))


def counts_up(value: float, name: str) -> int:
    """The least count not below the value (lower limits, residuals). Raises RecordError unless finite."""
    return _counts(value, name, ROUND_CEILING)


def counts_down(value: float, name: str) -> int:
    """The greatest count not above the value (upper limits, speeds). Raises RecordError unless finite."""
    return _counts(value, name, ROUND_FLOOR)


def counts_nearest(value: float, name: str) -> int:
    """The nearest count, ties to even. Raises RecordError unless finite."""
    return _counts(value, name, ROUND_HALF_EVEN)


def joints_to_memory(counts: Sequence[int]) -> Floats:
    """Counts of (deg, deg, mm, deg, deg) as (rad, rad, mm, rad, rad), shape (5,), read-only."""
    values = np.array([count / UNIT for count in counts], dtype=np.float64)
    turning = [0, 1, 3, 4]
    values[turning] = np.radians(values[turning])
    values.setflags(write=False)
    return values


def joints_to_counts(joints: Sequence[float] | Floats) -> tuple[int, ...]:
    """(rad, rad, mm, rad, rad) as nearest counts of (deg, deg, mm, deg, deg). Refuses non-finite values."""
    if len(joints) != 5:
        raise RecordError(f"joints are {len(joints)} values, must be 5")
    return tuple(
        counts_nearest(float(value) if joint == 2 else math.degrees(float(value)), f"q{joint}")
        for joint, value in enumerate(joints)
    )


@dataclass(frozen=True)
class Limits(Record):
    """Position, speed and acceleration limits per joint."""

    TYPE: ClassVar[int] = 0x10
    SENDER: ClassVar[Side] = Side.CONTROLLER
    CHANNEL: ClassVar[Channel] = Channel.BULK

    q_min_u: Counts5
    q_max_u: Counts5
    speed_u: Counts5
    acceleration_u: Counts5 = NOT_GIVEN

    @classmethod
    def quantised(
        cls,
        *,
        q_min_deg: Sequence[float],
        q_max_deg: Sequence[float],
        speed_deg_s: Sequence[float],
        acceleration_deg_s2: Sequence[float] | None = None,
    ) -> Self:
        """Limits rounded inward, at most 1e-6 deg or mm. The q2 entries are in mm, mm/s and mm/s².

        Raises:
            RecordError: a value is not finite or too large, or not five values a line.
        """
        return cls(
            q_min_u=tuple(counts_up(value, f"q{joint} lower limit") for joint, value in enumerate(q_min_deg)),
            q_max_u=tuple(
                counts_down(value, f"q{joint} upper limit") for joint, value in enumerate(q_max_deg)
            ),
            speed_u=tuple(
                counts_down(value, f"q{joint} speed limit") for joint, value in enumerate(speed_deg_s)
            ),
            acceleration_u=NOT_GIVEN
            if acceleration_deg_s2 is None
            else tuple(
                counts_down(value, f"q{joint} acceleration limit")
                for joint, value in enumerate(acceleration_deg_s2)
            ),
        )

    @functools.cached_property
    def q_min(self) -> Floats:
        """Lower limits, rad and mm, shape (5,)."""
        return joints_to_memory(self.q_min_u)

    @functools.cached_property
    def q_max(self) -> Floats:
        """Upper limits, rad and mm, shape (5,)."""
        return joints_to_memory(self.q_max_u)

    @functools.cached_property
    def speed(self) -> Floats:
        """Speed limits, rad/s and mm/s, shape (5,)."""
        return joints_to_memory(self.speed_u)

    @functools.cached_property
    def acceleration(self) -> Floats | None:
        """Acceleration limits, rad/s² and mm/s², shape (5,); None where the controller gives none."""
        return None if self.acceleration_u == NOT_GIVEN else joints_to_memory(self.acceleration_u)

    def problems(self) -> list[str]:
        """Why these limits cannot be a robot's; empty if they can. Each names joint, value and bound."""
        found = []
        if not any((*self.q_min_u, *self.q_max_u)):
            found.append("all position limits are zero: the controller has reported none")
        for joint, (low, high) in enumerate(zip(self.q_min_u, self.q_max_u, strict=True)):
            if not low < high:
                found.append(f"q{joint} lower limit {low / UNIT} is not below its upper limit {high / UNIT}")
            least, most = _PHYSICAL[joint]
            if not (least * UNIT <= low and high <= most * UNIT):
                found.append(
                    f"q{joint} limits [{low / UNIT}, {high / UNIT}] are not within [{least}, {most}]"
                )
        if self.q_min_u[1] < 0 < self.q_max_u[1]:
            found.append(
                f"q1 limits [{self.q_min_u[1] / UNIT}, {self.q_max_u[1] / UNIT}] span both elbows: one sign only"
            )
        found += [
            f"q{joint} speed limit {v / UNIT} is not > 0" for joint, v in enumerate(self.speed_u) if not v > 0
        ]
        if self.acceleration_u != NOT_GIVEN:
            found += [
                f"q{joint} acceleration limit {v / UNIT} is not > 0"
                for joint, v in enumerate(self.acceleration_u)
                if not v > 0
            ]
        return found


_PHYSICAL = (
    (-ROTATION_DEG_MAX, ROTATION_DEG_MAX),
    (-180, 180),
    (-SLIDE_MM_MAX, SLIDE_MM_MAX),
    (-ROTATION_DEG_MAX, ROTATION_DEG_MAX),
    (0, 180),
)


@dataclass(frozen=True)
class Calibration(Record):
    """Nominal links, their errors, joint offsets, the slide's tilt, and what the calibration left unexplained."""

    TYPE: ClassVar[int] = 0x11
    SENDER: ClassVar[Side] = Side.CONTROLLER
    CHANNEL: ClassVar[Channel] = Channel.BULK

    upper_link_u: I64
    forearm_link_u: I64
    upper_link_error_u: I64 = 0
    forearm_link_error_u: I64 = 0
    joint_offset_u: Counts5 = (0, 0, 0, 0, 0)
    slide_tilt_u: Counts2 = (0, 0)
    residual_mm_u: I64 = 0
    residual_deg_u: I64 = 0

    @classmethod
    def quantised(
        cls,
        *,
        upper_link_mm: float,
        forearm_link_mm: float,
        upper_link_error_mm: float = 0.0,
        forearm_link_error_mm: float = 0.0,
        joint_offset_deg: Sequence[float] = (0.0, 0.0, 0.0, 0.0, 0.0),
        slide_tilt_mrad: Sequence[float] = (0.0, 0.0),
        residual_mm: float = 0.0,
        residual_deg: float = 0.0,
    ) -> Self:
        """Residuals rounded up, everything else to the nearest count. The q2 offset is in mm.

        Raises:
            RecordError: a value is not finite or too large, or the number of offsets or tilts is wrong.
        """
        return cls(
            upper_link_u=counts_nearest(upper_link_mm, "upper link"),
            forearm_link_u=counts_nearest(forearm_link_mm, "forearm link"),
            upper_link_error_u=counts_nearest(upper_link_error_mm, "upper link error"),
            forearm_link_error_u=counts_nearest(forearm_link_error_mm, "forearm link error"),
            joint_offset_u=tuple(
                counts_nearest(v, f"q{joint} offset") for joint, v in enumerate(joint_offset_deg)
            ),
            slide_tilt_u=tuple(counts_nearest(value, "slide tilt") for value in slide_tilt_mrad),
            residual_mm_u=counts_up(residual_mm, "residual_mm"),
            residual_deg_u=counts_up(residual_deg, "residual_deg"),
        )

    @property
    def upper_mm(self) -> float:
        """Nominal upper link a0, mm."""
        return self.upper_link_u / UNIT

    @property
    def forearm_mm(self) -> float:
        """Nominal forearm a1, mm."""
        return self.forearm_link_u / UNIT

    @property
    def upper_link_error_mm(self) -> float:
        """True minus nominal upper link, mm."""
        return self.upper_link_error_u / UNIT

    @property
    def forearm_link_error_mm(self) -> float:
        """True minus nominal forearm, mm."""
        return self.forearm_link_error_u / UNIT

    @functools.cached_property
    def joint_offset(self) -> Floats:
        """True minus reported joints, rad and mm, shape (5,)."""
        return joints_to_memory(self.joint_offset_u)

    @functools.cached_property
    def slide_tilt(self) -> Floats:
        """Lean of the slide toward +x and +y, dimensionless, shape (2,)."""
        values = np.array([count / UNIT / 1000.0 for count in self.slide_tilt_u])
        values.setflags(write=False)
        return values

    @property
    def residual_mm(self) -> float:
        """Unexplained error of the wrist centre, mm."""
        return self.residual_mm_u / UNIT

    @property
    def residual_rad(self) -> float:
        """Unexplained error of the tool axis, rad."""
        return math.radians(self.residual_deg_u / UNIT)

    def problems(self) -> list[str]:
        """Why this cannot be an arm's calibration; empty if it can. Each names value and bound."""
        found = []
        for name, nominal, error in (
            ("upper link", self.upper_link_u, self.upper_link_error_u),
            ("forearm link", self.forearm_link_u, self.forearm_link_error_u),
        ):
            if not 0 < nominal <= LENGTH_MM_MAX * UNIT:
                found.append(f"{name} {nominal / UNIT} mm is not in (0, {LENGTH_MM_MAX}]")
            if not 0 < nominal + error <= LENGTH_MM_MAX * UNIT:
                found.append(f"true {name} {(nominal + error) / UNIT} mm is not in (0, {LENGTH_MM_MAX}]")
        for joint, offset in enumerate(self.joint_offset_u):
            bound = SLIDE_MM_MAX if joint == 2 else 180
            if not abs(offset) <= bound * UNIT:
                found.append(f"q{joint} offset {offset / UNIT} is not within +-{bound}")
        found += [
            f"slide tilt {tilt / UNIT} mrad is not within +-{SLIDE_TILT_MRAD_MAX}"
            for tilt in self.slide_tilt_u
            if not abs(tilt) <= SLIDE_TILT_MRAD_MAX * UNIT
        ]
        if not 0 <= self.residual_mm_u <= LENGTH_MM_MAX * UNIT:
            found.append(f"residual {self.residual_mm_u / UNIT} mm is not in [0, {LENGTH_MM_MAX}]")
        if not 0 <= self.residual_deg_u <= 90 * UNIT:
            found.append(f"residual {self.residual_deg_u / UNIT} deg is not in [0, 90]")
        return found


@dataclass(frozen=True)
class Tool(Record):
    """The mounted tool."""

    TYPE: ClassVar[int] = 0x12
    SENDER: ClassVar[Side] = Side.CONTROLLER
    CHANNEL: ClassVar[Channel] = Channel.BULK

    length_u: I64

    @classmethod
    def quantised(cls, *, length_mm: float) -> Self:
        """Length to the nearest count. Raises RecordError unless finite."""
        return cls(length_u=counts_nearest(length_mm, "tool length"))

    @property
    def length_mm(self) -> float:
        """Wrist centre to cutter tip, mm."""
        return self.length_u / UNIT

    def problems(self) -> list[str]:
        """Why this cannot be a tool; empty if it can."""
        if not 0 <= self.length_u <= LENGTH_MM_MAX * UNIT:
            return [f"tool length {self.length_mm} mm is not in [0, {LENGTH_MM_MAX}]"]
        return []
