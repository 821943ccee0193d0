"""python-can's way onto the virtual bus: `can.Bus(interface="cutgate", channel=...)`."""

import math
import select
import socket
import time
from typing import Any, Final

import can

from cutgate.config.bus import LOCAL_CHANNEL, RuntimeDirectoryError, socket_path
from cutgate.firmware_sim.bus import wire
from cutgate.firmware_sim.bus.peer import peer_of
from cutgate.firmware_sim.bus.wire import Flag, HubKind, HubRecord, WireError

HELLO_TIMEOUT_S: Final = 2.0
ERROR_CONTROLLER: Final = 0x004
"""Identifier of the error frame that stands for lost frames, as Linux numbers it (CAN_ERR_CRTL)."""
RECEIVE_OVERFLOW: Final = 0x01
"""Its second data byte (CAN_ERR_CRTL_RX_OVERFLOW)."""


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
        self._sock = _join(path, wire.hello(fd=fd, own=receive_own_messages))
        self._readable = select.poll()
        self._readable.register(self._sock, select.POLLIN)
        self._writable = select.poll()
        self._writable.register(self._sock, select.POLLOUT)
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
        while True:
            self._refuse_after_failure()
            try:
                raw = self._sock.recv(wire.MAX_RECORD + 1, socket.MSG_DONTWAIT)
            except BlockingIOError:
                if not _wait(self._readable, deadline):
                    return None, False
                continue
            except OSError as error:
                raise self._fail(f"the hub at {self._path} has ended: {error.strerror}") from error
            if not raw:
                raise self._fail(f"the hub at {self._path} has ended")
            return self._message(raw)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Put one frame on the bus; returns once the hub's socket has taken it.

        Args:
            msg: the frame.
            timeout: seconds to wait while the hub's queue is full; None waits as long as it takes, 0 not at all.

        Raises:
            can.CanTimeoutError: the queue stayed full; the frame was not sent and the bus still works.
            can.CanOperationError: a frame no CAN bus carries, or the hub has ended, now or earlier.
        """
        raw = self._record(msg).pack()
        deadline = math.inf if timeout is None else time.monotonic() + timeout
        while True:
            self._refuse_after_failure()
            try:
                self._sock.send(raw, socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)
            except BlockingIOError:
                if not _wait(self._writable, deadline):
                    raise can.CanTimeoutError(
                        f"the hub at {self._path} did not take the frame within {timeout} s"
                    ) from None
            except OSError as error:
                raise self._fail(f"the hub at {self._path} has ended: {error.strerror}") from error
            else:
                return

    def shutdown(self) -> None:
        """Leave the bus; may be called more than once."""
        super().shutdown()
        self._failure = self._failure or "the bus was shut down by this program"
        self._sock.close()

    def _record(self, msg: can.Message) -> HubRecord:
        """The record of a message, checked."""
        flags = (
            (Flag.EXTENDED if msg.is_extended_id else 0)
            | (Flag.REMOTE if msg.is_remote_frame else 0)
            | (Flag.ERROR if msg.is_error_frame else 0)
            | (Flag.FD if msg.is_fd else 0)
            | (Flag.BIT_RATE_SWITCH if msg.bitrate_switch else 0)
            | (Flag.ERROR_STATE if msg.error_state_indicator else 0)
        )
        data = b"" if msg.is_remote_frame else bytes(msg.data)
        length = msg.dlc if msg.is_remote_frame else len(data)
        if msg.is_fd and not self._fd_frames:
            raise can.CanOperationError("FD frame on a bus opened without FD; open it with fd=True")
        if not 0 <= length <= 64 or not 0 <= msg.arbitration_id <= 0xFFFF_FFFF:
            raise can.CanOperationError(f"no CAN frame: identifier {msg.arbitration_id}, length {length}")
        record = HubRecord(HubKind.FRAME, int(flags), msg.arbitration_id, 0, length, data)
        try:
            wire.check_frame(record)
        except WireError as error:
            raise can.CanOperationError(f"not sent, {error}") from error
        return record

    def _message(self, raw: bytes) -> tuple[can.Message, bool]:
        """The message of a record, and whether the filters of `recv` are to leave it alone."""
        try:
            record = wire.parse(raw)
        except WireError as error:
            raise self._fail(f"the hub at {self._path} sent an unknown record: {error}") from error
        if record.kind is HubKind.FRAME:
            return _to_message(record, self.channel), False
        if record.kind is HubKind.OVERRUN:
            self.lost_frames += record.number
            return _overrun_message(record, self.channel), True  # no filter may hide a loss
        reason = record.data.decode(errors="replace") or record.kind.name
        raise self._fail(f"the hub at {self._path} closed this connection: {reason}")

    def _fail(self, reason: str) -> can.CanOperationError:
        self._failure = reason
        return can.CanOperationError(reason)

    def _refuse_after_failure(self) -> None:
        if self._failure is not None:
            raise can.CanOperationError(self._failure)


def _to_message(record: HubRecord, channel: str) -> can.Message:
    flags = record.flags
    return can.Message(
        timestamp=record.time_ns * 1e-9,
        arbitration_id=record.number,
        is_extended_id=bool(flags & Flag.EXTENDED),
        is_remote_frame=bool(flags & Flag.REMOTE),
        is_error_frame=bool(flags & Flag.ERROR),
        is_fd=bool(flags & Flag.FD),
        bitrate_switch=bool(flags & Flag.BIT_RATE_SWITCH),
        error_state_indicator=bool(flags & Flag.ERROR_STATE),
        is_rx=not flags & Flag.OWN,
        dlc=record.length,
        data=record.data,
        channel=channel,
    )


def _overrun_message(record: HubRecord, channel: str) -> can.Message:
    return can.Message(
        timestamp=record.time_ns * 1e-9,
        arbitration_id=ERROR_CONTROLLER,
        is_extended_id=False,
        is_error_frame=True,
        data=bytes((0, RECEIVE_OVERFLOW, 0, 0)) + record.number.to_bytes(4, "big"),
        channel=channel,
    )


def _wait(poll: select.poll, deadline: float) -> bool:
    """Whether the socket became ready before the deadline of `time.monotonic()`."""
    left_s = deadline - time.monotonic()
    if left_s == math.inf:
        return bool(poll.poll())
    return bool(poll.poll(math.ceil(max(0.0, left_s) * 1000)))


def _join(path: str, hello: HubRecord) -> socket.socket:
    """Connect and be welcomed.

    Raises:
        can.CanInitializationError: see `VirtualBus`.
    """
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
    try:
        sock.connect(path)
        refusal = _refusal(sock, hello)
    except (FileNotFoundError, ConnectionRefusedError):
        refusal = "no hub is serving there: start one with `cutgate bus serve`"
    except BlockingIOError:
        refusal = "the hub accepts no connection, too many wait: end it and start another"
    except (OSError, WireError) as error:
        refusal = str(error)
    if refusal is not None:
        sock.close()
        raise can.CanInitializationError(f"virtual bus {path}: {refusal}")
    return sock


def _refusal(sock: socket.socket, hello: HubRecord) -> str | None:
    """Why this client does not join, or is not let in; None if it is."""
    stranger = peer_of(sock).stranger
    if stranger is not None:
        return f"the hub is not ours, {stranger}: start one with `cutgate bus serve`, or name its socket"
    sock.send(hello.pack(), socket.MSG_NOSIGNAL)
    answer = select.poll()
    answer.register(sock, select.POLLIN)
    if not answer.poll(HELLO_TIMEOUT_S * 1000):
        return f"the hub did not answer within {HELLO_TIMEOUT_S} s: end it and start another"
    raw = sock.recv(wire.MAX_RECORD + 1)
    if not raw:
        return "the hub ended before it answered: start it again"
    reply = wire.parse(raw)
    return (
        None if reply.kind is HubKind.WELCOME else f"the hub refused: {reply.data.decode(errors='replace')}"
    )
