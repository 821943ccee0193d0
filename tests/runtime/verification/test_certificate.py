"""A proof as data: it is checked without a search, holds at every sampled pose, and cannot deceive."""

import math
import struct
from dataclasses import FrozenInstanceError, replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from cutgate.runtime.verification import certificate, certified
from cutgate.runtime.verification.bounds import bisection
from cutgate.runtime.verification.bounds.chain import build
from cutgate.runtime.verification.bounds.enclosures import COLUMNS as COLUMNS_OF_A_PROOF
from cutgate.runtime.verification.bounds.enclosures import Q0_MIN, ROLL_MIN
from cutgate.runtime.verification.bounds.geometry import canonical
from cutgate.runtime.verification.branch import goes
from cutgate.runtime.verification.certificate import Certificate, CertificateError, certify, recheck
from cutgate.runtime.verification.problem import ArmCalibration, Deadband
from tests.oracle.dense import COLUMNS, Dense
from tests.runtime.verification.cases import DEG, WIDE, axis, mirrored, problem, random_problem, wrist_path
from tests.runtime.verification.random_paths import random_paths

SEEDS = range(12)


@cache
def proven(seed):
    """Random admissible problems with their proofs: both elbows, narrow and wide sweeps, shoulders of over a turn."""
    rng = np.random.default_rng([20260401, seed])
    found = []
    while len(found) < 6:
        case = random_problem(
            rng,
            segments=int(rng.integers(1, 12)),
            wide=rng.random() < 0.3,
            spinning=rng.random() < 0.3,
        )
        if rng.random() < 0.5:
            case = replace(case, acceleration=np.full(5, 1e5))
        verdict = certified.verify(case)
        if verdict.admissible:
            found.append((case, verdict, certify(case, verdict)))
    return found


def grazing():
    """A chord that passes the inner circle so closely, and a slide so near, that intervals have to be cut."""
    tips, axes = wrist_path([[-400, 140.2, 100], [400, 140.2, 100]], axis([1.0, 1.4], [0.2, 0.9]))
    return problem(
        tips,
        axes,
        lower=np.array([-WIDE, 0.0, 50.0, -WIDE, 0.0]),
        upper=np.array([WIDE, 162 * DEG, 450.0, WIDE, 110 * DEG]),
        speed=np.full(5, 300.0),
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_every_admissible_verdict_has_a_proof_that_holds_after_a_round_trip_through_bytes(seed):
    for case, verdict, proof in proven(seed):
        again = Certificate.parse(proof.body())
        assert again.body() == proof.body()
        assert recheck(case, again) == ()
        turns = (verdict.branch.q0_turns, verdict.branch.roll_turns)
        assert recheck(replace(case, branch=turns), again) == ()


@pytest.mark.parametrize("seed", SEEDS)
def test_what_is_stated_holds_at_every_sampled_pose(seed):
    for case, verdict, proof in proven(seed):
        dense = Dense(case, 80)
        assert dense.inside.all()
        least = dense.minima()
        sampled = dict(zip(COLUMNS, least, strict=True))
        rolls = dense.roll_margins(least, verdict.branch.roll_turns)
        sampled |= dict(zip(("roll_min", "roll_max"), rolls, strict=True))
        if dense.full:
            sides = dense.least_unwrapped_sides(verdict.branch.q0_turns)
            sampled |= dict(zip(("left", "right"), sides, strict=True))
        for name, bound in proof.bounds.items():
            if name in sampled:
                shown = bound if verdict.boundaries[name].unit == "mm" else math.degrees(bound)
                assert shown <= sampled[name] + 2e-5, name
                assert shown >= verdict.boundaries[name].deadband - 1e-9, name


def test_no_search_and_one_look_at_each_interval(monkeypatch):
    case = grazing()
    proof = certify(case, certified.verify(case))
    looked = []
    bounds = certificate.lower_bounds
    monkeypatch.setattr(certificate, "survey", None)
    monkeypatch.setattr(bisection, "survey", None)
    monkeypatch.setattr(
        certificate, "lower_bounds", lambda *given: (looked.append(len(given[3])), bounds(*given))[1]
    )
    assert recheck(case, proof) == ()
    assert sum(looked) == len(case.tips_mm) - 1 + len(proof.cut_segment)


def test_the_size_of_the_blocks_changes_nothing(monkeypatch):
    case = grazing()
    proof = certify(case, certified.verify(case))
    monkeypatch.setattr(certificate, "BLOCK", 2)
    assert recheck(case, proof) == ()
    assert certify(case, certified.verify(case)).body() == proof.body()
    bold = {**proof.bounds, "inner": proof.bounds["inner"] + 0.01}
    assert recheck(case, replace(proof, bounds=bold))


def test_a_shoulder_that_winds_beyond_its_limit_is_no_proof():
    angles = np.linspace(0, 4 * math.pi, 60)
    tips, axes = wrist_path(
        np.column_stack((500 * np.cos(angles), 500 * np.sin(angles), np.full(60, 100.0))), axis(1.0, angles)
    )
    wide = problem(
        tips,
        axes,
        lower=np.array([-2.0, 0.0, 50.0, -WIDE, 0.0]),
        upper=np.array([14.0, 162 * DEG, 450.0, WIDE, 110 * DEG]),
        speed=np.full(5, 300.0),
    )
    proof = certify(wide, certified.verify(wide))
    assert recheck(wide, proof) == ()
    short = replace(wide, upper=np.array([9.0, *wide.upper[1:]]))
    assert any(reason.startswith("left: ") for reason in recheck(short, proof))
    recovery = {name: 5.0 if name in {"left", "right"} else bound for name, bound in proof.bounds.items()}
    assert any(reason.startswith("left: ") for reason in recheck(short, replace(proof, bounds=recovery)))


def test_cuts_that_were_needed_cannot_be_left_out():
    case = grazing()
    proof = certify(case, certified.verify(case))
    assert len(proof.cut_segment) > 2
    none = replace(proof, cut_segment=proof.cut_segment[:0], cut_fraction=proof.cut_fraction[:0])
    assert any("is proven" in reason or "leave open" in reason for reason in recheck(case, none))


def test_cuts_at_other_places_may_prove_the_same():
    """The bounds hold on any intervals, so a finer proof than the one found is a proof as well."""
    case = grazing()
    proof = certify(case, certified.verify(case))
    places = np.linspace(0, 1, 4001)[1:-1]
    fine = replace(
        proof,
        bounds=dict(proof.bounds),
        cut_segment=np.zeros(len(places), dtype=np.int64),
        cut_fraction=places,
    )
    fine.bounds["inner"] = 5.0  # where it suffices, an interval is bounded by its length alone
    assert recheck(case, fine) == ()


@pytest.mark.parametrize("seed", SEEDS)
def test_no_proof_serves_a_path_that_is_inadmissible(seed):
    """Tighten one limit or deadband beyond the clearance: the proof fails, also with its statements adapted."""
    rng = np.random.default_rng([20260402, seed])
    for case, verdict, proof in proven(seed):
        changed = []
        room = min(b.clearance for b in verdict.boundaries.values() if b.unit == "mm")
        changed.append(replace(case, deadband=replace(case.deadband, arm_mm=room + 1e-6)))
        for line in verdict.speed:
            if line.peak > 0.1 * line.limit:  # its bracket is 0.005 of the limit
                slow = np.array(case.speed)
                slow[line.joint] = line.peak * 0.9
                changed.append(replace(case, speed=slow))
        for end in ("lower", "upper"):
            limits = np.array(getattr(case, end))
            reached = verdict.boundaries["pitch_min" if end == "lower" else "pitch_max"].clearance * DEG
            limits[4] += (reached if end == "lower" else -reached) * 1.01
            changed.append(replace(case, **{end: limits}))
        for other in changed:
            assert not certified.verify(other).admissible
            assert recheck(other, proof)
            bold = {name: value + rng.uniform(0, 1e3) for name, value in proof.bounds.items()}
            assert recheck(other, replace(proof, bounds=bold))


def test_another_turn_is_another_proof():
    case = grazing()
    proof = certify(case, certified.verify(case))
    assert recheck(replace(case, branch=(1, 0)), proof) == (
        "the certificate is for the turns (0, 0), the path for (1, 0)",
    )
    narrow = replace(case, lower=np.array([-1.0, *case.lower[1:]]), upper=np.array([7.0, *case.upper[1:]]))
    reasons = recheck(narrow, replace(proof, q0_turns=3))
    assert "the shoulder does not start within its limits in turn 3" in reasons
    ordinary = problem(*wrist_path([[600, 0, 100], [610, 50, 100]], axis(1.0, 0.3)))
    found = certify(ordinary, certified.verify(ordinary))
    assert recheck(ordinary, replace(found, q0_turns=1)) == (
        "the shoulder does not start within its limits in turn 1",
    )
    turned = recheck(
        replace(case, upper=np.array([*case.upper[:3], 7.0, case.upper[4]])), replace(proof, roll_turns=9)
    )
    assert any(reason.startswith("roll_max") for reason in turned)


def winding(turns, joint, elbow="right", **changes):
    """A path that turns the shoulder or the roll so many times, on an arm whose joints have no limits."""
    count = math.ceil(8 * turns) + 1
    around, still = np.linspace(0.0, 2 * math.pi * turns, count), np.zeros(count)
    bearing, azimuth = (around, around) if joint == 0 else (still, around)
    centres = np.stack((500 * np.cos(bearing), 500 * np.sin(bearing), np.full(count, 250.0)), axis=1)
    tips, axes = wrist_path(centres, axis(30 * DEG, azimuth), tool=1.0)
    lower, upper = (np.array([sign * WIDE, 0.0, 50.0, sign * WIDE, 0.0]) for sign in (-1, 1))
    upper += (0.0, 145 * DEG, 400.0, 0.0, 110 * DEG)
    wide = {"lower": lower, "upper": upper, "speed": np.full(5, 1e6), "tool_length_mm": 1.0}
    made = problem(tips, axes, **(wide | changes))
    return made if elbow == "right" else mirrored(made)


@pytest.mark.parametrize("elbow", ["right", "left"])
@pytest.mark.parametrize("joint", [0, 3])
def test_a_proof_says_that_a_joints_frame_carries_the_path_whatever_the_limits(joint, elbow):
    """Twelve turns fit with a revolution to spare, from -2261 deg on; thirteen do not, wherever they begin."""
    case = winding(12, joint, elbow)
    verdict = certified.verify(case)
    assert verdict.admissible
    proof = certify(case, verdict)
    assert recheck(case, proof) == ()
    name = {0: "q0_turns", 3: "roll_turns"}[joint]
    other = replace(proof, **{name: getattr(proof, name) + 1})
    assert any(f"q{joint} is not proven to stay within +-2261 deg" in r for r in recheck(case, other))
    far = certified.verify(winding(13, joint, elbow))
    assert far.branch is None
    assert any(
        f"q{joint} goes from -" in r
        and "must stay within +-2261 deg, what a joints frame carries" in r
        and "no turns fit" in r
        for r in far.reasons
    )


def test_a_roll_held_where_no_joints_frame_reports_it_is_neither_admitted_nor_proven():
    held = {"hold_roll": 2250 * DEG, "tool_length_mm": 160.0}
    tips = [[500.0, 0.0, 100.0], [510.0, 0.0, 100.0]]
    case = problem(tips, np.tile([0.0, 0.0, 1.0], (2, 1)), **held, lower=np.array([-1.4, 0, 50, -WIDE, 0]), upper=np.array([1.4, 2.5, 450, WIDE, 1.9]))  # fmt: skip
    verdict = certified.verify(case)
    assert verdict.admissible
    proof = certify(case, verdict)
    assert recheck(case, proof) == ()
    far = replace(case, hold_roll=2265 * DEG)
    assert certified.verify(far).branch is None
    assert any(
        "the roll is held at 2265.000 deg, must be within +-2261 deg" in r
        for r in certified.verify(far).reasons
    )
    assert any("q3 is not proven to stay" in r for r in recheck(far, proof))


def test_a_shoulder_of_less_than_a_turn_beyond_the_frame_is_followed_as_well():
    """Limits of 40 deg about 2261 deg: the path must stay on this side of it."""
    for past_deg, fits in ((-15.0, True), (15.0, False)):
        case = winding(0.02, 0)
        start = certified.verify(case).windings[0].least_deg
        turn = (2261.0 + past_deg - start) * DEG
        c, s = math.cos(turn), math.sin(turn)
        around = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        limits = [
            np.array([q0 * DEG, *getattr(case, end)[1:]])
            for q0, end in ((2150.0, "lower"), (2400.0, "upper"))
        ]
        case = replace(
            case, tips_mm=case.tips_mm @ around.T, axes=case.axes @ around.T, lower=limits[0], upper=limits[1]
        )
        verdict = certified.verify(case)
        assert (verdict.branch is not None) is fits, verdict.reasons
        if fits:
            assert recheck(case, certify(case, verdict)) == ()
        else:
            assert any("q0 goes from 227" in r and "+-2261 deg" in r for r in verdict.reasons)


def test_a_shoulder_that_goes_beyond_the_frame_between_two_poses_is_found():
    """Past the column q0 falls and rises again: neither pose is beyond -2261 deg, the middle is."""
    tips, axes = wrist_path(np.array([[300.0, -600.0, 250.0], [300.0, -50.0, 250.0]]), axis(60 * DEG, 0.0))
    at = {
        "lower": np.array([-WIDE, 0.0, 50.0, -WIDE, 0.0]),
        "upper": np.array([WIDE, 145 * DEG, 450.0, WIDE, 110 * DEG]),
    }
    case = problem(tips, axes, speed=np.full(5, 1e6), **at)
    whole = certified.verify(case).windings[0]
    ends = [
        certified.verify(replace(case, tips_mm=tips[[i, i]], axes=axes[[i, i]])).windings[0] for i in (0, 1)
    ]
    least = min(end.least_deg for end in ends)
    assert whole.least_deg < least - 2.0
    for line, fits in ((whole.least_deg - 1.0, True), ((whole.least_deg + least) / 2.0, False)):
        turn = (-2261.0 - line) * DEG
        c, s = math.cos(turn), math.sin(turn)
        around = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        limits = [np.array([q0 * DEG, *at[end][1:]]) for q0, end in ((-2400.0, "lower"), (-2100.0, "upper"))]
        turned = replace(
            case, tips_mm=tips @ around.T, axes=axes @ around.T, lower=limits[0], upper=limits[1]
        )
        assert (certified.verify(turned).branch is not None) is fits


def test_limits_that_lie_beyond_every_joints_frame_are_named():
    case = winding(0.5, 3)
    lower, upper = case.lower.copy(), case.upper.copy()
    lower[3], upper[3] = 3000 * DEG, 3400 * DEG
    reasons = certified.verify(replace(case, lower=lower, upper=upper)).reasons
    assert any("q3: its limits [3000, 3400] deg lie beyond +-2261 deg" in r for r in reasons)


def test_a_start_outside_is_no_proof():
    case = grazing()
    proof = certify(case, certified.verify(case))
    far = replace(case, tips_mm=case.tips_mm + np.array([2000.0, 0.0, 0.0]))
    reasons = recheck(far, proof)
    assert "the path starts outside the planar workspace" in reasons
    assert any("shoulder" in reason for reason in reasons)


def test_a_path_across_the_column_is_no_proof():
    tips, axes = wrist_path([[-400, 0.0, 100], [400, 0.0, 100]], axis(1.0, 0.2))
    case = replace(grazing(), tips_mm=tips, axes=axes)
    proof = certify(grazing(), certified.verify(grazing()))
    assert any("leave open on which side of the column" in reason for reason in recheck(case, proof))


def test_a_held_roll_is_proved_in_its_turn():
    tips, axes = wrist_path([[500, 0, 100], [600, 200, 100]], axis(0.0, 0.0))
    case = problem(tips, axes, hold_roll=0.5)
    proof = certify(case, certified.verify(case))
    assert recheck(case, proof) == ()
    assert "wrist_singularity" not in proof.bounds
    assert "the roll is not held in turn 1" in recheck(case, replace(proof, roll_turns=1))
    outside = replace(case, upper=np.array([*case.upper[:3], 0.4, case.upper[4]]))
    assert any(reason.startswith("roll_max") for reason in recheck(outside, proof))
    leaning = replace(case, axes=axis(1e-6, 0.0)[None].repeat(2, axis=0))
    assert any("wrist_singularity" in reason for reason in recheck(leaning, proof))


@pytest.mark.parametrize("elbow", ["right", "left"])
def test_the_names_are_those_of_the_arm_as_given(elbow):
    seen = set()
    for seed in SEEDS:
        for case, verdict, proof in proven(seed):
            if case.arm.elbow != elbow:
                continue
            for name, boundary in verdict.boundaries.items():
                scale = 1.0 if boundary.unit == "mm" else math.pi / 180
                if name in proof.bounds:
                    assert proof.bounds[name] <= boundary.clearance * scale + 1e-9, name
                    seen.add(name)
    assert {"left", "right", "roll_min", "roll_max"} <= seen


def test_each_statement_is_needed_and_each_must_be_proven():
    case = grazing()
    proof = certify(case, certified.verify(case))
    for name in proof.bounds:
        less = {n: v for n, v in proof.bounds.items() if n != name}
        assert any(
            r.startswith(f"{name}: the certificate states nothing")
            for r in recheck(case, replace(proof, bounds=less))
        )
        for value in (proof.bounds[name] + 1e4, -1e9, math.nan):
            more = {**proof.bounds, name: value}
            assert any(r.startswith(f"{name}: ") for r in recheck(case, replace(proof, bounds=more))), name
    extra = {**proof.bounds, "acceleration 0": -1.0}
    assert recheck(case, replace(proof, bounds=extra)) == (
        "acceleration 0: stated, but does not apply to this path",
    )


@pytest.mark.parametrize(
    ("segment", "fraction"),
    [([0], [0.0]), ([0], [1.0]), ([0], [-0.5]), ([1], [0.5]), ([-1], [0.5]), ([0, 0], [0.5, 0.5]),
     ([0, 0], [0.6, 0.5]), ([0], [math.nan]), ([0], [math.inf])],
)  # fmt: skip
def test_cuts_that_are_no_cuts_of_this_path_are_refused(segment, fraction):
    case = grazing()
    proof = certify(case, certified.verify(case))
    broken = replace(proof, cut_segment=np.array(segment), cut_fraction=np.array(fraction))
    assert any("cuts must lie inside the 1 segments" in reason for reason in recheck(case, broken))


def test_another_number_of_poses_and_unusable_numbers_are_refused():
    case = grazing()
    proof = certify(case, certified.verify(case))
    assert recheck(case, replace(proof, poses=3)) == ("the certificate is for 3 poses, the path has 2",)
    assert (
        recheck(replace(case, feed_mm_s=math.nan), proof)
        == certified.verify(replace(case, feed_mm_s=math.nan)).reasons
    )


def test_an_inadmissible_verdict_has_no_proof():
    case = replace(grazing(), deadband=Deadband(50.0, 2 * DEG))
    assert certify(case, certified.verify(case)) is None


def test_bytes_that_are_no_certificate_are_refused():
    case = grazing()
    body = certify(case, certified.verify(case)).body()
    nan = bytearray(body)
    nan[32:40] = np.float64(np.nan).tobytes()
    mask = bytearray(body)
    mask[31] = 0xFF
    for bad in (b"", body[:10], b"x" + body[1:], body[:-1], body + b"\0", bytes(nan), bytes(mask)):
        with pytest.raises(CertificateError):
            Certificate.parse(bad)
    for size in range(len(body)):
        with pytest.raises(CertificateError):
            Certificate.parse(body[:size])


def test_a_half_that_bulges_more_than_its_whole_stands_alone():
    """Seen from the whole segment's chord the boundary is further away than from the half's."""
    case = random_paths(np.random.default_rng([77, 30]), (9, 40), 250)[27]
    verdict = certified.verify(case)
    assert verdict.admissible
    assert recheck(case, certify(case, verdict)) == ()


def test_most_segments_need_no_cut():
    """2000 poses along a gentle path: the proof is the header alone, a tenth of a byte a pose."""
    s = np.linspace(0, 1, 2000)
    tips, axes = wrist_path(
        np.column_stack((600 + 60 * np.cos(40 * s), 60 * np.sin(40 * s), 250 - 100 * s)),
        axis(0.8 + 0.1 * np.sin(40 * s), 0.3 * np.cos(40 * s)),
    )
    case = problem(tips, axes, acceleration=np.full(5, 1e3))
    proof = certify(case, certified.verify(case))
    assert recheck(case, proof) == ()
    assert len(proof.body()) == 32 + 8 * len(proof.bounds) <= 200


@pytest.mark.parametrize("elbow", ["right", "left"])
@pytest.mark.parametrize("name", ["roll_min", "roll_max"])
def test_a_roll_that_comes_as_near_to_its_limit_as_it_may_is_cut_until_that_is_proven(name, elbow):
    tips, axes = wrist_path([[520.0, -250.0, 150.0], [560.0, 260.0, 140.0]], axis([0.6, 0.7], [0.9, -0.8]))
    case = problem(tips, axes, speed=np.full(5, 300.0))
    case = case if elbow == "right" else mirrored(case)
    room = certified.verify(case).boundaries[name].certified - 2.0
    end = name.replace("roll_max", "upper").replace("roll_min", "lower")
    limits = getattr(case, end).copy()
    limits[3] -= (room - 1e-3) * DEG * (1.0 if end == "upper" else -1.0)
    case = replace(case, **{end: limits})
    verdict = certified.verify(case)
    assert verdict.admissible
    proof = certify(case, verdict)
    assert len(proof.cut_segment) > 0
    assert recheck(case, proof) == ()
    assert 2.0 * DEG <= proof.bounds[name] <= verdict.boundaries[name].clearance * DEG + 1e-9


def vertical(**changes):
    """A vertical tool whose roll is held, on an arm with accelerations."""
    tips, axes = wrist_path([[500, 0, 100], [600, 200, 100]], axis(0.0, 0.0))
    return problem(tips, axes, **({"hold_roll": 0.4, "acceleration": np.full(5, 1e3)} | changes))


@pytest.mark.parametrize("elbow", ["right", "left"])
def test_of_a_held_roll_the_margins_are_stated_and_of_its_joint_no_rate(elbow):
    case = vertical() if elbow == "right" else mirrored(vertical())
    proof = certify(case, certified.verify(case))
    rates = {f"{quantity} {joint}" for quantity in ("speed", "acceleration") for joint in (0, 1, 2, 4)}
    arm = {"inner", "outer", "left", "right", "top", "bottom"}
    assert set(proof.bounds) == arm | {"roll_min", "roll_max", "pitch_max"} | rates
    held = case.hold_roll
    assert proof.bounds["roll_min"] == pytest.approx(held - case.lower[3], abs=1e-8)
    assert proof.bounds["roll_max"] == pytest.approx(case.upper[3] - held, abs=1e-8)
    assert recheck(case, proof) == ()


def test_a_roll_held_exactly_where_a_joints_frame_still_reports_it_is_proven():
    wide = {"lower": np.array([-1.4, 0, 50, -WIDE, 0]), "upper": np.array([1.4, 2.5, 450, WIDE, 1.9])}
    for held in (2261.0, -2261.0):
        case = vertical(hold_roll=math.radians(held), **wide)
        verdict = certified.verify(case)
        assert verdict.admissible
        assert recheck(case, certify(case, verdict)) == ()


def test_what_is_proven_too_little_is_said_in_the_units_of_its_name():
    case = vertical()
    proof = certify(case, certified.verify(case))
    for name, value, shown in (
        ("top", 1e6, "1000000.000000 mm is stated"),
        ("pitch_max", math.pi, "180.000000 deg is stated"),
        ("speed 0", -0.0, "at most 0 rad/s is stated"),
        ("speed 2", 0.0, "at most -0 mm/s is stated"),
        ("acceleration 4", 0.5, "at most -0.5 rad/s2 is stated"),
        ("acceleration 2", 0.5, "at most -0.5 mm/s2 is stated"),
        ("top", math.inf, "nothing is stated"),
    ):
        (reason,) = recheck(case, replace(proof, bounds={**proof.bounds, name: value}))
        assert reason.startswith(f"{name}: {shown}, "), reason


def test_a_certificate_of_nothing_is_its_head():
    none = Certificate(-3, 4, 2, {}, np.zeros(0, np.int64), np.zeros(0))
    body = none.body()
    assert body == b"cutgate.proof/1\0" + struct.pack("<hhIII", -3, 4, 2, 0, 0)
    again = Certificate.parse(body)
    assert (again.q0_turns, again.roll_turns, again.poses, again.bounds) == (-3, 4, 2, {})
    assert len(again.cut_segment) == len(again.cut_fraction) == 0


@pytest.mark.parametrize("joint", [0, 3])
@pytest.mark.parametrize("elbow", ["right", "left"])
def test_the_frame_is_about_the_reported_joint(joint, elbow):
    """Offsets that differ between the joints: each is added to its own."""
    offset = np.array([0.2, 0.01, 1.0, -0.3, 0.05])
    case = winding(12, joint, elbow, calibration=ArmCalibration(joint_offset=offset))
    verdict = certified.verify(case)
    assert verdict.admissible
    proof = certify(case, verdict)
    assert recheck(case, proof) == ()
    found = verdict.windings[0 if joint == 0 else 1]
    turns = {0: verdict.branch.q0_turns, 3: verdict.branch.roll_turns}[joint]
    assert all(abs(angle) <= 2261.0 for angle in found.range_deg(turns))


def test_the_mask_has_a_bit_for_each_boundary_speed_and_acceleration():
    everything = Certificate(
        0, 0, 2, dict.fromkeys(certificate.NAMES, 1.0), np.zeros(0, np.int64), np.zeros(0)
    )
    assert struct.unpack("<I", everything.body()[28:32]) == ((1 << 21) - 1,)
    assert certificate.NAMES[11:] == tuple(
        f"{q} {joint}" for q in ("speed", "acceleration") for joint in range(5)
    )


def test_a_certificate_is_never_changed():
    proof = certify(grazing(), certified.verify(grazing()))
    assert not hasattr(proof, "__dict__")
    with pytest.raises(FrozenInstanceError):
        proof.poses = 3


def test_stated_is_a_little_less_than_proven_and_never_less_than_needed():
    assert certificate._stated(10.0, 5.0) == 10.0 - 1e-8
    assert certificate._stated(0.5, 0.1) == 0.5 - 1e-9
    assert certificate._stated(-10.0, -20.0) == -10.0 - 1e-8
    assert certificate._stated(5.0, 5.0) == 5.0
    assert certificate._stated(4.0, 5.0) == 4.0


@pytest.mark.parametrize(
    ("proven_mm", "stated", "holds"),
    [(2.0, 2.0, True), (2.0, 1.0, True), (2.0, 2.1, False), (2.0, 0.9, False)],
)
def test_proven_is_at_least_stated_and_stated_at_least_needed(proven_mm, stated, holds):
    needing_one = SimpleNamespace(needed=lambda _: 1.0)
    assert (certificate._compared(needing_one, {"top": proven_mm}, {"top": stated}) == ()) is holds


def test_a_start_outside_is_no_proof_though_the_second_pose_is_inside():
    tips, axes = wrist_path([[950.0, 0.0, 100.0], [700.0, 0.0, 100.0]], axis(1.0, 0.3))
    inside = wrist_path([[800.0, 0.0, 100.0], [700.0, 0.0, 100.0]], axis(1.0, 0.3))
    case = problem(*inside)
    proof = certify(case, certified.verify(case))
    assert "the path starts outside the planar workspace" in recheck(
        replace(case, tips_mm=tips, axes=axes), proof
    )


@pytest.mark.parametrize("joint", [0, 3])
def test_a_joint_proven_to_the_very_bound_of_the_frame_is_within(joint):
    case = winding(0.5, joint)
    geometry, segments = canonical(case)
    chain = build(geometry, segments)
    proof = certificate._Proof(case, geometry, segments, chain, (0, 0))
    column, shift = (Q0_MIN, proof.q0.shift) if joint == 0 else (ROLL_MIN, proof.roll.shift)
    low, high = goes(geometry, joint)
    assert shift == 0.0
    least = np.full(COLUMNS_OF_A_PROOF, np.inf)
    least[column], least[column + 1] = low, -high
    assert proof.out_of_frame(least) == ()
    for other in (column, column + 1):
        less = least.copy()
        less[other] = np.nextafter(less[other], -np.inf)
        (reason,) = proof.out_of_frame(less)
        assert reason.startswith(f"q{joint} is not proven to stay within +-2261 deg")


@pytest.mark.parametrize("joint", range(5))
def test_a_speed_that_comes_as_near_to_its_limit_as_it_may_is_proven(joint):
    tips, axes = wrist_path([[520.0, -250.0, 150.0], [560.0, 260.0, 140.0]], axis([0.6, 0.7], [0.9, -0.8]))
    case = problem(tips, axes, speed=np.full(5, 300.0))
    speed = case.speed.copy()
    speed[joint] = certified.verify(replace(case, feed_mm_s=0.5)).speed[joint].peak * 1.0001
    near = replace(case, feed_mm_s=0.5, speed=speed)
    verdict = certified.verify(near)
    if verdict.admissible:
        assert recheck(near, certify(near, verdict)) == ()


@pytest.mark.parametrize("elbow", ["right", "left"])
def test_a_held_rolls_margins_are_those_of_the_reported_joint_whatever_its_offset(elbow):
    offset = ArmCalibration(joint_offset=np.array([0.0, 0.0, 0.0, 0.3, -0.002]))
    case = vertical(calibration=offset) if elbow == "right" else mirrored(vertical(calibration=offset))
    proof = certify(case, certified.verify(case))
    assert proof.bounds["roll_min"] == pytest.approx(case.hold_roll - case.lower[3], abs=1e-8)
    assert proof.bounds["roll_max"] == pytest.approx(case.upper[3] - case.hold_roll, abs=1e-8)
