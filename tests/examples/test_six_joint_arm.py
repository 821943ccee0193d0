"""The six-joint arm against its own joints: forward kinematics by matrices, found independently of its distances."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cutgate.runtime.library.other_arms import certify
from examples.six_joint_arm import (
    ArmDistance,
    PosePath,
    SixJointArm,
    WristDistance,
    main,
    pocket,
    verify,
)

ARM = SixJointArm()
DEG = math.pi / 180


def about(axis, angle):
    """Rotation matrices (n, 3, 3) about y or z."""
    c, s, o, i = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    rows = {"y": (c, o, s, o, i, o, -s, o, c), "z": (c, -s, o, s, c, o, o, o, i)}[axis]
    return np.stack(rows, axis=1).reshape(-1, 3, 3)


def forward(arm, q):
    """Wrist centre (n, 3) and tool axis, tip to holder, (n, 3) of joints q1..q5 (n, 5), by products of rotations.

    Links along x when all joints are zero; pitch joints turn about -y, so that up is positive; q4 about the forearm.
    """
    x = np.array([1.0, 0.0, 0.0])
    yaw = about("z", q[:, 0])
    upper = yaw @ about("y", -q[:, 1])
    fore = upper @ about("y", -q[:, 2])
    wrist = arm.base_mm * np.array([0, 0, 1.0]) + arm.upper_mm * upper @ x + arm.forearm_mm * fore @ x
    spin = about("z", q[:, 3])  # about x: the cyclic permutation of one about z
    cycle = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])
    tool = fore @ (cycle @ spin @ cycle.T) @ about("y", -q[:, 4]) @ x
    return wrist, -tool


def solved(arm, wrist):
    """q1, q2, q3 of wrist centres, elbow up, by the law of cosines; NaN out of reach."""
    rho, z = np.hypot(wrist[:, 0], wrist[:, 1]), wrist[:, 2] - arm.base_mm
    d = np.hypot(rho, z)
    with np.errstate(invalid="ignore"):
        at_shoulder = np.arccos((arm.upper_mm**2 + d**2 - arm.forearm_mm**2) / (2 * arm.upper_mm * d))
        at_elbow = np.arccos(
            (arm.upper_mm**2 + arm.forearm_mm**2 - d**2) / (2 * arm.upper_mm * arm.forearm_mm)
        )
    q2, q3 = np.arcsin(z / d) + at_shoulder, at_elbow - math.pi
    return np.stack((np.arctan2(wrist[:, 1], wrist[:, 0]), q2, q3), axis=1)


LIMITS = np.array([ARM.yaw, ARM.shoulder, ARM.elbow])


def margins(arm, wrist, axes):
    """Joint margins, rad: of q1..q3 (n, 3) and of q5 (n,)."""
    q = solved(arm, wrist)
    zero = np.zeros((len(q), 2))
    _, backward = forward(arm, np.concatenate((q, zero), axis=1))
    q5 = np.arccos(np.clip((backward * axes).sum(axis=1), -1, 1))
    return np.minimum(q - LIMITS[:, 0], LIMITS[:, 1] - q), np.minimum(q5 - arm.pitch[0], arm.pitch[1] - q5)


def random_joints(rng, n, inside=0.0):
    spans = np.array([ARM.yaw, ARM.shoulder, ARM.elbow, (-3.0, 3.0), ARM.pitch])
    return rng.uniform(spans[:, 0] + inside, spans[:, 1] - inside, (n, 5))


def test_distances_and_forward_kinematics_agree_on_joints_and_pitch():
    q = random_joints(np.random.default_rng(0), 3000)
    wrist, axes = forward(ARM, q)
    kept = np.hypot(wrist[:, 0], wrist[:, 1]) > ARM.axis_mm
    kept &= (
        np.abs(np.angle(np.exp(1j * (np.arctan2(wrist[:, 1], wrist[:, 0]) - q[:, 0])))) < 1.0
    )  # not reaching back
    wrist, axes, q = wrist[kept], axes[kept], q[kept]
    assert len(q) > 1500
    points = np.concatenate((wrist, axes), axis=1)
    np.testing.assert_allclose(solved(ARM, wrist), q[:, :3], atol=1e-8)
    np.testing.assert_allclose(WristDistance(ARM).pitch(points), q[:, 4], atol=1e-8)
    assert (ArmDistance(ARM)(points) > -1e-9).all()


@given(seed=st.integers(0, 10_000))
@settings(deadline=None, max_examples=40)
def test_a_ball_of_the_arms_distance_is_reachable_with_the_same_elbow(seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform((-800, -800, -400, 0, 0, 0), (800, 800, 1200, 1, 1, 1), (300, 6))
    d = ArmDistance(ARM)(points)
    points, d = points[d > 0], d[d > 0]
    off = rng.normal(size=(len(points), 3))
    off *= (d - 1e-6)[:, None] / np.linalg.norm(off, axis=1)[:, None]
    moved = points[:, :3] + off
    assert (margins(ARM, moved, points[:, 3:])[0] >= 0.0).all()
    assert (np.hypot(moved[:, 0], moved[:, 1]) >= ARM.axis_mm).all()


@given(seed=st.integers(0, 10_000))
@settings(deadline=None, max_examples=40)
def test_the_arms_distance_is_at_most_one_steep(seed):
    rng = np.random.default_rng(seed)
    one = rng.uniform(-900, 900, (300, 6))
    two = one + rng.normal(0, 30, one.shape)
    d = ArmDistance(ARM)
    assert (np.abs(d(one) - d(two)) <= np.linalg.norm((one - two)[:, :3], axis=1) + 1e-6).all()


def test_the_forearm_turns_no_faster_than_stated_and_nearly_that_fast_somewhere():
    rng = np.random.default_rng(1)
    largest = 0.0
    for arm in (ARM, replace(ARM, axis_mm=300.0), replace(ARM, elbow=(-100 * DEG, -5 * DEG))):
        spans = np.array([arm.yaw, arm.shoulder, arm.elbow, (0, 0), (0, 0)])
        q = rng.uniform(spans[:, 0], spans[:, 1], (40_000, 5))
        wrist, _ = forward(arm, q)
        wrist = wrist[ArmDistance(arm)(np.concatenate((wrist, wrist), axis=1)) > 0.01]
        move = rng.normal(size=wrist.shape)
        move *= 1e-4 / np.linalg.norm(move, axis=1)[:, None]
        turned = np.linalg.norm(arm.forearm(wrist + move) - arm.forearm(wrist), axis=1)
        rate = turned.max() / 1e-4
        assert rate <= arm.turn_per_mm * (1 + 1e-4)
        largest = max(largest, rate / arm.turn_per_mm)
    assert largest > 0.8


def dense(arm, tips, axes, parts=60):
    path = PosePath(tips, axes, arm.tool_mm, 1.0, 0.0)
    n = len(tips) - 1
    points = path.at(np.repeat(np.arange(n), parts), np.tile(np.linspace(0, 1, parts), n))
    return points, *margins(arm, points[:, :3], points[:, 3:])


@pytest.mark.parametrize(
    ("place", "arm_admitted", "wrist_admitted"),
    [((600, 120, 210, 5), True, True), ((800, 120, 210, 5), False, None), ((600, 120, 210, 30), True, False)],
    ids=["as planned", "too far out", "tool along the forearm"],
)
def test_dense_sampling_of_the_joints_agrees_with_each_decision(place, arm_admitted, wrist_admitted):
    tips, axes = pocket(*place)
    found = verify(ARM, tips, axes, 5.0, 2 * DEG)
    points, joints, pitch = dense(ARM, tips, axes)
    assert found.arm.admissible is arm_admitted
    assert found.admissible is bool(wrist_admitted)
    if not arm_admitted:
        assert found.arm.outcome == "inadmissible"
        assert found.wrist is None
        assert not (joints.min() >= 0.0)  # NaN where out of reach
        return
    assert joints.min() > 0.0
    assert found.arm.certified <= ArmDistance(ARM)(points).min() <= found.arm.attained + 0.2
    assert found.wrist.outcome == ("admissible" if wrist_admitted else "inadmissible")
    assert found.wrist.certified <= pitch.min() <= found.wrist.attained + 0.2 * DEG
    assert bool(pitch.min() >= 2 * DEG) is wrist_admitted


@given(seed=st.integers(0, 10_000))
@settings(deadline=None, max_examples=60)
def test_random_admitted_paths_keep_the_wrists_deadband_everywhere(seed):
    rng = np.random.default_rng(seed)
    q = random_joints(rng, 1, inside=0.05) + np.cumsum(rng.normal(0, 0.12, (4, 5)), axis=0)
    wrist, axes = forward(ARM, q)
    tips = wrist - ARM.tool_mm * axes
    found = verify(ARM, tips, axes, 1.0, 1 * DEG)
    _, joints, pitch = dense(ARM, tips, axes)
    if found.admissible:
        assert joints.min() > 0.0
        assert pitch.min() >= 1 * DEG
        assert found.wrist.certified <= pitch.min()
    if found.wrist is not None and found.wrist.outcome == "inadmissible":
        assert pitch.min() < 1.2 * DEG


def test_a_march_on_the_axis_angle_alone_admits_what_the_moving_forearm_violates():
    """The axis does not turn, so its own path has no length; moving the wrist centre swings the forearm past it."""
    wrist = np.array([[400.0, -150.0, 300.0], [400.0, 150.0, 300.0]])
    along = ARM.forearm(wrist.mean(axis=0, keepdims=True))
    axes = -np.repeat((about("y", np.array([8.5 * DEG])) @ along[..., None])[..., 0], 2, axis=0)
    tips = wrist - ARM.tool_mm * axes
    _, _, pitch = dense(ARM, tips, axes)
    assert min(pitch[0], pitch[-1]) > 2 * DEG > 1 * DEG > pitch.min()
    alone = PosePath(tips, axes, ARM.tool_mm, per_mm=0.0, per_rad=1.0)
    assert certify(alone, WristDistance(ARM), 2 * DEG).admissible
    assert verify(ARM, tips, axes, 5.0, 2 * DEG).wrist.outcome == "inadmissible"


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"elbow": (-145 * DEG, 0.0)}, "elbow"),
        ({"elbow": (-145 * DEG, -2 * DEG)}, "elbow"),
        ({"elbow": (-179 * DEG, -15 * DEG)}, "elbow"),
        ({"elbow": (-100 * DEG, 20 * DEG)}, "elbow"),
        ({"elbow": (-100 * DEG, math.nan)}, "elbow"),
        ({"axis_mm": 0.0}, "axis"),
        ({"axis_mm": math.nan}, "axis"),
        ({"pitch": (0.0, 1.0)}, "pitch"),
        ({"pitch": (-1.0, 1.0)}, "pitch"),
        ({"pitch": (math.nan, 1.0)}, "pitch"),
        ({"yaw": (-math.pi, math.pi)}, "yaw"),
    ],
)
def test_an_arm_whose_limits_leave_a_singular_position_in_is_refused(change, word):
    with pytest.raises(ValueError, match=word):
        replace(ARM, **change)


def test_the_example_certifies_one_path_and_refuses_two(capsys):
    main()
    shown = capsys.readouterr().out
    assert shown.count(": admissible") == 1
    assert shown.count(": refused") == 2
