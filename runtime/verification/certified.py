"""The gate's method: decide for every point of the continuous path, not for samples.

Rules, in order; every admitting comparison asks "inside?", so NaN denies:

1. All numbers are finite and usable (`defects`).
2. The path starts inside the planar workspace, by inverse kinematics.
3. No boundary's proven bound is below its deadband. As the signed distances are enclosed along the
   whole path, a path that starts inside and keeps them cannot leave, nor change its branch.
4. Shoulder and roll, followed continuously, stay within their limits for one choice of whole turns, and where a
   joints frame can carry them, with one revolution to spare.
5. The joint speeds at the planned feed stay within their limits, and so do the accelerations inside the
   segments where limits are given.

Whatever is not proven is refused: what lies between bound and least value found is undecided, and said to be. Every rule is
evaluated and everything that is lacking is said, but for 1: of numbers that are none nothing else is known.

Example:
    ``stroke`` is that of `problem`.

    >>> verdict = verify(stroke)
    >>> verdict.admissible, verdict.branch
    (True, JointBranch(elbow='right', q0_turns=0, roll_turns=0))
    >>> tight = verify(replace(stroke, deadband=Deadband(arm_mm=200.0, wrist_rad=0.03)))
    >>> tight.admissible, [name for name, b in tight.boundaries.items() if b.violated]
    (False, ['top', 'bottom'])
    >>> verify(replace(stroke, feed_mm_s=float("nan"))).reasons
    ('feed_mm_s is nan, must be finite and above 0',)
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cutgate.protocol.arrays import Bools, Floats
from cutgate.runtime.kinematics.arm import turns
from cutgate.runtime.kinematics.pose import lengths
from cutgate.runtime.verification.bounds.bisection import Survey, survey
from cutgate.runtime.verification.bounds.chain import Chain, build
from cutgate.runtime.verification.bounds.enclosures import (
    ACCELERATION,
    COLUMNS,
    HALF_TURN,
    LEFT,
    Q0_MAX,
    Q0_MIN,
    RIGHT,
    ROLL_MAX,
    ROLL_MIN,
    SPEED,
    Scope,
)
from cutgate.runtime.verification.bounds.first_look import FirstLook, extremes_of
from cutgate.runtime.verification.bounds.geometry import MIRRORED, Geometry, Segments, canonical
from cutgate.runtime.verification.bounds.look import TouchesError
from cutgate.runtime.verification.bounds.minima import Aim
from cutgate.runtime.verification.branch import GOES_RAD, Candidate, candidates, choose, confined, winding
from cutgate.runtime.verification.defects import defects
from cutgate.runtime.verification.effort import Effort
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.quantities import (
    Enclosed,
    azimuth_defined,
    boundary,
    held_roll,
    rates,
    refused,
    slide_and_pitch,
    wrist_length,
)
from cutgate.runtime.verification.report.reasons import roll_out_of_frame, sentences, unfit
from cutgate.runtime.verification.verdict import (
    BOUNDARIES,
    Boundary,
    Evaluations,
    JointBranch,
    Quantity,
    SpeedLine,
    Verdict,
    Winding,
)
from cutgate.runtime.workspace.planar import SIDES

GAP_MM = 0.008
"""Survey: proven and attained value this close, mm; the promise is 0.01."""

GAP_RAD = math.radians(0.008)
"""The same for the roll."""

FINE_MM = 5e-4
"""A bracket that straddles its deadband is narrowed to this before it counts as undecided."""

FINE_RAD = math.radians(5e-4)

GAP_RATE = {"speed": 0.01, "acceleration": 0.05}
"""The same for joint speeds and accelerations, as a part of the larger of peak and limit."""

GAP_MISSED = {"speed": 0.25, "acceleration": np.inf}
"""The same for a rate that is above its limit, as a part of its peak: how much too high it is matters little."""

FINE_RATE = 5e-4


POSES, POSE = 15_000, 3
"""Work beside the surveys, whole and for each pose, as `Effort` counts it."""


def verify(problem: Problem, effort: Effort | None = None) -> Verdict:
    """Verify a path at its deadbands, for all its points, arm and wrist together.

    Args:
        problem: the path.
        effort: bound on the work; without it the verdict's own bounds alone end it.

    Raises:
        EffortSpentError: it takes more work than that; nothing is then decided.
    """
    wrong = defects(problem)
    if wrong:
        return refused(problem, wrong, "certified")
    if effort is not None:
        effort.spend(POSES + POSE * len(problem.tips_mm))
    geometry, segments = canonical(problem)
    path: Chain | FirstLook | None = None
    if not problem.closely:
        path = FirstLook.of(geometry, segments, accelerations=problem.acceleration is not None)
    if path is None:
        path = build(geometry, segments, effort)
    return _Verification(problem, geometry, segments, path, effort).verdict()


class _Verification:
    """One run; its methods are the steps of `verdict`, in order."""

    def __init__(
        self,
        problem: Problem,
        geometry: Geometry,
        segments: Segments,
        path: Chain | FirstLook,
        effort: Effort | None,
    ) -> None:
        self.problem = problem
        self.effort = effort
        self.geometry = geometry
        self.segments = segments
        self.path = path
        self.limits = limits = extremes_of(geometry, segments, path)
        self.evaluations = [0, 0]
        self.budget = 0
        self.windings: list[Winding] = []
        self.held = held_roll(problem, limits)
        self.roll_defined = path.winding_known and azimuth_defined(limits)
        self.tip_at = np.concatenate(([0.0], np.cumsum(lengths(segments.tip[1:] - segments.tip[:-1]))))

    def verdict(self) -> Verdict:
        """Enclose everything, choose the branch, and say what the path lacks."""
        first = self._survey(self._first_columns())
        values = slide_and_pitch(self.geometry, self.limits, self.held)
        for column, name in enumerate(SIDES):
            values[name] = _value(first, column)
        shoulder = self._shoulder(first, values)
        roll = self._roll(first, values)
        branch = None
        if shoulder is not None and roll is not None:
            branch = JointBranch(self.problem.arm.elbow, shoulder.turns, roll.turns)
        boundaries = self._boundaries(values)
        lines = self._rates(first)
        other = self._other_reasons(values, branch)
        ok = not other and all(not b.violated for b in boundaries.values()) and all(line.ok for line in lines)
        return Verdict(
            method="certified",
            admissible=ok and branch is not None,
            tip_length_mm=float(self.tip_at[-1]),
            wrist_length_mm=self._wrist_length(),
            axis_angle_rad=float(self.segments.theta.sum()),
            deadband_arm_mm=self.geometry.arm_mm,
            deadband_wrist_rad=self.geometry.wrist_rad,
            branch=branch,
            evaluations=Evaluations(self.evaluations[0], self.evaluations[1], self.budget),
            boundaries=boundaries,
            speed=lines[:5],
            acceleration=lines[5:],
            windings=tuple(self.windings),
            reasons=(*other, *sentences(self.problem, boundaries, lines)),
        )

    # -- surveys ------------------------------------------------------------------------------

    def _first_columns(self) -> Bools:
        wanted = np.ones(COLUMNS, dtype=np.bool_)
        full = self.geometry.workspace.full_revolution
        wanted[[LEFT, RIGHT]] = not full
        wanted[[Q0_MIN, Q0_MAX]] = full or not confined(self.geometry, 0)
        wanted[ACCELERATION:] = self.problem.acceleration is not None
        if self.held is not None:
            wanted[[ROLL_MIN, ROLL_MAX, SPEED + 3, ACCELERATION + 3]] = False
        return wanted

    def _survey(
        self, wanted: Bools, *, shift: float | None = None, roll_target: tuple[float, float] | None = None
    ) -> Survey:
        gap, fine = np.full(COLUMNS, GAP_MM), np.full(COLUMNS, FINE_MM)
        gap[ROLL_MIN:SPEED], fine[ROLL_MIN:SPEED] = GAP_RAD, FINE_RAD
        target, share, missed = np.full(COLUMNS, -np.inf), np.zeros(COLUMNS), np.zeros(COLUMNS)
        target[:ROLL_MIN] = self.geometry.arm_mm
        for quantity, first, limits in rates(self.problem):
            joints, part = slice(first, first + 5), GAP_RATE[quantity]
            gap[joints], fine[joints], target[joints] = part * limits, FINE_RATE * limits, -limits
            share[joints], missed[joints] = part, GAP_MISSED[quantity]
        if roll_target is not None:
            target[[ROLL_MIN, ROLL_MAX]] = roll_target
        scope = Scope(
            wanted,
            reachable=not self.geometry.workspace.empty,
            winding_known=self.path.winding_known,
            roll_defined=self.roll_defined,
            shoulder_shift=shift,
        )
        aim = Aim(gap, share, missed, target, fine)
        try:
            done = survey(self.geometry, self.segments, self.path, scope, aim, self.effort)
        except TouchesError:
            self.path = build(self.geometry, self.segments, self.effort)
            done = survey(self.geometry, self.segments, self.path, scope, aim, self.effort)
        self.evaluations[0] += done.evaluations if wanted[:ROLL_MIN].any() else 0
        self.evaluations[1] += done.evaluations if wanted[[ROLL_MIN, ROLL_MAX]].any() else 0
        self.budget += done.budget
        return done

    # -- branches -----------------------------------------------------------------------------

    def _shoulder(self, first: Survey, values: dict[str, Enclosed]) -> Candidate | None:
        """Choose the turn of q0; fills left and right where they count by the unwrapped q0."""
        asked = None if self.problem.branch is None else self.problem.branch[0]
        start = self.path.start[0]
        if not (self.path.winding_known and math.isfinite(start)):
            return None
        full = self.geometry.workspace.full_revolution
        if not all(values[name].attained >= 0.0 for name in (SIDES[:LEFT] if full else SIDES)):
            return None  # out of these there is no shoulder to follow
        reach, proven = self._shoulder_range(first)
        if not all(map(math.isfinite, (*reach, *proven))):
            return None
        self.windings.append(winding(self.geometry, 0, start, reach))
        if not full:  # the sides keep it within its limits
            found = candidates(self.geometry, 0, start, (start, start), asked, proven)[0]
            return found if found.fits else None
        others = self._worst_ratio(values, leave_out=("left", "right"))
        best: tuple[float, Candidate, dict[str, Enclosed]] | None = None
        for option in candidates(self.geometry, 0, start, reach, asked, proven):
            sides = self._unwrapped_sides(option, reach)
            ratio = min([others, *(v.certified / self.geometry.arm_mm for v in sides.values())])
            if best is None or ratio > best[0]:
                best = (ratio, option, sides)
            if ratio >= others:
                break
        if best is None:  # pragma: no cover -- candidates() returns at least one
            return None
        for name in ("left", "right"):
            del values[name]
        values.update(best[2])
        return best[1] if best[1].fits else None

    def _shoulder_range(self, first: Survey) -> tuple[tuple[float, float], tuple[float, float]]:
        """Least and largest unwrapped q0 as found and, where its limits do not say so themselves, as proven."""
        if self._first_columns()[Q0_MIN]:
            return _range(first.attained, Q0_MIN), _range(first.certified, Q0_MIN)
        found = self.path.shoulder
        return found, found

    def _unwrapped_sides(self, option: Candidate, reach: tuple[float, float]) -> dict[str, Enclosed]:
        """Left and right for one choice of turns; left out where the path stays half a turn away."""
        g = self.geometry
        slack = GAP_RAD  # the range is attained, its bound may be that much wider
        near = {
            "left": reach[1] + option.shift + slack >= g.upper[0] - HALF_TURN,
            "right": reach[0] + option.shift - slack <= g.lower[0] + HALF_TURN,
        }
        if not any(near.values()):
            return {}
        wanted = np.zeros(COLUMNS, dtype=np.bool_)
        wanted[[LEFT, RIGHT]] = near["left"], near["right"]
        done = self._survey(wanted, shift=option.shift)
        found = {
            name: _value(done, column) for name, column in (("left", LEFT), ("right", RIGHT)) if near[name]
        }
        return {n: v for n, v in found.items() if math.isfinite(v.attained) or not v.certified >= g.arm_mm}

    def _roll(self, first: Survey, values: dict[str, Enclosed]) -> Candidate | None:
        """Choose the turn of the roll and fill its two boundaries."""
        g = self.geometry
        asked = None if self.problem.branch is None else self.problem.branch[1]
        if self.held is not None:
            return self._held_roll(values, asked)
        reach, proven = (_range(bounds, ROLL_MIN) for bounds in (first.attained, first.certified))
        start = self.path.start[1]
        if not all(map(math.isfinite, (*proven, *reach, start, float(g.lower[3]), float(g.upper[3])))):
            return None  # of limits the wrong way round as well
        self.windings.append(winding(self.geometry, 3, start, reach))
        options = candidates(g, 3, start, reach, asked, proven)
        chosen = choose(options, g.wrist_rad, self._worst_ratio(values, leave_out=()))
        shift = chosen.shift
        target = (g.lower[3] + g.wrist_rad - shift, -(g.upper[3] - g.wrist_rad - shift))
        undecided = any(
            first.certified[c] < t <= first.attained[c] and first.attained[c] - first.certified[c] > FINE_RAD
            for c, t in zip((ROLL_MIN, ROLL_MAX), target, strict=True)
        )
        if undecided:
            wanted = np.zeros(COLUMNS, dtype=np.bool_)
            wanted[[ROLL_MIN, ROLL_MAX]] = True
            first = self._survey(wanted, roll_target=target)
        values["roll_min"] = _value(first, ROLL_MIN, shift - float(g.lower[3]))
        values["roll_max"] = _value(first, ROLL_MAX, float(g.upper[3]) - shift)
        return chosen if chosen.fits else None

    def _held_roll(self, values: dict[str, Enclosed], asked: int | None) -> Candidate | None:
        """A vertical tool held at a declared roll: both boundaries are constants."""
        held = float(self.held or 0.0)
        reported = int(turns(np.float64(held)))  # type: ignore[arg-type]
        true = self.geometry.side * held + float(self.geometry.offset[3])
        for name, margin in (
            ("roll_min", true - float(self.geometry.lower[3])),
            ("roll_max", float(self.geometry.upper[3]) - true),
        ):
            values[name] = Enclosed(margin, margin, 0, 0.0)
        fits = min(values["roll_min"].attained, values["roll_max"].attained) >= 0.0 and abs(held) <= GOES_RAD
        self.windings.append(
            replace(winding(self.geometry, 3, true, (true, true)), first=reported, last=reported)
        )
        if not fits or asked not in {None, reported}:
            return None
        return Candidate(0.0, reported, fits=True, margin=0.0)

    def _worst_ratio(self, values: dict[str, Enclosed], leave_out: tuple[str, ...]) -> float:
        g = self.geometry
        return min(
            v.certified / (g.wrist_rad if name.startswith(("pitch", "wrist", "roll")) else g.arm_mm)
            for name, v in values.items()
            if name not in leave_out
        )

    # -- the answer ---------------------------------------------------------------------------

    def _boundaries(self, values: dict[str, Enclosed]) -> dict[str, Boundary]:
        """Back to the arm as it was given: a mirrored arm's sides and roll ends change places."""
        out: dict[str, Boundary] = {}
        left_out = set()
        if self.held is not None:
            left_out = {"wrist_singularity", "pitch_min"} - set(values)
        if self.geometry.workspace.full_revolution and self.path.winding_known:
            left_out |= {"left", "right"} - set(values)
        for name in BOUNDARIES:
            source = MIRRORED.get(name, name) if self.geometry.side < 0 else name
            if source in left_out:
                continue
            value = values.get(source)
            out[name] = boundary(name, value, self.geometry.arm_mm, self.geometry.wrist_rad, self.tip_at)
        return out

    def _rates(self, first: Survey) -> tuple[SpeedLine, ...]:
        return tuple(
            self._rate(first, quantity, joint, column + joint, float(limits[joint]))
            for quantity, column, limits in rates(self.problem)
            for joint in range(5)
        )

    def _rate(self, first: Survey, quantity: Quantity, joint: int, column: int, limit: float) -> SpeedLine:
        if joint == 3 and self.held is not None:
            return SpeedLine(joint, limit, 0.0, 0, ok=True, quantity=quantity)
        bound, found = -float(first.certified[column]), -float(first.attained[column])
        too_high = quantity == "acceleration" and found > limit  # not enclosed any further
        peak = max(0.0, found if too_high else bound)
        known = math.isfinite(peak) and math.isfinite(found)
        place = int(first.segment[column]) if known else None
        return SpeedLine(
            joint, limit, peak if known else None, place, ok=known and peak <= limit, quantity=quantity
        )

    def _other_reasons(self, values: dict[str, Enclosed], branch: JointBranch | None) -> tuple[str, ...]:
        out = []
        if not self.path.starts_inside:
            out.append(
                "the path starts outside the planar workspace: no joint position within the limits "
                "reaches the first wrist centre; move the bone toward the workspace"
            )
        bounding = SIDES[:LEFT] if self.geometry.workspace.full_revolution else SIDES
        if branch is None and min(values[name].attained for name in bounding) < 0.0:
            out.append("no joint branch holds the whole path: it leaves the reach")
        elif branch is None:
            asked = self.problem.branch
            turn = (
                "no choice of whole turns keeps"
                if asked is None
                else f"q0_turns {asked[0]}, roll_turns {asked[1]} do not keep"
            )
            out.append(f"{turn} shoulder and roll within their limits along the whole path")
            wanted = {"q0": None, "q3": None} if asked is None else {"q0": asked[0], "q3": asked[1]}
            if self.held is not None and not abs(self.held) <= GOES_RAD:
                out.append(roll_out_of_frame(self.held))
            out += [text for found in self.windings if (text := unfit(found, wanted[found.joint]))]
        return tuple(out)

    def _wrist_length(self) -> float:
        """Length of the wrist-centre path, mm: Gauss-Legendre on each segment's smooth speed."""
        return wrist_length(self.segments, self.geometry.tool_mm)


def _range(bounds: Floats, column: int) -> tuple[float, float]:
    """Least and largest value of a column pair: the second has the other sign."""
    return float(bounds[column]), -float(bounds[column + 1])


def _value(done: Survey, column: int, offset: float = 0.0) -> Enclosed:
    return Enclosed(
        float(done.attained[column]) + offset,
        float(done.certified[column]) + offset,
        int(done.segment[column]),
        float(done.fraction[column]),
    )
