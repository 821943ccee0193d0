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
RECEIVE_BELOW_PASSIVE: Final = 127
"""A receiver that was passive counts on from here once it has received a frame."""


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


STEPS: Final[dict[Counted, tuple[int, int]]] = {
    Counted.SENT: (-1, 0),
    Counted.RECEIVED: (0, -1),
    Counted.SENT_WRONG: (8, 0),
    Counted.NOT_ACKNOWLEDGED: (8, 0),
    Counted.RECEIVED_WRONG: (0, 1),
}
"""By how much the transmit and the receive error counter change."""


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
        """The counters after this; the receive counter stays at passive, where counting on changes nothing."""
        if counted is Counted.NOT_ACKNOWLEDGED and self.state is NodeState.ERROR_PASSIVE:
            return self  # alone on the bus a node never goes off
        transmit, receive = STEPS[counted]
        before = RECEIVE_BELOW_PASSIVE + 1 if receive < 0 and self.receive >= PASSIVE else self.receive
        after = (max(0, self.transmit + transmit), min(max(0, before + receive), PASSIVE))
        return self if after == (self.transmit, self.receive) else Counters(*after)
