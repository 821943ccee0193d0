"""The codes keep their distance."""

from itertools import combinations

import pytest

from cutgate.protocol.states import (
    LATCHING,
    WITHDRAWING,
    ControllerState,
    FaultCode,
    Purpose,
    Refusal,
    RuntimeCode,
    StopCause,
    StopCode,
    claimable,
)

WORDS = [int(code) for kind in (StopCode, FaultCode) for code in kind]


@pytest.mark.parametrize("kind", [RuntimeCode, ControllerState])
def test_what_a_heartbeat_says_fits_three_bits_and_nothing_is_said_by_zero(kind):
    assert all(1 <= code < 8 for code in kind)


def test_all_codes_that_no_tag_covers_differ_in_at_least_eight_bits_also_from_all_zeros_and_all_ones():
    for first, second in combinations([0x0000, 0xFFFF, *WORDS], 2):
        assert (first ^ second).bit_count() >= 8, (hex(first), hex(second))


@pytest.mark.parametrize("cause", StopCause)
def test_a_stop_frame_says_every_cause_but_a_withdrawing_one(cause):
    assert claimable(cause) is (StopCause.OPERATOR_STOP if cause in WITHDRAWING else cause)


def test_stop_causes_fit_five_bits():
    assert all(0 <= cause < 32 for cause in StopCause)


@pytest.mark.parametrize("kind", [Purpose, Refusal])
def test_small_codes_fit_one_byte(kind: type[Purpose | Refusal]):
    assert all(0 <= code < 256 for code in kind)


def test_only_real_causes_latch():
    assert StopCause.NONE not in LATCHING
