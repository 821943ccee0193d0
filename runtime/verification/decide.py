"""Whether a path is admissible, and nothing else: one look at each segment, by + - * / and roots alone.

A point of a segment is no further from the nearer of its two poses than half the chord of the wrist centre and what the
curve leaves that chord. So what holds of the poses, with so much to spare, holds between them:

* The tool axis turns by theta <= pi/2 |du|, and leaves its own chord by at most theta^2 / 8; the wrist centre by so much
  times the tool's length.
* A distance from the column, or from an arc, changes by no more than the wrist centre moves. The side arcs lie, besides,
  on one side of a line through the column, and so does no point on its other side.
* The heading of the forearm turns by at most the movement of the wrist centre over a1 sin q1; sin q1 is least at the ends of
  the range of r, for (a0 a1 sin q1)^2 is concave in r^2. The tool's azimuth is monotone. So the roll lies between those at
  the poses but for three times what the heading turns from the nearer pose. It is compared as a direction, not as an angle:
  what the axis turns in one segment must be too little to bring the roll from one end of its limits across what they leave
  out to the other.
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

SHORTEST2_MM2: Final = 1e-12
"""A segment that moves at all moves the wrist centre, or turns the tool's length, by this, squared; else it is left open."""

TURN_MIN: Final = 1e-9
"""Nearer to where its turn changes, as a part of a revolution, a reported joint's turn is left to the whole verification."""

SAG: Final = math.pi**2 / 32.0
"""An axis that turns by du leaves its chord by at most this times |du|^2."""


class Displacement(NamedTuple):
    """How far the bone may stand from where it is taken to stand: turned about a vertical, then moved.

    Attributes:
        ball_mm: any translation up to this.
        yaw_rad: any turn up to this, either way.
        pivot_mm: of the turn, x and y.
        level: whether only level translations are meant, which leave every height as it is.
    """

    ball_mm: float
    yaw_rad: float = 0.0
    pivot_mm: tuple[float, float] = (0.0, 0.0)
    level: bool = False

    @property
    def rise_mm(self) -> float:
        """How far a height may change."""
        return 0.0 if self.level else self.ball_mm


EXACT: Final = Displacement(0.0)


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
        piece = replace(problem, tips_mm=problem.tips_mm[part], axes=problem.axes[part])
        # turns are counted at a path's first pose, and limits of less than a revolution leave one choice
        piece = replace(piece, branch=_branch(arm, piece))
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

    def holds(self, error: Displacement) -> bool:
        """Whether it is proved; False where it is not, whatever is true."""
        return self._looks is not None and all(_holds(look, error) for look in self._looks)


def _holds(look: _Look, error: Displacement) -> bool:
    with np.errstate(all="ignore"):
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
    ends = np.flatnonzero(np.diff(rows) > GAP + 1)
    firsts, lasts = rows[np.append(0, ends + 1)], rows[np.append(ends, len(rows) - 1)]
    return list(zip(firsts.tolist(), lasts.tolist(), strict=True))


# ---------------------------------------------------------------- the arm


@dataclass(frozen=True, slots=True)
class _Arm:
    """The canonical arm and what of its limits one look compares with.

    Attributes:
        geometry: the arm.
        inner_mm, outer_mm: least and largest distance from the column, deadband kept, mm.
        slide_mm: least and largest height, deadband kept.
        upright: least and largest vertical part of the axis, deadbands of pitch and singularity kept.
        sides: what (x, y, z, square) of the wrist centre is multiplied by for `_Look.seen`, shape (4, 4).
        line_mm: how far to the left of either upper link its side arc begins.
        roll_middle: direction of the middle of the roll's limits, cosine and sine.
        roll_half: half their width, deadband kept, rad.
    """

    geometry: Geometry
    inner_mm: float
    outer_mm: float
    slide_mm: tuple[float, float]
    upright: tuple[float, float]
    sides: Floats
    line_mm: float
    roll_middle: tuple[float, float]
    roll_half: float

    @classmethod
    def of(cls, problem: Problem) -> _Arm | None:
        """None where one look is not meant for this arm, its limits, or a path of one pose."""
        n, calibration = len(problem.tips_mm), problem.calibration
        joints = [problem.lower, problem.upper, problem.speed, calibration.joint_offset]
        if problem.acceleration is not None:
            joints.append(problem.acceleration)
        whole = problem.tips_mm.shape == problem.axes.shape == (n, 3) and calibration.slide_tilt.shape == (2,)
        if n < 2 or not whole or any(joint.shape != (5,) for joint in joints):
            return None
        finite = all(math.isfinite(value) for joint in joints for value in joint.tolist())
        if not finite or bad_numbers(problem):
            return None
        g = canonical_arm(problem)
        space = g.workspace
        if space.empty or space.full_revolution or not (confined(g, 0) and confined(g, 3)):
            return None
        lower, upper = g.lower.tolist(), g.upper.tolist()
        half = (upper[3] - lower[3]) / 2 - g.wrist_rad
        least = max(lower[4], 0.0) + g.wrist_rad
        most = min(upper[4], math.pi) - g.wrist_rad
        keeps = 0.0 < half < math.pi and 0.0 < least < most < math.pi and problem.tool_length_mm > 0.0
        if not (keeps and upper[3] - lower[3] < REVOLUTION):
            return None
        middle = (lower[3] + upper[3]) / 2
        (lx, ly), (rx, ry) = ((math.cos(q0), math.sin(q0)) for q0 in (space.q0_hi, space.q0_lo))
        double = -2.0 * space.a0
        return cls(
            g,
            inner_mm=g.arcs[0].radius + g.arm_mm + g.pad_mm,
            outer_mm=g.arcs[1].radius - g.arm_mm - g.pad_mm,
            slide_mm=(lower[2] + g.arm_mm + g.pad_mm, upper[2] - g.arm_mm - g.pad_mm),
            upright=(math.cos(most) + 8 * UNIT, math.cos(least) - 8 * UNIT),
            sides=np.array(
                (
                    (double * lx, double * ly, 0.0, 1.0),
                    (double * rx, double * ry, 0.0, 1.0),
                    (-ly, lx, 0.0, 0.0),
                    (-ry, rx, 0.0, 0.0),
                )
            ),
            line_mm=space.a1 * min(math.sin(space.q1_lo), math.sin(space.q1_hi)),
            roll_middle=(math.cos(middle), math.sin(middle)),
            roll_half=half,
        )


def _branch(arm: _Arm, problem: Problem) -> tuple[int, int] | None:
    """The whole turns of shoulder and roll at the first pose.

    None where it lies outside of the limits, or so near to where a turn changes that rounding decides which it is.
    """
    g, space = arm.geometry, arm.geometry.workspace
    (tx, ty, tz), (ux, uy, uz) = problem.tips_mm[0].tolist(), problem.axes[0].tolist()
    ty, uy = g.side * ty, g.side * uy
    x, y, z = tx + g.tool_mm * ux, ty + g.tool_mm * uy, tz + g.tool_mm * uz
    lean_x, lean_y = g.tilt.tolist()
    x, y = x - z * lean_x, y - z * lean_y
    cosine = (x * x + y * y - space.a0 * space.a0 - space.a1 * space.a1) / (2.0 * space.a0 * space.a1)
    if not -1.0 < cosine < 1.0:
        return None
    q1 = math.acos(cosine)
    q0 = math.atan2(y, x) - math.atan2(space.a1 * math.sin(q1), space.a0 + space.a1 * cosine)
    roll = math.atan2(uy, ux) - q0 - q1
    if not space.q1_lo <= q1 <= space.q1_hi:
        return None
    found = []
    for joint, angle in ((0, q0), (3, roll)):
        lower, upper = float(g.lower[joint]), float(g.upper[joint])
        turned = lower + (angle - lower) % REVOLUTION
        turn = (turned - float(g.offset[joint])) / REVOLUTION + 0.5
        if not (turned <= upper and abs(turn - round(turn)) > TURN_MIN):
            return None
        found.append(reported(g, joint, turned))
    return found[0], found[1]


# ---------------------------------------------------------------- one look


def _open_segments(arm: _Arm, problem: Problem) -> Rows:
    """Numbers of the segments of which one look proves too little."""
    found = [np.zeros(0, dtype=np.intp)]
    with np.errstate(all="ignore"):  # what is no number, or too large for one, keeps nothing
        for number, look in enumerate(_looks(arm, problem)):
            if not look.keeps(_Whole):
                kept = look.keeps(_Each)
                found.append(number * BLOCK + np.flatnonzero(~(kept[:-1] & kept[1:])))
    return np.concatenate(found)


def _looks(arm: _Arm, problem: Problem) -> Iterator[_Look]:
    """Block by block; neighbours share a pose."""
    n = len(problem.tips_mm) - 1
    return (_Look.at(arm, problem, slice(i, min(i + BLOCK, n) + 1)) for i in range(0, n, BLOCK))


class _Worst(NamedTuple):
    """Of all poses, or around each: floats, or arrays of shape (m + 1,).

    Attributes:
        z, square, up, level2, long2: as in `_Look`, least and most.
        seen: `_Look.seen`, least and most.
        chord2, turn2: as in `_Look`, most.
        size2: squared chord of the wrist centre and of the tool's length together, least but for those at rest.
    """

    z: tuple[Any, Any]
    square: tuple[Any, Any]
    up: tuple[Any, Any]
    level2: tuple[Any, Any]
    long2: tuple[Any, Any]
    seen: tuple[Any, Any]
    chord2: Any
    turn2: Any
    size2: Any


class _Whole:
    """The rules asked of all poses at once, by the worst value of each quantity: floats."""

    sqrt, lesser, greater = math.sqrt, min, max

    @staticmethod
    def worst(look: _Look) -> _Worst:
        """Least and largest of all."""
        poses, segments = look.poses[POSES_LOOKED_AT:], look.segments
        least, most = np.minimum.reduce(poses, axis=1).tolist(), np.maximum.reduce(poses, axis=1).tolist()
        chord2, turn2, _ = np.maximum.reduce(segments, axis=1).tolist()
        size2 = float(np.minimum.reduce(segments[2]))
        if not size2 > 0.0:  # some rest
            size2 = float(np.where(segments[2] == 0.0, np.inf, segments[2]).min())
        z, square, up, level2, long2, *_ = zip(least, most, strict=True)
        return _Worst(z, square, up, level2, long2, (least[5:], most[5:]), chord2, turn2, size2)

    @staticmethod
    def all(poses: Bools) -> bool:
        """Whether a rule holds at every pose."""
        return bool(poses.all())

    @staticmethod
    def most(poses: Floats) -> float:
        """The largest of all."""
        return float(poses.max())

    @staticmethod
    def around(slack: float) -> float:
        """The worst of a pose and its neighbours."""
        return slack

    @staticmethod
    def sides(look: _Look, worst: _Worst, bounds: tuple[float, float, float]) -> bool:
        """Whether each side is kept by one of the three ways at all poses, or else one or another at each."""
        (least, most), (outside, inside, line) = worst.seen, bounds
        if all(least[k] >= outside or most[k] <= inside or most[k + 2] <= line for k in (0, 1)):
            return True
        return bool(_Each.sides(look, worst, bounds).all())

    @staticmethod
    def motion(look: _Look) -> tuple[float, float, float]:
        """Neither the tip nor the axis times the tool's length is faster than the feed."""
        feed, g = look.problem.feed_mm_s, look.arm.geometry
        return 2.0 * g.stretch * feed, 2.0 * feed, feed / g.tool_mm


class _Each:
    """The rules asked of each pose: arrays of shape (m + 1,)."""

    sqrt, lesser, greater = np.sqrt, np.minimum, np.maximum

    @staticmethod
    def worst(look: _Look) -> _Worst:
        """What each pose has, and the worse of the two segments that meet there."""
        z, square, up, level2, long2 = look.poses[POSES_LOOKED_AT:SEEN]
        chord2, turn2, size2 = look.segments
        moved = -_beside(-np.where(size2 == 0.0, np.inf, size2))
        return _Worst(
            (z, z),
            (square, square),
            (up, up),
            (level2, level2),
            (long2, long2),
            (look.seen, look.seen),
            _beside(chord2),
            _beside(turn2),
            moved,
        )

    @staticmethod
    def all(poses: Bools) -> Bools:
        """Whether it holds at each."""
        return poses

    @staticmethod
    def most(poses: Floats) -> Floats:
        """What each has."""
        return poses

    @staticmethod
    def around(slack: Floats) -> Floats:
        """The worst of a pose and its neighbours."""
        return _beside(np.maximum(slack[:-1], slack[1:]))

    @staticmethod
    def sides(look: _Look, _worst: _Worst, bounds: tuple[Any, Any, Any]) -> Bools:
        """Whether each side is kept by one of the three ways."""
        about, across = look.seen[:2], look.seen[2:]
        outside, inside, line = bounds
        keeps = (about >= outside) | (about <= inside) | (across <= line)
        both: Bools = keeps[0] & keeps[1]
        return both

    @staticmethod
    def motion(look: _Look) -> tuple[Floats, Floats, Floats]:
        """A derivative leaves its mean over the segment by at most half of the second one."""
        g = look.arm.geometry
        chord2, turn2, _ = look.segments
        step = look.tips[1:] - look.tips[:-1]
        turn = np.sqrt(turn2)
        way = np.maximum(np.sqrt(np.einsum("ij,ij->i", step, step)), g.tool_mm * turn)
        hertz = np.where(way > 0.0, look.problem.feed_mm_s / way, 0.0)  # one over the least time
        bulge = 4.0 * g.tool_mm * SAG * turn2 + g.pad_mm
        turning = np.minimum(math.pi / 2 * turn * hertz, look.problem.feed_mm_s / g.tool_mm)
        planar = g.stretch * (np.sqrt(chord2) + bulge) * hertz
        upward = (np.abs(look.z[1:] - look.z[:-1]) + bulge) * hertz
        return _beside(planar), _beside(upward), _beside(turning)


Over = type[_Whole] | type[_Each]


def _beside(segments: Floats) -> Floats:
    """The worse of the two segments that meet at each pose: (m,) to (m + 1,)."""
    out: Floats = np.empty(len(segments) + 1)
    out[0], out[-1] = segments[0], segments[-1]
    np.maximum(segments[:-1], segments[1:], out=out[1:-1])
    return out


POSES_LOOKED_AT, SEEN = 4, 9
"""First rows of what is compared of `_Look.poses`: of all, and of `_Look.seen`."""

ONES: Final = np.ones(3)


@dataclass(frozen=True, slots=True)
class _Look:
    """One look at m consecutive segments.

    Attributes:
        arm, problem: whose.
        tips: shape (m + 1, 3).
        poses: rows of what each pose has, shape (13, m + 1), right elbow: horizontal part of the axis (2), wrist centre (3), x
            and y in slide coordinates, its squared distance from the column, vertical part of the axis, squared length of
            its horizontal part, and of the axis; `seen`.
        segments: squared chords of the wrist centre and of the axis, and of both together, shape (3, m).
    """

    arm: _Arm
    problem: Problem
    tips: Floats
    poses: Floats
    segments: Floats

    @property
    def z(self) -> Floats:
        """Height of the wrist centre."""
        out: Floats = self.poses[4]
        return out

    @property
    def seen(self) -> Floats:
        """Squared distances from the elbow at the limits of q0 less a0 squared, and how far left of those upper links."""
        out: Floats = self.poses[SEEN:]
        return out

    @classmethod
    def at(cls, arm: _Arm, problem: Problem, part: slice) -> _Look:
        """At these poses."""
        g = arm.geometry
        tips, axes = problem.tips_mm[part], problem.axes[part]
        wrist = g.tool_mm * axes
        wrist += tips
        poses, segments = np.empty((13, len(tips))), np.empty((3, len(tips) - 1))
        poses[:2], poses[2:5], poses[6] = axes.T[:2], wrist.T, axes.T[2]
        if g.side < 0.0:
            np.negative(poses[1:4:2], out=poses[1:4:2])
        if g.tilt[0] or g.tilt[1]:
            poses[2:4] -= g.tilt[:, None] * poses[4]
        squares = poses[:4] * poses[:4]
        np.add(squares[2], squares[3], out=poses[5])
        np.add(squares[0], squares[1], out=poses[7])
        np.multiply(poses[6], poses[6], out=poses[8])
        poses[8] += poses[7]
        np.matmul(arm.sides, poses[2:6], out=poses[SEEN:])
        for row, places in enumerate((wrist, axes)):
            step = places[1:] - places[:-1]
            step *= step
            np.matmul(step, ONES, out=segments[row])
        np.multiply(g.tool_mm * g.tool_mm, segments[1], out=segments[2])
        segments[2] += segments[0]
        return cls(arm, problem, tips, poses, segments)

    def keeps(self, over: Over, error: Displacement = EXACT) -> Any:
        """Whether everything is kept as far from a pose as the path is from its nearer one: of all poses, or each, (m + 1,)."""
        g, worst = self.arm.geometry, over.worst(self)
        sag_mm = g.stretch * g.tool_mm * SAG * worst.turn2
        moved_mm = self._moved(over, error)
        reach_mm = g.stretch / 2 * over.sqrt(worst.chord2) + sag_mm + moved_mm
        nearest = over.sqrt(worst.square[0]) - reach_mm
        farthest = over.sqrt(worst.square[1]) + reach_mm
        bend = self._elbow_sine(over, nearest - g.error_mm, farthest + g.error_mm)
        turn = over.sqrt(worst.turn2)
        # sin q4, 1-Lipschitz in the turn; where it is above 0 the axis turns by less than 80 deg in a segment
        level = over.sqrt(worst.level2[0]) - math.pi / 4 * turn
        sines = over.greater(bend, SINE_MIN), over.greater(level, SINE_MIN)
        return (
            (bend >= SINE_MIN)
            & (level >= SINE_MIN)
            & (worst.size2 >= SHORTEST2_MM2)
            & self._axis_keeps(worst)
            & (nearest >= self.arm.inner_mm)
            & (farthest <= self.arm.outer_mm)
            & (worst.z[0] - sag_mm - error.rise_mm >= self.arm.slide_mm[0])
            & (worst.z[1] + sag_mm + error.rise_mm <= self.arm.slide_mm[1])
            & over.sides(self, worst, self._side_bounds(over, reach_mm, farthest))
            & (math.pi / 4 * turn <= (math.pi - self.arm.roll_half) * level)  # `_roll_keeps`
            & self._roll_keeps(
                over, (reach_mm, moved_mm, error.yaw_rad), (over.greater(nearest, g.arm_mm), farthest), sines
            )
            & self._rates_keep(over.motion(self), farthest, sines)
        )

    def _moved(self, over: Over, error: Displacement) -> Any:
        """How far the bone's error moves a wrist centre in slide coordinates, at most, mm."""
        g = self.arm.geometry
        if error.yaw_rad == 0.0:
            return g.stretch * error.ball_mm
        x, y = self.poses[2] - error.pivot_mm[0], self.poses[3] - g.side * error.pivot_mm[1]
        away_mm = np.sqrt(x * x + y * y) + math.hypot(*g.tilt) * np.abs(self.z)
        return g.stretch * error.ball_mm + 2.0 * math.sin(error.yaw_rad / 2) * over.most(away_mm)

    def _elbow_sine(self, over: Over, nearest_mm: Any, farthest_mm: Any) -> Any:
        """Least sin q1 between two distances from the column; 0 where they reach too far or not far enough."""
        a0, a1 = self.arm.geometry.workspace.a0, self.arm.geometry.workspace.a1
        near, far = ((r * r - a0 * a0 - a1 * a1) / (2.0 * a0 * a1) for r in (nearest_mm, farthest_mm))
        rounded = ROUNDINGS * EPSILON * (a0 / a1 + a1 / a0 + 1.0)
        square = over.lesser(1.0 - near * near, 1.0 - far * far) - rounded
        return over.sqrt(over.greater(square, 0.0)) * (nearest_mm > 0.0)

    def _axis_keeps(self, worst: _Worst) -> Any:
        """Pitch and singularity, and unit length."""
        (low, high), lean = self.arm.upright, SAG * worst.turn2
        return (
            (worst.long2[0] >= 1.0 - UNIT)
            & (worst.long2[1] <= 1.0 + UNIT)
            & (worst.up[0] - lean >= low)
            & (worst.up[1] + lean <= high)
        )

    def _side_bounds(self, over: Over, reach_mm: Any, farthest: Any) -> tuple[Any, Any, Any]:
        """Of `seen`: the side arcs are of radius a1 about the elbow at either limit of q0, and on one side of a line."""
        g, space = self.arm.geometry, self.arm.geometry.workspace
        a0, a1 = space.a0, space.a1
        rounded = ROUNDINGS * EPSILON * (farthest + a0) * (farthest + a0) / a1  # of a square
        keep = reach_mm + (g.arm_mm + g.pad_mm) + rounded
        outside, inside = a1 + keep, over.greater(a1 - keep, 0.0)
        return outside * outside - a0 * a0, inside * inside - a0 * a0, self.arm.line_mm - keep

    def _roll_keeps(
        self, over: Over, way: tuple[Any, Any, float], radii: tuple[Any, Any], sines: tuple[Any, Any]
    ) -> Any:
        """The axis turned back by the forearm's heading points within the roll's limits.

        With c the wrist centre, D its squared distance from the column, A = (D + a1^2 - a0^2) / 2 and B = a0 a1 sin q1,
        the forearm is (A c + B c') / D, c' being c turned by a right angle.

        Between two poses whose roll is within the same revolution's limits it goes nowhere else. To those of another the
        azimuth would have to turn by what the limits leave out, 2 (pi - half), and the heading by less than what is kept
        for it here. A segment turns the azimuth by at most theta over the least sin q4.
        """
        g, space, half = self.arm.geometry, self.arm.geometry.workspace, self.arm.roll_half
        a0, a1, (nearest, farthest), (bend, level) = space.a0, space.a1, radii, sines
        ux, uy, x, y = self.poses[:4]
        square, level2 = self.poses[5], self.poses[7]
        part = square * 0.5
        part += (a1 * a1 - a0 * a0) / 2
        other = square * (a1 * a1)
        other -= part * part
        np.sqrt(other, out=other)
        along, across = ux * x + uy * y, uy * x - ux * y
        (cosine, sine), toward = self.arm.roll_middle, part * along + other * across
        if sine != 0.0:
            toward = toward * cosine + (part * across - other * along) * sine
        rounding = 8.0 + 1.0 / level + farthest / (a0 * bend)
        rounding += (farthest * farthest + a0 * a0 + a1 * a1) / (a1 * nearest)
        reach_mm, moved_mm, yaw_rad = way
        slack = yaw_rad + (3.0 * reach_mm - 2.0 * moved_mm + g.error_mm) / (a1 * bend)
        slack += self._azimuth_error(over, level)
        slack += 2.0 * g.pad_mm / (min(a0, a1) * bend) + ROUNDINGS * EPSILON * rounding
        slack = over.around(slack)  # the heading of one half counts beside the azimuth at the other's end
        # cos(half - slack), for its second derivative is at most 1; and what rounds a cosine, whatever the angle
        bound = math.cos(half) + slack * (math.sin(half) + slack / 2) + ROUNDINGS * EPSILON
        needed = np.sqrt(level2)
        needed *= square
        needed *= a1 * bound
        return over.all(toward >= needed)

    def _azimuth_error(self, over: Over, level: Any) -> Any:
        """What the axis' error turns its azimuth by besides itself: an arc is no longer than its tangent."""
        error = self.arm.geometry.error_rad
        ratio = math.sin(error) / level
        room = over.greater(1.0 - ratio * ratio, EPSILON)
        return ratio / over.sqrt(room) - error

    def _rates_keep(self, motion: tuple[Any, Any, Any], farthest: Any, sines: tuple[Any, Any]) -> Any:
        """Joint speeds and accelerations, as `motion.angles_of` derives them, in seconds.

        Of its two bounds on the elbow's those from the radius are never the larger ones, for r <= a0 + a1 and
        r^2 + a0 a1 sin^2 q1 <= (a0 + a1)^2.
        """
        g, space, (bend, level) = self.arm.geometry, self.arm.geometry.workspace, sines
        a0, a1, links = space.a0, space.a1, space.a0 * space.a1
        planar, upward, turning = motion
        q0, heading = planar / (a0 * bend), planar / (a1 * bend)
        q1 = farthest * planar / (links * bend)
        azimuth = turning / level
        keeps = _below(self.problem.speed, (q0, q1, upward, azimuth + heading, turning))
        if self.problem.acceleration is None:
            return keeps
        pull = g.stretch * g.tool_mm * turning * turning
        pulled = (pull + a0 * q0 * q0 + a1 * heading * heading) / bend
        second = (
            pulled / a0,
            (planar * planar + farthest * pull + links * q1 * q1) / (links * bend),
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
