"""Landmarks that were touched in both frames, as CSV: ``id,ct_x,ct_y,ct_z,robot_x,robot_y,robot_z[,use]``, mm."""

import csv
import io
from typing import Final, NamedTuple

from cutgate.config.load import check_size, decode
from cutgate.config.refusal import InputError
from cutgate.runtime.plan.registration import POINT_NAME_MAX
from cutgate.runtime.plan.registrations.numbers import numbers_of
from cutgate.runtime.plan.transform import TRANSLATION_MM

COORDINATES: Final = ("ct_x", "ct_y", "ct_z", "robot_x", "robot_y", "robot_z")
USES: Final = ("fit", "check")
LANDMARKS_MAX: Final = 1000
_HEADER: Final = ("id", *COORDINATES)
_HEADERS: Final = (_HEADER, (*_HEADER, "use"))
_HEADER_TEXT: Final = f"the header {','.join(_HEADER)}, or the same with ,use"

Point = tuple[float, float, float]


class Landmark(NamedTuple):
    """One landmark: where it is in CT and in robot coordinates, mm, and whether it is held out of the fit."""

    id: str
    ct_mm: Point
    robot_mm: Point
    held_out: bool


def read_landmarks(file: object, data: bytes) -> tuple[Landmark, ...]:
    """The landmarks in the order of the file.

    Strict: this header, every field in every line, no blank lines but at the end. Nothing is skipped.

    Raises:
        InputError: names the line, the value and what was expected.
    """
    check_size(file, len(data))
    rows = _rows(file, decode(file, data).rstrip("\r\n"))
    header = tuple(name.strip() for name in rows[0][1]) if rows else ()
    if header not in _HEADERS:
        found = repr(",".join(header)[:60])
        raise InputError(file, "line 1", found, _HEADER_TEXT, "write it as the first line")
    if not (len(rows) - 1 <= LANDMARKS_MAX):
        bound = f"<= {LANDMARKS_MAX} landmarks"
        raise InputError(file, "", f"{len(rows) - 1} landmarks", bound, "leave some out")
    found_at: dict[str, int] = {}
    return tuple(_landmark(file, line, row, header, found_at) for line, row in rows[1:])


def _rows(file: object, text: str) -> list[tuple[int, list[str]]]:
    """Each row with the number of the line in which it begins."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    rows, line = [], 1
    try:
        for row in reader:
            rows.append((line, row))
            line = reader.line_num + 1
    except csv.Error as error:
        bound = "comma-separated values"
        raise InputError(
            file, f"line {reader.line_num}", str(error), bound, "correct its quotation marks"
        ) from None
    return rows


def _landmark(
    file: object, line: int, row: list[str], header: tuple[str, ...], found_at: dict[str, int]
) -> Landmark:
    place = f"line {line}"
    if len(row) != len(header):
        found = f"{len(row)} fields" if row else "empty"
        raise InputError(file, place, found, f"{len(header)} fields", "complete or remove the line")
    name = row[0].strip()
    if not (1 <= len(name) <= POINT_NAME_MAX):
        bound = f"1 to {POINT_NAME_MAX} characters"
        raise InputError(file, f"{place} id", f"of {len(name)} characters", bound, "give the landmark a name")
    if name in found_at:
        bound = f"another name than line {found_at[name]} has"
        raise InputError(file, f"{place} id", repr(name), bound, "give each landmark a name of its own")
    found_at[name] = line
    numbers = numbers_of(file, place, [cell.strip() for cell in row[1:7]])
    for column, number in zip(COORDINATES, numbers, strict=True):
        if not (abs(number) <= TRANSLATION_MM):
            bound = f"within +-{TRANSLATION_MM:g} mm"
            raise InputError(file, f"{place} {column}", f"{number:g}", bound, "lengths are mm")
    use = row[7].strip() if len(row) > 7 else ""
    if use not in ("", *USES):
        bound = "fit, check, or nothing, which is fit"
        raise InputError(file, f"{place} use", repr(use), bound, "say which of the two it is for")
    x, y, z, u, v, w = numbers
    return Landmark(name, (x, y, z), (u, v, w), use == "check")
