"""docs/doctor.md is true of the tables of checks."""

import re
from pathlib import Path

import pytest

from cutgate.runtime.doctor.finding import Condition
from cutgate.runtime.doctor.installation import INSTALLATION
from cutgate.runtime.doctor.judges.can_bus import QUEUE_MAX
from cutgate.runtime.doctor.machine import MACHINE
from cutgate.runtime.doctor.probes import can_bus, files, latency

PAGE = (Path(__file__).parents[2] / "docs" / "doctor.md").read_text(encoding="utf-8")
ASKED = PAGE.partition("## What is looked at")[2].partition("## What it does")[0]
SPELT = {"packages": "package ...", "CAN interfaces": "CAN interface ..."}
"""What is a line for each package or interface."""


@pytest.mark.parametrize("name", sorted({check.name for check in (*INSTALLATION, *MACHINE)}))
def test_every_check_has_its_row(name):
    firsts = [row.split("|")[1] for row in ASKED.splitlines() if row.startswith("| ")]
    assert any(SPELT.get(name, name) in first for first in firsts)


@pytest.mark.parametrize("state", Condition)
def test_every_state_is_explained(state):
    assert f"| `{state}` |" in PAGE


def test_bounds_are_those_of_the_code():
    assert f"`txqueuelen` over {QUEUE_MAX} " in PAGE
    assert f"worst of {files.WRITES} `fdatasync`" in PAGE
    assert f"worst of {latency.CYCLES} cycles of {1000 * latency.CYCLE_S:g} ms" in PAGE
    assert f"`ip` is given {can_bus.IP_S:g} s" in PAGE
    assert f"the disk {files.DISK_S:g} s" in PAGE
    assert f"the loop {latency.UNTIL_S:g} s" in PAGE
    assert files.WRITES * files.WRITE_BYTES < 82_000
    assert f"`{files.BEGIN}`" in PAGE


def test_the_output_shown_counts_what_it_shows():
    shown = PAGE.partition("```text\n")[2].partition("```")[0].partition("\nWhat to do\n")
    states = [
        line.split()[0] for line in shown[0].splitlines() if re.match(r"(ok|unknown|warning|FAIL) ", line)
    ]
    told = ", ".join(f"{states.count(state)} {state}" for state in Condition if state in states)
    assert shown[2].splitlines()[-1] == f"{len(states)} checks: {told}"
