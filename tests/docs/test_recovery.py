"""The page of what comes back of a log that was cut is made by its script, current, and claims no more than there is."""

import re

import pytest

from docs.make_recovery import PAGE, READERS, page


@pytest.mark.slow
def test_the_page_is_the_scripts():
    assert page() == PAGE.read_text(encoding="utf-8"), "run: python -m docs.make_recovery"


def test_of_what_is_cut_off_everything_whole_comes_back():
    text = PAGE.read_text(encoding="utf-8").split("## With")[0]
    rows = re.findall(r"^\| ([^|]+) \| (\d+) \| (\d+) \| (\d+) \((\d+)\) \|", text, re.MULTILINE)
    assert len(rows) == 6
    for row, cuts, whole, back, cuts_whole in rows:
        assert (whole, cuts) == (back, cuts_whole), row
    assert int(rows[-1][1]) > 700


def test_every_reader_has_its_column():
    assert all(f"| {name} " in PAGE.read_text(encoding="utf-8") for name in READERS)
