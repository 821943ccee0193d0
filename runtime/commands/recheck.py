"""``cutgate recheck``: check a proof that ``verify --certificate`` wrote, without searching."""

from pathlib import Path
from typing import Annotated

import typer

from cutgate.config.load import InputError, read_bytes
from cutgate.config.screen import printable
from cutgate.runtime.commands.registration_options import (
    DirectionOption,
    FrameOption,
    ResidualOption,
    TakenAtOption,
)
from cutgate.runtime.commands.screen import output, working
from cutgate.runtime.commands.tool_path_options import (
    ArcToleranceOption,
    AxisToleranceOption,
    CutcomOption,
    RotaryOption,
)
from cutgate.runtime.commands.verify import (
    FeedOption,
    PathArgument,
    RegistrationOption,
    RobotOption,
    ToolOption,
    one,
    read,
)
from cutgate.runtime.plan.registrations.declared import Declared
from cutgate.runtime.plan.toolpath.model import ARC_TOLERANCE_MM, AXIS_TOLERANCE_DEG, Reading
from cutgate.runtime.verification import certificate as proofs
from cutgate.runtime.verification.recorded import off_line_problem

HOLDS, FAILS = 0, 1


def recheck(
    certificate: Annotated[
        Path, typer.Argument(metavar="CERTIFICATE", help="Written by `verify --certificate`.")
    ],
    path: PathArgument,
    *,
    robot: RobotOption,
    registration: RegistrationOption = None,
    tool_length_mm: ToolOption = None,
    feed_mm_s: FeedOption = None,
    cutcom_is_tool_centre: CutcomOption = False,
    rotary: RotaryOption = None,
    arc_tolerance_mm: ArcToleranceOption = ARC_TOLERANCE_MM,
    axis_tolerance_deg: AxisToleranceOption = AXIS_TOLERANCE_DEG,
    registration_frame: FrameOption = None,
    registration_direction: DirectionOption = None,
    taken_at: TakenAtOption = None,
    registration_residual_mm: ResidualOption = None,
) -> None:
    """Check the proof that a whole cut path is admissible, interval by interval, without a search.

    Exit code: 0 the proof holds, 1 it does not prove this path admissible, 2 refused input.
    """
    declared = Declared(registration_frame, registration_direction, taken_at, registration_residual_mm)
    reading = Reading(cutcom_is_tool_centre, rotary, arc_tolerance_mm, axis_tolerance_deg)
    prepared = one(
        read(path, robot, registration, tool_length_mm, feed_mm_s, reading=reading, declared=declared)
    )
    try:
        proof = proofs.Certificate.parse(
            read_bytes(certificate, remedy="it holds something else; name a proof")
        )
    except proofs.CertificateError as error:
        remedy = "write it anew with `cutgate verify --certificate`"
        raise InputError(certificate, "", None, str(error), remedy) from None
    with working(f"checking {certificate}"):
        reasons = proofs.recheck(off_line_problem(prepared.path, prepared.robot), proof)
    pieces = len(prepared.path) - 1 + len(proof.cut_segment)
    console = output()
    if reasons:
        console.print(printable(f"NOT PROVEN: {certificate} does not prove that {path} is admissible"))
        for reason in reasons:
            console.print(f"  - {reason}")
    else:
        told = f"PROVEN: {path} is admissible, each of {pieces} intervals keeps every deadband"
        console.print(printable(told))
    console.print(f"path SHA-256 {prepared.path.digest.hex()}")
    raise typer.Exit(FAILS if reasons else HOLDS)


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command("recheck")(recheck)
