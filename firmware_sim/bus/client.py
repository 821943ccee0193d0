"""python-can's way onto the virtual bus: `can.Bus(interface="cutgate", channel=...)`."""

import math
import os
import select
import socket
import time
from collections import deque
from typing import Any, Final, NamedTuple

import can

from cutgate.config.bus import LOCAL_CHANNEL, RuntimeDirectoryError, socket_path
from cutgate.firmware_sim.bus import wire
from cutgate.firmware_sim.bus.messages import frame_of, message_of
from cutgate.firmware_sim.bus.peer import UnreachableError, connected
from cutgate.firmware_sim.bus.states import CONTROLLER as ERROR_CONTROLLER
from cutgate.firmware_sim.bus.states import RECEIVE_OVERFLOW, overflow_frame
from cutgate.firmware_sim.bus.wire import HubKind, HubRecord, WireError

HELLO_TIMEOUT_S: Final = 2.0

__all__ = ["ERROR_CONTROLLER", "RECEIVE_OVERFLOW", "VirtualBus"]


class VirtualBus(can.BusABC):
    """One client of the hub.

    `recv` gives frames in the order of the bus. Where the hub had to drop frames because this client read too
    slowly, it gives an error frame (identifier 0x004, data byte 1 = 0x01, bytes 4 to 7 = how many, big-endian),
    and `lost_frames` counts them. Once the hub has ended or sent anything wrong, every `recv` and `send` raises
    `can.CanOperationError`. One thread may send while another receives; neither changes the socket's mode.

    Args:
        channel: a socket's path, or a name that stands for one in the user's runtime directory.
        can_filters: as for every python-can bus; applied on this side.
        receive_own_messages: whether frames sent here come back, in their place in the bus's order.
        fd: whether FD frames may be sent and are received.
        **kwargs: what python-can hands over and this bus does not have, such as `bitrate`.

    Raises:
        ValueError: `channel` is neither a path nor a name.
        can.CanInitializationError: nobody serves there, or somebody else, or the hub refuses.
    """

    def __init__(
        self,
        channel: Any = LOCAL_CHANNEL,
        can_filters: Any = None,
        *,
        receive_own_messages: bool = False,
        fd: bool = False,
        **kwargs: object,
    ) -> None:
        try:
            path = str(socket_path(str(channel)))
        except RuntimeDirectoryError as error:
            raise can.CanInitializationError(str(error)) from error
        self.channel = str(channel)
        self.channel_info = f"virtual bus {path}"
        self.lost_frames = 0
        self._path = path
        self._fd_frames = fd
        self._failure: str | None = None
        self._can_protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
        self._waiting: deque[tuple[can.Message, bool]] = deque()
        """Frames of the datagram that is still in the socket; and whether the filters are to leave them alone."""
        self._room: int | None = None
        self._sock, self._depth, self._room = _join(path, wire.hello(fd=fd, own=receive_own_messages))
        self._readable = select.poll()
        self._readable.register(self._sock, select.POLLIN)
        self._writable = select.poll()
        self._writable.register(self._sock, select.POLLOUT)
        self._has_room = select.poll()
        self._has_room.register(self._sock, 0)  # woken when the hub ends
        if self._room is not None:
            self._has_room.register(self._room, select.POLLIN)
        super().__init__(channel=channel, can_filters=can_filters, **kwargs)

    def fileno(self) -> int:
        """The socket, for poll: readable when a frame waits or the hub has ended."""
        return self._sock.fileno()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        """Receive one frame.

        Raises:
            can.CanOperationError: the hub has ended or misbehaved, now or earlier.
        """
        deadline = math.inf if timeout is None else time.monotonic() + timeout
        while not self._waiting:
            self._refuse_after_failure()
            try:
                # Left in the socket until its last frame is taken: so long it stays readable for whoever polls it.
                raw = self._sock.recv(wire.MAX_DATAGRAM, socket.MSG_DONTWAIT | socket.MSG_PEEK)
            except BlockingIOError:
                if not _wait(self._readable, deadline):
                    return None, False
                continue
            except OSError as error:
                raise self._fail(f"the hub at {self._path} has ended: {error.strerror}") from error
            if not raw:
                raise self._fail(f"the hub at {self._path} has ended")
            self._took(raw)
        next_one = self._waiting.popleft()
        if not self._waiting:
            self._sock.recv(1, socket.MSG_DONTWAIT)
        return next_one

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Put one frame on the bus; returns once the hub's socket has taken it.

        Args:
            msg: the frame.
            timeout: seconds to wait while the hub's queue is full; None waits as long as it takes, 0 not at all.

        Raises:
            can.CanTimeoutError: the queue stayed full; the frame was not sent and the bus still works.
            can.CanOperationError: a frame no CAN bus carries, or the hub has ended, now or earlier.
        """
        raw = wire.of_frame(frame_of(msg, fd=self._fd_frames))
        deadline = math.inf if timeout is None else time.monotonic() + timeout
        self._refuse_after_failure()
        self._take_room(deadline)
        while True:
            try:
                self._sock.send(raw, socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)
            except BlockingIOError:
                if not _wait(self._writable, deadline):
                    self._give_room_back()
                    raise can.CanTimeoutError(
                        f"the hub at {self._path} did not take the frame within {timeout} s"
                    ) from None
                self._refuse_after_failure()
            except OSError as error:
                raise self._fail(f"the hub at {self._path} has ended: {error.strerror}") from error
            else:
                return

    def _take_room(self, deadline: float) -> None:
        """A place in the transmit queue of a paced bus.

        Raises:
            can.CanTimeoutError: it stayed full.
        """
        while self._room is not None:
            try:
                os.eventfd_read(self._room)
            except BlockingIOError:
                if not _wait(self._has_room, deadline):
                    raise can.CanTimeoutError(
                        f"the transmit queue at {self._path}, of {self._depth} frames, is full"
                    ) from None
                if self._is_gone():
                    raise self._fail(f"the hub at {self._path} has ended") from None
            else:
                return

    def _give_room_back(self) -> None:
        if self._room is not None:
            os.eventfd_write(self._room, 1)

    def _is_gone(self) -> bool:
        gone = select.poll()
        gone.register(self._sock, 0)
        return bool(gone.poll(0))

    def shutdown(self) -> None:
        """Leave the bus; may be called more than once."""
        super().shutdown()
        self._failure = self._failure or "the bus was shut down by this program"
        self._sock.close()
        if self._room is not None:
            os.close(self._room)
            self._room = None

    def _took(self, raw: bytes) -> None:
        """Read one datagram; its frames wait until they are asked for.

        Raises:
            can.CanOperationError: the hub says nonsense, or closes this connection.
        """
        try:
            records = wire.parse_all(raw)
        except WireError as error:
            raise self._fail(f"the hub at {self._path} sent an unknown record: {error}") from error
        first = records[0]
        if first.kind is HubKind.FRAME:
            self._waiting.extend((_to_message(record, self.channel), False) for record in records)
        elif first.kind is HubKind.OVERRUN:
            self.lost_frames += first.number
            self._waiting.append((_overrun_message(first, self.channel), True))  # no filter may hide a loss
        else:
            reason = first.data.decode(errors="replace") or first.kind.name
            raise self._fail(f"the hub at {self._path} closed this connection: {reason}")

    def _fail(self, reason: str) -> can.CanOperationError:
        self._failure = reason
        return can.CanOperationError(reason)

    def _refuse_after_failure(self) -> None:
        if self._failure is not None:
            raise can.CanOperationError(self._failure)


def _to_message(record: HubRecord, channel: str) -> can.Message:
    return message_of(record.frame, record.time_ns * 1e-9, channel)


def _overrun_message(record: HubRecord, channel: str) -> can.Message:
    return message_of(overflow_frame(RECEIVE_OVERFLOW, record.number), record.time_ns * 1e-9, channel)


def _wait(poll: select.poll, deadline: float) -> bool:
    """Whether the socket became ready before the deadline of `time.monotonic()`."""
    left_s = deadline - time.monotonic()
    if left_s == math.inf:
        return bool(poll.poll())
    return bool(poll.poll(math.ceil(max(0.0, left_s) * 1000)))


class _Joined(NamedTuple):
    """A connection that was welcomed: the transmit queue's frames, 0 where it is not paced, and what counts its room."""

    sock: socket.socket
    depth: int
    room: int | None


def _join(path: str, hello: HubRecord) -> _Joined:
    """Connect and be welcomed.

    Raises:
        can.CanInitializationError: see `VirtualBus`.
    """
    try:
        sock = connected(path)
    except UnreachableError as error:
        raise can.CanInitializationError(f"virtual bus {path}: {error}") from error
    try:
        return _welcomed(sock, hello)
    except (OSError, WireError) as error:
        sock.close()
        raise can.CanInitializationError(f"virtual bus {path}: {error}") from error


def _welcomed(sock: socket.socket, hello: HubRecord) -> _Joined:
    """Say hello. Raises WireError with the reason where this client is not let in."""
    sock.send(hello.pack(), socket.MSG_NOSIGNAL)
    answer = select.poll()
    answer.register(sock, select.POLLIN)
    if not answer.poll(HELLO_TIMEOUT_S * 1000):
        raise WireError(f"the hub did not answer within {HELLO_TIMEOUT_S} s: end it and start another")
    raw, room, _, _ = socket.recv_fds(sock, wire.MAX_DATAGRAM, 1)
    try:
        depth = _depth_of(raw)
    except WireError:
        for descriptor in room:
            os.close(descriptor)
        raise
    if bool(depth) != bool(room):
        raise WireError("the hub says a transmit queue and gives no room for it: end it and start another")
    return _Joined(sock, depth, room[0] if room else None)


def _depth_of(raw: bytes) -> int:
    """The frames that the transmit queue holds, of the hub's answer. Raises WireError where that is no welcome."""
    if not raw:
        raise WireError("the hub ended before it answered: start it again")
    reply = wire.parse(raw)
    if reply.kind is not HubKind.WELCOME:
        raise WireError(f"the hub refused: {reply.data.decode(errors='replace')}")
    return reply.number
