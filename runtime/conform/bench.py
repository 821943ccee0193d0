"""The tester's side of the bus: it speaks as a runtime does, and says what a runtime never says.

It uses the protocol package alone, no part of a controller, and drives its endpoint one turn at a time; bus, clock,
waiting and random numbers are handed in. What it hears it keeps, and in every turn it watches that nothing moves.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, TypeVar

import can
import numpy as np

from cutgate.protocol import permit as permits
from cutgate.protocol import records
from cutgate.protocol.endpoint import Endpoint, Item, RecordReceived, Undelivered
from cutgate.protocol.frames import (
    ControllerFault,
    ControllerHeartbeat,
    Frame,
    Progress,
    RuntimeHeartbeat,
    RuntimeStop,
)
from cutgate.protocol.link import Accepted, JointSample, Violation
from cutgate.protocol.parameters import joints_to_counts
from cutgate.protocol.port import RETRY_S, Passed, Port
from cutgate.protocol.records import Channel, Record, Side
from cutgate.protocol.states import (
    ControllerState,
    FaultCode,
    Purpose,
    Refusal,
    RuntimeCode,
    StopCause,
    StopCode,
)
from cutgate.runtime.conform.sample import Reported, Sample, approach, sample

VERIFIER: Final = "conform"
CONFIGURATION: Final = records.digest(b"cutgate conform")
NOISE_DEG: Final = 0.05
"""Measured joints of an arm that stands may change by so much, deg or mm."""
ANNOUNCE_WAIT_S: Final = 3.0
STOP_PERIODS: Final = 2
"""A stop is reported so many heartbeat periods after its cause at the latest."""
STANDING: Final = frozenset({ControllerState.INHIBITED, ControllerState.FAULT})

WAIT_MIN_S: Final = 0.001

T = TypeVar("T")
R = TypeVar("R", bound=Record)


class DeviationError(Exception):
    """The controller did something else than it must; the text says what came."""


class InconclusiveError(Exception):
    """The case could not be judged; the text says why."""


class HaltError(Exception):
    """The suite must not go on: something moved, the enabling device is pressed, or the controller is gone."""


class OperatorError(HaltError):
    """The suite must not go on because the operator has not kept to what was asked."""


class TesterEndpoint(Endpoint):
    """An endpoint that can also send what an endpoint never sends."""

    def send_bytes(self, channel: Channel, payload: bytes, now_s: float) -> None:
        """Queue these bytes as a record, whatever they are."""
        self._transfers[channel].send(payload, now_s)

    def number(self, channel: Channel) -> int:
        """The next sequence of a channel."""
        self._sent[channel] += 1
        return self._sent[channel]


@dataclass(frozen=True)
class Heard:
    """What arrived, and when."""

    at_s: float
    item: Item


@dataclass(frozen=True)
class Seen:
    """A frame that passed, and when."""

    at_s: float
    passed: Passed


@dataclass(frozen=True)
class Stop:
    """The first sign of a stop, and when it was heard."""

    after_s: float
    cause: StopCause
    latched: bool

    def __str__(self) -> str:
        kind = "latched fault" if self.latched else "stop"
        return f"{kind} {self.cause.name} after {self.after_s * 1000:.0f} ms"


def shown(answer: Record | None) -> str:
    """An answer in a few words."""
    match answer:
        case None:
            return "no answer"
        case records.Reply():
            return f"Reply {answer.refusal.name}"
        case records.PathStored():
            return f"PathStored {answer.refusal.name}, pose {answer.pose}"
        case _:
            return type(answer).__name__


def _sign_of_a_stop(item: Item, now_s: float) -> Stop | None:
    """A fault frame, a heartbeat that says so, an announcement; dated by the tester's clock."""
    match item:
        case Accepted(frame=ControllerFault(code=code, cause=cause)):
            return Stop(now_s, cause, code is FaultCode.LATCHED)
        case Accepted(frame=ControllerHeartbeat(state=state, cause=cause)) if state in STANDING:
            return Stop(now_s, cause, state is ControllerState.FAULT)
        case RecordReceived(record=records.Announce(state=state, cause=cause)):
            return Stop(now_s, cause, state is ControllerState.FAULT)
        case _:
            return None


class Bench:
    """A tester on a bus with one controller.

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
        self.timing, self.reply_s = timing, reply_s
        self.heartbeat_s, self.timeout_s = timing.heartbeat_ms / 1000, timing.timeout_ms / 1000
        self.registration = random(32)
        """Throw-away: it names no file, so that withdrawing it takes nothing away."""
        self._key, self._bus = key, bus
        self._clock, self._wait, self._random, self._recorder = clock, wait, random, recorder
        self.endpoint = TesterEndpoint(
            Side.RUNTIME,
            heartbeat_s=self.heartbeat_s,
            timeout_s=self.timeout_s,
            transfer_timeout_s=reply_s,
            fd=fd,
        )
        self.port = Port(bus, self.endpoint, self._record)
        self._turn_s = clock()
        self.announce: records.Announce | None = None
        self.reported: Reported | None = None
        self.moved = 0.0
        self._reference: JointSample | None = None
        self.abnormal: list[str] = []
        self.begin()

    def begin(self) -> None:
        """Forget what the case before has heard and said."""
        self.heard: list[Heard] = []
        self._signs: list[tuple[int, Stop]] = []
        self.frames: list[Seen] = []
        self.code = RuntimeCode.INHIBIT
        self.epoch = 0
        self.beating = True
        self.latency_s: float | None = None
        self.longest_gap_s = 0.0
        self.nonces = (b"", b"")
        self.good: Sample | None = None
        self.state: ControllerHeartbeat | None = None
        self._next_beat_s = 0.0
        self._turn_s = self._clock()

    # ------------------------------------------------------------ turns

    def renew_registration(self) -> None:
        """Another throw-away registration: the one before was withdrawn."""
        self.registration = self._random(32)

    @property
    def now_s(self) -> float:
        """The tester's clock, s."""
        return self._clock()

    @property
    def allowance_s(self) -> float:
        """What a stop may take beyond the time-out or the frame that causes it."""
        return STOP_PERIODS * self.heartbeat_s

    def turn(self) -> None:
        """Read, watch, send the heartbeat that is due, flush, wait.

        Raises:
            HaltError: something moved, or the enabling device is pressed.
            can.CanError: the bus failed.
        """
        now_s = self._clock()
        self.longest_gap_s = max(self.longest_gap_s, now_s - self._turn_s)
        self._turn_s = now_s
        for item in self.port.read(now_s):
            sign = _sign_of_a_stop(item, now_s)
            if sign is not None:
                self._signs.append((len(self.heard), sign))
            self.heard.append(Heard(now_s, item))
            self._watch(item)
        self.endpoint.expire(now_s)
        if self.beating and self.endpoint.link.is_open and now_s >= self._next_beat_s:
            self._next_beat_s = max(self._next_beat_s + self.heartbeat_s, now_s)
            self.send(RuntimeHeartbeat(self.code, self.epoch))
        self.port.flush()
        due_s = self._next_beat_s - self._clock() if self.beating else self.heartbeat_s
        due_s = RETRY_S if self.port.waits else due_s
        self._wait(min(self.heartbeat_s, max(WAIT_MIN_S, due_s)))

    def until(self, found: Callable[[], T | None], limit_s: float) -> T | None:
        """Turn until something is found; None once it was not found for so long."""
        begun_s = self._clock()
        while True:
            self.turn()
            value = found()
            if value is not None or not self._clock() - begun_s <= limit_s:
                return value

    def run(self, seconds: float) -> None:
        """Turn for so long."""
        self.until(lambda: None, seconds)

    def _record(self, passed: Passed) -> None:
        seen = Seen(self._clock(), passed)
        self.frames.append(seen)
        self._recorder(seen)

    def _watch(self, item: Item) -> None:
        """Whatever the case is about: the device stays released, nothing moves, the cutter is off unless permitted."""
        match item:
            case Accepted(frame=ControllerHeartbeat() as beat):
                self.state = beat
                if beat.device_pressed:
                    raise OperatorError(
                        "the enabling device is pressed; it must stay released during the suite"
                    )
                if beat.state in {ControllerState.CUTTING, ControllerState.DONE}:
                    self.abnormal.append(f"state {beat.state.name}")
                    raise HaltError(f"the controller is in state {beat.state.name}; nothing may ever move")
                if beat.cutting_mode != (beat.state is ControllerState.PERMITTED):
                    self.abnormal.append(f"cutting mode {beat.cutting_mode} in {beat.state.name}")
            case Accepted(frame=Progress()):
                self.abnormal.append("a Progress frame")
            case Undelivered(detail):
                self.abnormal.append(detail)
            case Accepted(sample=JointSample() as measured):
                self._watch_joints(measured)
            case _:
                pass

    def _watch_joints(self, measured: JointSample) -> None:
        self._reference = self._reference or measured
        change = np.array(measured.joints - self._reference.joints)
        change[[0, 1, 3, 4]] = np.degrees(change[[0, 1, 3, 4]])
        self.moved = max(self.moved, float(np.abs(change).max()))
        if not self.moved <= NOISE_DEG:
            self.abnormal.append(f"a joint moved by {self.moved:.3f} deg or mm")
            raise HaltError(f"a joint moved by {self.moved:.3f} deg or mm, must stay within {NOISE_DEG}")

    # ------------------------------------------------------------ saying

    def send(self, frame: Frame) -> None:
        """Queue a single frame."""
        self.endpoint.send_frame(frame, self._clock())

    def encoded(self, frame: Frame) -> tuple[int, bytes]:
        """A single frame's identifier and bytes, its counter used up, not sent."""
        return self.endpoint.link.encode(frame, self._clock())

    def inject(self, can_id: int, data: bytes) -> None:
        """Put these bytes on the bus at once."""
        message = can.Message(arbitration_id=can_id, data=data, is_extended_id=False)
        self._bus.send(message, timeout=0)
        self._record(
            Passed("sent", can_id, data, is_extended=False, is_remote=False, is_error=False, is_fd=False)
        )

    def say(self, record: Record, *, session: int | None = None) -> int:
        """Queue a record; its sequence."""
        return self.endpoint.send_record(record, self._clock(), session=session)[0]

    def say_bytes(self, channel: Channel, payload: bytes) -> None:
        """Queue bytes in a record's place."""
        self.endpoint.send_bytes(channel, payload, self._clock())

    def stop(self, cause: StopCause, code: StopCode = StopCode.STOP) -> None:
        """Queue a stop frame; it leaves before every transfer."""
        self.send(RuntimeStop(code, cause))

    # ------------------------------------------------------------ hearing

    def first(self, kind: type[R], since: int = 0) -> R | None:
        """The first record of a kind that was heard, from this place on."""
        found = (heard.item for heard in self.heard[since:])
        return next(
            (i.record for i in found if isinstance(i, RecordReceived) and isinstance(i.record, kind)), None
        )

    def wait_for(self, kind: type[R], since: int, limit_s: float | None = None) -> R | None:
        """Wait for a record of a kind."""
        return self.until(lambda: self.first(kind, since), self.reply_s if limit_s is None else limit_s)

    def reply(self, kind: type[Record], sequence: int, since: int) -> records.Reply | None:
        """The reply to a request, if it has come."""
        for heard in self.heard[since:]:
            item = heard.item
            if isinstance(item, RecordReceived) and isinstance(item.record, records.Reply):
                answer = item.record
                if (answer.request_type, answer.request_sequence) == (kind.TYPE, sequence):
                    return answer
        return None

    def ask(self, request: Record) -> records.Reply | None:
        """Send a request and wait for its reply."""
        since, begun_s = len(self.heard), self._clock()
        sequence = self.say(request)
        answer = self.until(lambda: self.reply(type(request), sequence, since), self.reply_s)
        self.latency_s = self._clock() - begun_s
        return answer

    def stop_sign(self, since: int, begun_s: float) -> Stop | None:
        """The first sign of a stop among what was heard from this place on."""
        found = next((sign for place, sign in self._signs if place >= since), None)
        return None if found is None else replace(found, after_s=found.after_s - begun_s)

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
        boot = self.identity.boot_nonce
        nonce = self._random(16)
        while not records.nonce_serves(boot, nonce):
            nonce = self._random(16)
        request = records.Open(
            protocol_version=records.PROTOCOL_VERSION,
            boot_nonce=boot,
            runtime_nonce=nonce,
            registration_digest=self.registration,
            configuration_digest=CONFIGURATION,
            verifier_version=VERIFIER,
            timing=self.timing,
        )
        return replace(request, **changes)  # type: ignore[arg-type]

    def ask_open(self, request: records.Open) -> records.Opened | records.Reply | None:
        """Send an OPEN outside a session, once more if an announcement was in its way, and wait for the answer."""
        tag = records.session_tag(request.boot_nonce, request.runtime_nonce)
        begun_s = self._clock()
        for _ in range(2):
            self.endpoint.abort()
            self.endpoint.use_session(tag)
            found = self._answer_to_open(len(self.heard), self.say(request, session=0))
            self.latency_s = self._clock() - begun_s
            if found is not None:
                break
        if not isinstance(found, records.Opened):
            self.endpoint.use_session(0)
        return found

    def _answer_to_open(self, since: int, sequence: int) -> records.Opened | records.Reply | None:
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
        return answer

    def open_unacknowledged(self) -> records.Opened:
        """A session with fresh heartbeats and measured joints; its cause stands as it was."""
        self.hello()
        request = self.open_request()
        answer = self.ask_open(request)
        if not isinstance(answer, records.Opened):
            raise DeviationError(f"a right OPEN was answered with {shown(answer)}")
        self.nonces = (request.boot_nonce, request.runtime_nonce)
        self.epoch = answer.epoch
        self.endpoint.link.open(records.session_tag(*self.nonces), self._clock())
        self._next_beat_s = self._clock()

        def heard() -> JointSample | None:
            return self.endpoint.link.sample if self.endpoint.link.fresh(self._clock()) else None

        if self.until(heard, self.reply_s) is None:
            raise DeviationError("no fresh heartbeat and joints of the controller after Opened")
        return answer

    def acknowledge(self, cause: StopCause) -> None:
        """Say that the cause was seen. Raises DeviationError unless that is accepted."""
        answer = self.ask(records.Acknowledge(cause=cause))
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
        said = [
            h.item.frame.state
            for h in self.heard[since:]
            if isinstance(h.item, Accepted) and isinstance(h.item.frame, ControllerHeartbeat)
        ]
        if not said or any(found is not state for found in said):
            names = ", ".join(dict.fromkeys(found.name for found in said)) or "no heartbeat"
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
        good, arm, measured = self.good, self.arm, self.endpoint.link.sample
        assert good is not None and measured is not None  # noqa: S101, PT018 - loaded() comes before
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
            boot_nonce=self.nonces[0],
            session_digest=records.session_digest(*self.nonces),
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
        )

    def signed(self, record: permits.Signed) -> permits.Signed:
        """The record with the right code."""
        return permits.sign(self._key, record)

    def permitted(self) -> records.Permit:
        """A session in cutting mode: a right permit was accepted."""
        self.loaded()
        permit = self.signed(self.permit())
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
        )

    def reset(self, cause: StopCause) -> records.Reset:
        """A right reset of a latched fault, not signed yet."""
        return records.Reset(
            nonce=self.nonce(Purpose.RESET),
            epoch=self.epoch,
            session_digest=records.session_digest(*self.nonces),
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
        answer = self.ask(self.signed(self.reset(cause)))
        if answer is None or answer.refusal is not Refusal.ACCEPTED:
            raise DeviationError(f"Reset was answered with {shown(answer)}")
        if not self.reaches(ControllerState.OPEN):
            raise DeviationError(f"after Reset the state is {self.state_name}, must be OPEN")


def milliseconds(seconds: float | None) -> float | None:
    """For people: ms to a tenth."""
    return None if seconds is None or not math.isfinite(seconds) else round(seconds * 1000.0, 1)
