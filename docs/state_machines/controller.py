"""The controller's transitions, from the events of its tests' builders; and by what events of one kind differ."""

from collections.abc import Iterator
from functools import cache
from typing import Any, Final

from cutgate.firmware_sim import state as controller_state
from cutgate.firmware_sim import table as controller_table
from cutgate.protocol.states import LATCHING, WITHDRAWING, ControllerState, Refusal, StopCause
from docs.state_machines.edges import LATE_S, Edge, by_table, effect_name, explore, handler_name
from tests.firmware_sim import controllers

C: Final = ControllerState


@cache
def controller_edges() -> tuple[Edge, ...]:
    """Every transition of the controller that can be reached from power-up."""

    def events(state: Any) -> list[tuple[Any, float]]:
        stopped = controllers.alive(epoch=state.epoch, cause=StopCause.OPERATOR_STOP)
        both = (*controllers.events(state), stopped)
        return [*((event, 0.0) for event in both), (controller_state.Tick(), LATE_S)]

    def alike(state: Any) -> tuple[Any, ...]:
        session = state.session and state.session.live
        issued = state.issued and (state.issued.purpose, state.issued.nonce)
        seen = (state.cause is StopCause.NONE, state.inputs, state.device, state.measured_u)
        memory = (
            _awaits(state),
            state.memory.latched,
            bool(state.memory.withdrawn),
            state.memory.withdrawal_due,
            state.memory == state.written,
        )
        return state.state, session, issued, *seen, state.cut_ordered, state.heartbeat_fresh, *memory

    def edges() -> Iterator[Edge]:
        start = [(controllers.POWERED_UP, controllers.NOW)]
        for before, event, after_s, after, effects in explore(start, controller_table.step, events, alike):
            key = (before.state, type(event))
            handler = controller_table.TABLE.get(key) or controller_table.EVERYWHERE.get(type(event))
            if handler is None:
                continue
            yield Edge(
                before.state.name,
                type(event).__name__,
                controller_case(before, event, after_s),
                handler_name(handler),
                after.state.name,
                tuple(map(effect_name, effects)),
                own=key in controller_table.TABLE,
            )

    return tuple(sorted(set(edges()), key=by_table([state.name for state in C], controller_state.Event)))


def _awaits(state: Any) -> str:
    """The request that waits for the memory."""
    return type(state.awaiting.event).__name__.removesuffix("Received") if state.awaiting else ""


def controller_case(state: Any, event: Any, after_s: float) -> str:  # noqa: C901, PLR0911 - one line each
    """What distinguishes this event from others of its kind, where the table looks at it."""
    match event:
        case controller_state.PathChecked(_, refusal, _, _):
            return "accepted" if refusal is Refusal.ACCEPTED else "refused"
        case controller_state.HeartbeatReceived(code, epoch, cause, fresh):
            if cause is not StopCause.NONE:
                return "latching cause" if cause in LATCHING else "other cause"
            text = "another epoch" if epoch != state.epoch else code.name if fresh else f"stale {code.name}"
            ordered = " after CUT" if state.cut_ordered else " before CUT"
            return text + (ordered if state.state is C.CUTTING else "")
        case controller_state.Persisted() | controller_state.PersistFailed():
            return f"{_awaits(state)} waits" if state.awaiting else ""
        case controller_state.StopReceived(code, cause):
            return "withdrawing" if cause in WITHDRAWING else code.name
        case controller_state.FaultArisen(cause):
            return "latching" if cause in LATCHING else "not latching"
        case controller_state.InputsChanged(inputs):
            if not inputs.emergency_stop_clear:
                return "emergency stop"
            return "pressed" if inputs.device_pressed else "released"
        case controller_state.PathFinished():
            return "at the start joints" if state.measured_u == controllers.START_JOINTS else "elsewhere"
        case controller_state.Tick():
            text = "late" if after_s else "in time"
            return f"{text} after CUT" if state.cut_ordered else text
    return ""
