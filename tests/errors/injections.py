"""What can be done to a message on its way: one function for each thing that is injected."""

from collections.abc import Callable

import can

from cutgate.protocol import records
from cutgate.protocol.frames import (
    IDS,
    ControllerFault,
    ControllerHeartbeat,
    Frame,
    Joint4,
    Joints01,
    Joints23,
    Progress,
    RuntimeHeartbeat,
    RuntimeStop,
    encode_frame,
)
from cutgate.protocol.records import Channel
from tests.errors.scene import UNLISTED_ID, Scene, resealed, with_data
from tests.runtime.session.pair import CYCLE_S
from tests.runtime.session.wire import RUNTIME, flip

Inject = Callable[[Scene], None]

STRANGE_TAG = 0x5EED
"""Differs from the session's tag in these bits."""
NEIGHBOUR = {
    RuntimeHeartbeat: RuntimeStop,
    RuntimeStop: RuntimeHeartbeat,
    ControllerHeartbeat: Joints01,
    Joints01: Joints23,
    Joints23: Joint4,
    Joint4: Progress,
    Progress: Joints01,
    ControllerFault: Joints01,
}
"""Where a wrongly addressed frame arrives."""


# ---------------------------------------------------------------- single frames


def corrupt_frames(number: int) -> Inject:
    """One bit of so many frames, every second one."""

    def change(scene: Scene, count: int, message: can.Message) -> list[can.Message]:
        if count % 2 or count >= 2 * number:
            return [message]
        scene.mark()
        return flip(message)

    return lambda scene: scene.frames(change)


def repeat_frame(scene: Scene) -> None:
    def change(scene: Scene, count: int, message: can.Message) -> list[can.Message]:
        if count:
            return [message]
        scene.mark()
        return [message, message]

    scene.frames(change)


def stick(scene: Scene) -> None:
    """The wire repeats one frame for ever instead of the new ones."""
    first: list[can.Message] = []

    def change(scene: Scene, count: int, message: can.Message) -> list[can.Message]:
        if not first:
            first.append(message)
            scene.mark()
        return first

    scene.frames(change)


def swap_frames(scene: Scene) -> None:
    held: list[can.Message] = []

    def change(scene: Scene, count: int, message: can.Message) -> list[can.Message]:
        if count == 0:
            held.append(message)
            return []
        if count == 1:
            scene.mark()
            return [message, *held]
        return [message]

    scene.frames(change)


def lose_frames(number: int) -> Inject:
    def change(scene: Scene, count: int, message: can.Message) -> list[can.Message]:
        if count >= number:
            return [message]
        if count == 0:
            scene.mark()
        return []

    return lambda scene: scene.frames(change)


def delay_frames(first_s: float, *, growing_s: float = 0.0) -> Inject:
    """Every frame from now on comes later, each by so much more than the one before."""

    def change(scene: Scene, count: int, message: can.Message) -> list[can.Message]:
        if count == 0:
            scene.mark()
        scene.hold(message, first_s + count * growing_s)
        return []

    return lambda scene: scene.frames(change)


def _after_the_next(scene: Scene, act: Callable[[can.Message], None]) -> None:
    """Right behind the message's next frame."""

    def change(scene: Scene, count: int, message: can.Message) -> list[can.Message]:
        if count == 0:
            scene.later(CYCLE_S / 2, lambda: marked(message))
        return [message]

    def marked(message: can.Message) -> None:
        scene.mark()
        act(message)

    scene.frames(change)


def _tag(scene: Scene) -> int:
    return scene.sender.link.tag


def insert_from_outside(scene: Scene) -> None:
    """A frame of a node that has no session."""
    _after_the_next(
        scene,
        lambda message: scene.put(
            message.arbitration_id, resealed(message, 0, ahead=1, flip=1), everybody=False
        ),
    )


def insert_sound(scene: Scene) -> None:
    """A frame of this session under the next counter: what a faulty gateway makes up."""
    _after_the_next(
        scene,
        lambda message: scene.put(
            message.arbitration_id,
            resealed(message, _tag(scene), ahead=1, flip=_harmless(scene)),
            everybody=False,
        ),
    )


def _harmless(scene: Scene) -> int:
    """A bit of the first payload byte that leaves the frame's content listed."""
    return 0 if scene.message.kind in (RuntimeHeartbeat, ControllerHeartbeat) else 1


def masquerade_frames(number: int) -> Inject:
    """So many frames of somebody who does not know the session, at the receiver alone."""

    def inject(scene: Scene) -> None:
        def act(message: can.Message) -> None:
            for ahead in range(1, number + 1):
                data = resealed(message, _tag(scene) ^ STRANGE_TAG, ahead=ahead)
                scene.put(message.arbitration_id, data, everybody=False)

        _after_the_next(scene, act)

    return inject


def second_node_frame(scene: Scene) -> None:
    """Another node sends a sound frame as this side: everybody on the bus hears it."""
    _after_the_next(
        scene,
        lambda message: scene.put(
            message.arbitration_id, resealed(message, _tag(scene), ahead=1), everybody=True
        ),
    )


def misaddress_frames(number: int, can_id: int | None = None) -> Inject:
    """Copies of so many frames arrive on another identifier, of the same sender if none is given."""

    def change(scene: Scene, count: int, message: can.Message) -> list[can.Message]:
        if count >= number:
            return [message]
        scene.mark()
        kind = scene.message.kind
        target = IDS[NEIGHBOUR[kind]] if can_id is None else can_id
        return [message, with_data(message, bytes(message.data), target)]

    return lambda scene: scene.frames(change)


# ---------------------------------------------------------------- frames that are sent once


def once(*injects: Inject) -> Inject:
    """Inject into the one stop frame, or the one fault frame, of a scene; then cause it to be sent."""

    def inject(scene: Scene) -> None:
        for each in injects:
            each(scene)
        if scene.message.sender is RUNTIME:
            scene.pair.terminal.type("stop")
        else:
            scene.pair.controller_terminal.type("estop")

    return inject


def silence_behind(kind: type[Frame]) -> Inject:
    """From the message on, this kind of frame is lost as well."""

    def inject(scene: Scene) -> None:
        def rule(message: can.Message) -> list[can.Message]:
            silent = scene.began_s is not None and message.arbitration_id == IDS[kind]
            return [] if silent else [message]

        scene.pair.wire.rules.append(rule)

    return inject


def divert_frame(scene: Scene) -> None:
    """It arrives on a neighbour's identifier, and not on its own."""

    def change(scene: Scene, count: int, message: can.Message) -> list[can.Message]:
        if count == 0:
            scene.mark()
        return [with_data(message, bytes(message.data), IDS[NEIGHBOUR[scene.message.kind]])]

    scene.frames(change)


def insert_frame(frame: Frame) -> Inject:
    """A sound frame of this session that nobody sent, at the receiver alone."""

    def inject(scene: Scene) -> None:
        scene.mark()
        can_id, data = encode_frame(frame, 7, _tag(scene))
        scene.put(can_id, data, everybody=False)

    return inject


def put_zeros(*, everybody: bool) -> Inject:
    """Eight zeros on the message's identifier."""

    def inject(scene: Scene) -> None:
        scene.mark()
        scene.put(scene.message.can_id, bytes(8), everybody=everybody)

    return inject


def strange_frames(frame: Frame, number: int) -> Inject:
    """So many sound frames of another session, at the receiver alone."""

    def inject(scene: Scene) -> None:
        scene.mark()
        for counter in range(number):
            scene.put(*encode_frame(frame, counter, _tag(scene) ^ STRANGE_TAG), everybody=False)

    return inject


# ---------------------------------------------------------------- records


def corrupt_record(scene: Scene) -> None:
    """One bit of the first consecutive frame: the transfer is whole, its record is not."""
    scene.carriers(_only(0, _flip_inside))


def corrupt_every_record(scene: Scene) -> None:
    scene.carriers(_only(0, _flip_inside), most=10_000)


def _flip_inside(message: can.Message) -> list[can.Message]:
    data = bytearray(message.data)
    data[3] ^= 1
    return [with_data(message, bytes(data))]


def _only(which: int, change: Callable[[can.Message], list[can.Message]]) -> Callable:
    """Apply a change to one consecutive frame of each transfer, told by its sequence number."""

    def rule(message: can.Message) -> list[can.Message]:
        consecutive = message.data[0] >> 4 == 2 and message.data[0] & 0xF == which + 1
        return change(message) if consecutive else [message]

    return rule


def lose_carrier(scene: Scene) -> None:
    done: list[int] = []

    def change(message: can.Message) -> list[can.Message]:
        if done:
            return [message]
        done.append(1)
        return []

    scene.carriers(_only(0, change))


def swap_carriers(scene: Scene) -> None:
    """The first two consecutive frames change places."""
    held: list[can.Message] = []
    count = 0

    def change(message: can.Message) -> list[can.Message]:
        nonlocal count
        if message.data[0] >> 4 != 2:
            return [message]
        count += 1
        if count == 1:
            held.append(message)
            return []
        return [message, *held] if count == 2 else [message]

    scene.carriers(change)


def lose_record(scene: Scene) -> None:
    scene.records(lambda _payload, _send: None)


def lose_every_record(scene: Scene) -> None:
    scene.records(lambda _payload, _send: None, most=10_000)


def repeat_record(scene: Scene) -> None:
    def change(payload: bytes, send: Callable[[bytes], None]) -> None:
        send(payload)
        send(payload)

    scene.records(change)


def say_twice(scene: Scene) -> None:
    """The same content again under a sequence number of its own."""

    def change(payload: bytes, send: Callable[[bytes], None]) -> None:
        send(payload)
        send(_next(scene, payload, records.unpack(payload).session))

    scene.records(change)


def _next(scene: Scene, payload: bytes, session: int) -> bytes:
    channel = scene.message.kind.CHANNEL
    scene.sender._sent[channel] += 1
    return records.pack(records.unpack(payload).record, session, scene.sender._sent[channel])


def old_record(scene: Scene) -> None:
    """An older number of the same sender comes behind it: the record as it was, numbered 0."""

    def change(payload: bytes, send: Callable[[bytes], None]) -> None:
        envelope = records.unpack(payload)
        send(payload)
        send(records.pack(envelope.record, envelope.session, 0))

    scene.records(change)


def delay_record(seconds: float) -> Inject:
    """From this record on, whatever its sender puts on the channel comes so much later, in order."""

    def inject(scene: Scene) -> None:
        slow = False

        def change(payload: bytes, send: Callable[[bytes], None]) -> None:
            nonlocal slow
            slow = True
            send(payload)

        def delayed(scene: Scene, _count: int, message: can.Message) -> list[can.Message]:
            if not slow:
                return [message]
            scene.hold(message, seconds)
            return []

        scene.records(change)
        scene.frames(delayed)

    return inject


def record_of_another_session(scene: Scene) -> None:
    """A copy with another session's tag comes first."""

    def change(payload: bytes, send: Callable[[bytes], None]) -> None:
        envelope = records.unpack(payload)
        send(records.pack(envelope.record, envelope.session ^ STRANGE_TAG, envelope.sequence + 7))
        send(payload)

    scene.records(change)


def insert_while_cutting(scene: Scene) -> None:
    """A sound record that nobody sent, of this session and with the next number, while the arm cuts."""
    kept: list[bytes] = []

    def keep(payload: bytes, send: Callable[[bytes], None]) -> None:
        kept.append(payload)
        send(payload)

    scene.records(keep)
    scene.cutting()
    envelope = records.unpack(kept[0])
    scene.mark()
    transfer = scene.sender._transfers[scene.message.kind.CHANNEL]
    transfer.send(_next(scene, kept[0], envelope.session), scene.pair.clock())


def second_node_record(scene: Scene) -> None:
    """Another node begins such a record as this side, in its place: everybody on the bus hears it."""

    def change(payload: bytes, _send: Callable[[bytes], None]) -> None:
        first = bytes([0x10 | len(payload) >> 8, len(payload) & 0xFF]) + payload[:6]
        scene.put(scene.message.can_id, first, everybody=True)

    scene.records(change)


def misaddress_record(scene: Scene) -> None:
    """Its frames arrive once more on an identifier that nobody has."""
    scene.carriers(lambda message: [with_data(message, bytes(message.data), UNLISTED_ID), message])


def wrong_channel(scene: Scene) -> None:
    """It arrives on the other channel."""

    def change(payload: bytes, _send: Callable[[bytes], None]) -> None:
        (other,) = set(Channel) - {scene.message.kind.CHANNEL}
        scene.sender._transfers[other].send(payload, scene.pair.clock())

    scene.records(change)


def unsigned(scene: Scene) -> None:
    """Somebody without the key: the code is not of this key."""

    def change(payload: bytes, send: Callable[[bytes], None]) -> None:
        envelope = records.unpack(payload)
        forged = envelope.record.with_mac(bytes(16))
        send(records.pack(forged, envelope.session, envelope.sequence))

    scene.records(change)
