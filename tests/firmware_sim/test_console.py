"""The person at the controller: every operator command, and every line that is read there."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from cutgate.firmware_sim import console
from cutgate.firmware_sim.console import ConsoleCommand
from cutgate.firmware_sim.mechanical import Approached
from cutgate.firmware_sim.state import BoneMoved, Inputs, InputsChanged, LimitsChanged
from cutgate.protocol import records
from cutgate.protocol.states import ControllerState, Refusal, StopCause
from tests.firmware_sim.controllers import FINGERPRINT, LIMITS, POWERED_UP

PRESSED_AND_STOPPED = replace(POWERED_UP, inputs=Inputs(device_pressed=True, emergency_stop_clear=False))


@pytest.mark.parametrize(
    ("command", "controller", "line", "inputs"),
    [
        (ConsoleCommand.HOLD, POWERED_UP, "enabling device pressed", Inputs(True, True)),
        (ConsoleCommand.HOLD, PRESSED_AND_STOPPED, "enabling device pressed", Inputs(True, False)),
        (ConsoleCommand.RELEASE, POWERED_UP, "enabling device released", Inputs(False, True)),
        (ConsoleCommand.RELEASE, PRESSED_AND_STOPPED, "enabling device released", Inputs(False, False)),
        (ConsoleCommand.ESTOP, POWERED_UP, "emergency stop pressed", Inputs(False, False)),
        (ConsoleCommand.ESTOP, PRESSED_AND_STOPPED, "emergency stop released", Inputs(True, True)),
    ],
)
def test_a_wired_input_changes_alone_and_is_confirmed(command, controller, line, inputs):
    assert console.event_of(command, controller) == (line, InputsChanged(inputs))


def test_bone_motion_is_what_the_sensor_would_say():
    assert console.event_of(ConsoleCommand.BONE_MOTION, POWERED_UP) == ("bone motion reported", BoneMoved())


def test_a_changed_limit_is_one_degree_narrower():
    upper = (LIMITS.q_max_u[0] - records.UNIT, *LIMITS.q_max_u[1:])
    narrow = LimitsChanged(replace(LIMITS, q_max_u=upper).body())
    assert console.event_of(ConsoleCommand.LIMIT, POWERED_UP) == ("a joint limit was changed", narrow)


def test_the_operator_commands_are_these():
    assert list(ConsoleCommand) == ["hold", "release", "estop", "bone-motion", "limit"]


def test_what_is_no_operator_command_is_answered_with_those_there_are():
    assert (
        console.not_known("hop")
        == "'hop' is no command here; say one of hold, release, estop, bone-motion, limit"
    )
    assert console.not_known("\x1b[2J").startswith(r"'\x1b[2J' is no command here")


def test_the_state_is_shown_with_the_cause_that_stands():
    assert console.state_line(POWERED_UP) == "state INHIBITED"
    stopped = replace(POWERED_UP, state=ControllerState.FAULT, cause=StopCause.SECOND_NODE)
    assert console.state_line(stopped) == "state FAULT (SECOND_NODE)"


def test_what_was_executed_is_shown_in_whole_percent():
    assert console.executed_line(20, 0.6789) == "20 segments executed, peak joint speed 68% of its limit"


@pytest.mark.parametrize(
    ("refusal", "line"),
    [
        (Refusal.NO_NONCE, "refused: NO_NONCE"),
        (
            Refusal.PROTOCOL_VERSION,
            "refused: PROTOCOL_VERSION: this controller speaks version 4 of the protocol; update it and the runtime to one release",
        ),
        (
            Refusal.MAC_INVALID,
            f"refused: MAC_INVALID: the runtime has another key file; this one's fingerprint is {FINGERPRINT}, compare it with the runtime's",
        ),
        (
            Refusal.EMERGENCY_STOP,
            "refused: EMERGENCY_STOP: the emergency stop is pressed; say estop to release it",
        ),
        (
            Refusal.DEVICE_NOT_RELEASED_AND_PRESSED,
            "refused: DEVICE_NOT_RELEASED_AND_PRESSED: say release, then hold",
        ),
    ],
)
def test_a_refusal_says_what_the_person_at_the_controller_can_do(refusal, line):
    assert console.refusal_line(refusal, POWERED_UP.identity) == line


def test_every_refusal_is_named():
    for refusal in Refusal:
        assert console.refusal_line(refusal, POWERED_UP.identity).startswith(f"refused: {refusal.name}")


@pytest.mark.parametrize(
    ("off_mm", "more"),
    [
        (0.0, []),
        (0.25, ["the true wrist centre was up to 0.250 mm from where the reported calibration has it"]),
    ],
)
def test_the_least_distances_of_a_cut_are_told_with_units_and_segments(off_mm, more):
    least = {"outer": Approached(12.5, 3), "roll": Approached(4.25, 7)}
    assert console.distance_lines(SimpleNamespace(least=least, off_mm=off_mm)) == [
        "least distances of the true arm in the cut: outer 12.500 mm (segment 3), roll 4.250 deg (segment 7)",
        *more,
    ]
