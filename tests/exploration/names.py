"""Names for what both tables only compare: epochs, nonces, boots and sessions are the present one or an earlier one.

When the present one ceases to be it (``Passing``), everything else in the world that names it is renamed.
"""

from dataclasses import dataclass, replace
from enum import IntFlag, auto
from functools import cache
from typing import Any

from cutgate.firmware_sim import state as c
from cutgate.protocol import records
from cutgate.protocol.states import ControllerState, Purpose, RuntimeCode, StopCause
from cutgate.runtime.interlock import state as r
from tests.firmware_sim import controllers as fixed

EPOCH, EARLIER_EPOCH = 10, 9
TOKEN = 5

LIVE, DEAD, GIVEN = (name.ljust(16, b".") for name in (b"live nonce", b"dead nonce", b"given now"))
"""The nonce that the controller has given and not taken back, every earlier one, and one as it is given."""
BOOT, EARLIER_BOOT, NEXT_BOOT = (name.ljust(16, b".") for name in (b"announced", b"earlier", b"next"))
"""Announce nonces: that which the runtime's OPEN names, every earlier one, and the next one once that is used up."""
RUNTIME_NONCE, EARLIER_NONCE = (name.ljust(16, b".") for name in (b"runtime", b"earlier runtime"))

REGISTRATION, EARLIER_REGISTRATION = (records.digest(name) for name in (b"registration", b"earlier"))
PLACE, EARLIER_PLACE = (records.digest(name) for name in (b"place", b"earlier place"))
"""The runtime's, and another one that the controller remembers."""
LONG_AGO_US, EARLIER_BARRIER_US, REGISTERED_US, BARRIER_US, LATELY_US = (
    second * 1_000_000 for second in (10, 20, 30, 40, 50)
)
"""Times are only compared: the runtime's registration lies between an earlier barrier and one that is told from now on."""

OPEN = replace(
    fixed.OPEN,
    announce_nonce=BOOT,
    runtime_nonce=RUNTIME_NONCE,
    registration_digest=REGISTRATION,
    place_digest=PLACE,
    registration_time_us=REGISTERED_US,
)
"""The runtime's own, for what the controller announces."""
OPEN_OF_EARLIER_BOOT = replace(OPEN, announce_nonce=EARLIER_BOOT)
SESSION, SESSION_OF_EARLIER_BOOT = map(records.session_digest, (OPEN, OPEN_OF_EARLIER_BOOT))
EARLIER_SESSION = records.session_digest(
    replace(OPEN, announce_nonce=EARLIER_BOOT, runtime_nonce=EARLIER_NONCE)
)
TAG, EARLIER_TAG, TAG_OF_EARLIER_BOOT = map(
    records.session_tag, (SESSION, EARLIER_SESSION, SESSION_OF_EARLIER_BOOT)
)


class Passing(IntFlag):
    """What ceases to be the present one."""

    STOP = auto()
    """What was sent until now was sent before a stop."""
    EPOCH = auto()
    NONCE = auto()
    BOOT = auto()
    SESSION = auto()
    REGISTRATION = auto()
    """The present one and the earlier one have changed places."""
    NEW = auto()
    """The present registration is a new one, later than every barrier."""
    OLD = auto()
    """The present registration is not later than the barrier, whichever that is."""
    AGED = auto()
    """A time-out has passed: what the runtime's heartbeat said before is no longer fresh."""
    OPENED = auto()
    """The runtime's OPEN has opened."""


@dataclass(frozen=True)
class Message:
    """A record or frame: its session's tag, 0 outside one; ``old``: sent before a stop of the controller."""

    tag: int
    content: Any
    old: bool = False


@dataclass(frozen=True)
class RuntimeSide:
    """The interlock with the records that are on their way to the disk."""

    interlock: r.Interlock
    commits: tuple[r.Commit, ...] = ()


KINDS = {Purpose.PERMIT: records.Permit, Purpose.START: records.Start, Purpose.RESET: records.Reset}

PERMITS: dict[bytes, records.Permit] = {}
"""The permit behind each digest that a start can name."""


def digest_of(permit: records.Permit) -> bytes:
    """What a start names; remembers the permit behind it."""
    return PERMITS.setdefault(permit.digest, permit) and permit.digest


CUT = c.HeartbeatReceived(RuntimeCode.CUT, EPOCH, StopCause.NONE, fresh=True)
WITHDRAWS = c.HeartbeatReceived(RuntimeCode.INHIBIT, EARLIER_EPOCH, StopCause.BONE_MOVED, fresh=True)
"""What the runtime's heartbeat must have said for it to be believed; all else of it only stops."""


@dataclass(frozen=True)
class Told:
    """The controller's heartbeat has said this of its state in the runtime's session."""

    state: ControllerState


@dataclass(frozen=True)
class Quiet:
    """No heartbeat that says CUT is still fresh; ``stale``: one that was said in this session has aged."""

    stale: bool = False


def rename_controller(state: c.Controller, passing: int) -> c.Controller:
    """The controller after the runtime's session has become an earlier one, or its registration another one."""
    session = state.session
    if passing & (Passing.SESSION | Passing.BOOT):
        state = replace(state, announce_nonce=BOOT)
        if session is not None and session.digest == SESSION:
            session = replace(session, tag=EARLIER_TAG, digest=EARLIER_SESSION, announce_nonce=EARLIER_BOOT)
    if passing & Passing.REGISTRATION and session is not None:
        session = replace(session, registration=SWAPPED[session.registration], place=SWAPPED[session.place])
    if session is not None:
        session = replace(session, registration_time_us=_time(session.registration_time_us, state, passing))
    return replace(
        state,
        session=session,
        memory=_rename_memory(state.memory, passing),
        written=_rename_memory(state.written, passing) if state.written else None,
        permit=rename_record(state.permit, passing) if state.permit else None,
        awaiting=_rename_awaiting(state.awaiting, passing) if state.awaiting else None,
    )


def _rename_awaiting(awaiting: c.Awaiting, passing: int) -> c.Awaiting:
    """Only a Withdraw waits from one step to the next."""
    event, memory = awaiting.event, _rename_memory(awaiting.memory, passing)
    assert isinstance(event, c.WithdrawReceived)
    return c.Awaiting(replace(event, withdraw=rename_record(event.withdraw, passing)), memory)


SWAPPED = {
    REGISTRATION: EARLIER_REGISTRATION,
    EARLIER_REGISTRATION: REGISTRATION,
    PLACE: EARLIER_PLACE,
    EARLIER_PLACE: PLACE,
    records.NO_PLACE: records.NO_PLACE,
}


def _time(time_us: int, state: c.Controller, passing: int) -> int:
    """A session's registration stays on its side of the barrier as that gets its new name."""
    barrier_us = state.memory.barrier_us
    if passing & Passing.NEW and barrier_us == BARRIER_US:
        return REGISTERED_US if time_us > BARRIER_US else LONG_AGO_US
    if passing & Passing.OLD and barrier_us == EARLIER_BARRIER_US:
        return LATELY_US if time_us > EARLIER_BARRIER_US else time_us
    return time_us


def _barrier(barrier_us: int, passing: int) -> int:
    if passing & Passing.NEW and barrier_us == BARRIER_US:
        return EARLIER_BARRIER_US
    if passing & Passing.OLD and barrier_us == EARLIER_BARRIER_US:
        return BARRIER_US
    return barrier_us


def _rename_memory(memory: c.Memory, passing: int) -> c.Memory:
    withdrawn = memory.withdrawn
    if passing & Passing.REGISTRATION:
        withdrawn = frozenset(map(SWAPPED.__getitem__, withdrawn))
    if passing & Passing.NEW:
        withdrawn -= {PLACE}
    return replace(memory, withdrawn=withdrawn, barrier_us=_barrier(memory.barrier_us, passing))


def rename_runtime(side: RuntimeSide | None, passing: int) -> RuntimeSide | None:
    """The runtime after what it names has ceased to be the controller's present epoch, nonce or boot."""
    if side is None:
        return None
    state = side.interlock
    view, session = state.controller, state.session
    if passing & Passing.BOOT and session is not None and session.announce_nonce == BOOT:
        session = replace(session, request=replace(session.request, announce_nonce=EARLIER_BOOT))
    renamed = replace(
        state,
        epoch=_epoch(state.epoch, passing),
        nonce=_nonce(state.nonce, passing) if state.nonce else None,
        permit=rename_record(state.permit, passing) if state.permit else None,
        controller=replace(view, epoch=_epoch(view.epoch, passing)) if view else None,
        session=session,
    )
    commits = (replace(one, record=rename_record(one.record, passing)) for one in side.commits)
    return RuntimeSide(renamed, tuple(commits))


def rename_message(message: Message, passing: int) -> Message:
    """What was sent, after that."""
    tag, content = message.tag, message.content
    if passing & Passing.SESSION and tag == TAG:
        tag = EARLIER_TAG
    if isinstance(content, records.Open):
        return Message(tag, content, message.old or bool(passing & Passing.OPENED))
    if isinstance(content, records.SignedRecord):
        old = message.old or bool(passing & Passing.STOP)
        return Message(tag, rename_record(content, passing), old)
    return Message(tag, _rename_frame(content, passing), message.old)


def _rename_frame(content: Any, passing: int) -> Any:
    """An unsigned record or frame."""
    if isinstance(content, r.HeartbeatReceived):
        return replace(content, view=replace(content.view, epoch=_epoch(content.view.epoch, passing)))
    changes: dict[str, Any] = {}
    if hasattr(content, "epoch"):
        changes["epoch"] = _epoch(content.epoch, passing)
    if isinstance(content, records.Nonce):
        changes["nonce"] = _nonce(content.nonce, passing)
    return replace(content, **changes) if changes else content


@cache
def rename_record(record: Any, passing: int) -> Any:
    """A signed record."""
    if isinstance(record, records.Withdraw):
        place = SWAPPED[record.place_digest] if passing & Passing.REGISTRATION else record.place_digest
        return records.Withdraw(place, _barrier(record.barrier_us, passing))
    if isinstance(record, records.Opened | records.Acknowledge):
        return replace(record, epoch=_epoch(record.epoch, passing))
    sessions = {}
    if passing & Passing.SESSION:
        sessions[SESSION] = EARLIER_SESSION
    if passing & Passing.BOOT:
        sessions[SESSION] = SESSION_OF_EARLIER_BOOT
    changes: dict[str, Any] = {
        "epoch": _epoch(record.epoch, passing),
        "nonce": _nonce(record.nonce, passing),
        "session_digest": sessions.get(record.session_digest, record.session_digest),
    }
    if isinstance(record, records.Permit):
        if passing & (Passing.BOOT | Passing.SESSION):
            changes["announce_nonce"] = EARLIER_BOOT
        if passing & Passing.REGISTRATION:
            changes["registration_digest"] = SWAPPED[record.registration_digest]
    if isinstance(record, records.Start):
        changes["permit_digest"] = digest_of(rename_record(PERMITS[record.permit_digest], passing))
    renamed = replace(record, **changes)
    if isinstance(renamed, records.Permit):
        digest_of(renamed)
    return renamed


def _epoch(epoch: int, passing: int) -> int:
    return EARLIER_EPOCH if passing & Passing.EPOCH and epoch == EPOCH else epoch


def _nonce(nonce: bytes, passing: int) -> bytes:
    return DEAD if passing & Passing.NONCE and nonce == LIVE else nonce


def is_past(side: RuntimeSide | None) -> bool:
    """Whether nothing that the runtime says counts any more: it is stopping, or speaks in an earlier epoch or boot."""
    if side is None or side.interlock.session is None or side.interlock.phase is r.Phase.OPENING:
        return False
    return side.interlock.phase is r.Phase.STOPPING or stale(side.interlock)


STALE = Passing.EPOCH | Passing.NONCE | Passing.BOOT


def stale(state: r.Interlock) -> bool:
    """Whether the runtime's epoch or the boot it speaks with is an earlier one."""
    if state.session is None:
        return False
    return state.session.announce_nonce != BOOT or (
        state.epoch != EPOCH and state.phase is not r.Phase.OPENING
    )
