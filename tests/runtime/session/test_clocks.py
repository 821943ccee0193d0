"""Loops that stand still, and the two that a clock drives for real."""

import os
from dataclasses import replace

import pytest

from cutgate.protocol.frames import ControllerHeartbeat, RuntimeHeartbeat
from cutgate.protocol.records import Side
from cutgate.protocol.states import ControllerState, StopCause
from cutgate.runtime.interlock.phases import ENDED
from cutgate.runtime.interlock.state import Phase
from tests.runtime.session.wire import Clock


@pytest.fixture
def cutting(pair):
    pair.power_up(time_scale=0.05)
    return pair.to(Phase.CUTTING).run(0.1)


def test_a_wedged_runtime_stops_the_arm_within_the_time_out(cutting):
    cutting.runtime_runs = False
    began_s = cutting.clock()
    cutting.until(lambda: not cutting.controller.may_move)
    assert cutting.clock() - began_s <= 0.100 + 2 * cutting.cycle_s
    assert cutting.controller.cause is StopCause.HEARTBEAT_LOST
    place = cutting.process.arm.state.joints
    cutting.run(0.2)
    assert cutting.process.arm.state.joints == place


def test_a_runtime_that_wakes_up_discards_what_queued_and_says_that_it_stalled(cutting):
    cutting.runtime_runs = False
    cutting.run(0.5)
    cutting.runtime_runs = True
    assert cutting.wire.nodes[0].inbox
    cutting.run_cycle()
    assert cutting.state.cause is StopCause.LOOP_STALLED
    assert "frames discarded" in cutting.state.reason
    assert cutting.end() is Phase.STOPPED


@pytest.mark.parametrize("side", Side)
def test_no_heartbeat_of_a_turn_that_stalled_says_what_was_right_before_it(cutting, side):
    """The clocks are looked at and the table is fed before the heartbeat: what it says was decided in this turn."""
    cutting.runtime_runs = side is Side.CONTROLLER
    cutting.controller_runs = side is Side.RUNTIME
    cutting.run(0.11)
    cutting.runtime_runs = cutting.controller_runs = True
    kind = RuntimeHeartbeat if side is Side.RUNTIME else ControllerHeartbeat
    before = len(cutting.wire.frames(kind))
    cutting.run_cycle()
    assert StopCause.NONE not in {beat.cause for _, beat in cutting.wire.frames(kind)[before:]}
    assert cutting.state.cause is not StopCause.NONE
    assert cutting.controller.cause is not StopCause.NONE


def test_a_gap_within_the_time_out_is_not_a_stall(cutting):
    """What was echoed last was sent up to two heartbeats ago; the time-out runs from there."""
    cutting.cycle_s = 0.05
    cutting.run_cycle()
    cutting.cycle_s = 0.005
    cutting.run(0.2)
    assert cutting.phase is Phase.CUTTING


def test_a_controller_that_hangs_stops_by_itself_when_it_wakes_up(pair):
    pair.power_up("hang@cutting", time_scale=0.05)
    assert pair.end() is Phase.STOPPED
    assert pair.state.cause is StopCause.HEARTBEAT_LOST
    assert "this computer was not late" in pair.state.reason
    pair.run(0.2)
    assert pair.controller.cause is StopCause.LOOP_STALLED
    assert pair.controller.state is ControllerState.INHIBITED


@pytest.mark.parametrize("seconds", [0.06, 0.09])
def test_a_lost_heartbeat_says_how_long_this_side_stood_still(cutting, seconds):
    """Not for as long as the time-out; with what the controller then does not say any more it is too long."""
    cutting.runtime_runs = False
    cutting.run(seconds)
    cutting.runtime_runs, cutting.controller_runs = True, False
    cutting.until(lambda: cutting.phase is not Phase.CUTTING)
    assert cutting.state.cause is StopCause.HEARTBEAT_LOST
    assert (
        "no fresh controller heartbeat within 100 ms; this computer stood still for" in cutting.state.reason
    )
    told_ms = int(cutting.state.reason.split(" ms")[-2].rsplit(" ", 1)[1])
    assert seconds <= told_ms / 1000 <= seconds + 3 * cutting.cycle_s


def test_a_heartbeat_is_sent_only_by_a_turn(cutting):
    cutting.runtime_runs = False
    before = len(cutting.wire.frames(RuntimeHeartbeat))
    cutting.run(0.3)
    assert len(cutting.wire.frames(RuntimeHeartbeat)) == before


class Leaping(Clock):
    """Goes on by more than a heartbeat whenever it is read, so that no loop has to wait."""

    def __call__(self):
        self.now_s += 0.03
        return self.now_s


def leaping(pair):
    pair.clock = pair.disk.clock = pair.wire.clock = Leaping()
    return pair


def test_the_loop_ends_when_the_session_does(pair):
    deadlines = replace(pair.job.deadlines, announce_wait_s=1.0)
    leaping(pair).begin(replace(pair.job, deadlines=deadlines))
    reading, writing = os.pipe()
    state = pair.session.run(reading)
    os.close(reading)
    os.close(writing)
    assert state.phase is Phase.REFUSED
    assert "no controller announced itself" in state.reason


def test_a_signal_wakes_the_loop_and_quits(pair):
    leaping(pair).begin()
    reading, writing = os.pipe2(os.O_NONBLOCK)
    os.write(writing, b"\0\0")
    pair.session.interrupt()
    state = pair.session.run(reading)
    with pytest.raises(BlockingIOError):  # emptied, or it would wake the loop for ever
        os.read(reading, 1)
    os.close(reading)
    os.close(writing)
    assert (state.phase, state.cause) == (Phase.STOPPED, StopCause.OPERATOR_QUIT)


def test_a_session_without_a_terminal_can_be_waited_for(pair):
    pair.begin()
    pair.session._commands = None
    leaping(pair)
    pair.session._clock = pair.clock
    reading, writing = os.pipe()
    pair.session.interrupt()
    assert pair.session.run(reading).cause is StopCause.OPERATOR_QUIT
    os.close(reading)
    os.close(writing)


# ---------------------------------------------------------------- standing still at the bus


def stands_at_the_bus(pair, port, seconds):
    """The next read of this port takes so long, with what is on the bus by then."""
    honest = port.read

    def read(now_s):
        port.read = honest
        pair.clock.now_s += seconds
        return honest(now_s)

    port.read = read


@pytest.mark.parametrize("seconds", [0.09, 0.11])
def test_a_runtime_that_stands_still_at_the_bus_says_so_in_the_same_turn(cutting, seconds):
    stands_at_the_bus(cutting, cutting.session._port, seconds)
    cutting.controller_runs = False
    cutting.run_cycle()
    stalled = seconds > 0.1
    assert (cutting.state.cause is StopCause.LOOP_STALLED) is stalled
    assert ("at the bus" in cutting.state.reason) is stalled


@pytest.mark.parametrize("seconds", [0.09, 0.11])
def test_a_controller_that_stands_still_at_the_bus_stops_in_the_same_turn(cutting, seconds):
    stands_at_the_bus(cutting, cutting.process.port, seconds)
    cutting.runtime_runs = False
    cutting.run_cycle()
    stalled = seconds > 0.1
    assert (cutting.controller.cause is StopCause.LOOP_STALLED) is stalled
    assert cutting.controller.may_move is not stalled


@pytest.mark.parametrize("earlier_s", [0.0, 0.005, 0.01, 0.05, 0.09])
def test_however_the_heartbeats_lie_to_each_other_a_short_path_is_permitted(pair, earlier_s):
    """It is verified within one heartbeat: then the runtime's own may not yet have echoed one of the controller's."""
    slow = replace(pair.job.timing, heartbeat_ms=100, timeout_ms=1000)
    pair.begin(replace(pair.job, timing=slow)).to(Phase.COLLECTING)
    pair.session._cycle.next_heartbeat_s -= earlier_s
    pair.to(Phase.PERMITTED, *ENDED)
    assert pair.phase is Phase.PERMITTED, pair.state.reason
