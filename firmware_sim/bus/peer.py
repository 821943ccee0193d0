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
