"""One cycle of a control loop, as both sides of the bus keep it: what came too late, what arrived, what is due.

A loop that stood still must not act on what queued meanwhile, a heartbeat is sent only by a cycle that has looked at
its clock, and nothing is waited for beyond the time at which something would be too late.

A loop that stood still for longer than the time-out of its open link throws away what queued meanwhile, and says so
before anything else::

    >>> import can
    >>> from cutgate.protocol.endpoint import Endpoint
    >>> from cutgate.protocol.wire import Side
    >>> bus = can.Bus(channel="cycle", interface="virtual")
    >>> endpoint = Endpoint(Side.CONTROLLER, bytes(32), heartbeat_s=0.02, timeout_s=0.1, transfer_timeout_s=2.0)
    >>> port = Port(bus, endpoint)
    >>> times_s = iter([0.0, 0.02, 0.02, 0.32])
    >>> cycle = Cycle(port, clock=lambda: next(times_s))
    >>> endpoint.use_session(bytes(range(32)))
    >>> endpoint.open_link(cycle.now_s)
    >>> cycle.begin()
    >>> list(cycle.late()), cycle.read(), cycle.heartbeat_due()
    ([], [], True)
    >>> cycle.begin()
    >>> [violation.cause.name for violation in cycle.late()]
    ['LOOP_STALLED', 'HEARTBEAT_LOST']
    >>> bus.shutdown()
"""

from collections.abc import Callable, Iterator
from typing import Final

from cutgate.protocol.endpoint import Item
from cutgate.protocol.link import Violation
from cutgate.protocol.port import RETRY_S, Port
from cutgate.protocol.states import StopCause

MS_PER_S: Final = 1000.0


class Cycle:
    """The clock of one side's loop.

    In each cycle, in this order::

        poller.poll(1000.0 * cycle.wait_s())
        cycle.begin()
        for violation in cycle.late():  # feed each to the table before the next is asked for
            ...
        for item in cycle.read():
            ...
        if cycle.heartbeat_due():  # the last act but one: all that it says was decided in this cycle
            port.endpoint.send_frame(heartbeat, cycle.now_s)
        port.flush()

    Args:
        port: this side of the bus.
        clock: monotonic seconds.

    Attributes:
        now_s: when this cycle began.
        gap_s: so long after the one before.
        next_heartbeat_s: when one is due; whoever opens a session sets it.
        late_s: so long after it was due the last one was made.
    """

    def __init__(self, port: Port, clock: Callable[[], float]) -> None:
        self._port = port
        self._clock = clock
        self.now_s = self.next_heartbeat_s = clock()
        self.gap_s = self.late_s = 0.0

    def wait_s(self, next_s: float | None = None) -> float:
        """How long there is nothing to do unless something arrives, s.

        Args:
            next_s: when something is due, for a side that sends no heartbeats now.
        """
        due_s = self.next_heartbeat_s if next_s is None else next_s
        left_s = min(due_s, self._port.endpoint.link.expires_s) - self._clock()
        if self._port.waits:  # nothing wakes a loop when a full transmit queue has room again
            left_s = min(left_s, RETRY_S)
        return max(0.0, left_s)

    def begin(self) -> None:
        """Look at the clock."""
        now_s = self._clock()
        self.gap_s, self.now_s = now_s - self.now_s, now_s

    def late(self) -> Iterator[Violation]:
        """What time alone has brought about: this loop stood still, the peer is lost, a transfer did not end.

        One after the other: what the first of them voids is not too late as well.

        Raises:
            can.CanError: the bus has failed.
        """
        if not self._in_time(self.gap_s):
            yield self._stalled(self.gap_s, f"{self._port.discard()} frames discarded")
        yield from self._port.endpoint.expire(self.now_s)

    def read(self) -> list[Item]:
        """What arrived; nothing of it counts if the loop stood still at the bus, since it looked at its clock.

        Raises:
            can.CanError: the bus has failed.
        """
        items = self._port.read(self.now_s)
        gap_s = self._clock() - self.now_s
        if not self._in_time(gap_s):
            return [self._stalled(gap_s, f"{len(items)} items discarded at the bus")]
        return items

    def heartbeat_due(self) -> bool:
        """Whether this cycle makes a heartbeat: one is due, or takes the place of one that has not left. Ask once."""
        due = self.now_s >= self.next_heartbeat_s
        if due:
            self.late_s = self.now_s - self.next_heartbeat_s
            period_s = self._port.endpoint.link.heartbeat_s
            self.next_heartbeat_s = max(self.next_heartbeat_s + period_s, self.now_s)
        return due or self._port.endpoint.heartbeat_waits

    def _in_time(self, gap_s: float) -> bool:
        link = self._port.endpoint.link
        return not link.is_open or gap_s <= link.timeout_s

    def _stalled(self, gap_s: float, discarded: str) -> Violation:
        return Violation(
            StopCause.LOOP_STALLED, f"this computer stood still for {gap_s * MS_PER_S:.0f} ms; {discarded}"
        )
