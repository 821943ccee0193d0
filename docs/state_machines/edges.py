"""The transitions that a real ``step`` takes, breadth first from power-up, and what leaves on each."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final

from cutgate.firmware_sim import state as controller_state
from cutgate.protocol.records import Reply
from cutgate.protocol.states import Refusal
from cutgate.runtime.interlock import state as interlock_state

LATE_S: Final = 1e6
"""Longer than every deadline and every lifetime."""


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


def by_table(states: list[str], events: Any) -> Callable[[Edge], tuple[Any, ...]]:
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
