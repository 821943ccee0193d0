"""What a reviewer reads of a session months later: why the permit and the start were allowed, and who was there."""

import re

import pytest
from rich.console import Console

from cutgate.config.load import InputError
from cutgate.runtime.commands.run import _name
from cutgate.runtime.interlock.permissives import FOR_PERMIT, FOR_START, evaluate
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.review.show import print_story
from cutgate.runtime.review.story import story


def told(pair):
    pair.close()
    return story(pair.read(), pair.paths.log, pair.paths.candump)


def shown(document, width):
    console = Console(width=width, no_color=True, highlight=False, markup=False)
    with console.capture() as capture:
        print_story(console, document)
    return capture.get()


@pytest.mark.parametrize("width", [80, 120])
def test_why_the_start_was_allowed_is_every_permissive_with_value_and_bound(pair, width):
    assert pair.end() is Phase.DONE
    document = told(pair)
    permit, start = document["allowed"]
    for allowed, which in ((permit, FOR_PERMIT), (start, FOR_START)):
        names = [one.name for one in evaluate(which, pair.state, pair.clock())]
        assert [entry["name"] for entry in allowed["permissives"]] == names
        for entry in allowed["permissives"]:
            assert entry["holds"] is True
            assert entry["bound"]
            assert ("value" in entry) != ("text" in entry)
    assert (permit["what"], start["what"]) == ("permit", "start")
    text = shown(document, width)
    assert max(map(len, text.partition("Time line")[0].splitlines())) <= width
    words = " ".join(text.split())
    assert "Why it was allowed permissive permit" in words
    for name in ("emergency stop", "age of the permit", "<= 0.5 mm", "enabling device"):
        assert name in words


@pytest.mark.parametrize("width", [60, 80, 120])
def test_nothing_is_cut_off_whatever_the_width_and_every_value_has_its_bounds_unit(pair, width):
    """A digit that is cut off makes another number, a phase that is cut off may be either of two."""
    pair.end()
    text = shown(told(pair), width)
    assert "…" not in text
    words = " ".join(text.split())
    assert "authorising permit" in words
    assert "authorising start" in words
    for unit in ("s", "mm", "deg"):
        assert re.search(rf"[0-9] {unit} +[0-9.]+ {unit} +<= [0-9.]+ {unit}", text)


def test_where_nothing_was_permitted_nothing_is_explained(outside):
    outside.end()
    document = told(outside)
    assert document["allowed"] == []
    assert "Why it was allowed" not in shown(document, 100)


@pytest.mark.parametrize("name", ["", " ", "a\nb", "a\x1b[2J", "x" * 65, "a\u202eb"])
def test_a_name_that_is_none_is_refused(name):
    with pytest.raises(InputError, match="1 to 64 printable characters"):
        _name(name)


@pytest.mark.parametrize("name", [None, "Dr. Müller", "x" * 64])
def test_an_operators_name_is_taken_as_it_is(name):
    assert _name(name) == name
