"""Concrete states made canonical: what no decision depends on is forgotten, names are reused by recency.

The result is again a concrete state on which the real step functions run; nothing here decides anything.

* Clock values: every remembered moment becomes ``NOW``. That a deadline or lifetime has passed is an event (``model``).
* Causes: one for each class that either table tells apart (``cause_class``).
* Epochs: the controller's becomes ``EPOCH``; older ones keep their order, in ranks below it. Both tables only compare
  epochs for equality, and only the controller counts them.
* Nonces: a name is given again as soon as nothing refers to it (``model``); one that neither side knows any more
  can never match again and is ``DEAD_NONCE``.
* Tokens: the pending one becomes ``TOKEN``, an older one ``TOKEN - 1``.
"""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from firmware_sim import state as c
from protocol import permit as permits
from protocol import records
from protocol.states import LATCHING, ControllerState, Purpose, StopCause
from runtime.interlock import state as r
from runtime.interlock.table import AUTHORISING
from tests.firmware_sim.controllers import KEY, START_JOINTS

NOW = 1000.0
EPOCH = 10
TOKEN = 5
GENERATIONS = 6

DEAD_NONCE = b"dead".ljust(16, b".")
NONCES: dict[bytes, int] = {
    f"{purpose.name} {generation}".encode().ljust(16, b"."): 1 << (GENERATIONS * (purpose - 1) + generation)
    for purpose in Purpose
    for generation in range(GENERATIONS)
}
"""Every nonce the controller may give, and its bit in a set of nonces."""

Renaming = tuple[tuple[int, int], ...]
"""(old, new) of every epoch that changes."""

PERMITS: dict[bytes, records.Permit] = {}
"""The permit behind each digest that a start can name."""


@dataclass(frozen=True)
class Message:
    """One record or frame on the bus: its session's tag, 0 outside one; ``old``: sent before a stop of the controller."""

    tag: int
    content: Any
    old: bool = False


@dataclass(frozen=True)
class RuntimeSide:
    """The interlock with the records that are on their way to the disk."""

    interlock: r.Interlock
    commits: tuple[r.Commit, ...] = ()


def cause_class(cause: StopCause) -> StopCause:
    """The one cause that stands for all which both tables treat alike."""
    if cause in LATCHING:
        return StopCause.AUTHENTICATION_FAILED
    if cause in (StopCause.BONE_MOVED, StopCause.REGISTRATION_WITHDRAWN):
        return StopCause.BONE_MOVED
    return cause if cause in (StopCause.NONE, StopCause.EMERGENCY_STOP) else StopCause.OPERATOR_STOP


def canonical_controller(state: c.Controller) -> c.Controller:
    """Without clock values and without what only a live session or a permit gives meaning."""
    live = state.session is not None and state.session.live
    memory = replace(state.memory, latched=cause_class(state.memory.latched))
    return replace(
        state,
        cause=cause_class(state.cause),
        memory=memory,
        written=memory,
        issued=replace(state.issued, at_s=NOW) if state.issued else None,
        permit_issued_at_s=NOW if state.permit else 0.0,
        started_at_s=NOW if state.state is ControllerState.CUTTING else 0.0,
        measured_u=None,
        device=state.device if state.permit else c.DeviceCycle.UNSEEN,
        heartbeat_fresh=state.heartbeat_fresh and live,
    )


def canonical_runtime(side: RuntimeSide) -> RuntimeSide | None:
    """Without clock values and reasons; None once the session has ended, for the process is gone."""
    state = side.interlock
    if state.phase in r.ENDED:
        return None
    if state.phase is r.Phase.STOPPING:
        state = r.Interlock(
            job=state.job,
            phase=state.phase,
            session=state.session,
            epoch=state.epoch,
            token=state.token,
            log=state.log,
            cause=cause_class(state.cause),
            stops_sent=frozenset(map(cause_class, state.stops_sent)),
            answer_due=state.answer_due,
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
        nonce=state.nonce if state.phase in AUTHORISING else None,
        acknowledged=state.acknowledged if state.phase in HELD else StopCause.NONE,
        reason="",
    )
    return _canonical_tokens(state, side.commits)


def _canonical_view(state: r.Interlock) -> r.Interlock:
    """What the last heartbeat said, as far as this phase or a later one looks at it.

    The device and the permitted state count from the permit on, and once the arm moves only what comes next counts.
    """
    view = state.controller
    if state.phase in (r.Phase.CUTTING, r.Phase.FINISHING) or view is None:
        return replace(state, controller=None, device=r.DeviceCycle.UNSEEN, heartbeat_fresh=False)
    view = replace(view, cause=cause_class(view.cause))
    if state.phase in BEFORE_PERMIT:
        latched = view.state is ControllerState.FAULT
        seen = view.state if latched else ControllerState.LOADED
        view = replace(view, state=seen, device_pressed=False, cutting_mode=False)
    device = state.device if state.phase in DEVICE_COUNTS else r.DeviceCycle.UNSEEN
    return replace(state, controller=view, device=device)


P = r.Phase
HELD = frozenset({P.HELD, P.NONCE_RESET, P.AUTHORISING_RESET, P.RESETTING})
"""Where the acknowledged cause is what a reset will name."""
DEVICE_COUNTS = frozenset({P.PERMITTED, P.NONCE_START, P.AUTHORISING_START, P.STARTING})
BEFORE_PERMIT = frozenset(P) - r.ENDED - DEVICE_COUNTS - {P.PERMITTING, P.CUTTING, P.FINISHING, P.STOPPING}


def _canonical_tokens(state: r.Interlock, commits: tuple[r.Commit, ...]) -> RuntimeSide:
    """The newest token is ``TOKEN``; of the older records still being written the newest one is kept, as TOKEN - 1."""
    pending = [replace(commit, token=TOKEN) for commit in commits if commit.token == state.token]
    older = [commit for commit in commits if commit.token != state.token]
    older = [replace(commit, token=TOKEN - 1) for commit in older[-1:]]
    return RuntimeSide(replace(state, token=TOKEN), tuple(older + pending))


# ---------------------------------------------------------------- names of epochs and nonces


def epochs_of(thing: Any) -> int:
    """The epochs something names, as a set of bits."""
    return sum(1 << epoch for epoch in set(_epochs(thing)))


def _epochs(thing: Any) -> list[int]:
    match thing:
        case None:
            return []
        case c.Controller():
            return [thing.epoch]
        case RuntimeSide(interlock=state, commits=commits):
            known = [state.epoch] if state.session and state.phase not in BEFORE_EPOCH else []
            viewed = [state.controller.epoch] if state.controller else []
            return known + viewed + [epoch for commit in commits for epoch in _epochs(commit.record)]
        case Message():
            return _epochs(thing.content)
        case r.HeartbeatReceived():
            return [thing.view.epoch]
        case _:
            return [thing.epoch] if hasattr(thing, "epoch") else []


BEFORE_EPOCH = frozenset({r.Phase.WAITING, r.Phase.OPENING})


def nonces_of(thing: Any) -> int:
    """The nonces something names, as a set of bits."""
    found = 0
    match thing:
        case c.Controller():
            named: list[Any] = [thing.issued, thing.permit]
        case RuntimeSide(interlock=state, commits=commits):
            found = NONCES.get(state.nonce or b"", 0)
            named = [state.permit, *(commit.record for commit in commits)]
        case Message():
            named = [thing.content]
        case _:
            named = []
    for one in named:
        found |= NONCES.get(getattr(one, "nonce", b"") or b"", 0)
    return found


def rename(thing: Any, epochs: Renaming, dead: int = 0) -> Any:
    """The same with other epochs, and with DEAD_NONCE for the nonces in ``dead``. Signed records are signed anew."""
    new = dict(epochs)
    match thing:
        case None:
            return None
        case c.Controller():
            return replace(
                thing, epoch=new.get(thing.epoch, thing.epoch), permit=rename(thing.permit, epochs)
            )
        case RuntimeSide(interlock=state, commits=commits):
            view = state.controller
            renamed = replace(
                state,
                epoch=new.get(state.epoch, state.epoch),
                permit=rename(state.permit, epochs),
                controller=replace(view, epoch=new.get(view.epoch, view.epoch)) if view else None,
            )
            return RuntimeSide(
                renamed, tuple(replace(one, record=rename(one.record, epochs)) for one in commits)
            )
        case Message():
            return replace(thing, content=rename(thing.content, epochs, dead))
        case r.HeartbeatReceived():
            view = thing.view
            return replace(thing, view=replace(view, epoch=new.get(view.epoch, view.epoch)))
        case records.SignedRecord():
            return _rename_signed(thing, epochs, dead)
        case _ if hasattr(thing, "epoch"):
            return replace(thing, epoch=new.get(thing.epoch, thing.epoch))
    return thing


@cache
def _rename_signed(record: Any, epochs: Renaming, dead: int) -> Any:
    changes: dict[str, Any] = {"epoch": dict(epochs).get(record.epoch, record.epoch)}
    if NONCES.get(record.nonce, 0) & dead:
        changes["nonce"] = DEAD_NONCE
    if isinstance(record, records.Start):
        changes["permit_digest"] = digest_of(_rename_signed(PERMITS[record.permit_digest], epochs, 0))
    renamed = replace(record, **changes, mac=records.NO_MAC)
    return renamed if record.mac == records.NO_MAC else signed(renamed)


def digest_of(permit: records.Permit) -> bytes:
    """What a start names; remembers the permit behind it."""
    return PERMITS.setdefault(permit.digest, permit) and permit.digest


@cache
def signed(record: Any) -> Any:
    """With the real code of the one real key."""
    return permits.sign(KEY, record)


@cache
def ranks(epochs: int, current: int) -> Renaming:
    """The controller's epoch becomes EPOCH, older ones follow below it in their order."""
    older = [epoch for epoch in range(EPOCH + 2) if epochs >> epoch & 1 and epoch != current]
    new = {current: EPOCH} | {epoch: EPOCH - 1 - rank for rank, epoch in enumerate(reversed(older))}
    return tuple((old, fresh) for old, fresh in sorted(new.items()) if old != fresh)
