"""Two documents, recorded and recomputed, value by value."""

import json
from collections.abc import Iterator, Mapping
from typing import Any, Final

from cutgate.runtime.audit import records

TOLERANCE: Final = 1e-9
"""mm, deg; relative for lengths above one."""
NOT_RECOMPUTED: Final = ("elapsed_ms", "guidance", "guidance_note", "other_elbow")
BIT_DEPENDENT: Final = ("evaluations", "segment", "fraction", "tip_length_mm", "tip_mm", "reasons", "text")
"""Follow from the last bit of arctan2 and arccos: compared only on an equal numpy and CPU."""
ABSOLUTE: Final = ("boundaries", "legs")
"""Clearances are compared absolutely, whatever their size."""


def document_of(recorded: records.AuditVerdict | records.AuditApproach) -> dict[str, Any] | None:
    """The record's document, or None where it is no JSON object."""
    try:
        document = json.loads(recorded.document)
    except (ValueError, RecursionError):
        return None
    return document if isinstance(document, dict) else None


def differences(
    what: str, recorded: dict[str, Any], recomputed: dict[str, Any], *, comparable: bool
) -> Iterator[str]:
    """Each value that differs, by its dotted key; ``comparable``: last bits as well."""
    before, after = _leaves(recorded), _leaves(recomputed)
    for key in sorted(before.keys() | after.keys()):
        parts = key.split(".")
        if parts[0] in NOT_RECOMPUTED or (not comparable and not {*parts}.isdisjoint(BIT_DEPENDENT)):
            continue
        if key not in before or key not in after:
            yield f"{what} {key}: {'recorded' if key in before else 'recomputed'} only"
        elif not same(before[key], after[key], absolute=parts[0] in ABSOLUTE):
            yield f"{what} {key}: recorded {before[key]}, recomputed {after[key]}"


def same(one: Any, other: Any, *, absolute: bool) -> bool:
    """Whether two values are the same but for rounding.

    Args:
        one: a value of JSON.
        other: what it is compared with.
        absolute: the tolerance of a number does not grow with it.
    """
    if isinstance(one, bool) or isinstance(other, bool):
        return one is other
    if isinstance(one, int | float) and isinstance(other, int | float):
        scale = 1.0 if absolute else max(1.0, abs(other))
        try:
            return abs(one - other) <= TOLERANCE * scale
        except OverflowError:  # an integer no double can hold
            return False
    return type(one) is type(other) and bool(one == other)


def _leaves(document: Any) -> dict[str, Any]:
    """Every value of a document under its dotted key, however deep; an empty container is a value."""
    found: dict[str, Any] = {}
    waiting = [("", document)]
    while waiting:
        place, value = waiting.pop()
        if isinstance(value, Mapping) and value:
            parts = [(str(key), item) for key, item in value.items()]
        elif isinstance(value, list) and value:
            parts = [(str(number), item) for number, item in enumerate(value)]
        else:
            found[place] = value
            continue
        waiting += [(f"{place}.{key}" if place else key, item) for key, item in reversed(parts)]
    return found
