"""Builders for tests: folders of real logs, as sessions leave them one after the other."""

import json
from hashlib import sha256
from pathlib import Path

from cutgate.protocol import candump
from cutgate.protocol import records as wire
from cutgate.runtime.audit import records
from cutgate.runtime.audit.commit import Durable
from cutgate.runtime.audit.directory import HEAD
from cutgate.runtime.audit.log import AuditLog
from cutgate.runtime.audit.reading import reading
from cutgate.runtime.audit.signing.signer import sidecar_of
from tests import logs
from tests.runtime.audit.build import OPENED, PATIENCE_S, Ticking, decision, wait_for

HOUR_NS = 3_600_000_000_000


def log_id(number: int) -> str:
    return sha256(b"log %d" % number).hexdigest()[:32]


def create(directory: Path, number: int, **options) -> AuditLog:
    clock = Ticking()
    clock.now_ns += number * HOUR_NS
    return logs.create(directory, log_id=log_id(number), opened=OPENED, clock=clock.clock(), **options)


def write_session(
    directory: Path,
    number: int,
    *,
    start: bool = False,
    crash: bool = False,
    seen: records.AuditWitness | None = None,
    behind: tuple[records.LogRecord, ...] = (),
    **options,
) -> Path:
    """A session's log, closed in order, or cut short as by a loss of power; with a start if it is to have one.

    Args:
        directory: of the logs.
        number: hours since the first one.
        start: the arm was started.
        crash: the power failed.
        seen: what the controller told.
        behind: records behind all that.
        options: of ``AuditLog.create``.
    """
    log = create(directory, number, **options)
    if seen is not None:
        log.write(seen)
    log.raw_frame(candump.line(1_790_000_000_123_456_789, "vcan0", 0x080, bytes(range(8))).encode())
    log.write(decision(1))
    if start:
        _start(log)
    for record in behind:
        log.write(record)
    log.commit(99)
    wait_for(log, lambda event: isinstance(event, Durable) and event.token == 99)
    left = {path: path.read_bytes() for path in (log.path, directory / HEAD)}
    log.close(final_state="done", clean=True, timeout_s=PATIENCE_S)
    if crash:
        sidecar_of(log.path).unlink()
        for path, data in left.items():
            path.write_bytes(data)
    return log.path


def _start(log: AuditLog) -> None:
    log.write(records.AuditPermit(kind="start", stage="authorised", token=5))
    log.write(decision(2, disposition="authorised", token=5))
    log.commit(5)
    tree = wait_for(log, lambda event: isinstance(event, Durable) and event.token == 5)
    head = wire.TreeHead(bytes.fromhex(log_id_of(log)), tree.size, tree.root)
    start = wire.Start(
        nonce=bytes(16),
        epoch=1,
        session_digest=bytes(32),
        permit_digest=bytes(32),
        start_joints_u=(0, 0, 0, 0, 0),
        log=head,
    )
    sent = {"log_size": tree.size, "log_root": tree.root.hex(), "record": start.canonical().hex()}
    log.write(records.AuditPermit(kind="start", stage="sent", token=5, **sent))
    log.write(decision(3, event="RecordDurable", disposition="sent"))


def log_id_of(log: AuditLog) -> str:
    return log._signer._origin.removeprefix("cutgate/")


def witness_of(number: int, trees: dict[int, tuple[int, str]], *, found: bool = True) -> records.AuditWitness:
    """What a controller tells that saw this session's start."""
    size, root = trees[number]
    return records.AuditWitness(log_id=log_id(number), log_size=size, log_root=root, found=found)


def started_tree(path: Path) -> tuple[int, str]:
    """Size and root that a log's start names."""
    with reading(path) as log:
        sent = [one for one in log.of(records.AuditPermit.TOPIC) if one["stage"] == "sent"]
    return sent[-1]["log_size"], sent[-1]["log_root"]


def folder_of(
    directory: Path, count: int, *, crashed: tuple[int, ...] = (), started: tuple[int, ...] = ()
) -> list[Path]:
    """So many sessions, an hour apart; each is told of the last start before it, as the controller tells it."""
    paths: list[Path] = []
    trees: dict[int, tuple[int, str]] = {}
    for number in range(count):
        seen = witness_of(max(trees), trees) if trees else None
        path = write_session(directory, number, start=number in started, crash=number in crashed, seen=seen)
        if number in started:
            trees[number] = started_tree(path)
        paths.append(path)
    return paths


def head(directory: Path) -> dict:
    return json.loads((directory / HEAD).read_bytes())
