"""What happens between samples: closed-form places where a path misses its deadband by a millionth.

Sampling inverse kinematics every 0.05 mm finds the deadband kept and would admit; the gate must refuse,
and must admit the same path with a millionth to spare.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from cutgate.runtime.verification import certified
from cutgate.runtime.verification.problem import Arm, ArmCalibration, Deadband
from tests.oracle.dense import COLUMNS, Dense
from tests.runtime.verification.cases import DEG, WIDE, axis, mirrored, problem, turned, wrist_path

STEP_MM = 0.05
LITTLE = 1e-6
LEVEL = axis(90 * DEG, 0.0)
FREE = {
    "lower": np.array([-WIDE, 0.0, -1e4, -WIDE, 0.0]),
    "upper": np.array([WIDE, math.pi, 1e4, WIDE, math.pi]),
    "speed": np.full(5, 1e12),
}

margin = pytest.mark.parametrize("margin", [LITTLE, -LITTLE])
symmetries = pytest.mark.parametrize("elbow", ["right", "left"])


def limited(**limits):
    lower, upper = FREE["lower"].copy(), FREE["upper"].copy()
    for name, (low, high) in limits.items():
        lower[int(name[1])], upper[int(name[1])] = low, high
    return {"lower": lower, "upper": upper, "speed": FREE["speed"]}


def sampled(path):
    """Least margins at samples of a path of one segment at most 0.05 mm apart, whose middle lies between two."""
    dense = Dense(path, 2)
    length = max(np.linalg.norm(np.diff(path.tips_mm, axis=0)), path.tool_length_mm * dense.turn[0])
    samples = 2 * math.ceil((length / STEP_MM + 1) / 2)  # an even number: none in the middle
    x = dense.at(np.zeros(samples, dtype=int), np.linspace(0.0, 1.0, samples))
    assert x.inside.all()
    return dict(
        zip(COLUMNS[:9], dense.columns(x, x.q[:, 0], x.q[:, 3]).min(axis=0).tolist()[:9], strict=True)
    )


def check(path, name, deadband, margin, elbow):
    """The samples keep the deadband; the gate decides by the sign of what is really to spare."""
    swap = {"left": "right", "right": "left"}
    if elbow == "left":
        path, name = mirrored(path), swap.get(name, name)
    path = turned(path, 0.7)
    assert sampled(path)[name] >= deadband, "the samples do not admit, the case is too coarse"
    verdict = certified.verify(path)
    found = verdict.boundaries[name]
    assert found.violated is (margin < 0)
    assert found.certified <= deadband + margin + 1e-9
    assert deadband + margin - 1e-9 <= found.clearance <= found.certified + 0.01
    if margin < 0:
        assert found.clearance == pytest.approx(deadband + margin, abs=2e-8)
    return verdict


@symmetries
@margin
def test_a_straight_segment_that_passes_the_inner_circle(elbow, margin):
    """Radius 105, foot of the column half a step from the samples: 0.025^2 / (2 * 110) = 2.8e-6 mm are missed."""
    y = 105.0 + 5.0 + margin
    tips, axes = wrist_path([[-20.0, y, 0.0], [20.0, y, 0.0]], LEVEL)
    path = problem(tips, axes, arm=Arm(500.0, 395.0, "right"), **FREE)
    assert check(path, "inner", 5.0, margin, elbow).admissible is (margin > 0)


@symmetries
@margin
@pytest.mark.parametrize(("name", "q0_deg", "q1_deg"), [("left", 40.0, 17.0), ("right", -40.0, 150.0)])
def test_a_straight_segment_that_passes_the_end_of_a_side(elbow, margin, name, q0_deg, q1_deg):
    """Half a step from the foot 0.025^2 / (2 * 5) = 6e-5 mm are missed.

    Seen from within the nearest of all boundaries is never a corner, whose angle is under 180 deg: the circle
    through it is nearer and refuses as well. The side must be right in the report all the same.
    """
    q0, q1 = q0_deg * DEG, q1_deg * DEG
    forearm = 500 * np.array([math.cos(q0 + q1), math.sin(q0 + q1)])
    corner = 500 * np.array([math.cos(q0), math.sin(q0)]) + forearm
    into_the_arc = np.array([-forearm[1], forearm[0]]) / 500 * (1.0 if q1_deg < 90 else -1.0)
    inward = np.array([corner[1], -corner[0]]) / np.linalg.norm(corner) * (1.0 if name == "left" else -1.0)
    off = inward - (inward @ into_the_arc) * into_the_arc
    tilted = 7 * DEG
    toward = math.cos(tilted) * off / np.linalg.norm(off) - math.sin(tilted) * into_the_arc
    beside = np.array([-toward[1], toward[0]])
    foot = corner + (5.0 + margin) * toward
    centres = np.hstack((np.array([foot - 0.2 * beside, foot + 0.2 * beside]), np.zeros((2, 1))))
    tips, axes = wrist_path(centres, LEVEL)
    arc = limited(q0=(-40 * DEG, 40 * DEG), q1=(17 * DEG, 150 * DEG))
    check(problem(tips, axes, arm=Arm(500.0, 500.0, "right"), **arc), name, 5.0, margin, elbow)


@symmetries
@pytest.mark.parametrize("margin", [LITTLE, -0.9e-6])
def test_a_leaning_slide_stretches_what_the_turning_axis_does(elbow, margin):
    """The axis dips and rises in the plane x, z: seen along the slide, x bulges by l sqrt(1 + 0.02^2) (1 - cos phi).

    Tool 300, phi = +-0.00683: 0.0070014 mm with the stretch of 1.0002, 1.4e-6 mm less without it; half a step
    misses 300 * (0.025 / 300)^2 / 2 = 1.04e-6 mm.
    """
    lean, tool, half = 0.02, 300.0, 0.00683
    dip = math.pi / 2 + math.atan(lean)
    axes = axis(np.array([dip - half, dip + half]), 0.0)
    crest = tool * math.hypot(1.0, lean)
    path = problem(
        [[900.0 - 5.0 - margin - crest, 0.0, 0.0]] * 2,
        axes,
        tool_length_mm=tool,
        calibration=ArmCalibration(slide_tilt=np.array([lean, 0.0])),
        **limited(q0=(-3.0, 3.0), q1=(0.0, 2.5)),
    )
    assert check(path, "outer", 5.0, margin, elbow).admissible is (margin > 0)


@symmetries
@margin
def test_the_height_between_two_poses_while_the_axis_turns(elbow, margin):
    """Tip at rest, tool 160: z = 160 cos q4 is greatest in the middle, at q4 = 20 deg.

    Half a step turns the axis by 0.025 / 160 rad: 160 cos 20 deg * (0.025 / 160)^2 / 2 = 1.8e-6 mm are missed.
    """
    top = 160 * math.cos(20 * DEG) + 5.0 + margin
    path = problem(
        [[450.0, 0.0, 0.0]] * 2, over_the_crest(20.0, 40.0), **limited(q0=(-3.0, 3.0), q2=(-1e3, top))
    )
    assert check(path, "top", 5.0, margin, elbow).admissible is (margin > 0)


@symmetries
@margin
@pytest.mark.parametrize("name", ["pitch_min", "pitch_max"])
def test_the_pitch_inside_a_great_circle(elbow, margin, name):
    """Least (or, pointing down, largest) pitch in the middle, 10 deg from the vertical.

    Half a step away the pitch differs by (0.025 / 160)^2 / (2 tan 10 deg) = 6.9e-8 rad = 4e-6 deg, which are missed.
    """
    up = name == "pitch_min"
    axes = over_the_crest(10.0, 40.0) * (1.0, 1.0, 1.0 if up else -1.0)
    limit = (8.0 - margin) * DEG
    pitch = (limit, math.pi) if up else (0.0, math.pi - limit)
    path = problem([[450.0, 0.0, 0.0]] * 2, axes, **limited(q0=(-3.0, 3.0), q4=pitch))
    verdict = check(path, name, 2.0, margin, elbow)
    assert verdict.admissible is (margin > 0)


def over_the_crest(pitch_deg, half_deg):
    """Two axes whose great circle comes nearest to the vertical, by this pitch, in its middle."""
    crest, half = pitch_deg * DEG, half_deg * DEG
    nearest, beside = np.array([0.0, math.sin(crest), math.cos(crest)]), np.array([1.0, 0.0, 0.0])
    return np.array([math.cos(half) * nearest + sign * math.sin(half) * beside for sign in (-1.0, 1.0)])


@symmetries
@pytest.mark.parametrize("gap_deg", [2e-3, 2e-6])
def test_a_roll_that_crosses_its_gap(elbow, gap_deg):
    """The axis turns by 100 deg level, the wrist on a circle: the roll changes by 0.018 deg a step, past the gap.

    Each sample's roll, wrapped, lies within its limits, farther than the deadband from both.
    """
    axes = axis(90 * DEG, np.array([-50.0, 50.0]) * DEG)
    free = problem(
        [[450.0, 0.0, 0.0]] * 2, axes, deadband=Deadband(5.0, 1e-8 * DEG), **limited(q0=(-3.0, 3.0))
    )
    dense = Dense(free, 2)
    x = dense.at(np.zeros(6000, dtype=int), np.linspace(0.0, 1.0, 6000))
    middle = (x.q[3000, 3] + x.q[3001, 3]) / 2
    half = gap_deg / 2 * DEG
    limits = limited(q0=(-3.0, 3.0), q3=(middle + half - 2 * math.pi, middle - half))
    from_low = np.remainder(x.q[:, 3] - limits["lower"][3], 2 * math.pi)
    keep = free.deadband.wrist_rad
    assert (from_low >= keep).all()
    assert (from_low <= limits["upper"][3] - limits["lower"][3] - keep).all()
    path = replace(free, lower=limits["lower"], upper=limits["upper"])
    verdict = certified.verify(turned(path if elbow == "right" else mirrored(path), 0.7))
    assert certified.verify(free).admissible
    assert not verdict.admissible
    assert verdict.branch is None
    assert min(verdict.boundaries[name].clearance for name in ("roll_min", "roll_max")) < -10


@symmetries
def test_a_shoulder_that_crosses_its_gap(elbow):
    """The same behind the robot: q0 passes a gap of 2e-6 deg between two samples."""
    tips, axes = wrist_path([[-700.0, -450.0, 0.0], [-700.0, -250.0, 0.0]], LEVEL)
    free = problem(tips, axes, deadband=Deadband(1e-9, 2 * DEG), **FREE)
    dense = Dense(free, 2)
    x = dense.at(np.zeros(4000, dtype=int), np.linspace(0.0, 1.0, 4000))
    middle, half = (x.q[2000, 0] + x.q[2001, 0]) / 2, 1e-6 * DEG
    limits = limited(q0=(middle + half - 2 * math.pi, middle - half), q1=(10 * DEG, 150 * DEG))
    path = replace(free, lower=limits["lower"], upper=limits["upper"])
    assert sampled(path)["left"] > 1e-4
    verdict = certified.verify(path if elbow == "right" else mirrored(path))
    assert not verdict.admissible
    assert verdict.boundaries["left"].certified < 1e-9
