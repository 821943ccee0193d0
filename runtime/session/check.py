"""What this side proves itself, so that nothing the verification process says has to be believed.

The controller's limits, calibration and tool must equal the approved ones, or the session is refused; so what will have
to be proved is known before it opens, but for where the arm stands. Hence the search for the verdict, the proof of the
cut and its check, the straight lines at entry and exit and the reference trajectory between them are done before (`Check`). In the session
remain the two joint lines, which cost the same whatever the path is: they are taken step by step (`steps`), each well
under a millisecond, between the cycle of the loop.

The verification process must say the same (`disagreement`): it can refuse, and it cannot permit.
"""

import time
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, NamedTuple

from cutgate.config.model import Robot
from cutgate.protocol import records
from cutgate.runtime.interlock.state import Collected, CutVerdict, Job
from cutgate.runtime.session import reference
from cutgate.runtime.session.messages import Bound, Claim, Request
from cutgate.runtime.verification import certificate, certified
from cutgate.runtime.verification import verdict as verdicts
from cutgate.runtime.verification.advice import Guidance
from cutgate.runtime.verification.approach import decision, report
from cutgate.runtime.verification.approach.model import ApproachVerdict, StartJoints, StraightLines
from cutgate.runtime.verification.approach.straight_line import straight_lines
from cutgate.runtime.verification.placing.other_elbow import other_elbow
from cutgate.runtime.verification.plausibility import Caution, Placed, cautions, cautions_of_move, described
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.recorded import problem_from_records
from cutgate.runtime.verification.report.document import Digests, guidance_entries, verdict_document
from cutgate.runtime.verification.report.summary import summary
from cutgate.runtime.verification.steps import Steps

ANSWER: Final = {True: "ADMISSIBLE", False: "INADMISSIBLE"}


@dataclass(frozen=True)
class Answer:
    """The verdict for the interlock; what was proved, for people; and documents and proof, for the log.

    ``approach``, its document and ``proof`` (a certificate's bytes) are None where the cut itself is not admissible.
    """

    verdict: CutVerdict
    proved: verdicts.Verdict
    document: dict[str, Any]
    approach: ApproachVerdict | None
    approach_document: dict[str, Any] | None
    proof: bytes | None
    cautions: tuple[Caution, ...] = ()
    """What looks wrong with the files."""
    guidance: Guidance | None = None
    """How to move the bone, once the verification process has said so: for people, it decides nothing."""


class _Ground(NamedTuple):
    """What is known before the session opens. ``lines`` and ``between`` are None as `Answer.approach` is."""

    proved: verdicts.Verdict
    cautions: tuple[Caution, ...]
    document: dict[str, Any]
    proof: bytes | None
    lines: StraightLines | ApproachVerdict | None
    between: reference.Between | None


class Check:
    """This side's own verification of a job.

    Args:
        job: what the session is about.
        robot: deadbands and wrist; everything else is in the job.
        placed: how the bone was registered, for what may look wrong with it.
    """

    def __init__(self, job: Job, robot: Robot, placed: Placed | None = None) -> None:
        self._job = job
        self._robot = robot
        self._ground: _Ground | ValueError
        try:
            self._ground = _ground(job, robot, placed)
        except ValueError as error:  # said, and recorded, when the session comes to it
            self._ground = error

    def request(self, number: int, start_joints_u: tuple[int, ...], held: Collected) -> Request:
        """What the verification process is asked: the same, of the bytes that the controller holds."""
        timing = self._job.timing
        assert held.limits is not None and held.calibration is not None and held.tool is not None  # noqa: S101, PT018
        return Request(
            number=number,
            path=self._job.path,
            limits=held.limits,
            calibration=held.calibration,
            tool=held.tool,
            robot=self._robot,
            start_joints_u=start_joints_u,
            clearance_um=timing.approach_clearance_um,
            start_tolerance_mm=timing.start_tolerance_mm,
            start_tolerance_deg=timing.start_tolerance_deg,
            speed_percent=timing.approach_speed_percent,
        )

    def steps(self, request: int, start_joints_u: tuple[int, ...]) -> Steps[Answer]:
        """The rest, once it is known where the arm stands.

        Raises:
            ValueError: there is no verdict, and why.
        """
        if isinstance(self._ground, ValueError):
            raise self._ground
        return (yield from _steps(self._job, self._ground, request, start_joints_u))


def _ground(job: Job, robot: Robot, placed: Placed | None) -> _Ground:
    """Verify the cut and prove it, and all of approach and retract that does not depend on where the arm stands.

    Raises:
        ValueError: the records pose no problem, an admissible verdict has no proof that holds, or the verified path
            cannot be followed.
    """
    problem = problem_from_records(job.path, job.limits, job.calibration, job.tool, robot)
    began_s = time.perf_counter()
    verdict = certified.verify(problem)
    elapsed_ms = (time.perf_counter() - began_s) * 1000.0
    document = verdict_document(
        verdict,
        poses=len(problem.tips_mm),
        guidance=None,
        digests=Digests(
            job.path_digest, records.digest(job.limits), records.digest(job.calibration), job.registration
        ),
        elapsed_ms=elapsed_ms,
        other_elbow=other_elbow(problem, verdict),
    )
    found = cautions(problem, verdict, placed)
    document = described(document, problem, verdict, found, placed)
    if not verdict.admissible:
        return _Ground(verdict, found, document, None, None, None)
    proof = checked_proof(problem, verdict)
    lines = straight_lines(problem, job.timing.approach_clearance_um)
    bound = report.bound(lines, job.timing.approach_speed_percent)
    return _Ground(
        verdict, found, document, proof, lines, reference.between(problem, bound) if bound else None
    )


def checked_proof(problem: Problem, verdict: verdicts.Verdict) -> bytes:
    """The proof of an admissible verdict, as the log will hold it, checked before anything is permitted on it.

    Raises:
        ValueError: there is none, or it does not hold; then there is no verdict either.
    """
    proof = certificate.certify(problem, verdict)
    if proof is None:
        raise ValueError("the admissible verdict has no proof")
    body = proof.body()
    reasons = certificate.recheck(problem, certificate.Certificate.parse(body))
    if reasons:
        raise ValueError(f"the proof of the admissible verdict does not hold: {'; '.join(reasons)}")
    return body


def _steps(job: Job, ground: _Ground, request: int, start_joints_u: tuple[int, ...]) -> Steps[Answer]:
    way, way_document, bound, trajectory = None, None, None, None
    if ground.lines is not None:
        timing = job.timing
        start = StartJoints.of(
            start_joints_u,
            clearance_um=timing.approach_clearance_um,
            tolerance_mm=timing.start_tolerance_mm,
            tolerance_deg=timing.start_tolerance_deg,
        )
        way = yield from decision.joint_lines(ground.lines, start)
        way_document = report.document(way, start)
        bound = report.bound(way, job.timing.approach_speed_percent)
    if bound is not None:
        assert ground.between is not None  # noqa: S101 - its straight lines are admissible
        trajectory = yield from reference.from_start(ground.between, start_joints_u)
    verdict = CutVerdict(
        request=request,
        admissible=ground.proved.admissible,
        path=job.path_digest,
        limits=records.digest(job.limits),
        calibration=records.digest(job.calibration),
        tool=records.digest(job.tool),
        start_joints_u=start_joints_u,
        reason=summary(ground.proved),
        approach=bound,
        approach_reason=report.summary(way) if way else "not verified: the cut is not admissible",
        trajectory=trajectory,
        to_confirm=tuple(caution.code for caution in ground.cautions if caution.confirm),
    )
    return Answer(
        verdict, ground.proved, ground.document, way, way_document, ground.proof, cautions=ground.cautions
    )


def with_guidance(answer: Answer, found: Guidance | None, note: str) -> Answer:
    """The answer with what was found where to move the bone; else with a note why there is nothing."""
    large = tuple(asdict(caution) for caution in cautions_of_move(found))
    told = {**guidance_entries(found, note), "warnings": [*answer.document["warnings"], *large]}
    return replace(answer, guidance=found, document={**answer.document, **told})


def disagreement(claim: Claim, own: CutVerdict) -> str:
    """What the verification process said otherwise than this side has found; empty where it said the same."""
    for name in ("path", "limits", "calibration", "tool"):
        if getattr(claim, name) != getattr(own, name).hex():
            return f"the verification process answered for another {name}"
    if (claim.request, claim.start_joints_u) != (own.request, own.start_joints_u):
        return "the verification process answered another request"
    if claim.admissible is not own.admissible:
        return _otherwise("", claim.admissible, own.admissible, own.reason)
    bound = Bound.of(own.approach)
    if (claim.approach is None) is not (bound is None):
        return _otherwise(" of approach and retract", bound is None, bound is not None, own.approach_reason)
    if claim.approach != bound:
        return "the verification process said another entry, exit or speed than this side has verified"
    return ""


def _otherwise(of_what: str, claimed: bool, found: bool, reason: str) -> str:
    return (
        f"the verification process said {ANSWER[claimed]}{of_what}, "
        f"this side's own check says {ANSWER[found]}: {reason}"
    )
