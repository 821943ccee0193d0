"""What the controller's state says about itself."""

from dataclasses import is_dataclass

import pytest

from cutgate.firmware_sim import state
from cutgate.firmware_sim.state import Controller, DeviceCycle, Inputs, Memory
from cutgate.protocol.states import ControllerState, StopCause
from tests.altering import altered
from tests.firmware_sim.controllers import CUTTING, EVERY_STATE, POWERED_UP

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
    memory = Memory(frozenset({ONE}), frozenset({TWO}), cause)
    controller = Controller.powered_up(POWERED_UP.identity, POWERED_UP.holdings, memory)
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
    assert Controller(POWERED_UP.identity, POWERED_UP.holdings) == altered(POWERED_UP, "written", None)
    assert Memory() == Memory(frozenset(), frozenset(), StopCause.NONE)


def test_a_registration_that_is_named_is_remembered_beside_the_others():
    before = Memory(frozenset({ONE}), frozenset({TWO}), StopCause.SECOND_NODE)
    assert before.naming(THREE) == Memory(frozenset({ONE, THREE}), frozenset({TWO}), StopCause.SECOND_NODE)


@pytest.mark.parametrize("known", [ONE, TWO])
def test_a_registration_that_is_known_is_not_named_again(known):
    """Above all not one that was withdrawn."""
    before = Memory(frozenset({ONE}), frozenset({TWO}), StopCause.SECOND_NODE)
    assert before.naming(known) == before


def test_what_is_withdrawn_is_everything_that_was_named_and_what_was_withdrawn_before():
    before = Memory(frozenset({ONE, THREE}), frozenset({TWO}), StopCause.SECOND_NODE)
    assert before.all_withdrawn == Memory(frozenset(), frozenset({ONE, TWO, THREE}), StopCause.SECOND_NODE)
    assert before.all_withdrawn.all_withdrawn == before.all_withdrawn


def test_a_session_is_live_until_a_stop_voids_it():
    session = CUTTING.session
    arguments = {name: getattr(session, name) for name in session.__dataclass_fields__ if name != "live"}
    assert type(session)(**arguments).live
