"""Breadth first to a fixed point, with the way back to the beginning, and backward from where the arm moves."""

import time
from array import array
from dataclasses import dataclass, field
from itertools import pairwise

from tests.exploration.model import Model, Move


@dataclass
class Found:
    """An explored graph.

    Attributes:
        states: packed states in the order in which they were found.
        before: for each, the number of the state it was first reached from; -1 for the beginning.
        wrong: the first move that breaks an invariant: the state's number and the move.
        sources, targets: edges of continuations without faults.
    """

    model: Model
    states: list[int] = field(default_factory=list)
    before: array = field(default_factory=lambda: array("i"))
    transitions: int = 0
    depth: int = 0
    seconds: float = 0.0
    wrong: tuple[int, Move] | None = None
    fixed_point: bool = False
    sources: array = field(default_factory=lambda: array("i"))
    targets: array = field(default_factory=lambda: array("i"))

    @property
    def figures(self) -> str:
        """States, transitions, depth, seconds."""
        return f"{len(self.states)} states, {self.transitions} transitions, depth {self.depth}, {self.seconds:.0f} s"

    def way_to(self, number: int) -> list[int]:
        """The numbers of the states from the beginning to this one: a shortest way."""
        way = [number]
        while self.before[way[-1]] >= 0:
            way.append(self.before[way[-1]])
        return way[::-1]

    def moves_to(self, number: int) -> list[tuple[Move, int]]:
        """The moves along a shortest way, each with the state it leads to."""
        way = [self.states[one] for one in self.way_to(number)]
        return [
            (next(move for move, reached in self.model.moves(source) if reached == target), target)
            for source, target in pairwise(way)
        ]


def explore(model: Model, *, begin: int | None = None, most: int | None = None) -> Found:
    """Every state that can be reached from ``begin``; stops at the first broken invariant, or at ``most`` states."""
    began_s, found = time.perf_counter(), Found(model)
    start = model.begin() if begin is None else begin
    numbers, found.before = {start: 0}, array("i", [-1])
    states, before, sources, targets = found.states, found.before, found.sources, found.targets
    states.append(start)
    at, level_ends = 0, 1
    while at < len(states) and found.wrong is None and (most is None or len(states) <= most):
        if at == level_ends:
            found.depth, level_ends = found.depth + 1, len(states)
        for move, reached in model.moves(states[at]):
            found.transitions += 1
            number = numbers.get(reached)
            if number is None:
                number = numbers[reached] = len(states)
                states.append(reached)
                before.append(at)
            if move.sound and number != at:
                sources.append(at)
                targets.append(number)
            if move.wrong is not None:
                found.wrong = (at, move)
                break
        at += 1
    found.fixed_point = at == len(states) and found.wrong is None
    found.seconds = time.perf_counter() - began_s
    return found


def cannot_reach(found: Found, goal: set[int]) -> list[int]:
    """The states from which no continuation without faults leads to ``goal``; both by number."""
    count = len(found.states)
    first = array("i", bytes(4 * (count + 1)))
    for target in found.targets:
        first[target + 1] += 1
    for number in range(count):
        first[number + 1] += first[number]
    place, inward = array("i", first), array("i", bytes(4 * len(found.sources)))
    for source, target in zip(found.sources, found.targets, strict=True):
        inward[place[target]] = source
        place[target] += 1
    reaches, todo = bytearray(count), list(goal)
    for number in todo:
        reaches[number] = 1
    while todo:
        number = todo.pop()
        for source in inward[first[number] : first[number + 1]]:
            if not reaches[source]:
                reaches[source] = 1
                todo.append(source)
    return [number for number in range(count) if not reaches[number]]


def follow(model: Model, texts: list[str]) -> int:
    """The state after these moves, each named as ``who: what``, from the beginning."""
    key = model.begin()
    for text in texts:
        key = next(reached for move, reached in model.moves(key) if f"{move.actor}: {move.text}" == text)
    return key


def chart(model: Model, begin: int, moves: list[tuple[Move, int]], last: Move | None = None) -> str:
    """A way as a sequence chart in plain text: who, what, and where both sides stand after it."""
    rows = [("", "", *_stand(model, begin))]
    rows += [(move.actor, move.text, *_stand(model, reached)) for move, reached in moves]
    if last is not None:
        rows.append((last.actor, last.text, "", ""))
        rows.append(("", f"breaks {last.wrong}", "", ""))
    heads = ("who", "what", "runtime", "controller")
    widths = [max(len(row[column]) for row in (heads, *rows)) for column in range(4)]
    lines = [
        "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True))
        for row in (heads, *rows)
    ]
    return "\n".join(
        f"{'' if index < 2 else index - 1!s:>3}  {line}".rstrip() for index, line in enumerate(lines)
    )


def _stand(model: Model, key: int) -> tuple[str, str]:
    world = model.unpack(key)
    runtime = world.runtime.interlock.phase if world.runtime else "-"
    controller = world.controller.state.name + (" moving" if world.controller.may_move else "")
    return runtime, controller


def trace(found: Found) -> str:
    """The shortest way to the broken invariant."""
    assert found.wrong is not None
    number, move = found.wrong
    return chart(found.model, found.states[0], found.moves_to(number), move)
