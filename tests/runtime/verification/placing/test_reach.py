"""The map of bone positions: every mark agrees with the certified method, wherever it came from."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cutgate.runtime.verification import certified
from cutgate.runtime.verification.placing import cells, reach
from cutgate.runtime.verification.placing.guidance import guide, pivot_of
from cutgate.runtime.verification.placing.survey import Work
from cutgate.runtime.verification.problem import ArmCalibration
from tests.runtime.verification.cases import DEG, axis, problem, wrist_path
from tests.runtime.verification.placing.surveyed import survey
from tests.runtime.verification.placing.test_guidance import LEAN, THIN, registered
from tests.runtime.verification.placing.test_search import LEFT_ELBOW, NARROW_ROLL, TILTED, strokes

CASES = {
    "right elbow": strokes(600.0, 0.0),
    "left elbow": strokes(600.0, 0.0, **LEFT_ELBOW),
    "a narrow roll": strokes(600.0, 0.0, **NARROW_ROLL),
    "a leaning slide": strokes(600.0, 0.0, **TILTED),
    "a shoulder of more than a turn": strokes(
        600.0, 0.0, lower=np.array([-4.0, 0.3, 50.0, -3.0, 0.0]), upper=np.array([4.0, 2.4, 450.0, 3.0, 1.9])
    ),
    "slow joints": strokes(600.0, 0.0, speed=np.array([0.04, 0.04, 200.0, 2.0, 2.0])),
}


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    """Squares are not parted so often here."""
    monkeypatch.setattr(cells, "UNKNOWN_MAX", 0.25)


def judged(path, grid):
    return survey(Work(path, path.feed_mm_s, path.tool_length_mm), grid, 1, lambda _: None).positions


def at(path, position):
    """The certified verdict on the contract's new registration, made here with 4x4 matrices."""
    translation = (position.x_mm, position.y_mm, position.lift_mm)
    move = type("Move", (), {})()
    move.yaw_deg, move.pivot_mm, move.translation_mm = position.yaw_deg, pivot_of(path), translation
    return certified.verify(registered(path, move))


@pytest.mark.parametrize("name", CASES)
def test_every_mark_agrees_with_the_certified_method(name):
    path = CASES[name]
    grid = replace(reach.grid_of(path, 300.0, (-70.0, 0.0), (0.0,)), lift_mm=(0.0, -140.0))
    positions = judged(path, grid)
    assert len(positions) == len(grid)
    for p in positions:
        verdict = at(path, p)
        assert p.admissible is verdict.admissible
        if p.checked == "pose":
            assert not p.admissible
            # a roll beyond its limits is nearer to the one end or the other, by the turn that is looked at
            names = ("roll_min", "roll_max") if p.limiting.startswith("roll") else (p.limiting,)
            assert min(verdict.boundaries[name].certified for name in names) <= p.clearance + 0.01
        elif p.limiting.startswith("speed"):
            assert not verdict.speed[int(p.limiting[-1])].ok
        elif p.clearance is not None:
            least = verdict.boundaries[p.limiting].certified
            if p.checked == "proved":
                assert p.clearance - 0.01 <= least <= p.clearance + 0.3
            else:
                assert least == pytest.approx(p.clearance, abs=0.01)
            assert p.ratio == pytest.approx(p.clearance / p.bound)
            assert (p.ratio >= 1.0) or not p.admissible
    assert any(p.admissible for p in positions)
    kinds = {p.checked for p in positions}
    assert (
        kinds == {"pose", "certified"}
        if name == "a shoulder of more than a turn"
        else kinds >= {"pose", "proved"}
    )


def test_the_limiting_boundary_has_the_smallest_clearance_per_deadband():
    path = CASES["right elbow"]
    for p in judged(path, reach.grid_of(path, 250.0, (0.0,), (0.0,))):
        if p.admissible:
            verdict = at(path, p)
            least = min(b.certified / b.deadband for b in verdict.boundaries.values())
            assert least - 0.05 <= p.ratio <= least + 0.005


def test_joints_that_are_too_fast_are_named_where_every_boundary_is_kept():
    path = CASES["slow joints"]
    positions = judged(path, reach.grid_of(path, 160.0, (0.0,), (0.0,)))
    fast = [p for p in positions if p.limiting.startswith("speed")]
    assert fast
    assert all(
        not p.admissible and p.unit == "rad/s" and p.clearance > p.bound and p.ratio < 1.0 for p in fast
    )


@pytest.mark.parametrize("name", CASES)
def test_no_position_off_the_grid_is_admissible(name):
    path, rng = CASES[name], np.random.default_rng(1)
    grid = reach.grid_of(path, 50.0, (0.0,), (0.0,))
    ends = ((grid.x_mm[0], grid.x_mm[-1]), (grid.y_mm[0], grid.y_mm[-1]))
    for x, y in rng.uniform(-2500, 2500, (60, 2)):
        if not (ends[0][0] <= x <= ends[0][1] and ends[1][0] <= y <= ends[1][1]):
            position = reach.judged(path, lambda tips, axes: (tips, axes), 0.0, (x, y, 0.0))
            assert not position.admissible


def test_the_grid_holds_the_place_where_the_bone_stands_in_whole_steps():
    far = strokes(3000.0, 2000.0)
    grid = reach.grid_of(far, 70.0, (0.0, 30.0), (0.0,))
    assert 0.0 in grid.x_mm
    assert 0.0 in grid.y_mm
    assert all(x % 70.0 == 0.0 for x in grid.x_mm)
    assert grid.x_mm[0] < -2500.0
    assert len(judged(far, replace(grid, x_mm=(0.0,), y_mm=(0.0,), yaw_deg=(0.0,)))) == 1


def test_a_tilt_that_no_position_cures_is_said_of_every_position_without_more_ado(monkeypatch):
    path = problem(*wrist_path([[600.0, 0.0, 200.0], [620.0, 0.0, 200.0]], axis(112 * DEG, 0.3)))
    monkeypatch.setattr(reach, "judged", None)
    positions = judged(path, reach.grid_of(path, 300.0, (0.0,), (0.0,)))
    assert {(p.admissible, p.limiting, p.checked) for p in positions} == {(False, "pitch_max", "pose")}


def test_an_undefined_boundary_is_named_where_no_known_one_is_violated():
    path = CASES["right elbow"]
    verdict = at(path, judged(path, reach.Grid(1.0, (0.0,), (0.0,), (0.0,), (0.0,)))[0])
    lost = replace(verdict.boundaries["roll_min"], certified=None, clearance=None, violated=True)
    verdict = replace(verdict, admissible=False, boundaries={**verdict.boundaries, "roll_min": lost})
    p = reach._position((0.0, 0.0, 0.0, 0.0), verdict)
    assert (p.admissible, p.limiting, p.clearance, p.ratio) == (False, "roll_min", None, None)


def plain(tips, axes):
    return tips, axes


def test_a_map_starts_at_the_present_height_where_the_path_is_admissible_there():
    path = strokes(600.0, 0.0)
    assert certified.verify(path).admissible
    assert reach.start(path, plain) == reach.GridStart(0.0, 0.0, "present")


@pytest.mark.parametrize("height", [30.0, 600.0])
def test_a_map_starts_from_the_height_that_guidance_would_choose(height):
    path = strokes(600.0, 0.0, height)
    chosen = guide(path, certified.verify(path), plain)
    assert chosen.verified
    assert chosen.translation_mm[2] != 0.0
    begun = reach.start(path, plain)
    assert begun == reach.GridStart(0.0, chosen.translation_mm[2], "guidance", chosen.translation_mm)
    x, y, lift = begun.move_mm
    assert reach.judged(path, plain, begun.yaw_deg, (x, y, lift)).admissible


def test_a_map_starts_with_the_turn_that_guidance_needs():
    stroke = [[780.0, 300.0, 600.0], [880.0, 300.0, 600.0]]
    path = problem(*wrist_path(stroke, LEAN), **THIN)
    chosen = guide(path, certified.verify(path), plain)
    assert chosen.verified
    assert chosen.yaw_deg != 0.0
    assert reach.start(path, plain).yaw_deg == chosen.yaw_deg


@pytest.mark.parametrize(
    ("heights", "begun"),
    [
        ((600.0, 600.0), reach.GridStart(0.0, -350.0, "slide")),
        ((200.0, 200.0), reach.GridStart(0.0, 0.0, "present")),
        ((-400.0, 900.0), reach.GridStart(0.0, 0.0, "present")),
    ],
    ids=["too high", "fits", "taller than the slide"],
)
def test_where_guidance_knows_no_move_a_map_starts_where_the_slide_has_room(heights, begun):
    down = axis(112 * DEG, 0.3)
    path = problem(*wrist_path([[600.0, 0.0, heights[0]], [620.0, 0.0, heights[1]]], down))
    assert not guide(path, certified.verify(path), plain).verified
    assert reach.start(path, plain) == begun


def test_the_outline_is_the_workspace_of_the_robot_as_given():
    for path, sign in ((CASES["right elbow"], 1.0), (CASES["left elbow"], -1.0)):
        arcs = dict(reach.outline(path))
        np.testing.assert_allclose(np.hypot(*arcs["outer"].T), 900.0)
        limit = path.upper[0]  # left is the boundary at q0's upper limit, for both elbows
        elbow = 450.0 * np.array((math.cos(limit), math.sin(limit)))
        np.testing.assert_allclose(np.hypot(*(arcs["left"] - elbow).T), 450.0)
        heading = limit + sign * 1.0
        on = elbow + 450.0 * np.array((math.cos(heading), math.sin(heading)))
        assert np.hypot(*(arcs["left"] - on).T).min() < 10.0


def test_a_calibrated_robot_is_mapped_with_its_residuals():
    path = strokes(600.0, 0.0, calibration=ArmCalibration(residual_mm=3.0))
    grid = reach.Grid(1.0, (0.0,), (0.0,), (0.0,), (0.0,))
    (p,) = judged(path, grid)
    assert p.bound in {8.0, 2.0}


def test_joints_that_accelerate_too_much_limit_with_their_unit():
    hasty = strokes(600.0, 0.0, acceleration=np.array([1e-9, 1.0, 1000.0, 10.0, 10.0]))
    work = Work(hasty, hasty.feed_mm_s, hasty.tool_length_mm)
    p = reach.judged(hasty, work.quantise, 0.0, (0.0, 0.0, 0.0))
    assert not p.admissible
    assert (p.limiting, p.unit, p.bound) == ("acceleration_q0", "rad/s2", 1e-9)
    assert p.ratio == pytest.approx(p.bound / p.clearance)
    assert p.ratio < 1.0
