"""The table of a log's records: each in a line of words, frames and samples apart."""

import json
import re
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Final

from cutgate.runtime.audit.container.scan import walk
from cutgate.runtime.audit.container.stored import Scan
from cutgate.runtime.audit.inspect import Log
from cutgate.runtime.audit.judge import parse_object
from cutgate.runtime.audit.records import STREAMED, AuditRecord
from cutgate.runtime.review.report.numbers import text_of

COLUMNS: Final = ("number", "t_s", "topic", "what", "text")
ROWS_MAX: Final = 3000
TEXT_MAX: Final = 300
_CHAIN: Final = frozenset(AuditRecord.model_fields)
_NAMES: Final = (
    "event",
    "kind",
    "name",
    "word",
    "state",
    "cause",
    "verdict",
    "final_state",
    "role",
    "record",
    "log_id",
)
"""Fields of which the first that is there says what a record is about."""
_LONG: Final = re.compile(r"[0-9a-f]{32,}")
_LONG_TEXTS: Final = frozenset({"document", "note"})
"""Of these only how long they are: JSON documents and signed notes."""
_DIGITS_SHOWN: Final = 16
_TIME_MAX: Final = 1 << 40
_NANOSECONDS: Final = 1_000_000_000


def rows(log: Log, shown: Callable[[Any], Any] = lambda record: record) -> dict[str, Any]:
    """Number in the file, seconds since record 0, topic, what it is about, and its other fields in words.

    At most `ROWS_MAX` rows: of more the middle is left out, and a row says how many. Never raises, whatever the log
    holds.

    Args:
        log: the log as read; its file is open.
        shown: what of a record is shown, as ``Redaction.apply``.
    """
    first: list[list[Any]] = []
    last: deque[list[Any]] = deque(maxlen=ROWS_MAX // 2)
    start_ns: int | None = None
    count = 0
    for number, message in enumerate(walk(log.file, Scan())):
        if message.topic in STREAMED:
            continue
        record = parse_object(message.data) or {}
        at_ns = _time_ns(record)
        start_ns = at_ns if start_ns is None else start_ns
        row = _row(number, message.topic, shown(record), at_ns, start_ns)
        count += 1
        if len(first) < ROWS_MAX - ROWS_MAX // 2:
            first.append(row)
        else:
            last.append(row)
    left_out = count - len(first) - len(last)
    gap = (
        [[None, None, "", f"{left_out} records are left out here; the log has them", ""]] if left_out else []
    )
    return {"columns": list(COLUMNS), "rows": [*first, *gap, *last]}


def _row(
    number: int, topic: str, record: Mapping[str, Any], at_ns: int | None, start_ns: int | None
) -> list[Any]:
    at_s = round((at_ns - start_ns) / 1e9, 3) if at_ns is not None and start_ns is not None else None
    name = next((key for key in _NAMES if text_of(record, key)), "")
    rest = {key: value for key, value in record.items() if key not in _CHAIN and key != name}
    return [number, at_s, topic, _short(text_of(record, name)), _short(_words(rest))]


def _words(fields: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{key.replace('_', ' ')} {_value(key, value)}"
        for key, value in fields.items()
        if value not in ([], "")
    )


def _value(key: str, value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return f"of {len(value)} characters" if key in _LONG_TEXTS else value
    try:
        return json.dumps(value, ensure_ascii=False)
    except (ValueError, RecursionError):
        return "(cannot be shown)"


def _short(text: str) -> str:
    """Long runs of hex digits by their first, and a bounded length; the log has all of it."""
    shown = _LONG.sub(lambda found: f"{found[0][:_DIGITS_SHOWN]}...", text[: 10 * TEXT_MAX])
    return shown if len(shown) <= TEXT_MAX else f"{shown[:TEXT_MAX]}..."


def _time_ns(record: Mapping[str, Any]) -> int | None:
    """The record's monotonic time, or a frame's stamp; None where it is none."""
    time = record.get("monotonic")
    if not isinstance(time, dict):
        return None
    sec, nsec = time.get("sec"), time.get("nsec")
    if not (
        isinstance(sec, int) and isinstance(nsec, int) and abs(sec) < _TIME_MAX and abs(nsec) < _TIME_MAX
    ):
        return None
    return sec * _NANOSECONDS + nsec
