"""Entry and exit by the controller's own kinematics, and how far an arm may stand off its start joints."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.firmware_sim import approach
from cutgate.firmware_sim.approach import BoundApproach, Ends, agrees, inside, own_ends, start_offset
from cutgate.firmware_sim.kinematics import KinematicsError, as_joints, calibrated_arm, forward
from cutgate.firmware_sim.path_check import PathCheck
from cutgate.protocol.records import UNIT, joints_to_counts, joints_to_memory
from cutgate.protocol.states import Refusal
from tests.firmware_sim.arms import CALIBRATED, LIMITS, NOMINAL, PATH, TOOL, TOOL_MM, WIDE, line_path
from tests.firmware_sim.controllers import ENDS, PERMIT


def ends_of(path, *, limits=LIMITS, calibration=NOMINAL, clearance_um=10_000):
    check = PathCheck(path, limits, calibration, TOOL)
    check.run()
    arm = calibrated_arm(calibration, tool_mm=TOOL_MM, elbow="right")
    return own_ends(path, arm, limits, check.first_joints, check.last_joints, clearance_um=clearance_um)


@pytest.mark.parametrize("calibration", [NOMINAL, CALIBRATED])
def test_entry_and_exit_lie_along_the_tool_beyond_every_tip(calibration):
    ends = ends_of(PATH, calibration=calibration)
    arm = calibrated_arm(calibration, tool_mm=TOOL_MM, elbow="right")
    for index, distance_um, joints_u in (
        (0, ends.entry_um, ends.entry_joints_u),
        (-1, ends.exit_um, ends.exit_joints_u),
    ):
        axis = PATH.axes[index]
        pose = forward(arm, as_joints(joints_to_memory(joints_u)))
        np.testing.assert_allclose(pose.tip, PATH.tips_mm[index] + distance_um / 1000 * axis, atol=1e-4)
        np.testing.assert_allclose(pose.axis, axis, atol=1e-7)
        beyond = (np.array(pose.tip) - PATH.tips_mm) @ axis
        assert 10.0 - 1e-4 <= beyond.min() <= 10.001 + 1e-4


def test_entry_and_exit_stay_on_the_turns_of_the_path():
    """A path once round the column: its exit is a turn further than its entry."""
    s = np.linspace(0.0, math.tau, 60)
    tips = np.column_stack((400 * np.cos(s), 400 * np.sin(s), np.full(60, 100.0)))
    axes = np.column_stack((0.5 * np.cos(s), 0.5 * np.sin(s), np.full(60, math.sqrt(0.75))))
    path = type(PATH).quantised(
        tips, axes, feed_mm_s=10, tool_length_mm=TOOL_MM, elbow="right", q0_turns=2, roll_turns=-1
    )
    ends = ends_of(path, limits=WIDE)
    around = np.subtract(ends.exit_joints_u, ends.entry_joints_u) / 1e6
    np.testing.assert_allclose(around, (360, 0, 0, 0, 0), atol=0.01)
    assert 540 < ends.entry_joints_u[0] / 1e6 < 900


def test_an_exit_outside_the_limits_is_named():
    path = line_path((500.0, 0.0, 100.0), (500.0, 20.0, 290.0), polar=(30, 30), azimuth=(0, 0))
    with pytest.raises(KinematicsError, match=r"exit pose, 50.000 mm along the tool: q2 = .* outside"):
        ends_of(path, clearance_um=50_000)


def test_an_entry_beyond_what_the_bus_reports_is_named():
    """The path itself is still where it may go."""
    tip = (500.0 * math.cos(2.52), 500.0 * math.sin(2.52), 100.0)
    path = line_path(tip, (tip[0], tip[1] + 0.1, tip[2]), poses=3, azimuth=(250.0, 250.0), q0_turns=6)
    assert PathCheck(path, WIDE, NOMINAL, TOOL).run()[0] is Refusal.ACCEPTED
    with pytest.raises(
        KinematicsError, match=r"entry pose, 200.000 mm along the tool: q0 = 2267\..* is beyond \+-2261 deg"
    ):
        ends_of(path, limits=WIDE, clearance_um=200_000)


@pytest.mark.parametrize("joint", [0, 3])
def test_bound_joints_must_be_such_as_the_bus_reports_whatever_the_limits(joint):
    def inner(degrees, **within):
        return inside(
            WIDE, tuple(degrees * 1_000_000 if j == joint else 1_000_000 for j in range(5)), **within
        )

    assert inner(2261) and inner(-2261)  # noqa: PT018
    assert not inner(2262) and not inner(-2262)  # noqa: PT018
    assert inner(2600, within_deg=2600)
    assert not inner(2601, within_deg=2600)


@pytest.mark.parametrize("joint", range(5))
def test_joints_on_their_limits_are_inside_and_one_count_further_they_are_not(joint):
    def moved(limit, by):
        return tuple(count + by * (j == joint) for j, count in enumerate(limit))

    low, high = LIMITS.q_min_u, LIMITS.q_max_u
    middle = tuple((a + b) // 2 for a, b in zip(low, high, strict=True))
    assert inside(LIMITS, low, high, middle)
    for outside in (moved(low, -1), moved(high, 1)):
        assert not inside(LIMITS, outside)
        assert not inside(LIMITS, middle, outside)
        assert not inside(LIMITS, outside, middle)


def test_entry_and_exit_that_the_arm_cannot_reach_agree_with_nothing():
    assert not agrees(None, PERMIT.approach)


@pytest.mark.parametrize("field", ["entry_um", "exit_um"])
def test_distances_agree_within_one_um(field):
    for off, agreed in ((-2, False), (-1, True), (0, True), (1, True), (2, False)):
        bound = replace(PERMIT.approach, **{field: getattr(ENDS, field) + off})
        assert agrees(ENDS, bound) is agreed


@pytest.mark.parametrize("joint", range(5))
@pytest.mark.parametrize("field", ["entry_joints_u", "exit_joints_u"])
def test_joints_agree_within_a_hundredth_of_a_degree_or_mm(field, joint):
    own = getattr(ENDS, field)
    for off, agreed in ((-10_001, False), (-10_000, True), (10_000, True), (10_001, False)):
        counts = tuple(count + off * (j == joint) for j, count in enumerate(own))
        assert agrees(ENDS, replace(PERMIT.approach, **{field: counts})) is agreed


def test_another_number_of_joints_is_an_error_and_no_comparison_of_some():
    six = (*ENDS.entry_joints_u, 0)
    for own in (replace(ENDS, entry_joints_u=six), replace(ENDS, exit_joints_u=six)):
        with pytest.raises(ValueError, match=r"zip\(\) argument 2"):
            agrees(own, PERMIT.approach)
    with pytest.raises(ValueError, match=r"zip\(\) argument 2"):
        inside(LIMITS, (*LIMITS.q_min_u, 0))
    with pytest.raises(ValueError, match=r"zip\(\) argument 2"):
        start_offset(NOMINAL, (0,) * 5, (0,) * 6)


def test_entry_and_exit_stay_as_they_were_found():
    assert Ends.__dataclass_params__.frozen
    assert BoundApproach.__dataclass_params__.frozen


def test_a_path_is_looked_at_in_parts_and_to_its_end(monkeypatch):
    """The farthest tip may be in any of them."""
    assert approach.PART_POSES == 4096
    tips = [(500.0, 0.0, 100.0), (500.0, 1.0, 100.0), (500.0, 2.0, 100.0), (500.0, 3.0, 140.0)]
    for order in (tips, tips[::-1]):
        path = type(PATH).quantised(
            order, np.tile((0.6, 0.0, 0.8), (4, 1)), feed_mm_s=10, tool_length_mm=TOOL_MM, elbow="right"
        )
        whole = ends_of(path)
        for poses in (1, 2, 3, 4):
            monkeypatch.setattr(approach, "PART_POSES", poses)
            assert ends_of(path) == whole
        farthest = max(whole.entry_um, whole.exit_um)
        assert farthest == pytest.approx(10_000 + 1000 * 40.0 * 0.8, abs=2)


def test_an_entry_to_which_the_arm_cannot_be_followed_is_named():
    path = line_path((700.0, 0.0, 100.0), (700.0, 20.0, 100.0), polar=(60, 60), azimuth=(0, 0))
    with pytest.raises(KinematicsError, match=r"^entry pose, 250\.000 mm along the tool: .*out of reach.*$"):
        ends_of(path, clearance_um=250_000)


joint = st.floats(-1.0, 1.0)


@given(
    st.tuples(joint, joint, joint),
    st.tuples(*[st.floats(-0.01, 0.01)] * 3),
    st.floats(0.0, 1.0),
    st.tuples(*[st.floats(-3, 3)] * 2),
)
def test_the_offset_bounds_the_wrist_centre_anywhere_on_the_joint_line(start, off, fraction, other):
    """The executed line begins at the measured joints, the bound one at the start joints; both end alike."""
    measured_u = joints_to_counts((start[0] + off[0], start[1] + off[1], start[2] + off[2], 0.0, 1.0))
    bound_u = joints_to_counts((*start, 0.0, 1.0))
    mm, _ = start_offset(CALIBRATED, measured_u, bound_u)
    arm = calibrated_arm(CALIBRATED, tool_mm=0.0, elbow="right")
    arm = replace(arm, tilt=(0.0, 0.0))
    end = np.array((*other, 100.0, 0.0, 1.0))
    places = [
        forward(arm, as_joints((1 - fraction) * joints_to_memory(counts) + fraction * end)).tip
        for counts in (measured_u, bound_u)
    ]
    assert math.dist(*places) <= mm + 1e-9


@pytest.mark.parametrize(
    ("off_deg", "swept_mm"),
    [
        ((1, 0), (450 + 1.5) + (430 - 0.75)),
        ((0, 1), 430 - 0.75),
        ((1, -1), 450 + 1.5),
        ((-1, 0), (450 + 1.5) + (430 - 0.75)),
        ((0, -2), 2 * (430 - 0.75)),
    ],
)
def test_the_offset_is_swept_by_the_calibrated_links_and_the_slide(off_deg, swept_mm):
    """Two degrees at the elbow move the forearm alone; what both joints do together moves it by their sum."""
    measured = (off_deg[0] * UNIT, off_deg[1] * UNIT, 3 * UNIT, 0, 0)
    mm, deg = start_offset(CALIBRATED, measured, (0,) * 5)
    assert mm == pytest.approx(math.hypot(swept_mm * math.radians(1), 3.0))
    assert deg == max(map(abs, off_deg))


@pytest.mark.parametrize("joint", [0, 1, 3, 4])
def test_the_turning_joint_furthest_off_counts(joint):
    measured = tuple(-5 * UNIT if j == joint else UNIT for j in range(5))
    assert start_offset(NOMINAL, measured, (0,) * 5)[1] == 5.0


def test_the_offset_of_a_wrist_joint_is_its_turn():
    assert start_offset(NOMINAL, (0, 0, 0, 150_000, 0), (0, 0, 0, -50_000, 20_000)) == (0.0, 0.2)


def test_what_is_executed_is_what_the_permit_binds():
    bound = BoundApproach.of(PERMIT)
    assert joints_to_counts(bound.start) == PERMIT.start_joints_u
    assert joints_to_counts(bound.entry) == PERMIT.approach.entry_joints_u
    assert joints_to_counts(bound.exit) == PERMIT.approach.exit_joints_u
    assert (bound.entry_um, bound.exit_um, bound.speed) == (12_000, 32_000, 0.25)
