"""The joint branch that somebody asks for: taken where the path fits in it, else refused with what does fit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from cutgate.config.load import InputError
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.report.reasons import unfit

OPTION: Final = {"q0": "--q0-turns", "q3": "--roll-turns"}
"""How the turns of a joint are asked for."""


@dataclass(frozen=True, slots=True)
class AskedTurns:
    """Whole turns at the first pose, of shoulder and roll; None where the best are to be chosen."""

    q0: int | None = None
    roll: int | None = None

    def __str__(self) -> str:
        """As it was asked for on the command line; empty where nothing was."""
        given = {"q0": self.q0, "q3": self.roll}
        return " ".join(f"{OPTION[joint]} {turns}" for joint, turns in given.items() if turns is not None)


BEST: Final = AskedTurns()
"""Nothing is asked for."""


def in_branch(problem: Problem, asked: AskedTurns) -> Problem:
    """The problem in the branch asked for; a joint of which nothing is asked keeps its best turns.

    Args:
        problem: without a branch.
        asked: whole turns.

    Returns:
        The problem as it is where nothing is asked, or where the path fits in no branch at all: its verdict says why.

    Raises:
        InputError: the path does not fit in these turns, and fits in others.
    """
    if asked == BEST:
        return problem
    verdict = certified.verify(problem)
    wanted = {"q0": asked.q0, "q3": asked.roll}
    for found in verdict.windings:
        turns = wanted[found.joint]
        if turns is not None and found.first <= found.last and (why := unfit(found, turns)):
            raise InputError(OPTION[found.joint], "", turns, found.feasible, why)
    best = verdict.branch
    if best is None:
        return problem
    q0 = best.q0_turns if asked.q0 is None else asked.q0
    return replace(problem, branch=(q0, best.roll_turns if asked.roll is None else asked.roll))
