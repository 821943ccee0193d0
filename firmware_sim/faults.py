"""Faults the simulated controller can be told to have, each at a stated moment.

``NAME@STATE`` happens once, when the controller first reaches that state, e.g. ``flip-path-bit@permitted``.
"""

from dataclasses import dataclass
from enum import StrEnum

from cutgate.protocol.states import ControllerState


class FaultName(StrEnum):
    """What can go wrong on demand."""

    FLIP_PATH_BIT = "flip-path-bit"
    """One stored bit of the path changes."""
    OFF_START = "off-start"
    """The arm stands 2 deg in q0 off the first pose."""
    HANG = "hang"
    """The control loop stands still for one second."""
    SILENT = "silent"
    """No frame leaves any more."""
    CHANGE_LIMIT = "change-limit"
    """A joint limit changes without a word."""
    REBOOT = "reboot"
    """Power is lost and comes back: a new boot nonce, nothing loaded; its memory is kept."""
    DRIFT = "drift"
    """q0 creeps away from where the controller believes it to be, 1 deg/s; its own checks see nothing."""
    FREEZE = "freeze"
    """The reported joints stand still while the arm goes on."""
    RUSH = "rush"
    """The plant runs three times as fast as it says, within its joint speed limits."""


@dataclass(frozen=True)
class FaultSpec:
    """A fault and the state in which it happens."""

    name: FaultName
    state: ControllerState

    @classmethod
    def parse(cls, text: str) -> "FaultSpec":
        """``NAME@STATE``; raises ValueError naming what is allowed."""
        name, at, state = text.partition("@")
        states = {member.name.lower(): member for member in ControllerState}
        try:
            fault = FaultName(name)
        except ValueError:
            allowed = ", ".join(FaultName)
            raise ValueError(f"fault {name!r} is not known; use one of {allowed}, as NAME@STATE") from None
        if not at:
            state = "loaded"
        if state not in states:
            raise ValueError(f"fault {text!r}: state must be one of {', '.join(states)}")
        return cls(fault, states[state])
