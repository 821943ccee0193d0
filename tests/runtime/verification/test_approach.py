"""Approach and retract: what is admitted keeps every deadband on every leg, and nothing else is refused."""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from cutgate.firmware_sim.approach import own_ends
from cutgate.firmware_sim.kinematics import as_joints, calibrated_arm
from cutgate.firmware_sim.path_check import PathCheck
from cutgate.protocol import records
from cutgate.runtime.verification import approach, certified
from cutgate.runtime.verification.approach import Start
from cutgate.runtime.verification.bounds.geometry import canonical
from cutgate.runtime.verification.problem import Arm, Calibration, Deadband
from cutgate.runtime.verification.standing import standing
from tests.firmware_sim.arms import CALIBRATED, LIMITS, NOMINAL, TOOL, TOOL_MM, WIDE, line_path
from tests.oracle.dense import COLUMNS, Dense
from tests.runtime.verification.cases import DEG, axis, problem, random_problem, wrist_path

ARCS = ("inner", "outer", "left", "right")
MIDDLE = np.array([0.0, 72.5 * DEG, 250.0, 0.0, 55.0 * DEG])


def cut(**changes):
    """A short cut with a tilted tool, inside every limit of the example robot."""
    tips = np.array([[500.0, 50.0, 120.0], [505.0, 55.0, 115.0], [520.0, 60.0, 110.0]])
    return problem(tips, np.tile(axis(30 * DEG, 0.0), (3, 1)), branch=(0, 0), **changes)


def joint_line(given_problem, start, pose, name="approach", **tolerances):
    """The verdict on a joint line between any two joints."""
    geometry, _ = canonical(given_problem)
    begin = Start(np.asarray(start, float), 0, **tolerances)
    return approach.finished(approach._joint_line(geometry, begin, name, np.asarray(pose, float), held=False))


# ---------------------------------------------------------------- the oracle


def line_margins(given_problem, first, last, n=200):
    """Margins at samples of a joint line by the oracle's forward kinematics and brute-force distances."""
    dense = Dense(given_problem, per_segment=2)
    t = np.linspace(0.0, 1.0, n)[:, None]
    q = (1 - t) * np.asarray(first) + t * np.asarray(last) + given_problem.calibration.joint_offset
    upper, heading = q[:, 0], q[:, 0] + q[:, 1]
    x = dense.a0 * np.cos(upper) + dense.a1 * np.cos(heading)
    xy = np.stack((x, dense.a0 * np.sin(upper) + dense.a1 * np.sin(heading)), axis=1)
    out = {name: dense.side_distance(xy, name) for name in ARCS}
    if dense.hi[0] - dense.lo[0] >= 2 * math.pi:
        out["left"] = np.where(dense.hi[0] - q[:, 0] <= math.pi, out["left"], np.inf)
        out["right"] = np.where(q[:, 0] - dense.lo[0] <= math.pi, out["right"], np.inf)
    inside = ((q >= dense.lo) & (q <= dense.hi)).all(axis=1)
    inside &= (q[:, 1] >= dense.q1[0]) & (q[:, 1] <= dense.q1[1])
    out |= {"bottom": q[:, 2] - dense.lo[2], "top": dense.hi[2] - q[:, 2]}
    for joint, name in ((3, "roll"), (4, "pitch")):
        out |= {
            f"{name}_min": np.degrees(q[:, joint] - dense.lo[joint]),
            f"{name}_max": np.degrees(dense.hi[joint] - q[:, joint]),
        }
    length = dense.a0 * abs(q[-1, 0] - q[0, 0]) + dense.a1 * abs(q[-1, :2].sum() - q[0, :2].sum())
    return out, bool(inside.all()), length / (n - 1)


def straight_margins(given_problem, pose, length_um, joints):
    """Margins of a straight leg; roll and shoulder followed from the joints at its pose."""
    tip, u = given_problem.tips_mm[pose], given_problem.axes[pose]
    line = replace(given_problem, tips_mm=np.stack((tip, tip + length_um / 1000 * u)), axes=np.stack((u, u)))
    dense = Dense(line, per_segment=100)
    turns = [math.ceil((joints[j] - math.pi) / (2 * math.pi)) for j in (0, 3)]
    out = dict(zip(COLUMNS, dense.values.T, strict=True))
    if dense.full:
        out |= dict(zip(("left", "right"), dense.lifted_sides(turns[0]).T, strict=True))
    shift = np.degrees(dense.lifted(3, turns[1])[0] - dense.q3[0])
    out["roll_min"] = out["roll_min"] + shift - np.degrees(dense.lo[3])
    out["roll_max"] = out["roll_max"] - shift + np.degrees(dense.hi[3])
    return out, dense, turns


def random_case(seed, **options):
    """A random cut in the branch that fits it best, and start joints somewhere inside the limits; None if there is none."""
    rng = np.random.default_rng(seed)
    made = random_problem(rng, **options)
    branch = certified.verify(made).branch
    if branch is None:
        return None
    made = replace(made, branch=(branch.q0_turns, branch.roll_turns))
    joints = made.lower + rng.uniform(0.05, 0.95, 5) * (made.upper - made.lower)
    tolerance = float(rng.choice([0.0, 0.5]))
    return made, Start(joints, int(rng.integers(0, 20_000)), tolerance, tolerance * DEG / 2)


def sampled_leg(made, start, verdict, leg):
    """Margins of a leg at samples, whether all of them are inside, and how far the wrist moves between two."""
    ends = {"approach": (start.joints, verdict.entry), "retract": (verdict.exit, start.joints)}
    if leg.name in ends:
        return line_margins(made, *ends[leg.name])
    pose, length_um = (0, verdict.entry_um) if leg.name == "entry" else (-1, verdict.exit_um)
    sampled, dense, _ = straight_margins(made, pose, length_um, approach._ends(made)[pose])
    return sampled, bool(dense.inside.all()), length_um / 1000 / 99


def agrees_with(b, sampled, step_mm, *, joint_line):
    """What is certified is true; what is attained on a joint line is the least, but for the survey's gap."""
    least = float(np.min(sampled))
    assert b.violated is not (b.certified >= b.deadband)
    assert b.certified <= least + 1e-6, b
    if joint_line and math.isfinite(least):
        slack = step_mm if b.name in ARCS else 1e-6
        assert b.clearance - 0.01 <= least <= b.clearance + slack, b
        assert b.clearance - b.certified <= 0.01


@given(st.integers(0, 2**32 - 1), st.booleans())
@settings(max_examples=40, deadline=None)
def test_an_approach_is_admitted_exactly_where_dense_sampling_keeps_every_deadband(seed, spinning):
    case = random_case(seed, spinning=spinning, segments=2)
    verdict = approach.verify(*case) if case else None
    if verdict is None or not verdict.legs:
        return
    for leg in verdict.legs:
        joint_line = leg.name in {"approach", "retract"}
        if not np.isfinite([*verdict.entry, *verdict.exit]).all():
            assert not verdict.admissible
            return
        sampled, inside, step_mm = sampled_leg(*case, verdict, leg)
        if not inside:
            assert leg.reasons
            continue
        for b in leg.boundaries.values():
            if b.certified is not None:
                agrees_with(b, sampled[b.name], step_mm, joint_line=joint_line)
        if joint_line:
            assert bool(leg.reasons) is any(b.violated for b in leg.boundaries.values())
    assert verdict.admissible is not any(leg.reasons for leg in verdict.legs)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_entry_and_exit_joints_bring_the_tool_there_on_the_branch_of_the_cut(seed):
    case = random_case(seed, segments=2)
    if case is None:
        return
    made, start = case
    verdict = approach.verify(made, start)
    if not verdict.admissible:
        return
    for pose, out_um, joints in ((0, verdict.entry_um, verdict.entry), (-1, verdict.exit_um, verdict.exit)):
        at_pose = approach._ends(made)[pose]
        _, dense, turns = straight_margins(made, pose, out_um, at_pose)
        true = joints + made.calibration.joint_offset
        np.testing.assert_allclose(true[[1, 4]], dense.samples.q[-1, [1, 4]], atol=1e-7)
        assert true[2] == pytest.approx(dense.samples.q[-1, 2], abs=1e-6)  # joints are bound in 1e-6 deg | mm
        assert true[0] == pytest.approx(dense.lifted(0, turns[0])[-1], abs=1e-7)
        assert true[3] == pytest.approx(dense.lifted(3, turns[1])[-1], abs=1e-6)
        beyond = (made.tips_mm[pose] + out_um / 1000 * made.axes[pose] - made.tips_mm) @ made.axes[pose]
        assert start.clearance_um / 1000 - 1e-9 <= beyond.min() <= start.clearance_um / 1000 + 0.001 + 1e-9
    first = Dense(made, per_segment=60)
    assert made.branch is not None
    np.testing.assert_allclose(
        approach._ends(made)[:, 0] + made.calibration.joint_offset[0],
        first.lifted(0, made.branch[0])[[0, -1]],
        atol=1e-7,
    )


# ---------------------------------------------------------------- closed forms


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


# ---------------------------------------------------------------- limits and branches


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
    verdict = approach.verify(cut(), Start(start, 10_000))
    assert not verdict.admissible
    assert f"the arm stands with {text}" in verdict.reasons[0]
    assert all(b.certified is None and b.violated for b in map(verdict.legs[0].boundaries.get, ARCS))


def told(verdict, stands):
    """The joints after the moves that the sentences ask for."""
    moved = np.array(stands, float)
    for sentence in verdict.reasons:
        match = re.search(r"move q(\d) by [+-][\d.]+ (deg|mm), to (-?[\d.]+) (deg|mm)$", sentence)
        if match:
            moved[int(match[1])] = float(match[3]) * (1.0 if match[4] == "mm" else DEG)
    return moved


@pytest.mark.parametrize("far", [0.0, 0.3, -0.3], ids=["at its limit", "inside", "beyond"])
@pytest.mark.parametrize("end", ["lower", "upper"])
@pytest.mark.parametrize("joint", range(5))
def test_an_arm_at_a_limit_is_told_which_joint_to_move_and_may_begin_there(joint, end, far):
    arm, stands = cut(), MIDDLE.copy()
    limit = getattr(arm, end)[joint]
    stands[joint] = limit + far * (1.0 if joint == 2 else DEG) * (1.0 if end == "lower" else -1.0)
    tolerances = {"tolerance_mm": 0.5, "tolerance_rad": 0.5 * DEG}
    verdict = approach.verify(arm, Start(stands, 10_000, **tolerances))
    assert not verdict.admissible
    assert len(verdict.reasons) == 1
    assert f"move q{joint} by {'+' if end == 'lower' else '-'}" in verdict.reasons[0]
    moved = told(verdict, stands)
    assert approach.verify(arm, Start(moved, 10_000, **tolerances)).admissible
    short = stands + (moved - stands) * 0.95 if joint > 1 else moved
    assert joint <= 1 or not approach.verify(arm, Start(short, 10_000, **tolerances)).admissible


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_after_the_moves_that_it_is_told_no_arm_stands_too_near_to_a_limit(seed):
    """Both elbows, calibrated arms, several joints at once, shoulders of less and of more than a turn."""
    rng = np.random.default_rng(seed)
    case = random_case(seed, spinning=bool(rng.integers(2)))
    assume(case is not None)
    made, start = case
    part = rng.choice([-0.01, 0.0, 0.001, 0.5, 0.999, 1.0, 1.01], 5)
    stands = made.lower + part * (made.upper - made.lower)
    verdict = approach.verify(made, replace(start, joints=stands))
    assume(verdict.legs and not re.search("no place|stand.*elsewhere", str(verdict.reasons)))
    after = approach.verify(made, replace(start, joints=told(verdict, stands)))
    assert not any(leg.at_start for leg in after.legs), (verdict.reasons, after.reasons)


def test_where_no_place_keeps_the_deadband_no_move_is_named():
    arm, stands = cut(deadband=Deadband(460.0, 2 * DEG)), MIDDLE.copy()
    verdict = approach.verify(arm, Start(stands, 10_000))
    assert any(
        "q1 at 72.500 deg" in r and "no place of it keeps 460 mm at the wrist centre" in r
        for r in verdict.reasons
    )
    assert any("q2 at 250.000 mm" in r and "no place of it keeps 460 mm" in r for r in verdict.reasons)


def test_where_next_to_no_place_is_left_no_move_is_named():
    """The slide has 10.001 mm, 5 mm are kept from either end."""
    narrow = cut().upper.copy()
    narrow[2] = 60.001
    verdict = approach.verify(cut(upper=narrow), Start(np.array([*MIDDLE[:2], 52.0, *MIDDLE[3:]]), 10_000))
    assert "must be kept: let the arm start from elsewhere" in standing_of(cut(upper=narrow), 2, 52.0)[0]
    assert not verdict.admissible


def test_an_arm_without_workspace_or_without_a_place_that_is_reported_is_told_no_move():
    """An offset leaves the elbow no angle; limits of the shoulder that begin beyond every joints frame."""
    folded = cut(calibration=Calibration(joint_offset=np.array([0.0, -146.0 * DEG, 0.0, 0.0, 0.0])))
    assert standing_of(folded, 2, 52.0) == ()
    far = {"lower": cut().lower.copy(), "upper": cut().upper.copy()}
    far["lower"][0], far["upper"][0] = 3000 * DEG, 3100 * DEG
    (said,) = standing_of(cut(**far), 0, 3050 * DEG)
    assert "no place of it keeps 5 mm" in said
    far["lower"][0], far["upper"][0] = -0.2 * DEG, 0.2 * DEG
    (said,) = standing_of(cut(**far), 0, 0.0)
    assert "no place of it keeps 5 mm" in said


def standing_of(given_problem, joint, value):
    """What is said of the middle with one joint elsewhere."""
    stands = MIDDLE.copy()
    stands[joint] = value
    return standing(canonical(given_problem)[0], stands, 0.0, 0.0, held=False)


@pytest.mark.parametrize("joint", [0, 3])
def test_an_arm_beyond_what_a_joints_frame_carries_is_told_to_come_back_first(joint):
    """The limits allow it, and from 2600 deg it may unwind."""
    wide = {"lower": cut().lower.copy(), "upper": cut().upper.copy()}
    wide["lower"][joint], wide["upper"][joint] = -36000 * DEG, 36000 * DEG
    arm, stands = cut(**wide), MIDDLE.copy()
    stands[joint] = 2610 * DEG
    verdict = approach.verify(arm, Start(stands, 10_000))
    assert not verdict.admissible
    (reason,) = verdict.reasons
    assert (
        f"q{joint} at 2610.000 deg, its limits are [-36000, 36000] deg, and it is surely reported within +-2600 deg"
        in reason
    )
    moved = told(verdict, stands)
    assert moved[joint] == pytest.approx(2600 * DEG, abs=0.2 * DEG)
    assert approach.verify(arm, Start(moved, 10_000)).admissible


def test_a_line_past_the_straight_elbow_is_refused_though_the_reported_limit_allows_it():
    """An offset pushes the reported limit of 0 to a true -1 deg: the branch ends at the straight arm."""
    arm = cut(calibration=Calibration(joint_offset=np.array([0.0, -1.0 * DEG, 0.0, 0.0, 0.0])))
    start = MIDDLE.copy()
    start[1] = 0.5 * DEG
    leg = joint_line(arm, start, MIDDLE)
    assert any("q1 is 0.500000 deg at its beginning, must be in [1, 145]" in reason for reason in leg.reasons)


def test_the_middle_of_the_limits_is_a_start_for_the_example():
    verdict = approach.verify(cut(), Start(MIDDLE, 10_000, 0.5, 0.2 * DEG))
    assert verdict.admissible
    assert verdict.reasons == ()
    assert [leg.name for leg in verdict.legs] == ["approach", "entry", "exit", "retract"]
    assert "tightest is" in approach.summary(verdict)
    for leg in (verdict.legs[0], verdict.legs[3]):
        assert "wrist_singularity" not in leg.boundaries
        assert leg.boundaries["top"].deadband == 5.5
        assert leg.boundaries["roll_min"].deadband == pytest.approx(2.2)
    assert "wrist_singularity" in verdict.legs[1].boundaries
    assert verdict.legs[1].boundaries["top"].deadband == 5.0


def test_residuals_and_tolerances_widen_the_deadbands_of_every_leg():
    arm = cut(
        calibration=Calibration(residual_mm=0.3, residual_rad=0.1 * DEG),
        deadband=Deadband(5.0, 2 * DEG, path_tolerance_mm=0.2, path_tolerance_rad=0.05 * DEG),
    )
    verdict = approach.verify(arm, Start(MIDDLE, 10_000))
    for leg in verdict.legs:
        assert leg.boundaries["inner"].deadband == pytest.approx(5.5)
        assert leg.boundaries["pitch_min"].deadband == pytest.approx(2.15)


def spinning(**changes):
    """q0 within +-400 deg, roll within +-700 deg."""
    lower, upper = (
        np.array([-400 * DEG, 0, 50, -700 * DEG, 0]),
        np.array([400 * DEG, 145 * DEG, 450, 700 * DEG, 110 * DEG]),
    )
    return cut(lower=lower, upper=upper, **changes)


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


@pytest.mark.parametrize("turns", [-1, 0, 1])
def test_a_roll_that_must_unwind_turns_on_the_joint_line(turns):
    start = MIDDLE.copy()
    start[3] = 400 * DEG
    verdict = approach.verify(replace(spinning(), branch=(0, turns)), Start(start, 10_000))
    assert verdict.admissible
    assert verdict.entry[3] / DEG == pytest.approx(-54.103025 + 360 * turns, abs=1e-3)
    ends = (400.0, verdict.entry[3] / DEG)
    assert verdict.legs[0].boundaries["roll_max"].clearance == pytest.approx(700 - max(ends))
    assert verdict.legs[0].boundaries["roll_min"].clearance == pytest.approx(700 + min(ends))


def test_the_mirrored_arm_has_the_mirrored_verdict():
    mirror = np.array([-1.0, -1.0, 1.0, -1.0, 1.0])
    right = cut(
        calibration=Calibration(
            joint_offset=np.array([0.01, 0.02, 1.0, 0.03, 0.01]), slide_tilt=np.array([0.01, 0.02])
        )
    )
    left = replace(
        right,
        tips_mm=right.tips_mm * (1, -1, 1),
        axes=right.axes * (1, -1, 1),
        arm=Arm(450.0, 450.0, "left"),
        lower=np.where(mirror < 0, -right.upper, right.lower),
        upper=np.where(mirror < 0, -right.lower, right.upper),
        calibration=Calibration(
            joint_offset=right.calibration.joint_offset * mirror, slide_tilt=np.array([0.01, -0.02])
        ),
    )
    start = np.array([0.4, 1.2, 200.0, -1.0, 0.8])
    one, other = (approach.verify(p, Start(q, 7_000)) for p, q in ((right, start), (left, start * mirror)))
    np.testing.assert_allclose(one.entry * mirror, other.entry, atol=2e-8)
    swap = {"left": "right", "right": "left", "roll_min": "roll_max", "roll_max": "roll_min"}
    for a, b in zip(one.legs, other.legs, strict=True):
        for name, boundary in a.boundaries.items():
            twin = b.boundaries[swap.get(name, name)]
            assert twin.certified == pytest.approx(boundary.certified, abs=1e-5), (a.name, name)


# ---------------------------------------------------------------- a vertical tool


def vertical(hold_roll):
    tips, axes = wrist_path(np.array([[600.0, 0.0, 300.0], [620.0, 10.0, 290.0]]), (0.0, 0.0, 1.0))
    return problem(tips, axes, hold_roll=hold_roll, branch=(0, 0))


def test_a_vertical_tool_is_approached_with_its_held_roll():
    verdict = approach.verify(vertical(0.4), Start(MIDDLE, 10_000))
    assert verdict.admissible, verdict.reasons
    assert verdict.entry[[3, 4]] == pytest.approx([0.4, 0.0], abs=1e-8)
    assert verdict.exit[[3, 4]] == pytest.approx([0.4, 0.0], abs=1e-8)
    assert all("pitch_min" not in leg.boundaries for leg in verdict.legs)
    assert (verdict.entry_um, verdict.exit_um) == (10_000, 20_000)


def test_below_a_vertical_tool_a_stop_counts():
    """A true lower limit of the pitch above 0 is a stop."""
    stop = vertical(0.4)
    stop = replace(stop, lower=np.array([*stop.lower[:4], 1e-9]))
    assert "pitch_min" in approach.verify(stop, Start(MIDDLE, 10_000)).legs[0].boundaries


def test_a_vertical_tool_without_a_held_roll_has_no_approach():
    assert not approach.verify(vertical(None), Start(MIDDLE, 10_000)).admissible


# ---------------------------------------------------------------- legs along the tool


def test_a_straight_leg_that_leaves_the_slides_travel_is_refused_with_its_sentence():
    high = replace(cut(), upper=np.array([80 * DEG, 145 * DEG, 300.0, 170 * DEG, 110 * DEG]))
    verdict = approach.verify(high, Start(MIDDLE, 60_000))
    assert any("pose to the first pose: top: " in reason for reason in verdict.reasons)
    assert any("last pose to the exit pose: top: " in reason for reason in verdict.reasons)
    assert any("lower approach_clearance_mm or move the bone" in reason for reason in verdict.reasons)


def test_a_straight_leg_keeps_the_joint_speeds():
    slow = replace(cut(), feed_mm_s=5_000.0)
    verdict = approach.verify(slow, Start(MIDDLE, 10_000))
    reasons = verdict.reasons
    assert not verdict.admissible
    assert not any(b.violated for leg in verdict.legs for b in leg.boundaries.values())
    assert any("straight line" in reason and "joint 2: needs up to" in reason for reason in reasons)
    assert not any("joint line" in reason for reason in reasons)


def of_both(path, calibration, limits, clearance_um, hold_roll=None):
    """What the runtime binds, and what the controller comes to by itself."""
    check = PathCheck(path, limits, calibration, TOOL, hold_roll)
    assert check.run().detail == ""
    arm = calibrated_arm(calibration, tool_mm=TOOL_MM, elbow=path.elbow, hold_roll_rad=hold_roll)
    theirs = own_ends(path, arm, limits, check.first_joints, check.last_joints, clearance_um=clearance_um)
    mine = problem(
        path.tips_mm,
        path.axes,
        branch=(path.q0_turns, path.roll_turns),
        arm=Arm(calibration.upper_mm, calibration.forearm_mm, path.elbow),
        lower=limits.q_min,
        upper=limits.q_max,
        hold_roll=hold_roll,
        calibration=Calibration(
            calibration.upper_link_error_mm,
            calibration.forearm_link_error_mm,
            calibration.joint_offset,
            calibration.slide_tilt,
        ),
    )
    middle = (limits.q_min + limits.q_max) / 2
    return approach.bound(approach.verify(mine, Start(middle, clearance_um)), 25), theirs


@pytest.mark.parametrize("calibration", [NOMINAL, CALIBRATED], ids=["nominal", "calibrated"])
@pytest.mark.parametrize("elbow", ["right", "left"])
@pytest.mark.parametrize(("q0_turns", "roll_turns"), [(0, 0), (1, -2), (-3, 1)])
@pytest.mark.parametrize("clearance_um", [0, 25_000])
def test_the_controller_comes_to_the_same_entry_and_exit(
    calibration, elbow, q0_turns, roll_turns, clearance_um
):
    sides = {
        "right": WIDE,
        "left": replace(WIDE, q_min_u=_elbow(WIDE.q_min_u, -180), q_max_u=_elbow(WIDE.q_max_u, 0)),
    }
    turns = {"q0_turns": q0_turns, "roll_turns": roll_turns}
    path = line_path((500.0, 40.0, 100.0), (450.0, 120.0, 60.0), elbow=elbow, **turns)
    bound, theirs = of_both(path, calibration, sides[elbow], clearance_um)
    assert (bound.entry_um, bound.exit_um) == (theirs.entry_um, theirs.exit_um)
    np.testing.assert_allclose(bound.entry_joints_u, theirs.entry_joints_u, atol=2)
    np.testing.assert_allclose(bound.exit_joints_u, theirs.exit_joints_u, atol=2)


def _elbow(joints_u, deg):
    return (joints_u[0], deg * records.UNIT, *joints_u[2:])


def test_the_controller_holds_the_roll_of_a_vertical_tool_on_the_way_as_well():
    path = line_path((500.0, 0.0, 100.0), (520.0, 0.0, 100.0), polar=(0, 0), azimuth=(0, 0))
    bound, theirs = of_both(path, NOMINAL, LIMITS, 10_000, hold_roll=0.4)
    assert (theirs.entry_um, theirs.exit_um) == (bound.entry_um, bound.exit_um) == (10_000, 10_000)
    assert theirs.entry_joints_u[3] == bound.exit_joints_u[3] == round(math.degrees(0.4) * 1e6)
    np.testing.assert_allclose(bound.exit_joints_u, theirs.exit_joints_u, atol=2)


# ---------------------------------------------------------------- fail closed


@pytest.mark.parametrize(
    ("field", "value", "text"),
    [
        ("joints", np.array([0.0, 1.0, math.nan, 0.0, 1.0]), "start joints"),
        ("joints", np.zeros(4), "start joints"),
        ("clearance_um", -1, "approach_clearance is -1"),
        ("tolerance_mm", math.nan, "start_tolerance_mm is nan"),
        ("tolerance_rad", math.inf, "start_tolerance is inf"),
    ],
)
def test_a_start_that_is_none_is_refused(field, value, text):
    verdict = approach.verify(cut(), replace(Start(MIDDLE, 10_000), **{field: value}))
    assert (verdict.admissible, verdict.legs, verdict.entry) == (False, (), None)
    assert text in verdict.reasons[0]
    assert approach.bound(verdict, 25) is None


def test_a_cut_without_a_branch_or_joints_has_no_approach():
    for bad, text in (
        (replace(cut(), branch=None), "no joint branch"),
        (replace(cut(), tips_mm=cut().tips_mm + 2000.0), "no joints"),
        (replace(cut(), tips_mm=cut().tips_mm * math.nan), "not all finite"),
    ):
        verdict = approach.verify(bad, Start(MIDDLE, 10_000))
        assert not verdict.admissible
        assert text in verdict.reasons[0]


def test_what_is_not_decided_within_the_effort_is_refused(monkeypatch):
    monkeypatch.setattr(approach, "BUDGET", 0)
    first, last = MIDDLE.copy(), MIDDLE.copy()
    first[0], last[0] = -60 * DEG, 60 * DEG
    first[1] = last[1] = 90 * DEG
    arm = cut(deadband=Deadband(150.0, 2 * DEG))
    leg = joint_line(arm, first, last)
    left = leg.boundaries["left"]
    assert left.certified < 150.0 <= left.clearance
    assert left.violated
    assert any("left: undecided, the clearance lies between" in reason for reason in leg.reasons)


def test_the_document_is_finite_and_says_what_was_verified():
    for start in (MIDDLE, np.array([2.0, *MIDDLE[1:]])):
        given_start = Start(start, 10_000, 0.5, 0.2 * DEG)
        verdict = approach.verify(cut(), given_start)
        text = json.dumps(approach.document(verdict, given_start), allow_nan=False)
        document = json.loads(text)
        assert document["verdict"] == ("admissible" if verdict.admissible else "inadmissible")
        assert document["start_joints"] == pytest.approx([*np.degrees(start[:2]), 250.0, 0.0, 55.0])
        assert set(document["legs"]) == {"approach", "entry", "exit", "retract"}
        assert document["reasons"] == list(verdict.reasons)


def test_what_is_bound_is_what_was_verified():
    verdict = approach.verify(cut(), Start(MIDDLE, 10_000))
    bound = approach.bound(verdict, 40)
    assert isinstance(bound, records.Approach)
    assert as_joints(records.joints_to_memory(bound.entry_joints_u)) == as_joints(verdict.entry)
    assert as_joints(records.joints_to_memory(bound.exit_joints_u)) == as_joints(verdict.exit)
    assert (bound.entry_um, bound.exit_um, bound.speed_percent) == (verdict.entry_um, verdict.exit_um, 40)


@pytest.mark.parametrize("block", [1, 3, 64])
def test_in_however_many_steps_the_answer_is_the_same(monkeypatch, block):
    first, last = MIDDLE.copy(), MIDDLE.copy()
    first[0], last[0] = -60 * DEG, 60 * DEG
    arm = cut(deadband=Deadband(150.0, 2 * DEG))
    whole = joint_line(arm, first, last)
    monkeypatch.setattr(approach, "BLOCK", block)
    assert joint_line(arm, first, last) == whole


def test_the_straight_lines_are_known_before_it_is_known_where_the_arm_stands():
    lines = approach.straight_lines(cut(), 10_000)
    whole = approach.verify(cut(), Start(MIDDLE, 10_000))
    assert (lines.inward, lines.outward) == whole.legs[1:3]
    assert lines.admissible
    assert approach.bound(lines, 25) == approach.bound(whole, 25)
    far = approach.straight_lines(cut(), 500_000)
    assert not far.admissible
    assert approach.bound(far, 25) is None
    nowhere = approach.straight_lines(cut(), -1)
    assert approach.bound(nowhere, 25) is None
    assert approach.finished(approach.joint_lines(nowhere, Start(MIDDLE, 10_000))) is nowhere
