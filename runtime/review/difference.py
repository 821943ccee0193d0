"""Two sessions side by side: which values differ, and how far their times lie apart. Pure."""

from collections.abc import Mapping
from typing import Any, Final

from cutgate.runtime.review.comparable import Values, is_number, words_of

SCHEMA: Final = "cutgate.audit-diff/1"
SAME: Final = 1e-9
"""Of measures, mm or deg: what a replay takes for the same, for the last bits of two processors differ."""
TIME_SAME_S: Final = 0.1
TIME_SAME_PART: Final = 0.1
"""Durations and counts that differ by no more than one of these are alike."""
_EXACT: Final = frozenset({"log", "record 0", "robot", "site", "plan", "path", "registration", "collected"})
"""Sections of what was given: the same to the last digit, or different."""
_SENTENCES: Final = frozenset({("outcome", "outcome")})
"""Values that are sentences with measured numbers in them."""

Sections = Mapping[str, Values]


def difference(first: Sections, second: Sections) -> list[dict[str, Any]]:
    """Each section with how many values were compared and those that differ.

    Args:
        first: as ``comparable`` makes it.
        second: of the other session.

    Returns:
        In the order of the sections: ``section``, ``compared``, and ``differences`` of ``what``, ``a``, ``b``; a value
        that one session does not have is missing there.
    """
    return [_section(name, first.get(name, {}), second.get(name, {})) for name in _together(first, second)]


def equal(found: list[dict[str, Any]]) -> bool:
    """Whether nothing that counts differs."""
    return not any(section["differences"] for section in found)


def time_difference(first: Values, second: Values) -> list[dict[str, Any]]:
    """Times and counts of both, ``what``, ``a``, ``b``, and whether they are ``alike``."""
    found = []
    for name in _together(first, second):
        sides = _sides(name, first, second)
        alike = len(sides) == 2 and _alike(sides["a"], sides["b"])
        found.append({"what": name, **sides, "alike": alike})
    return found


def _section(name: str, first: Values, second: Values) -> dict[str, Any]:
    differences = []
    keys = _together(first, second)
    for key in keys:
        sides = _sides(key, first, second)
        if len(sides) < 2 or not _same(name, key, sides["a"], sides["b"]):
            differences.append({"what": key, **sides})
    return {"section": name, "compared": len(keys), "differences": differences}


def _sides(key: str, first: Values, second: Values) -> dict[str, Any]:
    return {side: values[key] for side, values in (("a", first), ("b", second)) if key in values}


def _together(first: Mapping[str, Any], second: Mapping[str, Any]) -> list[str]:
    """The names of both, in the order of the first, then what only the second has."""
    return [*first, *(name for name in second if name not in first)]


def _same(section: str, key: str, a: Any, b: Any) -> bool:
    if (section, key) in _SENTENCES and isinstance(a, str) and isinstance(b, str):
        return words_of(a) == words_of(b)
    if is_number(a) and is_number(b) and section not in _EXACT:
        return a == b or abs(a - b) <= SAME
    return type(a) is type(b) and bool(a == b) if isinstance(a, bool) or isinstance(b, bool) else bool(a == b)


def _alike(a: float, b: float) -> bool:
    """Whether two durations, or two counts, are as good as equal."""
    apart = abs(a - b)
    small = TIME_SAME_S if isinstance(a, float) or isinstance(b, float) else 0.0
    return apart <= small or apart <= TIME_SAME_PART * max(abs(a), abs(b))
