"""Approach and retract again, from the recorded start joints and the site's settings."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from cutgate.protocol import records as wire
from cutgate.runtime.audit import records
from cutgate.runtime.audit.recomputed.comparison import differences, document_of, same
from cutgate.runtime.audit.recomputed.inputs import ReplayError, ReplayInputs
from cutgate.runtime.verification.approach import decision, report
from cutgate.runtime.verification.approach.model import StartJoints


class Recomputed(NamedTuple):
    """An approach as it must be: its document, and what a permit binds of it."""

    document: dict[str, Any]
    bound: wire.Approach | None
    reason: str

    @property
    def verdict(self) -> str:
        """Admissible or inadmissible."""
        return str(self.document["verdict"])


def recomputed_approach(recorded: records.AuditApproach, inputs: ReplayInputs) -> Recomputed:
    """The approach from the recorded start joints.

    Raises:
        ReplayError: they are none, or the inputs pose no problem.
    """
    settings = inputs.site
    try:
        start = StartJoints.of(
            recorded.start_joints_u,
            clearance_um=round(settings.approach.approach_clearance_mm * 1000),
            tolerance_mm=settings.start.start_tolerance_mm,
            tolerance_deg=settings.start.start_tolerance_deg,
        )
        verdict = decision.verify(inputs.problem, start)
    except (IndexError, ValueError) as error:
        raise ReplayError(f"the approach's start joints cannot be read: {error}") from None
    return Recomputed(
        document=report.document(verdict, start),
        bound=report.bound(verdict, settings.approach.approach_speed_percent),
        reason=report.summary(verdict),
    )


def approach_differences(
    recorded: records.AuditApproach, again: Recomputed, *, comparable: bool, sentences: bool
) -> Iterator[str]:
    """The recorded approach, as document and as flat fields, against the recomputed one.

    Args:
        recorded: as it stands in the log.
        again: as it must be.
        comparable: last bits are compared.
        sentences: the reasons are compared, too; another version may say the same in other sentences.
    """
    document, recomputed = document_of(recorded), again.document
    if document is None:
        yield "approach: the recorded document is not a JSON object"
        return
    if not sentences:
        document, recomputed = (
            {key: value for key, value in one.items() if key != "reasons"} for one in (document, recomputed)
        )
    yield from differences("approach", document, recomputed, comparable=comparable)
    flat = records.AuditApproach.of(
        recomputed, start_joints_u=recorded.start_joints_u, bound=again.bound, reason=again.reason
    )
    ignored = set() if sentences else {"reason"}
    ignored |= set() if comparable else {"worst_leg", "worst_boundary", "reason"}
    fields = records.AuditApproach.model_fields.keys() - records.AuditRecord.model_fields.keys()
    for name in sorted(fields - {"document"} - ignored):
        one, other = getattr(recorded, name), getattr(flat, name)
        if not (same(one, other, absolute=True) if name == "worst_certified" else one == other):
            if name.endswith("_joints_u"):
                one, other = joints_text(one), joints_text(other)
            yield f"approach {name}: recorded {one}, recomputed {other}"


def bound_differences(permit: wire.Permit, verified: records.AuditApproach) -> Iterator[str]:
    """The permit's start joints and approach are those that were verified."""
    bound = permit.approach
    pairs = {
        "start joints": (joints_text(permit.start_joints_u), joints_text(verified.start_joints_u)),
        "entry": (
            _pose_text(bound.entry_um, bound.entry_joints_u),
            _pose_text(verified.entry_um, verified.entry_joints_u),
        ),
        "exit": (
            _pose_text(bound.exit_um, bound.exit_joints_u),
            _pose_text(verified.exit_um, verified.exit_joints_u),
        ),
        "approach speed": (f"{bound.speed_percent} %", f"{verified.speed_percent} %"),
    }
    for name, (one, other) in pairs.items():
        if one != other:
            yield f"the permit's {name} are not the verified: {one}, verified {other}"


def joints_text(counts: Sequence[int]) -> str:
    """Joints, 1e-6 deg | mm, as people read them."""
    return ", ".join(
        f"q{joint} {_decimal(count, 6)} {'mm' if joint == 2 else 'deg'}" for joint, count in enumerate(counts)
    )


def _pose_text(distance_um: int, counts: Sequence[int]) -> str:
    """Entry or exit pose likewise."""
    return f"{_decimal(distance_um, 3)} mm along the tool, at {joints_text(counts) or 'no joints'}"


def _decimal(count: int, digits: int) -> str:
    """Counts of a power of ten as a number with so many decimals; exact, however large what a log says is."""
    whole, part = divmod(abs(count), 10**digits)
    return f"{'-' if count < 0 else ''}{whole}.{part:0{digits}d}"
