"""Transitions as Markdown tables."""

from collections import defaultdict
from collections.abc import Iterable
from typing import Any

from docs.state_machines.edges import Edge


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table."""
    head = tuple(head)
    lines = [head, ("---",) * len(head), *rows]
    return (
        "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
        + "\n"
    )


def names(given: Iterable[str]) -> str:
    """Each once, in the order given."""
    return ", ".join(dict.fromkeys(filter(None, given)))


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
    return table(head, ((state, event, names(cases), *rest) for (state, event, *rest), cases in rows.items()))


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
            (event, names(cases), places, handler, target, effects)
            for (event, handler, target, effects, places), cases in sorted(
                rows.items(), key=lambda row: order.index(row[0][0])
            )
        ),
    )
