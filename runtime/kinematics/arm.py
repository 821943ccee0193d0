"""Joints to pose and back, with the exact calibration.

Frames and joints as in the docs: ``q = (q0, q1, q2, q3, q4)``, rad and mm (q2).
Calibration in closed form: true joint = reported + offset, true link = nominal + error, and the
slide's lean is a shear of the wrist centre, ``w_xy += q2 * tilt``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cutgate.protocol.arrays import Floats

REVOLUTION = 2.0 * math.pi


def wrap(angle: Floats) -> Floats:
    """Angles modulo a turn into (-pi, pi]."""
    return angle - REVOLUTION * turns(angle)


def turns(angle: Floats) -> Floats:
    """Whole turns k such that ``angle - 2 pi k`` lies in (-pi, pi]."""
    return np.ceil((angle - math.pi) / REVOLUTION)


@dataclass(frozen=True, slots=True)
class TrueArm:
    """The arm as it really is: true links, offsets and slide tilt.

    Attributes:
        upper_mm, forearm_mm: true links a0, a1.
        side: +1 right elbow (q1 > 0), -1 left elbow.
        offset: true minus reported joints, shape (5,).
        tilt: lean of the slide toward x and y, ratio, shape (2,).
    """

    upper_mm: float
    forearm_mm: float
    side: float
    offset: Floats
    tilt: Floats

    def pose(self, joints: Floats, tool_length_mm: float) -> tuple[Floats, Floats]:
        """Tip (n, 3) and unit axis (n, 3) of reported joints (n, 5)."""
        q = joints + self.offset
        heading = q[:, 0] + q[:, 1]
        azimuth = heading + q[:, 3]
        sine = np.sin(q[:, 4])
        axes = np.stack((sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(q[:, 4])), axis=1)
        wrist = np.stack(
            (
                self.upper_mm * np.cos(q[:, 0]) + self.forearm_mm * np.cos(heading) + q[:, 2] * self.tilt[0],
                self.upper_mm * np.sin(q[:, 0]) + self.forearm_mm * np.sin(heading) + q[:, 2] * self.tilt[1],
                q[:, 2],
            ),
            axis=1,
        )
        return wrist - tool_length_mm * axes, axes

    def joints(self, tips_mm: Floats, axes: Floats, tool_length_mm: float) -> Floats:
        """Reported joints (n, 5), angles wrapped to (-pi, pi]; NaN where out of reach.

        A vertical axis leaves the roll undefined: its azimuth then counts as zero.
        """
        wrist = tips_mm + tool_length_mm * axes
        planar = wrist[:, :2] - wrist[:, 2:] * self.tilt
        r = np.hypot(planar[:, 0], planar[:, 1])
        elbow = elbow_angle(r, self.upper_mm, self.forearm_mm)
        beta = shoulder_offset(elbow, self.upper_mm, self.forearm_mm)
        q = np.empty((len(tips_mm), 5))
        q[:, 0] = np.arctan2(planar[:, 1], planar[:, 0]) - self.side * beta
        q[:, 1] = self.side * elbow
        q[:, 2] = wrist[:, 2]
        q[:, 3] = np.arctan2(axes[:, 1], axes[:, 0]) - q[:, 0] - q[:, 1]
        q[:, 4] = np.arctan2(np.hypot(axes[:, 0], axes[:, 1]), axes[:, 2])
        q -= self.offset
        for j in (0, 3):
            q[:, j] = wrap(q[:, j])
        return q


def elbow_sine(r: Floats, a0: float, a1: float) -> Floats:
    """Sine of the elbow angle at radius r, in 0..1; NaN out of reach.

    Heron's form: no cancellation beyond that of r against the straight and the folded arm.
    """
    with np.errstate(invalid="ignore"):
        out: Floats = np.sqrt((a0 + a1 - r) * (a0 + a1 + r) * (r - abs(a0 - a1)) * (r + abs(a0 - a1)))
    return out / (2.0 * a0 * a1)


def elbow_angle(r: Floats, a0: float, a1: float) -> Floats:
    """Angle of the right elbow, 0..pi, at radius r; NaN out of reach."""
    out: Floats = np.arctan2(elbow_sine(r, a0, a1), (r * r - a0 * a0 - a1 * a1) / (2.0 * a0 * a1))
    return out


def heading_offset(r: Floats, a0: float, a1: float) -> Floats:
    """Angle from the line shoulder-wrist to the forearm, right elbow, at radius r; NaN out of reach.

    The law of cosines, its difference of squares factored: as well conditioned as `elbow_sine`.
    """
    across = 2.0 * a0 * a1 * elbow_sine(r, a0, a1)
    out: Floats = np.arctan2(across, r * r + (a1 - a0) * (a1 + a0))
    return out


def shoulder_offset(elbow: Floats, a0: float, a1: float) -> Floats:
    """Angle beta from the upper link to the line shoulder-wrist, right elbow."""
    out: Floats = np.arctan2(a1 * np.sin(elbow), a0 + a1 * np.cos(elbow))
    return out
