"""What must hold in every state and after every step; each returns what is wrong, or None.

Judged from outside: from what was sent, held and committed, never by asking the guards that are under test.
"""

from dataclasses import dataclass, replace

from cutgate.firmware_sim import state as c
from cutgate.protocol import records
from cutgate.protocol.records import digest
from cutgate.protocol.states import WITHDRAWING, ControllerState, RuntimeCode, StopCause, StopCode
from cutgate.runtime.interlock import state as r
from cutgate.runtime.interlock.phases import PHASES
from tests.exploration.names import Message, RuntimeSide

HELD = frozenset({r.Phase.HELD, r.Phase.NONCE_RESET, r.Phase.AUTHORISING_RESET, r.Phase.RESETTING})
"""Where the cause stands that the session was opened on, and what is acknowledged is what a reset will name."""
MOVING = frozenset({r.Phase.STARTING, r.Phase.CUTTING, r.Phase.FINISHING})
ENABLING = (records.Permit, records.Start, records.Reset)
SIGNS = (c.PermitReceived, c.StartReceived, c.ResetReceived)


@dataclass(frozen=True)
class JudgedController(c.Controller):
    """The controller, with what no guard of its table reads.

    Attributes:
        moved: in its session, that is since it was opened, the bone moved or the runtime said so or withdrew.
    """

    moved: bool = False


def accounted(
    before: JudgedController, event: c.Event, after: JudgedController, *, forged: bool
) -> JudgedController:
    """The controller after an event, with the account continued."""
    here = after.session is not None and before.session is not None
    moved = here and (before.moved or _withdraws(event, forged=forged))
    return after if moved is after.moved else replace(after, moved=moved)


def _withdraws(event: c.Event, *, forged: bool) -> bool:
    """Whether a holder of the key, or the wired sensor, says that from now on a Withdraw is due."""
    return isinstance(event, c.BoneMoved) or (
        isinstance(event, c.HeartbeatReceived) and event.cause in WITHDRAWING and not forged
    )


def controller_state(state: c.Controller) -> str | None:
    """Invariants 1 and 7: motion only under a permit for exactly what is held, and with the device pressed."""
    if not state.may_move:
        return None
    permit, held = state.permit, state.holdings
    if permit is None or held.path is None:
        return "1: motion without a permit or without a path"
    bound = (permit.limits_digest, permit.calibration_digest, permit.tool_digest, permit.path_digest)
    if bound != tuple(map(digest, (held.limits, held.calibration, held.tool, held.path))):
        return "1: motion under a permit for something else than what is held"
    session, memory = state.session, state.memory
    if memory.withdrawal_due:
        return "1: motion while a withdrawal is due"
    if session is None or session.place in memory.withdrawn:
        return "1: motion on a withdrawn registration"
    if memory.barrier_us != records.NO_TIME and not session.registration_time_us > memory.barrier_us:
        return "1: motion on a registration not later than the barrier"
    if not state.inputs.device_pressed:
        return "7: motion with the enabling device released"
    return None


def must_stand_after(event: c.Event) -> bool:
    """Invariant 3 at the controller: after which events nothing may move."""
    match event:
        case c.HeartbeatReceived():
            return event.code is not RuntimeCode.CUT or event.cause is not StopCause.NONE or not event.fresh
        case c.InputsChanged(inputs=inputs):
            return not (inputs.device_pressed and inputs.emergency_stop_clear)
        case c.StopReceived() | c.HeartbeatLost() | c.FaultArisen() | c.BoneMoved() | c.LimitsChanged():
            return True
    return False


def controller_step(
    before: JudgedController,
    event: c.Event,
    after: JudgedController,
    message: Message | None,
    *,
    forged: bool = False,
    late_s: float = 0.0,
) -> str | None:
    """Those of the state reached, then invariants 3, 4, 6, 9, 10 at the controller.

    Args:
        message: what the event brings, if it was said before.
        forged: no holder of the key has said it.
        late_s: how late it was carried out.
    """
    wrong = controller_state(after)
    if wrong:
        return wrong
    wrong = _memory_step(before, event, after, forged=forged) or _session_step(before, event, after, message)
    if wrong:
        return wrong
    if must_stand_after(event) and after.may_move:
        return f"3: motion after {type(event).__name__}"
    left = before.state is ControllerState.FAULT and after.state is not ControllerState.FAULT
    if left and not (isinstance(event, c.ResetReceived) and event.authentic):
        return f"4: a latch was left by {type(event).__name__}"
    if isinstance(event, c.ResetReceived) and (after.may_move, after.cutting_mode) > (
        before.may_move,
        before.cutting_mode,
    ):
        return "4: a reset started something"
    cutting = ControllerState.CUTTING
    started = isinstance(event, c.StartReceived) and after.state is cutting is not before.state
    if started and before.session is not None and late_s > before.session.start_lifetime_s:
        return "6: a start was carried out after its lifetime"
    acted = isinstance(event, SIGNS) and after.state is not before.state
    if acted and message is not None and message.old and after.state is not ControllerState.FAULT:
        return f"6: a {type(message.content).__name__} from before a stop was acted upon"
    return None


def reboot(before: c.Controller, after: c.Controller) -> str | None:
    """Invariants 1 and 4 over a loss of power: what memory was known to hold is not forgotten, and nothing moves."""
    if after.may_move or after.cutting_mode:
        return "1: motion or cutting mode at power-up"
    known = before.written
    if known is None:
        return None
    if known.latched is not StopCause.NONE and after.state is not ControllerState.FAULT:
        return "4: a latch was left by a loss of power"
    if _forgotten(known, after.memory) or known.withdrawal_due > after.memory.withdrawal_due:
        return "1: a withdrawal was forgotten by a loss of power"
    return None


def _forgotten(before: c.Memory, after: c.Memory) -> bool:
    return not before.withdrawn <= after.withdrawn or after.barrier_us < before.barrier_us


def _memory_step(
    before: JudgedController, event: c.Event, after: JudgedController, *, forged: bool
) -> str | None:
    """Invariant 9: what memory holds of registrations is changed by who holds the key, or by the wired sensor, alone."""
    old, new = before.memory, after.memory
    if _forgotten(old, new):
        return "1: a withdrawal was forgotten"
    if _barrier_not_kept(before, event, new):
        return "1: the barrier that a Withdraw tells was not kept"
    if old.withdrawal_due and not new.withdrawal_due:
        if not isinstance(event, c.WithdrawReceived):
            return f"9: a withdrawal that was due is not, after {type(event).__name__}"
        if before.moved:
            return "9: a withdrawal is due no longer by a Withdraw of a session that was opened before it"
    same = (old.withdrawn, old.barrier_us, old.withdrawal_due) == (
        new.withdrawn,
        new.barrier_us,
        new.withdrawal_due,
    )
    entitled = (isinstance(event, c.WithdrawReceived) and event.authentic) or _withdraws(event, forged=forged)
    if not same and not entitled:
        return f"9: a registration was withdrawn or restored by {type(event).__name__} that no holder of the key made"
    return None


def _barrier_not_kept(before: c.Controller, event: c.Event, after: c.Memory) -> bool:
    if not (isinstance(event, c.WithdrawReceived) and event.authentic and before.session is not None):
        return False
    meant = event.withdraw.place_digest in (before.session.place, records.NO_PLACE)
    return meant and after.barrier_us < event.withdraw.barrier_us


def _session_step(
    before: c.Controller, event: c.Event, after: c.Controller, message: Message | None
) -> str | None:
    """Invariants 9 and 10: a session is named by a holder of the key, and the same OPEN opens once."""
    if after.session is None or (before.session and before.session.digest == after.session.digest):
        return None
    if not (isinstance(event, c.OpenReceived) and event.authentic):
        return f"9: a registration was named by {type(event).__name__} that no holder of the key made"
    if message is not None and message.old:
        return "10: the same OPEN opened twice"
    return None


def outlasts(moving: bool, cut_is_fresh: bool) -> str | None:
    """Invariant 8: nothing moves once a time-out has passed since the runtime's heartbeat last said CUT."""
    if moving and not cut_is_fresh:
        return "8: motion outlasts the runtime's will by more than the time-out"
    return None


def runtime_step(
    before: RuntimeSide,
    event: r.Event,
    after: r.Interlock,
    effects: tuple[r.Effect, ...],
    *,
    deviates: bool = False,
    forged: bool = False,
) -> str | None:
    """Invariants 2, 3, 9 and 11 at the runtime.

    Args:
        deviates: the event shows an arm that is not where it was verified.
        forged: no holder of the key has said it.
    """
    wrong = _believed(before.interlock, event, after, forged=forged)
    if wrong:
        return wrong
    for effect in effects:
        if isinstance(effect, r.Send) and isinstance(effect.record, ENABLING):
            wrong = _left_without_cover(before, event, effect.record)
            if wrong:
                return wrong
    if deviates or _stop_cause(before.interlock, event):
        if PHASES[after.phase].heartbeat is not RuntimeCode.INHIBIT:
            return f"3: the runtime upholds motion after {type(event).__name__}"
        ended = before.interlock.phase not in MOVING or any(
            isinstance(effect, r.SendStop) and effect.code is StopCode.STOP for effect in effects
        )
        if not ended:
            return f"3: no stop left after {type(event).__name__}"
    return None


def _believed(before: r.Interlock, event: r.Event, after: r.Interlock, *, forged: bool) -> str | None:
    """Invariants 9 and 11: what the controller is believed, and what withdraws, comes from a holder of the key."""
    heartbeat = isinstance(event, r.HeartbeatReceived) and not forged
    name = type(event).__name__
    led = next((one for one in BELIEVED if (after.phase, before.phase) == one[:2]), None)
    if led and not (heartbeat and event.view.state is led[2]):
        return f"11: {after.phase} is believed by {name}, and no heartbeat of the controller said so"
    opening = before.phase is r.Phase.OPENING and after.phase in (r.Phase.HELD, r.Phase.COLLECTING)
    if opening and not (isinstance(event, r.SessionOpened) and event.authentic):
        return f"11: a session is believed to be open by {name}"
    if after.registration_withdrawn and not before.registration_withdrawn:
        by_key = heartbeat and event.view.cause in WITHDRAWING
        if by_key and before.opened and before.phase in HELD and event.view.cause is before.opened.cause:
            return "9: a registration was withdrawn by the cause that its session was opened on"
        by_person = isinstance(event, r.CommandGiven) and event.command is r.OperatorCommand.WITHDRAW
        if not (by_key or by_person):
            return f"9: a registration was withdrawn by {name} that no holder of the key made"
    return None


BELIEVED = (
    (r.Phase.PERMITTED, r.Phase.PERMITTING, ControllerState.PERMITTED),
    (r.Phase.CUTTING, r.Phase.STARTING, ControllerState.CUTTING),
    (r.Phase.FINISHING, r.Phase.STARTING, ControllerState.DONE),
    (r.Phase.FINISHING, r.Phase.CUTTING, ControllerState.DONE),
)
"""What is reached from where by what the controller's heartbeat says."""


def _stop_cause(before: r.Interlock, event: r.Event) -> bool:
    """Whether the runtime must not uphold motion after this event."""
    match event:
        case r.Gone():
            return True
        case r.CommandGiven(command=command):
            return command in (r.OperatorCommand.STOP, r.OperatorCommand.WITHDRAW) or (
                command is r.OperatorCommand.QUIT and before.phase in MOVING
            )
        case r.HeartbeatReceived(view=view):
            released = before.phase in MOVING and not view.device_pressed
            return view.cause is not StopCause.NONE or (released and view.state is not ControllerState.DONE)
        case r.LogChanged(log=log):
            return before.log.writable and not log.writable
        case r.HeartbeatLost() | r.Failed() | r.FaultReceived() | r.Announced():
            return before.phase not in (r.Phase.WAITING, r.Phase.OPENING)
    return False


def _left_without_cover(before: RuntimeSide, event: r.Event, record: records.Record) -> str | None:
    """Invariant 2: what enables is durable as it leaves, and was decided on an admissible verdict for what is held."""
    name, state = type(record).__name__, before.interlock
    durable = [
        commit.record
        for commit in before.commits
        if isinstance(event, r.RecordDurable) and commit.token == event.token
    ]
    if durable != [replace(record, log=records.NO_TREE_HEAD) if hasattr(record, "log") else record]:
        return f"2: a {name} left without its durable record"
    if isinstance(record, records.Reset):
        return None
    verdict, held = state.verdict, state.collected
    if verdict is None or not verdict.admissible or verdict.approach is None:
        return f"2: a {name} left without an admissible verdict"
    if not state.confirmed.issuperset(verdict.to_confirm):
        return f"2: a {name} left although a warning was not confirmed"
    if state.job.check_points.missing or state.job.check_points.outside:
        return f"2: a {name} left although a check point of the registration is off or missing"
    log_missed = state.opened is None or (
        state.opened.log != records.NO_TREE_HEAD and not (state.witness and state.witness.found)
    )
    if log_missed and r.WITNESS not in state.confirmed:
        return f"2: a {name} left although the log that the controller saw last was not found"
    received = tuple(digest(data) if data else b"" for data in (held.limits, held.calibration, held.tool))
    made_for = (verdict.limits, verdict.calibration, verdict.tool, verdict.path)
    if made_for != (*received, digest(state.job.path)):
        return f"2: a {name} left on a verdict for something else than what is held"
    return None
