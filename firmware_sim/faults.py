"""Faults the simulated controller can be told to have, each at a stated moment.

``NAME@STATE`` happens once, when the controller first reaches that state, e.g. ``flip-path-bit@permitted``. What goes
wrong with the arm and with what the controller holds is done here; ``hang``, ``silent`` and ``reboot`` are the loop's.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum

from cutgate.firmware_sim.arm import PlantArm
from cutgate.firmware_sim.plant import StoredPath
from cutgate.firmware_sim.state import Controller
from cutgate.protocol import records
from cutgate.protocol.path import PathHeader
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
    """A joint limit changes unnoticed."""
    REBOOT = "reboot"
    """Power is lost and comes back: a new announce nonce, nothing loaded; its memory is kept."""
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

    def __str__(self) -> str:
        """``NAME@STATE``, as it is parsed."""
        return f"{self.name}@{self.state.name.lower()}"

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


class Faults:
    """The faults that are still to come.

    Args:
        specs: each with the state in which it happens.
    """

    def __init__(self, specs: Iterable[FaultSpec]) -> None:
        self._to_come = list(specs)

    def due(self, state: ControllerState) -> list[FaultName]:
        """Those that happen now, in the order in which they were given; each only once."""
        due = [spec.name for spec in self._to_come if spec.state is state]
        self._to_come = [spec for spec in self._to_come if spec.state is not state]
        return due


def happen(name: FaultName, controller: Controller, arm: PlantArm, now_s: float) -> Controller:
    """Let one of them happen to the arm, or to what the controller holds; it does not notice.

    Args:
        name: which one; of the loop's own ones nothing is seen here.
        controller: whose holdings may change.
        arm: what may go wrong otherwise; altered in place.
        now_s: when.

    Returns:
        The controller, with what it holds now.
    """
    holdings = controller.holdings
    match name:
        case FaultName.FLIP_PATH_BIT if holdings.path is not None:
            arm.path = flipped(holdings.path)
            return replace(controller, holdings=replace(holdings, path=last_bit_flipped(holdings.path)))
        case FaultName.CHANGE_LIMIT:
            return replace(controller, holdings=replace(holdings, limits=narrower(holdings.limits)))
        case FaultName.OFF_START:
            arm.push_aside()
        case FaultName.DRIFT:
            arm.drift(now_s)
        case FaultName.FREEZE:
            arm.freeze()
        case FaultName.RUSH:
            arm.rush()
        case _:
            pass
    return controller


def narrower(limits: bytes) -> bytes:
    """The limits with the upper one of q0 one degree lower."""
    before = records.Limits.parse(limits)
    upper = (before.q_max_u[0] - records.UNIT, *before.q_max_u[1:])
    return replace(before, q_max_u=upper).body()


def last_bit_flipped(path: bytes) -> bytes:
    """The path with another lowest bit of its last byte."""
    return path[:-1] + bytes([path[-1] ^ 1])


def flipped(path: bytes) -> StoredPath:
    """The path with that bit flipped where it lies in memory; the CRCs stay as received."""
    received = [block.block_crc32 for block in records.split(path)]
    altered = last_bit_flipped(path)
    blocks = [altered[at : at + records.BLOCK_BYTES] for at in range(0, len(path), records.BLOCK_BYTES)]
    return StoredPath(PathHeader.of(path), blocks, received)
