"""The page about the last whole run says what is run today, and what lives."""

from tools.mutation.forked import Verdict
from tools.mutation.modules import ROOT
from tools.mutation.mutants import OPERATORS, mutants
from tools.mutation.page import Score, about, page
from tools.mutation.run import listed

PAGE = (ROOT / "docs" / "mutation.md").read_text(encoding="utf-8")


def test_the_page_names_every_mistake_and_survivor():
    """`make mutation WRITE=docs/mutation.md` writes it anew."""
    assert [line for line in about(listed()) if line not in PAGE.splitlines()] == []
    for name in OPERATORS:
        assert f"| {name} |" in PAGE


def test_the_page_counts():
    those = mutants("def f(value):\n    return value < 1\n")
    score = Score("protocol/e2e.py", those, (Verdict.FAILED, Verdict.ALIVE))
    assert str(score) == "2 mutants, 1 killed (1 failed, 1 alive)"
    written = page([score], {("protocol/e2e.py", "f: 1 -> 2"): "because | it is"}, 60.0, 2)
    assert "| `protocol/e2e.py` | `test_e2e.py` | 2 | 1 | 1 | 0 | 0 | 1 |" in written
    assert "| all | | 2 | 1 | 1 | 0 | 0 | 1 |" in written
    assert "took 1.0 minutes with 2 processes" in written
    assert "| `protocol/e2e.py` | `f: 1 -> 2` | because \\| it is |" in written
