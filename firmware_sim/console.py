"""The person at the controller: what can be done there, and the lines that are read there. Pure."""

from dataclasses import replace
from enum import StrEnum

from cutgate.firmware_sim.faults import narrower
from cutgate.firmware_sim.mechanical import LeastDistances, distances_text
from cutgate.firmware_sim.state import BoneMoved, Controller, Event, Identity, InputsChanged, LimitsChanged
from cutgate.protocol.states import Refusal, StopCause


class ConsoleCommand(StrEnum):
    """What the person at the simulated controller can do: one operator command a line."""

    HOLD = "hold"
    RELEASE = "release"
    ESTOP = "estop"
    BONE_MOTION = "bone-motion"
    LIMIT = "limit"


def event_of(command: ConsoleCommand, controller: Controller) -> tuple[str, Event]:
    """What an operator command does: the line that confirms it, and what the table hears."""
    inputs = controller.inputs
    match command:
        case ConsoleCommand.HOLD:
            return "enabling device pressed", InputsChanged(replace(inputs, device_pressed=True))
        case ConsoleCommand.RELEASE:
            return "enabling device released", InputsChanged(replace(inputs, device_pressed=False))
        case ConsoleCommand.ESTOP:
            clear = not inputs.emergency_stop_clear
            line = "emergency stop released" if clear else "emergency stop pressed"
            return line, InputsChanged(replace(inputs, emergency_stop_clear=clear))
        case ConsoleCommand.BONE_MOTION:
            return "bone motion reported", BoneMoved()
    assert command is ConsoleCommand.LIMIT  # noqa: S101 - the only one left
    return "a joint limit was changed", LimitsChanged(narrower(controller.holdings.limits))


def not_known(text: str) -> str:
    """The answer to what is no operator command."""
    return f"{text!r} is no command here; say one of {', '.join(ConsoleCommand)}"


def state_line(controller: Controller) -> str:
    """The state, and the cause that stands."""
    cause = "" if controller.cause is StopCause.NONE else f" ({controller.cause.name})"
    return f"state {controller.state.name}{cause}"


def executed_line(segments: int, speed_ratio: float) -> str:
    """What the arm has done, once it stands at the start joints again."""
    return f"{segments} segments executed, peak joint speed {speed_ratio:.0%} of its limit"


def distance_lines(distances: LeastDistances) -> list[str]:
    """How near the true arm came to its limits while it cut, and how far it was from where its joints have it."""
    lines = [f"least distances of the true arm in the cut: {distances_text(distances.least)}"]
    if distances.off_mm > 0.0:
        lines.append(
            f"the true wrist centre was up to {distances.off_mm:.3f} mm from where the reported calibration has it"
        )
    return lines


def refusal_line(refusal: Refusal, identity: Identity) -> str:
    """A refusal, and what the person at the controller can do about it, as the runtime's people cannot.

    Args:
        refusal: why.
        identity: the controller's own.
    """
    return f"refused: {refusal.name}{_remedy(refusal, identity)}"


def _remedy(refusal: Refusal, identity: Identity) -> str:
    match refusal:
        case Refusal.PROTOCOL_VERSION:
            own = identity.protocol_version
            return f": this controller speaks version {own} of the protocol; update it and the runtime to one release"
        case Refusal.MAC_INVALID:
            own_key = identity.key_fingerprint
            return f": the runtime has another key file; this one's fingerprint is {own_key}, compare it with the runtime's"
        case Refusal.EMERGENCY_STOP:
            return ": the emergency stop is pressed; say estop to release it"
        case Refusal.DEVICE_NOT_RELEASED_AND_PRESSED:
            return ": say release, then hold"
        case _:
            return ""
