"""What the controller remembers over a loss of power: nothing moves before it is written, and a stop never waits for it."""

import math
from dataclasses import replace

import pytest

from cutgate.config.constants import REGISTRATIONS_MAX
from cutgate.firmware_sim.rules import REGISTRATION_RULES, RequestCase, first_refusal
from cutgate.firmware_sim.state import (
    BoneMoved,
    Controller,
    Effect,
    Event,
    FaultArisen,
    HeartbeatLost,
    JointsMeasured,
    Memory,
    NonceRequested,
    Persist,
    Persisted,
    PersistFailed,
    SendFault,
    StopReceived,
    Tick,
)
from cutgate.firmware_sim.table import step
from cutgate.protocol import records
from cutgate.protocol.states import (
    LATCHING,
    ControllerState,
    FaultCode,
    Purpose,
    Refusal,
    RuntimeCode,
    StopCause,
    StopCode,
)
from tests.firmware_sim.controllers import (
    ACKNOWLEDGED,
    CUTTING,
    CYCLED,
    EVERY_STATE,
    LATCHED,
    NOW,
    OPEN_LATCHED,
    OPENED,
    PLACE,
    POWERED_UP,
    REGISTERED_US,
    REGISTRATION,
    RELEASE,
    RESETTING,
    START_JOINTS,
    START_LOG,
    STARTING,
    STOPPING_EVENTS,
    acknowledging,
    alive,
    events,
    faults,
    fed,
    opening,
    reopening,
    replies,
    withdrawing,
)
from tests.firmware_sim.controllers import LEAVING as LEAVE

OTHER = records.digest(b"another place")
STOPPED = EVERY_STATE["stopped"]

C = ControllerState
LEAVING, LEAVING_EFFECTS = step(RESETTING, replace(LEAVE, sequence=8), NOW)
"""A reset whose cleared latch is on its way to the disk."""
WITNESSING, WITNESSING_EFFECTS = step(CYCLED, replace(STARTING, sequence=7), NOW)
"""A start whose log is on its way to the disk."""
TELLING, TELLING_EFFECTS = step(OPENED, withdrawing(), NOW)
"""A Withdraw on its way to the disk."""
WITNESSED = Memory(log=START_LOG)
MOVED = Memory(withdrawn=frozenset({PLACE}), withdrawal_due=True)
each_state = pytest.mark.parametrize("name", EVERY_STATE)
each_waiting = pytest.mark.parametrize(
    "waiting", [LEAVING, WITNESSING, TELLING], ids=["reset", "start", "withdraw"]
)


def written(effects: tuple[Effect, ...]) -> list[Memory]:
    """What is to be written."""
    return [effect.memory for effect in effects if isinstance(effect, Persist)]


def full(memory: Memory) -> Controller:
    return replace(POWERED_UP, memory=memory, written=memory)


# ---------------------------------------------------------------- opening writes nothing


@pytest.mark.parametrize("known", [Memory(), MOVED, Memory(earlier=frozenset({REGISTRATION}))])
def test_a_session_is_opened_without_a_word_to_the_disk(known):
    opened, effects = step(full(known), opening(), NOW)
    assert opened.state is C.OPEN
    assert (opened.memory, opened.awaiting) == (known, None)
    assert not written(effects)


def test_a_refused_open_is_remembered_by_nothing():
    for request in (opening(protocol_version=1), opening(announce_nonce=bytes(16))):
        for event in (request, replace(request, authentic=False)):
            after, effects = step(POWERED_UP, event, NOW)
            assert after == POWERED_UP
            assert not written(effects)


def test_a_full_memory_opens_for_what_it_knows_and_refuses_one_more():
    filling = frozenset(records.digest(b"%d" % number) for number in range(REGISTRATIONS_MAX - 1))
    almost = Memory(withdrawn=filling)
    moved = fed(full(almost), opening(), BoneMoved(), HeartbeatLost())
    assert len(moved.memory.withdrawn) == REGISTRATIONS_MAX, "the last one still fits"
    after, effects = step(moved, reopening(moved, place_digest=OTHER), NOW)
    assert after == moved, "none is forgotten for it"
    assert replies(effects) == [Refusal.MEMORY_FULL]
    assert fed(moved, reopening(moved)).session is not None


# ---------------------------------------------------------------- the bone moves


@pytest.mark.parametrize("place", [PLACE, OTHER])
def test_bone_motion_lists_one_place_and_the_barrier_keeps_out_the_others(place):
    """Whoever registered before it, under whatever name."""
    opened = fed(POWERED_UP, opening(), BoneMoved(), withdrawing(barrier_us=REGISTERED_US), HeartbeatLost())
    opened = fed(opened, reopening(opened, place_digest=place))
    expected = Refusal.REGISTRATION_WITHDRAWN if place == PLACE else Refusal.REGISTRATION_TOO_EARLY
    assert first_refusal(REGISTRATION_RULES, RequestCase(opened, None, NOW)) is expected


def test_what_was_withdrawn_before_stays_withdrawn():
    state = replace(CUTTING, memory=Memory(frozenset({OTHER}), frozenset({REGISTRATION}), 5))
    after, _ = step(state, BoneMoved(), NOW)
    assert after.memory == Memory(
        frozenset({OTHER, PLACE}), frozenset({REGISTRATION}), 5, withdrawal_due=True
    )


def test_what_is_due_and_what_was_told_is_written_over_a_loss_of_power():
    moved = fed(OPENED, BoneMoved())
    assert moved.written == MOVED
    told = fed(moved, withdrawing(barrier_us=7))
    assert told.written == Memory(frozenset({PLACE}), barrier_us=7, withdrawal_due=True)
    ended = fed(told, HeartbeatLost())
    settled = fed(ended, reopening(ended, place_digest=OTHER), withdrawing(records.NO_PLACE, barrier_us=8))
    assert settled.written == Memory(frozenset({PLACE}), barrier_us=8)


# ---------------------------------------------------------------- a start and its witness


def test_nothing_moves_before_the_start_s_log_is_durable():
    assert (Persist(WITNESSED),) == WITNESSING_EFFECTS, "no answer yet"
    assert (WITNESSING.state, WITNESSING.memory) == (C.PERMITTED, Memory())
    assert not fed(WITNESSING, alive(RuntimeCode.CUT)).may_move

    cutting, effects = step(WITNESSING, Persisted(WITNESSED), NOW + 0.5)

    assert (cutting.state, cutting.started_at_s, cutting.issued) == (C.CUTTING, NOW + 0.5, None)
    assert (cutting.memory, cutting.written, cutting.awaiting) == (WITNESSED, WITNESSED, None)
    assert replies(effects) == [Refusal.ACCEPTED]
    assert effects[0].record.request_sequence == 7
    assert not cutting.may_move


JUDGED_AGAIN = [
    ((), 2.1, Refusal.NONCE_EXPIRED),
    ((), -0.1, Refusal.NONCE_EXPIRED),
    ((), math.nan, Refusal.NONCE_EXPIRED),
    ((NonceRequested(Purpose.START, b"n" * 16),), 0.1, Refusal.NONCE_MISMATCH),
    ((NonceRequested(Purpose.PERMIT, b"n" * 16),), 0.1, Refusal.NO_NONCE),
    ((STARTING,), 0.1, Refusal.NO_NONCE),
    ((RELEASE,), 0.1, Refusal.DEVICE_NOT_RELEASED_AND_PRESSED),
    ((alive(RuntimeCode.READY, fresh=False),), 0.1, Refusal.HEARTBEAT_STALE),
    ((JointsMeasured((0, *START_JOINTS[1:])),), 0.1, Refusal.NOT_AT_START),
]


@pytest.mark.parametrize(("between", "after_s", "refusal"), JUDGED_AGAIN)
def test_a_start_is_judged_again_once_its_log_is_durable(between, after_s, refusal):
    """The disk took its time; what was true when it arrived may be so no more."""
    waiting = WITNESSING
    for event in between:
        waiting, _ = step(waiting, event, NOW + 0.05)
    after, effects = step(waiting, Persisted(WITNESSED), NOW + after_s)
    assert replies(effects) == [refusal]
    assert effects[0].record.request_sequence == 7
    assert (after.state, after.issued, after.awaiting) == (C.PERMITTED, None, None)
    assert after.memory.log == START_LOG, "a holder of the key has said that it stands there"
    assert not fed(after, alive(RuntimeCode.CUT)).may_move


def test_a_permit_that_has_aged_while_the_log_was_written_starts_nothing():
    waiting = replace(WITNESSING, permit_issued_at_s=NOW - 119.95)
    _, effects = step(waiting, Persisted(WITNESSED), NOW + 0.1)
    assert replies(effects) == [Refusal.PERMIT_EXPIRED]


def test_what_changed_unnoticed_while_the_log_was_written_starts_nothing():
    waiting = replace(WITNESSING, holdings=replace(WITNESSING.holdings, tool=b"other"))
    _, effects = step(waiting, Persisted(WITNESSED), NOW)
    assert replies(effects) == [Refusal.TOOL_DIGEST]


def test_a_start_without_a_code_that_fits_writes_nothing():
    _, effects = step(CYCLED, replace(STARTING, authentic=False), NOW)
    assert START_LOG not in [memory.log for memory in written(effects)]


def test_a_second_start_is_refused_while_the_first_waits():
    after, effects = step(WITNESSING, STARTING, NOW)
    assert replies(effects) == [Refusal.NOT_IN_STATE]
    assert after == replace(WITNESSING, issued=None)


def test_a_start_whose_log_cannot_be_written_is_refused():
    after, effects = step(WITNESSING, PersistFailed(), NOW)
    assert replies(effects) == [Refusal.MEMORY_FAILED]
    assert effects[0].record.request_sequence == 7
    assert (after.state, after.issued, after.memory) == (C.PERMITTED, None, Memory())
    assert written(step(after, Tick(), NOW)[1]) == [Memory()], "what the file holds is not known any more"
    late, effects = step(after, Persisted(WITNESSED), NOW)
    assert (late.state, effects) == (C.PERMITTED, ())


# ---------------------------------------------------------------- a Withdraw


def test_a_withdraw_that_cannot_be_written_is_in_force_all_the_same():
    assert written(TELLING_EFFECTS) == [TELLING.memory]
    after, effects = step(TELLING, PersistFailed(), NOW)
    assert replies(effects) == [Refusal.MEMORY_FAILED]
    assert effects[0].record.request_sequence == 5
    assert after.memory == TELLING.memory == Memory(frozenset({PLACE}), barrier_us=REGISTERED_US)
    assert written(step(after, Tick(), NOW)[1]) == [after.memory]


@pytest.mark.parametrize("stopping", STOPPING_EVENTS)
def test_a_stop_in_between_does_not_lose_a_withdraw(stopping):
    stopped = fed(TELLING, STOPPING_EVENTS[stopping][0])
    assert PLACE in stopped.memory.withdrawn
    assert stopped.memory.barrier_us == REGISTERED_US
    after, _ = step(stopped, Persisted(TELLING.memory), NOW)
    assert after.memory == stopped.memory
    due = written(step(after, Tick(), NOW)[1])
    assert due == ([] if stopped.memory == TELLING.memory else [stopped.memory])


@pytest.mark.parametrize("live", [True, False])
def test_what_waits_does_not_outlive_its_session(live):
    waiting = TELLING if live else step(STOPPED, withdrawing(), NOW)[0]
    assert waiting.session.live is live
    ended, _ = step(waiting, HeartbeatLost(), NOW)
    assert (ended.session, ended.awaiting) == (None, None)
    _, effects = step(ended, Persisted(waiting.memory), NOW)
    assert effects == ()


# ---------------------------------------------------------------- a latch


@each_state
@pytest.mark.parametrize("cause", sorted(LATCHING), ids=lambda cause: cause.name)
def test_a_latch_is_written_with_its_first_out_cause_after_its_stop_has_left(name, cause):
    before = EVERY_STATE[name]
    after, effects = step(before, FaultArisen(cause), NOW)
    first = before.memory.latched or before.cause or cause
    assert after.memory.latched is first
    assert effects[0] == SendFault(FaultCode.LATCHED, cause)
    if before.memory.latched is StopCause.NONE:
        assert effects[-1] == Persist(after.memory)
    else:
        assert not written(effects), "it is written already"


@pytest.mark.parametrize("cause", [cause for cause in StopCause if cause is not StopCause.NONE], ids=str)
def test_after_a_loss_of_power_a_latched_fault_still_stands(cause):
    old = POWERED_UP
    state = Controller.powered_up(old.identity, old.holdings, Memory(latched=cause), old.announce_nonce)
    assert (state.state, state.cause, state.cutting_mode) == (C.FAULT, cause, False)
    for event in events(state):
        assert fed(state, event).state is C.FAULT
    opened = fed(state, opening(), alive())
    assert (opened.state, opened.cause) == (C.FAULT, cause)


def test_without_a_latch_power_up_is_inhibited_whatever_is_remembered():
    old = POWERED_UP
    remembered = Memory(frozenset({OTHER}), frozenset({REGISTRATION}), 7, True, START_LOG)
    state = Controller.powered_up(old.identity, old.holdings, remembered, bytes(16))
    assert (state.state, state.cause, state.memory) == (C.INHIBITED, StopCause.NONE, remembered)
    assert not written(step(state, Tick(), NOW)[1])


def test_the_reset_is_answered_once_the_cleared_latch_is_durable():
    unlatched = replace(RESETTING.memory, latched=StopCause.NONE)
    assert (Persist(unlatched),) == LEAVING_EFFECTS, "no answer yet"
    assert (LEAVING.state, LEAVING.memory, LEAVING.issued) == (C.FAULT, RESETTING.memory, None)

    left, effects = step(LEAVING, Persisted(unlatched), NOW)

    assert (left.state, left.memory, left.written, left.awaiting) == (C.OPEN, unlatched, unlatched, None)
    assert replies(effects) == [Refusal.ACCEPTED]
    assert effects[0].record.request_sequence == 8


def test_a_reset_whose_cleared_latch_cannot_be_written_is_refused_and_the_latch_written_again():
    after, effects = step(LEAVING, PersistFailed(), NOW)
    assert replies(effects) == [Refusal.MEMORY_FAILED]
    assert effects[0].record.request_sequence == 8
    assert (after.state, after.memory) == (C.FAULT, RESETTING.memory)
    again, effects = step(after, Tick(), NOW)
    assert written(effects) == [RESETTING.memory]
    assert step(again, PersistFailed(), NOW) == (again, ()), "it is latched already"


@each_waiting
@pytest.mark.parametrize("stopping", STOPPING_EVENTS)
def test_a_stop_in_between_voids_what_waited_and_the_memory_is_put_right(waiting, stopping):
    wanted = waiting.awaiting.memory
    stopped = fed(waiting, STOPPING_EVENTS[stopping][0])
    after, effects = step(stopped, Persisted(wanted), NOW)
    assert (after.state, after.session, effects) == (stopped.state, stopped.session, ())
    assert after.memory == stopped.memory
    assert after.state is C.FAULT or waiting is not LEAVING
    assert after.awaiting is None
    _, effects = step(after, Tick(), NOW)
    assert written(effects) == ([] if after.memory == wanted else [after.memory])


@pytest.mark.parametrize(
    "ending",
    [
        StopReceived(StopCode.END, StopCause.SESSION_ENDED),
        HeartbeatLost(),
        FaultArisen(StopCause.BUS_FAILED),
    ],
    ids=["end", "heartbeat", "fault"],
)
def test_the_acknowledgement_of_a_latched_fault_ends_with_its_session(ending: Event):
    assert ACKNOWLEDGED.cause is StopCause.NONE
    assert fed(ACKNOWLEDGED, ending).cause is StopCause.SECOND_NODE


def test_the_first_out_cause_of_a_fault_that_latches_later_is_the_one_remembered_and_reset():
    state = fed(CUTTING, FaultArisen(StopCause.DEVICE_RELEASED), FaultArisen(StopCause.SECOND_NODE))
    assert state.memory.latched is StopCause.DEVICE_RELEASED
    ended = fed(state, HeartbeatLost())
    held = fed(ended, reopening(ended), alive())
    second, first = (
        acknowledging(cause, held.epoch) for cause in (StopCause.SECOND_NODE, StopCause.DEVICE_RELEASED)
    )
    assert replies(step(held, second, NOW)[1]) == [Refusal.WRONG_CAUSE]
    assert fed(held, first).cause is StopCause.NONE


# ---------------------------------------------------------------- a memory that fails


@each_state
def test_a_memory_that_cannot_be_written_latches_once_and_is_written_again_until_it_is(name):
    stopped, effects = step(EVERY_STATE[name], FaultArisen(StopCause.SECOND_NODE), NOW)
    (before,) = written(effects) or [stopped.memory]
    state, effects = step(replace(stopped, written=None), PersistFailed(), NOW)
    assert (state.state, faults(effects)) == (C.FAULT, []), "it is latched already"
    for _ in range(3):
        state, effects = step(state, Tick(), NOW)
        assert written(effects) == [before]
        state, effects = step(state, PersistFailed(), NOW)
        assert effects == ()
    state, _ = step(state, Persisted(before), NOW)
    assert not written(step(state, Tick(), NOW)[1])


def test_a_withdrawal_that_cannot_be_written_latches():
    stopped, _ = step(CUTTING, BoneMoved(), NOW)
    assert stopped.state is C.INHIBITED
    after, effects = step(stopped, PersistFailed(), NOW)
    assert (after.state, after.cause) == (C.FAULT, StopCause.BONE_MOVED)
    assert faults(effects) == [SendFault(FaultCode.LATCHED, StopCause.INTERNAL_ERROR)]
    assert written(effects) == [
        Memory(frozenset({PLACE}), withdrawal_due=True, log=START_LOG, latched=StopCause.BONE_MOVED)
    ]


@each_state
def test_in_every_state_what_is_not_written_yet_is_written_in_the_next_turn(name):
    state = replace(EVERY_STATE[name], written=None)
    assert written(step(state, Tick(), NOW)[1]) == [state.memory]
    assert not written(step(EVERY_STATE[name], Tick(), NOW)[1])


def test_a_held_fault_opens_a_session_and_is_left_by_none_while_the_memory_fails():
    ended = fed(OPEN_LATCHED, HeartbeatLost())
    assert ended.memory.latched is LATCHED.cause
    opened = fed(replace(ended, written=None), reopening(ended))
    after, _ = step(opened, PersistFailed(), NOW)
    assert (after.session, after.state) == (opened.session, C.FAULT)
