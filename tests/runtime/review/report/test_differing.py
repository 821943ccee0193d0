"""Two sessions on a page say what `audit diff` says."""

from pathlib import Path

from cutgate.runtime.audit.inspect import read_log
from cutgate.runtime.review.comparable import comparable, timing
from cutgate.runtime.review.difference import difference, equal, time_difference
from cutgate.runtime.review.report import differing
from cutgate.runtime.review.story import story
from tests.runtime.review.report.page import Page


def document(*logs):
    told = [(read_log(data), Path("x.mcap")) for data in logs]
    stories = [story(log, path, None) for log, path in told]
    values = [comparable(log, one) for (log, _), one in zip(told, stories, strict=True)]
    sections = difference(*values)
    times = time_difference(*map(timing, stories))
    return {"equal": equal(sections), "sections": sections, "timing": times}


def test_what_differs_is_told_with_both_values_and_what_is_equal_in_a_line(old_logs):
    found = document(old_logs["finished"], old_logs["stopped"])
    page = Page(differing.section(found))
    assert page.text.startswith("DIFFERENT: ")
    assert "first-out none OPERATOR_STOP" in page.text
    equal_ones = [one for one in found["sections"] if not one["differences"]]
    assert equal_ones
    for one in equal_ones:
        assert f"{one['section']} ({one['compared']})" in page.text
    rows = sum(len(one["differences"]) for one in found["sections"]) + len(found["timing"])
    assert len([tag for tag in page.elements if tag == ("th", {"scope": "row"})]) == rows


def test_equal_sessions_say_so(old_logs):
    text = Page(differing.section(document(old_logs["finished"], old_logs["finished"]))).text
    assert text.startswith("EQUAL: none of ")


def test_what_one_session_alone_has_is_told_in_a_sentence(old_logs):
    text = Page(differing.section(document(old_logs["finished"], old_logs["refused"]))).text
    assert "permissives of the start: only in the first session" in text


def test_values_are_data():
    entry = {"what": "<i>x</i>\x1b", "a": "<b>\x1b\u202e", "b": 1.0}
    found = {
        "equal": False,
        "sections": [{"section": "<u>", "compared": 2, "differences": [entry]}],
        "timing": [],
    }
    made = differing.section(found)
    page = Page(made)
    assert not {"i", "b", "u"} & {name for name, _ in page.elements}
    assert "\x1b" not in made
    assert "\u202e" not in made
