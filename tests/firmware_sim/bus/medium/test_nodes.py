"""Who goes first: what the bits of the arbitration field decide on a wire."""

from hypothesis import given
from hypothesis import strategies as st

from cutgate.firmware_sim.bus.frame import BusFrame, Flag
from cutgate.firmware_sim.bus.medium.confinement import Counters
from cutgate.firmware_sim.bus.medium.nodes import Node, Waiting, arbitration
from tests.firmware_sim.bus.medium.frames import classic, of
from tests.oracle.can_wire import winners


@given(st.lists(classic(), min_size=1, max_size=5))
def test_the_lowest_is_who_a_wire_lets_through(frames):
    lowest = min(map(arbitration, frames))
    expected = [index for index, frame in enumerate(frames) if arbitration(frame) == lowest]
    assert winners(frames) == expected


def test_an_error_flag_goes_before_everything():
    assert arbitration(BusFrame(0x4, int(Flag.ERROR), 8, bytes(8))) < arbitration(of(0))


def test_a_node_sends_when_it_has_something_and_may():
    node = Node(1, "one", 10)
    assert node.sends_from_ns is None
    node.queue.append(Waiting(of(1), 50))
    assert node.sends_from_ns == 50
    node.ready_ns = 70
    assert node.sends_from_ns == 70
    node.counters = Counters(256)
    assert node.sends_from_ns is None
