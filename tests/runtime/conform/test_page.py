"""The tables of docs/controllers.md that come from the program."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

from cutgate.runtime.conform.table import cases

DOCS = Path(__file__).parents[3] / "docs"


@pytest.fixture(scope="module")
def make_session() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_session", DOCS / "make_session.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_session_and_the_bus_load_on_the_page_are_what_the_program_does_now(
    make_session: ModuleType,
) -> None:
    text = (DOCS / "controllers.md").read_text(encoding="utf-8")
    assert make_session.page(text) == text, "run: python docs/make_session.py"


def test_the_session_tells_every_step_of_the_conversation(make_session: ModuleType) -> None:
    table = make_session.session()
    steps = ("Announce", "Open", "Opened", "Collect", "Limits", "PathBlock", "PathStored", "Permit", "Start")
    places = [table.index(f"**{step}") for step in steps]
    assert places == sorted(places)
    assert "DEVICE_NOT_RELEASED_AND_PRESSED" in table


def test_a_frame_of_eight_bytes_takes_111_bits_and_at_most_135(make_session: ModuleType) -> None:
    assert make_session.frame_bits(8) == (111, 135)


def test_every_case_that_the_page_names_is_there() -> None:
    names = {case.name for case in cases()}
    text = (DOCS / "controllers.md").read_text(encoding="utf-8")
    named = [part.split('"')[1] for part in text.split("--only")[1:] if part.startswith(' "')]
    assert len(named) == 4
    assert set(named) <= names
