"""Our messages have the fields that Foxglove publishes, each of its type, and no other; and the check of that finds faults."""

import json

import pytest

from cutgate.runtime.audit.schema import FORBIDDEN
from cutgate.runtime.commands.foxglove.schemas import VIEWED, BoundaryClearances, viewed_schema
from cutgate.runtime.verification.verdict import ARM_BOUNDARIES, BOUNDARIES
from tests.runtime.commands.foxglove.published_schema import problems, published

FOXGLOVE = sorted({viewed_schema(model)[0] for model in VIEWED.values()} & {
    "foxglove.SceneUpdate", "foxglove.FrameTransforms", "foxglove.PosesInFrame", "foxglove.Log"
})  # fmt: skip


def ours(name):
    (schema,) = {schema for own, schema in (viewed_schema(model) for model in VIEWED.values()) if own == name}
    return json.loads(schema)


def differences(own, theirs, place):
    if "oneOf" in theirs:
        if own["type"] != "integer" or own["enum"] != [one["const"] for one in theirs["oneOf"]]:
            yield f"{place}: {own}"
        return
    if own["type"] != theirs["type"]:
        yield f"{place}: {own['type']} instead of {theirs['type']}"
    if theirs["type"] == "object":
        names = set(theirs["properties"])
        if set(own["properties"]) != names or set(own["required"]) != names or own["additionalProperties"]:
            yield f"{place}: {sorted(own['properties'])} instead of {sorted(names)}"
        assert set(theirs.get("required", names)) == names, "every published field is required"
        for name in names & own["properties"].keys():
            yield from differences(own["properties"][name], theirs["properties"][name], f"{place}.{name}")
    if theirs["type"] == "array":
        yield from differences(own["items"], theirs["items"], f"{place}[]")


@pytest.mark.parametrize("name", FOXGLOVE)
def test_each_field_is_the_published_one(name):
    theirs = published(name.removeprefix("foxglove."))
    assert theirs["title"] == name
    assert list(differences(ours(name), theirs, name)) == []


def test_all_four_are_compared():
    assert len(FOXGLOVE) == 4


def walk(schema):
    yield schema
    for part in schema.get("properties", {}).values():
        yield from walk(part)
    if "items" in schema:
        yield from walk(schema["items"])


@pytest.mark.parametrize("topic", VIEWED)
def test_every_schema_is_flat(topic):
    name, data = viewed_schema(VIEWED[topic])
    schema = json.loads(data)
    assert name.split(".")[0] in ("foxglove", "cutgate")
    for part in walk(schema):
        assert not FORBIDDEN & part.keys()
        assert isinstance(part["type"], str)


def test_every_boundary_has_its_clearance_and_its_deadband_in_its_unit():
    names = {"segment", "fraction", "least_in_deadbands"}
    for boundary in BOUNDARIES:
        unit = "mm" if boundary in ARM_BOUNDARIES else "deg"
        names |= {f"{boundary}_{unit}", f"{boundary}_deadband_{unit}"}
    assert BoundaryClearances.model_fields.keys() == names


LINE = {
    "timestamp": {"sec": 1, "nsec": 2}, "level": 2, "message": "x", "name": "", "file": "", "line": 3,
}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({}, []),
        ({"more": 1}, ["message.more: not in the schema"]),
        ({"level": 9}, ["message.level: 9 is none of the enumeration"]),
        ({"level": True}, ["message.level: True is none of the enumeration"]),
        ({"message": None}, ["message.message: None is no string"]),
        ({"line": 1.5}, ["message.line: 1.5 is no integer"]),
        ({"line": -1}, ["message.line: -1 is out of bounds"]),
        ({"timestamp": {"sec": 1, "nsec": 1_000_000_000}}, ["message.timestamp.nsec: 1000000000 is out of bounds"]),
        ({"timestamp": {"sec": 1}}, ["message.timestamp.nsec: missing"]),
    ],
)  # fmt: skip
def test_the_check_of_messages_finds_what_does_not_fit(change, found):
    assert problems(published("Log"), LINE | change) == found
    assert problems(published("Log"), {}) != []
