"""The page of screens is what the program shows, and nothing on it is wider than its terminal."""

import re

import pytest

from docs.make_screens import PAGE, STOPS, WIDTHS, page

pytestmark = pytest.mark.slow


def test_the_page_is_what_the_program_shows():
    assert page() == PAGE.read_text(encoding="utf-8")


def test_every_screen_fits_its_terminal():
    found = re.findall(r"(\d+) columns:\n\n```text\n(.*?)\n```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(found) == len(WIDTHS) * (2 + len(STOPS))
    for width, text in found:
        assert max(map(len, text.splitlines())) <= int(width)
