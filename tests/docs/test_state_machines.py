"""The page of the state machines: made from the code by one script, current, and complete."""

import pytest

from cutgate.firmware_sim import table as controller_table
from cutgate.protocol.states import ControllerState
from cutgate.runtime.interlock import table as interlock_table
from cutgate.runtime.interlock.phases import ENDED
from cutgate.runtime.interlock.state import Phase
from docs.make_state_machines import PAGE, main
from docs.state_machines.controller import controller_edges
from docs.state_machines.interlock import runtime_edges
from docs.state_machines.pictures import picture
from tests.runtime.interlock.test_invariants import _successors

pytestmark = pytest.mark.slow


def test_the_page_is_the_scripts(tmp_path):
    main(tmp_path / "new.md")
    assert PAGE.read_text(encoding="utf-8") == (tmp_path / "new.md").read_text(encoding="utf-8"), (
        "run: make docs"
    )


def test_every_entry_of_the_interlocks_table_was_taken():
    own = {(edge.source, edge.event) for edge in runtime_edges() if edge.own}
    assert own == {(phase.name, event.__name__) for phase, event in interlock_table.TABLE}
    shared = {(edge.source, edge.event) for edge in runtime_edges() if not edge.own}
    every = {(phase, event) for phase in Phase if phase not in ENDED for event in interlock_table.EVERYWHERE}
    assert shared == {(phase.name, event.__name__) for phase, event in every - set(interlock_table.TABLE)}


def test_every_entry_of_the_controllers_table_was_taken():
    own = {(edge.source, edge.event) for edge in controller_edges() if edge.own}
    assert own == {(state.name, event.__name__) for state, event in controller_table.TABLE}
    shared = {(edge.source, edge.event) for edge in controller_edges() if not edge.own}
    every = {(state, event) for state in ControllerState for event in controller_table.EVERYWHERE}
    assert shared == {(state.name, event.__name__) for state, event in every - set(controller_table.TABLE)}


def test_another_search_finds_no_other_way_between_phases():
    """The exploration of the interlock's invariants follows other states with fewer events."""
    drawn = {(edge.source, edge.target) for edge in runtime_edges()}
    found = {(before.name, after.name) for before, reached in _successors().items() for after in reached}
    assert {way for way in found if Phase[way[0]] not in ENDED} <= drawn


def test_a_picture_names_event_case_and_what_leaves():
    (edge,) = [edge for edge in runtime_edges() if (edge.source, edge.target) == ("STARTING", "CUTTING")]
    assert "STARTING --> CUTTING : HeartbeatReceived (expected state)\n" in picture([edge])
