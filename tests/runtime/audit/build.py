"""Builders for tests: whole session logs on real inputs, a disk that can be made to misbehave, and forgeries."""

import json
import os
import select
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import cache
from hashlib import sha256
from pathlib import Path
from threading import Event as ThreadEvent
from typing import Any

from cutgate.config.durable import Replacement
from cutgate.config.load import SHIPPED, Loaded, robot_from_bytes
from cutgate.config.model import Robot
from cutgate.config.records import calibration_record, limits_record, tool_record
from cutgate.protocol import candump
from cutgate.protocol import records as wire
from cutgate.runtime.audit import names, records
from cutgate.runtime.audit.commit import Durable
from cutgate.runtime.audit.container.scan import scan
from cutgate.runtime.audit.disk import Reservation, SystemDisk
from cutgate.runtime.audit.inspect import read_log
from cutgate.runtime.audit.log import AuditLog, Clock, OpenInfo, Paths
from cutgate.runtime.audit.tree import Tree
from cutgate.runtime.audit.writer import LogWriter
from cutgate.runtime.plan.load import plan_from_bytes, registration_from_bytes
from cutgate.runtime.plan.prepare import prepare, with_branch
from cutgate.runtime.plan.registration import Registration
from cutgate.runtime.verification import certificate, certified
from cutgate.runtime.verification.approach import report
from cutgate.runtime.verification.approach.decision import verify as verify_approach
from cutgate.runtime.verification.approach.model import StartJoints
from cutgate.runtime.verification.plausibility import Placed, cautions, described
from cutgate.runtime.verification.recorded import problem_from_records
from cutgate.runtime.verification.report.document import Digests, verdict_document
from tests.logs import create, signer_of

VERIFIER = "cutgate test"
OPENED = OpenInfo(software="cutgate 0.1.0", verifier=VERIFIER, simulation=(("time scale", "20"),))
LOG_ID = "0123456789abcdef0123456789abcdef"
PATIENCE_S = 30.0
ROBOT = SHIPPED / "config" / "presets" / "example.toml"
MODELS = {model.TOPIC: model for model in records.MODELS}


class Ticking:
    """Two clocks that go on by a millisecond whenever one is read."""

    def __init__(self) -> None:
        self.now_ns = 1_000_000_000

    def monotonic_ns(self) -> int:
        self.now_ns += 1_000_000
        return self.now_ns

    def utc_ns(self) -> int:
        return 1_790_000_000_000_000_000 + self.monotonic_ns()

    def clock(self) -> Clock:
        return Clock(utc_ns=self.utc_ns, monotonic_ns=self.monotonic_ns)


@dataclass
class WatchedDisk(SystemDisk):
    """The real disk, with its operations counted, and trouble where a test wants it.

    ``trouble`` is asked before each operation with its name and how often it was done before; it may raise.
    ``hung`` lists operations that do not return before ``release``.
    """

    trouble: Callable[[str, int], None] = lambda _operation, _count: None
    hung: set[str] = field(default_factory=set)
    counts: dict[str, int] = field(default_factory=dict)
    synced: dict[int, int] = field(default_factory=dict)
    short: int | None = None
    entered: ThreadEvent = field(default_factory=ThreadEvent)
    released: ThreadEvent = field(default_factory=ThreadEvent)

    def _before(self, operation: str) -> None:
        count = self.counts.get(operation, 0)
        self.counts[operation] = count + 1
        if operation in self.hung:
            self.entered.set()
            self.released.wait()
            raise OSError(5, "released")
        self.trouble(operation, count)

    def write(self, descriptor: int, data: memoryview) -> int:
        self._before("write")
        return super().write(descriptor, data[: self.short])

    def sync(self, descriptor: int) -> None:
        self._before("sync")
        super().sync(descriptor)
        self.synced[descriptor] = os.fstat(descriptor).st_size

    def reserve(self, descriptor: int, path: Path, size: int) -> Reservation:
        self._before("reserve")
        return super().reserve(descriptor, path, size)

    def trim(self, descriptor: int) -> None:
        self._before("trim")
        super().trim(descriptor)

    def replace(self, prepared: Replacement, data: bytes) -> None:
        self._before("replace")
        super().replace(prepared, data)


@contextmanager
def hanging(disk: WatchedDisk, *operations: str) -> Iterator[None]:
    """These operations do not return while the block runs; one of them is begun before it ends."""
    disk.hung.update(operations)
    try:
        yield
        assert disk.entered.wait(PATIENCE_S), "no such operation was begun"
    finally:
        disk.hung.clear()
        disk.released.set()


def wait_for(log: AuditLog, wanted: Callable[[Any], bool]) -> Any:
    """The first event like this; fails if it does not come."""
    while True:
        ready, _, _ = select.select([log.fileno()], [], [], PATIENCE_S)
        assert ready, "the event did not come"
        for event in log.events():
            if wanted(event):
                return event


def decision(number: int, **changes: Any) -> records.AuditDecision:
    values = {
        "sequence": number,
        "event": "Tick",
        "from_state": "a",
        "to_state": "b",
        "disposition": "decided",
    }
    return records.AuditDecision(**(values | changes))


def small_log(directory: Path, *, decisions: int = 3, frames: bool = True, **options: Any) -> Paths:
    """A short log of made-up records, closed in order; with a raw frame for each decision."""
    log = create(directory, log_id=LOG_ID, opened=OPENED, **({"clock": Ticking().clock()} | options))
    log.attach("plan.csv", "text/csv", b"x,y,z\n" * 20)
    for number in range(decisions):
        log.write(records.AuditOperator(word="start", accepted=True))
        if frames:
            log.raw_frame(candump.line(1_790_000_000_123_456_789, "vcan0", 0x080, bytes(range(8))).encode())
        log.write(decision(number))
    return log.close(final_state="done", clean=True, timeout_s=PATIENCE_S)


@contextmanager
def open_log(directory: Path) -> Iterator[AuditLog]:
    """A log that is being written, a minute after another that was closed."""
    small_log(directory)
    later = Ticking()
    later.now_ns += 60_000_000_000
    log = create(directory, log_id=LOG_ID, opened=OPENED, clock=later.clock())
    yield log
    if log.writable:
        log.close(final_state="done", clean=True, timeout_s=PATIENCE_S)


# ---------------------------------------------------------------- a session on real inputs


@dataclass(frozen=True)
class Inputs:
    robot: Loaded[Robot]
    plan: bytes
    registration: bytes
    """The file, as it is attached."""
    path: bytes
    limits: bytes
    calibration: bytes
    tool: bytes

    @property
    def placed(self) -> Registration:
        """What the registration says."""
        return registration_from_bytes(Path("registration.json"), self.registration)


@cache
def inputs(bone_x_mm: float = 500.0) -> Inputs:
    """A short plan with a tilted tool, registered so far from the column; 500 is admissible, 850 is not."""
    data = ROBOT.read_bytes()
    robot = robot_from_bytes(ROBOT, data)
    rows = [f"{2 * i},{i},{-i},0.5,0,0.8660254" for i in range(6)]
    plan = ("x,y,z,i,j,k\n" + "\n".join(rows) + "\n").encode()
    matrix = [[1, 0, 0, bone_x_mm], [0, 1, 0, 50], [0, 0, 1, 120], [0, 0, 0, 1]]
    registration = json.dumps(
        {
            "schema": "cutgate.registration/1",
            "id": "test",
            "R_T_CT": matrix,
            "residual_rms_mm": 0.2,
            "created_utc": "2026-01-01T00:00:00Z",
        }
    ).encode()
    prepared = prepare(
        Loaded(plan_from_bytes(Path("plan.csv"), plan), plan, Path("plan.csv")),
        Loaded(
            registration_from_bytes(Path("registration.json"), registration),
            registration,
            Path("registration.json"),
        ),
        robot,
        now=datetime(2026, 9, 1, tzinfo=UTC),
        clock_skew_s=0.0,
    )
    return Inputs(
        Loaded(robot, data, ROBOT),
        plan,
        registration,
        with_branch(prepared.path, 0, 0).body(),
        limits_record(robot).body(),
        calibration_record(robot).body(),
        tool_record(robot).body(),
    )


@cache
def verdict_of(given: float = 500.0) -> str:
    """The verdict document of these inputs, as JSON text."""
    i = inputs(given)
    problem = problem_from_records(i.path, i.limits, i.calibration, i.tool, i.robot.value)
    verdict = certified.verify(problem)
    document = verdict_document(
        verdict,
        poses=6,
        guidance=None,
        digests=Digests(
            *(sha256(part).digest() for part in (i.path, i.limits, i.calibration)), i.placed.digest
        ),
        elapsed_ms=1.25,
    )
    value = i.placed
    placed = Placed(value.matrix, value.residual_rms_mm)
    found = cautions(problem, verdict, placed)
    return json.dumps(described(document, problem, verdict, found, placed))


@cache
def proof_of(given: float = 500.0) -> bytes | None:
    """The certificate of these inputs, None where they are inadmissible."""
    i = inputs(given)
    problem = problem_from_records(i.path, i.limits, i.calibration, i.tool, i.robot.value)
    proof = certificate.certify(problem, certified.verify(problem))
    return proof.body() if proof else None


STANDS = (-40_000_000, 95_000_000, 265_000_000, -50_000_000, 32_000_000)
"""Where the arm stood when it was verified, 1e-6 deg | mm."""


@cache
def approach_of(given: float = 500.0) -> records.AuditApproach:
    """The approach record of these inputs, at the default site's settings."""
    i = inputs(given)
    problem = problem_from_records(i.path, i.limits, i.calibration, i.tool, i.robot.value)
    start = StartJoints.of(STANDS, clearance_um=10_000, tolerance_mm=0.5, tolerance_deg=0.2)
    verdict = verify_approach(problem, start)
    return records.AuditApproach.of(
        report.document(verdict, start),
        start_joints_u=STANDS,
        bound=report.bound(verdict, 25),
        reason=report.summary(verdict),
    )


def wire_permit(
    given: float = 500.0, site: bytes | None = None, log: wire.TreeHead = wire.NO_TREE_HEAD
) -> wire.Permit:
    """A permit for these inputs."""
    way, path = approach_of(given), wire.Path.parse(inputs(given).path)
    i = inputs(given)
    digests = {
        f"{name}_digest": sha256(getattr(i, name)).digest()
        for name in ("path", "limits", "calibration", "tool")
    }
    digests["registration_digest"] = i.placed.digest
    files = i.robot.sha256 + (bytes(32) if site is None else sha256(site).digest())
    return wire.Permit(
        nonce=bytes(16),
        announce_nonce=bytes(16),
        session_digest=bytes(32),
        serial="SIM-1",
        protocol_version=wire.PROTOCOL_VERSION,
        epoch=1,
        **digests,
        configuration_digest=sha256(b"cutgate/configuration/1" + files).digest(),
        verifier_version=VERIFIER,
        start_joints_u=STANDS,
        branch=wire.Branch(path.elbow, path.q0_turns, path.roll_turns),
        approach=wire.Approach(
            way.entry_um, way.exit_um, way.entry_joints_u, way.exit_joints_u, way.speed_percent or 25
        ),
        lifetime_s=120,
        log=log,
    )


def wire_start(permit: wire.Permit, log: wire.TreeHead = wire.NO_TREE_HEAD) -> wire.Start:
    """The order to cut under this permit."""
    return wire.Start(
        nonce=bytes(16),
        epoch=permit.epoch,
        session_digest=permit.session_digest,
        permit_digest=permit.digest,
        start_joints_u=permit.start_joints_u,
        log=log,
    )


def tree_head(log: AuditLog) -> wire.TreeHead:
    """The tree of everything written so far, as it was signed last."""
    return wire.TreeHead(bytes.fromhex(LOG_ID), *log._writer.signed)


def permit_record(
    given: float,
    kind: str,
    stage: str,
    *,
    site: bytes | None = None,
    heads: tuple[wire.TreeHead, ...] = (),
    **changes: Any,
) -> records.AuditPermit:
    """One record of a permit or start; ``heads``: of the permit's log, and of the start's."""
    permit = wire_permit(given, site, *heads[:1])
    digests = {
        f"{name}_sha256": getattr(permit, f"{name}_digest").hex()
        for name in ("path", "limits", "calibration", "tool", "registration", "configuration")
    }
    values = {"kind": kind, "stage": stage, "token": 1 if kind == "permit" else 2}
    bound = digests if kind == "permit" else {}
    signed = (permit if kind == "permit" else wire_start(permit, *heads[1:])).canonical().hex()
    if stage == "sent":
        values |= {"log_size": heads[-1].size, "log_root": heads[-1].root.hex()}
    return records.AuditPermit(**(values | bound | {"record": signed} | changes))


def session_log(
    directory: Path, bone_x_mm: float = 500.0, *, disk: SystemDisk | None = None, site: bytes | None = None
) -> Paths:
    """A log as a session writes it: admitted, cut and closed, or refused."""
    i = inputs(bone_x_mm)
    log = create(directory, log_id=LOG_ID, opened=OPENED, clock=Ticking().clock(), disk=disk)
    for name, data in (
        (names.ROBOT, i.robot.data),
        ("plan.csv", i.plan),
        ("registration.json", i.registration),
        (names.PATH, i.path),
        (names.LIMITS, i.limits),
        (names.CALIBRATION, i.calibration),
        (names.TOOL, i.tool),
    ):
        log.attach(name, "application/octet-stream", data)
    if site is not None:
        log.attach(names.SITE, "application/toml", site)
    proof = proof_of(bone_x_mm)
    if proof is not None:
        log.attach(names.PROOF, "application/octet-stream", proof)
    document = json.loads(verdict_of(bone_x_mm))
    log.write(
        records.AuditVerdict.of(
            document, verifier=VERIFIER, tool_sha256=sha256(i.tool).hexdigest(), reason=""
        )
    )
    for boundary in records.boundaries_of(document):
        log.write(boundary)
    admitted = document["verdict"] == "admissible"
    if admitted:
        log.write(approach_of(bone_x_mm))
    log.write(decision(1, event=f"verdict {document['verdict']}", from_state="verifying"))
    if admitted:
        _enable(log, bone_x_mm, site)
    return log.close(
        final_state="done" if admitted else "refused",
        verdict=document["verdict"],
        clean=True,
        timeout_s=PATIENCE_S,
    )


def _enable(log: AuditLog, given: float, site: bytes | None) -> None:
    stands = records.PermissiveValue(
        name="verdict", holds=True, text="admissible", bound="admissible", remedy=""
    )
    heads: tuple[wire.TreeHead, ...] = ()
    for token, kind in ((1, "permit"), (2, "start")):
        log.write(permit_record(given, kind, "authorised", site=site, heads=heads))
        log.write(
            decision(2 * token, event=f"authorise {kind}", disposition="authorised", permissives=(stands,))
        )
        log.commit(token)
        heads += (tree_head(log),)
        log.write(permit_record(given, kind, "sent", site=site, heads=heads))
        log.write(decision(2 * token + 1, event="RecordDurable", disposition="sent", permissives=(stands,)))
        log.write(permit_record(given, kind, "acknowledged", site=site, heads=heads))


def enable(log: AuditLog, *kinds: str, **changes: Any) -> list[Durable]:
    """Each kind authorised, and sent with the tree of its authorising record, as a session does; those trees."""
    trees = []
    for token, kind in enumerate(kinds, start=1):
        log.write(records.AuditPermit(kind=kind, stage="authorised", token=token))
        log.write(decision(token, disposition="authorised", token=token))
        log.commit(token)
        tree = wait_for(log, lambda event, token=token: isinstance(event, Durable) and event.token == token)
        permit = wire_permit(log=wire.TreeHead(bytes.fromhex(LOG_ID), tree.size, tree.root))
        signed = permit if kind == "permit" else wire_start(permit, permit.log)
        named = {
            "log_size": tree.size,
            "log_root": tree.root.hex(),
            "record": signed.canonical().hex(),
        } | changes
        log.write(records.AuditPermit(kind=kind, stage="sent", token=token, **named))
        log.write(decision(token, event="RecordDurable", disposition="sent"))
        trees.append(tree)
    return trees


Edit = Callable[[records.LogRecord], "records.Record | None"]


def forge(
    data: bytes,
    edit: Edit = lambda record: record,
    attachments: Callable[[str, bytes], bytes | None] = lambda _name, data: data,
    *,
    signed: bool = True,
    trees_again: bool = True,
) -> bytes:
    """The log written again with changed records and attachments, every digest, link, count and checkpoint made to fit.

    ``signed``: with the key that signed it; without, its checkpoints stay as they are.
    ``trees_again``: what permits and starts name of the tree as well, for which the key is needed.
    """
    old = scan(data)
    log = read_log(data)
    signer = signer_of(data) if signed else None
    writer = LogWriter(log.report.log_id, {"software": old.metadata[0].metadata["software"]}, signer)
    changed = [(entry, attachments(entry.name, entry.data)) for entry in old.attachments]
    kept = {entry.name: content for entry, content in changed if content is not None}
    for entry, content in changed:
        if content is not None:
            writer.attach(entry.name, entry.media_type, content, log_time_ns=entry.log_time)
    trees = TreesAgain(bytes.fromhex(log.report.log_id))
    for message in old.messages:
        record: records.LogRecord | None = MODELS[message.topic].model_validate_json(message.link.data)
        if isinstance(record, records.AuditAttachment):
            record = _digest_again(record, kept)
        if isinstance(record, records.AuditPermit) and trees_again:
            record = trees.named_again(record)
        record = record and edit(record)
        if isinstance(record, records.AuditCheckpoint) and signer is not None:
            writer.checkpoint()
            continue
        if isinstance(record, records.AuditClose):
            record = record.model_copy(update={"message_count": writer.count + 1})
        if record is not None:
            writer.add(record, log_time_ns=message.link.log_time, monotonic_ns=_monotonic(record))
            if isinstance(record, records.AuditDecision) and record.disposition == "authorised":
                trees.authorised(writer.tree)
    writer.finish()
    return writer.take()


@dataclass
class TreesAgain:
    """What permits and starts name of the tree, as the log that is written again has it."""

    log_id: bytes
    head: wire.TreeHead = wire.NO_TREE_HEAD
    permit: bytes = b""

    def authorised(self, tree: Tree) -> None:
        """The record that authorises has been written; the tree with it as its last."""
        self.head = wire.TreeHead(self.log_id, tree.size, tree.root)

    def named_again(self, record: records.AuditPermit) -> records.AuditPermit:
        if record.stage != "sent" or record.log_size is None or record.record is None:
            return record
        kind = {"permit": wire.Permit, "start": wire.Start}[record.kind]
        signed = kind.parse(bytes.fromhex(record.record).removeprefix(kind.DOMAIN + b"\0") + wire.NO_MAC)
        changes = {} if isinstance(signed, wire.Permit) else {"permit_digest": self.permit}
        signed = replace(signed, log=self.head, **changes)
        self.permit = signed.digest if isinstance(signed, wire.Permit) else self.permit
        named = {"log_size": self.head.size, "log_root": self.head.root.hex()}
        return record.model_copy(update=named | {"record": signed.canonical().hex()})


def _digest_again(record: records.AuditAttachment, kept: dict[str, bytes]) -> records.AuditAttachment | None:
    if record.name not in kept:
        return None
    content = kept[record.name]
    return record.model_copy(update={"sha256": sha256(content).hexdigest(), "size": len(content)})


def _monotonic(record: records.LogRecord) -> int:
    return record.monotonic.nanoseconds if isinstance(record, records.AuditRecord) else 0
