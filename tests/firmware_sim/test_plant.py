"""The simulated arm: it executes every segment, in order, no faster than its limits, and stops at once."""

import dataclasses
import math
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_sim.kinematics import OutOfReachError, calibrated_arm, forward, interpolate, inverse
from firmware_sim.path_check import PathCheck
from firmware_sim.plant import BlockError, Plant, PlantFault, StoredPath
from protocol.records import UNIT, Path, split
from protocol.states import StopCause
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
STORED = StoredPath.of(PATH)
DT_S = 0.02


def drive(plant, path, *, dt_s=DT_S, time_scale=1.0, ticks=100_000):
    """Move until done or stopped; every step taken."""
    state, steps = plant.place_at_first_pose(path), []
    for _ in range(ticks):
        step = plant.advance(state, path, dt_s=dt_s, moving=True, cutter=True, time_scale=time_scale)
        steps.append(step)
        state = step.state
        if state.done or step.fault is not None:
            return steps
    raise AssertionError(f"not done after {ticks} ticks: {state}")


def test_the_arm_powers_up_at_the_first_pose():
    state = Plant(LIMITS, CALIBRATED).place_at_first_pose(STORED)
    pose = forward(calibrated_arm(CALIBRATED, tool_mm=TOOL_MM, elbow="right"), state.joints)
    np.testing.assert_allclose(pose.tip, PATH.tips_mm[0], atol=1e-9)
    np.testing.assert_allclose(pose.axis, PATH.axes[0], atol=1e-12)
    assert (state.segment, state.fraction, state.moving, state.cutter, state.done) == (
        0,
        0.0,
        False,
        False,
        False,
    )


def test_the_arm_can_be_placed_off_the_first_pose_and_on_other_turns():
    path = StoredPath.of(dataclasses.replace(PATH, q0_turns=1, roll_turns=-2))
    base = PLANT.place_at_first_pose(STORED).joints
    off = (0.01, 0.0, 0.6, 0.0, -0.02)
    joints = PLANT.place_at_first_pose(path, offset=off).joints
    turns = (math.tau, 0, 0, -2 * math.tau, 0)
    assert joints == pytest.approx(tuple(np.add(np.add(base, off), turns)))


def test_a_first_pose_out_of_reach_is_refused():
    path = StoredPath.of(line_path((1500, 0, 100), (1400, 0, 100)))
    with pytest.raises(OutOfReachError):
        PLANT.place_at_first_pose(path)


@pytest.mark.parametrize("calibration", [NOMINAL, CALIBRATED])
def test_every_segment_is_executed_in_order_and_the_last_pose_is_reached_exactly(calibration):
    steps = drive(Plant(LIMITS, calibration), STORED)
    assert [segment for step in steps for segment in step.executed] == list(range(len(PATH) - 1))
    last = steps[-1].state
    assert (last.done, last.moving, last.segment, last.fraction) == (True, False, len(PATH) - 2, 1.0)
    arm = calibrated_arm(calibration, tool_mm=TOOL_MM, elbow="right")
    assert last.joints == pytest.approx(inverse(arm, STORED.pose(len(PATH) - 1)), abs=1e-12)
    assert all(step.state.moving for step in steps[:-1])


def test_the_arm_is_always_on_the_path():
    arm = calibrated_arm(NOMINAL, tool_mm=TOOL_MM, elbow="right")
    for step in drive(PLANT, STORED, time_scale=7.3):
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
            len(drive(PLANT, StoredPath.of(path), dt_s=0.005, time_scale=time_scale)) * 0.005 * time_scale
        )
        assert planned_s(path) <= took_s <= planned_s(path) * 1.001 + 0.01 * time_scale


def test_joint_speeds_hold_the_feed_back_where_it_would_exceed_them():
    path = StoredPath.of(dataclasses.replace(PATH, feed_u=5_000 * UNIT))
    steps = drive(PLANT, path, dt_s=0.001)
    before = PLANT.place_at_first_pose(path).joints
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
    steps = drive(Plant(WIDE, NOMINAL), StoredPath.of(path), dt_s=0.002)
    rolls = [step.state.joints[3] for step in steps]
    assert abs(rolls[-1] - rolls[0]) > 2.5
    assert np.max(np.abs(np.diff(rolls))) <= WIDE.speed[3] * 0.002 * (1 + 1e-9)
    assert any(step.slowed for step in steps)


@given(st.lists(st.tuples(st.floats(0, 0.2), st.booleans()), min_size=1, max_size=60), st.floats(0.1, 50))
@settings(max_examples=25)
def test_whatever_the_ticks_nothing_is_skipped_and_no_joint_is_too_fast(ticks, time_scale):
    path = StoredPath.of(dataclasses.replace(PATH, feed_u=300 * UNIT))
    state, executed = PLANT.place_at_first_pose(path), []
    for dt_s, moving in ticks:
        step = PLANT.advance(state, path, dt_s=dt_s, moving=moving, cutter=False, time_scale=time_scale)
        assert step.fault is None
        executed += step.executed
        change = np.abs(np.subtract(step.state.joints, state.joints))
        assert np.all(change <= LIMITS.speed * dt_s * time_scale * (1 + 1e-9) + 1e-15)
        if not moving:
            assert dataclasses.replace(step.state, moving=state.moving) == state
        state = step.state
    assert executed == list(range(state.segment + state.done))


def test_without_leave_to_move_the_arm_stands_at_once():
    steps = drive(PLANT, STORED)
    state = steps[3].state
    assert state.moving
    held = PLANT.advance(state, STORED, dt_s=1.0, moving=False, cutter=False)
    assert held.state == dataclasses.replace(state, moving=False, cutter=False)
    assert not held.executed
    again = PLANT.advance(held.state, STORED, dt_s=DT_S, moving=True, cutter=True)
    assert again.state == steps[4].state


def test_at_the_end_nothing_moves_any_more():
    last = drive(PLANT, STORED, time_scale=50)[-1].state
    step = PLANT.advance(last, STORED, dt_s=1.0, moving=True, cutter=True)
    assert step.state == last
    assert not step.executed


def test_the_whole_path_can_be_done_in_one_step():
    step = drive(PLANT, STORED, dt_s=1000.0)
    assert len(step) == 1
    assert step[0].executed == range(len(PATH) - 1)


def test_no_time_is_no_motion():
    state = PLANT.place_at_first_pose(STORED)
    step = PLANT.advance(state, STORED, dt_s=0.0, moving=True, cutter=True)
    assert step.state == dataclasses.replace(state, cutter=True)


@pytest.mark.parametrize(
    ("dt_s", "time_scale"),
    [(-1.0, 1.0), (math.nan, 1.0), (math.inf, 1.0), (1.0, 0.0), (1.0, -1.0), (1.0, math.nan)],
)
def test_a_time_that_is_none_is_refused(dt_s, time_scale):
    state = PLANT.place_at_first_pose(STORED)
    with pytest.raises(ValueError, match="must be finite"):
        PLANT.advance(state, STORED, dt_s=dt_s, moving=True, cutter=True, time_scale=time_scale)


def test_a_limit_that_would_be_exceeded_stops_the_arm_before_it():
    path = StoredPath.of(line_path((500, 0, 100), (500, 0, -150), polar=(30, 30), azimuth=(0, 0)))
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
    fault = drive(Plant(limits, NOMINAL), StoredPath.of(path), time_scale=50)[-1].fault
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
    step = drive(Plant(limits, NOMINAL), StoredPath.of(path), dt_s=1000.0)[-1]
    assert step.fault.cause is StopCause.LIMIT_EXCEEDED
    assert step.state.fraction == pytest.approx(390 / 700, abs=5 / 700)


def test_a_path_that_leaves_the_reach_stops_the_arm():
    path = StoredPath.of(line_path((500, 0, 100), (1500, 0, 100), poses=3))
    fault = drive(Plant(WIDE, NOMINAL), path, time_scale=50)[-1].fault
    assert fault.cause is StopCause.LIMIT_EXCEEDED
    assert "out of reach" in fault.detail


def test_a_path_through_the_column_stops_the_arm():
    axes = tilted([90.0, 90.0], 0.0)
    tips = np.array([[-200.0, 0.0, 0.0], [200.0, 0.0, 0.0]]) - TOOL_MM * axes
    path = Path.quantised(tips, axes, feed_mm_s=10, tool_length_mm=TOOL_MM, elbow="right")
    steps = drive(Plant(WIDE, NOMINAL), StoredPath.of(path), time_scale=50)
    assert steps[-1].fault.cause is StopCause.LIMIT_EXCEEDED
    assert "jumps" in steps[-1].fault.detail
    assert steps[-1].state.fraction < 0.5 + 1e-6


@pytest.mark.parametrize(("offset", "moves"), [((0, 0, 0.4, 0, 0), True), ((0, 0, 1.1, 0, 0), False),
                                               ((0.002, 0, 0, -0.002, 0), True), ((0, 0.01, 0, 0, 0), False)])  # fmt: skip
def test_an_arm_off_its_path_does_not_move(offset, moves):
    state = PLANT.place_at_first_pose(STORED, offset=offset)
    step = PLANT.advance(state, STORED, dt_s=DT_S, moving=True, cutter=True)
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
    stored = StoredPath.of(path)
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
    blocks = [bytearray(part.data) for part in split(path.body())]
    stored = StoredPath(path, blocks, [part.block_crc32 for part in split(path.body())])
    if block == 0:
        blocks[0][100] ^= 1
        with pytest.raises(BlockError, match="block 0 of 4"):
            PLANT.place_at_first_pose(stored)
        return
    state = PLANT.place_at_first_pose(stored)
    blocks[block][100] ^= 1
    first_bad = (4000 * block - 40) // 20
    executed = []
    while True:
        step = PLANT.advance(state, stored, dt_s=DT_S, moving=True, cutter=True, time_scale=300)
        executed += step.executed
        state = step.state
        if step.fault is not None:
            break
    assert step.fault == PlantFault(
        StopCause.PATH_CHANGED, f"stored path block {block} of 4 does not have its CRC-32 any more"
    )
    assert executed == list(range(first_bad - 1))  # the segment that ends in the bad block is not begun


def test_a_held_roll_carries_a_vertical_tool():
    tips = np.column_stack((np.linspace(500, 550, 5), np.zeros(5), np.full(5, 100.0)))
    path = Path.quantised(
        tips, np.tile([0.0, 0, 1], (5, 1)), feed_mm_s=10, tool_length_mm=TOOL_MM, elbow="right"
    )
    steps = drive(Plant(LIMITS, NOMINAL, hold_roll_rad=0.3), StoredPath.of(path))
    assert {step.state.joints[3] for step in steps} == {0.3}
    assert steps[-1].state.done


def test_duplicate_poses_take_no_time_and_are_executed():
    tips = np.repeat([[500.0, 0, 100], [510.0, 0, 100]], 3, axis=0)
    path = Path.quantised(tips, tilted([30.0] * 6), feed_mm_s=10, tool_length_mm=TOOL_MM, elbow="right")
    steps = drive(PLANT, StoredPath.of(path))
    assert [segment for step in steps for segment in step.executed] == list(range(5))
    assert len(steps) * DT_S == pytest.approx(1.0, abs=0.05)


def test_five_metres_of_path_cost_little():
    path = StoredPath.of(pocket())
    begin = time.process_time()
    steps = drive(PLANT, path, time_scale=80)
    cost_s = time.process_time() - begin
    assert steps[-1].state.done
    assert len(steps) * DT_S < 8.0
    assert cost_s < 2.0  # measured 0.06 s; a quarter of a core would be 1.6 s
