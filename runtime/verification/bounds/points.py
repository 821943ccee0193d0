"""Everything about a pose on the path that the bounds need: attained values, no estimates."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from cutgate.protocol.arrays import Bools, Floats, Ints
from cutgate.runtime.kinematics.arm import REVOLUTION, elbow_angle, heading_offset, shoulder_offset
from cutgate.runtime.kinematics.pose import slerp
from cutgate.runtime.verification.bounds.geometry import Geometry, Segments
from cutgate.runtime.workspace.planar import distance_to_arc


@dataclass(frozen=True, slots=True)
class Points:
    """Attained poses, right elbow; arrays over m points.

    Attributes:
        centre: wrist centre in slide coordinates, shape (m, 2).
        axis_xy: horizontal part of the tool axis, shape (m, 2).
        height: true slide position, mm.
        pitch: q4, rad.
        distances: unsigned distance to the four arcs, shape (m, 4).
        inside: whether the planar workspace holds the point (for full turns: the annulus).
        bearing: polar angle of the wrist centre; continuous along the path once unwrapped.
        azimuth: of the tool axis; likewise.
        elbow: q1, rad; NaN out of reach.
        beta: angle from upper link to the line shoulder-wrist; NaN out of reach.
        widening: how much more than its deadband the errors make the roll keep from its lower and its upper
            limit here, rad, shape (m, 2).
    """

    centre: Floats
    axis_xy: Floats
    height: Floats
    pitch: Floats
    distances: Floats
    inside: Bools
    bearing: Floats
    azimuth: Floats
    elbow: Floats
    beta: Floats
    widening: Floats

    def __len__(self) -> int:
        return len(self.height)

    def take(self, index: Ints | slice) -> Points:
        """The points at an index or slice."""
        return Points(*(getattr(self, f.name)[index] for f in fields(self)))

    @property
    def shoulder(self) -> Floats:
        """q0, rad."""
        return self.bearing - self.beta

    @property
    def heading(self) -> Floats:
        """Heading q0 + q1 of the forearm, rad."""
        return self.bearing - self.beta + self.elbow

    @property
    def roll(self) -> Floats:
        """q3, rad, up to whole turns."""
        return self.azimuth - self.heading


def join(parts: list[Points]) -> Points:
    """Concatenate points in order."""
    if len(parts) == 1:
        return parts[0]
    return Points(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Points)))


def at_poses(geometry: Geometry, segments: Segments, chosen: slice) -> Points:
    """Evaluate the poses themselves."""
    return _evaluate(geometry, segments.tip[chosen], segments.axis[chosen])


def at(geometry: Geometry, segments: Segments, segment: Ints, s: Floats) -> Points:
    """Evaluate segment numbers (m,) at fractions (m,)."""
    tip = segments.tip[segment]
    tip = tip + s[:, None] * (segments.tip[segment + 1] - tip)
    axis = slerp(segments.axis[segment], segments.axis[segment + 1], segments.theta[segment], s)
    return _evaluate(geometry, tip, axis)


def _evaluate(geometry: Geometry, tip: Floats, axis: Floats) -> Points:
    space = geometry.workspace
    wrist = tip + geometry.tool_mm * axis
    centre = wrist[:, :2] - wrist[:, 2:] * geometry.tilt
    sine = np.hypot(axis[:, 0], axis[:, 1])
    if space.empty:
        nothing = np.full(len(tip), np.nan)
        bearing = elbow = beta = nothing
        distances = np.full((len(tip), 4), np.nan)
        inside = np.zeros(len(tip), dtype=np.bool_)
        widening = np.full((len(tip), 2), np.nan)
    else:
        r = np.hypot(centre[:, 0], centre[:, 1])
        bearing = np.arctan2(centre[:, 1], centre[:, 0])
        elbow = elbow_angle(r, space.a0, space.a1)
        beta = shoulder_offset(elbow, space.a0, space.a1)
        distances = np.stack([distance_to_arc(centre, arc) for arc in geometry.arcs], axis=1)
        inside = _inside(geometry, r, bearing - beta)
        widening = roll_widening(geometry, r, sine)
    return Points(
        centre=centre,
        axis_xy=axis[:, :2],
        height=wrist[:, 2],
        pitch=np.arctan2(sine, axis[:, 2]),
        distances=distances,
        inside=inside,
        bearing=bearing,
        azimuth=np.arctan2(axis[:, 1], axis[:, 0]),
        elbow=elbow,
        beta=beta,
        widening=widening,
    )


def _inside(geometry: Geometry, r: Floats, q0: Floats) -> Bools:
    space = geometry.workspace
    radial = (r >= space.radius(space.q1_hi)) & (r <= space.radius(space.q1_lo))
    if space.full_revolution:
        return radial
    with np.errstate(invalid="ignore"):
        return radial & (np.mod(q0 - space.q0_lo, REVOLUTION) <= space.q0_hi - space.q0_lo)


def roll_widening(geometry: Geometry, r: Floats, pitch_sine: Floats) -> Floats:
    """How far the errors can turn the roll down and up beyond the error of the axis itself, rad.

    The axis may be off by the angle e, which turns its azimuth by at most asin(sin e / sin q4). The wrist centre c
    may be off by up to d mm; a displaced one with forearm heading psi has its elbow at c - a1 e(psi) less the same
    displacement, on the circle of radius a0 about the column, so that c - a1 e(psi) itself lies between the radii
    a0 - d and a0 + d. The headings of the whole disc are therefore exactly those with which arms of an upper link
    from a0 - d to a0 + d reach c, and the extreme ones belong to the shortest and the longest: no bound, the value.

    Args:
        geometry: canonical arm.
        r: distance of the wrist centre from the column, mm, any shape.
        pitch_sine: sin q4, of a shape that fits r's.

    Returns:
        What the least roll loses and what the largest gains, of r's shape and (2,); infinite where the disc reaches
        a straight or a folded elbow, or the cone a pole.
    """
    if geometry.error_mm == 0.0 and geometry.error_rad == 0.0:
        return np.zeros((*r.shape, 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = math.sin(geometry.error_rad) / pitch_sine
        azimuth = np.where(ratio <= 1.0, np.arcsin(np.minimum(ratio, 1.0)), np.inf) - geometry.error_rad
    a0, a1, d = geometry.workspace.a0, geometry.workspace.a1, geometry.error_mm
    if d == 0.0:
        return np.stack((azimuth, azimuth), axis=-1)
    within = (r - d > abs(a0 - a1)) & (r + d < a0 + a1)
    shorter, same, longer = (heading_offset(r, link, a1) for link in (a0 - d, a0, a0 + d))
    heading = np.where(within[..., None], np.stack((longer - same, same - shorter), axis=-1), np.inf)
    out: Floats = azimuth[..., None] + heading
    return out
