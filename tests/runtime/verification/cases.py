"""Random and hand-made problems for the tests of verification."""

import math
from dataclasses import replace

import numpy as np

from cutgate.runtime.kinematics.arm import TrueArm
from cutgate.runtime.verification.problem import Arm, ArmCalibration, Deadband, Problem

DEG = math.pi / 180.0
WIDE = 36000.0 * DEG


def problem(tips, axes, **changes):
    """The documented example robot with a path; any field can be changed."""
    values = {
        "tips_mm": np.asarray(tips, dtype=float),
        "axes": np.asarray(axes, dtype=float),
        "feed_mm_s": 10.0,
        "tool_length_mm": 160.0,
        "arm": Arm(450.0, 450.0, "right"),
        "lower": np.array([-80 * DEG, 0.0, 50.0, -170 * DEG, 0.0]),
        "upper": np.array([80 * DEG, 145 * DEG, 450.0, 170 * DEG, 110 * DEG]),
        "speed": np.array([1.0, 1.0, 200.0, 2.0, 2.0]),
        "deadband": Deadband(5.0, 2 * DEG),
    }
    return Problem(**(values | changes))


def axis(pitch, azimuth):
    """Unit axes from pitch and azimuth in rad."""
    pitch, azimuth = np.broadcast_arrays(np.asarray(pitch, float), np.asarray(azimuth, float))
    return np.stack(
        (np.sin(pitch) * np.cos(azimuth), np.sin(pitch) * np.sin(azimuth), np.cos(pitch)), axis=-1
    )


def wrist_path(centres, axes, tool=160.0):
    """Tips of a path given by its wrist centres."""
    axes = np.broadcast_to(np.asarray(axes, float), (len(centres), 3))
    return np.asarray(centres, float) - tool * axes, np.array(axes)


def limited(found, **ends):
    """With other limits: ``lower2=60.0``."""
    lower, upper = found.lower.copy(), found.upper.copy()
    for name, value in ends.items():
        (lower if name.startswith("lower") else upper)[int(name[-1])] = value
    return replace(found, lower=lower, upper=upper)


def threshold(holds, good, bad):
    """Where between the two it stops to hold, by bisection."""
    assert holds(good), "the rule does not hold where it should"
    assert not holds(bad), "nothing else is left to bind"
    for _ in range(60):
        middle = (good + bad) / 2
        good, bad = (middle, bad) if holds(middle) else (good, middle)
    return good


def random_problem(rng, *, calibrated=True, segments=3, wide=False, spinning=False):
    """A path through random joints of a random arm, from tiny steps to large sweeps."""
    elbow = rng.choice(["right", "left"])
    side = 1.0 if elbow == "right" else -1.0
    a0, a1 = rng.uniform(200, 600, 2)
    centre, span = rng.uniform(-math.pi, math.pi), rng.uniform(0.3, 5.5)
    if spinning:
        span = rng.uniform(6.3, 9.0)
    bend = np.sort(rng.uniform(0, math.pi, 2)) * side
    if rng.random() < 0.3:
        bend = np.array([0.0, side * rng.uniform(1.5, math.pi)])
    lower = np.array(
        [centre - span / 2, min(bend), rng.uniform(-300, 0), -rng.uniform(2, 7), rng.uniform(0, 0.5)]
    )
    upper = np.array(
        [centre + span / 2, max(bend), rng.uniform(200, 700), rng.uniform(2, 7), rng.uniform(1.5, math.pi)]
    )
    calibration = ArmCalibration()
    if calibrated and rng.random() < 0.7:
        calibration = ArmCalibration(
            *rng.uniform(-2, 2, 2),
            joint_offset=rng.uniform(-1, 1, 5) * (0.02, 0.02, 3, 0.02, 0.02),
            slide_tilt=rng.uniform(-0.02, 0.02, 2),
            residual_mm=rng.choice([0.0, 0.3]),
            residual_rad=rng.choice([0.0, 0.002]),
        )
    size = rng.choice([0.003, 0.05, 0.3]) if not wide else 0.5
    part = np.clip(
        rng.uniform(0.1, 0.9, 5) + np.cumsum(rng.normal(0, size, (segments + 1, 5)), axis=0), 0.02, 0.98
    )
    q = lower + part * (upper - lower)
    arm = TrueArm(
        a0 + calibration.upper_link_error_mm,
        a1 + calibration.forearm_link_error_mm,
        side,
        calibration.joint_offset,
        calibration.slide_tilt,
    )
    tool = float(rng.choice([1.0, 80.0, 200.0]))
    tips, axes = arm.pose(q, tool)
    return problem(
        tips,
        axes,
        feed_mm_s=float(rng.uniform(5, 50)),
        tool_length_mm=tool,
        arm=Arm(a0, a1, elbow),
        lower=lower,
        upper=upper,
        calibration=calibration,
        deadband=Deadband(float(rng.choice([0.01, 5.0])), float(rng.choice([0.01, 2.0])) * DEG),
    )


def turned(before, angle):
    """The same problem with the whole cell turned about the first joint: path, shoulder limits and slide tilt."""
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    add = np.array([angle, 0.0, 0.0, 0.0, 0.0])
    tilt = turn[:2, :2] @ before.calibration.slide_tilt
    return replace(
        before,
        tips_mm=before.tips_mm @ turn.T,
        axes=before.axes @ turn.T,
        lower=before.lower + add,
        upper=before.upper + add,
        calibration=replace(before.calibration, slide_tilt=tilt),
    )


def mirrored(before):
    """The mirror image in the plane y = 0: other elbow; q0, q1, q3, their limits and offsets and ty change sign."""
    flip = np.array([-1.0, -1.0, 1.0, -1.0, 1.0])
    found, arm = before.calibration, before.arm
    ends = np.stack((before.lower * flip, before.upper * flip))
    return replace(
        before,
        arm=replace(arm, elbow="left" if arm.elbow == "right" else "right"),
        tips_mm=before.tips_mm * (1, -1, 1),
        axes=before.axes * (1, -1, 1),
        lower=ends.min(axis=0),
        upper=ends.max(axis=0),
        calibration=replace(
            found, joint_offset=found.joint_offset * flip, slide_tilt=found.slide_tilt * (1, -1)
        ),
    )
