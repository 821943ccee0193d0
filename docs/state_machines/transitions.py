"""The steps of both tables as the rows of ``transitions.json``: each taken by the real ``step``, from one state in each phase.

The states are those of the tests' builders, with all that a handler asks about altered one by one; a heartbeat comes in
every view it can have. What differs in nothing that a log shows falls together.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import product
from typing import Any, Final

from cutgate.firmware_sim import state as controller_state
from cutgate.protocol import records
from cutgate.protocol.states import ControllerState, FaultCode, Refusal, StopCause
from cutgate.runtime.audit.recomputed.transitions import (
    HOLD,
    NOT_SHOWN,
    SHOWN,
    SILENT,
    STAYS,
    VIEW_PARTS,
    HeartbeatView,
    condition_of,
    first_out_of,
    leaves_of,
    opened_as,
    shown_cause,
)
from cutgate.runtime.interlock import permissives
from cutgate.runtime.interlock import state as interlock_state
from cutgate.runtime.interlock.phases import MOVING, PHASES
from cutgate.runtime.interlock.state import Interlock, Phase
from cutgate.runtime.interlock.tracking import Deviation
from cutgate.runtime.session.journal import NAMES, QUIET, effect_name
from docs.state_machines.edges import LATE_S
from tests.firmware_sim import controllers
from tests.runtime.interlock import builders

C: Final = ControllerState
CAUSES: Final = (StopCause.NONE, StopCause.DEVICE_RELEASED, StopCause.BONE_MOVED)
REPEATED_S: Final = 0.5
"""Behind the last Withdraw, one that is not answered leaves again."""
JUST_IN_TIME_S: Final = 1.95
_BEFORE_UPLOAD: Final = frozenset(
    {Phase.WAITING, Phase.OPENING, Phase.HELD, Phase.NONCE_RESET, Phase.AUTHORISING_RESET, Phase.RESETTING}
    | {Phase.COLLECTING, Phase.STOPPING}
)
"""Here not all of limits, calibration and tool need be known."""
_ASKED: Final = {"log", "witness", "stored"}
"""What decides, with a heartbeat, whether a permit is asked for."""
_REFUSED: Final = interlock_state.UploadedPath(builders.PATH.digest, Refusal.POSE_OUTSIDE_LIMITS, 1)
"""The path as a controller confirms it that does not take it."""
AWAITED: Final = frozenset({C.OPEN.name, C.PERMITTED.name})
"""The runtime goes on only once it has seen the controller there."""
CONTROLLERS_MAX: Final = 2000
"""Far more states of the controller than differ in what is asked here."""


# ---------------------------------------------------------------- the runtime's interlock


def states_of(phase: Phase) -> Iterator[tuple[Interlock, bool]]:
    """One state of this phase in which everything holds, and others that differ from it in what the handlers ask.

    With each, whether heartbeats are to come in every view.
    """
    sound = builders.in_phase(phase)
    yield sound, True
    approved, log = sound.collected, sound.log
    collecting: tuple[dict[str, Any], ...] = (
        {"collected": interlock_state.Collected()},
        {"collected": interlock_state.Collected(), "held_on": StopCause.BONE_MOVED},
        {"collected": replace(approved, limits=None)},
        {"collected": replace(approved, calibration=None)},
        {"collected": replace(approved, tool=None)},
        {"collected": replace(approved, tool=None, limits=b"other")},
    )
    loaded, latched = builders.view(C.LOADED), builders.view(C.FAULT, cause=StopCause.NONE)
    others: tuple[dict[str, Any], ...] = (
        {"log": replace(log, writable=False)},
        {"log": replace(log, reserved_bytes=1)},
        {"controller": None},
        {"controller": replace(builders.VIEW, cause=StopCause.DEVICE_RELEASED)},
        {"controller": latched},
        {"controller": loaded},
        {"controller": latched, "acknowledged": StopCause.SECOND_NODE},
        {"held_on": StopCause.BONE_MOVED},
        {"held_on": StopCause.BONE_MOVED, "joints_u": None},
        {"stored": None},
        {"stored": None, "joints_u": None},
        {"joints_u": None},
        {"block": 0},
        {"stored": _REFUSED},
        {"witness": None, "controller": loaded},
        {"witness": builders.MISSED, "controller": loaded},
        {"witness": builders.MISSED, "log": replace(log, writable=False)},
        {"verdict": replace(builders.VERDICT, admissible=False)},
        {"witness": builders.MISSED, "verdict": replace(builders.VERDICT, to_confirm=("CUT_TINY",))},
        {"verdict": replace(builders.VERDICT, to_confirm=("CUT_TINY",)), "controller": loaded},
        {"device": interlock_state.DeviceCycle.UNSEEN},
        {"device": interlock_state.DeviceCycle.RELEASED},
        {"heartbeat_fresh": False},
    )
    for changes in (*(collecting if phase in _BEFORE_UPLOAD else ()), *others):
        yield replace(sound, **changes), _every_view(phase, changes)
    if phase in MOVING:
        for began_s in (builders.NOW, builders.NOW - 0.05):
            yield replace(sound, tracking=builders.monitor(began_s)), True
        # The arm is where it must be when a deadline passes: that alone stops it.
        yield replace(sound, tracking=builders.monitor(builders.NOW + LATE_S)), False
    if phase is Phase.STOPPING:
        yield from ((state, True) for state in _withdrawing(sound))


def _every_view(phase: Phase, changes: dict[str, Any]) -> bool:
    """Whether these changes and a heartbeat decide together: on a permit, a Withdraw, or what is listed of permissives."""
    asks = phase is Phase.ADMITTED and changes.keys() & _ASKED != set()
    listed = (phase is Phase.COLLECTING and changes.get("collected") == interlock_state.Collected()) or (
        phase is Phase.FINISHING and "joints_u" in changes
    )
    return asks or listed or "held_on" in changes


def _withdrawing(state: Interlock) -> Iterator[Interlock]:
    """What a session remembers while it stops."""
    for due, answer, withdrawn in product((False, True), repeat=3):
        for held in (StopCause.NONE, StopCause.BONE_MOVED):
            for view in (
                None,
                builders.view(C.CUTTING),
                builders.view(C.INHIBITED, cause=StopCause.BONE_MOVED),
            ):
                for sent in (frozenset({StopCause.PROTOCOL_VIOLATION}), frozenset(StopCause)):
                    yield replace(
                        state,
                        withdraw_due=due,
                        withdraw_sent_s=builders.NOW - 0.05,
                        answer_due=answer,
                        registration_withdrawn=withdrawn or due,
                        held_on=held,
                        controller=view,
                        cause=StopCause.OPERATOR_STOP,
                        stops_sent=sent,
                    )


def events_of(state: Interlock, *, every_view: bool) -> Iterator[tuple[Any, float]]:
    """Events and how long after the state they come, s; heartbeats in every view, or the one of a sound controller."""
    other_nonce = replace(builders.ANNOUNCE, announce_nonce=b"another nonce 16")
    verdict = replace(builders.VERDICT, request=state.token)
    opened = builders.OPENED
    events = [
        *(
            event
            for event in builders.events(state)
            if not isinstance(event, interlock_state.HeartbeatReceived)
        ),
        *(event for event in builders.events(replace(state, token=builders.REQUEST)) if _is_verdict(event)),
        interlock_state.LogChanged(replace(state.log, reserved_bytes=1)),
        interlock_state.LogChanged(builders.READY.log),
        interlock_state.Announced(builders.ANNOUNCE, b"n" * 16),
        interlock_state.Announced(other_nonce, builders.RUNTIME_NONCE),
        interlock_state.Announced(replace(builders.ANNOUNCE, serial="SIM-2"), builders.RUNTIME_NONCE),
        interlock_state.ParameterReceived(replace(builders.TOOL, length_u=1)),
        interlock_state.PathConfirmed(_REFUSED),
        interlock_state.VerdictReady(replace(verdict, admissible=False)),
        interlock_state.ProgressReported(0, 0),
        interlock_state.CommandGiven(interlock_state.OperatorCommand.CONFIRM, "CUT_TINY"),
        interlock_state.CommandGiven(interlock_state.OperatorCommand.CONFIRM, "WITNESS"),
        interlock_state.Failed(StopCause.SECOND_NODE, "another node"),
        interlock_state.Gone(StopCause.BUS_FAILED, "the bus failed"),
        *(
            interlock_state.ReplyReceived(kind.TYPE, Refusal.MAC_INVALID, StopCause.NONE)
            for kind in builders.REQUESTS
        ),
        interlock_state.ReplyReceived(0xEE, Refusal.ACCEPTED, StopCause.NONE),
        interlock_state.ReplyReceived(0xEE, Refusal.EPOCH, StopCause.NONE),
        *(
            interlock_state.FaultReceived(FaultCode.STOPPED, cause)
            for cause in (*CAUSES, StopCause.HEARTBEAT_LOST)
        ),
        *(
            interlock_state.SessionOpened(replace(opened, **said), authentic=True)
            for said in (
                {"withdrawal_due": 1},
                {"withdrawal_due": 1, "log": records.NO_TREE_HEAD},
                {"withdrawal_due": 1, "cause": StopCause.BONE_MOVED},
                {"withdrawal_due": 1, "cause": StopCause.BONE_MOVED, "log": records.NO_TREE_HEAD},
                {"cause": StopCause.BONE_MOVED},
                {"cause": StopCause.BONE_MOVED, "log": records.NO_TREE_HEAD},
                {"log": records.NO_TREE_HEAD},
                {"state": C.FAULT},
            )
        ),
    ]
    yield from ((event, 0.0) for event in events)
    late = (interlock_state.Tick(), interlock_state.RecordDurable(state.token, builders.DURABLE_LOG))
    yield from ((event, LATE_S) for event in late)
    yield interlock_state.Announced(builders.ANNOUNCE, b"n" * 16), 1.5
    if state.phase in MOVING:
        yield builders.measured(builders.START_JOINTS, 0.0), JUST_IN_TIME_S
        yield interlock_state.Tick(), 0.1
        yield interlock_state.Tick(), 0.3
        yield builders.measured(builders.START_JOINTS), 0.05
    if not every_view:
        yield builders.sound_beat(state), 0.0
        return
    for kind, cause, other, pressed, clear in product(C, CAUSES, (0, 1), (True, False), (True, False)):
        beat = builders.beat(
            kind,
            cause=cause,
            epoch=state.epoch + other,
            device_pressed=pressed,
            emergency_stop_clear=clear,
        )
        yield beat, 0.0
        if state.phase in (Phase.STOPPING, Phase.STARTING, Phase.CUTTING):
            yield beat, REPEATED_S


def _is_verdict(event: Any) -> bool:
    return isinstance(event, interlock_state.VerdictReady)


def _named(event: Any) -> str | None:
    match event:
        case interlock_state.HeartbeatReceived(view=view):
            return view.cause.name
        case interlock_state.Failed(cause) | interlock_state.Gone(cause):
            return cause.name
        case interlock_state.FaultReceived(cause=cause):
            return cause.name
    return None


def _cause(state: Interlock) -> str | None:
    return None if state.cause is StopCause.NONE else state.cause.name


Key = tuple[str, str, tuple[str, ...], str, str]
"""Condition, next phase, effects, first cause and permissives."""


def row_of(before: Interlock, event: Any, now_s: float) -> tuple[Key, HeartbeatView | None]:
    """One step as a row has it, and the view of a heartbeat."""
    after, effects = builders.step(before, event, now_s)
    text, view, opened = NAMES[type(event)](event), None, ""
    if isinstance(event, interlock_state.HeartbeatReceived):
        seen = event.view
        view = HeartbeatView.of(
            seen.state.name,
            seen.cause.name,
            seen.epoch,
            before.epoch,
            device_pressed=seen.device_pressed,
            emergency_stop_clear=seen.emergency_stop_clear,
        )
    if isinstance(event, interlock_state.SessionOpened) and before.phase is Phase.OPENING and event.authentic:
        answer = event.opened
        opened = opened_as(
            at_rest=answer.state is C.OPEN and answer.cause is StopCause.NONE,
            withdrawal_due=bool(answer.withdrawal_due),
            witness=answer.log != records.NO_TREE_HEAD,
        )
    unchanged = after.phase is before.phase and not effects
    shown = NOT_SHOWN
    if isinstance(event, QUIET) and unchanged:
        shown = SILENT
    elif after.collected.complete and not any(isinstance(effect, Deviation) for effect in effects):
        listed = permissives.evaluate(PHASES[before.phase].permissives, after, now_s)
        shown = (HOLD if all(one.holds for one in listed) else SHOWN) if listed else NOT_SHOWN
    key = (
        condition_of(text, opened),
        STAYS if after.phase is before.phase else str(after.phase),
        leaves_of(map(effect_name, effects)),
        first_out_of(_cause(after), _cause(before), _named(event)),
        shown,
    )
    return key, view


def runtime_rows() -> list[dict[str, Any]]:
    """The interlock's rows, those of several phases together."""
    plain: dict[tuple[str, Key], set[HeartbeatView | None]] = defaultdict(set)
    for phase in Phase:
        for state, every_view in states_of(phase):
            for event, after_s in events_of(state, every_view=every_view):
                key, view = row_of(state, event, builders.NOW + after_s)
                plain[str(phase), key].add(view)
    _need_no_more(plain)
    phases: dict[tuple[Key, tuple[tuple[str, ...], ...] | None], list[str]] = defaultdict(list)
    for (phase, key), views in plain.items():
        for box in boxes(views):
            phases[key, box].append(phase)
    order = [str(phase) for phase in Phase]
    rows = [
        {
            "in": sorted(found, key=order.index),
            "on": on,
            **({} if box is None else {"shows": _short(box)}),
            "to": to,
            "leaves": list(leaves),
            "first_out": first_out,
            "permissives": shown,
        }
        for ((on, to, leaves, first_out, shown), box), found in phases.items()
    ]
    return sorted(rows, key=lambda row: (row["on"], order.index(row["in"][0]), str(row)))


def _need_no_more(plain: dict[tuple[str, Key], set[HeartbeatView | None]]) -> None:
    """A step that was also taken while permissives failed does not need them: its row asks for no more than the list."""
    for phase, key in list(plain):
        failing = (*key[:4], SHOWN)
        if key[4] == HOLD and (phase, failing) in plain:
            plain[phase, failing] |= plain.pop((phase, key))


def boxes(views: set[HeartbeatView | None]) -> list[tuple[tuple[str, ...], ...] | None]:
    """The views as few boxes, each part any of some words; None for what has no view."""
    found: list[tuple[tuple[str, ...], ...] | None] = [None] if None in views else []
    cells = {tuple((part,) for part in view) for view in views if view is not None}
    for axis, words in reversed(list(enumerate(VIEW_PARTS))):
        alike: dict[tuple[Any, ...], set[str]] = defaultdict(set)
        for cell in cells:
            alike[cell[:axis] + cell[axis + 1 :]] |= set(cell[axis])
        cells = {
            (*rest[:axis], tuple(word for word in words if word in some), *rest[axis:])
            for rest, some in alike.items()
        }
    return found + sorted(cells)


def _short(box: tuple[tuple[str, ...], ...]) -> list[list[str] | None]:
    return [None if part == words else list(part) for part, words in zip(box, VIEW_PARTS, strict=True)]


def listed_permissives() -> dict[str, list[str]]:
    """By phase, what its decisions list."""
    return {
        str(phase): [
            one.name for one in permissives.evaluate(row.permissives, builders.in_phase(phase), builders.NOW)
        ]
        for phase, row in PHASES.items()
        if row.permissives
    }


# ---------------------------------------------------------------- the controller


def _alike(state: controller_state.Controller) -> tuple[Any, ...]:
    session = state.session and state.session.live
    awaiting = type(state.awaiting.event).__name__ if state.awaiting else ""
    issued = state.issued and state.issued.purpose
    return *_view(state), session, state.device, awaiting, issued, state.cut_ordered, state.measured_u


def _view(state: controller_state.Controller) -> tuple[Any, ...]:
    inputs = state.inputs
    cause = shown_cause(state.cause.name)
    return state.state.name, cause, inputs.device_pressed, inputs.emergency_stop_clear, state.cutting_mode


def _explored() -> Iterator[tuple[controller_state.Controller, controller_state.Controller]]:
    """Every step of a controller in a session, from power-up and the states of its tests; its memory works."""
    inputs = [
        controller_state.InputsChanged(controller_state.Inputs(device, clear))
        for device, clear in product((False, True), repeat=2)
    ]
    waiting, seen = [controllers.POWERED_UP, *controllers.EVERY_STATE.values()], set[tuple[Any, ...]]()
    for state in waiting:  # grows while it is walked
        if _alike(state) in seen or len(seen) > CONTROLLERS_MAX:
            continue
        seen.add(_alike(state))
        for event in (*controllers.events(state), *inputs):
            after, _ = controllers.settled(state, event, controllers.NOW)
            yield state, after
            waiting.append(after)


def controller_rows() -> dict[str, Any]:
    """What the controller's heartbeats show at once, and one after the other in a session and behind its stop."""
    views: set[tuple[Any, ...]] = set()
    live, stops, stopped = (defaultdict[str, set[str]](set) for _ in range(3))
    for before, after in _explored():
        if after.session is None:
            continue
        views.add(_view(after))
        if before.session is None or before.session.digest != after.session.digest:
            continue
        edges = (
            stops
            if before.session.live and not after.session.live
            else live
            if after.session.live
            else stopped
        )
        edges[before.state.name].add(after.state.name)
    states = [state.name for state in C]
    return {
        "shows": [list(map(list, box)) for box in _view_boxes(views)],
        "in the session": {state: sorted(_unseen(live, state)) for state in states},
        "behind a stop": {
            state: sorted(
                _reached(
                    stopped,
                    {state} & stopped.keys() | {end for one in _reached(live, {state}) for end in stops[one]},
                )
            )
            for state in states
        },
    }


def _unseen(edges: dict[str, set[str]], state: str) -> set[str]:
    """All that the next heartbeat that arrives may show: those before it may be lost, but none without which nothing goes on."""
    found, waiting = {state}, [state]
    for one in waiting:  # grows while it is walked
        for after in edges[one] - found:
            found.add(after)
            waiting += [after] if after not in AWAITED else []
    return found


def _reached(edges: dict[str, set[str]], begin: Iterable[str]) -> set[str]:
    """All that can be reached: heartbeats in between may be lost."""
    found, waiting = set(begin), list(begin)
    for one in waiting:  # grows while it is walked
        for after in edges[one] - found:
            found.add(after)
            waiting.append(after)
    return found


def _view_boxes(views: set[tuple[Any, ...]]) -> list[tuple[tuple[Any, ...], ...]]:
    cells = {tuple((part,) for part in view) for view in views}
    for axis in (2, 3, 1, 0):
        alike: dict[tuple[Any, ...], set[Any]] = defaultdict(set)
        for cell in cells:
            alike[cell[:axis] + cell[axis + 1 :]] |= set(cell[axis])
        cells = {(*rest[:axis], tuple(sorted(some)), *rest[axis:]) for rest, some in alike.items()}
    return sorted(cells)
