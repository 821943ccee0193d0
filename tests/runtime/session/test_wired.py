"""Whole sessions on a bus that takes its time and errs as a wire does."""

import pytest

from cutgate.firmware_sim.bus.frame import BusFrame
from cutgate.firmware_sim.bus.medium.bits import Rates
from cutgate.firmware_sim.bus.medium.confinement import NodeState
from cutgate.firmware_sim.bus.medium.errors import Injection, WireFault
from cutgate.firmware_sim.bus.overload import Overload
from cutgate.protocol.frames import IDS, ControllerHeartbeat, Joints01, RuntimeHeartbeat
from cutgate.protocol.records import Side
from cutgate.protocol.states import ControllerState, StopCause
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.interlock.phases import ENDED
from cutgate.runtime.interlock.state import Phase
from tests.runtime.session.pair import job_of
from tests.runtime.session.wired import wired

pytestmark = pytest.mark.no_cover

RATES = {
    "125 kbit/s": (Rates(125_000), ()),
    "250 kbit/s": (Rates(250_000), ()),
    "1 Mbit/s": (Rates(1_000_000), ()),
    "1 and 5 Mbit/s": (Rates(1_000_000, 5_000_000), tuple(Side)),
}


@pytest.fixture
def a_pair(tmp_path, tmp_path_factory):
    """Makes pairs on a wire."""

    def make(fd=(), **options):
        return wired(tmp_path, *job_of(tmp_path_factory), fd, **options)

    return make


@pytest.mark.parametrize("rate", RATES)
def test_a_cut_is_completed_at_every_bit_rate_with_a_queue_of_ten_frames(a_pair, rate):
    rates, fd = RATES[rate]
    with a_pair(fd, rates=rates) as pair:
        assert pair.end(60.0) is Phase.DONE, (pair.state.reason, pair.said)
        medium = pair.time.medium
        assert medium.totals.error_frames == 0
        assert {node.state for node in medium.nodes.values()} == {NodeState.ERROR_ACTIVE}
        assert any(node.tally.refused for node in medium.nodes.values()), "the queue was never full"
        pair.close()
        assert pair.read().report.status is Status.OK


def stopped(pair, limit_s=5.0):
    """How the session ended; the arm stands, and stays where it is."""
    pair.until(lambda: pair.phase in ENDED, limit_s)
    pair.until(lambda: pair.controller.state is not ControllerState.CUTTING, 1.0)
    joints = pair.process.arm.state.joints
    pair.run(0.5)
    assert pair.process.arm.state.joints == joints
    return pair.phase, pair.state.cause


def cutting(pair):
    pair.to(Phase.CUTTING, limit_s=60.0).run(0.1)
    assert pair.phase is Phase.CUTTING
    return pair.time.medium


@pytest.mark.parametrize("number", [IDS[RuntimeHeartbeat], IDS[ControllerHeartbeat], IDS[Joints01]])
@pytest.mark.parametrize("kind", WireFault)
def test_an_error_on_the_wire_is_mended_by_the_wire(a_pair, kind, number):
    """What was destroyed is sent again within its period; a frame that comes twice says nothing new."""
    with a_pair() as pair:
        medium = cutting(pair)
        for skip in (0, 3, 6):
            assert medium.inject(Injection(kind, number=number, skip=skip))
        phase = pair.end(60.0)
        assert medium.totals.error_frames == 3
        assert phase is Phase.DONE, pair.state.reason


@pytest.mark.parametrize("number", [0x000, 0x07F])
def test_a_babbling_node_of_the_highest_priority_stops_the_cut_and_is_named(a_pair, number):
    with a_pair() as pair:
        medium = cutting(pair)
        overload = Overload(medium, pair.time.now_ns)
        babbler = pair.time.join("babbler")
        pair.closing.append(babbler.shutdown)

        def babbles():
            while pair.time.offer(babbler.number, BusFrame(number, 0, 8, bytes(8))):
                pass

        pair.time.add(babbler, babbles, lambda: 0.0001)
        phase, cause = stopped(pair)
        assert (phase, cause) == (Phase.STOPPED, StopCause.HEARTBEAT_LOST)
        named = f"% of the frames on the bus had identifier 0x{number:03X}, which is neither side's"
        assert named in pair.state.reason
        assert [note for note in pair.notes.notes if named in note]
        pair.run(1.0)
        (line,) = overload.seen(pair.time.now_ns)
        assert line.startswith("babbler takes ")
        assert f"identifier {number:#05x}; load 100%" in line
        pair.close()
        log = pair.read()
        assert log.report.status is Status.OK
        lost = [one["reason"] for one in log.of("/audit/decision") if one["event"] == "heartbeat lost"]
        assert lost[0] == pair.state.reason
        assert pair.replayed().differences == ()


@pytest.mark.parametrize("side", Side)
def test_a_side_that_is_off_the_bus_stops_the_cut(a_pair, side):
    with a_pair() as pair:
        medium = cutting(pair)
        number = pair.wire.nodes[side].number
        medium.inject(Injection(WireFault.BIT, senders=frozenset({number}), count=32))
        phase, cause = stopped(pair)
        assert medium.nodes[number].state is NodeState.BUS_OFF
        assert (phase, cause) == (Phase.STOPPED, StopCause.HEARTBEAT_LOST)
        assert pair.controller.state in (ControllerState.INHIBITED, ControllerState.FAULT)


def test_a_side_that_comes_back_has_stopped_all_the_same(a_pair):
    with a_pair(restart_s=0.2) as pair:
        medium = cutting(pair)
        number = pair.wire.nodes[Side.RUNTIME].number
        medium.inject(Injection(WireFault.BIT, senders=frozenset({number}), count=32))
        assert stopped(pair)[0] is Phase.STOPPED
        assert medium.nodes[number].state is NodeState.ERROR_ACTIVE


def test_what_waits_in_a_short_queue_is_never_a_heartbeat_of_before(a_pair):
    """While the path is uploaded, no heartbeat waits longer than a full queue and the frame on the wire take."""
    with a_pair() as pair:
        offered, waits_ns = {}, []
        offer = pair.time.offer
        beats = (IDS[RuntimeHeartbeat], IDS[ControllerHeartbeat])

        def watched(number, frame):
            taken = offer(number, frame)
            if taken and frame.number in beats:
                offered[frame] = pair.time.now_ns
            return taken

        pair.time.offer = watched
        pair.end(60.0)
        waits_ns = [
            event.at_ns - offered[event.frame] for event in pair.wire.carried if event.frame in offered
        ]
        assert len(waits_ns) > 50
        assert max(waits_ns) <= 12 * 138_000
