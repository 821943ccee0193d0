"""Frames as `candump -L` of can-utils writes them, one line each; both sides' logs are made here."""

_ERROR_BIT = 0x2000_0000
"""CAN_ERR_FLAG of linux/can.h: what follows is no data frame but a class of errors."""
_FDF, _ESI, _BRS = 0x04, 0x02, 0x01
"""CANFD_FDF, which the kernel sets on every FD frame, CANFD_ESI and CANFD_BRS of linux/can.h."""


def line(
    time_ns: int,
    interface: str,
    can_id: int,
    data: bytes,
    *,
    is_extended: bool = False,
    is_remote: bool = False,
    is_error: bool = False,
    is_fd: bool = False,
    bit_rate_switch: bool = False,
    error_state: bool = False,
    remote_length: int = 0,
) -> str:
    """One line, its end included.

    Args:
        time_ns: since 1970, UTC; written in whole microseconds, rounded down.
        interface: the bus's name, without blanks.
        can_id: 11 bits, or 29 of an extended frame or an error.
        data: of a frame that is not remote.
        is_extended: its identifier has 29 bits.
        is_remote: it asks for data.
        is_error: it is a class of errors, no frame of anybody's.
        is_fd: it is a CAN FD frame.
        bit_rate_switch: its data were sent at the higher bit rate.
        error_state: its sender is error passive.
        remote_length: how many bytes a remote frame asks for.
    """
    seconds, rest = divmod(time_ns, 1_000_000_000)
    if is_error:
        identifier = f"{can_id | _ERROR_BIT:08X}"
    else:
        identifier = f"{can_id:08X}" if is_extended else f"{can_id:03X}"
    content = f"R{remote_length or ''}" if is_remote else data.hex().upper()
    if is_fd:
        flags = _FDF | (_BRS if bit_rate_switch else 0) | (_ESI if error_state else 0)
        content = f"#{flags:X}{content}"
    return f"({seconds}.{rest // 1000:06d}) {interface} {identifier}#{content}\n"
