"""The paper's method: its published counts, its bounds, and what it must never do."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.runtime.verification import certified, stocco
from cutgate.runtime.verification.problem import Arm
from tests.runtime.verification.cases import DEG, axis, problem, wrist_path
from tests.runtime.verification.table_1 import DEADBAND, TABLE_1, annulus, zigzag


@pytest.mark.parametrize(("rho", "phi", "count", "clearance"), TABLE_1)
def test_the_papers_table_1_is_reproduced(rho, phi, count, clearance):
    verdict = stocco.verify(annulus(zigzag(rho, phi)))
    assert verdict.admissible
    assert (verdict.evaluations.arm, verdict.evaluations.best_case) == (count, 2)
    assert verdict.evaluations.worst_case == 352
    assert verdict.wrist_length_mm == pytest.approx(17501.0, abs=1e-6)
    assert verdict.evaluations.wrist == 1


@pytest.mark.parametrize(("rho", "phi", "count", "clearance"), TABLE_1)
def test_the_exact_smallest_clearances_of_table_1_are_enclosed(rho, phi, count, clearance):
    verdict = certified.verify(annulus(zigzag(rho, phi)))
    assert verdict.admissible
    inner, outer = verdict.boundaries["inner"], verdict.boundaries["outer"]
    least, proven = min(inner.clearance, outer.clearance), min(inner.certified, outer.certified)
    assert proven <= clearance + 1e-3  # as the table is rounded
    assert clearance - 1e-3 <= least <= proven + 0.01


@pytest.mark.parametrize(("length", "bound"), [(5000.0, 501), (7000.0, 701), (3000.0, 301)])
def test_equation_15_gives_table_2_and_one(length, bound):
    assert stocco.worst_case(length, 5.0) == bound


def test_a_path_of_length_zero_takes_one_evaluation():
    run = stocco.march(0.0, 1.0, lambda _: np.array([2.0]))
    assert (run.admitted, run.evaluations, run.best_case, run.worst_case) == (True, 1, 1, 1)


def test_a_path_far_inside_takes_two_evaluations():
    run = stocco.march(100.0, 1.0, lambda _: np.array([500.0, 600.0]))
    assert (run.admitted, run.evaluations, run.best_case) == (True, 2, 2)


QUARTERS = st.integers(1, 4000).map(lambda n: n / 4)
"""Sums of these are exact, so that the bounds hold to the letter."""


@given(
    length=QUARTERS,
    slack=st.lists(st.integers(4, 160).map(lambda n: n / 4), min_size=1, max_size=30),
    deadband=QUARTERS.filter(lambda value: value <= 20),
)
def test_an_admitted_march_takes_as_many_evaluations_as_equations_14_and_15_allow(length, slack, deadband):
    values = itertools.cycle([2.0 * deadband * s for s in slack])
    run = stocco.march(length, deadband, lambda _: np.array([next(values)]))
    assert run.admitted
    assert run.best_case <= run.evaluations <= run.worst_case
    assert run.places[0] == 0.0
    assert run.places[-1] == length
    assert (np.diff(run.places) > 0.0).all()


@pytest.mark.parametrize("parts", [1, 2, 500])
def test_equation_15_is_attained_where_the_distance_is_twice_the_deadband(parts):
    run = stocco.march(parts * 4.0, 2.0, lambda _: np.array([4.0]))
    assert run.admitted
    assert run.evaluations == run.worst_case == parts + 1


@pytest.mark.parametrize(
    ("length", "least", "most"), [(0.0, 1, 1), (1e-9, 2, 2), (50.0, 2, 2), (50.001, 2, 3)]
)
def test_the_bounds_of_short_paths(length, least, most):
    assert (stocco.best_case(length), stocco.worst_case(length, 25.0)) == (least, most)


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


@pytest.mark.parametrize(("last_deg", "admitted"), [(40.0, True), (4.1, True), (3.9, False), (107.0, False)])
def test_the_wrists_march_is_that_of_a_scalar(last_deg, admitted):
    """At constant azimuth the pitch is the march length itself: equations (3)-(11) again, on a number line."""
    pitch = np.array([80.0, (80.0 + last_deg) / 2, last_deg])
    tips, axes = wrist_path([[500.0, 0.0, 100.0]] * 3, axis(pitch * DEG, 0.0))
    verdict = stocco.verify(problem(tips, axes))
    place, count, length, down = 0.0, 0, abs(last_deg - 80.0), math.copysign(1.0, last_deg - 80.0)
    while True:
        count += 1
        q4 = 80.0 + down * place
        d = min(q4, 110.0 - q4)
        if d < 4.0 or place == length:
            break
        place = min(place + d, length)
    assert verdict.evaluations.wrist == count
    assert verdict.axis_angle_rad == pytest.approx(length * DEG)
    assert verdict.admissible is admitted


def test_with_the_axis_the_march_length_of_the_arm_grows_by_the_tools_sweep():
    tips, axes = wrist_path([[500.0, 0.0, 100.0]] * 2, axis(np.array([80.0, 40.0]) * DEG, 0.0))
    turned = stocco.verify(problem(tips, axes))
    bound = np.linalg.norm(tips[1] - tips[0]) + 160.0 * 40.0 * DEG
    assert turned.wrist_length_mm <= bound
    assert turned.evaluations.worst_case == math.ceil(bound / 10.0) + 1


def in_the_band(seed, wanted):
    """Table 1's zigzag at random places whose exact smallest clearance is from one deadband up to two.

    Returns:
        Whether the march admits each, forward and reversed, and the clearances, mm.
    """
    rng = np.random.default_rng(seed)
    decided, clearances = [], []
    while len(decided) < wanted:
        centres = zigzag(rng.uniform(250.0, 800.0), rng.uniform(0.0, 180.0))[:, :2]
        inner, outer = _reach_of(centres)
        clearance = min(inner - 100.0, 1000.0 - outer)
        if not DEADBAND <= clearance < 2.0 * DEADBAND:
            continue
        clearances.append(clearance)
        decided.append([_annulus_march(points) for points in (centres, centres[::-1])])
    return np.array(decided), np.array(clearances)


def _reach_of(centres):
    """Least and largest distance of a polyline from the origin."""
    first, step = centres[:-1], np.diff(centres, axis=0)
    t = np.clip(-np.einsum("ij,ij->i", first, step) / np.einsum("ij,ij->i", step, step), 0.0, 1.0)
    return np.linalg.norm(first + t[:, None] * step, axis=1).min(), np.linalg.norm(centres, axis=1).max()


def _annulus_march(centres):
    steps = np.diff(centres, axis=0)
    ends = np.cumsum(np.hypot(*steps.T))
    starts = np.append(0.0, ends[:-1])

    def distance(place):
        i = min(int(np.searchsorted(ends, place)), len(steps) - 1)
        x, y = centres[i] + steps[i] * ((place - starts[i]) / (ends[i] - starts[i]))
        r = math.hypot(x, y)
        return np.array([min(r - 100.0, 1000.0 - r)])

    return stocco.march(float(ends[-1]), DEADBAND, distance).admitted


def test_between_one_and_two_deadbands_the_printed_method_decides_by_luck():
    decided, clearances = in_the_band(seed=0, wanted=150)
    forward, reversed_ = decided.T
    assert (clearances >= DEADBAND).all()
    assert 0.05 < forward.mean() < 0.6
    assert (forward != reversed_).any()


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
