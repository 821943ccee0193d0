"""Certified bounds of every quantity over intervals of the path.

All quantities are written so that small is bad; a *column* of bounds is a lower bound over the whole
interval, padded for rounding. Over an interval the wrist centre stays within ``sag = l phi^2 / 8`` of
its chord; joint angles stay within second-order bounds of their own chords (derivations beside the
formulas), so halving an interval shrinks every gap fourfold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cutgate.protocol.arrays import Bools, Floats
from cutgate.runtime.verification.bounds.acceleration import bounded_accelerations
from cutgate.runtime.verification.bounds.chain import Intervals
from cutgate.runtime.verification.bounds.geometry import EPSILON, ROUNDINGS, Geometry, Segments
from cutgate.runtime.verification.bounds.motion import Angles, Motion, angles_of, motion_of
from cutgate.runtime.verification.bounds.points import Points
from cutgate.runtime.workspace.distance import signed_sides
from cutgate.runtime.workspace.planar import segment_to_arc

INNER, OUTER, LEFT, RIGHT, ROLL_MIN, ROLL_MAX, Q0_MIN, Q0_MAX, SPEED = range(9)
ACCELERATION = SPEED + 5
COLUMNS = ACCELERATION + 5
"""Four arcs (mm), least roll, minus largest roll, the same for q0 (rad), minus the five joint speeds and the five
joint accelerations."""

HALF_TURN = math.pi + 1e-9
"""The contract counts an unwrapped shoulder limit up to half a turn away; the rest is for rounding."""


@dataclass(frozen=True, slots=True)
class Scope:
    """What is asked of a survey.

    Attributes:
        wanted: columns to bound, shape (COLUMNS,).
        reachable: whether the joint limits leave any planar workspace at all.
        winding_known: whether the winding about the column is known.
        roll_defined: whether besides the azimuth of the axis is defined.
        shoulder_shift: added to the unwrapped q0 where left and right count by unwrapped q0, else None.
        alone: whether each interval has to be bounded without what is known of the larger one it was cut from.
    """

    wanted: Bools
    reachable: bool
    winding_known: bool
    roll_defined: bool
    shoulder_shift: float | None = None
    alone: bool = False

    @property
    def undefined(self) -> Bools:
        """Columns that have no meaning on this path, shape (COLUMNS,)."""
        out = np.zeros(COLUMNS, dtype=np.bool_)
        out[:ROLL_MIN] = not self.reachable
        out[[Q0_MIN, Q0_MAX, SPEED, SPEED + 1, ACCELERATION, ACCELERATION + 1]] = not self.winding_known
        out[[ROLL_MIN, ROLL_MAX, SPEED + 3, ACCELERATION + 3]] = not self.roll_defined
        return out


def attained(geometry: Geometry, scope: Scope, points: Points) -> Floats:
    """Values at points, shape (m, SPEED); infinite where undefined or not wanted."""
    out = np.full((len(points), SPEED), np.inf)
    out[:, :LEFT] = (
        sides := signed_sides(
            points.distances, points.inside, full_revolution=geometry.workspace.full_revolution
        )
    )[:, :LEFT]
    if scope.shoulder_shift is not None:
        q0 = points.shoulder + scope.shoulder_shift
        for column, excess in ((LEFT, q0 - geometry.upper[0]), (RIGHT, geometry.lower[0] - q0)):
            d = points.distances[:, column]
            out[:, column] = np.where(np.abs(excess) <= HALF_TURN, np.where(excess <= 0.0, d, -d), np.inf)
    elif not geometry.workspace.full_revolution:
        out[:, LEFT:ROLL_MIN] = sides[:, LEFT:]
    if scope.roll_defined:
        out[:, ROLL_MIN] = points.roll - points.widening[:, 0]
        out[:, ROLL_MAX] = -(points.roll + points.widening[:, 1])
    if scope.winding_known:
        out[:, Q0_MIN] = points.shoulder
        out[:, Q0_MAX] = -points.shoulder
    out[np.isnan(out)] = np.inf
    out[:, ~scope.wanted[:SPEED]] = np.inf
    return out


def lower_bounds(
    geometry: Geometry, segments: Segments, scope: Scope, parts: Intervals, floor: Floats
) -> tuple[Floats, Floats, Floats]:
    """Bound every wanted column over every interval.

    Args:
        geometry: canonical arm.
        segments: the path.
        scope: what is wanted.
        parts: m intervals.
        floor: a bound at or above this needs no closer look, shape (COLUMNS,).

    Returns:
        Lower bounds (m, COLUMNS); attained joint speeds and accelerations, negative, (m, 10): the speeds are the
        means over the interval and hence attained within, the accelerations are those of its middle, infinite
        where the bound sufficed; where to cut each interval best, (m,).
    """
    motion = motion_of(geometry, segments, parts)
    bounds = np.full((len(parts), COLUMNS), np.inf)
    cut = np.full(len(parts), 0.5)
    if scope.wanted[:ROLL_MIN].any():
        bounds[:, :ROLL_MIN], cut = _arc_bounds(geometry, scope, parts, motion, floor)
    rates = np.full((len(parts), COLUMNS - SPEED), np.inf)
    if scope.wanted[ROLL_MIN:].any() or scope.shoulder_shift is not None:
        angles = angles_of(geometry, segments, parts, motion)
        if scope.shoulder_shift is not None:
            bounds[:, LEFT:ROLL_MIN] = _unwrapped_bounds(
                geometry, scope.shoulder_shift, parts, (motion, angles), bounds[:, LEFT:ROLL_MIN]
            )
        _bound_angles(parts, angles, bounds)
        rates[:, :5] = _bound_speeds(geometry, parts, motion, angles, bounds)
        if scope.wanted[ACCELERATION:].any():
            bounds[:, ACCELERATION:], rates[:, 5:] = bounded_accelerations(
                geometry, segments, parts, (motion, angles), floor[ACCELERATION:]
            )
    undefined = scope.undefined
    bounds[:, undefined], rates[:, undefined[SPEED:]] = -np.inf, np.inf
    bounds[np.isnan(bounds)] = -np.inf
    bounds[:, ~scope.wanted] = np.inf
    rates[:, ~scope.wanted[SPEED:]] = np.inf
    rates[np.isnan(rates)] = np.inf
    if not scope.alone:  # a half may bulge toward a boundary more than its whole seen from the whole's chord
        bounds = np.maximum(bounds, np.where(scope.wanted, parts.bound, np.inf))
    return bounds, rates, cut


def _arc_bounds(
    geometry: Geometry, scope: Scope, parts: Intervals, motion: Motion, floor: Floats
) -> tuple[Floats, Floats]:
    """Distances to the four arcs: by Lipschitz first, the closed form of the chord where that is too weak."""
    mean = (parts.a.distances + parts.b.distances) / 2
    near = mean - (motion.chord / 2 + motion.sag)[:, None]
    far = mean + (motion.chord / 2 + motion.sag)[:, None]
    cut, lacking = np.full(len(parts), 0.5), np.zeros(len(parts))
    for column, arc in enumerate(geometry.arcs):
        if not scope.wanted[column]:
            continue
        weak = np.flatnonzero(~(near[:, column] >= max(float(floor[column]), geometry.pad_mm)))
        if len(weak) == 0:
            continue
        distance, where = segment_to_arc(parts.a.centre[weak], parts.b.centre[weak], arc)
        near[weak, column] = np.maximum(near[weak, column], distance - motion.sag[weak])
        lack = floor[column] - near[weak, column]
        worse = (lack > lacking[weak]) & (where > 0.01) & (where < 0.99)
        lacking[weak[worse]], cut[weak[worse]] = lack[worse], where[worse]
    bounding = LEFT if geometry.workspace.full_revolution else ROLL_MIN
    touching = ~(parts.a.inside & parts.b.inside & (near[:, :bounding] > 0.0).all(axis=1))
    rows = np.flatnonzero(touching)
    near[rows, :bounding] = _outside(near[rows, :bounding], far[rows, :bounding])
    return near, cut


def _outside(near: Floats, far: Floats) -> Floats:
    """Signed bounds where the interval may leave the workspace: minus the distance if perhaps nearest."""
    near = np.maximum(near, 0.0)
    out = near.copy()
    for column in range(near.shape[1]):
        others = np.delete(far, column, axis=1).min(axis=1)
        out[:, column] = np.where(near[:, column] > others, near[:, column], -far[:, column])
    return out


def _bound_angles(parts: Intervals, angles: Angles, bounds: Floats) -> None:
    """Roll and q0: the better of the chord of the angle and of its steepness about the middle.

    The azimuth is monotone along a great circle, so its ends are its range.
    """
    a, b = parts.a, parts.b
    middle = (a.heading + b.heading) / 2
    first_order, second_order = angles.heading / 2, (angles.azimuth2 + angles.heading2) / 8
    with np.errstate(invalid="ignore"):
        least = np.fmax(
            np.minimum(a.roll, b.roll) - second_order, np.minimum(a.azimuth, b.azimuth) - middle - first_order
        )
        most = np.fmin(
            np.maximum(a.roll, b.roll) + second_order, np.maximum(a.azimuth, b.azimuth) - middle + first_order
        )
        bounds[:, ROLL_MIN] = least - angles.widening[:, 0] - angles.pad - angles.azimuth_pad
        bounds[:, ROLL_MAX] = -(most + angles.widening[:, 1] + angles.pad + angles.azimuth_pad)
        low, high = _shoulder_range(parts, angles)
        bounds[:, Q0_MIN], bounds[:, Q0_MAX] = low, -high


def _shoulder_range(parts: Intervals, angles: Angles) -> tuple[Floats, Floats]:
    qa, qb = parts.a.shoulder, parts.b.shoulder
    middle, first_order, second_order = (qa + qb) / 2, angles.shoulder / 2, angles.shoulder2 / 8
    low = np.fmax(np.minimum(qa, qb) - second_order, middle - first_order) - angles.pad
    high = np.fmin(np.maximum(qa, qb) + second_order, middle + first_order) + angles.pad
    return low, high


def _unwrapped_bounds(
    geometry: Geometry, shift: float, parts: Intervals, known: tuple[Motion, Angles], near: Floats
) -> Floats:
    """Left and right of a shoulder with a full turn or more: they count by the unwrapped q0."""
    motion, angles = known
    far = (parts.a.distances + parts.b.distances)[:, LEFT:] / 2 + (motion.chord / 2 + motion.sag)[:, None]
    low, high = _shoulder_range(parts, angles)
    unknown = ~(np.isfinite(low) & np.isfinite(high))
    low, high = np.where(unknown, -np.inf, low + shift), np.where(unknown, np.inf, high + shift)
    least = np.stack((low - geometry.upper[0], geometry.lower[0] - high), axis=1)
    most = np.stack((high - geometry.upper[0], geometry.lower[0] - low), axis=1)
    elsewhere = (most < -HALF_TURN) | (least > HALF_TURN)
    signed = np.where(most <= 0.0, np.maximum(near, 0.0), -far)
    out: Floats = np.where(elsewhere, np.inf, signed)
    return out


def _bound_speeds(
    geometry: Geometry, parts: Intervals, motion: Motion, angles: Angles, bounds: Floats
) -> Floats:
    """Joint speeds: |q'| leaves its mean over the interval by at most half of |q''|.

    Returns the mean speeds, negative; each is attained somewhere in the interval.
    """
    a, b = parts.a, parts.b
    roll2, roll1 = angles.azimuth2 + angles.heading2, np.full(len(parts), np.inf)
    tool = geometry.tool_mm
    lines = (
        (b.shoulder - a.shoulder, angles.shoulder2, angles.shoulder, angles.pad),
        (b.elbow - a.elbow, angles.elbow2, angles.elbow, angles.pad),
        (b.height - a.height, tool * motion.phi**2, roll1, geometry.pad_mm),
        (b.roll - a.roll, roll2, roll1, angles.pad + angles.azimuth_pad),
        (b.pitch - a.pitch, angles.pitch2, motion.phi, ROUNDINGS * EPSILON * 8.0),
    )
    means = np.empty((len(parts), 5))
    moving = motion.seconds > 0.0
    still = (motion.length == 0.0) & (motion.phi == 0.0) & (b.height == a.height)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for joint, (change, second, first, pad) in enumerate(lines):
            mean = np.abs(change)
            peak = np.fmin(mean + second / 2, first) + pad
            means[:, joint] = np.where(moving, -mean / motion.seconds, 0.0)
            bounds[:, SPEED + joint] = np.where(moving, -peak / motion.seconds, np.where(still, 0.0, -np.inf))
    return means
