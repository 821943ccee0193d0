"""CAN of the kernel, python-can's interfaces, and the hub of the local virtual bus."""

import errno
import json
import os
import socket
import stat
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from shutil import which
from typing import Any, Final, Literal

import can

from cutgate.config.bus import (
    LOCAL_CHANNEL,
    LOCAL_INTERFACE,
    RuntimeDirectoryError,
    open_bus,
    runtime_directory_name,
    socket_path,
)
from cutgate.runtime.doctor.examined import Examined
from cutgate.runtime.doctor.facts import (
    Backend,
    CanInterface,
    Interfaces,
    LinkDetail,
    LocalBus,
    RawSocket,
    SocketRefusal,
    Unknown,
)
from cutgate.runtime.doctor.probes.text import number, read_text

NET: Final = Path("/sys/class/net")
ARPHRD_CAN: Final = 280
IFF_UP: Final = 1
INTERFACES_MAX: Final = 64
IP_FOLDERS: Final = "/usr/sbin:/sbin:/usr/bin:/bin"
"""Where ``ip`` is looked for: never in a folder that the environment names."""
IP_S: Final = 3.0
IP_BYTES_MAX: Final = 1_000_000

_REFUSALS: Final = {
    errno.EAFNOSUPPORT: SocketRefusal.NO_CAN,
    errno.EPROTONOSUPPORT: SocketRefusal.NO_RAW,
    errno.ESOCKTNOSUPPORT: SocketRefusal.NO_RAW,
    errno.EPERM: SocketRefusal.FORBIDDEN,
    errno.EACCES: SocketRefusal.FORBIDDEN,
}

Opener = Callable[[], socket.socket]


def _raw_can() -> socket.socket:
    return socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)


def raw_socket(_examined: Examined, opened: Opener = _raw_can) -> RawSocket | Unknown:
    """Open a raw CAN socket, bound to nothing, and close it."""
    try:
        opened().close()
    except AttributeError:  # a Python that was built without it
        return RawSocket(SocketRefusal.NO_CAN)
    except OSError as error:
        refused = _REFUSALS.get(error.errno or 0)
        return RawSocket(refused) if refused else Unknown(f"a raw CAN socket: {error.strerror}")
    return RawSocket(None)


def backend(examined: Examined) -> Backend:
    """Whether python-can has the interface, its plugins included."""
    return Backend(examined.interface in can.VALID_INTERFACES)


# ---------------------------------------------------------------- interfaces of the kernel


class NoDetailError(Exception):
    """``ip`` says nothing, and why."""


def ip_text() -> str:
    """What ``ip -details -json link show`` prints; at most a megabyte of it, for at most three seconds.

    Raises:
        NoDetailError: there is no ``ip``, it failed, or was too slow.
    """
    program = which("ip", path=IP_FOLDERS)
    if program is None:
        raise NoDetailError("there is no ip program")
    try:
        done = subprocess.run(  # noqa: S603 - our own words
            [program, "-details", "-json", "link", "show"],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=IP_S,
            check=False,
            env={"LC_ALL": "C"},
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise NoDetailError(f"ip could not be asked: {type(error).__name__}") from None
    if done.returncode != 0 or len(done.stdout) > IP_BYTES_MAX:
        raise NoDetailError(f"ip failed with exit code {done.returncode}")
    return done.stdout.decode("utf-8", "replace")


def interfaces(
    _examined: Examined, net: Path = NET, asked: Callable[[], str] = ip_text
) -> Interfaces | Unknown:
    """All CAN interfaces of the kernel; ``ip`` is asked only where there is one."""
    try:
        folders = sorted(net.iterdir())
    except OSError as error:
        return Unknown(f"{net} cannot be read: {error.strerror}")
    found = [one for folder in folders if (one := _interface(folder)) is not None][:INTERFACES_MAX]
    if not found:
        return Interfaces(())
    try:
        told = kinds_of(asked())
    except NoDetailError as error:
        return Interfaces(tuple(found), str(error))
    return Interfaces(tuple(_completed(one, told.get(one.name)) for one in found))


def _interface(folder: Path) -> CanInterface | None:
    """What sysfs says of an interface; None for one that is no CAN interface, or that has gone meanwhile."""
    kind, flags, mtu, queue = (
        number(read_text(folder / name)) for name in ("type", "flags", "mtu", "tx_queue_len")
    )
    if kind != ARPHRD_CAN or flags is None or mtu is None or queue is None:
        return None
    # An adapter on a serial line lies among the virtual devices of sysfs as well: which it is says ip alone.
    return CanInterface(folder.name, False, bool(flags & IFF_UP), mtu, queue, None)


Kind = LinkDetail | Literal["virtual"]


def _completed(one: CanInterface, kind: Kind | None) -> CanInterface:
    """With what ``ip`` says of it."""
    detail = kind if isinstance(kind, LinkDetail) else None
    return replace(one, virtual=kind == "virtual", detail=detail)


def kinds_of(text: str) -> dict[str, Kind]:
    """The CAN interfaces in what ``ip -details -json link`` prints; what is not as expected is None.

    Raises:
        NoDetailError: it is no such list.
    """
    try:
        links = json.loads(text)
    except (ValueError, RecursionError):
        raise NoDetailError("what ip says is no JSON") from None
    if not isinstance(links, list):
        raise NoDetailError("what ip says is no list")
    told: dict[str, Kind] = {}
    for link in links:
        name, info = _member(link, "ifname"), _member(link, "linkinfo")
        kind = _member(info, "info_kind")
        if isinstance(name, str) and kind == "can":
            told[name] = _detail(_member(info, "info_data"))
        elif isinstance(name, str) and kind in ("vcan", "vxcan"):
            told[name] = "virtual"
    return told


def _detail(data: Any) -> LinkDetail:
    counters, modes, state = _member(data, "berr_counter"), _member(data, "ctrlmode"), _member(data, "state")
    return LinkDetail(
        state=state if isinstance(state, str) else None,
        bitrate_bit_s=_whole(_member(_member(data, "bittiming"), "bitrate"), _member(data, "bitrate")),
        tx_errors=_whole(_member(counters, "tx")),
        rx_errors=_whole(_member(counters, "rx")),
        restart_ms=_whole(_member(data, "restart_ms")),
        modes=frozenset(one for one in modes if isinstance(one, str))
        if isinstance(modes, list)
        else frozenset(),
    )


def _member(document: Any, name: str) -> Any:
    return document.get(name) if isinstance(document, dict) else None


def _whole(*values: Any) -> int | None:
    return next((one for one in values if type(one) is int), None)


# ---------------------------------------------------------------- the local virtual bus


def local_bus(examined: Examined) -> LocalBus | Unknown:
    """Join the hub as a client that sends nothing, and leave; where no socket is, nothing is made."""
    channel = examined.channel if examined.interface == LOCAL_INTERFACE else LOCAL_CHANNEL
    try:
        if "/" not in channel and not os.path.lexists(runtime_directory_name()):
            return LocalBus(str(runtime_directory_name() / f"{channel}.sock"), there=False, refused=None)
        path = socket_path(channel)
    except (RuntimeDirectoryError, ValueError, OSError) as error:
        return LocalBus(channel, there=True, refused=str(error))
    if not os.path.lexists(path):
        return LocalBus(str(path), there=False, refused=None)
    if not stat.S_ISSOCK(os.lstat(path).st_mode):
        return LocalBus(str(path), there=True, refused=f"{path} is no socket")
    try:
        open_bus(LOCAL_INTERFACE, str(path)).shutdown()
    except can.CanError as error:
        return LocalBus(str(path), there=True, refused=str(error))
    return LocalBus(str(path), there=True, refused=None)
