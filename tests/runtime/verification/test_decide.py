"""The answer alone: the same as the whole verification, and where exactly one look stops being enough.

Each threshold is computed here anew, from the two poses of a path and the rule in the module's head, and found in the
module by bisection: a wrong sign or constant moves it.
"""

import math
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from cutgate.runtime.verification import certified
from cutgate.runtime.verification import decide as module
from cutgate.runtime.verification.decide import decide
from cutgate.runtime.verification.problem import Arm, ArmCalibration, Deadband
from tests.runtime.verification.cases import DEG, axis, limited, mirrored, problem, threshold, wrist_path
from tests.runtime.verification.decided import Compared, share
from tests.seeds import seeds

SAG = math.pi**2 / 32
FAST = np.full(5, 1e9)


# -- where one look stops being enough ------------------------------------------------------------


def wrist_problem(centres, axes, tool=160.0, roll=(-170 * DEG, 170 * DEG), **changes):
    """A problem with fast joints and small deadbands."""
    tips, axes = wrist_path(centres, axes, tool)
    values = {
        "lower": np.array([-80 * DEG, 0.0, 50.0, roll[0], 0.0]),
        "upper": np.array([80 * DEG, 145 * DEG, 450.0, roll[1], 110 * DEG]),
        "speed": FAST,
        "tool_length_mm": tool,
        "deadband": Deadband(1.0, 0.5 * DEG),
    }
    return problem(tips, axes, **(values | changes))


CALIBRATION = ArmCalibration(
    upper_link_error_mm=0.7,
    forearm_link_error_mm=-1.3,
    joint_offset=np.array([0.01, -0.02, 1.5, 0.03, -0.015]),
    slide_tilt=np.array([0.011, -0.017]),
    residual_mm=0.3,
    residual_rad=0.002,
)
DEADBAND = Deadband(1.0, 0.5 * DEG, 0.1, 0.001)


def stroke(q0=0.2, q1=1.1, pitch=(60.0, 63.0), azimuth=(0.4, 0.47), step=(3.0, -2.0, 4.0), **changes):
    """Two poses with everything that may differ from zero: lean, errors, links, offsets, tolerances."""
    x, y = 450.7 * math.cos(q0) + 398.7 * math.cos(q0 + q1), 450.7 * math.sin(q0) + 398.7 * math.sin(q0 + q1)
    first = np.array([x + 250 * 0.011, y - 250 * 0.017, 250.0])
    values = {"arm": Arm(450.0, 400.0, "right"), "calibration": CALIBRATION, "deadband": DEADBAND}
    axes = axis(np.array(pitch) * DEG, q0 + q1 + np.array(azimuth))
    return wrist_problem([first, first + step], axes, **(values | changes))


def beside_a_coarse_stretch(found):
    """The two poses, two rests, and from there two metres at once: the path is never looked at as a whole."""
    (p, q), (u, v) = found.tips_mm, found.axes
    far = q + np.array([2000.0, 0.0, 0.0])
    return replace(found, tips_mm=np.array([p, q, q, q, far]), axes=np.array([u, v, v, v, v]))


@pytest.fixture
def closed(monkeypatch):
    """Whether one look is enough for the segment of a problem of two poses, looked at as a whole or pose by pose."""
    refused = SimpleNamespace(admissible=False, branch=None)
    monkeypatch.setattr(module.certified, "verify", lambda _: refused)
    keeps = module._Look.keeps

    def whole(look, over):
        return keeps(look, over) if over is module._Whole else np.zeros(len(look.tips), dtype=bool)

    def ask(found, way):
        monkeypatch.setattr(module._Look, "keeps", whole if way == "whole" else keeps)
        if way == "whole":
            return decide(found).open_segments == 0
        opened = decide(beside_a_coarse_stretch(found)).open_segments
        assert opened in {3, 4}, opened
        return opened == 3

    return ask


@dataclass
class Around:
    """What the rules compare, of one pose (each) or of the worse of two (whole), right elbow."""

    nearest: float
    farthest: float
    bend: float
    level: float
    slack: float
    planar: float
    upward: float
    turning: float


@dataclass
class Reference:
    """The numbers of a problem of two poses, from the documentation's formulas."""

    found: object

    def __post_init__(self):
        p, c, d = self.found, self.found.calibration, self.found.deadband
        self.tool, self.stretch = p.tool_length_mm, math.sqrt(1 + c.slide_tilt @ c.slide_tilt)
        self.a0, self.a1 = p.arm.upper_mm + c.upper_link_error_mm, p.arm.forearm_mm + c.forearm_link_error_mm
        self.lower, self.upper = p.lower + c.joint_offset, p.upper + c.joint_offset
        self.error_mm = (c.residual_mm + d.path_tolerance_mm) * self.stretch
        self.error_rad = c.residual_rad + d.path_tolerance_rad
        self.arm, self.wrist = d.arm_mm + self.error_mm, d.wrist_rad + self.error_rad
        self.w = p.tips_mm + self.tool * p.axes
        self.c = self.w[:, :2] - self.w[:, 2:] * c.slide_tilt
        self.r, self.z, self.up = np.hypot(*self.c.T), self.w[:, 2], p.axes[:, 2]
        self.du, self.chord = (np.linalg.norm(x[1] - x[0]) for x in (p.axes, self.w))
        self.lean = SAG * self.du**2
        self.sag = self.stretch * self.tool * self.lean
        self.reach = self.stretch * self.chord / 2 + self.sag
        self.sine = np.hypot(*p.axes[:, :2].T)
        q1 = np.arccos((self.r**2 - self.a0**2 - self.a1**2) / (2 * self.a0 * self.a1))
        q0 = np.arctan2(self.c[:, 1], self.c[:, 0]) - np.arctan2(
            self.a1 * np.sin(q1), self.a0 + self.a1 * np.cos(q1)
        )
        self.roll = np.arctan2(p.axes[:, 1], p.axes[:, 0]) - q0 - q1

    def elbow_sine(self, r):
        return math.sqrt(1 - ((r * r - self.a0**2 - self.a1**2) / (2 * self.a0 * self.a1)) ** 2)

    def around(self, way):
        """Of the whole, or of each of the two."""
        if way == "whole":
            return [self._around(self.r.min(), self.r.max(), self.sine.min(), self._whole())]
        return [self._around(r, r, s, self._each()) for r, s in zip(self.r, self.sine, strict=True)]

    def _around(self, least, most, sine, motion):
        nearest, farthest = least - self.reach, most + self.reach
        bend = min(self.elbow_sine(nearest - self.error_mm), self.elbow_sine(farthest + self.error_mm))
        level = sine - math.pi / 4 * self.du
        azimuth = math.sin(self.error_rad) / level
        slack = (3 * self.reach + self.error_mm) / (self.a1 * bend)
        slack += azimuth / math.sqrt(1 - azimuth**2) - self.error_rad
        return Around(nearest, farthest, bend, level, slack, *motion)

    def _whole(self):
        feed = self.found.feed_mm_s
        return 2 * self.stretch * feed, 2 * feed, feed / self.tool

    def _each(self):
        tips = np.linalg.norm(self.found.tips_mm[1] - self.found.tips_mm[0])
        seconds = max(tips, self.tool * self.du) / self.found.feed_mm_s
        bulge = math.pi**2 / 8 * self.tool * self.du**2
        turning = min(math.pi / 2 * self.du / seconds, self.found.feed_mm_s / self.tool)
        planar, upward = self.stretch * (self.chord + bulge), abs(self.z[1] - self.z[0]) + bulge
        return planar / seconds, upward / seconds, turning

    def rates(self, way):
        """Bounds on the five speeds and the five accelerations."""
        return np.max([self._rates(x) for x in self.around(way)], axis=0)

    def _rates(self, x):
        a0, a1 = self.a0, self.a1
        q0, heading = x.planar / (a0 * x.bend), x.planar / (a1 * x.bend)
        q1 = min(q0 + heading, x.farthest * x.planar / (a0 * a1 * x.bend))
        pull, azimuth = self.stretch * self.tool * x.turning**2, x.turning / x.level
        pulled = pull + a0 * q0**2 + a1 * heading**2
        q0_2, heading_2 = pulled / (a0 * x.bend), pulled / (a1 * x.bend)
        other = (x.planar**2 + x.farthest * pull + a0 * a1 * q1**2) / (a0 * a1 * x.bend)
        speeds = (q0, q1, x.upward, azimuth + heading, x.turning)
        accelerations = (
            q0_2,
            min(q0_2 + heading_2, other),
            self.tool * x.turning**2,
            2 * azimuth**2 + heading_2,
            x.turning**2 / x.level,
        )
        return speeds + accelerations


both_ways = pytest.mark.parametrize("way", ["whole", "each"])
both_elbows = pytest.mark.parametrize("elbow", ["right", "left"])


def as_elbow(found, elbow):
    return found if elbow == "right" else mirrored(found)


def arm_mm(found, x):
    return replace(found, deadband=replace(found.deadband, arm_mm=x))


INNER = limited(stroke(), lower1=0.0, upper1=1.3)
OUTER = limited(stroke(q1=1.0), lower1=0.8)
LEFT = limited(stroke(), upper0=0.35)
RIGHT = limited(stroke(), lower0=0.05)


def radius(x, elbow):
    return math.sqrt(x.a0**2 + x.a1**2 + 2 * x.a0 * x.a1 * math.cos(elbow))


def about(x, q0):
    """Distance of both wrist centres from the elbow at a limit of the shoulder."""
    return np.hypot(*(x.c - x.a0 * np.array([math.cos(q0), math.sin(q0)])).T)


def across(x, q0):
    """How far left of the upper link there."""
    return math.cos(q0) * x.c[:, 1] - math.sin(q0) * x.c[:, 0]


ARM_RULES = {
    "inner": (INNER, lambda x: x.r.min() - x.reach - radius(x, x.upper[1])),
    "outer": (OUTER, lambda x: radius(x, x.lower[1]) - x.r.max() - x.reach),
    "left": (LEFT, lambda x: x.a1 - about(x, x.upper[0]).max() - x.reach),
    "right": (RIGHT, lambda x: about(x, x.lower[0]).min() - x.a1 - x.reach),
}


@both_ways
@both_elbows
@pytest.mark.parametrize("rule", ARM_RULES)
def test_arm(closed, rule, elbow, way):
    found, room = ARM_RULES[rule]
    x = Reference(found)
    expected = room(x) - x.error_mm
    at = threshold(lambda mm: closed(arm_mm(as_elbow(found, elbow), mm), way), 1.0, 60.0)
    assert at == pytest.approx(expected, rel=1e-9)


@both_ways
@pytest.mark.parametrize("lean", [(0.3, 0.0), (0.0, -0.3)])
def test_a_slide_that_leans_one_way(closed, lean, way):
    found = replace(INNER, calibration=replace(CALIBRATION, slide_tilt=np.array(lean)))
    centre = Reference(found).c - Reference(INNER).c
    moved = found.tips_mm - np.append(centre.mean(axis=0), 0.0)
    found = replace(found, tips_mm=moved)
    x = Reference(found)
    at = threshold(lambda mm: closed(arm_mm(found, mm), way), 1.0, 60.0)
    assert at == pytest.approx(ARM_RULES["inner"][1](x) - x.error_mm, rel=1e-9)


LINES = {"upper0": (-3.31, 1.2, 1.2), "lower0": (-2.5, 2.5, -2.5)}
"""Limits of the shoulder, and that of them whose arc is meant."""


@both_ways
@both_elbows
@pytest.mark.parametrize("end", LINES)
def test_the_line_of_a_side_arc(closed, end, elbow, way):
    """An elbow that folds: the arc ends on the line of its upper link. On its circle's other side the distance to that counts."""
    low, high, q0 = LINES[end]
    x, y = 450 * math.cos(q0) - 450 * math.cos(q0 + 0.4), 450 * math.sin(q0) - 450 * math.sin(q0 + 0.4)
    found = wrist_problem(
        [[x, y, 250], [x + 0.3, y + 0.2, 250]],
        axis(1.2, math.atan2(y, x) + 1.4),
        lower=np.array([low, 0.5, -1e4, -2.9, 0.0]),
        upper=np.array([high, math.pi, 1e4, 2.9, math.pi]),
    )
    expected = -across(Reference(found), q0).max() - Reference(found).reach
    at = threshold(lambda mm: closed(arm_mm(as_elbow(found, elbow), mm), way), 0.01, 300.0)
    assert at == pytest.approx(expected, rel=1e-9)


SLIDE = {
    "upper2": lambda x: x.z.max() + x.sag + x.arm - CALIBRATION.joint_offset[2],
    "lower2": lambda x: x.z.min() - x.sag - x.arm - CALIBRATION.joint_offset[2],
}


@both_ways
@both_elbows
@pytest.mark.parametrize("end", SLIDE)
def test_slide(closed, end, elbow, way):
    found = stroke()
    good, bad = (450.0, 200.0) if end == "upper2" else (50.0, 300.0)
    at = threshold(lambda mm: closed(as_elbow(limited(found, **{end: mm}), elbow), way), good, bad)
    assert at == pytest.approx(SLIDE[end](Reference(found)), rel=1e-9)


UNIT = 8e-12
PITCH = {
    "pitch_max": ("upper4", 1.9, 1.0, lambda x: math.acos(x.up.min() - x.lean - UNIT) + x.wrist),
    "pitch_min": ("lower4", 0.1, 1.2, lambda x: math.acos(x.up.max() + x.lean + UNIT) - x.wrist),
}


@both_ways
@both_elbows
@pytest.mark.parametrize("rule", PITCH)
def test_pitch(closed, rule, elbow, way):
    end, good, bad, expected = PITCH[rule]
    found = stroke()
    at = threshold(lambda rad: closed(as_elbow(limited(found, **{end: rad}), elbow), way), good, bad)
    assert at == pytest.approx(expected(Reference(found)) - CALIBRATION.joint_offset[4], rel=1e-9)


@both_ways
@pytest.mark.parametrize("pitch", [(30.0, 32.0), (150.0, 148.0)])
def test_singularity(closed, pitch, way):
    found = limited(stroke(pitch=pitch, azimuth=(0.01, 0.02)), lower4=-1.0, upper4=4.0)

    def kept(rad):
        return closed(replace(found, deadband=replace(DEADBAND, wrist_rad=rad)), way)

    x = Reference(found)
    nearest = np.arccos(np.abs(x.up).max() + x.lean + UNIT)
    assert threshold(kept, 0.1, 0.8) == pytest.approx(nearest - x.error_rad, rel=1e-9)


def roll_room(found, way):
    """By how much the worst pose's roll is nearer to the middle than it has to be, as the cosine is bounded."""
    x = Reference(found)
    half, middle = (x.upper[3] - x.lower[3]) / 2 - x.wrist, (x.upper[3] + x.lower[3]) / 2
    slack = max(each.slack for each in x.around(way))
    bound = math.cos(half) + slack * math.sin(half) + slack**2 / 2
    return min(math.cos(roll - middle) for roll in x.roll) - bound


@both_ways
@both_elbows
@pytest.mark.parametrize(
    ("end", "other", "good", "bad"),
    [
        ("upper3", -2.9, 2.9, 0.2),  # the middle off zero, more and more
        ("lower3", 2.9, -2.9, 0.6),
        ("upper3", -0.4, 1.5, 0.2),
        ("lower3", 1.2, -1.0, 0.6),
    ],
)
def test_roll(closed, end, other, good, bad, elbow, way):
    found = limited(stroke(), lower3=other, upper3=other)
    at = threshold(lambda rad: closed(as_elbow(limited(found, **{end: rad}), elbow), way), good, bad)
    expected = threshold(lambda rad: roll_room(limited(found, **{end: rad}), way) >= 0, good, bad)
    assert at == pytest.approx(expected, rel=1e-9)


@both_ways
def test_roll_about_zero(closed, way):
    found = stroke(calibration=replace(CALIBRATION, joint_offset=np.zeros(5)))

    def about_zero(rad):
        return limited(found, lower3=-rad, upper3=rad)

    at = threshold(lambda rad: closed(about_zero(rad), way), 2.9, 0.2)
    expected = threshold(lambda rad: roll_room(about_zero(rad), way) >= 0, 2.9, 0.2)
    assert at == pytest.approx(expected, rel=1e-9)


@both_ways
def test_what_the_limits_of_the_roll_leave_out(closed, way):
    """An azimuth that turns as far as that may cross it."""
    found = stroke(step=(0.0, 0.0, 0.0), pitch=(80.0, 80.0), azimuth=(-0.2, 0.2))
    x = Reference(found)

    def about_zero(rad):
        return limited(found, lower3=-rad - 0.03, upper3=rad - 0.03)

    level = min(each.level for each in x.around(way))
    expected = math.pi - math.pi / 4 * x.du / level + x.wrist
    assert expected < math.pi
    at = threshold(lambda rad: closed(about_zero(rad), way), 2.0, math.pi - 1e-9)
    assert at == pytest.approx(expected, rel=1e-9)


STROKES = {
    "bent": stroke(),
    "near the column": stroke(q1=2.3),
    "turning little": stroke(pitch=(60.0, 60.1), azimuth=(0.4, 0.402), step=(6.0, -4.0, 8.0)),
    "wrist at rest": stroke(pitch=(60.0, 66.0), step=(0.0, 0.0, 0.0)),
}


@both_ways
@both_elbows
@pytest.mark.parametrize("path", STROKES)
@pytest.mark.parametrize("joint", range(5))
def test_speed(closed, joint, path, elbow, way):
    found = STROKES[path]

    def kept(limit):
        speed = FAST.copy()
        speed[joint] = limit
        return closed(as_elbow(replace(found, speed=speed), elbow), way)

    assert threshold(kept, 1e3, 0.0) == pytest.approx(Reference(found).rates(way)[joint], rel=1e-8)


@both_ways
@pytest.mark.parametrize("path", STROKES)
@pytest.mark.parametrize("joint", range(5))
def test_acceleration(closed, joint, path, way):
    found = STROKES[path]

    def kept(limit):
        acceleration = FAST.copy()
        acceleration[joint] = limit
        return closed(replace(found, acceleration=acceleration), way)

    assert threshold(kept, 1e3, 0.0) == pytest.approx(Reference(found).rates(way)[5 + joint], rel=1e-8)


@both_ways
@pytest.mark.parametrize("sign", [1, -1])
def test_unit_length(closed, sign, way):
    found = stroke()

    def kept(x):
        return closed(replace(found, axes=found.axes * math.sqrt(1 + sign * x)), way)

    assert threshold(kept, 0.0, 1e-9) == pytest.approx(1e-12, abs=2e-15)


def plain(centres, axes, **changes):
    """Without calibration or tolerances, the wrist centre's y exact."""
    return wrist_problem(centres, axes, deadband=Deadband(1e-5, 1e-4), **changes)


@both_ways
def test_barely_moving(closed, way):
    level = axis(math.pi / 2, 0.0)

    def kept(mm):
        return closed(plain([[600, 0, 250], [600, mm, 250]], level), way)

    assert kept(0.0)
    assert threshold(kept, 1e-3, 1e-9) == pytest.approx(1e-6, rel=1e-9)


@both_ways
def test_barely_turning(closed, way):
    def kept(mm):
        azimuth = np.array([0.0, 2 * math.asin(mm / 160 / 2)])
        return closed(plain([[600, 0, 250]] * 2, axis(math.pi / 2, azimuth)), way)

    assert threshold(kept, 1e-3, 1e-9) == pytest.approx(1e-6, rel=1e-4)  # the wrist centre rounds as much


@both_ways
@pytest.mark.parametrize("forearm", [450.0, 400.0])
@pytest.mark.parametrize("folded", [False, True])
def test_elbow_sine(closed, folded, forearm, way):
    """The difference from the straight or the folded arm at which sin q1 is 0.001 but for its rounding."""
    circle = abs(450.0 - forearm) if folded else 450.0 + forearm
    sign = 1 if folded else -1

    def at(mm):
        x = circle + sign * mm
        return plain(
            [[x * math.cos(0.5), x * math.sin(0.5), 250.0]] * 2,
            axis(math.pi / 2, 0.5 + math.pi * (folded and forearm < 450.0)),
            arm=Arm(450.0, forearm, "right"),
            lower=np.array([-3.0, 0.0, 50.0, -3.1, 0.0]),
            upper=np.array([3.0, math.pi, 450.0, 3.1, math.pi]),
        )

    links = 450.0 / forearm + forearm / 450.0
    sine2 = 1e-6 + 256 * np.finfo(float).eps * (links + 1)
    cosine = math.sqrt(1 - sine2)
    expected = sign * (math.sqrt(450.0**2 + forearm**2 - sign * 2 * 450.0 * forearm * cosine) - circle)
    assert threshold(lambda mm: closed(at(mm), way), 5.0, 2e-5) == pytest.approx(expected, rel=1e-5)


@both_ways
def test_level_sine(closed, way):
    """No turn, no errors: the pitch at which sin q4 is 0.001."""

    def at(pitch):
        return plain([[600, 0, 250]] * 2, axis(pitch, 0.0))

    assert threshold(lambda rad: closed(at(rad), way), 0.1, 2e-4) == pytest.approx(math.asin(1e-3), rel=1e-9)


def test_a_roll_that_leaves_its_limits_at_one_end_and_returns_at_the_other():
    """From 160 to 200 deg within one segment: at both of its poses it points within +-179.9 deg."""
    q0, q1 = -0.5, 1.0
    centre = [450 * np.cos(q0) + 450 * np.cos(q0 + q1), 450 * np.sin(q0) + 450 * np.sin(q0 + q1), 250.0]
    axes = axis(math.pi / 2 - 0.2, q0 + q1 + np.array([160, -160]) * DEG)
    across = wrist_problem([centre, centre], axes, tool=1.0, roll=(-179.9 * DEG, 179.9 * DEG))
    assert not certified.verify(across).admissible
    assert decide(across) == (False, None, 1)


# -- what is left to the whole verification -------------------------------------------------------


@pytest.fixture
def verified(monkeypatch):
    """The problems given to the whole verification, which admits all of them."""
    given = []

    def admit(found):
        given.append(found)
        return SimpleNamespace(admissible=True, branch=SimpleNamespace(q0_turns=7, roll_turns=8))

    monkeypatch.setattr(module.certified, "verify", admit)
    return given


def spoilt(name, value, place=0):
    """The stroke with one number of an array replaced."""
    found = replace(stroke(), acceleration=FAST)
    owner = found.calibration if name in {"joint_offset", "slide_tilt"} else found
    array = getattr(owner, name).copy()
    array.flat[place] = value
    if owner is found:
        return replace(found, **{name: array})
    return replace(found, calibration=replace(found.calibration, **{name: array}))


def shaped(name, shape):
    """The stroke with an array of another shape."""
    found = stroke()
    if name in {"joint_offset", "slide_tilt"}:
        return replace(found, calibration=replace(found.calibration, **{name: np.zeros(shape)}))
    return replace(found, **{name: np.ones(shape)})


def at_the_turn(little):
    """The first roll so far from where its turn changes."""
    centre = [450 * math.cos(0.2) + 450 * math.cos(1.3), 450 * math.sin(0.2) + 450 * math.sin(1.3), 250.0]
    axes = axis(1.2, 1.3 + math.pi + little)
    return wrist_problem([centre] * 2, axes, roll=(0.5, 5.5))


LEFT_TO_THE_WHOLE = {
    "one pose": replace(stroke(), tips_mm=stroke().tips_mm[:1], axes=stroke().axes[:1]),
    "tips of two numbers": shaped("tips_mm", (2, 2)),
    "fewer axes": shaped("axes", (1, 3)),
    "four lower limits": shaped("lower", (4,)),
    "four upper limits": shaped("upper", (4,)),
    "four speeds": shaped("speed", (4,)),
    "four accelerations": shaped("acceleration", (4,)),
    "four offsets": shaped("joint_offset", (4,)),
    "three leans": shaped("slide_tilt", (3,)),
    "no feed": replace(stroke(), feed_mm_s=0.0),
    "a tool of no length": replace(stroke(), tool_length_mm=0.0),
    "a shoulder of a revolution": limited(stroke(), lower0=-math.pi, upper0=math.pi),
    "a roll of a revolution": limited(stroke(), lower3=-math.pi, upper3=math.pi),
    "a roll of less than its deadband": limited(stroke(), lower3=-0.7, upper3=-0.69),
    "a pitch of less than its deadband": limited(stroke(), lower4=1.0, upper4=1.01),
    "elbow limits the wrong way round": limited(stroke(), lower1=1.5, upper1=1.0),
    "a shoulder beyond what is reported": limited(stroke(), lower0=-50.0, upper0=-46.0),
    "a roll beyond what is reported": limited(stroke(), lower3=-50.0, upper3=-46.0),
    "another turn of the shoulder": replace(stroke(), branch=(1, 0)),
    "another turn of the roll": replace(stroke(), branch=(0, -1)),
    "a start out of reach": replace(stroke(), tips_mm=stroke().tips_mm + np.array([500.0, 0.0, 0.0])),
    "a start at the column": replace(
        stroke(), tips_mm=stroke().tips_mm - Reference(stroke()).w[0] * (1, 1, 0)
    ),
    "a start beyond the elbow's limit": limited(stroke(), upper1=0.8),
    "a start before the elbow's limit": limited(stroke(), lower1=1.4),
    "a start beyond the shoulder's limit": limited(stroke(), upper0=0.1),
    "a start before the shoulder's limit": limited(stroke(), lower0=0.4),
    "a start beyond the roll's limit": limited(stroke(), upper3=0.2),
    "a start before the roll's limit": limited(stroke(), lower3=0.9),
    "a start where the roll's turn changes": at_the_turn(1e-10),
    "a start just before the roll's turn changes": at_the_turn(-1e-10),
} | {
    f"{value} in {name}": spoilt(name, value)
    for value in (math.nan, math.inf, -math.inf)
    for name in ("tips_mm", "axes", "lower", "upper", "speed", "acceleration", "joint_offset", "slide_tilt")
}


@pytest.mark.parametrize("name", LEFT_TO_THE_WHOLE)
def test_the_whole_path_is_verified_where_one_look_is_not_meant_for_it(verified, name):
    found = LEFT_TO_THE_WHOLE[name]
    assert decide(found) == (True, (7, 8), len(found.tips_mm) - 1)
    assert len(verified) == 1
    assert verified[0] is found


@pytest.mark.parametrize("name", LEFT_TO_THE_WHOLE)
@pytest.mark.parametrize("elbow", ["right", "left"])
def test_the_answer_is_the_same_there(name, elbow):
    found = LEFT_TO_THE_WHOLE[name]
    shapes = "tips", "fewer", "four", "three"
    if name.startswith(shapes) and elbow == "left":
        return  # there is no mirror image of it
    found = as_elbow(found, elbow)
    verdict = certified.verify(found)
    branch = None if verdict.branch is None else (verdict.branch.q0_turns, verdict.branch.roll_turns)
    assert decide(found)[:2] == (verdict.admissible, branch)


@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("name", ["tips_mm", "axes"])
@pytest.mark.parametrize("place", range(3, 6))
def test_a_pose_that_is_no_number_leaves_all_open(verified, name, value, place):
    """Not the first, of which the joint branch is asked."""
    found = replace(spoilt(name, value, place), acceleration=None)
    assert decide(found) == (True, (0, 0), 1)
    assert [len(piece.tips_mm) for piece in verified] == [2]


def test_a_vertical_tool_is_verified_as_a_whole():
    up = plain([[600, 0, 250], [600, 5, 250]], [[0.0, 0.0, 1.0]], hold_roll=0.3)
    assert decide(up) == (True, (0, 0), 1)
    assert (
        decide(replace(up, hold_roll=7.0)).admissible
        is certified.verify(replace(up, hold_roll=7.0)).admissible
    )
    assert not decide(replace(up, hold_roll=None)).admissible


def test_the_branch_asked_for_is_the_one_that_holds_the_path(verified):
    assert decide(replace(stroke(), branch=(0, 0))) == (True, (0, 0), 0)
    assert verified == []


@pytest.mark.parametrize("joint", [0, 3])
@pytest.mark.parametrize("turns", [-2, 1, 3])
@both_elbows
def test_limits_that_hold_another_revolution(joint, turns, elbow):
    away = 2 * math.pi * turns
    found = limited(
        stroke(),
        **{f"lower{joint}": stroke().lower[joint] + away, f"upper{joint}": stroke().upper[joint] + away},
    )
    branch = [0, 0]
    branch[joint // 3] = turns if elbow == "right" else -turns
    assert decide(as_elbow(found, elbow)) == (True, tuple(branch), 0)


@pytest.mark.parametrize("little", [1e-7, -1e-7])
def test_turns_are_counted_from_half_a_revolution(little):
    assert decide(at_the_turn(little)) == (True, (0, int(little > 0)), 0)


def resting(leaps, poses=80):
    """A wrist that rests but for leaps from side to side over so numbered segments; each opens five."""
    y = 75.0 * (-1.0) ** np.cumsum(np.isin(np.arange(poses) - 1, leaps))
    centres = np.stack((np.full(poses, 600.0), y, np.full(poses, 250.0)), axis=1)
    heading = 0.73 + np.arctan2(y, 600.0)  # of the forearm, nearly
    return wrist_problem(centres, axis(1.2, heading), roll=(-0.3, 0.3))


def pieces(given, whole):
    """First and last segment of each piece that was verified by itself."""
    where = []
    for piece in given:
        first = np.flatnonzero(
            [
                np.array_equal(whole.tips_mm[i : i + len(piece.tips_mm)], piece.tips_mm)
                for i in range(len(whole.tips_mm))
            ]
        )
        where.append((first[0] if len(first) else None, len(piece.tips_mm) - 1))
    return where


@pytest.mark.parametrize(
    ("leaps", "lengths", "opened"),
    [
        ([], [], 0),
        ([20], [5], 5),
        ([0, 40], [3, 5], 8),
        ([78], [3], 3),
        ([20, 33], [18], 10),  # 8 closed ones between them
        ([20, 34], [5, 5], 10),
        ([20, 33, 60], [18, 5], 15),
    ],
)
def test_runs_of_open_segments_are_verified_by_themselves(verified, leaps, lengths, opened):
    found = resting(leaps)
    assert decide(found) == (True, (0, 0), opened)
    assert [len(piece.tips_mm) - 1 for piece in verified] == lengths
    for piece, leap in zip(verified, leaps[:: 1 if len(lengths) == len(leaps) else 2], strict=False):
        first = max(leap - 2, 0)
        assert np.array_equal(piece.tips_mm, found.tips_mm[first : first + len(piece.tips_mm)])
        assert np.array_equal(piece.axes, found.axes[first : first + len(piece.tips_mm)])
        assert piece.branch == (0, 0)


@pytest.mark.parametrize(("runs", "calls"), [(16, 16), (17, 1)])
def test_of_many_runs_the_whole_path_is_verified(verified, runs, calls):
    found = resting([20 * (i + 1) for i in range(runs)], poses=400)
    whole = calls == 1
    assert decide(found) == (True, (7, 8) if whole else (0, 0), 5 * runs)
    assert len(verified) == calls
    assert (verified[0] is found) is whole


def test_a_piece_that_is_refused_is_not_the_last_word(monkeypatch):
    found, given = resting([20, 40, 60]), []

    def refuse(piece):
        given.append(piece)
        return SimpleNamespace(admissible=len(given) != 2, branch=None)

    monkeypatch.setattr(module.certified, "verify", refuse)
    assert decide(found) == (True, None, 15)
    assert [len(piece.tips_mm) for piece in given] == [6, 6, 80]


def test_a_piece_counts_its_turns_from_its_own_first_pose(monkeypatch):
    """The roll goes from 170 to 190 deg, with its limits; the coarse stretch is after that."""
    given, verify = [], certified.verify
    azimuth = 1.3 + np.append(np.linspace(170, 190, 60), [192, 215, 215]) * DEG
    centre = [450 * math.cos(0.2) + 450 * math.cos(1.3), 450 * math.sin(0.2) + 450 * math.sin(1.3), 250.0]
    found = wrist_problem([centre] * 63, axis(1.2, azimuth), roll=(0.5, 215 * DEG + 0.05))
    monkeypatch.setattr(module.certified, "verify", lambda piece: given.append(piece) or verify(piece))
    decided = decide(found)
    assert decided[:2] == (True, (0, 0))
    assert 0 < decided.open_segments < 10
    assert [piece.branch for piece in given] == [(0, 1)]


@pytest.mark.parametrize("block", [1, 7, 64])
def test_blocks_find_the_same(monkeypatch, block):
    """But for where the worst of a pose's neighbours lies in the next block: it counts in its own."""
    monkeypatch.setattr(module.certified, "verify", lambda _: SimpleNamespace(admissible=True, branch=None))
    found = resting([20, 34, 50])
    whole = decide(found)
    monkeypatch.setattr(module, "BLOCK", block)
    parted = decide(found)
    assert parted[:2] == whole[:2]
    assert 3 <= parted.open_segments <= whole.open_segments


def test_a_rest_moves_nothing_and_keeps_nothing_open(closed):
    """Of poses that are equal there is no speed; those that move count alone."""
    found = stroke()
    tips, axes = np.repeat(found.tips_mm, 2, axis=0), np.repeat(found.axes, 2, axis=0)
    assert closed(replace(found, tips_mm=tips, axes=axes), "whole")


# -- the same as the whole verification -----------------------------------------------------------


@pytest.mark.parametrize("seed", seeds(4, 8))
def test_the_answer_and_the_branch_are_those_of_the_whole_verification(seed):
    found = share([20260301, seed], 50, 0.0)
    assert found.wrong == []
    assert found.admitted > 5
    assert found.alone > 0


@pytest.mark.parametrize("seed", seeds(2, 4))
def test_what_one_look_admits_keeps_its_deadbands_by_dense_samples(seed):
    found = Compared()
    while found.sampled < 12:
        found.add(share([20260302, seed, found.problems], 20, 1.0, parts=(30, 60)))
    assert found.wrong == []
