"""Single frames: the typed codec, and a link that hears anything, sound frames of its own session included."""

from collections.abc import Iterator

from cutgate.protocol.e2e import protect
from cutgate.protocol.frames import (
    DATA_IDS,
    FRAMES,
    SENT_BY,
    TRANSFER_IDS,
    FrameError,
    RuntimeHeartbeat,
    RuntimeStop,
    decode_frame,
    encode_frame,
)
from cutgate.protocol.link import Accepted, Discarded, ForTransfer, Link, Unlisted, Violation
from cutgate.protocol.states import RuntimeCode, StopCause, StopCode
from cutgate.protocol.wire import Side
from tests.protocol.sessions import CODES, TAG
from tools.fuzz.harness import Family, attempt, expect

TRANSFERS = tuple(can_id for side in TRANSFER_IDS.values() for can_id in side.values())
IDS = (*FRAMES, *TRANSFERS, 0x000, 0x7FF, 0x12345)
OP_BYTES = 11
"""How it is sent, which identifier, length, and eight bytes."""


def check(data: bytes) -> None:
    """The codec, and a link of each side, over the same frames."""
    side = Side(data[0] & 1 if data else 0)
    link = Link(side, timeout_s=0.1, heartbeat_s=0.02)
    link.open(CODES, 0.0)
    for number, (how, can_id, content) in enumerate(_frames(data[1:])):
        _codec(can_id, content)
        now_s = number * 0.001 * (1 + how // 64)
        kind = how % 16
        outcome = link.receive(
            can_id,
            content,
            is_extended=kind == 1,
            is_remote=kind == 3,
            is_fd=kind == 5,
            is_error=kind == 7,
            now_s=now_s,
        )
        _outcome(can_id, content, outcome)
        if can_id in SENT_BY[side] and kind not in {1, 7}:
            expect(isinstance(outcome, Violation), f"{can_id:#05x} is a second node")
        lost = link.expire(now_s)
        expect(lost in {None, StopCause.HEARTBEAT_LOST}, "time alone loses the peer, nothing else")
        expect(not link.fresh(now_s), "a peer that answers nothing of ours is never fresh")


def _frames(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    """How each frame is sent, its identifier and its bytes; every second one carries a right CRC."""
    for at in range(0, len(data), OP_BYTES):
        how, which, length, *content = data[at : at + OP_BYTES].ljust(OP_BYTES, b"\0")
        can_id, payload = IDS[which % len(IDS)], bytes(content)
        if how % 2 == 0 and can_id in DATA_IDS:
            payload = protect(payload[3:], payload[2], DATA_IDS[can_id], TAG)
        elif length >= 128:
            payload = (payload * 9)[: length % 73]
        yield how, can_id, payload


def _codec(can_id: int, content: bytes) -> None:
    frame = attempt(FrameError, decode_frame, can_id, content)
    if frame is not None:
        again, sent = encode_frame(frame, content[2], TAG)
        expect((again, sent[2:]) == (can_id, content[2:]), f"{frame} has one form")


def _outcome(can_id: int, content: bytes, outcome: object) -> None:
    listed = isinstance(outcome, Accepted | Discarded | Violation | Unlisted | ForTransfer)
    expect(listed, f"{outcome} is an outcome")
    if isinstance(outcome, Accepted) and not isinstance(outcome.frame, RuntimeStop):
        sent = encode_frame(outcome.frame, outcome.counter, TAG)
        expect(sent == (can_id, content), f"{outcome.frame} was sent as it was accepted")


def _op(how: int, can_id: int, content: bytes) -> bytes:
    return bytes([how, IDS.index(can_id), 0]) + content


def _seeds() -> Iterator[bytes]:
    """Heartbeats with losses and repetitions, stops, one frame of each identifier, and lengths that lie."""
    counters = (0, 1, 1, 2, 5, 9, 255)
    beats = [encode_frame(RuntimeHeartbeat(RuntimeCode.CUT, 3), counter, TAG) for counter in counters]
    stops = [encode_frame(RuntimeStop(code, StopCause.NONE), 0, TAG) for code in StopCode]
    each = [(can_id, bytes(range(8))) for can_id in IDS]
    for side in (b"\0", b"\1"):
        yield side + b"".join(_op(0, *frame) for frame in (*beats, *stops, *each))
        yield side + b"".join(_op(how, *beats[0]) for how in range(16))
        yield side + b"".join(_op(9, can_id, b"\xff" * 8) for can_id in IDS)


FAMILY = Family(check, tuple(_seeds()))
