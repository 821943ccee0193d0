"""A log's records and frames in the forms of other programs: JSON lines, flat tables, messages of python-can. Pure."""

import csv
import io
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

import can

from cutgate.config.screen import printable
from cutgate.protocol.candump import RawFrame
from cutgate.runtime.audit.container.stored import Stored
from cutgate.runtime.audit.judge import parse_object
from cutgate.runtime.review.recorded_frames import Direction

NANOSECONDS: Final = 1_000_000_000
LEADING: Final = ("log_sequence", "log_time_s", "publish_time_s")
"""The first columns of every table; what the record holds stands behind them."""
COLUMNS_MAX: Final = 1000
"""Of one table; no record of ours has a tenth of it."""
NESTING_MAX: Final = 64
"""Levels of what is written as JSON; a record of ours has five."""
_DEPTH: Final = 8
"""Levels of objects that become columns; what lies deeper is JSON text."""
_FORMULA: Final = ("=", "+", "-", "@", "'")
"""What a spreadsheet takes a text for a formula by, and what marks one that it must not."""
_UNFIT: Final = re.compile(r"[^A-Za-z0-9]+")
_TIME: Final = {"sec", "nsec"}


# ---------------------------------------------------------------- JSON lines


def json_line(message: Stored) -> str:
    """One record as one line: topic, sequence, times, data.

    What is no JSON object of finite numbers, or is nested over ``NESTING_MAX`` levels, is there in hex.
    """
    head: dict[str, Any] = {
        "topic": message.topic,
        "sequence": message.sequence,
        "log_time": _time(message.log_time),
        "publish_time": _time(message.publish_time),
    }
    data = parse_object(message.data)
    if data is not None and _within(data, NESTING_MAX):
        try:
            return _json({**head, "data": data}) + "\n"
        except ValueError:  # infinite
            pass
    return _json({**head, "data_hex": message.data.hex()}) + "\n"


def _json(document: Any) -> str:
    """ASCII on one line."""
    return json.dumps(document, allow_nan=False, separators=(",", ":"))


def _within(value: Any, levels: int) -> bool:
    """Whether it is nested no deeper than this: how deep Python reads it differs from version to version."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return not inner or (levels > 0 and all(_within(one, levels - 1) for one in inner))


def _time(nanoseconds: int) -> dict[str, int]:
    sec, nsec = divmod(nanoseconds, NANOSECONDS)
    return {"sec": sec, "nsec": nsec}


# ---------------------------------------------------------------- tables


def row_of(message: Stored) -> dict[str, Any]:
    """What a record holds by column: parts of objects behind dots, lists as JSON text, times as seconds."""
    data = parse_object(message.data)
    if data is None or not _within(data, NESTING_MAX):
        return {"data_hex": message.data.hex()}
    return dict(_flat(data, "", 0))


def header_line(columns: Iterable[str]) -> str:
    """The first line of a table."""
    return _line([*LEADING, *(_text(name) for name in columns)])


def row_line(message: Stored, columns: Iterable[str]) -> str:
    """A record's line in the table of these columns."""
    row = row_of(message)
    times = (_seconds(message.log_time), _seconds(message.publish_time))
    return _line([str(message.sequence), *times, *(_cell(row.get(name)) for name in columns)])


def table_name(topic: str, taken: Iterable[str]) -> str:
    """The file of a topic's table: its letters and digits, and a number where another topic has the same."""
    plain = _UNFIT.sub("-", topic).strip("-")[:100] or "topic"
    names = (f"{plain}{'' if number == 1 else f'-{number}'}.csv" for number in range(1, 1 << 20))
    used = set(taken)
    return next(name for name in names if name not in used)


def _flat(value: Mapping[str, Any], before: str, depth: int) -> Iterator[tuple[str, Any]]:
    for key, inner in value.items():
        name = f"{before}{key}"
        if _is_time(inner):
            yield name, _Number(_seconds(inner["sec"] * NANOSECONDS + inner["nsec"]))
        elif isinstance(inner, dict) and inner and depth < _DEPTH:
            yield from _flat(inner, f"{name}.", depth + 1)
        elif isinstance(inner, dict | list):
            yield name, json.dumps(inner, separators=(",", ":"))
        else:
            yield name, inner


class _Number(str):
    """Digits that are a number, and no text."""

    __slots__ = ()


def _is_time(value: Any) -> bool:
    if not isinstance(value, dict) or value.keys() != _TIME:
        return False
    return all(isinstance(one, int) and not isinstance(one, bool) for one in value.values())


def _seconds(nanoseconds: int) -> str:
    """Seconds with nine decimals, exact."""
    whole, rest = divmod(abs(nanoseconds), NANOSECONDS)
    return f"{'-' * (nanoseconds < 0)}{whole}.{rest:09d}"


def _cell(value: Any) -> str:
    """A number as it is, a text that no spreadsheet takes for a formula, nothing for what is not there."""
    match value:
        case None:
            return ""
        case bool():
            return "true" if value else "false"
        case _Number():
            return value
        case int():
            return str(value)
        case float() if math.isfinite(value):
            return repr(value)
    return _text(str(value))


def _text(text: str) -> str:
    """On one line, with an apostrophe before what would be a formula; and before an apostrophe, so that it can be undone."""
    shown = printable(text)
    return f"'{shown}" if shown.lstrip().startswith(_FORMULA) else shown


def _line(cells: list[str]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue()


# ---------------------------------------------------------------- frames


def can_message(direction: Direction, frame: RawFrame) -> can.Message:
    """A frame as python-can has it: what the runtime sent is Tx, all else Rx."""
    return can.Message(
        timestamp=frame.time_ns / NANOSECONDS,
        arbitration_id=frame.can_id,
        data=frame.data,
        dlc=frame.remote_length if frame.is_remote else len(frame.data),
        is_extended_id=frame.is_extended,
        is_remote_frame=frame.is_remote,
        is_error_frame=frame.is_error,
        is_fd=frame.is_fd,
        bitrate_switch=frame.bit_rate_switch,
        error_state_indicator=frame.error_state,
        is_rx=direction == "received",
    )
