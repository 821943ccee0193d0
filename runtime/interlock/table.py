"""The interlock as one transition table: ``step(state, event, now_s) -> (state, effects)``.

Pure: no bus, no disk, no clock, no random number. Two rules stand above all others:

* What enables (permit, start, reset, a more permissive heartbeat) passes an AUTHORISING phase: the decision is
  committed, and only :class:`RecordDurable` with the pending token, after every permissive has been judged again
  at that moment, lets it leave.
* What disables leaves in the same step, from every phase.

What carries no code (a reply, a nonce, a receipt, a fault frame) may be anybody's. It denies; that a permit, a start or a
reset was accepted is believed by the controller's heartbeat alone.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from cutgate.protocol import records
from cutgate.protocol.records import joints_to_memory
from cutgate.protocol.states import WITHDRAWING, ControllerState, Purpose, Refusal, StopCause, StopCode
from cutgate.runtime.interlock.permissive import Permissive
from cutgate.runtime.interlock.permissives import (
    AT_START,
    COLLECTED,
    FOR_PERMIT,
    FOR_RESET,
    FOR_START,
    IDENTITY,
    Evaluate,
    all_hold,
    awaiting_confirmation,
    failing,
    measured_now,
    protocol_version,
    unrecoverable,
)
from cutgate.runtime.interlock.phases import AUTHORISING, ENDED, MOVING, PHASES, SIGNED
from cutgate.runtime.interlock.refusals import told
from cutgate.runtime.interlock.state import (
    Announced,
    BlockConfirmed,
    CommandGiven,
    Commit,
    ControllerView,
    DeviceCycle,
    Dropped,
    Effect,
    Event,
    Failed,
    FaultReceived,
    Gone,
    HeartbeatLost,
    HeartbeatReceived,
    Interlock,
    Job,
    JointsMeasured,
    LogChanged,
    NonceReceived,
    OpenLink,
    OperatorCommand,
    OtherVersionAnnounced,
    ParameterReceived,
    PathConfirmed,
    Phase,
    ProgressReported,
    RecordDurable,
    Refused,
    ReplyReceived,
    SeekWitness,
    Send,
    SendBlock,
    SendStop,
    SendWithdraw,
    SessionIdentity,
    SessionOpened,
    Tick,
    UseSession,
    VerdictReady,
    Verify,
    WithdrawalSent,
    Withheld,
    WitnessSought,
)
from cutgate.runtime.interlock.tracking import Deviation, TrackingMonitor

Outcome = tuple[Interlock, tuple[Effect, ...]]


def step(state: Interlock, event: Event, now_s: float) -> Outcome:
    """One transition. What is not listed changes nothing, and an ended session answers to nothing."""
    if state.phase in ENDED:
        return state, ()
    if state.began_s is None:  # the first event starts the clocks
        state = replace(state, began_s=now_s, since_s=now_s)
    handler = TABLE.get((state.phase, type(event))) or EVERYWHERE[type(event)]
    return handler(state, event, now_s)


def _reasons(permissives: tuple[Permissive, ...]) -> str:
    return "; ".join(map(str, permissives))


def _enter(state: Interlock, phase: Phase, now_s: float, **changes: Any) -> Interlock:
    return replace(state, phase=phase, since_s=now_s, **changes)


# ---------------------------------------------------------------- ending


def stop(state: Interlock, cause: StopCause, reason: str, now_s: float) -> Outcome:
    """Stop at once. Permit, nonce and pending record are void; the first cause is kept.

    A later cause leaves as well, once: it may latch. A lost frame is made good by the heartbeat's level. Each stop voids
    what waits behind it: a Withdraw that was not answered leaves again.
    """
    if cause is StopCause.NONE:  # whoever stops without a cause breaks the protocol
        cause = StopCause.PROTOCOL_VIOLATION
    told_cause = state.told(cause)
    sent = state.stops_sent | {told_cause}
    withdraw = (SendWithdraw(state.job.place),) if state.withdraw_due else ()
    if state.phase is Phase.STOPPING:
        if sent == state.stops_sent:
            return state, ()
        again = replace(state, stops_sent=sent, withdraw_sent_s=now_s)
        return again, (SendStop(StopCode.STOP, told_cause), *withdraw)
    withheld = (Withheld(state.token),) if state.phase in AUTHORISING else ()
    phase = Phase.STOPPING if state.session else Phase.STOPPED
    stopped = _enter(
        state,
        phase,
        now_s,
        cause=cause,
        reason=reason,
        permit=None,
        nonce=None,
        tracking=None,
        stops_sent=sent,
        withdraw_sent_s=now_s,
        answer_due=cause is StopCause.AUTHENTICATION_FAILED and state.phase in SIGNED,
    )
    return stopped, (*_link(state), SendStop(StopCode.STOP, told_cause), *withdraw, *withheld)


def _withdrawn(state: Interlock) -> Interlock:
    """The registration may never be permitted again; a controller with a session is told, behind the stop, and answers."""
    if state.registration_withdrawn:
        return state
    return replace(state, registration_withdrawn=True, withdraw_due=state.session is not None)


def _stopped_by(state: Interlock, cause: StopCause, reason: str, now_s: float) -> Outcome:
    """A cause that the controller's heartbeat names, under its tag; it may withdraw."""
    return stop(_withdrawn(state) if _withdraws(state, cause) else state, cause, reason, now_s)


def _withdraws(state: Interlock, cause: StopCause) -> bool:
    """Whether the controller says by it that the bone has moved in this session.

    What the session was opened on is older than that, and comes back with every stop, whoever has sent it. Where the
    bone has moved again meanwhile the controller remembers that, and tells it as the next session is opened.
    """
    return cause in WITHDRAWING and cause is not state.held_on


def _link(state: Interlock) -> tuple[Effect, ...]:
    """While OPEN is on its way the controller may have opened already: a stop is sent under the new session's tag."""
    return (OpenLink(state.session),) if state.phase is Phase.OPENING and state.session else ()


def refuse(state: Interlock, reason: str, now_s: float) -> Outcome:
    """Not admitted: the session ends in order, nothing was enabled."""
    refused = _enter(state, Phase.REFUSED, now_s, cause=StopCause.NOT_ADMITTED, reason=reason, permit=None)
    return refused, (SendStop(StopCode.END, StopCause.NOT_ADMITTED),)


def failed(state: Interlock, event: Failed, now_s: float) -> Outcome:
    return stop(state, event.cause, event.reason, now_s)


def gone(state: Interlock, event: Gone, now_s: float) -> Outcome:
    """The stop leaves if it still can. Nobody waits for its confirmation: without heartbeats the controller stops."""
    stopped, effects = stop(state, event.cause, event.reason, now_s)
    return _stopped(stopped, now_s), effects


def _stopped(state: Interlock, now_s: float) -> Interlock:
    """Nothing is waited for any more; what the controller has not confirmed of a withdrawal is told."""
    unheard = WITHDRAWAL_UNHEARD if state.withdraw_due else ""
    return _enter(state, Phase.STOPPED, now_s, reason=f"{state.reason}{unheard}")


WITHDRAWAL_UNHEARD = (
    "; the controller has not confirmed the withdrawal: only this log directory knows of it. Before the controller is "
    "used with another one, say withdraw in a session there"
)


def heartbeat_lost(state: Interlock, event: HeartbeatLost, now_s: float) -> Outcome:
    reason = f"no fresh controller heartbeat within {state.job.timing.timeout_ms} ms{_late(event)}"
    return stop(replace(state, heartbeat_fresh=False), StopCause.HEARTBEAT_LOST, reason, now_s)


def fault_received(state: Interlock, event: FaultReceived, now_s: float) -> Outcome:
    """It carries no code: it stops, and withdraws nothing whatever it claims."""
    late = _late(event) if event.cause is StopCause.HEARTBEAT_LOST else ""
    return stop(state, event.cause, f"the controller reports {event.cause.name}{late}", now_s)


def _late(event: HeartbeatLost | FaultReceived) -> str:
    """Which side was late, as far as this side knows, and who let nobody through."""
    crowd = f"; {event.crowd}" if event.crowd else ""
    if event.paused_ms:
        return f"; this computer stood still for {event.paused_ms} ms{crowd}"
    return f"; this computer was not late{crowd}"


def rebooted(state: Interlock, _event: Announced | OtherVersionAnnounced, now_s: float) -> Outcome:
    return stop(
        state, StopCause.PEER_REBOOTED, "the controller announced itself anew during the session", now_s
    )


def log_changed(state: Interlock, event: LogChanged, now_s: float) -> Outcome:
    changed = replace(state, log=event.log)
    if state.log.writable and not event.log.writable:
        return stop(changed, StopCause.AUDIT_FAILED, "the audit log can no longer be written", now_s)
    return changed, ()


def command_given(state: Interlock, event: CommandGiven, now_s: float) -> Outcome:
    """Commands that apply everywhere; start, acknowledge, reset and confirm only where the table lists them."""
    match event.command:
        case OperatorCommand.STOP:
            return stop(state, StopCause.OPERATOR_STOP, "the operator said stop", now_s)
        case OperatorCommand.WITHDRAW:
            reason = "the registration was withdrawn"
            return stop(_withdrawn(state), StopCause.REGISTRATION_WITHDRAWN, reason, now_s)
        case OperatorCommand.QUIT:
            return quit_session(state, now_s, event.what)
    return state, (
        Refused(event.command, f"{event.command} does not apply while {PHASES[state.phase].situation}"),
    )


def quit_session(state: Interlock, now_s: float, signal: str = "") -> Outcome:
    """Leave, on the operator's command or a signal. While the arm may move this is a stop; otherwise the session ends in order."""
    reason = f"{signal} ended the program" if signal else "the operator quit"
    if state.phase in MOVING:
        return stop(state, StopCause.OPERATOR_QUIT, reason, now_s)
    withheld = (Withheld(state.token),) if state.phase in AUTHORISING else ()
    left = _enter(state, Phase.STOPPED, now_s, cause=StopCause.OPERATOR_QUIT, reason=reason, permit=None)
    return left, (*_link(state), SendStop(StopCode.END, StopCause.OPERATOR_QUIT), *withheld)


# ---------------------------------------------------------------- opening


def announced(state: Interlock, event: Announced, now_s: float) -> Outcome:
    announce = event.announce
    request = _open(state.job, announce, event.nonce)
    if not records.opens(request):
        return state, ()  # the next announcement brings another nonce
    session = SessionIdentity(request, announce.serial, announce.time_scale)
    seen = replace(state, session=session, announced_version=announce.protocol_version)
    refusing = failing(IDENTITY, seen, now_s)
    if refusing:
        return refuse(seen, _reasons(refusing), now_s)
    return _enter(seen, Phase.OPENING, now_s), (UseSession(session), Send(request))


def other_version(state: Interlock, event: OtherVersionAnnounced, now_s: float) -> Outcome:
    """Nothing but its version can be read."""
    seen = replace(state, announced_version=event.version)
    return refuse(seen, _reasons(failing((protocol_version,), seen, now_s)), now_s)


def _open(job: Job, announce: records.Announce, nonce: bytes) -> records.Open:
    return records.Open(
        protocol_version=records.PROTOCOL_VERSION,
        announce_nonce=announce.announce_nonce,
        runtime_nonce=nonce,
        identity_digest=announce.identity_digest,
        registration_digest=job.registration,
        place_digest=job.place,
        registration_time_us=job.registration_time_us,
        configuration_digest=job.configuration,
        verifier_version=job.verifier,
        timing=job.timing,
    )


def opened(state: Interlock, event: SessionOpened, now_s: float) -> Outcome:
    """What its code does not prove opens nothing. What is due of before is told at once."""
    assert state.session is not None  # noqa: S101 - OPENING has a session
    if not event.authentic:
        return state, (Dropped(f"an OPENED that no holder of the key made{_our_key(state)}"),)
    answer = event.opened
    seen = replace(state, opened=answer, held_on=answer.cause, epoch=answer.epoch)
    effects: tuple[Effect, ...] = (OpenLink(state.session),)
    if answer.withdrawal_due:
        age_s = None if answer.motion_age_s == records.AGE_UNKNOWN else answer.motion_age_s
        effects = (*effects, SendWithdraw(records.NO_PLACE, age_s))
    if answer.log != records.NO_TREE_HEAD:
        effects = (*effects, SeekWitness(answer.log))
    if answer.state is ControllerState.OPEN and answer.cause is StopCause.NONE:
        return _enter(seen, Phase.COLLECTING, now_s), (*effects, Send(records.Collect()))
    return _enter(seen, Phase.HELD, now_s), effects


def open_refused(state: Interlock, event: ReplyReceived, now_s: float) -> Outcome:
    if event.request_type != records.Open.TYPE:
        return not_pending(state, event, now_s)
    key = _our_key(state) if event.refusal is Refusal.MAC_INVALID else ""
    return refuse(state, f"the controller refused the session: {told(event.refusal)}{key}", now_s)


def _our_key(state: Interlock) -> str:
    return f" (this side's has the fingerprint {state.job.key_fingerprint})"


def announced_again(state: Interlock, event: Announced, now_s: float) -> Outcome:
    """At first it crossed our OPEN; later it means that OPEN was lost, and the same one is sent again.

    Two on their way at the same time would disturb each other's transfer; half the reply's time rules that out.
    """
    assert state.session is not None  # noqa: S101 - OPENING has a session
    if event.announce.announce_nonce != state.session.announce_nonce:
        return announced(state, event, now_s)
    if not now_s - state.since_s >= state.job.deadlines.reply_timeout_s / 2:
        return state, ()
    return state, (Send(state.session.request),)


def withdrawal_sent(state: Interlock, event: WithdrawalSent, _now_s: float) -> Outcome:
    return replace(state, barrier_us=event.barrier_us), ()


def witness_sought(state: Interlock, event: WitnessSought, _now_s: float) -> Outcome:
    return replace(state, witness=event), ()


# ---------------------------------------------------------------- a controller that is held


def command_while_held(state: Interlock, event: CommandGiven, now_s: float) -> Outcome:
    view = state.controller
    if event.command is OperatorCommand.ACKNOWLEDGE:
        return acknowledge(state, view)
    if event.command is OperatorCommand.RESET:
        missing = failing(FOR_RESET, state, now_s)
        if missing:
            return state, (Refused(event.command, _reasons(missing)),)
        return _enter(state, Phase.NONCE_RESET, now_s), (Send(records.NonceRequest(purpose=Purpose.RESET)),)
    return command_given(state, event, now_s)


def acknowledge(state: Interlock, view: ControllerView | None) -> Outcome:
    """For the cause that the controller reports, no other; what still stands against it is said by the controller."""
    if view is None:
        reason = "the controller has not yet reported what it carries: wait for that, then say acknowledge"
    elif view.cause is StopCause.NONE:
        reason = "it is acknowledged already: say reset"
    else:
        acknowledgement = records.Acknowledge(epoch=state.epoch, cause=view.cause)
        return replace(state, acknowledged=view.cause), (Send(acknowledgement),)
    return state, (Refused(OperatorCommand.ACKNOWLEDGE, reason),)


def acknowledge_answered(state: Interlock, event: ReplyReceived, now_s: float) -> Outcome:
    if _denies(event, records.Acknowledge):
        return state, (
            Refused(OperatorCommand.ACKNOWLEDGE, f"the controller refused: {told(event.refusal)}"),
        )
    return not_pending(state, event, now_s)


def heartbeat_while_resetting(state: Interlock, event: HeartbeatReceived, now_s: float) -> Outcome:
    """A standing cause and a latch are expected here; another epoch is a new stop, which ended the session."""
    seen, view = _see(state, event), event.view
    if view.epoch == state.epoch:
        return seen, ()
    reason = f"the controller's epoch is {view.epoch}, the session's {state.epoch}"
    return _stopped_by(seen, view.cause, reason, now_s)


def heartbeat_while_held(state: Interlock, event: HeartbeatReceived, now_s: float) -> Outcome:
    seen, effects = heartbeat_while_resetting(state, event, now_s)
    released = event.view.state is ControllerState.OPEN and event.view.cause is StopCause.NONE
    if seen.phase is Phase.HELD and released:
        let_go = _enter(seen, Phase.COLLECTING, now_s, held_on=StopCause.NONE)
        return let_go, (Send(records.Collect()),)
    return seen, effects


def reset_nonce(state: Interlock, event: NonceReceived, now_s: float) -> Outcome:
    if event.purpose is not Purpose.RESET or event.epoch != state.epoch:
        return state, (Dropped("a nonce that is not for this reset"),)
    return _authorise(
        state, Phase.AUTHORISING_RESET, Purpose.RESET, _reset(state, event.nonce), now_s, nonce=event.nonce
    )


def _reset(state: Interlock, nonce: bytes) -> records.Reset:
    """For the fault that the operator has acknowledged, no other."""
    assert state.session is not None  # noqa: S101 - a held controller has a session
    return records.Reset(
        nonce=nonce, epoch=state.epoch, cause=state.acknowledged, session_digest=state.session.digest
    )


def reset_durable(state: Interlock, event: RecordDurable, now_s: float) -> Outcome:
    """The only place a reset leaves from."""
    nothing_leaves = _withhold(state, event, FOR_RESET, Phase.HELD, now_s)
    if nothing_leaves:
        return nothing_leaves
    assert state.nonce is not None  # noqa: S101 - set by reset_nonce
    return _enter(state, Phase.RESETTING, now_s), (Send(_reset(state, state.nonce)),)


def reset_refused(state: Interlock, event: ReplyReceived, now_s: float) -> Outcome:
    if not _denies(event, records.Reset):
        return not_pending(state, event, now_s)
    reason = f"the controller refused the reset: {told(event.refusal)}"
    return _enter(state, Phase.HELD, now_s, nonce=None), (Refused(OperatorCommand.RESET, reason),)


def heartbeat_after_reset(state: Interlock, event: HeartbeatReceived, now_s: float) -> Outcome:
    """It was accepted once the controller has left its fault."""
    seen, effects = heartbeat_while_resetting(state, event, now_s)
    if seen.phase is not Phase.RESETTING or event.view.state is ControllerState.FAULT:
        return seen, effects
    return heartbeat_while_held(_enter(seen, Phase.HELD, now_s, nonce=None), event, now_s)


# ---------------------------------------------------------------- collecting, uploading, verifying


def parameter(state: Interlock, event: ParameterReceived, now_s: float) -> Outcome:
    data = event.record.body()
    kind = {records.Limits: "limits", records.Calibration: "calibration", records.Tool: "tool"}[
        type(event.record)
    ]
    got = replace(state, collected=replace(state.collected, **{kind: data}))
    if not got.collected.complete:
        return got, ()
    refusing = failing(COLLECTED, got, now_s)
    if refusing:
        return refuse(got, _reasons(refusing), now_s)
    return _enter(got, Phase.UPLOADING, now_s), (SendBlock(got.block),)


def parameter_changed(state: Interlock, event: ParameterReceived, now_s: float) -> Outcome:
    """Parameters outside COLLECTING mean that something changed under us."""
    cause = (
        StopCause.LIMITS_CHANGED
        if isinstance(event.record, records.Limits)
        else StopCause.CALIBRATION_CHANGED
    )
    return stop(state, cause, "the controller sent parameters that were not asked for", now_s)


def block_stored(state: Interlock, event: BlockConfirmed, _now_s: float) -> Outcome:
    if event.index != state.block:
        return state, (Dropped(f"receipt for block {event.index} while block {state.block} is under way"),)
    following = state.block + 1
    if following >= state.job.blocks:
        return state, ()
    return replace(state, block=following), (SendBlock(following),)


def path_stored(state: Interlock, event: PathConfirmed, now_s: float) -> Outcome:
    """Verify even what the controller refused: the operator wants to know where to move the bone."""
    return verify_if_measured(replace(state, stored=event.stored), now_s)


def verify_if_measured(state: Interlock, now_s: float) -> Outcome:
    """The approach begins where the arm stands: without young measured joints there is nothing to verify yet."""
    joints_u = measured_now(state, now_s)
    if state.stored is None or joints_u is None:
        return state, ()
    request = state.token + 1
    return _enter(state, Phase.VERIFYING, now_s, token=request), (Verify(request, joints_u),)


def measured_while_uploading(state: Interlock, event: JointsMeasured, now_s: float) -> Outcome:
    seen, _ = measured(state, event, now_s)
    return verify_if_measured(seen, now_s)


def verdict_ready(state: Interlock, event: VerdictReady, now_s: float) -> Outcome:
    if event.verdict.request != state.token:
        return state, (Dropped("a verdict for another request"),)
    admitted = _enter(state, Phase.ADMITTED, now_s, verdict=event.verdict)
    return offer_permit(admitted, now_s)


def offer_permit(state: Interlock, now_s: float) -> Outcome:
    """Ask for the permit's nonce once everything holds; end if something never can."""
    final = unrecoverable(state, now_s)
    if final:
        return refuse(state, _reasons(final), now_s)
    if not all_hold(FOR_PERMIT, state, now_s):
        return state, ()
    asked = _enter(state, Phase.NONCE_PERMIT, now_s, nonce_at_s=now_s)
    return asked, (Send(records.NonceRequest(purpose=Purpose.PERMIT)),)


def heartbeat_while_admitted(state: Interlock, event: HeartbeatReceived, now_s: float) -> Outcome:
    seen, effects = heartbeat(state, event, now_s)
    return offer_permit(seen, now_s) if seen.phase is Phase.ADMITTED else (seen, effects)


def command_while_admitted(state: Interlock, event: CommandGiven, now_s: float) -> Outcome:
    """A warning counts as confirmed only by its own name, and only here, where it has been shown."""
    if event.command is not OperatorCommand.CONFIRM:
        return command_given(state, event, now_s)
    awaited = awaiting_confirmation(state)
    if event.what not in awaited:
        waits = f"say confirm {awaited[0]}" if awaited else "none waits"
        named = f"{event.what} is no warning that waits to be confirmed" if event.what else "name the warning"
        return state, (Refused(event.command, f"{named}; {waits}"),)
    return offer_permit(replace(state, confirmed=state.confirmed | {event.what}), now_s)


def witness_sought_while_admitted(state: Interlock, event: WitnessSought, now_s: float) -> Outcome:
    seen, _ = witness_sought(state, event, now_s)
    return offer_permit(seen, now_s)


# ---------------------------------------------------------------- permit


def permit_nonce(state: Interlock, event: NonceReceived, now_s: float) -> Outcome:
    if event.purpose is not Purpose.PERMIT or event.epoch != state.epoch:
        return state, (Dropped("a nonce that is not for this permit"),)
    return _authorise(
        state, Phase.AUTHORISING_PERMIT, Purpose.PERMIT, _permit(state, event.nonce), now_s, nonce=event.nonce
    )


def _permit(state: Interlock, nonce: bytes) -> records.Permit:
    job, session, verdict = state.job, state.session, state.verdict
    assert session is not None and verdict is not None  # noqa: S101, PT018 - permissives of this phase
    assert verdict.approach is not None  # noqa: S101 - likewise
    return records.Permit(
        nonce=nonce,
        announce_nonce=session.announce_nonce,
        session_digest=session.digest,
        serial=session.serial,
        protocol_version=records.PROTOCOL_VERSION,
        epoch=state.epoch,
        limits_digest=verdict.limits,
        calibration_digest=verdict.calibration,
        tool_digest=verdict.tool,
        path_digest=verdict.path,
        registration_digest=job.registration,
        configuration_digest=job.configuration,
        verifier_version=job.verifier,
        start_joints_u=verdict.start_joints_u,
        branch=job.branch,
        approach=verdict.approach,
        lifetime_s=job.timing.permit_lifetime_s,
    )


def permit_durable(state: Interlock, event: RecordDurable, now_s: float) -> Outcome:
    """The only place a permit leaves from."""
    nothing_leaves = _withhold(state, event, FOR_PERMIT, Phase.ADMITTED, now_s)
    if nothing_leaves:
        return nothing_leaves
    assert state.nonce is not None  # noqa: S101 - set by permit_nonce
    permit = replace(_permit(state, state.nonce), log=event.log)
    return _enter(state, Phase.PERMITTING, now_s, permit=permit), (Send(permit),)


def permit_refused(state: Interlock, event: ReplyReceived, now_s: float) -> Outcome:
    if not _denies(event, records.Permit):
        return not_pending(state, event, now_s)
    return refuse(state, f"the controller refused the permit: {told(event.refusal)}", now_s)


def heartbeat_after_permit(state: Interlock, event: HeartbeatReceived, now_s: float) -> Outcome:
    """It was accepted once the controller reports so. The enabling device's cycle begins with that heartbeat."""
    seen, effects = heartbeat(state, event, now_s)
    if seen.phase is not Phase.PERMITTING or event.view.state is not ControllerState.PERMITTED:
        return seen, effects
    return _enter(seen, Phase.PERMITTED, now_s, device=_cycle(DeviceCycle.UNSEEN, event.view)), ()


# ---------------------------------------------------------------- start


def start_commanded(state: Interlock, event: CommandGiven, now_s: float) -> Outcome:
    if event.command is not OperatorCommand.START:
        return command_given(state, event, now_s)
    missing = failing(FOR_START, state, now_s)
    if missing:
        return state, (Refused(OperatorCommand.START, _reasons(missing)),)
    return _enter(state, Phase.NONCE_START, now_s), (Send(records.NonceRequest(purpose=Purpose.START)),)


def start_nonce(state: Interlock, event: NonceReceived, now_s: float) -> Outcome:
    if event.purpose is not Purpose.START or event.epoch != state.epoch:
        return state, (Dropped("a nonce that is not for this start"),)
    return _authorise(
        state, Phase.AUTHORISING_START, Purpose.START, _start(state, event.nonce), now_s, nonce=event.nonce
    )


def _start(state: Interlock, nonce: bytes) -> records.Start:
    assert state.session is not None and state.permit is not None  # noqa: S101, PT018 - PERMITTED has both
    return records.Start(
        nonce=nonce,
        epoch=state.epoch,
        session_digest=state.session.digest,
        permit_digest=state.permit.digest,
        start_joints_u=state.permit.start_joints_u,
    )


def start_durable(state: Interlock, event: RecordDurable, now_s: float) -> Outcome:
    """The only place a start leaves from, and with it the first heartbeat that says CUT."""
    nothing_leaves = _withhold(state, event, FOR_START, Phase.PERMITTED, now_s)
    if nothing_leaves:
        return nothing_leaves
    assert state.nonce is not None and state.session is not None  # noqa: S101, PT018 - AUTHORISING_START has both
    assert state.verdict is not None and state.verdict.trajectory is not None  # noqa: S101, PT018 - permissives
    scale, trajectory = state.session.time_scale, state.verdict.trajectory
    monitor = TrackingMonitor.begin(trajectory, state.job.timing, state.job.tracking, scale, now_s)
    start = replace(_start(state, state.nonce), log=event.log)
    return _enter(state, Phase.STARTING, now_s, tracking=monitor), (Send(start),)


def heartbeat_before_start(state: Interlock, event: HeartbeatReceived, now_s: float) -> Outcome:
    """The command ``start`` counts only after the device was pressed: released again, it must be said again."""
    seen, effects = heartbeat(state, event, now_s)
    if seen.phase is not state.phase or event.view.device_pressed:
        return seen, effects
    withheld = (Withheld(state.token),) if state.phase in AUTHORISING else ()
    reason = "the enabling device was released: hold it, then say start again"
    back = _enter(seen, Phase.PERMITTED, now_s, nonce=None)
    return back, (Refused(OperatorCommand.START, reason), *withheld)


def start_refused(state: Interlock, event: ReplyReceived, now_s: float) -> Outcome:
    if not _denies(event, records.Start):
        return not_pending(state, event, now_s)
    refused = _enter(state, Phase.PERMITTED, now_s, nonce=None, tracking=None)
    return refused, (
        Refused(OperatorCommand.START, f"the controller refused the start: {told(event.refusal)}"),
    )


# ---------------------------------------------------------------- cutting and watching


def heartbeat(state: Interlock, event: HeartbeatReceived, now_s: float) -> Outcome:
    """What the controller reports must fit the phase, and no cause may stand."""
    seen = _see(state, event)
    view = event.view
    if view.cause is not StopCause.NONE:
        return _stopped_by(seen, view.cause, f"the controller stopped: {view.cause.name}", now_s)
    if view.epoch != state.epoch:
        reason = f"the controller's epoch is {view.epoch}, the session's {state.epoch}"
        return stop(seen, StopCause.PROTOCOL_VIOLATION, reason, now_s)
    expected = PHASES[state.phase].expected
    if expected is None or view.state not in expected:
        reason = f"the controller reports {view.state.name} while {state.phase}"
        return stop(seen, StopCause.PROTOCOL_VIOLATION, reason, now_s)
    if state.phase in MOVING and not view.emergency_stop_clear:
        return stop(seen, StopCause.EMERGENCY_STOP, "the emergency stop is pressed", now_s)
    if state.phase in MOVING and not view.device_pressed and view.state is not ControllerState.DONE:
        return stop(seen, StopCause.DEVICE_RELEASED, "the enabling device is released", now_s)
    return seen, ()


def heartbeat_while_cutting(state: Interlock, event: HeartbeatReceived, now_s: float) -> Outcome:
    """The controller's word for the end is not enough: the joints it measures from then on decide."""
    seen, effects = heartbeat(state, event, now_s)
    if seen.phase is Phase.STARTING and event.view.state is ControllerState.CUTTING:
        return _enter(seen, Phase.CUTTING, now_s), effects
    if seen.phase is not state.phase or event.view.state is not ControllerState.DONE:
        return seen, effects
    too_early = _monitor(state).finished(now_s)
    return _deviates(seen, too_early, now_s) if too_early else (_enter(seen, Phase.FINISHING, now_s), ())


def measured_while_moving(state: Interlock, event: JointsMeasured, now_s: float) -> Outcome:
    """Every sample must lie where the verified path allows; one that does not stops in this step."""
    seen, _ = measured(state, event, now_s)
    joints = joints_to_memory(event.joints_u)
    monitor, deviation = _monitor(state).sample(joints, event.measured_s, now_s)
    seen = replace(seen, nearest=(deviation or monitor).nearest)
    return _deviates(seen, deviation, now_s) if deviation else (replace(seen, tracking=monitor), ())


def progress_while_moving(state: Interlock, event: ProgressReported, now_s: float) -> Outcome:
    monitor, deviation = _monitor(state).report(event.segment, event.fraction, now_s)
    return _deviates(state, deviation, now_s) if deviation else (replace(state, tracking=monitor), ())


def tick_while_moving(state: Interlock, event: Tick, now_s: float) -> Outcome:
    """Joints that do not come any more stop; so does progress, which is due once the controller has started."""
    cutting_since_s = state.since_s if state.phase is Phase.CUTTING else None
    missing = _monitor(state).overdue(now_s, cutting_since_s)
    return _deviates(state, missing, now_s) if missing else tick(state, event, now_s)


def _monitor(state: Interlock) -> TrackingMonitor:
    assert state.tracking is not None  # noqa: S101 - begun with the start
    return state.tracking


def _deviates(state: Interlock, deviation: Deviation, now_s: float) -> Outcome:
    stopped, effects = stop(state, StopCause.TRACKING_DEVIATION, deviation.reason, now_s)
    return stopped, (*effects, deviation)


def measured_while_finishing(state: Interlock, event: JointsMeasured, now_s: float) -> Outcome:
    """The cut is completed where the arm began, within the start tolerance; a sample too old to say so is passed over."""
    seen, effects = measured_while_moving(state, event, now_s)
    if seen.phase is not state.phase or measured_now(seen, now_s) is None:
        return seen, effects
    off = failing(AT_START, seen, now_s)
    if off:
        reason = f"the controller reports the end, but the arm is not back: {_reasons(off)}"
        return _deviates(seen, Deviation(reason, off), now_s)
    done = _enter(seen, Phase.DONE, now_s, tracking=None)
    return done, (SendStop(StopCode.END, StopCause.SESSION_ENDED),)


def heartbeat_while_stopping(state: Interlock, event: HeartbeatReceived, now_s: float) -> Outcome:
    """At rest is confirmed; until the deadline a Reply that is on its way may say why, or that a Withdraw has arrived."""
    news = state.controller is not None and state.controller.cause is StopCause.NONE  # else it stood before
    seen = _see(state, event)
    if news and _withdraws(seen, event.view.cause) and not seen.registration_withdrawn:
        return _tell_withdrawal(_withdrawn(seen), now_s)
    if event.view.state not in (ControllerState.INHIBITED, ControllerState.FAULT):
        return seen, ()
    if seen.withdraw_due and now_s - seen.withdraw_sent_s >= WITHDRAW_TIMEOUTS * state.job.timing.timeout_s:
        return _tell_withdrawal(seen, now_s)
    if seen.answer_due or seen.withdraw_due:
        return seen, ()
    return _stopped(seen, now_s), ()


WITHDRAW_TIMEOUTS = 2
"""After so many it is sent again: a stop voids what is on its way with it, on either side."""


def _tell_withdrawal(state: Interlock, now_s: float) -> Outcome:
    return replace(state, withdraw_sent_s=now_s), (SendWithdraw(state.job.place),)


def reply_while_stopping(state: Interlock, event: ReplyReceived, now_s: float) -> Outcome:
    if event.request_type == records.Withdraw.TYPE:
        answered = replace(state, withdraw_due=False)
        return answered, () if event.refusal is Refusal.ACCEPTED else (Dropped(_withdraw_refused(event)),)
    if not state.answer_due or event.refusal is not Refusal.MAC_INVALID:
        return not_pending(state, event, now_s)
    reason = f"{state.reason}: it refused with {told(event.refusal)}{_our_key(state)}"
    return replace(state, answer_due=False, reason=reason), ()


def _withdraw_refused(event: ReplyReceived) -> str:
    return f"a withdrawal, which the controller refused: {told(event.refusal)}"


def _see(state: Interlock, event: HeartbeatReceived) -> Interlock:
    return replace(
        state,
        controller=event.view,
        heartbeat_fresh=event.fresh,
        device=_cycle(state.device, event.view),
    )


def _cycle(cycle: DeviceCycle, view: ControllerView) -> DeviceCycle:
    if not view.device_pressed:
        return DeviceCycle.RELEASED
    return DeviceCycle.UNSEEN if cycle is DeviceCycle.UNSEEN else DeviceCycle.PRESSED


def command_while_stopping(state: Interlock, event: CommandGiven, now_s: float) -> Outcome:
    """The session is ending; a stop is repeated, and a withdrawal still reaches the controller."""
    if event.command in (OperatorCommand.STOP, OperatorCommand.WITHDRAW):
        return command_given(state, event, now_s)
    return state, (Refused(event.command, "the session is being stopped"),)


def measured(state: Interlock, event: JointsMeasured, _now_s: float) -> Outcome:
    return replace(state, joints_u=event.joints_u, measured_s=event.measured_s), ()


# ---------------------------------------------------------------- time


def tick(state: Interlock, _event: Tick, now_s: float) -> Outcome:
    """Every phase that waits has a deadline; one that has passed stops, or ends a wait without a result."""
    deadline = PHASES[state.phase].deadline
    if deadline is None:
        return state, ()
    bound_s, cause = deadline.seconds(state.job), deadline.cause
    if 0.0 <= now_s - state.since_s <= bound_s:
        return state, ()
    reason = f"{deadline.missed} within {bound_s:g} s"
    if cause is StopCause.NOT_ADMITTED:
        missing = failing(FOR_PERMIT, state, now_s) if state.phase is Phase.ADMITTED else ()
        return refuse(state, "; ".join((reason, *map(str, missing))), now_s)
    if state.phase is Phase.STOPPING:
        return _stopped(state, now_s), ()
    return stop(state, cause, reason, now_s)


# ---------------------------------------------------------------- small parts


def _authorise(
    state: Interlock, phase: Phase, purpose: Purpose, record: records.Record, now_s: float, **changes: Any
) -> Outcome:
    token = state.token + 1
    return _enter(state, phase, now_s, token=token, **changes), (Commit(token, purpose, record),)


def _withhold(
    state: Interlock, event: RecordDurable, which: tuple[Evaluate, ...], back: Phase, now_s: float
) -> Outcome | None:
    """Why nothing may leave although a record is durable: another record, too late, or a permissive. Else None."""
    if event.token != state.token:
        return _drop_token(state, event)
    if not 0.0 <= now_s - state.since_s <= state.job.deadlines.commit_deadline_s:
        return tick(state, Tick(), now_s)
    if not all_hold(which, state, now_s):
        return _enter(state, back, now_s, nonce=None), (Withheld(state.token),)
    return None


def _denies(event: ReplyReceived, request: type[records.Record]) -> bool:
    """Whether it refuses a request of this type; anybody may."""
    return event.request_type == request.TYPE and event.refusal is not Refusal.ACCEPTED


def not_pending(state: Interlock, event: ReplyReceived, _now_s: float) -> Outcome:
    """That something was accepted changes nothing; a refusal of what is not awaited is told."""
    if event.refusal is Refusal.ACCEPTED:
        return state, ()
    if event.request_type == records.Withdraw.TYPE:
        return state, (Dropped(_withdraw_refused(event)),)
    return state, (Dropped(f"a reply to something else while {state.phase}"),)


def _drop_token(state: Interlock, event: RecordDurable) -> Outcome:
    return state, (Dropped(f"durable record {event.token} while {state.token} is pending"),)


def ignored(state: Interlock, _event: Event, _now_s: float) -> Outcome:
    return state, ()


def dropped(state: Interlock, event: Event, _now_s: float) -> Outcome:
    return state, (Dropped(f"{type(event).__name__} while {state.phase}"),)


Handler = Callable[[Interlock, Any, float], Outcome]
P = Phase

TABLE: dict[tuple[Phase, type], Handler] = {
    (P.WAITING, Announced): announced,
    (P.WAITING, OtherVersionAnnounced): other_version,
    (P.OPENING, Announced): announced_again,
    (P.OPENING, OtherVersionAnnounced): other_version,
    (P.OPENING, SessionOpened): opened,
    (P.OPENING, ReplyReceived): open_refused,
    (P.OPENING, HeartbeatReceived): lambda state, event, _now_s: (_see(state, event), ()),
    (P.HELD, CommandGiven): command_while_held,
    (P.HELD, HeartbeatReceived): heartbeat_while_held,
    (P.HELD, ReplyReceived): acknowledge_answered,
    (P.NONCE_RESET, NonceReceived): reset_nonce,
    (P.NONCE_RESET, HeartbeatReceived): heartbeat_while_resetting,
    (P.AUTHORISING_RESET, RecordDurable): reset_durable,
    (P.AUTHORISING_RESET, HeartbeatReceived): heartbeat_while_resetting,
    (P.RESETTING, ReplyReceived): reset_refused,
    (P.RESETTING, HeartbeatReceived): heartbeat_after_reset,
    (P.COLLECTING, ParameterReceived): parameter,
    (P.UPLOADING, BlockConfirmed): block_stored,
    (P.UPLOADING, PathConfirmed): path_stored,
    (P.UPLOADING, JointsMeasured): measured_while_uploading,
    (P.VERIFYING, VerdictReady): verdict_ready,
    (P.ADMITTED, HeartbeatReceived): heartbeat_while_admitted,
    (P.ADMITTED, CommandGiven): command_while_admitted,
    (P.ADMITTED, WitnessSought): witness_sought_while_admitted,
    (P.NONCE_PERMIT, NonceReceived): permit_nonce,
    (P.AUTHORISING_PERMIT, RecordDurable): permit_durable,
    (P.PERMITTING, ReplyReceived): permit_refused,
    (P.PERMITTING, HeartbeatReceived): heartbeat_after_permit,
    (P.PERMITTED, CommandGiven): start_commanded,
    (P.NONCE_START, NonceReceived): start_nonce,
    (P.NONCE_START, HeartbeatReceived): heartbeat_before_start,
    (P.AUTHORISING_START, RecordDurable): start_durable,
    (P.AUTHORISING_START, HeartbeatReceived): heartbeat_before_start,
    (P.STARTING, ReplyReceived): start_refused,
    (P.STARTING, HeartbeatReceived): heartbeat_while_cutting,
    (P.STARTING, JointsMeasured): measured_while_moving,
    (P.STARTING, ProgressReported): progress_while_moving,
    (P.STARTING, Tick): tick_while_moving,
    (P.CUTTING, HeartbeatReceived): heartbeat_while_cutting,
    (P.CUTTING, JointsMeasured): measured_while_moving,
    (P.CUTTING, ProgressReported): progress_while_moving,
    (P.CUTTING, Tick): tick_while_moving,
    (P.FINISHING, JointsMeasured): measured_while_finishing,
    (P.FINISHING, ProgressReported): progress_while_moving,
    (P.FINISHING, Tick): tick_while_moving,
    (P.STOPPING, HeartbeatReceived): heartbeat_while_stopping,
    (P.STOPPING, HeartbeatLost): lambda state, _event, now_s: (_stopped(state, now_s), ()),
    (P.STOPPING, FaultReceived): lambda state, _event, _now_s: (state, ()),  # answered, it would never end
    (P.STOPPING, ReplyReceived): reply_while_stopping,
    (P.STOPPING, CommandGiven): command_while_stopping,
}
"""What only one phase answers to."""

EVERYWHERE: dict[type, Handler] = {
    Announced: rebooted,
    OtherVersionAnnounced: rebooted,
    SessionOpened: dropped,
    WitnessSought: witness_sought,
    ParameterReceived: parameter_changed,
    BlockConfirmed: dropped,
    PathConfirmed: dropped,
    VerdictReady: dropped,
    NonceReceived: dropped,
    ReplyReceived: not_pending,
    HeartbeatReceived: heartbeat,
    HeartbeatLost: heartbeat_lost,
    FaultReceived: fault_received,
    JointsMeasured: measured,
    ProgressReported: ignored,
    RecordDurable: dropped,
    WithdrawalSent: withdrawal_sent,
    LogChanged: log_changed,
    Failed: failed,
    Gone: gone,
    CommandGiven: command_given,
    Tick: tick,
}
"""What every other phase answers."""
