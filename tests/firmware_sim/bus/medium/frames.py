"""Frames for tests."""

import random

from hypothesis import strategies as st

from cutgate.firmware_sim.bus.frame import FD_LENGTHS, BusFrame, Flag

FD, SWITCH, STATE, EXTENDED, REMOTE = (
    int(flag) for flag in (Flag.FD, Flag.BIT_RATE_SWITCH, Flag.ERROR_STATE, Flag.EXTENDED, Flag.REMOTE)
)
RUNS = st.sampled_from([0x00, 0xFF, 0xF8, 0x1F, 0x3E, 0xC1])


def of(number: int, data: bytes = b"", flags: int = 0) -> BusFrame:
    return BusFrame(number, flags, len(data), data)


def in_runs(draw: random.Random, bits: int) -> int:
    """A number of so many bits in runs of equal ones, as need stuff bits."""
    value, bit, count = 0, draw.getrandbits(1), 0
    while count < bits:
        run = draw.randint(1, 7)
        value, bit, count = value << run | bit * ((1 << run) - 1), 1 - bit, count + run
    return value >> count - bits


def of_runs(draw: random.Random) -> BusFrame:
    """Any frame, of identifier and data with many stuff bits."""
    extended = draw.choice([0, EXTENDED])
    number = in_runs(draw, 29 if extended else 11)
    kind = draw.choice([0, REMOTE, FD, FD | SWITCH, FD | SWITCH | STATE])
    length = draw.choice(FD_LENGTHS if kind & FD else FD_LENGTHS[:9])
    data = b"" if kind & REMOTE else in_runs(draw, 8 * length).to_bytes(length, "big")
    return BusFrame(number, kind | extended, length, data)


@st.composite
def classic(draw: st.DrawFn) -> BusFrame:
    flags = draw(st.sampled_from([0, 0, EXTENDED, REMOTE, EXTENDED | REMOTE]))
    number = draw(st.sampled_from([0, 0x7F8]) | st.integers(0, 0x1FFFFFFF if flags & EXTENDED else 0x7FF))
    if flags & REMOTE:
        return BusFrame(number, flags, draw(st.integers(0, 8)))
    data = bytes(draw(st.lists(RUNS | st.integers(0, 255), max_size=8)))
    return BusFrame(number, flags, len(data), data)


@st.composite
def flexible(draw: st.DrawFn) -> BusFrame:
    flags = (
        FD | draw(st.sampled_from([0, SWITCH, SWITCH | STATE, STATE])) | draw(st.sampled_from([0, EXTENDED]))
    )
    number = draw(st.sampled_from([0, 0x7F8]) | st.integers(0, 0x1FFFFFFF if flags & EXTENDED else 0x7FF))
    length = draw(st.sampled_from(FD_LENGTHS))
    data = bytes(draw(st.lists(RUNS | st.integers(0, 255), min_size=length, max_size=length)))
    return BusFrame(number, flags, length, data)
