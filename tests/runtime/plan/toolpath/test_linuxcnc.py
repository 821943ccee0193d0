"""Random programs, read by us and run by LinuxCNC's interpreter: the same moves, or both refuse."""

from dataclasses import replace

import numpy as np
import pytest

from cutgate.config.refusal import InputError
from cutgate.runtime.plan.toolpath.model import Reading
from tests.runtime.plan.toolpath.linuxcnc import VARIABLE, Programs, differs, interpreted, interpreter
from tests.runtime.plan.toolpath.reading import path_of
from tests.tool_paths import tool_path

pytestmark = [
    pytest.mark.processes,
    pytest.mark.skipif(interpreter() is None, reason=f"{VARIABLE} names no interpreter of LinuxCNC"),
]
PROGRAMS = 40
OURS_ALONE = ("check its units", "two poses or more", "no loop between")
"""Refusals of what LinuxCNC executes: it is too far out, moves nothing, or is not executed as it is written."""


def compared(program: str, folder) -> str:
    """How the two differ: empty where they do not."""
    moves, ended = interpreted(program, folder)
    try:
        path = path_of(program, Reading(arc_tolerance_mm=0.005))
    except InputError as error:
        return str(error) if ended and not any(part in str(error) for part in OURS_ALONE) else ""
    if not ended:
        return f"only LinuxCNC refuses, after {len(moves)} moves"
    (cut,) = path.cuts
    tolerance_mm = 0.006 if program.startswith("G20") else 2e-4
    return differs(moves, cut, tolerance_mm, 20 * tolerance_mm)


@pytest.mark.parametrize("seed", range(PROGRAMS))
def test_random_programs_move_the_tool_alike(seed: int, tmp_path):
    program = Programs(seed).program()
    assert compared(program, tmp_path) == "", program


def test_a_difference_is_seen(tmp_path):
    moves, _ = interpreted("G21 G90\nG0 X0 Y0 Z0\nF60\nG2 X2 I1\nG1 Y5\nM2\n", tmp_path)
    for other in (
        "G3 X2 I1\nG1 Y5",
        "G2 X2 I1 P2\nG1 Y5",
        "G2 X2 I1\nG0 Y5",
        "G2 X2 I1",
        "G2 X2 I1\nG1 Y5\nX9",
    ):
        (cut,) = path_of(f"G21 G90\nG0 X0 Y0 Z0\nF60\n{other}\nM2\n").cuts
        assert differs(moves, cut, 1e-3, 0.02)


def test_the_impeller_by_its_coordinates(tmp_path):
    text = tool_path("impeller-7bl-xyzac.ngc").read_text()
    moves, ended = interpreted("G21\n" + text.replace("M428", "").replace("M429", ""), tmp_path)
    assert ended
    (cut,) = path_of(text, Reading(rotary="xyzac", axis_tolerance_deg=1.0)).cuts
    assert sum(move.feeds for move in moves) == 4306
    ends = np.append(np.diff(cut.lines) > 0, True)
    whole = replace(cut, tips_mm=cut.tips_mm[ends], positioning=cut.positioning[ends], lines=cut.lines[ends])
    assert differs(moves, whole, 1e-3, 0.02) == ""
