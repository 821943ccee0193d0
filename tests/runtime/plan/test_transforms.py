"""From the files to the robot frame: ``R_p = R_T_CT * CT_T_I * I_p`` with rotations that do not commute.

The reference composes unit quaternions pose by pose and shares no matrix with the code.
"""

import json
import math
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from cutgate.config.load import robot_from_bytes
from cutgate.config.records import calibration_record, limits_record, tool_record
from cutgate.runtime.plan.load import load_plan, load_registration
from cutgate.runtime.plan.prepare import prepare
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.recorded import problem_from_records

PRESET = Path(__file__).parents[3] / "config" / "presets" / "example.toml"
ROBOT = robot_from_bytes("example.toml", PRESET.read_bytes())
NOW = datetime(2026, 6, 1, tzinfo=UTC)
WIRE_MM, WIRE_UNIT = 0.5e-3 + 1e-9, 1e-6
SEEDS = range(20)


def times(p, q):
    """Hamilton's product of quaternions (w, x, y, z)."""
    a, u, b, v = p[0], p[1:], q[0], q[1:]
    return np.concatenate(([a * b - u @ v], a * v + b * u + np.cross(u, v)))


def turned(q, v):
    """A vector turned by a unit quaternion."""
    return times(times(q, np.concatenate(([0.0], v))), q * (1, -1, -1, -1))[1:]


def random_rigid(rng):
    """A large turn about any axis, as a unit quaternion, and a translation."""
    axis = rng.normal(size=3)
    half = rng.uniform(0.3, 2.8) / 2
    q = np.concatenate(([math.cos(half)], math.sin(half) * axis / np.linalg.norm(axis)))
    return q, rng.uniform(-400, 400, 3)


def matrix(q, t):
    """Row-major 4x4 for a file: columns are the turned unit vectors."""
    out = np.eye(4)
    out[:3, :3] = np.stack([turned(q, e) for e in np.eye(3)], axis=1)
    out[:3, 3] = t
    return out.tolist()


def composed(outer, inner, tips, axes):
    """First the inner transform, then the outer one."""
    (q2, t2), (q1, t1) = outer, inner
    moved = np.array([turned(q2, turned(q1, p) + t1) + t2 for p in tips])
    return moved, np.array([turned(q2, turned(q1, u)) for u in axes])


def files(directory, registration, placement, tips, axes):
    """Plan and registration as a clinic would hand them over."""
    plan, registered = directory / "plan.json", directory / "registration.json"
    plan.write_text(
        json.dumps(
            {
                "schema": "cutgate.plan/1",
                "id": "p",
                "implant": "stem",
                "side": "left",
                "units": "mm",
                "feed_mm_s": 20.0,
                "ct_T_implant": matrix(*placement),
                "poses": np.hstack((tips, axes)).tolist(),
            }
        )
    )
    registered.write_text(
        json.dumps(
            {
                "schema": "cutgate.registration/1",
                "id": "r",
                "R_T_CT": matrix(*registration),
                "residual_rms_mm": 0.3,
                "created_utc": "2026-01-02T03:04:05Z",
            }
        )
    )
    return load_plan(plan), load_registration(registered)


def random_case(seed):
    rng = np.random.default_rng([20260401, seed])
    registration, placement = random_rigid(rng), random_rigid(rng)
    axes = np.array([0.3, 0.2, 1.0]) + rng.normal(0, 0.1, (6, 3))
    tips = np.cumsum(rng.normal(0, 20, (6, 3)), axis=0)
    return registration, placement, tips, axes / np.linalg.norm(axes, axis=1, keepdims=True)


@pytest.mark.parametrize("seed", SEEDS)
def test_registration_and_implant_placement_are_composed_in_this_order(seed, tmp_path):
    registration, placement, tips, axes = random_case(seed)
    path = prepare(
        *files(tmp_path, registration, placement, tips, axes), ROBOT, now=NOW, clock_skew_s=0.0
    ).path
    expected_tips, expected_axes = composed(registration, placement, tips, axes)
    assert np.abs(path.tips_mm - expected_tips).max() <= WIRE_MM
    assert np.abs(path.axes - expected_axes).max() <= WIRE_UNIT
    other_way_tips, other_way_axes = composed(placement, registration, tips, axes)
    assert np.abs(other_way_tips - expected_tips).max() > 1.0  # they do not commute
    assert np.abs(other_way_axes - expected_axes).max() > 1e-3
    backward = (registration[0] * (1, -1, -1, -1), registration[1])  # a transposed rotation
    assert np.abs(composed(backward, placement, tips, axes)[0] - expected_tips).max() > 1.0


@pytest.mark.parametrize("seed", SEEDS)
def test_the_gate_verifies_the_composed_path(seed, tmp_path):
    """The verdict on the files is that on the reference's path, put where the robot reaches it."""
    registration, placement, tips, axes = random_case(seed)
    start = composed(registration, placement, tips[:1], axes[:1])[0][0]
    registration = (registration[0], registration[1] + (450.0, 60.0, 120.0) - start)
    path = prepare(
        *files(tmp_path, registration, placement, tips, axes), ROBOT, now=NOW, clock_skew_s=0.0
    ).path
    bodies = (limits_record(ROBOT).body(), calibration_record(ROBOT).body(), tool_record(ROBOT).body())
    asked = problem_from_records(path.body(), *bodies, ROBOT, any_branch=True)
    there_tips, there_axes = composed(registration, placement, tips, axes)
    there = certified.verify(replace(asked, tips_mm=there_tips, axes=there_axes))
    verdict = certified.verify(asked)
    assert verdict.tip_length_mm == pytest.approx(
        np.linalg.norm(np.diff(tips, axis=0), axis=1).sum(), abs=0.01
    )
    for name, b in verdict.boundaries.items():
        if not there.boundaries[name].violated:
            assert b.clearance == pytest.approx(there.boundaries[name].clearance, abs=0.02), name
