"""Guidance: hints per boundary, and a combined move that is proven before it is shown."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cutgate.protocol.path import Path
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.placing import guidance
from cutgate.runtime.verification.placing.freedom import Placing, Reserve
from cutgate.runtime.verification.placing.guidance import guide
from cutgate.runtime.verification.placing.search import smallest_translation
from cutgate.runtime.verification.problem import Arm
from tests.runtime.verification.cases import DEG, axis, problem, random_problem, wrist_path

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


LEFT_ELBOW = {
    "arm": Arm(450.0, 450.0, "left"),
    "lower": np.array([-80, -145, 50, -170, 0]) * (DEG, DEG, 1, DEG, DEG),
    "upper": np.array([80, 0, 450, 170, 110]) * (DEG, DEG, 1, DEG, DEG),
}


@pytest.mark.parametrize("elbow", ["right", "left"])
@pytest.mark.parametrize("name", PLACES)
def test_each_hint_points_the_way_of_its_table(name, elbow):
    x, y, z, boundary, direction = PLACES[name]
    path = spot(x, y, z)
    if elbow == "left":  # the mirror image
        mirror = np.array((1.0, -1.0, 1.0))
        path, y = problem(path.tips_mm * mirror, path.axes * mirror, **LEFT_ELBOW), -y
    verdict, found = advice(path)
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


def registered(path, found):
    """The path after the contract's new registration, R' = Trans(translation) Rz(yaw about pivot) R."""
    yaw, (px, py, pz) = math.radians(found.yaw_deg), found.pivot_mm
    turn, there, back, shift = np.eye(4), np.eye(4), np.eye(4), np.eye(4)
    turn[:2, :2] = ((math.cos(yaw), -math.sin(yaw)), (math.sin(yaw), math.cos(yaw)))
    there[:3, 3], back[:3, 3], shift[:3, 3] = (-px, -py, -pz), (px, py, pz), found.translation_mm
    matrix = shift @ back @ turn @ there
    tips = np.column_stack((path.tips_mm, np.ones(len(path.tips_mm)))) @ matrix.T
    wire = Path.quantised(
        tips[:, :3], path.axes @ matrix[:3, :3].T, feed_mm_s=10.0, tool_length_mm=160.0, elbow=path.arm.elbow
    )
    return replace(path, tips_mm=wire.tips_mm, axes=wire.axes)


def test_a_turn_about_the_vertical_keeps_its_pivot_and_the_height():
    pivot = (10.0, -4.0, 7.0)
    path = problem(np.array([pivot, (11.0, -4.0, 9.0)]), np.tile((1.0, 0.0, 0.0), (2, 1)))
    there = guidance.moved(path, 40.0, pivot, (0.5, 0.0, -2.0))
    expected = ((10.5, -4.0, 5.0), (10.5 + math.cos(40 * DEG), -4.0 + math.sin(40 * DEG), 7.0))
    np.testing.assert_allclose(there.tips_mm, expected, atol=1e-12)
    np.testing.assert_allclose(there.axes, [(math.cos(40 * DEG), math.sin(40 * DEG), 0.0)] * 2, atol=1e-15)


def test_what_a_translation_cannot_cure_is_said():
    path = problem(*wrist_path([[600.0, 0.0, 200.0], [620.0, 0.0, 200.0]], axis(0.5 * DEG, 0.3)))
    _, found = advice(path)
    assert (found.translation_mm, found.verified, found.predicted_clearance_mm) == (None, False, None)
    assert "wrist_singularity" in found.text
    assert found.none_possible is True
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
    assert (found.translation_mm, found.none_possible) == (None, True)
    assert not found.verified
    assert "the roll leaves its limits" in found.text
    assert {m.boundary for m in found.moves} == {n for n, b in verdict.boundaries.items() if b.violated}
    assert all(m.kind == "turn" and abs(m.direction[2]) == 1.0 for m in found.moves)


@pytest.mark.parametrize(("azimuth", "boundary", "up"), [(-1.2, "roll_min", 1.0), (1.2, "roll_max", -1.0)])
@pytest.mark.parametrize("elbow", ["right", "left"])
def test_a_roll_beyond_its_limit_is_hinted_to_turn_about_the_vertical(elbow, azimuth, boundary, up):
    narrow = (
        LEFT_ELBOW if elbow == "left" else {"lower": problem([], []).lower, "upper": problem([], []).upper}
    )
    side = -1.0 if elbow == "left" else 1.0
    heading = side * math.acos(600.0 / 900.0)
    roll = np.array((0, 0, 0, 1.0, 0))
    limits = {
        "lower": narrow["lower"] * (1 - roll) - roll * (1.0 + heading),
        "upper": narrow["upper"] * (1 - roll) + roll * (1.0 - heading),
    }
    at = [[600.0, 0.0, 200.0], [600.0, 1.0, 200.0]]
    path = problem(*wrist_path(at, axis(60 * DEG, azimuth)), **{**narrow, **limits})
    _, found = advice(path)
    (hint,) = (m for m in found.moves if m.boundary == boundary)
    assert (hint.kind, hint.direction) == ("turn", (0.0, 0.0, up))
    assert hint.angle_deg == pytest.approx(math.degrees(0.2) + 2.1, abs=0.3)


def test_a_path_taller_than_the_slide_has_no_translation():
    path = problem(*wrist_path([[600.0, 0.0, 40.0], [600.0, 0.0, 460.0]], LEAN))
    _, found = advice(path)
    assert (found.translation_mm, found.none_possible) == (None, True)
    assert "taller than the slide's range" in found.text


def test_an_arm_without_workspace_has_no_translation():
    path = spot(600.0, 0.0)
    broken = problem(
        path.tips_mm, path.axes, lower=np.array([1.0, 0, 50, -3, 0]), upper=np.array([0.9, 2, 450, 3, 2])
    )
    verdict = certified.verify(broken)
    found = guide(broken, verdict, quantise)
    assert (found.translation_mm, found.none_possible) == (None, True)
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
    assert (found.translation_mm, found.verified, found.none_possible) == (None, False, None)
    assert "no translation found" in found.text
    assert "not proved" in found.text
    assert "lower the feed" in found.text


THIN = {
    "lower": np.array([-20, 0.6 / DEG, 50, -170, 0]) * (DEG, DEG, 1, DEG, DEG),
    "upper": np.array([20, 0.9 / DEG, 450, 170, 110]) * (DEG, DEG, 1, DEG, DEG),
}
"""A ring sector 50 mm deep and too narrow for a stroke across it to lie along it anywhere."""


@pytest.mark.parametrize("sign", [1, -1])
def test_a_stroke_across_a_thin_ring_is_cured_by_the_smallest_turn_and_by_no_translation(sign):
    turned = {1: 0.0, -1: 55.0}[sign] * DEG  # the sector lies about 20 deg: along it is 110 deg
    stroke = [[780.0, 300.0, 200.0], [780.0 + 100 * math.cos(turned), 300.0 + 100 * math.sin(turned), 200.0]]
    path = problem(*wrist_path(stroke, LEAN), **THIN)
    _, found = advice(path)
    assert found.verified
    assert found.none_possible is True
    assert "no translation helps (proved)" in found.text
    assert "inner, outer, left or right" in found.text
    assert found.yaw_deg * sign < 0.0
    assert abs(found.yaw_deg) < 45.0
    assert round(found.yaw_deg, 1) == found.yaw_deg
    assert certified.verify(registered(path, found)).admissible
    for yaw in (abs(found.yaw_deg) - 0.6, 0.6 - abs(found.yaw_deg)):
        less = guidance.moved(path, yaw, found.pivot_mm, (0.0, 0.0, 0.0))
        assert smallest_translation(Placing(less, Reserve(0.2))).translation_mm is None


@pytest.mark.parametrize("proved", [True, None])
def test_where_no_turn_is_found_either_it_is_said_beside_what_is_proved(monkeypatch, proved):
    monkeypatch.setattr(guidance._Combined, "_turns", lambda _: iter((50,)))
    if proved is None:
        monkeypatch.setattr(guidance._Combined, "_proof", lambda _: None)
    _, found = advice(problem(*wrist_path([[780.0, 300.0, 200.0], [880.0, 300.0, 200.0]], LEAN), **THIN))
    assert (found.translation_mm, found.none_possible, found.verified) == (None, proved, False)
    assert ("no translation helps (proved)" in found.text) is (proved is True)
    assert found.settled is (proved is True)
    assert "no turn about the vertical with a translation was found either: tilt the bone" in found.text


def test_the_search_for_a_turn_ends_when_its_work_is_used_up(monkeypatch):
    monkeypatch.setattr(guidance, "WORK", 300_000)
    _, found = advice(problem(*wrist_path([[780.0, 300.0, 200.0], [880.0, 300.0, 200.0]], LEAN), **THIN))
    assert (found.translation_mm, found.none_possible) == (None, True)
    assert "no turn about the vertical with a translation was found either" in found.text
    assert guidance.SPENT in found.text


def test_a_turn_that_leaves_a_tilt_violated_is_not_tried(monkeypatch):
    monkeypatch.setattr(guidance, "moved", None)
    path = problem(*wrist_path([[600.0, 0.0, 200.0], [620.0, 0.0, 200.0]], axis(112 * DEG, 0.3)))
    _, found = advice(path)
    assert (found.none_possible, found.yaw_deg, found.translation_mm) == (True, 0.0, None)
    assert "no turn about the vertical changes pitch_max" in found.text


def test_a_held_roll_beyond_its_limit_is_changed_by_no_move():
    path = problem(*wrist_path([[600.0, 0.0, 200.0], [600.0, 20.0, 200.0]], [0.0, 0.0, 1.0]), hold_roll=3.1)
    _, found = advice(path)
    assert (found.none_possible, found.translation_mm) == (True, None)
    assert "declare another hold_roll_deg" in found.text


def test_every_move_says_that_it_voids_the_registration_and_how_short_it_could_be():
    _, found = advice(spot(890.0, 100.0))
    assert (found.none_possible, found.yaw_deg) == (False, 0.0)
    assert 0.0 < found.at_least_mm <= np.linalg.norm(found.translation_mm) + 0.1
    shown = math.floor(found.at_least_mm * 10.0) / 10.0
    assert (found.reserve_mm, found.reserve_deg) == (0.2, pytest.approx(0.1))
    assert (
        f"no translation shorter than {shown:.1f} mm keeps 0.2 mm beyond the deadband of arm and slide and "
        "0.1 deg beyond that of the roll (proved)"
    ) in found.text
    assert "needs a new registration, which voids every permit" in found.text


@pytest.mark.parametrize("seed", range(14))
def test_whatever_is_shown_as_verified_is_admitted_after_the_new_registration(seed):
    rng = np.random.default_rng(1000 + seed)
    path = replace(random_problem(rng, segments=4), speed=np.full(5, 1e3))
    path = guidance.moved(path, 0.0, (0, 0, 0), rng.normal(0.0, 80.0, 3))
    verdict = certified.verify(path)
    found = guide(path, verdict, quantise)
    if found is None:
        assert verdict.admissible
        return
    assert found.verified is (found.translation_mm is not None)
    assert not (found.none_possible is True and found.verified and found.yaw_deg == 0.0)
    if found.verified:
        again = certified.verify(registered(path, found))
        assert again.admissible
        least = min(b.certified for b in again.boundaries.values() if b.unit == "mm")
        assert least == pytest.approx(found.predicted_clearance_mm, abs=0.003)
