"""The mutants are the mistakes they claim to be; the survivors that are listed exist, and a few mutants are run."""

import subprocess
import sys

import pytest

from mutation.modules import OWN_TESTS, ROOT
from mutation.mutants import mutants
from mutation.run import listed

SOURCE = """
TABLE = {1: f, 2: g}
def admits(value, state):
    if not state:
        return False
    return 0.0 <= value < 7 and state is not None
"""


@pytest.mark.parametrize(
    "made",
    [
        "TABLE = {2: g}",
        "if not not state:",
        "pass",
        "return True",
        "return 0.0 < value < 7 and",
        "return 0.0 <= value <= 7 and",
        "return 0.0 <= value < 8 and",
        "value < 7 and state is None",
        "value < 7 or state is not None",
    ],
)
def test_each_kind_of_mistake_is_made_once(made):
    assert sum(made in mutant.source for mutant in mutants(SOURCE)) == 1


def test_no_mutant_is_the_original_and_no_two_share_a_name():
    found = mutants(SOURCE)
    assert len({mutant.name for mutant in found}) == len(found)
    assert SOURCE.strip() not in {mutant.source for mutant in found}


def test_every_listed_survivor_is_a_mutant_and_has_a_reason():
    for module in {module for module, _ in listed()}:
        names = {mutant.name for mutant in mutants((ROOT / module).read_text(encoding="utf-8"))}
        assert {name for other, name in listed() if other == module} <= names
    assert all(len(reason) > 10 for reason in listed().values())


def test_every_named_module_and_test_file_is_there():
    for module, tests in OWN_TESTS.items():
        assert all((ROOT / name).is_file() for name in (module, *tests))


def test_a_few_mutants_of_the_end_to_end_check_are_killed():
    """The short mode: the rest runs with make mutation."""
    words = [sys.executable, "-m", "mutation.run", "protocol/e2e.py", "--sample", "3"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=110, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "3 mutants, 3 killed" in done.stdout
