"""The controller's loop by itself: what it does without a runtime, and how it ends.

In a session: test_loop_in_session.py; with a whole runtime: tests/runtime/session.
"""

import math
import os
import select
from dataclasses import replace

import can
import pytest

from cutgate.firmware_sim import memory
from cutgate.firmware_sim.console import ConsoleCommand
from cutgate.firmware_sim.faults import FaultName, FaultSpec
from cutgate.firmware_sim.loop import Options
from cutgate.firmware_sim.path_check import PathCheck
from cutgate.firmware_sim.state import (
    BoneMoved,
    FaultArisen,
    Memory,
    PathChecked,
)
from cutgate.protocol import records
from cutgate.protocol.endpoint import Endpoint, RecordReceived
from cutgate.protocol.frames import CONTROL_IDS, IDS, ControllerFault
from cutgate.protocol.port import RETRY_S
from cutgate.protocol.records import Side
from cutgate.protocol.states import ControllerState, Refusal, StopCause
from tests.firmware_sim.arms import LIMITS, PATH, line_path, pocket
from tests.firmware_sim.bench import KEY
from tests.firmware_sim.controllers import OPENED, PLACE, TAG

HIGH = line_path((500.0, 0.0, 200.0), (500.0, 20.0, 200.0), polar=(30, 30), azimuth=(0, 0))
"""200 mm further along the tool the slide is beyond its upper limit."""


def announced(bench):
    """The announcement that is on the bus, heard whole by a runtime that answers its flow control."""
    runtime = Endpoint(Side.RUNTIME, KEY, heartbeat_s=0.02, timeout_s=0.1, transfer_timeout_s=2.0)
    items, controller = [], bench.process.port.endpoint
    for _ in range(10):
        for message in bench.bus.sent:
            items += runtime.receive(message.arbitration_id, bytes(message.data), now_s=0.0)
        bench.bus.sent.clear()
        for can_id, data in runtime.outgoing():
            controller.receive(can_id, data, now_s=0.0)
        bench.process.port.flush()
    (item,) = [item for item in items if isinstance(item, RecordReceived)]
    return item.record


def test_without_a_session_only_announcements_leave(bench):
    one = bench()
    one.process.run_cycle()
    assert {message.arbitration_id for message in one.bus.sent} == {CONTROL_IDS[1]}
    announce = announced(one)
    assert isinstance(announce, records.Announce)
    assert (announce.serial, announce.state, announce.cause) == (
        "SIM-1",
        ControllerState.INHIBITED,
        StopCause.NONE,
    )
    assert announce.firmware_version == "sim-0.1"


def test_a_time_scale_is_announced(bench):
    one = bench(time_scale=20.0)
    one.process.run_cycle()
    announce = announced(one)
    assert (announce.plant_speed_permille, announce.time_scale) == (20_000, 20.0)


@pytest.mark.parametrize("typed", [True, False])
def test_the_loop_runs_until_it_is_woken_to_end(bench, typed):
    one = bench(typed=typed)
    one.end_after(5)
    one.process.run(one.wake)
    assert one.process.controller.cause is StopCause.OPERATOR_QUIT
    assert one.bus.sent


def test_the_loop_hears_the_terminal_and_its_end(bench):
    one = bench()
    os.write(one.typing, b"hold\nhop\n")

    def hang_up():
        one.descriptors.remove(one.typing)
        os.close(one.typing)

    one.bus.after[3] = hang_up
    one.end_after(9)
    one.process.run(one.wake)
    assert one.process.controller.inputs.device_pressed
    assert one.shown[:2] == [
        "enabling device pressed",
        "'hop' is no command here; say one of hold, release, estop, bone-motion, limit",
    ]
    assert one.process._commands.descriptor is None


def test_the_loop_ends_with_its_bus(bench):
    one = bench()
    one.bus.after[4] = lambda: setattr(one.bus, "broken", True)
    with pytest.raises(can.CanError):
        one.process.run(one.wake)
    assert one.process.controller.cause is StopCause.BUS_FAILED


def test_while_the_bus_takes_no_more_the_loop_turns_again_soon(bench, monkeypatch):
    one = bench(announce_s=5.0)
    monkeypatch.setattr(one.process._cycle, "_clock", lambda: 60.0)
    one.bus.room = 0
    one.process.run_cycle()
    assert one.process.port.waits
    assert one.process._wait_s() == RETRY_S
    one.bus.room = 1
    one.process.run_cycle()
    assert one.process._wait_s() == pytest.approx(5.0)


@pytest.mark.parametrize("fails", [False, True])
def test_the_last_word_is_tried_until_there_is_room(bench, monkeypatch, fails):
    one = bench()
    one.process.controller = _opened(one.process.controller)
    one.process.port.endpoint.use_session(OPENED.session.digest)
    one.process.port.endpoint.open_link(0.0)
    pauses, flush_last = [], one.process.port.flush_last
    one.bus.room = 0

    def pause(seconds):
        pauses.append(seconds)
        one.bus.room = len(pauses) // 3

    monkeypatch.setattr(one.process.port, "flush_last", lambda: flush_last(pause))
    if fails:
        monkeypatch.setattr(one.process._cycle, "late", lambda: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            one.process.run_cycle()
    else:
        os.write(one.waking, b"\0")
        one.process.run(one.wake)
    assert pauses == [RETRY_S] * 3
    assert [message.arbitration_id for message in one.bus.sent] == [IDS[ControllerFault]]


def test_words_change_the_wired_inputs(bench):
    one = bench()
    for command, pressed, clear in (
        (ConsoleCommand.HOLD, True, True),
        (ConsoleCommand.ESTOP, True, False),
        (ConsoleCommand.RELEASE, False, False),
        (ConsoleCommand.ESTOP, False, True),
    ):
        one.process.act(command)
        inputs = one.process.controller.inputs
        assert (inputs.device_pressed, inputs.emergency_stop_clear) == (pressed, clear)
    assert one.process.controller.cause is StopCause.EMERGENCY_STOP


def test_bone_motion_without_a_session_is_due_and_withdraws_nothing_there_is(bench):
    one = bench()
    one.process.act(ConsoleCommand.BONE_MOTION)
    assert one.process.controller.cause is StopCause.BONE_MOVED
    assert memory.load(one.file, now_us=0) == Memory(withdrawal_due=True)


def test_a_changed_limit_is_one_degree_narrower(bench):
    one = bench()
    one.process.act(ConsoleCommand.LIMIT)
    held = records.Limits.parse(one.process.controller.holdings.limits)
    assert held.q_max_u[0] == LIMITS.q_max_u[0] - records.UNIT
    assert held.q_max_u[1:] == LIMITS.q_max_u[1:]
    assert one.process.controller.cause is StopCause.LIMITS_CHANGED


def test_a_withdrawn_registration_is_in_the_memory_before_anything_else_happens(bench):
    one = bench()
    one.process.controller = _stopped(one.process.controller)
    one.process._feed(BoneMoved())
    assert memory.load(one.file, now_us=0).withdrawn == {PLACE}


def failing(monkeypatch, one):
    """The disk fails; what left the controller before each attempt to write."""
    attempts = []

    def fail(path, _memory):
        attempts.append([message.arbitration_id for message in one.bus.sent])
        raise memory.ControllerMemoryError(f"{path}: the memory cannot be written: full")

    monkeypatch.setattr(memory, "save", fail)
    return attempts


def test_a_stop_leaves_before_the_memory_is_written(bench, monkeypatch):
    one = bench()
    attempts = failing(monkeypatch, one)
    one.process.controller = _opened(one.process.controller)
    one.process.port.endpoint.use_session(OPENED.session.digest)
    one.process.port.endpoint.open_link(0.0)
    one.process._feed(FaultArisen(StopCause.SECOND_NODE))
    assert IDS[ControllerFault] in attempts[0]


def test_a_memory_that_cannot_be_written_is_said_once_latches_and_is_written_as_soon_as_it_can_be(
    bench, monkeypatch
):
    one = bench()
    attempts = failing(monkeypatch, one)
    one.process.controller = _stopped(one.process.controller)
    one.process._feed(BoneMoved())
    for _ in range(3):
        one.process.run_cycle()
    controller = one.process.controller
    assert (controller.state, controller.cause) == (ControllerState.FAULT, StopCause.BONE_MOVED)
    assert len(attempts) == 5, "once for the motion, once for the latch, then in every cycle"
    assert len([line for line in one.shown if "cannot be written" in line]) == 1
    monkeypatch.undo()
    one.process.run_cycle()
    assert (
        memory.load(one.file, now_us=0)
        == controller.memory
        == Memory(frozenset({PLACE}), withdrawal_due=True, latched=StopCause.BONE_MOVED)
    )


def test_an_error_of_the_program_itself_is_remembered(bench, monkeypatch):
    one = bench()
    monkeypatch.setattr(one.process, "_move", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        one.process.run_cycle()
    assert memory.load(one.file, now_us=0).latched is StopCause.INTERNAL_ERROR


def test_what_is_remembered_over_a_loss_of_power_is_what_was_written(bench, monkeypatch):
    one = bench()
    one.process.controller = _stopped(one.process.controller)
    one.process._feed(BoneMoved())
    one.process._feed(FaultArisen(StopCause.SECOND_NODE))
    one.process._happen(FaultName.REBOOT)
    controller = one.process.controller
    assert controller.memory == Memory(frozenset({PLACE}), withdrawal_due=True, latched=StopCause.BONE_MOVED)
    assert (controller.state, controller.cause) == (ControllerState.FAULT, StopCause.BONE_MOVED)


def _stopped(controller):
    """A session that a stop has voided."""
    return replace(controller, session=replace(OPENED.session, live=False))


def test_a_stored_path_does_not_move_the_arm(bench):
    one = bench()
    before = one.process.arm.state
    one.process.controller = _opened(one.process.controller)
    one.process._feed(PathChecked(PATH.body(), Refusal.ACCEPTED, 0, None))
    assert one.process.controller.state is ControllerState.LOADED
    assert one.process.arm.state == before


def test_the_arm_stands_where_it_is_told_to(bench):
    joints = (0.1, 0.2, 300.0, 0.4, 0.5)
    assert bench(joints=joints).process.arm.state.joints == joints


def test_an_entry_that_the_arm_cannot_reach_is_said_and_leaves_no_approach(bench):
    """The path itself is accepted: why it cannot be approached is the answer to the permit."""
    for clearance_um, reaches in ((10_000, True), (200_000, False)):
        one = bench()
        opened = _opened(one.process.controller)
        session = replace(opened.session, approach_clearance_um=clearance_um)
        one.process.controller = replace(opened, session=session)
        one.process.port.endpoint.use_session(OPENED.session.digest)
        for block in records.split(HIGH.body()):
            one.process._block(block)
        while one.process.upload.check is not None:
            one.process._continue_check()
        assert one.process.controller.state is ControllerState.LOADED
        assert (one.process.controller.holdings.ends is not None) is reaches
        assert (
            any("no approach: entry pose, 200.000 mm along the tool: q2" in line for line in one.shown)
            is not reaches
        )


def _opened(controller):
    return replace(controller, state=ControllerState.OPEN, session=OPENED.session)


def in_session(one):
    """The bench, with a session open; nothing else of it has happened."""
    one.process.controller = _opened(one.process.controller)
    one.process.port.endpoint.use_session(OPENED.session.digest)
    return one


def test_a_fault_on_the_path_without_a_path_does_nothing(bench):
    one = bench(faults=(FaultSpec(FaultName.FLIP_PATH_BIT, ControllerState.INHIBITED),))
    one.process.run_cycle()
    assert one.shown == ["fault injected: flip-path-bit"]
    assert one.process.controller.holdings.path is None


def test_a_path_of_many_blocks_is_checked_once_it_is_whole(bench):
    one = in_session(bench())
    *blocks, last = records.split(pocket(poses=500, length_mm=1200.0).body())
    assert blocks
    for block in blocks:
        one.process._block(block)
        assert one.process.upload.check is None
    one.process._block(last)
    assert one.process.upload.check is not None


def test_a_record_of_no_session_is_ignored(bench):
    one = bench()
    one.process._record(RecordReceived(records.Collect(), records.Channel.CONTROL, 7, 1, 20, bytes(32)))
    assert one.process.port.endpoint.outgoing() == []


def test_what_is_measured_is_where_the_arm_stands(bench):
    one = bench()
    one.process._measure()
    assert one.process.controller.measured_u == (0, 72_500_000, 250_000_000, 0, 55_000_000)


def test_a_stop_ends_the_check_of_a_path(bench, monkeypatch):
    monkeypatch.setattr("cutgate.firmware_sim.upload.CHECK_POSES_PER_CYCLE", 1)
    one = in_session(bench())
    one.process._block(records.split(PATH.body())[0])
    one.process._feed(FaultArisen(StopCause.OPERATOR_STOP))
    checked = []
    monkeypatch.setattr(PathCheck, "step", lambda _self, count: checked.append(count))
    one.process._continue_check()
    assert not checked


def test_a_path_begun_before_a_stop_is_not_completed_after_it(bench):
    """What lies between may have changed what the controller holds; a path is of one session, from its first block."""
    one = in_session(bench())
    *blocks, last = records.split(pocket(poses=500, length_mm=1200.0).body())
    for block in blocks:
        one.process._block(block)
    one.process._feed(FaultArisen(StopCause.OPERATOR_STOP))
    one.process.controller = _opened(one.process.controller)
    one.process._block(last)
    assert one.process.upload.check is None
    assert "path refused" in one.shown[-1]


def test_where_the_arm_stands_is_measured_anew_for_a_start(bench):
    """Between the permit and the start somebody may have moved it."""
    one = bench()
    one.process.controller = _opened(one.process.controller)
    one.process._measure()
    q0, *rest = one.process.arm.state.joints
    one.process.arm.state = replace(one.process.arm.state, joints=(q0 + math.radians(2.0), *rest))
    start = records.Start(bytes(16), 1, bytes(32), bytes(32), (0,) * 5)
    one.process._record(RecordReceived(start, records.Channel.CONTROL, TAG, 1, 20, bytes(32)))
    assert one.process.controller.measured_u == (2_000_000, 72_500_000, 250_000_000, 0, 55_000_000)


def test_a_path_that_is_checked_in_parts_is_not_waited_for(bench, monkeypatch):
    monkeypatch.setattr("cutgate.firmware_sim.upload.CHECK_POSES_PER_CYCLE", 1)
    one = in_session(bench())
    one.process._block(records.split(PATH.body())[0])
    assert one.process._wait_s() == 0.0
    for _ in range(len(PATH) + 1):
        one.process._continue_check()
    assert one.process.controller.state is ControllerState.LOADED


def test_the_options_are_those_of_a_real_controller_but_for_what_is_asked_for(bench):
    assert Options() == Options(1.0, 0.2, (), None, None)
    assert Options.__dataclass_params__.frozen
    one = bench(hold_roll_rad=0.3)
    assert one.process.arm.plant.hold_roll_rad == one.process.upload._hold_roll_rad == 0.3


class Poller:
    """Ready as a test says."""

    def __init__(self, ready):
        self.ready, self.registered, self.waited_ms = ready, [], []

    def register(self, descriptor, events):
        assert events == select.POLLIN
        self.registered.append(descriptor)

    def unregister(self, descriptor):
        self.registered.remove(descriptor)

    def poll(self, timeout_ms):
        self.waited_ms.append(timeout_ms)
        return [(descriptor, select.POLLIN) for descriptor in self.ready.pop(0)]


def test_the_loop_waits_for_bus_console_and_its_end_and_no_longer_than_until_something_is_due(
    bench, monkeypatch
):
    one = bench(clock=lambda: 60.0, announce_s=5.0)
    console = one.process._console_descriptor
    one.descriptors.remove(one.typing)
    os.close(one.typing)
    poller = Poller([[], [one.bus.descriptor], [console], [one.wake]])
    monkeypatch.setattr(select, "poll", lambda: poller)
    one.process.run(one.wake)
    assert poller.registered == [one.wake, one.bus.descriptor], "at its end the console is not waited for"
    assert poller.waited_ms == [0.0, 5000.0, 5000.0, 5000.0]


def test_a_memory_that_fails_again_after_it_has_worked_is_said_again(bench, monkeypatch):
    one = bench()
    for _ in range(2):
        with monkeypatch.context() as patch:
            failing(patch, one)
            assert not one.process._remember(Memory())
            assert not one.process._remember(Memory())
        assert one.process._remember(Memory())
    assert len(one.shown) == 2
