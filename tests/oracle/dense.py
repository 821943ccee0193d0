"""Dense reference: own inverse kinematics and own distances, by brute force, for both elbows.

Takes any object with the attributes of a verification problem and imports nothing of the packages
under test. Boundaries are sampled through forward kinematics of the joint rectangle's sides, so the
clipped-arc formulas are not used here either. Every value is attained at a pose of the path; nothing
is proved between the poses, but they are set closer where a joint turns fast and around each minimum.
"""

import math
from dataclasses import dataclass

import numpy as np

SIDES = ("inner", "outer", "left", "right")
COLUMNS = (
    *SIDES,
    "top",
    "bottom",
    "pitch_min",
    "pitch_max",
    "wrist_singularity",
    "roll_min",
    "roll_max",
    "q0_min",
    "q0_max",
    *(f"speed{joint}" for joint in range(5)),
)
"""What is followed along the path, small is bad: mm and deg; joint speeds are negative. The roll's two are
the least and minus the largest continuous roll to which the errors bring it, less the error of the axis itself."""

ROLL_COLUMNS = tuple(COLUMNS.index(name) for name in ("roll_min", "roll_max"))

CORNERS = 33
NEWTON_STEPS = 3
LARGEST_JUMP = 0.3
SMALLEST_WIDTH = 1e-13
SPEED_STEP = 1e-4
"""Joint speeds are means over this part of a segment, hence attained somewhere in it."""

ROUNDING = 2e-12
"""Of the change of a joint over that step, mm and rad; taken off, so that tiny segments do not seem fast."""

WINDOWS, ZOOM_POINTS, ZOOM_ROUNDS = 4, 9, 7
DIRECTIONS, DIRECTION_POINTS, DIRECTION_ROUNDS = 16, 7, 5
"""In which directions wrist centre and axis are moved by their errors: all around, then closer around the best."""


@dataclass
class Samples:
    """Evaluated poses; arrays over m samples, true joints q (m, 5), unsigned distances to the sides (m, 4).

    ``strays`` (m, 2): how far the errors can bring the roll down, and up, less the error of the axis itself.
    """

    segment: np.ndarray
    s: np.ndarray
    q: np.ndarray
    sides: np.ndarray
    inside: np.ndarray
    strays: np.ndarray


class Dense:
    """All margins of a path at many sampled poses."""

    def __init__(self, problem, per_segment=200):
        c, d, arm = problem.calibration, problem.deadband, problem.arm
        self.problem = problem
        self.sign = 1.0 if arm.elbow == "right" else -1.0
        self.a0 = arm.upper_mm + c.upper_link_error_mm
        self.a1 = arm.forearm_mm + c.forearm_link_error_mm
        self.lo = np.array(problem.lower) + c.joint_offset
        self.hi = np.array(problem.upper) + c.joint_offset
        bent = (0.0, math.pi) if self.sign > 0 else (-math.pi, 0.0)
        self.q1 = (max(self.lo[1], bent[0]), min(self.hi[1], bent[1]))
        self.full = self.hi[0] - self.lo[0] >= 2 * math.pi
        # A ball about the wrist centre lies, sheared by the slide's lean, in a disc that much larger.
        self.error_mm = (c.residual_mm + d.path_tolerance_mm) * math.hypot(1.0, *c.slide_tilt)
        self.error_rad = c.residual_rad + d.path_tolerance_rad
        self.turn, self.normal, self.seconds = self._segments()
        n = len(problem.tips_mm) - 1
        self.samples = self.at(
            np.repeat(np.arange(n), per_segment), np.tile(np.linspace(0, 1, per_segment), n)
        )
        self._close_in_on_jumps()
        self.q0, self.q3 = np.unwrap(self.samples.q[:, 0]), np.unwrap(self.samples.q[:, 3])
        self.place = self.samples.segment + self.samples.s
        self.inside = self.samples.inside
        self.values = self.columns(self.samples, self.q0, self.q3)
        self.stays_inside = bool(self.inside.all()) and (self.full or self._keeps_its_turn())

    # -- the path ------------------------------------------------------------------------------

    def _segments(self):
        """Turn, common normal and planned duration of each segment."""
        p, u = self.problem.tips_mm, self.problem.axes
        normal = np.cross(u[:-1], u[1:])
        length = np.linalg.norm(normal, axis=1)
        turn = np.arctan2(length, (u[:-1] * u[1:]).sum(axis=1))
        step = np.linalg.norm(np.diff(p, axis=0), axis=1)
        seconds = np.maximum(step, self.problem.tool_length_mm * turn) / self.problem.feed_mm_s
        return turn, normal / np.where(length > 0, length, 1.0)[:, None], seconds

    def poses(self, segment, s):
        """Tip and axis: the axis by Rodrigues' rotation about the common normal."""
        p, u = self.problem.tips_mm, self.problem.axes
        tip = p[segment] * (1 - s)[:, None] + p[segment + 1] * s[:, None]
        first, angle = u[segment], s * self.turn[segment]
        beside = np.cross(self.normal[segment], first)
        axis = first * np.cos(angle)[:, None] + beside * np.sin(angle)[:, None]
        return tip, axis / np.linalg.norm(axis, axis=1)[:, None]

    def joints(self, tip, axis):
        """True joints by the law of cosines; NaN out of reach; also the planar wrist centre."""
        w = tip + self.problem.tool_length_mm * axis
        xy = w[:, :2] - w[:, 2:] * np.asarray(self.problem.calibration.slide_tilt)
        q0, q1 = self.arm(xy)
        q3 = np.arctan2(axis[:, 1], axis[:, 0]) - q0 - q1
        q4 = np.arctan2(np.hypot(axis[:, 0], axis[:, 1]), axis[:, 2])
        return xy, np.stack((q0, q1, w[:, 2], q3, q4), axis=1)

    def arm(self, xy):
        """Shoulder and elbow that bring the wrist centre there, (..., 2); NaN out of reach."""
        square = (xy**2).sum(axis=-1)
        with np.errstate(invalid="ignore"):
            q1 = self.sign * np.arccos((square - self.a0**2 - self.a1**2) / (2 * self.a0 * self.a1))
        elbow = np.arctan2(self.a1 * np.sin(q1), self.a0 + self.a1 * np.cos(q1))
        return np.arctan2(xy[..., 1], xy[..., 0]) - elbow, q1

    def at(self, segment, s, strays=None):
        """Evaluate fractions (m,) of segments (m,); ``strays``: the rows of which the strays are wanted, else all."""
        xy, q = self.joints(*self.poses(segment, s))
        sides = np.stack([self.side_distance(xy, name) for name in SIDES], axis=1)
        bent = (q[:, 1] >= self.q1[0]) & (q[:, 1] <= self.q1[1])
        turned = np.mod(q[:, 0] - self.lo[0], 2 * math.pi) <= self.hi[0] - self.lo[0]
        return Samples(segment, s, q, sides, bent & turned, self.strays(xy, q, strays))

    def _close_in_on_jumps(self):
        """Halve the steps over which a joint turns by more than LARGEST_JUMP, so that turns can be counted."""
        for _ in range(45):
            x = self.samples
            jump = np.remainder(np.diff(x.q[:, [0, 1, 3]], axis=0) + math.pi, 2 * math.pi) - math.pi
            width = np.where(x.segment[1:] == x.segment[:-1], np.diff(x.s), 0.0)
            far = np.flatnonzero((np.abs(jump) > LARGEST_JUMP).any(axis=1) & (width > SMALLEST_WIDTH))
            if len(far) == 0:
                return
            more = self.at(x.segment[far], (x.s[far] + x.s[far + 1]) / 2)
            both = (
                np.insert(a, far + 1, b, axis=0)
                for a, b in zip(vars(x).values(), vars(more).values(), strict=True)
            )
            self.samples = Samples(*both)

    def _keeps_its_turn(self):
        start = self.q0[0] + 2 * math.pi * math.ceil((self.lo[0] - self.q0[0]) / (2 * math.pi) - 1e-12)
        q0 = self.q0 + (start - self.q0[0])
        return bool(q0.min() >= self.lo[0] - 1e-9 and q0.max() <= self.hi[0] + 1e-9)

    # -- the boundaries ------------------------------------------------------------------------

    def side_distance(self, xy, name):
        """Distance to one side of the joint rectangle: sampled, then Newton's steps from the best sample.

        The plane is complex here: the joint that moves turns its lever by t, about zero or the elbow's place.
        """
        inner, outer = (self.q1[1], self.q1[0]) if self.sign > 0 else (self.q1[0], self.q1[1])
        if name in {"inner", "outer"}:
            low, high = self.lo[0], self.lo[0] + min(self.hi[0] - self.lo[0], 2 * math.pi)
            pivot, lever = 0.0, self.a0 + self.a1 * np.exp(1j * (inner if name == "inner" else outer))
        else:
            low, high = self.q1
            upper = np.exp(1j * (self.hi[0] if name == "left" else self.lo[0]))
            pivot, lever = self.a0 * upper, self.a1 * upper
        goal = xy[:, 0] + 1j * xy[:, 1] - pivot
        sampled = np.linspace(low, high, CORNERS)
        reach = lever * np.exp(1j * sampled)  # all as far from the pivot, so the nearest is most aligned
        t = sampled[(goal.real[:, None] * reach.real + goal.imag[:, None] * reach.imag).argmax(axis=1)]
        best = np.abs(lever * np.exp(1j * t) - goal)
        for _ in range(NEWTON_STEPS):
            across = goal.conj() * (lever * np.exp(1j * t))
            with np.errstate(divide="ignore", invalid="ignore"):
                t = t - np.where(across.real > 0.0, across.imag / across.real, 0.0)
            t = np.minimum(
                low + np.mod(t - low, 2 * math.pi), high
            )  # beyond an end, the end is the best sample
        return np.minimum(best, np.abs(lever * np.exp(1j * t) - goal))

    def strays(self, xy, q, rows=None):
        """How far the errors bring the roll down and up, less the error of the axis itself, rad, (m, 2).

        The wrist centre is moved over the disc of its error and the axis over its cone; infinite where one of them
        may become singular, NaN where not wanted.
        """
        out = np.zeros((len(q), 2))
        if rows is not None:
            out[~rows] = np.nan
        rows = np.arange(len(q)) if rows is None else np.flatnonzero(rows)
        if self.error_mm > 0:
            out[rows] += self._heading_strays(xy[rows])
        if self.error_rad > 0:
            out[rows] += self._azimuth_stray(q[rows, 4])[:, None] - self.error_rad
        return out

    def _heading_strays(self, xy):
        """How far up, and down, q0 + q1 goes while the wrist centre moves about: the roll goes the other way."""
        heading = sum(self.arm(xy))[:, None]
        bearing = np.arctan2(xy[:, 1], xy[:, 0])[:, None]

        def change(direction):
            offset = self.error_mm * np.stack(
                (np.cos(bearing + direction), np.sin(bearing + direction)), axis=-1
            )
            return (
                np.remainder(sum(self.arm(xy[:, None, :] + offset)) - heading + math.pi, 2 * math.pi)
                - math.pi
            )

        return np.stack((highest(change, len(xy)), highest(lambda d: -change(d), len(xy))), axis=1)

    def _azimuth_stray(self, pitch):
        """How far the azimuth goes while the axis moves about its cone: as far either way."""
        sine, cosine = np.sin(pitch)[:, None], np.cos(pitch)[:, None]
        c, s = math.cos(self.error_rad), math.sin(self.error_rad)

        def change(direction):
            return np.arctan2(s * np.sin(direction), c * sine + s * cosine * np.cos(direction))

        polar = np.minimum(pitch, math.pi - pitch) <= self.error_rad
        return np.where(polar, math.inf, highest(change, len(pitch)))

    def signed(self, x):
        """Signed distances to the sides, (m, 4): outside the nearest of them counts as negative."""
        out = x.sides.copy()
        rows = np.flatnonzero(~x.inside)
        nearest = out[rows, : 2 if self.full else 4].argmin(axis=1)
        out[rows, nearest] *= -1
        return out

    def columns(self, x, q0, q3):
        """Everything in COLUMNS at samples with their continuous shoulder and roll, (m, k)."""
        z, q4 = x.q[:, 2], x.q[:, 4]
        slide = np.stack((self.hi[2] - z, z - self.lo[2]), axis=1)
        pitch = np.stack((q4 - self.lo[4], self.hi[4] - q4, np.minimum(q4, math.pi - q4)), axis=1)
        turns = np.stack((q3 - x.strays[:, 0], -q3 - x.strays[:, 1], q0, -q0), axis=1)
        return np.hstack((self.signed(x), slide, np.degrees(pitch), np.degrees(turns), -self.speeds(x)))

    def speeds(self, x):
        """Joint speeds at the planned feed, rad/s and mm/s, (m, 5)."""
        ahead = np.where(x.s < 0.5, SPEED_STEP, -SPEED_STEP)
        _, q = self.joints(*self.poses(x.segment, x.s + ahead))
        change = q - x.q
        change[:, [0, 3]] = np.remainder(change[:, [0, 3]] + math.pi, 2 * math.pi) - math.pi
        change = np.maximum(np.abs(change) - ROUNDING, 0.0)
        seconds = self.seconds[x.segment] * SPEED_STEP
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(change > 0.0, change / seconds[:, None], 0.0)

    # -- the whole path ------------------------------------------------------------------------

    def unwrap(self, x):
        """Continuous shoulder and roll of samples from the nearest known ones."""
        near = np.clip(np.searchsorted(self.place, x.segment + x.s), 0, len(self.place) - 1)
        unwrapped = []
        for joint, known in ((0, self.q0), (3, self.q3)):
            raw = x.q[:, joint]
            unwrapped.append(raw + 2 * math.pi * np.round((known[near] - raw) / (2 * math.pi)))
        return unwrapped

    def minima(self, columns=None):
        """Least value of each column on the path, (k,): the lowest samples, then closer around them."""
        columns = columns or self.columns
        base = self.values if columns == self.columns else columns(self.samples, self.q0, self.q3)
        base = np.where(np.isnan(base), np.inf, base)
        best = base.min(axis=0)
        edge = np.full((1, base.shape[1]), np.inf)
        low = (base <= np.vstack((edge, base[:-1]))) & (base <= np.vstack((base[1:], edge)))
        order = np.argsort(np.where(low & np.isfinite(base), base, np.inf), axis=0)[:WINDOWS]
        row, column = order.T.ravel(), np.repeat(np.arange(base.shape[1]), len(order))
        segment, s = self.samples.segment, self.samples.s
        before, after = np.maximum(row - 1, 0), np.minimum(row + 1, len(s) - 1)
        first = np.where(segment[before] == segment[row], s[before], s[row])
        last = np.where(segment[after] == segment[row], s[after], s[row])
        segment = segment[row]
        part, window = np.linspace(0, 1, ZOOM_POINTS), np.arange(len(row))
        strays = np.repeat(np.isin(column, ROLL_COLUMNS) | (columns != self.columns), ZOOM_POINTS)
        for _ in range(ZOOM_ROUNDS):
            inner = first[:, None] + (last - first)[:, None] * part
            x = self.at(np.repeat(segment, ZOOM_POINTS), inner.ravel(), strays)
            found = columns(x, *self.unwrap(x))
            found = np.where(np.isnan(found), np.inf, found)
            best = np.minimum(best, found.min(axis=0))
            own = found.reshape(len(row), ZOOM_POINTS, -1)[window, :, column]
            at = own.argmin(axis=1)
            first, last = (
                inner[window, np.maximum(at - 1, 0)],
                inner[window, np.minimum(at + 1, ZOOM_POINTS - 1)],
            )
        return best

    def unwrapped(self, joint, turns, followed=None):
        """A joint followed continuously; its turns count the reported joint at the first pose."""
        start = (self.q0 if joint == 0 else self.q3)[0]
        followed = (self.q0 if joint == 0 else self.q3) if followed is None else followed
        first = start - self.problem.calibration.joint_offset[joint]
        wrapped = -((-first + math.pi) % (2 * math.pi) - math.pi)
        return followed + (wrapped + 2 * math.pi * turns - first)

    def unwrapped_sides(self, q0_turns, x=None, q0=None):
        """Left and right of a shoulder of a turn or more, (m, 2): they count within half a turn of their limit."""
        x = self.samples if x is None else x
        q0 = self.unwrapped(0, q0_turns, q0)
        out = []
        for side, beyond in ((2, q0 - self.hi[0]), (3, self.lo[0] - q0)):
            signed = np.where(beyond <= 0, x.sides[:, side], -x.sides[:, side])
            out.append(np.where(np.abs(beyond) <= math.pi, signed, np.inf))
        return np.stack(out, axis=1)

    def least_unwrapped_sides(self, q0_turns):
        """Their least values on the path, mm."""
        return self.minima(lambda x, q0, q3: self.unwrapped_sides(q0_turns, x, q0))

    def roll_margins(self, least, roll_turns):
        """Both margins of the roll in deg for a choice of turns, from the minima of its columns."""
        shift = math.degrees(self.unwrapped(3, roll_turns)[0] - self.q3[0])
        low, high = least[COLUMNS.index("roll_min")], least[COLUMNS.index("roll_max")]
        return low + shift - math.degrees(self.lo[3]), high - shift + math.degrees(self.hi[3])

    def turns_that_fit(self, joint, least):
        """All turns of the shoulder or the roll that keep its whole range within its limits."""
        name = "q0" if joint == 0 else "roll"
        low, high = least[COLUMNS.index(f"{name}_min")], -least[COLUMNS.index(f"{name}_max")]
        if not (math.isfinite(low) and math.isfinite(high)):
            return []
        start = math.degrees((self.q0 if joint == 0 else self.q3)[0])
        shift = math.degrees(self.unwrapped(joint, 0)[0]) - start
        first = math.ceil((math.degrees(self.lo[joint]) - low - shift) / 360)
        return list(range(first, math.floor((math.degrees(self.hi[joint]) - high - shift) / 360) + 1))


def highest(function, rows):
    """Largest value of a function of a direction for each of m rows, by trying directions; infinite where one is NaN.

    Args:
        function: directions (m, k), rad, to values (m, k).
        rows: m.
    """
    step = 2 * math.pi / DIRECTIONS
    tried = np.tile(np.arange(DIRECTIONS) * step, (rows, 1))
    values = function(tried)
    undefined, values = np.isnan(values).any(axis=1), np.nan_to_num(values, nan=-math.inf)
    row, best = np.arange(rows), values.max(axis=1)
    around = tried[row, values.argmax(axis=1)][:, None]
    for _ in range(DIRECTION_ROUNDS):
        tried = around + np.linspace(-step, step, DIRECTION_POINTS)
        values = np.nan_to_num(function(tried), nan=-math.inf)
        best, around = np.maximum(best, values.max(axis=1)), tried[row, values.argmax(axis=1)][:, None]
        step = 2 * step / (DIRECTION_POINTS - 1)
    low, middle, high = np.nan_to_num(function(around + step * np.array((-1, 0, 1)))).T
    bend = low - 2 * middle + high
    peak = np.where(
        bend < 0, (low - high) / np.where(bend < 0, 2 * bend, 1.0), 0.0
    )  # of the parabola through them
    last = function(around + step * np.clip(peak, -1, 1)[:, None])[:, 0]
    return np.where(undefined, math.inf, np.fmax(best, last))
