"""The envelope of every reassembled record, and all records by name.

`type u8 | reserved u8 = 0 | length u16 of body | session u32 | sequence u32 | body | crc32 u32 over all before`,
little endian, at most 4095 bytes.

:func:`pack` before a record is given to its channel's transfer, :func:`unpack` after a transfer has brought one whole.
Who unpacks says from whom and on which channel it came, and then looks at session and sequence, which are right only
in a conversation (``endpoint.Endpoint`` does)::

    >>> envelope = pack(Collect(), session=7, sequence=1)
    >>> envelope.hex(" ", 4)
    '04000000 07000000 01000000 6c93aaca'
    >>> found = unpack(envelope, sender=Side.RUNTIME, channel=Channel.CONTROL)
    >>> found.record, found.session, found.sequence
    (Collect(), 7, 1)
    >>> unpack(envelope, sender=Side.CONTROLLER)
    Traceback (most recent call last):
    cutgate.protocol.wire.RecordError: Collect is never sent by the controller
    >>> pack(Collect(), session=0, sequence=1)
    Traceback (most recent call last):
    cutgate.protocol.wire.RecordError: Collect must not be sent outside a session
"""

import struct
import zlib
from dataclasses import dataclass

from cutgate.protocol.conversation import (
    AGE_UNKNOWN,
    NO_MAC,
    NO_PLACE,
    NO_TIME,
    NO_TREE_HEAD,
    PLANT_SPEED_PERMILLE_MAX,
    PROTOCOL_VERSION,
    Acknowledge,
    Announce,
    Approach,
    BlockStored,
    Branch,
    Collect,
    Nonce,
    NonceRequest,
    Open,
    Opened,
    OtherVersion,
    PathStored,
    Permit,
    Reply,
    Reset,
    SignedRecord,
    Start,
    Timing,
    TreeHead,
    Withdraw,
    opens,
    session_digest,
    session_tag,
)
from cutgate.protocol.parameters import UNIT, Calibration, Limits, Tool, joints_to_counts, joints_to_memory
from cutgate.protocol.path import (
    BLOCK_BYTES,
    PATH_BYTES_MAX,
    POSES_MAX,
    Assembly,
    Elbow,
    Path,
    PathBlock,
    PathCodes,
    block_of_pose,
    path_block,
    split,
)
from cutgate.protocol.wire import Channel, Record, RecordError, Side, digest

__all__ = [
    "AGE_UNKNOWN",
    "BLOCK_BYTES",
    "ENVELOPE_BYTES_MAX",
    "NO_MAC",
    "NO_PLACE",
    "NO_TIME",
    "NO_TREE_HEAD",
    "PATH_BYTES_MAX",
    "PLANT_SPEED_PERMILLE_MAX",
    "POSES_MAX",
    "PROTOCOL_VERSION",
    "RECORDS",
    "UNIT",
    "Acknowledge",
    "Announce",
    "Approach",
    "Assembly",
    "BlockStored",
    "Branch",
    "Calibration",
    "Channel",
    "Collect",
    "Elbow",
    "Envelope",
    "Limits",
    "Nonce",
    "NonceRequest",
    "Open",
    "Opened",
    "OtherVersion",
    "Path",
    "PathBlock",
    "PathCodes",
    "PathStored",
    "Permit",
    "Record",
    "RecordError",
    "Reply",
    "Reset",
    "Side",
    "SignedRecord",
    "Start",
    "Timing",
    "Tool",
    "TreeHead",
    "Withdraw",
    "block_of_pose",
    "digest",
    "joints_to_counts",
    "joints_to_memory",
    "opens",
    "pack",
    "path_block",
    "session_digest",
    "session_tag",
    "split",
    "unpack",
]

ENVELOPE_BYTES_MAX = 4095
_HEAD = struct.Struct("<BBHII")
_CRC = struct.Struct("<I")

RECORDS: dict[int, type[Record]] = {
    kind.TYPE: kind
    for kind in (
        Announce,
        Open,
        Opened,
        Collect,
        NonceRequest,
        Nonce,
        Permit,
        Start,
        Reset,
        Acknowledge,
        Withdraw,
        Reply,
        Limits,
        Calibration,
        Tool,
        PathBlock,
        BlockStored,
        PathStored,
    )
}
"""Every record by its type; any other type is refused."""
_VERSIONED = (Announce, Open)
"""Their first field is the protocol version; it is read before the rest, which another version may lay out otherwise."""


@dataclass(frozen=True)
class Envelope:
    """A record that has passed every check of its envelope.

    Attributes:
        type: the record's type.
        session: the session's tag, 0 outside one.
        sequence: the sender's running number, per channel.
        record: what was sent.
    """

    type: int
    session: int
    sequence: int
    record: Record


def _refuse_wrong_session(kind: type[Record], session: int) -> None:
    if not (kind.OUTSIDE_SESSION if session == 0 else kind.INSIDE_SESSION):
        raise RecordError(
            f"{kind.__name__} must not be sent {'outside a' if session == 0 else 'inside a'} session"
        )


def pack(record: Record, session: int, sequence: int) -> bytes:
    """The envelope of a record.

    Args:
        record: what to send.
        session: the session's tag; 0 outside a session.
        sequence: the sender's running number on this channel.

    Raises:
        RecordError: the record does not belong in or outside a session, or a number does not fit 32 bits.
    """
    _refuse_wrong_session(type(record), session)
    for name, value in (("session", session), ("sequence", sequence)):
        if not 0 <= value < 1 << 32:
            raise RecordError(f"{name} is {value}, must be in 0..4294967295")
    body = record.body()
    head = _HEAD.pack(record.TYPE, 0, len(body), session, sequence)
    return head + body + _CRC.pack(zlib.crc32(head + body))


def unpack(data: bytes, *, sender: Side | None = None, channel: Channel | None = None) -> Envelope:
    """The record in these bytes.

    Args:
        data: one reassembled transfer.
        sender: where given, a record that this side never sends is refused.
        channel: where given, a record that does not belong on this channel is refused.

    Raises:
        RecordError: anything is wrong; the only exception for any bytes whatever.
    """
    least = _HEAD.size + _CRC.size
    if not least <= len(data) <= ENVELOPE_BYTES_MAX:
        raise RecordError(f"record is {len(data)} bytes, must be {least}..{ENVELOPE_BYTES_MAX}")
    (crc,) = _CRC.unpack(data[-_CRC.size :])
    if crc != zlib.crc32(data[: -_CRC.size]):
        raise RecordError("record CRC-32 does not match")
    code, reserved, length, session, sequence = _HEAD.unpack(data[: _HEAD.size])
    if reserved != 0:
        raise RecordError(f"record reserved byte is {reserved:#04x}, must be 0")
    if length != len(data) - least:
        raise RecordError(f"record length says {length}, body is {len(data) - least} bytes")
    if code not in RECORDS:
        raise RecordError(f"record type {code:#04x} is not known")
    kind = RECORDS[code]
    if sender is not None and kind.SENDER is not sender:
        raise RecordError(f"{kind.__name__} is never sent by the {sender.name.lower()}")
    if channel is not None and kind.CHANNEL is not channel:
        raise RecordError(f"{kind.__name__} does not belong on the {channel.name.lower()} channel")
    _refuse_wrong_session(kind, session)
    return Envelope(code, session, sequence, _parsed(kind, data[_HEAD.size : -_CRC.size]))


def _parsed(kind: type[Record], body: bytes) -> Record:
    version = int.from_bytes(body[:2], "little")
    if kind in _VERSIONED and len(body) >= 2 and version != PROTOCOL_VERSION:
        return OtherVersion(kind.TYPE, version)
    return kind.parse(body)
