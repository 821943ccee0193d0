"""Transitions as Mermaid diagrams."""

from collections import defaultdict
from collections.abc import Collection, Iterable

from docs.state_machines.edges import Edge


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
        cases_text = ", ".join(dict.fromkeys(filter(None, cases)))
        on = f"{event} ({cases_text})" if cases_text else event
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
