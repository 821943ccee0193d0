"""Plain decimal numbers of text files, as the doubles they stand for."""

import math
import re
from collections.abc import Sequence
from typing import Final

from cutgate.config.refusal import InputError

DIGITS_MAX: Final = 60
"""Characters of one number: a double needs 25 at most."""
_NUMBER: Final = re.compile(r"[+-]?+(?:[0-9]++(?:\.[0-9]*+)?+|\.[0-9]++)(?:[eE][+-]?+[0-9]++)?+")


def numbers_of(file: object, place: str, cells: Sequence[str]) -> tuple[float, ...]:
    """Each cell as a number.

    Args:
        file: for messages.
        place: where the cells stand in it, for messages.
        cells: without the blanks around them.

    Raises:
        InputError: names the first that is not a finite plain decimal number, or is too long for one.
    """
    for number, cell in enumerate(cells, start=1):
        where = f"{place} number {number}"
        if not (len(cell) <= DIGITS_MAX):
            bound = f"at most {DIGITS_MAX} characters long"
            raise InputError(
                file, where, f"{len(cell)} characters", bound, "write 17 digits: a double has no more"
            )
        if _NUMBER.fullmatch(cell) is None or not math.isfinite(float(cell)):
            raise InputError(file, where, repr(cell), "a finite decimal number", "correct it")
    return tuple(map(float, cells))
