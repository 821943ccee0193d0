"""The gate on hand-checkable paths: what must be refused, what must be admitted, and what is said."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cutgate.runtime.verification import certified
from cutgate.runtime.verification.effort import Effort, EffortSpentError
from cutgate.runtime.verification.problem import Arm, ArmCalibration, Deadband
from tests.runtime.verification.cases import DEG, WIDE, axis, problem, wrist_path
from tests.tool_paths import tool_path

LEVEL = axis(90 * DEG, 0.0)
FREE = {
    "lower": np.array([-WIDE, 0.0, -1e4, -WIDE, 0.0]),
    "upper": np.array([WIDE, math.pi, 1e4, WIDE, math.pi]),
    "speed": np.full(5, 1e12),
}


def limits(**joints):
    """Wide limits but for the joints named, in deg or mm."""
    lower, upper = FREE["lower"].copy(), FREE["upper"].copy()
    for name, (low, high) in joints.items():
        i, scale = int(name[1]), 1.0 if name == "q2" else DEG
        lower[i], upper[i] = low * scale, high * scale
    return {"lower": lower, "upper": upper, "speed": FREE["speed"]}


def milled(name):
    table = np.loadtxt(tool_path(name), delimiter=",", skiprows=1)
    return table[:, :3], table[:, 3:] / np.linalg.norm(table[:, 3:], axis=1, keepdims=True)


# -- tool paths of five-axis milling -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "tip_mm", "wrist_mm"),
    [("blade-channel.csv", 427.440, 1081.970), ("impeller-blade.csv", 330.777, 1004.878)],
)
def test_a_blade_channel_is_admitted(name, tip_mm, wrist_mm):
    tips, axes = milled(name)
    verdict = certified.verify(problem(np.add(tips, (450.0, 150.0, 100.0)), axes))
    assert verdict.admissible, verdict.reasons
    assert min(b.certified / b.deadband for b in verdict.boundaries.values()) > 10
    assert verdict.tip_length_mm == pytest.approx(tip_mm, abs=1e-3)
    assert verdict.wrist_length_mm == pytest.approx(wrist_mm, abs=1e-3)


@pytest.mark.parametrize(
    ("name", "clearance"), [("whole-wheel.csv", "-129.5"), ("impeller-op1.csv", "-35.5")]
)
def test_an_axis_that_goes_round_by_almost_a_turn_is_refused_for_its_roll(name, clearance):
    tips, axes = milled(name)
    verdict = certified.verify(problem(np.add(tips, (450.0, 150.0, 100.0)), axes))
    assert not verdict.admissible
    assert [b.name for b in verdict.boundaries.values() if b.violated] == ["roll_max"]
    assert verdict.branch is None
    assert any(reason.startswith(f"roll_max: clearance {clearance}") for reason in verdict.reasons)


# -- the arm -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("clearance", "admitted"), [(5.001, True), (4.999, False), (5.0 + 1e-6, True), (5.0 - 1e-6, False)]
)
def test_decides_at_the_deadband_itself(clearance, admitted):
    """The foot of a straight stroke between its poses is the place that decides."""
    inner = {"arm": Arm(500.0, 395.0, "right")}  # folded: |a0 - a1| = 105
    tips, axes = wrist_path([[-200.0, 105.0 + clearance, 0.0], [200.0, 105.0 + clearance, 0.0]], LEVEL)
    verdict = certified.verify(problem(tips, axes, **inner, **FREE))
    assert verdict.admissible is admitted
    assert verdict.boundaries["inner"].clearance == pytest.approx(clearance, abs=1e-5)
    assert verdict.boundaries["inner"].fraction == pytest.approx(0.5, abs=1e-3)
    assert verdict.boundaries["inner"].violated is not admitted


def test_a_path_beside_the_thin_gap_is_admitted():
    tips, axes = wrist_path([[-700.0, 100.0, 0.0], [-700.0, 300.0, 0.0]], LEVEL)
    verdict = certified.verify(problem(tips, axes, **limits(q0=(-179.999, 179.999), q1=(10, 150))))
    assert verdict.admissible, verdict.reasons


def test_a_unwrapped_limit_counts_only_within_half_a_turn():
    tips, axes = wrist_path([[500.0, 0.0, 0.0], [520.0, 10.0, 0.0]], LEVEL)
    far = certified.verify(problem(tips, axes, **limits(q0=(-400, 400), q1=(10, 150))))
    near = certified.verify(problem(tips, axes, **limits(q0=(-100, 400), q1=(10, 150))))
    assert far.admissible
    assert "left" not in far.boundaries
    assert "right" not in far.boundaries
    assert near.admissible
    assert "left" not in near.boundaries
    assert near.boundaries["right"].clearance > 5


@pytest.mark.parametrize("joint", range(5))
def test_limits_the_wrong_way_round_are_refused_in_words(joint):
    """No file gives them; a program may."""
    stroke = problem([[500, 50, 120], [520, 60, 110]], axis([0.5, 0.5], [0.0, 0.1]))
    lower, upper = stroke.lower.copy(), stroke.upper.copy()
    lower[joint], upper[joint] = upper[joint], lower[joint]
    verdict = certified.verify(replace(stroke, lower=lower, upper=upper))
    assert not verdict.admissible
    assert verdict.reasons


def test_the_turn_of_the_shoulder_is_chosen_and_reported():
    tips, axes = wrist_path([[500.0, 0.0, 0.0], [520.0, 10.0, 0.0]], LEVEL)
    verdict = certified.verify(problem(tips, axes, **limits(q0=(200, 700), q1=(10, 150))))
    assert verdict.admissible, verdict.reasons
    assert verdict.branch.q0_turns == 1
    asked = certified.verify(problem(tips, axes, branch=(0, 0), **limits(q0=(200, 700), q1=(10, 150))))
    assert not asked.admissible


# -- slide and wrist -----------------------------------------------------------------------------


def test_the_same_passage_is_admitted_with_a_free_roll_and_refused_by_its_speed():
    lean = 0.03 * DEG
    ends = np.array([[-0.4, math.tan(lean), 1.0], [0.4, math.tan(lean), 1.0]])
    tips, axes = wrist_path([[600.0, 0.0, 0.0]] * 2, ends / np.linalg.norm(ends, axis=1, keepdims=True))
    free = limits(q0=(-170, 170), q1=(5, 170))
    tiny = Deadband(1.0, 0.001 * DEG)
    assert certified.verify(problem(tips, axes, deadband=tiny, **free)).admissible
    slow = free | {"speed": np.array([1.0, 1.0, 200.0, 2.0, 2.0])}
    verdict = certified.verify(problem(tips, axes, deadband=tiny, **slow))
    assert not verdict.admissible
    assert not any(b.violated for b in verdict.boundaries.values())
    assert [line.joint for line in verdict.speed if not line.ok] == [3]
    assert verdict.speed[3].peak > 100
    assert any(reason.startswith("joint 3: needs up to") for reason in verdict.reasons)


def test_a_vertical_tool_is_singular_unless_the_roll_is_held():
    tips, axes = wrist_path([[600.0, 0.0, 100.0], [640.0, 30.0, 120.0]], [0.0, 0.0, 1.0])
    refused = certified.verify(problem(tips, axes))
    assert not refused.admissible
    assert refused.boundaries["roll_min"].clearance is None
    assert refused.boundaries["roll_min"].violated
    assert any("hold_roll_when_vertical" in reason for reason in refused.reasons)
    held = certified.verify(problem(tips, axes, hold_roll=0.5))
    assert held.admissible, held.reasons
    assert not {"wrist_singularity", "pitch_min"} & set(held.boundaries)
    assert held.boundaries["roll_min"].clearance == pytest.approx(170 + math.degrees(0.5))
    assert held.speed[3].peak == 0.0
    assert not certified.verify(problem(tips, axes, hold_roll=169 * DEG)).admissible
    assert not certified.verify(problem(tips, axes, hold_roll=171 * DEG)).admissible


def test_a_held_roll_does_not_excuse_a_leaning_tool():
    tips, axes = wrist_path([[600.0, 0.0, 100.0], [640.0, 30.0, 120.0]], axis(0.01, 0.0))
    verdict = certified.verify(problem(tips, axes, hold_roll=0.0))
    assert verdict.boundaries["wrist_singularity"].violated


def test_the_height_between_two_poses_is_seen():
    """Both poses at the same height, the tool passes the level between them: a sinusoid, closed form."""
    tips = np.array([[450.0, 0.0, 200.0]] * 2)
    axes = axis(np.array([60.0, 120.0]) * DEG, np.array([0.2, 0.2]))
    up = axes * (1, 1, -1)
    verdict = certified.verify(problem(tips, up[::-1], **limits(q0=(-170, 170), q2=(0, 300))))
    assert verdict.boundaries["top"].clearance == pytest.approx(300 - 280, abs=1e-9)
    sideways = axis(np.array([80.0, 80.0]) * DEG, np.array([-1.2, 1.2]))
    verdict = certified.verify(problem(tips, sideways, **limits(q0=(-170, 170), q2=(0, 300))))
    crest = math.atan2(math.cos(80 * DEG), math.sin(80 * DEG) * math.cos(1.2))
    assert verdict.boundaries["pitch_min"].clearance == pytest.approx(90 - math.degrees(crest), abs=1e-9)
    assert verdict.boundaries["pitch_min"].fraction == pytest.approx(0.5)
    assert verdict.boundaries["top"].clearance == pytest.approx(100 - 160 * math.sin(crest), abs=1e-9)


def test_roll_follows_a_wrist_that_moves_without_turning_the_tool():
    """The separate angular run of the paper sees nothing here: the axis is constant, the roll is not."""
    tips, axes = wrist_path([[300.0, -200.0, 100.0], [300.0, 207.0, 100.0]], axis(1.0, 0.0))
    verdict = certified.verify(problem(tips, axes))
    span = 340.0 - verdict.boundaries["roll_min"].clearance - verdict.boundaries["roll_max"].clearance
    assert verdict.axis_angle_rad == 0.0
    assert span > 50


def test_the_roll_turn_with_most_room_is_chosen_and_one_that_does_not_fit_is_refused():
    tips, axes = wrist_path([[600.0, 0.0, 100.0], [600.0, 40.0, 100.0]], axis(1.0, 0.0))
    free = certified.verify(problem(tips, axes))
    start = free.boundaries["roll_min"].clearance - 170
    narrow = limits(q0=(-170, 170), q1=(0, 170), q3=(start + 360 - 30, start + 360 + 40))
    verdict = certified.verify(problem(tips, axes, **narrow))
    assert verdict.admissible, verdict.reasons
    assert verdict.branch.roll_turns == 1
    assert certified.verify(problem(tips, axes, branch=(0, 1), **narrow)).admissible
    other = certified.verify(problem(tips, axes, branch=(0, 0), **narrow))
    assert not other.admissible
    assert "q0_turns 0, roll_turns 0 do not keep" in other.reasons[0]


def test_ties_go_to_the_smallest_turn():
    tips, axes = wrist_path([[600.0, 0.0, 100.0], [600.0, 40.0, 100.0]], axis(1.0, 0.0))
    verdict = certified.verify(problem(tips, axes, **limits(q0=(-170, 170), q1=(0, 170))))
    assert (verdict.branch.q0_turns, verdict.branch.roll_turns) == (0, 0)


# -- calibration, residuals ----------------------------------------------------------------------


def test_residuals_and_tolerances_widen_the_deadbands():
    tips, axes = wrist_path([[600.0, 0.0, 100.0], [600.0, 40.0, 100.0]], axis(1.0, 0.0))
    plain = certified.verify(problem(tips, axes))
    wide = certified.verify(
        problem(
            tips,
            axes,
            calibration=ArmCalibration(residual_mm=0.5, residual_rad=0.002),
            deadband=Deadband(5.0, 2 * DEG, 0.25, 0.001),
        )
    )
    assert wide.deadband_arm_mm == 5.75
    assert wide.deadband_wrist_rad == pytest.approx(2 * DEG + 0.003)
    assert wide.boundaries["outer"].clearance == plain.boundaries["outer"].clearance
    elbow = math.acos((600.0**2 - 2 * 450.0**2) / (2 * 450.0**2))
    more = math.asin(math.sin(0.003) / math.sin(1.0)) - 0.003 + 0.75 / (450 * math.sin(elbow))
    lost = plain.boundaries["roll_max"].clearance - wide.boundaries["roll_max"].clearance
    assert math.radians(lost) == pytest.approx(more, rel=0.02)


def test_an_offset_past_the_straight_elbow_makes_extension_the_boundary():
    offset = np.array([0.0, -0.1, 0.0, 0.0, 0.0])
    tips, axes = wrist_path([[890.0, 0.0, 100.0], [890.0, 1.0, 100.0]], LEVEL)
    shifted = certified.verify(problem(tips, axes, calibration=ArmCalibration(joint_offset=offset)))
    assert shifted.boundaries["outer"].clearance == pytest.approx(900 - math.hypot(890, 1), abs=1e-6)


def test_a_leaning_slide_is_a_shear():
    tips, axes = wrist_path([[600.0, 0.0, 100.0], [600.0, 0.0, 140.0]], LEVEL)
    leaning = ArmCalibration(slide_tilt=np.array([0.02, 0.0]))
    verdict = certified.verify(problem(tips, axes, calibration=leaning))
    assert verdict.boundaries["outer"].clearance == pytest.approx(900 - 600 + 100 * 0.02, abs=1e-6)


# -- degenerate and bad --------------------------------------------------------------------------


def test_duplicate_poses_and_a_single_pose_are_verified():
    tips, axes = wrist_path([[600.0, 0.0, 100.0]] * 3, axis(1.0, 0.2))
    verdict = certified.verify(problem(tips, axes))
    assert verdict.admissible, verdict.reasons
    assert verdict.tip_length_mm == 0.0
    assert [line.peak for line in verdict.speed] == [0.0] * 5
    assert certified.verify(problem(tips[:1], axes[:1])).admissible


def test_a_wrist_centre_on_the_column_is_refused():
    folds = limits(q0=(-170, 170), q1=(0, 180))
    tips, axes = wrist_path([[-50.0, 0.0, 100.0], [50.0, 0.0, 100.0]], axis(1.0, 0.2))
    verdict = certified.verify(problem(tips, axes, **folds))
    assert not verdict.admissible
    assert verdict.boundaries["inner"].clearance == pytest.approx(0.0, abs=1e-9)
    assert verdict.boundaries["roll_min"].clearance is None
    tips, axes = wrist_path([[0.0, 0.0, 100.0], [0.0, 0.0, 100.0]], axis(1.0, 0.2))
    assert not certified.verify(problem(tips, axes, **folds)).admissible


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"feed_mm_s": math.nan}, "feed"),
        ({"feed_mm_s": 0.0}, "feed"),
        ({"tool_length_mm": -1.0}, "tool_length"),
        ({"lower": np.full(5, math.nan)}, "lower"),
        ({"speed": np.array([1.0, 1.0, 0.0, 1.0, 1.0])}, "speed"),
        ({"deadband": Deadband(0.0, 0.1)}, "arm deadband"),
        ({"deadband": Deadband(5.0, math.nan)}, "wrist deadband"),
        ({"arm": Arm(0.0, 450.0, "right")}, "upper link"),
        ({"calibration": ArmCalibration(residual_mm=-1.0)}, "residual"),
        ({"hold_roll": math.inf}, "held roll"),
        ({"upper": np.zeros(4)}, "shape"),
    ],
)
def test_unusable_numbers_are_refused_and_named(change, named):
    tips, axes = wrist_path([[600.0, 0.0, 100.0], [620.0, 0.0, 100.0]], LEVEL)
    verdict = certified.verify(problem(tips, axes, **change))
    assert not verdict.admissible
    assert named in " ".join(verdict.reasons)
    assert all(b.violated and b.clearance is None for b in verdict.boundaries.values())
    assert not any(line.ok for line in verdict.speed)


def test_unusable_poses_are_refused_and_named():
    tips, axes = wrist_path([[600.0, 0.0, 100.0], [620.0, 0.0, 100.0]], LEVEL)
    good = problem(tips, axes)
    bad = tips.copy()
    bad[1, 1] = math.nan
    assert "tips_mm are not all finite" in certified.verify(replace(good, tips_mm=bad)).reasons[0]
    assert "not a unit" in certified.verify(replace(good, axes=axes * 1.01)).reasons[0]
    assert "179 deg" in certified.verify(replace(good, axes=axes * [[1], [-1]])).reasons[0]
    for turn, refused in ((178.99, False), (179.01, True), (179.9999, True)):
        bent = np.vstack((LEVEL, axis(90 * DEG, turn * DEG)))
        reasons = certified.verify(replace(good, axes=bent)).reasons
        assert any("179 deg" in reason for reason in reasons) is refused
    assert "no pose" in certified.verify(replace(good, tips_mm=tips[:0], axes=axes[:0])).reasons[0]


def test_limits_that_exclude_each_other_are_refused():
    tips, axes = wrist_path([[600.0, 0.0, 100.0], [620.0, 0.0, 100.0]], LEVEL)
    for swap in (0, 1):
        good = problem(tips, axes)
        lower, upper = good.lower.copy(), good.upper.copy()
        lower[swap], upper[swap] = upper[swap], lower[swap]
        verdict = certified.verify(replace(good, lower=lower, upper=upper))
        assert not verdict.admissible
        assert verdict.branch is None
    wrong_elbow = certified.verify(replace(good, arm=Arm(450.0, 450.0, "left"), lower=good.lower))
    assert not wrong_elbow.admissible


def test_a_branch_that_the_path_does_not_lie_in_is_refused_and_named():
    tips, axes = wrist_path([[600.0, 0.0, 100.0], [600.0, 40.0, 100.0]], axis(1.0, 0.0))
    wide = limits(q0=(-1000, 1000), q1=(5, 170))
    assert certified.verify(problem(tips, axes, branch=(2, 3), **wide)).branch.q0_turns == 2
    held = wrist_path([[600.0, 0.0, 100.0], [600.0, 40.0, 100.0]], [0.0, 0.0, 1.0])
    assert not certified.verify(problem(*held, hold_roll=0.0, branch=(0, 1))).admissible
    assert certified.verify(problem(*held, hold_roll=0.0, branch=(0, 0))).admissible


def test_a_shoulder_of_a_full_turn_out_of_reach_has_no_branch():
    tips, axes = wrist_path([[1200.0, 0.0, 100.0], [1300.0, 40.0, 100.0]], axis(1.0, 0.0))
    verdict = certified.verify(problem(tips, axes, **limits(q0=(-1000, 1000), q1=(5, 170))))
    assert not verdict.admissible
    assert verdict.branch is None
    assert verdict.boundaries["outer"].clearance < 0


def test_a_unwrapped_limit_that_decides_is_refused_in_mm():
    tips, axes = wrist_path([[500.0, 0.0, 0.0], [520.0, 10.0, 0.0]], LEVEL)
    free = certified.verify(problem(tips, axes, **limits(q0=(-900, 900), q1=(10, 150))))
    assert free.admissible
    x, y = 500.0, 0.0
    elbow = math.acos((x * x + y * y - 2 * 450.0**2) / (2 * 450.0**2))
    q0 = -math.degrees(math.atan2(450 * math.sin(elbow), 450 + 450 * math.cos(elbow)))
    # Only the turn k = 0 fits, and its right limit lies 0.1 deg below the start: under a millimetre.
    verdict = certified.verify(problem(tips, axes, **limits(q0=(q0 - 0.1, q0 + 360), q1=(10, 150))))
    assert not verdict.admissible
    assert verdict.boundaries["right"].violated
    assert 0 < verdict.boundaries["right"].clearance < 1.0


def test_an_offset_past_the_folded_elbow_makes_the_fold_the_boundary():
    tips, axes = wrist_path([[60.0, 0.0, 100.0], [60.0, 1.0, 100.0]], LEVEL)
    folds = limits(q0=(-170, 170), q1=(0, 179))
    offset = ArmCalibration(joint_offset=np.array([0.0, 0.1, 0.0, 0.0, 0.0]))
    verdict = certified.verify(
        problem(tips, axes, arm=Arm(450.0, 400.0, "right"), calibration=offset, **folds)
    )
    assert verdict.boundaries["inner"].clearance == pytest.approx(60.0 - 50.0, abs=1e-9)


def test_a_tie_set_by_another_boundary_goes_to_the_smallest_turn():
    """The arm keeps 1.2 of its deadband; both roll turns keep more, the larger one by far."""
    tips, axes = wrist_path([[894.0, 0.0, 100.0], [893.0, 1.0, 100.0]], axis(1.0, 0.0))
    free = certified.verify(problem(tips, axes, **limits(q0=(-170, 170), q1=(0, 170))))
    start = free.boundaries["roll_min"].clearance - 36000
    verdict = certified.verify(
        problem(tips, axes, **limits(q0=(-170, 170), q1=(0, 170), q3=(start - 60, start + 360 + 200)))
    )
    assert verdict.branch.roll_turns == 0
    tighter = certified.verify(
        problem(tips, axes, **limits(q0=(-170, 170), q1=(0, 170), q3=(start - 2.1, start + 360 + 200)))
    )
    assert tighter.branch.roll_turns == 1


def test_work_that_is_bounded_is_done_within_its_bound_or_not_at_all():
    path = problem(*wrist_path([[600.0, 0.0, 100.0], [610.0, 50.0, 100.0]], axis(1.0, 0.3)))
    enough = Effort(1e6)
    assert certified.verify(path, enough) == certified.verify(path)
    assert 15_000 + 3 * 2 < enough.spent < 1e6  # the poses are work as well
    with pytest.raises(EffortSpentError):
        certified.verify(path, Effort(15_000))


def test_a_shoulder_that_cannot_be_followed_near_the_straight_elbow_has_no_branch():
    """Reported within +-400 deg, from the outermost place, where the elbow is straight, inward."""
    tips, axes = wrist_path([[900.0, 0.0, 100.0], [500.0, 0.0, 100.0]], LEVEL)
    verdict = certified.verify(problem(tips, axes, **limits(q0=(-400.0, 400.0))))
    assert verdict.branch is None
    assert not verdict.admissible
    assert "q0" not in [found.joint for found in verdict.windings]


@pytest.mark.parametrize(("upper", "chosen"), [(367.0, 0), (376.0, 1)])
def test_of_two_turns_near_a_limit_each_the_one_further_away_is_taken(upper, chosen):
    """The shoulder stands at 5 deg; its lower limit is 0, and one revolution on its upper limit is 2 or 11 deg away."""
    tips, axes = wrist_path([[450.0 * math.cos(5 * DEG) - 450.0 * math.sin(5 * DEG),
                              450.0 * math.sin(5 * DEG) + 450.0 * math.cos(5 * DEG), 100.0]] * 2, LEVEL)  # fmt: skip
    tips[1, 2] += 1.0
    verdict = certified.verify(problem(tips, axes, **limits(q0=(0.0, upper), q1=(5.0, 170.0))))
    assert verdict.branch.q0_turns == chosen
    assert ("right" if chosen == 0 else "left") in verdict.boundaries


def test_a_roll_held_beyond_what_a_joints_frame_carries_is_refused_with_what_to_do():
    tips = [[500.0, 0.0, 100.0], [510.0, 0.0, 100.0]]
    path = problem(tips, np.tile([0.0, 0.0, 1.0], (2, 1)), hold_roll=2261.5 * DEG, **limits(q0=(-80.0, 80.0)))
    assert any("declare another hold_roll_deg" in reason for reason in certified.verify(path).reasons)
    assert certified.verify(replace(path, hold_roll=2261.0 * DEG)).branch is not None


@pytest.mark.parametrize("name", ["roll_min", "roll_max"])
@pytest.mark.parametrize("part", [0.25, 0.75])
def test_a_roll_whose_deadband_lies_between_bound_and_least_found_is_looked_at_more_finely(name, part):
    tips, axes = wrist_path([[520.0, -250.0, 150.0], [560.0, 260.0, 140.0]], axis([0.6, 0.7], [0.9, -0.8]))
    path = problem(tips, axes, closely=True, **limits(q0=(-80.0, 80.0), q3=(-170.0, 170.0)))
    first = certified.verify(path).boundaries[name]
    assert first.clearance - first.certified > 1e-3
    end, sign = ("upper", 1.0) if name == "roll_max" else ("lower", -1.0)
    bound = getattr(path, end).copy()
    bound[3] -= sign * (first.certified + part * (first.clearance - first.certified) - 2.0) * DEG
    found = certified.verify(replace(path, **{end: bound})).boundaries[name]
    assert found.certified >= 2.0  # the first bound says no, the least found is what is true
    assert not found.violated


def test_past_the_column_there_is_no_branch_and_no_shoulder_to_follow():
    tips, axes = wrist_path([[-400.0, 0.0, 100.0], [400.0, 0.0, 100.0]], axis(1.0, 0.2))
    verdict = certified.verify(problem(tips, axes, **FREE))
    assert verdict.branch is None
    assert [found.joint for found in verdict.windings] == []
    assert not verdict.admissible
