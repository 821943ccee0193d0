"""Guidance: hints per boundary, and a combined move that is proven before it is shown."""

import math

import numpy as np
import pytest

from runtime.verification import certified
from runtime.verification.guidance import guide
from runtime.verification.problem import Arm
from tests.runtime.verification.cases import DEG, axis, problem, wrist_path

LEAN = axis(60 * DEG, 0.2)


def quantise(tips, axes):
    return np.round(tips * 1000.0) / 1000.0, axes


def spot(x, y, z=200.0, **changes):
    """A short path of three strokes about a place of the wrist centre."""
    strokes = [[x, y, z], [x + 8, y, z], [x + 8, y + 6, z + 4], [x, y + 6, z + 4]]
    return problem(*wrist_path(strokes, LEAN), **changes)


def advice(path):
    verdict = certified.verify(path)
    assert not verdict.admissible
    return verdict, guide(path, verdict, quantise)


def moved(path, translation):
    tips, axes = quantise(path.tips_mm + np.asarray(translation), path.axes)
    return certified.verify(
        problem(tips, axes, arm=path.arm, lower=path.lower, upper=path.upper, calibration=path.calibration)
    )


PLACES = {
    "outer": (890.0, 100.0, 200.0, "outer", lambda w: -w),
    "outer, from outside": (930.0, 100.0, 200.0, "outer", lambda w: -w),
    "inner": (248.0, 114.0, 200.0, "inner", lambda w: w),
    "inner, from inside the hole": (190.0, 90.0, 200.0, "inner", lambda w: w),
    "top": (600.0, 50.0, 447.0, "top", None),
    "bottom": (600.0, 50.0, 20.0, "bottom", None),
}


@pytest.mark.parametrize("name", PLACES)
def test_each_hint_points_the_way_of_its_table(name):
    x, y, z, boundary, direction = PLACES[name]
    verdict, found = advice(spot(x, y, z))
    hint = next(m for m in found.moves if m.boundary == boundary)
    assert hint.kind == "move"
    lacking = verdict.boundaries[boundary].deadband - verdict.boundaries[boundary].clearance
    assert hint.distance_mm == pytest.approx(lacking + 0.2)
    if direction is None:
        assert hint.direction == (0.0, 0.0, -1.0 if boundary == "top" else 1.0)
    else:
        want = direction(np.array([x, y]))
        assert np.dot(hint.direction[:2], want) / math.hypot(*want) > 0.98


@pytest.mark.parametrize("name", PLACES)
def test_the_combined_move_is_small_verified_and_keeps_its_reserve(name):
    path = spot(*PLACES[name][:3])
    verdict, found = advice(path)
    assert found.verified
    again = moved(path, found.translation_mm)
    assert again.admissible
    assert found.predicted_clearance_mm >= verdict.deadband_arm_mm + 0.05
    hint = max(m.distance_mm for m in found.moves if m.kind == "move")
    assert np.linalg.norm(found.translation_mm) <= hint + 8.0
    assert all(round(v, 1) == pytest.approx(v, abs=1e-9) for v in found.translation_mm)


@pytest.mark.parametrize("elbow", ["right", "left"])
def test_left_and_right_hints_follow_the_elbow(elbow):
    """Right elbow: left toward o1, right away from o2; left elbow the mirror image."""
    side = 1.0 if elbow == "right" else -1.0
    lower = np.array([-80.0, min(0.0, 145 * side), 0, -3600, 0]) * (DEG, DEG, 1, DEG, DEG)
    upper = np.array([80.0, max(0.0, 145 * side), 450, 3600, 110]) * (DEG, DEG, 1, DEG, DEG)
    arm = Arm(450.0, 450.0, elbow)
    for name, q0 in (("left", 80 * DEG), ("right", -80 * DEG)):
        elbow_at = 450 * np.array([math.cos(q0), math.sin(q0)])
        heading = q0 + side * 70 * DEG
        on = elbow_at + 450 * np.array([math.cos(heading), math.sin(heading)])
        path = spot(*on, arm=arm, lower=lower, upper=upper)
        _, found = advice(path)
        hint = next(m for m in found.moves if m.boundary == name)
        toward = (elbow_at - on) / 450 * (1 if (name == "left") == (elbow == "right") else -1)
        assert np.dot(hint.direction[:2], toward) > 0.99
        assert found.verified
        assert moved(path, found.translation_mm).admissible


def test_what_a_translation_cannot_cure_is_said():
    path = problem(*wrist_path([[600.0, 0.0, 200.0], [620.0, 0.0, 200.0]], axis(0.5 * DEG, 0.3)))
    _, found = advice(path)
    assert (found.translation_mm, found.verified, found.predicted_clearance_mm) == (None, False, None)
    assert "wrist_singularity" in found.text
    hint = next(m for m in found.moves if m.boundary == "wrist_singularity")
    assert hint.kind == "turn"
    assert hint.angle_deg == pytest.approx(1.6)
    np.testing.assert_allclose(hint.direction, (-math.sin(0.3), math.cos(0.3), 0.0), atol=1e-9)


def test_a_pitch_beyond_its_limit_turns_back():
    path = problem(*wrist_path([[600.0, 0.0, 200.0], [620.0, 0.0, 200.0]], axis(112 * DEG, 0.3)))
    _, found = advice(path)
    hint = next(m for m in found.moves if m.boundary == "pitch_max")
    assert hint.angle_deg == pytest.approx(4.1)
    np.testing.assert_allclose(hint.direction, (math.sin(0.3), -math.cos(0.3), 0.0), atol=1e-9)


def test_a_roll_that_no_place_cures_has_no_translation():
    n = 80
    azimuth = np.linspace(0, 400 * DEG, n)
    path = problem(*wrist_path(np.tile([600.0, 0.0, 200.0], (n, 1)), axis(60 * DEG, azimuth)))
    verdict, found = advice(path)
    assert found.translation_mm is None
    assert not found.verified
    assert {m.boundary for m in found.moves} == {n for n, b in verdict.boundaries.items() if b.violated}
    assert all(m.kind == "turn" and abs(m.direction[2]) == 1.0 for m in found.moves)


def test_a_path_taller_than_the_slide_has_no_translation():
    path = problem(*wrist_path([[600.0, 0.0, 40.0], [600.0, 0.0, 460.0]], LEAN))
    _, found = advice(path)
    assert found.translation_mm is None


def test_an_arm_without_workspace_has_no_translation():
    path = spot(600.0, 0.0)
    broken = problem(
        path.tips_mm, path.axes, lower=np.array([1.0, 0, 50, -3, 0]), upper=np.array([0.9, 2, 450, 3, 2])
    )
    verdict = certified.verify(broken)
    found = guide(broken, verdict, quantise)
    assert found.translation_mm is None
    assert found.moves == ()


def test_nothing_to_cure_and_nothing_usable_give_no_guidance():
    good = spot(600.0, 0.0)
    assert guide(good, certified.verify(good), quantise) is None
    bad = problem(good.tips_mm * math.nan, good.axes)
    assert guide(bad, certified.verify(bad), quantise) is None


def test_a_held_vertical_tool_is_guided_too():
    path = problem(*wrist_path([[895.0, 0.0, 200.0], [890.0, 20.0, 200.0]], [0.0, 0.0, 1.0]), hold_roll=0.0)
    _, found = advice(path)
    assert found.verified


def test_a_shoulder_of_more_than_a_turn_is_guided_by_its_circles():
    lower, upper = np.array([-7.0, 0.2, 0.0, -60.0, 0.0]), np.array([7.0, 2.5, 450.0, 60.0, 3.0])
    path = spot(889.0, 10.0, lower=lower, upper=upper)
    _, found = advice(path)
    assert found.verified
    assert moved(path, found.translation_mm).admissible


def test_a_move_that_the_certified_method_does_not_admit_is_not_shown():
    path = spot(930.0, 100.0, speed=np.full(5, 1e-6))
    _, found = advice(path)
    assert (found.translation_mm, found.verified) == (None, False)
    assert "no translation found" in found.text
