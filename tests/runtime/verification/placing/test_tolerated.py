"""What error of a registration a path tolerates: every placement within it, tried out by the whole verification."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.runtime.verification import certified, stocco
from cutgate.runtime.verification.decide import Around, Displacement
from cutgate.runtime.verification.placing import tolerated as module
from cutgate.runtime.verification.placing.guidance import moved
from cutgate.runtime.verification.placing.tolerated import tolerated
from cutgate.runtime.verification.problem import Arm, ArmCalibration
from tests.runtime.verification.cases import DEG, axis, mirrored, problem

K = np.linspace(0.0, 1.0, 40)
WEAVING = problem(
    np.stack((520 + 60 * K, 40 * np.sin(9 * K), 120 + 30 * K), axis=1), axis(0.5 + 0.3 * K, 0.4 + 2.0 * K)
)
LIMITS = {
    "lower": np.array([-75 * DEG, 0.0, 210.0, -150 * DEG, 5 * DEG]),
    "upper": np.array([60 * DEG, 120 * DEG, 420.0, 120 * DEG, 80 * DEG]),
}
TILTED = ArmCalibration(
    1.0, -2.0, np.array([0.01, -0.02, 1.5, 0.02, -0.01]), np.array([0.012, -0.02]), 0.2, 0.002
)
CASES = {
    "as it is": WEAVING,
    "narrow": replace(WEAVING, **LIMITS),
    "calibrated": replace(WEAVING, calibration=TILTED),
    "left elbow": mirrored(replace(WEAVING, **LIMITS, calibration=TILTED)),
    "coarse": replace(WEAVING, tips_mm=WEAVING.tips_mm[::13], axes=WEAVING.axes[::13]),
}


def found(case):
    verdict = certified.verify(case)
    assert verdict.admissible, verdict.reasons
    error = tolerated(case, verdict)
    assert error is not None
    return error


def admitted(case, error, translation, yaw_deg):
    return certified.verify(moved(case, yaw_deg, error.pivot_mm, translation)).admissible


def on_the_ball(rng, radius):
    direction = rng.normal(size=3)
    return radius * direction / np.linalg.norm(direction)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_every_placement_within_it_is_admissible(case):
    error, rng = found(case), np.random.default_rng(1)
    assert error.ball_mm > 0.5
    assert error.yaw_deg > 0.5
    for number in range(24):
        sign = (-1) ** number
        assert admitted(case, error, on_the_ball(rng, error.ball_mm), 0.0)
        assert admitted(case, error, np.zeros(3), sign * error.yaw_deg)
        assert admitted(case, error, on_the_ball(rng, error.both_ball_mm), sign * error.both_yaw_deg)


def test_a_translation_is_tolerated_up_to_the_nearest_boundary():
    """Straight up there is so much room, and no more; elsewhere there is more."""
    low = replace(WEAVING, upper=WEAVING.upper - [0, 0, 450.0 - 311.0, 0, 0])
    error, verdict = found(low), certified.verify(low)
    room = verdict.boundaries["top"].clearance - 5.0
    assert room - 0.02 <= error.ball_mm <= room
    assert admitted(low, error, (0.0, 0.0, error.ball_mm), 0.0)
    assert not admitted(low, error, (0.0, 0.0, room + 0.01), 0.0)


def test_a_turn_is_tolerated_almost_up_to_where_the_roll_ends():
    """Of a path far from the column, about a pivot in its middle, the roll is what ends it; the tool's lever costs some."""
    middle = WEAVING.tips_mm.mean(axis=0)
    short = replace(WEAVING, tips_mm=middle + 0.02 * (WEAVING.tips_mm - middle))
    roll = certified.verify(short).boundaries["roll_max"].clearance
    upper = short.upper - [0, 0, 0, (roll - 12.0) * DEG, 0]
    error = found(replace(short, upper=upper))
    assert 7.0 < error.yaw_deg <= 10.0


def test_both_at_once_are_less_than_each_alone_and_whole_steps():
    error = found(CASES["narrow"])
    assert 0.0 < error.both_ball_mm < error.ball_mm
    assert 0.0 < error.both_yaw_deg < error.yaw_deg
    for value in (error.ball_mm, error.yaw_deg, error.both_ball_mm, error.both_yaw_deg):
        assert value == round(value, 2)
    assert error.text == (
        f"Still admissible with the bone up to {error.both_ball_mm:.2f} mm and {error.both_yaw_deg:.2f} deg about the "
        f"vertical from where it is registered; alone up to {error.ball_mm:.2f} mm, or {error.yaw_deg:.2f} deg (proved)."
    )


def test_long_segments_are_cut_so_that_one_look_proves_something():
    """The same path in fewer poses has the same room, but for what its pieces are longer."""
    line = problem([[500.0, -60.0, 120.0], [500.0, 60.0, 120.0]], axis([0.5, 0.5], [0.0, 0.0]))
    fine = replace(line, tips_mm=np.linspace(*line.tips_mm, 241), axes=np.repeat(line.axes[:1], 241, axis=0))
    assert found(line).ball_mm == pytest.approx(found(fine).ball_mm, abs=3.0)
    assert not Around(line).holds(Displacement(found(line).ball_mm))


def test_a_path_of_too_many_pieces_is_taken_as_it_is(monkeypatch):
    monkeypatch.setattr(module, "POSES_MAX", 40)
    coarse = CASES["coarse"]
    assert module._refined(coarse) is coarse
    monkeypatch.undo()
    refined = module._refined(coarse)
    assert len(refined.tips_mm) > 60
    assert (refined.tips_mm[-1] == coarse.tips_mm[-1]).all()
    assert (refined.axes[0] == coarse.axes[0]).all()
    steps = np.linalg.norm(np.diff(refined.tips_mm, axis=0), axis=1)
    assert steps.max() <= module.PIECE_MM
    again = certified.verify(refined)
    for name, b in certified.verify(coarse).boundaries.items():
        assert again.boundaries[name].clearance == pytest.approx(b.clearance, abs=0.02)


def test_where_nothing_is_admitted_or_proved_nothing_is_said():
    refused = replace(WEAVING, tips_mm=WEAVING.tips_mm + np.array((0, 0, 400.0)))
    wide = replace(WEAVING, upper=WEAVING.upper + np.array((0, 0, 0, 30 * DEG, 0)))
    for case in (refused, wide):
        assert tolerated(case, certified.verify(case)) is None
    assert tolerated(WEAVING, stocco.verify(WEAVING)) is None
    near = certified.verify(WEAVING).boundaries["pitch_min"].clearance * DEG
    tight = replace(WEAVING, deadband=replace(WEAVING.deadband, wrist_rad=near - 1e-7))
    verdict = certified.verify(tight)
    assert verdict.admissible
    assert tolerated(tight, verdict) is None


def test_of_a_path_too_long_to_look_at_so_often_nothing_is_said(monkeypatch):
    verdict = certified.verify(WEAVING)
    monkeypatch.setattr(module, "LONGEST_POSES", len(WEAVING.tips_mm))
    assert tolerated(WEAVING, verdict) is not None
    monkeypatch.setattr(module, "LONGEST_POSES", len(WEAVING.tips_mm) - 1)
    assert tolerated(WEAVING, verdict) is None


@given(edge=st.integers(0, 400), most=st.integers(0, 300), first=st.integers(-5, 500))
def test_the_largest_is_found_wherever_it_is_looked_for_first(edge, most, first):
    asked = []

    def holds(value):
        asked.append(value)
        return value <= edge

    assert module._largest(holds, most, first=first) == min(edge, most)
    assert all(0 < value <= most for value in asked)
    assert len(asked) <= 20


@given(ball=st.floats(0, 40), yaw=st.floats(0, 40 * DEG), more=st.floats(0, 10))
def test_what_is_proved_of_an_error_is_proved_of_a_smaller_one(ball, yaw, more):
    around = Around(CASES["narrow"])
    pivot = (550.0, 0.0)
    if around.holds(Displacement(ball + more, yaw * 1.1, pivot)):
        assert around.holds(Displacement(ball, yaw, pivot))


def test_an_arm_without_a_wrist_or_with_nan_proves_nothing():
    for changes in ({"tool_length_mm": 0.0}, {"feed_mm_s": math.nan}, {"arm": Arm(math.nan, 450.0, "right")}):
        assert not Around(replace(WEAVING, **changes)).holds(Displacement(0.0))
    outside = replace(WEAVING, tips_mm=WEAVING.tips_mm + np.array((900.0, 0, 0)))
    assert not Around(outside).holds(Displacement(0.0))
