"""One session of the report: what stands in the page as words, and as JSON what its script draws. Pure."""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, BinaryIO, Final

from cutgate.config.screen import printable
from cutgate.runtime.audit.container.scan import walk
from cutgate.runtime.audit.container.stored import Scan
from cutgate.runtime.audit.inspect import Log
from cutgate.runtime.audit.replay import Replay
from cutgate.runtime.audit.trust import REPLAY, TrustAnswer
from cutgate.runtime.commands.foxglove.known import known_of
from cutgate.runtime.commands.foxglove.streams import Known
from cutgate.runtime.commands.report.over_time import OverTime
from cutgate.runtime.commands.report.place import along_the_path, joints_along_the_path, place_document
from cutgate.runtime.review.decoding import Decoding
from cutgate.runtime.review.recorded_frames import SessionFrames
from cutgate.runtime.review.report.answers import Answers, Fact, answers
from cutgate.runtime.review.report.cards import Card, cards_of
from cutgate.runtime.review.report.integrity import steps_of
from cutgate.runtime.review.report.measured import measured_of
from cutgate.runtime.review.report.records import rows
from cutgate.runtime.review.report.redact import Redaction
from cutgate.runtime.review.report.timeline import duration_s, lanes
from cutgate.runtime.review.told import text_line

BEFORE_MAX: Final = 40
BEHIND_MAX: Final = 20
"""Messages that are shown beside a decision, the nearest before and behind it."""
WITHIN_NS: Final = 500_000_000
"""None that is further from it in time."""
_NS: Final = 1_000_000_000


@dataclass(frozen=True, eq=False)
class ReportedSession:
    """What the page shows of a session.

    Attributes:
        log: as read.
        told: `story` of it.
        replay: what deciding again has shown; None where it was left out.
        answers: the first screen.
        cards: decisions that are told at length.
        known: what can be drawn.
        missing: what cannot be drawn, and why.
        source: where the messages on the bus come from.
        document: for the script.
    """

    log: Log
    told: Mapping[str, Any]
    replay: Replay | None
    answers: Answers
    cards: Sequence[Card]
    known: Known
    missing: Sequence[str]
    source: str
    document: Mapping[str, Any]


def reported(
    log: Log,
    name: str,
    told: Mapping[str, Any],
    raw: BinaryIO | None,
    replay: Replay | None,
    prefix: str,
    redaction: Redaction | None = None,
) -> ReportedSession:
    """Reads the log from front to back, and the raw frames once. Never raises, whatever they hold.

    Args:
        log: the log as read; its file is open.
        name: of its file.
        told: `story` of the log.
        raw: the raw frames beside it, open, or None.
        replay: what deciding again has shown; None where it was left out.
        prefix: of the names of its cards, each session's own.
        redaction: what is left out of the document and of what is told; None for nothing. The log itself keeps it.
    """
    known, _, missing = known_of(log, name)
    shown = redaction.apply if redaction else _whole
    told = shown(told)
    cards = cards_of(told, prefix)
    start_ns = told["opened"].get("utc_ns") or 0
    over_time = OverTime(known, start_ns)
    for message in walk(log.file, Scan()):
        over_time.take(message)
    frames = SessionFrames(log, raw)
    along = [along_the_path(known.decision)] if known.decision else []
    if known.decision and known.arm and known.trajectory:
        along.append(joints_along_the_path(known.decision, known.arm, known.trajectory))
    plots = over_time.plots()
    started = any(one["what"] == "start" for one in told["allowed"])
    if started and not any(plot["id"] == "deviation" for plot in plots):
        missing.append(
            "a log of this version does not hold how far the arm was from its way, nor the times of the loop"
        )
    document = {
        "name": printable(name),
        "redacted": redaction is not None,
        "began": _moment(start_ns),
        "end": round(max(duration_s(told), 0.001), 3),
        "lanes": lanes(told, cards),
        "moments": [
            {"t_s": round(one.t_s, 3), "name": printable(one.title), "card": one.id} for one in cards
        ],
        "place": place_document(known.decision, known.arm) if known.decision else None,
        "arm": over_time.arm(),
        "plots": [*along, *plots],
        "records": rows(log, shown),
        "frames": _about(frames, cards, start_ns),
    }
    answered = answers(told, log.report.status, _replayed(log, replay), measured_of(log))
    return ReportedSession(log, told, replay, answered, cards, known, missing, frames.source, shown(document))


def _whole(document: Any) -> Any:
    return document


def _replayed(log: Log, replay: Replay | None) -> Fact:
    step = next(step for step in steps_of(log.report, replay) if step.name == REPLAY)
    good = {TrustAnswer.YES: True, TrustAnswer.NO: False}.get(step.answer)
    return Fact("Replay", step.text, good, "integrity")


def _moment(time_ns: int) -> str:
    if not 0 < time_ns < 1 << 62:
        return ""
    return f"{datetime.fromtimestamp(time_ns // _NS, UTC):%Y-%m-%d %H:%M:%S} UTC"


def _about(frames: SessionFrames, cards: Sequence[Card], start_ns: int) -> dict[str, list[str]]:
    """The messages on the bus about each decision, a line each, by the name of its card."""
    found = {one.id: (deque[str](maxlen=BEFORE_MAX), list[str]()) for one in cards}
    times = {one.id: start_ns + int(one.t_s * _NS) for one in cards}
    decoding = Decoding()
    for direction, frame in frames.each():
        for heard in decoding.take(frame, direction):
            for name, at_ns in times.items():
                if not at_ns - WITHIN_NS <= heard.time_ns <= at_ns + WITHIN_NS:
                    continue
                before, behind = found[name]
                line = text_line(heard, start_ns, interfaces=False).rstrip("\n")
                if heard.time_ns <= at_ns:
                    before.append(line)
                elif len(behind) < BEHIND_MAX:
                    behind.append(line)
    return {name: [*before, *behind] for name, (before, behind) in found.items()}
