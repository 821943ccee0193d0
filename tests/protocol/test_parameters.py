"""Limits, calibration and tool: inward rounding, exact decimals, and what cannot be a robot."""

import math
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.protocol.parameters import (
    UNIT,
    Calibration,
    Limits,
    Tool,
    counts_down,
    counts_nearest,
    counts_up,
    joints_to_counts,
    joints_to_memory,
)
from cutgate.protocol.wire import RecordError

LIMITS = Limits.quantised(
    q_min_deg=[-80.0, 0.0, 50.0, -170.0, 0.0],
    q_max_deg=[80.0, 145.0, 450.0, 170.0, 110.0],
    speed_deg_s=[60.0, 60.0, 200.0, 120.0, 120.0],
    acceleration_deg_s2=[300.0, 300.0, 1000.0, 600.0, 600.0],
)
CALIBRATION = Calibration.quantised(upper_link_mm=450.0, forearm_link_mm=400.0)

finite = st.floats(-1e9, 1e9)


@given(finite)
def test_rounding_is_inward_and_within_one_count(value: float):
    exact = Fraction(repr(value)) * UNIT
    assert exact <= counts_up(value, "x") < exact + 1
    assert exact - 1 < counts_down(value, "x") <= exact
    assert abs(counts_nearest(value, "x") - exact) <= Fraction(1, 2)


@given(st.integers(-(10**12), 10**12))
def test_six_decimals_are_exact(count: int):
    value = float(Decimal(count) / UNIT)
    assert counts_up(value, "x") == counts_down(value, "x") == counts_nearest(value, "x") == count


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("counts", [counts_up, counts_down, counts_nearest])
def test_non_finite_is_refused(counts, value: float):
    with pytest.raises(RecordError, match=r"q1 is .* must be finite"):
        counts(value, "q1")


def test_limits_in_memory_are_radians_and_millimetres():
    assert LIMITS.q_min == pytest.approx([math.radians(-80), 0, 50, math.radians(-170), 0])
    assert LIMITS.q_max == pytest.approx(
        [math.radians(80), math.radians(145), 450, math.radians(170), math.radians(110)]
    )
    assert LIMITS.speed[2] == 200.0
    assert LIMITS.acceleration is not None
    assert LIMITS.acceleration[0] == pytest.approx(math.radians(300))
    assert replace(LIMITS, acceleration_u=(0,) * 5).acceleration is None


def test_vectors_in_memory_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        LIMITS.q_min[0] = 0.0


def test_limits_without_acceleration_say_so():
    limits = Limits.quantised(q_min_deg=[0.0] * 5, q_max_deg=[1.0] * 5, speed_deg_s=[1.0] * 5)
    assert limits.acceleration is None


def test_wrong_number_of_limits_is_refused():
    with pytest.raises(RecordError, match="q_min_u"):
        Limits.quantised(q_min_deg=[0.0] * 4, q_max_deg=[1.0] * 5, speed_deg_s=[1.0] * 5)


def test_limits_round_trip():
    assert Limits.parse(LIMITS.body()) == LIMITS


def test_good_limits_have_no_problems():
    assert LIMITS.problems() == []
    assert replace(LIMITS, acceleration_u=(0,) * 5).problems() == []


def moved(values: tuple[int, ...], joint: int, degrees: float) -> tuple[int, ...]:
    return tuple(round(degrees * UNIT) if at == joint else value for at, value in enumerate(values))


@pytest.mark.parametrize("joint", range(5))
def test_each_lower_limit_must_be_below_its_upper_one(joint: int):
    limits = replace(LIMITS, q_min_u=moved(LIMITS.q_min_u, joint, LIMITS.q_max_u[joint] / UNIT))
    assert any(f"q{joint} lower limit" in problem for problem in limits.problems())


@pytest.mark.parametrize(
    ("joint", "least", "most"),
    [(0, -36000, 36000), (1, -180, 180), (2, -5242, 5242), (3, -36000, 36000), (4, 0, 180)],
)
def test_each_limit_must_be_physical(joint: int, least: float, most: float):
    if joint == 1:
        inside = replace(LIMITS, q_min_u=moved(LIMITS.q_min_u, 1, 0), q_max_u=moved(LIMITS.q_max_u, 1, most))
        other = replace(LIMITS, q_min_u=moved(LIMITS.q_min_u, 1, least), q_max_u=moved(LIMITS.q_max_u, 1, 0))
        assert other.problems() == []
    else:
        inside = replace(
            LIMITS, q_min_u=moved(LIMITS.q_min_u, joint, least), q_max_u=moved(LIMITS.q_max_u, joint, most)
        )
    assert inside.problems() == []
    above = replace(LIMITS, q_max_u=moved(LIMITS.q_max_u, joint, most + 1e-6))
    assert any(f"q{joint} limits" in problem for problem in above.problems())
    below = replace(LIMITS, q_min_u=moved(LIMITS.q_min_u, joint, least - 1e-6))
    assert any(f"q{joint} limits" in problem for problem in below.problems())


def test_limits_spanning_both_elbows_are_a_problem():
    limits = replace(LIMITS, q_min_u=moved(LIMITS.q_min_u, 1, -1e-6))
    assert any("span both elbows" in problem for problem in limits.problems())


def test_all_zero_limits_are_a_problem():
    limits = replace(LIMITS, q_min_u=(0,) * 5, q_max_u=(0,) * 5)
    assert any("all position limits are zero" in problem for problem in limits.problems())


@pytest.mark.parametrize("field", ["speed_u", "acceleration_u"])
@pytest.mark.parametrize("joint", range(5))
def test_each_speed_and_acceleration_must_be_positive(field: str, joint: int):
    for value in (0.0, -1.0):
        limits = replace(LIMITS, **{field: moved(getattr(LIMITS, field), joint, value)})
        assert any(f"q{joint} {field[:5]}" in problem for problem in limits.problems())


def test_calibration_in_memory_is_radians_millimetres_and_plain_tilt():
    calibration = Calibration.quantised(
        upper_link_mm=450.0,
        forearm_link_mm=400.0,
        upper_link_error_mm=0.5,
        forearm_link_error_mm=-0.25,
        joint_offset_deg=[1.0, 2.0, 3.0, 4.0, 5.0],
        slide_tilt_mrad=[10.0, -20.0],
        residual_mm=0.1234561,
        residual_deg=0.5,
    )
    assert (calibration.upper_mm, calibration.forearm_mm) == (450.0, 400.0)
    assert (calibration.upper_link_error_mm, calibration.forearm_link_error_mm) == (0.5, -0.25)
    assert calibration.joint_offset == pytest.approx([*np.radians([1, 2]), 3.0, *np.radians([4, 5])])
    assert calibration.slide_tilt == pytest.approx([0.01, -0.02])
    assert calibration.residual_mm == 0.123457
    assert calibration.residual_rad == math.radians(0.5)
    assert calibration.problems() == []
    assert Calibration.parse(calibration.body()) == calibration


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"upper_link_u": 0}, "upper link 0.0"),
        ({"forearm_link_u": 10_001 * UNIT}, "forearm link 10001.0"),
        ({"upper_link_error_u": -450 * UNIT}, "true upper link 0.0"),
        ({"joint_offset_u": (0, 0, 0, 180 * UNIT + 1, 0)}, "q3 offset"),
        ({"joint_offset_u": (0, 0, -5242 * UNIT - 1, 0, 0)}, "q2 offset"),
        ({"slide_tilt_u": (0, 20 * UNIT + 1)}, "slide tilt 20.000001"),
        ({"residual_mm_u": -1}, "residual -1e-06 mm"),
        ({"residual_deg_u": 90 * UNIT + 1}, "residual 90.000001 deg"),
    ],
)
def test_each_impossible_calibration_is_named(change: dict[str, object], named: str):
    problems = replace(CALIBRATION, **change).problems()
    assert any(problem.startswith(named) for problem in problems), problems


def test_tool_length():
    tool = Tool.quantised(length_mm=160.0000004)
    assert tool.length_mm == 160.0
    assert Tool.parse(tool.body()) == tool
    assert tool.problems() == []
    assert Tool(length_u=-1).problems()
    assert Tool(length_u=10_000 * UNIT + 1).problems()


@given(st.tuples(*[st.floats(-1000.0, 1000.0)] * 5))
def test_joints_travel_within_half_a_count(joints: tuple[float, ...]):
    counts = joints_to_counts(joints)
    there = joints_to_memory(counts)
    assert there == pytest.approx(joints, abs=0.51e-6)
    assert joints_to_counts(there) == counts


def test_joints_that_are_no_sample_are_refused():
    with pytest.raises(RecordError, match="must be 5"):
        joints_to_counts([0.0] * 4)
    with pytest.raises(RecordError, match="q2"):
        joints_to_counts([0.0, 0.0, math.nan, 0.0, 0.0])
