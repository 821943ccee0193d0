"""Every single frame as a typed value. The DBC is the truth: cantools packs and unpacks by it.

Fields hold raw counts, so that what is sent is what is received; properties give units. A field beyond its bits,
an unknown code and a set reserved bit are refused, never wrapped or clamped.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from importlib.resources import files
from typing import Any, ClassVar, get_type_hints

import cantools.database
import numpy as np
from cantools.database.can import Database, Message

from cutgate.protocol.arrays import Floats
from cutgate.protocol.e2e import protect
from cutgate.protocol.states import ControllerState, FaultCode, RuntimeCode, StopCause, StopCode
from cutgate.protocol.wire import Channel, Side

ECHO_NONE = 255
"""Echo of a side that has not yet accepted a heartbeat of its peer."""
ROTATION_DEG = 0.005
SLIDE_MM = 0.01
JOINT_COUNT_MAX = 524_287
"""Of a joint, either way: 20 bits."""
FRACTION_MAX = 65535

CONTROL_IDS = (0x600, 0x601)
"""ISO-TP identifiers of the control channel: the runtime's, the controller's."""
BULK_IDS = (0x640, 0x641)
"""ISO-TP identifiers of the bulk channel: the runtime's, the controller's."""
TRANSFER_IDS: dict[Side, dict[Channel, int]] = {
    side: {Channel.CONTROL: CONTROL_IDS[side], Channel.BULK: BULK_IDS[side]} for side in Side
}
"""The ISO-TP identifiers each side sends on."""


class FrameError(ValueError):
    """A frame that cannot be sent, or whose content is not listed."""


def _load() -> Database:
    text = files("cutgate.protocol").joinpath("cutgate.dbc").read_bytes().decode("ascii")
    database = cantools.database.load_string(text, "dbc")
    if not isinstance(database, Database):
        raise TypeError("protocol/cutgate.dbc is not a CAN database")
    return database


DATABASE = _load()


@dataclass(frozen=True)
class Frame:
    """Base of all single frames; fields have the names of the DBC's signals."""

    SENDER: ClassVar[Side]

    def __post_init__(self) -> None:
        for name, kind, low, high in _fields(type(self)):
            value = getattr(self, name)
            if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
                raise FrameError(f"{type(self).__name__}.{name} is {value!r}, must be {kind.__name__}")
            if not low <= value <= high:
                raise FrameError(f"{type(self).__name__}.{name} is {value}, must be in {low}..{high}")


@dataclass(frozen=True)
class ControllerFault(Frame):
    """The controller has stopped. `detail` depends on the cause."""

    SENDER: ClassVar[Side] = Side.CONTROLLER

    code: FaultCode
    cause: StopCause
    detail: int = 0


@dataclass(frozen=True)
class RuntimeStop(Frame):
    """The runtime stops the controller."""

    SENDER: ClassVar[Side] = Side.RUNTIME

    code: StopCode
    cause: StopCause
    echo: int = ECHO_NONE


@dataclass(frozen=True)
class RuntimeHeartbeat(Frame):
    """What the runtime asks for, as a level. The link fills in echo and tag."""

    SENDER: ClassVar[Side] = Side.RUNTIME

    code: RuntimeCode
    epoch: int
    cause: StopCause = StopCause.NONE
    echo: int = ECHO_NONE
    tag: int = 0


@dataclass(frozen=True)
class ControllerHeartbeat(Frame):
    """The controller's state and inputs. The link fills in echo and tag."""

    SENDER: ClassVar[Side] = Side.CONTROLLER

    state: ControllerState
    epoch: int
    cause: StopCause
    device_pressed: bool
    emergency_stop_ok: bool
    cutting_mode: bool
    echo: int = ECHO_NONE
    tag: int = 0


@dataclass(frozen=True)
class Joints01(Frame):
    """Joints 0 and 1 in counts of 0.005 deg."""

    SENDER: ClassVar[Side] = Side.CONTROLLER

    q0: int
    q1: int


@dataclass(frozen=True)
class Joints23(Frame):
    """Joint 2 in counts of 0.01 mm, joint 3 in counts of 0.005 deg."""

    SENDER: ClassVar[Side] = Side.CONTROLLER

    q2: int
    q3: int


@dataclass(frozen=True)
class Joint4(Frame):
    """Joint 4 in counts of 0.005 deg. The link fills in the tag of the whole sample."""

    SENDER: ClassVar[Side] = Side.CONTROLLER

    q4: int
    tag: int = 0


@dataclass(frozen=True)
class Progress(Frame):
    """Place on the stored path; `fraction` in counts of 1/65535 of the segment."""

    SENDER: ClassVar[Side] = Side.CONTROLLER

    segment: int
    fraction: int

    @property
    def part(self) -> float:
        """Part of the segment done, 0..1."""
        return self.fraction / FRACTION_MAX


FRAMES: dict[int, type[Frame]] = {
    DATABASE.get_message_by_name(kind.__name__).frame_id: kind
    for kind in (
        ControllerFault,
        RuntimeStop,
        RuntimeHeartbeat,
        ControllerHeartbeat,
        Joints01,
        Joints23,
        Joint4,
        Progress,
    )
}
"""Every single frame by its identifier; any other identifier is not listed."""

IDS: dict[type[Frame], int] = {kind: can_id for can_id, kind in FRAMES.items()}
DATA_IDS: dict[int, int] = {
    message.frame_id: int(message.dbc.attributes["DataID"].value)
    for message in DATABASE.messages
    if message.dbc
}
SENT_BY: dict[Side, frozenset[int]] = {
    side: frozenset(
        [can_id for can_id, kind in FRAMES.items() if kind.SENDER is side] + list(TRANSFER_IDS[side].values())
    )
    for side in Side
}
"""All identifiers that only this side may send on."""


def message_of(kind: type[Frame]) -> Message:
    """The DBC's message of a frame."""
    return DATABASE.get_message_by_name(kind.__name__)


_FIELDS: dict[type[Frame], tuple[tuple[str, type[int], int, int], ...]] = {}


def _fields(kind: type[Frame]) -> tuple[tuple[str, type[int], int, int], ...]:
    """Names of a frame's fields, what they hold, and the least and the greatest that their bits carry."""
    if kind not in _FIELDS:
        _FIELDS[kind] = _listed(kind)
    return _FIELDS[kind]


def _listed(kind: type[Frame]) -> tuple[tuple[str, type[int], int, int], ...]:
    hints, message = get_type_hints(kind), message_of(kind)

    def bounds(name: str) -> tuple[int, int]:
        signal = message.get_signal_by_name(name)
        values = 1 << signal.length
        return (-values // 2, values // 2 - 1) if signal.is_signed else (0, values - 1)

    return tuple((field.name, hints[field.name], *bounds(field.name)) for field in fields(kind))


def payload_of(frame: Frame) -> bytes:
    """The five bytes that a frame says, before they are protected."""
    message = message_of(type(frame))
    signals: dict[str, Any] = {signal.name: 0 for signal in message.signals}
    signals |= {name: int(getattr(frame, name)) for name, *_ in _fields(type(frame))}
    # Not strict: every field was held against its bits when the frame was made, and no signal is missing.
    return bytes(message.encode(signals, scaling=False, strict=False)[3:])


def encode_frame(frame: Frame, counter: int, tag: int) -> tuple[int, bytes]:
    """Identifier and eight protected bytes of a frame, for this counter and session tag."""
    can_id = IDS[type(frame)]
    return can_id, protect(payload_of(frame), counter, DATA_IDS[can_id], tag)


def decode_frame(can_id: int, data: bytes) -> Frame:
    """The typed frame in eight bytes whose protection was checked before.

    Raises:
        FrameError: the identifier or a code is not listed, the length is wrong, or a reserved bit is set.
    """
    if can_id not in FRAMES:
        raise FrameError(f"identifier {can_id:#05x} is not listed")
    kind = FRAMES[can_id]
    message = message_of(kind)
    if len(data) != message.length:
        raise FrameError(f"{message.name} is {len(data)} bytes, must be {message.length}")
    signals: dict[str, Any] = message.decode(data, decode_choices=False, scaling=False)  # type: ignore[assignment]
    if signals.get("reserved", 0) != 0:
        raise FrameError(f"{message.name}.reserved is {signals['reserved']:#x}, must be 0")
    return kind(
        **{name: _typed(holds, signals[name], message.name, name) for name, holds, *_ in _fields(kind)}
    )


def _typed(holds: type[int], value: int, message: str, name: str) -> int:
    """A raw count as what the field holds."""
    try:
        return holds(value)
    except ValueError:
        raise FrameError(f"{message}.{name} is {value:#x}, which is no {holds.__name__}") from None


def joint_frames(joints: Sequence[float] | Floats) -> tuple[Joints01, Joints23, Joint4]:
    """One sample of measured joints, (rad, rad, mm, rad, rad), to the nearest count.

    Raises:
        FrameError: not five values, not finite, or beyond what the frames can carry, said in deg and mm.
    """
    values = [float(value) for value in joints]
    if len(values) != 5 or not all(math.isfinite(value) for value in values):
        raise FrameError(f"joints are {values}, must be five finite values")
    q0, q1, q2, q3, q4 = (_joint_count(joint, value) for joint, value in enumerate(values))
    return Joints01(q0, q1), Joints23(q2, q3), Joint4(q4)


def _joint_count(joint: int, value: float) -> int:
    """A joint to the nearest count. A person reads what is refused here, hence no counts in it."""
    scale, step, unit = (1.0, SLIDE_MM, "mm") if joint == 2 else (math.degrees(1.0), ROTATION_DEG, "deg")
    count = value * scale / step
    if not abs(count) <= JOINT_COUNT_MAX:
        raise FrameError(
            f"q{joint} is {value * scale:.3f} {unit}, a joints frame carries +-{JOINT_COUNT_MAX * step:.3f} {unit}"
        )
    return round(count)


def joint_values(first: Joints01, second: Joints23, third: Joint4) -> Floats:
    """The joints of one sample, (rad, rad, mm, rad, rad), shape (5,)."""
    counts = np.array([first.q0, first.q1, second.q2, second.q3, third.q4])
    joints = np.radians(counts * ROTATION_DEG)
    joints[2] = second.q2 * SLIDE_MM
    return joints


def codes() -> dict[tuple[int, str], type[IntEnum]]:
    """The enumeration of every coded signal, by identifier and signal: what the DBC's value tables must equal."""
    return {
        (can_id, name): holds
        for can_id, kind in FRAMES.items()
        for name, holds, *_ in _fields(kind)
        if issubclass(holds, IntEnum)
    }
