"""What the controller says of itself: all of it, and nothing of a cut that is not."""

from dataclasses import replace

import pytest

from cutgate.firmware_sim import reports
from cutgate.firmware_sim.plant import Leg, PlantState
from cutgate.firmware_sim.state import Inputs
from cutgate.protocol import records
from cutgate.protocol.frames import ControllerHeartbeat, Progress
from cutgate.protocol.states import ControllerState, StopCause
from tests.firmware_sim.controllers import ANNOUNCE_NONCE, CUTTING, DONE, EVERY_STATE, LATCHED, POWERED_UP

HALFWAY = PlantState((0.0,) * 5, Leg.CUT, segment=3, fraction=0.5)


@pytest.mark.parametrize("permille", [1000, 1, 20_000])
def test_the_announcement_says_who_it_is_and_how_it_stands(permille):
    controller = replace(LATCHED, identity=replace(LATCHED.identity, plant_speed_permille=permille))
    assert reports.announcement(controller) == records.Announce(
        protocol_version=records.PROTOCOL_VERSION,
        firmware_version="sim-0.1",
        serial="SIM-1",
        announce_nonce=ANNOUNCE_NONCE,
        plant_speed_permille=permille,
        state=ControllerState.FAULT,
        cause=StopCause.SECOND_NODE,
    )


def test_the_announcement_names_the_controllers_own_version():
    other = replace(POWERED_UP, identity=replace(POWERED_UP.identity, protocol_version=9))
    assert reports.announcement(other).protocol_version == 9


@pytest.mark.parametrize("name", EVERY_STATE)
@pytest.mark.parametrize("inputs", [Inputs(False, True), Inputs(True, False)])
def test_the_heartbeat_says_state_cause_and_inputs(name, inputs):
    controller = replace(EVERY_STATE[name], inputs=inputs)
    assert reports.heartbeat(controller) == ControllerHeartbeat(
        state=controller.state,
        epoch=controller.epoch,
        cause=controller.cause,
        device_pressed=inputs.device_pressed,
        emergency_stop_ok=inputs.emergency_stop_clear,
        cutting_mode=controller.cutting_mode,
    )


@pytest.mark.parametrize("state", ControllerState)
def test_progress_is_told_of_a_cut_and_of_its_end_alone(state):
    told = reports.progress(replace(CUTTING, state=state), HALFWAY)
    if state in (ControllerState.CUTTING, ControllerState.DONE):
        assert told == Progress(3, 32768)
    else:
        assert told is None


@pytest.mark.parametrize(
    ("arm", "told"),
    [
        (replace(HALFWAY, fraction=0.0), Progress(3, 0)),
        (replace(HALFWAY, fraction=1.0), Progress(3, 65535)),
        (replace(HALFWAY, leg=Leg.ENTRY, segment=0), Progress(0, 0)),
        (replace(HALFWAY, leg=Leg.EXIT), Progress(3, 65535)),
    ],
)
def test_progress_is_that_of_the_cut_to_the_last_step(arm, told):
    assert reports.progress(DONE, arm) == told
