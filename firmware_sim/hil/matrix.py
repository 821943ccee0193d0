"""The fault matrix: which faults were tried, how each session ended, and whether the test agreed. Pure."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from html import escape
from typing import Final

from cutgate.config.screen import printable

SUFFIXES: Final = (".html", ".md")
_HEADINGS: Final = ("test", "faults", "how it ended", "health", "outcome")
_PAGE: Final = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>cutgate: fault matrix</title>
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'">
<style>
body {{ font: 15px/1.4 system-ui, sans-serif; margin: 2em; color: #1a1a1a; background: #fff }}
table {{ border-collapse: collapse }}
th, td {{ border: 1px solid #bbb; padding: .3em .6em; text-align: left; vertical-align: top }}
code {{ display: block }}
.failed {{ background: #fbe3e0 }}
</style></head><body>
<h1>Fault matrix</h1>
<p>{summary}</p>
<table><tr>{headings}</tr>
{rows}
</table></body></html>
"""


@dataclass(frozen=True)
class MatrixRow:
    """One test that has held sessions.

    Attributes:
        test: its name as pytest has it.
        faults: lines of the fault language.
        ended: how its sessions ended.
        health: what the health check found, by name.
        outcome: passed or failed.
    """

    test: str
    faults: tuple[str, ...]
    ended: str
    health: tuple[str, ...]
    outcome: str

    def as_dict(self) -> dict[str, object]:
        """As it travels from a worker of pytest-xdist."""
        return asdict(self)


def page(rows: Sequence[MatrixRow], suffix: str) -> str:
    """The whole page: HTML for ``.html``, else a table in markdown."""
    ordered = sorted(rows, key=lambda row: row.test)
    failed = sum(row.outcome != "passed" for row in ordered)
    faults = len({line for row in ordered for line in row.faults})
    summary = f"{len(ordered)} tests with sessions, {faults} different faults, {failed} tests failed."
    return _html(ordered, summary) if suffix == ".html" else _markdown(ordered, summary)


def _html(rows: Sequence[MatrixRow], summary: str) -> str:
    lines = []
    for row in rows:
        cells = (
            _text(row.test),
            "".join(f"<code>{_text(line)}</code>" for line in row.faults) or "none",
            _text(row.ended),
            _text(", ".join(row.health)),
            _text(row.outcome),
        )
        kind = "" if row.outcome == "passed" else ' class="failed"'
        lines.append(f"<tr{kind}>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    headings = "".join(f"<th>{heading}</th>" for heading in _HEADINGS)
    return _PAGE.format(summary=escape(summary), headings=headings, rows="\n".join(lines))


def _text(text: str) -> str:
    return escape(printable(text))


def _markdown(rows: Sequence[MatrixRow], summary: str) -> str:
    lines = ["# Fault matrix", "", summary, "", f"| {' | '.join(_HEADINGS)} |", "|---" * len(_HEADINGS) + "|"]
    for row in rows:
        faults = ", ".join(row.faults) or "none"
        cells = (row.test, faults, row.ended, ", ".join(row.health), row.outcome)
        lines.append("| " + " | ".join(_cell(cell) for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def _cell(text: str) -> str:
    """Text in a cell: nothing in it ends the cell, is markup or a link."""
    return "".join(f"\\{one}" if one in "\\|`*_<>[]&!#" else one for one in printable(text))
