"""What hub and client say to each other: fixed binary records in datagrams.

    offset  size  field
    0       1     version of this framing, 2
    1       1     kind
    2       2     flags, little-endian like all that follows
    4       4     CAN identifier; in OVERRUN the number of frames lost, in WELCOME the frames that the transmit queue
                  holds (0: it is not paced), in STATUS, INJECT and TEXT the size of the text
    8       8     time of the frame on the bus, ns since the epoch; stamped by the hub, 0 from a client
    16      1     DLC field of a remote frame, else the number of data bytes
    17      0-64  data

A conversation: the client's HELLO (its data is the magic word, its flags say what it wants to receive) is answered
by WELCOME or by REFUSED with a reason; then FRAMEs go both ways, several in one datagram where several wait, and the
hub may say OVERRUN. With the WELCOME of a paced bus comes a descriptor, an eventfd that counts the room in the client's
transmit queue: a client takes one for each frame, the hub puts one back for each that has left.

Whoever says STAT or INJECT instead of HELLO takes no part: it is answered by STATUS or TEXT, and closed.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag, unique
from typing import Final, NamedTuple

from cutgate.firmware_sim.bus import frame as frames
from cutgate.firmware_sim.bus.frame import ALL_FLAGS, BusFrame, BusFrameError, Flag

VERSION: Final = 2
MAGIC: Final = b"cutgate-bus"
MAX_DATAGRAM: Final = 8192
"""About a hundred FD frames."""
MAX_TEXT: Final = 128 * 1024

_HEAD: Final = struct.Struct("<BBHIQB")
_TIME: Final = struct.Struct("<Q")
_TIME_AT: Final = 8


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
    STAT = 6
    STATUS = 7
    INJECT = 8
    TEXT = 9


class Wish(IntFlag):
    """Flags of a HELLO."""

    FD = 0x08
    OWN = 0x40


_FRAME: Final = int(HubKind.FRAME)
_REMOTE: Final = int(Flag.REMOTE)
_FD: Final = int(Flag.FD)
_OWN: Final = int(Flag.OWN)
_TEXTS: Final = frozenset({HubKind.STATUS, HubKind.INJECT, HubKind.TEXT})
_KINDS: Final = {int(kind): kind for kind in HubKind}


@dataclass(frozen=True, slots=True)
class HubRecord:
    """One record between hub and client."""

    kind: HubKind
    flags: int = 0
    number: int = 0
    time_ns: int = 0
    length: int = 0
    data: bytes = b""

    def pack(self) -> bytes:
        """The record's bytes."""
        return _HEAD.pack(VERSION, self.kind, self.flags, self.number, self.time_ns, self.length) + self.data

    @property
    def frame(self) -> BusFrame:
        """The frame that a FRAME holds."""
        return BusFrame(self.number, self.flags, self.length, self.data)


def hello(*, fd: bool, own: bool) -> HubRecord:
    """The record a client opens with."""
    flags = (Wish.FD if fd else 0) | (Wish.OWN if own else 0)
    return HubRecord(HubKind.HELLO, flags=int(flags), length=len(MAGIC), data=MAGIC)


def refused(reason: str) -> HubRecord:
    """The hub's refusal of a HELLO."""
    words = reason.encode()[:255]
    return HubRecord(HubKind.REFUSED, length=len(words), data=words)


def text(kind: HubKind, content: str) -> HubRecord:
    """A record of a kind that holds a text."""
    data = content.encode()
    return HubRecord(kind, number=len(data), data=data)


def of_frame(frame: BusFrame, time_ns: int = 0) -> bytes:
    """A FRAME record's bytes."""
    head = _HEAD.pack(VERSION, _FRAME, frame.flags, frame.number, time_ns, frame.length)
    return head + frame.data


def parse(raw: bytes) -> HubRecord:
    """Read one datagram of one record.

    Raises:
        WireError: wrong size, version, kind, flags or length.
    """
    record, end = _read(raw, 0)
    if end != len(raw):
        raise WireError(f"{len(raw) - end} bytes behind a record of {record.kind.name}")
    return record


def parse_all(raw: bytes) -> list[HubRecord]:
    """Read one datagram: one record, or several FRAMEs.

    Raises:
        WireError: see ``parse``; or several of which one is no FRAME.
    """
    record, at = _read(raw, 0)
    records = [record]
    while at < len(raw):
        record, at = _read(raw, at)
        records.append(record)
    if len(records) > 1 and any(each.kind is not HubKind.FRAME for each in records):
        raise WireError("several records in one datagram must all be frames")
    return records


def _read(raw: bytes, at: int) -> tuple[HubRecord, int]:
    """The record at a place, and where it ends."""
    if len(raw) - at < _HEAD.size:
        raise WireError(f"record of {len(raw) - at} bytes, must be at least {_HEAD.size}")
    version, kind_number, flags, number, time_ns, length = _HEAD.unpack_from(raw, at)
    if version != VERSION:
        raise WireError(f"framing version {version}, this side speaks {VERSION}")
    kind = _KINDS.get(kind_number)
    if kind is None:
        raise WireError(f"unknown kind {kind_number} of record")
    if flags & ~ALL_FLAGS:
        raise WireError(f"unknown flags 0x{flags:04x}")
    size = number if kind in _TEXTS else 0 if kind is HubKind.FRAME and flags & _REMOTE else length
    start = at + _HEAD.size
    data = raw[start : start + size]
    if len(data) != size or size > MAX_TEXT:
        raise WireError(f"record says {size} data bytes and brings {len(data)}")
    return HubRecord(kind, flags, number, time_ns, length, data), start + size


class Stamped(NamedTuple):
    """Frames of one datagram, checked, with the hub's time.

    Attributes:
        raw: all of them.
        frames: how many.
        fd: how many of them are FD frames.
    """

    raw: bytes
    frames: int
    fd: int


def stamp(raw: bytes, time_ns: int) -> Stamped:
    """Check the frames that a client has sent in one datagram, and put the hub's time into each.

    Raises:
        WireError: anything else than FRAMEs that a CAN bus can carry, or a flag that is the hub's to set.
    """
    out, at, count, fd, size = bytearray(raw), 0, 0, 0, len(raw)
    head, time = _HEAD.size, _TIME.pack(time_ns)
    while at < size:
        if size - at < head:
            raise WireError(f"record of {size - at} bytes, must be at least {head}")
        version, kind, flags, number, _, length = _HEAD.unpack_from(raw, at)
        if version != VERSION or kind != _FRAME or flags & ~ALL_FLAGS:
            _refuse(raw, at)
        if flags or number > frames.STANDARD_MAX or length > 8:
            _check(number, flags, length)
            fd += bool(flags & _FD)
        out[at + _TIME_AT : at + _TIME_AT + 8] = time
        at += head + (0 if flags & _REMOTE else length)
        count += 1
    if at > size:
        raise WireError(f"the last of {count} records brings {at - size} data bytes too few")
    return Stamped(bytes(out), count, fd)


def _refuse(raw: bytes, at: int) -> None:
    record, _ = _read(raw, at)
    raise WireError(f"{record.kind.name} is out of place")


def _check(number: int, flags: int, length: int) -> None:
    try:
        frames.check(number, flags, length)
    except BusFrameError as error:
        raise WireError(str(error)) from error
    if flags & _OWN:
        raise WireError("flag OWN is the hub's to set")


def own_copies(raw: bytes) -> bytes:
    """The same frames as their sender gets them back."""
    return b"".join(
        of_frame(record.frame._replace(flags=record.flags | _OWN), record.time_ns)
        for record in parse_all(raw)
    )


def without_fd(raw: bytes) -> bytes:
    """The classic frames among them."""
    return b"".join(record.pack() for record in parse_all(raw) if not record.flags & _FD)
