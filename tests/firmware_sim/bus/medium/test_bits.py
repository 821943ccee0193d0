"""How many bits a frame has: every bit of it, written down one after the other by an oracle, counted."""

import random
from dataclasses import FrozenInstanceError

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.firmware_sim.bus.frame import BusFrame, Flag
from cutgate.firmware_sim.bus.medium import bits as module
from cutgate.firmware_sim.bus.medium.bits import Bits, Rates, frame_bits
from tests.firmware_sim.bus.medium.frames import (
    EXTENDED,
    FD,
    REMOTE,
    SWITCH,
    classic,
    flexible,
    of,
    of_runs,
)
from tests.oracle.can_wire import encoded

END = 9
"""Acknowledge slot and delimiter, end of frame."""


@given(classic() | flexible())
def test_every_bit_is_counted(frame):
    wire = encoded(frame)
    assert frame_bits(frame) == (len(wire.bits) + END - len(wire.fast), len(wire.fast))


@pytest.mark.parametrize("seed", range(10))
def test_so_is_every_stuff_bit_of_long_runs(seed):
    draw = random.Random(seed)
    for frame in (of_runs(draw) for _ in range(150)):
        wire = encoded(frame)
        assert frame_bits(frame) == (len(wire.bits) + END - len(wire.fast), len(wire.fast)), frame


@pytest.mark.parametrize(
    ("field", "bits"),
    [
        ("INTERMISSION_BITS", 3),
        ("ERROR_FLAG_BITS", 6 + 6),
        ("ERROR_DELIMITER_BITS", 8),
        ("SUSPEND_BITS", 8),
        ("RECOVERY_BITS", 1408),
    ],
)
def test_between_frames_are_as_many_bits_as_the_standard_says(field, bits):
    assert getattr(module, field) == bits


@given(st.binary(max_size=8))
def test_a_classic_frame_is_between_the_bounds_of_the_standard(data):
    bits = frame_bits(of(0x123, data)).nominal
    assert 44 + 8 * len(data) <= bits <= 44 + 8 * len(data) + (34 + 8 * len(data) - 1) // 4


@pytest.mark.parametrize(
    ("frame", "bits"),
    [
        # 44 fixed bits, and stuff bits: counted on paper, of the start bit and an identifier of zeros
        (of(0x555), 47 - 3),
        (of(0x555, b"\x55" * 8), 108),
        (BusFrame(0x555, REMOTE, 8), 44),
        (BusFrame(0x15555555, EXTENDED, 0), 64),
    ],
)
def test_frames_with_next_to_no_stuff_bits(frame, bits):
    assert bits <= frame_bits(frame).nominal <= bits + 3


def test_an_error_frame_is_flag_and_delimiter():
    assert frame_bits(BusFrame(0x4, int(Flag.ERROR), 8, bytes(8))) == Bits(20)


def test_time_goes_by_both_rates():
    bits = Bits(30, 500)
    assert bits.ns(Rates(1_000_000, 5_000_000)) == 30_000 + 100_000
    assert bits.ns(Rates(500_000)) == 2 * 530_000
    assert Rates(1).nominal_ns(3) == 3 * 10**9
    with pytest.raises(FrozenInstanceError):
        Rates(1).nominal_bit_s = 2
    assert frame_bits(of(1, bytes(64), FD | SWITCH)).data > frame_bits(of(1, bytes(64), FD)).data == 0
