"""The controller's own check of a stored path."""

import dataclasses
import itertools
import math
import re
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cutgate.firmware_sim import path_check
from cutgate.firmware_sim.kinematics import Pose, calibrated_arm, follow, forward, inverse
from cutgate.firmware_sim.path_check import PathCheck
from cutgate.protocol.path import encode_axes
from cutgate.protocol.records import UNIT, Path, PathCodes, RecordError, Tool
from cutgate.protocol.states import Refusal
from tests.firmware_sim.arms import (
    CALIBRATED,
    LEFT_LIMITS,
    LIMITS,
    NOMINAL,
    PATH,
    TOOL,
    TOOL_MM,
    WIDE,
    line_path,
    pocket,
    tilted,
)


def check(path, limits=LIMITS, calibration=NOMINAL, tool=TOOL, hold=None):
    return PathCheck(path, limits, calibration, tool, hold).run()


def path_of(joints, calibration=NOMINAL, elbow="right", **header):
    """The path through the poses of these reported joints."""
    arm = calibrated_arm(calibration, tool_mm=TOOL_MM, elbow=elbow)
    poses = [forward(arm, tuple(q)) for q in joints]
    tips, axes = [p.tip for p in poses], [p.axis for p in poses]
    return Path.quantised(tips, axes, feed_mm_s=10, tool_length_mm=TOOL_MM, elbow=elbow, **header)


def test_a_path_inside_the_limits_is_accepted():
    assert check(PATH) == (Refusal.ACCEPTED, 0, "")


@pytest.mark.parametrize(("joint", "turns"), [(0, "q0_turns"), (3, "roll_turns")])
def test_what_must_fit_a_joints_frame_is_where_the_path_goes_not_the_limits(joint, turns):
    """Limits of +-3000 deg: six turns leave a revolution to spare, seven do not, and the pose and the angle are named."""
    assert check(line_path((500.0, 0.0, 100.0), (450.0, 120.0, 60.0), **{turns: 6}), WIDE) == (
        Refusal.ACCEPTED,
        0,
        "",
    )
    refusal, pose, detail = check(line_path((500.0, 0.0, 100.0), (450.0, 120.0, 60.0), **{turns: 7}), WIDE)
    assert (refusal, pose) == (Refusal.JOINTS_BEYOND_WIRE, 0)
    assert re.fullmatch(
        rf"q{joint} = 2[45]\d\d\.\d+ deg is beyond \+-2261 deg, what the bus .* spare", detail
    )


def test_limits_that_a_pose_leaves_are_named_before_the_frame():
    refusal, _, detail = check(line_path((500.0, 0.0, 100.0), (450.0, 120.0, 60.0), roll_turns=7))
    assert refusal is Refusal.POSE_OUTSIDE_LIMITS
    assert "outside [-170.000000, 170.000000]" in detail


def test_the_first_joints_are_known_afterwards():
    inspection = PathCheck(PATH, LIMITS, CALIBRATED, TOOL)
    assert inspection.first_joints is None
    inspection.run()
    arm = calibrated_arm(CALIBRATED, tool_mm=TOOL_MM, elbow="right")
    expected = inverse(arm, Pose(tuple(PATH.tips_mm[0]), tuple(PATH.axes[0])))
    assert inspection.first_joints == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("at_once", [1, 1000])
def test_the_last_joints_are_known_once_the_path_is_accepted(at_once):
    inspection = PathCheck(PATH, LIMITS, CALIBRATED, TOOL)
    while not inspection.step(at_once):
        assert inspection.last_joints is None
    arm = calibrated_arm(CALIBRATED, tool_mm=TOOL_MM, elbow="right")
    expected = inverse(arm, Pose(tuple(PATH.tips_mm[-1]), tuple(PATH.axes[-1])))
    assert inspection.last_joints == pytest.approx(expected, abs=1e-9)
    assert inspection.path is PATH


def test_a_path_that_is_refused_has_no_last_joints_and_its_first_only_inside_the_limits():
    for first, last, known in ((500.0, 1500.0, True), (1500.0, 500.0, False)):
        inspection = PathCheck(line_path((first, 0, 100), (last, 0, 100)), LIMITS, NOMINAL, TOOL)
        assert inspection.run().refusal is Refusal.POSE_OUTSIDE_LIMITS
        assert inspection.last_joints is None
        assert (inspection.first_joints is not None) is known


@given(
    wrong=st.integers(0, 199),
    kind=st.sampled_from(["code", "run_cycle"]),
    part=st.integers(1, 250),
)
@settings(max_examples=40, deadline=None)
def test_a_malformed_pose_is_refused_in_parts_as_it_is_in_one_look(wrong, kind, part):
    """The whole look of the protocol's own path is the oracle; what comes before the pose is checked before it."""
    good = line_path((500.0, 0.0, 100.0), (450.0, 120.0, 60.0), poses=200)
    codes = good.poses.copy()
    if kind == "code":
        codes[wrong, 3] = -(2**30) - 1
    else:
        codes[wrong, 3:] = encode_axes(-good.axes[wrong : wrong + 1])[0]
    found = {field.name: getattr(good, field.name) for field in dataclasses.fields(good)}
    found["pose_bytes"] = codes.tobytes()
    with pytest.raises(RecordError) as whole:
        Path(**found)
    inspection = PathCheck(PathCodes(**found), WIDE, NOMINAL, TOOL)
    while not inspection.step(part):
        pass
    assert inspection.verdict == (Refusal.PATH_MALFORMED, 0, str(whole.value))


INSIDE = (0.2, 1.2, 200.0, 0.4, 0.6)


@pytest.mark.parametrize("joint", range(5))
@pytest.mark.parametrize("end", ["q_min", "q_max"])
@pytest.mark.parametrize("calibration", [NOMINAL, CALIBRATED])
def test_the_first_pose_outside_a_limit_is_named(joint, end, calibration):
    """Each joint is moved past each limit of its own; the limits are drawn round the path for it."""
    joints = np.tile(INSIDE, (9, 1))
    joints[6:, joint] += (-1 if end == "q_min" else 1) * (3.0 if joint == 2 else 0.03)
    counts = list(getattr(LIMITS, f"{end}_u"))
    bound = INSIDE[joint] if joint == 2 else math.degrees(INSIDE[joint])
    margin = 1.0 if joint == 2 else 0.5
    counts[joint] = round((bound + (-margin if end == "q_min" else margin)) * UNIT)
    limits = dataclasses.replace(LIMITS, **{f"{end}_u": tuple(counts)})
    verdict = check(path_of(joints, calibration), limits, calibration)
    assert (verdict.refusal, verdict.pose) == (Refusal.POSE_OUTSIDE_LIMITS, 6)
    assert verdict.detail.startswith(f"q{joint} = ")
    assert check(path_of(joints[:6], calibration), limits, calibration).refusal is Refusal.ACCEPTED


def test_calibration_decides():
    """The same poses are inside for one arm and outside for another whose joints are offset."""
    joints = np.tile(INSIDE, (3, 1))
    joints[:, 1] = math.radians(144.8)
    assert check(path_of(joints)).refusal is Refusal.ACCEPTED
    offset = dataclasses.replace(NOMINAL, joint_offset_u=(0, -400_000, 0, 0, 0))
    verdict = check(path_of(joints), LIMITS, offset)
    assert verdict.refusal is Refusal.POSE_OUTSIDE_LIMITS
    assert verdict.detail.startswith("q1 = 145.2")


def test_a_path_for_the_other_elbow_is_refused():
    left = path_of([(0.2, -1.2, 200.0, 0.4, 0.6)] * 2, elbow="left")
    assert check(left, LEFT_LIMITS).refusal is Refusal.ACCEPTED
    for path, limits in ((left, LIMITS), (PATH, LEFT_LIMITS)):
        verdict = check(path, limits)
        assert verdict[:2] == (Refusal.WRONG_ELBOW, 0)
        assert path.elbow in verdict.detail


def test_a_path_for_another_tool_is_refused():
    verdict = check(PATH, tool=Tool.quantised(length_mm=TOOL_MM + 1e-6))
    assert verdict[:2] == (Refusal.TOOL_LENGTH, 0)
    assert "160.000001" in verdict.detail


def test_a_pose_out_of_reach_is_named():
    path = line_path((500, 0, 100), (1500, 0, 100), poses=21)
    verdict = check(path, WIDE)
    assert verdict.refusal is Refusal.POSE_OUTSIDE_LIMITS
    assert "out of reach" in verdict.detail
    radius = np.hypot(*(path.tips_mm + TOOL_MM * path.axes)[:, :2].T)
    assert verdict.pose == int(np.argmax(radius > 900))


def vertical_path(count=5):
    tips = np.column_stack((np.linspace(500, 550, count), np.zeros(count), np.full(count, 100.0)))
    return tips, np.tile([0.0, 0.0, 1.0], (count, 1))


def test_a_vertical_axis_is_refused_without_a_held_roll_and_accepted_with_one():
    tips, axes = vertical_path()
    path = Path.quantised(tips, axes, feed_mm_s=10, tool_length_mm=TOOL_MM, elbow="right", roll_turns=1)
    verdict = check(path)
    assert verdict[:2] == (Refusal.POSE_OUTSIDE_LIMITS, 0)
    assert "vertical" in verdict.detail
    assert check(path, hold=0.3).refusal is Refusal.ACCEPTED
    assert check(path, hold=3.1).refusal is Refusal.POSE_OUTSIDE_LIMITS


def test_a_held_roll_serves_only_an_axis_vertical_throughout():
    tips, axes = vertical_path()
    for vertical, text in (([0, 1, 2], "leaves the vertical"), ([3], "is vertical")):
        mixed = tilted([30.0] * 5).copy()
        mixed[vertical] = axes[vertical]
        path = Path.quantised(tips, mixed, feed_mm_s=10, tool_length_mm=TOOL_MM, elbow="right")
        verdict = check(path, hold=0.3)
        assert verdict[:2] == (Refusal.POSE_OUTSIDE_LIMITS, 3)
        assert text in verdict.detail


@pytest.mark.parametrize(("q0_turns", "roll_turns"), [(0, 0), (2, -3), (-1, 1)])
def test_the_header_says_on_which_turns_the_path_begins(q0_turns, roll_turns):
    inspection = PathCheck(
        dataclasses.replace(PATH, q0_turns=q0_turns, roll_turns=roll_turns), WIDE, NOMINAL, TOOL
    )
    base = PathCheck(PATH, WIDE, NOMINAL, TOOL)
    base.run()
    assert inspection.run().refusal is Refusal.ACCEPTED
    moved = np.subtract(inspection.first_joints, base.first_joints)
    assert moved == pytest.approx([math.tau * q0_turns, 0, 0, math.tau * roll_turns, 0])
    if q0_turns or roll_turns:
        assert check(dataclasses.replace(PATH, q0_turns=q0_turns, roll_turns=roll_turns)).pose == 0


def turning(joint, turns, count=200):
    """A path on which q0 or q3 goes through whole turns."""
    joints = np.tile(INSIDE, (count, 1))
    joints[:, joint] += np.linspace(0, math.tau * turns, count)
    return path_of(joints)


@pytest.mark.parametrize("joint", [0, 3])
@pytest.mark.parametrize("turns", [1.6, -1.6])
@pytest.mark.parametrize("poses_at_once", [1, 7, 1000])
def test_turns_add_up_along_the_path_across_every_part_of_the_check(joint, turns, poses_at_once):
    path = turning(joint, turns)
    inspection = PathCheck(path, WIDE, NOMINAL, TOOL)
    while not inspection.step(poses_at_once):
        pass
    assert inspection.verdict.refusal is Refusal.ACCEPTED
    reached = inspection._before[joint]
    assert reached == pytest.approx(INSIDE[joint] + math.tau * turns, abs=1e-5)
    verdict = check(path, LIMITS)
    assert verdict.refusal is Refusal.POSE_OUTSIDE_LIMITS
    expected = np.linspace(0, math.tau * turns, 200) + INSIDE[joint]
    inside = (expected >= LIMITS.q_min[joint]) & (expected <= LIMITS.q_max[joint])
    assert verdict.pose == int(np.argmax(~inside))


def test_a_long_swing_of_q0_in_one_segment_is_followed_not_guessed():
    axes = tilted([90.0, 90.0])
    tips = np.array([[-30.0, -200.0, 0.0], [-30.0, 200.0, 0.0]]) - TOOL_MM * axes
    path = Path.quantised(tips, axes, feed_mm_s=10, tool_length_mm=TOOL_MM, elbow="right")
    inspection = PathCheck(path, WIDE, NOMINAL, TOOL)
    assert inspection.run().refusal is Refusal.ACCEPTED
    arm = calibrated_arm(NOMINAL, tool_mm=TOOL_MM, elbow="right")
    start, end = (
        Pose(tuple(t), tuple(a)) for t, a in zip(path.tips_mm.tolist(), path.axes.tolist(), strict=True)
    )
    expected = follow(arm, start, end, inspection.first_joints)
    assert abs(expected[0] - inspection.first_joints[0]) > 2.5
    assert tuple(inspection._before) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("at_once", [1, 100])
def test_a_swing_that_cannot_be_followed_is_refused_at_its_end(at_once):
    """Straight through the column: q0 jumps by half a turn there, or the links cannot fold so far."""
    axes = tilted([90.0] * 4, 90.0)
    tips = np.array([[300.0, 0, 0], [200.0, 0, 0], [-200.0, 1.0, 0], [-300.0, 0, 0]]) - TOOL_MM * axes
    path = Path.quantised(tips, axes, feed_mm_s=10, tool_length_mm=TOOL_MM, elbow="right")
    inspection = PathCheck(path, WIDE, CALIBRATED, TOOL)
    while not inspection.step(at_once):
        pass
    assert inspection.verdict[:2] == (Refusal.POSE_OUTSIDE_LIMITS, 2)
    assert "out of reach" in inspection.verdict.detail


@given(st.integers(0, 2**32 - 1), st.integers(1, 12))
def test_every_way_to_cut_the_work_gives_the_same_verdict(seed, at_once):
    rng = np.random.default_rng(seed)
    joints = np.array(INSIDE) + np.cumsum(rng.normal(size=(12, 5)) * [0.2, 0.1, 10, 0.3, 0.06], axis=0)
    joints[:, 1] = np.clip(joints[:, 1], 0.1, 2.8)
    joints[:, 4] = np.clip(joints[:, 4], 0.1, 2.5)
    path = path_of(joints)
    inspection = PathCheck(path, LIMITS, NOMINAL, TOOL)
    while not inspection.step(at_once):
        pass
    assert inspection.verdict == check(path)
    outside = np.any((joints < LIMITS.q_min - 1e-5) | (joints > LIMITS.q_max + 1e-5), axis=1)
    if np.any(outside):
        assert inspection.verdict.refusal is Refusal.POSE_OUTSIDE_LIMITS
        assert inspection.verdict.pose <= int(np.argmax(outside))


def test_seven_thousand_poses_take_no_cycle_of_the_loop_long():
    path = pocket(poses=7000, length_mm=17_500.0)
    inspection = PathCheck(path, LIMITS, NOMINAL, TOOL)
    parts = []
    while True:
        begin = time.process_time()
        done = inspection.step(512)
        parts.append(time.process_time() - begin)
        if done:
            break
    assert inspection.verdict.refusal is Refusal.ACCEPTED
    assert len(parts) == 14
    assert sum(parts) < 0.5  # measured 4 ms; the bound only catches a check that went scalar
    assert inspection.step(512)


# ---------------------------------------------------------------- what is followed, and to the last count


def along(wrists, axis, **header):
    """The path of a wrist through these places, mm, under one axis."""
    axes = np.tile(axis, (len(wrists), 1))
    tips = np.asarray(wrists) - TOOL_MM * axes
    return Path.quantised(tips, axes, feed_mm_s=10, tool_length_mm=TOOL_MM, elbow="right", **header)


SWING = [[850.0, -25.0, 200.0], [-60.0, -25.0, 200.0]]
"""Past the column while the elbow folds: q0 turns back by more than half a revolution."""


@pytest.mark.parametrize("at_once", [1, 2, 1000])
@pytest.mark.parametrize("before", [0, 1, 3])
def test_a_swing_of_more_than_half_a_revolution_is_followed_wherever_it_is(at_once, before):
    lead = [[850.0 - at, -25.0, 200.0] for at in range(before, 0, -1)]
    path = along(lead + SWING, (0.6, 0.0, 0.8), roll_turns=1)
    inspection = PathCheck(path, WIDE, NOMINAL, TOOL)
    while not inspection.step(at_once):
        pass
    assert inspection.verdict.refusal is Refusal.ACCEPTED
    arm = calibrated_arm(NOMINAL, tool_mm=TOOL_MM, elbow="right")
    poses = [Pose(tuple(t), tuple(a)) for t, a in zip(path.tips_mm, path.axes, strict=True)]
    joints = inspection.first_joints
    for start, end in itertools.pairwise(poses):
        joints, earlier = follow(arm, start, end, joints), joints
    assert joints[0] - earlier[0] < -math.pi
    assert inspection.last_joints == pytest.approx(joints, abs=1e-9)


SHORT = dataclasses.replace(NOMINAL, forearm_link_u=430 * UNIT)
"""Its links cannot fold to less than 20 mm."""


@pytest.mark.parametrize("at_once", [1, 2, 1000])
@pytest.mark.parametrize("before", [0, 1, 3])
def test_a_swing_of_more_than_one_rad_through_the_column_is_refused_at_its_end_with_the_place(
    at_once, before
):
    angle = 0.75
    x, y = 26.0 * math.cos(angle), 26.0 * math.sin(angle)
    lead = [[x, -y - at / 10, 200.0] for at in range(before, 0, -1)]
    path = along([*lead, [x, -y, 200.0], [x, y, 200.0], [x, y + 0.1, 200.0]], (0.6, 0.0, 0.8))
    inspection = PathCheck(path, WIDE, SHORT, TOOL)
    while not inspection.step(at_once):
        pass
    assert inspection.verdict[:2] == (Refusal.POSE_OUTSIDE_LIMITS, before + 1)
    assert re.fullmatch(
        r"wrist centre at radius 19\.\d+ mm is out of reach, must be in \[20\.0+, 880\.0+\]",
        inspection.verdict.detail,
    )


def test_a_joint_on_its_limit_is_inside():
    """The slide of a vertical tool is a whole number of mm, without rounding."""
    path = along([[600.0, 0.0, 260.0], [610.0, 0.0, 260.0]], (0.0, 0.0, 1.0))
    for low, high, refusal in (
        (260 * UNIT, 260 * UNIT, Refusal.ACCEPTED),
        (260 * UNIT + 1, 300 * UNIT, Refusal.POSE_OUTSIDE_LIMITS),
        (200 * UNIT, 260 * UNIT - 1, Refusal.POSE_OUTSIDE_LIMITS),
    ):
        limits = dataclasses.replace(
            LIMITS,
            q_min_u=(*LIMITS.q_min_u[:2], low, *LIMITS.q_min_u[3:]),
            q_max_u=(*LIMITS.q_max_u[:2], high, *LIMITS.q_max_u[3:]),
        )
        assert check(path, limits, hold=0.0).refusal is refusal


def test_the_bounds_themselves_are_inside(monkeypatch):
    """Of what the bus reports."""
    inspection = PathCheck(PATH, LIMITS, NOMINAL, TOOL)
    inspection.run()
    most = max(abs(joints[joint]) for joints in (inspection.first_joints,) for joint in (0, 3))
    path = dataclasses.replace(PATH, pose_bytes=PATH.pose_bytes[:20] * 2)
    monkeypatch.setattr(path_check, "GOES_RAD", most)
    assert check(path).refusal is Refusal.ACCEPTED
    monkeypatch.setattr(path_check, "GOES_RAD", math.nextafter(most, 0.0))
    assert check(path).refusal is Refusal.JOINTS_BEYOND_WIRE


def test_an_axis_on_the_bound_is_not_vertical(monkeypatch):
    """So its roll is on the revolution that the header names."""
    path = dataclasses.replace(PATH, pose_bytes=PATH.pose_bytes[:20] * 2, roll_turns=1)
    level = float(np.hypot(*PATH.axes[0, :2]))
    for bound, turns in ((level, 1), (math.nextafter(level, 1.0), 0)):
        monkeypatch.setattr(path_check, "VERTICAL_SIN", bound)
        inspection = PathCheck(path, WIDE, NOMINAL, TOOL)
        assert inspection.run().refusal is Refusal.ACCEPTED
        assert round(inspection.first_joints[3] / math.tau) == turns


@pytest.mark.parametrize("at_once", [1, 2, 3, 1000])
def test_a_pose_is_named_by_its_place_in_the_path_whatever_the_part(at_once):
    joints = np.tile(INSIDE, (9, 1))
    joints[5:, 2] = 460.0
    inspection = PathCheck(path_of(joints), LIMITS, NOMINAL, TOOL)
    while not inspection.step(at_once):
        pass
    assert inspection.verdict[:2] == (Refusal.POSE_OUTSIDE_LIMITS, 5)
    joints = np.tile(INSIDE, (9, 1))
    joints[:, 3] = np.radians([2200.0 + 12 * at for at in range(9)])
    path = path_of(joints)
    inspection = PathCheck(dataclasses.replace(path, roll_turns=6), WIDE, NOMINAL, TOOL)
    while not inspection.step(at_once):
        pass
    assert inspection.verdict[:2] == (Refusal.JOINTS_BEYOND_WIRE, 6)


def test_the_elbow_is_the_sign_of_the_limits_to_the_last_count():
    left = path_of([(0.2, -1.2, 200.0, 0.4, 0.6)] * 2, elbow="left")
    for path, limits, end, text in (
        (PATH, LIMITS, "q_min_u", "path for the right elbow, q1 limits are [-1e-06, 145.0] deg"),
        (left, LEFT_LIMITS, "q_max_u", "path for the left elbow, q1 limits are [-145.0, 1e-06] deg"),
    ):
        counts = list(getattr(limits, end))
        assert counts[1] == 0
        assert check(path, limits).refusal is Refusal.ACCEPTED
        counts[1] = 1 if end == "q_max_u" else -1
        verdict = check(path, dataclasses.replace(limits, **{end: tuple(counts)}))
        assert verdict == (Refusal.WRONG_ELBOW, 0, text)


def test_from_one_rad_on_a_change_of_q0_is_followed():
    assert path_check.SURE_STEP_RAD == 1.0
