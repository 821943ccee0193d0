"""The frozen tables are the code's: what the file says, and what falls together in it."""

from dataclasses import replace
from itertools import product
from random import Random

import pytest

from cutgate.runtime.audit.recomputed.transitions import (
    SILENT,
    STAYS,
    VIEW_PARTS,
    HeartbeatView,
    StepTaken,
    data,
    transitions,
)
from cutgate.runtime.interlock.state import Phase
from docs.make_transitions import main
from docs.state_machines.transitions import boxes, events_of, row_of, states_of
from tests.runtime.interlock import builders

TABLE = transitions()


def test_the_file_is_what_the_code_does(tmp_path):
    """Whoever changes a table writes it anew, and reads what has changed: ``python -m docs.make_transitions``."""
    main(tmp_path / "new.json")
    assert (tmp_path / "new.json").read_bytes() == data(), "run: python -m docs.make_transitions, and read it"


def altered_in_two_ways(phase, number, draw):
    """States of this phase that differ from the sound one in what two of the file's states differ in."""
    sound = builders.in_phase(phase)
    changes = [
        {name: value for name, value in vars(state).items() if getattr(sound, name) != value}
        for state, _ in states_of(phase)
    ]
    for _ in range(number):
        first, second = draw.sample(changes, 2)
        yield replace(sound, **first, **{name: value for name, value in second.items() if name not in first})


@pytest.mark.slow
@pytest.mark.parametrize("phase", Phase)
def test_no_step_from_a_state_that_is_altered_in_two_ways_is_refused(phase):
    """The file's rows come from states that are altered in one; nothing new comes of two."""
    for state in altered_in_two_ways(phase, 10, Random(str(phase))):
        for event, after_s in events_of(state, every_view=True):
            (on, to, *rest), view = row_of(state, event, builders.NOW + after_s)
            taken = StepTaken(str(phase) if to == STAYS else to, *rest)
            if taken.permissives == SILENT:
                assert view is None or TABLE.silent(str(phase), view), (phase, on, view)
            else:
                assert TABLE.step(str(phase), on, view, taken) is None, (phase, on, view, taken)


def test_views_fall_together_without_losing_or_adding_one():
    views = {
        HeartbeatView(*parts) for parts in product(*VIEW_PARTS) if parts[0] == "DONE" or parts[3] == "held"
    }
    found = boxes(views)
    covered = {HeartbeatView(*parts) for box in found if box for parts in product(*box)}
    assert covered == views
    assert len(found) < len(views) / 10
