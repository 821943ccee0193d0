"""The answer alone against the whole verification, for the quick tests and for the long run alike."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from cutgate.runtime.verification import certified
from cutgate.runtime.verification.decide import decide
from cutgate.runtime.verification.problem import ArmCalibration
from tests.oracle.dense import Dense
from tests.runtime.verification.cases import DEG
from tests.runtime.verification.judge import Case, admitted_paths_keep_every_deadband
from tests.runtime.verification.random_paths import random_path

FAST = np.full(5, 1e9)


@dataclass
class Compared:
    """What came of a share: ``wrong`` in words; how many were admitted, by one look alone, and held against samples."""

    problems: int = 0
    admitted: int = 0
    alone: int = 0
    sampled: int = 0
    wrong: list = field(default_factory=list)

    def add(self, other):
        """Take another share in."""
        for name, value in vars(other).items():
            setattr(self, name, getattr(self, name) + value)


def refined(problem, parts):
    """The same path with each segment parted into so many."""
    tips, axes = [], []
    for i in range(len(problem.tips_mm) - 1):
        u, v = problem.axes[i], problem.axes[i + 1]
        theta = math.atan2(np.linalg.norm(np.cross(u, v)), float(u @ v))
        for s in np.arange(parts) / parts:
            tips.append(problem.tips_mm[i] + s * (problem.tips_mm[i + 1] - problem.tips_mm[i]))
            turned = math.sin((1 - s) * theta) * u + math.sin(s * theta) * v
            axes.append(u if theta == 0 else turned / math.sin(theta))
    axes = np.array([*axes, problem.axes[-1]])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return replace(problem, tips_mm=np.array([*tips, problem.tips_mm[-1]]), axes=axes)


def drawn(rng, parts):
    """A random path, fine or coarse, of which the roll's limits are often less than a revolution, or nearly one."""
    found = random_path(rng, int(rng.integers(1, 5)), lean=float(rng.choice([0.02, 0.7])))
    lower, upper = found.lower.copy(), found.upper.copy()
    if rng.random() < 0.8:
        middle = rng.uniform(-2, 2)
        half = rng.choice([rng.uniform(1.0, 3.1), math.pi - 10.0 ** rng.uniform(-5, -1)])
        lower[3], upper[3] = middle - half, middle + half
    if upper[0] - lower[0] >= 2 * math.pi and rng.random() < 0.8:
        upper[0] = lower[0] + 6.2
    if rng.random() < 0.4:
        found = replace(
            found,
            calibration=ArmCalibration(
                *rng.uniform(-2, 2, 2),
                joint_offset=rng.uniform(-0.1, 0.1, 5) * (1, 1, 100, 1, 1),
                slide_tilt=found.calibration.slide_tilt,
                residual_mm=float(rng.choice([0.0, 0.1, 3.0])),
                residual_rad=float(rng.choice([0.0, 0.001, 0.1])),
            ),
        )
    if rng.random() < 0.5:
        accelerations = np.array([5.0, 5.0, 1000.0, 10.0, 10.0]) * rng.choice([1.0, 10.0, 1e9])
        found = replace(found, acceleration=accelerations)
    found = replace(found, lower=lower, upper=upper, speed=FAST if rng.random() < 0.5 else found.speed)
    return refined(found, int(rng.choice(parts)))


def closed_in(rng, problem, verdict):
    """The same path with one limit or deadband almost what the path has, to either side; itself where it has none."""
    little = float(rng.choice([-1, 1], p=[0.3, 0.7])) * 10.0 ** rng.uniform(-9, 0)
    has = {name: b.clearance for name, b in verdict.boundaries.items() if b.clearance is not None}
    kind = str(rng.choice(["arm", *ENDS, "speed", "acceleration"]))
    if kind == "arm":
        return _arm_closed_in(problem, verdict, has, little)
    if kind not in ENDS:
        if getattr(problem, kind) is None:
            return problem
        peaks = np.array([line.peak or 1.0 for line in getattr(verdict, kind)])
        return replace(problem, **{kind: peaks * (1 + 0.1 * little)})
    lower, upper = problem.lower.copy(), problem.upper.copy()
    for name, spare in ((kind, little), (OPPOSITE.get(kind), abs(little) if rng.random() < 0.5 else None)):
        if name in has and spare is not None:
            joint, sign, unit = ENDS[name]
            needed = verdict.deadband_arm_mm if joint == 2 else verdict.deadband_wrist_rad
            (upper if sign > 0 else lower)[joint] -= sign * (has[name] * unit - needed - spare * unit)
    return problem if (lower >= upper).any() else replace(problem, lower=lower, upper=upper)


ENDS = {
    "top": (2, 1, 1.0),
    "bottom": (2, -1, 1.0),
    "roll_max": (3, 1, DEG),
    "roll_min": (3, -1, DEG),
    "pitch_max": (4, 1, DEG),
    "pitch_min": (4, -1, DEG),
}
"""Joint, which of its limits, and the unit of its clearance."""

OPPOSITE = {"roll_max": "roll_min", "roll_min": "roll_max"}


def _arm_closed_in(problem, verdict, has, little):
    sides = {"inner", "outer", "left", "right"}
    if not sides <= set(has):
        return problem
    errors = verdict.deadband_arm_mm - problem.deadband.arm_mm
    room = min(has[name] for name in sides) - errors - little
    if not room > 0:
        return problem
    along = np.array([0.0, 0.0, 1000.0, 0.0, 0.0])
    deadband = replace(problem.deadband, arm_mm=room)
    return replace(problem, deadband=deadband, lower=problem.lower - along, upper=problem.upper + along)


def share(seed, count, sampled_part, parts=(1, 1, 1, 4, 4, 30, 30, 100)):
    """Compare so many random problems, and hold a part of those admitted by one look alone against dense samples."""
    rng, found = np.random.default_rng(seed), Compared()
    while found.problems < count:
        problem = drawn(rng, parts)
        verdict = compare(problem, f"{seed}, {found.problems}", found, sampled_part, rng)
        if not verdict.admissible:
            easy = None if problem.acceleration is None else FAST * 1e3
            problem = replace(problem, speed=FAST, acceleration=easy)
            verdict = certified.verify(problem)
        for _ in range(min(3, count - found.problems)):
            compare(closed_in(rng, problem, verdict), f"{seed}, {found.problems}", found, sampled_part, rng)
    return found


def compare(problem, where, found, sampled_part, rng):
    """The whole verdict of one problem; what differs goes to ``found``."""
    verdict, decided = certified.verify(problem), decide(problem)
    branch = None if verdict.branch is None else (verdict.branch.q0_turns, verdict.branch.roll_turns)
    found.problems += 1
    found.admitted += verdict.admissible
    if decided[:2] != (verdict.admissible, branch):
        found.wrong.append((where, decided, verdict.admissible, branch, verdict.reasons))
    if decided.admissible and decided.open_segments == 0:
        found.alone += 1
        if rng.random() < sampled_part:
            found.sampled += 1
            dense = Dense(problem, 48 if len(problem.tips_mm) < 20 else 8)
            case = Case(problem, verdict, dense, dense.minima())
            found.wrong += [(where, what) for what in admitted_paths_keep_every_deadband(case)]
    return verdict
