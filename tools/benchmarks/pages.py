"""A page of Markdown tables, printed as it comes and written where asked."""

import argparse
import inspect
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

Rows = Iterator[tuple[str, ...]]
Sections = Mapping[str, Callable[[], Rows]]
"""Title, and what yields the table's head and rows; the docstring stands above the table."""


def document(title: str, about: str, sections: Sections) -> Iterator[str]:
    """The lines of the whole page."""
    yield from (f"# {title}", "", about)
    for name, section in sections.items():
        rows = section()
        head = next(rows)
        said = inspect.cleandoc(section.__doc__ or "").replace("\n\n", "\n")
        yield from ("", f"## {name}", "", said, "", _row(head), _row(("---",) * len(head)))
        yield from map(_row, rows)


def _row(cells: tuple[str, ...]) -> str:
    return "| " + " | ".join(cells) + " |"


def show(lines: Iterator[str], description: str | None) -> None:
    """The command line of a page: print each line as it comes, and write them all with ``--write``."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the page to a file as well")
    file = parser.parse_args().write
    kept = []
    for line in lines:
        print(line, flush=True)
        kept.append(line)
    if file is not None:
        file.write_text("\n".join(kept) + "\n", encoding="utf-8")
