"""The interpreter, the packages that are asked for, and the program's own files. Needs nothing but ``packaging``."""

import base64
import hashlib
import os
import platform
import stat
import sys
from collections.abc import Iterable, Iterator, Mapping
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Final

from packaging.requirements import InvalidRequirement, Requirement

from cutgate.runtime.doctor.facts import CodeSources, PackageFound, ProgramFiles, PythonVersion, Unknown

FILES_MAX: Final = 10_000
FILE_MAX: Final = 16_000_000
"""Bytes: far more than any file of the program has."""
PROGRAM: Final = Path(__file__).parents[3]
"""Folder of the package."""
_HASH: Final = "sha256"
_NOT_INSTALLED: Final = Unknown(
    "cutgate is not installed: nothing says what it asks for", "install it: pip install cutgate-*.whl"
)


def python_version(distribution: str) -> PythonVersion | Unknown:
    """The running interpreter, and what the program's metadata asks for."""
    try:
        required = metadata.metadata(distribution)["Requires-Python"] or ""
    except metadata.PackageNotFoundError:
        return _NOT_INSTALLED
    return PythonVersion(
        platform.python_version().rstrip("+"), required
    )  # built from sources after that version


def packages(distribution: str) -> tuple[PackageFound, ...] | Unknown:
    """Each package that the program's metadata asks for here, those of extras left out."""
    try:
        asked = [Requirement(text) for text in metadata.requires(distribution) or ()]
    except metadata.PackageNotFoundError:
        return _NOT_INSTALLED
    except InvalidRequirement as error:
        return Unknown(f"what cutgate asks for is not readable: {error}", "install it anew")
    here = (one for one in asked if one.marker is None or one.marker.evaluate({"extra": ""}))
    return tuple(PackageFound(one.name, str(one.specifier), _version(one.name)) for one in here)


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def program_files(distribution: str) -> ProgramFiles | Unknown:
    """All files that were installed, held against the hashes of that time; of a checkout those that are there."""
    try:
        entries = metadata.files(distribution) or ()
    except metadata.PackageNotFoundError:
        return _NOT_INSTALLED
    installed = {
        Path(str(entry.locate())): entry.hash.value
        for entry in entries
        if entry.parts[0] == PROGRAM.name and entry.hash is not None and entry.hash.mode == _HASH
    }
    return held_against(installed) if installed else readable(_files(PROGRAM))


def held_against(installed: Mapping[Path, str]) -> ProgramFiles:
    """Files and what their SHA-256 must be, base64 as RECORD of a wheel has it."""
    unreadable, altered = [], []
    for file, expected in list(installed.items())[:FILES_MAX]:
        data = _content(file)
        if data is None:
            unreadable.append(str(file))
        elif base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode() != expected:
            altered.append(str(file))
    return ProgramFiles(len(installed), tuple(unreadable), tuple(altered))


def readable(files: Iterable[Path]) -> ProgramFiles:
    """Files of which nothing says what they were."""
    found = [(file, _content(file) is not None) for file in files]
    return ProgramFiles(len(found), tuple(str(file) for file, read in found if not read), None)


def _files(folder: Path) -> Iterator[Path]:
    """All files under the folder, also where links lead to; at most so many."""
    count = 0
    for place, folders, names in os.walk(folder, followlinks=True):
        folders[:] = sorted(one for one in folders if one != "__pycache__" and not one.startswith("."))
        for name in sorted(names):
            count += 1
            if count > FILES_MAX:
                return
            yield Path(place, name)


def _content(file: Path) -> bytes | None:
    """All of a regular file; None if it cannot be read. A pipe is not waited for."""
    try:
        descriptor = os.open(file, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        status = os.fstat(descriptor)
        if not (stat.S_ISREG(status.st_mode) and status.st_size <= FILE_MAX):
            return None
        with os.fdopen(descriptor, "rb", closefd=False) as opened:
            return opened.read(status.st_size)
    except OSError:
        return None
    finally:
        os.close(descriptor)


def code_sources(_distribution: str) -> CodeSources:
    """Where the modules that are loaded came from, and who may put others there."""
    return sources_of(dict(sys.modules), sys.path, PROGRAM)


def sources_of(
    modules: Mapping[str, ModuleType | None], search_path: Iterable[str], root: Path
) -> CodeSources:
    """Of these modules and this search path, for a program in ``root``."""
    foreign = []
    for name, module in sorted(modules.items()):
        file = getattr(module, "__file__", None)
        ours = name.partition(".")[0] == root.name
        if ours and file is not None and not Path(file).is_relative_to(root):
            foreign.append(f"{name} ({file})")
    folders = dict.fromkeys([*(one for one in search_path if one), str(root)])
    return CodeSources(str(root), tuple(foreign), tuple(one for one in folders if _open_to_others(one)))


def _open_to_others(folder: str) -> bool:
    """Somebody else but root may put a module there; what is not there is nobody's."""
    try:
        status = os.stat(folder)  # noqa: PTH116 - also of what is no path
    except (OSError, ValueError):
        return False
    theirs = status.st_uid not in (0, os.geteuid())
    return theirs or bool(status.st_mode & stat.S_IWOTH and not status.st_mode & stat.S_ISVTX)
