"""Each fault of an installation is found, with its remedy."""

import pytest

from cutgate.runtime.doctor.facts import CodeSources, PackageFound, ProgramFiles, PythonVersion
from cutgate.runtime.doctor.finding import Condition
from cutgate.runtime.doctor.judges.installation import (
    judge_files,
    judge_packages,
    judge_python,
    judge_sources,
    listed,
)


@pytest.mark.parametrize(
    ("version", "required", "state"),
    [
        ("3.11.0", ">=3.11", Condition.OK),
        ("3.14.0rc1", ">=3.11", Condition.OK),
        ("3.10.9", ">=3.11", Condition.FAIL),
        ("3.9", ">=3.11,<4", Condition.FAIL),
        ("3.11+", ">=3.11", Condition.UNKNOWN),
        ("3.11", "three", Condition.UNKNOWN),
    ],
)
def test_the_interpreter(version, required, state):
    (found,) = judge_python(PythonVersion(version, required), "cutgate")
    assert found.state is state
    assert bool(found.remedy) is (state is not Condition.OK)


@pytest.mark.parametrize(
    ("required", "version", "state"),
    [
        ("==4.6.1", "4.6.1", Condition.OK),
        ("==4.6.1", "4.6.2", Condition.FAIL),
        (">=2.2", "2.10", Condition.OK),  # numbers, not text
        (">=2.10", "2.2", Condition.FAIL),
        (">=2.2", "2.2rc1", Condition.FAIL),
        (">=2.2", "2.3rc1", Condition.OK),  # pip has been told to install it
        (">=2.2", None, Condition.FAIL),
        ("", "1", Condition.OK),
        (">=2.2", "of today", Condition.UNKNOWN),
    ],
)
def test_a_package(required, version, state):
    (found,) = judge_packages((PackageFound("numpy", required, version),), "cutgate")
    assert (found.name, found.state) == ("package numpy", state)
    assert ("requirements.txt" in found.remedy) is (state is not Condition.OK)
    assert found.bound


def test_a_package_is_told_with_what_is_asked_of_it():
    facts = (PackageFound("a", ">=1", "2"), PackageFound("b", "", "2"), PackageFound("c", "", None))
    assert [(one.found, one.bound) for one in judge_packages(facts, "cutgate")] == [
        ("2", ">=1"),
        ("2", "installed"),
        ("not installed", "installed"),
    ]


def test_every_package_has_its_line():
    facts = tuple(
        PackageFound(name, ">=1", version) for name, version in {"a": "1", "b": None, "c": "0.1"}.items()
    )
    assert [one.state for one in judge_packages(facts, "cutgate")] == [
        Condition.OK,
        Condition.FAIL,
        Condition.FAIL,
    ]


@pytest.mark.parametrize(
    ("facts", "states"),
    [
        (ProgramFiles(9, (), ()), (Condition.OK, Condition.OK)),
        (ProgramFiles(1, (), ()), (Condition.OK, Condition.OK)),
        (ProgramFiles(9, ("a",), ()), (Condition.FAIL, Condition.OK)),
        (ProgramFiles(9, (), ("a",)), (Condition.OK, Condition.FAIL)),
        (ProgramFiles(9, (), None), (Condition.OK, Condition.UNKNOWN)),
        (ProgramFiles(0, (), None), (Condition.FAIL, Condition.UNKNOWN)),
    ],
)
def test_its_files(facts, states):
    found = tuple(judge_files(facts, "cutgate"))
    assert tuple(one.state for one in found) == states
    assert all(bool(one.remedy) is (one.state is not Condition.OK) for one in found)


def test_its_files_are_told():
    def told(*facts):
        return [one.found for one in judge_files(ProgramFiles(*facts), "cutgate")]

    assert told(1, (), ()) == ["1 readable", "1 by their SHA-256"]
    assert told(9, ("a",), ("b",)) == ["not readable: a", "altered: b"]


def test_where_its_code_comes_from():
    def judged(foreign=(), folders=()):
        (found,) = judge_sources(CodeSources("/opt/cutgate", foreign, folders), "cutgate")
        return found

    assert judged().state is Condition.OK
    assert judged(foreign=("cutgate.config (elsewhere/config.py)",)).state is Condition.FAIL
    assert "elsewhere/config.py" in judged(foreign=("cutgate.config (elsewhere/config.py)",)).found
    assert judged(folders=("elsewhere/lib",)).state is Condition.FAIL
    assert "chmod go-w" in judged(folders=("elsewhere/lib",)).remedy


def test_a_long_list_is_told_by_its_beginning():
    assert listed(("a", "b", "c")) == "a, b, c"
    assert listed(tuple("abcde")) == "a, b, c and 2 more"
