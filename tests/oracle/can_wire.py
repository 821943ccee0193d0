"""A CAN wire bit by bit: each node drives its own bits, the wire is dominant where anybody is, and who hears another bit
than it sent falls silent. It shares nothing with the model: no table, no counting, no comparison of identifiers."""

from dataclasses import dataclass

from cutgate.firmware_sim.bus.frame import BusFrame, Flag

POLYNOMIAL_15 = 0b1100010110011001
FD_CODES = (12, 16, 20, 24, 32, 48, 64)


def number(value: int, count: int) -> list[int]:
    """Most significant bit first."""
    return [value >> place & 1 for place in reversed(range(count))]


def arbitration_field(frame: BusFrame) -> list[int]:
    """From the start of the frame to what follows the identifier: RTR, IDE and, of FD frames, FDF, res, BRS."""
    remote, fd = int(bool(frame.flags & Flag.REMOTE)), bool(frame.flags & Flag.FD)
    switch = int(bool(frame.flags & Flag.BIT_RATE_SWITCH))
    tail = [1, 0, switch] if fd else [0]
    if frame.flags & Flag.EXTENDED:
        first = [0, *number(frame.number >> 18, 11), 1, 1, *number(frame.number & 0x3FFFF, 18), remote]
        return first + (tail if fd else [0, 0])
    return [0, *number(frame.number, 11), remote, 0, *tail]


def remainder_15(bits: list[int]) -> list[int]:
    """The rest of a division by the polynomial, as on paper."""
    rest = bits + [0] * 15
    divisor = number(POLYNOMIAL_15, 16)
    for at in range(len(bits)):
        if rest[at]:
            rest[at : at + 16] = [a ^ b for a, b in zip(rest[at : at + 16], divisor, strict=True)]
    return rest[-15:]


def stuffed(bits: list[int]) -> list[int]:
    """With a complementary bit after five equal ones, stuff bits counted."""
    out: list[int] = []
    for bit in bits:
        out.append(bit)
        if len(out) >= 5 and len(set(out[-5:])) == 1:
            out.append(1 - bit)
    return out


@dataclass(frozen=True)
class Encoded:
    """A frame's bits as they stand on the wire, without those of acknowledge and end: and where the data phase is."""

    bits: list[int]
    fast: range = range(0)


def encoded(frame: BusFrame) -> Encoded:
    """Every bit from start of frame to CRC delimiter."""
    data = [bit for byte in frame.data for bit in number(byte, 8)]
    head = arbitration_field(frame)
    if not frame.flags & Flag.FD:
        covered = [*head, *number(frame.length, 4), *data]
        return Encoded([*stuffed(covered + remainder_15(covered)), 1])
    code = frame.length if frame.length <= 8 else 9 + FD_CODES.index(frame.length)
    state = int(bool(frame.flags & Flag.ERROR_STATE))
    body = stuffed([*head, state, *number(code, 4), *data])
    plain = [*head, state, *number(code, 4), *data]
    if len(body) > 5 and len(set(body[-6:-1])) == 1 and body[-1] != plain[-1]:
        body.pop()  # the fixed stuff bit stands there
    check = [0] * (
        4 + (17 if frame.length <= 16 else 21)
    )  # their values move no bit: the stuff bits are fixed
    fixed = [bit for at in range(0, len(check), 4) for bit in (1, *check[at : at + 4])]
    bits = [*body, *fixed, 1]
    if not frame.flags & Flag.BIT_RATE_SWITCH:
        return Encoded(bits)
    return Encoded(bits, range(len(stuffed(head)), len(bits)))


def winners(frames: list[BusFrame]) -> list[int]:
    """Of nodes that begin at once, those that are still sending when the identifier and what decides is over."""
    sending = {index: stuffed(arbitration_field(frame)) for index, frame in enumerate(frames)}
    alive = set(sending)
    for at in range(max(map(len, sending.values()))):
        bits = {index: sending[index][at] for index in alive if at < len(sending[index])}
        if not bits:
            break
        wire = min(bits.values())  # dominant is 0
        alive -= {index for index, bit in bits.items() if bit != wire}
    return sorted(alive)
