"""How far and how fast wrist centre and joint angles move over each interval of the path, at most.

All derivatives are taken in units of the interval: its parameter runs from 0 to 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cutgate.protocol.arrays import Floats
from cutgate.runtime.kinematics.arm import elbow_sine
from cutgate.runtime.verification.bounds.chain import Intervals, distance_from_column, sagitta
from cutgate.runtime.verification.bounds.geometry import EPSILON, ROUNDINGS, Geometry, Segments
from cutgate.runtime.verification.bounds.points import roll_widening


@dataclass(frozen=True, slots=True)
class Motion:
    """Chord and curvature of the wrist centre over each interval, in units of the interval."""

    phi: Floats  # turn of the axis
    chord: Floats  # length of the chord
    sag: Floats  # distance from the chord at most, padded
    bend: Floats  # bound on |c''|
    length: Floats  # bound on |c'|: its mean is the chord, it leaves the mean by at most |c''| / 2
    seconds: Floats


def motion_of(geometry: Geometry, segments: Segments, parts: Intervals) -> Motion:
    """Motion of the wrist centre over m intervals."""
    width = parts.s1 - parts.s0
    phi = segments.theta[parts.segment] * width
    step = parts.b.centre - parts.a.centre
    chord = np.sqrt(np.einsum("ij,ij->i", step, step))
    sag = sagitta(geometry, phi)
    return Motion(
        phi=phi,
        chord=chord,
        sag=sag + geometry.pad_mm,
        bend=8.0 * sag,
        length=chord + 4.0 * sag,
        seconds=segments.seconds[parts.segment] * width,
    )


@dataclass(frozen=True, slots=True)
class Angles:
    """Bounds on the joint angles' motion over each interval; infinite where the elbow may be straight."""

    shoulder: Floats  # on |q0'|
    heading: Floats  # on |psi'|
    shoulder2: Floats  # on |q0''|
    heading2: Floats  # on |psi''|
    elbow: Floats  # on |q1'|
    elbow2: Floats  # on |q1''|
    azimuth2: Floats  # on |azimuth''|
    pitch2: Floats  # on |q4''|
    widening: Floats  # of the roll for the errors, shape (m, 2), as in `points.roll_widening`
    pad: Floats  # rounding of q0, q1 and the heading
    azimuth_pad: Floats  # rounding of the azimuth
    elbow_sine: Floats  # least sin q1
    pitch_sine: Floats  # least sin q4


def angles_of(geometry: Geometry, segments: Segments, parts: Intervals, motion: Motion) -> Angles:
    """Motion of the joint angles over m intervals.

    Derived from dw = a0 e'(q0) q0' + a1 e'(psi) psi', projected on e(q0) and on e(psi).

    |psi'| <= |w'| / (a1 sin q1), |q0'| <= |w'| / (a0 sin q1); once more differentiated,
    a1 sin(q1) |psi''| <= |w''| + a0 q0'^2 + a1 psi'^2 and a0 sin(q1) |q0''| <= the same.
    The elbow alone follows r^2 = a0^2 + a1^2 + 2 a0 a1 cos q1 as well: a0 a1 sin(q1) |q1'| <= r |w'| and
    a0 a1 sin(q1) |q1''| <= |w'|^2 + r |w''| + a0 a1 q1'^2.
    Azimuth: az' = phi n_z / sin^2 q4, |az''| <= 2 phi^2 n_z / sin^3 q4, and
    |q4''| = |sin q4 cos q4| az'^2 <= phi^2 n_z^2 / sin^3 q4, with n the great circle's normal.
    """
    space = geometry.workspace
    nearest = np.maximum(distance_from_column(parts.a.centre, parts.b.centre) - motion.sag, 0.0)
    farthest = np.maximum(_norm(parts.a.centre), _norm(parts.b.centre)) + motion.sag
    bend = np.minimum(elbow_sine(nearest, space.a0, space.a1), elbow_sine(farthest, space.a0, space.a1))
    bend = np.where(bend > 0.0, bend, 0.0)  # NaN, out of reach, as well
    normal_lo, normal_hi = segments.normals(parts.segment)
    middle = (parts.a.pitch + parts.b.pitch) / 2
    low, high = middle - motion.phi / 2, middle + motion.phi / 2
    sine = np.where((low > 0.0) & (high < math.pi), np.minimum(np.sin(low), np.sin(high)), 0.0)
    sine = np.maximum(sine, normal_lo)
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = motion.length / bend
        pull = motion.bend + turn * turn * (1.0 / space.a0 + 1.0 / space.a1)
        square = motion.phi * motion.phi
        links = space.a0 * space.a1
        elbow = np.fmin(turn / space.a0 + turn / space.a1, farthest * turn / links)
        stretch = motion.length**2 + farthest * motion.bend + links * elbow * elbow
        elbow2 = np.fmin(pull / (space.a0 * bend) + pull / (space.a1 * bend), stretch / (links * bend))
        # A wrist centre off by pad_mm turns both links by this; a straight elbow leaves no bound.
        pad = ROUNDINGS * EPSILON * (8.0 + np.abs(parts.a.bearing))
        pad += geometry.pad_mm / (min(space.a0, space.a1) * bend)
        azimuth_pad = ROUNDINGS * EPSILON * (8.0 + np.abs(parts.a.azimuth) + 1.0 / sine)
        return Angles(
            shoulder=turn / space.a0,
            heading=turn / space.a1,
            shoulder2=pull / (space.a0 * bend),
            heading2=pull / (space.a1 * bend),
            elbow=elbow,
            elbow2=elbow2,
            azimuth2=2.0 * square * normal_hi / sine**3,
            pitch2=square * normal_hi * normal_hi / sine**3,
            widening=_widening(geometry, (nearest, farthest), sine),
            pad=pad,
            azimuth_pad=azimuth_pad,
            elbow_sine=bend,
            pitch_sine=sine,
        )


def _widening(geometry: Geometry, radii: tuple[Floats, Floats], pitch_sine: Floats) -> Floats:
    """The largest `roll_widening` between two radii, shape (m, 2): it is the larger of both ends'.

    As d heading / d a0 = 1 / (a1 sin q1), a widening is the integral of that over the links between, and for every
    link a0 1 / sin q1 is convex in r: with u = cos q1 = (r^2 - a0^2 - a1^2) / (2 a0 a1) the second derivative of
    (1 - u^2)^-1/2 has the sign of (1 + 2 u^2) r^2 / (a0 a1) + u (1 - u^2), and r^2 / (a0 a1) >= 2 + 2 u leaves
    (1 + u)(3 u^2 + u + 2) >= 0.
    """
    nearest, farthest = radii
    ends = [roll_widening(geometry, r, pitch_sine) for r in radii]
    out: Floats = np.maximum(*ends)
    if geometry.error_mm > 0.0:  # what rounds r and the links turns both headings, at the places of the disc
        space, d = geometry.workspace, geometry.error_mm
        least = np.minimum(*(elbow_sine(r, space.a0, space.a1) for r in (nearest - d, farthest + d)))
        out += (2.0 * geometry.pad_mm / (space.a1 * np.where(least > 0.0, least, 0.0)))[:, None]
    return out


def _norm(points: Floats) -> Floats:
    out: Floats = np.hypot(points[:, 0], points[:, 1])
    return out
