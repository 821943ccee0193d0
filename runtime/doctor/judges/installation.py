"""Whether the program is installed as it was tested: Python, packages, its own files, where its code comes from."""

from collections.abc import Iterable, Iterator
from typing import Final

from packaging.specifiers import InvalidSpecifier, SpecifierSet
from packaging.version import InvalidVersion, Version

from cutgate.runtime.doctor.facts import CodeSources, PackageFound, ProgramFiles, PythonVersion
from cutgate.runtime.doctor.finding import Condition, Finding, within

SHOWN: Final = 3
"""So many names of a list are told."""
INSTALL_ANEW: Final = "install cutgate anew: pip install --force-reinstall --no-deps cutgate-*.whl"


def judge_python(facts: PythonVersion, _distribution: str) -> Iterable[Finding]:
    """The interpreter is one for which the program is made."""
    holds = _contains(facts.required, facts.version)
    remedy = f"make the environment with another Python, {facts.required}"
    yield _asked("Python", facts.version, facts.required, holds, remedy)


def judge_packages(facts: tuple[PackageFound, ...], _distribution: str) -> Iterator[Finding]:
    """Each package is there, in a version that the program asks for."""
    for one in facts:
        name = f"package {one.name}"
        remedy = "install what was tested: pip install --no-deps --require-hashes -r requirements.txt"
        if one.version is None:
            yield Finding(name, Condition.FAIL, "not installed", one.required or "installed", remedy)
            continue
        holds = _contains(one.required, one.version)
        yield _asked(name, one.version, one.required or "installed", holds, remedy)


def judge_files(facts: ProgramFiles, _distribution: str) -> Iterator[Finding]:
    """The program's files can be read, and are those that were installed."""
    yield Finding(
        "program files",
        within(not facts.unreadable and facts.count > 0, Condition.FAIL),
        f"not readable: {listed(facts.unreadable)}" if facts.unreadable else f"{facts.count} readable",
        "all readable",
        "" if not facts.unreadable and facts.count else f"let this user read them, or {INSTALL_ANEW}",
    )
    bound = "as they were installed"
    if facts.altered is None:
        found = "installed from a checkout: nothing says what its files were"
        yield Finding("program unaltered", Condition.UNKNOWN, found, bound, "install the wheel (make wheel)")
        return
    found = f"altered: {listed(facts.altered)}" if facts.altered else f"{facts.count} by their SHA-256"
    state = within(not facts.altered, Condition.FAIL)
    yield Finding("program unaltered", state, found, bound, INSTALL_ANEW if facts.altered else "")


def judge_sources(facts: CodeSources, _distribution: str) -> Iterable[Finding]:
    """Code comes from the installation, and nobody else can put some there."""
    bound = "from the installation, where nobody else can write"
    if facts.foreign:
        found, remedy = (
            f"from elsewhere: {listed(facts.foreign)}",
            "remove that copy, or start another cutgate",
        )
    elif facts.open_folders:
        found = f"others may write in {listed(facts.open_folders)}"
        remedy = "install into a folder of your own or of root's, or take their right: chmod go-w"
    else:
        yield Finding("code", Condition.OK, f"from {facts.root}", bound)
        return
    yield Finding("code", Condition.FAIL, found, bound, remedy)


def listed(names: tuple[str, ...]) -> str:
    """The first of them, and how many more."""
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return f"{', '.join(names[:SHOWN])}{more}"


def _asked(name: str, found: str, bound: str, holds: bool | None, remedy: str) -> Finding:
    if holds is None:
        return Finding(name, Condition.UNKNOWN, f"{found}, which is no version", bound, remedy)
    return Finding(name, within(holds, Condition.FAIL), found, bound, "" if holds else remedy)


def _contains(required: str, version: str) -> bool | None:
    """Whether the version is among those asked for; None where one of the two means nothing."""
    try:
        return SpecifierSet(required).contains(Version(version), prereleases=True)
    except (InvalidSpecifier, InvalidVersion):
        return None
