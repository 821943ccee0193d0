"""The time line: spans without gaps, marks that lead to their cards, every step in words, and a bounded length."""

from itertools import pairwise

import pytest

from cutgate.runtime.interlock.phases import ENDED, MOVING
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.review.report import timeline
from cutgate.runtime.review.report.cards import cards_of
from cutgate.runtime.review.report.timeline import ROWS_MAX, duration_s, kind_of, lanes
from tests.runtime.review.report.page import Page

NAMES = ("finished", "refused", "stopped", "crashed", "withdrawn", "latched", "reset")


def of(told, name):
    story = told[name]
    return {lane["name"]: lane.get("spans", lane.get("marks")) for lane in lanes(story, cards_of(story))}


@pytest.mark.parametrize("name", NAMES)
def test_the_states_of_both_sides_follow_each_other_without_a_gap(told, name):
    found = of(told, name)
    assert list(found) == ["runtime", "controller", "verdict", "permissives", "faults", "operator"]
    assert found["runtime"][0]["from_s"] == 0.0
    for side in ("runtime", "controller"):
        spans = found[side]
        assert [span["to_s"] for span in spans[:-1]] == [span["from_s"] for span in spans[1:]]
        assert all(a["state"] != b["state"] for a, b in pairwise(spans))
        assert spans[-1]["to_s"] == duration_s(told[name])


def test_the_arm_is_shown_as_moving_exactly_where_it_could_move(told):
    for name in NAMES:
        moving = [span["state"] for span in of(told, name)["runtime"] if span["kind"] == "moving"]
        assert set(moving) <= {phase.replace("_", " ") for phase in MOVING}
        assert bool(moving) == any(one["what"] == "start" for one in told[name]["allowed"])


@pytest.mark.parametrize("phase", Phase)
def test_every_phase_has_a_kind(phase):
    assert (kind_of(phase) == "moving") == (phase in MOVING)
    assert (kind_of(phase) in ("ended", "fault")) == (phase in ENDED)
    assert kind_of("no phase") == "idle"


def test_marks_lead_to_cards(told):
    ids = {card.id for card in cards_of(told["stopped"])}
    found = of(told, "stopped")
    assert {mark["card"] for mark in found["permissives"]} == ids
    (verdict,) = found["verdict"]
    assert verdict["card"] == "c1"
    assert verdict["kind"] == "good"
    assert [mark["text"] for mark in found["operator"]] == [
        entry["word"] for entry in told["stopped"]["operator"]
    ]


def test_every_step_stands_in_the_table_in_the_order_of_time(told):
    story = told["stopped"]
    page = Page(timeline.section(story, cards_of(story)))
    times = [float(text) for text in page.said if text.replace(".", "").isdigit() and text.count(".") == 1]
    assert times == sorted(times)
    for one in story["decisions"]:
        assert f"on {one['event']}" in page.text
    assert "first-out OPERATOR_STOP" in page.text
    assert "log closed" in page.text
    links = {attributes["href"] for attributes in page.of("a")}
    assert links == {f"#{card.id}" for card in cards_of(story)}


def test_what_the_operator_said_tells_who_and_where_and_whether_it_was_taken(told):
    entry = {"offset_s": 2.0, "word": "start", "accepted": False, "reason": "not yet"}
    opened = told["finished"]["opened"] | {"operator": "Ann", "account": "or1 (uid 7)", "host": "theatre"}
    story = told["finished"] | {"operator": [entry], "opened": opened}
    text = Page(timeline.section(story, [])).text
    assert "operator Ann, account or1 (uid 7), on theatre" in text
    assert "(refused: not yet)" in text
    (mark,) = next(lane for lane in lanes(story, []) if lane["name"] == "operator")["marks"]
    assert mark["kind"] == "bad"


def test_more_rows_than_a_page_holds_are_left_out_in_the_middle_and_counted(told):
    many = [{"offset_s": float(k), "state": f"S{k}", "cause": "NONE"} for k in range(ROWS_MAX + 7)]
    story = told["finished"] | {
        name: [] for name in ("decisions", "operator", "collected", "witness", "faults")
    }
    page = Page(timeline.section(story | {"controller": many, "closed": None}, []))
    assert f"{7} rows are left out here" in page.text
    assert page.text.endswith(f"S{ROWS_MAX + 6}")
    assert len(page.of("tr")) == ROWS_MAX + 2
