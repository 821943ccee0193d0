"""Whole sessions in virtual time: admitted and cut, refused, stopped, and what bus and log say of them afterwards."""

from itertools import groupby, pairwise

import pytest

from cutgate.protocol import records
from cutgate.protocol.frames import CONTROL_IDS, ControllerHeartbeat, RuntimeHeartbeat, RuntimeStop
from cutgate.protocol.states import ControllerState, RuntimeCode, StopCause, StopCode
from cutgate.runtime.audit.inspect import Status, read_log
from cutgate.runtime.audit.records import CanTransfer
from cutgate.runtime.audit.replay import ReplayOutcome
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.session.loop import CHECK_HEARTBEATS, GUIDANCE_S
from tests.runtime.session.pair import CYCLE_S
from tests.runtime.session.wire import RUNTIME


def first_frames(pair, record):
    """Where the transfers of a record began on the bus: an ISO-TP first frame carries the record's type."""
    return [
        seen
        for seen in pair.wire.seen
        if seen.can_id == CONTROL_IDS[RUNTIME] and seen.data[0] >> 4 == 1 and seen.data[2] == record.TYPE
    ]


def authorised(pair, durable):
    """The kinds of enabling records in what the disk held for sure at that moment."""
    found = read_log(pair.paths.log.read_bytes()[:durable]).of("/audit/permit")
    return {record["kind"] for record in found if record["stage"] == "authorised"}


def test_a_session_cuts_every_segment_and_leaves_a_log_that_replays(pair):
    assert pair.end() is Phase.DONE
    assert any("DONE: 5 segments executed" in line for line in pair.said)
    pair.run(0.2)
    assert (pair.controller.state, pair.controller.cause) == (ControllerState.INHIBITED, StopCause.NONE)
    assert pair.close().closed
    assert pair.read().report.status is Status.OK
    assert pair.replayed().outcome is ReplayOutcome.IDENTICAL
    assert [(stop.code, stop.cause) for _, stop in pair.wire.frames(RuntimeStop)] == [
        (StopCode.END, StopCause.SESSION_ENDED)
    ]


def test_every_record_that_left_is_in_the_log(pair):
    pair.end()
    pair.close()
    sent = [one["record"] for one in pair.read().of(CanTransfer.TOPIC) if one["direction"] == "sent"]
    kinds = ("Open", "Collect", "PathBlock", "NonceRequest", "Permit", "NonceRequest", "Start")
    assert [kind for kind, _ in groupby(sent)] == [*kinds]


def test_every_record_that_came_is_in_the_log(pair):
    pair.end()
    pair.close()
    came = [one["record"] for one in pair.read().of(CanTransfer.TOPIC) if one["direction"] == "received"]
    parameters = ("Limits", "Calibration", "Tool")
    answers = ("Nonce", "Reply", "Nonce", "Reply")  # to the permit and to the start
    kinds = ("Announce", "Opened", *parameters, "BlockStored", "PathStored", *answers)
    assert [kind for kind, _ in groupby(came)] == [*kinds]


def test_where_a_session_stood_when_it_was_stopped_is_told_and_nothing_of_one_that_was_not(pair):
    pair.to(Phase.PERMITTED)
    assert pair.session.stopped_in is None
    pair.say("stop")
    assert (pair.phase, pair.session.stopped_in) == (Phase.STOPPING, Phase.PERMITTED)
    assert (pair.end(), pair.session.stopped_in) == (Phase.STOPPED, Phase.PERMITTED)


@pytest.mark.parametrize(("phase", "wakes"), [(Phase.OPENING, True), (Phase.PERMITTED, False)])
def test_the_verification_process_wakes_the_loop_until_its_verdict_and_no_longer(pair, phase, wakes):
    pair.to(phase).prover.give(b"word")
    assert [pair.prover.fileno() in pair.session._wait(pair.wake[0]) for _ in range(2)] == [wakes] * 2


def test_a_check_holds_up_a_cycle_for_an_eighth_of_a_heartbeat_and_guidance_nobody_for_longer_than_5_s():
    assert (CHECK_HEARTBEATS, GUIDANCE_S) == (0.125, 5.0)


@pytest.mark.parametrize("delay_s", [0.0, 0.3])
def test_every_enabling_record_is_durable_before_it_is_on_the_bus(pair, delay_s):
    pair.begin().disk.delay_s = delay_s
    pair.end()
    pair.run(1.0).close()
    (permit,), (start,) = first_frames(pair, records.Permit), first_frames(pair, records.Start)
    assert "permit" in authorised(pair, permit.durable)
    assert "start" in authorised(pair, start.durable)
    beats = pair.wire.frames(RuntimeHeartbeat)
    first = {code: next(seen for seen, beat in beats if beat.code is code) for code in RuntimeCode}
    assert first[RuntimeCode.READY].at_s >= permit.at_s
    assert first[RuntimeCode.CUT].at_s >= start.at_s
    assert "start" in authorised(pair, first[RuntimeCode.CUT].durable)


def test_heartbeats_grow_more_permissive_step_by_step_and_fall_back_at_the_end(pair):
    pair.end()
    codes = [beat.code for _, beat in pair.wire.frames(RuntimeHeartbeat)]
    order = [code for code, before in zip(codes, [None, *codes], strict=False) if code is not before]
    assert order == [RuntimeCode.INHIBIT, RuntimeCode.READY, RuntimeCode.CUT]


def test_heartbeats_keep_their_period_on_both_sides(pair):
    pair.end()
    for kind in (RuntimeHeartbeat, ControllerHeartbeat):
        times = [seen.at_s for seen, _ in pair.wire.frames(kind)]
        assert max(b - a for a, b in pairwise(times)) <= 0.020 + CYCLE_S + 1e-9


def test_a_path_outside_the_controllers_limits_is_refused_and_its_pose_is_named(outside):
    assert outside.end() is Phase.REFUSED
    assert "POSE_OUTSIDE_LIMITS at pose 0" in outside.state.reason
    assert "verdict: " in outside.state.reason
    assert not first_frames(outside, records.Permit)
    assert outside.notes.verdicts[0].proved.admissible is False
    outside.run(0.2)
    assert (outside.controller.state, outside.controller.cause) == (
        ControllerState.INHIBITED,
        StopCause.NONE,
    )
    assert outside.close().closed
    assert outside.read().report.status is Status.OK
    assert outside.replayed().outcome is ReplayOutcome.IDENTICAL


def test_a_stopped_session_leaves_a_log_that_replays(pair):
    pair.to(Phase.CUTTING).say("stop")
    assert pair.controller.state is not ControllerState.INHIBITED  # the frame is on its way
    assert pair.end() is Phase.STOPPED
    assert (pair.controller.state, pair.controller.cause) == (
        ControllerState.INHIBITED,
        StopCause.OPERATOR_STOP,
    )
    assert pair.close().closed
    assert pair.read().report.status is Status.OK
    assert pair.replayed().outcome is ReplayOutcome.IDENTICAL


@pytest.mark.parametrize("phase", [Phase.WAITING, Phase.COLLECTING, Phase.VERIFYING, Phase.PERMITTED])
def test_a_word_of_stop_ends_every_phase_without_motion(pair, phase):
    pair.begin()
    pair.prover.answer = (lambda _request: None) if phase is Phase.VERIFYING else pair.prover.answer
    pair.to(phase).say("stop")
    assert pair.end() is Phase.STOPPED
    assert pair.state.cause is StopCause.OPERATOR_STOP
    assert not first_frames(pair, records.Start)
    pair.run(0.2)
    assert pair.controller.state is ControllerState.INHIBITED
    assert not pair.controller.cutting_mode


def test_the_progress_is_shown_and_never_beyond_the_path(pair):
    pair.end()
    assert pair.notes.segments
    assert all(0 <= segment <= segments == 5 for segment, segments in pair.notes.segments)
