"""Who is at the other end of the hub's socket, asked of the kernel: nobody but this user joins, or serves.

Whoever serves a bus can alter every frame on it, and whoever joins it can send any. The socket's mode keeps others
out, but not root, whom nothing keeps out; and a path may name anybody's socket.
"""

import os
import socket
import struct
from dataclasses import dataclass
from typing import Final

from cutgate.config.ours import user

_CREDENTIALS: Final = struct.Struct("iII")
"""struct ucred of Linux: process, user, group."""


@dataclass(frozen=True)
class Peer:
    """The process that made the other end: that listens, for a client; that connected, for the hub."""

    process: int
    uid: int

    @property
    def stranger(self) -> str | None:
        """None for this process's own user; else who it is and who it must be."""
        if self.uid == os.geteuid():
            return None
        return f"it is run by {user(self.uid)}, must be {user(os.geteuid())} as this end"


def peer_of(sock: socket.socket) -> Peer:
    """Who is at the other end of a connected AF_UNIX socket."""
    data = sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    process, uid, _group = _CREDENTIALS.unpack(data)
    return Peer(process, uid)


class UnreachableError(Exception):
    """No hub of ours can be spoken to there; the message says why, and what to do."""


def connected(path: str) -> socket.socket:
    """A connection to the hub at `path`, which is run by this process's own user; it never blocks.

    Raises:
        UnreachableError: nobody serves there, or somebody else, or no connection is accepted.
    """
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
    try:
        sock.connect(path)
        stranger = peer_of(sock).stranger
    except (FileNotFoundError, ConnectionRefusedError):
        reason = "no hub is serving there: start one with `cutgate bus serve`, or name its socket"
    except BlockingIOError:
        reason = "the hub accepts no connection, too many wait: end it and start another"
    except OSError as error:
        reason = str(error)
    else:
        if stranger is None:
            return sock
        reason = f"the hub is not ours, {stranger}: start one with `cutgate bus serve`, or name its socket"
    sock.close()
    raise UnreachableError(reason)
