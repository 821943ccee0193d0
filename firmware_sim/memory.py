"""The simulated controller's non-volatile memory: registrations named and withdrawn, and a latched fault.

One JSON document with its schema and the SHA-256 of its content, so that no damage goes unseen.
"""

import hashlib
import json
from pathlib import Path
from typing import Any, Final

from cutgate.config.constants import REGISTRATIONS_MAX
from cutgate.config.durable import replace_durably
from cutgate.config.load import InputError
from cutgate.config.ours import read_ours
from cutgate.firmware_sim.state import Memory
from cutgate.protocol.states import StopCause

SUFFIX: Final = ".sim-memory.json"
SCHEMA: Final = "cutgate.sim-memory/1"
BYTES_MAX: Final = 100 * REGISTRATIONS_MAX
"""A file that is longer holds something else: a digest takes 68 bytes."""


class ControllerMemoryError(Exception):
    """The memory cannot be read or written; the controller does not start without it."""


def beside(key_file: Path) -> Path:
    """The memory's file: beside the key, for a controller with another key is another controller."""
    return key_file.with_name(key_file.name + SUFFIX)


def load(path: Path) -> Memory:
    """What is remembered; nothing where the file does not exist yet.

    Raises:
        ControllerMemoryError: the file is there but is not ours, or cannot be believed.
    """
    try:
        data = read_ours(path, BYTES_MAX)
    except FileNotFoundError:
        return Memory()
    except InputError as error:
        raise ControllerMemoryError(str(error)) from None
    try:
        return _believed(data)
    except (ValueError, RecursionError) as error:
        raise ControllerMemoryError(
            f"{path}: not a memory that can be believed ({error}); restore the file, or write a new key and memory"
        ) from None


def _believed(data: bytes) -> Memory:
    """Raises ValueError unless this says what would be written, digest included."""
    document = json.loads(data.decode("ascii"))
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        raise ValueError(f"its schema is not {SCHEMA}")
    content: Any = document.get("content")
    try:
        memory = Memory(
            named=frozenset(map(bytes.fromhex, content["named"])),
            withdrawn=frozenset(map(bytes.fromhex, content["withdrawn"])),
            latched=StopCause[content["latched"]],
        )
    except (KeyError, TypeError) as error:
        raise ValueError(f"its content is malformed: {type(error).__name__} {error}") from None
    if document != _document(memory):
        raise ValueError("its SHA-256 does not match, or it is not in its canonical form")
    known = memory.named | memory.withdrawn
    if len(known) > REGISTRATIONS_MAX or not all(len(digest) == 32 for digest in known):
        raise ValueError(f"it must hold at most {REGISTRATIONS_MAX} digests of 32 bytes each")
    return memory


def _document(memory: Memory) -> dict[str, Any]:
    content = {
        "named": sorted(digest.hex() for digest in memory.named),
        "withdrawn": sorted(digest.hex() for digest in memory.withdrawn),
        "latched": memory.latched.name,
    }
    return {
        "schema": SCHEMA,
        "content": content,
        "sha256": hashlib.sha256(json.dumps(content).encode()).hexdigest(),
    }


def save(path: Path, memory: Memory) -> None:
    """Replace the memory; it is on the disk, directory entry included, when this returns.

    Raises:
        ControllerMemoryError: it could not be written; the file holds what it held, or this.
    """
    try:
        replace_durably(path, json.dumps(_document(memory)).encode("ascii"))
    except OSError as error:
        raise ControllerMemoryError(
            f"{path}: the memory cannot be written: {error}; free or replace the disk"
        ) from None
