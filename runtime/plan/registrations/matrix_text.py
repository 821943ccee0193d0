"""A plain 4x4 matrix as text (``.txt``, ``.mat``): four lines of four numbers, row by row."""

import re
from typing import Final

import numpy as np

from cutgate.config.refusal import InputError, shown
from cutgate.protocol.arrays import Floats
from cutgate.runtime.plan.registrations.numbers import numbers_of
from cutgate.runtime.plan.registrations.rigid import check_rigid
from cutgate.runtime.plan.transform import LAST_ROW

LINES_MAX: Final = 100
"""Empty ones included."""
_SEPARATOR: Final = re.compile(r"[ \t]*+,[ \t]*+|[ \t]++")
_CHARACTERS_MAX: Final = 1000
"""Of one line."""


def read_matrix(file: object, text: str) -> Floats:
    """The matrix, shape (4, 4), numbers separated by blanks or commas; empty lines are none of it.

    Raises:
        InputError: names the line, or what the matrix is instead of a rigid one.
    """
    if not (text.count("\n") <= LINES_MAX):
        bound = f"four lines of four numbers, {LINES_MAX} lines at most with the empty ones"
        raise InputError(file, "", f"{text.count(chr(10))} lines", bound, "name a file of one matrix")
    lines = [(number, line.strip()) for number, line in enumerate(text.split("\n"), start=1) if line.strip()]
    rows = [_row(file, f"line {number}", line) for number, line in lines]
    if len(rows) != 4:
        raise InputError(file, "", f"{len(rows)} rows", "four lines of four numbers", "write the 4x4 matrix")
    if rows[3] != LAST_ROW:
        remedy = "write the matrix row by row: the translation is its last column"
        raise InputError(file, f"line {lines[3][0]}", shown(list(rows[3])), "0 0 0 1", remedy)
    matrix = np.array(rows)
    check_rigid(file, "matrix", matrix)
    return matrix


def _row(file: object, place: str, line: str) -> tuple[float, ...]:
    bound, remedy = "four numbers", "write them without brackets or comments"
    if not (len(line) <= _CHARACTERS_MAX):
        raise InputError(file, place, f"{len(line)} characters", bound, remedy)
    cells = _SEPARATOR.split(line)
    if len(cells) != 4:
        raise InputError(file, place, f"{len(cells)} numbers", bound, remedy)
    return numbers_of(file, place, cells)
