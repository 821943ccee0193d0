"""A node of the bus: its transmit queue, its error counters, and what it has done."""

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from cutgate.firmware_sim.bus.frame import BusFrame, Flag
from cutgate.firmware_sim.bus.medium.confinement import Counters, NodeState

_EXTENDED, _REMOTE, _ERROR = int(Flag.EXTENDED), int(Flag.REMOTE), int(Flag.ERROR)


class Waiting(NamedTuple):
    """A frame in a transmit queue."""

    frame: BusFrame
    since_ns: int


@dataclass
class Tally:
    """What a node has done since it joined: frames, and what became of them."""

    sent: int = 0
    received: int = 0
    refused: int = 0
    """Frames for which its transmit queue had no room."""
    lost_arbitration: int = 0
    errors: int = 0
    """Error frames on what it sent."""
    busy_ns: int = 0
    """So long its frames have kept the bus busy."""


@dataclass(eq=False)
class Node:
    """One node.

    Attributes:
        number: the bus's number for it.
        name: for people.
        depth: frames that its transmit queue holds.
        queue: what waits, first in first out as SocketCAN's.
        counters: its error counters.
        ready_ns: before this it does not begin to send.
        leaving: it has left; what it has queued still goes.
        recessive: so many times eleven recessive bits a node that is bus-off must still see.
    """

    number: int
    name: str
    depth: int
    queue: deque[Waiting] = field(default_factory=deque)
    counters: Counters = field(default_factory=Counters)
    tally: Tally = field(default_factory=Tally)
    ready_ns: int = 0
    leaving: bool = False
    recessive: int = 0

    @property
    def state(self) -> NodeState:
        """What it may still do."""
        return self.counters.state

    @property
    def sends_from_ns(self) -> int | None:
        """The earliest at which it begins to send; None where it has nothing, or may not."""
        if not self.queue or self.state is NodeState.BUS_OFF:
            return None
        return max(self.queue[0].since_ns, self.ready_ns)


def arbitration(frame: BusFrame) -> int:
    """The bits by which frames compete, as a number: the lower one goes first.

    Identifier, then remote behind data, then extended behind standard with the same first eleven bits.
    """
    if frame.flags & _ERROR:
        return -1  # dominant at once
    remote = int(bool(frame.flags & _REMOTE))
    if frame.flags & _EXTENDED:
        base, extension = frame.number >> 18, frame.number & 0x3FFFF
        return base << 21 | 0b11 << 19 | extension << 1 | remote
    return frame.number << 21 | remote << 20
