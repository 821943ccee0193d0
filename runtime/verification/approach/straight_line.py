"""The straight lines along the tool: where entry and exit are, and whether the lines between them and the cut are kept."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cutgate.protocol.arrays import Floats
from cutgate.protocol.records import joints_to_counts, joints_to_memory
from cutgate.runtime.kinematics.arm import REVOLUTION, turns
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.approach.model import (
    ApproachVerdict,
    LegName,
    LegVerdict,
    StraightLines,
    not_at_least_0,
    refused,
)
from cutgate.runtime.verification.bounds.chain import build
from cutgate.runtime.verification.bounds.geometry import VERTICAL, canonical
from cutgate.runtime.verification.defects import defects
from cutgate.runtime.verification.problem import Problem


def straight_lines(problem: Problem, clearance_um: int) -> StraightLines | ApproachVerdict:
    """Entry and exit, and the lines between them and the cut; the answer at once where there are none.

    Args:
        problem: as for `verify`.
        clearance_um: as in `Start`.
    """
    wrong = list(defects(problem))
    if problem.branch is None:
        wrong.append("the cut names no joint branch")
    wrong += not_at_least_0("approach_clearance", clearance_um)
    if wrong:
        return refused(tuple(wrong))
    first, last = first_and_last_joints(problem)
    if not (np.isfinite(first).all() and np.isfinite(last).all()):
        return refused(("the cut's first or last pose has no joints: cure the cut first",))
    entry_um, exit_um = (standoff_um(problem, pose, clearance_um) for pose in (0, -1))
    inward, entry = straight_line(problem, "entry", 0, entry_um, first)
    outward, leaving = straight_line(problem, "exit", -1, exit_um, last)
    geometry, _ = canonical(problem)
    return StraightLines(geometry, roll_is_held(problem), entry_um, exit_um, entry, leaving, inward, outward)


def standoff_um(problem: Problem, pose: int, clearance_um: int) -> int:
    """From a pose along its axis to the clearance beyond every tip of the path, rounded up to whole um."""
    along = (problem.tips_mm - problem.tips_mm[pose]) @ problem.axes[pose]
    return math.ceil(clearance_um + 1000.0 * float(along.max()))


def roll_is_held(problem: Problem) -> bool:
    """Whether the cut holds a declared roll, its axis being vertical throughout."""
    level = np.hypot(problem.axes[:, 0], problem.axes[:, 1])
    return problem.hold_roll is not None and bool((level < VERTICAL).all())


def first_and_last_joints(problem: Problem) -> Floats:
    """Reported joints at the first and the last pose, followed along the path in its branch; NaN if unknown. (2, 5)."""
    geometry, segments = canonical(problem)
    chain = build(geometry, segments)
    if not chain.winding_known or problem.branch is None:
        return np.full((2, 5), np.nan)
    both = chain.points.take(np.array((0, len(chain))))
    true = np.stack((both.shoulder, both.elbow, both.height, both.roll, both.pitch), axis=1)
    joints: Floats = (true - geometry.offset) * geometry.signs
    for joint, asked in ((0, problem.branch[0]), (3, problem.branch[1])):
        joints[:, joint] += REVOLUTION * (asked - turns(joints[:1, joint]))
    if roll_is_held(problem):
        joints[:, 3] = float(problem.hold_roll or 0.0)
    return joints


def straight_line(
    problem: Problem, name: LegName, pose: int, length_um: int, joints: Floats
) -> tuple[LegVerdict, Floats]:
    """The line from a pose along its axis, in the branch in which the cut meets it.

    The set of places is the same in both directions, and so are the joint speeds; hence both lines are verified
    from the pose outward, where the branch is known.

    Args:
        problem: the cut.
        name: of the leg.
        pose: its number.
        length_um: of the line.
        joints: at the pose.

    Returns:
        The leg, and the joints at its outer end as a permit carries them: what is bound is what is verified.
    """
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
    far: Floats = first_and_last_joints(line)[1]
    carried = joints_to_memory(joints_to_counts(far)) if np.isfinite(far).all() else far
    return LegVerdict(name, verdict.boundaries, reasons), carried
