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
import fcntl
import math
import os
import select
import socket
import stat
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Self, TextIO

from cutgate.config.signals import wake
from cutgate.firmware_sim.bus import wire
from cutgate.firmware_sim.bus.peer import peer_of
from cutgate.firmware_sim.bus.wire import Flag, HubKind, HubRecord, WireError
from cutgate.protocol import candump

QUEUE_FRAMES: Final = 65_536
MAX_CLIENTS: Final = 64
"""So many take part, and so many more may be about to."""
HELLO_S: Final = 1.0
"""Within this time a connection says HELLO or is dropped; a client says it at once."""
MAX_SOCKET_PATH_BYTES: Final = 107

_READS_A_CYCLE: Final = 64  # a busy client waits for its next cycle after so many frames
_READ: Final = select.POLLIN
_READ_WRITE: Final = select.POLLIN | select.POLLOUT
_GONE: Final = select.POLLHUP | select.POLLERR | select.POLLNVAL
_LOCK_TRIES: Final = 200
_LOCK_PAUSE_S: Final = 0.01


class HubError(Exception):
    """The hub cannot serve: the socket's place, or the log."""


@dataclass(slots=True, eq=False)
class _Client:
    """A connected client; it takes part from its HELLO on."""

    sock: socket.socket
    name: str
    until_s: float
    """When its HELLO must have come."""
    joined: bool = False
    fd_frames: bool = False
    own_frames: bool = False
    queue: deque[bytes] = field(default_factory=deque)
    lost: int = 0


class Hub:
    """A hub bound to its socket; `serve` runs it until `stop`.

    Args:
        path: where the socket is made; its directory must exist.
        queue_frames: frames that wait for one client before it loses some.
        report: told about overruns and refused clients, one line each; it must not wait for anybody.

    Raises:
        HubError: a living hub serves there, something else stands there, or the path cannot be a socket's.
    """

    def __init__(
        self,
        path: Path,
        *,
        queue_frames: int = QUEUE_FRAMES,
        report: Callable[[str], None] | None = None,
    ) -> None:
        if not queue_frames >= 2:
            raise HubError(f"queue of {queue_frames} frames: at least 2 are needed")
        self.path = path
        self._log: TextIO | None = None
        self._log_name = "_".join(path.stem.split()) or "cutgate"
        self._queue_frames = queue_frames
        self._report = report or (lambda _line: None)
        self._clients: dict[int, _Client] = {}
        self._silent: deque[_Client] = deque()
        """Those that may not have said HELLO, the oldest first."""
        self._lost_clients: set[int] = set()
        self._last_ns = 0
        self._stopped = False
        self._watched = -1
        self._born = 0
        self._listener = _listen(path)
        self._identity = _identity(path)
        self._wake_read, self._wake_write = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._poll = select.poll()
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
            for descriptor, events in self._poll.poll(self._patience_ms()):
                self._attend(descriptor, events)
                self._drop_lost_clients()
            self._drop_silent_clients()
            self._flush_log()

    def close(self) -> None:
        """Close every connection and remove the socket, if it is still this hub's own."""
        if self._listener.fileno() < 0:
            return
        if _identity(self.path) == self._identity:
            self.path.unlink()
        for client in self._clients.values():
            client.sock.close()
        self._clients.clear()
        self._listener.close()
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
            if events & select.POLLOUT:
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
        client = _Client(sock, name, time.monotonic() + HELLO_S)
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
                raw = client.sock.recv(wire.MAX_RECORD + 1)
            except BlockingIOError:
                return
            except OSError:
                raw = b""
            if not raw:
                self._lost_clients.add(client.sock.fileno())
                return
            try:
                self._take(client, wire.parse(raw))
            except WireError as error:
                self._refuse(client, str(error))
                return

    def _take(self, client: _Client, record: HubRecord) -> None:
        if client.joined and record.kind is HubKind.FRAME:
            self._carry(client, record)
        elif not client.joined and record.kind is HubKind.HELLO and record.data == wire.MAGIC:
            if sum(other.joined for other in self._clients.values()) >= MAX_CLIENTS:
                raise WireError(f"the bus has {MAX_CLIENTS} clients already")
            client.fd_frames = bool(record.flags & Flag.FD)
            client.own_frames = bool(record.flags & Flag.OWN)
            client.joined = True
            self._silent.remove(client)
            self._offer(client, HubRecord(HubKind.WELCOME).pack())
        else:
            raise WireError(f"{record.kind.name} is out of place")

    def _carry(self, sender: _Client, frame: HubRecord) -> None:
        """Put one frame on the bus: stamp it, log it, offer it to all who take it."""
        wire.check_frame(frame)
        if frame.flags & Flag.OWN:
            raise WireError("flag OWN is the hub's to set")
        self._last_ns = max(self._last_ns, time.time_ns())
        stamped = HubRecord(HubKind.FRAME, frame.flags, frame.number, self._last_ns, frame.length, frame.data)
        raw = stamped.pack()
        if self._log is not None:
            self._write_log(stamped)
        for client in self._clients.values():
            if not client.joined or (frame.flags & Flag.FD and not client.fd_frames):
                continue
            if client is not sender:
                self._offer(client, raw)
            elif client.own_frames:
                own = HubRecord(
                    HubKind.FRAME,
                    frame.flags | Flag.OWN,
                    frame.number,
                    self._last_ns,
                    frame.length,
                    frame.data,
                )
                self._offer(client, own.pack())

    def _offer(self, client: _Client, raw: bytes) -> None:
        if client.lost or len(client.queue) >= self._queue_frames:
            client.lost += 1
        elif client.queue or not self._send(client, raw):
            client.queue.append(raw)
            if len(client.queue) == 1:
                self._poll.modify(client.sock, _READ_WRITE)

    def _flush(self, client: _Client) -> None:
        queue = client.queue
        while queue and self._send(client, queue[0]):
            queue.popleft()
        if client.lost and len(queue) <= self._queue_frames // 2:
            # Only half-way down, so that a client at its limit gets frames in runs, not one here and there.
            told = HubRecord(HubKind.OVERRUN, number=min(client.lost, 0xFFFF_FFFF), time_ns=self._last_ns)
            queue.append(told.pack())
            self._report(f"{client.name} lost {client.lost} frames: it reads too slowly")
            client.lost = 0
        if not queue:
            self._poll.modify(client.sock, _READ)

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
                client.sock.close()
                if client in self._silent:
                    self._silent.remove(client)
        self._lost_clients.clear()

    def _patience_ms(self) -> float | None:
        """How long the oldest silent client still has; None where there is none."""
        if not self._silent:
            return None
        return max(0.0, math.ceil((self._silent[0].until_s - time.monotonic()) * 1000.0))

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


def is_served(path: Path) -> bool:
    """Whether a living hub, or anything else that accepts connections of its kind, listens at `path`.

    Raises:
        HubError: something that is no hub's socket stands there.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
        probe.setblocking(False)
        try:
            probe.connect(str(path))
        except (ConnectionRefusedError, FileNotFoundError):
            return False
        except BlockingIOError:
            return True  # its queue of new connections is full
        except OSError as error:
            raise HubError(f"socket {path}: {error.strerror}; give another path") from error
    return True


def _listen(path: Path) -> socket.socket:
    """Take the socket's place, one hub at a time.

    Raises:
        HubError: see `Hub`.
    """
    if len(os.fsencode(path)) > MAX_SOCKET_PATH_BYTES:
        raise HubError(
            f"socket {path}: a path of {len(os.fsencode(path))} bytes, at most {MAX_SOCKET_PATH_BYTES}; "
            "give a shorter one"
        )
    try:
        directory = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError as error:
        raise HubError(f"directory {path.parent} of the socket: {error.strerror}; make it first") from error
    listener = socket.socket(
        socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC
    )
    try:
        _lock(
            directory, path
        )  # two hubs that start at once must not take each other's fresh socket for a dead one
        _clear_place(path)
        listener.bind(str(path))
        path.chmod(0o600)  # before listen(): until then every connection is refused
        listener.listen(MAX_CLIENTS)
    except OSError as error:
        listener.close()
        raise HubError(f"socket {path}: {error.strerror}; give a path this user can write to") from error
    except HubError:
        listener.close()
        raise
    finally:
        os.close(directory)
    return listener


def _lock(directory: int, path: Path) -> None:
    for _ in range(_LOCK_TRIES):
        try:
            fcntl.flock(directory, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(_LOCK_PAUSE_S)
        else:
            return
    raise HubError(
        f"directory {path.parent} of the socket stays locked by another process; give another path"
    )


def _clear_place(path: Path) -> None:
    """Remove a dead hub's socket; refuse anything else that stands there."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(mode):
        raise HubError(f"{path} exists and is not a socket; give another path")
    if is_served(path):
        raise HubError(f"a hub is already serving on {path}; use it, end it, or give another path")
    path.unlink()


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        status = path.lstat()
    except FileNotFoundError:
        return None
    return status.st_dev, status.st_ino


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
