"""What the runtime proves itself: the cut before the session, the joint lines in it, and what it makes of a claim."""

import inspect
from dataclasses import FrozenInstanceError, fields, replace

import numpy as np
import pytest

from cutgate.protocol import records
from cutgate.runtime.interlock.state import Collected, CutVerdict
from cutgate.runtime.session import check as checks
from cutgate.runtime.session.check import Check, disagreement, with_guidance
from cutgate.runtime.session.messages import Request
from cutgate.runtime.session.prover import answers
from cutgate.runtime.verification import certificate, certified, plausibility
from cutgate.runtime.verification.advice import Guidance
from cutgate.runtime.verification.approach import curve as curves
from cutgate.runtime.verification.approach import decision
from cutgate.runtime.verification.approach.model import StartJoints
from cutgate.runtime.verification.recorded import problem_from_records
from cutgate.runtime.verification.steps import finished
from tests.runtime.session.pair import (
    ADMISSIBLE_MM,
    INADMISSIBLE_MM,
    STANDS,
    check_of,
    claim_of,
    job_of,
    request_of,
)

LOW = (*STANDS[:2], 52_050_000, *STANDS[3:])
"""The arm stands 2.05 mm above its lower limit."""


def job_and_robot(tmp_path_factory, bone_x_mm=ADMISSIBLE_MM):
    files, job = job_of(tmp_path_factory, bone_x_mm)
    return job, files.robot.value


def own(tmp_path_factory, bone_x_mm=ADMISSIBLE_MM, joints_u=STANDS):
    return finished(check_of(*job_and_robot(tmp_path_factory, bone_x_mm)).steps(5, joints_u))


def problem_of(job, robot):
    return problem_from_records(job.path, job.limits, job.calibration, job.tool, robot)


def test_an_admissible_path_is_verified_for_exactly_the_job(tmp_path_factory):
    job, robot = job_and_robot(tmp_path_factory)
    answer = own(tmp_path_factory)
    verdict = answer.verdict
    assert (verdict.request, verdict.admissible, verdict.start_joints_u) == (5, True, STANDS)
    assert (verdict.path, verdict.limits, verdict.calibration, verdict.tool) == tuple(
        records.digest(data) for data in (job.path, job.limits, job.calibration, job.tool)
    )
    assert (verdict.approach.entry_um, verdict.approach.exit_um) == (10_670, 10_000)
    assert verdict.approach.speed_percent == job.timing.approach_speed_percent == 25
    assert answer.document["verdict"] == answer.approach_document["verdict"] == "admissible"
    assert answer.document["guidance"] is None
    assert certificate.recheck(problem_of(job, robot), certificate.Certificate.parse(answer.proof)) == ()
    assert verdict.trajectory.segments == len(records.Path.parse(job.path)) - 1


def test_what_was_found_cannot_be_changed(tmp_path_factory):
    with pytest.raises(FrozenInstanceError):
        own(tmp_path_factory).verdict = None


def test_the_time_the_search_took_is_told_in_milliseconds(tmp_path_factory, monkeypatch):
    times_s = iter((100.0, 100.25))
    monkeypatch.setattr(checks.time, "perf_counter", lambda: next(times_s))
    answer = finished(Check(*job_and_robot(tmp_path_factory)).steps(5, STANDS))
    assert answer.document["elapsed_ms"] == 250.0


def test_the_verification_process_is_asked_for_what_the_controller_holds_as_the_site_wants_it(
    tmp_path_factory,
):
    job, robot = job_and_robot(tmp_path_factory)
    timing = replace(
        job.timing,
        approach_clearance_um=12_346,
        start_tolerance_um=700,
        start_tolerance_mdeg=300,
        approach_speed_percent=31,
    )
    asked = Check(replace(job, timing=timing), robot).request(8, LOW, Collected(b"these", b"and", b"those"))
    assert asked == Request(8, job.path, b"these", b"and", b"those", robot, LOW, 12_346, 0.7, 0.3, 31)


def test_step_by_step_it_finds_what_is_found_in_one_go(tmp_path_factory):
    job, robot = job_and_robot(tmp_path_factory)
    for joints_u in (STANDS, LOW):
        whole = decision.verify(
            problem_of(job, robot),
            StartJoints.of(joints_u, clearance_um=10_000, tolerance_mm=0.5, tolerance_deg=0.2),
        )
        answer = own(tmp_path_factory, joints_u=joints_u)
        assert answer.approach.admissible is whole.admissible
        assert answer.approach.reasons == whole.reasons
        for one, other in zip(answer.approach.legs, whole.legs, strict=True):
            assert [b.name for b in one.boundaries.values()] == [b.name for b in other.boundaries.values()]


def test_an_inadmissible_path_says_what_the_other_elbow_would(tmp_path_factory):
    found = own(tmp_path_factory, INADMISSIBLE_MM).document["other_elbow"]
    assert (found["elbow"], found["admissible"]) == ("left", False)
    assert own(tmp_path_factory).document["other_elbow"] is None


def test_an_inadmissible_path_has_neither_proof_nor_approach_nor_trajectory(tmp_path_factory):
    answer = own(tmp_path_factory, INADMISSIBLE_MM)
    verdict = answer.verdict
    assert not verdict.admissible
    assert (verdict.approach, verdict.trajectory) == (None, None)
    assert (answer.approach, answer.approach_document, answer.proof) == (None, None, None)
    assert "not verified" in verdict.approach_reason
    assert "short by" in verdict.reason


def test_an_approach_that_is_not_admissible_binds_nothing_and_has_no_trajectory(tmp_path_factory):
    answer = own(tmp_path_factory, joints_u=LOW)
    assert answer.verdict.admissible
    assert (answer.verdict.approach, answer.verdict.trajectory) == (None, None)
    assert "q2 at 52.050 mm" in answer.verdict.approach_reason
    assert "move q2 by +3.46 mm, to 55.51 mm" in answer.verdict.approach_reason
    assert answer.approach_document["verdict"] == "inadmissible"


def test_an_entry_that_leaves_the_travel_binds_nothing_wherever_the_arm_stands(tmp_path_factory):
    """240 mm beyond the bone the slide has ended."""
    job, robot = job_and_robot(tmp_path_factory)
    far = replace(job, timing=replace(job.timing, approach_clearance_um=240_000))
    answer = finished(Check(far, robot).steps(5, STANDS))
    assert answer.verdict.admissible
    assert (answer.verdict.approach, answer.verdict.trajectory) == (None, None)
    assert "straight line from" in answer.verdict.approach_reason


def test_the_start_tolerance_and_the_clearance_are_the_sites(tmp_path_factory):
    job, robot = job_and_robot(tmp_path_factory)
    timing = replace(job.timing, start_tolerance_um=1500, approach_clearance_um=20_000)
    answer = finished(Check(replace(job, timing=timing), robot).steps(5, STANDS))
    assert answer.approach.legs[0].boundaries["bottom"].deadband == 6.5
    assert (answer.approach.entry_um, answer.approach.exit_um) == (20_670, 20_000)


# ---------------------------------------------------------------- nothing is believed that does not hold


def forged(proof):
    """Bytes of a certificate that states more than is true."""
    bounds = {name: bound + 1.0 if name == "outer" else bound for name, bound in proof.bounds.items()}
    return replace(proof, bounds=bounds)


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        (lambda _problem, _verdict, _proof: None, "the admissible verdict has no proof"),
        (lambda _problem, _verdict, proof: forged(proof), "outer: .* is stated, .* is proven"),
        (lambda _problem, _verdict, proof: replace(proof, poses=proof.poses + 1), "the certificate is for"),
        (lambda _problem, _verdict, proof: replace(proof, bounds={}), "the certificate states nothing"),
    ],
    ids=["none", "forged", "of another path", "empty"],
)
def test_without_a_proof_that_holds_there_is_no_verdict(tmp_path_factory, monkeypatch, broken, said):
    certify = certificate.certify
    monkeypatch.setattr(
        certificate, "certify", lambda problem, verdict: broken(problem, verdict, certify(problem, verdict))
    )
    check = Check(*job_and_robot(tmp_path_factory))
    with pytest.raises(ValueError, match=said):
        finished(check.steps(5, STANDS))


def test_a_verifier_that_admits_what_is_inadmissible_is_found_by_the_proof(tmp_path_factory, monkeypatch):
    """As a planted module makes it: the verdict of another path."""
    elsewhere = own(tmp_path_factory).proved
    monkeypatch.setattr(certified, "verify", lambda _problem: elsewhere)
    check = Check(*job_and_robot(tmp_path_factory, INADMISSIBLE_MM))
    with pytest.raises(ValueError, match="a bound of the certificate is not finite"):
        finished(check.steps(5, STANDS))


def test_records_that_pose_no_problem_have_no_verdict(tmp_path_factory):
    job, robot = job_and_robot(tmp_path_factory)
    with pytest.raises(records.RecordError):
        finished(Check(replace(job, limits=b"none"), robot).steps(5, STANDS))


def test_a_path_that_cannot_be_followed_has_no_verdict(tmp_path_factory, monkeypatch):
    def bends(*_given):
        raise ValueError("the verified path bends too much to be followed on segment 3")

    monkeypatch.setattr(checks.reference, "_followed", bends)
    with pytest.raises(ValueError, match="bends too much"):
        finished(Check(*job_and_robot(tmp_path_factory)).steps(5, STANDS))


# ---------------------------------------------------------------- step by step


def test_nothing_of_the_path_is_looked_at_in_the_steps(tmp_path_factory, monkeypatch):
    """Neither verified nor proved nor followed: in the session only the joint lines are."""
    check = Check(*job_and_robot(tmp_path_factory))
    for module, name in (
        (certified, "verify"),
        (certificate, "recheck"),
        (certificate, "certify"),
        (records.Path, "parse"),
        (checks.reference, "between"),
        (checks, "straight_lines"),
    ):
        monkeypatch.setattr(module, name, lambda *_given, **_options: 1 / 0)
    assert finished(check.steps(5, STANDS)).verdict.approach is not None


def test_no_step_looks_at_more_than_a_block(tmp_path_factory, monkeypatch):
    """Also where nothing is ever decided: the work of a step is bounded, and so is their number."""
    monkeypatch.setattr(curves, "GAP_MM", -1e9)  # every interval wants to be halved
    monkeypatch.setattr(curves, "BUDGET", 20_000)
    sizes, looked = [], curves.looked_at

    def looking(curve, arc, a, b, **options):
        sizes.append(len(a))
        return looked(curve, arc, a, b, **options)

    monkeypatch.setattr(curves, "looked_at", looking)
    steps, before = check_of(*job_and_robot(tmp_path_factory)).steps(5, STANDS), 0
    for _ in steps:
        assert len(sizes) - before <= 1
        before = len(sizes)
    assert max(sizes) == curves.BLOCK
    assert sum(sizes) <= 8 * (2 * 20_000 + 1)


def test_a_trajectory_of_many_knots_is_put_together_in_parts(tmp_path_factory, monkeypatch):
    whole = own(tmp_path_factory).verdict.trajectory
    monkeypatch.setattr(checks.reference, "ROWS", 7)
    parts = own(tmp_path_factory).verdict.trajectory
    assert len(whole.times_s) > 3 * 7
    for name in ("times_s", "joints", "poses_s"):
        assert np.array_equal(getattr(whole, name), getattr(parts, name))
    assert inspect.isgenerator(checks.reference.from_start(None, STANDS))


# ---------------------------------------------------------------- what is made of a claim


@pytest.mark.parametrize("bone_x_mm", [ADMISSIBLE_MM, INADMISSIBLE_MM])
@pytest.mark.parametrize("joints_u", [STANDS, LOW])
def test_an_honest_verification_process_says_what_this_side_finds(tmp_path_factory, bone_x_mm, joints_u):
    asked = replace(request_of(tmp_path_factory, bone_x_mm), start_joints_u=joints_u)
    claim, *_ = answers(asked)
    verdict = own(tmp_path_factory, bone_x_mm, joints_u).verdict
    assert claim == claim_of(verdict)
    assert disagreement(claim, verdict) == ""


OTHER = b"other" + bytes(27)
ANOTHER = {
    "request": ("answered another request", lambda v: v.request + 1),
    "admissible": ("said INADMISSIBLE, this side's own check says ADMISSIBLE", lambda _: False),
    "path": ("answered for another path", lambda _: OTHER),
    "limits": ("answered for another limits", lambda _: OTHER),
    "calibration": ("answered for another calibration", lambda _: OTHER),
    "tool": ("answered for another tool", lambda _: OTHER),
    "start_joints_u": ("answered another request", lambda _: LOW),
    "approach": (
        "said INADMISSIBLE of approach and retract, this side's own check says ADMISSIBLE",
        lambda _: None,
    ),
}
"""A claim with one field altered, and what is said of it."""
NOT_CLAIMED = {"reason", "approach_reason", "trajectory", "to_confirm"}
"""This side's alone."""


def test_every_field_of_a_verdict_is_compared():
    assert {field.name for field in fields(CutVerdict)} == ANOTHER.keys() | NOT_CLAIMED


@pytest.mark.parametrize("name", ANOTHER)
def test_a_claim_that_differs_in_anything_is_a_disagreement(tmp_path_factory, name):
    verdict = own(tmp_path_factory).verdict
    said, value = ANOTHER[name]
    claim = claim_of(replace(verdict, **{name: value(verdict)}))
    assert disagreement(claim, verdict).startswith(f"the verification process {said}")


@pytest.mark.parametrize("name", [field.name for field in fields(records.Approach)])
def test_an_approach_that_differs_in_anything_is_a_disagreement(tmp_path_factory, name):
    verdict = own(tmp_path_factory).verdict
    value = getattr(verdict.approach, name)
    other = tuple(count + 1 for count in value) if isinstance(value, tuple) else value + 1
    claim = claim_of(replace(verdict, approach=replace(verdict.approach, **{name: other})))
    assert disagreement(claim, verdict) == (
        "the verification process said another entry, exit or speed than this side has verified"
    )


def test_a_claim_of_more_than_this_side_has_verified_is_a_disagreement_with_its_reason(tmp_path_factory):
    admissible = own(tmp_path_factory).verdict
    outside, low = own(tmp_path_factory, INADMISSIBLE_MM).verdict, own(tmp_path_factory, joints_u=LOW).verdict
    claim = claim_of(replace(outside, admissible=True, approach=admissible.approach))
    assert disagreement(claim, outside).startswith(
        "the verification process said ADMISSIBLE, this side's own check says INADMISSIBLE: outer short by"
    )
    claim = claim_of(replace(low, approach=admissible.approach))
    assert disagreement(claim, low).startswith(
        "the verification process said ADMISSIBLE of approach and retract, this side's own check says INADMISSIBLE: "
    )


# ---------------------------------------------------------------- guidance


def test_guidance_is_told_in_the_verdicts_document_or_why_there_is_none(tmp_path_factory):
    answer = own(tmp_path_factory, INADMISSIBLE_MM)
    *_, guided = answers(request_of(tmp_path_factory, INADMISSIBLE_MM))
    found = guided.guidance.value
    with_it, without = with_guidance(answer, found, "unused"), with_guidance(answer, None, "not in time")
    assert with_it.document["guidance"]["translation_mm"] == list(found.translation_mm)
    assert with_it.guidance is found
    assert "guidance_note" not in with_it.document
    assert (without.document["guidance"], without.document["guidance_note"]) == (None, "not in time")
    for told in (with_it, without):
        assert {**answer.document, **told.document} == told.document
        assert set(told.document) - {"guidance_note"} == set(answer.document)
    assert with_it.verdict is without.verdict is answer.verdict
    assert answer.document["guidance"] is None


def test_what_was_neither_found_nor_proved_is_a_note(tmp_path_factory):
    answer = own(tmp_path_factory, INADMISSIBLE_MM)
    *_, guided = answers(request_of(tmp_path_factory, INADMISSIBLE_MM))
    open_ended = replace(guided.guidance.value, verified=False, none_possible=None, text="none was found")
    told = with_guidance(answer, open_ended, "unused")
    assert (told.document["guidance"], told.document["guidance_note"]) == (None, "none was found")
    assert told.guidance is open_ended


def test_what_looks_wrong_goes_with_the_answer_and_what_must_be_confirmed_with_the_verdict(
    tmp_path_factory, monkeypatch
):
    assert own(tmp_path_factory).verdict.to_confirm == own(tmp_path_factory).cautions == ()
    monkeypatch.setattr(plausibility, "CUT_LEAST_MM", 1000.0)
    job, robot = job_and_robot(tmp_path_factory)
    placed = plausibility.Placed(np.eye(4), 0.1)
    answer = finished(Check(job, robot, placed).steps(5, STANDS))
    assert [caution.code for caution in answer.cautions] == ["CUT_TINY", "CT_TRANSLATION_SMALL"]
    assert answer.verdict.to_confirm == ("CUT_TINY",)
    assert [warning["code"] for warning in answer.document["warnings"]] == [
        "CUT_TINY",
        "CT_TRANSLATION_SMALL",
    ]


def test_a_large_move_is_doubted_in_the_document_beside_what_was_doubted_before(
    tmp_path_factory, monkeypatch
):
    monkeypatch.setattr(plausibility, "CUT_LEAST_MM", 1000.0)
    job, robot = job_and_robot(tmp_path_factory, INADMISSIBLE_MM)
    answer = finished(Check(job, robot).steps(5, STANDS))
    move = Guidance((-200.0, 0.0, 0.0), 0.0, (0.0, 0.0, 0.0), (), 1.0, True, "moved")
    told = with_guidance(answer, move, "").document["warnings"]
    assert [warning["code"] for warning in told] == ["CUT_TINY", "MOVE_LARGE"]
    assert [warning["code"] for warning in with_guidance(answer, None, "x").document["warnings"]] == [
        "CUT_TINY"
    ]
