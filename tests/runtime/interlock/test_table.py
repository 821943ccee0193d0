"""The interlock's table: what leaves, when, and what never does."""

import math
from dataclasses import FrozenInstanceError, replace

import pytest

from cutgate.protocol import records
from cutgate.protocol.frames import FRACTION_MAX
from cutgate.protocol.states import (
    WITHDRAWING,
    ControllerState,
    FaultCode,
    Purpose,
    Refusal,
    RuntimeCode,
    StopCause,
    StopCode,
)
from cutgate.runtime.interlock import permissives as p
from cutgate.runtime.interlock import table
from cutgate.runtime.interlock.permissives import AT_START, COLLECTED, FOR_PERMIT, FOR_START
from cutgate.runtime.interlock.phases import AUTHORISING, ENDED, ENDINGS, MOVING, PHASES, SIGNED, STOPPING
from cutgate.runtime.interlock.state import (
    Announced,
    BlockConfirmed,
    CommandGiven,
    Commit,
    DeviceCycle,
    Dropped,
    Failed,
    FaultReceived,
    Gone,
    HeartbeatLost,
    HeartbeatReceived,
    LogChanged,
    LogHealth,
    NonceReceived,
    OpenLink,
    OperatorCommand,
    OtherVersionAnnounced,
    ParameterReceived,
    PathConfirmed,
    Phase,
    ProgressReported,
    RecordDurable,
    Refused,
    ReplyReceived,
    SeekWitness,
    Send,
    SendBlock,
    SendStop,
    SendWithdraw,
    SessionOpened,
    Tick,
    UploadedPath,
    UseSession,
    VerdictReady,
    Verify,
    WithdrawalSent,
    Withheld,
)
from cutgate.runtime.interlock.tracking import Deviation, FrameSeen, TrackingMonitor
from tests.altering import altered
from tests.runtime.interlock.builders import (
    ANNOUNCE,
    ANNOUNCE_NONCE,
    BEYOND,
    DEADLINES,
    DURABLE_LOG,
    ELSEWHERE,
    EPOCH,
    FOUND,
    FRESH,
    HALF_WAY,
    JOB,
    LIMITS,
    MISSED,
    NEXT_EPOCH,
    NONCE,
    NOW,
    ON,
    OPEN,
    PATH,
    PATH_BLOCKS,
    PERMISSIVENESS,
    PERMIT,
    READY,
    REQUESTS,
    RUNTIME_NONCE,
    SEEN_LOG,
    SESSION,
    STANDING,
    START_JOINTS,
    TIMING,
    TOKEN,
    TOOL,
    TRACKING,
    TRAJECTORY,
    VERDICT,
    Run,
    beat,
    code,
    durable,
    enabled,
    events,
    in_phase,
    measured,
    monitor,
    opened,
    reply,
    sent,
    sound_beat,
    step,
    stop_events,
    stops,
    view,
)

EXPECTED = {phase: row.expected for phase, row in PHASES.items() if row.expected is not None}
LIVE = [phase for phase in Phase if phase not in ENDED]
ENABLING_PHASES = {
    Phase.AUTHORISING_PERMIT: (records.Permit, Phase.PERMITTING, Phase.ADMITTED, p.FOR_PERMIT),
    Phase.AUTHORISING_START: (records.Start, Phase.STARTING, Phase.PERMITTED, p.FOR_START),
    Phase.AUTHORISING_RESET: (records.Reset, Phase.RESETTING, Phase.HELD, p.FOR_RESET),
}
PENDING = durable(TOKEN)


def without_log(record):
    """As it was committed."""
    return record if isinstance(record, records.Reset) else replace(record, log=records.NO_TREE_HEAD)


def withdrawals(effects):
    """The withdrawals that leave."""
    return [effect for effect in effects if isinstance(effect, SendWithdraw)]


each_phase = pytest.mark.parametrize("phase", LIVE, ids=str)
each_authorising = pytest.mark.parametrize("phase", ENABLING_PHASES, ids=str)


# ---------------------------------------------------------------- what enables


@pytest.mark.parametrize("phase", Phase, ids=str)
def test_nothing_enables_but_the_pending_durable_record(phase):
    """All phases times all events, from the state in which every permissive holds."""
    state = in_phase(phase)
    for event in events(state):
        after, effects = step(state, event, NOW)
        more_permissive = PERMISSIVENESS[code(after)] > PERMISSIVENESS[code(state)]
        if phase in ENABLING_PHASES and event == PENDING:
            kind, following, *_ = ENABLING_PHASES[phase]
            assert [type(record) for record in enabled(effects)] == [kind]
            assert after.phase is following
        else:
            assert not enabled(effects), event
            assert not more_permissive, event


ORDERS = MOVING - {Phase.FINISHING}
"""Where the heartbeat orders the cut. Once the end is reported nothing is ordered any more, only watched."""


def test_only_two_phases_order_the_cut_and_each_is_reached_through_its_start():
    assert {phase for phase, row in PHASES.items() if row.heartbeat is RuntimeCode.CUT} == ORDERS
    assert len(ORDERS) == 2
    for phase in Phase:
        state = in_phase(phase)
        for event in events(state):
            after, _ = step(state, event, NOW)
            if after.phase in MOVING and phase not in MOVING:
                assert (phase, after.phase) == (Phase.AUTHORISING_START, Phase.STARTING)


@each_authorising
def test_every_permissive_is_judged_again_when_the_record_is_durable(phase):
    """Each permissive that fails in between withholds what was authorised."""
    _, _, back, which = ENABLING_PHASES[phase]
    worse = [
        ("job.limits", b"other"),
        ("log.writable", False),
        ("log.reserved_bytes", 1),
        ("heartbeat_fresh", False),
        ("controller.cause", StopCause.BONE_MOVED),
        ("controller.emergency_stop_clear", False),
        ("controller.epoch", NEXT_EPOCH),
        ("controller.device_pressed", False),
        ("joints_u", ELSEWHERE),
        ("registration_withdrawn", True),
        ("controller", None),
    ]
    withheld = 0
    for field, value in worse:
        state = altered(in_phase(phase), field, value)
        if p.all_hold(which, state, NOW):
            continue
        withheld += 1
        after, effects = step(state, PENDING, NOW)
        assert effects == (Withheld(TOKEN),), field
        assert (after.phase, after.nonce) == (back, None)
    assert withheld >= 5


@each_authorising
def test_the_time_of_durability_is_the_time_of_judgement(phase):
    """The permit's age is judged when the record is durable, not when it was committed."""
    late = NOW + 0.4
    state = replace(in_phase(phase), nonce_at_s=late - 120.01, measured_s=late)
    _, effects = step(state, PENDING, late)
    assert bool(enabled(effects)) is (phase is not Phase.AUTHORISING_START)


@each_authorising
@pytest.mark.parametrize("token", [TOKEN - 1, TOKEN + 1, 0])
def test_another_record_enables_nothing(phase, token):
    state = in_phase(phase)
    after, effects = step(state, durable(token), NOW)
    assert after == state
    assert [type(effect) for effect in effects] == [Dropped]


@each_authorising
@pytest.mark.parametrize("now_s", [NOW + 0.6, NOW - 0.6, math.nan])
def test_a_record_that_is_durable_too_late_enables_nothing(phase, now_s):
    """Whether or not the loop has looked at its clocks before."""
    state = in_phase(phase)
    after, effects = step(state, PENDING, now_s)
    assert effects == (SendStop(StopCode.STOP, StopCause.AUDIT_FAILED), Withheld(TOKEN))
    assert after.phase is Phase.STOPPING


@each_authorising
def test_a_record_that_is_durable_just_in_time_enables(phase):
    state = in_phase(phase, since_s=NOW - DEADLINES.commit_deadline_s)
    assert enabled(step(state, PENDING, NOW)[1])


@each_authorising
def test_a_stop_in_between_withholds_and_the_record_is_dead(phase):
    for name, event in stop_events(in_phase(phase)).items():
        stopped, effects = step(in_phase(phase), event, NOW)
        assert Withheld(TOKEN) in effects, name
        after, effects = step(stopped, PENDING, NOW)
        assert after == stopped
        assert [type(effect) for effect in effects] == [Dropped]


@each_authorising
def test_quitting_in_between_withholds(phase):
    after, effects = step(in_phase(phase), CommandGiven(OperatorCommand.QUIT), NOW)
    assert effects == (SendStop(StopCode.END, StopCause.OPERATOR_QUIT), Withheld(TOKEN))
    assert after.phase is Phase.STOPPED


@pytest.mark.parametrize(
    ("phase", "purpose", "authorising"),
    [
        (Phase.NONCE_PERMIT, Purpose.PERMIT, Phase.AUTHORISING_PERMIT),
        (Phase.NONCE_START, Purpose.START, Phase.AUTHORISING_START),
        (Phase.NONCE_RESET, Purpose.RESET, Phase.AUTHORISING_RESET),
    ],
)
def test_a_nonce_leads_to_a_commit_under_a_new_token_and_nothing_leaves(phase, purpose, authorising):
    after, effects = step(in_phase(phase), NonceReceived(purpose, b"n" * 16, EPOCH), NOW)
    assert (after.phase, after.token, after.nonce) == (authorising, TOKEN + 1, b"n" * 16)
    (commit,) = effects
    assert (commit.token, commit.purpose, commit.record.nonce) == (TOKEN + 1, purpose, b"n" * 16)
    assert commit.record.epoch == EPOCH
    assert commit.record.session_digest == SESSION.digest
    # what leaves is what was made durable, and names the log up to that
    _, effects = step(after, durable(TOKEN + 1), NOW)
    (left,) = sent(effects)
    assert without_log(left) == commit.record
    assert purpose is Purpose.RESET or (commit.record.log, left.log) == (records.NO_TREE_HEAD, DURABLE_LOG)


@pytest.mark.parametrize("phase", [Phase.NONCE_PERMIT, Phase.NONCE_START, Phase.NONCE_RESET], ids=str)
def test_a_nonce_for_something_else_is_dropped(phase):
    state = in_phase(phase)
    wanted = Purpose[phase.name.removeprefix("NONCE_")]
    wrong = [NonceReceived(purpose, NONCE, EPOCH) for purpose in Purpose if purpose is not wanted]
    for event in (*wrong, NonceReceived(wanted, NONCE, NEXT_EPOCH)):
        after, effects = step(state, event, NOW)
        assert after == state
        assert [type(effect) for effect in effects] == [Dropped]


def test_the_permit_binds_what_was_proved_and_nothing_else():
    run = Run(in_phase(Phase.NONCE_PERMIT), NOW).feed(NonceReceived(Purpose.PERMIT, NONCE, EPOCH))
    assert run.commit.record == replace(PERMIT, log=records.NO_TREE_HEAD)
    assert run.durable().state.permit == PERMIT


def test_the_start_names_its_permit():
    run = Run(in_phase(Phase.NONCE_START), NOW).feed(NonceReceived(Purpose.START, b"s" * 16, EPOCH))
    assert run.commit.record == records.Start(
        nonce=b"s" * 16,
        epoch=EPOCH,
        session_digest=SESSION.digest,
        permit_digest=records.digest(PERMIT.canonical()),
        start_joints_u=VERDICT.start_joints_u,
    )


def test_a_record_that_is_durable_names_the_log_of_its_own_commit():
    """The permit's is not the start's."""
    further = replace(DURABLE_LOG, size=DURABLE_LOG.size + 9)
    run = Run(in_phase(Phase.AUTHORISING_START), NOW).feed(RecordDurable(TOKEN, further))
    (start,) = enabled(run.effects)
    assert (start.log, run.state.permit.log) == (further, DURABLE_LOG)


# ---------------------------------------------------------------- what disables


@each_phase
@pytest.mark.parametrize("name", stop_events(READY))
def test_every_stop_leaves_in_the_same_step(phase, name):
    state = in_phase(phase)
    event = stop_events(state)[name]
    after, effects = step(state, event, NOW)
    assert PERMISSIVENESS[code(after)] == 0
    assert not enabled(effects)
    if phase is Phase.STOPPING and isinstance(event, HeartbeatLost | FaultReceived):
        assert not stops(effects), "a stop was sent already; the controller's answer is not answered"
        return
    assert len(stops(effects)) == 1
    if phase is Phase.OPENING:  # the link was closed; without it nothing could be sent
        assert effects[0] == OpenLink(state.session)
        effects = effects[1:]
    assert isinstance(effects[0], SendStop), "before anything else"
    if phase is not Phase.STOPPING:
        assert after.phase is (Phase.STOPPED if phase is Phase.WAITING else Phase.STOPPING)
        assert after.cause is stops(effects)[0]
        assert after.reason
        assert (after.permit, after.nonce) == (None, None)


@pytest.mark.parametrize("cause", [cause for cause in StopCause if cause is not StopCause.NONE], ids=str)
@pytest.mark.parametrize("phase", sorted(MOVING), ids=str)
def test_every_cause_the_shell_or_the_controller_can_name_stops_the_cut(phase, cause):
    for event in (
        Failed(cause, "why"),
        FaultReceived(FaultCode.LATCHED, cause),
        beat(ControllerState.INHIBITED, cause=cause),
        beat(ControllerState.CUTTING, cause=cause),
        beat(ControllerState.CUTTING, fresh=False, cause=cause),
    ):
        after, effects = step(in_phase(phase), event, NOW)
        claimed = cause in WITHDRAWING and not isinstance(event, HeartbeatReceived)
        assert stops(effects) == [StopCause.PROTOCOL_VIOLATION if claimed else cause]
        assert (after.phase, after.cause) == (Phase.STOPPING, cause)


@pytest.mark.parametrize("cause", StopCause)
def test_a_withdrawal_is_told_under_this_sides_code_only_once_a_holder_of_the_key_has_said_it(cause):
    """Claimed by a fault frame, it is none; the controller's own heartbeat makes it one."""
    claimed, _ = step(in_phase(Phase.CUTTING), FaultReceived(FaultCode.STOPPED, cause), NOW)
    told = claimed.told(claimed.cause)
    first = StopCause.PROTOCOL_VIOLATION if cause in {*WITHDRAWING, StopCause.NONE} else cause
    assert (told, claimed.registration_withdrawn) == (first, False)
    said, _ = step(claimed, beat(ControllerState.INHIBITED, cause=cause, epoch=NEXT_EPOCH), NOW)
    assert said.told(said.cause) == (cause if cause in WITHDRAWING else first)


@each_phase
def test_the_first_cause_is_kept(phase):
    stopped, _ = step(in_phase(phase), Failed(StopCause.LOOP_STALLED, "first"), NOW)
    if phase is Phase.STOPPING:
        stopped = replace(stopped, cause=StopCause.LOOP_STALLED, reason="first")
    for event in stop_events(stopped).values():
        after, _ = step(stopped, event, NOW)
        assert (after.cause, after.reason) == (StopCause.LOOP_STALLED, "first")


@each_phase
def test_a_stop_without_a_cause_is_a_violation(phase):
    after, effects = step(in_phase(phase), Failed(StopCause.NONE, ""), NOW)
    assert stops(effects) == [StopCause.PROTOCOL_VIOLATION]
    assert after.phase in (Phase.STOPPING, Phase.STOPPED)


JUDGING = [phase for phase in LIVE if phase not in (Phase.OPENING, Phase.STOPPING)]
"""Where a heartbeat that names another stop ends the session."""


@pytest.mark.parametrize("phase", JUDGING, ids=str)
@pytest.mark.parametrize("cause", [cause for cause in StopCause if cause is not StopCause.NONE])
def test_a_heartbeats_cause_that_withdraws_is_remembered_and_no_other(phase, cause):
    heard = beat(ControllerState.INHIBITED, cause=cause, epoch=NEXT_EPOCH)
    after, effects = step(in_phase(phase), heard, NOW)
    assert after.registration_withdrawn is (cause in WITHDRAWING)
    told = cause in WITHDRAWING and phase is not Phase.WAITING
    assert (SendWithdraw(JOB.place) in effects) is told is after.withdraw_due
    later, _ = step(after, Failed(StopCause.OPERATOR_STOP, ""), NOW)
    assert later.registration_withdrawn is after.registration_withdrawn


@each_phase
@pytest.mark.parametrize("cause", WITHDRAWING)
def test_what_carries_no_code_withdraws_nothing_whatever_it_claims(phase, cause):
    for event in (
        FaultReceived(FaultCode.STOPPED, cause),
        FaultReceived(FaultCode.LATCHED, cause),
        ReplyReceived(records.Permit.TYPE, Refusal.REGISTRATION_WITHDRAWN, cause),
        ReplyReceived(records.Withdraw.TYPE, Refusal.ACCEPTED, cause),
        Failed(cause, ""),
        Gone(cause, ""),
    ):
        after, effects = step(in_phase(phase), event, NOW)
        assert not after.registration_withdrawn
        assert not withdrawals(effects)
        assert not WITHDRAWING & {*stops(effects), after.told(after.cause)}, (
            "nor does it by this side's mouth"
        )


@each_phase
def test_a_withdrawn_registration_stays_withdrawn_and_the_controller_is_told_behind_the_stop(phase):
    after, effects = step(in_phase(phase), CommandGiven(OperatorCommand.WITHDRAW), NOW)
    assert after.registration_withdrawn
    assert stops(effects) == [StopCause.REGISTRATION_WITHDRAWN]
    if phase is Phase.WAITING:
        assert not withdrawals(effects), "nobody is there"
        return
    assert withdrawals(effects) == [SendWithdraw(JOB.place, None)]
    order = [type(effect) for effect in effects if isinstance(effect, SendStop | SendWithdraw)]
    assert order == [SendStop, SendWithdraw], "a stop voids what waits before it"


@each_phase
@pytest.mark.parametrize(
    ("signal", "reason"), [("", "the operator quit"), ("SIGHUP", "SIGHUP ended the program")]
)
def test_quit_ends_the_session_and_is_a_stop_while_the_arm_may_move(phase, signal, reason):
    after, effects = step(in_phase(phase), CommandGiven(OperatorCommand.QUIT, signal), NOW)
    if phase is Phase.STOPPING:
        assert [type(effect) for effect in effects] == [Refused]
        return
    assert (after.cause, after.reason, after.permit) == (StopCause.OPERATOR_QUIT, reason, None)
    if phase in MOVING:
        assert after.phase is Phase.STOPPING
        assert stops(effects) == [StopCause.OPERATOR_QUIT]
    else:
        assert after.phase is Phase.STOPPED
        assert stops(effects, StopCode.END) == [StopCause.OPERATOR_QUIT]


@pytest.mark.parametrize("phase", sorted(ENDED), ids=str)
def test_an_ended_session_answers_nothing(phase):
    state = in_phase(phase)
    for event in events(state):
        assert step(state, event, NOW + 1e6) == (state, ())


@each_phase
def test_an_announcement_in_a_session_is_a_reboot(phase):
    after, effects = step(in_phase(phase), Announced(ANNOUNCE, RUNTIME_NONCE), NOW)
    if phase is Phase.WAITING:
        assert after.phase is Phase.OPENING
    elif phase is not Phase.OPENING:
        assert stops(effects) == [StopCause.PEER_REBOOTED]


@each_phase
def test_parameters_that_were_not_asked_for_stop(phase):
    if phase is Phase.COLLECTING:
        return
    for record, cause in ((LIMITS, StopCause.LIMITS_CHANGED), (TOOL, StopCause.CALIBRATION_CHANGED)):
        _, effects = step(in_phase(phase), ParameterReceived(record), NOW)
        assert stops(effects) == [cause]


def test_only_a_log_that_fails_stops_not_one_that_changes():
    state = in_phase(Phase.CUTTING)
    health = LogHealth(writable=True, reserved_bytes=1, needed_bytes=1000)
    after, effects = step(state, LogChanged(health), NOW)
    assert (after.phase, after.log, effects) == (Phase.CUTTING, health, ())
    failed = replace(health, writable=False)
    after, effects = step(after, LogChanged(failed), NOW)
    assert stops(effects) == [StopCause.AUDIT_FAILED]
    assert after.log == failed


# ---------------------------------------------------------------- the controller's heartbeat


@pytest.mark.parametrize("phase", EXPECTED, ids=str)
def test_an_unexpected_state_another_epoch_or_a_cause_stops(phase):
    state = in_phase(phase)
    for kind in ControllerState:
        after, effects = step(state, beat(kind), NOW)
        if kind in EXPECTED[phase]:
            assert not stops(effects), kind
        else:
            assert stops(effects) == [StopCause.PROTOCOL_VIOLATION], kind
            assert after.controller == view(kind)
    _, effects = step(state, sound_beat(state, epoch=NEXT_EPOCH), NOW)
    assert stops(effects) == [StopCause.PROTOCOL_VIOLATION]
    _, effects = step(state, sound_beat(state, cause=StopCause.BONE_MOVED), NOW)
    assert stops(effects) == [StopCause.BONE_MOVED]


def test_the_phases_without_a_list_judge_heartbeats_by_themselves():
    listed = {phase for phase, kind in table.TABLE if kind is HeartbeatReceived}
    assert set(LIVE) <= set(EXPECTED) | listed


BEFORE = [
    # the controller's state just before and just after it dealt with our record
    (
        Phase.UPLOADING,
        ControllerState.OPEN,
        PathConfirmed(UploadedPath(PATH.digest, Refusal.ACCEPTED, 0)),
    ),
    (Phase.PERMITTING, ControllerState.LOADED, reply(records.Permit)),
    (Phase.STARTING, ControllerState.PERMITTED, reply(records.Start)),
    (Phase.RESETTING, ControllerState.FAULT, reply(records.Reset)),
]


@pytest.mark.parametrize(("phase", "before", "answer"), BEFORE, ids=[str(phase) for phase, *_ in BEFORE])
def test_a_heartbeat_sent_just_before_our_record_was_dealt_with_is_no_violation(phase, before, answer):
    """It may arrive before the answer, and, overtaken by the answer's transfer, after it."""
    early = Run(in_phase(phase), NOW).feed(beat(before))
    assert early.phase is phase
    assert not stops(early.effects)
    late = Run(in_phase(phase), NOW).feed(answer, beat(before))
    assert not stops(late.effects)
    assert late.phase not in (Phase.STOPPING, Phase.STOPPED)


AHEAD = [
    (Phase.OPENING, ControllerState.OPEN),
    (Phase.UPLOADING, ControllerState.LOADED),
]


@pytest.mark.parametrize(("phase", "after"), AHEAD, ids=[str(phase) for phase, _ in AHEAD])
def test_a_heartbeat_that_overtakes_the_answer_is_no_violation(phase, after):
    run = Run(in_phase(phase), NOW).feed(beat(after))
    assert run.phase is phase
    assert not stops(run.effects)


BELIEVED = [
    # what was sent, the report that shows that it was accepted, and where the session is then
    (Phase.PERMITTING, records.Permit, ControllerState.PERMITTED, Phase.PERMITTED),
    (Phase.STARTING, records.Start, ControllerState.CUTTING, Phase.CUTTING),
    (Phase.STARTING, records.Start, ControllerState.DONE, Phase.FINISHING),
    (Phase.RESETTING, records.Reset, ControllerState.OPEN, Phase.COLLECTING),
    (Phase.RESETTING, records.Reset, ControllerState.INHIBITED, Phase.HELD),
]
each_believed = pytest.mark.parametrize(
    ("phase", "request_type", "report", "following"),
    BELIEVED,
    ids=[f"{one[0]}-{one[2].name}" for one in BELIEVED],
)


@each_believed
def test_what_was_accepted_is_believed_by_the_controllers_heartbeat(phase, request_type, report, following):
    run = Run(in_phase(phase), NOW).feed(beat(report))
    assert run.phase is following
    assert not stops(run.effects)
    assert run.state.since_s == run.now_s
    run.feed(reply(request_type))
    assert (run.phase, run.effects) == (following, ()), "nor does the Reply behind it"


@each_believed
def test_a_reply_that_accepts_changes_nothing(phase, request_type, report, following):
    state = in_phase(phase)
    assert step(state, reply(request_type), NOW) == (state, ())


@each_believed
def test_a_heartbeat_of_another_epoch_shows_nothing(phase, request_type, report, following):
    after, effects = step(in_phase(phase), beat(report, epoch=NEXT_EPOCH), NOW)
    assert after.phase is Phase.STOPPING
    assert stops(effects) == [StopCause.PROTOCOL_VIOLATION]


def test_a_reset_leaves_its_nonce_behind_and_a_cause_that_stands_is_still_held():
    after, effects = step(
        in_phase(Phase.RESETTING), beat(ControllerState.OPEN, cause=StopCause.OPERATOR_STOP), NOW
    )
    assert (after.phase, after.nonce, effects) == (Phase.HELD, None, ())


@pytest.mark.parametrize("kind", REQUESTS)
@each_phase
def test_that_somebody_says_accepted_never_moves_a_session_on(phase, kind):
    """But for the OPEN that he says was accepted: then no session is there. And the wait for a Withdraw ends."""
    state = in_phase(phase)
    after, effects = step(state, reply(kind), NOW)
    if (phase, kind) == (Phase.OPENING, records.Open):
        assert after.phase is Phase.REFUSED
    else:
        assert (after, effects) == (state, ())


def test_a_heartbeat_before_the_opened_record_is_seen_and_judged_later():
    state = in_phase(Phase.OPENING, epoch=0, controller=None)
    after, effects = step(state, beat(ControllerState.FAULT, cause=StopCause.BONE_MOVED), NOW)
    assert (after.phase, effects) == (Phase.OPENING, ())
    assert after.controller == view(ControllerState.FAULT, cause=StopCause.BONE_MOVED)


@pytest.mark.parametrize(
    ("phase", "kind"),
    [
        (Phase.STARTING, ControllerState.PERMITTED),
        *((phase, ControllerState.CUTTING) for phase in sorted(ORDERS)),
    ],
)
def test_released_device_or_pressed_emergency_stop_stops_the_cut(phase, kind):
    _, effects = step(in_phase(phase), beat(kind, device_pressed=False), NOW)
    assert stops(effects) == [StopCause.DEVICE_RELEASED]
    _, effects = step(in_phase(phase), beat(kind, emergency_stop_clear=False), NOW)
    assert stops(effects) == [StopCause.EMERGENCY_STOP]


@pytest.mark.parametrize("phase", sorted(MOVING), ids=str)
@pytest.mark.parametrize("pressed", [True, False])
def test_done_and_the_arm_back_end_the_session_in_order_also_with_the_device_already_released(phase, pressed):
    done = beat(ControllerState.DONE, device_pressed=pressed)
    after, effects = step(in_phase(phase), done, NOW)
    assert (after.phase, after.cause, effects) == (Phase.FINISHING, StopCause.NONE, ())
    after, effects = step(step(after, done, NOW)[0], STANDING, NOW)
    assert (after.phase, after.cause) == (Phase.DONE, StopCause.NONE)
    assert effects == (SendStop(StopCode.END, StopCause.SESSION_ENDED),)


def patient(seen_s):
    """A monitor that waits for joints and progress for ever."""
    begun = monitor(seen_s - 10.0, seen_s)
    return replace(begun, bounds=replace(begun.bounds, latency_s=math.inf))


def off_start(joint, by_u):
    """Joints measured so far off the start, 1e-6 deg | mm."""
    return measured((*START_JOINTS[:joint], START_JOINTS[joint] + by_u, *START_JOINTS[joint + 1 :]))


def test_the_end_is_shown_by_a_sample_within_two_time_outs():
    state = in_phase(Phase.FINISHING, since_s=0.0, tracking=patient(0.0))
    limit_s = 2 * TIMING.timeout_s
    assert step(state, Tick(), limit_s) == (state, ())
    late, effects = step(state, Tick(), limit_s + 1e-6)
    assert stops(effects) == [StopCause.TRACKING_DEVIATION]
    assert late.reason == f"no measured joints after the end was reported within {limit_s:g} s"


@pytest.mark.parametrize(("joint", "tolerance_u"), [(2, 500_000), (3, 200_000), (4, -200_000)])
def test_the_end_counts_within_the_start_tolerance_and_not_beyond(joint, tolerance_u):
    inside, beyond = (off_start(joint, tolerance_u * part // 1_000_000) for part in (1_000_000, 1_000_005))
    state = in_phase(Phase.FINISHING)
    done, _ = step(state, inside, NOW)
    assert (done.phase, done.tracking) == (Phase.DONE, None)
    after, effects = step(state, beyond, NOW)
    assert (after.phase, after.cause) == (Phase.STOPPING, StopCause.TRACKING_DEVIATION)
    assert stops(effects) == [StopCause.TRACKING_DEVIATION]
    assert "the controller reports the end, but the arm is not back: measured" in after.reason
    assert "(required: <= 0." in after.reason
    (deviation,) = [effect for effect in effects if isinstance(effect, Deviation)]
    assert deviation.reason == after.reason
    assert not any(rule.holds for rule in deviation.judged)


def test_an_end_is_not_shown_by_a_place_on_the_path_that_is_not_the_start():
    after, _ = step(in_phase(Phase.FINISHING), HALF_WAY, NOW)
    assert "the controller reports the end, but the arm is not back: measured joints" in after.reason


def test_an_end_is_not_shown_by_joints_too_old_to_say_so():
    """Nor are they a deviation: the next sample decides, within the deadline."""
    state = in_phase(Phase.FINISHING)
    after, effects = step(state, measured(START_JOINTS, NOW - 0.101), NOW)
    assert (after.phase, effects) == (Phase.FINISHING, ())
    assert step(after, measured(START_JOINTS, NOW - 0.099), NOW)[0].phase is Phase.DONE


def test_only_what_is_measured_after_the_end_was_reported_counts_for_it():
    """The sample from before stood at the start; the next one does not."""
    run = Run(in_phase(Phase.CUTTING), NOW).feed(STANDING, beat(ControllerState.DONE))
    assert run.phase is Phase.FINISHING
    run.feed(HALF_WAY)
    assert run.state.cause is StopCause.TRACKING_DEVIATION


# ---------------------------------------------------------------- the tracking monitor


each_moving = pytest.mark.parametrize("phase", sorted(MOVING), ids=str)
BACK = replace(monitor(NOW - 10.0, NOW), progress=(1, 1))
DEVIATING = [
    ("joints off the path", measured(ELSEWHERE), {}, "off the verified path near"),
    ("progress too far", BEYOND, {"tracking": monitor(NOW)}, "can have been reached"),
    ("progress that goes back", ON, {"tracking": BACK}, "it never goes back"),
    ("no such segment", ProgressReported(2, 0), {}, "the path has segments 0 to 1"),
    ("silence", Tick(), {"tracking": monitor(NOW - 0.201)}, "no measured joints for 201 ms"),
]


@each_moving
@pytest.mark.parametrize(
    ("event", "changes", "why"), [one[1:] for one in DEVIATING], ids=[one[0] for one in DEVIATING]
)
def test_a_deviation_stops_in_the_step_that_shows_it_and_says_what_and_by_how_much(
    phase, event, changes, why
):
    after, effects = step(in_phase(phase, **changes), event, NOW)
    assert (after.phase, after.cause, after.tracking) == (Phase.STOPPING, StopCause.TRACKING_DEVIATION, None)
    assert effects[0] == SendStop(StopCode.STOP, StopCause.TRACKING_DEVIATION), "before anything else"
    (deviation,) = effects[1:]
    assert isinstance(deviation, Deviation)
    assert why in deviation.reason == after.reason
    assert not all(rule.holds for rule in deviation.judged)
    assert PERMISSIVENESS[code(after)] == 0


@each_moving
def test_what_is_on_the_path_is_remembered_and_stops_nothing(phase):
    state = in_phase(phase, since_s=NOW)
    for event, seen in ((HALF_WAY, "sampled"), (ON, "progressed")):
        if (phase, event) == (Phase.FINISHING, HALF_WAY):
            continue
        after, effects = step(state, event, NOW + 0.01)
        assert (after.phase, effects) == (phase, ())
        assert getattr(after.tracking, seen).at_s == NOW + 0.01
    after, effects = step(state, Tick(), NOW + 0.199)
    assert (after, effects) == (state, ())


@pytest.mark.parametrize("phase", sorted(ORDERS), ids=str)
def test_an_end_that_comes_too_early_is_a_deviation(phase):
    state = in_phase(phase, tracking=monitor(NOW))
    done = beat(ControllerState.DONE)
    after, effects = step(state, done, NOW)
    assert stops(effects) == [StopCause.TRACKING_DEVIATION]
    assert "the controller reports the end, at most" in after.reason
    assert step(state, done, NOW + 0.021)[0].phase is Phase.FINISHING


def test_progress_is_due_only_while_cutting_and_from_then_on():
    """In STARTING nobody has said yet that it begins, in FINISHING it has ended; joints are due in all three."""
    silent = replace(monitor(NOW - 10.0, NOW), progressed=FrameSeen(0.0, NOW - 9.0))
    for phase in MOVING:
        since_s = NOW - 0.1
        state = in_phase(phase, tracking=silent, since_s=since_s)
        assert step(state, Tick(), NOW + 0.09)[1] == ()
        after, _ = step(replace(state, tracking=replace(silent, heard_s=NOW + 0.1)), Tick(), NOW + 0.101)
        assert ("no progress for 201 ms" in after.reason) is (phase is Phase.CUTTING)


@pytest.mark.parametrize("phase", [phase for phase in LIVE if phase not in MOVING], ids=str)
def test_nobody_watches_an_arm_that_may_not_move(phase):
    state = in_phase(phase)
    assert step(state, BEYOND, NOW) == (state, ())
    assert not stops(step(state, measured(ELSEWHERE), NOW)[1])


@pytest.mark.parametrize("scale", [1.0, 60.0])
def test_the_start_begins_the_monitor_of_the_very_trajectory_that_was_permitted(scale):
    other = replace(TRAJECTORY)
    verdict = replace(VERDICT, trajectory=other)
    state = altered(in_phase(Phase.AUTHORISING_START, verdict=verdict), "session.time_scale", scale)
    state = altered(state, "job.simulation_allowed_by", "site.toml")
    after, _ = step(state, PENDING, NOW)
    assert after.tracking == TrackingMonitor.begin(other, TIMING, TRACKING, scale, NOW)
    assert after.tracking.trajectory is other
    refused, _ = step(after, reply(records.Start, Refusal.NOT_AT_START), NOW)
    assert (refused.phase, refused.tracking) == (Phase.PERMITTED, None)


def test_a_verdict_without_a_reference_trajectory_is_not_permitted():
    run = Run(FRESH).until(Phase.VERIFYING).feed(beat(device_pressed=False), STANDING)
    run.feed(VerdictReady(replace(VERDICT, request=run.state.token, trajectory=None)))
    assert run.phase is Phase.REFUSED
    assert "reference trajectory: none" in run.state.reason


# ---------------------------------------------------------------- nothing can be waited for


@each_phase
@pytest.mark.parametrize("cause", [StopCause.INTERNAL_ERROR, StopCause.BUS_FAILED], ids=str)
def test_a_shell_that_cannot_go_on_stops_and_has_stopped(phase, cause):
    state = in_phase(phase)
    after, effects = step(state, Gone(cause, "why"), NOW)
    assert after.phase is Phase.STOPPED
    assert (after.permit, after.nonce, after.tracking) == (None, None, None) or phase is Phase.STOPPING
    assert stops(effects) == [cause]
    if phase is not Phase.STOPPING:
        assert (after.cause, after.reason) == (cause, "why")
    assert (Withheld(TOKEN) in effects) is (phase in AUTHORISING)
    assert (OpenLink(SESSION) in effects) is (phase is Phase.OPENING)
    assert (effects[1] if phase is Phase.OPENING else effects[0]) == SendStop(StopCode.STOP, cause)


def test_a_shell_that_cannot_go_on_keeps_the_first_cause():
    stopped, _ = step(in_phase(Phase.CUTTING), CommandGiven(OperatorCommand.STOP), NOW)
    after, effects = step(stopped, Gone(StopCause.BUS_FAILED, "the bus failed"), NOW)
    assert (after.phase, after.cause, after.reason) == (
        Phase.STOPPED,
        StopCause.OPERATOR_STOP,
        stopped.reason,
    )
    assert stops(effects) == [StopCause.BUS_FAILED]


def test_an_end_that_is_taken_back_is_a_violation():
    after, _ = step(in_phase(Phase.FINISHING), beat(ControllerState.CUTTING), NOW)
    assert after.cause is StopCause.PROTOCOL_VIOLATION


def test_an_emergency_stop_counts_until_the_session_has_ended():
    pressed = beat(ControllerState.DONE, emergency_stop_clear=False)
    assert step(in_phase(Phase.FINISHING), pressed, NOW)[0].cause is StopCause.EMERGENCY_STOP


@pytest.mark.parametrize("kind", ControllerState, ids=str)
def test_a_stop_is_confirmed_by_a_controller_at_rest(kind):
    after, effects = step(in_phase(Phase.STOPPING), beat(kind, cause=StopCause.OPERATOR_STOP), NOW)
    rests = kind in (ControllerState.INHIBITED, ControllerState.FAULT)
    assert after.phase is (Phase.STOPPED if rests else Phase.STOPPING)
    assert effects == ()


AUTHENTICATION = FaultReceived(FaultCode.LATCHED, StopCause.AUTHENTICATION_FAILED)
REFUSED_CODE = {
    Phase.PERMITTING: reply(records.Permit, Refusal.MAC_INVALID),
    Phase.STARTING: reply(records.Start, Refusal.MAC_INVALID),
    Phase.RESETTING: reply(records.Reset, Refusal.MAC_INVALID),
}
LATCHED_BEAT = beat(ControllerState.FAULT, cause=StopCause.AUTHENTICATION_FAILED, epoch=NEXT_EPOCH)


@pytest.mark.parametrize("first", [AUTHENTICATION, LATCHED_BEAT], ids=["fault frame", "heartbeat"])
@pytest.mark.parametrize("phase", REFUSED_CODE, ids=str)
def test_the_reply_with_its_reason_is_awaited_after_the_stop_that_overtook_it(phase, first):
    run = Run(in_phase(phase), NOW).feed(first)
    assert (run.phase, stops(run.effects)) == (Phase.STOPPING, [StopCause.AUTHENTICATION_FAILED])
    run.feed(LATCHED_BEAT)
    assert run.phase is Phase.STOPPING
    run.feed(REFUSED_CODE[phase], LATCHED_BEAT)
    assert run.phase is Phase.STOPPED
    assert ": it refused with MAC_INVALID: the two key files differ: compare" in run.state.reason
    assert run.state.reason.endswith(f"(this side's has the fingerprint {JOB.key_fingerprint})")


@pytest.mark.parametrize("phase", REFUSED_CODE, ids=str)
def test_a_reply_that_never_comes_is_not_awaited_for_longer_than_a_confirmation(phase):
    run = Run(in_phase(phase), NOW).feed(AUTHENTICATION, LATCHED_BEAT)
    assert run.feed(Tick(), after_s=JOB.deadlines.stop_confirm_s + 0.01).phase is Phase.STOPPED
    assert "MAC_INVALID" not in run.state.reason


@pytest.mark.parametrize(("paused_ms", "told"), [(0, "was not late"), (140, "stood still for 140 ms")])
def test_a_lost_heartbeat_names_the_side_that_was_late(paused_ms, told):
    for event, lost in (
        (HeartbeatLost(paused_ms), True),
        (FaultReceived(FaultCode.LATCHED, StopCause.HEARTBEAT_LOST, paused_ms), True),
        (FaultReceived(FaultCode.LATCHED, StopCause.EMERGENCY_STOP, paused_ms), False),
    ):
        after, _ = step(in_phase(Phase.CUTTING), event, NOW)
        assert (f"; this computer {told}" in after.reason) is lost


@pytest.mark.parametrize("phase", [phase for phase in LIVE if phase is not Phase.STOPPING], ids=str)
@pytest.mark.parametrize("cause", [StopCause.AUTHENTICATION_FAILED, StopCause.SECOND_NODE], ids=str)
def test_no_other_stop_waits_for_a_reply(phase, cause):
    expected = phase in REFUSED_CODE and cause is StopCause.AUTHENTICATION_FAILED
    after, _ = step(in_phase(phase), FaultReceived(FaultCode.LATCHED, cause), NOW)
    assert after.answer_due is expected


@pytest.mark.parametrize("refusal", [Refusal.NOT_IN_STATE, Refusal.VOIDED_BY_STOP], ids=str)
def test_another_reply_while_stopping_is_dropped(refusal):
    state = in_phase(Phase.STOPPING, answer_due=True)
    after, effects = step(state, reply(records.Permit, refusal), NOW)
    assert (after, len(effects)) == (state, 1)
    after, effects = step(in_phase(Phase.STOPPING), reply(records.Permit, Refusal.MAC_INVALID), NOW)
    assert (after, len(effects)) == (in_phase(Phase.STOPPING), 1)


def test_a_lost_controller_needs_no_confirmation():
    after, effects = step(in_phase(Phase.STOPPING), HeartbeatLost(), NOW)
    assert (after.phase, effects) == (Phase.STOPPED, ())


def test_a_lost_heartbeat_is_not_fresh():
    after, _ = step(in_phase(Phase.CUTTING), HeartbeatLost(), NOW)
    assert after.heartbeat_fresh is False
    assert after.cause is StopCause.HEARTBEAT_LOST


# ---------------------------------------------------------------- deadlines


@each_phase
def test_every_phase_that_waits_has_a_deadline(phase):
    patiently = {"tracking": patient(0.0)} if phase in MOVING else {}
    state = in_phase(phase, since_s=0.0, **patiently)  # from 0 on, for no sum to be rounded
    if phase is Phase.CUTTING:
        assert PHASES[phase].deadline is None
        assert step(state, Tick(), 1e9) == (state, ())
        return
    deadline = PHASES[phase].deadline
    bound_s, cause = deadline.seconds(JOB), deadline.cause
    for inside in (0.0, bound_s):
        assert step(state, Tick(), inside) == (state, ())
    for outside in (math.nextafter(bound_s, math.inf), -0.1, math.nan):
        after, effects = step(state, Tick(), outside)
        if phase in MOVING and math.isnan(outside):
            assert stops(effects) == [StopCause.TRACKING_DEVIATION], "its silence is judged first"
            continue
        if phase is Phase.STOPPING:
            assert (after.phase, effects) == (Phase.STOPPED, ())
        elif cause is StopCause.NOT_ADMITTED:
            assert (after.phase, effects) == (Phase.REFUSED, (SendStop(StopCode.END, cause),))
        else:
            assert after.phase is Phase.STOPPING
            assert stops(effects) == [cause]
        if phase is not Phase.STOPPING:
            assert f"{bound_s:g} s" in after.reason


def test_every_phase_has_a_row_and_an_end_waits_for_nothing():
    assert list(PHASES) == list(Phase)
    assert {phase for phase, row in PHASES.items() if row.deadline} == set(LIVE) - {Phase.CUTTING}
    for phase in ENDED:
        row = PHASES[phase]
        assert (row.deadline, row.expected, row.permissives) == (None, None, ())
        assert row.heartbeat is RuntimeCode.INHIBIT
        assert (row.moving, row.authorising, row.signed) == (False, False, False)


RESTS_ON = {
    Phase.COLLECTING: COLLECTED,
    **dict.fromkeys(
        (Phase.VERIFYING, Phase.ADMITTED, Phase.NONCE_PERMIT, Phase.AUTHORISING_PERMIT), FOR_PERMIT
    ),
    **dict.fromkeys((Phase.PERMITTED, Phase.NONCE_START, Phase.AUTHORISING_START), FOR_START),
    Phase.FINISHING: AT_START,
}
"""Typed here a second time: what the log shows of a decision taken in this phase."""


@pytest.mark.parametrize("phase", Phase)
def test_the_log_shows_what_a_decision_rests_on(phase):
    assert PHASES[phase].permissives == RESTS_ON.get(phase, ())


def test_a_person_is_told_of_every_phase_but_those_that_pass_at_once_or_end():
    silent = {phase for phase, row in PHASES.items() if not row.announced}
    passing = {Phase.NONCE_RESET, Phase.AUTHORISING_RESET, Phase.RESETTING, Phase.NONCE_START}
    assert silent == {Phase.WAITING, *passing, *ENDED}


def test_a_row_stays_as_it_is_written():
    for row in (PHASES[Phase.WAITING], PHASES[Phase.WAITING].deadline, ENDINGS[Phase.DONE]):
        with pytest.raises(FrozenInstanceError):
            row.heartbeat = RuntimeCode.CUT


def test_the_arm_moves_only_where_the_heartbeat_says_so_or_its_end_is_awaited():
    """A second list, typed here: what the table says of the phases that matter most."""
    assert {Phase.STARTING, Phase.CUTTING, Phase.FINISHING} == MOVING
    assert {Phase.AUTHORISING_RESET, Phase.AUTHORISING_PERMIT, Phase.AUTHORISING_START} == AUTHORISING
    assert {Phase.DONE, Phase.REFUSED, Phase.STOPPED} == ENDED
    assert {Phase.RESETTING, Phase.PERMITTING, Phase.STARTING} == SIGNED
    assert {Phase.STOPPING, Phase.STOPPED} == STOPPING
    ready = {phase for phase, row in PHASES.items() if row.heartbeat is RuntimeCode.READY}
    assert ready == {Phase.PERMITTING, Phase.PERMITTED, Phase.NONCE_START, Phase.AUTHORISING_START}
    assert {phase: ending.exit_code for phase, ending in ENDINGS.items()} == {
        Phase.DONE: 0,
        Phase.REFUSED: 1,
        Phase.STOPPED: 3,
    }


def test_waiting_in_vain_for_the_permissives_names_them():
    state = in_phase(Phase.ADMITTED, since_s=NOW - 301, heartbeat_fresh=False)
    after, _ = step(state, Tick(), NOW)
    assert "stale or never seen" in after.reason
    assert "check the bus" in after.reason


def test_the_first_event_starts_the_clocks():
    """The shell's clock does not begin at zero: an interlock made now must not be late at once."""
    state, effects = step(FRESH, Tick(), 5e6)
    assert (state.phase, effects) == (Phase.WAITING, ())
    assert (state.began_s, state.since_s) == (5e6, 5e6)
    assert step(state, Tick(), 5e6 + 31)[0].phase is Phase.REFUSED


# ---------------------------------------------------------------- operator words


@each_phase
@pytest.mark.parametrize(
    "word", [OperatorCommand.START, OperatorCommand.ACKNOWLEDGE, OperatorCommand.RESET], ids=str
)
def test_start_acknowledge_and_reset_mean_something_in_one_phase_only(phase, word):
    if (phase, word) in {(Phase.PERMITTED, OperatorCommand.START), (Phase.HELD, OperatorCommand.RESET)}:
        return
    state = in_phase(phase)  # no cause stands: nothing to acknowledge either
    after, effects = step(state, CommandGiven(word), NOW)
    assert after == state
    assert [type(effect) for effect in effects] == [Refused]
    assert effects[0].command is word
    assert effects[0].reason


def test_start_is_refused_with_every_missing_permissive():
    state = replace(READY, joints_u=ELSEWHERE, device=DeviceCycle.UNSEEN)
    after, effects = step(state, CommandGiven(OperatorCommand.START), NOW)
    assert after == state
    (refused,) = effects
    assert "verified start: 2 (required: <= 0.5 mm)" in refused.reason
    assert "after the permit): release it, then hold it" in refused.reason


def test_start_only_asks_for_a_nonce():
    after, effects = step(READY, CommandGiven(OperatorCommand.START), NOW)
    assert (after.phase, after.since_s) == (Phase.NONCE_START, NOW)
    assert effects == (Send(records.NonceRequest(purpose=Purpose.START)),)


@pytest.mark.parametrize("phase", [Phase.NONCE_START, Phase.AUTHORISING_START], ids=str)
def test_a_device_released_after_the_word_start_takes_the_word_back(phase):
    """Pressed again in time, it still needs a new word: the word counts only after the press."""
    run = Run(in_phase(phase), NOW).feed(beat(ControllerState.PERMITTED, device_pressed=False))
    assert (run.phase, run.state.nonce) == (Phase.PERMITTED, None)
    assert (Withheld(TOKEN) in run.effects) is (phase is Phase.AUTHORISING_START)
    assert any(isinstance(effect, Refused) for effect in run.effects)
    run.feed(beat(ControllerState.PERMITTED), NonceReceived(Purpose.START, NONCE, EPOCH), durable(TOKEN))
    assert run.phase is Phase.PERMITTED
    assert [type(effect) for effect in run.effects] == [Dropped]


@pytest.mark.parametrize("phase", [Phase.NONCE_START, Phase.AUTHORISING_START], ids=str)
def test_the_heartbeat_is_judged_while_the_start_is_authorised(phase):
    same, effects = step(in_phase(phase), beat(ControllerState.PERMITTED), NOW)
    assert (same.phase, effects) == (phase, ())
    _, effects = step(
        in_phase(phase),
        beat(ControllerState.PERMITTED, device_pressed=False, cause=StopCause.BONE_MOVED),
        NOW,
    )
    assert stops(effects) == [StopCause.BONE_MOVED]


def test_a_device_held_since_before_the_permit_does_not_count():
    run = Run(in_phase(Phase.PERMITTING, device=DeviceCycle.PRESSED), NOW)
    run.feed(beat(ControllerState.PERMITTED))
    assert (run.phase, run.state.device) == (Phase.PERMITTED, DeviceCycle.UNSEEN)
    run.feed(beat(ControllerState.PERMITTED))
    assert run.state.device is DeviceCycle.UNSEEN
    run.feed(beat(ControllerState.PERMITTED, device_pressed=False))
    assert run.state.device is DeviceCycle.RELEASED
    run.feed(beat(ControllerState.PERMITTED))
    assert run.state.device is DeviceCycle.PRESSED


def test_a_device_released_at_the_moment_of_the_permit_was_seen_released():
    """By the heartbeat that reports the permit, never by one that may be older than it."""
    run = Run(in_phase(Phase.PERMITTING), NOW).feed(beat(ControllerState.LOADED, device_pressed=False))
    assert run.state.device is DeviceCycle.RELEASED
    held = Run(run.state, NOW).feed(beat(ControllerState.PERMITTED))
    assert held.state.device is DeviceCycle.UNSEEN
    released = Run(run.state, NOW).feed(beat(ControllerState.PERMITTED, device_pressed=False))
    assert released.state.device is DeviceCycle.RELEASED


def test_words_while_stopping():
    state = in_phase(Phase.STOPPING, cause=StopCause.DEVICE_RELEASED)
    again, effects = step(state, CommandGiven(OperatorCommand.STOP), NOW)
    assert (again.cause, stops(effects)) == (StopCause.DEVICE_RELEASED, [StopCause.OPERATOR_STOP])
    withdrawn, effects = step(state, CommandGiven(OperatorCommand.WITHDRAW), NOW)
    assert stops(effects) == [StopCause.REGISTRATION_WITHDRAWN]
    assert withdrawn.registration_withdrawn


@each_phase
def test_a_cause_that_the_shell_reports_every_turn_leaves_once(phase):
    """Each stop is answered by a fault frame, which wakes the loop: repeated, they would chase each other."""
    run = Run(in_phase(phase), NOW).feed(Failed(StopCause.AUDIT_FAILED, "the disk does not answer"))
    assert stops(run.effects) == [StopCause.AUDIT_FAILED]
    for _ in range(5):
        run.feed(
            FaultReceived(FaultCode.LATCHED, StopCause.AUDIT_FAILED),
            Failed(StopCause.AUDIT_FAILED, "the disk does not answer"),
        )
        assert run.effects == ()


# ---------------------------------------------------------------- opening and the held controller


def test_the_session_is_opened_with_both_nonces_and_the_job_s_timing():
    run = Run(FRESH).feed(Announced(ANNOUNCE, RUNTIME_NONCE))
    assert (run.phase, run.state.session) == (Phase.OPENING, SESSION)
    use, send = run.effects
    assert use == UseSession(SESSION)
    assert send.record == records.Open(
        protocol_version=4,
        announce_nonce=ANNOUNCE_NONCE,
        runtime_nonce=RUNTIME_NONCE,
        identity_digest=ANNOUNCE.identity_digest,
        registration_digest=JOB.registration,
        place_digest=JOB.place,
        registration_time_us=JOB.registration_time_us,
        configuration_digest=JOB.configuration,
        verifier_version=JOB.verifier,
        timing=records.Timing(20, 100, 120, 2000, 500, 200, 10_000, 25),
    )


def test_the_session_is_named_by_all_that_its_open_says():
    session = Run(FRESH).feed(Announced(ANNOUNCE, RUNTIME_NONCE)).state.session
    assert (session.request, session.announce_nonce) == (OPEN, ANNOUNCE_NONCE)
    assert session.digest == records.session_digest(OPEN)
    assert session.tag == records.session_tag(session.digest)
    other = replace(ANNOUNCE, plant_speed_permille=999)
    assert Run(FRESH).feed(Announced(other, RUNTIME_NONCE)).state.session.digest != session.digest


def test_a_simulated_controller_s_time_scale_is_the_session_s():
    faster = replace(ANNOUNCE, plant_speed_permille=60_000)
    assert Run(FRESH).feed(Announced(faster, RUNTIME_NONCE)).state.session.time_scale == 60.0


def test_an_open_that_was_lost_is_sent_again_at_the_next_announcement():
    run = Run(FRESH, 77.0).feed(Announced(ANNOUNCE, RUNTIME_NONCE))
    first = run.effects[1]
    opening = run.state
    run.feed(Announced(ANNOUNCE, b"another nonce..."), after_s=0.9)
    assert (run.state, run.effects) == (opening, ()), "it may have crossed our OPEN"
    run.feed(Announced(ANNOUNCE, b"another nonce..."), after_s=0.2)
    assert (run.state, run.effects) == (opening, (first,)), "the same session, the same deadline"
    half = replace(opening, since_s=NOW - DEADLINES.reply_timeout_s / 2)
    assert step(half, Announced(ANNOUNCE, b"another nonce..."), NOW) == (half, (first,))


def test_a_second_open_that_was_not_needed_is_refused_without_harm():
    run = (
        Run(FRESH)
        .feed(Announced(ANNOUNCE, RUNTIME_NONCE))
        .feed(Announced(ANNOUNCE, RUNTIME_NONCE), after_s=1.1)
    )
    assert sent(run.effects)
    for cause, following in ((StopCause.NONE, Phase.COLLECTING), (StopCause.BONE_MOVED, Phase.HELD)):
        second = Run(run.state, run.now_s).feed(
            opened(cause=cause), reply(records.Open, Refusal.SESSION_IN_USE)
        )
        assert second.phase is following
        assert [type(effect) for effect in second.effects] == [Dropped]


def test_a_controller_that_reboots_before_it_opened_is_asked_anew():
    run = Run(FRESH).feed(Announced(ANNOUNCE, RUNTIME_NONCE))
    rebooted = replace(ANNOUNCE, announce_nonce=b"B" * 16)
    run.feed(Announced(rebooted, b"N" * 16))
    assert run.phase is Phase.OPENING
    use, send = run.effects
    assert use.session == run.state.session
    assert (send.record.announce_nonce, send.record.runtime_nonce) == (b"B" * 16, b"N" * 16)


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [("protocol_version", 3, "protocol version"), ("serial", "SIM-2", "serial number")],
)
def test_another_version_or_controller_is_refused_before_a_session(field, value, said):
    run = Run(FRESH).feed(Announced(replace(ANNOUNCE, **{field: value}), RUNTIME_NONCE))
    assert (run.phase, run.state.cause) == (Phase.REFUSED, StopCause.NOT_ADMITTED)
    assert said in run.state.reason
    assert not sent(run.effects)


@pytest.mark.parametrize("phase", [Phase.WAITING, Phase.OPENING])
def test_a_controller_of_another_version_is_refused_in_words(phase):
    after, effects = step(replace(in_phase(phase), announced_version=None), OtherVersionAnnounced(3), NOW)
    assert (after.phase, after.announced_version) == (Phase.REFUSED, 3)
    assert after.reason == (
        "protocol version: 3 (required: 4): use a controller and a runtime of the same protocol version"
    )
    assert effects == (SendStop(StopCode.END, StopCause.NOT_ADMITTED),)


@pytest.mark.parametrize("phase", [one for one in LIVE if one not in (Phase.WAITING, Phase.OPENING)], ids=str)
def test_an_announcement_of_another_version_in_a_session_is_a_reboot(phase):
    assert stops(step(in_phase(phase), OtherVersionAnnounced(3), NOW)[1]) == [StopCause.PEER_REBOOTED]


def test_nonces_that_make_the_tag_of_no_session_wait_for_another(monkeypatch):
    monkeypatch.setattr(table.records, "opens", lambda _request: False)
    run = Run(FRESH).feed(Announced(ANNOUNCE, RUNTIME_NONCE))
    assert (run.phase, run.effects) == (Phase.WAITING, ())


@pytest.mark.parametrize("kind", ControllerState, ids=str)
@pytest.mark.parametrize("cause", [StopCause.NONE, StopCause.BONE_MOVED], ids=str)
def test_only_an_open_controller_without_a_cause_is_collected_from(kind, cause):
    said = opened(kind, cause, epoch=5)
    after, effects = step(in_phase(Phase.OPENING, epoch=0, opened=None), said, NOW)
    sound = kind is ControllerState.OPEN and cause is StopCause.NONE
    assert (after.phase, after.epoch) == (Phase.COLLECTING if sound else Phase.HELD, 5)
    assert after.opened == said.opened
    assert effects[:2] == (OpenLink(SESSION), SeekWitness(SEEN_LOG))
    assert effects[2:] == ((Send(records.Collect()),) if sound else ())


@pytest.mark.parametrize("kind", ControllerState, ids=str)
def test_an_opened_that_no_holder_of_the_key_made_opens_nothing(kind):
    state = in_phase(Phase.OPENING, epoch=0, opened=None)
    after, effects = step(state, opened(kind, authentic=False, withdrawal_due=1), NOW)
    assert after == state
    assert effects == (
        Dropped("an OPENED that no holder of the key made (this side's has the fingerprint 1a2b3c4d)"),
    )
    assert step(after, opened(), NOW)[0].phase is Phase.COLLECTING, "nor does it keep the right one out"
    late, _ = step(after, Tick(), state.since_s + DEADLINES.reply_timeout_s + 0.01)
    assert (late.phase, late.reason) == (
        Phase.REFUSED,
        "the controller did not open the session within 2 s",
    )


def test_a_log_that_the_controller_never_saw_is_not_sought():
    _, effects = step(in_phase(Phase.OPENING), opened(log=records.NO_TREE_HEAD), NOW)
    assert effects == (OpenLink(SESSION), Send(records.Collect()))
    anything = replace(records.NO_TREE_HEAD, size=1)
    assert SeekWitness(anything) in step(in_phase(Phase.OPENING), opened(log=anything), NOW)[1]


@pytest.mark.parametrize(("age", "age_s"), [(0, 0), (7200, 7200), (records.AGE_UNKNOWN, None)])
@pytest.mark.parametrize("kind", [ControllerState.OPEN, ControllerState.FAULT], ids=str)
def test_a_bone_that_moved_while_no_session_ran_is_withdrawn_at_once(kind, age, age_s):
    said = opened(kind, withdrawal_due=1, motion_age_s=age)
    after, effects = step(in_phase(Phase.OPENING), said, NOW)
    assert withdrawals(effects) == [SendWithdraw(records.NO_PLACE, age_s)]
    assert effects.index(SendWithdraw(records.NO_PLACE, age_s)) == 1, "behind the link, before what is asked"
    assert not after.registration_withdrawn, "a registration of later may stand"
    assert not withdrawals(step(in_phase(Phase.OPENING), opened(motion_age_s=age), NOW)[1])


@pytest.mark.parametrize(("barrier_us", "following"), [(-1, Phase.UPLOADING), (0, Phase.REFUSED)])
def test_after_a_motion_only_a_later_registration_is_collected_for(barrier_us, following):
    run = (
        Run(FRESH)
        .until(Phase.OPENING)
        .feed(opened(withdrawal_due=1), WithdrawalSent(JOB.registration_time_us + barrier_us))
    )
    run.feed(*(ParameterReceived(kind.parse(data)) for kind, data in HELD_BY_THE_CONTROLLER))
    assert run.phase is following
    assert ("registration stands: one of 2026-09-21" in run.state.reason) is (following is Phase.REFUSED)


HELD_BY_THE_CONTROLLER = (
    (records.Limits, JOB.limits),
    (records.Calibration, JOB.calibration),
    (records.Tool, JOB.tool),
)


@pytest.mark.parametrize("phase", [one for one in LIVE if one is not Phase.ADMITTED], ids=str)
def test_what_the_shell_tells_of_barrier_and_witness_is_kept(phase):
    state = in_phase(phase, witness=None)
    assert step(state, WithdrawalSent(7), NOW) == (replace(state, barrier_us=7), ())
    for said in (FOUND, MISSED):
        assert step(state, said, NOW) == (replace(state, witness=said), ())


def test_an_open_with_a_wrong_code_is_refused_with_this_sides_fingerprint():
    after, _ = step(in_phase(Phase.OPENING), reply(records.Open, Refusal.MAC_INVALID), NOW)
    assert after.phase is Phase.REFUSED
    assert ": MAC_INVALID: the two key files differ: compare" in after.reason
    assert after.reason.endswith("(this side's has the fingerprint 1a2b3c4d)")
    other, _ = step(in_phase(Phase.OPENING), reply(records.Open, Refusal.SESSION_IN_USE), NOW)
    assert "fingerprint" not in other.reason


@pytest.mark.parametrize("refusal", [Refusal.SESSION_IN_USE, Refusal.TIMING_OUT_OF_BOUNDS], ids=str)
def test_a_refused_session_is_refused_with_the_reason(refusal):
    after, _ = step(in_phase(Phase.OPENING), reply(records.Open, refusal), NOW)
    assert (after.phase, refusal.name in after.reason) == (Phase.REFUSED, True)


@pytest.mark.parametrize(
    ("phase", "mine"),
    [
        (Phase.OPENING, records.Open),
        (Phase.HELD, records.Acknowledge),
        (Phase.RESETTING, records.Reset),
        (Phase.PERMITTING, records.Permit),
        (Phase.STARTING, records.Start),
    ],
)
def test_a_reply_to_something_else_is_dropped(phase, mine):
    state = in_phase(phase)
    for kind in REQUESTS:
        after, effects = step(state, reply(kind, Refusal.EPOCH), NOW)
        if kind is mine:
            assert not any(isinstance(effect, Dropped) for effect in effects)
        else:
            assert after == state
            (told,) = effects
            withdrawal = "a withdrawal, which the controller refused: EPOCH: a stop came in between"
            assert told.what.startswith(
                withdrawal if kind is records.Withdraw else "a reply to something else"
            )


NOT_PENDING = {
    SessionOpened: {Phase.OPENING},
    BlockConfirmed: {Phase.UPLOADING},
    PathConfirmed: {Phase.UPLOADING},
    VerdictReady: {Phase.VERIFYING},
    NonceReceived: {Phase.NONCE_PERMIT, Phase.NONCE_START, Phase.NONCE_RESET},
    RecordDurable: set(AUTHORISING),
}


@each_phase
def test_an_answer_that_is_not_pending_is_dropped_and_reported(phase):
    state = in_phase(phase)
    for event in events(state):
        if phase in NOT_PENDING.get(type(event), set(Phase)):
            continue
        after, effects = step(state, event, NOW)
        assert after == state
        (dropped,) = effects
        assert type(event).__name__ in dropped.what


NOT_REPORTED = "the controller has not yet reported what it carries: wait for that, then say acknowledge"


def test_a_held_controller_is_acknowledged_then_reset_then_collected():
    run = Run(FRESH).feed(
        Announced(ANNOUNCE, RUNTIME_NONCE),
        opened(ControllerState.FAULT, StopCause.SECOND_NODE),
    )
    assert run.phase is Phase.HELD
    run.feed(CommandGiven(OperatorCommand.ACKNOWLEDGE))
    assert run.effects == (Refused(OperatorCommand.ACKNOWLEDGE, NOT_REPORTED),)
    run.feed(beat(ControllerState.FAULT, cause=StopCause.SECOND_NODE), CommandGiven(OperatorCommand.RESET))
    assert "acknowledge" in run.effects[0].reason
    run.feed(CommandGiven(OperatorCommand.ACKNOWLEDGE))
    assert sent(run.effects) == [records.Acknowledge(epoch=EPOCH, cause=StopCause.SECOND_NODE)]
    run.feed(reply(records.Acknowledge))
    assert (run.phase, run.effects) == (Phase.HELD, ())
    run.feed(beat(ControllerState.FAULT))
    assert (run.phase, run.effects) == (Phase.HELD, ()), "acknowledging is not resetting"
    run.feed(CommandGiven(OperatorCommand.ACKNOWLEDGE))
    assert run.effects == (Refused(OperatorCommand.ACKNOWLEDGE, "it is acknowledged already: say reset"),)
    run.feed(CommandGiven(OperatorCommand.RESET))
    assert sent(run.effects) == [records.NonceRequest(purpose=Purpose.RESET)]
    run.feed(NonceReceived(Purpose.RESET, NONCE, EPOCH))
    assert (run.phase, run.commit.purpose) == (Phase.AUTHORISING_RESET, Purpose.RESET)
    run.durable()
    (reset,) = enabled(run.effects)
    assert isinstance(reset, records.Reset)
    assert (reset.cause, reset.nonce, reset.epoch) == (StopCause.SECOND_NODE, NONCE, EPOCH)
    assert code(run.state) is RuntimeCode.INHIBIT
    run.feed(reply(records.Reset))
    assert (run.phase, run.effects) == (Phase.RESETTING, ())
    run.feed(beat(ControllerState.OPEN))
    assert (run.phase, sent(run.effects)) == (Phase.COLLECTING, [records.Collect()])
    run.until(Phase.DONE)


def test_a_cause_without_a_latch_needs_only_the_acknowledgement():
    run = Run(in_phase(Phase.HELD), NOW).feed(
        beat(ControllerState.OPEN, cause=StopCause.OPERATOR_STOP), CommandGiven(OperatorCommand.ACKNOWLEDGE)
    )
    assert sent(run.effects) == [records.Acknowledge(epoch=EPOCH, cause=StopCause.OPERATOR_STOP)]
    assert run.feed(beat(ControllerState.OPEN)).phase is Phase.COLLECTING


def test_refused_acknowledgements_and_resets_are_shown_and_the_session_stays_held():
    run = Run(in_phase(Phase.HELD), NOW).feed(reply(records.Acknowledge, Refusal.EMERGENCY_STOP))
    assert run.phase is Phase.HELD
    pressed = "EMERGENCY_STOP: the emergency stop is still pressed: release it, then try again"
    assert run.effects == (Refused(OperatorCommand.ACKNOWLEDGE, f"the controller refused: {pressed}"),)
    run = Run(in_phase(Phase.RESETTING), NOW).feed(reply(records.Reset, Refusal.NONCE_EXPIRED))
    assert (run.phase, run.state.nonce) == (Phase.HELD, None)
    assert (run.effects[0].command, "NONCE_EXPIRED" in run.effects[0].reason) == (OperatorCommand.RESET, True)


@pytest.mark.parametrize(
    "phase", [Phase.HELD, Phase.NONCE_RESET, Phase.AUTHORISING_RESET, Phase.RESETTING], ids=str
)
def test_a_new_stop_while_held_ends_the_session_even_if_the_fault_frame_was_lost(phase):
    """The controller's session is dead then: no acknowledgement would ever be accepted in it."""
    for cause, wanted in (
        (StopCause.EMERGENCY_STOP, StopCause.EMERGENCY_STOP),
        (StopCause.NONE, StopCause.PROTOCOL_VIOLATION),
    ):
        state = in_phase(phase)
        after, effects = step(state, beat(ControllerState.FAULT, epoch=NEXT_EPOCH, cause=cause), NOW)
        assert after.phase is Phase.STOPPING
        assert stops(effects) == [wanted]


ON_MOTION = opened(ControllerState.FAULT, StopCause.BONE_MOVED, withdrawal_due=1)
"""The session is opened on a controller that stands since the bone moved, and that is latched besides."""
ACKNOWLEDGED = (
    beat(ControllerState.FAULT, cause=StopCause.BONE_MOVED),
    CommandGiven(OperatorCommand.ACKNOWLEDGE),
    beat(ControllerState.FAULT),
)


def held_on_motion(phase, **changes):
    return in_phase(phase, held_on=StopCause.BONE_MOVED, **changes)


@pytest.mark.parametrize("cause", WITHDRAWING)
@pytest.mark.parametrize("words", [(), ACKNOWLEDGED], ids=["standing", "acknowledged"])
def test_the_cause_that_a_session_was_opened_on_withdraws_nothing_as_a_stop_brings_it_back(words, cause):
    """Anybody may send that stop; another cause than that one is the controller's own news."""
    run = Run(in_phase(Phase.OPENING), NOW).feed(ON_MOTION, *words)
    assert run.phase is Phase.HELD
    run.feed(beat(ControllerState.FAULT, cause=cause, epoch=NEXT_EPOCH))
    news = cause is not StopCause.BONE_MOVED
    assert (run.phase, run.state.registration_withdrawn) == (Phase.STOPPING, news)
    assert withdrawals(run.effects) == ([SendWithdraw(JOB.place)] if news else [])


@pytest.mark.parametrize(
    "stopped_by",
    [CommandGiven(OperatorCommand.STOP), FaultReceived(FaultCode.LATCHED, StopCause.OPERATOR_STOP)],
)
@pytest.mark.parametrize("cause", WITHDRAWING)
def test_nor_does_it_where_the_session_is_stopping_already(stopped_by, cause):
    run = Run(in_phase(Phase.OPENING), NOW).feed(ON_MOTION, *ACKNOWLEDGED, stopped_by)
    assert run.phase is Phase.STOPPING
    run.feed(beat(ControllerState.FAULT, cause=cause, epoch=NEXT_EPOCH))
    news = cause is not StopCause.BONE_MOVED
    assert run.state.registration_withdrawn is news
    assert (run.phase, withdrawals(run.effects)) == (
        (Phase.STOPPING, [SendWithdraw(JOB.place)]) if news else (Phase.STOPPED, [])
    )


@pytest.mark.parametrize("phase", [Phase.HELD, Phase.RESETTING], ids=str)
def test_once_the_controller_has_let_go_of_it_the_same_cause_is_a_new_motion(phase):
    run = Run(held_on_motion(phase), NOW).feed(beat(ControllerState.OPEN))
    assert run.phase is Phase.COLLECTING
    run.feed(beat(ControllerState.OPEN, cause=StopCause.BONE_MOVED, epoch=NEXT_EPOCH))
    assert (run.state.registration_withdrawn, withdrawals(run.effects)) == (True, [SendWithdraw(JOB.place)])


@pytest.mark.parametrize("phase", [Phase.NONCE_RESET, Phase.AUTHORISING_RESET, Phase.RESETTING], ids=str)
def test_a_reset_under_way_lets_go_of_nothing(phase):
    run = Run(held_on_motion(phase), NOW).feed(beat(ControllerState.FAULT))
    run.feed(beat(ControllerState.FAULT, cause=StopCause.BONE_MOVED, epoch=NEXT_EPOCH))
    assert (run.phase, run.state.registration_withdrawn) == (Phase.STOPPING, False)


def test_what_the_operator_withdraws_in_such_a_session_is_withdrawn():
    run = Run(in_phase(Phase.OPENING), NOW).feed(ON_MOTION, CommandGiven(OperatorCommand.WITHDRAW))
    assert (run.state.registration_withdrawn, withdrawals(run.effects)) == (True, [SendWithdraw(JOB.place)])


def test_a_reset_waits_for_everything_a_reset_needs():
    for field, value in (
        ("heartbeat_fresh", False),
        ("controller.emergency_stop_clear", False),
        ("log.writable", False),
    ):
        state = altered(in_phase(Phase.HELD), field, value)
        after, effects = step(state, CommandGiven(OperatorCommand.RESET), NOW)
        assert after == state
        assert [type(effect) for effect in effects] == [Refused]


# ---------------------------------------------------------------- collecting, uploading, verifying


def test_the_upload_begins_only_with_all_three_equal_to_the_approved():
    run = Run(FRESH).until(Phase.COLLECTING).feed(ParameterReceived(LIMITS), ParameterReceived(TOOL))
    assert (run.phase, run.effects) == (Phase.COLLECTING, ())
    other = replace(LIMITS, q_max_u=(79_000_000, *LIMITS.q_max_u[1:]))
    refused = Run(run.state, run.now_s).feed(
        ParameterReceived(other), ParameterReceived(records.Calibration.parse(JOB.calibration))
    )
    assert refused.phase is Phase.REFUSED
    assert "joint limits" in refused.state.reason
    run.feed(ParameterReceived(records.Calibration.parse(JOB.calibration)))
    assert (run.phase, run.effects) == (Phase.UPLOADING, (SendBlock(0),))


def test_blocks_go_one_after_the_other():
    assert len(records.split(JOB.path)) == JOB.blocks == PATH_BLOCKS
    run = Run(FRESH).until(Phase.UPLOADING)
    assert run.feed(BlockConfirmed(1)).state.block == 0
    assert [type(effect) for effect in run.effects] == [Dropped]
    assert run.feed(BlockConfirmed(0)).effects == (SendBlock(1),)
    assert run.feed(BlockConfirmed(1)).effects == (SendBlock(2),)
    assert run.feed(BlockConfirmed(2)).effects == ()
    before = run.state.token
    run.feed(STANDING, PathConfirmed(UploadedPath(PATH.digest, Refusal.ACCEPTED, 0)))
    assert (run.phase, run.state.token) == (Phase.VERIFYING, before + 1)
    assert run.effects == (Verify(before + 1, START_JOINTS),)


@pytest.mark.parametrize("old", [None, 0.2])
def test_what_is_verified_begins_where_the_arm_stands_now(old):
    """Neither unknown nor old joints are where it stands: the next sample is waited for, within the deadline."""
    run = Run(FRESH).until(Phase.UPLOADING)
    if old is not None:
        run.feed(measured(ELSEWHERE)).feed(Tick(), after_s=old)
    run.feed(PathConfirmed(UploadedPath(PATH.digest, Refusal.ACCEPTED, 0)))
    assert (run.phase, run.effects) == (Phase.UPLOADING, ())
    late = Run(run.state, run.now_s).feed(Tick(), after_s=DEADLINES.transfer_timeout_s)
    assert "no measured joints" in late.state.reason
    run.feed(STANDING)
    assert (run.phase, run.effects) == (Phase.VERIFYING, (Verify(run.state.token, START_JOINTS),))


@pytest.mark.parametrize(
    ("stored", "why"),
    [
        (UploadedPath(PATH.digest, Refusal.POSE_OUTSIDE_LIMITS, 17), "POSE_OUTSIDE_LIMITS at pose 17"),
        (UploadedPath(bytes(32), Refusal.ACCEPTED, 0), "digest of the stored path"),
    ],
)
def test_what_the_controller_did_not_accept_is_verified_for_guidance_and_then_refused(stored, why):
    run = Run(FRESH).until(Phase.UPLOADING).feed(STANDING, PathConfirmed(stored))
    assert run.phase is Phase.VERIFYING
    run.until(Phase.REFUSED)
    assert why in run.state.reason


def test_a_verdict_for_another_request_is_dropped():
    state = in_phase(Phase.VERIFYING)
    after, effects = step(state, VerdictReady(replace(VERDICT, request=VERDICT.request + 1)), NOW)
    assert after == state
    assert [type(effect) for effect in effects] == [Dropped]


@pytest.mark.parametrize(
    ("field", "value", "why"),
    [
        ("admissible", False, "verdict: outer"),
        ("path", bytes(32), "made for what the controller holds"),
    ],
)
def test_an_inadmissible_or_foreign_verdict_ends_the_session_with_the_reason(field, value, why):
    verdict = replace(VERDICT, reason="outer", **{field: value})
    after, effects = step(in_phase(Phase.VERIFYING), VerdictReady(verdict), NOW)
    assert after.phase is Phase.REFUSED
    assert why in after.reason
    assert effects == (SendStop(StopCode.END, StopCause.NOT_ADMITTED),)


def test_a_verdict_before_the_first_heartbeat_waits_for_it():
    """A short path is proved within one heartbeat period; that is no reason to refuse it."""
    state = in_phase(Phase.VERIFYING, controller=None, heartbeat_fresh=False)
    run = Run(state, NOW).feed(VerdictReady(VERDICT))
    assert (run.phase, run.effects) == (Phase.ADMITTED, ())
    run.feed(beat(ControllerState.LOADED))
    assert (run.phase, sent(run.effects)) == (
        Phase.NONCE_PERMIT,
        [records.NonceRequest(purpose=Purpose.PERMIT)],
    )
    assert run.state.nonce_at_s == run.now_s


def test_a_verdict_before_the_disk_has_reserved_its_space_waits_for_it():
    state = in_phase(Phase.VERIFYING, log=LogHealth(writable=True, reserved_bytes=0, needed_bytes=1000))
    run = Run(state, NOW).feed(VerdictReady(VERDICT), LogChanged(READY.log), beat())
    assert run.phase is Phase.NONCE_PERMIT


def test_an_admitted_path_waits_until_everything_holds():
    run = Run(in_phase(Phase.ADMITTED), NOW).feed(beat(fresh=False))
    assert (run.phase, run.effects) == (Phase.ADMITTED, ())
    run.feed(beat(cause=StopCause.BONE_MOVED))
    assert run.phase is Phase.STOPPING


@pytest.mark.parametrize(
    ("before", "withdrawn"), [(StopCause.NONE, True), (StopCause.BONE_MOVED, False), (None, False)]
)
def test_a_withdrawal_that_a_stopping_session_hears_counts_if_it_is_news(before, withdrawn):
    """A cause that stood before this session is none of its registration's; before any heartbeat nothing is known."""
    seen = None if before is None else replace(READY.controller, cause=before)
    state = in_phase(Phase.STOPPING, controller=seen, registration_withdrawn=False, answer_due=False)
    after, effects = step(state, beat(ControllerState.INHIBITED, cause=StopCause.BONE_MOVED), NOW)
    assert after.registration_withdrawn is withdrawn
    assert withdrawals(effects) == ([SendWithdraw(JOB.place)] if withdrawn else [])
    assert after.phase is (Phase.STOPPING if withdrawn else Phase.STOPPED)


@pytest.mark.parametrize("cause", [cause for cause in StopCause if cause not in WITHDRAWING])
def test_another_cause_that_a_stopping_session_hears_withdraws_nothing(cause):
    after, effects = step(in_phase(Phase.STOPPING), beat(ControllerState.FAULT, cause=cause), NOW)
    assert (after.phase, after.registration_withdrawn, effects) == (Phase.STOPPED, False, ())


AT_REST = beat(ControllerState.INHIBITED, cause=StopCause.BONE_MOVED, epoch=NEXT_EPOCH)


@pytest.mark.parametrize("refusal", [Refusal.ACCEPTED, Refusal.MEMORY_FAILED], ids=str)
def test_a_withdrawal_is_delivered_before_the_session_has_stopped(refusal):
    run = Run(in_phase(Phase.CUTTING), NOW).feed(AT_REST)
    assert withdrawals(run.effects) == [SendWithdraw(JOB.place)]
    run.feed(AT_REST, reply(records.Permit), reply(records.Permit, Refusal.EPOCH))
    assert run.phase is Phase.STOPPING
    run.feed(reply(records.Withdraw, refusal))
    refused = run.effects
    assert run.feed(AT_REST).phase is Phase.STOPPED
    if refusal is Refusal.ACCEPTED:
        assert refused == ()
    else:
        (told,) = refused
        assert "a withdrawal, which the controller refused: MEMORY_FAILED" in told.what


def test_a_withdrawal_that_is_not_answered_is_sent_again_to_a_controller_at_rest():
    """It may have been on its way with the stop, which voids it."""
    run = Run(in_phase(Phase.CUTTING), NOW).feed(CommandGiven(OperatorCommand.WITHDRAW))
    left_s = run.now_s
    run.feed(AT_REST, after_s=0.199)
    assert run.effects == ()
    moving = Run(run.state, left_s).feed(beat(ControllerState.CUTTING), after_s=0.201)
    assert moving.effects == ()
    run.feed(AT_REST, after_s=0.002)
    assert run.effects == (SendWithdraw(JOB.place),)
    assert run.feed(AT_REST, after_s=0.199).effects == ()
    assert run.feed(AT_REST, after_s=0.002).effects == (SendWithdraw(JOB.place),)
    run.feed(reply(records.Withdraw)).feed(AT_REST, after_s=0.3)
    assert (run.phase, run.effects) == (Phase.STOPPED, ())


def test_a_withdrawal_is_sent_again_after_two_time_outs_and_no_earlier():
    waits = in_phase(Phase.STOPPING, registration_withdrawn=True, withdraw_due=True, withdraw_sent_s=0.0)
    limit_s = 2 * TIMING.timeout_s
    assert step(waits, AT_REST, math.nextafter(limit_s, 0.0))[1] == ()
    assert step(waits, AT_REST, limit_s)[1] == (SendWithdraw(JOB.place),)


def test_a_withdrawal_that_was_heard_while_stopping_is_sent_again_as_well():
    run = Run(in_phase(Phase.STOPPING), NOW).feed(AT_REST)
    assert run.feed(AT_REST, after_s=0.199).effects == ()
    assert run.feed(AT_REST, after_s=0.002).effects == (SendWithdraw(JOB.place),)
    run.feed(CommandGiven(OperatorCommand.STOP))
    assert run.feed(AT_REST, after_s=0.199).effects == ()


def test_a_withdrawal_that_is_not_answered_is_awaited_as_long_as_a_confirmation():
    run = Run(in_phase(Phase.CUTTING), NOW).feed(CommandGiven(OperatorCommand.WITHDRAW), AT_REST)
    assert run.phase is Phase.STOPPING
    assert run.feed(Tick(), after_s=DEADLINES.stop_confirm_s + 0.01).phase is Phase.STOPPED
    lost = Run(in_phase(Phase.CUTTING), NOW).feed(CommandGiven(OperatorCommand.WITHDRAW), HeartbeatLost())
    assert lost.phase is Phase.STOPPED


@pytest.mark.parametrize(
    ("command", "answers", "told"),
    [
        (OperatorCommand.WITHDRAW, (), True),
        (OperatorCommand.WITHDRAW, (reply(records.Withdraw),), False),
        (OperatorCommand.STOP, (), False),
    ],
)
@pytest.mark.parametrize(
    "over", [HeartbeatLost(), Gone(StopCause.BUS_FAILED, "the bus"), None], ids=["lost", "gone", "late"]
)
def test_a_withdrawal_that_the_controller_has_not_confirmed_is_told_as_the_session_ends(
    command, answers, told, over
):
    run = Run(in_phase(Phase.CUTTING), NOW).feed(CommandGiven(command))
    reason = run.state.reason
    run.feed(*answers)
    run.feed(over) if over else run.feed(Tick(), after_s=DEADLINES.stop_confirm_s + 0.01)
    assert run.phase is Phase.STOPPED
    unheard = (
        "; the controller has not confirmed the withdrawal: only this log directory knows of it. Before the "
        "controller is used with another one, say withdraw in a session there"
    )
    assert run.state.reason == (reason + unheard if told else reason)


def test_a_stop_behind_a_withdrawal_that_is_not_answered_sends_it_again():
    """For it voids what waits; answered, it has arrived."""
    run = Run(in_phase(Phase.CUTTING), NOW).feed(CommandGiven(OperatorCommand.WITHDRAW))
    run.feed(CommandGiven(OperatorCommand.STOP))
    assert run.effects == (SendStop(StopCode.STOP, StopCause.OPERATOR_STOP), SendWithdraw(JOB.place))
    run.feed(reply(records.Withdraw), Failed(StopCause.LOOP_STALLED, "why"))
    assert run.effects == (SendStop(StopCode.STOP, StopCause.LOOP_STALLED),)
    again = run.feed(CommandGiven(OperatorCommand.WITHDRAW))
    assert (again.effects, again.state.withdraw_due) == ((), False)


@pytest.mark.parametrize("phase", [one for one in LIVE if one not in {*MOVING, Phase.STOPPING}], ids=str)
def test_who_quits_waits_for_no_withdrawal(phase):
    quitting, effects = step(in_phase(phase), CommandGiven(OperatorCommand.QUIT), NOW)
    assert (quitting.phase, withdrawals(effects)) == (Phase.STOPPED, [])


# ---------------------------------------------------------------- the controller as the log's witness


def test_a_permit_waits_for_the_look_up_of_the_log_and_asks_as_soon_as_it_is_found():
    state = in_phase(Phase.ADMITTED, witness=None)
    run = Run(state, NOW).feed(beat(ControllerState.LOADED), STANDING)
    assert (run.phase, run.effects) == (Phase.ADMITTED, ())
    run.feed(FOUND)
    assert (run.phase, sent(run.effects)) == (
        Phase.NONCE_PERMIT,
        [records.NonceRequest(purpose=Purpose.PERMIT)],
    )


def test_a_log_that_is_not_found_waits_for_its_own_confirmation():
    run = Run(in_phase(Phase.ADMITTED, witness=None), NOW)
    run.feed(CommandGiven(OperatorCommand.CONFIRM, "WITNESS"))
    assert [type(effect) for effect in run.effects] == [Refused], "it was not shown yet"
    run.feed(MISSED, beat(ControllerState.LOADED))
    assert (run.phase, run.effects) == (Phase.ADMITTED, ())
    run.feed(CommandGiven(OperatorCommand.CONFIRM, "CUT_TINY"))
    assert "say confirm WITNESS" in run.effects[0].reason
    run.feed(CommandGiven(OperatorCommand.CONFIRM, "WITNESS"))
    assert run.phase is Phase.NONCE_PERMIT


def test_a_log_that_is_found_needs_no_confirmation_and_takes_none():
    state = in_phase(Phase.ADMITTED)
    after, effects = step(state, CommandGiven(OperatorCommand.CONFIRM, "WITNESS"), NOW)
    assert (after, [type(effect) for effect in effects]) == (state, [Refused])


def test_a_look_up_that_does_not_end_ends_the_session():
    state = in_phase(Phase.ADMITTED, witness=None, since_s=NOW - 301)
    after, _ = step(state, Tick(), NOW)
    assert (after.phase, "controller's witness: being looked up" in after.reason) == (Phase.REFUSED, True)


def _warned(*codes, confirmed=()):
    verdict = replace(VERDICT, to_confirm=codes)
    return in_phase(Phase.ADMITTED, verdict=verdict, confirmed=frozenset(confirmed))


def test_an_admitted_path_waits_for_each_warning_to_be_confirmed():
    run = Run(_warned("CUT_TINY", "LIMITS_IN_RADIANS"), NOW).feed(beat(ControllerState.LOADED))
    assert (run.phase, run.effects) == (Phase.ADMITTED, ())
    run.feed(CommandGiven(OperatorCommand.CONFIRM, "LIMITS_IN_RADIANS"), beat(ControllerState.LOADED))
    assert (run.phase, run.effects) == (Phase.ADMITTED, ())
    run.feed(CommandGiven(OperatorCommand.CONFIRM, "CUT_TINY"))
    assert (run.phase, sent(run.effects)) == (
        Phase.NONCE_PERMIT,
        [records.NonceRequest(purpose=Purpose.PERMIT)],
    )


@pytest.mark.parametrize(
    ("what", "confirmed", "why"),
    [
        ("", (), "name the warning; say confirm CUT_TINY"),
        ("CUT_HUGE", (), "CUT_HUGE is no warning that waits to be confirmed; say confirm CUT_TINY"),
        ("CUT_TINY", ("CUT_TINY",), "CUT_TINY is no warning that waits to be confirmed; none waits"),
    ],
)
def test_only_a_warning_that_waits_can_be_confirmed(what, confirmed, why):
    before = _warned("CUT_TINY", confirmed=confirmed)
    assert step(before, CommandGiven(OperatorCommand.CONFIRM, what), NOW) == (
        before,
        (Refused(OperatorCommand.CONFIRM, why),),
    )


@pytest.mark.parametrize("phase", sorted({*Phase} - {Phase.ADMITTED} - ENDED))
def test_a_warning_is_confirmed_only_where_it_has_been_shown(phase):
    before = in_phase(phase)
    after, effects = step(before, CommandGiven(OperatorCommand.CONFIRM, "CUT_TINY"), NOW)
    assert after.confirmed == frozenset()
    assert [type(effect) for effect in effects] == [Refused]


# ---------------------------------------------------------------- permit, start, cut


@pytest.mark.parametrize("refusal", [one for one in Refusal if one is not Refusal.ACCEPTED], ids=str)
def test_a_refused_permit_ends_and_a_refused_start_may_be_tried_again(refusal):
    after, _ = step(in_phase(Phase.PERMITTING), reply(records.Permit, refusal), NOW)
    assert (after.phase, after.permit) == (Phase.REFUSED, None)
    assert refusal.name in after.reason
    after, effects = step(in_phase(Phase.STARTING), reply(records.Start, refusal), NOW)
    assert (after.phase, after.nonce, code(after)) == (Phase.PERMITTED, None, RuntimeCode.READY)
    assert refusal.name in effects[0].reason


@pytest.mark.parametrize("phase", [phase for phase in LIVE if phase not in MOVING], ids=str)
def test_a_measurement_is_kept_with_the_time_when_it_was_made_not_when_it_came(phase):
    after, effects = step(in_phase(phase), measured(ELSEWHERE, NOW + 2.5), NOW + 3.0)
    assert (after.joints_u, after.measured_s) == (ELSEWHERE, NOW + 2.5)
    assert not stops(effects)


@pytest.mark.parametrize("age_s", [0.101, -0.001, math.inf])
def test_joints_that_were_measured_too_long_ago_start_nothing_however_late_they_came(age_s):
    late = measured(START_JOINTS, NOW - age_s)
    state, _ = step(READY, late, NOW)
    after, effects = step(state, CommandGiven(OperatorCommand.START), NOW)
    assert after == state
    assert "age of the measured joints" in effects[0].reason
    state, _ = step(in_phase(Phase.AUTHORISING_START), late, NOW)
    after, effects = step(state, PENDING, NOW)
    assert (after.phase, effects) == (Phase.PERMITTED, (Withheld(TOKEN),))
    state, _ = step(in_phase(Phase.AUTHORISING_PERMIT), late, NOW)
    assert step(state, PENDING, NOW)[1] == (Withheld(TOKEN),)
    assert step(in_phase(Phase.UPLOADING), late, NOW)[0].phase is Phase.UPLOADING, (
        "nor are they verified from"
    )


def test_an_arm_that_moves_after_its_approach_was_verified_is_not_permitted():
    run = Run(FRESH).until(Phase.VERIFYING).feed(beat(device_pressed=False), measured(ELSEWHERE))
    run.feed(VerdictReady(replace(VERDICT, request=run.state.token)), beat())
    assert (run.phase, run.effects) == (Phase.ADMITTED, ())
    run.feed(STANDING, beat())
    assert run.phase is Phase.NONCE_PERMIT
    run.until(Phase.AUTHORISING_PERMIT).feed(measured(ELSEWHERE)).durable()
    assert (run.phase, run.effects) == (Phase.ADMITTED, (Withheld(run.state.token),))


def test_an_approach_that_is_not_admissible_ends_the_session():
    run = Run(FRESH).until(Phase.VERIFYING).feed(beat(device_pressed=False), STANDING)
    bad = replace(VERDICT, request=run.state.token, approach=None, approach_reason="inner: 3 mm, needs 5 mm")
    run.feed(VerdictReady(bad))
    assert run.phase is Phase.REFUSED
    assert stops(run.effects, StopCode.END) == [StopCause.NOT_ADMITTED]
    assert "approach and retract: inner: 3 mm, needs 5 mm" in run.state.reason
    assert "approach_clearance_mm" in run.state.reason


def test_the_happy_path_from_announcement_to_done():
    run = Run(FRESH, 77.0)
    codes = {}
    for phase in (
        Phase.OPENING,
        Phase.COLLECTING,
        Phase.UPLOADING,
        Phase.VERIFYING,
        Phase.NONCE_PERMIT,
        Phase.AUTHORISING_PERMIT,
        Phase.PERMITTING,
        Phase.PERMITTED,
        Phase.NONCE_START,
        Phase.AUTHORISING_START,
        Phase.STARTING,
        Phase.CUTTING,
    ):
        run.until(phase)
        codes[phase] = code(run.state)
    assert {phase for phase, order in codes.items() if order is RuntimeCode.CUT} == ORDERS
    assert {phase for phase, order in codes.items() if order is RuntimeCode.READY} == {
        Phase.PERMITTING,
        Phase.PERMITTED,
        Phase.NONCE_START,
        Phase.AUTHORISING_START,
    }
    run.feed(*(beat(ControllerState.CUTTING) for _ in range(100)), after_s=0.02)
    assert (run.phase, run.effects) == (Phase.CUTTING, ())
    half_way = ProgressReported(1, FRACTION_MAX // 2)
    for _ in range(20_000):
        run.feed(HALF_WAY, half_way, Tick(), after_s=0.06)
    assert (run.phase, run.effects) == (Phase.CUTTING, ()), "it lasts as long as joints and progress come"
    assert code(run.until(Phase.FINISHING).state) is RuntimeCode.INHIBIT
    run.until(Phase.DONE)
    assert run.state.cause is StopCause.NONE


def test_withheld_permits_and_starts_can_be_asked_for_again():
    run = Run(FRESH).until(Phase.AUTHORISING_PERMIT).feed(beat(emergency_stop_clear=False)).durable()
    assert (run.phase, run.effects) == (Phase.ADMITTED, (Withheld(run.state.token),))
    run.until(Phase.AUTHORISING_START).feed(measured(ELSEWHERE)).durable()
    assert (run.phase, run.effects) == (Phase.PERMITTED, (Withheld(run.state.token),))
    run.until(Phase.DONE)


def test_tokens_are_never_used_twice():
    run = Run(FRESH).until(Phase.AUTHORISING_PERMIT)
    first = run.state.token
    run.feed(beat(emergency_stop_clear=False)).durable().until(Phase.AUTHORISING_PERMIT)
    second = run.state.token
    third = run.until(Phase.AUTHORISING_START).state.token
    assert first < second < third
    assert isinstance(run.effects[0], Commit)


SILENT = ENDED | {Phase.STOPPING}
"""After the end, and while it is confirmed, no command is answered."""


@pytest.mark.parametrize("phase", [phase for phase in Phase if phase not in SILENT], ids=str)
def test_a_command_that_does_not_apply_is_refused_with_what_is_so(phase):
    applies = {
        Phase.HELD: {OperatorCommand.ACKNOWLEDGE, OperatorCommand.RESET},
        Phase.ADMITTED: {OperatorCommand.CONFIRM},
        Phase.PERMITTED: {OperatorCommand.START},
    }
    patiently = {"tracking": patient(0.0)} if phase in MOVING else {}
    state = in_phase(phase, **patiently)
    for word in {
        OperatorCommand.ACKNOWLEDGE,
        OperatorCommand.RESET,
        OperatorCommand.CONFIRM,
        OperatorCommand.START,
    } - applies.get(phase, set()):
        after, effects = step(state, CommandGiven(word, "BOX_SMALL"), NOW)
        told = f"{word} does not apply while {PHASES[phase].situation}"
        assert (after.phase, effects) == (phase, (Refused(word, told),)), phase


def test_each_phase_that_answers_commands_has_a_situation_of_its_own():
    situations = [PHASES[phase].situation for phase in Phase if phase not in SILENT]
    assert len(set(situations)) == len(situations)
    assert {PHASES[phase].situation for phase in SILENT} == {""}
