"""Reads programs for the tests."""

import numpy as np
import pytest

from cutgate.config.refusal import InputError
from cutgate.runtime.plan.toolpath.gcode import read_gcode
from cutgate.runtime.plan.toolpath.model import PLAIN, Cut, Reading, ToolPath

XYZAC = Reading(rotary="xyzac")
LIMIT = 100_000
HEAD = "G21 G90 G99 F60\nG0 X0 Y0 Z0\n"
"""Two lines that leave the tool at the origin, in mm and at 1 mm/s."""


def path_of(program: str, reading: Reading = PLAIN, limit: int = LIMIT, told=None) -> ToolPath:
    return read_gcode("program.ngc", program.encode(), reading, limit, told)


def cut_of(program: str, reading: Reading = PLAIN, limit: int = LIMIT) -> Cut:
    (cut,) = path_of(program, reading, limit).cuts
    return cut


def after_head(lines: str, reading: Reading = PLAIN) -> Cut:
    """What these lines do from the origin on."""
    return cut_of(f"{HEAD}{lines}\nM2\n", reading)


def tips(lines: str) -> list[tuple[float, ...]]:
    """Where the tip comes from the origin on, rounded."""
    return [tuple(tip) for tip in np.round(after_head(lines).tips_mm[1:], 6).tolist()]


def refused(program: str, line: int, *parts: str, reading: Reading = PLAIN, limit: int = LIMIT) -> str:
    """The refusal of a program: it names the line, and says these parts."""
    with pytest.raises(InputError) as caught:
        path_of(program, reading, limit)
    text = str(caught.value)
    assert text.startswith(f"program.ngc: line {line} " if line else "program.ngc"), text
    for part in parts:
        assert part in text, text
    assert text.isprintable()
    return text
