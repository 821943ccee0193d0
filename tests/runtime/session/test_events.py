"""What arrives, as events of the interlock."""

import pytest

from cutgate.protocol import records
from cutgate.protocol.endpoint import RecordReceived
from cutgate.protocol.frames import ControllerHeartbeat
from cutgate.protocol.states import ControllerState, Purpose, Refusal, StopCause
from cutgate.runtime.interlock.state import (
    Announced,
    BlockConfirmed,
    CommandGiven,
    ControllerView,
    NonceReceived,
    OperatorCommand,
    OtherVersionAnnounced,
    ParameterReceived,
    PathConfirmed,
    ReplyReceived,
    SessionOpened,
    UploadedPath,
)
from cutgate.runtime.session import events
from tests.runtime.interlock.builders import ANNOUNCE, CALIBRATION, EPOCH, LIMITS, NONCE, OPENED, TOOL

DIGEST = records.digest(b"path")
MEANINGS = [
    (records.OtherVersion(records.Announce.TYPE, 3), OtherVersionAnnounced(3)),
    (LIMITS, ParameterReceived(LIMITS)),
    (CALIBRATION, ParameterReceived(CALIBRATION)),
    (TOOL, ParameterReceived(TOOL)),
    (records.BlockStored(2), BlockConfirmed(2)),
    (records.PathStored(DIGEST, Refusal.ACCEPTED, 0), PathConfirmed(UploadedPath(DIGEST, Refusal.ACCEPTED, 0))),
    (records.Nonce(Purpose.START, NONCE, EPOCH), NonceReceived(Purpose.START, NONCE, EPOCH)),
    (records.Reply(0x0A, 5, Refusal.NONCE_EXPIRED, StopCause.NONE, 0), ReplyReceived(0x0A, Refusal.NONCE_EXPIRED, StopCause.NONE)),
    (records.Reply(0x0A, 5, Refusal.ACCEPTED, StopCause.BONE_MOVED, 7), ReplyReceived(0x0A, Refusal.ACCEPTED, StopCause.BONE_MOVED)),
]  # fmt: skip


def received(record, *, authentic=True):
    """As the endpoint gives it."""
    return RecordReceived(record, record.CHANNEL, 7, 1, 0, bytes(32), authentic)


@pytest.mark.parametrize(("record", "event"), MEANINGS, ids=range(len(MEANINGS)))
def test_every_field_of_a_record_reaches_the_table(record, event):
    assert events.of_record(received(record), random=lambda _: b"") == event


def test_an_announcement_comes_with_a_nonce_drawn_for_it():
    assert events.of_record(received(ANNOUNCE), random=bytes) == Announced(ANNOUNCE, bytes(16))


@pytest.mark.parametrize("authentic", [True, False])
def test_an_opened_session_comes_whole_and_with_what_its_code_proves(authentic):
    heard = events.of_record(received(OPENED, authentic=authentic), random=bytes)
    assert heard == SessionOpened(OPENED, authentic)


def test_every_record_of_the_controller_means_something_to_the_table():
    sent = {kind for kind in records.RECORDS.values() if kind.SENDER is records.Side.CONTROLLER}
    assert set(events.OF_RECORD) == {type(record) for record, _ in MEANINGS}
    assert set(events.OF_RECORD) == (sent - {records.Announce, records.Opened}) | {records.OtherVersion}


@pytest.mark.parametrize("field", ["device_pressed", "emergency_stop_ok", "cutting_mode"])
def test_a_heartbeat_tells_each_of_its_signals(field):
    signals = dict.fromkeys(("device_pressed", "emergency_stop_ok", "cutting_mode"), False) | {field: True}
    beat = ControllerHeartbeat(
        state=ControllerState.INHIBITED, cause=StopCause.OPERATOR_STOP, epoch=EPOCH, **signals
    )
    signals["emergency_stop_clear"] = signals.pop("emergency_stop_ok")
    expected = ControllerView(
        state=ControllerState.INHIBITED, cause=StopCause.OPERATOR_STOP, epoch=EPOCH, **signals
    )
    assert events.view_of(beat) == expected


@pytest.mark.parametrize("word", OperatorCommand, ids=str)
def test_each_command_of_the_operator_is_itself(word):
    assert events.of_operator(word) == CommandGiven(word)


@pytest.mark.parametrize(
    ("typed", "what"),
    [
        ("confirm box_small", "BOX_SMALL"),
        ("confirm  Witness", "WITNESS"),
        ("confirm", ""),
        ("confirm box small now", "BOX SMALL NOW"),
    ],
)
def test_a_confirmation_names_what_it_confirms(typed, what):
    assert events.of_operator(typed) == CommandGiven(OperatorCommand.CONFIRM, what)


@pytest.mark.parametrize("typed", ["begin", "start now", "CONFIRM X", "confirmX"])
def test_anything_else_is_no_command(typed):
    assert events.of_operator(typed) is None
