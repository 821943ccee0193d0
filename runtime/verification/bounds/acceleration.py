"""Joint accelerations at the planned feed, inside the segments.

From w = a0 e(q0) + a1 e(psi) with psi = q0 + q1, differentiated twice and projected on e(psi) and e(q0),

    a0 sin(q1) q0''  =  e(psi).R      a1 sin(q1) psi'' = -e(q0).R      R = w'' + a0 e(q0) q0'^2 + a1 e(psi) psi'^2

and likewise without the squares for the speeds. At a pose of the path the joint velocities may jump: there the
controller slows down or rounds the corner within the path tolerance, and no bound is stated.
"""

from __future__ import annotations

import numpy as np

from cutgate.protocol.arrays import Floats, Ints
from cutgate.runtime.kinematics.arm import elbow_angle, shoulder_offset
from cutgate.runtime.kinematics.pose import slerp
from cutgate.runtime.verification.bounds.chain import Intervals
from cutgate.runtime.verification.bounds.geometry import EPSILON, ROUNDINGS, Geometry, Segments
from cutgate.runtime.verification.bounds.motion import Angles, Motion


def joint_accelerations(geometry: Geometry, segments: Segments, segment: Ints, s: Floats) -> Floats:
    """Exact q'' at fractions of segments, at the planned feed, rad/s2 and mm/s2.

    Args:
        geometry: canonical arm.
        segments: the path.
        segment: numbers of the segments, shape (m,).
        s: fractions, shape (m,).

    Returns:
        Shape (m, 5); NaN or infinite where the joints are singular, 0 in a segment that takes no time.
    """
    theta = segments.theta[segment]
    axis = slerp(segments.axis[segment], segments.axis[segment + 1], theta, s)
    turning = _turning(segments, segment, s)
    step = segments.tip[segment + 1] - segments.tip[segment]
    wrist = segments.tip[segment] + s[:, None] * step + geometry.tool_mm * axis
    pull = -geometry.tool_mm * (theta * theta)[:, None] * axis
    centre, velocity, bend = (_slid(geometry, v) for v in (wrist, step + geometry.tool_mm * turning, pull))
    out = np.empty((len(segment), 5))
    with np.errstate(divide="ignore", invalid="ignore"):
        shoulder, heading = _arm(geometry, centre, velocity, bend)
        azimuth, out[:, 4] = _wrist(axis, turning, theta)
        out[:, 0], out[:, 1], out[:, 2] = shoulder, heading - shoulder, pull[:, 2]
        out[:, 3] = azimuth - heading
        out /= (segments.seconds[segment] ** 2)[:, None]
    out[segments.seconds[segment] == 0.0] = 0.0
    return out


def _turning(segments: Segments, segment: Ints, s: Floats) -> Floats:
    """Derivative of the great circle from u to v: theta / sin(theta) (cos(s theta) v - cos((1 - s) theta) u)."""
    u, v, theta = segments.axis[segment], segments.axis[segment + 1], segments.theta[segment]
    scale = theta / np.where(theta > 0.0, np.sin(theta), 1.0)
    out: Floats = (scale * np.cos(s * theta))[:, None] * v - (scale * np.cos((1.0 - s) * theta))[:, None] * u
    return out


def _slid(geometry: Geometry, vectors: Floats) -> Floats:
    """The planar part in slide coordinates, shape (m, 3) -> (m, 2)."""
    out: Floats = vectors[:, :2] - vectors[:, 2:] * geometry.tilt
    return out


def _arm(geometry: Geometry, centre: Floats, velocity: Floats, pull: Floats) -> tuple[Floats, Floats]:
    """Second derivatives of q0 and of the heading."""
    a0, a1 = geometry.workspace.a0, geometry.workspace.a1
    elbow = elbow_angle(np.hypot(centre[:, 0], centre[:, 1]), a0, a1)
    q0 = np.arctan2(centre[:, 1], centre[:, 0]) - shoulder_offset(elbow, a0, a1)
    psi, sine = q0 + elbow, np.sin(elbow)
    upper, fore = (np.column_stack((np.cos(angle), np.sin(angle))) for angle in (q0, psi))
    shoulder = _dot(fore, velocity) / (a0 * sine)
    heading = -_dot(upper, velocity) / (a1 * sine)
    whole = pull + (a0 * shoulder**2)[:, None] * upper + (a1 * heading**2)[:, None] * fore
    return _dot(fore, whole) / (a0 * sine), -_dot(upper, whole) / (a1 * sine)


def _wrist(axis: Floats, turning: Floats, theta: Floats) -> tuple[Floats, Floats]:
    """Second derivatives of the azimuth and of the pitch along the great circle.

    az' = N / sin^2 q4 with N = u_x u_y' - u_y u_x' constant, q4' = -u_z' / sin q4, u_z'' = -theta^2 u_z.
    """
    sine = np.hypot(axis[:, 0], axis[:, 1])
    moment = axis[:, 0] * turning[:, 1] - axis[:, 1] * turning[:, 0]
    azimuth = 2.0 * moment * axis[:, 2] * turning[:, 2] / sine**4
    swing = -turning[:, 2] / sine
    pitch = axis[:, 2] * (theta * theta - swing * swing) / sine
    still = theta == 0.0
    return np.where(still, 0.0, azimuth), np.where(still, 0.0, pitch)


def _dot(a: Floats, b: Floats) -> Floats:
    out: Floats = np.einsum("ij,ij->i", a, b)
    return out


def bounded_accelerations(
    geometry: Geometry,
    segments: Segments,
    parts: Intervals,
    known: tuple[Motion, Angles],
    floor: Floats,
) -> tuple[Floats, Floats]:
    """Bound |q''| over intervals: by its terms, and where that is too weak by its middle and |q'''|.

    Args:
        geometry: canonical arm.
        segments: the path.
        parts: m intervals.
        known: how wrist centre and joint angles move over them.
        floor: minus the acceleration that needs no closer look, shape (5,).

    Returns:
        Minus the bounds, and minus the accelerations attained in the middle (infinite where not looked at),
        rad/s2 and mm/s2, both shape (m, 5).
    """
    motion, angles = known
    second, third, pad = _derivatives(geometry, parts, motion, angles)
    resting = (motion.length == 0.0) & (motion.phi == 0.0)
    square = np.where(motion.seconds > 0.0, motion.seconds, np.nan) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        bound = -(second + pad) / square[:, None]
    bound[resting] = 0.0
    attained = np.full_like(bound, np.inf)
    attained[resting] = 0.0

    weak = np.flatnonzero(~(bound >= floor).all(axis=1) & ~resting)
    if len(weak):
        middle = (parts.s0[weak] + parts.s1[weak]) / 2
        attained[weak] = -np.abs(joint_accelerations(geometry, segments, parts.segment[weak], middle))
        with np.errstate(divide="ignore", invalid="ignore"):
            closer = attained[weak] - (third[weak] / 2 + pad[weak]) / square[weak, None]
        bound[weak] = np.fmax(bound[weak], closer)
    return bound, attained


def _derivatives(
    geometry: Geometry, parts: Intervals, motion: Motion, angles: Angles
) -> tuple[Floats, Floats, Floats]:
    """Bounds on |q''|, on |q'''| and on the rounding of a computed q'', per unit of the interval, each (m, 5).

    A first derivative leaves its mean over the interval by at most half of the second, which sharpens both. Once
    more differentiated, a1 sin(q1) |psi'''| <= |w'''| + 3 a0 |q0' q0''| + 3 a1 |psi' psi''| + a0 |q0'|^3 +
    a1 |psi'|^3, and a0 sin(q1) |q0'''| likewise. With S = sin q4 and az' = phi n / S^2 along the great circle,
    |az'''| <= 12 phi^3 n / S^4 and |q4'''| <= 5 phi^3 n^2 / S^4, where n <= 1.
    """
    a0, a1 = geometry.workspace.a0, geometry.workspace.a1
    a, b, phi = parts.a, parts.b, motion.phi
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        first = np.fmin(angles.shoulder, np.abs(b.shoulder - a.shoulder) + angles.shoulder2 / 2 + angles.pad)
        turn = np.fmin(angles.heading, np.abs(b.heading - a.heading) + angles.heading2 / 2 + angles.pad)
        pull = (motion.bend + a0 * first**2 + a1 * turn**2) / angles.elbow_sine
        shoulder2, heading2 = pull / a0, pull / a1
        whole = motion.bend * phi + 3.0 * (a0 * first * shoulder2 + a1 * turn * heading2)
        whole = (whole + a0 * first**3 + a1 * turn**3) / angles.elbow_sine
        bent = _moving(shoulder2 + heading2, motion.length)
        # An axis that rests has no derivatives, even where it stands vertical.
        swung = _moving((phi / angles.pitch_sine) ** 2 * (8.0 + 1.0 / angles.pitch_sine**2), phi)
        azimuth2, pitch2 = _moving(angles.azimuth2, phi), _moving(angles.pitch2, phi)
        azimuth3 = _moving(12.0 * phi**3 / angles.pitch_sine**4, phi)
        pitch3 = _moving(5.0 * phi**3 / angles.pitch_sine**4, phi)
        rounded = ROUNDINGS * EPSILON * bent * (8.0 + 1.0 / angles.elbow_sine**2)
    tool = geometry.tool_mm * phi**2
    swinging = ROUNDINGS * EPSILON * swung
    second = (shoulder2, np.fmin(bent, angles.elbow2), tool, azimuth2 + heading2, pitch2)
    third = (whole / a0, whole / a0 + whole / a1, tool * phi, azimuth3 + whole / a1, pitch3)
    pad = (rounded, rounded, ROUNDINGS * EPSILON * tool, rounded + swinging, swinging)
    return np.column_stack(second), np.column_stack(third), np.column_stack(pad)


def _moving(value: Floats, size: Floats) -> Floats:
    """The value where something moves, else nothing."""
    return np.where(size == 0.0, 0.0, value)
