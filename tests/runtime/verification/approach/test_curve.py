"""The distance of the wrist centre to an arc over a joint line: bounded work, in steps."""

import math
from dataclasses import FrozenInstanceError, replace
from types import SimpleNamespace

import numpy as np
import pytest

from cutgate.runtime.verification.approach import curve
from cutgate.runtime.verification.problem import Deadband
from cutgate.runtime.verification.steps import finished
from cutgate.runtime.workspace.planar import Arc
from tests.runtime.verification.approach.cuts import MIDDLE, cut, joint_line
from tests.runtime.verification.cases import DEG


def test_what_is_not_decided_within_the_effort_is_refused(monkeypatch):
    monkeypatch.setattr(curve, "BUDGET", 0)
    first, last = MIDDLE.copy(), MIDDLE.copy()
    first[0], last[0] = -60 * DEG, 60 * DEG
    first[1] = last[1] = 90 * DEG
    arm = cut(deadband=Deadband(150.0, 2 * DEG))
    leg = joint_line(arm, first, last)
    left = leg.boundaries["left"]
    assert left.certified < 150.0 <= left.clearance
    assert left.violated
    assert any("left: undecided, the clearance lies between" in reason for reason in leg.reasons)


@pytest.mark.parametrize("block", [1, 3, 64])
def test_in_however_many_steps_the_answer_is_the_same(monkeypatch, block):
    first, last = MIDDLE.copy(), MIDDLE.copy()
    first[0], last[0] = -60 * DEG, 60 * DEG
    arm = cut(deadband=Deadband(150.0, 2 * DEG))
    whole = joint_line(arm, first, last)
    monkeypatch.setattr(curve, "BLOCK", block)
    assert joint_line(arm, first, last) == whole


LINKS = (450.0, 300.0)
ARC = Arc(100.0, -50.0, 950.0, -0.2, 0.9)


def curve_of(first, last, pad_mm=1e-9):
    """The wrist centre between two pairs of shoulder and elbow angles, rad."""
    space = SimpleNamespace(a0=LINKS[0], a1=LINKS[1])
    line = np.tile((0.0, 0.0, 250.0, 3.0, 2.0), (2, 1))
    line[0, :2], line[1, :2] = first, last
    return curve.Curve.of(SimpleNamespace(workspace=space, pad_mm=pad_mm), line)


def places(first, last, t):
    """The same by forward kinematics, shape (n, 2)."""
    q0, q1 = (first[i] + t * (last[i] - first[i]) for i in (0, 1))
    return np.stack(
        (
            LINKS[0] * np.cos(q0) + LINKS[1] * np.cos(q0 + q1),
            LINKS[0] * np.sin(q0) + LINKS[1] * np.sin(q0 + q1),
        ),
        axis=1,
    )


def to_arc(points, arc=ARC):
    """Distance to samples of the arc, mm, good to 1e-3."""
    angle = arc.start + np.linspace(0.0, arc.span, 20_001)
    on = np.array((arc.x, arc.y)) + arc.radius * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    return np.array([np.hypot(*(on - point).T).min() for point in points])


SWEEPS = [
    ((0.2, 0.9), (1.1, 0.4)),
    ((-0.8, 1.7), (0.9, 0.3)),
    ((1.0, 0.5), (-0.7, 1.2)),
    ((0.1, 2.0), (0.1, 0.2)),
]


@pytest.mark.parametrize(("first", "last"), SWEEPS)
def test_a_curve_is_the_forward_kinematics_with_its_bend_and_its_rounding(first, last):
    made, t = curve_of(first, last), np.linspace(0.0, 1.0, 201)
    np.testing.assert_allclose(made(t), places(first, last, t), atol=1e-9)
    rate, heading = last[0] - first[0], sum(last) - sum(first)
    assert made.bend == pytest.approx(LINKS[0] * rate**2 + LINKS[1] * heading**2)
    second = np.diff(made(t), 2, axis=0) / (t[1] - t[0]) ** 2
    assert np.hypot(*second.T).max() <= made.bend + 1e-4
    largest = max(abs(first[0]) + abs(first[1]), abs(last[0]) + abs(last[1]))
    assert made.pad == pytest.approx(1e-9 + 256 * 2.0**-52 * largest * sum(LINKS), rel=1e-12)


@pytest.mark.parametrize(("first", "last"), SWEEPS)
def test_a_look_bounds_every_place_of_an_interval_by_chord_and_bend(first, last):
    made = curve_of(first, last, pad_mm=0.25)
    a, b = np.array([0.0, 0.3, 0.5]), np.array([0.3, 0.5, 1.0])
    bounds, found, at = curve.looked_at(made, ARC, a, b, concentric=False)
    for bound, begin, end in zip(bounds, a, b, strict=True):
        (pa,), (pb,) = (places(first, last, np.array([t])) for t in (begin, end))
        chord = to_arc(pa + np.linspace(0.0, 1.0, 401)[:, None] * (pb - pa)).min()
        assert bound == pytest.approx(chord - made.bend * (end - begin) ** 2 / 8.0 - 0.25, abs=0.02)
        assert bound <= to_arc(places(first, last, np.linspace(begin, end, 101))).min()
    assert found == pytest.approx(to_arc(places(first, last, np.array([at])))[0], abs=1e-3)
    assert found <= min(to_arc(places(first, last, np.append(a, b)))) + 1e-3
    assert 0.0 <= at <= 1.0


def test_a_look_finds_what_lies_between_the_ends_of_an_interval():
    """The least distance of this sweep is at 0.689; at either end it is 10 mm more."""
    made, ends = curve_of(*SWEEPS[1]), np.array([0.5, 0.9])
    _, found, at = curve.looked_at(made, ARC, ends[:1], ends[1:], concentric=False)
    assert 0.6 < at < 0.8
    assert found < to_arc(places(*SWEEPS[1], ends)).min() - 5.0


def test_about_the_column_the_ends_of_an_interval_bound_it_as_well():
    """The elbow is linear: along 1 rad of the shoulder at a constant elbow the distance to a circle is constant."""
    first, last = (0.0, 0.9), (1.0, 0.9)
    made, circle = curve_of(first, last), Arc(0.0, 0.0, 300.0, -math.pi, 2 * math.pi)
    radius = math.hypot(*places(first, last, np.zeros(1))[0])
    loose, _, _ = curve.looked_at(made, circle, np.zeros(1), np.ones(1), concentric=False)
    bound, found, _ = curve.looked_at(made, circle, np.zeros(1), np.ones(1), concentric=True)
    assert bound[0] == pytest.approx(radius - 300.0, abs=1e-6)
    assert found == pytest.approx(radius - 300.0, abs=1e-6)
    assert loose[0] < radius - 400.0


@pytest.mark.parametrize(("first", "last"), SWEEPS)
@pytest.mark.parametrize("part", [(0.0, 1.0), (0.25, 0.75)])
def test_the_least_distance_is_enclosed_to_a_hundredth_and_decided_at_the_target(first, last, part):
    made, t = curve_of(first, last), np.linspace(*part, 1001)
    true = to_arc(places(first, last, t)).min()
    least = finished(curve.enclose(made, ARC, part, 0.0, concentric=False))
    assert least.certified <= true + 1e-3
    assert least.attained - least.certified <= 0.01
    assert least.attained == pytest.approx(true, abs=0.02)
    assert part[0] <= least.fraction <= part[1]
    assert to_arc(places(first, last, np.array([least.fraction])))[0] == pytest.approx(
        least.attained, abs=1e-3
    )
    for near in (1e-6, 1e-4):
        target = least.attained - near
        again = finished(curve.enclose(made, ARC, part, target, concentric=False))
        assert again.certified >= target or again.attained < target


def test_what_is_no_number_stays_none():
    broken = replace(curve_of((0.0, 1.0), (1.0, 1.0)), bend=math.nan)
    assert math.isnan(finished(curve.enclose(broken, ARC, (0.0, 1.0), 5.0, concentric=False)).certified)


def enclosed(monkeypatch, bound, found=5.0, target=1.0, budget=curve.BUDGET):
    """The least distance where an interval's bound is as said; and the lengths of the intervals looked at."""
    lengths, calls = [], []

    def looking(_curve, _arc, a, b, *, concentric):
        lengths.extend(b - a)
        calls.append(concentric)
        return bound(a, b), found, 0.125 * len(calls)

    monkeypatch.setattr(curve, "looked_at", looking)
    monkeypatch.setattr(curve, "BUDGET", budget)
    made = curve_of((0.0, 1.0), (1.0, 1.0))
    return finished(curve.enclose(made, ARC, (0.0, 1.0), target, concentric=False)), lengths


def test_where_nothing_is_found_the_place_is_the_beginning(monkeypatch):
    least, _ = enclosed(monkeypatch, lambda a, _: np.full(len(a), np.nan), found=math.nan)
    assert least.fraction == 0.0
    assert math.isnan(least.certified)


def test_no_interval_is_split_below_the_smallest(monkeypatch):
    least, lengths = enclosed(monkeypatch, lambda a, b: np.where((a <= 0.3) & (b > 0.3), -1.0, 10.0))
    assert min(lengths) == 2.0**-40
    assert len(lengths) == 81
    assert least == curve.Least(5.0, -1.0, 0.125)


def test_no_more_intervals_are_split_than_the_budget_has(monkeypatch):
    least, lengths = enclosed(monkeypatch, lambda a, _: np.full(len(a), -1.0), budget=3)
    assert lengths == [1.0, 0.5, 0.5, 0.25, 0.25, 0.25, 0.25]
    assert least.certified == -1.0


@pytest.mark.parametrize(
    ("bound", "target", "looks"),
    [
        (5.0 - curve.GAP_MM, 1.0, 1),  # close enough to the least found
        (np.nextafter(5.0 - curve.GAP_MM, 0.0), 1.0, 3),
        (4.999, 4.999, 1),  # keeps the target
        (4.999, 5.0, 3),  # the least found keeps the target, the bound does not
        (4.999, 5.001, 1),  # neither does
    ],
)
def test_an_interval_is_split_where_more_can_be_decided(monkeypatch, bound, target, looks):
    least, lengths = enclosed(monkeypatch, lambda a, b: np.where(b - a < 1.0, 5.0, bound), target=target)
    assert len(lengths) == looks
    assert least.attained == 5.0


def test_the_bounds_on_the_effort_are_these():
    assert (curve.GAP_MM, curve.SMALLEST, curve.BUDGET, curve.BLOCK) == (0.008, 2.0**-40, 200_000, 1024)


@pytest.mark.parametrize(
    ("value", "name"), [(curve.Least(1.0, 0.5, 0.0), "attained"), (curve_of((0.0, 1.0), (1.0, 1.0)), "pad")]
)
def test_values_are_never_changed(value, name):
    assert not hasattr(value, "__dict__")
    with pytest.raises(FrozenInstanceError):
        setattr(value, name, 0.0)
