"""A CAN bus in memory, in virtual time: everybody hears everybody else, and a test can come between."""

import os
from collections import deque
from collections.abc import Callable, Container
from dataclasses import dataclass, field
from typing import TypeVar

import can

from cutgate.protocol.frames import IDS, Frame, decode_frame
from cutgate.protocol.records import Side

F = TypeVar("F", bound=Frame)

RUNTIME, CONTROLLER = Side.RUNTIME, Side.CONTROLLER


@dataclass
class Clock:
    """Seconds that pass only when a test says so."""

    now_s: float = 1000.0

    def __call__(self) -> float:
        return self.now_s

    def monotonic_ns(self) -> int:
        return round(self.now_s * 1e9)

    def utc_ns(self) -> int:
        return 1_790_000_000_000_000_000 + self.monotonic_ns()


@dataclass(frozen=True)
class Seen:
    """A frame as it was sent: when, by whom, and what the disk had made durable of the log by then."""

    at_s: float
    sender: Side
    can_id: int
    data: bytes
    durable: int
    is_fd: bool = False


Rule = Callable[[can.Message], list[can.Message]]
"""What becomes of a frame on its way: itself, nothing, another, several."""


@dataclass
class Wire:
    """The bus. ``rules`` act on what passes, first to last; ``late`` holds what arrives after its time."""

    clock: Clock
    durable: Callable[[], int] = lambda: 0
    rules: list[Rule] = field(default_factory=list)
    seen: list[Seen] = field(default_factory=list)
    late: list[tuple[float, "Node", can.Message]] = field(default_factory=list)
    delay_s: dict[int, float] = field(default_factory=dict)
    """By identifier: how long its frames are on their way."""

    def __post_init__(self) -> None:
        self.nodes = {side: Node(self) for side in Side}

    def pass_on(self, sender: "Node", message: can.Message) -> None:
        """Deliver to the other node, whatever the rules make of it."""
        side = next(side for side, node in self.nodes.items() if node is sender)
        data = bytes(message.data)
        self.seen.append(
            Seen(self.clock(), side, message.arbitration_id, data, self.durable(), message.is_fd)
        )
        passing = [message]
        for rule in self.rules:
            passing = [after for before in passing for after in rule(before)]
        for arriving in passing:
            due_s = self.clock() + self.delay_s.get(arriving.arbitration_id, 0.0)
            self.late.append((due_s, self.nodes[side.peer], arriving))

    def deliver(self) -> None:
        """Hand over what is due, in the order in which it was sent."""
        waiting = self.late
        self.late = [entry for entry in waiting if entry[0] > self.clock()]
        for due_s, node, message in waiting:
            if due_s <= self.clock():
                node.inbox.append(message)

    def frames(self, kind: type[F]) -> list[tuple[Seen, F]]:
        """Every frame of a kind that was sent."""
        sent = [seen for seen in self.seen if seen.can_id == IDS[kind]]
        return [(seen, decode_frame(seen.can_id, seen.data)) for seen in sent]  # type: ignore[misc]


class Node:
    """One side's bus, as far as python-can's interface is used."""

    def __init__(self, wire: Wire) -> None:
        self._wire = wire
        self.inbox: deque[can.Message] = deque()
        self.broken = False
        self.deaf = self.mute = False
        """The bus cannot be read, or not be written, any more."""
        self.room: int | None = None
        """So many frames fit into the transmit queue, which is empty again by the next turn; None: any number."""
        self._left = 0
        self.refused = 0
        """How many frames found no room."""
        self._descriptor = os.eventfd(0)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        assert timeout == 0, "a loop must not wait in recv"
        if self.broken or self.deaf:
            raise can.CanOperationError("the bus is gone")
        self._left = self.room or 0  # a turn begins
        self._wire.deliver()
        return self.inbox.popleft() if self.inbox else None

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        assert timeout == 0, "a loop must not wait in send"
        if self.broken or self.mute:
            raise can.CanOperationError("the bus is gone")
        if self.room is not None:
            if self._left == 0:
                self.refused += 1
                raise can.CanTimeoutError("the transmit queue is full")
            self._left -= 1
        self._wire.pass_on(self, message)

    def put(self, can_id: int, data: bytes) -> None:
        """A frame that neither side has sent arrives here."""
        self.inbox.append(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def fileno(self) -> int:
        return self._descriptor

    def shutdown(self) -> None:
        os.close(self._descriptor)


# ---------------------------------------------------------------- what may happen on the way


def of(kind: type[Frame]) -> int:
    """The identifier of a kind of frame."""
    return IDS[kind]


def nth(can_id: int, which: Container[int], change: Rule) -> Rule:
    """Apply ``change`` to those frames of an identifier, counted from now."""
    count = 0

    def rule(message: can.Message) -> list[can.Message]:
        nonlocal count
        if message.arbitration_id != can_id:
            return [message]
        count += 1
        return change(message) if count - 1 in which else [message]

    return rule


def lose(_message: can.Message) -> list[can.Message]:
    return []


def double(message: can.Message) -> list[can.Message]:
    return [message, message]


def flip(message: can.Message) -> list[can.Message]:
    """One bit of the last byte."""
    data = bytes(message.data)
    changed = data[:-1] + bytes([data[-1] ^ 1])
    return [
        can.Message(
            arbitration_id=message.arbitration_id,
            data=changed,
            is_extended_id=False,
            is_fd=message.is_fd,
            bitrate_switch=message.bitrate_switch,
        )
    ]
