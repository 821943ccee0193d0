"""Faults on demand: NAME@STATE and nothing else, each once, and what comes of it."""

from dataclasses import replace

import pytest

from cutgate.firmware_sim.faults import FaultName, Faults, FaultSpec, happen, masquerade
from cutgate.firmware_sim.plant import BlockError, StoredPath
from cutgate.firmware_sim.reports import heartbeat
from cutgate.protocol.e2e import intact
from cutgate.protocol.frames import DATA_IDS, IDS, ControllerHeartbeat, RuntimeHeartbeat, decode_frame
from cutgate.protocol.records import UNIT, Limits, block_of_pose
from cutgate.protocol.states import ControllerState, RuntimeCode
from tests.altering import altered
from tests.firmware_sim.arms import PATH, pocket
from tests.firmware_sim.controllers import LIMITS, LOADED, POWERED_UP


@pytest.mark.parametrize("state", list(ControllerState))
@pytest.mark.parametrize("name", list(FaultName))
def test_every_fault_can_happen_in_every_state(name, state):
    assert FaultSpec.parse(f"{name}@{state.name.lower()}") == FaultSpec(name, state)


@pytest.mark.parametrize("text", ["hang@loaded", "flip-path-bit@cutting"])
def test_a_fault_is_written_as_it_is_read(text):
    assert str(FaultSpec.parse(text)) == text


def test_a_fault_without_a_state_happens_when_a_path_is_loaded():
    assert FaultSpec.parse("hang") == FaultSpec(FaultName.HANG, ControllerState.LOADED)


def test_a_fault_that_was_asked_for_stays_the_same():
    assert FaultSpec.__dataclass_params__.frozen


@pytest.mark.parametrize("text", ["", "explode@loaded", "HANG@loaded", "@loaded", " hang@loaded"])
def test_an_unknown_fault_is_refused_with_those_there_are(text):
    with pytest.raises(ValueError, match="use one of flip-path-bit, off-start, hang"):
        FaultSpec.parse(text)


@pytest.mark.parametrize("text", ["hang@", "hang@LOADED", "hang@nowhere", "hang@loaded@done"])
def test_an_unknown_state_is_refused_with_those_there_are(text):
    with pytest.raises(ValueError, match="state must be one of inhibited, open, loaded"):
        FaultSpec.parse(text)


# ---------------------------------------------------------------- when they happen, and what comes of them


def test_a_fault_is_due_once_when_its_state_is_reached():
    faults = Faults(map(FaultSpec.parse, ("hang@open", "rush@loaded", "drift@open", "hang@open")))
    assert faults.due(ControllerState.INHIBITED) == []
    assert faults.due(ControllerState.OPEN) == [FaultName.HANG, FaultName.DRIFT, FaultName.HANG]
    assert faults.due(ControllerState.OPEN) == []
    assert faults.due(ControllerState.LOADED) == [FaultName.RUSH]
    assert faults.due(ControllerState.LOADED) == []


class RecordingArm:
    """What is asked of an arm."""

    def __init__(self):
        self.path, self.asked = None, []

    def __getattr__(self, name):
        return lambda *arguments: self.asked.append((name, *arguments))


@pytest.mark.parametrize(
    ("name", "asked"),
    [
        (FaultName.OFF_START, ("push_aside",)),
        (FaultName.DRIFT, ("drift", 77.0)),
        (FaultName.FREEZE, ("freeze",)),
        (FaultName.RUSH, ("rush",)),
        (FaultName.WEAK_DRIVE, ("weaken",)),
    ],
)
def test_what_is_wrong_with_the_arm_the_controller_does_not_notice(name, asked):
    arm = RecordingArm()
    assert happen(name, LOADED, arm, 77.0) == LOADED
    assert arm.asked == [asked]


LOOPS_OWN = (
    FaultName.HANG,
    FaultName.SILENT,
    FaultName.REBOOT,
    FaultName.BONE_MOTION,
    FaultName.POWER_LOSS,
    FaultName.TORN_WRITE,
    FaultName.UNANSWERED_WRITE,
    FaultName.FLIP_MEMORY_BIT,
    FaultName.SLOW,
    FaultName.HUNG,
    FaultName.SECOND_CONTROLLER,
    FaultName.SECOND_RUNTIME,
)


@pytest.mark.parametrize("name", LOOPS_OWN)
def test_what_the_loop_does_itself_changes_nothing_here(name):
    arm = RecordingArm()
    assert happen(name, LOADED, arm, 77.0) == LOADED
    assert (arm.asked, arm.path) == ([], None)


def test_a_changed_limit_is_one_degree_narrower_and_nothing_else():
    after = happen(FaultName.CHANGE_LIMIT, LOADED, RecordingArm(), 77.0)
    upper = (LIMITS.q_max_u[0] - UNIT, *LIMITS.q_max_u[1:])
    assert after == altered(LOADED, "holdings.limits", replace(LIMITS, q_max_u=upper).body())


def test_a_flipped_bit_of_a_limit_is_another_digest_and_a_limit_all_the_same():
    after = happen(FaultName.FLIP_LIMIT_BIT, LOADED, RecordingArm(), 77.0)
    found = Limits.parse(after.holdings.limits)
    assert found == replace(LIMITS, q_max_u=(LIMITS.q_max_u[0] ^ 1, *LIMITS.q_max_u[1:]))
    assert after == altered(LOADED, "holdings.limits", found.body())


class HeardLink:
    """A link in a session, as far as who listens to its bus knows it."""

    counter, echo, tag = 255, 40, 0x12345678


def test_who_says_the_heartbeat_of_another_node_has_all_of_it_but_the_tag():
    link = HeardLink()
    can_id, data = masquerade(FaultName.SECOND_CONTROLLER, LOADED, link)
    assert (can_id, data[2]) == (IDS[ControllerHeartbeat], 0)
    assert intact(data, DATA_IDS[can_id], link.tag)
    assert decode_frame(can_id, data) == heartbeat(LOADED)
    can_id, data = masquerade(FaultName.SECOND_RUNTIME, LOADED, link)
    assert (can_id, data[2]) == (IDS[RuntimeHeartbeat], 41)
    assert intact(data, DATA_IDS[can_id], link.tag)
    assert decode_frame(can_id, data) == RuntimeHeartbeat(RuntimeCode.CUT, LOADED.epoch)


@pytest.mark.parametrize("path", [PATH, pocket(poses=500, length_mm=1200.0)])
def test_a_flipped_bit_is_the_last_of_the_stored_path_under_the_crcs_as_received(path):
    stored, arm = path.body(), RecordingArm()
    after = happen(FaultName.FLIP_PATH_BIT, altered(LOADED, "holdings.path", stored), arm, 77.0)
    held = after.holdings.path
    assert after == altered(LOADED, "holdings.path", held)
    assert held[:-1] == stored[:-1]
    assert held[-1] ^ stored[-1] == 1
    assert len(arm.path) == len(path)
    assert (arm.path.elbow, arm.path.feed_mm_s) == (path.elbow, path.feed_mm_s)
    as_received = StoredPath.of(stored)
    for pose in range(len(path)):
        if block_of_pose(pose) < block_of_pose(len(path) - 1):
            assert arm.path.pose(pose) == as_received.pose(pose)
    with pytest.raises(BlockError):
        arm.path.pose(len(path) - 1)


def test_without_a_path_no_bit_flips():
    arm = RecordingArm()
    assert happen(FaultName.FLIP_PATH_BIT, POWERED_UP, arm, 77.0) == POWERED_UP
    assert arm.path is None
