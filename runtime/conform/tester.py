"""The tester's side of the bus: it speaks as a runtime does, and says what a runtime never says.

It uses the protocol package alone, no part of a controller, and drives its endpoint one cycle at a time; bus, clock,
waiting and random numbers are handed in. What it hears it keeps, and in every cycle it watches that nothing moves.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final, TypeVar

import can

from cutgate.protocol import records
from cutgate.protocol.codes import SessionCodes
from cutgate.protocol.e2e import COUNTER_MODULUS
from cutgate.protocol.endpoint import Endpoint, RecordReceived
from cutgate.protocol.frames import (
    ControllerHeartbeat,
    Frame,
    RuntimeHeartbeat,
    RuntimeStop,
    encode_frame,
    payload_of,
)
from cutgate.protocol.port import RETRY_S, Passed, Port
from cutgate.protocol.records import Channel, Record, Side, SignedRecord
from cutgate.protocol.states import RuntimeCode, StopCause, StopCode
from cutgate.runtime.conform.heard import Heard, Seen, Standstill, Stop, sign_of_a_stop

STOP_PERIODS: Final = 2
"""A stop is reported so many heartbeat periods after its cause at the latest."""
WAIT_MIN_S: Final = 0.001

T = TypeVar("T")
R = TypeVar("R", bound=Record)
S = TypeVar("S", bound=SignedRecord)


class TesterEndpoint(Endpoint):
    """An endpoint that can also send what an endpoint never sends."""

    def send_bytes(self, channel: Channel, payload: bytes, now_s: float) -> None:
        """Queue these bytes as a record, whatever they are."""
        self._transfers[channel].send(payload, now_s)

    def number(self, channel: Channel) -> int:
        """The next sequence of a channel."""
        self._sent[channel] += 1
        return self._sent[channel]

    def signed_next(self, record: S) -> S:
        """The record with the code that it would leave with, were it the next one on its channel."""
        return super()._signed(record, self._sent[record.CHANNEL] + 1)  # type: ignore[return-value]

    def tagged(self, beat: RuntimeHeartbeat, now_s: float, echo: int | None = None) -> tuple[int, bytes]:
        """A heartbeat whose tag is right for what it echoes; its counter is used up, it is not sent.

        Args:
            beat: what it says.
            now_s: when it is made.
            echo: the controller's counter of 8 bits, one of its last 256; the last one heard where not given.
        """
        self.link.encode(beat, now_s)
        counter, echoed = self.link.counter, self.link.echo
        if echo is not None:
            echoed -= (echoed - echo) % COUNTER_MODULUS
        tag = self.codes.heartbeat_tag(self.side, counter, echoed, payload_of(beat)[-2:])
        sealed = replace(beat, echo=echoed % COUNTER_MODULUS, tag=tag)
        return encode_frame(sealed, counter % COUNTER_MODULUS, self.link.tag)

    @property
    def codes(self) -> SessionCodes:
        """Of the session in use."""
        assert self._codes is not None  # noqa: S101 - asked for in a session alone
        return self._codes

    def _signed(self, record: Record, sequence: int) -> Record:
        """A code that a case has put in stays as it is."""
        if isinstance(record, SignedRecord) and record.code != records.NO_MAC:
            return record
        return super()._signed(record, sequence)


class Tester:
    """A tester on a bus with one controller, which says and hears whatever it is told to.

    Args:
        bus: an open python-can bus.
        key: the pre-shared key, 32 bytes.
        timing: what OPEN proposes.
        reply_s: how long an answer may take.
        clock: monotonic seconds.
        wait: waits until a frame may have come, at most so many seconds.
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
        recorder: Callable[[Seen], None] = lambda _seen: None,
        fd: bool = False,
    ) -> None:
        self.timing, self.reply_s = timing, reply_s
        self.heartbeat_s, self.timeout_s = timing.heartbeat_ms / 1000, timing.timeout_ms / 1000
        self._bus = bus
        self._clock, self._wait, self._recorder = clock, wait, recorder
        self.endpoint = TesterEndpoint(
            Side.RUNTIME,
            key,
            heartbeat_s=self.heartbeat_s,
            timeout_s=self.timeout_s,
            transfer_timeout_s=reply_s,
            fd=fd,
        )
        self.port = Port(bus, self.endpoint, self._record)
        self._cycle_s = clock()
        self.standstill = Standstill()
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
        self.standstill.state = None
        self._next_beat_s = 0.0
        self._cycle_s = self._clock()

    # ------------------------------------------------------------ cycles

    @property
    def state(self) -> ControllerHeartbeat | None:
        """The controller's heartbeat that was heard last, in this case."""
        return self.standstill.state

    @property
    def now_s(self) -> float:
        """The tester's clock, s."""
        return self._clock()

    @property
    def allowance_s(self) -> float:
        """What a stop may take beyond the time-out or the frame that causes it."""
        return STOP_PERIODS * self.heartbeat_s

    def run_cycle(self) -> None:
        """One cycle: read, watch, send the heartbeat that is due, flush, wait.

        Raises:
            HaltError: something moved, or the enabling device is pressed.
            can.CanError: the bus failed.
        """
        now_s = self._clock()
        self.longest_gap_s = max(self.longest_gap_s, now_s - self._cycle_s)
        self._cycle_s = now_s
        for item in self.port.read(now_s):
            sign = sign_of_a_stop(item, now_s)
            if sign is not None:
                self._signs.append((len(self.heard), sign))
            self.heard.append(Heard(now_s, item))
            self.standstill.take(item)
        self.endpoint.expire(now_s)
        if self.beating and self.endpoint.link.is_open and now_s >= self._next_beat_s:
            self._next_beat_s = max(self._next_beat_s + self.heartbeat_s, now_s)
            self.send(RuntimeHeartbeat(self.code, self.epoch))
        self.port.flush()
        due_s = self._next_beat_s - self._clock() if self.beating else self.heartbeat_s
        due_s = RETRY_S if self.port.waits else due_s
        self._wait(min(self.heartbeat_s, max(WAIT_MIN_S, due_s)))

    def until(self, found: Callable[[], T | None], limit_s: float) -> T | None:
        """Cycle until something is found; None once it was not found for so long."""
        begun_s = self._clock()
        while True:
            self.run_cycle()
            value = found()
            if value is not None or not self._clock() - begun_s <= limit_s:
                return value

    def run(self, seconds: float) -> None:
        """Cycle for so long."""
        self.until(lambda: None, seconds)

    def _record(self, passed: Passed) -> None:
        seen = Seen(self._clock(), passed)
        self.frames.append(seen)
        self._recorder(seen)

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
        return self.endpoint.send_record(record, self._clock(), session=session).sequence

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

    def authentic(self, record: Record) -> bool:
        """Whether the code of a record that was heard is right."""
        found = (heard.item for heard in self.heard)
        return any(
            isinstance(item, RecordReceived) and item.record is record and item.authentic for item in found
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
