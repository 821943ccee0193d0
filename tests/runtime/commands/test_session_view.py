"""What a person is told while a session goes on."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from cutgate.protocol.states import StopCause
from cutgate.runtime.audit.log import Paths
from cutgate.runtime.commands.session_view import SessionView, approach_line, run_document
from cutgate.runtime.interlock.state import CommandGiven, OperatorCommand, Phase, VerdictReady
from cutgate.runtime.kinematics.landmarks import CheckPoints, PointResidual
from cutgate.runtime.verification.advice import Guidance
from cutgate.runtime.verification.approach.decision import verify
from cutgate.runtime.verification.approach.model import StartJoints
from tests.runtime.interlock.builders import NOW, READY, START_JOINTS, VERDICT, in_phase
from tests.runtime.verification.approach.cuts import MIDDLE, cut


def test_what_an_admitted_session_waits_for_is_named(capfd):
    moved = (*START_JOINTS[:2], START_JOINTS[2] + 3_000_000, *START_JOINTS[3:])
    before, after = in_phase(Phase.VERIFYING), in_phase(Phase.ADMITTED, joints_u=moved)
    with SessionView(quiet_output=True) as view:
        view.step(before, VerdictReady(VERDICT), after, (), NOW)
    told = capfd.readouterr().err
    assert "waiting for the permissives" in told
    assert "measured wrist centre to the verified start: 3 (required: <= 0.5 mm)" in told
    assert "move the arm back" in told


def test_every_check_point_is_shown_with_how_far_it_is_off_and_stands_in_the_document(capfd):
    asked = CheckPoints((PointResidual("P1", 0.4), PointResidual("\x1b[2J", 2.5)))
    with SessionView(quiet_output=True) as view:
        view.check_points(asked)
    told = capfd.readouterr().err.splitlines()
    assert [line.split(" s  ")[1] for line in told] == [
        "check point P1 0.400 mm off",
        "check point \\x1b[2J 2.500 mm off, TOO FAR",
    ]
    state = replace(READY, phase=Phase.REFUSED, job=replace(READY.job, check_points=asked))
    document = run_document(state, None, Paths(Path(), Path(), closed=True, reason=""), None)
    assert document["check_points"] == [
        {"id": "P1", "residual_mm": 0.4},
        {"id": "\x1b[2J", "residual_mm": 2.5},
    ]


def test_a_heartbeat_that_is_about_to_come_is_not_looked_for(capfd):
    before, after = in_phase(Phase.VERIFYING), in_phase(Phase.ADMITTED, heartbeat_fresh=False)
    with SessionView(quiet_output=True) as view:
        view.step(before, VerdictReady(VERDICT), after, (), NOW)
    assert "heartbeat" not in capfd.readouterr().err


def test_an_approach_is_told_in_a_line_with_what_decided_it():
    good = approach_line(verify(cut(), StartJoints(MIDDLE, 10_000))).plain
    assert good.startswith("approach and retract ADMISSIBLE, entry ")
    assert "tightest is " in good
    low = np.array([*MIDDLE[:2], 53.0, *MIDDLE[3:]])
    bad = approach_line(verify(cut(), StartJoints(low, 10_000))).plain
    assert "INADMISSIBLE" in bad
    assert "the arm stands with q2 at 53.000 mm" in bad
    assert "move q2 by +2.01 mm, to 55.01 mm" in bad


def test_the_signal_that_ends_a_session_is_told_once_it_is_obeyed(capfd):
    before, after = in_phase(Phase.CUTTING), in_phase(Phase.STOPPING)
    with SessionView(quiet_output=True) as view:
        view.interrupted("SIGHUP")
        view.step(before, CommandGiven(OperatorCommand.STOP), before, (), NOW)
        view.step(before, CommandGiven(OperatorCommand.QUIT), after, (), NOW)
    told = capfd.readouterr().err.splitlines()
    assert "SIGHUP: the session ends" in told[0]
    assert "STOP sent" in told[1]


def test_an_emergency_stop_that_is_still_pressed_is_to_be_released_before_it_is_acknowledged(capfd):
    view_of = replace(READY.controller, cause=StopCause.EMERGENCY_STOP)
    held = [
        in_phase(Phase.HELD, controller=replace(view_of, emergency_stop_clear=clear))
        for clear in (False, True, True)
    ]
    with SessionView(quiet_output=True) as view:
        for state in held:
            view.step(state, CommandGiven(OperatorCommand.START), state, (), NOW)
    pressed, released = capfd.readouterr().err.splitlines()
    assert pressed.endswith("its cause is EMERGENCY_STOP: release the emergency stop, then say acknowledge")
    assert released.endswith("its cause is EMERGENCY_STOP: say acknowledge")


def test_a_reset_is_asked_for_once_it_would_not_be_refused_for_a_heartbeat_that_is_about_to_come(capfd):
    acknowledged = replace(READY.controller, cause=StopCause.NONE)
    with SessionView(quiet_output=True) as view:
        for fresh in (False, True, True):
            state = in_phase(Phase.HELD, controller=acknowledged, heartbeat_fresh=fresh)
            view.step(state, CommandGiven(OperatorCommand.START), state, (), NOW)
            assert bool(view._hold) == fresh
    (told,) = capfd.readouterr().err.splitlines()
    assert told.endswith("acknowledged; the fault is latched: say reset")


def test_an_outcome_is_data_whatever_its_reason_and_its_files_are_called(capfd):
    state = in_phase(Phase.STOPPED, reason="bus\x1b[2J[/]")
    paths = Paths(
        Path("logs/[bold]\u202e.mcap"), Path("logs/x.candump.log"), closed=False, reason="no\r space"
    )
    with SessionView(quiet_output=False) as view:
        view.outcome(state, paths)
    told = capfd.readouterr().out
    assert r"STOPPED: bus\x1b[2J[/]" in told
    assert r"audit log:  logs/[bold]\u202e.mcap  NOT CLOSED: no\r space" in told
    assert "raw frames: logs/x.candump.log" in told


def test_verdict_and_outcome_leave_standard_output_to_a_document(capfd):
    state = in_phase(Phase.DONE)
    with SessionView(quiet_output=True) as view:
        view.outcome(state, Paths(Path("a.mcap"), Path("a.log"), closed=True, reason=""))
    told = capfd.readouterr()
    assert told.out == ""
    assert "CUT COMPLETED" in told.err


def test_a_move_of_the_bone_is_shown_when_it_comes_and_else_why_there_is_none(capfd):
    found = Guidance(
        translation_mm=(-20.0, 1.5, 0.0),
        yaw_deg=0.0,
        pivot_mm=(0.0, 0.0, 0.0),
        moves=(),
        predicted_clearance_mm=5.3,
        verified=True,
        text="a moved bone needs a new registration",
    )
    with SessionView(quiet_output=False) as view:
        view.guidance(found, "")
        view.guidance(None, "not found within 5 s")
    told = capfd.readouterr()
    assert "Move it x -20.0  y +1.5  z +0.0 mm (20.1 mm): verified" in told.out
    assert "no move of the bone is shown: not found within 5 s" in told.err
