"""Two sessions side by side, as plain values: what differs is found, and nothing else."""

import json
import math

from hypothesis import given
from hypothesis import strategies as st

from cutgate.runtime.review.difference import SAME, difference, equal, time_difference

SECTIONS = ("robot", "verdict", "approach", "outcome")
scalars = st.none() | st.booleans() | st.integers(-9, 9) | st.floats(-1e6, 1e6) | st.text(max_size=4)
values = st.dictionaries(st.text(max_size=5), scalars | st.lists(scalars, max_size=3), max_size=6)
sessions = st.dictionaries(st.sampled_from(SECTIONS), values, max_size=4)


def found(result):
    return {(section["section"], entry["what"]) for section in result for entry in section["differences"]}


@given(sessions)
def test_a_session_equals_itself(session):
    again = json.loads(json.dumps(session))
    assert equal(difference(session, again))
    assert not any(section["differences"] for section in difference(again, session))


@given(sessions, sessions)
def test_the_order_of_the_two_only_swaps_the_sides(first, second):
    one, other = difference(first, second), difference(second, first)
    assert found(one) == found(other)
    swap = {"a": "b", "b": "a"}
    turned = {
        (section["section"], entry["what"]): {swap.get(key, key): value for key, value in entry.items()}
        for section in other
        for entry in section["differences"]
    }
    for section in one:
        for entry in section["differences"]:
            assert repr(turned[section["section"], entry["what"]]) == repr(
                {key: entry[key] for key in turned[section["section"], entry["what"]]}
            )


@given(sessions, st.data())
def test_every_value_that_is_changed_is_found_and_no_other(session, data):
    places = [(section, name) for section, inner in session.items() for name in inner]
    if not places:
        return
    chosen = set(data.draw(st.lists(st.sampled_from(places), min_size=1, unique=True)))
    other = {
        section: {name: ["another"] if (section, name) in chosen else value for name, value in inner.items()}
        for section, inner in session.items()
    }
    assert found(difference(session, other)) == chosen


@given(sessions, st.sampled_from(SECTIONS), st.text(max_size=5), scalars)
def test_what_only_one_of_them_has_is_a_difference(session, section, name, value):
    without = {key: dict(inner) for key, inner in session.items()}
    without.setdefault(section, {}).pop(name, None)
    more = {**without, section: {**without[section], name: value}}
    (entry,) = [
        entry
        for part in difference(without, more)
        for entry in part["differences"]
        if part["section"] == section
    ]
    assert entry == {"what": name, "b": value}


def test_measures_are_equal_within_what_two_processors_may_differ_by():
    near, far = {"verdict": {"x": 5.0}}, {"verdict": {"x": 5.0 + 3 * SAME}}
    assert equal(difference(near, {"verdict": {"x": 5.0 + 0.5 * SAME}}))
    assert not equal(difference(near, far))


def test_what_was_given_is_equal_to_the_last_digit():
    assert not equal(difference({"robot": {"x": 5.0}}, {"robot": {"x": math.nextafter(5.0, 6.0)}}))


def test_a_truth_value_is_no_number():
    assert not equal(difference({"outcome": {"x": True}}, {"outcome": {"x": 1}}))
    assert not equal(difference({"verdict": {"x": False}}, {"verdict": {"x": 0.0}}))


def test_an_outcome_that_differs_in_measured_numbers_alone_is_the_same():
    def outcome(text):
        return {"outcome": {"outcome": text}}

    assert equal(difference(outcome("q0 is 0.53 deg off"), outcome("q0 is 0.611 deg off")))
    assert not equal(difference(outcome("q0 is 0.53 deg off"), outcome("q0 is 0.53 mm off")))
    assert not equal(difference({"verdict": {"outcome": "1"}}, {"verdict": {"outcome": "2"}}))


def test_integers_without_end_are_compared_and_no_error():
    assert equal(difference({"verdict": {"x": 10**4000}}, {"verdict": {"x": 10**4000}}))
    assert not equal(difference({"verdict": {"x": 10**4000}}, {"verdict": {"x": 1.5}}))


def test_times_are_alike_within_a_tenth_or_a_tenth_of_a_second_and_counts_within_a_tenth():
    first = {"permit": 0.50, "end": 100.0, "accepted": 1000, "losses": 0, "start": 1.0}
    second = {"permit": 0.59, "end": 111.0, "accepted": 1099, "losses": 1, "end of all": 2.0}
    alike = {entry["what"]: entry["alike"] for entry in time_difference(first, second)}
    assert alike == {
        "permit": True, "end": True, "accepted": True, "losses": False, "start": False, "end of all": False,
    }  # fmt: skip
    assert not time_difference({"end": 100.0}, {"end": 112.0})[0]["alike"]
    assert time_difference({"losses": 0}, {"losses": 0})[0]["alike"]
