"""Any sequence of events, right and wrong in every argument, on a clock that jumps: what must hold after each.

The machine keeps its own books (what was committed, what is durable, what the controller last said) and never asks
the interlock's permissives; a failing sequence is shrunk to the shortest one.
"""

import math
from dataclasses import replace
from typing import Any

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from cutgate.protocol import records
from cutgate.protocol.states import (
    ControllerState,
    FaultCode,
    Purpose,
    Refusal,
    RuntimeCode,
    StopCause,
    StopCode,
)
from cutgate.runtime.interlock.phases import ENDED, MOVING
from cutgate.runtime.interlock.state import (
    Announced,
    BlockConfirmed,
    CommandGiven,
    Commit,
    Event,
    Failed,
    FaultReceived,
    Gone,
    HeartbeatLost,
    HeartbeatReceived,
    JointsMeasured,
    LogChanged,
    LogHealth,
    NonceReceived,
    OperatorCommand,
    ParameterReceived,
    PathConfirmed,
    Phase,
    ProgressReported,
    RecordDurable,
    ReplyReceived,
    SendStop,
    SessionOpened,
    Tick,
    UploadedPath,
    VerdictReady,
    WithdrawalSent,
    WitnessSought,
)
from tests.runtime.interlock.builders import (
    ANNOUNCE,
    ANNOUNCE_NONCE,
    BEYOND,
    CALIBRATION,
    DEADLINES,
    DURABLE_LOG,
    FOUND,
    FRESH,
    HALF_WAY,
    JOB,
    LIMITS,
    MISSED,
    NONCE,
    ON,
    PATH,
    PATH_BLOCKS,
    REQUESTS,
    RUNTIME_NONCE,
    SEEN_LOG,
    START_JOINTS,
    STRAIGHT_ON,
    TIMING,
    TOOL,
    VERDICT,
    code,
    dated,
    durable,
    enabled,
    events,
    opened,
    sound_beat,
    step,
    view,
)
from tests.runtime.interlock.builders import ELSEWHERE as FAR

OTHER = b"o" * 16
JUMPS_S = (0.0, 0.001, 0.02, 0.09, 0.3, 1.1, 2.1, 30.0, 400.0, -0.001, -0.5, -100.0)
ELSEWHERE = (*START_JOINTS[:2], START_JOINTS[2] + 600_000, *START_JOINTS[3:])
"""0.6 mm off the start joints: beyond the start's tolerance, within that of the path."""
AUTHORISED_BY = {
    Purpose.PERMIT: Phase.AUTHORISING_PERMIT,
    Purpose.START: Phase.AUTHORISING_START,
    Purpose.RESET: Phase.AUTHORISING_RESET,
}
HELD = {Phase.HELD, Phase.NONCE_RESET, Phase.AUTHORISING_RESET, Phase.RESETTING}
goals = st.one_of(
    st.sampled_from(list(AUTHORISED_BY.values())),
    st.sampled_from(sorted({*STRAIGHT_ON} - {Phase.ADMITTED, Phase.STOPPING} - HELD)),
)
causes = st.sampled_from(StopCause)
refusals = st.sampled_from([Refusal.ACCEPTED, *Refusal])


def mostly(right: Any, *wrong: Any) -> st.SearchStrategy[Any]:
    """The right value, or one of the wrong ones."""
    return st.one_of(st.just(right), st.sampled_from(wrong))


def while_in(*phases: Phase) -> Any:
    """Offer a rule in these phases; elsewhere ``something`` stands for it."""
    return precondition(lambda self: self.state.phase in phases)


class AnySession(RuleBasedStateMachine):
    """One session of the runtime, followed from outside."""

    def __init__(self) -> None:
        super().__init__()
        self.now_s = 1000.0
        self.begin()

    def begin(self) -> None:
        """The interlock as it is made, nothing in the books."""
        self.state = FRESH
        self.committed: dict[int, records.Record] = {}
        self.pending: int | None = None
        self.committed_at_s = 0.0
        self.started = False
        self.alive = False
        """The last heartbeat was fresh, in the session's epoch, without cause, the emergency stop clear."""
        self.pressed = False
        self.withdrawn = False
        self.authentic = self.nothing_seen = self.found = self.permitted = False
        self.confirmed: set[str] = set()
        self.barrier_us = records.NO_TIME
        self.joints_u: tuple[int, ...] | None = None
        self.measured_s = 0.0

    # ------------------------------------------------------------ one step, and what must hold after it

    def feed(self, event: Event) -> None:
        before, event = self.state, dated(event, self.now_s)
        self._see(event)
        after, effects = step(before, event, self.now_s)
        self.state = after
        self._nothing_enables_but_the_pending_durable_record(event, effects)
        self._books(effects)
        self._a_stop_stops(before, event, effects)
        self._the_order_to_cut_needs_its_start(effects)
        self._only_a_heartbeat_is_believed(before, event)
        assert after.job is before.job
        assert after.token >= before.token

    def _see(self, event: Event) -> None:
        match event:
            case HeartbeatReceived(seen, fresh):
                sound = seen.cause is StopCause.NONE and seen.emergency_stop_clear
                self.alive = fresh and sound and seen.epoch == self.state.epoch
                self.pressed = seen.device_pressed
                self.permitted = seen.state is ControllerState.PERMITTED
            case SessionOpened(said, True) if self.state.phase is Phase.OPENING:
                self.authentic = True
                self.nothing_seen = said.log == records.NO_TREE_HEAD
            case WitnessSought(found, _):
                self.found = found
            case WithdrawalSent(barrier_us):
                self.barrier_us = barrier_us
            case CommandGiven(OperatorCommand.CONFIRM, what) if self.state.phase is Phase.ADMITTED:
                self.confirmed.add(what)
            case JointsMeasured(joints_u, measured_s):
                self.joints_u, self.measured_s = joints_u, measured_s
            case CommandGiven(OperatorCommand.WITHDRAW):
                self.withdrawn = True

    def _nothing_enables_but_the_pending_durable_record(self, event, effects) -> None:
        for record in enabled(effects):
            assert isinstance(event, RecordDurable)
            assert event.token == self.pending
            assert 0.0 <= self.now_s - self.committed_at_s <= DEADLINES.commit_deadline_s
            committed = self.committed[event.token]
            if not isinstance(record, records.Reset):
                assert (record.log, committed.log) == (DURABLE_LOG, records.NO_TREE_HEAD)
                committed = replace(committed, log=DURABLE_LOG)
            assert record == committed
            assert record.nonce == self.state.nonce
            assert self.alive
            assert self.state.log.writable
            if not isinstance(record, records.Reset):
                assert not self.withdrawn
                assert self.joints_u == VERDICT.start_joints_u
                assert 0.0 <= self.now_s - self.measured_s <= TIMING.timeout_s
                assert self.authentic
                assert self.nothing_seen or self.found or "WITNESS" in self.confirmed
                assert not self.barrier_us >= JOB.registration_time_us
            if isinstance(record, records.Start):
                assert self.pressed
                assert self.permitted
                self.started = True

    def _books(self, effects) -> None:
        if self.state.phase not in AUTHORISED_BY.values():
            self.pending = None
        for effect in effects:
            if isinstance(effect, Commit):
                assert effect.token not in self.committed, "a token serves once"
                assert self.state.phase is AUTHORISED_BY[effect.purpose]
                self.committed[effect.token] = effect.record
                self.pending, self.committed_at_s = effect.token, self.now_s

    def _a_stop_stops(self, before, event, effects) -> None:
        after, sent = self.state, [effect for effect in effects if isinstance(effect, SendStop)]
        over = {Phase.STOPPING, *ENDED}
        if before.phase in ENDED:
            assert (after, effects) == (before, ())
            return
        if before.phase is Phase.STOPPING:
            assert after.phase in (Phase.STOPPING, Phase.STOPPED)
            assert after.cause is before.cause, "the first cause is kept"
            assert after.reason.startswith(before.reason)
        elif after.phase in over:
            assert sent, "nothing ends without a word to the controller"
            assert after.phase is Phase.DONE or after.permit is None
            assert (after.cause is StopCause.NONE) == (after.phase is Phase.DONE)
        if any(stop.code is StopCode.STOP for stop in sent):
            assert after.phase in (Phase.STOPPING, Phase.STOPPED)
            assert (after.permit, after.nonce) == (None, None)
            assert step(after, durable(after.token), self.now_s)[0] == after, "its record is dead"
        if self._must_stop(before, event):
            assert after.phase in over
        if sent:
            self.started = False

    @staticmethod
    def _must_stop(before, event) -> bool:
        match event:
            case (
                CommandGiven(OperatorCommand.STOP)
                | CommandGiven(OperatorCommand.WITHDRAW)
                | HeartbeatLost()
                | FaultReceived()
                | Failed()
                | Gone()
            ):
                return True
            case JointsMeasured(joints_u):
                return before.phase in MOVING and joints_u == FAR
            case ProgressReported(segment):
                return before.phase in MOVING and segment > 1
            case LogChanged(log):
                return before.log.writable and not log.writable
        return False

    def _the_order_to_cut_needs_its_start(self, effects) -> None:
        if code(self.state) is RuntimeCode.CUT:
            assert self.started
            assert self.state.tracking is not None
            assert self.state.permit is not None
            assert self.state.cause is StopCause.NONE
        if code(self.state) is RuntimeCode.READY:
            assert replace(self.state.permit, log=records.NO_TREE_HEAD) in self.committed.values()

    def _only_a_heartbeat_is_believed(self, before, event) -> None:
        """What a session does next because the controller has accepted something, a heartbeat has shown."""
        shown = {
            Phase.PERMITTING: Phase.PERMITTED,
            Phase.STARTING: Phase.CUTTING,
            Phase.RESETTING: Phase.COLLECTING,
        }
        if self.state.phase is shown.get(before.phase):
            assert isinstance(event, HeartbeatReceived)
            assert event.view.epoch == before.epoch
            assert event.view.cause is StopCause.NONE

    @invariant()
    def what_was_withdrawn_stays_withdrawn(self) -> None:
        assert self.state.registration_withdrawn >= (self.withdrawn and self.state.phase not in ENDED)

    # ------------------------------------------------------------ what can happen

    @initialize(goal=goals)
    def as_far_as(self, goal) -> None:
        if goal is Phase.AUTHORISING_RESET:
            self.as_far_as(Phase.OPENING)
            self.the_controller_is_held(StopCause.SECOND_NODE)
        while self.state.phase is not goal:
            self.onward(goal)

    @precondition(lambda self: self.state.phase in ENDED)
    @rule(goal=goals)
    def an_ended_session_answers_to_nothing_and_another_begins(self, goal) -> None:
        for event in events(self.state):
            self.feed(event)
        self.begin()
        self.as_far_as(goal)

    @while_in(Phase.OPENING)
    @rule(cause=causes)
    def the_controller_is_held(self, cause) -> None:
        self.feed(opened(ControllerState.FAULT, cause))

    @rule(goal=st.none())
    def onward(self, goal) -> None:
        """What a sound controller and a patient operator do next, up to ``goal``."""
        for event in STRAIGHT_ON.get(self.state.phase, lambda _state: ())(self.state):
            if self.state.phase is not goal:
                self.now_s += 0.01
                self.feed(event)

    @rule(by_s=st.sampled_from(JUMPS_S))
    def the_clock_jumps(self, by_s) -> None:
        self.now_s += by_s
        self.feed(Tick())

    @rule(pick=st.integers(0, 200))
    def something(self, pick) -> None:
        offered = events(self.state)
        self.feed(offered[pick % len(offered)])

    @while_in(Phase.WAITING, Phase.OPENING)
    @rule(
        announced=mostly(ANNOUNCE_NONCE, OTHER, bytes(16)),
        nonce=mostly(RUNTIME_NONCE, OTHER, bytes(16)),
        version=mostly(records.PROTOCOL_VERSION, 0),
        serial=mostly("SIM-1", "SIM-2"),
    )
    def announced(self, announced, nonce, version, serial) -> None:
        announce = replace(ANNOUNCE, announce_nonce=announced, protocol_version=version, serial=serial)
        self.feed(Announced(announce, nonce))

    @while_in(Phase.WAITING, Phase.OPENING)
    @rule(
        epoch=mostly(3, 0, 31),
        state=st.sampled_from(ControllerState),
        cause=causes,
        authentic=mostly(True, False),
        due=mostly(0, 1),
        log=mostly(SEEN_LOG, records.NO_TREE_HEAD),
    )
    def opened(self, epoch, state, cause, authentic, due, log) -> None:
        self.feed(opened(state, cause, epoch=epoch, authentic=authentic, withdrawal_due=due, log=log))

    @rule(said=mostly(FOUND, MISSED))
    def witness(self, said) -> None:
        self.feed(said)

    @rule(later_us=mostly(-1, 0, 1))
    def barrier(self, later_us) -> None:
        self.feed(WithdrawalSent(JOB.registration_time_us + later_us))

    @while_in(Phase.ADMITTED)
    @rule(what=mostly("WITNESS", "CUT_TINY"))
    def confirmed_by_name(self, what) -> None:
        self.feed(CommandGiven(OperatorCommand.CONFIRM, what))

    @while_in(Phase.OPENING, Phase.COLLECTING)
    @rule(record=mostly(TOOL, LIMITS, CALIBRATION, replace(TOOL, length_u=1)))
    def parameter(self, record) -> None:
        self.feed(ParameterReceived(record))

    @while_in(Phase.COLLECTING, Phase.UPLOADING)
    @rule(index=st.integers(0, PATH_BLOCKS))
    def block_stored(self, index) -> None:
        self.feed(BlockConfirmed(index))

    @while_in(Phase.COLLECTING, Phase.UPLOADING)
    @rule(digest=mostly(PATH.digest, bytes(32)), refusal=refusals)
    def path_stored(self, digest, refusal) -> None:
        self.feed(PathConfirmed(UploadedPath(digest, refusal, 0)))

    @while_in(Phase.UPLOADING, Phase.VERIFYING)
    @rule(
        late=mostly(0, 1, -1),
        admissible=st.booleans(),
        path=mostly(VERDICT.path, bytes(32)),
        approach=mostly(VERDICT.approach, None),
    )
    def verdict(self, late, admissible, path, approach) -> None:
        changes = {"request": self.state.token + late, "admissible": admissible, "path": path}
        self.feed(VerdictReady(replace(VERDICT, **changes, approach=approach)))

    @while_in(Phase.NONCE_RESET, Phase.NONCE_PERMIT, Phase.NONCE_START)
    @rule(purpose=st.sampled_from(Purpose), nonce=mostly(NONCE, OTHER), off=mostly(0, 1, -1))
    def nonce(self, purpose, nonce, off) -> None:
        self.feed(NonceReceived(purpose, nonce, self.state.epoch + off))

    @while_in(Phase.OPENING, Phase.HELD, Phase.RESETTING, Phase.PERMITTING, Phase.STARTING)
    @rule(
        request=st.sampled_from(REQUESTS),
        refusal=refusals,
    )
    def reply(self, request, refusal) -> None:
        self.feed(ReplyReceived(request.TYPE, refusal, StopCause.NONE))

    @rule(
        state=st.sampled_from(ControllerState),
        cause=mostly(StopCause.NONE, *StopCause),
        off=mostly(0, 1, -1),
        pressed=st.booleans(),
        clear=mostly(True, False),
        fresh=mostly(True, False),
    )
    def any_beat(self, state, cause, off, pressed, clear, fresh) -> None:
        changes = {"cause": cause, "epoch": self.state.epoch + off, "device_pressed": pressed}
        self.feed(HeartbeatReceived(view(state, **changes, emergency_stop_clear=clear), fresh))

    @rule(pressed=st.booleans(), clear=mostly(True, False), fresh=mostly(True, False))
    def a_beat_that_fits(self, pressed, clear, fresh) -> None:
        beat = sound_beat(self.state, device_pressed=pressed, emergency_stop_clear=clear)
        self.feed(replace(beat, fresh=fresh))

    @rule(
        event=st.one_of(
            st.builds(FaultReceived, st.sampled_from(FaultCode), causes),
            st.builds(Failed, causes, st.just("the shell found something")),
            st.builds(Gone, causes, st.just("the program failed")),
            st.just(HeartbeatLost()),
            st.just(LogChanged(LogHealth(False, 2000, 1000))),
            st.sampled_from(
                [
                    CommandGiven(OperatorCommand.STOP),
                    CommandGiven(OperatorCommand.WITHDRAW),
                    CommandGiven(OperatorCommand.QUIT),
                ]
            ),
        )
    )
    def something_stops(self, event) -> None:
        self.feed(event)

    @rule(joints_u=mostly(START_JOINTS, ELSEWHERE), age_s=mostly(0.0, 0.09, 0.11, -0.01, math.inf))
    def measured(self, joints_u, age_s) -> None:
        self.feed(JointsMeasured(joints_u, self.now_s - age_s))

    @while_in(*MOVING)
    @rule(
        event=st.sampled_from(
            [
                HALF_WAY,
                JointsMeasured(FAR, math.nan),
                ON,
                BEYOND,
                ProgressReported(0, 0),
                ProgressReported(2, 0),
            ]
        )
    )
    def the_arm_moves(self, event) -> None:
        self.feed(event)

    @while_in(*AUTHORISED_BY.values())
    @rule(off=mostly(0, 1, -1), after_s=mostly(0.01, 0.0, 0.5, 1.5, -0.01))
    def durable(self, off, after_s) -> None:
        self.now_s += after_s
        self.feed(durable(self.state.token + off))

    @rule(reserved=mostly(2000, 0, 1999))
    def log(self, reserved) -> None:
        self.feed(LogChanged(LogHealth(True, reserved, 1000)))

    @rule(word=st.sampled_from([OperatorCommand.START, OperatorCommand.RESET, OperatorCommand.ACKNOWLEDGE]))
    def said(self, word) -> None:
        self.feed(CommandGiven(word))


AnySession.TestCase.settings = settings(
    max_examples=350, stateful_step_count=20, deadline=None, derandomize=True
)
TestAnySession = AnySession.TestCase
