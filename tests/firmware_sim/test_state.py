"""What the controller's state says about itself."""

import pytest

from cutgate.firmware_sim.state import Inputs
from cutgate.protocol.states import ControllerState
from tests.altering import altered
from tests.firmware_sim.controllers import CUTTING, EVERY_STATE, POWERED_UP


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
    state = EVERY_STATE[name]
    assert state.cutting_mode is (state.state in (ControllerState.PERMITTED, ControllerState.CUTTING))
    assert state.may_move is (name == "cutting")
