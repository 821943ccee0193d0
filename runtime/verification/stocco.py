"""The paper's method as printed: march along the path by the distance to the boundary.

Rules, in order; every admitting comparison asks "inside?", so NaN denies:

1. All numbers are finite and usable (`defects`).
2. The path starts inside the planar workspace, by inverse kinematics.
3. Stocco 2001, eq. (3)-(11): at path length l take d = D(X(l)); stop, inadmissible, unless d >= 2 * deadband; else
   l = min(l + d, L); admissible once l = L has been looked at. Arm and wrist march separately, and both must arrive.
4. A march that takes more evaluations than eq. (15) allows and rounding explains, or `MOST_EVALUATIONS`, does not arrive.

Every admitted path keeps the deadband everywhere, as a worst excursion between samples eats at most half of twice the
deadband. Between the deadband and twice the deadband it decides by luck, which is why the gate uses `certified`.

The arm marches on the length of the wrist-centre path, bounded per segment by V, which is linear in the
segment's parameter; D is the smallest distance to the planar arcs and to the ends of the slide. The
wrist marches separately on the angle of the tool axis; its D is the smallest distance of the pitch
to its limits and to the singularity. The separate angular run does not see that moving the wrist centre
turns the roll, nor does it wind q0 about the column: ``roll_min``, ``roll_max``, the joint speeds and,
for a shoulder of a full turn or more, ``left`` and ``right`` are no part of this verdict.

D is the exact distance. The planar D as printed, eq. (16)-(21), is positive at places out of reach; no verdict comes of it
(`cutgate.runtime.library.printed`).

Example:
    ``stroke`` is that of `problem`.

    >>> verdict = verify(stroke)
    >>> verdict.admissible, verdict.evaluations.arm, verdict.evaluations.worst_case
    (True, 2, 4)
    >>> march(100.0, 5.0, lambda place: np.array([9.0])).admitted  # keeps the deadband, and not twice the deadband
    False
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cutgate.protocol.arrays import Floats
from cutgate.runtime.kinematics.arm import turns
from cutgate.runtime.verification.bounds.geometry import MIRRORED_SIDES, Geometry, Segments, canonical
from cutgate.runtime.verification.bounds.points import Points, at
from cutgate.runtime.verification.defects import defects
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.quantities import Enclosed, boundary, refused, wrist_length
from cutgate.runtime.verification.report.reasons import sentences
from cutgate.runtime.verification.verdict import BOUNDARIES, Evaluations, JointBranch, Verdict
from cutgate.runtime.workspace.distance import signed_sides
from cutgate.runtime.workspace.planar import SIDES

MOST_EVALUATIONS = 2_000_000
"""A march is given up after so many evaluations: not admitted."""


@dataclass(frozen=True, slots=True)
class March:
    """One run along a path of given length.

    Attributes:
        admitted: whether the end was reached.
        evaluations: how many times D was evaluated.
        best_case: lower bound of evaluations of an admitted path, eq. (14).
        worst_case: upper bound of evaluations, eq. (15); rounding of the places may cost one more.
        places: path length of each evaluation.
        values: all distances evaluated there, shape (evaluations, boundaries).
    """

    admitted: bool
    evaluations: int
    best_case: int
    worst_case: int
    places: Floats
    values: Floats


def best_case(length: float) -> int:
    """Lower bound of evaluations of an admitted path, eq. (14): both ends; one for a path of length zero."""
    return 1 if length == 0.0 else 2


def worst_case(length: float, deadband: float) -> int:
    """Upper bound of evaluations, eq. (15); one for a path of length zero."""
    if length == 0.0:
        return 1
    return math.ceil(length / (2.0 * deadband)) + 1


def march(length: float, deadband: float, distances: Callable[[float], Floats]) -> March:
    """Eq. (3)-(11). NaN denies: the march goes on only while ``d >= 2 * deadband`` holds.

    Args:
        length: L, of the path.
        deadband: in the same unit.
        distances: signed distances to all boundaries at a path length; D is their minimum.
    """
    bound = worst_case(length, deadband)
    place, admitted = 0.0, False
    places: list[float] = []
    values: list[Floats] = []
    while len(places) < min(bound + 2, MOST_EVALUATIONS):
        here = distances(place)
        places.append(place)
        values.append(here)
        d = float(here.min())
        if not d >= 2.0 * deadband:
            break
        if place >= length:
            admitted = True
            break
        place = min(length, place + d)
    return March(admitted, len(places), best_case(length), bound, np.array(places), np.array(values))


def verify(problem: Problem) -> Verdict:
    """Verify as the paper prints it: the arm's march, then the wrist's, each at twice its deadband."""
    wrong = defects(problem)
    if wrong:
        return refused(problem, wrong, "stocco")
    geometry, segments = canonical(problem)
    lengths = _lengths(geometry, segments)
    arm = arm_march(geometry, segments, _arm_distances)
    wrist = march(
        float(segments.theta.sum()),
        geometry.wrist_rad,
        _along(geometry, segments, segments.theta, _wrist_distances),
    )
    first = at(geometry, segments, np.zeros(1, dtype=np.int64), np.zeros(1))
    started = bool(first.inside[0])
    tip_at = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(segments.tip, axis=0), axis=1))))
    enclosed = _enclosed(geometry, arm, lengths, ARM) | _enclosed(geometry, wrist, segments.theta, WRIST)
    boundaries = {}
    for name in BOUNDARIES:
        source = MIRRORED_SIDES.get(name, name) if geometry.side < 0 else name
        if source in enclosed:
            boundaries[name] = boundary(name, enclosed[source], geometry.arm_mm, geometry.wrist_rad, tip_at)
    admitted = started and arm.admitted and wrist.admitted
    return Verdict(
        method="stocco",
        admissible=admitted,
        tip_length_mm=float(tip_at[-1]),
        wrist_length_mm=wrist_length(segments, geometry.tool_mm),
        axis_angle_rad=float(segments.theta.sum()),
        deadband_arm_mm=geometry.arm_mm,
        deadband_wrist_rad=geometry.wrist_rad,
        branch=_branch(problem, geometry, first) if admitted else None,
        evaluations=Evaluations(arm.evaluations, wrist.evaluations, arm.worst_case, arm.best_case),
        boundaries=boundaries,
        speed=(),
        acceleration=(),
        reasons=(
            *_stops(arm, wrist, geometry, started=started),
            *sentences(problem, boundaries, ()),
        ),
    )


ARM = (*SIDES, "top", "bottom")
WRIST = ("pitch_min", "pitch_max", "wrist_singularity")


def arm_march(
    geometry: Geometry, segments: Segments, evaluate: Callable[[Geometry, Points], Floats]
) -> March:
    """The arm's march on any distances, shape (boundaries,), of one point."""
    lengths = _lengths(geometry, segments)
    return march(float(lengths.sum()), geometry.arm_mm, _along(geometry, segments, lengths, evaluate))


def _lengths(geometry: Geometry, segments: Segments) -> Floats:
    """March length V of each segment: at most what the wrist centre moves per unit of the parameter."""
    step = np.linalg.norm(np.diff(segments.tip, axis=0), axis=1)
    out: Floats = geometry.stretch * (step + geometry.tool_mm * segments.theta)
    return out


def _along(
    geometry: Geometry, segments: Segments, lengths: Floats, evaluate: Callable[[Geometry, Points], Floats]
) -> Callable[[float], Floats]:
    """Distances as a function of the march length."""
    ends = np.cumsum(lengths)

    def distances(place: float) -> Floats:
        i, s = locate(ends, lengths, place)
        return evaluate(geometry, at(geometry, segments, np.array([i]), np.array([s])))

    return distances


def locate(ends: Floats, lengths: Floats, place: float) -> tuple[int, float]:
    """Segment and fraction of a march length."""
    i = min(int(np.searchsorted(ends, place)), len(ends) - 1)
    if not lengths[i] > 0.0:
        return i, 0.0
    return i, min(max((place - float(ends[i] - lengths[i])) / float(lengths[i]), 0.0), 1.0)


def _arm_distances(geometry: Geometry, points: Points) -> Floats:
    full = geometry.workspace.full_revolution
    sides = signed_sides(points.distances, points.inside, full_revolution=full)[0]
    if full:  # unlimited joints of the paper's Figure 2: only the two circles bound the set
        sides[2:] = np.inf
    return with_slide(geometry, points, sides)


def with_slide(geometry: Geometry, points: Points, sides: Floats) -> Floats:
    """Distances to the arcs, and to both ends of the slide."""
    z = float(points.height[0])
    return np.append(sides, (geometry.upper[2] - z, z - geometry.lower[2]))


def _wrist_distances(geometry: Geometry, points: Points) -> Floats:
    q4 = float(points.pitch[0])
    return np.array((q4 - geometry.lower[4], geometry.upper[4] - q4, min(q4, math.pi - q4)))


def _enclosed(geometry: Geometry, run: March, lengths: Floats, names: tuple[str, ...]) -> dict[str, Enclosed]:
    """What a march knows of each boundary: the least value met, and what Lipschitz leaves between.

    Between neighbours at distance h with values a and b nothing is below (a + b - h) / 2, and on the rest of
    a march that was stopped nothing below its last value less the length that is left.
    """
    ends = np.cumsum(lengths)
    found = {}
    for column, name in enumerate(names):
        values = run.values[:, column]
        if np.isposinf(values).all():
            continue
        row = int(np.argmin(values))
        between = (values[:-1] + values[1:] - np.diff(run.places)) / 2.0
        rest = values[-1] - max(float(ends[-1] - run.places[-1]), 0.0)
        proven = float(min([float(values[row]), float(rest), *between]))
        i, s = locate(ends, lengths, float(run.places[row]))
        found[name] = Enclosed(float(values[row]), proven - geometry.pad_mm, i, s)
    return found


def _branch(problem: Problem, geometry: Geometry, first: Points) -> JointBranch:
    q0 = geometry.side * (first.shoulder - geometry.offset[0])
    q3 = geometry.side * (first.roll - geometry.offset[3])
    return JointBranch(problem.arm.elbow, int(turns(q0)[0]), int(turns(q3)[0]))


def _stops(arm: March, wrist: March, geometry: Geometry, *, started: bool) -> tuple[str, ...]:
    out = []
    if not started:
        out.append(
            "the path starts outside the planar workspace (inverse kinematics); move the bone toward it"
        )
    for name, run, scale, unit, deadband in (
        ("arm", arm, 1.0, "mm", geometry.arm_mm),
        ("wrist", wrist, 180.0 / math.pi, "deg", geometry.wrist_rad),
    ):
        if not run.admitted:
            out.append(
                f"{name}: the march stopped after {run.evaluations} evaluations at {run.places[-1] * scale:.3f} {unit} "
                f"where D = {float(run.values[-1].min()) * scale:.4f} {unit} is not at least "
                f"twice the deadband, {2.0 * deadband * scale:.6g} {unit}"
            )
    return tuple(out)
