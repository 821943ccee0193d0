"""Canned drilling cycles of RS-274 as moves along the normal of the plane, in the order of LinuxCNC."""

from dataclasses import dataclass
from typing import Final

from cutgate.runtime.plan.toolpath.expressions import GcodeError

PECK_CLEARANCE_MM: Final = 0.254
"""So far above the last depth a peck begins (0.010 inch, LinuxCNC without a setting of its own); it cuts nothing."""
PECKING: Final = frozenset({"G73", "G83"})
MOVES_MAX: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class Hole:
    """One hole.

    Attributes:
        code: G81, G82 (with a dwell, which moves nothing), G83 or G73.
        level: height at which the tool comes, mm.
        retract: height from which it feeds, mm.
        bottom: mm.
        clear: height at which it leaves, mm.
        peck: depth of each peck, mm; of the cycles without one it means nothing.
    """

    code: str
    level: float
    retract: float
    bottom: float
    clear: float
    peck: float = 0.0

    def heights(self, most: int) -> list[tuple[float, bool]]:
        """Heights that follow ``level``, and whether the tool feeds to each; a peck never ends above the last one.

        Raises:
            GcodeError: more than ``most``.
        """
        moves = [(self.retract, False)] if self.level != self.retract else []
        if self.code in PECKING:
            pecks = (self.retract - self.bottom) / self.peck
            if not (3.0 * pecks <= min(most, MOVES_MAX)):
                bound = f"<= {min(most, MOVES_MAX)}, what is left of the pose limit"
                raise GcodeError(f"{3.0 * pecks:.6g} moves of a cycle", bound, "make Q larger")
            depth = self.retract - self.peck
            while depth > self.bottom:
                moves.append((depth, True))
                if self.code == "G83":
                    moves.append((self.retract, False))
                moves.append((depth + PECK_CLEARANCE_MM, False))
                depth -= self.peck
        return [*moves, (self.bottom, True), (self.clear, False)]
