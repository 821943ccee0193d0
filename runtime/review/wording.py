"""The fields of what crosses the bus, in words and units: single frames by the DBC, records by their layout."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import IntEnum
from typing import Any, Final

from cutgate.protocol.conversation import AGE_UNKNOWN, NO_TIME
from cutgate.protocol.frames import Frame, message_of
from cutgate.protocol.parameters import UNIT
from cutgate.protocol.wire import Block, Nested, layout

_JOINTS: Final = ("deg", "deg", "mm", "deg", "deg")
JOINT_COUNTS: Final = {
    "q_min_u": "",
    "q_max_u": "",
    "joint_offset_u": "",
    "start_joints_u": "",
    "entry_joints_u": "",
    "exit_joints_u": "",
    "speed_u": "/s",
    "acceleration_u": "/s2",
}
"""Fields of five counts, one a joint, and what follows the joint's unit."""
COUNTS: Final = {
    "upper_link_u": "mm",
    "forearm_link_u": "mm",
    "upper_link_error_u": "mm",
    "forearm_link_error_u": "mm",
    "slide_tilt_u": "mrad",
    "residual_mm_u": "mm",
    "residual_deg_u": "deg",
    "length_u": "mm",
}
"""Fields of one count, or of several of one kind, and their unit."""
_TIMES: Final = ("registration_time_us", "barrier_us")
_AGES: Final = ("motion_age_s",)
_PROTECTION: Final = frozenset({"crc", "counter", "reserved"})
"""Signals that say nothing of their own."""
_DECIMALS: Final = 6
_SHOWN_BYTES: Final = 64
_DATED_US: Final = range(1 << 57)
"""Microseconds since 1970 of which a date can be told."""


@dataclass(frozen=True)
class Field:
    """One field: a number with its unit, a word, or bytes in hex.

    Attributes:
        name: as the DBC or the record has it; parts of nested fields behind dots.
        value: text, or a number in the unit.
        unit: empty where the name says it, or where there is none.
    """

    name: str
    value: str | int | float
    unit: str = ""

    @property
    def key(self) -> str:
        """The name with the unit behind it, for a JSON object."""
        return f"{self.name}_{self.unit.replace('/', '_')}" if self.unit else self.name

    def __str__(self) -> str:
        """Name, value and unit; of long bytes only how many."""
        value = self.value
        if isinstance(value, float):
            text = f"{value:.{_DECIMALS}f}".rstrip("0").rstrip(".")
        elif isinstance(value, str):
            text = value or '""'
            if len(text) > 2 * _SHOWN_BYTES:
                text = f"{len(text) // 2} bytes"
        else:
            text = str(value)
        return " ".join(filter(None, (self.name, text, self.unit)))


def fields_of_frame(frame: Frame, data: bytes) -> tuple[Field, ...]:
    """The signals of a single frame, but for what protects it.

    Args:
        frame: as ``decode_frame`` found it in these bytes.
        data: its eight bytes.
    """
    message = message_of(type(frame))
    values: dict[str, Any] = message.decode(data, decode_choices=True, scaling=True)  # type: ignore[assignment]
    found = []
    for signal in message.signals:
        if signal.name in _PROTECTION:
            continue
        value = values[signal.name]
        if signal.name == "tag":
            told: str | int | float = f"{value:#x}"
        elif isinstance(value, float):
            told = round(value, _DECIMALS)
        else:
            told = value if isinstance(value, int) else str(value)
        found.append(Field(signal.name, told, signal.unit or ""))
    return tuple(found)


def fields_of_record(record: Block, before: str = "") -> Iterator[Field]:
    """The fields of a record, or of what is nested in one.

    Args:
        record: the record.
        before: what stands before each name.
    """
    for name, codec in layout(type(record)):
        value = getattr(record, name)
        if isinstance(codec, Nested):
            yield from fields_of_record(value, f"{before}{name}.")
        elif name in JOINT_COUNTS:
            for joint, (count, unit) in enumerate(zip(value, _JOINTS, strict=True)):
                own = f"{before}{name.removesuffix('_u')}.q{joint}"
                yield Field(own, count / UNIT, unit + JOINT_COUNTS[name])
        elif name in COUNTS:
            yield from _counted(f"{before}{name.removesuffix('_u')}", value, COUNTS[name])
        else:
            yield Field(f"{before}{name}", _plain(name, value))


def _counted(name: str, value: int | tuple[int, ...], unit: str) -> Iterator[Field]:
    """One count, or several of one kind, in the unit; a name that ends in its unit does not say it twice."""
    unit = "" if name.endswith(f"_{unit}") else unit
    if isinstance(value, tuple):
        for number, count in enumerate(value):
            yield Field(f"{name}.{number}", count / UNIT, unit)
    else:
        yield Field(name, value / UNIT, unit)


def _plain(name: str, value: Any) -> str | int | float:
    """A field that is no count: a code's name, bytes in hex, a time of day, text, a number."""
    if isinstance(value, IntEnum):
        return value.name
    if isinstance(value, bytes):
        return value.hex()
    if name in _TIMES:
        return moment(value) if value != NO_TIME else "none"
    if name in _AGES and value == AGE_UNKNOWN:
        return "not known"
    return value if isinstance(value, int | str) else json.dumps(value)


def moment(time_us: int) -> str:
    """A time of day, microseconds since 1970 UTC, as ISO 8601 has it; the count where no calendar has it."""
    if time_us not in _DATED_US:
        return f"{time_us} us since 1970"
    seconds, rest = divmod(time_us, 1_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{rest:06d}Z"
