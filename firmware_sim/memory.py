"""The simulated controller's non-volatile memory: what was withdrawn, the barrier, the last start's log, a latched fault.

One JSON document with its schema and the SHA-256 of its content, so that no damage goes unseen. What a controller of an
earlier version wrote is read as well: what it withdrew stays withdrawn, and nothing registered until then counts.
"""

import hashlib
import json
import os
from pathlib import Path
from typing import Any, Final

from cutgate.config.constants import REGISTRATIONS_MAX
from cutgate.config.durable import create_ours, replace_durably
from cutgate.config.load import InputError
from cutgate.config.ours import read_ours
from cutgate.firmware_sim.state import Memory
from cutgate.protocol.records import NO_TIME, TreeHead
from cutgate.protocol.states import StopCause

SUFFIX: Final = ".sim-memory.json"
SCHEMA: Final = "cutgate.sim-memory/2"
EARLIER_SCHEMA: Final = "cutgate.sim-memory/1"
"""Of whole registrations, named and withdrawn, by their digests."""
BYTES_MAX: Final = 200 * REGISTRATIONS_MAX
"""A file that is longer holds something else: a digest takes 68 bytes, and there are two lists of them."""
DIGEST_BYTES: Final = 32
BARRIERS: Final = range(NO_TIME, 1 << 63)
"""What OPENED can tell."""


class ControllerMemoryError(Exception):
    """The memory cannot be read or written; the controller does not start without it."""


def beside(key_file: Path) -> Path:
    """The memory's file: beside the key, for a controller with another key is another controller."""
    return key_file.with_name(key_file.name + SUFFIX)


def load(path: Path, now_us: int) -> Memory:
    """What is remembered; nothing where the file does not exist yet.

    Args:
        path: the memory's file.
        now_us: UTC microseconds since 1970: the barrier of a memory of an earlier version that withdrew any.

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
        return _believed(data, now_us)
    except (ValueError, RecursionError) as error:
        raise ControllerMemoryError(
            f"{path}: not a memory that can be believed ({error}); restore the file, or write a new key and memory"
        ) from None


def _believed(data: bytes, now_us: int) -> Memory:
    """Raises ValueError unless this says what would be written, digest included."""
    document = json.loads(data.decode("ascii"))
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema not in (SCHEMA, EARLIER_SCHEMA):
        raise ValueError(f"its schema is not {SCHEMA}")
    content: Any = document.get("content")
    try:
        memory, canonical = _read(content) if schema == SCHEMA else _converted(content, now_us)
    except (KeyError, TypeError) as error:
        raise ValueError(f"its content is malformed: {type(error).__name__} {error}") from None
    if json.dumps(document) != json.dumps(_document(schema, canonical)):  # 1 is not true, nor 1.0
        raise ValueError("its SHA-256 does not match, or it is not in its canonical form")
    if memory.barrier_us not in BARRIERS:
        raise ValueError(f"its barrier is {memory.barrier_us} us, which no session can tell")
    return memory


def _read(content: Any) -> tuple[Memory, dict[str, Any]]:
    """The memory in this content, and the content in its canonical form."""
    log = content["log"]
    memory = Memory(
        withdrawn=_digests(content["withdrawn"]),
        earlier=_digests(content["earlier"]),
        barrier_us=int(content["barrier_us"]),
        withdrawal_due=bool(content["withdrawal_due"]),
        log=TreeHead(bytes.fromhex(log["log_id"]), int(log["size"]), bytes.fromhex(log["root"])),
        latched=StopCause[content["latched"]],
    )
    return memory, _content(memory)


def _converted(content: Any, now_us: int) -> tuple[Memory, dict[str, Any]]:
    """As ``_read``, of the earlier schema: what it withdrew refuses still, and what was registered before now as well.

    Names without a withdrawal are let go: they stood there because an OPEN was not signed.
    """
    named, withdrawn = _digests(content["named"]), _digests(content["withdrawn"])
    latched = StopCause[content["latched"]]
    memory = Memory(earlier=withdrawn, barrier_us=now_us if withdrawn else NO_TIME, latched=latched)
    return memory, {"named": _listed(named), "withdrawn": _listed(withdrawn), "latched": latched.name}


def _digests(listed: Any) -> frozenset[bytes]:
    digests = frozenset(map(bytes.fromhex, listed))
    if len(digests) > REGISTRATIONS_MAX or not all(len(digest) == DIGEST_BYTES for digest in digests):
        raise ValueError(f"it must hold at most {REGISTRATIONS_MAX} digests of {DIGEST_BYTES} bytes each")
    return digests


def _listed(digests: frozenset[bytes]) -> list[str]:
    return sorted(digest.hex() for digest in digests)


def _content(memory: Memory) -> dict[str, Any]:
    log = memory.log
    return {
        "withdrawn": _listed(memory.withdrawn),
        "earlier": _listed(memory.earlier),
        "barrier_us": memory.barrier_us,
        "withdrawal_due": memory.withdrawal_due,
        "log": {"log_id": log.log_id.hex(), "size": log.size, "root": log.root.hex()},
        "latched": memory.latched.name,
    }


def _document(schema: str, content: dict[str, Any]) -> dict[str, Any]:
    return {
        "schema": schema,
        "content": content,
        "sha256": hashlib.sha256(json.dumps(content).encode()).hexdigest(),
    }


def save(path: Path, memory: Memory) -> None:
    """Replace the memory; it is on the disk, directory entry included, when this returns.

    Raises:
        ControllerMemoryError: it could not be written; the file holds what it held, or this.
    """
    try:
        replace_durably(path, json.dumps(_document(SCHEMA, _content(memory))).encode("ascii"))
    except OSError as error:
        raise ControllerMemoryError(
            f"{path}: the memory cannot be written: {error}; free or replace the disk"
        ) from None


# ---------------------------------------------------------------- what a fault makes of it


def cut_short(path: Path, memory: Memory) -> None:
    """As ``save`` whose power is lost half way: the file is what it was, and half of the new one lies beside it."""
    data = json.dumps(_document(SCHEMA, _content(memory))).encode("ascii")
    descriptor = create_ours(path.with_name(f".{path.name}.{os.urandom(8).hex()}.new"))
    try:
        os.write(descriptor, data[: len(data) // 2])
    finally:
        os.close(descriptor)


def flip_bit(path: Path) -> None:
    """Another lowest bit of the byte in the middle of the file, if there is one."""
    if path.exists():
        data = bytearray(read_ours(path, BYTES_MAX))
        data[len(data) // 2] ^= 1
        replace_durably(path, bytes(data))
