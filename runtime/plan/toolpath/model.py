"""What a tool path file says, whatever its language: for each tool the poses between which it moves."""

import json
from collections.abc import Callable, Collection
from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cutgate.config.refusal import InputError
from cutgate.protocol.arrays import Floats

Lines = NDArray[np.int64]
Flags = NDArray[np.bool_]
Told = Callable[[int, str], None]
"""Takes a line's number and what was understood of it."""

ARC_TOLERANCE_MM: Final = 0.01
AXIS_TOLERANCE_DEG: Final = 0.01
LINES_PER_POSE: Final = 4
LINES_BESIDE: Final = 10_000
"""So many lines may a file have that lead to no pose."""
TOLERANCES: Final = (0.0001, 1.0)
"""Least and largest that may be declared: smaller ones would cut a path into pieces without end."""


@dataclass(frozen=True, slots=True)
class Reading:
    """What a person declares of a tool path file, where the file leaves it open.

    Attributes:
        cutcom_is_tool_centre: coordinates under cutter compensation are the tool's centre already (APT's CUTCOM).
        rotary: convention of the rotary words, such as ``xyzac``; None where none was declared.
        arc_tolerance_mm: chords replace an arc no further off than this.
        axis_tolerance_deg: great circles replace a turn of machine axes no further off than this.

    Raises:
        ValueError: a tolerance is beyond its bounds, ``TOLERANCES``.
    """

    cutcom_is_tool_centre: bool = False
    rotary: str | None = None
    arc_tolerance_mm: float = ARC_TOLERANCE_MM
    axis_tolerance_deg: float = AXIS_TOLERANCE_DEG

    def __post_init__(self) -> None:
        least, most = TOLERANCES
        for name in ("arc_tolerance_mm", "axis_tolerance_deg"):
            if not (least <= getattr(self, name) <= most):
                raise ValueError(f"{name} is {getattr(self, name)!r}, must be {least:g} to {most:g}")


PLAIN: Final = Reading()
"""Nothing is declared."""
_NAMES: Final = tuple(field.name for field in fields(Reading))


def as_words(reading: Reading, names: Collection[str]) -> str:
    """What these fields of a reading say, as a log keeps it: ``name=JSON``, in the order of the fields."""
    return " ".join(f"{name}={json.dumps(getattr(reading, name))}" for name in _NAMES if name in names)


def of_words(text: str) -> Reading:
    """The reading that a log keeps; what it does not name is not declared.

    Raises:
        ValueError: the text is none of `as_words`.
    """
    pairs = [pair.partition("=") for pair in text.split()]
    try:
        found = {name: json.loads(value) for name, _, value in pairs}
    except RecursionError:
        raise ValueError("the reading of a tool path is nested without end") from None
    if not (len(found) == len(pairs) and found.keys() <= set(_NAMES)):
        raise ValueError(f"{text!r} says no reading of a tool path")
    for name, value in found.items():
        usual = getattr(PLAIN, name)
        if type(value) is not type(usual) and not (usual is None and type(value) is str):
            raise ValueError(f"{name} of the reading of a tool path is {value!r}")
    return replace(PLAIN, **found)


@dataclass(frozen=True, slots=True)
class Cut:
    """One tool's way from its first position to its last; between neighbouring poses it moves straight.

    Attributes:
        tool: the file's name for the tool; empty where it names none.
        tool_length_mm: what the file says of its length, or None.
        tips_mm: (n, 3).
        axes: (n, 3), unit, from the tip toward the holder.
        lines: (n,), the line of the file that each pose stems from.
        positioning: (n,), whether the move that ends at a pose only positions (APT's RAPID, G0); the first is True.
        feeds_mm_s: (n,), of the move that ends at a pose; NaN where it positions or the file gives none.
        tolerance_mm: how far what the file describes may be from these straight lines.
        tolerance_deg: the same of the tool axis.
    """

    tool: str
    tool_length_mm: float | None
    tips_mm: Floats
    axes: Floats
    lines: Lines
    positioning: Flags
    feeds_mm_s: Floats
    tolerance_mm: float = 0.0
    tolerance_deg: float = 0.0

    @property
    def feed_range_mm_s(self) -> tuple[float, float] | None:
        """The slowest and the fastest feed of the moves that cut; None where the file gives none."""
        given = self.feeds_mm_s[np.isfinite(self.feeds_mm_s)]
        return (float(given.min()), float(given.max())) if given.size else None


@dataclass(frozen=True, slots=True)
class ToolPath:
    """All of a file: one cut for each tool, or for each time that a tool was mounted, in the file's order."""

    cuts: tuple[Cut, ...]


Reader = Callable[[object, bytes, Reading, int, Told | None], ToolPath]
"""Reads one language: takes the file for messages, the whole of its content, what was declared, the most poses of all cuts
together, and what takes the remarks on its lines, or None where nobody wants to know. Raises ``InputError``, which names
line, what was found and what is accepted. Nothing is skipped that could move the tool."""


def check_lines(file: object, data: bytes, pose_limit: int) -> None:
    """Refuses a file of far more lines than its poses need, before its lines become strings.

    Raises:
        InputError: more than ``LINES_PER_POSE`` for each pose that a path may have.
    """
    count, most = data.count(b"\n"), LINES_BESIDE + LINES_PER_POSE * pose_limit
    if not (count <= most):
        bound = f"<= {most} lines for {pose_limit} poses"
        raise InputError(file, "", f"{count} lines", bound, "take out what moves nothing, or part the file")


def too_many(file: object, line: int, pose_limit: int, remedy: str) -> InputError:
    """The refusal of a path that becomes longer than the limit at this line."""
    return InputError(file, f"line {line}", f"over {pose_limit} poses", f"<= {pose_limit} poses", remedy)
