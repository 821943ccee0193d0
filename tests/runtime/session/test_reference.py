"""The reference trajectory that the arm is held against, beside the controller's own kinematics and plant."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cutgate.firmware_sim.approach import BoundApproach
from cutgate.firmware_sim.kinematics import as_joints
from cutgate.firmware_sim.plant import Leg, Plant, PlantState, StoredPath
from cutgate.protocol import records
from cutgate.protocol.records import joints_to_memory
from cutgate.runtime.interlock.tracking import CHORD_MM, CHORD_RAD
from cutgate.runtime.session.reference import KNOT_S, between, from_start
from cutgate.runtime.verification.recorded import problem_from_records
from cutgate.runtime.verification.steps import finished
from tests.runtime.session.pair import STANDS, check_of, job_of, request_of


@pytest.fixture(scope="module")
def asked(tmp_path_factory):
    return request_of(tmp_path_factory)


@pytest.fixture(scope="module")
def bound(tmp_path_factory):
    files, job = job_of(tmp_path_factory)
    return finished(check_of(job, files.robot.value).steps(0, STANDS)).verdict.approach


def trajectory_for(asked, bound, path=None):
    path = path or asked.path
    problem = problem_from_records(path, asked.limits, asked.calibration, asked.tool, asked.robot)
    return finished(from_start(between(problem, bound), STANDS))


def test_the_controllers_plant_is_on_the_course_at_every_moment_at_full_speed(asked, bound):
    """Another kinematics, another way of stepping: joints, progress and time all agree."""
    followed = trajectory_for(asked, bound)
    path = records.Path.parse(asked.path)
    plant = Plant(records.Limits.parse(asked.limits), records.Calibration.parse(asked.calibration))
    start, entry, leaving = (
        as_joints(joints_to_memory(u)) for u in (STANDS, bound.entry_joints_u, bound.exit_joints_u)
    )
    approach = BoundApproach(
        start=start,
        entry=entry,
        exit=leaving,
        entry_um=bound.entry_um,
        exit_um=bound.exit_um,
        speed=bound.speed_percent / 100,
    )
    state, passed_s, legs = PlantState(start), 0.0, set()
    stored = StoredPath.of(path.body())
    chord = np.array([CHORD_RAD, CHORD_RAD, CHORD_MM, CHORD_RAD, CHORD_RAD])
    while not state.done:
        state = plant.advance(state, stored, approach, dt_s=0.02, moving=True, cutter=True).state
        passed_s += 0.02
        legs.add(state.leg)
        if state.leg is Leg.CUT:
            assert followed.time_of(*state.progress) <= passed_s + 1e-6
            places = [followed.time_of(*state.progress)]
        else:  # the plant loses some of its time at the ends of legs
            places = np.clip(np.linspace(passed_s - 0.05, passed_s, 1001), 0.0, followed.end_s)
        off = min(np.max(np.abs(followed.joints_at(at_s) - state.joints) / chord) for at_s in places)
        assert off <= 2.0, state
    assert legs == set(Leg)
    assert followed.end_s == pytest.approx(passed_s, abs=0.05)


def test_a_dense_path_makes_no_longer_course(asked, bound):
    """Twenty thousand poses on the same way: what is watched costs by time, not by poses."""
    path = records.Path.parse(asked.path)
    at, poses = np.linspace(0, len(path) - 1, 20_001), np.arange(len(path))
    tips = np.stack([np.interp(at, poses, path.tips_mm[:, j]) for j in range(3)], axis=1)
    axes = np.stack([np.interp(at, poses, path.axes[:, j]) for j in range(3)], axis=1)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    dense = records.Path.quantised(
        tips,
        axes,
        feed_mm_s=path.feed_mm_s,
        tool_length_mm=path.tool_length_mm,
        elbow=path.elbow,
        q0_turns=path.q0_turns,
        roll_turns=path.roll_turns,
    )
    followed, plain = trajectory_for(asked, bound, dense.body()), trajectory_for(asked, bound)
    assert followed.segments == 20_000
    assert len(followed.times_s) <= followed.end_s / KNOT_S + 200
    each = followed.segments // plain.segments
    for segment in range(0, followed.segments, 97):
        ours = followed.joints_at(followed.time_of(segment, 0.0))
        theirs = plain.joints_at(plain.time_of(segment // each, segment % each / each))
        assert np.abs(ours - theirs)[[0, 1, 3, 4]].max() < math.radians(
            0.05
        )  # axes were halved on chords here


def test_joints_that_are_not_the_bound_ones_make_no_course(asked, bound):
    turned = (bound.exit_joints_u[0], *bound.exit_joints_u[1:3], bound.exit_joints_u[3] + 360_000_000, 0)
    for other in (
        replace(bound, exit_joints_u=turned),
        replace(bound, entry_joints_u=bound.exit_joints_u),
        replace(bound, entry_um=bound.entry_um + 1000),
    ):
        with pytest.raises(ValueError, match="are not the verified ones"):
            trajectory_for(asked, other)
