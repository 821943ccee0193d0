"""Frames as `candump -L` of can-utils writes them, one line each; both sides' logs are made here, and read again."""

import re
from dataclasses import dataclass
from typing import Final

_ERROR_BIT = 0x2000_0000
"""CAN_ERR_FLAG of linux/can.h: what follows is no data frame but a class of errors."""
_FDF, _ESI, _BRS = 0x04, 0x02, 0x01
"""CANFD_FDF, which the kernel sets on every FD frame, CANFD_ESI and CANFD_BRS of linux/can.h."""

STANDARD_MAX: Final = 0x7FF
EXTENDED_MAX: Final = 0x1FFF_FFFF
TIME_NS_MAX: Final = 10**19 - 1
"""Of ten digits of seconds."""
CLASSIC_BYTES: Final = 8
FD_LENGTHS: Final = (*range(9), 12, 16, 20, 24, 32, 48, 64)
"""What a CAN FD frame can be long."""
_LINE: Final = re.compile(
    r"\((?P<seconds>[0-9]{1,10})\.(?P<fraction>[0-9]{1,9})\)[ \t]+(?P<interface>[^\s]{1,64})[ \t]+"
    r"(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#"
    r"(?:[Rr](?P<remote>[0-8]?)|(?:#(?P<flags>[0-9A-Fa-f]))?(?P<data>(?:[0-9A-Fa-f]{2})*))"
    r"(?:_[9A-Fa-f])?"  # the length code of a frame of eight bytes, where it was asked for
    r"(?:[ \t]+[RTrt])?"  # the direction, where it was asked for
)


class CandumpError(ValueError):
    """A line that is no frame, or one that no bus carries."""


@dataclass(frozen=True, slots=True)
class RawFrame:
    """One frame as a line tells it.

    Attributes:
        time_ns: since 1970, UTC.
        interface: the bus's name.
        can_id: 11 bits, or 29 of an extended frame or an error.
        data: its bytes; none of a frame that is remote.
        is_extended: its identifier has 29 bits.
        is_remote: it asks for data.
        is_error: it is a class of errors, no frame of anybody's.
        is_fd: it is a CAN FD frame.
        bit_rate_switch: its data were sent at the higher bit rate.
        error_state: its sender is error passive.
        remote_length: how many bytes a remote frame asks for.

    Raises:
        CandumpError: no bus carries such a frame.
    """

    time_ns: int
    interface: str
    can_id: int
    data: bytes = b""
    is_extended: bool = False
    is_remote: bool = False
    is_error: bool = False
    is_fd: bool = False
    bit_rate_switch: bool = False
    error_state: bool = False
    remote_length: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.time_ns <= TIME_NS_MAX:
            raise CandumpError("a time before 1970, or of more than ten digits of seconds")
        most = EXTENDED_MAX if self.is_extended or self.is_error else STANDARD_MAX
        if not 0 <= self.can_id <= most:
            raise CandumpError(f"identifier {self.can_id:#x} is above {most:#x}")
        length = len(self.data)
        if self.is_fd and length not in FD_LENGTHS:
            raise CandumpError(f"an FD frame of {length} bytes")
        if not self.is_fd and not length <= CLASSIC_BYTES:
            raise CandumpError(f"a classic frame of {length} bytes")

    @property
    def time_us(self) -> int:
        """Since 1970, UTC, as a line of ours has it."""
        return self.time_ns // 1000

    @property
    def line(self) -> str:
        """As `line` writes it."""
        return line(
            self.time_ns,
            self.interface,
            self.can_id,
            self.data,
            is_extended=self.is_extended,
            is_remote=self.is_remote,
            is_error=self.is_error,
            is_fd=self.is_fd,
            bit_rate_switch=self.bit_rate_switch,
            error_state=self.error_state,
            remote_length=self.remote_length,
        )


def parse(text: str) -> RawFrame:
    """The frame of one line, which may end in blanks.

    A time has up to nine decimals; behind the frame may stand its length code and its direction (`candump -8`, `-x`),
    which are not kept.

    Raises:
        CandumpError: it is no such line, or no bus carries such a frame.
    """
    found = _LINE.fullmatch(text.rstrip())
    if found is None:
        raise CandumpError("not a line of candump -L: (seconds.fraction) interface identifier#data")
    digits, flags, remote = found["id"], found["flags"], found["remote"]
    can_id = int(digits, 16)
    is_error = len(digits) == 8 and bool(can_id & _ERROR_BIT)
    fd = 0 if flags is None else int(flags, 16)
    return RawFrame(
        int(found["seconds"]) * 1_000_000_000 + int(found["fraction"].ljust(9, "0")),
        found["interface"],
        can_id & ~_ERROR_BIT if is_error else can_id,
        bytes.fromhex(found["data"] or ""),
        is_extended=len(digits) == 8 and not is_error,
        is_remote=remote is not None,
        is_error=is_error,
        is_fd=flags is not None,
        bit_rate_switch=bool(fd & _BRS),
        error_state=bool(fd & _ESI),
        remote_length=int(remote or 0),
    )


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
