"""Which way the bone must move: a hint for each boundary, and one combined, verified move.

A hint cures the worst place of one boundary to first order; it says nothing of the rest of the path.
The combined move is the smallest translation, or, where none is found, a turn about the vertical by the
smallest angle found and the smallest translation with it. It is shown only with what the certified method
says of the moved and re-quantised path. That no translation helps is said only where it is proved.

All work is counted (`Effort`), that of the certified method included, and bounded as a whole: a second or so,
whatever the path. Where it is spent before anything is found or proved, that is the answer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import Final

import numpy as np

from cutgate.protocol.arrays import Floats, Vector
from cutgate.runtime.kinematics.pose import transform_poses, turn_about_vertical
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.advice import Guidance, Move
from cutgate.runtime.verification.bounds.geometry import Geometry, canonical
from cutgate.runtime.verification.bounds.points import Points, at
from cutgate.runtime.verification.defects import defects
from cutgate.runtime.verification.effort import Effort, EffortSpentError
from cutgate.runtime.verification.placing.freedom import Placing, Reserve
from cutgate.runtime.verification.placing.search import smallest_translation
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.verdict import ARM_BOUNDARIES, Boundary, Verdict
from cutgate.runtime.workspace.planar import SIDES, nearest_on_arc

Quantise = Callable[[Floats, Floats], tuple[Floats, Floats]]

RESERVES_MM = (0.2, 0.5, 2.0)
"""Beyond the deadband the points of the moved path keep this; the next is tried where the certified method says no."""

RESERVE_DEG = 0.1
"""The same for turns, with the first of the reserves; it grows as they do."""

STEP_MM = 0.1
"""Translations are shown, and verified, in whole steps of this; so is the pivot of a turn."""

STEP_DEG = 0.1
"""Turns about the vertical are shown, and verified, in whole steps of this."""

COARSE_STEPS, FINE_STEPS = 50, 5
"""Turns are tried every 5 deg, then narrowed down to 0.5 deg."""

WORK: Final = 8_000_000
"""Bound on all work of one answer, in points looked at (`Effort`)."""

WORK_ALONE, WORK_PROOF = 5 * WORK // 8, WORK // 16
"""Of that: for the smallest translation alone, and for each proof that none helps; turns have what is left."""

SEARCHED = 0.6
"""The part of what is left that may go into a search; the rest is for the certified method to verify its answer."""

QUANTISED = 2
"""Work of moving and quantising a pose."""

TURN_FINEST_MM, TURN_WORK = 0.5, WORK // 32
"""How hard it is tried at each turn whether any translation fits with it."""

TURNS_VERIFIED = 6
"""So many turns are given to the certified method; where it admits none of them, more are not tried."""

SHOWN_MM = 0.01
"""What is shown keeps this beyond the deadbands (mm, deg): a new registration's path is quantised otherwise."""

ON_THE_ARC_MM = 1e-6
"""Nearer than this the difference to the arc has no direction."""

NEW_REGISTRATION = "a moved bone needs a new registration, which voids every permit given before"

NOT_FOUND = "no translation found that makes the whole path admissible; that there is none is not proved"

SPENT = "the search ended where the work it may take was spent"

OTHERWISE = "tilt the bone, or part the path"

_TILT = ("pitch_min", "pitch_max", "wrist_singularity")
_ROLL = ("roll_min", "roll_max")


def guide(problem: Problem, verdict: Verdict, quantise: Quantise) -> Guidance | None:
    """Say how to move the bone so that an inadmissible path becomes admissible.

    Args:
        problem: what was verified.
        verdict: the certified method's answer to it.
        quantise: what the wire does to poses, (tips, axes) -> (tips, axes).

    Returns:
        None where there is nothing to cure, or where the numbers themselves are unfit.
    """
    if verdict.admissible or defects(problem):
        return None
    geometry, segments = canonical(problem)
    moves = []
    for b in verdict.boundaries.values():
        if b.violated and b.clearance is not None and b.segment is not None and b.fraction is not None:
            place = at(geometry, segments, np.array([b.segment]), np.array([b.fraction]))
            moves.append(_hint(geometry, b, place))
    found = _Combined(problem, verdict, quantise).guidance()
    return replace(found, moves=tuple(moves))


def moved(problem: Problem, yaw_deg: float, pivot_mm: Vector, translation_mm: Floats | Vector) -> Problem:
    """The path on a bone turned about the vertical through the pivot, then translated; not quantised."""
    if yaw_deg == 0.0:
        return replace(problem, tips_mm=problem.tips_mm + np.asarray(translation_mm))
    pivot, turn = np.asarray(pivot_mm), turn_about_vertical(math.radians(yaw_deg))
    tips, axes = transform_poses(turn, problem.tips_mm - pivot, problem.axes)
    return replace(problem, tips_mm=tips + pivot + np.asarray(translation_mm), axes=axes)


def pivot_of(problem: Problem) -> Vector:
    """The mean tip, to whole steps."""
    return _steps(problem.tips_mm.mean(axis=0))


def unchanged_by_moves(problem: Problem, verdict: Verdict) -> tuple[str, ...]:
    """Violated boundaries that no translation and no turn about the vertical changes.

    The tool's tilt is one; so is the roll of a vertical tool that is held.
    """
    held = problem.hold_roll is not None and "wrist_singularity" not in verdict.boundaries
    names = (*_TILT, *(_ROLL if held else ()))
    return tuple(n for n in names if n in verdict.boundaries and _attained(verdict.boundaries[n]))


def _steps(vector: Floats) -> Vector:
    x, y, z = (round(round(float(v) / STEP_MM) * STEP_MM, 3) + 0.0 for v in vector)
    return (x, y, z)


def _reserve(mm: float) -> Reserve:
    return Reserve(mm, math.radians(RESERVE_DEG) * mm / RESERVES_MM[0])


def _down(value: float, step: float) -> float:
    """To whole steps, never up: what is said of a lower bound."""
    return math.floor(value / step) * step if math.isfinite(value) else value


@dataclass(frozen=True, slots=True)
class _Shortest:
    """How short no translation is that keeps a reserve, and the reserve; infinite where none at all keeps it."""

    at_least_mm: float
    reserve_mm: float
    reserve_deg: float

    @classmethod
    def of(cls, at_least_mm: float, reserve: Reserve, *, roll: bool) -> _Shortest:
        """From what a search proved; ``roll`` says whether the roll counted in it."""
        return cls(_down(at_least_mm, 0.001), reserve.arm_mm, math.degrees(reserve.roll_rad) if roll else 0.0)

    @property
    def sentence(self) -> str:
        """With every reserve that the proof rests on."""
        shorter = f" shorter than {_down(self.at_least_mm, STEP_MM):.1f} mm"
        roll = f" and {self.reserve_deg:g} deg beyond that of the roll" if self.reserve_deg else ""
        return (
            f"no translation{shorter if math.isfinite(self.at_least_mm) else ''} keeps {self.reserve_mm:g} mm "
            f"beyond the deadband of arm and slide{roll} (proved)"
        )


@dataclass(frozen=True, slots=True)
class _Proof:
    """That no translation helps, in a sentence; ``for_turns``: nor with any turn about the vertical."""

    text: str
    for_turns: bool


class _Combined:
    """The search for one combined move; its methods are the steps of `guidance`, in order."""

    def __init__(self, problem: Problem, verdict: Verdict, quantise: Quantise) -> None:
        self.problem = problem
        self.verdict = verdict
        self.quantise = quantise
        self.pivot = pivot_of(problem)
        self.too_fast = False
        self.fits_somewhere = False
        self.spent = False
        self.effort = Effort(WORK)
        self.shortest: _Shortest | None = None
        self.lift_mm = (-math.inf, math.inf)

    def guidance(self) -> Guidance:
        """The smallest translation, else the smallest turn with a translation, else why there is none."""
        unchanged = self._unchanged()
        if unchanged is not None:
            return self._nothing(unchanged, none_possible=True)
        if canonical(self.problem)[0].workspace.empty:
            return self._nothing("the joint limits leave the arm no workspace", none_possible=True)
        alone = self._translated(0.0, self.effort.part(WORK_ALONE))
        if alone is not None:
            return alone
        if self.too_fast:
            fast = "the joint speeds stay above their limits wherever it was tried: lower the feed"
            return self._nothing(f"{NOT_FOUND}; {fast}", none_possible=None)
        return self._not_by_translation()

    def _not_by_translation(self) -> Guidance:
        """What is proved of translations alone, and the smallest turn that helps."""
        proof = None if self.fits_somewhere else self._proof()
        if proof is not None and proof.for_turns:
            return self._nothing(f"{proof.text}: {OTHERWISE}", none_possible=True)
        turned = self._turned()
        first, none_possible = (self._not_found(), None) if proof is None else (proof.text, True)
        if turned is not None:
            return replace(turned, text=f"{first}; {turned.text}", none_possible=none_possible)
        both = f"no turn about the vertical with a translation was found either: {OTHERWISE}"
        spent = f"; {SPENT}" if self.spent else ""
        return self._nothing(f"{first}; {both}{spent}", none_possible=none_possible)

    def _not_found(self) -> str:
        """That no translation was found, and how short there is none."""
        if self.shortest is None or not self.shortest.at_least_mm >= STEP_MM:
            return NOT_FOUND
        return f"{NOT_FOUND}; {self.shortest.sentence}"

    def _nothing(self, text: str, *, none_possible: bool | None) -> Guidance:
        return Guidance(
            None, 0.0, self.pivot, (), None, verified=False, text=text, none_possible=none_possible
        )

    def _unchanged(self) -> str | None:
        """Why no move and no turn about the vertical helps: a violated boundary that they leave as it is."""
        names = unchanged_by_moves(self.problem, self.verdict)
        if not names:
            return None
        remedy = "declare another hold_roll_deg" if set(names) <= set(_ROLL) else "tilt the registration"
        return f"no translation and no turn about the vertical changes {', '.join(names)} (proved): {remedy}"

    def _translated(self, yaw_deg: float, effort: Effort) -> Guidance | None:
        """The smallest translation, with a turn, that the certified method admits; None also where the work is spent."""
        try:
            return self._searched(yaw_deg, effort)
        except EffortSpentError:
            self.spent = True
            return None

    def _searched(self, yaw_deg: float, effort: Effort) -> Guidance | None:
        effort.spend(QUANTISED * len(self.problem.tips_mm))
        turned = moved(self.problem, yaw_deg, self.pivot, (0.0, 0.0, 0.0))
        for reserve in map(_reserve, RESERVES_MM):
            placing = Placing(turned, reserve, effort=effort.part(SEARCHED * effort.left))
            found = smallest_translation(placing)
            self.spent |= placing.effort.spent >= placing.effort.most
            shortest = _Shortest.of(found.at_least_mm, reserve, roll=placing.follows_roll)
            if yaw_deg == 0.0 and self.shortest is None:
                self.shortest = shortest
            if found.translation_mm is None:
                return None
            self.fits_somewhere |= yaw_deg == 0.0
            shift = _steps(found.translation_mm * (1.0, placing.geometry.side, 1.0))
            clearance = self._verified(yaw_deg, shift, effort)
            if clearance is not None:
                return self._shown(yaw_deg, shift, clearance, shortest)
        return None

    def _verified(self, yaw_deg: float, shift: Vector, effort: Effort) -> float | None:
        """Smallest proven clearance of the arm on the moved path; None if it is not admitted."""
        effort.spend(QUANTISED * len(self.problem.tips_mm))
        path = moved(self.problem, yaw_deg, self.pivot, shift)
        tips, axes = self.quantise(path.tips_mm, path.axes)
        verdict = certified.verify(replace(path, tips_mm=tips, axes=axes, branch=None), effort)
        cured = [b for b in verdict.boundaries.values() if b.name in (*ARM_BOUNDARIES, *_ROLL)]
        self.too_fast = verdict.branch is not None and not any(
            b.violated for b in verdict.boundaries.values()
        )
        if not (verdict.admissible and all((b.certified or 0.0) >= b.deadband + SHOWN_MM for b in cured)):
            return None
        return min(b.certified for b in cured if b.name in ARM_BOUNDARIES and b.certified is not None)

    def _shown(self, yaw_deg: float, shift: Vector, clearance: float, shortest: _Shortest) -> Guidance:
        kept = _down(clearance - self.verdict.deadband_arm_mm, 0.01)
        text = f"the whole moved path keeps at least {kept:.2f} mm beyond the arm deadband (proved)"
        alone = yaw_deg == 0.0
        if alone:
            text += f"; {shortest.sentence}"
        else:
            text += "; it is the smallest turn found, cutgate reach shows what larger ones allow"
        return Guidance(
            translation_mm=shift,
            yaw_deg=yaw_deg,
            pivot_mm=self.pivot,
            moves=(),
            predicted_clearance_mm=clearance,
            verified=True,
            text=f"{text}; {NEW_REGISTRATION}",
            none_possible=False if alone else None,
            at_least_mm=shortest.at_least_mm if alone else None,
            reserve_mm=shortest.reserve_mm if alone else None,
            reserve_deg=shortest.reserve_deg if alone else None,
        )

    def _proof(self) -> _Proof | None:
        """A proof that no translation helps, or that none does with whatever turn about the vertical."""
        tall = "the path is taller than the slide's range"
        arm = "wherever it stands, a pose violates inner, outer, left or right"
        roll = "wherever the arm reaches every pose, the roll leaves its limits"
        if self._none_fits(shoulder=False):
            low, high = self.lift_mm
            why = tall if low > high else arm if self._none_fits(roll=False, shoulder=False) else roll
            return _Proof(
                f"no translation helps, with or without a turn about the vertical (proved): {why}",
                for_turns=True,
            )
        if self._none_fits():
            return _Proof(
                f"no translation helps (proved): {arm if self._none_fits(roll=False) else roll}",
                for_turns=False,
            )
        return None

    def _none_fits(self, *, roll: bool = True, shoulder: bool = True) -> bool:
        effort = self.effort.part(WORK_PROOF)
        try:
            placing = Placing(self.problem, Reserve(), roll=roll, shoulder=shoulder, effort=effort)
        except EffortSpentError:
            self.spent = True
            return False
        self.lift_mm = placing.lift_mm
        return smallest_translation(placing, any_will_do=True).none_fits

    def _turned(self) -> Guidance | None:
        """The smallest turn found, either way, for which the certified method admits a translation."""
        try:
            for steps in islice(self._turns(), TURNS_VERIFIED):
                found = self._translated(round(steps * STEP_DEG, 3), self.effort)
                if found is not None:
                    return found
        except EffortSpentError:
            self.spent = True
        return None

    def _turns(self) -> Iterator[int]:
        """Turns in steps of `STEP_DEG` for which a translation fits the poses, smallest first."""
        for coarse in range(COARSE_STEPS, round(180.0 / STEP_DEG) + 1, COARSE_STEPS):
            fitting = [sign * coarse for sign in (1, -1) if self._fits(sign * coarse)]
            refined = [self._narrowed(steps) for steps in fitting]
            yield from sorted({*refined, *fitting}, key=lambda steps: (abs(steps), steps))

    def _narrowed(self, steps: int) -> int:
        """The smallest turn that fits between the last coarse one, which does not, and this one."""
        sign, high = (1 if steps > 0 else -1), abs(steps)
        low = high - COARSE_STEPS
        while high - low > FINE_STEPS:
            middle = (low + high) // 2
            low, high = (low, middle) if self._fits(sign * middle) else (middle, high)
        return sign * high

    def _fits(self, steps: int) -> bool:
        self.effort.spend(QUANTISED * len(self.problem.tips_mm))
        turned = moved(self.problem, steps * STEP_DEG, self.pivot, (0.0, 0.0, 0.0))
        placing = Placing(turned, _reserve(RESERVES_MM[0]), effort=self.effort.part(TURN_WORK))
        found = smallest_translation(placing, any_will_do=True, finest_mm=TURN_FINEST_MM)
        return found.translation_mm is not None


def _attained(b: Boundary) -> bool:
    """Whether a pose of the path itself, not only a bound, is nearer than the deadband."""
    return b.violated and b.clearance is not None and b.clearance < b.deadband


def _hint(geometry: Geometry, b: Boundary, place: Points) -> Move:
    """Direction and amount for one boundary's worst place, in the robot frame."""
    lacking = max(b.deadband - (b.clearance or 0.0), 0.0)
    if b.name in SIDES:
        return Move(b.name, "move", _away(geometry, b, place), distance_mm=lacking + RESERVES_MM[0])
    if b.name in {"top", "bottom"}:
        up = 1.0 if b.name == "bottom" else -1.0
        return Move(b.name, "move", (0.0, 0.0, up), distance_mm=lacking + RESERVES_MM[0])
    return Move(b.name, "turn", _turn(geometry, b.name, place), angle_deg=lacking + RESERVE_DEG)


def _away(geometry: Geometry, b: Boundary, place: Points) -> Vector:
    """Away from the nearest place of the arc; toward it from outside."""
    mirrored = {"left": "right", "right": "left"}
    name = mirrored.get(b.name, b.name) if geometry.side < 0 else b.name
    arc = geometry.arcs[SIDES.index(name)]
    inward = place.centre[0] - nearest_on_arc(place.centre, arc)[0]
    if (b.clearance or 0.0) < 0.0:
        inward = -inward
    length = math.hypot(*inward)
    if not length > ON_THE_ARC_MM:  # on the arc itself: along its radius, inward for the right elbow
        outward = place.centre[0] - (arc.x, arc.y)
        inward = outward if name in {"inner", "right"} else -outward
        length = max(math.hypot(*inward), ON_THE_ARC_MM)
    return (float(inward[0] / length), geometry.side * float(inward[1] / length), 0.0)


def _turn(geometry: Geometry, name: str, place: Points) -> Vector:
    """Axis of a turn: the vertical for the roll, the horizontal across the tool for the pitch."""
    if name.startswith("roll"):
        return (0.0, 0.0, 1.0 if name == "roll_min" else -1.0)
    azimuth = geometry.side * float(place.azimuth[0])
    more = name == "pitch_min" or (name == "wrist_singularity" and float(place.pitch[0]) < math.pi / 2.0)
    sign = 1.0 if more else -1.0
    return (-sign * math.sin(azimuth), sign * math.cos(azimuth), 0.0)
