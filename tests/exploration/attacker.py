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
from cutgate.protocol import records
from cutgate.protocol.states import ControllerState, Purpose, Refusal, RuntimeCode, StopCause, StopCode
from cutgate.runtime.interlock import state as r
from tests.exploration.names import (
    BOOT,
    DEAD,
    EARLIER_BOOT,
    EARLIER_EPOCH,
    EARLIER_NONCE,
    EARLIER_REGISTRATION,
    EARLIER_SESSION,
    EPOCH,
    GIVEN,
    KINDS,
    LIVE,
    REGISTRATION,
    RUNTIME_NONCE,
    SESSION,
    SESSION_OF_EARLIER_BOOT,
    Message,
    digest_of,
    signed,
)
from tests.exploration.world import FLIPPED_PATH, OTHER_LIMITS, World
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
    return r.Announced(replace(builders.ANNOUNCE, boot_nonce=boot), RUNTIME_NONCE)


def unsigned_records() -> Iterable[r.Event]:
    """Every record that carries no code, as far as the table tells them apart."""
    for epoch in (EPOCH, EARLIER_EPOCH):
        yield r.SessionOpened(epoch, ControllerState.OPEN, StopCause.NONE)
        yield r.SessionOpened(epoch, ControllerState.FAULT, StopCause.NONE)
        for purpose in Purpose:
            yield r.NonceReceived(purpose, DEAD, epoch)
    for record in (*LIMITS, builders.CALIBRATION, builders.TOOL):
        yield r.ParameterReceived(record)
    yield r.BlockConfirmed(0)
    yield r.PathConfirmed(STORED)
    yield r.PathConfirmed(replace(STORED, refusal=Refusal.POSE_OUTSIDE_LIMITS))
    yield r.PathConfirmed(replace(STORED, digest=bytes(32)))
    for kind in (records.Open, records.Permit, records.Start, records.Reset, records.Acknowledge):
        for refusal in (Refusal.ACCEPTED, Refusal.NOT_IN_STATE, Refusal.MAC_INVALID):
            yield r.ReplyReceived(kind.TYPE, refusal, StopCause.NONE, device_pressed=False)
            yield r.ReplyReceived(kind.TYPE, refusal, StopCause.NONE, device_pressed=True)


def heartbeats(causes: tuple[StopCause, ...]) -> Iterable[r.HeartbeatReceived]:
    """Every heartbeat of a controller, as far as the table tells them apart: a cause, or another epoch, comes first."""
    for state, pressed, clear, fresh in product(ControllerState, *[(True, False)] * 3):
        mode = state in (ControllerState.PERMITTED, ControllerState.CUTTING)
        yield r.HeartbeatReceived(r.ControllerView(state, StopCause.NONE, EPOCH, pressed, clear, mode), fresh)
    for state, cause, clear, fresh in product(STOPPED, causes[1:], *[(True, False)] * 2):
        yield r.HeartbeatReceived(r.ControllerView(state, cause, EPOCH, False, clear, False), fresh)
    for state, cause in product(STOPPED, causes):
        yield r.HeartbeatReceived(r.ControllerView(state, cause, EARLIER_EPOCH, False, True, False), True)


STOPPED = (ControllerState.INHIBITED, ControllerState.OPEN, ControllerState.FAULT)

ONWARD, BEFORE = r.ProgressReported(1, 0), r.ProgressReported(0, 0)
"""Where an arm may be that has just started, and a place before that."""
TOO_FAR, NOWHERE = builders.BEYOND, r.ProgressReported(2, 0)
"""Where none can be so soon, and a segment that the path does not have."""


# ---------------------------------------------------------------- to the controller


def opens(world: World) -> Iterable[c.OpenReceived]:
    """Opens an earlier session of this boot again, or one with a nonce of his own, for any registration."""
    earlier = replace(fixed.OPEN, boot_nonce=BOOT, runtime_nonce=EARLIER_NONCE)
    for registration in (REGISTRATION, EARLIER_REGISTRATION)[: 1 + world.bone]:
        yield c.OpenReceived(replace(earlier, registration_digest=registration), 1)


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
        yield c.AcknowledgeReceived(cause, 1)
        yield c.StopReceived(StopCode.STOP, cause)
        yield c.StopReceived(StopCode.END, cause)
        for code in RuntimeCode:
            for epoch in (EPOCH, EARLIER_EPOCH):
                yield c.HeartbeatReceived(code, epoch, cause, fresh=True)
                yield c.HeartbeatReceived(code, epoch, cause, fresh=False)


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
    names = [(foreign, BOOT, nonce, EPOCH), (SESSION_OF_EARLIER_BOOT, EARLIER_BOOT, nonce, EPOCH)]
    if not exact:
        names += [(session.digest, BOOT, DEAD, EPOCH), (session.digest, BOOT, LIVE, EARLIER_EPOCH)]
    found = [record for one in names for record in _records(session, latched, *one)]
    if not exact and issued is not None:
        others = _records(session, latched, session.digest, BOOT, LIVE, EPOCH)
        found += [one for one in others if KINDS[issued] is not type(one)]
    return tuple(Message(0, signed(record), old=True) for record in found)


def _records(
    of: c.ControllerSession, latched: StopCause, session: bytes, boot: bytes, nonce: bytes, epoch: int
) -> list[Any]:
    names: dict[str, Any] = {"nonce": nonce, "session_digest": session, "epoch": epoch}
    permit = replace(fixed.PERMIT, boot_nonce=boot, registration_digest=of.registration, **names)
    accepted = replace(permit, nonce=DEAD)
    start = replace(fixed.START, permit_digest=digest_of(accepted), **names)
    return [permit, start, replace(fixed.RESET, cause=latched, **names)]


def present_records(
    session: c.ControllerSession, permit: records.Permit | None, latched: StopCause
) -> list[Any]:
    """Permit, start and reset for the present session, epoch and nonce, not signed."""
    new, start, reset = _records(session, latched, session.digest, BOOT, LIVE, EPOCH)
    return [new, replace(start, permit_digest=permit.digest) if permit else start, reset]


@cache
def forged_records(
    session: c.ControllerSession, permit: records.Permit | None, latched: StopCause
) -> tuple[Message, ...]:
    """The same with a wrong code: all that they name can be read on the bus."""
    forged = (one.with_mac(bytes(15) + b"x") for one in present_records(session, permit, latched))
    return tuple(Message(0, record) for record in forged)
