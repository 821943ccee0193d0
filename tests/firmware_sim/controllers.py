"""A controller taken by its own table to each state, and one request that passes: what its tests start from."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from cutgate.firmware_sim import reports
from cutgate.firmware_sim.approach import Ends
from cutgate.firmware_sim.rules import RequestCase
from cutgate.firmware_sim.state import (
    AcknowledgeReceived,
    BoneMoved,
    CollectReceived,
    Controller,
    Effect,
    Event,
    FaultArisen,
    HeartbeatLost,
    HeartbeatReceived,
    Holdings,
    Identity,
    Inputs,
    InputsChanged,
    JointsMeasured,
    LimitsChanged,
    Memory,
    NonceRequested,
    OpenReceived,
    PathChecked,
    PathFinished,
    PermitReceived,
    Persist,
    Persisted,
    PersistFailed,
    ResetReceived,
    Send,
    SendFault,
    StartReceived,
    StopReceived,
    Tick,
    WithdrawReceived,
)
from cutgate.firmware_sim.table import step
from cutgate.protocol import records
from cutgate.protocol.states import Purpose, Refusal, RuntimeCode, StopCause, StopCode
from tests.altering import altered

NOW = 500.0
FINGERPRINT = "0123abcd"
ANNOUNCE_NONCE, NEXT_NONCE, RUNTIME_NONCE = b"b" * 16, b"x" * 16, b"r" * 16
PERMIT_NONCE, START_NONCE, RESET_NONCE = b"p" * 16, b"s" * 16, b"z" * 16
REGISTRATION, PLACE = records.digest(b"registration"), records.digest(b"place")
REGISTERED_US = 1_700_000_000_000_000
PERMIT_LOG = records.TreeHead(b"l" * 16, 40, records.digest(b"tree at the permit"))
START_LOG = records.TreeHead(b"l" * 16, 41, records.digest(b"tree at the start"))
CONFIGURATION = records.digest(b"configuration")
START_JOINTS = (10_000_000, 20_000_000, 100_000_000, 30_000_000, 40_000_000)
ENDS = Ends(
    entry_um=12_000,
    exit_um=32_000,
    entry_joints_u=(-70_000_000, 100_000_000, 210_000_000, -160_000_000, 36_000_000),
    exit_joints_u=(-69_000_000, 99_000_000, 211_000_000, 160_000_000, 37_000_000),
)

LIMITS = records.Limits.quantised(
    q_min_deg=(-80, 0, 50, -170, 0), q_max_deg=(80, 145, 450, 170, 110), speed_deg_s=(57, 57, 200, 114, 114)
)
OTHER_LIMITS = replace(LIMITS, q_max_u=(79_000_000, *LIMITS.q_max_u[1:]))
CALIBRATION = records.Calibration.quantised(upper_link_mm=450.0, forearm_link_mm=450.0)
TOOL = records.Tool.quantised(length_mm=160.0)
PATH = records.Path.quantised(
    [(500.0, 0.0, 100.0), (510.0, 0.0, 100.0), (520.0, 0.0, 100.0)],
    np.tile((0.6, 0.0, 0.8), (3, 1)),
    feed_mm_s=10.0,
    tool_length_mm=160.0,
    elbow="right",
    q0_turns=0,
    roll_turns=1,
)

POWERED_UP = Controller.powered_up(
    Identity(serial="SIM-1", key_fingerprint=FINGERPRINT),
    Holdings(LIMITS.body(), CALIBRATION.body(), TOOL.body()),
    Memory(),
    ANNOUNCE_NONCE,
)
OPEN = records.Open(
    protocol_version=records.PROTOCOL_VERSION,
    announce_nonce=ANNOUNCE_NONCE,
    runtime_nonce=RUNTIME_NONCE,
    identity_digest=reports.announcement(POWERED_UP).identity_digest,
    registration_digest=REGISTRATION,
    place_digest=PLACE,
    registration_time_us=REGISTERED_US,
    configuration_digest=CONFIGURATION,
    verifier_version="cutgate test",
    timing=records.Timing(
        heartbeat_ms=20,
        timeout_ms=100,
        permit_lifetime_s=120,
        start_lifetime_ms=2000,
        start_tolerance_um=500,
        start_tolerance_mdeg=200,
        approach_clearance_um=10_000,
        approach_speed_percent=25,
    ),
)
SESSION = records.session_digest(OPEN)
TAG = records.session_tag(SESSION)


def opening(request: records.Open = OPEN, *, fresh: bytes = NEXT_NONCE, **changes: Any) -> OpenReceived:
    """An OPEN that a holder of the key made, with some of it changed."""
    return OpenReceived(replace(request, **changes), 1, authentic=True, fresh=fresh)


def reopening(state: Controller, **changes: Any) -> OpenReceived:
    """An OPEN that names what this controller announces now."""
    fresh = records.digest(state.announce_nonce)[:16]
    return opening(announce_nonce=state.announce_nonce, fresh=fresh, **changes)


def acknowledging(cause: StopCause, epoch: int, *, authentic: bool = True) -> AcknowledgeReceived:
    """An acknowledgement of this cause, in this epoch."""
    return AcknowledgeReceived(records.Acknowledge(epoch=epoch, cause=cause), 2, authentic)


def withdrawing(
    place: bytes = PLACE, barrier_us: int = REGISTERED_US, *, authentic: bool = True
) -> WithdrawReceived:
    """A Withdraw of this place with this barrier."""
    return WithdrawReceived(records.Withdraw(place, barrier_us), 5, authentic)


def settled(
    state: Controller, event: Event, now_s: float, take: Callable[..., Any] = step
) -> tuple[Controller, tuple[Effect, ...]]:
    """One step with a memory that works: what is to be written is at once. All effects."""
    after, effects = take(state, event, now_s)
    for effect in effects:
        if isinstance(effect, Persist):
            after, more = take(after, Persisted(effect.memory), now_s)
            effects += more
    return after, effects


def fed(state: Controller, *events: Event, now_s: float = NOW) -> Controller:
    """The state after these events, all at ``now_s``, with a memory that works."""
    for event in events:
        state, _ = settled(state, event, now_s)
    return state


def alive(code: RuntimeCode = RuntimeCode.INHIBIT, epoch: int = 1, **changes: Any) -> HeartbeatReceived:
    """A fresh heartbeat of the runtime."""
    return replace(HeartbeatReceived(code, epoch, StopCause.NONE, fresh=True), **changes)


HOLD, RELEASE = InputsChanged(Inputs(device_pressed=True)), InputsChanged(Inputs(device_pressed=False))
EMERGENCY_STOP = InputsChanged(Inputs(device_pressed=True, emergency_stop_clear=False))
ACCEPTED_PATH = PathChecked(PATH.body(), Refusal.ACCEPTED, 0, ENDS)
STANDING = JointsMeasured(START_JOINTS)

OPENED = fed(POWERED_UP, opening(), alive())
LOADED = fed(OPENED, ACCEPTED_PATH, STANDING)
ASKED = fed(LOADED, NonceRequested(Purpose.PERMIT, PERMIT_NONCE))

PERMIT = records.Permit(
    nonce=PERMIT_NONCE,
    announce_nonce=ANNOUNCE_NONCE,
    session_digest=SESSION,
    serial="SIM-1",
    protocol_version=records.PROTOCOL_VERSION,
    epoch=1,
    limits_digest=records.digest(LIMITS.body()),
    calibration_digest=records.digest(CALIBRATION.body()),
    tool_digest=records.digest(TOOL.body()),
    path_digest=PATH.digest,
    registration_digest=REGISTRATION,
    configuration_digest=CONFIGURATION,
    verifier_version="cutgate test",
    start_joints_u=START_JOINTS,
    branch=records.Branch("right", 0, 1),
    approach=records.Approach(
        ENDS.entry_um, ENDS.exit_um, ENDS.entry_joints_u, ENDS.exit_joints_u, speed_percent=25
    ),
    lifetime_s=120,
    log=PERMIT_LOG,
)
START = records.Start(
    nonce=START_NONCE,
    epoch=1,
    session_digest=PERMIT.session_digest,
    permit_digest=records.digest(PERMIT.canonical()),
    start_joints_u=START_JOINTS,
    log=START_LOG,
)
RESET = records.Reset(
    nonce=RESET_NONCE, epoch=1, cause=StopCause.SECOND_NODE, session_digest=PERMIT.session_digest
)
ASKING, STARTING = PermitReceived(PERMIT, 4, authentic=True), StartReceived(START, 5, authentic=True)
"""What a holder of the key asks for next."""

PERMITTED = fed(ASKED, ASKING, alive(RuntimeCode.READY))
CYCLED = fed(PERMITTED, RELEASE, HOLD, NonceRequested(Purpose.START, START_NONCE))
STARTED = fed(CYCLED, STARTING)
CUTTING = fed(STARTED, alive(RuntimeCode.CUT))
DONE = fed(CUTTING, PathFinished())

LATCHED = fed(POWERED_UP, FaultArisen(StopCause.SECOND_NODE))
"""A latched fault without a session; epoch 1."""
OPEN_LATCHED = fed(LATCHED, opening(), alive(epoch=2))
"""A session with a latched controller; epoch 2."""
ACKNOWLEDGED = fed(OPEN_LATCHED, acknowledging(StopCause.SECOND_NODE, 2))
RESETTING = fed(ACKNOWLEDGED, NonceRequested(Purpose.RESET, RESET_NONCE))
OWN_RESET = replace(RESET, epoch=2)
LEAVING = ResetReceived(OWN_RESET, 6, authentic=True)

EVERY_STATE: dict[str, Controller] = {
    "powered up": POWERED_UP,
    "open": OPENED,
    "loaded": LOADED,
    "asked for a permit": ASKED,
    "permitted": PERMITTED,
    "device cycled": CYCLED,
    "started": STARTED,
    "cutting": CUTTING,
    "done": DONE,
    "latched": LATCHED,
    "latched, session open": OPEN_LATCHED,
    "acknowledged": ACKNOWLEDGED,
    "resetting": RESETTING,
    "stopped": fed(CUTTING, HOLD, FaultArisen(StopCause.BUS_FAILED)),
}
"""The controller in every state, each reached through the table."""

STOPPING_EVENTS: dict[str, tuple[Event, StopCause]] = {
    "stop frame": (StopReceived(StopCode.STOP, StopCause.OPERATOR_STOP), StopCause.OPERATOR_STOP),
    "stop without cause": (StopReceived(StopCode.STOP, StopCause.NONE), StopCause.PROTOCOL_VIOLATION),
    "claimed withdrawal": (
        StopReceived(StopCode.STOP, StopCause.REGISTRATION_WITHDRAWN),
        StopCause.PROTOCOL_VIOLATION,
    ),
    "claimed withdrawal as end": (
        StopReceived(StopCode.END, StopCause.REGISTRATION_WITHDRAWN),
        StopCause.PROTOCOL_VIOLATION,
    ),
    "stalled loop": (FaultArisen(StopCause.LOOP_STALLED), StopCause.LOOP_STALLED),
    "second node": (FaultArisen(StopCause.SECOND_NODE), StopCause.SECOND_NODE),
    "fault without cause": (FaultArisen(StopCause.NONE), StopCause.PROTOCOL_VIOLATION),
    "bone motion": (BoneMoved(), StopCause.BONE_MOVED),
    "limit changed": (LimitsChanged(OTHER_LIMITS.body()), StopCause.LIMITS_CHANGED),
    "emergency stop": (EMERGENCY_STOP, StopCause.EMERGENCY_STOP),
}
"""Every event that must stop whatever the state, and its cause."""

PERMIT_CASE = RequestCase(ASKED, PERMIT, NOW, authentic=True)
START_CASE = RequestCase(CYCLED, START, NOW, authentic=True)
RESET_CASE = RequestCase(RESETTING, OWN_RESET, NOW, authentic=True)


def changed(case: RequestCase, field: str, value: Any) -> RequestCase:
    """The case with one field altered."""
    twin: RequestCase = altered(case, field, value)
    return twin


RECEIVED: dict[type, Callable[[Any, int, bool], Event]] = {
    records.Permit: PermitReceived,
    records.Start: StartReceived,
    records.Reset: ResetReceived,
    records.Acknowledge: AcknowledgeReceived,
    records.Withdraw: WithdrawReceived,
}


def decide(case: RequestCase) -> tuple[Controller, tuple[Effect, ...]]:
    """What the table does with the case's request."""
    event = RECEIVED[type(case.request)](case.request, 9, case.authentic)
    return settled(case.controller, event, case.now_s)


def replies(effects: tuple[Effect, ...]) -> list[Refusal]:
    """The answers that leave."""
    return [
        effect.record.refusal
        for effect in effects
        if isinstance(effect, Send) and isinstance(effect.record, records.Reply)
    ]


def faults(effects: tuple[Effect, ...]) -> list[SendFault]:
    """The fault frames that leave."""
    return [effect for effect in effects if isinstance(effect, SendFault)]


def is_void(state: Controller) -> bool:
    """Nothing that could enable anything is left, and nothing moves."""
    return (
        state.permit is None
        and state.issued is None
        and (state.holdings.path, state.holdings.ends) == (None, None)
        and not (state.session is not None and state.session.live)
        and not state.may_move
        and not state.cut_ordered
        and not state.cutting_mode
    )


@cache
def _requests(
    epoch: int, nonce: bytes, given: records.Permit | None, session: tuple[bytes, bytes]
) -> tuple[records.Permit, records.Start, records.Reset]:
    """Permit, start and reset for this epoch, nonce and session; the start names the permit that was given."""
    digest, announced = session
    start = replace(START, nonce=nonce, epoch=epoch, session_digest=digest)
    if given is not None:
        start = replace(start, permit_digest=records.digest(given.canonical()))
    return (
        replace(PERMIT, nonce=nonce, epoch=epoch, session_digest=digest, announce_nonce=announced),
        start,
        replace(RESET, nonce=nonce, epoch=epoch, session_digest=digest),
    )


def events(state: Controller) -> list[Event]:
    """At least one of every kind of event, each as tempting as it can be in ``state``."""
    epoch, nonce = state.epoch, state.issued.nonce if state.issued else PERMIT_NONCE
    session = (state.session.digest, state.session.announce_nonce) if state.session else (SESSION, bytes(16))
    permit, start, reset = _requests(epoch, nonce, state.permit, session)
    return [
        reopening(state),
        replace(reopening(state), authentic=False),
        opening(),
        OpenReceived(records.OtherVersion(records.Open.TYPE, 3), 1, authentic=True, fresh=b"v" * 16),
        CollectReceived(),
        ACCEPTED_PATH,
        PathChecked(PATH.body(), Refusal.POSE_OUTSIDE_LIMITS, 1, None),
        *(NonceRequested(purpose, purpose.name.encode().ljust(16, b".")) for purpose in Purpose),
        PermitReceived(permit, 2, authentic=True),
        PermitReceived(permit, 2, authentic=False),
        StartReceived(start, 3, authentic=True),
        ResetReceived(reset, 4, authentic=True),
        acknowledging(state.cause, epoch),
        acknowledging(StopCause.OPERATOR_QUIT, epoch),
        acknowledging(state.cause, epoch, authentic=False),
        withdrawing(),
        withdrawing(records.NO_PLACE, 1),
        withdrawing(authentic=False),
        *(alive(code, epoch) for code in RuntimeCode),
        alive(RuntimeCode.CUT, epoch + 1),
        alive(RuntimeCode.CUT, epoch, fresh=False),
        alive(RuntimeCode.INHIBIT, epoch, cause=StopCause.AUDIT_FAILED),
        alive(RuntimeCode.INHIBIT, epoch, cause=StopCause.BONE_MOVED),
        HeartbeatLost(),
        StopReceived(StopCode.END, StopCause.SESSION_ENDED),
        HOLD,
        RELEASE,
        STANDING,
        JointsMeasured((0, *START_JOINTS[1:])),
        PathFinished(),
        Persisted(state.awaiting.memory if state.awaiting else state.memory),
        Persisted(replace(state.memory, latched=StopCause.NONE)),
        PersistFailed(),
        Tick(),
        *(event for event, _ in STOPPING_EVENTS.values()),
    ]
