"""For every invariant a guard is taken out of a table, and the exploration must find the consequence in a few moves.

``pytest -s tests/exploration/test_seeded_faults.py`` prints each as a sequence chart; ``docs/exploration.md`` shows one.
"""

from dataclasses import replace
from pathlib import Path

import pytest

import cutgate.firmware_sim.table
import cutgate.runtime.interlock.permissives
import cutgate.runtime.interlock.table
from cutgate.firmware_sim import state as c
from cutgate.firmware_sim.rules import (
    OPEN_RULES,
    PERMIT_RULES,
    REGISTRATION_RULES,
    RESET_RULES,
    START_RULES,
    WITHDRAW_RULES,
)
from cutgate.protocol import records
from cutgate.protocol.states import WITHDRAWING, ControllerState, FaultCode, Refusal, StopCause
from cutgate.runtime.interlock.state import (
    FaultReceived,
    Gone,
    HeartbeatLost,
    NonceReceived,
    Phase,
    ReplyReceived,
    Send,
    SessionOpened,
    Tick,
)
from cutgate.runtime.interlock.tracking import TrackingMonitor
from cutgate.runtime.kinematics.landmarks import CheckPoints, PointResidual
from tests.altering import altered
from tests.exploration.model import Model
from tests.exploration.names import BARRIER_US, EPOCH, PLACE
from tests.exploration.recovery import Recovery, runtimes_that_do_not_end, stuck
from tests.exploration.search import explore, trace, trace_to_controller
from tests.exploration.traces import LATCHED, TO_MOVING, TO_PERMITTED, TO_RESET, TO_VERIFYING
from tests.exploration.world import START_LOG, World

pytestmark = pytest.mark.no_cover
DOCS = Path(__file__).parents[2] / "docs" / "exploration.md"


def _finds(
    world: World,
    way: tuple[str, ...],
    invariant: str,
    longest: int,
    opened: records.Opened | None = None,
    checked: CheckPoints | None = None,
) -> str:
    """After ``way`` the exploration finds the broken invariant within ``longest`` moves; the chart.

    Without and with what is taken as said or as so.

    Args:
        opened: what the controller has said in OPENED, if not what it said on the way.
        checked: how far the registration's check points are off, if not as in every other world.
    """
    for exact in (False, True):
        model = Model(replace(world, exact=exact))
        run, con, said = Recovery(model).follow(way)
        side = model.runtime.sides.values[run]
        if opened is not None:
            side = replace(side, interlock=replace(side.interlock, opened=opened))
        if checked is not None:
            side = altered(side, "interlock.job.check_points", checked)
        run = model.runtime.sides.number(side)
        found = explore(model, (run, con, said), deepest=longest)
        assert found.wrong is not None, (exact, found.figures)
    shown = trace(found)
    print("\n" + shown)  # noqa: T201 - shown on request
    assert found.wrong[1].wrong.startswith(invariant)
    assert len(found.levels) <= longest
    return shown


def _without(monkeypatch, name, rules, *refusals):
    """The controller's table with fewer rules for one request."""
    kept = tuple(rule for rule in rules if rule[0] not in refusals)
    monkeypatch.setattr(cutgate.firmware_sim.table, name, kept)


def _replaced(monkeypatch, table, entry, handler):
    """The transition table with one entry exchanged."""
    monkeypatch.setitem(table, entry, handler)


NAMES = (Refusal.NONCE_MISMATCH, Refusal.EPOCH, Refusal.WRONG_SESSION, Refusal.ANNOUNCE_NONCE)
"""By what a permit and a reset from before a stop are told."""


def _unchanged(state, _event, _now_s):
    return state, ()


def _blind(monkeypatch, unseen):
    """The runtime without one of its permissives."""
    permissives = cutgate.runtime.interlock.permissives
    table = cutgate.runtime.interlock.table
    lists = ((table, "COLLECTED"), (table, "FOR_PERMIT"), (table, "FOR_START"), (permissives, "FINAL"))
    for module, name in lists:
        kept = [one for one in getattr(module, name) if one is not unseen]
        monkeypatch.setattr(module, name, tuple(kept))


def _remembering(**memory):
    """The controller at the beginning, with this in its memory."""
    begin = World().begin
    remembered = replace(begin.memory, **memory)
    return replace(begin, memory=remembered, written=remembered)


def _without_of_registrations(monkeypatch, refusal):
    """A controller that does not look at this of its memory, nor tells it in OPENED."""
    for name, rules in (
        ("REGISTRATION_RULES", REGISTRATION_RULES),
        ("PERMIT_RULES", PERMIT_RULES),
        ("START_RULES", START_RULES),
    ):
        _without(monkeypatch, name, rules, refusal)


# ---------------------------------------------------------------- 1, 2, 3


@pytest.mark.slow
def test_without_the_digest_rules_motion_under_a_permit_for_other_limits_is_found(monkeypatch):
    _without(monkeypatch, "START_RULES", START_RULES, Refusal.LIMITS_DIGEST)
    _finds(World(limits=True), TO_PERMITTED, "1: motion under a permit for something else", 10)


@pytest.mark.slow
def test_without_the_list_of_the_withdrawn_motion_on_a_withdrawn_registration_is_found(monkeypatch):
    _without_of_registrations(monkeypatch, Refusal.REGISTRATION_WITHDRAWN)
    begin = _remembering(withdrawn=frozenset({PLACE}))
    _finds(World(begin=begin), TO_PERMITTED, "1: motion on a withdrawn registration", 10)


@pytest.mark.slow
def test_where_neither_side_compares_with_the_barrier_motion_on_an_earlier_registration_is_found(monkeypatch):
    _without_of_registrations(monkeypatch, Refusal.REGISTRATION_TOO_EARLY)
    _blind(monkeypatch, cutgate.runtime.interlock.permissives.registration_stands)
    begin = _remembering(barrier_us=BARRIER_US)
    _finds(World(begin=begin), TO_PERMITTED, "1: motion on a registration not later than the barrier", 10)


def test_a_controller_that_does_not_keep_the_barrier_is_found(monkeypatch):
    real = c.Memory.with_barrier
    monkeypatch.setattr(
        c.Memory,
        "with_barrier",
        lambda memory, place, barrier_us, *, settles: replace(
            real(memory, place, barrier_us, settles=settles), barrier_us=memory.barrier_us
        ),
    )
    _finds(World(bone=True), TO_PERMITTED, "1: the barrier that a Withdraw tells was not kept", 3)


@pytest.mark.slow
def test_where_a_withdrawal_that_is_due_is_only_noted_motion_is_found(monkeypatch):
    def noted(state, _event, now_s):
        return cutgate.firmware_sim.table._with_motion(state, now_s), ()

    _replaced(monkeypatch, cutgate.firmware_sim.table.EVERYWHERE, c.BoneMoved, noted)
    _without(monkeypatch, "START_RULES", START_RULES, Refusal.WITHDRAWAL_DUE, Refusal.REGISTRATION_WITHDRAWN)
    _finds(World(bone=True), TO_PERMITTED, "1: motion while a withdrawal is due", 10)


def test_without_a_look_at_the_verdict_a_permit_without_an_admissible_one_is_found(monkeypatch):
    _blind(monkeypatch, cutgate.runtime.interlock.permissives.verdict_admissible)
    _finds(World(disk=True), TO_VERIFYING, "2: a Permit left without an admissible", 5)


def test_without_a_look_at_the_witness_a_permit_beside_a_log_that_is_gone_is_found(monkeypatch):
    _blind(monkeypatch, cutgate.runtime.interlock.permissives.controllers_witness)
    opened = records.Opened(EPOCH, ControllerState.OPEN, StopCause.NONE, log=START_LOG)
    shown = "2: a Permit left although the log that the controller saw last was not found"
    _finds(World(warned=True), TO_VERIFYING, shown, 6, opened)


def test_without_a_look_at_the_warnings_a_permit_with_one_that_is_not_confirmed_is_found(monkeypatch):
    _blind(monkeypatch, cutgate.runtime.interlock.permissives.warnings_confirmed)
    _finds(World(warned=True), TO_VERIFYING, "2: a Permit left although a warning was not confirmed", 6)


@pytest.mark.parametrize(
    "checked",
    [CheckPoints((PointResidual("P1", 0.5), PointResidual("P2", 2.5))), CheckPoints(least=1)],
    ids=["off", "missing"],
)
def test_without_a_look_at_the_check_points_a_permit_beside_one_that_is_off_or_missing_is_found(
    monkeypatch, checked
):
    _blind(monkeypatch, cutgate.runtime.interlock.permissives.check_points)
    shown = "2: a Permit left although a check point of the registration is off or missing"
    _finds(World(disk=True), TO_VERIFYING, shown, 5, checked=checked)


def test_without_a_look_at_what_the_verdict_was_made_for_a_permit_for_something_else_is_found(monkeypatch):
    _blind(monkeypatch, cutgate.runtime.interlock.permissives.verdict_current)
    _finds(World(disk=True), TO_VERIFYING, "2: a Permit left on a verdict for something else", 5)


def test_a_permit_that_does_not_wait_for_the_disk_is_found(monkeypatch):
    def hasty(state, event, _now_s):
        permit = cutgate.runtime.interlock.table._permit(state, event.nonce)
        return replace(state, phase=Phase.PERMITTING), (Send(permit),)

    _replaced(monkeypatch, cutgate.runtime.interlock.table.TABLE, (Phase.NONCE_PERMIT, NonceReceived), hasty)
    _finds(World(), TO_VERIFYING, "2: a Permit left without its durable record", 5)


def test_a_controller_that_moves_on_without_the_order_to_cut_is_found(monkeypatch):
    def indifferent(state, event, _now_s):
        return replace(state, cut_ordered=True, heartbeat_fresh=event.fresh), ()

    entry = (ControllerState.CUTTING, c.HeartbeatReceived)
    _replaced(monkeypatch, cutgate.firmware_sim.table.TABLE, entry, indifferent)
    _finds(World(), TO_MOVING, "3: motion after HeartbeatReceived", 2)


def test_a_runtime_that_outlives_the_loss_of_heartbeats_is_found(monkeypatch):
    _replaced(monkeypatch, cutgate.runtime.interlock.table.EVERYWHERE, HeartbeatLost, _unchanged)
    _finds(World(), TO_MOVING, "3: the runtime upholds motion after HeartbeatLost", 2)


@pytest.mark.parametrize(
    ("rule", "found"),
    [
        ("sample", "JointsMeasured"),
        ("report", "ProgressReported"),
        ("finished", "HeartbeatReceived"),
        ("overdue", "Tick"),
    ],
)
def test_a_tracking_monitor_that_sees_nothing_is_found_in_each_of_its_rules(monkeypatch, rule, found):
    moves_on = rule in ("sample", "report")
    blind = (lambda monitor, *_: (monitor, None)) if moves_on else (lambda *_: None)
    monkeypatch.setattr(TrackingMonitor, rule, blind)
    if rule == "finished":  # leads to FINISHING, where nothing is ordered any more, without a stop
        _finds(World(), TO_MOVING, f"3: no stop left after {found}", 2)
    else:
        _finds(World(), TO_MOVING, f"3: the runtime upholds motion after {found}", 2)


def test_a_runtime_that_outlives_its_own_failure_is_found(monkeypatch):
    _replaced(monkeypatch, cutgate.runtime.interlock.table.EVERYWHERE, Gone, _unchanged)
    _finds(World(), TO_MOVING, "3: the runtime upholds motion after Gone", 2)


# ---------------------------------------------------------------- 4, 5


def test_a_latch_that_the_end_of_a_session_opens_is_found(monkeypatch):
    def unlatched(state, _event, _now_s):
        return replace(state, state=ControllerState.INHIBITED, session=None), ()

    _replaced(monkeypatch, cutgate.firmware_sim.table.EVERYWHERE, c.StopReceived, unlatched)
    _finds(World(begin=LATCHED), (), "4: a latch was left by StopReceived", 5)


def test_a_latch_that_a_loss_of_power_opens_is_found(monkeypatch):
    def forgetful(identity, holdings, memory, announce_nonce):
        return c.Controller(identity, holdings, announce_nonce, memory=memory, written=memory)

    monkeypatch.setattr(c.Controller, "powered_up", forgetful)
    _finds(World(reboots=True), (), "4: a latch was left by a loss of power", 5)


def test_a_reset_whose_code_nobody_verifies_is_found(monkeypatch):
    _without(monkeypatch, "RESET_RULES", RESET_RULES, Refusal.MAC_INVALID)
    _finds(World(begin=LATCHED), TO_RESET[:6], "4: a latch was left by ResetReceived", 8)


def test_a_cause_that_can_never_be_acknowledged_is_found_as_a_trap(monkeypatch):
    _replaced(monkeypatch, cutgate.firmware_sim.table.EVERYWHERE, c.AcknowledgeReceived, _unchanged)
    found = explore(Model(World(exact=True)), deepest=1)
    trapped = stuck(found.model, found.seen)
    shown = trace_to_controller(found, trapped[0], "breaks 5: there is no way back")
    print("\n" + shown)  # noqa: T201 - shown on request
    assert len(found.levels) == 2
    assert "fault (SEQUENCE_ERROR)" in shown


def test_a_runtime_that_waits_for_the_confirmation_of_its_stop_for_ever_is_found(monkeypatch):
    table = cutgate.runtime.interlock.table
    _replaced(monkeypatch, table.TABLE, (Phase.STOPPING, HeartbeatLost), _unchanged)
    _replaced(monkeypatch, table.EVERYWHERE, Tick, _unchanged)
    model = Model(World(exact=True))
    explore(model, Recovery(model).follow(TO_MOVING), deepest=1)
    endless = runtimes_that_do_not_end(model)
    assert endless
    assert model.runtime.sides.values[endless[0]].interlock.phase is Phase.STOPPING


# ---------------------------------------------------------------- 6: permit, start, reset


@pytest.mark.slow
def test_a_permit_from_before_a_stop_is_found_where_nonce_epoch_and_session_are_not_compared(monkeypatch):
    _without(monkeypatch, "PERMIT_RULES", PERMIT_RULES, *NAMES)
    _finds(World(), TO_PERMITTED, "6: a Permit from before a stop", 10)


def test_a_start_from_an_earlier_session_is_found_where_nothing_in_it_is_compared(monkeypatch):
    compared = (Refusal.WRONG_SESSION, Refusal.NONCE_MISMATCH, Refusal.PERMIT_MISMATCH)
    _without(monkeypatch, "START_RULES", START_RULES, *compared)
    _finds(World(), TO_PERMITTED, "6: a Start from before a stop", 5)


@pytest.mark.slow
def test_a_start_after_a_stop_that_voids_nothing_is_found(monkeypatch):
    def said_only(state, event, _now_s):
        return state, (c.SendFault(FaultCode.STOPPED, event.cause),)

    _replaced(monkeypatch, cutgate.firmware_sim.table.EVERYWHERE, c.FaultArisen, said_only)
    _finds(World(), TO_PERMITTED, "6: a Start from before a stop", 8)


@pytest.mark.slow
def test_a_reset_from_before_a_stop_is_found_where_nonce_epoch_and_session_are_not_compared(monkeypatch):
    _without(monkeypatch, "RESET_RULES", RESET_RULES, *NAMES)
    _finds(World(begin=LATCHED), TO_RESET, "6: a Reset from before a stop", 10)


# ---------------------------------------------------------------- 7


@pytest.mark.slow
def test_a_start_without_the_enabling_device_is_found(monkeypatch):
    _without(monkeypatch, "START_RULES", START_RULES, Refusal.DEVICE_NOT_RELEASED_AND_PRESSED)
    shown = _finds(World(), TO_PERMITTED, "7: motion with the enabling device released", 10)
    assert shown in DOCS.read_text(encoding="utf-8")


def test_a_release_that_does_not_stop_is_found(monkeypatch):
    def noted(state, event, _now_s):
        device = cutgate.firmware_sim.table._cycle(state.device, event.inputs.device_pressed)
        return replace(state, inputs=event.inputs, device=device), ()

    _replaced(monkeypatch, cutgate.firmware_sim.table.EVERYWHERE, c.InputsChanged, noted)
    _finds(World(), TO_MOVING, "7: motion with the enabling device released", 2)


# ---------------------------------------------------------------- 8: heartbeats


@pytest.mark.parametrize("link", ["tag", "session", "round", "arrival"])
def test_motion_that_heartbeats_uphold_which_the_link_must_not_let_through_is_found(link):
    """Made up, of another session, of a round of the counter before, held back and counted from its arrival."""
    _finds(World(link=f"controller: {link}"), TO_MOVING, "8: motion outlasts the runtime's will", 5)


@pytest.mark.parametrize("link", ["tag", "session"])
def test_a_permitted_controller_that_only_a_made_up_heartbeat_reports_is_found(link):
    found = "11: permitted is believed by HeartbeatReceived"
    _finds(World(link=f"runtime: {link}"), TO_PERMITTED[:5], found, 6)


def test_a_controller_that_outlives_the_loss_of_heartbeats_is_found(monkeypatch):
    _replaced(monkeypatch, cutgate.firmware_sim.table.EVERYWHERE, c.HeartbeatLost, _unchanged)
    _finds(World(), TO_MOVING, "3: motion after HeartbeatLost", 2)


# ---------------------------------------------------------------- 9: registrations


def test_a_withdrawal_by_a_made_up_heartbeat_is_found():
    _finds(
        World(link="controller: tag", bone=True),
        TO_VERIFYING,
        "9: a registration was withdrawn or restored",
        3,
    )


def test_a_controller_that_an_unkeyed_stop_makes_withdraw_is_found(monkeypatch):
    def obedient(state, event, now_s):
        if event.cause in WITHDRAWING:
            state = cutgate.firmware_sim.table._with_motion(state, now_s)
        return cutgate.firmware_sim.table.stop(state, event.cause)

    _replaced(monkeypatch, cutgate.firmware_sim.table.EVERYWHERE, c.StopReceived, obedient)
    _finds(World(bone=True), TO_VERIFYING, "9: a registration was withdrawn or restored by StopReceived", 2)


def test_a_runtime_that_an_unkeyed_fault_makes_withdraw_is_found(monkeypatch):
    def obedient(state, event, now_s):
        return cutgate.runtime.interlock.table._stopped_by(state, event.cause, "", now_s)

    _replaced(monkeypatch, cutgate.runtime.interlock.table.EVERYWHERE, FaultReceived, obedient)
    _finds(World(bone=True), TO_VERIFYING, "9: a registration was withdrawn by FaultReceived", 2)


def test_a_runtime_that_takes_the_cause_its_session_was_opened_on_for_news_is_found(monkeypatch):
    """A stop by anybody brings it back."""
    real = cutgate.runtime.interlock.table.opened

    def unmindful(state, event, now_s):
        seen, effects = real(state, event, now_s)
        return replace(seen, held_on=StopCause.NONE), effects

    _replaced(monkeypatch, cutgate.runtime.interlock.table.TABLE, (Phase.OPENING, SessionOpened), unmindful)
    _finds(
        World(bone=True), (), "9: a registration was withdrawn by the cause that its session was opened on", 5
    )


@pytest.mark.parametrize("seeded", ["withdraw", "open"])
def test_a_withdraw_and_an_open_whose_code_nobody_verifies_are_found(monkeypatch, seeded):
    if seeded == "open":
        _without(monkeypatch, "OPEN_RULES", OPEN_RULES, Refusal.MAC_INVALID)
        _finds(World(), (), "9: a registration was named by OpenReceived", 2)
    else:
        _without(monkeypatch, "WITHDRAW_RULES", WITHDRAW_RULES, Refusal.MAC_INVALID)
        _finds(World(), TO_VERIFYING, "9: a registration was withdrawn or restored by WithdrawReceived", 2)


def test_a_withdraw_that_settles_what_happened_after_its_session_was_opened_is_found(monkeypatch):
    """Said before the bone moved, it arrives afterwards."""
    real = c.Memory.with_barrier
    monkeypatch.setattr(
        c.Memory,
        "with_barrier",
        lambda memory, place, barrier_us, **_: real(memory, place, barrier_us, settles=True),
    )
    found = "9: a withdrawal is due no longer by a Withdraw of a session that was opened before it"
    shown = _finds(World(bone=True), TO_VERIFYING, found, 3)
    assert "BoneMoved" in shown


# ---------------------------------------------------------------- 10, 11: what opens, what is believed


def test_an_open_that_opens_twice_is_found_where_no_new_announce_nonce_is_drawn(monkeypatch):
    real = cutgate.firmware_sim.table.open_received

    def constant(state, event, now_s):
        opened, effects = real(state, event, now_s)
        return replace(opened, announce_nonce=state.announce_nonce), effects

    _replaced(monkeypatch, cutgate.firmware_sim.table.EVERYWHERE, c.OpenReceived, constant)
    _finds(World(), (), "10: the same OPEN opened twice", 6)


@pytest.mark.parametrize(
    ("awaiting", "record", "believed", "way"),
    [
        (Phase.PERMITTING, records.Permit, Phase.PERMITTED, TO_PERMITTED[:5]),
        (Phase.STARTING, records.Start, Phase.CUTTING, TO_MOVING[:-2]),
    ],
)
def test_a_permit_and_a_start_that_an_unkeyed_reply_makes_believed_are_found(
    monkeypatch, awaiting, record, believed, way
):
    def credulous(state, event, _now_s):
        accepted = event.request_type == record.TYPE and event.refusal is Refusal.ACCEPTED
        return (replace(state, phase=believed) if accepted else state), ()

    _replaced(monkeypatch, cutgate.runtime.interlock.table.TABLE, (awaiting, ReplyReceived), credulous)
    _finds(World(), way, f"11: {believed} is believed by ReplyReceived", 6)


def test_an_opened_whose_code_nobody_verifies_is_found(monkeypatch):
    real = cutgate.runtime.interlock.table.opened

    def credulous(state, event, now_s):
        return real(state, replace(event, authentic=True), now_s)

    _replaced(monkeypatch, cutgate.runtime.interlock.table.TABLE, (Phase.OPENING, SessionOpened), credulous)
    _finds(World(), (), "11: a session is believed to be open by SessionOpened", 4)


# ---------------------------------------------------------------- 6: the memory takes its time


def test_a_start_that_is_not_judged_again_once_it_is_durable_is_found(monkeypatch):
    def begun(state, event, now_s):
        cutting = replace(state, state=ControllerState.CUTTING, issued=None, started_at_s=now_s)
        return cutting, (cutgate.firmware_sim.table._accept(cutting, event.start, event.sequence),)

    monkeypatch.setattr(cutgate.firmware_sim.table, "begin_cut", begun)
    _finds(World(), TO_MOVING[:-2], "6: a start was carried out after its lifetime", 6)
