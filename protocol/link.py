"""One side's view of the single frames: counters, age, and the other node that must not be there.

Pure: the caller brings each frame and the time. What is accepted has passed identifier, CRC (with data ID and
session tag), counter and content; what is not says why, and whether motion must stop for it.

How a :class:`Link` is used, one on either side:

- :meth:`Link.open` with the session's tag, once both sides have agreed on it; :meth:`Link.close` at its end.
- Every frame from the bus goes through :meth:`Link.receive`, which raises nothing and returns one of five outcomes:
  :class:`Accepted` may be acted on, a :class:`Violation` stops motion, :class:`Discarded` and :class:`Unlisted`
  change nothing, and what is :class:`ForTransfer` belongs to that channel's transfer.
- Before a frame leaves, :meth:`Link.encode` gives it counter, echo and CRC. It sends nothing; whoever finds out that
  the frame never left says so with :meth:`Link.take_back` before the next one of its identifier is made.
- Once a cycle, before anything is acted on, look at the clock with :meth:`Link.expire`.

``endpoint.Endpoint`` does all of this. A peer is fresh once it answers: its first heartbeat answers nothing, enables
nothing, and the second does::

    >>> from cutgate.protocol.states import ControllerState, RuntimeCode
    >>> runtime, controller = (Link(side, timeout_s=0.1, heartbeat_s=0.02) for side in Side)
    >>> for link in (runtime, controller):
    ...     link.open(tag=7, now_s=0.0)
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
    >>> controller.expire(now_s=0.13), controller.expire(now_s=0.14).name
    (None, 'HEARTBEAT_LOST')
"""

import math
from collections import deque
from dataclasses import dataclass, field, replace

from cutgate.protocol.arrays import Floats
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
)
from cutgate.protocol.states import StopCause, StopCode
from cutgate.protocol.wire import Channel, Side

NO_SESSION = 0
"""The tag of a closed link."""

STOP_ID = IDS[RuntimeStop]
PERIODS_MIN = 3
ROUNDED = 1.0 + 1e-9
"""Three times 0.1 s are more than 0.3 s in binary."""


@dataclass(frozen=True, eq=False)
class JointSample:
    """Measured joints of one counter value, (rad, rad, mm, rad, rad), and when the last part came.

    Attributes:
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
    - A heartbeat refreshes only if it echoes one of ours that was sent no longer than the time-out ago.
    - A joint sample is as old as the heartbeat of its counter, whenever it arrives.
    - Never seen is stale.
    - An FD frame is unsound, but for the bulk channel where ``fd`` says so; there a classic one is.
    """

    def __init__(self, side: Side, timeout_s: float, heartbeat_s: float, *, fd: bool = False) -> None:
        enough = PERIODS_MIN * heartbeat_s <= timeout_s * ROUNDED
        if not (enough and timeout_s < COUNTER_MODULUS * heartbeat_s):
            raise ValueError(
                f"time-out {timeout_s} s must be {PERIODS_MIN} to {COUNTER_MODULUS - 1} heartbeats of {heartbeat_s} s"
            )
        self.side = side
        self.timeout_s = timeout_s
        self.heartbeat_s = heartbeat_s
        self.fd = fd
        self._clear()

    def _clear(self) -> None:
        self.tag = NO_SESSION
        self.statistics = Statistics()
        self.sample: JointSample | None = None
        self._opened_s: float | None = None
        self._refreshed_s: float | None = None
        self._sent_s: dict[int, float] = {}
        self._echoing: set[int] = set()
        self._answered = False
        self._peer_counter: int | None = None
        self._heard = False
        self._counters: dict[int, int] = {}
        self._sequences: dict[int, Sequence] = {}
        self._corruption = CorruptionCount()
        self._parts: dict[int, tuple[int, Frame]] = {}
        self._cycles: dict[int, int] = {}
        self._proved: deque[tuple[int, float]] = deque(maxlen=COUNTER_MODULUS)

    def open(self, tag: int, now_s: float) -> None:
        """Begin a session: counters from 0, nothing seen, nothing fresh. From now on the peer's time-out runs.

        Raises:
            ValueError: the tag is 0, which means no session, or is none.
        """
        if not 0 < tag < 1 << 32:
            raise ValueError(
                f"session tag is {tag}, must be in 1..4294967295: the runtime draws another nonce"
            )
        self._clear()
        self.tag = tag
        self._opened_s = now_s

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
        """Identifier and bytes to send now. Fills in the echo; the three joint frames share a counter.

        Encode in the order in which the frames are to leave, the three joint frames in theirs. Without a session the
        frame carries tag 0, which no open link accepts.

        Raises:
            FrameError: the frame is the other side's.
        """
        if frame.SENDER is not self.side:
            raise FrameError(f"{type(frame).__name__} is never sent by the {self.side.name.lower()}")
        can_id = IDS[type(frame)]
        counter = self._next_counter(frame, can_id)
        if isinstance(frame, RuntimeHeartbeat | ControllerHeartbeat | RuntimeStop):
            echo = ECHO_NONE if self._peer_counter is None else self._peer_counter
            frame = replace(frame, echo=echo)
        if isinstance(frame, RuntimeHeartbeat | ControllerHeartbeat):
            self._sent_s[counter] = now_s
            if self._peer_counter is not None:
                self._echoing.add(counter)
        return encode_frame(frame, counter, self.tag)

    def _next_counter(self, frame: Frame, can_id: int) -> int:
        """The counter this frame goes out with; the second and third part of a sample take the first one's."""
        if isinstance(frame, Joints23 | Joint4):
            counter = self._counters.get(IDS[Joints01], COUNTER_MODULUS - 1)
        else:
            counter = (self._counters.get(can_id, COUNTER_MODULUS - 1) + 1) % COUNTER_MODULUS
        self._counters[can_id] = counter
        return counter

    def take_back(self, can_id: int) -> None:
        """The last frame made for this identifier never left: its counter is the next one's, and nobody echoes it."""
        counter = self._counters.get(can_id, 0)
        self._counters[can_id] = (counter - 1) % COUNTER_MODULUS
        if can_id in (IDS[RuntimeHeartbeat], IDS[ControllerHeartbeat]):
            self._sent_s.pop(counter, None)

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
        step, lost = self._sequences.setdefault(can_id, Sequence()).judge(data)
        if step is Step.REPEATED:
            self._count(repetitions=1)
            return Discarded(f"{can_id:#05x} repeated")
        if step is Step.BROKEN:
            return Violation(
                StopCause.SEQUENCE_ERROR, f"{can_id:#05x} counter {data[2]} after a gap of {lost}"
            )
        try:
            frame = decode_frame(can_id, data)
        except FrameError as error:
            return Violation(StopCause.PROTOCOL_VIOLATION, str(error))
        self._count(accepted=1, losses=lost)
        fresh, sample = True, None
        match frame:
            case RuntimeHeartbeat() | ControllerHeartbeat():
                self._peer_counter = data[2]
                cycle, fresh = self._cycle_of(can_id, data[2], lost), self._refresh(frame.echo, now_s)
                if fresh:
                    self._proved.append((cycle, self._sent_s.get(frame.echo, -math.inf)))
            case Joints01() | Joints23() | Joint4():
                self._parts[can_id] = (self._cycle_of(can_id, data[2], lost), frame)
                sample = self._complete(now_s)
        return Accepted(frame, data[2], lost, fresh, sample)

    def _corrupt(self, can_id: int, now_s: float) -> Outcome:
        self._count(crc_failures=1)
        if self._corruption.tolerated(now_s):
            return Discarded(f"{can_id:#05x} corrupted")
        return Violation(
            StopCause.CORRUPTION, f"{can_id:#05x} corrupted, more than the tolerated number in a second"
        )

    def _refresh(self, echo: int, now_s: float) -> bool:
        """Refresh only for an echo of a heartbeat that we sent no longer than the time-out ago."""
        none_yet = echo == ECHO_NONE and not self._heard
        sent_s = None if none_yet else self._sent_s.get(echo)
        if sent_s is not None and 0.0 <= now_s - sent_s <= self.timeout_s:
            self._heard = True
            self._answered = self._answered or echo in self._echoing
            self._refreshed_s = now_s
            return True
        self._count(stale_heartbeats=1)
        return False

    def _cycle_of(self, can_id: int, counter: int, lost: int) -> int:
        """The sender's cycle since the session was opened: its counter, counted on where that rolls over."""
        before = self._cycles.get(can_id, counter - 1)
        self._cycles[can_id] = before + 1 + lost
        return self._cycles[can_id]

    def _complete(self, now_s: float) -> JointSample | None:
        """The sample, once all three parts of one cycle are here."""
        parts = [self._parts.get(IDS[kind]) for kind in (Joints01, Joints23, Joint4)]
        cycles, frames = {part[0] for part in parts if part}, [part[1] for part in parts if part]
        match frames:
            case [Joints01() as first, Joints23() as second, Joint4() as third] if len(cycles) == 1:
                (cycle,) = cycles
                joints, measured_s = joint_values(first, second, third), self._no_older_than(cycle)
                self.sample = JointSample(joints, cycle % COUNTER_MODULUS, now_s, measured_s)
                return self.sample
        return None

    def _no_older_than(self, cycle: int) -> float:
        """The last moment that is proved to lie before this cycle of the peer."""
        return next((sent_s for proved, sent_s in reversed(self._proved) if proved <= cycle), -math.inf)

    def _count(self, **more: int) -> None:
        self.statistics = replace(
            self.statistics, **{name: getattr(self.statistics, name) + by for name, by in more.items()}
        )

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
