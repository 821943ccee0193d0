"""Rows of six numbers, as files have them, to tips and unit tool axes."""

from collections.abc import Callable, Sequence
from itertools import chain
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cutgate.config.constants import CONSTANTS
from cutgate.config.refusal import InputError, shown
from cutgate.protocol.arrays import Floats

COORDINATE_MM: Final = 10_000.0
UNIT_AXIS: Final = 1e-3
AXIS_DECIMALS: Final = 4
"""So many are enough for an axis to be of length 1."""
NUMBERS: Final = frozenset({int, float})


def shorter(pose_limit: int) -> str:
    """What to do about a path of more poses than the limit: no site can raise it beyond what the wire carries."""
    part = "part the path"
    return part if pose_limit >= CONSTANTS["pose_limit"].high else f"raise pose_limit in site.toml, or {part}"


def table_of(file: object, rows: Sequence[Any], place: Callable[[int], str]) -> Floats:
    """Rows of six numbers, as JSON has them, as one array of shape (n, 6).

    Raises:
        InputError: names the first row that is not six numbers (true, false and text are none).
    """
    bound = "six numbers x, y, z, i, j, k"
    for index, row in enumerate(rows):
        if not (type(row) is list and len(row) == 6 and NUMBERS.issuperset(map(type, row))):
            quotes = type(row) is list and str in set(map(type, row))
            remedy = "write its numbers without quotes" if quotes else "correct this pose"
            raise InputError(file, place(index), row, bound, remedy)
    try:
        return np.fromiter(chain.from_iterable(rows), np.float64, 6 * len(rows)).reshape(-1, 6)
    except OverflowError:
        found = "an integer no double can hold"
        raise InputError(file, "poses", found, f"within +-{COORDINATE_MM:g}", "lengths are mm") from None


def poses_of(file: object, table: Floats, place: Callable[[int], str]) -> tuple[Floats, Floats]:
    """Tips (n, 3) mm and unit axes (n, 3) of rows ``x, y, z, i, j, k``.

    Args:
        file: for messages.
        table: shape (n, 6).
        place: where row ``n`` stands in the file, for messages.

    Raises:
        InputError: fewer than two rows, not finite, too far out, or an axis that is not of length 1 within 1e-3.
    """
    if not (len(table) >= 2):
        raise InputError(file, "poses", f"{len(table)} poses", ">= 2 poses", "a path needs two poses or more")
    inside = np.isfinite(table) & (np.abs(table) <= COORDINATE_MM)
    bad = np.flatnonzero(~inside.all(axis=1))
    if bad.size:
        bound = f"six finite numbers within +-{COORDINATE_MM:g}"
        found = _and_more(table[bad[0]].tolist(), bad)
        raise InputError(file, place(int(bad[0])), found, bound, "lengths are mm")
    lengths = np.linalg.norm(table[:, 3:], axis=1)
    bad = np.flatnonzero(~(np.abs(lengths - 1.0) <= UNIT_AXIS))
    if bad.size:
        found = _and_more(f"of length {lengths[bad[0]]:.6g}", bad)
        bound = f"a tool axis i, j, k of length 1 within {UNIT_AXIS:g}"
        raise InputError(
            file,
            place(int(bad[0])),
            found,
            bound,
            f"normalise the tool axis, with {AXIS_DECIMALS} decimals or more",
        )
    return table[:, :3].copy(), table[:, 3:] / lengths[:, None]


def _and_more(found: object, bad: NDArray[np.intp]) -> str:
    """The first bad row's value, and how many rows more are bad."""
    return shown(found) + (f" ({bad.size - 1} more like it)" if bad.size > 1 else "")
