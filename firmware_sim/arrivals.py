"""What arrives from the bus, as events of the table. Pure but for the random number of a nonce.

Whether a code fits is the endpoint's finding, and goes with the record.

Blocks of a path are no events: they go to the upload (``upload``), and its verdict is one.
"""

from collections.abc import Callable
from typing import Any, Final

from cutgate.firmware_sim.state import (
    AcknowledgeReceived,
    CollectReceived,
    ControllerSession,
    Event,
    FaultArisen,
    HeartbeatLost,
    HeartbeatReceived,
    NonceRequested,
    OpenReceived,
    PermitReceived,
    ResetReceived,
    StartReceived,
    StopReceived,
    WithdrawReceived,
)
from cutgate.protocol import records
from cutgate.protocol.endpoint import RecordReceived
from cutgate.protocol.frames import RuntimeHeartbeat, RuntimeStop
from cutgate.protocol.link import Accepted, Violation
from cutgate.protocol.states import StopCause

NONCE_BYTES: Final = 16
_OPENINGS: Final = (records.Open, records.OtherVersion)
JUDGED_WHERE_THE_ARM_STANDS: Final = (records.Permit, records.Start)
"""Before these the joints are measured anew: between a permit and its start somebody may have moved the arm."""


def of_frame(accepted: Accepted) -> Event | None:
    """What a checked single frame of the runtime means; None of one that says nothing to the table."""
    frame = accepted.frame
    if isinstance(frame, RuntimeHeartbeat):
        return HeartbeatReceived(frame.code, frame.epoch, frame.cause, accepted.fresh)
    return StopReceived(frame.code, frame.cause) if isinstance(frame, RuntimeStop) else None


def of_lateness(violation: Violation) -> Event:
    """What time alone has brought about: a lost peer, a stalled loop, a transfer that did not end."""
    lost = violation.cause is StopCause.HEARTBEAT_LOST
    return HeartbeatLost() if lost else FaultArisen(violation.cause)


def belongs(item: RecordReceived, session: ControllerSession | None) -> bool:
    """Whether a checked record is of this session, or asks for one; any other is ignored."""
    inside = session is not None and item.session == session.tag
    return inside or isinstance(item.record, _OPENINGS)


OF_RECORD: Final[dict[type[records.Record], Callable[[Any, int, bool], Event]]] = {
    records.Collect: lambda _collect, _sequence, _authentic: CollectReceived(),
    records.Permit: PermitReceived,
    records.Start: StartReceived,
    records.Reset: ResetReceived,
    records.Acknowledge: AcknowledgeReceived,
    records.Withdraw: WithdrawReceived,
}
"""Record, its sequence and whether its code fits to the event; an OPEN and a nonce request need a random number as well."""


def of_record(item: RecordReceived, random: Callable[[int], bytes]) -> Event | None:
    """What a checked record means that belongs.

    Args:
        item: the record.
        random: the operating system's generator; asked where a nonce is to be given out, or the next one to be announced.

    Returns:
        The event, None of a record that says nothing to the table.
    """
    record = item.record
    if isinstance(record, records.NonceRequest):
        return NonceRequested(record.purpose, random(NONCE_BYTES))
    if isinstance(record, _OPENINGS):
        return OpenReceived(record, item.sequence, item.authentic, random(NONCE_BYTES))
    event = OF_RECORD.get(type(record))
    return event(record, item.sequence, item.authentic) if event else None
