"""The verification problem from recorded bytes."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cutgate.config.load import robot_from_bytes
from cutgate.config.records import calibration_record, limits_record, tool_record
from cutgate.protocol.records import Path as PathRecord
from cutgate.protocol.records import RecordError
from cutgate.runtime.verification.recorded import problem_from_records

PRESET = (Path(__file__).parents[3] / "config" / "presets" / "example.toml").read_text(encoding="utf-8")
ROBOT = robot_from_bytes(
    "r",
    (
        PRESET
        + "path_tolerance_mm = 0.25\npath_tolerance_deg = 0.5\n[calibration]\nupper_link_error_mm = 0.5\n"
        + "forearm_link_error_mm = -0.25\njoint_offset_deg = [1.0, 2.0, 3.0, 4.0, 5.0]\n"
        + "slide_tilt_mrad = [2.0, -4.0]\nresidual_mm = 0.125\nresidual_deg = 0.5\n"
        + "[wrist]\nhold_roll_when_vertical = true\nhold_roll_deg = 90.0\n"
    ).encode(),
)
PATH = PathRecord.quantised(
    [[500, 0, 200], [500, 10, 200]],
    [[0.6, 0, 0.8], [0, 0.6, 0.8]],
    feed_mm_s=12.5,
    tool_length_mm=160.0,
    elbow="right",
    q0_turns=1,
    roll_turns=-2,
)
LIMITS, CALIBRATION, TOOL = limits_record(ROBOT), calibration_record(ROBOT), tool_record(ROBOT)


def problem(path=PATH, limits=LIMITS, calibration=CALIBRATION, tool=TOOL, robot=ROBOT, **options):
    return problem_from_records(path.body(), limits.body(), calibration.body(), tool.body(), robot, **options)


def test_every_number_of_the_records_reaches_the_problem():
    found = problem()
    assert found.tips_mm.tolist() == [[500, 0, 200], [500, 10, 200]]
    assert np.allclose(found.axes, [[0.6, 0, 0.8], [0, 0.6, 0.8]], atol=1e-6)
    assert (found.feed_mm_s, found.tool_length_mm) == (12.5, 160.0)
    assert (found.arm.upper_mm, found.arm.forearm_mm, found.arm.elbow) == (450.0, 450.0, "right")
    assert np.allclose(found.lower, [math.radians(-80), 0, 50, math.radians(-170), 0], atol=1e-15)
    assert np.allclose(
        found.upper, [math.radians(80), math.radians(145), 450, math.radians(170), math.radians(110)]
    )
    assert np.allclose(found.speed, [1, 1, 200, 2, 2], atol=2e-8)
    calibration = found.calibration
    assert (calibration.upper_link_error_mm, calibration.forearm_link_error_mm) == (0.5, -0.25)
    offsets = [math.radians(1), math.radians(2), 3, math.radians(4), math.radians(5)]
    assert np.allclose(calibration.joint_offset, offsets)
    assert np.allclose(calibration.slide_tilt, [0.002, -0.004])
    assert (calibration.residual_mm, calibration.residual_rad) == (0.125, math.radians(0.5))
    assert found.hold_roll == math.radians(90)
    assert (found.deadband.arm_mm, found.deadband.wrist_rad) == (5.0, math.radians(2))
    assert (found.deadband.path_tolerance_mm, found.deadband.path_tolerance_rad) == (0.25, math.radians(0.5))


def test_the_branch_is_the_paths_unless_any_is_asked_for():
    assert problem().branch == (1, -2)
    assert problem(any_branch=True).branch is None


def test_roll_is_held_only_where_the_robot_says_so():
    robot = ROBOT.model_copy(
        update={"wrist": ROBOT.wrist.model_copy(update={"hold_roll_when_vertical": False})}
    )
    assert problem(robot=robot).hold_roll is None


@pytest.mark.parametrize(
    ("part", "words"),
    [
        ({"path": replace(PATH, elbow="left")}, "left elbow"),
        ({"path": replace(PATH, tool_length_u=160_000_001)}, "160.000001"),
        ({"limits": replace(LIMITS, q_min_u=LIMITS.q_max_u)}, "not below its upper limit"),
        ({"limits": replace(LIMITS, q_min_u=(0,) * 5, q_max_u=(0,) * 5)}, "all position limits are zero"),
        ({"calibration": replace(CALIBRATION, upper_link_u=0)}, "upper link"),
        ({"tool": replace(TOOL, length_u=-1)}, "tool length"),
    ],
)
def test_records_no_robot_can_have_are_refused(part, words):
    with pytest.raises(RecordError, match=words):
        problem(**part)


def test_malformed_records_are_refused():
    bodies = [PATH.body(), LIMITS.body(), CALIBRATION.body(), TOOL.body()]
    for n in range(4):
        with pytest.raises(RecordError):
            problem_from_records(*[body[:-1] if k == n else body for k, body in enumerate(bodies)], ROBOT)
