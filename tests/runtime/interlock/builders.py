"""One job, one state in which everything holds, and one of every event: what the interlock's tests start from."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from cutgate.protocol import records
from cutgate.protocol.frames import FRACTION_MAX
from cutgate.protocol.states import (
    ControllerState,
    FaultCode,
    Purpose,
    Refusal,
    RuntimeCode,
    StopCause,
    StopCode,
)
from cutgate.runtime.interlock import table
from cutgate.runtime.interlock.phases import MOVING, PHASES
from cutgate.runtime.interlock.state import (
    Announced,
    BlockConfirmed,
    Collected,
    CommandGiven,
    Commit,
    ControllerView,
    CutVerdict,
    Deadlines,
    DeviceCycle,
    Effect,
    Event,
    Failed,
    FaultReceived,
    Gone,
    HeartbeatLost,
    HeartbeatReceived,
    Interlock,
    Job,
    JointsMeasured,
    LogChanged,
    LogHealth,
    NonceReceived,
    OperatorCommand,
    OtherVersionAnnounced,
    ParameterReceived,
    PathConfirmed,
    Phase,
    ProgressReported,
    RecordDurable,
    ReplyReceived,
    Send,
    SendStop,
    SessionIdentity,
    SessionOpened,
    Tick,
    UploadedPath,
    VerdictReady,
    WithdrawalSent,
    WitnessSought,
)
from cutgate.runtime.interlock.tracking import (
    FrameSeen,
    ReferenceTrajectory,
    TrackingMonitor,
    TrackingTolerance,
)
from cutgate.runtime.kinematics.landmarks import CheckPoints, PointResidual

NOW = 1000.0
EPOCH = 3
NEXT_EPOCH = 4
TOKEN = 7
REQUEST = 6
ANNOUNCE_NONCE, RUNTIME_NONCE = bytes(range(16)), bytes(range(16, 32))
NONCE = bytes(range(32, 48))

TIMING = records.Timing(
    heartbeat_ms=20,
    timeout_ms=100,
    permit_lifetime_s=120,
    start_lifetime_ms=2000,
    start_tolerance_um=500,
    start_tolerance_mdeg=200,
    approach_clearance_um=10_000,
    approach_speed_percent=25,
)
DEADLINES = Deadlines(
    announce_wait_s=30.0,
    reply_timeout_s=2.0,
    transfer_timeout_s=20.0,
    verify_timeout_s=60.0,
    operator_wait_s=300.0,
    commit_deadline_s=1.0,
    stop_confirm_s=1.5,
)
TRACKING = TrackingTolerance(wrist_mm=0.5, joint_deg=0.25)

LIMITS = records.Limits.quantised(
    q_min_deg=(-80, 0, 50, -170, 0), q_max_deg=(80, 145, 450, 170, 110), speed_deg_s=(57, 57, 200, 114, 114)
)
CALIBRATION = records.Calibration.quantised(upper_link_mm=450.0, forearm_link_mm=450.0)
TOOL = records.Tool.quantised(length_mm=160.0)
POSES = 450
PATH = records.Path.quantised(
    np.column_stack((np.linspace(500.0, 520.0, POSES), np.zeros(POSES), np.full(POSES, 100.0))),
    np.tile((0.6, 0.0, 0.8), (POSES, 1)),
    feed_mm_s=10.0,
    tool_length_mm=160.0,
    elbow="right",
)
PATH_BLOCKS = 3

JOB = Job(
    limits=LIMITS.body(),
    calibration=CALIBRATION.body(),
    tool=TOOL.body(),
    path=PATH.body(),
    registration=records.digest(b"registration"),
    place=records.digest(b"place"),
    registration_time_us=1_790_000_000_000_000,
    prepared_us=1_790_000_060_000_000,
    configuration=records.digest(b"configuration"),
    verifier="cutgate test",
    branch=records.Branch("right", 0, 0),
    timing=TIMING,
    deadlines=DEADLINES,
    tracking=TRACKING,
    serial="SIM-1",
    registration_age_s=100.0,
    registration_max_age_s=3600.0,
    registration_residual_mm=0.5,
    registration_max_residual_mm=1.0,
    check_points=CheckPoints((PointResidual("P1", 0.4), PointResidual("P2", 1.2)), 2.0, 2),
    key_fingerprint="1a2b3c4d",
)

ANNOUNCE = records.Announce(
    protocol_version=records.PROTOCOL_VERSION,
    firmware_version="test",
    plant_speed_permille=1000,
    serial="SIM-1",
    announce_nonce=ANNOUNCE_NONCE,
    state=ControllerState.INHIBITED,
    cause=StopCause.NONE,
)

OPEN = records.Open(
    protocol_version=records.PROTOCOL_VERSION,
    announce_nonce=ANNOUNCE_NONCE,
    runtime_nonce=RUNTIME_NONCE,
    identity_digest=ANNOUNCE.identity_digest,
    registration_digest=JOB.registration,
    place_digest=JOB.place,
    registration_time_us=JOB.registration_time_us,
    configuration_digest=JOB.configuration,
    verifier_version=JOB.verifier,
    timing=TIMING,
)

SESSION = SessionIdentity(OPEN, "SIM-1")

SEEN_LOG = records.TreeHead(b"earlier log's id", 17, records.digest(b"earlier log"))
"""What the controller saw at the last start, in another session."""
OPENED = records.Opened(EPOCH, ControllerState.OPEN, StopCause.NONE, log=SEEN_LOG)
FOUND = WitnessSought(found=True, text="found in earlier.mcap")
MISSED = WitnessSought(found=False, text="no log is there")
DURABLE_LOG = records.TreeHead(b"this session's l", 40, records.digest(b"this log"))
"""The session's own log once a record is durable."""

VIEW = ControllerView(
    state=ControllerState.PERMITTED,
    cause=StopCause.NONE,
    epoch=EPOCH,
    device_pressed=True,
    emergency_stop_clear=True,
    cutting_mode=True,
)

START_JOINTS = (10_000_000, 20_000_000, 100_000_000, 30_000_000, 40_000_000)
ELSEWHERE = (*START_JOINTS[:2], START_JOINTS[2] + 2_000_000, *START_JOINTS[3:])
"""2 mm off the start joints, and off every place of the path."""


def measured(joints_u: tuple[int, ...], at_s: float = math.nan) -> JointsMeasured:
    """Joints measured then; else (``dated``) as they arrive."""
    return JointsMeasured(joints_u, at_s)


def dated(event: Event, now_s: float) -> Event:
    """An event as it arrives: joints are measured at this moment unless it is said when."""
    undated = isinstance(event, JointsMeasured) and math.isnan(event.measured_s)
    return replace(event, measured_s=now_s) if undated else event


def step(state: Interlock, event: Event, now_s: float) -> table.Outcome:
    """The table's step; joints that come undated are measured as they come."""
    return table.step(state, dated(event, now_s), now_s)


STANDING = measured(START_JOINTS)


def pitched(deg: float, start_u: tuple[int, ...] = START_JOINTS) -> tuple[int, ...]:
    """The start joints with another pitch, along which the path goes, 1e-6 deg | mm."""
    return (*start_u[:4], start_u[4] + round(deg * records.UNIT))


def trajectory(start_u: tuple[int, ...]) -> ReferenceTrajectory:
    """Along the pitch to 4 deg and back, so short that an arm is at its end a few events after the start: two segments."""
    return ReferenceTrajectory(
        times_s=np.array([0.0, 0.01, 0.02, 0.03, 0.11, 0.115, 0.12]),
        joints=np.stack([records.joints_to_memory(pitched(deg, start_u)) for deg in (0, 1, 2, 3, 4, 3, 0)]),
        poses_s=np.array([0.02, 0.03, 0.11]),
        links_mm=(450.0, 450.0),
    )


TRAJECTORY = trajectory(START_JOINTS)
HALF_WAY = measured(pitched(3.5))
ON = ProgressReported(1, 0)
BEYOND = ProgressReported(1, FRACTION_MAX)
"""At the end of the cut: where no arm can be as early as a time-out after its start."""

VERDICT = CutVerdict(
    request=REQUEST,
    admissible=True,
    path=PATH.digest,
    limits=records.digest(LIMITS.body()),
    calibration=records.digest(CALIBRATION.body()),
    tool=records.digest(TOOL.body()),
    start_joints_u=START_JOINTS,
    reason="admissible",
    approach=records.Approach(
        entry_um=30_000,
        exit_um=10_000,
        entry_joints_u=(11_000_000, 21_000_000, 110_000_000, 31_000_000, 36_869_898),
        exit_joints_u=(12_000_000, 22_000_000, 110_000_000, 32_000_000, 36_869_898),
        speed_percent=25,
    ),
    approach_reason="every leg keeps every deadband",
    trajectory=TRAJECTORY,
)

PERMIT = records.Permit(
    nonce=NONCE,
    announce_nonce=ANNOUNCE_NONCE,
    session_digest=SESSION.digest,
    serial="SIM-1",
    protocol_version=records.PROTOCOL_VERSION,
    epoch=EPOCH,
    limits_digest=VERDICT.limits,
    calibration_digest=VERDICT.calibration,
    tool_digest=VERDICT.tool,
    path_digest=VERDICT.path,
    registration_digest=JOB.registration,
    configuration_digest=JOB.configuration,
    verifier_version=JOB.verifier,
    start_joints_u=VERDICT.start_joints_u,
    branch=JOB.branch,
    approach=VERDICT.approach,
    lifetime_s=120,
    log=DURABLE_LOG,
)

READY = Interlock(
    job=JOB,
    phase=Phase.PERMITTED,
    since_s=NOW - 0.5,
    began_s=NOW - 60.0,
    announced_version=records.PROTOCOL_VERSION,
    session=SESSION,
    opened=OPENED,
    witness=FOUND,
    epoch=EPOCH,
    controller=VIEW,
    heartbeat_fresh=True,
    collected=Collected(JOB.limits, JOB.calibration, JOB.tool),
    block=PATH_BLOCKS - 1,
    stored=UploadedPath(PATH.digest, Refusal.ACCEPTED, 0),
    verdict=VERDICT,
    nonce=NONCE,
    permit=PERMIT,
    nonce_at_s=NOW - 5.0,
    token=TOKEN,
    device=DeviceCycle.PRESSED,
    joints_u=START_JOINTS,
    measured_s=NOW - 0.01,
    log=LogHealth(writable=True, reserved_bytes=2000, needed_bytes=1000),
)
"""Every permissive of FOR_START holds at NOW."""

FRESH = Interlock(job=JOB, log=READY.log)
"""The interlock as it is made: nothing seen yet."""


def monitor(began_s: float = NOW, seen_s: float | None = None) -> TrackingMonitor:
    """Begun then; the last sample and progress came when the arm stood at its start, at ``seen_s``."""
    begun = TrackingMonitor.begin(TRAJECTORY, TIMING, TRACKING, 1.0, began_s)
    seen = FrameSeen(0.0, began_s if seen_s is None else seen_s)
    return replace(begun, sampled=seen, progressed=seen, heard_s=seen.at_s)


def in_phase(phase: Phase, **changes: Any) -> Interlock:
    """The state in which everything holds, put into ``phase``: only the table is left to refuse.

    While the arm moves it may be anywhere on its path.
    """
    token = REQUEST if phase is Phase.VERIFYING else TOKEN
    early = {"session": None} if phase is Phase.WAITING else {}
    moving = {"tracking": monitor(NOW - 10.0, NOW)} if phase in MOVING else {}
    return replace(READY, phase=phase, token=token, **(early | moving | changes))


def view(state: ControllerState = ControllerState.LOADED, **changes: Any) -> ControllerView:
    """What a controller in this state reports."""
    cutting = state in (ControllerState.PERMITTED, ControllerState.CUTTING)
    return replace(VIEW, state=state, cutting_mode=cutting, **changes)


def beat(state: ControllerState = ControllerState.LOADED, *, fresh: bool = True, **changes: Any) -> Event:
    """A heartbeat of a controller in this state."""
    return HeartbeatReceived(view(state, **changes), fresh)


def reply(request: type[records.Record], refusal: Refusal = Refusal.ACCEPTED) -> Event:
    """The controller's answer to a request of this type."""
    return ReplyReceived(request.TYPE, refusal, StopCause.NONE)


def opened(
    state: ControllerState = ControllerState.OPEN,
    cause: StopCause = StopCause.NONE,
    *,
    authentic: bool = True,
    **changes: Any,
) -> Event:
    """The session is open, with a controller in this state."""
    return SessionOpened(replace(OPENED, state=state, cause=cause, **changes), authentic)


def durable(token: int) -> Event:
    """The record with this token has reached the disk."""
    return RecordDurable(token, DURABLE_LOG)


EXPECTED_STATE: dict[Phase, ControllerState] = {
    Phase.COLLECTING: ControllerState.OPEN,
    Phase.UPLOADING: ControllerState.OPEN,
    Phase.PERMITTED: ControllerState.PERMITTED,
    Phase.NONCE_START: ControllerState.PERMITTED,
    Phase.AUTHORISING_START: ControllerState.PERMITTED,
    Phase.STARTING: ControllerState.PERMITTED,
    Phase.CUTTING: ControllerState.CUTTING,
    Phase.FINISHING: ControllerState.DONE,
    Phase.HELD: ControllerState.FAULT,
    Phase.NONCE_RESET: ControllerState.FAULT,
    Phase.AUTHORISING_RESET: ControllerState.FAULT,
    Phase.RESETTING: ControllerState.FAULT,
}
"""What a sound controller reports in each phase; LOADED in all others."""


def sound_beat(state: Interlock, **changes: Any) -> Event:
    """The heartbeat of a sound controller in the state's phase."""
    return beat(EXPECTED_STATE.get(state.phase, ControllerState.LOADED), **({"epoch": state.epoch} | changes))


def stop_events(state: Interlock) -> dict[str, Event]:
    """Every event that must stop, whatever the phase."""
    return {
        "operator": CommandGiven(OperatorCommand.STOP),
        "withdrawn": CommandGiven(OperatorCommand.WITHDRAW),
        "heartbeat lost": HeartbeatLost(),
        "fault": FaultReceived(FaultCode.STOPPED, StopCause.EMERGENCY_STOP),
        "shell": Failed(StopCause.LOOP_STALLED, "the loop stalled"),
        "log": LogChanged(replace(state.log, writable=False)),
    }


def events(state: Interlock) -> list[Event]:
    """At least one of every kind of event, each as tempting as it can be in ``state``."""
    epoch = state.epoch
    everything: list[Event] = [
        Announced(ANNOUNCE, RUNTIME_NONCE),
        OtherVersionAnnounced(3),
        *(
            opened(kind, cause, epoch=epoch, authentic=authentic)
            for kind in ControllerState
            for cause in list(StopCause)[:2]
            for authentic in (True, False)
        ),
        FOUND,
        MISSED,
        *(ParameterReceived(record) for record in (LIMITS, CALIBRATION, TOOL)),
        *(BlockConfirmed(index) for index in range(PATH_BLOCKS)),
        PathConfirmed(READY.stored or UploadedPath(b"", Refusal.ACCEPTED, 0)),
        *(VerdictReady(replace(VERDICT, request=token)) for token in (state.token, state.token + 1)),
        *(NonceReceived(purpose, NONCE, e) for purpose in Purpose for e in (epoch, epoch + 1)),
        *(
            reply(kind, refusal)
            for kind in REQUESTS
            for refusal in (Refusal.ACCEPTED, Refusal.NONCE_MISMATCH)
        ),
        *(beat(kind, epoch=epoch) for kind in ControllerState),
        *(beat(kind, epoch=epoch, device_pressed=False) for kind in ControllerState),
        *(beat(kind, epoch=epoch, cause=StopCause.DEVICE_RELEASED) for kind in ControllerState),
        beat(epoch=epoch + 1),
        beat(ControllerState.PERMITTED, epoch=epoch, fresh=False),
        STANDING,
        measured(ELSEWHERE),
        HALF_WAY,
        ON,
        BEYOND,
        ProgressReported(2, 0),
        *(durable(token) for token in (state.token - 1, state.token, state.token + 1)),
        WithdrawalSent(JOB.registration_time_us),
        LogChanged(state.log),
        *(CommandGiven(word) for word in OperatorCommand),
        Tick(),
        Gone(StopCause.INTERNAL_ERROR, "the program failed"),
        *stop_events(state).values(),
    ]
    return everything


def code(state: Interlock) -> RuntimeCode:
    """What the heartbeat says in this state."""
    return PHASES[state.phase].heartbeat


PERMISSIVENESS = {RuntimeCode.INHIBIT: 0, RuntimeCode.READY: 1, RuntimeCode.CUT: 2}

ENABLING = (records.Permit, records.Start, records.Reset)
REQUESTS = (records.Open, *ENABLING, records.Acknowledge, records.Withdraw)
"""What is answered by a Reply."""


def sent(effects: tuple[Effect, ...]) -> list[records.Record]:
    """The records among the effects."""
    return [effect.record for effect in effects if isinstance(effect, Send)]


def enabled(effects: tuple[Effect, ...]) -> list[records.Record]:
    """The permits, starts and resets that leave."""
    return [record for record in sent(effects) if isinstance(record, ENABLING)]


def stops(effects: tuple[Effect, ...], code: StopCode = StopCode.STOP) -> list[StopCause]:
    """The causes of the stop frames that leave."""
    return [effect.cause for effect in effects if isinstance(effect, SendStop) and effect.code is code]


class Run:
    """One session, event by event; keeps state, time and the effects of the last event."""

    def __init__(self, state: Interlock, now_s: float = 0.0) -> None:
        self.state = state
        self.now_s = now_s
        self.effects: tuple[Effect, ...] = ()

    def feed(self, *arriving: Event, after_s: float = 0.01) -> "Run":
        """Feed events, each ``after_s`` later than the one before."""
        for event in arriving:
            self.now_s += after_s
            self.state, self.effects = step(self.state, event, self.now_s)
        return self

    @property
    def phase(self) -> Phase:
        """Where the conversation stands."""
        return self.state.phase

    @property
    def commit(self) -> Commit:
        """The commit among the last effects."""
        return next(effect for effect in self.effects if isinstance(effect, Commit))

    def durable(self) -> "Run":
        """The pending record reaches the disk."""
        return self.feed(durable(self.state.token))

    def until(self, phase: Phase) -> "Run":
        """Go the straight way up to ``phase``."""
        for _ in range(2 * len(Phase)):
            if self.phase is phase:
                return self
            for event in STRAIGHT_ON[self.phase](self.state):
                self.feed(event)
                if self.phase is phase:
                    break
        raise AssertionError(f"the straight way leads to {self.phase}, never to {phase}")


def _opened(_state: Interlock) -> tuple[Event, ...]:
    return (opened(),)


def _verdict(state: Interlock) -> tuple[Event, ...]:
    return (
        beat(ControllerState.LOADED, device_pressed=False),
        STANDING,
        VerdictReady(replace(VERDICT, request=state.token)),
    )


def _go(_state: Interlock) -> tuple[Event, ...]:
    return (
        beat(ControllerState.PERMITTED, device_pressed=False),
        beat(ControllerState.PERMITTED),
        STANDING,
        CommandGiven(OperatorCommand.START),
    )


STRAIGHT_ON: dict[Phase, Callable[[Interlock], tuple[Event, ...]]] = {
    Phase.WAITING: lambda _s: (Announced(ANNOUNCE, RUNTIME_NONCE),),
    Phase.OPENING: _opened,
    Phase.COLLECTING: lambda _s: (
        FOUND,
        *(ParameterReceived(kind) for kind in (LIMITS, CALIBRATION, TOOL)),
    ),
    Phase.UPLOADING: lambda _s: (
        *(BlockConfirmed(index) for index in range(PATH_BLOCKS)),
        STANDING,
        PathConfirmed(UploadedPath(PATH.digest, Refusal.ACCEPTED, 0)),
    ),
    Phase.VERIFYING: _verdict,
    Phase.ADMITTED: lambda _s: (STANDING, beat()),
    Phase.NONCE_PERMIT: lambda _s: (NonceReceived(Purpose.PERMIT, NONCE, EPOCH),),
    Phase.AUTHORISING_PERMIT: lambda s: (durable(s.token),),
    Phase.PERMITTING: lambda _s: (reply(records.Permit), beat(ControllerState.PERMITTED)),
    Phase.PERMITTED: _go,
    Phase.NONCE_START: lambda _s: (NonceReceived(Purpose.START, NONCE, EPOCH),),
    Phase.AUTHORISING_START: lambda s: (durable(s.token),),
    Phase.STARTING: lambda _s: (reply(records.Start), beat(ControllerState.CUTTING)),
    Phase.CUTTING: lambda _s: (beat(ControllerState.CUTTING), beat(ControllerState.DONE)),
    Phase.FINISHING: lambda _s: (STANDING,),
    Phase.HELD: lambda s: (
        beat(ControllerState.FAULT, epoch=s.epoch, cause=StopCause.NONE),
        CommandGiven(OperatorCommand.RESET),
    ),
    Phase.NONCE_RESET: lambda s: (NonceReceived(Purpose.RESET, NONCE, s.epoch),),
    Phase.AUTHORISING_RESET: lambda s: (durable(s.token),),
    Phase.RESETTING: lambda _s: (reply(records.Reset), beat(ControllerState.OPEN)),
    Phase.STOPPING: lambda _s: (beat(ControllerState.INHIBITED, cause=StopCause.OPERATOR_STOP),),
}
"""What a sound controller and a patient operator do next in each phase."""
