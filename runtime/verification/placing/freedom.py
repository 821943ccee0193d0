"""What the points of one path ask of a shift of the bone, and proofs that no shift in a disc fits.

A lift ``h`` changes the heights alone, and shifts the wrist centres in slide coordinates by ``-h tilt``.
With ``p`` the shift in slide coordinates the conditions come apart: the slide asks for ``h`` in an
interval, everything else for ``p`` in a set of the plane. The translation is ``(p + h tilt, h)``.

The points are attained: the poses and, on long or turning segments, points between. Where they do not
fit, the path does not; where they do, the certified method has the last word.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from cutgate.protocol.arrays import Bools, Floats, Ints
from cutgate.runtime.kinematics.arm import REVOLUTION, elbow_angle, elbow_sine, shoulder_offset
from cutgate.runtime.kinematics.pose import slerp
from cutgate.runtime.verification.bounds.chain import BLOCK, sagitta, sweep
from cutgate.runtime.verification.bounds.closed_form import extremes
from cutgate.runtime.verification.bounds.geometry import VERTICAL, Geometry, Segments, canonical
from cutgate.runtime.verification.bounds.points import Points, at_poses, join, roll_widening
from cutgate.runtime.verification.effort import CALL, Effort
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.workspace.distance import side_distances, signed_distance
from cutgate.runtime.workspace.planar import distance_to_arc

SPACING_MM = 10.0
"""Points are this far apart at most: over it an arc of 250 mm leaves its chord by 0.05 mm."""

SAG_MM = 0.02
"""Between two of them a turning tool takes the wrist centre at most this far off the chord."""

POINTS_MAX = 8192
"""So many points are inserted, no more: they help to find a shift that the whole path admits."""

WIRE_MM = 2e-3
"""A moved path is quantised anew: its wrist centres may lie this far from the shifted ones."""

WIRE_RAD = 2e-6
"""The same for the tool axis; its azimuth turns by that over sin q4."""

SAMPLE = 64
"""Points that stand for all at first; those that object later are taken in."""

FIRST = 24
"""Of the sample, so many are tried first: they are enough to exclude most discs."""

BUILD, BUILD_POINT, BUILD_BLOCK = 6000, 6, 100
"""Work of setting up, whole, for each point and for each block of the path."""

DIFFERENCE_MM = 1e-4
"""Shifts this far apart tell how a margin changes."""

TURNS_MAX = 8
"""So many turns of the shoulder are looked at one by one; where more are possible, none is excluded by its sides."""


@dataclass(frozen=True, slots=True)
class Reserve:
    """What is to be kept beyond the deadbands."""

    arm_mm: float = 0.0
    roll_rad: float = 0.0


class Placing:
    """The conditions of one path on a shift, as for the right elbow.

    Attributes:
        geometry: canonical arm; its workspace is not empty.
        lift_mm: least and largest lift that the slide allows; least > largest where there is none.
        centres: wrist centres in slide coordinates, shape (n, 2).
        sample: numbers of points that stand for all, those most likely to object first.
        effort: what all its work is counted on.

    Args:
        problem: a path with usable numbers.
        reserve: kept beyond the deadbands.
        roll: whether the roll's limits count.
        shoulder: whether the shoulder's limits count, not only their span. Without them nothing changes if
            bone and arm turn together about the column, so that a proof holds for every turn of the bone.
        effort: bound on all its work; none if left out.

    Raises:
        EffortSpentError: here and in each method, where the work is more than the bound leaves.
    """

    def __init__(
        self,
        problem: Problem,
        reserve: Reserve,
        *,
        roll: bool = True,
        shoulder: bool = True,
        effort: Effort | None = None,
    ) -> None:
        self.effort = Effort() if effort is None else effort
        self.effort.spend(BUILD + BUILD_POINT * len(problem.tips_mm))
        geometry, segments = canonical(_dense(problem))
        n = len(segments.tip)
        self.effort.spend(BUILD_POINT * max(n - len(problem.tips_mm), 0))
        points = join([at_poses(geometry, segments, slice(i, i + BLOCK)) for i in range(0, n, BLOCK)])
        self.geometry = geometry if shoulder else _unlimited_shoulder(geometry)
        self._shoulder = shoulder
        self.reserve = reserve
        self.keep_mm = geometry.arm_mm + reserve.arm_mm
        self.pad_mm = geometry.pad_mm + WIRE_MM + WIRE_RAD * geometry.tool_mm
        self.centres = points.centre
        height = extremes(geometry, segments, points.height, points.pitch)
        if not shoulder:  # the slide leans the same way however the bone is turned
            rise = height.highest.value - height.lowest.value
            self.pad_mm += rise * math.hypot(*geometry.tilt)
        self.lift_mm = (
            float(geometry.lower[2]) + self.keep_mm - height.lowest.value,
            float(geometry.upper[2]) - self.keep_mm - height.highest.value,
        )
        self._sine = np.sin(points.pitch)
        held = problem.hold_roll is not None and not bool((self._sine >= VERTICAL).any())
        steps = sweep(points.axis_xy[:-1], points.axis_xy[1:])
        self._azimuth = (
            None if held or not roll else points.azimuth[0] + np.concatenate(([0.0], np.cumsum(steps)))
        )
        self._start, self._ball = _blocks(geometry, segments, points, self.effort)
        self._block = np.searchsorted(self._start, np.arange(n), side="right") - 1
        even = np.linspace(0, n - 1, min(SAMPLE, n)).astype(np.int64)
        angles = np.arange(FIRST) * REVOLUTION / FIRST
        farthest = np.argmax(points.centre @ np.stack((np.cos(angles), np.sin(angles))), axis=0)
        turned = [] if self._azimuth is None else [np.argmin(self._azimuth), np.argmax(self._azimuth)]
        self.sample: Ints = _distinct(np.concatenate((np.array(turned, dtype=np.int64), farthest, even)))

    @property
    def domain(self) -> tuple[Floats, Floats]:
        """Corners of a box outside of which no shift keeps every point within the reach, shape (2,) each."""
        space = self.geometry.workspace
        reach = space.radius(space.q1_lo) - self.keep_mm + self.pad_mm
        return -reach - self.centres.min(axis=0), reach - self.centres.max(axis=0)

    @property
    def at_once(self) -> int:
        """So many shifts are looked at in one go: that bounds the memory."""
        return max(1, 2**20 // (len(self.sample) + len(self._start)))

    def excluded(self, shifts: Floats, radii: Floats) -> tuple[Bools, Floats]:
        """Discs of shifts of which it is proved that none fits.

        The signed distance is 1-Lipschitz: if one point's is below what is to be kept by more than the
        radius, every shift of the disc leaves that point too near.

        Args:
            shifts: centres of the discs, slide coordinates, shape (k, 2).
            radii: shape (k,), mm.

        Returns:
            Whether excluded, (k,); and the smallest margin found at the centre, mm, (k,).
        """
        margin = np.full(len(shifts), np.inf)
        out = np.zeros(len(shifts), dtype=np.bool_)
        for rows in (self.sample[:FIRST], self.sample[FIRST:]):
            open_ = np.flatnonzero(~out)
            margin[open_] = np.minimum(
                margin[open_], self.arm_margins(shifts[open_], rows).min(axis=1, initial=np.inf)
            )
            out[open_] = margin[open_] < -(radii[open_] + self.pad_mm)
        for joint in self._followed:
            many = FIRST * np.count_nonzero(~out) > CALL  # a first pass over few costs more than it spares
            for rows in (self.sample[:FIRST], self.sample) if many else (self.sample,):
                open_ = np.flatnonzero(~out)
                out[open_] = self._turns_exclude(joint, shifts[open_], radii[open_] + self.pad_mm, rows)
        return out, margin

    def nearest_sides(self, shifts: Floats) -> tuple[Floats, Ints]:
        """The sample's smallest signed distance to the planar boundary after shifts (k, 2), mm, and whose it is.

        Returns:
            Distances, shape (k,), and the arc's number in `SIDES`, (k,), as for the right elbow.
        """
        margins = self.arm_margins(shifts, self.sample)
        worst = np.argmin(margins, axis=1)
        points = self.centres[self.sample[worst]] + shifts
        bounding = 2 if self.geometry.workspace.full_revolution else 4
        nearest = np.argmin(side_distances(points, self.geometry.workspace)[:, :bounding], axis=1)
        return margins[np.arange(len(shifts)), worst] + self.keep_mm, nearest

    def least_room(self, shift: Floats) -> tuple[float, Floats]:
        """The sample's smallest margin of the arm after a shift (2,), mm, and how it changes with the shift, (2,)."""
        near = shift + np.array(((0.0, 0.0), (DIFFERENCE_MM, 0.0), (0.0, DIFFERENCE_MM)))
        margins = self.arm_margins(near, self.sample)
        least, x, y = margins[:, np.argmin(margins[0])]
        return float(least), np.array((x - least, y - least)) / DIFFERENCE_MM

    def promising(self, shifts: Floats) -> Bools:
        """Whether the points of the sample keep their deadbands and the reserve after shifts (k, 2)."""
        fit: Bools = self.arm_margins(shifts, self.sample).min(axis=1, initial=np.inf) >= 0.0
        for joint in self._followed:
            nothing = np.zeros(len(shifts))
            least, most, _ = self._angle_range(joint, shifts, nothing, self.sample)
            fit &= self._turns_fit(joint, least.max(axis=1), most.min(axis=1))
            if joint == 0:
                fit &= self._sides_allow(shifts, nothing, self.sample, least, most)
        return fit

    def fits(self, shift: Floats) -> bool:
        """Whether all points keep them; those that object most join the sample."""
        rows, one = np.arange(len(self.centres)), shift[None, :]
        margins = self.arm_margins(one, rows)[0]
        objecting = [int(np.argmin(margins))]
        fit = bool(margins.min() >= 0.0)
        for joint in self._followed if fit else ():
            least, most, _ = self._angle_range(joint, one, np.zeros(1), rows)
            objecting += [int(np.nanargmax(least[0])), int(np.nanargmin(most[0]))]
            fit = fit and bool(self._turns_fit(joint, least.max(axis=1), most.min(axis=1))[0])
            if joint == 0 and fit:
                fit = bool(self._sides_allow(one, np.zeros(1), rows, least, most)[0])
                objecting += self._nearest_to_limits(shift, least[0], most[0])
        if not fit:
            self.sample = _distinct(np.concatenate((np.array(objecting), self.sample)))
        return fit

    def arm_margins(self, shifts: Floats, rows: Ints) -> Floats:
        """Signed distance of points to the planar boundary beyond what is to be kept, mm, shape (k, rows)."""
        self.effort.spend(CALL + len(shifts) * len(rows))
        points = (self.centres[rows][None, :, :] + shifts[:, None, :]).reshape(-1, 2)
        distance = signed_distance(points, self.geometry.workspace)
        out: Floats = distance.reshape(len(shifts), len(rows)) - self.keep_mm
        return out

    @property
    def follows_roll(self) -> bool:
        """Whether the roll's limits count: not where it is left out, nor where it is held."""
        return self._azimuth is not None

    @property
    def _followed(self) -> tuple[int, ...]:
        """Joints whose limits ask for one choice of whole turns along the path."""
        shoulder = (0,) if self.geometry.workspace.full_revolution else ()
        return shoulder if self._azimuth is None else (3, *shoulder)

    def _turns_exclude(self, joint: int, shifts: Floats, radii: Floats, rows: Ints) -> Bools:
        """Discs of shifts for which no choice of whole turns keeps a joint within its limits."""
        least, most, clear = self._angle_range(joint, shifts, radii, rows, proving=True)
        least, most = np.where(np.isnan(least), -np.inf, least), np.where(np.isnan(most), np.inf, most)
        fit = self._turns_fit(joint, least.max(axis=1), most.min(axis=1))
        if joint == 0:
            fit &= self._sides_allow(shifts, radii, rows, least, most)
        return clear & ~fit

    def _turns_fit(self, joint: int, least: Floats, most: Floats) -> Bools:
        """Whether a whole number of turns lies between, ends included; NaN is none.

        A shoulder without limits may be turned by any amount, only its span counts.
        """
        if joint == 0 and not self._shoulder:
            return least <= most
        out: Bools = np.ceil(least) <= np.floor(most)
        return out

    def _angle_range(
        self, joint: int, shifts: Floats, radii: Floats, rows: Ints, *, proving: bool = False
    ) -> tuple[Floats, Floats, Bools]:
        """Turns that points ask for: ``least <= k <= most``, each of shape (k, rows), over discs of shifts.

        By dw = a0 e'(q0) dq0 + a1 e'(psi) dpsi, projected on e(q0) and e(psi), a wrist centre moved by
        rho turns the heading psi by at most rho / (a1 sin q1) and the shoulder by rho / (a0 sin q1).
        ``clear`` says for each disc whether the winding about the column is known.
        """
        self.effort.spend(CALL + len(shifts) * (len(rows) + len(self._start)))
        g, space = self.geometry, self.geometry.workspace
        bearing, clear = self._bearing(shifts, radii, rows)
        r = np.hypot(*np.moveaxis(self.centres[rows][None, :, :] + shifts[:, None, :], 2, 0))
        elbow = elbow_angle(r, space.a0, space.a1)
        shoulder = bearing - shoulder_offset(elbow, space.a0, space.a1)
        sines = [elbow_sine(r + sign * radii[:, None], space.a0, space.a1) for sign in (-1.0, 1.0)]
        link = space.a0 if joint == 0 else space.a1
        with np.errstate(divide="ignore", invalid="ignore"):
            slack = radii[:, None] / (link * np.minimum(*sines))
        slack = np.where(radii[:, None] == 0.0, 0.0, slack)
        if joint == 0:
            angle, margin = shoulder, np.zeros((len(rows), 2))
        else:
            angle = self._azimuth_of(rows) - shoulder - elbow
            margin = self._roll_margin(r, rows, proving=proving)
        lower, upper = float(g.lower[joint]) + margin[..., 0], float(g.upper[joint]) - margin[..., 1]
        return (lower - slack - angle) / REVOLUTION, (upper + slack - angle) / REVOLUTION, clear

    def _azimuth_of(self, rows: Ints) -> Floats:
        return np.zeros(len(rows)) if self._azimuth is None else self._azimuth[rows]

    def _roll_margin(self, r: Floats, rows: Ints, *, proving: bool) -> Floats:
        """What the roll keeps from its limits, shape (..., rows, 2); for a proof not more than the least of it."""
        g, sine = self.geometry, self._sine[rows]
        keep = g.wrist_rad + self.reserve.roll_rad
        if not proving:
            return keep + roll_widening(g, r, sine)
        with np.errstate(divide="ignore"):
            rounding = np.minimum(WIRE_RAD + WIRE_RAD / sine, math.pi)
        least = roll_widening(replace(g, error_mm=0.0), sine, sine)
        return keep + np.where(np.isfinite(least), least, 0.0) - rounding[:, None]

    def _bearing(self, shifts: Floats, radii: Floats, rows: Ints) -> tuple[Floats, Bools]:
        """Polar angle of shifted points, followed along the path; and whether that is known in each disc.

        Within a block the path stays in a ball about the block's first point; while the ball leaves the
        column out, the angle from that point is the principal one.
        """
        anchors = self.centres[self._start][None, :, :] + shifts[:, None, :]
        far = np.hypot(anchors[..., 0], anchors[..., 1])
        clear = np.all(far > self._ball + radii[:, None] + self.pad_mm, axis=1)
        first = np.arctan2(anchors[:, :1, 1], anchors[:, :1, 0])
        steps = sweep(anchors[:, :-1], anchors[:, 1:])
        unwrapped = first + np.concatenate((np.zeros_like(first), np.cumsum(steps, axis=1)), axis=1)
        block = self._block[rows]
        points = self.centres[rows][None, :, :] + shifts[:, None, :]
        return unwrapped[:, block] + sweep(anchors[:, block], points), clear

    def _sides_allow(self, shifts: Floats, radii: Floats, rows: Ints, least: Floats, most: Floats) -> Bools:
        """Whether some whole turn of a shoulder of a turn or more leaves every point off left and right, (k,).

        They count within half a turn of their limit; in a disc of shifts only where that is so for all of it.

        Args:
            shifts: centres of the discs, shape (k, 2).
            radii: shape (k,), mm.
            rows: points.
            least: fewest turns that the points ask for over the discs, shape (k, rows).
            most: most turns, likewise.
        """
        out = np.ones(len(shifts), dtype=np.bool_)
        if not self._shoulder or len(shifts) == 0:
            return out
        first, last = np.ceil(least.max(axis=1)), np.floor(most.min(axis=1))
        if not float(last.max() - first.min()) < TURNS_MAX:
            return out
        left, right = (d < self.keep_mm - radii[:, None] for d in self._to_limits(shifts, rows))
        out[:] = False
        for turn in np.arange(first.min(), last.max() + 1.0):
            near = (left & (most - turn <= 0.5)) | (right & (turn - least <= 0.5))
            out |= (first <= turn) & (turn <= last) & ~near.any(axis=1)
        return out

    def _to_limits(self, shifts: Floats, rows: Ints) -> tuple[Floats, Floats]:
        """Distances of points to the arcs left and right, mm, each of shape (k, rows)."""
        self.effort.spend(CALL + 2 * len(shifts) * len(rows))
        points = (self.centres[rows][None, :, :] + shifts[:, None, :]).reshape(-1, 2)
        left, right = (
            distance_to_arc(points, arc).reshape(len(shifts), len(rows)) for arc in self.geometry.arcs[2:]
        )
        return left, right

    def _nearest_to_limits(self, shift: Floats, least: Floats, most: Floats) -> list[int]:
        """The points nearest to left and right where these count, in the first turn that the points allow."""
        turn = math.ceil(float(least.max()))
        distances = self._to_limits(shift[None, :], np.arange(len(self.centres)))
        counts = (most - turn <= 0.5, turn - least <= 0.5)
        return [
            int(np.argmin(np.where(near, d[0], np.inf))) for d, near in zip(distances, counts, strict=True)
        ]


def _unlimited_shoulder(geometry: Geometry) -> Geometry:
    """The same arm with a workspace of a full turn; its joint limits keep the shoulder's span."""
    workspace = replace(geometry.workspace, q0_lo=-math.pi, q0_hi=math.pi)
    return replace(geometry, workspace=workspace, arcs=workspace.arcs)


def _distinct(rows: Ints) -> Ints:
    """Each number once, in order of first appearance."""
    return rows[np.sort(np.unique(rows, return_index=True)[1])]


def _dense(problem: Problem) -> Problem:
    """The same path with poses inserted where its segments are long or turn the tool far."""
    if len(problem.tips_mm) < 2:
        return problem
    geometry, segments = canonical(problem)
    wrist = problem.tips_mm + problem.tool_length_mm * problem.axes
    chord = np.linalg.norm(np.diff(wrist, axis=0), axis=1)
    sag = sagitta(geometry, segments.theta)
    parts = np.ceil(np.maximum(chord / SPACING_MM, np.sqrt(sag / SAG_MM)))
    while int((parts - 1).clip(0).sum()) > POINTS_MAX:
        parts = np.ceil(parts / 2.0)
    count = parts.clip(1).astype(np.int64)
    segment = np.repeat(np.arange(len(count)), count)
    s = (np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)) / count[segment]
    tips, axes = problem.tips_mm, problem.axes
    tip = tips[segment] + s[:, None] * (tips[segment + 1] - tips[segment])
    axis = slerp(axes[segment], axes[segment + 1], segments.theta[segment], s)
    return replace(problem, tips_mm=np.vstack((tip, tips[-1:])), axes=np.vstack((axis, axes[-1:])))


def _blocks(geometry: Geometry, segments: Segments, points: Points, effort: Effort) -> tuple[Ints, Floats]:
    """Cut the path into blocks: first point of each, and the ball about it that holds the block, mm.

    A block includes the next one's first point.
    """
    space = geometry.workspace
    largest = max(space.radius(space.q1_hi) / 2.0, (space.a0 + space.a1) / 20.0)
    sag = np.append(sagitta(geometry, segments.theta), 0.0)
    start, ball, i, last = [], [], 0, len(points) - 1
    size = BLOCK
    while i < last:
        size = min(2 * size, BLOCK)
        effort.spend(BUILD_BLOCK + size // 8)
        stop = min(i + size, last)
        away = np.hypot(*(points.centre[i : stop + 1] - points.centre[i]).T)
        outside = np.flatnonzero(away > largest)
        stop = i + max(int(outside[0]) - 1, 1) if len(outside) else stop
        size = stop - i  # blocks are much alike: no more than twice the last is looked at
        start.append(i)
        ball.append(float(away[: stop - i + 1].max() + sag[i:stop].max()))
        i = stop
    return np.array(start), np.array(ball)
