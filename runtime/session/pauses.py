"""How long the loop stood still lately: the answer to which side was late. Pure."""

from collections import deque
from typing import Final

from cutgate.protocol.records import Timing

PAUSE_HEARTBEATS: Final = 2
"""A cycle that begins later than this after the one before is late."""
PAUSE_TIMEOUTS: Final = 2
"""So long it may be what the other side's time-out is about."""
PAUSES_KEPT: Final = 64


class Pauses:
    """The pauses of late.

    Args:
        timing: the session's.
    """

    def __init__(self, timing: Timing) -> None:
        self._long_s = PAUSE_HEARTBEATS * timing.heartbeat_s
        self._lately_s = PAUSE_TIMEOUTS * timing.timeout_s
        self._pauses: deque[tuple[float, float]] = deque(maxlen=PAUSES_KEPT)

    def cycle(self, gap_s: float, now_s: float) -> None:
        """A cycle begins, so long after the one before."""
        if not gap_s <= self._long_s:
            self._pauses.append((now_s, gap_s))

    def longest_ms(self, now_s: float) -> int:
        """The longest of late; 0 if the loop kept its time."""
        lately = [gap_s for at_s, gap_s in self._pauses if now_s - at_s <= self._lately_s]
        return round(max(lately, default=0.0) * 1000)
