"""Every fault of the simulated controller stands in its table with what happens and how a session ends."""

import re
from pathlib import Path

from cutgate.firmware_sim.faults import FaultName

PAGE = Path(__file__).parents[2] / "docs" / "controllers.md"


def test_the_table_names_every_fault_once_and_no_other():
    table = PAGE.read_text(encoding="utf-8").split("<!-- faults: ")[1].split("<!-- end of faults")[0]
    rows = [row.split("|")[1:-1] for row in table.splitlines() if row.startswith("| `")]
    named = [name for row in rows for name in re.findall(r"`([a-z-]+)`", row[0])]
    assert sorted(named) == sorted(FaultName)
    assert all(len(row) == 3 and all(cell.strip() for cell in row) for row in rows)
