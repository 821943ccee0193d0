"""Injection points: one message of the pair, damaged on its way, and what became of both sides.

A single frame is met on the wire. A record is met twice: where its sender hands it to the transfer (``records``),
and where the frames that carry it pass (``carriers``). Nothing here decides whether an outcome is right.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import can

from cutgate.protocol import records
from cutgate.protocol.e2e import protect
from cutgate.protocol.endpoint import Endpoint, RecordReceived
from cutgate.protocol.frames import DATA_IDS, IDS, TRANSFER_IDS, Frame
from cutgate.protocol.link import Accepted, Discarded, Violation
from cutgate.protocol.records import Record, Side
from cutgate.protocol.states import ControllerState, RuntimeCode, StopCause
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.interlock.phases import ENDED, PHASES
from cutgate.runtime.interlock.state import Phase
from tests.runtime.session.pair import Pair
from tests.runtime.session.wire import Rule

UNLISTED_ID = 0x123
PATIENCE_S = 8.0
"""More than the longest deadline of a scene."""
WATCHED_S = 0.2
"""How long an outcome must last."""
YEAR_S = 365 * 86_400.0
SLOW = 0.05
"""Time scale at which the cut lasts longer than any scene."""
SHORT = {"transfer_timeout_s": 3.0, "announce_wait_s": 3.0, "operator_wait_s": 3.0}
"""Waiting times of a scene, s, each within its bounds; everything else is the default."""


@dataclass(frozen=True)
class Message:
    """One message of the conversation: a single frame, or a record (told from others of its type by ``which``)."""

    name: str
    kind: type[Frame] | type[Record]
    which: Callable[[Any], bool] = lambda _record: True

    @property
    def sender(self) -> Side:
        return self.kind.SENDER

    @property
    def is_frame(self) -> bool:
        return issubclass(self.kind, Frame)

    @property
    def can_id(self) -> int:
        """What its frames travel on."""
        return IDS[self.kind] if self.is_frame else TRANSFER_IDS[self.sender][self.kind.CHANNEL]


@dataclass(frozen=True)
class Observed:
    """What became of a scene.

    Attributes:
        goes_on: the arm was cutting ``WATCHED_S`` after the injection.
        phase, state: how runtime and controller ended, before anybody ended a scene that went on.
        causes: first-out cause of runtime and controller at that moment.
        latency_s: from the injection until neither side enables anything any more; None if the cut went on.
        stands: the arm did not move once both sides had stopped, or never.
        evidence: everything either side said about what it did not take.
        log, logged: the verifier's word on the log, and the first-out causes that it names.
    """

    goes_on: bool
    phase: Phase
    state: ControllerState
    causes: tuple[StopCause, StopCause]
    latency_s: float | None
    stands: bool
    evidence: str
    log: Status
    logged: frozenset[str]


class Scene:
    """A pair with one message that something happens to."""

    def __init__(self, pair: Pair, message: Message) -> None:
        self.pair, self.message = pair, message
        pair.power_up(time_scale=SLOW)
        pair.begin(replace(pair.job, deadlines=replace(pair.job.deadlines, **SHORT)))
        self.began_s: float | None = None
        self.stopped_s: float | None = None
        self.due: list[tuple[float, Callable[[], None]]] = []
        self.heard: list[str] = []
        self.words: list[str] = []
        self.stood = pair.process.arm.state.joints
        for side in Side:
            self._overhear(self.endpoint(side))

    # ------------------------------------------------------------ who is who

    def endpoint(self, side: Side) -> Endpoint:
        port = self.pair.session._port if side is Side.RUNTIME else self.pair.process.port
        return port.endpoint

    @property
    def sender(self) -> Endpoint:
        return self.endpoint(self.message.sender)

    @property
    def receiver(self) -> Endpoint:
        return self.endpoint(self.message.sender.peer)

    def _overhear(self, endpoint: Endpoint) -> None:
        """Keep what this side says about frames and records that it does not take."""
        receive = endpoint.receive

        def listening(*args: Any, **options: Any) -> list[Any]:
            items = receive(*args, **options)
            for item in items:
                match item:
                    case Discarded():
                        self.heard.append(item.reason)
                    case Violation():
                        self.heard.append(item.detail)
                    case Accepted(lost=lost, fresh=fresh) if lost or not fresh:
                        self.heard.append(f"{lost} lost, {'fresh' if fresh else 'stale'}")
                    case RecordReceived(record=records.Reply() as reply):
                        self.heard.append(f"reply {reply.refusal.name}")
            return items

        endpoint.receive = listening  # type: ignore[method-assign]

    # ------------------------------------------------------------ time

    def mark(self) -> None:
        """Now something beyond what has been tolerated so far happens."""
        self.began_s = self.pair.clock()

    def later(self, seconds: float, act: Callable[[], None]) -> None:
        self.due.append((self.pair.clock() + seconds, act))

    def lead(self) -> None:
        """Do what is due and what a patient operator does; each word that clears a stop is said once."""
        ready = [act for due_s, act in self.due if due_s <= self.pair.clock()]
        self.due = [entry for entry in self.due if entry[0] > self.pair.clock()]
        for act in ready:
            act()
        self.pair._lead()
        view = self.pair.state.controller
        if self.pair.phase is Phase.HELD and view is not None and self.words:
            wanted = "reset" if view.cause is StopCause.NONE else "acknowledge"
            if self.words[0] == wanted:
                self.pair.terminal.type(self.words.pop(0))

    def to(self, *phases: Phase) -> "Scene":
        self.pair.until(lambda: self.pair.phase in phases, act=self.lead)
        return self

    def cutting(self) -> "Scene":
        self.to(Phase.CUTTING)
        self.pair.run(0.1)
        return self

    def held(self) -> "Scene":
        """The controller woke up with a latched fault; the operator knows the words."""
        self.pair.latch(StopCause.SECOND_NODE)
        self.words = ["acknowledge", "reset"]
        return self

    def moved(self) -> "Scene":
        """The bone moved long before this session's registration; the controller knows, and is to be told a barrier."""
        moved_at_s = self.pair.clock() - YEAR_S
        memory = replace(self.pair.controller.memory, withdrawal_due=True)
        self.pair.process.controller = replace(self.pair.controller, memory=memory, moved_at_s=moved_at_s)
        return self

    # ------------------------------------------------------------ single frames

    def frames(self, change: Callable[["Scene", int, can.Message], list[can.Message]]) -> None:
        """Change this message's frames, counted from now."""
        count = -1

        def rule(message: can.Message) -> list[can.Message]:
            nonlocal count
            if message.arbitration_id != self.message.can_id:
                return [message]
            count += 1
            return change(self, count, message)

        self.pair.wire.rules.append(rule)

    def put(self, can_id: int, data: bytes, *, everybody: bool) -> None:
        """Another node's frame: at the receiver alone, or on the bus where the sender hears it as well."""
        self.pair.wire.nodes[self.message.sender.peer].put(can_id, data)
        if everybody:
            self.pair.wire.nodes[self.message.sender].put(can_id, data)

    def hold(self, message: can.Message, seconds: float) -> None:
        """This frame arrives so much later."""
        node = self.pair.wire.nodes[self.message.sender.peer]
        self.pair.wire.late.append((self.pair.clock() + seconds, node, message))

    # ------------------------------------------------------------ records

    def matches(self, payload: bytes) -> bool:
        return payload[0] == self.message.kind.TYPE and self.message.which(records.unpack(payload).record)

    def records(self, change: Callable[[bytes, Callable[[bytes], None]], None], most: int = 1) -> None:
        """Change what the sender hands to its transfer: ``change(envelope, send)``, at most so many times."""
        transfer = self.sender._transfers[self.message.kind.CHANNEL]
        send, left = transfer.send, most

        def tapped(payload: bytes, now_s: float) -> None:
            nonlocal left
            if left and self.matches(payload):
                left -= 1
                if self.began_s is None:
                    self.mark()
                change(payload, lambda data: send(data, self.pair.clock()))
            else:
                send(payload, now_s)

        transfer.send = tapped  # type: ignore[method-assign]

    def carriers(self, change: Rule, most: int = 1) -> None:
        """Change the consecutive frames that carry this record; ``change`` gets each."""
        armed = 0
        inside = False

        def arm(payload: bytes, send: Callable[[bytes], None]) -> None:
            nonlocal armed
            armed += 1
            send(payload)

        def rule(message: can.Message) -> list[can.Message]:
            nonlocal armed, inside
            if message.arbitration_id != self.message.can_id or message.data[0] >> 4 == 3:
                return [message]
            if message.data[0] >> 4 == 1:
                inside = bool(armed) and message.data[2] == self.message.kind.TYPE
                armed -= inside
            return change(message) if inside else [message]

        self.records(arm, most)
        self.pair.wire.rules.append(rule)

    # ------------------------------------------------------------ what became of it

    def _inhibited(self) -> bool:
        """Neither side enables anything: no cutting mode there, no order here, the session is ending."""
        phase = self.pair.phase
        return (
            not self.pair.controller.cutting_mode
            and PHASES[phase].heartbeat is RuntimeCode.INHIBIT
            and (phase is Phase.STOPPING or phase in ENDED)
        )

    def observe(self) -> Observed:
        """Turn until both sides have stopped or the cut has gone on for long enough; then close the log."""
        goes_on = self._follow()
        pair = self.pair
        phase, state = pair.phase, pair.controller.state
        causes = (pair.state.cause, pair.controller.cause)
        latency_s = None if goes_on else self.stopped_s - self.began_s  # type: ignore[operator]
        stands = not goes_on and self._stands()
        if goes_on:
            pair.say("stop").end()
            pair.run(2 * pair.cycle_s)
        closed = pair.close().closed
        log = pair.read()
        named = {record.get("first_out") for record in log.of("/audit/decision")} - {None}
        return Observed(
            goes_on,
            phase,
            state,
            causes,
            latency_s,
            stands,
            "\n".join([*self.heard, *pair.said, pair.state.reason]),
            log.report.status if closed else Status.INCOMPLETE,
            frozenset(named),
        )

    def _follow(self) -> bool:
        until_s = self.pair.clock() + PATIENCE_S
        settled_s = None
        while self.pair.clock() < until_s:
            self.lead()
            self.pair.run_cycle()
            now_s = self.pair.clock()
            if self.stopped_s is None and self.began_s is not None and self._inhibited():
                self.stopped_s = now_s
            if self.pair.phase in ENDED:
                self.pair.run(WATCHED_S)
                return False
            moving = self.pair.phase is Phase.CUTTING and self.pair.controller.may_move and not self.due
            settled_s = (settled_s or now_s) if moving and self.began_s is not None else None
            if settled_s is not None and now_s - max(settled_s, self.began_s) >= WATCHED_S:  # type: ignore[type-var]
                return True
        raise AssertionError(f"neither stopped nor cutting: {self.pair.phase} {self.pair.state.reason}")

    def _stands(self) -> bool:
        began = {Phase.STARTING, Phase.CUTTING} & set(self.pair.notes.phases)
        before = self.pair.process.arm.state.joints if began else self.stood
        self.pair.run(WATCHED_S)
        return not self.pair.controller.may_move and self.pair.process.arm.state.joints == before


# ---------------------------------------------------------------- small changes


def with_data(message: can.Message, data: bytes, can_id: int | None = None) -> can.Message:
    """The same frame with other bytes, or on another identifier."""
    arbitration_id = message.arbitration_id if can_id is None else can_id
    return can.Message(arbitration_id=arbitration_id, data=data, is_extended_id=False)


def resealed(message: can.Message, tag: int, *, ahead: int = 0, flip: int = 0) -> bytes:
    """The same content, another counter or one bit, made sound for a session tag."""
    data = bytes(message.data)
    payload = bytes([data[3] ^ flip]) + data[4:]
    return protect(payload, (data[2] + ahead) % 256, DATA_IDS[message.arbitration_id], tag)
