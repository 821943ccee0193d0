"""The drives: against an integration by small steps, and what is promised of lag, braking and limits."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.firmware_sim.drives import (
    BANDWIDTH_RAD_S,
    CYCLE_S,
    RAMPS_S,
    SETTLES_S,
    TIME_SCALE_MAX,
    TRIPS_MM,
    TRIPS_RAD,
    DrivenArm,
    Drives,
    DriveState,
    JointMotion,
)
from cutgate.firmware_sim.plant import Leg, PlantState
from cutgate.protocol.records import Limits
from tests.firmware_sim.arms import LIMITS

UNLIMITED = Drives((1e9,) * 5)
LIMITED = Drives((5.0, 5.0, 1000.0, 10.0, 10.0))
HOME = (0.1, -0.2, 300.0, 0.0, 1.0)
LAG_S = 2.0 / BANDWIDTH_RAD_S


def at(joints, speeds, seconds):
    """Joints that have gone on so long."""
    return tuple(joint + speed * seconds for joint, speed in zip(joints, speeds, strict=True))


def ramp(drives, speeds, seconds, state=None, start=HOME):
    """Every state while the command goes on at constant speeds, one a cycle."""
    state, states = state or DriveState.standing(start), []
    for cycle in range(round(seconds / CYCLE_S)):
        before, after = (at(start, speeds, (cycle + more) * CYCLE_S) for more in (0, 1))
        state = drives.follow(state, before, after, CYCLE_S)
        states.append(state)
    return states


def settling(drives, state, command, seconds):
    states = []
    for _ in range(round(seconds / CYCLE_S)):
        state = drives.follow(state, command, command, CYCLE_S)
        states.append(state)
    return states


def speeds_of(state):
    return [joint.speed for joint in state.actual]


@pytest.mark.parametrize("dt_s", [0.0005, 0.005, 0.05])
def test_a_drive_is_a_servo_of_the_second_order_whatever_the_step(dt_s):
    """By small steps of its equation alone: q'' = w^2 (command - q) - 2 w q'."""
    w, small_s, command_speed = BANDWIDTH_RAD_S, 1e-6, 0.4
    position, speed, command = 0.3, -0.2, 0.31
    state = DriveState(*[(JointMotion(position, speed),) * 5] * 2)
    for _ in range(round(dt_s / small_s)):
        pushed = w * w * (command - position) - 2.0 * w * speed
        position, speed = position + speed * small_s, speed + pushed * small_s
        command += command_speed * small_s
    after = UNLIMITED.follow(state, (0.31,) * 5, (0.31 + command_speed * dt_s,) * 5, dt_s)
    assert after.actual == (pytest.approx((position, speed), abs=2e-5),) * 5


def test_the_measured_joints_are_behind_the_command_by_its_lag():
    speeds = (0.2, -0.1, 10.0, 0.05, 0.0)
    last = ramp(UNLIMITED, speeds, 1.0)[-1]
    assert pytest.approx(LAG_S) == UNLIMITED.lag_s
    assert last.joints == pytest.approx(at(HOME, speeds, 1.0 - LAG_S), abs=1e-9)


@given(st.lists(st.floats(-0.25, 0.25), min_size=5, max_size=5), st.floats(0.0, 1.0))
def test_an_arm_whose_command_stops_brakes_along_what_was_commanded_and_never_overshoots(speeds, seconds):
    """All joints in the same proportion: what was a line stays one."""
    moving = ramp(UNLIMITED, speeds, seconds)
    start = moving[-1] if moving else DriveState.standing(HOME)
    stop = at(HOME, speeds, len(moving) * CYCLE_S)
    parts = []
    for state in settling(UNLIMITED, start, stop, 0.5):
        left = [command - joint for command, joint in zip(stop, state.joints, strict=True)]
        part = {round(gap / speed, 5) for gap, speed in zip(left, speeds, strict=True) if abs(speed) > 1e-2}
        assert len(part) <= 1 or max(part) - min(part) < 2e-4
        assert all(
            gap * speed >= -1e-9 and abs(gap) <= abs(speed) * LAG_S + 1e-9
            for gap, speed in zip(left, speeds, strict=True)
        )
        parts.append(state)
    braked_s = 7.0 / BANDWIDTH_RAD_S
    after = parts[math.ceil(braked_s / CYCLE_S)]
    assert all(
        abs(now) <= 0.01 * abs(speed) + 1e-9 for now, speed in zip(speeds_of(after), speeds, strict=True)
    )
    assert parts[-1] == DriveState.standing(stop) or max(map(abs, speeds)) < 1e-3


def test_an_arm_comes_to_rest_exactly_where_it_is_commanded_to():
    state = ramp(LIMITED, (0.2, 0.0, 5.0, 0.1, 0.0), 0.3)[-1]
    stop = at(HOME, (0.2, 0.0, 5.0, 0.1, 0.0), 0.3)
    assert settling(LIMITED, state, stop, 1.0)[-1] == DriveState.standing(stop)


@given(st.lists(st.lists(st.floats(-2.0, 2.0), min_size=5, max_size=5), min_size=1, max_size=6))
def test_no_joint_accelerates_faster_than_its_limit(legs):
    state, place = DriveState.standing(HOME), HOME
    for speeds in legs:
        states = ramp(LIMITED, speeds, 0.1, state, place)
        for before, after in zip([state, *states], states, strict=False):
            for was, now, limit in zip(before.actual, after.actual, LIMITED.acceleration, strict=True):
                assert abs(now.speed - was.speed) <= limit * CYCLE_S * (1 + 1e-9) + 2e-6
        state, place = states[-1], at(place, speeds, 0.1)


def test_a_drive_of_which_too_much_is_asked_falls_behind_and_trips():
    """A joint that is to reverse from its full speed at once."""
    slow = ramp(LIMITED, (0.3, 0.0, 0.0, 0.0, 0.0), 0.5)[-1]
    assert LIMITED.tripped(slow) == ""
    place = at(HOME, (0.3, 0.0, 0.0, 0.0, 0.0), 0.5)
    states = ramp(LIMITED, (-2.0, 0.0, 0.0, 0.0, 0.0), 0.3, slow, place)
    told = next(filter(None, map(LIMITED.tripped, states)))
    assert told.startswith("the drive of q0 is 0.")
    assert "at most 0.200 deg" in told
    assert "286.479 deg/s2" in told
    slide = ramp(LIMITED, (0.0, 0.0, 500.0, 0.0, 0.0), 0.3)
    assert next(filter(None, map(LIMITED.tripped, slide))).startswith("the drive of q2 is 0.")


def test_a_drive_trips_beyond_its_bound_and_not_at_it():
    for joint, bound in ((0, TRIPS_RAD), (2, TRIPS_MM)):
        ideal = DriveState.standing((0.0,) * 5).ideal
        for by, trips in ((bound, False), (bound * (1 + 1e-9), True), (math.nan, True)):
            actual = tuple(JointMotion(by if one == joint else 0.0, 0.0) for one in range(5))
            assert bool(LIMITED.tripped(DriveState(actual, ideal))) is trips


@pytest.mark.parametrize("speed", [-0.7, 0.3])
def test_without_power_each_joint_stops_by_itself_at_its_acceleration_limit(speed):
    state = DriveState(*[tuple(JointMotion(joint, speed) for joint in HOME)] * 2)
    for dt_s in (0.01, 1.0):
        state = LIMITED.brake(state, dt_s)
    for joint, home, limit in zip(state.actual, HOME, LIMITED.acceleration, strict=True):
        assert joint.speed == 0.0
        assert joint.position - home == pytest.approx(math.copysign(speed * speed / (2 * limit), speed))
    assert LIMITED.brake(state, 1.0) == state


def test_in_no_time_nothing_happens():
    state = DriveState(*[tuple(JointMotion(joint, 0.1) for joint in HOME)] * 2)
    assert LIMITED.follow(state, HOME, at(HOME, HOME, 1.0), 0.0) is state


def test_the_drives_have_the_acceleration_limits_of_the_arm_or_such_as_fit_its_speeds():
    given_limits = Limits.quantised(
        q_min_deg=[-80, 0, 50, -170, 0],
        q_max_deg=[80, 145, 450, 170, 110],
        speed_deg_s=[57, 57, 200, 114, 114],
        acceleration_deg_s2=[100, 200, 300, 400, 500],
    )
    assert Drives.of(given_limits).acceleration == pytest.approx(tuple(given_limits.acceleration))
    assert LIMITS.acceleration is None
    assert Drives.of(LIMITS).acceleration == pytest.approx(tuple(LIMITS.speed / RAMPS_S))


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_at_its_acceleration_limit_a_joint_goes_as_one_that_is_pushed_so_hard(side):
    """Towards a command far away: from its own speed, at 5 rad/s2, whichever way."""
    state = DriveState(*[tuple(JointMotion(joint, side * 0.1) for joint in HOME)] * 2)
    far = at(HOME, (side * 1e4,) * 5, 1.0)
    after = LIMITED.follow(state, far, far, 0.02)
    for joint, home, limit in zip(after.actual, HOME, LIMITED.acceleration, strict=True):
        pushed = side * limit
        assert joint.speed == pytest.approx(side * 0.1 + pushed * 0.02)
        assert joint.position == pytest.approx(home + side * 0.1 * 0.02 + pushed * 0.02**2 / 2.0)


def test_a_joint_that_passes_its_command_at_speed_does_not_stand_there():
    for position, speed in ((0.0, 1e-3), (1e-3, 0.0), (0.0, 2e-6), (2e-6, 0.0)):
        state = DriveState(*[(JointMotion(0.0, 0.0),) * 4 + (JointMotion(position, speed),)] * 2)
        after = UNLIMITED.follow(state, (0.0,) * 5, (0.0,) * 5, 1e-9)
        assert after.actual[4] != JointMotion(0.0, 0.0)
    state = DriveState(*[(JointMotion(0.5e-6, 0.5e-6),) * 5] * 2)
    assert UNLIMITED.follow(state, (0.0,) * 5, (0.0,) * 5, 1e-9) == DriveState.standing((0.0,) * 5)


def test_a_drive_that_trips_says_how_far_behind_it_is():
    ideal = DriveState.standing((0.0,) * 5).ideal
    for joint, by, told in (
        (3, math.radians(1.25), "the drive of q3 is 1.250 deg behind"),
        (2, 2.5, "2.500 mm behind"),
    ):
        actual = tuple(JointMotion(by if one == joint else 0.0, 0.0) for one in range(5))
        assert told in LIMITED.tripped(DriveState(actual, ideal))


def test_the_constants_are_those_of_the_manual():
    assert (BANDWIDTH_RAD_S, RAMPS_S, SETTLES_S, TIME_SCALE_MAX) == (40.0, 0.2, 2.0, 10.0)


@pytest.mark.parametrize("kind", [DriveState, Drives])
def test_states_and_drives_are_values(kind):
    assert kind.__dataclass_params__.frozen
    assert "__slots__" in vars(kind)


# ---------------------------------------------------------------- the arm behind its command


def driven(joints=HOME):
    return DrivenArm(LIMITED, PlantState(joints))


def test_an_arm_that_follows_is_seen_as_far_as_its_joints_have_come():
    arm, joints = driven(), HOME
    for segment in range(40):
        after = at(joints, (0.1, 0.0, 5.0, 0.0, 0.0), CYCLE_S)
        visited = arm.follow(joints, PlantState(after, Leg.CUT, segment), CYCLE_S)
        joints = after
    lag = round(LAG_S / CYCLE_S)
    assert arm.seen == PlantState(arm.seen.joints, Leg.CUT, 39 - lag)
    assert visited == (Leg.CUT, 39 - lag, arm.state.joints)
    assert arm.state.joints == pytest.approx(arm.seen.joints, abs=1e-3)
    assert len(arm._commanded) <= lag + 2
    assert not arm.at_rest


def test_an_arm_without_a_command_settles_in_bounded_work_and_then_does_nothing():
    arm, command = driven(), PlantState(at(HOME, (0.001,) * 5, 1.0), Leg.CUT, 7)
    arm.follow(HOME, command, CYCLE_S)
    assert arm.seen.segment == 0
    visited = arm.settle(command, 3600.0)
    assert len(visited) == round(SETTLES_S / CYCLE_S)
    assert arm.at_rest
    assert arm.seen == command
    assert arm.settle(command, 3600.0) == ()


def test_settling_is_following_a_command_that_stands():
    one, other = driven(), driven()
    command = PlantState(at(HOME, (0.001,) * 5, 1.0))
    one.follow(HOME, command, CYCLE_S)
    other.follow(HOME, command, CYCLE_S)
    visited = one.settle(command, 10.0 * CYCLE_S)
    assert visited == tuple(other.follow(command.joints, command, CYCLE_S) for _ in range(10))


def test_an_arm_at_rest_settles_where_another_command_stands():
    arm, command = driven(), PlantState(at(HOME, (0.001,) * 5, 1.0))
    assert len(arm.settle(command, CYCLE_S)) == 1
    assert arm.state != DriveState.standing(HOME)


def test_an_arm_that_loses_power_stands_off_its_command_until_it_is_told_where_it_stands():
    arm, joints = driven(), HOME
    for _ in range(40):
        after = at(joints, (0.2, 0.0, 0.0, 0.0, 0.0), CYCLE_S)
        arm.follow(joints, PlantState(after), CYCLE_S)
        joints = after
    arm.powered = False
    q0 = arm.state.joints[0]
    arm.settle(PlantState(joints), 1.0)
    assert arm.state.joints[0] - q0 == pytest.approx(0.2**2 / (2 * 5.0), rel=0.01)
    assert not arm.at_rest
    assert arm.tripped() == ""
    arm.stand(PlantState(arm.state.joints))
    assert arm.at_rest


def test_an_arm_is_powered_and_its_drives_trip():
    arm, fast = driven(), at(HOME, (3.0, 0.0, 0.0, 0.0, 0.0), CYCLE_S)
    for _ in range(20):
        arm.follow(HOME, PlantState(fast), CYCLE_S)
        fast = at(fast, (3.0, 0.0, 0.0, 0.0, 0.0), CYCLE_S)
    assert arm.tripped().startswith("the drive of q0")
    arm.powered = False
    assert arm.tripped() == ""


def test_weak_drives_have_a_part_of_their_acceleration():
    arm = driven()
    arm.weaken(0.1)
    assert arm._drives.acceleration == pytest.approx([0.1 * limit for limit in LIMITED.acceleration])


def test_an_arm_of_fewer_joints_is_none():
    short = DriveState.standing(HOME).actual[:4]
    for state in (DriveState(short, short), DriveState(short, DriveState.standing(HOME).ideal)):
        for wrong in (
            lambda state=state: LIMITED.follow(state, HOME, HOME, CYCLE_S),
            lambda state=state: LIMITED.brake(state, CYCLE_S),
        ):
            with pytest.raises(ValueError, match="zip"):
                wrong()
    with pytest.raises(ValueError, match="zip"):
        LIMITED.tripped(DriveState(short, DriveState.standing(HOME).ideal))
