"""Writes ``docs/state-machines.md``: ``python -m docs.make_state_machines [FILE]``.

Nothing on that page is written down twice. Its edges are those the real ``step`` functions take from every state that
is reached, breadth first, from power-up with the events of the tests' builders; its tables are read from the tables of
the code. The same page comes out on every run.
"""
# ruff: noqa: INP001

import sys
from pathlib import Path
from typing import Final

from cutgate.firmware_sim import rules
from cutgate.firmware_sim import state as controller_state
from cutgate.protocol.states import ControllerState
from cutgate.runtime.interlock import state as interlock_state
from cutgate.runtime.interlock.phases import ENDED
from cutgate.runtime.interlock.state import Phase
from docs.state_machines.controller import controller_edges
from docs.state_machines.interlock import STOPS, runtime_edges
from docs.state_machines.interlock_tables import permissive_table, phases, tracking_table
from docs.state_machines.pictures import endings, picture
from docs.state_machines.rule_tables import rule_table
from docs.state_machines.tables import own_transitions, shared_transitions
from docs.state_machines.texts import (
    CONTROLLER_STOPS,
    CONTROLLER_WAY,
    INTRODUCTION,
    OWN,
    PERMISSIVES,
    PHASES_TEXT,
    RULES,
    RUNTIME_ENDS,
    RUNTIME_HELD,
    RUNTIME_WAY,
    TRACKING,
)

PAGE: Final = Path(__file__).parent / "state-machines.md"
C: Final = ControllerState
HELD: Final = frozenset({Phase.HELD, Phase.NONCE_RESET, Phase.AUTHORISING_RESET, Phase.RESETTING})


def page() -> str:
    """The whole page."""
    runtime, controller = runtime_edges(), controller_edges()
    stops = {phase.name for phase in STOPS}
    held = {phase.name for phase in HELD}
    onward = [edge for edge in runtime if edge.target not in stops and edge.source not in stops]
    live = [phase.name for phase in Phase if phase not in ENDED]
    resting = {C.INHIBITED.name, C.FAULT.name}
    forward = [edge for edge in controller if edge.target not in resting]
    sections = [
        INTRODUCTION,
        "## The runtime's interlock\n",
        "### The way to the cut\n",
        RUNTIME_WAY,
        picture(
            (edge for edge in onward if not {edge.source, edge.target} & held),
            first=Phase.WAITING.name,
            last=[Phase.DONE.name],
        ),
        "### A controller that is held\n",
        RUNTIME_HELD,
        picture(edge for edge in onward if {edge.source, edge.target} & held),
        "### How a session ends\n",
        RUNTIME_ENDS,
        endings(runtime, stops),
        "### Phases, deadlines and what a missed one means\n",
        PHASES_TEXT,
        phases(),
        "### What one phase answers to\n",
        OWN,
        own_transitions(runtime),
        "### What every other phase answers\n",
        shared_transitions(runtime, live, interlock_state.Event),
        "### Permissives\n",
        PERMISSIVES,
        permissive_table(),
        "### The tracking monitor\n",
        TRACKING,
        tracking_table(),
        "## The controller\n",
        "### The way to the cut and out of a latched fault\n",
        CONTROLLER_WAY,
        picture(forward, first=C.INHIBITED.name),
        "### How it stops\n",
        CONTROLLER_STOPS,
        endings(controller, resting),
        "### What one state answers to\n",
        own_transitions(controller),
        "### What every other state answers\n",
        shared_transitions(controller, [state.name for state in C], controller_state.Event),
        "### Why a session is refused\n",
        RULES,
        rule_table(rules.OPEN_RULES),
        "### Why an acknowledgement is refused\n",
        rule_table(rules.ACKNOWLEDGE_RULES),
        "### Why a permit is refused\n",
        rule_table(rules.PERMIT_RULES),
        "### Why a start is refused\n",
        rule_table(rules.START_RULES),
        "### Why a reset is refused\n",
        rule_table(rules.RESET_RULES),
    ]
    return "\n".join(sections)


def main(target: Path = PAGE) -> None:
    """Write the page."""
    target.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main(*(Path(name) for name in sys.argv[1:]))
