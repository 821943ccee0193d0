"""Every state of the two tables together that a world allows, and every invariant in it.

``docs/exploration.md`` shows the figures; ``pytest -s tests/exploration`` prints them.
"""

from pathlib import Path

import pytest

from cutgate.firmware_sim.state import HeartbeatLost
from tests.exploration.alone import alone
from tests.exploration.exact import left_out, met_exactly
from tests.exploration.model import Model
from tests.exploration.recovery import runtimes_that_do_not_end, stuck
from tests.exploration.search import Found, explore, trace, trace_to_controller
from tests.exploration.traces import TO_MOVING, TO_VERIFYING
from tests.exploration.world import World

pytestmark = pytest.mark.no_cover  # measuring coverage makes millions of steps several times slower

WORLDS: dict[str, World] = {
    "disk, memory, loss of power": World(disk=True, reboots=True),
    "a warning to confirm": World(warned=True),
}
"""Explored to the last state in every run of the tests."""

LARGER_WORLDS: dict[str, World] = {
    "emergency stop, limits, disk, memory, loss of power": World(
        emergency_stop=True, limits=True, disk=True, reboots=True
    ),
    "bone, registrations, loss of power": World(bone=True, reboots=True),
}
"""To the last state as well, in ``make test-all``."""

LARGE_WORLDS: dict[str, World] = {
    "all of these together": World(
        bone=True, emergency_stop=True, limits=True, disk=True, warned=True, reboots=True
    ),
}
"""To the last state as well, with ``-m long``."""

DOCS = Path(__file__).parents[2] / "docs" / "exploration.md"


def _every_stop_is_left(found: Found) -> None:
    """Invariant 5, at the controller: without a process a new session leads from every state to the cut."""
    trapped = stuck(found.model, found.seen)
    assert not trapped, "\n" + trace_to_controller(found, trapped[0], "breaks 5: there is no way back")


def _motion_can_always_end(found: Found) -> None:
    """Invariant 3, the bound: wherever the arm moves its time-out may pass, and that ends the motion."""
    side = found.model.controller
    moving = [state for state in side.states.values if state.may_move]
    assert moving, "the exploration never saw the arm move"
    for state in moving:
        ended = side.states.values[side.feed(state, "clock", HeartbeatLost()).side]
        assert not ended.may_move


def _keeps_the_invariants(name: str, world: World) -> None:
    found = explore(Model(world))
    print(f"{name}: {found.figures}")  # noqa: T201 - the figures are the result
    assert found.wrong is None, "\n" + trace(found)
    assert found.fixed_point
    _every_stop_is_left(found)
    _motion_can_always_end(found)
    ways = {(): 5, TO_VERIFYING: 3} if world.warned else {(): 5, TO_VERIFYING: 3, TO_MOVING: 3}
    assert left_out(found, met_exactly(world, ways)) is None
    shown = f"| {name} | {' | '.join(map(str, found.counts))} |"
    assert shown in DOCS.read_text(encoding="utf-8"), f"docs/exploration.md does not show {shown}"


@pytest.mark.timeout(900)  # a busy machine is no failure
@pytest.mark.parametrize("name", WORLDS)
def test_every_state_of_the_world_keeps_the_invariants(name):
    _keeps_the_invariants(name, WORLDS[name])


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", LARGER_WORLDS)
def test_every_state_of_the_larger_world_keeps_the_invariants(name):
    _keeps_the_invariants(name, LARGER_WORLDS[name])


@pytest.mark.long
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("name", LARGE_WORLDS)
def test_every_state_of_the_large_world_keeps_the_invariants(name):
    _keeps_the_invariants(name, LARGE_WORLDS[name])


@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    ("world", "shown"),
    [
        (World(), ""),
        pytest.param(World(bone=True, emergency_stop=True, disk=True), "", marks=pytest.mark.slow),
        pytest.param(
            World(bone=True, emergency_stop=True, disk=True, warned=True),
            "{} runtimes by themselves",
            marks=pytest.mark.long,
        ),
    ],
    ids=["smallest", "larger", "largest"],
)
def test_every_runtime_by_itself_keeps_the_invariants_and_ends_at_the_operators_stop(world, shown):
    """Also what is past, and so led on nowhere else; the largest world contains those of every other."""
    model = Model(world)
    runtimes, wrong = alone(model)
    assert not wrong
    assert not runtimes_that_do_not_end(model)
    assert shown.format(runtimes) in DOCS.read_text(encoding="utf-8")
