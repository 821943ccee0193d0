"""What may happen to frames on the bus, one row after the other: tolerated and counted, or stopped."""

from dataclasses import asdict, replace
from io import StringIO

import can
import pytest
from rich.console import Console

from cutgate.protocol import records
from cutgate.protocol.endpoint import RecordReceived
from cutgate.protocol.frames import (
    BULK_IDS,
    CONTROL_IDS,
    ControllerFault,
    ControllerHeartbeat,
    RuntimeHeartbeat,
    RuntimeStop,
    encode_frame,
)
from cutgate.protocol.states import ControllerState, FaultCode, Purpose, Refusal, RuntimeCode, StopCause
from cutgate.runtime.interlock.phases import ENDED
from cutgate.runtime.interlock.state import Commit, Phase
from cutgate.runtime.review.show import print_story
from cutgate.runtime.review.story import story
from tests.runtime.interlock.builders import DURABLE_LOG
from tests.runtime.session.pair import Stranger
from tests.runtime.session.test_session import first_frames
from tests.runtime.session.wire import CONTROLLER, RUNTIME, double, flip, lose, nth, of

KINDS = [RuntimeHeartbeat, ControllerHeartbeat]


@pytest.fixture
def cutting(pair):
    """A pair in the middle of a cut that lasts longer than any test."""
    pair.power_up(time_scale=0.05)
    return pair.to(Phase.CUTTING).run(0.1)


def hears(pair, kind):
    """The link that receives this kind of frame."""
    port = pair.process.port if kind is RuntimeHeartbeat else pair.session._port
    return port.endpoint.link


def goes_on(pair, seconds=0.3):
    pair.run(seconds)
    return pair.phase is Phase.CUTTING and pair.controller.may_move


def stopped(pair):
    """End the session; the causes of both sides."""
    pair.end()
    pair.run(0.3)
    assert not pair.controller.may_move
    return pair.state.cause, pair.controller.cause


# ---------------------------------------------------------------- loss, corruption, repetition


@pytest.mark.parametrize("lost", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_lost_heartbeats_within_the_gap_are_counted_and_cutting_goes_on(cutting, kind, lost):
    cutting.wire.rules.append(nth(of(kind), range(lost), lose))
    assert goes_on(cutting)
    assert hears(cutting, kind).statistics.losses == lost


@pytest.mark.parametrize("kind", KINDS)
def test_a_gap_beyond_the_tolerance_stops(cutting, kind):
    cutting.wire.rules.append(nth(of(kind), range(3), lose))
    assert StopCause.SEQUENCE_ERROR in stopped(cutting)


@pytest.mark.parametrize("kind", KINDS)
def test_silence_beyond_the_time_out_stops_both_sides(cutting, kind):
    cutting.wire.rules.append(nth(of(kind), range(10_000), lose))
    began_s = cutting.clock()
    cutting.until(lambda: not cutting.controller.may_move)
    assert cutting.clock() - began_s <= 0.100 + 0.020 + 0.010
    assert StopCause.HEARTBEAT_LOST in stopped(cutting)


@pytest.mark.parametrize("kind", KINDS)
def test_two_corrupted_frames_in_a_second_are_counted_and_cutting_goes_on(cutting, kind):
    cutting.wire.rules.append(nth(of(kind), range(2), flip))
    assert goes_on(cutting)
    assert hears(cutting, kind).statistics.crc_failures == 2


@pytest.mark.parametrize("kind", KINDS)
def test_a_third_corrupted_frame_in_a_second_stops(cutting, kind):
    cutting.wire.rules.append(nth(of(kind), range(0, 6, 2), flip))
    assert StopCause.CORRUPTION in stopped(cutting)


@pytest.mark.parametrize("kind", KINDS)
def test_a_repeated_frame_is_discarded_and_cutting_goes_on(cutting, kind):
    cutting.wire.rules.append(nth(of(kind), range(1), double))
    assert goes_on(cutting)
    assert hears(cutting, kind).statistics.repetitions == 1


def test_the_log_tells_what_was_lost_repeated_and_damaged(cutting):
    of_controller = of(ControllerHeartbeat)
    cutting.wire.rules.append(nth(of_controller, [0], lose))
    cutting.wire.rules.append(nth(of_controller, [4], double))
    cutting.wire.rules.append(nth(of_controller, [8], flip))
    assert goes_on(cutting)
    assert cutting.say("stop").end() is Phase.STOPPED
    cutting.close()
    counted = hears(cutting, ControllerHeartbeat).statistics
    (closed,) = cutting.read().of("/audit/close")
    assert closed["bus"] == asdict(counted)
    assert (counted.losses, counted.repetitions, counted.crc_failures) == (1 + 1, 1, 1), (
        "a damaged one is lost too"
    )
    shown = Console(file=StringIO(), width=120)
    print_story(shown, story(cutting.read(), cutting.paths.log, None))
    assert "2 lost, 1 repeated, 1 damaged frames of the controller" in shown.file.getvalue()


# ---------------------------------------------------------------- delay


def test_heartbeats_whose_echo_is_too_old_do_not_keep_the_gate_open(cutting):
    """60 ms each way: never silent for the time-out, but every echo is older than it."""
    before = [hears(cutting, kind).statistics.losses for kind in KINDS]
    cutting.wire.delay_s = dict.fromkeys(map(of, KINDS), 0.060)
    began_s = cutting.clock()
    cutting.until(lambda: not cutting.controller.may_move)
    assert cutting.clock() - began_s < 0.2
    assert cutting.controller.cause is StopCause.HEARTBEAT_LOST
    assert hears(cutting, RuntimeHeartbeat).statistics.stale_heartbeats > 0
    assert [hears(cutting, kind).statistics.losses for kind in KINDS] == before
    assert StopCause.HEARTBEAT_LOST in stopped(cutting)


def test_twenty_six_heartbeats_that_queued_while_the_loop_slept_move_nothing(cutting):
    link = cutting.session._port.endpoint.link
    for _ in range(26):
        beat = RuntimeHeartbeat(RuntimeCode.CUT, cutting.state.epoch, StopCause.NONE)
        cutting.wire.nodes[CONTROLLER].put(*link.encode(beat, cutting.clock()))
    place = cutting.process.arm.state
    cutting.clock.now_s += 0.5
    cutting.process.run_cycle()
    assert cutting.controller.cause is StopCause.LOOP_STALLED
    assert not cutting.controller.may_move
    assert cutting.process.arm.state.joints == place.joints
    assert any("26 frames discarded" in line for line in cutting.said)
    cutting.runtime_runs = False
    cutting.run(0.2)
    assert cutting.process.arm.state.joints == place.joints


# ---------------------------------------------------------------- insertion, masquerade, a second node


@pytest.mark.parametrize(("side", "kind"), [(RUNTIME, RuntimeHeartbeat), (CONTROLLER, ControllerHeartbeat)])
def test_a_frame_on_ones_own_identifier_latches_on_both_sides(cutting, side, kind):
    cutting.wire.nodes[side].put(of(kind), bytes(8))
    assert stopped(cutting) == (StopCause.SECOND_NODE, StopCause.SECOND_NODE)
    assert cutting.controller.state is ControllerState.FAULT


@pytest.mark.parametrize("identifier", [CONTROL_IDS, BULK_IDS])
def test_a_transfer_on_ones_own_identifier_is_a_second_node_as_well(cutting, identifier):
    cutting.wire.nodes[RUNTIME].put(identifier[RUNTIME], bytes(8))
    assert stopped(cutting) == (StopCause.SECOND_NODE, StopCause.SECOND_NODE)


def test_frames_from_outside_the_session_are_ignored(cutting):
    order = RuntimeHeartbeat(RuntimeCode.INHIBIT, 0, StopCause.NONE)
    cutting.wire.nodes[CONTROLLER].put(*encode_frame(order, 77, 0))
    assert goes_on(cutting)
    assert hears(cutting, RuntimeHeartbeat).statistics.outside_session == 1


def test_frames_of_another_session_count_as_corrupted(cutting):
    order = RuntimeHeartbeat(RuntimeCode.INHIBIT, 0, StopCause.NONE)
    other = cutting.state.session.tag ^ 1
    for counter in range(2):
        cutting.wire.nodes[CONTROLLER].put(*encode_frame(order, counter, other))
    assert goes_on(cutting)
    cutting.wire.nodes[CONTROLLER].put(*encode_frame(order, 9, other))
    assert stopped(cutting)[1] is StopCause.CORRUPTION


def test_records_of_another_session_are_ignored(cutting):
    stranger = Stranger(cutting, session=records.digest(cutting.state.session.digest))
    stranger.say(records.NonceRequest(purpose=Purpose.PERMIT))
    assert goes_on(cutting)
    assert cutting.controller.issued is None


@pytest.mark.parametrize("data", [bytes(8), b"", b"\xff" * 8])
def test_anything_on_the_stop_identifier_stops(cutting, data):
    cutting.wire.nodes[CONTROLLER].put(of(RuntimeStop), data)
    assert StopCause.CORRUPTION in stopped(cutting)


def test_a_controllers_fault_frame_stops_the_runtime_at_once(cutting):
    cutting.controller_terminal.type("estop")
    cutting.run_cycle()
    assert cutting.wire.frames(ControllerFault)
    assert Phase.STOPPING in cutting.notes.phases
    assert stopped(cutting) == (StopCause.EMERGENCY_STOP, StopCause.EMERGENCY_STOP)


# ---------------------------------------------------------------- a stop overtakes a permit


@pytest.fixture
def authorising(pair):
    """A pair whose permit is decided and waits for the disk."""
    pair.begin().until(lambda: pair.phase is Phase.UPLOADING)
    pair.disk.answers = False
    pair.until(lambda: pair.phase is Phase.AUTHORISING_PERMIT)
    return pair


def signed(pair):
    """The permit that waits, as it would leave but for its code, which the endpoint makes."""
    committed = next(effect for effect in pair.notes.effects if isinstance(effect, Commit)).record
    return replace(committed, log=DURABLE_LOG)


def test_only_the_stop_makes_the_difference_in_the_next_tests(authorising):
    """Without it the permit is accepted; then it falls, for no heartbeat of the runtime says READY."""
    stranger = Stranger(authorising, authorising.state.session.digest)
    stranger.say(signed(authorising))
    authorising.run(0.05)
    assert "state PERMITTED" in authorising.said
    assert authorising.said[-1] == "state INHIBITED (PROTOCOL_VIOLATION)"


def test_a_permit_that_arrives_whole_after_a_stop_is_void(authorising):
    stranger = Stranger(authorising, authorising.state.session.digest)
    authorising.say("stop")
    stranger.say(signed(authorising))
    authorising.run(0.05)
    assert [reply.refusal for reply in stranger.replies] == [Refusal.VOIDED_BY_STOP]
    assert authorising.controller.state is ControllerState.INHIBITED


def test_a_permit_in_flight_when_the_stop_arrives_is_dead(authorising):
    stranger = Stranger(authorising, authorising.state.session.digest)
    stranger.say(signed(authorising))
    authorising.run_cycle()
    authorising.run_cycle()  # the first block is under way, the second waits for its flow control
    assert stranger.endpoint.outgoing() == []
    authorising.say("stop")
    authorising.run(0.06)
    assert stranger.replies == []
    assert authorising.controller.state is ControllerState.INHIBITED
    assert authorising.controller.permit is None


def test_a_permit_that_waits_behind_a_stop_never_leaves(pair):
    pair.begin().until(lambda: pair.phase is Phase.PERMITTING)
    begun = sum(seen.can_id == CONTROL_IDS[RUNTIME] for seen in pair.wire.seen)
    pair.say("stop")
    pair.run(0.2)
    sent = [seen for seen in pair.wire.seen if seen.can_id == CONTROL_IDS[RUNTIME]]
    assert all(seen.data[0] >> 4 == 3 for seen in sent[begun:])  # flow controls at most
    assert pair.controller.state is ControllerState.INHIBITED


def test_an_old_permit_opens_nothing_in_the_next_session(pair):
    pair.to(Phase.PERMITTED)
    old = signed(pair)
    pair.say("quit").end()
    pair.close()
    pair.run(0.2).begin()
    pair.prover.answer = lambda _request: None
    pair.to(Phase.VERIFYING)
    stranger = Stranger(pair, pair.state.session.digest)
    stranger.say(old)
    pair.run(0.05)
    assert [reply.refusal for reply in stranger.replies] == [Refusal.WRONG_SESSION]


# ---------------------------------------------------------------- transfers


@pytest.mark.parametrize("which", [1, 5, 13])
@pytest.mark.parametrize("change", [lose, flip], ids=["lost", "flipped"])
def test_a_damaged_upload_ends_the_session_and_never_loads_a_path(pair, change, which):
    pair.wire.rules.append(nth(BULK_IDS[RUNTIME], range(which + 3, which + 4), change))  # after flow controls
    pair.begin()
    assert pair.end() is Phase.STOPPED
    assert {pair.state.cause, pair.controller.cause} & {
        StopCause.TRANSFER_FAILED,
        StopCause.PROTOCOL_VIOLATION,
    }
    assert Phase.VERIFYING not in pair.notes.phases
    assert pair.controller.holdings.path is None


@pytest.mark.parametrize("change", [lose, flip], ids=["lost", "flipped"])
def test_a_damaged_record_of_the_controller_ends_the_session(pair, change):
    pair.wire.rules.append(nth(BULK_IDS[CONTROLLER], range(4, 5), change))
    pair.begin()
    assert pair.end() is Phase.STOPPED
    assert pair.state.cause in (StopCause.TRANSFER_FAILED, StopCause.PROTOCOL_VIOLATION)
    assert not pair.state.collected.complete


def paused(channels, side):
    """Every flow control that this side sends on these channels asks for 10 ms between two frames."""

    def change(message):
        if message.arbitration_id in channels and message.data[0] == 0x30:
            message = can.Message(
                arbitration_id=message.arbitration_id,
                data=bytes([*message.data[:2], 10, *message.data[3:]]),
                is_extended_id=False,
            )
        return [message]

    channels = {channels[side]}
    return change


SEPARATION = "flow control asks for a separation time (STmin) of 0x0a, must be 0"


def test_a_controller_that_asks_for_a_separation_time_is_told_apart_from_a_silent_one(pair):
    pair.wire.rules.append(paused(CONTROL_IDS, CONTROLLER))
    assert pair.begin().end() is Phase.REFUSED
    assert f"control channel: {SEPARATION}" in pair.notes.notes


def test_a_controller_that_asks_for_a_separation_time_during_the_upload_is_refused_in_words(pair):
    pair.wire.rules.append(paused(BULK_IDS, CONTROLLER))
    assert pair.begin().end() is Phase.STOPPED
    assert (pair.state.cause, pair.state.reason) == (StopCause.TRANSFER_FAILED, f"bulk channel: {SEPARATION}")


def test_a_runtime_that_asks_for_a_separation_time_is_refused_in_words_by_the_controller(pair):
    pair.wire.rules.append(paused(CONTROL_IDS, RUNTIME))
    pair.begin().run(1.0)
    assert pair.phase is Phase.WAITING
    assert pair.said.count(f"control channel: {SEPARATION}") == 1


def test_a_runtime_that_asks_for_a_separation_time_for_the_limits_is_refused_in_words(pair):
    pair.wire.rules.append(paused(BULK_IDS, RUNTIME))
    assert pair.begin().end() is Phase.STOPPED
    assert f"refused: bulk channel: {SEPARATION}" in pair.said


def test_an_opening_whose_flow_control_never_comes_does_not_hold_up_the_next_one(pair):
    """The first one's beginning is lost, and its sender waits; what the next announcement brings leaves at once."""

    def begins_open(message):
        return message.arbitration_id == CONTROL_IDS[RUNTIME] and message.data[0] >> 4 == 1

    pair.wire.rules.append(
        lambda m: [] if begins_open(m) and len(first_frames(pair, records.Open)) == 1 else [m]
    )
    assert pair.end() is Phase.DONE, pair.state.reason
    assert len(first_frames(pair, records.Open)) == 2


def test_an_announcement_that_was_damaged_is_followed_by_another(pair):
    pair.wire.rules.append(nth(CONTROL_IDS[CONTROLLER], range(1, 2), lose))
    assert pair.begin().end() is Phase.DONE


def test_a_record_that_was_heard_twice_counts_once(pair):
    pair.to(Phase.CUTTING)
    stranger = Stranger(pair, pair.state.session.digest)
    stranger.endpoint._sent = dict.fromkeys(stranger.endpoint._sent, 0)
    stranger.say(records.Collect())
    pair.run(0.05)
    assert not [item for item in stranger.heard if isinstance(item, RecordReceived)]


# ---------------------------------------------------------------- a stranger that takes the bus


TAKEN = "had identifier 0x000, which is neither side's"


def crowded(pair, ended, frames=10):
    """Until the session has ended, so many frames of a stranger arrive in each cycle."""
    limit_s = pair.clock() + 5.0
    while not ended() and pair.clock() < limit_s:
        for _ in range(frames):
            pair.wire.nodes[RUNTIME].put(0x000, bytes(8))
        pair.run_cycle()
    assert ended()
    return pair.state


@pytest.mark.parametrize("frames", [0, 1, 10])
def test_a_lost_heartbeat_says_who_has_taken_the_bus(cutting, frames):
    """Ten frames in 5 ms do; one is a node with something to say."""
    cutting.controller_runs = False
    state = crowded(cutting, lambda: cutting.phase is not Phase.CUTTING, frames)
    assert state.cause is StopCause.HEARTBEAT_LOST
    assert sum(TAKEN in note for note in cutting.notes.notes) == (frames == 10)
    assert ("; this computer was not late; " in state.reason) is (TAKEN in state.reason) is (frames == 10)


@pytest.mark.parametrize("frames", [0, 10])
@pytest.mark.parametrize("cause", [StopCause.HEARTBEAT_LOST, StopCause.EMERGENCY_STOP])
def test_a_controller_that_has_heard_nothing_is_told_with_who_has_taken_the_bus(cutting, cause, frames):
    for _ in range(40):
        for _ in range(frames):
            cutting.wire.nodes[RUNTIME].put(0x000, bytes(8))
        cutting.run_cycle()
    assert cutting.phase is Phase.CUTTING
    fault = encode_frame(ControllerFault(FaultCode.LATCHED, cause), 0, cutting.state.session.tag)
    cutting.wire.nodes[RUNTIME].put(*fault)
    cutting.run_cycle()
    assert cutting.state.reason.startswith(f"the controller reports {cause.name}")
    assert (TAKEN in cutting.state.reason) is (cause is StopCause.HEARTBEAT_LOST and frames > 0)


@pytest.mark.parametrize("frames", [0, 10])
def test_a_transfer_that_does_not_end_says_who_has_taken_the_bus(pair, frames):
    pair.to(Phase.COLLECTING).until(lambda: pair.state.collected.tool is not None)
    pair.wire.rules.append(nth(BULK_IDS[CONTROLLER], range(1000), lose))  # no flow control any more
    state = crowded(pair, lambda: pair.phase in ENDED, frames)
    assert state.cause is StopCause.TRANSFER_FAILED
    assert (TAKEN in state.reason) is (frames > 0)
    pair.close()
    faults = [one["detail"] for one in pair.read().of("/audit/fault") if one["source"] == "runtime"]
    assert faults[0] == state.reason
