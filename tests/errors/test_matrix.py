"""Each row of the error matrix, played with both real loops: what is stated happens, in time, and is in the log."""

import re
from collections import Counter
from itertools import product

import pytest

from cutgate.protocol.frames import FRAMES
from cutgate.protocol.records import RECORDS
from cutgate.runtime.audit.inspect import Status
from docs.make_error_matrix import PAGE, page
from tests.errors.matrix import FOUND, GOES_ON, MESSAGES, NO_ROW, ROWS, End, Error

pytestmark = pytest.mark.no_cover  # whole sessions, one an error: measured they take three times as long

SLACK_S = 1e-6


@pytest.fixture(params=ROWS, ids=lambda row: row.name)
def row(request):
    return request.param


def test_the_outcome_is_the_stated_one(row, played):
    seen = played(row)
    if row.end == GOES_ON:
        assert seen.goes_on, (seen.phase, seen.causes)
        assert seen.logged == {"OPERATOR_STOP"}, "the error itself is no cause"
    else:
        assert End(seen.phase.value, seen.state.name, *seen.causes) == row.end
        assert seen.stands, "the arm moved"
        assert 0.0 <= seen.latency_s <= row.bound.seconds + SLACK_S
        assert seen.logged == {row.end.runtime.name}, "one first-out cause"
    assert re.search(FOUND[row.found_by], seen.evidence), seen.evidence
    assert seen.log is Status.OK


def test_every_frame_of_the_dbc_and_every_record_is_a_message_of_the_matrix():
    assert {message.kind for message in MESSAGES} == {*FRAMES.values(), *RECORDS.values()}


def test_every_message_has_for_every_error_a_row_within_and_beyond_or_a_reason_and_never_both():
    rows = Counter((row.message.name, row.error, row.tolerated) for row in ROWS)
    reasons = Counter(
        (message.name, error, tolerated) for messages, error, tolerated, _ in NO_ROW for message in messages
    )
    for cell in product((message.name for message in MESSAGES), Error, (True, False)):
        assert (rows[cell] > 0) + reasons[cell] == 1, cell


def test_a_row_is_tolerated_or_has_a_bound():
    names = Counter(row.name for row in ROWS)
    assert set(names.values()) == {1}
    assert all((row.bound is None) == (row.end == GOES_ON) for row in ROWS)
    assert all(row.tolerated for row in ROWS if row.end == GOES_ON)


def test_the_page_is_what_the_rows_show(played):
    """In this file, so that it comes after them in the same process: no row is played twice."""
    assert PAGE.read_text(encoding="utf-8") == page(played), "run make docs"
