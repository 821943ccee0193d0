"""What arrives, as events of the table: each frame and record exactly one, and nothing of another session."""

from dataclasses import replace

import pytest

from cutgate.firmware_sim import arrivals
from cutgate.firmware_sim.state import (
    AcknowledgeReceived,
    CollectReceived,
    FaultArisen,
    HeartbeatLost,
    HeartbeatReceived,
    NonceRequested,
    OpenReceived,
    PermitReceived,
    ResetReceived,
    StartReceived,
    StopReceived,
    WithdrawReceived,
)
from cutgate.protocol import records
from cutgate.protocol.endpoint import RecordReceived
from cutgate.protocol.frames import ControllerFault, RuntimeHeartbeat, RuntimeStop
from cutgate.protocol.link import Accepted, Violation
from cutgate.protocol.records import Channel, Side
from cutgate.protocol.states import FaultCode, Purpose, RuntimeCode, StopCause, StopCode
from tests.firmware_sim.controllers import OPEN, OPENED, OWN_RESET, PERMIT, PLACE, START, TAG

BEAT = RuntimeHeartbeat(RuntimeCode.CUT, 7, StopCause.OPERATOR_STOP)
BLOCK = records.split(bytes(100))[0]
OTHER_VERSION = records.OtherVersion(records.Open.TYPE, 3)
ACKNOWLEDGE, WITHDRAW = records.Acknowledge(3, StopCause.SECOND_NODE), records.Withdraw(PLACE, 17)


def received(record, *, session=TAG, sequence=9, authentic=True):
    return RecordReceived(record, record.CHANNEL, session, sequence, 20, bytes(32), authentic)


def no_random(_count):
    raise AssertionError("no random number is needed")


@pytest.mark.parametrize("fresh", [False, True])
def test_a_heartbeat_keeps_what_it_says_and_whether_it_is_fresh(fresh):
    accepted = Accepted(BEAT, 3, fresh=fresh)
    assert arrivals.of_frame(accepted) == HeartbeatReceived(
        RuntimeCode.CUT, 7, StopCause.OPERATOR_STOP, fresh
    )


def test_a_stop_keeps_its_code_and_its_cause():
    accepted = Accepted(RuntimeStop(StopCode.END, StopCause.SESSION_ENDED), 3)
    assert arrivals.of_frame(accepted) == StopReceived(StopCode.END, StopCause.SESSION_ENDED)


def test_any_other_frame_says_nothing_to_the_table():
    assert arrivals.of_frame(Accepted(ControllerFault(FaultCode.STOPPED, StopCause.NONE), 3)) is None


@pytest.mark.parametrize("cause", StopCause)
def test_what_is_late_is_a_lost_peer_or_a_fault_of_its_cause(cause):
    expected = HeartbeatLost() if cause is StopCause.HEARTBEAT_LOST else FaultArisen(cause)
    assert arrivals.of_lateness(Violation(cause, "late")) == expected


@pytest.mark.parametrize(
    ("record", "session", "here", "belongs"),
    [
        (records.Collect(), TAG, OPENED.session, True),
        (records.Collect(), TAG + 1, OPENED.session, False),
        (records.Collect(), 0, OPENED.session, False),
        (records.Collect(), TAG, None, False),
        (OPEN, 0, None, True),
        (OPEN, 0, OPENED.session, True),
        (OTHER_VERSION, 0, None, True),
        (OTHER_VERSION, 0, OPENED.session, True),
        (WITHDRAW, TAG, OPENED.session, True),
        (WITHDRAW, TAG + 1, OPENED.session, False),
        (BLOCK, TAG, OPENED.session, True),
        (BLOCK, TAG, None, False),
    ],
)
def test_only_what_is_of_this_session_or_asks_for_one_belongs(record, session, here, belongs):
    assert arrivals.belongs(received(record, session=session), here) is belongs


def test_a_record_of_a_session_that_a_stop_has_voided_still_belongs():
    """The table refuses it, with the reason."""
    voided = replace(OPENED.session, live=False)
    assert arrivals.belongs(received(records.Collect()), voided)


@pytest.mark.parametrize(
    ("record", "event"),
    [
        (PERMIT, PermitReceived),
        (START, StartReceived),
        (OWN_RESET, ResetReceived),
        (ACKNOWLEDGE, AcknowledgeReceived),
        (WITHDRAW, WithdrawReceived),
    ],
    ids=lambda value: type(value).__name__,
)
@pytest.mark.parametrize("authentic", [True, False])
def test_each_record_is_its_event_with_its_sequence_and_whether_its_code_fits(record, event, authentic):
    item = received(record, authentic=authentic)
    assert arrivals.of_record(item, no_random) == event(record, 9, authentic)


def test_what_carries_no_code_says_nothing_of_one():
    assert arrivals.of_record(received(records.Collect()), no_random) == CollectReceived()


@pytest.mark.parametrize("record", [OPEN, OTHER_VERSION], ids=["open", "other version"])
@pytest.mark.parametrize("authentic", [True, False])
def test_an_open_comes_with_the_next_nonce_to_announce(record, authentic):
    asked = []
    event = arrivals.of_record(
        received(record, session=0, authentic=authentic), lambda count: asked.append(count) or b"n" * count
    )
    assert event == OpenReceived(record, 9, authentic, b"n" * 16)
    assert asked == [16]


@pytest.mark.parametrize("purpose", Purpose)
def test_a_nonce_is_16_bytes_of_the_systems_generator(purpose):
    asked = []
    event = arrivals.of_record(
        received(records.NonceRequest(purpose)), lambda count: asked.append(count) or b"n" * count
    )
    assert event == NonceRequested(purpose, b"n" * 16)
    assert asked == [16]


def test_a_block_of_a_path_is_no_event():
    assert arrivals.of_record(received(BLOCK), no_random) is None


def test_every_record_of_the_runtime_but_a_block_has_its_event():
    sent = {kind for kind in records.RECORDS.values() if kind.SENDER is Side.RUNTIME}
    assert {*arrivals.OF_RECORD, records.Open, records.NonceRequest, records.PathBlock} == sent
    assert {kind.CHANNEL for kind in arrivals.OF_RECORD} == {Channel.CONTROL}


def test_the_arm_is_measured_for_what_depends_on_where_it_stands():
    assert set(arrivals.JUDGED_WHERE_THE_ARM_STANDS) == {records.Permit, records.Start}
