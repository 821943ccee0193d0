"""ITK transform files as text (``.tfm``, ``.txt``)."""

from dataclasses import dataclass, field
from typing import Final

from cutgate.config.refusal import InputError
from cutgate.runtime.plan.registrations.itk import COMPOSITE, PARTS_MAX, Part, kind_of
from cutgate.runtime.plan.registrations.numbers import numbers_of

HEADER: Final = "#Insight Transform File V1.0"
NUMBERS_MAX: Final = 100
"""Of one line; a rigid transform has 12 at most."""


@dataclass(slots=True)
class _Written:
    """A transform as far as it is read."""

    place: str
    kind: str
    numbers: dict[str, tuple[float, ...]] = field(default_factory=dict)


def is_itk_text(text: str) -> bool:
    """Whether a text begins as these files do."""
    return text.split("\n", 1)[0].strip() == HEADER


def read_itk_text(file: object, text: str) -> tuple[Part, ...]:
    """The transforms in the order of the file.

    Raises:
        InputError: names the line; a line that is not understood is not left out.
    """
    lines = text.split("\n")
    if not is_itk_text(text):
        remedy = "save the transform as text from ITK or Slicer"
        raise InputError(file, "line 1", repr(lines[0][:40]), f"{HEADER!r}", remedy)
    found: list[_Written] = []
    for number, line in enumerate(lines[1:], start=2):
        told = line.strip()
        if told and not told.startswith("#"):
            _take(file, f"line {number}", told, found)
    return tuple(_part(file, one) for one in found)


def _take(file: object, place: str, line: str, found: list[_Written]) -> None:
    """One line that says something."""
    name, colon, value = line.partition(":")
    if not colon or name not in ("Transform", "Parameters", "FixedParameters"):
        bound = "Transform:, Parameters: or FixedParameters:"
        raise InputError(file, place, repr(line[:40]), bound, "save the transform anew")
    if name == "Transform":
        if len(found) > PARTS_MAX:
            bound = f"at most {PARTS_MAX} transforms"
            raise InputError(file, place, "one more transform", bound, "compose them into one")
        found.append(_Written(place, kind_of(file, place, value.strip())))
        return
    if not found:
        raise InputError(file, place, f"{name} before any Transform", "Transform: first", "save it anew")
    if name in found[-1].numbers:
        raise InputError(file, place, f"{name} a second time", "given once", "save the transform anew")
    cells = value.split(maxsplit=NUMBERS_MAX)
    if not (len(cells) <= NUMBERS_MAX):
        bound = f"at most {NUMBERS_MAX} numbers in a line"
        raise InputError(file, place, f"more than {NUMBERS_MAX} numbers", bound, "save a rigid transform")
    found[-1].numbers[name] = numbers_of(file, place, cells)


def _part(file: object, one: _Written) -> Part:
    if one.kind != COMPOSITE:
        for name in ("Parameters", "FixedParameters"):
            if name not in one.numbers:
                found = f"a {one.kind} without {name}"
                raise InputError(file, one.place, found, f"{name}: in a line behind it", "save it anew")
    return Part(
        one.place, one.kind, one.numbers.get("Parameters", ()), one.numbers.get("FixedParameters", ())
    )
