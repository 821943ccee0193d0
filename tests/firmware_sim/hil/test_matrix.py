"""The fault matrix says what was tried, and nothing in it is markup."""

from html.parser import HTMLParser

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.firmware_sim.hil.matrix import SUFFIXES, MatrixRow, page

ROWS = [
    MatrixRow(
        "b.py::test", ("lose any", "hang@cutting"), "stopped HEARTBEAT_LOST", ("HEARTBEAT_LOST",), "failed"
    ),
    MatrixRow("a.py::test", ("lose any",), "completed", (), "passed"),
]


class Cells(HTMLParser):
    """The text of each cell, row by row, and every element there is."""

    def __init__(self, text):
        super().__init__()
        self.rows, self.elements, self._cell = [], set(), False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.elements.add(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in {"td", "th"}:
            self.rows[-1].append("")
            self._cell = True

    def handle_endtag(self, tag):
        self._cell = self._cell and tag not in {"td", "th"}

    def handle_data(self, data):
        if self._cell:
            self.rows[-1][-1] += data


def test_each_test_is_a_row_in_order_with_its_faults_and_its_end():
    heads, first, second = Cells(page(ROWS, ".html")).rows
    assert heads == ["test", "faults", "how it ended", "health", "outcome"]
    assert first == ["a.py::test", "lose any", "completed", "", "passed"]
    assert second == [
        "b.py::test",
        "lose anyhang@cutting",
        "stopped HEARTBEAT_LOST",
        "HEARTBEAT_LOST",
        "failed",
    ]
    markdown = page(ROWS, ".md").splitlines()
    assert markdown[-2] == "| a.py::test | lose any | completed |  | passed |"
    assert (
        markdown[-1]
        == r"| b.py::test | lose any, hang@cutting | stopped HEARTBEAT\_LOST | HEARTBEAT\_LOST | failed |"
    )


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_it_counts(suffix):
    assert "2 tests with sessions, 2 different faults, 1 tests failed." in page(ROWS, suffix)
    assert "0 tests with sessions" in page([], suffix)


ELEMENTS = Cells(page(ROWS, ".html")).elements
TEXT = st.text() | st.sampled_from(["<script>", "|", "\x1b[31m", "](x)", "</td>", "\n# x", "{0}"])


@given(st.builds(MatrixRow, TEXT, st.tuples(TEXT), TEXT, st.tuples(TEXT), TEXT))
def test_what_is_shown_is_data(row):
    html, markdown = page([row], ".html"), page([row], ".md")
    read = Cells(html)
    assert read.elements <= ELEMENTS
    assert [len(cells) for cells in read.rows] == [5, 5]
    assert all(one.isprintable() for one in html.splitlines()[-3])
    *_, line = markdown.split("\n")[:-1]
    assert line.isprintable()
    assert line.replace("\\\\", "").replace("\\|", "").count("|") == 6


def test_a_row_survives_its_way_from_a_worker():
    row = ROWS[0].as_dict()
    assert MatrixRow(**{**row, "faults": tuple(row["faults"]), "health": tuple(row["health"])}) == ROWS[0]
