"""python-can's messages and the frames of the virtual bus."""

import can

from cutgate.firmware_sim.bus import frame as frames
from cutgate.firmware_sim.bus.frame import BusFrame, BusFrameError, Flag

# Plain numbers: IntFlag takes a microsecond for each operation, and a frame needs seven.
_EXTENDED, _REMOTE, _ERROR, _FD = int(Flag.EXTENDED), int(Flag.REMOTE), int(Flag.ERROR), int(Flag.FD)
_SWITCH, _STATE, _OWN = int(Flag.BIT_RATE_SWITCH), int(Flag.ERROR_STATE), int(Flag.OWN)


def frame_of(msg: can.Message, *, fd: bool) -> BusFrame:
    """The frame of a message, checked.

    Args:
        msg: the message.
        fd: whether the bus was opened for FD frames.

    Raises:
        can.CanOperationError: a frame that this bus, or no CAN bus, carries.
    """
    flags = (
        (_EXTENDED if msg.is_extended_id else 0)
        | (_REMOTE if msg.is_remote_frame else 0)
        | (_ERROR if msg.is_error_frame else 0)
        | (_FD if msg.is_fd else 0)
        | (_SWITCH if msg.bitrate_switch else 0)
        | (_STATE if msg.error_state_indicator else 0)
    )
    data = b"" if msg.is_remote_frame else bytes(msg.data)
    length = msg.dlc if msg.is_remote_frame else len(data)
    if msg.is_fd and not fd:
        raise can.CanOperationError("FD frame on a bus opened without FD; open it with fd=True")
    try:
        frames.check(msg.arbitration_id, flags, length)
    except BusFrameError as error:
        raise can.CanOperationError(f"not sent, {error}") from error
    return BusFrame(msg.arbitration_id, flags, length, data)


def message_of(frame: BusFrame, time_s: float, channel: str) -> can.Message:
    """The message of a frame."""
    flags = frame.flags
    return can.Message(
        timestamp=time_s,
        arbitration_id=frame.number,
        is_extended_id=bool(flags & _EXTENDED),
        is_remote_frame=bool(flags & _REMOTE),
        is_error_frame=bool(flags & _ERROR),
        is_fd=bool(flags & _FD),
        bitrate_switch=bool(flags & _SWITCH),
        error_state_indicator=bool(flags & _STATE),
        is_rx=not flags & _OWN,
        dlc=frame.length,
        data=frame.data,
        channel=channel,
    )
