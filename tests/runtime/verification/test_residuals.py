"""Residuals and tolerances: what must hold is that nothing which they allow brings the roll nearer to its limits.

The rule: let the wrist centre lie anywhere within residual_mm + path_tolerance_mm of a pose of an admitted path, and
the tool axis within residual_deg + path_tolerance_deg of that pose's. Then the roll, followed from the pose to there,
keeps wrist_deg from both of its limits, and the shoulder stays within its own. Wrist and axis are moved here, at
random and in space; the joints come of the reference, no formula for how far they turn is used.
"""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cutgate.runtime.verification import certified
from cutgate.runtime.verification.bounds.chain import build
from cutgate.runtime.verification.bounds.geometry import canonical
from cutgate.runtime.verification.bounds.motion import _widening
from cutgate.runtime.verification.bounds.points import roll_widening
from cutgate.runtime.verification.certificate import certify, recheck
from cutgate.runtime.verification.problem import Arm, ArmCalibration, Deadband
from tests.oracle.dense import COLUMNS, Dense
from tests.runtime.verification.cases import DEG, WIDE, axis, mirrored, problem, wrist_path
from tests.seeds import seeds

LOST_DEG = 0.011
"""What may be lost of the roll: the width of a bracket, 0.01 deg, and what the reference may be off."""

MOVED = 400
"""Displacements tried at each pose looked at."""

ENDS = ("roll_min", "roll_max")


# -- two places ----------------------------------------------------------------------------------


def near_extension(**changes):
    """3.10 mm from the straight elbow, residual 3 mm and arm deadband 0.1 mm."""
    tips = [
        (745.9684935451241, 139.48322421107054, 170.0),
        (745.9088435740765, 139.77723421109596, 170.0),
        (745.8294965947829, 140.06723774403343, 170.0),
    ]
    axes = [(0.8315581240898381, 0.24189064938560412, 0.5000000000000001)] * 3
    values = {
        "lower": np.array([-175 * DEG, 0.0, 50.0, -170 * DEG, 0.0]),
        "upper": np.array([175 * DEG, 145 * DEG, 450.0, 2.888563631378748 * DEG, 110 * DEG]),
        "speed": np.full(5, 1e6),
        "calibration": ArmCalibration(residual_mm=3.0),
        "deadband": Deadband(0.1, 0.5 * DEG),
    }
    return problem(tips, axes, **(values | changes))


def near_fold(**changes):
    """3.8 mm from the folded elbow of equal links, residual 3 mm and arm deadband 0.5 mm."""
    tips = [
        (30.679051346679316, -135.1620858140133, 170.0),
        (30.65789721969671, -135.06435185970733, 170.0),
        (30.653543927894813, -134.96220931076317, 170.0),
    ]
    axes = [(-0.16846748969301623, 0.8494814329439657, 0.5000000000000001)] * 3
    values = {
        "lower": np.array([-175 * DEG, 0.0, 50.0, -51.93536651403848 * DEG, 0.0]),
        "upper": np.array([175 * DEG, 180 * DEG, 450.0, 170 * DEG, 110 * DEG]),
        "speed": np.full(5, 1e6),
        "calibration": ArmCalibration(residual_mm=3.0),
        "deadband": Deadband(0.5, 0.5 * DEG),
    }
    return problem(tips, axes, **(values | changes))


PLACES = {"extension": (near_extension, "roll_max"), "fold": (near_fold, "roll_min")}

in_both_places = pytest.mark.parametrize("place", PLACES)
both_elbows = pytest.mark.parametrize("elbow", ["right", "left"])


def posed(place, elbow, **changes):
    case = PLACES[place][0](**changes)
    return case if elbow == "right" else mirrored(case)


def end(name, elbow):
    """A roll boundary's name in the mirror image."""
    return name if elbow == "right" else ENDS[1 - ENDS.index(name)]


@both_elbows
@in_both_places
@pytest.mark.parametrize("part", [0.0, 0.4, 1.0])
def test_a_wrist_off_by_residual_and_tolerance_that_turns_the_roll_past_its_limit_is_not_admitted(
    place, elbow, part
):
    """The published widening residual / (a1 sin q1) admits both places; the wrist moved turns the roll beyond."""
    arm_mm = PLACES[place][0]().deadband.arm_mm
    case = posed(
        place,
        elbow,
        calibration=ArmCalibration(residual_mm=3.0 * part),
        deadband=Deadband(arm_mm, 0.5 * DEG, path_tolerance_mm=3.0 * (1 - part)),
    )
    name = end(PLACES[place][1], elbow)
    verdict = certified.verify(case)
    assert not verdict.admissible
    assert [b.name for b in verdict.boundaries.values() if b.violated] == [name]
    assert verdict.boundaries[name].clearance < -0.9
    assert verdict.boundaries[name].clearance == pytest.approx(least_moved(case)[ENDS.index(name)], abs=0.01)


@both_elbows
@in_both_places
def test_near_a_singular_elbow_a_roll_limit_far_away_is_admitted(place, elbow):
    """By the least sin q1 over the disc alone the roll could turn by 13 deg here, and by 344 deg near the fold."""
    free = posed(place, elbow)
    low, high = roll_range(free)
    lower, upper = free.lower.copy(), free.upper.copy()
    lower[3], upper[3] = low - (0.5 + LOST_DEG) * DEG, high + (0.5 + LOST_DEG) * DEG
    case = replace(free, lower=lower, upper=upper)
    verdict = certified.verify(case)
    assert verdict.admissible, verdict.reasons
    assert recheck(case, certify(case, verdict)) == ()


@both_elbows
@in_both_places
def test_a_proof_that_states_what_the_published_widening_would_prove_is_no_proof(place, elbow):
    case = posed(place, elbow)
    more = np.array((0.0, 0.0, 0.0, 1.0, 0.0))
    free = replace(case, lower=case.lower - more, upper=case.upper + more)
    proof = certify(free, certified.verify(free))
    assert recheck(free, proof) == ()
    name = end(PLACES[place][1], elbow)
    bold = {**proof.bounds, **dict.fromkeys(ENDS, 0.5 * DEG)}
    wrong = recheck(case, replace(proof, bounds=bold))
    assert [reason.split(":")[0] for reason in wrong] == [name]
    assert "0.500000 deg is stated" in wrong[0]


@in_both_places
def test_where_the_disc_of_the_errors_reaches_the_singular_elbow_the_roll_is_undefined(place):
    case = posed(place, "right", calibration=ArmCalibration(residual_mm=4.0))
    verdict = certified.verify(case)
    assert not verdict.admissible
    assert verdict.boundaries["outer" if place == "extension" else "inner"].violated
    assert all(verdict.boundaries[name].violated for name in ENDS)


# -- at random -----------------------------------------------------------------------------------


def drawn(rng):
    """A short path of a random arm near or far from the straight or folded elbow, with errors; limits are wide."""
    elbow = str(rng.choice(["right", "left"]))
    a0, a1 = rng.uniform(150, 600, 2)
    a1 = a0 if rng.random() < 0.3 else a1
    error = 10.0 ** rng.uniform(-2, 0.9)
    part = rng.choice([0.0, 1.0, rng.uniform()])
    turn, turned = (
        10.0 ** rng.uniform(-2, 0.8) * DEG * (rng.random() < 0.7),
        rng.choice([0.0, 1.0, rng.uniform()]),
    )
    leans = rng.random() < 0.4
    arm_mm = 10.0 ** rng.uniform(-3, 0.7)
    calibration = ArmCalibration(
        residual_mm=error * part,
        residual_rad=turn * turned,
        slide_tilt=rng.uniform(-0.02, 0.02, 2) if leans else np.zeros(2),
    )
    wrist_rad = 10.0 ** rng.uniform(-2, 0.5) * DEG
    deadband = Deadband(arm_mm, wrist_rad, error * (1 - part), turn * (1 - turned))
    reach = (abs(a0 - a1), a0 + a1)
    kept = (arm_mm + error) * math.hypot(1.0, *calibration.slide_tilt)
    off = kept + 10.0 ** rng.uniform(-4, 2, 4)
    r = {
        "extension": reach[1] - off,
        "fold": reach[0] + off,
        "anywhere": np.full(4, rng.uniform(reach[0] + kept, reach[1] - kept)),
    }[str(rng.choice(["extension", "fold", "anywhere"]))]
    r = np.clip(r, reach[0] + kept + 0.002, reach[1] - kept - 0.002)
    bearing = rng.uniform(-math.pi, math.pi) + np.cumsum(10.0 ** rng.uniform(-4, -1) * rng.normal(size=4))
    height = rng.uniform(100, 400) + rng.normal(0, 3, 4)
    flat = (
        np.stack((r * np.cos(bearing), r * np.sin(bearing)), axis=1)
        + height[:, None] * calibration.slide_tilt
    )
    least = wrist_rad + turn + 0.01 * DEG
    pitch = np.clip(rng.uniform(least, math.pi - least) + rng.normal(0, 0.01, 4), least, math.pi - least)
    azimuth = rng.uniform(-3, 3) + rng.normal(0, 0.02, 4)
    tool = float(rng.uniform(20, 200))
    tips, axes = wrist_path(np.column_stack((flat, height)), axis(pitch, azimuth), tool)
    return problem(
        tips,
        axes,
        tool_length_mm=tool,
        arm=Arm(float(a0), float(a1), elbow),
        lower=np.array([-WIDE, 0.0 if elbow == "right" else -math.pi, -1e4, -WIDE, 0.0]),
        upper=np.array([WIDE, math.pi if elbow == "right" else 0.0, 1e4, WIDE, math.pi]),
        speed=np.full(5, 1e12),
        calibration=calibration,
        deadband=deadband,
    )


@cache
def dense(case_seed):
    """The first problem of a seed that keeps all but the roll's limits, with its reference."""
    rng = np.random.default_rng([20270101, *case_seed])
    while True:
        case = drawn(rng)
        reference = Dense(case, 60)
        least = dict(zip(COLUMNS, minima := reference.minima(), strict=True))
        arm = min(least["inner"], least["outer"]) - case.deadband.arm_mm - reference.error_mm
        wrist = least["wrist_singularity"] * DEG - case.deadband.wrist_rad - reference.error_rad
        if reference.inside.all() and arm > 0.001 and wrist > 0.0:
            return case, reference, minima


def roll_range(case):
    """Least and largest roll that the errors allow on the path, less the axis's own error, rad."""
    reference = Dense(case, 60)
    return ranged(reference, reference.minima())


def ranged(reference, least):
    """The same, unwrapped as the reported roll of turn 0."""
    shift = float(reference.unwrapped(3, 0)[0] - reference.q3[0])
    low, high = (math.radians(least[COLUMNS.index(name)]) for name in ENDS)
    return low + shift, shift - high


def least_moved(case):
    """Both margins of the roll by the reference, deg."""
    low, high = roll_range(case)
    return math.degrees(low - case.lower[3]), math.degrees(case.upper[3] - high)


def with_roll_limits(case, low, high, room_rad):
    """Limits that leave so much beyond the deadbands of a roll between low and high."""
    lower, upper = case.lower.copy(), case.upper.copy()
    d, c = case.deadband, case.calibration
    keep = d.wrist_rad + d.path_tolerance_rad + c.residual_rad + room_rad
    lower[3], upper[3] = low - keep, high + keep
    return replace(case, lower=lower, upper=upper)


SEEDS = [(share, number) for share in range(8) for number in range(25)]
by_share = pytest.mark.parametrize("share", seeds(3, 5))


def tight(share):
    """The share's random problems with roll limits that they keep by the reference, just."""
    found = []
    for seed in SEEDS:
        if seed[0] == share:
            case, reference, least = dense(seed)
            found.append((with_roll_limits(case, *ranged(reference, least), LOST_DEG * DEG), seed))
    return found


@by_share
def test_no_more_than_a_bracket_is_lost_of_the_roll_wherever_the_elbow_stands(share):
    """Both elbows, any links, either error alone and both together, leaning slides, near and far from singular."""
    for case, seed in tight(share):
        verdict = certified.verify(case)
        assert verdict.admissible, (seed, verdict.reasons)
        assert recheck(case, certify(case, verdict)) == (), seed


@by_share
def test_limits_that_a_moved_wrist_or_axis_brings_the_roll_too_near_to_are_refused(share):
    for seed in SEEDS:
        if seed[0] != share:
            continue
        case, reference, least = dense(seed)
        low, high = ranged(reference, least)
        for ends in ((low + 1e-6, high + 1.0), (low - 1.0, high - 1e-6)):
            near = with_roll_limits(case, *ends, 0.0)
            assert not certified.verify(near).admissible, seed


def ball(rng, radius, shape):
    """Points of a ball, most of them on its surface, (*shape, 3)."""
    step = rng.normal(size=(*shape, 3))
    step /= np.linalg.norm(step, axis=-1, keepdims=True)
    inside = rng.random(shape) < 0.2
    return step * (radius * np.where(inside, rng.random(shape) ** (1 / 3), 1.0))[..., None]


def cone(rng, axes, angle, shape):
    """Axes within an angle of the given ones, most of them on the cone's edge, (m, k, 3)."""
    u = np.repeat(axes[:, None, :], shape[1], axis=1)
    beside = np.cross(u, rng.normal(size=u.shape))
    beside /= np.linalg.norm(beside, axis=-1, keepdims=True)
    by = (angle * np.where(rng.random(shape) < 0.2, rng.random(shape), 1.0))[..., None]
    return u * np.cos(by) + beside * np.sin(by)


@by_share
def test_no_wrist_and_axis_within_the_errors_of_an_admitted_path_come_nearer_to_a_limit_than_the_deadband(
    share,
):
    """Moved in space, in ten steps from the pose outward, so that the joints are followed and not guessed."""
    looked = 0
    for case, seed in tight(share):
        if not certified.verify(case).admissible:
            continue
        rng = np.random.default_rng([20270102, *seed])
        reference = Dense(case, 12)
        c, d = case.calibration, case.deadband
        tip, axes = reference.poses(reference.samples.segment, reference.samples.s)
        wrist = tip + case.tool_length_mm * axes
        shape = (len(tip), MOVED)
        step, turned = (
            ball(rng, c.residual_mm + d.path_tolerance_mm, shape),
            cone(rng, axes, c.residual_rad + d.path_tolerance_rad, shape),
        )
        followed = []
        for part in np.linspace(0, 1, 11):
            w = wrist[:, None, :] + part * step
            u = axes[:, None, :] + part * (turned - axes[:, None, :])
            q0, q1 = reference.arm(w[..., :2] - w[..., 2:] * c.slide_tilt)
            followed.append((q0, np.arctan2(u[..., 1], u[..., 0]) - q0 - q1))
        q0, q3 = (np.unwrap(np.stack(angles), axis=0) for angles in zip(*followed, strict=True))
        assert np.isfinite(q3).all(), seed
        strayed = q3[-1] - q3[0]
        roll = reference.unwrapped(3, 0)[:, None] + strayed
        assert roll.min() >= case.lower[3] + d.wrist_rad - 1e-9, seed
        assert roll.max() <= case.upper[3] - d.wrist_rad + 1e-9, seed
        assert np.abs(q0[-1] - q0[0]).max() < math.pi, seed
        looked += strayed.size
    assert looked > 20 * 36 * MOVED


@by_share
def test_no_wrist_within_the_errors_of_an_admitted_path_leaves_the_shoulders_limits(share):
    """Limits of the shoulder just kept, spans over a turn among them: the arcs' deadband holds the disc."""
    kept = 0
    for seed in SEEDS:
        if seed[0] != share:
            continue
        case, reference, _ = dense(seed)
        rng = np.random.default_rng([20270103, *seed])
        q0 = reference.unwrapped(0, 0)
        span = rng.choice([0.3, 2.0, 6.4, 8.0])
        upper, lower = case.upper.copy(), case.lower.copy()
        side = rng.choice([-1.0, 1.0])
        off = 10.0 ** rng.uniform(-3, 0)
        if side > 0:
            upper[0] = q0.max() + off
            lower[0] = upper[0] - max(span, np.ptp(q0) + 2 * off)
        else:
            lower[0] = q0.min() - off
            upper[0] = lower[0] + max(span, np.ptp(q0) + 2 * off)
        near = replace(case, lower=lower, upper=upper, branch=(0, 0))
        if not certified.verify(near).admissible:
            continue
        kept += 1
        wrist = reference.poses(reference.samples.segment, reference.samples.s)
        wrist = (wrist[0] + case.tool_length_mm * wrist[1])[::7]
        c, d = case.calibration, case.deadband
        step = ball(rng, c.residual_mm + d.path_tolerance_mm, (len(wrist), MOVED))
        followed = []
        for part in np.linspace(0, 1, 11):
            w = wrist[:, None, :] + part * step
            followed.append(reference.arm(w[..., :2] - w[..., 2:] * c.slide_tilt)[0])
        moved = np.unwrap(np.stack(followed), axis=0)
        moved = q0[::7, None] + moved[-1] - moved[0]
        assert lower[0] < moved.min(), seed
        assert moved.max() < upper[0], seed
    assert kept > 3


# -- the bound over an interval ------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(8))
def test_the_widening_between_two_radii_is_the_larger_of_both_ends(seed):
    """As it is convex in the radius; tried at a thousand radii between, on arms of every proportion."""
    rng = np.random.default_rng([20270104, seed])
    tried = 0
    while tried < 40:
        case = drawn(rng)
        geometry, segments = canonical(case)
        build(geometry, segments)
        space, d = geometry.workspace, geometry.error_mm
        least, most = abs(space.a0 - space.a1) + d, space.a0 + space.a1 - d
        ends = least + (most - least) * np.sort(
            np.concatenate((rng.random(2), 10.0 ** rng.uniform(-9, 0, 2)))
        )
        low, high = ends[rng.integers(0, 2)], ends[rng.integers(2, 4)]
        sine = np.array(0.9)
        whole = _widening(geometry, (np.array([low]), np.array([high])), sine)[0]
        within = roll_widening(geometry, np.linspace(low, high, 1000), sine)
        if np.isfinite(whole).all():
            assert (within <= whole + 1e-12).all()
            tried += 1
