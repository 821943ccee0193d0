"""What becomes of a step in the log, and that no text can break it."""

import json
import sys
from dataclasses import replace
from hashlib import sha256
from typing import get_args

import pytest

from cutgate.protocol import records
from cutgate.protocol.codes import fingerprint
from cutgate.protocol.link import Statistics
from cutgate.protocol.port import Passed
from cutgate.protocol.records import Side
from cutgate.protocol.states import ControllerState, FaultCode, Purpose, Refusal, StopCause, StopCode
from cutgate.runtime.audit.inspect import read_log
from cutgate.runtime.audit.witness import WitnessFound
from cutgate.runtime.interlock.state import (
    CommandGiven,
    Dropped,
    Event,
    Failed,
    FaultReceived,
    Gone,
    NonceReceived,
    OperatorCommand,
    OtherVersionAnnounced,
    Phase,
    Refused,
    ReplyReceived,
    Send,
    SendBlock,
    SendStop,
    SendWithdraw,
    Tick,
    WithdrawalSent,
)
from cutgate.runtime.interlock.table import EVERYWHERE
from cutgate.runtime.session.journal import NAMES, Journal, plain
from tests.logs import judged
from tests.runtime.interlock.builders import (
    DURABLE_LOG,
    ELSEWHERE,
    EPOCH,
    FOUND,
    JOB,
    MISSED,
    NONCE,
    NOW,
    ON,
    READY,
    SEEN_LOG,
    TIMING,
    TOKEN,
    beat,
    durable,
    in_phase,
    measured,
    opened,
    step,
)
from tests.runtime.session.pair import KEY

BAD = "caf\udce9 \ud800"
SHOWN = "caf\\udce9 \\ud800"
WITHDRAWAL = SendWithdraw(JOB.place)


@pytest.fixture
def log(pair):
    """A log without a session: the journal alone writes to it."""
    return pair.begin()


def written(pair, topic):
    paths = pair.log.close(final_state="x", clean=True)
    found = judged(paths.log)
    assert found.report.status.name == "OK"
    return found.of(topic)


@pytest.mark.parametrize("text", ["", "plain", "Ünïcode ✓", "\0\n\x7f"])
def test_text_that_can_be_stored_stays_as_it_is(text):
    assert plain(text) == text


def test_text_that_cannot_be_stored_is_spelled_out():
    assert plain(BAD) == SHOWN
    plain(BAD).encode()


def test_arguments_that_are_no_text_are_recorded_all_the_same(log, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["cutgate", "run", BAD])
    log.journal.processes(7)
    processes = written(log, "/audit/process")
    assert processes[-2]["argv"] == ["cutgate", "run", SHOWN]
    assert (processes[-1]["role"], processes[-1]["pid"]) == ("verifier", 7)


def test_reasons_that_are_no_text_are_recorded_all_the_same(log):
    journal, state = log.journal, READY
    stopped = in_phase(Phase.STOPPING, reason=BAD, cause=StopCause.INTERNAL_ERROR)
    journal.step(state, Failed(StopCause.INTERNAL_ERROR, BAD), stopped, (), 1.0)
    journal.step(
        state, CommandGiven(OperatorCommand.START), state, (Refused(OperatorCommand.START, BAD),), 1.0
    )
    journal.step(state, CommandGiven(OperatorCommand.STOP), state, (Dropped(BAD),), 1.0)
    decisions = written(log, "/audit/decision")
    assert [decision["reason"] for decision in decisions] == [SHOWN, SHOWN, f"dropped {SHOWN}"]


def test_a_channel_that_is_no_text_can_name_the_raw_frames(log):
    journal = Journal(log.log, "vc\udcffan", TIMING)
    journal.frame(Passed("received", 0x123, bytes(8), False, False, False, False))
    assert written(log, "/can/frame")[-1]["id"] == 0x123


def test_frames_of_transfers_are_raw_only(log):
    for can_id in (0x600, 0x641, 0x080):
        log.journal.frame(Passed("sent", can_id, bytes(8), False, False, False, False))
    log.journal.frame(Passed("received", 0x18FF0001, b"", True, True, False, False))
    frames = written(log, "/can/frame")
    assert [frame["id"] for frame in frames] == [0x080, 0x18FF0001]
    assert (frames[1]["is_extended"], frames[1]["is_rtr"], frames[1]["dlc"]) == (True, True, 0)
    (candump,) = (log.directory / "logs").glob("*.candump.log")
    assert candump.read_text().splitlines()[-1].endswith("vcan0 18FF0001#R")


def test_only_the_frames_of_our_own_transfers_are_raw_only(log):
    """What a stranger sends beside them is what a reviewer looks for; so is an error of the bus of that number."""
    log.journal.frame(Passed("received", 0x610, bytes(8), False, False, False, False))
    log.journal.frame(Passed("received", 0x600, bytes(8), True, False, False, False))
    log.journal.frame(Passed("received", 0x004, bytes(8), False, False, True, False))
    frames = written(log, "/can/frame")
    assert [(frame["id"], frame["is_extended"], frame["is_error"]) for frame in frames] == [
        (0x610, False, False),
        (0x600, True, False),
        (0x004, False, True),
    ]
    (candump,) = (log.directory / "logs").glob("*.candump.log")
    lines = [line.split(" ")[-1] for line in candump.read_text().splitlines()]
    assert lines == ["610#" + "00" * 8, "00000600#" + "00" * 8, "20000004#" + "00" * 8]


def test_an_uneventful_step_is_not_recorded(log):
    log.journal.step(READY, Tick(), READY, (), 1.0)
    assert written(log, "/audit/decision") == []


@pytest.mark.parametrize(
    ("event", "effects", "expected"),
    [
        (
            ReplyReceived(records.Permit.TYPE, Refusal.ACCEPTED, StopCause.NONE),
            (),
            "reply ACCEPTED to permit",
        ),
        (ReplyReceived(records.Open.TYPE, Refusal.EPOCH, StopCause.NONE), (), "reply EPOCH to open"),
        (
            ReplyReceived(records.Withdraw.TYPE, Refusal.ACCEPTED, StopCause.NONE),
            (),
            "reply ACCEPTED to withdraw",
        ),
        (
            ReplyReceived(records.Acknowledge.TYPE, Refusal.EPOCH, StopCause.NONE),
            (),
            "reply EPOCH to acknowledge",
        ),
        (ReplyReceived(0x99, Refusal.EPOCH, StopCause.NONE), (), "reply EPOCH to 0x99"),
        (OtherVersionAnnounced(3), (), "controller of protocol version 3 announced"),
        (opened(), (), "session opened"),
        (opened(authentic=False), (), "session called open, with a wrong code"),
        (FOUND, (), "controller's witness found"),
        (MISSED, (), "controller's witness not found"),
        (WithdrawalSent(0), (), "withdrawal sent"),
        (FaultReceived(FaultCode.LATCHED, StopCause.SECOND_NODE), (), "controller's fault"),
        (Failed(StopCause.BUS_FAILED, "no"), (), "failed BUS_FAILED"),
        (Gone(StopCause.BUS_FAILED, "no"), (), "gave up BUS_FAILED"),
    ],
)
def test_an_event_has_a_name_that_says_what_it_was(log, event, effects, expected):
    log.journal.step(READY, event, READY, effects, 1.0)
    assert written(log, "/audit/decision")[0]["event"] == expected


def test_every_event_of_the_table_has_a_name():
    assert set(NAMES) == set(get_args(Event)) == set(EVERYWHERE)


def test_effects_have_names_that_say_what_they_do(log):
    effects = (SendStop(StopCode.END, StopCause.SESSION_ENDED), SendBlock(3), WITHDRAWAL, Dropped("x"))
    log.journal.step(READY, Tick(), READY, effects, 1.0)
    assert written(log, "/audit/decision")[0]["effects"] == [
        "send END SESSION_ENDED",
        "send path block 3",
        "send Withdraw",
        "Dropped",
    ]


def test_a_deviation_is_recorded_with_its_values_and_bounds_and_as_a_fault(log):
    state = in_phase(Phase.CUTTING)
    event = measured(ELSEWHERE, NOW)
    after, effects = step(state, event, NOW)
    log.journal.step(state, event, after, effects, NOW)
    paths = log.log.close(final_state="x", clean=True)
    found = judged(paths.log)
    (decision,) = found.of("/audit/decision")
    assert (decision["event"], decision["to_state"], decision["first_out"]) == (
        "joints measured",
        "stopping",
        "TRACKING_DEVIATION",
    )
    off_mm, off_deg = decision["permissives"]
    assert (off_mm["name"], off_mm["holds"], off_mm["value"]) == (
        "measured wrist centre to the verified path",
        False,
        pytest.approx(2.0),
    )
    assert (off_deg["name"], off_deg["holds"], off_deg["value"]) == (
        "measured joints to the verified path",
        True,
        pytest.approx(0.0, abs=1e-9),
    )
    assert all("near" in rule["bound"] for rule in (off_mm, off_deg))
    (fault,) = found.of("/audit/fault")
    assert (fault["source"], fault["code"], fault["cause"]) == ("runtime", "STOP", "TRACKING_DEVIATION")
    assert fault["detail"] == decision["reason"] == after.reason


@pytest.mark.parametrize(
    "event", [measured(READY.joints_u, NOW), ON, Tick()], ids=lambda event: type(event).__name__
)
def test_a_look_that_shows_nothing_is_not_recorded(log, event):
    state = in_phase(Phase.CUTTING)
    after, effects = step(state, event, NOW)
    log.journal.step(state, event, after, effects, NOW)
    assert written(log, "/audit/decision") == []


def test_a_reply_that_refuses_a_signed_record_is_a_fact_of_its_own_and_one_that_accepts_is_none(log):
    for refusal in (Refusal.ACCEPTED, Refusal.NONCE_EXPIRED):
        log.journal.step(READY, ReplyReceived(records.Start.TYPE, refusal, StopCause.NONE), READY, (), 1.0)
    assert [(r["kind"], r["stage"], r["reply"]) for r in written(log, "/audit/permit")] == [
        ("start", "refused", "NONCE_EXPIRED"),
    ]


SHOWN_BY = [
    (Phase.PERMITTING, ControllerState.PERMITTED, "permit"),
    (Phase.STARTING, ControllerState.CUTTING, "start"),
    (Phase.STARTING, ControllerState.DONE, "start"),
    (Phase.RESETTING, ControllerState.OPEN, "reset"),
    (Phase.RESETTING, ControllerState.INHIBITED, "reset"),
    (Phase.PERMITTING, ControllerState.LOADED, None),
    (Phase.STARTING, ControllerState.PERMITTED, None),
    (Phase.RESETTING, ControllerState.FAULT, None),
    (Phase.PERMITTED, ControllerState.PERMITTED, None),
    (Phase.CUTTING, ControllerState.DONE, None),
    (Phase.PERMITTING, ControllerState.INHIBITED, None),
    (Phase.HELD, ControllerState.OPEN, None),
]


@pytest.mark.parametrize(
    ("phase", "report", "kind"), SHOWN_BY, ids=[f"{phase}-{report.name}" for phase, report, _ in SHOWN_BY]
)
def test_acknowledged_is_written_at_the_heartbeat_that_shows_it(log, phase, report, kind):
    state, event = in_phase(phase), beat(report)
    after, effects = step(state, event, NOW)
    log.journal.step(state, event, after, effects, NOW)
    paths = log.log.close(final_state="x", clean=True)
    found = judged(paths.log)
    assert [(r["kind"], r["stage"]) for r in found.of("/audit/permit")] == (
        [(kind, "acknowledged")] if kind else []
    )
    dispositions = {one["disposition"] for one in found.of("/audit/decision")}
    assert ("acknowledged" in dispositions) is (kind is not None)


def test_a_phase_that_a_reply_left_is_not_called_acknowledged(log):
    state = in_phase(Phase.RESETTING)
    event = ReplyReceived(records.Reset.TYPE, Refusal.EPOCH, StopCause.NONE)
    after, effects = step(state, event, NOW)
    assert after.phase is Phase.HELD
    log.journal.step(state, event, after, effects, NOW)
    assert [r["stage"] for r in written(log, "/audit/permit")] == ["refused"]


@pytest.mark.parametrize(
    "phase", [Phase.AUTHORISING_PERMIT, Phase.AUTHORISING_START, Phase.AUTHORISING_RESET]
)
def test_what_was_sent_is_recorded_with_its_code_and_the_log_that_it_names(log, phase):
    state, event = in_phase(phase), durable(TOKEN)
    after, (send,) = step(state, event, NOW)
    signed = send.record.with_mac(b"c" * 16)
    log.journal.step(state, event, after, (Send(signed, sequence=258),), NOW)
    paths = log.log.close(final_state="x", clean=True)
    (written_down,) = read_log(paths.log.read_bytes()).of("/audit/permit")
    assert written_down["stage"] == "sent"
    assert (written_down["code"], written_down["sequence"]) == ((b"c" * 16).hex(), 258)
    assert bytes.fromhex(written_down["record"]) == send.record.canonical()
    named = written_down.get("log_size"), written_down.get("log_root")
    reset = phase is Phase.AUTHORISING_RESET
    assert named == ((None, None) if reset else (DURABLE_LOG.size, DURABLE_LOG.root.hex()))


def test_what_was_authorised_has_neither_code_nor_log(log):
    state = in_phase(Phase.NONCE_PERMIT)
    event = NonceReceived(Purpose.PERMIT, NONCE, EPOCH)
    after, effects = step(state, event, NOW)
    log.journal.step(state, event, after, effects, NOW)
    (record,) = written(log, "/audit/permit")
    assert (record["stage"], {"code", "sequence", "log_size", "log_root"} & set(record)) == (
        "authorised",
        set(),
    )


def test_a_cause_that_a_fault_frame_names_is_called_claimed(log):
    log.journal.step(READY, FaultReceived(FaultCode.LATCHED, StopCause.BONE_MOVED), READY, (), 1.0)
    (fault,) = written(log, "/audit/fault")
    assert (fault["source"], fault["cause"], fault["detail"]) == (
        "controller",
        "BONE_MOVED",
        "claimed: a fault frame carries no code",
    )


def test_the_barrier_of_a_withdrawal_is_in_the_log(log):
    log.journal.step(READY, WithdrawalSent(1_790_000_000_000_000), READY, (), 1.0)
    (decision,) = written(log, "/audit/decision")
    assert decision["reason"] == "only a registration later than 2026-09-21 14:13:20 UTC counts from now on"


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (WitnessFound("a.mcap", ""), {"found": True, "log": "a.mcap"}),
        (WitnessFound("a.mcap", BAD), {"found": True, "log": "a.mcap", "reason": SHOWN}),
        (WitnessFound(None, BAD), {"found": False, "reason": SHOWN}),
    ],
)
def test_whether_the_log_that_the_controller_saw_is_here_is_recorded(log, found, expected):
    log.journal.witness(SEEN_LOG, found)
    (record,) = written(log, "/audit/witness")
    told = {"log_id": SEEN_LOG.log_id.hex(), "log_size": 17, "log_root": SEEN_LOG.root.hex()} | expected
    assert {key: record[key] for key in record if key in {*told, "log", "reason"}} == told


def test_what_waits_behind_a_permit_that_has_left_is_not_called_that_permit(log):
    """The withdrawal may be voided by another stop; the permit had left long before."""
    state = in_phase(Phase.AUTHORISING_PERMIT)
    after, (send,) = step(state, durable(TOKEN), NOW)
    log.journal.step(state, durable(TOKEN), after, (Send(send.record.with_mac(b"c" * 16)),), NOW)
    event = CommandGiven(OperatorCommand.WITHDRAW)
    stopping, effects = step(after, event, NOW)
    assert WITHDRAWAL in effects
    log.journal.step(after, event, stopping, effects, NOW)
    log.journal.voided()
    paths = log.log.close(final_state="x", clean=True)
    assert [one["stage"] for one in read_log(paths.log.read_bytes()).of("/audit/permit")] == ["sent"]


def test_a_log_that_is_closed_names_its_end(log):
    state = in_phase(Phase.STOPPED, reason=BAD)
    paths = log.journal.close(state, "admissible", Statistics(accepted=7), clean=True)
    assert paths.closed
    (closed,) = read_log(paths.log.read_bytes()).of("/audit/close")
    assert (closed["final_state"], closed["verdict"], closed["outcome"]) == ("stopped", "admissible", SHOWN)


# ---------------------------------------------------------------- the session


def test_how_the_session_was_opened_is_recorded_as_it_crossed_the_bus(pair):
    pair.job = replace(pair.job, key_fingerprint=fingerprint(KEY))
    pair.end()
    pair.close()
    log = pair.read()
    (session,) = log.of("/audit/session")
    sums = {one["record"]: one["sha256"] for one in log.of("/can/transfer")}
    for kind, name, side in (
        (records.Open, "open", Side.RUNTIME),
        (records.Opened, "opened", Side.CONTROLLER),
    ):
        crossed = bytes.fromhex(session[name])
        assert sha256(crossed).hexdigest() == sums[kind.__name__]
        assert isinstance(records.unpack(crossed, sender=side).record, kind)
    assert session["session"] == pair.state.session.digest.hex()
    assert session["key_fingerprint"] == fingerprint(KEY)
    order = [
        json.loads(data).get("event", topic) for topic, data in log.each("/audit/session", "/audit/decision")
    ]
    assert order[order.index("/audit/session") + 1] == "session opened"


def test_a_session_that_nobody_opened_is_none_and_a_key_without_a_name_has_none(pair):
    pair.to(Phase.OPENING).say("quit")
    pair.end()
    pair.close()
    assert pair.read().of("/audit/session") == []
    pair.begin().to(Phase.COLLECTING)
    pair.close()
    (session,) = pair.read().of("/audit/session")
    assert "key_fingerprint" not in session


def test_an_opened_that_no_holder_of_the_key_made_is_recorded_as_no_session(log):
    state = in_phase(Phase.OPENING)
    event = opened(authentic=False)
    after, effects = step(state, event, NOW)
    log.journal.step(state, event, after, effects, NOW)
    assert written(log, "/audit/session") == []
