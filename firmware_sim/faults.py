"""Faults the simulated controller can be told to have, each at a stated moment.

``NAME@STATE`` happens once, when the controller first reaches that state, e.g. ``flip-path-bit@permitted``. What goes
wrong with the arm and with what the controller holds is done here, as what another node says; the rest is the loop's.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum

from cutgate.firmware_sim.arm import PlantArm
from cutgate.firmware_sim.plant import StoredPath
from cutgate.firmware_sim.reports import heartbeat
from cutgate.firmware_sim.state import Controller
from cutgate.protocol import records
from cutgate.protocol.e2e import COUNTER_MODULUS
from cutgate.protocol.frames import ControllerHeartbeat, RuntimeHeartbeat, encode_frame
from cutgate.protocol.link import Link
from cutgate.protocol.path import PathHeader
from cutgate.protocol.states import ControllerState, RuntimeCode


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
    BONE_MOTION = "bone-motion"
    """The bone moves by 1 mm, and its sensor tells."""
    POWER_LOSS = "power-loss"
    """Power is lost for a second: the brakes stop the arm, nothing is sent, then everything but its memory is new."""
    TORN_WRITE = "torn-write"
    """Power is lost in the middle of the next writing of its memory, which is what it was."""
    UNANSWERED_WRITE = "unanswered-write"
    """Power is lost after the next writing of its memory, before anything is answered."""
    FLIP_LIMIT_BIT = "flip-limit-bit"
    """One stored bit of a joint limit changes."""
    FLIP_MEMORY_BIT = "flip-memory-bit"
    """One bit of its memory's file changes, which it finds when it is powered up again."""
    SLOW = "slow"
    """Each cycle of the control loop is late from now on."""
    HUNG = "hung"
    """The control loop stands still for good."""
    SECOND_CONTROLLER = "second-controller"
    """Another node says a controller's heartbeat, without the key."""
    SECOND_RUNTIME = "second-runtime"
    """Another node says a runtime's heartbeat, without the key."""
    WEAK_DRIVE = "weak-drive"
    """The drives have a hundredth of their acceleration left."""


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
        case FaultName.FLIP_LIMIT_BIT:
            return replace(controller, holdings=replace(holdings, limits=one_bit_off(holdings.limits)))
        case FaultName.WEAK_DRIVE:
            arm.weaken()
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


def one_bit_off(limits: bytes) -> bytes:
    """The limits with another lowest bit of the upper one of q0."""
    before = records.Limits.parse(limits)
    return replace(before, q_max_u=(before.q_max_u[0] ^ 1, *before.q_max_u[1:])).body()


def masquerade(name: FaultName, controller: Controller, link: Link) -> tuple[int, bytes]:
    """Identifier and bytes of a heartbeat as another node says it that has heard the bus and has no key.

    Its counter is the next one and its checksum fits: nothing but the tag is wrong.
    """
    frame: ControllerHeartbeat | RuntimeHeartbeat
    if name is FaultName.SECOND_CONTROLLER:
        frame, counter = heartbeat(controller), link.counter + 1
    else:
        frame, counter = RuntimeHeartbeat(RuntimeCode.CUT, controller.epoch), link.echo + 1
    return encode_frame(frame, counter % COUNTER_MODULUS, link.tag)


def last_bit_flipped(path: bytes) -> bytes:
    """The path with another lowest bit of its last byte."""
    return path[:-1] + bytes([path[-1] ^ 1])


def flipped(path: bytes) -> StoredPath:
    """The path with that bit flipped where it lies in memory; the CRCs stay as received."""
    received = [block.block_crc32 for block in records.split(path)]
    altered = last_bit_flipped(path)
    blocks = [altered[at : at + records.BLOCK_BYTES] for at in range(0, len(path), records.BLOCK_BYTES)]
    return StoredPath(PathHeader.of(path), blocks, received)
