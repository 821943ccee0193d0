"""How long a frame keeps the bus busy: every bit of it, stuff bits and intermission included (ISO 11898-1)."""

from dataclasses import dataclass

CLASSIC_BIT_S, DATA_BIT_S = 1e-6, 0.2e-6
"""1 Mbit/s; 5 Mbit/s in the data phase of an FD frame."""
WORST_BITS = 135
"""A classic frame of 8 bytes with a stuff bit after every four bits."""
CRC15, CRC15_BITS = 0x4599, 15
AFTER_CRC = 13
"""CRC delimiter, acknowledge slot and delimiter, end of frame 7, intermission 3: never stuffed."""
FD_CODES = (12, 16, 20, 24, 32, 48, 64)
FULL_S = (111 * CLASSIC_BIT_S, 29 * CLASSIC_BIT_S + 550 * DATA_BIT_S)
"""A classic frame of 8 bytes and an FD frame of 64 without a single stuff bit but the fixed ones."""


@dataclass(frozen=True)
class Sent:
    """A frame that was on the bus."""

    can_id: int
    data: bytes
    is_fd: bool = False

    @property
    def bits(self) -> int:
        """How many bits it has, at whatever rate."""
        return sum(_fd_bits(self.can_id, self.data)) if self.is_fd else _classic_bits(self.can_id, self.data)

    @property
    def seconds(self) -> float:
        """How long it keeps a bus of 1 Mbit/s busy; 5 Mbit/s from bit rate switch to CRC delimiter if it is FD."""
        if not self.is_fd:
            return _classic_bits(self.can_id, self.data) * CLASSIC_BIT_S
        nominal, fast = _fd_bits(self.can_id, self.data)
        return nominal * CLASSIC_BIT_S + fast * DATA_BIT_S


def _bits_of(value: int, count: int) -> list[int]:
    """Most significant bit first."""
    return [value >> place & 1 for place in reversed(range(count))]


def _stuffed(bits: list[int]) -> list[bool]:
    """After which bits a stuff bit follows: five equal ones, stuff bits counted."""
    follows, run, last = [], 0, None
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        follows.append(run == 5)
        if run == 5:
            last, run = 1 - bit, 1
    return follows


def _classic_bits(can_id: int, data: bytes) -> int:
    head = [0, *_bits_of(can_id, 11), 0, 0, 0, *_bits_of(len(data), 4)]
    covered = head + [bit for byte in data for bit in _bits_of(byte, 8)]
    crc = 0
    for bit in covered:
        crc = (crc << 1 & 0x7FFF) ^ (CRC15 if bit ^ crc >> 14 else 0)
    whole = covered + _bits_of(crc, CRC15_BITS)
    return len(whole) + sum(_stuffed(whole)) + AFTER_CRC


def _fd_bits(can_id: int, data: bytes) -> tuple[int, int]:
    """Bits at the nominal rate and in the data phase.

    Stuff bits are counted to the end of the data. Stuff count and CRC have fixed ones: before their first bit, where
    it takes the place of one that the data would need, and after every four.
    """
    nominal = [0, *_bits_of(can_id, 11), 0, 0, 1, 0, 1]  # RRS, IDE, FDF, res, BRS
    code = len(data) if len(data) <= 8 else 9 + FD_CODES.index(len(data))
    fast = [0, *_bits_of(code, 4), *(bit for byte in data for bit in _bits_of(byte, 8))]  # ESI, DLC, data
    follows = _stuffed(nominal + fast)[:-1]
    check = 4 + (17 if len(data) <= 16 else 21)
    fixed = -(-check // 4)
    slow_bits = len(nominal) + sum(follows[: len(nominal)]) + AFTER_CRC - 1
    return slow_bits, len(fast) + sum(follows[len(nominal) :]) + check + fixed + 1
