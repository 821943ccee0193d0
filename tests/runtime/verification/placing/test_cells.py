"""What a map proves of squares: every place within them, tried out by the whole verification as it would be sent."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cutgate.runtime.verification import certified
from cutgate.runtime.verification.placing import cells, reach
from cutgate.runtime.verification.placing.cells import Lattice, PathAtYaw, State, everywhere
from cutgate.runtime.verification.placing.guidance import moved, pivot_of
from cutgate.runtime.verification.placing.room import Room
from cutgate.runtime.verification.placing.survey import Work, squares, workers_for
from docs.make_pictures import hip_stem
from tests.runtime.verification.cases import axis, problem, wrist_path
from tests.runtime.verification.placing.surveyed import survey
from tests.runtime.verification.placing.test_reach import CASES as STROKES
from tests.runtime.verification.placing.test_tolerated import CASES as PATHS

CASES = {**PATHS, **STROKES}
TRIED, TRIED_LONG = 60, 1000


def work_of(path):
    return Work(path, path.feed_mm_s, path.tool_length_mm)


def surveyed(path, yaw_deg, lift_mm=0.0, step_mm=150.0):
    grid = reach.grid_of(path, step_mm, (yaw_deg,), (lift_mm,))
    return grid, survey(work_of(path), grid, 1, lambda _: None)


def admitted(path, yaw_deg, translation_mm):
    """By the certified method, moved and quantised."""
    work, place = work_of(path), moved(path, yaw_deg, pivot_of(path), translation_mm)
    tips, axes = work.quantise(place.tips_mm, place.axes)
    return certified.verify(replace(place, tips_mm=tips, axes=axes, branch=None)).admissible


def places(squares_, state, rng, count):
    """Anywhere in squares of a state, most of them where it may be wrong: in small squares, at corners and on edges."""
    chosen = np.flatnonzero(squares_.states == state)
    if len(chosen) == 0:
        return np.zeros((0, 2))
    level = squares_.where[chosen, 0] + 1.0
    chosen = rng.choice(chosen, count, p=level / level.sum())
    within = rng.uniform(-1.0, 1.0, (count, 2))
    within[::3] = np.sign(within[::3])
    within[1::3, 0] = np.sign(within[1::3, 0])
    return squares_.middles_mm[chosen] + within * squares_.sides_mm[chosen, None] / 2.0


def tried(names, count):
    """As many places of either kind, of all these cases together."""
    rng, counts = np.random.default_rng(8), dict.fromkeys((State.ADMISSIBLE, State.INADMISSIBLE), 0)
    for name in names:
        path, yaw = CASES[name], float(rng.choice((-15.0, 0.0, 10.0)))
        _, (_, (found,), _) = surveyed(path, yaw)
        for state in counts:
            for x, y in places(found, state, rng, math.ceil(count / len(names))):
                assert admitted(path, yaw, (x, y, 0.0)) is (state == State.ADMISSIBLE), (name, x, y, yaw)
                counts[state] += 1
    return counts


def test_every_place_in_a_square_is_what_the_square_is(monkeypatch):
    monkeypatch.setattr(cells, "UNKNOWN_MAX", 0.2)
    counts = tried(("narrow", "a narrow roll", "left elbow"), TRIED)
    assert min(counts.values()) >= TRIED


@pytest.mark.long
@pytest.mark.parametrize("name", [*CASES, "hip stem"])
def test_every_place_of_many_in_a_square_is_what_the_square_is(name, monkeypatch):
    monkeypatch.setitem(CASES, "hip stem", hip_stem("second")[0])
    counts = tried((name,), TRIED_LONG)
    assert counts[State.INADMISSIBLE] >= TRIED_LONG
    assert counts[State.ADMISSIBLE] >= TRIED_LONG or Room.of(CASES[name]) is None


def test_squares_cover_the_map_once_and_little_of_it_is_unknown():
    path = STROKES["right elbow"]
    grid, (_, (found,), _) = surveyed(path, 0.0, step_mm=70.0)
    whole = len(grid.x_mm) * len(grid.y_mm) * 70.0**2
    assert sum(found.area_mm2(state) for state in State) == pytest.approx(whole)
    assert found.area_mm2(State.ADMISSIBLE) > 0.1 * whole
    assert found.unknown_share <= cells.UNKNOWN_MAX
    assert found.area_mm2(State.UNKNOWN) < 0.02 * whole
    low, high = found.middles_mm - found.sides_mm[:, None] / 2, found.middles_mm + found.sides_mm[:, None] / 2
    assert low.min(axis=0) == pytest.approx((grid.x_mm[0] - 35.0, grid.y_mm[0] - 35.0))
    assert high.max(axis=0) == pytest.approx((grid.x_mm[-1] + 35.0, grid.y_mm[-1] + 35.0))
    rng = np.random.default_rng(1)
    for place in rng.uniform(low.min(axis=0), high.max(axis=0), (200, 2)):
        assert ((low < place) & (place < high)).all(axis=1).sum() == 1


def test_a_position_agrees_with_its_square():
    path = STROKES["right elbow"]
    _, (positions, (found,), middles) = surveyed(path, 0.0, step_mm=60.0)
    of_squares, itself = found.of_positions()
    assert {p.cell for p in positions} >= {"admissible", "inadmissible", "parted"}
    for p, state, proved in zip(positions, of_squares.ravel(), itself.ravel(), strict=True):
        assert reach.CELLS[state] == p.cell
        assert p.admissible or not (proved or p.cell == "admissible")
        assert not (p.admissible and p.cell == "inadmissible")
    for p, state in zip(middles[0], found.states[found.smaller], strict=True):
        assert p.admissible is bool(state == State.ADMISSIBLE)


@pytest.mark.parametrize("step_mm", [0.5, 3.0, 20.0, 129.0, 500.0])
def test_a_square_of_the_step_has_a_position_in_its_middle(step_mm):
    x, y = tuple(step_mm * k for k in range(-3, 9)), tuple(step_mm * k for k in range(-2, 5))
    lattice = Lattice.over(x, y, step_mm)
    assert lattice.side_mm(lattice.whole) == step_mm
    i, j = np.meshgrid(np.arange(12), np.arange(7))
    middles = lattice.middles_mm(np.stack((i.ravel(), j.ravel()), axis=1), lattice.whole)
    np.testing.assert_allclose(middles, [(a, b) for b in y for a in x], atol=1e-9)
    found = everywhere(0.0, 0.0, lattice, State.INADMISSIBLE)
    assert found.area_mm2(State.INADMISSIBLE) == pytest.approx(84 * step_mm**2)
    assert (found.of_positions()[0] == State.INADMISSIBLE).all()


def test_a_slide_that_is_too_short_excludes_everything():
    path = STROKES["right elbow"]
    _, (positions, (found,), _) = surveyed(path, 0.0, lift_mm=900.0, step_mm=300.0)
    assert (found.states == State.INADMISSIBLE).all()
    assert {(p.admissible, p.cell) for p in positions} == {(False, "inadmissible")}
    assert "top" in {p.limiting for p in positions}


def test_where_the_work_is_spent_the_rest_is_unknown_and_positions_are_judged_still(monkeypatch):
    path = STROKES["right elbow"]
    monkeypatch.setattr("cutgate.runtime.verification.placing.survey.WORK", 150_000)
    monkeypatch.setattr("cutgate.runtime.verification.placing.survey.PART", 10**9)
    _, (positions, (found,), _) = surveyed(path, 0.0)
    assert found.unknown_share > cells.UNKNOWN_MAX
    assert any(p.admissible for p in positions)
    for p in positions:
        assert p.admissible is admitted(path, 0.0, (p.x_mm, p.y_mm, 0.0))


def test_what_is_unknown_and_stays_so_is_not_parted_for_ever():
    """Joints so slow that one look proves nothing of them: a whole region, not its rim."""
    _, (_, (found,), _) = surveyed(STROKES["slow joints"], 0.0)
    assert found.unknown_share > cells.UNKNOWN_MAX
    assert found.sides_mm.min() > cells.FINEST_MM


@pytest.mark.parametrize(
    "name", ["as it is", "narrow", "calibrated", "left elbow", "coarse", "a narrow roll"]
)
def test_room_is_never_more_than_there_is_and_almost_all_of_it(name):
    path, rng = CASES[name], np.random.default_rng(3)
    plane = PathAtYaw(path, 0.0)
    g, seen = plane.room.geometry, 0
    for x, y in rng.uniform(-400.0, 400.0, (400, 2)):
        verdict = certified.verify(moved(path, 0.0, (0, 0, 0), (x, y, 0.0)))
        if not verdict.admissible:
            continue
        seen += 1
        shift, b = plane.shifts(np.array([[x, y]]), 0.0), verdict.boundaries
        kept = plane.room.kept(shift, np.full(1, 1e9))
        sides = ("inner", "outer", "left", "right") if g.side > 0 else ("inner", "outer", "right", "left")
        true = np.array([b[side].clearance for side in sides])
        assert (kept.arm_mm[:, 0] <= true).all()
        nearest = int(np.argmin(true))
        assert kept.arm_mm[:, 0].min() >= true[nearest] - 0.4
        roll = min(b["roll_min"].clearance, b["roll_max"].clearance)
        assert math.degrees(kept.roll_rad[0]) <= roll + 1e-9
        if seen == 12:
            break
    assert seen >= 3


def test_two_levels_of_work_are_told_to_the_caller():
    path, told = STROKES["right elbow"], []
    grid = reach.grid_of(path, 200.0, (0.0,), (0.0,))
    with workers_for(work_of(path), 1) as workers:
        squares(work_of(path), workers, grid, told.append)
    assert 0.9 * len(grid) < sum(told) <= len(grid)


def test_a_disc_is_proved_up_to_the_nearest_limit_and_no_further():
    """The room that is read off only says what is worth a proof: the proof itself takes the disc."""
    plane = PathAtYaw(PATHS["narrow"], 0.0)
    keep = plane.room.geometry.arm_mm
    room = float(plane.room.kept(np.zeros((1, 2)), np.full(1, np.inf)).arm_mm.min()) - keep
    assert plane.holds((0.0, 0.0, 0.0), room - 1.5)
    assert not plane.holds((0.0, 0.0, 0.0), room + 0.5)


def test_a_level_disc_needs_no_room_above():
    path = PATHS["as it is"]
    lift = PathAtYaw(path, 0.0).placing.lift_mm[1] - 0.2
    plane = PathAtYaw(path, 0.0)
    assert plane.holds((0.0, 0.0, lift), 5.0)
    assert not plane.holds((0.0, 0.0, lift + 0.3), 0.0)


def test_what_a_long_segment_nears_between_its_poses_is_counted():
    """Past the column, nearest to it in the middle of the segment."""
    past = problem(*wrist_path([[340.0, -60.0, 200.0], [340.0, 60.0, 200.0]], axis([0.6, 0.6], [0.3, 0.3])))
    true = certified.verify(past).boundaries["inner"].clearance
    kept = Room.of(past).kept(np.zeros((1, 2)), np.full(1, np.inf)).arm_mm[0, 0]
    assert math.hypot(340.0, 60.0) - 340.0 > 5.0
    assert true - 0.01 < kept <= true


def test_a_path_too_long_to_be_looked_at_so_often_is_judged_one_by_one(monkeypatch):
    path = STROKES["right elbow"]
    monkeypatch.setattr(cells, "LONGEST_POSES", len(path.tips_mm) - 1)
    _, (positions, (found,), _) = surveyed(path, 0.0, step_mm=300.0)
    assert set(found.states) <= {State.INADMISSIBLE, State.UNKNOWN}
    assert {p.checked for p in positions} == {"certified", "pose"}
