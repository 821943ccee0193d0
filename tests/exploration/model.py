"""The two real tables joined by a modelled bus, in a modelled world: every state's enabled moves.

A state of the world is five numbers packed into one: the runtime's side (interlock and records on their way to the
disk; none: no process), the controller, what is under way to the controller, what is under way to the runtime, and
the signed records of these sessions that an attacker has heard. Each number names a canonical concrete value
(``canonical``); every change of either side is made by its real step function on that value, once for each pair of
value and event, and is judged by ``invariants`` as it is made.

Bus. What is under way in one direction is a set of at most ``queue`` records and frames. Any of them may arrive next
(reordering, delay), or never (loss; corruption is loss, for CRC-16, CRC-32 and code refuse it; the third in a second
is a link fault, which is a move of its own). A repeated frame or record is discarded by its counter or sequence, so
that a repetition can only come from somebody who writes new ones: the attacker. What is sent into a full set is lost;
that anything else is lost instead is the same as losing it before. Heartbeats that arrive are fresh or stale by choice.
A message of a session that the receiver is not in is discarded by its tag: it is removed as soon as that is so.

Time. No clock runs. That a nonce, permit, sample, record or deadline is too old when it is looked at is a choice made
anew at each look; a heartbeat's time-out may pass at any moment.

Attacker, without the key. Says again, in envelopes of his own with any sequence and tag, every signed record of the
present sessions and one each of an earlier session of the same boot, of an earlier boot, with wrong code; says every
unsigned request; opens again an earlier session; repeats any heartbeat (never fresh, for its echo is old); answers
the runtime with old replies, nonces and announcements.

Not in the model: forged fresh heartbeats (docs/protocol.md promises nothing there), the controller's own check of the
path and the proof (data, not protocol: their results are inputs), the split of records into ISO-TP frames and of
the path into blocks (one block), more than one change of limits, silent changes while cutting (found by the block's
CRC in the plant, not by the table), 256 stops between two looks (the epoch is one byte).
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from types import SimpleNamespace
from typing import Any, NamedTuple

import firmware_sim.table
import runtime.interlock.table
from firmware_sim import state as c
from protocol import records
from protocol.states import ControllerState, Purpose, Refusal, RuntimeCode, StopCause, StopCode
from runtime.interlock import state as r
from tests.exploration import invariants
from tests.exploration.canonical import (
    DEAD_NONCE,
    EPOCH,
    NONCES,
    NOW,
    TOKEN,
    Message,
    RuntimeSide,
    canonical_controller,
    canonical_runtime,
    cause_class,
    digest_of,
    epochs_of,
    nonces_of,
    ranks,
    rename,
    signed,
)
from tests.exploration.words import (
    COMMIT_OLD,
    LATE,
    NONCE_OLD,
    PERMIT_OLD,
    SAMPLE_OLD,
    describe,
    lateness,
)
from tests.firmware_sim import controllers as fixed
from tests.runtime.interlock import builders

REGISTRATIONS = (fixed.REGISTRATION, records.digest(b"registered anew"))
BOOTS = tuple(f"boot {index}".encode().ljust(16, b".") for index in range(3))
RUNTIME_NONCES = tuple(f"runtime {index}".encode().ljust(16, b".") for index in range(3))
EARLIER_NONCE = b"earlier".ljust(16, b".")
"""The runtime's nonce of an earlier session: never drawn again."""
OLD_BOOT = b"boot of old".ljust(16, b".")

JOB = replace(
    builders.JOB,
    path=fixed.PATH.body(),
    branch=fixed.PERMIT.branch,
    configuration=fixed.PERMIT.configuration_digest,
    registration=REGISTRATIONS[0],
    registration_max_age_s=None,
)
FRESH = r.Interlock(job=JOB, log=builders.READY.log, token=TOKEN)
VERDICT = r.Verdict(
    request=TOKEN,
    admissible=True,
    path=fixed.PATH.digest,
    limits=fixed.PERMIT.limits_digest,
    calibration=fixed.PERMIT.calibration_digest,
    tool=fixed.PERMIT.tool_digest,
    start_joints_u=fixed.START_JOINTS,
    reason="",
    approach=fixed.PERMIT.approach,
    approach_reason="",
)
POWERED_UP = replace(
    fixed.POWERED_UP, identity=replace(fixed.POWERED_UP.identity, boot_nonce=BOOTS[0]), epoch=EPOCH
)
OFF_START = (0, *fixed.START_JOINTS[1:])
OTHER_LIMITS = fixed.OTHER_LIMITS.body()
FLIPPED_PATH = fixed.PATH.body()[:-1] + bytes([fixed.PATH.body()[-1] ^ 1])

BITS = 20
MASK = (1 << BITS) - 1


@dataclass(frozen=True)
class Parameters:
    """Limits, calibration and tool, as one message."""

    limits: bytes


@dataclass(frozen=True)
class Stored:
    """BlockStored of the only block, then PathStored, as one message."""

    stored: records.PathStored


@dataclass(frozen=True)
class World:
    """What may happen besides a sound session with patient people.

    Attributes:
        queue: how much may be under way in each direction.
        attacker: somebody without the key says again to the controller what was said before.
        answers: he says old answers to the runtime as well.
        reboots: the controller loses power.
        crashes: the runtime's process dies.
        limits: limits change, with a word and without; a bit of the stored path flips.
        bone: it moves, the registration is withdrawn, and there is another one.
        latches: causes that latch occur.
        emergency_stop: it is pressed and released.
        disk: records late, log failing, the arm away from where it was verified, verdicts against the path.
        again: another session is started when the first has ended.
        begin: the controller at the beginning.
    """

    queue: int = 1
    attacker: bool = False
    answers: bool = False
    reboots: bool = False
    crashes: bool = False
    limits: bool = False
    bone: bool = False
    latches: bool = False
    emergency_stop: bool = False
    disk: bool = False
    again: bool = True
    begin: c.Controller = POWERED_UP


class Move(NamedTuple):
    """What happens; ``sound``: part of a continuation without faults; ``wrong``: the invariant it breaks."""

    actor: str
    text: str
    sound: bool
    wrong: str | None = None


class Change(NamedTuple):
    """One side's new value and what it sent; ``stopped``: the controller's epoch went on."""

    move: Move
    side: int
    sent: tuple[int, ...] = ()
    stopped: bool = False


class Names:
    """Canonical values by number, with the epochs and nonces each names."""

    def __init__(self) -> None:
        self.values: list[Any] = []
        self.numbers: dict[Any, int] = {}
        self.epochs: list[int] = []
        self.nonces: list[int] = []

    def number(self, value: Any) -> int:
        """The value's number, a new one where it is new."""
        found = self.numbers.get(value)
        if found is None:
            found = self.numbers[value] = len(self.values)
            self.values.append(value)
            self.epochs.append(epochs_of(value) if not isinstance(value, tuple) else 0)
            self.nonces.append(nonces_of(value) if not isinstance(value, tuple) else 0)
        return found


class Sets(Names):
    """Sets of messages by number."""

    def __init__(self, messages: Names) -> None:
        super().__init__()
        self.messages = messages
        self.number(())

    def number(self, value: tuple[int, ...]) -> int:
        """The set's number; messages are numbers in increasing order."""
        found = self.numbers.get(value)
        if found is None:
            found = super().number(value)
            for message in value:
                self.epochs[found] |= self.messages.epochs[message]
                self.nonces[found] |= self.messages.nonces[message]
        return found


def tag_of(side: RuntimeSide | c.Controller | None) -> int:
    """The session this side is in, 0 for none."""
    session = side.interlock.session if isinstance(side, RuntimeSide) else side.session if side else None
    return session.tag if session else 0


class Model:
    """The moves of the world.

    Args:
        world: what may happen.
        runtime_step, controller_step: the tables under test.
    """

    def __init__(
        self,
        world: World,
        runtime_step: Callable[..., Any] | None = None,
        controller_step: Callable[..., Any] | None = None,
    ) -> None:
        self.world = world
        self.runtime_step = runtime_step or runtime.interlock.table.step
        self.controller_step = controller_step or firmware_sim.table.step
        self.runtimes, self.controllers, self.messages = Names(), Names(), Names()
        self.sets = Sets(self.messages)
        self.memo: dict[Any, Any] = {}
        self.none = self.runtimes.number(None)

    def begin(self) -> int:
        """Powered up, no process, nothing on the bus."""
        return self.controllers.number(self.world.begin) << BITS | self.none

    # ------------------------------------------------------------ the whole world

    def moves(self, key: int) -> Iterable[tuple[Move, int]]:
        """Every enabled move with the state it leads to."""
        run, con, up, down, heard = (key >> BITS * index & MASK for index in range(5))
        own = self._cached("runtime", run, 0, 0, self._runtime_alone)
        for change in own:
            yield change.move, self._pack(change.side, con, self._add(up, change.sent), down, heard, change)
        fresh = self._fresh(run, con, up, down)
        own = self._cached("controller", con, 0, 0, self._controller_alone)
        for change in own:
            yield change.move, self._pack(run, change.side, up, self._add(down, change.sent), heard, change)
        for message in self.sets.values[up]:
            rest = self._cached("less", up, message, 0, self._less)
            yield self._lost(message), self._pack(run, con, rest, down, heard)
            for change in self._cached("to controller", con, message, fresh, self._to_controller):
                yield (
                    change.move,
                    self._pack(run, change.side, rest, self._add(down, change.sent), heard, change),
                )
        for message in self.sets.values[down]:
            rest = self._cached("less", down, message, 0, self._less)
            yield self._lost(message), self._pack(run, con, up, rest, heard)
            for change in self._cached("to runtime", run, message, 0, self._to_runtime):
                yield (
                    change.move,
                    self._pack(change.side, con, self._add(up, change.sent), rest, heard, change),
                )
        for change in self._cached("both", run, con, 0, self._both):
            yield change.move, self._pack(change.side, con, self._add(up, change.sent), down, heard, change)
        if self.world.attacker:
            yield from self._attacks(run, con, up, down, heard, fresh)

    def _attacks(
        self, run: int, con: int, up: int, down: int, heard: int, fresh: int
    ) -> Iterable[tuple[Move, int]]:
        for change in self._cached("attacks", con, heard, fresh, self._attacks_on_controller):
            yield change.move, self._pack(run, change.side, up, self._add(down, change.sent), heard, change)
        answers = self._cached("answers", run, 0, 0, self._attacks_on_runtime) if self.world.answers else ()
        for change in answers:
            yield change.move, self._pack(change.side, con, self._add(up, change.sent), down, heard, change)

    def _attacks_on_controller(self, con: int, heard: int, fresh: int) -> list[Change]:
        said = (*self.sets.values[heard], *self._forged(con))
        changes = [change for message in said for change in self._to_controller(con, message, fresh)]
        return self._by_attacker("attacker > controller", con, changes)

    def _attacks_on_runtime(self, run: int, *_: int) -> list[Change]:
        changes = [
            change for message in self._forged_answers(run) for change in self._to_runtime(run, message, 0)
        ]
        return self._by_attacker("attacker > runtime", run, changes)

    def _by_attacker(self, actor: str, side: int, changes: list[Change]) -> list[Change]:
        """One of each different outcome."""
        different = {(one.side, one.sent, one.stopped, one.move.wrong): one for one in reversed(changes)}
        return [
            one._replace(move=one.move._replace(actor=actor, sound=False))
            for one in self._distinct(side, different.values())
        ]

    def _cached(self, what: str, one: int, two: int, three: int, make: Callable[..., Any]) -> Any:
        key = (what, one, two, three)
        found = self.memo.get(key)
        if found is None:
            found = self.memo[key] = make(one, two, three)
        return found

    def _lost(self, message: int) -> Move:
        return self._cached(
            "lost", message, 0, 0, lambda *_: Move("bus", f"loses {self.text(message)}", sound=False)
        )

    # ------------------------------------------------------------ what is under way

    def _less(self, queue: int, message: int, _: int) -> int:
        return self.sets.number(tuple(one for one in self.sets.values[queue] if one != message))

    def _add(self, queue: int, sent: tuple[int, ...]) -> int:
        if not sent:
            return queue
        key = (queue, sent)
        found = self.memo.get(key)
        if found is None:
            held = list(self.sets.values[queue])
            for message in sent:
                if message not in held and len(held) < self.world.queue:
                    held.append(message)
            found = self.memo[key] = self.sets.number(tuple(sorted(held)))
        return found

    def _fresh(self, run: int, con: int, up: int, down: int) -> int:
        """The nonces that may not be given now."""
        return (
            self.runtimes.nonces[run]
            | self.controllers.nonces[con]
            | self.sets.nonces[up]
            | self.sets.nonces[down]
        )

    def _pack(self, run: int, con: int, up: int, down: int, heard: int, change: Change | None = None) -> int:
        """Canonical as a whole: foreign sessions dropped, epochs ranked, dead nonces named so."""
        if change is not None:
            if self.world.attacker and change.sent:
                heard = self._hear(heard, change.sent)
            if change.stopped and (up or heard):
                up, heard = (self._cached("age", queue, 0, 0, self._age) for queue in (up, heard))
        if up:
            up = self._cached("up", up, con, 0, self._drop_for_controller)
        if down:
            down = self._cached("down", down, run, 0, self._drop_for_runtime)
        if heard:
            heard = self._cached("heard", heard, run, con, self._forget)
        sets = self.sets
        epochs = (
            self.controllers.epochs[con]
            | self.runtimes.epochs[run]
            | sets.epochs[up]
            | sets.epochs[down]
            | sets.epochs[heard]
        )
        dead = 0
        if sets.nonces[up] | sets.nonces[heard]:
            live = self.controllers.nonces[con] | self.runtimes.nonces[run] | sets.nonces[down]
            dead = (sets.nonces[up] | sets.nonces[heard]) & ~live
        new = ranks(epochs, self.controllers.values[con].epoch)
        if new or dead:
            run = self._renamed(self.runtimes, run, new)
            con = self._renamed(self.controllers, con, new)
            up, down, heard = (self._renamed_set(queue, new, dead) for queue in (up, down, heard))
        return ((((heard << BITS | down) << BITS | up) << BITS) | con) << BITS | run

    def _renamed(self, names: Names, one: int, new: Any) -> int:
        if not new:
            return one
        key = (id(names), one, new)
        found = self.memo.get(key)
        if found is None:
            found = self.memo[key] = names.number(rename(names.values[one], new))
        return found

    def _renamed_set(self, queue: int, new: Any, dead: int) -> int:
        if not queue:
            return 0
        key = ("set", queue, new, dead)
        found = self.memo.get(key)
        if found is None:
            renamed = {
                self.messages.number(rename(self.messages.values[one], new, dead))
                for one in self.sets.values[queue]
            }
            found = self.memo[key] = self.sets.number(tuple(sorted(renamed)))
        return found

    def _age(self, queue: int, *_: int) -> int:
        aged = {
            self.messages.number(replace(self.messages.values[one], old=True))
            if isinstance(self.messages.values[one].content, records.SignedRecord)
            else one
            for one in self.sets.values[queue]
        }
        return self.sets.number(tuple(sorted(aged)))

    def _drop_for_controller(self, queue: int, con: int, _: int) -> int:
        tag = tag_of(self.controllers.values[con])
        kept = (one for one in self.sets.values[queue] if self.messages.values[one].tag in (0, tag))
        return self.sets.number(tuple(kept))

    def _drop_for_runtime(self, queue: int, run: int, _: int) -> int:
        tag = tag_of(self.runtimes.values[run])
        if run == self.none:
            return 0
        kept = (one for one in self.sets.values[queue] if self.messages.values[one].tag in (0, tag))
        return self.sets.number(tuple(kept))

    def _hear(self, heard: int, sent: tuple[int, ...]) -> int:
        signed_ones = {
            one for one in sent if isinstance(self.messages.values[one].content, records.SignedRecord)
        }
        return (
            self.sets.number(tuple(sorted(signed_ones | set(self.sets.values[heard]))))
            if signed_ones
            else heard
        )

    def _forget(self, heard: int, run: int, con: int) -> int:
        """Of sessions that neither side is in, ``_forged`` says one of each kind."""
        tags = {tag_of(self.runtimes.values[run]), tag_of(self.controllers.values[con])} - {0}
        return self.sets.number(
            tuple(one for one in self.sets.values[heard] if self.messages.values[one].tag in tags)
        )

    # ------------------------------------------------------------ the runtime

    def _runtime_alone(self, run: int, *_: int) -> list[Change]:
        side = self.runtimes.values[run]
        if side is None:
            return []
        return self._distinct(run, (*self._runtime_events(side), *self._runtime_acts(run, side)))

    def _runtime_events(self, side: RuntimeSide) -> Iterable[Change]:
        state, world = side.interlock, self.world
        link = link_open(state)
        feed = partial(self._feed_runtime, side)
        yield feed("operator", r.Said(r.Word.STOP), sound=True)
        if state.phase is r.Phase.PERMITTED:
            yield feed("operator", r.Said(r.Word.START), sound=True)
        if state.phase is r.Phase.HELD:
            yield feed("operator", r.Said(r.Word.ACKNOWLEDGE), sound=True)
            yield feed("operator", r.Said(r.Word.RESET), sound=True)
        yield feed("clock", r.Tick(), sound=True, late_s=LATE)
        if link:
            yield feed("clock", r.HeartbeatLost(), sound=True)
        if state.phase is r.Phase.VERIFYING:
            yield from self._verdicts(feed)
        for commit in side.commits:
            durable = r.RecordDurable(commit.token)
            yield feed("disk", durable, sound=True)
            if world.disk:
                yield feed("disk", durable, late_s=COMMIT_OLD)
                yield feed("disk", durable, late_s=SAMPLE_OLD)
                yield feed("disk", durable, first=r.JointsMeasured(OFF_START))
        if world.disk:
            yield feed("operator", r.Said(r.Word.QUIT))
            yield feed("disk", r.LogChanged(replace(state.log, writable=False)))
        if world.bone:
            yield feed("operator", r.Said(r.Word.WITHDRAW))
        if world.latches:
            yield feed("shell", r.Failed(StopCause.SECOND_NODE, ""))

    def _verdicts(self, feed: Callable[..., Change]) -> Iterable[Change]:
        yield feed("worker", r.VerdictReady(VERDICT), sound=True)
        if self.world.disk:
            yield feed("worker", r.VerdictReady(replace(VERDICT, admissible=False)))
            yield feed("worker", r.VerdictReady(replace(VERDICT, approach=None)))
            yield feed("worker", r.VerdictReady(replace(VERDICT, limits=records.digest(OTHER_LIMITS))))
            yield feed("worker", r.VerdictReady(replace(VERDICT, request=TOKEN - 1)))

    def _runtime_acts(self, run: int, side: RuntimeSide) -> Iterable[Change]:
        state = side.interlock
        if link_open(state):
            code = r.HEARTBEAT_CODE.get(state.phase, RuntimeCode.INHIBIT)
            beat = c.HeartbeatReceived(code, state.epoch, state.cause, fresh=True)
            yield Change(Move("runtime", "sends its heartbeat", True), run, (self._message(side, beat),))
        if self.world.crashes:
            yield Change(Move("runtime", "its process dies", False), self.none)

    def _feed_runtime(
        self,
        side: RuntimeSide,
        actor: str,
        event: r.Event,
        *,
        sound: bool = False,
        late_s: float = 0.0,
        first: r.Event | None = None,
    ) -> Change:
        state = side.interlock
        if first is not None:
            state, _ = self.runtime_step(state, first, NOW)
        after, effects = self.runtime_step(state, event, NOW + late_s)
        seen = replace(side, interlock=state)
        wrong = invariants.runtime_step(seen, event, after, effects)
        commits = list(side.commits)
        if isinstance(event, r.RecordDurable):
            commits = [commit for commit in commits if commit.token != event.token]
        commits += [replace(one, record=one.record) for one in effects if isinstance(one, r.Commit)]
        following = RuntimeSide(after, tuple(commits))
        sent = tuple(
            message for effect in effects for message in self._sent_by_runtime(state, following, effect)
        )
        move = Move(actor, describe(event) + lateness(late_s, first), sound, wrong)
        return Change(move, self.runtimes.number(canonical_runtime(following)), sent)

    def _sent_by_runtime(self, before: r.Interlock, after: RuntimeSide, effect: r.Effect) -> list[int]:
        match effect:
            case r.Send(record=records.Open() as request):
                return [self.messages.number(Message(0, c.OpenReceived(request, 1)))]
            case r.Send(record=record):
                if isinstance(record, records.Permit):
                    digest_of(record)
                if isinstance(record, records.SignedRecord):
                    record = signed(record)
                return [self._message(after, record)]
            case r.SendBlock():
                return [
                    self._message(after, c.PathChecked(fixed.PATH.body(), Refusal.ACCEPTED, 0, fixed.ENDS))
                ]
            case r.SendStop(code=code, cause=cause) if link_open(before):
                return [self._message(RuntimeSide(before), c.StopReceived(code, cause_class(cause)))]
        return []

    def _message(self, side: RuntimeSide | c.Controller, content: Any) -> int:
        return self.messages.number(Message(tag_of(side), content))

    # ------------------------------------------------------------ the controller

    def _controller_alone(self, con: int, *_: int) -> list[Change]:
        state = self.controllers.values[con]
        return self._distinct(con, (*self._controller_events(state), *self._controller_acts(con, state)))

    def _controller_events(self, state: c.Controller) -> Iterable[Change]:
        world, inputs = self.world, state.inputs
        feed = partial(self._feed_controller, state)
        yield feed(
            "person", c.InputsChanged(replace(inputs, device_pressed=not inputs.device_pressed)), sound=True
        )
        if world.emergency_stop:
            clear = not inputs.emergency_stop_clear
            yield feed("person", c.InputsChanged(replace(inputs, emergency_stop_clear=clear)), sound=clear)
        if state.session is not None:
            yield feed("clock", c.HeartbeatLost(), sound=True)
        yield feed("clock", c.Tick(), sound=True, late_s=LATE)
        yield feed("plant", c.PathFinished(), sound=True, first=c.JointsMeasured(fixed.START_JOINTS))
        yield feed("plant", c.PathFinished(), first=c.JointsMeasured(OFF_START))
        yield feed("shell", c.Fault(StopCause.SEQUENCE_ERROR))
        if world.latches:
            yield feed("shell", c.Fault(StopCause.SECOND_NODE))
        if world.bone:
            yield feed("sensor", c.BoneMoved())
        if world.limits:
            original = fixed.LIMITS.body()
            changed = OTHER_LIMITS if state.holdings.limits == original else original
            yield feed("person", c.LimitsChanged(changed), sound=changed == original)

    def _controller_acts(self, con: int, state: c.Controller) -> Iterable[Change]:
        if state.session is not None:
            view = r.ControllerView(
                state.state,
                state.cause,
                state.epoch,
                state.inputs.device_pressed,
                state.inputs.emergency_stop_clear,
                state.cutting_mode,
            )
            beat = self._message(state, r.HeartbeatReceived(view, fresh=True))
            yield Change(Move("controller", "sends its heartbeat", True), con, (beat,))
        if self.world.reboots:
            boot = BOOTS[(BOOTS.index(state.identity.boot_nonce) + 1) % 2]
            again = c.Controller.powered_up(
                replace(state.identity, boot_nonce=boot),
                replace(state.holdings, path=None, ends=None),
                state.memory,
            )
            again = replace(again, epoch=EPOCH + 1, inputs=state.inputs)
            move = Move("controller", "reboots", False)
            yield Change(move, self.controllers.number(again), (), True)
        if self.world.limits and state.state is not ControllerState.CUTTING:
            yield from self._silent_changes(state)

    def _silent_changes(self, state: c.Controller) -> Iterable[Change]:
        held = state.holdings
        changes = [("its limits change without a word", replace(held, limits=OTHER_LIMITS))]
        if held.path is not None:
            changes.append(("a bit of the stored path flips", replace(held, path=FLIPPED_PATH)))
        for text, holdings in changes:
            after = self.controllers.number(replace(state, holdings=holdings))
            yield Change(Move("controller", text, False), after)

    def _feed_controller(
        self,
        state: c.Controller,
        actor: str,
        event: c.Event,
        *,
        sound: bool = False,
        late_s: float = 0.0,
        first: c.Event | None = None,
        message: Message | None = None,
    ) -> Change:
        at_hand = self.controller_step(state, first, NOW)[0] if first is not None else state
        after, effects = fixed.settled(at_hand, event, NOW + late_s, self.controller_step)
        wrong = invariants.controller_step(state, event, after, message)
        sent = tuple(one for effect in effects for one in self._sent_by_controller(state, effect, effects))
        stopped = any(isinstance(effect, c.SendFault) for effect in effects) or after.epoch != state.epoch
        move = Move(actor, describe(event) + lateness(late_s, first), sound, wrong)
        return Change(move, self.controllers.number(canonical_controller(after)), sent, stopped)

    def _sent_by_controller(
        self, before: c.Controller, effect: c.Effect, effects: tuple[c.Effect, ...]
    ) -> list[int]:
        match effect:
            case c.Send(record=records.Limits() as limits, session=tag):
                return [self.messages.number(Message(tag, Parameters(limits.body())))]
            case c.Send(record=records.Calibration() | records.Tool()):
                return []
            case c.Send(record=records.PathStored() as stored, session=tag):
                return [self.messages.number(Message(tag, Stored(stored)))]
            case c.Send(record=records.Reply() as reply, session=tag):
                return [self.messages.number(Message(tag, _reply(reply)))]
            case c.Send(record=record, session=tag):
                return [self.messages.number(Message(tag, record))]
            case c.SendFault(code=code, cause=cause) if before.session is not None:
                return [self._message(before, r.FaultReceived(code, cause_class(cause)))]
        return []

    # ------------------------------------------------------------ arrivals

    def _to_controller(self, con: int, number: int, taken: int) -> list[Change]:
        state, message = self.controllers.values[con], self.messages.values[number]
        if message.tag != 0 and message.tag != tag_of(state):
            return []
        feed = partial(self._feed_controller, state, "runtime > controller", message=message)
        match message.content:
            case c.HeartbeatReceived() as beat:
                found = [feed(beat, sound=True), feed(replace(beat, fresh=False))]
            case c.PathChecked() as event if state.state in (ControllerState.OPEN, ControllerState.LOADED):
                found = [feed(event, sound=True)]
                if self.world.disk:
                    found.append(feed(replace(event, refusal=Refusal.POSE_OUTSIDE_LIMITS)))
            case c.PathChecked():
                found = []
            case records.NonceRequest(purpose=purpose):
                found = [feed(c.NonceRequested(purpose, fresh_nonce(purpose, taken)), sound=True)]
            case records.SignedRecord() as record:
                found = self._signed(feed, record)
            case records.Acknowledge(cause=cause):
                found = [feed(c.AcknowledgeReceived(cause, 1), sound=True)]
            case records.Collect():
                found = [feed(c.CollectReceived(), sound=True)]
            case event:
                found = [feed(event, sound=True)]
        return found

    def _signed(self, feed: Callable[..., Change], record: Any) -> list[Change]:
        """Permit, start and reset: looked at in time or too late, the arm at its start or away from it."""
        if isinstance(record, records.Reset):
            reset = c.ResetReceived(record, 1)
            return [feed(reset, sound=True), feed(reset, late_s=NONCE_OLD)]
        standing, away = c.JointsMeasured(fixed.START_JOINTS), c.JointsMeasured(OFF_START)
        permit = isinstance(record, records.Permit)
        event = c.PermitReceived(record, 1) if permit else c.StartReceived(record, 1)
        too_late_s = PERMIT_OLD if permit else NONCE_OLD
        return [
            feed(event, sound=True, first=standing),
            feed(event, first=standing, late_s=too_late_s),
            feed(event, first=away),
        ]

    def _to_runtime(self, run: int, number: int, _: int) -> list[Change]:
        side, message = self.runtimes.values[run], self.messages.values[number]
        if side is None or message.tag not in (0, tag_of(side)):
            return []
        state, content = side.interlock, message.content
        feed = partial(self._feed_runtime, side, "controller > runtime", sound=True)
        standing = r.JointsMeasured(fixed.START_JOINTS)
        match content:
            case r.HeartbeatReceived() | r.FaultReceived() if not link_open(state):
                return []
            case r.HeartbeatReceived():
                stale = feed(replace(content, fresh=False))
                stale = stale._replace(move=stale.move._replace(sound=False))
                return [feed(content, first=standing), stale]
            case Parameters(limits=limits):
                return [self._parameters(side, limits)]
            case Stored(stored=stored):
                mid, _ = self.runtime_step(state, r.BlockStored(0), NOW)
                event = r.PathStored(r.Stored(stored.digest, stored.refusal, stored.pose))
                return [
                    self._feed_runtime(
                        replace(side, interlock=mid),
                        "controller > runtime",
                        event,
                        sound=True,
                        first=standing,
                    )
                ]
            case records.Opened():
                return [feed(r.SessionOpened(content.epoch, content.state, content.cause))]
            case records.Nonce():
                return [feed(r.NonceReceived(content.purpose, content.nonce, content.epoch))]
            case records.Reply() as reply:
                pressed = reply.detail != 0
                return [feed(r.ReplyReceived(reply.request_type, reply.refusal, reply.cause, pressed))]
            case r.Announced():
                return [feed(content)]
        return [feed(content)]

    def _parameters(self, side: RuntimeSide, limits: bytes) -> Change:
        """Three records one after the other; the last one is judged."""
        state = side.interlock
        for record in (fixed.CALIBRATION, fixed.TOOL):
            state, _ = self.runtime_step(state, r.ParameterReceived(record), NOW)
        event = r.ParameterReceived(records.Limits.parse(limits))
        if state.phase is not side.interlock.phase:  # it stopped at the first one
            return self._feed_runtime(side, "controller > runtime", event, sound=True)
        return self._feed_runtime(replace(side, interlock=state), "controller > runtime", event, sound=True)

    def _both(self, run: int, con: int, _: int) -> list[Change]:
        """An announcement, and a person who starts another session: what needs a look at both sides."""
        side, state = self.runtimes.values[run], self.controllers.values[con]
        known = state.memory.named | state.memory.withdrawn
        if side is None and known and not self.world.again:
            return []
        if side is None:
            last = next((one for one in REGISTRATIONS if one in state.memory.named), REGISTRATIONS[0])
            other = next(one for one in REGISTRATIONS if one != last)
            stands = last not in state.memory.withdrawn
            found = [("starts a session", last)] if stands or self.world.bone else []
            if self.world.bone or not found:
                found.append(("starts a session with a new registration", other))
            return [
                Change(
                    Move("person", text, True),
                    self.runtimes.number(
                        RuntimeSide(replace(FRESH, job=replace(JOB, registration=registration)))
                    ),
                )
                for text, registration in found
            ]
        if state.session is not None:
            return []
        nonce = next(
            nonce
            for nonce in RUNTIME_NONCES
            if side.interlock.session is None or side.interlock.session.runtime_nonce != nonce
        )
        event = r.Announced(announce(state.identity.boot_nonce), nonce)
        changes = [self._feed_runtime(side, "controller > runtime", event, sound=True)]
        if side.interlock.phase is r.Phase.OPENING:
            changes.append(self._feed_runtime(side, "controller > runtime", event, sound=True, late_s=1.0))
        return self._distinct(run, changes)

    # ------------------------------------------------------------ the attacker

    def _forged(self, con: int, *_: int) -> list[int]:
        """What he may say to the controller besides the signed records he has heard in these sessions."""
        state = self.controllers.values[con]
        tag, boot = tag_of(state), state.identity.boot_nonce
        earlier = replace(fixed.OPEN, boot_nonce=boot, runtime_nonce=EARLIER_NONCE)
        said = [Message(0, c.OpenReceived(earlier, 1))]
        contents: list[Any] = [
            *(records.NonceRequest(purpose=purpose) for purpose in Purpose),
            records.Collect(),
            records.Acknowledge(cause=state.cause),
            c.StopReceived(StopCode.END, StopCause.OPERATOR_STOP),
        ]
        said += [Message(tag, content) for content in contents]
        said += [
            Message(tag, c.HeartbeatReceived(code, state.epoch, StopCause.NONE, fresh=False))
            for code in RuntimeCode
        ]
        for of_boot in (boot, OLD_BOOT):
            said += [Message(tag, record, old=True) for record in earlier_records(of_boot)]
        said += [Message(tag, forged) for forged in _forged_records(state)]
        return [self.messages.number(message) for message in said] if tag else [self.messages.number(said[0])]

    def _forged_answers(self, run: int, *_: int) -> list[int]:
        """Old replies, nonces and announcements to the runtime."""
        side = self.runtimes.values[run]
        if side is None or side.interlock.session is None:
            return []
        state = side.interlock
        said: list[Any] = [
            *(
                records.Reply(kind.TYPE, 1, refusal, StopCause.NONE, 0)
                for kind in (records.Permit, records.Start, records.Reset)
                for refusal in (Refusal.ACCEPTED, Refusal.NOT_IN_STATE)
            ),
            *(records.Nonce(purpose=purpose, nonce=DEAD_NONCE, epoch=state.epoch) for purpose in Purpose),
            r.Announced(announce(OLD_BOOT), RUNTIME_NONCES[0]),
        ]
        if state.phase is r.Phase.OPENING:
            said = said[-1:]
        return [self._message(side, content) for content in said]

    # ------------------------------------------------------------ for people

    def _distinct(self, side: int, changes: Iterable[Change]) -> list[Change]:
        """Without what changes nothing and says nothing, unless it is wrong."""
        return [one for one in changes if one.side != side or one.sent or one.stopped or one.move.wrong]

    def text(self, message: int) -> str:
        """A message in a few words."""
        return describe(self.messages.values[message].content)

    def unpack(self, key: int) -> SimpleNamespace:
        """The state's concrete values."""
        run, con, up, down, heard = (key >> BITS * index & MASK for index in range(5))
        return SimpleNamespace(
            runtime=self.runtimes.values[run],
            controller=self.controllers.values[con],
            up=[self.messages.values[one] for one in self.sets.values[up]],
            down=[self.messages.values[one] for one in self.sets.values[down]],
            heard=[self.messages.values[one] for one in self.sets.values[heard]],
        )


# ---------------------------------------------------------------- small parts


def link_open(state: r.Interlock) -> bool:
    """Whether the runtime's single frames flow: from the answer to OPEN on."""
    return state.phase not in (r.Phase.WAITING, r.Phase.OPENING, *r.ENDED)


def fresh_nonce(purpose: Purpose, taken: int) -> bytes:
    """The first name of this purpose that nothing refers to."""
    return next(
        nonce for nonce, bit in NONCES.items() if nonce.startswith(purpose.name.encode()) and not bit & taken
    )


def announce(boot: bytes) -> records.Announce:
    """The controller without a session, of this boot."""
    return replace(builders.ANNOUNCE, boot_nonce=boot)


def earlier_records(boot: bytes) -> list[Any]:
    """Permit, start and reset of an earlier session of ``boot``, for the same job; the epoch is the present one."""
    session = records.session_digest(boot, EARLIER_NONCE)
    permit = replace(fixed.PERMIT, nonce=DEAD_NONCE, boot_nonce=boot, session_digest=session, epoch=EPOCH)
    start = replace(
        fixed.START, nonce=DEAD_NONCE, session_digest=session, permit_digest=digest_of(permit), epoch=EPOCH
    )
    cause = cause_class(fixed.RESET.cause)
    reset = replace(fixed.RESET, nonce=DEAD_NONCE, session_digest=session, epoch=EPOCH, cause=cause)
    return [signed(permit), signed(start), signed(reset)]


def _forged_records(state: c.Controller) -> list[Any]:
    """Permit, start and reset for the present session, epoch and nonce, which all can be read on the bus; wrong code."""
    if state.session is None or state.issued is None:
        return []
    names = {"nonce": state.issued.nonce, "epoch": state.epoch, "session_digest": state.session.digest}
    permit = replace(fixed.PERMIT, boot_nonce=state.identity.boot_nonce, **names)
    held = state.permit.digest if state.permit else permit.digest
    digest_of(permit)
    found = (
        permit,
        replace(fixed.START, permit_digest=held, **names),
        replace(fixed.RESET, cause=state.memory.latched, **names),
    )
    return [record.with_mac(bytes(15) + b"x") for record in found]


def _reply(reply: records.Reply) -> records.Reply:
    """Without what the runtime does not look at."""
    told_apart = (Refusal.ACCEPTED, Refusal.MAC_INVALID)
    refusal = reply.refusal if reply.refusal in told_apart else Refusal.NOT_IN_STATE
    return replace(reply, request_sequence=1, refusal=refusal, cause=StopCause.NONE)
