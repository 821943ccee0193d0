"""What a hub is asked from outside: its counts, and errors on demand."""

import json
import select
import socket
from pathlib import Path
from typing import Any, Final

from cutgate.firmware_sim.bus import wire
from cutgate.firmware_sim.bus.control import SCHEMA
from cutgate.firmware_sim.bus.peer import UnreachableError, connected
from cutgate.firmware_sim.bus.wire import HubKind, HubRecord, WireError

ANSWER_S: Final = 2.0


class NotAnsweredError(Exception):
    """No hub of ours answers there, or not as it must."""


def counts(path: Path) -> dict[str, Any]:
    """What the hub counts; the document of ``cutgate bus stat --json``.

    Raises:
        NotAnsweredError: see there.
    """
    answer = _asked(path, HubRecord(HubKind.STAT), HubKind.STATUS)
    try:
        document = json.loads(answer)
    except (ValueError, RecursionError):
        raise NotAnsweredError(f"bus {path}: the hub's counts cannot be read; start it anew") from None
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        raise NotAnsweredError(f"bus {path}: the hub does not count as {SCHEMA} says; start it anew")
    return document


def let_err(path: Path, wanted: dict[str, object]) -> str:
    """Ask the hub for errors to come; what it answers.

    Raises:
        NotAnsweredError: see there.
    """
    return _asked(path, wire.text(HubKind.INJECT, json.dumps(wanted)), HubKind.TEXT)


def _asked(path: Path, question: HubRecord, kind: HubKind) -> str:
    try:
        with connected(str(path)) as sock:
            sock.send(question.pack(), socket.MSG_NOSIGNAL)
            ready = select.poll()
            ready.register(sock, select.POLLIN)
            if not ready.poll(ANSWER_S * 1000):
                raise NotAnsweredError(f"bus {path}: the hub did not answer within {ANSWER_S:g} s")
            answer = wire.parse(sock.recv(wire.MAX_TEXT + wire.MAX_DATAGRAM))
    except (UnreachableError, OSError, WireError) as error:
        raise NotAnsweredError(f"bus {path}: {error}") from error
    if answer.kind is not kind:
        raise NotAnsweredError(f"bus {path}: {answer.data.decode(errors='replace') or answer.kind.name}")
    return answer.data.decode(errors="replace")
