"""What the controller says of itself: the announcement outside a session, heartbeat and progress in one. Pure."""

from typing import Final

from cutgate.firmware_sim.plant import PlantState
from cutgate.firmware_sim.state import Controller
from cutgate.protocol import records
from cutgate.protocol.frames import FRACTION_MAX, ControllerHeartbeat, Progress
from cutgate.protocol.states import ControllerState

FIRMWARE_VERSION: Final = "sim-0.1"


def announcement(controller: Controller) -> records.Announce:
    """Who it is, what an OPEN must name, and how it stands."""
    return records.Announce(
        protocol_version=controller.identity.protocol_version,
        firmware_version=FIRMWARE_VERSION,
        serial=controller.identity.serial,
        announce_nonce=controller.announce_nonce,
        plant_speed_permille=controller.identity.plant_speed_permille,
        state=controller.state,
        cause=controller.cause,
    )


def heartbeat(controller: Controller) -> ControllerHeartbeat:
    """State, cause and wired inputs."""
    return ControllerHeartbeat(
        state=controller.state,
        epoch=controller.epoch,
        cause=controller.cause,
        device_pressed=controller.inputs.device_pressed,
        emergency_stop_ok=controller.inputs.emergency_stop_clear,
        cutting_mode=controller.cutting_mode,
    )


def progress(controller: Controller, arm: PlantState) -> Progress | None:
    """How far the cut is; None where nothing is executed."""
    if controller.state not in (ControllerState.CUTTING, ControllerState.DONE):
        return None
    segment, fraction = arm.progress
    return Progress(segment, round(fraction * FRACTION_MAX))
