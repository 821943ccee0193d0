"""What a tester hears of a controller: each item with its time, the signs of a stop, and that nothing moves."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from cutgate.protocol import records
from cutgate.protocol.endpoint import Item, RecordReceived, Undelivered
from cutgate.protocol.frames import ControllerFault, ControllerHeartbeat, Progress
from cutgate.protocol.link import Accepted, JointSample
from cutgate.protocol.port import Passed
from cutgate.protocol.records import Record
from cutgate.protocol.states import ControllerState, FaultCode, StopCause
from cutgate.runtime.conform.failures import HaltError, OperatorError

NOISE_DEG: Final = 0.05
"""Measured joints of an arm that stands may change by so much, deg or mm."""
STANDING: Final = frozenset({ControllerState.INHIBITED, ControllerState.FAULT})


@dataclass(frozen=True)
class Heard:
    """What arrived, and when."""

    at_s: float
    item: Item


@dataclass(frozen=True)
class Seen:
    """A frame that passed, and when."""

    at_s: float
    passed: Passed


@dataclass(frozen=True)
class Stop:
    """The first sign of a stop, and when it was heard."""

    after_s: float
    cause: StopCause
    latched: bool

    def __str__(self) -> str:
        kind = "latched fault" if self.latched else "stop"
        return f"{kind} {self.cause.name} after {self.after_s * 1000:.0f} ms"


def shown(answer: Record | None) -> str:
    """An answer in a few words."""
    match answer:
        case None:
            return "no answer"
        case records.Reply():
            return f"Reply {answer.refusal.name}"
        case records.PathStored():
            return f"PathStored {answer.refusal.name}, pose {answer.pose}"
        case _:
            return type(answer).__name__


def sign_of_a_stop(item: Item, now_s: float) -> Stop | None:
    """A fault frame, a heartbeat that says so, an announcement; dated by the tester's clock."""
    match item:
        case Accepted(frame=ControllerFault(code=code, cause=cause)):
            return Stop(now_s, cause, code is FaultCode.LATCHED)
        case Accepted(frame=ControllerHeartbeat(state=state, cause=cause)) if state in STANDING:
            return Stop(now_s, cause, state is ControllerState.FAULT)
        case RecordReceived(record=records.Announce(state=state, cause=cause)):
            return Stop(now_s, cause, state is ControllerState.FAULT)
        case _:
            return None


class Standstill:
    """Whatever the case is about: the device stays released, nothing moves, the cutter is off unless permitted.

    Attributes:
        state: the controller's heartbeat that was heard last.
        moved: the largest change of a measured joint, deg or mm.
        abnormal: what should not have been, in words.
    """

    def __init__(self) -> None:
        self.state: ControllerHeartbeat | None = None
        self.moved = 0.0
        self.abnormal: list[str] = []
        self._reference: JointSample | None = None

    def take(self, item: Item) -> None:
        """What arrived.

        Raises:
            HaltError: something moved, or the enabling device is pressed.
        """
        match item:
            case Accepted(frame=ControllerHeartbeat() as beat):
                self.state = beat
                if beat.device_pressed:
                    raise OperatorError(
                        "the enabling device is pressed; it must stay released during the suite"
                    )
                if beat.state in {ControllerState.CUTTING, ControllerState.DONE}:
                    self.abnormal.append(f"state {beat.state.name}")
                    raise HaltError(f"the controller is in state {beat.state.name}; nothing may ever move")
                if beat.cutting_mode != (beat.state is ControllerState.PERMITTED):
                    self.abnormal.append(f"cutting mode {beat.cutting_mode} in {beat.state.name}")
            case Accepted(frame=Progress()):
                self.abnormal.append("a Progress frame")
            case Undelivered(detail):
                self.abnormal.append(detail)
            case Accepted(sample=JointSample() as measured):
                self._joints(measured)
            case _:
                pass

    def _joints(self, measured: JointSample) -> None:
        self._reference = self._reference or measured
        change = np.array(measured.joints - self._reference.joints)
        change[[0, 1, 3, 4]] = np.degrees(change[[0, 1, 3, 4]])
        self.moved = max(self.moved, float(np.abs(change).max()))
        if not self.moved <= NOISE_DEG:
            self.abnormal.append(f"a joint moved by {self.moved:.3f} deg or mm")
            raise HaltError(f"a joint moved by {self.moved:.3f} deg or mm, must stay within {NOISE_DEG}")
