"""Rigid transforms and great circles. Lengths in mm, angles in rad."""

from __future__ import annotations

import math

import numpy as np

from cutgate.protocol.arrays import Floats


def transform_poses(transform: Floats, tips_mm: Floats, axes: Floats) -> tuple[Floats, Floats]:
    """Move poses by a rigid transform; the axes are normalised again.

    The one place where poses are moved: digests of paths hang on its last bits. That the transform is rigid is for whoever
    reads one to say (`cutgate.runtime.plan.transform`); what is composed of those is not asked again.

    Args:
        transform: shape (4, 4), mm.
        tips_mm: shape (n, 3).
        axes: unit, shape (n, 3).

    Returns:
        Tips and unit axes, shape (n, 3) each; the arguments stay as they are.
    """
    rotation = transform[:3, :3]
    turned: Floats = axes @ rotation.T
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    return tips_mm @ rotation.T + transform[:3, 3], turned


def turn_about_vertical(angle_rad: float) -> Floats:
    """The rotation about the vertical through the origin, shape (4, 4)."""
    out = np.eye(4)
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    out[:2, :2] = ((c, -s), (s, c))
    return out


def turn_angles(first: Floats, second: Floats) -> Floats:
    """Angle between unit vectors, rad, exact near 0 and near pi. Shapes (n, 3) -> (n,)."""
    (ux, uy, uz), (vx, vy, vz) = np.ascontiguousarray(first.T), np.ascontiguousarray(second.T)
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    out: Floats = np.arctan2(np.sqrt(x * x + y * y + z * z), ux * vx + uy * vy + uz * vz)
    return out


def dot(first: Floats, second: Floats) -> Floats:
    """Inner products. Shapes (n, 3) -> (n,)."""
    ux, uy, uz = np.ascontiguousarray(first.T)
    vx, vy, vz = np.ascontiguousarray(second.T)
    out: Floats = ux * vx + uy * vy + uz * vz
    return out


def lengths(vectors: Floats) -> Floats:
    """Euclidean lengths. Shape (n, 3) -> (n,)."""
    x, y, z = np.ascontiguousarray(vectors.T)
    out: Floats = np.sqrt(x * x + y * y + z * z)
    return out


def slerp(first: Floats, second: Floats, theta: Floats, s: Floats) -> Floats:
    """Great circle from first to second at fraction s.

    Args:
        first: unit vectors, shape (n, 3).
        second: unit vectors, shape (n, 3).
        theta: angle between them (`turn_angles`), shape (n,), below pi.
        s: fraction in 0..1, shape (n,).

    Returns:
        Unit vectors, shape (n, 3); exactly first at s = 0 and second at s = 1.
    """
    still = theta == 0.0
    sine = np.where(still, 1.0, np.sin(theta))
    w0 = np.where(still, 1.0 - s, np.sin((1.0 - s) * theta) / sine)
    w1 = np.where(still, s, np.sin(s * theta) / sine)
    return w0[:, None] * first + w1[:, None] * second
