"""What every verifier takes: one path, one arm, its limits, and the deadbands to keep.

Plain numbers in mm and rad; nothing in here reads files or knows the wire.
Joint vectors are ``(q0, q1, q2, q3, q4)``; the third entry is in mm, the others in rad.

Example:
    The ``stroke`` of the verifiers' examples: 24.5 mm, the tool tilted by 30 deg, away from every limit.

    >>> import numpy as np
    >>> limits = np.radians([[-80, 0, 0, -170, 0], [80, 145, 0, 170, 110]])
    >>> limits[:, 2] = 50, 450  # the slide's, mm
    >>> stroke = Problem(
    ...     tips_mm=np.array([[500.0, 50.0, 120.0], [520.0, 60.0, 110.0]]),
    ...     axes=np.array([[0.5, 0.0, 0.75**0.5]] * 2),
    ...     feed_mm_s=10.0,
    ...     tool_length_mm=160.0,
    ...     arm=Arm(450.0, 450.0, "right"),
    ...     lower=limits[0],
    ...     upper=limits[1],
    ...     speed=np.array([1.0, 1.0, 100.0, 3.0, 3.0]),
    ...     deadband=Deadband(arm_mm=5.0, wrist_rad=np.radians(2.0)),
    ... )
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from cutgate.protocol.arrays import Floats


def _zeros(n: int) -> Floats:
    return np.zeros(n)


@dataclass(frozen=True, slots=True)
class Arm:
    """Nominal links and the elbow configuration of the whole procedure."""

    upper_mm: float
    forearm_mm: float
    elbow: Literal["right", "left"]


@dataclass(frozen=True, slots=True)
class ArmCalibration:
    """What calibration found: exact corrections, and residuals it left unexplained.

    ``joint_offset`` (5,): true = reported + offset. ``slide_tilt`` (2,): lean of the slide
    toward +x and +y as a ratio (mrad / 1000), ``w_xy += q2_true * slide_tilt``.
    """

    upper_link_error_mm: float = 0.0
    forearm_link_error_mm: float = 0.0
    joint_offset: Floats = field(default_factory=lambda: _zeros(5))
    slide_tilt: Floats = field(default_factory=lambda: _zeros(2))
    residual_mm: float = 0.0
    residual_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Deadband:
    """Margins to keep; the tolerances say how far the controller may leave the path."""

    arm_mm: float
    wrist_rad: float
    path_tolerance_mm: float = 0.0
    path_tolerance_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Problem:
    """A path to verify.

    Attributes:
        tips_mm: tip positions in robot coordinates, shape (n, 3).
        axes: unit tool axes from the tip toward the holder, shape (n, 3).
        feed_mm_s: planned feed along the tip path.
        tool_length_mm: wrist centre to cutter tip.
        arm: nominal links and elbow.
        lower, upper: limits of the reported joints, shape (5,).
        speed: joint speed limits, rad/s and mm/s, shape (5,).
        acceleration: joint acceleration limits, rad/s2 and mm/s2, shape (5,), or None where none are given.
        closely: every segment is bounded closely, without a look at all of them before; slower, to other digits of the same promise.
        calibration: corrections and residuals.
        deadband: margins to keep.
        hold_roll: roll held by a path of constant exactly vertical axis, or None.
        branch: (q0_turns, roll_turns) to check, or None to try all and keep the best.
    """

    tips_mm: Floats
    axes: Floats
    feed_mm_s: float
    tool_length_mm: float
    arm: Arm
    lower: Floats
    upper: Floats
    speed: Floats
    deadband: Deadband
    calibration: ArmCalibration = field(default_factory=ArmCalibration)
    hold_roll: float | None = None
    branch: tuple[int, int] | None = None
    acceleration: Floats | None = None
    closely: bool = False
