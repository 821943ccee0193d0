"""The codes keep their distance."""

from itertools import combinations

import pytest

from cutgate.protocol.states import (
    EPOCHS,
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

NUMBERS = {
    RuntimeCode: (1, 2, 4),
    ControllerState: range(1, 8),
    StopCause: range(27),
    Purpose: range(1, 4),
    Refusal: range(47),
}
WORDS = [int(code) for kind in (StopCode, FaultCode) for code in kind]


@pytest.mark.parametrize("kind", [RuntimeCode, ControllerState])
def test_what_a_heartbeat_says_fits_three_bits_and_nothing_is_said_by_zero(kind):
    assert all(1 <= code < 8 for code in kind)


@pytest.mark.parametrize(
    ("kind", "numbers"), NUMBERS.items(), ids=lambda value: getattr(value, "__name__", "")
)
def test_a_code_keeps_its_number(kind, numbers):
    """Logs are read for years: a code that is no longer sent keeps its own, and a new one takes the next."""
    assert [int(code) for code in kind] == [*numbers]


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


def test_second_node_audit_authentication_internal_error_and_limits_latch_and_nothing_else():
    assert {cause.name for cause in LATCHING} == {
        "SECOND_NODE",
        "AUDIT_FAILED",
        "AUTHENTICATION_FAILED",
        "INTERNAL_ERROR",
        "LIMIT_EXCEEDED",
    }


def test_a_withdrawal_and_a_bone_that_moves_withdraw_and_nothing_else():
    assert {cause.name for cause in WITHDRAWING} == {"REGISTRATION_WITHDRAWN", "BONE_MOVED"}


def test_the_epoch_has_five_bits():
    assert EPOCHS == 1 << 5
