"""The thin shell between an endpoint and a CAN bus; both sides use it.

It reads a bounded number of frames a turn, sends what the endpoint has queued, and shows every frame that passes
to a recorder. It decides nothing.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import can

from cutgate.protocol.endpoint import Endpoint, Item

READ_FRAMES_MAX = 512
"""Frames read in one turn; more wait for the next, so that clocks are looked at in between."""
DISCARD_FRAMES_MAX = 100_000


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

    def read(self, now_s: float) -> list[Item]:
        """Everything that waits, at most ``READ_FRAMES_MAX`` frames.

        Raises:
            can.CanError: the bus has failed.
        """
        items: list[Item] = []
        for _ in range(READ_FRAMES_MAX):
            message = self.bus.recv(timeout=0)
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
        """Send what is queued; True if anything left.

        Raises:
            can.CanError: the bus has failed.
        """
        frames = self.endpoint.outgoing()
        for can_id, data in frames:
            fd = self.endpoint.is_fd(can_id)
            message = can.Message(
                arbitration_id=can_id, data=data, is_extended_id=False, is_fd=fd, bitrate_switch=fd
            )
            self.bus.send(message, timeout=0)
            self._record("sent", message)
        return bool(frames)

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
