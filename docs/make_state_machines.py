"""Writes ``docs/state-machines.md``: ``python -m docs.make_state_machines [FILE]``.

Nothing on that page is written down twice. Its edges are those the real ``step`` functions take from every state that
is reached, breadth first, from power-up with the events of the tests' builders; its tables are read from the tables of
the code. The same page comes out on every run.
"""
# ruff: noqa: INP001

import ast
import inspect
import re
import sys
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from textwrap import dedent
from typing import Any, Final

from cutgate.firmware_sim import rules
from cutgate.firmware_sim import state as controller_state
from cutgate.firmware_sim import table as controller_table
from cutgate.protocol.records import Permit, Reply, joints_to_memory
from cutgate.protocol.states import LATCHING, WITHDRAWING, ControllerState, Refusal, StopCause
from cutgate.runtime.interlock import permissives
from cutgate.runtime.interlock import state as interlock_state
from cutgate.runtime.interlock import table as interlock_table
from cutgate.runtime.interlock.phases import ENDED, MOVING, PHASES, Deadline
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.interlock.tracking import Deviation, Seen
from tests.firmware_sim import controllers
from tests.runtime.interlock import builders

PAGE: Final = Path(__file__).parent / "state-machines.md"
LATE_S: Final = 1e6
"""Longer than every deadline and every lifetime."""
ARRIVED_S: Final = 0.05
"""So long after its start an arm can be back."""
JUST_IN_TIME_S: Final = 1.95
SOON_S: Final = 0.1
"""A sample breaks the silence just in time; the phase's own deadline has passed soon after."""
OLD: Final = 0.0
"""When a sample was measured that is too old to tell anything."""
C: Final = ControllerState
HELD: Final = frozenset({Phase.HELD, Phase.NONCE_RESET, Phase.AUTHORISING_RESET, Phase.RESETTING})
STOPS: Final = frozenset({Phase.STOPPING, Phase.REFUSED, Phase.STOPPED})


# ---------------------------------------------------------------- what the code does


@dataclass(frozen=True)
class Edge:
    """One transition the code takes: from where, on what, by which handler, where to, and what leaves."""

    source: str
    event: str
    case: str
    handler: str
    target: str
    effects: tuple[str, ...]
    own: bool
    """Listed for this state; else what every state answers."""


Step = Callable[[Any, Any, float], tuple[Any, tuple[Any, ...]]]


def explore(
    start: Iterable[tuple[Any, float]],
    step: Step,
    events: Callable[[Any], list[tuple[Any, float]]],
    alike: Callable[[Any], tuple[Any, ...]],
) -> Iterator[tuple[Any, Any, float, Any, tuple[Any, ...]]]:
    """Every (state, event, delay, next state, effects) met breadth first; states that are alike are followed once."""
    waiting, seen = list(start), set[tuple[Any, ...]]()
    for state, now_s in waiting:  # grows while it is walked
        if alike(state) in seen:
            continue
        seen.add(alike(state))
        for event, after_s in events(state):
            after, effects = step(state, event, now_s + after_s)
            yield state, event, after_s, after, effects
            waiting.append((after, now_s + after_s))


def handler_name(handler: Callable[..., Any]) -> str:
    """The handler's name; what a lambda does stands in its row."""
    return "" if handler.__name__ == "<lambda>" else f"`{handler.__name__}`"


@cache
def runtime_edges() -> tuple[Edge, ...]:
    """Every transition of the interlock that can be reached from its first state."""

    def events(state: Any) -> list[tuple[Any, float]]:
        permit = builders.reply(Permit)
        reserved = replace(state.log, reserved_bytes=1)
        other_boot = replace(builders.ANNOUNCE, boot_nonce=b"other boot nonce")
        inadmissible = replace(builders.VERDICT, request=state.token, admissible=False)
        extra = [
            builders.sound_beat(state),
            builders.sound_beat(state, device_pressed=False),
            builders.sound_beat(state, emergency_stop_clear=False),
            replace(permit, device_pressed=False),
            interlock_state.LogChanged(reserved),
            interlock_state.LogChanged(builders.READY.log),
            interlock_state.Announced(other_boot, builders.RUNTIME_NONCE),
            interlock_state.Announced(replace(builders.ANNOUNCE, protocol_version=0), builders.RUNTIME_NONCE),
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
        held = state.collected
        got = (
            *(part is None for part in (held.limits, held.calibration, held.tool)),
            state.stored is None,
            state.joints_u is None,
            state.block == 0,
        )
        cycle = state.device if state.permit else None  # what came before the permit does not count
        tracked = state.tracking and (state.tracking.progress, state.measured_s == OLD)
        return state.phase, seen, cycle, healthy, tracked, *got

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

    return tuple(sorted(set(edges()), key=_by_table([phase.name for phase in Phase], interlock_state.Event)))


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
            bool(state.memory.named),
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

    return tuple(sorted(set(edges()), key=_by_table([state.name for state in C], controller_state.Event)))


def _by_table(states: list[str], events: Any) -> Callable[[Edge], tuple[Any, ...]]:
    """Order of the states, then of the events, as declared."""
    order = [event.__name__ for event in events.__args__]
    return lambda edge: (
        states.index(edge.source),
        order.index(edge.event),
        states.index(edge.target),
        edge.case,
        edge.effects,
    )


def effect_name(effect: Any) -> str:
    """An effect in a few words."""
    match effect:
        case interlock_state.Send(record):
            return f"Send {type(record).__name__}"
        case interlock_state.SendStop(code, _):
            return f"SendStop {code.name}"
        case controller_state.Send(Reply(refusal=refusal)):
            return "Send Reply accepted" if refusal is Refusal.ACCEPTED else "Send Reply refused"
        case controller_state.Send(record):
            return f"Send {type(record).__name__}"
        case controller_state.SendFault(code, _):
            return f"SendFault {code.name}"
    return type(effect).__name__


def runtime_case(  # noqa: C901, PLR0911, PLR0912 - one line each
    state: Any, event: Any, after_s: float, effects: tuple[Any, ...]
) -> str:
    """What distinguishes this event from others of its kind, where the table looks at it."""
    match event:
        case interlock_state.Announced(announce, _):
            if announce.protocol_version == 0:
                return "other protocol version"
            known = state.session is None or announce.boot_nonce == state.session.boot_nonce
            return ("later" if after_s else "at once") if known else "other boot"
        case interlock_state.SessionOpened(_, kind, cause):
            return "OPEN, no cause" if (kind, cause) == (C.OPEN, StopCause.NONE) else "held"
        case interlock_state.ParameterReceived(record):
            return "limits" if record == builders.LIMITS else "calibration or tool"
        case interlock_state.VerdictReady(verdict):
            if verdict.request != state.token:
                return "another request"
            return "admissible" if verdict.admissible else "inadmissible"
        case interlock_state.NonceReceived(purpose, _, epoch):
            fits = state.phase.name == f"NONCE_{purpose.name}" and epoch == state.epoch
            return "asked for" if fits else "another purpose or epoch"
        case interlock_state.ReplyReceived(request, refusal, _, pressed):
            if request != ANSWERED.get(state.phase):
                return "to something else"
            return (
                ("accepted" if pressed else "accepted, released")
                if refusal is Refusal.ACCEPTED
                else "refused"
            )
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
        case interlock_state.RecordDurable(token):
            return "pending token" if token == state.token else "another token"
        case interlock_state.LogChanged(log):
            return "writable" if log.writable else "failed"
        case interlock_state.Said(word):
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


def _deviates(effects: tuple[Any, ...]) -> bool:
    return any(isinstance(effect, Deviation) for effect in effects)


ANSWERED: Final = {
    Phase.OPENING: interlock_table.records.Open.TYPE,
    Phase.HELD: interlock_table.records.Acknowledge.TYPE,
    Phase.RESETTING: interlock_table.records.Reset.TYPE,
    Phase.PERMITTING: interlock_table.records.Permit.TYPE,
    Phase.STARTING: interlock_table.records.Start.TYPE,
}
"""The request each phase awaits an answer to."""


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
            said = "another epoch" if epoch != state.epoch else code.name if fresh else f"stale {code.name}"
            ordered = " after CUT" if state.cut_ordered else " before CUT"
            return said + (ordered if state.state is C.CUTTING else "")
        case controller_state.Persisted() | controller_state.PersistFailed():
            return f"{_awaits(state)} waits" if state.awaiting else ""
        case controller_state.StopReceived(code, cause):
            return "withdrawing" if cause in WITHDRAWING else code.name
        case controller_state.Fault(cause):
            return "latching" if cause in LATCHING else "not latching"
        case controller_state.InputsChanged(inputs):
            if not inputs.emergency_stop_clear:
                return "emergency stop"
            return "pressed" if inputs.device_pressed else "released"
        case controller_state.PathFinished():
            return "at the start joints" if state.measured_u == controllers.START_JOINTS else "elsewhere"
        case controller_state.Tick():
            said = "late" if after_s else "in time"
            return f"{said} after CUT" if state.cut_ordered else said
    return ""


# ---------------------------------------------------------------- pictures


def diagram(lines: Iterable[str]) -> str:
    """A Mermaid state diagram."""
    return "\n".join(["```mermaid", "stateDiagram-v2", *(f"    {line}" for line in lines), "```", ""])


def picture(edges: Iterable[Edge], first: str = "", last: Collection[str] = ()) -> str:
    """The edges between different states; each arrow names its events and, after the slash, what leaves."""
    arrows: dict[tuple[str, str], list[str]] = defaultdict(list)
    labels: dict[tuple[str, str, str, tuple[str, ...]], list[str]] = defaultdict(list)
    for edge in edges:
        if edge.source != edge.target:
            labels[edge.source, edge.target, edge.event, edge.effects].append(edge.case)
    for (source, target, event, effects), cases in labels.items():
        said = ", ".join(dict.fromkeys(filter(None, cases)))
        on = f"{event} ({said})" if said else event
        arrows[source, target].append(f"{on} / {', '.join(effects)}" if effects else on)
    lines = [f"[*] --> {first}"] if first else []
    lines += [f"{a} --> {b} : {'<br/>'.join(text)}" for (a, b), text in arrows.items()]
    return diagram(lines + [f"{state} --> [*]" for state in last])


def endings(edges: Iterable[Edge], targets: Collection[str]) -> str:
    """Where each state ends, states that can end alike in one box; a star marks what ends some of the box only."""
    ways: dict[str, dict[str, dict[str, None]]] = {}
    for edge in edges:
        if edge.target in targets and edge.source != edge.target:
            ways.setdefault(edge.source, {}).setdefault(edge.target, {})[edge.event] = None
    boxes: dict[frozenset[str], list[str]] = defaultdict(list)
    for source, way in ways.items():
        boxes[frozenset(way)].append(source)
    lines = ["direction LR"]
    for number, (ends, names) in enumerate(boxes.items(), start=1):
        box = f"box{number}" if len(names) > 1 else names[0]
        if len(names) > 1:
            lines.append(f'state "{"<br/>".join(names)}" as {box}')
        for target in sorted(ends):
            events = dict.fromkeys(event for name in names for event in ways[name][target])
            marked = (
                event if all(event in ways[name][target] for name in names) else f"{event}*"
                for event in events
            )
            lines.append(f"{box} --> {target} : {'<br/>'.join(marked)}")
    return diagram(lines)


# ---------------------------------------------------------------- tables


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table."""
    head = tuple(head)
    lines = [head, ("---",) * len(head), *rows]
    return (
        "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
        + "\n"
    )


def _names(names: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(filter(None, names)))


def own_transitions(edges: Iterable[Edge]) -> str:
    """What only one state answers to: a row for each outcome."""
    rows: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for edge in edges:
        if edge.own:
            target = "stays" if edge.target == edge.source else edge.target
            rows[edge.source, edge.event, edge.handler, target, ", ".join(edge.effects) or "–"].append(
                edge.case
            )
    head = ("state", "event", "case", "handler", "next", "leaves")
    return table(
        head, ((state, event, _names(cases), *rest) for (state, event, *rest), cases in rows.items())
    )


def shared_transitions(edges: Iterable[Edge], states: Iterable[str], events: Any) -> str:
    """What every state answers to that does not answer itself: states with the same outcome share a row."""
    edges, states = [edge for edge in edges if not edge.own], tuple(states)
    where: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for edge in edges:
        target = "stays" if edge.target == edge.source else edge.target
        row = (edge.event, edge.handler, target, ", ".join(edge.effects) or "–", edge.case)
        where[row].append(edge.source)
    rows: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for (event, handler, target, effects, case), sources in where.items():
        answering = {edge.source for edge in edges if edge.event == event}
        places = [state for state in states if state in sources]
        everywhere = set(places) == answering and len(places) > 1
        rows[event, handler, target, effects, "every other" if everywhere else ", ".join(places)].append(case)
    head = ("event", "case", "in", "handler", "next", "leaves")
    order = [event.__name__ for event in events.__args__]
    return table(
        head,
        (
            (event, _names(cases), places, handler, target, effects)
            for (event, handler, target, effects, places), cases in sorted(
                rows.items(), key=lambda row: order.index(row[0][0])
            )
        ),
    )


def _seconds(deadline: Deadline) -> str:
    """The setting that a deadline reads, and its default."""
    read: list[str] = []

    class Probe:
        def __getattr__(self, name: str) -> "Probe":
            read.append(name)
            return self

        def __float__(self) -> float:
            return 0.0

        def __rmul__(self, factor: float) -> float:
            return 0.0

    deadline.seconds(Probe())  # type: ignore[arg-type]
    return f"`{read[-1]}`, {deadline.seconds(builders.JOB):g} s"


def phases() -> str:
    """What each phase says, expects and waits for."""
    rows = []
    for phase in Phase:
        if phase in ENDED:
            continue
        row = PHASES[phase]
        ends = {
            edge.target
            for edge in runtime_edges()
            if (edge.source, edge.case) == (phase.name, "deadline missed")
        }
        deadline, missed = row.deadline, "–"
        if deadline is not None:
            cause = f" ({deadline.cause.name})" if deadline.cause else ""
            missed = f"{deadline.missed}: {_names(sorted(ends))}{cause}"
        expected = None if row.expected is None else _names(kind.name for kind in C if kind in row.expected)
        rows.append(
            (
                phase.name,
                row.heartbeat.name,
                "not judged" if expected is None else expected or "none",
                _seconds(deadline) if deadline is not None else "none",
                missed,
            )
        )
    head = ("phase", "heartbeat says", "controller may report", "deadline", "missed")
    return table(head, rows)


LISTS: Final = ("IDENTITY", "COLLECTED", "FOR_RESET", "FOR_PERMIT", "FOR_START", "AT_START", "FINAL")
NAMED_BOUNDS: Final = {
    "serial_number": "`[controller] serial` of site.toml; any where none is set",
    "limits_approved": "equal to robot.toml's, as canonical bytes",
    "calibration_approved": "equal to robot.toml's, as canonical bytes",
    "tool_approved": "equal to robot.toml's, as canonical bytes",
    "path_digest": "SHA-256 of the path that was sent",
    "verdict_current": "digests of path, limits, calibration and tool equal",
    "registration_age": "<= `registration_max_age_s` of site.toml; none where it is not set",
    "registration_residual": "<= `registration_max_residual_mm` of site.toml; none where it is not set",
    "log_space": ">= twice the bytes this path's log needs",
    "epoch_current": "the session's epoch",
}
"""Bounds that depend on the job: their value says nothing, so that here stands where it comes from."""


def permissive_table() -> str:
    """Every permissive in the order in which it is judged, and the lists that it stands in."""
    lists = {name: getattr(permissives, name) for name in LISTS}
    rows = []
    for judge in dict.fromkeys(judge for members in lists.values() for judge in members):
        permissive = judge(builders.READY, builders.NOW)
        bound = NAMED_BOUNDS.get(judge.__name__, permissive.bound)
        marks = ("yes" if judge in members else "" for members in lists.values())
        rows.append((permissive.name, bound, permissive.remedy, *marks))
    return table(("permissive", "bound", "remedy", *(f"`{name}`" for name in LISTS)), rows)


def tracking_table() -> str:
    """Every rule of the tracking monitor, from steps that break it in each phase in which it does."""
    begun, seen = builders.monitor(builders.NOW), builders.monitor(builders.NOW - 10.0, builders.NOW)
    half_way = builders.measured(builders.HALF_WAY.joints_u, builders.NOW)
    ahead, _ = seen.sample(joints_to_memory(half_way.joints_u), builders.NOW, builders.NOW)
    silent = replace(seen, progressed=Seen(0.0, builders.NOW - 9.0))
    breaking = (
        (seen, builders.measured(builders.ELSEWHERE, builders.NOW), 0.0),
        (begun, half_way, -1.0),
        (seen, interlock_state.ProgressReported(2, 0), 0.0),
        (replace(seen, progress=(1, 1)), builders.ON, 0.0),
        (begun, builders.BEYOND, 0.0),
        (ahead, interlock_state.ProgressReported(0, 0), 0.2),
        (begun, builders.beat(C.DONE), 0.0),
        (begun, interlock_state.Tick(), 0.201),
        (silent, interlock_state.Tick(), 0.16),
        (seen, half_way, 0.0),
    )
    rows: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for monitor, event, after_s in breaking:
        for phase in (phase for phase in Phase if phase in MOVING):
            state = builders.in_phase(phase, tracking=monitor, since_s=builders.NOW - 0.05)
            _, effects = interlock_table.step(state, event, builders.NOW + after_s)
            for deviation in (effect for effect in effects if isinstance(effect, Deviation)):
                for rule in deviation.judged:
                    row = (rule.name, type(event).__name__, rule.bound, deviation.reason)
                    rows[row].append(phase.name)
    head = ("rule", "asked on", "in", "bound, in an example", "what the stop says then")
    return table(head, ((rule, on, _names(where), *said) for (rule, on, *said), where in rows.items()))


@cache
def _rule_lambdas() -> dict[int, str]:
    """The conditions of the lambdas in the rules' module, by line."""
    tree = ast.parse(inspect.getsource(rules))
    return {node.lineno: ast.unparse(node.body) for node in ast.walk(tree) if isinstance(node, ast.Lambda)}


def condition(holds: Callable[..., Any]) -> str:
    """What a rule demands: the expression that it returns at last, and its docstring."""
    if holds.__name__ == "<lambda>":
        text = _rule_lambdas()[holds.__code__.co_firstlineno]
    else:
        body = ast.parse(dedent(inspect.getsource(holds))).body[0]
        returned = (node for node in ast.walk(body) if isinstance(node, ast.Return))
        text = ast.unparse(max(returned, key=lambda node: node.lineno).value or body)
    text = re.sub(r"\b_(\w+)\((case|c)(, purpose)?\)", r"\1", text)  # a part of a rule: its name says it
    words = (holds.__doc__ or "").partition("\n")[0]
    return f"`{re.sub(r'(case|c)[.](controller[.])?', '', text)}` {words}".rstrip()


def rule_table(which: tuple[rules.Rule, ...]) -> str:
    """One request's rules in the order in which they are judged."""
    head = ("", "refusal", "code", "required")
    return table(
        head,
        (
            (str(number), refusal.name, str(int(refusal)), condition(holds))
            for number, (refusal, holds) in enumerate(which, start=1)
        ),
    )


# ---------------------------------------------------------------- the page


def page() -> str:
    """The whole page."""
    runtime, controller = runtime_edges(), controller_edges()
    stops = {phase.name for phase in STOPS}
    held = {phase.name for phase in HELD}
    onward = [edge for edge in runtime if edge.target not in stops and edge.source not in stops]
    live = [phase.name for phase in Phase if phase not in ENDED]
    resting = {C.INHIBITED.name, C.FAULT.name}
    forward = [edge for edge in controller if edge.target not in resting]
    sections = [
        INTRODUCTION,
        "## The runtime's interlock\n",
        "### The way to the cut\n",
        RUNTIME_WAY,
        picture(
            (edge for edge in onward if not {edge.source, edge.target} & held),
            first=Phase.WAITING.name,
            last=[Phase.DONE.name],
        ),
        "### A controller that is held\n",
        RUNTIME_HELD,
        picture(edge for edge in onward if {edge.source, edge.target} & held),
        "### How a session ends\n",
        RUNTIME_ENDS,
        endings(runtime, stops),
        "### Phases, deadlines and what a missed one means\n",
        PHASES_TEXT,
        phases(),
        "### What one phase answers to\n",
        OWN,
        own_transitions(runtime),
        "### What every other phase answers\n",
        shared_transitions(runtime, live, interlock_state.Event),
        "### Permissives\n",
        PERMISSIVES,
        permissive_table(),
        "### The tracking monitor\n",
        TRACKING,
        tracking_table(),
        "## The controller\n",
        "### The way to the cut and out of a latched fault\n",
        CONTROLLER_WAY,
        picture(forward, first=C.INHIBITED.name),
        "### How it stops\n",
        CONTROLLER_STOPS,
        endings(controller, resting),
        "### What one state answers to\n",
        own_transitions(controller),
        "### What every other state answers\n",
        shared_transitions(controller, [state.name for state in C], controller_state.Event),
        "### Why a session is refused\n",
        RULES,
        rule_table(rules.OPEN_RULES),
        "### Why an acknowledgement is refused\n",
        rule_table(rules.ACKNOWLEDGE_RULES),
        "### Why a permit is refused\n",
        rule_table(rules.PERMIT_RULES),
        "### Why a start is refused\n",
        rule_table(rules.START_RULES),
        "### Why a reset is refused\n",
        rule_table(rules.RESET_RULES),
    ]
    return "\n".join(sections)


INTRODUCTION: Final = """# State machines

Generated from the code by `make docs`; change it there. Every arrow and every row was taken by the real `step` of
`runtime/interlock/table.py` or `firmware_sim/table.py`, from a state that is reached from power-up. Events, effects and
handlers bear the names they have in the code. After the slash stands what leaves.
"""
RUNTIME_WAY: Final = """What enables (permit, start) leaves only from the two phases AUTHORISING, when its record is durable and every
permissive has held once more at that moment. The controller's word for the end leads to FINISHING, where the heartbeat
says INHIBIT again: the joints measured next must show the arm back. Stops are left out here; they stand below.
"""
RUNTIME_HELD: Final = """A controller that carries a stop cause or a latched fault is acknowledged and reset by the operator; the reset passes
the audit log like a permit.
"""
RUNTIME_ENDS: Final = """Phases with the same ends share a box; a star marks an event that ends only some of them (the
rows below say which, and in which cases). REFUSED: nothing was enabled. STOPPING: a stop has left and its confirmation is awaited; permit,
nonce and pending record are void. A stop before there is a session ends at STOPPED at once.
"""
PHASES_TEXT: Final = """Defaults in seconds; a site sets them in `site.toml` ([constants.md](constants.md)). A heartbeat that reports anything
else than the controller may report in that phase stops. *Not judged*: the phase has a rule of its own, see its row
below.
"""
OWN: Final = """Where one case has several rows the permissives decide, or what was collected before. *Stays* with nothing that leaves:
at most something is remembered. An ended session (DONE, REFUSED, STOPPED) answers to nothing.
"""
PERMISSIVES: Final = """All of a list are judged each time, in this order, so that a person sees every reason at once. `IDENTITY` is judged when
a controller announces itself, `COLLECTED` when its records are complete, `FOR_RESET`, `FOR_PERMIT` and `FOR_START` when
the word or the nonce is due and again when the record is durable, `AT_START` once more when the controller reports the
end. What fails of `FINAL` can no longer come true, and ends the session at once.
"""
TRACKING: Final = """From the start on the table asks the tracking monitor (`runtime/interlock/tracking.py`) in every step with joints,
progress, DONE or the time. It begins with the reference trajectory of the very verdict that was permitted, and
remembers where the arm was at the earliest at the last sample and the last progress, and how far it can have come. A
sample is dated by when it was measured, whenever it came. What deviates stops in that step, and the decision in the
log holds the rules below with value and bound. What is tolerated, and why a sound arm never deviates:
[protocol.md](protocol.md#tracking). The path of the examples has two segments and takes 0.12 s.
"""
CONTROLLER_WAY: Final = """Requests that are refused change nothing and are not drawn. A start moves nothing yet: the arm moves while the last
fresh heartbeat says CUT with this epoch.
"""
CONTROLLER_STOPS: Final = """States with the same ends share a box; a star marks an event that stops only some of them: the rows below name them. A
stop voids permit, nonce, session, path and transfers and starts a new epoch; causes that latch, and every stop of a
latched controller, end at FAULT. INHIBITED and FAULT stop as well, and stay what they are.
"""
RULES: Final = """The first rule that does not hold answers with its refusal code. The state is the controller's own; `request` is the
record that arrived. A wrong authentication code is a masquerade and latches. An Open or Reset that passes waits for the
memory, and is refused with MEMORY_FAILED if that cannot be written.
"""


def main(target: Path = PAGE) -> None:
    """Write the page."""
    target.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main(*(Path(name) for name in sys.argv[1:]))
