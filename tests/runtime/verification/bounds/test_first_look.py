"""The first look: it never says more than is true, hardly less, and leaves the answer what the closed bounds alone give.

What is true comes of the dense reference, which shares no formula with the module. That would not see a constant on the cautious
side, so each bound of one stroke is computed here anew as well, from the rule in its docstring.
"""

import importlib
import math
import multiprocessing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cutgate.runtime.verification import certificate, certified
from cutgate.runtime.verification.bounds import bisection, first_look
from cutgate.runtime.verification.bounds import look as look_module
from cutgate.runtime.verification.bounds import pieces as pieces_module
from cutgate.runtime.verification.bounds.enclosures import (
    ACCELERATION,
    COLUMNS,
    INNER,
    LEFT,
    Q0_MAX,
    Q0_MIN,
    RIGHT,
    ROLL_MAX,
    ROLL_MIN,
    SPEED,
    Scope,
)
from cutgate.runtime.verification.bounds.first_look import FirstLook, Looks
from cutgate.runtime.verification.bounds.geometry import canonical
from cutgate.runtime.verification.bounds.look import TouchesError
from cutgate.runtime.verification.bounds.minima import INTERVAL, ROUND, Aim, Minima
from cutgate.runtime.verification.bounds.pieces import Pieces
from cutgate.runtime.verification.effort import Effort, EffortSpentError
from cutgate.runtime.verification.problem import Arm, ArmCalibration, Deadband
from cutgate.runtime.workspace.planar import Arc as Arc_
from tests.oracle.dense import Dense
from tests.runtime.verification.cases import (
    DEG,
    WIDE,
    axis,
    limited,
    mirrored,
    problem,
    threshold,
    wrist_path,
)
from tests.runtime.verification.decided import closed_in, drawn, refined
from tests.runtime.verification.random_paths import random_path
from tests.seeds import seeds

BENCHMARKS = Path(__file__).parents[4] / "tools" / "benchmarks"
FAST = np.full(5, 1e9)
EPSILON = np.finfo(float).eps
PLACES = 9
"""Samples of a piece, both ends among them."""

NOISE = 2e-11
"""Of a change of a joint between samples, mm and rad."""


def looked(found, **changes):
    """The first look at a problem, accelerations included, or None."""
    geometry, segments = canonical(replace(found, **changes))
    return FirstLook.of(geometry, segments, accelerations=True)


def once(found):
    """A look at the segments as they are, or None."""
    geometry, segments = canonical(found)
    return FirstLook._of(geometry, segments, True, Pieces.whole)


def places(look):
    """Segments, first fractions and widths of a look's pieces, and all their sampled fractions, (m, PLACES)."""
    a_run = look.hertz.shape[1]
    pieces = np.arange(look.hertz.size)
    segment, s0 = look.pieces.places(pieces, a_run)
    width = look.pieces.width[pieces // a_run]
    return segment, width, np.minimum(s0[:, None] + width[:, None] * np.linspace(0, 1, PLACES), 1.0)


class Truth:
    """What the dense reference attains on pieces of a path, in the columns of the right elbow."""

    def __init__(self, found, path, per_segment=24):
        self.dense = Dense(found, per_segment)
        self.left = found.arm.elbow == "left"
        q0, q3 = self._signed(self.dense.q0[:1], self.dense.q3[:1])
        self.turns = [
            2 * math.pi * np.round((a - b[0]) / (2 * math.pi))
            for a, b in zip(path.start, (q0, q3), strict=True)
        ]

    def _signed(self, *angles):
        return [-a if self.left else a for a in angles]

    def _canonical(self, x):
        unwrapped = self._signed(*self.dense.unwrap(x))
        q0, q3 = (q + turn for q, turn in zip(unwrapped, self.turns, strict=True))
        return q0, q3, x.sides[:, [0, 1, 3, 2]] if self.left else x.sides

    def values(self, x):
        """Of samples, (m, SPEED)."""
        q0, q3, sides = self._canonical(x)
        strays = x.strays[:, ::-1] if self.left else x.strays
        return np.column_stack((sides, q3 - strays[:, 0], -q3 - strays[:, 1], q0, -q0))

    def of(self, look):
        """Least sampled value of each column on each piece, (m, COLUMNS), the joints there, (m, PLACES, 5), and the ends.

        At the ends, (m, 2, SPEED), the roll is that without errors.
        """
        segment, width, s = places(look)
        every = np.repeat(segment, PLACES)
        x = self.dense.at(every, s.ravel())
        q0, q3, sides = self._canonical(x)
        q = np.stack((q0, np.abs(x.q[:, 1]), x.q[:, 2], q3, x.q[:, 4]), axis=1)
        values = self.values(x)
        out = np.full((len(segment), COLUMNS), np.inf)
        q = q.reshape(-1, PLACES, 5)
        out[:, :SPEED] = values.reshape(-1, PLACES, SPEED).min(axis=1)
        step = self.dense.seconds[segment] * width / (PLACES - 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            for first, order, power in ((SPEED, 1, 1), (ACCELERATION, 2, 2)):
                change = np.maximum(np.abs(np.diff(q, order, axis=1)).max(axis=1) - order * NOISE, 0.0)
                out[:, first : first + 5] = -np.where(change > 0, change / (step**power)[:, None], 0.0)
        plain = np.column_stack((sides, q3, -q3, q0, -q0)).reshape(-1, PLACES, SPEED)
        return out, q, plain[:, [0, -1]]


def exceeding(look, truth, what):
    """What a look says beyond what is attained, in words."""
    attained, q, ends = truth.of(look)
    for column, bounds in enumerate(look.bounds):
        true = attained[:, column] + (1e-8 if column < SPEED else 1e-9 * (1 + np.abs(attained[:, column])))
        for piece in np.flatnonzero(~(bounds.ravel() <= true)):
            kept = bounds.ravel()[piece]
            yield f"{what}: column {column} of piece {piece}: {kept} above {attained[piece, column]}"
    for joint, followed in enumerate(look.joints):
        first, last = followed[:, :-1].ravel(), followed[:, 1:].ravel()
        if not np.allclose(np.stack((first, last)), q[:, [0, -1], joint].T, rtol=0, atol=1e-8):
            yield f"{what}: joint {joint} is another"
    for column in range(SPEED):
        kept = np.stack((look.ends[column][:, :-1].ravel(), look.ends[column][:, 1:].ravel()))
        true = ends[:, :, column].T
        if column < ROLL_MIN and not (kept <= true + 1e-8).all():
            yield f"{what}: an end of column {column} is nearer"
        if column >= ROLL_MIN and not np.allclose(kept, true, rtol=0, atol=1e-8):
            yield f"{what}: an end of column {column} is another"


def looks_of(found, rng, cut=12):
    """Every look that can come of a problem: at all segments, arcs clipped and not, at some eighths and their eighths."""
    path = looked(found)
    if path is None:
        return
    truth = Truth(found, path)
    for look in path.all():
        yield path, truth, look, "all"
        for column in range(ROLL_MIN):
            look._clip(column)
        yield path, truth, look, "clipped"
        parent = look
        for depth in ("eighths", "sixty-fourths"):
            rows = np.sort(rng.choice(parent.hertz.size, min(cut, parent.hertz.size), replace=False))
            part = parent.pieces.cut(path.segments, rows, parent.joints)
            finer = first_look._looked(path.geometry, path.segments, part, accelerations=True)
            assert finer is not None
            for column in range(ROLL_MIN):
                finer._clip(column)
            yield path, truth, finer, depth
            inherited = [b.copy() for b in finer.bounds]
            finer.inherit(parent, rows)
            assert all((a >= b).all() for a, b in zip(finer.bounds, inherited, strict=True))
            yield path, truth, finer, f"{depth}, inherited"
            parent = finer


def with_limits(found, rng):
    """Sometimes with limits of the accelerations."""
    if rng.random() < 0.5:
        return found
    return replace(found, acceleration=np.array([5.0, 5.0, 1e3, 10.0, 10.0]) * 10.0 ** rng.uniform(-3, 1))


# -- never more than is true ---------------------------------------------------------------------------


@pytest.mark.parametrize("seed", seeds(3, 12))
def test_no_bound_is_above_what_a_dense_sample_of_its_piece_attains(seed):
    rng, wrong, count, parted = np.random.default_rng([20260601, seed]), [], 0, 0
    while count < 30:
        found = drawn(rng, (1, 1, 2, 6))
        looks = list(looks_of(found, rng))
        for path, truth, look, what in looks:
            wrong += exceeding(look, truth, what)
            parted += path.parts > 1 and what == "all"
        count += bool(looks)
    assert wrong == []
    assert parted > 0


# -- hardly less than is true --------------------------------------------------------------------------

CALIBRATION = ArmCalibration(
    upper_link_error_mm=0.7,
    forearm_link_error_mm=-1.3,
    joint_offset=np.array([0.01, -0.02, 1.5, 0.03, -0.015]),
    slide_tilt=np.array([0.011, -0.017]),
    residual_mm=0.3,
    residual_rad=0.002,
)
A0, A1, TOOL = 450.7, 398.7, 160.0


def stroke(q0=0.2, q1=1.1, pitch=(60.0, 68.0), azimuth=(0.4, 0.52), step=(13.0, -9.0, 4.0), **changes):
    """Two poses with everything that may differ from zero: lean, errors, links, offsets, tolerances."""
    x, y = A0 * math.cos(q0) + A1 * math.cos(q0 + q1), A0 * math.sin(q0) + A1 * math.sin(q0 + q1)
    first = np.array([x + 250 * 0.011, y - 250 * 0.017, 250.0])
    tips, axes = wrist_path(
        [first, first + step], axis(np.array(pitch) * DEG, q0 + q1 + np.array(azimuth)), TOOL
    )
    values = {
        "tool_length_mm": TOOL,
        "arm": Arm(450.0, 400.0, "right"),
        "calibration": CALIBRATION,
        "deadband": Deadband(1.0, 0.5 * DEG, 0.1, 0.001),
        "lower": np.array([-80 * DEG, 0.0, 50.0, -170 * DEG, 0.0]),
        "upper": np.array([80 * DEG, 145 * DEG, 450.0, 170 * DEG, 110 * DEG]),
        "acceleration": FAST,
    }
    return problem(tips, axes, **(values | changes))


class Reference:
    """The bounds of a problem of two poses, right elbow, each from its rule; without what rounding takes."""

    def __init__(self, found):
        c, d = found.calibration, found.deadband
        self.tool = found.tool_length_mm
        self.stretch = math.sqrt(1 + c.slide_tilt @ c.slide_tilt)
        self.a0, self.a1 = (
            found.arm.upper_mm + c.upper_link_error_mm,
            found.arm.forearm_mm + c.forearm_link_error_mm,
        )
        self.error_mm = (c.residual_mm + d.path_tolerance_mm) * self.stretch
        self.error_rad = c.residual_rad + d.path_tolerance_rad
        self.lower, self.upper = found.lower + c.joint_offset, found.upper + c.joint_offset
        w = found.tips_mm + self.tool * found.axes
        self.c, self.z = w[:, :2] - w[:, 2:] * c.slide_tilt, w[:, 2]
        self.r, self.chord = np.hypot(*self.c.T), float(np.hypot(*(self.c[1] - self.c[0])))
        self.q1 = np.arccos((self.r**2 - self.a0**2 - self.a1**2) / (2 * self.a0 * self.a1))
        beta = np.arctan2(self.a1 * np.sin(self.q1), self.a0 + self.a1 * np.cos(self.q1))
        self.q0 = np.arctan2(self.c[:, 1], self.c[:, 0]) - beta
        self.psi = self.q0 + self.q1
        u = found.axes
        self.q3 = np.arctan2(u[:, 1], u[:, 0]) - self.psi
        self.q4 = np.arccos(u[:, 2])
        normal = np.cross(u[0], u[1])
        self.theta = math.asin(np.linalg.norm(normal))
        self.level = float(np.hypot(u[:, 0], u[:, 1]).min()) - self.theta / 2
        self.twist = abs(normal[2]) / (1 - self.theta**2 / 6)
        length = np.linalg.norm(found.tips_mm[1] - found.tips_mm[0])
        self.seconds = max(length, self.tool * self.theta) / found.feed_mm_s
        self.bend = self.stretch * self.tool * self.theta**2
        self.sag = self.bend / 8
        self.nearest = math.sqrt(self.r.min() ** 2 - self.chord**2 / 4) - self.sag
        self.farthest = self.r.max() + self.sag
        self.sine = self.elbow_sine(0.0)
        self.turn = (self.chord + self.bend / 2) / self.sine
        self.pull = (self.bend + self.turn**2 / self.a0 + self.turn**2 / self.a1) / self.sine
        self.second = (
            self.pull / self.a0,
            self.pull / self.a0 + self.pull / self.a1,
            self.tool * self.theta**2,
            2 * self.theta * self.twist / self.level**3 + self.pull / self.a1,
            self.twist**2 / self.level**3,
        )

    def elbow_sine(self, error):
        ends = [
            (r**2 - self.a0**2 - self.a1**2) / (2 * self.a0 * self.a1)
            for r in (self.nearest - error, self.farthest + error)
        ]
        return math.sqrt(1 - max(x * x for x in ends))

    def arcs(self):
        """Where the nearest place of each arc is within it, and neither is beside its line."""
        inner, outer = (
            math.sqrt(self.a0**2 + self.a1**2 + 2 * self.a0 * self.a1 * math.cos(q1))
            for q1 in (self.upper[1], max(self.lower[1], 0.0))
        )
        return (self.nearest - inner, outer - self.farthest, *map(self.side, (self.upper[0], self.lower[0])))

    def side(self, q0):
        about = np.hypot(*(self.c - self.a0 * np.array([math.cos(q0), math.sin(q0)])).T)
        beyond = math.sqrt(about.min() ** 2 - self.chord**2 / 4) - self.a1
        across = math.cos(q0) * self.c[:, 1] - math.sin(q0) * self.c[:, 0]
        line = self.a1 * min(math.sin(max(self.lower[1], 0.0)), math.sin(self.upper[1])) - across.max()
        return max(beyond, self.a1 - about.max(), line) - self.sag

    def roll(self):
        ratio = math.sin(self.error_rad) / self.level
        wide = ratio / math.sqrt(1 - ratio**2) - self.error_rad
        wide += self.error_mm / (self.a1 * self.elbow_sine(self.error_mm))
        sway = self.second[3] / 8 + wide
        return self.q3.min() - sway, -self.q3.max() - sway

    def shoulder(self):
        return self.q0.min() - self.second[0] / 8, -self.q0.max() - self.second[0] / 8

    def speeds(self):
        change = [abs(q[1] - q[0]) for q in (self.q0, self.q1, self.z, self.q3, self.q4)]
        return [-(c + x / 2) / self.seconds for c, x in zip(change, self.second, strict=True)]

    def accelerations(self):
        q0, q1 = abs(self.q0[1] - self.q0[0]), abs(self.q1[1] - self.q1[0])
        first = q0 + self.pull / self.a0 / 2
        heading = min(q0 + q1 + self.pull / self.a1 / 2, self.turn / self.a1)
        pulled = (self.bend + self.a0 * first**2 + self.a1 * heading**2) / self.sine
        azimuth = 2 * self.theta * self.twist / self.level**3
        found = (pulled / self.a0, pulled / self.a0 + pulled / self.a1, self.bend, azimuth + pulled / self.a1)
        return [-x / self.seconds**2 for x in (*found, self.second[4])]

    def bounds(self):
        return np.array([*self.arcs(), *self.roll(), *self.shoulder(), *self.speeds(), *self.accelerations()])


def free(found):
    """With limits that leave the arm all that it reaches."""
    ends = {"lower0": -3.0, "upper0": 3.0, "lower1": 0.0, "upper1": math.pi, "lower3": -WIDE, "upper3": WIDE}
    return limited(found, **ends, lower2=-1e4, upper2=1e4, lower4=0.0, upper4=math.pi)


def wrist(tool, centres):
    """A level tool of a plain arm whose wrist centre goes from place to place."""
    tips, axes = wrist_path(np.array(centres), axis(math.pi / 2, 0.3), tool)
    return problem(tips, axes, tool_length_mm=tool, acceleration=FAST)


STROKES = {
    "as it is": stroke(),
    "outward": stroke(q1=0.9, step=(22.0, 14.0, -3.0)),
    "inward, elbow far bent": stroke(q1=2.2, step=(-9.0, -18.0, 1.0)),
    "the heading turns little, the shoulder and the elbow against each other": stroke(step=(5.0, -28.0, 0.0)),
    "the axis alone": stroke(step=(0.0, 0.0, 0.0), pitch=(75.0, 62.0)),
    "the wrist alone": stroke(pitch=(60.0, 60.0), azimuth=(0.4, 0.4)),
    "beside the upper link at its limit": limited(
        stroke(q0=0.5, q1=0.35, step=(5.0, -8.0, 0.0)), lower1=0.3, upper1=2.6
    ),
    "in its circle": limited(stroke(q1=1.4), upper0=0.5, lower0=-0.3),
    "a slide that leans forward": stroke(calibration=replace(CALIBRATION, slide_tilt=np.array([0.02, 0.0]))),
    "a slide that leans aside": stroke(calibration=replace(CALIBRATION, slide_tilt=np.array([0.0, -0.03]))),
    "downward tool": stroke(pitch=(120.0, 126.0)),
    "a steep tool": stroke(pitch=(20.0, 23.0), azimuth=(0.4, 0.3)),
}


@pytest.mark.parametrize("elbow", ["right", "left"])
@pytest.mark.parametrize("name", STROKES)
def test_a_bound_is_what_its_rule_says(name, elbow):
    found = STROKES[name]
    path = once(found if elbow == "right" else mirrored(found))
    bounds = np.array([b[0, 0] for b in path.only.bounds])
    expected = Reference(found).bounds()
    assert bounds == pytest.approx(expected, rel=3e-9, abs=3e-9)
    assert (bounds <= expected + 1e-12 * (1 + np.abs(expected))).all(), "nothing is left for rounding"


def rest(q1=1.1, pitch=60.0, **changes):
    """The stroke's first pose twice."""
    return stroke(q1=q1, pitch=(pitch, pitch), azimuth=(0.4, 0.4), step=(0.0, 0.0, 0.0), **changes)


LINKS = ArmCalibration(upper_link_error_mm=0.7, forearm_link_error_mm=-1.3, slide_tilt=CALIBRATION.slide_tilt)
EXACT = {"calibration": ArmCalibration(), "deadband": Deadband(1.0, 0.5 * DEG)}


def test_what_is_kept_back_for_rounding():
    """Of a rest: a distance loses ``pad_mm``, an angle what that turns both links, and its own."""
    found = rest(**EXACT)
    geometry, _ = canonical(found)
    assert geometry.pad_mm == pytest.approx(256 * EPSILON * (850 + 160 + np.abs(found.tips_mm).max()))
    path = once(found)
    x = Reference(found)
    kept = [path.only.ends[c][0, 0] - path.only.bounds[c][0, 0] for c in range(SPEED)]
    assert kept[:4] == pytest.approx([geometry.pad_mm] * 4, rel=1e-2, abs=0)
    own = 256 * EPSILON * (32 + 1 / math.sin(60 * DEG))
    assert kept[4:] == pytest.approx([2 * geometry.pad_mm / (400 * x.sine) + own] * 4, rel=1e-2, abs=0)
    moving = once(replace(found, tips_mm=found.tips_mm + np.outer([0, 1], [0, 0, 1e-6])))
    lost = -1e-7 * np.array([moving.only.bounds[SPEED + j][0, 0] for j in range(5)])
    expected = np.full(5, kept[4])
    expected[2] = 1e-6 + geometry.pad_mm
    assert lost == pytest.approx(expected, rel=1e-2, abs=0)


def test_a_chord_is_no_better_known_than_its_ends():
    """A step straight at the elbow, bent at a right angle: it turns the forearm alone, whose pull is all that there is."""
    mm = 1e-6
    found = rest(**EXACT, q1=math.pi / 2)
    found = free(replace(found, arm=Arm(A0, A1, "right")))
    found = replace(found, tips_mm=found.tips_mm - [[250 * 0.011, -250 * 0.017, 0.0]])
    x = Reference(found)
    assert x.q1[0] == pytest.approx(math.pi / 2, abs=1e-9)
    step = mm * np.array([math.cos(x.q0[0]), math.sin(x.q0[0]), 0.0])
    found = replace(found, tips_mm=found.tips_mm + np.outer([0, 1], step))
    pad = canonical(found)[0].pad_mm
    assert 1e-11 < pad < 1e-9
    expected = -(((mm + pad) / (mm / found.feed_mm_s)) ** 2) / (A0 * A1)
    assert once(found).only.bounds[ACCELERATION][0, 0] == pytest.approx(expected, rel=2e-5)


def test_the_distance_of_a_wrist_that_lies_in_the_elbow_of_a_limit():
    """The whole forearm from the side: as exact there as everywhere."""
    q0, off = 0.7, 3e-6
    centre = [A0 * math.cos(q0), A0 * math.sin(q0) + off, 250.0]
    tips, axes = wrist_path([centre] * 2, axis(1.2, 0.3))
    found = problem(tips, axes, arm=Arm(A0, A0, "right"))
    path = once(limited(free(found), upper0=q0, lower0=-2.5))
    assert path.only.ends[LEFT][0] == pytest.approx([A0 - off] * 2, abs=1e-9)
    assert path.only.bounds[LEFT][0, 0] <= A0 - off


@pytest.mark.parametrize(
    ("r", "pitch", "defined"),
    [(0.48, 60.0, False), (0.6, 60.0, True), (800.0, 0.1, False), (800.0, 0.3, True)],
)
def test_errors_that_reach_the_column_or_the_vertical_leave_no_roll(r, pitch, defined):
    """The one by 0.5 mm, of equal links; the other by 0.2 deg."""
    tips, axes = wrist_path([[r, 0.0, 250.0]] * 2, axis(pitch * DEG, 0.3))
    found = problem(
        tips,
        axes,
        lower=np.array([-3.0, 0.0, -1e4, -WIDE, 0.0]),
        upper=np.array([3.0, math.pi, 1e4, WIDE, math.pi]),
        calibration=ArmCalibration(residual_mm=0.5, residual_rad=0.2 * DEG),
    )
    bounds = once(found).only.bounds
    assert np.isfinite([bounds[ROLL_MIN][0, 0], bounds[ROLL_MAX][0, 0]]).tolist() == [defined] * 2


def test_a_rest_takes_no_time_and_has_no_rates():
    path = once(rest())
    rates = [b[0, 0] for b in path.only.bounds[SPEED:]]
    assert rates == [0.0] * 10


def about(arc, angle, radius):
    """A place seen from an arc's centre."""
    return arc.x + radius * math.cos(angle), arc.y + radius * math.sin(angle)


def clipped(arc, places, sag=0.0):
    """What `_clipped` says of the ends of one piece between two places, and of the piece."""
    x, y = (np.array([[p[i] for p in places]]) for i in (0, 1))
    quarter = ((x[:, 1:] - x[:, :-1]) ** 2 + (y[:, 1:] - y[:, :-1]) ** 2) / 4
    ends, bounds = look_module._clipped(arc, [x, y, x * x + y * y, quarter, np.full_like(quarter, sag)])
    return ends[0], bounds[0, 0]


ARCS = [Arc_(30.0, -20.0, 400.0, start, span) for start in (-2.0, 0.7) for span in (0.01, 1.0, 3.0, 3.3, 6.0)]


@pytest.mark.parametrize("arc", ARCS, ids=str)
def test_where_an_arc_is_clipped_the_distance_is_that_of_its_nearer_end(arc):
    """Of places at rest, all around and in and out of its circle; where it is not clipped nothing is said."""
    seen = {True: 0, False: 0}
    for angle in arc.start + np.linspace(0.005, 2 * math.pi - 0.004, 97):
        for radius in (1e-6, 150.0, 399.0, 700.0):
            place = about(arc, angle, radius)
            beside = (angle - arc.start) % (2 * math.pi) <= arc.span
            ends, bound = clipped(arc, [place, place])
            nearer = min(math.dist(place, end) for end in arc.ends)
            expected = -math.inf if beside else nearer
            assert ends == pytest.approx([expected] * 2, rel=1e-12)
            assert bound == pytest.approx(expected, rel=1e-12)
            seen[beside] += 1
    assert seen[False] > 10
    assert seen[True] > 0


def test_a_circle_is_not_clipped():
    ends, bound = clipped(Arc_(0.0, 0.0, 400.0, 1.0, 2 * math.pi), [(390.0, 1.0), (390.0, -1.0)])
    assert (ends == -math.inf).all()
    assert bound == -math.inf


@pytest.mark.parametrize("span", [1.0, 3.0, 3.5, 5.0])
@pytest.mark.parametrize("end", [0, 1])
@pytest.mark.parametrize("radius", [300.0, 500.0])
def test_a_piece_is_clipped_as_far_as_the_way_leaves_its_chord(span, end, radius):
    """Straight beyond an end of the arc, outward and back: its line is as far off as the way may leave the chord."""
    arc = Arc_(30.0, -20.0, 400.0, 0.4, span)
    angle = arc.start - 1e-9 if end == 0 else arc.start + span + 1e-9
    out = np.array([math.cos(angle), math.sin(angle)])
    beyond = np.array([-out[1], out[0]]) * (1 if end else -1)
    places_ = [np.array([arc.x, arc.y]) + radius * out + off * beyond for off in (5.0, 8.0)]
    nearer = math.sqrt(min(math.dist(p, arc.ends[end]) for p in places_) ** 2 - 3.0**2 / 4)
    assert clipped(arc, places_, 4.999)[1] == pytest.approx(nearer - 4.999, rel=1e-9)
    assert clipped(arc, places_, 5.001)[1] == -math.inf
    across = [places_[0] - 6.0 * beyond, places_[1]]
    assert clipped(arc, across, 0.1)[1] == -math.inf
    assert np.isfinite(clipped(arc, across, 0.1)[0]).tolist() == [False, True]


@pytest.fixture(scope="module")
def stem():
    """The example's hip stem, which is admissible."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(BENCHMARKS))
        return importlib.import_module("paths").hip_stem()


@pytest.fixture
def closely(monkeypatch):
    """The intervals that are bounded closely."""
    seen, bounded = [], bisection.lower_bounds

    def count(geometry, segments, scope, parts, floor):
        seen.append(parts)
        return bounded(geometry, segments, scope, parts, floor)

    monkeypatch.setattr(bisection, "lower_bounds", count)
    return seen


def test_of_a_fine_path_nothing_is_looked_at_closely(stem, closely):
    verdict = certified.verify(stem)
    assert verdict.admissible, verdict.reasons
    assert closely == []
    n = len(stem.tips_mm) - 1
    assert n <= verdict.evaluations.arm <= 1.05 * n  # those near the least distances, in eighths
    certificate_ = certificate.certify(stem, verdict)
    assert closely == []
    assert len(certificate_.cut_segment) == 0
    assert certificate.recheck(stem, certificate_) == ()


LOST = [*[0.11] * 4, *[1.4e-3] * 2, *[5.5e-4] * 2, 0.05, 0.06, 0.022, 0.09, 0.016, 1.0, 1.3, 0.75, 3.2, 0.65]
"""What a bound of that path loses on one segment, at most: mm, rad, and of the rates parts of the path's peak."""


def test_the_bounds_of_a_fine_path_are_close(stem):
    """Its segments are 2.5 mm long on average: distances and angles lose what the squares of that come to."""
    stem = replace(stem, acceleration=FAST)
    path = looked(stem)
    (look,) = path.all()
    for column in range(ROLL_MIN):
        look._clip(column)
    attained, _, _ = Truth(stem, path, per_segment=3).of(look)
    lost = (attained - np.stack([b.ravel() for b in look.bounds], axis=1)).max(axis=0)
    lost[SPEED:] /= np.abs(attained[:, SPEED:]).max(axis=0)
    assert (lost < LOST).all()
    assert (lost > 0.75 * np.array(LOST)).all(), "what is stated is far too much"


# -- the answer stays what it is -----------------------------------------------------------------------


def without(found):
    """The verdict of the closed bounds alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FirstLook, "of", lambda *_, **__: None)
        return certified.verify(found)


PROMISE = 0.01001
UNDECIDED = 5.2e-4


def differing(found, one, two):
    """What of two verdicts differs by more than either promises, in words.

    A bracket about its deadband may be decided by one alone where it is as fine as either looks.
    """
    if set(one.boundaries) != set(two.boundaries):
        yield f"{sorted(one.boundaries)} is not {sorted(two.boundaries)}"
        return
    both = [(a, two.boundaries[name]) for name, a in one.boundaries.items()]
    lines = list(zip(one.speed + one.acceleration, two.speed + two.acceleration, strict=True))
    branches = one.branch is not None and two.branch is not None
    yield from (f"{a} is not {b}" for a, b in both if not agree(a, b, enclosed=branches))
    noise = rounding(found)
    for a, b in lines:
        if a.ok is not b.ok and not abs((a.peak or 0.0) - (b.peak or 0.0)) <= 6e-4 * a.limit + noise:
            yield f"{a} is not {b}"
    rolls = [v.boundaries[n].clearance for v in (one, two) for n in ("roll_min", "roll_max")]
    if one.branch != two.branch and not any(x is not None and abs(x) <= PROMISE for x in rolls):
        yield f"{one.branch} is not {two.branch}"
    alike = all(a.violated is b.violated for a, b in both) and all(a.ok is b.ok for a, b in lines)
    if one.admissible is not two.admissible and alike:
        yield f"{one.reasons} and {two.reasons}"


def agree(a, b, *, enclosed):
    """Whether two findings of a boundary may both be; ``enclosed``: where there are joints to bound."""
    undecided = a if a.violated else b
    if a.violated is not b.violated and not (
        undecided.clearance is not None and 0 <= undecided.clearance - undecided.deadband <= UNDECIDED
    ):
        return False
    if a.clearance is None or b.clearance is None:
        return a.clearance is b.clearance
    close = abs(a.clearance - b.clearance) <= PROMISE
    true = a.certified <= b.clearance + 1e-7 and b.certified <= a.clearance + 1e-7
    return not enclosed or (close and true)


def rounding(found):
    """What it may add to a rate where the shortest steps, in parts, take hardly any time; then they are no rates."""
    steps, axes = np.diff(found.tips_mm, axis=0), np.diff(found.axes, axis=0)
    steps = np.hypot(np.linalg.norm(steps, axis=1), found.tool_length_mm * np.linalg.norm(axes, axis=1))
    smallest = np.min(steps, where=steps > 0, initial=np.inf)
    return 1e-8 * found.feed_mm_s / smallest if smallest > 1e-10 else np.inf


def spinning(rng):
    """A path of an arm whose shoulder turns by a revolution and more, or of any."""
    return random_path(rng, int(rng.integers(1, 6)), lean=0.02)


def compared(seed, count):
    """What differs with and without the first look, and how many there were, looked at and admitted."""
    rng, wrong, numbers = np.random.default_rng(seed), [], np.zeros(3, dtype=int)
    while numbers[0] < count:
        found = (
            drawn(rng, (1, 1, 4, 12))
            if rng.random() < 0.6
            else refined(spinning(rng), int(rng.choice([1, 8])))
        )
        found = with_limits(found, rng)
        for _ in range(2):
            one, two = certified.verify(found), without(found)
            wrong += [f"{seed}, {numbers[0]}: {what}" for what in differing(found, one, two)]
            numbers += (1, looked(found) is not None, two.admissible)
            found = closed_in(rng, found, two)
    return wrong, numbers


@pytest.mark.parametrize("seed", seeds(2, 8))
def test_the_answer_is_that_of_the_closed_bounds_alone(seed):
    wrong, (count, looks, admitted) = compared([20260602, seed], 80)
    assert wrong == []
    assert looks > count / 4
    assert admitted > 5


def _compared(number):
    return compared([20260603, number], 200)


@pytest.mark.long
def test_ten_thousand_answers_are_those_of_the_closed_bounds_alone():
    whole, differ = np.zeros(3, dtype=int), []
    with multiprocessing.get_context("spawn").Pool(maxtasksperchild=5) as pool:
        for wrong, numbers in pool.imap_unordered(_compared, range(50)):
            whole += numbers
            differ += wrong
    print(f"{whole[0]} problems, {whole[1]} looked at, {whole[2]} admitted, {len(differ)} differ", flush=True)  # noqa: T201
    assert whole[0] >= 10_000
    assert differ == []


@pytest.mark.parametrize("number", [63, 167, 189, 203, 237, 238])
def test_what_it_decides_more_finely_than_closed_bounds_has_a_proof_as_well(number):
    """Some that come to within 5e-4 mm or deg of what they must keep, where closed bounds may leave off."""
    rng = np.random.default_rng([20260605, number])
    found = drawn(rng, (1, 1, 4))
    found = closed_in(rng, found, certified.verify(found))
    verdict = certified.verify(found)
    assert verdict.admissible
    assert min(b.clearance - b.deadband for b in verdict.boundaries.values()) < UNDECIDED
    assert certificate.recheck(found, certificate.certify(found, verdict)) == ()


def several(seed, count, *, parts=(4, 12)):
    """Random problems at which there is a first look."""
    rng, out = np.random.default_rng([20260604, seed]), []
    while len(out) < count:
        found = with_limits(drawn(rng, parts), rng)
        if looked(found) is not None:
            out.append(found)
    return out


def all_bounds(found):
    """Of all pieces of the first look, (m, COLUMNS), and their places."""
    looks = list(looked(found).all())
    bounds = np.concatenate([np.stack([b.ravel() for b in look.bounds], axis=1) for look in looks])
    where = [(segment, s[:, 0]) for segment, _, s in map(places, looks)]
    return bounds, np.concatenate([a for a, _ in where]), np.concatenate([b for _, b in where])


@pytest.mark.parametrize("block", [8, 9, 29, 200])
def test_the_size_of_the_blocks_changes_nothing(monkeypatch, block):
    for found in several(block, 6):
        whole, alone = all_bounds(found), certified.verify(found)
        path = looked(found)
        with monkeypatch.context() as patch:
            patch.setattr(first_look, "BLOCK", block)
            patch.setattr(first_look, "PARTED_MAX", 256)
            for a, b in zip(whole, all_bounds(found), strict=True):
                assert b == pytest.approx(a, rel=1e-8, abs=1e-8)
            parted = looked(found)
            assert parted.height == pytest.approx(path.height, abs=1e-9)
            assert parted.pitch == pytest.approx(path.pitch, abs=1e-12)
            assert parted.start == path.start
            assert parted.shoulder == pytest.approx(path.shoulder, abs=1e-8)
            assert list(differing(found, alone, certified.verify(found))) == []


PARTING = {
    "never cut": {"DEPTH": 0},
    "cut once": {"DEPTH": 1},
    "cut four times": {"DEPTH": 4},
    "in quarters": {"PARTS": 4},
    "in quarters, few at a time": {"PARTS": 4, "BLOCK": 4, "DEPTH": 3},
}


@pytest.mark.parametrize("way", PARTING)
def test_how_pieces_are_cut_changes_nothing(monkeypatch, way):
    for found in several(len(way), 6, parts=(1, 2, 4)):
        alone = certified.verify(found)
        with monkeypatch.context() as patch:
            for name, value in PARTING[way].items():
                for module in (first_look, pieces_module):
                    if hasattr(module, name):
                        patch.setattr(module, name, value)
            assert list(differing(found, alone, certified.verify(found))) == []


def test_segments_cut_at_once_change_nothing(monkeypatch):
    of = FirstLook._of
    for found in several(77, 8):
        alone, path = certified.verify(found), looked(found)
        with monkeypatch.context() as patch:
            patch.setattr(
                FirstLook, "_of", lambda g, s, a, make: None if make == Pieces.whole else of(g, s, a, make)
            )
            parted = looked(found)
            assert parted.parts == 8
            assert len(parted) == len(path) == len(found.tips_mm) - 1
            assert parted.height == pytest.approx(path.height, abs=1e-9)
            assert parted.pitch == pytest.approx(path.pitch, abs=1e-12)
            assert list(differing(found, alone, certified.verify(found))) == []


def test_heights_and_pitches_are_those_of_the_poses_in_whatever_block_and_part(monkeypatch):
    monkeypatch.setattr(first_look, "BLOCK", 8)
    found = refined(stroke(), 30)
    geometry, segments = canonical(found)
    for make in (Pieces.whole, Pieces.parted):
        path = FirstLook._of(geometry, segments, False, make)
        assert len(path.looks) == 4
        assert path.height == pytest.approx(found.tips_mm[:, 2] + TOOL * found.axes[:, 2], abs=1e-9)
        assert path.pitch == pytest.approx(np.arccos(found.axes[:, 2]), abs=1e-9)


def test_a_lack_of_one_block_in_accelerations_leaves_the_parts_of_another_alone(monkeypatch):
    """Parts say nothing of accelerations. The first block lacks one of the pitch, the other, at rest there, a bound of the roll."""
    monkeypatch.setattr(first_look, "BLOCK", 8)
    turning = refined(stroke(pitch=(90.0, 90.0), azimuth=(0.4, 0.5), step=(0.0, 0.0, 0.0)), 8)
    steps = np.array([[60.0, 0.0, 0.0], [0.0, 60.0, 0.0]])
    tips = np.vstack((turning.tips_mm, turning.tips_mm[-1] + steps))
    found = free(replace(turning, tips_mm=tips, axes=turning.axes[np.minimum(np.arange(11), 8)]))
    path, pitch = looked(found), ACCELERATION + 4
    assert len(path.looks) == 2
    rolls = [ROLL_MIN, ROLL_MAX]
    looks = Looks(path, scope([*rolls, pitch]), aims(gap=1e-3), Minima(), None)
    lacking = [(kept < looks.best.value - 1e-3)[rolls].any() for kept in looks.least]
    assert lacking == [False, True]
    assert [kept[pitch] < -1e-3 for kept in looks.least] == [True, False]
    closed = list(looks.rest())
    assert sorted(set(closed[0].segment.tolist())) == list(range(8))
    assert np.isfinite(looks.proven[rolls]).all()
    assert list(differing(found, certified.verify(found), without(found))) == []


# -- where there is none -------------------------------------------------------------------------------


NONE = {
    "no workspace": limited(stroke(), lower1=-0.5, upper1=-0.1),
    "out of reach": stroke(step=(900.0, 0.0, 0.0)),
    "past the column": wrist(450.0, [[-300.0, 0.0, 250.0], [300.0, 0.0, 250.0]]),
    "a vertical tool": stroke(pitch=(0.0, 0.0)),
    "past the vertical": stroke(pitch=(4.0, 4.0), azimuth=(0.0, math.pi)),
    "a start beyond the elbow's limit": limited(stroke(), upper1=0.8),
    "a start before the elbow's limit": limited(stroke(), lower1=1.4),
    "a start beyond the shoulder's limit": limited(stroke(), upper0=0.1),
    "a start before the shoulder's limit": limited(stroke(), lower0=0.4),
}


@pytest.mark.parametrize("elbow", ["right", "left"])
@pytest.mark.parametrize("name", NONE)
def test_there_is_no_first_look(name, elbow):
    found = NONE[name] if elbow == "right" else mirrored(NONE[name])
    assert looked(found) is None
    assert list(differing(found, certified.verify(found), without(found))) == []


@pytest.mark.parametrize("turns", [-2, -1, 1])
def test_limits_another_revolution_away_hold_the_start_as_well(turns):
    away = 2 * math.pi * turns
    assert looked(limited(stroke(), lower0=-1.4 + away, upper0=1.4 + away)) is not None
    assert looked(limited(stroke(), lower0=0.4 + away, upper0=1.4 + away)) is None


def test_no_look_nearer_to_a_straight_or_a_folded_elbow():
    for side in (0.0, math.pi):

        def bent(q, side=side):
            return free(rest(q1=abs(side - q), calibration=LINKS, deadband=Deadband(1.0, 0.01)))

        q = threshold(lambda q: once(bent(q)) is not None, 0.1, 1e-5)
        assert Reference(bent(q)).sine == pytest.approx(1e-3, rel=1e-5)


def test_no_look_nearer_to_the_vertical():
    for side in (0.0, 180.0):
        pitch = threshold(lambda deg: once(free(rest(pitch=abs(side - deg)))) is not None, 5.0, 1e-3)  # noqa: B023
        assert math.sin(pitch * DEG) == pytest.approx(1e-3, rel=1e-9)


def test_no_look_where_the_tool_may_turn_too_far():
    """By a quarter of a revolution over the sine of its pitch, which itself is less by half of the turn."""

    def turning(deg):
        return stroke(
            step=(0.0, 0.0, 0.0),
            pitch=(60.0 - deg / 2, 60.0 + deg / 2),
            azimuth=(0.4, 0.4),
            tool_length_mm=1.0,
        )

    deg = threshold(lambda deg: once(free(turning(deg))) is not None, 10.0, 80.0)
    level = math.sin((60.0 - deg / 2) * DEG) - deg * DEG / 2
    assert deg * DEG / level == pytest.approx(math.pi / 2, rel=1e-9)
    assert looked(free(turning(deg + 1.0))).parts == 8


def test_no_look_where_the_arm_may_turn_too_far():
    """The way of the wrist centre over the least sine of the elbow: no more than its shorter link by a quarter of a revolution."""

    def across(mm):
        found = wrist(0.0, [[520.0, -mm, 250.0], [520.0, mm, 250.0]])
        found = replace(found, axes=axis(1.1, [0.2, 0.4]), tool_length_mm=20.0)
        return free(replace(found, arm=Arm(500.0, 400.0, "right")))

    mm = threshold(lambda mm: once(across(mm)) is not None, 10.0, 400.0)
    x = Reference(across(mm))
    assert x.turn == pytest.approx(math.pi / 2 * min(x.a0, x.a1), rel=1e-9)
    assert looked(across(mm + 1.0)).parts == 8


@pytest.mark.parametrize(("pad", "seen"), [(240.0, True), (270.0, False)])
def test_no_look_as_near_to_the_column_as_the_place_is_known(pad, seen):
    """Half a metre less the pad: elbow and turn would allow either."""
    found = free(rest(q1=math.acos(-0.3125), **EXACT))
    assert Reference(found).r[0] == pytest.approx(500.0, abs=5.0)
    geometry, segments = canonical(found)
    look = FirstLook._of(replace(geometry, pad_mm=pad), segments, False, Pieces.whole)
    assert (look is not None) is seen


@pytest.mark.parametrize(("poses", "parts"), [(257, 8), (258, None)])
def test_segments_of_longer_paths_are_not_cut_at_once(poses, parts):
    far = np.array([[520.0, -390.0, 250.0], [520.0, 390.0, 250.0]])
    assert once(free(wrist(160.0, far))) is None
    path = looked(free(wrist(160.0, far[np.minimum(np.arange(poses) % 4 // 2, 1)])))
    assert (None if path is None else path.parts) == parts


def test_a_path_that_no_eighth_can_be_followed_on():
    """As near as the eighths do not reach, and yet a path."""
    found = free(wrist(160.0, [[-500.0, 30.0, 250.0], [500.0, 30.0, 250.0]]))
    assert looked(found) is None
    assert certified.verify(found).branch == without(found).branch


# -- a path that may touch the boundary ----------------------------------------------------------------


@pytest.fixture
def built(monkeypatch):
    """How often a path is evaluated the closed bounds' way."""
    seen, build = [], certified.build
    monkeypatch.setattr(certified, "build", lambda *found: seen.append(1) or build(*found))
    return seen


TOUCHING = {
    "inner": limited(stroke(q1=1.25, step=(-40.0, -60.0, 0.0)), upper1=1.3),
    "outer": limited(stroke(q1=0.9, step=(60.0, 40.0, 0.0)), lower1=0.85),
    "left": limited(stroke(step=(-80.0, 60.0, 0.0)), upper0=0.25),
    "right": limited(stroke(step=(30.0, -90.0, 0.0)), lower0=0.15),
}


@pytest.mark.parametrize("elbow", ["right", "left"])
@pytest.mark.parametrize("name", TOUCHING)
def test_a_search_that_touches_a_boundary_begins_again_with_the_closed_bounds(built, name, elbow):
    found = TOUCHING[name] if elbow == "right" else mirrored(TOUCHING[name])
    assert looked(found) is not None
    verdict = certified.verify(found)
    assert built == [1]
    name = {"left": "right", "right": "left"}.get(name, name) if elbow == "left" else name
    assert verdict.boundaries[name].violated
    alone = without(found)
    assert verdict.boundaries == alone.boundaries
    assert verdict.reasons == alone.reasons


def test_a_search_that_comes_near_a_boundary_does_not(built):
    for room in (20.0, 1.0, 1e-3):

        def kept(q1):
            return certified.verify(limited(stroke(q1=1.25, step=(-4.0, -6.0, 0.0)), upper1=q1)).boundaries[
                "inner"
            ]

        q1 = threshold(lambda q1: kept(q1).clearance >= room, 2.0, 1.26)  # noqa: B023
        built.clear()
        assert kept(q1).clearance == pytest.approx(room, abs=1e-6)
        assert built == []


SPIN = limited(stroke(), lower0=-math.pi, upper0=math.pi + 0.3)


@pytest.mark.parametrize("elbow", ["right", "left"])
@pytest.mark.parametrize("q0", [math.pi - 0.05, math.pi + 0.25, -math.pi + 0.05])
def test_a_shoulder_of_a_revolution_and_more(built, q0, elbow):
    """Its sides count by the unwrapped shoulder: up to half a turn from their limits, and beyond them the search begins again."""
    for lower, upper in (
        (-math.pi, math.pi + 0.3),
        (-4.0, 4.0),
        (q0 - 0.01, q0 + 6.4),
        (q0 - 6.4, q0 + 0.01),
    ):
        for step in ((13.0, -9.0, 4.0), (-40.0, 60.0, 0.0), (40.0, -60.0, 0.0)):
            found = limited(stroke(q0=q0, step=step), lower0=lower, upper0=upper)
            found = found if elbow == "right" else mirrored(found)
            assert list(differing(found, certified.verify(found), without(found))) == []
    assert built


def test_a_side_half_a_turn_away_does_not_count():
    """Neither at an end of a piece nor on it: what is attained there is nothing, and kept is everything."""
    found = limited(stroke(), lower0=-3.4, upper0=3.4)
    path = looked(found)
    look = path.only
    q0 = look.joints[0][0]
    aim, best = aims(), Minima()
    for column, limit, sign in ((LEFT, 3.4 + 0.01, 1.0), (RIGHT, -3.4 + 0.01, -1.0)):
        for little in (-0.02, 0.02):
            shift = (
                limit - sign * (math.pi + 1e-9) - q0[0 if sign * q0[0] > sign * q0[1] else 1] - sign * little
            )
            look.offer([column], scope([column], shift), aim, best)
            nearest = np.isinf(look.shown[column][0, 0])
            assert nearest == (little > 0)
            assert np.isfinite(best.value[column]) == (little < 0)
            best = Minima()


@pytest.mark.parametrize("little", [-1e-6, 1e-6])
@pytest.mark.parametrize("column", [LEFT, RIGHT])
def test_a_shoulder_that_may_pass_its_unwrapped_limit_is_left_to_the_closed_bounds(column, little):
    path = looked(limited(stroke(), lower0=-3.4, upper0=3.4))
    bounds = [path.only.bounds[c][0, 0] for c in (Q0_MIN, Q0_MAX)]
    shift = 3.41 + bounds[1] + little if column == LEFT else -3.39 - bounds[0] - little
    if little > 0:
        with pytest.raises(TouchesError):
            Looks(path, scope([column], shift), aims(), Minima(), None)
    else:
        looks = Looks(path, scope([column], shift), aims(gap=1e3), Minima(), None)
        assert np.isfinite(looks.best.value[column])


def scope(columns, shift=None):
    wanted = np.zeros(COLUMNS, dtype=bool)
    wanted[columns] = True
    return Scope(wanted, reachable=True, winding_known=True, roll_defined=True, shoulder_shift=shift)


def aims(gap=1e-3, target=-np.inf, share=0.0, missed=0.0):
    full = [np.full(COLUMNS, float(x)) for x in (gap, share, missed, target, 1e-4)]
    return Aim(*full)


def test_a_part_that_cannot_be_followed_is_left_to_the_closed_bounds(monkeypatch):
    """Rounding may say so of a part of what could be followed; and the search begins again if it may touch."""
    looked_ = first_look._looked

    def whole_only(geometry, segments, pieces, *, accelerations):
        return (
            looked_(geometry, segments, pieces, accelerations=accelerations)
            if len(pieces.segment) == 1 and (pieces.width[0] == 1.0)
            else None
        )

    monkeypatch.setattr(first_look, "_looked", whole_only)
    found = stroke(acceleration=None)
    assert list(differing(found, certified.verify(found), without(found))) == []
    touching = TOUCHING["inner"]
    looks = Looks(looked(touching), scope([INNER]), aims(), Minima(), None)
    with pytest.raises(TouchesError):
        list(looks.rest())


# -- what it asks of a survey --------------------------------------------------------------------------


def test_work_is_counted_before_it_is_done(stem):
    geometry, segments = canonical(stem)
    path = FirstLook.of(geometry, segments, accelerations=False)
    n = len(segments)
    effort = Effort(ROUND + INTERVAL * n)
    looks = Looks(path, scope([ROLL_MIN]), aims(gap=1.0), Minima(), effort)
    assert (effort.spent, looks.looked_at, looks.most) == (ROUND + INTERVAL * n, n, n * (1 + 8 + 64))
    with pytest.raises(EffortSpentError):
        Looks(path, scope([ROLL_MIN]), aims(gap=1.0), Minima(), Effort(ROUND + INTERVAL * n - 1))
    assert (ROUND, INTERVAL) == (5000, 6)
    assert first_look.PARTED_MAX == 256


def test_a_survey_of_what_is_kept_needs_nothing_more():
    path = looked(stroke())
    looks = Looks(path, scope([ROLL_MIN, Q0_MIN]), aims(gap=1.0), Minima(), None)
    assert not looks.lacking.any()
    assert list(looks.rest()) == []
    assert looks.proven[ROLL_MIN] == path.only.bounds[ROLL_MIN][0, 0]
    assert looks.proven[Q0_MAX] == np.inf


@pytest.mark.parametrize(("gap", "needs"), [(0.999, True), (1.001, False)])
def test_a_bound_must_be_close_to_the_least_value_found(gap, needs):
    path = looked(stroke())
    attained = path.only.ends[Q0_MIN].min()
    lost = attained - path.only.bounds[Q0_MIN][0, 0]
    looks = Looks(path, scope([Q0_MIN]), aims(gap=gap * lost), Minima(), None)
    assert looks.lacking[Q0_MIN] == needs


@pytest.mark.parametrize(("part", "needs"), [(0.01, False), (0.99, True), (1.01, False)])
def test_a_bound_must_decide_whether_the_target_is_kept(part, needs):
    """Between bound and least value found it is undecided; the value below it, it is decided."""
    path = looked(stroke())
    attained, bound = path.only.ends[Q0_MIN].min(), path.only.bounds[Q0_MIN][0, 0]
    target = bound + part * (attained - bound) if part != 0.01 else bound - 1e-6
    looks = Looks(path, scope([Q0_MIN]), aims(gap=1.0, target=target), Minima(), None)
    assert looks.lacking[Q0_MIN] == needs


def test_what_the_other_pieces_keep_is_all_that_is_proved_before_the_rest_is_bounded(monkeypatch):
    monkeypatch.setattr(first_look, "DEPTH", 0)
    found = stroke()
    tips = np.vstack((found.tips_mm, found.tips_mm[1:] + 0.3 * np.diff(found.tips_mm, axis=0)))
    found = replace(found, tips_mm=tips, axes=found.axes[[0, 1, 1]])
    path = looked(found)
    bounds = path.only.bounds[Q0_MAX][0]
    coarse, fine = np.argsort(bounds)
    gap = -path.only.joints[0].max() - bounds.mean()
    looks = Looks(path, scope([Q0_MAX]), aims(gap=gap), Minima(), None)
    (parts,) = looks.rest()
    assert parts.segment.tolist() == [coarse]
    assert looks.proven[Q0_MAX] == bounds[fine]


def test_the_fastest_piece_is_named_in_its_middle():
    """The third of four, and of its eighths the one of which the mean is largest."""
    found = refined(stroke(), 4)
    tips = found.tips_mm.copy()
    tips[3:, 2] += 30.0
    path, best = looked(replace(found, tips_mm=tips)), Minima()
    path.only.offer(list(range(SPEED, ACCELERATION)), scope([SPEED]), aims(), best)
    assert (best.segment[SPEED + 2], best.fraction[SPEED + 2]) == (2, 0.5)
    assert best.value[SPEED + 2] == -path.only.means[2][0, 2]
    rows = np.array([2])
    part = path.only.pieces.cut(path.segments, rows, path.only.joints)
    finer = first_look._looked(path.geometry, path.segments, part, accelerations=False)
    fastest = int(finer.means[0].argmax())
    finer.offer([SPEED], scope([SPEED]), aims(), best := Minima())
    assert (best.segment[SPEED], best.fraction[SPEED]) == (2, (fastest + 0.5) / 8)


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("elbow", ["right", "left"])
def test_pieces_that_are_bounded_closely_go_on_counting_turns(way, elbow):
    """Round the column twice and on, the tool the other way round."""
    q0 = way * np.linspace(0.1, 15.0, 61)
    centres = np.stack((700 * np.cos(q0), 700 * np.sin(q0), np.full(61, 250.0)), axis=1)
    found = free(problem(*wrist_path(centres, axis(1.2, -q0)), acceleration=FAST))
    found = limited(found, lower0=-20.0, upper0=20.0)
    path = looked(found if elbow == "right" else mirrored(found))
    look = path.only
    assert np.ptp(look.joints[0]) > 14.0
    assert np.ptp(look.joints[3]) > 28.0
    rows = np.array([0, 30, 60 - 1])
    parts = look.intervals(rows)
    for joint, a, b in ((0, parts.a.shoulder, parts.b.shoulder), (3, parts.a.roll, parts.b.roll)):
        assert a == pytest.approx(look.joints[joint][0, rows], abs=1e-9)
        assert b == pytest.approx(look.joints[joint][0, rows + 1], abs=1e-9)
    assert parts.bound[:, ROLL_MIN] == pytest.approx(look.bounds[ROLL_MIN][0, rows], abs=0)
    assert (parts.segment.tolist(), parts.s0.tolist(), parts.s1.tolist()) == (
        rows.tolist(),
        [0.0] * 3,
        [1.0] * 3,
    )


def test_what_is_found_is_attained_where_it_is_said_to_be():
    """And is the least of all poses, for distances and angles."""
    found_ends = 0
    for found in several(6, 25, parts=(1, 4)):
        path = looked(found)
        columns = (
            list(range(SPEED))
            if not path.geometry.workspace.full_revolution
            else [*range(LEFT), *range(ROLL_MIN, SPEED)]
        )
        best, truth = Minima(), Truth(found, path)
        try:
            Looks(path, scope(columns), aims(gap=1e-6), best, None)
        except TouchesError:  # pragma: no cover -- none of these
            continue
        segment, s = best.segment[columns], best.fraction[columns]
        assert ((s >= 0.0) & (s <= 1.0)).all()
        poses = np.arange(len(segment) + len(path) + 1)
        x = truth.dense.at(
            np.append(segment, np.minimum(poses[: len(path) + 1], len(path) - 1)),
            np.append(s, (poses[: len(path) + 1] == len(path)).astype(float)),
        )
        values = truth.values(x)[:, columns]
        there = values[np.arange(len(columns)), np.arange(len(columns))]
        assert best.value[columns] == pytest.approx(there, abs=1e-6)
        assert (best.value[columns] <= values[len(columns) :].min(axis=0) + 1e-6).all()
        found_ends += int((s == 1.0).sum())
    assert found_ends > 5


def test_what_is_proved_is_less_than_what_is_found_and_close_to_it():
    for found in several(5, 25, parts=(1, 4)):
        geometry, segments = canonical(found)
        path = FirstLook.of(geometry, segments, accelerations=found.acceleration is not None)
        wanted = scope(list(range(ROLL_MIN, Q0_MAX + 1)))
        done = bisection.survey(geometry, segments, path, wanted, aims(gap=1e-6))
        truth = Truth(found, path)
        q0 = np.radians(truth.dense.minima()[[12, 11] if truth.left else [11, 12]])
        turn = float(truth.turns[0])
        assert (done.certified[ROLL_MIN : Q0_MAX + 1] <= done.attained[ROLL_MIN : Q0_MAX + 1]).all()
        assert done.certified[[Q0_MIN, Q0_MAX]] == pytest.approx(q0 + np.array([turn, -turn]), abs=3e-6)


def test_a_look_that_is_not_found_again_proves_nothing(monkeypatch):
    """Of several blocks each is made anew, which cannot fail; if it did, no bound would be missing unnoticed."""
    monkeypatch.setattr(first_look, "BLOCK", 8)
    path = looked(refined(stroke(), 20))
    assert len(list(path.all())) == 3
    monkeypatch.setattr(first_look, "_looked", lambda *_, **__: None)
    with pytest.raises(TouchesError):
        list(path.all())
    with pytest.raises(TouchesError):
        Looks(path, scope([ROLL_MIN]), aims(), Minima(), None)


# -- the least value found -----------------------------------------------------------------------------


def test_the_least_value_is_kept_with_its_place():
    best = Minima()
    assert (best.value == np.inf).all()
    best.offer(2, np.zeros((0, 3)), np.zeros(0, dtype=np.int64), np.zeros(0))
    assert (best.value == np.inf).all()
    best.offer(2, np.array([[3.0, 5.0], [4.0, 1.0]]), np.array([7, 9]), np.array([0.25, 0.75]))
    assert best.value[1:5].tolist() == [np.inf, 3.0, 1.0, np.inf]
    assert best.segment[2:4].tolist() == [7, 9]
    assert best.fraction[2:4].tolist() == [0.25, 0.75]
    best.offer(2, np.array([[3.0, 0.5]]), np.array([1]), np.array([0.5]))
    assert (best.segment[2], best.segment[3]) == (7, 1)
    best.one(3, 0.5, 4, 0.1)
    assert best.segment[3] == 1
    best.one(3, 0.4, 4, 0.1)
    assert (best.value[3], best.segment[3], best.fraction[3]) == (0.4, 4, 0.1)


@pytest.mark.parametrize(
    ("best", "target", "needed"),
    [
        (2.0, -np.inf, 2.0 - 0.1),  # the gap alone
        (-20.0, -30.0, -20.0 - 0.4),  # a share of what is kept
        (-20.0, -20.0, -20.0 - 0.4),
        (-20.0, -10.0, -20.0 - 5.0),  # more of what is not
        (np.inf, 0.0, np.inf),  # nothing found
    ],
)
def test_how_close_is_enough(best, target, needed):
    found = aims(gap=0.1, share=0.02, missed=0.25, target=target).enough(np.full(COLUMNS, best))
    assert found == pytest.approx(np.full(COLUMNS, needed))


def test_a_turn_in_no_time_has_no_speed_that_a_look_could_bound():
    """No problem has one (`defects`); a look does not rely on that."""
    path = problem(
        *wrist_path([[500.0, 0.0, 100.0]] * 2, axis([0.9, 1.0], [0.3, 0.3]), 0.0), tool_length_mm=0.0
    )
    assert looked(path) is None
    assert looked(replace(path, tool_length_mm=1.0)) is not None


def test_pieces_whose_joints_cannot_be_followed_are_not_looked_at():
    geometry, segments = canonical(stroke(pitch=(0.0, 0.0)))
    pieces = Pieces.whole(segments, slice(0, len(segments)), (np.zeros((1, 1)), np.zeros((1, 1))))
    assert first_look._looked(geometry, segments, pieces, accelerations=False) is None
