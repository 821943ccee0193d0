"""The locks are whole: whatever is released tomorrow, nothing is left to be resolved when they are installed."""

import importlib.metadata
import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from cutgate import __version__

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
LOCKS = {"requirements.txt": (), "requirements-dev.txt": ("pictures", "h5", "dev")}
"""Each lock and the extras that it is for."""

locks = pytest.mark.parametrize("lock", LOCKS)


def locked(lock: str) -> dict[str, Version]:
    """What this lock installs here, by canonical name."""
    entries = [
        Requirement(line.removesuffix("\\"))
        for line in (ROOT / lock).read_text(encoding="utf-8").splitlines()
        if re.match("[A-Za-z]", line)
    ]
    here = [entry for entry in entries if entry.marker is None or entry.marker.evaluate()]
    versions = {canonicalize_name(one.name): Version(str(one.specifier).removeprefix("==")) for one in here}
    assert len(versions) == len(here) > 20
    return versions


def asked_for(lock: str) -> list[Requirement]:
    """What the project itself asks for."""
    extras = PROJECT["project"]["optional-dependencies"]
    texts = [*PROJECT["project"]["dependencies"], *(text for extra in LOCKS[lock] for text in extras[extra])]
    return [Requirement(text) for text in texts]


def needs(name: str, extra: str) -> list[Requirement]:
    """What an installed package with this extra needs here."""
    found = [Requirement(text) for text in importlib.metadata.requires(name) or ()]
    return [one for one in found if one.marker is None or one.marker.evaluate({"extra": extra})]


@locks
def test_every_requirement_of_every_locked_package_is_locked_extras_included(lock):
    versions, todo, seen = locked(lock), asked_for(lock), set()
    while todo:
        one = todo.pop()
        name = canonicalize_name(one.name)
        assert name in versions, f"{lock} lacks {one}"
        assert one.specifier.contains(versions[name], prereleases=True), (
            f"{lock}: {name} {versions[name]}, {one}"
        )
        for extra in ("", *one.extras):
            if (name, extra) not in seen:
                seen.add((name, extra))
                todo += needs(name, extra)
    assert versions.keys() == {name for name, _ in seen}, "nothing is locked that nobody needs"


@locks
def test_every_package_has_one_exact_version_and_hashes_and_no_address(lock):
    text = (ROOT / lock).read_text(encoding="utf-8")
    blocks = re.split(r"\n(?=[A-Za-z])", text)
    for block in blocks:
        assert re.match(
            r"[a-z0-9-]+==[0-9a-z.]+( ; .*)? \\\n( +--hash=sha256:[0-9a-f]{64}( \\)?\n?)+$", block
        ), block
    assert "://" not in text


def test_what_builds_is_locked_too():
    (builder,) = map(Requirement, PROJECT["build-system"]["requires"])
    assert builder.specifier.contains(locked("requirements-dev.txt")[builder.name])


def test_both_locks_agree():
    everything = locked("requirements-dev.txt")
    assert locked("requirements.txt").items() <= everything.items()


def test_what_is_installed_is_what_is_locked():
    for name, version in locked("requirements-dev.txt").items():
        assert Version(importlib.metadata.version(name)) == version


def test_the_version_stands_in_one_place():
    assert PROJECT["project"]["dynamic"] == ["version"]
    assert importlib.metadata.version("cutgate") == __version__, "pip install -e . again"
