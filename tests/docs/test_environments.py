"""What the page of surroundings says is so: some commands are tried again in all of them, the rest by the script."""

import re
import signal

import pytest

from docs.make_environments import (
    ENDINGS,
    LASTING,
    PAGE,
    SURROUNDINGS,
    UNREAD,
    a_bus,
    ended,
    made,
    one_shot,
    tried,
    wrong,
)

pytestmark = [pytest.mark.slow, pytest.mark.processes]

AGAIN = ("--help", "verify --json", "key new", "audit show")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    made(folder)
    return folder


@pytest.mark.parametrize("where", SURROUNDINGS, ids=lambda where: where.name)
def test_a_command_gives_the_code_of_the_page_in_every_surrounding(files, where):
    commands = one_shot(files)
    for name in AGAIN:
        arguments, ordinary = commands[name]
        expected = ordinary if name in UNREAD else where.code(ordinary)
        seen = tried(arguments, where)
        assert not wrong(seen, expected, where), (name, seen)


@pytest.mark.parametrize("where", SURROUNDINGS, ids=lambda where: where.name)
def test_a_hub_serves_in_every_surrounding_and_ends_when_it_is_told_to(where):
    what = LASTING["bus serve"]
    seen = ended(what, signal.SIGTERM, {}, where)
    assert not wrong(seen, what.code, where), seen


@pytest.mark.parametrize("number", ENDINGS[:3], ids=lambda number: number.name)
def test_a_program_that_goes_on_ends_in_order(tmp_path_factory, number):
    with a_bus(tmp_path_factory.mktemp("bus")) as places:
        for name, what in LASTING.items():
            seen = ended(what, number, places)
            assert not wrong(seen, what.code, SURROUNDINGS[0]), (name, seen)


def test_the_page_has_every_surrounding_command_and_signal_and_nothing_wrong(files):
    text = PAGE.read_text(encoding="utf-8")
    assert "WRONG" not in text
    rows = set(re.findall(r"^\| ([^|]*) \|", text, re.MULTILINE))
    assert {where.name for where in SURROUNDINGS} <= rows
    assert {number.name for number in ENDINGS} <= rows
    for name in (*one_shot(files), *LASTING):
        assert f"`{name}`" in text
