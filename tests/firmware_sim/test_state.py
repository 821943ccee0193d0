"""What the controller's state says about itself."""

import math
from dataclasses import is_dataclass, replace

import pytest

from cutgate.firmware_sim import state
from cutgate.firmware_sim.state import Controller, ControllerSession, DeviceCycle, Inputs, Memory
from cutgate.protocol import records
from cutgate.protocol.states import ControllerState, StopCause
from tests.altering import altered
from tests.firmware_sim.controllers import (
    CUTTING,
    EVERY_STATE,
    NOW,
    OPEN,
    POWERED_UP,
    SESSION,
    START_LOG,
    TAG,
)

ONE, TWO, THREE = bytes(range(32)), bytes(32), b"x" * 32


@pytest.mark.parametrize(
    "kind", [kind for kind in vars(state).values() if isinstance(kind, type) and is_dataclass(kind)]
)
def test_what_was_decided_on_is_not_altered_afterwards(kind):
    assert kind.__dataclass_params__.frozen


def test_power_up_is_inhibited():
    assert POWERED_UP.state is ControllerState.INHIBITED
    assert not POWERED_UP.may_move
    assert not POWERED_UP.cutting_mode
    assert not POWERED_UP.heartbeat_fresh
    assert POWERED_UP.inputs == Inputs(device_pressed=False, emergency_stop_clear=True)


def test_never_measured_is_not_at_the_start():
    assert POWERED_UP.measured_u is None


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *(("state", state) for state in ControllerState if state is not ControllerState.CUTTING),
        ("cut_ordered", False),
        ("heartbeat_fresh", False),
        ("session", None),
        ("session.live", False),
    ],
)
def test_motion_needs_every_part_of_its_level(field, value):
    assert CUTTING.may_move
    assert not altered(CUTTING, field, value).may_move


@pytest.mark.parametrize("name", EVERY_STATE)
def test_the_cutter_may_spin_only_permitted_or_cutting(name):
    controller = EVERY_STATE[name]
    spins = controller.state in (ControllerState.PERMITTED, ControllerState.CUTTING)
    assert controller.cutting_mode is spins
    assert controller.may_move is (name == "cutting")


@pytest.mark.parametrize("cause", StopCause)
def test_at_power_up_a_fault_that_was_latched_still_is_and_nothing_else_is_left(cause):
    memory = Memory(frozenset({ONE}), frozenset({TWO}), 17, True, START_LOG, cause)
    controller = Controller.powered_up(POWERED_UP.identity, POWERED_UP.holdings, memory, b"a" * 16)
    assert (controller.announce_nonce, controller.moved_at_s) == (b"a" * 16, None)
    latched = cause is not StopCause.NONE
    assert controller.state is (ControllerState.FAULT if latched else ControllerState.INHIBITED)
    assert controller.cause is cause
    assert controller.memory == controller.written == memory
    assert (controller.identity, controller.holdings) == (POWERED_UP.identity, POWERED_UP.holdings)
    assert (controller.session, controller.permit, controller.issued, controller.awaiting) == (
        None,
        None,
        None,
        None,
    )
    assert (controller.epoch, controller.device, controller.cut_ordered) == (0, DeviceCycle.UNSEEN, False)
    assert (controller.permit_issued_at_s, controller.started_at_s) == (0.0, 0.0)


def test_nothing_is_known_of_what_is_written_until_it_is():
    old = POWERED_UP
    assert Controller(old.identity, old.holdings, old.announce_nonce) == altered(old, "written", None)
    assert Memory() == Memory(
        frozenset(), frozenset(), records.NO_TIME, False, records.NO_TREE_HEAD, StopCause.NONE
    )


BEFORE = Memory(frozenset({ONE}), frozenset({TWO}), 17, False, START_LOG, StopCause.SECOND_NODE)


@pytest.mark.parametrize(("place", "listed"), [(THREE, {ONE, THREE}), (ONE, {ONE}), (None, {ONE})])
def test_a_bone_that_moves_withdraws_the_place_that_is_named_and_is_due(place, listed):
    after = BEFORE.with_motion(place)
    assert after == replace(BEFORE, withdrawn=frozenset(listed), withdrawal_due=True)
    assert after.with_motion(place) == after


@pytest.mark.parametrize("due", [True, False])
@pytest.mark.parametrize("settles", [True, False])
@pytest.mark.parametrize(("barrier_us", "kept_us"), [(16, 17), (17, 17), (18, 18), (-1, 17)])
@pytest.mark.parametrize(("place", "listed"), [(THREE, {ONE, THREE}), (records.NO_PLACE, {ONE})])
def test_a_withdraw_names_a_place_or_none_raises_the_barrier_and_may_settle_what_is_due(
    due, settles, barrier_us, kept_us, place, listed
):
    after = replace(BEFORE, withdrawal_due=due).with_barrier(place, barrier_us, settles=settles)
    still_due = due and not settles
    assert after == replace(BEFORE, withdrawn=frozenset(listed), barrier_us=kept_us, withdrawal_due=still_due)


def test_a_barrier_before_1970_is_none():
    assert Memory().with_barrier(records.NO_PLACE, -1, settles=True).barrier_us == records.NO_TIME


@pytest.mark.parametrize(
    ("ago_s", "age_s"),
    [
        (0.0, 0),
        (0.999, 0),
        (3.999, 3),
        (4.0, 4),
        (-0.001, records.AGE_UNKNOWN),
        (2.0**33, records.AGE_UNKNOWN),
        (float(records.AGE_UNKNOWN), records.AGE_UNKNOWN),
        (records.AGE_UNKNOWN - 1.0, records.AGE_UNKNOWN - 1),
        (math.nan, records.AGE_UNKNOWN),
        (math.inf, records.AGE_UNKNOWN),
    ],
)
def test_the_age_of_a_motion_is_in_whole_seconds_rather_too_few(ago_s, age_s):
    """The runtime's barrier is then rather too late than too early."""
    assert replace(POWERED_UP, moved_at_s=0.0).motion_age_s(ago_s) == age_s


def test_the_age_of_a_motion_runs_from_it():
    assert replace(POWERED_UP, moved_at_s=NOW - 12.5).motion_age_s(NOW) == 12


def test_the_plant_of_a_controller_runs_as_the_clock_unless_it_says_otherwise():
    assert POWERED_UP.identity.plant_speed_permille == 1000


def test_the_age_of_a_motion_before_power_up_is_not_known():
    assert POWERED_UP.motion_age_s(NOW) == records.AGE_UNKNOWN


def test_a_session_is_what_its_open_agrees_on():
    assert ControllerSession.of(OPEN) == ControllerSession(
        tag=TAG,
        digest=SESSION,
        announce_nonce=OPEN.announce_nonce,
        registration=OPEN.registration_digest,
        place=OPEN.place_digest,
        registration_time_us=OPEN.registration_time_us,
        configuration=OPEN.configuration_digest,
        verifier="cutgate test",
        permit_lifetime_s=120.0,
        start_lifetime_s=2.0,
        start_tolerance_mm=0.5,
        start_tolerance_deg=0.2,
        approach_clearance_um=10_000,
        approach_speed_percent=25,
        heartbeat_s=0.02,
        timeout_s=0.1,
        live=True,
        withdrawn=False,
    )


def test_a_session_is_live_until_a_stop_voids_it():
    session = CUTTING.session
    arguments = {name: getattr(session, name) for name in session.__dataclass_fields__ if name != "live"}
    assert type(session)(**arguments).live
