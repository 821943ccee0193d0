"""The rigid transform that takes points to where they were touched, in the sense of least squares.

Arun, Huang and Blostein 1987, with the determinant of Umeyama 1991 and without his scale: with both sets about their
centroids, H = sum p q^T = U S V^T and R = V diag(1, 1, det(V U^T)) U^T.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from cutgate.protocol.arrays import Floats
from cutgate.runtime.kinematics.landmarks import residuals_mm

POINTS_MIN: Final = 3
SPREAD_MIN_MM: Final = 1.0
"""Root mean square of the points' distances from a line, at least: else nothing keeps the bone from turning about it."""
MIRROR_MM: Final = 0.5
"""A fit this good needs no better one."""
MIRROR_RATIO: Final = 0.5
"""A mirror image that leaves less than this part of the residual fits much better."""
SCALE_MIN: Final = 0.9
SCALE_MAX: Final = 1.1
"""Of what fits best if it may scale: no bone and no probe is that far off, but another unit is, or another landmark."""


@dataclass(frozen=True)
class RigidFit:
    """A fit, and what tells whether it can be believed.

    Attributes:
        transform: shape (4, 4), mm.
        residuals_mm: of each point, shape (n,).
        rms_mm: their root mean square.
        mirrored_rms_mm: what the best mirror image would leave.
        scale: what would fit best if it might scale.
        flatness_mm: root mean square of the points' distances from a plane; a mirror image shows by them alone.
    """

    transform: Floats
    residuals_mm: Floats
    rms_mm: float
    mirrored_rms_mm: float
    scale: float
    flatness_mm: float

    @property
    def mirrored(self) -> bool:
        """Whether a mirror image fits much better: an axis of one of the two sets is reversed."""
        return bool(self.rms_mm > MIRROR_MM and self.mirrored_rms_mm < MIRROR_RATIO * self.rms_mm)


def spread_mm(points_mm: Floats) -> float:
    """How far points are from lying on a line: root mean square of their distances from the nearest one. Shape (n, 3).

    It is the root of the sum of the squares of the two least singular values of the centred points, over n; along a line
    the least is zero anyway.
    """
    return _rms_of(_singular_values(points_mm)[1:], len(points_mm))


def rigid_fit(from_mm: Floats, to_mm: Floats) -> RigidFit:
    """The best rigid transform from one set of points to the other; they do not lie on a line (`spread_mm`).

    Args:
        from_mm: shape (n, 3), n at least 3.
        to_mm: shape (n, 3).
    """
    centre, there = from_mm.mean(axis=0), to_mm.mean(axis=0)
    p, q = from_mm - centre, to_mm - there
    u, sizes, vt = np.linalg.svd(p.T @ q)
    sense = 1.0 if float(np.linalg.det(vt.T @ u.T)) > 0.0 else -1.0
    proper, mirrored = (_placed(u, vt, last, centre, there) for last in (sense, -sense))
    off_mm = residuals_mm(proper, from_mm, to_mm)
    # The sum of S with its sign, over the squares of p, is Umeyama's scale (eq. 42).
    scale = float((sizes * (1.0, 1.0, sense)).sum() / (p * p).sum())
    return RigidFit(
        transform=proper,
        residuals_mm=off_mm,
        rms_mm=_rms(off_mm),
        mirrored_rms_mm=_rms(residuals_mm(mirrored, from_mm, to_mm)),
        scale=scale,
        flatness_mm=_rms_of(_singular_values(from_mm)[2:], len(from_mm)),
    )


def _placed(u: Floats, vt: Floats, last: float, centre: Floats, there: Floats) -> Floats:
    """Turned by V diag(1, 1, last) U^T about the centroid, then moved to the other; shape (4, 4)."""
    transform = np.eye(4)
    transform[:3, :3] = (vt.T * (1.0, 1.0, last)) @ u.T
    transform[:3, 3] = there - transform[:3, :3] @ centre
    return transform


def _singular_values(points_mm: Floats) -> Floats:
    """Of the points about their centroid, shape (3,), the largest first."""
    values = np.zeros(3)
    found = np.linalg.svd(points_mm - points_mm.mean(axis=0), compute_uv=False)
    values[: len(found)] = found
    return values


def _rms_of(values: Floats, count: int) -> float:
    return float(np.sqrt((values * values).sum() / count))


def _rms(values: Floats) -> float:
    return _rms_of(values, len(values))
