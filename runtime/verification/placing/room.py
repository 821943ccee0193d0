"""How much room one path has at many places of the bone at once: by + - * / and roots at each of its poses.

A shift `p` in slide coordinates moves every wrist centre alike, so that squared distances and what the roll needs are
linear in (1, px, py, p^2) with coefficients of the pose: a matrix product gives them for all poses and many shifts. Two
things follow from them, for each shift:

* What is attained at a pose: where that violates a limit by more than the radius of a disc of shifts, so does every shift
  of the disc. A signed distance is 1-Lipschitz; the heading of the forearm turns by no more than 1 / (a1 sin q1) per mm.
* What is kept all along, provided that the path is admissible there (`decide` proves that): between two poses at least d
  from a set, a chord L apart, a point of the chord is at least sqrt(d^2 - L^2 / 4) from it (Stewart's theorem), and a wrist
  centre is no further off its chord than the sagitta. Between poses the roll exceeds the larger of both by at most an
  eighth of its second derivative: of the heading, along a straight line, at most (a0 q0'^2 + a1 psi'^2) / (a1 sin q1).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from cutgate.protocol.arrays import Bools, Floats, Ints
from cutgate.runtime.kinematics.arm import REVOLUTION, elbow_angle, elbow_sine, shoulder_offset
from cutgate.runtime.verification.bounds.chain import sagitta, sweep
from cutgate.runtime.verification.bounds.geometry import canonical, canonical_arm
from cutgate.runtime.verification.branch import confined
from cutgate.runtime.verification.placing.freedom import WIRE_MM, WIRE_RAD
from cutgate.runtime.verification.placing.tolerated import QUANTISED_MM, QUANTISED_RAD
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.workspace.distance import signed_distance
from cutgate.runtime.workspace.planar import distance_to_arc

AT_ONCE: Final = 32_768
"""So many pairs of a pose and a shift are looked at in one go: few enough for the cache."""

SINE_MIN: Final = 1e-3
"""Nearer to a straight or folded elbow, or to the vertical, nothing is said."""

ROUNDED_MM, ROUNDED_RAD = 1e-6, 1e-6
"""More than rounding does: squares of metres are exact to 1e-9 mm2, an angle is to 2e-8 from its cosine."""

TIGHT_MM: Final = 30.0
"""What is known of the distance from a side is that itself where it is less: its arc ends on the two circles."""

NEAR_MM: Final = 1.0
"""Where less is missing, poses are looked at as well."""

HALVINGS: Final = 5
"""The poses are parted so often into halves, each in a ball: where that shows enough, none of them is looked at."""


class Attained(NamedTuple):
    """What is found at the worst poses after k shifts, deadbands not taken off; NaN where nothing is.

    Attributes:
        arm_mm: least signed distance, shape (k,).
        place: that wrist centre, slide coordinates, shape (k, 2).
        roll_rad: how far the roll is from the nearer end of its limits at its worst pose, negative beyond; shape (k,).
        toward_upper: whether that is the upper one, as for the right elbow.
        radius_mm: of that pose's wrist centre about the column.
    """

    arm_mm: Floats
    place: Floats
    roll_rad: Floats
    toward_upper: Bools
    radius_mm: Floats


class ClearanceBounds(NamedTuple):
    """What is kept along the path after k shifts, where it is admissible there: lower bounds.

    Attributes:
        arm_mm: on the distance from each of `workspace.planar.SIDES`, shape (4, k).
        roll_rad: on that from the nearer end of the roll's limits, shape (k,); NaN where nothing is said.
        toward_upper: whether that is the upper one, as for the right elbow.
    """

    arm_mm: Floats
    roll_rad: Floats
    toward_upper: Bools


@dataclass(frozen=True, slots=True)
class _Balls:
    """Balls that hold all wrist centres, with the azimuths of the tools there.

    Attributes:
        centre: shape (m, 2).
        radius: shape (m,), mm.
        azimuth: the middle one, shape (m,).
        spread: how far others are from it, rad.
    """

    centre: Floats
    radius: Floats
    azimuth: Floats
    spread: Floats

    @classmethod
    def of(cls, centres: Floats, axes: Floats) -> _Balls:
        """About points that are parted into halves again and again."""
        parts = [np.arange(len(centres))]
        for _ in range(HALVINGS):
            parts = [half for part in parts for half in _halves(centres, part)]
        middles = np.array([(centres[k].min(axis=0) + centres[k].max(axis=0)) / 2.0 for k in parts])
        radii = [float(np.hypot(*(centres[k] - m).T).max()) for k, m in zip(parts, middles, strict=True)]
        means = np.array([axes[k].mean(axis=0) for k in parts])
        spread = [
            float(np.abs(sweep(np.broadcast_to(m, axes[k].shape), axes[k])).max())
            for k, m in zip(parts, means, strict=True)
        ]
        return cls(middles, np.array(radii), np.arctan2(means[:, 1], means[:, 0]), np.array(spread))


def _halves(centres: Floats, part: Ints) -> Iterator[Ints]:
    """Across the longer side of its box."""
    along = int(np.argmax(np.ptp(centres[part], axis=0)))
    order = part[np.argsort(centres[part, along], kind="stable")]
    return (half for half in np.array_split(order, 2) if len(half))


class Room:
    """The poses of one path, ready to be looked at.

    Args:
        problem: a path with usable numbers.
    """

    def __init__(self, problem: Problem) -> None:
        g, segments = canonical(problem)
        self.geometry = g
        wrist = segments.tip + g.tool_mm * segments.axis
        self._centre, axis = wrist[:, :2] - wrist[:, 2:] * g.tilt, segments.axis[:, :2]
        self._level = np.hypot(axis[:, 0], axis[:, 1])
        turn = float(segments.theta.max())
        self._least_level = float(self._level.min()) - turn
        self._half = (float(g.upper[3]) - float(g.lower[3])) / 2.0
        self._middle = (float(g.upper[3]) + float(g.lower[3])) / 2.0
        self._balls = _Balls.of(self._centre, axis)
        x, y, ux, uy = self._centre[:, 0], self._centre[:, 1], axis[:, 0], axis[:, 1]
        nothing, one = np.zeros(len(x)), np.ones(len(x))
        self._square = np.stack((x * x + y * y, 2.0 * x, 2.0 * y, one))
        self._along = np.stack((ux * x + uy * y, ux, uy, nothing))
        self._across = np.stack((uy * x - ux * y, uy, -ux, nothing))
        self._elbows, self._lines, self._links = [], [], []
        a0 = g.workspace.a0
        for q0 in (g.workspace.q0_hi, g.workspace.q0_lo):
            ex, ey = math.cos(q0), math.sin(q0)
            about = self._square - 2.0 * a0 * np.stack((ex * x + ey * y, ex * one, ey * one, nothing))
            about[0] += a0 * a0
            self._elbows.append(about)
            self._lines.append(np.stack((ex * y - ey * x, -ey * one, ex * one, nothing)))
            self._links.append(np.array((ex, ey)))
        step = np.diff(self._centre, axis=0)
        self._chord_mm = float(np.sqrt(np.einsum("ij,ij->i", step, step)).max())
        self._sag_mm = float(sagitta(g, segments.theta).max())
        self._pull_mm = (
            g.stretch * g.tool_mm * turn * turn
        )  # second derivative of a wrist centre along a segment
        self.wire_mm = g.stretch * (QUANTISED_MM + g.tool_mm * QUANTISED_RAD)
        self._azimuth_rad = (turn / max(self._least_level, SINE_MIN)) ** 2 / 4.0

    @classmethod
    def of(cls, problem: Problem) -> Room | None:
        """None where a turn of shoulder or roll is to be chosen, or the tool may stand vertical."""
        if len(problem.tips_mm) < 2 or problem.hold_roll is not None:
            return None
        g = canonical_arm(problem)
        whole = g.workspace.empty or g.workspace.full_revolution
        if whole or not (confined(g, 0) and confined(g, 3) and g.upper[3] - g.lower[3] < REVOLUTION):
            return None
        room = cls(problem)
        return room if room.usable else None

    @property
    def usable(self) -> bool:
        """Whether the tool keeps away from the vertical."""
        return self._least_level >= SINE_MIN

    def __len__(self) -> int:
        """Poses that are looked at."""
        return len(self._level)

    # ---- what is attained, and what that excludes

    def attained(self, shifts: Floats, radius_mm: float = 0.0) -> Attained:
        """At the worst poses after shifts in slide coordinates, shape (k, 2).

        Sides and roll are looked at only where balls about the poses do not show that discs of the radius keep them.
        """
        g, every = self.geometry, np.arange(len(shifts))
        near, far = self._radial(shifts)[1]
        rows = np.stack((near, far, near, near), axis=1)
        open_ = np.flatnonzero(self._ball_distances(shifts)[2:].min(axis=0) < g.arm_mm + radius_mm + NEAR_MM)
        rows[open_, 2:] = np.stack(self._sides(shifts[open_])[1], axis=1)
        points = self._centre[rows] + shifts[:, None, :]
        distances = signed_distance(points.reshape(-1, 2), g.workspace).reshape(-1, 4)
        nearest = np.argmin(distances, axis=1)
        roll, upper = np.full(len(shifts), np.inf), np.zeros(len(shifts), dtype=np.bool_)
        radius = np.full(len(shifts), np.nan)
        with np.errstate(invalid="ignore"):
            kept = (
                self._half
                - self._ball_rolled(shifts)[0]
                - (radius_mm + NEAR_MM) / (g.workspace.a1 * self._elbow_sine(*self._radii(shifts, radius_mm)))
            )
            open_ = np.flatnonzero(~(kept > g.wrist_rad))
        angle, upper[open_], turned = self._rolled(shifts[open_])
        roll[open_] = self._half - angle
        radius[open_] = np.hypot(*(self._centre[turned] + shifts[open_]).T)
        return Attained(distances[every, nearest], points[every, nearest], roll, upper, radius)

    def _radii(self, shifts: Floats, more_mm: float) -> tuple[Floats, Floats]:
        """Between which radii the balls lie, and a little more."""
        distances, (inner, outer) = self._ball_distances(shifts), self._ends
        return distances[0] + inner - more_mm, outer - distances[1] + more_mm

    def violated(self, found: Attained, radii_mm: Floats) -> tuple[Bools, Bools]:
        """Whether the arm's limits, and the roll's, are surely violated for all shifts of discs, shape (k,) each.

        Args:
            found: at the centres of the discs.
            radii_mm: theirs.
        """
        g = self.geometry
        wire = g.pad_mm + WIRE_MM + WIRE_RAD * g.tool_mm + ROUNDED_MM
        arm: Bools = found.arm_mm < g.arm_mm - wire - radii_mm
        moved = radii_mm + wire
        sine = self._elbow_sine(found.radius_mm - moved, found.radius_mm + moved)
        with np.errstate(invalid="ignore"):
            turned = moved / (g.workspace.a1 * sine) + WIRE_RAD * (1.0 + 1.0 / self._least_level)
            roll: Bools = found.roll_rad < g.wrist_rad - turned - ROUNDED_RAD
        return arm, roll

    # ---- what is kept

    def kept(self, shifts: Floats, ratio: Floats) -> ClearanceBounds:
        """What is kept after shifts, shape (k, 2): the least per deadband as well as it is known, all else bounded.

        Args:
            shifts: slide coordinates.
            ratio: what else is kept per deadband, shape (k,): where balls about the poses show more, none is looked at.
        """
        g, asked = self.geometry, ratio
        distances, (angle, upper) = self._ball_distances(shifts), self._ball_rolled(shifts)
        for first, look in ((0, self._radial), (2, self._sides)):
            group = slice(first, first + 2)
            rows = np.flatnonzero(self._all_along(distances)[group].min(axis=0) / g.arm_mm < ratio)
            distances[group, rows] = look(shifts[rows])[0]
            ratio = np.minimum(ratio, self._all_along(distances)[group].min(axis=0) / g.arm_mm)
        self._exact_sides(shifts, distances, np.where(np.isfinite(asked), asked, 0.0) * g.arm_mm)
        slack = self._roll_slack(distances)
        with np.errstate(invalid="ignore"):
            rows = np.flatnonzero(~((self._half - angle - slack) / g.wrist_rad >= ratio))
        angle[rows], upper[rows], _ = self._rolled(shifts[rows])
        return ClearanceBounds(self._all_along(distances), self._half - angle - slack, upper)

    def _exact_sides(self, shifts: Floats, distances: Floats, below_mm: Floats) -> None:
        """Where a side seems the nearest of all, and what is known of it only bounds its distance: the distance itself."""
        g = self.geometry
        for row in (2, 3):
            seems = np.flatnonzero(distances[row] <= np.minimum(distances.min(axis=0), below_mm))
            for k in seems[distances[row, seems] > TIGHT_MM].tolist():
                exact = float(distance_to_arc(self._centre + shifts[k], g.arcs[row]).min())
                distances[row, k] = max(exact, distances[row, k])

    def spare_mm(self, shifts: Floats, radius_mm: float) -> Floats:
        """What whole discs of shifts keep beyond the arm's deadband, if they are admissible, shape (k,), mm.

        NaN where the roll's deadband is not kept: what is not positive is worth no proof.
        """
        g, kept = self.geometry, self.kept(shifts, np.full(len(shifts), np.inf))
        inner, outer = self._ends
        sine = self._elbow_sine(kept.arm_mm[0] + inner - radius_mm, outer - kept.arm_mm[1] + radius_mm)
        with np.errstate(invalid="ignore"):
            turned = kept.roll_rad - radius_mm / (g.workspace.a1 * sine) >= g.wrist_rad
            out: Floats = np.where(turned, kept.arm_mm.min(axis=0) - radius_mm - g.arm_mm, np.nan)
        return out

    def _all_along(self, distances: Floats) -> Floats:
        """From the least distances at poses, (4, k), to those of the whole path and quantised anew.

        That from the inner circle is one from the column less its radius. From the outer one the poses are the nearest.
        """
        quarter, (inner, _) = self._chord_mm * self._chord_mm / 4.0, self._ends
        out = distances - (self._sag_mm + self.wire_mm + ROUNDED_MM)
        for row, centre in ((0, inner), (2, 0.0), (3, 0.0)):
            away = distances[row] + centre
            out[row] += np.sqrt(np.maximum(away * np.abs(away) - quarter, 0.0)) - away
        return out

    def _roll_slack(self, distances: Floats) -> Floats:
        """What the roll may lose between poses, by quantising anew, by residuals and by tolerances, rad, shape (k,)."""
        g, (inner, outer) = self.geometry, self._ends
        more = self._chord_mm / 2.0 + self._sag_mm + self.wire_mm + g.error_mm
        sine = self._elbow_sine(distances[0] + inner - more, outer - distances[1] + more)
        a0, a1 = g.workspace.a0, g.workspace.a1
        way = self._chord_mm + self._pull_mm
        with np.errstate(invalid="ignore"):
            bent = (self._pull_mm + way * way * (1.0 / a0 + 1.0 / a1) / (sine * sine)) / (8.0 * a1 * sine)
            moved = (self._sag_mm + self.wire_mm + g.error_mm) / (a1 * sine)
        ratio = math.sin(g.error_rad + QUANTISED_RAD) / self._least_level
        axis = math.asin(ratio) - g.error_rad if ratio < 1.0 else math.nan
        out: Floats = bent + moved + self._azimuth_rad + axis + ROUNDED_RAD
        return out

    # ---- at the poses

    @property
    def _ends(self) -> tuple[float, float]:
        """Radii of the inner and the outer circle."""
        space = self.geometry.workspace
        return space.radius(space.q1_hi), space.radius(space.q1_lo)

    @property
    def _line_mm(self) -> float:
        """The side arcs lie at least so far to the left of either upper link."""
        space = self.geometry.workspace
        return space.a1 * min(math.sin(space.q1_lo), math.sin(space.q1_hi))

    def _elbow_sine(self, nearest: Floats, farthest: Floats) -> Floats:
        """The least between two radii; NaN where it is too little to divide by."""
        space = self.geometry.workspace
        ends = (elbow_sine(r, space.a0, space.a1) for r in (np.maximum(nearest, 0.0), farthest))
        least = np.minimum(*ends)
        with np.errstate(invalid="ignore"):
            out: Floats = np.where(least >= SINE_MIN, least, np.nan)
        return out

    def _blocks(self, shifts: Floats) -> Iterator[tuple[slice, Floats]]:
        """What the coefficients are multiplied by, some shifts at a time."""
        by = np.stack((np.ones(len(shifts)), *shifts.T, np.einsum("ij,ij->i", shifts, shifts)), axis=1)
        size = max(1, AT_ONCE // len(self))
        return ((slice(i, i + size), by[i : i + size]) for i in range(0, len(shifts), size))

    def _radial(self, shifts: Floats) -> tuple[Floats, tuple[Ints, Ints]]:
        """Least distances from the inner and the outer circle at poses, (2, k), and which poses'."""
        ends, (near, far) = np.empty((2, len(shifts))), np.empty((2, len(shifts)), dtype=np.int64)
        for part, by in self._blocks(shifts):
            square = by @ self._square
            near[part], far[part] = square.argmin(axis=1), square.argmax(axis=1)
            every = np.arange(len(by))
            ends[0, part], ends[1, part] = square[every, near[part]], square[every, far[part]]
        inner, outer = self._ends
        least, most = np.sqrt(np.maximum(ends, 0.0))
        return np.stack((least - inner, outer - most)), (near, far)

    def _sides(self, shifts: Floats) -> tuple[Floats, tuple[Ints, Ints]]:
        """Lower bounds on the least distances from the arcs left and right at poses, (2, k), and which poses'.

        The arc is of a circle about the elbow at a limit of q0, and lies on one side of a line along that upper link.
        """
        a1, line_mm = self.geometry.workspace.a1, self._line_mm
        least, rows = np.empty((2, len(shifts))), np.empty((2, len(shifts)), dtype=np.int64)
        for part, by in self._blocks(shifts):
            every = np.arange(len(by))
            for side in (0, 1):
                away = by @ self._elbows[side]
                np.sqrt(np.maximum(away, 0.0, out=away), out=away)
                away -= a1
                np.abs(away, out=away)
                np.maximum(away, line_mm - by @ self._lines[side], out=away)
                rows[side, part] = away.argmin(axis=1)
                least[side, part] = away[every, rows[side, part]]
        return least, (rows[0], rows[1])

    def _rolled(self, shifts: Floats) -> tuple[Floats, Bools, Ints]:
        """How far the roll is from the middle of its limits at its worst pose, whether above it, and which pose's.

        With the forearm along (A c + B c') / D as in `decide`; NaN where a pose is out of reach.
        """
        space = self.geometry.workspace
        a0, a1, length = space.a0, space.a1, space.a1 * self._level
        cosine, sine = math.cos(self._middle), math.sin(self._middle)
        angle, upper = np.empty(len(shifts)), np.empty(len(shifts), dtype=np.bool_)
        rows = np.empty(len(shifts), dtype=np.int64)
        for part, by in self._blocks(shifts):
            every, square = np.arange(len(by)), by @ self._square
            along, across = by @ self._along, by @ self._across
            a = square * 0.5
            a += (a1 * a1 - a0 * a0) / 2.0
            b = square * (a1 * a1)
            b -= a * a
            with np.errstate(invalid="ignore", divide="ignore"):
                np.sqrt(b, out=b)
                toward = a * along
                toward += b * across
                if sine != 0.0:
                    toward *= cosine
                    toward += (a * across - b * along) * sine
                square *= length
                toward /= square
                k = toward.argmin(axis=1)  # of NaN, where there is any
                worst = toward[every, k]
                angle[part] = np.arccos(np.clip(worst, -1.0, 1.0))
            ahead, aside = along[every, k], across[every, k]
            a, b = a[every, k], b[every, k]
            with np.errstate(invalid="ignore"):
                upper[part] = (a * aside - b * ahead) * cosine - (a * ahead + b * aside) * sine > 0.0
            rows[part] = k
        return angle, upper, rows

    # ---- at the balls about them

    def _ball_distances(self, shifts: Floats) -> Floats:
        """Lower bounds on the distances at poses, (4, k)."""
        balls, space = self._balls, self.geometry.workspace
        points = balls.centre + shifts[:, None, :]
        r, (inner, outer) = np.sqrt(np.einsum("kmi,kmi->km", points, points)), self._ends
        out = [(r - balls.radius).min(axis=1) - inner, outer - (r + balls.radius).max(axis=1)]
        for link in self._links:
            x, y = np.moveaxis(points, 2, 0)
            away = np.abs(np.hypot(x - space.a0 * link[0], y - space.a0 * link[1]) - space.a1)
            away = np.maximum(away, self._line_mm - (link[0] * y - link[1] * x))
            out.append((away - balls.radius).min(axis=1))
        return np.stack(out)

    def _ball_rolled(self, shifts: Floats) -> tuple[Floats, Bools]:
        """Upper bounds on how far the roll is from the middle of its limits, (k,), and to which side; NaN if unknown."""
        balls, space = self._balls, self.geometry.workspace
        points = balls.centre + shifts[:, None, :]
        r = np.sqrt(np.einsum("kmi,kmi->km", points, points))
        elbow = elbow_angle(r, space.a0, space.a1)
        heading = (
            np.arctan2(points[..., 1], points[..., 0]) + elbow - shoulder_offset(elbow, space.a0, space.a1)
        )
        off = balls.azimuth - heading - self._middle
        off -= REVOLUTION * np.round(off / REVOLUTION)
        with np.errstate(invalid="ignore"):
            sine = self._elbow_sine(r - balls.radius, r + balls.radius)
            most = np.abs(off) + balls.spread + balls.radius / (space.a1 * sine)
        k = np.argmax(most, axis=1)
        every = np.arange(len(shifts))
        return most[every, k], off[every, k] > 0.0
