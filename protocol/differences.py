"""What a controller's limits, calibration and tool say otherwise than the approved ones, in words and units."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from cutgate.protocol.parameters import NOT_GIVEN, UNIT, Calibration, Limits, Tool

Parameters = Limits | Calibration | Tool

_JOINT: Final = ("deg", "deg", "mm", "deg", "deg")
_RATE: Final = ("rad/s", "rad/s", "mm/s", "rad/s", "rad/s")
_RATE2: Final = tuple(f"{unit}2" for unit in _RATE)
_IN_RADIANS: Final = {"rad/s", "rad/s2"}
"""As in robot.toml, where people look for them; a record has them in degrees."""


@dataclass(frozen=True)
class _Field:
    """A value, or several: the unit of each, and what it is called; ``{}`` stands for which."""

    name: str
    words: str
    units: tuple[str, ...]
    which: tuple[str, ...] = ("",)


_EACH: Final = ("q0", "q1", "q2", "q3", "q4")
_FIELDS: Final[dict[type, tuple[_Field, ...]]] = {
    Limits: (
        _Field("q_min_u", "{} lower limit", _JOINT, _EACH),
        _Field("q_max_u", "{} upper limit", _JOINT, _EACH),
        _Field("speed_u", "{} speed limit", _RATE, _EACH),
        _Field("acceleration_u", "{} acceleration limit", _RATE2, _EACH),
    ),
    Calibration: (
        _Field("upper_link_u", "upper link", ("mm",)),
        _Field("forearm_link_u", "forearm link", ("mm",)),
        _Field("upper_link_error_u", "error of the upper link", ("mm",)),
        _Field("forearm_link_error_u", "error of the forearm link", ("mm",)),
        _Field("joint_offset_u", "{} offset", _JOINT, _EACH),
        _Field("slide_tilt_u", "slide tilt along {}", ("mrad", "mrad"), ("x", "y")),
        _Field("residual_mm_u", "residual", ("mm",)),
        _Field("residual_deg_u", "residual", ("deg",)),
    ),
    Tool: (_Field("length_u", "tool length", ("mm",)),),
}


def differences(received: Parameters, approved: Parameters) -> tuple[str, ...]:
    """Each value that is not the approved one, with both; of two records of one kind.

    >>> differences(Tool(150_000_000), Tool(160_000_000))
    ('tool length is 150 mm, approved: 160 mm',)
    """
    return tuple(text for entry in _FIELDS[type(approved)] for text in _unequal(entry, received, approved))


def _unequal(entry: _Field, received: Parameters, approved: Parameters) -> Iterator[str]:
    found, wanted = (_values(getattr(record, entry.name)) for record in (received, approved))
    given = [values != NOT_GIVEN for values in (found, wanted)]
    for which, unit, one, other in zip(entry.which, entry.units, found, wanted, strict=True):
        if one != other:
            shown, bound = _apart(one if given[0] else None, other if given[1] else None, unit)
            yield f"{entry.words.format(which)} is {shown}, approved: {bound}"


_DECIMALS: Final = (6, 9)
"""As in robot.toml; and as many as tell any two values of a record apart."""


def _apart(one: int | None, other: int | None, unit: str) -> list[str]:
    """Two values that differ, so that they look it."""
    for decimals in _DECIMALS:
        shown = [_shown(value, unit, decimals) for value in (one, other)]
        if shown[0] != shown[1]:
            break
    return shown


def _shown(value: int | None, unit: str, decimals: int) -> str:
    if value is None:
        return "not given"
    number = math.radians(value / UNIT) if unit in _IN_RADIANS else value / UNIT
    return f"{number:.{decimals}f}".rstrip("0").rstrip(".") + f" {unit}"


def _values(value: int | tuple[int, ...]) -> tuple[int, ...]:
    return value if isinstance(value, tuple) else (value,)
