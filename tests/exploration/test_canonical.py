"""What a state is made canonical by loses nothing: the real tables do the same with the raw state, under every event.

Raw states are met on random walks that leave the straight way to the cut at every place, with real clocks, causes,
epochs, nonces and tokens. Where the canonical state stands for several, the event is translated with it.
"""

import random
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product
from typing import Any

import pytest

import cutgate.firmware_sim.table
import cutgate.runtime.interlock.table
from cutgate.firmware_sim import state as c
from cutgate.protocol import records
from cutgate.protocol.states import EPOCHS, WITHDRAWING, ControllerState, StopCause
from cutgate.runtime.interlock import state as r
from cutgate.runtime.interlock.tracking import TrackingMonitor
from tests.exploration import attacker, canonical, controller_side, invariants, runtime_side
from tests.exploration.canonical import NOW, cause_class, standing
from tests.exploration.exact import Pair, left_out, met_exactly
from tests.exploration.model import Model
from tests.exploration.names import (
    BARRIER_US,
    BOOT,
    DEAD,
    EPOCH,
    LIVE,
    REGISTERED_US,
    TOKEN,
    Message,
    Passing,
    RuntimeSide,
    is_past,
    rename_controller,
)
from tests.exploration.recovery import Recovery
from tests.exploration.runtime_side import ORDERS
from tests.exploration.search import explore
from tests.exploration.traces import LATCHED, TO_MOVING, TO_PERMITTED, TO_RESET
from tests.exploration.world import JOB, PERMIT_LOG, VERDICT, WARNED, World

pytestmark = [pytest.mark.no_cover, pytest.mark.slow]

WORLD = World(reboots=True, limits=True, bone=True, emergency_stop=True, disk=True, warned=True, exact=True)
LAST = EPOCHS - 1
WALKS, STEPS = 2, 4
"""From each place on the way to the cut, and how far."""


@dataclass(frozen=True)
class Input:
    """One step of a table as the exploration makes it: the event, how late, what was measured before, what is told."""

    event: Any
    late_s: float = 0.0
    first: Any = None
    barrier_us: int = BARRIER_US


class Recording:
    """Instead of making a step, remembers it."""

    def __init__(self) -> None:
        super().__init__(WORLD)
        self.inputs: list[Input] = []

    def feed(
        self,
        _state: Any,
        _actor: str,
        event: Any,
        *,
        late_s: float = 0.0,
        first: Any = None,
        barrier_us: int = BARRIER_US,
        **_: Any,
    ) -> None:
        """Remember."""
        self.inputs.append(Input(event, late_s, first, barrier_us))


class RecordingRuntime(Recording, runtime_side.Runtime):
    """Every step that the exploration makes with one runtime."""

    def all(self, side: RuntimeSide) -> list[Input]:
        """In the order in which it makes them."""
        told = self._told(side, frozenset(attacker.TOLD))
        opened = self._opened(partial(self.feed, side, ""), side.interlock, EPOCH)
        for _ in (*self._own(side), *self._said(side), *told, *opened, *self._nonce_said(side)):
            pass
        return self.inputs


class RecordingController(Recording, controller_side.Controller):
    """Every step that the exploration makes with one controller."""

    def all(self, state: c.Controller) -> list[Input]:
        """In the order in which it makes them."""
        for _ in (*self._own(0, state), *self._said(state)):
            pass
        if state.session is not None:
            genuine = attacker.present_records(state.session, state.permit, state.memory.latched)
            for record in genuine:
                self._looks_at(partial(self.feed, state, ""), record)
        return self.inputs


@cache
def places() -> tuple[tuple[RuntimeSide | None, c.Controller], ...]:
    """Both sides at every place on the way to the cut, and on the way out of a latched fault."""
    found = []
    for begin, way in ((WORLD.begin, TO_MOVING), (LATCHED, TO_RESET)):
        world = replace(WORLD, warned=False, begin=begin)
        model = Model(world)
        for length in range(len(way) + 1):
            run, con, _ = Recovery(model).follow(way[:length])
            found.append((model.runtime.sides.values[run], model.controller.states.values[con]))
    return tuple(found)


def classed(thing: Any) -> Any:
    """With the one cause of each class; a record names one that stands."""
    by = standing if isinstance(thing, records.Record) else cause_class
    return replace(thing, cause=by(thing.cause)) if hasattr(thing, "cause") else thing


def another(cause: StopCause, chance: random.Random) -> StopCause:
    """A cause of the same class. Of those that latch the runtime looks at one as it comes: the exploration says both."""
    code = StopCause.AUTHENTICATION_FAILED
    same = [
        one
        for one in StopCause
        if cause_class(one) is cause_class(cause) and (one is code) is (cause is code)
    ]
    return chance.choice(same)


# ---------------------------------------------------------------- the runtime


def raw_runtime_input(given: Input, raw: RuntimeSide, form: RuntimeSide, chance: random.Random) -> Input:
    """The same for the raw runtime: its tokens, and any cause of the class."""
    event, token = given.event, raw.interlock.token
    match event:
        case r.RecordDurable(token=named):
            older = [one.token for one in raw.commits if one.token != token]
            event = r.RecordDurable(token if named == TOKEN else older[-1], event.log)
        case r.VerdictReady(verdict=verdict):
            event = r.VerdictReady(replace(verdict, request=verdict.request - TOKEN + token))
        case r.HeartbeatReceived(view=view):
            brought_back = view.cause in WITHDRAWING and view.cause is form.interlock.held_on
            cause = raw.interlock.held_on if brought_back else another(view.cause, chance)
            event = replace(event, view=replace(view, cause=cause))
        case r.Failed(cause=cause) | r.FaultReceived(cause=cause):
            event = replace(event, cause=another(cause, chance))
    return replace(given, event=event)


def after_runtime(side: RuntimeSide, given: Input, now_s: float) -> tuple[RuntimeSide, tuple[Any, ...]]:
    """One step of the real table, with the records still on their way."""
    state, table = side.interlock, cutgate.runtime.interlock.table
    if given.first is not None:
        state, _ = table.step(state, given.first, now_s)
    after, effects = table.step(state, given.event, now_s + given.late_s)
    for effect in effects:
        answer = runtime_side.answered(effect, given.barrier_us)
        if answer is not None:
            after, more = table.step(after, answer, now_s + given.late_s)
            effects += more
    durable = given.event.token if isinstance(given.event, r.RecordDurable) else None
    commits = [one for one in side.commits if one.token != durable]
    return RuntimeSide(after, (*commits, *(one for one in effects if isinstance(one, r.Commit)))), effects


def runtime_effects(before: RuntimeSide, after: RuntimeSide, effects: tuple[Any, ...]) -> list[Any]:
    """Without reasons and numbers; a second stop of one class while stopping, with the Withdraw behind it, is said anyway."""
    found: list[Any] = []
    for effect in effects:
        match effect:
            case r.Send(record=record):
                found.append(classed(record))
            case r.Commit(token=token, purpose=purpose, record=record):
                found.append((token - after.interlock.token, purpose, classed(record)))
            case r.SendStop() | r.SendWithdraw() if before.interlock.phase is not r.Phase.STOPPING:
                found.append(classed(effect))
            case r.Verify(start_joints_u=joints_u):
                found.append(joints_u)
            case r.SendBlock() | r.OpenLink() | r.UseSession():
                found.append(effect)
            case r.Withheld() | r.Refused() | r.Dropped():
                found.append(type(effect))
    return found


def runtimes_to_begin_with() -> list[RuntimeSide]:
    """At every place, and with a warning that waits and a log that the controller has seen: sought, found, not found.

    And opened on a controller that stands since the bone moved, as it is held and after a stop in that session.
    """
    found = [side for side, _ in places() if side is not None]
    waiting = next(one for one in found if one.interlock.phase is r.Phase.WAITING)
    opening, _ = after_runtime(waiting, Input(attacker.announced(BOOT)), NOW)
    for cause in sorted(WITHDRAWING):
        opened = records.Opened(EPOCH, ControllerState.FAULT, cause, withdrawal_due=1)
        held, _ = after_runtime(opening, Input(r.SessionOpened(opened, authentic=True)), NOW)
        stopping, _ = after_runtime(held, Input(r.Failed(StopCause.SECOND_NODE, "")), NOW)
        view = replace(canonical.STOOD, state=ControllerState.FAULT)
        found += [held, replace(stopping, interlock=replace(stopping.interlock, controller=view))]
    verifying = next(one.interlock for one in found if one.interlock.phase is r.Phase.VERIFYING)
    verdict = r.VerdictReady(replace(WARNED, request=verifying.token))
    sought = (None, *(r.WitnessSought(found=here, text="somewhere") for here in (True, False)))
    for witness, confirmed in product(sought, ((), WARNED.to_confirm, (r.WITNESS,))):
        opened = replace(verifying.opened, log=PERMIT_LOG)
        state = replace(verifying, opened=opened, witness=witness, confirmed=frozenset(confirmed))
        found.append(after_runtime(RuntimeSide(state), Input(verdict), NOW)[0])
    return found


def runtime_differs() -> str | None:
    """The first step that a raw and its canonical runtime make differently."""
    chance = random.Random(1)
    for start in runtimes_to_begin_with():
        for _ in range(WALKS):
            raw, now_s = start, NOW
            for _ in range(STEPS):
                form = canonical.canonical_runtime(raw)
                if form is None:
                    break
                inputs = RecordingRuntime().all(form)
                followers = []
                for given in inputs:
                    step = raw_runtime_input(given, raw, form, chance)
                    left, sent = after_runtime(raw, step, now_s)
                    right, expected = after_runtime(form, given, NOW)
                    same = canonical.canonical_runtime(left) == canonical.canonical_runtime(right)
                    if not same or runtime_effects(raw, left, sent) != runtime_effects(form, right, expected):
                        return f"{raw.interlock.phase}: {step}"
                    if not given.late_s:  # the clocks of the walk go on, a little at each step
                        followers.append(left)
                raw, now_s = chance.choice(followers), now_s + 0.001
    return None


# ---------------------------------------------------------------- the controller


def named(state: c.Controller) -> c.Controller:
    """The raw controller with the names that the exploration uses."""
    permit, issued = state.permit, state.issued
    if permit is not None:
        permit = replace(permit, nonce=DEAD, epoch=EPOCH)
    issued = replace(issued, nonce=LIVE) if issued else None
    return canonical.canonical_controller(replace(state, epoch=EPOCH, permit=permit, issued=issued))


def raw_controller(form: c.Controller) -> c.Controller:
    """As far along as this one, but with another epoch and other nonces."""
    permit, issued = form.permit, form.issued
    if permit is not None:
        permit = replace(permit, nonce=b"p" * 16, epoch=LAST)
    return replace(
        form, epoch=LAST, permit=permit, issued=replace(issued, nonce=b"i" * 16) if issued else None
    )


def of_this_moment(given: Input, form: c.Controller) -> Input:
    """An OPEN tells that its registration is later than the barrier of now; a barrier from now on is later still."""
    event = given.event
    if not isinstance(event, c.OpenReceived) or form.memory.barrier_us == BARRIER_US:
        return given
    time_us = min(event.request.registration_time_us, REGISTERED_US)
    return replace(given, event=replace(event, request=replace(event.request, registration_time_us=time_us)))


def raw_controller_input(given: Input, raw: c.Controller, form: c.Controller, chance: random.Random) -> Input:
    """The same for the raw controller: its epoch, nonces and causes."""
    event = given.event
    match event:
        case c.NonceRequested():
            event = replace(event, fresh=chance.randbytes(16))
        case c.HeartbeatReceived(epoch=epoch, cause=cause):
            event = replace(event, epoch=raw_epoch(raw, epoch), cause=another(cause, chance))
        case c.StopReceived(cause=cause) | c.FaultArisen(cause=cause):
            event = replace(event, cause=another(cause, chance))
        case c.AcknowledgeReceived(acknowledge=asked):
            cause = raw.cause if asked.cause is form.cause else another(asked.cause, chance)
            asked = records.Acknowledge(epoch=raw_epoch(raw, asked.epoch), cause=cause)
            event = replace(event, acknowledge=asked)
        case c.PermitReceived(permit=record):
            event = replace(event, permit=raw_record(record, raw, form))
        case c.StartReceived(start=record):
            event = replace(event, start=raw_record(record, raw, form))
        case c.ResetReceived(reset=record):
            event = replace(event, reset=raw_record(record, raw, form))
    return replace(given, event=event)


def raw_epoch(raw: c.Controller, epoch: int) -> int:
    return raw.epoch if epoch == EPOCH else (raw.epoch - 1) % EPOCHS


def raw_record(record: Any, raw: c.Controller, form: c.Controller) -> Any:
    """A permit, start or reset that stands to the raw controller as this one does to the canonical."""
    nonce = raw.issued.nonce if record.nonce == LIVE and raw.issued else b"d" * 16
    changes: dict[str, Any] = {"nonce": nonce, "epoch": raw_epoch(raw, record.epoch)}
    if isinstance(record, records.Start) and form.permit and record.permit_digest == form.permit.digest:
        changes["permit_digest"] = raw.permit.digest if raw.permit else b""
    if isinstance(record, records.Reset) and record.cause is form.memory.latched:
        changes["cause"] = raw.memory.latched
    return replace(record, **changes)


def after_controller(state: c.Controller, given: Input, now_s: float) -> tuple[c.Controller, list[Any]]:
    """One step of the real table with a memory that works; what it sends, without numbers."""
    step = cutgate.firmware_sim.table.step
    if given.first is not None:
        state, _ = step(state, given.first, now_s)
    after, effects = step(state, given.event, now_s + given.late_s)
    found: list[Any] = []
    for effect in effects:
        if isinstance(effect, c.Persist):
            after, more = step(after, c.Persisted(effect.memory), now_s + given.late_s)
            effects += more
    after = invariants.accounted(state, given.event, after, forged=False)
    for effect in effects:
        match effect:
            case c.Send(record=records.Nonce(purpose=purpose), session=tag):
                found.append((purpose, tag))
            case c.Send(record=records.Opened() as opened, session=tag):
                forgotten = {"log": records.NO_TREE_HEAD, "motion_age_s": records.AGE_UNKNOWN}
                found.append((classed(replace(opened, epoch=0, **forgotten)), tag))
            case c.Send(record=record, session=tag):
                found.append((classed(record), tag))
            case c.SendFault():
                found.append(classed(effect))
            case c.Persist(memory=memory):
                found.append(canonical._canonical_memory(memory))
            case _:
                found.append(effect)
    return after, found


def controller_differs() -> str | None:
    """The first step that a raw and its canonical controller make differently."""
    chance = random.Random(2)
    side = controller_side.Controller(WORLD)
    for start in dict.fromkeys(state for _, state in places()):
        for _ in range(WALKS):
            raw, now_s = raw_controller(start), NOW
            for _ in range(STEPS):
                form, followers = named(raw), []
                for given in [of_this_moment(one, form) for one in RecordingController().all(form)]:
                    step = raw_controller_input(given, raw, form, chance)
                    left, sent = after_controller(raw, step, now_s)
                    passing = controller_side.passing_between(raw, left)
                    _, expected = after_controller(form, given, NOW)
                    change = side.feed(form, "", given.event, late_s=given.late_s, first=given.first)
                    left = rename_controller(
                        controller_side.named_session(left), change.passing & Passing.BOOT
                    )
                    if named(left) != side.states.values[change.side] or sent != expected:
                        return f"{raw.state.name}: {step}: {sent} {expected}"
                    if (passing ^ change.passing) & ~Passing.STOP:
                        return f"{raw.state.name}: {step}: other names pass away"
                    if not given.late_s:  # the clocks of the walk go on, a little at each step
                        followers.append(left)
                raw, now_s = chance.choice(followers), now_s + 0.001
    return None


# ---------------------------------------------------------------- the tests


def test_every_event_does_the_same_with_a_raw_and_with_its_canonical_runtime():
    assert runtime_differs() is None


def test_every_event_does_the_same_with_a_raw_and_with_its_canonical_controller():
    assert controller_differs() is None


@pytest.mark.parametrize(
    "forgotten",
    [
        {"verdict": None},
        {"stored": None},
        {"heartbeat_fresh": False},
        {"device": r.DeviceCycle.UNSEEN},
        {"controller": None},
        {"permit": None},
        {"acknowledged": StopCause.NONE},
        {"held_on": StopCause.NONE},
        {"opened": None},
        {"witness": None},
        {"confirmed": frozenset()},
    ],
    ids=lambda one: next(iter(one)),
)
def test_a_runtime_that_is_made_to_forget_one_thing_more_does_something_else(monkeypatch, forgotten):
    places()
    real = canonical.canonical_runtime

    def forgetful(side):
        form = real(side)
        return replace(form, interlock=replace(form.interlock, **forgotten)) if form else None

    monkeypatch.setattr(canonical, "canonical_runtime", forgetful)
    assert runtime_differs() is not None


def test_a_monitor_that_is_made_to_have_begun_earlier_does_something_else(monkeypatch):
    places()
    earlier = TrackingMonitor.begin(VERDICT.trajectory, JOB.timing, JOB.tracking, 1.0, NOW - 10.0)
    monkeypatch.setattr(canonical, "MONITOR", earlier)
    assert runtime_differs() is not None


@pytest.mark.parametrize(
    "forgotten",
    [
        {"cause": StopCause.NONE},
        {"heartbeat_fresh": False},
        {"device": c.DeviceCycle.UNSEEN},
        {"cut_ordered": False},
        {"issued": None},
        {"inputs": c.Inputs()},
        {"memory": c.Memory()},
        {"written": None},
    ],
    ids=lambda one: next(iter(one)),
)
def test_a_controller_that_is_made_to_forget_one_thing_more_does_something_else(monkeypatch, forgotten):
    places()
    real = canonical.canonical_controller

    def forgetful(state):
        return replace(real(state), **forgotten)

    monkeypatch.setattr(canonical, "canonical_controller", forgetful)
    monkeypatch.setattr(controller_side, "canonical_controller", forgetful)
    assert controller_differs() is not None


# ---------------------------------------------------------------- what is taken as said or as so


def controllers_met() -> list[tuple[c.Controller, bool]]:
    """Some of those that one move of the exact world leads to from the way to the cut, also from one that is taken."""
    side = controller_side.Controller(WORLD)
    for start in dict.fromkeys(state for _, state in places()):
        number = side.number(start)
        for message in signed(start):
            side.repeated(number, message)
        side.changes(number)
    return random.Random(3).sample(side.states.values, 150)


def signed(state: c.Controller) -> list[Message]:
    """What the session's runtime may have signed for this moment."""
    if state.session is None:
        return []
    found = attacker.present_records(state.session, state.permit, state.memory.latched)
    return [Message(state.session.tag, record) for record in found]


def outcomes(side: controller_side.Controller, number: int, state: c.Controller) -> set[tuple[int, int]]:
    """The controllers that every move leads to, as they are taken, and what passes away."""
    changes = [*side.changes(number)]
    for message in signed(state):
        changes += side.repeated(number, message)
    return {(change.side, change.passing) for change in changes} | {(side.number(state), 0)}


def controller_taken_for_less() -> str | None:
    """The first controller that can lead to something to which the one that is taken for it cannot."""
    side = controller_side.Controller(replace(WORLD, exact=False))
    for state in controllers_met():
        real = outcomes(side, side.states.number(state), state)
        if not real <= outcomes(side, side.number(state), state):
            return f"{state.state.name}, issued {state.issued}, {state.inputs}"
    return None


def test_where_a_controller_leads_the_one_that_is_taken_for_it_leads_as_well():
    assert controller_taken_for_less() is None


@pytest.mark.parametrize(
    "taken",
    [
        {"heartbeat_fresh": False},
        {"issued": None},
        {"cut_ordered": False},
        {"cause": StopCause.OPERATOR_STOP},
    ],
    ids=lambda one: next(iter(one)),
)
def test_a_controller_that_is_taken_for_one_that_leads_to_less_is_found(monkeypatch, taken):
    places()
    monkeypatch.setattr(
        controller_side,
        "taken_controller",
        lambda state: replace(canonical.taken_controller(state), **taken) if state.session else state,
    )
    assert controller_taken_for_less() is not None


SMALL = World()
WAYS = {(): 11, TO_PERMITTED: 4, TO_MOVING: 4}


@cache
def exact() -> set[Pair]:
    """What is met in so many moves of the exact world."""
    return met_exactly(SMALL, WAYS)


def test_every_state_of_the_exact_world_is_met_with_what_is_taken_as_said_or_as_so():
    assert left_out(explore(Model(SMALL)), exact()) is None


@pytest.mark.parametrize(
    "fault",
    [
        (
            "tests.exploration.model.is_past",
            lambda side: is_past(side) or (side and side.interlock.phase in ORDERS),
        ),
        ("tests.exploration.runtime_side.Runtime._opened", lambda *_: ()),
        ("tests.exploration.model.Model._counts", lambda *_: False),
    ],
    ids=["past", "opened", "said"],
)
def test_states_that_are_left_out_are_found(monkeypatch, fault):
    exact()
    monkeypatch.setattr(*fault)
    assert left_out(explore(Model(SMALL)), exact()) is not None
