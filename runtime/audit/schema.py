"""JSON Schema as the viewers of log files can read it: one flat document per model.

Open-source viewers fail on ``$ref``, ``anyOf``, ``prefixItems`` and lists of lists. References are inlined, an
optional value becomes a key that may be absent, and whatever is left of the forbidden words is an error.
"""

import json
from collections.abc import Mapping
from functools import cache
from typing import Any, Final

from pydantic import BaseModel

FORBIDDEN: Final = frozenset({"$ref", "$defs", "anyOf", "oneOf", "allOf", "prefixItems", "patternProperties"})
"""What a flattened schema never holds."""


@cache
def schema_bytes(model: type[BaseModel]) -> bytes:
    """The model's flattened schema as JSON, the same bytes each time.

    Raises:
        TypeError: the model has a field that no flat schema describes.
    """
    return json.dumps(flat_schema(model), allow_nan=False, sort_keys=True, separators=(",", ":")).encode()


def flat_schema(model: type[BaseModel]) -> dict[str, Any]:
    """The model's schema with references inlined and optional values as absent keys.

    Raises:
        TypeError: as ``schema_bytes``.
    """
    schema = model.model_json_schema(mode="serialization")
    flat = _flatten(schema, schema.get("$defs", {}))
    problem = find_problem(flat)
    if problem:
        raise TypeError(f"{model.__name__}: {problem} cannot stand in a flat schema")
    return flat


def find_problem(schema: Mapping[str, Any]) -> str:
    """The first thing in the schema that viewers cannot read; empty if nothing is."""
    forbidden = sorted(FORBIDDEN & schema.keys())
    if forbidden:
        return forbidden[0]
    if schema.get("type") == "array":
        items = schema.get("items", {})
        return "a list of lists" if items.get("type") in ("array", None) else find_problem(items)
    return next(filter(None, map(find_problem, schema.get("properties", {}).values())), "")


def _flatten(schema: Mapping[str, Any], definitions: Mapping[str, Any]) -> dict[str, Any]:
    if "$ref" in schema:
        return _flatten(definitions[schema["$ref"].rpartition("/")[2]], definitions)
    schema = _without_null(schema)
    if "$ref" in schema:
        return _flatten(schema, definitions)
    flat = {key: value for key, value in schema.items() if key not in ("$defs", "default", "title")}
    if "items" in flat:
        flat["items"] = _flatten(flat["items"], definitions)
    if "properties" in flat:
        optional = {name for name, value in flat["properties"].items() if _nullable(value)}
        flat["required"] = [name for name in flat["properties"] if name not in optional]
        flat["properties"] = {
            name: _flatten(value, definitions) for name, value in flat["properties"].items()
        }
        flat["title"] = schema["title"]
    return flat


def _nullable(schema: Mapping[str, Any]) -> bool:
    return {"type": "null"} in schema.get("anyOf", ())


def _without_null(schema: Mapping[str, Any]) -> Mapping[str, Any]:
    """``X or null`` as ``X``; anything else as it is."""
    if not _nullable(schema):
        return schema
    alternatives = [entry for entry in schema["anyOf"] if entry != {"type": "null"}]
    return alternatives[0] if len(alternatives) == 1 else {"anyOf": alternatives}
