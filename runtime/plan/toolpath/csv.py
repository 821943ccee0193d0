"""Tool paths as CSV: a header that names x, y, z and i, j, k, and one pose a line.

The plain form is ``x,y,z,i,j,k``, mm and unit tool axis, six decimal numbers a line. What programs make of it is read
where it can mean one thing only: another delimiter, decimal commas, quotes, units, the columns' order, a feed.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cutgate.config.load import InputError, decode
from cutgate.protocol.arrays import Floats
from cutgate.runtime.plan.poses import poses_of, shorter
from cutgate.runtime.plan.toolpath.csv_header import (
    FEED,
    HEADER,
    NUMBER,
    SPACES,
    Header,
    header_of,
    not_poses,
)
from cutgate.runtime.plan.toolpath.model import Cut, Reading, Told, ToolPath

FEED_MM_S: Final = (0.001, 10_000.0)
_PLAIN: Final = Header(1, ",", tuple("xyzijk"), tuple("xyzijk"), (1.0,) * 6, 1, ())


def _number(sign: str, pad: str) -> str:
    """A decimal number with this decimal sign.

    Nothing that was matched is given back: a line takes time in proportion to its length, whatever stands in it.
    """
    digits = rf"(?:[0-9]++(?:{sign}[0-9]*+)?+|{sign}[0-9]++)"
    return rf"{pad}*+[+-]?+{digits}(?:[eE][+-]?+[0-9]++)?+{pad}*+"


_POINT, _COMMA = r"\.", ","
_PADDING: Final = {",": r"[ \t]", ";": r"[ \t]", "\t": " ", SPACES: "(?!)"}
_GAP: Final = re.compile(r"[ \t]+")
_DECIMAL: Final = re.compile(r"[.,]")
_PROVES_COMMA: Final = re.compile(r"(?<![0-9])(?:0[0-9]*|[0-9]{4,})?,|,(?![0-9]{3}(?![0-9]))")
"""A comma that parts no thousands: nothing, a zero or too many digits before it, or not three behind it."""


@dataclass(frozen=True, slots=True)
class _Form:
    """How the numbers of a file are written.

    Attributes:
        header: columns and their delimiter.
        sign: of decimals, as a regular expression.
        quoted: of each column, whether its numbers stand in quotes.
    """

    header: Header
    sign: str
    quoted: tuple[bool, ...]

    def cell(self, column: int, sign: str = "") -> re.Pattern[str]:
        """A number of this column."""
        number = _number(sign or self.sign, pad := _PADDING[self.header.delimiter])
        return re.compile(f'{pad}*+"{number}"{pad}*+' if self.quoted[column] else number)

    def line(self) -> re.Pattern[str]:
        """A whole line of numbers."""
        cells = (self.cell(column).pattern for column in range(len(self.quoted)))
        spaced, gap = self.header.delimiter == SPACES, r"[ \t]"
        return re.compile(
            f"{gap}*+{f'{gap}++'.join(cells)}{gap}*+" if spaced else self.header.delimiter.join(cells)
        )


def read_csv(file: object, data: bytes, reading: Reading, pose_limit: int, told: Told | None) -> ToolPath:  # noqa: ARG001 - a `Reader`
    """The poses of a CSV tool path.

    Nothing is skipped among the poses and nothing is guessed: every line below the header is a pose, only the last
    one may be empty. What differs from the plain form is told.

    Raises:
        InputError: names the line and the column, the value and what was expected.
    """
    _check_count(file, data.count(b"\n") - data.endswith(b"\n"), pose_limit, not_poses(data))
    lines = decode(file, data).split("\n")
    lines = [line.removesuffix("\r") for line in lines]
    if lines[-1] == "":
        lines.pop()
    form = _form(file, lines)
    header = form.header
    rows = lines[header.rows :]
    _check_count(file, len(rows), pose_limit)
    _check_lines(file, form, rows)
    table = _table(form, rows)
    _check_comma(file, form, rows)
    _check_running(file, header, table)
    feeds = _feeds(file, header, table)
    poses = table[:, header.columns]
    if set(header.factors) != {1.0}:
        poses *= np.array([header.factors[column] for column in header.columns])
    tips, axes = poses_of(file, poses, lambda index: f"line {header.rows + index + 1}")
    _tell(told, form, rows)
    positioning = np.zeros(len(tips), dtype=np.bool_)
    positioning[0] = True
    numbers = np.arange(header.rows + 1, header.rows + len(tips) + 1)
    return ToolPath((Cut("", None, tips, axes, numbers, positioning, feeds),))


def _check_count(file: object, count: int, pose_limit: int, beside: int = 0) -> None:
    """Refuses more lines than the limit; ``beside`` may be something else. Before so many lines become strings."""
    if not (count <= pose_limit + beside):
        raise InputError(file, "poses", f"{count} poses", f"<= {pose_limit} poses", shorter(pose_limit))


def _form(file: object, lines: Sequence[str]) -> _Form:
    """How this file is written: the plain form without ado, else what header and numbers say."""
    plain = _Form(_PLAIN, _POINT, (False,) * 6)
    if lines and [name.strip() for name in lines[0].split(",", 6)] == HEADER.split(","):
        first = lines[1] if len(lines) > 1 else None
        if first is None or plain.line().fullmatch(first):
            return plain
    header = header_of(file, lines)
    sign = _POINT
    if header.delimiter in (";", "\t"):
        found = next(filter(None, map(_DECIMAL.search, lines[header.rows :])), None)
        sign = _COMMA if found and found[0] == "," else _POINT
    cells = _cells(lines[header.rows], header) if header.rows < len(lines) else []
    count = len(header.names)
    quoted = tuple('"' in cell for cell in cells) if len(cells) == count else (False,) * count
    return _Form(header, sign, quoted)


def _cells(line: str, header: Header) -> list[str]:
    """The line's cells, no more than one too many."""
    count = len(header.names)
    if header.delimiter == SPACES:
        return _GAP.split(line.strip(" \t"), count)
    return line.split(header.delimiter, count)


def _check_lines(file: object, form: _Form, rows: Sequence[str]) -> None:
    matches = form.line().fullmatch
    for number, line in enumerate(rows, start=form.header.rows + 1):
        if matches(line) is None:
            raise _bad_line(file, form, number, line)


def _bad_line(file: object, form: _Form, number: int, line: str) -> InputError:
    """What is wrong with a line that is not one number for each column."""
    header, expected = form.header, len(form.quoted)
    spaced = header.delimiter == SPACES
    fields = 1 + (
        sum(1 for _ in _GAP.finditer(line.strip(" \t"))) if spaced else line.count(header.delimiter)
    )
    names = ",".join(header.names)
    if fields != expected:
        found = f"{fields} fields" if line.strip() else "empty"
        remedy = "complete or remove the line"
        if header.delimiter == "," and fields > expected:
            remedy += "; where a comma is the decimal sign, separate the columns by semicolons"
        bound = f"{'six' if expected == 6 else expected} numbers {names}"
        return InputError(file, f"line {number}", found, bound, remedy)
    cells = _cells(line, header)
    column = next(k for k, cell in enumerate(cells) if not form.cell(k).fullmatch(cell))
    cell, bound = cells[column], "a finite decimal number"
    other = _COMMA if form.sign == _POINT else _POINT
    remedy = "correct it"
    if form.quoted[column] and '"' not in cell:
        bound, remedy = (
            f"in quotes, as in line {header.rows + 1}",
            "quote all numbers of this column, or none",
        )
    elif '"' in cell and not form.quoted[column]:
        remedy = "write it without quotes"
    elif "." in cell and "," in cell:
        remedy = "write no signs between thousands, and a decimal point"
    elif form.cell(column, other).fullmatch(cell):
        remedy = "write decimal points"
        if header.delimiter in (";", "\t"):
            bound = (
                f"a number with a decimal {'point' if form.sign == _POINT else 'comma'}, as those before it"
            )
            remedy += " in the whole file"
    return InputError(file, header.place(number, column), repr(cell), bound, remedy)


def _table(form: _Form, rows: Sequence[str]) -> Floats:
    """The numbers of checked lines, shape (n, columns)."""
    header = form.header
    if header.delimiter == SPACES:
        cells = " ".join(rows).split()
    else:
        text = header.delimiter.join(rows)
        if any(form.quoted):
            text = text.replace('"', "")
        if form.sign == _COMMA:
            text = text.replace(",", ".")
        cells = text.split(header.delimiter) if rows else []
    count = len(header.names)
    return np.fromiter(map(float, cells), np.float64, count * len(rows)).reshape(-1, count)


def _check_comma(file: object, form: _Form, rows: Sequence[str]) -> None:
    """Refuses decimal commas of which each may as well part thousands: 1,234 is 1.234 to some, 1234 to others."""
    if form.sign == _COMMA and not any(map(_PROVES_COMMA.search, rows)):
        index, row = next((index, row) for index, row in enumerate(rows) if "," in row)
        cells = _cells(row, form.header)
        column = next(k for k, cell in enumerate(cells) if "," in cell)
        place = form.header.place(form.header.rows + index + 1, column)
        bound = "a number whose comma can only be a decimal one, here or in another line"
        remedy = "write decimal points, and no signs between thousands"
        raise InputError(file, place, repr(cells[column]), bound, remedy)


def _check_running(file: object, header: Header, table: Floats) -> None:
    """Refuses a running number that does not run: lines are missing or in another order.

    Raises:
        InputError: names the first line that is out of its place.
    """
    if NUMBER not in header.meanings or not len(table):
        return
    column = header.meanings.index(NUMBER)
    numbers: Floats = table[:, column]
    with np.errstate(invalid="ignore", over="ignore"):  # NaN of infinite ones is no step either
        step = numbers[1] - numbers[0] if len(numbers) > 1 else 1.0
        good = (numbers == np.rint(numbers)) & (np.abs(numbers) < 2.0**53)
        good[1:] &= (np.diff(numbers) == step) & (step > 0.0)
    if not good.all():
        index = int(np.argmin(good))
        place, found = header.place(header.rows + index + 1, column), f"{numbers[index]:.15g}"
        bound = "a running number: whole, and growing by the same from line to line"
        raise InputError(file, place, found, bound, "see whether lines are missing, or remove the column")


def _feeds(file: object, header: Header, table: Floats) -> Floats:
    """Of the move that ends at each pose, mm/s; NaN of the first, to which no move leads, and where there are none.

    Raises:
        InputError: no feed at all, or beyond the bounds of a plan's.
    """
    if FEED not in header.meanings:
        return np.full(len(table), np.nan)
    column, (low, high) = header.meanings.index(FEED), FEED_MM_S
    feeds: Floats = table[:, column] * header.factors[column]
    feeds[:1] = np.nan
    good: NDArray[np.bool_] = (feeds >= low) & (feeds <= high)
    good[:1] = True
    if not good.all():
        index = int(np.argmin(good))
        place = header.place(header.rows + index + 1, column)
        bound = f"a feed within {low:g} to {high:g} mm/s"
        raise InputError(file, place, f"{feeds[index]:.6g} mm/s", bound, "correct it, or the feed's unit")
    return feeds


def _tell(told: Told | None, form: _Form, rows: Sequence[str]) -> None:
    """Says what was understood that the plain form does not say."""
    if told is None:
        return
    header = form.header
    for line, text in header.remarks:
        told(line, text)
    if any(form.quoted):
        told(header.rows + 1, "numbers in quotes are read as numbers")
    if form.sign == _COMMA:
        index = next(index for index, row in enumerate(rows) if "," in row)
        told(header.rows + index + 1, "commas in numbers are decimal signs")
