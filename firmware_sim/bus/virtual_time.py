"""The bus in one process and in virtual time: programs take turns, and time passes only when all of them wait.

A session that takes a minute on a real bus takes what its computations take, and the same one every time. How it is
used: :meth:`VirtualTime.join` a bus for each program, :meth:`VirtualTime.add` each program's loop, then
:meth:`VirtualTime.run`. ``recv`` with a timeout lets time pass as well, so that a script can be written as for any bus.
"""

import os
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Final

import can

from cutgate.firmware_sim.bus.frame import BusFrame, Flag
from cutgate.firmware_sim.bus.medium.bits import Rates
from cutgate.firmware_sim.bus.medium.confinement import NodeState
from cutgate.firmware_sim.bus.medium.medium import QUEUE_FRAMES, Carried, Changed, Event, Medium
from cutgate.firmware_sim.bus.messages import frame_of, message_of
from cutgate.firmware_sim.bus.states import state_frame

NOT_PACED: Final = Rates(10**15)
"""Frames take no time at all."""
TURN_S: Final = 0.001
"""What a turn of a loop takes, about as on a machine: one that never waits must not keep time from passing."""
START_S: Final = 1000.0
_FD, _OWN = int(Flag.FD), int(Flag.OWN)
_NS: Final = 1_000_000_000


class VirtualTime:
    """A bus and a clock.

    Args:
        rates: of the bus.
        queue_frames: frames that each program's transmit queue holds.
        restart_s: so long after it went bus-off a node begins to come back; None: never by itself.
    """

    def __init__(
        self,
        rates: Rates = NOT_PACED,
        *,
        queue_frames: int = QUEUE_FRAMES,
        restart_s: float | None = None,
    ) -> None:
        restart_ns = None if restart_s is None else round(restart_s * _NS)
        self.medium = Medium(rates, queue_frames=queue_frames, restart_ns=restart_ns)
        self.now_ns = round(START_S * _NS)
        self.watchers: list[Callable[[Event], None]] = []
        """Shown everything that happens on the bus, in its order."""
        self._buses: dict[int, VirtualTimeBus] = {}
        self._states: dict[int, NodeState] = {}
        self._loops: list[_Loop] = []

    def clock(self) -> float:
        """Monotonic seconds."""
        return self.now_ns / _NS

    def join(self, name: str, *, fd: bool = False, receive_own_messages: bool = False) -> "VirtualTimeBus":
        """A node more, as python-can's programs use one."""
        number = self.medium.join(name)
        bus = VirtualTimeBus(self, number, name, fd=fd, receive_own_messages=receive_own_messages)
        self._buses[number], self._states[number] = bus, NodeState.ERROR_ACTIVE
        return bus

    def leave(self, number: int) -> None:
        """A node less."""
        if self._buses.pop(number, None) is not None:
            self.medium.leave(number)

    def add(self, bus: "VirtualTimeBus", turn: Callable[[], None], wait_s: Callable[[], float]) -> None:
        """A program's loop.

        Args:
            bus: what it reads; a frame there wakes it.
            turn: one cycle of it.
            wait_s: how long it waits after that if nothing arrives.
        """
        self._loops.append(_Loop(bus, turn, wait_s, self.now_ns, self.now_ns))

    def remove(self, bus: "VirtualTimeBus") -> None:
        """This program runs no more."""
        self._loops = [loop for loop in self._loops if loop.bus is not bus]

    # ------------------------------------------------------------ time passes

    def run(self, seconds: float) -> None:
        """Let so much time pass."""
        self.until(lambda: False, seconds)

    def until(self, condition: Callable[[], bool], limit_s: float) -> bool:
        """Let time pass until it is so, at most so long; whether it is. Asked after all that is heard, and after each turn."""
        end_ns = self.now_ns + round(limit_s * _NS)
        while not (met := condition()) and self.now_ns < end_ns:
            self._step(end_ns)
        return met

    def offer(self, number: int, frame: BusFrame) -> bool:
        """Queue a frame at a node; False where there is no room."""
        return self.medium.offer(number, frame, self.now_ns)

    def _step(self, end_ns: int) -> None:
        """To the next thing that happens, and let it."""
        due_ns = min([end_ns, *[loop.due_ns() for loop in self._loops]])
        events: list[Event] = []
        while not events and (next_ns := self.medium.next_ns) is not None and next_ns <= due_ns:
            self.now_ns = max(
                self.now_ns, next_ns
            )  # of a frame that begins nobody hears: it goes on to its end
            events = self.medium.advance(self.now_ns)
        if not events:
            self.now_ns = max(self.now_ns, due_ns)
        for event in events:
            self._happened(event)
        for loop in list(self._loops):
            if loop.due_ns() <= self.now_ns:
                loop.take(self)

    def _happened(self, event: Event) -> None:
        for tell in self.watchers:
            tell(event)
        match event:
            case Carried(at_ns, frame, senders, receivers, sent):
                for number in receivers:
                    self._deliver(number, frame, at_ns)
                for number in senders if sent else ():
                    bus = self._buses.get(number)
                    if bus is not None and bus.own_frames:
                        own = frame._replace(flags=frame.flags | _OWN)
                        self._deliver(number, own, at_ns)
            case Changed(at_ns, number, state, counters) if number in self._buses:
                before, self._states[number] = self._states[number], state
                self._deliver(number, state_frame(before, state, counters), at_ns)

    def _deliver(self, number: int, frame: BusFrame, at_ns: int) -> None:
        bus = self._buses.get(number)
        if bus is not None and (bus.fd or not frame.flags & _FD):
            bus.inbox.append(message_of(frame, at_ns / _NS, bus.channel_info))


class VirtualTimeBus(can.BusABC):
    """One program's bus in virtual time.

    ``send`` with a full transmit queue raises ``can.CanTimeoutError`` at once, whatever the timeout: a program that
    waited would keep time from passing. ``recv(timeout)`` lets time pass.
    """

    def __init__(
        self, time: VirtualTime, number: int, name: str, *, fd: bool, receive_own_messages: bool
    ) -> None:
        self.number = number
        self.fd = fd
        self.own_frames = receive_own_messages
        self.inbox: deque[can.Message] = deque()
        self.channel_info = name
        self._time = time
        self._descriptor = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._leaving = ExitStack()
        self._leaving.callback(os.close, self._descriptor)
        self._leaving.callback(time.leave, number)
        self._can_protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
        super().__init__(channel=name)

    def fileno(self) -> int:
        """A descriptor for poll, of which nothing ever comes: what is to be read, the turns say.

        Raises:
            can.CanOperationError: it was shut down; the number may be another file's.
        """
        self._must_be_open()
        return self._descriptor

    def _must_be_open(self) -> None:
        if self._is_shutdown:
            raise can.CanOperationError("the bus was shut down by this program")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - python-can's
        """Queue one frame.

        Raises:
            can.CanTimeoutError: the transmit queue has no room.
            can.CanOperationError: a frame that this bus, or no CAN bus, carries; or it was shut down.
        """
        self._must_be_open()
        if not self._time.offer(self.number, frame_of(msg, fd=self.fd)):
            raise can.CanTimeoutError(f"the transmit queue of {self.channel_info} is full")

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame that the filters let through; while it waits time passes, for everybody.

        python-can's own waits by the computer's clock.

        Raises:
            can.CanOperationError: without a timeout, for it could wait for ever; or it was shut down.
        """
        if timeout is None:
            raise can.CanOperationError("in virtual time recv needs a timeout: it could wait for ever")
        end_s = self._time.clock() + timeout
        while True:
            self._must_be_open()
            while self.inbox:
                message = self.inbox.popleft()
                if message.is_error_frame or self._matches_filters(message):
                    return message
            if not self._time.until(lambda: bool(self.inbox), end_s - self._time.clock()):
                return None

    def shutdown(self) -> None:
        """Leave the bus; may be called more than once."""
        super().shutdown()
        self._leaving.close()


@dataclass
class _Loop:
    """A program's loop, and when it has its next turn."""

    bus: VirtualTimeBus
    turn: Callable[[], None]
    wait_s: Callable[[], float]
    free_ns: int
    """It is busy with the last turn until then."""
    wake_ns: int

    def due_ns(self) -> int:
        return self.free_ns if self.bus.inbox else max(self.free_ns, self.wake_ns)

    def take(self, time: VirtualTime) -> None:
        self.turn()
        self.free_ns = time.now_ns + round(TURN_S * _NS)
        self.wake_ns = time.now_ns + round(self.wait_s() * _NS)
