"""What was signed of a permit or start, as its record in the log holds it: all but the session and the sequence."""

from typing import TypeVar

from cutgate.protocol import records as wire
from cutgate.runtime.audit.records import AuditPermit

S = TypeVar("S", wire.Permit, wire.Start)


def canonical(record: AuditPermit) -> bytes:
    """The bytes. Raises ValueError if they cannot be read."""
    return bytes.fromhex(record.record or "")


def signed(kind: type[S], record: AuditPermit) -> S:
    """The same, in its fields; one that names no tree is of version 3 of the protocol, which had none.

    Raises:
        ValueError: it cannot be read.
    """
    body = canonical(record).removeprefix(kind.DOMAIN + b"\0")
    log = wire.NO_TREE_HEAD.body() if record.log_size is None else b""
    return kind.parse(body + log + wire.NO_MAC)
