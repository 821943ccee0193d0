"""Writes the annotated session of docs/controllers.md from a run against the simulated controller, in virtual time.

``python docs/make_session.py`` rewrites the table between the two marks; random numbers are the same in every run.
"""

import sys
import tempfile
from dataclasses import dataclass, field, fields
from enum import IntEnum
from pathlib import Path
from typing import Final

sys.path.insert(0, str(Path(__file__).parents[1]))

from protocol import records
from protocol.frames import FRAMES, ControllerHeartbeat, Frame, RuntimeHeartbeat, decode_frame
from protocol.records import Record
from protocol.states import StopCause, StopCode
from runtime.conform.bench import Seen
from tests.runtime.conform.rig import Rig

PAGE: Final = Path(__file__).with_name("controllers.md")
BEGIN, END = "<!-- session: docs/make_session.py -->", "<!-- end of session -->"
CYCLIC_SHOWN: Final = 1
"""Cyclic frames repeat; so many of each kind and content are shown."""


@dataclass
class Reading:
    """Frames to rows; transfers are put together, so that their last frame says what was sent."""

    begun_s: float
    rows: list[str] = field(default_factory=list)
    _parts: dict[int, bytearray] = field(default_factory=dict)
    _left: dict[int, int] = field(default_factory=dict)
    _shown: dict[str, int] = field(default_factory=dict)

    def take(self, seen: Seen) -> None:
        """One frame: a row, unless it only repeats or continues."""
        passed = seen.passed
        if passed.can_id in FRAMES:
            meaning = self._single(decode_frame(passed.can_id, passed.data))
        else:
            meaning = self._transfer(passed.can_id, passed.data)
        if meaning is not None:
            way = "R → C" if passed.direction == "sent" else "C → R"
            at_ms = round((seen.at_s - self.begun_s) * 1000)
            self.rows.append(
                f"| {at_ms} | {way} | {passed.can_id:03X} | `{passed.data.hex(' ')}` | {meaning} |"
            )

    def _single(self, frame: Frame) -> str | None:
        hidden = {"echo"} if isinstance(frame, RuntimeHeartbeat | ControllerHeartbeat) else set()
        values = [f"{f.name} {_value(getattr(frame, f.name))}" for f in fields(frame) if f.name not in hidden]
        meaning = f"{type(frame).__name__}: {', '.join(values)}"
        self._shown[meaning] = self._shown.get(meaning, 0) + 1
        return meaning if self._shown[meaning] <= CYCLIC_SHOWN else None

    def _transfer(self, can_id: int, data: bytes) -> str | None:
        match data[0] >> 4:
            case 0x0:
                return self._whole(data[1 : 1 + (data[0] & 0xF)])
            case 0x1:
                length = (data[0] & 0xF) << 8 | data[1]
                self._parts[can_id], self._left[can_id] = bytearray(data[2:]), length
                return f"first frame of {length} bytes, {-(-(length - 6) // 7)} frames follow"
            case 0x2:
                self._parts[can_id] += data[1:]
                if len(self._parts[can_id]) < self._left[can_id]:
                    return None
                return self._whole(bytes(self._parts[can_id][: self._left[can_id]]))
            case _:
                return f"flow control: blocks of {data[1]}"

    def _whole(self, payload: bytes) -> str:
        envelope = records.unpack(payload)
        return f"**{_told(envelope.record)}**, session {envelope.session:08x}, sequence {envelope.sequence}"


def _value(value: object) -> str:
    return value.name if isinstance(value, IntEnum) else str(int(value) if isinstance(value, bool) else value)


def _told(record: Record) -> str:
    """A record in a few words."""
    match record:
        case records.Reply():
            return f"Reply to {records.RECORDS[record.request_type].__name__}: {record.refusal.name}"
        case records.Announce():
            return f"Announce {record.serial}, {record.state.name}"
        case records.Opened():
            return f"Opened, epoch {record.epoch}, {record.state.name}"
        case records.Nonce() | records.NonceRequest():
            return f"{type(record).__name__} {record.purpose.name}"
        case records.PathStored():
            return f"PathStored {record.refusal.name}, digest {record.digest.hex()[:8]}..."
        case records.PathBlock():
            return f"PathBlock {record.index} of {record.count}"
        case _:
            return type(record).__name__


def session() -> str:
    """The table: a session up to a START that is refused because the enabling device is released."""
    with tempfile.TemporaryDirectory() as directory:
        rig = Rig(Path(directory))
        try:
            bench = rig.bench
            permit = bench.permitted()
            bench.ask(bench.signed(bench.start(permit)))
            bench.stop(StopCause.OPERATOR_QUIT, StopCode.END)
            bench.turn()
            frames = bench.frames
        finally:
            rig.close()
    reading = Reading(frames[0].at_s)
    for seen in frames:
        reading.take(seen)
    return "\n".join(["| ms | | id | bytes | |", "|---|---|---|---|---|", *reading.rows])


def page(text: str) -> str:
    """The page with the table between the marks. Raises ValueError where a mark is missing."""
    before, rest = text.split(BEGIN)
    _, after = rest.split(END)
    return f"{before}{BEGIN}\n\n{session()}\n\n{END}{after}"


def main() -> None:
    """Rewrite the page."""
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
