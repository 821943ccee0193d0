"""What must hold after every step of any sequence of events, and: every phase is reached, and can be left."""

from collections import deque
from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st

from cutgate.protocol import records
from cutgate.protocol.states import ControllerState, RuntimeCode, StopCause
from cutgate.runtime.interlock.phases import AUTHORISING, ENDED, MOVING
from cutgate.runtime.interlock.state import (
    Commit,
    Interlock,
    Phase,
    RecordDurable,
    Send,
    SendStop,
)
from cutgate.runtime.interlock.table import WITHDRAWAL_UNHEARD
from tests.runtime.interlock.builders import (
    FRESH,
    NOW,
    PERMISSIVENESS,
    STRAIGHT_ON,
    Event,
    beat,
    code,
    durable,
    enabled,
    events,
    in_phase,
    opened,
    sound_beat,
    step,
    stops,
)

PICKS = 200


def _next(state: Interlock, pick: int) -> Event:
    """Two times in three what a sound controller and a patient operator do next, else anything."""
    if pick % 3 and state.phase in STRAIGHT_ON:
        onward = STRAIGHT_ON[state.phase](state)
        return onward[pick % len(onward)]
    choice = [*events(state), sound_beat(state)]
    return choice[pick % len(choice)]


def _as_committed(record: records.Record) -> records.Record:
    """Before anybody knew the log up to it."""
    return record if isinstance(record, records.Reset) else replace(record, log=records.NO_TREE_HEAD)


class Watch:
    """Follows one session from outside and knows only what left and what was committed."""

    def __init__(self, state: Interlock) -> None:
        self.state = state
        self.committed: dict[int, Commit] = {}
        self.durable: set[int] = set()
        self.start_left = state.phase in MOVING

    def step(self, event: Event, now_s: float) -> None:
        before = self.state
        if isinstance(event, RecordDurable) and event.token in self.committed:
            self.durable.add(event.token)
        after, effects = step(before, event, now_s)
        self.state = after
        for effect in effects:
            if isinstance(effect, Commit):
                assert effect.token not in self.committed, "a token serves once"
                self.committed[effect.token] = effect
        self._nothing_leaves_that_is_not_durable(before, event, effects)
        self._the_code_follows_what_left(before, after, effects)
        self._stopped_stays_stopped(before, after, effects)

    def _nothing_leaves_that_is_not_durable(self, before, event, effects) -> None:
        for record in enabled(effects):
            assert isinstance(event, RecordDurable)
            assert before.phase in AUTHORISING
            assert event.token in self.durable
            assert self.committed[event.token].record == _as_committed(record)

    def _the_code_follows_what_left(self, before, after, effects) -> None:
        left = {type(effect.record) for effect in effects if isinstance(effect, Send)}
        if records.Start in left:
            self.start_left = True
        if stops(effects) or after.phase not in MOVING:
            self.start_left = False
        if code(after) is RuntimeCode.CUT:
            assert self.start_left
            assert after.permit is not None
            assert after.cause is StopCause.NONE
        if PERMISSIVENESS[code(after)] > PERMISSIVENESS[code(before)]:
            assert left & {records.Permit, records.Start}

    def _stopped_stays_stopped(self, before, after, effects) -> None:
        if before.phase in ENDED:
            assert (after, effects) == (before, ())
        if before.phase is Phase.STOPPING:
            assert after.phase in (Phase.STOPPING, Phase.STOPPED)
            unheard = WITHDRAWAL_UNHEARD if after.phase is Phase.STOPPED else ""
            assert after.cause is before.cause
            assert after.reason in (before.reason, before.reason + unheard)
        if after.phase in (Phase.STOPPING, Phase.STOPPED, Phase.REFUSED):
            assert after.cause is not StopCause.NONE
            assert after.permit is None
        if after.phase in {Phase.STOPPING, *ENDED} and before.phase not in {Phase.STOPPING, *ENDED}:
            assert any(isinstance(effect, SendStop) for effect in effects)
        if before.registration_withdrawn:
            assert after.registration_withdrawn
        assert after.token >= before.token
        assert after.job is before.job


steps = st.lists(st.tuples(st.integers(0, PICKS * 3), st.sampled_from([0.0, 0.01, 0.02, 0.3])), max_size=60)


@settings(max_examples=120, deadline=None)
@given(start=st.sampled_from([None, *Phase]), sequence=steps)
def test_no_sequence_of_events_breaks_the_rules(start, sequence):
    state = FRESH if start is None else in_phase(start)
    if start in (Phase.STOPPING, *ENDED):
        state = replace(state, permit=None, cause=StopCause.OPERATOR_STOP)
    watch = Watch(state)
    if start in AUTHORISING:  # as if this session had committed it
        pending = step(state, durable(state.token), NOW)[1][0]
        watch.committed[state.token] = Commit(state.token, None, _as_committed(pending.record))
    now_s = NOW
    for pick, after_s in sequence:
        now_s += after_s
        watch.step(_next(watch.state, pick), now_s)


def _successors() -> dict[Phase, set[Phase]]:
    """Every phase reached from WAITING, breadth first, with the phases one event leads to."""
    edges: dict[Phase, set[Phase]] = {}
    queue, seen = deque([FRESH]), set()
    while queue:
        state = queue.popleft()
        if (state.phase, state.controller) in seen:
            continue
        seen.add((state.phase, state.controller))
        here = edges.setdefault(state.phase, set())
        now_s = NOW + 0.05 if state.phase in MOVING else NOW  # an arm that moves comes to its end
        onward = STRAIGHT_ON[state.phase](state) if state.phase in STRAIGHT_ON else ()
        held = opened(ControllerState.FAULT, StopCause.SECOND_NODE)
        chain = state
        for event in onward:
            chain, _ = step(chain, event, now_s)
            here.add(chain.phase)
            queue.append(chain)
        for event in (*events(state), held, beat(ControllerState.FAULT, epoch=state.epoch)):
            after, _ = step(state, event, now_s)
            here.add(after.phase)
            queue.append(after)
    return edges


def test_every_phase_is_reached_and_none_is_a_trap():
    edges = _successors()
    assert set(edges) == set(Phase), "no phase is unreachable"
    for phase in set(Phase) - ENDED:
        onward, known = {phase}, set()
        while onward:
            known |= onward
            onward = set().union(*(edges[one] for one in onward)) - known
        assert Phase.STOPPED in known, f"{phase} cannot be stopped"
        if phase is not Phase.STOPPING:
            assert Phase.DONE in known, f"no way leads from {phase} to the end of the cut"
