"""Sessions over a wire that the kernel disturbs: what netem does to frames of controller and runtime on their way.

The runtime is at one end of a `vxcan` pair, the controller at the other. On a `vcan` netem changes nothing: its frames
reach their hearers before the interface's queue.
"""

import pytest

from cutgate.config.bus import has_socketcan
from cutgate.protocol.frames import RuntimeHeartbeat
from cutgate.protocol.states import StopCause
from tests.system.harness import FAST, Rig, is_kind
from tests.vcan.interfaces import disturb, queue
from tests.vcan.sessions import assert_cut, assert_not_permitted, assert_stopped, hurried

pytestmark = [
    pytest.mark.processes,
    pytest.mark.skipif(not has_socketcan(), reason="the kernel has no vcan0"),
]

DOWN, UP, BOTH = (1,), (0,), (0, 1)
"""At which ends frames are disturbed as they leave: the runtime's, the controller's."""
FRAMES_MIN = 100
ANY_BIT = {
    StopCause.CORRUPTION,
    StopCause.SECOND_NODE,
    StopCause.SEQUENCE_ERROR,
    StopCause.TRACKING_DEVIATION,
}
"""Of a frame as the kernel holds it: of its data, and of identifier and length, which no wire would leave unnoticed. So
it may carry the receiver's own identifier, or none that counts."""


@pytest.fixture
def rig(tmp_path, wire):
    """Sessions across a wire; the bus that is looked at is the controller's end of it."""
    with Rig(tmp_path, "socketcan", wire[0]) as made:
        yield made


@pytest.fixture
def far(wire):
    """What puts a runtime at the other end."""
    return {"more": ["--channel", wire[1]]}


def test_a_wire_that_only_takes_its_time_holds_up_no_session(rig, wire, far, capsys):
    for end in wire:
        disturb(end, "delay", "2ms", "rate", "500kbit")
    sim, run = rig.cutting(scale=FAST, **far)
    assert_cut(rig, sim, run, capsys)
    assert all(queue(end)["packets"] > FRAMES_MIN for end in wire), "hardly anything crossed the wire"


def test_a_cut_in_which_every_frame_comes_twice_goes_on_to_its_end(rig, wire, far, capsys):
    sim, run = rig.cutting(scale=FAST / 3, **far)
    for end in wire:
        disturb(end, "duplicate", "100%")
    assert_cut(rig, sim, run, capsys)
    heard = [bytes(m.data) for m in rig.bus.frames if is_kind(m, RuntimeHeartbeat)]
    assert len(set(heard)) < len(heard), "the wire duplicates nothing"


@pytest.mark.parametrize(
    ("ends", "how", "causes"),
    [
        (DOWN, ("loss", "100%"), {StopCause.HEARTBEAT_LOST}),
        (UP, ("loss", "60%"), {StopCause.SEQUENCE_ERROR, StopCause.TRACKING_DEVIATION}),
        (DOWN, ("delay", "80ms", "reorder", "50%"), {StopCause.SEQUENCE_ERROR}),
        (BOTH, ("delay", "700ms"), {StopCause.HEARTBEAT_LOST}),
        (UP, ("rate", "2kbit"), {StopCause.HEARTBEAT_LOST}),
        (BOTH, ("corrupt", "100%"), ANY_BIT),
    ],
    ids=["runtime lost", "controller half lost", "order", "age", "too slow", "corrupt"],
)
def test_a_disturbed_cut_stops_for_the_right_cause_and_stays_where_it_is(
    rig, wire, far, capsys, ends, how, causes
):
    sim, run = rig.cutting(**far)
    for end in ends:
        disturb(wire[end], *how)
    assert_stopped(rig, sim, run, causes, capsys)


def test_over_a_wire_that_spoils_every_transfer_nothing_is_permitted(rig, wire, far, capsys):
    hurried(rig)
    for end in wire:
        disturb(end, "duplicate", "100%")
    run, sim = rig.run(**far), rig.sim()
    assert_not_permitted(rig, sim, run, capsys)
    assert "no controller announced itself" in run.told
