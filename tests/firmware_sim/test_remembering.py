"""What the controller remembers over a loss of power: nothing opens before it is written, and a stop never waits for it."""

from dataclasses import replace

import pytest

from cutgate.config.constants import REGISTRATIONS_MAX
from cutgate.firmware_sim.state import (
    AcknowledgeReceived,
    BoneMoved,
    Controller,
    Effect,
    Event,
    FaultArisen,
    HeartbeatLost,
    Memory,
    OpenReceived,
    Persist,
    Persisted,
    PersistFailed,
    ResetReceived,
    Send,
    SendFault,
    StopReceived,
    Tick,
)
from cutgate.firmware_sim.table import step
from cutgate.protocol import records
from cutgate.protocol.states import LATCHING, ControllerState, FaultCode, Refusal, StopCause, StopCode
from tests.firmware_sim.controllers import (
    ACKNOWLEDGED,
    CUTTING,
    EVERY_STATE,
    LATCHED,
    NOW,
    OPEN,
    OPEN_LATCHED,
    POWERED_UP,
    REGISTRATION,
    RESETTING,
    SIGNED_RESET,
    STOPPING_EVENTS,
    alive,
    events,
    faults,
    fed,
    replies,
    settled,
)

C = ControllerState
OTHER = records.digest(b"somebody else's registration")
OPEN_OTHER = replace(OPEN, registration_digest=OTHER, runtime_nonce=b"o" * 16)
OPENING, OPENING_EFFECTS = step(POWERED_UP, OpenReceived(OPEN, 7), NOW)
"""An OPEN whose name is on its way to the disk."""
LEAVING, LEAVING_EFFECTS = step(RESETTING, ResetReceived(SIGNED_RESET, 8), NOW)
"""A reset whose cleared latch is on its way to the disk."""
NAMED = Memory(named=frozenset({REGISTRATION}))
each_state = pytest.mark.parametrize("name", EVERY_STATE)


def written(effects: tuple[Effect, ...]) -> list[Memory]:
    """What is to be written."""
    return [effect.memory for effect in effects if isinstance(effect, Persist)]


def full(memory: Memory) -> Controller:
    return replace(POWERED_UP, memory=memory, written=memory)


# ---------------------------------------------------------------- a name before its session


def test_no_session_is_opened_before_the_name_of_its_registration_is_durable():
    assert (Persist(NAMED),) == OPENING_EFFECTS, "no answer yet"
    assert (OPENING.session, OPENING.state, OPENING.memory) == (None, C.INHIBITED, Memory())

    opened, effects = step(OPENING, Persisted(NAMED), NOW)

    assert opened.state is C.OPEN
    assert (opened.memory, opened.written, opened.awaiting) == (NAMED, NAMED, None)
    assert isinstance(effects[-1], Send)
    assert isinstance(effects[-1].record, records.Opened)
    assert not written(effects)


@pytest.mark.parametrize("known", [NAMED, Memory(withdrawn=frozenset({REGISTRATION}))])
def test_a_name_that_is_known_is_not_written_again(known):
    opened, effects = step(full(known), OpenReceived(OPEN, 7), NOW)
    assert opened.state is C.OPEN
    assert opened.memory == known
    assert not written(effects)


def test_while_a_name_is_being_written_no_other_session_is_opened():
    after, effects = step(OPENING, OpenReceived(OPEN_OTHER, 8), NOW)
    assert after == OPENING
    assert replies(effects) == [Refusal.SESSION_IN_USE]


def test_an_open_whose_name_cannot_be_written_is_refused():
    after, effects = step(OPENING, PersistFailed(), NOW)
    (send,) = effects
    assert (send.session, send.record.refusal) == (0, Refusal.MEMORY_FAILED)
    assert (send.record.request_type, send.record.request_sequence) == (records.Open.TYPE, 7)
    assert (after.session, after.state, after.memory) == (None, C.INHIBITED, Memory())
    assert written(step(after, Tick(), NOW)[1]) == [Memory()], "what the file holds is not known any more"


def test_a_refused_open_names_nothing():
    for request in (replace(OPEN, protocol_version=1), replace(OPEN, boot_nonce=bytes(16))):
        after, effects = step(POWERED_UP, OpenReceived(request, 1), NOW)
        assert after == POWERED_UP
        assert not written(effects)


def test_a_full_memory_opens_for_what_it_knows_and_refuses_one_more():
    filling = frozenset(records.digest(b"%d" % number) for number in range(REGISTRATIONS_MAX - 1))
    for almost in (Memory(named=filling), Memory(withdrawn=filling)):
        opened, _ = settled(full(almost), OpenReceived(OPEN, 1), NOW)
        assert opened.state is C.OPEN, "the last one still fits"
        ended = fed(opened, StopReceived(StopCode.END, StopCause.SESSION_ENDED))
        after, effects = step(ended, OpenReceived(OPEN_OTHER, 2), NOW)
        assert after == ended, "none is forgotten for it"
        assert replies(effects) == [Refusal.MEMORY_FULL]
        again = replace(OPEN, runtime_nonce=b"R" * 16)
        assert fed(ended, OpenReceived(again, 3)).state is C.OPEN


# ---------------------------------------------------------------- the bone moves


def test_bone_motion_withdraws_every_registration_that_was_named_not_only_the_last():
    """Somebody without the key opens in between: the operator's registration is withdrawn all the same."""
    state = fed(
        POWERED_UP,
        OpenReceived(OPEN, 1),
        StopReceived(StopCode.END, StopCause.SESSION_ENDED),
        OpenReceived(OPEN_OTHER, 2),
        HeartbeatLost(),
    )
    assert state.memory.named == {REGISTRATION, OTHER}
    after, effects = step(state, BoneMoved(), NOW)
    assert after.memory == Memory(withdrawn=frozenset({REGISTRATION, OTHER}))
    assert written(effects) == [after.memory]


@pytest.mark.parametrize("cause", [StopCause.REGISTRATION_WITHDRAWN, StopCause.BONE_MOVED])
def test_a_withdrawal_withdraws_what_was_named_before_as_well(cause):
    state = replace(CUTTING, memory=Memory(named=frozenset({REGISTRATION, OTHER})))
    after, _ = step(state, StopReceived(StopCode.STOP, cause), NOW)
    assert after.memory == Memory(withdrawn=frozenset({REGISTRATION, OTHER}))


def test_a_name_given_after_the_bone_moved_is_a_new_one():
    after = fed(fed(CUTTING, BoneMoved(), HeartbeatLost()), OpenReceived(OPEN_OTHER, 1))
    assert after.memory == Memory(named=frozenset({OTHER}), withdrawn=frozenset({REGISTRATION}))


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
    state = Controller.powered_up(old.identity, old.holdings, Memory(latched=cause))
    assert (state.state, state.cause, state.cutting_mode) == (C.FAULT, cause, False)
    for event in events(state):
        assert fed(state, event).state is C.FAULT
    opened = fed(state, OpenReceived(OPEN, 1), alive())
    assert (opened.state, opened.cause) == (C.FAULT, cause)


def test_without_a_latch_power_up_is_inhibited_whatever_is_remembered():
    old, remembered = POWERED_UP, Memory(named=frozenset({OTHER}), withdrawn=frozenset({REGISTRATION}))
    state = Controller.powered_up(old.identity, old.holdings, remembered)
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


@pytest.mark.parametrize("waiting", [OPENING, LEAVING], ids=["open", "reset"])
@pytest.mark.parametrize("stopping", STOPPING_EVENTS)
def test_a_stop_in_between_voids_what_waited_and_the_memory_is_put_right(waiting, stopping):
    wanted = waiting.awaiting.memory
    stopped = fed(waiting, STOPPING_EVENTS[stopping][0])
    after, effects = step(stopped, Persisted(wanted), NOW)
    assert (after.state, after.session, effects) == (stopped.state, stopped.session, ())
    assert after.memory == stopped.memory
    assert after.state is C.FAULT or waiting is OPENING
    _, effects = step(after, Tick(), NOW)
    assert written(effects) == [after.memory]


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
    held = fed(state, HeartbeatLost(), OpenReceived(replace(OPEN, runtime_nonce=b"R" * 16), 1), alive())
    assert replies(step(held, AcknowledgeReceived(StopCause.SECOND_NODE, 2), NOW)[1]) == [Refusal.WRONG_CAUSE]
    assert fed(held, AcknowledgeReceived(StopCause.DEVICE_RELEASED, 2)).cause is StopCause.NONE


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
    assert written(effects) == [Memory(withdrawn=frozenset({REGISTRATION}), latched=StopCause.BONE_MOVED)]


@each_state
def test_in_every_state_what_is_not_written_yet_is_written_in_the_next_turn(name):
    state = replace(EVERY_STATE[name], written=None)
    assert written(step(state, Tick(), NOW)[1]) == [state.memory]
    assert not written(step(EVERY_STATE[name], Tick(), NOW)[1])


def test_a_held_fault_opens_no_session_under_a_new_name_while_the_memory_fails():
    ended = fed(OPEN_LATCHED, HeartbeatLost())
    assert ended.memory.latched is LATCHED.cause
    opening, _ = step(ended, OpenReceived(OPEN_OTHER, 1), NOW)
    after, effects = step(opening, PersistFailed(), NOW)
    assert (after.session, replies(effects)) == (None, [Refusal.MEMORY_FAILED])
