"""The smallest translation of the bone, with a proof of how small, by branch and bound.

The length of the translation that belongs to a shift ``p`` is the distance of the origin from the straight
segment ``(p + h tilt, h)`` over the lifts h that the slide allows, hence 1-Lipschitz in p. Squares of shifts
are worked off by the least length in them; one is dropped when it is proved that no shift in it fits, or
that none is shorter than the best found. Nothing left proves that no translation fits. A few Newton steps come
first: a best that is near the shortest from the start leaves little to be divided. All work is counted
(`Effort` of the placing); where that is spent, what has been seen until then proves as much as it can.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cutgate.protocol.arrays import Bools, Floats
from cutgate.runtime.verification.effort import EffortSpentError
from cutgate.runtime.verification.placing.freedom import Placing

TOLERANCE_MM = 0.05
"""The translation found is longer than the shortest by at most this, unless said otherwise."""

FINEST_MM = 0.01
"""A disc of this radius that can neither be excluded nor used stays open."""

SQUARES, SQUARES_NEAR = 6, 2
"""So many squares a side are divided first: of the domain, or of the little that is left where the best is near."""

FINER, FEW = 4, 1024
"""Where the best is near, squares are divided into so many a side if that makes no more than few; else into two."""

BATCH = 128
"""Squares divided at once."""

ROUNDING_MM = 1e-9
"""A place on a line counts as allowed by it."""

STEPS, AIM_MM = 8, 0.005
"""At most so many Newton steps come first, each aimed this far beyond what is to be kept."""


@dataclass(frozen=True, slots=True)
class Placement:
    """What a search found and what it proved.

    Attributes:
        translation_mm: shape (3,), canonical frame (right elbow); None if none was found.
        at_least_mm: every translation after which all points fit is at least this long; infinite where
            it is proved that there is none.
    """

    translation_mm: Floats | None
    at_least_mm: float

    @property
    def none_fits(self) -> bool:
        """Whether it is proved that no translation fits."""
        return self.at_least_mm == math.inf


@dataclass(frozen=True, slots=True)
class _Squares:
    """Squares of shifts: centres (k, 2), half sides (k,), least length of a translation in each (k,)."""

    centre: Floats
    half: Floats
    least: Floats

    def __len__(self) -> int:
        return len(self.half)

    @property
    def radius(self) -> Floats:
        return math.sqrt(2.0) * self.half

    def take(self, chosen: Bools | NDArray[np.intp]) -> _Squares:
        return _Squares(self.centre[chosen], self.half[chosen], self.least[chosen])

    def joined(self, other: _Squares) -> _Squares:
        return _Squares(
            np.concatenate((self.centre, other.centre)),
            np.concatenate((self.half, other.half)),
            np.concatenate((self.least, other.least)),
        )


def smallest_translation(
    placing: Placing, *, any_will_do: bool = False, finest_mm: float = FINEST_MM
) -> Placement:
    """The smallest translation after which all points of a path keep their deadbands and the reserve.

    Args:
        placing: the path's conditions, and the bound on the work.
        any_will_do: stop at the first translation that fits.
        finest_mm: radius down to which discs of shifts are divided.
    """
    least, most = placing.lift_mm
    if least > most + 2.0 * placing.pad_mm:
        return Placement(None, math.inf)
    if not least <= most:  # within rounding: no lift is known to fit, none is proved not to
        return Placement(None, 0.0)
    return _Search(placing, finest_mm).run(any_will_do=any_will_do)


class _Search:
    """One run: the open squares, the best shift so far, and the least length among those given up.

    ``near`` says that the best was found by the steps: mostly about as short as can be, and if not, squares tell.
    """

    def __init__(self, placing: Placing, finest_mm: float) -> None:
        self.placing = placing
        self.finest_mm = finest_mm
        self.best: Floats | None = None
        self.length = math.inf
        self.given_up = math.inf
        self.near = False

    def run(self, *, any_will_do: bool) -> Placement:
        """Divide until nothing can improve the best, or the work is spent: the squares left then stay open."""
        shortest = min(max(0.0, self.placing.lift_mm[0]), self.placing.lift_mm[1])  # no shift of the tips
        with suppress(EffortSpentError):
            self._approach(-shortest * self.placing.geometry.tilt, 0 if any_will_do else STEPS)
        self.near = self.best is not None
        self.squares = self._first()
        with suppress(EffortSpentError):
            self._divide(any_will_do=any_will_do)
        least = float(self.squares.least.min(initial=math.inf))
        least = min(self.given_up, least, max(self.length - TOLERANCE_MM, 0.0))
        return Placement(None if self.best is None else self._translation(self.best), least)

    def _approach(self, start: Floats, steps: int) -> None:
        """Try the start, then what Newton steps from it lead to; nothing is proved by it.

        Each step draws the line up to which the point with least room lets the shift go, to first order, and
        takes the place nearest to the start that all lines allow.
        """
        self._try(start[None, :])
        shift, lines = start, np.empty((0, 3))
        for _ in range(steps):
            if self.best is not None:
                return
            margin, gradient = self.placing.least_room(shift)
            line = np.append(gradient, gradient @ (shift - start) - margin + AIM_MM)
            nearest = _nearest(line, lines)
            if margin >= 0.0 or nearest is None:  # it is the roll that objects, or the lines leave no place
                return
            shift, lines = start + nearest, np.vstack((lines, line))
            self._try(shift[None, :])

    def _divide(self, *, any_will_do: bool) -> None:
        """Divide the square with the shortest translation first. A square leaves the open ones when it is decided."""
        while len(self.squares) and not (any_will_do and self.best is not None):
            squares = self.squares = self.squares.take(self.squares.least < self.length - TOLERANCE_MM)
            order = np.argsort(squares.least, kind="stable")
            near, rest = squares.take(order[:BATCH]), squares.take(order[BATCH:])
            self.squares = rest.joined(self._look(self._divided(near)))

    def _first(self) -> _Squares:
        """Squares that cover the domain as far as translations are shorter than the best; none if it is empty."""
        low, high = self.placing.domain
        away = self.length * (1.0 + np.abs(self.placing.geometry.tilt))
        low, high = np.maximum(low, -away), np.minimum(high, away)
        if not (low <= high).all():
            nothing = np.empty(0)
            return _Squares(np.empty((0, 2)), nothing, nothing)
        side = SQUARES_NEAR if self.near else SQUARES
        half = max(float((high - low).max()) / (2.0 * side), self.finest_mm)
        ticks = [np.arange(a + half, b + 2.0 * half, 2.0 * half) for a, b in zip(low, high, strict=True)]
        centre = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 2)
        return self._bounded(centre, np.full(len(centre), half), np.zeros(len(centre)))

    def _divided(self, squares: _Squares) -> _Squares:
        """Finer at once where the best is near and they are few: nothing is looked for between, and calls are spared."""
        parts = FINER if self.near and FINER**2 * len(squares) <= FEW else 2
        ticks = (2.0 * np.arange(parts) + 1.0) / parts - 1.0
        off = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
        centre = (squares.centre[:, None, :] + squares.half[:, None, None] * off).reshape(-1, 2)
        half, least = np.repeat(squares.half / parts, len(off)), np.repeat(squares.least, len(off))
        return self._bounded(centre, half, least)

    def _bounded(self, centre: Floats, half: Floats, inherited: Floats) -> _Squares:
        least = np.maximum(inherited, self._length(centre) - math.sqrt(2.0) * half)
        return _Squares(centre, half, least)

    def _look(self, squares: _Squares) -> _Squares:
        """Use the centres that fit, drop what is excluded; the squares that remain to be divided."""
        rest = squares.take(np.zeros(len(squares), dtype=np.bool_))
        while len(squares):
            squares = squares.take(squares.least < self.length - TOLERANCE_MM)
            some = np.arange(len(squares)) < self.placing.at_once
            rest, squares = rest.joined(self._undecided(squares.take(some))), squares.take(~some)
        return rest

    def _undecided(self, squares: _Squares) -> _Squares:
        """What `_look` does, for as many as are looked at in one go."""
        excluded, margin = self.placing.excluded(squares.centre, squares.radius)
        self._try(squares.centre[(margin >= 0.0) & ~excluded])
        squares = squares.take(~excluded)
        fine = squares.radius <= self.finest_mm
        self.given_up = min(self.given_up, float(squares.least[fine].min(initial=math.inf)))
        return squares.take(~fine)

    def _try(self, shifts: Floats) -> None:
        """Take the shortest of some shifts that fits all points, if it is shorter than the best."""
        shifts = shifts[self._length(shifts) < self.length]
        shifts = shifts[np.argsort(self._length(shifts), kind="stable")]
        while len(shifts):
            shifts = shifts[self.placing.promising(shifts)]  # the sample has grown since
            if len(shifts) and self.placing.fits(shifts[0]):
                self.best, self.length = shifts[0], float(self._length(shifts[:1])[0])
                return
            shifts = shifts[1:]

    def _lift(self, shift: Floats) -> Floats:
        """The lift of the shortest translation that shifts the wrist centres by (k, 2)."""
        tilt = self.placing.geometry.tilt
        out: Floats = np.clip(-(shift @ tilt) / (1.0 + tilt @ tilt), *self.placing.lift_mm)
        return out

    def _length(self, shift: Floats) -> Floats:
        """Length of the shortest translation that shifts the wrist centres by (k, 2), mm."""
        lift = self._lift(shift)
        plane = shift + lift[:, None] * self.placing.geometry.tilt
        out: Floats = np.sqrt((plane * plane).sum(axis=1) + lift * lift)
        return out

    def _translation(self, shift: Floats) -> Floats:
        lift = self._lift(shift[None, :])[0]
        return np.append(shift + lift * self.placing.geometry.tilt, lift)


def _nearest(line: Floats, others: Floats) -> Floats | None:
    """The place nearest to the origin on a line ``(n, b)``, of those with ``n p >= b`` for the others (k, 3)."""
    n, b = line[:2], line[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        foot = n * b / (n @ n)
        along = np.array((-n[1], n[0]))
        crossings = foot + ((others[:, 2] - others[:, :2] @ foot) / (others[:, :2] @ along))[:, None] * along
    places = np.vstack((foot, crossings))
    allowed = (places @ others[:, :2].T >= others[:, 2] - ROUNDING_MM).all(axis=1)
    places = places[allowed & np.isfinite(places).all(axis=1)]
    return places[np.argmin((places * places).sum(axis=1))] if len(places) else None
