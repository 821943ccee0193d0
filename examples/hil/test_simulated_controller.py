"""cutgate's simulated controller against a script of ours: what anybody hears on the bus, and what faults do."""

import can
import pytest

from cutgate.protocol.frames import IDS, ControllerFault, decode_frame
from cutgate.protocol.states import StopCause


@pytest.mark.cutgate_expect("EMERGENCY_STOP")
def test_an_emergency_stop_is_heard_by_everybody(
    cutgate_bus, cutgate_controller, cutgate_session, cutgate_operator
):
    faults = []

    def hear(message):
        if message.arbitration_id == IDS[ControllerFault]:
            faults.append(decode_frame(message.arbitration_id, bytes(message.data)))

    with can.Notifier(cutgate_bus.open(), [hear]):
        cutgate_controller(time_scale=1)
        cutgate_operator.cut()
        cutgate_operator.type("estop")
        assert cutgate_session.ended() == 3
    assert faults[0].cause is StopCause.EMERGENCY_STOP


@pytest.mark.cutgate_wire("1M", queue=10)
@pytest.mark.cutgate_faults("silent@cutting")
@pytest.mark.cutgate_expect("HEARTBEAT_LOST")
def test_in_virtual_time_the_runtime_stops_within_its_time_out(cutgate_virtual, cutgate_virtual_session):
    cutgate_virtual.controller()
    session = cutgate_virtual_session().start()
    assert session.ended() == 3
    assert session.cause == "HEARTBEAT_LOST"


@pytest.mark.cutgate_faults("delay Progress by 5..40ms p=0.2 seed=1")
def test_late_progress_holds_up_no_cut(cutgate_controller, cutgate_session, cutgate_operator):
    cutgate_controller()
    cutgate_operator.start()
    assert cutgate_session.ended() == 0
