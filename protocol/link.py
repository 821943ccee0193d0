"""One side's view of the single frames: counters, age, and the other node that must not be there.

Pure: the caller brings each frame and the time. What is accepted has passed identifier, CRC (with data ID and
session tag), counter and content, a heartbeat and a joint sample also the tag that only a holder of the key can make;
what is not says why, and whether motion must stop for it.

How a :class:`Link` is used, one on either side:

- :meth:`Link.open` with the session's codes, once both sides have agreed on it; :meth:`Link.close` at its end.
- Every frame from the bus goes through :meth:`Link.receive`, which raises nothing and returns one of five outcomes:
  :class:`Accepted` may be acted on, a :class:`Violation` stops motion, :class:`Discarded` and :class:`Unlisted`
  change nothing, and what is :class:`ForTransfer` belongs to that channel's transfer.
- Before a frame leaves, :meth:`Link.encode` gives it counter, echo, tag and CRC. It sends nothing; whoever finds out
  that the frame never left says so with :meth:`Link.take_back` before the next one of its identifier is made.
- Once a cycle, before anything is acted on, look at the clock with :meth:`Link.expire`.

``endpoint.Endpoint`` does all of this. A peer is fresh once it answers: its first heartbeat answers nothing, enables
nothing, and the second does::

    >>> from cutgate.protocol.codes import PresharedKey
    >>> from cutgate.protocol.states import ControllerState, RuntimeCode
    >>> codes = PresharedKey(bytes(32)).session(bytes(range(32)))
    >>> runtime, controller = (Link(side, timeout_s=0.1, heartbeat_s=0.02) for side in Side)
    >>> for link in (runtime, controller):
    ...     link.open(codes, now_s=0.0)
    >>> inhibit = RuntimeHeartbeat(RuntimeCode.INHIBIT, epoch=0)
    >>> first = controller.receive(*runtime.encode(inhibit, now_s=0.01), now_s=0.01)
    >>> first.frame.code.name, first.fresh
    ('INHIBIT', False)
    >>> answer = ControllerHeartbeat(
    ...     state=ControllerState.OPEN,
    ...     epoch=0,
    ...     cause=StopCause.NONE,
    ...     device_pressed=False,
    ...     emergency_stop_ok=True,
    ...     cutting_mode=False,
    ... )
    >>> runtime.receive(*controller.encode(answer, now_s=0.02), now_s=0.02).fresh
    True
    >>> controller.receive(*runtime.encode(inhibit, now_s=0.03), now_s=0.03).fresh
    True

The time-out runs from the sending of what was echoed last, at 0.02 s: whoever holds a frame back gains nothing::

    >>> controller.expire(now_s=0.12), controller.expire(now_s=0.121).name
    (None, 'HEARTBEAT_LOST')
"""

import hmac
import math
from collections import deque
from dataclasses import dataclass, field, replace

from cutgate.protocol.arrays import Floats
from cutgate.protocol.codes import NO_ECHO, SessionCodes
from cutgate.protocol.e2e import COUNTER_MODULUS, CorruptionCount, Sequence, Step, intact
from cutgate.protocol.frames import (
    DATA_IDS,
    ECHO_NONE,
    FRAMES,
    IDS,
    SENT_BY,
    TRANSFER_IDS,
    ControllerHeartbeat,
    Frame,
    FrameError,
    Joint4,
    Joints01,
    Joints23,
    RuntimeHeartbeat,
    RuntimeStop,
    decode_frame,
    encode_frame,
    joint_values,
    payload_of,
)
from cutgate.protocol.states import StopCause, StopCode
from cutgate.protocol.wire import Channel, Side

NO_SESSION = 0
"""The tag of a closed link."""

STOP_ID = IDS[RuntimeStop]
_HEARTBEATS = (RuntimeHeartbeat, ControllerHeartbeat)
_HEARTBEAT_IDS = frozenset(IDS[kind] for kind in _HEARTBEATS)
_JOINTS = (Joints01, Joints23, Joint4)
_JOINT_IDS = tuple(IDS[kind] for kind in _JOINTS)
PERIODS_MIN = 4
"""The time-out runs from the sending of what is echoed: two periods on the way there and back, and two may be lost."""
PERIODS_MAX = COUNTER_MODULUS - 2
"""An echo of 255 is none until one was heard: none of our first 255 heartbeats may be that old."""
COVERED_BYTES = 2
"""So many bytes at the end of a heartbeat are covered by its tag, beside counter and echo."""
SAMPLE_TIMEOUTS = 2
"""A joint sample that may be older than so many time-outs is none."""
ROUNDED = 1.0 + 1e-9
"""Four times 0.1 s are more than 0.4 s in binary."""


@dataclass(frozen=True, eq=False)
class JointSample:
    """Measured joints of one cycle of the controller, (rad, rad, mm, rad, rad), and when the last part came.

    Attributes:
        counter: of the cycle's heartbeat, extended to 32 bits.
        measured_s: the joints are no older than this, by the receiver's own clock: what the heartbeat of their counter
            echoes was sent then, so that the peer's cycle in which both were made came later. Where that heartbeat was
            lost or proved nothing, one before it says so; minus infinity where none does.
    """

    joints: Floats
    counter: int
    received_s: float
    measured_s: float = -math.inf


@dataclass(frozen=True)
class Accepted:
    """A frame that may be acted on.

    Attributes:
        frame: what was sent.
        counter: its counter.
        lost: how many frames are missing before it.
        fresh: False for a heartbeat that answers nothing we sent within the time-out: it enables nothing.
        sample: the joint sample whose last part this frame is; each one comes once, in order.
    """

    frame: Frame
    counter: int
    lost: int = 0
    fresh: bool = True
    sample: JointSample | None = field(default=None, compare=False)


@dataclass(frozen=True)
class Discarded:
    """A frame that is dropped and counted; motion goes on."""

    reason: str


@dataclass(frozen=True)
class Violation:
    """A frame for which motion must stop."""

    cause: StopCause
    detail: str


@dataclass(frozen=True)
class Unlisted:
    """An identifier that is not cutgate's."""


@dataclass(frozen=True)
class ForTransfer:
    """A frame of the peer's on an ISO-TP channel: hand it to that channel's transfer."""

    channel: Channel


Outcome = Accepted | Discarded | Violation | Unlisted | ForTransfer


@dataclass(frozen=True)
class Statistics:
    """What a link has counted since it was opened."""

    accepted: int = 0
    losses: int = 0
    repetitions: int = 0
    crc_failures: int = 0
    outside_session: int = 0
    stale_heartbeats: int = 0


class Link:
    """The single-frame traffic of one side.

    Rules:
    - A frame on an identifier that only this side sends on is a second node, also while the link is closed.
    - While the link is closed everything else is discarded.
    - Anything on the stop identifier that is not a sound stop or end is a stop.
    - A heartbeat and a joint sample whose tag does not fit stop: counter and echo of 8 bits are extended to 32 from what
      was heard and sent before, never resynchronised, so that nothing fits twice.
    - A heartbeat refreshes only if it echoes one of ours that was sent no longer than the time-out ago; the time-out then
      runs from that sending.
    - A joint sample is as old as the heartbeat of its counter, whenever it arrives; older than two time-outs it is none.
    - Never seen is stale.
    - An FD frame is unsound, but for the bulk channel where ``fd`` says so; there a classic one is.
    """

    def __init__(self, side: Side, timeout_s: float, heartbeat_s: float, *, fd: bool = False) -> None:
        enough = PERIODS_MIN * heartbeat_s <= timeout_s * ROUNDED
        if not (enough and timeout_s <= PERIODS_MAX * heartbeat_s * ROUNDED):
            raise ValueError(
                f"time-out {timeout_s} s must be {PERIODS_MIN} to {PERIODS_MAX} heartbeats of {heartbeat_s} s"
            )
        self.side = side
        self.timeout_s = timeout_s
        self.heartbeat_s = heartbeat_s
        self.fd = fd
        self._clear()

    def _clear(self) -> None:
        self._codes: SessionCodes | None = None
        self.statistics = Statistics()
        self.sample: JointSample | None = None
        self._opened_s: float | None = None
        self._refreshed_s: float | None = None
        self._made = -1
        """Our last heartbeat's counter, extended to 32 bits; -1 before the first."""
        self._echoing_from: int | None = None
        """The first of our heartbeats that echoed one of the peer's."""
        self.round_trip_s: float | None = None
        """From the sending of our heartbeat that was echoed last, and in time, to its echo; the peer's own wait is in it."""
        self._sent_s: dict[int, float] = {}
        self._answered = False
        self._heard = False
        """Whether the peer has echoed anything of ours."""
        self._peer: int | None = None
        """The last accepted heartbeat's counter, extended to 32 bits."""
        self._counters: dict[int, int] = {}
        self._sequences: dict[int, Sequence] = {}
        self._corruption = CorruptionCount()
        self._parts: dict[int, tuple[int, Frame]] = {}
        self._counts: list[int] = []
        """The joints of the sample that is being encoded, in counts."""
        self._proved: deque[tuple[int, float]] = deque(maxlen=COUNTER_MODULUS)

    def open(self, codes: SessionCodes, now_s: float) -> None:
        """Begin a session: counters from 0, nothing seen, nothing fresh. From now on the peer's time-out runs.

        Raises:
            ValueError: the session's tag is 0, which means no session.
        """
        if codes.tag == NO_SESSION:
            raise ValueError("session tag is 0, which means no session: the runtime draws another nonce")
        self._clear()
        self._codes = codes
        self._opened_s = now_s

    @property
    def tag(self) -> int:
        """The session's tag, 0 while the link is closed."""
        return NO_SESSION if self._codes is None else self._codes.tag

    def close(self) -> None:
        """End the session; nothing is accepted until the next one."""
        self._clear()

    @property
    def answered(self) -> bool:
        """Whether the peer has echoed a heartbeat that echoed one of its own: ours are proved young to it as well.

        Who enables on the peer's fresh heartbeat alone may be a heartbeat too early for the peer.
        """
        return self._answered

    @property
    def is_open(self) -> bool:
        """Whether a session is open."""
        return self._opened_s is not None

    def encode(self, frame: Frame, now_s: float) -> tuple[int, bytes]:
        """Identifier and bytes to send now. Fills in echo and tag; the joint frames take their heartbeat's counter.

        Encode in the order in which the frames are to leave: a cycle's heartbeat before its joints, the three joint frames
        in theirs. Without a session the frame carries tag 0, which no open link accepts.

        Raises:
            FrameError: the frame is the other side's.
        """
        if frame.SENDER is not self.side:
            raise FrameError(f"{type(frame).__name__} is never sent by the {self.side.name.lower()}")
        match frame:
            case RuntimeHeartbeat() | ControllerHeartbeat():
                return encode_frame(self._heartbeat(frame, now_s), self._made % COUNTER_MODULUS, self.tag)
            case Joints01() | Joints23() | Joint4():
                return encode_frame(self._joints(frame), self._made % COUNTER_MODULUS, self.tag)
            case RuntimeStop():
                frame = replace(frame, echo=self.echo % COUNTER_MODULUS)
        can_id = IDS[type(frame)]
        counter = (self._counters.get(can_id, COUNTER_MODULUS - 1) + 1) % COUNTER_MODULUS
        self._counters[can_id] = counter
        return encode_frame(frame, counter, self.tag)

    @property
    def counter(self) -> int:
        """Of the heartbeat that we made last, extended to 32 bits; -1 before the first."""
        return self._made

    @property
    def echo(self) -> int:
        """What we echo, extended to 32 bits."""
        return NO_ECHO if self._peer is None else self._peer

    def _heartbeat(
        self, frame: RuntimeHeartbeat | ControllerHeartbeat, now_s: float
    ) -> RuntimeHeartbeat | ControllerHeartbeat:
        """The next heartbeat, with echo and tag."""
        self._made += 1
        self._sent_s[self._made] = now_s
        self._sent_s.pop(self._made - COUNTER_MODULUS, None)
        if self._echoing_from is None and self._peer is not None:
            self._echoing_from = self._made
        echo = self.echo
        tag = frame.tag
        if self._codes is not None:
            covered = payload_of(frame)[-COVERED_BYTES:]
            tag = self._codes.heartbeat_tag(self.side, self._made, echo, covered)
        return replace(frame, echo=echo % COUNTER_MODULUS, tag=tag)

    def _joints(self, frame: Joints01 | Joints23 | Joint4) -> Joints01 | Joints23 | Joint4:
        """A part of the sample; the last one takes the tag of all."""
        match frame:
            case Joints01():
                self._counts = [frame.q0, frame.q1]
            case Joints23():
                self._counts = [*self._counts[:2], frame.q2, frame.q3]
            case Joint4() if self._codes is not None and self._made >= 0:
                tag = self._codes.sample_tag(self._made, (*self._counts, frame.q4))
                return replace(frame, tag=tag)
        return frame

    def take_back(self, can_id: int) -> None:
        """The last frame made for this identifier never left: its counter is the next one's, and nobody echoes it.

        Joint frames have no counter of their own: they go with their heartbeat.
        """
        if can_id in _HEARTBEAT_IDS:
            self._made -= 1
        else:
            self._counters[can_id] = (self._counters.get(can_id, 0) - 1) % COUNTER_MODULUS

    def receive(
        self,
        can_id: int,
        data: bytes,
        *,
        is_extended: bool = False,
        is_remote: bool = False,
        is_fd: bool = False,
        is_error: bool = False,
        now_s: float,
    ) -> Outcome:
        """Judge one frame from the bus, whatever it is; raises nothing.

        Args:
            can_id: its identifier.
            data: its bytes.
            is_extended: whether that is an extended identifier.
            is_remote: whether it is a remote frame.
            is_fd: whether it is an FD frame.
            is_error: whether it is an error frame, which carries nothing.
            now_s: when it was read.

        Returns:
            What becomes of it. After a violation the link stays open, and goes on judging.
        """
        if is_error:
            return Discarded("error frame")
        if not is_extended and can_id in SENT_BY[self.side]:
            return Violation(StopCause.SECOND_NODE, f"received on our own identifier {can_id:#05x}")
        if is_extended or can_id not in SENT_BY[self.side.peer]:
            return Unlisted()
        shaped = len(data) == 8 and not is_remote and not is_fd
        if can_id not in FRAMES:
            return self._transfer(can_id, shaped=shaped, flexible=is_fd and not is_remote)
        return self._single(can_id, data, now_s, shaped=shaped)

    def _single(self, can_id: int, data: bytes, now_s: float, *, shaped: bool) -> Outcome:
        if not self.is_open:
            return Discarded("no session")
        if can_id == STOP_ID:
            return self._stop(data, shaped=shaped)
        return self._judge(can_id, data, now_s, shaped=shaped)

    def _transfer(self, can_id: int, *, shaped: bool, flexible: bool) -> Outcome:
        channel = next(channel for channel, sent in TRANSFER_IDS[self.side.peer].items() if sent == can_id)
        if self.fd and channel is Channel.BULK:
            return ForTransfer(channel) if flexible else Discarded(f"transfer frame {can_id:#05x} is not FD")
        if not shaped:
            return Discarded(f"transfer frame {can_id:#05x} is not 8 bytes classic")
        return ForTransfer(channel)

    def _stop(self, data: bytes, *, shaped: bool) -> Accepted:
        """Whatever stands on the stop identifier stops; only a sound end of session is anything less."""
        counter = data[2] if len(data) > 2 else 0
        if not shaped or not intact(data, DATA_IDS[STOP_ID], self.tag):
            self._count(crc_failures=1)
            return Accepted(RuntimeStop(StopCode.STOP, StopCause.CORRUPTION), counter)
        try:
            frame = decode_frame(STOP_ID, data)
        except FrameError:
            frame = RuntimeStop(StopCode.STOP, StopCause.PROTOCOL_VIOLATION)
        self._count(accepted=1)
        return Accepted(frame, counter)

    def _judge(self, can_id: int, data: bytes, now_s: float, *, shaped: bool) -> Outcome:
        if not shaped or not intact(data, DATA_IDS[can_id], self.tag):
            if shaped and intact(data, DATA_IDS[can_id], NO_SESSION):
                self._count(outside_session=1)
                return Discarded(f"{can_id:#05x} was sent outside the session")
            return self._corrupt(can_id, now_s)
        sequence = self._sequences.setdefault(can_id, Sequence())
        before = sequence.last
        step, lost = sequence.judge(data)
        if step is Step.REPEATED:
            self._count(repetitions=1)
            return Discarded(f"{can_id:#05x} repeated")
        if step is Step.BROKEN:
            return Violation(
                StopCause.SEQUENCE_ERROR, f"{can_id:#05x} counter {data[2]} after a gap of {lost}"
            )
        if can_id in _HEARTBEAT_IDS:
            heard = self._heard_heartbeat(can_id, data, lost, now_s)
            if isinstance(heard, Violation):  # a stranger's: what the peer says next still fits
                sequence.last = before
            return heard
        return self._heard_other(can_id, data, lost, now_s)

    def _heard_other(self, can_id: int, data: bytes, lost: int, now_s: float) -> Outcome:
        """Accepted; a joint frame may complete a sample, unless nothing was heard yet that tells of which cycle it is."""
        try:
            frame = decode_frame(can_id, data)
        except FrameError as error:
            return Violation(StopCause.PROTOCOL_VIOLATION, str(error))
        self._count(accepted=1, losses=lost)
        accepted = Accepted(frame, data[2], lost)
        if not isinstance(frame, _JOINTS) or self._peer is None:
            return accepted
        self._parts[can_id] = (nearest(data[2], self._peer), frame)
        return self._complete(accepted, now_s)

    def _heard_heartbeat(self, can_id: int, data: bytes, lost: int, now_s: float) -> Outcome:
        """Accepted if its tag fits; then it may refresh."""
        assert self._codes is not None  # noqa: S101 - the link is open
        counter = data[2] if self._peer is None else self._peer + 1 + lost
        echo = self._echoed(data[5])
        if not 0 <= echo <= NO_ECHO or not _fits(
            self._codes.heartbeat_tag(self.side.peer, counter, echo, data[-COVERED_BYTES:]),
            int.from_bytes(data[3:5], "little"),
        ):
            return _no_fit(f"heartbeat {can_id:#05x}", counter)
        try:
            frame = decode_frame(can_id, data)
        except FrameError as error:
            return Violation(StopCause.PROTOCOL_VIOLATION, str(error))
        self._count(accepted=1, losses=lost)
        self._peer = counter
        fresh = self._refresh(echo, now_s)
        if fresh:
            self._proved.append((counter, self._sent_s[echo]))
        return Accepted(frame, data[2], lost, fresh)

    def _echoed(self, echo: int) -> int:
        """The heartbeat of ours that is echoed, extended to 32 bits: the last one made that ends so, negative if none."""
        if echo == ECHO_NONE and not self._heard:
            return NO_ECHO
        return self._made - (self._made - echo) % COUNTER_MODULUS

    def _corrupt(self, can_id: int, now_s: float) -> Outcome:
        self._count(crc_failures=1)
        if self._corruption.tolerated(now_s):
            return Discarded(f"{can_id:#05x} corrupted")
        return Violation(
            StopCause.CORRUPTION, f"{can_id:#05x} corrupted, more than the tolerated number in a second"
        )

    def _refresh(self, echo: int, now_s: float) -> bool:
        """Refresh only for an echo of a heartbeat that we sent no longer than the time-out ago."""
        sent_s = self._sent_s.get(echo)
        if sent_s is None or not 0.0 <= now_s - sent_s <= self.timeout_s:
            self._count(stale_heartbeats=1)
            return False
        self._heard = True
        self.round_trip_s = now_s - sent_s
        self._answered = self._answered or (self._echoing_from is not None and echo >= self._echoing_from)
        self._refreshed_s = sent_s if self._refreshed_s is None else max(self._refreshed_s, sent_s)
        return True

    def _complete(self, accepted: Accepted, now_s: float) -> Outcome:
        """The sample, once all three parts of one cycle are here, if its tag fits and it is young enough to be one."""
        assert self._codes is not None  # noqa: S101 - the link is open
        parts = [self._parts.get(can_id) for can_id in _JOINT_IDS]
        cycles, frames = {part[0] for part in parts if part}, [part[1] for part in parts if part]
        match frames:
            case [Joints01() as first, Joints23() as second, Joint4() as third] if len(cycles) == 1:
                (cycle,) = cycles
            case _:
                return accepted
        counts = (first.q0, first.q1, second.q2, second.q3, third.q4)
        if cycle < 0 or not _fits(self._codes.sample_tag(cycle, counts), third.tag):
            return _no_fit("joint sample", cycle)
        measured_s = self._no_older_than(cycle)
        if not now_s - measured_s <= SAMPLE_TIMEOUTS * self.timeout_s:
            return accepted
        self.sample = JointSample(joint_values(first, second, third), cycle, now_s, measured_s)
        return replace(accepted, sample=self.sample)

    def _no_older_than(self, cycle: int) -> float:
        """The last moment that is proved to lie before this cycle of the peer."""
        return next((sent_s for proved, sent_s in reversed(self._proved) if proved <= cycle), -math.inf)

    def _count(self, **more: int) -> None:
        before = vars(self.statistics)
        self.statistics = Statistics(**before | {name: before[name] + by for name, by in more.items()})

    def fresh(self, now_s: float) -> bool:
        """Whether the peer was heard in answer to us within the time-out."""
        return self._refreshed_s is not None and 0.0 <= now_s - self._refreshed_s <= self.timeout_s

    def expire(self, now_s: float) -> StopCause | None:
        """HEARTBEAT_LOST once an open link has had no refresh for longer than the time-out, and at every call after it.

        It closes nothing: that is the caller's.
        """
        since_s = self._since_s
        lost = since_s is not None and not 0.0 <= now_s - since_s <= self.timeout_s
        return StopCause.HEARTBEAT_LOST if lost else None

    @property
    def expires_s(self) -> float:
        """When to look at the clock at the latest: the peer's time-out. Infinite while the link is closed."""
        return math.inf if self._since_s is None else self._since_s + self.timeout_s

    @property
    def _since_s(self) -> float | None:
        """Since when the time-out runs; None while the link is closed."""
        return self._opened_s if self._refreshed_s is None else self._refreshed_s


def nearest(counter: int, heartbeat: int) -> int:
    """A joint frame's counter of 8 bits, extended: the one nearest to the last heartbeat's, before or after it."""
    half = COUNTER_MODULUS // 2
    return heartbeat + (counter - heartbeat + half) % COUNTER_MODULUS - half


def _fits(made: int, sent: int) -> bool:
    """Whether two tags are equal, in constant time."""
    return hmac.compare_digest(made.to_bytes(4, "little"), sent.to_bytes(4, "little"))


def _no_fit(what: str, counter: int) -> Violation:
    return Violation(
        StopCause.AUTHENTICATION_FAILED, f"{what} {counter}: its tag is none that a holder of the key made"
    )
