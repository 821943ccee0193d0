"""Records: flat schemas, finite numbers, absent keys."""

import json
import math

import pytest
from pydantic import BaseModel, ValidationError

from cutgate.runtime.audit import records
from cutgate.runtime.audit.schema import FORBIDDEN, flat_schema, schema_bytes
from tests.runtime.audit.build import MODELS, decision, verdict_of


def walk(value):
    """Every dictionary inside a JSON value, found without the code under test."""
    if isinstance(value, dict):
        yield value
        for item in value.values():
            yield from walk(item)
    elif isinstance(value, list):
        for item in value:
            yield from walk(item)


def schemas_in(schema):
    """Every schema inside a schema; names of properties are no keywords."""
    yield schema
    for part in schema.get("properties", {}).values():
        yield from schemas_in(part)
    if "items" in schema:
        yield from schemas_in(schema["items"])


@pytest.mark.parametrize("model", records.MODELS, ids=lambda model: model.TOPIC)
def test_every_schema_is_flat(model):
    schema = json.loads(schema_bytes(model))
    assert schema["type"] == "object"
    for part in schemas_in(schema):
        assert not FORBIDDEN & part.keys()
        assert "type" in part
        assert isinstance(part["type"], str)
        if part["type"] == "array":
            assert part["items"]["type"] != "array"
    assert not {"$ref", "anyOf", "prefixItems", "null"} & {key for part in walk(schema) for key in part}
    assert b"null" not in schema_bytes(model)


def test_every_topic_has_one_model():
    assert len(MODELS) == len(records.MODELS)


def test_an_optional_value_is_a_key_that_may_be_absent():
    schema = flat_schema(records.AuditPermit)
    assert schema["properties"]["nonce"] == {"type": "string"}
    assert "nonce" not in schema["required"]
    assert "kind" in schema["required"]


class ListOfLists(BaseModel):
    table: list[list[float]]


class Either(BaseModel):
    value: int | str


class Maybe(BaseModel):
    value: int | str | None = None


class Pair(BaseModel):
    value: tuple[int, str]


class Inside(BaseModel):
    value: tuple[Either, ...]


class Anything(BaseModel):
    value: list


@pytest.mark.parametrize("model", [ListOfLists, Either, Maybe, Pair, Inside, Anything])
def test_a_model_that_viewers_cannot_read_is_refused(model):
    with pytest.raises(TypeError, match=model.__name__):
        flat_schema(model)


class Nested(BaseModel):
    at: records.Time | None = None


def test_an_optional_part_is_inlined():
    assert flat_schema(Nested)["properties"]["at"]["properties"].keys() == {"sec", "nsec"}


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_not_finite_is_refused(number):
    with pytest.raises(ValidationError):
        records.AuditBoundary(name="inner", unit="mm", clearance=number, deadband=5.0, violated=True)


def test_a_number_that_is_not_finite_never_becomes_json():
    sound = records.AuditBoundary(name="inner", unit="mm", clearance=1.0, deadband=5.0, violated=True)
    with pytest.raises(ValueError, match="not JSON compliant"):
        sound.model_copy(update={"clearance": math.nan}).encode()


def test_undefined_values_are_left_out():
    boundary = records.AuditBoundary(name="inner", unit="mm", deadband=5.0, violated=True)
    assert json.loads(boundary.encode()).keys() == {
        "prev", "utc", "monotonic", "name", "unit", "deadband", "violated",
    }  # fmt: skip


def test_times_are_seconds_and_nanoseconds():
    time = records.Time.of(1_790_000_000_123_456_789)
    assert (time.sec, time.nsec) == (1_790_000_000, 123_456_789)
    assert time.nanoseconds == 1_790_000_000_123_456_789


@pytest.mark.parametrize(
    ("value", "text", "kept"),
    [
        (0.25, None, (0.25, None)),
        (math.nan, None, (None, "nan")),
        (math.inf, "far", (None, "far")),
        (None, "x", (None, "x")),
    ],
)
def test_a_permissive_keeps_an_undefined_number_as_text(value, text, kept):
    source = records.PermissiveValue(name="distance", holds=False, bound="<= 0.5 mm", remedy="move")
    entry = records.PermissiveValue.of(source.model_copy(update={"value": value, "text": text}))
    assert (entry.value, entry.text) == kept
    assert entry.holds is False


def test_a_verdict_record_says_what_its_document_says():
    document = json.loads(verdict_of())
    record = records.AuditVerdict.of(document, verifier="v", tool_sha256="00")
    assert json.loads(record.document) == document
    assert (record.verdict, record.poses, record.q0_turns) == ("admissible", 6, 0)
    assert record.worst_boundary == "wrist_singularity" or record.worst_boundary == "pitch_min"
    assert record.worst_certified == document["boundaries"][record.worst_boundary]["certified"]
    assert record.reason is None


def test_an_undefined_clearance_is_the_worst():
    document = json.loads(verdict_of())
    document["boundaries"]["top"]["certified"] = None
    record = records.AuditVerdict.of(
        document | {"branch": None}, verifier="v", tool_sha256="00", reason="why"
    )
    assert (record.worst_boundary, record.worst_certified) == ("top", None)
    assert (record.elbow, record.reason) == (None, "why")


def test_a_verdict_without_boundaries_has_no_worst():
    document = json.loads(verdict_of()) | {"boundaries": {}}
    assert records.AuditVerdict.of(document, verifier="v", tool_sha256="00").worst_boundary is None


def test_records_are_frozen_and_closed():
    with pytest.raises(ValidationError):
        decision(1).sequence = 2
    with pytest.raises(ValidationError):
        decision(1, comment="x")
