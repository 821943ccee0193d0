"""A transmit queue that is full: nothing has failed, what waits goes next turn, and what disables goes first."""

from contextlib import nullcontext
from dataclasses import replace

import pytest

from cutgate.protocol.frames import BULK_IDS, CONTROL_IDS, IDS, RuntimeStop
from cutgate.protocol.port import LAST_TRIES, RETRY_S
from cutgate.protocol.states import StopCause, StopCode
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.replay import ReplayOutcome
from cutgate.runtime.interlock.state import Phase
from tests.runtime.session.wire import CONTROLLER, RUNTIME

TIMEOUT_S = 0.1


def squeeze(pair, room):
    for node in pair.wire.nodes.values():
        node.room = room


@pytest.mark.parametrize("room", [3, 4, 10])
def test_a_session_over_a_bus_that_takes_a_few_frames_a_turn_cuts_to_its_end(pair, room):
    """With two, Opened alone takes as long as the time-out, and no session is opened."""
    squeeze(pair, room)
    assert pair.end(60.0) is Phase.DONE
    assert pair.wire.nodes[RUNTIME].refused > 0
    pair.close()
    assert pair.read().report.status is Status.OK
    assert pair.replayed().outcome is ReplayOutcome.IDENTICAL


def test_a_stop_leaves_in_its_turn_although_an_upload_waits(pair):
    pair.to(Phase.UPLOADING)
    squeeze(pair, 1)
    pair.until(lambda: pair.session._port.waits)
    begun = len(pair.wire.seen)
    pair.say("stop")
    mine = [seen.can_id for seen in pair.wire.seen[begun:] if seen.sender is RUNTIME]
    assert mine == [IDS[RuntimeStop]]
    assert pair.end() is Phase.STOPPED
    after = [seen.can_id for seen in pair.wire.seen[begun:] if seen.sender is RUNTIME]
    assert BULK_IDS[RUNTIME] not in after, "what the stop voids never leaves"


@pytest.mark.parametrize("side", [RUNTIME, CONTROLLER])
def test_a_queue_that_stays_full_stops_both_sides_within_the_time_out(pair, side):
    """Nobody is told that the bus takes nothing any more; silence tells it."""
    pair.power_up(time_scale=0.05)
    pair.to(Phase.CUTTING).run(0.1)
    pair.wire.nodes[side].room = 0
    stood_s = pair.clock()
    pair.until(lambda: not pair.controller.may_move)
    assert pair.clock() - stood_s <= TIMEOUT_S + 2 * pair.cycle_s + pair.job.timing.heartbeat_ms / 1000
    assert pair.end() is Phase.STOPPED
    assert StopCause.HEARTBEAT_LOST in (pair.state.cause, pair.controller.cause)
    assert StopCause.BUS_FAILED not in (pair.state.cause, pair.controller.cause)


def test_a_queue_full_for_less_than_the_time_out_holds_nothing_up(pair):
    """Again and again more than a period without room: no heartbeat's counter is missed for it."""
    pair.power_up(time_scale=0.05)
    pair.to(Phase.CUTTING).run(0.1)
    for _ in range(20):
        for node in pair.wire.nodes.values():
            node.room = 0
            pair.run(0.03)
            node.room = None
            pair.run(0.05)
    assert pair.phase is Phase.CUTTING
    assert pair.controller.may_move
    for port in (pair.session._port, pair.process.port):
        assert not port.waits
    assert pair.process.port.endpoint.link.statistics.losses == 0
    assert all(node.refused > 0 for node in pair.wire.nodes.values())


@pytest.mark.parametrize("fails", [False, True])
def test_the_last_word_of_a_session_is_tried_until_there_is_room(pair, monkeypatch, fails):
    """The loop turns no more after its end: without another try the controller would only find out by the time-out."""
    pair.to(Phase.PERMITTED)
    session, node, pauses = pair.session, pair.wire.nodes[RUNTIME], []

    def turn(_ready):
        """The last one: the operator quits, or the program fails; either way the bus takes nothing."""
        node.room = node._left = 0
        if fails:
            monkeypatch.setattr(session._cycle, "read", lambda: 1 / 0)
        else:
            pair.terminal.type("quit")
        last_cycle({pair.terminal.reader.descriptor})
        session.state = replace(session.state, phase=Phase.STOPPED)

    def pause(seconds):
        pauses.append(seconds)
        node._left = int(len(pauses) == 5)

    last_cycle, flush_last = session.run_cycle, session._port.flush_last
    monkeypatch.setattr(session, "run_cycle", turn)
    monkeypatch.setattr(session, "begin", lambda _wake: None)
    monkeypatch.setattr(session, "_wait", lambda _wake: set())
    monkeypatch.setattr(session._port, "flush_last", lambda: flush_last(pause))
    begun = len(pair.wire.seen)
    with pytest.raises(ZeroDivisionError) if fails else nullcontext():
        session.run(-1)
    assert pauses == [RETRY_S] * 5
    assert len(pauses) < LAST_TRIES
    assert [seen.can_id for seen in pair.wire.seen[begun:]] == [IDS[RuntimeStop]]


def test_a_bus_that_fails_at_the_last_word_is_no_error_of_its_own(pair, monkeypatch):
    pair.to(Phase.PERMITTED)
    pair.session.state = replace(pair.state, phase=Phase.STOPPED)
    pair.session._port.endpoint.send_frame(RuntimeStop(StopCode.STOP, StopCause.OPERATOR_QUIT), pair.clock())
    pair.wire.nodes[RUNTIME].mute = True
    monkeypatch.setattr(pair.session, "begin", lambda _wake: None)
    assert pair.session.run(-1).phase is Phase.STOPPED


def test_while_the_bus_takes_no_more_the_loop_turns_again_soon(pair, monkeypatch):
    class Poller:
        def poll(self, wait_ms):
            waits_ms.append(wait_ms)
            return []

        def unregister(self, _descriptor):
            """The verification process has said all it is asked."""

    pair.to(Phase.PERMITTED)
    waits_ms: list[float] = []
    monkeypatch.setattr(pair.session, "_poller", Poller())
    pair.until(lambda: pair.session._cycle.next_heartbeat_s - pair.clock() > 2 * RETRY_S)
    pair.session._wait(-1)
    pair.session._port.waits = True
    pair.session._wait(-1)
    assert waits_ms[0] > waits_ms[1] == 1000.0 * RETRY_S


@pytest.mark.parametrize(
    ("waiting", "kind"), [(Phase.AUTHORISING_PERMIT, "permit"), (Phase.AUTHORISING_START, "start")]
)
def test_what_a_stop_voids_before_it_has_left_is_not_called_sent(pair, waiting, kind):
    pair.begin().to(Phase.NONCE_PERMIT if kind == "permit" else Phase.PERMITTED).disk.answers = False
    pair.to(waiting)
    squeeze(pair, 0)
    begun = len(pair.wire.seen)
    pair.disk.answers = True
    pair.until(lambda: pair.phase is not waiting)
    pair.say("stop").run_cycle()
    squeeze(pair, None)
    assert pair.end() is Phase.STOPPED
    mine = [seen.can_id for seen in pair.wire.seen[begun:] if seen.sender is RUNTIME]
    assert CONTROL_IDS[RUNTIME] not in mine
    pair.close()
    stages = [(entry["kind"], entry["stage"]) for entry in pair.read().of("/audit/permit")]
    assert stages[-3:] == [(kind, "authorised"), (kind, "sent"), (kind, "withheld")]
    assert "void" in pair.read().of("/audit/permit")[-1]["reason"]
    assert pair.replayed().outcome is ReplayOutcome.IDENTICAL


def test_what_left_before_a_stop_stays_sent(pair):
    pair.to(Phase.CUTTING).say("stop")
    assert pair.end() is Phase.STOPPED
    pair.close()
    assert "withheld" not in {entry["stage"] for entry in pair.read().of("/audit/permit")}
