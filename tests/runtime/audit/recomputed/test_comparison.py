"""Two documents, value by value: what counts as the same, and what is not compared."""

import json

import pytest

from cutgate.runtime.audit import records
from cutgate.runtime.audit.recomputed.comparison import differences, document_of, same

HUGE = 10**400


def told(recorded, recomputed, comparable=True):
    return list(differences("verdict", recorded, recomputed, comparable=comparable))


@pytest.mark.parametrize("absolute", [True, False])
@pytest.mark.parametrize(
    ("one", "other", "alike"),
    [
        (1.0, 1, True),
        (0.5, 0.5 + 0.9e-9, True),
        (0.5, 0.5 + 1.1e-9, False),
        (0.5 + 1.1e-9, 0.5, False),
        (0.0, 1e-9, True),
        (-0.5, 0.5, False),
        (True, True, True),
        (True, False, False),
        (True, 1, False),
        (1, True, False),
        (0, False, False),
        ("a", "a", True),
        ("a", "b", False),
        ("1", 7, False),
        (8, "8", False),
        (None, None, True),
        (None, 0, False),
        (0, None, False),
        (None, False, False),
        ([], [], True),
        ([], {}, False),
        ({}, {}, True),
        (HUGE, 1.5, False),
        (float("nan"), float("nan"), False),
        (float("nan"), 1.0, False),
        (float("inf"), 1.0, False),
    ],
)
def test_values_are_the_same_but_for_rounding(one, other, alike, absolute):
    assert same(one, other, absolute=absolute) is alike


def test_the_tolerance_grows_with_lengths_and_not_with_clearances():
    assert same(1000.0, 1000.0 + 9e-7, absolute=False)
    assert same(-1000.0, -1000.0 - 9e-7, absolute=False)
    assert not same(1000.0, 1000.0 + 1.1e-6, absolute=False)
    assert not same(1000.0, 1000.0 + 2e-9, absolute=True)
    assert same(1000.0, 1000.0 + 0.5e-9, absolute=True)
    assert not same(0.001, 0.001 + 1e-9 * 1.5, absolute=False), "it does not shrink either"


def test_lengths_that_no_double_can_hold_are_never_the_same():
    assert not same(HUGE, HUGE, absolute=False)
    assert not same(HUGE, HUGE + 1, absolute=False)


def test_what_differs_is_named_by_its_place_in_order():
    recorded = {"b": {"c": [1, 2, {"d": "x"}]}, "a": 1}
    recomputed = {"b": {"c": [1, 3, {"d": "y"}]}, "a": 1}
    assert told(recorded, recomputed) == [
        "verdict b.c.1: recorded 2, recomputed 3",
        "verdict b.c.2.d: recorded x, recomputed y",
    ]


def test_what_stands_in_one_alone_is_named_too():
    assert told({"a": 1, "b": 2}, {"b": 2, "c": 3}) == [
        "verdict a: recorded only",
        "verdict c: recomputed only",
    ]
    assert told({"a": []}, {"a": [1]}) == ["verdict a: recorded only", "verdict a.0: recomputed only"]
    assert told({"a": {}}, {"a": {}}) == []
    assert told({"a": {}}, {"a": []}) == ["verdict a: recorded {}, recomputed []"]
    assert told({}, {}) == []


@pytest.mark.parametrize("name", ["elapsed_ms", "guidance", "guidance_note", "other_elbow"])
def test_what_is_not_computed_again_is_not_compared(name):
    assert told({name: {"x": 1}}, {name: {"x": 2}}) == []
    assert told({"x": 1, name: 1}, {"x": 1}) == []
    assert told({"a": {name: 1}}, {"a": {name: 2}}) != [], "only at the top"


@pytest.mark.parametrize(
    "name", ["evaluations", "segment", "fraction", "tip_length_mm", "tip_mm", "reasons", "text"]
)
def test_what_follows_from_a_last_bit_is_compared_on_an_equal_machine_alone(name):
    for one, other in (({name: 1}, {name: 2}), ({"a": [{name: 1}]}, {"a": [{name: 2}]})):
        assert told(one, other) != []
        assert told(one, other, comparable=False) == []
    assert told({"a": 1}, {"a": 2}, comparable=False) != []


@pytest.mark.parametrize("name", ["boundaries", "legs"])
def test_clearances_are_compared_absolutely(name):
    off = ({"a": 1000.0}, {"a": 1000.0 + 2e-8})
    assert told({name: off[0]}, {name: off[1]}) != []
    assert told({"path": off[0]}, {"path": off[1]}) == []


def test_depth_is_no_matter():
    deep, other = 1, 2
    for _ in range(3000):
        deep, other = {"a": deep}, {"a": other}
    assert len(told(deep, other)) == 1


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ('{"a": 1}', {"a": 1}),
        ("{}", {}),
        ("7", None),
        ("[]", None),
        ("null", None),
        ("{", None),
        ("[" * 100_000, None),
    ],
)
def test_a_document_is_a_json_object_or_none(text, found):
    record = records.AuditApproach(
        document=text, verdict="admissible", start_joints_u=(), entry_um=0, exit_um=0
    )
    assert document_of(record) == found
    assert json.dumps(document_of(record)) == json.dumps(found)
