"""Names for what both tables only compare: epochs, nonces, boots and sessions are the present one or an earlier one.

When the present one ceases to be it (``Passing``), everything else in the world that names it is renamed.
"""

from dataclasses import dataclass, replace
from enum import IntFlag, auto
from functools import cache
from typing import Any

from cutgate.firmware_sim import state as c
from cutgate.protocol import permit as permits
from cutgate.protocol import records
from cutgate.protocol.states import Purpose
from cutgate.runtime.interlock import state as r
from tests.firmware_sim.controllers import KEY

EPOCH, EARLIER_EPOCH = 10, 9
TOKEN = 5

LIVE, DEAD, GIVEN = (name.ljust(16, b".") for name in (b"live nonce", b"dead nonce", b"given now"))
"""The nonce that the controller has given and not taken back, every earlier one, and one as it is given."""
BOOT, EARLIER_BOOT = (name.ljust(16, b".") for name in (b"boot", b"earlier boot"))
RUNTIME_NONCE, EARLIER_NONCE = (name.ljust(16, b".") for name in (b"runtime", b"earlier runtime"))

SESSION = records.session_digest(BOOT, RUNTIME_NONCE)
"""The runtime's own with the present boot of the controller."""
EARLIER_SESSION = records.session_digest(BOOT, EARLIER_NONCE)
SESSION_OF_EARLIER_BOOT = records.session_digest(EARLIER_BOOT, RUNTIME_NONCE)
TAG, EARLIER_TAG = (records.session_tag(BOOT, nonce) for nonce in (RUNTIME_NONCE, EARLIER_NONCE))
TAG_OF_EARLIER_BOOT = records.session_tag(EARLIER_BOOT, RUNTIME_NONCE)


REGISTRATION, EARLIER_REGISTRATION = (records.digest(name) for name in (b"registration", b"earlier"))
"""The runtime's, and another one that the controller remembers."""


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


@cache
def signed(record: Any) -> Any:
    """With the real code of the one real key."""
    return permits.sign(KEY, record)


def rename_controller(state: c.Controller, passing: int) -> c.Controller:
    """The controller after the runtime's session has become an earlier one."""
    session = state.session
    if passing & Passing.SESSION and session is not None and session.digest == SESSION:
        state = replace(state, session=replace(session, tag=EARLIER_TAG, digest=EARLIER_SESSION))
    if passing & Passing.REGISTRATION:
        memory, session = state.memory, state.session
        state = replace(
            state,
            memory=_swap_memory(memory),
            written=_swap_memory(state.written) if state.written else None,
            session=replace(session, registration=SWAPPED[session.registration]) if session else None,
        )
    return replace(state, permit=rename_record(state.permit, passing)) if state.permit else state


SWAPPED = {REGISTRATION: EARLIER_REGISTRATION, EARLIER_REGISTRATION: REGISTRATION}


def _swap_memory(memory: c.Memory) -> c.Memory:
    swap = SWAPPED.__getitem__
    return replace(
        memory, named=frozenset(map(swap, memory.named)), withdrawn=frozenset(map(swap, memory.withdrawn))
    )


def rename_runtime(side: RuntimeSide | None, passing: int) -> RuntimeSide | None:
    """The runtime after what it names has ceased to be the controller's present epoch, nonce or boot."""
    if side is None:
        return None
    state = side.interlock
    view, session = state.controller, state.session
    if passing & Passing.BOOT and session is not None and session.boot_nonce == BOOT:
        session = replace(
            session, boot_nonce=EARLIER_BOOT, digest=SESSION_OF_EARLIER_BOOT, tag=TAG_OF_EARLIER_BOOT
        )
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
    """A permit, start or reset, signed anew if it was signed."""
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
        if passing & Passing.BOOT:
            changes["boot_nonce"] = EARLIER_BOOT
        if passing & Passing.REGISTRATION:
            changes["registration_digest"] = SWAPPED[record.registration_digest]
    if isinstance(record, records.Start):
        changes["permit_digest"] = digest_of(rename_record(PERMITS[record.permit_digest], passing))
    renamed = replace(record, **changes, mac=records.NO_MAC)
    if isinstance(renamed, records.Permit):
        digest_of(renamed)
    return renamed if record.mac == records.NO_MAC else signed(renamed)


def _epoch(epoch: int, passing: int) -> int:
    return EARLIER_EPOCH if passing & Passing.EPOCH and epoch == EPOCH else epoch


def _nonce(nonce: bytes, passing: int) -> bytes:
    return DEAD if passing & Passing.NONCE and nonce == LIVE else nonce


def without_registration(state: c.Controller) -> c.Controller:
    """The present registration is a new one, which the controller has never heard of."""

    def without(memory: c.Memory) -> c.Memory:
        new = {REGISTRATION}
        return replace(memory, named=memory.named - new, withdrawn=memory.withdrawn - new)

    return replace(
        state, memory=without(state.memory), written=without(state.written) if state.written else None
    )


STALE = Passing.EPOCH | Passing.NONCE | Passing.BOOT


def stale(state: r.Interlock) -> bool:
    """Whether the runtime's epoch or the boot it speaks with is an earlier one."""
    if state.session is None:
        return False
    return state.session.boot_nonce != BOOT or (state.epoch != EPOCH and state.phase is not r.Phase.OPENING)
