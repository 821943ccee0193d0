"""The bus itself: who sends next, how long it takes, what becomes of it. Pure: time comes in as nanoseconds.

How it is used: :meth:`Medium.join` for each node; :meth:`Medium.advance` to now, then :meth:`Medium.offer` a frame; and
:meth:`Medium.advance` again no later than :attr:`Medium.next_ns`. What it returns is in the order of the bus.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Final, NamedTuple

from cutgate.firmware_sim.bus.frame import BusFrame
from cutgate.firmware_sim.bus.medium.bits import (
    ERROR_DELIMITER_BITS,
    ERROR_FLAG_BITS,
    INTERMISSION_BITS,
    RECOVERY_BITS,
    SUSPEND_BITS,
    Rates,
    frame_bits,
)
from cutgate.firmware_sim.bus.medium.confinement import Counted, Counters, NodeState
from cutgate.firmware_sim.bus.medium.errors import CASES, Injection, WireFault
from cutgate.firmware_sim.bus.medium.nodes import Node, Waiting, arbitration

QUEUE_FRAMES: Final = 10
"""As `txqueuelen` of a CAN interface."""
TALKERS_MAX: Final = 4096
INJECTIONS_MAX: Final = 256
_RECESSIVE_BITS: Final = 11


@dataclass(frozen=True, slots=True)
class Carried:
    """A frame that reached somebody: whose it was, who has taken it, and who of its senders believes it sent."""

    at_ns: int
    frame: BusFrame
    senders: tuple[int, ...]
    receivers: tuple[int, ...]
    sent: bool = True


@dataclass(frozen=True, slots=True)
class Destroyed:
    """An error frame was on the bus: which error, and whose frame it hit."""

    at_ns: int
    kind: WireFault
    frame: BusFrame
    senders: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class QueueRoom:
    """So many frames have left a node's transmit queue."""

    node: int
    frames: int


@dataclass(frozen=True, slots=True)
class Changed:
    """A node may do more or less than before."""

    at_ns: int
    node: int
    state: NodeState
    counters: Counters


Event = Carried | Destroyed | QueueRoom | Changed


class _OnWire(NamedTuple):
    """What is being sent: from when, until when; the error that ends it, and the receivers that see it."""

    frame: BusFrame
    senders: tuple[Node, ...]
    start_ns: int
    end_ns: int
    error: WireFault | None = None
    seers: tuple[Node, ...] = ()


@dataclass
class Talker:
    """Frames of one identifier that one node has sent, and how long they kept the bus busy."""

    frames: int = 0
    busy_ns: int = 0


@dataclass
class Totals:
    """The bus since it began."""

    frames: int = 0
    error_frames: int = 0
    busy_ns: int = 0
    talkers: dict[tuple[int, int], Talker] = field(default_factory=dict)
    """By node and identifier; what is beyond the bound, under identifier -1."""


class Medium:
    """A bus of nodes.

    Args:
        rates: its bit rates.
        queue_frames: frames that each node's transmit queue holds.
        restart_ns: so long after it went bus-off a node begins to come back; None: never by itself.
    """

    def __init__(
        self, rates: Rates, *, queue_frames: int = QUEUE_FRAMES, restart_ns: int | None = None
    ) -> None:
        self.rates = rates
        self.totals = Totals()
        self.nodes: dict[int, Node] = {}
        self._queue_frames = queue_frames
        self._restart_ns = restart_ns
        self._off: dict[Node, int] = {}
        """Those that are bus-off and wait for their way back, and since when they do."""
        self._injections: list[Injection] = []
        self._on_wire: _OnWire | None = None
        self._idle_ns = 0
        """From when on the bus is free."""
        self._joined = 0
        self._intermission_ns = rates.nominal_ns(INTERMISSION_BITS)
        self._eleven_ns = max(1, rates.nominal_ns(_RECESSIVE_BITS))

    # ------------------------------------------------------------ who takes part

    def join(self, name: str) -> int:
        """A node more; its number."""
        self._joined += 1
        self.nodes[self._joined] = Node(self._joined, name, self._queue_frames)
        return self._joined

    def leave(self, number: int) -> None:
        """A node has left; what it has queued still goes, where somebody is there to take it."""
        self.nodes[number].leaving = True
        self._forget_who_left()

    def inject(self, injection: Injection) -> bool:
        """Let an error come; False where too many are to come already."""
        self._injections = [to_come for to_come in self._injections if to_come.count > 0]
        if len(self._injections) >= INJECTIONS_MAX:
            return False
        self._injections.append(injection)
        return True

    def offer(self, number: int, frame: BusFrame, now_ns: int) -> bool:
        """Queue a frame; False where the node's transmit queue has no room, or the node is bus-off."""
        node = self.nodes[number]
        if len(node.queue) >= node.depth or node.state is NodeState.BUS_OFF:
            node.tally.refused += 1
            return False
        node.queue.append(Waiting(frame, now_ns))
        return True

    # ------------------------------------------------------------ time

    @property
    def next_ns(self) -> int | None:
        """When something happens next; None where nothing will unless a frame is offered."""
        coming = self._next()
        return None if coming is None else coming[0]

    def advance(self, now_ns: int) -> list[Event]:
        """What has happened until now."""
        events: list[Event] = []
        while (coming := self._next()) is not None and coming[0] <= now_ns:
            events += coming[1]()
        return events

    def _next(self) -> tuple[int, Callable[[], Iterable[Event]]] | None:
        """When something happens next, and it: a frame ends, a node comes back, a frame begins."""
        if self._on_wire is not None:
            return self._on_wire.end_ns, partial(self._finish, self._on_wire)
        start_ns, back_ns = self._start_ns(), self._recovery_ns() if self._off else None
        if back_ns is not None and (start_ns is None or back_ns <= start_ns):
            return back_ns, partial(self._recover, back_ns)
        return None if start_ns is None else (start_ns, partial(self._begin, start_ns))

    def _start_ns(self) -> int | None:
        """When the next frame begins."""
        times = [from_ns for node in self.nodes.values() if (from_ns := node.sends_from_ns) is not None]
        return max(min(times), self._idle_ns) if times else None

    # ------------------------------------------------------------ one frame

    def _begin(self, start_ns: int) -> tuple[()]:
        """Arbitration: of all that have something to send, who sends. Nobody hears that a frame begins."""
        competing = {
            node: arbitration(node.queue[0].frame)
            for node in self.nodes.values()
            if (from_ns := node.sends_from_ns) is not None and from_ns <= start_ns
        }
        lowest = min(competing.values())
        senders = tuple(node for node, bits in competing.items() if bits == lowest)
        for node in competing:
            node.tally.lost_arbitration += node not in senders
        frame = senders[0].queue[0].frame
        error, seers = self._error(frame, senders)
        end_ns = start_ns + frame_bits(frame).ns(self.rates)
        if error is not None:
            at = CASES[error].from_end
            end_ns = (start_ns + end_ns) // 2 if at is None else end_ns - self.rates.nominal_ns(at)
        self._count_recessive(start_ns)
        self._on_wire = _OnWire(frame, senders, start_ns, end_ns, error, seers)
        return ()

    def _error(self, frame: BusFrame, senders: tuple[Node, ...]) -> tuple[WireFault | None, tuple[Node, ...]]:
        """What goes wrong with this frame, and which receivers see it."""
        receivers = self._receivers(senders)
        if any(node.queue[0].frame != frame for node in senders):
            return WireFault.BIT, ()  # two that nobody can tell apart by identifier: one is overwritten
        numbers = tuple(node.number for node in senders)
        for injection in self._injections:
            if injection.hits(frame.number, numbers):
                wanted = injection.receivers
                seers = [node for node in receivers if wanted is None or node.number in wanted]
                return self._seen(injection.kind, seers)
        return (None, ()) if receivers else (WireFault.ACK, ())

    def _seen(self, kind: WireFault, seers: list[Node]) -> tuple[WireFault | None, tuple[Node, ...]]:
        """An error that only passive receivers see destroys nothing: they alone have not got the frame."""
        if not CASES[kind].by_receivers:
            return kind, ()
        destroys = any(node.state is not NodeState.ERROR_PASSIVE for node in seers)
        return (kind if destroys else None), tuple(seers)

    def _receivers(self, senders: Iterable[Node]) -> list[Node]:
        return [
            node
            for node in self.nodes.values()
            if node not in senders and not node.leaving and node.state is not NodeState.BUS_OFF
        ]

    def _finish(self, sent: _OnWire) -> Iterator[Event]:
        self._on_wire = None
        if sent.error is None:
            yield from self._arrived(sent)
        else:
            yield from self._destroyed(sent, sent.error)
        self._forget_who_left()

    def _arrived(self, sent: _OnWire) -> Iterator[Event]:
        """Sent, and taken by everybody but those whose error flag nobody sees."""
        busy_ns = sent.end_ns - sent.start_ns + self._intermission_ns
        self._occupied(sent, busy_ns)
        self.totals.frames += 1
        takers = [node for node in self._receivers(sent.senders) if node not in sent.seers]
        yield Carried(sent.end_ns, sent.frame, _numbers(sent.senders), _numbers(takers))
        for node in sent.senders:
            node.queue.popleft()
            node.tally.sent += 1
            yield from self._counted(node, Counted.SENT, sent.end_ns)
            yield QueueRoom(node.number, 1)
        yield from self._taken(takers, sent.end_ns)
        for node in sent.seers:
            yield from self._counted(node, Counted.RECEIVED_WRONG, sent.end_ns)
        self._suspend(sent)

    def _destroyed(self, sent: _OnWire, error: WireFault) -> Iterator[Event]:
        """An error frame follows; the frame stays in its queue and is sent again."""
        flag_ns = self.rates.nominal_ns(ERROR_FLAG_BITS + ERROR_DELIMITER_BITS)
        self._occupied(sent, sent.end_ns - sent.start_ns + flag_ns + self._intermission_ns)
        self.totals.error_frames += 1
        receivers = self._receivers(sent.senders)
        takers = [node for node in receivers if CASES[error].kept and node not in sent.seers]
        if CASES[error].kept:
            yield Carried(sent.end_ns, sent.frame, _numbers(sent.senders), _numbers(takers), sent=False)
        yield Destroyed(sent.end_ns, error, sent.frame, _numbers(sent.senders))
        own = Counted.NOT_ACKNOWLEDGED if error is WireFault.ACK else Counted.SENT_WRONG
        for node in sent.senders:
            node.tally.errors += 1
            yield from self._counted(node, own, sent.end_ns)
        yield from self._taken(takers, sent.end_ns)
        for node in receivers:
            if node not in takers:
                wrong = Counted.FOUND_WRONG if node in sent.seers else Counted.RECEIVED_WRONG
                yield from self._counted(node, wrong, sent.end_ns)
        self._suspend(sent)

    def _taken(self, takers: Iterable[Node], at_ns: int) -> Iterator[Event]:
        for node in takers:
            node.tally.received += 1
            yield from self._counted(node, Counted.RECEIVED, at_ns)

    def _occupied(self, sent: _OnWire, busy_ns: int) -> None:
        self._idle_ns = sent.start_ns + busy_ns
        self.totals.busy_ns += busy_ns
        for node in sent.senders:
            node.tally.busy_ns += busy_ns
            key = (node.number, sent.frame.number)
            talkers = self.totals.talkers
            if key not in talkers and len(talkers) >= TALKERS_MAX:
                key = (node.number, -1)
            talker = talkers.setdefault(key, Talker())
            talker.frames += 1
            talker.busy_ns += busy_ns

    def _suspend(self, sent: _OnWire) -> None:
        """Who sends in spite of many errors lets the others go first."""
        for node in sent.senders:
            if node.state is NodeState.ERROR_PASSIVE:
                node.ready_ns = self._idle_ns + self.rates.nominal_ns(SUSPEND_BITS)

    # ------------------------------------------------------------ counters, off and back

    def _counted(self, node: Node, counted: Counted, at_ns: int) -> Iterator[Event]:
        before, node.counters = node.counters, node.counters.after(counted)
        if node.counters is before or node.state is before.state:
            return
        yield Changed(at_ns, node.number, node.state, node.counters)
        if node.state is NodeState.BUS_OFF:
            node.queue.clear()  # what it held is lost, and it has been told
            if self._restart_ns is not None:
                self._off[node] = at_ns + self._restart_ns
            node.recessive = RECOVERY_BITS // _RECESSIVE_BITS

    def _recessive_ns(self, node: Node) -> int:
        """Since when a node that is off has seen none but recessive bits, as the last eleven before a free bus are."""
        return max(self._idle_ns - self._eleven_ns, self._off[node])

    def _count_recessive(self, start_ns: int) -> None:
        """A frame begins: whoever is off has seen so many times eleven recessive bits, and begins to count anew."""
        for node in self._off:
            since_ns = self._recessive_ns(node)
            if since_ns < start_ns:
                node.recessive -= (start_ns - since_ns) // self._eleven_ns

    def _back_ns(self, node: Node) -> int:
        """When a node that is off comes back, if nobody sends."""
        return self._recessive_ns(node) + node.recessive * self._eleven_ns

    def _recovery_ns(self) -> int:
        """When the next node of those that are off comes back, if nobody sends."""
        return min(map(self._back_ns, self._off))

    def _recover(self, now_ns: int) -> Iterator[Event]:
        """Whoever has seen enough recessive bits by now, on a bus on which nobody sends."""
        for node in [node for node in self._off if self._back_ns(node) <= now_ns]:
            yield from self._back(node, now_ns)

    def _back(self, node: Node, now_ns: int) -> Iterator[Event]:
        node.counters, node.ready_ns = Counters(), now_ns
        del self._off[node]
        yield Changed(now_ns, node.number, node.state, node.counters)
        yield QueueRoom(node.number, node.depth)

    def _forget_who_left(self) -> None:
        """Who has left and has nothing to send, or nobody to send it to."""
        if not any(node.leaving for node in self.nodes.values()):
            return
        stay = any(not node.leaving for node in self.nodes.values())
        sending = () if self._on_wire is None else self._on_wire.senders
        self.nodes = {
            number: node
            for number, node in self.nodes.items()
            if not node.leaving or node in sending or (node.queue and stay)
        }
        self._off = {node: since_ns for node, since_ns in self._off.items() if node.number in self.nodes}


def _numbers(nodes: Iterable[Node]) -> tuple[int, ...]:
    return tuple(node.number for node in nodes)
