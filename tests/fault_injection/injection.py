"""Faults: what happens to frames, loops, disk, people and power, drawn from a seed, several things at once."""

import random
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field

import can

from cutgate.firmware_sim.console import ConsoleCommand
from cutgate.firmware_sim.fault_language import ANY, FAULT_TABLE, ByRule, MessageAction, MessageFault
from cutgate.firmware_sim.message_faults import MessageFaults
from cutgate.protocol.records import Side
from cutgate.protocol.states import ControllerState
from cutgate.runtime.interlock.state import OperatorCommand
from tests.fault_injection.tap import SENDER, Tap
from tests.runtime.session.pair import Pair
from tests.runtime.session.wire import CONTROLLER, RUNTIME, Node

RATES = (*(0.0,) * 9, 0.002, 0.01, 0.05)
"""How often each thing may happen to a frame, or in a cycle, while faults are injected: most things not at all, some often."""
LATE_MS = 250
LATE_S = LATE_MS / 1000
STILL_S = 0.3
"""The longest delay of a frame, and the longest that a loop stands still, s: above and below the time-out."""

STATES = (*(None,) * len(ControllerState), *ControllerState)
"""When a fault of frames may happen: half of them at any time, the others in one state of the controller."""

FrameAttack = Callable[["Injection", can.Message], list[can.Message] | None]
"""What becomes of a frame on its way; None where it is of a kind that this does not concern."""
Act = Callable[["Injection"], None]


@dataclass
class Injection:
    """The faults of one seed over one pair.

    Attributes:
        frame_attacks, acts: what may happen besides the faults of frames, by the name under which a person reads it.
        only: nothing but these happen, and that often; everything where empty.
        fell: what a person reads when a test has failed: everything that happened, in order.
        tap: what anybody has heard on the bus so far.
        relays: who takes a frame before anything else may happen to it, until it lets it pass.
    """

    pair: Pair
    seed: int
    frame_attacks: Mapping[str, FrameAttack]
    acts: Mapping[str, Act]
    only: Collection[str] = ()
    blowing: bool = False
    fell: list[str] = field(default_factory=list)
    later: list[tuple[float, Callable[[], None]]] = field(default_factory=list)
    tap: Tap = field(default_factory=Tap)
    relays: list[Callable[[can.Message], list[can.Message] | None]] = field(default_factory=list)
    crashed: bool = False

    def __post_init__(self) -> None:
        self.draw = random.Random(self.seed)
        drawn = [fault for action in MessageAction if (fault := self._drawn(action)) is not None]
        self.faults = MessageFaults(
            drawn, lambda fault, _times, message: self._note_frame(message, str(fault))
        )
        self.fell += [f"may happen: {fault}" for fault in drawn]
        self.frame_rates = {name: self._rate(name) for name in self.frame_attacks}
        self.act_rates = {name: self._rate(name) / 2 for name in self.acts}
        self.heard: list[can.Message] = []
        self.pair.wire.rules.append(self._frame)

    def _rate(self, name: str) -> float:
        if not self.only:
            return self.draw.choice(RATES)
        return RATES[-1] if name in self.only else 0.0

    def _drawn(self, action: MessageAction) -> MessageFault | None:
        """A fault of frames, as often as it may happen; None for not at all. Its line brings back what it does."""
        rate = self._rate(action)
        if not rate:
            return None
        takes_time = FAULT_TABLE[action].by is not ByRule.NEVER
        by_ms = (0, LATE_MS) if takes_time else None
        state = None if self.only else self.draw.choice(STATES)
        return MessageFault(action, ANY, by_ms, state, None, rate, self.draw.getrandbits(32))

    def note(self, text: str) -> None:
        self.fell.append(f"{self.pair.clock() - 1000:8.3f} s  {text}")

    def _frame(self, message: can.Message) -> list[can.Message]:
        """What becomes of one frame; at most one thing, for the next frame brings another."""
        self.tap.hear(message)
        for relay in self.relays:
            taken = relay(message)
            if taken is not None:
                return taken
        if self.blowing:
            for name, change in self.frame_attacks.items():
                if not self.draw.random() < self.frame_rates[name]:
                    continue
                becomes = change(self, message)
                if becomes is not None:
                    self._note_frame(message, name)
                    return becomes
        if len(self.heard) < 5000:
            self.heard.append(message)
        if not self.blowing:
            return [message]
        sender = SENDER[message.arbitration_id]
        return self.faults.passing(message, sender, self.pair.controller.state, self.pair.clock())

    def _note_frame(self, message: can.Message, text: str) -> None:
        self.note(f"{message.arbitration_id:03X} {bytes(message.data).hex()} {text}")

    def strike(self) -> None:
        """What happens in this cycle besides; what was late and is due arrives first."""
        now_s = self.pair.clock()
        for sender in Side:
            node = self.pair.wire.nodes[sender.peer]
            self.pair.wire.late += [(now_s, node, message) for message in self.faults.late(sender, now_s)]
        due = [act for due_s, act in self.later if due_s <= self.pair.clock()]
        self.later = [entry for entry in self.later if entry[0] > self.pair.clock()]
        for act in due:
            act()
        if not self.blowing:
            return
        for name, act in self.acts.items():
            if self.draw.random() < self.act_rates[name]:
                self.note(name)
                act(self)

    def clear(self) -> None:
        """The faults are over: nothing is lost, the disk answers, everybody works. What was done stays done."""
        self.blowing = False
        pair = self.pair
        pair.runtime_runs = pair.controller_runs = True
        pair.disk.answers, pair.disk.delay_s = True, 0.0
        for node in pair.wire.nodes.values():
            node.mute = node.deaf = False
        self.relays.clear()
        pair.wire.delay_s.clear()
        self.note("it clears")

    # ------------------------------------------------------------ small parts of it

    def hold(self, message: can.Message, longest_s: float = LATE_S) -> None:
        """This frame arrives later."""
        due_s = self.pair.clock() + self.draw.uniform(0.0, longest_s)
        self.pair.wire.late.append((due_s, self._receiver(message), message))

    def _receiver(self, message: can.Message) -> Node:
        return self.pair.wire.nodes[SENDER[message.arbitration_id].peer]

    def for_a_while(self, begin: Callable[[], None], end: Callable[[], None]) -> None:
        begin()
        self.later.append((self.pair.clock() + self.draw.uniform(0.01, STILL_S), end))


# ---------------------------------------------------------------- frames


def with_data(message: can.Message, data: bytes, can_id: int | None = None) -> can.Message:
    arbitration_id = message.arbitration_id if can_id is None else can_id
    return can.Message(arbitration_id=arbitration_id, data=data, is_extended_id=False)


def said_again(injection: Injection, message: can.Message) -> list[can.Message]:
    """Something that either side has said before, in whatever session, arrives as well."""
    old = injection.draw.choice(injection.heard or [message])
    injection.hold(old)
    return [message]


# ---------------------------------------------------------------- people, loops, disk, power


def _operator(injection: Injection) -> None:
    word = injection.draw.choice([*OperatorCommand])
    injection.note(f"operator: {word}")
    injection.pair.terminal.type(word)


def _person(injection: Injection) -> None:
    word = injection.draw.choice([*ConsoleCommand])
    injection.note(f"controller: {word}")
    injection.pair.controller_terminal.type(word)


def _still(name: str) -> Act:
    def act(injection: Injection) -> None:
        injection.for_a_while(
            lambda: setattr(injection.pair, name, False), lambda: setattr(injection.pair, name, True)
        )

    return act


def _slow_disk(injection: Injection) -> None:
    injection.pair.disk.delay_s = injection.draw.choice((0.001, 0.05, 0.5, 3.0))


def _deaf(side: Side, how: str) -> Act:
    def act(injection: Injection) -> None:
        setattr(injection.pair.wire.nodes[side], how, True)

    return act


def _crash(injection: Injection) -> None:
    injection.crashed = True


def _no_verifier(injection: Injection) -> None:
    """Before it has said its verdict the session stops; afterwards nothing is asked of it any more."""
    injection.pair.prover.die()


def reboot(injection: Injection) -> None:
    """Power goes and comes: nothing stays but the memory file; what waited to be read is gone."""
    pair = injection.pair
    node = pair.wire.nodes[CONTROLLER]
    node.inbox.clear()
    node.mute = node.deaf = False
    pair.controller_runs = True
    pair.power_up()


ACTS: dict[str, Act] = {
    "the operator says something": _operator,
    "somebody does something at the controller": _person,
    "the runtime stands still": _still("runtime_runs"),
    "the controller stands still": _still("controller_runs"),
    "the disk is slow": _slow_disk,
    "the disk answers no more": lambda injection: setattr(injection.pair.disk, "answers", False),
    "the verifier dies": _no_verifier,
    "the runtime cannot send": _deaf(RUNTIME, "mute"),
    "the runtime cannot read": _deaf(RUNTIME, "deaf"),
    "the controller cannot send": _deaf(CONTROLLER, "mute"),
    "the controller reboots": reboot,
    "the runtime is killed": _crash,
}
