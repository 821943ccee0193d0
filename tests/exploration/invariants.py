"""What must hold in every state and after every step; each returns what is wrong, or None.

Judged from outside: from what was sent, held and committed, never by asking the guards that are under test.
"""

from typing import Any

from cutgate.firmware_sim import state as c
from cutgate.protocol import records
from cutgate.protocol.records import digest
from cutgate.protocol.states import ControllerState, RuntimeCode, StopCause, StopCode
from cutgate.runtime.interlock import state as r
from cutgate.runtime.interlock.phases import PHASES
from tests.exploration.names import Message, RuntimeSide, signed

MOVING = frozenset({r.Phase.STARTING, r.Phase.CUTTING, r.Phase.FINISHING})
ENABLING = (records.Permit, records.Start, records.Reset)
SIGNS = (c.PermitReceived, c.StartReceived, c.ResetReceived)


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
    if permit.registration_digest in state.memory.withdrawn:
        return "1: motion on a withdrawn registration"
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
    before: c.Controller, event: c.Event, after: c.Controller, message: Message | None
) -> str | None:
    """Those of the state reached, then invariants 3, 4 and 6 at the controller."""
    wrong = controller_state(after)
    if wrong:
        return wrong
    if not before.memory.withdrawn <= after.memory.withdrawn:
        return "1: a withdrawal was forgotten"
    if must_stand_after(event) and after.may_move:
        return f"3: motion after {type(event).__name__}"
    if before.state is ControllerState.FAULT and after.state is not ControllerState.FAULT:
        authentic = isinstance(event, c.ResetReceived) and signed(_bare(event.reset)) == event.reset
        if not authentic:
            return f"4: a latch was left by {type(event).__name__}"
    if isinstance(event, c.ResetReceived) and (after.may_move, after.cutting_mode) > (
        before.may_move,
        before.cutting_mode,
    ):
        return "4: a reset started something"
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
    if not known.withdrawn <= after.memory.withdrawn:
        return "1: a withdrawal was forgotten by a loss of power"
    return None


def _bare(record: Any) -> Any:
    return record.with_mac(records.NO_MAC)


def runtime_step(
    before: RuntimeSide,
    event: r.Event,
    after: r.Interlock,
    effects: tuple[r.Effect, ...],
    *,
    deviates: bool = False,
) -> str | None:
    """Invariants 2 and 3 at the runtime; ``deviates``: the event shows an arm that is not where it was verified."""
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
    if durable != [record]:
        return f"2: a {name} left without its durable record"
    if isinstance(record, records.Reset):
        return None
    verdict, held = state.verdict, state.collected
    if verdict is None or not verdict.admissible or verdict.approach is None:
        return f"2: a {name} left without an admissible verdict"
    if not state.confirmed.issuperset(verdict.to_confirm):
        return f"2: a {name} left although a warning was not confirmed"
    received = tuple(digest(data) if data else b"" for data in (held.limits, held.calibration, held.tool))
    made_for = (verdict.limits, verdict.calibration, verdict.tool, verdict.path)
    if made_for != (*received, digest(state.job.path)):
        return f"2: a {name} left on a verdict for something else than what is held"
    return None
