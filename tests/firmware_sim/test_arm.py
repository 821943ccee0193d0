"""The arm as the loop sees it: what a start, a stored path and each fault make of it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cutgate.firmware_sim.approach import own_ends
from cutgate.firmware_sim.arm import DRIFT_DEG_S, OFF_START_DEG, RUSH, PlantArm, middle_of
from cutgate.firmware_sim.drives import BANDWIDTH_RAD_S
from cutgate.firmware_sim.kinematics import as_joints, calibrated_arm, forward, inverse
from cutgate.firmware_sim.path_check import PathCheck
from cutgate.firmware_sim.plant import Leg, Plant, PlantState
from cutgate.firmware_sim.state import Holdings
from cutgate.protocol import records
from cutgate.protocol.parameters import ROTATION_DEG_GOES
from cutgate.protocol.states import StopCause
from tests.firmware_sim.arms import CALIBRATED, LEFT_LIMITS, LIMITS, PATH, TOOL, TOOL_MM
from tests.firmware_sim.controllers import PERMIT

HOLDINGS = Holdings(LIMITS.body(), CALIBRATED.body(), TOOL.body())
WITH_PATH = replace(HOLDINGS, path=PATH.body())
STANDS = (0.1, 0.2, 300.0, 0.4, 0.5)
DT_S = 0.02


def _permit():
    check = PathCheck(records.PathCodes.parse(PATH.body()), LIMITS, CALIBRATED, TOOL)
    check.run()
    arm = calibrated_arm(CALIBRATED, tool_mm=TOOL_MM, elbow="right")
    ends = own_ends(check.path, arm, LIMITS, check.first_joints, check.last_joints, clearance_um=10_000)
    bound = records.Approach(
        ends.entry_um, ends.exit_um, ends.entry_joints_u, ends.exit_joints_u, speed_percent=100
    )
    near = (ends.entry_joints_u[0] + 2 * records.UNIT, *ends.entry_joints_u[1:])
    return replace(PERMIT, start_joints_u=near, approach=bound)


GIVEN = _permit()
AT_START = as_joints(records.joints_to_memory(GIVEN.start_joints_u))


def begun(**options):
    """An arm at its start joints, with a path and an accepted start."""
    arm = PlantArm(WITH_PATH, joints=AT_START, **options)
    arm.begin(GIVEN)
    return arm


def moved(arm, cycles=1, dt_s=DT_S):
    for _ in range(cycles):
        assert arm.move(dt_s, moving=True, cutter=True) is None
    return arm


@pytest.mark.parametrize(
    ("lower", "upper", "expected"),
    [
        ((-80, 0, 50, -170, 0), (80, 145, 450, 170, 110), (0, 72.5, 250, 0, 55)),
        ((-36_000, -145, -10, 100, 20), (36_000, 0, 20, 220, 180), (0, -72.5, 5, 160, 100)),
        ((-180, 0, 0, -100, 0), (500, 180, 1, 700, 180), (0, 90, 0.5, 300, 90)),
        ((-39, 0, 0, -36_000, 0), (36_000, 180, 1, -139, 180), (1111, 90, 0.5, -1200, 90)),
    ],
)
def test_the_arm_powers_up_in_the_middle_of_its_limits(lower, upper, expected):
    """0 where a joint has half a turn on either side of it; of limits beyond what the bus reports, where it may go."""
    limits = records.Limits.quantised(q_min_deg=lower, q_max_deg=upper, speed_deg_s=(57, 57, 200, 114, 114))
    joints = middle_of(limits)
    shown = [joint if index == 2 else math.degrees(joint) for index, joint in enumerate(joints)]
    assert shown == pytest.approx(expected)


def test_the_middle_of_the_limits_is_the_middle_of_a_range_that_touches_half_a_revolution():
    """A degree less on either side, and 0 is not the place."""
    for lower, upper, expected in (
        (-180, 180, 0.0),
        (-179, 180, 0.5),
        (-180, 179, -0.5),
        (-200, 182, 0.0),
        (-200, 180, 0.0),
    ):
        limits = replace(LIMITS, q_min_u=(lower * records.UNIT, *LIMITS.q_min_u[1:]))
        limits = replace(limits, q_max_u=(upper * records.UNIT, *limits.q_max_u[1:]))
        assert math.degrees(middle_of(limits)[0]) == pytest.approx(expected)


@pytest.mark.parametrize("side", [-1, 1])
def test_limits_that_begin_where_the_bus_reports_no_further_leave_one_place(side):
    far = sorted((side * ROTATION_DEG_GOES * records.UNIT, side * 9000 * records.UNIT))
    limits = replace(LIMITS, q_min_u=(far[0], *LIMITS.q_min_u[1:]), q_max_u=(far[1], *LIMITS.q_max_u[1:]))
    assert math.degrees(middle_of(limits)[0]) == pytest.approx(side * ROTATION_DEG_GOES)


def test_at_power_up_it_stands_in_the_middle_of_its_limits_or_where_it_is_told_to():
    assert PlantArm(HOLDINGS).state == PlantState(middle_of(LIMITS))
    arm = PlantArm(HOLDINGS, joints=STANDS)
    assert arm.state == PlantState(STANDS)
    assert arm.measured == STANDS
    assert (arm.executed, arm.speed_ratio, arm.path, arm.frozen) == (0, 0.0, None, None)


def test_the_plant_is_the_one_that_the_holdings_describe():
    assert PlantArm(HOLDINGS).plant == Plant(LIMITS, CALIBRATED)
    assert PlantArm(HOLDINGS, hold_roll_rad=0.3).plant == Plant(LIMITS, CALIBRATED, 0.3)


def test_a_stored_path_does_not_move_the_arm_and_takes_the_limits_as_they_are_now():
    arm = PlantArm(HOLDINGS, joints=STANDS)
    arm.load(replace(WITH_PATH, limits=LEFT_LIMITS.body()))
    assert arm.state == PlantState(STANDS)
    assert arm.plant.limits == LEFT_LIMITS
    assert len(arm.path) == len(PATH)
    arm.load(HOLDINGS)
    assert arm.path is None


def test_a_path_that_is_loaded_anew_voids_the_start():
    arm = begun()
    arm.load(WITH_PATH)
    with pytest.raises(AssertionError):
        arm.move(DT_S, moving=True, cutter=True)


def test_without_a_path_nothing_is_executed():
    arm = begun()
    arm.path = None
    with pytest.raises(AssertionError):
        arm.move(DT_S, moving=True, cutter=True)


def test_a_start_begins_from_where_the_arm_stands_and_counts_anew():
    arm = moved(begun(), 2000)
    assert arm.executed == len(PATH) - 1
    assert arm.state.done
    assert 0.0 < arm.speed_ratio <= 1.0
    arm.state = PlantState(STANDS, Leg.EXIT)
    arm.begin(GIVEN)
    assert arm.state == PlantState(STANDS)
    assert arm.measured == STANDS
    assert (arm.executed, arm.speed_ratio) == (0, 0.0)


def test_it_executes_the_permitted_legs_and_comes_back():
    arm = begun()
    legs = {moved(arm).state.leg for _ in range(2000)}
    assert legs == set(Leg)
    assert arm.state.joints == pytest.approx(AT_START)


def test_segments_and_peak_speed_are_counted_over_all_cycles():
    arm, executed, fastest = begun(), 0, 0.0
    while not arm.state.done:
        before = arm.state
        advance = arm.plant.advance(before, arm.path, arm._approach, dt_s=DT_S, moving=True, cutter=True)
        moved(arm)
        executed, fastest = executed + len(advance.executed), max(fastest, advance.speed_ratio)
        assert (arm.executed, arm.speed_ratio) == (executed, fastest)
        assert arm.state == advance.state
        assert arm.measured == arm.state.joints


@pytest.mark.parametrize(("moving", "cutter"), [(False, False), (False, True), (True, False), (True, True)])
def test_it_moves_only_where_motion_is_allowed(moving, cutter):
    arm = begun()
    assert arm.move(DT_S, moving=moving, cutter=cutter) is None
    assert (arm.state.joints != AT_START) is moving
    assert (arm.state.moving, arm.state.cutter) == (moving, cutter)


def test_time_in_which_it_may_not_move_is_not_made_up_for():
    """Even one that the plant would refuse."""
    arm = begun()
    assert arm.move(math.inf, moving=False, cutter=True) is None
    assert arm.state.joints == AT_START


@pytest.mark.parametrize("scale", [0.5, 1.0, 4.0])
def test_a_time_scale_is_that_of_the_plant(scale):
    slow, scaled = moved(begun(), 1, scale * DT_S), moved(begun(time_scale=scale))
    assert scaled.state.joints == pytest.approx(slow.state.joints)


def test_an_arm_off_its_path_stops_by_itself():
    arm = begun()
    arm.push_aside()
    fault = arm.move(DT_S, moving=True, cutter=True)
    assert fault.cause is StopCause.TRACKING_DEVIATION


@pytest.mark.parametrize(("scale", "gap_s"), [(1.0, 0.02), (4.0, 0.01)])
def test_whoever_moves_the_measured_joints_too_fast_is_seen(scale, gap_s):
    """57 deg/s in the plant's time; what it moves by itself in this cycle is counted from the joints before."""
    for part, seen in ((0.99, False), (1.01, True)):
        arm = begun(time_scale=scale)
        moved_rad = part * math.radians(57) * scale * gap_s
        arm.measured = (AT_START[0] + moved_rad, *AT_START[1:])
        fault = arm.move(gap_s, moving=False, cutter=True)
        assert (fault is not None) is seen
        if fault:
            assert fault.cause is StopCause.LIMIT_EXCEEDED
        assert arm.measured == AT_START


# ---------------------------------------------------------------- what can be wrong with it


def test_the_bus_hears_where_it_stands():
    arm = PlantArm(HOLDINGS, joints=STANDS)
    assert arm.reported(77.0) == STANDS


def test_an_arm_that_was_pushed_aside_stands_2_deg_off_in_q0():
    arm = PlantArm(HOLDINGS, joints=STANDS)
    arm.push_aside()
    assert OFF_START_DEG == 2.0
    assert arm.state == PlantState((STANDS[0] + math.radians(2.0), *STANDS[1:]))
    assert arm.measured == STANDS


def test_an_arm_that_drifts_is_reported_1_deg_further_each_second_and_knows_nothing_of_it():
    arm = PlantArm(HOLDINGS, joints=STANDS)
    arm.drift(100.0)
    assert DRIFT_DEG_S == 1.0
    for after_s in (0.0, 1.0, 3.0):
        assert arm.reported(100.0 + after_s) == pytest.approx(
            (STANDS[0] + math.radians(after_s), *STANDS[1:])
        )
    assert arm.state.joints == STANDS


def test_a_drift_that_began_when_the_clock_stood_at_0_is_one():
    arm = PlantArm(HOLDINGS, joints=STANDS)
    arm.drift(0.0)
    assert arm.reported(1.0)[0] == pytest.approx(STANDS[0] + math.radians(1.0))


def test_frozen_joints_are_heard_while_the_arm_goes_on():
    arm = begun()
    arm.freeze()
    moved(arm, 50)
    assert arm.reported(0.0) == AT_START
    assert not np.allclose(arm.state.joints, AT_START)


def test_an_arm_that_rushes_runs_three_times_as_fast_and_within_its_own_speed_limits():
    arm = begun(time_scale=0.5)
    arm.rush()
    slow = moved(begun(), 1, 1.5 * DT_S)
    assert RUSH == 3.0
    arm.move(DT_S, moving=True, cutter=True)
    assert arm.state.joints == pytest.approx(slow.state.joints)


def test_the_speed_of_a_rushing_arm_is_judged_by_the_time_scale_that_it_says():
    """On a joint line at its speed limit its own check sees three times as much."""
    arm = begun()
    arm.rush()
    assert arm.move(0.01, moving=True, cutter=True).cause is StopCause.LIMIT_EXCEEDED


# ---------------------------------------------------------------- the arm as it is


def test_how_near_the_true_arm_came_is_kept_of_the_cut_alone():
    """Entry, exit and the joint lines are verified for themselves, and lie above the path."""
    arm = begun()
    while arm.state.leg < Leg.CUT:
        assert arm.distances.least == {}
        moved(arm, dt_s=0.001)
    while not arm.state.done:
        moved(arm)
    least = arm.distances.least
    slide = [pose[2] for pose in _cut_readings()]
    assert least["bottom"].distance == pytest.approx(min(slide) - LIMITS.q_min[2], abs=0.01)
    assert least["top"].distance == pytest.approx(LIMITS.q_max[2] - max(slide), abs=0.01)
    assert least["bottom"].segment == len(PATH) - 2
    arm.begin(GIVEN)
    assert arm.distances.least == {}


def _cut_readings():
    """Reported joints at every pose of the path."""
    arm = calibrated_arm(CALIBRATED, tool_mm=TOOL_MM, elbow="right")
    path = begun().path
    return [inverse(arm, path.pose(index)) for index in range(len(path))]


def test_a_limit_switch_stops_an_arm_that_stands_further_than_is_reported():
    """5 deg of the shoulder: the readings are inside of their limits, the arm is not."""
    true = replace(CALIBRATED, joint_offset_u=(-5 * records.UNIT, *CALIBRATED.joint_offset_u[1:]))
    limits = replace(LIMITS, q_min_u=(-50 * records.UNIT, *LIMITS.q_min_u[1:]))
    assert math.degrees(min(joints[0] for joints in _cut_readings())) > -49.0
    for calibration, expected in ((CALIBRATED, None), (true, StopCause.LIMIT_EXCEEDED)):
        arm = PlantArm(
            replace(WITH_PATH, limits=limits.body()), joints=AT_START, true_calibration=calibration
        )
        arm.begin(GIVEN)
        fault = None
        while fault is None and not arm.state.done:
            fault = arm.move(DT_S, moving=True, cutter=True)
        assert (fault.cause if fault else None) is expected
        if fault:
            assert fault.detail.startswith("limit switch of the true arm: q0 = ")


def test_an_arm_that_drifts_trips_its_limit_switch():
    limits = replace(LIMITS, q_max_u=(-30 * records.UNIT, *LIMITS.q_max_u[1:]))
    arm = PlantArm(replace(WITH_PATH, limits=limits.body()), joints=AT_START)
    arm.begin(GIVEN)
    arm.drift(0.0)
    for after_s, cause in ((10.0, None), (20.0, StopCause.LIMIT_EXCEEDED)):
        arm.reported(after_s)
        fault = arm.move(DT_S, moving=True, cutter=True)
        assert (fault.cause if fault else None) is cause


# ---------------------------------------------------------------- with mass


def dynamic(**options):
    limits = replace(LIMITS, acceleration_u=tuple(5 * speed for speed in LIMITS.speed_u))
    arm = PlantArm(replace(WITH_PATH, limits=limits.body()), joints=AT_START, dynamics=True, **options)
    arm.begin(replace(GIVEN, approach=replace(GIVEN.approach, speed_percent=25)))
    return arm


def test_an_arm_with_mass_follows_its_command_to_the_end_and_is_done_when_it_stands():
    arm, off = dynamic(), []
    while not arm.state.done:
        moved(arm)
        off.append(max(abs(a - b) for a, b in zip(arm.reading, arm.state.joints, strict=True)))
    assert not arm.done
    assert 0.001 < max(off) < 2.0
    cycles = 0
    while not arm.done:
        moved(arm)
        cycles += 1
    assert 5 < cycles < 50
    assert arm.reading == arm.measured == arm.state.joints == pytest.approx(AT_START)
    assert (arm.executed, arm.seen) == (len(PATH) - 1, arm.state)


def test_an_arm_with_mass_keeps_its_distances_but_for_what_it_rounds_off():
    """By no more than it is behind."""
    arms = dynamic(), begun()
    for arm in arms:
        while not arm.done:
            moved(arm)
    with_mass, without = (arm.distances.least for arm in arms)
    assert with_mass.keys() == without.keys()
    behind_mm = PATH.feed_mm_s * 2.0 / BANDWIDTH_RAD_S
    assert all(with_mass[name].distance >= without[name].distance - behind_mm for name in without)
    assert with_mass != without


def test_an_arm_with_mass_that_may_not_move_any_more_brakes_along_its_path():
    """From 10 mm/s in 175 ms, and in half a mm; then it stands at its command exactly."""
    arm = dynamic()
    while arm.state.leg is not Leg.CUT:
        moved(arm)
    moved(arm, 100)
    command, start = arm.state.joints, arm.reading
    kinematics = calibrated_arm(CALIBRATED, tool_mm=TOOL_MM, elbow="right")
    moving = []
    for _ in range(40):
        before = arm.reading
        assert arm.move(DT_S, moving=False, cutter=False) is None
        moving.append(arm.reading != before)
    assert arm.state.joints == command == arm.reading
    assert moving[:3] == [True] * 3
    assert not moving[-1]
    braked_mm = math.dist(forward(kinematics, start).tip, forward(kinematics, command).tip)
    assert braked_mm == pytest.approx(PATH.feed_mm_s * 2.0 / BANDWIDTH_RAD_S, rel=0.02)


def test_a_stop_that_voids_the_path_brakes_all_the_same():
    arm = moved(dynamic(), 50)
    arm.load(replace(WITH_PATH, path=None))
    for _ in range(50):
        before = arm.reading
        arm.settle(DT_S)
        assert arm.measured == arm.reading
    assert before == arm.reading == arm.state.joints


def test_an_arm_without_mass_has_nothing_to_settle():
    arm = moved(begun(), 50)
    before = arm.reading
    arm.settle(DT_S)
    assert arm.reading == arm.measured == arm.state.joints == before
    assert arm.seen is arm.state


def test_a_drive_of_which_too_much_is_asked_stops_the_arm():
    """On the approach at the whole of its speed limits, with a tenth of the usual acceleration."""
    arm = PlantArm(
        replace(
            WITH_PATH, limits=replace(LIMITS, acceleration_u=tuple(v // 2 for v in LIMITS.speed_u)).body()
        ),
        joints=AT_START,
        dynamics=True,
    )
    arm.begin(GIVEN)
    fault = None
    while fault is None:
        fault = arm.move(DT_S, moving=True, cutter=True)
    assert fault.cause is StopCause.TRACKING_DEVIATION
    assert fault.detail.startswith("the drive of q")


def test_with_mass_it_can_be_pushed_aside_and_frozen_as_without():
    arm = moved(dynamic(), 20)
    q0 = arm.state.joints[0]
    arm.freeze()
    assert arm.frozen == arm.reading
    arm.push_aside()
    assert arm.reading == arm.state.joints
    assert math.degrees(arm.reading[0] - q0) == pytest.approx(2.0)


@pytest.mark.parametrize("scale", [0.5, 4.0])
def test_the_time_scale_of_an_arm_with_mass_is_that_of_its_plant(scale):
    slow, scaled = moved(dynamic(), 10, scale * DT_S), moved(dynamic(time_scale=scale), 10)
    assert scaled.reading == pytest.approx(slow.reading)


def test_weak_drives_and_power_are_those_of_an_arm_with_mass():
    arm = moved(dynamic(), 20)
    arm.weaken()
    assert arm.driven._drives.acceleration[0] == pytest.approx(0.01 * 5 * LIMITS.speed[0])
    arm.power(on=False)
    assert not arm.driven.powered
    for _ in range(200):
        arm.settle(DT_S)
    assert arm.reading != arm.state.joints
    arm.power(on=True)
    assert arm.driven.powered
    assert arm.driven.at_rest
    assert arm.state == PlantState(arm.reading)


def test_an_arm_without_mass_stands_where_it_is_whatever_its_power():
    arm = moved(begun(), 20)
    before = arm.state
    arm.weaken()
    arm.power(on=False)
    arm.power(on=True)
    assert arm.state is before


@pytest.mark.parametrize(("dt_s", "parts"), [(0.02, 4), (0.1, 20), (0.003, 1)])
def test_the_drives_hear_the_command_every_5_ms_of_the_plant_while_it_goes_on(dt_s, parts, monkeypatch):
    arm, heard = dynamic(), []
    follow = arm.driven.follow
    monkeypatch.setattr(arm.driven, "follow", lambda *command: heard.append(command[2]) or follow(*command))
    arm.move(dt_s, moving=True, cutter=True)
    assert heard == [pytest.approx(dt_s / parts)] * parts
    still = begun()
    asked = []
    part = still._part
    monkeypatch.setattr(still, "_part", lambda gap_s, **how: asked.append(gap_s) or part(gap_s, **how))
    still.move(dt_s, moving=True, cutter=True)
    assert asked == [dt_s], "without mass a cycle is one part"


def test_a_start_is_one_of_an_arm_that_stands_where_its_encoders_say():
    arm = moved(dynamic(), 50)
    reading = arm.reading
    arm.begin(GIVEN)
    assert arm.driven.at_rest
    assert arm.state == PlantState(reading) == arm.seen


def test_an_arm_that_has_not_cut_came_near_to_nothing():
    assert PlantArm(HOLDINGS).distances.least == {}
