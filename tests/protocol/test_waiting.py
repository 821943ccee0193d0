"""What waits because the bus takes no more: nothing is lost or out of order, what disables overtakes, what leaves is young."""

from collections import defaultdict
from dataclasses import replace
from itertools import pairwise

import can
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from cutgate.config.constants import CONSTANTS
from cutgate.protocol import records
from cutgate.protocol.e2e import GAP_MAX
from cutgate.protocol.endpoint import Endpoint, RecordReceived
from cutgate.protocol.frames import (
    BULK_IDS,
    CONTROL_IDS,
    IDS,
    ControllerFault,
    ControllerHeartbeat,
    Joint4,
    Joints01,
    Joints23,
    Progress,
    RuntimeHeartbeat,
    RuntimeStop,
    joint_frames,
)
from cutgate.protocol.link import Accepted, JointSample, Violation
from cutgate.protocol.port import LAST_TRIES, RETRY_S, Port
from cutgate.protocol.records import Channel, Side
from cutgate.protocol.states import ControllerState, FaultCode, Purpose, RuntimeCode, StopCause, StopCode
from tests.firmware_sim.arms import LIMITS
from tests.protocol.sessions import DIGEST, KEY, OTHER_DIGEST

NOW = 10.0
CUT, INHIBIT = RuntimeHeartbeat(RuntimeCode.CUT, 0), RuntimeHeartbeat(RuntimeCode.INHIBIT, 0)
STOP = RuntimeStop(StopCode.STOP, StopCause.OPERATOR_STOP)
CUTTING = ControllerHeartbeat(ControllerState.CUTTING, 0, StopCause.NONE, True, True, True)
FAULT = ControllerFault(FaultCode.STOPPED, StopCause.EMERGENCY_STOP)
BLOCKS = records.split(bytes(40) + bytes(range(250)) * 12)
STANDS = (0.0, 0.1, 200.0, 0.2, 0.3)
STEP_RAD = 0.01
"""So far every joint has gone from one turn to the next, the slide in mm."""


def endpoint(side: Side) -> Endpoint:
    made = Endpoint(side, KEY, heartbeat_s=0.02, timeout_s=0.1, transfer_timeout_s=1.0)
    made.use_session(DIGEST)
    made.open_link(NOW)
    return made


class Bus:
    """Takes so many frames, then no more; as SocketCAN and the virtual bus say it."""

    def __init__(self, room: int = 0) -> None:
        self.room = room
        self.taken: list[tuple[int, bytes]] = []
        self.asked = 0

    def send(self, message: can.Message, timeout: float) -> None:
        assert timeout == 0, "a loop must not wait in send"
        self.asked += 1
        if self.room == 0:
            raise can.CanTimeoutError("No buffer space available")
        self.room -= 1
        self.taken.append((message.arbitration_id, bytes(message.data)))

    def ids(self) -> list[int]:
        return [can_id for can_id, _ in self.taken]


@pytest.fixture
def runtime() -> Port:
    return Port(Bus(), endpoint(Side.RUNTIME))


@pytest.fixture
def controller() -> Port:
    return Port(Bus(), endpoint(Side.CONTROLLER))


def leaves(port: Port, room: int = 1000) -> list[tuple[int, bytes]]:
    """What the bus takes when it has room for so many frames."""
    begun, port.bus.room = len(port.bus.taken), room
    port.flush()
    port.bus.room = 0
    return port.bus.taken[begun:]


def joints(turn: int):
    q0, q1, q2, q3, q4 = (STEP_RAD * turn + place for place in STANDS)
    return joint_frames((q0, q1, q2, q3, q4))


# ------------------------------------------------------------------ the bus


def test_a_bus_that_takes_no_more_has_not_failed_and_what_waits_goes_next_time(runtime):
    seen = []
    runtime._recorder = seen.append
    runtime.endpoint.send_record(BLOCKS[0], NOW)
    runtime.endpoint.send_frame(INHIBIT, NOW)
    assert not runtime.flush()
    assert runtime.waits
    assert seen == []
    assert [can_id for can_id, _ in leaves(runtime, 1)] == [IDS[RuntimeHeartbeat]]
    assert runtime.waits
    assert [can_id for can_id, _ in leaves(runtime, 1)] == [BULK_IDS[0]]
    assert not runtime.waits
    assert [(passed.can_id, passed.data) for passed in seen] == runtime.bus.taken
    assert leaves(runtime) == []


def test_nothing_waits_before_anything_was_said_and_what_waits_is_tried_within_the_shortest_period(runtime):
    assert not runtime.waits
    assert CONSTANTS["heartbeat_ms"].low / 1000 >= 5 * RETRY_S
    assert pytest.approx(CONSTANTS["timeout_ms"].default / 1000) == LAST_TRIES * RETRY_S


def test_a_bus_that_takes_no_more_is_asked_once_a_turn(runtime):
    for block in BLOCKS:
        runtime.endpoint.send_record(block, NOW)
    runtime.endpoint.send_frame(INHIBIT, NOW)
    runtime.flush()
    assert runtime.bus.asked == 1


def test_the_last_words_are_tried_for_a_bounded_time(runtime):
    pauses = []
    runtime.endpoint.send_frame(STOP, NOW)
    assert not runtime.flush_last(pauses.append)
    assert pauses == [RETRY_S] * LAST_TRIES
    pauses.clear()

    def pause(seconds: float) -> None:
        pauses.append(seconds)
        runtime.bus.room = len(pauses) // 3

    assert runtime.flush_last(pause)
    assert len(pauses) == 3
    assert runtime.bus.ids() == [IDS[RuntimeStop]]


# ------------------------------------------------------------------ what goes first


def test_a_stop_overtakes_everything_that_waits(runtime):
    runtime.endpoint.send_record(BLOCKS[0], NOW)
    runtime.endpoint.send_record(records.Collect(), NOW)
    runtime.endpoint.send_frame(INHIBIT, NOW)
    runtime.endpoint.send_frame(STOP, NOW)
    runtime.endpoint.send_frame(INHIBIT, NOW)
    ids = [can_id for can_id, _ in leaves(runtime)]
    assert ids == [IDS[RuntimeStop], IDS[RuntimeHeartbeat], CONTROL_IDS[0], BULK_IDS[0]]


def test_what_a_stop_voids_never_leaves_although_it_waited_half_sent(runtime):
    peer = endpoint(Side.CONTROLLER)
    runtime.endpoint.send_record(BLOCKS[0], NOW)
    for can_id, data in leaves(runtime, 1):
        peer.receive(can_id, data, now_s=NOW)
    for can_id, data in peer.outgoing():
        runtime.endpoint.receive(can_id, data, now_s=NOW)
    assert len(leaves(runtime, 3)) == 3
    runtime.endpoint.send_record(records.Collect(), NOW)
    runtime.endpoint.stop_sending()
    runtime.endpoint.send_frame(STOP, NOW)
    assert [can_id for can_id, _ in leaves(runtime)] == [IDS[RuntimeStop]]


@pytest.mark.parametrize(
    ("side", "stop", "beat"), [(Side.RUNTIME, STOP, CUT), (Side.CONTROLLER, FAULT, CUTTING)]
)
def test_no_heartbeat_that_is_older_than_a_stop_follows_it(side, stop, beat):
    port = Port(Bus(), endpoint(side))
    port.endpoint.send_frame(beat, NOW)
    port.flush()
    port.endpoint.send_frame(stop, NOW)
    assert [can_id for can_id, _ in leaves(port)] == [IDS[type(stop)]]
    assert not port.endpoint.heartbeat_waits


def test_a_stop_that_waits_is_not_queued_again_and_another_one_is(runtime):
    end = replace(STOP, code=StopCode.END)
    for frame in (STOP, STOP, end, STOP, end):
        runtime.endpoint.send_frame(frame, NOW)
    assert [data[2] for _, data in leaves(runtime)] == [0, 1]
    runtime.endpoint.send_frame(STOP, NOW)
    assert len(leaves(runtime)) == 1


def test_what_waits_of_another_session_never_leaves_in_this_one(controller):
    controller.endpoint.send_frame(FAULT, NOW)
    controller.endpoint.end_session()
    assert controller.endpoint.outgoing() != []
    controller.endpoint.use_session(DIGEST)
    controller.endpoint.open_link(NOW)
    controller.endpoint.send_frame(CUTTING, NOW)
    controller.endpoint.use_session(OTHER_DIGEST)
    assert controller.endpoint.outgoing() == []


# ------------------------------------------------------------------ what leaves is young


def test_a_heartbeat_that_waited_leaves_with_fresh_content_and_no_counter_is_lost(runtime):
    peer = endpoint(Side.CONTROLLER)
    for turn in range(50):
        at_s = NOW + turn * 0.001
        runtime.endpoint.send_frame(RuntimeHeartbeat(RuntimeCode.CUT, turn % 32), at_s)
        assert runtime.endpoint.heartbeat_waits
        runtime.flush()
    ((can_id, data),) = leaves(runtime)
    assert not runtime.endpoint.heartbeat_waits
    (item,) = peer.receive(can_id, data, now_s=NOW)
    assert (item.frame.epoch, item.counter, item.lost) == (49 % 32, 0, 0)
    peer.send_frame(CUTTING, NOW)
    runtime.endpoint.send_frame(CUT, NOW + 0.06)  # waits, and is made before the peer's heartbeat is heard
    runtime.flush()
    for can_id, data in peer.outgoing():
        (heard,) = runtime.endpoint.receive(can_id, data, now_s=NOW + 0.06)
    assert heard.fresh
    runtime.endpoint.send_frame(CUT, NOW + 0.061)
    ((can_id, data),) = leaves(runtime)
    (item,) = peer.receive(can_id, data, now_s=NOW + 0.061)
    assert (item.frame.echo, item.counter, item.lost, item.fresh) == (heard.counter, 1, 0, True)


def test_the_time_out_runs_from_the_heartbeat_that_left_not_from_one_that_waited(runtime):
    """An echo of a counter whose first heartbeat never left proves the age of the one that did."""
    peer = endpoint(Side.CONTROLLER)
    runtime.endpoint.send_frame(CUT, NOW)
    runtime.flush()
    runtime.endpoint.send_frame(CUT, NOW + 0.05)
    for can_id, data in leaves(runtime):
        peer.receive(can_id, data, now_s=NOW + 0.05)
    peer.send_frame(CUTTING, NOW + 0.05)
    for can_id, data in peer.outgoing():
        (heard,) = runtime.endpoint.receive(can_id, data, now_s=NOW + 0.149)
    assert heard.fresh


def test_an_unmade_heartbeat_is_echoed_by_nobody(runtime):
    peer = endpoint(Side.CONTROLLER)
    runtime.endpoint.send_frame(CUT, NOW)
    ((can_id, data),) = runtime.endpoint.outgoing()  # as if delayed from 256 periods ago: the same counter
    peer.receive(can_id, data, now_s=NOW)
    other = endpoint(Side.RUNTIME)
    other.send_frame(CUT, NOW)
    other.send_frame(STOP, NOW)  # unmakes it
    peer.send_frame(CUTTING, NOW)
    for can_id, data in peer.outgoing():
        (heard,) = other.receive(can_id, data, now_s=NOW)
    assert heard.cause is StopCause.AUTHENTICATION_FAILED


def test_a_joint_sample_of_which_nothing_has_left_gives_way_to_the_next(controller):
    peer = endpoint(Side.RUNTIME)
    peer.send_frame(CUT, NOW)
    for can_id, data in peer.outgoing():
        controller.endpoint.receive(can_id, data, now_s=NOW)
    controller.endpoint.send_frame(CUTTING, NOW)
    beat = leaves(controller)
    for turn in range(3):
        for frame in joints(turn):
            controller.endpoint.send_frame(frame, NOW)
    expected = [IDS[kind] for kind in (Joints01, Joints23, Joint4)]
    sent = leaves(controller)
    assert [can_id for can_id, _ in sent] == expected
    for can_id, data in beat + sent:
        peer.receive(can_id, data, now_s=NOW)
    assert peer.link.sample.joints[0] == pytest.approx(2 * STEP_RAD, abs=STEP_RAD / 10)


def test_a_joint_sample_that_has_begun_is_finished_before_the_next(controller):
    for frame in joints(0):
        controller.endpoint.send_frame(frame, NOW)
    assert len(leaves(controller, 1)) == 1
    for turn in (1, 2):
        for frame in joints(turn):
            controller.endpoint.send_frame(frame, NOW)
    kinds = (Joints23, Joint4, Joints01, Joints23, Joint4)
    assert [can_id for can_id, _ in leaves(controller)] == [IDS[kind] for kind in kinds]


def test_a_joint_sample_that_has_begun_is_finished_also_where_the_next_heartbeat_is_made_again(controller):
    for turn in range(2):
        controller.endpoint.send_frame(CUTTING, NOW)
        for frame in joints(turn):
            controller.endpoint.send_frame(frame, NOW)
        assert len(leaves(controller, 2 * (turn == 0))) == 2 * (turn == 0)
    controller.endpoint.send_frame(CUTTING, NOW)
    assert [can_id for can_id, _ in leaves(controller)] == [
        IDS[kind] for kind in (ControllerHeartbeat, Joints23, Joint4)
    ]


def test_a_stop_that_waits_outlives_every_heartbeat_that_is_made_again(runtime):
    for turn in range(3):
        runtime.endpoint.send_frame(CUT, NOW)
        runtime.endpoint.send_frame(replace(STOP, cause=list(StopCause)[turn + 1]), NOW)
        runtime.endpoint.send_frame(CUT, NOW)
    runtime.endpoint.send_frame(INHIBIT, NOW)
    assert [can_id for can_id, _ in leaves(runtime)] == [IDS[RuntimeStop]] * 3 + [IDS[RuntimeHeartbeat]]


def test_only_the_last_progress_waits_and_no_counter_of_it_is_lost(controller):
    for segment in range(10):
        controller.endpoint.send_frame(Progress(segment, 0), NOW)
    ((_, data),) = leaves(controller)
    assert data[2] == 0


# ------------------------------------------------------------------ transfers


def test_a_record_whose_frames_wait_for_longer_than_the_time_out_has_failed(runtime):
    runtime.endpoint.send_record(records.Collect(), NOW)  # one frame: the transfer itself is done
    runtime.flush()
    assert runtime.endpoint.expire(NOW) == []
    failed = [found.cause for found in runtime.endpoint.expire(NOW + 1.1)]
    assert StopCause.TRANSFER_FAILED in failed
    assert leaves(runtime) == []


def test_a_record_of_which_frames_leave_now_and_then_stands_not_still(runtime):
    peer = endpoint(Side.CONTROLLER)
    runtime.endpoint.send_record(BLOCKS[0], NOW)
    now_s, received = NOW, []
    while not received:
        for can_id, data in leaves(runtime, 1):
            received += peer.receive(can_id, data, now_s=now_s)
        for can_id, data in peer.outgoing():
            runtime.endpoint.receive(can_id, data, now_s=now_s)
        now_s += 0.5
        failed = [found.cause for found in runtime.endpoint.expire(now_s)]
        assert StopCause.TRANSFER_FAILED not in failed
    assert received[0].record == BLOCKS[0]


# ------------------------------------------------------------------ any pattern of room


class Conversation:
    """A controller that speaks on a bus of little room, and a runtime that hears what the bus took and answers."""

    def __init__(self) -> None:
        self.speaker, self.hearer = Port(Bus(), endpoint(Side.CONTROLLER)), endpoint(Side.RUNTIME)
        self.turn = 0
        self.sent: list[records.Record] = []
        self.received: list[records.Record] = []
        self.stop_waits = False
        self.faults_heard = 0
        self.judged: JointSample | None = None
        self.turn_of_counter: dict[int, int] = {}
        self.counters: dict[int, list[int]] = defaultdict(list)

    def say_turn(self, room: int) -> None:
        """What a controller says in one cycle."""
        self.turn += 1
        for frame in (replace(CUTTING, epoch=self.turn % 256), *joints(self.turn), Progress(self.turn, 0)):
            self.speaker.endpoint.send_frame(frame, NOW)
        self.pass_on(room)

    def say_bulk(self, number: int) -> None:
        self._say(replace(LIMITS, q_max_u=(LIMITS.q_max_u[0] + number, *LIMITS.q_max_u[1:])))

    def say_control(self, number: int) -> None:
        self._say(records.Nonce(purpose=Purpose.PERMIT, nonce=number.to_bytes(16, "big"), epoch=0))

    def _say(self, record: records.Record) -> None:
        self.sent.append(record)
        self.speaker.endpoint.send_record(record, NOW)

    def say_fault(self, number: int) -> None:
        cause = (StopCause.EMERGENCY_STOP, StopCause.DEVICE_RELEASED)[number % 2]
        self.speaker.endpoint.send_frame(replace(FAULT, cause=cause), NOW)
        self.stop_waits = True

    def pass_on(self, room: int) -> None:
        """So many frames find room; the runtime hears them and answers."""
        sent = leaves(self.speaker, room)
        if self.stop_waits and sent:
            assert sent[0][0] == IDS[ControllerFault], "nothing leaves before a stop that waits"
            self.stop_waits = False
        for can_id, data in sent:
            if can_id == IDS[ControllerHeartbeat]:
                self.turn_of_counter[data[2]] = self.turn
            if can_id in JOINT_IDS:
                self.counters[can_id].append(data[2])
            for item in self.hearer.receive(can_id, data, now_s=NOW):
                self.hear(item)
        for can_id, data in self.hearer.outgoing():
            self.speaker.endpoint.receive(can_id, data, now_s=NOW)

    def hear(self, item: object) -> None:
        match item:
            case RecordReceived(record=record):
                self.received.append(record)
            case Accepted(frame=ControllerHeartbeat() as beat, lost=lost):
                assert (beat.epoch, lost) == (self.turn % 256, 0), "the last one made, and none is missed"
            case Accepted(frame=Progress() as progress, lost=lost):
                assert (progress.segment <= self.turn, lost) == (True, 0)
            case Accepted(frame=ControllerFault()):
                self.faults_heard += 1
            case Accepted(frame=Joint4()) if self.hearer.link.sample is not self.judged:
                self.judge(self.hearer.link.sample)
            case Violation() if not self.starved:
                pytest.fail(str(item))

    def judge(self, sample: JointSample) -> None:
        self.judged = sample
        made_in = round(float(sample.joints[0]) / STEP_RAD)
        assert self.turn_of_counter[sample.counter] == made_in, "a sample has the counter of its heartbeat"
        together = [STEP_RAD * made_in + place for place in STANDS]
        assert list(sample.joints) == pytest.approx(together, abs=STEP_RAD / 10), (
            "its parts were made together"
        )

    @property
    def starved(self) -> bool:
        """Whether so many samples in a row found no room that their counters tell the runtime to stop."""
        return any(
            (after - before) % 256 > GAP_MAX
            for counters in self.counters.values()
            for before, after in pairwise(counters)
        )


JOINT_IDS = {IDS[kind] for kind in (Joints01, Joints23, Joint4)}
ACTS = st.lists(
    st.tuples(st.just(Conversation.say_turn), st.integers(0, 8))
    | st.tuples(st.just(Conversation.pass_on), st.integers(0, 40))
    | st.tuples(st.just(Conversation.say_bulk), st.integers(0, 1000))
    | st.tuples(st.just(Conversation.say_control), st.integers(0, 1000))
    | st.tuples(st.just(Conversation.say_fault), st.integers(0, 1)),
    max_size=60,
)


@settings(max_examples=300, deadline=None)
@given(ACTS)
def test_whatever_room_the_bus_has_everything_arrives_once_and_in_order_and_stops_first(acts):
    talk = Conversation()
    for act, number in acts:
        act(talk, number)
    event("starved" if talk.starved else "heard")
    for _ in range(len(talk.sent) * 20 + 1):
        talk.pass_on(1000)
    assert not talk.speaker.waits
    assert not talk.stop_waits
    assert bool(talk.faults_heard) is any(act is Conversation.say_fault for act, _ in acts)
    for channel in Channel:
        sent = [record for record in talk.sent if record.CHANNEL is channel]
        assert [record for record in talk.received if record.CHANNEL is channel] == sent
