"""Any sequence of events, right and wrong in every argument, on a clock that jumps: what must hold after each.

The machine keeps its own books (which nonce is out, which permit was accepted, how the device moved, what the last
heartbeat said) and never asks the controller's rules; a failing sequence is shrunk to the shortest one.
"""

from dataclasses import replace
from typing import Any

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule

from cutgate.firmware_sim.state import (
    AcknowledgeReceived,
    BoneMoved,
    CollectReceived,
    Controller,
    Event,
    FaultArisen,
    HeartbeatLost,
    HeartbeatReceived,
    Inputs,
    InputsChanged,
    JointsMeasured,
    LimitsChanged,
    NonceRequested,
    OpenReceived,
    PathChecked,
    PathFinished,
    PermitReceived,
    Persist,
    ResetReceived,
    StartReceived,
    StopReceived,
    Tick,
    WithdrawReceived,
)
from cutgate.protocol import records
from cutgate.protocol.states import (
    EPOCHS,
    LATCHING,
    WITHDRAWING,
    ControllerState,
    Purpose,
    Refusal,
    RuntimeCode,
    StopCause,
    StopCode,
)
from tests.firmware_sim.controllers import (
    ENDS,
    LIMITS,
    NOW,
    OPEN,
    OTHER_LIMITS,
    PATH,
    PERMIT,
    PLACE,
    POWERED_UP,
    REGISTERED_US,
    RESET,
    START,
    START_JOINTS,
    START_LOG,
    faults,
    is_void,
    replies,
    settled,
)

C = ControllerState
OTHER = b"o" * 16
JUMPS_S = (0.0, 0.001, 0.02, 0.09, 0.3, 1.9, 2.1, 119.0, 400.0, -0.001, -0.5, -100.0)
ELSEWHERE = (*START_JOINTS[:2], START_JOINTS[2] + 600_000, *START_JOINTS[3:])
"""0.6 mm off the start joints: beyond the tolerance."""
OTHER_REGISTRATION, OTHER_PLACE = records.digest(b"another registration"), records.digest(b"another place")
causes = st.sampled_from(StopCause)


def mostly(right: Any, *wrong: Any) -> st.SearchStrategy[Any]:
    """The right value, or one of the wrong ones."""
    return st.one_of(st.just(right), st.just(right), st.sampled_from(wrong))


one_wrong = mostly(
    {},
    {"nonce": OTHER},
    {"epoch": 7},
    {"session_digest": bytes(32)},
    {"announce_nonce": OTHER},
    {"log": records.NO_TREE_HEAD},
    {"serial": "SIM-2"},
    {"limits_digest": bytes(32)},
    {"calibration_digest": bytes(32)},
    {"tool_digest": bytes(32)},
    {"path_digest": bytes(32)},
    {"registration_digest": bytes(32)},
    {"configuration_digest": bytes(32)},
    {"verifier_version": "another"},
    {"start_joints_u": ELSEWHERE},
    {"branch": records.Branch("left", 0, 1)},
    {"lifetime_s": 600},
)
"""Nothing, or one field of a permit, wrong."""


class AnyLife(RuleBasedStateMachine):
    """One controller from power-up, followed from outside."""

    def __init__(self) -> None:
        super().__init__()
        self.now_s, self.nonces = NOW, 0
        self.opened: set[records.Open] = set()
        self.moved = False
        """In this session: no Withdraw of it settles that."""
        self.begin()

    def begin(self) -> None:
        """Power-up, nothing in the books."""
        self.state = POWERED_UP
        self.out: tuple[Purpose, bytes, float] | None = None
        """The nonce that was given out last, and when."""
        self.spent: set[bytes] = set()
        self.permit: records.Permit | None = None
        self.permit_at_s = 0.0
        self.cycle = ""
        """How the enabling device moved since the permit; held since before it counts as nothing."""
        self.says_cut = False
        self.started = False
        self.opened.clear()

    # ------------------------------------------------------------ one step, and what must hold after it

    def feed(self, event: Event) -> None:
        before = self.state
        after, effects = settled(before, event, self.now_s)
        self.state = after
        self._a_request_is_accepted_only_if(before, event, effects)
        self._books(before, event, effects)
        self._a_stop_voids(before, event, effects)
        self._a_latch_is_left_by_a_reset_only(before, event, effects)
        self._only_a_key_holder_or_the_wired_input_withdraws(before, event, effects)
        self._the_same_open_never_opens_twice(before, event)
        self._cutting_and_moving()
        assert before.memory.withdrawn <= after.memory.withdrawn
        assert before.memory.earlier == after.memory.earlier
        assert before.memory.barrier_us <= after.memory.barrier_us
        assert after.awaiting is None
        assert (after.state is C.FAULT) == (after.memory.latched is not StopCause.NONE)
        if before.memory != after.memory:
            assert Persist(after.memory) in effects
        assert after.written == after.memory

    def _a_request_is_accepted_only_if(self, before: Controller, event, effects) -> None:
        if not isinstance(event, PermitReceived | StartReceived | ResetReceived):
            return
        if replies(effects) != [Refusal.ACCEPTED]:
            assert replies(effects), "a refusal has its reason"
            if not faults(effects):
                assert event.authentic
                assert self.state == replace(before, issued=None)
            return
        request, purpose = {
            PermitReceived: lambda e: (e.permit, Purpose.PERMIT),
            StartReceived: lambda e: (e.start, Purpose.START),
            ResetReceived: lambda e: (e.reset, Purpose.RESET),
        }[type(event)](event)
        assert event.authentic
        assert request.nonce not in self.spent, "a nonce serves once"
        self.spent.add(request.nonce)
        assert self.out is not None
        assert (purpose, request.nonce) == self.out[:2]
        assert 0.0 <= self.now_s - self.out[2] <= (120.0 if purpose is Purpose.PERMIT else 2.0)
        assert request.epoch == before.epoch
        if purpose is Purpose.RESET:
            assert request.cause is before.memory.latched
        if purpose is Purpose.PERMIT:
            session = before.session
            assert session is not None
            assert request.announce_nonce == session.announce_nonce
            assert request.log.size > 0
            assert request.configuration_digest == session.configuration
            assert request.verifier_version == session.verifier
        assert before.heartbeat_fresh
        assert before.inputs.emergency_stop_clear
        assert before.cause is StopCause.NONE
        if purpose is not Purpose.RESET:
            assert before.measured_u == START_JOINTS
        if purpose is Purpose.PERMIT:
            self.permit, self.permit_at_s = request, self.out[2]
            self.cycle = "" if before.inputs.device_pressed else "released"
        if purpose is Purpose.START:
            assert self.cycle == "released, then pressed"
            assert 0.0 <= self.now_s - self.permit_at_s <= 120.0
            self.started, self.says_cut = True, False
            assert request.log.log_id == self.permit.log.log_id
            assert request.log.size > self.permit.log.size
            assert self.state.memory.log == self.state.written.log == request.log

    def _books(self, before: Controller, event, effects) -> None:
        match event:
            case NonceRequested(purpose, fresh) if effects:
                self.out = (purpose, fresh, self.now_s)
            case HeartbeatReceived(code, epoch, cause, fresh):
                sound = cause is StopCause.NONE and fresh and epoch == self.state.epoch
                self.says_cut = sound and code is RuntimeCode.CUT
            case InputsChanged(inputs):
                if not inputs.device_pressed:
                    self.cycle = "released"
                elif self.cycle:
                    self.cycle = "released, then pressed"
        if faults(effects) or self.state.session is None or not before.session:
            self.out, self.permit, self.started, self.says_cut = None, None, False, False

    def _a_stop_voids(self, before: Controller, event, effects) -> None:
        after, sent = self.state, faults(effects)
        if sent:
            assert is_void(after)
            assert after.epoch == (before.epoch + 1) % EPOCHS
            first = before.memory.latched if before.state is C.FAULT else before.cause
            assert after.cause is (first if first is not StopCause.NONE else sent[0].cause)
            assert after.cause is not StopCause.NONE
            assert (after.state is C.FAULT) == (before.state is C.FAULT or sent[0].cause in LATCHING)
        elif before.state is C.FAULT and before.session and after.session is None:
            assert after.cause is before.memory.latched, "an acknowledgement ends with its session"
        elif after.cause is not before.cause:
            assert isinstance(event, AcknowledgeReceived), "the first cause is kept"
            assert event.authentic
            acknowledged = event.acknowledge
            assert (acknowledged.cause, acknowledged.epoch) == (before.cause, before.epoch)
            assert after.cause is StopCause.NONE
        if self._must_stop(before, event):
            assert sent

    def _only_a_key_holder_or_the_wired_input_withdraws(self, before: Controller, event, effects) -> None:
        after, place = self.state.memory, before.session.place if before.session else None
        listed, withdraws = {place} if place else set(), False
        match event:
            case BoneMoved():
                withdraws = True
                assert after.withdrawal_due
            case HeartbeatReceived(cause=cause) if cause in WITHDRAWING and place:
                withdraws = before.session.live or not before.session.withdrawn
                assert not withdraws or after.withdrawal_due
            case WithdrawReceived(withdraw, authentic=True) if replies(effects) == [Refusal.ACCEPTED]:
                withdraws = True
                assert withdraw.place_digest in (place, records.NO_PLACE)
                listed = {withdraw.place_digest} - {records.NO_PLACE}
                assert after.barrier_us == max(before.memory.barrier_us, withdraw.barrier_us)
                settled = not self.moved and withdraw.barrier_us > 0
                assert after.withdrawal_due == (before.memory.withdrawal_due and not settled)
        if before.session is None:
            self.moved = False
        self.moved |= isinstance(event, BoneMoved) or (withdraws and isinstance(event, HeartbeatReceived))
        if withdraws:
            assert after.withdrawn == before.memory.withdrawn | listed
        else:
            kept = (before.memory.withdrawn, before.memory.barrier_us, before.memory.withdrawal_due)
            assert (after.withdrawn, after.barrier_us, after.withdrawal_due) == kept

    def _the_same_open_never_opens_twice(self, before: Controller, event) -> None:
        if before.session is None and self.state.session is not None:
            assert isinstance(event, OpenReceived)
            assert event.authentic
            assert event.request not in self.opened
            assert event.request.announce_nonce == before.announce_nonce
            assert self.state.announce_nonce == event.fresh
            self.opened.add(event.request)
        else:
            assert self.state.announce_nonce == before.announce_nonce

    @staticmethod
    def _must_stop(before: Controller, event) -> bool:
        match event:
            case FaultArisen() | BoneMoved() | LimitsChanged() | StopReceived(StopCode.STOP, _):
                return True
            case WithdrawReceived(withdraw, authentic=True):
                own = before.session is not None and withdraw.place_digest in (
                    before.session.place,
                    records.NO_PLACE,
                )
                return own and before.cutting_mode
            case (
                PermitReceived(authentic=False)
                | StartReceived(authentic=False)
                | ResetReceived(authentic=False)
                | AcknowledgeReceived(authentic=False)
                | WithdrawReceived(authentic=False)
            ):
                return True
            case StopReceived():
                return before.state is C.CUTTING
            case HeartbeatLost():
                return before.session is not None and before.session.live
            case InputsChanged(inputs):
                pressed = before.inputs.emergency_stop_clear and not inputs.emergency_stop_clear
                return pressed or (before.state is C.CUTTING and not inputs.device_pressed)
        return False

    def _a_latch_is_left_by_a_reset_only(self, before: Controller, event, effects) -> None:
        if before.state is C.FAULT and self.state.state is not C.FAULT:
            assert isinstance(event, ResetReceived)
            assert self.state.state is C.OPEN
            assert before.cause is StopCause.NONE
        assert not (before.state is C.FAULT and self.state.cutting_mode)

    def _cutting_and_moving(self) -> None:
        state, permit = self.state, self.permit
        assert state.cutting_mode == (state.permit is not None)
        if not state.cutting_mode:
            return
        held, session = state.holdings, state.session
        assert permit == state.permit
        assert permit is not None
        assert session is not None
        assert held.path is not None
        assert session.live
        assert [permit.limits_digest, permit.calibration_digest, permit.tool_digest, permit.path_digest] == [
            records.digest(part) for part in (held.limits, held.calibration, held.tool, held.path)
        ]
        assert (permit.session_digest, permit.epoch) == (session.digest, state.epoch)
        assert permit.registration_digest == session.registration
        memory = state.memory
        assert session.place not in memory.withdrawn
        assert session.registration not in memory.earlier
        assert not memory.withdrawal_due
        assert memory.barrier_us == records.NO_TIME or session.registration_time_us > memory.barrier_us
        if state.state is C.CUTTING:
            assert memory.log == state.written.log == START_LOG
        assert state.inputs.emergency_stop_clear
        assert state.cause is StopCause.NONE
        if state.may_move:
            assert self.started
            assert self.says_cut
            assert state.inputs.device_pressed

    # ------------------------------------------------------------ what can happen

    def _nonce(self, purpose: Purpose) -> None:
        self.nonces += 1
        self.feed(NonceRequested(purpose, self.nonces.to_bytes(16, "big")))

    def _beat(self, code: RuntimeCode) -> None:
        self.feed(HeartbeatReceived(code, self.state.epoch, StopCause.NONE, fresh=True))

    @rule(wrong=one_wrong, cycled=st.booleans())
    def from_power_up_with_one_thing_wrong(self, wrong, cycled) -> None:
        self.begin()
        for asked in ({}, {}, wrong, {}):
            self.onward(asked, True, cycled, 0.01)

    @initialize(steps=st.integers(0, 7))
    def some_way(self, steps) -> None:
        for _ in range(steps):
            self.onward({}, True, True, 0.01)

    @rule(
        wrong=one_wrong,
        authentic=mostly(True, False),
        cycled=mostly(True, False),
        after_s=mostly(0.01, 3.0, 121.0),
    )
    def onward(self, wrong, authentic, cycled, after_s) -> None:
        """What a sound runtime and a patient person do next, with one thing wrong in the request."""
        self.now_s += 0.01
        match self.state.state:
            case _ if self.state.session is None:
                self.open(self._right_open() if cycled else {}, True)
            case _ if not self.state.session.live:
                self.feed(HeartbeatLost())
            case C.FAULT:
                self._beat(RuntimeCode.INHIBIT)
                self.acknowledge(None, 0, True)
                self._nonce(Purpose.RESET)
                self.now_s += after_s
                self.reset(wrong if {*wrong} <= {"nonce", "epoch"} else {}, authentic)
            case C.OPEN:
                self._beat(RuntimeCode.INHIBIT)
                self.acknowledge(None, 0, True)
                self._told_what_is_due()
                self.path(Refusal.ACCEPTED)
            case C.LOADED:
                self._beat(RuntimeCode.INHIBIT)
                self.feed(InputsChanged(Inputs(device_pressed=not cycled)))
                self.feed(JointsMeasured(START_JOINTS))
                self._nonce(Purpose.PERMIT)
                self.now_s += after_s
                self.permitted(wrong, authentic)
            case C.PERMITTED:
                self._beat(RuntimeCode.READY)
                if cycled:
                    self.feed(InputsChanged(Inputs(device_pressed=False)))
                self.feed(InputsChanged(Inputs(device_pressed=True)))
                self._nonce(Purpose.START)
                self.now_s += after_s
                self.start(wrong if {*wrong} <= {"nonce", "epoch", "log"} else {}, authentic)
            case C.CUTTING:
                self.beat(RuntimeCode.CUT, 0 if cycled else 1, StopCause.NONE, fresh=True)
            case C.DONE:
                self.feed(StopReceived(StopCode.END, StopCause.SESSION_ENDED))

    def _told_what_is_due(self) -> None:
        if self.state.memory.withdrawal_due:
            self.withdraw(records.NO_PLACE, REGISTERED_US, True)

    def _right_open(self) -> dict[str, Any]:
        """What an OPEN names for a registration that counts: of another place, and late enough."""
        memory = self.state.memory
        place = OTHER_PLACE if PLACE in memory.withdrawn else PLACE
        return {"place_digest": place, "registration_time_us": max(REGISTERED_US, memory.barrier_us + 1)}

    @rule(by_s=st.sampled_from(JUMPS_S))
    def the_clock_jumps(self, by_s) -> None:
        self.now_s += by_s
        self.feed(Tick())

    @rule(
        named=mostly(
            {},
            {"announce_nonce": OTHER},
            {"announce_nonce": POWERED_UP.announce_nonce},
            {"identity_digest": bytes(32)},
            {"runtime_nonce": OTHER},
            {"protocol_version": 0},
            {"timing": replace(OPEN.timing, permit_lifetime_s=9)},
            {"registration_digest": OTHER_REGISTRATION},
            {"place_digest": OTHER_PLACE},
            {"registration_time_us": records.NO_TIME},
        ),
        authentic=mostly(True, False),
    )
    def open(self, named, authentic) -> None:
        self.nonces += 1
        request = replace(OPEN, **({"announce_nonce": self.state.announce_nonce} | named))
        self.feed(OpenReceived(request, 1, authentic, self.nonces.to_bytes(16, "big")))

    @rule()
    def a_recorded_open(self) -> None:
        for request in sorted(self.opened, key=records.Open.body)[:1]:
            self.feed(OpenReceived(request, 1, authentic=True, fresh=OTHER))

    @rule(
        place=mostly(PLACE, OTHER_PLACE, records.NO_PLACE),
        barrier_us=st.sampled_from([-1, 1, REGISTERED_US - 1, REGISTERED_US, REGISTERED_US + 5]),
        authentic=mostly(True, False),
    )
    def withdraw(self, place, barrier_us, authentic) -> None:
        self.feed(WithdrawReceived(records.Withdraw(place, barrier_us), 6, authentic))

    @rule()
    def collect(self) -> None:
        self.feed(CollectReceived())

    @rule(refusal=mostly(Refusal.ACCEPTED, Refusal.POSE_OUTSIDE_LIMITS))
    def path(self, refusal) -> None:
        accepted = refusal is Refusal.ACCEPTED
        self.feed(PathChecked(PATH.body(), refusal, 0, ENDS if accepted else None))

    @rule(purpose=st.sampled_from(Purpose))
    def nonce(self, purpose) -> None:
        self._nonce(purpose)

    def _named(self, record: Any, wrong: dict[str, Any]) -> Any:
        """The record as it would fit now, with some of it wrong."""
        session = self.state.session.digest if self.state.session else bytes(32)
        nonce = self.out[1] if self.out else OTHER
        fitting = replace(record, nonce=nonce, epoch=self.state.epoch, session_digest=session)
        return replace(fitting, **wrong)

    @rule(
        wrong=one_wrong,
        authentic=mostly(True, False),
    )
    def permitted(self, wrong, authentic) -> None:
        session = self.state.session
        registration, announced = (
            (session.registration, session.announce_nonce) if session else (bytes(32), OTHER)
        )
        fitting = replace(PERMIT, registration_digest=registration, announce_nonce=announced)
        self.feed(PermitReceived(self._named(fitting, wrong), 2, authentic))

    @rule(
        wrong=mostly(
            {},
            {"nonce": OTHER},
            {"epoch": 7},
            {"permit_digest": bytes(32)},
            {"session_digest": OTHER * 2},
            {"log": PERMIT.log},
            {"log": replace(START.log, log_id=OTHER)},
        ),
        authentic=mostly(True, False),
    )
    def start(self, wrong, authentic) -> None:
        permit = self.permit.digest if self.permit else bytes(32)
        self.feed(StartReceived(self._named(replace(START, permit_digest=permit), wrong), 3, authentic))

    @rule(
        wrong=mostly({}, {"nonce": OTHER}, {"epoch": 7}, {"cause": StopCause.BUS_FAILED}),
        authentic=mostly(True, False),
    )
    def reset(self, wrong, authentic) -> None:
        fitting = replace(RESET, cause=self.state.memory.latched)
        self.feed(ResetReceived(self._named(fitting, wrong), 4, authentic))

    @rule(cause=st.one_of(st.none(), causes), off=mostly(0, 1, -1), authentic=mostly(True, False))
    def acknowledge(self, cause, off, authentic) -> None:
        epoch, cause = (self.state.epoch + off) % EPOCHS, self.state.cause if cause is None else cause
        self.feed(AcknowledgeReceived(records.Acknowledge(epoch, cause), 5, authentic))

    @rule(
        code=st.sampled_from(RuntimeCode),
        off=mostly(0, 1, -1),
        cause=mostly(StopCause.NONE, *StopCause),
        fresh=mostly(True, False),
    )
    def beat(self, code, off, cause, fresh) -> None:
        self.feed(HeartbeatReceived(code, self.state.epoch + off, cause, fresh))

    @rule(pressed=st.booleans())
    def device(self, pressed) -> None:
        inputs = replace(self.state.inputs, device_pressed=pressed)
        self.feed(InputsChanged(inputs))

    @rule(clear=mostly(True, False))
    def emergency_stop(self, clear) -> None:
        self.feed(InputsChanged(replace(self.state.inputs, emergency_stop_clear=clear)))

    @rule(joints_u=mostly(START_JOINTS, ELSEWHERE))
    def measured(self, joints_u) -> None:
        self.feed(JointsMeasured(joints_u))

    @rule()
    def finished(self) -> None:
        self.feed(PathFinished())

    @precondition(lambda self: self.state.session is not None)
    @rule(
        event=st.one_of(
            st.builds(StopReceived, st.sampled_from(StopCode), causes),
            st.builds(FaultArisen, causes),
            st.just(HeartbeatLost()),
            st.just(BoneMoved()),
            st.sampled_from([LimitsChanged(LIMITS.body()), LimitsChanged(OTHER_LIMITS.body())]),
        )
    )
    def something_stops(self, event) -> None:
        self.feed(event)


AnyLife.TestCase.settings = settings(
    max_examples=250, stateful_step_count=25, deadline=None, derandomize=True
)
TestAnyLife = AnyLife.TestCase
