"""Sessions through the kernel's gateway (can-gw), which alters frames between two buses as a faulty gateway would."""

import pytest

from cutgate.config.bus import has_socketcan
from cutgate.protocol.frames import BULK_IDS, IDS, ControllerHeartbeat, Progress, RuntimeHeartbeat
from cutgate.protocol.states import StopCause
from tests.system.harness import FAST, Rig
from tests.vcan.interfaces import gate
from tests.vcan.sessions import assert_cut, assert_not_permitted, assert_stopped

pytestmark = [
    pytest.mark.processes,
    pytest.mark.skipif(not has_socketcan(), reason="the kernel has no vcan0"),
]

AS_IT_IS = "XOR:ILD:000.0.0000000000000000"
"""Each bit of identifier, length and data is turned over where the mask has a one."""
LAST_BIT = "XOR:D:000.0.0000000000000001"
THE_CHOSEN, THE_REST, THE_OTHER_WAY = 0xC1, 0xC2, 0xC3
"""The numbers of its rules: the kernel's gateway is one for the whole machine."""


class Gateway:
    """What lies between the controller's bus and the runtime's: one identifier apart from the rest."""

    def __init__(self, can_id: int, *, controllers: bool, buses: tuple[str, str]) -> None:
        one, other = buses
        self._can_id = can_id
        self._way = (one, other) if controllers else (other, one)
        gate(THE_REST, *self._way, f"{can_id:x}~7FF", AS_IT_IS)
        gate(THE_OTHER_WAY, *reversed(self._way), "0:0", AS_IT_IS)
        self.alter(AS_IT_IS)

    def alter(self, how: str) -> None:
        """From now on this becomes of each frame of the identifier, as ``cangw -m`` takes it."""
        gate(THE_CHOSEN, *self._way, f"{self._can_id:x}:7FF", how)


@pytest.fixture
def rig(tmp_path, two_buses):
    """The controller's bus, and everything that is started on either."""
    with Rig(tmp_path, "socketcan", two_buses[0]) as made:
        yield made


@pytest.fixture
def far(two_buses):
    """What puts a runtime on the other bus."""
    return {"more": ["--channel", two_buses[1]]}


def test_through_a_gateway_that_alters_nothing_a_session_cuts(rig, two_buses, far, capsys):
    Gateway(IDS[RuntimeHeartbeat], controllers=False, buses=two_buses)
    sim, run = rig.cutting(scale=FAST, **far)
    assert_cut(rig, sim, run, capsys)


@pytest.mark.parametrize(
    ("kind", "how", "causes"),
    [
        (RuntimeHeartbeat, LAST_BIT, {StopCause.CORRUPTION}),
        (RuntimeHeartbeat, f"SET:I:{IDS[ControllerHeartbeat]:x}.0.0000000000000000", {StopCause.SECOND_NODE}),
        (Progress, "SET:I:7F0.0.0000000000000000", {StopCause.TRACKING_DEVIATION}),
    ],
    ids=["data", "the receiver's identifier", "an identifier that nobody knows"],
)
def test_a_cut_in_which_a_gateway_begins_to_alter_frames_stops_for_the_right_cause(
    rig, two_buses, far, capsys, kind, how, causes
):
    gateway = Gateway(IDS[kind], controllers=kind is not RuntimeHeartbeat, buses=two_buses)
    sim, run = rig.cutting(**far)
    gateway.alter(how)
    assert_stopped(rig, sim, run, causes, capsys)


def test_a_path_of_which_a_gateway_alters_one_bit_in_each_frame_is_refused(rig, two_buses, far, capsys):
    gateway = Gateway(BULK_IDS[0], controllers=False, buses=two_buses)
    gateway.alter(LAST_BIT)
    run, sim = rig.run(**far), rig.sim()
    assert_not_permitted(rig, sim, run, capsys)
    assert rig.log().of("/audit/decision")[-1]["first_out"] == "PROTOCOL_VIOLATION"
