"""Which frames an injected error hits."""

import pytest

from cutgate.firmware_sim.bus.medium.errors import CASES, Injection, WireFault


def hits(injection, *frames):
    return [injection.hits(number, senders) for number, senders in frames]


def test_every_error_has_a_row():
    assert set(CASES) == set(WireFault)


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
