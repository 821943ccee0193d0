"""What people are told: what is not kept, where, by how much, and what to do first."""

import numpy as np
import pytest

from cutgate.runtime.verification import certified
from tests.runtime.verification.cases import DEG, axis, problem, wrist_path


def crossing(span_deg):
    """A level tool straight across the column, out of the reach near it."""
    tips, axes = wrist_path([[-600, -300, 0], [600, -300, 0]], axis(90 * DEG, 0.0))
    return problem(
        tips,
        axes,
        lower=np.array([-span_deg * DEG, 10 * DEG, -300.0, -700.0, 0.0]),
        upper=np.array([span_deg * DEG, 100 * DEG, 300.0, 700.0, 3.0]),
        speed=np.full(5, 1e6),
    )


def test_out_of_the_reach_the_boundary_left_first_is_named_first_and_no_other_is_called_undecided():
    for span_deg in (170, 400):
        verdict = certified.verify(crossing(span_deg))
        assert verdict.branch is None
        assert "no joint branch holds the whole path: it leaves the reach" in verdict.reasons
        inner = next(reason for reason in verdict.reasons if reason.startswith("inner: "))
        assert "inner: clearance -" in inner
        assert "needs 5 mm" in inner
        assert "move the bone away from the column" in inner
        outer = next(reason for reason in verdict.reasons if reason.startswith("outer: "))
        assert "not enclosed where the path leaves the reach" in outer
        assert "inner" in outer.split("cure")[1]
        assert not any("undecided" in reason for reason in verdict.reasons)


def test_a_speed_names_joint_peak_segment_and_limit():
    tips, axes = wrist_path([[600, 0, 100], [600, 50, 100]], axis(1.0, 0.3))
    slow = problem(tips, axes, speed=np.array([1e-3, 1.0, 200.0, 2.0, 2.0]))
    (reason,) = certified.verify(slow).reasons
    assert reason.startswith("joint 0: needs up to 0.0")
    assert "rad/s in segment 0, limit 0.001 rad/s; reduce the feed" in reason


def test_what_is_undefined_is_said_once_and_after_what_to_cure_first():
    tips, axes = wrist_path([[880, 0, 100], [920, 0, 100]], axis(1.0, 0.3))
    reasons = certified.verify(problem(tips, axes)).reasons
    (said,) = [reason for reason in reasons if "not defined or not bounded" in reason]
    assert said == reasons[-1]
    assert said.startswith("roll_min, roll_max, speed of joint 0, speed of joint 1, speed of joint 3: ")
    assert said.endswith("cure outer first")


def test_a_singular_tool_alone_says_what_to_do():
    tips, axes = wrist_path([[600, 0, 100], [600, 50, 100]], axis(0.0, 0.0))
    reasons = certified.verify(problem(tips, axes)).reasons
    assert any(reason.startswith("wrist_singularity: clearance 0.0") for reason in reasons)
    assert any(reason.startswith("roll_min, roll_max, speed of joint 3: ") for reason in reasons)


def told(tilt_rad, *, hold=None, turn_rad=0.0, **changes):
    """What is said of a tool that leans by so much, and turns by so much on the way."""
    tips, axes = wrist_path([[600, 0, 100], [600, 50, 100]], axis(tilt_rad, 0.0))
    axes[1] = axis(tilt_rad + turn_rad, 0.0)
    lower = np.array([-80 * DEG, 0.0, 50.0, -170 * DEG, changes.pop("stop", 0.0)])
    wanted = problem(tips, axes, hold_roll=hold, lower=lower, **changes)
    return {reason.partition(":")[0]: reason for reason in certified.verify(wanted).reasons}


LEVEL = "0 0 1 in the robot frame, exactly"
DECLARE = "declare hold_roll_when_vertical"


def test_a_declared_hold_is_not_advised_but_how_to_be_vertical_is():
    for name in ("wrist_singularity", "pitch_min"):
        said = told(1e-6, hold=0.0)[name]
        assert "5.73e-05 deg from vertical and counts as vertical below 5.7e-08 deg" in said
        assert LEVEL in said
        assert DECLARE not in said


def test_a_hold_is_advised_alone_only_where_the_tool_is_exactly_vertical():
    for name in ("wrist_singularity", "pitch_min"):
        assert DECLARE in told(0.0)[name]
        assert LEVEL not in told(0.0)[name]
    off = told(1e-6)["wrist_singularity"]
    assert LEVEL in off
    assert off.index(LEVEL) < off.index(DECLARE)


@pytest.mark.parametrize(
    ("tilt_rad", "more"),
    [
        (1e-6, {"turn_rad": 0.5}),  # a path that comes near the vertical once
        (np.pi - 1e-6, {}),  # downward, where the pitch has its greatest value whatever is held
        (1e-6, {"stop": 0.5 * DEG}),  # a lower limit of the pitch that a vertical tool violates
    ],
)
@pytest.mark.parametrize("hold", [None, 0.0])
def test_nobody_is_told_to_hold_the_roll_where_that_cures_nothing(tilt_rad, more, hold):
    said = told(tilt_rad, hold=hold, **more)
    assert said["wrist_singularity"].endswith(
        "tilt the registration so that the tool keeps further from the vertical"
    )
    assert not any(DECLARE in reason or LEVEL in reason for reason in said.values())


def test_a_held_roll_is_changed_by_no_move_of_the_bone():
    said = told(0.0, hold=169 * DEG)["roll_max"]
    assert said.endswith("declare another hold_roll_deg: the roll is held there")
