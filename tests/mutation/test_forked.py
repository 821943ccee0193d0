"""The short way to a verdict, the long way and a plain run of pytest agree, on a module made to be hard to mutate."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tools.mutation.modules import ROOT
from tools.mutation.mutants import mutants

pytestmark = [pytest.mark.slow, pytest.mark.processes]

SOURCE = """
from dataclasses import dataclass
from functools import cache, partial

TABLE = {1: "one", 2: "two", 3: lambda: "three"}

def admits(value):
    return 0 <= value < 3

def unguarded(value):
    return value > 7

def at_import():
    return 5 + 1

MADE = at_import()

@cache
def remembered():
    return 2 + 2

def made(by):
    return lambda value: value + by

ADD_TWO = made(2)
ADMITS = partial(admits)

def count_down(value):
    while value > 0:
        value -= 1
    return value

@dataclass(frozen=True)
class Bound:
    greatest: int = 4

    @property
    def next(self):
        return self.greatest + 1

    def __post_init__(self):
        if self.greatest < 0:
            raise ValueError("negative")
"""
TESTS = """
import pytest
import rules
from rules import ADD_TWO, ADMITS, MADE, TABLE, Bound, admits, count_down, remembered

def test_admits():
    assert [admits(value) for value in (-1, 0, 2, 3)] == [False, True, True, False]
    assert ADMITS(1)

def test_the_table():
    assert [TABLE[1], TABLE[2], TABLE[3]()] == ["one", "two", "three"]

def test_what_was_made_at_import():
    assert (MADE, ADD_TWO(5)) == (6, 7)

def test_count_down():
    assert count_down(3) == 0

def test_warms_the_cache():
    remembered()

def test_sees_what_is_remembered():
    assert remembered() == 4

@pytest.mark.parametrize("bound", [Bound(1), Bound()])
def test_bounds(bound):
    assert bound.next == bound.greatest + 1

def test_the_usual_bound():
    assert Bound().greatest == 4
    with pytest.raises(ValueError):
        Bound(-1)
"""
TRY = """
import json, sys
from pathlib import Path
from tools.mutation.forked import Trial
from tools.mutation.mutants import mutants
folder = Path(sys.argv[1])
those = mutants((folder / "rules.py").read_text())
verdicts = Trial(folder / "rules.py", folder, ("test_rules.py",), 2).verdicts(those)
print(json.dumps({one.name: verdict.name for one, verdict in zip(those, verdicts, strict=True)}))
"""


def tried(folder: Path, first: str = "") -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-c", f"import tools.mutation.forked\n{first}\n{TRY}", str(folder)]
    return subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "rules.py").write_text(SOURCE)
    (tmp_path / "test_rules.py").write_text(TESTS)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    return tmp_path


def test_every_mutant_ends_as_it_does_in_a_plain_run(folder):
    done = tried(folder)
    assert done.returncode == 0, done.stderr
    verdicts = json.loads(done.stdout)
    assert {name for name, verdict in verdicts.items() if verdict == "ALIVE"} == {
        "unguarded: value > 7 -> value >= 7",
        "unguarded: 7 -> 8",
        "Bound: dataclass(frozen=True) -> dataclass()",
        "Bound: True -> False",
        "Bound.__post_init__: self.greatest < 0 -> self.greatest <= 0",
        "Bound.__post_init__: 0 -> 1",
    }
    assert {name for name, verdict in verdicts.items() if verdict == "HANGS"} == {
        "count_down: value -= 1 -> value += 1",
    }
    bare = os.environ | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    plain = {}
    for mutant in mutants(SOURCE)[::5]:
        if verdicts[mutant.name] != "HANGS":
            (folder / "rules.py").write_text(mutant.source)
            words = [sys.executable, "-B", "-m", "pytest", "-q", "-p", "no:cacheprovider"]
            plain[mutant.name] = subprocess.run(
                words, cwd=folder, env=bare, capture_output=True, check=False
            ).returncode
    assert {name: code == 0 for name, code in plain.items()} == {
        name: verdicts[name] == "ALIVE" for name in plain
    }


@pytest.mark.parametrize(
    ("tests", "why"),
    [
        (
            "import rules\ndef test_fails():\n    assert rules.admits(3)\n",
            "its own tests fail without any mutant",
        ),
        ("import missing\n", "its own tests fail without any mutant"),
        ("import rules\n", "its own tests fail without any mutant"),
        (
            "import rules\nMET = []\ndef test_one():\n    MET.append(1)\n    assert len(MET) == 1\ntest_two = test_one\n",
            "its own tests fail without any mutant",
        ),
        (
            "import rules\nMET = []\ndef test_one():\n    MET.append(1)\ndef test_two():\n    assert MET\n",
            "fails alone",
        ),
    ],
    ids=["failing", "unimportable", "none", "together", "alone"],
)
def test_tests_that_fail_without_a_mutant_prove_nothing(folder, tests, why):
    (folder / "test_rules.py").write_text(tests)
    done = tried(folder)
    assert done.returncode == 1
    assert "UnfitError" in done.stderr
    assert why in done.stderr


@pytest.mark.parametrize("conftest", ["", "import rules\n"], ids=["by its tests", "by their conftest"])
def test_a_module_that_cannot_be_imported_is_told_from_a_failing_test(folder, conftest):
    (folder / "conftest.py").write_text(conftest)
    (folder / "rules.py").write_text("assert_me = 1\nCHECK = {1: 2}[assert_me]\ndef f():\n    return 1\n")
    (folder / "test_rules.py").write_text("import rules\ndef test_f():\n    assert rules.f() == 1\n")
    verdicts = json.loads(tried(folder).stdout)
    assert verdicts["assert_me: 1 -> 2"] == "UNIMPORTABLE"
    assert verdicts["f: 1 -> 2"] == "FAILED"


def test_a_test_that_waits_for_ever_hangs(folder):
    (folder / "rules.py").write_text("def f():\n    return 1\n")
    (folder / "test_rules.py").write_text(
        "import os, rules\ndef test_f():\n    if rules.f() == 2:\n        os.read(os.pipe()[0], 1)\n"
    )
    assert json.loads(tried(folder, "tools.mutation.forked.ASLEEP_S = 2").stdout) == {"f: 1 -> 2": "HANGS"}


def test_a_process_that_ends_by_itself_kills_no_mutant(folder):
    (folder / "rules.py").write_text("def f():\n    return 1\n")
    (folder / "test_rules.py").write_text(
        "import os, rules\ndef test_f():\n    if rules.f() == 2:\n        os._exit(9)\n"
    )
    assert json.loads(tried(folder).stdout) == {"f: 1 -> 2": "UNDECIDED"}
