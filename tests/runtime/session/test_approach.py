"""Approach and retract in whole sessions: from where the arm stands, bound, executed, stopped, refused."""

from dataclasses import replace

import numpy as np
import pytest

from cutgate.firmware_sim.console import ConsoleCommand
from cutgate.firmware_sim.faults import FaultName
from cutgate.firmware_sim.kinematics import as_joints
from cutgate.firmware_sim.plant import Leg
from cutgate.protocol import records
from cutgate.protocol.frames import ControllerHeartbeat, Progress
from cutgate.protocol.records import joints_to_counts, joints_to_memory
from cutgate.protocol.states import ControllerState, Refusal, StopCause
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.replay import ReplayOutcome
from cutgate.runtime.interlock.refusals import told
from cutgate.runtime.interlock.state import Phase
from tests.altering import altered
from tests.runtime.session.pair import STANDS, answers
from tests.runtime.session.test_session import first_frames

ELSEWHERE = (30_000_000, 40_000_000, 400_000_000, 120_000_000, 90_000_000)
LOW = (*STANDS[:2], 52_050_000, *STANDS[3:])
"""2.05 mm above the slide's lower limit."""


def standing(pair):
    return joints_to_counts(pair.process.arm.state.joints)


def place(pair, joints_u):
    """Put the arm there, however it comes there."""
    state = pair.process.arm.state
    pair.process.arm.state = replace(state, joints=as_joints(joints_to_memory(joints_u)))


@pytest.mark.parametrize("stands", [STANDS, ELSEWHERE])
def test_the_arm_goes_from_where_it_stands_to_the_cut_and_back(pair, stands):
    pair.power_up(joints=as_joints(joints_to_memory(stands)))
    legs, apart = [], []

    def watch():
        pair._lead()
        legs.append(pair.process.arm.state.leg)
        apart.append(np.abs(np.subtract(standing(pair), stands)).max())

    pair.begin().until(lambda: pair.phase is Phase.DONE, 20.0, watch)
    assert set(legs) == set(Leg)
    assert max(apart) > 1_000_000
    assert standing(pair) == stands
    assert any("DONE: 5 segments executed" in line for line in pair.said)
    pair.close()
    assert pair.read().report.status is Status.OK
    assert pair.replayed().outcome is ReplayOutcome.IDENTICAL
    (entry,) = pair.read().of("/audit/approach")
    assert (tuple(entry["start_joints_u"]), entry["verdict"]) == (stands, "admissible")


def test_done_is_reported_only_when_the_arm_is_back(pair):
    pair.to(Phase.CUTTING)
    pair.until(lambda: pair.process.arm.state.leg is Leg.RETRACT)
    assert pair.controller.state is ControllerState.CUTTING
    assert pair.phase is Phase.CUTTING
    pair.until(lambda: pair.controller.state is ControllerState.DONE)
    assert standing(pair) == STANDS


def test_the_progress_stands_still_before_and_after_the_cut(pair):
    seen = []

    def watch():
        pair._lead()
        seen.append((pair.process.arm.state.leg, pair.process.arm.state.progress))

    pair.begin().until(lambda: pair.phase is Phase.DONE, 20.0, watch)
    assert {shown for leg, shown in seen if leg < Leg.CUT} == {(0, 0.0)}
    assert {shown for leg, shown in seen if leg > Leg.CUT} == {(4, 1.0)}
    frames = [(frame.segment, frame.fraction) for _, frame in pair.wire.frames(Progress)]
    assert frames == sorted(frames)
    assert (frames[0], frames[-1]) == ((0, 0), (4, 65535))


@pytest.mark.parametrize("who", ["runtime", "controller"])
@pytest.mark.parametrize("leg", Leg)
def test_a_stop_stops_on_every_leg(pair, leg, who):
    pair.to(Phase.CUTTING).until(
        lambda: pair.process.arm.state.leg is leg and pair.process.arm.state.fraction > 0.2
    )
    if who == "runtime":
        pair.say("stop")
    else:
        pair.process.act(ConsoleCommand.RELEASE)
    assert pair.end() is Phase.STOPPED
    at_rest = standing(pair)
    assert pair.controller.state is ControllerState.INHIBITED
    pair.run(0.3)
    assert standing(pair) == at_rest
    cause = StopCause.OPERATOR_STOP if who == "runtime" else StopCause.DEVICE_RELEASED
    assert pair.controller.cause is cause
    assert not any(beat.state is ControllerState.DONE for _, beat in pair.wire.frames(ControllerHeartbeat))


def test_after_a_stop_the_next_approach_begins_where_the_arm_stands(pair):
    pair.to(Phase.CUTTING).until(lambda: pair.process.arm.state.fraction > 0.3).say("stop").end()
    at_rest = standing(pair)
    assert at_rest != STANDS
    pair.close()
    pair.run(0.2).begin()
    pair.to(Phase.HELD).run(0.05).say("acknowledge")
    assert pair.end() is Phase.DONE
    resolved = (2_501, 2_501, 5_001, 2_501, 2_501)  # by a joints frame
    assert (np.abs(np.subtract(standing(pair), at_rest)) <= resolved).all()
    assert pair.prover.asked[-1].start_joints_u == standing(pair)


# ---------------------------------------------------------------- not admitted


def test_an_approach_that_violates_a_deadband_is_not_admitted(pair):
    pair.power_up(joints=as_joints(joints_to_memory(LOW)))
    assert pair.begin().end() is Phase.REFUSED
    assert (
        "approach and retract: the arm stands with q2 at 52.050 mm, its limits are [50, 450] mm"
        in pair.state.reason
    )
    assert "move q2 by +3.46 mm, to 55.51 mm" in pair.state.reason
    assert "5.5 mm (deadband and start tolerance) must be kept" in pair.state.reason
    assert not first_frames(pair, records.Permit)
    assert standing(pair) == LOW
    pair.close()
    assert pair.read().report.status is Status.OK
    assert pair.replayed().outcome is ReplayOutcome.IDENTICAL
    (entry,) = pair.read().of("/audit/approach")
    assert entry["verdict"] == "inadmissible"
    assert "speed_percent" not in entry
    (last,) = [d for d in pair.read().of("/audit/decision") if d["to_state"] == "refused"]
    named = {p["name"]: p["holds"] for p in last["permissives"]}
    assert named["approach and retract"] is False
    assert named["verdict"] is True


def test_an_arm_that_moved_during_the_verification_is_not_permitted_before_it_is_back(pair):
    pair.begin().prover.answer = lambda _request: None
    pair.to(Phase.VERIFYING)
    pair.process._happen(FaultName.OFF_START)
    pair.run(0.1)
    pair.prover.give(*answers(pair.prover.asked[0]))
    pair.to(Phase.ADMITTED).run(0.5)
    assert pair.phase is Phase.ADMITTED
    assert not first_frames(pair, records.Permit)
    place(pair, STANDS)
    assert pair.end() is Phase.DONE


def test_an_arm_that_slips_while_the_permit_is_on_its_way_is_refused_by_the_controller(pair):
    pair.to(Phase.ADMITTED, Phase.NONCE_PERMIT)
    pair.disk.delay_s = 0.1
    pair.until(lambda: bool(first_frames(pair, records.Permit)))
    pair.process._happen(FaultName.OFF_START)
    assert pair.end() is Phase.REFUSED
    assert pair.state.reason == f"the controller refused the permit: {told(Refusal.START_JOINTS)}"


@pytest.mark.parametrize(
    ("field", "value", "refusal"),
    [
        ("approach.entry_um", lambda v: v.approach.entry_um - 2, Refusal.APPROACH),
        ("approach.entry_um", lambda v: v.approach.entry_um + 2, Refusal.APPROACH),
        ("approach.exit_um", lambda _: 0, Refusal.APPROACH),
        ("approach.exit_um", lambda v: v.approach.exit_um + 2, Refusal.APPROACH),
        ("approach.entry_joints_u", lambda v: v.approach.exit_joints_u, Refusal.APPROACH),
        ("approach.exit_joints_u", lambda _: STANDS, Refusal.APPROACH),
        ("approach.speed_percent", lambda _: 100, Refusal.APPROACH_SPEED),
    ],
    ids=["entry nearer", "entry further", "no exit", "exit further", "entry joints", "exit joints", "speed"],
)
def test_an_altered_approach_is_refused_by_the_controller(pair, field, value, refusal):
    """A runtime that holds the key, and permits something else than was verified."""
    pair.begin().verdict_altered(lambda verdict: altered(verdict, field, value(verdict)))
    assert pair.end() is Phase.REFUSED
    assert pair.state.reason == f"the controller refused the permit: {told(refusal)}"
    assert standing(pair) == STANDS
    pair.close()
    assert pair.replayed().outcome is ReplayOutcome.DIFFERS, "and the log tells"


# ---------------------------------------------------------------- the site's settings


def test_clearance_and_speed_are_the_sites(pair):
    timing = replace(pair.job.timing, approach_clearance_um=20_500, approach_speed_percent=50)
    pair.begin(replace(pair.job, timing=timing)).to(Phase.PERMITTED)
    bound = pair.controller.permit.approach
    assert (bound.entry_um, bound.exit_um, bound.speed_percent) == (21_170, 20_500, 50)
    assert pair.end() is Phase.DONE


@pytest.mark.parametrize(
    "changes",
    [{"approach_clearance_um": 200_100}, {"approach_speed_percent": 101}],
)
def test_settings_outside_the_controllers_bounds_are_refused(pair, changes):
    pair.begin(replace(pair.job, timing=replace(pair.job.timing, **changes)))
    assert pair.end() is Phase.REFUSED
    assert pair.state.reason == f"the controller refused the session: {told(Refusal.TIMING_OUT_OF_BOUNDS)}"
