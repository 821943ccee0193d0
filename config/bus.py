"""Which CAN bus to use where none is named, and how it is opened.

Two buses work without hardware: the kernel's `vcan0` through SocketCAN, and the local virtual bus, a hub process
on an AF_UNIX socket. Any other interface of python-can is a matter of configuration.

What a bus from `open_bus` promises its reader: the first failure of the bus (hub ended, interface down or deleted)
raises `can.CanOperationError`, and **every** later `recv` and `send` raises it again, until the bus is opened anew.
python-can's own SocketCAN bus reports such a failure once and then goes on returning None, as if the bus were
merely quiet. A full transmit queue is no failure: `send` raises `can.CanTimeoutError`, nothing of the frame was sent,
and it may be tried again. Frames that the local virtual bus had to drop show as an error frame. SocketCAN drops without a word
when its receive buffer is full, therefore the buffer is raised, and what is lost all the same is found by the
counters of the end-to-end protection.
"""

import errno
import os
import re
import socket
import stat
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import can
from can.interfaces.socketcan import SocketcanBus

SOCKETCAN_CHANNEL: Final = "vcan0"
LOCAL_INTERFACE: Final = "cutgate"
LOCAL_CHANNEL: Final = "bus0"
BITRATE_BIT_S: Final = 1_000_000
DATA_BITRATE_BIT_S: Final = 5_000_000
"""Nominal, and of the data of FD frames."""
RECEIVE_BUFFER_BYTES: Final = 4 * 1024 * 1024
"""Asked of the kernel: its default holds 278 frames, less than one uploaded block may bring at once."""

_SO_RCVBUFFORCE: Final = 33
_FULL: Final = frozenset({errno.ENOBUFS, errno.EAGAIN, None})
"""What says that the kernel did not take a frame for want of room: the interface's queue (`txqueuelen`), the socket's
buffer, and python-can's own word for a socket that is not writable, which has no number."""
_CHANNEL_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,31}")
NOT_PRIVATE: Final = frozenset({"udp_multicast", "socketcand"})
"""Interfaces of python-can that leave the machine; they are refused."""


class RuntimeDirectoryError(Exception):
    """The directory for the local bus is not one that only this user can write to."""


class LatchingSocketcanBus(SocketcanBus):
    """SocketCAN whose first failure stays: every later call raises it again, and the receive buffer is large."""

    def __init__(self, channel: str, *, fd: bool = False, **options: Any) -> None:
        """Bind to `channel`, with python-can's options of its own bus.

        Raises:
            OSError: the kernel has no such interface; see `has_socketcan`.
        """
        self._failure: str | None = None
        super().__init__(channel=channel, fd=fd, **options)
        # SO_RCVBUF never fails but is capped at net.core.rmem_max; SO_RCVBUFFORCE needs CAP_NET_ADMIN.
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
        with suppress(OSError):
            self.socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, RECEIVE_BUFFER_BYTES)

    @property
    def receive_buffer_bytes(self) -> int:
        """What the kernel granted; it counts its own overhead too, so about 770 bytes are one classic frame."""
        return self.socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        self._refuse_after_failure()
        try:
            return super()._recv_internal(timeout)
        except can.CanOperationError as error:
            self._failure = str(error)
            raise

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send one frame.

        Raises:
            can.CanTimeoutError: the interface's transmit queue or the socket's buffer is full; the bus still works.
            can.CanOperationError: interface down or deleted, or an earlier failure.
        """
        self._refuse_after_failure()
        try:
            super().send(msg, timeout)
        except can.CanOperationError as error:
            if error.error_code in _FULL:
                raise can.CanTimeoutError(f"the transmit queue is full: {error}") from error
            self._failure = str(error)
            raise

    def _refuse_after_failure(self) -> None:
        if self._failure is not None:
            raise can.CanOperationError(f"the bus failed before and was not opened anew: {self._failure}")


def has_socketcan(channel: str = SOCKETCAN_CHANNEL) -> bool:
    """Whether a raw CAN socket can be bound to `channel`, that is, whether the kernel has that interface."""
    if not hasattr(socket, "AF_CAN"):
        return False
    try:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as probe:
            probe.bind((channel,))
    except OSError:
        return False
    return True


def default_interface() -> tuple[str, str]:
    """Interface and channel used where none is named: `vcan0` where the kernel has it, else the local bus."""
    if has_socketcan():
        return "socketcan", SOCKETCAN_CHANNEL
    return LOCAL_INTERFACE, LOCAL_CHANNEL


def runtime_directory_name() -> Path:
    """Where the directory of the local bus's sockets lies, whether or not it is there.

    It lies under XDG_RUNTIME_DIR where that names a directory of this user, else in the temporary directory under
    a name that holds the user's number.
    """
    uid = os.getuid()
    given = os.environ.get("XDG_RUNTIME_DIR", "")
    usable = Path(given).is_absolute() and Path(given).is_dir() and Path(given).stat().st_uid == uid
    return Path(given) / "cutgate" if usable else Path(tempfile.gettempdir()) / f"cutgate-{uid}"


def runtime_directory() -> Path:
    """The directory of the local bus's sockets (`runtime_directory_name`), made with mode 0700 if missing.

    Raises:
        RuntimeDirectoryError: it cannot be made, or belongs to or is open to someone else.
    """
    uid = os.getuid()
    directory = runtime_directory_name()
    try:
        directory.mkdir(mode=0o700, exist_ok=True)
        status = directory.lstat()
    except OSError as error:
        raise RuntimeDirectoryError(
            f"directory {directory} for the local bus: {error.strerror}; remove what stands there, or name a socket"
        ) from error
    if not (
        stat.S_ISDIR(status.st_mode) and status.st_uid == uid and stat.S_IMODE(status.st_mode) & 0o077 == 0
    ):
        raise RuntimeDirectoryError(
            f"directory {directory} for the local bus must be this user's own with mode 0700, it has owner "
            f"{status.st_uid} and mode {stat.S_IMODE(status.st_mode):04o}; remove it, or name a socket"
        )
    return directory


def socket_path(channel: str = LOCAL_CHANNEL) -> Path:
    """The hub's socket for a channel of the local bus: a path as it stands, a plain name in the runtime directory.

    Raises:
        ValueError: neither a path nor a name of at most 32 letters, digits, `_`, `.` or `-`.
        RuntimeDirectoryError: see `runtime_directory`.
    """
    if "/" in channel:
        return Path(channel)
    if not _CHANNEL_NAME.fullmatch(channel):
        raise ValueError(
            f"channel {channel!r} of the local bus: give a path with a '/', or a name of at most 32 letters, "
            "digits, '_', '.' or '-'"
        )
    return runtime_directory() / f"{channel}.sock"


def open_bus(
    interface: str, channel: str, *, fd: bool = False, bitrate_bit_s: int = BITRATE_BIT_S
) -> can.BusABC:
    """Open a bus; see the module's text for what its reader is promised.

    Args:
        interface: python-can's name of the interface, `cutgate` for the local virtual bus.
        channel: that interface's channel, for the local bus a socket path or a name.
        fd: whether CAN FD frames are sent and received, their data at 5 Mbit/s.
        bitrate_bit_s: what an interface is set to that python-can sets up. The kernel's is set with `ip link`; the
            virtual ones have none.

    Raises:
        can.CanInitializationError: no such interface or channel, nobody serving, or a bus that leaves the machine.
    """
    place = f"bus {interface}/{channel}"
    if interface in NOT_PRIVATE:
        raise can.CanInitializationError(
            f"{place}: refused, it leaves this machine and the bus must be private; use {LOCAL_INTERFACE} or socketcan"
        )
    if interface == "socketcan" and not has_socketcan(channel):
        raise can.CanInitializationError(
            f"{place}: the kernel has no such CAN interface; create it, or use {LOCAL_INTERFACE}"
        )
    try:
        if interface == "socketcan":
            return LatchingSocketcanBus(channel, fd=fd)
        rates: dict[str, Any] = {"bitrate": bitrate_bit_s}
        if fd:
            rates["data_bitrate"] = DATA_BITRATE_BIT_S
        return can.Bus(channel=channel, interface=interface, fd=fd, ignore_config=True, **rates)
    except can.CanInitializationError:
        raise
    except (can.CanError, NotImplementedError, OSError, ValueError, ImportError) as error:
        raise can.CanInitializationError(
            f"{place} cannot be opened: {error}; check that the interface exists and is up"
        ) from error
