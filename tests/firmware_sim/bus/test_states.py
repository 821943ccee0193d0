"""Error frames of the interface, as linux/can/error.h numbers them and python-can shows them."""

import pytest

from cutgate.firmware_sim.bus.frame import BusFrame, Flag
from cutgate.firmware_sim.bus.medium.confinement import Counters, NodeState
from cutgate.firmware_sim.bus.messages import message_of
from cutgate.firmware_sim.bus.states import RECEIVE_OVERFLOW, TRANSMIT_OVERFLOW, overflow_frame, state_frame

S = NodeState
CAN_ERR_CRTL, CAN_ERR_BUSOFF, CAN_ERR_RESTARTED, CAN_ERR_CNT = 0x004, 0x040, 0x100, 0x200


@pytest.mark.parametrize(
    ("before", "state", "counters", "number", "detail"),
    [
        (S.ERROR_ACTIVE, S.ERROR_WARNING, Counters(96, 0), CAN_ERR_CRTL, 0x08),
        (S.ERROR_ACTIVE, S.ERROR_WARNING, Counters(0, 96), CAN_ERR_CRTL, 0x04),
        (S.ERROR_WARNING, S.ERROR_PASSIVE, Counters(128, 3), CAN_ERR_CRTL, 0x20),
        (S.ERROR_WARNING, S.ERROR_PASSIVE, Counters(3, 128), CAN_ERR_CRTL, 0x10),
        (S.ERROR_WARNING, S.ERROR_ACTIVE, Counters(95, 3), CAN_ERR_CRTL, 0x40),
        (S.ERROR_WARNING, S.ERROR_ACTIVE, Counters(3, 95), CAN_ERR_CRTL, 0x40),
        # as can_change_state of drivers/net/can/dev/dev.c: both bits where both counters are as high
        (S.ERROR_ACTIVE, S.ERROR_WARNING, Counters(96, 96), CAN_ERR_CRTL, 0x08 | 0x04),
        (S.ERROR_WARNING, S.ERROR_PASSIVE, Counters(128, 128), CAN_ERR_CRTL, 0x20 | 0x10),
        (S.ERROR_WARNING, S.ERROR_ACTIVE, Counters(95, 95), CAN_ERR_CRTL, 0x40),
        (S.ERROR_PASSIVE, S.BUS_OFF, Counters(256, 3), CAN_ERR_BUSOFF, 0),
        (S.BUS_OFF, S.ERROR_ACTIVE, Counters(), CAN_ERR_RESTARTED, 0),
    ],
)
def test_a_change_of_state_is_told_with_both_counters(before, state, counters, number, detail):
    frame = state_frame(before, state, counters)
    message = message_of(frame, 1.0, "bus")
    assert frame.length == len(frame.data) == 8
    assert message.is_error_frame
    assert message.arbitration_id == number | CAN_ERR_CNT
    assert bytes(message.data) == bytes(
        (0, detail, 0, 0, 0, 0, min(counters.transmit, 255), counters.receive)
    )


def test_an_overflow_says_how_many():
    assert overflow_frame(0x01, 0x10203) == BusFrame(
        CAN_ERR_CRTL, Flag.ERROR, 8, bytes((0, 1, 0, 0, 0, 1, 2, 3))
    )
    assert (RECEIVE_OVERFLOW, TRANSMIT_OVERFLOW) == (0x01, 0x02)  # CAN_ERR_CRTL_RX_OVERFLOW, _TX_OVERFLOW
