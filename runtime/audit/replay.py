"""Deciding again from the log alone: same path, same limits, same verdict, and nothing enabled without it.

The attachments are the bytes that the session decided on. The path is made again from plan, registration and
robot; the verdict is computed again from the recorded path and parameters; and every permit and start that left
is held against that verdict. A log in which a verdict was changed and the whole chain computed anew differs here.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import IntEnum
from hashlib import sha256
from pathlib import Path as FilePath
from typing import Any, Final, TypeVar

import numpy as np
from pydantic import ValidationError

from cutgate.config.load import (
    BYTES_PER_MB,
    DEFAULT_LIMIT,
    InputError,
    Loaded,
    robot_from_bytes,
    site_from_bytes,
)
from cutgate.config.model import Robot, Site
from cutgate.config.records import calibration_record, limits_record, tool_record
from cutgate.protocol import records as wire
from cutgate.protocol.records import Path, RecordError
from cutgate.runtime.audit import names, records
from cutgate.runtime.audit.configuration import allowed_by_option, configuration_digest
from cutgate.runtime.audit.container.stored import StoredAttachment
from cutgate.runtime.audit.inspect import Log, Status
from cutgate.runtime.audit.log import cpu_dispatch
from cutgate.runtime.interlock.phases import MOVING, STOPPING
from cutgate.runtime.plan.load import plan_from_bytes, registration_from_bytes
from cutgate.runtime.plan.model import Registration
from cutgate.runtime.plan.prepare import IDENTITY_REGISTRATION, prepare, with_branch
from cutgate.runtime.verification import certificate
from cutgate.runtime.verification.approach import decision, report
from cutgate.runtime.verification.approach.model import Start
from cutgate.runtime.verification.plausibility import Placed, cautions, described
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.recorded import problem_from_records
from cutgate.runtime.verification.report.document import Digests, verdict_document
from cutgate.runtime.verification.verdict import Verdict

TOLERANCE: Final = 1e-9
"""mm, deg; relative for lengths above one."""
NOT_RECOMPUTED: Final = ("elapsed_ms", "guidance", "guidance_note", "other_elbow")
BIT_DEPENDENT: Final = ("evaluations", "segment", "fraction", "tip_length_mm", "tip_mm", "reasons", "text")
"""Follow from the last bit of arctan2 and arccos: compared only on an equal numpy and CPU."""

BEFORE_WARNINGS: Final = ("cutgate 0.1.0",)
"""Verifiers that did not say where a cut lies and what looks wrong."""

WATCHED: Final = ("joints measured", "progress reported", "heartbeat", "time passed")
"""On these the moving arm is held against the verified path, and what the decision names is what it showed."""

ABSOLUTE: Final = ("boundaries", "legs")
"""Clearances are compared absolutely, whatever their size."""

Verify = Callable[[Problem], Verdict]
R = TypeVar("R", bound=records.Record)


class Outcome(IntEnum):
    """What a replay shows; its number is the exit code."""

    IDENTICAL = 0
    DIFFERS = 1
    BAD_INPUT = 2


class ReplayError(Exception):
    """The log does not hold what a replay needs."""


@dataclass(frozen=True, slots=True)
class Replay:
    """What came of it.

    Attributes:
        outcome: identical, different, or not a log that can be replayed.
        differences: each names what was recorded and what it should have been.
        notes: what was not compared, and why.
        verdict: the recomputed verdict document of the last verdict; None if there was none.
    """

    outcome: Outcome
    differences: tuple[str, ...]
    notes: tuple[str, ...]
    verdict: dict[str, Any] | None = None


@dataclass
class _Findings:
    differences: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    documents: list[dict[str, Any]] = field(default_factory=list)
    approaches: list[str] = field(default_factory=list)
    """The words recomputed for the approach records, in their order."""


@dataclass(frozen=True, slots=True)
class _Inputs:
    """The bytes that the session decided on."""

    path: bytes
    limits: bytes
    calibration: bytes
    tool: bytes
    robot: Robot
    site: Site
    registration_sha256: bytes
    placed: Placed | None
    size_max: int
    """Bytes of the largest attachment that is read: what the site allowed its input files."""


def replay(log: Log, verify: Verify, *, verifier: str) -> Replay:
    """Decide again what the log's session decided.

    Args:
        log: the log as read.
        verify: the gate's verifier.
        verifier: its version, as permits name it.
    """
    if log.report.status is Status.UNREADABLE:
        return Replay(Outcome.BAD_INPUT, log.report.reasons, ())
    found = _Findings()
    if log.report.status is not Status.OK:
        text = f"the log itself is {log.report.status.name}: {log.report.reasons[0]}"
        (found.notes if log.report.status is Status.INCOMPLETE else found.differences).append(text)
    try:
        _replay(log, verify, verifier, found)
    except ReplayError as error:
        return Replay(Outcome.BAD_INPUT, (str(error),), tuple(found.notes))
    outcome = Outcome.DIFFERS if found.differences else Outcome.IDENTICAL
    verdict = found.documents[-1] if found.documents else None
    return Replay(outcome, tuple(found.differences), tuple(found.notes), verdict)


def _replay(log: Log, verify: Verify, verifier: str, found: _Findings) -> None:
    opened = _typed(log, records.Open)
    if not opened:
        raise ReplayError("the log has no record 0")
    verdicts = _typed(log, records.Verdict)
    if verdicts:
        inputs = _inputs(log)
        found.differences += _derivation(log, inputs, opened[0])
        comparable = _comparable(opened[0], verifier, found)
        words = opened[0].verifier == verifier
        for recorded in verdicts:
            document = _recompute(recorded, inputs, verify, opened[0])
            found.documents.append(document)
            found.differences += _compare(recorded, document, inputs, comparable=comparable)
        found.differences += _boundary_records(log, verdicts)
        if verdicts[-1].verdict == "admissible":
            found.differences += _proof(log, inputs)
        for way in _typed(log, records.Approach):
            found.differences += _approach(way, inputs, found, comparable=comparable, words=words)
        if any(document["verdict"] == "inadmissible" for document in found.documents):
            found.notes.append("the guidance was not computed again, nor the other elbow")
    else:
        found.notes.append("the session ended before a verdict: there is nothing to compute again")
    found.differences += _permits(log, opened[0], found.documents, found.approaches)


# ---------------------------------------------------------------- what was decided on


def _inputs(log: Log) -> _Inputs:
    size_max = DEFAULT_LIMIT

    def needed(name: str) -> bytes:
        data = _attachment(log, name, size_max)
        if data is None:
            raise ReplayError(f"attachment {name} is missing: the verdict cannot be computed again")
        return data

    try:
        robot = robot_from_bytes(names.ROBOT, needed(names.ROBOT))
        settings = _attachment(log, names.SITE, size_max)
        site = Site() if settings is None else site_from_bytes(names.SITE, settings, recorded=True)
    except InputError as error:
        raise ReplayError(f"attachment {error}") from None
    size_max = max(size_max, site.files.file_size_limit_mb * BYTES_PER_MB)
    registration = _by_stem(log, names.REGISTRATION, size_max)
    return _Inputs(
        path=needed(names.PATH),
        limits=needed(names.LIMITS),
        calibration=needed(names.CALIBRATION),
        tool=needed(names.TOOL),
        robot=robot,
        site=site,
        registration_sha256=sha256(registration[1] if registration else IDENTITY_REGISTRATION).digest(),
        placed=_placed(registration, site),
        size_max=size_max,
    )


def _placed(registration: tuple[FilePath, bytes] | None, site: Site) -> Placed | None:
    if registration is None:
        return None
    try:
        value = registration_from_bytes(*registration)
    except InputError as error:
        raise ReplayError(f"attachment {error}") from None
    return Placed(value.matrix, value.residual_rms_mm, site.registration_max_residual_mm)


def _derivation(log: Log, inputs: _Inputs, opened: records.Open) -> Iterator[str]:
    """Whether the uploaded path is the one that plan, registration and robot give."""
    plan, registration = (_by_stem(log, stem, inputs.size_max) for stem in (names.PLAN, names.REGISTRATION))
    if plan is None:
        raise ReplayError(f"attachment {names.PLAN} is missing: the path cannot be made again")
    try:
        uploaded = Path.parse(inputs.path)
        wanted = plan_from_bytes(plan[0], plan[1])
        placed: Loaded[Registration] | None = None
        if registration is not None:
            value = registration_from_bytes(registration[0], registration[1])
            placed = Loaded(value, registration[1], registration[0])
        prepared = prepare(
            Loaded(wanted, plan[1], plan[0]),
            placed,
            inputs.robot,
            now=_after(opened.utc),
            feed_mm_s=uploaded.feed_mm_s if wanted.feed_mm_s is None else None,
        )
    except (InputError, RecordError) as error:
        yield f"plan, registration and robot give no path: {error}"
        return
    made = with_branch(prepared.path, uploaded.q0_turns, uploaded.roll_turns)
    if made.body() != inputs.path:
        yield "the uploaded path is not the one that plan, registration and robot give"


def _after(utc: records.Time) -> datetime:
    """The whole second after a time."""
    try:
        return datetime.fromtimestamp(utc.sec + 1, UTC)
    except (ValueError, OverflowError, OSError):
        raise ReplayError(f"record 0 was written at {utc.sec} s since 1970, which is no date") from None


def _comparable(opened: records.Open, verifier: str, found: _Findings) -> bool:
    """Whether last bits can be compared; says why not, and whether the verifier is another."""
    if opened.verifier != verifier:
        found.notes.append(f"verifier {opened.verifier} recorded, {verifier} recomputes")
    there, here = (opened.numpy, opened.cpu_dispatch), (np.__version__, cpu_dispatch())
    if there == here:
        return True
    found.notes.append(
        f"evaluation counts and worst places are not comparable: numpy {there[0]} on {' '.join(there[1])} "
        f"recorded, numpy {here[0]} on {' '.join(here[1])} recomputes"
    )
    return False


# ---------------------------------------------------------------- the verdict


def _problem(inputs: _Inputs) -> Problem:
    try:
        return problem_from_records(inputs.path, inputs.limits, inputs.calibration, inputs.tool, inputs.robot)
    except (RecordError, ValueError) as error:
        raise ReplayError(f"the attachments pose no problem that can be verified: {error}") from None


def _recompute(
    recorded: records.Verdict, inputs: _Inputs, verify: Verify, opened: records.Open
) -> dict[str, Any]:
    problem = _problem(inputs)
    try:
        verdict = verify(problem)
    except ValueError as error:
        raise ReplayError(f"the attachments pose no problem that can be verified: {error}") from None
    digests = Digests(
        path=sha256(inputs.path).digest(),
        limits=sha256(inputs.limits).digest(),
        calibration=sha256(inputs.calibration).digest(),
        registration=inputs.registration_sha256,
    )
    document = verdict_document(
        verdict,
        poses=len(problem.tips_mm),
        guidance=None,
        digests=digests,
        elapsed_ms=recorded.elapsed_ms or 0.0,
    )
    if recorded.verifier == opened.verifier and opened.verifier in BEFORE_WARNINGS:
        return document
    return described(document, problem, verdict, cautions(problem, verdict, inputs.placed))


def _compare(
    recorded: records.Verdict, document: dict[str, Any], inputs: _Inputs, *, comparable: bool
) -> Iterator[str]:
    """The recorded verdict, as document and as flat fields, against the recomputed document."""
    theirs = _document(recorded)
    if theirs is None:
        yield "verdict: the recorded document is not a JSON object"
        return
    yield from _documents("verdict", theirs, document, comparable=comparable)
    yield from _flat(recorded, theirs, inputs)


def _documents(what: str, theirs: dict[str, Any], ours: dict[str, Any], *, comparable: bool) -> Iterator[str]:
    """Two documents, value by value."""
    before, after = _leaves(theirs), _leaves(ours)
    for key in sorted(before.keys() | after.keys()):
        parts = key.split(".")
        if parts[0] in NOT_RECOMPUTED or (not comparable and not {*parts}.isdisjoint(BIT_DEPENDENT)):
            continue
        if key not in before or key not in after:
            yield f"{what} {key}: {'recorded' if key in before else 'recomputed'} only"
        elif not _same(before[key], after[key], absolute=parts[0] in ABSOLUTE):
            yield f"{what} {key}: recorded {before[key]}, recomputed {after[key]}"


def _flat(recorded: records.Verdict, theirs: dict[str, Any], inputs: _Inputs) -> Iterator[str]:
    """The record's flat fields must say what its document says."""
    try:
        again = records.Verdict.of(
            theirs,
            verifier=recorded.verifier,
            tool_sha256=sha256(inputs.tool).hexdigest(),
            reason=recorded.reason or "",
        )
    except (KeyError, TypeError, AttributeError, ValueError, ArithmeticError, RecursionError):
        yield "verdict: the recorded document is not a verdict document"
        return
    for name in type(recorded).model_fields.keys() - records.AuditRecord.model_fields.keys() - {"document"}:
        if getattr(recorded, name) != getattr(again, name):
            yield f"verdict {name}: recorded {getattr(recorded, name)}, its document says {getattr(again, name)}"


def _boundary_records(log: Log, verdicts: list[records.Verdict]) -> Iterator[str]:
    """The boundary records are those of the recorded documents, in their order."""
    expected: list[records.Boundary] = []
    for verdict in verdicts:
        document = _document(verdict)
        try:
            expected += records.boundaries_of(document or {})
        except (KeyError, TypeError, AttributeError, ValueError, ArithmeticError):
            return  # said already by _flat
    found = _typed(log, records.Boundary)
    if len(found) > len(expected) or (log.scan.finished and len(found) < len(expected)):
        yield f"boundaries: {len(found)} recorded, the documents have {len(expected)}"
    ignored = set(records.AuditRecord.model_fields)
    for one, other in zip(found, expected, strict=False):
        if one.model_dump(exclude=ignored) != other.model_dump(exclude=ignored):
            yield f"boundary {one.name}: the record is not what the verdict's document says"


def _document(recorded: records.Verdict | records.Approach) -> dict[str, Any] | None:
    try:
        document = json.loads(recorded.document)
    except (ValueError, RecursionError):
        return None
    return document if isinstance(document, dict) else None


def _leaves(document: Any) -> dict[str, Any]:
    """Every value of a document under its dotted key, however deep; an empty container is a value."""
    found: dict[str, Any] = {}
    waiting = [("", document)]
    while waiting:
        place, value = waiting.pop()
        if isinstance(value, Mapping) and value:
            parts = [(str(key), item) for key, item in value.items()]
        elif isinstance(value, list) and value:
            parts = [(str(number), item) for number, item in enumerate(value)]
        else:
            found[place] = value
            continue
        waiting += [(f"{place}.{key}" if place else key, item) for key, item in reversed(parts)]
    return found


def _same(one: Any, other: Any, *, absolute: bool) -> bool:
    if isinstance(one, bool) or isinstance(other, bool):
        return one is other
    if isinstance(one, int | float) and isinstance(other, int | float):
        scale = 1.0 if absolute else max(1.0, abs(other))
        try:
            return abs(one - other) <= TOLERANCE * scale
        except OverflowError:  # an integer no double can hold
            return False
    return type(one) is type(other) and bool(one == other)


def _proof(log: Log, inputs: _Inputs) -> Iterator[str]:
    """The recorded certificate proves the recorded path admissible, checked without a search."""
    body = _attachment(log, names.PROOF, inputs.size_max)
    if body is None:
        yield f"attachment {names.PROOF} is missing: the admissible verdict has no proof"
        return
    try:
        proof = certificate.Certificate.parse(body)
    except certificate.CertificateError as error:
        yield f"attachment {names.PROOF}: {error}"
        return
    yield from (f"the proof: {reason}" for reason in certificate.recheck(_problem(inputs), proof))


# ---------------------------------------------------------------- approach and retract


def _approach(
    recorded: records.Approach, inputs: _Inputs, found: _Findings, *, comparable: bool, words: bool
) -> Iterator[str]:
    """Approach and retract again, from the recorded start joints and the site's settings; ``words``: the reasons as well."""
    settings = inputs.site
    try:
        start = Start.of(
            recorded.start_joints_u,
            clearance_um=round(settings.approach.approach_clearance_mm * 1000),
            tolerance_mm=settings.start.start_tolerance_mm,
            tolerance_deg=settings.start.start_tolerance_deg,
        )
        verdict = decision.verify(_problem(inputs), start)
    except (IndexError, ValueError) as error:
        raise ReplayError(f"the approach's start joints cannot be read: {error}") from None
    document = report.document(verdict, start)
    found.approaches.append(document["verdict"])
    theirs = _document(recorded)
    if theirs is None:
        yield "approach: the recorded document is not a JSON object"
        return
    if not words:  # another version may say the same in other sentences
        theirs, document = (
            {key: value for key, value in one.items() if key != "reasons"} for one in (theirs, document)
        )
    yield from _documents("approach", theirs, document, comparable=comparable)
    again = records.Approach.of(
        document,
        start_joints_u=recorded.start_joints_u,
        bound=report.bound(verdict, settings.approach.approach_speed_percent),
        reason=report.summary(verdict),
    )
    last_bits = set() if words else {"reason"}
    last_bits |= set() if comparable else {"worst_leg", "worst_boundary", "reason"}
    fields = records.Approach.model_fields.keys() - records.AuditRecord.model_fields.keys()
    for name in sorted(fields - {"document"}):
        one, other = getattr(recorded, name), getattr(again, name)
        same = _same(one, other, absolute=True) if name == "worst_certified" else one == other
        if not same and name not in last_bits:
            if name.endswith("_joints_u"):
                one, other = _joints(one), _joints(other)
            yield f"approach {name}: recorded {one}, recomputed {other}"


S = TypeVar("S", wire.Permit, wire.Start)


def _signed(kind: type[S], record: records.Permit) -> S:
    """What was signed, as it stands in the record.

    Raises:
        ValueError: it cannot be read.
    """
    signed = bytes.fromhex(record.record or "")
    return kind.parse(signed.removeprefix(kind.DOMAIN + b"\0") + wire.NO_MAC)


def _bound(left: wire.Permit, way: records.Approach) -> Iterator[str]:
    """The permit's start joints and approach are those that were verified."""
    bound = left.approach
    pairs = {
        "start joints": (_joints(left.start_joints_u), _joints(way.start_joints_u)),
        "entry": (_end(bound.entry_um, bound.entry_joints_u), _end(way.entry_um, way.entry_joints_u)),
        "exit": (_end(bound.exit_um, bound.exit_joints_u), _end(way.exit_um, way.exit_joints_u)),
        "approach speed": (f"{bound.speed_percent} %", f"{way.speed_percent} %"),
    }
    for name, (one, other) in pairs.items():
        if one != other:
            yield f"the permit's {name} are not the verified: {one}, verified {other}"


def _joints(counts: Sequence[int]) -> str:
    """Joints as people read them."""
    return ", ".join(
        f"q{joint} {_decimal(count, 6)} {'mm' if joint == 2 else 'deg'}" for joint, count in enumerate(counts)
    )


def _end(distance_um: int, counts: Sequence[int]) -> str:
    """Entry or exit likewise."""
    return f"{_decimal(distance_um, 3)} mm along the tool, at {_joints(counts) or 'no joints'}"


def _decimal(count: int, digits: int) -> str:
    """Counts of a power of ten as a number with so many decimals; exact, however large what a log says is."""
    whole, part = divmod(abs(count), 10**digits)
    return f"{'-' if count < 0 else ''}{whole}.{part:0{digits}d}"


def _digests(permit: records.Permit, left: wire.Permit, configuration: bytes) -> Iterator[str]:
    """What was signed is what the record says, and was decided with the files that are attached."""
    for name in ("path", "limits", "calibration", "tool", "registration", "configuration"):
        if getattr(permit, f"{name}_sha256") != getattr(left, f"{name}_digest").hex():
            yield f"the permit's {name} digest is not the one that was signed"
    if left.configuration_digest != configuration:
        yield (
            f"the permit's configuration is not that of {names.ROBOT}, {names.SITE} and the options as they are attached"
        )


# ---------------------------------------------------------------- what was enabled


def _permits(
    log: Log, opened: records.Open, recomputed: list[dict[str, Any]], ways: list[str]
) -> Iterator[str]:
    """Nothing that left may lack its admissible verdict, its authorisation or a permissive."""
    verdicts, approaches = iter(recomputed), iter(ways)
    ledger = _Ledger(_configuration(log, opened))
    kinds = (records.Verdict, records.Approach, records.Decision, records.Operator, records.Permit)
    for topic, data in log.each(*(kind.TOPIC for kind in kinds)):
        if topic == records.Verdict.TOPIC:
            document = next(verdicts)
            ledger.verdict = (_model(records.Verdict, data), document["verdict"])
            ledger.approach, ledger.confirmed = None, set()
            ledger.to_confirm = {one["code"] for one in document.get("warnings", ()) if one["confirm"]}
        elif topic == records.Approach.TOPIC:
            ledger.approach = (_model(records.Approach, data), next(approaches, "not computed again"))
        elif topic == records.Decision.TOPIC:
            yield from _decision(_model(records.Decision, data))
        elif topic == records.Operator.TOPIC:
            ledger.hear(_model(records.Operator, data))
        elif topic == records.Permit.TOPIC:
            yield from ledger.enter(_model(records.Permit, data))
    if any(kind != "reset" for kind, _ in ledger.authorised):
        yield from _approved(log)


@dataclass
class _Ledger:
    """What has been proved, authorised and acknowledged up to a record."""

    configuration: bytes
    """The digest of the files and options that are attached."""
    verdict: tuple[records.Verdict, str] | None = None
    """The latest recorded verdict, and the word that was recomputed for it."""
    approach: tuple[records.Approach, str] | None = None
    """The same for the approach recorded after it."""
    authorised: set[tuple[str, int | None]] = field(default_factory=set)
    permit: bytes | None = None
    """Digest of the permit that left last, which a start names."""
    permitted: bool = False
    to_confirm: set[str] = field(default_factory=set)
    """Warnings of the latest verdict, as recomputed, that keep from a permit."""
    confirmed: set[str] = field(default_factory=set)
    """What the operator has confirmed since."""

    def hear(self, said: records.Operator) -> None:
        """One word of the operator."""
        if said.word == "confirm" and said.accepted and said.what is not None:
            self.confirmed.add(said.what)

    def enter(self, permit: records.Permit) -> Iterator[str]:
        """One record of a permit, start or reset."""
        if permit.stage == "authorised":
            self.authorised.add((permit.kind, permit.token))
        elif permit.stage == "acknowledged":
            self.permitted |= permit.kind == "permit"
        elif permit.stage == "sent":
            yield from self._sent(permit)

    def _sent(self, permit: records.Permit) -> Iterator[str]:
        if (permit.kind, permit.token) not in self.authorised:
            yield f"a {permit.kind} left without a record that authorised it"
        if permit.kind != "reset":
            yield from _enabled(permit, self.verdict)
            yield from _enabled_approach(permit, self.approach)
        try:
            if permit.kind == "permit":
                yield from self._permit(permit, _signed(wire.Permit, permit))
            elif permit.kind == "start":
                yield from self._start(_signed(wire.Start, permit))
        except ValueError as error:
            yield f"the {permit.kind}'s record cannot be read: {error}"

    def _permit(self, permit: records.Permit, left: wire.Permit) -> Iterator[str]:
        self.permit = left.digest
        for code in sorted(self.to_confirm - self.confirmed):
            yield f"a permit left although the warning {code} was not confirmed"
        if self.verdict is not None and left.verifier_version != self.verdict[0].verifier:
            yield f"the permit names the verifier {left.verifier_version}, its verdict {self.verdict[0].verifier}"
        yield from _digests(permit, left, self.configuration)
        if self.approach is not None:
            yield from _bound(left, self.approach[0])

    def _start(self, left: wire.Start) -> Iterator[str]:
        if not self.permitted:
            yield "a start left without an acknowledged permit"
        if left.permit_digest != self.permit:
            yield "a start left for another permit than the one that had left"


def _configuration(log: Log, opened: records.Open) -> bytes:
    """The configuration's digest by the files that are attached and the options of record 0."""
    robot, site = log.scan.attachment(names.ROBOT), log.scan.attachment(names.SITE)
    allowed = allowed_by_option((option.name, option.value) for option in opened.simulation)
    found = [bytes.fromhex(entry.sha256) if entry else None for entry in (robot, site)]
    return configuration_digest(found[0] or bytes(32), found[1], allow_simulated=allowed)


def _decision(decision: records.Decision) -> Iterator[str]:
    if decision.disposition == "sent":
        for permissive in decision.permissives:
            if not permissive.holds:
                yield f"decision {decision.sequence} sent although this did not hold: {permissive.name}"
    if decision.from_state in MOVING and decision.event in WATCHED and decision.to_state not in STOPPING:
        for rule in decision.permissives:
            if not rule.holds:
                yield f"decision {decision.sequence} let the arm go on although this did not hold: {rule.name}"


def _enabled(permit: records.Permit, current: tuple[records.Verdict, str] | None) -> Iterator[str]:
    if current is None:
        yield f"a {permit.kind} left without a verdict"
        return
    verdict, recomputed = current
    if not (verdict.verdict == "admissible" and recomputed == "admissible"):
        yield (
            f"a {permit.kind} left; the verdict is recorded as {verdict.verdict} and recomputed as {recomputed}"
        )
    if permit.kind == "permit":
        for name in ("path", "limits", "calibration", "tool", "registration"):
            if getattr(permit, f"{name}_sha256") != getattr(verdict, f"{name}_sha256"):
                yield f"the permit's {name} digest is not the verdict's"


def _enabled_approach(permit: records.Permit, current: tuple[records.Approach, str] | None) -> Iterator[str]:
    if current is None:
        yield f"a {permit.kind} left without a verified approach"
        return
    way, recomputed = current
    if not (way.verdict == "admissible" and recomputed == "admissible"):
        yield f"a {permit.kind} left; the approach is recorded as {way.verdict} and recomputed as {recomputed}"


def _approved(log: Log) -> Iterator[str]:
    """What the controller reported must equal what robot.toml approves, if anything was authorised on it."""
    inputs = _inputs(log)
    approved = {
        names.LIMITS: limits_record(inputs.robot).body(),
        names.CALIBRATION: calibration_record(inputs.robot).body(),
        names.TOOL: tool_record(inputs.robot).body(),
    }
    for name, body in approved.items():
        if _attachment(log, name, inputs.size_max) != body:
            yield f"attachment {name} is not what {names.ROBOT} approves"


# ---------------------------------------------------------------- reading


def _typed(log: Log, model: type[R]) -> list[R]:
    return [_model(model, data) for _, data in log.each(model.TOPIC)]


def _model(model: type[R], data: bytes) -> R:
    try:
        return model.model_validate_json(data)
    except ValidationError as error:
        what = error.errors(include_url=False)[0]
        place = ".".join(map(str, what["loc"]))
        raise ReplayError(f"a record of {model.TOPIC} cannot be read: {place}: {what['msg']}") from None


def _attachment(log: Log, name: str, size_max: int) -> bytes | None:
    """The attachment's bytes, or None where there is none of this name."""
    entry = log.scan.attachment(name)
    return None if entry is None else _bytes_of(entry, size_max)


def _by_stem(log: Log, stem: str, size_max: int) -> tuple[FilePath, bytes] | None:
    """The attachment of this name whatever its ending, with its name."""
    for entry in log.scan.attachments:
        if FilePath(entry.name).stem == stem:
            return FilePath(entry.name), _bytes_of(entry, size_max)
    return None


def _bytes_of(entry: StoredAttachment, size_max: int) -> bytes:
    if not entry.size <= size_max:
        raise ReplayError(
            f"attachment {entry.name} has {entry.size} bytes, the site reads files of at most {size_max}"
        )
    return entry.data
