"""A man in the middle: every frame passes through his hands, he reads everything, and he has not got the key.

He holds frames back, drops, repeats and reorders them, rewrites what they say and makes the CRC anew with the session's
tag, which follows from the OPEN that he read; and he makes up whatever carries no code, or carries a wrong one.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import can

from cutgate.protocol import records
from cutgate.protocol.e2e import COUNTER_MODULUS, protect
from cutgate.protocol.frames import (
    CONTROL_IDS,
    DATA_IDS,
    ECHO_NONE,
    FRAMES,
    IDS,
    JOINT_COUNT_MAX,
    ControllerFault,
    ControllerHeartbeat,
    Frame,
    FrameError,
    Joint4,
    Joints01,
    Joints23,
    Progress,
    RuntimeHeartbeat,
    RuntimeStop,
    decode_frame,
    payload_of,
)
from cutgate.protocol.records import NO_MAC, Channel, RecordError, Side
from cutgate.protocol.states import (
    EPOCHS,
    WITHDRAWING,
    ControllerState,
    FaultCode,
    Purpose,
    Refusal,
    RuntimeCode,
    StopCause,
    StopCode,
)
from cutgate.protocol.transfer import Transfer
from tests.fault_injection import injection as chance
from tests.fault_injection.injection import LATE_S, Act, Injection, with_data
from tests.fault_injection.tap import SENDER, is_flow_control

HELD_S = 0.5
"""The longest that he holds a frame back: several time-outs."""
CARRIES_S = 0.4
"""So long he says CUT in the runtime's place."""
BEATS: dict[Side, type[Frame]] = {Side.RUNTIME: RuntimeHeartbeat, Side.CONTROLLER: ControllerHeartbeat}


# ---------------------------------------------------------------- single frames


def _sealed(injection: Injection, frame: Frame, counter: int) -> can.Message:
    """A frame with a sound CRC."""
    can_id = IDS[type(frame)]
    data = protect(payload_of(frame), counter % COUNTER_MODULUS, DATA_IDS[can_id], injection.tap.tag)
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False)


def _read(can_id: int, data: bytes) -> Any:
    """What a frame says; None where it is none."""
    try:
        return decode_frame(can_id, data) if can_id in FRAMES else None
    except FrameError:
        return None


def _rewriting(change: Callable[[Injection, Any], Frame | None]) -> chance.FrameAttack:
    """He lets a frame say something else."""

    def rewrite(injection: Injection, message: can.Message) -> list[can.Message] | None:
        frame = _read(message.arbitration_id, bytes(message.data))
        other = None if frame is None else change(injection, frame)
        return None if other is None else [_sealed(injection, other, message.data[2])]

    return rewrite


def _any_bits(injection: Injection, message: can.Message) -> list[can.Message] | None:
    """Any bits of the payload, under a sound CRC."""
    can_id = message.arbitration_id
    if can_id not in FRAMES or len(message.data) != 8:
        return None
    payload = bytearray(message.data[3:])
    payload[injection.draw.randrange(len(payload))] ^= injection.draw.randint(1, 255)
    data = protect(bytes(payload), message.data[2], DATA_IDS[can_id], injection.tap.tag)
    return [with_data(message, data)]


def _cut(injection: Injection, frame: Any) -> Frame | None:
    match frame:
        case RuntimeHeartbeat():
            return replace(frame, code=RuntimeCode.CUT, cause=StopCause.NONE)
    return None


def _other_code(injection: Injection, frame: Any) -> Frame | None:
    draw = injection.draw
    match frame:
        case RuntimeHeartbeat():
            cause = draw.choice([StopCause.NONE, *WITHDRAWING])
            return replace(frame, code=draw.choice([*RuntimeCode]), cause=cause)
        case ControllerHeartbeat():
            cause = draw.choice([StopCause.NONE, *WITHDRAWING])
            return replace(frame, state=draw.choice([*ControllerState]), cause=cause)
    return None


def _other_inputs(_injection: Injection, frame: Any) -> Frame | None:
    match frame:
        case ControllerHeartbeat():
            return replace(frame, device_pressed=True, emergency_stop_ok=True, cause=StopCause.NONE)
    return None


def _younger(injection: Injection, frame: Any) -> Frame | None:
    """An old heartbeat that echoes the peer's last one."""
    match frame:
        case RuntimeHeartbeat() | ControllerHeartbeat():
            return replace(frame, echo=_last_counter(injection, frame.SENDER.peer, ECHO_NONE))
    return None


def _elsewhere(injection: Injection, frame: Any) -> Frame | None:
    count = injection.draw.randint(-JOINT_COUNT_MAX, JOINT_COUNT_MAX)
    match frame:
        case Joints01():
            return replace(frame, q0=count)
        case Joints23():
            return replace(frame, q2=count)
        case Joint4():
            return replace(frame, q4=count)
        case Progress():
            return replace(frame, segment=abs(count) % 1000)
    return None


def _softer(injection: Injection, frame: Any) -> Frame | None:
    """A stop becomes an end, or withdraws."""
    cause = injection.draw.choice([StopCause.SESSION_ENDED, *WITHDRAWING])
    match frame:
        case RuntimeStop():
            return replace(frame, code=injection.draw.choice([*StopCode]), cause=cause)
        case ControllerFault():
            return replace(frame, code=FaultCode.STOPPED, cause=cause)
    return None


def _held(injection: Injection, message: can.Message) -> list[can.Message]:
    injection.hold(message, HELD_S)
    return []


def _swapped(injection: Injection, message: can.Message) -> list[can.Message]:
    """It arrives behind the next one of its kind."""

    def behind(following: can.Message) -> list[can.Message] | None:
        if following.arbitration_id != message.arbitration_id:
            return None
        injection.relays.remove(behind)
        return [following, message]

    injection.relays.append(behind)
    return []


FRAME_ATTACKS: dict[str, chance.FrameAttack] = {
    "he holds it back": _held,
    "he lets the next one pass first": _swapped,
    "he drops it": lambda _injection, _message: [],
    "he repeats it": lambda _injection, message: [message, message],
    "he says an earlier one again": chance.said_again,
    "he rewrites any bits": _any_bits,
    "he rewrites it to CUT": _rewriting(_cut),
    "he rewrites a heartbeat": _rewriting(_other_code),
    "he rewrites the inputs": _rewriting(_other_inputs),
    "he rewrites the echo": _rewriting(_younger),
    "he rewrites joints or progress": _rewriting(_elsewhere),
    "he rewrites a stop or fault": _rewriting(_softer),
}
"""What he does to a frame on its way; each with a sound CRC."""


# ---------------------------------------------------------------- frames of his own


def _last_counter(injection: Injection, side: Side, otherwise: int) -> int:
    data = injection.tap.frames.get(IDS[BEATS[side]])
    return otherwise if data is None or len(data) < 3 else data[2]


def _beat(injection: Injection, side: Side) -> Any:
    """The side's last heartbeat; None before the first."""
    can_id = IDS[BEATS[side]]
    return _read(can_id, injection.tap.frames.get(can_id, b"\0" * 8))


def _arrives(injection: Injection, message: can.Message) -> None:
    side = SENDER[message.arbitration_id]
    injection.pair.wire.nodes[side.peer].put(message.arbitration_id, bytes(message.data))


def _says(injection: Injection, frame: Frame) -> None:
    """A frame of his own, under the counter that comes next."""
    data = injection.tap.frames.get(IDS[type(frame)])
    counter = 0 if data is None or len(data) < 3 else data[2] + 1
    message = _sealed(injection, frame, counter)
    injection.tap.frames[message.arbitration_id] = bytes(message.data)
    _arrives(injection, message)


def _makes_up_cut(injection: Injection) -> None:
    last = _beat(injection, Side.CONTROLLER)
    _says(
        injection,
        RuntimeHeartbeat(
            RuntimeCode.CUT,
            epoch=0 if last is None else last.epoch,
            echo=_last_counter(injection, Side.CONTROLLER, ECHO_NONE),
            tag=injection.draw.randrange(1 << 16),
        ),
    )


def _makes_up_runtime(injection: Injection) -> None:
    draw = injection.draw
    _says(
        injection,
        RuntimeHeartbeat(
            draw.choice([*RuntimeCode]),
            epoch=draw.randrange(EPOCHS),
            cause=draw.choice([StopCause.NONE, *WITHDRAWING]),
            echo=_last_counter(injection, Side.CONTROLLER, ECHO_NONE),
            tag=draw.randrange(1 << 16),
        ),
    )


def _makes_up_controller(injection: Injection) -> None:
    draw, last = injection.draw, _beat(injection, Side.CONTROLLER)
    _says(
        injection,
        ControllerHeartbeat(
            state=draw.choice([*ControllerState]),
            epoch=0 if last is None else last.epoch,
            cause=draw.choice([StopCause.NONE, StopCause.NONE, *WITHDRAWING]),
            device_pressed=bool(draw.getrandbits(1)),
            emergency_stop_ok=True,
            cutting_mode=bool(draw.getrandbits(1)),
            echo=_last_counter(injection, Side.RUNTIME, ECHO_NONE),
            tag=draw.randrange(1 << 16),
        ),
    )


def _makes_up_joints(injection: Injection) -> None:
    """A whole sample where the arm is not, under the last heartbeat's counter or the next one's."""
    draw, counter = injection.draw, _last_counter(injection, Side.CONTROLLER, 0)
    counter += draw.randint(0, 1)
    q = [draw.randint(-10_000, 10_000) for _ in range(5)]
    for frame in (Joints01(q[0], q[1]), Joints23(q[2], q[3]), Joint4(q[4], draw.randrange(1 << 20))):
        _arrives(injection, _sealed(injection, frame, counter))


def _stops(code: StopCode) -> Act:
    def act(injection: Injection) -> None:
        cause = injection.draw.choice([StopCause.SESSION_ENDED, *WITHDRAWING])
        _says(injection, RuntimeStop(code, cause))

    return act


def _reports_fault(injection: Injection) -> None:
    code = injection.draw.choice([*FaultCode])
    _says(injection, ControllerFault(code, injection.draw.choice([*WITHDRAWING])))


# ---------------------------------------------------------------- records of his own


def frames_of(payload: bytes) -> list[bytes]:
    """A record in frames of a transfer, as ISO 15765-2 says."""
    if len(payload) <= 7:
        return [bytes([len(payload)]) + payload.ljust(7, b"\xcc")]
    first = bytes([0x10 | len(payload) >> 8, len(payload) & 0xFF]) + payload[:6]
    rest = [payload[at : at + 7] for at in range(6, len(payload), 7)]
    return [
        first,
        *(bytes([0x20 | n & 0xF]) + part.ljust(7, b"\xcc") for n, part in enumerate(rest, start=1)),
    ]


def _inserts(injection: Injection, record: records.Record, *, tag: int | None = None) -> None:
    """A record of his own, all its frames at once, under the sequence that comes next."""
    tap, side = injection.tap, record.SENDER
    outside = record.OUTSIDE_SESSION and not record.INSIDE_SESSION
    named = tag if tag is not None else 0 if outside else tap.tag
    if named == 0 and not record.OUTSIDE_SESSION:
        return
    payload = records.pack(record, named, tap.sequences[side] + injection.draw.randint(1, 3))
    for data in frames_of(payload):
        injection.pair.wire.nodes[side.peer].put(CONTROL_IDS[side], data)


def _wrong_code(injection: Injection) -> bytes:
    return injection.draw.choice([NO_MAC, injection.draw.randbytes(len(NO_MAC))])


def _says_again(kind: type[records.SignedRecord], *, changed: bool = True) -> Act:
    """The last one of a kind under the next sequence, as it was or with other bits, and its code or a wrong one."""

    def act(injection: Injection) -> None:
        last = injection.tap.last.get(kind)
        if last is None:
            return
        record: Any = last.record
        if changed and injection.draw.getrandbits(1):
            record = _altered(injection, record)
        if injection.draw.getrandbits(1):
            record = record.with_mac(_wrong_code(injection))
        _inserts(injection, record)

    return act


def _accepts(injection: Injection) -> None:
    """As if the controller had accepted the last request of a kind."""
    kinds = (records.Permit, records.Start, records.Reset, records.Acknowledge, records.Withdraw)
    kind = injection.draw.choice(kinds)
    last = injection.tap.last.get(kind)
    sequence = injection.tap.sequences[Side.RUNTIME] + 1 if last is None else last.sequence
    _inserts(injection, records.Reply(kind.TYPE, sequence, Refusal.ACCEPTED, StopCause.NONE, 0))


def _refuses(injection: Injection) -> None:
    kind = injection.draw.choice([records.Open, records.Permit, records.Start, records.Withdraw])
    refusal = injection.draw.choice([*Refusal])
    sequence = injection.tap.sequences[Side.RUNTIME]
    _inserts(injection, records.Reply(kind.TYPE, sequence, refusal, StopCause.NONE, 0))


def _gives_nonce(injection: Injection) -> None:
    last = _beat(injection, Side.CONTROLLER)
    nonce = injection.draw.randbytes(16)
    epoch = 0 if last is None else last.epoch
    _inserts(injection, records.Nonce(injection.draw.choice([*Purpose]), nonce, epoch))


def _asks_for_nonce(injection: Injection) -> None:
    _inserts(injection, records.NonceRequest(injection.draw.choice([*Purpose])))


def _announces(injection: Injection) -> None:
    """Another controller, or this one as it is not."""
    last = injection.tap.last.get(records.Announce)
    if last is None:
        return
    announce: Any = last.record
    changes: dict[str, Any] = injection.draw.choice(
        [
            {"plant_speed_permille": injection.draw.choice([1000, 2000, 100_000])},
            {"serial": "SIM-2"},
            {"announce_nonce": injection.draw.randbytes(16)},
            {},
        ]
    )
    _inserts(injection, replace(announce, **changes))


def _rewritten_open(injection: Injection, request: records.Open) -> records.Open:
    """For slower heartbeats, a longer time-out, wider tolerances, another registration or place or time."""
    timing = replace(
        request.timing,
        timeout_ms=injection.draw.choice([100, 200, 250, 1000]),
        start_tolerance_um=injection.draw.choice([500, 5000]),
        start_lifetime_ms=injection.draw.choice([5000, 60_000]),
    )
    named: dict[str, Any] = injection.draw.choice(
        [
            {},
            {"registration_digest": injection.draw.randbytes(32)},
            {"place_digest": injection.draw.randbytes(32)},
            {"registration_time_us": 1 << 60},
        ]
    )
    return replace(request, timing=timing, **named)


def _opens_otherwise(injection: Injection) -> None:
    """The last OPEN for other timing, under the nonce that was announced last."""
    if not injection.tap.opens:
        return
    request: Any = injection.tap.opens[-1].record
    announced: Any = injection.tap.last.get(records.Announce)
    nonce = request.announce_nonce if announced is None else announced.record.announce_nonce
    _inserts(injection, replace(_rewritten_open(injection, request), announce_nonce=nonce))


def _opens_again(injection: Injection) -> None:
    """Any OPEN there ever was, to the bit."""
    if injection.tap.opens:
        _inserts(injection, injection.draw.choice(injection.tap.opens).record)


def _makes_up_opened(injection: Injection) -> None:
    code, due = _wrong_code(injection), injection.draw.randint(0, 1)
    state = injection.draw.choice([ControllerState.OPEN, ControllerState.FAULT])
    _inserts(injection, records.Opened(0, state, StopCause.NONE, withdrawal_due=due, mac=code))


def _acknowledges(injection: Injection) -> None:
    last = _beat(injection, Side.CONTROLLER)
    if last is not None:
        code = _wrong_code(injection)
        _inserts(injection, records.Acknowledge(last.epoch, last.cause, mac=code))


def _withdraws(injection: Injection) -> None:
    last = injection.tap.opens[-1].record if injection.tap.opens else None
    places = [records.NO_PLACE, *([last.place_digest] if isinstance(last, records.Open) else [])]
    barrier_us = injection.draw.choice([1, 1 << 60])
    record = records.Withdraw(injection.draw.choice(places), barrier_us, mac=_wrong_code(injection))
    _inserts(injection, record)


# ---------------------------------------------------------------- records on their way


def _altered(injection: Injection, record: records.Record) -> Any:
    """The record with other bits somewhere, if it can be one."""
    if isinstance(record, records.Open) and injection.draw.getrandbits(1):
        return _rewritten_open(injection, record)
    for _ in range(5):
        body = bytearray(record.body())
        if not body:
            break
        body[injection.draw.randrange(len(body))] ^= 1 << injection.draw.randrange(8)
        try:
            return type(record).parse(bytes(body))
        except RecordError:
            continue
    return record


@dataclass
class Relay:
    """He takes the next record of a side himself, flow control and all, and passes another one on.

    ``change`` gives the other one; None lets that record pass, and the next one is waited for.
    """

    injection: Injection
    side: Side
    change: Callable[[Injection, records.Record], Any | None]
    begun: bool = False
    passing: bool = False
    changed: bool = False

    def __post_init__(self) -> None:
        ours, theirs = CONTROL_IDS[self.side], CONTROL_IDS[self.side.peer]
        self.takes, self.gives = Transfer(theirs, ours), Transfer(ours, theirs)

    def __call__(self, message: can.Message) -> list[can.Message] | None:
        if message.arbitration_id == CONTROL_IDS[self.side] and not is_flow_control(message):
            return self._takes(message)
        if (
            message.arbitration_id == CONTROL_IDS[self.side.peer]
            and is_flow_control(message)
            and self.passing
        ):
            self.gives.feed(bytes(message.data))
            self._to(self.side.peer, self.gives)
            return []
        return None

    def _takes(self, message: can.Message) -> list[can.Message] | None:
        if not self.begun and message.data[0] >> 4 > 1:  # in the middle of another one
            return None
        if self.passing:
            return None
        self.begun = True
        self.takes.feed(bytes(message.data))
        self._to(self.side, self.takes)
        for payload in self.takes.received():
            self.passing = True
            self.gives.send(self._other(payload), self.injection.pair.clock())
            self._to(self.side.peer, self.gives)
        return []

    def _to(self, side: Side, transfer: Transfer) -> None:
        for can_id, data in transfer.outgoing():
            self.injection.pair.wire.nodes[side].put(can_id, data)
        if self.passing and not self.gives.sending:
            self.begun = self.passing = False
            if self.changed and self in self.injection.relays:
                self.injection.relays.remove(self)

    def _other(self, payload: bytes) -> bytes:
        try:
            envelope = records.unpack(payload, sender=self.side, channel=Channel.CONTROL)
        except RecordError:
            return payload
        other = self.change(self.injection, envelope.record)
        if other is None:
            return payload
        self.changed = True
        self.injection.note(f"{type(other).__name__} rewritten")
        return records.pack(other, envelope.session, envelope.sequence)


def _other_mac(injection: Injection, record: records.Record) -> Any | None:
    """The same under a wrong code, where it carries one; OPEN passes, for something to be signed in its session."""
    if isinstance(record, records.SignedRecord) and not isinstance(record, records.Open):
        return record.with_mac(_wrong_code(injection))
    return None


def _relays(side: Side, change: Callable[[Injection, records.Record], Any | None] = _altered) -> Act:
    def act(injection: Injection) -> None:
        if not any(isinstance(relay, Relay) and relay.side is side for relay in injection.relays):
            injection.relays.append(Relay(injection, side, change))

    return act


# ---------------------------------------------------------------- everything of one side


def _delays(side: Side) -> Act:
    """Everything of one side is late by the same, for a while: by less than the time-out, or by more."""

    def act(injection: Injection) -> None:
        wire, draw = injection.pair.wire, injection.draw
        late_s = draw.uniform(0.02, 0.07) if draw.getrandbits(1) else draw.uniform(0.0, LATE_S)
        ids = [can_id for can_id, sender in SENDER.items() if sender is side]
        injection.for_a_while(lambda: wire.delay_s.update(dict.fromkeys(ids, late_s)), wire.delay_s.clear)

    return act


def _keeps(side: Side) -> Act:
    """Nothing of one side passes for a while; then all of it at once, in its order."""

    def act(injection: Injection) -> None:
        kept: list[can.Message] = []

        def keep(message: can.Message) -> list[can.Message] | None:
            if SENDER[message.arbitration_id] is not side:
                return None
            kept.append(message)
            return []

        def let_go() -> None:
            if keep in injection.relays:
                injection.relays.remove(keep)
            for message in kept:
                _arrives(injection, message)

        injection.for_a_while(lambda: injection.relays.append(keep), let_go)

    return act


def _goes_on_cutting(injection: Injection) -> None:
    """He takes the runtime's place: nothing of it passes, and in time with its heartbeats he says CUT."""
    pair, timing = injection.pair, injection.pair.job.timing

    def silent(message: can.Message) -> list[can.Message] | None:
        return [] if SENDER[message.arbitration_id] is Side.RUNTIME else None

    injection.relays.append(silent)
    beats = range(1, round(CARRIES_S / timing.heartbeat_s))
    injection.later += [
        (pair.clock() + beat * timing.heartbeat_s, lambda: _makes_up_cut(injection)) for beat in beats
    ]
    injection.later.append(
        (pair.clock() + CARRIES_S, lambda: silent in injection.relays and injection.relays.remove(silent))
    )


ATTACKS: dict[str, Act] = {
    "he makes up a CUT": _makes_up_cut,
    "he takes the runtime's place and says CUT": _goes_on_cutting,
    "he makes up a heartbeat of the runtime": _makes_up_runtime,
    "he makes up a heartbeat of the controller": _makes_up_controller,
    "he makes up a joint sample": _makes_up_joints,
    "he stops": _stops(StopCode.STOP),
    "he ends the session": _stops(StopCode.END),
    "he reports a fault": _reports_fault,
    "he accepts": _accepts,
    "he refuses": _refuses,
    "he gives a nonce": _gives_nonce,
    "he asks for a nonce": _asks_for_nonce,
    "he announces another controller": _announces,
    "he opens for another timing": _opens_otherwise,
    "he says an OPEN again": _opens_again,
    "he makes up an OPENED": _makes_up_opened,
    "he permits": _says_again(records.Permit),
    "he starts": _says_again(records.Start),
    "he resets": _says_again(records.Reset),
    "he acknowledges": _acknowledges,
    "he says an acknowledgement again": _says_again(records.Acknowledge),
    "he withdraws": _withdraws,
    "he says a withdrawal again": _says_again(records.Withdraw),
    "he rewrites a record of the runtime": _relays(Side.RUNTIME),
    "he rewrites a record of the controller": _relays(Side.CONTROLLER),
    "he rewrites a code of the runtime": _relays(Side.RUNTIME, _other_mac),
    "he rewrites a code of the controller": _relays(Side.CONTROLLER, _other_mac),
    "he delays the runtime": _delays(Side.RUNTIME),
    "he delays the controller": _delays(Side.CONTROLLER),
    "he keeps the runtime's frames": _keeps(Side.RUNTIME),
    "he keeps the controller's frames": _keeps(Side.CONTROLLER),
}
"""What he does of his own."""
