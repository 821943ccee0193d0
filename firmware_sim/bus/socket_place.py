"""Where a hub's socket stands: taken by one hub at a time, a living one's never, and nothing else ever removed."""

import fcntl
import os
import socket
import stat
import time
from pathlib import Path
from typing import Final

MAX_CLIENTS: Final = 64
"""So many take part, and so many more may be about to."""
MAX_SOCKET_PATH_BYTES: Final = 107
_LOCK_TRIES: Final = 200
_LOCK_PAUSE_S: Final = 0.01


class HubError(Exception):
    """The hub cannot serve: the socket's place, or the log."""


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


def listen(path: Path) -> socket.socket:
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


def identity(path: Path) -> tuple[int, int] | None:
    """Device and inode of what stands there; None where nothing does."""
    try:
        status = path.lstat()
    except FileNotFoundError:
        return None
    return status.st_dev, status.st_ino
