"""The least value found of each quantity, and how close to it a bound must be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cutgate.protocol.arrays import Floats, Ints
from cutgate.runtime.verification.bounds.enclosures import COLUMNS

ROUND, INTERVAL = 5000, 6
"""Work of each round of a survey and of each interval in it, as `Effort` counts it."""


@dataclass(frozen=True, slots=True)
class Aim:
    """How far to refine each column; arrays of shape (COLUMNS,).

    Attributes:
        gap: bounds this close below the least attained value are close enough ...
        share: ... and so are those within this part of it ...
        missed: ... or within this part, once it has missed its target.
        target: the value to keep; while a bound is below and the attained value above it, go on ...
        fine: ... until they are this close: undecided.
    """

    gap: Floats
    share: Floats
    missed: Floats
    target: Floats
    fine: Floats

    def enough(self, best: Floats) -> Floats:
        """What a bound must reach where only closeness to the least attained value counts, shape (COLUMNS,)."""
        size = np.abs(np.where(np.isfinite(best), best, 0.0))
        part = np.where(best < self.target, self.missed, self.share)
        out: Floats = best - np.maximum(self.gap, part * size)
        return out


class Minima:
    """Minima attained value of each column and its place."""

    def __init__(self) -> None:
        self.value = np.full(COLUMNS, np.inf)
        self.segment = np.zeros(COLUMNS, dtype=np.int64)
        self.fraction = np.zeros(COLUMNS)

    def offer(self, first: int, values: Floats, segment: Ints, fraction: Floats) -> None:
        """Take values (m, columns) of the columns from ``first`` on where they are smaller."""
        if len(values) == 0:
            return
        rows = np.argmin(values, axis=0)
        for i, row in enumerate(rows):
            if values[row, i] < self.value[first + i]:
                self.value[first + i] = values[row, i]
                self.segment[first + i] = segment[row]
                self.fraction[first + i] = fraction[row]

    def one(self, column: int, value: float, segment: int, fraction: float) -> None:
        """Take one value of one column where it is smaller."""
        if value < self.value[column]:
            self.value[column], self.segment[column], self.fraction[column] = value, segment, fraction
