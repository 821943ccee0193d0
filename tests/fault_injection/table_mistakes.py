"""Mistakes in the two tables, each with a session that is led to where it shows.

A guard that is left out, a transition to the wrong phase, a phase that is skipped, an effect that is missing or out of order.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import can
import pytest

from cutgate.firmware_sim import state as c
from cutgate.firmware_sim import table as controller
from cutgate.firmware_sim.faults import narrower
from cutgate.protocol import records
from cutgate.protocol.frames import IDS, ControllerFault
from cutgate.protocol.states import ControllerState, Purpose, Refusal, StopCause, StopCode
from cutgate.runtime.interlock import permissives, phases
from cutgate.runtime.interlock import table as interlock
from cutgate.runtime.interlock.phases import ENDED, PHASES
from cutgate.runtime.interlock.state import (
    Announced,
    CommandGiven,
    Commit,
    HeartbeatLost,
    HeartbeatReceived,
    JointsMeasured,
    NonceReceived,
    OperatorCommand,
    Phase,
    RecordDurable,
    ReplyReceived,
    SeekWitness,
    Send,
    SendStop,
    SendWithdraw,
    SessionOpened,
    Tick,
    Withheld,
)
from tests.runtime.session.pair import Pair
from tests.runtime.session.wire import CONTROLLER

Patch = pytest.MonkeyPatch
Scene = Callable[[Pair], None]
SLOW_S = 0.06
"""A disk that answers, later than the next heartbeat."""


# ---------------------------------------------------------------- how a table is altered


def _entry(place: Any, handler: Callable[..., Any]) -> Callable[[Patch], None]:
    """One entry of the interlock's table exchanged: of one phase, or of every other."""
    table: Any = interlock.TABLE if isinstance(place, tuple) else interlock.EVERYWHERE
    return lambda patch: patch.setitem(table, place, handler)


def _of_controller(place: Any, handler: Callable[..., Any]) -> Callable[[Patch], None]:
    table: Any = controller.TABLE if isinstance(place, tuple) else controller.EVERYWHERE
    return lambda patch: patch.setitem(table, place, handler)


def _around(module: Any, name: str, altered: Callable[..., Any]) -> Callable[[Patch], None]:
    """One function of a table's module exchanged; `altered` gets it as its first argument."""

    def seed(patch: Patch) -> None:
        real = getattr(module, name)
        patch.setattr(module, name, lambda *given, **named: altered(real, *given, **named))

    return seed


def _without(kind: type) -> Callable[..., Any]:
    """What leaves, without effects of this kind."""

    def altered(real: Any, *given: Any) -> Any:
        after, effects = real(*given)
        return after, tuple(effect for effect in effects if not isinstance(effect, kind))

    return altered


def _first(kind: type) -> Callable[..., Any]:
    """What leaves, effects of this kind before all others."""

    def altered(real: Any, *given: Any) -> Any:
        after, effects = real(*given)
        return after, tuple(sorted(effects, key=lambda effect: not isinstance(effect, kind)))

    return altered


def _handler(place: Any, altered: Callable[..., Any]) -> Callable[[Patch], None]:
    """One entry whose outcome is altered."""

    def seed(patch: Patch) -> None:
        table: Any = interlock.TABLE if isinstance(place, tuple) else interlock.EVERYWHERE
        real = table[place]
        patch.setitem(table, place, lambda *given: altered(real, *given))

    return seed


def _unchanged(state: Any, _event: Any, _now_s: float) -> Any:
    return state, ()


# ---------------------------------------------------------------- the runtime's mistakes


def _permit_without_record(state: Any, event: Any, now_s: float) -> Any:
    permit = interlock._permit(state, event.nonce)
    return interlock._enter(state, Phase.PERMITTING, now_s, permit=permit, nonce=event.nonce), (Send(permit),)


def _reset_without_record(state: Any, event: Any, now_s: float) -> Any:
    return interlock._enter(state, Phase.RESETTING, now_s), (Send(interlock._reset(state, event.nonce)),)


def _believes(phase: Phase, kind: type[records.Record]) -> Callable[..., Any]:
    def altered(real: Any, state: Any, event: Any, now_s: float) -> Any:
        if event.request_type == kind.TYPE and event.refusal is Refusal.ACCEPTED:
            return interlock._enter(state, phase, now_s), ()
        return real(state, event, now_s)

    return altered


def _start_unasked(real: Any, state: Any, event: Any, now_s: float) -> Any:
    if event.command is not OperatorCommand.START:
        return real(state, event, now_s)
    asks = records.NonceRequest(purpose=Purpose.START)
    return interlock._enter(state, Phase.NONCE_START, now_s), (Send(asks),)


def _done_at_once(real: Any, *given: Any) -> Any:
    after, effects = real(*given)
    if after.phase is not Phase.FINISHING:
        return after, effects
    return replace(after, phase=Phase.DONE), (SendStop(StopCode.END, StopCause.SESSION_ENDED),)


def _free_at_once(real: Any, state: Any, event: Any, now_s: float) -> Any:
    after, effects = real(state, event, now_s)
    if after.phase is not Phase.HELD:
        return after, effects
    return replace(after, phase=Phase.COLLECTING), (*effects, Send(records.Collect()))


def _cause_overwritten(real: Any, state: Any, cause: StopCause, *given: Any) -> Any:
    after, effects = real(state, cause, *given)
    return replace(after, cause=cause), effects


def _no_permissive_asked(real: Any, which: Any, *given: Any) -> Any:
    return () if which is interlock.COLLECTED else real(which, *given)


def _quits_in_order(_real: Any, state: Any, now_s: float, signal: str = "") -> Any:
    left = interlock._enter(
        state, Phase.STOPPED, now_s, cause=StopCause.OPERATOR_QUIT, reason=signal, permit=None
    )
    return left, (SendStop(StopCode.END, StopCause.OPERATOR_QUIT),)


def _late_is_over(real: Any, state: Any, *given: Any) -> Any:
    after, effects = real(state, *given)
    return (replace(after, phase=Phase.STOPPED), ()) if after.phase is Phase.REFUSED else (after, effects)


def _one_permissive_less(patch: Patch) -> None:
    left_out = permissives.device_cycled
    kept = tuple(one for one in interlock.FOR_START if one is not left_out)
    patch.setattr(interlock, "FOR_START", kept)
    patch.setattr(phases, "FOR_START", kept)
    for phase, row in list(PHASES.items()):
        if left_out in row.permissives:
            patch.setitem(
                PHASES, phase, replace(row, permissives=tuple(one for one in row.permissives if one in kept))
            )


def _released_not_seen(real: Any, state: Any, event: Any, now_s: float) -> Any:
    after, effects = real(state, event, now_s)
    return (interlock._see(state, event), ()) if after.phase is Phase.PERMITTED else (after, effects)


def _stopped_at_once(real: Any, state: Any, *given: Any) -> Any:
    after, effects = real(state, *given)
    return (
        (replace(after, phase=Phase.STOPPED), effects) if after.phase is Phase.STOPPING else (after, effects)
    )


def _authorises_twice(real: Any, *given: Any, **named: Any) -> Any:
    after, effects = real(*given, **named)
    return after, (*effects, *(effect for effect in effects if isinstance(effect, Commit)))


# ---------------------------------------------------------------- the controller's mistakes


def _inputs_noted(which: str) -> Callable[..., Any]:
    def handler(state: Any, event: Any, now_s: float) -> Any:
        wrong = not getattr(event.inputs, which) and state.state is ControllerState.CUTTING
        if not wrong:
            return controller.inputs_changed(state, event, now_s)
        return replace(state, inputs=event.inputs), ()

    return handler


def _epoch_kept(real: Any, state: Any) -> Any:
    return replace(real(state), epoch=state.epoch)


def _stops_open(real: Any, *given: Any) -> Any:
    after, effects = real(*given)
    return replace(after, state=ControllerState.OPEN), effects


def _latches_nothing(real: Any, *given: Any) -> Any:
    after, effects = real(*given)
    return replace(after, state=ControllerState.INHIBITED), effects


def _finishes_loaded(state: Any, event: Any, now_s: float) -> Any:
    after, effects = controller.finished(state, event, now_s)
    done = after.state is ControllerState.DONE
    return (replace(after, state=ControllerState.LOADED) if done else after), effects


def _permitted_cuts(state: Any, event: Any, now_s: float) -> Any:
    after, effects = controller.permit_received(state, event, now_s)
    permitted = after.state is ControllerState.PERMITTED
    return (
        replace(after, state=ControllerState.CUTTING, started_at_s=now_s) if permitted else after
    ), effects


def _loaded_is_done(state: Any, event: Any, now_s: float) -> Any:
    after, effects = controller.path_checked(state, event, now_s)
    loaded = after.state is ControllerState.LOADED
    return (replace(after, state=ControllerState.DONE) if loaded else after), effects


def _acknowledged_is_reset(state: Any, event: Any, now_s: float) -> Any:
    after, effects = controller.acknowledge_received(state, event, now_s)
    free = after.cause is StopCause.NONE
    return (replace(after, state=ControllerState.OPEN) if free else after), effects


def _forgets_its_cause(state: Any, event: Any, now_s: float) -> Any:
    after, effects = controller.heartbeat(state, event, now_s)
    return replace(after, cause=StopCause.NONE), effects


# ---------------------------------------------------------------- what leads there


def lead(pair: Pair, *phases_: Phase, limit_s: float = 4.0) -> Pair:
    """Turn until the session is there, has ended, or so long has passed; a patient operator helps."""
    if pair.session is None:
        pair.begin()
    until_s = pair.clock() + limit_s
    while pair.phase not in (*phases_, *ENDED) and pair.clock() < until_s:
        view = pair.state.controller
        pair._lead()
        if pair.phase is Phase.HELD and view is not None:
            free = view.cause is StopCause.NONE
            pair.terminal.type(OperatorCommand.RESET if free else OperatorCommand.ACKNOWLEDGE)
        pair.run_cycle()
    return pair


def through(pair: Pair) -> None:
    """To the end."""
    lead(pair)


def _said(word: str, phase: Phase = Phase.CUTTING) -> Scene:
    def scene(pair: Pair) -> None:
        lead(pair, phase).say(word)
        lead(pair, limit_s=0.5)

    return scene


def _at_the_controller(word: str, phase: Phase = Phase.CUTTING) -> Scene:
    def scene(pair: Pair) -> None:
        lead(pair, phase).controller_terminal.type(word)
        lead(pair, limit_s=0.5)

    return scene


def _silent(pair: Pair) -> None:
    lead(pair, Phase.CUTTING).controller_runs = False
    pair.run(0.3)


def _restarted(pair: Pair) -> None:
    lead(pair, Phase.CUTTING)
    pair.power_up()
    lead(pair, limit_s=0.5)


def _while_authorising(act: Callable[[Pair], None]) -> Scene:
    """Something happens while the start's record waits for the disk."""

    def scene(pair: Pair) -> None:
        lead(pair, Phase.PERMITTED)
        pair.disk.delay_s = SLOW_S
        lead(pair, Phase.AUTHORISING_START)
        act(pair)
        pair.run(SLOW_S)
        pair.disk.delay_s = 0.0
        lead(pair, limit_s=0.5)
        pair.run(SLOW_S)

    return scene


def _start_at_once(pair: Pair) -> None:
    """Said before anybody has pressed the enabling device."""
    lead(pair, Phase.PERMITTED).say("start")
    lead(pair, limit_s=0.3)


def _without_fault_frames(pair: Pair) -> None:
    """The controller stops, and its fault frame is lost: the heartbeat says it."""

    def lost(message: can.Message) -> list[can.Message]:
        return [] if message.arbitration_id == IDS[ControllerFault] else [message]

    lead(pair, Phase.CUTTING).wire.rules.append(lost)
    pair.controller_terminal.type("release")
    lead(pair, limit_s=0.3)


def _latched(pair: Pair) -> None:
    pair.latch(StopCause.SECOND_NODE)
    through(pair)


def _again(first: Scene) -> Scene:
    """A session, and then another one."""

    def scene(pair: Pair) -> None:
        first(pair)
        pair.close()
        pair.run(0.3)
        pair.begin()
        lead(pair, limit_s=1.0)

    return scene


def _other_limits(pair: Pair) -> None:
    holdings = pair.controller.holdings
    limits = narrower(holdings.limits)
    pair.process.controller = replace(pair.controller, holdings=replace(holdings, limits=limits))
    lead(pair, limit_s=0.5)


def _nobody_there(pair: Pair) -> None:
    deadlines = replace(pair.job.deadlines, announce_wait_s=0.5)
    pair.controller_runs = False
    pair.begin(replace(pair.job, deadlines=deadlines))
    lead(pair, limit_s=1.0)


def _second_node(pair: Pair) -> None:
    """Somebody else speaks on an identifier that is the controller's."""
    lead(pair, Phase.CUTTING).wire.nodes[CONTROLLER].put(IDS[ControllerFault], bytes(8))
    lead(pair, limit_s=0.5)


def _witness_gone(pair: Pair) -> None:
    """The log that the controller saw at its last start is not there any more."""
    through(pair)
    pair.close().log.unlink()
    pair.run(0.3)
    pair.begin()
    lead(pair, limit_s=1.0)


@dataclass(frozen=True)
class Mistake:
    """One of them.

    Attributes:
        seed: alters the table.
        scene: leads a session to where it shows.
        admissible: whether the bone stands where the cut is admitted.
    """

    seed: Callable[[Patch], None]
    scene: Scene
    admissible: bool = True


P = Phase
MISTAKES: dict[str, Mistake] = {
    # the runtime: guards
    "a lost heartbeat does not stop": Mistake(_entry(HeartbeatLost, _unchanged), _silent),
    "a controller that restarts is not noticed": Mistake(_entry(Announced, _unchanged), _restarted),
    "a cause in the heartbeat does not stop": Mistake(
        _around(interlock, "_stopped_by", lambda _real, state, *_: (state, ())), _without_fault_frames
    ),
    "a start is asked for without a look at the permissives": Mistake(
        _handler((P.PERMITTED, CommandGiven), _start_unasked), _start_at_once
    ),
    "other limits than the approved are taken": Mistake(
        _around(interlock, "failing", _no_permissive_asked), _other_limits
    ),
    "an inadmissible verdict does not refuse": Mistake(
        _around(interlock, "unrecoverable", lambda *_: ()), through, admissible=False
    ),
    "a permit is asked for though a permissive fails": Mistake(
        _around(interlock, "all_hold", lambda *_: True), _witness_gone
    ),
    "the enabling device's cycle is no permissive": Mistake(_one_permissive_less, through),
    "a release does not call off the start": Mistake(
        _handler((P.AUTHORISING_START, HeartbeatReceived), _released_not_seen),
        _while_authorising(lambda pair: pair.controller_terminal.type("release")),
    ),
    "a held controller is taken for a free one": Mistake(
        _handler((P.OPENING, SessionOpened), _free_at_once), _latched
    ),
    "a reply makes the permit believed": Mistake(
        _handler((P.PERMITTING, ReplyReceived), _believes(P.PERMITTED, records.Permit)), through
    ),
    "a reply makes the start believed": Mistake(
        _handler((P.STARTING, ReplyReceived), _believes(P.CUTTING, records.Start)), through
    ),
    # the runtime: wrong phases, and skipped ones
    "a permit does not wait for its record": Mistake(
        _entry((P.NONCE_PERMIT, NonceReceived), _permit_without_record), through
    ),
    "a reset does not wait for its record": Mistake(
        _entry((P.NONCE_RESET, NonceReceived), _reset_without_record), _latched
    ),
    "the end is taken at the controller's word": Mistake(
        _handler((P.CUTTING, HeartbeatReceived), _done_at_once), through
    ),
    "a missed deadline ends without a word": Mistake(_handler(Tick, _late_is_over), _nobody_there),
    "who quits while the arm moves does not stop it": Mistake(
        _around(interlock, "quit_session", _quits_in_order), _said("quit")
    ),
    "a stop is taken for confirmed": Mistake(_around(interlock, "stop", _stopped_at_once), _said("stop")),
    "the first cause is overwritten": Mistake(
        _around(interlock, "stop", _cause_overwritten), _said("stop\nwithdraw")
    ),
    # the runtime: effects
    "a stop is not sent": Mistake(_around(interlock, "stop", _without(SendStop)), _said("stop")),
    "a withdrawal is not sent": Mistake(
        _around(interlock, "stop", _without(SendWithdraw)), _said("withdraw")
    ),
    "a withdrawal leaves before the stop": Mistake(
        _around(interlock, "stop", _first(SendWithdraw)), _said("withdraw")
    ),
    "what is withheld comes before the stop": Mistake(
        _around(interlock, "stop", _first(Withheld)),
        _while_authorising(lambda pair: pair.terminal.type("stop")),
    ),
    "what is withheld is not told": Mistake(
        _around(interlock, "stop", _without(Withheld)),
        _while_authorising(lambda pair: pair.terminal.type("stop")),
    ),
    "a permit is not sent": Mistake(_handler((P.AUTHORISING_PERMIT, RecordDurable), _without(Send)), through),
    "a record is committed twice": Mistake(_around(interlock, "_authorise", _authorises_twice), through),
    "an acknowledgement is not sent": Mistake(_around(interlock, "acknowledge", _without(Send)), _latched),
    "what is due of a withdrawal is not told": Mistake(
        _handler((P.OPENING, SessionOpened), _without(SendWithdraw)),
        _again(_at_the_controller("bone-motion")),
    ),
    "the log that the controller saw is not sought": Mistake(
        _handler((P.OPENING, SessionOpened), _without(SeekWitness)), _again(through)
    ),
    "the session ends without a word": Mistake(
        _handler((P.FINISHING, JointsMeasured), _without(SendStop)), through
    ),
    # the controller
    "a released device does not stop the arm": Mistake(
        _of_controller(c.InputsChanged, _inputs_noted("device_pressed")), _at_the_controller("release")
    ),
    "an emergency stop does not stop the arm": Mistake(
        _of_controller(c.InputsChanged, _inputs_noted("emergency_stop_clear")), _at_the_controller("estop")
    ),
    "a stop begins no new epoch": Mistake(
        _around(controller, "_void", _epoch_kept), _at_the_controller("release")
    ),
    "a stop leads to OPEN": Mistake(_around(controller, "stop", _stops_open), _at_the_controller("release")),
    "a latching cause does not latch": Mistake(_around(controller, "stop", _latches_nothing), _second_node),
    "the end of the path leads to LOADED": Mistake(
        _of_controller((ControllerState.CUTTING, c.PathFinished), _finishes_loaded), through
    ),
    "a permit begins the cut": Mistake(_of_controller(c.PermitReceived, _permitted_cuts), through),
    "a path is done as it is loaded": Mistake(
        _of_controller((ControllerState.OPEN, c.PathChecked), _loaded_is_done), through
    ),
    "an acknowledgement leaves the latch": Mistake(
        _of_controller(c.AcknowledgeReceived, _acknowledged_is_reset), _latched
    ),
    "a cause goes by itself": Mistake(_of_controller(c.HeartbeatReceived, _forgets_its_cause), _latched),
}
"""By what is wrong."""
