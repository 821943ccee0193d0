"""The page says what is recorded, what is run today, and what lives."""

from tools.mutation.forked import Verdict
from tools.mutation.modules import OWN_TESTS, ROOT
from tools.mutation.mutants import OPERATORS, mutants
from tools.mutation.page import about, page
from tools.mutation.results import Result, changed, digest_of, load, store
from tools.mutation.run import PAGE, listed, summary

MODULE = "protocol/e2e.py"
THOSE = mutants("def f(value):\n    return value < 1\n")
ENDED = [Verdict.FAILED, Verdict.ALIVE]
RESULT = Result.of(MODULE, ENDED, [mutant.kind for mutant in THOSE])


def test_the_page_names_every_mistake_and_survivor():
    """`make mutation RECORD=1` writes it anew."""
    written = PAGE.read_text(encoding="utf-8")
    assert [line for line in about(listed()) if line not in written.splitlines()] == []
    for name in OPERATORS:
        assert f"| {name} |" in written


def test_the_page_is_of_what_is_recorded_for_every_module():
    written = PAGE.read_text(encoding="utf-8")
    assert written == page(load(), listed())
    assert [module for module in OWN_TESTS if f"| `{module}` |" not in written] == []


def test_the_front_page_says_how_many_modules_they_are():
    assert f"in one of {len(OWN_TESTS)} modules that decide" in (ROOT / "README.md").read_text(
        encoding="utf-8"
    )


def test_the_page_counts():
    assert summary(ENDED) == "2 mutants, 1 killed (1 failed, 1 alive)"
    written = page({MODULE: RESULT}, {(MODULE, "f: 1 -> 2"): "because | it is"})
    assert f"| `{MODULE}` | `test_e2e.py` | 2 | 1 | 1 | 0 | 0 | 1 |" in written
    assert "| all | | 2 | 1 | 1 | 0 | 0 | 1 |" in written
    assert f"| `{MODULE}` | `f: 1 -> 2` | because \\| it is |" in written
    assert "| comparison | A comparison is flipped, or its bound goes to the other side. | 1 |" in written


def test_what_is_recorded_is_read_back(tmp_path):
    file = tmp_path / "results.json"
    assert load(file) == {}
    store({MODULE: RESULT}, file)
    assert load(file) == {MODULE: RESULT}
    assert RESULT.digest == digest_of(MODULE)


def test_a_module_is_run_again_once_it_or_its_tests_have_changed():
    whole = {module: Result(digest_of(module), {}, {}) for module in OWN_TESTS}
    assert changed(whole) == []
    assert changed({**whole, MODULE: Result("another", {}, {})}) == [MODULE]
    assert changed({module: result for module, result in whole.items() if module != MODULE}) == [MODULE]
