"""Whether the other elbow configuration would admit a path that is not admitted, as the bone stands.

Decided by the certified method itself, for the same arm with the elbow's limits mirrored: what else the other
configuration may need is not known here. The work is counted and bounded; where it is spent nothing is said either way.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, Literal

from cutgate.runtime.verification import certified
from cutgate.runtime.verification.advice import OtherElbow
from cutgate.runtime.verification.defects import defects
from cutgate.runtime.verification.effort import Effort, EffortSpentError
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.report.summary import summary
from cutgate.runtime.verification.verdict import Verdict

WORK: Final = 4_000_000
"""Bound on the work, in points looked at (`Effort`): half a second or so."""

OTHER: Final[dict[str, Literal["right", "left"]]] = {"right": "left", "left": "right"}


def other_elbow(problem: Problem, verdict: Verdict, work: float = WORK) -> OtherElbow | None:
    """Verify the path for the other elbow.

    Args:
        problem: what was verified.
        verdict: the certified method's answer to it.
        work: bound on the work.

    Returns:
        None where the path is admitted, where another method decided, or where the numbers themselves are unfit.
    """
    if verdict.admissible or verdict.method != "certified" or defects(problem):
        return None
    elbow = OTHER[problem.arm.elbow]
    lower, upper = problem.lower.copy(), problem.upper.copy()
    lower[1], upper[1] = -problem.upper[1], -problem.lower[1]
    arm = replace(problem.arm, elbow=elbow)
    mirrored = replace(problem, arm=arm, lower=lower, upper=upper, branch=None)
    q1_deg = (round(math.degrees(lower[1]), 6) + 0.0, round(math.degrees(upper[1]), 6) + 0.0)
    limits = f"its q1 limits taken as [{q1_deg[0]:g}, {q1_deg[1]:g}] deg"
    try:
        found = certified.verify(mirrored, Effort(work))
    except EffortSpentError:
        text = f"whether the {elbow} elbow would admit this path is not proved: it takes more work than is given to it"
        return OtherElbow(elbow, q1_deg, None, text)
    if found.admissible:
        text = f"the {elbow} elbow would admit this path as the bone stands ({limits}): {summary(found)}"
    else:
        text = f"the {elbow} elbow would not admit this path either as the bone stands ({limits}): {summary(found)}"
    return OtherElbow(elbow, q1_deg, found.admissible, text)
