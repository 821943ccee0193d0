"""``cutgate verify --plot``: which files, drawn, and each written whole or not at all."""

from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Final

import typer

from cutgate.config.load import InputError
from cutgate.config.screen import printable
from cutgate.runtime.commands.reach_files import write_whole
from cutgate.runtime.commands.screen import echo, working
from cutgate.runtime.commands.verify_page import page
from cutgate.runtime.commands.verify_picture import picture
from cutgate.runtime.commands.verify_scene import Scene, scene
from cutgate.runtime.plan.prepare import Prepared
from cutgate.runtime.verification.advice import Guidance
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.verdict import Verdict

OPTION: Final = "--plot"
MAKERS: Final[dict[str, Callable[[Scene], bytes]]] = {
    ".html": lambda shown: page(shown).encode(),
    ".png": picture,
}
DRAWN_BY: Final = {".png": "matplotlib"}


def checked_files(files: Sequence[Path] | None) -> list[Path]:
    """Refuses what could not be written, before anything is verified.

    Raises:
        InputError: another kind of file, one twice, no such folder, or a picture that nothing here can draw.
    """
    seen: set[Path] = set()
    for file in files or ():
        kind = file.suffix.lower()
        if kind not in MAKERS:
            raise InputError(
                file, OPTION, kind or "without extension", " or ".join(MAKERS), "name another file"
            )
        if file.absolute() in seen:
            raise InputError(file, OPTION, None, "named twice", "name it once")
        seen.add(file.absolute())
        needed = DRAWN_BY.get(kind)
        if needed and not find_spec(needed):
            remedy = (
                "pip install 'cutgate[pictures]', or ask for the page, which needs none: --plot FILE.html"
            )
            raise InputError(file, OPTION, None, f"needs {needed}, not installed here", remedy)
        if not file.parent.is_dir():
            raise InputError(file.parent, OPTION, None, "no such folder", "make it, or name another")
    return list(files or ())


PlotOption = Annotated[
    list[Path] | None,
    typer.Option(
        OPTION,
        callback=checked_files,
        help="Draw path, workspace and worst places: FILE.html or FILE.png; may be given twice.",
    ),
]


def save_plots(
    files: Sequence[Path], problem: Problem, verdict: Verdict, guidance: Guidance | None, prepared: Prepared
) -> None:
    """Draws and writes the files asked for; nothing of this machine's folders is in them.

    Raises:
        InputError: one that cannot be written.
    """
    if not files:
        return
    placed = prepared.registration
    where = f"registration {placed.value.id}" if placed else "no registration (identity)"
    with working("drawing"):
        shown = scene(problem, verdict, guidance, f"{prepared.plan.value.id}, {where}")
        for file in files:
            write_whole(file, MAKERS[file.suffix.lower()](shown), OPTION)
    for file in files:
        echo(f"{printable(str(file))}: written", err=True)
