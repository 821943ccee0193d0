"""Registrations that this site must never use again: the runtime's own list, beside its logs.

The controller keeps a list as well, but a withdrawal that never reached it (a dead bus, a controller without power)
would be forgotten without this one. One line each: the registration's SHA-256 and the log that tells why. Lines are
only ever added, and HEAD says how many there are; a list that cannot be read, or has lost any, stops the next session,
for nobody knows what it held.
"""

import re
from pathlib import Path
from typing import Final

from cutgate.config.load import InputError
from cutgate.runtime.audit.directory import WITHDRAWN, Listed, extend_list, withdrawn_list

_ENTRY: Final = re.compile(r"[0-9a-f]{64} \S+")


def load(directory: Path) -> dict[bytes, str]:
    """The log that tells why, by the registration's digest; empty where nothing was ever withdrawn.

    Raises:
        InputError: the list is not whole (``audit.directory.withdrawn_list``) or a line of it is no entry.
    """
    file = directory / WITHDRAWN
    try:
        lines = withdrawn_list(directory).decode("ascii").split("\n")
    except UnicodeDecodeError as error:
        raise InputError(file, "list of withdrawn registrations", None, f"cannot be read: {error}") from None
    for number, line in enumerate(lines[:-1], start=1):
        if not _ENTRY.fullmatch(line):
            raise _no_entry(file, number, line)
    if lines[-1]:  # the power went while it was written
        raise _no_entry(file, len(lines), lines[-1])
    entries = (line.split(" ") for line in lines[:-1])
    return {bytes.fromhex(digest): log for digest, log in entries}


def _no_entry(file: Path, number: int, line: str) -> InputError:
    bound = "a registration's SHA-256 and the name of a log, and an end of line"
    return InputError(file, f"line {number}", line, bound, "restore the list from a backup")


def add(directory: Path, registration: bytes, log: str, known: Listed | None = None) -> Listed:
    """List a registration; it is on the disk, directory entry included, when this returns.

    Args:
        directory: the log directory, locked by this session.
        registration: SHA-256 digest.
        log: name of the log that tells why.
        known: how the list stood when the session began.

    Returns:
        How the list stands, for HEAD.

    Raises:
        InputError: the list or HEAD is not ours.
        OSError: it cannot be written.
    """
    return extend_list(directory, f"{registration.hex()} {log}\n".encode("ascii"), known)
