"""Builders for tests: the records of a made-up log, its keys, and proofs out of them."""

import json
from functools import cache

from cutgate.runtime.audit.chain import ChainLink, covered
from cutgate.runtime.audit.signing.checkpoint import Checkpoint, origin_of
from cutgate.runtime.audit.signing.log_key import LogKey
from cutgate.runtime.audit.signing.note import sign
from cutgate.runtime.audit.signing.proof import RecordProof
from cutgate.runtime.audit.tree import ProvingTree

LOG_ID = "0123456789abcdef0123456789abcdef"
SERIES = bytes(range(16))
UTC_NS = 1_790_000_000_000_000_000


def record(number: int, text: str = "") -> bytes:
    """What is covered of a record of this number."""
    content = {"prev": "00" * 32, "word": text or f"record {number}"}
    return covered(
        ChainLink(
            "/audit/operator", "json", "cutgate.Operator", b"{}", UTC_NS + number, UTC_NS + number, number,
            json.dumps(content).encode(),
        )
    )  # fmt: skip


@cache
def keys(count: int, first: int = 1) -> tuple[LogKey, ...]:
    """The keys of so many sessions; the first was enrolled."""
    made = [LogKey(SERIES, first, first.to_bytes(4) * 8)]
    for _ in range(count - 1):
        made.append(made[-1].following((made[-1].epoch + 1).to_bytes(4) * 8))
    return tuple(made)


def checkpoint(key: LogKey, size: int, root: bytes, log_id: str = LOG_ID) -> str:
    """A checkpoint that this key signs."""
    return sign(Checkpoint(origin_of(log_id), size, root).text, origin_of(log_id), key.private)


def proof_of(index: int, size: int, *, epochs: int = 1, first: int = 1, text: str = "") -> RecordProof:
    """A true proof of record ``index`` by a checkpoint of ``size`` records, with ``epochs - 1`` certificates."""
    chain = keys(epochs, first)
    tree = ProvingTree(index)
    for number in range(size):
        tree.append(record(number, text))
    public = tuple(key.public for key in chain)
    return RecordProof(
        record(index, text),
        index,
        tree.proof,
        checkpoint(chain[-1], size, tree.root),
        public[-1].public,
        public if epochs > 1 else (),
    )
