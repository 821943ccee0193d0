"""The rules of the gate against the dense reference, for the quick tests and for the long run alike.

Each rule takes a problem with its verdict and its reference and yields what is wrong, in words.
"""

import math
from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from cutgate.runtime.verification import certified
from tests.oracle.dense import COLUMNS, SIDES, Dense
from tests.runtime.verification.cases import DEG
from tests.runtime.verification.random_paths import random_paths, with_deadband

ORACLE = 1e-6
"""What the reference's minima may be above the true ones, mm and deg: its last step, squared."""

GAP = 0.01
"""The documented width of a bracket, mm and deg."""

ROOM = GAP + 0.001
"""A path with this much more than its deadbands must be admitted."""

SLOW = 0.97
"""The same for joint speeds: the part of their limits up to which they must be admitted."""

ARM = (*SIDES, "top", "bottom")
WRIST = ("pitch_min", "pitch_max", "wrist_singularity", "roll_min", "roll_max")


@dataclass
class Case:
    """A problem, its verdict, its reference, and the least margins of the path by the reference."""

    problem: object
    verdict: object
    dense: Dense
    least: np.ndarray

    @cached_property
    def inside(self):
        """Whether the whole path stays within the reach and within the shoulder's limits."""
        bounding = 2 if self.dense.full else 4
        if not (self.dense.stays_inside and self.least[:bounding].min() >= 0.0):
            return False
        return not self.dense.full or bool(self.dense.turns_that_fit(0, self.least))

    @cached_property
    def keeps_its_bend(self):
        """Whether every place within the errors of the wrist centre is reached with an elbow neither straight nor folded.

        The deadbands of inner and outer see to it, but for places beyond a shoulder's limit, where these arcs end.
        """
        dense = self.dense
        square = dense.a0**2 + dense.a1**2 + 2 * dense.a0 * dense.a1 * np.cos(dense.samples.q[:, 1])
        radius, error = np.sqrt(square), dense.error_mm + ORACLE
        return radius.max() + error < dense.a0 + dense.a1 and radius.min() - error > abs(dense.a0 - dense.a1)

    @cached_property
    def margins(self):
        """Least margin of each boundary that the reference knows, in the verdict's joint branch."""
        found = dict(zip(COLUMNS[:9], self.least[:9].tolist(), strict=True))
        branch = self.verdict.branch
        if branch is not None:
            found |= zip(
                ("roll_min", "roll_max"), self.dense.roll_margins(self.least, branch.roll_turns), strict=True
            )
        if self.dense.full:
            sides = (np.inf, np.inf) if branch is None else self.dense.least_unwrapped_sides(branch.q0_turns)
            found |= zip(("left", "right"), sides, strict=True)
        return found

    @cached_property
    def best(self):
        """Least arm and wrist margins, mm and deg, in the best joint branch; None out of the reach."""
        dense, least = self.dense, self.least
        if not self.inside:
            return None
        unwrapped = {"left", "right"} if dense.full else set()
        arm = min(least[i] for i, n in enumerate(COLUMNS) if n in ARM and n not in unwrapped)
        if dense.full:
            turns = dense.turns_that_fit(0, least)
            arm = min(arm, max((dense.least_unwrapped_sides(k).min() for k in turns), default=-math.inf))
        wrist = min(least[i] for i, n in enumerate(COLUMNS) if n in WRIST[:3])
        roll = max(
            (min(dense.roll_margins(least, k)) for k in dense.turns_that_fit(3, least)), default=-math.inf
        )
        return float(arm), float(min(wrist, roll))


def judged(problem, per_segment):
    """Verify a problem and compute its reference."""
    dense = Dense(problem, per_segment)
    return Case(problem, certified.verify(problem), dense, dense.minima())


def room(case):
    """What the path has beyond its deadbands by the reference, the smaller of mm and deg; minus infinity outside."""
    margins = case.best
    if margins is None:
        return -math.inf
    verdict = case.verdict
    return min(margins[0] - verdict.deadband_arm_mm, margins[1] - math.degrees(verdict.deadband_wrist_rad))


# -- rules ---------------------------------------------------------------------------------------


def admitted_paths_keep_every_deadband(case):
    if not case.verdict.admissible:
        return
    if not case.inside:
        yield "admitted though a sampled pose is out of reach"
    for name, least in case.margins.items():
        deadband = (
            case.verdict.deadband_arm_mm if name in ARM else math.degrees(case.verdict.deadband_wrist_rad)
        )
        if not least >= deadband - ORACLE:
            yield f"admitted with {name} {least}, deadband {deadband}"
    for joint, limit in enumerate(case.problem.speed):
        if not -case.least[COLUMNS.index(f"speed{joint}")] <= limit * (1 + 1e-6):
            yield f"admitted with joint {joint} faster than {limit}"


def paths_with_room_are_admitted(case):
    fastest = -case.least[COLUMNS.index("speed0") :]
    if room(case) >= ROOM and (fastest <= SLOW * case.problem.speed).all() and not case.verdict.admissible:
        yield f"refused with room of {room(case)}: {case.verdict.reasons}"


def bounds_lie_below_every_sampled_pose(case):
    margins = case.margins
    for name, b in case.verdict.boundaries.items():
        if b.certified is None:
            if not b.violated:
                yield f"{b} is undefined and not violated"
            continue
        if not b.certified <= b.clearance or b.violated is (b.certified >= b.deadband):
            yield f"{b} contradicts itself"
        if name in margins and not b.certified <= margins[name] + ORACLE:
            yield f"{b} is proved above the sampled {margins[name]}"


def defines_the_roll(verdict):
    """Whether the boundaries are kept near which the roll is undefined or turns without bound."""
    return all(
        name in verdict.boundaries and not verdict.boundaries[name].violated
        for name in ("inner", "outer", "wrist_singularity")
    )


def brackets_are_a_hundredth_wide_inside_the_reach(case):
    if not case.inside:
        return
    kept = defines_the_roll(case.verdict) and case.keeps_its_bend
    margins = case.margins
    for name, b in case.verdict.boundaries.items():
        if b.clearance is None:
            if kept or not name.startswith("roll"):
                yield f"{b} is undefined inside the reach"
        elif (kept or not name.startswith("roll")) and not b.clearance - b.certified <= GAP:
            yield f"{b} is wider than {GAP}"
        elif name in margins and math.isfinite(margins[name]) and not b.clearance <= margins[name] + ROOM:
            yield f"{b} is not as small as the sampled {margins[name]}"


def clearances_are_attained_where_reported(case):
    if not case.inside:
        return
    named = [b for b in case.verdict.boundaries.values() if b.clearance is not None and b.name in COLUMNS[:9]]
    if case.dense.full:
        named = [b for b in named if b.name not in {"left", "right"}]
    x = case.dense.at(np.array([b.segment for b in named]), np.array([b.fraction for b in named]))
    there = case.dense.columns(x, x.q[:, 0], x.q[:, 3])
    for row, b in zip(there, named, strict=True):
        if not abs(row[COLUMNS.index(b.name)] - b.clearance) <= ORACLE:
            yield f"{b} is {row[COLUMNS.index(b.name)]} at the place it names"


def speeds_are_bounded(case):
    if not case.inside:
        return
    for line in case.verdict.speed:
        found = -case.least[COLUMNS.index(f"speed{line.joint}")]
        if line.ok is not (line.peak is not None and line.peak <= line.limit):
            yield f"{line} contradicts itself"
        if line.peak is not None and not found <= line.peak * (1 + 1e-6) + 1e-6:
            yield f"{line} is below the sampled {found}"


RULES = (
    admitted_paths_keep_every_deadband,
    paths_with_room_are_admitted,
    bounds_lie_below_every_sampled_pose,
    brackets_are_a_hundredth_wide_inside_the_reach,
    clearances_are_attained_where_reported,
    speeds_are_bounded,
)


# -- the deadband itself -------------------------------------------------------------------------


def at_its_deadbands(case):
    """The same path with deadbands just kept, which must be admitted, and just missed, which must be refused."""
    margins = case.best
    if margins is None:
        return
    arm, wrist = margins[0] - case.dense.error_mm, margins[1] * DEG - case.dense.error_rad
    kept, missed, little = (arm - ROOM, wrist - ROOM * DEG), 2 * ORACLE, 1e-9
    in_no_time = not np.isfinite(case.least).all()  # a turn on the spot with a tool of no length
    if not min(kept) > 0 or in_no_time:
        return
    if not certified.verify(with_deadband(case.problem, *kept)).admissible:
        yield "paths_with_room_are_admitted", f"refused with deadbands {ROOM} below its margins {margins}"
    for deadband in ((arm + missed, little), (little, wrist + missed * DEG)):
        if certified.verify(with_deadband(case.problem, *deadband)).admissible:
            yield "admitted_paths_keep_every_deadband", f"admitted at {deadband}, margins {margins}"


# -- a share of random segments ------------------------------------------------------------------


@dataclass
class Tally:
    """What came of a share of random segments; ``wrong`` holds (rule, seed and case, what)."""

    segments: int = 0
    paths: int = 0
    admitted: int = 0
    refused_within_a_hundredth: int = 0
    undecided: int = 0
    largest_gap: float = 0.0
    sharpened: int = 0
    wrong: list = field(default_factory=list)

    def add(self, other):
        """Take another share in."""
        for name, value in vars(other).items():
            mine = getattr(self, name)
            setattr(self, name, max(mine, value) if name == "largest_gap" else mine + value)

    @property
    def by_rule(self):
        """How often each rule was broken."""
        return Counter(rule for rule, _, _ in self.wrong)


def undecided(verdict):
    """Whether some bracket straddles its deadband."""
    return any(
        b.certified is not None and b.certified < b.deadband <= b.clearance
        for b in verdict.boundaries.values()
    )


def widest(verdict):
    """Widest bracket among those that the documentation promises to be a hundredth wide, mm and deg."""
    return max(
        b.clearance - b.certified
        for b in verdict.boundaries.values()
        if b.clearance is not None and (defines_the_roll(verdict) or not b.name.startswith("roll"))
    )


def turns_in_no_time(problem):
    """Whether the axis turns in a segment that is planned to take no time: refused by name, nothing to judge."""
    rests = (np.diff(problem.tips_mm, axis=0) == 0.0).all(axis=1) & (problem.tool_length_mm == 0.0)
    return bool((rests & (np.diff(problem.axes, axis=0) != 0.0).any(axis=1)).any())


def share(seed, count, *, longest=40, per_segment=48, lean=0.02):
    """Judge so many random segments of one seed."""
    tally = Tally()
    for number, problem in enumerate(random_paths(np.random.default_rng(seed), (9, longest), count, lean)):
        where = f"seed {seed}, path {number}"
        if turns_in_no_time(problem):
            refused = any("in no time" in reason for reason in certified.verify(problem).reasons)
            tally.wrong += [] if refused else [("turns_in_no_time", where, "not refused by name")]
            tally.segments, tally.paths = tally.segments + len(problem.tips_mm) - 1, tally.paths + 1
            continue
        case = judged(problem, per_segment)
        wrong = [(rule.__name__, where, what) for rule in RULES for what in rule(case)]
        if number % 3 == 0:
            tally.sharpened += 1
            wrong += [(rule, where, what) for rule, what in at_its_deadbands(case)]
        inside = case.inside
        tally.add(
            Tally(
                segments=len(problem.tips_mm) - 1,
                paths=1,
                admitted=int(case.verdict.admissible),
                refused_within_a_hundredth=int(not case.verdict.admissible and 0 <= room(case) < ROOM),
                undecided=int(undecided(case.verdict)),
                largest_gap=widest(case.verdict) if inside else 0.0,
                wrong=wrong,
            )
        )
    return tally
