"""Whole sessions under the tracking monitor: sound ones never trip it, every deviation stops in the turn that shows it."""

import math
import random
from dataclasses import replace
from functools import partial

import pytest

from cutgate.firmware_sim.arm import DRIFT_DEG_S
from cutgate.firmware_sim.faults import FaultName
from cutgate.firmware_sim.loop import Process
from cutgate.firmware_sim.plant import Leg
from cutgate.protocol import records
from cutgate.protocol.frames import ControllerHeartbeat, Joint4, Joints01, Joints23, Progress, RuntimeStop
from cutgate.protocol.states import ControllerState, StopCause
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.replay import ReplayOutcome
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.interlock.tracking import TrackingTolerance
from tests.runtime.session.test_session import first_frames
from tests.runtime.session.wire import lose, nth, of

JOINTS = (Joints01, Joints23, Joint4)


def on(pair, leg, fraction=0.3):
    """Turn until the arm is so far on a leg."""
    return pair.to(Phase.CUTTING).until(
        lambda: pair.process.arm.state.leg is leg and pair.process.arm.state.fraction >= fraction
    )


def stopped_by_the_monitor(pair):
    """The session has ended for a deviation that the runtime alone has seen."""
    assert pair.end() is Phase.STOPPED
    assert pair.state.cause is StopCause.TRACKING_DEVIATION
    assert pair.controller.cause is StopCause.TRACKING_DEVIATION
    assert not any("the arm stopped by itself" in line for line in pair.said)
    assert not pair.controller.may_move
    return pair.state.reason


# ---------------------------------------------------------------- sound sessions


@pytest.mark.parametrize("time_scale", [0.3, 1.0, 4.0, 60.0])
def test_a_sound_session_never_trips_it(pair, time_scale):
    pair.power_up(time_scale=time_scale)
    assert pair.begin().end(limit_s=60.0) is Phase.DONE


class Jitter:
    """Each frame of the controller is late by its own delay; the order of what one node sends is kept."""

    def __init__(self, pair, delays):
        self._pair, self._delays, self._last_s, self._count = pair, delays, 0.0, 0

    def __call__(self, message):
        if message.arbitration_id in {of(kind) for kind in (ControllerHeartbeat, *JOINTS, Progress)}:
            self._count += 1
            due_s = self._pair.clock() + self._delays[self._count % len(self._delays)]
            self._last_s = max(self._last_s, due_s)
            self._pair.wire.delay_s[message.arbitration_id] = self._last_s - self._pair.clock()
        return [message]


@pytest.mark.parametrize("seed", range(6))
def test_neither_jitter_nor_tolerated_losses_trip_it(pair, seed):
    """Delays up to what the heartbeat's time-out allows; every fifth frame and its neighbour may be lost.

    A heartbeat that comes at once and the next one late by the most are a period and that delay apart; what they echo was
    sent a period before, and each side sees it up to a turn later. Later than that, HEARTBEAT_LOST is right.
    """
    draw = random.Random(seed)
    timing = pair.job.timing
    most_s = (timing.timeout_ms - 2 * timing.heartbeat_ms) / 1000 - 3 * pair.cycle_s
    percent, latest_s = draw.randint(10, 100), draw.choice([0.015, 0.03, most_s])
    pair.power_up(time_scale=draw.choice([1.0, 2.0, 7.0, 60.0]))
    pair.begin(replace(pair.job, timing=replace(timing, approach_speed_percent=percent)))
    pair.to(Phase.STARTING)
    pair.wire.rules.append(Jitter(pair, [draw.uniform(0.0, latest_s) for _ in range(17)]))
    for kind in (*JOINTS, Progress):
        lost = {
            5 * at + more for at in range(100) if draw.random() < 0.3 for more in range(draw.randint(1, 2))
        }
        pair.wire.rules.append(nth(of(kind), lost, lose))
    assert pair.end(limit_s=40.0) is Phase.DONE, pair.state.reason


# ---------------------------------------------------------------- what deviates


@pytest.mark.parametrize("leg", Leg)
def test_a_drift_that_the_controller_does_not_see_is_stopped_on_every_leg(pair, leg):
    pair.power_up(time_scale=1.0)
    on(pair, leg, 0.0 if leg is Leg.RETRACT else 0.3)
    pair.process._happen(FaultName.DRIFT)
    began_s = pair.clock()
    reason = stopped_by_the_monitor(pair)
    assert "deg off the verified path near" in reason
    assert "at most 0.618 mm and 0.255 deg" in reason or leg is Leg.APPROACH
    turned = math.radians(DRIFT_DEG_S) * (pair.clock() - began_s)
    assert turned * 900.0 < 6.0, "mm: far less than the deadbands leave"
    pair.close()
    assert pair.read().report.status is Status.OK
    assert pair.replayed().outcome is ReplayOutcome.IDENTICAL
    (entry,) = [fault for fault in pair.read().of("/audit/fault") if fault["cause"] == "TRACKING_DEVIATION"][
        :1
    ]
    assert entry["detail"] == reason


def test_the_stop_leaves_in_the_turn_in_which_the_deviation_is_seen(pair):
    pair.power_up(time_scale=1.0)
    on(pair, Leg.CUT)
    q0, *rest = pair.process.arm.state.joints
    pair.process.arm.frozen = (
        q0 + math.radians(0.2),
        *rest,
    )  # 0.2 deg of a shoulder that carries 900 mm at most
    pair.until(lambda: pair.phase is Phase.STOPPING)
    shown = [seen for seen, _ in pair.wire.frames(Joint4)][-1]
    (stop, _) = pair.wire.frames(RuntimeStop)[0]
    assert stop.at_s == shown.at_s
    stopped_by_the_monitor(pair)


def test_joints_that_stand_still_while_the_progress_goes_on_are_stopped(pair):
    pair.power_up("freeze@cutting", time_scale=1.0)
    pair.to(Phase.CUTTING).until(
        lambda: pair.process.arm.state.leg is Leg.CUT or pair.phase is Phase.STOPPED, 20.0
    )
    stopped_by_the_monitor(pair)


@pytest.mark.parametrize("leg", [Leg.APPROACH, Leg.CUT, Leg.RETRACT])
def test_an_arm_that_runs_faster_than_it_may_is_stopped(pair, leg):
    pair.power_up(time_scale=1.0)
    on(pair, leg, 0.1)
    pair.process._happen(FaultName.RUSH)
    began_s = pair.clock()
    reason = stopped_by_the_monitor(pair)
    gained_s = 2.0 * (pair.clock() - began_s)
    assert gained_s < 0.5, reason


def test_a_time_scale_that_is_not_announced_is_stopped(pair, monkeypatch):
    monkeypatch.setattr(records.Announce, "time_scale", property(lambda _: 1.0))
    pair.power_up(time_scale=4.0)
    pair.begin().end()
    stopped_by_the_monitor(pair)


def test_progress_that_jumps_while_the_joints_do_not_is_stopped(pair, monkeypatch):
    pair.power_up(time_scale=1.0)
    on(pair, Leg.APPROACH)
    honest = Process._heartbeat

    def jumps(process, now_s):
        there = process.arm.state
        process.arm.frozen, process.arm.state = there.joints, replace(there, leg=Leg.CUT, segment=3)
        honest(process, now_s)
        process.arm.frozen, process.arm.state = None, there

    monkeypatch.setattr(Process, "_heartbeat", jumps)
    assert "progress is segment 3, fraction" in stopped_by_the_monitor(pair)


def test_a_controller_that_says_done_too_early_is_not_believed(pair):
    pair.power_up(time_scale=1.0)
    on(pair, Leg.CUT, 0.1)
    pair.process.controller = replace(pair.controller, state=ControllerState.DONE)
    pair.run_cycle()
    assert pair.end() is Phase.STOPPED
    assert "the controller reports the end, at most" in pair.state.reason


def test_an_end_elsewhere_than_at_the_start_is_none_for_the_controller_itself(pair):
    pair.power_up(time_scale=1.0)
    on(pair, Leg.CUT, 0.1)
    pair.process.arm.state = replace(pair.process.arm.state, done=True)
    assert pair.end() is Phase.STOPPED
    assert (pair.controller.state, pair.controller.cause) == (
        ControllerState.INHIBITED,
        StopCause.TRACKING_DEVIATION,
    )
    assert not any(beat.state is ControllerState.DONE for _, beat in pair.wire.frames(ControllerHeartbeat))
    assert pair.state.reason == "the controller reports TRACKING_DEVIATION"


def test_a_drift_so_late_that_done_is_reported_is_no_completed_cut(pair):
    """Within tolerance of the path all the way, by a site's wide one; the controller does not see it at all."""
    pair.power_up(time_scale=1.0)
    pair.begin(replace(pair.job, tracking=TrackingTolerance(wrist_mm=5.0, joint_deg=2.0)))
    on(pair, Leg.RETRACT, 0.8)
    pair.process._happen(FaultName.DRIFT)
    assert pair.end() is Phase.STOPPED
    assert any(line.startswith("state DONE") for line in pair.said)
    assert pair.state.cause is StopCause.TRACKING_DEVIATION
    assert pair.state.reason.startswith(
        "the controller reports the end, but the arm is not back: measured wrist centre to the verified start: "
    )
    assert pair.controller.cause is StopCause.TRACKING_DEVIATION
    pair.close()
    last = next(entry for entry in pair.read().of("/audit/decision") if entry["from_state"] == "finishing")
    assert (last["event"], last["to_state"], last["first_out"]) == (
        "joints measured",
        "stopping",
        "TRACKING_DEVIATION",
    )
    assert last["reason"] == pair.state.reason
    assert last["permissives"][0]["holds"] is False
    assert pair.replayed().outcome is ReplayOutcome.IDENTICAL


def after_the_end(pair, rule, message):
    """The rule holds from the controller's DONE on."""
    return rule(message) if pair.controller.state is ControllerState.DONE else [message]


@pytest.mark.parametrize("waiting", [2, 3])
@pytest.mark.parametrize("off", range(4))
def test_of_several_samples_that_came_in_one_turn_each_is_judged(pair, waiting, off):
    """The runtime did not turn for less than its time-out; one of the samples that wait was measured off the path."""
    pair.power_up(time_scale=1.0)
    on(pair, Leg.CUT, 0.1)
    pair.until(lambda: pair.process._cycle.next_heartbeat_s - pair.clock() > 0.015)  # between two samples
    pair.runtime_runs = False
    for number in range(waiting):
        measured = len(pair.wire.frames(Joint4))
        if number == off:
            q0, *rest = pair.process.arm.state.joints
            pair.process.arm.frozen = (q0 + math.radians(0.4), *rest)
        pair.until(lambda measured=measured: len(pair.wire.frames(Joint4)) > measured)
        pair.process.arm.frozen = None
    pair.runtime_runs = True
    pair.run_cycle()
    if off >= waiting:
        assert pair.phase is Phase.CUTTING
        return
    assert pair.phase is Phase.STOPPING
    assert "deg off the verified path near segment" in stopped_by_the_monitor(pair)


@pytest.mark.parametrize("lost", [2, 1000])
def test_the_end_waits_for_joints_measured_after_it_and_not_for_ever(pair, lost):
    pair.power_up(time_scale=1.0)
    on(pair, Leg.RETRACT)
    losing = [nth(of(kind), range(lost), lose) for kind in JOINTS]
    pair.wire.rules += [partial(after_the_end, pair, rule) for rule in losing]
    pair.until(lambda: pair.phase is Phase.FINISHING)
    began_s = pair.clock()
    if lost == 2:
        assert pair.end() is Phase.DONE
        return
    assert "no measured joints" in stopped_by_the_monitor(pair)
    (stop, _) = pair.wire.frames(RuntimeStop)[0]
    assert stop.at_s - began_s <= 0.200 + 2 * pair.cycle_s


@pytest.mark.parametrize("kind", [*JOINTS, Progress])
def test_silence_of_joints_or_progress_alone_is_stopped_within_two_time_outs(pair, kind):
    pair.power_up(time_scale=1.0)
    on(pair, Leg.CUT, 0.1)
    pair.wire.rules.append(lambda message: [] if message.arbitration_id == of(kind) else [message])
    began_s = pair.clock()
    reason = stopped_by_the_monitor(pair)
    assert ("no progress" if kind is Progress else "no measured joints") in reason
    assert "at most 200 ms" in reason
    (stop, _) = pair.wire.frames(RuntimeStop)[0]
    assert stop.at_s - began_s <= 0.200 + 2 * pair.cycle_s


def test_joints_that_are_late_are_stopped(pair):
    """The heartbeats are on time, the joints are three time-outs old: no safe age for what is watched."""
    pair.power_up(time_scale=1.0)
    on(pair, Leg.CUT, 0.1)
    for kind in JOINTS:
        pair.wire.delay_s[of(kind)] = 0.3
    stopped_by_the_monitor(pair)


def test_joints_that_come_later_and_later_are_stopped_once_they_are_two_time_outs_old(pair):
    """None is silent for long, none is off the path: each is a little older than the one before."""
    pair.power_up(time_scale=1.0)
    on(pair, Leg.APPROACH, 0.1)
    began_s = pair.clock()

    def later():
        for kind in JOINTS:
            pair.wire.delay_s[of(kind)] = (pair.clock() - began_s) / 4

    pair.until(lambda: pair.phase is Phase.STOPPING, act=later)
    sent_now_s, growth = pair.wire.delay_s[of(Joint4)], 1 + 1 / 4  # what came now was sent when it was less
    assert sent_now_s <= growth * (0.2 + 0.2 / 4) + 0.01
    assert "no measured joints" in stopped_by_the_monitor(pair)


# ---------------------------------------------------------------- the monitor itself is a condition


def test_without_a_reference_trajectory_nothing_is_permitted(pair):
    pair.begin().verdict_altered(lambda verdict: replace(verdict, trajectory=None))
    assert pair.end() is Phase.REFUSED
    assert "reference trajectory: none" in pair.state.reason
    assert not first_frames(pair, records.Permit)


def test_the_sites_tolerances_are_used(pair):
    pair.power_up(time_scale=1.0)
    pair.begin(replace(pair.job, tracking=TrackingTolerance(wrist_mm=4.0, joint_deg=1.5)))
    on(pair, Leg.CUT)
    pair.process._happen(FaultName.DRIFT)
    assert "at most 4.118 mm and 1.505 deg" in stopped_by_the_monitor(pair)


# ---------------------------------------------------------------- the controller's own


@pytest.mark.parametrize("joint", range(5))
def test_a_joint_that_is_measured_faster_than_its_limit_stops_the_controller_by_itself(pair, joint):
    """A knock within its position tolerance: less than 1 mm and 0.5 deg, in one cycle of 5 ms."""
    pair.power_up(time_scale=1.0)
    on(pair, Leg.CUT)
    for part, stopped in ((0.5, False), (1.1, True)):
        joints = list(pair.process.arm.state.joints)
        limit = (1.0, 1.0, 200.0, 2.0, 2.0)[joint] * pair.cycle_s
        joints[joint] += min(part * limit, 0.99 if joint == 2 else math.radians(0.49))
        if stopped and joint > 1:  # no knock within the tolerance of position is as fast
            pair.process.arm.plant = replace(
                pair.process.arm.plant, limits=slower(pair.process.arm.plant.limits)
            )
        said = len(pair.said)
        fault = pair.process.arm.plant.too_fast(pair.process.arm.state.joints, tuple(joints), pair.cycle_s)
        assert (fault is not None) is stopped
        assert len(pair.said) == said
    pair.process.arm.measured = tuple(joints)
    pair.run_cycle()
    assert any(f"the arm stopped by itself: q{joint} moved by" in line for line in pair.said)
    assert pair.controller.cause is StopCause.LIMIT_EXCEEDED
    assert pair.controller.state is ControllerState.FAULT
    assert pair.end() is Phase.STOPPED


def slower(limits):
    return replace(limits, speed_u=tuple(speed // 4 for speed in limits.speed_u))
