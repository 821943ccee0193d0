"""What anybody without the key can say: every unsigned record and frame, records of earlier times, forged ones.

Session tags, nonces and epochs can be read on the bus; a check value is no secret. Whatever carries no code is
therefore taken as said at any moment, with every content the tables tell apart, heartbeats proved young included.
What carries a code can only be repeated.
"""

from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from itertools import product
from typing import Any

from cutgate.firmware_sim import state as c
from cutgate.firmware_sim.reports import announcement
from cutgate.protocol import records
from cutgate.protocol.states import ControllerState, Purpose, Refusal, RuntimeCode, StopCause, StopCode
from cutgate.runtime.interlock import state as r
from tests.exploration.names import (
    BARRIER_US,
    CUT,
    DEAD,
    EARLIER_BARRIER_US,
    EARLIER_BOOT,
    EARLIER_EPOCH,
    EARLIER_NONCE,
    EARLIER_PLACE,
    EARLIER_REGISTRATION,
    EARLIER_SESSION,
    EPOCH,
    GIVEN,
    KINDS,
    LATELY_US,
    LIVE,
    NEXT_BOOT,
    OPEN,
    RUNTIME_NONCE,
    SESSION,
    SESSION_OF_EARLIER_BOOT,
    WITHDRAWS,
    Message,
    digest_of,
)
from tests.exploration.world import FLIPPED_PATH, OTHER_LIMITS, POWERED_UP, START_LOG, World
from tests.firmware_sim import controllers as fixed
from tests.runtime.interlock import builders


def causes(world: World) -> tuple[StopCause, ...]:
    """One of each class that occurs in this world."""
    found = (StopCause.NONE, StopCause.OPERATOR_STOP, StopCause.AUTHENTICATION_FAILED)
    found += (StopCause.BONE_MOVED,) if world.bone else ()
    return found + ((StopCause.EMERGENCY_STOP,) if world.emergency_stop else ())


# ---------------------------------------------------------------- to the runtime


STORED = r.UploadedPath(fixed.PATH.digest, Refusal.ACCEPTED, 0)
LIMITS = (builders.LIMITS, records.Limits.parse(OTHER_LIMITS))


def announced(boot: bytes) -> r.Announced:
    """A controller of this boot without a session, with the nonce the runtime draws for it."""
    return r.Announced(replace(announcement(POWERED_UP), announce_nonce=boot), RUNTIME_NONCE)


def unsigned_records() -> Iterable[r.Event]:
    """Every record that carries no code, as far as the table tells them apart."""
    for epoch in (EPOCH, EARLIER_EPOCH):
        yield r.SessionOpened(records.Opened(epoch, ControllerState.OPEN, StopCause.NONE), authentic=False)
        for purpose in Purpose:
            yield r.NonceReceived(purpose, DEAD, epoch)
    for record in (*LIMITS, builders.CALIBRATION, builders.TOOL):
        yield r.ParameterReceived(record)
    yield r.BlockConfirmed(0)
    yield r.PathConfirmed(STORED)
    yield r.PathConfirmed(replace(STORED, refusal=Refusal.POSE_OUTSIDE_LIMITS))
    yield r.PathConfirmed(replace(STORED, digest=bytes(32)))
    for kind in builders.REQUESTS:
        for refusal in (Refusal.ACCEPTED, Refusal.NOT_IN_STATE, Refusal.MAC_INVALID):
            yield r.ReplyReceived(kind.TYPE, refusal, StopCause.NONE)


def opened(world: World, epoch: int) -> Iterable[r.SessionOpened]:
    """What a controller may say as it opens the session: of its state, of logs and, where bones move, of the registration."""
    memories: list[dict[str, Any]] = [{}]
    memories += [{"log": START_LOG}] if world.warned else []
    if world.bone:
        memories += [
            {"withdrawal_due": 1},
            {"withdrawal_due": 1, "registration": Refusal.REGISTRATION_WITHDRAWN},
            {"registration": Refusal.REGISTRATION_WITHDRAWN, "barrier_us": BARRIER_US},
            {"registration": Refusal.REGISTRATION_TOO_EARLY, "barrier_us": BARRIER_US},
            {"barrier_us": EARLIER_BARRIER_US},
        ]
    stands = (StopCause.NONE, StopCause.BONE_MOVED) if world.bone else (StopCause.NONE,)
    for state, cause, memory in product((ControllerState.OPEN, ControllerState.FAULT), stands, memories):
        yield r.SessionOpened(records.Opened(epoch, state, cause, **memory), authentic=True)


TOLD = (ControllerState.PERMITTED, ControllerState.CUTTING, ControllerState.DONE)
"""What the runtime believes of the controller's heartbeat only once that has said it in this session."""


def heartbeats(causes: tuple[StopCause, ...], own_epoch: int) -> Iterable[r.HeartbeatReceived]:
    """Every heartbeat of a controller that it may have said in a session, but for those that only stop alike.

    In a session a controller has one epoch until it stops: what it said of ``TOLD`` has the runtime's own.
    """
    other = EARLIER_EPOCH if own_epoch == EPOCH else EPOCH
    for state, pressed, clear, fresh in product(ControllerState, *[(True, False)] * 3):
        mode = state in (ControllerState.PERMITTED, ControllerState.CUTTING)
        yield r.HeartbeatReceived(
            r.ControllerView(state, StopCause.NONE, own_epoch, pressed, clear, mode), fresh
        )
    for state, cause, clear, fresh in product(STOPPED, causes[1:], *[(True, False)] * 2):
        yield r.HeartbeatReceived(r.ControllerView(state, cause, own_epoch, False, clear, False), fresh)
    for state, cause in product(STOPPED, causes):
        yield r.HeartbeatReceived(r.ControllerView(state, cause, other, False, True, False), True)


STOPPED = (ControllerState.INHIBITED, ControllerState.OPEN, ControllerState.FAULT)

ONWARD, BEFORE = r.ProgressReported(1, 0), r.ProgressReported(0, 0)
"""Where an arm may be that has just started, and a place before that."""
TOO_FAR, NOWHERE = builders.BEYOND, r.ProgressReported(2, 0)
"""Where none can be so soon, and a segment that the path does not have."""


# ---------------------------------------------------------------- to the controller


def opens(world: World, announced: bytes) -> Iterable[c.OpenReceived]:
    """OPEN with any content under a wrong code, and those of earlier runtimes that were held back, for any registration."""
    yield c.OpenReceived(replace(OPEN, announce_nonce=announced), 1, authentic=False, fresh=NEXT_BOOT)
    if announced == NEXT_BOOT:  # which no runtime has heard of yet
        return
    held = replace(OPEN, runtime_nonce=EARLIER_NONCE)
    yield c.OpenReceived(held, 1, authentic=True, fresh=NEXT_BOOT)
    if world.bone:
        held = replace(held, registration_digest=EARLIER_REGISTRATION, place_digest=EARLIER_PLACE)
        yield c.OpenReceived(held, 1, authentic=True, fresh=NEXT_BOOT)
        yield c.OpenReceived(
            replace(held, registration_time_us=LATELY_US), 1, authentic=True, fresh=NEXT_BOOT
        )


def uploads(world: World) -> Iterable[c.PathChecked]:
    """A path, accepted or not by the controller's own check; in a world in which paths change another one as well."""
    yield c.PathChecked(fixed.PATH.body(), Refusal.ACCEPTED, 0, fixed.ENDS)
    yield c.PathChecked(fixed.PATH.body(), Refusal.POSE_OUTSIDE_LIMITS, 0, None)
    if world.limits:
        yield c.PathChecked(FLIPPED_PATH, Refusal.ACCEPTED, 0, fixed.ENDS)


def unsigned(causes: Iterable[StopCause]) -> Iterable[c.Event]:
    """Every record and frame that carries no code, as far as the table tells them apart."""
    for purpose in Purpose:
        yield c.NonceRequested(purpose, GIVEN)
    yield c.CollectReceived()
    for cause in causes:
        yield c.StopReceived(StopCode.STOP, cause)
        yield c.StopReceived(StopCode.END, cause)


def beats(causes: Iterable[StopCause]) -> Iterable[c.HeartbeatReceived]:
    """The runtime's heartbeats that may have been said in any session: all that order no motion and withdraw nothing.

    A stale CUT among them, and one of an earlier epoch.
    """
    for cause in causes:
        if cause is not StopCause.BONE_MOVED:
            for code, epoch, fresh in product(RuntimeCode, (EPOCH, EARLIER_EPOCH), (True, False)):
                beat = c.HeartbeatReceived(code, epoch, cause, fresh)
                if beat != CUT:
                    yield beat


def withdrawals(session: c.ControllerSession) -> Iterable[c.Event]:
    """What the session's runtime may have said of registrations, taken as said in every session, now or held back.

    A barrier before its own registration it tells in answer to an OPENED that says when the bone moved.
    """
    for named in product((session.place, records.NO_PLACE), (EARLIER_BARRIER_US, BARRIER_US)):
        yield c.WithdrawReceived(records.Withdraw(*named), 1, authentic=True)
    yield WITHDRAWS


def believed_by_a_fault(world: World) -> Iterable[c.HeartbeatReceived]:
    """What the controller's link lets through if it does not look at the tag, or if the tag is the same in every session."""
    if world.link in ("controller: tag", "controller: session"):
        yield CUT
    if world.link == "controller: tag" and world.bone:
        yield WITHDRAWS


@cache
def earlier_records(
    session: c.ControllerSession, issued: Purpose | None, latched: StopCause, *, exact: bool
) -> tuple[Message, ...]:
    """Permit, start and reset that serve no more for one reason alone; with more reasons they serve even less.

    Of an earlier session of this boot and of an earlier boot; unless ``exact``, also of this session with an earlier
    nonce, with an earlier epoch, and with a nonce given for something else.
    """
    foreign = EARLIER_SESSION if session.digest == SESSION else SESSION
    nonce = DEAD if exact else LIVE
    announced = session.announce_nonce
    names = [(foreign, announced, nonce, EPOCH), (SESSION_OF_EARLIER_BOOT, EARLIER_BOOT, nonce, EPOCH)]
    if not exact:
        names += [(session.digest, announced, DEAD, EPOCH), (session.digest, announced, LIVE, EARLIER_EPOCH)]
    found = [record for one in names for record in _records(session, latched, *one)]
    if not exact and issued is not None:
        others = _records(session, latched, session.digest, announced, LIVE, EPOCH)
        found += [one for one in others if KINDS[issued] is not type(one)]
    return tuple(Message(0, record, old=True) for record in found)


def _records(
    of: c.ControllerSession, latched: StopCause, session: bytes, announced: bytes, nonce: bytes, epoch: int
) -> list[Any]:
    names: dict[str, Any] = {"nonce": nonce, "session_digest": session, "epoch": epoch}
    permit = replace(fixed.PERMIT, announce_nonce=announced, registration_digest=of.registration, **names)
    accepted = replace(permit, nonce=DEAD)
    start = replace(fixed.START, permit_digest=digest_of(accepted), **names)
    return [permit, start, replace(fixed.RESET, cause=latched, **names)]


def present_records(
    session: c.ControllerSession, permit: records.Permit | None, latched: StopCause
) -> list[Any]:
    """Permit, start and reset for the present session, epoch and nonce, not signed."""
    new, start, reset = _records(session, latched, session.digest, session.announce_nonce, LIVE, EPOCH)
    return [new, replace(start, permit_digest=permit.digest) if permit else start, reset]


def forged(state: c.Controller) -> Iterable[c.Event]:
    """All that is signed, with the most tempting content, under a code that does not fit."""
    assert state.session is not None
    permit, start, reset = present_records(state.session, state.permit, state.memory.latched)
    yield c.PermitReceived(permit, 1, authentic=False)
    yield c.StartReceived(start, 1, authentic=False)
    yield c.ResetReceived(reset, 1, authentic=False)
    yield c.AcknowledgeReceived(records.Acknowledge(epoch=EPOCH, cause=state.cause), 1, authentic=False)
    yield c.WithdrawReceived(records.Withdraw(state.session.place, BARRIER_US), 1, authentic=False)
