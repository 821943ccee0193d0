"""What a CAN frame may be: a rule of ISO 11898-1 after the other, and the numbers of the flags on the hub's sockets."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.firmware_sim.bus.frame import ALL_FLAGS, BusFrame, BusFrameError, Flag, check

EXTENDED, REMOTE, ERROR, FD, SWITCH, STATE = (
    int(flag)
    for flag in (
        *(Flag.EXTENDED, Flag.REMOTE, Flag.ERROR),
        *(Flag.FD, Flag.BIT_RATE_SWITCH, Flag.ERROR_STATE),
    )
)


def refused(number=0, flags=0, length=0):
    try:
        check(number, flags, length)
    except BusFrameError:
        return True
    return False


def test_the_flags_are_the_bits_of_a_record():
    assert {flag.name: flag.value for flag in Flag} == {
        "EXTENDED": 0b1,
        "REMOTE": 0b10,
        "ERROR": 0b100,
        "FD": 0b1000,
        "BIT_RATE_SWITCH": 0b1_0000,
        "ERROR_STATE": 0b10_0000,
        "OWN": 0b100_0000,
    }
    assert sum(Flag) == ALL_FLAGS
    assert BusFrame(5) == (5, 0, 0, b"")


@pytest.mark.parametrize(
    ("flags", "bits"),
    [(0, 11), (REMOTE, 11), (FD, 11), (EXTENDED, 29), (EXTENDED | FD, 29), (ERROR, 29)],
)
def test_an_identifier_has_11_bits_or_29(flags, bits):
    assert [refused(number, flags) for number in (-1, 0, 2**bits - 1, 2**bits)] == [True, False, False, True]


@pytest.mark.parametrize("flags", [0, REMOTE, EXTENDED, EXTENDED | REMOTE, ERROR])
def test_a_classic_frame_has_up_to_8_bytes(flags):
    assert [length for length in range(-2, 70) if not refused(0, flags, length)] == list(range(9))


@pytest.mark.parametrize("flags", [FD, FD | EXTENDED, FD | SWITCH, FD | STATE, FD | SWITCH | STATE])
def test_an_fd_frame_has_a_length_that_has_a_code(flags):
    of_codes = [*range(9), 12, 16, 20, 24, 32, 48, 64]
    assert [length for length in range(-2, 70) if not refused(0, flags, length)] == of_codes


@given(st.integers(0, 127))
def test_there_is_no_remote_frame_no_error_frame_of_fd_and_no_switch_without(flags):
    fd, others = bool(flags & FD), flags & (REMOTE | ERROR if flags & FD else SWITCH | STATE)
    assert refused(0, flags, 8) == bool(others), fd


@pytest.mark.parametrize(
    ("number", "flags", "length", "why"),
    [
        (0x800, 0, 0, "identifier 0x800, must be 0x0 to 0x7ff"),
        (-1, EXTENDED, 0, "identifier -0x1, must be 0x0 to 0x1fffffff"),
        (0, 0, 9, "classic frame of 9 data bytes, must be 0 to 8"),
        (0, FD, 9, "FD frame of 9 data bytes"),
        (0, FD | REMOTE, 0, "an FD frame is neither a remote nor an error frame"),
        (0, SWITCH, 0, "bit rate switch and error state exist in FD frames only"),
    ],
)
def test_a_refusal_says_what_and_within_which_bounds(number, flags, length, why):
    with pytest.raises(BusFrameError, match=why):
        check(number, flags, length)
