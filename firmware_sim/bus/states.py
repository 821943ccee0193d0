"""What a node hears of its own interface: error frames, as Linux numbers them (linux/can/error.h)."""

from typing import Final

from cutgate.firmware_sim.bus.frame import BusFrame, Flag
from cutgate.firmware_sim.bus.medium.confinement import Counters, NodeState

CONTROLLER: Final = 0x004
"""CAN_ERR_CRTL: the interface's own trouble; its second byte says which."""
BUS_OFF: Final = 0x040
RESTARTED: Final = 0x100
COUNTERS: Final = 0x200
"""CAN_ERR_CNT: bytes 6 and 7 are the error counters."""
RECEIVE_OVERFLOW: Final = 0x01
TRANSMIT_OVERFLOW: Final = 0x02
_DETAIL: Final = {
    NodeState.ERROR_ACTIVE: (0x40, 0x40),
    NodeState.ERROR_WARNING: (0x08, 0x04),
    NodeState.ERROR_PASSIVE: (0x20, 0x10),
}
"""Second byte where the transmit counter is the higher one, and where the receive counter is; both where they are equal."""


def state_frame(before: NodeState, state: NodeState, counters: Counters) -> BusFrame:
    """The error frame by which an interface tells its programs that it may do more or less than before."""
    if state is NodeState.BUS_OFF:
        return _error(BUS_OFF, 0, counters)
    if before is NodeState.BUS_OFF:
        return _error(RESTARTED, 0, counters)
    sending, receiving = _DETAIL[state]
    detail = (sending if counters.transmit >= counters.receive else 0) | (
        receiving if counters.receive >= counters.transmit else 0
    )
    return _error(CONTROLLER, detail, counters)


def overflow_frame(detail: int, frames: int) -> BusFrame:
    """Frames were lost for want of room; bytes 4 to 7 say how many, big-endian."""
    return BusFrame(CONTROLLER, int(Flag.ERROR), 8, bytes((0, detail, 0, 0)) + frames.to_bytes(4, "big"))


def _error(number: int, detail: int, counters: Counters) -> BusFrame:
    counts = bytes((min(counters.transmit, 255), counters.receive))
    return BusFrame(number | COUNTERS, int(Flag.ERROR), 8, bytes((0, detail, 0, 0, 0, 0)) + counts)
