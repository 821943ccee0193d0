"""Tool paths as CSV: header ``x,y,z,i,j,k``, one pose a line, mm and unit tool axis."""

import re
from typing import Final

import numpy as np

from cutgate.config.load import InputError, decode
from cutgate.runtime.plan.poses import poses_of, shorter
from cutgate.runtime.plan.toolpath.model import Cut, Reading, Told, ToolPath

HEADER: Final = "x,y,z,i,j,k"
_NUMBER: Final = r"[ \t]*+[+-]?+(?:[0-9]++(?:\.[0-9]*+)?+|\.[0-9]++)(?:[eE][+-]?+[0-9]++)?+[ \t]*+"
"""Nothing that was matched is given back: a line takes time in proportion to its length, whatever stands in it."""
_LINE: Final = re.compile(f"{_NUMBER}(?:,{_NUMBER}){{5}}")
_CELL: Final = re.compile(_NUMBER)


def read_csv(file: object, data: bytes, reading: Reading, pose_limit: int, told: Told | None) -> ToolPath:  # noqa: ARG001 - a `Reader`
    """The poses of a CSV tool path.

    Strict: this header, six plain decimal numbers in every line, no blank or comment lines; only the last
    line may be empty. Nothing is skipped and nothing is guessed.

    Raises:
        InputError: names the line, its value and what was expected.
    """
    count = data.count(b"\n") - data.endswith(
        b"\n"
    )  # without the header; before so many lines become strings
    if not (count <= pose_limit):
        raise InputError(file, "poses", f"{count} poses", f"<= {pose_limit} poses", shorter(pose_limit))
    lines = decode(file, data).split("\n")
    lines = [line.removesuffix("\r") for line in lines]
    if lines[-1] == "":
        lines.pop()
    header = lines[0] if lines else ""
    if [name.strip() for name in header.split(",", 6)] != HEADER.split(","):
        raise InputError(
            file,
            "line 1",
            repr(header[:40]),
            f"the header {HEADER}",
            "write it as the first line, without quotes",
        )
    rows = lines[1:]
    for number, line in enumerate(rows, start=2):
        if _LINE.fullmatch(line) is None:
            raise _bad_line(file, number, line)
    cells = map(float, ",".join(rows).split(",")) if rows else ()
    table = np.fromiter(cells, np.float64, 6 * len(rows)).reshape(-1, 6)
    tips, axes = poses_of(file, table, lambda index: f"line {index + 2}")
    positioning = np.zeros(len(tips), dtype=np.bool_)
    positioning[0] = True
    feeds = np.full(len(tips), np.nan)
    return ToolPath((Cut("", None, tips, axes, np.arange(2, len(tips) + 2), positioning, feeds),))


def _bad_line(file: object, number: int, line: str) -> InputError:
    """What is wrong with a line that is not six numbers."""
    fields = line.count(",") + 1
    if fields != 6:
        found = f"{fields} fields" if line.strip() else "empty"
        return InputError(
            file, f"line {number}", found, f"six numbers {HEADER}", "complete or remove the line"
        )
    column, cell = next(
        (name, cell)
        for name, cell in zip(HEADER.split(","), line.split(","), strict=True)
        if not _CELL.fullmatch(cell)
    )
    remedy = "write it without quotes" if '"' in cell else "correct it"
    return InputError(file, f"line {number} column {column}", repr(cell), "a finite decimal number", remedy)
