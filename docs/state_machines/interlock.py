"""The interlock's transitions, from the events of its tests' builders; and by what events of one kind differ."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any, Final

from cutgate.protocol.states import ControllerState, Refusal, StopCause
from cutgate.runtime.interlock import state as interlock_state
from cutgate.runtime.interlock import table as interlock_table
from cutgate.runtime.interlock.phases import ENDED, MOVING, PHASES
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.interlock.tracking import Deviation
from docs.state_machines.edges import LATE_S, Edge, by_table, effect_name, explore, handler_name
from tests.runtime.interlock import builders

ARRIVED_S: Final = 0.05
"""So long after its start an arm can be back."""
JUST_IN_TIME_S: Final = 1.95
SOON_S: Final = 0.1
"""A sample breaks the silence just in time; the phase's own deadline has passed soon after."""
OLD: Final = 0.0
"""When a sample was measured that is too old to tell anything."""
C: Final = ControllerState
STOPS: Final = frozenset({Phase.STOPPING, Phase.REFUSED, Phase.STOPPED})
ANSWERED: Final = {
    Phase.OPENING: interlock_table.records.Open.TYPE,
    Phase.HELD: interlock_table.records.Acknowledge.TYPE,
    Phase.RESETTING: interlock_table.records.Reset.TYPE,
    Phase.PERMITTING: interlock_table.records.Permit.TYPE,
    Phase.STARTING: interlock_table.records.Start.TYPE,
}
"""The request each phase awaits an answer to."""


@cache
def runtime_edges() -> tuple[Edge, ...]:
    """Every transition of the interlock that can be reached from its first state."""

    def events(state: Any) -> list[tuple[Any, float]]:
        reserved = replace(state.log, reserved_bytes=1)
        other_nonce = replace(builders.ANNOUNCE, announce_nonce=b"another nonce 16")
        inadmissible = replace(builders.VERDICT, request=state.token, admissible=False)
        extra = [
            builders.sound_beat(state),
            builders.sound_beat(state, device_pressed=False),
            builders.sound_beat(state, emergency_stop_clear=False),
            interlock_state.LogChanged(reserved),
            interlock_state.LogChanged(builders.READY.log),
            interlock_state.Announced(other_nonce, builders.RUNTIME_NONCE),
            interlock_state.ParameterReceived(replace(builders.TOOL, length_u=1)),
            interlock_state.VerdictReady(inadmissible),
            interlock_state.ProgressReported(0, 0),
        ]
        late = [
            (interlock_state.Tick(), LATE_S),
            (interlock_state.Announced(builders.ANNOUNCE, b"n" * 16), 1.5),
        ]
        if state.phase in MOVING:
            late += [
                (builders.beat(C.DONE, epoch=state.epoch), ARRIVED_S),
                (builders.measured(builders.START_JOINTS, OLD), JUST_IN_TIME_S),
                (interlock_state.Tick(), SOON_S),
            ]
        return [*((event, 0.0) for event in (*builders.events(state), *extra)), *late]

    def alike(state: Any) -> tuple[Any, ...]:
        if state.phase in STOPS or state.phase is Phase.DONE:
            return state.phase, state.log.writable
        view = state.controller
        seen = view and (
            view.state,
            view.cause is StopCause.NONE,
            view.epoch == state.epoch,
            view.device_pressed,
        )
        healthy = state.log.writable and state.log.reserved_bytes > 1
        collected = state.collected
        got = (
            *(part is None for part in (collected.limits, collected.calibration, collected.tool)),
            state.stored is None,
            state.joints_u is None,
            state.block == 0,
        )
        cycle = state.device if state.permit else None  # what came before the permit does not count
        tracked = state.tracking and (state.tracking.progress, state.measured_s == OLD)
        witnessed = state.witness is not None and state.witness.found
        return state.phase, seen, cycle, healthy, tracked, witnessed, *got

    began, _ = interlock_table.step(builders.FRESH, interlock_state.Tick(), builders.NOW)

    def edges() -> Iterator[Edge]:
        for before, event, after_s, after, effects in explore(
            [(began, builders.NOW)], builders.step, events, alike
        ):
            if before.phase in ENDED:
                continue
            key = (before.phase, type(event))
            handler = interlock_table.TABLE.get(key) or interlock_table.EVERYWHERE[type(event)]
            yield Edge(
                before.phase.name,
                type(event).__name__,
                runtime_case(before, event, after_s, effects),
                handler_name(handler),
                after.phase.name,
                tuple(map(effect_name, effects)),
                own=key in interlock_table.TABLE,
            )

    return tuple(sorted(set(edges()), key=by_table([phase.name for phase in Phase], interlock_state.Event)))


def runtime_case(  # noqa: C901, PLR0911, PLR0912 - one line each
    state: Any, event: Any, after_s: float, effects: tuple[Any, ...]
) -> str:
    """What distinguishes this event from others of its kind, where the table looks at it."""
    match event:
        case interlock_state.Announced(announce, _):
            known = state.session is None or announce.announce_nonce == state.session.announce_nonce
            return ("later" if after_s else "at once") if known else "other nonce"
        case interlock_state.SessionOpened(opened, authentic):
            if not authentic:
                return "wrong code"
            at_rest = (opened.state, opened.cause) == (C.OPEN, StopCause.NONE)
            return f"{'OPEN, no cause' if at_rest else 'held'}{', withdrawal due' if opened.withdrawal_due else ''}"
        case interlock_state.WitnessSought(found, _):
            return "found" if found else "not found"
        case interlock_state.ParameterReceived(record):
            return "limits" if record == builders.LIMITS else "calibration or tool"
        case interlock_state.VerdictReady(verdict):
            if verdict.request != state.token:
                return "another request"
            return "admissible" if verdict.admissible else "inadmissible"
        case interlock_state.NonceReceived(purpose, _, epoch):
            fits = state.phase.name == f"NONCE_{purpose.name}" and epoch == state.epoch
            return "asked for" if fits else "another purpose or epoch"
        case interlock_state.ReplyReceived(request, refusal, _):
            if request != ANSWERED.get(state.phase):
                return "to something else"
            return "accepted" if refusal is Refusal.ACCEPTED else "refused"
        case interlock_state.HeartbeatReceived(view, _):
            return _beat_case(state, view, effects)
        case interlock_state.JointsMeasured(joints_u, measured_s) if state.phase in MOVING:
            if joints_u == builders.ELSEWHERE:
                return "off the path"
            if state.phase is not Phase.FINISHING:
                return "on the path, too early or too late" if _deviates(effects) else "on the path"
            back = "at the start joints" if joints_u == builders.START_JOINTS else "elsewhere on the path"
            return "too old to tell" if measured_s == OLD else back
        case interlock_state.ProgressReported(segment) if state.phase in MOVING:
            if not _deviates(effects):
                return "onward"
            if segment > 1:
                return "no such segment"
            return "too far" if event == builders.BEYOND else "backward"
        case interlock_state.RecordDurable(token, _):
            return "pending token" if token == state.token else "another token"
        case interlock_state.LogChanged(log):
            return "writable" if log.writable else "failed"
        case interlock_state.CommandGiven(word):
            return str(word)
        case interlock_state.Tick():
            return (
                "silence"
                if _deviates(effects)
                else "deadline missed"
                if effects or after_s == LATE_S
                else "in time"
            )
    return ""


def _beat_case(state: Any, view: Any, effects: tuple[Any, ...]) -> str:  # noqa: PLR0911 - one line each
    """The heartbeat as the phase sees it: first what stops, then what it says."""
    expected = PHASES[state.phase].expected
    if view.cause is not StopCause.NONE:
        return "a cause stands"
    if view.epoch != state.epoch:
        return "another epoch"
    if expected is None:
        return view.state.name
    if view.state not in expected:
        return "unexpected state"
    if not view.emergency_stop_clear:
        return "emergency stop"
    if view.state is C.DONE:
        return "DONE too early" if _deviates(effects) else "DONE"
    return "expected state" if view.device_pressed else "device released"


def _deviates(effects: tuple[Any, ...]) -> bool:
    return any(isinstance(effect, Deviation) for effect in effects)
