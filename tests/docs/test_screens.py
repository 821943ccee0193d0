"""The page of screens is what the program shows, and nothing on it is wider than its terminal."""

import re

import pytest

from cutgate.protocol.states import StopCause
from docs.make_screens import PAGE, STOPS, WIDTHS, page

pytestmark = pytest.mark.slow


NO_STOP = {StopCause.NONE, StopCause.NOT_ADMITTED, StopCause.SESSION_ENDED}
"""What a session does not stop for."""


def test_the_page_is_what_the_program_shows():
    assert page() == PAGE.read_text(encoding="utf-8")


def captures():
    """Width and text of each."""
    return re.findall(r"(\d+) columns:\n\n```text\n(.*?)\n```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def test_every_screen_fits_its_terminal():
    found = captures()
    assert len(found) == len(WIDTHS) * (2 + len(STOPS))
    for width, text in found:
        assert max(map(len, text.splitlines())) <= int(width)


@pytest.mark.parametrize("width", WIDTHS)
def test_there_is_a_stop_for_every_cause(width):
    screens = [" ".join(text.split()) for of_width, text in captures() if int(of_width) == width]
    shown = {cause for text in screens for cause in re.findall(r"\((\w+), while ", text)}
    assert shown == {cause.name for cause in StopCause} - {cause.name for cause in NO_STOP}
