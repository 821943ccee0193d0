"""Approach and retract: from where the arm stands to the first pose, and from the last pose to there again.

Two straight lines along the tool (entry to first pose, last pose to exit) are paths of two poses. Two joint lines (start
joints to entry, exit to start joints) have all joints linear in one parameter.

Rules, in order; every admitting comparison asks "inside?", so NaN denies:

1. All numbers of the cut are usable (`defects`), the clearance is at least 0, and the cut names its joint branch.
2. The cut's first and last pose have joints in that branch, followed along the whole cut.
3. Each straight line is admissible by the certified method, in the branch in which the cut meets it (`straight_line`).
4. The start joints are five finite numbers, the start tolerances at least 0.
5. Both ends of a joint line lie inside the true joint limits, and where a joints frame carries them. These are a box, so
   the whole line does: membership is by the joints themselves, and no arc is ever crossed (`joint_line`).
6. The wrist centre's distance to each clipped arc is enclosed (`curve`): it stays within h^2 / 8 max|c''| of the chord of
   an interval h, |c''| <= a0 q0'^2 + a1 (q0' + q1')^2, and the chord's distance is closed form (`segment_to_arc`).
7. Slide, roll and pitch are linear: their ends are their range. A joint line commands the roll instead of solving it
   from a pose, so a vertical tool is not singular on it and errors of the pose do not turn the roll further.

Of 3, 5, 6 and 7 everything that is lacking is said; where the start joints are at fault, with which joint to move (`standing`).

An arm that begins up to the start tolerance beside the start joints stays so near to the line (`start_offset` in the
interlock's permissives bounds the wrist centre at every elbow angle), hence the tolerance widens the deadbands.

Only the joint lines depend on where the arm stands. Hence the rest is verified before a session (`straight_lines`),
and the joint lines, whose cost does not depend on the number of poses, in it: step by step (`joint_lines`), each step
so short that a loop can take it between two of its cycles.

Example:
    ``stroke`` is that of `problem`, with the branch of its verdict.

    >>> from dataclasses import replace
    >>> cut = replace(stroke, branch=(0, 0))
    >>> start = StartJoints(np.array([0.0, 1.2, 250.0, 0.0, 1.0]), clearance_um=10_000)
    >>> found = verify(cut, start)
    >>> found.admissible, found.entry_um, [leg.name for leg in found.legs]
    (True, 11340, ['approach', 'entry', 'exit', 'retract'])
    >>> low = replace(start, joints=np.array([0.0, 1.2, 52.0, 0.0, 1.0]))
    >>> print(*verify(cut, low).reasons)
    the arm stands with q2 at 52.000 mm, its limits are [50, 450] mm, 5 mm (deadband ...) must be kept: move q2 by +3.01 mm, ...
"""

from __future__ import annotations

from typing import Final

import numpy as np

from cutgate.runtime.verification.approach.joint_line import joint_line
from cutgate.runtime.verification.approach.model import (
    ApproachVerdict,
    LegName,
    StartJoints,
    StraightLines,
    not_at_least_0,
    refused,
)
from cutgate.runtime.verification.approach.standing import standing
from cutgate.runtime.verification.approach.straight_line import straight_lines
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.steps import Steps, finished

_TITLE: Final[dict[LegName, str]] = {
    "approach": "joint line from the start joints to the entry pose",
    "entry": "straight line from the entry pose to the first pose",
    "exit": "straight line from the last pose to the exit pose",
    "retract": "joint line from the exit pose to the start joints",
}


def verify(problem: Problem, start: StartJoints) -> ApproachVerdict:
    """Verify approach and retract of a cut at the deadbands.

    Args:
        problem: the cut with its joint branch. Whether the cut itself is admissible is decided elsewhere.
        start: where the arm stands.
    """
    lines = straight_lines(problem, start.clearance_um)
    return finished(joint_lines(lines, start))


def joint_lines(lines: StraightLines | ApproachVerdict, start: StartJoints) -> Steps[ApproachVerdict]:
    """The joint lines between the start joints and entry and exit, and with them the whole answer."""
    if isinstance(lines, ApproachVerdict):
        return lines
    wrong = _unfit(start)
    if wrong:
        return refused(wrong)
    geometry, roll_held = lines.geometry, lines.roll_held
    legs = (
        (yield from joint_line(geometry, start, "approach", lines.entry, roll_held=roll_held)),
        lines.inward,
        lines.outward,
        (yield from joint_line(geometry, start, "retract", lines.exit, roll_held=roll_held)),
    )
    # What both joint lines lack where the arm stands is said once, and with what to do about it.
    moves: tuple[str, ...] = ()
    if any(leg.at_start for leg in legs):
        moves = standing(geometry, start.joints, start.tolerance_mm, start.tolerance_rad, roll_held=roll_held)
    reasons = (
        *moves,
        *(
            f"{_TITLE[leg.name]}: {reason}"
            for leg in legs
            for reason in leg.reasons
            if not (moves and reason in leg.at_start)
        ),
    )
    admissible = not any(leg.violated for leg in legs)
    return ApproachVerdict(admissible, lines.entry_um, lines.exit_um, lines.entry, lines.exit, legs, reasons)


def _unfit(start: StartJoints) -> tuple[str, ...]:
    """What makes the numbers of the start unfit to be verified; any doubt is a defect."""
    found = []
    if start.joints.shape != (5,) or not np.isfinite(start.joints).all():
        found.append("the start joints are not five finite numbers")
    found += not_at_least_0("start_tolerance_mm", start.tolerance_mm)
    found += not_at_least_0("start_tolerance", start.tolerance_rad)
    return tuple(found)
