"""``python tools/coverage_whole.py REPORT.json STATEMENTS``: fails where a coverage report measured too little.

A source named wrongly gives a report of no statement at all, and that is 100 %.
"""

import json
import sys
from pathlib import Path


def main(report: Path, least: int) -> int:
    """0 if the report is of at least so many statements, else 1 and a line that says so."""
    counted = json.loads(report.read_text(encoding="utf-8"))["totals"]["num_statements"]
    print(f"{counted} statements measured, at least {least} expected")  # noqa: T201 - a report
    return int(not counted >= least)


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1]), int(sys.argv[2])))
