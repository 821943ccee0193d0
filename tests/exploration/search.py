"""Breadth first to a fixed point, over sets of runtimes, with the way back to the beginning."""

import time
from collections import defaultdict
from dataclasses import dataclass, field

from tests.exploration.model import Key, Model, State
from tests.exploration.world import Move


@dataclass
class Found:
    """What was visited.

    Attributes:
        seen: for each controller and what has been said, the runtimes met.
        levels: the states first met after so many moves: for each controller and what has been said, the runtimes.
        wrong: the first move that breaks an invariant: the depth, the state and the move.
    """

    model: Model
    seen: dict[int, dict[int, int]] = field(default_factory=lambda: defaultdict(dict))
    levels: list[dict[Key, int]] = field(default_factory=list)
    transitions: int = 0
    seconds: float = 0.0
    wrong: tuple[State, Move] | None = None
    fixed_point: bool = False

    @property
    def counts(self) -> tuple[int, int, int]:
        """States, transitions, depth."""
        states = sum(runs.bit_count() for level in self.levels for runs in level.values())
        return states, self.transitions, len(self.levels) - 1

    @property
    def figures(self) -> str:
        """The same in words, and seconds of processor time."""
        states, transitions, depth = self.counts
        return f"{states} states, {transitions} transitions, depth {depth}, {self.seconds:.0f} s"


def explore(model: Model, begin: State | None = None, deepest: int | None = None) -> Found:
    """Every state that can be reached, breadth first; stops at the first broken invariant.

    Args:
        model: the two sides.
        begin: where from.
        deepest: how many moves from there the last states are that are looked at, with every move they have.
    """
    began_s, found = time.process_time(), Found(model)
    run, con, said = begin or model.begin()
    level: dict[Key, int] = {(con, said): 1 << run}
    found.seen[con][said] = 1 << run
    while level and found.wrong is None:
        found.levels.append(level)
        reached = _next(found, level)
        if deepest is not None and len(found.levels) > deepest:
            break
        level = _new(found, reached)
    found.fixed_point = not level
    found.seconds = time.process_time() - began_s
    return found


def _next(found: Found, level: dict[Key, int]) -> dict[Key, int]:
    """Where every move leads from these states."""
    model, reached = found.model, defaultdict(int)
    nobody = 1 << model.runtime.none
    for (con, said), runs in level.items():
        if runs & nobody:
            for _move, (started, following, now) in model.starts(con, said):
                reached[following, now] |= 1 << started
        groups, count, broken = model.runtimes_after(runs, model.heard(con, said))
        for (sent, passing), after in groups.items():
            reached[model.with_runtime(con, said, sent, passing)] |= after
        count += runs.bit_count() * len(model.of_controller(con, said))
        wrong = [
            *broken,
            *_moved(model, (con, said), runs, reached),
            *_ages(model, (con, said), runs, reached),
        ]
        found.transitions += count
        if wrong:
            found.wrong = (wrong[0][0], con, said), wrong[0][1]
            break
    return reached


def _moved(model: Model, key: Key, runs: int, reached: dict[Key, int]) -> list[tuple[int, Move]]:
    """The controller moves: where it leads, and what is wrong with it."""
    wrong, renamed = [], {}
    for step in model.of_controller(*key):
        after = renamed.get(step.passing)
        if after is None:
            after = renamed[step.passing] = model.renamed_runtimes(runs, step.passing)
        present, past = after
        if present:
            reached[step.side, step.said] |= present
        if past:
            reached[model.without_runtime(step)] |= 1 << model.runtime.none
        if step.move.wrong:
            wrong.append((runs.bit_length() - 1, step.move))
    return wrong


def _ages(model: Model, key: Key, runs: int, reached: dict[Key, int]) -> list[tuple[int, Move]]:
    """A time-out passes: where it leads, and what is wrong with it."""
    wrong = []
    for cuts, which in ((True, runs & model.runtime.cut), (False, runs & ~model.runtime.cut)):
        if which:
            move, *following = model.ages(*key, cuts=cuts)
            reached[following[0], following[1]] |= which
            if move.wrong:
                wrong.append((which.bit_length() - 1, move))
    return wrong


def way_to(found: Found, state: State, depth: int) -> list[tuple[Move, State]]:
    """The moves of a shortest way from the beginning to a state first met at this depth, each with where it leads."""
    way: list[tuple[Move, State]] = []
    for level in reversed(found.levels[:depth]):
        before, move = next(
            (before, move)
            for (con, said), runs in level.items()
            for before in ((run, con, said) for run in range(runs.bit_length()) if runs >> run & 1)
            for move, reached in found.model.moves(*before)
            if reached == state
        )
        way.append((move, state))
        state = before
    return way[::-1]


def trace(found: Found) -> str:
    """The shortest way to the broken invariant as a sequence chart."""
    assert found.wrong is not None
    state, last = found.wrong
    return chart(found, state, len(found.levels) - 1, (last.actor, last.text), f"breaks {last.wrong}")


def trace_to_controller(found: Found, number: int, what: str) -> str:
    """The shortest way to this controller as a sequence chart, and what is wrong with it."""
    state, depth = next(
        ((runs.bit_length() - 1, con, said), depth)
        for depth, level in enumerate(found.levels)
        for (con, said), runs in level.items()
        if con == number
    )
    return chart(found, state, depth, what)


def chart(found: Found, state: State, depth: int, *last: tuple[str, str] | str) -> str:
    """A shortest way in plain text: who, what, and where both sides stand after it; then the last lines."""
    ((con, said), runs), *_ = found.levels[0].items()
    heads = ("who", "what", "runtime", "controller")
    rows = [heads, ("", "", *_stand(found.model, (runs.bit_length() - 1, con, said)))]
    for move, reached in way_to(found, state, depth):
        rows.append((move.actor, move.text, *_stand(found.model, reached)))
    rows += [("", one, "", "") if isinstance(one, str) else (*one, "", "") for one in last]
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    lines = ["  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)) for row in rows]
    return "\n".join(
        f"{'' if index < 2 else index - 1!s:>3}  {line}".rstrip() for index, line in enumerate(lines)
    )


def _stand(model: Model, state: State) -> tuple[str, str]:
    run, con, _ = state
    side, controller = model.runtime.sides.values[run], model.controller.states.values[con]
    moving = " moving" if controller.may_move else ""
    return side.interlock.phase if side else "-", controller.state.name + moving


def _new(found: Found, reached: dict[Key, int]) -> dict[Key, int]:
    """Of these what was not met before, nor with more said: with more said everything can happen that can with less."""
    level = {}
    for con, said in sorted(reached, key=lambda key: -key[1].bit_count()):
        runs = reached[con, said]
        known = found.seen[con]
        for more, met in known.items():
            if more & said == said:
                runs &= ~met
        if runs:
            known[said] = known.get(said, 0) | runs
            level[con, said] = runs
    return level
