"""A joint branch that is asked for: taken where the path fits in it, else refused with the turns that fit."""

from dataclasses import replace

import numpy as np
import pytest

from cutgate.config.load import InputError
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.asked import BEST, AskedTurns, in_branch
from tests.runtime.verification.cases import DEG, WIDE, axis, mirrored, problem


def cut(**limits):
    """A short cut on the example robot, some joints without limits."""
    tips = np.array([[500.0, 50.0, 120.0], [520.0, 60.0, 110.0]])
    case = problem(tips, np.tile(axis(30 * DEG, 0.0), (2, 1)))
    lower, upper = case.lower.copy(), case.upper.copy()
    for joint in (int(name[1]) for name in limits):
        lower[joint], upper[joint] = -limits[f"q{joint}"], limits[f"q{joint}"]
    return replace(case, lower=lower, upper=upper)


def test_nothing_asked_leaves_the_choice():
    case = cut(q3=WIDE)
    assert in_branch(case, BEST) is case
    assert (str(BEST), str(AskedTurns(1, -2))) == ("", "--q0-turns 1 --roll-turns -2")


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize(("asked", "taken"), [(AskedTurns(roll=-6), (0, -6)), (AskedTurns(q0=3), (3, 0)), (AskedTurns(2, 5), (2, 5))])  # fmt: skip
def test_a_branch_in_which_the_path_fits_is_taken_and_admitted(asked, taken, mirror):
    case = cut(q0=WIDE, q3=WIDE)
    chosen = in_branch(mirrored(case) if mirror else case, asked)
    assert chosen.branch == taken
    verdict = certified.verify(chosen)
    assert verdict.admissible
    assert (verdict.branch.q0_turns, verdict.branch.roll_turns) == taken


@pytest.mark.parametrize(
    ("asked", "texts"),
    [
        (AskedTurns(roll=1), ["--roll-turns is 1, must be 0", "q3 goes from 305", "limits [-170, 170] deg"]),
        (AskedTurns(q0=-1), ["--q0-turns is -1, must be 0", "q0 goes from -4", "limits [-80, 80] deg"]),
        (AskedTurns(0, -1), ["--roll-turns is -1, must be 0", "turns that fit: 0"]),
    ],
)
def test_a_branch_that_does_not_fit_is_refused_with_range_limit_and_what_fits(asked, texts):
    with pytest.raises(InputError) as refused:
        in_branch(cut(), asked)
    for text in texts:
        assert text in str(refused.value)


def test_a_branch_beyond_what_a_joints_frame_carries_is_refused_whatever_the_limits():
    with pytest.raises(
        InputError, match=r"--roll-turns is 7, must be -6 to 6; q3 goes from 2\d+.* within \+-2261 deg"
    ):
        in_branch(cut(q3=WIDE), AskedTurns(roll=7))


def test_the_turns_that_are_said_to_fit_are_those_that_do():
    case = cut(q0=700 * DEG, q3=1000 * DEG)
    q0, q3 = certified.verify(case).windings
    for turns in range(-8, 9):
        for found, branch in ((q0, (turns, 0)), (q3, (0, turns))):
            fits = certified.verify(replace(case, branch=branch)).branch is not None
            assert fits is (found.first <= turns <= found.last), (found, turns)


def test_a_path_that_fits_in_no_turns_keeps_its_own_verdict():
    """No other turns would help: what it lacks is said by the verdict, not by the option."""
    case = cut()
    narrow = replace(case, upper=np.array([*case.upper[:3], -160 * DEG, case.upper[4]]))
    assert in_branch(narrow, AskedTurns(roll=1)) is narrow
    assert not certified.verify(narrow).admissible
