"""What Foxglove publishes of its messages, and a check of all that these schemas say; what else they might say is an error."""

import json
from functools import cache
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent / "published"
TYPES = {
    "object": dict,
    "array": list,
    "string": str,
    "boolean": bool,
    "number": (int, float),
    "integer": int,
}
TOLD = {"title", "description", "$comment"}
KNOWN = {"type", "properties", "required", "items", "minimum", "maximum", "oneOf", "contentEncoding"}


@cache
def published(name: str) -> dict[str, Any]:
    """The schema of ``foxglove.<name>``."""
    return json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))


def problems(schema: dict[str, Any], value: Any, place: str = "message") -> list[str]:
    """What of a value the schema does not allow, with ``additionalProperties: false`` in every object."""
    unknown = schema.keys() - KNOWN - TOLD
    assert not unknown, f"{place}: this check knows no {unknown}"
    if "oneOf" in schema:
        fits = [one for one in schema["oneOf"] if one["const"] == value and type(value) is int]
        return [] if len(fits) == 1 else [f"{place}: {value!r} is none of the enumeration"]
    kind = TYPES[schema["type"]]
    if not isinstance(value, kind) or (isinstance(value, bool) and schema["type"] != "boolean"):
        return [f"{place}: {value!r} is no {schema['type']}"]
    found = []
    bounded = schema["type"] in ("number", "integer")
    if bounded and not schema.get("minimum", value) <= value <= schema.get("maximum", value):
        found.append(f"{place}: {value!r} is out of bounds")
    if schema["type"] == "object":
        # sec and nsec of a time are written without `required`: they are always there as well
        wanted = set(schema.get("required", schema["properties"]))
        found += [f"{place}.{name}: missing" for name in wanted - value.keys()]
        found += [f"{place}.{name}: not in the schema" for name in value.keys() - schema["properties"].keys()]
        for name in value.keys() & schema["properties"].keys():
            found += problems(schema["properties"][name], value[name], f"{place}.{name}")
    elif schema["type"] == "array":
        for number, item in enumerate(value):
            found += problems(schema["items"], item, f"{place}[{number}]")
    return found
