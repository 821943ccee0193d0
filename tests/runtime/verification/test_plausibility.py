"""What looks wrong with files that are sound in themselves, and where the cut lies."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cutgate.runtime.kinematics.landmarks import CheckPoints, PointResidual
from cutgate.runtime.verification import certified, plausibility
from cutgate.runtime.verification.advice import Guidance
from cutgate.runtime.verification.plausibility import (
    Placed,
    cautions,
    cautions_of_move,
    cautions_of_reading,
    described,
    extent,
    place,
)
from tests.runtime.verification.cases import axis, problem, wrist_path


def case(size_mm=50.0, turning=0.2, **changes):
    t = np.linspace(0.0, 1.0, 5)
    wrist = np.column_stack(
        (600.0 + size_mm * t, 20.0 * t * size_mm / 50.0, 200.0 - 10.0 * t * size_mm / 50.0)
    )
    return problem(*wrist_path(wrist, axis(0.5 + turning * t, turning * t)), **changes)


def at(*translation):
    placed = np.eye(4)
    placed[:3, 3] = translation
    return placed


def found_in(one, placed=None):
    return cautions(one, certified.verify(one), placed)


def move(translation, yaw_deg=0.0):
    return Guidance(translation, yaw_deg, (0.0, 0.0, 0.0), (), 1.0, True, "moved")


def codes(found):
    return [one.code for one in found]


def test_the_extent_is_that_of_every_tip():
    found, one = extent(case()), case()
    for k in range(3):
        assert found.min_mm[k] == min(tip[k] for tip in one.tips_mm)
        assert found.max_mm[k] == max(tip[k] for tip in one.tips_mm)
    assert found.entry_tip_mm == tuple(one.tips_mm[0])
    assert found.tilt_deg == pytest.approx((math.degrees(0.5), math.degrees(0.7)))


def test_a_worst_place_lies_on_the_tips_path():
    one = case()
    for boundary in certified.verify(one).boundaries.values():
        tip = np.array(place(one, boundary))
        begin, end = one.tips_mm[boundary.segment], one.tips_mm[boundary.segment + 1]
        assert np.linalg.norm(tip - begin) + np.linalg.norm(tip - end) == pytest.approx(
            np.linalg.norm(end - begin)
        )
        assert place(one, replace(boundary, segment=None, fraction=None)) is None


def test_an_ordinary_case_gives_no_warning():
    assert found_in(case(), Placed(at(500.0, 0.0, 0.0), 0.4, 0.5)) == found_in(case()) == ()


@pytest.mark.parametrize(
    ("size_mm", "code"),
    [(0.05, "CUT_TINY"), (0.5, "CUT_TINY"), (2.0, None), (700.0, None), (1500.0, "CUT_HUGE")],
)
def test_a_cut_in_another_unit_is_too_small_or_too_large(size_mm, code):
    found = found_in(case(size_mm, 0.0))
    assert codes(found) == ([code] if code else [])
    for one in found:
        assert one.value == pytest.approx(extent(case(size_mm, 0.0)).size_mm)
        assert (one.value < one.bound) is (code == "CUT_TINY")
        assert one.confirm


@pytest.mark.parametrize(
    ("length_mm", "warns"), [(0.0, True), (0.5, True), (9.9, True), (10.1, False), (500.0, False)]
)
def test_a_registration_that_moves_the_ct_hardly_is_told(length_mm, warns):
    found = found_in(case(), Placed(at(0.0, -length_mm, 0.0), 0.1))
    assert codes(found) == ["CT_TRANSLATION_SMALL"] * warns
    assert not any(one.confirm for one in found), "a plan in robot coordinates has it"


@pytest.mark.parametrize(
    ("residual_mm", "bound_mm", "warns"), [(0.5, None, False), (0.5, 0.5, False), (0.51, 0.5, True)]
)
def test_a_residual_over_the_sites_bound_is_told(residual_mm, bound_mm, warns):
    found = found_in(case(), Placed(at(500.0, 0.0, 0.0), residual_mm, bound_mm))
    assert codes(found) == ["REGISTRATION_RESIDUAL"] * warns
    assert [(one.value, one.bound) for one in found] == [(residual_mm, bound_mm)] * warns


def checked(*residuals_mm, tolerance_mm=2.0, least=0):
    points = tuple(PointResidual(f"P{k}", off_mm) for k, off_mm in enumerate(residuals_mm))
    return Placed(at(500.0, 0.0, 0.0), 0.1, check_points=CheckPoints(points, tolerance_mm, least))


@pytest.mark.parametrize(
    ("placed", "code", "value", "bound"),
    [
        (checked(), None, None, None),
        (checked(0.0, 2.0), None, None, None),
        (checked(0.0, 2.0, least=2), None, None, None),
        (checked(0.0, 2.0001), "CHECK_POINT_OFF", 2.0001, 2.0),
        (checked(5.0, 0.1, 7.5, tolerance_mm=3.0), "CHECK_POINT_OFF", 7.5, 3.0),
        (checked(0.0, 2.0, least=3), "CHECK_POINTS_MISSING", 2.0, 3.0),
        (checked(least=1), "CHECK_POINTS_MISSING", 0.0, 1.0),
    ],
)
def test_a_check_point_that_is_off_and_one_that_is_missing_are_told(placed, code, value, bound):
    found = found_in(case(), placed)
    assert [(one.code, one.value, one.bound) for one in found] == ([(code, value, bound)] if code else [])
    assert not any(one.confirm for one in found), "nobody confirms it away: run refuses"


def test_the_worst_check_point_is_named_and_how_many_are_off():
    (found,) = found_in(case(), checked(5.0, 0.1, 7.5, tolerance_mm=3.0))
    assert found.text.startswith("check point P2 is 7.5 mm off, more than 3 mm, 2 of 3 are off: ")
    assert "check units, direction and frame (LPS or RAS)" in found.text


def test_limits_in_radians_are_told():
    lower, upper = np.radians((-1.4, 0.0, 0.0, -2.97, 0.0)), np.radians((1.4, 2.5, 0.0, 2.97, 1.92))
    lower[2], upper[2] = 50.0, 450.0
    (found,) = found_in(case(lower=lower, upper=upper))
    assert (found.code, found.confirm) == ("LIMITS_IN_RADIANS", True)
    assert found.text.startswith("q0, q1, q3, q4 may not leave +-2.97 deg")


@pytest.mark.parametrize("joint", [0, 1, 3, 4])
def test_one_joints_limits_in_radians_are_told_and_a_little_more_are_not(joint):
    usual = case()
    lower, upper = np.array(usual.lower), np.array(usual.upper)
    lower[joint], upper[joint] = math.radians(-2.0), math.radians(6.28)
    (found,) = found_in(case(lower=lower, upper=upper))
    assert found.text.startswith(f"q{joint} may not leave +-6.28 deg")
    assert (found.value, found.confirm) == (pytest.approx(6.28), True)
    upper[joint] = math.radians(6.3)
    assert found_in(case(lower=lower, upper=upper)) == ()


@pytest.mark.parametrize(
    ("deg", "warns"), [(math.radians(2.0), True), (0.099, True), (0.1, False), (0.5, False)]
)
def test_a_deadband_in_radians_is_told(deg, warns):
    found = found_in(replace(case(), deadband=replace(case().deadband, wrist_rad=math.radians(deg))))
    assert codes(found) == ["DEADBAND_IN_RADIANS"] * warns
    assert all(one.confirm and one.value == pytest.approx(deg) and one.bound == 0.1 for one in found)


@pytest.mark.parametrize(
    ("guidance", "code"),
    [
        (None, None),
        (move(None), None),
        (move((100.0, 100.0, 0.0)), None),
        (move((149.0, 0.0, 0.0), 15.0), None),
        (move((100.0, 100.0, 60.0)), "MOVE_LARGE"),
        (move((1.0, 0.0, 0.0), -15.5), "TURN_LARGE"),
    ],
)
def test_a_large_move_is_doubted_before_it_is_made(guidance, code):
    found = cautions_of_move(guidance)
    assert codes(found) == ([code] if code else [])
    for one in found:
        assert "check units, direction and frame (LPS or RAS) of the registration first" in one.text
        assert abs(one.value) > one.bound
        assert not one.confirm, "an inadmissible path is not permitted, confirmed or not"
        assert json.dumps(one.value)


MISREADINGS = {
    "REGISTRATION_INVERTED": np.linalg.inv,
    "REGISTRATION_TRANSPOSED": lambda r: np.block(
        [[r[:3, :3].T, r[:3, 3:]], [np.array([[0.0, 0.0, 0.0, 1.0]])]]
    ),
    "REGISTRATION_IN_METRES": lambda r: np.block(
        [[r[:3, :3], r[:3, 3:] / 1000.0], [np.array([[0.0, 0.0, 0.0, 1.0]])]]
    ),
    "REGISTRATION_FRAME": lambda r: r @ np.diag([-1.0, -1.0, 1.0, 1.0]),
}


@pytest.mark.parametrize("code", MISREADINGS)
def test_a_registration_that_was_written_otherwise_than_it_is_read_is_told(code):
    turn = 1.4
    right = at(420.0, -160.0, 230.0)
    right[:2, :2] = [[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]
    cut = case()
    written = MISREADINGS[code](right)
    to_ct = np.linalg.inv(right)
    by = written @ to_ct  # where it is put who reads what was written
    misplaced = replace(cut, tips_mm=cut.tips_mm @ by[:3, :3].T + by[:3, 3], axes=cut.axes @ by[:3, :3].T)
    verdict = certified.verify(misplaced)
    assert not verdict.admissible
    found = cautions_of_reading(misplaced, verdict, written)
    assert code in codes(found)
    assert all(one.value > one.bound for one in found)
    assert {*codes(found)} <= {*codes(cautions(misplaced, verdict, Placed(written, 0.1)))}
    assert cautions_of_reading(cut, certified.verify(cut), right) == ()


def test_a_described_document_is_plain_data_that_says_where_the_cut_lies_and_what_looks_wrong():
    one = case(0.5, 0.0)
    verdict = certified.verify(one)
    document = {"boundaries": {name: {"unit": line.unit} for name, line in verdict.boundaries.items()}}
    told = described(document, one, verdict, cautions(one, verdict, None), None)
    assert json.loads(json.dumps(told)) == told
    assert told["extent"]["entry_tip_mm"] == list(one.tips_mm[0])
    assert [(warning["code"], warning["confirm"]) for warning in told["warnings"]] == [("CUT_TINY", True)]
    assert told["check_points"] == []
    points = CheckPoints((PointResidual("P1", 0.5), PointResidual("P2", 9.0)))
    placed = Placed(np.eye(4), 0.1, check_points=points)
    again = described(document, one, verdict, (), placed)
    assert again["check_points"] == [
        {"id": "P1", "residual_mm": 0.5},
        {"id": "P2", "residual_mm": 9.0},
    ]
    for name, line in verdict.boundaries.items():
        assert told["boundaries"][name] == {"unit": line.unit, "tip_mm": list(place(one, line))}


def test_the_page_names_every_warning_and_which_must_be_confirmed():
    source = Path(plausibility.__file__).read_text(encoding="utf-8")
    codes_made = {*re.findall(r'"([A-Z]+(?:_[A-Z]+)+)"', source)}
    page = (Path(__file__).parents[3] / "docs" / "verification.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`[A-Z_`, ]+`) \|.*\| (yes|no) \|$", page, re.MULTILINE)
    told = {code: answer for names, answer in rows for code in re.findall(r"[A-Z_]+", names)}
    assert told.keys() == codes_made
    confirmed = {code for code in codes_made if re.search(rf'Caution\("{code}",.*confirm=True', source)}
    assert {code for code, answer in told.items() if answer == "yes"} == confirmed
