"""Who keeps the bus busy is named, once, and again when it begins anew."""

import pytest

from cutgate.firmware_sim.bus.frame import BusFrame
from cutgate.firmware_sim.bus.medium.bits import Rates
from cutgate.firmware_sim.bus.medium.medium import Medium, Talker
from cutgate.firmware_sim.bus.overload import WINDOW_NS, Overload


def busy(medium, number, until_ns):
    """Node 1 keeps the bus busy until then."""
    now_ns = medium.next_ns or 0
    while now_ns < until_ns:
        while medium.offer(1, BusFrame(number, 0, 8, bytes(8)), now_ns):
            pass
        now_ns = medium.next_ns
        medium.advance(now_ns)


def test_it_is_named_once_until_the_load_has_fallen():
    medium = Medium(Rates(1_000_000))
    for name in ("loud", "other"):
        medium.join(name)
    overload = Overload(medium, 0)
    busy(medium, 7, WINDOW_NS)
    assert not list(overload.seen(WINDOW_NS - 1))
    (line,) = overload.seen(WINDOW_NS)
    assert line == "loud takes 100% of the bus with identifier 0x007; load 100%"
    busy(medium, 7, 2 * WINDOW_NS)
    assert not list(overload.seen(2 * WINDOW_NS))
    medium.advance(3 * WINDOW_NS)
    assert not list(overload.seen(3 * WINDOW_NS))
    for now_ns in range(3 * WINDOW_NS, 4 * WINDOW_NS, 100_000):
        medium.offer(1, BusFrame(8, 0, 8, bytes(8)), now_ns)
        medium.advance(now_ns)
    (line,) = overload.seen(4 * WINDOW_NS)
    assert "identifier 0x008" in line


def test_who_has_left_is_named_by_its_number():
    medium = Medium(Rates(1_000_000))
    for name in ("loud", "other"):
        medium.join(name)
    overload = Overload(medium, 0)
    busy(medium, 7, WINDOW_NS)
    medium.leave(1)
    medium.advance(WINDOW_NS * 3)
    assert 1 not in medium.nodes
    assert [line[:31] for line in overload.seen(WINDOW_NS)] == ["node 1, which has left, takes 1"]


@pytest.mark.parametrize(
    ("bus_ns", "talker_ns", "named"),
    [
        (900_000_000, 500_000_000, True),
        (899_999_999, 500_000_000, False),
        (900_000_000, 499_999_999, False),
    ],
)
def test_nine_tenths_of_a_second_of_which_half_is_of_one_is_too_much(bus_ns, talker_ns, named):
    """In each second anew: what was before does not count."""
    medium = Medium(Rates(1_000_000))
    medium.join("loud")
    medium.totals.busy_ns = 5 * 10**9
    overload = Overload(medium, 0)
    medium.totals.busy_ns += bus_ns
    medium.totals.talkers[1, 7] = Talker(1, talker_ns)
    assert not list(overload.seen(999_999_999))
    assert bool(list(overload.seen(1_000_000_000))) == named
    medium.totals.busy_ns += 899_999_999
    medium.totals.talkers[1, 8] = Talker(1, 800_000_000)
    assert not list(overload.seen(2_000_000_000))


def test_a_load_of_many_names_nobody():
    medium = Medium(Rates(1_000_000))
    for name in "abc":
        medium.join(name)
    overload = Overload(medium, 0)
    for turn in range(25_000):
        node = turn % 3 + 1
        medium.offer(node, BusFrame(node), turn * 50_000)
        medium.advance(turn * 50_000)
    assert medium.totals.busy_ns > 0.9 * WINDOW_NS
    assert not list(overload.seen(WINDOW_NS))
