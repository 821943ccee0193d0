"""A frame on the virtual bus, and what no CAN bus can carry."""

from enum import IntFlag
from typing import Final, NamedTuple

FD_LENGTHS: Final = (*range(9), 12, 16, 20, 24, 32, 48, 64)
"""Data bytes of an FD frame by its length code (ISO 11898-1)."""
STANDARD_MAX: Final = 0x7FF
EXTENDED_MAX: Final = 0x1FFF_FFFF


class BusFrameError(ValueError):
    """A frame that no CAN bus can carry."""


class Flag(IntFlag):
    """What a frame is besides its identifier and data; OWN marks the copy that comes back to its sender."""

    EXTENDED = 0x01
    REMOTE = 0x02
    ERROR = 0x04
    FD = 0x08
    BIT_RATE_SWITCH = 0x10
    ERROR_STATE = 0x20
    OWN = 0x40


ALL_FLAGS: Final = 0x7F
_EXTENDED, _REMOTE, _ERROR, _FD = int(Flag.EXTENDED), int(Flag.REMOTE), int(Flag.ERROR), int(Flag.FD)
_FD_ONLY: Final = int(Flag.BIT_RATE_SWITCH | Flag.ERROR_STATE)


class BusFrame(NamedTuple):
    """One frame.

    Attributes:
        number: the identifier; of an error frame the class of errors, as Linux numbers it.
        flags: of ``Flag``.
        length: data bytes; of a remote frame the length that it asks for.
        data: the bytes.
    """

    number: int
    flags: int = 0
    length: int = 0
    data: bytes = b""


def check(number: int, flags: int, length: int) -> None:
    """Refuse what no CAN bus can carry.

    Raises:
        BusFrameError: identifier, length or combination of flags that no frame has.
    """
    highest = EXTENDED_MAX if flags & (_EXTENDED | _ERROR) else STANDARD_MAX
    if not 0 <= number <= highest:
        raise BusFrameError(f"identifier {number:#x}, must be 0x0 to {highest:#x}")
    if flags & _FD:
        if flags & (_REMOTE | _ERROR):
            raise BusFrameError("an FD frame is neither a remote nor an error frame")
        if length not in FD_LENGTHS:
            raise BusFrameError(f"FD frame of {length} data bytes; 0-8, 12, 16, 20, 24, 32, 48 or 64 exist")
    elif not 0 <= length <= 8:
        raise BusFrameError(f"classic frame of {length} data bytes, must be 0 to 8")
    elif flags & _FD_ONLY:
        raise BusFrameError("bit rate switch and error state exist in FD frames only")
