"""What a person may declare of a tool path file on the command line, the same for every command that reads one."""

from typing import Annotated

import typer

from cutgate.runtime.plan.toolpath.model import TOLERANCES

CutcomOption = Annotated[
    bool,
    typer.Option(
        "--cutcom-is-tool-centre",
        help="APT: coordinates under cutter compensation (CUTCOM) are the tool's centre already.",
    ),
]
RotaryOption = Annotated[
    str | None,
    typer.Option(metavar="AXES", help="G-code: what A, B and C turn, for example xyzac; see docs/files.md."),
]
ArcToleranceOption = Annotated[
    float,
    typer.Option(
        metavar="MM",
        min=TOLERANCES[0],
        max=TOLERANCES[1],
        help="How far chords may be off an arc of the file; widens the deadbands.",
    ),
]
AxisToleranceOption = Annotated[
    float,
    typer.Option(
        metavar="DEG",
        min=TOLERANCES[0],
        max=TOLERANCES[1],
        help="How far great circles may be off a turn of machine axes; widens the deadbands.",
    ),
]
