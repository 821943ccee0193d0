"""The controller's real table, and everything that can happen to it, with what it sends."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from typing import Any

import cutgate.firmware_sim.table
from cutgate.firmware_sim import state as c
from cutgate.protocol import records
from cutgate.protocol.states import ControllerState, StopCause
from cutgate.runtime.interlock import state as r
from tests.exploration import attacker, invariants
from tests.exploration.canonical import NOW, canonical_controller, cause_class, taken_controller
from tests.exploration.labels import LATE, NONCE_OLD, PERMIT_OLD, describe, lateness
from tests.exploration.names import (
    BOOT,
    EARLIER_BOOT,
    EARLIER_SESSION,
    EARLIER_TAG,
    EPOCH,
    GIVEN,
    LIVE,
    NEXT_BOOT,
    SESSION,
    TAG,
    Message,
    Passing,
    Told,
    rename_controller,
)
from tests.exploration.world import (
    FLIPPED_PATH,
    OFF_START,
    OTHER_LIMITS,
    Change,
    Move,
    Numbers,
    World,
    distinct,
)
from tests.firmware_sim import controllers as fixed

STANDING, AWAY = c.JointsMeasured(fixed.START_JOINTS), c.JointsMeasured(OFF_START)


class Controller:
    """Every controller met, by number, and what can happen to it.

    Args:
        world: what may happen.
        step: the table under test.
    """

    def __init__(self, world: World, step: Callable[..., Any] | None = None) -> None:
        self.world, self.step = world, step or cutgate.firmware_sim.table.step
        self.states = Numbers()
        self.written: list[Callable[..., Change]] = []
        self.known: dict[tuple[c.Controller, int], int] = {}
        self.attacked: dict[int, list[Change]] = {}
        self.heard: dict[tuple[int, Message], list[Change]] = {}
        self.recovery: dict[int, list[Change]] = {}

    def changes(self, number: int) -> list[Change]:
        """Everything but what somebody with the key has said and what only the present runtime may open."""
        if number not in self.attacked:
            state = self.states.values[number]
            self.attacked[number] = self._with_failures(
                number, lambda: [*self._own(number, state), *self._said(state)]
            )
        return self.attacked[number]

    def repeated(self, number: int, message: Message) -> list[Change]:
        """A record the runtime once sent arrives, now or again, in whatever envelope."""
        key = number, message
        if key not in self.heard:
            state = self.states.values[number]
            feed = partial(self.feed, state, "bus > controller", message=message)
            content = message.content
            if isinstance(content, records.Open):
                opening = c.OpenReceived(content, 1, authentic=True, fresh=NEXT_BOOT)
                self.heard[key] = self._with_failures(number, lambda: [feed(opening)])
            elif isinstance(content, c.HeartbeatReceived):
                beats = [content, replace(content, fresh=False)]
                self.heard[key] = self._with_failures(number, lambda: [feed(one) for one in beats])
            elif isinstance(content, records.Permit) and state.session and not self.world.exact:
                pressed = replace(state, inputs=replace(state.inputs, device_pressed=True))
                feeds = feed, partial(self.feed, pressed, "bus > controller", message=message)
                self.heard[key] = self._with_failures(
                    number, lambda: [one for each in feeds for one in self._looks_at(each, content)]
                )
            else:
                looks = partial(self._looks_at, feed, content)
                self.heard[key] = self._with_failures(number, looks if state.session else list)
        return self.heard[key]

    def own(self, number: int) -> list[Change]:
        """What happens to it without faults, but for arrivals."""
        if number not in self.recovery:
            state = self.states.values[number]
            found = [*self._own(number, state), *self._beats(number, state)]
            self.recovery[number] = distinct(number, [one for one in found if one.move.sound])
        return self.recovery[number]

    def _with_failures(self, number: int, changes: Callable[[], list[Change]]) -> list[Change]:
        """All these, once with a memory that is written and once with one that cannot be."""
        self.written.clear()
        found = changes()
        if self.world.disk:
            found += [again(memory_fails=True) for again in self.written]
        return distinct(number, [one._replace(sent=()) for one in found])

    def number(self, canonical: c.Controller) -> int:
        """The number of this controller, or of the one that is taken for it."""
        return self.states.number(canonical if self.world.exact else taken_controller(canonical))

    # ------------------------------------------------------------ its own, people, sensors, clock

    def _own(self, number: int, state: c.Controller) -> Iterable[Change]:
        world, inputs = self.world, state.inputs
        feed = partial(self.feed, state)
        pressed = replace(inputs, device_pressed=not inputs.device_pressed)
        yield feed("person", c.InputsChanged(pressed), sound=True)
        if world.emergency_stop:
            clear = not inputs.emergency_stop_clear
            yield feed("person", c.InputsChanged(replace(inputs, emergency_stop_clear=clear)), sound=clear)
        if state.session is not None:
            yield feed("clock", c.HeartbeatLost(), sound=True)
        yield feed("clock", c.Tick(), sound=True, late_s=LATE)
        yield feed("plant", c.PathFinished(), sound=True, first=STANDING)
        yield feed("plant", c.PathFinished(), first=AWAY)
        yield feed("shell", c.FaultArisen(StopCause.SEQUENCE_ERROR))
        yield feed("shell", c.FaultArisen(StopCause.SECOND_NODE))
        if world.bone:
            yield feed("sensor", c.BoneMoved())
        if world.limits:
            original = fixed.LIMITS.body()
            changed = OTHER_LIMITS if state.holdings.limits == original else original
            yield feed("person", c.LimitsChanged(changed), sound=changed == original)
            if state.state is not ControllerState.CUTTING:
                yield from self._silent_changes(number, state)
        if world.reboots:
            yield from self._reboots(state)

    def _reboots(self, state: c.Controller) -> Iterable[Change]:
        """With what memory holds; where that is not known, what it was to hold, or a latch less."""
        memories = {state.memory, state.written or replace(state.memory, latched=StopCause.NONE)}
        for memory in sorted(memories, key=repr):
            again = invariants.JudgedController.powered_up(
                state.identity, replace(state.holdings, path=None, ends=None), memory, BOOT
            )
            again = replace(again, epoch=EPOCH, inputs=state.inputs)
            wrong = invariants.reboot(state, again)
            move = Move("controller", "reboots", wrong=wrong)
            yield Change(move, self.number(again), (), Passing.STOP | Passing.BOOT | Passing.NONCE)

    def _silent_changes(self, number: int, state: c.Controller) -> Iterable[Change]:
        held = state.holdings
        changes = [("its limits change without a word", replace(held, limits=OTHER_LIMITS))]
        if held.path is not None:
            changes.append(("a bit of the stored path flips", replace(held, path=FLIPPED_PATH)))
        for text, holdings in changes:
            yield Change(Move("controller", text), self.number(replace(state, holdings=holdings)))

    def _beats(self, number: int, state: c.Controller) -> Iterable[Change]:
        if state.session is None:
            move = Move("controller", "announces itself", sound=True)
            yield Change(move, number, (Message(0, attacker.announced(state.announce_nonce)),))
            return
        view = r.ControllerView(
            state.state,
            state.cause,
            state.epoch,
            state.inputs.device_pressed,
            state.inputs.emergency_stop_clear,
            state.cutting_mode,
        )
        beat = Message(state.session.tag, r.HeartbeatReceived(view, fresh=True))
        yield Change(Move("controller", "sends its heartbeat", sound=True), number, (beat,))

    # ------------------------------------------------------------ what is said to it

    def _said(self, state: c.Controller) -> Iterable[Change]:
        feed = partial(self.feed, state, "bus > controller")
        for event in attacker.opens(self.world, state.announce_nonce):
            yield feed(event)
        if state.session is None:
            return
        session, causes = state.session, attacker.causes(self.world)
        for event in (*attacker.unsigned(causes), *attacker.beats(causes), *attacker.forged(state)):
            yield feed(event)
        for event in attacker.withdrawals(session) if self.world.bone else ():
            yield feed(event)
        for event in attacker.believed_by_a_fault(self.world):
            yield feed(event, forged=True)
        if state.state in (ControllerState.OPEN, ControllerState.LOADED):
            for event in attacker.uploads(self.world):
                yield feed(event)
        latched = state.memory.latched
        issued = state.issued.purpose if state.issued else None
        said = attacker.earlier_records(session, issued, latched, exact=self.world.exact)
        for message in said:
            yield from self._looks_at(partial(feed, message=message), message.content)
        if not self.world.exact:
            yield feed(
                c.AcknowledgeReceived(records.Acknowledge(epoch=EPOCH, cause=state.cause), 1, authentic=True)
            )

    def _looks_at(self, feed: Callable[..., Change], record: Any) -> list[Change]:
        """Permit, start and reset: looked at in time or too late, the arm at its start or away from it."""
        event = fixed.RECEIVED[type(record)](record, 1, True)
        match record:
            case records.Acknowledge() | records.Withdraw():
                return [feed(event)]
            case records.Reset():
                return [feed(event), feed(event, late_s=NONCE_OLD)]
            case records.Permit():
                late = [feed(event, first=STANDING, late_s=PERMIT_OLD)]
            case _:
                late = [
                    feed(event, first=STANDING, late_s=NONCE_OLD),
                    feed(event, first=STANDING, slow_s=NONCE_OLD),
                ]
        return [feed(event, first=STANDING), *late, feed(event, first=AWAY)]

    def hears(self, number: int, message: Message) -> Change:
        """A message of the real runtime arrives, in time."""
        feed = partial(
            self.feed, self.states.values[number], "runtime > controller", sound=True, message=message
        )
        match message.content:
            case records.Open() as request:
                return feed(c.OpenReceived(request, 1, authentic=True, fresh=NEXT_BOOT))
            case records.NonceRequest(purpose=purpose):
                return feed(c.NonceRequested(purpose, GIVEN))
            case records.Permit() | records.Start() as record:
                return feed(fixed.RECEIVED[type(record)](record, 1, True), first=STANDING)
            case records.SignedRecord() as record:
                return feed(fixed.RECEIVED[type(record)](record, 1, True))
            case records.Collect():
                return feed(c.CollectReceived())
        return feed(message.content)

    # ------------------------------------------------------------ one step

    def feed(
        self,
        state: c.Controller,
        actor: str,
        event: c.Event,
        *,
        sound: bool = False,
        late_s: float = 0.0,
        first: c.Event | None = None,
        message: Message | None = None,
        memory_fails: bool = False,
        slow_s: float = 0.0,
        forged: bool = False,
    ) -> Change:
        """One step of the real table, judged, and what it sends.

        Args:
            slow_s: how long the memory takes.
            forged: a link that is at fault lets through what no holder of the key has said.
        """
        at_hand = self.step(state, first, NOW)[0] if first is not None else state
        after, effects = self.step(at_hand, event, NOW + late_s)
        text = describe(event) + lateness(late_s, first) + (", its memory is slow" if slow_s else "")
        for effect in effects:
            if isinstance(effect, c.Persist):
                answer = c.PersistFailed() if memory_fails else c.Persisted(effect.memory)
                after, more = self.step(after, answer, NOW + late_s + slow_s)
                effects += more
                text += ", its memory cannot be written" if memory_fails else ""
                if not memory_fails:
                    again = partial(
                        self.feed,
                        state,
                        actor,
                        event,
                        late_s=late_s,
                        first=first,
                        message=message,
                        forged=forged,
                    )
                    self.written.append(again)
        after = invariants.accounted(state, event, after, forged=forged)
        wrong = invariants.controller_step(
            state, event, after, message, forged=forged, late_s=late_s + slow_s
        )
        sent = tuple(one for effect in effects for one in sent_by(state, effect))
        stopped = any(isinstance(effect, c.SendFault) for effect in effects)
        passing = passing_between(state, after) | (Passing.STOP if stopped else 0)
        renamed = passing & (Passing.NONCE | Passing.BOOT)
        key = after, renamed
        number = self.known.get(key)
        if number is None:
            canonical = canonical_controller(rename_controller(present(after), renamed))
            number = self.known[key] = self.number(canonical)
        move = Move(actor, text, sound, wrong)
        return Change(move, number, sent, passing)


def passing_between(before: c.Controller, after: c.Controller) -> int:
    """What ceased to be the present one."""
    passing = 0
    if after.epoch != before.epoch:
        passing |= Passing.STOP | Passing.EPOCH
    if before.issued is not None and (after.issued is None or after.issued.nonce != before.issued.nonce):
        passing |= Passing.NONCE
    if after.session is not None and after.session != before.session and before.session is None:
        passing |= Passing.OPENED if after.session.digest == SESSION else Passing.BOOT
    return passing


def present(state: c.Controller) -> c.Controller:
    """Its epoch is the present one, and so is the nonce it has just given."""
    issued = state.issued
    if issued is not None and issued.nonce == GIVEN:
        issued = replace(issued, nonce=LIVE)
    return replace(named_session(state), epoch=EPOCH, issued=issued)


def named_session(state: c.Controller) -> c.Controller:
    """A session that is not the runtime's own is an earlier one."""
    session = state.session
    if session is None or session.digest == SESSION:
        return state
    earlier = replace(session, tag=EARLIER_TAG, digest=EARLIER_SESSION, announce_nonce=EARLIER_BOOT)
    return replace(state, session=earlier)


def sent_by(before: c.Controller, effect: c.Effect) -> list[Message]:
    """What an effect puts on the bus, with the names it has after the step."""
    match effect:
        case c.Send(record=records.Nonce() as nonce, session=tag):
            return [Message(tag, replace(nonce, nonce=LIVE, epoch=EPOCH))]
        case c.Send(record=records.Opened() as opened, session=tag):
            return [Message(tag, replace(opened, epoch=EPOCH))]
        case c.Send(record=record, session=tag):
            return [Message(tag, record)]
        case c.SendFault(code=code, cause=cause) if before.session is not None:
            return [Message(before.session.tag, r.FaultReceived(code, cause_class(cause)))]
    return []


def told(state: c.Controller) -> tuple[Message, ...]:
    """What its heartbeat says from now on to the runtime, of what the runtime believes of it alone."""
    if state.session is not None and state.session.tag == TAG and state.state in attacker.TOLD:
        return (Message(TAG, Told(state.state)),)
    return ()
