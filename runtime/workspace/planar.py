"""The exact planar workspace of one elbow branch: four clipped arcs.

The image of the joint rectangle q0 in [lo, hi], q1 in [c, d] (0 <= c < d <= pi, right elbow).
For q0 spans below a full turn the map is one to one, so the boundary of the workspace is the image
of the rectangle's sides, each a clipped arc. Exact replacement of Stocco 2001, eq. (16)-(21), which
ignore the arcs' extents.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cutgate.protocol.arrays import Bools, Floats
from cutgate.runtime.kinematics.arm import REVOLUTION, elbow_angle, shoulder_offset

SIDES = ("inner", "outer", "left", "right")
"""Order of the four arcs everywhere; names as for the right elbow."""


@dataclass(frozen=True, slots=True)
class Arc:
    """A clipped arc, counter-clockwise from ``start`` over ``span`` rad; a circle from a full turn on."""

    x: float
    y: float
    radius: float
    start: float
    span: float

    @property
    def ends(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The two end points, mm."""
        first, last = self.start, self.start + self.span
        return (
            (self.x + self.radius * math.cos(first), self.y + self.radius * math.sin(first)),
            (self.x + self.radius * math.cos(last), self.y + self.radius * math.sin(last)),
        )

    def distance(self, x: float, y: float) -> float:
        """`distance_to_arc` of one point."""
        dx, dy = x - self.x, y - self.y
        first, last, middle = self.start, self.start + self.span, self.start + self.span / 2
        after = math.cos(first) * dy - math.sin(first) * dx >= 0.0
        before = math.sin(last) * dx - math.cos(last) * dy >= 0.0
        if self.span > math.pi:
            beside = self.span >= REVOLUTION or after or before
        else:
            beside = after and before and math.cos(middle) * dx + math.sin(middle) * dy >= 0.0
        if beside:
            return abs(math.sqrt(dx * dx + dy * dy) - self.radius)
        return math.sqrt(min((x - px) ** 2 + (y - py) ** 2 for px, py in self.ends))


@dataclass(frozen=True, slots=True)
class PlanarWorkspace:
    """Right-elbow workspace of true links and true joint limits, q1 cut to [0, pi].

    Attributes:
        a0, a1: links, mm.
        q0_lo, q0_hi: shoulder limits, rad, any span.
        q1_lo, q1_hi: elbow limits, rad.
    """

    a0: float
    a1: float
    q0_lo: float
    q0_hi: float
    q1_lo: float
    q1_hi: float

    @property
    def empty(self) -> bool:
        """Whether no position is reachable at all."""
        return not (
            self.a0 > 0.0
            and self.a1 > 0.0
            and self.q0_hi >= self.q0_lo
            and 0.0 <= self.q1_lo <= self.q1_hi <= math.pi
        )

    @property
    def full_revolution(self) -> bool:
        """Whether every shoulder direction is reachable, so that only the circles bound the set."""
        return self.q0_hi - self.q0_lo >= REVOLUTION

    def radius(self, elbow: float) -> float:
        """Distance of the wrist from the column at an elbow angle, mm."""
        if elbow == math.pi:
            return abs(self.a0 - self.a1)
        return math.hypot(self.a0 + self.a1 * math.cos(elbow), self.a1 * math.sin(elbow))

    @property
    def arcs(self) -> tuple[Arc, Arc, Arc, Arc]:
        """Inner, outer, left (q0 at its upper limit) and right arc."""
        span = min(self.q0_hi - self.q0_lo, REVOLUTION)
        bend = self.q1_hi - self.q1_lo
        beta_c, beta_d = (
            float(shoulder_offset(np.float64(e), self.a0, self.a1))  # type: ignore[arg-type]
            for e in (self.q1_lo, self.q1_hi)
        )

        def swept(q0: float) -> Arc:
            return Arc(self.a0 * math.cos(q0), self.a0 * math.sin(q0), self.a1, q0 + self.q1_lo, bend)

        return (
            Arc(0.0, 0.0, self.radius(self.q1_hi), self.q0_lo + beta_d, span),
            Arc(0.0, 0.0, self.radius(self.q1_lo), self.q0_lo + beta_c, span),
            swept(self.q0_hi),
            swept(self.q0_lo),
        )

    def inside(self, points: Floats) -> Bools:
        """Membership by inverse kinematics, not by distance. Shape (n, 2) -> (n,)."""
        if self.empty:
            return np.zeros(len(points), dtype=np.bool_)
        r = np.hypot(points[:, 0], points[:, 1])
        radial = (r >= self.radius(self.q1_hi)) & (r <= self.radius(self.q1_lo))
        if self.full_revolution:
            return radial
        elbow = elbow_angle(r, self.a0, self.a1)
        q0 = np.arctan2(points[:, 1], points[:, 0]) - shoulder_offset(elbow, self.a0, self.a1)
        with np.errstate(invalid="ignore"):
            return radial & (np.mod(q0 - self.q0_lo, REVOLUTION) <= self.q0_hi - self.q0_lo)


def distance_to_arc(points: Floats, arc: Arc) -> Floats:
    """Distance from each point to the clipped arc, mm. Shape (n, 2) -> (n,)."""
    dx, dy = points[:, 0] - arc.x, points[:, 1] - arc.y
    radial: Floats = np.abs(np.sqrt(dx * dx + dy * dy) - arc.radius)
    if arc.span >= REVOLUTION:
        return radial
    (x1, y1), (x2, y2) = arc.ends
    nearer = np.minimum(
        (points[:, 0] - x1) ** 2 + (points[:, 1] - y1) ** 2,
        (points[:, 0] - x2) ** 2 + (points[:, 1] - y2) ** 2,
    )
    out: Floats = np.where(_within_extent(dx, dy, arc), radial, np.sqrt(nearer))
    return out


def nearest_on_arc(points: Floats, arc: Arc) -> Floats:
    """Nearest point of the clipped arc, mm. Shape (n, 2) -> (n, 2); any for the centre itself."""
    dx, dy = points[:, 0] - arc.x, points[:, 1] - arc.y
    angle = np.arctan2(dy, dx)
    on = np.stack((arc.x + arc.radius * np.cos(angle), arc.y + arc.radius * np.sin(angle)), axis=1)
    ends = np.array(arc.ends)
    gaps = np.linalg.norm(points[:, None, :] - ends, axis=2)
    extent = np.full(len(points), True) if arc.span >= REVOLUTION else _within_extent(dx, dy, arc)
    out: Floats = np.where(extent[:, None], on, ends[np.argmin(gaps, axis=1)])
    return out


def _within_extent(dx: Floats, dy: Floats, arc: Arc) -> Bools:
    """Whether directions from the arc's centre fall on the arc.

    By cross products with both ends, whose rounding is of the order of the machine precision for
    every span; the distance is continuous there, so a misjudged end changes it by as little.
    """
    first, last, middle = arc.start, arc.start + arc.span, arc.start + arc.span / 2
    after_first = math.cos(first) * dy - math.sin(first) * dx >= 0.0
    before_last = math.sin(last) * dx - math.cos(last) * dy >= 0.0
    if arc.span > math.pi:
        wide: Bools = after_first | before_last
        return wide
    narrow: Bools = after_first & before_last & (math.cos(middle) * dx + math.sin(middle) * dy >= 0.0)
    return narrow


def segment_to_arc(first: Floats, second: Floats, arc: Arc) -> tuple[Floats, Floats]:
    """Smallest distance from straight segments to a clipped arc, in closed form.

    The nearest pair is an end of the segment, an end of the arc, a crossing, or the foot of the
    arc's centre on the segment; all are tried.

    Args:
        first: starts of the segments, shape (n, 2).
        second: ends of the segments, shape (n, 2).
        arc: the arc.

    Returns:
        Distance in mm, shape (n,), and the fraction of the segment where it is attained, (n,).
    """
    step = second - first
    square = np.einsum("ij,ij->i", step, step)
    safe = np.where(square > 0.0, square, 1.0)

    def foot(x: float, y: float) -> Floats:
        along = (x - first[:, 0]) * step[:, 0] + (y - first[:, 1]) * step[:, 1]
        out: Floats = along / safe
        return out

    centre = foot(arc.x, arc.y)
    off = first + centre[:, None] * step - (arc.x, arc.y)
    half = np.sqrt(np.maximum(arc.radius**2 - np.einsum("ij,ij->i", off, off), 0.0) / safe)
    candidates = [np.zeros_like(square), np.ones_like(square), centre, centre - half, centre + half]
    if arc.span < REVOLUTION:
        candidates += [foot(x, y) for x, y in arc.ends]
    t = np.clip(candidates, 0.0, 1.0)
    points = first + t[:, :, None] * step
    distances = distance_to_arc(points.reshape(-1, 2), arc).reshape(t.shape)
    nearest, row = np.argmin(distances, axis=0), np.arange(len(first))  # NaN counts as nearest and stays
    return distances[nearest, row], t[nearest, row]
