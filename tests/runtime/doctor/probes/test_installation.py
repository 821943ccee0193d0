"""The installation that is there, and made-up ones."""

import base64
import hashlib
import os
import sys
from importlib import metadata
from types import SimpleNamespace

import pytest
from packaging.version import Version

from cutgate.runtime.doctor.facts import Unknown
from cutgate.runtime.doctor.probes import installation
from cutgate.runtime.doctor.probes.installation import (
    PROGRAM,
    code_sources,
    held_against,
    packages,
    program_files,
    python_version,
    readable,
    sources_of,
)

ABSENT = "cutgate-that-nobody-has"


def recorded(data):
    return base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()


def test_the_interpreter_that_runs_is_the_one_told():
    facts = python_version("cutgate")
    assert Version(facts.version).release[:3] == sys.version_info[:3]
    assert facts.required == ">=3.11"


def test_packages_are_those_of_the_metadata_without_extras():
    found = {one.name: one for one in packages("cutgate")}
    assert {"numpy", "python-can", "packaging"} <= set(found)
    assert "matplotlib" not in found
    assert "pytest" not in found
    assert found["numpy"].version == metadata.version("numpy")
    assert found["python-can"].required == "==4.6.1"


def test_a_package_that_is_asked_for_and_not_there_has_no_version(monkeypatch):
    monkeypatch.setattr(
        installation.metadata, "requires", lambda _: [f"{ABSENT}>=1", 'numpy; sys_platform == "none"']
    )
    (found,) = packages("cutgate")
    assert (found.name, found.required, found.version) == (ABSENT, ">=1", None)


@pytest.mark.parametrize("probe", [python_version, packages, program_files])
def test_a_program_that_is_not_installed_is_unknown(probe):
    facts = probe(ABSENT)
    assert isinstance(facts, Unknown)
    assert "pip install" in facts.remedy


def test_metadata_that_mean_nothing_are_unknown(monkeypatch):
    monkeypatch.setattr(installation.metadata, "requires", lambda _: ["=="])
    assert isinstance(packages("cutgate"), Unknown)


def test_a_checkout_is_readable_and_nothing_says_what_it_was():
    facts = program_files("cutgate")
    assert facts.count > 200
    assert facts.unreadable == ()
    assert facts.altered is None or facts.altered == ()


def test_the_record_of_a_wheel_is_what_files_are_held_against(monkeypatch):
    file = PROGRAM / "__init__.py"

    def entry(name, digest, mode="sha256"):
        place = PROGRAM.parent / name
        hashed = None if digest is None else SimpleNamespace(mode=mode, value=digest)
        return SimpleNamespace(
            parts=place.relative_to(PROGRAM.parent).parts, hash=hashed, locate=lambda: place
        )

    entries = [
        entry("cutgate/__init__.py", recorded(file.read_bytes())),
        entry("cutgate/py.typed", recorded(b"other")),
        entry("cutgate/gone.py", recorded(b"")),
        entry("cutgate/__pycache__/a.pyc", None),
        entry("elsewhere/a.py", recorded(b"")),
    ]
    monkeypatch.setattr(installation.metadata, "files", lambda _: entries)
    facts = program_files("cutgate")
    assert facts.count == 3
    assert facts.unreadable == (str(PROGRAM / "gone.py"),)
    assert facts.altered == (str(PROGRAM / "py.typed"),)


def test_one_byte_more_is_an_altered_file(tmp_path):
    (tmp_path / "a").write_bytes(b"content")
    assert held_against({tmp_path / "a": recorded(b"content")}).altered == ()
    (tmp_path / "a").write_bytes(b"content\n")
    assert held_against({tmp_path / "a": recorded(b"content")}).altered == (str(tmp_path / "a"),)


def test_what_is_no_file_is_not_readable_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    (tmp_path / "file").touch()
    facts = readable(sorted(tmp_path.iterdir()))
    assert facts.count == 4
    assert facts.unreadable == tuple(str(tmp_path / name) for name in ("folder", "link", "pipe"))


def test_a_file_that_no_program_has_is_not_read(tmp_path):
    with (tmp_path / "huge").open("wb") as file:
        file.truncate(installation.FILE_MAX + 1)
    assert readable([tmp_path / "huge"]).unreadable == (str(tmp_path / "huge"),)


def test_our_own_modules_come_from_the_program():
    assert code_sources("cutgate").foreign == ()
    assert code_sources("cutgate").root == str(PROGRAM)


def test_a_module_from_elsewhere_is_named(tmp_path):
    modules = {
        "cutgate": SimpleNamespace(__file__=str(tmp_path / "cutgate" / "__init__.py")),
        "cutgate.config": SimpleNamespace(__file__="/elsewhere/cutgate/config/__init__.py"),
        "cutgatekeeper": SimpleNamespace(__file__="/elsewhere/cutgatekeeper.py"),
        "cutgate.nothing": None,
        "sys": SimpleNamespace(),
    }
    facts = sources_of(modules, [], tmp_path / "cutgate")
    assert facts.foreign == ("cutgate.config (/elsewhere/cutgate/config/__init__.py)",)


@pytest.mark.parametrize(
    ("mode", "open_to_others"), [(0o755, False), (0o775, False), (0o777, True), (0o1777, False)]
)
def test_a_folder_in_which_others_may_put_modules_is_named(tmp_path, mode, open_to_others):
    folder = tmp_path / "lib"
    folder.mkdir()
    folder.chmod(mode)
    facts = sources_of({}, [str(folder), "", "/nowhere/at/all", "\0"], tmp_path / "absent")
    assert facts.open_folders == ((str(folder),) if open_to_others else ())


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to give a folder away")
def test_a_folder_of_somebody_else_is_named(tmp_path):
    folder = tmp_path / "lib"
    folder.mkdir()
    os.chown(folder, 12345, 12345)
    assert sources_of({}, [str(folder)], folder).open_folders == (str(folder),)
