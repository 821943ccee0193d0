"""Transfers: two endpoints that carry sound records while frames are lost, doubled, altered and invented between them."""

from collections.abc import Iterator

from cutgate.protocol.endpoint import Endpoint, RecordReceived
from cutgate.protocol.frames import BULK_IDS, CONTROL_IDS
from cutgate.protocol.link import Accepted, Discarded, Violation
from cutgate.protocol.path import split
from cutgate.protocol.records import ENVELOPE_BYTES_MAX, NonceRequest, Side, pack
from cutgate.protocol.states import Purpose
from cutgate.protocol.transfer import PAYLOAD_BYTES_MAX, Transfer
from tests.protocol.sessions import DIGEST, KEY, TAG
from tools.fuzz.harness import Family, expect

OP_BYTES = 9
"""What happens, and eight bytes for it."""
BLOCK = split(bytes(range(250)) * 4)[0]
OPEN_TIMING = {"heartbeat_s": 0.02, "timeout_s": 0.1}


def check(data: bytes) -> None:
    """A lone transfer that is fed anything, and a controller between whom and the runtime anything happens.

    Both with classic frames and with FD frames.
    """
    for fd in (False, True):
        _lone(data, fd=fd)
        _conversation(data, fd=fd)


def _lone(data: bytes, *, fd: bool) -> None:
    transfer, size = Transfer(CONTROL_IDS[1], CONTROL_IDS[0], fd=fd), 64 if fd else 8
    transfer.send(bytes(100), 0.0)
    fed = 0
    for at in range(0, len(data), size):
        transfer.feed(data[at : at + size].ljust(8, b"\0"))
        fed += size
        transfer.expire(at * 0.001)
        for payload in transfer.received():
            expect(len(payload) <= min(fed, PAYLOAD_BYTES_MAX), "no record is longer than its frames")
        expect(len(transfer.outgoing()) <= 40, "one frame brings out no more than a block of frames")
        transfer.errors()


def _conversation(data: bytes, *, fd: bool) -> None:
    """Whatever is done to frames, a record that arrives is one that was sent, whole and once."""
    runtime, controller = _endpoint(Side.RUNTIME, fd=fd), _endpoint(Side.CONTROLLER, fd=fd)
    sent: list[bytes] = []
    arrived: list[bytes] = []
    for number, (what, content) in enumerate(_ops(data)):
        now_s = number * 0.001
        if what == 0:
            record = BLOCK if content[0] % 2 else NonceRequest(Purpose.START)
            queued = runtime.send_record(record, now_s)
            expect(queued.payload == pack(record, TAG, queued.sequence), "what is sent has one form")
            sent.append(queued.payload)
        for can_id, frame in _altered(runtime.outgoing(), what, content):
            items = controller.receive(can_id, frame, is_fd=runtime.is_fd(can_id), now_s=now_s)
            arrived += _received(items, sent)
        for can_id, frame in _altered(controller.outgoing(), what if content[7] % 2 else 1, content):
            runtime.receive(can_id, frame, is_fd=controller.is_fd(can_id), now_s=now_s)
        controller.expire(now_s)
        runtime.expire(now_s)
    expect(len(arrived) == len(set(arrived)), "no record arrives twice")


def _endpoint(side: Side, *, fd: bool) -> Endpoint:
    endpoint = Endpoint(side, KEY, **OPEN_TIMING, transfer_timeout_s=0.05, fd=fd)
    endpoint.use_session(DIGEST)
    endpoint.open_link(0.0)
    return endpoint


def _ops(data: bytes) -> Iterator[tuple[int, bytes]]:
    for at in range(0, len(data), OP_BYTES):
        op = data[at : at + OP_BYTES].ljust(OP_BYTES, b"\0")
        yield op[0] % 8, op[1:]


def _altered(frames: list[tuple[int, bytes]], what: int, content: bytes) -> list[tuple[int, bytes]]:
    """What becomes of these frames; 0 and 1 leave them alone."""
    at = content[1] % len(frames) if frames else 0
    before, here, after = frames[:at], frames[at : at + 1], frames[at + 1 :]
    match what:
        case 2:
            here = []
        case 3:
            here = here * 2
        case 4:
            here = [(can_id, _flipped(frame, content)) for can_id, frame in here]
        case 5:
            before, after = after, before
        case 6:
            after = [*after, *((can_id, content) for can_id in CONTROL_IDS)]
        case 7:
            after = [*after, *((can_id, content) for can_id in BULK_IDS)]
    return [*before, *here, *after]


def _flipped(frame: bytes, content: bytes) -> bytes:
    at = content[2] % 8
    return frame[:at] + bytes([frame[at] ^ (content[3] or 1)]) + frame[at + 1 :]


def _received(items: list[object], sent: list[bytes]) -> Iterator[bytes]:
    for item in items:
        expect(isinstance(item, RecordReceived | Accepted | Discarded | Violation), f"{item} is an item")
        if isinstance(item, RecordReceived):
            payload = pack(item.record, item.session, item.sequence)
            expect(payload in sent and len(payload) == item.size, f"{item.record} was sent")
            expect(item.size <= ENVELOPE_BYTES_MAX, "a record fits a transfer")
            yield payload


def _seeds() -> Iterator[bytes]:
    """Both records undisturbed, and with each kind of disturbance; first frames that announce far too much."""
    send_both = b"\0" + bytes(8) + b"\0" + bytes([1]) + bytes(7)
    yield send_both + (b"\1" + bytes(8)) * 8
    for what in range(2, 8):
        yield send_both + (bytes([what]) + bytes([0, what, 3, 0x40, 0, 0, 0, what])) * 8
    yield bytes.fromhex("1000ffffffff0102") * 4 + bytes.fromhex("1fff010203040506 2101020304050607") * 4
    yield bytes.fromhex("300000cccccccccc 302000cccccccccc 3120ffcccccccccc 3f00000000000000")


FAMILY = Family(check, tuple(_seeds()))
