"""Random problems over everything the gate must cope with: arms, limits, calibrations, tools and paths.

Each feature is drawn on its own, so that they meet in all combinations; what is drawn depends on the
generator alone. Forward kinematics is written out here, not taken from the package under test.
"""

import math
from dataclasses import replace

import numpy as np

from cutgate.runtime.verification.problem import Arm, ArmCalibration, Deadband, Problem
from tests.runtime.verification.cases import DEG

LARGEST_TURN = 170 * DEG
"""In one segment."""

FREE = 36000 * DEG


def random_path(rng, segments, lean=0.02):
    """A problem with a path of so many segments; the slide leans by up to ``lean`` each way where calibrated."""
    elbow = str(rng.choice(["right", "left"]))
    arm = Arm(*_links(rng), elbow)
    calibration = _calibration(rng, lean) if rng.random() < 0.4 else ArmCalibration()
    lower, upper = _limits(rng, 1.0 if elbow == "right" else -1.0)
    joints = _walk(rng, segments, lower, upper)
    tool = float(rng.choice([0.0, 1.0, 20.0, 80.0, 200.0], p=[0.05, 0.25, 0.25, 0.25, 0.2]))
    centres, axes = _forward(arm, calibration, joints)
    if rng.random() < 0.35:
        axes = _large_turns(rng, axes)
        lower[3:], upper[3:] = (-FREE, 0.0), (FREE, math.pi)
    tips = centres - tool * axes
    tips, axes = _degenerate(rng, tips, axes / np.linalg.norm(axes, axis=1, keepdims=True))
    if (np.einsum("ij,ij->i", axes[:-1], axes[1:]) < math.cos(LARGEST_TURN)).any():
        return random_path(rng, segments, lean)
    if rng.random() < 0.25:
        _close_in(rng, lower, upper, joints)
    if rng.random() < 0.08:
        _leave_out_the_start(rng, lower, upper, joints)
    return Problem(
        tips_mm=tips,
        axes=axes,
        feed_mm_s=float(rng.uniform(5, 50)),
        tool_length_mm=tool,
        arm=arm,
        lower=lower,
        upper=upper,
        speed=np.full(5, 1e9) if rng.random() < 0.6 else np.array([1.0, 1.0, 200.0, 2.0, 2.0]),
        deadband=Deadband(
            float(rng.choice([1e-4, 0.01, 1.0, 5.0])),
            float(rng.choice([1e-4, 0.01, 0.5, 2.0])) * DEG,
            float(rng.choice([0.0, 0.0, 0.0, 0.2])),
            float(rng.choice([0.0, 0.0, 0.0, 0.001])),
        ),
        calibration=calibration,
    )


def random_paths(rng, segments, count, lean=0.02):
    """Problems until they have ``count`` segments together; single segments, handfuls, and long paths."""
    drawn = []
    while count > 0:
        n = min(count, int(rng.choice([1, rng.integers(2, 9), rng.integers(*segments)], p=[0.25, 0.5, 0.25])))
        drawn.append(random_path(rng, n, lean))
        count -= n
    return drawn


def _links(rng):
    a0, a1 = rng.uniform(200, 600, 2)
    return (float(a0), float(a0 if rng.random() < 0.25 else a1))


def _calibration(rng, lean):
    return ArmCalibration(
        *rng.uniform(-2, 2, 2),
        joint_offset=rng.uniform(-1, 1, 5) * (0.02, 0.02, 3, 0.02, 0.02),
        slide_tilt=rng.uniform(-lean, lean, 2),
        residual_mm=float(rng.choice([0.0, 0.3])),
        residual_rad=float(rng.choice([0.0, 0.002])),
    )


def _limits(rng, side):
    """Shoulder from 2 deg to beyond a full turn, thin gaps; elbow that extends or folds fully, or neither."""
    span = (
        rng.uniform(2 * DEG, 0.2),
        rng.uniform(0.3, 5.5),
        2 * math.pi - 10.0 ** rng.uniform(-5, -1),
        2 * math.pi + rng.choice([0.0, rng.uniform(0, 3)]),
    )[rng.choice(4, p=[0.15, 0.5, 0.2, 0.15])]
    centre = (math.pi, 0.0, rng.uniform(-math.pi, math.pi))[rng.choice(3)]
    bend = np.sort(rng.uniform(0, math.pi, 2))
    extends, folds = rng.random(2) < 0.3
    bend = np.sort((0.0 if extends else bend[0], math.pi if folds else bend[1])) * side
    roll = rng.uniform(-math.pi, math.pi)
    room = rng.uniform(0.5, 7.0)
    lower = np.array(
        [centre - span / 2, bend.min(), rng.uniform(-300, 0), roll - room, rng.choice([0.0, 0.3])]
    )
    upper = np.array(
        [centre + span / 2, bend.max(), rng.uniform(200, 700), roll + room, rng.uniform(1.5, math.pi)]
    )
    return lower, upper


def _walk(rng, segments, lower, upper):
    """A random walk through the joint rectangle, in steps from tiny to sweeping."""
    size = rng.choice([1e-5, 1e-3, 0.02, 0.2])
    steps = rng.normal(0, size, (segments + 1, 5))
    part = rng.uniform(0.15, 0.85, 5) + np.cumsum(steps, axis=0)
    part = 0.5 - np.abs(np.remainder(part, 2.0) - 1.0) + 0.5  # reflected at the limits
    part = 0.03 + 0.94 * part
    span = np.minimum(upper - lower, 3 * math.pi)
    span[2] = upper[2] - lower[2]
    return (lower + upper) / 2 + (part - 0.5) * span


def _forward(arm, calibration, joints):
    """Wrist centres and axes of reported joints."""
    q = joints + calibration.joint_offset
    a0, a1 = (
        arm.upper_mm + calibration.upper_link_error_mm,
        arm.forearm_mm + calibration.forearm_link_error_mm,
    )
    heading, azimuth = q[:, 0] + q[:, 1], q[:, 0] + q[:, 1] + q[:, 3]
    lean = q[:, 2:3] * calibration.slide_tilt
    planar = np.stack(
        (a0 * np.cos(q[:, 0]) + a1 * np.cos(heading), a0 * np.sin(q[:, 0]) + a1 * np.sin(heading)), axis=1
    )
    axes = np.stack(
        (np.sin(q[:, 4]) * np.cos(azimuth), np.sin(q[:, 4]) * np.sin(azimuth), np.cos(q[:, 4])), axis=1
    )
    return np.hstack((planar + lean, q[:, 2:3])), axes


def _large_turns(rng, axes):
    """Axes that turn by up to 170 deg in a segment, about any normal or close past the vertical."""
    out = [axes[0]]
    largest = LARGEST_TURN * rng.choice([1.0, 0.3])
    for _ in axes[1:]:
        normal = rng.normal(size=3)
        if rng.random() < 0.2:
            normal[2] *= 10.0 ** rng.uniform(-5, -1)  # a great circle that comes near the pole
        normal -= (normal @ out[-1]) * out[-1]
        normal /= np.linalg.norm(normal)
        angle = rng.uniform(0, largest)
        out.append(out[-1] * math.cos(angle) + np.cross(normal, out[-1]) * math.sin(angle))
    return np.array(out)


def _degenerate(rng, tips, axes):
    """Sometimes duplicate poses, tips that stand still while the axis turns, and the other way round."""
    kind = rng.random()
    moves = rng.random(len(tips)) > 0.3
    held = np.cumsum(moves) - moves[0]
    if kind < 0.1:
        return tips[held], axes[held]
    if kind < 0.2:
        return tips[held], axes
    if kind < 0.3:
        return tips, axes[held]
    return tips, axes


def _close_in(rng, lower, upper, joints):
    """Limits close around the joints of the poses: what lies between the poses may leave them."""
    slack = 10.0 ** rng.uniform(-6, -1)
    for j in rng.choice(5, rng.integers(1, 4), replace=False):
        spare = slack * (100.0 if j == 2 else 1.0)
        lower[j] = max(lower[j], joints[:, j].min() - spare)
        upper[j] = min(upper[j], joints[:, j].max() + spare)


def _leave_out_the_start(rng, lower, upper, joints):
    j = int(rng.choice([0, 1, 2]))
    if rng.random() < 0.5:
        lower[j] = joints[0, j] + 0.2 * (upper[j] - joints[0, j])
    else:
        upper[j] = joints[0, j] - 0.2 * (joints[0, j] - lower[j])


def with_deadband(problem, arm_mm, wrist_rad):
    """The same problem with other deadbands, residuals and tolerances besides, and speeds that never decide."""
    deadband = replace(problem.deadband, arm_mm=arm_mm, wrist_rad=wrist_rad)
    return replace(problem, deadband=deadband, speed=np.full(5, 1e12))
