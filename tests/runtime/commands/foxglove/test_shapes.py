"""Quaternions, cylinders and chains of frames, for any arm: held against matrices and the controller's own kinematics."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.firmware_sim.kinematics import ControllerArm, as_joints, forward
from cutgate.runtime.audit.records import ZERO
from cutgate.runtime.commands.foxglove.arm import ShownArm, bone_transform
from cutgate.runtime.commands.foxglove.decided import DrawnDecision
from cutgate.runtime.commands.foxglove.shapes import (
    about_z_then_y,
    colour,
    cylinder,
    of_matrix,
    with_z_along,
)
from cutgate.runtime.commands.verify_scene import scene
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.recorded import problem_from_records
from tests.runtime.audit.build import inputs
from tests.runtime.commands.foxglove.sessions import matrix, quaternion_matrix

ANGLE = st.floats(-7.0, 7.0)


def drawn_of(given):
    i = inputs(given)
    problem = problem_from_records(i.path, i.limits, i.calibration, i.tool, i.robot.value)
    return DrawnDecision(problem, scene(problem, certified.verify(problem), None, "x"), None)


DRAWN = drawn_of(500.0)


def turned(axis, angle):
    """The matrix of a rotation about a unit axis, by the exponential of its cross product matrix (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * (cross @ cross)


def unit(values):
    length = math.sqrt(sum(value * value for value in values))
    return np.array(values) / length if length > 1e-3 else np.array([0.0, 0.0, 1.0])


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3), ANGLE)
def test_a_matrix_and_its_quaternion_turn_alike(axis, angle):
    rotation = turned(unit(axis), angle)
    assert quaternion_matrix(of_matrix(rotation).model_dump()) == pytest.approx(rotation, abs=1e-7)


@pytest.mark.parametrize("axis", np.eye(3))
def test_half_turns_have_quaternions_as_well(axis):
    rotation = turned(axis, math.pi)
    assert quaternion_matrix(of_matrix(rotation).model_dump()) == pytest.approx(rotation, abs=1e-7)


@given(ANGLE, ANGLE)
def test_about_z_and_then_about_the_y_that_turned_with_it(z, y):
    made = quaternion_matrix(about_z_then_y(z, y).model_dump())
    assert made == pytest.approx(turned([0, 0, 1], z) @ turned([0, 1, 0], y), abs=1e-7)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3))
def test_z_is_brought_to_any_axis(axis):
    axis = unit(axis)
    assert quaternion_matrix(with_z_along(axis).model_dump())[:, 2] == pytest.approx(axis, abs=1e-7)


def test_a_cylinder_joins_its_ends_and_has_a_place_where_they_are_one():
    begin, end = np.array([100.0, -20.0, 5.0]), np.array([150.0, 80.0, -95.0])
    made = cylinder(begin, end, 8.0, colour("#102030")).model_dump()
    middle = np.array([made["pose"]["position"][name] for name in "xyz"]) * 1000
    half = quaternion_matrix(made["pose"]["orientation"])[:, 2] * made["size"]["z"] * 500
    assert (middle - half, middle + half) == (pytest.approx(begin, abs=0.01), pytest.approx(end, abs=0.01))
    assert made["color"] == {"r": 0.0627, "g": 0.1255, "b": 0.1882, "a": 1.0}
    assert cylinder(begin, begin, 8.0, colour("#102030")).size.z == 0.0


@given(
    q=st.tuples(ANGLE, ANGLE, st.floats(0.0, 500.0), ANGLE, ANGLE),
    offset=st.tuples(*[st.floats(-0.1, 0.1)] * 5),
    tilt=st.tuples(st.floats(-0.01, 0.01), st.floats(-0.01, 0.01)),
)
def test_the_frames_of_any_arm_end_at_the_tip_that_the_controller_computes(q, offset, tilt):
    theirs = ControllerArm(430.0, 390.0, 161.0, right=True, offset=offset, tilt=tilt)
    ours = ShownArm(430.0, 390.0, 161.0, np.array(offset), np.array(tilt), (0.0, 500.0))
    chain = np.eye(4)
    for one in ours.transforms(np.array(q), ZERO).model_dump()["transforms"]:
        chain = chain @ matrix(one)
    pose = forward(theirs, as_joints(np.array(q)))
    assert chain[:3, 3] * 1000 == pytest.approx(np.array(pose.tip), abs=0.01)
    assert chain[:3, 2] == pytest.approx(np.array(pose.axis), abs=1e-6)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3), ANGLE, st.tuples(*[st.floats(-2000.0, 2000.0)] * 3))
def test_the_bones_frame_is_the_registration(axis, angle, origin):
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = turned(unit(axis), angle), origin
    (one,) = bone_transform(place, ZERO).model_dump()["transforms"]
    found = matrix(one)
    assert found[:3, :3] == pytest.approx(place[:3, :3], abs=1e-7)
    assert found[:3, 3] * 1000 == pytest.approx(place[:3, 3], abs=0.002)


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.004, -0.003)])
@pytest.mark.parametrize("given", [500.0, 850.0])
def test_a_leaning_slide_leans_in_the_scene_as_well(tilt, given):
    """Wrist centres by tips and axes, and worst places on them, in the robot's frame."""
    i = inputs(given)
    problem = problem_from_records(i.path, i.limits, i.calibration, i.tool, i.robot.value)
    problem = replace(problem, calibration=replace(problem.calibration, slide_tilt=np.array(tilt)))
    verdict = certified.verify(problem)
    drawn = DrawnDecision(problem, scene(problem, verdict, None, "x"), None)
    wrist = problem.tips_mm + problem.tool_length_mm * problem.axes
    whole = [k for k, pose in enumerate(drawn.scene.path.pose) if pose == round(pose)]
    assert len(whole) > 2
    poses = drawn.scene.path.pose[whole].astype(int)
    assert drawn.wrist_mm[whole] == pytest.approx(wrist[poses], abs=1e-6)
    assert drawn.tips_mm[whole] == pytest.approx(problem.tips_mm[poses], abs=1e-9)
    entities = {one.id: one for one in drawn.drawn(ZERO).entities}
    assert "bone/path" not in entities, "without a registration"
    for name, boundary in verdict.boundaries.items():
        if boundary.segment is not None:
            at = entities[f"worst/{name}"].texts[0].pose.position
            place = np.array([at.x, at.y, at.z]) * 1000
            assert np.linalg.norm(drawn.wrist_mm - place, axis=1).min() < 1.0


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3), ANGLE)
def test_a_path_in_the_frame_of_a_turned_bone_is_the_same_path(axis, angle):
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = turned(unit(axis), angle), (471.0, -150.0, 30.0)
    drawn = replace(DRAWN, place=place)
    (own,) = [one for one in drawn.drawn(ZERO).entities if one.id == "bone/path"]
    points = np.array([[point.x, point.y, point.z] for point in own.lines[0].points]) * 1000
    assert own.frame_id == "bone"
    assert points @ place[:3, :3].T + place[:3, 3] == pytest.approx(drawn.tips_mm, abs=0.01)


@pytest.mark.parametrize("segment", [-1, 5, 10**9])
def test_of_a_segment_that_the_path_does_not_have_nothing_is_said(segment):
    assert DRAWN.clearances(segment, 0.5) is None
    assert DRAWN.clearances(4, 1.0) is not None


@pytest.mark.parametrize("most", [1, 2, 3, 4, 5, 6, 7])
def test_of_a_long_plan_every_so_manieth_pose_and_the_last(monkeypatch, most):
    """The plan has six."""
    monkeypatch.setattr("cutgate.runtime.commands.foxglove.decided.POSES_MAX", most)
    shown = [pose.position.x * 1000 for pose in DRAWN.plan(ZERO).poses]
    all_of_them = DRAWN.problem.tips_mm[:, 0].tolist()
    which = [min(range(6), key=lambda k: abs(all_of_them[k] - x)) for x in shown]
    assert (which[0], which[-1]) == (0, 5)
    assert len({b - a for a, b in pairwise(which[:-1])}) <= 1
    assert which == sorted(set(which))
    assert len(which) <= most + 1
    assert most < 5 or which == list(range(6))
