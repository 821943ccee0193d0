"""A conversation with a controller, to any place in it and back to one that stands.

Each step raises ``DeviationError`` where the controller does something else than it must.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import can

from cutgate.protocol import records
from cutgate.protocol.frames import ControllerHeartbeat
from cutgate.protocol.link import Accepted, JointSample, Violation
from cutgate.protocol.parameters import joints_to_counts
from cutgate.protocol.states import ControllerState, Purpose, Refusal, RuntimeCode, StopCause, StopCode
from cutgate.runtime.conform.failures import DeviationError, HaltError, InconclusiveError
from cutgate.runtime.conform.heard import STANDING, Seen, shown
from cutgate.runtime.conform.sample import Reported, Sample, approach, sample
from cutgate.runtime.conform.tester import Tester

VERIFIER: Final = "conform"
CONFIGURATION: Final = records.digest(b"cutgate conform")
ANNOUNCE_WAIT_S: Final = 3.0
REGISTERED_US: Final = 1_000_000
"""When the throw-away registrations were taken: early in 1970, so that no barrier a case sets keeps a real one out."""
PERMIT_RECORDS: Final = 100
"""So many records the log is said to have at the permit."""


class Bench(Tester):
    """A tester that knows how a session goes.

    Args:
        bus: an open python-can bus.
        key: the pre-shared key, 32 bytes.
        timing: what OPEN proposes.
        reply_s: how long an answer may take.
        clock: monotonic seconds.
        wait: waits until a frame may have come, at most so many seconds.
        random: the operating system's generator.
        recorder: shown every frame that passes, with its time.
        fd: bulk records in CAN FD frames.
    """

    def __init__(
        self,
        bus: can.BusABC,
        key: bytes,
        timing: records.Timing,
        *,
        reply_s: float,
        clock: Callable[[], float],
        wait: Callable[[float], None],
        random: Callable[[int], bytes],
        recorder: Callable[[Seen], None] = lambda _seen: None,
        fd: bool = False,
    ) -> None:
        self.registration, self.place = random(32), random(32)
        """Throw-away: they name no file and no place, so that withdrawing them takes nothing away."""
        self.barrier_us = records.NO_TIME
        """As the controller said last: a registration has to be later."""
        self.announce: records.Announce | None = None
        self.reported: Reported | None = None
        self._random = random
        super().__init__(bus, key, timing, reply_s=reply_s, clock=clock, wait=wait, recorder=recorder, fd=fd)

    def begin(self) -> None:
        """Forget what the case before has heard and said."""
        super().begin()
        self.opening: records.Open | None = None
        """The OPEN of the session, with its code."""
        self.log_id = self._random(16)
        self.good: Sample | None = None

    def renew_registration(self) -> None:
        """Another throw-away registration: the one before was withdrawn."""
        self.registration, self.place = self._random(32), self._random(32)

    # ------------------------------------------------------------ to a place in the conversation

    def hello(self) -> records.Announce:
        """Wait for the next announcement. Raises HaltError without one."""
        found = self.wait_for(records.Announce, len(self.heard), ANNOUNCE_WAIT_S)
        if found is None:
            raise HaltError(f"no announcement within {ANNOUNCE_WAIT_S:g} s: is the controller on the bus?")
        self.announce = found
        return found

    @property
    def identity(self) -> records.Announce:
        """The controller, as it last announced itself."""
        return self.announce or self.hello()

    def open_request(self, **changes: object) -> records.Open:
        """A right OPEN with a fresh nonce, except for what is changed."""
        request = records.Open(
            protocol_version=records.PROTOCOL_VERSION,
            announce_nonce=self.identity.announce_nonce,
            runtime_nonce=self._random(16),
            identity_digest=self.identity.identity_digest,
            registration_digest=self.registration,
            place_digest=self.place,
            registration_time_us=max(REGISTERED_US, self.barrier_us + 1),
            configuration_digest=CONFIGURATION,
            verifier_version=VERIFIER,
            timing=self.timing,
        )
        wanted = replace(request, **changes)  # type: ignore[arg-type]
        return wanted if records.opens(wanted) else self.open_request(**changes)

    def ask_open(self, request: records.Open) -> records.Opened | records.Reply | None:
        """Send an OPEN outside a session, once more if an announcement was in its way, and wait for the answer."""
        named = records.session_digest(request)
        begun_s = self._clock()
        for _ in range(2):
            self.endpoint.abort()
            self.endpoint.use_session(named)
            found = self.answer_to_open(len(self.heard), self.say(request, session=0))
            self.latency_s = self._clock() - begun_s
            if found is not None:
                break
        if not isinstance(found, records.Opened):
            self.endpoint.use_session(None)
        return found

    def answer_to_open(self, since: int, sequence: int) -> records.Opened | records.Reply | None:
        """What comes to an OPEN that was sent with this sequence."""

        def opened() -> records.Opened | None:
            return self.first(records.Opened, since)

        def refused() -> records.Reply | None:
            return self.reply(records.Open, sequence, since)

        self.until(lambda: True if opened() or refused() else None, self.reply_s / 2)
        return opened() or refused()

    def open(self) -> records.Opened:
        """A session with fresh heartbeats, measured joints and no cause that was not acknowledged."""
        answer = self.open_unacknowledged()
        if answer.cause is not StopCause.NONE:
            self.acknowledge(answer.cause)
        if answer.withdrawal_due:  # of what happened before the suite, or in a case of it
            self.withdraw(records.NO_PLACE, max(self.barrier_us, REGISTERED_US))
        return answer

    def open_unacknowledged(self) -> records.Opened:
        """A session with fresh heartbeats and measured joints; its cause stands as it was."""
        self.hello()
        request = self.open_request()
        answer = self.ask_open(request)
        if not isinstance(answer, records.Opened):
            raise DeviationError(f"a right OPEN was answered with {shown(answer)}")
        if not self.authentic(answer):
            raise DeviationError("Opened carries a code that no holder of the key made")
        self.opening = self.endpoint.signed_next(request)
        self.epoch, self.barrier_us = answer.epoch, answer.barrier_us
        self.endpoint.open_link(self._clock())
        self._next_beat_s = self._clock()

        def heard() -> JointSample | None:
            return self.endpoint.link.sample if self.endpoint.link.fresh(self._clock()) else None

        if self.until(heard, self.reply_s) is None:
            raise DeviationError("no fresh heartbeat and joints of the controller after Opened")
        return answer

    def withdraw(self, place: bytes, barrier_us: int) -> None:
        """Withdraw a place, or none in particular. Raises DeviationError unless that is accepted."""
        answer = self.ask(records.Withdraw(place_digest=place, barrier_us=barrier_us))
        if answer is None or answer.refusal is not Refusal.ACCEPTED:
            raise DeviationError(f"Withdraw was answered with {shown(answer)}")
        self.barrier_us = max(self.barrier_us, barrier_us)

    def acknowledge(self, cause: StopCause) -> None:
        """Say that the cause was seen. Raises DeviationError unless that is accepted."""
        answer = self.ask(records.Acknowledge(epoch=self.epoch, cause=cause))
        if answer is None or answer.refusal is not Refusal.ACCEPTED:
            raise DeviationError(f"Acknowledge {cause.name} was answered with {shown(answer)}")

    def collect(self) -> tuple[records.Limits, records.Calibration, records.Tool]:
        """What the controller reports of itself."""
        since, begun_s = len(self.heard), self._clock()
        self.say(records.Collect())
        found = (
            self.wait_for(records.Limits, since),
            self.wait_for(records.Calibration, since),
            self.wait_for(records.Tool, since),
        )
        self.latency_s = self._clock() - begun_s
        limits, calibration, tool = found
        if limits is None or calibration is None or tool is None:
            raise DeviationError(f"Collect was answered with {', '.join(map(shown, found))}")
        self.reported = Reported(limits, calibration, tool)
        return limits, calibration, tool

    @property
    def arm(self) -> Reported:
        """What the controller reported last; asked for if it has not yet."""
        if self.reported is None:
            self.collect()
        assert self.reported is not None  # noqa: S101 - collect() has set it or raised
        return self.reported

    def sample(self, poses: int | None = None) -> Sample:
        """A path for this arm. Raises InconclusiveError where there is none."""
        try:
            return sample(self.arm) if poses is None else sample(self.arm, poses)
        except ValueError as error:
            raise InconclusiveError(f"no sample path for this arm: {error}") from None

    def upload(self, blocks: list[records.PathBlock]) -> records.PathStored | None:
        """Send blocks, each after the one before was stored; the answer over the whole path."""
        begun_s = self._clock()
        since = len(self.heard)
        for block in blocks:
            place = len(self.heard)
            self.say(block)

            def answer(place: int = place) -> records.BlockStored | records.PathStored | None:
                return self.first(records.BlockStored, place) or self.first(records.PathStored, place)

            if self.until(answer, self.reply_s) is None:
                break
        found = self.wait_for(records.PathStored, since)
        self.latency_s = self._clock() - begun_s
        return found

    def loaded(self) -> Sample:
        """A session with a stored path."""
        self.open()
        return self.load()

    def load(self) -> Sample:
        """Store a path in the session that is open."""
        good = self.sample()
        answer = self.upload(records.split(good.path.body()))
        if answer is None or answer.refusal is not Refusal.ACCEPTED:
            raise DeviationError(f"a path in the middle of the limits was answered with {shown(answer)}")
        self.good, self.code = good, RuntimeCode.READY
        if not self.reaches(ControllerState.LOADED):
            raise DeviationError(f"after the path was stored the state is {self.state_name}, must be LOADED")
        return good

    def reaches(self, state: ControllerState) -> bool:
        """Whether the controller's heartbeat says so within the time-out."""
        return bool(
            self.until(lambda: (self.state is not None and self.state.state is state) or None, self.timeout_s)
        )

    def stays(self, state: ControllerState) -> None:
        """Raises DeviationError unless the next heartbeats all say this state."""
        since = len(self.heard)
        self.run(3 * self.heartbeat_s)
        states = [
            h.item.frame.state
            for h in self.heard[since:]
            if isinstance(h.item, Accepted) and isinstance(h.item.frame, ControllerHeartbeat)
        ]
        if not states or any(found is not state for found in states):
            names = ", ".join(dict.fromkeys(found.name for found in states)) or "no heartbeat"
            raise DeviationError(f"the state became {names}, must stay {state.name}")

    @property
    def state_name(self) -> str:
        """The state that was heard last."""
        return self.state.state.name if self.state else "unknown"

    def nonce(self, purpose: Purpose) -> bytes:
        """A nonce of the controller's."""
        since = len(self.heard)
        self.say(records.NonceRequest(purpose=purpose))
        answer = self.wait_for(records.Nonce, since)
        if answer is None or answer.purpose is not purpose:
            raise DeviationError(f"NonceRequest {purpose.name} was answered with {shown(answer)}")
        if answer.epoch != self.epoch:
            raise DeviationError(f"the nonce names epoch {answer.epoch}, the session is in {self.epoch}")
        return answer.nonce

    def permit(self, nonce: bytes | None = None) -> records.Permit:
        """A right permit for the stored path, not signed yet."""
        good, arm, measured, opening = self.good, self.arm, self.endpoint.link.sample, self.opening
        assert good is not None and measured is not None and opening is not None  # noqa: S101, PT018 - loaded() comes before
        try:
            ends = approach(
                good,
                arm,
                clearance_um=self.timing.approach_clearance_um,
                speed_percent=self.timing.approach_speed_percent,
            )
        except ValueError as error:  # RecordError is one; so is a pose that the arm cannot reach
            raise InconclusiveError(f"no approach for this arm: {error}") from None
        return records.Permit(
            nonce=self.nonce(Purpose.PERMIT) if nonce is None else nonce,
            announce_nonce=opening.announce_nonce,
            session_digest=self.endpoint.codes.digest,
            serial=self.identity.serial,
            protocol_version=records.PROTOCOL_VERSION,
            epoch=self.epoch,
            limits_digest=records.digest(arm.limits.body()),
            calibration_digest=records.digest(arm.calibration.body()),
            tool_digest=records.digest(arm.tool.body()),
            path_digest=good.path.digest,
            registration_digest=self.registration,
            configuration_digest=CONFIGURATION,
            verifier_version=VERIFIER,
            start_joints_u=joints_to_counts(measured.joints),
            branch=records.Branch(good.path.elbow, good.path.q0_turns, good.path.roll_turns),
            approach=ends,
            lifetime_s=self.timing.permit_lifetime_s,
            log=records.TreeHead(self.log_id, PERMIT_RECORDS, bytes(32)),
        )

    def permitted(self) -> records.Permit:
        """A session in cutting mode: a right permit was accepted."""
        self.loaded()
        permit = self.permit()
        answer = self.ask(permit)
        if answer is None or answer.refusal is not Refusal.ACCEPTED:
            raise DeviationError(f"a right permit was answered with {shown(answer)}")
        if not self.reaches(ControllerState.PERMITTED):
            raise DeviationError(
                f"after the permit was accepted the state is {self.state_name}, must be PERMITTED"
            )
        return permit

    def start(self, permit: records.Permit, nonce: bytes | None = None) -> records.Start:
        """A right start under a permit, not signed yet."""
        return records.Start(
            nonce=self.nonce(Purpose.START) if nonce is None else nonce,
            epoch=self.epoch,
            session_digest=permit.session_digest,
            permit_digest=permit.digest,
            start_joints_u=permit.start_joints_u,
            log=replace(permit.log, size=permit.log.size + 1),
        )

    def reset(self, cause: StopCause) -> records.Reset:
        """A right reset of a latched fault, not signed yet."""
        return records.Reset(
            nonce=self.nonce(Purpose.RESET),
            epoch=self.epoch,
            session_digest=self.endpoint.codes.digest,
            cause=cause,
        )

    # ------------------------------------------------------------ the end of a case

    def violations(self) -> list[str]:
        """What was wrong with the controller's own frames."""
        return [f"{h.item.cause.name}: {h.item.detail}" for h in self.heard if isinstance(h.item, Violation)]

    def stop_now(self) -> None:
        """One stop frame, ahead of everything; nothing is read."""
        self.endpoint.abort()
        if self.endpoint.link.is_open:
            self.stop(StopCause.OPERATOR_STOP)
            self.port.flush_last(self._wait)

    def finish(self) -> records.Announce:
        """End the session and wait until the controller announces that it stands.

        Raises:
            HaltError: it does not, or not in INHIBITED or FAULT.
        """
        self.endpoint.abort()
        self.beating = True
        if self.endpoint.link.is_open:
            self.stop(StopCause.OPERATOR_QUIT, StopCode.END)
            self.port.flush()
        self.endpoint.end_session()
        found = self.hello()
        if found.state not in STANDING:
            raise HaltError(f"after END the controller announces {found.state.name}, must be INHIBITED")
        return found

    def recover(self, cause: StopCause) -> None:
        """Leave a latched fault: acknowledge (done by open), then reset. Raises DeviationError if it stays."""
        self.open()
        answer = self.ask(self.reset(cause))
        if answer is None or answer.refusal is not Refusal.ACCEPTED:
            raise DeviationError(f"Reset was answered with {shown(answer)}")
        if not self.reaches(ControllerState.OPEN):
            raise DeviationError(f"after Reset the state is {self.state_name}, must be OPEN")
