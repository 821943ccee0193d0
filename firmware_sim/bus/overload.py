"""Who keeps the bus busy: a babbling node is named."""

from collections.abc import Iterator
from typing import Final

from cutgate.firmware_sim.bus.medium.medium import Medium

WINDOW_NS: Final = 1_000_000_000
LOAD: Final = 0.9
"""Of the bus's time in a window: beyond this somebody is looked for."""
SHARE: Final = 0.5
"""Of the bus's time: whoever takes more is named."""


class Overload:
    """Looks at the load once a second, and says once who it is until the load has fallen again.

    Args:
        medium: the bus.
        now_ns: when it begins to look.
    """

    def __init__(self, medium: Medium, now_ns: int) -> None:
        self._medium = medium
        self._since_ns = now_ns
        self._busy_ns = medium.totals.busy_ns
        self._by_talker = {key: talker.busy_ns for key, talker in medium.totals.talkers.items()}
        self._named: set[tuple[int, int]] = set()

    def seen(self, now_ns: int) -> Iterator[str]:
        """A line for each who takes the bus for himself, if a window has passed."""
        window_ns = now_ns - self._since_ns
        if window_ns < WINDOW_NS:
            return
        totals = self._medium.totals
        load = (totals.busy_ns - self._busy_ns) / window_ns
        shares = {
            key: (talker.busy_ns - self._by_talker.get(key, 0)) / window_ns
            for key, talker in totals.talkers.items()
        }
        self._since_ns, self._busy_ns = now_ns, totals.busy_ns
        self._by_talker = {key: talker.busy_ns for key, talker in totals.talkers.items()}
        loud = {key for key, share in shares.items() if load >= LOAD and share >= SHARE}
        for node, number in sorted(loud - self._named):
            name = (
                self._medium.nodes[node].name
                if node in self._medium.nodes
                else f"node {node}, which has left,"
            )
            yield f"{name} takes {shares[node, number]:.0%} of the bus with identifier {number:#05x}; load {load:.0%}"
        self._named = loud
