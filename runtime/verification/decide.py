"""Whether a path is admissible, and nothing else: one look at each segment, by + - * / and roots alone.

A point of a segment is no further from the nearer of its two poses than half the chord of the wrist centre and what the
curve leaves that chord. So what holds of the poses, with so much to spare, holds between them:

* The tool axis turns by theta <= pi/2 |du|, and leaves its own chord by at most theta^2 / 8; the wrist centre by so much
  times the tool's length.
* A distance from the column, or from an arc, changes by no more than the wrist centre moves. The side arcs lie, besides,
  on one side of a line through the column, and so does no point on its other side.
* The heading of the forearm turns by at most the movement of the wrist centre over a1 sin q1; sin q1 is least at the ends of
  the range of r, for (a0 a1 sin q1)^2 is concave in r^2. The tool's azimuth is monotone. So the roll lies between those at
  the poses but for three times what the heading turns from the nearer pose; it is compared as a direction, not as an angle:
  within less than a turn no path gets from one end of its limits to the other but through them.
* Joint speeds and accelerations follow from the feed: neither tip nor tool end is faster (`motion.angles_of`).

Segments of which that does not prove it are verified by themselves, in runs, by `certified`; so is the whole path where
shoulder or roll may turn by a revolution and more, the tool may stand vertical, or anything about the numbers is wrong.

Example:
    ``stroke`` is that of `problem`.

    >>> from dataclasses import replace
    >>> decide(stroke)
    Decided(admissible=True, branch=(0, 0), open_segments=0)
    >>> decide(replace(stroke, feed_mm_s=float("nan"))).admissible
    False
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from cutgate.protocol.arrays import Bools, Floats
from cutgate.runtime.kinematics.arm import REVOLUTION
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.bounds.geometry import (
    EPSILON,
    LARGEST_TURN,
    ROUNDINGS,
    Geometry,
    canonical_arm,
)
from cutgate.runtime.verification.branch import confined, reported
from cutgate.runtime.verification.defects import bad_numbers
from cutgate.runtime.verification.problem import Problem

Rows = np.ndarray[tuple[int], np.dtype[np.intp]]

BLOCK: Final = 8192
"""Poses looked at at once: few enough for the cache."""

RUNS_MAX: Final = 16
"""More runs than this are not worth while: the whole path is verified."""

GAP: Final = 8
"""Runs with no more closed segments than this between them are one."""

SINE_MIN: Final = 1e-3
"""Nearer to a straight or a folded elbow, or to the vertical, nothing is proved in one look."""

UNIT: Final = 1e-12
"""An axis is as long as 1 to this, squared, or it is left to the whole verification."""

TURN2_MAX: Final = (2.0 * math.sin(LARGEST_TURN / 2)) ** 2 * (1.0 - 1e-9)
"""Squared chord of the largest turn between neighbouring axes."""

SHORTEST_MM: Final = 1e-6
"""A segment that moves at all moves the wrist centre, or turns the tool's length, by this; else it is left open."""

SAG: Final = math.pi**2 / 32.0
"""An axis that turns by du leaves its chord by at most this times |du|^2."""


class Error(NamedTuple):
    """How far the bone may stand from where it is taken to stand: turned about a vertical, then moved.

    Attributes:
        ball_mm: any translation up to this.
        yaw_rad: any turn up to this, either way.
        pivot_mm: of the turn, x and y.
    """

    ball_mm: float
    yaw_rad: float = 0.0
    pivot_mm: tuple[float, float] = (0.0, 0.0)


EXACT: Final = Error(0.0)


class Decided(NamedTuple):
    """What is decided.

    Attributes:
        admissible: as `certified.verify` says.
        branch: (q0_turns, roll_turns); None where no branch holds the path.
        open_segments: of how many one look proved too little.
    """

    admissible: bool
    branch: tuple[int, int] | None
    open_segments: int


def decide(problem: Problem) -> Decided:
    """Whether a path keeps every deadband for all its points, arm and wrist together."""
    arm = _Arm.of(problem)
    if arm is None:
        return _verified(problem, len(problem.tips_mm) - 1)
    branch = _branch(arm, problem)
    if branch is None or problem.branch not in {None, branch}:
        return _verified(problem, len(problem.tips_mm) - 1)
    opened = _open_segments(arm, problem)
    runs = _runs(opened)
    if len(runs) > RUNS_MAX:
        return _verified(problem, len(opened))
    for first, last in runs:
        part = slice(first, last + 2)
        piece = replace(problem, tips_mm=problem.tips_mm[part], axes=problem.axes[part], branch=branch)
        if not certified.verify(piece).admissible:
            return _verified(problem, len(opened))
    return Decided(admissible=True, branch=branch, open_segments=len(opened))


class Around:
    """Whether a path is admissible wherever its bone stands within an error, as far as one look proves it.

    The placements within an error are one connected set, and where no boundary is met in it the branch is one as well.

    Args:
        problem: an admissible path.
    """

    def __init__(self, problem: Problem) -> None:
        arm = _Arm.of(problem)
        known = arm is not None and _branch(arm, problem) is not None
        self._looks = list(_looks(arm, problem)) if arm is not None and known else None

    def holds(self, error: Error) -> bool:
        """Whether it is proved; False where it is not, whatever is true."""
        return self._looks is not None and all(_holds(look, error) for look in self._looks)


def _holds(look: _Look, error: Error) -> bool:
    with np.errstate(invalid="ignore", divide="ignore"):
        return bool(look.keeps(_Whole, error)) or bool(look.keeps(_Each, error).all())


def _verified(problem: Problem, open_segments: int) -> Decided:
    verdict = certified.verify(problem)
    found = verdict.branch
    branch = None if found is None else (found.q0_turns, found.roll_turns)
    return Decided(verdict.admissible, branch, open_segments)


def _runs(rows: Rows) -> list[tuple[int, int]]:
    """First and last segment of each run of open ones, those close together joined."""
    if len(rows) == 0:
        return []
    ends = np.flatnonzero(np.diff(rows) > GAP)
    firsts, lasts = rows[np.append(0, ends + 1)], rows[np.append(ends, len(rows) - 1)]
    return list(zip(firsts.tolist(), lasts.tolist(), strict=True))


# ---------------------------------------------------------------- the arm


@dataclass(frozen=True)
class _Arm:
    """The canonical arm and what of its limits one look compares with.

    Attributes:
        geometry: the arm.
        inner_mm, outer_mm: least and largest distance from the column, deadband kept, mm.
        slide_mm: least and largest height, deadband kept.
        upright: least and largest vertical part of the axis, deadbands of pitch and singularity kept.
        sides: what the wrist centre is multiplied by for `_Look.seen`, shape (4, 2) ...
        side_square: ... and what is added, shape (4, 1).
        roll_middle: direction of the middle of the roll's limits, cosine and sine.
        roll_half: half their width, deadband kept, rad.
    """

    geometry: Geometry
    inner_mm: float
    outer_mm: float
    slide_mm: tuple[float, float]
    upright: tuple[float, float]
    sides: Floats
    side_square: Floats
    roll_middle: tuple[float, float]
    roll_half: float

    @classmethod
    def of(cls, problem: Problem) -> _Arm | None:
        """None where one look is not meant for this arm, its limits, or a path of one pose."""
        n, calibration = len(problem.tips_mm), problem.calibration
        joints = [problem.lower, problem.upper, problem.speed, calibration.joint_offset]
        joints += [] if problem.acceleration is None else [problem.acceleration]
        shapes = [each.shape for each in (problem.tips_mm, problem.axes, calibration.slide_tilt, *joints)]
        if n < 2 or shapes != [(n, 3), (n, 3), (2,), *[(5,)] * len(joints)]:
            return None
        if bad_numbers(problem) or not all(map(math.isfinite, np.concatenate(joints).tolist())):
            return None
        g = canonical_arm(problem)
        space = g.workspace
        lower, upper = g.lower, g.upper
        if space.empty or space.full_revolution or not (confined(g, 0) and confined(g, 3)):
            return None
        half = float(upper[3] - lower[3]) / 2 - g.wrist_rad
        least = max(float(lower[4]), 0.0) + g.wrist_rad
        most = min(float(upper[4]), math.pi) - g.wrist_rad
        keeps = 0.0 < half < math.pi and 0.0 < least < most < math.pi and problem.tool_length_mm > 0.0
        if not (keeps and float(upper[3] - lower[3]) < REVOLUTION):
            return None
        middle = float(lower[3] + upper[3]) / 2
        (lx, ly), (rx, ry) = ((math.cos(q0), math.sin(q0)) for q0 in (space.q0_hi, space.q0_lo))
        double = -2.0 * space.a0
        return cls(
            g,
            sides=np.array(((double * lx, double * ly), (double * rx, double * ry), (-ly, lx), (-ry, rx))),
            side_square=np.array(((space.a0**2,), (space.a0**2,), (0.0,), (0.0,))),
            inner_mm=g.arcs[0].radius + g.arm_mm + g.pad_mm,
            outer_mm=g.arcs[1].radius - g.arm_mm - g.pad_mm,
            slide_mm=(float(lower[2]) + g.arm_mm + g.pad_mm, float(upper[2]) - g.arm_mm - g.pad_mm),
            upright=(math.cos(most) + 8 * UNIT, math.cos(least) - 8 * UNIT),
            roll_middle=(math.cos(middle), math.sin(middle)),
            roll_half=half,
        )


def _branch(arm: _Arm, problem: Problem) -> tuple[int, int] | None:
    """The whole turns of shoulder and roll at the first pose; None where it lies outside of the limits."""
    g, space = arm.geometry, arm.geometry.workspace
    tip, axis = problem.tips_mm[0] * (1.0, g.side, 1.0), problem.axes[0] * (1.0, g.side, 1.0)
    x, y, z = (float(value) for value in tip + g.tool_mm * axis)
    x, y = x - z * float(g.tilt[0]), y - z * float(g.tilt[1])
    cosine = (x * x + y * y - space.a0**2 - space.a1**2) / (2.0 * space.a0 * space.a1)
    if not -1.0 < cosine < 1.0:
        return None
    q1 = math.acos(cosine)
    q0 = math.atan2(y, x) - math.atan2(space.a1 * math.sin(q1), space.a0 + space.a1 * cosine)
    roll = math.atan2(float(axis[1]), float(axis[0])) - q0 - q1
    turned = [float(g.lower[j]) + (q - float(g.lower[j])) % REVOLUTION for j, q in ((0, q0), (3, roll))]
    if not (space.q1_lo <= q1 <= space.q1_hi and turned[0] <= g.upper[0] and turned[1] <= g.upper[3]):
        return None
    return reported(g, 0, turned[0]), reported(g, 3, turned[1])


# ---------------------------------------------------------------- one look


def _open_segments(arm: _Arm, problem: Problem) -> Rows:
    """Numbers of the segments of which one look proves too little."""
    found = []
    for number, look in enumerate(_looks(arm, problem)):
        with np.errstate(invalid="ignore", divide="ignore"):
            if not look.keeps(_Whole):
                kept = look.keeps(_Each)
                found.append(number * BLOCK + np.flatnonzero(~(kept[:-1] & kept[1:])))
    return np.concatenate(found) if found else np.zeros(0, dtype=np.intp)


def _looks(arm: _Arm, problem: Problem) -> Iterator[_Look]:
    """Block by block; neighbours share a pose."""
    n = len(problem.tips_mm) - 1
    return (_Look.at(arm, problem, slice(i, min(i + BLOCK, n) + 1)) for i in range(0, n, BLOCK))


class _Whole:
    """The rules asked of all poses at once, by the worst value of each quantity: floats."""

    sqrt, lesser, greater = math.sqrt, min, max

    @staticmethod
    def least(poses: Floats) -> float:
        """The worst where small is bad."""
        return float(poses.min())

    @staticmethod
    def most(poses: Floats) -> float:
        """The worst where large is bad."""
        return float(poses.max())

    @staticmethod
    def all(poses: Bools) -> bool:
        """Whether a rule holds at every pose."""
        return bool(poses.all())

    @staticmethod
    def any_of(segments: Bools) -> np.bool_:
        """Whether there is such a segment."""
        return np.bool_(segments.any())

    @staticmethod
    def beside(segments: Floats) -> float:
        """The worst of all segments."""
        return float(segments.max())

    @staticmethod
    def motion(look: _Look) -> tuple[float, float, float]:
        """Neither the tip nor the axis times the tool's length is faster than the feed."""
        feed, g = look.problem.feed_mm_s, look.arm.geometry
        return 2.0 * g.stretch * feed, 2.0 * feed, math.pi / 2 * feed / g.tool_mm


class _Each:
    """The rules asked of each pose: arrays of shape (m + 1,)."""

    sqrt, lesser, greater = np.sqrt, np.minimum, np.maximum

    @staticmethod
    def least(poses: Floats) -> Floats:
        """What each has."""
        return poses

    most = least

    @staticmethod
    def all(poses: Bools) -> Bools:
        """Whether it holds at each."""
        return poses

    @staticmethod
    def any_of(segments: Bools) -> Bools:
        """Whether one of the two that meet there is such a segment."""
        out: Bools = np.append(segments, False) | np.append(False, segments)
        return out

    @staticmethod
    def beside(segments: Floats) -> Floats:
        """The worse of the two segments that meet there."""
        out: Floats = np.maximum(np.append(segments, segments[-1]), np.append(segments[0], segments))
        return out

    @staticmethod
    def motion(look: _Look) -> tuple[Floats, Floats, Floats]:
        """A derivative leaves its mean over the segment by at most half of the second one."""
        g = look.arm.geometry
        step = look.tip[:, 1:] - look.tip[:, :-1]
        turn = np.sqrt(look.turn2)
        way = np.maximum(np.sqrt(np.einsum("ij,ij->j", step, step)), g.tool_mm * turn)
        hertz = np.where(way > 0.0, look.problem.feed_mm_s / way, 0.0)  # one over the least time
        bulge = 4.0 * g.tool_mm * SAG * look.turn2
        planar = g.stretch * (np.sqrt(look.chord2) + bulge) * hertz
        upward = (np.abs(look.z[1:] - look.z[:-1]) + bulge) * hertz
        return _Each.beside(planar), _Each.beside(upward), _Each.beside(math.pi / 2 * turn * hertz)


Over = type[_Whole] | type[_Each]


@dataclass(frozen=True)
class _Look:
    """One look at m consecutive segments. Arrays of their poses have shape (m + 1,), those of segments (m,).

    Attributes:
        tip, axis: shape (3, m + 1), right elbow.
        x, y, z: wrist centre, x and y in slide coordinates, mm.
        seen: what squared distances from the elbow at the limits of q0 add to `square`, mm2, and how far the wrist
            centre lies beside those upper links, mm; left and right of each, shape (4, m + 1).
        square: squared distance of the wrist centre from the column.
        level2: squared length of the axis' horizontal part.
        chord2: squared chords of the wrist centre.
        turn2: squared chords of the axis.
    """

    arm: _Arm
    problem: Problem
    tip: Floats
    axis: Floats
    x: Floats
    y: Floats
    z: Floats
    seen: Floats
    square: Floats
    level2: Floats
    chord2: Floats
    turn2: Floats

    @classmethod
    def at(cls, arm: _Arm, problem: Problem, part: slice) -> _Look:
        """At these poses."""
        g = arm.geometry
        tip, axis = np.array(problem.tips_mm[part].T, order="C"), np.array(problem.axes[part].T, order="C")
        if g.side < 0.0:
            tip[1], axis[1] = -tip[1], -axis[1]
        wrist = tip + g.tool_mm * axis
        centre, z = wrist[:2], wrist[2]
        if g.tilt[0] or g.tilt[1]:
            centre = centre - g.tilt[:, None] * z
        x, y = centre
        turned = axis[:, 1:] - axis[:, :-1]
        step = wrist[:, 1:] - wrist[:, :-1]
        return cls(
            arm,
            problem,
            tip,
            axis,
            x,
            y,
            z,
            seen=arm.sides @ centre + arm.side_square,
            square=x * x + y * y,
            level2=axis[0] * axis[0] + axis[1] * axis[1],
            chord2=np.einsum("ij,ij->j", step, step),
            turn2=np.einsum("ij,ij->j", turned, turned),
        )

    def keeps(self, over: Over, error: Error = EXACT) -> Any:
        """Whether everything is kept as far from a pose as the path is from its nearer one: of all poses, or each, (m + 1,)."""
        g = self.arm.geometry
        turn2 = over.beside(self.turn2)
        sag_mm = g.stretch * g.tool_mm * SAG * turn2
        moved_mm, turned = self._moved(over, error)
        reach_mm = g.stretch / 2 * over.sqrt(over.beside(self.chord2)) + sag_mm + moved_mm
        nearest = over.sqrt(over.least(self.square)) - reach_mm
        farthest = over.sqrt(over.most(self.square)) + reach_mm
        bend = self._elbow_sine(over, nearest - g.error_mm, farthest + g.error_mm)
        level = over.sqrt(over.least(self.level2)) - math.pi / 4 * over.sqrt(
            turn2
        )  # sin q4, 1-Lipschitz in the turn
        sines = over.greater(bend, SINE_MIN), over.greater(level, SINE_MIN)
        return (
            (bend >= SINE_MIN)
            & (level >= SINE_MIN)
            & self._axis_keeps(over, turn2)
            & ~over.any_of(self._barely_moves())
            & (nearest >= self.arm.inner_mm)
            & (farthest <= self.arm.outer_mm)
            & (over.least(self.z) - sag_mm - error.ball_mm >= self.arm.slide_mm[0])
            & (over.most(self.z) + sag_mm + error.ball_mm <= self.arm.slide_mm[1])
            & self._sides_keep(over, reach_mm, farthest)
            & self._roll_keeps(
                over, (reach_mm, moved_mm, turned), (over.greater(nearest, g.arm_mm), farthest), sines
            )
            & self._rates_keep(over, farthest, sines)
        )

    def _barely_moves(self) -> Bools:
        """Segments as short as what rounds them, but not at rest: what bounds their speed is mostly rounding, (m,)."""
        size2 = self.chord2 + self.arm.geometry.tool_mm**2 * self.turn2
        return (size2 > 0.0) & (size2 < SHORTEST_MM**2)

    def _moved(self, over: Over, error: Error) -> tuple[Any, float]:
        """How far the bone's error moves a wrist centre in slide coordinates, and turns an azimuth, at most."""
        g = self.arm.geometry
        if error.yaw_rad == 0.0:
            return g.stretch * error.ball_mm, 0.0
        x, y = self.x - error.pivot_mm[0], self.y - g.side * error.pivot_mm[1]
        away_mm = np.sqrt(x * x + y * y) + math.hypot(*g.tilt) * np.abs(self.z)
        chord = 2.0 * math.sin(error.yaw_rad / 2)
        return g.stretch * error.ball_mm + chord * over.most(away_mm), error.yaw_rad

    def _elbow_sine(self, over: Over, nearest_mm: Any, farthest_mm: Any) -> Any:
        """Least sin q1 between two distances from the column; 0 where they reach too far or not far enough."""
        a0, a1 = self.arm.geometry.workspace.a0, self.arm.geometry.workspace.a1
        near, far = ((r * r - a0 * a0 - a1 * a1) / (2.0 * a0 * a1) for r in (nearest_mm, farthest_mm))
        square = over.lesser(1.0 - near * near, 1.0 - far * far)
        return over.sqrt(over.greater(square, 0.0)) * (nearest_mm > 0.0)

    def _axis_keeps(self, over: Over, turn2: Any) -> Any:
        """Pitch and singularity; and that the axes are such that a great circle joins them."""
        up, (low, high), lean = self.axis[2], self.arm.upright, SAG * turn2
        long2 = self.level2 + up * up
        return (
            (over.least(long2) >= 1.0 - UNIT)
            & (over.most(long2) <= 1.0 + UNIT)
            & (turn2 <= TURN2_MAX)
            & (over.least(up) - lean >= low)
            & (over.most(up) + lean <= high)
        )

    def _sides_keep(self, over: Over, reach_mm: Any, farthest: Any) -> Any:
        """The side arcs: of radius a1 about the elbow at either limit of q0, and on one side of a line through the column."""
        g, space = self.arm.geometry, self.arm.geometry.workspace
        line_mm = space.a1 * min(math.sin(space.q1_lo), math.sin(space.q1_hi))
        rounded = (
            ROUNDINGS * EPSILON * (farthest + space.a0) * (farthest + space.a0) / space.a1
        )  # of a square
        keep = reach_mm + (g.arm_mm + g.pad_mm) + rounded
        outside, inside = (space.a1 + keep) ** 2, over.greater(space.a1 - keep, 0.0) ** 2
        about2, across = self.square + self.seen[:2], self.seen[2:]
        keeps: Any = (about2 >= outside) | (about2 <= inside) | (across <= line_mm - keep)
        return over.all(keeps[0] & keeps[1])

    def _roll_keeps(
        self, over: Over, way: tuple[Any, Any, float], radii: tuple[Any, Any], sines: tuple[Any, Any]
    ) -> Any:
        """The axis turned back by the forearm's heading points within the roll's limits.

        With c the wrist centre, D its squared distance from the column, A = (D + a1^2 - a0^2) / 2 and B = a0 a1 sin q1,
        the forearm is (A c + B c') / D, c' being c turned by a right angle.
        """
        g, space, half = self.arm.geometry, self.arm.geometry.workspace, self.arm.roll_half
        a0, a1, (nearest, farthest), (bend, level) = space.a0, space.a1, radii, sines
        part = self.square / 2 + (a1 * a1 - a0 * a0) / 2
        other = np.sqrt(a1 * a1 * self.square - part * part)
        fx, fy = self.x * part - self.y * other, self.x * other + self.y * part
        ux, uy = self.axis[0], self.axis[1]
        (cosine, sine), toward = self.arm.roll_middle, ux * fx + uy * fy
        if sine != 0.0:
            toward = toward * cosine + (uy * fx - ux * fy) * sine
        rounding = 8.0 + 1.0 / level + farthest / (a0 * bend) + (farthest**2 + a0**2 + a1**2) / (a1 * nearest)
        reach_mm, moved_mm, turned = way
        slack = turned + (3.0 * reach_mm - 2.0 * moved_mm + g.error_mm) / (a1 * bend)
        slack += self._azimuth_error(over, level)
        slack += 2.0 * g.pad_mm / (min(a0, a1) * bend) + ROUNDINGS * EPSILON * rounding
        # cos(half - slack), for its second derivative is at most 1
        bound = math.cos(half) + slack * (math.sin(half) + slack / 2)
        return over.all(toward >= np.sqrt(self.level2) * self.square * (a1 * bound))

    def _azimuth_error(self, over: Over, level: Any) -> Any:
        """What the axis' error turns its azimuth by besides itself: an arc is no longer than its tangent."""
        error = self.arm.geometry.error_rad
        if error == 0.0:
            return 0.0
        ratio = math.sin(error) / level
        room = over.greater(1.0 - ratio * ratio, EPSILON)
        return ratio / over.sqrt(room) - error

    def _rates_keep(self, over: Over, farthest: Any, sines: tuple[Any, Any]) -> Any:
        """Joint speeds and accelerations, as `motion.angles_of` derives them, in seconds."""
        g, space, (bend, level) = self.arm.geometry, self.arm.geometry.workspace, sines
        a0, a1, links = space.a0, space.a1, space.a0 * space.a1
        planar, upward, turning = over.motion(self)
        q0, heading = planar / (a0 * bend), planar / (a1 * bend)
        q1 = over.lesser(q0 + heading, farthest * planar / (links * bend))
        keeps = _below(self.problem.speed, (q0, q1, upward, turning / level + heading, turning))
        if self.problem.acceleration is None:
            return keeps
        pull = g.stretch * g.tool_mm * turning * turning
        pulled = (pull + a0 * q0 * q0 + a1 * heading * heading) / bend
        stretched = (planar * planar + farthest * pull + links * q1 * q1) / (links * bend)
        azimuth = turning / level
        second = (
            pulled / a0,
            over.lesser(pulled / a0 + pulled / a1, stretched),
            g.tool_mm * turning * turning,
            2.0 * azimuth * azimuth + pulled / a1,
            turning * azimuth,
        )
        return keeps & _below(self.problem.acceleration, second)


def _below(limits: Floats, rates: tuple[Any, ...]) -> Any:
    """Whether every joint's rate is below its limit, rounded down for what rounds the rate."""
    keeps = True
    for limit, rate in zip(limits.tolist(), rates, strict=True):
        keeps &= rate <= limit * (1.0 - ROUNDINGS * EPSILON)
    return keeps
