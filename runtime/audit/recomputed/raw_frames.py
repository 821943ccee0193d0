"""The raw frames beside a log, read along with it: each frame that the log has too, and whole records between them.

    raw = RawFrames(file, take=...)
    while (frame := raw.next()) is not None:
        ...  # what /can/frame must hold next; before it, take() was given each control record that was whole by then

What is in memory is a line, and the two records of the control channel that are being put together. Whoever reads along
answers nobody: a record that either side gave up may be whole here.
"""

from collections.abc import Callable
from typing import BinaryIO, Final, NamedTuple

from cutgate.protocol.candump import CandumpError, RawFrame, parse
from cutgate.protocol.frames import BULK_IDS, CONTROL_IDS, TRANSFER_IDS
from cutgate.protocol.transfer import Transfer
from cutgate.protocol.wire import Channel, Side
from cutgate.runtime.audit.records import CanFrame

_TRANSFERS: Final = frozenset((*CONTROL_IDS, *BULK_IDS))
_FLOW_CONTROL: Final = 0x3
_IDENTIFIER: Final = (1 << 29) - 1


LINE_BYTES_MAX: Final = 4096
"""Of a line: a frame takes under 300."""


class WholeRecord(NamedTuple):
    """A record of the control channel, as it was put together again: who sends there, and where its last frame stands."""

    side: Side
    payload: bytes
    line: int
    time_us: int


class RawFrames:
    """One file of raw frames, from its beginning.

    Args:
        file: the candump file, seekable.
        take: is given each whole record of the control channel.

    Attributes:
        line: of the frame that was read last, from 1 on.
        broken: what is no frame, and where; nothing is read behind it. Empty where there is none.
    """

    def __init__(self, file: BinaryIO, take: Callable[[WholeRecord], None]) -> None:
        file.seek(0)
        self._file = file
        self._take = take
        self._channels = {
            TRANSFER_IDS[side][Channel.CONTROL]: (
                side,
                Transfer(TRANSFER_IDS[side.peer][Channel.CONTROL], TRANSFER_IDS[side][Channel.CONTROL]),
            )
            for side in Side
        }
        self.line = 0
        self.broken = ""

    def next(self) -> RawFrame | None:
        """The next frame that the log holds as well; None at the end, and where a line is no frame.

        Raises:
            OSError: the file cannot be read.
        """
        while not self.broken and (text := self._file.readline(LINE_BYTES_MAX)):
            self.line += 1
            try:
                frame = _frame(text)
            except CandumpError as error:
                self.broken = f"line {self.line} of the raw frames: {error}"
                break
            if frame.is_extended or frame.is_error or frame.can_id not in _TRANSFERS:
                return frame
            if frame.can_id in self._channels and not frame.is_remote:
                self._feed(frame)
        return None

    def _feed(self, frame: RawFrame) -> None:
        side, transfer = self._channels[frame.can_id]
        if frame.is_fd or not frame.data or frame.data[0] >> 4 == _FLOW_CONTROL:
            return
        transfer.feed(frame.data)
        transfer.outgoing()
        transfer.errors()
        for payload in transfer.received():
            self._take(WholeRecord(side, payload, self.line, frame.time_us))


def _frame(text: bytes) -> RawFrame:
    """The frame of one line, its end included."""
    if not text.endswith(b"\n"):
        raise CandumpError("its end is missing")
    return parse(text.decode("utf-8", "surrogateescape"))


def is_logged(frame: RawFrame, record: CanFrame) -> bool:
    """Whether a record of the log is of this frame: when, which, and what it says."""
    return (
        frame.time_us == record.stamp.nanoseconds // 1000
        and frame.can_id == record.id & _IDENTIFIER
        and frame.data.hex() == record.data
        and frame.is_error == record.is_error
        and (frame.is_error or (frame.is_extended, frame.is_remote) == (record.is_extended, record.is_rtr))
    )
