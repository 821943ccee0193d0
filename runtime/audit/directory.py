"""The log directory: one session at a time, and the head of the last one.

``LOCK`` is held while a session runs. ``HEAD`` says what came last: ``open`` while a log is being written, so that
the next session sees a crash, and ``closed`` with the chain's head afterwards.
"""

import fcntl
import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cutgate.config.load import InputError

LOCK: Final = "LOCK"
HEAD: Final = "HEAD"
_FREE: Final = "free it, or name another with --log-dir"


@dataclass(frozen=True, slots=True)
class Previous:
    """What the directory says of the session before."""

    log: str | None = None
    head: str | None = None
    crashed: bool = False
    note: str | None = None


def lock(directory: Path) -> int:
    """Make the directory if it is missing and lock it; the descriptor that holds the lock.

    Raises:
        InputError: it cannot be made or written, or another session holds it.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(directory / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(
            directory, "log directory", reason, "a directory that can be written", _FREE
        ) from None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise InputError(
            directory, "log directory", "in use", "free of any running session", "end the other session"
        ) from None
    return descriptor


def head_bytes(*, log: str, head: str | None, closed: bool) -> bytes:
    """What HEAD holds."""
    content = {"schema": "cutgate.head/1", "log": log, "state": "closed" if closed else "open", "head": head}
    return json.dumps(content).encode() + b"\n"


def previous_session(directory: Path, recover: Callable[[bytes], str]) -> Previous:
    """What came before, read under the lock.

    Args:
        directory: the log directory.
        recover: the chain's head over the complete chunks of a log that was not closed.
    """
    try:
        log, head, closed = _parse_head((directory / HEAD).read_bytes())
    except FileNotFoundError:
        return Previous()
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        return Previous(crashed=True, note=f"HEAD could not be read: {error}")
    if closed:
        return Previous(log, head)
    try:
        return Previous(log, recover((directory / log).read_bytes()), crashed=True)
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        return Previous(log, head, crashed=True, note=f"its log could not be read: {error}")


def _parse_head(data: bytes) -> tuple[str, str | None, bool]:
    """Log, head and whether it was closed; raises ValueError, KeyError or TypeError for anything else."""
    content = json.loads(data)
    log, head = content["log"], content["head"]
    if not (isinstance(log, str) and Path(log).name == log and isinstance(head, str | None)):
        raise ValueError("not a head")
    return log, head, content["state"] == "closed"
