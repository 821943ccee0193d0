"""Lines of a bus log as `candump -L` writes them."""

from cutgate.firmware_sim.bus.wire import Flag, Record

_ERROR_BIT = 0x2000_0000
_FDF = 0x04  # the kernel sets it on every FD frame


def line(frame: Record, interface: str) -> str:
    """One log line, newline included, of a frame that `wire.check_frame` accepts.

    Args:
        frame: the frame with the hub's time stamp.
        interface: the name in the second column; no blanks.
    """
    seconds, rest = divmod(frame.time_ns, 1_000_000_000)
    flags = frame.flags
    if flags & Flag.ERROR:
        identifier = f"{frame.number | _ERROR_BIT:08X}"
    else:
        identifier = f"{frame.number:08X}" if flags & Flag.EXTENDED else f"{frame.number:03X}"
    data = frame.data.hex().upper()
    if flags & Flag.REMOTE:
        content = f"#R{frame.length or ''}"
    elif flags & Flag.FD:
        bits = _FDF | (1 if flags & Flag.BIT_RATE_SWITCH else 0) | (2 if flags & Flag.ERROR_STATE else 0)
        content = f"##{bits:X}{data}"
    else:
        content = f"#{data}"
    return f"({seconds}.{rest // 1000:06d}) {interface} {identifier}{content}\n"
