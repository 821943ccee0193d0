"""One side's single frames: age, counters, session, second node, stop."""

import math
from collections.abc import Sized
from dataclasses import FrozenInstanceError, replace
from itertools import count, permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.protocol.codes import NO_ECHO, PresharedKey
from cutgate.protocol.e2e import intact, protect
from cutgate.protocol.frames import (
    BULK_IDS,
    CONTROL_IDS,
    DATA_IDS,
    FRAMES,
    IDS,
    SENT_BY,
    ControllerFault,
    ControllerHeartbeat,
    FrameError,
    Joints01,
    Progress,
    RuntimeHeartbeat,
    RuntimeStop,
    decode_frame,
    encode_frame,
    joint_frames,
)
from cutgate.protocol.link import (
    Accepted,
    Discarded,
    ForTransfer,
    JointSample,
    Link,
    Outcome,
    Statistics,
    Unlisted,
    Violation,
)
from cutgate.protocol.states import ControllerState, FaultCode, RuntimeCode, StopCause, StopCode
from cutgate.protocol.wire import Channel, Side
from tests.protocol.sessions import CODES, DIGEST, KEY, OTHER_DIGEST, TAG, tagged

TIMEOUT_S = 0.1
PERIOD_S = 0.02

CUT = RuntimeHeartbeat(RuntimeCode.CUT, 3)
CUTTING = ControllerHeartbeat(ControllerState.CUTTING, 3, StopCause.NONE, True, True, True)
BEATS = {Side.RUNTIME: CUT, Side.CONTROLLER: CUTTING}


def link(side: Side = Side.CONTROLLER, now_s: float = 0.0) -> Link:
    made = Link(side, TIMEOUT_S, PERIOD_S)
    made.open(CODES, now_s)
    return made


def pair() -> tuple[Link, Link]:
    """The runtime's and the controller's link."""
    return link(Side.RUNTIME), link(Side.CONTROLLER)


def deliver(sender: Link, receiver: Link, frame, now_s: float) -> Outcome:
    return receiver.receive(*sender.encode(frame, now_s), now_s=now_s)


def exchange(runtime: Link, controller: Link, turns: int, start_s: float = 0.0) -> float:
    """Both sides beat once a period; the time of the last beat."""
    now_s = start_s
    for _ in range(turns):
        now_s += PERIOD_S
        deliver(runtime, controller, CUT, now_s)
        deliver(controller, runtime, CUTTING, now_s)
    return now_s


# ------------------------------------------------------------------ opening


@pytest.mark.parametrize(
    ("timeout_s", "heartbeat_s"),
    [(0.1, 0.0), (0.1, 0.03), (0.1, -1.0), (6.0, 0.02), (math.nan, 0.02), (0.1, math.nan), (math.inf, 0.02)],
)
def test_timing_that_cannot_show_age_is_refused(timeout_s: float, heartbeat_s: float):
    with pytest.raises(ValueError, match="must be 4 to 254 heartbeats"):
        Link(Side.RUNTIME, timeout_s, heartbeat_s)


@pytest.mark.parametrize("heartbeat_ms", range(5, 101))
def test_four_heartbeats_of_whole_milliseconds_are_enough_and_not_a_microsecond_less(heartbeat_ms: int):
    heartbeat_s = heartbeat_ms / 1000
    assert Link(Side.RUNTIME, 4 * heartbeat_ms / 1000, heartbeat_s).heartbeat_s == heartbeat_s
    with pytest.raises(ValueError, match="must be 4 to 254 heartbeats"):
        Link(Side.RUNTIME, 4 * heartbeat_ms / 1000 - 1e-6, heartbeat_s)


@pytest.mark.parametrize("factor", [4.0, 254.0])
def test_timing_at_the_ends_of_its_range_is_taken(factor: float):
    made = Link(Side.RUNTIME, factor * 0.25, 0.25)
    assert (made.timeout_s, made.heartbeat_s) == (factor * 0.25, 0.25)


def test_a_counter_that_goes_round_within_the_time_out_shows_no_age():
    with pytest.raises(ValueError, match="must be 4 to 254 heartbeats"):
        Link(Side.RUNTIME, 255 * 0.25, 0.25)


def test_a_link_is_made_closed():
    made = Link(Side.RUNTIME, TIMEOUT_S, PERIOD_S)
    assert not made.is_open
    assert made.receive(IDS[ControllerHeartbeat], bytes(8), now_s=0.0) == Discarded("no session")


@pytest.mark.parametrize("tag", [1, (1 << 32) - 1])
def test_every_other_number_is_the_tag_of_a_session(tag: int):
    made = link()
    made.open(PresharedKey(KEY).session(tag.to_bytes(4, "little") + bytes(28)), 0.0)
    assert made.tag == tag


def test_session_needs_a_tag():
    with pytest.raises(ValueError, match="session tag is 0"):
        Link(Side.RUNTIME, TIMEOUT_S, PERIOD_S).open(PresharedKey(KEY).session(bytes(32)), 0.0)


def test_opening_begins_anew():
    runtime, controller = pair()
    exchange(runtime, controller, 5)
    controller.open(CODES, 1.0)
    assert controller.statistics == link().statistics
    assert not controller.fresh(1.0)
    assert controller.encode(CUTTING, 1.0)[1][2] == 0
    assert controller.encode(CUTTING, 1.0)[1][5] == 255


def test_closed_link_accepts_nothing_and_expires_nothing():
    runtime, controller = pair()
    exchange(runtime, controller, 5)
    controller.close()
    assert not controller.is_open
    for frame in (CUT, RuntimeStop(StopCode.STOP, StopCause.OPERATOR_STOP)):
        assert deliver(runtime, controller, frame, 0.2) == Discarded("no session")
    assert not controller.fresh(0.2)
    assert controller.expire(1e9) is None
    assert controller.sample is None


def test_what_a_closed_link_sends_belongs_to_no_session():
    runtime = link(Side.RUNTIME)
    runtime.close()
    can_id, data = runtime.encode(CUT, 0.0)
    assert intact(data, DATA_IDS[can_id], 0)


@pytest.mark.parametrize(
    "judged",
    [
        Accepted(CUT, 0),
        Discarded("why"),
        Violation(StopCause.CORRUPTION, "why"),
        Unlisted(),
        ForTransfer(Channel.BULK),
        Statistics(),
        JointSample(np.zeros(5), 0, 0.0),
    ],
    ids=lambda judged: type(judged).__name__,
)
def test_what_was_judged_stays_as_it_was(judged):
    with pytest.raises(FrozenInstanceError):
        judged.counter = 1


def test_a_sample_equals_itself_alone():
    """Arrays do not say whether they are equal."""
    assert JointSample(np.zeros(5), 0, 0.0) != JointSample(np.zeros(5), 0, 0.0)


# ------------------------------------------------------------------ identifiers


@pytest.mark.parametrize("side", Side)
@pytest.mark.parametrize("opened", [True, False])
def test_whole_identifier_space(side: Side, opened: bool):
    listed = SENT_BY[Side.RUNTIME] | SENT_BY[Side.CONTROLLER]
    watched = link(side)
    if not opened:
        watched.close()
    for can_id in range(0x800):
        outcome = watched.receive(can_id, bytes(8), now_s=0.0)
        if can_id not in listed:
            assert outcome == Unlisted()
        elif can_id in SENT_BY[side]:
            assert isinstance(outcome, Violation)
            assert outcome.cause is StopCause.SECOND_NODE
        elif can_id not in FRAMES:
            assert isinstance(outcome, ForTransfer)
        elif not opened:
            assert isinstance(outcome, Discarded)


@pytest.mark.parametrize("side", Side)
def test_second_node_is_seen_whatever_its_frame(side: Side):
    for flags in ({}, {"is_remote": True}, {"is_fd": True}):
        for can_id in SENT_BY[side]:
            outcome = link(side).receive(can_id, b"", **flags, now_s=0.0)
            assert isinstance(outcome, Violation)
            assert outcome.cause is StopCause.SECOND_NODE


def test_extended_identifiers_are_not_ours():
    for can_id in SENT_BY[Side.RUNTIME] | SENT_BY[Side.CONTROLLER]:
        assert link().receive(can_id, bytes(8), is_extended=True, now_s=0.0) == Unlisted()


def test_error_frames_are_discarded():
    assert isinstance(link().receive(0x011, b"", is_error=True, now_s=0.0), Discarded)


@pytest.mark.parametrize(("can_id", "channel"), [(0x600, Channel.CONTROL), (0x640, Channel.BULK)])
def test_transfer_frames_go_to_their_channel(can_id: int, channel: Channel):
    assert link().receive(can_id, bytes(8), now_s=0.0) == ForTransfer(channel)
    assert isinstance(link().receive(can_id, bytes(7), now_s=0.0), Discarded)
    assert isinstance(link().receive(can_id, bytes(8), is_fd=True, now_s=0.0), Discarded)
    assert isinstance(link().receive(can_id, bytes(8), is_remote=True, now_s=0.0), Discarded)


@pytest.mark.parametrize("side", Side)
def test_with_fd_only_the_bulk_channel_takes_fd_frames_and_takes_no_other(side: Side):
    made = Link(side, TIMEOUT_S, PERIOD_S, fd=True)
    made.open(CODES, 0.0)
    for can_id in SENT_BY[side.peer]:
        bulk = can_id in BULK_IDS
        for size in (8, 12, 64):
            outcome = made.receive(can_id, bytes(size), is_fd=True, now_s=0.0)
            assert (outcome == ForTransfer(Channel.BULK)) is bulk, can_id
        for flags in ({}, {"is_remote": True}, {"is_remote": True, "is_fd": True}):
            outcome = made.receive(can_id, bytes(8), **flags, now_s=0.0)
            assert (outcome == ForTransfer(Channel.CONTROL)) is (can_id in CONTROL_IDS and not flags)
            assert outcome != ForTransfer(Channel.BULK)


@pytest.mark.parametrize("side", Side)
def test_frames_of_the_other_side_are_never_sent(side: Side):
    with pytest.raises(FrameError, match="never sent by"):
        link(side).encode(BEATS[side.peer], 0.0)


# ------------------------------------------------------------------ counters and protection


def test_losses_up_to_three_steps_are_counted_and_more_is_a_violation():
    for lost, accepted in ((0, True), (1, True), (2, True), (3, False), (200, False)):
        runtime, controller = pair()
        deliver(runtime, controller, CUT, 0.0)
        for _ in range(lost):
            runtime.encode(CUT, 0.0)
        outcome = deliver(runtime, controller, CUT, 0.0)
        if accepted:
            assert isinstance(outcome, Accepted)
            assert (outcome.lost, controller.statistics.losses) == (lost, lost)
        else:
            assert isinstance(outcome, Violation)
            assert outcome == Violation(
                StopCause.SEQUENCE_ERROR, f"0x080 counter {lost + 1} after a gap of {lost}"
            )


def test_repetition_is_discarded_and_refreshes_nothing():
    runtime, controller = pair()
    now_s = exchange(runtime, controller, 5)
    frame = runtime.encode(CUT, now_s)
    assert isinstance(controller.receive(*frame, now_s=now_s), Accepted)
    for _ in range(10):
        now_s += PERIOD_S
        assert isinstance(controller.receive(*frame, now_s=now_s), Discarded)
    assert controller.statistics.repetitions == 10
    assert controller.expire(now_s) is StopCause.HEARTBEAT_LOST


def test_same_counter_with_other_content_is_a_violation():
    controller = link()
    for frame, kind in ((CUT, Accepted), (replace(CUT, epoch=4), Violation)):
        assert isinstance(controller.receive(*tagged(frame, 0), now_s=0.0), kind)


@given(st.integers(0, 63), st.sampled_from([0x080]))
def test_one_flipped_bit_is_discarded_and_counted(bit: int, can_id: int):
    runtime, controller = pair()
    _, data = runtime.encode(CUT, 0.0)
    damaged = bytearray(data)
    damaged[bit // 8] ^= 1 << bit % 8
    assert isinstance(controller.receive(can_id, bytes(damaged), now_s=0.0), Discarded)
    assert controller.statistics.crc_failures == 1
    assert isinstance(controller.receive(can_id, data, now_s=0.0), Accepted)


def test_third_corruption_in_a_second_is_a_violation_over_all_identifiers():
    runtime = link(Side.RUNTIME)
    assert isinstance(runtime.receive(0x081, bytes(8), now_s=0.0), Discarded)
    assert isinstance(runtime.receive(0x300, bytes(8), now_s=0.5), Discarded)
    outcome = runtime.receive(0x010, bytes(8), now_s=1.0)
    assert isinstance(outcome, Violation)
    assert outcome.cause is StopCause.CORRUPTION


def test_two_corruptions_a_second_are_tolerated_for_ever():
    runtime = link(Side.RUNTIME)
    for at in range(50):
        assert isinstance(runtime.receive(0x081, bytes(8), now_s=0.6 * at), Discarded)


@pytest.mark.parametrize("flags", [{"is_remote": True}, {"is_fd": True}])
def test_frame_of_another_kind_counts_as_corrupt(flags: dict[str, bool]):
    runtime, controller = pair()
    can_id, data = runtime.encode(CUT, 0.0)
    assert isinstance(controller.receive(can_id, data, **flags, now_s=0.0), Discarded)
    assert controller.statistics.crc_failures == 1


def test_frame_of_another_session_counts_as_corrupt():
    controller = link()
    controller.receive(*tagged(CUT, 0, codes=PresharedKey(KEY).session(OTHER_DIGEST)), now_s=0.0)
    assert controller.statistics.crc_failures == 1


def test_frame_sent_outside_any_session_is_discarded_and_never_accepted():
    controller = link()
    for counter in range(10):
        outcome = controller.receive(*encode_frame(CUT, counter, 0), now_s=0.0)
        assert isinstance(outcome, Discarded)
        assert "outside the session" in outcome.reason
    assert controller.statistics.outside_session == 10
    assert not controller.fresh(0.0)


def test_frame_under_another_identifier_is_corrupt():
    controller, runtime = link(), link(Side.RUNTIME)
    _, data = controller.encode(Progress(1, 2), 0.0)
    assert isinstance(runtime.receive(IDS[Joints01], data, now_s=0.0), Discarded)
    assert runtime.statistics.crc_failures == 1


def test_sound_frame_with_unlisted_content_is_a_violation():
    covered = b"\x03\x00"
    tag = CODES.heartbeat_tag(Side.RUNTIME, 0, NO_ECHO, covered).to_bytes(2, "little")
    data = protect(tag + b"\xff" + covered, 0, DATA_IDS[0x080], TAG)
    outcome = link().receive(0x080, data, now_s=0.0)
    assert isinstance(outcome, Violation)
    assert outcome.cause is StopCause.PROTOCOL_VIOLATION
    assert "code is 0x3" in outcome.detail


def test_sound_frame_of_any_other_kind_with_unlisted_content_is_a_violation():
    data = protect(b"\x01\x00\x01\x00\x00", 0, DATA_IDS[0x010], TAG)
    outcome = link(Side.RUNTIME).receive(0x010, data, now_s=0.0)
    assert isinstance(outcome, Violation)
    assert outcome.cause is StopCause.PROTOCOL_VIOLATION


@pytest.mark.parametrize(
    "frame", [Progress(7, 8), ControllerFault(FaultCode.LATCHED, StopCause.SECOND_NODE, 9)]
)
def test_progress_and_fault_are_accepted_and_refresh_nothing(frame):
    runtime, controller = pair()
    outcome = deliver(controller, runtime, frame, 0.0)
    assert outcome == Accepted(frame, 0)
    assert outcome.fresh, "of a heartbeat alone it is asked"
    assert not runtime.fresh(0.0)


def test_frames_of_every_kind_are_counted_and_what_is_missing_before_them():
    runtime, controller = pair()
    for lost in (0, 2):
        for _ in range(lost):
            controller.encode(Progress(1, 0), 0.0)
        assert deliver(controller, runtime, Progress(1, 0), 0.0).lost == lost
    assert runtime.statistics == Statistics(accepted=2, losses=2)


def test_each_message_has_its_own_counter():
    controller = link()
    assert controller.encode(CUTTING, 0.0)[1][2] == 0
    assert controller.encode(Progress(0, 0), 0.0)[1][2] == 0
    assert controller.encode(CUTTING, 0.0)[1][2] == 1
    assert controller.encode(ControllerFault(FaultCode.STOPPED, StopCause.BONE_MOVED), 0.0)[1][2] == 0
    assert [controller.encode(Progress(0, 0), 0.0)[1][2] for _ in range(300)] == [
        at % 256 for at in range(1, 301)
    ]


def test_the_counter_is_that_of_the_heartbeat_made_last_and_does_not_roll_over():
    runtime = link(Side.RUNTIME)
    assert runtime.counter == -1
    for counter in range(300):
        runtime.encode(CUT, 0.0)
        assert runtime.counter == counter
    runtime.take_back(IDS[RuntimeHeartbeat])
    assert runtime.counter == 298


def test_counter_rolls_over():
    runtime, controller = pair()
    exchange(runtime, controller, 600)
    assert controller.statistics.accepted == 600
    assert controller.statistics.losses == controller.statistics.repetitions == 0
    assert controller.statistics.stale_heartbeats == 1


def test_what_a_link_remembers_does_not_grow():
    runtime, controller = pair()
    exchange(runtime, controller, 1000)
    for one in (runtime, controller):
        sizes = {name: len(value) for name, value in vars(one).items() if isinstance(value, Sized)}
        assert max(sizes.values()) <= 256, sizes


# ------------------------------------------------------------------ stop


def test_a_stop_names_what_was_heard_last():
    runtime, controller = pair()
    stop = RuntimeStop(StopCode.STOP, StopCause.OPERATOR_STOP)
    assert decode_frame(*runtime.encode(stop, 0.0)).echo == 255
    exchange(runtime, controller, 300)
    assert decode_frame(*runtime.encode(stop, 0.0)).echo == 299 % 256


def test_stop_and_end_are_accepted_as_sent():
    for code in StopCode:
        runtime, controller = pair()
        outcome = deliver(runtime, controller, RuntimeStop(code, StopCause.OPERATOR_STOP), 0.0)
        assert outcome == Accepted(RuntimeStop(code, StopCause.OPERATOR_STOP), 0)
        assert controller.statistics == Statistics(accepted=1)


@given(st.binary(max_size=64), st.booleans(), st.booleans())
def test_anything_on_the_stop_identifier_stops(data: bytes, is_remote: bool, is_fd: bool):
    outcome = link().receive(0x011, data, is_remote=is_remote, is_fd=is_fd, now_s=0.0)
    assert isinstance(outcome, Accepted)
    assert isinstance(outcome.frame, RuntimeStop)
    assert outcome.frame.code is StopCode.STOP
    assert outcome.counter == (data[2] if len(data) > 2 else 0)


@given(st.integers(0, 63))
def test_end_with_one_flipped_bit_is_a_stop(bit: int):
    data = bytearray(link(Side.RUNTIME).encode(RuntimeStop(StopCode.END, StopCause.SESSION_ENDED), 0.0)[1])
    data[bit // 8] ^= 1 << bit % 8
    outcome = link().receive(0x011, bytes(data), now_s=0.0)
    assert isinstance(outcome, Accepted)
    assert outcome.frame == RuntimeStop(StopCode.STOP, StopCause.CORRUPTION)


@pytest.mark.parametrize(("data", "counter"), [(b"", 0), (b"ab", 0), (b"ab\x07", 7)])
def test_a_stop_cut_short_is_a_stop_and_counted(data: bytes, counter: int):
    controller = link()
    outcome = controller.receive(0x011, data, now_s=0.0)
    assert outcome == Accepted(RuntimeStop(StopCode.STOP, StopCause.CORRUPTION), counter)
    assert controller.statistics == Statistics(crc_failures=1)


def test_sound_stop_frame_with_unlisted_code_is_a_stop():
    data = protect(b"\x00\x00\x00\xff\x00", 0, DATA_IDS[0x011], TAG)
    assert link().receive(0x011, data, now_s=0.0) == Accepted(
        RuntimeStop(StopCode.STOP, StopCause.PROTOCOL_VIOLATION), 0
    )


def test_repeated_stop_stops_again():
    runtime, controller = pair()
    frame = runtime.encode(RuntimeStop(StopCode.STOP, StopCause.BONE_MOVED), 0.0)
    for _ in range(3):
        assert isinstance(controller.receive(*frame, now_s=0.0), Accepted)


# ------------------------------------------------------------------ age


def test_never_seen_is_stale():
    assert not link().fresh(0.0)
    assert link().expire(0.0) is None
    assert link().expire(TIMEOUT_S) is None
    assert link().expire(TIMEOUT_S + 1e-6) is StopCause.HEARTBEAT_LOST


def test_answered_heartbeats_keep_the_link_fresh():
    runtime, controller = pair()
    now_s = exchange(runtime, controller, 3)
    for one in (runtime, controller):
        assert one.fresh(now_s)
        echoed_s = {controller: now_s - PERIOD_S, runtime: now_s}[one]  # when what was echoed last was sent
        assert one.fresh(echoed_s + TIMEOUT_S - 1e-6)
        assert not one.fresh(echoed_s + TIMEOUT_S + 1e-6)
        assert one.expire(echoed_s + TIMEOUT_S - 1e-6) is None
        assert one.expire(echoed_s + TIMEOUT_S + 1e-6) is StopCause.HEARTBEAT_LOST


def test_the_time_out_says_when_it_comes():
    """So that a loop can wake at it, instead of a heartbeat's period later."""
    runtime, controller = pair()
    assert controller.expires_s == TIMEOUT_S
    now_s = exchange(runtime, controller, 3)
    for one, echoed_s in ((runtime, now_s), (controller, now_s - PERIOD_S)):
        assert one.expires_s == pytest.approx(echoed_s + TIMEOUT_S)
        one.close()
        assert one.expires_s == math.inf


def test_clock_that_runs_backward_or_is_nan_is_stale():
    runtime, controller = pair()
    now_s = exchange(runtime, controller, 3)
    for bad_s in (now_s - PERIOD_S - 0.01, math.nan):
        assert not controller.fresh(bad_s)
        assert controller.expire(bad_s) is StopCause.HEARTBEAT_LOST


def test_heartbeat_that_answers_nothing_does_not_refresh():
    runtime, controller = pair()
    for at in range(10):
        outcome = deliver(runtime, controller, CUT, at * PERIOD_S)
        assert isinstance(outcome, Accepted)
        assert not outcome.fresh
    assert controller.statistics.stale_heartbeats == 10
    assert not controller.fresh(10 * PERIOD_S)


@pytest.mark.parametrize(("late_s", "fresh"), [(TIMEOUT_S, True), (TIMEOUT_S + 1e-6, False)])
def test_answer_counts_only_if_we_sent_within_the_timeout(late_s: float, fresh: bool):
    runtime, controller = pair()
    runtime.receive(*controller.encode(CUTTING, 0.0), now_s=0.0)
    answer = runtime.encode(CUT, 0.0)
    outcome = controller.receive(*answer, now_s=late_s)
    assert isinstance(outcome, Accepted)
    assert outcome.fresh is fresh
    assert controller.fresh(late_s) is fresh


def test_26_queued_stale_heartbeats_do_not_refresh():
    """The controller's reader pauses half a second, then finds 26 sound heartbeats at once."""
    runtime, controller = pair()
    now_s = exchange(runtime, controller, 5)
    queued = []
    for _ in range(26):
        now_s += PERIOD_S
        queued.append(runtime.encode(CUT, now_s))
    assert controller.expire(now_s) is StopCause.HEARTBEAT_LOST
    for frame in queued:
        outcome = controller.receive(*frame, now_s=now_s)
        assert isinstance(outcome, Accepted)
        assert not outcome.fresh
    assert not controller.fresh(now_s)
    assert controller.expire(now_s) is StopCause.HEARTBEAT_LOST
    assert controller.statistics.stale_heartbeats == 26 + 1


def test_steady_delay_beyond_the_timeout_does_not_refresh():
    """Every frame of the runtime comes eight periods late; counters are perfect all the while."""
    runtime, controller = pair()
    pipe = []
    fresh = []
    for turn in range(60):
        now_s = turn * PERIOD_S
        runtime.receive(*controller.encode(CUTTING, now_s), now_s=now_s)
        pipe.append(runtime.encode(CUT, now_s))
        if turn >= 8:
            assert isinstance(controller.receive(*pipe[turn - 8], now_s=now_s), Accepted)
        fresh.append(controller.fresh(now_s))
    assert not any(fresh)


def test_echo_255_before_any_is_not_taken_for_the_heartbeat_255():
    """The peer has heard nothing of us; that our 255th heartbeat has just left must not make it fresh."""
    runtime, controller = pair()
    for turn in range(256):
        controller.encode(CUTTING, turn * PERIOD_S)
    now_s = 255 * PERIOD_S
    assert runtime.encode(CUT, now_s)[1][5] == 255
    outcome = deliver(runtime, controller, CUT, now_s)
    assert isinstance(outcome, Accepted)
    assert not outcome.fresh


def test_heartbeat_255_refreshes_once_an_answer_was_heard():
    runtime, controller = pair()
    exchange(runtime, controller, 256)
    now_s = 257 * PERIOD_S
    outcome = deliver(runtime, controller, CUT, now_s)
    assert isinstance(outcome, Accepted)
    assert isinstance(outcome.frame, RuntimeHeartbeat)
    assert outcome.frame.echo == 255
    assert outcome.fresh


# ------------------------------------------------------------------ tags


def violated(outcome: Outcome) -> bool:
    return isinstance(outcome, Violation) and outcome.cause is StopCause.AUTHENTICATION_FAILED


@given(st.sampled_from(Side), st.data())
def test_a_heartbeat_changed_in_anything_and_given_a_sound_crc_stops(side: Side, data: st.DataObject):
    """What a node without the key can do: everything but the tag."""
    runtime, controller = pair()
    exchange(runtime, controller, 3)
    hearer, speaker = (runtime, controller) if side is Side.RUNTIME else (controller, runtime)
    can_id, sent = speaker.encode(BEATS[speaker.side], 0.07)
    bit = data.draw(st.integers(24, 63))
    altered = bytearray(sent)
    altered[bit // 8] ^= 1 << bit % 8
    forged = protect(bytes(altered[3:]), altered[2], DATA_IDS[can_id], TAG)
    assert violated(hearer.receive(can_id, forged, now_s=0.07))


@pytest.mark.parametrize("replaced", [True, False])
def test_after_a_strangers_heartbeat_the_peers_own_still_fits(replaced: bool):
    """It has stopped; that the peer is at rest must be heard all the same."""
    runtime, controller = pair()
    now_s = exchange(runtime, controller, 3)
    can_id, honest = controller.encode(CUTTING, now_s)
    forged = protect(bytes([honest[3] ^ 1]) + honest[4:], honest[2], DATA_IDS[can_id], TAG)
    assert violated(runtime.receive(can_id, forged, now_s=now_s))
    if not replaced:
        assert isinstance(runtime.receive(can_id, honest, now_s=now_s), Accepted)
    assert isinstance(deliver(controller, runtime, CUTTING, now_s), Accepted)


@pytest.mark.parametrize("codes", [PresharedKey(bytes(32)).session(DIGEST)])
def test_a_heartbeat_made_with_another_key_stops(codes):
    assert codes.tag == TAG
    assert violated(link().receive(*tagged(CUT, 0, codes=codes), now_s=0.0))


def test_one_sides_heartbeat_is_not_the_others():
    """Each direction has a key of its own: what a side said is not said back to it."""
    covered = b"\x05\x00"
    tags = {side: CODES.heartbeat_tag(side, 7, 3, covered) for side in Side}
    assert tags[Side.RUNTIME] != tags[Side.CONTROLLER]


def test_a_heartbeat_of_a_whole_round_of_counters_before_stops():
    """Counter and echo are extended to 32 bits: what was said once is never said again."""
    runtime, controller = pair()
    frames = []
    for turn in range(256):
        now_s = turn * PERIOD_S
        frame = runtime.encode(CUT, now_s)
        frames.append(frame)
        controller.receive(*frame, now_s=now_s)
        deliver(controller, runtime, CUTTING, now_s)
    assert runtime.encode(CUT, now_s)[1][2] == frames[0][1][2]
    assert violated(controller.receive(*frames[0], now_s=now_s))
    assert controller.statistics.accepted == 256


def test_an_echo_of_a_heartbeat_that_was_never_sent_stops():
    controller = link()
    controller.encode(CUTTING, 0.0)
    for echo in (1, 200, 254):
        assert violated(controller.receive(*tagged(CUT, 0, echo=echo), now_s=0.0))
        controller.open(CODES, 0.0)


def test_a_first_heartbeat_may_carry_any_counter_of_eight_bits_and_no_greater():
    for counter in (0, 17, 255):
        assert isinstance(link().receive(*tagged(CUT, counter), now_s=0.0), Accepted)
        assert violated(link().receive(*tagged(CUT, counter + 256), now_s=0.0))


def test_losses_are_counted_into_the_extended_counter():
    controller = link()
    for counter in (254, 257, 258):
        assert isinstance(controller.receive(*tagged(CUT, counter), now_s=0.0), Accepted)


@given(st.integers(0, 4), st.integers(1, 40), st.booleans())
def test_a_joint_sample_changed_in_one_joint_or_its_tag_stops(joint: int, by: int, tag: bool):
    runtime, controller = pair()
    deliver(runtime, controller, CUT, 0.0)
    deliver(controller, runtime, CUTTING, 0.0)
    frames = [controller.encode(frame, 0.0) for frame in joint_frames(JOINTS)]
    whole = [decode_frame(*frame) for frame in frames]
    where, name = (2, "tag") if tag else (joint // 2, f"q{joint}")
    value = getattr(whole[where], name)
    forged = replace(whole[where], **{name: value ^ by})
    frames[where] = encode_frame(forged, 0, TAG)
    assert violated([runtime.receive(*frame, now_s=0.0) for frame in frames][-1])
    assert runtime.sample is None


def test_parts_of_two_samples_under_one_counter_stop():
    """A node between the two holds one part back and sends another: what is joined was measured together."""
    runtime, controller = pair()
    deliver(runtime, controller, CUT, 0.0)
    deliver(controller, runtime, CUTTING, 0.0)
    first, second, _ = [controller.encode(frame, 0.0) for frame in joint_frames(JOINTS)]
    third = encode_frame(joint_frames([0.5] * 5)[2], 0, TAG)
    outcomes = [runtime.receive(*frame, now_s=0.0) for frame in (first, second, third)]
    assert violated(outcomes[-1])


def test_who_holds_the_last_heartbeat_back_gains_nothing():
    """The time-out runs from the sending of what is echoed, not from the arrival."""
    runtime, controller = pair()
    now_s = exchange(runtime, controller, 5)
    sent_s = now_s  # the last heartbeat of the controller that the runtime heard
    held = runtime.encode(CUT, now_s)  # and then it hangs
    arrives_s = sent_s + TIMEOUT_S - 0.001
    assert controller.receive(*held, now_s=arrives_s).fresh
    assert controller.expire(sent_s + TIMEOUT_S - 1e-6) is None
    assert controller.expire(sent_s + TIMEOUT_S + 1e-6) is StopCause.HEARTBEAT_LOST


def test_the_round_trip_is_from_the_sending_of_what_is_echoed_to_its_echo():
    """An echo that comes too late, or none, leaves it as it was; a new session knows of none."""
    runtime, controller = pair()
    assert runtime.round_trip_s is None
    deliver(runtime, controller, CUT, 0.01)
    deliver(controller, runtime, CUTTING, 0.04)
    assert runtime.round_trip_s == pytest.approx(0.03)
    deliver(controller, runtime, CUTTING, 0.05)
    assert runtime.round_trip_s == pytest.approx(0.04), "the same is echoed again, later"
    assert not deliver(controller, runtime, CUTTING, 0.01 + TIMEOUT_S + 0.001).fresh
    assert runtime.round_trip_s == pytest.approx(0.04)
    runtime.open(CODES, 1.0)
    assert runtime.round_trip_s is None


def test_an_earlier_echo_does_not_shorten_the_time_out():
    runtime, controller = pair()
    now_s = exchange(runtime, controller, 5)
    before = controller.expires_s
    stale_echo = tagged(CUT, 5, echo=1)
    assert controller.receive(*stale_echo, now_s=now_s).fresh
    assert controller.expires_s == before


# ------------------------------------------------------------------ joints

JOINTS = [0.1, 0.2, 300.0, -0.3, 1.5]


def test_three_joint_frames_of_one_counter_are_one_sample():
    runtime, controller = pair()
    for turn in range(300):
        deliver(runtime, controller, CUT, 0.02 * turn)
        deliver(controller, runtime, CUTTING, 0.02 * turn)
        for frame in joint_frames([0.001 * turn, *JOINTS[1:]]):
            assert isinstance(deliver(controller, runtime, frame, 0.02 * turn), Accepted)
        assert runtime.sample is not None
        assert runtime.sample.counter == turn
        assert runtime.sample.received_s == 0.02 * turn
        assert np.allclose(runtime.sample.joints, [0.001 * turn, *JOINTS[1:]], rtol=0.0, atol=0.006)


def test_a_sample_before_any_heartbeat_carries_the_counter_before_zero_and_is_none():
    runtime, controller = pair()
    for part in joint_frames(JOINTS):
        frame = controller.encode(part, 0.0)
        assert frame[1][2] == 255
        assert isinstance(runtime.receive(*frame, now_s=0.0), Accepted)
    assert runtime.sample is None


def test_a_part_that_is_made_again_takes_the_place_of_the_one_before():
    """Also the first part of all is made, whichever it is."""
    runtime, controller = pair()
    controller.encode(joint_frames(JOINTS)[1], 0.0)
    deliver(runtime, controller, CUT, 0.0)
    deliver(controller, runtime, CUTTING, 0.0)
    first, second, third = joint_frames(JOINTS)
    for frame in (*joint_frames([0.5] * 5)[:2], first, second, second):
        part = controller.encode(frame, 0.0)
        if frame in (first, second):
            runtime.receive(*part, now_s=0.0)
    assert isinstance(deliver(controller, runtime, third, 0.0), Accepted)
    assert runtime.sample is not None


@pytest.mark.parametrize("missing", [0, 1, 2])
def test_parts_of_different_samples_are_never_joined(missing: int):
    runtime, controller = pair()
    deliver(runtime, controller, CUT, 0.0)
    for frame in (CUTTING, *joint_frames(JOINTS)):
        deliver(controller, runtime, frame, 0.0)
    deliver(controller, runtime, CUTTING, 0.1)
    for part, frame in enumerate(joint_frames([0.5] * 5)):
        encoded = controller.encode(frame, 0.1)
        if part != missing:
            runtime.receive(*encoded, now_s=0.1)
    assert runtime.sample is not None
    assert runtime.sample.received_s == 0.0
    assert np.allclose(runtime.sample.joints, JOINTS, rtol=0.0, atol=0.006)


class Peer:
    """A controller with a clock of its own turns, whose frames the test delivers when and in which order it likes."""

    def __init__(self) -> None:
        self.runtime, self.controller = pair()

    def hear(self, now_s: float) -> None:
        """A heartbeat of the runtime reaches it."""
        deliver(self.runtime, self.controller, CUT, now_s)

    def run_cycle(self, now_s: float, place: float = 0.0) -> list[tuple[int, bytes]]:
        """Its heartbeat, and the joints it measures in this turn."""
        frames = [CUTTING, *joint_frames([place, *JOINTS[1:]])]
        return [self.controller.encode(frame, now_s) for frame in frames]

    def arrives(self, frame: tuple[int, bytes], now_s: float) -> Outcome:
        return self.runtime.receive(*frame, now_s=now_s)

    def sample(self, frames: list[tuple[int, bytes]], now_s: float) -> JointSample | None:
        """The sample that the last of these brings."""
        brought = [outcome.sample for outcome in (self.arrives(frame, now_s) for frame in frames)]
        assert not any(brought[:-1])
        return brought[-1]


def test_a_sample_comes_with_its_last_part_whichever_that_is_and_once():
    for order in permutations(range(3)):
        peer = Peer()
        peer.hear(0.1)
        beat, *parts = peer.run_cycle(0.1, 0.25)
        peer.arrives(beat, 0.1)
        sample = peer.sample([parts[at] for at in order], 0.1)
        assert sample is peer.runtime.sample
        assert sample.joints[0] == pytest.approx(0.25, abs=1e-4)
        for part in parts:
            assert isinstance(peer.arrives(part, 0.1), Discarded)


def test_a_frame_is_what_it_is_whatever_sample_it_completes():
    peer = Peer()
    peer.hear(0.1)
    *_, part = [peer.arrives(frame, 0.1) for frame in peer.run_cycle(0.1)]
    assert part.sample is not None
    assert part == replace(part, sample=None)


def test_a_sample_of_unknown_age_is_of_any():
    assert JointSample(np.zeros(5), 0, 1.0).measured_s == -math.inf


def test_several_samples_in_one_turn_each_come_in_order():
    peer = Peer()
    peer.hear(0.0)
    waiting = [frame for turn in range(5) for frame in peer.run_cycle(0.02 * turn, 0.01 * turn)]
    outcomes = [peer.arrives(frame, 0.1) for frame in waiting]
    found = [outcome.sample for outcome in outcomes if outcome.sample is not None]
    assert [sample.counter for sample in found] == list(range(5))
    assert [sample.joints[0] for sample in found] == pytest.approx(
        [0.01 * turn for turn in range(5)], abs=1e-4
    )


def test_a_sample_is_as_old_as_its_heartbeat_whatever_arrived_before_it():
    """Its own heartbeat echoes what was sent at 0.00; later ones overtake it, as urgent frames do."""
    peer = Peer()
    peer.hear(0.0)
    beat, *late = peer.run_cycle(0.01)
    peer.arrives(beat, 0.01)
    for now_s in (0.02, 0.04, 0.06):
        peer.hear(now_s)
        peer.arrives(peer.run_cycle(now_s + 0.01)[0], now_s + 0.01)
    assert peer.sample(late, 0.07).measured_s == 0.0


@pytest.mark.parametrize(("lost", "measured_s"), [((), 0.02), ((1,), 0.0)])
def test_where_its_heartbeat_was_lost_one_before_it_dates_a_sample(lost: tuple[int, ...], measured_s: float):
    peer = Peer()
    for turn, now_s in enumerate((0.0, 0.02)):
        peer.hear(now_s)
        beat, *parts = peer.run_cycle(now_s + 0.01)
        if turn not in lost:
            peer.arrives(beat, now_s + 0.01)
        sample = peer.sample(parts, now_s + 0.01)
    peer.arrives(peer.run_cycle(0.05)[0], 0.05)
    assert sample.measured_s == measured_s


def test_a_sample_that_no_heartbeat_dates_is_none():
    peer = Peer()
    for now_s in (0.0, 0.02):
        peer.hear(now_s)
        _, *parts = peer.run_cycle(now_s + 0.01)
        assert peer.sample(parts, now_s + 0.01) is None


@pytest.mark.parametrize(("late_s", "some"), [(2 * TIMEOUT_S, True), (2 * TIMEOUT_S + 1e-6, False)])
def test_a_sample_older_than_two_time_outs_is_none(late_s: float, some: bool):
    peer = Peer()
    peer.hear(0.0)
    beat, *parts = peer.run_cycle(0.0)
    peer.arrives(beat, 0.0)
    assert (peer.sample(parts, late_s) is not None) is some


def test_a_heartbeat_that_proves_nothing_dates_no_sample():
    """Neither the first, which echoes nothing, nor one that is stale."""
    peer = Peer()
    beat, *parts = peer.run_cycle(0.0)
    peer.arrives(beat, 0.0)
    assert peer.sample(parts, 0.0) is None
    peer.hear(0.1)
    beat, *parts = peer.run_cycle(0.11)
    peer.arrives(beat, 0.1 + TIMEOUT_S + 1e-6)
    assert peer.sample(parts, 0.21) is None


@pytest.mark.parametrize("behind", [0, 1, 3, 9, 11, 100])
def test_a_sample_that_comes_late_is_as_old_as_its_cycle_or_none(behind: int):
    peer = Peer()
    waiting = []
    for turn in range(400):
        now_s = turn * PERIOD_S
        peer.hear(now_s)
        beat, *parts = peer.run_cycle(now_s)
        assert isinstance(peer.arrives(beat, now_s), Accepted)
        waiting.append(parts)
        if turn >= behind:
            sample = peer.sample(waiting[turn - behind], now_s)
            measured_s = None if sample is None else sample.measured_s
            assert measured_s == ((turn - behind) * PERIOD_S if behind <= 9 else None)


def test_a_sample_a_whole_round_of_counters_late_is_nobodys():
    """Its counter is one that has just been used: it is told by its tag, which covers all 32 bits."""
    peer = Peer()
    waiting = []
    for turn in range(300):
        now_s = turn * PERIOD_S
        peer.hear(now_s)
        beat, *parts = peer.run_cycle(now_s)
        peer.arrives(beat, now_s)
        waiting.append(parts)
    outcome = [peer.arrives(part, now_s) for part in waiting[299 - 256]][-1]
    assert isinstance(outcome, Violation)
    assert outcome.cause is StopCause.AUTHENTICATION_FAILED


@pytest.mark.parametrize("first", [0, 1, 100, 254])
@pytest.mark.parametrize(("missing", "found"), [(0, [0, 1]), (1, [1]), (2, [1]), (3, [1]), (4, [1])])
def test_a_runtime_that_opens_later_takes_the_first_sample_whose_heartbeat_it_hears(first, missing, found):
    """In the middle of a cycle perhaps: a sample whose heartbeat came too early is none, nor is one in part."""
    peer = Peer()
    for _ in range(first):
        peer.run_cycle(0.0)
    peer.hear(0.0)
    waiting = [frame for _ in range(2) for frame in peer.run_cycle(0.01)][missing:]
    samples = [peer.arrives(frame, 0.01).sample for frame in waiting]
    assert [(one.counter - first, one.measured_s) for one in samples if one] == [(at, 0.0) for at in found]


@given(
    periods=st.lists(
        st.tuples(st.booleans(), st.floats(0.0, 0.3), st.floats(0.0, 0.05)), min_size=2, max_size=40
    )
)
def test_no_sample_is_called_younger_than_it_is(periods: list[tuple[bool, float, float]]):
    """Heartbeats are lost, joints late, each kind in its own order; the controller measures when it has heard."""
    peer = Peer()
    due: list[tuple[float, int, int, tuple[int, bytes]]] = []
    order = count()
    free_s = {"beat": 0.0, "joints": 0.0}
    measured_s: dict[int, float] = {}
    lost_last = 0
    for turn, (lost, joints_late_s, beat_late_s) in enumerate(periods):
        now_s = turn * PERIOD_S
        peer.hear(now_s)
        beat, *parts = peer.run_cycle(now_s)
        measured_s[turn] = now_s
        lost_last = lost_last + 1 if lost and lost_last < 2 else 0
        free_s["beat"] = max(free_s["beat"], now_s + beat_late_s)
        free_s["joints"] = max(free_s["joints"], now_s + joints_late_s)
        if lost_last == 0:
            due.append((free_s["beat"], next(order), turn, beat))
        due += [(free_s["joints"], next(order), turn, part) for part in parts]
    seen = 0
    for arrives_s, _, turn, frame in sorted(due):
        outcome = peer.arrives(frame, arrives_s)
        assert isinstance(outcome, Accepted)
        if outcome.sample is not None:
            assert seen <= outcome.sample.counter == turn
            assert arrives_s - 2 * TIMEOUT_S - 1e-9 <= outcome.sample.measured_s <= measured_s[turn]
            seen = turn + 1


# ------------------------------------------------------------------ what never left


def test_a_frame_that_never_left_gives_its_counter_to_the_next():
    runtime, controller = pair()
    exchange(runtime, controller, 3)
    runtime.encode(CUT, 0.07)
    runtime.take_back(IDS[RuntimeHeartbeat])
    outcome = deliver(runtime, controller, CUT, 0.08)
    assert (outcome.counter, outcome.lost, outcome.fresh) == (3, 0, True)


def test_the_first_frame_too_gives_its_counter_back_and_so_does_the_last_before_it_rolls_over():
    sender = link(Side.RUNTIME)
    for turn in range(600):
        sender.encode(CUT, 0.0)
        sender.take_back(IDS[RuntimeHeartbeat])
        _, data = sender.encode(CUT, 0.0)
        assert data[2] == turn % 256


@pytest.mark.parametrize("made", [1, 6, 256, 262])
def test_what_is_no_heartbeat_gives_its_counter_back_as_well(made: int):
    sender = link(Side.CONTROLLER)
    for _ in range(made):
        _, last = sender.encode(Progress(1, 0), 0.0)
    sender.take_back(IDS[Progress])
    assert sender.encode(Progress(1, 0), 0.0)[1] == last


def test_taking_back_what_was_never_made_changes_nothing():
    sender = link(Side.CONTROLLER)
    sender.take_back(IDS[Progress])
    _, data = sender.encode(Progress(1, 0), 0.0)
    assert data[2] == 0


@pytest.mark.parametrize("side", Side)
def test_an_echo_of_a_heartbeat_that_never_left_is_nobodys(side: Side):
    """The echo is of one of another session's, or made up."""
    speaker, hearer = link(side), link(side.peer)
    deliver(speaker, hearer, BEATS[side], 0.0)  # counter 0 has left, and is echoed from now on
    other = link(side)
    other.encode(BEATS[side], 0.0)
    other.take_back(IDS[type(BEATS[side])])
    assert violated(deliver(hearer, other, BEATS[side.peer], 0.01))


def test_taking_back_another_frame_leaves_the_heartbeats_their_age():
    """Fault and heartbeat have counters of their own, which may be equal."""
    runtime, controller = pair()
    deliver(controller, runtime, CUTTING, 0.0)
    controller.encode(Progress(1, 0), 0.0)
    controller.take_back(IDS[Progress])
    outcome = deliver(runtime, controller, CUT, 0.01)
    assert outcome.fresh


def test_a_side_is_answered_once_a_heartbeat_that_echoed_the_peer_is_echoed():
    """The first heartbeat of each side echoes nothing: proof to the one is not yet proof to the other."""
    runtime, controller = pair()
    deliver(runtime, controller, CUT, 0.00)  # echoes nothing
    assert deliver(controller, runtime, CUTTING, 0.01).fresh
    assert not runtime.answered, "the controller has heard nothing that is young for sure"
    assert deliver(runtime, controller, CUT, 0.02).fresh
    assert controller.answered, "its own heartbeat echoed one, and is echoed"
    assert not runtime.answered
    assert deliver(controller, runtime, CUTTING, 0.03).fresh
    assert runtime.answered
    assert deliver(controller, runtime, CUTTING, 0.04).fresh
    assert runtime.answered
    runtime.open(CODES, 0.05)
    assert not runtime.answered, "another session begins with nothing"


def test_what_was_sent_in_an_earlier_session_proves_nothing_in_this_one():
    """Counters begin anew with each session; an echo of a later one than any sent is an echo of nothing."""
    runtime, controller = pair()
    now_s = exchange(runtime, controller, 6)
    for one in (runtime, controller):
        one.open(CODES, now_s)
    deliver(runtime, controller, CUT, now_s)  # the only one sent in this session: counter 0
    assert runtime.receive(*tagged(CUTTING, 0, echo=0), now_s=now_s).fresh
    for one in (runtime, controller):
        one.open(CODES, now_s)
    deliver(runtime, controller, CUT, now_s)
    later = runtime.receive(*tagged(CUTTING, 0, echo=3), now_s=now_s)
    assert isinstance(later, Violation)
    assert later.cause is StopCause.AUTHENTICATION_FAILED


def test_what_echoed_in_an_earlier_session_answers_nothing_in_this_one():
    runtime, controller = pair()
    now_s = exchange(runtime, controller, 6)
    for one in (runtime, controller):
        one.open(CODES, now_s)
    for _ in range(3):
        deliver(
            runtime, controller, CUT, now_s
        )  # echoes nothing, as all of a session before the peer is heard
    assert deliver(controller, runtime, CUTTING, now_s).fresh
    assert not runtime.answered


def test_an_echo_that_proves_nothing_answers_nothing():
    runtime, controller = pair()
    deliver(runtime, controller, CUT, 0.00)
    deliver(controller, runtime, CUTTING, 0.01)
    deliver(runtime, controller, CUT, 0.02)
    late = 0.02 + TIMEOUT_S + 0.001
    assert not deliver(controller, runtime, CUTTING, late).fresh
    assert not runtime.answered
