"""A refused input in words: short, on lines of its own, whatever was found."""

import builtins

import pytest

from cutgate.config.refusal import MAX_SHOWN, FileProblem, InputError, shown


def test_a_flood_of_problems_is_cut_short_and_says_so():
    error = InputError.of([FileProblem("f", f"k{n}", "1", "2", "") for n in range(MAX_SHOWN + 3)])
    assert str(error).splitlines()[-1] == "... and 3 more"


def test_values_are_shown_on_one_short_printable_line():
    assert shown(None) == ""
    assert shown("a\nb") == "a\\nb"
    assert len(shown("x" * 1000)) == 60
    assert shown("x" * 60) == "x" * 60


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("x" * 10_000_000, "x" * 57 + "..."),
        ("\n" * 10_000_000, "\\n" * 28 + "\\..."),
        ([1.5] * 10_000_000, "[" + "1.5, " * 11 + "1..."),
        ([["y" * 10_000_000]], "[['" + "y" * 54 + "..."),
        (10**1000, "1" + "0" * 56 + "..."),
        (1 << 1_000_000, "an integer of 1000001 bits"),
        ([-(1 << 1_000_000)], "[an integer of 1000001 bits]"),
    ],
    ids=["text", "line ends", "list", "nested", "digits", "bits", "negative"],
)
def test_a_value_of_any_size_is_shown_by_its_beginning(value, text, monkeypatch):
    monkeypatch.setattr(
        builtins, "ascii", lambda found: repr(found) if len(found) == 1 else pytest.fail("whole")
    )
    assert shown(value) == text
