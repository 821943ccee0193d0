"""The simulated controller as one transition table: ``step(state, event, now_s) -> (state, effects)``.

Pure: no bus, no clock, no random number. ``cutgate.firmware_sim.loop`` feeds it events and carries out its effects.
Everything that enables is judged here against what the controller holds at that moment (``rules``); everything
that stops goes through :func:`stop`, which voids permit, nonces and transfers and starts a new epoch.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from cutgate.firmware_sim.rules import (
    ACKNOWLEDGE_RULES,
    OPEN_RULES,
    PERMIT_RULES,
    RESET_RULES,
    START_RULES,
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
)
from cutgate.protocol import records
from cutgate.protocol.records import digest
from cutgate.protocol.states import (
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
        epoch=(state.epoch + 1) % 256,
        session=replace(state.session, live=False) if state.session else None,
        issued=None,
        permit=None,
        device=DeviceCycle.UNSEEN,
        cut_ordered=False,
        measured_u=None,
        holdings=replace(state.holdings, path=None, ends=None),
    )


def stop_and_withdraw(state: Controller, cause: StopCause) -> Outcome:
    """Stop; if the cause says that the bone is elsewhere, no registration named before holds any more.

    A withdrawal withdraws the earlier ones as well: it is the operator's only command for a bone that has moved, and then
    they are no better. Too much costs another registration, too little a cut in the wrong place.
    """
    if cause in WITHDRAWING:
        state = replace(state, memory=state.memory.all_withdrawn)
    return stop(state, cause)


def stop_received(state: Controller, event: StopReceived, _now_s: float) -> Outcome:
    is_end = event.code is StopCode.END and event.cause not in WITHDRAWING
    if is_end and state.state is not ControllerState.CUTTING:
        return end_session(state)
    return stop_and_withdraw(state, event.cause)


def end_session(state: Controller) -> Outcome:
    """The runtime is done. A latched fault stays latched."""
    resting = ControllerState.FAULT if state.state is ControllerState.FAULT else ControllerState.INHIBITED
    ended = replace(_void(state), state=resting, session=None, heartbeat_fresh=False)
    return ended, (AbortTransfers(), CloseLink())


def heartbeat_lost(state: Controller, _event: HeartbeatLost, _now_s: float) -> Outcome:
    if state.session is None:
        return state, ()
    if not state.session.live:  # the stop came first; now the peer is gone as well
        return replace(state, session=None, heartbeat_fresh=False), (CloseLink(),)
    stopped, effects = stop(state, StopCause.HEARTBEAT_LOST)
    return replace(stopped, session=None, heartbeat_fresh=False), (*effects, CloseLink())


def fault(state: Controller, event: FaultArisen, _now_s: float) -> Outcome:
    return stop_and_withdraw(state, event.cause)


def bone_moved(state: Controller, _event: BoneMoved, _now_s: float) -> Outcome:
    return stop_and_withdraw(state, StopCause.BONE_MOVED)


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
    """A session is opened once the name of its registration cannot be forgotten any more."""
    refusal = first_refusal(OPEN_RULES, RequestCase(state, event.request, now_s))
    if refusal is not Refusal.ACCEPTED:
        return state, (_reply(state, event.request, event.sequence, refusal, session=0),)
    memory = state.memory.naming(event.request.registration_digest)
    return open_session(state, event) if memory == state.memory else _await_memory(state, event, memory)


def open_session(state: Controller, event: OpenReceived) -> Outcome:
    request = event.request
    timing, nonces = request.timing, (state.identity.boot_nonce, request.runtime_nonce)
    session = ControllerSession(
        tag=records.session_tag(*nonces),
        digest=records.session_digest(*nonces),
        registration=request.registration_digest,
        configuration=request.configuration_digest,
        verifier=request.verifier_version,
        permit_lifetime_s=timing.permit_lifetime_s,
        start_lifetime_s=timing.start_lifetime_ms / 1000,
        start_tolerance_mm=timing.start_tolerance_um / 1000,
        start_tolerance_deg=timing.start_tolerance_mdeg / 1000,
        approach_clearance_um=timing.approach_clearance_um,
        approach_speed_percent=timing.approach_speed_percent,
        heartbeat_s=timing.heartbeat_ms / 1000,
        timeout_s=timing.timeout_ms / 1000,
    )
    latched = state.state is ControllerState.FAULT
    opened = replace(
        _void(state),
        state=ControllerState.FAULT if latched else ControllerState.OPEN,
        session=session,
        heartbeat_fresh=False,
    )
    answer = records.Opened(epoch=opened.epoch, state=opened.state, cause=opened.cause)
    return opened, (OpenLink(session), Send(answer, session.tag))


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
    refusal = first_refusal(PERMIT_RULES, RequestCase(state, event.permit, now_s))
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
    pressed = int(state.inputs.device_pressed)
    return permitted, (_reply(permitted, event.permit, event.sequence, Refusal.ACCEPTED, detail=pressed),)


def start_received(state: Controller, event: StartReceived, now_s: float) -> Outcome:
    refusal = first_refusal(START_RULES, RequestCase(state, event.start, now_s))
    if refusal is not Refusal.ACCEPTED:
        return _refuse(state, event.start, event.sequence, refusal)
    cutting = replace(
        state, state=ControllerState.CUTTING, issued=None, cut_ordered=False, started_at_s=now_s
    )
    return cutting, (_reply(cutting, event.start, event.sequence, Refusal.ACCEPTED),)


def reset_received(state: Controller, event: ResetReceived, now_s: float) -> Outcome:
    refusal = first_refusal(RESET_RULES, RequestCase(state, event.reset, now_s))
    if refusal is not Refusal.ACCEPTED:
        return _refuse(state, event.reset, event.sequence, refusal)
    unlatched = replace(state.memory, latched=StopCause.NONE)
    return _await_memory(replace(state, issued=None), event, unlatched)


def leave_fault(state: Controller, event: ResetReceived) -> Outcome:
    reset = replace(state, state=ControllerState.OPEN)
    return reset, (_reply(reset, event.reset, event.sequence, Refusal.ACCEPTED),)


def acknowledge_received(state: Controller, event: AcknowledgeReceived, now_s: float) -> Outcome:
    """Only the cause that stands is acknowledged, once it is gone; the operator has to have seen it."""
    request = records.Acknowledge(cause=event.cause)
    refusal = first_refusal(ACKNOWLEDGE_RULES, RequestCase(state, request, now_s))
    acknowledged = replace(state, cause=StopCause.NONE) if refusal is Refusal.ACCEPTED else state
    return acknowledged, (_reply(acknowledged, request, event.sequence, refusal),)


# ---------------------------------------------------------------- what is remembered


def _await_memory(state: Controller, event: OpenReceived | ResetReceived, memory: Memory) -> Outcome:
    """What enables is answered once it is durable; until then nothing has changed."""
    return replace(state, awaiting=Awaiting(event, memory)), (Persist(memory),)


def persisted(state: Controller, event: Persisted, _now_s: float) -> Outcome:
    """What waited for this is carried out; a stop in between has voided it."""
    known, awaiting = replace(state, written=event.memory), state.awaiting
    if awaiting is None or awaiting.memory != event.memory:
        return known, ()
    settled = replace(known, memory=event.memory, awaiting=None)
    if isinstance(awaiting.event, OpenReceived):
        return open_session(settled, awaiting.event)
    return leave_fault(settled, awaiting.event)


def persist_failed(state: Controller, _event: PersistFailed, _now_s: float) -> Outcome:
    """What waited is refused; what must not be forgotten is written again in every cycle, and nothing starts before."""
    awaiting, unknown = state.awaiting, replace(state, awaiting=None, written=None)
    match awaiting.event if awaiting else None:
        case OpenReceived(request, sequence) | ResetReceived(request, sequence):
            return unknown, (_reply(state, request, sequence, Refusal.MEMORY_FAILED),)
    if state.state is ControllerState.FAULT:
        return unknown, ()
    return stop(unknown, StopCause.INTERNAL_ERROR)


def _refuse(state: Controller, request: records.Record, sequence: int, refusal: Refusal) -> Outcome:
    """Refuse with the reason. A wrong authentication code is a masquerade and latches."""
    answer = _reply(state, request, sequence, refusal)
    used = replace(state, issued=None)
    if refusal is not Refusal.MAC_INVALID:
        return used, (answer,)
    stopped, effects = stop(used, StopCause.AUTHENTICATION_FAILED)
    return stopped, (*effects, answer)


def _reply(
    state: Controller,
    request: records.Record,
    sequence: int,
    refusal: Refusal,
    session: int | None = None,
    detail: int = 0,
) -> Send:
    tag = session if session is not None else state.session.tag if state.session else 0
    answer = records.Reply(
        request_type=request.TYPE,
        request_sequence=sequence,
        refusal=refusal,
        cause=state.cause,
        detail=detail,
    )
    return Send(answer, tag)


# ---------------------------------------------------------------- heartbeats and motion


def heartbeat(state: Controller, event: HeartbeatReceived, _now_s: float) -> Outcome:
    """A stop cause is a level in the runtime's heartbeat: it stops even when the stop frame was lost."""
    if event.cause is not StopCause.NONE and state.session is not None and state.session.live:
        return stop_and_withdraw(state, event.cause)
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
