"""A python-can bus on which messages fail on their way: ``message_faults.py`` between a program and its bus."""

import contextlib
import math
import time
from collections import deque
from collections.abc import Callable, Iterable

import can

from cutgate.firmware_sim.fault_language import MessageFault
from cutgate.firmware_sim.message_faults import MessageFaults, Tell
from cutgate.protocol.frames import IDS, ControllerHeartbeat, FrameError, decode_frame
from cutgate.protocol.port import RETRY_S
from cutgate.protocol.states import ControllerState
from cutgate.protocol.wire import Side


class FaultyBus(can.BusABC):
    """The bus of one side, faults in both directions. What it does not alter it passes on as it is.

    A frame that was held back leaves or arrives with the next ``send`` or ``recv``; :meth:`late_wait_s` says when that
    should be. A failure of the bus beneath is raised as it is.

    Args:
        bus: the bus beneath; ``shutdown`` ends it as well.
        faults: in the order in which they are asked.
        side: whose bus it is: what is sent on it is this side's, what arrives is the other's.
        controller_state: the controller's state, for ``@STATE``; None takes it from its heartbeats as they pass,
            INHIBITED before the first.
        tell: hears of each fault that happens.
        clock: monotonic seconds.
    """

    def __init__(
        self,
        bus: can.BusABC,
        faults: Iterable[MessageFault],
        *,
        side: Side = Side.CONTROLLER,
        controller_state: Callable[[], ControllerState] | None = None,
        tell: Tell = lambda *_happened: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._bus = bus
        self._heard = ControllerState.INHIBITED
        self.faults = MessageFaults(faults, tell)
        self.side = side
        self.controller_state = controller_state or (lambda: self._heard)
        self._clock = clock
        self._arrived: deque[can.Message] = deque()
        self._leaving: deque[can.Message] = deque()
        self.channel_info = f"{bus.channel_info} with faults"
        self._can_protocol = bus.protocol
        super().__init__(channel=bus.channel_info)

    def fileno(self) -> int:
        """Of the bus beneath."""
        return self._bus.fileno()

    def late_wait_s(self) -> float:
        """How long until something that was held back is due; infinite where nothing is."""
        if self._arrived:
            return 0.0
        if self._leaving:
            return RETRY_S
        due_s = self.faults.next_due_s
        return due_s if due_s == math.inf else max(0.0, due_s - self._clock())

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send one frame, or what the faults make of it.

        Raises:
            can.CanTimeoutError: the queue stayed full; nothing of the frame was sent.
            can.CanOperationError: the bus beneath failed.
        """
        self._release(timeout)
        self._listen(msg)
        self._leaving.extend(self.faults.passing(msg, self.side, self.controller_state(), self._clock()))
        try:
            self._leave(timeout)
        except can.CanTimeoutError:
            return  # it counts as sent: what the faults made of it leaves before anything else does

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        with contextlib.suppress(can.CanTimeoutError):  # it leaves with the next call
            self._release(0.0)
        self._arrived.extend(self.faults.late(self.side.peer, self._clock()))
        if not self._arrived:
            message = self._bus.recv(self._shorter(timeout))
            if message is not None:
                self._listen(message)
                state = self.controller_state()
                self._arrived.extend(self.faults.passing(message, self.side.peer, state, self._clock()))
            self._arrived.extend(self.faults.late(self.side.peer, self._clock()))
        return (self._arrived.popleft() if self._arrived else None), True

    def shutdown(self) -> None:
        """End this bus and the one beneath; may be called more than once."""
        super().shutdown()
        self._bus.shutdown()

    def _shorter(self, timeout: float | None) -> float | None:
        wait_s = self.late_wait_s()
        if wait_s == math.inf:
            return timeout
        return wait_s if timeout is None else min(timeout, wait_s)

    def _release(self, timeout: float | None) -> None:
        """What was held back and is due leaves. Raises CanTimeoutError where it does not."""
        self._leaving.extend(self.faults.late(self.side, self._clock()))
        self._leave(timeout)

    def _leave(self, timeout: float | None) -> None:
        while self._leaving:
            self._bus.send(self._leaving[0], timeout)
            self._leaving.popleft()

    def _listen(self, message: can.Message) -> None:
        """Remember the state that the controller's heartbeat says, before anything happens to it."""
        if message.arbitration_id != IDS[ControllerHeartbeat] or message.is_error_frame:
            return
        try:
            heartbeat = decode_frame(message.arbitration_id, bytes(message.data))
        except FrameError:
            return
        assert isinstance(heartbeat, ControllerHeartbeat)  # noqa: S101 - of this identifier
        self._heard = heartbeat.state
