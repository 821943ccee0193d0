"""The exact world against the one in which something is taken as said or as so, or has died: nothing is left out."""

from collections.abc import Iterator
from dataclasses import replace
from functools import reduce
from operator import or_

from cutgate.firmware_sim import state as c
from tests.exploration.model import Model
from tests.exploration.names import Passing, RuntimeSide
from tests.exploration.recovery import Recovery
from tests.exploration.search import Found, explore
from tests.exploration.world import World

Ways = dict[tuple[str, ...], int]
"""Where from, as moves without faults, and how many moves of every kind from there."""
Pair = tuple[c.Controller, RuntimeSide | None]


def met_exactly(world: World, ways: Ways) -> set[Pair]:
    """The two sides of every state that so many moves lead to, with nothing taken as said or as so, and no runtime dead."""
    model, found = Model(replace(world, exact=True)), set()
    for way, deepest in ways.items():
        found |= set(_pairs(explore(model, Recovery(model).follow(way), deepest)))
    return found


def left_out(found: Found, met: set[Pair]) -> Pair | None:
    """One that no state of this world stands for."""
    here = _runtimes(found)
    for state, side in met:
        con, run = _standing_for(found.model, state, side)
        if not here.get(con, 0) >> run & 1:
            return state, side
    return None


def _runtimes(found: Found) -> dict[int, int]:
    """For each controller the runtimes met with it."""
    return {con: reduce(or_, sets.values()) for con, sets in found.seen.items()}


def _pairs(found: Found) -> Iterator[Pair]:
    states, sides = found.model.controller.states.values, found.model.runtime.sides.values
    for con, runs in _runtimes(found).items():
        yield from ((states[con], side) for run, side in enumerate(sides) if runs >> run & 1)


def _standing_for(model: Model, state: c.Controller, side: RuntimeSide | None) -> tuple[int, int]:
    """The numbers of the two that stand for these."""
    con, run = model.controller.number(state), model.settled(model.runtime.sides.number(side))
    if not model.past(run):
        return con, run
    return model.with_runtime(con, 0, 0, Passing.SESSION)[0], model.runtime.none
