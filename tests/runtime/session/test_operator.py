"""What the operator and the worker say, at the right and at the wrong moment."""

from dataclasses import replace

import pytest
from rich.console import Console

from cutgate.protocol import records
from cutgate.protocol.frames import CONTROL_IDS, ControllerHeartbeat, RuntimeStop
from cutgate.protocol.states import ControllerState, StopCause
from cutgate.runtime.audit import records as audit
from cutgate.runtime.audit.inspect import read_log
from cutgate.runtime.audit.replay import ReplayOutcome, replay
from cutgate.runtime.interlock.state import OperatorCommand, Phase, Refused
from cutgate.runtime.review.show import print_story
from cutgate.runtime.review.story import story
from cutgate.runtime.session.job import VERIFIER
from cutgate.runtime.session.messages import Broken
from cutgate.runtime.verification import certified, plausibility
from tests.runtime.audit.build import forge
from tests.runtime.session.pair import check_of
from tests.runtime.session.test_session import first_frames
from tests.runtime.session.wire import CONTROLLER

QUIET = [
    Phase.WAITING,
    Phase.OPENING,
    Phase.COLLECTING,
    Phase.UPLOADING,
    Phase.VERIFYING,
    Phase.AUTHORISING_PERMIT,
    Phase.PERMITTING,
    Phase.PERMITTED,
    Phase.NONCE_START,
    Phase.AUTHORISING_START,
]


def reach(pair, phase):
    """Stand in a phase, with a disk and a worker that hold still where it would pass by."""
    pair.begin()
    if phase is Phase.VERIFYING:
        pair.prover.answer = lambda _request: None
    if phase is Phase.AUTHORISING_PERMIT:
        pair.to(Phase.NONCE_PERMIT).disk.answers = False
    if phase is Phase.AUTHORISING_START:
        pair.to(Phase.PERMITTED).disk.answers = False
    pair.to(phase)
    return pair


@pytest.mark.parametrize("phase", QUIET)
def test_quit_ends_every_phase_in_order(pair, phase):
    reach(pair, phase).say("quit")
    pair.disk.answers = True
    assert (pair.phase, pair.state.cause) == (Phase.STOPPED, StopCause.OPERATOR_QUIT)
    assert not first_frames(pair, records.Start)
    pair.run(0.2)
    assert pair.controller.state is ControllerState.INHIBITED
    assert pair.close().closed


@pytest.mark.parametrize("phase", [Phase.STARTING, Phase.CUTTING])
def test_quit_stops_the_arm_first(pair, phase):
    pair.power_up(time_scale=0.05)
    reach(pair, phase).say("quit")
    assert pair.end() is Phase.STOPPED
    pair.run(0.2)
    assert pair.state.cause is StopCause.OPERATOR_QUIT
    assert pair.controller.cause is StopCause.OPERATOR_QUIT


@pytest.mark.parametrize("word", [OperatorCommand.START, OperatorCommand.ACKNOWLEDGE, OperatorCommand.RESET])
@pytest.mark.parametrize("phase", [Phase.COLLECTING, Phase.AUTHORISING_PERMIT, Phase.CUTTING])
def test_a_word_at_the_wrong_moment_is_refused_and_recorded(pair, word, phase):
    pair.power_up(time_scale=0.05)
    reach(pair, phase).say(word)
    refused = [effect for effect in pair.notes.effects if isinstance(effect, Refused)]
    assert refused[-1].command is word
    assert pair.state.cause is StopCause.NONE
    pair.disk.answers = True
    pair.say("stop").end()
    pair.close()
    said = [(record["word"], record["accepted"]) for record in pair.read().of("/audit/operator")]
    assert said[-2:] == [(word, False), ("stop", True)]


def test_an_unknown_word_is_answered_and_changes_nothing(pair):
    pair.to(Phase.COLLECTING).say("go")
    assert "'go' is no command here; say one of start, stop," in pair.notes.notes[-1]
    assert pair.end() is Phase.DONE


def test_the_end_of_standard_input_stops_nothing(pair):
    pair.to(Phase.STARTING)
    pair.terminal.hang_up()
    assert pair.end() is Phase.DONE
    assert pair.terminal.reader.descriptor is None


def test_a_terminal_that_has_hung_up_wakes_the_loop_once_and_no_more(pair):
    """The end of a pipe can be read for ever: a loop that went on listening to it would never rest."""

    def wakes():
        pair.clock.now_s = pair.session._cycle.next_heartbeat_s  # a cycle is due: nothing is waited for
        return descriptor in pair.session._wait(pair.wake[0])

    pair.to(Phase.PERMITTED)
    descriptor = pair.terminal.reader.descriptor
    pair.terminal.hang_up()
    assert wakes()
    pair.run_cycle()
    assert not wakes()


def test_start_before_the_device_was_released_and_pressed_is_refused(pair):
    pair.controller_terminal.type("hold")
    pair.to(Phase.PERMITTED).run(0.1).say("start")
    assert "enabling device" in next(
        effect.reason for effect in pair.notes.effects if isinstance(effect, Refused)
    )
    assert not first_frames(pair, records.Start)


def test_withdraw_reaches_the_controllers_memory(pair):
    pair.to(Phase.PERMITTED).say("withdraw")
    pair.end()
    assert pair.state.cause is StopCause.REGISTRATION_WITHDRAWN
    pair.run(0.2)
    assert pair.controller.memory.withdrawn == {pair.job.place}
    assert pair.controller.memory.barrier_us == pair.state.barrier_us
    assert pair.controller.memory.withdrawal_due, (
        "until the next session, for what is held back must settle nothing"
    )
    assert not pair.state.withdraw_due


# ---------------------------------------------------------------- the worker


def test_a_broken_worker_stops_and_latches(pair):
    pair.begin()
    pair.prover.answer = lambda request: [Broken(request=request.number, reason="ValueError: no")]
    assert pair.end() is Phase.STOPPED
    assert pair.state.cause is StopCause.INTERNAL_ERROR
    assert pair.state.reason == "verification failed: ValueError: no"
    assert pair.controller.state is ControllerState.FAULT
    assert not first_frames(pair, records.Permit)


def test_an_answer_that_comes_too_late_ends_without_a_permit(pair):
    pair.begin(replace(pair.job, deadlines=replace(pair.job.deadlines, verify_timeout_s=0.3)))
    pair.prover.answer = lambda _request: None
    assert pair.end() is Phase.REFUSED
    assert "no verdict within 0.3 s" in pair.state.reason


def test_a_worker_that_wakes_the_loop_for_nothing_changes_nothing(pair):
    pair.begin()
    pair.prover.answer = lambda _request: None
    pair.to(Phase.VERIFYING)
    pair.prover.give(b"\0\0")  # half of a length
    pair.run(0.1)
    assert pair.phase is Phase.VERIFYING


# ---------------------------------------------------------------- acknowledge and reset


def next_session(pair):
    pair.close()
    pair.run(0.3).begin()
    return pair.to(Phase.HELD).run(0.05)


def test_a_stop_is_acknowledged_in_the_next_session_before_anything_else(pair):
    pair.to(Phase.CUTTING)
    pair.controller_terminal.type("estop")
    pair.end()
    assert (pair.state.cause, pair.controller.state) == (
        StopCause.EMERGENCY_STOP,
        ControllerState.INHIBITED,
    )
    next_session(pair).say("acknowledge").run(0.05)
    assert pair.phase is Phase.HELD
    assert "EMERGENCY_STOP" in [e.reason for e in pair.notes.effects if isinstance(e, Refused)][-1]
    pair.controller_terminal.type("estop")  # released
    pair.run(0.05).say("acknowledge")
    assert pair.end() is Phase.DONE


def test_a_latched_fault_needs_acknowledge_and_then_reset(pair):
    pair.to(Phase.CUTTING)
    pair.wire.nodes[0].put(0x080, bytes(8))
    pair.end()
    assert (pair.controller.state, pair.controller.cause) == (ControllerState.FAULT, StopCause.SECOND_NODE)
    next_session(pair).say("reset").run(0.05)
    assert "say acknowledge" in [e.reason for e in pair.notes.effects if isinstance(e, Refused)][-1]
    pair.say("acknowledge").run(0.1)
    assert (pair.phase, pair.controller.state) == (Phase.HELD, ControllerState.FAULT)
    pair.say("reset")
    assert pair.end() is Phase.DONE
    (reset,) = first_frames(pair, records.Reset)
    pair.close()
    kinds = [(record["kind"], record["stage"]) for record in pair.read().of("/audit/permit")]
    assert kinds[:3] == [("reset", "authorised"), ("reset", "sent"), ("reset", "acknowledged")]
    assert reset.durable > 0


def test_a_reset_waits_for_the_disk(pair):
    pair.to(Phase.CUTTING)
    pair.wire.nodes[0].put(0x080, bytes(8))
    pair.end()
    next_session(pair).say("acknowledge").run(0.1)
    pair.disk.answers = False
    pair.say("reset")
    assert pair.end() is Phase.STOPPED
    assert pair.state.cause is StopCause.AUDIT_FAILED
    assert not first_frames(pair, records.Reset)


def test_a_stop_before_any_session_was_held_names_the_cause_in_the_heartbeats(pair):
    pair.to(Phase.PERMITTED)
    pair.controller_terminal.type("bone-motion")
    pair.end()
    assert pair.wire.frames(ControllerHeartbeat)[-1][1].cause is StopCause.BONE_MOVED


# ---------------------------------------------------------------- while OPEN is on its way


@pytest.mark.parametrize(
    ("word", "cause"),
    [
        ("stop", StopCause.OPERATOR_STOP),
        ("withdraw", StopCause.OPERATOR_STOP),  # what the stop frame says; the withdrawal follows it
        ("quit", StopCause.NONE),
    ],
)
def test_a_word_said_while_the_controller_opens_reaches_it(pair, word, cause):
    """It has opened, its answer has not come: what is said leaves under the new session's tag."""
    answers = CONTROL_IDS[CONTROLLER]
    pair.wire.rules.append(lambda m: [] if pair.controller.session and m.arbitration_id == answers else [m])
    pair.begin().until(lambda: pair.controller.state is ControllerState.OPEN).run(0.05)
    assert pair.phase is Phase.OPENING
    pair.say(word)
    assert pair.phase is not Phase.OPENING
    sent = pair.clock()
    assert pair.wire.frames(RuntimeStop)
    pair.run_cycle()
    assert pair.clock() <= sent + 2 * pair.cycle_s
    assert pair.controller.state is ControllerState.INHIBITED
    assert pair.controller.cause is cause
    assert (pair.job.place in pair.controller.memory.withdrawn) is (word == "withdraw")
    assert pair.end() is Phase.STOPPED


# ---------------------------------------------------------------- warnings


@pytest.fixture
def doubtful(pair, monkeypatch):
    """A session whose cut is called tiny."""
    monkeypatch.setattr(plausibility, "CUT_LEAST_MM", 1000.0)
    monkeypatch.setattr("tests.runtime.session.pair.check_of", check_of.__wrapped__)
    return pair


def test_a_warning_keeps_from_the_permit_until_it_is_confirmed_by_its_code(doubtful):
    doubtful.to(Phase.ADMITTED).run(0.5)
    assert doubtful.phase is Phase.ADMITTED
    assert [caution.code for caution in doubtful.notes.verdicts[0].cautions] == ["CUT_TINY"]
    doubtful.say("confirm").say("confirm cut_huge").run(0.1)
    assert doubtful.phase is Phase.ADMITTED
    assert not first_frames(doubtful, records.Permit)
    doubtful.say("Confirm\tcut_tiny")
    assert doubtful.end() is Phase.DONE
    doubtful.close()
    told = story(doubtful.read(), doubtful.paths.log, None)
    console = Console(width=120, no_color=True, highlight=False, markup=False)
    with console.capture() as capture:
        print_story(console, told)
    for line in ("WARNING CUT_TINY: ", "confirmed: CUT_TINY", "operator: confirm CUT_TINY"):
        assert line in capture.get(), "whoever reads why it was allowed sees what was overruled"
    said = [
        (record["word"], record.get("what"), record["accepted"])
        for record in doubtful.read().of("/audit/operator")
    ]
    assert said == [
        ("confirm", None, False),
        ("confirm", "CUT_HUGE", False),
        ("confirm", "CUT_TINY", True),
        ("start", None, True),
    ]
    assert doubtful.replayed().outcome is ReplayOutcome.IDENTICAL


def test_a_warning_nobody_confirms_ends_the_session_and_is_named(doubtful):
    doubtful.begin(replace(doubtful.job, deadlines=replace(doubtful.job.deadlines, operator_wait_s=1.0)))
    assert doubtful.end() is Phase.REFUSED
    assert "say confirm CUT_TINY" in doubtful.state.reason


@pytest.mark.parametrize(
    "change", [{"accepted": False}, {"what": "CUT_HUGE"}, {"what": None}, {"word": "start"}]
)
def test_replay_finds_a_permit_that_left_without_the_confirmation(doubtful, change):
    doubtful.to(Phase.ADMITTED).say("confirm cut_tiny").end()
    doubtful.close()

    def edit(record):
        confirms = isinstance(record, audit.AuditOperator) and record.word == "confirm"
        return record.model_copy(update=change) if confirms else record

    forged = forge(doubtful.paths.log.read_bytes(), edit)
    found = replay(read_log(forged), certified.verify, verifier=VERIFIER)
    assert found.differences == ("a permit left although the warning CUT_TINY was not confirmed",)
