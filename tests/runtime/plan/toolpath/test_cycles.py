"""Heights of drilling cycles."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.runtime.plan.toolpath.cycles import PECK_CLEARANCE_MM, Hole
from cutgate.runtime.plan.toolpath.expressions import GcodeError


def test_a_plain_hole():
    assert Hole("G81", 10, 2, -5, 10).heights(9) == [(2, False), (-5, True), (10, False)]
    assert Hole("G82", 2, 2, -5, 2).heights(9) == [(-5, True), (2, False)]


def test_pecks_of_both_kinds():
    c = PECK_CLEARANCE_MM
    assert Hole("G73", 2, 2, -3, 2, 2).heights(99) == [
        *((0, True), (0 + c, False), (-2, True), (-2 + c, False), (-3, True), (2, False))
    ]
    assert Hole("G83", 2, 2, -3, 5, 3).heights(99) == [
        *((-1, True), (2, False), (-1 + c, False), (-3, True), (5, False))
    ]


@given(
    st.sampled_from(["G73", "G83"]), st.floats(-5, 5), st.floats(0.1, 20), st.floats(0.3, 30), st.floats(0, 9)
)
def test_feeds_go_down_by_no_more_than_a_peck_to_the_bottom(code, retract, deep, peck, above):
    moves = Hole(code, retract, retract, retract - deep, retract + above, peck).heights(100_000)
    depths = [height for height, feeds in moves if feeds]
    for before, after in zip([retract, *depths], depths, strict=False):
        assert 0 <= before - after <= peck + 1e-9
    assert depths[-1] == retract - deep
    assert moves[-1] == (retract + above, False)


def test_too_many_pecks_are_refused_at_once():
    with pytest.raises(GcodeError, match="moves of a cycle"):
        Hole("G83", 0, 0, -1000, 0, 1e-9).heights(10**9)
    with pytest.raises(GcodeError, match="pose limit"):
        Hole("G83", 0, 0, -10, 0, 1).heights(20)
