"""The verdict again: its document, its flat fields, its boundary records and its proof."""

import json
from dataclasses import replace
from hashlib import sha256

import pytest

from cutgate.runtime.audit import records
from cutgate.runtime.audit.inspect import read_log
from cutgate.runtime.audit.recomputed.inputs import ReplayError, inputs_of, typed
from cutgate.runtime.audit.recomputed.verdict import (
    boundary_differences,
    expected_boundaries,
    proof_differences,
    recomputed_verdict,
    verdict_differences,
)
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.certificate import Certificate
from tests.runtime.audit.build import proof_of, session_log

EARLIER = "cutgate 0.1.0"


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return read_log(session_log(tmp_path_factory.mktemp("admitted")).log.read_bytes())


@pytest.fixture(scope="module")
def given(log):
    return inputs_of(log)


@pytest.fixture(scope="module")
def opened(log):
    return typed(log, records.AuditOpen)[0]


@pytest.fixture(scope="module")
def recorded(log):
    return typed(log, records.AuditVerdict)[0]


@pytest.fixture(scope="module")
def again(recorded, given, opened):
    return recomputed_verdict(recorded, given, certified.verify, opened)


def differing(recorded, again, given, *, comparable=True):
    return list(verdict_differences(recorded, again, given, comparable=comparable))


def test_the_document_is_the_recorded_one(recorded, again, given):
    document = json.loads(recorded.document)
    assert again == document
    assert differing(recorded, again, given) == []


def test_a_record_without_a_duration_has_none(recorded, given, opened):
    made = recomputed_verdict(
        recorded.model_copy(update={"elapsed_ms": None}), given, certified.verify, opened
    )
    assert made["elapsed_ms"] == 0.0


@pytest.mark.parametrize("field", ["path", "limits", "calibration"])
def test_the_digests_are_those_of_the_inputs(given, again, field):
    assert again["digests"][field] == sha256(getattr(given, field)).hexdigest()
    assert again["digests"]["registration"] == given.registration_digest.hex()


def test_a_verifier_of_0_1_0_did_not_say_where_a_cut_lies(recorded, given, opened):
    for verdict_by, opened_by, described in (
        (EARLIER, EARLIER, False),
        (EARLIER, opened.verifier, True),
        (opened.verifier, EARLIER, True),
        (opened.verifier, opened.verifier, True),
    ):
        made = recomputed_verdict(
            recorded.model_copy(update={"verifier": verdict_by}),
            given,
            certified.verify,
            opened.model_copy(update={"verifier": opened_by}),
        )
        assert ("warnings" in made) is described
        assert ("extent" in made) is described


def test_a_verifier_that_gives_up_poses_no_problem(recorded, given, opened):
    def broken(_problem):
        raise ValueError("no problem of this kind")

    with pytest.raises(ReplayError, match="pose no problem that can be verified: no problem of this kind"):
        recomputed_verdict(recorded, given, broken, opened)


# ---------------------------------------------------------------- recorded and recomputed


@pytest.mark.parametrize(
    ("document", "told"),
    [
        ("7", "verdict: the recorded document is not a JSON object"),
        ("{", "verdict: the recorded document is not a JSON object"),
    ],
)
def test_a_document_that_is_none_differs(recorded, again, given, document, told):
    assert differing(recorded.model_copy(update={"document": document}), again, given) == [told]


@pytest.mark.parametrize(
    "change",
    [
        {"boundaries": 7},
        {"boundaries": {"x": 7}},
        {"digests": None},
        {"deadband": {"arm_mm": 0, "wrist_deg": 0}, "boundaries": {"x": {"unit": "mm", "certified": 1}}},
        {"verdict": "perhaps"},
    ],
)
def test_a_document_of_another_kind_differs_and_is_no_exception(recorded, again, given, change):
    document = json.loads(recorded.document) | change
    found = differing(recorded.model_copy(update={"document": json.dumps(document)}), again, given)
    assert found[-1] == "verdict: the recorded document is not a verdict document"
    assert len(found) > 1


FIELDS = sorted(
    records.AuditVerdict.model_fields.keys() - records.AuditRecord.model_fields.keys() - {"document"}
)


@pytest.mark.parametrize("name", [name for name in FIELDS if name not in ("verifier", "reason")])
def test_each_flat_field_is_that_of_the_document(recorded, again, given, name):
    value = getattr(recorded, name)
    other = f"{value}x" if isinstance(value, str) else (value or 0) + 1
    (line,) = differing(recorded.model_copy(update={name: other}), again, given)
    assert line == f"verdict {name}: recorded {other}, its document says {value}"


@pytest.mark.parametrize("name", ["verifier", "reason"])
def test_what_no_document_says_may_be_anything(recorded, again, given, name):
    assert differing(recorded.model_copy(update={name: "other"}), again, given) == []


def test_an_empty_reason_is_no_reason(recorded, again, given):
    assert differing(recorded.model_copy(update={"reason": None}), again, given) == []


def test_on_another_machine_counts_may_differ_and_clearances_may_not(recorded, again, given):
    other = json.loads(json.dumps(again))
    other["evaluations"]["arm"] += 1
    assert differing(recorded, other, given, comparable=False) == []
    assert differing(recorded, other, given) != []
    other["boundaries"]["top"]["clearance"] += 1e-6
    assert differing(recorded, other, given, comparable=False) != []


# ---------------------------------------------------------------- boundary records


def test_the_boundary_records_are_those_of_the_documents(log, recorded):
    found, expected = typed(log, records.AuditBoundary), expected_boundaries([recorded])
    assert [one.name for one in found] == [one.name for one in expected]
    assert list(boundary_differences(found, expected, finished=True)) == []
    assert len(expected_boundaries([recorded, recorded])) == 2 * len(found)
    assert expected_boundaries([]) == []


@pytest.mark.parametrize(
    "document", ["7", "{}", '{"deadband": 7}', '{"deadband": {"arm_mm": 1, "wrist_deg": 1}, "boundaries": 7}']
)
def test_of_a_document_that_is_none_no_boundary_is_expected(recorded, document):
    assert expected_boundaries([recorded, recorded.model_copy(update={"document": document})]) is None


def test_each_field_of_each_boundary_counts(log, recorded):
    expected = expected_boundaries([recorded])
    found = typed(log, records.AuditBoundary)
    for place, one in enumerate(found):
        other = one.model_copy(update={"violated": not one.violated})
        changed = [*found[:place], other, *found[place + 1 :]]
        told = [f"boundary {one.name}: the record is not what the verdict's document says"]
        assert list(boundary_differences(changed, expected, finished=True)) == told
    linked = [one.model_copy(update={"prev": "other"}) for one in found]
    assert list(boundary_differences(linked, expected, finished=True)) == []


def test_none_is_missing_from_a_finished_file_and_none_too_many_in_any(log, recorded):
    found, expected = typed(log, records.AuditBoundary), expected_boundaries([recorded])
    count = len(found)
    told = [f"boundaries: {count - 1} recorded, the documents have {count}"]
    assert list(boundary_differences(found[:-1], expected, finished=True)) == told
    assert list(boundary_differences(found[:-1], expected, finished=False)) == []
    many = [f"boundaries: {count + 1} recorded, the documents have {count}"]
    for finished in (True, False):
        assert list(boundary_differences([*found, found[0]], expected, finished=finished)) == many
        assert list(boundary_differences(found, expected, finished=finished)) == []


# ---------------------------------------------------------------- the proof


def test_the_proof_proves_the_recorded_path(given):
    assert list(proof_differences(proof_of(), given)) == []


def test_an_admissible_verdict_needs_its_proof(given):
    assert list(proof_differences(None, given)) == [
        "attachment proof.bin is missing: the admissible verdict has no proof"
    ]
    (line,) = proof_differences(b"damaged", given)
    assert line.startswith("attachment proof.bin: ")


def test_a_proof_that_states_more_than_it_proves_is_none(given):
    proof = Certificate.parse(proof_of())
    bold = replace(proof, bounds={**proof.bounds, "outer": proof.bounds["outer"] + 500.0})
    found = list(proof_differences(bold.body(), given))
    assert found
    assert all(line.startswith("the proof: ") for line in found)
