"""The way to the cut and back: from where the arm stands to the first pose, and from the last pose to there again.

Two straight lines along the tool (entry to first pose, last pose to exit) are paths of two poses and are verified as
the cut is (`certified`), in the joint branch of the cut where they meet it. Two joint lines (start joints to entry,
exit to start joints; all joints linear in one parameter) are decided here, for all their points:

1. Both ends lie inside the true joint limits. These are a box, so the whole line does: membership is by the joints
   themselves, and no arc is ever crossed.
2. The wrist centre's distance to each clipped arc is enclosed: it stays within h^2 / 8 max|c''| of the chord of an
   interval h, |c''| <= a0 q0'^2 + a1 (q0' + q1')^2, and the chord's distance is closed form (`segment_to_arc`).
3. Slide, roll and pitch are linear: their ends are their range. A joint line commands the roll instead of solving it
   from a pose, so a vertical tool is not singular on it and errors of the pose do not turn the roll further.

An arm that begins up to the start tolerance beside the start joints stays so near to the line (`start_offset` in the
interlock's permissives bounds the wrist centre at every elbow angle), hence the tolerance widens the deadbands.

Only the joint lines depend on where the arm stands. Hence the rest is verified before a session (`straight_lines`),
and the joint lines, whose cost does not depend on the number of poses, in it: step by step (`joint_lines`), each step
so short that a loop can take it between two of its turns.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from cutgate.protocol import records
from cutgate.protocol.parameters import ROTATION_DEG_STANDS
from cutgate.protocol.records import joints_to_counts, joints_to_memory
from cutgate.runtime.kinematics.arm import TURN, turns
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.bounds.chain import build
from cutgate.runtime.verification.bounds.enclosures import HALF_TURN
from cutgate.runtime.verification.bounds.geometry import (
    EPSILON,
    MIRRORED,
    ROUNDINGS,
    VERTICAL,
    Geometry,
    canonical,
)
from cutgate.runtime.verification.branch import goes
from cutgate.runtime.verification.defects import defects
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.standing import standing
from cutgate.runtime.verification.verdict import Boundary
from cutgate.runtime.workspace.planar import SIDES, Arc, distance_to_arc, segment_to_arc

Floats = NDArray[np.float64]

T = TypeVar("T")
Steps = Generator[None, None, T]
"""Work in steps, for whoever has other things to do in between; what it returns is the answer."""

LegName = Literal["approach", "entry", "exit", "retract"]

SCHEMA: Final = "cutgate.approach/1"
GAP_MM: Final = 0.008
"""Proven and attained distance this close; the promise is 0.01 mm."""
SMALLEST: Final = 2.0**-40
"""No interval is split below this part of the line."""
BUDGET: Final = 200_000
"""Intervals looked at for one arc of one line; the rest stays undecided, which is refused."""
AT_END: Final = 1e-6
"""A worst place so near to an end of its line is that end's."""
BLOCK: Final = 1024
"""So many of them in one step: under a millisecond."""

_TITLE: Final[dict[LegName, str]] = {
    "approach": "joint line from the start joints to the entry pose",
    "entry": "straight line from the entry pose to the first pose",
    "exit": "straight line from the last pose to the exit pose",
    "retract": "joint line from the exit pose to the start joints",
}


@dataclass(frozen=True, slots=True)
class Start:
    """Where the arm stands, and how the site wants it to come and go.

    Attributes:
        joints: measured reported joints, rad and mm, shape (5,).
        clearance_um: entry and exit beyond everything that is cut.
        tolerance_mm: how far the wrist centre may be off the start joints' when it begins.
        tolerance_rad: how far a turning joint may be.
    """

    joints: Floats
    clearance_um: int
    tolerance_mm: float = 0.0
    tolerance_rad: float = 0.0

    @classmethod
    def of(
        cls, joints_u: tuple[int, ...], *, clearance_um: int, tolerance_mm: float, tolerance_deg: float
    ) -> Start:
        """From joints in counts of 1e-6 deg | mm, as a permit binds them."""
        return cls(joints_to_memory(joints_u), clearance_um, tolerance_mm, math.radians(tolerance_deg))


@dataclass(frozen=True, slots=True)
class Leg:
    """One line of the four: each boundary's worst place, and in sentences what it lacks.

    ``at_start`` are those of the sentences that speak of the start joints.
    """

    name: LegName
    boundaries: dict[str, Boundary]
    reasons: tuple[str, ...]
    at_start: frozenset[str] = frozenset()

    @property
    def violated(self) -> bool:
        """Whether it lacks anything."""
        return bool(self.reasons) or any(b.violated for b in self.boundaries.values())


@dataclass(frozen=True, slots=True)
class Approach:
    """The answer. ``admissible`` only if every leg keeps every deadband.

    Attributes:
        admissible: whether the arm may go this way.
        entry_um: from the first pose along its axis to the entry pose.
        exit_um: from the last pose likewise.
        entry: reported joints at the entry pose, in the cut's branch; None where there are none.
        exit: the same at the exit pose.
        legs: in the order of motion; empty where nothing could be verified.
        reasons: sentences of all legs.
    """

    admissible: bool
    entry_um: int
    exit_um: int
    entry: Floats | None
    exit: Floats | None
    legs: tuple[Leg, ...]
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class StraightLines:
    """Entry and exit with the lines between them and the cut: all that does not depend on where the arm stands.

    Attributes:
        geometry: of the cut.
        held: whether the cut holds a declared roll.
        entry_um: as in `Approach`.
        exit_um: likewise.
        entry: likewise; NaN where there are none.
        exit: likewise.
        inward: from the entry pose to the first pose.
        outward: from the last pose to the exit pose.
    """

    geometry: Geometry
    held: bool
    entry_um: int
    exit_um: int
    entry: Floats
    exit: Floats
    inward: Leg
    outward: Leg

    @property
    def admissible(self) -> bool:
        """Whether both lines keep every deadband; the joint lines are another question."""
        return not any(leg.violated for leg in (self.inward, self.outward))


def verify(problem: Problem, start: Start) -> Approach:
    """Verify approach and retract of a cut at the deadbands.

    Args:
        problem: the cut with its joint branch. Whether the cut itself is admissible is decided elsewhere.
        start: where the arm stands.
    """
    lines = straight_lines(problem, start.clearance_um)
    return finished(joint_lines(lines, start))


def finished(steps: Steps[T]) -> T:
    """Take all steps; what came of them."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            answer: T = end.value
            return answer


def straight_lines(problem: Problem, clearance_um: int) -> StraightLines | Approach:
    """Entry and exit, and the lines between them and the cut; the answer at once where there are none.

    Args:
        problem: as for `verify`.
        clearance_um: as in `Start`.
    """
    wrong = list(defects(problem))
    if problem.branch is None:
        wrong.append("the cut names no joint branch")
    wrong += _not_at_least_0("approach_clearance", clearance_um)
    if wrong:
        return _refused(tuple(wrong))
    first, last = _ends(problem)
    if not (np.isfinite(first).all() and np.isfinite(last).all()):
        return _refused(("the cut's first or last pose has no joints: cure the cut first",))
    entry_um, exit_um = (beyond_um(problem, pose, clearance_um) for pose in (0, -1))
    inward, entry = _straight(problem, "entry", (0, entry_um), first)
    outward, leaving = _straight(problem, "exit", (-1, exit_um), last)
    geometry, _ = canonical(problem)
    return StraightLines(geometry, _held(problem), entry_um, exit_um, entry, leaving, inward, outward)


def joint_lines(lines: StraightLines | Approach, start: Start) -> Steps[Approach]:
    """The joint lines between the start joints and entry and exit, and with them the whole answer."""
    if isinstance(lines, Approach):
        return lines
    wrong = _unfit(start)
    if wrong:
        return _refused(wrong)
    geometry, held = lines.geometry, lines.held
    legs = (
        (yield from _joint_line(geometry, start, "approach", lines.entry, held=held)),
        lines.inward,
        lines.outward,
        (yield from _joint_line(geometry, start, "retract", lines.exit, held=held)),
    )
    # What both joint lines lack where the arm stands is said once, and with what to do about it.
    ill = any(leg.at_start for leg in legs)
    said = _standing(geometry, start, held=held) if ill else ()
    reasons = (
        *said,
        *(
            f"{_TITLE[leg.name]}: {reason}"
            for leg in legs
            for reason in leg.reasons
            if not (said and reason in leg.at_start)
        ),
    )
    admissible = not any(leg.violated for leg in legs)
    return Approach(admissible, lines.entry_um, lines.exit_um, lines.entry, lines.exit, legs, reasons)


def _standing(geometry: Geometry, start: Start, *, held: bool) -> tuple[str, ...]:
    return standing(geometry, start.joints, start.tolerance_mm, start.tolerance_rad, held=held)


def _refused(reasons: tuple[str, ...]) -> Approach:
    return Approach(False, 0, 0, None, None, (), reasons)


def _unfit(start: Start) -> tuple[str, ...]:
    """What makes the numbers of the start unfit to be verified; any doubt is a defect."""
    found = []
    if start.joints.shape != (5,) or not np.isfinite(start.joints).all():
        found.append("the start joints are not five finite numbers")
    found += _not_at_least_0("start_tolerance_mm", start.tolerance_mm)
    found += _not_at_least_0("start_tolerance", start.tolerance_rad)
    return tuple(found)


def _not_at_least_0(name: str, value: float) -> list[str]:
    return [] if 0.0 <= value < math.inf else [f"{name} is {value}, must be finite and at least 0"]


def beyond_um(problem: Problem, pose: int, clearance_um: int) -> int:
    """From a pose along its axis to the clearance beyond every tip of the path, rounded up to whole um."""
    along = (problem.tips_mm - problem.tips_mm[pose]) @ problem.axes[pose]
    return math.ceil(clearance_um + 1000.0 * float(along.max()))


def _held(problem: Problem) -> bool:
    """Whether the cut holds a declared roll, its axis being vertical throughout."""
    level = np.hypot(problem.axes[:, 0], problem.axes[:, 1])
    return problem.hold_roll is not None and bool((level < VERTICAL).all())


def _ends(problem: Problem) -> Floats:
    """Reported joints at the first and the last pose, followed along the path in its branch; NaN if unknown. (2, 5)."""
    geometry, segments = canonical(problem)
    chain = build(geometry, segments)
    if not chain.wound or problem.branch is None:
        return np.full((2, 5), np.nan)
    ends = chain.points.take(np.array((0, len(chain))))
    true = np.stack((ends.shoulder, ends.elbow, ends.height, ends.roll, ends.pitch), axis=1)
    joints: Floats = (true - geometry.offset) * _flip(geometry)
    for joint, asked in ((0, problem.branch[0]), (3, problem.branch[1])):
        joints[:, joint] += TURN * (asked - turns(joints[:1, joint]))
    if _held(problem):
        joints[:, 3] = float(problem.hold_roll or 0.0)
    return joints


def _flip(geometry: Geometry) -> Floats:
    """Signs that mirror a left elbow's joints into the canonical arm, and back."""
    return np.array((geometry.side, geometry.side, 1.0, geometry.side, 1.0))


# ---------------------------------------------------------------- straight lines


def _straight(problem: Problem, name: LegName, way: tuple[int, int], joints: Floats) -> tuple[Leg, Floats]:
    """The line from a pose along its axis, in the branch in which the cut meets it.

    The set of places is the same in both directions, and so are the joint speeds; hence both lines are verified
    from the pose outward, where the branch is known.

    Args:
        problem: the cut.
        name: of the leg.
        way: number of the pose, and the line's length in um.
        joints: at the pose.

    Returns:
        The leg, and the joints at its outer end as a permit carries them: what is bound is what is verified.
    """
    pose, length_um = way
    tip, axis = problem.tips_mm[pose], problem.axes[pose]
    outer = tip + length_um / 1000.0 * axis
    q0_turns, _, _, roll_turns, _ = turns(joints)
    line = replace(
        problem,
        tips_mm=np.stack((tip, outer)),
        axes=np.stack((axis, axis)),
        branch=(int(q0_turns), int(roll_turns)),
    )
    verdict = certified.verify(line)
    reasons = verdict.reasons if not verdict.admissible else ()
    if not verdict.admissible and not reasons:  # pragma: no cover -- a verdict says why
        reasons = ("not admissible",)
    far: Floats = _ends(line)[1]
    carried = joints_to_memory(joints_to_counts(far)) if np.isfinite(far).all() else far
    return Leg(name, verdict.boundaries, reasons), carried


# ---------------------------------------------------------------- joint lines


@dataclass(frozen=True, slots=True)
class _Least:
    """Least clearance of one boundary on a joint line, mm or rad, and where it is attained."""

    attained: float
    certified: float
    fraction: float


def _joint_line(geometry: Geometry, start: Start, name: LegName, pose: Floats, *, held: bool) -> Steps[Leg]:
    """All joints linear in one parameter between the start joints and a pose's joints."""
    ends = np.stack((start.joints, pose) if name == "approach" else (pose, start.joints))
    line = ends * _flip(geometry) + geometry.offset
    space = geometry.workspace
    lower, upper = geometry.lower.copy(), geometry.upper.copy()
    lower[1], upper[1] = space.q1_lo, space.q1_hi
    for joint in (0, 3):  # both ends where a joints frame can carry them: then all of the line
        low, high = goes(geometry, joint, ROTATION_DEG_STANDS)
        lower[joint], upper[joint] = max(lower[joint], low), min(upper[joint], high)
    inside = bool(((lower <= line) & (line <= upper)).all()) and not space.empty
    values = _linear(geometry, line)
    if held and geometry.lower[4] <= 0.0:  # as for the cut: below a vertical tool there is no stop
        del values["pitch_min"]
    if inside:
        values |= yield from _sides(geometry, line, geometry.arm_mm + start.tolerance_mm)
    boundaries = {}
    names: dict[str, _Least | None] = dict.fromkeys(SIDES) if not inside else {}
    for source, least in {**names, **values}.items():
        shown = MIRRORED.get(source, source) if geometry.side < 0.0 else source
        boundaries[shown] = _boundary(shown, least, geometry, start)
    begins = 0 if name == "approach" else 1
    outside = [] if inside else _outside(geometry, line, lower, upper)
    reasons = [text for _, text in outside]
    reasons += [_sentence(b, name) for b in boundaries.values() if b.violated]
    at_start = {text for end, text in outside if end == begins}
    by_start = len(at_start) == len(outside)  # then what is not defined is not for its sake alone
    at_start |= {
        _sentence(b, name)
        for b in boundaries.values()
        if b.violated and (by_start if b.fraction is None else abs(b.fraction - begins) <= AT_END)
    }
    return Leg(name, boundaries, tuple(reasons), frozenset(at_start))


def _linear(geometry: Geometry, line: Floats) -> dict[str, _Least]:
    """Slide, roll and pitch: the range of a linear joint is that of its ends."""
    found = {}
    for joint, low, high in (
        (2, "bottom", "top"),
        (3, "roll_min", "roll_max"),
        (4, "pitch_min", "pitch_max"),
    ):
        value = line[:, joint]
        pad = geometry.pad_mm if joint == 2 else ROUNDINGS * EPSILON * (8.0 + float(np.abs(value).max()))
        for side, margin in ((low, value - geometry.lower[joint]), (high, geometry.upper[joint] - value)):
            at = int(np.argmin(margin))
            found[side] = _Least(float(margin[at]), float(margin[at]) - pad, float(at))
    return found


def _sides(geometry: Geometry, line: Floats, target_mm: float) -> Steps[dict[str, _Least]]:
    """Distance to the four arcs; from a full turn on a limit's arc counts within half a turn of the limit."""
    curve = _Curve.of(geometry, line)
    parts: dict[str, tuple[float, float] | None] = dict.fromkeys(SIDES, (0.0, 1.0))
    if geometry.workspace.full_turn:
        parts["left"] = _part_above(line[:, 0], float(geometry.upper[0]) - HALF_TURN)
        parts["right"] = _part_above(-line[:, 0], -float(geometry.lower[0]) - HALF_TURN)
    found = {}
    for (name, part), arc in zip(parts.items(), geometry.arcs, strict=True):
        if part is not None:
            concentric = name in {"inner", "outer"}
            found[name] = yield from _enclose(curve, arc, part, target_mm, concentric=concentric)
    return found


def _part_above(ends: Floats, bound: float) -> tuple[float, float] | None:
    """Where a linear quantity with these ends (2,) is at least the bound; None where nowhere."""
    first, last = float(ends[0]), float(ends[1])
    if min(first, last) >= bound:
        return 0.0, 1.0
    if not max(first, last) >= bound:
        return None
    crossing = (bound - first) / (last - first)
    return (crossing, 1.0) if last > first else (0.0, crossing)


@dataclass(frozen=True, slots=True)
class _Curve:
    """The wrist centre over a joint line, slide coordinates.

    Attributes:
        links: a0, a1, mm.
        angles: bearings of the two links at 0, rad, shape (2,).
        rates: their change up to 1, rad.
        bend: bound on |c''|, mm.
        pad: bound on the rounding of a computed distance, mm.
    """

    links: Floats
    angles: Floats
    rates: Floats
    bend: float
    pad: float

    @classmethod
    def of(cls, geometry: Geometry, line: Floats) -> _Curve:
        """The curve of a line of true joints, shape (2, 5)."""
        space = geometry.workspace
        links = np.array((space.a0, space.a1))
        bearings = np.cumsum(line[:, :2], axis=1)
        rates = bearings[1] - bearings[0]
        turned = ROUNDINGS * EPSILON * float(np.abs(line[:, :2]).sum(axis=1).max())
        pad = geometry.pad_mm + turned * float(links.sum())
        return cls(links, bearings[0], rates, float(links @ (rates * rates)), pad)

    def __call__(self, t: Floats) -> Floats:
        """Places (n, 2) at fractions (n,)."""
        angles = self.angles + t[:, None] * self.rates
        out: Floats = np.stack((np.cos(angles) @ self.links, np.sin(angles) @ self.links), axis=1)
        return out


def _enclose(
    curve: _Curve, arc: Arc, part: tuple[float, float], target_mm: float, *, concentric: bool
) -> Steps[_Least]:
    """The least distance to a clipped arc over a part of the curve, decided at the target.

    Intervals whose bound lies below the target, or too far below the least distance found, are halved. Of arcs about
    the column (``concentric``) the ends of an interval bound it as well: the elbow is linear, hence the distance
    from the column is monotone, and no point comes nearer to the circle.
    """
    a, b = np.array(part[:1]), np.array(part[1:])
    best, place, proven, spent = math.inf, part[0], np.float64(math.inf), 0
    while len(a):
        spent += len(a)
        bound = np.empty(len(a))
        for i in range(0, len(a), BLOCK):
            these = slice(i, i + BLOCK)
            bound[these], found, at = _looked_at(curve, arc, a[these], b[these], concentric=concentric)
            if found < best:
                best, place = found, at
            yield
        wanting = (bound < best - GAP_MM) | ((bound < target_mm) & (best >= target_mm))
        wanting &= (b - a > SMALLEST) & (spent <= BUDGET)
        proven = np.minimum(proven, bound[~wanting].min(initial=math.inf))  # keeps a NaN
        a, b = a[wanting], b[wanting]
        middle = (a + b) / 2.0
        a, b = np.concatenate((a, middle)), np.concatenate((middle, b))
    return _Least(best, float(np.minimum(proven, best)), place)


def _looked_at(
    curve: _Curve, arc: Arc, a: Floats, b: Floats, *, concentric: bool
) -> tuple[Floats, float, float]:
    """Lower bounds of the distance on intervals, the least distance found at some places of them, and where."""
    pa, pb = curve(a), curve(b)
    chord, nearest = segment_to_arc(pa, pb, arc)
    bound = chord - curve.bend / 8.0 * (b - a) ** 2
    if concentric:
        off = [np.abs(np.hypot(p[:, 0], p[:, 1]) - arc.radius) for p in (pa, pb)]
        bound = np.maximum(bound, np.minimum(*off))
    tried = np.concatenate((a, b, a + nearest * (b - a)))
    found = distance_to_arc(curve(tried), arc)
    at = int(np.argmin(found))
    return bound - curve.pad, float(found[at]), float(tried[at])


# ---------------------------------------------------------------- the answer


def _boundary(name: str, least: _Least | None, geometry: Geometry, start: Start) -> Boundary:
    """In mm or deg; undefined, hence violated, where nothing was enclosed."""
    angular = name.startswith(("roll", "pitch"))
    unit: Literal["mm", "deg"] = "deg" if angular else "mm"
    scale = math.degrees(1.0) if angular else 1.0
    kept = geometry.wrist_rad + start.tolerance_rad if angular else geometry.arm_mm + start.tolerance_mm
    deadband = kept * scale
    if least is None or not (math.isfinite(least.attained) and math.isfinite(least.certified)):
        return Boundary(name, unit, None, None, None, None, None, deadband, violated=True)
    clearance, proven = least.attained * scale, least.certified * scale
    return Boundary(
        name, unit, clearance, proven, None, least.fraction, None, deadband, violated=not proven >= deadband
    )


def _sentence(b: Boundary, leg: LegName) -> str:
    """What a boundary of a joint line lacks, where, and what to do."""
    at_pose = b.fraction == (1.0 if leg == "approach" else 0.0)
    remedy = "lower approach_clearance_mm or move the bone" if at_pose else "let the arm start from elsewhere"
    needs = f"needs {b.deadband:.6g} {b.unit}"
    if b.clearance is None or b.certified is None:
        return f"{b.name}: not defined on this line, {needs}; {remedy}"
    place = f"at fraction {b.fraction:.6f} of the line"
    if b.clearance >= b.deadband:
        return (
            f"{b.name}: undecided, the clearance lies between {b.certified:.6f} and {b.clearance:.6f} {b.unit} "
            f"and {needs} {place}; {remedy}"
        )
    return f"{b.name}: clearance {b.clearance:.6f} {b.unit}, {needs} {place}; {remedy}"


def _outside(geometry: Geometry, line: Floats, lower: Floats, upper: Floats) -> list[tuple[int, str]]:
    """The joints whose ends are not where they may go, as the controller reports them, each with which end it is."""
    flip = _flip(geometry)
    reported = (line - geometry.offset) * flip
    low, high = np.sort(((np.stack((lower, upper)) - geometry.offset) * flip), axis=0)
    found = []
    for joint in range(5):
        for end in range(2):
            if lower[joint] <= line[end, joint] <= upper[joint]:
                continue
            scale, unit = (1.0, "mm") if joint == 2 else (math.degrees(1.0), "deg")
            value, least, most = (float(x) * scale for x in (reported[end, joint], low[joint], high[joint]))
            text = f"q{joint} is {value:.6f} {unit} at its {('beginning', 'end')[end]}, must be in [{least:.6g}, {most:.6g}]"
            found.append((end, text))
    return found


def summary(verdict: Approach) -> str:
    """The smallest margin per deadband, or what is lacking, in one line."""
    if not verdict.admissible:
        return "; ".join(verdict.reasons)
    found = worst(verdict)
    if found is None:
        return "every leg keeps every deadband"
    leg, b = found
    return f"every leg keeps every deadband; tightest is {b.name} on the {leg}, {b.certified:.3f} {b.unit} with {b.deadband:g} {b.unit} required"


def worst(verdict: Approach) -> tuple[LegName, Boundary] | None:
    """The boundary with the least margin per deadband, and its leg; an undefined one is the worst."""

    def margin(entry: tuple[LegName, Boundary]) -> float:
        b = entry[1]
        return -math.inf if b.certified is None else b.certified / b.deadband

    entries = [(leg.name, b) for leg in verdict.legs for b in leg.boundaries.values()]
    return min(entries, key=margin, default=None)


def bound(verdict: Approach | StraightLines, speed_percent: int) -> records.Approach | None:
    """What a permit binds; None where approach or retract, or of the straight lines one, is not admissible."""
    if not verdict.admissible or verdict.entry is None or verdict.exit is None:
        return None
    return records.Approach(
        entry_um=verdict.entry_um,
        exit_um=verdict.exit_um,
        entry_joints_u=joints_to_counts(verdict.entry),
        exit_joints_u=joints_to_counts(verdict.exit),
        speed_percent=speed_percent,
    )


def document(verdict: Approach, start: Start) -> dict[str, Any]:
    """The answer and what it was made for as one JSON document (``cutgate.approach/1``); undefined values are None.

    Joints are (deg, deg, mm, deg, deg).
    """
    return {
        "schema": SCHEMA,
        "verdict": "admissible" if verdict.admissible else "inadmissible",
        "clearance_um": start.clearance_um,
        "start_tolerance_mm": start.tolerance_mm,
        "start_tolerance_deg": math.degrees(start.tolerance_rad),
        "start_joints": shown(start.joints),
        "entry_um": verdict.entry_um,
        "exit_um": verdict.exit_um,
        "entry_joints": None if verdict.entry is None else shown(verdict.entry),
        "exit_joints": None if verdict.exit is None else shown(verdict.exit),
        "legs": {
            leg.name: {
                b.name: {
                    "unit": b.unit,
                    "clearance": b.clearance,
                    "certified": b.certified,
                    "deadband": b.deadband,
                    "fraction": b.fraction,
                    "violated": b.violated,
                }
                for b in leg.boundaries.values()
            }
            for leg in verdict.legs
        },
        "reasons": list(verdict.reasons),
    }


def shown(joints: Floats) -> list[float | None]:
    """Joints in deg, deg, mm, deg, deg; None for any that is not finite."""
    values = [float(q) if joint == 2 else math.degrees(float(q)) for joint, q in enumerate(joints)]
    return [value if math.isfinite(value) else None for value in values]
