"""One side of the conversation, without bus and without clock: bytes in, checked frames and records out.

Joins the single frames (``link``) with the two ISO-TP channels (``transfer``) and their envelopes (``records``).
What is to be sent waits in two queues: single frames leave before transfers.
"""

from collections import deque
from dataclasses import dataclass

from cutgate.protocol import records
from cutgate.protocol.frames import BULK_IDS, TRANSFER_IDS, Frame
from cutgate.protocol.link import Accepted, Discarded, ForTransfer, Link, Unlisted, Violation
from cutgate.protocol.records import Channel, Record, RecordError, Side
from cutgate.protocol.states import StopCause
from cutgate.protocol.transfer import Transfer, TransferError

NO_SESSION = 0


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
    """

    record: Record
    channel: Channel
    session: int
    sequence: int
    size: int
    digest: bytes


Item = RecordReceived | Accepted | Discarded | Violation


class Endpoint:
    """Bytes to checked items and back, for one side.

    Args:
        side: which end this is.
        heartbeat_s: period of heartbeats, s.
        timeout_s: without a fresh heartbeat for this long the peer is lost, s.
        transfer_timeout_s: how long one record may take on the bus, s.
        fd: bulk records travel in CAN FD frames; everything else stays classic.
    """

    def __init__(
        self, side: Side, *, heartbeat_s: float, timeout_s: float, transfer_timeout_s: float, fd: bool = False
    ) -> None:
        self.side = side
        self.link = Link(side, timeout_s=timeout_s, heartbeat_s=heartbeat_s, fd=fd)
        self.session = NO_SESSION
        self._transfers = {
            channel: Transfer(
                TRANSFER_IDS[side][channel],
                TRANSFER_IDS[side.peer][channel],
                timeout_s=transfer_timeout_s,
                fd=fd and channel is Channel.BULK,
            )
            for channel in Channel
        }
        self._urgent: deque[tuple[int, bytes]] = deque()
        self._sent = dict.fromkeys(Channel, 0)
        self._seen = dict.fromkeys(Channel, 0)
        self._opening = b""

    # ------------------------------------------------------------ sessions

    def use_session(self, tag: int) -> None:
        """Records carry this tag from now on; sequences begin anew."""
        self.session = tag
        self._sent = dict.fromkeys(Channel, 0)
        self._seen = dict.fromkeys(Channel, 0)

    def use_timing(self, *, heartbeat_s: float, timeout_s: float) -> None:
        """Take over what OPEN agreed on; the link is closed by it."""
        self.link = Link(self.side, timeout_s=timeout_s, heartbeat_s=heartbeat_s, fd=self.link.fd)

    def end_session(self) -> None:
        """Close the link; records travel outside a session."""
        self.link.close()
        self.use_session(NO_SESSION)
        self.abort()

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
        """What one frame from the bus brings: nothing, an accepted frame, records, or a reason to stop."""
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
        """Records that were lost on the way; until the link is open nobody waits for one.

        An announcement that crosses the runtime's OPEN is broken off by the controller's answer.
        """
        errors = [error for error in transfer.errors() if error.lost]
        if not self.link.is_open:
            return []
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
            )
        ]

    def expire(self, now_s: float) -> list[Violation]:
        """What time alone has brought about: a lost peer, a transfer that did not end."""
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
        """Queue a single frame; it leaves before any transfer."""
        self._urgent.append(self.link.encode(frame, now_s))

    def send_record(self, record: Record, now_s: float, *, session: int | None = None) -> tuple[int, bytes]:
        """Queue a record on its channel; the sequence it goes out with, and the envelope's bytes."""
        channel = record.CHANNEL
        self._sent[channel] += 1
        payload = records.pack(record, self.session if session is None else session, self._sent[channel])
        self._transfers[channel].send(payload, now_s)
        return self._sent[channel], payload

    def is_fd(self, can_id: int) -> bool:
        """Whether frames with this identifier leave as CAN FD."""
        return self.link.fd and can_id in BULK_IDS

    def outgoing(self) -> list[tuple[int, bytes]]:
        """Everything that may leave now, most urgent first."""
        out = list(self._urgent)
        self._urgent.clear()
        for transfer in self._transfers.values():
            out.extend(transfer.outgoing())
        return out


def _failed(channel: Channel, error: TransferError) -> Violation:
    return Violation(StopCause.TRANSFER_FAILED, f"{channel.name.lower()} channel: {error.reason}")
