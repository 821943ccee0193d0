"""The distance of the wrist centre to an arc over a joint line: bounded work, in steps."""

import pytest

from cutgate.runtime.verification.approach import curve
from cutgate.runtime.verification.problem import Deadband
from tests.runtime.verification.approach.cuts import MIDDLE, cut, joint_line
from tests.runtime.verification.cases import DEG


def test_what_is_not_decided_within_the_effort_is_refused(monkeypatch):
    monkeypatch.setattr(curve, "BUDGET", 0)
    first, last = MIDDLE.copy(), MIDDLE.copy()
    first[0], last[0] = -60 * DEG, 60 * DEG
    first[1] = last[1] = 90 * DEG
    arm = cut(deadband=Deadband(150.0, 2 * DEG))
    leg = joint_line(arm, first, last)
    left = leg.boundaries["left"]
    assert left.certified < 150.0 <= left.clearance
    assert left.violated
    assert any("left: undecided, the clearance lies between" in reason for reason in leg.reasons)


@pytest.mark.parametrize("block", [1, 3, 64])
def test_in_however_many_steps_the_answer_is_the_same(monkeypatch, block):
    first, last = MIDDLE.copy(), MIDDLE.copy()
    first[0], last[0] = -60 * DEG, 60 * DEG
    arm = cut(deadband=Deadband(150.0, 2 * DEG))
    whole = joint_line(arm, first, last)
    monkeypatch.setattr(curve, "BLOCK", block)
    assert joint_line(arm, first, last) == whole
