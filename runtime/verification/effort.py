"""Work that is counted, not timed: an answer that ends early is the same on every machine."""

from __future__ import annotations

import math
from typing import Final

CALL: Final = 600
"""What a step costs however few points it looks at, in points."""


class EffortSpentError(Exception):
    """The next step would take more work than is left; it was not begun."""


class Effort:
    """A bound on work, in points looked at: one takes an eighth of a microsecond or so.

    A part of it (`part`) draws on the whole as well. ``spent`` never passes ``most``.
    """

    def __init__(self, most: float = math.inf, *, of: Effort | None = None) -> None:
        self.most = most
        self.spent = 0
        self._of = of

    @property
    def left(self) -> float:
        """What may still be spent here."""
        own = self.most - self.spent
        return own if self._of is None else min(own, self._of.left)

    def spend(self, points: int) -> None:
        """Count the work of a step before it is begun.

        Raises:
            EffortSpentError: it is more than is left.
        """
        if not points <= self.left:
            raise EffortSpentError(f"{points} points are more than the {self.left:g} left of {self.most:g}")
        effort: Effort | None = self
        while effort is not None:
            effort.spent += points
            effort = effort._of  # noqa: SLF001 - its own kind

    def part(self, most: float) -> Effort:
        """A bound of its own within this one."""
        return Effort(most, of=self)
