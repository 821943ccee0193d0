"""``cutgate example``: writes the example files into a folder, to start from."""

import os
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Final

import typer

from cutgate.config.load import EXAMPLES, InputError
from cutgate.config.screen import printable
from cutgate.runtime.commands.screen import echo

SUFFIXES: Final = (".json", ".toml", ".service")
"""What is written of the examples: data, not the scripts that made them."""
README: Final = """\
cutgate: files to start from
============================

robot.toml                   the robot: limits, calibration, deadbands
site.toml                    timing, key and log folder of the site
hip-stem.plan.json           cavity of a femoral stem, 5.0 m of path
  registration-first.json    refused: the bone stands too far out and too high
  registration-second.json   admitted
femoral.plan.json            femoral component of a knee, 7.0 m
  registration-femoral.json  admitted
tibial.plan.json             tibial tray of a knee, 3.0 m
  registration-tibial.json   admitted
cutgate-run.service          one session as a unit of systemd, with priority

All commands are for this folder. Off-line, refused and admitted:

  cutgate verify hip-stem.plan.json --robot robot.toml \\
      --registration registration-first.json
  cutgate verify femoral.plan.json --robot robot.toml \\
      --registration registration-femoral.json

A session with a simulated controller takes two terminals. In the first one,
the bus only where the kernel has no vcan0:

  cutgate key new site.key
  cutgate bus serve &
  cutgate sim --robot robot.toml --key site.key --time-scale 60

In the second one:

  cutgate run tibial.plan.json --robot robot.toml \\
      --registration registration-tibial.json \\
      --site site.toml --key site.key --log-dir logs --allow-simulated

--allow-simulated says that the controller may be a simulation; leave it out
wherever there is a robot. When it says permitted, type hold in the first
terminal (the enabling device) and then start in the second one. Afterwards:

  cutgate audit show logs/*.mcap
  cutgate audit verify logs/*.mcap

Where something does not work, and before there is a robot:

  cutgate doctor --site site.toml --key site.key --log-dir logs
"""


HIL: Final = "hil"
HIL_SUFFIXES: Final = (".py", ".toml", ".txt")


def example(
    names: Annotated[
        list[str],
        typer.Argument(metavar="[hil] DIR", help="A new folder, or one that is empty; hil before it: tests."),
    ],
) -> None:
    """Write the example files into a folder, to start from: robot, site, plans, registrations, README.txt.

    With hil before the folder: a small project of tests of a controller, with hardware in the loop (docs/hil.md).
    Nothing that exists is touched. Exit code: 0 written, 2 refused.
    """
    *kind, name = names
    if kind not in ([], [HIL]):
        raise InputError(
            "[hil] DIR", "", " ".join(names), f"a folder, or {HIL} and a folder", "quote a name with spaces"
        )
    folder = Path(name)
    files = _hil_files() if kind else _start_files()
    fill(folder, "DIR", files)
    told = f"{folder}: {len(files)} files written; {folder / 'README.txt'} says how to start"
    echo(printable(told))


def _start_files() -> dict[str, bytes]:
    """What a session reads, and how to start."""
    files = {path.name: path.read_bytes() for path in sorted(EXAMPLES.iterdir()) if path.suffix in SUFFIXES}
    return files | {"README.txt": README.encode()}


def _hil_files() -> dict[str, bytes]:
    """A project of tests, its README.txt among them."""
    there = sorted((EXAMPLES / HIL).iterdir())
    return {path.name: path.read_bytes() for path in there if path.suffix in HIL_SUFFIXES}


def fill(folder: Path, option: str, files: dict[str, bytes]) -> None:
    """Makes a folder, or takes one that is empty, and writes files into it: all of them or none.

    Args:
        folder: where; a link to an empty folder is followed.
        option: what the user calls the folder, for messages.
        files: content by name. None is written over or through anything that has appeared meanwhile.

    Raises:
        InputError: no folder, not empty, or not to be written.
    """
    made = _make(folder, option)
    begun: list[Path] = []
    try:
        for name, content in files.items():
            with (folder / name).open("xb") as file:
                begun.append(folder / name)
                file.write(content)
    except BaseException as error:
        for path in begun:
            with suppress(OSError):
                path.unlink()
        if made:
            with suppress(OSError):
                folder.rmdir()
        if isinstance(error, OSError):
            left = [path.name for path in begun if os.path.lexists(path)]
            remains = (
                f"{', '.join(left)} could not be removed again" if left else "nothing of it is left there"
            )
            reason = f"cannot be written ({error.strerror})"
            raise InputError(
                folder / name, "", None, reason, f"make room or name another folder; {remains}"
            ) from None
        raise


def _make(folder: Path, option: str) -> bool:
    """Whether the folder is new; else it is there and empty."""
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        pass
    except OSError as error:
        raise InputError(
            folder, option, None, f"cannot be made ({error.strerror})", "name another folder"
        ) from None
    else:
        return True
    try:
        there = sorted(path.name for path in folder.iterdir())
    except NotADirectoryError:
        raise InputError(folder, option, "a file", "a folder, new or empty", "name another") from None
    except OSError as error:
        raise InputError(
            folder, option, None, f"cannot be read ({error.strerror})", "name another folder"
        ) from None
    if there:
        more = f" and {len(there) - 1} more" if len(there) > 1 else ""
        raise InputError(
            folder, option, f"a folder with {there[0]}{more} in it", "new or empty", "name another folder"
        )
    return False


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command("example")(example)
