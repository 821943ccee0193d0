"""The signed distance D(x, W) of a point to the boundary of the workspace.

Positive inside, negative outside, 1-Lipschitz; the sign comes from inverse kinematics.
"""

from __future__ import annotations

import numpy as np

from cutgate.protocol.arrays import Bools, Floats
from cutgate.runtime.workspace.planar import PlanarWorkspace, distance_to_arc


def side_distances(points: Floats, workspace: PlanarWorkspace) -> Floats:
    """Unsigned distance to the inner, outer, left and right arc, mm. Shape (n, 2) -> (n, 4)."""
    return np.stack([distance_to_arc(points, arc) for arc in workspace.arcs], axis=1)


def signed_sides(distances: Floats, inside: Bools, *, full_revolution: bool) -> Floats:
    """Give the distances their sign: outside, the nearest arc's is negative, the others' positive.

    Args:
        distances: unsigned, shape (n, 4).
        inside: membership, shape (n,).
        full_revolution: only the circles bound the set, left and right keep their sign.

    Returns:
        Shape (n, 4).
    """
    out = distances.copy()
    outside = np.flatnonzero(~inside)
    bounding = distances[outside, : 2 if full_revolution else 4]
    nearest = np.argmin(bounding, axis=1)
    out[outside, nearest] = -bounding[np.arange(len(outside)), nearest]
    return out


def signed_distance(points: Floats, workspace: PlanarWorkspace) -> Floats:
    """D(x, W): signed distance to the nearest boundary, mm. Shape (n, 2) -> (n,)."""
    bounding = workspace.arcs[: 2 if workspace.full_revolution else 4]
    nearest: Floats = np.minimum.reduce([distance_to_arc(points, arc) for arc in bounding])
    return np.where(workspace.inside(points), nearest, -nearest)
