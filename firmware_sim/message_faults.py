"""What becomes of frames on their way under the faults of ``fault_language.py``. Pure: no bus, no clock.

To a frame at most one thing happens: the first fault that concerns it and whose chance has come. Each fault draws from
a generator of its own, seeded by its line, so that the faults beside it change nothing of what it does to the same
frames.
"""

import heapq
import math
import random
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import count
from typing import Final

import can

from cutgate.firmware_sim.fault_language import ANY, MESSAGES, MessageAction, MessageFault
from cutgate.protocol.states import ControllerState
from cutgate.protocol.wire import Side

REORDER_MAX_S: Final = 0.25
"""A frame that waits for the next one of its sender arrives then at the latest."""
LATE_MAX: Final = 20_000
"""Frames that are on their way at once; one more is lost, and counted."""
HISTORY_MAX: Final = 1000
"""Frames that a replay chooses from, the last of each sender."""
FLIPPED_MAX: Final = 3
NOT_OURS: Final = 0x123
"""An identifier that cutgate does not use: where a misaddressed frame may also go."""
_LENGTHS: Final = (*range(9), 12, 16, 20, 24, 32, 48, 64)

Tell = Callable[[MessageFault, int, can.Message], None]
"""Hears of each fault that happens: which, how often with this one, to which frame."""


@dataclass
class _Running:
    """A fault with what it has done so far."""

    fault: MessageFault
    draw: random.Random
    done: int = 0
    earlier: dict[Side, deque[can.Message]] = field(default_factory=dict)

    def due(self, state: ControllerState) -> bool:
        """Whether it happens to a frame that it concerns; draws only where that is left to chance."""
        fault = self.fault
        if fault.state not in (None, state) or (fault.times is not None and self.done >= fault.times):
            return False
        return fault.probability == 1.0 or self.draw.random() < fault.probability

    def later_s(self) -> float:
        """How much later, where the line says so; else at once."""
        low, high = self.fault.by_ms or (0, 0)
        return (low if low == high else self.draw.uniform(low, high)) / 1000.0


class MessageFaults:
    """The faults of one bus, both ways.

    Args:
        faults: in the order in which they are asked.
        tell: hears of each that happens.

    Attributes:
        overflowed: frames lost because too many were on their way.
    """

    def __init__(self, faults: Iterable[MessageFault], tell: Tell = lambda *_happened: None) -> None:
        self._running = [_Running(fault, random.Random(fault.seed)) for fault in faults]  # noqa: S311 - to be repeated
        self._tell = tell
        self._late: dict[Side, list[tuple[float, int, can.Message]]] = {side: [] for side in Side}
        self._waiting: dict[Side, tuple[float, can.Message] | None] = dict.fromkeys(Side)
        self._order = count()
        self.overflowed = 0

    @property
    def done(self) -> dict[MessageFault, int]:
        """How often each has happened."""
        return {running.fault: running.done for running in self._running}

    @property
    def next_due_s(self) -> float:
        """When the next frame that was held back arrives; infinite where none is."""
        late = [heap[0][0] for heap in self._late.values() if heap]
        waiting = [entry[0] for entry in self._waiting.values() if entry is not None]
        return min((*late, *waiting), default=math.inf)

    def late(self, sender: Side, now_s: float) -> list[can.Message]:
        """What was held back of this sender's and arrives by now, in the order in which it was due."""
        heap, arriving = self._late[sender], []
        while heap and heap[0][0] <= now_s:
            arriving.append(heapq.heappop(heap)[2])
        waiting = self._waiting[sender]
        if waiting is not None and waiting[0] <= now_s:
            arriving.append(waiting[1])
            self._waiting[sender] = None
        return arriving

    def passing(
        self, message: can.Message, sender: Side, state: ControllerState, now_s: float
    ) -> list[can.Message]:
        """What arrives at once of a frame that its sender has just sent.

        Args:
            message: the frame; it is not altered.
            sender: whose it is.
            state: the controller's.
            now_s: monotonic seconds, never earlier than at the call before.
        """
        held = self._waiting[sender]
        arriving = self._befallen(message, sender, state, now_s)
        if held is not None:  # it has waited for this one, whatever becomes of it
            self._waiting[sender] = None
            arriving = [*arriving, held[1]]
        return arriving

    def _befallen(
        self, message: can.Message, sender: Side, state: ControllerState, now_s: float
    ) -> list[can.Message]:
        if message.is_extended_id or message.is_remote_frame or message.is_error_frame:
            return [message]
        for running in self._running:
            if message.arbitration_id not in running.fault.can_ids:
                continue
            arriving = None
            if self._can(running, message, sender) and running.due(state):
                arriving = self._happen(running, message, sender, now_s)
            if running.fault.action is MessageAction.REPLAY:
                running.earlier.setdefault(sender, deque(maxlen=HISTORY_MAX)).append(message)
            if arriving is not None:
                running.done += 1
                self._tell(running.fault, running.done, message)
                return arriving
        return [message]

    def _can(self, running: _Running, message: can.Message, sender: Side) -> bool:
        """Whether this can happen to that frame at all."""
        match running.fault.action:
            case MessageAction.CORRUPT | MessageAction.SHORTEN:
                return len(message.data) > 0
            case MessageAction.REPLAY:
                return bool(running.earlier.get(sender))
            case MessageAction.REORDER:
                return self._waiting[sender] is None
            case _:
                return True

    def _happen(
        self, running: _Running, message: can.Message, sender: Side, now_s: float
    ) -> list[can.Message]:
        """Changes the frame, or when it arrives; which of both is the action's."""
        action = running.fault.action
        if action in _CHANGES:
            return _CHANGES[action](message, running.draw)
        if action is MessageAction.REORDER:
            self._waiting[sender] = (now_s + REORDER_MAX_S, message)
            return []
        at_once = [] if action is MessageAction.DELAY else [message]
        again = running.draw.choice(running.earlier[sender]) if action is MessageAction.REPLAY else message
        return [*at_once, *self._later(running, again, sender, now_s)]

    def _later(
        self, running: _Running, message: can.Message, sender: Side, now_s: float
    ) -> list[can.Message]:
        """Holds a frame back as long as the fault says; itself where that is not at all."""
        later_s = running.later_s()
        if later_s == 0.0:
            return [message]
        if sum(map(len, self._late.values())) >= LATE_MAX:
            self.overflowed += 1
            return []
        heapq.heappush(self._late[sender], (now_s + later_s, next(self._order), message))
        return []


def _corrupted(message: can.Message, draw: random.Random) -> list[can.Message]:
    """With one to three different bits flipped."""
    data = bytearray(message.data)
    for bit in draw.sample(range(8 * len(data)), draw.randint(1, FLIPPED_MAX)):
        data[bit // 8] ^= 1 << bit % 8
    return [_changed(message, data=bytes(data))]


def _shortened(message: can.Message, draw: random.Random) -> list[can.Message]:
    """To a length that a CAN frame can have."""
    lengths = [length for length in _LENGTHS if length < len(message.data)]
    return [_changed(message, data=bytes(message.data)[: draw.choice(lengths)])]


def _misaddressed(message: can.Message, draw: random.Random) -> list[can.Message]:
    others = sorted({*MESSAGES[ANY], NOT_OURS} - {message.arbitration_id})
    return [_changed(message, can_id=draw.choice(others))]


_CHANGES: Final[dict[MessageAction, Callable[[can.Message, random.Random], list[can.Message]]]] = {
    MessageAction.LOSE: lambda _message, _draw: [],
    MessageAction.CORRUPT: _corrupted,
    MessageAction.SHORTEN: _shortened,
    MessageAction.MISADDRESS: _misaddressed,
}
"""What is done to a frame; all other actions change when, or how often, it arrives."""


def _changed(message: can.Message, *, data: bytes | None = None, can_id: int | None = None) -> can.Message:
    """A copy with other bytes or another identifier; when and where it came from stays."""
    return can.Message(
        timestamp=message.timestamp,
        arbitration_id=message.arbitration_id if can_id is None else can_id,
        is_extended_id=False,
        data=bytes(message.data) if data is None else data,
        is_fd=message.is_fd,
        bitrate_switch=message.bitrate_switch,
        is_rx=message.is_rx,
        channel=message.channel,
    )
