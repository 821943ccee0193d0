"""End-to-end protection of single frames: CRC, counter, data ID and session tag.

The shape is AUTOSAR E2E profile 5: CRC-16 (polynomial 0x1021, start 0xFFFF) in bytes 0-1, low byte first, counter
in byte 2, five bytes of payload. The CRC covers bytes 2-7, then four virtual bytes of session tag, then the two
bytes of the message's data ID, both low byte first; neither is sent.
"""

import binascii
from collections import deque
from dataclasses import dataclass, field
from enum import Enum, unique

FRAME_BYTES = 8
PAYLOAD_BYTES = 5
COUNTER_MODULUS = 256
GAP_MAX = 3
"""Greatest counter step that is taken for loss; beyond it the sequence is broken."""
CRC_FAILURES_MAX = 2
CRC_WINDOW_S = 1.0


def crc16(covered: bytes, data_id: int, tag: int) -> int:
    """The CRC over a frame's bytes from the counter on, the session tag and the data ID."""
    return binascii.crc_hqx(covered + tag.to_bytes(4, "little") + data_id.to_bytes(2, "little"), 0xFFFF)


def protect(payload: bytes, counter: int, data_id: int, tag: int) -> bytes:
    """Eight protected bytes around five bytes of payload. Raises ValueError for another length."""
    if len(payload) != PAYLOAD_BYTES:
        raise ValueError(f"payload is {len(payload)} bytes, must be {PAYLOAD_BYTES}")
    covered = bytes([counter]) + payload
    return crc16(covered, data_id, tag).to_bytes(2, "little") + covered


def intact(data: bytes, data_id: int, tag: int) -> bool:
    """Whether eight bytes carry this message, unchanged, of this session."""
    return len(data) == FRAME_BYTES and int.from_bytes(data[:2], "little") == crc16(data[2:], data_id, tag)


@unique
class Step(Enum):
    """What a frame's counter says, by its distance from the last accepted one."""

    NEXT = "next"
    """Accepted; `lost` frames are missing before it."""
    REPEATED = "repeated"
    """The last frame once more: discarded, refreshes nothing."""
    BROKEN = "broken"
    """Another frame under the last counter, or a gap too wide."""


@dataclass
class Sequence:
    """The receiver's memory of one message's counter."""

    last: bytes | None = None

    def judge(self, data: bytes) -> tuple[Step, int]:
        """What to do with an intact frame, and how many were lost before it.

        The first frame of a session may carry any counter: the two sides do not open at the same instant.
        """
        if self.last is None:
            self.last = data
            return Step.NEXT, 0
        delta = (data[2] - self.last[2]) % COUNTER_MODULUS
        if delta == 0:
            return (Step.REPEATED if data == self.last else Step.BROKEN), 0
        if not delta <= GAP_MAX:
            return Step.BROKEN, delta - 1
        self.last = data
        return Step.NEXT, delta - 1


@dataclass
class CorruptionCount:
    """Counts frames that fail their CRC: two in any second are tolerated, a third is not."""

    failures_s: deque[float] = field(default_factory=deque)

    def tolerated(self, now_s: float) -> bool:
        """Count one more failure; whether the number within one second is still within its bound."""
        self.failures_s.append(now_s)
        while self.failures_s and not now_s - self.failures_s[0] <= CRC_WINDOW_S:
            self.failures_s.popleft()
        return len(self.failures_s) <= CRC_FAILURES_MAX
