"""What hub and client say to each other: one fixed binary record per datagram.

    offset  size  field
    0       1     version of this framing, 1
    1       1     kind
    2       2     flags, little-endian like all that follows
    4       4     CAN identifier; in OVERRUN the number of frames lost
    8       8     time of the frame on the bus, ns since the epoch; stamped by the hub, 0 from a client
    16      1     DLC field of a remote frame, else the number of data bytes
    17      0-64  data

A conversation: the client's HELLO (its data is the magic word, its flags say what it wants to receive) is answered
by WELCOME or by REFUSED with a reason; then FRAMEs go both ways, and the hub may say OVERRUN.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag, unique
from typing import Final

VERSION: Final = 1
MAGIC: Final = b"cutgate-bus"
MAX_RECORD: Final = 1024
FD_LENGTHS: Final = frozenset((*range(9), 12, 16, 20, 24, 32, 48, 64))

_HEAD: Final = struct.Struct("<BBHIQB")
_MAX_STANDARD: Final = 0x7FF
_MAX_EXTENDED: Final = 0x1FFF_FFFF


class WireError(ValueError):
    """Bytes that are no record of this framing, or a frame that no CAN bus can carry."""


@unique
class HubKind(IntEnum):
    """What a record is."""

    HELLO = 1
    WELCOME = 2
    REFUSED = 3
    FRAME = 4
    OVERRUN = 5


class Flag(IntFlag):
    """Flags of a frame, and the two wishes of a HELLO (FD frames, own frames)."""

    EXTENDED = 0x01
    REMOTE = 0x02
    ERROR = 0x04
    FD = 0x08
    BIT_RATE_SWITCH = 0x10
    ERROR_STATE = 0x20
    OWN = 0x40


_ALL_FLAGS: Final = 0x7F


@dataclass(frozen=True, slots=True)
class HubRecord:
    """One datagram between hub and client."""

    kind: HubKind
    flags: int = 0
    number: int = 0
    time_ns: int = 0
    length: int = 0
    data: bytes = b""

    def pack(self) -> bytes:
        """The record's bytes."""
        return _HEAD.pack(VERSION, self.kind, self.flags, self.number, self.time_ns, self.length) + self.data


def hello(*, fd: bool, own: bool) -> HubRecord:
    """The record a client opens with."""
    flags = (Flag.FD if fd else 0) | (Flag.OWN if own else 0)
    return HubRecord(HubKind.HELLO, flags=int(flags), length=len(MAGIC), data=MAGIC)


def refused(reason: str) -> HubRecord:
    """The hub's refusal of a HELLO."""
    text = reason.encode()[:255]
    return HubRecord(HubKind.REFUSED, length=len(text), data=text)


def parse(raw: bytes) -> HubRecord:
    """Read one datagram.

    Raises:
        WireError: wrong size, version, kind, flags or length.
    """
    if not _HEAD.size <= len(raw) <= MAX_RECORD:
        raise WireError(f"record of {len(raw)} bytes, must be {_HEAD.size} to {MAX_RECORD}")
    version, kind, flags, number, time_ns, length = _HEAD.unpack_from(raw)
    if version != VERSION:
        raise WireError(f"framing version {version}, this side speaks {VERSION}")
    if kind not in HubKind._value2member_map_:
        raise WireError(f"unknown kind {kind} of record")
    if flags & ~_ALL_FLAGS:
        raise WireError(f"unknown flags 0x{flags:04x}")
    data = raw[_HEAD.size :]
    remote = kind == HubKind.FRAME and flags & Flag.REMOTE
    if len(data) != (0 if remote else length):
        raise WireError(f"record says {length} data bytes and brings {len(data)}")
    return HubRecord(HubKind(kind), flags, number, time_ns, length, data)


def check_frame(frame: HubRecord) -> None:
    """Refuse what no CAN bus can carry.

    Raises:
        WireError: identifier, length or combination of flags that no frame has.
    """
    flags = frame.flags
    highest = _MAX_EXTENDED if flags & (Flag.EXTENDED | Flag.ERROR) else _MAX_STANDARD
    if not 0 <= frame.number <= highest:
        raise WireError(f"identifier 0x{frame.number:x}, at most 0x{highest:x}")
    if flags & Flag.FD:
        if flags & (Flag.REMOTE | Flag.ERROR):
            raise WireError("an FD frame is neither a remote nor an error frame")
        if frame.length not in FD_LENGTHS:
            raise WireError(f"FD frame of {frame.length} data bytes; 0-8, 12, 16, 20, 24, 32, 48 or 64 exist")
    elif frame.length > 8:
        raise WireError(f"classic frame of {frame.length} data bytes, at most 8")
    elif flags & (Flag.BIT_RATE_SWITCH | Flag.ERROR_STATE):
        raise WireError("bit rate switch and error state exist in FD frames only")
