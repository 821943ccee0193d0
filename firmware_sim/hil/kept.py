"""What is kept of a test that failed: logs, frames, what the programs said, and pages that show why; never a key."""

import errno
import os
import re
import shutil
import subprocess
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Final

from cutgate.config.interpreter import program
from cutgate.config.screen import printable

REPORT_S: Final = 60.0
NAME_MAX: Final = 150
COPIES_MAX: Final = 1000
KEPT: Final = (".mcap", ".log", ".sig", ".html", ".txt", ".json")
"""What is copied of a failed test, never a key."""


def artefacts(folder: Path, logs: Iterable[Path], directory: Path | None, name: str) -> list[str]:
    """Report pages beside the logs, a copy of everything but keys where a directory is named; a line for each file.

    Args:
        folder: of the test.
        logs: in folders of their own in it.
        directory: of all artefacts; None leaves them in the test's own folder.
        name: of the test.
    """
    lines = []
    for log in logs:
        trouble = _report(log, folder / f"{log.parent.name}-report.html")
        lines += [f"no report page: {trouble}"] if trouble else []
    place = folder
    if directory is not None:
        try:
            place = _new_folder(directory, re.sub(r"[^A-Za-z0-9_.-]+", "_", name)[-NAME_MAX:])
            _copy(folder, place)
        except OSError as error:  # the failure of the test is what counts, and all of it lies here
            lines.append(f"not copied to {printable(str(directory))}: {error.strerror}")
            place = folder
    kept = sorted(path for path in place.rglob("*") if path.suffix in KEPT and path.is_file())
    return [*lines, *(printable(str(path)) for path in kept)]


def _report(log: Path, page: Path) -> str:
    """Write the page that shows why; why not, where it cannot be written."""
    command = program("cutgate.runtime.cli", "audit", "report", str(log), "-o", str(page))
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=REPORT_S)  # noqa: S603
    except subprocess.TimeoutExpired:
        return f"not written within {REPORT_S:g} s"
    return "" if page.exists() else printable(done.stderr[-500:])


def _new_folder(directory: Path, name: str) -> Path:
    """A folder of this name, or with the first free number behind it: what an earlier run has left stays."""
    directory.mkdir(parents=True, exist_ok=True)
    for number in range(1, COPIES_MAX + 1):
        place = directory / (name if number == 1 else f"{name}-{number}")
        with suppress(FileExistsError):
            place.mkdir()
            return place
    raise OSError(errno.EEXIST, f"{COPIES_MAX} copies of this test lie there, remove them")


def _copy(folder: Path, place: Path) -> None:
    """Everything that is kept; links are not followed."""
    for directory, _folders, names in os.walk(folder):
        for name in names:
            source = Path(directory) / name
            if source.suffix in KEPT and source.is_file() and not source.is_symlink():
                target = place / source.relative_to(folder)
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(source, target)
