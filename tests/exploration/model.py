"""The two sides together, with a bus that is the attacker: what every state leads to.

A state of the world is the runtime's side (interlock and records on their way to the disk; none: no process), the
controller, and what of the runtime's words nobody else could say: the records with its code, and its OPEN.
Sets of runtimes are the bits of one number: what happens to the controller happens with each of them alike, so
that whole sets are led on at once (``runtimes_after``, ``renamed_runtimes``).
"""

from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import Any, NamedTuple

from cutgate.firmware_sim import state as c
from cutgate.protocol import records
from cutgate.protocol.states import StopCause
from tests.exploration import invariants
from tests.exploration.controller_side import Controller, told
from tests.exploration.names import (
    CUT,
    EARLIER_PLACE,
    EARLIER_TAG,
    EPOCH,
    KINDS,
    SESSION,
    STALE,
    TAG,
    Message,
    Passing,
    Quiet,
    Told,
    is_past,
    rename_controller,
    rename_message,
    rename_runtime,
    stale,
)
from tests.exploration.runtime_side import Heard, Runtime
from tests.exploration.world import Change, Move, Numbers, World

State = tuple[int, int, int]
"""A runtime, a controller and what has been said, by number."""
Key = tuple[int, int]
"""A controller and what has been said."""


class Step(NamedTuple):
    """A move of one side: its new number, what was said in all by then, what ceased to be the present one."""

    move: Move
    side: int
    said: int
    passing: int


Groups = dict[tuple[int, int], int]
"""Runtimes after a move, by what they said with it and by what ceased to be the present one."""

SETS = 4096
"""So many sets of runtimes are remembered with what becomes of them: hundreds of controllers are met with each."""


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
        self.runtime, self.controller = Runtime(world, runtime_step), Controller(world, controller_step)
        self.messages = Numbers()
        self.quiet, self.stale = (
            1 << self.messages.number(Message(0, Quiet(stale=stale))) for stale in (False, True)
        )
        self.memo: dict[Any, Any] = {}
        self.runtimes_after = lru_cache(SETS)(self._runtimes_after)
        self.renamed_runtimes = lru_cache(SETS)(self._renamed_runtimes)

    def begin(self) -> tuple[int, int, int]:
        """No process, the controller as the world begins, nothing said."""
        return self.runtime.none, self.controller.states.number(self.world.begin), self.quiet

    # ------------------------------------------------------------ one state

    def moves(self, run: int, con: int, said: int) -> Iterator[tuple[Move, tuple[int, int, int]]]:
        """Every enabled move with the state it leads to."""
        if run == self.runtime.none:
            yield from self.starts(con, said)
        for step in self.of_runtime(run, self.heard(con, said)):
            following, now = self.with_runtime(con, said, step.said, step.passing)
            yield step.move, (step.side, following, now)
        for step in self.of_controller(con, said):
            renamed = self.renamed_runtime(run, step.passing)
            if renamed is None:
                yield step.move, (self.runtime.none, *self.without_runtime(step))
            else:
                yield step.move, (renamed, step.side, step.said)
        move, following, now = self.ages(con, said, cuts=bool(self.runtime.cut >> run & 1))
        yield move, (run, following, now)

    def ages(self, con: int, said: int, *, cuts: bool) -> tuple[Move, int, int]:
        """A time-out passes: of the runtime's heartbeats what it says now is fresh, or nothing that orders motion is.

        A controller that moved by what has aged has lost the heartbeat meanwhile. All that it heard instead is a move.
        """
        key = "ages", con, said, cuts
        found = self.memo.get(key)
        if found is None:
            state, link = self.controller.states.values[con], self.world.link
            following, now, upheld = con, said, False
            if cuts and link == "controller: round":
                now |= self.stale
            if not cuts:
                upheld = self._upheld_by_a_fault(said)
                fresh = self._bits(said, lambda message: message.content == CUT)
                passing = 0
                if state.may_move and not upheld:
                    change = self.controller.feed(state, "clock", c.HeartbeatLost())
                    following, passing = change.side, change.passing
                now = self.after(said & ~fresh, passing, following)
            text = "a time-out passes" + (", with heartbeats CUT that the link must refuse" if upheld else "")
            wrong = self._outlasts(self.controller.states.values[following], now)
            found = self.memo[key] = Move("clock", text, wrong=wrong), following, now
        return found

    def _upheld_by_a_fault(self, said: int) -> bool:
        """Whether a link that is at fault hears CUT as fresh although the runtime says it no longer."""
        match self.world.link:
            case "controller: tag" | "controller: session":
                return True
            case "controller: round":
                return bool(said & self.stale)
            case "controller: arrival":
                return bool(self._bits(said, lambda message: message.content == CUT))
        return False

    def _bits(self, said: int, which: Callable[[Message], bool]) -> int:
        return sum(1 << bit for bit, one in enumerate(self.messages.values) if said >> bit & 1 and which(one))

    def _outlasts(self, state: c.Controller, said: int) -> str | None:
        fresh = any(message.content == CUT for message in self.said(said))
        return invariants.outlasts(state.may_move, fresh)

    def starts(self, con: int, said: int) -> list[tuple[Move, State]]:
        """A person starts a session: for the last registration, for an earlier one, for a new one."""
        fresh, state = self.runtime.fresh(), self.controller.states.values[con]
        found = [(Move("person", "starts a session", sound=True), (fresh, con, said))]
        bone = self.world.bone
        if not bone:
            return found
        swapped = self.with_runtime(con, said, 0, Passing.REGISTRATION)
        found.append((Move("person", "starts a session for an earlier registration"), (fresh, *swapped)))
        barred = self.with_runtime(con, said, 0, Passing.REGISTRATION | Passing.OLD)
        move = Move("person", "starts a session for a registration before the barrier")
        found.append((move, (fresh, *barred)))
        session = state.session
        in_session = session is not None and session.place == EARLIER_PLACE
        new = Passing.NEW if in_session else Passing.NEW | Passing.REGISTRATION
        move = Move("person", "starts a session with a new registration", sound=True)
        found.append((move, (fresh, *self.with_runtime(con, said, 0, new))))
        return found

    def heard(self, con: int, said: int) -> Heard:
        """Whether a nonce has been given that still counts, and what the controller has told in the runtime's session."""
        key = "heard", con, said
        found = self.memo.get(key)
        if found is None:
            told = frozenset(one.content.state for one in self.said(said) if isinstance(one.content, Told))
            state = self.controller.states.values[con]
            session = state.session
            opened = session is not None and session.digest == SESSION and session.live
            found = self.memo[key] = Heard(state.issued is not None, told, opened)
        return found

    def of_runtime(self, run: int, heard: Heard) -> list[Step]:
        """Moves of the runtime; ``said`` is what it says with them."""
        key = "runtime", run, heard
        found = self.memo.get(key)
        if found is None:
            steps = [self._runtime_step(run, one) for one in self.runtime.changes(run, heard)]
            found = self.memo[key] = self._distinct(run, 0, steps)
        return found

    def _runtime_step(self, run: int, change: Change) -> Step:
        """One that is past is led on by itself (``alone``); here its process has died."""
        side = self.settled(change.side)
        if self.past(side):
            return Step(change.move, self.runtime.none, 0, change.passing | Passing.SESSION)
        return Step(change.move, side, self.kept(change.sent) | self.orders(run, change.side), change.passing)

    def past(self, run: int) -> bool:
        return not self.world.exact and is_past(self.runtime.sides.values[run])

    def without_runtime(self, step: Step) -> Key:
        """The controller and what was said, after a move of the controller behind which the runtime is past."""
        return self.with_runtime(step.side, step.said, 0, Passing.SESSION)

    def of_controller(self, con: int, said: int) -> list[Step]:
        """Moves of the controller after all this was said."""
        key = "controller", con, said
        found = self.memo.get(key)
        if found is None:
            changes = list(self.controller.changes(con))
            for message in self.said(said):
                if not isinstance(message.content, Quiet | Told):
                    changes += self.controller.repeated(con, message)
            steps = [self.with_controller(said, one) for one in changes]
            found = self.memo[key] = self._distinct(con, said, steps)
        return found

    def with_controller(self, said: int, change: Change) -> Step:
        """A move of the controller, with what its heartbeat tells from then on."""
        state = self.controller.states.values[change.side]
        now = said
        for message in told(state):
            now |= 1 << self.messages.number(message)
        now = self.after(now, change.passing, change.side)
        wrong = change.move.wrong or self._outlasts(state, now)
        return Step(
            change.move._replace(wrong=wrong),
            change.side,
            now,
            change.passing & ~(Passing.STOP | Passing.OPENED),
        )

    def orders(self, before: int, run: int) -> int:
        """That its heartbeat says CUT from now on."""
        if before == run or not self.runtime.cut >> run & 1:
            return 0
        return 1 << self.messages.number(Message(TAG, CUT))

    def with_runtime(self, con: int, said: int, sent: int, passing: int) -> tuple[int, int]:
        """The controller and what was said, after a move of the runtime."""
        if passing:
            con = self._renamed("controller", self.controller.states, con, passing, rename_controller)
            said = self.after(said, passing, con)
        if sent:
            said = self.after(said | sent, 0, con)
        return con, said

    def renamed_runtime(self, run: int, passing: int) -> int | None:
        """The runtime after a move of the controller; None if it is past."""
        if not passing:
            return run
        renamed = self.settled(self.real_runtime(run, passing))
        return None if self.past(renamed) else renamed

    def real_runtime(self, run: int, passing: int) -> int:
        """The runtime after a move of the controller, whatever it still counts for."""
        return self._renamed("runtime", self.runtime.sides, run, passing, rename_runtime)

    def settled(self, run: int) -> int:
        """Nothing counts that a runtime of an earlier boot or epoch signs; which one, and by what nonce, is forgotten."""
        side = self.runtime.sides.values[run]
        if self.world.exact or side is None or not stale(side.interlock):
            return run
        return self._renamed("runtime", self.runtime.sides, run, STALE, rename_runtime)

    # ------------------------------------------------------------ many runtimes at once

    def _runtimes_after(self, runs: int, heard: Heard) -> tuple[Groups, int, tuple[tuple[int, Move], ...]]:
        """Where every move leads these runtimes, the number of moves, and those that are wrong."""
        groups: Groups = defaultdict(int)
        count: int = 0
        wrong: list[tuple[int, Move]] = []
        for place, byte in enumerate(_bytes(runs)):
            if byte:
                key = "after", place, byte, heard
                found = self.memo.get(key)
                if found is None:
                    found = self.memo[key] = self._eight_after(place, byte, heard)
                for group, reached in found[0]:
                    groups[group] |= reached
                count += found[1]
                wrong += found[2]
        return groups, count, tuple(wrong)

    def _eight_after(self, place: int, byte: int, heard: Heard) -> tuple[Any, int, list[tuple[int, Move]]]:
        groups: Groups = defaultdict(int)
        count, wrong = 0, []
        for run in _numbers(byte, place):
            for step in self.of_runtime(run, heard):
                groups[step.said, step.passing] |= 1 << step.side
                count += 1
                if step.move.wrong:
                    wrong.append((run, step.move))
        return tuple(groups.items()), count, wrong

    def _renamed_runtimes(self, runs: int, passing: int) -> tuple[int, bool]:
        """These runtimes after a move of the controller, without those that are past; whether there are such."""
        if not passing:
            return runs, False
        renamed, past = 0, False
        for place, byte in enumerate(_bytes(runs)):
            if byte:
                key = "renamed", place, byte, passing
                found = self.memo.get(key)
                if found is None:
                    numbers = [self.renamed_runtime(run, passing) for run in _numbers(byte, place)]
                    bits = sum({1 << one for one in numbers if one is not None})
                    found = self.memo[key] = bits, None in numbers
                renamed, past = renamed | found[0], past or found[1]
        return renamed, past

    # ------------------------------------------------------------ what was said

    def said(self, said: int) -> list[Message]:
        """The messages behind the bits."""
        return [message for bit, message in enumerate(self.messages.values) if said >> bit & 1]

    def kept(self, sent: tuple[Message, ...]) -> int:
        """Of what the runtime sends: what carries its code, in the present session or for the nonce that is announced."""
        kept = 0
        for message in sent:
            content = message.content
            keyed = isinstance(content, records.SignedRecord) and not isinstance(content, records.Withdraw)
            present = self.world.exact or getattr(content, "epoch", EPOCH) == EPOCH
            if message.tag in (0, TAG) and present and keyed:
                kept |= 1 << self.messages.number(Message(TAG, content))
        return kept

    def _counts(self, content: Any, state: c.Controller) -> bool:
        """Whether it is remembered that it was said, and not taken as said already, or done already."""
        match content:
            case records.Open():
                return content.announce_nonce == state.announce_nonce
            case records.Acknowledge():
                return self.world.exact and content.epoch == EPOCH and content.cause is state.cause
            case c.HeartbeatReceived():
                return bool(content == CUT)
        issued = state.issued
        serves = (
            issued is not None and issued.nonce == content.nonce and KINDS[issued.purpose] is type(content)
        )
        if isinstance(content, records.Reset):  # a latch, and another cause of it, come with a new epoch
            serves = serves and content.cause is state.memory.latched is not StopCause.NONE
        return self.world.exact or (serves and content.epoch == EPOCH)

    def after(self, said: int, passing: int, con: int) -> int:
        """As it is named now. Of sessions that neither side is in, the attacker's earlier records stand for it."""
        key = "said", said, passing, con
        found = self.memo.get(key)
        if found is None:
            state = self.controller.states.values[con]
            session = state.session
            found, fresh = 0, False
            for message in self.said(said):
                if isinstance(message.content, Told | Quiet):
                    if isinstance(message.content, Told) and not passing & Passing.SESSION:
                        found |= 1 << self.messages.number(message)
                    if message.content == Quiet(stale=True) and not passing & (Passing.EPOCH | Passing.BOOT):
                        found |= 1 << self.messages.number(message)
                    continue
                if passing & Passing.BOOT:
                    continue
                renamed = rename_message(message, passing)
                if not self._counts(renamed.content, state):
                    continue
                held = session is not None and session.tag == EARLIER_TAG
                gone = renamed.tag == EARLIER_TAG
                if (held and not isinstance(renamed.content, records.Open)) if gone else True:
                    found |= 1 << self.messages.number(renamed)
                    fresh |= renamed.content == CUT
            self.memo[key] = found = found if fresh else found | self.quiet
        return found

    # ------------------------------------------------------------ small parts

    def _renamed(
        self, kind: str, names: Numbers, number: int, passing: int, rename: Callable[..., Any]
    ) -> int:
        key = kind, "renamed", number, passing
        found = self.memo.get(key)
        if found is None:
            found = self.memo[key] = names.number(rename(names.values[number], passing))
        return found

    def _distinct(self, side: int, said: int, steps: list[Step]) -> list[Step]:
        """One of each outcome, and none that changes nothing, unless it is wrong."""
        found: dict[Any, Step] = {}
        for step in steps:
            if step.side != side or step.passing or step.said != said or step.move.wrong:
                found.setdefault((step.side, step.passing, step.said, step.move.wrong), step)
        return list(found.values())


def _bytes(bits: int) -> bytes:
    return bits.to_bytes((bits.bit_length() + 7) // 8, "little")


def _numbers(byte: int, place: int) -> list[int]:
    return [place * 8 + bit for bit in range(8) if byte >> bit & 1]
