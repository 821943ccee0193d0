"""The reference itself: against sampling so dense that nothing of it need be believed."""

import ast
from pathlib import Path

import numpy as np
import pytest

from tests.oracle import dense
from tests.oracle.dense import COLUMNS, SIDES, Dense
from tests.runtime.verification.random_paths import random_paths


def drawn(seed, count=40):
    return random_paths(np.random.default_rng([20260501, seed]), (3, 6), count)


def test_the_reference_imports_nothing_of_ours():
    tree = ast.parse(Path(dense.__file__).read_text(encoding="utf-8"))
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    imported |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert imported == {"math", "dataclasses", "numpy"}


@pytest.mark.parametrize("seed", range(3))
def test_distances_to_the_sides_are_those_to_the_nearest_of_a_hundred_thousand_places(seed):
    rng = np.random.default_rng(seed)
    for problem in drawn(seed):
        d = Dense(problem, 2)
        points = rng.uniform(-1000, 1000, (5, 2))
        inner, outer = (d.q1[1], d.q1[0]) if d.sign > 0 else (d.q1[0], d.q1[1])
        q0, q1 = np.linspace(d.lo[0], d.hi[0], 100_001), np.linspace(*d.q1, 100_001)
        sides = {"inner": (q0, inner), "outer": (q0, outer), "left": (d.hi[0], q1), "right": (d.lo[0], q1)}
        for name in SIDES:
            shoulder, elbow = sides[name]
            x = d.a0 * np.cos(shoulder) + d.a1 * np.cos(shoulder + elbow)
            y = d.a0 * np.sin(shoulder) + d.a1 * np.sin(shoulder + elbow)
            sampled = np.hypot(points[:, :1] - x, points[:, 1:] - y).min(axis=1)
            found = d.side_distance(points, name)
            assert (found <= sampled + 1e-9).all()
            assert np.abs(found - sampled).max() < 0.05


@pytest.mark.parametrize("seed", range(3))
def test_forward_kinematics_brings_its_joints_back_to_the_path(seed):
    for problem in drawn(seed):
        d = Dense(problem, 5)
        tip, axis = d.poses(d.samples.segment, d.samples.s)
        q = d.samples.q
        heading, azimuth = q[:, 0] + q[:, 1], q[:, 0] + q[:, 1] + q[:, 3]
        planar = np.stack(
            (
                d.a0 * np.cos(q[:, 0]) + d.a1 * np.cos(heading),
                d.a0 * np.sin(q[:, 0]) + d.a1 * np.sin(heading),
            ),
            axis=1,
        )
        wrist = np.hstack((planar + q[:, 2:3] * problem.calibration.slide_tilt, q[:, 2:3]))
        back = np.stack(
            (np.sin(q[:, 4]) * np.cos(azimuth), np.sin(q[:, 4]) * np.sin(azimuth), np.cos(q[:, 4])), axis=1
        )
        rows = np.isfinite(q).all(axis=1)
        assert np.abs(back - axis)[rows].max(initial=0.0) < 1e-9
        assert np.abs(wrist - problem.tool_length_mm * back - tip)[rows].max(initial=0.0) < 1e-6


@pytest.mark.parametrize("seed", range(3))
def test_minima_are_those_of_ten_thousand_poses_a_segment_or_lower(seed):
    for problem in drawn(seed, 12):
        coarse, fine = Dense(problem, 48), Dense(problem, 10_000)
        found, sampled = (
            coarse.minima(),
            np.nanmin(np.where(np.isnan(fine.values), np.inf, fine.values), axis=0),
        )
        turning = [COLUMNS.index(name) for name in ("roll_min", "roll_max", "q0_min", "q0_max")]
        settled = fine.inside.all() and coarse.inside.all()
        for column, name in enumerate(COLUMNS[: COLUMNS.index("speed0")]):
            if settled or column not in turning:
                assert found[column] <= sampled[column] + 1e-6, name
