"""The frames of a session: from the raw frames beside its log where they are those of its close record, else from it.

A log without them, or with others beside it, holds its single frames alone: what its transfers were made of it does not
keep. A line of raw frames has no direction; the log's record of the same frame has, and follows in the same order.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import PurePath
from typing import BinaryIO, Final, Literal

from pydantic import ValidationError

from cutgate.protocol.candump import CLASSIC_BYTES, CandumpError, RawFrame, parse
from cutgate.protocol.frames import SENT_BY, TRANSFER_IDS
from cutgate.protocol.wire import Side
from cutgate.runtime.audit.container.raw import PIECE
from cutgate.runtime.audit.inspect import Log
from cutgate.runtime.audit.records import AuditClose, AuditOpen, CanFrame

Direction = Literal["received", "sent"]
"""As the runtime saw it."""

LINE_MAX: Final = 512
"""Bytes of a line; the longest frame takes half of it."""
TRANSFER_FRAMES: Final = frozenset(can_id for ids in TRANSFER_IDS.values() for can_id in ids.values())
_UNNAMED: Final = "can0"


@dataclass
class SessionFrames:
    """The frames of a log, read from its files when they are asked for.

    Attributes:
        log: the log as read; its file is open.
        raw: the raw frames beside it, open, or None where there are none.
        whole: the raw frames are those that the close record names.
        strange: records of frames that are none, so far.
    """

    log: Log
    raw: BinaryIO | None
    whole: bool = field(init=False)
    strange: int = 0

    def __post_init__(self) -> None:
        self.whole = self.raw is not None and _named(self.log, self.raw)

    @property
    def source(self) -> str:
        """Where the frames come from, in words."""
        if self.whole:
            return "the raw frames beside the log, whose SHA-256 its close record names"
        beside = (
            "are not beside it" if self.raw is None else "beside it are not those that its close record names"
        )
        return f"the single frames of the log itself, without those of transfers: raw frames {beside}"

    def each(self) -> Iterator[tuple[Direction, RawFrame]]:
        """Every frame with its direction, in order; from the start of the files each time."""
        self.strange = 0
        if not self.whole or self.raw is None:
            yield from self._recorded()
            return
        recorded = self._recorded()
        waiting = next(recorded, None)
        for text in lines(self.raw):
            frame = _frame(text)
            if frame is None:
                self.strange += 1
                continue
            if waiting is not None and _same(waiting[1], frame):
                yield waiting[0], frame
                waiting = next(recorded, None)
            else:
                yield direction_of(frame), frame

    def _recorded(self) -> Iterator[tuple[Direction, RawFrame]]:
        """The frames of the log itself."""
        interface = self.interface
        for _, data in self.log.each(CanFrame.TOPIC):
            found = self.recorded(data, interface)
            if found is not None:
                yield found

    def recorded(self, data: bytes, interface: str) -> tuple[Direction, RawFrame] | None:
        """The frame of a record of ``/can/frame``; None for one that is none, which is counted."""
        try:
            record = CanFrame.model_validate_json(data)
            content = bytes.fromhex(record.data)
            frame = RawFrame(
                record.stamp.nanoseconds,
                interface,
                record.id,
                b"" if record.is_rtr else content,
                is_extended=record.is_extended,
                is_remote=record.is_rtr,
                is_error=record.is_error,
                is_fd=len(content) > CLASSIC_BYTES,
            )
        except (ValidationError, ValueError):  # it is data
            self.strange += 1
            return None
        return record.direction, frame

    @property
    def interface(self) -> str:
        """The bus's name, by the option of record 0."""
        for opened in self.log.of(AuditOpen.TOPIC)[:1]:
            options = opened.get("simulation")
            for option in options if isinstance(options, list) else ():
                if isinstance(option, dict) and option.get("name") == "bus":
                    name = PurePath(str(option.get("value"))).name
                    if name.isascii() and name.isprintable() and " " not in name and 0 < len(name) <= 64:
                        return name
        return _UNNAMED


def lines(file: BinaryIO, end: int | None = None) -> Iterator[bytes]:
    """The lines of a file, from its start, each with its end; of one that is longer than any frame its beginning.

    Args:
        file: seekable.
        end: so many bytes are read at most.
    """
    left = file.seek(0, 2) if end is None else end
    file.seek(0)
    while left > 0 and (text := file.readline(min(LINE_MAX, left))):
        left -= len(text)
        yield text
        while left > 0 and not text.endswith(b"\n") and (text := file.readline(min(LINE_MAX, left))):
            left -= len(text)  # the rest of a line that is too long


def direction_of(frame: RawFrame) -> Direction:
    """As a frame of this identifier goes, in a session with nobody else on the bus."""
    ours = frame.can_id in SENT_BY[Side.RUNTIME]
    return "sent" if ours and not (frame.is_extended or frame.is_error) else "received"


def _frame(text: bytes) -> RawFrame | None:
    try:
        return parse(text.decode("utf-8"))
    except (CandumpError, UnicodeDecodeError):
        return None


def _same(recorded: RawFrame, raw: RawFrame) -> bool:
    """Whether a record of the log is of this frame; a line has whole microseconds."""
    return (recorded.can_id, recorded.data, recorded.time_ns // 1000) == (
        raw.can_id,
        raw.data,
        raw.time_ns // 1000,
    )


def _named(log: Log, raw: BinaryIO) -> bool:
    """Whether the close record names these raw frames."""
    closed = log.of(AuditClose.TOPIC)[-1:]
    if not closed:
        return False
    digest = sha256()
    raw.seek(0)
    while data := raw.read(PIECE):
        digest.update(data)
    return digest.hexdigest() == closed[0].get("candump_sha256")
