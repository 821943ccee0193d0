"""The simulated controller's table: what enables, what stops, and what a stop leaves behind."""

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cutgate.config.constants import CONSTANTS
from cutgate.firmware_sim.state import (
    AbortTransfers,
    AcknowledgeReceived,
    BoneMoved,
    CloseLink,
    CollectReceived,
    Controller,
    DeviceCycle,
    Event,
    FaultArisen,
    HeartbeatLost,
    HeartbeatReceived,
    Inputs,
    InputsChanged,
    JointsMeasured,
    LimitsChanged,
    Memory,
    NonceRequested,
    OpenLink,
    OpenReceived,
    PathChecked,
    PathFinished,
    PermitReceived,
    Persist,
    Persisted,
    ResetReceived,
    Send,
    SendFault,
    StartReceived,
    StopReceived,
    Tick,
)
from cutgate.firmware_sim.table import EVERYWHERE, TABLE, step
from cutgate.protocol import records
from cutgate.protocol.states import (
    EPOCHS,
    LATCHING,
    WITHDRAWING,
    ControllerState,
    FaultCode,
    Purpose,
    Refusal,
    RuntimeCode,
    StopCause,
    StopCode,
)
from tests.altering import altered
from tests.firmware_sim.controllers import (
    ACCEPTED_PATH,
    ACKNOWLEDGED,
    ASKED,
    ASKING,
    CALIBRATION,
    CUTTING,
    CYCLED,
    DONE,
    EMERGENCY_STOP,
    ENDS,
    EVERY_STATE,
    HOLD,
    LATCHED,
    LEAVING,
    LIMITS,
    LOADED,
    NEXT_NONCE,
    NOW,
    OPEN,
    OPEN_LATCHED,
    OPENED,
    OTHER_LIMITS,
    OWN_RESET,
    PATH,
    PERMIT,
    PERMITTED,
    PLACE,
    POWERED_UP,
    REGISTERED_US,
    REGISTRATION,
    RELEASE,
    RESET,
    RESETTING,
    SESSION,
    STANDING,
    START,
    START_JOINTS,
    START_LOG,
    STARTED,
    STARTING,
    STOPPING_EVENTS,
    TAG,
    TOOL,
    acknowledging,
    alive,
    events,
    faults,
    fed,
    is_void,
    opening,
    reopening,
    replies,
    settled,
    withdrawing,
)

C = ControllerState
each_state = pytest.mark.parametrize("name", EVERY_STATE)


# ---------------------------------------------------------------- stopping


@each_state
@pytest.mark.parametrize("stopping", STOPPING_EVENTS)
def test_every_stop_from_every_state_voids_everything(name, stopping):
    state = EVERY_STATE[name]
    event, cause = STOPPING_EVENTS[stopping]

    after, effects = step(state, event, NOW)

    latched = state.state is C.FAULT or cause in LATCHING
    assert after.state is (C.FAULT if latched else C.INHIBITED)
    assert is_void(after)
    assert after.epoch == state.epoch + 1
    assert after.device is DeviceCycle.UNSEEN
    first = state.memory.latched if state.state is C.FAULT else state.cause
    assert after.cause is (first if first is not StopCause.NONE else cause), "first-out"
    assert effects[0] == SendFault(FaultCode.LATCHED if latched else FaultCode.STOPPED, cause)
    live = state.session is not None and state.session.live
    assert (AbortTransfers() in effects) is live, "a reply to a session that has stopped already still leaves"


@each_state
@pytest.mark.parametrize("stopping", STOPPING_EVENTS)
def test_what_was_overtaken_by_a_stop_is_dead_on_arrival(name, stopping):
    stopped = fed(EVERY_STATE[name], STOPPING_EVENTS[stopping][0])
    for event in events(stopped):
        if not isinstance(event, PermitReceived | StartReceived | ResetReceived | NonceRequested):
            continue
        after, effects = step(stopped, event, NOW)
        if isinstance(event, NonceRequested):
            assert (after, effects) == (stopped, ()), "no nonce from a dead session"
            continue
        assert replies(effects)[0] in (Refusal.VOIDED_BY_STOP, Refusal.MAC_INVALID)
        assert is_void(after)


@pytest.mark.parametrize(
    ("before", "arriving"),
    [
        (ASKED, ASKING),
        (CYCLED, STARTING),
        (RESETTING, LEAVING),
    ],
    ids=["permit", "start", "reset"],
)
def test_a_request_that_would_pass_is_void_after_a_stop(before, arriving):
    assert replies(settled(before, arriving, NOW)[1]) == [Refusal.ACCEPTED]
    stopped = fed(before, StopReceived(StopCode.STOP, StopCause.OPERATOR_STOP))
    after, effects = step(stopped, arriving, NOW)
    assert replies(effects) == [Refusal.VOIDED_BY_STOP]
    assert is_void(after)


def test_a_permit_of_the_session_before_the_stop_does_not_serve_the_next():
    stopped = fed(ASKED, StopReceived(StopCode.STOP, StopCause.OPERATOR_STOP), HeartbeatLost())
    state = fed(
        stopped,
        reopening(stopped),
        alive(epoch=3),
        acknowledging(StopCause.OPERATOR_STOP, 3),
        ACCEPTED_PATH,
        STANDING,
        NonceRequested(Purpose.PERMIT, PERMIT.nonce),
    )
    assert state.state is C.LOADED
    _, effects = step(state, ASKING, NOW)
    assert replies(effects) == [Refusal.WRONG_SESSION]


@pytest.mark.parametrize("cause", [cause for cause in StopCause if cause is not StopCause.NONE], ids=str)
def test_only_latching_causes_latch(cause):
    after, (sent, *_) = step(CUTTING, FaultArisen(cause), NOW)
    assert after.state is (C.FAULT if cause in LATCHING else C.INHIBITED)
    assert sent.code is (FaultCode.LATCHED if cause in LATCHING else FaultCode.STOPPED)


def test_the_first_cause_is_kept_until_it_is_acknowledged():
    state = fed(CUTTING, RELEASE, FaultArisen(StopCause.SECOND_NODE), BoneMoved())
    assert state.cause is StopCause.DEVICE_RELEASED
    assert state.state is C.FAULT


def test_the_epoch_wraps_at_five_bits():
    assert EPOCHS == 32
    assert fed(replace(CUTTING, epoch=30), FaultArisen(StopCause.BUS_FAILED)).epoch == 31
    assert fed(replace(CUTTING, epoch=31), FaultArisen(StopCause.BUS_FAILED)).epoch == 0


@each_state
def test_the_end_of_a_session_ends_it_and_is_a_stop_while_cutting(name):
    state = EVERY_STATE[name]
    after, effects = step(state, StopReceived(StopCode.END, StopCause.SESSION_ENDED), NOW)
    assert is_void(after)
    assert after.epoch == state.epoch + 1
    if state.state is C.CUTTING:
        assert (after.state, after.cause) == (C.INHIBITED, StopCause.SESSION_ENDED)
        assert faults(effects)
    else:
        assert after.state is (C.FAULT if state.state is C.FAULT else C.INHIBITED)
        stands = state.memory.latched if state.state is C.FAULT else state.cause
        assert (after.cause, after.session, after.heartbeat_fresh) == (stands, None, False)
        assert effects == (AbortTransfers(), CloseLink())


# ---------------------------------------------------------------- the lost peer


@each_state
def test_a_lost_heartbeat_stops_and_frees_the_controller_for_another_session(name):
    state = EVERY_STATE[name]
    after, effects = step(state, HeartbeatLost(), NOW)
    if state.session is None:
        assert (after, effects) == (state, ())
        return
    assert (after.session, after.heartbeat_fresh) == (None, False)
    assert is_void(after)
    assert CloseLink() in effects
    if state.session.live:
        assert after.epoch == state.epoch + 1
        assert faults(effects)
        assert after.cause is (state.memory.latched or state.cause or StopCause.HEARTBEAT_LOST)
    else:
        assert (after.cause, after.epoch, effects) == (state.cause, state.epoch, (CloseLink(),))
    assert fed(after, reopening(after)).session is not None


# ---------------------------------------------------------------- the wired inputs


def test_the_device_is_seen_released_and_then_pressed_after_the_permit():
    held_throughout = fed(ASKED, HOLD, ASKING)
    assert held_throughout.device is DeviceCycle.UNSEEN
    assert fed(held_throughout, HOLD).device is DeviceCycle.UNSEEN
    released = fed(held_throughout, RELEASE)
    assert released.device is DeviceCycle.RELEASED
    assert fed(released, HOLD).device is DeviceCycle.PRESSED
    assert fed(released, HOLD, RELEASE).device is DeviceCycle.RELEASED
    assert fed(ASKED, ASKING).device is DeviceCycle.RELEASED


def test_a_cycle_before_the_permit_does_not_count():
    state = fed(ASKED, HOLD, RELEASE, HOLD, ASKING)
    assert state.device is DeviceCycle.UNSEEN


@pytest.mark.parametrize("cutting", [STARTED, CUTTING], ids=["started", "cutting"])
def test_a_released_device_stops_the_cut(cutting):
    after, effects = step(cutting, RELEASE, NOW)
    assert (after.state, after.cause) == (C.INHIBITED, StopCause.DEVICE_RELEASED)
    assert faults(effects)


@each_state
def test_a_released_device_stops_nothing_else(name):
    state = EVERY_STATE[name]
    if state.state is C.CUTTING:
        return
    after, effects = step(state, RELEASE, NOW)
    assert (after.state, after.cause, effects) == (state.state, state.cause, ())


def test_the_emergency_stop_stops_once_when_pressed_and_not_when_released():
    pressed, effects = step(CUTTING, EMERGENCY_STOP, NOW)
    assert pressed.cause is StopCause.EMERGENCY_STOP
    assert faults(effects)
    same, effects = step(pressed, EMERGENCY_STOP, NOW)
    assert (same.epoch, effects) == (pressed.epoch, ())
    _, effects = step(pressed, HOLD, NOW)
    assert effects == ()


def test_emergency_stop_and_device_at_once_name_the_emergency_stop():
    both = InputsChanged(Inputs(device_pressed=False, emergency_stop_clear=False))
    assert fed(CUTTING, both).cause is StopCause.EMERGENCY_STOP


# ---------------------------------------------------------------- withdrawn registrations

WITHDRAWALS: dict[str, Event] = {
    "bone motion": BoneMoved(),
    "heartbeat of a withdrawal": alive(cause=StopCause.REGISTRATION_WITHDRAWN),
    "heartbeat of bone motion": alive(cause=StopCause.BONE_MOVED),
}
"""The wired input, and what only a holder of the key can say."""
CLAIMS: dict[str, Event] = {
    f"{code.name} frame of {cause.name}": StopReceived(code, cause)
    for code in StopCode
    for cause in WITHDRAWING
} | {f"fault of {cause.name}": FaultArisen(cause) for cause in WITHDRAWING}
"""What may be anybody's."""
MOVED = Memory(withdrawn=frozenset({PLACE}), withdrawal_due=True)


@pytest.mark.parametrize("state", [OPENED, LOADED, PERMITTED, CUTTING, DONE], ids=lambda s: s.state.name)
@pytest.mark.parametrize("withdrawal", WITHDRAWALS)
def test_a_withdrawal_lists_the_place_by_whatever_way_it_comes(state, withdrawal):
    after, effects = step(state, WITHDRAWALS[withdrawal], NOW + 7)
    assert after.memory == replace(state.memory, withdrawn=frozenset({PLACE}), withdrawal_due=True)
    assert after.moved_at_s == NOW + 7
    assert isinstance(effects[0], SendFault)
    assert effects[-1] == Persist(after.memory), "the stop leaves before the memory is written"
    assert is_void(after)
    assert after.cause in WITHDRAWING


@pytest.mark.parametrize("claim", CLAIMS)
@each_state
def test_a_claimed_withdrawal_stops_and_withdraws_nothing(name, claim):
    state = EVERY_STATE[name]
    after, effects = step(state, CLAIMS[claim], NOW)
    assert faults(effects)
    assert is_void(after)
    assert after.memory == state.memory
    assert after.moved_at_s is None
    assert after.session is None or not after.session.withdrawn


@pytest.mark.parametrize("cause", sorted(WITHDRAWING), ids=lambda cause: cause.name)
def test_a_heartbeat_withdraws_also_after_the_stop_that_came_first_and_only_once(cause):
    stopped = fed(CUTTING, StopReceived(StopCode.STOP, cause))
    assert not stopped.memory.withdrawal_due
    beat = alive(epoch=stopped.epoch, cause=cause)
    after, effects = settled(stopped, beat, NOW + 1)
    assert after.memory == replace(stopped.memory, withdrawn=frozenset({PLACE}), withdrawal_due=True)
    assert (after.moved_at_s, after.epoch, faults(effects)) == (NOW + 1, stopped.epoch, []), "no second stop"

    told = fed(after, withdrawing())
    again, effects = step(told, beat, NOW + 2)
    assert (again, effects) == (told, ()), "the level that stays is no news"


def test_a_withdraw_that_overtakes_the_heartbeats_of_its_stop_is_not_undone_by_them():
    stopped = fed(CUTTING, StopReceived(StopCode.STOP, StopCause.BONE_MOVED), withdrawing(barrier_us=17))
    after = fed(stopped, alive(epoch=stopped.epoch, cause=StopCause.BONE_MOVED))
    wanted = Memory(frozenset({PLACE}), barrier_us=17, withdrawal_due=True, log=CUTTING.memory.log)
    assert after.memory == wanted


def test_a_withdraw_of_before_that_is_held_back_hides_no_withdrawal_of_its_runtime():
    """It names no place, for it was said when the session was opened; it arrives behind the stop of a withdrawal."""
    stopped = fed(
        CUTTING, StopReceived(StopCode.STOP, StopCause.PROTOCOL_VIOLATION), withdrawing(records.NO_PLACE)
    )
    after = fed(stopped, alive(epoch=stopped.epoch, cause=StopCause.REGISTRATION_WITHDRAWN))
    assert (after.memory.withdrawn, after.memory.withdrawal_due) == ({PLACE}, True)


def test_a_withdraw_in_a_live_session_does_not_hide_a_bone_that_moves_afterwards():
    told = fed(OPENED, withdrawing(records.NO_PLACE))
    stopped = fed(told, StopReceived(StopCode.STOP, StopCause.BONE_MOVED))
    after = fed(stopped, alive(epoch=stopped.epoch, cause=StopCause.BONE_MOVED))
    assert after.memory.withdrawn == {PLACE}
    assert after.memory.withdrawal_due


def test_what_the_runtime_says_of_a_motion_that_the_wired_input_reported_is_no_news():
    """It learned of it from here; how long ago it was stays what it is."""
    moved = fed(CUTTING, BoneMoved())
    after = fed(moved, alive(epoch=moved.epoch, cause=StopCause.BONE_MOVED), now_s=NOW + 5)
    assert after == moved
    assert after.moved_at_s == NOW


def test_a_withdraw_settles_what_happened_before_its_session_alone():
    """One that was held back since the session was opened does not know of a motion in it."""
    moved = fed(fed(POWERED_UP, BoneMoved()), opening(), BoneMoved(), now_s=NOW + 60)
    held_back = fed(moved, withdrawing(records.NO_PLACE, 17), now_s=NOW + 61)
    wanted = Memory(frozenset({PLACE}), barrier_us=17, withdrawal_due=True)
    assert (held_back.memory, held_back.moved_at_s) == (wanted, NOW + 60)
    ended = fed(held_back, HeartbeatLost())
    (opened,) = [e.record for e in step(ended, reopening(ended), NOW + 99)[1] if isinstance(e, Send)]
    assert (opened.withdrawal_due, opened.motion_age_s) == (1, 39)
    told = fed(ended, reopening(ended), withdrawing(records.NO_PLACE, 18))
    assert (told.memory.withdrawal_due, told.moved_at_s) == (False, None)
    after = fed(told, BoneMoved(), now_s=NOW + 99)
    assert (after.memory.withdrawal_due, after.moved_at_s) == (True, NOW + 99), "due again"


@pytest.mark.parametrize(
    "news",
    [BoneMoved(), alive(epoch=EVERY_STATE["stopped"].epoch, cause=StopCause.BONE_MOVED)],
    ids=["wired", "heartbeat"],
)
def test_a_motion_while_a_withdraw_is_written_is_not_forgotten_when_that_is_durable(news):
    waiting, (persist,) = step(EVERY_STATE["stopped"], withdrawing(records.NO_PLACE, 17), NOW)
    moved, _ = step(waiting, news, NOW + 1)
    wanted = replace(persist.memory, withdrawn=frozenset({PLACE}), withdrawal_due=True)
    assert moved.memory == wanted
    after, _ = step(moved, Persisted(persist.memory), NOW + 1)
    assert (after.memory, after.written) == (wanted, persist.memory)
    assert Persist(wanted) in step(after, Tick(), NOW + 2)[1], "written next"


@pytest.mark.parametrize(("barrier_us", "due"), [(-1, True), (records.NO_TIME, True), (1, False)])
def test_a_withdraw_that_tells_no_time_settles_nothing(barrier_us, due):
    after = fed(POWERED_UP, BoneMoved(), opening(), withdrawing(records.NO_PLACE, barrier_us))
    assert after.memory.withdrawal_due is due


def test_other_causes_in_a_heartbeat_withdraw_nothing():
    for cause in set(StopCause) - WITHDRAWING:
        assert fed(CUTTING, alive(cause=cause)).memory.withdrawn == frozenset()


@pytest.mark.parametrize("cause", sorted(WITHDRAWING), ids=lambda cause: cause.name)
def test_a_heartbeat_without_a_session_withdraws_nothing(cause):
    assert not fed(POWERED_UP, alive(cause=cause)).memory.withdrawal_due


def test_bone_motion_after_the_session_is_due_and_names_no_place():
    ended = fed(DONE, StopReceived(StopCode.END, StopCause.SESSION_ENDED))
    after, effects = step(ended, BoneMoved(), NOW)
    assert after.memory == replace(ended.memory, withdrawal_due=True)
    assert effects[-1] == Persist(after.memory)


def test_bone_motion_before_any_session_stops_and_is_due():
    after, effects = step(POWERED_UP, BoneMoved(), NOW)
    assert (after.cause, after.memory) == (StopCause.BONE_MOVED, Memory(withdrawal_due=True))
    assert effects[-1] == Persist(after.memory)


def _permit_answer(state: Controller, **changes):
    """How a permit is answered in a session that this controller opens."""
    asked = fed(
        state,
        opening(**changes),
        alive(),
        ACCEPTED_PATH,
        STANDING,
        NonceRequested(Purpose.PERMIT, PERMIT.nonce),
    )
    named = replace(
        PERMIT,
        session_digest=asked.session.digest,
        registration_digest=asked.session.registration,
    )
    after, effects = step(asked, PermitReceived(named, 4, authentic=True), NOW)
    return after, replies(effects)[0]


def _remembering(memory: Memory) -> Controller:
    return replace(POWERED_UP, memory=memory, written=memory)


def test_the_list_grows_and_only_another_place_is_permitted():
    state = _remembering(Memory(withdrawn=frozenset({PLACE})))
    _, refusal = _permit_answer(state)
    assert refusal is Refusal.REGISTRATION_WITHDRAWN
    again = {"registration_digest": records.digest(b"the same place again"), "registration_time_us": 1 << 60}
    _, refusal = _permit_answer(state, **again)
    assert refusal is Refusal.REGISTRATION_WITHDRAWN, "another id or time does not bring it back"

    other = records.digest(b"another place")
    after, refusal = _permit_answer(state, place_digest=other)
    assert refusal is Refusal.ACCEPTED
    assert fed(after, BoneMoved()).memory.withdrawn == {PLACE, other}


def test_a_registration_that_was_withdrawn_before_places_were_remembered_stays_withdrawn():
    state = _remembering(Memory(earlier=frozenset({REGISTRATION})))
    assert _permit_answer(state)[1] is Refusal.REGISTRATION_WITHDRAWN
    other = records.digest(b"another registration")
    assert _permit_answer(state, registration_digest=other)[1] is Refusal.ACCEPTED


def test_nothing_is_permitted_before_a_withdraw_tells_the_barrier():
    assert _permit_answer(_remembering(Memory(withdrawal_due=True)))[1] is Refusal.WITHDRAWAL_DUE


def test_other_stops_withdraw_nothing():
    for cause in StopCause:
        after = fed(CUTTING, FaultArisen(cause))
        assert after.memory.withdrawn == frozenset()
        assert not after.memory.withdrawal_due


# ---------------------------------------------------------------- Withdraw

STOPPED = EVERY_STATE["stopped"]
WITHDRAWN = [OPENED, LOADED, DONE, STOPPED, OPEN_LATCHED]


@pytest.mark.parametrize("state", WITHDRAWN, ids=lambda s: s.state.name)
@pytest.mark.parametrize(
    ("place", "listed"), [(PLACE, {PLACE}), (records.NO_PLACE, set())], ids=["its place", "no place"]
)
def test_a_withdraw_is_in_force_at_once_and_answered_once_it_is_durable(state, place, listed):
    due = replace(state, memory=replace(state.memory, withdrawal_due=True), moved_at_s=NOW - 9)
    after, effects = step(due, withdrawing(place, 17), NOW)
    wanted = replace(state.memory, withdrawn=frozenset(listed), barrier_us=17)
    assert after.memory == wanted
    assert (after.moved_at_s, after.state, after.cause) == (None, state.state, state.cause)
    assert effects == (Persist(wanted),), "no answer yet"

    told, effects = step(after, Persisted(wanted), NOW)
    (send,) = effects
    assert (send.record.request_type, send.record.request_sequence) == (records.Withdraw.TYPE, 5)
    assert (send.session, send.record.refusal) == (TAG, Refusal.ACCEPTED)
    assert (told.memory, told.written, told.awaiting) == (wanted, wanted, None)


@pytest.mark.parametrize(
    "state", [PERMITTED, CYCLED, STARTED, CUTTING], ids=["permitted", "cycled", "started", "cutting"]
)
def test_what_was_permitted_before_a_withdraw_does_not_go_on(state):
    after, effects = settled(state, withdrawing(records.NO_PLACE, 17), NOW)
    assert (after.state, after.cause) == (C.INHIBITED, StopCause.REGISTRATION_WITHDRAWN)
    assert is_void(after)
    assert effects[0] == SendFault(FaultCode.STOPPED, StopCause.REGISTRATION_WITHDRAWN)
    assert replies(effects) == [Refusal.ACCEPTED]
    assert (after.memory.barrier_us, after.memory.withdrawn) == (17, frozenset())


def test_the_barrier_is_never_lowered():
    after = fed(OPENED, withdrawing(barrier_us=17), withdrawing(barrier_us=16))
    assert after.memory.barrier_us == 17
    assert fed(after, withdrawing(barrier_us=18)).memory.barrier_us == 18


def test_a_withdraw_that_changes_nothing_is_answered_at_once():
    told = fed(OPENED, withdrawing(barrier_us=17))
    after, effects = step(told, withdrawing(barrier_us=17), NOW)
    assert replies(effects) == [Refusal.ACCEPTED]
    assert (after.memory, after.awaiting) == (told.memory, None)
    assert not any(isinstance(effect, Persist) for effect in effects)


def test_a_withdraw_that_is_not_written_yet_is_answered_when_it_is():
    unwritten = replace(fed(OPENED, withdrawing(barrier_us=17)), written=None)
    waiting, effects = step(unwritten, withdrawing(barrier_us=17), NOW)
    assert effects == ()
    _, effects = settled(waiting, Tick(), NOW)
    assert replies(effects) == [Refusal.ACCEPTED]


def test_a_withdraw_of_another_place_changes_nothing():
    after, effects = step(OPENED, withdrawing(records.digest(b"another place")), NOW)
    assert after == OPENED
    (send,) = effects
    assert (send.record.request_type, send.record.request_sequence) == (records.Withdraw.TYPE, 5)
    assert send.record.refusal is Refusal.WRONG_SESSION


def test_after_a_withdraw_a_later_registration_of_another_place_is_permitted():
    stopped = fed(CUTTING, BoneMoved(), withdrawing(barrier_us=REGISTERED_US), HeartbeatLost())
    memory = fed(stopped, reopening(stopped), withdrawing(records.NO_PLACE, REGISTERED_US)).memory
    state = replace(POWERED_UP, memory=memory, written=memory)
    other = records.digest(b"another place")
    assert _permit_answer(state, place_digest=other)[1] is Refusal.REGISTRATION_TOO_EARLY
    later = {"place_digest": other, "registration_time_us": REGISTERED_US + 1}
    assert _permit_answer(state, **later)[1] is Refusal.ACCEPTED
    assert _permit_answer(state, **(later | {"place_digest": PLACE}))[1] is Refusal.REGISTRATION_WITHDRAWN


def test_a_changed_limit_is_held_and_stops():
    after = fed(LOADED, LimitsChanged(OTHER_LIMITS.body()))
    assert (after.holdings.limits, after.cause) == (OTHER_LIMITS.body(), StopCause.LIMITS_CHANGED)


# ---------------------------------------------------------------- opening


def test_a_session_is_opened_with_what_both_sides_said():
    state = replace(POWERED_UP, heartbeat_fresh=True)
    after, effects = step(state, replace(opening(), sequence=7), NOW)
    assert (after.state, after.epoch, after.heartbeat_fresh) == (C.OPEN, 1, False)
    session = after.session
    assert session is not None
    assert (session.tag, session.digest) == (TAG, SESSION)
    assert (session.registration, session.place) == (REGISTRATION, PLACE)
    assert session.registration_time_us == REGISTERED_US
    assert session.announce_nonce == OPEN.announce_nonce
    assert (session.permit_lifetime_s, session.start_lifetime_s) == (120, 2.0)
    assert (session.start_tolerance_mm, session.start_tolerance_deg) == (0.5, 0.2)
    assert (session.heartbeat_s, session.timeout_s) == (0.02, 0.1)
    assert effects == (
        OpenLink(session),
        Send(records.Opened(epoch=1, state=C.OPEN, cause=StopCause.NONE), TAG),
    ), "and nothing is written"


def _opened_by(state: Controller, *, now_s: float = NOW, **changes) -> records.Opened:
    """What the controller says of itself to whom it opens a session."""
    _, effects = step(state, opening(**changes), now_s)
    return effects[-1].record


def test_who_opens_is_told_the_last_start_and_how_the_bone_stands():
    remembered = Memory(barrier_us=17, withdrawal_due=True, log=START_LOG)
    told = _opened_by(replace(_remembering(remembered), moved_at_s=NOW - 3.9))
    assert told == records.Opened(1, C.OPEN, StopCause.NONE, START_LOG, 1, 3, Refusal.ACCEPTED, 17)
    assert _opened_by(_remembering(remembered)).motion_age_s == records.AGE_UNKNOWN, "after a power-up"


@pytest.mark.parametrize(
    ("memory", "registration"),
    [
        (Memory(), Refusal.ACCEPTED),
        (Memory(withdrawal_due=True), Refusal.ACCEPTED),
        (Memory(withdrawn=frozenset({PLACE})), Refusal.REGISTRATION_WITHDRAWN),
        (Memory(earlier=frozenset({REGISTRATION})), Refusal.REGISTRATION_WITHDRAWN),
        (Memory(barrier_us=REGISTERED_US), Refusal.REGISTRATION_TOO_EARLY),
        (Memory(frozenset({PLACE}), barrier_us=REGISTERED_US), Refusal.REGISTRATION_WITHDRAWN),
        (Memory(barrier_us=REGISTERED_US - 1), Refusal.ACCEPTED),
    ],
)
def test_who_opens_is_told_what_the_list_says_of_its_registration(memory, registration):
    assert _opened_by(_remembering(memory)).registration is registration


@pytest.mark.parametrize("again", [opening(), replace(opening(), sequence=9, fresh=b"y" * 16)])
def test_the_same_open_opens_once(again):
    opened = fed(POWERED_UP, opening())
    assert opened.announce_nonce == NEXT_NONCE
    ended = fed(opened, StopReceived(StopCode.END, StopCause.SESSION_ENDED))
    after, effects = step(ended, again, NOW)
    assert after == ended
    assert replies(effects) == [Refusal.ANNOUNCE_NONCE]
    assert fed(ended, reopening(ended)).session is not None


@each_state
@pytest.mark.parametrize("authentic", [True, False])
def test_a_refused_open_changes_no_state_and_uses_no_nonce_up(name, authentic):
    """Least of all one that no holder of the key made: no stop, no latch."""
    state = EVERY_STATE[name]
    wrong = replace(reopening(state, identity_digest=bytes(32)), authentic=authentic)
    after, effects = step(state, wrong, NOW)
    assert after == state
    (send,) = effects
    expected = Refusal.IDENTITY_DIGEST if authentic else Refusal.MAC_INVALID
    assert send.record.refusal is (Refusal.SESSION_IN_USE if state.session else expected)
    assert send.session == 0


def test_another_version_is_refused_in_words_whatever_else_it_says():
    other = OpenReceived(records.OtherVersion(records.Open.TYPE, 3), 7, authentic=True, fresh=b"y" * 16)
    for state in (POWERED_UP, OPENED):
        after, effects = step(state, other, NOW)
        assert after == state
        (send,) = effects
        assert (send.session, send.record.refusal) == (0, Refusal.PROTOCOL_VERSION)
        assert (send.record.request_type, send.record.request_sequence) == (records.Open.TYPE, 7)


OPEN_REFUSED = [
    ("protocol_version", 1, Refusal.PROTOCOL_VERSION),
    ("announce_nonce", bytes(16), Refusal.ANNOUNCE_NONCE),
    ("identity_digest", bytes(32), Refusal.IDENTITY_DIGEST),
    ("timing.heartbeat_ms", 4, Refusal.TIMING_OUT_OF_BOUNDS),
    ("timing.heartbeat_ms", 101, Refusal.TIMING_OUT_OF_BOUNDS),
    ("timing.heartbeat_ms", 34, Refusal.TIMING_OUT_OF_BOUNDS),
    ("timing.timeout_ms", 79, Refusal.TIMING_OUT_OF_BOUNDS),
    ("timing.timeout_ms", 1001, Refusal.TIMING_OUT_OF_BOUNDS),
    ("timing.permit_lifetime_s", 9, Refusal.TIMING_OUT_OF_BOUNDS),
    ("timing.permit_lifetime_s", 601, Refusal.TIMING_OUT_OF_BOUNDS),
    ("timing.start_lifetime_ms", 499, Refusal.TIMING_OUT_OF_BOUNDS),
    ("timing.start_tolerance_um", 49, Refusal.TIMING_OUT_OF_BOUNDS),
    ("timing.start_tolerance_um", 2001, Refusal.TIMING_OUT_OF_BOUNDS),
    ("timing.start_tolerance_mdeg", 1001, Refusal.TIMING_OUT_OF_BOUNDS),
]


@pytest.mark.parametrize(
    ("field", "value", "refusal"), OPEN_REFUSED, ids=[f"{field}={value}" for field, value, _ in OPEN_REFUSED]
)
def test_a_session_that_does_not_fit_is_refused(field, value, refusal):
    after, effects = step(POWERED_UP, replace(opening(altered(OPEN, field, value)), sequence=7), NOW)
    assert after == POWERED_UP
    (send,) = effects
    assert (send.session, send.record.refusal) == (0, refusal)
    assert (send.record.request_type, send.record.request_sequence) == (records.Open.TYPE, 7)


def test_the_bounds_are_those_of_the_table_of_constants():
    exchanged = {name for name, constant in CONSTANTS.items() if constant.exchanged}
    assert exchanged == {
        "heartbeat_ms",
        "timeout_ms",
        "permit_lifetime_s",
        "start_lifetime_ms",
        "start_tolerance_mm",
        "start_tolerance_deg",
        "approach_clearance_mm",
        "approach_speed_percent",
    }


def test_nonces_that_make_the_tag_of_no_session_are_refused(monkeypatch):
    monkeypatch.setattr("firmware_sim.rules.records.opens", lambda _request: False)
    _, effects = step(POWERED_UP, opening(), NOW)
    assert replies(effects) == [Refusal.WRONG_SESSION]


@each_state
def test_one_session_at_a_time(name):
    state = EVERY_STATE[name]
    after, effects = settled(state, reopening(state), NOW)
    if state.session is None:
        assert after.session is not None
    else:
        assert after == state, "the session is not disturbed"
        assert replies(effects) == [Refusal.SESSION_IN_USE]
        assert [effect.session for effect in effects] == [0]


# ---------------------------------------------------------------- a latched fault


def test_a_latched_fault_is_left_only_by_acknowledge_and_then_reset():
    acknowledge = acknowledging(StopCause.SECOND_NODE, 2)
    for sequence, wanted in (
        ((), C.FAULT),
        ((acknowledge,), C.FAULT),
        ((NonceRequested(Purpose.RESET, OWN_RESET.nonce), LEAVING), C.FAULT),
        ((acknowledge, NonceRequested(Purpose.RESET, OWN_RESET.nonce), LEAVING), C.OPEN),
    ):
        after = fed(OPEN_LATCHED, *sequence)
        assert after.state is wanted
        assert not after.may_move
        assert not after.cutting_mode


@each_state
def test_no_other_single_event_leaves_a_latched_fault(name):
    state = EVERY_STATE[name]
    if state.state is not C.FAULT:
        return
    for event in events(state):
        after, _ = step(state, event, NOW)
        if after.state is not C.FAULT:
            assert (name, type(event)) == ("resetting", ResetReceived)


def test_a_session_opened_with_a_latched_controller_says_so():
    _, effects = settled(LATCHED, opening(), NOW)
    assert effects[-1].record == records.Opened(epoch=2, state=C.FAULT, cause=StopCause.SECOND_NODE)


@pytest.mark.parametrize(
    ("state", "cause", "refusal"),
    [
        (OPEN_LATCHED, StopCause.SECOND_NODE, Refusal.ACCEPTED),
        (OPEN_LATCHED, StopCause.OPERATOR_STOP, Refusal.WRONG_CAUSE),
        (LATCHED, StopCause.SECOND_NODE, Refusal.VOIDED_BY_STOP),
        (EVERY_STATE["stopped"], StopCause.BUS_FAILED, Refusal.VOIDED_BY_STOP),
    ],
)
def test_only_the_standing_cause_is_acknowledged_in_a_live_session(state, cause, refusal):
    after, effects = step(state, acknowledging(cause, state.epoch), NOW)
    assert replies(effects) == [refusal]
    assert [effect.record.request_sequence for effect in effects] == [2]
    assert after.cause is (StopCause.NONE if refusal is Refusal.ACCEPTED else state.cause)
    assert after.state is state.state


def test_an_emergency_stop_is_not_acknowledged_while_it_is_pressed():
    state = fed(
        POWERED_UP,
        InputsChanged(Inputs(emergency_stop_clear=False)),
        opening(),
        alive(),
    )
    after, effects = step(state, acknowledging(StopCause.EMERGENCY_STOP, 2), NOW)
    assert (after, replies(effects)) == (state, [Refusal.EMERGENCY_STOP])
    after = fed(state, RELEASE, acknowledging(StopCause.EMERGENCY_STOP, 2))
    assert after.cause is StopCause.NONE


def test_an_acknowledgement_of_another_epoch_is_not_of_the_stop_that_stands():
    """The same cause may stand for a stop that the operator has not seen."""
    for epoch in (1, 3):
        after, effects = step(OPEN_LATCHED, acknowledging(StopCause.SECOND_NODE, epoch), NOW)
        assert (after, replies(effects)) == (OPEN_LATCHED, [Refusal.EPOCH])


def test_a_wrong_key_latches_from_every_state():
    for state in EVERY_STATE.values():
        for event in (
            replace(ASKING, authentic=False),
            replace(STARTING, authentic=False),
            replace(LEAVING, authentic=False),
            acknowledging(state.cause, state.epoch, authentic=False),
            withdrawing(authentic=False),
        ):
            after, effects = step(state, event, NOW)
            assert (after.state, is_void(after)) == (C.FAULT, True)
            assert after.cause is (state.memory.latched or state.cause or StopCause.AUTHENTICATION_FAILED)
            assert faults(effects) == [SendFault(FaultCode.LATCHED, StopCause.AUTHENTICATION_FAILED)]
            assert after.memory == replace(state.memory, latched=after.cause), "it withdraws nothing"
            assert replies(effects) == [Refusal.MAC_INVALID]


REFUSED = [
    (ASKED, PermitReceived(replace(PERMIT, epoch=7), 9, authentic=True), Refusal.EPOCH),
    (CYCLED, StartReceived(replace(START, epoch=7), 9, authentic=True), Refusal.EPOCH),
    (RESETTING, ResetReceived(replace(RESET, epoch=7), 9, authentic=True), Refusal.EPOCH),
]


@pytest.mark.parametrize(("state", "event", "refusal"), REFUSED, ids=["permit", "start", "reset"])
def test_a_refused_request_uses_its_nonce_up_and_stops_nothing(state, event, refusal):
    after, effects = step(state, event, NOW)
    assert state.issued is not None
    assert after == replace(state, issued=None)
    (send,) = effects
    assert (send.session, send.record.request_sequence) == (TAG, 9)
    assert (send.record.refusal, send.record.cause, send.record.detail) == (refusal, state.cause, 0)


def test_a_request_without_a_session_is_answered_outside_any():
    _, (send,) = step(POWERED_UP, ASKING, NOW)
    assert (send.session, send.record.refusal) == (0, Refusal.VOIDED_BY_STOP)


# ---------------------------------------------------------------- loading


@pytest.mark.parametrize("state", [OPENED, LOADED], ids=["open", "loaded"])
def test_the_records_are_given_as_they_are_held(state):
    after, effects = step(state, CollectReceived(), NOW)
    assert after == state
    assert effects == tuple(Send(record, TAG) for record in (LIMITS, CALIBRATION, TOOL))


@each_state
def test_nothing_is_collected_or_stored_in_any_other_state(name):
    state = EVERY_STATE[name]
    if state.state in (C.OPEN, C.LOADED):
        return
    for event in (CollectReceived(), ACCEPTED_PATH):
        assert step(state, event, NOW) == (state, ())


@pytest.mark.parametrize("state", [OPENED, LOADED], ids=["open", "loaded"])
def test_an_accepted_path_is_stored_and_answered_with_its_digest(state):
    after, effects = step(state, ACCEPTED_PATH, NOW)
    assert (after.state, after.holdings.path, after.holdings.ends) == (
        C.LOADED,
        PATH.body(),
        ENDS,
    )
    (send,) = effects
    assert send == Send(records.PathStored(digest=PATH.digest, refusal=Refusal.ACCEPTED, pose=0), TAG)


@pytest.mark.parametrize("state", [OPENED, LOADED], ids=["open", "loaded"])
def test_a_refused_path_is_not_stored_and_displaces_the_one_before(state):
    refused = PathChecked(PATH.body(), Refusal.POSE_OUTSIDE_LIMITS, 2, ENDS)
    after, effects = step(state, refused, NOW)
    assert (after.state, after.holdings.path, after.holdings.ends) == (C.OPEN, None, None)
    assert effects[0].record.refusal is Refusal.POSE_OUTSIDE_LIMITS


def test_a_measurement_does_not_outlive_a_stop():
    assert LOADED.measured_u == START_JOINTS
    assert fed(LOADED, FaultArisen(StopCause.BUS_FAILED)).measured_u is None


@pytest.mark.parametrize("purpose", Purpose, ids=str)
def test_a_new_nonce_voids_the_old(purpose):
    after, effects = step(ASKED, NonceRequested(purpose, b"new".ljust(16)), NOW + 1)
    assert after.issued is not None
    assert (after.issued.nonce, after.issued.purpose, after.issued.at_s) == (
        b"new".ljust(16),
        purpose,
        NOW + 1,
    )
    assert effects == (Send(records.Nonce(purpose=purpose, nonce=b"new".ljust(16), epoch=1), TAG),)
    _, effects = step(after, ASKING, NOW + 1)
    assert replies(effects)[0] in (Refusal.NONCE_MISMATCH, Refusal.NO_NONCE)


# ---------------------------------------------------------------- permit, start, motion


def test_a_permit_enables_the_cutter_and_no_motion():
    after, effects = step(ASKED, ASKING, NOW + 3)
    assert (after.state, after.permit, after.issued) == (C.PERMITTED, PERMIT, None)
    assert after.permit_issued_at_s == NOW, "its life began with its nonce"
    assert (after.cutting_mode, after.may_move) == (True, False)
    assert replies(effects) == [Refusal.ACCEPTED]


@pytest.mark.parametrize("device", [HOLD, RELEASE], ids=["held", "released"])
def test_the_answer_to_a_permit_says_nothing_of_the_device(device):
    """An answer may be anybody's; the heartbeat says it."""
    _, effects = step(fed(ASKED, device), ASKING, NOW)
    assert [effect.record.detail for effect in effects] == [0]


def test_a_permit_ages_from_its_nonce():
    for now_s in (NOW, NOW + 120.0):
        assert step(PERMITTED, Tick(), now_s) == (PERMITTED, ())
    for now_s in (NOW + 120.1, NOW - 0.1, math.nan):
        after, _ = step(PERMITTED, Tick(), now_s)
        assert (after.state, after.cause) == (C.INHIBITED, StopCause.PERMIT_EXPIRED)


@pytest.mark.parametrize("ordered_before", [False, True])
def test_a_start_alone_moves_nothing(ordered_before):
    after, effects = settled(replace(CYCLED, cut_ordered=ordered_before), STARTING, NOW)
    assert (after.state, after.may_move, after.issued) == (C.CUTTING, False, None)
    assert replies(effects) == [Refusal.ACCEPTED]


def test_a_start_that_no_cut_follows_is_dropped_within_the_time_out():
    for now_s in (NOW, NOW + 0.099):
        assert step(STARTED, Tick(), now_s) == (STARTED, ())
    just_in_time = replace(STARTED, started_at_s=0.0)
    assert step(just_in_time, Tick(), 0.1) == (just_in_time, ())
    for now_s in (NOW + 0.11, NOW - 0.1, math.nan):
        after, _ = step(STARTED, Tick(), now_s)
        assert (after.state, after.cause) == (C.INHIBITED, StopCause.HEARTBEAT_LOST)
    assert step(CUTTING, Tick(), NOW + 3600.0) == (CUTTING, ()), (
        "an ordered cut lasts as long as heartbeats do"
    )


@pytest.mark.parametrize(
    "beat",
    [
        alive(RuntimeCode.READY),
        alive(RuntimeCode.INHIBIT),
        alive(RuntimeCode.CUT, epoch=0),
        alive(RuntimeCode.CUT, epoch=2),
        alive(RuntimeCode.CUT, fresh=False),
    ],
)
def test_only_a_fresh_cut_of_this_epoch_begins_the_motion_and_only_that_upholds_it(beat):
    begun, effects = step(STARTED, beat, NOW)
    assert (begun.state, begun.may_move, effects) == (C.CUTTING, False, ())
    assert fed(begun, alive(RuntimeCode.CUT)).may_move

    stopped, effects = step(CUTTING, beat, NOW)
    assert stopped.state is C.INHIBITED
    assert faults(effects)
    stale = beat.code is RuntimeCode.CUT and beat.epoch == 1
    assert stopped.cause is (StopCause.HEARTBEAT_LOST if stale else StopCause.PROTOCOL_VIOLATION)
    assert not fed(stopped, alive(RuntimeCode.CUT)).may_move, "there is no pause to resume from"


def test_a_stale_cut_does_not_count_as_the_cut_that_must_follow_a_start():
    after = fed(fed(STARTED, alive(RuntimeCode.CUT, fresh=False)), Tick(), now_s=NOW + 0.11)
    assert (after.state, after.cause) == (C.INHIBITED, StopCause.HEARTBEAT_LOST)


def test_twenty_six_stale_heartbeats_do_not_keep_the_gate_open():
    state = fed(CUTTING, *(alive(RuntimeCode.CUT, fresh=False) for _ in range(26)))
    assert (state.state, state.epoch) == (C.INHIBITED, 2)


@pytest.mark.parametrize(
    "state",
    [OPENED, LOADED, PERMITTED, STARTED, CUTTING, DONE],
    ids=["open", "loaded", "permitted", "started", "cutting", "done"],
)
@pytest.mark.parametrize("code", RuntimeCode, ids=str)
def test_a_cause_in_the_heartbeat_stops_whatever_its_code(state, code):
    after, effects = step(state, alive(code, cause=StopCause.AUDIT_FAILED), NOW)
    assert (after.state, after.cause) == (C.FAULT, StopCause.AUDIT_FAILED)
    assert faults(effects)


def test_a_standing_cause_is_not_a_stop_again_and_again():
    stopped = EVERY_STATE["stopped"]
    after, effects = step(stopped, alive(epoch=stopped.epoch, cause=StopCause.BUS_FAILED), NOW)
    assert (after.epoch, effects) == (stopped.epoch, ())


@pytest.mark.parametrize(
    ("beat", "upheld"),
    [
        (alive(RuntimeCode.READY), True),
        (alive(RuntimeCode.CUT), True),
        (alive(RuntimeCode.READY, fresh=False), True),
        (alive(RuntimeCode.INHIBIT), False),
        (alive(RuntimeCode.READY, epoch=2), False),
    ],
)
def test_cutting_mode_lasts_while_the_runtime_upholds_it(beat, upheld):
    after, effects = step(PERMITTED, beat, NOW)
    assert after.cutting_mode is upheld
    if upheld:
        assert (after.heartbeat_fresh, effects) == (beat.fresh, ())
    else:
        assert (after.state, after.cause) == (C.INHIBITED, StopCause.PROTOCOL_VIOLATION)


@each_state
def test_freshness_is_what_the_link_says(name):
    state = EVERY_STATE[name]
    if state.state in (C.PERMITTED, C.CUTTING):
        return
    for fresh in (True, False):
        after, effects = step(state, alive(epoch=state.epoch, fresh=fresh), NOW)
        assert (after, effects) == (replace(state, heartbeat_fresh=fresh), ())


def test_the_end_of_the_path_ends_cutting_mode_and_spends_the_permit():
    asked = fed(CUTTING, NonceRequested(Purpose.PERMIT, PERMIT.nonce))
    after, effects = step(asked, PathFinished(), NOW)
    assert (after.state, after.cause, effects) == (C.DONE, StopCause.NONE, ())
    assert (after.permit, after.issued, after.may_move, after.cutting_mode) == (None, None, False, False)
    assert (after.cut_ordered, after.device) == (False, DeviceCycle.UNSEEN)
    assert after.session is not None
    assert after.session.live


@pytest.mark.parametrize(("joint", "tolerance_u"), [(0, 31_830), (2, 500_000), (3, 200_000), (4, -200_000)])
def test_the_end_of_the_path_counts_only_where_the_measured_arm_is_back_within_the_start_tolerance(
    joint, tolerance_u
):
    inside, beyond = (
        JointsMeasured((*START_JOINTS[:joint], START_JOINTS[joint] + by_u, *START_JOINTS[joint + 1 :]))
        for by_u in (tolerance_u, tolerance_u + (3 if tolerance_u > 0 else -3))
    )
    assert fed(CUTTING, inside, PathFinished()).state is C.DONE
    after = fed(CUTTING, beyond, PathFinished())
    assert (after.state, after.cause) == (C.INHIBITED, StopCause.TRACKING_DEVIATION)
    assert is_void(after)


def test_the_end_of_the_path_does_not_count_without_a_measurement():
    after = fed(replace(CUTTING, measured_u=None), PathFinished())
    assert (after.state, after.cause) == (C.INHIBITED, StopCause.TRACKING_DEVIATION)


@each_state
def test_the_end_of_the_path_means_nothing_where_the_arm_was_not_free_to_move(name):
    state = EVERY_STATE[name]
    if name != "cutting":
        assert step(state, PathFinished(), NOW) == (state, ())


def test_measurements_are_kept():
    assert fed(LOADED, JointsMeasured((1, 2, 3, 4, 5))).measured_u == (1, 2, 3, 4, 5)


# ---------------------------------------------------------------- whole stories


def test_the_whole_way_from_power_up_to_the_next_session():
    state = fed(DONE, RELEASE, StopReceived(StopCode.END, StopCause.SESSION_ENDED))
    assert (state.state, state.cause, state.session) == (C.INHIBITED, StopCause.NONE, None)
    state = fed(state, reopening(state), alive(epoch=3))
    assert (state.state, state.epoch, state.cause) == (C.OPEN, 3, StopCause.NONE)


def test_a_reset_controller_can_be_loaded_and_permitted():
    state = fed(
        ACKNOWLEDGED,
        NonceRequested(Purpose.RESET, OWN_RESET.nonce),
        LEAVING,
        ACCEPTED_PATH,
        STANDING,
        NonceRequested(Purpose.PERMIT, PERMIT.nonce),
        PermitReceived(replace(PERMIT, epoch=2), 4, authentic=True),
    )
    assert state.state is C.PERMITTED


def test_every_event_is_answered_somewhere():
    kinds = {type(event) for event in events(LOADED)}
    assert kinds == set(EVERYWHERE) | {kind for _, kind in TABLE}


# ---------------------------------------------------------------- invariants of any sequence


class Watch:
    """Follows the controller from outside: what was accepted in this session, and whether a stop came since."""

    def __init__(self, state: Controller) -> None:
        self.state = state
        self.permit: records.Permit | None = state.permit
        self.started = state.state is C.CUTTING
        self.ordered = state.may_move

    def step(self, event: Event, now_s: float) -> None:
        before = self.state
        after, effects = settled(before, event, now_s)
        self.state = after
        accepted = replies(effects) == [Refusal.ACCEPTED]
        if faults(effects) or after.session is None or after.state is C.DONE:
            self.permit, self.started, self.ordered = None, False, False
        if isinstance(event, PermitReceived) and accepted:
            self.permit = event.permit
        if isinstance(event, StartReceived) and accepted:
            self.started = True
        if isinstance(event, HeartbeatReceived) and self.started:
            self.ordered = (event.code, event.epoch, event.fresh) == (RuntimeCode.CUT, after.epoch, True)
        self._motion(after)
        self._bookkeeping(before, after, effects)

    def _motion(self, after: Controller) -> None:
        if after.cutting_mode:
            permit, held, session = self.permit, after.holdings, after.session
            assert permit is not None
            assert session is not None
            assert session.live
            assert held.path is not None
            assert (
                permit.path_digest,
                permit.limits_digest,
                permit.calibration_digest,
                permit.tool_digest,
            ) == tuple(records.digest(data) for data in (held.path, held.limits, held.calibration, held.tool))
            memory = after.memory
            assert permit.registration_digest == session.registration
            assert session.place not in memory.withdrawn
            assert session.registration not in memory.earlier
            assert not memory.withdrawal_due
            assert memory.barrier_us == records.NO_TIME or session.registration_time_us > memory.barrier_us
            assert (permit.session_digest, permit.epoch) == (session.digest, after.epoch)
            assert after.inputs.emergency_stop_clear
            assert after.cause is StopCause.NONE
        if after.state is C.CUTTING:
            assert after.memory.log == after.written.log != records.NO_TREE_HEAD, (
                "its witness, before it moves"
            )
        if after.may_move:
            assert self.started
            assert self.ordered
            assert after.inputs.device_pressed

    def _bookkeeping(self, before: Controller, after: Controller, effects: tuple[object, ...]) -> None:
        assert before.memory.withdrawn <= after.memory.withdrawn
        assert (after.session is None) <= (after.state in (C.INHIBITED, C.FAULT))
        assert (after.state in (C.PERMITTED, C.CUTTING)) == (after.permit is not None)
        if faults(effects):
            assert is_void(after)
            assert after.cause is not StopCause.NONE
            assert after.epoch == (before.epoch + 1) % EPOCHS
        assert before.memory.barrier_us <= after.memory.barrier_us
        assert (after.state is C.FAULT) == (after.memory.latched is not StopCause.NONE)
        if after.memory != before.memory:
            assert Persist(after.memory) in effects
        if before.state is C.FAULT and after.state is not C.FAULT:
            assert after.state is C.OPEN
            assert before.cause is StopCause.NONE


def _onward(state: Controller) -> list[Event]:
    """What a sound runtime and a patient person do next."""
    tempting = {type(event): event for event in reversed(events(state))}
    match state.state:
        case C.INHIBITED if state.session is None:
            return [tempting[OpenReceived]]
        case C.INHIBITED:
            return [HeartbeatLost()]
        case C.FAULT:
            wanted = [AcknowledgeReceived, NonceRequested, ResetReceived]
            return [alive(epoch=state.epoch), *(tempting[kind] for kind in wanted)]
        case C.OPEN:
            return [alive(epoch=state.epoch), tempting[AcknowledgeReceived], ACCEPTED_PATH]
        case C.LOADED:
            return [
                STANDING,
                NonceRequested(Purpose.PERMIT, b"1" * 16),
                tempting[PermitReceived],
            ]
        case C.PERMITTED:
            return [RELEASE, HOLD, NonceRequested(Purpose.START, b"2" * 16), tempting[StartReceived]]
        case C.CUTTING:
            return [alive(RuntimeCode.CUT, state.epoch)]
        case _:
            return [StopReceived(StopCode.END, StopCause.SESSION_ENDED)]


@settings(max_examples=80, deadline=None)
@given(
    start=st.sampled_from(sorted(EVERY_STATE)),
    sequence=st.lists(
        st.tuples(st.integers(0, 400), st.sampled_from([0.0, 0.01, 0.05, 1.0])), min_size=5, max_size=40
    ),
)
def test_no_sequence_of_events_moves_an_arm_that_was_not_permitted(start, sequence):
    watch = Watch(EVERY_STATE[start])
    now_s = NOW
    for pick, after_s in sequence:
        now_s += after_s
        onward = _onward(watch.state)
        if pick % 3:
            choice = [onward[pick % len(onward)]]
        elif pick % 2:
            choice = onward  # the straight way, all of it
        else:
            tempting = events(watch.state)
            choice = [tempting[pick % len(tempting)]]
        for event in choice:
            watch.step(event, now_s)
