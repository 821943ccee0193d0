"""The work behind guidance is counted and bounded, whatever the path, and what is counted is what is done."""

import math

import numpy as np
import pytest

from cutgate.runtime.verification import certified
from cutgate.runtime.verification.bounds import bisection, chain
from cutgate.runtime.verification.effort import Effort, EffortSpentError
from cutgate.runtime.verification.placing import freedom as placing
from cutgate.runtime.verification.placing import guidance
from cutgate.runtime.verification.placing.guidance import WORK, guide
from cutgate.runtime.verification.problem import Arm, ArmCalibration, Deadband
from cutgate.runtime.verification.report.document import Digests, verdict_document
from tests.runtime.commands.contract import VerdictDocument
from tests.runtime.verification.cases import DEG, axis, problem, random_problem, wrist_path
from tests.seeds import seeds


def quantise(tips, axes):
    return np.round(tips * 1000.0) / 1000.0, axes


# -- counting ------------------------------------------------------------------------------------


def test_work_that_is_more_than_what_is_left_is_not_begun_and_not_counted():
    effort = Effort(100)
    effort.spend(60)
    with pytest.raises(EffortSpentError, match="41 points are more than the 40 left of 100"):
        effort.spend(41)
    assert (effort.spent, effort.left) == (60, 40)
    effort.spend(40)
    assert (effort.spent, effort.left) == (100, 0)


def test_a_part_draws_on_the_whole_and_neither_passes_its_bound():
    whole = Effort(100)
    whole.spend(50)
    part, large = whole.part(30), whole.part(80)
    part.spend(25)
    assert (part.left, whole.spent, large.left) == (5, 75, 25)
    with pytest.raises(EffortSpentError):
        part.spend(6)
    with pytest.raises(EffortSpentError):
        large.spend(26)
    assert (part.spent, large.spent, whole.spent) == (25, 0, 75)
    assert whole.part(math.inf).part(7).left == 7


def test_work_without_a_bound_is_counted_all_the_same():
    effort = Effort()
    effort.spend(10**12)
    assert (effort.spent, effort.left) == (10**12, math.inf)


def test_a_number_that_is_none_is_not_taken():
    with pytest.raises(EffortSpentError):
        Effort(100).spend(math.nan)


# -- paths that are hard to guide ----------------------------------------------------------------


def circle(rng):
    """About the column, for a shoulder of about a turn: what its sides refuse is where the search once never ended."""
    n = int(rng.integers(5, 120))
    t = rng.uniform(0, 6) + np.linspace(0.0, rng.uniform(3.0, 6.5), n)
    r, off = rng.uniform(300, 800), rng.normal(0, 40, 2)
    centres = np.column_stack((r * np.cos(t) + off[0], r * np.sin(t) + off[1], 150 + rng.normal(0, 2, n)))
    half, middle = rng.uniform(3.0, 6.0), rng.uniform(-3, 3)
    return problem(
        *wrist_path(centres, axis(rng.uniform(0.3, 1.2), t)),
        lower=np.array([middle - half, 0.0, 50.0, -rng.uniform(1, 9), 0.0]),
        upper=np.array([middle + half, rng.uniform(1.8, math.pi), 450.0, rng.uniform(1, 9), 1.9]),
        speed=np.full(5, 1e3),
    )


def scattered(rng):
    """Poses to and fro over the reach of an odd arm, or near together and many, with errors and a leaning slide."""
    n = int(10.0 ** rng.uniform(0.5, 3.7))
    centres = rng.uniform(-600, 600, (n, 2)) * rng.uniform(0.02, 1) + rng.normal(0, 300, 2)
    axes = axis(np.clip(rng.normal(0.9, 0.05, n), 0.1, 1.8), rng.normal(0, rng.choice([0.001, 0.3]), n))
    bend = np.sort(rng.uniform(0, math.pi, 2))
    span, middle = rng.choice([0.1, 1.0, 3.0, 6.2, 6.3, 8.0]), rng.uniform(-3, 3)
    return problem(
        *wrist_path(np.column_stack((centres, 150 + rng.normal(0, 5, n))), axes),
        arm=Arm(*(float(x) for x in rng.uniform(250, 500, 2)), "right"),
        lower=np.array([middle - span / 2, rng.choice([0.0, bend[0]]), 50.0, -rng.uniform(0.5, 9), 0.0]),
        upper=np.array([middle + span / 2, rng.choice([math.pi, bend[1]]), 450.0, rng.uniform(0.5, 9), 1.9]),
        speed=np.full(5, float(rng.choice([1e-6, 1e6]))),
        calibration=ArmCalibration(
            slide_tilt=rng.uniform(-0.02, 0.02, 2), residual_mm=float(rng.choice([0, 0.3]))
        ),
        deadband=Deadband(float(rng.choice([1e-3, 1.0, 5.0])), float(rng.choice([0.01, 2.0])) * DEG),
    )


def displaced(rng):
    """A random problem, moved away."""
    path = random_problem(rng, segments=int(rng.integers(1, 12)), spinning=rng.random() < 0.5)
    return guidance.moved(path, 0.0, (0, 0, 0), rng.normal(0, rng.choice([3, 60, 400]), 3))


HARD = {"circle": circle, "scattered": scattered, "displaced": displaced}


def inadmissible(kind, seed, count):
    rng = np.random.default_rng([20270401, seed])
    while count:
        path = HARD[kind](rng)
        verdict = certified.verify(path)
        if not verdict.admissible:
            count -= 1
            yield path, verdict


@pytest.fixture
def looked(monkeypatch):
    """Counts, apart from `Effort`, the points and intervals that are looked at, and keeps each answer's bound."""
    seen = {"points": 0, "efforts": []}

    def counting(module, name, size):
        real = getattr(module, name)

        def counted(*given, **named):
            seen["points"] += size(*given, **named)
            return real(*given, **named)

        monkeypatch.setattr(module, name, counted)

    counting(placing, "signed_distance", lambda points, _: len(points))
    counting(placing, "distance_to_arc", lambda points, _: len(points))
    counting(placing, "elbow_angle", lambda r, *_: np.size(r))
    counting(placing, "at_poses", lambda geometry, segments, chosen: len(segments.tip[chosen]))
    counting(bisection, "lower_bounds", lambda geometry, segments, scope, parts, floor: len(parts))
    counting(chain, "distance_from_column", lambda first, _: len(first))

    class Kept(Effort):
        def __init__(self, *given, **named):
            super().__init__(*given, **named)
            seen["efforts"].append(self)

    monkeypatch.setattr(guidance, "Effort", Kept)
    return seen


@pytest.mark.parametrize("seed", seeds(3, 5))
@pytest.mark.parametrize("kind", HARD)
def test_whatever_the_path_the_work_of_guidance_is_counted_and_stays_within_its_bound(looked, kind, seed):
    for path, verdict in inadmissible(kind, seed, 3):
        looked["points"], looked["efforts"][:] = 0, []
        found = guide(path, verdict, quantise)
        whole = looked["efforts"][0]
        assert looked["points"] <= whole.spent <= WORK
        assert found.settled or "not proved" in found.text
        if found.verified:
            assert found.translation_mm is not None


@pytest.mark.parametrize("kind", HARD)
def test_the_answer_does_not_depend_on_anything_but_the_path(kind):
    for path, verdict in inadmissible(kind, 99, 2):
        assert guide(path, verdict, quantise) == guide(path, verdict, quantise)


def test_with_little_work_to_spend_nothing_is_claimed_that_more_work_refutes(monkeypatch):
    answers = []
    for work in (WORK, 400_000, 100_000, 20_000, 1000):
        monkeypatch.setattr(guidance, "WORK", work)
        answers.append([guide(path, verdict, quantise) for path, verdict in inadmissible("displaced", 7, 12)])
    for best, *others in zip(*answers, strict=True):
        for found in others:
            assert not (found.none_possible is True and best.none_possible is False)
            assert not (best.none_possible is True and found.none_possible is False)
            if (
                found.at_least_mm is not None
                and best.at_least_mm is not None
                and found.reserve_mm == best.reserve_mm
            ):
                assert found.at_least_mm <= np.linalg.norm(best.translation_mm) + 0.1
    undecided = [found for found in answers[-1] if guidance.SPENT in found.text]
    assert len(undecided) > 3
    assert not any(found.settled for found in undecided)


def test_what_is_neither_found_nor_proved_is_null_in_the_document_with_a_note(monkeypatch):
    monkeypatch.setattr(guidance, "WORK", 1000)
    path = problem(*wrist_path([[890.0, 100.0, 200.0], [895.0, 90.0, 200.0]], axis(1.0, 0.2)))
    verdict = certified.verify(path)
    found = guide(path, verdict, quantise)
    digests = Digests(*(bytes(32) for _ in range(4)))
    document = verdict_document(verdict, poses=5, guidance=found, digests=digests, elapsed_ms=1.0)
    assert document["guidance"] is None
    assert document["guidance_note"] == found.text
    assert "that there is none is not proved" in found.text
    assert guidance.SPENT in found.text
    assert VerdictDocument.model_validate(document)


def test_a_path_too_long_to_be_looked_at_is_not_searched_at_all(monkeypatch, looked):
    monkeypatch.setattr(guidance, "WORK", 10_000)
    path = problem(*wrist_path(np.tile([895.0, 0.0, 200.0], (6000, 1)), axis(1.0, 0.2)))
    verdict = certified.verify(path)
    looked["points"] = 0
    found = guide(path, verdict, quantise)
    assert not found.settled
    assert found.moves
    assert looked["points"] == 0


# -- what is proved is said, and no more ---------------------------------------------------------


def test_a_full_circle_for_a_shoulder_of_little_more_than_a_turn_is_answered():
    """Once the search of this path had no end. That nothing helps is proved; tried at eighty places as well."""
    t = np.linspace(0, 2 * math.pi, 25)
    tips = np.column_stack((620 * np.cos(t), 620 * np.sin(t), np.full(25, 100.0)))
    path = problem(
        tips,
        axis(30 * DEG, t),
        lower=np.array([-180 * DEG, 0.0, 50.0, -170 * DEG, 0.0]),
        upper=np.array([181 * DEG, 145 * DEG, 450.0, 170 * DEG, 110 * DEG]),
    )
    verdict = certified.verify(path)
    assert not verdict.admissible
    found = guide(path, verdict, quantise)
    assert (found.none_possible, found.translation_mm) == (True, None)
    rng = np.random.default_rng(3)
    for size in (1.0, 10.0, 100.0, 300.0):
        for shift in rng.normal(0, size, (20, 2)):
            moved = guidance.moved(path, 0.0, (0, 0, 0), (*shift, 0.0))
            assert not certified.verify(moved).admissible
