"""The simulated arm: it executes every segment, in order, no faster than its limits, and stops at once."""

import dataclasses
import math
import time
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cutgate.firmware_sim.approach import BoundApproach
from cutgate.firmware_sim.kinematics import (
    KinematicsError,
    Pose,
    calibrated_arm,
    forward,
    interpolate,
    inverse,
    on_nearest_revolutions,
)
from cutgate.firmware_sim.path_check import PathCheck
from cutgate.firmware_sim.plant import BlockError, Leg, Plant, PlantFault, PlantState, StoredPath
from cutgate.protocol.path import PathHeader
from cutgate.protocol.records import UNIT, Path, split
from cutgate.protocol.states import StopCause
from tests.firmware_sim.arms import (
    CALIBRATED,
    LIMITS,
    NOMINAL,
    PATH,
    TOOL,
    TOOL_MM,
    WIDE,
    line_path,
    pocket,
    tilted,
)

PLANT = Plant(LIMITS, NOMINAL)
STORED = StoredPath.of(PATH.body())
DT_S = 0.02


def first_joints(plant, path):
    """Joints at the first pose on the path's branch."""
    arm = calibrated_arm(
        plant.calibration, tool_mm=TOOL_MM, elbow=path.elbow, hold_roll_rad=plant.hold_roll_rad
    )
    q0, q1, q2, q3, q4 = inverse(arm, path.pose(0))
    return q0 + math.tau * path.q0_turns, q1, q2, q3 + math.tau * path.roll_turns, q4


def out(pose, distance_um):
    """The pose so far along its axis."""
    return Pose(tuple(t + distance_um / 1000 * u for t, u in zip(*pose, strict=True)), pose.axis)


@cache
def way(plant, path, start=None, *, out_um=(30_000, 40_000), speed=0.25):
    """Approach and retract of a path, its joints followed pose by pose; from the entry itself where no start is given."""
    arm = calibrated_arm(
        plant.calibration, tool_mm=TOOL_MM, elbow=path.elbow, hold_roll_rad=plant.hold_roll_rad
    )
    joints = first = first_joints(plant, path)
    entry = on_nearest_revolutions(inverse(arm, out(path.pose(0), out_um[0])), first)
    try:
        for index in range(len(path)):
            joints = on_nearest_revolutions(inverse(arm, path.pose(index)), joints)
        leave = on_nearest_revolutions(inverse(arm, out(path.pose(len(path) - 1), out_um[1])), joints)
    except KinematicsError:
        leave = entry  # never reached
    return BoundApproach(start or entry, entry, leave, *out_um, speed)


def at_cut(plant, path, offset=(0.0, 0.0, 0.0, 0.0, 0.0)):
    """The arm about to cut, or so much off the first pose."""
    q0, q1, q2, q3, q4 = (q + off for q, off in zip(first_joints(plant, path), offset, strict=True))
    return PlantState((q0, q1, q2, q3, q4), Leg.CUT)


def drive(plant, path, *, dt_s=DT_S, time_scale=1.0, ticks=100_000):
    """Cut until the last pose is reached or something stopped; every step taken."""
    state, steps = at_cut(plant, path), []
    for _ in range(ticks):
        step = plant.advance(
            state, path, way(plant, path), dt_s=dt_s, moving=True, cutter=True, time_scale=time_scale
        )
        steps.append(step)
        state = step.state
        if state.leg is not Leg.CUT or step.fault is not None:
            return steps
    raise AssertionError(f"not at its end after {ticks} ticks: {state}")


@pytest.mark.parametrize("calibration", [NOMINAL, CALIBRATED])
def test_every_segment_is_executed_in_order_and_the_last_pose_is_reached_exactly(calibration):
    steps = drive(Plant(LIMITS, calibration), STORED)
    assert [segment for step in steps for segment in step.executed] == list(range(len(PATH) - 1))
    last = steps[-1].state
    assert (last.leg, last.progress) == (Leg.EXIT, (len(PATH) - 2, 1.0))
    arm = calibrated_arm(calibration, tool_mm=TOOL_MM, elbow="right")
    pose, there = forward(arm, last.joints), out(STORED.pose(len(PATH) - 1), 40_000 * last.fraction)
    np.testing.assert_allclose(pose.tip, there.tip, atol=1e-9)
    np.testing.assert_allclose(pose.axis, there.axis, atol=1e-12)
    assert all(step.state.moving for step in steps)


def test_the_arm_is_always_on_the_path():
    arm = calibrated_arm(NOMINAL, tool_mm=TOOL_MM, elbow="right")
    for step in drive(PLANT, STORED, time_scale=7.3)[:-1]:
        state = step.state
        on_path = interpolate(STORED.pose(state.segment), STORED.pose(state.segment + 1), state.fraction)
        pose = forward(arm, state.joints)
        np.testing.assert_allclose(pose.tip, on_path.tip, atol=1e-9)
        np.testing.assert_allclose(pose.axis, on_path.axis, atol=1e-12)


def planned_s(path):
    tips, axes = path.tips_mm, path.axes
    turn = np.arccos(np.clip(np.sum(axes[1:] * axes[:-1], axis=1), -1, 1))
    longest = np.maximum(np.linalg.norm(np.diff(tips, axis=0), axis=1), path.tool_length_mm * turn)
    return float(np.sum(longest)) / path.feed_mm_s


@pytest.mark.parametrize("time_scale", [1.0, 20.0])
def test_the_path_takes_the_planned_time(time_scale):
    for path in (PATH, line_path((500, 0, 100), (500, 5, 100), polar=(30, 60))):  # tip bound, tool bound
        took_s = (
            len(drive(PLANT, StoredPath.of(path.body()), dt_s=0.005, time_scale=time_scale))
            * 0.005
            * time_scale
        )
        assert planned_s(path) <= took_s <= planned_s(path) * 1.001 + 0.01 * time_scale


def test_joint_speeds_hold_the_feed_back_where_it_would_exceed_them():
    path = StoredPath.of(dataclasses.replace(PATH, feed_u=5_000 * UNIT).body())
    steps = drive(PLANT, path, dt_s=0.001)
    before = first_joints(PLANT, path)
    for step in steps:
        speed = np.abs(np.subtract(step.state.joints, before)) / 0.001
        assert np.all(speed <= LIMITS.speed * (1 + 1e-9))
        assert step.speed_ratio <= 1.0
        before = step.state.joints
    assert max(step.speed_ratio for step in steps) == 1.0
    assert any(step.slowed for step in steps)
    assert len(steps) * 0.001 > planned_s(PATH) * 10 / 5_000 * 2


def test_an_axis_that_passes_close_to_the_vertical_is_slowed_to_the_rolls_limit():
    """0.3 deg beside the vertical the roll turns by nearly half a turn within one segment."""
    axes = np.array([[math.sin(a), math.sin(math.radians(0.3)), math.cos(a)] for a in np.radians([20, -20])])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    tips = np.array([[500.0, 50.0, 100.0], [500.0, 52.0, 100.0]])
    path = Path.quantised(tips, axes, feed_mm_s=100, tool_length_mm=TOOL_MM, elbow="right")
    steps = drive(Plant(WIDE, NOMINAL), StoredPath.of(path.body()), dt_s=0.002)
    rolls = [step.state.joints[3] for step in steps]
    assert abs(rolls[-1] - rolls[0]) > 2.5
    assert np.max(np.abs(np.diff(rolls))) <= WIDE.speed[3] * 0.002 * (1 + 1e-9)
    assert any(step.slowed for step in steps)


@given(st.lists(st.tuples(st.floats(0, 0.2), st.booleans()), min_size=1, max_size=60), st.floats(0.1, 50))
@settings(max_examples=25)
def test_whatever_the_ticks_nothing_is_skipped_and_no_joint_is_too_fast(ticks, time_scale):
    path = StoredPath.of(dataclasses.replace(PATH, feed_u=300 * UNIT).body())
    state, executed = at_cut(PLANT, path), []
    for dt_s, moving in ticks:
        step = PLANT.advance(
            state, path, way(PLANT, path), dt_s=dt_s, moving=moving, cutter=False, time_scale=time_scale
        )
        assert step.fault is None
        executed += step.executed
        change = np.abs(np.subtract(step.state.joints, state.joints))
        assert np.all(change <= LIMITS.speed * dt_s * time_scale * (1 + 1e-9) + 1e-15)
        if not moving:
            assert dataclasses.replace(step.state, moving=state.moving) == state
        state = step.state
    assert executed == list(range(state.segment + (state.leg > Leg.CUT)))


def test_without_leave_to_move_the_arm_stands_at_once():
    steps = drive(PLANT, STORED)
    state = steps[3].state
    assert state.moving
    held = PLANT.advance(state, STORED, way(PLANT, STORED), dt_s=1.0, moving=False, cutter=False)
    assert held.state == dataclasses.replace(state, moving=False, cutter=False)
    assert not held.executed
    again = PLANT.advance(held.state, STORED, way(PLANT, STORED), dt_s=DT_S, moving=True, cutter=True)
    assert again.state == steps[4].state


def test_at_the_end_nothing_moves_any_more():
    last = dataclasses.replace(drive(PLANT, STORED, time_scale=50)[-1].state, done=True, moving=False)
    step = PLANT.advance(last, STORED, way(PLANT, STORED), dt_s=1.0, moving=True, cutter=True)
    assert step.state == last
    assert not step.executed


def test_the_whole_path_can_be_done_in_one_step():
    step = drive(PLANT, STORED, dt_s=1000.0)
    assert len(step) == 1
    assert step[0].executed == range(len(PATH) - 1)
    assert step[0].state.done


def test_no_time_is_no_motion():
    state = at_cut(PLANT, STORED)
    step = PLANT.advance(state, STORED, way(PLANT, STORED), dt_s=0.0, moving=True, cutter=True)
    assert step.state == dataclasses.replace(state, cutter=True)


@pytest.mark.parametrize(
    ("dt_s", "time_scale"),
    [(-1.0, 1.0), (math.nan, 1.0), (math.inf, 1.0), (1.0, 0.0), (1.0, -1.0), (1.0, math.nan)],
)
def test_a_time_that_is_none_is_refused(dt_s, time_scale):
    state = at_cut(PLANT, STORED)
    with pytest.raises(ValueError, match="must be finite"):
        PLANT.advance(
            state, STORED, way(PLANT, STORED), dt_s=dt_s, moving=True, cutter=True, time_scale=time_scale
        )


def test_a_limit_that_would_be_exceeded_stops_the_arm_before_it():
    path = StoredPath.of(line_path((500, 0, 100), (500, 0, -150), polar=(30, 30), azimuth=(0, 0)).body())
    steps = drive(PLANT, path, time_scale=10)
    last = steps[-1]
    assert last.fault.cause is StopCause.LIMIT_EXCEEDED
    assert "q2 = " in last.fault.detail
    assert "outside [50.000000, 450.000000]" in last.fault.detail
    assert not last.state.moving
    assert not last.state.done
    for step in steps:
        assert step.state.joints[2] >= LIMITS.q_min[2]


def test_the_middle_of_a_segment_is_watched_too():
    """Both poses keep q1's upper limit, the line between them does not: no check of poses alone finds it."""
    limits = dataclasses.replace(LIMITS, q_max_u=(80_000_000, 60_000_000, *LIMITS.q_max_u[2:]))
    axes = tilted([30.0, 30.0])
    wrists = np.array([[700.0, -400.0, 200.0], [700.0, 400.0, 200.0]])
    path = Path.quantised(wrists - TOOL_MM * axes, axes, feed_mm_s=10, tool_length_mm=TOOL_MM, elbow="right")
    assert PathCheck(path, limits, NOMINAL, TOOL).run().detail == ""
    fault = drive(Plant(limits, NOMINAL), StoredPath.of(path.body()), time_scale=50)[-1].fault
    assert fault.cause is StopCause.LIMIT_EXCEEDED
    assert "q1" in fault.detail


def test_a_short_excursion_within_a_long_segment_is_seen_even_in_one_step():
    """q1 exceeds its limit on 20 mm of 700 mm, and turns too little there for the turn of a joint to tell."""
    highest = 2 * math.acos(700 / 900)  # where the wrist is nearest, 700 mm from the column
    limits = dataclasses.replace(
        LIMITS, q_max_u=(80_000_000, round((math.degrees(highest) - 0.01) * UNIT), *LIMITS.q_max_u[2:])
    )
    axes = tilted([30.0, 30.0])
    wrists = np.array([[700.0, -400.0, 200.0], [700.0, 300.0, 200.0]])
    path = Path.quantised(wrists - TOOL_MM * axes, axes, feed_mm_s=10, tool_length_mm=TOOL_MM, elbow="right")
    step = drive(Plant(limits, NOMINAL), StoredPath.of(path.body()), dt_s=1000.0)[-1]
    assert step.fault.cause is StopCause.LIMIT_EXCEEDED
    assert step.state.fraction == pytest.approx(390 / 700, abs=5 / 700)


def test_a_path_that_leaves_the_reach_stops_the_arm():
    path = StoredPath.of(line_path((500, 0, 100), (1500, 0, 100), poses=3).body())
    fault = drive(Plant(WIDE, NOMINAL), path, time_scale=50)[-1].fault
    assert fault.cause is StopCause.LIMIT_EXCEEDED
    assert "out of reach" in fault.detail


def test_a_path_through_the_column_stops_the_arm():
    axes = tilted([90.0, 90.0], 0.0)
    tips = np.array([[-200.0, 0.0, 0.0], [200.0, 0.0, 0.0]]) - TOOL_MM * axes
    path = Path.quantised(tips, axes, feed_mm_s=10, tool_length_mm=TOOL_MM, elbow="right")
    steps = drive(Plant(WIDE, NOMINAL), StoredPath.of(path.body()), time_scale=50)
    assert steps[-1].fault.cause is StopCause.LIMIT_EXCEEDED
    assert "jumps" in steps[-1].fault.detail
    assert steps[-1].state.fraction < 0.5 + 1e-6


@pytest.mark.parametrize("joint", range(5))
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_measured_joint_is_too_fast_beyond_its_limit_and_what_its_rounding_explains(joint, sign):
    limit, before = float(LIMITS.speed[joint]), (0.1, 0.2, 300.0, 0.4, 0.5)

    def after(moved):
        return tuple(at + sign * moved * (j == joint) for j, at in enumerate(before))

    for time_s in (0.0, 0.02, 1.0):
        assert PLANT.too_fast(before, after(limit * time_s + 0.9e-6), time_s) is None
        fault = PLANT.too_fast(before, after(limit * time_s + 1.1e-6), time_s)
        assert fault.cause is StopCause.LIMIT_EXCEEDED
        assert fault.detail == (
            f"q{joint} moved by {limit * time_s + 1.1e-6:.6f} in {time_s:.6f} s, at most {limit:.6f} a second"
        )


def test_a_measured_joint_that_is_no_number_is_too_fast():
    fault = PLANT.too_fast((0.0,) * 5, (0.0, math.nan, 0.0, 0.0, 0.0), 1.0)
    assert fault.detail.startswith("q1 moved by nan")


@pytest.mark.parametrize(("offset", "moves"), [((0, 0, 0.4, 0, 0), True), ((0, 0, 1.1, 0, 0), False),
                                               ((0.002, 0, 0, -0.002, 0), True), ((0, 0.01, 0, 0, 0), False)])  # fmt: skip
def test_an_arm_off_its_path_does_not_move(offset, moves):
    state = at_cut(PLANT, STORED, offset)
    step = PLANT.advance(state, STORED, way(PLANT, STORED), dt_s=DT_S, moving=True, cutter=True)
    if moves:
        assert step.fault is None
        assert step.state.moving
    else:
        assert step.fault.cause is StopCause.TRACKING_DEVIATION
        assert "off its place on segment 0" in step.fault.detail
        assert step.state.joints == state.joints
        assert not step.state.moving


def test_every_pose_of_every_block_is_read_as_the_record_says():
    path = pocket(poses=777)
    stored = StoredPath.of(path.body())
    assert len(split(path.body())) == 4
    assert len(stored) == 777
    order = np.random.default_rng(1).permutation(777)
    for index in order.tolist():
        pose = stored.pose(index)
        assert pose.tip == tuple(path.tips_mm[index])
        assert pose.axis == tuple(path.axes[index])


@pytest.mark.parametrize("block", [0, 1, 3])
def test_a_flipped_bit_stops_the_arm_before_its_block_is_executed(block):
    path = pocket(poses=777)
    parts = split(path.body())
    blocks = [bytearray(part.decoded()) for part in parts]
    stored = StoredPath(PathHeader.of(path.body()), blocks, [part.block_crc32 for part in parts])
    if block == 0:
        blocks[0][100] ^= 1
        with pytest.raises(BlockError, match="block 0 of 4"):
            stored.pose(0)
        return
    state, there = at_cut(PLANT, stored), way(PLANT, stored)
    blocks[block][100] ^= 1
    first_bad = (4000 * block - 40) // 20
    executed = []
    while True:
        step = PLANT.advance(state, stored, there, dt_s=DT_S, moving=True, cutter=True, time_scale=300)
        executed += step.executed
        state = step.state
        if step.fault is not None:
            break
    assert step.fault == PlantFault(
        StopCause.PATH_CHANGED, f"stored path block {block} of 4 does not have its CRC-32 any more"
    )
    assert executed == list(range(first_bad - 1))  # the segment that ends in the bad block is not begun


# ---------------------------------------------------------------- approach and retract


ELSEWHERE = tuple(math.radians(q) if joint != 2 else q for joint, q in enumerate((40, 30, 400, -120, 80)))


def whole(plant, path, bound, *, dt_s=DT_S, time_scale=1.0, ticks=100_000):
    """From the start joints to done or a stop: every state, and every step taken."""
    states, steps = [PlantState(bound.start)], []
    for _ in range(ticks):
        steps.append(
            plant.advance(states[-1], path, bound, dt_s=dt_s, moving=True, cutter=True, time_scale=time_scale)
        )
        states.append(steps[-1].state)
        if states[-1].done or steps[-1].fault is not None:
            return states, steps
    raise AssertionError(f"not done after {ticks} ticks: {states[-1]}")


@pytest.mark.parametrize("calibration", [NOMINAL, CALIBRATED])
def test_every_leg_is_executed_in_order_and_the_arm_returns_to_where_it_stood(calibration):
    plant = Plant(LIMITS, calibration)
    states, steps = whole(plant, STORED, way(plant, STORED, ELSEWHERE))
    assert states[-1].joints == ELSEWHERE
    assert (states[-1].done, states[-1].moving, states[-1].leg) == (True, False, Leg.RETRACT)
    legs = [state.leg for state in states]
    assert legs == sorted(legs)
    assert set(legs) == set(Leg)
    assert [segment for step in steps for segment in step.executed] == list(range(len(PATH) - 1))


def test_the_progress_shows_the_cut_alone():
    states, _ = whole(PLANT, STORED, way(PLANT, STORED, ELSEWHERE))
    for state in states:
        if state.leg < Leg.CUT:
            assert state.progress == (0, 0.0)
        elif state.leg > Leg.CUT:
            assert state.progress == (len(PATH) - 2, 1.0)
    shown = [state.progress for state in states]
    assert shown == sorted(shown)


@pytest.mark.parametrize("leg", [Leg.APPROACH, Leg.RETRACT])
def test_on_a_joint_line_all_joints_are_linear_and_the_slowest_has_its_part_of_its_limit(leg):
    bound = way(PLANT, STORED, ELSEWHERE)
    first, last = (bound.start, bound.entry) if leg is Leg.APPROACH else (bound.exit, bound.start)
    change = np.subtract(last, first)
    states, steps = whole(PLANT, STORED, bound)
    on_it = [state for state in states if state.leg is leg and 0 < state.fraction < 1]
    for state in on_it:
        np.testing.assert_allclose(state.joints, first + state.fraction * change, atol=1e-12)
    slowest_s = float(np.max(np.abs(change) / LIMITS.speed)) / 0.25
    assert len(on_it) * DT_S == pytest.approx(slowest_s, abs=2 * DT_S)
    ratio = max(step.speed_ratio for step, state in zip(steps, states, strict=False) if state in on_it[1:-1])
    assert ratio == pytest.approx(0.25, rel=1e-6)


@pytest.mark.parametrize(("leg", "index", "outer"), [(Leg.ENTRY, 0, "entry"), (Leg.EXIT, -1, "exit")])
def test_between_entry_first_pose_last_pose_and_exit_the_tip_moves_along_the_tool_at_the_feed(
    leg, index, outer
):
    bound = way(PLANT, STORED, ELSEWHERE)
    arm = calibrated_arm(NOMINAL, tool_mm=TOOL_MM, elbow="right")
    tip, axis = PATH.tips_mm[index], PATH.axes[index]
    out_mm = getattr(bound, f"{outer}_um") / 1000
    states, _ = whole(PLANT, STORED, bound)
    on_it = [state for state in states if state.leg is leg and 0 < state.fraction < 1]
    assert len(on_it) * DT_S == pytest.approx(out_mm / PATH.feed_mm_s, abs=2 * DT_S)
    for state in on_it:
        pose = forward(arm, state.joints)
        np.testing.assert_allclose(pose.axis, axis, atol=1e-12)
        beyond = out_mm * (state.fraction if leg is Leg.EXIT else 1.0 - state.fraction)
        np.testing.assert_allclose(pose.tip, tip + beyond * axis, atol=1e-9)


def test_a_roll_that_stands_a_turn_off_is_unwound_on_the_joint_line():
    plant, turn = Plant(WIDE, NOMINAL), math.tau
    q0, q1, q2, q3, q4 = way(plant, STORED).entry
    bound = way(plant, STORED, (q0, q1, q2, q3 + turn, q4))
    states, _ = whole(plant, STORED, bound)
    rolls = np.array([state.joints[3] for state in states])
    assert rolls[0] == rolls[-1] == q3 + turn
    assert min(rolls) < q3 + 1.0
    assert np.max(np.abs(np.diff(rolls))) < 0.1
    assert all(state.joints[:3] == (q0, q1, q2) for state in states if state.leg is Leg.APPROACH)


@given(st.lists(st.tuples(st.floats(0, 0.2), st.booleans()), min_size=1, max_size=80), st.floats(0.1, 100))
@settings(max_examples=25)
def test_no_joint_is_too_fast_on_any_leg_whatever_the_ticks(ticks, time_scale):
    bound = way(PLANT, STORED, ELSEWHERE, speed=1.0)
    state = PlantState(bound.start)
    for dt_s, moving in ticks:
        step = PLANT.advance(
            state, STORED, bound, dt_s=dt_s, moving=moving, cutter=False, time_scale=time_scale
        )
        assert step.fault is None
        change = np.abs(np.subtract(step.state.joints, state.joints))
        assert np.all(change <= LIMITS.speed * dt_s * time_scale * (1 + 1e-9) + 1e-12)
        state = step.state


@pytest.mark.parametrize("leg", Leg)
def test_the_arm_stands_at_once_and_does_not_move_off_its_line_on_every_leg(leg):
    bound = way(PLANT, STORED, ELSEWHERE)
    states, _ = whole(PLANT, STORED, bound)
    state = next(state for state in states if state.leg is leg and state.fraction > 0.3)
    held = PLANT.advance(state, STORED, bound, dt_s=1.0, moving=False, cutter=False)
    assert held.state == dataclasses.replace(state, moving=False, cutter=False)
    for joint, off in ((2, 1.1), (3, 0.01)):
        joints = tuple(q + off * (j == joint) for j, q in enumerate(state.joints))
        astray = dataclasses.replace(state, joints=joints)
        step = PLANT.advance(astray, STORED, bound, dt_s=DT_S, moving=True, cutter=True)
        assert step.fault.cause is StopCause.TRACKING_DEVIATION
        assert ("segment" if leg is Leg.CUT else leg.name.lower()) in step.fault.detail
        assert (step.state.joints, step.state.moving) == (joints, False)


@pytest.mark.parametrize("leg", [Leg.APPROACH, Leg.RETRACT])
def test_a_joint_line_is_left_at_a_limit(leg):
    """Its ends were checked; should a limit be narrower by now, the arm stops before it."""
    bound = way(PLANT, STORED, ELSEWHERE)
    states, _ = whole(PLANT, STORED, bound)
    state = next(state for state in states if state.leg is leg and state.fraction > 0.5)
    at = state.joints[4]
    toward = (1 if leg is Leg.RETRACT else -1) * math.degrees(0.01)
    edge = round((math.degrees(at) + toward) * UNIT)
    limits = dataclasses.replace(
        LIMITS,
        **{
            "q_max_u" if toward > 0 else "q_min_u": (
                *(LIMITS.q_max_u if toward > 0 else LIMITS.q_min_u)[:4],
                edge,
            )
        },
    )
    step = Plant(limits, NOMINAL).advance(state, STORED, bound, dt_s=5.0, moving=True, cutter=True)
    assert step.fault.cause is StopCause.LIMIT_EXCEEDED
    assert "q4" in step.fault.detail
    assert leg.name.lower() in step.fault.detail


def test_without_a_way_to_go_each_leg_is_done_at_once():
    first = first_joints(PLANT, STORED)
    bound = way(PLANT, STORED, first, out_um=(0, 0))
    state = PLANT.advance(PlantState(first), STORED, bound, dt_s=1e-3, moving=True, cutter=True).state
    assert state.leg is Leg.CUT


def test_a_held_roll_carries_a_vertical_tool():
    tips = np.column_stack((np.linspace(500, 550, 5), np.zeros(5), np.full(5, 100.0)))
    path = Path.quantised(
        tips, np.tile([0.0, 0, 1], (5, 1)), feed_mm_s=10, tool_length_mm=TOOL_MM, elbow="right"
    )
    steps = drive(Plant(LIMITS, NOMINAL, hold_roll_rad=0.3), StoredPath.of(path.body()))
    assert {step.state.joints[3] for step in steps} == {0.3}
    assert steps[-1].state.leg is Leg.EXIT


def test_duplicate_poses_take_no_time_and_are_executed():
    tips = np.repeat([[500.0, 0, 100], [510.0, 0, 100]], 3, axis=0)
    path = Path.quantised(tips, tilted([30.0] * 6), feed_mm_s=10, tool_length_mm=TOOL_MM, elbow="right")
    steps = drive(PLANT, StoredPath.of(path.body()))
    assert [segment for step in steps for segment in step.executed] == list(range(5))
    assert len(steps) * DT_S == pytest.approx(1.0, abs=0.05)


def test_five_metres_of_path_cost_little():
    path = StoredPath.of(pocket().body())
    begin = time.process_time()
    steps = drive(PLANT, path, time_scale=80)
    cost_s = time.process_time() - begin
    assert steps[-1].state.leg > Leg.CUT
    assert len(steps) * DT_S < 8.0
    assert cost_s < 2.0  # measured 0.06 s; a quarter of a core would be 1.6 s
