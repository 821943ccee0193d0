"""Continuations without faults: whatever is said arrives at once, in order, before anything else happens."""

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace

from cutgate.runtime.interlock import state as r
from tests.exploration.model import Model, State
from tests.exploration.names import Message, rename_message
from tests.exploration.runtime_side import EVERYTHING, tag_of
from tests.exploration.world import Change, Move

DELIVERIES = 50
"""Answers to answers end before this."""

LAST = ("says stop", "says quit", "HeartbeatLost", "Tick, deadline passed")
"""What leads away from the cut is tried last."""


class Recovery:
    """The moves of a world in which nothing goes wrong.

    Args:
        model: the two sides; the same numbers.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self.ways: dict[tuple[int, int], list[tuple[Move, State]]] = {}

    def moves(self, state: State) -> Iterator[tuple[Move, State]]:
        """Every move of one side, a person, disk or clock, with all that is said on it delivered and answered."""
        run, con, said = state
        model = self.model
        if run == model.runtime.none:
            yield from ((move, reached) for move, reached in model.starts(con, said) if move.sound)
        for change in sorted(model.runtime.own(run), key=lambda one: one.move.text in LAST):
            yield change.move, self._delivered(state, change, by_runtime=True)
        for change in sorted(model.controller.own(con), key=lambda one: one.move.text in LAST):
            yield change.move, self._delivered(state, change, by_runtime=False)

    def follow(self, texts: Iterable[str]) -> State:
        """The state after these moves, each named as ``who: what``, from the beginning."""
        state = self.model.begin()
        for text in texts:
            state = next(
                reached for move, reached in self.moves(state) if f"{move.actor}: {move.text}" == text
            )
        return state

    def _delivered(self, state: State, change: Change, *, by_runtime: bool) -> State:
        up: deque[Message] = deque()
        down: deque[Message] = deque()
        for _ in range(DELIVERIES):
            state = self._applied(state, change, by_runtime, up, down)
            run, con, _said = state
            while up and not self._reaches_controller(up[0], con):
                up.popleft()
            while down and down[0].tag not in (0, tag_of(self.model.runtime.sides.values[run])):
                down.popleft()
            if not up and (run == self.model.runtime.none or not down):
                return state
            by_runtime = not up
            if up:
                change = self.model.controller.hears(con, up.popleft())
            else:
                change = self.model.runtime.hears(run, down.popleft().content)
        raise AssertionError("the two sides answer each other without end")

    def _reaches_controller(self, message: Message, con: int) -> bool:
        session = self.model.controller.states.values[con].session
        return message.tag == 0 or (session is not None and message.tag == session.tag)

    def _applied(
        self, state: State, change: Change, by_runtime: bool, up: deque[Message], down: deque[Message]
    ) -> State:
        """The state after one side's change; what is under way is renamed with it."""
        run, con, said = state
        if by_runtime:
            up.extend(change.sent)
            sent = self.model.kept(change.sent) | self.model.orders(run, change.side)
            run = change.side
            con, said = self.model.with_runtime(con, said, sent, change.passing)
        else:
            con = change.side
            said = self.model.with_controller(said, change).said
            run = self.model.real_runtime(run, change.passing) if change.passing else run
        for messages in (up, down):
            renamed = [rename_message(one, change.passing) for one in messages]
            messages.clear()
            messages.extend(renamed)
        if not by_runtime:
            down.extend(change.sent)
        return run, con, said


def stuck(model: Model, controllers: Iterable[int]) -> list[int]:
    """The controllers from which, without a process and with an empty bus, no recovery way leads to motion.

    Nothing is taken as said or as so on the way.
    """
    exact = Model(replace(model.world, exact=True), model.runtime.step, model.controller.step)
    recovery, good, found = Recovery(exact), set(), []
    for con in controllers:
        begin = exact.controller.number(model.controller.states.values[con])
        way = _way(recovery, (exact.runtime.none, begin, exact.quiet), good)
        good.update(way)
        if not way:
            found.append(con)
    return found


def _way(recovery: Recovery, start: State, good: set[tuple[int, int]]) -> list[tuple[int, int]]:
    """The states of a way from ``start`` to motion or to what is known to be ``good``, depth first; empty if none."""
    states = recovery.model.controller.states.values
    path, visited = [(start[:2], recovery.moves(start))], {start[:2]}
    while path:
        (run, con), moves = path[-1]
        if (run, con) in good or states[con].may_move:
            return [key for key, _ in path]
        for _move, (run, con, _said) in moves:
            if (run, con) not in visited:
                visited.add((run, con))
                path.append(((run, con), recovery.moves((run, con, recovery.model.quiet))))
                break
        else:
            path.pop()
    return []


def runtimes_that_do_not_end(model: Model) -> list[int]:
    """Those that the operator's stop does not end, whatever arrives meanwhile.

    Every runtime stops at that word; a stopping one can do nothing but stay so or end, and ends at its deadline.
    """
    sides = model.runtime.sides.values

    def ends(number: int) -> bool:
        side = sides[number]
        return side is None or side.interlock.phase is r.Phase.STOPPING

    found = []
    for number in range(1, len(sides)):
        if ends(number):
            led = [one.side for one in model.runtime.changes(number, EVERYTHING)]
            waited = [one.side for one in model.runtime.own(number)]
            if not all(map(ends, led)) or model.runtime.none not in waited:
                found.append(number)
        elif not all(ends(one.side) for one in model.runtime.own(number) if one.move.text == LAST[0]):
            found.append(number)
    return found
