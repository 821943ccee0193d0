"""How a session ends whose controller has a fault: both loops in virtual time, each fault by its name."""

import math
from dataclasses import replace
from itertools import pairwise

import pytest

from cutgate.firmware_sim import memory
from cutgate.firmware_sim.bone import BoneMotion
from cutgate.firmware_sim.faults import FaultName
from cutgate.firmware_sim.loop import POWERLESS_S
from cutgate.protocol import records
from cutgate.protocol.frames import ControllerHeartbeat
from cutgate.protocol.records import NO_TREE_HEAD
from cutgate.protocol.states import ControllerState, Refusal, StopCause
from cutgate.runtime.interlock.refusals import told
from cutgate.runtime.interlock.state import Phase
from tests.runtime.session.test_controller import refusals
from tests.runtime.session.test_session import first_frames


def powered_again(pair):
    """Time for the controller to come up."""
    return pair.until(lambda: "power is back" in pair.said, limit_s=2.0 * POWERLESS_S)


def remembered(pair):
    return memory.load(pair.memory_file, now_us=0)


# ---------------------------------------------------------------- power


@pytest.mark.parametrize("state", ["loaded", "permitted", "cutting"])
def test_a_controller_that_loses_power_is_lost_and_another_session_cuts(pair, state):
    pair.power_up(f"power-loss@{state}", time_scale=0.5)
    boot = pair.controller.announce_nonce
    assert pair.end() is Phase.STOPPED
    assert pair.state.cause is StopCause.HEARTBEAT_LOST
    place = pair.process.arm.reading
    powered_again(pair)
    assert pair.controller.announce_nonce != boot
    assert pair.controller.state is ControllerState.INHIBITED
    assert pair.controller.holdings.path is None
    assert pair.process.arm.reading == place
    pair.close()
    pair.power_up(time_scale=4.0)
    assert pair.begin().end() is Phase.DONE


def test_a_controller_that_loses_power_before_its_session_is_open_is_waited_for(pair):
    pair.power_up("power-loss@open")
    assert pair.end() is Phase.DONE
    assert "power is back" in pair.said


def test_nothing_is_sent_without_power(pair):
    pair.power_up("power-loss@cutting", time_scale=0.5)
    pair.begin().until(lambda: pair.process._dark_until_s is not None, act=pair._lead)
    sent = len(pair.wire.frames(ControllerHeartbeat))
    pair.controller_terminal.type("bone-motion")
    pair.run(0.9 * POWERLESS_S)
    assert len(pair.wire.frames(ControllerHeartbeat)) == sent
    powered_again(pair)
    assert not pair.controller.memory.withdrawal_due, "nobody was there to hear it"


@pytest.mark.parametrize("dynamics", [False, True])
def test_the_brakes_stop_an_arm_without_power(pair, dynamics):
    pair.power_up(time_scale=1.0, dynamics=dynamics)
    pair.to(Phase.CUTTING).run(1.0)
    pair.process._happen(FaultName.POWER_LOSS)
    pair.run(0.2)
    place = pair.process.arm.reading
    powered_again(pair)
    assert pair.process.arm.reading == place == pair.process.arm.state.joints
    assert pair.end() is Phase.STOPPED


def test_a_start_whose_writing_is_torn_moves_nothing_and_is_not_remembered(pair):
    pair.power_up("torn-write@permitted")
    before = pair.process.arm.reading
    assert pair.end() is Phase.STOPPED
    assert pair.state.cause is StopCause.HEARTBEAT_LOST
    powered_again(pair)
    assert (remembered(pair).log, pair.process.arm.reading) == (NO_TREE_HEAD, before)
    assert list(pair.memory_file.parent.glob(f".{pair.memory_file.name}.*.new"))
    pair.close()
    assert pair.begin().end() is Phase.DONE


def test_a_start_that_is_written_and_not_answered_moves_nothing_and_is_remembered(pair):
    pair.power_up("unanswered-write@permitted")
    before = pair.process.arm.reading
    assert pair.end() is Phase.STOPPED
    assert pair.state.cause is StopCause.HEARTBEAT_LOST
    powered_again(pair)
    assert first_frames(pair, records.Start)
    assert remembered(pair).log.log_id == pair.log_id
    assert pair.process.arm.reading == before
    pair.close()
    assert pair.begin().end() is Phase.DONE


@pytest.mark.parametrize(("fault", "kept"), [("torn-write", False), ("unanswered-write", True)])
def test_a_motion_of_the_bone_is_told_before_power_is_lost_in_writing_it_down(pair, fault, kept):
    """What the controller then does not remember the runtime has listed."""
    pair.to(Phase.CUTTING)
    pair.process._happen(FaultName(fault))
    pair.controller_terminal.type("bone-motion")
    assert pair.end() is Phase.STOPPED
    assert pair.state.cause is StopCause.BONE_MOVED
    powered_again(pair)
    assert (pair.job.place in remembered(pair).withdrawn) is kept


# ---------------------------------------------------------------- bits that flip


def test_a_bit_of_a_limit_that_flips_after_the_upload_is_found_at_the_permit(pair):
    pair.power_up("flip-limit-bit@loaded")
    assert pair.end() is Phase.REFUSED
    assert pair.state.reason == f"the controller refused the permit: {told(Refusal.LIMITS_DIGEST)}"


def test_a_bit_of_a_limit_that_flips_after_the_permit_is_found_at_the_start(pair):
    pair.power_up("flip-limit-bit@permitted")
    pair.begin().until(lambda: bool(refusals(pair)), act=pair._lead)
    assert refusals(pair)[0] == f"the controller refused the start: {told(Refusal.LIMITS_DIGEST)}"


def test_a_bit_of_a_limit_that_flips_before_the_records_are_collected_is_none_of_the_approved(pair):
    pair.power_up("flip-limit-bit@inhibited")
    assert pair.end() is Phase.REFUSED
    assert "controller's joint limits equal the approved: q" in pair.state.reason


def test_a_bit_of_its_memory_that_flips_is_found_when_it_is_powered_up_and_it_stays_down(pair):
    pair.power_up("flip-memory-bit@cutting", "power-loss@done")
    pair.end()
    damaged = pair.memory_file.read_bytes()
    pair.run(2.0 * POWERLESS_S)
    assert any(line.startswith("the controller does not start: ") for line in pair.said)
    assert pair.process._dark_until_s == math.inf
    assert pair.memory_file.read_bytes() == damaged
    with pytest.raises(memory.ControllerMemoryError):
        remembered(pair)


# ---------------------------------------------------------------- the loop


def test_a_slow_controller_is_tolerated_while_it_keeps_its_time_out(pair):
    pair.power_up("slow@loaded", slow_s=0.03)
    assert pair.end() is Phase.DONE
    late = [seen.at_s for seen, _ in pair.wire.frames(ControllerHeartbeat)]
    assert max(b - a for a, b in pairwise(late)) >= 0.03


def test_a_controller_that_is_slower_than_its_time_out_stops(pair):
    pair.power_up("slow@cutting", slow_s=0.15, time_scale=0.5)
    assert pair.end() is Phase.STOPPED
    assert pair.state.cause in (StopCause.HEARTBEAT_LOST, StopCause.LOOP_STALLED)
    assert not pair.controller.may_move


def test_a_controller_that_hangs_for_good_is_lost_and_its_arm_stands(pair):
    pair.power_up("hung@cutting", time_scale=0.5, dynamics=True)
    assert pair.end() is Phase.STOPPED
    assert pair.state.cause is StopCause.HEARTBEAT_LOST
    pair.run(0.5)
    arm = pair.process.arm
    assert arm.reading == arm.state.joints
    pair.controller_terminal.type("release")
    before = pair.said[:]
    pair.run(5.0)
    assert pair.said == before


# ---------------------------------------------------------------- the bone


def test_a_bone_that_moves_stops_the_cut(pair):
    pair.power_up("bone-motion@cutting", time_scale=0.5)
    assert pair.end() is Phase.STOPPED
    assert (pair.state.cause, pair.controller.cause) == (StopCause.BONE_MOVED, StopCause.BONE_MOVED)
    assert "the bone has moved by 1 mm" in pair.said


def test_a_bone_moves_by_itself_so_long_after_the_start(pair):
    pair.power_up(time_scale=0.5, bone_motion=BoneMotion(1.5, 0.5))
    assert pair.end() is Phase.STOPPED
    assert pair.state.cause is StopCause.BONE_MOVED
    assert pair.controller.moved_at_s - pair.controller.started_at_s == pytest.approx(1.5, abs=0.01)


def test_a_motion_that_the_sensor_does_not_tell_stops_nothing_and_is_shown_once(pair):
    pair.power_up(bone_motion=BoneMotion(0.5, 0.1))
    assert pair.end() is Phase.DONE
    assert [
        line for line in pair.said if line.startswith("the bone has moved by 0.1 mm, less than the 0.2 mm")
    ]
    assert sum(line.startswith("the bone") for line in pair.said) == 1


# ---------------------------------------------------------------- other nodes


@pytest.mark.parametrize(
    ("fault", "runtime", "controller"),
    [
        ("second-controller", StopCause.AUTHENTICATION_FAILED, StopCause.SECOND_NODE),
        ("second-runtime", StopCause.SECOND_NODE, StopCause.AUTHENTICATION_FAILED),
    ],
)
@pytest.mark.parametrize("state", ["permitted", "cutting"])
def test_another_node_that_says_the_heartbeat_of_one_side_latches_both(
    pair, fault, runtime, controller, state
):
    pair.power_up(f"{fault}@{state}", time_scale=0.5)
    assert pair.end() is Phase.STOPPED
    assert (pair.state.cause, pair.controller.cause) == (runtime, controller)
    assert pair.controller.state is ControllerState.FAULT


# ---------------------------------------------------------------- the drives


def test_a_weak_drive_trips_and_an_arm_without_mass_has_none(pair):
    pair.power_up("weak-drive@cutting", time_scale=1.0, dynamics=True)
    assert pair.end() is Phase.STOPPED
    assert pair.state.cause is StopCause.TRACKING_DEVIATION
    assert any("the drive of q" in line for line in pair.said)


# ---------------------------------------------------------------- the arm as it is


def test_an_arm_that_stands_where_it_may_not_is_stopped_by_its_limit_switch_whatever_it_reports(pair):
    """45 deg of the shoulder: every reading is what was verified."""
    reported = records.Calibration.parse(pair.job.calibration)
    true = replace(reported, joint_offset_u=(-45 * records.UNIT, *reported.joint_offset_u[1:]))
    pair.power_up(true_calibration=true)
    assert pair.end() is Phase.STOPPED
    assert (pair.state.cause, pair.controller.cause) == (StopCause.LIMIT_EXCEEDED, StopCause.LIMIT_EXCEEDED)
    assert any("the arm stopped by itself: limit switch of the true arm: q0 = " in line for line in pair.said)
