"""Writes ``runtime/audit/recomputed/transitions.json``: ``python -m docs.make_transitions [FILE]``.

The tables of both sides as data that a log is held against (``cutgate audit replay``). Written anew after a change that
is meant, and read in the change's difference: what stands there is what a log may show.
"""
# ruff: noqa: INP001

import json
import sys
from pathlib import Path
from typing import Any, Final

from docs.state_machines.transitions import controller_rows, listed_permissives, runtime_rows

FILE: Final = Path(__file__).parents[1] / "runtime" / "audit" / "recomputed" / "transitions.json"


def content() -> str:
    """The file: one row a line."""
    rows = ",\n".join(map(json.dumps, runtime_rows()))
    parts = [
        f'"permissives": {_lines(listed_permissives())}',
        f'"controller": {_lines(controller_rows())}',
        f'"runtime": [\n{rows}\n]',
    ]
    return "{\n" + ",\n".join(parts) + "\n}\n"


def _lines(entries: dict[str, Any]) -> str:
    lines = ",\n".join(f"{json.dumps(key)}: {json.dumps(value)}" for key, value in entries.items())
    return f"{{\n{lines}\n}}"


def main(target: Path = FILE) -> None:
    """Write the file."""
    target.write_text(content(), encoding="utf-8")


if __name__ == "__main__":
    main(*(Path(name) for name in sys.argv[1:]))
