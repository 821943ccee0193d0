"""The files of ``cutgate reach``: which ones, drawn, and written whole or not at all."""

import csv
import io
import os
from collections.abc import Callable
from dataclasses import astuple
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from cutgate.config.load import InputError
from cutgate.runtime.commands.reach_page import page
from cutgate.runtime.commands.reach_picture import picture
from cutgate.runtime.verification.placing import reach
from cutgate.runtime.verification.placing.reach import Position, Surveyed
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.report.document import document_text

KINDS: Final = (".png", ".html", ".csv", ".json")
DRAWN_BY: Final = {".png": "matplotlib"}
"""Not installed with cutgate alone: nobody draws beside a controller. The page draws itself."""


def files_for(out: Path | None, *, json: bool) -> dict[str, Path]:
    """What to write where, by kind: one file, a folder of all four, or nothing.

    Raises:
        InputError: a folder that cannot be made, or a picture that nothing here can draw.
    """
    if out is None:
        if json:
            return {}
        out = Path("cutgate-reach")
    if out.suffix.lower() in KINDS:
        folder, files = out.parent, {out.suffix.lower(): out}
    else:
        folder, files = out, {kind: out / f"reach{kind}" for kind in KINDS}
    if missing := sorted(DRAWN_BY[kind] for kind in DRAWN_BY.keys() & files if not find_spec(DRAWN_BY[kind])):
        raise InputError(
            out,
            "--out",
            None,
            f"needs {' and '.join(missing)}, not installed here",
            "pip install 'cutgate[pictures]', or ask for what needs none: --out FILE.html, FILE.csv or FILE.json, or --json",
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            folder, "--out", None, f"cannot be made ({error.strerror})", "name another"
        ) from None
    return files


def write_whole(path: Path, content: bytes, option: str = "--out") -> None:
    """Writes a whole file or none: beside it first, then into its place.

    Raises:
        InputError: it cannot be written; names the option that asked for it.
    """
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        beside.write_bytes(content)
        beside.replace(path)
    except OSError as error:
        raise InputError(
            path, option, None, f"cannot be written ({error.strerror})", "name another"
        ) from None
    finally:
        beside.unlink(missing_ok=True)


def table(positions: list[Position]) -> str:
    """All positions as CSV; undefined values are empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(reach.COLUMNS)
    writer.writerows(
        ("" if v is None else int(v) if isinstance(v, bool) else v for v in astuple(p)) for p in positions
    )
    return text.getvalue()


def save(files: dict[str, Path], problem: Problem, document: dict[str, Any], found: Surveyed) -> None:
    """Writes the files asked for."""
    arcs = list(reach.outline(problem))
    makers: dict[str, Callable[[], bytes]] = {
        ".png": lambda: picture(document, found, arcs),
        ".html": lambda: page(document, found, arcs).encode(),
        ".csv": lambda: table(found.positions).encode(),
        ".json": (document_text(document) + "\n").encode,
    }
    for kind, path in files.items():
        write_whole(path, makers[kind]())
