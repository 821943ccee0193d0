"""A problem in canonical form: right elbow, true links, true limits, segments ready to evaluate.

A left elbow is the mirror image in the plane y = 0: q0, q1, q3 and their limits change sign, left
and right change places, and so do the two ends of the roll.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cutgate.protocol.arrays import Floats, Ints
from cutgate.runtime.kinematics.pose import lengths, turn_angles
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.workspace.planar import Arc, PlanarWorkspace

EPSILON = float(np.finfo(np.float64).eps)

ROUNDINGS = 256.0
"""Bound on the rounding steps between an input and a bound, each at most one machine epsilon of the
largest intermediate: a distance to a segment takes under 60 operations, and conditioning is carried
beside it (1 / sin q1 for headings, 1 / sin q4 for azimuths)."""

VERTICAL = 1e-9
"""Below this sine of the pitch an axis counts as exactly vertical and its azimuth as undefined."""

MIRRORED_SIDES = {"left": "right", "right": "left"}
"""Of the planar boundaries alone, where those of the roll are named already."""
MIRRORED = {**MIRRORED_SIDES, "roll_min": "roll_max", "roll_max": "roll_min"}
"""What the boundaries of a left elbow are called on its mirror image, and the other way round."""

LARGEST_TURN = math.radians(179.0)
"""Neighbouring axes further apart have no usable great circle."""


@dataclass(frozen=True, slots=True)
class Geometry:
    """The arm, its true limits and the deadbands, right elbow.

    Attributes:
        side: +1 as given, -1 mirrored from a left elbow.
        lower: true joint limits, shape (5,); q1 not yet cut.
        upper: the same, shape (5,).
        offset: true minus reported joints, shape (5,).
        tilt: slide tilt as a ratio, shape (2,).
        stretch: largest growth of a length by the tilt's shear.
        tool_mm: wrist centre to tip.
        workspace: exact planar workspace in slide coordinates.
        arcs: its four arcs.
        arm_mm: deadband of the arm and the slide, residual and tolerance included.
        wrist_rad: deadband of the wrist, residual and tolerance included.
        error_mm: residual and tolerance of the wrist centre alone, in slide coordinates.
        error_rad: residual and tolerance of the axis alone.
        pad_mm: bound on the rounding of a computed distance.
    """

    side: float
    lower: Floats
    upper: Floats
    offset: Floats
    tilt: Floats
    stretch: float
    tool_mm: float
    workspace: PlanarWorkspace
    arcs: tuple[Arc, ...]
    arm_mm: float
    wrist_rad: float
    error_mm: float
    error_rad: float
    pad_mm: float

    @property
    def signs(self) -> Floats:
        """Signs that mirror a left elbow's joints into the canonical arm, and back; shape (5,)."""
        return joint_signs(self.side)


@dataclass(frozen=True, slots=True)
class Segments:
    """Straight tip, great-circle axis, one parameter 0..1. Arrays over n segments.

    Attributes:
        tip: tips at the start of each segment and one more, shape (n + 1, 3).
        axis: axes likewise, shape (n + 1, 3).
        theta: turn of the axis, rad, shape (n,).
        seconds: planned duration, shape (n,).
    """

    tip: Floats
    axis: Floats
    theta: Floats
    seconds: Floats

    def __len__(self) -> int:
        return len(self.theta)

    def normals(self, rows: Ints) -> tuple[Floats, Floats]:
        """Bounds on the height (z, unsigned) of the great circle's unit normal in some segments, shape (m,) each.

        A cross product of unit vectors is exact to a few epsilon, its direction to that over theta.
        """
        u, v = self.axis[rows], self.axis[rows + 1]
        turning = np.maximum(self.theta[rows], 16.0 * EPSILON)
        slack = 16.0 * EPSILON / turning
        normal = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / np.sin(turning)
        return np.maximum(normal - slack, 0.0), np.minimum(normal + slack, 1.0)


def canonical(problem: Problem) -> tuple[Geometry, Segments]:
    """Bring a problem with finite numbers into canonical form."""
    geometry = canonical_arm(problem)
    if geometry.side > 0.0:
        return geometry, _segments(problem.tips_mm, problem.axes, problem)
    mirror = np.array((1.0, -1.0, 1.0))
    return geometry, _segments(problem.tips_mm * mirror, problem.axes * mirror, problem)


def canonical_arm(problem: Problem) -> Geometry:
    """The arm alone in canonical form; of the path only how far its tips are from the origin."""
    side = 1.0 if problem.arm.elbow == "right" else -1.0
    signs = joint_signs(side)
    calibration = problem.calibration
    lower, upper = problem.lower.tolist(), problem.upper.tolist()
    for j, (sign, offset) in enumerate(zip(signs.tolist(), calibration.joint_offset.tolist(), strict=True)):
        if lower[j] > upper[j]:  # stays empty instead of being mended by the sorting
            lower[j], upper[j] = math.inf, -math.inf
        else:
            lower[j], upper[j] = sorted(((lower[j] + offset) * sign, (upper[j] + offset) * sign))
    workspace = PlanarWorkspace(
        a0=problem.arm.upper_mm + calibration.upper_link_error_mm,
        a1=problem.arm.forearm_mm + calibration.forearm_link_error_mm,
        q0_lo=lower[0],
        q0_hi=upper[0],
        q1_lo=max(lower[1], 0.0),
        q1_hi=min(upper[1], math.pi),
    )
    tilt = calibration.slide_tilt * (1.0, side)
    stretch = math.sqrt(1.0 + float(tilt @ tilt))
    error_mm, error_rad = errors(problem)
    largest = workspace.a0 + workspace.a1 + problem.tool_length_mm + float(np.abs(problem.tips_mm).max())
    return Geometry(
        side=side,
        lower=np.array(lower),
        upper=np.array(upper),
        offset=calibration.joint_offset * signs,
        tilt=tilt,
        stretch=stretch,
        tool_mm=problem.tool_length_mm,
        workspace=workspace,
        arcs=() if workspace.empty else workspace.arcs,
        arm_mm=problem.deadband.arm_mm + error_mm,
        wrist_rad=problem.deadband.wrist_rad + error_rad,
        error_mm=error_mm,
        error_rad=error_rad,
        pad_mm=ROUNDINGS * EPSILON * largest,
    )


def joint_signs(side: float) -> Floats:
    """Sign of each joint for the elbow's side, +1 or -1; shape (5,)."""
    return np.array((side, side, 1.0, side, 1.0))


def errors(problem: Problem) -> tuple[float, float]:
    """How far wrist centre (mm, slide coordinates) and tool axis (rad) may be off: residual and tolerance together.

    The ball about a wrist centre lies in a disc of slide coordinates larger by the shear of the slide's lean.
    """
    calibration, deadband = problem.calibration, problem.deadband
    stretch = math.sqrt(1.0 + float((calibration.slide_tilt**2).sum()))
    return (
        (calibration.residual_mm + deadband.path_tolerance_mm) * stretch,
        calibration.residual_rad + deadband.path_tolerance_rad,
    )


def _segments(tip: Floats, axis: Floats, problem: Problem) -> Segments:
    if len(tip) == 1:  # a path of one pose is a segment of length zero
        tip, axis = np.repeat(tip, 2, axis=0), np.repeat(axis, 2, axis=0)
    theta = turn_angles(axis[:-1], axis[1:])
    length = lengths(tip[1:] - tip[:-1])
    return Segments(
        tip=tip,
        axis=axis,
        theta=theta,
        seconds=np.maximum(length, problem.tool_length_mm * theta) / problem.feed_mm_s,
    )
