"""Verdicts side by side: how each boundary's clearance changed from one registration to the next."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from cutgate.runtime.review.show import BAD, GOOD


def print_comparison(console: Console, verdicts: Sequence[Mapping[str, Any]], names: Sequence[str]) -> None:
    """A table of certified clearances, one column per verdict document.

    Args:
        console: where to.
        verdicts: documents as ``cutgate verify --json`` prints them.
        names: the columns' heads.
    """
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    table.add_column("certified clearance of the whole path")
    for name in names[: len(verdicts)]:
        table.add_column(name, justify="right")
    table.add_column("required", justify="right")
    table.add_column("unit")
    for boundary in verdicts[-1]["boundaries"]:
        cells = [_cell(verdict["boundaries"].get(boundary)) for verdict in verdicts]
        unit = verdicts[-1]["boundaries"][boundary]["unit"]
        required = verdicts[-1]["deadband"]["arm_mm" if unit == "mm" else "wrist_deg"]
        table.add_row(boundary, *cells, f"{required:.3f}", unit)
    console.print(table)


def _cell(entry: Mapping[str, Any] | None) -> Text:
    if entry is None or entry["certified"] is None:
        return Text("undefined", style=BAD)
    return Text(f"{entry['certified']:.3f}", style=BAD if entry["violated"] else GOOD)
