"""The tags of heartbeats and joint samples, one single frame after the other as the runtime has logged them.

    tags = Tags(codes)
    for record in /can/frame, in the log's order, from the record on that opened the session:
        unfit = tags.take(record)  # what does not fit; empty for everything else

Who reads along knows what either side had made and heard, and so extends counters and echoes as ``docs/protocol.md``
(Tags) says; where this side lost frames or stood still it knows more than that side did, and checks what it refused as
well. Rules:

- A heartbeat that was sent has the counter after the last one's, and its echo is either the one before or the last
  heartbeat heard that ends in these 8 bits; no echo is all ones.
- A heartbeat that came has the next counter that ends in its 8 bits, the first one upper bits 0; its echo is the last
  heartbeat sent that ends so; 255 is none until another one came.
- A joint sample is checked once its three parts carry one counter: the one nearest to the last heartbeat's.
- What came with a wrong CRC, length or kind is damaged, what came again byte by byte is a repetition: neither has a
  tag to check. What was sent is never damaged.
"""

from typing import Final

from cutgate.protocol.codes import NO_ECHO, SessionCodes
from cutgate.protocol.e2e import COUNTER_MODULUS, intact
from cutgate.protocol.frames import (
    DATA_IDS,
    ECHO_NONE,
    FRAMES,
    IDS,
    SENT_BY,
    ControllerHeartbeat,
    Frame,
    Joint4,
    Joints01,
    Joints23,
    RuntimeHeartbeat,
    decode_frame,
)
from cutgate.protocol.link import COVERED_BYTES, NO_SESSION, nearest
from cutgate.protocol.states import RuntimeCode
from cutgate.protocol.wire import Side
from cutgate.runtime.audit.records import CanFrame

OURS: Final = IDS[RuntimeHeartbeat]
THEIRS: Final = IDS[ControllerHeartbeat]
JOINTS: Final = tuple(IDS[kind] for kind in (Joints01, Joints23, Joint4))
UNFIT: Final = "its tag is none that a holder of the key made here"


class Tags:
    """Both sides' frames of one session.

    Attributes:
        sent, came, samples: heartbeats of this side, of the controller, joint samples whose tag fits.
        damaged: frames of the controller's identifiers that were damaged.
        strangers: frames that came on identifiers that only this side sends on.
    """

    def __init__(self, codes: SessionCodes) -> None:
        self._codes = codes
        self.sent = self.came = self.samples = self.damaged = self.strangers = 0
        self._made = -1
        """This side's last heartbeat, extended to 32 bits."""
        self._echo = NO_ECHO
        """What it echoed."""
        self._peer: int | None = None
        """The controller's last heartbeat, extended to 32 bits."""
        self._heard = False
        """Whether the controller has echoed any."""
        self._last: dict[int, bytes] = {}
        self._parts: dict[int, tuple[int, Frame]] = {}

    def take(self, record: CanFrame) -> str:
        """One frame: which one does not fit, empty where nothing is wrong.

        Raises:
            ValueError: its data are no hexadecimal digits.
        """
        data = bytes.fromhex(record.data)
        if record.is_extended or record.is_error or record.id not in FRAMES:
            return ""
        shaped = len(data) == record.dlc and not record.is_rtr
        whole = shaped and intact(data, DATA_IDS[record.id], self._codes.tag)
        if record.direction == "sent":
            return self._leaving(record.id, data, whole=whole)
        if record.id in SENT_BY[Side.RUNTIME]:
            self.strangers += 1
        elif whole:
            return self._came(record.id, data)
        elif not (shaped and intact(data, DATA_IDS[record.id], NO_SESSION)):
            self.damaged += 1
        return ""

    def _came(self, can_id: int, data: bytes) -> str:
        if self._last.get(can_id) == data:
            return ""
        if can_id == THEIRS:
            return self._heartbeat(data)
        self._last[can_id] = data
        return self._part(can_id, data) if can_id in JOINTS and self._peer is not None else ""

    def _leaving(self, can_id: int, data: bytes, *, whole: bool) -> str:
        self._made += can_id == OURS
        if not whole:
            return f"frame {can_id:#05x} left damaged"
        if can_id != OURS:
            return ""
        if data[5] != self._echo % COUNTER_MODULUS:
            self._echo = -1 if self._peer is None else _last_ending_so(data[5], self._peer)
        counted = data[2] == self._made % COUNTER_MODULUS
        if not (counted and self._fits(Side.RUNTIME, data, self._made, self._echo)):
            return f"heartbeat {self._made} that left: {UNFIT}"
        self.sent += 1
        return ""

    def _heartbeat(self, data: bytes) -> str:
        counter = data[2] if self._peer is None else self._peer + (data[2] - self._peer) % COUNTER_MODULUS
        none = data[5] == ECHO_NONE and not self._heard
        echo = NO_ECHO if none else _last_ending_so(data[5], self._made)
        if not self._fits(Side.CONTROLLER, data, counter, echo):
            return f"heartbeat {counter} that came: {UNFIT}"
        self._last[THEIRS], self._peer = data, counter
        self._heard = self._heard or not none
        self.came += 1
        return ""

    def _fits(self, sender: Side, data: bytes, counter: int, echo: int) -> bool:
        """Whether a heartbeat's tag is that of this counter and echo."""
        if not (0 <= counter <= NO_ECHO and 0 <= echo <= NO_ECHO):
            return False
        made = self._codes.heartbeat_tag(sender, counter, echo, data[-COVERED_BYTES:])
        return made == int.from_bytes(data[3:5], "little")

    def _part(self, can_id: int, data: bytes) -> str:
        """A part of a sample; of one that has come already the first counts, as it did for the runtime."""
        assert self._peer is not None  # noqa: S101 - asked before
        cycle = nearest(data[2], self._peer)
        if can_id in self._parts and self._parts[can_id][0] == cycle:
            return ""
        self._parts[can_id] = (cycle, decode_frame(can_id, data))
        parts = [self._parts[part] for part in JOINTS if part in self._parts]
        match [frame for of_cycle, frame in parts if of_cycle == cycle]:
            case [Joints01() as first, Joints23() as second, Joint4() as third]:
                counts = (first.q0, first.q1, second.q2, second.q3, third.q4)
                if cycle < 0 or self._codes.sample_tag(cycle, counts) != third.tag:
                    return f"joint sample {cycle}: {UNFIT}"
                self.samples += 1
        return ""


def _last_ending_so(echo: int, last: int) -> int:
    """The last of the heartbeats up to this one that ends in these 8 bits; negative if none does."""
    return last - (last - echo) % COUNTER_MODULUS


def enables(heartbeat: CanFrame) -> bool:
    """Whether a heartbeat of this side asks for more than to stand still. Raises ValueError: it is none."""
    frame = decode_frame(OURS, bytes.fromhex(heartbeat.data))
    return not (isinstance(frame, RuntimeHeartbeat) and frame.code is RuntimeCode.INHIBIT)
