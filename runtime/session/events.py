"""What arrives, as events of the interlock: records and heartbeats of the controller, commands of the operator. Pure."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final

from cutgate.protocol import records
from cutgate.protocol.endpoint import RecordReceived
from cutgate.protocol.frames import ControllerHeartbeat
from cutgate.runtime.interlock.state import (
    Announced,
    BlockConfirmed,
    CommandGiven,
    ControllerView,
    Event,
    NonceReceived,
    OperatorCommand,
    OtherVersionAnnounced,
    ParameterReceived,
    PathConfirmed,
    ReplyReceived,
    SessionOpened,
    UploadedPath,
)

OF_RECORD: Final[Mapping[type[records.Record], Callable[[Any], Event]]] = MappingProxyType(
    {
        records.OtherVersion: lambda r: OtherVersionAnnounced(r.protocol_version),
        records.Limits: ParameterReceived,
        records.Calibration: ParameterReceived,
        records.Tool: ParameterReceived,
        records.BlockStored: lambda r: BlockConfirmed(r.index),
        records.PathStored: lambda r: PathConfirmed(UploadedPath(r.digest, r.refusal, r.pose)),
        records.Nonce: lambda r: NonceReceived(r.purpose, r.nonce, r.epoch),
        records.Reply: lambda r: ReplyReceived(r.request_type, r.refusal, r.cause),
    }
)
"""What each other record from the controller means to the table."""


def of_record(item: RecordReceived, random: Callable[[int], bytes]) -> Event:
    """What a controller's record means to the table.

    Args:
        item: one that only a controller sends; the endpoint lets no other through, and has judged its code.
        random: the operating system's generator, for this side's nonce.
    """
    match item.record:
        case records.Announce() as announce:
            return Announced(announce, random(16))
        case records.Opened() as opened:
            return SessionOpened(opened, item.authentic)
    return OF_RECORD[type(item.record)](item.record)


def view_of(beat: ControllerHeartbeat) -> ControllerView:
    """What a heartbeat tells of the controller."""
    return ControllerView(
        state=beat.state,
        cause=beat.cause,
        epoch=beat.epoch,
        device_pressed=beat.device_pressed,
        emergency_stop_clear=beat.emergency_stop_ok,
        cutting_mode=beat.cutting_mode,
    )


def of_operator(text: OperatorCommand | str) -> CommandGiven | None:
    """The command that was given; only a confirmation names something besides, and None is no command here."""
    if isinstance(text, OperatorCommand):
        return CommandGiven(text)
    command, *what = text.split(maxsplit=1)
    return (
        CommandGiven(OperatorCommand.CONFIRM, "".join(what).upper())
        if command == OperatorCommand.CONFIRM
        else None
    )
