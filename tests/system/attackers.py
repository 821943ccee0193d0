"""Who has no key: one more node on the bus, and a node that stands between two halves of it.

Both read everything. What they say carries the right CRC and session tag, for these follow from the OPEN that anybody
can read; a code they can only repeat or guess.
"""

import select
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import can

from cutgate.config.bus import open_bus
from cutgate.firmware_sim import memory
from cutgate.firmware_sim.state import Memory
from cutgate.protocol import records
from cutgate.protocol.frames import CONTROL_IDS, Frame, RuntimeHeartbeat, encode_frame
from cutgate.protocol.records import Envelope, Side
from cutgate.protocol.states import Refusal
from cutgate.protocol.transfer import Transfer
from tests.fault_injection.middle import frames_of
from tests.fault_injection.tap import Tap, is_flow_control
from tests.system.harness import END_S, Child, HungError, Rig, decoded, is_kind

Way = Callable[[can.Message], list[can.Message]]
"""What becomes of a frame on its way: itself, others, or nothing."""
GO_ON = bytes.fromhex("302000cccccccccc")
"""Flow control: go on, in blocks of 32 frames."""
FIRST_FRAME = 0x1
ASKED_MAX = 10
WRONG_TAG = 0x5A5A
"""Fits once in 65 536; where it does, another one does not."""


def sealed(frame: Frame, counter: int, tag: int) -> can.Message:
    """A frame with a sound CRC for this session."""
    can_id, data = encode_frame(frame, counter % 256, tag)
    return raw(can_id, data)


def raw(can_id: int, data: bytes) -> can.Message:
    """Bytes as they are."""
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False)


def guessed(beat: Any) -> int:
    """A tag for a heartbeat that says something else than the one it was read with."""
    return WRONG_TAG if beat.tag != WRONG_TAG else WRONG_TAG + 1


class Stranger:
    """One more node on a rig's bus."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._bus = open_bus(rig.interface, rig.channel)

    @property
    def tag(self) -> int:
        """Of the session that was opened last."""
        return records.session_tag(records.session_digest(self.read(records.Open)[-1]))

    def read(self, kind: type[records.Record]) -> list[Any]:
        """Every record of a kind that has passed."""
        passed = self._rig.bus.records(CONTROL_IDS[kind.SENDER])
        return [envelope.record for envelope in passed if isinstance(envelope.record, kind)]

    def send(self, message: can.Message) -> None:
        """Send one frame."""
        self._bus.send(message)

    def say(self, record: records.Record, *, session: int = 0, sequence: int = 1) -> None:
        """Send a record, all its frames at once."""
        for data in frames_of(records.pack(record, session, sequence)):
            self.send(raw(CONTROL_IDS[record.SENDER], data))

    def ask(self, request: records.Record) -> Refusal:
        """Send a record between two announcements, and take the controller's answer in the runtime's place.

        An announcement that is due cuts an answer off that nobody has taken in time; then it is asked for again.
        """
        answers = len(self.read(records.Reply))
        with self._taking():
            for sequence in range(1, ASKED_MAX + 1):
                self._whole_announcements(1)
                self.say(request, sequence=sequence)
                self._whole_announcements(2, or_answers=answers)
                for answer in self.read(records.Reply)[answers:]:
                    assert answer.request_type == request.TYPE
                    return Refusal(answer.refusal)
        raise HungError("the controller gives no answer")

    def announcement(self) -> records.Announce:
        """The next one, taken in the runtime's place."""
        with self._taking():
            self._whole_announcements(1)
        announced: records.Announce = self.read(records.Announce)[-1]
        return announced

    @contextmanager
    def _taking(self) -> Iterator[None]:
        self._rig.bus.at_once = self._take
        try:
            yield
        finally:
            self._rig.bus.at_once = lambda _message: None

    def _whole_announcements(self, number: int, or_answers: int | None = None) -> None:
        """Wait for so many more, or for an answer."""
        before = len(self.read(records.Announce))
        self._rig.until(
            lambda: (
                len(self.read(records.Announce)) >= before + number
                or (or_answers is not None and len(self.read(records.Reply)) > or_answers)
            )
        )

    def _take(self, message: can.Message) -> None:
        """Let go on whatever the controller begins to send."""
        if message.arbitration_id == CONTROL_IDS[Side.CONTROLLER] and message.data[0] >> 4 == FIRST_FRAME:
            self.send(raw(CONTROL_IDS[Side.RUNTIME], GO_ON))

    def close(self) -> None:
        """Leave the bus."""
        self._bus.shutdown()


class Middle:
    """The only way from a bus with the runtime to a bus with the controller, and back.

    Attributes:
        controller, runtime: the two buses; every process is the first one's.
        down, up: what becomes of frames toward the controller and toward the runtime.
        rewrite: where given, takes each of the runtime's control records whole; what it returns is sent instead. To be
            set while none is under way.
        genuine: the runtime's last heartbeat that passed as it was.
    """

    def __init__(self, controller: Rig, runtime: Rig) -> None:
        self.controller, self.runtime = controller, runtime
        self.down: Way = _passes
        self.up: Way = _passes
        self.rewrite: Callable[[Envelope], list[records.Record]] | None = None
        self.genuine: can.Message | None = None
        self._tap = Tap()
        self._receiver = Transfer(CONTROL_IDS[Side.CONTROLLER], CONTROL_IDS[Side.RUNTIME])
        self._to_controller = open_bus(controller.interface, controller.channel)
        self._to_runtime = open_bus(runtime.interface, runtime.channel)
        self._failure: BaseException | None = None
        self._ended = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def tag(self) -> int:
        """Of the session that was opened last."""
        return self._tap.tag

    @property
    def there(self) -> dict[str, Any]:
        """Options that put a runtime on its side."""
        return {"more": ["--channel", self.runtime.channel]}

    def run(self, **how: Any) -> Child:
        """A runtime on its side."""
        return self.controller.run(**self.there, **how)

    def say_down(self, *messages: can.Message) -> None:
        """Say something to the controller alone."""
        for message in messages:
            self._to_controller.send(message)

    def hand_down(self, envelope: Envelope) -> None:
        """Let the controller have a record of the runtime's, to the bit."""
        whole = records.pack(envelope.record, envelope.session, envelope.sequence)
        self.say_down(*(raw(CONTROL_IDS[Side.RUNTIME], data) for data in frames_of(whole)))

    def say_up(self, *messages: can.Message) -> None:
        """Say something to the runtime alone."""
        for message in messages:
            self._to_runtime.send(message)

    def close(self) -> None:
        """Let go of both; what has failed meanwhile fails here."""
        self._ended = True
        self._thread.join(END_S)
        self._to_controller.shutdown()
        self._to_runtime.shutdown()
        if self._failure is not None:
            raise self._failure

    def _run(self) -> None:
        poll = select.poll()
        poll.register(self._to_controller, select.POLLIN)
        poll.register(self._to_runtime, select.POLLIN)
        try:
            while not self._ended:
                poll.poll(100.0)
                self._relay(self._to_runtime, self._downward)
                self._relay(self._to_controller, self._upward)
        except can.CanOperationError:
            return  # a test that ends the bus
        except BaseException as error:  # noqa: BLE001 - told by close()
            self._failure = error

    @staticmethod
    def _relay(bus: can.BusABC, act: Callable[[can.Message], None]) -> None:
        """Everything that waits on one side."""
        while (message := bus.recv(timeout=0.0)) is not None:
            act(message)

    def _downward(self, message: can.Message) -> None:
        self._tap.hear(message)
        if self.rewrite is not None and self._is_record_of(Side.RUNTIME, message):
            self._rewritten(message, self.rewrite)
            return
        passed = self.down(message)
        if message in passed and is_kind(message, RuntimeHeartbeat):
            self.genuine = message
        self.say_down(*passed)

    def _upward(self, message: can.Message) -> None:
        self._tap.hear(message)
        receives_himself = self.rewrite is not None and message.arbitration_id == CONTROL_IDS[Side.CONTROLLER]
        if not (receives_himself and is_flow_control(message)):
            self.say_up(*self.up(message))

    @staticmethod
    def _is_record_of(side: Side, message: can.Message) -> bool:
        return message.arbitration_id == CONTROL_IDS[side] and not is_flow_control(message)

    def _rewritten(self, message: can.Message, rewrite: Callable[[Envelope], list[records.Record]]) -> None:
        self._receiver.feed(bytes(message.data))
        self.say_up(*(raw(can_id, data) for can_id, data in self._receiver.outgoing()))
        for payload in self._receiver.received():
            envelope = records.unpack(payload)
            for record in rewrite(envelope):
                self.hand_down(replace(envelope, type=record.TYPE, record=record))


def _passes(message: can.Message) -> list[can.Message]:
    return [message]


def saying(message: can.Message, tag: int, **changes: Any) -> can.Message:
    """A frame that says something else under the counter, and if it is a heartbeat the tag, of the one that was read."""
    return sealed(replace(decoded(message), **changes), message.data[2], tag)


def remembered(rig: Rig) -> Memory:
    """What the controller would know after a loss of power."""
    return memory.load(memory.beside(rig.folder / "site.key"), 0)


def withdrawn_anywhere(rig: Rig) -> bool:
    """Whether either side has withdrawn a registration, or has it to do."""
    kept = remembered(rig)
    told = [e for e in rig.bus.records(CONTROL_IDS[Side.RUNTIME]) if isinstance(e.record, records.Withdraw)]
    listed = list((rig.folder / "logs").glob("WITHDRAWN"))
    return bool(kept.withdrawn or kept.earlier or kept.barrier_us or kept.withdrawal_due or told or listed)
