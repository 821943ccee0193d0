"""The search for the smallest translation: as short as it says, and never a wrong proof."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cutgate.runtime.verification import certified
from cutgate.runtime.verification.effort import Effort
from cutgate.runtime.verification.placing import search
from cutgate.runtime.verification.placing.freedom import Placing, Reserve
from cutgate.runtime.verification.placing.guidance import moved
from cutgate.runtime.verification.placing.search import FINEST_MM, TOLERANCE_MM, smallest_translation
from cutgate.runtime.verification.problem import Arm, ArmCalibration
from tests.runtime.verification.cases import DEG, axis, problem, random_problem, wrist_path
from tests.runtime.verification.placing.placements import admitted, grid

RESERVE = Reserve(0.2, 0.1 * DEG)
FAST = np.full(5, 1e9)


def strokes(x, y, z=200.0, *, lean=60 * DEG, azimuth=(0.2, 0.23, 0.25, 0.28), **changes):
    """Three short strokes about a place of the wrist centre: all points that count are poses."""
    at = [[x, y, z], [x + 8, y, z], [x + 8, y + 6, z + 4], [x, y + 6, z + 4]]
    return problem(*wrist_path(at, axis(lean, np.array(azimuth))), **changes)


def searched(path, reserve=RESERVE, effort=None, **options):
    """The answer of the search in the robot frame."""
    placing = Placing(path, reserve, effort=effort)
    found = smallest_translation(placing, **options)
    if found.translation_mm is None:
        return found, None
    return found, found.translation_mm * (1.0, placing.geometry.side, 1.0)


LEFT_ELBOW = {
    "arm": Arm(450.0, 450.0, "left"),
    "lower": np.array([-80, -145, 50, -170, 0]) * (DEG, DEG, 1, DEG, DEG),
    "upper": np.array([80, 0, 450, 170, 110]) * (DEG, DEG, 1, DEG, DEG),
}
NARROW_ROLL = {
    "lower": np.array([-80, 0, 50, 20, 0]) * (DEG, DEG, 1, DEG, DEG),
    "upper": np.array([80, 145, 450, 75, 110]) * (DEG, DEG, 1, DEG, DEG),
}
TILTED = {
    "calibration": ArmCalibration(
        1.0, -1.0, slide_tilt=np.array((0.02, -0.015)), residual_mm=0.3, residual_rad=0.002
    )
}
CASES = {
    "beyond the outer arc": strokes(870.0, 130.0),
    "in the hole": strokes(100.0, 20.0),
    "beyond a side": strokes(-300.0, 700.0),
    "left elbow": strokes(-300.0, 500.0, **LEFT_ELBOW),
    "roll": strokes(600.0, -100.0, **NARROW_ROLL),
    "too high on a leaning slide": strokes(880.0, 60.0, 520.0, **TILTED),
}


@pytest.mark.parametrize("name", CASES)
def test_no_translation_of_a_dense_grid_is_shorter_than_the_one_found(name):
    path = CASES[name]
    found, translation = searched(path)
    length = float(np.linalg.norm(translation))
    assert found.at_least_mm <= length <= found.at_least_mm + TOLERANCE_MM + FINEST_MM
    kept = {"reserve_mm": RESERVE.arm_mm, "reserve_rad": RESERVE.roll_rad}
    assert admitted(path, translation[None, :], reserve_mm=0.2 - 1e-6, reserve_rad=RESERVE.roll_rad - 1e-9)[0]
    for half, step in ((length + 5.0, (length + 5.0) / 18), (2.0, 0.11)):
        near = grid((0, 0, translation[2]) if half > 2.0 else translation, half, step)
        shorter = near[np.linalg.norm(near, axis=1) < found.at_least_mm]
        assert not admitted(path, shorter, **kept).any()


def test_a_path_that_fits_where_it_stands_needs_no_translation():
    found, translation = searched(strokes(600.0, 0.0))
    assert np.linalg.norm(translation) == 0.0
    assert found.at_least_mm == 0.0


NOWHERE = {
    "too wide": problem(*wrist_path([[-500.0, 0, 200], [500.0, 0, 200], [500.0, 700, 200]], axis(1.0, 0.2))),
    "wider than the reach": problem(*wrist_path([[-950.0, 0, 200], [950.0, 0, 200]], axis(1.0, 0.2))),
    "roll": strokes(600.0, 0.0, azimuth=np.linspace(0.0, 5.6, 4) % (2 * math.pi), **NARROW_ROLL),
}


@pytest.mark.parametrize("name", NOWHERE)
def test_where_no_translation_fits_it_is_proved_and_a_grid_over_the_whole_reach_finds_none(name):
    path = NOWHERE[name]
    found, translation = searched(path, Reserve())
    assert translation is None
    assert found.none_fits
    middle = (path.tips_mm + 160.0 * path.axes).mean(axis=0)
    assert not admitted(path, grid((-middle[0], -middle[1], 0.0), 950.0, 38.0)).any()


def test_a_path_taller_than_the_slide_is_proved_to_fit_nowhere():
    path = problem(*wrist_path([[600.0, 0.0, 40.0], [600.0, 0.0, 460.0]], axis(1.0, 0.2)))
    assert searched(path, Reserve())[0].none_fits


def test_exactly_as_tall_as_the_slide_is_neither_found_nor_proved_impossible():
    tall = problem(*wrist_path([[600.0, 0.0, 0.0], [600.0, 0.0, 390.001]], axis(1.0, 0.2)))
    found, translation = searched(tall, Reserve())
    assert (translation, found.none_fits) == (None, False)


def test_a_search_that_is_cut_short_proves_nothing():
    """Wherever that is, be it one point before its end."""
    whole = Effort()
    assert searched(NOWHERE["roll"], Reserve(), effort=whole)[0].none_fits
    for work in (whole.spent // 4, whole.spent // 2, whole.spent - 1):
        found, translation = searched(NOWHERE["roll"], Reserve(), effort=Effort(work))
        assert (translation, found.none_fits) == (None, False)
    assert searched(NOWHERE["roll"], Reserve(), effort=Effort(whole.spent))[0].none_fits


@pytest.mark.parametrize("name", CASES)
def test_what_a_search_that_is_cut_short_proves_is_no_more_than_what_the_whole_one_does(name):
    whole, _ = searched(CASES[name])
    for work in (12_000, 30_000, 60_000, 100_000, 200_000):
        found, translation = searched(CASES[name], effort=Effort(work))
        assert found.at_least_mm <= whole.at_least_mm + TOLERANCE_MM
        assert translation is None or np.linalg.norm(translation) >= whole.at_least_mm


def test_discs_that_are_given_up_undecided_prove_nothing():
    found, translation = searched(NOWHERE["roll"], Reserve(), finest_mm=60.0)
    assert (translation, found.none_fits) == (None, False)
    assert found.at_least_mm < 1000.0


@pytest.mark.parametrize("size", [(0.0, 0.0), (0.0, 300.0), (700.0, 123.4)])
def test_the_first_squares_cover_the_whole_domain(monkeypatch, size):
    low = np.array((-200.0, 50.0))
    monkeypatch.setattr(Placing, "domain", (low, low + size))
    squares = search._Search(Placing(strokes(600.0, 0.0), Reserve()), 0.01)._first()
    for point in low + np.random.default_rng(1).uniform(0, 1, (200, 2)) * size:
        assert (np.abs(squares.centre - point).max(axis=1) <= squares.half + 1e-9).any()


@pytest.mark.parametrize("near", [False, True])
@pytest.mark.parametrize("length", [0.0, 0.02, 7.0, 150.0, 5000.0])
def test_the_first_squares_cover_every_shift_by_a_shorter_translation_than_the_best(length, near):
    """On a leaning slide, where a shift may be longer than its translation."""
    placing = Placing(CASES["too high on a leaning slide"], Reserve())
    run = search._Search(placing, FINEST_MM)
    run.length, run.near = length, near
    squares, (low, high) = run._first(), placing.domain
    farthest = [(*side, -float(side @ placing.geometry.tilt)) for side in np.vstack((np.eye(2), -np.eye(2)))]
    translations = np.vstack((farthest, np.random.default_rng(2).normal(size=(2000, 3))))
    translations *= length / np.linalg.norm(translations, axis=1)[:, None]
    for shift in translations[:, :2] - translations[:, 2:] * placing.geometry.tilt:
        if ((low <= shift) & (shift <= high)).all():
            assert (np.abs(squares.centre - shift).max(axis=1) <= squares.half + 1e-9).any()


@pytest.mark.parametrize("near", [False, True])
@pytest.mark.parametrize("count", [0, 1, 3, 64, 65, 200])
def test_divided_squares_cover_what_they_divide_and_nothing_else(count, near):
    rng = np.random.default_rng(count)
    run = search._Search(Placing(strokes(600.0, 0.0), Reserve()), FINEST_MM)
    run.near = near
    half, least = rng.uniform(0.1, 9.0, count), rng.uniform(0.0, 100.0, count)
    squares = search._Squares(rng.normal(0.0, 100.0, (count, 2)), half, least)
    parts = run._divided(squares)
    each = len(parts) // max(count, 1)
    assert each == (0 if count == 0 else 16 if near and count <= 64 else 4)
    of = np.repeat(np.arange(count), each)
    assert (
        np.abs(parts.centre - squares.centre[of]).max(axis=1, initial=0.0) <= half[of] - parts.half + 1e-9
    ).all()
    np.testing.assert_allclose(parts.half, half[of] / math.sqrt(max(each, 1)))
    assert (parts.least >= least[of]).all()
    for corner in rng.uniform(-1.0, 1.0, (20, 2)):
        inside = squares.centre + corner * half[:, None]
        away = np.abs(parts.centre[None] - inside[:, None]).max(axis=2)
        assert (away <= parts.half + 1e-9).any(axis=1).all()


# -- the steps that come first ---------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(40))
def test_the_nearest_place_on_a_line_is_that_of_a_dense_look_along_it(seed):
    rng = np.random.default_rng(seed)
    line, others = rng.normal(size=3), rng.normal(size=(int(rng.integers(0, 7)), 3))
    found = search._nearest(line, others)
    foot = line[:2] * line[2] / (line[:2] @ line[:2])
    along = np.array((-line[1], line[0])) / np.hypot(*line[:2])
    places = foot + np.linspace(-30.0, 30.0, 200_001)[:, None] * along
    allowed = places[(places @ others[:, :2].T >= others[:, 2]).all(axis=1)]
    if found is None:
        assert len(allowed) == 0
        return
    assert found @ line[:2] == pytest.approx(line[2], abs=1e-9)
    assert (others[:, :2] @ found >= others[:, 2] - 1e-6).all()
    if len(allowed):
        assert np.hypot(*found) <= np.hypot(*allowed.T).min() + 1e-9


def test_a_line_without_a_direction_has_no_nearest_place():
    assert search._nearest(np.array((0.0, 0.0, 1.0)), np.empty((0, 3))) is None


@pytest.mark.parametrize("name", CASES)
def test_least_room_is_that_of_the_worst_point_and_changes_as_it_says(name):
    placing = Placing(CASES[name], RESERVE)
    for shift in np.random.default_rng(3).normal(0.0, 100.0, (20, 2)):
        margins = placing.arm_margins(shift[None, :], placing.sample)[0]
        worst = [np.argmin(margins)]
        least, gradient = placing.least_room(shift)
        assert least == pytest.approx(margins.min(), abs=1e-9)
        assert np.hypot(*gradient) <= 1.0 + 1e-6
        step = np.array((0.6, -0.8)) * 1e-5
        ahead, behind = placing.arm_margins(shift + np.array((step, -step)), placing.sample[worst])[:, 0]
        assert (ahead - behind) / 2e-5 == pytest.approx(gradient @ (0.6, -0.8), abs=1e-3)


@pytest.mark.parametrize("name", CASES)
def test_the_steps_lead_to_about_the_shortest_or_give_up_and_what_is_found_is_as_short(name):
    """They give up where the roll objects, and where the arm does so from far away and on several sides."""
    run = search._Search(Placing(CASES[name], RESERVE), FINEST_MM)
    found = run.run(any_will_do=False)
    assert run.near is (name not in {"roll", "left elbow"})
    assert np.linalg.norm(found.translation_mm) <= found.at_least_mm + TOLERANCE_MM + FINEST_MM


@pytest.mark.parametrize("seed", range(24))
def test_with_and_without_the_steps_neither_search_refutes_the_other(monkeypatch, seed):
    path, _ = displaced(seed)
    found, translation = searched(path)
    monkeypatch.setattr(search, "STEPS", 0)
    plain, other = searched(path)
    assert found.at_least_mm <= np.linalg.norm(other)
    assert plain.at_least_mm <= np.linalg.norm(translation)
    assert np.linalg.norm(translation) <= np.linalg.norm(other) + TOLERANCE_MM + FINEST_MM


def test_where_any_will_do_no_steps_are_taken(monkeypatch):
    monkeypatch.setattr(Placing, "least_room", None)
    assert searched(CASES["in the hole"], any_will_do=True)[1] is not None


@pytest.mark.parametrize("name", CASES)
def test_a_search_that_is_cut_short_in_its_steps_still_proves_no_more_than_is_true(name):
    built = Placing(CASES[name], RESERVE).effort.spent
    whole, _ = searched(CASES[name])
    for work in range(0, 12_000, 400):
        found, translation = searched(CASES[name], effort=Effort(built + work))
        assert found.at_least_mm <= whole.at_least_mm + TOLERANCE_MM
        assert translation is None or np.linalg.norm(translation) >= whole.at_least_mm


def test_no_disc_is_excluded_by_the_winding_of_a_shift_that_passes_the_column_on_the_other_side():
    """The roll fits only if the path passes the column on its left; the disc's centre passes on its right."""
    x = np.linspace(-400.0, 400.0, 81)
    path = problem(*wrist_path(np.stack((x, np.full(81, 30.0), np.full(81, 200.0)), axis=1), axis(1.0, 0.0)))
    heading = math.pi - math.atan2(30.0, 400.0) + math.acos(math.hypot(30.0, 400.0) / 900.0)
    path = replace(
        path,
        lower=np.array((-40.0, 0.0, 50.0, -heading - 0.4, 0.0)),
        upper=np.array((40.0, math.pi, 450.0, -heading + math.pi + 0.4, 2.0)),
    )
    placing = Placing(path, Reserve())
    assert placing.fits(np.zeros(2))
    assert not placing.fits(np.array((0.0, -60.0)))
    assert not placing.excluded(np.array([(0.0, -60.0)]), np.array([65.0]))[0].any()


def test_a_leaning_slide_is_allowed_for_in_what_is_proved_for_every_turn():
    """Fits a thin ring at one turn only, where the lean brings the high and the low point under each other."""
    elbow = [2.0 * math.acos(r / 900.0) for r in (847.0 + 9.0, 847.0 - 9.0)]
    lower = np.array((-1.4, elbow[0], 50.0, -60.0, 0.0))
    upper = np.array((1.4, elbow[1], 450.0, 60.0, 2.0))
    lean = ArmCalibration(slide_tilt=np.array((0.02, 0.0)))
    at = [[850.0, -80.0, 250.0], [848.2, 0.0, 60.0], [855.8, 0.0, 440.0], [850.0, 80.0, 250.0]]
    path = problem(*wrist_path(at, axis(1.0, 0.3)), lower=lower, upper=upper, calibration=lean)
    assert Placing(path, Reserve()).fits(np.zeros(2))
    turned = moved(path, 180.0, (700.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    found = smallest_translation(Placing(turned, Reserve(), shoulder=False), any_will_do=True, finest_mm=0.5)
    assert not found.none_fits


def displaced(seed):
    """A random problem that is admitted with room for the reserve, and how far it is then moved away."""
    rng = np.random.default_rng(seed)
    while True:
        path = replace(random_problem(rng, spinning=bool(rng.random() < 0.3)), speed=FAST)
        wide = replace(
            path,
            deadband=replace(
                path.deadband,
                arm_mm=path.deadband.arm_mm + 0.25,
                wrist_rad=path.deadband.wrist_rad + 0.15 * DEG,
            ),
        )
        if certified.verify(wide).admissible:
            break
    move = rng.normal(0.0, rng.choice([3.0, 60.0, 400.0]), 3)
    return moved(path, 0.0, (0, 0, 0), move), move


@pytest.mark.parametrize("seed", range(24))
def test_a_displaced_path_is_never_proved_hopeless_and_comes_back_no_longer_way(seed):
    path, move = displaced(seed)
    assert not searched(path, Reserve(), any_will_do=True)[0].none_fits
    found, translation = searched(path)
    assert found.at_least_mm <= np.linalg.norm(move)
    assert np.linalg.norm(translation) <= np.linalg.norm(move) + TOLERANCE_MM


@pytest.mark.parametrize("seed", range(12))
def test_no_disc_is_excluded_that_holds_a_shift_that_fits(seed):
    """Discs about a known shift, of every size and off centre: the proof must never cover it."""
    path, move = displaced(seed)
    rng = np.random.default_rng(seed)
    placing = Placing(path, RESERVE)
    tilt = placing.geometry.tilt
    back = -move * (1.0, placing.geometry.side, 1.0)
    known = back[:2] - back[2] * tilt
    radii = 10.0 ** rng.uniform(-4, 3, 400)
    off = rng.normal(size=(400, 2))
    centres = known + off / np.linalg.norm(off, axis=1)[:, None] * (radii * rng.uniform(0, 1, 400))[:, None]
    assert not placing.excluded(centres, radii)[0].any()


@pytest.mark.parametrize("seed", range(12))
def test_a_turned_and_displaced_path_is_never_proved_hopeless_for_every_turn(seed):
    path, _ = displaced(seed)
    turned = moved(
        path, float(np.random.default_rng(seed).uniform(-180, 180)), (100.0, -50.0, 0.0), (0, 0, 0)
    )
    placing = Placing(turned, Reserve(), shoulder=False)
    assert not smallest_translation(placing, any_will_do=True).none_fits


def test_what_is_proved_for_every_turn_holds_for_each():
    path = NOWHERE["roll"]
    assert smallest_translation(Placing(path, Reserve(), shoulder=False)).none_fits
    for yaw in (-150.0, -40.0, 35.0, 110.0):
        turned = moved(path, yaw, (500.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        assert searched(turned, Reserve())[0].none_fits


def test_what_one_turn_cures_is_not_proved_hopeless_for_every_turn():
    """A stroke across a thin ring sector: no translation, but a turn."""
    lower, upper = np.array((-0.35, 0.6, 50.0, -3.0, 0.0)), np.array((0.35, 0.9, 450.0, 3.0, 1.9))
    at = [[780.0, 300.0, 200.0], [880.0, 300.0, 200.0]]
    path = problem(*wrist_path(at, axis(1.0, 0.2)), lower=lower, upper=upper)
    assert smallest_translation(Placing(path, Reserve()), any_will_do=True).none_fits
    assert not smallest_translation(Placing(path, Reserve(), shoulder=False), any_will_do=True).none_fits
