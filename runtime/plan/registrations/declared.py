"""What a person declares of a registration whose file does not say it: frame, direction, time and residual."""

from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Final

from pydantic_core import PydanticCustomError

from cutgate.config.refusal import FileProblem, InputError, shown
from cutgate.runtime.plan.registration import finer_than_a_microsecond, utc_time

RESIDUAL_MAX_MM: Final = 100.0


class CtFrame(StrEnum):
    """Axes of the plan's CT coordinates: toward left, posterior, superior; or toward right, anterior, superior."""

    LPS = "lps"
    RAS = "ras"


class TransformDirection(StrEnum):
    """What the file's transform takes to what."""

    CT_TO_ROBOT = "ct-to-robot"
    ROBOT_TO_CT = "robot-to-ct"


@dataclass(frozen=True, slots=True)
class Declared:
    """What is declared on the command line; None is not declared.

    Attributes:
        frame: of the plan's CT coordinates; the file's are LPS.
        direction: of the file's transform.
        taken_at: when the registration was made, ISO-8601 in UTC.
        residual_mm: its root mean square, mm, 0 to 100.
    """

    frame: CtFrame | None = None
    direction: TransformDirection | None = None
    taken_at: str | None = None
    residual_mm: float | None = None

    def __str__(self) -> str:
        """The options as they are given."""
        given = ((OPTIONS[one.name], getattr(self, one.name)) for one in fields(self))
        return " ".join(f"{name} {value}" for name, value in given if value is not None)


NOTHING: Final = Declared()
OPTIONS: Final = {
    "frame": "--registration-frame",
    "direction": "--registration-direction",
    "taken_at": "--taken-at",
    "residual_mm": "--registration-residual-mm",
}
"""What each field of `Declared` is called on the command line."""
_SAY: Final = {
    "frame": "say lps or ras: the axes of the plan's CT coordinates (the file's are LPS)",
    "direction": "say ct-to-robot or robot-to-ct: what the file's transform takes to what",
    "taken_at": "say when the bone was registered, for example 2026-03-01T08:30:00Z",
    "residual_mm": f"say the registration's rms residual, 0 to {RESIDUAL_MAX_MM:g} mm",
}


def refuse_declared(declared: Declared, why: str, remedy: str) -> None:
    """Refuses whatever is declared where it means nothing: whoever says it expects an effect.

    Args:
        declared: what is declared.
        why: the end of "must be left out: ...".
        remedy: what to do.

    Raises:
        InputError: names each option.
    """
    given = [one.name for one in fields(Declared) if getattr(declared, one.name) is not None]
    if given:
        bound = f"left out: {why}"
        raise InputError.of(
            [
                FileProblem(OPTIONS[name], "", shown(str(getattr(declared, name))), bound, remedy)
                for name in given
            ]
        )


@dataclass(frozen=True, slots=True)
class Complete:
    """All that a foreign registration needs, declared; fields as in `Declared`."""

    frame: CtFrame
    direction: TransformDirection
    taken_at: str
    residual_mm: float


def complete(file: object, declared: Declared) -> Complete:
    """Everything that this file does not say.

    Raises:
        InputError: names each option that is missing, or one whose value is none.
    """
    frame, direction = declared.frame, declared.direction
    taken_at, residual_mm = declared.taken_at, declared.residual_mm
    if frame is None or direction is None or taken_at is None or residual_mm is None:
        missing = [one.name for one in fields(Declared) if getattr(declared, one.name) is None]
        bound = f"is needed with {file}, which does not say it"
        raise InputError.of([FileProblem(OPTIONS[name], "", "", bound, _SAY[name]) for name in missing])
    _check_taken_at(taken_at)
    if not (0.0 <= residual_mm <= RESIDUAL_MAX_MM):
        bound = f"0 to {RESIDUAL_MAX_MM:g} mm"
        raise InputError(OPTIONS["residual_mm"], "", f"{residual_mm:g}", bound, "register the bone again")
    return Complete(frame, direction, taken_at, residual_mm)


def _check_taken_at(text: str) -> None:
    option = OPTIONS["taken_at"]
    try:
        utc_time(text)
    except PydanticCustomError as error:
        context = error.context or {}
        raise InputError(option, "", text, context["bound"], context["remedy"]) from None
    if finer_than_a_microsecond(text):
        bound = "at most six digits behind the second"
        raise InputError(option, "", text, bound, "leave the other digits out")
