"""What was said on a bus, message by message, out of its frames: for people, nothing is decided by it. Pure.

    decoding = Decoding()
    for frame in frames:
        for heard in decoding.take(frame):
            ...
    decoding.end()

Single frames are read by the DBC, the segments of a transfer are put together as both sides put them together
(``protocol.transfer``), and the record by its layout. What is wrong with a message is told in place. Codes and tags of
the key are shown and not checked: that takes the key.

What is kept is bounded: of each bus a record half received for each of four identifiers, the counters of eight, and
the tags of the last sessions.
"""

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final

from cutgate.protocol.candump import RawFrame
from cutgate.protocol.e2e import COUNTER_MODULUS, FRAME_BYTES, GAP_MAX, intact
from cutgate.protocol.frames import DATA_IDS, FRAMES, TRANSFER_IDS, FrameError, decode_frame
from cutgate.protocol.link import NO_SESSION
from cutgate.protocol.path import BLOCK_BYTES, HEADER_BYTES, POSE_BYTES
from cutgate.protocol.records import (
    RECORDS,
    Open,
    OtherVersion,
    PathBlock,
    Record,
    RecordError,
    session_digest,
    session_tag,
    unpack,
)
from cutgate.protocol.transfer import Transfer
from cutgate.protocol.wire import Channel, Side
from cutgate.runtime.review.recorded_frames import Direction
from cutgate.runtime.review.wording import Field, fields_of_frame, fields_of_record

NANOSECONDS: Final = 1_000_000_000
SESSIONS_KEPT: Final = 4
"""Tags of sessions that a frame may belong to."""
UNKNOWN: Final = "unknown"
BUS_ERROR: Final = "bus error"
_SENDERS: Final = {
    can_id: (side, channel) for side, ids in TRANSFER_IDS.items() for channel, can_id in ids.items()
}
_SINGLE, _FIRST, _CONSECUTIVE, _FLOW_CONTROL = range(4)
"""Kinds of segments, by their first half byte."""
_CONTINUE: Final = 0x30
NAMES: Final = frozenset(kind.__name__ for kind in (*FRAMES.values(), *RECORDS.values(), OtherVersion))
"""Of all messages."""
_ON: Final = {
    can_id: frozenset(kind.__name__ for kind in RECORDS.values() if place == (kind.SENDER, kind.CHANNEL))
    for can_id, place in _SENDERS.items()
}
"""The records that come on a transfer's identifier."""
_REQUEST_TYPES: Final = {code: kind.__name__ for code, kind in RECORDS.items()}


@dataclass(frozen=True)
class DecodedMessage:
    """One message, or what is to be told of what is none.

    Attributes:
        time_ns: of its last frame, since 1970 UTC.
        interface: the bus.
        can_id: of its frames.
        sender: runtime, controller or unknown: who alone may send on this identifier. Anybody on the bus can.
        name: of the message; ``unknown``, ``bus error``, or empty for a record that was lost.
        fields: what it says.
        notes: what is wrong with it, or around it.
        may_be: names of the messages it is, or may have been.
        segments: frames of a record; 0 of a single frame.
        began_ns: time of its first frame.
        numbers: of a record its session's tag and its running number.
    """

    time_ns: int
    interface: str
    can_id: int
    sender: str
    name: str
    fields: tuple[Field, ...] = ()
    notes: tuple[str, ...] = ()
    may_be: frozenset[str] = frozenset()
    segments: int = 0
    began_ns: int = 0
    numbers: tuple[int, int] | None = None


class Decoding:
    """The frames of any number of buses, one after the other.

    Attributes:
        counts: frames, messages, segments, records, unknown, flow controls, unchecked, stray segments.
    """

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._buses: dict[str, _Bus] = {}

    def take(self, frame: RawFrame, direction: Direction | None = None) -> tuple[DecodedMessage, ...]:
        """What the next frame completes.

        Args:
            frame: as it was recorded.
            direction: as the runtime saw it, where that is known.
        """
        if frame.interface not in self._buses:
            self._buses[frame.interface] = _Bus(frame.interface, self.counts)
        self.counts["frames"] += 1
        heard = tuple(self._buses[frame.interface].take(frame, direction))
        self.counts["with remarks"] += sum(bool(one.notes) for one in heard)
        return heard

    def end(self) -> tuple[DecodedMessage, ...]:
        """Nothing more comes: what was left half said."""
        return tuple(one for bus in self._buses.values() for one in bus.end())


@dataclass
class _Bus:
    """What is remembered of one bus."""

    interface: str
    counts: Counter[str]
    tags: deque[int] = field(default_factory=lambda: deque(maxlen=SESSIONS_KEPT))
    last: dict[int, tuple[int | None, bytes]] = field(default_factory=dict)
    """Of each single frame the session's tag and the bytes."""
    receptions: dict[tuple[int, bool], "_Reception"] = field(default_factory=dict)
    numbers: dict[int, tuple[int, int]] = field(default_factory=dict)
    """Of each transfer's identifier session and number of the last record."""

    def take(self, frame: RawFrame, direction: Direction | None) -> Iterator[DecodedMessage]:
        plain = not (frame.is_extended or frame.is_error or frame.is_remote)
        if frame.is_error:
            self.counts["unknown"] += 1
            yield self._heard(frame, UNKNOWN, BUS_ERROR, fields=_bytes_of(frame, class_of=True))
        elif plain and frame.can_id in _SENDERS:
            yield from self._segment(frame, direction)
        elif plain and not frame.is_fd and frame.can_id in FRAMES:
            yield self._single(frame, direction)
        else:
            self.counts["unknown"] += 1
            yield self._heard(frame, UNKNOWN, UNKNOWN, fields=_bytes_of(frame))

    def end(self) -> Iterator[DecodedMessage]:
        for (can_id, _), reception in self.receptions.items():
            if reception.transfer.receiving:
                note = f"the frames end in the middle of a record, after {reception.segments} of its segments"
                frame = RawFrame(reception.seen_ns, self.interface, can_id)
                yield self._heard(
                    frame, _sender(can_id), "", notes=(note,), may_be=_ON[can_id],
                    segments=reception.segments, began_ns=reception.began_ns,
                )  # fmt: skip

    def _heard(self, frame: RawFrame, sender: str, name: str, **more: Any) -> DecodedMessage:
        self.counts["messages"] += bool(name)
        return DecodedMessage(frame.time_ns, self.interface, frame.can_id, sender, name, **more)

    # ------------------------------------------------------------ single frames

    def _single(self, frame: RawFrame, direction: Direction | None) -> DecodedMessage:
        kind = FRAMES[frame.can_id]
        notes = [*_second_node(kind.SENDER, direction)]
        try:
            fields = fields_of_frame(decode_frame(frame.can_id, frame.data), frame.data)
        except FrameError as error:
            fields, notes = _bytes_of(frame), [*notes, str(error)]
        if len(frame.data) == FRAME_BYTES:
            notes += self._protection(frame)
        return self._heard(
            frame, _side(kind.SENDER), kind.__name__, fields=fields, notes=tuple(notes), may_be=frozenset({kind.__name__})
        )  # fmt: skip

    def _protection(self, frame: RawFrame) -> Iterator[str]:
        """What CRC and counter say."""
        data_id = DATA_IDS[frame.can_id]
        tags = (*reversed(self.tags), NO_SESSION)
        tag = next((one for one in tags if intact(frame.data, data_id, one)), None)
        if tag is None and self.tags:
            yield "CRC WRONG: damaged, or of a session that was not seen to open"
            return
        self.counts["unchecked"] += tag is None
        before = self.last.get(frame.can_id)
        self.last[frame.can_id] = (tag, frame.data)
        if before is not None and before[0] == tag:
            yield from _sequence(before[1], frame.data)

    # ------------------------------------------------------------ records

    def _segment(self, frame: RawFrame, direction: Direction | None) -> Iterator[DecodedMessage]:
        """A segment of a transfer, and the record that it completes."""
        self.counts["segments"] += 1
        side, _ = _SENDERS[frame.can_id]
        kind = frame.data[0] >> 4 if frame.data else None
        if kind == _FLOW_CONTROL:
            self.counts["flow controls"] += 1
            if frame.data[0] != _CONTINUE:
                wants = {1: "wait", 2: "too long for me"}.get(frame.data[0] & 0xF, "nothing that is known")
                note = f"flow control: {wants}"
                yield self._heard(
                    frame, _side(side), "", fields=_bytes_of(frame), notes=(note,), may_be=_ON[frame.can_id]
                )
            return
        reception = self._reception(frame.can_id, fd=frame.is_fd)
        notes = (*_second_node(side, direction), *reception.take(frame, kind))
        self.counts["stray segments"] += reception.stray
        whole = reception.transfer.received()
        for payload in whole:
            self.counts["records"] += 1
            yield self._record(frame, payload, reception, notes)
        if notes and not whole:
            yield self._heard(
                frame, _side(side), "", notes=notes, may_be=_ON[frame.can_id],
                segments=reception.segments, began_ns=reception.began_ns,
            )  # fmt: skip

    def _reception(self, can_id: int, *, fd: bool) -> "_Reception":
        if (can_id, fd) not in self.receptions:  # costly to make, and asked for with each segment
            self.receptions[can_id, fd] = _Reception(can_id, fd=fd)
        return self.receptions[can_id, fd]

    def _record(
        self, frame: RawFrame, payload: bytes, reception: "_Reception", notes: tuple[str, ...]
    ) -> DecodedMessage:
        side, channel = _SENDERS[frame.can_id]
        more: dict[str, Any] = {"segments": reception.segments, "began_ns": reception.began_ns}
        try:
            found = unpack(payload, sender=side, channel=channel)
        except RecordError as error:
            self.numbers.pop(frame.can_id, None)  # whether it is the next one nobody knows
            data = (Field("data", payload.hex()),)
            return self._heard(
                frame, _side(side), UNKNOWN, fields=data, notes=(*notes, str(error)), may_be=_ON[frame.can_id], **more
            )  # fmt: skip
        record, name = found.record, type(found.record).__name__
        self._remember(found.session, record)
        notes = (*notes, *self._running(frame.can_id, found.session, found.sequence), *_path_notes(record))
        return self._heard(
            frame, _side(side), name, fields=tuple(_fields(record)), notes=notes, may_be=frozenset({name}),
            numbers=(found.session, found.sequence), **more,
        )  # fmt: skip

    def _remember(self, session: int, record: Record) -> None:
        """The tags that single frames may carry from here on."""
        for tag in (session, session_tag(session_digest(record)) if isinstance(record, Open) else NO_SESSION):
            if tag != NO_SESSION and tag not in self.tags:
                self.tags.append(tag)

    def _running(self, can_id: int, session: int, number: int) -> Iterator[str]:
        """Whether the record follows the one before it on its channel."""
        before = self.numbers.get(can_id)
        self.numbers[can_id] = (session, number)
        if before is None or before[0] != session or number == before[1] + 1:
            return
        last = before[1]
        if number == last:
            yield f"record {number} again"
        elif number > last:
            missing = number - last - 1
            yield f"{missing} record{'s' * (missing > 1)} lost before it: {number} comes after {last}"
        else:
            yield f"out of sequence: record {number} comes after {last}"


class _Reception:
    """The records that come on one identifier, in classic or in FD frames.

    Attributes:
        transfer: puts the segments together.
        segments: of the record that comes in, or came in last.
        began_ns, seen_ns: time of its first segment, and of its last so far.
        stray: whether the last segment belongs to nothing, and that was told already.
    """

    def __init__(self, can_id: int, *, fd: bool) -> None:
        side, channel = _SENDERS[can_id]
        self.transfer = Transfer(TRANSFER_IDS[side.peer][channel], can_id, fd=fd)
        self.segments = 0
        self.began_ns = self.seen_ns = 0
        self.stray = False
        self._lost = False
        """Whether what comes until the next record begins belongs to nothing."""

    def take(self, frame: RawFrame, kind: int | None) -> tuple[str, ...]:
        """The next segment; what is to be told of it."""
        begins = kind in (_SINGLE, _FIRST)
        before = self.segments
        was_receiving = self.transfer.receiving
        if begins:
            self.segments, self.began_ns = 0, frame.time_ns
        self.segments += 1
        self.seen_ns = frame.time_ns
        self.transfer.feed(frame.data)
        self.transfer.outgoing()  # flow controls: the other side has sent its own
        errors = self.transfer.errors()
        self.stray = self._lost and not begins and bool(errors)
        if self.stray:
            return ()
        self._lost = bool(errors) and not self.transfer.receiving
        if begins and was_receiving and errors:
            return (f"record lost: another one begins after {before} of its segments",)
        return tuple(
            f"{'record lost' if error.lost else 'segment ignored'}: {error.reason}" for error in errors
        )


def _sequence(before: bytes, data: bytes) -> Iterator[str]:
    """What the counters of two frames that follow each other say."""
    last, counter = before[2], data[2]
    step = (counter - last) % COUNTER_MODULUS
    if step == 0:
        yield "repeated" if data == before else f"another frame under the same counter {counter}"
    elif step > GAP_MAX:
        yield f"out of sequence: counter {counter} comes after {last}"
    elif step > 1:
        yield f"{step - 1} lost before it"


def _fields(record: Record) -> Iterator[Field]:
    """A record's fields, and what of them is told in other words."""
    for one in fields_of_record(record):
        yield one
        if one.name == "request_type":
            yield Field("request", _REQUEST_TYPES.get(int(one.value), UNKNOWN))
    if isinstance(record, PathBlock):
        begin = max(0, record.offset - HEADER_BYTES) // POSE_BYTES
        end = (min(record.offset + BLOCK_BYTES, record.total) - HEADER_BYTES) // POSE_BYTES
        yield Field("poses", f"{begin}..{end - 1}")


def _path_notes(record: Record) -> Iterator[str]:
    """What is wrong with the poses of a block."""
    if isinstance(record, PathBlock):
        try:
            record.decoded()
        except RecordError as error:
            yield str(error)


def _second_node(sender: Side, direction: Direction | None) -> Iterator[str]:
    if direction is not None and (direction == "sent") != (sender is Side.RUNTIME):
        yield f"{direction} by the runtime of this log: somebody else speaks in the name of the {_side(sender)}"


def _bytes_of(frame: RawFrame, *, class_of: bool = False) -> tuple[Field, ...]:
    """What a frame is that nothing more is known of."""
    kinds = [
        text
        for text, holds in (
            ("extended", frame.is_extended),
            ("FD", frame.is_fd),
            ("bit rate switch", frame.bit_rate_switch),
            ("error passive", frame.error_state),
        )
        if holds
    ]
    found = [Field("class", f"{frame.can_id:#x}")] if class_of else []
    if kinds:
        found.append(Field("kind", " ".join(kinds)))
    if frame.is_remote:
        return (*found, Field("remote", frame.remote_length))
    return (*found, Field("data", frame.data.hex()))


def _sender(can_id: int) -> str:
    return _side(_SENDERS[can_id][0])


def _side(side: Side) -> str:
    return side.name.lower()


def transfer_of(record: dict[str, Any], time_ns: int, interface: str) -> DecodedMessage:
    """A transfer as the log itself tells it: of which record, how long, and its digest.

    Args:
        record: of ``/can/transfer``, as it is.
        time_ns: of its message.
        interface: the bus.
    """
    side = Side.RUNTIME if record.get("direction") == "sent" else Side.CONTROLLER
    channel = Channel.BULK if record.get("channel") == "bulk" else Channel.CONTROL
    name = str(record.get("record"))
    told = tuple(Field(key, str(record.get(key))) for key in ("length", "sha256"))
    note = "its fields are in the raw frames alone"
    return DecodedMessage(
        time_ns, interface, TRANSFER_IDS[side][channel], _side(side), name, told, (note,), frozenset({name}),
        began_ns=time_ns,
    )  # fmt: skip
