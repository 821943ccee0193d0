"""The paper's method: its published counts, its bounds, and what it must never do."""

import math

import numpy as np
import pytest

from runtime.verification import certified, stocco
from runtime.verification.problem import Arm, Deadband
from tests.runtime.verification.cases import DEG, WIDE, axis, problem, wrist_path

LENGTH, EXTENT, STROKES, DEADBAND = 17501.0, 225.0, 25, 25.0

TABLE_1 = [
    # rho mm, phi deg, evaluations, smallest clearance mm
    (765.299, 90.0, 97, 55.000),
    (274.514, 90.0, 83, 66.500),
    (500.0, 90.0, 47, 291.968),
    (546.458, 0.0, 65, 96.519),
]


def zigzag(rho, phi_deg):
    """The reconstructed zigzag of Table 1: 25 equal strokes, 17501 mm, 225 mm across."""
    k = np.arange(STROKES + 1)
    width = math.sqrt(LENGTH**2 - EXTENT**2) / STROKES
    x, y = -width / 2 * (-1.0) ** k, -EXTENT / 2 + k * EXTENT / STROKES
    c, s = math.cos(phi_deg * DEG), math.sin(phi_deg * DEG)
    return np.stack((c * x - s * y + rho, s * x + c * y, np.full(len(k), 100.0)), axis=1)


def annulus(centres, **changes):
    """The Figure 2 arm: unlimited joints, annulus 100..1000 mm, level tool."""
    tips, axes = wrist_path(centres, axis(90 * DEG, 0.3))
    values = {
        "arm": Arm(550.0, 450.0, "right"),
        "lower": np.array([-WIDE, 0.0, -1e4, -WIDE, 0.0]),
        "upper": np.array([WIDE, math.pi, 1e4, WIDE, math.pi]),
        "speed": np.full(5, 1e9),
        "deadband": Deadband(DEADBAND, 2 * DEG),
    }
    return problem(tips, axes, **(values | changes))


@pytest.mark.parametrize(("rho", "phi", "count", "clearance"), TABLE_1)
def test_the_papers_table_1_is_reproduced(rho, phi, count, clearance):
    verdict = stocco.verify(annulus(zigzag(rho, phi)))
    assert verdict.admissible
    assert (verdict.evaluations.arm, verdict.evaluations.worst_case) == (count, 352)
    assert verdict.wrist_length_mm == pytest.approx(17501.0, abs=1e-6)
    assert verdict.evaluations.wrist == 1


@pytest.mark.parametrize(("rho", "phi", "count", "clearance"), TABLE_1)
def test_the_exact_smallest_clearances_of_table_1_are_enclosed(rho, phi, count, clearance):
    verdict = certified.verify(annulus(zigzag(rho, phi)))
    assert verdict.admissible
    inner, outer = verdict.boundaries["inner"], verdict.boundaries["outer"]
    least, proven = min(inner.clearance, outer.clearance), min(inner.certified, outer.certified)
    assert least == pytest.approx(clearance, abs=1e-3)
    assert proven <= least <= proven + 0.01


@pytest.mark.parametrize(("length", "bound"), [(5000.0, 501), (7000.0, 701), (3000.0, 301)])
def test_equation_15_gives_table_2_and_one(length, bound):
    assert stocco.worst_case(length, 5.0) == bound


def test_a_path_of_length_zero_takes_one_evaluation():
    run = stocco.march(0.0, 1.0, lambda _: np.array([2.0]))
    assert (run.admitted, run.evaluations, run.worst_case) == (True, 1, 1)


def test_a_path_far_inside_takes_two_evaluations():
    run = stocco.march(100.0, 1.0, lambda _: np.array([500.0, 600.0]))
    assert (run.admitted, run.evaluations) == (True, 2)


@pytest.mark.parametrize("at", [0, 1, 2])
def test_a_distance_that_is_not_a_number_denies(at):
    values = iter([50.0] * at + [math.nan] + [50.0] * 10)
    run = stocco.march(100.0, 1.0, lambda _: np.array([next(values)]))
    assert not run.admitted
    assert run.evaluations == at + 1


def test_the_number_of_evaluations_is_bounded_whatever_the_distance_says(monkeypatch):
    monkeypatch.setattr(stocco, "MOST_EVALUATIONS", 5)
    run = stocco.march(1e9, 1e-3, lambda _: np.array([2e-3]))
    assert not run.admitted
    assert run.evaluations == 5


@pytest.mark.parametrize(("clearance", "admitted"), [(50.001, True), (49.999, False)])
def test_the_printed_rule_stops_below_twice_the_deadband(clearance, admitted):
    r = 1000.0 - clearance
    verdict = stocco.verify(annulus([[r, 0.0, 0.0], [r, 0.0, 10.0]]))
    assert verdict.admissible is admitted
    assert verdict.boundaries["outer"].clearance == pytest.approx(clearance, abs=1e-6)
    assert certified.verify(annulus([[r, 0.0, 0.0], [r, 0.0, 10.0]])).admissible


def test_a_start_outside_is_never_admitted():
    verdict = stocco.verify(annulus([[1200.0, 0.0, 0.0], [500.0, 0.0, 0.0]]))
    assert not verdict.admissible
    assert "outside" in verdict.reasons[0]


def test_bad_numbers_are_refused_with_a_reason():
    verdict = stocco.verify(annulus([[500.0, 0.0, 0.0], [500.0, math.nan, 0.0]]))
    assert (verdict.method, verdict.admissible) == ("stocco", False)
    assert "finite" in verdict.reasons[0]


def test_the_wrist_marches_on_the_angle_of_the_axis():
    tips, axes = wrist_path([[500.0, 0.0, 100.0]] * 2, axis([1.0, 0.06], 0.0))
    verdict = stocco.verify(problem(tips, axes))
    assert not verdict.admissible
    assert any(reason.startswith("wrist") for reason in verdict.reasons)
    assert verdict.boundaries["wrist_singularity"].clearance < 4.0


def test_the_march_never_admits_below_the_deadband():
    rng = np.random.default_rng(4)
    admitted = 0
    for _ in range(150):
        clearance = rng.uniform(20.0, 60.0)
        y = rng.uniform(-300, 300)
        x = math.sqrt((1000.0 - clearance) ** 2 - 300.0**2)
        ends = [[x, y - 5, 0.0], [x, 300.0, 0.0]]
        path = annulus(ends)
        verdict = stocco.verify(path)
        if verdict.admissible:
            admitted += 1
            assert certified.verify(path).admissible
            assert verdict.boundaries["outer"].certified >= DEADBAND - 1e-6
    assert 10 < admitted < 140


def test_left_elbow_names_its_own_sides():
    right = problem(*wrist_path([[520.0, 60.0, 100.0], [500.0, 80.0, 120.0]], axis(1.0, 0.4)))
    left = problem(
        right.tips_mm * (1, -1, 1),
        right.axes * (1, -1, 1),
        arm=Arm(450.0, 450.0, "left"),
        lower=np.array([-80 * DEG, -145 * DEG, 50.0, -170 * DEG, 0.0]),
        upper=np.array([80 * DEG, 0.0, 450.0, 170 * DEG, 110 * DEG]),
    )
    a, b = stocco.verify(right), stocco.verify(left)
    assert a.boundaries["left"].clearance == pytest.approx(b.boundaries["right"].clearance, abs=1e-9)
    assert a.evaluations == b.evaluations
