"""Concrete states made canonical: what no decision depends on is forgotten.

The result is again a concrete state on which the real step functions run; nothing here decides anything.
``test_canonical.py`` compares what both tables do with the one and with the other.

* Clock values: every remembered moment becomes ``NOW``. That a deadline or lifetime has passed is an event.
* Causes: one for each class that either table tells apart (``cause_class``).
* What the last heartbeat said and where the arm stood, in phases after which nobody reads it.
* What the tracking monitor has seen: it has just begun. What deviates, and what does not, comes as an event.
* Tokens: the pending one becomes ``TOKEN``, an older one ``TOKEN - 1``.
"""

from dataclasses import replace

from cutgate.firmware_sim import state as c
from cutgate.protocol import records
from cutgate.protocol.states import LATCHING, WITHDRAWING, ControllerState, Refusal, StopCause
from cutgate.runtime.interlock import state as r
from cutgate.runtime.interlock.permissives import registration_stands
from cutgate.runtime.interlock.phases import AUTHORISING, ENDED
from cutgate.runtime.interlock.tracking import TrackingMonitor
from tests.exploration.invariants import HELD
from tests.exploration.names import (
    BARRIER_US,
    EPOCH,
    LATELY_US,
    LONG_AGO_US,
    REGISTERED_US,
    TOKEN,
    RuntimeSide,
)
from tests.exploration.world import JOB, MISSED, START_LOG, VERDICT
from tests.firmware_sim.controllers import START_JOINTS

NOW = 1000.0
MONITOR = TrackingMonitor.begin(VERDICT.trajectory, JOB.timing, JOB.tracking, 1.0, NOW)


def cause_class(cause: StopCause) -> StopCause:
    """The one cause that stands for all which both tables treat alike."""
    if cause in LATCHING:
        return StopCause.AUTHENTICATION_FAILED
    if cause in WITHDRAWING:
        return StopCause.BONE_MOVED
    return cause if cause in (StopCause.NONE, StopCause.EMERGENCY_STOP) else StopCause.OPERATOR_STOP


def standing(cause: StopCause) -> StopCause:
    """The same for a cause that stands, which is only named again; an emergency stop must also be clear."""
    return cause if cause in (StopCause.NONE, StopCause.EMERGENCY_STOP) else StopCause.OPERATOR_STOP


def withdrawing(cause: StopCause) -> StopCause:
    """The same for a cause that a later one is compared with, where that withdraws."""
    return cause_class(cause) if cause in WITHDRAWING else StopCause.NONE


def canonical_controller(state: c.Controller) -> c.Controller:
    """Without clock values and without what only a live session or a permit gives meaning."""
    live = state.session is not None and state.session.live
    memory = _canonical_memory(state.memory)
    return replace(
        state,
        cause=standing(state.cause),
        memory=memory,
        written=memory if state.written == state.memory else None,
        moved_at_s=None,
        session=_canonical_session(state) if state.session else None,
        awaiting=_canonical_awaiting(state.awaiting) if state.awaiting else None,
        issued=replace(state.issued, at_s=NOW) if state.issued else None,
        permit_issued_at_s=NOW if state.permit else 0.0,
        started_at_s=NOW if state.state is ControllerState.CUTTING else 0.0,
        measured_u=None,
        device=state.device if state.permit else c.DeviceCycle.UNSEEN,
        heartbeat_fresh=state.heartbeat_fresh and live,
    )


def taken_controller(state: c.Controller) -> c.Controller:
    """What may become so at any moment is taken as so already, and what is chosen at the permit is not kept before."""
    pressed = state.inputs.device_pressed and state.permit is not None
    return replace(
        state,
        heartbeat_fresh=state.session is not None and state.session.live,
        inputs=replace(state.inputs, device_pressed=pressed),
    )


def _canonical_session(state: c.Controller) -> c.ControllerSession:
    """Of its registration's time only counts on which side of the barrier it lies; a later barrier is later than all."""
    session, barrier_us = state.session, state.memory.barrier_us
    assert session is not None
    later = session.registration_time_us > barrier_us
    if barrier_us == BARRIER_US:
        time_us = LATELY_US if later else REGISTERED_US
    else:
        time_us = REGISTERED_US if later else LONG_AGO_US
    return replace(session, registration_time_us=time_us)


def _canonical_awaiting(awaiting: c.Awaiting) -> c.Awaiting:
    return replace(awaiting, memory=_canonical_memory(awaiting.memory))


def _canonical_memory(memory: c.Memory) -> c.Memory:
    """The log of the last start is only told on; it is the controller's own affair (``tests/firmware_sim``)."""
    return replace(memory, latched=standing(memory.latched), log=records.NO_TREE_HEAD)


def canonical_runtime(side: RuntimeSide) -> RuntimeSide | None:
    """Without clock values and reasons; None once the session has ended, for the process is gone."""
    state = side.interlock
    if state.phase in ENDED:
        return None
    if state.phase is r.Phase.STOPPING:
        state = r.Interlock(
            job=state.job,
            phase=state.phase,
            began_s=state.began_s,
            session=state.session,
            epoch=state.epoch,
            token=state.token,
            log=state.log,
            cause=cause_class(state.cause),
            stops_sent=frozenset(map(cause_class, state.stops_sent)),
            answer_due=state.answer_due,
            registration_withdrawn=state.registration_withdrawn,
            withdraw_due=state.withdraw_due,
            held_on=state.held_on,
            controller=state.controller,
        )
        side = replace(side, commits=())
    state = _canonical_view(state)
    state = replace(
        state,
        since_s=NOW,
        began_s=None if state.began_s is None else NOW,
        nonce_at_s=NOW if state.permit or state.nonce or state.verdict else 0.0,
        measured_s=NOW if state.joints_u else 0.0,
        joints_u=START_JOINTS if state.joints_u else None,
        tracking=MONITOR if state.tracking else None,
        nonce=state.nonce if state.phase in AUTHORISING else None,
        acknowledged=standing(state.acknowledged) if state.phase in HELD else StopCause.NONE,
        held_on=withdrawing(state.held_on),
        reason="",
        announced_version=None if state.session is None else records.PROTOCOL_VERSION,
        opened=_canonical_opened(state) if state.opened else None,
        barrier_us=records.NO_TIME,
        witness=MISSED if state.witness is not None and not state.witness.found else None,
    )
    return _canonical_tokens(state, side.commits)


def _canonical_opened(state: r.Interlock) -> records.Opened:
    """What it says of the registration: that it stands, or that it does not, which stays so for the session.

    State and epoch are looked at as OPENED comes, the cause until the controller lets go; a log that was found is as none.
    """
    assert state.opened is not None
    found = state.witness is not None and state.witness.found
    log = records.NO_TREE_HEAD if found or state.opened.log == records.NO_TREE_HEAD else START_LOG
    cause = withdrawing(state.opened.cause) if state.phase in HELD else StopCause.NONE
    said = records.Opened(EPOCH, ControllerState.OPEN, cause, log=log)
    if registration_stands(replace(state, registration_withdrawn=False), NOW).holds:
        return said
    return replace(said, registration=Refusal.REGISTRATION_WITHDRAWN)


STOOD = r.ControllerView(ControllerState.OPEN, StopCause.NONE, EPOCH, False, True, False)
"""Before a stop, no cause stood."""


def _canonical_view(state: r.Interlock) -> r.Interlock:
    """What the last heartbeat said, as far as this phase or a later one looks at it.

    The device and the permitted state count from the permit on, and once the arm moves only what comes next counts.
    """
    view = state.controller
    if state.phase in (r.Phase.CUTTING, r.Phase.FINISHING, r.Phase.STOPPING) or view is None:
        kept = STOOD if view is not None and view.cause is StopCause.NONE else None
        return replace(state, controller=kept, device=r.DeviceCycle.UNSEEN, heartbeat_fresh=False)
    view = replace(view, cause=standing(view.cause))
    if state.phase in BEFORE_PERMIT:
        latched = view.state is ControllerState.FAULT
        seen = view.state if latched else ControllerState.LOADED
        view = replace(view, state=seen, device_pressed=False, cutting_mode=False)
    device = state.device if state.phase in DEVICE_COUNTS else r.DeviceCycle.UNSEEN
    return replace(state, controller=view, device=device)


P = r.Phase
DEVICE_COUNTS = frozenset({P.PERMITTED, P.NONCE_START, P.AUTHORISING_START, P.STARTING})
BEFORE_PERMIT = frozenset(P) - ENDED - DEVICE_COUNTS - {P.PERMITTING, P.CUTTING, P.FINISHING, P.STOPPING}


def _canonical_tokens(state: r.Interlock, commits: tuple[r.Commit, ...]) -> RuntimeSide:
    """The newest token is ``TOKEN``; of the older records still being written the newest one is kept, as TOKEN - 1."""
    pending = [replace(commit, token=TOKEN) for commit in commits if commit.token == state.token]
    older = [commit for commit in commits if commit.token != state.token]
    older = [replace(commit, token=TOKEN - 1) for commit in older[-1:]]
    return RuntimeSide(replace(state, token=TOKEN), tuple(older + pending))
