"""The languages of tool path files: extensions, reader, and what a person may declare of such a file."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Final

from cutgate.config.refusal import InputError
from cutgate.runtime.plan.toolpath import gcode
from cutgate.runtime.plan.toolpath.apt import read_apt
from cutgate.runtime.plan.toolpath.csv import read_csv
from cutgate.runtime.plan.toolpath.model import PLAIN, Reader, Reading

OPTIONS: Final = {
    "cutcom_is_tool_centre": "--cutcom-is-tool-centre",
    "rotary": "--rotary",
    "arc_tolerance_mm": "--arc-tolerance-mm",
    "axis_tolerance_deg": "--axis-tolerance-deg",
}
"""What each field of `Reading` is called on the command line."""


@dataclass(frozen=True, slots=True)
class Language:
    """One language.

    Attributes:
        name: for people.
        extensions: of its files, in lower case.
        read: its reader.
        declared: the fields of `Reading` that mean anything in it.
    """

    name: str
    extensions: tuple[str, ...]
    read: Reader
    declared: frozenset[str] = frozenset()


LANGUAGES: Final = (
    Language("CSV", (".csv",), read_csv),
    Language(
        "APT/CL",
        (".apt", ".cls", ".ncl"),
        read_apt,
        declared=frozenset({"cutcom_is_tool_centre", "arc_tolerance_mm"}),
    ),
    Language("G-code", gcode.EXTENSIONS, gcode.read_gcode, gcode.DECLARED),
)

EXTENSIONS: Final = tuple(extension for language in LANGUAGES for extension in language.extensions)


def language_of(path: Path) -> Language | None:
    """The language of a file by its extension; None of a plan."""
    suffix = path.suffix.lower()
    return next((language for language in LANGUAGES if suffix in language.extensions), None)


def check_declared(path: Path, language: Language | None, reading: Reading) -> None:
    """Refuses what is declared of a file in which it means nothing: whoever says it expects an effect.

    Raises:
        InputError: names the option.
    """
    meant = language.declared if language else frozenset()
    for field in fields(Reading):
        value = getattr(reading, field.name)
        if value != getattr(PLAIN, field.name) and field.name not in meant:
            kind = language.name if language else "a plan"
            bound = f"left out: it means nothing for {kind} ({path})"
            raise InputError(OPTIONS[field.name], "", None, bound, "drop the option")
