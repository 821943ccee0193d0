"""What a node without the key can say to a runtime: it may deny and stop, and moves nothing on."""

from dataclasses import replace

import can
import pytest

from cutgate.protocol import records
from cutgate.protocol.codes import fingerprint
from cutgate.protocol.endpoint import Endpoint
from cutgate.protocol.frames import (
    CONTROL_IDS,
    IDS,
    ControllerFault,
    ControllerHeartbeat,
    RuntimeStop,
    encode_frame,
)
from cutgate.protocol.records import Side
from cutgate.protocol.states import ControllerState, FaultCode, Refusal, StopCause, StopCode
from cutgate.runtime.interlock.state import Dropped, Phase
from tests.runtime.session.pair import KEY
from tests.runtime.session.test_session import first_frames
from tests.runtime.session.wire import CONTROLLER, RUNTIME

OTHER_KEY = KEY[::-1]
ACCEPTING = {
    Phase.PERMITTING: records.Permit,
    Phase.STARTING: records.Start,
}


class Forger:
    """Speaks as the controller into the runtime's ears: it has heard the whole session, and has another key."""

    def __init__(self, pair):
        self._pair = pair
        self.endpoint = Endpoint(
            Side.CONTROLLER, OTHER_KEY, heartbeat_s=0.02, timeout_s=0.1, transfer_timeout_s=2.0
        )
        self.endpoint.use_session(pair.state.session.digest)
        self.endpoint._sent = dict.fromkeys(self.endpoint._sent, 1000)
        pair.wire.rules.append(self._listen)
        pair.strangers.append(self)

    def _listen(self, message):
        if message.arbitration_id == CONTROL_IDS[RUNTIME]:
            self.endpoint.receive(message.arbitration_id, bytes(message.data), now_s=self._pair.clock())
        return [message]

    def say(self, record):
        self.endpoint.send_record(record, self._pair.clock())

    def speak(self):
        for can_id, data in self.endpoint.outgoing():
            self._pair.wire.nodes[RUNTIME].put(can_id, data)


def keep_out(pair, *can_ids):
    """Of the controller nothing more on these identifiers reaches the runtime."""
    pair.wire.rules.append(lambda message: [] if message.arbitration_id in can_ids else [message])


def test_an_opened_that_another_key_made_opens_nothing(pair):
    pair.begin().until(lambda: pair.phase is Phase.OPENING)
    pair.controller_runs = False
    Forger(pair).say(records.Opened(0, ControllerState.OPEN, StopCause.NONE))
    pair.run(0.2)
    assert pair.phase is Phase.OPENING
    (dropped,) = [effect for effect in pair.notes.effects if isinstance(effect, Dropped)]
    assert dropped.what.startswith(
        "an OPENED that no holder of the key made (this side's has the fingerprint"
    )
    assert pair.end() is Phase.REFUSED
    assert "the controller did not open the session" in pair.state.reason


def test_an_open_under_another_key_is_refused_with_the_fingerprint_of_this_side(pair):
    pair.job = replace(pair.job, key_fingerprint=fingerprint(OTHER_KEY))
    pair.begin()
    pair.session._port.endpoint._key = Endpoint(
        Side.RUNTIME, OTHER_KEY, heartbeat_s=0.02, timeout_s=0.1, transfer_timeout_s=2.0
    )._key
    assert pair.end() is Phase.REFUSED
    assert "MAC_INVALID: the two key files differ" in pair.state.reason
    assert pair.state.reason.endswith(f"(this side's has the fingerprint {fingerprint(OTHER_KEY)})")
    assert pair.controller.state is ControllerState.INHIBITED


def test_a_controller_of_version_3_is_refused_in_words(pair):
    """Whatever else stands in what it announces."""
    pair.controller_runs = False
    pair.begin()
    body = records.PROTOCOL_VERSION - 1, bytes(51)
    forger = Endpoint(Side.CONTROLLER, KEY, heartbeat_s=0.02, timeout_s=0.1, transfer_timeout_s=2.0)

    class Older(records.Announce):
        def body(self):
            return body[0].to_bytes(2, "little") + body[1]

    said = Older(3, "old", "SIM-1", bytes(16), 1000, ControllerState.INHIBITED, StopCause.NONE)
    forger.send_record(said, pair.clock())

    def speak():
        for can_id, data in forger.outgoing():
            pair.wire.nodes[RUNTIME].put(can_id, data)

    def listen(message):
        if message.arbitration_id == CONTROL_IDS[RUNTIME]:
            forger.receive(message.arbitration_id, bytes(message.data), now_s=pair.clock())
        return [message]

    pair.wire.rules.append(listen)
    pair.until(lambda: pair.phase is Phase.REFUSED, act=speak)
    assert pair.state.reason == (
        "protocol version: 3 (required: 4): use a controller and a runtime of the same protocol version"
    )


@pytest.mark.parametrize("phase", ACCEPTING, ids=str)
def test_a_forged_reply_that_accepts_moves_nothing_on(pair, phase):
    """The controller's own answer and heartbeats do not come: what it has accepted is not known."""
    pair.to(phase)
    keep_out(pair, CONTROL_IDS[CONTROLLER])
    pair.controller_runs = False
    Forger(pair).say(records.Reply(ACCEPTING[phase].TYPE, 1, Refusal.ACCEPTED, StopCause.NONE, 1))
    pair.run(0.05)
    assert pair.phase is phase
    assert pair.end() is Phase.STOPPED


def test_a_forged_refusal_denies_and_the_controller_that_had_accepted_is_stopped(pair):
    pair.power_up(time_scale=0.05)
    pair.to(Phase.STARTING)
    Forger(pair).say(records.Reply(records.Start.TYPE, 1, Refusal.EPOCH, StopCause.NONE, 0))
    pair.end()
    pair.run(0.2)
    assert pair.phase is Phase.STOPPED
    assert not pair.controller.may_move


@pytest.mark.parametrize("cause", [StopCause.BONE_MOVED, StopCause.REGISTRATION_WITHDRAWN])
def test_a_forged_fault_frame_stops_and_withdraws_nothing(pair, cause):
    pair.power_up(time_scale=0.05)
    pair.to(Phase.CUTTING)
    can_id, data = encode_frame(ControllerFault(FaultCode.STOPPED, cause), 0, pair.state.session.tag)
    pair.wire.nodes[RUNTIME].put(can_id, data)
    assert pair.end() is Phase.STOPPED
    pair.run(0.2)
    assert (pair.state.cause, pair.state.registration_withdrawn) == (cause, False)
    assert not pair.controller.may_move
    assert not first_frames(pair, records.Withdraw)
    assert (pair.controller.memory.withdrawn, pair.controller.memory.withdrawal_due) == (frozenset(), False)
    pair.close()
    fault = next(one for one in pair.read().of("/audit/fault") if one["source"] == "controller")
    assert (fault["cause"], fault["detail"]) == (cause.name, "claimed: a fault frame carries no code")


@pytest.mark.parametrize("cause", [StopCause.BONE_MOVED, StopCause.REGISTRATION_WITHDRAWN])
@pytest.mark.parametrize("code", StopCode)
def test_a_forged_stop_frame_stops_and_does_not_come_back_under_the_controllers_tag(pair, code, cause):
    """Else the runtime believes it, and withdraws under its own code what a stranger has claimed."""
    pair.power_up(time_scale=0.05)
    pair.to(Phase.CUTTING)
    can_id, data = encode_frame(RuntimeStop(code, cause), 0, pair.state.session.tag)
    pair.wire.nodes[CONTROLLER].put(can_id, data)
    assert pair.end() is Phase.STOPPED
    pair.run(0.2)
    assert not pair.controller.may_move
    assert (pair.controller.cause, pair.state.registration_withdrawn) == (StopCause.PROTOCOL_VIOLATION, False)
    assert not first_frames(pair, records.Withdraw)
    assert (pair.controller.memory.withdrawn, pair.controller.memory.withdrawal_due) == (frozenset(), False)


@pytest.mark.parametrize("phase", [Phase.PERMITTING, Phase.STARTING, Phase.CUTTING], ids=str)
def test_a_heartbeat_that_another_key_made_stops_and_is_never_believed(pair, phase):
    pair.power_up(time_scale=0.05)
    pair.to(phase)

    def forge(message):
        if message.arbitration_id != IDS[ControllerHeartbeat]:
            return [message]
        forged = ControllerHeartbeat(
            state=ControllerState.DONE if phase is Phase.CUTTING else ControllerState.CUTTING,
            epoch=pair.state.epoch,
            cause=StopCause.NONE,
            device_pressed=True,
            emergency_stop_ok=True,
            cutting_mode=True,
            echo=message.data[5],
            tag=int.from_bytes(message.data[3:5], "little") ^ 1,
        )
        can_id, data = encode_frame(forged, message.data[2], pair.state.session.tag)
        return [can.Message(arbitration_id=can_id, data=data, is_extended_id=False)]

    pair.wire.rules.append(forge)
    pair.until(lambda: pair.phase is not phase)
    assert (pair.phase, pair.state.cause) == (Phase.STOPPING, StopCause.AUTHENTICATION_FAILED)
    pair.run(0.2)
    assert not pair.controller.may_move
