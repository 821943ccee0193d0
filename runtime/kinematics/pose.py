"""Rigid transforms and great circles. Lengths in mm, angles in rad."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

RIGID_TOLERANCE = 1e-6
"""How far rows of a rotation may be from orthonormal."""


def rigid_defect(transform: Floats) -> str | None:
    """Say what keeps a 4x4 matrix from being a rigid transform, or None if it is one."""
    if transform.shape != (4, 4):
        return f"shape is {transform.shape}, not (4, 4)"
    if not np.isfinite(transform).all():
        return "an entry is not finite"
    if not np.array_equal(transform[3], (0.0, 0.0, 0.0, 1.0)):
        return f"last row is {transform[3].tolist()}, not [0, 0, 0, 1]"
    rotation = transform[:3, :3]
    off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if not off <= RIGID_TOLERANCE:
        return f"rotation is off orthonormal by {off:.3g}, allowed {RIGID_TOLERANCE:g}"
    if not np.linalg.det(rotation) > 0:
        return "determinant is -1 (a reflection)"
    return None


def transform_poses(transform: Floats, tips_mm: Floats, axes: Floats) -> tuple[Floats, Floats]:
    """Move poses by a rigid 4x4 transform; the axes are normalised again.

    Args:
        transform: rigid, shape (4, 4).
        tips_mm: shape (n, 3).
        axes: unit, shape (n, 3).

    Raises:
        ValueError: the transform is not rigid.
    """
    defect = rigid_defect(transform)
    if defect is not None:
        raise ValueError(f"not a rigid transform: {defect}")
    rotation = transform[:3, :3]
    turned = axes @ rotation.T
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    return tips_mm @ rotation.T + transform[:3, 3], turned


def turn_about_vertical(angle_rad: float, pivot_mm: Floats) -> Floats:
    """The 4x4 rotation about the vertical line through a pivot, shape (3,)."""
    out = np.eye(4)
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    out[:2, :2] = ((c, -s), (s, c))
    out[:3, 3] = pivot_mm - out[:3, :3] @ pivot_mm
    return out


def turn_angles(first: Floats, second: Floats) -> Floats:
    """Angle between unit vectors, rad, exact near 0 and near pi. Shapes (n, 3) -> (n,)."""
    x, y, z = _cross(first, second)
    out: Floats = np.arctan2(np.sqrt(x * x + y * y + z * z), np.einsum("ij,ij->i", first, second))
    return out


def _cross(a: Floats, b: Floats) -> tuple[Floats, Floats, Floats]:
    return (
        a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1],
        a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
        a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0],
    )


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
