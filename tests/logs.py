"""Logs as tests write and judge them: the keys that signed them are remembered, so that a log can be signed again."""

from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any

from cutgate.runtime.audit.container.scan import walk
from cutgate.runtime.audit.container.stored import Scan
from cutgate.runtime.audit.inspect import Log, read_log
from cutgate.runtime.audit.judge import parse_object
from cutgate.runtime.audit.log import AuditLog
from cutgate.runtime.audit.signing.log_key import LogKey
from cutgate.runtime.audit.signing.signer import Signer, sidecar_of
from cutgate.runtime.audit.tree import Tree

_KEYS: dict[str, LogKey] = {}
"""By the public half, in hex."""


def create(directory: Path, **options: Any) -> AuditLog:
    """As ``AuditLog.create``; the key is remembered."""
    log = AuditLog.create(directory, **options)
    key = log.held.key
    _KEYS[key.public.public.hex()] = key
    return log


def key_of(data: bytes) -> LogKey:
    """The key that has signed this log, which was written here."""
    first = next(walk(BytesIO(data), Scan()))
    return _KEYS[(parse_object(first.data) or {})["public_key"]]


def signer_of(data: bytes) -> Signer | None:
    """Who has signed this log; None where nobody did, or nobody here."""
    first = next(walk(BytesIO(data), Scan()), None)
    opened = (parse_object(first.data) if first else None) or {}
    key = _KEYS.get(opened.get("public_key", ""))
    return None if key is None else Signer(key, str(opened.get("log_id")))


def signature_of(data: bytes) -> bytes | None:
    """What stands beside a log of these bytes, signed by whoever has signed it; None as ``signer_of``."""
    signer, tree = signer_of(data), Tree()
    if signer is None:
        return None
    for message in walk(BytesIO(data), Scan()):
        tree.append(message.covered)
    return signer.sidecar(tree.size, tree.root, len(data), sha256(data).digest())


def judged(path: Path) -> Log:
    """A log, read and judged together with its raw frames and its signature, as far as they are there."""
    candump, sidecar = path.with_suffix(".candump.log"), sidecar_of(path)
    return read_log(
        path.read_bytes(),
        candump.read_bytes() if candump.exists() else None,
        sidecar.read_bytes() if sidecar.exists() else None,
    )
