"""Cases a reviewer can check with a pocket calculator: the arithmetic stands beside each.

Each is tried with the right and with the left elbow (its mirror image in the x axis), and with the
whole cell turned about the first joint, limits included: none of that may change the answer.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from cutgate.runtime.verification import certified
from cutgate.runtime.verification.problem import Arm, Deadband
from tests.runtime.verification.cases import DEG, WIDE, axis, mirrored, problem, turned, wrist_path

LEVEL = axis(90 * DEG, 0.0)
FAST = np.full(5, 1e12)
TURNS = (0.0, 75.0, 180.0, -131.0)

everywhere = pytest.mark.parametrize("turn", [f"J1 turned by {turn:g} deg" for turn in TURNS])
both_elbows = pytest.mark.parametrize("elbow", ["right", "left"])


def limits(**joints):
    """Wide limits but for the joints named, in deg or mm."""
    lower, upper = np.array([-WIDE, 0.0, -1e4, -WIDE, 0.0]), np.array([WIDE, math.pi, 1e4, WIDE, math.pi])
    for name, (low, high) in joints.items():
        i, scale = int(name[1]), 1.0 if name == "q2" else DEG
        lower[i], upper[i] = low * scale, high * scale
    return {"lower": lower, "upper": upper, "speed": FAST}


def ask(right, elbow, turn):
    """The verdict on a right-elbow problem or its mirror image, turned about the first joint."""
    asked = turned(right, float(turn.split()[-2]) * DEG)
    return certified.verify(asked if elbow == "right" else mirrored(asked))


def side(name, elbow):
    """A boundary's name in the mirror image."""
    swapped = {"left": "right", "right": "left", "roll_min": "roll_max", "roll_max": "roll_min"}
    return swapped.get(name, name) if elbow == "left" else name


@everywhere
@both_elbows
def test_the_unreachable_wedge_is_refused(elbow, turn):
    """J1 +-60 deg, a0 = a1 = 500, J2 0..150 deg; start at bearing -120 deg, r = 800; deadband 5.

    cos(q1 / 2) = 800 / 1000, so q1 = 73.74 deg: within 0..150. Equal links: the upper link lies q1 / 2 =
    36.87 deg clockwise of the wrist's bearing, so q0 = -120 - 36.87 = -156.87 deg, or 203.13 deg: outside
    +-60 both ways. The printed equations (16)-(21) find D = 200 here, the distance to r = 1000.
    """
    start = 800.0 * np.array([math.cos(-120 * DEG), math.sin(-120 * DEG), 0.0])
    tips, axes = wrist_path([start, np.add(start, (5.0, 0.0, 0.0))], LEVEL)
    verdict = ask(
        problem(tips, axes, arm=Arm(500.0, 500.0, "right"), **limits(q0=(-60, 60), q1=(0, 150))), elbow, turn
    )
    assert not verdict.admissible
    assert verdict.branch is None
    assert "starts outside" in verdict.reasons[0]
    assert min(verdict.boundaries[name].clearance for name in ("inner", "outer", "left", "right")) < -5


@pytest.mark.parametrize("wrist_deadband", [2.0, 0.001])
@everywhere
@both_elbows
def test_an_axis_that_passes_003_deg_from_the_vertical_must_cross_its_roll_gap(elbow, turn, wrist_deadband):
    """The wrist stands at (600, 0), links 450, so q0 + q1 is constant: cos(q1 / 2) = 600 / 900, q0 + q1 = 48.19 deg.

    The axis goes from (-0.4, t, 1) to (0.4, t, 1), t = tan 0.03 deg = 0.000524: its azimuth sweeps clockwise
    from 180 - 0.075 to 0.075 deg (tan 0.075 deg = t / 0.4), so the roll from 131.74 to -48.11 deg, through 0.
    The roll's limits 30..330 deg leave out 0: 131.74 fits, -48.11 is -78.11 short of 30; -48.11 + 360 = 311.89
    fits, 131.74 + 360 = 491.74 is too far. No turn fits both, whatever the wrist's deadband is. The least
    pitch is 0.03 deg: below the deadband of 2 deg, above that of 0.001 deg.
    """
    lean = math.tan(0.03 * DEG)
    ends = np.array([[-0.4, lean, 1.0], [0.4, lean, 1.0]])
    tips, axes = wrist_path([[600.0, 0.0, 0.0]] * 2, ends / np.linalg.norm(ends, axis=1, keepdims=True))
    gap = limits(q0=(-170, 170), q1=(5, 170), q3=(30, 330))
    verdict = ask(problem(tips, axes, deadband=Deadband(1.0, wrist_deadband * DEG), **gap), elbow, turn)
    found = verdict.boundaries
    assert not verdict.admissible
    assert verdict.branch is None
    assert found["wrist_singularity"].clearance == pytest.approx(0.03, abs=1e-9)
    assert found["wrist_singularity"].violated is (wrist_deadband > 0.03)
    if wrist_deadband < 0.03:
        assert found[side("roll_min", elbow)].clearance == pytest.approx(-78.11, abs=0.01)
        assert not any(found[name].violated for name in ("inner", "outer", "left", "right", "top", "bottom"))


@everywhere
@both_elbows
@pytest.mark.parametrize("step", [0.1, 1.0])
def test_a_thin_gap_behind_the_robot_is_refused(elbow, turn, step):
    """J1 +-179.999 deg: a gap of 0.002 deg, which at r = 700 is 700 * 0.002 * pi / 180 = 0.024 mm wide.

    The wrist passes x = -700 from y = -450 to -250, so that q0 goes through 180 deg: links 450, at y = -353.5
    r = 784.2, q1 / 2 = acos(784.2 / 900) = 29.4 deg, bearing -153.2 deg, q0 = -182.6; at y = -450, r = 832.2,
    q1 / 2 = 22.4 deg, bearing -147.3 deg, q0 = -169.7. So it crosses between. Inverse kinematics at samples
    0.1 mm apart, each wrapped into +-180 deg, finds every sample within the limits.
    """
    y = np.arange(-450.0, -250.0, step)
    r = np.hypot(700.0, y)
    q0 = np.degrees(np.arctan2(y, -700.0) - np.arccos(r / 900.0))
    sampled = np.abs(np.remainder(q0 + 180.0, 360.0) - 180.0)
    assert (np.diff(np.sign(np.remainder(q0, 360.0) - 180.0)) != 0).sum() == 1
    assert sampled.max() < 179.999
    tips, axes = wrist_path([[-700.0, -450.0, 0.0], [-700.0, -250.0, 0.0]], LEVEL)
    gap = limits(q0=(-179.999, 179.999), q1=(10, 150))
    verdict = ask(problem(tips, axes, deadband=Deadband(1e-3, 2 * DEG), **gap), elbow, turn)
    assert not verdict.admissible
    assert verdict.boundaries["left"].violated
    assert verdict.boundaries["right"].violated
    assert min(verdict.boundaries[name].certified for name in ("left", "right")) <= 0


@pytest.mark.parametrize(("clearance", "admitted"), [(5.001, True), (4.999, False)])
@everywhere
@both_elbows
def test_a_clearance_of_5001_is_admitted_and_4999_refused_at_a_deadband_of_5(
    elbow, turn, clearance, admitted
):
    """Links 500 and 395, folded: the inner circle has radius 500 - 395 = 105.

    A straight stroke from x = -200 to 200 at y = 105 + clearance comes nearest at x = 0, in its middle.
    """
    y = 105.0 + clearance
    tips, axes = wrist_path([[-200.0, y, 0.0], [200.0, y, 0.0]], LEVEL)
    verdict = ask(problem(tips, axes, arm=Arm(500.0, 395.0, "right"), **limits()), elbow, turn)
    inner = verdict.boundaries["inner"]
    assert verdict.admissible is admitted
    assert inner.clearance == pytest.approx(clearance, abs=1e-5)
    assert inner.fraction == pytest.approx(0.5, abs=1e-3)
    assert inner.violated is not admitted


@everywhere
@both_elbows
def test_a_turn_of_137_deg_in_one_segment_whose_end_pose_is_at_172_mm_is_refused(elbow, turn):
    """The tip stands at (400, 0), tool 498.28: the level tool's wrist runs on the circle of that radius about it.

    Pointing outward, at the end, the wrist is at 400 + 498.28 = 898.28 of 900: clearance 1.72. With the bound
    |dp| Theta h in place of |dp| Theta^2 h on the change of dp.u' such a turn was once certified.
    """
    tip = np.array([[400.0, 0.0, 0.0]] * 2)
    turning = axis(90 * DEG, np.array([-137.0, 0.0]) * DEG)
    verdict = ask(
        problem(tip, turning, tool_length_mm=498.28, **limits(q0=(-170, 170), q1=(0, 180))), elbow, turn
    )
    outer = verdict.boundaries["outer"]
    assert not verdict.admissible
    assert outer.clearance == pytest.approx(1.72, abs=1e-9)
    assert (outer.segment, outer.fraction) == (0, pytest.approx(1.0))
    assert 1.71 <= outer.certified <= 1.72 + 1e-9


@everywhere
@both_elbows
def test_the_same_turn_with_172_mm_in_its_middle_is_refused(elbow, turn):
    """From -68.5 to 68.5 deg the ends are harmless: r^2 = 400^2 + 498.28^2 + 2 * 400 * 498.28 * cos 68.5 deg, r = 743.8."""
    tip = np.array([[400.0, 0.0, 0.0]] * 2)
    turning = axis(90 * DEG, np.array([-68.5, 68.5]) * DEG)
    verdict = ask(
        problem(tip, turning, tool_length_mm=498.28, **limits(q0=(-170, 170), q1=(0, 180))), elbow, turn
    )
    outer = verdict.boundaries["outer"]
    assert math.hypot(400 + 498.28 * math.cos(68.5 * DEG), 498.28 * math.sin(68.5 * DEG)) < 760
    assert not verdict.admissible
    assert outer.fraction == pytest.approx(0.5, abs=0.01)
    assert 1.71 <= outer.certified <= 1.72 + 1e-9


def three_turns(per_turn=72):
    """Three turns round the column at r = 600 in straight chords, the tool level."""
    t = np.linspace(0.3, 0.3 + 6 * math.pi, 3 * per_turn + 1)
    return wrist_path(np.stack((600 * np.cos(t), 600 * np.sin(t), 0 * t), axis=1), LEVEL)


@everywhere
@both_elbows
def test_three_turns_round_the_column_are_refused_at_a_shoulder_of_180_deg_each_way(elbow, turn):
    """The shoulder turns by 3 * 360 = 1080 deg; its limits are 360 apart. Each pose alone can be reached."""
    asked = problem(*three_turns(), **limits(q0=(-180, 180), q1=(10, 150)))
    verdict = ask(asked, elbow, turn)
    assert not verdict.admissible
    assert verdict.branch is None
    assert min(verdict.boundaries[name].clearance for name in ("left", "right")) < 0
    assert any("whole turns" in reason for reason in verdict.reasons)
    for i in range(0, len(asked.tips_mm) - 1, 9):
        one = replace(asked, tips_mm=asked.tips_mm[i : i + 1], axes=asked.axes[i : i + 1])
        assert ask(one, elbow, turn).branch is not None


@everywhere
@both_elbows
def test_three_turns_round_the_column_are_admitted_at_a_shoulder_of_800_deg_each_way(elbow, turn):
    """1600 deg apart, 1080 needed: 520 deg to spare, so at least two choices of turns fit; the smallest is kept."""
    verdict = ask(problem(*three_turns(), **limits(q0=(-800, 800), q1=(10, 150))), elbow, turn)
    assert verdict.admissible, verdict.reasons
