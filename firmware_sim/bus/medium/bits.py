"""How many bits a frame has on the wire, every stuff bit counted, and how long they take (ISO 11898-1).

Stuff bits are counted by a table over whole bytes: what follows depends only on the last bit and on how many equal
ones stand before it.
"""

from dataclasses import dataclass
from functools import cache
from typing import Final, NamedTuple

from cutgate.firmware_sim.bus.frame import FD_LENGTHS, BusFrame, Flag

INTERMISSION_BITS: Final = 3
ERROR_FLAG_BITS: Final = 12
"""A flag of six dominant bits, and the flags of those who see only that one."""
ERROR_DELIMITER_BITS: Final = 8
SUSPEND_BITS: Final = 8
"""So long an error-passive transmitter lets the others go first."""
RECOVERY_BITS: Final = 128 * 11
"""So many recessive bits a node that was bus-off must see before it takes part again."""

_EXTENDED, _REMOTE, _ERROR, _FD = int(Flag.EXTENDED), int(Flag.REMOTE), int(Flag.ERROR), int(Flag.FD)
_SWITCH, _STATE = int(Flag.BIT_RATE_SWITCH), int(Flag.ERROR_STATE)

_CRC_POLYNOMIAL: Final = 0x4599
_CRC_BITS: Final = 15
_END_BITS: Final = 10
"""CRC delimiter, acknowledge slot and delimiter, end of frame 7: never stuffed."""
_NS: Final = 1_000_000_000


@dataclass(frozen=True)
class Rates:
    """Bit rates of the bus: the nominal one, and that of the data phase of FD frames; None: no FD frames."""

    nominal_bit_s: int
    data_bit_s: int | None = None

    def nominal_ns(self, bits: int) -> int:
        """How long so many bits take at the nominal rate."""
        return bits * _NS // self.nominal_bit_s


class Bits(NamedTuple):
    """Bits of a frame to the end of its last field, at the nominal rate and in the data phase."""

    nominal: int
    data: int = 0

    def ns(self, rates: Rates) -> int:
        """How long they take."""
        fast = self.data * _NS // (rates.data_bit_s or rates.nominal_bit_s)
        return rates.nominal_ns(self.nominal) + fast


def frame_bits(frame: BusFrame) -> Bits:
    """The bits of a frame from its start to the end of its last field; the intermission is not counted."""
    if frame.flags & _ERROR:
        return Bits(ERROR_FLAG_BITS + ERROR_DELIMITER_BITS)
    return _fd_bits(frame) if frame.flags & _FD else _classic_bits(frame)


# ---------------------------------------------------------------- stuff bits

_START: Final = (2, 0)
"""No bit yet: the first one begins a run, whichever it is."""


def _after_bit(last: int, run: int, bit: int) -> tuple[int, int, int]:
    """The bit and run that count from here on, and whether a stuff bit was inserted behind this one."""
    run = run + 1 if bit == last else 1
    return (1 - bit, 1, 1) if run == 5 else (bit, run, 0)


_STATES: Final = [_START, *((bit, run) for bit in (0, 1) for run in (1, 2, 3, 4))]
_INDEX: Final = {state: index for index, state in enumerate(_STATES)}


@cache
def _after_bits(state: int, value: int, count: int) -> tuple[int, int]:
    """Of at most eight bits: the state behind them, and how many stuff bits they needed; so few that all are kept."""
    (last, run), inserted = _STATES[state], 0
    for place in range(count - 1, -1, -1):
        last, run, stuffed = _after_bit(last, run, value >> place & 1)
        inserted += stuffed
    return _INDEX[last, run], inserted


_BY_BYTE: Final = [[_after_bits(state, byte, 8) for byte in range(256)] for state in range(len(_STATES))]


def _stuffed(state: int, value: int, count: int) -> tuple[int, int]:
    """The state behind a value of ``count`` bits, most significant first, and how many stuff bits they needed."""
    odd, whole = count % 8, count // 8
    state, inserted = _after_bits(state, value >> 8 * whole, odd)
    for byte in (value & (1 << 8 * whole) - 1).to_bytes(whole, "big"):
        state, more = _BY_BYTE[state][byte]
        inserted += more
    return state, inserted


# ---------------------------------------------------------------- classic frames


def _crc_table() -> list[int]:
    table = []
    for byte in range(256):
        crc = byte << _CRC_BITS - 8
        for _ in range(8):
            crc = crc << 1 ^ (_CRC_POLYNOMIAL if crc & 0x4000 else 0)
        table.append(crc & 0x7FFF)
    return table


_CRC_TABLE: Final = _crc_table()


def _crc15(value: int, count: int) -> int:
    """CRC over ``count`` bits; zeros before them change nothing, so they may be filled up to whole bytes."""
    crc = 0
    for byte in value.to_bytes((count + 7) // 8, "big"):
        crc = (crc << 8 & 0x7FFF) ^ _CRC_TABLE[crc >> 7 ^ byte]
    return crc


def _classic_bits(frame: BusFrame) -> Bits:
    remote = int(bool(frame.flags & _REMOTE))
    if frame.flags & _EXTENDED:  # SOF, base, SRR, IDE, extension, RTR, r1, r0, DLC
        base, extension = frame.number >> 18, frame.number & 0x3FFFF
        head = ((base << 2 | 0b11) << 18 | extension) << 7 | remote << 6 | frame.length
        count = 39
    else:  # SOF, identifier, RTR, IDE, r0, DLC
        head, count = frame.number << 7 | remote << 6 | frame.length, 19
    if not remote:
        head = head << 8 * frame.length | int.from_bytes(frame.data, "big")
        count += 8 * frame.length
    whole = head << _CRC_BITS | _crc15(head, count)
    count += _CRC_BITS
    return Bits(count + _stuffed(0, whole, count)[1] + _END_BITS)


# ---------------------------------------------------------------- FD frames


def _fd_bits(frame: BusFrame) -> Bits:
    """Stuff bits are counted to the end of the data; stuff count and CRC have fixed ones.

    A fixed one stands before their first bit, where it takes the place of one that the data would need, and after
    every four.
    """
    switch = int(bool(frame.flags & _SWITCH))
    if frame.flags & _EXTENDED:  # SOF, base, SRR, IDE, extension, RRS, FDF, res, BRS
        base, extension = frame.number >> 18, frame.number & 0x3FFFF
        head, count = ((base << 2 | 0b11) << 18 | extension) << 4 | 0b0100 | switch, 36
    else:  # SOF, identifier, RRS, IDE, FDF, res, BRS
        head, count = frame.number << 5 | 0b00100 | switch, 17
    state, slow = _stuffed(0, head, count)
    esi = int(bool(frame.flags & _STATE))
    rest = (esi << 4 | FD_LENGTHS.index(frame.length)) << 8 * frame.length | int.from_bytes(frame.data, "big")
    rest_count = 5 + 8 * frame.length
    state, fast = _stuffed(state, rest, rest_count)
    if _STATES[state][0] != rest & 1:  # one behind the last bit: the fixed one stands there
        fast -= 1
    check = 4 + (17 if frame.length <= 16 else 21)
    in_data_phase = rest_count + fast + check + -(-check // 4) + 1  # the CRC delimiter
    nominal = count + slow + _END_BITS - 1
    return Bits(nominal, in_data_phase) if switch else Bits(nominal + in_data_phase)
