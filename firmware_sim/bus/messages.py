"""python-can's messages and the frames of the virtual bus."""

import can

from cutgate.firmware_sim.bus import frame as frames
from cutgate.firmware_sim.bus.frame import Flag, Frame, FrameError


def frame_of(msg: can.Message, *, fd: bool) -> Frame:
    """The frame of a message, checked.

    Args:
        msg: the message.
        fd: whether the bus was opened for FD frames.

    Raises:
        can.CanOperationError: a frame that this bus, or no CAN bus, carries.
    """
    flags = (
        (Flag.EXTENDED if msg.is_extended_id else 0)
        | (Flag.REMOTE if msg.is_remote_frame else 0)
        | (Flag.ERROR if msg.is_error_frame else 0)
        | (Flag.FD if msg.is_fd else 0)
        | (Flag.BIT_RATE_SWITCH if msg.bitrate_switch else 0)
        | (Flag.ERROR_STATE if msg.error_state_indicator else 0)
    )
    data = b"" if msg.is_remote_frame else bytes(msg.data)
    length = msg.dlc if msg.is_remote_frame else len(data)
    if msg.is_fd and not fd:
        raise can.CanOperationError("FD frame on a bus opened without FD; open it with fd=True")
    if not 0 <= length <= 64 or not 0 <= msg.arbitration_id <= 0xFFFF_FFFF:
        raise can.CanOperationError(f"no CAN frame: identifier {msg.arbitration_id}, length {length}")
    try:
        frames.check(msg.arbitration_id, flags, length)
    except FrameError as error:
        raise can.CanOperationError(f"not sent, {error}") from error
    return Frame(msg.arbitration_id, int(flags), length, data)


def message_of(frame: Frame, time_s: float, channel: str) -> can.Message:
    """The message of a frame."""
    flags = frame.flags
    return can.Message(
        timestamp=time_s,
        arbitration_id=frame.number,
        is_extended_id=bool(flags & Flag.EXTENDED),
        is_remote_frame=bool(flags & Flag.REMOTE),
        is_error_frame=bool(flags & Flag.ERROR),
        is_fd=bool(flags & Flag.FD),
        bitrate_switch=bool(flags & Flag.BIT_RATE_SWITCH),
        error_state_indicator=bool(flags & Flag.ERROR_STATE),
        is_rx=not flags & Flag.OWN,
        dlc=frame.length,
        data=frame.data,
        channel=channel,
    )
