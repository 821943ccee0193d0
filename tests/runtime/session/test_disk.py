"""A disk that is slow, full or silent: nothing is enabled without it, and nothing that stops waits for it."""

import errno
from dataclasses import replace

import pytest

from cutgate.protocol import records
from cutgate.protocol.frames import RuntimeHeartbeat, RuntimeStop
from cutgate.protocol.states import ControllerState, RuntimeCode, StopCause
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.interlock.state import Phase, Withheld
from tests.runtime.session.test_session import first_frames


def full(operation, _count):
    if operation == "write":
        raise OSError(errno.ENOSPC, "no space")


def codes(pair):
    return {beat.code for _, beat in pair.wire.frames(RuntimeHeartbeat)}


def test_a_disk_that_never_answers_lets_no_permit_leave(pair):
    pair.begin()
    pair.disk.answers = False
    pair.end()
    assert (pair.phase, pair.state.cause) == (Phase.STOPPED, StopCause.AUDIT_FAILED)
    assert not first_frames(pair, records.Permit)
    assert codes(pair) == {RuntimeCode.INHIBIT}
    paths = pair.close()
    assert not paths.closed
    assert "did not answer" in paths.reason


@pytest.mark.parametrize(
    ("before", "pending", "record"),
    [
        (Phase.VERIFYING, Phase.AUTHORISING_PERMIT, records.Permit),
        (Phase.PERMITTED, Phase.AUTHORISING_START, records.Start),
    ],
)
def test_a_decision_that_does_not_become_durable_in_time_is_an_audit_failure(pair, before, pending, record):
    pair.begin()
    pair.prover.answer, answer = (lambda request: None), pair.prover.answer
    pair.to(Phase.VERIFYING)
    if before is Phase.PERMITTED:
        pair.prover.give(answer(pair.prover.asked[0]))
        pair.to(Phase.PERMITTED)
        pair.disk.answers = False
    else:
        pair.disk.answers = False
        pair.prover.give(answer(pair.prover.asked[0]))
    pair.to(pending)
    began_s = pair.clock()
    pair.end()
    assert pair.clock() - began_s <= 1.0 + 2 * pair.turn_s + 0.02
    assert pair.state.cause is StopCause.AUDIT_FAILED
    assert not first_frames(pair, record)
    pair.run(0.2)
    assert (pair.controller.state, pair.controller.cause) == (
        ControllerState.FAULT,
        StopCause.AUDIT_FAILED,
    )


@pytest.mark.parametrize("phase", [Phase.AUTHORISING_PERMIT, Phase.AUTHORISING_START, Phase.CUTTING])
def test_the_stop_frame_does_not_wait_for_a_silent_disk(pair, phase):
    pair.to(Phase.COLLECTING if phase is Phase.AUTHORISING_PERMIT else Phase.PERMITTED)
    if phase is Phase.CUTTING:
        pair.to(Phase.CUTTING)
    pair.disk.answers = False
    pair.to(phase)
    said_s = pair.clock() + pair.turn_s
    pair.say("stop")
    (seen, stop) = pair.wire.frames(RuntimeStop)[0]
    assert (seen.at_s, stop.cause) == (said_s, StopCause.OPERATOR_STOP)
    pair.run(0.05)
    assert pair.controller.cause is StopCause.OPERATOR_STOP
    assert not pair.controller.may_move


def test_a_full_disk_stops_the_cut(pair):
    pair.power_up(time_scale=0.05)
    pair.to(Phase.CUTTING)
    pair.disk.trouble = full
    assert (
        pair.end(limit_s=1.1) is Phase.STOPPED
    )  # with the next chunk, not only after the checkpoint's deadline
    assert pair.state.cause is StopCause.AUDIT_FAILED
    assert (pair.controller.state, pair.controller.cause) == (
        ControllerState.FAULT,
        StopCause.AUDIT_FAILED,
    )
    assert any("No space left" in note for note in pair.notes.notes)
    assert not pair.close().closed
    assert pair.read().report.status is Status.INCOMPLETE


@pytest.mark.parametrize(("delay_s", "phase"), [(3.0, Phase.CUTTING), (6.0, Phase.STOPPED)])
def test_a_slow_checkpoint_stops_the_cut_only_beyond_its_own_deadline(pair, delay_s, phase):
    pair.power_up(time_scale=0.02)
    pair.to(Phase.CUTTING)
    pair.disk.delay_s, pair.turn_s = delay_s, 0.02
    pair.run(6.5)
    assert pair.phase is phase
    if phase is Phase.STOPPED:
        assert pair.state.cause is StopCause.AUDIT_FAILED


def test_a_durable_decision_that_no_longer_holds_is_withheld(pair):
    """The registration grows too old while the permit's record is on its way to the disk."""
    pair.begin(replace(pair.job, registration_age_s=0.0, registration_max_age_s=0.5))
    pair.to(Phase.UPLOADING)
    pair.disk.delay_s = 0.8
    assert pair.end() is Phase.REFUSED
    assert any(isinstance(effect, Withheld) for effect in pair.notes.effects)
    assert "age of the registration" in pair.state.reason
    assert not first_frames(pair, records.Permit)
    pair.run(1.0).close()
    stages = [record["stage"] for record in pair.read().of("/audit/permit")]
    assert stages == ["authorised", "withheld"]


def test_the_enabling_device_released_before_the_start_is_durable_takes_the_start_back(pair):
    pair.to(Phase.PERMITTED)
    pair.disk.delay_s = 0.3
    pair.to(Phase.AUTHORISING_START)
    pair.controller_terminal.type("release")
    pair.until(lambda: pair.phase is Phase.PERMITTED)
    assert any(isinstance(effect, Withheld) for effect in pair.notes.effects)
    pair.run(0.5)
    assert not first_frames(pair, records.Start)
    pair.disk.delay_s = 0.0
    assert pair.end() is Phase.DONE  # pressed again, said again
