"""Curves of any length as a bounded number of points, in which every extreme is kept. Pure."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

ROWS_MAX: Final = 2000
"""Of one plot."""


class Curves:
    """Columns of numbers over one axis, row by row; of more than `ROWS_MAX` those that no column misses are left out."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        self._rows: list[tuple[float | None, ...]] = []

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, at: float, values: Mapping[str, float | None]) -> None:
        """The next row; what is absent or not finite is undefined."""
        self._rows.append((at, *(_finite(values.get(name)) for name in self.names)))
        # Groups are as long as would halve them if every column kept two rows of its own.
        if len(self._rows) > ROWS_MAX:
            self._rows = thinned(self._rows, 4 * len(self.names) + 4)

    def document(self, decimals: int, *, down: bool = False) -> dict[str, Any]:
        """``x`` and one list of ``values`` a column, with null where undefined.

        Args:
            decimals: that are kept.
            down: no value is shown as more than it is, as clearances must not be.
        """
        columns = list(zip(*self._rows, strict=True)) if self._rows else [()] * (1 + len(self.names))
        return {
            "x": [_rounded(x, decimals) for x in columns[0]],
            "series": [
                {"name": name, "values": [_rounded(value, decimals, down=down) for value in column]}
                for name, column in zip(self.names, columns[1:], strict=True)
            ],
        }


def thinned(rows: list[tuple[float | None, ...]], size: int) -> list[tuple[float | None, ...]]:
    """Of each group of so many rows the first, the last, and those with the least or the largest of a column."""
    out = []
    for begin in range(0, len(rows), size):
        group = rows[begin : begin + size]
        kept = {0, len(group) - 1}
        for column in range(1, len(group[0])):
            known = [(value, k) for k, row in enumerate(group) if (value := row[column]) is not None]
            if known:
                kept |= {min(known)[1], max(known)[1]}
        out += [group[k] for k in sorted(kept)]
    return out


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def _rounded(value: float | None, decimals: int, *, down: bool = False) -> float | None:
    if value is None:
        return None
    return math.floor(value * 10**decimals) / 10**decimals if down else round(value, decimals)
