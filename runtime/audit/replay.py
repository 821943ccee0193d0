"""Deciding again from the log alone: same path, same limits, same verdict, and nothing enabled without it.

The attachments are the bytes that the session decided on. The path is made again from plan, registration and
robot; the verdict is computed again from the recorded path and parameters; and every permit and start that left
is held against that verdict. A log in which a verdict was changed and the whole chain computed anew differs here.

    with reading(path) as log:
        result = replay(log, certified.verify, verifier=VERIFIER)
    result.outcome is Outcome.IDENTICAL
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np

from cutgate.runtime.audit import names, records
from cutgate.runtime.audit.configuration import allowed_by_option, configuration_digest
from cutgate.runtime.audit.inspect import Log, Status
from cutgate.runtime.audit.log import cpu_dispatch
from cutgate.runtime.audit.recomputed.approach import approach_differences, recomputed_approach
from cutgate.runtime.audit.recomputed.enabled import Ledger, decision_differences
from cutgate.runtime.audit.recomputed.inputs import (
    ReplayError,
    approved,
    attachment,
    derivation,
    inputs_of,
    model_of,
    typed,
)
from cutgate.runtime.audit.recomputed.steps import Steps
from cutgate.runtime.audit.recomputed.transitions import transitions, transitions_sha256
from cutgate.runtime.audit.recomputed.verdict import (
    Verify,
    boundary_differences,
    expected_boundaries,
    proof_differences,
    recomputed_verdict,
    verdict_differences,
)


class ReplayOutcome(IntEnum):
    """What a replay shows; its number is the exit code."""

    IDENTICAL = 0
    DIFFERS = 1
    BAD_INPUT = 2


@dataclass(frozen=True, slots=True)
class Replay:
    """What came of it.

    Attributes:
        outcome: identical, different, or not a log that can be replayed.
        differences: each names what was recorded and what it should have been.
        notes: what was not compared, and why.
        verdict: the recomputed verdict document of the last verdict; None if there was none.
    """

    outcome: ReplayOutcome
    differences: tuple[str, ...]
    notes: tuple[str, ...]
    verdict: dict[str, Any] | None = None


@dataclass
class _Findings:
    differences: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    documents: list[dict[str, Any]] = field(default_factory=list)
    """Recomputed for the verdict records, in their order."""
    approaches: list[str] = field(default_factory=list)
    """The verdicts recomputed for the approach records, in their order."""


def replay(log: Log, verify: Verify, *, verifier: str) -> Replay:
    """Decide again what the log's session decided.

    Args:
        log: the log as read.
        verify: the gate's verifier.
        verifier: its version, as permits name it.
    """
    if log.report.status is Status.UNREADABLE:
        return Replay(ReplayOutcome.BAD_INPUT, log.report.reasons, ())
    found = _Findings()
    if log.report.status is not Status.OK:
        text = f"the log itself is {log.report.status.name}: {log.report.reasons[0]}"
        (found.notes if log.report.status is Status.INCOMPLETE else found.differences).append(text)
    try:
        _replay(log, verify, verifier, found)
    except ReplayError as error:
        return Replay(ReplayOutcome.BAD_INPUT, (str(error),), tuple(found.notes))
    outcome = ReplayOutcome.DIFFERS if found.differences else ReplayOutcome.IDENTICAL
    verdict = found.documents[-1] if found.documents else None
    return Replay(outcome, tuple(found.differences), tuple(found.notes), verdict)


def _replay(log: Log, verify: Verify, verifier: str, found: _Findings) -> None:
    opened = typed(log, records.AuditOpen)
    if not opened:
        raise ReplayError("the log has no record 0")
    verdicts = typed(log, records.AuditVerdict)
    if verdicts:
        _decided(log, opened[0], verdicts, verify, verifier, found)
    else:
        found.notes.append("the session ended before a verdict: there is nothing to compute again")
    found.differences += _enabled(log, opened[0], found)
    found.differences += _steps(log, opened[0], found)


def _decided(
    log: Log,
    opened: records.AuditOpen,
    verdicts: list[records.AuditVerdict],
    verify: Verify,
    verifier: str,
    found: _Findings,
) -> None:
    """Verdicts, proof and approaches again."""
    inputs = inputs_of(log)
    found.differences += derivation(log, inputs, opened)
    comparable = _comparable(opened, verifier, found)
    for verdict in verdicts:
        document = recomputed_verdict(verdict, inputs, verify, opened)
        found.documents.append(document)
        found.differences += verdict_differences(verdict, document, inputs, comparable=comparable)
    boundaries = expected_boundaries(verdicts)
    if boundaries is not None:  # else it is said already, of the verdict
        recorded = typed(log, records.AuditBoundary)
        found.differences += boundary_differences(recorded, boundaries, finished=log.scan.finished)
    if verdicts[-1].verdict == "admissible":
        found.differences += proof_differences(attachment(log, names.PROOF, inputs.size_max), inputs)
    for approach in typed(log, records.AuditApproach):
        again = recomputed_approach(approach, inputs)
        found.approaches.append(again.verdict)
        found.differences += approach_differences(
            approach, again, comparable=comparable, sentences=opened.verifier == verifier
        )
    if any(document["verdict"] == "inadmissible" for document in found.documents):
        found.notes.append("the guidance was not computed again, nor the other elbow")


def _comparable(opened: records.AuditOpen, verifier: str, found: _Findings) -> bool:
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


def _enabled(log: Log, opened: records.AuditOpen, found: _Findings) -> Iterator[str]:
    """Nothing that left may lack its admissible verdict, its authorisation or a permissive."""
    documents, approaches = iter(found.documents), iter(found.approaches)
    ledger = Ledger(_configuration(log, opened))
    kinds = (
        records.AuditVerdict,
        records.AuditApproach,
        records.AuditDecision,
        records.AuditOperator,
        records.AuditPermit,
    )
    for topic, data in log.each(*(kind.TOPIC for kind in kinds)):
        if topic == records.AuditVerdict.TOPIC:
            ledger.verdict(model_of(records.AuditVerdict, data), next(documents))
        elif topic == records.AuditApproach.TOPIC:
            ledger.approach(model_of(records.AuditApproach, data), next(approaches, "not computed again"))
        elif topic == records.AuditDecision.TOPIC:
            yield from decision_differences(model_of(records.AuditDecision, data))
        elif topic == records.AuditOperator.TOPIC:
            ledger.operator(model_of(records.AuditOperator, data))
        else:
            yield from ledger.permit(model_of(records.AuditPermit, data))
    if ledger.enabling:
        yield from approved(log, inputs_of(log))


def _steps(log: Log, opened: records.AuditOpen, found: _Findings) -> Iterator[str]:
    """Every recorded step is a transition of the tables, by the tables as they were frozen."""
    if opened.transitions_sha256 != transitions_sha256():
        which = "names none" if opened.transitions_sha256 is None else "names those of another version"
        found.notes.append(f"the steps were not held against the tables of transitions: record 0 {which}")
        return
    steps = Steps(transitions())
    heard: dict[str, Callable[[bytes], Iterator[str]]] = {
        records.AuditSession.TOPIC: steps.opened,
        records.AuditController.TOPIC: lambda data: steps.controller(model_of(records.AuditController, data)),
        records.AuditFault.TOPIC: lambda data: steps.fault(model_of(records.AuditFault, data)),
        records.AuditPermit.TOPIC: lambda data: steps.permit(model_of(records.AuditPermit, data)),
        records.AuditOperator.TOPIC: lambda data: steps.operator(model_of(records.AuditOperator, data)),
        records.AuditDecision.TOPIC: lambda data: steps.decision(model_of(records.AuditDecision, data)),
        records.AuditClose.TOPIC: lambda data: steps.closed(model_of(records.AuditClose, data)),
    }
    for topic, data in log.each(*heard):
        yield from heard[topic](data)


def _configuration(log: Log, opened: records.AuditOpen) -> bytes:
    """The configuration's digest by the files that are attached and the options of record 0."""
    robot, site = log.scan.attachment(names.ROBOT), log.scan.attachment(names.SITE)
    allowed = allowed_by_option((option.name, option.value) for option in opened.simulation)
    found = [bytes.fromhex(entry.sha256) if entry else None for entry in (robot, site)]
    return configuration_digest(found[0] or bytes(32), found[1], allow_simulated=allowed)
