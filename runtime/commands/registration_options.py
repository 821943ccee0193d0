"""The options of a registration that another program wrote, and how it was read, for people."""

from typing import Annotated

import typer

from cutgate.config.load import Loaded
from cutgate.runtime.plan.registration import Registration
from cutgate.runtime.plan.registrations.declared import RESIDUAL_MAX_MM, CtFrame, TransformDirection
from cutgate.runtime.plan.registrations.foreign import Converted

_OF = "of a .tfm, .h5, .txt or .mat"

FrameOption = Annotated[
    CtFrame | None,
    typer.Option(
        "--registration-frame",
        help=f"Axes of the plan's CT coordinates, where those {_OF} are LPS: ras reverses x and y of the CT.",
    ),
]
DirectionOption = Annotated[
    TransformDirection | None,
    typer.Option(
        "--registration-direction",
        metavar="WAY",
        help=f"What the transform {_OF} takes to what: ct-to-robot or robot-to-ct.",
    ),
]
TakenAtOption = Annotated[
    str | None,
    typer.Option(
        "--taken-at", metavar="TIME", help=f"When the registration {_OF} was made, ISO-8601 in UTC."
    ),
]
ResidualOption = Annotated[
    float | None,
    typer.Option(
        "--registration-residual-mm",
        metavar="MM",
        help=f"Rms residual of the registration {_OF}, 0 to {RESIDUAL_MAX_MM:g}.",
    ),
]


def how_read(registration: Loaded[Registration] | None) -> str:
    """What was done to a registration of another program; empty where nothing was."""
    if not isinstance(registration, Converted):
        return ""
    declared = registration.declared
    inverted = declared.direction is TransformDirection.ROBOT_TO_CT
    way = "inverted, for it takes robot to CT" if inverted else "as it stands, from CT to robot"
    reversed_axes = declared.frame is CtFrame.RAS
    axes = (
        "x and y of the CT reversed (plan RAS, file LPS)" if reversed_axes else "CT axes as they stand (LPS)"
    )
    return f"{way}; {axes}; taken at {declared.taken_at}"
