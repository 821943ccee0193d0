"""How long a frame keeps the bus busy: every bit of it, stuff bits and intermission included (ISO 11898-1)."""

from dataclasses import dataclass

from cutgate.firmware_sim.bus.frame import BusFrame, Flag
from cutgate.firmware_sim.bus.medium.bits import INTERMISSION_BITS, Bits, Rates, frame_bits

RATES = Rates(1_000_000, 5_000_000)
CLASSIC_BIT_S, DATA_BIT_S = 1e-6, 0.2e-6
"""1 Mbit/s; 5 Mbit/s in the data phase of an FD frame."""
WORST_BITS = 135
"""A classic frame of 8 bytes with a stuff bit after every four bits."""
FULL_S = (111 * CLASSIC_BIT_S, 29 * CLASSIC_BIT_S + 550 * DATA_BIT_S)
"""A classic frame of 8 bytes and an FD frame of 64 without a single stuff bit but the fixed ones."""


@dataclass(frozen=True)
class Sent:
    """A frame that was on the bus."""

    can_id: int
    data: bytes
    is_fd: bool = False

    @property
    def _bits(self) -> Bits:
        flags = int(Flag.FD | Flag.BIT_RATE_SWITCH) if self.is_fd else 0
        nominal, data = frame_bits(BusFrame(self.can_id, flags, len(self.data), self.data))
        return Bits(nominal + INTERMISSION_BITS, data)

    @property
    def bits(self) -> int:
        """How many bits it has, at whatever rate."""
        return sum(self._bits)

    @property
    def seconds(self) -> float:
        """How long it keeps a bus of 1 Mbit/s busy; 5 Mbit/s from bit rate switch to CRC delimiter if it is FD."""
        return self._bits.ns(RATES) * 1e-9
