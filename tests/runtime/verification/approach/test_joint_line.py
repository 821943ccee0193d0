"""Joint lines: closed forms of every boundary, limits, and shoulders of more than a turn."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cutgate.runtime.verification.approach import joint_line as joint_lines
from cutgate.runtime.verification.approach.curve import Least
from cutgate.runtime.verification.approach.decision import verify
from cutgate.runtime.verification.approach.model import StartJoints
from cutgate.runtime.verification.approach.sentences import shortfall
from cutgate.runtime.verification.bounds.geometry import canonical
from cutgate.runtime.verification.problem import Arm, ArmCalibration, Deadband
from cutgate.runtime.verification.verdict import Boundary
from tests.runtime.verification.approach.cuts import (
    ARCS,
    MIDDLE,
    cut,
    joint_line,
    line_margins,
    spinning,
    vertical,
)
from tests.runtime.verification.cases import DEG


def solved(function, low, high):
    """Where a monotone function is zero, by bisection."""
    for _ in range(200):
        middle = (low + high) / 2
        low, high = (middle, high) if function(low) * function(middle) > 0 else (low, middle)
    return (low + high) / 2


def elbow_at(radius):
    return math.acos((radius**2 - 2 * 450.0**2) / (2 * 450.0**2))


INNER = 900.0 * math.cos(72.5 * DEG)


def side_distance(name, off):
    """Wrist centre from the arc of a q0 limit, q1 at 90 deg and q0 so far inside it."""
    turned = -off if name == "left" else off
    x = 450 * (math.cos(turned) - 1) - 450 * math.sin(turned)
    y = 450 * math.sin(turned) + 450 * math.cos(turned)
    return abs(math.hypot(x, y) - 450)


def line_at(name, kept):
    """A joint line whose least distance to one boundary is known in closed form."""
    first, last = MIDDLE.copy(), MIDDLE.copy()
    if name in {"inner", "outer"}:
        first[1] = last[1] = elbow_at(INNER + kept if name == "inner" else 900.0 - kept)
        first[0], last[0] = -50 * DEG, 60 * DEG
    elif name in {"left", "right"}:
        first[1] = last[1] = 90 * DEG
        at = 80 * DEG - solved(lambda off: side_distance(name, off) - kept, 0.0, 0.05)
        last[0] = at if name == "left" else -at
    else:
        last[2] = 450.0 - kept if name == "top" else 50.0 + kept
    return first, last


@pytest.mark.parametrize("short_mm", [1e-6, -1e-6])
@pytest.mark.parametrize("name", ["inner", "outer", "left", "right", "top", "bottom"])
def test_an_arm_boundary_is_decided_to_a_millionth_of_a_millimetre(name, short_mm):
    """The arm sweeps along inner and outer at a constant distance, and turns up to left and right."""
    first, last = line_at(name, 5.0 - short_mm)
    for leg in (joint_line(cut(), first, last), joint_line(cut(), last, first, "retract")):
        assert leg.boundaries[name].violated is (short_mm > 0)
        assert leg.boundaries[name].clearance == pytest.approx(5.0 - short_mm, abs=1e-7)
        assert bool(leg.reasons) is (short_mm > 0)


@pytest.mark.parametrize("short_deg", [1e-6, -1e-6])
@pytest.mark.parametrize(
    ("name", "joint", "limit", "sign"),
    [
        ("roll_min", 3, -170.0, 1),
        ("roll_max", 3, 170.0, -1),
        ("pitch_min", 4, 0.0, 1),
        ("pitch_max", 4, 110.0, -1),
    ],
)
def test_a_wrist_boundary_is_decided_to_a_millionth_of_a_degree(name, joint, limit, sign, short_deg):
    last = MIDDLE.copy()
    last[joint] = (limit + sign * (2.0 - short_deg)) * DEG
    leg = joint_line(cut(), MIDDLE, last)
    assert leg.boundaries[name].violated is (short_deg > 0)
    assert leg.boundaries[name].fraction == 1.0
    assert [reason.split(":")[0] for reason in leg.reasons] == ([name] if short_deg > 0 else [])


def test_a_line_whose_ends_keep_inner_and_whose_middle_does_not_is_refused():
    """Its ends lie beside the inner arc's extent, its middle before it."""
    arm = cut(
        arm=Arm(244.0, 591.0, "right"),
        lower=np.array([69 * DEG, 0.77 * DEG, 50.0, -170 * DEG, 0.0]),
        upper=np.array([195 * DEG, 99.4 * DEG, 450.0, 170 * DEG, 110 * DEG]),
        deadband=Deadband(160.0, 2 * DEG),
    )
    first, last = MIDDLE.copy(), MIDDLE.copy()
    first[:2], last[:2] = (72.4 * DEG, 75.2 * DEG), (195 * DEG, 3.0 * DEG)
    leg = joint_line(arm, first, last)
    sampled, inside, _ = line_margins(arm, first, last)
    assert inside
    inner = leg.boundaries["inner"]
    assert min(sampled["inner"][0], sampled["inner"][-1]) > 200.0
    assert inner.clearance < 160.0
    assert inner.clearance == pytest.approx(sampled["inner"].min(), abs=0.05)
    assert 0.1 < inner.fraction < 0.9
    assert inner.violated
    assert any(reason.startswith("inner: clearance") for reason in leg.reasons)


@pytest.mark.parametrize(
    ("joint", "value", "text"),
    [
        (0, 80.1 * DEG, "q0 at 80.100 deg, its limits are [-80, 80] deg, 5 mm at the wrist centre"),
        (1, 145.1 * DEG, "q1 at 145.100 deg, its limits are [0, 145] deg, 5 mm at the wrist centre"),
        (2, 49.9, "q2 at 49.900 mm, its limits are [50, 450] mm, 5 mm"),
        (3, -170.1 * DEG, "q3 at -170.100 deg, its limits are [-170, 170] deg, 2 deg"),
        (4, -0.1 * DEG, "q4 at -0.100 deg, its limits are [0, 110] deg, 2 deg"),
    ],
)
def test_start_joints_outside_their_limits_are_named(joint, value, text):
    start = MIDDLE.copy()
    start[joint] = value
    verdict = verify(cut(), StartJoints(start, 10_000))
    assert not verdict.admissible
    assert f"the arm stands with {text}" in verdict.reasons[0]
    assert all(b.certified is None and b.violated for b in map(verdict.legs[0].boundaries.get, ARCS))


def test_a_line_past_the_straight_elbow_is_refused_though_the_reported_limit_allows_it():
    """An offset pushes the reported limit of 0 to a true -1 deg: the branch ends at the straight arm."""
    arm = cut(calibration=ArmCalibration(joint_offset=np.array([0.0, -1.0 * DEG, 0.0, 0.0, 0.0])))
    start = MIDDLE.copy()
    start[1] = 0.5 * DEG
    leg = joint_line(arm, start, MIDDLE)
    assert any("q1 is 0.500000 deg at its beginning, must be in [1, 145]" in reason for reason in leg.reasons)


def test_of_a_shoulder_of_more_than_a_turn_a_limit_counts_within_half_a_turn_of_it():
    def sides(first_deg, last_deg):
        first, last = MIDDLE.copy(), MIDDLE.copy()
        first[0], last[0] = first_deg * DEG, last_deg * DEG
        return joint_line(spinning(), first, last).boundaries

    assert {"left", "right"}.isdisjoint(sides(-200.0, 200.0))  # passes their places in the plane all the same
    near = sides(0.0, 390.0)
    assert "right" not in near
    expected = line_margins(spinning(), [0, *MIDDLE[1:]], [390 * DEG, *MIDDLE[1:]], 4000)[0]["left"].min()
    assert near["left"].certified == pytest.approx(expected, abs=0.01)
    assert near["left"].fraction == pytest.approx(1.0)
    both = sides(390.0, -395.0)
    assert both["left"].fraction == 0.0
    assert both["right"].fraction == 1.0


def test_a_limit_that_does_not_count_at_the_worst_place_of_its_arc_counts_elsewhere():
    """On the way to +230 deg the arm passes the left arc's place a turn before it, and comes near it only half."""
    first, last = MIDDLE.copy(), MIDDLE.copy()
    first[0], last[0] = 0.0, 230 * DEG
    left = joint_line(spinning(), first, last).boundaries["left"]
    sampled = line_margins(spinning(), first, last, 4_000)[0]["left"]
    assert left.clearance == pytest.approx(sampled.min(), abs=0.5)
    assert left.fraction >= 220 / 230 - 1e-6
    assert left.clearance > 100.0


def test_below_a_vertical_tool_a_stop_counts():
    """A true lower limit of the pitch above 0 is a stop."""
    stop = vertical(0.4)
    stop = replace(stop, lower=np.array([*stop.lower[:4], 1e-9]))
    assert "pitch_min" in verify(stop, StartJoints(MIDDLE, 10_000)).legs[0].boundaries


def test_below_a_vertical_tool_whose_roll_is_held_there_is_no_stop():
    assert "pitch_min" not in verify(vertical(0.4), StartJoints(MIDDLE, 10_000)).legs[0].boundaries


def test_a_line_within_half_a_turn_of_a_limit_is_bounded_over_all_of_it():
    first, last = MIDDLE.copy(), MIDDLE.copy()
    first[0], last[0] = 300 * DEG, 395 * DEG
    forward, back = (
        joint_line(spinning(), *pair).boundaries["left"] for pair in ((first, last), (last, first))
    )
    expected = line_margins(spinning(), first, last, 4000)[0]["left"].min()
    assert forward.certified == pytest.approx(expected, abs=0.01)
    assert back.certified == pytest.approx(expected, abs=0.01)
    assert (forward.fraction, back.fraction) == (pytest.approx(1.0), 0.0)


@pytest.mark.parametrize("short_mm", [1e-6, -1e-6])
@pytest.mark.parametrize("name", ["inner", "outer", "left", "right", "top", "bottom"])
def test_the_start_tolerance_is_kept_besides_the_deadband(name, short_mm):
    leg = joint_line(cut(), *line_at(name, 5.5 - short_mm), tolerance_mm=0.5, tolerance_rad=0.25 * DEG)
    assert leg.boundaries[name].violated is (short_mm > 0)
    assert {b.name: (b.unit, b.deadband) for b in leg.boundaries.values()} == {
        **dict.fromkeys((*ARCS, "top", "bottom"), ("mm", 5.5)),
        **dict.fromkeys(("roll_min", "roll_max", "pitch_min", "pitch_max"), ("deg", pytest.approx(2.25))),
    }


def test_a_linear_joint_is_bounded_by_its_ends_less_their_rounding():
    first, last = MIDDLE.copy(), MIDDLE.copy()
    first[2:], last[2:] = (200.0, -1.0, 0.5), (300.0, 2.0, 1.5)
    geometry, _ = canonical(cut())
    found = joint_lines._linear(geometry, np.stack((first, last)))
    for name, value, place, largest in (
        ("bottom", 150.0, 0.0, None),
        ("top", 150.0, 1.0, None),
        ("roll_min", -1.0 + 170 * DEG, 0.0, 2.0),
        ("roll_max", 170 * DEG - 2.0, 1.0, 2.0),
        ("pitch_min", 0.5, 0.0, 1.5),
        ("pitch_max", 110 * DEG - 1.5, 1.0, 1.5),
    ):
        pad = geometry.pad_mm if largest is None else 256 * 2.0**-52 * (8.0 + largest)
        assert (found[name].attained, found[name].fraction) == (pytest.approx(value, abs=1e-12), place)
        assert found[name].attained - found[name].certified == pytest.approx(pad, rel=1e-2, abs=0.0)


def test_a_joint_exactly_at_its_limit_is_inside():
    for end in ("lower", "upper"):
        start = getattr(cut(), end).copy()
        start[1] = MIDDLE[1]  # a straight elbow has a margin of its own
        leg = joint_line(cut(), start, MIDDLE)
        assert not any("must be in" in reason for reason in leg.reasons)
        assert all(b.certified is not None for b in leg.boundaries.values())
        assert leg.boundaries["bottom" if end == "lower" else "top"].clearance == 0.0


@pytest.mark.parametrize("joint", [0, 3])
def test_a_joints_frame_carries_both_ends_whatever_the_limits(joint):
    wide = {"lower": cut().lower.copy(), "upper": cut().upper.copy()}
    wide["lower"][joint], wide["upper"][joint] = -36000 * DEG, 36000 * DEG
    for angle, inside in ((2600.0, True), (-2600.0, True), (2600.1, False), (-2600.1, False)):
        start = MIDDLE.copy()
        start[joint] = math.radians(angle)
        reasons = joint_line(cut(**wide), start, MIDDLE).reasons
        found = [reason for reason in reasons if "must be in [-2600, 2600]" in reason]
        assert bool(found) is not inside, reasons


def test_only_circles_about_the_column_are_bounded_by_the_ends_of_an_interval(monkeypatch):
    asked = []

    def enclosing(_curve, arc, _part, target_mm, *, concentric):
        asked.append((arc.x == arc.y == 0.0, concentric, target_mm))
        yield
        return Least(100.0, 100.0, 0.0)

    monkeypatch.setattr(joint_lines, "enclose", enclosing)
    joint_line(cut(), MIDDLE, MIDDLE, tolerance_mm=0.5)
    assert asked == [(True, True, 5.5), (True, True, 5.5), (False, False, 5.5), (False, False, 5.5)]


@pytest.mark.parametrize(
    ("ends", "bound", "part"),
    [
        ((1.0, 2.0), 0.5, (0.0, 1.0)),
        ((2.0, 1.0), 0.5, (0.0, 1.0)),
        ((1.0, 1.0), 1.0, (0.0, 1.0)),
        ((1.0, 2.0), 1.75, (0.75, 1.0)),
        ((2.0, 1.0), 1.75, (0.0, 0.25)),
        ((1.0, 2.0), 2.0, (1.0, 1.0)),
        ((2.0, 1.0), 2.0, (0.0, 0.0)),
        ((1.0, 2.0), 2.5, None),
        ((math.nan, 2.0), 1.0, None),
        ((1.0, 2.0), math.nan, None),
    ],
)
def test_a_linear_quantity_is_at_least_a_bound_over_this_part(ends, bound, part):
    assert joint_lines._part_above(np.array(ends), bound) == part


def boundary_of(name, least):
    geometry, _ = canonical(cut())
    return joint_lines._boundary(name, least, geometry, StartJoints(MIDDLE, 0))


def test_a_boundary_that_keeps_exactly_its_deadband_is_kept():
    kept = boundary_of("top", Least(7.0, 5.0, 0.25))
    assert (kept.clearance, kept.certified, kept.fraction, kept.violated) == (7.0, 5.0, 0.25, False)
    assert boundary_of("top", Least(7.0, np.nextafter(5.0, 0.0), 0.25)).violated
    roll = boundary_of("roll_min", Least(4 * DEG, 3 * DEG, 0.25))
    assert (roll.unit, roll.clearance, roll.certified) == ("deg", pytest.approx(4.0), pytest.approx(3.0))


@pytest.mark.parametrize(
    "least", [None, Least(math.inf, 9.0, 0.0), Least(9.0, -math.inf, 0.0), Least(9.0, math.nan, 0.0)]
)
def test_what_is_not_enclosed_is_violated(least):
    found = boundary_of("outer", least)
    assert (found.clearance, found.certified, found.fraction, found.violated) == (None, None, None, True)


def told_of(fraction, *, violated=True):
    return Boundary("top", "mm", 1.0, 1.0, None, fraction, None, 5.0, violated=violated)


@pytest.mark.parametrize(("name", "start"), [("approach", 0), ("retract", 1)])
def test_of_the_start_is_what_lies_at_its_end_of_the_line(name, start):
    here, there = (0, "here"), (1, "there")
    if start == 1:
        here, there = (1, "here"), (0, "there")
    near = 1e-6 if start == 0 else 1.0 - 9e-7
    for fraction, speaks in (
        (float(start), True),
        (near, True),
        (abs(start - 2e-6), False),
        (0.5, False),
        (1.0 - start, False),
    ):
        b = told_of(fraction)
        found = joint_lines._of_the_start(name, {"top": b}, [])
        assert found == ({shortfall(b, name)} if speaks else set()), fraction
    assert joint_lines._of_the_start(name, {"top": told_of(float(start), violated=False)}, []) == set()
    undefined = replace(told_of(None), clearance=None, certified=None)
    said = shortfall(undefined, name)
    assert joint_lines._of_the_start(name, {"top": undefined}, [here]) == {"here", said}
    assert joint_lines._of_the_start(name, {"top": undefined}, [here, there]) == {"here"}
    assert joint_lines._of_the_start(name, {"top": undefined}, [there]) == set()
