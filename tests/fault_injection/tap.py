"""What anybody reads on the bus: records put together from their frames, sessions by their OPEN, and the last frames."""

from dataclasses import dataclass, field

import can

from cutgate.protocol import records
from cutgate.protocol.frames import CONTROL_IDS, FRAMES, TRANSFER_IDS
from cutgate.protocol.records import Channel, Envelope, RecordError, Side
from cutgate.protocol.transfer import Transfer

SENDER: dict[int, Side] = {
    **{can_id: kind.SENDER for can_id, kind in FRAMES.items()},
    **{can_id: side for side, ids in TRANSFER_IDS.items() for can_id in ids.values()},
}
"""Who sends on each identifier."""
FLOW_CONTROL = 0x3


def is_flow_control(message: can.Message) -> bool:
    """Whether it answers the other side's transfer."""
    return bool(message.data) and message.data[0] >> 4 == FLOW_CONTROL


@dataclass
class Tap:
    """A listener on the control channel, without the key.

    Attributes:
        opens: every OPEN that passed, in order.
        last: by type, the last record that passed, with its envelope.
        frames: by identifier, the last single frame that passed.
        sequences: by side, of the last record that passed.
    """

    opens: list[Envelope] = field(default_factory=list)
    last: dict[type[records.Record], Envelope] = field(default_factory=dict)
    frames: dict[int, bytes] = field(default_factory=dict)
    sequences: dict[Side, int] = field(default_factory=lambda: dict.fromkeys(Side, 0))

    def __post_init__(self) -> None:
        self._transfers = {
            side: Transfer(CONTROL_IDS[side.peer], CONTROL_IDS[side], timeout_s=1.0) for side in Side
        }

    def hear(self, message: can.Message) -> list[Envelope]:
        """The records that are whole with this frame."""
        can_id = message.arbitration_id
        if can_id in FRAMES:
            self.frames[can_id] = bytes(message.data)
        if can_id not in CONTROL_IDS or is_flow_control(message):
            return []
        side = SENDER[can_id]
        transfer = self._transfers[side]
        transfer.feed(bytes(message.data))
        transfer.outgoing()
        transfer.errors()
        whole = [self._read(payload, side) for payload in transfer.received()]
        return [envelope for envelope in whole if envelope is not None]

    def _read(self, payload: bytes, side: Side) -> Envelope | None:
        try:
            envelope = records.unpack(payload, sender=side, channel=Channel.CONTROL)
        except RecordError:
            return None
        self.last[type(envelope.record)] = envelope
        self.sequences[side] = envelope.sequence
        if isinstance(envelope.record, records.Open):
            self.opens.append(envelope)
        return envelope

    @property
    def session(self) -> bytes | None:
        """The digest that the last OPEN names; None before the first."""
        return records.session_digest(self.opens[-1].record) if self.opens else None  # type: ignore[arg-type]

    @property
    def tag(self) -> int:
        """Of that session; 0 before the first."""
        return records.session_tag(self.session) if self.session else 0
