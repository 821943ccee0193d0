"""Tags are checked along a whole session as both links made them, whatever was lost, came late or was never looked at."""

from dataclasses import dataclass, field, replace
from functools import cache

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cutgate.protocol.e2e import protect
from cutgate.protocol.frames import (
    DATA_IDS,
    IDS,
    ControllerHeartbeat,
    Joint4,
    Joints01,
    Joints23,
    Progress,
    RuntimeHeartbeat,
    RuntimeStop,
)
from cutgate.protocol.link import Accepted, Link
from cutgate.protocol.states import ControllerState, RuntimeCode, StopCause, StopCode
from cutgate.protocol.wire import Side
from cutgate.runtime.audit.recomputed.tags import UNFIT, Tags, enables
from cutgate.runtime.audit.records import ZERO, CanFrame
from tests.protocol.sessions import CODES

PERIOD_S = 0.02
OURS, THEIRS = IDS[RuntimeHeartbeat], IDS[ControllerHeartbeat]
BEAT = ControllerHeartbeat(
    state=ControllerState.OPEN,
    epoch=1,
    cause=StopCause.NONE,
    device_pressed=False,
    emergency_stop_ok=True,
    cutting_mode=False,
)


def logged(direction, can_id, data, **changes):
    values = {"stamp": ZERO, "direction": direction, "id": can_id, "dlc": len(data), "data": data.hex()}
    return CanFrame(**values | changes)


@dataclass
class Conversation:
    """Two links, and what the runtime has logged of them."""

    now_s: float = 0.0
    log: list[CanFrame] = field(default_factory=list)
    samples: int = 0

    def __post_init__(self):
        self.runtime, self.controller = (
            Link(side, timeout_s=254 * PERIOD_S, heartbeat_s=PERIOD_S) for side in Side
        )
        for link in (self.runtime, self.controller):
            link.open(CODES, 0.0)

    def cycle(self, *, came=True, arrives=True, looks=True, q=0):
        """Both sides' turn: whether the controller's frames come, the runtime's arrive, the runtime looks at all."""
        self.now_s += PERIOD_S
        for frame in (BEAT, Joints01(q, -q), Joints23(1, 2), Joint4(3), Progress(0, q)):
            can_id, data = self.controller.encode(frame, self.now_s)
            if came:
                self.log.append(logged("received", can_id, data))
            if came and looks:
                heard = self.runtime.receive(can_id, data, now_s=self.now_s)
                self.samples += isinstance(heard, Accepted) and heard.sample is not None
        if looks:
            can_id, data = self.runtime.encode(RuntimeHeartbeat(RuntimeCode.CUT, 1), self.now_s)
            self.log.append(logged("sent", can_id, data))
            if arrives:
                self.controller.receive(can_id, data, now_s=self.now_s)

    def found(self):
        tags = Tags(CODES)
        return tags, [tags.take(record) for record in self.log]

    def of(self, can_id):
        return [number for number, record in enumerate(self.log) if record.id == can_id]


def talked(cycles):
    conversation = Conversation()
    for number in range(cycles):
        conversation.cycle(q=number % 100)
    return conversation


def test_everything_that_was_said_over_several_rounds_of_the_counter_fits():
    conversation = talked(600)
    tags, told = conversation.found()
    assert not any(told)
    assert (tags.sent, tags.came, tags.samples) == (600, 600, 600)
    assert conversation.samples == 599, "nothing dates the first one for the runtime"
    assert (tags.damaged, tags.strangers) == (0, 0)


acts = st.lists(
    st.tuples(
        st.sampled_from(["all", "came not", "arrives not", "neither", "blind"]),
        st.integers(1, 6),
    ),
    max_size=20,
)


@given(acts)
@settings(max_examples=50, deadline=None)
def test_what_was_lost_or_never_looked_at_makes_nothing_unfit(acts):
    """Both sides refuse what comes behind a wide gap; whoever reads along knows what was made and heard, and it fits."""
    conversation = talked(3)
    for act, times in acts:
        for _ in range(times):
            came, arrives = act not in ("came not", "neither"), act not in ("arrives not", "neither")
            conversation.cycle(came=came, arrives=arrives, looks=act != "blind")
    tags, told = conversation.found()
    assert not any(told)
    assert tags.came == len(conversation.of(THEIRS))
    assert tags.sent == len(conversation.of(OURS))
    assert tags.samples >= conversation.samples


@pytest.mark.parametrize("blind", [255, 256, 257, 300, 600])
def test_a_runtime_that_stood_still_echoes_what_it_heard_before(blind):
    conversation = talked(10)
    for _ in range(blind):
        conversation.cycle(looks=False)
    for _ in range(20):
        conversation.cycle()
    tags, told = conversation.found()
    assert not any(told)
    assert (tags.sent, tags.came) == (30, 30 + blind)


@cache
def several_rounds():
    return talked(300)


@pytest.mark.no_cover
@given(st.data())
@settings(max_examples=60, deadline=None)
def test_no_bit_of_what_a_tag_covers_can_be_flipped(data):
    conversation = replace(several_rounds(), log=list(several_rounds().log))
    can_id = data.draw(st.sampled_from([OURS, THEIRS, *(IDS[kind] for kind in (Joints01, Joints23, Joint4))]))
    which = data.draw(st.sampled_from(conversation.of(can_id)))
    record = conversation.log[which]
    bit = data.draw(st.integers(24, 63))
    payload = (int.from_bytes(bytes.fromhex(record.data), "little") ^ 1 << bit).to_bytes(8, "little")
    changed = protect(payload[3:], payload[2], DATA_IDS[can_id], CODES.tag)
    conversation.log[which] = record.model_copy(update={"data": changed.hex()})
    _, told = conversation.found()
    first = next(number for number, text in enumerate(told) if text)
    assert UNFIT in told[first]
    assert 0 <= first - which <= 2  # a sample's last part tells


@pytest.mark.parametrize("can_id", [OURS, THEIRS, IDS[Joint4]])
@pytest.mark.parametrize("counter", [0, 1, 127, 255])
def test_what_was_said_before_fits_nowhere_else(can_id, counter):
    conversation = talked(40)
    place = conversation.of(can_id)[30]
    old = bytes.fromhex(conversation.log[conversation.of(can_id)[10]].data)
    moved = protect(old[3:], (old[2] + counter) % 256, DATA_IDS[can_id], CODES.tag)
    conversation.log[place] = conversation.log[place].model_copy(update={"data": moved.hex()})
    _, told = conversation.found()
    joints = can_id == IDS[Joint4]
    assert told[place] or joints
    samples = conversation.found()[0].samples
    assert samples < 40 or not joints


@pytest.mark.parametrize("by", [1, 2, 128, 255])
def test_a_heartbeat_that_left_has_the_counter_after_the_last_ones(by):
    """The tag is that of its place, whatever the eight bits say."""
    conversation = talked(5)
    which = conversation.of(OURS)[-1]
    old = bytes.fromhex(conversation.log[which].data)
    moved = protect(old[3:], (old[2] + by) % 256, DATA_IDS[OURS], CODES.tag)
    conversation.log[which] = conversation.log[which].model_copy(update={"data": moved.hex()})
    assert conversation.found()[1][which] == f"heartbeat 4 that left: {UNFIT}"


def test_a_sample_of_before_the_first_heartbeat_fits_nowhere():
    conversation = talked(1)
    for kind in (Joints01, Joints23, Joint4):
        (which,) = conversation.of(IDS[kind])
        old = bytes.fromhex(conversation.log[which].data)
        data = protect(old[3:], 255, DATA_IDS[IDS[kind]], CODES.tag)
        conversation.log[which] = conversation.log[which].model_copy(update={"data": data.hex()})
    assert [text for text in conversation.found()[1] if text] == [f"joint sample -1: {UNFIT}"]


def test_a_heartbeat_that_came_twice_is_a_repetition():
    conversation = talked(5)
    for can_id in (THEIRS, IDS[Joints01], IDS[Joint4]):
        last = conversation.of(can_id)[-1]
        conversation.log.insert(last + 1, conversation.log[last])
    tags, told = conversation.found()
    assert not any(told)
    assert (tags.came, tags.samples) == (5, 5)


def test_of_one_part_that_came_twice_the_first_counts_as_it_did_for_the_runtime():
    conversation = talked(5)
    last = conversation.of(IDS[Joints01])[-1]
    record = conversation.log[last]
    old = bytes.fromhex(record.data)
    forged = protect(bytes(5), old[2], DATA_IDS[record.id], CODES.tag)
    behind = record.model_copy(update={"data": forged.hex()})
    conversation.log.insert(last + 1, behind)
    assert not any(conversation.found()[1])
    conversation.log[last : last + 2] = [behind, record]
    assert [text for text in conversation.found()[1] if text] == [f"joint sample 4: {UNFIT}"]


@pytest.mark.parametrize(
    "changes",
    [{"is_rtr": True}, {"dlc": 7}, {"data": "00" * 7, "dlc": 7}, {"data": "00" * 8}, {"data": "", "dlc": 0}],
    ids=str,
)
def test_what_came_damaged_is_counted_and_what_left_damaged_is_told(changes):
    conversation = talked(5)
    for can_id in (THEIRS, IDS[Progress]):
        which = conversation.of(can_id)[-1]
        conversation.log[which] = conversation.log[which].model_copy(update=changes)
    del conversation.log[conversation.of(OURS)[-1]]  # it echoes what was damaged
    tags, told = conversation.found()
    assert not any(told)
    assert (tags.damaged, tags.came) == (2, 4)
    which = conversation.of(OURS)[-2]
    conversation.log[which] = conversation.log[which].model_copy(update=changes)
    tags, told = conversation.found()
    assert told[which] == "frame 0x080 left damaged"
    assert sum(map(bool, told)) == 1, "what follows still fits"


def test_what_was_sent_outside_the_session_is_not_damaged():
    conversation = talked(3)
    data = protect(bytes(5), 0, DATA_IDS[THEIRS], 0)
    conversation.log.append(logged("received", THEIRS, data))
    tags, told = conversation.found()
    assert (tags.damaged, any(told)) == (0, False)


def test_other_nodes_and_frames_of_no_concern_are_passed_over():
    conversation = talked(3)
    link = conversation.runtime
    stop = link.encode(RuntimeStop(StopCode.STOP, StopCause.OPERATOR_STOP), 1.0)
    some = bytes.fromhex(conversation.log[conversation.of(OURS)[-1]].data)
    conversation.log += [
        logged("sent", *stop),
        logged("received", OURS, some),
        logged("received", THEIRS, bytes(8), is_extended=True),
        logged("received", THEIRS, bytes(8), is_error=True),
        logged("received", 0x123, bytes(3)),
    ]
    tags, told = conversation.found()
    assert not any(told)
    assert (tags.strangers, tags.damaged) == (1, 0)


def test_a_sample_before_any_heartbeat_is_none_and_data_that_are_no_digits_are_refused():
    conversation = talked(1)
    joints = [record for record in conversation.log if record.id in (0x300, 0x301, 0x302)]
    tags = Tags(CODES)
    assert [tags.take(record) for record in joints] == ["", "", ""]
    assert tags.samples == 0
    with pytest.raises(ValueError, match="hexadecimal"):
        tags.take(joints[0].model_copy(update={"data": "zz"}))


@pytest.mark.parametrize("code", RuntimeCode)
def test_whatever_is_more_than_inhibit_enables(code):
    link = Link(Side.RUNTIME, timeout_s=0.1, heartbeat_s=PERIOD_S)
    record = logged("sent", *link.encode(RuntimeHeartbeat(code, 1), 0.0))
    assert enables(record) is (code is not RuntimeCode.INHIBIT)
