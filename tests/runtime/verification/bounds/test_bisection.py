"""The search itself: honest when undecided, bounded in effort and memory, the same in any blocks."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cutgate.runtime.verification import certified
from cutgate.runtime.verification.bounds import bisection, chain
from cutgate.runtime.verification.problem import Deadband
from tests.runtime.verification.cases import DEG, WIDE, axis, problem, random_problem, wrist_path
from tests.runtime.verification.judge import RULES, judged


def round_the_column(radius, *, roll=(-WIDE, WIDE), poses=4):
    """Tip on the column, level tool turning: the wrist centre runs on a circle, at constant roll."""
    azimuth = np.linspace(-0.8, 0.8, poses)
    return problem(
        np.zeros((poses, 3)),
        axis(90 * DEG, azimuth),
        tool_length_mm=radius,
        lower=np.array([-170 * DEG, 0.0, -300.0, roll[0], 0.0]),
        upper=np.array([170 * DEG, 145 * DEG, 300.0, roll[1], 3.0]),
        deadband=Deadband(5.0, 2 * DEG),
    )


def roll_on_the_circle(radius):
    """Constant roll of that path: azimuth less heading, with the wrist on the tool's own bearing."""
    elbow = math.acos((radius**2 - 2 * 450.0**2) / (2 * 450.0**2))
    return math.atan2(450 * math.sin(elbow), 450 + 450 * math.cos(elbow)) - elbow


def test_a_constant_clearance_just_above_its_deadband_is_decided():
    verdict = certified.verify(round_the_column(900 - 5.002))
    assert verdict.admissible, verdict.reasons
    assert verdict.boundaries["outer"].certified >= 5.0


def test_a_constant_clearance_at_its_deadband_is_undecided_and_said_so():
    verdict = certified.verify(round_the_column(900 - 5.000001))
    outer = verdict.boundaries["outer"]
    assert not verdict.admissible
    assert outer.clearance >= 5.0 > outer.certified
    assert outer.clearance - outer.certified < 1e-3
    assert any(reason.startswith("outer: undecided") for reason in verdict.reasons)


@pytest.mark.parametrize(
    ("spare_deg", "admitted"), [(0.002, True), (0.0006, True), (0.00005, False), (-1e-6, False)]
)
@pytest.mark.parametrize("end", ["roll_min", "roll_max"])
def test_a_constant_roll_is_decided_at_its_deadband(spare_deg, admitted, end):
    roll, keep = roll_on_the_circle(600.0), (2 + spare_deg) * DEG
    limits = (roll - keep, roll + 1) if end == "roll_min" else (roll - 1, roll + keep)
    verdict = certified.verify(round_the_column(600.0, roll=limits))
    found = verdict.boundaries[end]
    assert verdict.admissible is admitted, verdict.reasons
    assert found.clearance == pytest.approx(2 + spare_deg, abs=1e-9)
    if spare_deg > 0 and not admitted:
        assert found.clearance - found.certified < 1e-3
        assert any(f"{end}: undecided" in reason for reason in verdict.reasons)


def test_a_search_that_runs_out_of_effort_admits_nothing(monkeypatch):
    path = replace(round_the_column(900 - 5.01), closely=True)
    assert certified.verify(path).admissible
    monkeypatch.setattr(bisection, "budget", lambda _: 3)
    verdict = certified.verify(path)
    assert not verdict.admissible
    assert verdict.boundaries["outer"].violated
    assert verdict.evaluations.arm <= verdict.evaluations.worst_case


@pytest.mark.parametrize("allowed", range(1, 14))
def test_what_an_exhausted_search_left_open_counts_as_its_parents_proved_it(monkeypatch, allowed):
    """The way between the poses comes to 1.72 mm at a third of a 137 deg turn, where no cut falls."""
    monkeypatch.setattr(bisection, "budget", lambda _: allowed)
    monkeypatch.setattr(bisection, "BLOCK", 1)
    axes = axis(90 * DEG, np.array([-137 / 3, 137 * 2 / 3]) * DEG)
    tips = np.array([[400.0, 0.0, 100.0]] * 2)
    lower, upper = np.array([-2.9, 0.0, 0.0, -50.0, 0.0]), np.array([2.9, 3.1, 450.0, 50.0, 3.0])
    verdict = certified.verify(problem(tips, axes, tool_length_mm=498.28, lower=lower, upper=upper))
    assert verdict.boundaries["outer"].certified <= 1.7200001
    assert not verdict.admissible


def test_the_size_of_the_blocks_changes_nothing(monkeypatch):
    rng = np.random.default_rng(3)
    paths = [random_problem(rng, segments=30) for _ in range(6)] + [round_the_column(880.0, poses=40)]
    paths = [replace(path, closely=True) for path in paths]
    whole = [certified.verify(path) for path in paths]
    for module in (bisection, chain):
        monkeypatch.setattr(module, "BLOCK", 3)
    for path, one in zip(paths, whole, strict=True):
        two = certified.verify(path)
        assert two.admissible is one.admissible
        for name, b in one.boundaries.items():
            if b.clearance is not None and one.branch is not None:
                assert two.boundaries[name].clearance == pytest.approx(b.clearance, abs=0.011)
                assert two.boundaries[name].certified <= b.clearance


def test_a_straight_pass_over_the_column_winds_by_half_a_turn_and_no_more():
    """Arm that reaches the column's neighbourhood: the bearing is followed, not wrapped."""
    y = 0.5
    tips, axes = wrist_path([[-300.0, y, 0.0], [300.0, y, 0.0]], axis(90 * DEG, 0.0))
    path = problem(
        tips,
        axes,
        lower=np.array([-WIDE, 0.0, -1e3, -WIDE, 0.0]),
        upper=np.array([WIDE, math.pi, 1e3, WIDE, math.pi]),
        deadband=Deadband(0.1, 2 * DEG),
        speed=np.full(5, 1e9),
    )
    verdict = certified.verify(path)
    assert verdict.admissible, verdict.reasons
    rolled = 2 * 36000 - verdict.boundaries["roll_min"].clearance - verdict.boundaries["roll_max"].clearance
    x = np.linspace(-300, 300, 100_001)
    heading = np.unwrap(np.arctan2(y, x)) + np.arccos(np.hypot(x, y) / 900)  # equal links: q1 / 2
    assert rolled == pytest.approx(math.degrees(np.ptp(heading)), abs=0.02)
    assert not certified.verify(replace(path, deadband=Deadband(0.6, 2 * DEG))).admissible


@pytest.mark.parametrize("turn_deg", [60.0, 170.0, -170.0])
@pytest.mark.parametrize("offset", [-50.0, 0.0, 30.0])
def test_a_wrist_that_swings_round_the_column_within_a_segment_is_followed(turn_deg, offset):
    """At -50 the chord passes the column on one side and the way on the other: the ends alone mislead."""
    axes = axis(90 * DEG, np.array([-0.5, 0.5]) * turn_deg * DEG)
    path = problem(
        [[offset, 5.0, 0.0]] * 2,
        axes,
        tool_length_mm=100.0,
        lower=np.array([-WIDE, 0.0, -1e3, -WIDE, 0.0]),
        upper=np.array([WIDE, math.pi, 1e3, WIDE, math.pi]),
        speed=np.full(5, 1e9),
    )
    case = judged(path, 100)
    assert case.verdict.admissible, case.verdict.reasons
    assert [wrong for rule in RULES for wrong in rule(case)] == []


def test_thousands_of_poses_need_about_one_look_each():
    n = 4000
    t = np.linspace(0, 60, n)
    centres = np.stack((520 + 40 * np.cos(t), 30 * np.sin(t), 150 + t), axis=1)
    tips, axes = wrist_path(centres, axis(0.9 + 0.1 * np.sin(t / 7), 0.3 * np.cos(t / 5)))
    verdict = certified.verify(problem(tips, axes))
    assert verdict.admissible, verdict.reasons
    assert verdict.evaluations.arm < 2 * n
