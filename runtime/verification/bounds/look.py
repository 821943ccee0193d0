"""One look at each piece of a path: what every quantity keeps on it, by little more than the joints at its ends.

Of a piece everything is known from the two places that it joins and from how far the path leaves its chord, with every
sine at its least on that piece:

* Along a chord of length c the distance from any place is convex: it is at most the larger of those at the ends, and at
  least sqrt(d^2 - c^2 / 4) with d the smaller of them.
* Angles leave their own chords by at most an eighth of their second derivatives (`motion.angles_of`).

The angles are unwrapped from end to end, which is right where none of them can turn by half a revolution in a piece.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from cutgate.protocol.arrays import Floats, Ints
from cutgate.runtime.kinematics.arm import REVOLUTION
from cutgate.runtime.verification.bounds.acceleration import joint_accelerations
from cutgate.runtime.verification.bounds.chain import Intervals
from cutgate.runtime.verification.bounds.enclosures import (
    ACCELERATION,
    COLUMNS,
    HALF_TURN,
    INNER,
    LEFT,
    OUTER,
    Q0_MAX,
    Q0_MIN,
    ROLL_MIN,
    SPEED,
    Scope,
)
from cutgate.runtime.verification.bounds.geometry import EPSILON, ROUNDINGS, Geometry, Segments
from cutgate.runtime.verification.bounds.minima import Aim, Minima
from cutgate.runtime.verification.bounds.pieces import Pieces
from cutgate.runtime.verification.bounds.points import Points, at, roll_widening
from cutgate.runtime.workspace.planar import Arc

SINE_MIN: Final = 1e-3
"""Nearer to a straight or folded elbow, or to the vertical, a look tells nothing."""

TURN_MAX: Final = math.pi / 2.0
"""Nor where an angle of the arm or the tool may turn further in a piece."""

Rows = list[Floats]

np.empty(4 << 20, dtype=np.uint8)
"""Freed at once. The allocator then keeps blocks of this size instead of handing them back to the system, from which
every page comes anew, and slowly; a look takes and frees some hundred kilobytes."""


class TouchesError(Exception):
    """A path may touch a boundary of the workspace, so that a first look does not tell inside from outside."""


class _Way(NamedTuple):
    """How far wrist centre and axis go on each piece, at most, as arrays of shape (runs, k)."""

    nearest: Floats  # distance from the column, at least
    farthest: Floats  # and at most
    bulge: Floats  # |c''|
    turn: Floats  # |c'| over sin q1
    over: Floats  # 1 over sin q1
    tilted: Floats  # sin q4, at least
    spanned: Floats  # what the horizontal parts of the axes at its ends span


class Look:
    """One look at pieces: lists of one array for each quantity.

    Attributes:
        pieces: looked at.
        joints: q0, q1, height of the wrist centre, q3 and q4 at their ends, rad and mm; angles followed.
        ends: what arcs, roll and q0 keep there, the arcs at least; by column.
        bounds: what each column keeps on each piece, at least.
        means: what each joint's speed is at least somewhere on each piece.
    """

    def __init__(self, geometry: Geometry, segments: Segments, pieces: Pieces) -> None:
        self.geometry = geometry
        self.segments = segments
        self.pieces = pieces
        self.centre: Rows = []
        self.joints: Rows = []
        self.ends: Rows = []
        self.bounds: Rows = []
        self.means: Rows = []
        self.shown: Rows = []
        self._way: _Way
        self.hertz = 1.0 / np.where(pieces.seconds > 0.0, pieces.seconds, np.inf)

    def follows(self) -> bool:
        """Evaluate the joints; False where it is not known how they turn, or how fast: a turn in no time."""
        g, space, theta = self.geometry, self.geometry.workspace, self.pieces.theta
        if theta[self.pieces.seconds == 0.0].any():
            return False
        x, y, z, ux, uy, uz = self._wrist()
        square = x * x + y * y
        level = np.sqrt(ux * ux + uy * uy)
        dx, dy = x[:, 1:] - x[:, :-1], y[:, 1:] - y[:, :-1]
        chord2 = dx * dx + dy * dy
        bulge = (g.stretch * g.tool_mm) * (theta * theta)  # |c''| at most
        sag, quarter = bulge * 0.125 + g.pad_mm, chord2 * 0.25
        nearest = np.sqrt(np.maximum(_least(square) - quarter, 0.0)) - sag
        farthest = np.sqrt(_most(square)) + sag
        sine = elbow_sine_least(g, nearest, farthest)
        tilted = _least(level) - theta * 0.5  # sin q4 is 1-Lipschitz in the turn
        if not (sine.min() >= SINE_MIN and tilted.min() >= SINE_MIN and nearest.min() > g.pad_mm):
            return False
        turn = (np.sqrt(chord2) + bulge * 0.5 + g.pad_mm) / sine
        if not (turn.max() <= TURN_MAX * min(space.a0, space.a1) and (theta / tilted).max() <= TURN_MAX):
            return False
        self.centre = [x, y, square, quarter, sag]
        self.joints = self._followed((ux, uy, uz, level), z)
        # sin(theta) times the height of the great circle's normal is what the horizontal parts of the axes span
        spanned = np.abs(ux[:, :-1] * uy[:, 1:] - uy[:, :-1] * ux[:, 1:]) + 16.0 * EPSILON
        self._way = _Way(nearest, farthest, bulge, turn, 1.0 / sine, tilted, spanned)
        return True

    def bound(self, *, accelerations: bool) -> None:
        """Bound every column, with second derivatives as in `motion`."""
        g, a0, a1 = self.geometry, self.geometry.workspace.a0, self.geometry.workspace.a1
        way, theta = self._way, self.pieces.theta
        self._circles(way.nearest, way.farthest)
        square, upright = theta * theta, 1.0 / (way.tilted * way.tilted * way.tilted)
        twist = way.spanned / (1.0 - square * (1.0 / 6.0))
        azimuth2, pitch2 = 2.0 * theta * twist * upright, twist * twist * upright
        bent = (way.bulge + way.turn * way.turn * (1.0 / a0 + 1.0 / a1)) * way.over
        roll2 = azimuth2 + bent * (1.0 / a1)
        pad = way.over * (2.0 * g.pad_mm / min(a0, a1)) + (ROUNDINGS * EPSILON) * (32.0 + 1.0 / way.tilted)
        roll_off = roll2 * 0.125 + pad
        if g.error_mm > 0.0 or g.error_rad > 0.0:
            roll_off += _widening(g, way.nearest, way.farthest, way.tilted)
        for q, off in ((self.joints[3], roll_off), (self.joints[0], bent * (0.125 / a0) + pad)):
            self.ends += [q, -q]
            self.bounds += [_least(q) - off, -_most(q) - off]
        seconds = (bent * (1.0 / a0), bent * (1.0 / a0 + 1.0 / a1), g.tool_mm * square, roll2, pitch2)
        self._speeds(seconds, pad)
        if accelerations:
            self._accelerations(bent, (azimuth2, pitch2), pad)

    def _wrist(self) -> tuple[Floats, ...]:
        """Wrist centre, x and y in slide coordinates, and axis."""
        (x, y, z), (ux, uy, uz), tool = self.pieces.tip, self.pieces.axis, self.geometry.tool_mm
        x, y, z = x + tool * ux, y + tool * uy, z + tool * uz
        lean_x, lean_y = self.geometry.tilt.tolist()
        if lean_x or lean_y:
            x, y = x - lean_x * z, y - lean_y * z
        return x, y, z, ux, uy, uz

    def _followed(self, axis: tuple[Floats, Floats, Floats, Floats], z: Floats) -> Rows:
        """The joints, by algebra and an arctangent each.

        With c the wrist centre, D its squared distance from the column, A = (D + a1^2 - a0^2) / 2 and B = a0 a1 sin q1,
        the forearm is (A c + B c') / D, c' being c turned by a right angle; the upper link is what is left of c.
        """
        (x, y, square), (ux, uy, uz, level) = self.centre[:3], axis
        a0, a1 = self.geometry.workspace.a0, self.geometry.workspace.a1
        along = square * 0.5 + (a1 * a1 - a0 * a0) / 2.0
        across = np.sqrt(square * (a1 * a1) - along * along)
        fx, fy = along * x - across * y, along * y + across * x
        start, roll = self.pieces.follow
        return [
            _unwrapped(np.arctan2(square * y - fy, square * x - fx), start),
            np.arctan2(2.0 * across, square - (a0 * a0 + a1 * a1)),
            z,
            _unwrapped(np.arctan2(uy * fx - ux * fy, ux * fx + uy * fy), roll),
            np.arctan2(level, uz),
        ]

    def _circles(self, nearest: Floats, farthest: Floats) -> None:
        """Distances from the four arcs, at least: those from their circles.

        The side arcs lie besides beyond a line through the column, that of the upper link at the limit of q0.
        """
        x, y, square, quarter, sag = self.centre
        space = self.geometry.workspace
        inner, outer = self.geometry.arcs[INNER].radius, self.geometry.arcs[OUTER].radius
        radius = np.sqrt(square)
        self.ends = [radius - inner, outer - radius]
        self.bounds = [nearest - inner, outer - farthest]
        line = space.a1 * min(math.sin(space.q1_lo), math.sin(space.q1_hi))
        for q0 in (space.q0_hi, space.q0_lo):
            c, s = math.cos(q0), math.sin(q0)
            dx, dy = x - space.a0 * c, y - space.a0 * s
            about = dx * dx + dy * dy
            beside = line + s * x - c * y
            away = np.sqrt(about) - space.a1
            self.ends.append(np.maximum(np.abs(away), beside))
            near = np.sqrt(np.maximum(_least(about) - quarter, 0.0)) - space.a1
            self.bounds.append(np.maximum(np.maximum(near, -_most(away)), _least(beside)) - sag)

    def _speeds(self, seconds: tuple[Floats, ...], pad: Floats) -> None:
        """|q'| leaves its mean by at most half of |q''|, and is no less than that somewhere."""
        for joint, (q, second) in enumerate(zip(self.joints, seconds, strict=True)):
            change = np.abs(q[:, 1:] - q[:, :-1])
            rounded = pad if joint != 2 else self.geometry.pad_mm
            self.means.append(np.maximum(change - rounded, 0.0) * self.hertz)
            self.bounds.append((change + second * 0.5 + rounded) * -self.hertz)

    def _accelerations(self, bent: Floats, tool: tuple[Floats, Floats], pad: Floats) -> None:
        """By their terms, as in `acceleration`."""
        way, (azimuth2, pitch2) = self._way, tool
        a0, a1 = self.geometry.workspace.a0, self.geometry.workspace.a1
        q0, q1 = (np.abs(q[:, 1:] - q[:, :-1]) for q in self.joints[:2])
        first = q0 + (bent * (0.5 / a0) + pad)
        turned = np.minimum(q0 + q1 + (bent * (0.5 / a1) + 2.0 * pad), way.turn * (1.0 / a1))
        pulled = (way.bulge + a0 * first * first + a1 * turned * turned) * way.over
        minus = self.hertz * -self.hertz * (1.0 + 64.0 * ROUNDINGS * EPSILON)
        self.bounds += [pulled * minus * (1.0 / a0), pulled * minus * (1.0 / a0 + 1.0 / a1)]
        self.bounds += [way.bulge * minus, (azimuth2 + pulled * (1.0 / a1)) * minus, pitch2 * minus]

    # -- what a survey asks -------------------------------------------------------------------

    def offer(self, columns: list[int], scope: Scope, aim: Aim, best: Minima) -> Floats:
        """Give what is attained, and say what every piece keeps, shape (COLUMNS,)."""
        out = np.full(COLUMNS, np.inf)
        self.shown = list(self.bounds)
        for column in columns:
            if column < ROLL_MIN:
                self._offer_arc(column, scope.shoulder_shift, aim, best)
            elif column < SPEED:
                self._offer_angle(column, best)
            elif column < ACCELERATION:
                means = self.means[column - SPEED]
                piece = int(means.argmax())
                best.one(column, -float(means.flat[piece]), *self._middle(piece))
            out[column] = self.shown[column].min()
        if columns[-1] >= ACCELERATION:
            self._offer_accelerations(out, aim, best)
        return out

    def _offer_accelerations(self, kept: Floats, aim: Aim, best: Minima) -> None:
        """No acceleration is below zero: where the bounds are close to that nothing else needs to be known."""
        columns = slice(ACCELERATION, COLUMNS)
        places = [self._middle(int(bounds.argmin())) for bounds in self.bounds[columns]]
        rates = np.zeros((5, 5))
        if not (kept[columns] >= -aim.gap[columns]).all():
            segment, s = (np.array(part) for part in zip(*places, strict=True))
            rates = -np.abs(joint_accelerations(self.geometry, self.segments, segment, s))
        for joint, place in enumerate(places):
            best.one(ACCELERATION + joint, float(rates[joint, joint]), *place)

    def _offer_arc(self, column: int, shift: float | None, aim: Aim, best: Minima) -> None:
        """The least distance at an end of a piece. Where the nearest place of the circle is not on the arc, and that counts, the arc."""
        ends, self.shown[column], i, distance = self._arc(column, shift)
        least = float(self.shown[column].min())
        clipped = distance > float(ends.flat[i])
        if least <= 0.0 or (clipped and least < min(distance, best.value[column]) - aim.gap[column]):
            self._clip(column)
            ends, self.shown[column], i, distance = self._arc(column, shift)
        if ends.flat[i] < np.inf:
            self._offer_end(column, i, distance, best)

    def _arc(self, column: int, shift: float | None) -> tuple[Floats, Floats, int, float]:
        """What an arc's column is at the ends and on the pieces, and where it is least, with the distance there.

        A side of a shoulder of a turn and more counts by the unwrapped q0; here, where that is within its limits.
        """
        ends, bounds = self.ends[column], self.bounds[column]
        if shift is not None and column >= LEFT:
            g, q0 = self.geometry, self.joints[0]
            if column == LEFT:
                excess, most = q0 + (shift - g.upper[0]), (shift - g.upper[0]) - self.bounds[Q0_MAX]
            else:
                excess, most = (g.lower[0] - shift) - q0, (g.lower[0] - shift) - self.bounds[Q0_MIN]
            if not most.max() <= 0.0:
                raise TouchesError
            ends = np.where(excess < -HALF_TURN, np.inf, ends)
            bounds = np.where(most < -HALF_TURN, np.inf, bounds)
        i = int(ends.argmin())
        x, y = self.centre[:2]
        return ends, bounds, i, self.geometry.arcs[column].distance(float(x.flat[i]), float(y.flat[i]))

    def _clip(self, column: int) -> None:
        ends, bounds = _clipped(self.geometry.arcs[column], self.centre)
        self.ends[column] = np.maximum(self.ends[column], ends)
        self.bounds[column] = np.maximum(self.bounds[column], bounds)

    def _offer_angle(self, column: int, best: Minima) -> None:
        g, values = self.geometry, self.ends[column]
        if column < Q0_MIN and (g.error_mm > 0.0 or g.error_rad > 0.0):
            wide = roll_widening(g, np.sqrt(self.centre[2]), np.sin(self.joints[4]))
            values = values - wide[..., column - ROLL_MIN]
        i = int(values.argmin())
        self._offer_end(column, i, float(values.flat[i]), best)

    def _offer_end(self, column: int, end: int, value: float, best: Minima) -> None:
        run, piece = divmod(end, self.centre[0].shape[1])
        number, s = self._place(run, float(piece))
        last = len(self.segments) - 1
        best.one(column, value, min(number, last), 1.0 if number > last else s)

    def _middle(self, piece: int) -> tuple[int, float]:
        run, number = divmod(piece, self.hertz.shape[1])
        return self._place(run, number + 0.5)

    def _place(self, run: int, pieces: float) -> tuple[int, float]:
        """Segment and fraction so many pieces from the beginning of a run."""
        along = float(self.pieces.s0[run]) + float(self.pieces.width[run]) * pieces
        whole = math.floor(along)
        return int(self.pieces.segment[run]) + whole, along - whole

    def inherit(self, whole: Look, pieces: Ints) -> None:
        """What some pieces keep their parts keep as well; rounding may say less of a part."""
        for column, bounds in enumerate(self.bounds):
            np.maximum(bounds, whole.bounds[column].flat[pieces][:, None], out=bounds)

    def short(self, columns: list[int], needed: Floats) -> Ints:
        """Pieces that keep too little of some columns."""
        open_ = np.zeros(self.hertz.shape, dtype=np.bool_)
        for column in columns:
            open_ |= ~(self.shown[column] >= needed[column])
        return np.flatnonzero(open_)

    def rest(self, column: int, pieces: Ints) -> float:
        """What all other pieces keep."""
        bounds = self.shown[column].copy()
        bounds.flat[pieces] = np.inf
        return float(bounds.min())

    def intervals(self, pieces: Ints) -> Intervals:
        """Some of the pieces, to be bounded closely."""
        a_run = self.hertz.shape[1]
        segment, s0 = self.pieces.places(pieces, a_run)
        run, piece = np.divmod(pieces, a_run)
        inherited = np.full((len(pieces), COLUMNS), -np.inf)
        for column, bounds in enumerate(self.bounds):
            inherited[:, column] = bounds.flat[pieces]
        s1 = np.minimum(s0 + self.pieces.width[run], 1.0)
        return Intervals(
            segment,
            s0,
            s1,
            self._points(segment, s0, run, piece),
            self._points(segment, s1, run, piece + 1),
            inherited,
        )

    def _points(self, segment: Ints, s: Floats, run: Ints, end: Ints) -> Points:
        """Ends evaluated closely, their angles those that were followed."""
        found = at(self.geometry, self.segments, segment, s)
        turned = np.rint((self.joints[0][run, end] - found.shoulder) / REVOLUTION)
        found = replace(found, bearing=found.bearing + REVOLUTION * turned)
        turned = np.rint((self.joints[3][run, end] - found.roll) / REVOLUTION)
        return replace(found, azimuth=found.azimuth + REVOLUTION * turned)


def _least(ends: Floats) -> Floats:
    return np.minimum(ends[:, 1:], ends[:, :-1])


def _most(ends: Floats) -> Floats:
    return np.maximum(ends[:, 1:], ends[:, :-1])


def _unwrapped(raw: Floats, start: Floats) -> Floats:
    """An angle followed along each run; its first is the one nearest to ``start``."""
    raw += REVOLUTION * np.rint((start - raw[:, :1]) / REVOLUTION)
    step = raw[:, 1:] - raw[:, :-1]
    if not (step.min() >= -math.pi and step.max() <= math.pi):
        raw[:, 1:] -= REVOLUTION * np.cumsum(np.rint(step / REVOLUTION), axis=1)
    return raw


def elbow_sine_least(geometry: Geometry, nearest: Floats, farthest: Floats) -> Floats:
    """Minima sin q1 between two distances from the column: (a0 a1 sin q1)^2 is concave in r^2. 0 out of reach."""
    a0, a1 = geometry.workspace.a0, geometry.workspace.a1
    double, squares = 2.0 * a0 * a1, a0 * a0 + a1 * a1
    near, far = (nearest * nearest - squares) / double, (farthest * farthest - squares) / double
    square = 1.0 - ROUNDINGS * EPSILON * (a0 / a1 + a1 / a0 + 1.0) - np.maximum(near * near, far * far)
    return np.sqrt(np.maximum(square, 0.0))


def _clipped(arc: Arc, centre: Rows) -> tuple[Floats, Floats]:
    """Distances from the ends of an arc where the nearest place can only be one of them, else minus infinity.

    A place is not beside the arc if one of three products is negative (`planar.distance_to_arc`); along a chord they
    are linear.
    """
    x, y, _, quarter, sag = centre
    dx, dy = x - arc.x, y - arc.y
    first, last, middle = arc.start, arc.start + arc.span, arc.start + arc.span / 2
    after = math.cos(first) * dy - math.sin(first) * dx
    before = math.sin(last) * dx - math.cos(last) * dy
    if arc.span >= REVOLUTION:
        return np.full_like(x, -np.inf), np.full_like(sag, -np.inf)
    if arc.span > math.pi:
        outside = np.maximum(after, before)
        passes = _most(outside)
    else:
        toward = math.cos(middle) * dx + math.sin(middle) * dy
        outside = np.minimum(np.minimum(after, before), toward)
        passes = np.minimum(np.minimum(_most(after), _most(before)), _most(toward))
    (x1, y1), (x2, y2) = arc.ends
    square = np.minimum((x - x1) ** 2 + (y - y1) ** 2, (x - x2) ** 2 + (y - y2) ** 2)
    nearer = np.sqrt(np.maximum(_least(square) - quarter, 0.0)) - sag
    return np.where(outside < 0.0, np.sqrt(square), -np.inf), np.where(passes + sag < 0.0, nearer, -np.inf)


def _widening(geometry: Geometry, nearest: Floats, farthest: Floats, tilted: Floats) -> Floats:
    """What the errors turn the roll by, at most, beyond the error of the axis (`points.roll_widening`); infinite likewise."""
    g = geometry
    ratio = math.sin(g.error_rad) / tilted
    azimuth = ratio / np.sqrt(np.maximum(1.0 - ratio * ratio, 0.0)) - g.error_rad
    sine = elbow_sine_least(g, np.maximum(nearest - g.error_mm, 0.0), farthest + g.error_mm)
    out: Floats = azimuth + g.error_mm / (g.workspace.a1 * sine)
    return out
