"""A message of python-can and a frame of the bus say the same."""

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.firmware_sim.bus.frame import BusFrame, Flag
from cutgate.firmware_sim.bus.messages import frame_of, message_of
from tests.firmware_sim.bus.medium.frames import classic, flexible

FIELDS = {
    "is_extended_id": Flag.EXTENDED,
    "is_remote_frame": Flag.REMOTE,
    "is_error_frame": Flag.ERROR,
    "is_fd": Flag.FD,
    "bitrate_switch": Flag.BIT_RATE_SWITCH,
    "error_state_indicator": Flag.ERROR_STATE,
}


@given(
    classic()
    | flexible()
    | st.builds(lambda data: BusFrame(0x4, int(Flag.ERROR), 8, data), st.binary(min_size=8, max_size=8))
)
def test_a_message_says_what_the_frame_says_and_becomes_it_again(frame):
    message = message_of(frame, 12.5, "bus")
    assert {name for name in FIELDS if getattr(message, name)} == {
        name for name, flag in FIELDS.items() if frame.flags & flag
    }
    assert (message.arbitration_id, message.dlc, bytes(message.data)) == (
        frame.number,
        frame.length,
        frame.data,
    )
    assert (message.timestamp, message.channel, message.is_rx) == (12.5, "bus", True)
    assert frame_of(message, fd=True) == frame
    own = message_of(frame._replace(flags=frame.flags | Flag.OWN), 0.0, "bus")
    assert not own.is_rx
    assert frame_of(own, fd=True) == frame


@given(flexible())
def test_a_bus_without_fd_takes_no_fd_frame(frame):
    with pytest.raises(can.CanOperationError, match="open it with fd=True"):
        frame_of(message_of(frame, 0.0, "bus"), fd=False)


@given(classic())
def test_and_every_classic_one(frame):
    assert frame_of(message_of(frame, 0.0, "bus"), fd=False) == frame


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (can.Message(arbitration_id=0x800, is_extended_id=False), "not sent, identifier 0x800"),
        (can.Message(arbitration_id=-1), "not sent, identifier -0x1"),
        (can.Message(data=bytes(9)), "not sent, classic frame of 9"),
        (can.Message(is_remote_frame=True, dlc=9), "not sent, classic frame of 9"),
        (can.Message(is_remote_frame=True, dlc=-1), "not sent, classic frame of -1"),
        (can.Message(is_fd=True, data=bytes(65)), "not sent, FD frame of 65"),
        (can.Message(bitrate_switch=True), "not sent, bit rate switch"),
    ],
)
def test_what_no_bus_carries_is_refused_with_the_reason(message, why):
    with pytest.raises(can.CanOperationError, match=why):
        frame_of(message, fd=True)


def test_a_remote_frame_asks_for_a_length_and_has_no_data():
    message = can.Message(arbitration_id=1, is_extended_id=False, is_remote_frame=True, dlc=5)
    assert frame_of(message, fd=False) == BusFrame(1, int(Flag.REMOTE), 5, b"")
