"""The decoder of coded poses without numpy, a bit at a time, as firmware may do it: it shares no line with the package."""


class Bits:
    """A reader; EOFError where no bit is left."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, width: int) -> int:
        value = 0
        for place in range(width):
            if self.at >= 8 * len(self.data):
                raise EOFError
            value |= (self.data[self.at >> 3] >> (self.at & 7) & 1) << place
            self.at += 1
        return value

    def zeros(self, most: int) -> int:
        """Before a one."""
        for zeros in range(most + 1):
            if self.take(1):
                return zeros
        raise EOFError


def component(bits: Bits, count: int) -> list[int]:
    order, parameter, first = bits.take(3) + 1, bits.take(6), bits.take(32)
    if parameter <= 32:
        numbers = [bits.take(parameter) for _ in range(count - 1)]
    else:
        known = parameter - 33
        prefixes = [bits.zeros(32 - known) for _ in range(count - 1)]
        numbers = [
            bits.take(zeros + known - 1) | 1 << zeros + known - 1 if zeros else bits.take(known)
            for zeros in prefixes
        ]
    differences, values = [first] + [0] * order, [first]
    for i, number in enumerate(numbers, 1):
        top = min(i, order)
        differences[top] = (number >> 1 ^ -(number & 1)) % 2**32
        for level in range(top - 1, -1, -1):
            differences[level] = (differences[level] + differences[level + 1]) % 2**32
        values.append(differences[0])
    return [value - 2**32 if value >= 2**31 else value for value in values]
