"""Every state of the two tables together that a world allows, and every invariant in it; seeded faults are found.

``docs/exploration.md`` shows the figures and one trace; ``pytest -s tests/exploration`` prints them.
"""

from dataclasses import replace
from pathlib import Path

import pytest

import firmware_sim.table
import runtime.interlock.permissives
import runtime.interlock.table
from firmware_sim.rules import RESET_RULES, START_RULES
from firmware_sim.state import AcknowledgeReceived, Fault, HeartbeatReceived, InputsChanged, StopReceived
from protocol.states import ControllerState, Refusal, StopCause
from runtime.interlock.state import HeartbeatLost, NonceReceived, Phase, Send
from tests.exploration.canonical import EPOCH
from tests.exploration.model import BITS, MASK, POWERED_UP, Model, World
from tests.exploration.search import Found, cannot_reach, chart, explore, follow, trace

pytestmark = pytest.mark.no_cover  # measuring coverage makes millions of steps several times slower

LATCHED = replace(
    firmware_sim.table.step(POWERED_UP, Fault(StopCause.SECOND_NODE), 0.0)[0],
    epoch=EPOCH,
    cause=StopCause.AUTHENTICATION_FAILED,
)

WORLDS: dict[str, World] = {
    "disk and verdicts": World(disk=True),
    "limits": World(limits=True),
    "latched faults": World(latches=True),
    "emergency stop": World(emergency_stop=True),
}
"""Explored to the last state in every run of the tests."""

LONG_WORLDS: dict[str, World] = {
    "reboots and crashes": World(reboots=True, crashes=True),
    "bone, registrations and limits": World(bone=True, limits=True),
}
"""Explored with ``-m long``."""

WITHOUT_THE_WAY_BACK = frozenset({"bone, registrations and limits"})
"""Where invariant 5 is not judged."""

NEAREST = 20_000
"""States visited around the permit and the cut, with an attacker and with two under way."""

DOCS = Path(__file__).parents[2] / "docs" / "exploration.md"


def _moving(found: Found) -> list[int]:
    controllers = found.model.controllers.values
    return [number for number, key in enumerate(found.states) if controllers[key >> BITS & MASK].may_move]


def _explored(name: str, world: World) -> Found:
    """The fixed point, without a broken invariant; a broken one is shown with the shortest way to it."""
    found = explore(Model(world))
    print(f"{name}: {found.figures}")  # noqa: T201 - the figures are the result
    assert found.wrong is None, "\n" + trace(found)
    assert found.fixed_point
    return found


def _the_arm_can_always_move_again(found: Found) -> None:
    """Invariant 5: from every state, latched ones included, the operator gets back to cutting."""
    moving = _moving(found)
    assert moving, "the exploration never saw the arm move"
    stuck = cannot_reach(found, set(moving))
    assert not stuck, f"{len(stuck)} states without a way back, the first:\n" + chart(
        found.model, found.states[0], found.moves_to(stuck[0])
    )


def _motion_can_always_end(found: Found) -> None:
    """Invariant 3, the bound: wherever the arm moves its time-out may pass, and that ends the motion."""
    controllers = found.model.controllers.values
    for number in _moving(found):
        ends = [
            reached
            for move, reached in found.model.moves(found.states[number])
            if (move.actor, move.text) == ("clock", "HeartbeatLost")
        ]
        assert any(not controllers[key >> BITS & MASK].may_move for key in ends)


def _keeps_the_invariants(name: str, world: World) -> None:
    found = _explored(name, world)
    if name not in WITHOUT_THE_WAY_BACK:
        _the_arm_can_always_move_again(found)
    _motion_can_always_end(found)
    listed = f"{name} (invariants but 5)" if name in WITHOUT_THE_WAY_BACK else name
    shown = f"| {listed} | {len(found.states)} | {found.transitions} | {found.depth} |"
    assert shown in DOCS.read_text(encoding="utf-8"), f"docs/exploration.md does not show {shown}"


@pytest.mark.timeout(900)  # a busy machine is no failure
@pytest.mark.parametrize("name", WORLDS)
def test_every_state_of_the_world_keeps_the_invariants(name):
    _keeps_the_invariants(name, WORLDS[name])


@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "world", [World(attacker=True, answers=True), World(queue=2)], ids=["attacker", "two"]
)
@pytest.mark.parametrize("way", ["TO_PERMITTED", "TO_MOVING"])
def test_the_states_nearest_to_permit_and_cut_keep_the_invariants(world, way):
    """Not to a fixed point: an attacker, and two under way in each direction, have more states than a test visits."""
    model = Model(world)
    found = explore(model, begin=follow(model, globals()[way]), most=NEAREST)
    print(f"{way}: {found.figures}")  # noqa: T201 - the figures are the result
    assert found.wrong is None, "\n" + trace(found)


@pytest.mark.long
@pytest.mark.parametrize("name", LONG_WORLDS)
def test_every_state_of_the_larger_world_keeps_the_invariants(name):
    _keeps_the_invariants(name, LONG_WORLDS[name])


# ---------------------------------------------------------------- seeded faults

TO_VERIFYING = [
    "person: starts a session",
    "controller > runtime: Announced",
    "runtime > controller: OpenReceived",
    "controller > runtime: SessionOpened",
    "controller: sends its heartbeat",
    "controller > runtime: heartbeat OPEN, device released",
    "runtime > controller: CollectReceived",
    "runtime: sends its heartbeat",
    "runtime > controller: heartbeat INHIBIT",
    "controller > runtime: ParameterReceived",
    "runtime > controller: PathChecked",
    "controller > runtime: PathStored",
]
TO_PERMITTED = [
    *TO_VERIFYING,
    "worker: verdict admissible",
    "runtime > controller: NonceRequested PERMIT",
    "controller > runtime: NonceReceived PERMIT",
    "disk: record durable",
    "runtime > controller: PermitReceived",
    "person: device pressed",
    "controller > runtime: reply to Permit: ACCEPTED",
    "controller: sends its heartbeat",
    "controller > runtime: heartbeat PERMITTED, device pressed",
]
TO_MOVING = [
    *TO_PERMITTED,
    "operator: says start",
    "runtime > controller: NonceRequested START",
    "controller > runtime: NonceReceived START",
    "disk: record durable",
    "runtime > controller: StartReceived",
    "runtime: sends its heartbeat",
    "runtime > controller: heartbeat CUT",
]


def _finds(world: World, way: list[str], invariant: str, longest: int) -> str:
    """From the end of ``way`` the exploration finds the broken invariant within ``longest`` moves; the chart."""
    model = Model(world)
    found = explore(model, begin=follow(model, way), most=60_000)
    assert found.wrong is not None, found.figures
    number, move = found.wrong
    print("\n" + trace(found))  # noqa: T201 - shown on request
    assert move.wrong.startswith(invariant)
    assert len(found.way_to(number)) <= longest
    assert move.wrong in trace(found)
    return trace(found)


def _without(rules, *refusals):
    return tuple(rule for rule in rules if rule[0] not in refusals)


def _replaced(monkeypatch, table, entry, handler):
    """The transition table with one entry exchanged."""
    monkeypatch.setitem(table, entry, handler)


def _unchanged(state, _event, _now_s):
    return state, ()


def test_without_the_digest_rules_motion_under_a_permit_for_other_limits_is_found(monkeypatch):
    rules = _without(START_RULES, Refusal.LIMITS_DIGEST)
    monkeypatch.setattr(firmware_sim.table, "START_RULES", rules)
    _finds(World(limits=True), TO_PERMITTED, "1:", 9)


def test_without_a_look_at_the_verdict_a_permit_without_an_admissible_one_is_found(monkeypatch):
    permissives = runtime.interlock.permissives
    for module, name in (
        (runtime.interlock.table, "FOR_PERMIT"),
        (permissives, "FINAL"),
    ):
        kept = [one for one in getattr(module, name) if one is not permissives.verdict_admissible]
        monkeypatch.setattr(module, name, tuple(kept))
    _finds(World(disk=True), TO_VERIFYING, "2: a Permit left without an admissible", 5)


def test_without_a_look_at_what_the_verdict_was_made_for_a_permit_for_something_else_is_found(monkeypatch):
    permissives = runtime.interlock.permissives
    for module, name in (
        (runtime.interlock.table, "FOR_PERMIT"),
        (permissives, "FINAL"),
    ):
        kept = [one for one in getattr(module, name) if one is not permissives.verdict_current]
        monkeypatch.setattr(module, name, tuple(kept))
    _finds(World(disk=True), TO_VERIFYING, "2: a Permit left on a verdict for something else", 5)


def test_a_permit_that_does_not_wait_for_the_disk_is_found(monkeypatch):
    def hasty(state, event, _now_s):
        return replace(state, phase=Phase.PERMITTING), (
            Send(runtime.interlock.table._permit(state, event.nonce)),
        )

    _replaced(monkeypatch, runtime.interlock.table.TABLE, (Phase.NONCE_PERMIT, NonceReceived), hasty)
    _finds(World(), TO_VERIFYING, "2: a Permit left without its durable record", 5)


def test_a_controller_that_moves_on_without_the_order_to_cut_is_found(monkeypatch):
    def indifferent(state, event, _now_s):
        return replace(state, cut_ordered=True, heartbeat_fresh=event.fresh), ()

    entry = (ControllerState.CUTTING, HeartbeatReceived)
    _replaced(monkeypatch, firmware_sim.table.TABLE, entry, indifferent)
    _finds(World(), TO_MOVING, "3: motion after HeartbeatReceived", 6)


def test_a_runtime_that_outlives_the_loss_of_heartbeats_is_found(monkeypatch):
    _replaced(monkeypatch, runtime.interlock.table.EVERYWHERE, HeartbeatLost, _unchanged)
    _finds(World(), TO_MOVING, "3: the runtime upholds motion after HeartbeatLost", 2)


def test_a_latch_that_the_end_of_a_session_opens_is_found(monkeypatch):
    def unlatched(state, _event, _now_s):
        return replace(state, state=ControllerState.INHIBITED, session=None), ()

    _replaced(monkeypatch, firmware_sim.table.EVERYWHERE, StopReceived, unlatched)
    _finds(World(begin=LATCHED), [], "4: a latch was left by StopReceived", 8)


def test_a_reset_whose_code_nobody_verifies_is_found(monkeypatch):
    monkeypatch.setattr(firmware_sim.table, "RESET_RULES", _without(RESET_RULES, Refusal.MAC_INVALID))
    _finds(World(begin=LATCHED, attacker=True), [], "4: a latch was left by ResetReceived", 12)


def test_a_cause_that_can_never_be_acknowledged_is_found_as_a_trap(monkeypatch):
    _replaced(monkeypatch, firmware_sim.table.EVERYWHERE, AcknowledgeReceived, _unchanged)
    found = explore(Model(World()))
    stuck = cannot_reach(found, set(_moving(found)))
    assert stuck
    assert len(found.way_to(stuck[0])) <= 6


def test_a_reset_from_before_a_stop_is_found_where_nonce_epoch_and_session_are_not_compared(monkeypatch):
    blind = _without(
        RESET_RULES,
        Refusal.WRONG_SESSION,
        Refusal.NO_NONCE,
        Refusal.NONCE_MISMATCH,
        Refusal.NONCE_EXPIRED,
        Refusal.EPOCH,
    )
    monkeypatch.setattr(firmware_sim.table, "RESET_RULES", blind)
    _finds(World(begin=LATCHED, attacker=True), [], "6: a Reset from before a stop", 12)


def test_a_start_without_the_enabling_device_is_found(monkeypatch):
    rules = _without(START_RULES, Refusal.DEVICE_NOT_RELEASED_AND_PRESSED)
    monkeypatch.setattr(firmware_sim.table, "START_RULES", rules)
    shown = _finds(World(), TO_PERMITTED, "7: motion with the enabling device released", 10)
    assert shown in DOCS.read_text(encoding="utf-8")


def test_a_release_that_does_not_stop_is_found(monkeypatch):
    def noted(state, event, _now_s):
        device = firmware_sim.table._cycle(state.device, event.inputs.device_pressed)
        return replace(state, inputs=event.inputs, device=device), ()

    _replaced(monkeypatch, firmware_sim.table.EVERYWHERE, InputsChanged, noted)
    _finds(World(), TO_MOVING, "7: motion with the enabling device released", 2)
