"""The errors of the wire: where in the frame each is seen, by whom, and who keeps the frame all the same.

What a program on top of it makes of them are the errors that its end-to-end protection must find: a frame that is
repeated, lost for some, delayed.
"""

from dataclasses import dataclass
from enum import StrEnum, unique
from typing import Final


@unique
class WireFault(StrEnum):
    """What can go wrong with one frame."""

    BIT = "bit"
    STUFF = "stuff"
    CRC = "crc"
    FORM = "form"
    ACK = "ack"
    LAST_BUT_ONE = "last-but-one-bit"
    LAST = "last-bit"


@dataclass(frozen=True)
class ErrorCase:
    """One row of the table.

    Attributes:
        from_end: how many bits before the end of the frame it is seen; None: in the middle.
        by_receivers: the receivers see it first, all of them or those named; else the transmitter.
        kept: those who do not see it have taken the frame already.
    """

    from_end: int | None
    by_receivers: bool
    kept: bool = False


CASES: Final[dict[WireFault, ErrorCase]] = {
    WireFault.BIT: ErrorCase(None, by_receivers=False),
    WireFault.STUFF: ErrorCase(None, by_receivers=True),
    WireFault.FORM: ErrorCase(9, by_receivers=True),
    WireFault.ACK: ErrorCase(8, by_receivers=False),
    WireFault.CRC: ErrorCase(7, by_receivers=True),
    WireFault.LAST_BUT_ONE: ErrorCase(1, by_receivers=True, kept=True),
    WireFault.LAST: ErrorCase(0, by_receivers=False, kept=True),
}
"""CRC delimiter 9 bits before the end, acknowledge slot 8, end of frame the last 7. A receiver takes a frame when the
last bit but one was right, the transmitter believes it sent when the last one was: between the two everybody else has
it, and gets it again."""


@dataclass
class Injection:
    """An error to come.

    Attributes:
        kind: which one.
        number: of frames with this identifier; None: of any.
        senders: of these nodes; None: of any.
        receivers: the receivers that see it; None: all. Only where receivers do.
        skip: so many frames that it could hit pass first.
        count: how many it hits.
    """

    kind: WireFault
    number: int | None = None
    senders: frozenset[int] | None = None
    receivers: frozenset[int] | None = None
    skip: int = 0
    count: int = 1

    def hits(self, number: int, senders: tuple[int, ...]) -> bool:
        """Whether this frame is one that it hits; counts it."""
        if self.count <= 0 or (self.number is not None and number != self.number):
            return False
        if self.senders is not None and self.senders.isdisjoint(senders):
            return False
        if self.skip:
            self.skip -= 1
            return False
        self.count -= 1
        return True
