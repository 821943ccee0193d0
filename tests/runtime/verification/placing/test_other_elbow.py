"""Whether the other elbow would admit a refused path: by the certified method, with bounded work."""

from dataclasses import replace

import numpy as np
import pytest

from cutgate.runtime.verification import certified, stocco
from cutgate.runtime.verification.placing.other_elbow import WORK, other_elbow
from tests.runtime.verification.cases import DEG, axis, mirrored, problem, random_problem


def swapped(case):
    """The same path for the other elbow, its limits of q1 mirrored."""
    lower, upper = case.lower.copy(), case.upper.copy()
    lower[1], upper[1] = -case.upper[1], -case.lower[1]
    elbow = {"right": "left", "left": "right"}[case.arm.elbow]
    return replace(case, lower=lower, upper=upper, arm=replace(case.arm, elbow=elbow))


def refused(elbow):
    """A path that this elbow cannot cut for its shoulder's limits, and the other one can."""
    tips = np.array([[500.0, 0.0, 100.0], [520.0, 10.0, 110.0]])
    case = problem(tips, np.tile(axis(30 * DEG, 0.0), (2, 1)))
    case = replace(case, lower=np.array([0.0, *case.lower[1:]]), upper=np.array([80 * DEG, *case.upper[1:]]))
    return case if elbow == "right" else mirrored(case)


@pytest.mark.parametrize(
    ("elbow", "other", "q1"), [("right", "left", (-145, 0)), ("left", "right", (0, 145))]
)
def test_a_path_that_the_other_elbow_admits_is_said_so_with_the_limits_it_was_taken_to_have(elbow, other, q1):
    case = refused(elbow)
    verdict = certified.verify(case)
    assert not verdict.admissible
    found = other_elbow(case, verdict)
    assert (found.elbow, found.q1_deg, found.admissible) == (other, q1, True)
    assert f"the {other} elbow would admit this path as the bone stands" in found.text
    assert f"[{q1[0]}, {q1[1]}] deg" in found.text
    assert found.document == {"elbow": other, "q1_deg": [*q1], "admissible": True, "text": found.text}
    assert certified.verify(swapped(case)).admissible


def test_the_answer_is_the_certified_methods_whatever_the_arm():
    rng = np.random.default_rng(20261127)
    said = []
    for _ in range(16):
        case = random_problem(rng)
        case = replace(case, branch=(0, 0))
        verdict = certified.verify(case)
        found = other_elbow(case, verdict)
        assert (found is None) is verdict.admissible
        if found is not None:
            said.append(found.admissible)
            assert found.admissible is certified.verify(replace(swapped(case), branch=None)).admissible
            assert (f"the {found.elbow} elbow would not admit" in found.text) is not found.admissible
    assert len(said) > 4


def test_where_the_work_is_spent_nothing_is_said_either_way():
    case = refused("right")
    found = other_elbow(case, certified.verify(case), work=1000)
    assert found.admissible is None
    assert "is not proved" in found.text
    assert WORK >= 1_000_000


def test_nothing_is_asked_of_a_path_that_is_admitted_or_not_decided_by_the_gates_method():
    case = refused("right")
    assert other_elbow(swapped(case), certified.verify(swapped(case))) is None
    assert other_elbow(case, stocco.verify(case)) is None
    unfit = replace(case, feed_mm_s=np.nan)
    assert other_elbow(unfit, certified.verify(unfit)) is None
