"""The thin shell between an endpoint and a CAN bus; both sides use it.

It reads a bounded number of frames a cycle, sends what the endpoint has queued, and shows every frame that passes
to a recorder. A bus that takes no more has not failed: what waits goes in the next cycle. It decides nothing.

How a :class:`Port` is used: :meth:`Port.read` once a cycle; queue what is to be sent at ``port.endpoint``; then
:meth:`Port.flush` as the last act of the cycle, always. While :attr:`Port.waits` says that something is left, the
next cycle begins within :data:`RETRY_S`. :meth:`Port.leave_now` before anything that may take long, as writing a
file; :meth:`Port.flush_last` before the loop ends. ``cycle.Cycle`` says when.

Two ports on one bus::

    >>> from cutgate.protocol.endpoint import Accepted
    >>> from cutgate.protocol.frames import RuntimeStop
    >>> from cutgate.protocol.states import StopCause, StopCode
    >>> from cutgate.protocol.wire import Side
    >>> buses = [can.Bus(channel="port", interface="virtual") for _side in Side]
    >>> runtime, controller = (
    ...     Port(bus, Endpoint(side, bytes(32), heartbeat_s=0.02, timeout_s=0.1, transfer_timeout_s=2.0))
    ...     for side, bus in zip(Side, buses, strict=True)
    ... )
    >>> for port in (runtime, controller):
    ...     port.endpoint.use_session(bytes(range(32)))
    ...     port.endpoint.open_link(now_s=0.0)
    >>> runtime.endpoint.send_frame(RuntimeStop(StopCode.STOP, StopCause.OPERATOR_STOP), now_s=0.01)
    >>> controller.read(now_s=0.01)  # queued is not sent
    []
    >>> runtime.flush()
    True
    >>> [item.frame.cause.name for item in controller.read(now_s=0.01) if isinstance(item, Accepted)]
    ['OPERATOR_STOP']
    >>> for bus in buses:
    ...     bus.shutdown()
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import can

from cutgate.protocol.endpoint import Endpoint, Item

READ_FRAMES_MAX = 512
"""Frames read in one cycle; more wait for the next, so that clocks are looked at in between."""
DISCARD_FRAMES_MAX = 100_000
RETRY_S = 0.001
"""So soon the next cycle begins while something waits: nothing wakes it when a full transmit queue has room again."""
LAST_TRIES = 100
"""So often, `RETRY_S` apart, the last words are tried: about as long as the other side waits for a heartbeat."""


@dataclass(frozen=True)
class Passed:
    """A frame that passed the bus, as the log keeps it."""

    direction: Literal["received", "sent"]
    can_id: int
    data: bytes
    is_extended: bool
    is_remote: bool
    is_error: bool
    is_fd: bool
    bit_rate_switch: bool = False
    """The data of an FD frame were sent at the higher bit rate."""


Recorder = Callable[[Passed], None]


class Port:
    """A bus and one side's endpoint.

    Args:
        bus: an open python-can bus; its ``recv`` must raise on every call after the bus failed.
        endpoint: this side's endpoint.
        recorder: shown every frame read and sent.
    """

    def __init__(self, bus: can.BusABC, endpoint: Endpoint, recorder: Recorder | None = None) -> None:
        self.bus = bus
        self.endpoint = endpoint
        self._recorder = recorder
        self.waits = False
        """Whether the bus did not take everything when it was last asked."""

    def read(self, now_s: float) -> list[Item]:
        """Everything that waits, at most ``READ_FRAMES_MAX`` frames. What came before a failure counts; the next read raises.

        Raises:
            can.CanError: the bus has failed.
        """
        items: list[Item] = []
        for _ in range(READ_FRAMES_MAX):
            try:
                message = self.bus.recv(timeout=0)
            except can.CanError:
                if items:
                    break
                raise
            if message is None:
                break
            self._record("received", message)
            items += self.endpoint.receive(
                message.arbitration_id,
                bytes(message.data),
                is_extended=message.is_extended_id,
                is_remote=message.is_remote_frame,
                is_fd=message.is_fd,
                is_error=message.is_error_frame,
                now_s=now_s,
            )
        return items

    def discard(self) -> int:
        """Throw away everything that waits: it came while this side was not looking. Returns how many frames.

        Raises:
            can.CanError: the bus has failed.
        """
        for count in range(DISCARD_FRAMES_MAX):
            message = self.bus.recv(timeout=0)
            if message is None:
                return count
            self._record("received", message)
        return DISCARD_FRAMES_MAX

    def flush(self) -> bool:
        """Send what is queued, most urgent first, until the bus takes no more; True if nothing waits any longer.

        Raises:
            can.CanError: the bus has failed.
        """
        self.waits = not self.endpoint.hand_out(self._send)
        return not self.waits

    def leave_now(self) -> can.CanError | None:
        """As ``flush``, before anything that may take long; also on a bus that has failed, which may still be written.

        Returns:
            The failure of the bus, None where there is none: it fails in the next ``flush`` as well.
        """
        try:
            self.flush()
        except can.CanError as error:
            return error
        return None

    def flush_last(self, pause: Callable[[float], None] = time.sleep) -> bool:
        """The last words before this side falls silent: as ``flush``, again for a bounded time while some wait.

        Raises:
            can.CanError: the bus has failed.
        """
        for _ in range(LAST_TRIES):
            if self.flush():
                break
            pause(RETRY_S)
        return not self.waits

    def _send(self, can_id: int, data: bytes) -> bool:
        """Whether the bus took this frame; a full transmit queue does not, and loses nothing."""
        fd = self.endpoint.is_fd(can_id)
        message = can.Message(
            arbitration_id=can_id, data=data, is_extended_id=False, is_fd=fd, bitrate_switch=fd
        )
        try:
            self.bus.send(message, timeout=0)
        except can.CanTimeoutError:
            return False
        self._record("sent", message)
        return True

    def _record(self, direction: Literal["received", "sent"], message: can.Message) -> None:
        if self._recorder is not None:
            self._recorder(
                Passed(
                    direction,
                    message.arbitration_id,
                    bytes(message.data),
                    message.is_extended_id,
                    message.is_remote_frame,
                    message.is_error_frame,
                    message.is_fd,
                    message.bitrate_switch,
                )
            )
