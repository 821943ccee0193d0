"""Cuts, joint lines and the margins on them by the oracle, for the tests of approach and retract."""

import math
from dataclasses import replace

import numpy as np

from cutgate.runtime.verification import certified
from cutgate.runtime.verification.approach.joint_line import joint_line as decided
from cutgate.runtime.verification.approach.model import StartJoints
from cutgate.runtime.verification.bounds.geometry import canonical
from cutgate.runtime.verification.steps import finished
from tests.oracle.dense import COLUMNS, Dense
from tests.runtime.verification.cases import DEG, axis, problem, random_problem, wrist_path

ARCS = ("inner", "outer", "left", "right")


MIDDLE = np.array([0.0, 72.5 * DEG, 250.0, 0.0, 55.0 * DEG])


def cut(**changes):
    """A short cut with a tilted tool, inside every limit of the example robot."""
    tips = np.array([[500.0, 50.0, 120.0], [505.0, 55.0, 115.0], [520.0, 60.0, 110.0]])
    return problem(tips, np.tile(axis(30 * DEG, 0.0), (3, 1)), branch=(0, 0), **changes)


def spinning(**changes):
    """q0 within +-400 deg, roll within +-700 deg."""
    lower, upper = (
        np.array([-400 * DEG, 0, 50, -700 * DEG, 0]),
        np.array([400 * DEG, 145 * DEG, 450, 700 * DEG, 110 * DEG]),
    )
    return cut(lower=lower, upper=upper, **changes)


def vertical(hold_roll):
    tips, axes = wrist_path(np.array([[600.0, 0.0, 300.0], [620.0, 10.0, 290.0]]), (0.0, 0.0, 1.0))
    return problem(tips, axes, hold_roll=hold_roll, branch=(0, 0))


def joint_line(given_problem, start, pose, name="approach", **tolerances):
    """The verdict on a joint line between any two joints."""
    geometry, _ = canonical(given_problem)
    begin = StartJoints(np.asarray(start, float), 0, **tolerances)
    return finished(decided(geometry, begin, name, np.asarray(pose, float), roll_held=False))


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
        out |= dict(zip(("left", "right"), dense.unwrapped_sides(turns[0]).T, strict=True))
    shift = np.degrees(dense.unwrapped(3, turns[1])[0] - dense.q3[0])
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
    return made, StartJoints(joints, int(rng.integers(0, 20_000)), tolerance, tolerance * DEG / 2)
