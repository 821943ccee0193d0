"""Pieces of a path, in runs that follow each other: whole segments, or parts of some."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from cutgate.protocol.arrays import Floats, Ints
from cutgate.runtime.kinematics.pose import slerp
from cutgate.runtime.verification.bounds.geometry import Segments

PARTS: Final = 8
"""What is cut is cut into so many, a power of two: fractions stay exact."""


@dataclass(frozen=True, slots=True)
class Pieces:
    """Pieces of the path in runs of k that follow each other, all of a run equally long; arrays by run, then by piece or end of one.

    Attributes:
        segment: number of the segment in which each run begins, shape (runs,).
        s0: where in it, shape (runs,).
        width: how long its pieces are, as a part of a segment, shape (runs,).
        tip, axis: at the ends, shape (3, runs, k + 1).
        theta, seconds: of the pieces, shape (runs, k).
        follow: q0 and q3 at the beginning of each run, or near, shape (runs, 1).
    """

    segment: Ints
    s0: Floats
    width: Floats
    tip: Floats
    axis: Floats
    theta: Floats
    seconds: Floats
    follow: tuple[Floats, Floats]

    @classmethod
    def whole(cls, segments: Segments, part: slice, follow: tuple[Floats, Floats]) -> Pieces:
        """Consecutive segments, one run."""
        ends = slice(part.start, part.stop + 1)
        return cls(
            np.array([part.start]),
            np.zeros(1),
            np.ones(1),
            np.ascontiguousarray(segments.tip[ends].T)[:, None],
            np.ascontiguousarray(segments.axis[ends].T)[:, None],
            segments.theta[None, part],
            segments.seconds[None, part],
            follow,
        )

    @classmethod
    def parted(cls, segments: Segments, part: slice, follow: tuple[Floats, Floats]) -> Pieces:
        """Consecutive segments, each cut into `PARTS`, one run."""
        numbers = np.arange(part.start, part.stop)
        tip, axis = _between(segments, numbers, np.zeros(len(numbers)), np.full(len(numbers), 1.0 / PARTS))
        tip, axis = (
            np.append(a[:, :, :-1].reshape(3, -1), b[part.stop][:, None], axis=1)[:, None]
            for a, b in ((tip, segments.tip), (axis, segments.axis))
        )
        theta, seconds = (np.repeat(a[part] / PARTS, PARTS)[None] for a in (segments.theta, segments.seconds))
        start, s0, width = np.array([part.start]), np.zeros(1), np.full(1, 1.0 / PARTS)
        return cls(start, s0, width, tip, axis, theta, seconds, follow)

    def cut(self, segments: Segments, pieces: Ints, joints: list[Floats]) -> Pieces:
        """Some of the pieces, each cut into `PARTS`, a run of its own."""
        a_run = self.theta.shape[1]
        segment, s0 = self.places(pieces, a_run)
        run, piece = np.divmod(pieces, a_run)
        width = self.width[run] / PARTS
        tip, axis = _between(segments, segment, s0, width)
        share = np.repeat(width[:, None], PARTS, axis=1)
        theta, seconds = segments.theta[segment][:, None] * share, segments.seconds[segment][:, None] * share
        follow = (joints[0][run, piece][:, None], joints[3][run, piece][:, None])
        return Pieces(segment, s0, width, tip, axis, theta, seconds, follow)

    def places(self, index: Ints, a_run: int) -> tuple[Ints, Floats]:
        """Segment and fraction where pieces begin (``a_run`` is k), or of their ends (k + 1). Halves and eighths are exact."""
        run, piece = np.divmod(index, a_run)
        along = self.s0[run] + self.width[run] * piece
        whole = np.floor(along)
        return self.segment[run] + whole.astype(np.int64), along - whole


def _between(segments: Segments, segment: Ints, s0: Floats, width: Floats) -> tuple[Floats, Floats]:
    """Tip and axis at the `PARTS` + 1 ends in parts of segments, shape (3, m, PARTS + 1)."""
    s = s0[:, None] + width[:, None] * np.arange(PARTS + 1)
    first, last = segments.tip[segment].T[:, :, None], segments.tip[segment + 1].T[:, :, None]
    every = np.repeat(segment, PARTS + 1)
    axis = slerp(segments.axis[every], segments.axis[every + 1], segments.theta[every], s.ravel())
    return first + s * (last - first), np.ascontiguousarray(axis.T).reshape(3, len(segment), PARTS + 1)
