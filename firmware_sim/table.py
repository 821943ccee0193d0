"""The simulated controller as one transition table: ``step(state, event, now_s) -> (state, effects)``.

Pure: no bus, no clock, no random number. ``cutgate.firmware_sim.loop`` feeds it events and carries out its effects.
Everything that enables is judged here against what the controller holds at that moment (``rules``); everything
that stops goes through :func:`stop`, which voids permit, nonces and transfers and starts a new epoch.

Whatever enables, withdraws a registration or clears a cause carries a code that only a holder of the key can make; what
carries none, as a stop frame, denies and withdraws nothing.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from cutgate.firmware_sim.rules import (
    ACKNOWLEDGE_RULES,
    OPEN_RULES,
    PERMIT_RULES,
    REGISTRATION_RULES,
    RESET_RULES,
    START_RULES,
    WITHDRAW_RULES,
    RequestCase,
    at_start,
    first_refusal,
)
from cutgate.firmware_sim.state import (
    AbortTransfers,
    AcknowledgeReceived,
    Awaiting,
    BoneMoved,
    CloseLink,
    CollectReceived,
    Controller,
    ControllerSession,
    DeviceCycle,
    Effect,
    Event,
    FaultArisen,
    HeartbeatLost,
    HeartbeatReceived,
    InputsChanged,
    Issued,
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
    PersistFailed,
    ResetReceived,
    Send,
    SendFault,
    StartReceived,
    StopReceived,
    Tick,
    WithdrawReceived,
)
from cutgate.protocol import records
from cutgate.protocol.records import digest
from cutgate.protocol.states import (
    EPOCHS,
    LATCHING,
    WITHDRAWING,
    ControllerState,
    FaultCode,
    Refusal,
    RuntimeCode,
    StopCause,
    StopCode,
)

Outcome = tuple[Controller, tuple[Effect, ...]]


def step(state: Controller, event: Event, now_s: float) -> Outcome:
    """One transition. An event that the table does not list for this state changes nothing.

    What must be remembered is written after everything else of the step has left, and in every cycle until it is.
    """
    handler = TABLE.get((state.state, type(event))) or EVERYWHERE.get(type(event))
    after, effects = handler(state, event, now_s) if handler else (state, ())
    news = after.memory != state.memory or isinstance(event, Tick)
    return after, (*effects, Persist(after.memory)) if news and after.memory != after.written else effects


# ---------------------------------------------------------------- stopping


def stop(state: Controller, cause: StopCause) -> Outcome:
    """Protective stop: no motion, no cutting mode, nothing outstanding survives, the first cause is kept."""
    if cause is StopCause.NONE:  # whoever stops without a cause breaks the protocol
        cause = StopCause.PROTOCOL_VIOLATION
    latched = state.state is ControllerState.FAULT or cause in LATCHING
    voided = _void(state)
    first = voided.cause if voided.cause is not StopCause.NONE else cause
    stopped = replace(
        voided,
        state=ControllerState.FAULT if latched else ControllerState.INHIBITED,
        cause=first,
        memory=replace(state.memory, latched=first) if latched else state.memory,
    )
    sent = SendFault(FaultCode.LATCHED if latched else FaultCode.STOPPED, cause)
    live = state.session is not None and state.session.live  # else there is nothing to void but a reply
    return stopped, (sent, AbortTransfers()) if live else (sent,)


def _void(state: Controller) -> Controller:
    """Nothing outstanding survives. The cause of a latched fault stands again: its acknowledgement was this session's."""
    return replace(
        state,
        cause=state.memory.latched if state.state is ControllerState.FAULT else state.cause,
        awaiting=None,
        epoch=(state.epoch + 1) % EPOCHS,
        session=replace(state.session, live=False) if state.session else None,
        issued=None,
        permit=None,
        device=DeviceCycle.UNSEEN,
        cut_ordered=False,
        measured_u=None,
        holdings=replace(state.holdings, path=None, ends=None),
    )


def stop_received(state: Controller, event: StopReceived, _now_s: float) -> Outcome:
    """It may be anybody's: its cause is recorded as claimed, and withdraws nothing.

    No runtime names a withdrawal in it. One that is named must not come back under the tag of our heartbeat, for what
    stands there is believed.
    """
    claims_withdrawal = event.cause in WITHDRAWING
    if event.code is StopCode.END and not claims_withdrawal and state.state is not ControllerState.CUTTING:
        return end_session(state)
    return stop(state, StopCause.PROTOCOL_VIOLATION if claims_withdrawal else event.cause)


def end_session(state: Controller) -> Outcome:
    """The runtime is done. A latched fault stays latched."""
    resting = ControllerState.FAULT if state.state is ControllerState.FAULT else ControllerState.INHIBITED
    ended = replace(_void(state), state=resting, session=None, heartbeat_fresh=False)
    return ended, (AbortTransfers(), CloseLink())


def heartbeat_lost(state: Controller, _event: HeartbeatLost, _now_s: float) -> Outcome:
    if state.session is None:
        return state, ()
    if not state.session.live:  # the stop came first; now the peer is gone as well
        return replace(state, session=None, heartbeat_fresh=False, awaiting=None), (CloseLink(),)
    stopped, effects = stop(state, StopCause.HEARTBEAT_LOST)
    return replace(stopped, session=None, heartbeat_fresh=False), (*effects, CloseLink())


def fault(state: Controller, event: FaultArisen, _now_s: float) -> Outcome:
    return stop(state, event.cause)


def bone_moved(state: Controller, _event: BoneMoved, now_s: float) -> Outcome:
    return stop(_with_motion(state, now_s), StopCause.BONE_MOVED)


def _with_motion(state: Controller, now_s: float) -> Controller:
    """The session's place is withdrawn, if there is a session, and nothing is permitted before a Withdraw tells a barrier.

    What was registered before and is not named here is kept out by that barrier.
    """
    session = state.session
    return replace(
        state,
        memory=state.memory.with_motion(session.place if session else None),
        moved_at_s=now_s,
        session=replace(session, withdrawn=True) if session else None,
    )


def limits_changed(state: Controller, event: LimitsChanged, _now_s: float) -> Outcome:
    changed = replace(state, holdings=replace(state.holdings, limits=event.limits))
    return stop(changed, StopCause.LIMITS_CHANGED)


def inputs_changed(state: Controller, event: InputsChanged, _now_s: float) -> Outcome:
    changed = replace(state, inputs=event.inputs, device=_cycle(state.device, event.inputs.device_pressed))
    if not event.inputs.emergency_stop_clear and state.inputs.emergency_stop_clear:
        return stop(changed, StopCause.EMERGENCY_STOP)
    if state.state is ControllerState.CUTTING and not event.inputs.device_pressed:
        return stop(changed, StopCause.DEVICE_RELEASED)
    return changed, ()


def _cycle(cycle: DeviceCycle, pressed: bool) -> DeviceCycle:
    if not pressed:
        return DeviceCycle.RELEASED
    return DeviceCycle.UNSEEN if cycle is DeviceCycle.UNSEEN else DeviceCycle.PRESSED


# ---------------------------------------------------------------- opening and loading


def open_received(state: Controller, event: OpenReceived, now_s: float) -> Outcome:
    """An OPEN that is refused changes nothing, whoever sent it; one that is accepted opens no second time."""
    refusal = first_refusal(OPEN_RULES, RequestCase(state, event.request, now_s, event.authentic))
    if refusal is not Refusal.ACCEPTED:
        return state, (_reply(state, records.Open.TYPE, event.sequence, refusal, session=0),)
    assert isinstance(event.request, records.Open)  # noqa: S101 - PROTOCOL_VERSION stands in the rules
    session = ControllerSession.of(event.request)
    latched = state.state is ControllerState.FAULT
    opened = replace(
        _void(state),
        announce_nonce=event.fresh,
        state=ControllerState.FAULT if latched else ControllerState.OPEN,
        session=session,
        heartbeat_fresh=False,
    )
    return opened, (OpenLink(session), Send(_opened(opened, now_s), session.tag))


def _opened(state: Controller, now_s: float) -> records.Opened:
    """How the controller stands, and what its memory says: of the last start, of the bone, of this registration."""
    return records.Opened(
        epoch=state.epoch,
        state=state.state,
        cause=state.cause,
        log=state.memory.log,
        withdrawal_due=int(state.memory.withdrawal_due),
        motion_age_s=state.motion_age_s(now_s),
        registration=first_refusal(REGISTRATION_RULES, RequestCase(state, None, now_s)),
        barrier_us=state.memory.barrier_us,
    )


def collect(state: Controller, _event: CollectReceived, _now_s: float) -> Outcome:
    assert state.session is not None  # noqa: S101 - OPEN and LOADED have a session
    tag, holdings = state.session.tag, state.holdings
    return state, (
        Send(records.Limits.parse(holdings.limits), tag),
        Send(records.Calibration.parse(holdings.calibration), tag),
        Send(records.Tool.parse(holdings.tool), tag),
    )


def path_checked(state: Controller, event: PathChecked, _now_s: float) -> Outcome:
    assert state.session is not None  # noqa: S101 - OPEN and LOADED have a session
    accepted = event.refusal is Refusal.ACCEPTED
    loaded = replace(
        state,
        state=ControllerState.LOADED if accepted else ControllerState.OPEN,
        holdings=replace(
            state.holdings,
            path=event.path if accepted else None,
            ends=event.ends if accepted else None,
        ),
    )
    answer = records.PathStored(digest=digest(event.path), refusal=event.refusal, pose=event.pose)
    return loaded, (Send(answer, state.session.tag),)


def give_nonce(state: Controller, event: NonceRequested, now_s: float) -> Outcome:
    if state.session is None or not state.session.live:
        return state, ()
    issued = Issued(event.fresh, event.purpose, now_s)
    answer = records.Nonce(purpose=event.purpose, nonce=event.fresh, epoch=state.epoch)
    return replace(state, issued=issued), (Send(answer, state.session.tag),)


# ---------------------------------------------------------------- enabling


def permit_received(state: Controller, event: PermitReceived, now_s: float) -> Outcome:
    refusal = first_refusal(PERMIT_RULES, RequestCase(state, event.permit, now_s, event.authentic))
    if refusal is not Refusal.ACCEPTED:
        return _refuse(state, event.permit, event.sequence, refusal)
    assert state.issued is not None  # noqa: S101 - NO_NONCE stands in the rules
    permitted = replace(
        state,
        state=ControllerState.PERMITTED,
        permit=event.permit,
        permit_issued_at_s=state.issued.at_s,
        issued=None,
        device=DeviceCycle.UNSEEN if state.inputs.device_pressed else DeviceCycle.RELEASED,
    )
    return permitted, (_accept(permitted, event.permit, event.sequence),)


def start_received(state: Controller, event: StartReceived, now_s: float) -> Outcome:
    """The controller is the log's witness: what the start says of it is durable before anything moves."""
    refusal = first_refusal(START_RULES, RequestCase(state, event.start, now_s, event.authentic))
    if refusal is not Refusal.ACCEPTED:
        return _refuse(state, event.start, event.sequence, refusal)
    return _await_memory(state, event, replace(state.memory, log=event.start.log))


def begin_cut(state: Controller, event: StartReceived, now_s: float) -> Outcome:
    """Its log is durable; that took time, so every rule is asked again."""
    refusal = first_refusal(START_RULES, RequestCase(state, event.start, now_s, event.authentic))
    if refusal is not Refusal.ACCEPTED:
        return _refuse(state, event.start, event.sequence, refusal)
    cutting = replace(
        state, state=ControllerState.CUTTING, issued=None, cut_ordered=False, started_at_s=now_s
    )
    return cutting, (_accept(cutting, event.start, event.sequence),)


def reset_received(state: Controller, event: ResetReceived, now_s: float) -> Outcome:
    refusal = first_refusal(RESET_RULES, RequestCase(state, event.reset, now_s, event.authentic))
    if refusal is not Refusal.ACCEPTED:
        return _refuse(state, event.reset, event.sequence, refusal)
    unlatched = replace(state.memory, latched=StopCause.NONE)
    return _await_memory(replace(state, issued=None), event, unlatched)


def leave_fault(state: Controller, event: ResetReceived) -> Outcome:
    reset = replace(state, state=ControllerState.OPEN)
    return reset, (_accept(reset, event.reset, event.sequence),)


def acknowledge_received(state: Controller, event: AcknowledgeReceived, now_s: float) -> Outcome:
    """Only the cause that stands is acknowledged, once it is gone; the operator has to have seen it."""
    request = event.acknowledge
    refusal = first_refusal(ACKNOWLEDGE_RULES, RequestCase(state, request, now_s, event.authentic))
    if refusal is Refusal.MAC_INVALID:
        return _refuse(state, request, event.sequence, refusal)
    acknowledged = replace(state, cause=StopCause.NONE) if refusal is Refusal.ACCEPTED else state
    return acknowledged, (_reply(acknowledged, request.TYPE, event.sequence, refusal),)


# ---------------------------------------------------------------- withdrawing


def withdraw_received(state: Controller, event: WithdrawReceived, now_s: float) -> Outcome:
    """It is in force at once, and answered once it is durable. What was permitted before it does not go on.

    One that is held back may not know of what has happened since: it settles what was due when its session was opened,
    and what happens in a session is settled in the next one.
    """
    request = event.withdraw
    refusal = first_refusal(WITHDRAW_RULES, RequestCase(state, request, now_s, event.authentic))
    if refusal is Refusal.MAC_INVALID:
        return _refuse(state, request, event.sequence, refusal)
    if refusal is not Refusal.ACCEPTED:
        return state, (_reply(state, request.TYPE, event.sequence, refusal),)
    stopped, effects = stop(state, StopCause.REGISTRATION_WITHDRAWN) if state.cutting_mode else (state, ())
    assert stopped.session is not None  # noqa: S101 - WRONG_SESSION stands in the rules
    settles = not stopped.session.withdrawn and request.barrier_us > records.NO_TIME
    memory = stopped.memory.with_barrier(request.place_digest, request.barrier_us, settles=settles)
    withdrawn = replace(
        stopped,
        memory=memory,
        moved_at_s=stopped.moved_at_s if memory.withdrawal_due else None,
        awaiting=Awaiting(event, memory),
    )
    if memory == state.written:
        return replace(withdrawn, awaiting=None), (*effects, _accept(withdrawn, request, event.sequence))
    return withdrawn, effects


# ---------------------------------------------------------------- what is remembered


def _await_memory(state: Controller, event: StartReceived | ResetReceived, memory: Memory) -> Outcome:
    """What enables is carried out once it is durable; until then nothing has changed."""
    return replace(state, awaiting=Awaiting(event, memory)), (Persist(memory),)


def persisted(state: Controller, event: Persisted, now_s: float) -> Outcome:
    """What waited for this is carried out; a stop in between has voided it.

    A Withdraw is in force since it came: what has happened since then stays, and is written next.
    """
    known, awaiting = replace(state, written=event.memory), state.awaiting
    if awaiting is None or awaiting.memory != event.memory:
        return known, ()
    settled = replace(known, awaiting=None)
    if isinstance(awaiting.event, WithdrawReceived):
        return settled, (_accept(settled, awaiting.event.withdraw, awaiting.event.sequence),)
    settled = replace(settled, memory=event.memory)
    if isinstance(awaiting.event, StartReceived):
        return begin_cut(settled, awaiting.event, now_s)
    return leave_fault(settled, awaiting.event)


def persist_failed(state: Controller, _event: PersistFailed, _now_s: float) -> Outcome:
    """What waited is refused; what must not be forgotten is written again in every cycle, and nothing starts before."""
    awaiting, unknown = state.awaiting, replace(state, awaiting=None, written=None)
    match awaiting.event if awaiting else None:
        case StartReceived(request, sequence) | ResetReceived(request, sequence):
            return _refuse(unknown, request, sequence, Refusal.MEMORY_FAILED)
        case WithdrawReceived(request, sequence):  # it stays in force, and is written again
            return unknown, (_reply(unknown, request.TYPE, sequence, Refusal.MEMORY_FAILED),)
    if state.state is ControllerState.FAULT:
        return unknown, ()
    return stop(unknown, StopCause.INTERNAL_ERROR)


def _refuse(state: Controller, request: records.Record, sequence: int, refusal: Refusal) -> Outcome:
    """Refuse with the reason. A wrong authentication code is a masquerade and latches."""
    answer = _reply(state, request.TYPE, sequence, refusal)
    used = replace(state, issued=None)
    if refusal is not Refusal.MAC_INVALID:
        return used, (answer,)
    stopped, effects = stop(used, StopCause.AUTHENTICATION_FAILED)
    return stopped, (*effects, answer)


def _accept(state: Controller, request: records.Record, sequence: int) -> Send:
    return _reply(state, request.TYPE, sequence, Refusal.ACCEPTED)


def _reply(
    state: Controller, request_type: int, sequence: int, refusal: Refusal, session: int | None = None
) -> Send:
    tag = session if session is not None else state.session.tag if state.session else 0
    answer = records.Reply(
        request_type=request_type,
        request_sequence=sequence,
        refusal=refusal,
        cause=state.cause,
        detail=0,
    )
    return Send(answer, tag)


# ---------------------------------------------------------------- heartbeats and motion


def heartbeat(state: Controller, event: HeartbeatReceived, now_s: float) -> Outcome:
    """A stop cause is a level in the runtime's heartbeat: it stops even when the stop frame was lost.

    Only a holder of the key can say it: a withdrawing one withdraws, also after the stop that came first.
    """
    if event.cause in WITHDRAWING and state.session is not None and not state.session.withdrawn:
        state = _with_motion(state, now_s)
    if event.cause is not StopCause.NONE and state.session is not None and state.session.live:
        return stop(state, event.cause)
    return replace(state, heartbeat_fresh=event.fresh), ()


def heartbeat_permitted(state: Controller, event: HeartbeatReceived, now_s: float) -> Outcome:
    """Cutting mode is a level as well: it lasts while the heartbeats say READY or CUT with this epoch."""
    upheld = event.code in (RuntimeCode.READY, RuntimeCode.CUT) and event.epoch == state.epoch
    if not upheld and event.cause is StopCause.NONE:
        return stop(state, StopCause.PROTOCOL_VIOLATION)
    return heartbeat(state, event, now_s)


def heartbeat_cutting(state: Controller, event: HeartbeatReceived, now_s: float) -> Outcome:
    """Fresh CUT with this epoch keeps the arm moving; once given, anything else stops it: there is no pause."""
    orders_cut = event.code is RuntimeCode.CUT and event.epoch == state.epoch
    seen, effects = heartbeat(state, event, now_s)
    if seen.state is not ControllerState.CUTTING:
        return seen, effects
    if state.cut_ordered and not orders_cut:
        return stop(seen, StopCause.PROTOCOL_VIOLATION)
    if state.cut_ordered and not event.fresh:
        return stop(seen, StopCause.HEARTBEAT_LOST)
    return replace(seen, cut_ordered=orders_cut and event.fresh), ()


def measured(state: Controller, event: JointsMeasured, _now_s: float) -> Outcome:
    return replace(state, measured_u=event.joints_u), ()


def finished(state: Controller, event: PathFinished, now_s: float) -> Outcome:
    """The end of the retract: cutting mode off, the permit is spent. It counts only where the arm was free to move.

    The measured arm must be back where it began: a retract that ends elsewhere is a deviation.
    """
    if not state.may_move:
        return state, ()
    if not at_start(RequestCase(state, event, now_s)):
        return stop(state, StopCause.TRACKING_DEVIATION)
    done = replace(
        state,
        state=ControllerState.DONE,
        permit=None,
        issued=None,
        cut_ordered=False,
        device=DeviceCycle.UNSEEN,
    )
    return done, ()


def permit_ages(state: Controller, _event: Tick, now_s: float) -> Outcome:
    assert state.session is not None  # noqa: S101 - PERMITTED has a session
    if 0.0 <= now_s - state.permit_issued_at_s <= state.session.permit_lifetime_s:
        return state, ()
    return stop(state, StopCause.PERMIT_EXPIRED)


def cut_must_follow(state: Controller, _event: Tick, now_s: float) -> Outcome:
    """A START whose heartbeat never says CUT is dropped within the time-out."""
    assert state.session is not None  # noqa: S101 - CUTTING has a session
    if state.cut_ordered or 0.0 <= now_s - state.started_at_s <= state.session.timeout_s:
        return state, ()
    return stop(state, StopCause.HEARTBEAT_LOST)


Handler = Callable[[Controller, Any, float], Outcome]
S = ControllerState

TABLE: dict[tuple[ControllerState, type], Handler] = {
    (S.OPEN, CollectReceived): collect,
    (S.LOADED, CollectReceived): collect,
    (S.OPEN, PathChecked): path_checked,
    (S.LOADED, PathChecked): path_checked,
    (S.PERMITTED, HeartbeatReceived): heartbeat_permitted,
    (S.PERMITTED, Tick): permit_ages,
    (S.CUTTING, HeartbeatReceived): heartbeat_cutting,
    (S.CUTTING, PathFinished): finished,
    (S.CUTTING, Tick): cut_must_follow,
}
"""What only one state answers to."""

EVERYWHERE: dict[type, Handler] = {
    OpenReceived: open_received,
    NonceRequested: give_nonce,
    PermitReceived: permit_received,
    StartReceived: start_received,
    ResetReceived: reset_received,
    AcknowledgeReceived: acknowledge_received,
    WithdrawReceived: withdraw_received,
    HeartbeatReceived: heartbeat,
    JointsMeasured: measured,
    StopReceived: stop_received,
    HeartbeatLost: heartbeat_lost,
    FaultArisen: fault,
    BoneMoved: bone_moved,
    LimitsChanged: limits_changed,
    InputsChanged: inputs_changed,
    Persisted: persisted,
    PersistFailed: persist_failed,
}
"""What every state answers to: requests are refused with their reason, stops always stop."""
