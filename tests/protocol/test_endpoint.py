"""One side of the conversation: what an endpoint hands on, drops, and takes for a reason to stop."""

from dataclasses import FrozenInstanceError, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cutgate.protocol import records
from cutgate.protocol.endpoint import NO_SESSION, Endpoint, RecordReceived, Sent, Undelivered
from cutgate.protocol.frames import CONTROL_IDS, IDS, ControllerHeartbeat, RuntimeHeartbeat, encode_frame
from cutgate.protocol.link import Accepted, Discarded, Violation
from cutgate.protocol.records import Channel, Side
from cutgate.protocol.states import ControllerState, Purpose, RuntimeCode, StopCause
from tests.protocol.sessions import CODES, DIGEST, KEY, OPEN, OTHER_DIGEST, TAG

NOW = 100.0
BEAT = RuntimeHeartbeat(RuntimeCode.INHIBIT, 0, StopCause.NONE)
PERMIT_NONCE = records.Nonce(purpose=Purpose.PERMIT, nonce=bytes(16), epoch=0)
COLLECT = records.Collect()
ANNOUNCE = records.Announce(
    protocol_version=records.PROTOCOL_VERSION,
    firmware_version="test",
    plant_speed_permille=1000,
    serial="SIM-1",
    announce_nonce=bytes(16),
    state=ControllerState.INHIBITED,
    cause=StopCause.NONE,
)


def endpoint(side, named=DIGEST, *, fd=False, key=KEY):
    made = Endpoint(side, key, heartbeat_s=0.02, timeout_s=0.1, transfer_timeout_s=1.0, fd=fd)
    if named:
        made.use_session(named)
        made.open_link(NOW)
    return made


@pytest.fixture
def runtime():
    return endpoint(Side.RUNTIME)


@pytest.fixture
def controller():
    return endpoint(Side.CONTROLLER)


def carry(one, other, now_s=NOW, change=lambda _can_id, data: data):
    """Frames to and fro until neither has any left; what both received."""
    items, rounds = {one: [], other: []}, 0
    while rounds < 100:
        moved = False
        for sender, receiver in ((one, other), (other, one)):
            for can_id, data in sender.outgoing():
                moved = True
                passing = change(can_id, data)
                if passing is not None:
                    items[receiver] += receiver.receive(
                        can_id, passing, is_fd=sender.is_fd(can_id), now_s=now_s
                    )
        if not moved:
            return items[one], items[other]
        rounds += 1
    raise AssertionError("they never end")


def send_raw(transfer_id, payload, receiver):
    """An ISO-TP single frame with this payload."""
    data = bytes([len(payload)]) + payload
    return receiver.receive(transfer_id, data.ljust(8, b"\xcc"), now_s=NOW)


# ---------------------------------------------------------------- codes


SIGNED = {
    records.Acknowledge(3, StopCause.OPERATOR_STOP): Side.RUNTIME,
    records.Withdraw(bytes(32), 5): Side.RUNTIME,
    records.Opened(3, ControllerState.OPEN, StopCause.NONE): Side.CONTROLLER,
}


@pytest.mark.parametrize(("record", "side"), SIGNED.items(), ids=lambda value: type(value).__name__)
def test_what_is_to_be_signed_is_signed_for_the_sequence_it_leaves_with(record, side):
    sender, receiver = endpoint(side), endpoint(side.peer)
    for sequence in (1, 2):
        sent = sender.send_record(record, NOW)
        assert sent.record == CODES.sign(record, sequence) != record
        _, (item,) = carry(sender, receiver)
        assert (item.record, item.authentic) == (sent.record, True)


@pytest.mark.parametrize(("record", "side"), SIGNED.items(), ids=lambda value: type(value).__name__)
def test_a_code_made_with_another_key_is_told(record, side):
    sender, receiver = endpoint(side, key=bytes(32)), endpoint(side.peer)
    sender.send_record(record, NOW)
    _, (item,) = carry(sender, receiver)
    assert not item.authentic


def test_a_signed_record_said_again_under_a_later_sequence_is_told():
    """Its envelope carries no more than a CRC: only the code covers the sequence."""
    sender, receiver = endpoint(Side.RUNTIME), endpoint(Side.CONTROLLER)
    sent = sender.send_record(records.Acknowledge(3, StopCause.OPERATOR_STOP), NOW)
    carry(sender, receiver)
    sender._transfers[Channel.CONTROL].send(records.pack(sent.record, TAG, 2), NOW)
    _, (item,) = carry(sender, receiver)
    assert (item.sequence, item.authentic) == (2, False)


@pytest.mark.parametrize(("key", "authentic"), [(KEY, True), (bytes(32), False)])
def test_an_open_is_signed_with_the_key_of_opens(key, authentic):
    sender, receiver = endpoint(Side.RUNTIME, None, key=key), endpoint(Side.CONTROLLER, None)
    sender.send_record(OPEN, NOW)
    _, (item,) = carry(sender, receiver)
    assert item.authentic is authentic


def test_what_carries_no_code_is_not_called_false(runtime, controller):
    controller.send_record(PERMIT_NONCE, NOW)
    _, (item,) = carry(controller, runtime)
    assert item.authentic


def test_without_a_session_nothing_of_one_is_authentic_and_nothing_signed(runtime):
    controller = endpoint(Side.CONTROLLER, None)
    opened = records.Opened(3, ControllerState.OPEN, StopCause.NONE)
    assert controller.send_record(opened, NOW, session=TAG).record == opened
    assert not controller._authentic(CODES.sign(opened, 1), 1)


def test_the_link_opens_with_the_session_in_use():
    made = endpoint(Side.RUNTIME, None)
    with pytest.raises(ValueError, match="no session is in use"):
        made.open_link(NOW)
    made.use_session(OTHER_DIGEST)
    made.open_link(NOW)
    assert made.link.tag == made.session == int.from_bytes(OTHER_DIGEST[:4], "little")


# ---------------------------------------------------------------- records


def test_a_record_arrives_as_it_was_sent(runtime, controller):
    sent = runtime.send_record(records.NonceRequest(purpose=Purpose.START), NOW)
    sequence, payload = sent.sequence, sent.payload
    assert sent.record == records.NonceRequest(purpose=Purpose.START)
    _, (item,) = carry(runtime, controller)
    assert item == RecordReceived(
        records.NonceRequest(purpose=Purpose.START),
        Channel.CONTROL,
        TAG,
        sequence,
        len(payload),
        records.digest(payload),
    )


@pytest.mark.parametrize(
    "said",
    [
        RecordReceived(COLLECT, Channel.CONTROL, TAG, 1, 30, bytes(32)),
        Sent(COLLECT, 1, b""),
        Undelivered("why"),
    ],
    ids=lambda said: type(said).__name__,
)
def test_what_was_sent_and_heard_stays_as_it_was(said):
    with pytest.raises(FrozenInstanceError):
        said.record = None


@pytest.mark.parametrize(
    ("record", "channel", "why"),
    [
        (COLLECT, Channel.CONTROL, "control channel: Collect is never sent by the controller"),
        (PERMIT_NONCE, Channel.BULK, "bulk channel: Nonce does not belong on the bulk channel"),
        (records.BlockStored(index=0), Channel.CONTROL, "BlockStored does not belong on the control channel"),
    ],
)
def test_a_record_of_the_other_side_or_of_the_other_channel_stops(runtime, controller, record, channel, why):
    controller._transfers[channel].send(records.pack(record, TAG, 1), NOW)
    _, (found,) = carry(controller, runtime)
    assert found.cause is StopCause.PROTOCOL_VIOLATION
    assert why in found.detail


@pytest.mark.parametrize("repeated", [1, 2])
def test_a_record_heard_again_is_discarded(runtime, controller, repeated):
    for _ in range(2):
        controller.send_record(PERMIT_NONCE, NOW)
    carry(controller, runtime)
    controller._sent[Channel.CONTROL] = repeated - 1
    controller.send_record(PERMIT_NONCE, NOW)
    _, items = carry(controller, runtime)
    assert items == [Discarded(f"record {repeated} after 2")]


def test_sequences_of_the_two_channels_are_apart(runtime, controller):
    controller.send_record(PERMIT_NONCE, NOW)
    controller.send_record(records.BlockStored(index=0), NOW)
    _, items = carry(controller, runtime)
    assert [(item.channel, item.sequence) for item in items] == [(Channel.CONTROL, 1), (Channel.BULK, 1)]


def test_a_record_of_another_session_is_discarded(runtime, controller):
    controller.send_record(PERMIT_NONCE, NOW, session=TAG + 1)
    _, items = carry(controller, runtime)
    assert items == [Discarded(f"record of session {TAG + 1:08x}")]


def test_an_announcement_is_heard_inside_and_outside_a_session(runtime):
    controller = endpoint(Side.CONTROLLER, named=None)
    for _ in range(2):  # its sequence does not count
        controller.send_record(ANNOUNCE, NOW)
        _, (item,) = carry(controller, runtime)
        assert (item.record, item.session) == (ANNOUNCE, NO_SESSION)
        controller.use_session(None)


def test_an_open_that_is_repeated_is_discarded_and_another_one_is_not(controller):
    """Also after the first one has opened the session, and whatever number another one bears."""
    runtime = endpoint(Side.RUNTIME, named=None)
    payload = runtime.send_record(OPEN, NOW).payload
    runtime._transfers[Channel.CONTROL].send(payload, NOW)
    runtime.send_record(OPEN, NOW)
    runtime.send_record(replace(OPEN, runtime_nonce=b"another nonce".ljust(16)), NOW)
    _, heard = carry(runtime, controller)
    assert [getattr(item, "sequence", item) for item in heard] == [1, Discarded("record 1 repeated"), 2, 3]


def test_what_goes_out_is_voided_and_what_comes_in_goes_on(runtime, controller):
    controller.send_record(PERMIT_NONCE, NOW)
    runtime.send_record(COLLECT, NOW)
    runtime.send_record(COLLECT, NOW)
    for can_id, data in controller.outgoing():
        runtime.receive(can_id, data, now_s=NOW)
    for can_id, data in runtime.outgoing():
        controller.receive(can_id, data, now_s=NOW)
    runtime.stop_sending()
    (heard, (item,)) = carry(controller, runtime)
    assert (heard, item.record) == ([], PERMIT_NONCE)
    runtime.send_record(COLLECT, NOW)
    _, items = carry(runtime, controller)
    assert [getattr(item, "record", None) for item in items][-1] == COLLECT


def test_a_control_record_that_waits_for_its_peer_is_seen_and_a_block_is_none(runtime, controller):
    assert not controller.control_waits
    controller.send_record(records.BlockStored(index=0), NOW)
    assert not controller.control_waits
    controller.send_record(PERMIT_NONCE, NOW)
    assert controller.control_waits
    carry(controller, runtime)
    assert not controller.control_waits


def test_a_record_that_is_none_stops_a_session_and_is_dropped_outside(runtime):
    (found,) = send_raw(CONTROL_IDS[1], b"\xff\0\0", runtime)
    assert found.cause is StopCause.PROTOCOL_VIOLATION
    assert found.detail.startswith("control channel: ")
    runtime.end_session()
    (found,) = send_raw(CONTROL_IDS[1], b"\xff\0\0", runtime)
    assert isinstance(found, Discarded)


@pytest.mark.parametrize("which", range(5))
def test_one_flipped_bit_in_any_frame_never_makes_a_record(which):
    """The record is refused, or the transfer fails or stands still."""
    sender, receiver, count = endpoint(Side.CONTROLLER), endpoint(Side.RUNTIME), 0

    def change(can_id, data):
        nonlocal count
        count += can_id == CONTROL_IDS[1]
        hit = can_id == CONTROL_IDS[1] and count == which + 1
        return data[:3] + bytes([data[3] ^ 4]) + data[4:] if hit else data

    sender.send_record(PERMIT_NONCE, NOW)
    _, items = carry(sender, receiver, change=change)
    assert count == 5
    assert not any(isinstance(item, RecordReceived) for item in items)


@pytest.mark.parametrize("tag", [DIGEST, None])
def test_a_lost_frame_is_a_failed_transfer_inside_a_session_only(tag):
    """Outside one nobody waits for an announcement: the next one follows."""
    sender, receiver, count = endpoint(Side.CONTROLLER, tag), endpoint(Side.RUNTIME, tag), 0

    def change(can_id, data):
        nonlocal count
        count += can_id == CONTROL_IDS[1]
        return None if can_id == CONTROL_IDS[1] and count == 3 else data

    sender.send_record(PERMIT_NONCE if tag else ANNOUNCE, NOW)
    _, items = carry(sender, receiver, change=change)
    causes = [item.cause for item in items if isinstance(item, Violation)]
    assert causes == ([StopCause.TRANSFER_FAILED] if tag else [])


@pytest.mark.parametrize("side", [Side.RUNTIME, Side.CONTROLLER])
@pytest.mark.parametrize("asked", [b"\x30\x20\x0a", b"\x30\x00\x00", b"\x31\x00\x00", b"\x32\x00\x00"])
def test_a_flow_control_that_is_not_obeyed_stops_a_session_and_is_told_outside(side, asked):
    """OPEN and the announcement are the first records that it meets: there the peer only seems to be silent."""
    data = asked.ljust(8, b"\xcc")
    inside, outside = endpoint(side), endpoint(side, named=None)
    heard = []
    for made in (inside, outside):
        made.send_record(OPEN if side is Side.RUNTIME else ANNOUNCE, NOW, session=NO_SESSION)
        made.outgoing()
        heard.append(made.receive(CONTROL_IDS[side.peer], data, now_s=NOW))
    ((stopping,), (told,)) = heard
    assert stopping.cause is StopCause.TRANSFER_FAILED
    assert told == Undelivered(stopping.detail)
    assert told.detail.startswith("control channel: ")
    if asked[2]:
        assert told.detail.endswith("separation time (STmin) of 0x0a, must be 0")


def test_a_record_on_its_way_is_seen(runtime, controller):
    controller.send_record(PERMIT_NONCE, NOW)
    assert not runtime.receiving
    for can_id, data in controller.outgoing():
        runtime.receive(can_id, data, now_s=NOW)
    assert runtime.receiving
    carry(controller, runtime)
    assert not runtime.receiving


# ---------------------------------------------------------------- time


@pytest.mark.parametrize("tag", [DIGEST, None])
def test_a_transfer_that_stands_still_fails_inside_a_session_only(tag):
    made = endpoint(Side.CONTROLLER, tag)
    made.send_record(PERMIT_NONCE if tag else ANNOUNCE, NOW)
    made.outgoing()
    assert not [found for found in made.expire(NOW) if found.cause is StopCause.TRANSFER_FAILED]
    late = [found for found in made.expire(NOW + 1.1) if found.cause is StopCause.TRANSFER_FAILED]
    assert len(late) == (1 if tag else 0)
    assert all("control channel" in found.detail for found in late)


@pytest.mark.parametrize("timeout_s", [0.25, 4.0])
def test_a_transfer_may_stand_still_for_as_long_as_the_endpoint_was_told(timeout_s):
    made = Endpoint(Side.CONTROLLER, KEY, heartbeat_s=0.02, timeout_s=0.1, transfer_timeout_s=timeout_s)
    made.use_session(DIGEST)
    made.open_link(NOW)
    made.send_record(PERMIT_NONCE, NOW)
    made.outgoing()
    made.expire(NOW)

    def causes(now_s):
        return [found.cause for found in made.expire(now_s)]

    assert StopCause.TRANSFER_FAILED not in causes(NOW + timeout_s - 0.01)
    assert StopCause.TRANSFER_FAILED in causes(NOW + timeout_s + 0.01)


def test_silence_is_a_lost_peer(runtime):
    assert runtime.expire(NOW + 0.1) == []
    (lost,) = runtime.expire(NOW + 0.1001)
    assert lost == Violation(StopCause.HEARTBEAT_LOST, "no fresh heartbeat within 100 ms")
    runtime.end_session()
    assert runtime.expire(NOW + 9.0) == []


def test_timing_that_was_agreed_replaces_the_link(controller):
    controller.use_timing(heartbeat_s=0.05, timeout_s=0.5)
    assert not controller.link.is_open
    assert (controller.link.heartbeat_s, controller.link.timeout_s) == (0.05, 0.5)


# ---------------------------------------------------------------- frames


def test_single_frames_leave_before_transfers(runtime):
    runtime.send_record(records.Collect(), NOW)
    runtime.send_frame(BEAT, NOW)
    assert [can_id for can_id, _ in runtime.outgoing()] == [IDS[RuntimeHeartbeat], CONTROL_IDS[0]]
    assert runtime.outgoing() == []


def test_a_heartbeat_is_accepted_and_others_are_not_ours(runtime, controller):
    runtime.send_frame(BEAT, NOW)
    _, (item,) = carry(runtime, controller)
    assert isinstance(item, Accepted)
    assert item.frame.code is RuntimeCode.INHIBIT
    assert controller.receive(0x123, bytes(8), now_s=NOW) == []


def test_flags_of_a_frame_are_looked_at(controller):
    can_id, data = encode_frame(BEAT, 0, TAG)
    (found,) = controller.receive(can_id, data, is_error=True, now_s=NOW)
    assert isinstance(found, Discarded)
    assert controller.receive(can_id, data, is_extended=True, now_s=NOW) == []
    for flag in ("is_remote", "is_fd"):
        (found,) = controller.receive(can_id, data, now_s=NOW, **{flag: True})
        assert found == Discarded(f"{can_id:#05x} corrupted")


def test_a_frame_on_ones_own_identifier_is_a_second_node(runtime):
    (found,) = runtime.receive(IDS[RuntimeHeartbeat], bytes(8), now_s=NOW)
    assert found.cause is StopCause.SECOND_NODE


def test_the_end_of_a_session_voids_everything(runtime, controller):
    controller.send_record(PERMIT_NONCE, NOW)
    frames = controller.outgoing()
    for can_id, data in frames:
        runtime.receive(can_id, data, now_s=NOW)
    runtime.send_record(records.Collect(), NOW)
    runtime.send_record(records.Collect(), NOW)
    runtime.end_session()
    assert (runtime.session, runtime.link.is_open, runtime.outgoing()) == (NO_SESSION, False, [])
    runtime.use_session(DIGEST)
    assert runtime.send_record(records.Collect(), NOW).sequence == 1


def test_an_aborted_transfer_does_not_go_on(runtime, controller):
    controller.send_record(PERMIT_NONCE, NOW)
    for can_id, data in controller.outgoing():
        runtime.receive(can_id, data, now_s=NOW)
    flow_control = runtime.outgoing()
    controller.abort()
    for can_id, data in flow_control:
        assert controller.receive(can_id, data, now_s=NOW) == []
    assert controller.outgoing() == []


def test_a_controllers_heartbeat_carries_what_it_was_given(runtime, controller):
    beat = ControllerHeartbeat(
        state=ControllerState.OPEN,
        epoch=3,
        cause=StopCause.NONE,
        device_pressed=True,
        emergency_stop_ok=True,
        cutting_mode=False,
    )
    controller.send_frame(beat, NOW)
    _, (item,) = carry(controller, runtime)
    assert item.frame == replace(beat, echo=item.frame.echo, tag=item.frame.tag)


# ------------------------------------------------------------------ CAN FD


def test_with_fd_bulk_frames_alone_leave_as_fd_also_after_the_timing_was_agreed(runtime):
    assert not any(runtime.is_fd(can_id) for can_id in range(0x800))
    with_fd = endpoint(Side.RUNTIME, fd=True)
    with_fd.use_timing(heartbeat_s=0.05, timeout_s=0.5)
    assert [can_id for can_id in range(0x800) if with_fd.is_fd(can_id)] == [0x640, 0x641]
    with_fd.send_record(records.Collect(), NOW)
    with_fd.send_record(BLOCKS[0], NOW)
    assert [(can_id, len(data)) for can_id, data in with_fd.outgoing()] == [(0x600, 8), (0x640, 64)]


BLOCKS = records.split(bytes(range(256)) * 40)  # 510 poses of no path


@pytest.mark.parametrize("fd", [False, True], ids=["classic", "FD"])
@given(
    what=st.dictionaries(
        st.integers(0, 400), st.sampled_from(["lost", "doubled", "flipped", "late"]), max_size=3
    ),
    place=st.integers(0, 511),
)
@settings(max_examples=40, deadline=None)
def test_a_block_that_arrives_is_the_one_that_was_sent_once_and_in_order(what, place, fd):
    """Frames to the controller are counted; a flipped bit anywhere in one is found by a CRC unless it was padding."""
    runtime, controller = endpoint(Side.RUNTIME, fd=fd), endpoint(Side.CONTROLLER, fd=fd)
    got, late, count = [], [], 0
    for block in BLOCKS:
        runtime.send_record(block, NOW)
    while frames := runtime.outgoing():
        for can_id, data in frames:
            change, count = what.get(count), count + 1
            waiting, late = late, [data] if change == "late" else []
            at, bit = divmod(place % (8 * len(data)), 8)
            flip = bytes([data[at] ^ (1 << bit if change == "flipped" else 0)])
            arriving = data[:at] + flip + data[at + 1 :]
            for passing in [arriving] * {"lost": 0, "doubled": 2, "late": 0}.get(change, 1) + waiting:
                got += controller.receive(can_id, passing, is_fd=fd, now_s=NOW)
        for can_id, data in controller.outgoing():
            runtime.receive(can_id, data, is_fd=fd, now_s=NOW)
    received = [item.record for item in got if isinstance(item, RecordReceived)]
    indices = [record.index for record in received]
    assert received == [BLOCKS[index] for index in indices]
    assert indices == sorted(set(indices))
    if not what:
        assert received == BLOCKS
