"""Faults on demand: NAME@STATE, and nothing else."""

import pytest

from cutgate.firmware_sim.faults import FaultName, FaultSpec
from cutgate.protocol.states import ControllerState


@pytest.mark.parametrize("state", list(ControllerState))
@pytest.mark.parametrize("name", list(FaultName))
def test_every_fault_can_happen_in_every_state(name, state):
    assert FaultSpec.parse(f"{name}@{state.name.lower()}") == FaultSpec(name, state)


def test_a_fault_without_a_state_happens_when_a_path_is_loaded():
    assert FaultSpec.parse("hang") == FaultSpec(FaultName.HANG, ControllerState.LOADED)


@pytest.mark.parametrize("text", ["", "explode@loaded", "HANG@loaded", "@loaded", " hang@loaded"])
def test_an_unknown_fault_is_refused_with_those_there_are(text):
    with pytest.raises(ValueError, match="use one of flip-path-bit, off-start, hang"):
        FaultSpec.parse(text)


@pytest.mark.parametrize("text", ["hang@", "hang@LOADED", "hang@nowhere", "hang@loaded@done"])
def test_an_unknown_state_is_refused_with_those_there_are(text):
    with pytest.raises(ValueError, match="state must be one of inhibited, open, loaded"):
        FaultSpec.parse(text)
