"""HTML made of data: whatever a log says is escaped once, here, and what was made here is not escaped again."""

import html
from collections.abc import Iterable, Sequence
from typing import Final

from cutgate.config.screen import printable

TEXT_MAX: Final = 2000
"""Characters of one text of a log; the log has all of it."""


class Markup(str):
    """HTML that was made here."""

    __slots__ = ()


def told(value: object) -> Markup:
    """What a log says, as text of a page: no markup, no control characters, nothing that turns the reading direction."""
    if isinstance(value, Markup):
        return value
    text = "" if value is None else str(value)
    shown = text if len(text) <= TEXT_MAX else f"{text[:TEXT_MAX]}..."
    return Markup(html.escape(printable(shown)))


def tag(name: str, *parts: object, **attributes: str | None) -> Markup:
    """An element of these parts.

    Args:
        name: of the element.
        parts: markup, or data, which is escaped.
        attributes: ``class_`` for ``class``, ``_`` for a hyphen; None leaves one out.
    """
    own = "".join(
        f' {key.strip("_").replace("_", "-")}="{told(value)}"'
        for key, value in attributes.items()
        if value is not None
    )
    return Markup(f"<{name}{own}>{''.join(map(told, parts))}</{name}>")


def joined(parts: Iterable[object], between: str = "") -> Markup:
    """Parts one after the other."""
    return Markup(told(between).join(map(told, parts)))


def table(columns: Sequence[str], rows: Iterable[Sequence[object]], **attributes: str | None) -> Markup:
    """A table: a row of headings, and below it each row's cells, of which the first heads its row."""
    head = joined(tag("th", column, scope="col") for column in columns)
    body = joined(
        tag(
            "tr",
            *(tag("td", cell) if number else tag("th", cell, scope="row") for number, cell in enumerate(row)),
        )
        for row in rows
    )
    return tag("table", tag("thead", tag("tr", head)), tag("tbody", body), **attributes)


def listed(texts: Iterable[object], kind: str = "ul") -> Markup:
    """A list of texts; nothing where there are none."""
    items = [tag("li", text) for text in texts]
    return tag(kind, *items) if items else Markup()


def pairs(entries: Iterable[tuple[object, object]], **attributes: str | None) -> Markup:
    """A list of names and what each is; an empty one is left out."""
    parts = [part for name, value in entries if value for part in (tag("dt", name), tag("dd", value))]
    return tag("dl", *parts, **attributes)
