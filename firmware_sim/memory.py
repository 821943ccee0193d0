"""The simulated controller's non-volatile memory: the registrations it must never permit again."""

import json
import os
from pathlib import Path

SUFFIX = ".sim-memory.json"


class ControllerMemoryError(Exception):
    """The memory cannot be read; the controller does not start without it."""


def beside(key_file: Path) -> Path:
    """The memory's file: beside the key, for a controller with another key is another controller."""
    return key_file.with_name(key_file.name + SUFFIX)


def load(path: Path) -> frozenset[bytes]:
    """The withdrawn registrations' digests; none where the file does not exist yet.

    Raises:
        ControllerMemoryError: the file is there but cannot be believed.
    """
    try:
        text = path.read_text(encoding="ascii")
    except FileNotFoundError:
        return frozenset()
    except (OSError, UnicodeDecodeError) as error:
        raise ControllerMemoryError(f"{path}: {error}") from None
    try:
        entries = json.loads(text)["withdrawn"]
        withdrawn = frozenset(bytes.fromhex(entry) for entry in entries)
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ControllerMemoryError(
            f"{path}: not a memory file ({error}); restore it or use another key"
        ) from None
    if not all(len(entry) == 32 for entry in withdrawn):
        raise ControllerMemoryError(f"{path}: a withdrawn digest is not 32 bytes long; restore the file")
    return withdrawn


def save(path: Path, withdrawn: frozenset[bytes]) -> None:
    """Replace the memory; it is on the disk, directory entry included, when this returns."""
    fresh = path.with_name(path.name + ".new")
    text = json.dumps({"withdrawn": sorted(entry.hex() for entry in withdrawn)})
    with fresh.open("w", encoding="ascii") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    fresh.replace(path)
    directory = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(directory)
    finally:
        os.close(directory)
