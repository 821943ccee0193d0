"""What each joint travels on the approach, as it is told before the start."""

from dataclasses import replace

import numpy as np
import pytest

from cutgate.protocol.records import joints_to_counts
from cutgate.runtime.commands.travel_view import travel_lines
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.approach.decision import verify
from cutgate.runtime.verification.approach.model import StartJoints
from tests.runtime.verification.approach.cuts import MIDDLE, cut
from tests.runtime.verification.cases import DEG, WIDE


def told(roll_deg=0.0, turns=0, limit=WIDE, **changes):
    """What is said of an arm that stands with its roll there."""
    lower, upper = cut().lower.copy(), cut().upper.copy()
    lower[3], upper[3] = -limit, limit
    made = replace(cut(lower=lower, upper=upper, **changes), branch=(0, turns))
    stands = np.array([*MIDDLE[:3], roll_deg * DEG, MIDDLE[4]])
    verdict, way = certified.verify(made), verify(made, StartJoints(stands, 10_000))
    return [line.plain for line in travel_lines(way, joints_to_counts(stands), verdict)]


def test_each_joint_is_told_in_degrees_and_turns_and_none_is_warned_of_within_a_turn():
    (line,) = told()
    assert line.startswith("the approach moves q0 -44.3 deg (0.1 turns), q1 +")
    assert " mm, q3 -5" in line


@pytest.mark.parametrize(
    ("stands", "turns", "text"),
    [
        (2520, 0, "; --roll-turns 6 is nearest to where the arm stands (the path fits in -6 to 6)"),
        (-1000, 2, "; --roll-turns -3 is nearest to where the arm stands (the path fits in -6 to 6)"),
        (2520, 6, "; the path fits in no turns nearer to where the arm stands (--roll-turns -6 to 6)"),
    ],
)
def test_more_than_one_turn_is_warned_of_with_the_turns_that_would_spare_it(stands, turns, text):
    _, warning = told(stands, turns)
    assert warning.startswith("WARNING q3 turns ")
    assert f"times on the approach, from {stands}.0 to " in warning
    assert warning.endswith(text)


def test_an_arm_that_stands_in_the_turns_asked_for_is_not_warned_of():
    assert len(told(2100, 6)) == 1


def test_where_there_is_no_entry_nothing_is_told():
    way = verify(cut(), StartJoints(MIDDLE, 10_000))
    verdict = certified.verify(cut())
    assert travel_lines(replace(way, entry=None), joints_to_counts(MIDDLE), verdict) == []
    assert travel_lines(replace(way, entry=np.full(5, np.nan)), joints_to_counts(MIDDLE), verdict) == []


def test_without_a_known_branch_no_other_turns_are_named():
    made = cut()
    way, verdict = verify(made, StartJoints(MIDDLE, 10_000)), certified.verify(made)
    far = joints_to_counts(MIDDLE + np.array([0, 0, 0, 800 * DEG, 0]))
    for bare in (replace(verdict, branch=None), replace(verdict, windings=())):
        assert travel_lines(way, far, bare)[1].plain.endswith("cables and hoses must allow it")
