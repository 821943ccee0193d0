"""Two sessions side by side on a page: what differs in tables, section by section, what is equal in a line."""

from collections.abc import Mapping
from typing import Any

from cutgate.runtime.review.report.markup import Markup, joined, table, tag
from cutgate.runtime.review.show_difference import ABSENT, decimals_of, value_words


def section(document: Mapping[str, Any]) -> Markup:
    """The whole section.

    Args:
        document: as ``audit diff --json`` has it.
    """
    sections = document["sections"]
    compared = sum(one["compared"] for one in sections)
    differ = sum(len(one["differences"]) for one in sections)
    if document["equal"]:
        headline = f"EQUAL: none of {compared} values differs."
    else:
        headline = f"DIFFERENT: {differ} of {compared} values."
    different = [_differences(one) for one in sections if one["differences"]]
    same = [f"{one['section']} ({one['compared']})" for one in sections if not one["differences"]]
    equal = tag("p", f"Equal, with the number of their values: {', '.join(same)}.") if same else Markup()
    return joined([tag("p", headline, class_="headline"), *different, equal, _timing(document["timing"])])


def _differences(one: Mapping[str, Any]) -> Markup:
    """The values of a section that differ; of one that one session alone has, that."""
    differences, compared = one["differences"], one["compared"]
    only = {side for side in ("a", "b") if all(set(entry) == {"what", side} for entry in differences)}
    if only and len(differences) == compared:
        name = "first" if only == {"a"} else "second"
        return tag("p", f"{one['section']}: only in the {name} session ({compared} values).")
    title = tag("h3", f"{one['section']}: {len(differences)} of {compared} values")
    return joined([title, _table(differences)])


def _timing(entries: list[dict[str, Any]]) -> Markup:
    """Times and counts, those that are alike as well: a page has room for them."""
    if not entries:
        return Markup()
    title = tag("h3", "Timing, which makes no sessions different")
    return joined([title, _table(entries)])


def _table(entries: list[dict[str, Any]]) -> Markup:
    return table(
        ("value", "first", "second"), [(entry["what"], *_sides(entry)) for entry in entries], class_="pair"
    )


def _sides(entry: Mapping[str, Any]) -> list[object]:
    decimals = decimals_of(entry)
    return [value_words(entry[side], decimals) if side in entry else tag("em", ABSENT) for side in ("a", "b")]
