"""Where the arm was when its controller was last heard: for telling only, nothing is decided by it.

Whatever the controller sent counts, also what came too late for the session to act on. A running session and a log of
it hear the same frames, and so tell the same.
"""

from collections import deque
from contextlib import suppress
from typing import Final

from cutgate.protocol.e2e import intact
from cutgate.protocol.frames import (
    DATA_IDS,
    IDS,
    Frame,
    Joint4,
    Joints01,
    Joints23,
    Progress,
    decode_frame,
    joint_values,
)
from cutgate.protocol.records import joints_to_counts

JOINTS: Final = (Joints01, Joints23, Joint4)
KEPT: Final = 16
"""Of each identifier: a sample is complete when its three parts carry one counter."""


class LastSeen:
    """The last of the frames that tell where the arm is."""

    def __init__(self) -> None:
        self._frames: dict[int, deque[bytes]] = {
            IDS[kind]: deque(maxlen=KEPT) for kind in (*JOINTS, Progress)
        }

    def frame(self, can_id: int, data: bytes) -> None:
        """One frame from the bus, with an identifier of 11 bits and data; any other tells nothing."""
        if can_id in self._frames:
            self._frames[can_id].append(data)

    def progress(self, tag: int) -> tuple[int, int] | None:
        """Segment, and counts of 1/65535 of it, as last reported in the session of this tag."""
        for _, frame in reversed(self._intact(IDS[Progress], tag)):
            if isinstance(frame, Progress):
                return frame.segment, frame.fraction
        return None

    def joints_u(self, tag: int) -> tuple[int, ...] | None:
        """The joints of the last complete sample in the session of this tag, 1e-6 deg | mm."""
        seconds, thirds = (dict(self._intact(IDS[kind], tag)) for kind in (Joints23, Joint4))
        for counter, first in reversed(self._intact(IDS[Joints01], tag)):
            second, third = seconds.get(counter), thirds.get(counter)
            if isinstance(first, Joints01) and isinstance(second, Joints23) and isinstance(third, Joint4):
                return joints_to_counts(joint_values(first, second, third))
        return None

    def _intact(self, can_id: int, tag: int) -> list[tuple[int, Frame]]:
        """Those kept that belong to the session, with their counters, in their order."""
        found = []
        for data in self._frames[can_id]:
            if intact(data, DATA_IDS[can_id], tag):
                with suppress(ValueError):  # it is data
                    found.append((data[2], decode_frame(can_id, data)))
        return found
