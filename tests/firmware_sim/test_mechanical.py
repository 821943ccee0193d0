"""Limit switches and distances of the true arm: against moving every joint by hand, and what is kept of a cut."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cutgate.firmware_sim.kinematics import as_joints, calibrated_arm, forward
from cutgate.firmware_sim.mechanical import (
    FIRST_STEPS,
    NEXT_STEPS,
    ROWS_MAX,
    SEARCHES,
    Approached,
    LeastDistances,
    MechanicalLimits,
    distances_text,
)
from cutgate.protocol.records import UNIT
from cutgate.runtime.verification.verdict import ARM_BOUNDARIES, WRIST_BOUNDARIES
from tests.firmware_sim.arms import CALIBRATED, LEFT_LIMITS, LIMITS, NOMINAL, WIDE
from tests.firmware_sim.verified_plans import shifted

MIDDLE = as_joints((LIMITS.q_min + LIMITS.q_max) / 2.0)
DEG = math.radians(1.0)


def moved(reading, **by):
    """The joints, some of them further: ``q0=0.1``."""
    return tuple(joint + by.get(f"q{index}", 0.0) for index, joint in enumerate(reading))


def random_readings(limits, count, seed=1):
    rng = np.random.default_rng(seed)
    return limits.q_min + rng.uniform(0.01, 0.99, (count, 5)) * (limits.q_max - limits.q_min)


def near_the_ends(limits):
    """A little inside of each end of shoulder and elbow: the nearest place of a boundary is then one of its ends."""
    ends = [(shoulder, elbow, 0.5, 0.5, 0.5) for shoulder in (0.02, 0.98) for elbow in (0.1, 0.5)]
    return limits.q_min + np.array(ends) * (limits.q_max - limits.q_min)


def along_limit(limits, calibration, reading, fixed, free):
    """The least distance to where one joint is held at its limit and another goes everywhere: by steps, then by small ones."""
    arm = calibrated_arm(calibration, tool_mm=0.0, elbow="right" if limits.q_min_u[1] >= 0 else "left")
    here, (joint, end) = forward(arm, reading).tip, fixed

    def away(value):
        other = list(reading)
        other[joint], other[free] = end[joint], float(value)
        return math.dist(here, forward(arm, tuple(other)).tip)

    low, high = limits.q_min[free], limits.q_max[free]
    coarse = min(np.linspace(low, high, 301), key=away)
    step = (high - low) / 300
    return min(map(away, np.linspace(max(low, coarse - step), min(high, coarse + step), 301)))


@pytest.mark.parametrize("limits", [LIMITS, LEFT_LIMITS], ids=["right", "left"])
@pytest.mark.parametrize("calibration", [NOMINAL, CALIBRATED], ids=["nominal", "calibrated"])
def test_the_distances_are_those_to_the_arm_with_a_joint_at_its_limit(limits, calibration):
    """The elbow's limits lie short of straight and folded, so that calibration moves them and cuts nothing off."""
    short = replace(
        limits,
        q_min_u=(limits.q_min_u[0], limits.q_min_u[1] + 5 * UNIT, *limits.q_min_u[2:]),
        q_max_u=(limits.q_max_u[0], limits.q_max_u[1] - 5 * UNIT, *limits.q_max_u[2:]),
    )
    rows = np.vstack((random_readings(short, 3), near_the_ends(short)))
    found = MechanicalLimits.of(short, calibration, calibration).distances(rows)
    near_straight, near_folded = (
        (short.q_min, short.q_max) if short.q_min_u[1] >= 0 else (short.q_max, short.q_min)
    )
    for row, reading in enumerate(rows):
        by_hand = {
            "outer": along_limit(short, calibration, reading, (1, near_straight), 0),
            "inner": along_limit(short, calibration, reading, (1, near_folded), 0),
            "left": along_limit(short, calibration, reading, (0, short.q_max), 1),
            "right": along_limit(short, calibration, reading, (0, short.q_min), 1),
        }
        assert {name: found[name][row] for name in by_hand} == pytest.approx(by_hand, abs=0.001)
        q = np.array(reading)
        assert found["top"][row] == pytest.approx(short.q_max[2] - q[2])
        assert found["bottom"][row] == pytest.approx(q[2] - short.q_min[2])
        assert found["roll_min"][row] == pytest.approx(math.degrees(q[3] - short.q_min[3]))
        assert found["roll_max"][row] == pytest.approx(math.degrees(short.q_max[3] - q[3]))
        assert found["pitch_min"][row] == pytest.approx(math.degrees(q[4] - short.q_min[4]))
        assert found["pitch_max"][row] == pytest.approx(math.degrees(short.q_max[4] - q[4]))
        pitch = math.degrees(q[4] + calibration.joint_offset[4])
        assert found["wrist_singularity"][row] == pytest.approx(min(pitch, 180.0 - pitch))


@pytest.mark.parametrize("limits", [LIMITS, LEFT_LIMITS], ids=["right", "left"])
def test_an_elbow_that_may_go_straight_ends_there_whatever_its_offset(limits):
    side = 1 if limits.q_min_u[1] >= 0 else -1
    true = shifted(NOMINAL, joint_offset_u=(0, -2 * side * UNIT, 0, 0, 0))
    straight = (0.0, 2.0 * side * DEG, 100.0, 0.0, 1.0)
    found = MechanicalLimits.of(limits, true, true).distances(np.array([straight]))
    assert found["outer"] == pytest.approx([0.0], abs=1e-6)


@pytest.mark.parametrize(
    ("joint", "at", "boundary"),
    [
        (0, "q_max", "left"),
        (0, "q_min", "right"),
        (1, "q_max", "inner"),
        (1, "q_min", "outer"),
        (2, "q_max", "top"),
        (2, "q_min", "bottom"),
    ],
)
def test_at_a_limit_nothing_is_left_and_outside_of_it_less(joint, at, boundary):
    short = replace(LIMITS, q_min_u=(LIMITS.q_min_u[0], 30 * UNIT, *LIMITS.q_min_u[2:]))
    limits = MechanicalLimits.of(short, NOMINAL, NOMINAL)
    out = (1.0 if at == "q_max" else -1.0) * (1.0 if joint == 2 else DEG)
    rows = np.array([MIDDLE] * 3)
    rows[:, joint] = getattr(short, at)[joint] + np.array([-out, 0.0, out])
    inside, there, outside = limits.distances(rows)[boundary]
    assert inside > 0.9
    assert there == pytest.approx(0.0, abs=1e-4)
    assert outside < -0.9


def test_a_shoulder_limit_half_a_revolution_away_is_none_where_the_shoulder_turns_round():
    limits = MechanicalLimits.of(WIDE, NOMINAL, NOMINAL)
    near = WIDE.q_max[0] - math.pi + 0.01
    found = limits.distances(np.array([[near, 1.0, 0.0, 0.0, 1.0], [near - 0.02, 1.0, 0.0, 0.0, 1.0]]))
    assert np.isfinite(found["left"]).tolist() == [True, False]
    assert np.isinf(found["right"]).all()
    assert np.isfinite(
        MechanicalLimits.of(LIMITS, NOMINAL, NOMINAL).distances(np.array([MIDDLE]))["right"]
    ).all()


@pytest.mark.parametrize("joint", range(5))
@pytest.mark.parametrize("side", [-1, 1])
def test_a_limit_switch_trips_where_the_true_joint_is_whatever_its_reading(joint, side):
    """Set up with the reported calibration: an arm that stands 1 deg or mm further trips that much earlier."""
    by = tuple((one == joint) * side * UNIT for one in range(5))
    unit = 1.0 if joint == 2 else DEG
    end = (LIMITS.q_max if side > 0 else LIMITS.q_min)[joint]
    reading = list(MIDDLE)
    for short_of, as_reported, further in (
        (1.5, "", ""),
        (0.5, "", f"q{joint} = "),
        (-0.5, f"q{joint} = ", f"q{joint} = "),
    ):
        reading[joint] = end - side * short_of * unit
        if joint == 1 and side < 0:
            continue  # straight is the end of it
        for true, expected in ((NOMINAL, as_reported), (shifted(NOMINAL, joint_offset_u=by), further)):
            tripped = MechanicalLimits.of(LIMITS, NOMINAL, true).tripped(tuple(reading))
            assert tripped.startswith(expected)
            assert bool(tripped) is bool(expected)


def test_where_both_calibrations_are_one_a_switch_trips_exactly_at_the_limit_of_the_reading():
    limits = MechanicalLimits.of(LIMITS, CALIBRATED, CALIBRATED)
    for corner in (LIMITS.q_min, LIMITS.q_max):
        reading = np.where(np.arange(5) == 1, MIDDLE[1], corner)
        assert limits.tripped(as_joints(reading)) == ""
        outside = moved(as_joints(reading), q0=math.copysign(1e-9, corner[0]))
        assert limits.tripped(outside).startswith("q0 = ")


# ---------------------------------------------------------------- what is kept of a cut


def test_the_least_of_each_boundary_is_kept_with_its_segment():
    distances = LeastDistances(MechanicalLimits.of(LIMITS, NOMINAL, NOMINAL))
    assert distances.least == {}
    up, down = moved(MIDDLE, q2=100.0), moved(MIDDLE, q2=-50.0)
    distances.add((MIDDLE, up), 3)
    assert distances.least["top"] == Approached(pytest.approx(100.0), 3)
    distances.add((down,), 4)
    distances.add((MIDDLE,), 5)
    least = distances.least
    assert least["top"] == Approached(pytest.approx(100.0), 3)
    assert least["bottom"] == Approached(pytest.approx(150.0), 4)
    assert list(least)[:4] == ["inner", "outer", "left", "right"]
    assert distances.off_mm == 0.0


def test_a_long_cut_takes_no_more_room_than_a_short_one():
    distances = LeastDistances(MechanicalLimits.of(LIMITS, NOMINAL, NOMINAL))
    for segment in range(3 * ROWS_MAX):
        distances.add((moved(MIDDLE, q2=float(segment % 100)),), segment)
        assert len(distances._rows) == len(distances._segments) < ROWS_MAX
    assert distances.least["top"] == Approached(pytest.approx(200.0 - 99.0), 99)


def test_a_boundary_that_never_was_near_is_left_out():
    distances = LeastDistances(MechanicalLimits.of(WIDE, NOMINAL, NOMINAL))
    distances.add(((0.0, 1.0, 0.0, 0.0, 1.0),), 0)
    assert not {"left", "right"} & set(distances.least)


def test_an_arm_that_is_another_one_than_is_reported_is_off_by_as_much():
    true = shifted(NOMINAL, upper_link_error_u=2 * UNIT)
    distances = LeastDistances(MechanicalLimits.of(LIMITS, NOMINAL, true))
    distances.add((MIDDLE, moved(MIDDLE, q0=0.1)), 0)
    assert distances.off_mm == pytest.approx(2.0)


def test_distances_are_told_with_unit_and_segment():
    told = distances_text({"outer": Approached(12.3456, 7), "roll_min": Approached(2.0, 0)})
    assert told == "outer 12.346 mm (segment 7), roll_min 2.000 deg (segment 0)"


def test_an_arm_whose_tool_alone_points_elsewhere_has_its_wrist_where_it_is_believed_to_be():
    distances = LeastDistances(
        MechanicalLimits.of(LIMITS, NOMINAL, shifted(NOMINAL, joint_offset_u=(0, 0, 0, 0, UNIT)))
    )
    distances.add((MIDDLE,), 0)
    assert distances.off_mm == 0.0


def test_every_distance_of_the_wrist_centre_is_told_in_mm():
    names = MechanicalLimits.of(LIMITS, NOMINAL, NOMINAL).distances(np.array([MIDDLE]))
    told = distances_text(dict.fromkeys(names, Approached(1.0, 2)))
    assert [part.split()[::2] for part in told.replace(" (segment 2)", "").split(", ")] == [
        [name, "mm" if name in ARM_BOUNDARIES else "deg"] for name in names
    ]
    assert set(names) == {*ARM_BOUNDARIES, *WRIST_BOUNDARIES}


@pytest.mark.parametrize(("span_deg", "counts"), [(359, True), (360, False), (361, False)])
def test_a_shoulder_that_turns_just_once_round_is_one_that_turns_round(span_deg, counts):
    """The elbow's span is no part of it."""
    limits = replace(LIMITS, q_min_u=(-180 * UNIT, *LIMITS.q_min_u[1:]))
    limits = replace(limits, q_max_u=((span_deg - 180) * UNIT, *LIMITS.q_max_u[1:]))
    found = MechanicalLimits.of(limits, NOMINAL, NOMINAL).distances(
        np.array([moved(MIDDLE, q0=-math.pi / 2.0)])
    )
    assert bool(np.isfinite(found["left"][0])) is counts
    assert np.isfinite(found["right"][0])


def test_limits_are_values_and_a_reading_has_five_joints():
    assert MechanicalLimits.__dataclass_params__.frozen
    with pytest.raises(ValueError, match="zip"):
        MechanicalLimits.of(LIMITS, NOMINAL, NOMINAL).tripped(MIDDLE[:4])


def test_so_many_places_are_looked_at_and_kept():
    assert (FIRST_STEPS, NEXT_STEPS, SEARCHES, ROWS_MAX) == (64, 32, 6, 256)


def test_a_tool_that_points_down_is_singular_where_it_hangs():
    limits = MechanicalLimits.of(WIDE, NOMINAL, NOMINAL)
    rows = np.array([(0.0, 1.0, 0.0, 0.0, pitch * DEG) for pitch in (30.0, 100.0, 170.0)])
    assert limits.distances(rows)["wrist_singularity"] == pytest.approx([30.0, 80.0, 10.0])
