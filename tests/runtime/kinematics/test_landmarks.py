"""Points touched in both frames: how far they are off, which of them is worst, what is asked of them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config.model import Site
from cutgate.runtime.kinematics.landmarks import NONE_ASKED, CheckPoints, PointResidual, residuals_mm

LENGTHS = st.floats(-1000.0, 1000.0)
POINTS = st.lists(st.tuples(LENGTHS, LENGTHS, LENGTHS), min_size=1, max_size=8)


@given(
    points=POINTS, turn=st.floats(-math.pi, math.pi), shift=st.tuples(LENGTHS, LENGTHS, LENGTHS), off=LENGTHS
)
def test_a_residual_is_the_distance_from_where_the_transform_puts_the_point(points, turn, shift, off):
    """The other way: each coordinate by itself, with the trigonometry written out."""
    c, s = math.cos(turn), math.sin(turn)
    transform = np.array([[c, -s, 0, shift[0]], [s, c, 0, shift[1]], [0, 0, 1, shift[2]], [0, 0, 0, 1]])
    there = [(c * x - s * y + shift[0], s * x + c * y + shift[1], z + shift[2] + off) for x, y, z in points]
    found = residuals_mm(transform, np.array(points), np.array(there))
    assert found == pytest.approx([abs(off)] * len(points), abs=1e-9)


def of(*residuals, **asked):
    return CheckPoints(tuple(PointResidual(f"P{k}", off) for k, off in enumerate(residuals)), **asked)


@pytest.mark.parametrize(
    ("points", "outside", "worst", "missing"),
    [
        (of(), [], None, 0),
        (of(least=2), [], None, 2),
        (of(0.5, 2.0, 1.0, least=2), [], "P1", 0),
        (of(0.5, 2.0, math.nextafter(2.0, 3.0)), ["P2"], "P2", 0),
        (of(3.0, 0.5, 2.5), ["P0", "P2"], "P0", 0),
        (of(3.0, math.nan, 2.5), ["P0", "P1", "P2"], "P1", 0),
        (of(-0.1, 0.0), ["P0"], "P1", 0),
        (of(0.5, tolerance_mm=0.4, least=3), ["P0"], "P0", 2),
    ],
)
def test_what_is_not_surely_within_the_tolerance_is_outside(points, outside, worst, missing):
    assert [one.id for one in points.outside] == outside
    assert (points.worst and points.worst.id) == worst
    assert points.missing == missing


def test_what_nobody_asks_for_is_what_the_default_site_asks_for():
    assert (NONE_ASKED.tolerance_mm, NONE_ASKED.least) == (
        Site().check_point_tolerance_mm,
        Site().check_points_min,
    )
