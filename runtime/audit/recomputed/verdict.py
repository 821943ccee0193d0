"""The verdict again, from the recorded path and parameters; and the proof of an admissible one."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from hashlib import sha256
from typing import Any, Final

from cutgate.runtime.audit import names, records
from cutgate.runtime.audit.recomputed.comparison import differences, document_of
from cutgate.runtime.audit.recomputed.inputs import ReplayInputs, no_problem
from cutgate.runtime.verification import certificate
from cutgate.runtime.verification.plausibility import cautions, described
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.report.document import Digests, verdict_document
from cutgate.runtime.verification.verdict import Verdict

BEFORE_WARNINGS: Final = ("cutgate 0.1.0",)
"""Verifiers that did not say where a cut lies and what looks wrong."""

Verify = Callable[[Problem], Verdict]


def recomputed_verdict(
    recorded: records.AuditVerdict, inputs: ReplayInputs, verify: Verify, opened: records.AuditOpen
) -> dict[str, Any]:
    """The verdict's document as it must be.

    Raises:
        ReplayError: the inputs pose no problem.
    """
    problem = inputs.problem
    try:
        verdict = verify(problem)
    except ValueError as error:
        raise no_problem(error) from None
    digests = Digests(
        path=sha256(inputs.path).digest(),
        limits=sha256(inputs.limits).digest(),
        calibration=sha256(inputs.calibration).digest(),
        registration=inputs.registration_digest,
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
    return described(document, problem, verdict, cautions(problem, verdict, inputs.placed), inputs.placed)


def verdict_differences(
    recorded: records.AuditVerdict, recomputed: dict[str, Any], inputs: ReplayInputs, *, comparable: bool
) -> Iterator[str]:
    """The recorded verdict, as document and as flat fields, against the recomputed document."""
    document = document_of(recorded)
    if document is None:
        yield "verdict: the recorded document is not a JSON object"
        return
    yield from differences("verdict", document, recomputed, comparable=comparable)
    yield from _flat_fields(recorded, document, inputs)


def _flat_fields(
    recorded: records.AuditVerdict, document: dict[str, Any], inputs: ReplayInputs
) -> Iterator[str]:
    """The record's flat fields must say what its document says."""
    try:
        again = records.AuditVerdict.of(
            document,
            verifier=recorded.verifier,
            tool_sha256=sha256(inputs.tool).hexdigest(),
            reason=recorded.reason or "",
        )
    except (KeyError, TypeError, AttributeError, ValueError, ArithmeticError, RecursionError):
        yield "verdict: the recorded document is not a verdict document"
        return
    fields = records.AuditVerdict.model_fields.keys() - records.AuditRecord.model_fields.keys()
    for name in sorted(fields - {"document"}):
        if getattr(recorded, name) != getattr(again, name):
            yield f"verdict {name}: recorded {getattr(recorded, name)}, its document says {getattr(again, name)}"


def expected_boundaries(verdicts: Sequence[records.AuditVerdict]) -> list[records.AuditBoundary] | None:
    """The boundaries of the recorded documents, in their order; None where one is no verdict document."""
    with suppress(KeyError, TypeError, AttributeError, ValueError, ArithmeticError):
        return [
            one
            for verdict in verdicts
            for one in records.boundaries_of(document_of(verdict))  # type: ignore[arg-type]  # None has none
        ]
    return None


def boundary_differences(
    found: Sequence[records.AuditBoundary], expected: Sequence[records.AuditBoundary], *, finished: bool
) -> Iterator[str]:
    """The boundary records are those that are expected, in their order; in a ``finished`` file all of them."""
    if len(found) > len(expected) or (finished and len(found) < len(expected)):
        yield f"boundaries: {len(found)} recorded, the documents have {len(expected)}"
    ignored = set(records.AuditRecord.model_fields)
    for number, one in enumerate(found[: len(expected)]):
        if one.model_dump(exclude=ignored) != expected[number].model_dump(exclude=ignored):
            yield f"boundary {one.name}: the record is not what the verdict's document says"


def proof_differences(body: bytes | None, inputs: ReplayInputs) -> Iterator[str]:
    """Why the recorded certificate does not prove the recorded path admissible, checked without a search.

    Raises:
        ReplayError: the inputs pose no problem.
    """
    if body is None:
        yield f"attachment {names.PROOF} is missing: the admissible verdict has no proof"
        return
    try:
        proof = certificate.Certificate.parse(body)
    except certificate.CertificateError as error:
        yield f"attachment {names.PROOF}: {error}"
        return
    yield from (f"the proof: {reason}" for reason in certificate.recheck(inputs.problem, proof))
