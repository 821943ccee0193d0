"""One side of the conversation, without bus and without clock: bytes in, checked frames and records out.

Joins the single frames (``link``) with the two ISO-TP channels (``transfer``), their envelopes (``records``) and the codes
that only a holder of the key can make (``codes``): what is to be signed is signed here, on its way out, and of what comes
in it says whether its code fits. What that means is decided by the tables of either side.
What is to be sent waits here until the bus has taken it: stop and fault first, then the heartbeat, joints and progress,
then control, then bulk records. So a stop overtakes what waits, and what it voids never leaves.

How an :class:`Endpoint` is used:

- Give every frame from the bus to :meth:`Endpoint.receive` and act on the items it returns, in order.
- Once a cycle, before that, look at the clock with :meth:`Endpoint.expire`.
- :meth:`Endpoint.send_frame` and :meth:`Endpoint.send_record` queue; nothing leaves by itself. At the end of a cycle
  whoever owns the bus flushes, with :meth:`Endpoint.hand_out`: also where nothing was queued, for a transfer that
  comes in is answered there. ``port.Port`` does so.
- A session: its OPEN names it. Then :meth:`Endpoint.use_timing` where the timing was agreed as well,
  :meth:`Endpoint.use_session`, and :meth:`Endpoint.open_link`; the link is closed by ``use_timing``.
  :meth:`Endpoint.end_session` at its end.
- Whatever stops motion queues its stop or fault frame and then calls :meth:`Endpoint.abort`: what was under way never
  leaves, the stop does.

A request and its answer, carried by hand until nothing waits any longer::

    >>> from cutgate.protocol.states import Purpose
    >>> runtime, controller = (
    ...     Endpoint(side, bytes(32), heartbeat_s=0.02, timeout_s=0.1, transfer_timeout_s=2.0) for side in Side
    ... )
    >>> for one in (runtime, controller):
    ...     one.use_session(bytes(range(32)))
    ...     one.open_link(now_s=0.0)
    >>> def carried(sender: Endpoint, receiver: Endpoint) -> list[Item]:
    ...     items: list[Item] = []
    ...     while frames := sender.outgoing():
    ...         items += [item for frame in frames for item in receiver.receive(*frame, now_s=0.01)]
    ...         for frame in receiver.outgoing():  # flow control
    ...             sender.receive(*frame, now_s=0.01)
    ...     return items
    >>> sent = runtime.send_record(records.NonceRequest(Purpose.PERMIT), now_s=0.01)
    >>> for item in carried(runtime, controller):
    ...     print(item.record, item.sequence == sent.sequence)
    NonceRequest(purpose=<Purpose.PERMIT: 1>) True
    >>> _ = controller.send_record(records.Nonce(Purpose.PERMIT, bytes(16), epoch=3), now_s=0.01)
    >>> [item.record.epoch for item in carried(controller, runtime)]
    [3]

What a stop voids does not leave any more::

    >>> from cutgate.protocol.states import StopCode
    >>> _ = runtime.send_record(records.NonceRequest(Purpose.START), now_s=0.02)
    >>> runtime.send_frame(RuntimeStop(StopCode.STOP, StopCause.OPERATOR_STOP), now_s=0.02)
    >>> runtime.abort()
    >>> [item.frame.cause.name for item in carried(runtime, controller)]
    ['OPERATOR_STOP']
"""

from bisect import insort
from collections.abc import Callable
from dataclasses import dataclass
from itertools import dropwhile
from typing import NamedTuple

from cutgate.protocol import records
from cutgate.protocol.codes import PresharedKey, SessionCodes
from cutgate.protocol.frames import (
    BULK_IDS,
    TRANSFER_IDS,
    ControllerFault,
    ControllerHeartbeat,
    Frame,
    Joint4,
    Joints01,
    Joints23,
    Progress,
    RuntimeHeartbeat,
    RuntimeStop,
)
from cutgate.protocol.link import Accepted, Discarded, ForTransfer, Link, Unlisted, Violation
from cutgate.protocol.records import Channel, Open, Record, RecordError, Side, SignedRecord
from cutgate.protocol.states import StopCause
from cutgate.protocol.transfer import Transfer, TransferError

NO_SESSION = 0
_JOINTS = (Joints01, Joints23, Joint4)


@dataclass(frozen=True)
class RecordReceived:
    """A record that passed every check of its envelope.

    Attributes:
        record: what was sent.
        channel: where it came.
        session: tag of its envelope.
        sequence: the sender's running number, which a reply names.
        size: bytes of the envelope.
        digest: SHA-256 of the envelope.
        authentic: False for a record whose code no holder of the key made; of one that carries none it says nothing.
    """

    record: Record
    channel: Channel
    session: int
    sequence: int
    size: int
    digest: bytes
    authentic: bool = True


@dataclass(frozen=True)
class Sent:
    """A record that was queued.

    Attributes:
        record: as it leaves, with its code.
        sequence: with which; a reply names it.
        payload: the envelope's bytes.
    """

    record: Record
    sequence: int
    payload: bytes


@dataclass(frozen=True)
class Undelivered:
    """A record that the peer did not let be sent while no session was open: it stops nothing, but a person may mend it."""

    detail: str


Item = RecordReceived | Accepted | Discarded | Violation | Undelivered
Take = Callable[[int, bytes], bool]
"""Takes a frame, by identifier and bytes; False if it cannot now."""


class _Waiting(NamedTuple):
    """A single frame that has not left.

    Attributes:
        frame: what it says.
        can_id, data: what leaves.
        cycle: how many heartbeats were made before it, its own included.
    """

    frame: Frame
    can_id: int
    data: bytes
    cycle: int

    @property
    def urgency(self) -> int:
        """The lowest leaves first, and of one kind the oldest: identifiers of one kind share these bits."""
        return self.can_id >> 7


class Endpoint:
    """Bytes to checked items and back, for one side.

    Args:
        side: which end this is.
        key: the pre-shared key, 32 bytes.
        heartbeat_s: period of heartbeats, s.
        timeout_s: without a fresh heartbeat for this long the peer is lost, s.
        transfer_timeout_s: how long one record may take on the bus, s.
        fd: bulk records travel in CAN FD frames; everything else stays classic.
    """

    def __init__(
        self,
        side: Side,
        key: bytes,
        *,
        heartbeat_s: float,
        timeout_s: float,
        transfer_timeout_s: float,
        fd: bool = False,
    ) -> None:
        self.side = side
        self.link = Link(side, timeout_s=timeout_s, heartbeat_s=heartbeat_s, fd=fd)
        self._key = PresharedKey(key)
        self._transfers = {
            channel: Transfer(
                TRANSFER_IDS[side][channel],
                TRANSFER_IDS[side.peer][channel],
                timeout_s=transfer_timeout_s,
                fd=fd and channel is Channel.BULK,
            )
            for channel in Channel
        }
        self._waiting: list[_Waiting] = []
        self._cycle = 0
        self._opening = b""
        self.use_session(None)

    # ------------------------------------------------------------ sessions

    def use_session(self, session_digest: bytes | None) -> None:
        """Records carry this session's tag and codes from now on; None for outside one. Sequences begin anew.

        What waits of another session never leaves in this one. Then open the link: records and single frames are two
        things. Transfers in progress go on; :meth:`stop_sending` or :meth:`abort` first where they must not.
        """
        self._codes: SessionCodes | None = (
            None if session_digest is None else self._key.session(session_digest)
        )
        if self._codes is not None:
            self._waiting.clear()
        self._sent = dict.fromkeys(Channel, 0)
        self._seen = dict.fromkeys(Channel, 0)

    @property
    def session(self) -> int:
        """The tag that records carry, 0 outside a session."""
        return NO_SESSION if self._codes is None else self._codes.tag

    def open_link(self, now_s: float) -> None:
        """Single frames of the session in use are made and accepted from now on, and the peer's time-out runs.

        Raises:
            ValueError: no session is in use, or its tag is 0.
        """
        if self._codes is None:
            raise ValueError("no session is in use: use_session first")
        self.link.open(self._codes, now_s)

    def use_timing(self, *, heartbeat_s: float, timeout_s: float) -> None:
        """Take over what OPEN agreed on; the link is closed by it, and to be opened after it.

        Raises:
            ValueError: the time-out is not 4 to 254 heartbeats.
        """
        self.link = Link(self.side, timeout_s=timeout_s, heartbeat_s=heartbeat_s, fd=self.link.fd)

    def end_session(self) -> None:
        """Close the link; records travel outside a session."""
        self.link.close()
        self.use_session(None)
        self.abort()

    @property
    def control_waits(self) -> bool:
        """Whether a control record has not left, or not whole: what voids it now keeps it from being one."""
        return self._transfers[Channel.CONTROL].sending

    def stop_sending(self) -> None:
        """Void every record that goes out; what comes in goes on."""
        for transfer in self._transfers.values():
            transfer.stop_sending()

    def abort(self) -> None:
        """Void every transfer in progress, both directions."""
        for transfer in self._transfers.values():
            transfer.abort()

    # ------------------------------------------------------------ receiving

    @property
    def receiving(self) -> bool:
        """Whether a record is coming in on either channel."""
        return any(transfer.receiving for transfer in self._transfers.values())

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
    ) -> list[Item]:
        """What one frame from the bus brings; raises nothing, whatever it is. Flush afterwards: it may want an answer.

        Args:
            can_id: its identifier.
            data: its bytes.
            is_extended: whether that is an extended identifier.
            is_remote: whether it is a remote frame.
            is_fd: whether it is an FD frame.
            is_error: whether it is an error frame, which carries nothing.
            now_s: when it was read.

        Returns:
            Nothing, an accepted frame, records, a reason to stop (:class:`Violation`), or what may be told and stops
            nothing.
        """
        outcome = self.link.receive(
            can_id,
            data,
            is_extended=is_extended,
            is_remote=is_remote,
            is_fd=is_fd,
            is_error=is_error,
            now_s=now_s,
        )
        match outcome:
            case Unlisted():
                return []
            case ForTransfer(channel):
                transfer = self._transfers[channel]
                transfer.feed(data)
                items = [item for payload in transfer.received() for item in self._record(payload, channel)]
                return items + self._lost(channel, transfer)
        return [outcome]

    def _lost(self, channel: Channel, transfer: Transfer) -> list[Item]:
        """Records that were lost on the way; until the link is open nothing stops for one.

        An announcement that crosses the runtime's OPEN is broken off by the controller's answer.
        """
        errors = [error for error in transfer.errors() if error.lost]
        if not self.link.is_open:
            return [Undelivered(_failed(channel, error).detail) for error in errors if error.refused]
        return [_failed(channel, error) for error in errors]

    def _record(self, payload: bytes, channel: Channel) -> list[Item]:
        try:
            envelope = records.unpack(payload, sender=self.side.peer, channel=channel)
        except RecordError as error:
            if self.session == NO_SESSION:
                return [Discarded(str(error))]
            return [Violation(StopCause.PROTOCOL_VIOLATION, f"{channel.name.lower()} channel: {error}")]
        if envelope.session not in (NO_SESSION, self.session):
            return [Discarded(f"record of session {envelope.session:08x}")]
        if envelope.session != NO_SESSION:
            if not envelope.sequence > self._seen[channel]:
                return [Discarded(f"record {envelope.sequence} after {self._seen[channel]}")]
            self._seen[channel] = envelope.sequence
        elif isinstance(envelope.record, records.Open):  # its nonce is fresh: the same bytes are a repetition
            if payload == self._opening:
                return [Discarded(f"record {envelope.sequence} repeated")]
            self._opening = payload
        return [
            RecordReceived(
                envelope.record,
                channel,
                envelope.session,
                envelope.sequence,
                len(payload),
                records.digest(payload),
                self._authentic(envelope.record, envelope.sequence),
            )
        ]

    def _authentic(self, record: Record, sequence: int) -> bool:
        """Whether the record's code fits, where it carries one."""
        match record:
            case Open():
                return self._key.open_authentic(record)
            case SignedRecord():
                return self._codes is not None and self._codes.authentic(record, sequence)
        return True

    def expire(self, now_s: float) -> list[Violation]:
        """What time alone has brought about: a lost peer, a transfer that did not end. To be called in every cycle.

        A late transfer is void with that; a lost peer is reported again until the session is ended.
        """
        found = []
        lost = self.link.expire(now_s)
        if lost is not None:
            found.append(Violation(lost, f"no fresh heartbeat within {self.link.timeout_s * 1000:g} ms"))
        for channel, transfer in self._transfers.items():
            late = transfer.expire(now_s)
            if late is not None and self.link.is_open:
                found.append(_failed(channel, late))
        return found

    # ------------------------------------------------------------ sending

    def send_frame(self, frame: Frame, now_s: float) -> None:
        """Queue a single frame; it leaves with the next flush, before any transfer, in place of what it makes obsolete.

        Rules, for what has not left yet:
        - A stop or fault that waits is not queued again.
        - A heartbeat leaves in no other place than the last one made, and none that is older than a stop. With it go the
          joints and the progress of its cycle, for a sample has the counter of its heartbeat.
        - A joint sample of which nothing has left gives way to the next one; one begun is finished first.

        Raises:
            FrameError: the frame is the other side's.
        """
        match frame:
            case RuntimeStop() | ControllerFault():
                if any(waiting.frame == frame for waiting in self._waiting):
                    return
                self._take_back_cycle()
            case RuntimeHeartbeat() | ControllerHeartbeat():
                self._take_back_cycle()
                self._cycle += 1
            case Joints01():
                unbegun = list(
                    dropwhile(lambda waiting: not isinstance(waiting.frame, Joints01), self._waiting)
                )
                self._drop(lambda waiting: waiting in unbegun and isinstance(waiting.frame, _JOINTS))
            case Progress():
                for old in self._drop(lambda waiting: isinstance(waiting.frame, Progress)):
                    self.link.take_back(old.can_id)
            case _:
                pass
        can_id, data = self.link.encode(frame, now_s)
        insort(self._waiting, _Waiting(frame, can_id, data, self._cycle), key=lambda waiting: waiting.urgency)

    @property
    def heartbeat_waits(self) -> bool:
        """Whether a heartbeat has not left: the next cycle's takes its place."""
        return any(
            isinstance(waiting.frame, RuntimeHeartbeat | ControllerHeartbeat) for waiting in self._waiting
        )

    def _take_back_cycle(self) -> None:
        """Unmake the last heartbeat, if it has not left, and what was made in its cycle."""
        if self.heartbeat_waits:
            # A stop is of an earlier cycle.
            for made in self._drop(lambda waiting: waiting.cycle == self._cycle):
                self.link.take_back(made.can_id)

    def _drop(self, obsolete: Callable[[_Waiting], bool]) -> list[_Waiting]:
        """Take out of the queue what is obsolete; what it was."""
        dropped = [waiting for waiting in self._waiting if obsolete(waiting)]
        self._waiting = [waiting for waiting in self._waiting if not obsolete(waiting)]
        return dropped

    def send_record(self, record: Record, now_s: float, *, session: int | None = None) -> Sent:
        """Queue a record on its channel; it leaves with the next flushes, behind those queued before it.

        What is to be signed gets its code here, and nowhere else.

        Args:
            record: what to send.
            now_s: when; it must not stand still on the bus for longer than the time-out of transfers.
            session: the tag it carries; the endpoint's own where not given.

        Raises:
            RecordError: the record does not belong in such a session, or outside one.
        """
        channel = record.CHANNEL
        self._sent[channel] += 1
        sequence = self._sent[channel]
        signed = self._signed(record, sequence)
        payload = records.pack(signed, self.session if session is None else session, sequence)
        self._transfers[channel].send(payload, now_s)
        return Sent(signed, sequence, payload)

    def _signed(self, record: Record, sequence: int) -> Record:
        match record:
            case Open():
                return self._key.sign_open(record)
            case SignedRecord() if self._codes is not None:
                return self._codes.sign(record, sequence)
        return record

    def is_fd(self, can_id: int) -> bool:
        """Whether frames with this identifier leave as CAN FD."""
        return self.link.fd and can_id in BULK_IDS

    def hand_out(self, take: Take) -> bool:
        """Give away what waits, most urgent first, until it is not taken; at the end of every cycle.

        Args:
            take: sends a frame. What was not taken stays, and is offered again.

        Returns:
            Whether nothing waits any longer.
        """
        while self._waiting:
            if not take(self._waiting[0].can_id, self._waiting[0].data):
                return False
            del self._waiting[0]
        return all(transfer.hand_out(take) for transfer in self._transfers.values())

    def outgoing(self) -> list[tuple[int, bytes]]:
        """Everything that may leave now, most urgent first; each frame is handed out once, and is the caller's to send."""
        frames: list[tuple[int, bytes]] = []

        def take(can_id: int, data: bytes) -> bool:
            frames.append((can_id, data))
            return True

        self.hand_out(take)
        return frames


def _failed(channel: Channel, error: TransferError) -> Violation:
    return Violation(StopCause.TRANSFER_FAILED, f"{channel.name.lower()} channel: {error.reason}")
