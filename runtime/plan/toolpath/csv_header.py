"""The beginning of a CSV tool path: which columns it has, in which units, and how they are separated."""

import re
from codecs import BOM_UTF8
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from cutgate.config.refusal import InputError, shown

HEADER: Final = "x,y,z,i,j,k"
POSE: Final = tuple(HEADER.split(","))
FEED: Final = "feed"
NUMBER: Final = "number"
SPACES: Final = " "

PREAMBLE_MAX: Final = 100
"""Lines of comments, and blank ones, before the header."""
HEADER_MAX: Final = 1000
"""Characters of the header, and of the units below it."""

POSITIONS: Final = (("x", "y", "z"), ("px", "py", "pz"), ("pos_x", "pos_y", "pos_z"))
AXES: Final = (("i", "j", "k"), ("nx", "ny", "nz"), ("ax", "ay", "az"), ("axis_x", "axis_y", "axis_z"))
"""What exporters call the three; of one family they must be, for names of several are of several things."""
MEANINGS: Final = {
    **{name: meaning for family in POSITIONS for name, meaning in zip(family, POSE[:3], strict=True)},
    **{name: meaning for family in AXES for name, meaning in zip(family, POSE[3:], strict=True)},
    **dict.fromkeys(("f", "feed", "feedrate", "feed_rate"), FEED),
    **dict.fromkeys(("n", "id", "no", "nr", "index"), NUMBER),
}

LENGTHS_MM: Final = {"": 1.0, "mm": 1.0, "m": 1000.0, "in": 25.4, "inch": 25.4}
FEEDS_MM_S: Final = dict.fromkeys(("mm/s", "mm_s"), 1.0) | dict.fromkeys(("mm/min", "mm_min"), 1.0 / 60.0)
NONE: Final = {"": 1.0, "-": 1.0, "1": 1.0}
UNITS: Final = (
    dict.fromkeys(POSE[:3], LENGTHS_MM) | dict.fromkeys(POSE[3:], NONE) | {FEED: FEEDS_MM_S, NUMBER: NONE}
)
ACCEPTED: Final = (
    dict.fromkeys(POSE[:3], "mm, m, in or inch")
    | dict.fromkeys(POSE[3:], "none, for an axis has none")
    | {FEED: "mm/s or mm/min", NUMBER: "none, for a running number has none"}
)
FOREIGN: Final = frozenset({"um", "µm", "μm", "cm", "dm", "km", "ft", "mil", "deg", "rad", "°", "in/min"})
"""Units that are none of ours, by which a line of units is known, to be refused as one."""

_KNOWN_UNITS: Final = (frozenset(LENGTHS_MM) | frozenset(FEEDS_MM_S) | FOREIGN) - frozenset(NONE)
_CELL: Final = re.compile(
    rf"({'|'.join(sorted(MEANINGS, key=len, reverse=True))})"
    r"(?:\s*\[([^\[\]()]*)\]|\s*\(([^\[\]()]*)\)|\s*[\s_/]\s*([^\[\]()]+))?"
)
_SEPARATOR: Final = re.compile(r"sep=([,;\t])")
_DATA: Final = re.compile(r"[\s\"]*[+\-.0-9]")
_COMMENTS: Final = ("#", "//", ";")


def not_poses(data: bytes) -> int:
    """So many lines beside the header are none of poses, at most: counted before the file becomes text.

    Args:
        data: the whole file, of which the first lines are looked at.
    """
    count, begin = 0, 3 * data.startswith(BOM_UTF8)
    for _ in range(PREAMBLE_MAX + 1):
        end = data.find(b"\n", begin)
        line = data[begin : min(end, begin + HEADER_MAX) if end >= 0 else begin].lstrip()
        if end < 0 or not (not line or line.startswith((b"#", b"//", b";", b"sep="))):
            break
        count, begin = count + 1, end + 1
    below = data.find(b"\n", begin) + 1
    return count + any(
        letter in data[below : below + HEADER_MAX].split(b"\n", 1)[0].lower() for letter in b"mi"
    )


@dataclass(frozen=True, slots=True)
class Header:
    """What is known of the file before its first pose.

    Attributes:
        line: of the header.
        delimiter: comma, semicolon, tab, or a space that stands for any number of them.
        names: of the columns, as the file has them, for messages.
        meanings: of the columns: ``x`` to ``k``, ``feed`` or ``number``.
        factors: by which the columns are to be multiplied, to mm and mm/s.
        rows: index of the first line of numbers, which follows header and units.
        remarks: what was understood, each with its line.
    """

    line: int
    delimiter: str
    names: tuple[str, ...]
    meanings: tuple[str, ...]
    factors: tuple[float, ...]
    rows: int
    remarks: tuple[tuple[int, str], ...]

    @property
    def columns(self) -> tuple[int, ...]:
        """Where x, y, z, i, j, k stand."""
        return tuple(self.meanings.index(meaning) for meaning in POSE)

    def place(self, line: int, column: int) -> str:
        """A number's place, for messages."""
        return f"line {line} column {self.names[column]}"


def header_of(file: object, lines: Sequence[str]) -> Header:
    """Reads comments, header and units.

    Comments and blank lines may stand before the header and nowhere else: among the poses one may be all that is
    left of a pose. Whatever a column is, its header says it.

    Args:
        file: for messages.
        lines: of the whole file.

    Raises:
        InputError: names the line, and the column where it is one, and what is accepted.
    """
    index, separator = _first(file, lines)
    text, named, remarks = lines[index] if index < len(lines) else "", index, []
    begun = index - (separator is not None)
    if begun:
        remarks.append((1, f"{begun} lines of comments, or blank ones, before the header: not read"))
    if _DATA.match(text) and index and _names_columns(lines[index - 1]):
        named, text = index - 1, lines[index - 1][1:]
        remarks = [(named + 1, "the comment before the first pose names the columns: read as the header")]
    line = named + 1
    delimiter = _delimiter(file, line, text)
    _check_comments(file, lines[:named], delimiter, separator)
    cells = _cells(text, delimiter)
    names, units = _columns(file, line, cells)
    meanings = tuple(MEANINGS[name] for name in names)
    shown_names = tuple(shown(cell.strip().strip('"').strip()) for cell in cells)
    rows = max(index, named + 1)
    below = _cells(lines[rows], delimiter) if rows < len(lines) and len(lines[rows]) <= HEADER_MAX else []
    if len(below) == len(cells) and any(_unit(cell) in _KNOWN_UNITS for cell in below):
        units = _agreed(file, rows + 1, shown_names, units, [_unit(cell) for cell in below])
        remarks.append((rows + 1, "read as a line of units"))
        rows += 1
    factors = _factors(file, line, shown_names, meanings, units)
    remarks += _remarks(line, delimiter, names, units)
    return Header(line, delimiter, shown_names, meanings, factors, rows, tuple(remarks))


def _first(file: object, lines: Sequence[str]) -> tuple[int, str | None]:
    """Index of the first line that is neither blank nor comment, and what a line ``sep=`` says."""
    found = _SEPARATOR.fullmatch(lines[0]) if lines else None
    index = 1 if found else 0
    while index < len(lines) and (not lines[index].strip() or lines[index].lstrip().startswith(_COMMENTS)):
        index += 1
        if not (index <= PREAMBLE_MAX):
            bound = f"the header {HEADER} within the first {PREAMBLE_MAX} lines"
            raise InputError(file, f"line {index}", None, bound, "remove comments and blank lines before it")
    return index, found[1] if found else None


def _names_columns(comment: str) -> bool:
    """Whether a comment is a header, as numpy's ``savetxt`` writes it."""
    if not comment.startswith("#") or len(comment) > HEADER_MAX:
        return False
    inner = [cell.strip().strip('"').casefold() for cell in re.split(r"[,;\t]", comment[1:])]
    return all(map(_CELL.fullmatch, inner if len(inner) > 1 else comment[1:].casefold().split() or [""]))


def _delimiter(file: object, line: int, text: str) -> str:
    """What separates the columns. Where commas or semicolons do, tabs and spaces only pad.

    Raises:
        InputError: both occur, or this is no header at all.
    """
    if not text.strip() or len(text) > HEADER_MAX or _DATA.match(text):
        bound = f"the header {HEADER}"
        raise InputError(file, f"line {line}", repr(text[:40]), bound, "write it as the first line")
    if "," in text and ";" in text:
        bound = "a header with one delimiter: commas or semicolons"
        raise InputError(file, f"line {line}", repr(text[:40]), bound, f"write the header {HEADER}")
    return next((mark for mark in (",", ";", "\t") if mark in text), SPACES)


def _check_comments(file: object, above: Sequence[str], delimiter: str, separator: str | None) -> None:
    """Refuses what stands above the header and does not go with its delimiter."""
    if separator is not None and separator != delimiter:
        bound = f"sep={delimiter}, for that is what separates the columns of the header"
        raise InputError(file, "line 1", repr(above[0]), bound, "correct or remove this line")
    for number, text in enumerate(above, start=1):
        if delimiter == ";" and text.lstrip().startswith(";"):
            bound = "no comment that begins with ;, for ; separates the columns"
            raise InputError(file, f"line {number}", repr(text[:40]), bound, "remove it, or begin it with #")


def _cells(text: str, delimiter: str) -> list[str]:
    return text.split() if delimiter == SPACES else text.split(delimiter)


def _columns(file: object, line: int, cells: Sequence[str]) -> tuple[list[str], list[str]]:
    """Names and units of the header's columns.

    Raises:
        InputError: a name that is not known, twice, of another family, or missing.
    """
    names, units = [], []
    for number, cell in enumerate(cells, start=1):
        inner = cell.strip()
        if len(inner) > 1 and inner.startswith('"') and inner.endswith('"'):
            inner = inner[1:-1].strip()
        found = _CELL.fullmatch(inner.casefold())
        if found is None:
            bound = f"in the header {HEADER}, a feed or a running number n (with units or without)"
            remedy = "remove the column, or name it; rotary angles are to be written as tool axes i,j,k"
            raise InputError(file, f"line {line} column {number}", repr(cell[:40]), bound, remedy)
        names.append(found[1])
        units.append((found[2] or found[3] or found[4] or "").strip())
    _check_names(file, line, names)
    return names, units


def _check_names(file: object, line: int, names: Sequence[str]) -> None:
    meanings = [MEANINGS[name] for name in names]
    for number, meaning in enumerate(meanings, start=1):
        if meaning in meanings[: number - 1]:
            other = names[meanings.index(meaning)]
            bound = f"one column of its meaning: the header has {other} already"
            place = f"line {line} column {number}"
            raise InputError(file, place, repr(names[number - 1]), bound, "remove one of them")
    if missing := [meaning for meaning in POSE if meaning not in meanings]:
        bound = f"a header with {HEADER}: {','.join(missing)} {'is' if len(missing) == 1 else 'are'} missing"
        raise InputError(file, f"line {line}", repr(",".join(names)), bound, "add what is missing")
    for families in (POSITIONS, AXES):
        used = [name for name in names if any(name in family for family in families)]
        if not any(set(used) == set(family) for family in families):
            bound = f"a header with names of one kind: {' or '.join(','.join(one) for one in families)}"
            raise InputError(file, f"line {line}", repr(",".join(used)), bound, "rename these columns")


def _unit(cell: str) -> str:
    """A cell of a line of units, without quotes and brackets."""
    inner = cell.strip().strip('"').strip().casefold()
    bracketed = len(inner) > 1 and inner[0] + inner[-1] in ("[]", "()")
    return inner[1:-1].strip() if bracketed else inner


def _agreed(
    file: object, line: int, names: Sequence[str], units: Sequence[str], below: Sequence[str]
) -> list[str]:
    """The units of header and line of units together.

    Raises:
        InputError: they say two things of a column.
    """
    for name, above, under in zip(names, units, below, strict=True):
        if above and under and above != under:
            place, bound = f"line {line} column {name}", f"{above}, as the header says"
            raise InputError(file, place, repr(under), bound, "correct one of them")
    return [above or under for above, under in zip(units, below, strict=True)]


def _factors(
    file: object, line: int, names: Sequence[str], meanings: Sequence[str], units: Sequence[str]
) -> tuple[float, ...]:
    """To mm and mm/s.

    Raises:
        InputError: a unit that is none of the column's, or three lengths in different ones.
    """
    for name, meaning, unit in zip(names, meanings, units, strict=True):
        if unit not in UNITS[meaning]:
            place, bound = f"line {line} column {name}", f"a unit: {ACCEPTED[meaning]}"
            remedy = "say the feed's unit: feed [mm/s]" if meaning == FEED and not unit else "convert it"
            raise InputError(file, place, repr(unit) if unit else "without a unit", bound, remedy)
    factors = tuple(UNITS[meaning][unit] for meaning, unit in zip(meanings, units, strict=True))
    lengths = [k for k, meaning in enumerate(meanings) if meaning in POSE[:3]]
    if odd := [k for k in lengths if factors[k] != factors[lengths[0]]]:
        place = f"line {line} column {names[odd[0]]}"
        found, bound = (
            units[odd[0]] or "without a unit",
            f"{units[lengths[0]] or 'mm'}, as {names[lengths[0]]} is",
        )
        raise InputError(file, place, found, bound, "name the same unit for x, y and z")
    return factors


_DELIMITERS: Final = {";": "semicolons", "\t": "tabs", SPACES: "spaces"}


def _remarks(line: int, delimiter: str, names: Sequence[str], units: Sequence[str]) -> list[tuple[int, str]]:
    """What was understood of the header that the plain form does not say."""
    meanings = [MEANINGS[name] for name in names]
    words = [f"columns are separated by {_DELIMITERS[delimiter]}"] if delimiter != "," else []
    pose = [name for name, meaning in zip(names, meanings, strict=True) if meaning in POSE]
    if pose != list(POSE):
        read = [meaning for meaning in meanings if meaning in POSE]
        words.append(f"columns {','.join(pose)} are read as {','.join(read)}")
    unit = units[meanings.index("x")]
    if LENGTHS_MM[unit] != 1.0:
        words.append(f"lengths are in {unit}: multiplied by {LENGTHS_MM[unit]:g} to mm")
    for name, meaning, written in zip(names, meanings, units, strict=True):
        if meaning == FEED:
            words.append(f"column {name} is the feed in {written} of the move that ends at its pose")
        elif meaning == NUMBER:
            words.append(f"column {name} is a running number: not used")
    return [(line, text) for text in words]
