"""Datagrams between the virtual bus's hub and its clients, the log line of a frame, and the client's message."""

import io
import re
from collections.abc import Iterator

from can.io.canutils import CanutilsLogReader

from cutgate.firmware_sim.bus import client, control, wire
from cutgate.firmware_sim.bus import frame as frames
from cutgate.firmware_sim.bus.control import InjectionRefusedError
from cutgate.firmware_sim.bus.frame import BusFrameError, Flag
from cutgate.firmware_sim.bus.hub import log_line
from cutgate.firmware_sim.bus.wire import HubKind, HubRecord, WireError
from cutgate.protocol.endpoint import Endpoint
from cutgate.protocol.records import Side
from tests.protocol.sessions import DIGEST, KEY
from tools.fuzz.harness import Family, attempt, expect

LINE = re.compile(r"\(\d+\.\d{6}\) vcan0 [0-9A-F]{3,8}#(#[0-9A-F])?(R\d?|[0-9A-F]*)\n")
YEAR_2100_NS = 4_102_444_800_000_000_000


def check(data: bytes) -> None:
    """A datagram as hub and client read it."""
    attempt(WireError, wire.stamp, data, YEAR_2100_NS)
    attempt(WireError, wire.parse_all, data)
    record = attempt(WireError, wire.parse, data)
    if record is None:
        return
    expect(record.pack() == data, "a record has one form")
    expect(len(record.data) in {0, record.length, record.number}, "no data come from nowhere")
    if record.kind is HubKind.INJECT:
        attempt(InjectionRefusedError, control.injection_of, record.data.decode(errors="replace"), {1: 1})
    if record.kind is not HubKind.FRAME:
        return
    message = client._to_message(record, "vcan0")  # noqa: SLF001 - what a client makes of it
    for side in Side:
        endpoint = Endpoint(side, KEY, heartbeat_s=0.02, timeout_s=0.1, transfer_timeout_s=1.0)
        endpoint.use_session(DIGEST)
        endpoint.open_link(0.0)
        endpoint.receive(
            message.arbitration_id,
            bytes(message.data),
            is_extended=message.is_extended_id,
            is_remote=message.is_remote_frame,
            is_fd=message.is_fd,
            is_error=message.is_error_frame,
            now_s=0.0,
        )
    if attempt(BusFrameError, lambda: frames.check(record.number, record.flags, record.length) or True):
        _logged(record)


def _logged(record: HubRecord) -> None:
    """The log line is one, and python-can reads the same frame from it."""
    line = log_line(record, "vcan0")
    expect(LINE.fullmatch(line) is not None, f"{line!r} is a line of candump")
    if record.flags & Flag.ERROR or record.time_ns > YEAR_2100_NS:
        return  # python-can keeps no data of an error frame; floats hold no microseconds far from now
    (read,) = CanutilsLogReader(io.StringIO(line))
    expect(read.arbitration_id == record.number, "the identifier is in the log")
    expect(bytes(read.data) == record.data, "the data are in the log")
    expect(read.is_fd == bool(record.flags & Flag.FD), "FD is in the log")
    expect(read.is_remote_frame == bool(record.flags & Flag.REMOTE), "remote is in the log")


def _seeds() -> Iterator[bytes]:
    yield wire.hello(fd=True, own=False).pack()
    yield wire.refused("the bus has 64 clients already").pack()
    yield HubRecord(HubKind.WELCOME).pack()
    yield HubRecord(HubKind.OVERRUN, number=12).pack()
    yield wire.text(HubKind.INJECT, '{"error": "crc", "sender": 1, "count": 3}').pack()
    yield wire.of_frame(frames.BusFrame(1)) + wire.of_frame(frames.BusFrame(2, int(Flag.FD), 12, bytes(12)))
    for flags, number, data in (
        (0, 0x081, bytes(8)),
        (0, 0x601, b"\x10\x14" + bytes(6)),
        (int(Flag.EXTENDED), 0x1FFFFFFF, b"\x01"),
        (int(Flag.FD | Flag.BIT_RATE_SWITCH), 0x640, bytes(range(64))),
        (int(Flag.ERROR), 0x004, b"\0\1\0\0\0\0\0\2"),
    ):
        yield HubRecord(HubKind.FRAME, flags, number, 1_790_000_000_123_456_789, len(data), data).pack()
    yield HubRecord(HubKind.FRAME, int(Flag.REMOTE), 0x080, 1, 8).pack()
    yield HubRecord(HubKind.FRAME, 0, 0x080, 0, 255, b"").pack()


FAMILY = Family(check, tuple(_seeds()))
