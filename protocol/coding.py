"""The poses of one block as they are sent: differences of each component, in as few bits as their sizes need.

A component (x, y, z, u, v) of n poses is `order - 1` (3 bits), a parameter (6 bits), its first value (32 bits), then the
other n - 1 as differences of that order, the i-th of order min(i, order), because no more lie before it. Everything is
computed modulo 2**32: every value has one difference and every difference one value, so there is no overflow and nothing
to check, and firmware needs unsigned words of 32 bits and nothing else. A difference d, signed, becomes 2 d or -2 d - 1;
the number's bit length is b.

- parameter 0 to 32: all numbers in so many bits;
- parameter 33 + k: first for each number max(b - k, 0) zeros and a one, then for each its bits: k of them where
  b <= k, else b - 1, the leading one being known.

Order and parameter are those of the fewest bits, the lowest order and then the lowest parameter among equals. So the
same poses always have the same bytes, and :func:`decode` refuses all others. Bits are packed from the least
significant one on, filled with zeros to whole bytes.

How many poses there are is not said: both sides know it from the block's place. A block needs at most 32 bits a value
and 9 a component, so that no poses whatever, only their number, can make it longer than a transfer carries.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cutgate.protocol.arrays import Ints
from cutgate.protocol.wire import RecordError

COMPONENTS: Final = 5
ORDERS: Final = 8
VALUE_BITS: Final = 32
ORDER_BITS: Final = 3
PARAMETER_BITS: Final = 6
HEAD_BITS: Final = ORDER_BITS + PARAMETER_BITS + VALUE_BITS
PREFIXED: Final = VALUE_BITS + 1
"""The least parameter of numbers of differing length."""
KNOWN_BITS: Final = 31

"""So many k have a parameter, from 0 on; with more no number would be shorter than in 32 fixed bits."""

Values = NDArray[np.uint32]
Choice = tuple[int, int]
"""`order - 1` and parameter of a component."""

_ONE: Final = np.uint64(1)
_ONE_32: Final = np.uint32(1)
_LENGTHS: Final = np.arange(VALUE_BITS + 1)[:, np.newaxis]
_KNOWN: Final = np.arange(KNOWN_BITS)
_COST: Final = np.where(_LENGTHS <= _KNOWN, _KNOWN + 1, 2 * _LENGTHS - _KNOWN)
"""Bits of a number of each bit length under each k: prefix and the rest."""
_BINS: Final = (VALUE_BITS + 1) * np.arange(ORDERS * COMPONENTS).reshape(ORDERS, COMPONENTS, 1)


def coded_bytes_max(poses: int) -> int:
    """No so many poses need more bytes."""
    return -(-COMPONENTS * (HEAD_BITS + VALUE_BITS * (poses - 1)) // 8)


def fewest(poses: NDArray[np.int32]) -> list[Choice]:
    """`order - 1` and parameter of each component with which these poses, (n, 5), take the fewest bits."""
    return _fewest(_bit_lengths(_numbers(_components(poses))))


def encode(poses: NDArray[np.int32]) -> bytes:
    """The bytes of one or more poses, (n, 5)."""
    return written(poses, None)


def written(poses: NDArray[np.int32], choice: list[Choice] | None) -> bytes:
    """Poses, (n, 5), with orders and parameters as told; only those of the fewest bits, None, are ever accepted."""
    values = _components(poses)
    numbers = _numbers(values)
    lengths = _bit_lengths(numbers)
    fields, widths = [], []
    for component, (order, parameter) in enumerate(choice or _fewest(lengths)):
        number, length = numbers[order, component].astype(np.uint64), lengths[order, component]
        head = order | parameter << ORDER_BITS | int(values[component, 0]) << ORDER_BITS + PARAMETER_BITS
        fields.append(np.array([head], dtype=np.uint64))
        widths.append(np.array([HEAD_BITS]))
        if parameter < PREFIXED:
            width = np.full(len(number), parameter)
        else:
            known = parameter - PREFIXED
            zeros = np.maximum(length.astype(np.int64) - known, 0)
            fields.append(_ONE << zeros.astype(np.uint64))
            widths.append(zeros + 1)
            width = known + np.maximum(zeros - 1, 0)
        fields.append(number & (_ONE << width.astype(np.uint64)) - _ONE)
        widths.append(width)
    return _packed(np.concatenate(fields), np.concatenate(widths))


def decode(data: bytes, count: int) -> NDArray[np.int32]:
    """The poses of a block, shape (count, 5).

    Work and memory are bounded by `count` and by the length of `data`, whatever stands in it.

    Args:
        data: the bytes.
        count: how many poses the block holds, 1 or more, as its place in the path says.

    Raises:
        RecordError: the bytes are not those of so many poses; the only exception for any bytes whatever.
    """
    padded = data + bytes(8)
    bits = np.unpackbits(np.frombuffer(padded, dtype=np.uint8), count=8 * len(data), bitorder="little")
    from_each_byte = np.ndarray((len(data) + 1,), dtype="<u8", buffer=padded, strides=(1,))
    zeros = np.zeros((COMPONENTS, count - 1), dtype=np.int64)
    starts, widths = zeros.copy(), zeros.copy()
    choice: list[Choice] = []
    values = np.empty((COMPONENTS, count), dtype=np.uint32)
    at = 0
    for component in range(COMPONENTS):
        head = int(from_each_byte[min(at >> 3, len(data))]) >> (at & 7)
        values[component, 0] = (head >> ORDER_BITS + PARAMETER_BITS) % (1 << VALUE_BITS)
        choice.append((head % ORDERS, (head >> ORDER_BITS) % (1 << PARAMETER_BITS)))
        at += HEAD_BITS
        known = choice[-1][1]
        if known >= PREFIXED:
            known -= PREFIXED
            zeros[component] = _zeros(bits[at:], count - 1, VALUE_BITS - known)
            at += int(np.sum(zeros[component])) + count - 1
        widths[component] = known + np.maximum(zeros[component] - 1, 0)
        ends = at + np.cumsum(widths[component])
        starts[component] = ends - widths[component]
        at += int(np.sum(widths[component]))
        if at > len(bits):
            raise RecordError(f"coded poses end inside component {component}")
    if len(data) != -(-at // 8) or np.any(bits[at:]):
        raise RecordError(f"coded poses of {at} bits are followed by others")
    width = widths.astype(np.uint64)
    rest = from_each_byte[starts >> 3] >> (starts & 7).astype(np.uint64) & (_ONE << width) - _ONE
    numbers = np.where(zeros > 0, rest | _ONE << width, rest).astype(np.uint32)
    values[:, 1:] = numbers >> _ONE_32 ^ -(numbers & _ONE_32)
    for component, (order, _) in enumerate(choice):
        for begin in reversed(range(order + 1)):  # of each order, by adding up those of the next
            differences = values[component, begin:]
            np.add.accumulate(differences, out=differences)
    if choice != _fewest(_bit_lengths(_numbers(values))):
        raise RecordError("coded poses have another order or parameter than those of the fewest bits")
    return np.ascontiguousarray(values.T).view(np.int32)


def _components(poses: NDArray[np.int32]) -> Values:
    """Each component's values modulo 2**32, (5, n)."""
    return np.ascontiguousarray(poses.T).view(np.uint32)


def _numbers(values: Values) -> Values:
    """The numbers of all differences, of each order, (8, 5, n - 1)."""
    found = np.empty((ORDERS, COMPONENTS, values.shape[1] - 1), dtype=np.uint32)
    found[0] = np.diff(values)
    for order in range(1, ORDERS):
        found[order, :, :order] = found[order - 1, :, :order]
        found[order, :, order:] = np.diff(found[order - 1, :, order - 1 :])
    return found << _ONE_32 ^ -(found >> np.uint32(31))


def _bit_lengths(numbers: Values) -> NDArray[np.uint8]:
    filled = numbers
    for shift in (1, 2, 4, 8, 16):
        filled = filled | filled >> np.uint32(shift)
    return np.bitwise_count(filled)


def _fewest(lengths: NDArray[np.uint8]) -> list[Choice]:
    """Of the fewest bits; among equals of the lowest order, then the lowest parameter."""
    bins = np.bincount((lengths + _BINS).ravel(), minlength=ORDERS * COMPONENTS * (VALUE_BITS + 1))
    longest = np.max(lengths, axis=2, initial=0).astype(np.int64)
    fixed = lengths.shape[2] * longest[:, :, np.newaxis]
    cost = np.concatenate((fixed, bins.reshape(ORDERS, COMPONENTS, VALUE_BITS + 1) @ _COST), axis=2)
    options = 1 + KNOWN_BITS
    best = np.argmin(
        cost.transpose(1, 0, 2).reshape(COMPONENTS, ORDERS * options), axis=1
    )  # the first of them
    found = []
    for component, (order, option) in enumerate(divmod(place, options) for place in best.tolist()):
        found.append((order, PREFIXED + option - 1 if option else int(longest[order, component])))
    return found


def _zeros(bits: NDArray[np.uint8], count: int, most: int) -> Ints:
    """How many zeros stand before the one of each of so many prefixes."""
    ones = np.flatnonzero(bits.view(np.bool_))[:count]
    if len(ones) < count:
        raise RecordError(f"coded poses have {len(ones)} prefixes, must have {count}")
    zeros = np.diff(ones, prepend=-1) - 1
    if np.any(zeros > most):
        raise RecordError(f"coded poses have a prefix of more than {most} zeros")
    return zeros


def _packed(fields: NDArray[np.uint64], widths: Ints) -> bytes:
    """These bits one after the other, the least significant one first."""
    ends = np.cumsum(widths)
    place, shift = np.divmod(ends - widths, 64)
    shift = shift.astype(np.uint64)
    words = np.zeros(int(place[-1]) + 2, dtype="<u8")
    np.add.at(words, place, fields << shift)  # no two share a bit
    np.add.at(words, place + 1, fields >> _ONE >> (np.uint64(63) - shift))
    return words.tobytes()[: -(-int(ends[-1]) // 8)]
