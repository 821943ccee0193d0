"""The controller's loop in a session: what it makes of a runtime's frames and records, and what the bus hears of it."""

import hashlib
import json
import math
import os
import time
from dataclasses import replace

import can
import pytest

from cutgate.firmware_sim import memory, reports
from cutgate.firmware_sim.approach import own_ends
from cutgate.firmware_sim.bone import BoneMotion
from cutgate.firmware_sim.console import ConsoleCommand
from cutgate.firmware_sim.faults import FaultName, FaultSpec
from cutgate.firmware_sim.kinematics import as_joints, calibrated_arm
from cutgate.firmware_sim.loop import DARK_CYCLE_S
from cutgate.firmware_sim.mechanical import distances_text
from cutgate.firmware_sim.path_check import PathCheck
from cutgate.firmware_sim.state import FaultArisen, Memory, OpenLink
from cutgate.protocol import records
from cutgate.protocol.codes import fingerprint
from cutgate.protocol.endpoint import Endpoint, RecordReceived
from cutgate.protocol.frames import (
    IDS,
    ControllerFault,
    ControllerHeartbeat,
    Joints01,
    Progress,
    RuntimeHeartbeat,
    RuntimeStop,
)
from cutgate.protocol.link import Accepted
from cutgate.protocol.records import Channel, Side
from cutgate.protocol.states import (
    ControllerState,
    FaultCode,
    Purpose,
    Refusal,
    RuntimeCode,
    StopCause,
    StopCode,
)
from tests.firmware_sim.arms import LIMITS, NOMINAL, PATH, TOOL, TOOL_MM, pocket
from tests.firmware_sim.bench import KEY
from tests.firmware_sim.controllers import OPEN, PERMIT, PERMIT_LOG, PLACE, REGISTERED_US, START_LOG

STEP_S = 0.005
HEARTBEAT_S = 0.02
OTHER_KEY = bytes(31) + b"x"

FITTING = {ControllerState.PERMITTED: RuntimeCode.READY, ControllerState.CUTTING: RuntimeCode.CUT}
"""What a sound runtime says in its heartbeat then; else INHIBIT."""


class Clock:
    """Passes when a test says so."""

    def __init__(self):
        self.now_s = 50.0

    def __call__(self):
        return self.now_s


class Runtime:
    """The other end of a bench's bus, by hand: it keeps up its heartbeat and does what a test says."""

    def __init__(self, bench, *, key=KEY, **options):
        self.clock = Clock()
        self.bench = bench(clock=self.clock, **options)
        self.process = self.bench.process
        self.endpoint = Endpoint(
            Side.RUNTIME, key, heartbeat_s=HEARTBEAT_S, timeout_s=0.1, transfer_timeout_s=2.0
        )
        self.code, self.beats, self.next_s = None, True, 0.0
        self.items = []

    @property
    def controller(self):
        return self.process.controller

    @property
    def received(self):
        return [item.record for item in self.items if isinstance(item, RecordReceived)]

    def frames(self, kind):
        return [i.frame for i in self.items if isinstance(i, Accepted) and isinstance(i.frame, kind)]

    def heard_frames(self, kind):
        self.hear()
        return self.frames(kind)

    def step(self, by_s=STEP_S):
        """One cycle of the controller, and what it says to it."""
        self.clock.now_s += by_s
        if self.endpoint.link.is_open and self.beats and self.clock.now_s >= self.next_s:
            self.next_s = self.clock.now_s + HEARTBEAT_S
            code = self.code or FITTING.get(self.controller.state, RuntimeCode.INHIBIT)
            self.endpoint.send_frame(RuntimeHeartbeat(code, self.controller.epoch), self.clock.now_s)
        self.send()
        self.process.run_cycle()
        self.hear()

    def send(self):
        for can_id, data in self.endpoint.outgoing():
            self.bench.bus.inbox.append(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def hear(self):
        for message in self.bench.bus.sent:
            self.items += self.endpoint.receive(
                message.arbitration_id, bytes(message.data), now_s=self.clock.now_s
            )
        self.bench.bus.sent.clear()

    def run(self, seconds):
        for _ in range(round(seconds / STEP_S)):
            self.step()
        return self

    def ask(self, record, *, session=None):
        """Send a record; the records that come back."""
        self.items.clear()
        sent = self.endpoint.send_record(record, self.clock.now_s, session=session)
        self.run(0.1)
        for answer in self.received:
            if isinstance(answer, records.Reply):
                assert answer.request_sequence == sent.sequence
        return self.received

    def opening(self, **changes):
        """An OPEN that names what the controller announces now."""
        announced = reports.announcement(self.controller)
        named = replace(
            OPEN, announce_nonce=announced.announce_nonce, identity_digest=announced.identity_digest
        )
        return replace(named, **changes)

    def open(self, **changes):
        self.step()
        self.hear()
        self.items.clear()
        self.endpoint.abort()
        self.request = self.opening(**changes)
        digest = records.session_digest(self.request)
        self.endpoint.use_session(digest)
        self.endpoint.send_record(self.request, self.clock.now_s, session=0)
        while self.process.port.endpoint.session != records.session_tag(digest):
            self.step()
        self.endpoint.open_link(self.clock.now_s)
        self.run(0.1)
        return self

    def end(self):
        self.endpoint.send_frame(RuntimeStop(StopCode.END, StopCause.SESSION_ENDED), self.clock.now_s)
        self.step()
        self.endpoint.end_session()
        self.items.clear()
        return self

    def load(self, path=PATH):
        for block in records.split(path.body()):
            self.ask(block)
        return self

    def permit(self, start_u):
        (nonce,) = self.ask(records.NonceRequest(Purpose.PERMIT))
        ends = self.controller.holdings.ends
        holdings = self.controller.holdings
        bound = records.Approach(
            ends.entry_um, ends.exit_um, ends.entry_joints_u, ends.exit_joints_u, speed_percent=25
        )
        permit = replace(
            PERMIT,
            nonce=nonce.nonce,
            announce_nonce=self.request.announce_nonce,
            session_digest=records.session_digest(self.request),
            epoch=nonce.epoch,
            limits_digest=records.digest(holdings.limits),
            calibration_digest=records.digest(holdings.calibration),
            tool_digest=records.digest(holdings.tool),
            path_digest=records.digest(holdings.path),
            start_joints_u=start_u,
            branch=records.Branch("right", 0, 0),
            approach=bound,
            log=PERMIT_LOG,
        )
        self.answer = self.ask(permit)
        self.permitted = permit
        return self

    def start(self):
        self.process.act(ConsoleCommand.RELEASE)
        self.process.act(ConsoleCommand.HOLD)
        (nonce,) = self.ask(records.NonceRequest(Purpose.START))
        start = records.Start(
            nonce.nonce,
            nonce.epoch,
            self.permitted.session_digest,
            self.permitted.digest,
            self.permitted.start_joints_u,
            START_LOG,
        )
        self.answer = self.ask(start)
        return self


def _entry_u():
    check = PathCheck(records.PathCodes.parse(PATH.body()), LIMITS, NOMINAL, TOOL)
    check.run()
    arm = calibrated_arm(NOMINAL, tool_mm=TOOL_MM, elbow="right")
    ends = own_ends(check.path, arm, LIMITS, check.first_joints, check.last_joints, clearance_um=10_000)
    return (ends.entry_joints_u[0] + 2 * records.UNIT, *ends.entry_joints_u[1:])


START_U = _entry_u()
FAST = replace(LIMITS, acceleration_u=tuple(5 * speed for speed in LIMITS.speed_u))


@pytest.fixture
def runtime(bench):
    def make(**options):
        options.setdefault("joints", as_joints(records.joints_to_memory(START_U)))
        return Runtime(bench, **options)

    return make


def test_an_open_is_answered_and_its_timing_is_taken_over(runtime):
    one = runtime().open()
    (item,) = [item for item in one.items if isinstance(item, RecordReceived)]
    opened = records.Opened(1, ControllerState.OPEN, StopCause.NONE)
    assert (replace(item.record, mac=records.NO_MAC), item.authentic) == (opened, True)
    link = one.process.port.endpoint.link
    assert (link.heartbeat_s, link.timeout_s) == (0.02, 0.1)
    tag = records.session_tag(records.session_digest(one.request))
    assert (one.controller.session.tag, link.tag) == (tag, tag)
    assert one.bench.shown == ["state OPEN"]
    assert one.controller.heartbeat_fresh


def test_a_refused_open_is_answered_outside_a_session_and_not_cut_off_by_an_announcement(runtime):
    one = runtime(announce_s=0.05).run(0.03)
    assert [type(record) for record in one.received] == [records.Announce]
    one.endpoint.send_record(one.opening(announce_nonce=b"x" * 16), one.clock.now_s)
    while not one.bench.shown:
        one.step()
    refused_s = one.clock.now_s
    assert one.bench.shown == ["refused: ANNOUNCE_NONCE"]
    assert one.process._next_announce_s == pytest.approx(refused_s + 0.05, abs=STEP_S)
    one.run(0.04)
    (reply,) = [record for record in one.received if isinstance(record, records.Reply)]
    assert reply.refusal is Refusal.ANNOUNCE_NONCE
    assert one.controller.session is None


def _asks_to_open(one, **changes):
    """Sends an OPEN whose like may have been sent before, and waits for its answer."""
    one.items.clear()
    one.endpoint.send_record(
        one.opening(runtime_nonce=one.clock.now_s.hex().encode()[-16:], **changes), one.clock.now_s
    )
    one.run(0.05)
    return [record.refusal for record in one.received if isinstance(record, records.Reply)]


def test_an_open_that_no_holder_of_the_key_made_changes_nothing_and_is_shown_once(runtime):
    one = runtime(key=OTHER_KEY, announce_s=5.0).run(0.03)
    before = one.controller
    for _ in range(3):
        assert _asks_to_open(one) == [Refusal.MAC_INVALID]
    assert one.controller == before
    own = fingerprint(KEY)
    assert [own in line for line in one.bench.shown] == [True]


def test_two_reasons_by_turns_are_shown_once_each_until_something_else_happens(runtime):
    one = runtime(key=OTHER_KEY, announce_s=5.0).run(0.03)
    other = records.OtherVersion(records.Open.TYPE, 3)
    for _ in range(3):
        _asks_to_open(one)
        one.process._record(RecordReceived(other, Channel.CONTROL, 0, 1, 20, bytes(32)))
    assert [line.split(":")[1] for line in one.bench.shown] == [" MAC_INVALID", " PROTOCOL_VERSION"]
    one.process.act(ConsoleCommand.BONE_MOTION)
    _asks_to_open(one)
    assert one.bench.shown[-1].startswith("refused: MAC_INVALID")


def test_another_refusal_is_shown_each_time(runtime):
    one = runtime().open()
    for _ in range(2):
        one.ask(records.Acknowledge(1, StopCause.BONE_MOVED))
    assert one.bench.shown[-2:] == ["refused: WRONG_CAUSE"] * 2


def test_a_recorded_open_opens_no_second_time(runtime):
    one = runtime(announce_s=5.0).open()
    assert one.controller.announce_nonce == b"n" * 16
    recorded = one.request
    one.end()
    one.process.port.endpoint._opening = b""  # as after so many others in between
    one.endpoint.send_record(recorded, one.clock.now_s)
    one.run(0.05)
    (reply,) = [record for record in one.received if isinstance(record, records.Reply)]
    assert (reply.refusal, one.controller.session) == (Refusal.ANNOUNCE_NONCE, None)


def test_a_withdraw_is_durable_before_it_is_answered(runtime):
    one = runtime().open()
    one.process.act(ConsoleCommand.BONE_MOTION)
    assert memory.load(one.bench.file, now_us=0) == Memory(frozenset({PLACE}), withdrawal_due=True)
    (reply,) = one.ask(records.Withdraw(PLACE, REGISTERED_US))
    assert (reply.request_type, reply.refusal) == (records.Withdraw.TYPE, Refusal.ACCEPTED)
    told = Memory(frozenset({PLACE}), barrier_us=REGISTERED_US, withdrawal_due=True)
    assert memory.load(one.bench.file, now_us=0) == told


def test_who_opens_after_the_bone_moved_is_told_how_long_ago(runtime):
    one = runtime(announce_s=5.0)
    one.process.act(ConsoleCommand.BONE_MOTION)
    one.clock.now_s += 7.5
    one.open()
    (opened,) = [record for record in one.received if isinstance(record, records.Opened)]
    assert (opened.withdrawal_due, opened.motion_age_s) == (1, 7)


def test_a_recorded_acknowledgement_clears_nothing(runtime):
    one = runtime().open()
    one.process._feed(FaultArisen(StopCause.OPERATOR_QUIT))
    signed = replace(records.Acknowledge(2, StopCause.OPERATOR_QUIT), mac=b"m" * 16)
    tag = one.controller.session.tag
    payload = records.pack(signed, tag, 99)
    items = one.process.port.endpoint._record(payload, Channel.CONTROL)
    assert [item.authentic for item in items] == [False]
    one.process._item(items[0])
    assert (one.controller.state, one.controller.cause) == (ControllerState.FAULT, StopCause.OPERATOR_QUIT)


def test_while_an_open_comes_in_nothing_is_announced(runtime):
    one = runtime(announce_s=0.01)
    one.step()
    one.process.port.endpoint.stop_sending()
    one.endpoint.send_record(one.opening(), one.clock.now_s)
    one.process._next_announce_s = math.inf
    one.step()
    assert one.process.port.endpoint.receiving
    one.process._next_announce_s = one.clock.now_s
    before = one.process._next_announce_s
    one.endpoint.outgoing()  # the rest is late
    one.run(0.03)
    assert one.process._next_announce_s > before
    assert one.process.port.endpoint.receiving
    assert one.received == []


def test_an_announcement_that_nobody_took_gives_way_to_the_next(runtime):
    one = runtime(announce_s=0.05)
    for _ in range(3):
        one.process.run_cycle()
        one.clock.now_s += 0.05
    assert len(one.bench.bus.sent) == 3, "the first frame of each"


def test_what_is_due_now_is_announced_now(runtime):
    one = runtime()
    one.process.run_cycle()
    assert one.bench.bus.sent


def test_the_heartbeat_goes_out_in_its_period_with_the_joints_of_where_the_arm_stands(runtime):
    one = runtime().open()
    one.items.clear()
    one.run(0.2)
    beats = one.frames(ControllerHeartbeat)
    assert len(beats) == 10
    assert beats[-1].state is ControllerState.OPEN
    samples = [i.sample for i in one.items if isinstance(i, Accepted) and i.sample]
    assert len(samples) == 10
    assert samples[-1].joints == pytest.approx(records.joints_to_memory(START_U), abs=0.01)
    assert one.frames(Progress) == []


def test_a_drifting_arm_is_heard_where_the_clock_has_taken_it(runtime):
    one = runtime().open()
    one.process._happen(FaultName.DRIFT)
    one.run(0.5)
    q0 = one.endpoint.link.sample.joints[0]
    assert math.degrees(q0) - START_U[0] / records.UNIT == pytest.approx(0.5, abs=0.03)


def test_records_are_collected(runtime):
    one = runtime().open()
    assert one.ask(records.Collect()) == [LIMITS, NOMINAL, TOOL]


def test_every_block_is_answered_and_the_last_one_by_the_paths_digest(runtime):
    one, path = runtime().open(), pocket(poses=500, length_mm=1200.0)
    blocks = records.split(path.body())
    for block in blocks[:-1]:
        assert one.ask(block) == [records.BlockStored(block.index)]
    assert one.ask(blocks[-1]) == [
        records.BlockStored(blocks[-1].index),
        records.PathStored(path.digest, Refusal.ACCEPTED, 0),
    ]
    assert one.controller.state is ControllerState.LOADED
    assert len(one.process.arm.path) == 500
    assert one.bench.shown == ["state OPEN", "state LOADED"]


def test_a_block_out_of_its_order_refuses_the_path(runtime):
    one = runtime().open()
    block = records.split(pocket(poses=500, length_mm=1200.0).body())[1]
    (answer,) = one.ask(block)
    assert answer == records.PathStored(records.digest(b""), Refusal.PATH_MALFORMED, 0)
    assert one.bench.shown[-1] == "path refused: PathBlock 1 came where 0 was due"


def test_a_refused_path_says_why_at_the_controller(runtime):
    one = runtime().open().load(pocket(poses=20, length_mm=100_000.0))
    assert one.bench.shown[-1].startswith("path refused: POSE_OUTSIDE_LIMITS at pose ")
    assert one.controller.state is ControllerState.OPEN


def test_a_block_is_stored_only_where_the_table_takes_a_path(runtime):
    one = runtime().open().load().permit(START_U)
    assert one.controller.state is ControllerState.PERMITTED
    assert one.ask(records.split(PATH.body())[0]) == []
    assert one.process.upload.check is None


def test_a_nonce_is_of_the_systems_generator(runtime):
    one = runtime().open()
    assert one.ask(records.NonceRequest(Purpose.RESET)) == [records.Nonce(Purpose.RESET, b"n" * 16, 1)]


def test_a_permit_is_refused_where_the_arm_does_not_stand_at_its_start(runtime):
    one = runtime().open().load().permit((START_U[0] + records.UNIT, *START_U[1:]))
    (reply,) = one.answer
    assert reply.refusal is Refusal.START_JOINTS
    assert one.bench.shown[-1] == "refused: START_JOINTS"
    assert one.controller.measured_u == START_U


def test_a_request_that_is_not_accepted_says_what_to_do(runtime):
    one = runtime().open().load().permit(START_U)
    one.endpoint._codes = Endpoint(
        Side.RUNTIME, OTHER_KEY, heartbeat_s=HEARTBEAT_S, timeout_s=0.1, transfer_timeout_s=2.0
    )._key.session(records.session_digest(one.request))
    start = records.Start(bytes(16), 1, bytes(32), bytes(32), START_U)
    (reply,) = one.ask(start)
    assert reply.refusal is Refusal.MAC_INVALID
    own = fingerprint(KEY)
    assert any(f"this one's fingerprint is {own}" in line for line in one.bench.shown)


def test_a_whole_life_ends_where_it_began(runtime):
    one = runtime(time_scale=20.0).open().load().permit(START_U)
    (reply,) = one.answer
    assert (reply.refusal, one.controller.state) == (Refusal.ACCEPTED, ControllerState.PERMITTED)
    one.start()
    (reply,) = one.answer
    assert (reply.refusal, one.controller.state) == (Refusal.ACCEPTED, ControllerState.CUTTING)
    assert memory.load(one.bench.file, now_us=0) == Memory(log=START_LOG)
    one.items.clear()
    one.process.controller = replace(one.controller, measured_u=None)
    for _ in range(1000):
        one.step()
        if one.controller.state is not ControllerState.CUTTING:
            break
    assert one.controller.state is ControllerState.DONE
    told = one.frames(Progress)
    assert [frame.segment for frame in told] == sorted(frame.segment for frame in told)
    assert one.process.arm.state.joints == pytest.approx(records.joints_to_memory(START_U), abs=1e-6)
    ratio = one.process.arm.speed_ratio
    assert one.bench.shown[-1] == (
        f"state DONE: 20 segments executed, peak joint speed {ratio:.0%} of its limit"
    )
    assert one.bench.shown[-2] == (
        f"least distances of the true arm in the cut: {distances_text(one.process.arm.distances.least)}"
    )
    one.items.clear()
    one.run(0.1)
    assert one.frames(Progress)[-1] == Progress(19, 65535)
    assert one.controller.measured_u == START_U


def test_an_arm_that_is_another_one_than_is_reported_says_so_after_the_cut(runtime):
    true = replace(NOMINAL, upper_link_error_u=2 * records.UNIT)
    one = runtime(time_scale=20.0, true_calibration=true).open().load().permit(START_U).start().run(5.0)
    assert one.controller.state is ControllerState.DONE
    told = "the true wrist centre was up to 2.000 mm from where the reported calibration has it"
    assert told in one.bench.shown


@pytest.mark.parametrize(
    ("took_s", "refusal"), [(1.5, Refusal.ACCEPTED), (2.1, Refusal.NONCE_EXPIRED)], ids=["in time", "late"]
)
def test_a_disk_that_takes_longer_than_a_start_lives_starts_nothing(runtime, monkeypatch, took_s, refusal):
    """And in time or not: after so long at the disk the loop has stood still, and the arm never moves."""
    one = runtime().open().load().permit(START_U)
    save, before = memory.save, one.process.arm.state.joints

    def slow(path, wanted):
        save(path, wanted)
        one.clock.now_s += took_s

    monkeypatch.setattr(memory, "save", slow)
    answers = []
    reply = one.process._reply
    monkeypatch.setattr(one.process, "_reply", lambda effect: answers.append(effect.record) or reply(effect))
    one.code = RuntimeCode.CUT
    one.start()
    replied = [one for one in answers if isinstance(one, records.Reply)]
    assert [(one.request_type, one.refusal) for one in replied] == [(records.Start.TYPE, refusal)]
    assert one.controller.cause is not StopCause.NONE
    assert one.process.arm.state.joints == before
    assert memory.load(one.bench.file, now_us=0).log == START_LOG


def test_the_arm_moves_only_while_the_heartbeat_says_so_and_by_the_time_that_has_passed(runtime):
    one = runtime().open().load().permit(START_U)
    one.code = RuntimeCode.READY
    before = one.process.arm.state.joints
    one.start()
    assert one.controller.state is ControllerState.CUTTING
    assert one.process.arm.state.joints == before
    one.code = RuntimeCode.CUT
    while one.process.arm.state.joints == before:
        one.step()
    one.step()
    q0 = one.process.arm.state.joints[0]
    one.step(0.01)
    assert (q0 - one.process.arm.state.joints[0]) == pytest.approx(0.25 * math.radians(57) * 0.01)
    assert (one.process.arm.state.moving, one.process.arm.state.cutter) == (True, True)


def test_an_arm_that_stops_by_itself_is_a_fault_and_says_why(runtime):
    one = runtime().open().load().permit(START_U).start().run(0.05)
    one.items.clear()
    one.process._happen(FaultName.OFF_START)
    one.run(0.03)
    assert one.controller.cause is StopCause.TRACKING_DEVIATION
    assert any(line.startswith("the arm stopped by itself: the arm is ") for line in one.bench.shown)
    assert one.frames(ControllerFault) == [ControllerFault(FaultCode.STOPPED, StopCause.TRACKING_DEVIATION)]


def test_a_stop_stops_and_is_shown_once(runtime):
    one = runtime().open()
    one.endpoint.send_frame(RuntimeStop(StopCode.STOP, StopCause.OPERATOR_STOP), one.clock.now_s)
    one.run(0.05)
    assert one.controller.cause is StopCause.OPERATOR_STOP
    assert one.bench.shown == ["state OPEN", "state INHIBITED (OPERATOR_STOP)"]


def test_an_end_closes_the_link_and_announcements_begin_after_their_pause(runtime):
    one = runtime(announce_s=0.05).open()
    one.endpoint.send_frame(RuntimeStop(StopCode.END, StopCause.SESSION_ENDED), one.clock.now_s)
    one.items.clear()
    one.step()
    assert one.controller.session is None
    assert not one.process.port.endpoint.link.is_open
    assert one.process._next_announce_s == pytest.approx(one.clock.now_s + 0.05)
    one.run(0.04)
    assert not one.process.port.endpoint.control_waits
    one.run(0.03)
    assert [type(record) for record in one.received] == [records.Announce]


def test_a_peer_that_falls_silent_is_lost_and_the_session_ends(runtime):
    one = runtime().open()
    one.beats = False
    one.run(0.15)
    assert one.controller.session is None
    assert one.controller.cause is StopCause.HEARTBEAT_LOST
    assert one.bench.shown[-2:] == [
        "no fresh heartbeat within 100 ms",
        "state INHIBITED (HEARTBEAT_LOST)",
    ]


def test_a_loop_that_stood_still_says_so_and_stops(runtime):
    one = runtime().open()
    one.step(0.11)
    assert one.bench.shown[1].startswith("this computer stood still for 110 ms; ")
    assert one.controller.cause is StopCause.LOOP_STALLED


def test_a_loop_that_stood_still_at_the_bus_says_so_and_stops(runtime):
    one = runtime().open()
    one.bench.bus.after[one.bench.bus.reads + 1] = lambda: setattr(one.clock, "now_s", one.clock.now_s + 0.2)
    one.process.run_cycle()
    assert one.bench.shown[1].startswith("this computer stood still for 200 ms; ")
    assert "refused" not in one.bench.shown[1]
    assert one.controller.cause is StopCause.LOOP_STALLED


def test_a_second_node_is_refused_and_latches(runtime):
    one = runtime().open()
    one.bench.bus.inbox.append(
        can.Message(arbitration_id=IDS[ControllerHeartbeat], data=bytes(8), is_extended_id=False)
    )
    one.step()
    assert one.bench.shown[1] == f"refused: received on our own identifier {IDS[ControllerHeartbeat]:#05x}"
    assert (one.controller.state, one.controller.cause) == (ControllerState.FAULT, StopCause.SECOND_NODE)
    assert memory.load(one.bench.file, now_us=0) == Memory(latched=StopCause.SECOND_NODE)


def test_a_frame_that_says_nothing_to_the_table_changes_nothing(runtime):
    one = runtime().open()
    before = one.controller
    one.process._item(Accepted(Joints01(0, 0), 0))
    assert one.controller == before


def test_an_announcement_that_is_asked_for_in_a_form_that_is_not_sent_is_shown_once(runtime):
    one = runtime(announce_s=0.02)
    flow_control = can.Message(arbitration_id=0x640, data=bytes([0x30, 0, 5] + [0] * 5), is_extended_id=False)
    flow_control.arbitration_id = one.endpoint._transfers[Channel.CONTROL].tx_id
    for _ in range(6):
        one.step()
        one.endpoint.abort()
        one.bench.bus.inbox.append(flow_control)
    lines = [line for line in one.bench.shown if "flow control" in line]
    assert len(lines) == 1
    assert lines == one.bench.shown


@pytest.mark.parametrize("word", ["silent", "hang"])
def test_a_fault_happens_when_its_state_is_reached(runtime, word):
    one = runtime(faults=(FaultSpec.parse(f"{word}@open"),)).open()
    assert one.bench.shown[:2] == ["state OPEN", f"fault injected: {word}"]
    assert one.bench.slept == ([1.0] if word == "hang" else [])
    one.items.clear()
    one.run(0.05)
    assert bool(one.items) is (word == "hang")


def test_a_silent_controller_writes_its_memory_and_sends_nothing(runtime):
    one = runtime().open()
    one.process._happen(FaultName.SILENT)
    one.process._feed_any(None)
    one.process.act(ConsoleCommand.BONE_MOTION)
    assert memory.load(one.bench.file, now_us=0).withdrawn == {PLACE}
    assert one.bench.bus.sent == []
    one.process._cycle.late = lambda: 1 / 0
    with pytest.raises(ZeroDivisionError):
        one.process.run_cycle()
    assert one.bench.bus.sent == []
    assert one.controller.cause is StopCause.BONE_MOVED


def test_a_reboot_is_another_boot_with_nothing_loaded_and_what_was_remembered(runtime):
    one = runtime().open().load()
    one.process._feed(FaultArisen(StopCause.SECOND_NODE))
    one.process._random = b"m".__mul__
    one.process._happen(FaultName.REBOOT)
    assert one.controller.announce_nonce == b"m" * 16
    assert one.controller.identity.plant_speed_permille == 1000
    assert one.controller.holdings.path is None
    assert one.controller.holdings.ends is None
    assert one.controller.holdings.limits == LIMITS.body()
    assert one.process.arm.path is None
    assert one.controller.state is ControllerState.FAULT
    assert one.controller.memory == Memory(latched=StopCause.SECOND_NODE)
    assert one.process._next_announce_s == one.clock.now_s
    assert not one.process.port.endpoint.link.is_open


def test_a_memory_of_the_schema_before_that_a_reboot_finds_is_converted_then(runtime):
    """As restored from a copy: nothing registered until then counts."""
    one = runtime()
    content = {"named": [], "withdrawn": ["aa" * 32], "latched": "NONE"}
    digest = hashlib.sha256(json.dumps(content).encode()).hexdigest()
    document = {"schema": "cutgate.sim-memory/1", "content": content, "sha256": digest}
    one.bench.file.write_text(json.dumps(document), encoding="ascii")
    one.bench.file.chmod(0o600)
    before_us = time.time_ns() // 1000
    one.process._happen(FaultName.REBOOT)
    remembered = one.controller.memory
    assert before_us <= remembered.barrier_us <= time.time_ns() // 1000
    assert remembered == Memory(earlier=frozenset({b"\xaa" * 32}), barrier_us=remembered.barrier_us)


def test_the_link_keeps_the_time_of_the_session_and_its_first_heartbeat_is_due_at_once(runtime):
    one = runtime().open()
    one.process._cycle.next_heartbeat_s = math.inf
    one.process._carry_out(OpenLink(replace(one.controller.session, heartbeat_s=0.04, timeout_s=0.2)))
    link = one.process.port.endpoint.link
    assert (link.heartbeat_s, link.timeout_s) == (0.04, 0.2)
    assert one.process._cycle.next_heartbeat_s == one.clock.now_s


@pytest.mark.parametrize("error", [False, True])
def test_what_was_under_way_when_something_stopped_does_not_leave(runtime, error):
    one = runtime().open()
    one.process._send(records.Nonce(Purpose.PERMIT, bytes(16), 1))
    assert one.process.port.endpoint.control_waits
    if error:
        one.process._cycle.late = lambda: 1 / 0
        with pytest.raises(ZeroDivisionError):
            one.process.run_cycle()
        assert [frame.arbitration_id for frame in one.bench.bus.sent] == [IDS[ControllerFault]]
    else:
        one.process._feed(FaultArisen(StopCause.OPERATOR_STOP))
    assert not one.process.port.endpoint.control_waits


def test_while_a_path_is_checked_nothing_is_waited_for(runtime, monkeypatch):
    monkeypatch.setattr("cutgate.firmware_sim.upload.CHECK_POSES_PER_CYCLE", 1)
    one = runtime().open()
    assert one.process._wait_s() > 0.0
    one.process._block(records.split(PATH.body())[0])
    assert one.process._wait_s() == 0.0
    one.process._happen(FaultName.REBOOT)
    assert one.process.upload.check is None
    one.process._next_announce_s = one.clock.now_s + 1.0
    assert one.process._wait_s() == pytest.approx(1.0)


def test_a_limit_that_changes_unnoticed_is_held_and_stops_nothing(runtime):
    one = runtime().open()
    one.process._happen(FaultName.CHANGE_LIMIT)
    assert records.Limits.parse(one.controller.holdings.limits).q_max_u[0] == LIMITS.q_max_u[0] - records.UNIT
    assert one.controller.state is ControllerState.OPEN


# ---------------------------------------------------------------- without power


def dark(one, until_s=None):
    """A controller that has just lost its power."""
    one.process._happen(FaultName.POWER_LOSS)
    if until_s is not None:
        one.process._dark_until_s = until_s
    return one


def test_without_power_nothing_is_said_or_heard_and_afterwards_it_is_another_boot(runtime):
    one = runtime().open().load()
    dark(one)
    one.items.clear()
    one.endpoint.send_frame(RuntimeStop(StopCode.STOP, StopCause.OPERATOR_STOP), one.clock.now_s)
    one.run(0.9)
    assert one.items == []
    assert one.controller.cause is StopCause.NONE
    assert one.process._wait_s() == DARK_CYCLE_S
    one.process._random = b"m".__mul__
    one.run(0.2)
    assert one.bench.shown[-1] == "power is back"
    assert one.controller.announce_nonce == b"m" * 16
    assert one.controller.holdings.path is None
    assert one.controller.cause is StopCause.NONE


def test_what_is_typed_without_power_is_lost(runtime):
    one = dark(runtime().open())
    os.write(one.bench.typing, b"bone-motion\n")
    descriptor = one.process._console_descriptor
    one.process.run_cycle()
    one.process.run_cycle({descriptor})
    assert one.process._commands.read() == []
    one.run(1.2)
    assert one.controller.cause is StopCause.NONE


def test_a_controller_without_a_console_can_lose_its_power_as_well(runtime):
    one = dark(runtime(typed=False).open()).run(1.2)
    assert one.bench.shown[-1] == "power is back"


def test_a_program_that_is_to_end_without_power_says_no_last_words(runtime):
    one = dark(runtime().open())
    os.write(one.bench.waking, b"\0")
    one.process.run(one.bench.wake)
    assert one.bench.bus.sent == []
    assert one.controller.cause is StopCause.NONE


def test_a_controller_whose_memory_cannot_be_believed_does_not_come_up_and_leaves_it_as_it_is(runtime):
    one = runtime().open()
    one.process.act(ConsoleCommand.BONE_MOTION)
    one.process._happen(FaultName.FLIP_MEMORY_BIT)
    damaged = one.bench.file.read_bytes()
    dark(one).run(5.0)
    assert one.bench.shown[-2] == "power is back"
    assert one.bench.shown[-1].startswith(f"the controller does not start: {one.bench.file}: ")
    assert one.process._dark_until_s == math.inf
    assert one.bench.file.read_bytes() == damaged


@pytest.mark.parametrize(
    ("name", "kept"), [(FaultName.TORN_WRITE, False), (FaultName.UNANSWERED_WRITE, True)]
)
def test_power_can_be_lost_while_the_memory_is_written(runtime, name, kept):
    """Once: the writing after that is one as any other."""
    one = runtime().open()
    one.process._happen(name)
    os.write(one.bench.typing, b"bone-motion\n")
    one.process.run_cycle({one.process._console_descriptor})
    assert ControllerFault(FaultCode.STOPPED, StopCause.BONE_MOVED) in one.heard_frames(ControllerFault)
    assert one.process._dark_until_s == pytest.approx(one.clock.now_s + 1.0)
    assert memory.load(one.bench.file, now_us=0) == (
        Memory(frozenset({PLACE}), withdrawal_due=True) if kept else Memory()
    )
    one.run(1.2)
    one.process.act(ConsoleCommand.BONE_MOTION)
    assert memory.load(one.bench.file, now_us=0).withdrawal_due


def test_a_loop_that_hangs_for_good_does_nothing_more(runtime):
    one = runtime(faults=(FaultSpec.parse("hung@open"),)).open()
    one.items.clear()
    one.run(5.0)
    assert one.items == []
    assert one.bench.shown == ["state OPEN", "fault injected: hung"]


def test_a_slow_loop_is_late_in_every_cycle(runtime):
    one = runtime(faults=(FaultSpec.parse("slow@open"),), slow_s=0.07).open()
    before = len(one.bench.slept)
    one.run(0.05)
    assert one.bench.slept[before:] == [0.07] * 10


@pytest.mark.parametrize(
    ("name", "cause"),
    [
        (FaultName.SECOND_CONTROLLER, StopCause.SECOND_NODE),
        (FaultName.SECOND_RUNTIME, StopCause.AUTHENTICATION_FAILED),
    ],
)
def test_what_another_node_says_is_on_the_bus_if_it_has_room_and_heard_here(runtime, name, cause):
    one = runtime().open()
    one.process._happen(name)
    message = one.bench.bus.sent[0]
    beat = {FaultName.SECOND_CONTROLLER: ControllerHeartbeat, FaultName.SECOND_RUNTIME: RuntimeHeartbeat}
    assert message.arbitration_id == IDS[beat[name]]
    assert (one.controller.state, one.controller.cause) == (ControllerState.FAULT, cause)
    other = runtime().open()
    other.bench.bus.room = 0
    other.process._happen(name)
    assert other.controller.cause is cause


@pytest.mark.parametrize(("by_mm", "cause"), [(1.0, StopCause.BONE_MOVED), (0.1, StopCause.NONE)])
def test_the_bone_moves_once_so_long_after_the_start(runtime, by_mm, cause):
    one = runtime(bone_motion=BoneMotion(0.3, by_mm)).open().load().permit(START_U).run(1.0).start()
    while one.clock.now_s - one.controller.started_at_s < 0.29:
        assert not any("the bone" in line for line in one.bench.shown)
        one.step()
    one.run(0.05)
    assert one.controller.cause is cause
    one.run(0.5)
    assert sum("the bone has moved" in line for line in one.bench.shown) == 1


def test_a_bone_that_moves_by_a_fault_is_told(runtime):
    one = runtime(faults=(FaultSpec.parse("bone-motion@open"),)).open()
    assert "the bone has moved by 1 mm" in one.bench.shown
    assert one.controller.cause is StopCause.BONE_MOVED


def test_the_drives_of_an_arm_with_mass_settle_whatever_the_state(runtime):
    one = runtime(dynamics=True, limits=FAST).open().load().permit(START_U).start().run(0.5)
    assert one.process.arm.reading != one.process.arm.state.joints
    heard = one.endpoint.link.sample.joints
    assert heard == pytest.approx(one.process.arm.reading, abs=0.02)
    one.process.act(ConsoleCommand.RELEASE)
    command = one.process.arm.state.joints
    one.run(1.0)
    assert one.process.arm.reading == one.process.arm.state.joints == command


def test_the_brakes_of_an_arm_with_mass_stop_it_where_it_is(runtime):
    one = runtime(dynamics=True, limits=FAST).open().load().permit(START_U).start().run(0.5)
    command = one.process.arm.state.joints
    dark(one).run(0.5)
    place = one.process.arm.reading
    assert place != command
    one.run(1.0)
    assert one.process.arm.reading == place == one.process.arm.state.joints
