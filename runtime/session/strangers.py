"""What share of the frames that are heard is neither side's: a babbling node leaves others no room. Pure."""

import math
from typing import Final

from cutgate.protocol.frames import SENT_BY
from cutgate.protocol.records import Timing
from cutgate.runtime.interlock.state import Crowd

OURS: Final = frozenset().union(*SENT_BY.values())
WINDOW_TIMEOUTS: Final = 0.5
"""Of each window; two are looked at: where a heartbeat was missing for the time-out, nothing older is in them."""
SHARE: Final = 0.5
"""Of the frames that are heard: with fewer, ours get through."""
FRAMES_PER_S: Final = 500
"""Half of what a bus of 125 kbit/s carries: a node that does its work beside ours says less."""
IDENTIFIERS_MAX: Final = 64
"""Counted by themselves in a window; what comes with one more counts among all."""

Key = tuple[int, bool]


class _Window:
    def __init__(self, since_s: float) -> None:
        self.since_s = since_s
        self.all = self.strange = 0
        self.by_identifier: dict[Key, int] = {}

    def strange_one(self, key: Key) -> None:
        self.strange += 1
        if key in self.by_identifier or len(self.by_identifier) < IDENTIFIERS_MAX:
            self.by_identifier[key] = self.by_identifier.get(key, 0) + 1


class Strangers:
    """How many frames came lately, and with which identifiers.

    Args:
        timing: the session's.
    """

    def __init__(self, timing: Timing) -> None:
        self._window_s = WINDOW_TIMEOUTS * timing.timeout_s
        self._now = self._before = _Window(-math.inf)

    def cycle(self, now_s: float) -> None:
        """A cycle begins."""
        if not now_s - self._now.since_s < self._window_s:
            self._before, self._now = self._now, _Window(now_s)

    def frame(self, can_id: int, *, is_extended: bool) -> None:
        """A frame has come."""
        self._now.all += 1
        if can_id not in OURS or is_extended:
            self._now.strange_one((can_id, is_extended))

    def crowd(self, now_s: float) -> Crowd | None:
        """The identifier of most of the frames that are neither side's, where those are more than ours, and many; else None."""
        windows = (self._before, self._now)
        heard, strange = (sum(getattr(one, name) for one in windows) for name in ("all", "strange"))
        span_s = now_s - self._before.since_s
        if not strange or not (strange >= SHARE * heard and strange >= FRAMES_PER_S * span_s):
            return None
        counts: dict[Key, int] = {}
        for one in windows:
            for key, count in one.by_identifier.items():
                counts[key] = counts.get(key, 0) + count
        (can_id, is_extended), most = max(counts.items(), key=lambda entry: (entry[1], entry[0]))
        return Crowd(can_id, is_extended, round(most / span_s), round(100 * most / heard))
