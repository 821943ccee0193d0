"""Who goes first: what the bits of the arbitration field decide on a wire."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.firmware_sim.bus.frame import BusFrame, Flag
from cutgate.firmware_sim.bus.medium.confinement import Counters
from cutgate.firmware_sim.bus.medium.nodes import Node, Tally, Waiting, arbitration
from tests.firmware_sim.bus.medium.frames import EXTENDED, REMOTE, classic, of
from tests.oracle.can_wire import winners


@given(st.lists(classic(), min_size=1, max_size=5))
def test_the_lowest_is_who_a_wire_lets_through(frames):
    lowest = min(map(arbitration, frames))
    expected = [index for index, frame in enumerate(frames) if arbitration(frame) == lowest]
    assert winners(frames) == expected


def neighbours(identifier):
    """Frames that agree in their first bits for as long as two can: data and remote, standard and extended."""
    for flags in (0, REMOTE):
        yield of(identifier, flags=flags)
        yield from (of(identifier ^ 1 << bit, flags=flags) for bit in range(11))
        for number in (identifier << 18, identifier << 18 | 0x3FFFF, identifier << 18 | 0x15555):
            yield of(number, flags=flags | EXTENDED)
            yield from (of(number ^ 1 << bit, flags=flags | EXTENDED) for bit in range(29))


@pytest.mark.parametrize("identifier", [0x000, 0x555, 0x7FF])
def test_of_any_two_that_differ_late_a_wire_lets_the_same_one_through(identifier):
    """In the order of the numbers each next one loses: so each before it wins against all that follow."""
    ordered = sorted(set(neighbours(identifier)), key=arbitration)
    for first, second in pairwise(ordered):
        assert winners([second, first]) == [1], (first, second)


def test_an_error_flag_goes_before_everything():
    assert arbitration(BusFrame(0x4, int(Flag.ERROR), 8, bytes(8))) < arbitration(of(0))


def test_a_node_begins_with_nothing_and_is_itself_alone():
    node = Node(1, "one", 10)
    assert node.tally == Tally(0, 0, 0, 0, 0, 0)
    assert (node.ready_ns, node.leaving, node.recessive, node.counters) == (0, False, 0, Counters(0, 0))
    assert node != Node(1, "one", 10)
    assert {node: 1}[node] == 1


def test_a_node_sends_when_it_has_something_and_may():
    node = Node(1, "one", 10)
    assert node.sends_from_ns is None
    node.queue.append(Waiting(of(1), 50))
    assert node.sends_from_ns == 50
    node.ready_ns = 70
    assert node.sends_from_ns == 70
    node.counters = Counters(256)
    assert node.sends_from_ns is None
