"""One session of the report, read once: what stands in the page as HTML, and what its script draws, as JSON."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from cutgate.runtime.audit.container.scan import walk
from cutgate.runtime.audit.container.stored import Scan
from cutgate.runtime.audit.inspect import Log
from cutgate.runtime.commands.foxglove.known import known_of
from cutgate.runtime.commands.foxglove.streams import Known
from cutgate.runtime.commands.report.course import Course
from cutgate.runtime.commands.report.place import along_the_path, place_document
from cutgate.runtime.commands.report.told import Card, RecordRows, cards, lanes
from cutgate.runtime.review.decoding import Decoding
from cutgate.runtime.review.recorded_frames import SessionFrames
from cutgate.runtime.review.report.answers import Answers, Fact, answers
from cutgate.runtime.review.report.measured import measured_of
from cutgate.runtime.review.story import story
from cutgate.runtime.review.told import text_line

BEFORE_S: Final = 0.15
BEHIND_S: Final = 0.1
"""Frames this long before and behind a decision are shown beside it."""
FRAMES_MAX: Final = 60
"""Of one decision."""


@dataclass(frozen=True)
class Session:
    """What the page shows of a session.

    Attributes:
        name: of the log's file.
        told: `story` of the log.
        answers: the first screen.
        cards: the decisions that are told at length.
        known: what can be drawn.
        missing: what cannot, and why.
        document: for the script.
        frames: where they come from.
        report: the judgement of the log.
    """

    name: str
    told: Mapping[str, Any]
    answers: Answers
    cards: list[Card]
    known: Known
    missing: list[str]
    document: dict[str, Any]
    frames: str
    report: Any


def session_of(log: Log, path: Path, raw: Any, replayed: Fact) -> Session:
    """Reads the log from front to back, and its raw frames once.

    Args:
        log: the log as read; its file is open.
        path: its file.
        raw: the raw frames beside it, open, or None.
        replayed: what deciding again has shown.
    """
    told = story(log, path, None)
    known, _, missing = known_of(log, path.name)
    found = cards(told)
    start_ns = told["opened"].get("utc_ns") or 0
    course: Course | None = None
    rows: RecordRows | None = None
    end_ns = start_ns
    for number, message in enumerate(walk(log.file, Scan())):
        start_ns = start_ns or message.log_time
        course, rows = course or Course(known, start_ns), rows or RecordRows(start_ns)
        course.take(message)
        rows.take(number, message)
        end_ns = message.log_time
    end_s = round((end_ns - start_ns) / 1e9, 3)
    frames = SessionFrames(log, raw)
    document = {
        "name": path.name,
        "began": _moment(start_ns),
        "end": end_s,
        "lanes": lanes(told, end_s),
        "moments": [{"at": round(one.at_s, 3), "name": one.title, "card": one.name} for one in found],
        "place": place_document(known.decision, known.arm) if known.decision else None,
        "arm": course.arm() if course else None,
        "plots": [
            *([along_the_path(known.decision)] if known.decision else []),
            *(course.plots() if course else []),
        ],
        "records": rows.rows() if rows else [],
        "frames": frames_about(frames, found, start_ns),
    }
    answered = answers(told, log.report.status, replayed, measured_of(log))
    return Session(path.name, told, answered, found, known, missing, document, frames.source, log.report)


def _moment(time_ns: int) -> str:
    if not 0 < time_ns < 2**62:
        return ""
    return datetime.fromtimestamp(time_ns // 1_000_000_000, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def frames_about(frames: SessionFrames, found: list[Card], start_ns: int) -> dict[str, list[str]]:
    """The messages on the bus about each decision, a line each, by the name of its card."""
    windows = {
        one.name: (start_ns + int((one.at_s - BEFORE_S) * 1e9), start_ns + int((one.at_s + BEHIND_S) * 1e9))
        for one in found
    }
    lines: dict[str, list[str]] = {one.name: [] for one in found}
    decoding = Decoding()
    for direction, frame in frames.each():
        for heard in decoding.take(frame, direction):
            for name, (begin, end) in windows.items():
                if begin <= heard.time_ns <= end and len(lines[name]) < FRAMES_MAX:
                    lines[name].append(text_line(heard, start_ns, interfaces=False).rstrip("\n"))
    return lines
