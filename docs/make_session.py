"""Writes what docs/controllers.md takes from the program: an annotated session, and the bus load.

``python docs/make_session.py`` rewrites the tables between their marks. The session is a run against the simulated
controller in virtual time; random numbers are the same in every run.
"""
# ruff: noqa: INP001, PLR0911

import sys
import tempfile
from dataclasses import dataclass, field, fields
from enum import IntEnum
from pathlib import Path
from typing import Final

sys.path.insert(0, str(Path(__file__).parents[1]))

from cutgate.protocol import records
from cutgate.protocol.frames import (
    FRAMES,
    ControllerHeartbeat,
    Frame,
    Joint4,
    Joints01,
    Joints23,
    Progress,
    RuntimeHeartbeat,
    decode_frame,
    message_of,
)
from cutgate.protocol.records import Record
from cutgate.protocol.states import StopCause, StopCode
from cutgate.runtime.conform.heard import Seen
from tests.runtime.conform.rig import Rig

PAGE: Final = Path(__file__).with_name("controllers.md")
MARK: Final = "<!-- {name}: docs/make_session.py -->"
MARK_END: Final = "<!-- end of {name} -->"
BITRATE_BIT_S: Final = 1_000_000
FIXED_BITS: Final = 47
"""A classic frame with an 11-bit identifier and no data, intermission of 3 bits included, without stuff bits."""
STUFFED_BITS: Final = 34
"""Of these, so many are subject to bit stuffing, as all data bits are."""
CYCLIC: Final = (RuntimeHeartbeat, ControllerHeartbeat, Joints01, Joints23, Joint4, Progress)
PERIODS_MS: Final = (5, 20, 50, 100)
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
            bench.ask(bench.start(permit))
            bench.stop(StopCause.OPERATOR_QUIT, StopCode.END)
            bench.run_cycle()
            frames = bench.frames
        finally:
            rig.close()
    reading = Reading(frames[0].at_s)
    for seen in frames:
        reading.take(seen)
    return "\n".join(["| ms | | id | bytes | |", "|---|---|---|---|---|", *reading.rows])


def frame_bits(data_bytes: int) -> tuple[int, int]:
    """Bits of a classic frame on the bus: without stuff bits, and with the most there can be (one after four)."""
    bits = FIXED_BITS + 8 * data_bytes
    return bits, bits + (STUFFED_BITS + 8 * data_bytes - 1) // 4


def load() -> str:
    """The table of what the cyclic frames take of the bus, at the most stuff bits."""
    bits = [frame_bits(message_of(kind).length) for kind in CYCLIC]
    most = sum(stuffed for _, stuffed in bits)
    rows = [
        f"| {kind.__name__} | {message_of(kind).frame_id:03X} | {message_of(kind).length} | {plain} | {stuffed} |"
        for kind, (plain, stuffed) in zip(CYCLIC, bits, strict=True)
    ]
    shares = [
        f"| {period} | {len(CYCLIC) * 1000 // period} | {most * 1000 / period / 1000:.1f} "
        f"| {100 * most * 1000 / period / BITRATE_BIT_S:.1f} % |"
        for period in PERIODS_MS
    ]
    return "\n".join(
        [
            "| cyclic frame | id | data bytes | bits | bits, most stuffed |",
            "|---|---|---|---|---|",
            *rows,
            f"| **one period** | | | {sum(plain for plain, _ in bits)} | {most} |",
            "",
            "| period, ms | frames/s | kbit/s | of 1 Mbit/s |",
            "|---|---|---|---|",
            *shares,
        ]
    )


def page(text: str) -> str:
    """The page with each table between its marks. Raises ValueError where a mark is missing."""
    for name, made in (("session", session()), ("load", load())):
        begin, end = MARK.format(name=name), MARK_END.format(name=name)
        before, rest = text.split(begin)
        _, after = rest.split(end)
        text = f"{before}{begin}\n\n{made}\n\n{end}{after}"
    return text


def main() -> None:
    """Rewrite the page."""
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
