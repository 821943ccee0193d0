"""What carries frames from one client of the hub to the others: at once, or at the speed of a wire.

Both give every frame one place in one order, and say what is to be delivered to whom; the hub's sockets are the hub's.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from cutgate.firmware_sim.bus import wire
from cutgate.firmware_sim.bus.frame import BusFrame, Flag
from cutgate.firmware_sim.bus.medium.bits import Rates
from cutgate.firmware_sim.bus.medium.confinement import Counters, NodeState
from cutgate.firmware_sim.bus.medium.medium import (
    QUEUE_FRAMES,
    Carried,
    Changed,
    Destroyed,
    Event,
    Medium,
    QueueRoom,
)
from cutgate.firmware_sim.bus.medium.nodes import Node
from cutgate.firmware_sim.bus.overload import Overload
from cutgate.firmware_sim.bus.states import TRANSMIT_OVERFLOW, overflow_frame, state_frame


class Delivery(NamedTuple):
    """Frames for some clients.

    Attributes:
        raw: FRAME records.
        frames: how many.
        fd: how many of them are FD frames.
        receivers: the clients' numbers.
        own: those who get them back as their own, if they asked for it.
        logged: whether they were on the bus; what a node hears of its own interface was not.
    """

    raw: bytes
    frames: int
    fd: int
    receivers: tuple[int, ...]
    own: tuple[int, ...] = ()
    logged: bool = True


@dataclass(frozen=True, slots=True)
class Credit:
    """QueueRoom in a client's transmit queue: so many frames more; None: none at all from now on."""

    client: int
    frames: int | None


Effect = Delivery | Credit


class Carrier(Protocol):
    """What carries frames."""

    depth: int
    """Frames that a client's transmit queue holds; 0: frames are carried at once."""
    fd: bool
    """Whether FD frames are carried."""

    def join(self, client: int, name: str) -> None:
        """A client takes part."""

    def leave(self, client: int) -> None:
        """A client has left."""

    def take(self, client: int, raw: bytes) -> Iterator[Effect]:
        """A datagram of a client. Raises WireError where it holds anything but frames."""

    def wait_s(self) -> float | None:
        """How soon something happens by itself; None: nothing does."""

    def go_on(self) -> Iterator[Effect]:
        """What has happened by itself until now."""


class Stamps:
    """The time of the bus as the log has it: since the epoch, and never back."""

    def __init__(self) -> None:
        self._last_ns = 0

    def at(self, time_ns: int) -> int:
        """This time, or the last one where that was later."""
        self._last_ns = max(self._last_ns, time_ns)
        return self._last_ns


@dataclass
class AtOnce:
    """Frames take no time: one after the other, in the order in which the hub reads them."""

    depth: int = 0
    fd: bool = True
    _stamps: Stamps = field(default_factory=Stamps)
    _clients: tuple[int, ...] = ()
    sent: dict[int, int] = field(default_factory=dict)
    """By client, how many frames."""

    def join(self, client: int, name: str) -> None:  # noqa: ARG002 - the wire's nodes have names
        """A client takes part."""
        self._clients += (client,)
        self.sent[client] = 0

    def leave(self, client: int) -> None:
        """A client has left."""
        self._clients = tuple(other for other in self._clients if other != client)
        self.sent.pop(client, None)

    def take(self, client: int, raw: bytes) -> Iterator[Effect]:
        """All of it, to all the others."""
        stamped = wire.stamp(raw, self._stamps.at(time.time_ns()))
        self.sent[client] += stamped.frames
        others = tuple(other for other in self._clients if other != client)
        yield Delivery(stamped.raw, stamped.frames, stamped.fd, others, (client,))

    def wait_s(self) -> float | None:
        """Nothing happens by itself."""
        return None

    def go_on(self) -> Iterator[Effect]:
        """Nothing."""
        return iter(())


class Paced:
    """Frames take the time that they take on a wire, and compete for it.

    Args:
        rates: bit rates.
        queue_frames: frames that each client's transmit queue holds.
        restart_s: so long after it went bus-off a client begins to come back; None: never, unless it joins anew.
        report: told of what somebody should see, one line each.
        clock_ns: monotonic nanoseconds.
    """

    def __init__(
        self,
        rates: Rates,
        *,
        queue_frames: int = QUEUE_FRAMES,
        restart_s: float | None = None,
        report: Callable[[str], None] = lambda _line: None,
        clock_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        restart_ns = None if restart_s is None else round(restart_s * 1e9)
        self.medium = Medium(rates, queue_frames=queue_frames, restart_ns=restart_ns)
        self.depth = queue_frames
        self.fd = rates.data_bit_s is not None
        self._report = report
        self._clock_ns = clock_ns
        self._stamps = Stamps()
        self._epoch_ns = time.time_ns() - clock_ns()
        self._numbers: dict[int, int] = {}
        self._clients: dict[int, int] = {}
        self._states: dict[int, NodeState] = {}
        self._overload = Overload(self.medium, clock_ns())

    def join(self, client: int, name: str) -> None:
        """A client takes part."""
        number = self.medium.join(name)
        self._numbers[client], self._clients[number] = number, client
        self._states[number] = NodeState.ERROR_ACTIVE

    def leave(self, client: int) -> None:
        """A client has left; what it has queued still goes."""
        number = self._numbers.pop(client, None)
        if number is not None:
            del self._clients[number], self._states[number]
            self.medium.leave(number)

    def take(self, client: int, raw: bytes) -> Iterator[Effect]:
        """Queue its frames."""
        wire.stamp(raw, 0)  # checked whole before any of them counts
        yield from self.go_on()
        number, now_ns = self._numbers[client], self._clock_ns()
        refused = 0
        for record in wire.parse_all(raw):
            refused += not self.medium.offer(number, record.frame, now_ns)
        if refused:
            yield self._told(number, overflow_frame(TRANSMIT_OVERFLOW, refused))

    def wait_s(self) -> float | None:
        """Until the end of the frame that is on the wire, or the beginning of the next."""
        next_ns = self.medium.next_ns
        return None if next_ns is None else max(0, next_ns - self._clock_ns()) * 1e-9

    def go_on(self) -> Iterator[Effect]:
        """What the wire has done until now."""
        now_ns = self._clock_ns()
        for event in self.medium.advance(now_ns):
            yield from self._effects(event)
        for line in self._overload.seen(now_ns):
            self._report(line)

    def now_ns(self) -> int:
        """The bus's time."""
        return self._clock_ns()

    def numbers(self) -> dict[int, int]:
        """By client, the medium's number for it."""
        return dict(self._numbers)

    def node_of(self, client: int) -> Node:
        """A client that takes part, as the medium knows it."""
        return self.medium.nodes[self._numbers[client]]

    def client_of(self, node: int) -> int | None:
        """The client of a node; None once it has left."""
        return self._clients.get(node)

    def _effects(self, event: Event) -> Iterator[Effect]:
        match event:
            case Carried(at_ns, frame, senders, receivers, sent):
                raw = wire.of_frame(frame, self._stamps.at(at_ns + self._epoch_ns))
                own = self._known(senders) if sent else ()
                yield Delivery(raw, 1, int(bool(frame.flags & Flag.FD)), self._known(receivers), own)
            case QueueRoom(node, count) if node in self._clients:
                yield Credit(self._clients[node], count)
            case Changed(_, node, state, counters) if node in self._clients:
                yield from self._changed(node, state, counters)
            case Destroyed():
                pass  # counted by the medium

    def _known(self, numbers: tuple[int, ...]) -> tuple[int, ...]:
        return tuple(self._clients[number] for number in numbers if number in self._clients)

    def _changed(self, node: int, state: NodeState, counters: Counters) -> Iterator[Effect]:
        before, self._states[node] = self._states[node], state
        name = self.medium.nodes[node].name
        self._report(
            f"{name}: {before.name} -> {state.name}, error counters {counters.transmit} sending, "
            f"{counters.receive} receiving"
        )
        if state is NodeState.BUS_OFF:
            yield Credit(self._clients[node], None)
        yield self._told(node, state_frame(before, state, counters))

    def _told(self, node: int, frame: BusFrame) -> Delivery:
        """What a node hears of its own interface."""
        raw = wire.of_frame(frame, self._stamps.at(self._clock_ns() + self._epoch_ns))
        return Delivery(raw, 1, 0, (self._clients[node],), logged=False)
