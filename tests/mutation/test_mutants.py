"""The mutants are the mistakes they claim to be; the survivors that are listed exist, and a few mutants are run."""

import ast
import hashlib
import subprocess
import sys

import pytest

from tools.mutation import run
from tools.mutation.forked import Verdict
from tools.mutation.modules import OWN_TESTS, ROOT
from tools.mutation.mutants import OPERATORS, mutants
from tools.mutation.run import all_mutants, complaints, listed, sample, strangers

SAMPLE = 12
MODULES = 6


def chosen() -> list[str]:
    """So many modules: the same as long as none changes, others when one does."""
    sources = {module: (ROOT / module).read_bytes() for module in OWN_TESTS}
    turn = hashlib.sha256(b"".join(sources.values())).digest()
    return sorted(OWN_TESTS, key=lambda module: hashlib.sha256(turn + module.encode()).digest())[:MODULES]


SOURCE = """
TABLE = {1: f, 2: g}
CODES = (1, 2)
def admits(self, value, state: A | None = None):
    assert value < 99
    if not state:
        return False
    self.seen += state.count
    self.last = value
    state.note(value, loud=True)
    match state.kind:
        case K.OPEN:
            return held(value)
    return 0.0 <= value < 7 and state is not None or state.calm
"""


@pytest.mark.parametrize(
    ("kind", "made"),
    [
        ("entry", "TABLE = {2: g}"),
        ("entry", "CODES = (2,)"),
        ("negation", "if not not state:"),
        ("negation", "is not None or not state.calm"),
        ("leaving", "if not state:\n        pass"),
        ("leaving", "case K.OPEN:\n            pass"),
        ("truth", "return True"),
        ("truth", "loud=False"),
        ("comparison", "return 0.0 < value < 7 and"),
        ("comparison", "return 0.0 <= value <= 7 and"),
        ("comparison", "value < 7 and state is None"),
        ("number", "return 0.0 <= value < 8 and"),
        ("connective", "(0.0 <= value < 7 or state is not None) or"),
        ("arithmetic", "self.seen -= state.count"),
        ("argument", "state.note(value)"),
        ("effect", "self.last = value\n    ..."),
        ("memory", "_ = value"),
    ],
)
def test_each_kind_of_mistake_is_made_once(kind, made):
    assert [mutant.kind for mutant in mutants(SOURCE) if made in mutant.source] == [kind]


def test_every_operator_is_tried_above():
    assert {mutant.kind for mutant in mutants(SOURCE)} == set(OPERATORS)


def test_strings_annotations_and_assertions_are_left_alone():
    for mutant in mutants(SOURCE):
        assert "state: A | None=None" in mutant.source
        assert "assert value < 99" in mutant.source


def test_no_mutant_is_the_original_and_no_two_share_a_name():
    found = mutants(SOURCE)
    assert len({mutant.name for mutant in found}) == len(found)
    assert SOURCE.strip() not in {mutant.source for mutant in found}


def test_a_mutant_compiles_and_only_its_own_statement_is_another():
    """What mutants share they do not alter: the first one is the same after all the others were made."""
    original = [ast.dump(one, include_attributes=True) for one in ast.parse(SOURCE).body]
    for mutant in mutants(SOURCE):
        compile(mutant.tree, "mutant", "exec")
        now = [ast.dump(one, include_attributes=True) for one in mutant.tree.body]
        assert sum(old != new for old, new in zip(original, now, strict=True)) == 1


def test_a_name_says_where_and_outlives_moved_lines():
    method = "class A:\n    def f(self):\n        return 1\n"
    assert [mutant.name for mutant in mutants(method)] == ["A.f: 1 -> 2"]
    assert [mutant.name for mutant in mutants("\n\n" + method)] == ["A.f: 1 -> 2"]


# ---------------------------------------------------------------- the list


@pytest.mark.slow
def test_every_listed_survivor_is_a_mutant_and_has_a_reason():
    assert not any(strangers(module, listed()) for module in OWN_TESTS)
    assert {module for module, _ in listed()} <= set(OWN_TESTS)
    assert all(len(reason) > 10 for reason in listed().values())


def test_what_is_no_mutant_must_not_be_listed():
    assert strangers("protocol/e2e.py", {("protocol/e2e.py", "crc16: 1 -> 2"): "why"}) == [
        "STALE survivor protocol/e2e.py crc16: 1 -> 2: there is no such mutant"
    ]


@pytest.mark.parametrize(
    ("verdict", "known", "said"),
    [
        (Verdict.FAILED, False, None),
        (Verdict.UNIMPORTABLE, False, None),
        (Verdict.HANGS, False, None),
        (Verdict.ALIVE, False, "NEW"),
        (Verdict.UNDECIDED, False, "NEW"),
        (Verdict.ALIVE, True, None),
        (Verdict.FAILED, True, "STALE"),
        (Verdict.HANGS, True, "STALE"),
    ],
)
def test_the_list_holds_what_lives_and_nothing_else(verdict, known, said):
    reasons = {("m.py", "f: 1 -> 2"): "why"} if known else {}
    found = complaints("m.py", {"f: 1 -> 2": verdict}, reasons)
    assert [line.split()[0] for line in found] == ([said] if said else [])


def test_every_named_module_and_test_file_is_there():
    for module, tests in OWN_TESTS.items():
        assert all((ROOT / name).is_file() for name in (module, *tests))


# ---------------------------------------------------------------- the run


@pytest.mark.slow
def test_a_sample_is_spread_and_always_the_same_until_a_module_changes(monkeypatch):
    found = {module: all_mutants(module) for module in OWN_TESTS}
    first = sample(found, 40)
    assert sum(map(len, first.values())) == 40
    assert sum(map(bool, first.values())) > 40 / 4
    assert sample(found, 40) == first
    monkeypatch.setattr(run, "_source", lambda _module: "changed")
    assert sample(found, 40) != first


@pytest.mark.slow
@pytest.mark.processes
@pytest.mark.timeout(600)
@pytest.mark.parametrize("module", chosen())
def test_a_few_mutants_of_a_few_modules_end_as_the_list_says(module):
    """The short mode; which few changes with the modules. The rest runs with make mutation."""
    words = [sys.executable, "-m", "tools.mutation.run", module, "--sample", str(SAMPLE), "--jobs", "2"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{module}: {min(SAMPLE, len(all_mutants(module)))} mutants" in done.stdout


@pytest.mark.processes
def test_figures_are_of_all_of_a_modules_mutants():
    words = [sys.executable, "-m", "tools.mutation.run", "protocol/e2e.py", "--record", "--sample", "3"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "all of a module's mutants" in done.stderr
