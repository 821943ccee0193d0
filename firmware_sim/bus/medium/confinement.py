"""Fault confinement: what each node counts of its own and others' errors, and what it may still do (ISO 11898-1).

A node that errs too often must not go on disturbing the others: from ``PASSIVE`` its error flags destroy nothing, and
``OFF`` it takes no part at all.
"""

from dataclasses import dataclass
from enum import IntEnum, StrEnum, unique
from functools import cached_property
from typing import Final

WARNING: Final = 96
PASSIVE: Final = 128
OFF: Final = 256


@unique
class NodeState(IntEnum):
    """What a node may still do, by its counters."""

    ERROR_ACTIVE = 0
    ERROR_WARNING = 1
    ERROR_PASSIVE = 2
    BUS_OFF = 3


@unique
class Counted(StrEnum):
    """What a node counts."""

    SENT = "sent"
    RECEIVED = "received"
    SENT_WRONG = "sent wrong"
    NOT_ACKNOWLEDGED = "not acknowledged"
    RECEIVED_WRONG = "received wrong"
    """Another's error flag, or an error that the transmitter flags first."""
    FOUND_WRONG = "found wrong"
    """An error that this receiver is among the first to flag."""


STEPS: Final[dict[Counted, tuple[int, int]]] = {
    Counted.SENT: (-1, 0),
    Counted.RECEIVED: (0, -1),
    Counted.SENT_WRONG: (8, 0),
    Counted.NOT_ACKNOWLEDGED: (8, 0),
    Counted.RECEIVED_WRONG: (0, 1),
    Counted.FOUND_WRONG: (0, 1 + 8),
}
"""By how much the transmit and the receive error counter change. A receiver whose flag is the first hears the others'
behind it, which counts 8 more: so the one that is broken itself is passive before it has sent a good transmitter off."""


@dataclass(frozen=True)
class Counters:
    """Error counters of one node: transmit and receive."""

    transmit: int = 0
    receive: int = 0

    @cached_property
    def state(self) -> NodeState:
        """What a node with these counters may do."""
        if self.transmit >= OFF:
            return NodeState.BUS_OFF
        highest = max(self.transmit, self.receive)
        if highest >= PASSIVE:
            return NodeState.ERROR_PASSIVE
        return NodeState.ERROR_WARNING if highest >= WARNING else NodeState.ERROR_ACTIVE

    def after(self, counted: Counted) -> "Counters":
        """The counters after this.

        The receive counter stays at passive: one frame received, and it is at 127, as the standard allows from wherever
        above.
        """
        if counted is Counted.NOT_ACKNOWLEDGED and self.state is NodeState.ERROR_PASSIVE:
            return self  # alone on the bus a node never goes off
        transmit, receive = STEPS[counted]
        after = (max(0, self.transmit + transmit), min(max(0, self.receive + receive), PASSIVE))
        return self if after == (self.transmit, self.receive) else Counters(*after)
