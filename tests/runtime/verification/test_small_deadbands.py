"""Deadbands far smaller than any robot file may ask for: arithmetic that decides them decides all others.

The tool axis passes the vertical by very little, at both poles: the least pitch on a great circle through two axes is
the angle whose sine is the height of its normal, computed here in whole fractions. And the wrist centre passes the
singular circles by very little, computed here with fifty digits.
"""

import math
from dataclasses import replace
from decimal import Decimal, localcontext
from fractions import Fraction

import numpy as np
import pytest

from cutgate.runtime.verification import certified
from cutgate.runtime.verification.bounds.chain import build
from cutgate.runtime.verification.bounds.closed_form import PITCH_PAD, extremes
from cutgate.runtime.verification.bounds.geometry import canonical
from cutgate.runtime.verification.certificate import certify, recheck
from cutgate.runtime.verification.problem import Arm, Deadband
from tests.runtime.verification.cases import DEG, WIDE, axis, problem, wrist_path
from tests.seeds import seeds

FREE = {
    "lower": np.array([-80 * DEG, 0.0, -1e4, -WIDE, 0.0]),
    "upper": np.array([80 * DEG, 145 * DEG, 1e4, WIDE, math.pi]),
    "speed": np.full(5, 1e12),
}


def passing(axes, wrist_deg):
    """A move of 67 mm with these axes at its ends."""
    tips = [(500.0, 100.0, 90.0), (560.0, 130.0, 90.0)]
    return problem(tips, axes, deadband=Deadband(5.0, wrist_deg * DEG), **FREE)


def least_pitch(first, second, pole=1.0):
    """Smallest angle to a pole on the shorter great circle between two axes, rad."""
    u, v = ([Fraction(float(x)) for x in direction] for direction in (first, second))
    up = Fraction(pole)
    dot = sum(a * b for a, b in zip(u, v, strict=True))
    uu, vv = (sum(a * a for a in w) for w in (u, v))
    beside = v[2] * uu - u[2] * dot  # how it rises from u toward v,
    behind = u[2] * vv - v[2] * dot  # and from v toward u
    if up * beside <= 0 or up * behind <= 0:
        return min(math.atan2(math.sqrt(w[0] ** 2 + w[1] ** 2), up * w[2]) for w in (u, v))
    normal = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
    return math.asin(math.sqrt(normal[2] ** 2 / sum(x * x for x in normal)))


def test_an_axis_that_passes_a_millionth_of_a_degree_from_the_vertical_is_not_admitted_at_a_millionth():
    """Both ends keep 1.01e-6 deg and more; between them the axis passes at 9.605e-7 deg."""
    ends = np.array(
        [
            (5.587935572592964e-09, 1.676380671777889e-08, 0.9999999999999999),
            (-6.519258174096656e-09, 1.6763806733391402e-08, 0.9999999999999998),
        ]
    )
    assert math.degrees(least_pitch(*ends)) == pytest.approx(9.605e-7, rel=1e-4)
    for pole in (1.0, -1.0):
        verdict = certified.verify(passing(ends * (1.0, 1.0, pole), 1e-6))
        assert not verdict.admissible
        assert verdict.boundaries["wrist_singularity"].violated
        assert verdict.boundaries["wrist_singularity"].clearance == pytest.approx(9.605e-7, rel=1e-4)


def test_a_proof_for_less_does_not_prove_what_passes_too_near_to_the_vertical():
    ends = axis(np.array((1.8e-8, 1.8e-8)), np.array((1.25, 1.89)))
    case = passing(ends, 5e-7)
    proof = certify(case, certified.verify(case))
    assert recheck(case, proof) == ()
    near = passing(ends, 1e-6)
    bold = {**proof.bounds, **dict.fromkeys(("wrist_singularity", "pitch_min"), 1e-6 * DEG)}
    assert any(
        reason.startswith("wrist_singularity") for reason in recheck(near, replace(proof, bounds=bold))
    )


@pytest.mark.parametrize("pole", [1.0, -1.0])
@pytest.mark.parametrize("seed", range(6))
def test_the_least_pitch_is_exact_from_a_billionth_of_a_radian_to_the_equator(seed, pole):
    rng = np.random.default_rng([20270301, seed])
    between = 0
    for _ in range(150):
        near, sweep = 10.0 ** rng.uniform(-9, 0.19), 10.0 ** rng.uniform(-9, 0.4)
        turn = rng.uniform(-math.pi, math.pi)
        along = np.array((math.cos(turn), math.sin(turn), 0.0))
        across = np.array((-math.sin(turn) * math.cos(near), math.cos(turn) * math.cos(near), math.sin(near)))
        lowest = np.array(
            (-math.sin(turn) * math.sin(near), math.cos(turn) * math.sin(near), -math.cos(near))
        )
        assert abs(across @ lowest) < 1e-12
        start = rng.uniform(-sweep, 0.2 * sweep)
        axes = np.array([-lowest * math.cos(t) * pole + along * math.sin(t) for t in (start, start + sweep)])
        axes[:, :2] *= pole
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        case = passing(axes, 0.5)
        geometry, segments = canonical(case)
        poses = build(geometry, segments).poses
        found = extremes(geometry, segments, poses.height, poses.pitch)
        value = found.least_pitch.value if pole > 0 else math.pi - found.most_pitch.value
        exact = least_pitch(*axes, pole)
        between += exact < min(least_pitch(u, u, pole) for u in axes)
        assert abs(value - exact) <= 2e-14
        assert value - PITCH_PAD <= exact
    assert between > 60


def chord(rng):
    """A level chord that passes the extended or the folded arm by about an arm deadband of next to nothing."""
    arm_mm = 10.0 ** rng.uniform(-11, -3)
    a0, a1 = (float(link) for link in rng.uniform(100, 600, 2))
    by = arm_mm * (1 + rng.uniform(-1, 1) * 10.0 ** rng.uniform(-4, 0))
    radial = np.array((math.cos(turn := rng.uniform(-3, 3)), math.sin(turn)))
    across = np.array((-radial[1], radial[0]))
    name = str(rng.choice(["inner", "outer"]))
    if name == "outer":
        ends = [(a0 + a1 - by) * radial, (a0 + a1 - 20.0) * radial + 5.0 * across]
    else:
        half = rng.uniform(0.1, 20.0)
        ends = [(abs(a0 - a1) + by) * radial + part * half * across for part in (-1.0, 0.7)]
    tips, axes = wrist_path([(*end, 100.0) for end in ends], axis(90 * DEG, 0.0), 0.0)
    upper = np.array([WIDE, math.pi, 1e4, WIDE, math.pi])
    return name, problem(
        tips,
        axes,
        tool_length_mm=0.0,
        arm=Arm(a0, a1, "right"),
        lower=np.array([-WIDE, 0.0, -1e4, -WIDE, 0.0]),
        upper=upper,
        speed=np.full(5, 1e15),
        deadband=Deadband(arm_mm, 0.001 * DEG),
    )


def clearance(name, case):
    """The exact distance of the chord to the singular circle, mm."""
    (x0, y0), (x1, y1) = ([Decimal(float(x)) for x in tip[:2]] for tip in case.tips_mm)
    a0, a1 = Decimal(case.arm.upper_mm), Decimal(case.arm.forearm_mm)
    if name == "outer":
        return a0 + a1 - max((x0 * x0 + y0 * y0).sqrt(), (x1 * x1 + y1 * y1).sqrt())
    dx, dy = x1 - x0, y1 - y0
    return abs(x0 * dy - y0 * dx) / (dx * dx + dy * dy).sqrt() - abs(a0 - a1)


@pytest.mark.parametrize("seed", seeds(1, 5))
def test_an_arm_deadband_of_next_to_nothing_is_decided_to_the_rounding(seed):
    rng = np.random.default_rng([20270302, seed])
    admitted = 0
    for _ in range(60):
        name, case = chord(rng)
        verdict = certified.verify(case)
        with localcontext() as context:
            context.prec = 50
            exact, needed = clearance(name, case), Decimal(case.deadband.arm_mm)
        assert Decimal(verdict.boundaries[name].certified) <= exact
        assert not verdict.admissible or exact >= needed
        assert verdict.admissible or exact < needed + Decimal("2e-9")
        admitted += verdict.admissible
    assert 8 < admitted < 52
