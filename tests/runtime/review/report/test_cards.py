"""Decisions as cards: each decision that mattered has one, with its reasons; a stop or a refusal is never shown as good."""

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.protocol.states import StopCause
from cutgate.runtime.audit.inspect import read_log
from cutgate.runtime.review.report import cards, timeline
from cutgate.runtime.review.report.cards import BAD, CARDS_MAX, GOOD, cards_of
from cutgate.runtime.review.story import story
from tests.runtime.review.report.page import Page

TITLES = {
    "finished": ["verdict: admissible", "permit left", "start left", "end: done"],
    "refused": ["verdict: inadmissible"],
    "stopped": ["verdict: admissible", "permit left", "start left", "stop", "end: stopped"],
    "crashed": ["verdict: admissible", "permit left", "start left"],
    "withdrawn": ["verdict: admissible", "permit left", "start left", "stop", "end: stopped"],
    "latched": ["verdict: admissible", "permit left", "stop", "end: stopped"],
    "reset": ["reset left", "verdict: admissible", "permit left", "start left", "end: done"],
}


def decided(**changes):
    return {
        "offset_s": 1.0,
        "event": "Tick",
        "from_state": "cutting",
        "to_state": "cutting",
        "disposition": "decided",
    } | changes


def shown(told, *decisions):
    told = told | {"decisions": list(decisions)}
    found = cards_of(told)
    return found, Page(cards.section(told, found)).text


@pytest.mark.parametrize("name", TITLES)
def test_every_decision_that_mattered_has_a_card(told, name):
    found = cards_of(told[name])
    assert [card.title for card in found] == TITLES[name]
    assert [card.id for card in found] == [f"c{k}" for k in range(1, len(found) + 1)]
    bad = {"verdict: inadmissible", "stop", "end: stopped"}
    assert {card.title for card in found if card.kind == BAD} == bad & set(TITLES[name])
    page = Page(cards.section(told[name], found))
    assert [attributes["id"] for attributes in page.of("article")] == [card.id for card in found]


def test_a_permit_says_how_many_permissives_held_and_what_it_bound(told):
    permit = cards_of(told["finished"])[1]
    count = len(permit.decision["permissives"])
    assert permit.why == f"Every one of its {count} permissives held as it left."
    assert {name for name, _ in permit.inputs} >= {"path", "limits", "calibration", "tool", "registration"}
    text = Page(cards.section(told["finished"], [permit])).text
    assert all(digest in text for _, digest in permit.inputs)
    for entry in permit.decision["permissives"]:
        assert entry["name"] in text
        assert entry["bound"] in text


def test_what_left_although_a_permissive_did_not_hold_is_shown_as_bad(told):
    entry = {"name": "bone", "holds": False, "value": 0.7, "bound": "<= 0.5 mm", "remedy": "fix it"}
    (card,), text = shown(
        told["finished"], decided(disposition="sent", effects=["send Start"], permissives=[entry])
    )
    assert card.kind == BAD
    assert "1 of its 1 permissives did NOT hold." in text
    assert "bone: 0.700 mm, required: <= 0.5 mm. Remedy: fix it" in text
    assert "0 of 1 hold" in text


def test_what_was_withheld_says_so(told):
    (card,), text = shown(told["finished"], decided(disposition="withheld", reason="the device was released"))
    assert (card.title, card.kind) == ("withheld: nothing left", BAD)
    assert "It was authorised and did not leave. the device was released" in text


def test_a_stop_names_its_cause_in_words_and_what_was_found(told):
    (card,), text = shown(
        told["stopped"],
        decided(to_state="stopping", first_out=StopCause.TRACKING_DEVIATION.name, reason="q1 too far"),
    )
    assert card.kind == BAD
    assert "The arm was not where the verified path allows. q1 too far" in text
    assert "TRACKING_DEVIATION" in text


def test_a_stop_is_told_as_one_even_where_something_left_with_it(told):
    (card,), _ = shown(
        told["stopped"], decided(to_state="stopping", disposition="sent", effects=["send Start"])
    )
    assert (card.title, card.kind) == ("stop", BAD)


def test_refused_permissives_are_told_with_value_bound_and_remedy(told):
    entry = {"name": "key", "holds": False, "text": "none", "bound": "given", "remedy": "give one"}
    _, text = shown(told["refused"], decided(from_state="admitted", to_state="refused", permissives=[entry]))
    assert "key: none, required: given. Remedy: give one" in text


def test_more_decisions_than_a_page_holds_are_counted(told):
    many = [decided(disposition="withheld")] * (CARDS_MAX + 3)
    found, text = shown(told["finished"], *many)
    assert len(found) == CARDS_MAX
    assert "3 decisions more are in the log." in text


def test_a_log_without_decisions_says_so(told):
    assert "The log holds no decision." in shown(told["finished"])[1]


def test_two_sessions_have_cards_of_their_own(told):
    ids = [
        card.id
        for name, prefix in (("finished", "c"), ("stopped", "d"))
        for card in cards_of(told[name], prefix)
    ]
    assert len(set(ids)) == len(ids)


@pytest.mark.parametrize(
    "text", ["<script>alert(1)</script>", '"><img src=x onerror=y>', "a\x1b[31m\x00b", "a\u202eb"]
)
def test_no_text_of_a_log_is_markup_or_turns_the_reading_direction(told, text):
    entry = dict.fromkeys(("name", "text", "bound", "remedy"), text) | {"holds": False}
    fields = dict.fromkeys(("event", "from_state", "reason", "first_out"), text)
    one = decided(**fields, disposition="withheld", permissives=[entry])
    record = {"offset_s": 1.0} | dict.fromkeys(
        (
            "word",
            "what",
            "reason",
            "source",
            "cause",
            "detail",
            "kind",
            "difference",
            "state",
            "log",
            "outcome",
        ),
        text,
    )
    opened = told["finished"]["opened"] | dict.fromkeys(("operator", "account", "host"), text)
    lists = {name: [record] for name in ("operator", "faults", "collected", "controller", "witness")}
    strange = told["finished"] | lists | {"decisions": [one], "closed": record, "opened": opened}
    found = cards_of(strange)
    made = cards.section(strange, found) + timeline.section(strange, found)
    page = Page(made)
    assert not page.of("script")
    assert not page.of("img")
    assert not any(character in made for character in "\x1b\x00\u202e")


# ---------------------------------------------------------------- whatever a log holds

ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.just(10**400) | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(st.text(max_size=3), inner, max_size=2),
    max_leaves=4,
)
LISTS = (
    "decisions", "permits", "faults", "operator", "collected", "witness", "controller", "verdicts",
)  # fmt: skip
FIELDS = (
    "event", "from_state", "to_state", "disposition", "effects", "permissives", "first_out", "reason", "kind", "word",
    "what", "accepted", "cause", "detail", "source", "state", "verdict", "path_sha256", "matches_approved", "log",
)  # fmt: skip


@given(
    st.lists(st.tuples(st.sampled_from(LISTS), st.sampled_from(FIELDS), ANYTHING), min_size=1, max_size=6),
    st.lists(
        st.tuples(st.sampled_from(("name", "holds", "value", "text", "bound", "remedy")), ANYTHING),
        max_size=2,
    ),
)
def test_a_log_that_says_anything_anywhere_is_told_without_an_error(told, changes, permissives):
    strange = dict(told["stopped"])
    for place, field, value in changes:
        strange[place] = [entry | {field: value} for entry in strange[place]]
    entry = dict(permissives)
    strange["decisions"] = [*strange["decisions"], decided(disposition="sent", permissives=[entry])]
    found = cards_of(strange)
    Page(cards.section(strange, found) + timeline.section(strange, found))
    json.dumps(timeline.lanes(strange, found), allow_nan=False)


@given(st.data())
def test_a_log_with_damaged_bytes_is_told_without_an_error(old_logs, data):
    log = bytearray(old_logs["stopped"])
    for _ in range(data.draw(st.integers(1, 20))):
        log[data.draw(st.integers(0, len(log) - 1))] = data.draw(st.integers(0, 255))
    strange = story(read_log(bytes(log)), Path("x.mcap"), None)
    found = cards_of(strange)
    Page(cards.section(strange, found) + timeline.section(strange, found))


def test_good_and_bad_are_told_by_shape_as_well(told):
    shapes = {
        card.kind: Page(cards.section(told["stopped"], [card])).text[0] for card in cards_of(told["stopped"])
    }
    assert shapes[GOOD] != shapes[BAD]
