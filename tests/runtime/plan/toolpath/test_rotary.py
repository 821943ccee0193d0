"""Rotary conventions against matrices, and the subdivision of turns against dense sampling."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cutgate.runtime.plan.toolpath.rotary import CONVENTIONS, angle_between, deviation_deg

ANGLES = st.floats(-400.0, 400.0)
NAMES = st.sampled_from(sorted(CONVENTIONS))


def turned(axis: str, degrees: float) -> np.ndarray:
    """Rotation about a coordinate axis."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    i = "XYZ".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    matrix = np.eye(3)
    matrix[j, j] = matrix[k, k] = c
    matrix[j, k], matrix[k, j] = -s, s
    return matrix


def great_circle(first: np.ndarray, second: np.ndarray, along: np.ndarray) -> np.ndarray:
    """From one axis to the other at a constant rate, shape (n, 3)."""
    w = math.acos(float(np.clip(first @ second, -1.0, 1.0)))
    if w < 1e-7:
        return first + along[:, None] * (second - first)
    return (np.sin((1 - along) * w)[:, None] * first + np.sin(along * w)[:, None] * second) / math.sin(w)


@given(ANGLES, ANGLES)
def test_the_axis_is_what_the_two_rotations_make_of_z(tilt: float, turn: float):
    z = np.array([0.0, 0.0, 1.0])
    for name, about in (("xyzac", "X"), ("xyzbc", "Y")):
        expected = turned("Z", -turn) @ turned(about, -tilt) @ z
        assert CONVENTIONS[name].axis(tilt, turn) == pytest.approx(expected, abs=1e-12)


@given(
    NAMES,
    ANGLES,
    ANGLES,
    st.floats(-180, 180),
    st.floats(-180, 180),
    st.sampled_from([0.001, 0.01, 0.1, 1.0]),
)
@example("xyzac", 30.0, 0.0, 0.0, 360.0, 0.01)
@example("xyzbc", -90.0, 10.0, 180.0, 0.0, 0.01)
@example("xyzac", 0.0, 0.0, 0.0, 90.0, 0.01)
@example("xyzac", 0.1, 0.0, -0.2, 180.0, 0.01)
def test_pieces_stay_within_their_bound_at_every_parameter(name, tilt, turn, a, c, tolerance):
    convention = CONVENTIONS[name]
    axes, bound = convention.pieces((tilt, turn), (tilt + a, turn + c), tolerance, 100_000)
    assert bound <= tolerance
    assert axes[-1] == convention.axis(tilt + a, turn + c)
    along = np.linspace(0.0, 1.0, 33)
    before = np.array(convention.axis(tilt, turn))
    count = len(axes)
    for k in {0, count // 3, count // 2, count - 1}:
        first = before if k == 0 else np.array(axes[k - 1])
        expected = great_circle(first, np.array(axes[k]), along)
        s = (k + along) / count
        true = np.array([convention.axis(tilt + a * x, turn + c * x) for x in s])
        off = np.degrees(2.0 * np.arcsin(np.minimum(1.0, np.linalg.norm(true - expected, axis=1) / 2.0)))
        assert off.max() <= bound + 1e-5


@given(st.floats(-400, 400), st.floats(-0.7, 0.7), st.floats(-0.7, 0.7))
def test_the_bound_holds_for_one_piece_and_is_not_far_off(tilt: float, a: float, c: float):
    convention, degrees = CONVENTIONS["xyzac"], math.degrees
    along = np.linspace(0.0, 1.0, 65)
    ends = [np.array(convention.axis(tilt + degrees(a) * x, degrees(c) * x)) for x in (0, 1)]
    true = np.array([convention.axis(tilt + degrees(a) * x, degrees(c) * x) for x in along])
    off = np.linalg.norm(true - great_circle(*ends, along), axis=1).max()
    bound = deviation_deg(math.radians(tilt), a, c, angle_between(tuple(ends[0]), tuple(ends[1])))
    assert degrees(2 * math.asin(off / 2)) <= bound + 1e-5
    assert bound <= 60.0 * (abs(a) + abs(c)) ** 2 + 1e-9


def test_a_mere_tilt_is_a_great_circle_and_needs_no_piece():
    axes, bound = CONVENTIONS["xyzac"].pieces((0.0, 20.0), (50.0, 20.0), 1e-6, 10)
    assert len(axes) == 1
    assert bound < 1e-6


def test_a_turn_about_a_tilted_axis_takes_as_many_pieces_as_its_deviation_asks_for():
    counts = [len(CONVENTIONS["xyzac"].pieces((45.0, 0.0), (45.0, 90.0), t, 10_000)[0]) for t in (0.1, 0.001)]
    assert 8 <= counts[1] / counts[0] <= 12  # ten, by the root of the tolerances


def test_more_pieces_than_there_is_room_for_are_none():
    convention = CONVENTIONS["xyzac"]
    assert convention.pieces((45.0, 0.0), (45.0, 90.0), 0.01, 3) is None
    assert convention.pieces((45.0, 0.0), (45.0, 1e12), 0.01, 1_000_000) is None


def test_a_piece_of_more_than_a_radian_has_no_bound():
    assert deviation_deg(0.0, 1.5, 0.0, 1.5) == 180.0
