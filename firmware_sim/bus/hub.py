"""The hub of the virtual bus: one process that joins every client of one AF_UNIX socket into a CAN bus.

What it guarantees:

- Each frame reaches every other client, and its sender only if that asked for its own frames.
- One order for all: any two clients see the frames they both receive in the same order, the order of the log.
- Nothing is lost silently. Each client has its own bounded queue; a client that does not read neither blocks the
  others nor makes them lose a frame. When its own queue is full, it is told where and how many frames it lost.
- The socket has mode 0600 before anybody can connect. A dead hub's socket is replaced, a living hub's never.
- Only processes of the hub's own user take part, root's neither.
- Whoever connects and says nothing is dropped soon, and keeps nobody out.
"""

import errno
import json
import os
import select
import socket
import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Final, Self, TextIO

from cutgate.config.signals import wake
from cutgate.firmware_sim.bus import wire
from cutgate.firmware_sim.bus.carriers import AtOnce, Carrier, Credit, Delivery, Effect, Paced
from cutgate.firmware_sim.bus.control import inject, status
from cutgate.firmware_sim.bus.frame import Flag
from cutgate.firmware_sim.bus.peer import peer_of
from cutgate.firmware_sim.bus.socket_place import MAX_CLIENTS, HubError, identity, is_served, listen
from cutgate.firmware_sim.bus.wire import HubKind, HubRecord, WireError, Wish
from cutgate.protocol import candump

QUEUE_FRAMES: Final = 65_536
HELLO_S: Final = 1.0
"""Within this time a connection says HELLO or is dropped; a client says it at once."""

_READS_A_CYCLE: Final = 64  # a busy client waits for its next cycle after so many frames
_READ: Final = select.EPOLLIN
_READ_WRITE: Final = select.EPOLLIN | select.EPOLLOUT
_GONE: Final = select.EPOLLHUP | select.EPOLLERR
_COARSE_S: Final = 0.003


__all__ = ["Hub", "HubError", "is_served", "log_line"]


@dataclass(slots=True, eq=False)
class _Client:
    """A connected client; it takes part from its HELLO on."""

    sock: socket.socket
    number: int
    name: str
    until_s: float
    """When its HELLO must have come."""
    joined: bool = False
    fd_frames: bool = False
    own_frames: bool = False
    queue: deque[tuple[bytes, int]] = field(default_factory=deque)
    """Datagrams that wait, and how many frames each holds."""
    waiting: int = 0
    """Frames in them."""
    lost: int = 0
    """Frames of which it has not been told."""
    lost_frames: int = 0
    polled: bool = False
    """Whether the hub waits until its socket takes more."""
    room: int | None = None
    """What counts the room in its transmit queue, on a paced bus."""


class Hub:
    """A hub bound to its socket; `serve` runs it until `stop`.

    Args:
        path: where the socket is made; its directory must exist.
        queue_frames: frames that wait to be read by one client before it loses some.
        pace: makes what carries the frames, at the speed of a wire; without it they are carried at once.
        report: told about overruns and refused clients, one line each; it must not wait for anybody.

    Raises:
        HubError: a living hub serves there, something else stands there, or the path cannot be a socket's.
    """

    def __init__(
        self,
        path: Path,
        *,
        queue_frames: int = QUEUE_FRAMES,
        pace: Callable[[Callable[[str], None]], Paced] | None = None,
        report: Callable[[str], None] | None = None,
    ) -> None:
        if not queue_frames >= 2:
            raise HubError(f"queue of {queue_frames} frames: at least 2 are needed")
        self.path = path
        self._log: TextIO | None = None
        self._log_name = "_".join(path.stem.split()) or "cutgate"
        self._queue_frames = queue_frames
        self._report = report or (lambda _line: None)
        self._carrier: Carrier = AtOnce() if pace is None else pace(self._report)
        self._clients: dict[int, _Client] = {}
        """By descriptor."""
        self._joined: dict[int, _Client] = {}
        """By number, those that take part."""
        self._dirty: set[_Client] = set()
        """Those for whom something was queued in this turn."""
        self._silent: deque[_Client] = deque()
        """Those that may not have said HELLO, the oldest first."""
        self._lost_clients: set[int] = set()
        self._stopped = False
        self._watched = -1
        self._born = 0
        self._listener = listen(path)
        self._identity = identity(path)
        self._wake_read, self._wake_write = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._poll = select.epoll()
        self._poll.register(self._listener, _READ)
        self._poll.register(self._wake_read, _READ)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def stop(self) -> None:
        """Make `serve` return; may be called from a signal handler or another thread, and more than once."""
        wake(self._wake_write)

    @property
    def wake(self) -> int:
        """A non-blocking pipe: whatever is written into it makes `serve` return."""
        return self._wake_write

    def log_to(self, log: TextIO) -> None:
        """Write each frame from now on as a line of `candump -L`."""
        self._log = log

    def stop_when_closed(self, descriptor: int) -> None:
        """End as well when the other end of this pipe is closed, so that no hub outlives who started it."""
        self._watched = descriptor
        self._poll.register(descriptor, _READ)

    def serve(self) -> None:
        """Carry frames until stopped.

        Raises:
            HubError: the log cannot be written; a bus whose log has a gap must not go on.
        """
        while not self._stopped:
            for descriptor, events in self._wait():
                self._attend(descriptor, events)
                self._flush_dirty()
                self._drop_lost_clients()
            self._carry_out(self._carrier.go_on())
            self._flush_dirty()
            self._drop_silent_clients()
            self._flush_log()

    def _wait(self) -> list[tuple[int, int]]:
        """What can be read or written, once something can or the carrier has something to do."""
        wait_s = min((s for s in (self._patience_s(), self._carrier.wait_s()) if s is not None), default=None)
        if (
            wait_s is not None and wait_s < _COARSE_S
        ):  # epoll counts milliseconds, a frame takes a tenth of one
            select.select([self._poll], [], [], wait_s)
            wait_s = 0.0
        return self._poll.poll(wait_s)

    def close(self) -> None:
        """Close every connection and remove the socket, if it is still this hub's own."""
        if self._listener.fileno() < 0:
            return
        if identity(self.path) == self._identity:
            self.path.unlink()
        for client in self._clients.values():
            _close(client)
        self._clients.clear()
        self._joined.clear()
        self._listener.close()
        self._poll.close()
        os.close(self._wake_read)
        os.close(self._wake_write)

    def _attend(self, descriptor: int, events: int) -> None:
        if descriptor == self._wake_read:
            self._stopped = True
        elif descriptor == self._watched:
            self._stopped = self._stopped or not os.read(descriptor, 4096)
        elif descriptor == self._listener.fileno():
            self._accept()
        elif (client := self._clients.get(descriptor)) is not None:
            if events & select.EPOLLOUT:
                self._flush(client)
            if events & (_READ | _GONE):
                self._read(client)

    def _accept(self) -> None:
        try:
            sock, _ = self._listener.accept()
        except (BlockingIOError, ConnectionAbortedError):
            return  # the client has gone again
        except OSError as error:
            if error.errno not in (errno.EMFILE, errno.ENFILE) or not self._silent:
                raise
            self._refuse(self._silent.popleft(), "no descriptor is left for another connection")
            return  # it is asked again, and finds the one that was given up
        sock.setblocking(False)
        self._born += 1
        peer = peer_of(sock)
        name = f"client {self._born} (process {peer.process})"
        client = _Client(sock, self._born, name, time.monotonic() + HELLO_S)
        self._clients[sock.fileno()] = client
        self._poll.register(sock, _READ)
        if (stranger := peer.stranger) is not None:
            self._refuse(client, stranger)
            return
        self._silent.append(client)
        if len(self._silent) > MAX_CLIENTS:  # who has been silent longest makes room
            self._refuse(self._silent.popleft(), "too many connections without a HELLO")

    def _read(self, client: _Client) -> None:
        for _ in range(_READS_A_CYCLE):
            try:
                raw = client.sock.recv(wire.MAX_DATAGRAM + 1)
            except BlockingIOError:
                return
            except OSError:
                raw = b""
            if not raw:
                self._lost_clients.add(client.sock.fileno())
                return
            try:
                self._take(client, raw)
            except WireError as error:
                self._refuse(client, str(error))
                return

    def _take(self, client: _Client, raw: bytes) -> None:
        if len(raw) > wire.MAX_DATAGRAM:
            raise WireError(f"datagram of more than {wire.MAX_DATAGRAM} bytes")
        if client.joined:
            self._carry_out(self._carrier.take(client.number, raw))
            return
        record = wire.parse(raw)
        match record.kind:
            case HubKind.HELLO if record.data == wire.MAGIC:
                self._welcome(client, record.flags)
            case HubKind.STAT:
                self._answer(client, wire.text(HubKind.STATUS, json.dumps(self.status())))
            case HubKind.INJECT:
                answer = inject(self._carrier, record.data.decode(errors="replace"))
                self._answer(client, wire.text(HubKind.TEXT, answer))
            case kind:
                raise WireError(f"{kind.name} is out of place")

    def _welcome(self, client: _Client, wishes: int) -> None:
        if len(self._joined) >= MAX_CLIENTS:
            raise WireError(f"the bus has {MAX_CLIENTS} clients already")
        if wishes & Wish.FD and not self._carrier.fd:
            raise WireError("this bus carries no FD frames; give it their bit rate (bus serve --fd)")
        client.fd_frames, client.own_frames = bool(wishes & Wish.FD), bool(wishes & Wish.OWN)
        depth = self._carrier.depth
        if depth:
            client.room = os.eventfd(depth, os.EFD_SEMAPHORE | os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        client.joined = True
        self._silent.remove(client)
        try:
            socket.send_fds(
                client.sock,
                [HubRecord(HubKind.WELCOME, number=depth).pack()],
                [] if client.room is None else [client.room],
                socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL,
            )
        except OSError:  # it has gone again
            self._lost_clients.add(client.sock.fileno())
            return
        self._joined[client.number] = client
        self._carrier.join(client.number, client.name)

    def _answer(self, client: _Client, record: HubRecord) -> None:
        """The one word for who takes no part."""
        self._send(client, record.pack())
        self._lost_clients.add(client.sock.fileno())

    def status(self) -> dict[str, object]:
        """What is going on, as `cutgate bus stat --json` prints it."""
        queues = {
            client.number: (client.name, client.waiting, client.lost_frames)
            for client in self._joined.values()
        }
        return status(self._carrier, queues)

    # ------------------------------------------------------------ from the carrier to the clients

    def _carry_out(self, effects: Iterable[Effect]) -> None:
        for effect in effects:
            match effect:
                case Delivery():
                    self._deliver(effect)
                case Credit(client, frames) if client in self._joined:
                    _give_room(self._joined[client], frames)

    def _deliver(self, delivery: Delivery) -> None:
        if self._log is not None and delivery.logged:
            for record in wire.parse_all(delivery.raw):
                self._write_log(record)
        for number in delivery.receivers:
            client = self._joined.get(number)
            if client is None:
                continue
            if client.fd_frames or not delivery.fd:
                self._offer(client, delivery.raw, delivery.frames)
            elif delivery.fd < delivery.frames:
                self._offer(client, wire.without_fd(delivery.raw), delivery.frames - delivery.fd)
        for number in delivery.own:
            client = self._joined.get(number)
            if client is not None and client.own_frames:
                self._offer(client, wire.own_copies(delivery.raw), delivery.frames)

    def _offer(self, client: _Client, raw: bytes, count: int) -> None:
        if client.lost or client.waiting + count > self._queue_frames:
            client.lost += count
            client.lost_frames += count
            return
        client.queue.append((raw, count))
        client.waiting += count
        self._dirty.add(client)

    def _flush_dirty(self) -> None:
        for client in self._dirty:
            if not client.polled:
                self._flush(client)
        self._dirty.clear()

    def _flush(self, client: _Client) -> None:
        """Send what waits, as much in one datagram as fits, until the socket takes no more."""
        queue = client.queue
        while queue:
            raw, frames, datagrams = _head_of(queue)
            if not self._send(client, raw):
                break
            client.waiting -= frames
            for _ in range(datagrams):
                queue.popleft()
        if client.lost and client.waiting <= self._queue_frames // 2:
            # Only half-way down, so that a client at its limit gets frames in runs, not one here and there.
            self._tell_losses(client)
        if bool(queue) != client.polled:
            client.polled = bool(queue)
            self._poll.modify(client.sock, _READ_WRITE if queue else _READ)

    def _tell_losses(self, client: _Client) -> None:
        told = HubRecord(HubKind.OVERRUN, number=min(client.lost, 0xFFFF_FFFF), time_ns=time.time_ns())
        client.queue.append((told.pack(), 0))
        self._report(f"{client.name} lost {client.lost} frames: it reads too slowly")
        client.lost = 0

    def _send(self, client: _Client, raw: bytes) -> bool:
        """Whether the record is dealt with: sent, or its receiver is gone."""
        try:
            client.sock.send(raw, socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)
        except BlockingIOError:
            return False
        except OSError:
            self._lost_clients.add(client.sock.fileno())
        return True

    def _refuse(self, client: _Client, reason: str) -> None:
        self._report(f"{client.name} refused: {reason}")
        self._send(client, wire.refused(reason).pack())
        self._lost_clients.add(client.sock.fileno())

    def _drop_lost_clients(self) -> None:
        for descriptor in self._lost_clients:
            client = self._clients.pop(descriptor, None)
            if client is not None:
                self._poll.unregister(descriptor)
                _close(client)
                if self._joined.pop(client.number, None) is not None:
                    self._carrier.leave(client.number)
                if client in self._silent:
                    self._silent.remove(client)
        self._lost_clients.clear()

    def _patience_s(self) -> float | None:
        """How long the oldest silent client still has; None where there is none."""
        if not self._silent:
            return None
        return max(0.0, self._silent[0].until_s - time.monotonic())

    def _drop_silent_clients(self) -> None:
        while self._silent and not time.monotonic() < self._silent[0].until_s:
            self._refuse(self._silent.popleft(), f"it said no HELLO within {HELLO_S:g} s")
        self._drop_lost_clients()

    def _write_log(self, frame: HubRecord) -> None:
        assert self._log is not None  # noqa: S101 - narrowed by the caller
        try:
            self._log.write(log_line(frame, self._log_name))
        except OSError as error:
            raise HubError(
                f"log {self._log.name} cannot be written: {error.strerror}; free some space"
            ) from error

    def _flush_log(self) -> None:
        if self._log is None:
            return
        try:
            self._log.flush()
        except OSError as error:
            raise HubError(
                f"log {self._log.name} cannot be written: {error.strerror}; free some space"
            ) from error


def _head_of(queue: deque[tuple[bytes, int]]) -> tuple[bytes, int, int]:
    """What waits first, as much of it as one datagram takes: the bytes, the frames, and the entries of the queue.

    An entry without frames, which says that some were lost, goes alone.
    """
    raw, frames = queue[0]
    if len(queue) == 1 or not frames:
        return raw, frames, 1
    parts, size = [raw], len(raw)
    for more, count in islice(queue, 1, None):
        size += len(more)
        if not count or size > wire.MAX_DATAGRAM:
            break
        parts.append(more)
        frames += count
    return b"".join(parts), frames, len(parts)


def _give_room(client: _Client, frames: int | None) -> None:
    """QueueRoom in a client's transmit queue; None takes away what it has."""
    if client.room is None:
        return
    if frames is not None:
        os.eventfd_write(client.room, frames)
        return
    with suppress(BlockingIOError):
        while True:
            os.eventfd_read(client.room)


def _close(client: _Client) -> None:
    client.sock.close()
    if client.room is not None:
        os.close(client.room)
        client.room = None


def log_line(frame: HubRecord, name: str) -> str:
    """A frame that ``wire.check_frame`` accepts, with the hub's time, as a line of its log."""

    def has(flag: Flag) -> bool:
        return bool(frame.flags & flag)

    return candump.line(
        frame.time_ns,
        name,
        frame.number,
        frame.data,
        is_extended=has(Flag.EXTENDED),
        is_remote=has(Flag.REMOTE),
        is_error=has(Flag.ERROR),
        is_fd=has(Flag.FD),
        bit_rate_switch=has(Flag.BIT_RATE_SWITCH),
        error_state=has(Flag.ERROR_STATE),
        remote_length=frame.length if has(Flag.REMOTE) else 0,
    )
