"""Which frames an injected error hits."""

from dataclasses import FrozenInstanceError

import pytest

from cutgate.firmware_sim.bus.medium.errors import CASES, ErrorCase, Injection, WireFault


def hits(injection, *frames):
    return [injection.hits(number, senders) for number, senders in frames]


ENDS = (
    *("crc delimiter", "acknowledge slot", "acknowledge delimiter"),
    *(f"end of frame {bit}" for bit in (1, 2, 3, 4, 5, 6, 7)),
)
"""The last bits of a frame."""


@pytest.mark.parametrize(
    ("kind", "last_bit", "by_receivers", "kept"),
    [
        (WireFault.BIT, None, False, False),
        (WireFault.STUFF, None, True, False),
        (WireFault.FORM, "crc delimiter", True, False),
        (WireFault.ACK, "acknowledge slot", False, False),
        (WireFault.CRC, "acknowledge delimiter", True, False),  # flagged from the first bit of the end on
        (WireFault.LAST_BUT_ONE, "end of frame 6", True, True),
        (WireFault.LAST, "end of frame 7", False, True),
    ],
)
def test_each_error_is_seen_where_and_by_whom_the_standard_says(kind, last_bit, by_receivers, kept):
    from_end = None if last_bit is None else len(ENDS) - 1 - ENDS.index(last_bit)
    assert CASES[kind] == ErrorCase(from_end, by_receivers, kept)


def test_every_error_has_a_row():
    assert set(CASES) == set(WireFault)
    assert not ErrorCase(None, by_receivers=False).kept
    with pytest.raises(FrozenInstanceError):
        CASES[WireFault.BIT].kept = True


@pytest.mark.parametrize(
    ("wanted", "expected"),
    [
        ({}, [True, False, False]),
        ({"count": 2}, [True, True, False]),
        ({"count": 0}, [False, False, False]),
        ({"skip": 1}, [False, True, False]),
        ({"number": 7}, [False, True, False]),
        ({"number": 7, "skip": 1, "count": 5}, [False, False, True]),
        ({"senders": frozenset({2})}, [False, False, True]),
        ({"number": 6, "senders": frozenset({2})}, [False, False, False]),
    ],
)
def test_it_hits_what_it_names_so_often(wanted, expected):
    assert hits(Injection(WireFault.BIT, **wanted), (6, (1,)), (7, (1,)), (7, (1, 2))) == expected
