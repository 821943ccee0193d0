"""Tables of numbers that never lose a digit: they leave out columns, and become lines, before one would be cut."""

from collections.abc import Sequence
from dataclasses import dataclass

from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

Cell = str | Text
_WIDE = 10_000


@dataclass(frozen=True)
class Fitting:
    """A table without lines between its cells.

    Attributes:
        columns: the heads; what has none still has its place.
        rows: as many cells each.
        numbers: heads of the columns that are right-aligned.
        dispensable: heads of those that are left out where the width is too small for all.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    numbers: Sequence[str] = ()
    dispensable: Sequence[str] = ()

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """The table that fits, else a line for each row, which may be broken between its words."""
        for left_out in ((), tuple(self.dispensable)):
            table = self._table(left_out)
            needed = Measurement.get(console, options.update(max_width=_WIDE), table).maximum
            if needed <= options.max_width:
                yield table
                return
        for row in self.rows:
            first, *rest = zip(self.columns, row, strict=True)
            told = [Text.assemble(f"{head} " if head else "", cell) for head, cell in rest if str(cell)]
            yield Text.assemble(first[1], ": ", Text(", ").join(told))

    def _table(self, left_out: Sequence[str]) -> Table:
        kept = [number for number, head in enumerate(self.columns) if head not in left_out]
        table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
        for number in kept:
            head = self.columns[number]
            table.add_column(head, justify="right" if head in self.numbers else "left", no_wrap=True)
        for row in self.rows:
            table.add_row(*(row[number] for number in kept))
        return table
