"""Where our processes take code from: the installation and the standard library, never the place they are started in.

Whoever owns the working directory, or a folder that PYTHONPATH names, would else own the program: a folder
``multiprocessing`` beside a plan on a stick has been run in place of the library's.
"""

import os
import sys


def own_code_only() -> None:
    """From now on, for this process and all that it starts: the first act of every entry point.

    Only what Python itself loads before our first line is out of reach.
    """
    named = os.environ.pop("PYTHONPATH", "")
    foreign = {_absolute(folder) for folder in named.split(os.pathsep)} if named else set()
    os.environ["PYTHONSAFEPATH"] = "1"  # children that a library starts
    first = 0 if sys.flags.safe_path else 1  # else the script's folder, or with -m the working directory
    sys.path[:] = [folder for folder in sys.path[first:] if _absolute(folder) not in foreign]


def _absolute(folder: str) -> str:
    return os.path.abspath(folder)  # noqa: PTH100 - pathlib would be imported before it is known where from


def program(module: str, *arguments: str) -> list[str]:
    """The command that runs one of our modules in a fresh interpreter, wherever and by whomever it is started."""
    return [sys.executable, "-E", "-P", "-m", module, *arguments]
