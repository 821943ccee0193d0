"""Numbers of a log as a page shows them: a time in seconds, a measure in its unit, rounded to the safe side."""

import math
from collections.abc import Mapping
from typing import Any, Final

from cutgate.runtime.review.comparable import is_number

_DECIMALS: Final = 1000.0


def seconds(value: object) -> float:
    """A time since record 0, s, to the millisecond; 0 where the log has none."""
    return round(float(value), 3) if is_number(value) and math.isfinite(value) else 0.0


def measure(value: object, unit: object) -> str:
    """A clearance in its unit, rounded down: it is never shown as more than it is; in words where there is none."""
    if not is_number(value) or not math.isfinite(value):
        return "undefined"
    down = math.floor(round(value * _DECIMALS, 3)) / _DECIMALS
    return f"{down:.3f} {unit if unit in ('mm', 'deg') else ''}".strip()


def plain(value: object) -> str:
    """A bound as it was set: no digit is added or lost that a person would miss."""
    return f"{value:g}" if is_number(value) and math.isfinite(value) else "undefined"


def text_of(record: Mapping[str, Any], key: str) -> str:
    """What stands there if it is text; a number in words of its own; else empty."""
    value = record.get(key)
    if isinstance(value, str):
        return value
    return str(value) if is_number(value) else ""


def state(name: object) -> str:
    """A state or phase in words."""
    return str(name).replace("_", " ") if name is not None else ""
