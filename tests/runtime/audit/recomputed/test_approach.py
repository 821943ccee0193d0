"""Approach and retract again: every part of the record is compared, and what a permit binds is what was verified."""

import json

import pytest

from cutgate.runtime.audit import records
from cutgate.runtime.audit.inspect import read_log
from cutgate.runtime.audit.recomputed.approach import (
    Recomputed,
    approach_differences,
    bound_differences,
    joints_text,
    recomputed_approach,
)
from cutgate.runtime.audit.recomputed.inputs import ReplayError, inputs_of
from tests.altering import altered
from tests.runtime.audit.build import STANDS, approach_of, session_log, wire_permit


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    return inputs_of(read_log(session_log(tmp_path_factory.mktemp("admitted")).log.read_bytes()))


@pytest.fixture(scope="module")
def again(given):
    return recomputed_approach(approach_of(), given)


def told(recorded, again, *, comparable=True, sentences=True):
    return list(approach_differences(recorded, again, comparable=comparable, sentences=sentences))


def with_document(change):
    """The recorded approach with another document, its flat fields as they were."""
    document = json.loads(approach_of().document)
    change(document)
    return approach_of().model_copy(update={"document": json.dumps(document)})


def test_it_is_recomputed_from_the_recorded_joints_with_the_sites_settings(given, again):
    assert again.verdict == "admissible"
    assert again.document == json.loads(approach_of().document)
    assert again.bound == wire_permit().approach
    assert again.reason == approach_of().reason
    assert told(approach_of(), again) == []
    elsewhere = approach_of().model_copy(update={"start_joints_u": (*STANDS[:2], 52_000_000, *STANDS[3:])})
    other = recomputed_approach(elsewhere, given)
    assert (other.verdict, other.bound) == ("inadmissible", None)


@pytest.mark.parametrize(
    ("part", "name", "value", "key"),
    [
        ("approach", "approach_clearance_mm", 12.5004, "clearance_um"),
        ("start", "start_tolerance_mm", 1.0, "start_tolerance_mm"),
        ("start", "start_tolerance_deg", 0.5, "start_tolerance_deg"),
    ],
)
def test_each_setting_of_the_site_acts(given, part, name, value, key):
    site = given.site.model_copy(update={part: getattr(given.site, part).model_copy(update={name: value})})
    other = recomputed_approach(approach_of(), given._replace(site=site))
    assert other.document[key] == (12_500 if key == "clearance_um" else value)


def test_the_speed_is_the_sites(given):
    part = given.site.approach.model_copy(update={"approach_speed_percent": 30})
    other = recomputed_approach(
        approach_of(), given._replace(site=given.site.model_copy(update={"approach": part}))
    )
    assert other.bound.speed_percent == 30


@pytest.mark.parametrize("joints", [(1, 2, 3), ()])
def test_start_joints_that_are_none_are_no_approach(given, joints):
    recorded = approach_of().model_copy(update={"start_joints_u": joints})
    with pytest.raises(ReplayError, match="the approach's start joints cannot be read: "):
        recomputed_approach(recorded, given)


# ---------------------------------------------------------------- recorded and recomputed


@pytest.mark.parametrize("document", ["7", "{"])
def test_a_document_that_is_none_differs(again, document):
    recorded = approach_of().model_copy(update={"document": document})
    assert told(recorded, again) == ["approach: the recorded document is not a JSON object"]


def test_what_differs_in_the_document_is_named(again):
    recorded = with_document(lambda document: document.update(exit_um=1))
    (line,) = told(recorded, again)
    assert line == f"approach exit_um: recorded 1, recomputed {again.document['exit_um']}"


FIELDS = {
    "verdict": "inadmissible",
    "entry_um": 1,
    "exit_um": 1,
    "entry_joints_u": (0, 0, 0, 0, 0),
    "exit_joints_u": (),
    "speed_percent": 26,
    "worst_leg": "none",
    "worst_boundary": "none",
    "worst_certified": 99.0,
    "reason": "all is well",
}


def test_these_are_all_fields_but_what_it_was_computed_from():
    own = records.AuditApproach.model_fields.keys() - records.AuditRecord.model_fields.keys()
    assert FIELDS.keys() == own - {"document", "start_joints_u"}


@pytest.mark.parametrize("name", FIELDS)
def test_each_field_is_the_one_that_is_recomputed(again, name):
    recorded = approach_of().model_copy(update={name: FIELDS[name]})
    (line,) = told(recorded, again)
    one, other = FIELDS[name], getattr(approach_of(), name)
    if name.endswith("_joints_u"):
        one, other = joints_text(one), joints_text(other)
    assert line == f"approach {name}: recorded {one}, recomputed {other}"


def test_the_worst_clearance_may_differ_by_rounding(again):
    off = approach_of().worst_certified
    for by, alike in ((0.5e-9, True), (2e-9, False)):
        recorded = approach_of().model_copy(update={"worst_certified": off + by})
        assert (told(recorded, again) == []) is alike
    assert told(approach_of().model_copy(update={"worst_certified": None}), again) != []


def test_on_another_machine_the_worst_place_and_the_reason_may_be_others(again):
    for name in ("worst_leg", "worst_boundary", "reason"):
        recorded = approach_of().model_copy(update={name: "other"})
        assert told(recorded, again, comparable=False) == []
        assert told(recorded, again) != []
    for name in FIELDS.keys() - {"worst_leg", "worst_boundary", "reason"}:
        recorded = approach_of().model_copy(update={name: FIELDS[name]})
        assert told(recorded, again, comparable=False) != [], name


def test_another_version_may_say_the_same_in_other_sentences(again):
    recorded = with_document(lambda document: document.update(reasons=["other"])).model_copy(
        update={"reason": "other"}
    )
    assert len(told(recorded, again)) > 1
    assert told(recorded, again, sentences=False) == []
    for name in FIELDS.keys() - {"reason"}:
        recorded = approach_of().model_copy(update={name: FIELDS[name]})
        assert told(recorded, again, sentences=False) != [], name
    assert told(with_document(lambda document: document.update(exit_um=1)), again, sentences=False) != []


def test_on_another_machine_sentences_of_the_document_are_not_compared(again):
    recorded = with_document(lambda document: document.update(reasons=["other"]))
    assert told(recorded, again, comparable=False) == []


def test_what_is_recomputed_names_its_verdict():
    assert Recomputed({"verdict": "admissible"}, None, "").verdict == "admissible"


# ---------------------------------------------------------------- what a permit binds


@pytest.mark.parametrize(
    ("field", "value", "name"),
    [
        ("start_joints_u", (0, *STANDS[1:]), "start joints"),
        ("approach.entry_um", 0, "entry"),
        ("approach.entry_joints_u", STANDS, "entry"),
        ("approach.exit_um", 1, "exit"),
        ("approach.exit_joints_u", STANDS, "exit"),
        ("approach.speed_percent", 100, "approach speed"),
    ],
)
def test_a_permit_binds_what_was_verified(field, value, name):
    assert list(bound_differences(wire_permit(), approach_of())) == []
    (line,) = bound_differences(altered(wire_permit(), field, value), approach_of())
    assert line.startswith(f"the permit's {name} are not the verified: ")


def test_what_is_bound_is_told_as_people_read_it():
    permit = altered(altered(wire_permit(), "approach.exit_um", 12_005), "approach.speed_percent", 7)
    empty = approach_of().model_copy(update={"exit_um": -5, "exit_joints_u": (), "speed_percent": None})
    exit_pose, speed = bound_differences(permit, empty)
    assert exit_pose == (
        f"the permit's exit are not the verified: 12.005 mm along the tool, at "
        f"{joints_text(permit.approach.exit_joints_u)}, verified -0.005 mm along the tool, at no joints"
    )
    assert speed == "the permit's approach speed are not the verified: 7 %, verified None %"


def test_joints_are_exact_however_large_what_a_log_says_is():
    assert joints_text((-1_500_000, 0, 1, 10**30)) == (
        f"q0 -1.500000 deg, q1 0.000000 deg, q2 0.000001 mm, q3 {10**24}.000000 deg"
    )
    assert joints_text(()) == ""
