"""A cut as CSV, in the plain form, from which the same poses are read again."""

from typing import Final

import numpy as np

from cutgate.protocol.arrays import Floats
from cutgate.runtime.plan.toolpath.csv_header import HEADER
from cutgate.runtime.plan.toolpath.model import Cut

STRETCHES: Final = 4096
"""So many lengths of an axis are tried; of 200 000 random axes none needed more than 224."""


def write_csv(cut: Cut) -> bytes:
    """The poses of a cut, each number with as many digits as tell it from every other.

    Poses are all that is written: no tool, feed, tolerance, nor which moves position. They are read again to the last
    bit, where the axes are what normalising gives; an axis that it never gives is read a rounding off.
    """
    rows = np.concatenate([cut.tips_mm, _giving_back(cut.axes)], axis=1).tolist()
    return "\n".join([HEADER, *(",".join(map(repr, row)) for row in rows), ""]).encode()


def _giving_back(axes: Floats) -> Floats:
    """Axes, shape (n, 3), that a reader normalises to these, to the last bit.

    Who normalises a normalised axis anew often changes its last bit. A slightly longer axis of the same direction is
    rounded otherwise: among many such there is one that comes out right.
    """
    written = axes.copy()
    left = np.arange(len(axes))
    for stretch in range(STRETCHES):
        tried = axes[left] * (1.0 + stretch * 2.0**-22)
        same = (tried / np.linalg.norm(tried, axis=1)[:, None] == axes[left]).all(axis=1)
        written[left[same]] = tried[same]
        left = left[~same]
        if not left.size:
            break
    return written
