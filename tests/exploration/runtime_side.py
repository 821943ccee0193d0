"""The runtime's real table, and everything that can happen to it, with what it sends."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import cutgate.runtime.interlock.table
from cutgate.firmware_sim import state as c
from cutgate.protocol import records
from cutgate.protocol.states import (
    ControllerState,
    FaultCode,
    Purpose,
    Refusal,
    StopCause,
)
from cutgate.runtime.interlock import state as r
from cutgate.runtime.interlock.phases import ENDED, PHASES
from tests.exploration import attacker, invariants
from tests.exploration.canonical import NOW, canonical_runtime, cause_class
from tests.exploration.labels import ARRIVED, COMMIT_OLD, LATE, SAMPLE_OLD, describe, lateness
from tests.exploration.names import (
    BARRIER_US,
    BOOT,
    CUT,
    EARLIER_BARRIER_US,
    EARLIER_BOOT,
    EARLIER_EPOCH,
    EPOCH,
    LIVE,
    NEXT_BOOT,
    TAG,
    TOKEN,
    Message,
    Passing,
    RuntimeSide,
    digest_of,
)
from tests.exploration.world import (
    FOUND,
    FRESH,
    MISSED,
    OFF_START,
    OTHER_LIMITS,
    PERMIT_LOG,
    START_LOG,
    VERDICT,
    WARNED,
    Change,
    Move,
    Numbers,
    World,
    distinct,
)
from tests.firmware_sim import controllers as fixed

STANDING, AWAY = (r.JointsMeasured(joints_u, NOW) for joints_u in (fixed.START_JOINTS, OFF_START))
"""At the start, which is on the path as well; off both."""
ORDERS = (r.Phase.STARTING, r.Phase.CUTTING)


class Heard(NamedTuple):
    """What a runtime can be told beyond what anybody can say.

    Attributes:
        live_nonce: a nonce that counts was given.
        told: what the controller's heartbeat has said in the runtime's session.
        opened: its OPEN was accepted, and no stop has come since.
    """

    live_nonce: bool
    told: frozenset[ControllerState]
    opened: bool


NOTHING = Heard(live_nonce=False, told=frozenset(), opened=False)
EVERYTHING = Heard(live_nonce=True, told=frozenset(attacker.TOLD), opened=True)


class Runtime:
    """Every runtime met, by number, and what can happen to it.

    Args:
        world: what may happen.
        step: the table under test.
    """

    def __init__(self, world: World, step: Callable[..., Any] | None = None) -> None:
        self.world, self.step = world, step or cutgate.runtime.interlock.table.step
        self.sides = Numbers()
        self.none = self.sides.number(None)
        self.known: dict[RuntimeSide, int] = {}
        self.attacked: dict[tuple[int, Heard], list[Change]] = {}
        self.cut = 0
        """The bits of those whose heartbeat says CUT in the controller's present epoch and the present session."""
        self.recovery: dict[int, list[Change]] = {}

    def fresh(self) -> int:
        """A process that has just begun."""
        return self.sides.number(RuntimeSide(FRESH))

    def changes(self, number: int, heard: Heard) -> list[Change]:
        """Everything: its own acts, people, disk, clock, whatever anybody can say to it, and what the controller has said.

        Args:
            number: which runtime.
            heard: what it can be told beyond what anybody can say.
        """
        key = number, heard
        if key not in self.attacked:
            side = self.sides.values[number]
            if side is None:
                found = []
            elif heard.live_nonce:
                found = [*self.changes(number, heard._replace(live_nonce=False)), *self._nonce_said(side)]
            elif heard.told:
                found = [
                    *self.changes(number, heard._replace(told=frozenset())),
                    *self._told(side, heard.told),
                ]
            elif heard.opened:
                feed = partial(self.feed, side, "bus > runtime")
                found = [*self.changes(number, NOTHING), *self._opened(feed, side.interlock, EPOCH)]
            else:
                found = [*self._own(side), *self._said(side)]
            self.attacked[key] = distinct(number, found)
        return self.attacked[key]

    def own(self, number: int) -> list[Change]:
        """What happens to it without faults, but for arrivals."""
        if number not in self.recovery:
            side = self.sides.values[number]
            found = [] if side is None else [*self._own(side), *self._beats(side)]
            self.recovery[number] = distinct(number, [one for one in found if one.move.sound])
        return self.recovery[number]

    # ------------------------------------------------------------ its own, people, disk, clock

    def _own(self, side: RuntimeSide) -> Iterable[Change]:
        state = side.interlock
        feed = partial(self.feed, side)
        yield feed("operator", r.CommandGiven(r.OperatorCommand.STOP), sound=True)
        yield feed("operator", r.CommandGiven(r.OperatorCommand.START), sound=True)
        yield feed("operator", r.CommandGiven(r.OperatorCommand.ACKNOWLEDGE), sound=True)
        yield feed("operator", r.CommandGiven(r.OperatorCommand.RESET), sound=True)
        yield feed("operator", r.CommandGiven(r.OperatorCommand.QUIT), sound=True)
        yield feed("clock", r.Tick(), sound=True, late_s=LATE, deviates=state.tracking is not None)
        if link_open(state):
            yield feed("clock", r.HeartbeatLost(), sound=True)
        if state.phase is r.Phase.VERIFYING:
            yield from self._verdicts(feed)
        if state.phase is r.Phase.FINISHING:
            yield feed("arm", STANDING, sound=True)
        for commit in side.commits:
            yield from self._durable(feed, durable(commit))
        yield feed("shell", r.Failed(StopCause.SECOND_NODE, ""))
        yield feed("shell", r.Gone(StopCause.INTERNAL_ERROR, ""))
        if self.world.disk:
            yield feed("disk", r.LogChanged(replace(state.log, writable=False)))
        if self.world.bone:
            yield feed("operator", r.CommandGiven(r.OperatorCommand.WITHDRAW))
        if self.world.warned:
            yield feed("operator", r.CommandGiven(r.OperatorCommand.CONFIRM, *WARNED.to_confirm), sound=True)
            yield feed("operator", r.CommandGiven(r.OperatorCommand.CONFIRM, r.WITNESS))
            yield feed("operator", r.CommandGiven(r.OperatorCommand.CONFIRM, "ANOTHER"))
            if is_sought(state):
                yield feed("disk", FOUND)
                yield feed("disk", MISSED)
        over = Passing.SESSION if state.session else 0
        yield Change(Move("runtime", "its process dies"), self.none, (), over)

    def _durable(self, feed: Callable[..., Change], durable: r.RecordDurable) -> Iterable[Change]:
        yield feed("disk", durable, sound=True)
        if self.world.disk:
            yield feed("disk", durable, late_s=COMMIT_OLD)
            yield feed("disk", durable, late_s=SAMPLE_OLD)
            yield feed("disk", durable, first=AWAY)

    def _verdicts(self, feed: Callable[..., Change]) -> Iterable[Change]:
        yield feed("worker", r.VerdictReady(WARNED if self.world.warned else VERDICT), sound=True)
        if self.world.disk:
            yield feed("worker", r.VerdictReady(replace(VERDICT, admissible=False)))
            yield feed("worker", r.VerdictReady(replace(VERDICT, approach=None)))
            yield feed("worker", r.VerdictReady(replace(VERDICT, limits=records.digest(OTHER_LIMITS))))
            yield feed("worker", r.VerdictReady(replace(VERDICT, request=TOKEN - 1)))

    def _beats(self, side: RuntimeSide) -> Iterable[Change]:
        state = side.interlock
        if link_open(state):
            code = PHASES[state.phase].heartbeat
            beat = c.HeartbeatReceived(code, state.epoch, state.cause, fresh=True)
            move = Move("runtime", "sends its heartbeat", sound=True)
            yield Change(move, self.sides.number(side), (Message(tag_of(side), beat),))

    # ------------------------------------------------------------ what is said to it

    def _said(self, side: RuntimeSide) -> Iterable[Change]:
        state = side.interlock
        feed = partial(self.feed, side, "bus > runtime")
        if state.phase in (r.Phase.WAITING, r.Phase.OPENING):
            for late_s in (0.0, 1.0):
                yield feed(attacker.announced(BOOT), late_s=late_s)
                yield feed(attacker.announced(EARLIER_BOOT), late_s=late_s)
            if state.phase is r.Phase.OPENING:
                yield feed(attacker.announced(NEXT_BOOT))
        else:
            yield feed(attacker.announced(BOOT))
        if state.session is None:
            return
        for event in attacker.unsigned_records():
            yield feed(event)
        yield from self._opened(feed, state, EARLIER_EPOCH)
        yield feed(r.PathConfirmed(attacker.STORED), first=STANDING)
        if link_open(state):
            for cause in attacker.causes(self.world):
                yield feed(r.FaultReceived(FaultCode.LATCHED, cause))
            yield from self._beats_said(feed, state)
        if state.tracking is not None:
            yield from self._tracked(feed)

    def _opened(self, feed: Callable[..., Change], state: r.Interlock, epoch: int) -> Iterable[Change]:
        """The answer to its OPEN, given in this epoch."""
        for event in attacker.opened(self.world, epoch) if state.phase is r.Phase.OPENING else ():
            yield feed(event)
            if event.opened.withdrawal_due:  # since before this registration
                yield feed(event, barrier_us=EARLIER_BARRIER_US)

    def _beats_said(self, feed: Callable[..., Change], state: r.Interlock) -> Iterable[Change]:
        """All that need not have been told, and what a link that is at fault lets through."""
        forged = self.world.link in ("runtime: tag", "runtime: session")
        for beat in attacker.heartbeats(attacker.causes(self.world), state.epoch):
            must_be_told = self._must_be_told(state, beat)
            if forged or not must_be_told:
                yield from self._beat(feed, state, beat, forged=must_be_told)

    def _must_be_told(self, state: r.Interlock, beat: r.HeartbeatReceived) -> bool:
        """Whether this phase believes it, so that it comes only once the controller has said it; elsewhere it stops."""
        return (
            beat.view.state in attacker.TOLD and beat.view.epoch == state.epoch and state.phase in BELIEVING
        )

    def _told(self, side: RuntimeSide, told: frozenset[ControllerState]) -> Iterable[Change]:
        """What the controller's heartbeat has said in this session, now or held back."""
        state = side.interlock
        if link_open(state):
            feed = partial(self.feed, side, "bus > runtime")
            for beat in attacker.heartbeats(attacker.causes(self.world), state.epoch):
                if self._must_be_told(state, beat) and beat.view.state in told:
                    yield from self._beat(feed, state, beat)

    def _beat(
        self,
        feed: Callable[..., Change],
        state: r.Interlock,
        beat: r.HeartbeatReceived,
        *,
        forged: bool = False,
    ) -> Iterable[Change]:
        early = state.phase in ORDERS and beat.view.state is ControllerState.DONE
        yield feed(beat, first=STANDING, deviates=early, forged=forged)
        if early:
            yield feed(beat, first=STANDING, late_s=ARRIVED, forged=forged)

    def _tracked(self, feed: Callable[..., Change]) -> Iterable[Change]:
        """Joints and progress of an arm that is where it was verified, and of one that is not, in each way."""
        yield feed(STANDING)
        yield feed(AWAY, deviates=True)
        yield feed(attacker.ONWARD)
        yield feed(attacker.TOO_FAR, deviates=True)
        yield feed(attacker.BEFORE, first=attacker.ONWARD, deviates=True)
        yield feed(attacker.NOWHERE, deviates=True)

    def _nonce_said(self, side: RuntimeSide) -> Iterable[Change]:
        """The nonce that the controller has given, for any purpose: everybody on the bus has read it."""
        for purpose in Purpose if side.interlock.session else ():
            yield self.feed(side, "bus > runtime", r.NonceReceived(purpose, LIVE, EPOCH))

    def hears(self, number: int, content: Any) -> Change:
        """A message of the real controller arrives, in time."""
        side = self.sides.values[number]
        feed = partial(self.feed, side, "controller > runtime", sound=True)
        match content:
            case r.HeartbeatReceived():
                done = content.view.state is ControllerState.DONE
                return feed(content, first=STANDING, late_s=ARRIVED if done else 0.0)
            case records.Opened():
                return feed(r.SessionOpened(content, authentic=True))
            case records.Limits() | records.Calibration() | records.Tool():
                return feed(r.ParameterReceived(content))
            case records.PathStored(digest=digest, refusal=refusal, pose=pose):
                return feed(r.PathConfirmed(r.UploadedPath(digest, refusal, pose)), first=STANDING)
            case records.Nonce():
                return feed(r.NonceReceived(content.purpose, content.nonce, content.epoch))
            case records.Reply() as reply:
                return feed(r.ReplyReceived(reply.request_type, reply.refusal, reply.cause))
            case r.Announced():
                return feed(content, late_s=1.0)
        return feed(content)

    # ------------------------------------------------------------ one step

    def feed(
        self,
        side: RuntimeSide,
        actor: str,
        event: r.Event,
        *,
        sound: bool = False,
        late_s: float = 0.0,
        first: r.Event | None = None,
        deviates: bool = False,
        forged: bool = False,
        barrier_us: int = BARRIER_US,
    ) -> Change:
        """One step of the real table, judged, and what it sends.

        Args:
            deviates: by it the arm is not where it may be.
            barrier_us: what a Withdraw tells that leaves with it.
        """
        state = side.interlock
        if first is not None:
            state, _ = self.step(state, first, NOW)
        after, effects = self.step(state, event, NOW + late_s)
        for effect in effects:
            answer = answered(effect, barrier_us)
            if answer is not None:
                after, more = self.step(after, answer, NOW + late_s)
                effects += more
        wrong = invariants.runtime_step(
            replace(side, interlock=state), event, after, effects, deviates=deviates, forged=forged
        )
        commits = [
            commit
            for commit in side.commits
            if not (isinstance(event, r.RecordDurable) and commit.token == event.token)
        ]
        commits += [one for one in effects if isinstance(one, r.Commit)]
        following = RuntimeSide(after, tuple(commits))
        sent = tuple(message for effect in effects for message in sent_by(state, following, effect))
        number = self.known.get(following)
        if number is None:
            number = self.known[following] = self.sides.number(canonical_runtime(present(following)))
            if says_cut(self.sides.values[number]):
                self.cut |= 1 << number
        left = state.session is not None and (number == self.none or after.session != state.session)
        move = Move(actor, describe(event) + lateness(late_s, first), sound, wrong)
        return Change(move, number, sent, Passing.SESSION if left else 0)


BELIEVING = frozenset(
    {
        r.Phase.PERMITTING,
        r.Phase.PERMITTED,
        r.Phase.NONCE_START,
        r.Phase.AUTHORISING_START,
        *ORDERS,
        r.Phase.FINISHING,
    }
)
"""Where what the controller's heartbeat tells leads on, or lets the phase last."""


def durable(commit: r.Commit) -> r.RecordDurable:
    """The log goes on from permit to start."""
    log = START_LOG if isinstance(commit.record, records.Start) else PERMIT_LOG
    return r.RecordDurable(commit.token, log)


def answered(effect: r.Effect, barrier_us: int) -> r.Event | None:
    """What the shell answers at once: a Withdraw has left."""
    return r.WithdrawalSent(barrier_us) if isinstance(effect, r.SendWithdraw) else None


def is_sought(state: r.Interlock) -> bool:
    """Whether the log that the controller saw last is being looked up."""
    return state.opened is not None and state.opened.log != records.NO_TREE_HEAD and state.witness is None


def present(side: RuntimeSide) -> RuntimeSide:
    """The announce nonce that its OPEN names is the present one."""
    session = side.interlock.session
    if session is None or session.announce_nonce != NEXT_BOOT:
        return side
    session = replace(session, request=replace(session.request, announce_nonce=BOOT))
    return replace(side, interlock=replace(side.interlock, session=session))


def says_cut(side: RuntimeSide | None) -> bool:
    """Whether its heartbeat orders motion from a controller that listens."""
    if side is None or tag_of(side) != TAG or side.interlock.epoch != EPOCH:
        return False
    return PHASES[side.interlock.phase].heartbeat is CUT.code


def link_open(state: r.Interlock) -> bool:
    """Whether the runtime's single frames flow: from the answer to OPEN on."""
    return state.phase not in (r.Phase.WAITING, r.Phase.OPENING, *ENDED)


def tag_of(side: RuntimeSide | None) -> int:
    """The session it is in, 0 for none."""
    session = side.interlock.session if side else None
    return session.tag if session else 0


def sent_by(before: r.Interlock, after: RuntimeSide, effect: r.Effect) -> list[Message]:
    """What an effect puts on the bus."""
    match effect:
        case r.Send(record=records.Open() as request):
            named = BOOT if request.announce_nonce == NEXT_BOOT else request.announce_nonce
            return [Message(0, replace(request, announce_nonce=named))]
        case r.Send(record=records.SignedRecord() as record):
            if isinstance(record, records.Permit):
                digest_of(record)
            return [Message(tag_of(after), record)]
        case r.SendWithdraw(place=place):
            return [Message(tag_of(after), records.Withdraw(place, BARRIER_US))]
        case r.Send(record=record):
            return [Message(tag_of(after), record)]
        case r.SendBlock():
            path = c.PathChecked(fixed.PATH.body(), Refusal.ACCEPTED, 0, fixed.ENDS)
            return [Message(tag_of(after), path)]
        case r.SendStop(code=code, cause=cause) if link_open(before) or before.phase is r.Phase.OPENING:
            return [Message(tag_of(RuntimeSide(before)), c.StopReceived(code, cause_class(cause)))]
    return []
