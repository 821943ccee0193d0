"""The planar distance as printed, Stocco 2001, eq. (16)-(21): kept for the record, never used by the gate.

This is a documented reconstruction, not a copy: we hold the equations' structure and facts about what they
accept, not the page. As we read them, with o0 the shoulder axis, o1 = a0 e(q0_hi), o2 = a0 e(q0_lo), both
joints' limits as for the right elbow and e(t) = (cos t, sin t):

- inner circle     |x - o0| - r_min
- outer circle     r_max - |x - o0|
- arc about o1     a1 - |x - o1|, only where alpha > 0: x on the far side (left) of the line from o0 to o1
- arc about o2     |x - o2| - a1, everywhere
- D                the smallest of them

The arcs' extents appear nowhere, which is what goes wrong. Facts that pin this reading (tests measure them):

- q0 +-60 deg, a0 = a1 = 500 mm, q1 0..150 deg: 13.6 % of the accepted area is unreachable (13.7 % on
  record, from sampling), all of it in one wedge behind the robot; D there comes up to 200 mm, with the supremum
  at azimuth -120 deg, r = 800 mm, which is where the line o0-o1 switches the arc about o1 off;
- q0 spans up to 180 deg of that arm reject no reachable point; a span of 250 deg rejects 13.1 % of them;
- on reachable points D never exceeds the exact distance (1000 random arms, 400 000 points, to 3e-13 mm).
"""

from __future__ import annotations

import math

import numpy as np

from cutgate.protocol.arrays import Floats
from cutgate.runtime.verification.bounds.geometry import Geometry, canonical
from cutgate.runtime.verification.bounds.points import Points
from cutgate.runtime.verification.defects import defects
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.stocco import March, arm_march, with_slide
from cutgate.runtime.workspace.planar import PlanarWorkspace


def printed_sides(points: Floats, workspace: PlanarWorkspace) -> Floats:
    """The terms of D for inner, outer, left (o1) and right (o2), mm. Shape (n, 2) -> (n, 4).

    A term that does not apply at a point is infinite; left and right apply nowhere where the shoulder turns
    fully, as in the paper's Figure 2. NaN stays NaN, and of an empty workspace everything is.
    """
    if workspace.empty:
        return np.full((len(points), 4), np.nan)
    a0, a1 = workspace.a0, workspace.a1
    x, y = points[:, 0], points[:, 1]
    r = np.hypot(x, y)
    out = np.stack((r, r, r, r), axis=1)
    out[:, 0] -= workspace.radius(workspace.q1_hi)
    out[:, 1] = workspace.radius(workspace.q1_lo) - r
    if workspace.full_revolution:
        out[:, 2:] = np.inf
        return out
    x1, y1 = a0 * math.cos(workspace.q0_hi), a0 * math.sin(workspace.q0_hi)
    x2, y2 = a0 * math.cos(workspace.q0_lo), a0 * math.sin(workspace.q0_lo)
    near_side = x1 * y - y1 * x <= 0.0
    out[:, 2] = np.where(near_side, np.inf, a1 - np.hypot(x - x1, y - y1))
    out[:, 3] = np.hypot(x - x2, y - y2) - a1
    return out


def printed_distance(points: Floats, workspace: PlanarWorkspace) -> Floats:
    """D as printed, eq. (21), mm. Shape (n, 2) -> (n,). Positive does not mean reachable."""
    smallest: Floats = printed_sides(points, workspace).min(axis=1)
    return smallest


def march_on_printed(problem: Problem) -> March:
    """The arm's march on the planar distance as printed, eq. (16)-(21). For the record: it proves nothing.

    ``admitted`` may be true of a path that leaves the workspace, or even starts outside. The columns of ``values`` are
    those of the exact march: inner, outer, arc about o1, arc about o2, top, bottom; infinite where none applies.

    Raises:
        ValueError: the problem's numbers are not usable.
    """
    wrong = defects(problem)
    if wrong:
        raise ValueError("; ".join(wrong))
    return arm_march(*canonical(problem), _distances)


def _distances(geometry: Geometry, points: Points) -> Floats:
    return with_slide(geometry, points, printed_sides(points.centre, geometry.workspace)[0])
