"""The controller's kinematics against a chain of matrices, and against itself."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.firmware_sim.kinematics import (
    ControllerArm,
    KinematicsError,
    OutOfReachError,
    Pose,
    SingularError,
    angle_between,
    as_joints,
    calibrated_arm,
    follow,
    forward,
    interpolate,
    inverse,
    inverse_many,
    limit_text,
    on_nearest_revolutions,
    wrap,
    wrap_many,
)
from tests.firmware_sim.arms import CALIBRATED, NOMINAL, TOOL_MM, tilted

RIGHT = calibrated_arm(NOMINAL, tool_mm=TOOL_MM, elbow="right")
ANGLE = st.floats(-3.1, 3.1)


@st.composite
def arms(draw):
    """Random arms with links of different length, calibration and either elbow."""
    small = st.floats(-0.05, 0.05)
    return ControllerArm(
        upper_mm=draw(st.floats(100, 600)),
        forearm_mm=draw(st.floats(100, 600)),
        tool_mm=draw(st.floats(0, 300)),
        right=draw(st.booleans()),
        offset=(draw(small), draw(small), draw(st.floats(-5, 5)), draw(small), draw(small)),
        tilt=(draw(st.floats(-0.02, 0.02)), draw(st.floats(-0.02, 0.02))),
    )


@st.composite
def arms_and_joints(draw):
    """An arm and reported joints on its elbow, away from straight, folded and vertical."""
    arm = draw(arms())
    elbow = draw(st.floats(0.2, 2.9)) * (1 if arm.right else -1)
    joints = (draw(ANGLE), elbow, draw(st.floats(-200, 500)), draw(ANGLE), draw(st.floats(0.1, 3.0)))
    return arm, joints


def rz(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])


def ry(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1.0]])


def move(x, y, z):
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


@given(arms_and_joints())
def test_forward_is_the_chain_of_the_joints_matrices(arm_and_joints):
    arm, joints = arm_and_joints
    q0, q1, q2, q3, q4 = np.add(joints, arm.offset)
    slide = move(arm.tilt[0] * q2, arm.tilt[1] * q2, q2)  # the leaning slide carries the arm
    chain = slide @ rz(q0) @ move(arm.upper_mm, 0, 0) @ rz(q1) @ move(arm.forearm_mm, 0, 0) @ rz(q3) @ ry(q4)
    pose = forward(arm, joints)
    np.testing.assert_allclose(pose.axis, chain[:3, 2], atol=1e-12)
    np.testing.assert_allclose(pose.tip, (chain @ move(0, 0, -arm.tool_mm))[:3, 3], atol=1e-9)


@given(arms_and_joints())
def test_inverse_undoes_forward(arm_and_joints):
    arm, joints = arm_and_joints
    found = on_nearest_revolutions(inverse(arm, forward(arm, joints)), joints)
    np.testing.assert_allclose(found, joints, atol=1e-8)


@given(st.lists(arms_and_joints(), min_size=1, max_size=1), st.integers(0, 2**32 - 1))
def test_many_poses_at_once_give_what_each_gives(arm_and_joints, seed):
    arm = arm_and_joints[0][0]
    rng = np.random.default_rng(seed)
    tips = rng.uniform(-900, 900, (20, 3))
    axes = rng.normal(size=(20, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    for row, tip, axis in zip(inverse_many(arm, tips, axes), tips, axes, strict=True):
        try:
            expected = inverse(arm, Pose(tuple(tip), tuple(axis)))
        except OutOfReachError:
            assert np.all(np.isnan(row))
        else:
            np.testing.assert_allclose(row, expected, atol=1e-9)


def test_a_right_elbow_lies_to_the_right_of_the_line_to_the_wrist():
    pose = forward(RIGHT, (0.3, 1.0, 200.0, 0.2, 0.5))
    left = inverse(calibrated_arm(NOMINAL, tool_mm=TOOL_MM, elbow="left"), pose)
    right = inverse(RIGHT, pose)
    assert right[1] == pytest.approx(1.0)
    assert left[1] == pytest.approx(-1.0)
    wrist = np.add(pose.tip, np.multiply(TOOL_MM, pose.axis))
    elbow = 450 * np.array([math.cos(right[0]), math.sin(right[0])])
    assert wrist[0] * elbow[1] - wrist[1] * elbow[0] < 0  # z of wrist x elbow: clockwise from the line


def test_the_record_gives_the_true_arm():
    arm = calibrated_arm(CALIBRATED, tool_mm=100.0, elbow="left", hold_roll_rad=0.25)
    assert (arm.upper_mm, arm.forearm_mm) == (451.5, 429.25)
    assert (arm.tool_mm, arm.right, arm.hold_roll_rad) == (100.0, False, 0.25)
    np.testing.assert_allclose(np.degrees(arm.offset)[[0, 1, 3, 4]], [0.5, -0.4, 0.3, -0.2])
    assert arm.offset[2] == 0.8
    assert arm.tilt == (0.003, -0.005)


def vertical_at(radius):
    return Pose((radius, 0.0, 0.0), (0.0, 0.0, 1.0))


@pytest.mark.parametrize(
    ("radius", "text"), [(900.001, "900.001000 mm"), (math.nan, "nan"), (math.inf, "inf")]
)
def test_a_wrist_beyond_the_links_is_out_of_reach_with_the_radius(radius, text):
    with pytest.raises(OutOfReachError, match=f"{text}.*out of reach.*900.000000"):
        inverse(RIGHT, vertical_at(radius))


def test_a_wrist_too_near_to_unequal_links_is_out_of_reach():
    arm = ControllerArm(upper_mm=450, forearm_mm=300, tool_mm=0, right=True, hold_roll_rad=0.0)
    with pytest.raises(OutOfReachError, match=r"149.999000 mm.*\[150.000000, 750.000000\]"):
        inverse(arm, vertical_at(149.999))
    assert inverse(arm, vertical_at(150.0))[1] == pytest.approx(math.pi)
    assert inverse(arm, vertical_at(750.0))[1] == 0.0


def test_a_vertical_axis_needs_a_held_roll():
    with pytest.raises(SingularError, match="vertical"):
        inverse(RIGHT, vertical_at(500.0))
    arm = ControllerArm(upper_mm=450, forearm_mm=450, tool_mm=160, right=True, hold_roll_rad=0.7)
    assert inverse(arm, vertical_at(500.0))[3:] == (0.7, 0.0)
    tips, axes = np.array([[500.0, 0, 0]] * 2), np.array([[0, 0, 1.0], [0, 0, -1.0]])
    assert inverse_many(arm, tips, axes)[:, 3].tolist() == [0.7, 0.7]
    assert np.isnan(inverse_many(RIGHT, tips, axes)[:, 3]).all()


@pytest.mark.parametrize(
    ("angle", "wrapped"),
    [(math.pi, math.pi), (-math.pi, math.pi), (0.0, 0.0), (3 * math.pi, math.pi), (-4.0, math.tau - 4.0)],
)
def test_wrap_is_the_half_open_turn(angle, wrapped):
    assert wrap(angle) == pytest.approx(wrapped)
    assert wrap_many(np.array([angle]))[0] == pytest.approx(wrapped)


def test_turns_are_kept():
    start = (3.0 + 2 * math.tau, 1.0, 2.0, -3.0 - math.tau, 0.5)
    assert on_nearest_revolutions((-3.0, 1.1, 2.1, 3.0, 0.6), start) == pytest.approx(
        (-3.0 + 3 * math.tau, 1.1, 2.1, 3.0 - 2 * math.tau, 0.6)
    )


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 1.0, 2.0, math.radians(179.0)])
def test_the_turn_of_an_axis_is_exact_for_small_and_large_angles(angle):
    end = (math.sin(angle), 0.0, math.cos(angle))
    assert angle_between((0.0, 0.0, 1.0), end) == pytest.approx(angle, rel=1e-12, abs=1e-16)


@given(st.floats(0, 1), st.floats(0, 3.1), ANGLE, ANGLE)
def test_a_pose_between_has_its_tip_on_the_line_and_its_axis_at_constant_rate(fraction, turn, azimuth, twist):
    first, second = tilted(math.degrees(twist), math.degrees(azimuth))[0], None
    across = tilted(math.degrees(twist + math.pi / 2), math.degrees(azimuth))[0]
    second = math.cos(turn) * first + math.sin(turn) * across
    start, end = Pose((0.0, 0.0, 0.0), tuple(first)), Pose((10.0, -20.0, 5.0), tuple(second))
    pose = interpolate(start, end, fraction)
    expected = math.cos(fraction * turn) * first + math.sin(fraction * turn) * across
    np.testing.assert_allclose(pose.axis, expected, atol=1e-9)
    np.testing.assert_allclose(pose.tip, np.multiply(fraction, end.tip), atol=1e-12)


def test_the_ends_of_a_segment_are_exact():
    start, end = Pose((0.1, 0.2, 0.3), (0.6, 0.0, 0.8)), Pose((1.1, 2.2, 3.3), (0.0, 0.6, 0.8))
    assert interpolate(start, end, 0.0) is start
    assert interpolate(start, end, 1.0) is end


def test_joints_are_followed_through_more_than_half_a_turn():
    """The wrist passes close behind the column, q0 turns by far more than the nearest turn would say."""
    arm = ControllerArm(upper_mm=450, forearm_mm=440, tool_mm=0.0, right=True)
    axis = tuple(tilted(90.0, 0.0)[0])
    start, end = Pose((-30.0, -200.0, 0.0), axis), Pose((-30.0, 200.0, 0.0), axis)
    joints = inverse(arm, start)
    dense = joints
    for fraction in np.linspace(0, 1, 4001):
        dense = on_nearest_revolutions(inverse(arm, interpolate(start, end, float(fraction))), dense)
    assert abs(dense[0] - joints[0]) > 2.5
    np.testing.assert_allclose(follow(arm, start, end, joints), dense, atol=1e-9)


def test_a_segment_through_the_column_cannot_be_followed():
    arm = ControllerArm(upper_mm=450, forearm_mm=450, tool_mm=0.0, right=True)
    axis = tuple(tilted(90.0, 0.0)[0])
    start, end = Pose((-200.0, 0.0, 0.0), axis), Pose((200.0, 0.0, 0.0), axis)
    with pytest.raises(KinematicsError, match=r"jumps at fraction 0\.(5000|4999)"):
        follow(arm, start, end, inverse(arm, start))


def test_a_segment_through_the_vertical_cannot_be_followed():
    start, end = (Pose((500.0, 0.0, 0.0), tuple(axis)) for axis in tilted([30.0, 20.0], [0.0, 180.0]))
    with pytest.raises(SingularError, match="vertical"):
        follow(RIGHT, start, end, inverse(RIGHT, start))


def test_a_segment_that_leaves_the_reach_cannot_be_followed():
    arm = ControllerArm(upper_mm=450, forearm_mm=300, tool_mm=0.0, right=True)
    axis = tuple(tilted(90.0, 0.0)[0])
    start, end = Pose((-300.0, 10.0, 0.0), axis), Pose((300.0, 10.0, 0.0), axis)
    with pytest.raises(OutOfReachError, match="out of reach"):
        follow(arm, start, end, inverse(arm, start))


def test_limits_that_are_not_kept_are_named_in_degrees_and_mm():
    lower, upper = (-1.0, 0.0, 50.0, -1.0, 0.0), (1.0, 2.0, 450.0, 1.0, 1.0)
    assert limit_text((1.0, 0.0, 50.0, -1.0, 0.5), lower, upper) == ""
    text = limit_text((1.1, 0.0, 49.0, math.nan, 0.5), lower, upper)
    assert text == (
        "q0 = 63.025357 deg is outside [-57.295780, 57.295780], "
        "q2 = 49.000000 mm is outside [50.000000, 450.000000], "
        "q3 = nan deg is outside [-57.295780, 57.295780]"
    )
    assert as_joints(np.array(lower)) == lower
