"""The signed distance D(x, W) of a point to the boundary of the workspace.

Positive inside, negative outside, 1-Lipschitz; the sign comes from inverse kinematics.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cutgate.runtime.workspace.planar import PlanarWorkspace, distance_to_arc

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


class Distance(Protocol):
    """A distance to the nearest boundary of a workspace, exact or numeric, for `cutgate.runtime.workspace.numeric`.

    The true signed distance is positive only inside, and a ball of that radius round a point inside is inside.
    What is computed may be off by a stated bound. Unit: mm, or whatever the path is measured in.
    """

    @property
    def lipschitz(self) -> float:
        """Bound on the change of the true distance per unit moved."""
        ...  # pragma: no cover

    @property
    def error(self) -> float:
        """Bound on how far a computed distance is from the true one, rounding included."""
        ...  # pragma: no cover

    def __call__(self, points: Floats) -> Floats:
        """Signed distances (n,) of points (n, d); NaN where undefined."""
        ...  # pragma: no cover


ROUNDING = 1e-9
"""Error of the exact planar distance per mm of reach. Rounding moves an arc by a few epsilon of the reach, and
membership by most where the elbow is nearly straight: epsilon ** (2 / 3), 4e-11, of the reach."""


@dataclass(frozen=True, slots=True)
class ExactPlanar:
    """The exact distance of one planar elbow branch as a `Distance`, for points within twice the reach."""

    workspace: PlanarWorkspace

    @property
    def lipschitz(self) -> float:
        """A distance to a set is 1-Lipschitz, and so is a signed one."""
        return 1.0

    @property
    def error(self) -> float:
        """Rounding alone, mm."""
        return ROUNDING * (self.workspace.a0 + self.workspace.a1)

    def __call__(self, points: Floats) -> Floats:
        """Signed distances, mm. Shape (n, 2) -> (n,)."""
        return signed_distance(points, self.workspace)


def side_distances(points: Floats, workspace: PlanarWorkspace) -> Floats:
    """Unsigned distance to the inner, outer, left and right arc, mm. Shape (n, 2) -> (n, 4)."""
    return np.stack([distance_to_arc(points, arc) for arc in workspace.arcs], axis=1)


def signed_sides(distances: Floats, inside: Bools, *, full_turn: bool) -> Floats:
    """Give the distances their sign: outside, the nearest arc's is negative, the others' positive.

    Args:
        distances: unsigned, shape (n, 4).
        inside: membership, shape (n,).
        full_turn: only the circles bound the set, left and right keep their sign.

    Returns:
        Shape (n, 4).
    """
    out = distances.copy()
    outside = np.flatnonzero(~inside)
    bounding = distances[outside, : 2 if full_turn else 4]
    nearest = np.argmin(bounding, axis=1)
    out[outside, nearest] = -bounding[np.arange(len(outside)), nearest]
    return out


def signed_distance(points: Floats, workspace: PlanarWorkspace) -> Floats:
    """D(x, W): signed distance to the nearest boundary, mm. Shape (n, 2) -> (n,)."""
    distances = side_distances(points, workspace)[:, : 2 if workspace.full_turn else 4]
    nearest: Floats = distances.min(axis=1)
    return np.where(workspace.inside(points), nearest, -nearest)
