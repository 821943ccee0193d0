"""Two sessions side by side on a terminal: what differs in a table, what is equal in a line."""

import re
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from typing import Any, Final

from rich.console import Console
from rich.table import Table
from rich.text import Text

from cutgate.config.screen import printable
from cutgate.runtime.review.show import BAD, GOOD

_DIGEST: Final = re.compile(r"[0-9a-f]{64}")
_DIGEST_SHOWN: Final = 16
_VALUE_MAX: Final = 400
"""Characters of one value; all of it is in the JSON document."""
_DECIMALS: Final = (3, 6, 9)
_SECONDS_MAX: Final = 1 << 33
"""Since 1970; a log's clock that is ahead of it is none."""
ABSENT: Final = "(absent)"


def print_difference(console: Console, document: Mapping[str, Any]) -> None:
    """Print the document that ``audit diff --json`` has."""
    for side in ("a", "b"):
        _head(console, side.upper(), document[side])
    sections = document["sections"]
    compared = sum(section["compared"] for section in sections)
    differ = sum(len(section["differences"]) for section in sections)
    console.print()
    if document["equal"]:
        console.print(Text.assemble(("EQUAL", GOOD), f": none of {compared} values differs"))
    else:
        console.print(Text.assemble(("DIFFERENT", BAD), f": {differ} of {compared} values"))
    for section in sections:
        if section["differences"]:
            _section(console, section)
    same = [
        f"{section['section']} ({section['compared']})" for section in sections if not section["differences"]
    ]
    if same and differ:
        console.print()
        console.print(f"Equal, with the number of their values: {', '.join(same)}")
    _timing(console, document["timing"])


def _head(console: Console, name: str, log: Mapping[str, Any]) -> None:
    judgement = printable(str(log["judgement"]))
    style = GOOD if log["judgement"].startswith("OK") else BAD
    seconds = log["opened_ns"] // 1_000_000_000
    moment = datetime.fromtimestamp(seconds, UTC) if 0 < seconds < _SECONDS_MAX else None
    opened = f", opened {moment:%Y-%m-%d %H:%M:%S} UTC" if moment else ""
    console.print(Text.assemble(f"{name}  ", (judgement, style), opened))
    console.print(
        f"   {printable(str(log['log']))}", soft_wrap=True
    )  # never wrapped, so that it can be copied
    for reason in log["reasons"]:
        console.print(f"   {printable(str(reason))}")


def _section(console: Console, section: Mapping[str, Any]) -> None:
    console.print()
    differences, compared = section["differences"], section["compared"]
    only = {side for side in ("a", "b") if all(set(entry) == {"what", side} for entry in differences)}
    if only and len(differences) == compared:  # no table of what there is nothing to hold against
        console.print(Text(f"{section['section']}: only in {only.pop().upper()} ({compared} values)", "bold"))
        return
    console.print(Text(f"{section['section']}: {len(differences)} of {compared} values", "bold"))
    table = _table("value", "A", "B")
    for entry in differences:
        table.add_row(printable(str(entry["what"])), *_cells(entry))
    console.print(table)


def _timing(console: Console, entries: list[dict[str, Any]]) -> None:
    """Times and counts: those that are far apart in a table, the rest in a line."""
    if not entries:
        return
    console.print()
    console.print(Text("Timing, which makes no sessions different", "bold"))
    apart = [entry for entry in entries if not entry["alike"]]
    if apart:
        table = _table("value", "A", "B")
        for entry in apart:
            table.add_row(printable(str(entry["what"])), *_cells(entry))
        console.print(table)
    alike = [printable(str(entry["what"])) for entry in entries if entry["alike"]]
    if alike:
        console.print(f"Alike, within 0.1 s or a tenth: {'; '.join(alike)}")


def _table(*columns: str) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for column in columns:
        table.add_column(column, overflow="fold")  # a digit that is cut off makes another number
    return table


def _cells(entry: Mapping[str, Any]) -> Iterator[Text]:
    """Both values, with as many decimals as it takes to tell them apart."""
    decimals = decimals_of(entry)
    for side in ("a", "b"):
        yield Text(value_words(entry[side], decimals)) if side in entry else Text(ABSENT, "italic")


def decimals_of(entry: Mapping[str, Any]) -> int | None:
    """How many decimals tell both values apart; None for all."""
    sides = [entry.get(side) for side in ("a", "b")]
    return next((d for d in _DECIMALS if len({value_words(one, d) for one in sides}) > 1), None)


def value_words(value: Any, decimals: int | None) -> str:
    """A value in few characters; numbers with so many decimals, or with all."""
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "none"}[value]
    if isinstance(value, float):
        return repr(value) if decimals is None else f"{value:.{decimals}f}"
    if isinstance(value, list):
        return f"[{', '.join(value_words(one, decimals) for one in value)}]"[:_VALUE_MAX]
    text = str(value)
    if _DIGEST.fullmatch(text):
        return text[:_DIGEST_SHOWN]
    return printable(text if len(text) <= _VALUE_MAX else f"{text[:_VALUE_MAX]}...")
