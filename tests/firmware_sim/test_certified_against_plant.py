"""What the runtime certifies against what the simulated arm does: no boundary comes nearer than its certified bound.

The arm has kinematics of its own, steps of its own along the path, and finds its distances by moving joints to their
limits. A calibration that one side takes the other way round must fail.
"""

from functools import cache

import numpy as np
import pytest

from cutgate.firmware_sim.drives import BANDWIDTH_RAD_S
from cutgate.protocol.records import UNIT
from tests.firmware_sim.verified_plans import (
    least_while_cutting,
    least_with_mass,
    random_plan,
    shifted,
    too_near,
)
from tests.seeds import seeds

PLANS = 50
"""Of each seed."""
LONG_PLANS = 10_000
MASS_PLANS = 20
ROUNDING = 1e-6
"""mm, deg: the last digits of either side."""
CLOSE = 0.02
"""mm, deg: so near to the certified bound the arm comes, if the runtime certifies as closely as it says."""


def plans(seed, count):
    rng = np.random.default_rng([20261129, seed])
    found = []
    while len(found) < count:
        plan = random_plan(rng, int(rng.integers(1, 9)))
        found += [plan] if plan is not None else []
    return found


@cache
def drawn(seed):
    return plans(seed, PLANS)


@pytest.mark.parametrize("seed", seeds(6, 20))
def test_the_arm_never_comes_nearer_than_was_certified(seed):
    assert [too_near(plan, least_while_cutting(plan), ROUNDING) for plan in drawn(seed)] == [[]] * PLANS


@pytest.mark.long
def test_the_arm_never_comes_nearer_than_was_certified_in_thousands_of_plans():
    for seed in range(1000, 1000 + LONG_PLANS // PLANS):
        wrong = [too_near(plan, least_while_cutting(plan), ROUNDING) for plan in plans(seed, PLANS)]
        assert wrong == [[]] * PLANS, seed


@pytest.mark.parametrize("seed", range(2))
def test_the_arm_comes_about_as_near_as_was_certified(seed):
    """Else the comparison would say nothing: of an arm that stays in the middle everything is certified."""
    most = 0.0
    for plan in drawn(seed):
        least = least_while_cutting(plan)
        gaps = [
            least[name].distance - b.certified for name, b in plan.verdict.boundaries.items() if name in least
        ]
        most = max(most, float(np.median(gaps)))
    assert most < CLOSE


@pytest.mark.parametrize(
    ("field", "boundaries"),
    [
        ("upper_link_error_u", {"inner", "outer", "left", "right"}),
        ("forearm_link_error_u", {"inner", "outer", "left", "right"}),
        (0, {"left", "right"}),
        (1, {"inner", "outer"}),
        (2, {"top", "bottom"}),
        (3, {"roll_min", "roll_max"}),
        (4, {"pitch_min", "pitch_max", "wrist_singularity"}),
    ],
)
@pytest.mark.parametrize("sign", [-1, 1])
def test_an_arm_that_is_another_one_than_was_verified_comes_nearer(field, boundaries, sign):
    """By 2 mm of a link or 1 deg or mm of a joint, as where one side takes a correction the other way round."""
    by = (
        2 * UNIT * sign
        if isinstance(field, str)
        else tuple((joint == field) * sign * UNIT for joint in range(5))
    )
    name = field if isinstance(field, str) else "joint_offset_u"
    found = set()
    for plan in drawn(0):
        least = least_while_cutting(plan, shifted(plan.calibration, **{name: by}))
        found |= {boundary for boundary, _, _ in too_near(plan, least, ROUNDING)}
    assert found & boundaries


def test_an_arm_within_its_residual_comes_nearer_by_no_more_than_twice_that():
    """Wrist centre and boundary are each within the residual of where the calibration has them, so both together are.

    Joints, and with them slide, pitch and roll, are those of the calibrated arm: whatever the links are, no limit is met.
    """
    rng, seen = np.random.default_rng(20261130), 0.0
    for plan in drawn(1):
        off_u = rng.uniform(-1, 1, 2) * 0.1 * UNIT
        links = {"upper_link_error_u": int(off_u[0]), "forearm_link_error_u": int(off_u[1])}
        residual_mm = sum(abs(by) for by in links.values()) / UNIT
        least = least_while_cutting(plan, shifted(plan.calibration, **links))
        assert too_near(plan, least, 2.0 * residual_mm + ROUNDING) == []
        nearest = [b - distance for _, distance, b in too_near(plan, least, ROUNDING)]
        assert {name for name, _, _ in too_near(plan, least, ROUNDING)} <= {"inner", "outer", "left", "right"}
        seen = max(seen, *(gap / residual_mm for gap in nearest), 0.0)
    assert seen > 0.5


def test_an_arm_with_mass_comes_nearer_by_no_more_than_it_is_behind():
    """Its path tolerance: what the wrist centre, at most twice as fast as the tip, and a joint go in the drives' lag."""
    followed, feed_mm_s, lag_s = 0, 20.0, 2.0 / BANDWIDTH_RAD_S
    for plan in drawn(2)[:MASS_PLANS]:
        done = least_with_mass(plan, feed_mm_s)
        if done is not None:
            least, fastest_deg_s = done
            followed += 1
            assert (
                too_near(plan, least, 2.0 * feed_mm_s * lag_s, 2.0 * fastest_deg_s * lag_s + ROUNDING) == []
            )
            if len(plan.path) > 2:
                assert least != least_while_cutting(plan)
    assert followed > MASS_PLANS / 2
