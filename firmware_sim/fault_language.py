"""Faults as one line each: what, to which message, when, how often, from which seed. Pure.

A fault of the controller itself is ``NAME@STATE`` (``faults.py``). A fault of a message on its way is::

    lose ControllerHeartbeat @cutting x3
    delay Joints01 by 30ms @permitted p=0.1 seed=7
    corrupt RuntimeHeartbeat

After action and message come, in any order and each once at most: ``by`` (how much later), ``@STATE`` (only while the
controller is in it), ``xN`` (so often at most), ``p=`` (each time with this probability) and ``seed=``. With neither
``xN`` nor ``p=`` a fault happens once; with ``p=`` alone it may happen every time. Whatever a line leaves to chance
follows from its seed alone, so that a line reproduces what it did. ``parse_fault(str(fault)) == fault`` for every one.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from cutgate.config.refusal import InputError, shown
from cutgate.firmware_sim.faults import FaultName, FaultSpec
from cutgate.protocol.frames import FRAMES, TRANSFER_IDS
from cutgate.protocol.states import ControllerState

BY_MAX_MS: Final = 10_000
TIMES_MAX: Final = 1_000_000
SEED_MAX: Final = 2**32 - 1
CHANCE_STEPS: Final = 1_000_000
"""A probability is a whole number of millionths: printed and read again it is the same."""
LINE_MAX: Final = 200
ANY: Final = "any"
REMEDY: Final = "docs/hil.md lists all faults"

MESSAGES: Final[dict[str, frozenset[int]]] = {
    **{kind.__name__: frozenset((can_id,)) for can_id, kind in FRAMES.items()},
    **{
        f"{side.name.title()}{channel.name.title()}": frozenset((can_id,))
        for side, channels in TRANSFER_IDS.items()
        for channel, can_id in channels.items()
    },
    ANY: frozenset(FRAMES) | {can_id for channels in TRANSFER_IDS.values() for can_id in channels.values()},
}
"""What a line may name, with its identifiers: single frames as the DBC names them, the segments of each transfer, all."""

STATES: Final[dict[str, ControllerState]] = {state.name.lower(): state for state in ControllerState}


class MessageAction(StrEnum):
    """What can happen to a message on its way."""

    LOSE = "lose"
    CORRUPT = "corrupt"
    SHORTEN = "shorten"
    DELAY = "delay"
    REPEAT = "repeat"
    REPLAY = "replay"
    REORDER = "reorder"
    MISADDRESS = "misaddress"


ACTIONS: Final[dict[str, MessageAction]] = {action.value: action for action in MessageAction}


class ByRule(StrEnum):
    """Whether a line says by how much later."""

    NEVER = "never"
    MAY = "may"
    MUST = "must"


@dataclass(frozen=True)
class FaultRow:
    """What a fault does, for whoever chooses one, and whether it takes ``by``."""

    does: str
    by: ByRule = ByRule.NEVER


FAULT_TABLE: Final[dict[FaultName | MessageAction, FaultRow]] = {
    MessageAction.LOSE: FaultRow("does not arrive"),
    MessageAction.CORRUPT: FaultRow("arrives with one to three of its bits flipped"),
    MessageAction.SHORTEN: FaultRow("arrives with fewer bytes"),
    MessageAction.DELAY: FaultRow("arrives later, and what follows it overtakes it", ByRule.MUST),
    MessageAction.REPEAT: FaultRow("arrives twice; with `by`, the second time so much later", ByRule.MAY),
    MessageAction.REPLAY: FaultRow(
        "arrives, and an earlier one of those named arrives with it; with `by`, so much later", ByRule.MAY
    ),
    MessageAction.REORDER: FaultRow("arrives after the next frame of the same sender"),
    MessageAction.MISADDRESS: FaultRow("arrives under another identifier"),
    FaultName.FLIP_PATH_BIT: FaultRow("one bit of the stored path changes"),
    FaultName.OFF_START: FaultRow("the arm stands 2 deg in q0 off the first pose"),
    FaultName.HANG: FaultRow("the control loop stands still for one second"),
    FaultName.SILENT: FaultRow("no frame leaves any more"),
    FaultName.CHANGE_LIMIT: FaultRow("a joint limit changes unnoticed"),
    FaultName.REBOOT: FaultRow("power is lost and comes back, its memory is kept"),
    FaultName.DRIFT: FaultRow("q0 creeps away from where the controller believes it to be, 1 deg/s"),
    FaultName.FREEZE: FaultRow("the reported joints stand still while the arm goes on"),
    FaultName.RUSH: FaultRow("the plant runs three times as fast as it says"),
    FaultName.BONE_MOTION: FaultRow("the bone moves by 1 mm, and its sensor tells"),
    FaultName.POWER_LOSS: FaultRow(
        "power is lost for a second: the brakes stop the arm, nothing is sent, then everything but its memory is new"
    ),
    FaultName.TORN_WRITE: FaultRow(
        "power is lost in the middle of the next writing of its memory, which is what it was"
    ),
    FaultName.UNANSWERED_WRITE: FaultRow(
        "power is lost after the next writing of its memory, before anything is answered"
    ),
    FaultName.FLIP_LIMIT_BIT: FaultRow("one stored bit of a joint limit changes"),
    FaultName.FLIP_MEMORY_BIT: FaultRow(
        "one bit of its memory's file changes, which it finds when it is powered up again"
    ),
    FaultName.SLOW: FaultRow("each cycle of the control loop is late from now on, by `--slow-ms`"),
    FaultName.HUNG: FaultRow("the control loop stands still for good"),
    FaultName.SECOND_CONTROLLER: FaultRow("another node says a controller's heartbeat, without the key"),
    FaultName.SECOND_RUNTIME: FaultRow("another node says a runtime's heartbeat, without the key"),
    FaultName.WEAK_DRIVE: FaultRow(
        "the drives have a hundredth of their acceleration left; needs `--dynamics`"
    ),
}
"""Every fault there is: those of a message, then those of the controller."""


@dataclass(frozen=True)
class MessageFault:
    """A fault of messages on their way.

    Attributes:
        action: what happens.
        message: to which, a key of ``MESSAGES``.
        by_ms: shortest and longest delay, whole ms; drawn in between. None where nothing is said.
        state: only while the controller is in it; None for always.
        times: so often at most; None for any number.
        probability: of each time, a whole number of millionths in (0, 1].
        seed: of all that is left to chance.

    Raises:
        ValueError: a value outside its bounds; the text says which and what is allowed.
    """

    action: MessageAction
    message: str
    by_ms: tuple[int, int] | None = None
    state: ControllerState | None = None
    times: int | None = 1
    probability: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        _require(self.message in MESSAGES, f"message must be one of {', '.join(MESSAGES)}")
        rule = FAULT_TABLE[self.action].by
        if self.by_ms is None:
            _require(rule is not ByRule.MUST, f"{self.action} needs `by`, for example `by 30ms`")
        else:
            _require(rule is not ByRule.NEVER, f"{self.action} takes no `by`; leave it out")
            low, high = self.by_ms
            _require(
                0 <= low <= high <= BY_MAX_MS and high > 0, f"by must be 1ms to {BY_MAX_MS}ms, or A..Bms"
            )
        _require(self.times is None or 1 <= self.times <= TIMES_MAX, f"times must be x1 to x{TIMES_MAX}")
        steps = self.probability * CHANCE_STEPS
        _require(
            1 <= steps <= CHANCE_STEPS and round(steps) / CHANCE_STEPS == self.probability,
            "p must be over 0, at most 1, with at most six digits after the point",
        )
        _require(0 <= self.seed <= SEED_MAX, f"seed must be 0 to {SEED_MAX}")

    def __str__(self) -> str:
        """The line, as ``parse_fault`` reads it."""
        parts = [self.action.value, self.message]
        if self.by_ms is not None:
            low, high = self.by_ms
            parts.append(f"by {high}ms" if low == high else f"by {low}..{high}ms")
        if self.state is not None:
            parts.append(f"@{self.state.name.lower()}")
        if self.times is not None and (self.times, self.probability) != (1, 1.0):
            parts.append(f"x{self.times}")
        if self.probability < 1.0:
            parts.append(f"p={self.probability:.6f}".rstrip("0"))
        elif self.times is None:
            parts.append("p=1")
        if self.seed:
            parts.append(f"seed={self.seed}")
        return " ".join(parts)

    @property
    def can_ids(self) -> frozenset[int]:
        """The identifiers that it concerns."""
        return MESSAGES[self.message]


Fault = FaultSpec | MessageFault


def _require(holds: bool, text: str) -> None:
    if not holds:
        raise ValueError(text)


# ---------------------------------------------------------------- reading a line


def _by(fault: dict[str, object], found: re.Match[str]) -> None:
    high = int(found["high"])
    fault["by_ms"] = (high if found["low"] is None else int(found["low"]), high)


def _state(fault: dict[str, object], found: re.Match[str]) -> None:
    name = found["state"]
    _require(name in STATES, f"state must be one of {', '.join(STATES)}")
    fault["state"] = STATES[name]


def _times(fault: dict[str, object], found: re.Match[str]) -> None:
    fault["times"] = int(found["times"])


def _chance(fault: dict[str, object], found: re.Match[str]) -> None:
    fault["probability"] = float(found["chance"])


def _seed(fault: dict[str, object], found: re.Match[str]) -> None:
    fault["seed"] = int(found["seed"])


_QUALIFIERS: Final[dict[str, tuple[re.Pattern[str], Callable[[dict[str, object], re.Match[str]], None]]]] = {
    "by": (re.compile(r"by (?:(?P<low>0|[1-9][0-9]{0,4})\.\.)?(?P<high>[1-9][0-9]{0,4})ms"), _by),
    "@STATE": (re.compile(r"@(?P<state>[a-z]{1,20})"), _state),
    "xN": (re.compile(r"x(?P<times>[1-9][0-9]{0,6})"), _times),
    "p=": (re.compile(r"p=(?P<chance>0\.[0-9]{1,6}|1)"), _chance),
    "seed=": (re.compile(r"seed=(?P<seed>0|[1-9][0-9]{0,9})"), _seed),
}
"""What may follow action and message, as it is written."""
_ALLOWED: Final = "`by 30ms` or `by 5..250ms`, `@STATE`, `xN`, `p=0.1`, `seed=7`, one space between"


def parse_fault(line: str, place: str = "fault") -> Fault:
    """One line as a value.

    Args:
        line: what was written, at most ``LINE_MAX`` characters.
        place: where, for the refusal: an option, or a file with its line.

    Raises:
        InputError: it is no fault; the refusal says what is allowed there.
    """
    if len(line) > LINE_MAX:
        raise InputError(place, "", line, f"at most {LINE_MAX} characters", f"name one fault; {REMEDY}")
    name, _, rest = line.partition(" ")
    try:
        if name in ACTIONS:
            return _message_fault(ACTIONS[name], rest)
        return FaultSpec.parse(name + rest if rest.startswith("@") else line)
    except ValueError as error:
        known = name in ACTIONS or name.partition("@")[0] in frozenset(map(str, FaultName))
        of_messages = "" if known else f"; of messages: {', '.join(ACTIONS)}"
        raise InputError(place, f'"{shown(line)}"', None, f"{error}{of_messages}", REMEDY) from None


def _message_fault(action: MessageAction, rest: str) -> MessageFault:
    """Raises ValueError naming what is allowed."""
    message, _, rest = rest.partition(" ")
    read: dict[str, object] = {}
    _require(message in MESSAGES, f"message must be one of {', '.join(MESSAGES)}")
    seen: set[str] = set()
    while rest:
        name, found = _next_qualifier(rest)
        _require(name not in seen, f"{name} is given twice; give it once")
        seen.add(name)
        _QUALIFIERS[name][1](read, found)
        rest = rest[found.end() :].removeprefix(" ")
    if "p=" in seen and "xN" not in seen:
        read["times"] = None
    return MessageFault(action, message, **read)  # type: ignore[arg-type]


def _next_qualifier(rest: str) -> tuple[str, re.Match[str]]:
    """What the line goes on with, and a space or its end after it; raises ValueError naming what is allowed."""
    for name, (pattern, _take) in _QUALIFIERS.items():
        found = pattern.match(rest)
        if found is not None and re.match(r"\Z| [^ ]", rest[found.end() :]):
            return name, found
    raise ValueError(f"{rest!r} is not understood; after the message may come {_ALLOWED}")
