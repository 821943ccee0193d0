"""The transitions of both tables as frozen data, ``transitions.json``: what a log may show that a session did.

Read independently of the code that took the steps: a table that was changed by mistake makes a log that does not fit.
The file is written by ``python -m docs.make_transitions``, and a test holds it against the code. Pure.

    table = transitions()
    table.step("permitting", condition_of(event), view, taken)  # None, or what is wrong

A row says: in these phases, on this event (of a heartbeat: that shows this), the session goes there, these leave in this
order, this becomes the first cause, and the decision lists the phase's permissives, perhaps with all of them holding.
"""

import json
import re
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib.resources import files
from typing import Any, Final, NamedTuple

from cutgate.protocol.states import LATCHING, WITHDRAWING, ControllerState, StopCause

NAME: Final = "transitions.json"
STAYS: Final = "="
"""Of a row: the phase stays."""
KEPT, NAMED = "kept", "named"
"""Of a row: the first cause stays what it was; it becomes the one that the event names."""
NOT_SHOWN, SHOWN, HOLD, SILENT = "none", "listed", "hold", "silent"
"""Of a row: the decision lists no permissive; those of the phase; those, and all hold; there is no record of the step."""
HEARTBEAT: Final = "heartbeat"
NO_EPOCH: Final = 0
"""Of a session that is not open yet."""


class HeartbeatView(NamedTuple):
    """A heartbeat of the controller as the rows tell it from others, each part in words."""

    state: str
    cause: str
    epoch: str
    device: str
    emergency_stop: str

    @classmethod
    def of(
        cls,
        state: str,
        cause: str,
        epoch: int,
        session_epoch: int,
        *,
        device_pressed: bool,
        emergency_stop_clear: bool,
    ) -> "HeartbeatView":
        """From the words of the log; ``session_epoch`` is the one the session was opened in."""
        return cls(
            state=state,
            cause=cause_kind(cause),
            epoch="the session's" if epoch == session_epoch else "another",
            device="held" if device_pressed else "released",
            emergency_stop="clear" if emergency_stop_clear else "pressed",
        )

    def __str__(self) -> str:
        """In words."""
        return (
            f"{self.state}, cause {self.cause}, epoch {self.epoch}, enabling device {self.device}, emergency stop "
            f"{self.emergency_stop}"
        )


def cause_kind(cause: str) -> str:
    """Whether a cause stands, and whether it withdraws the registration."""
    if cause == StopCause.NONE.name:
        return "none"
    return "withdrawing" if cause in {one.name for one in WITHDRAWING} else "standing"


def shown_cause(cause: str) -> str:
    """As `cause_kind`, and whether it latches the controller."""
    return "latching" if cause in {one.name for one in LATCHING} else cause_kind(cause)


VIEW_PARTS: Final[tuple[tuple[str, ...], ...]] = (
    tuple(state.name for state in ControllerState),
    ("none", "standing", "withdrawing"),
    ("the session's", "another"),
    ("held", "released"),
    ("clear", "pressed"),
)
"""What each part of a view may be."""

_REPLY: Final = re.compile(r"reply (\S+) to (.+)")
_COUNTED: Final = re.compile(r"(send path block|commit \w+)( as record)? \d+")
_STOP: Final = re.compile(r"send (STOP|END) \w+")


def condition_of(event: str, opened: str = "") -> str:
    """An event of the log as the rows name it: without what is particular to one session.

    Args:
        event: as the decision names it.
        opened: of a session that was opened, how the controller stands (`opened_as`).
    """
    if event.startswith(("failed ", "gave up ")):
        return event.rsplit(" ", 1)[0]
    if event.startswith("said "):
        return " ".join(event.split()[:2])
    if event.startswith("controller of protocol version "):
        return "controller of another protocol version announced"
    reply = _REPLY.fullmatch(event)
    if reply:
        answer, request = reply.groups()
        return f"reply {'accepted' if answer == 'ACCEPTED' else 'refused'} to {'something else' if request.startswith('0x') else request}"
    return f"{event}, {opened}" if opened else event


def opened_as(*, at_rest: bool, withdrawal_due: bool, witness: bool) -> str:
    """How the controller stands as it opens the session."""
    return ", ".join(
        (
            "no cause" if at_rest else "held",
            *(("withdrawal due",) if withdrawal_due else ()),
            *(("witness",) if witness else ()),
        )
    )


def leaves_of(effects: Iterable[str]) -> tuple[str, ...]:
    """Effects of the log as the rows name them: without index, token and cause."""
    return tuple(_STOP.sub(r"send \1", _COUNTED.sub(r"\1", effect)) for effect in effects)


def first_out_of(now: str | None, before: str | None, named: str | None) -> str:
    """The first cause behind a step as the rows name it: kept, named by the event, or by its own name."""
    if now == before:
        return KEPT
    return NAMED if now is not None and now == named else str(now)


class StepTaken(NamedTuple):
    """What a step came to.

    Attributes:
        to: the phase after it.
        leaves: the effects, in their order.
        first_out: `first_out_of`.
        permissives: `NOT_SHOWN`, `SHOWN`, `HOLD` or `SILENT`.
    """

    to: str
    leaves: tuple[str, ...]
    first_out: str
    permissives: str

    def __str__(self) -> str:
        """In words."""
        left = ", ".join(self.leaves) or "nothing"
        return f"to {self.to}, {left} leaves, first cause {self.first_out}, permissives {self.permissives}"


class TransitionRow(NamedTuple):
    """One row: the view that it needs of a heartbeat, each part any of these, and what the step comes to."""

    views: tuple[frozenset[str], ...] | None
    taken: StepTaken

    def fits(self, view: HeartbeatView | None) -> bool:
        """Whether it is about this heartbeat; it is about every other event."""
        if self.views is None or view is None:
            return self.views is None and view is None
        return all(part in allowed for part, allowed in zip(view, self.views, strict=True))


@dataclass(frozen=True)
class Transitions:
    """Both tables as the file holds them.

    Attributes:
        rows: by phase and condition.
        permissives: by phase, the names that a decision in it lists, in their order.
        views: what a heartbeat of the controller may show at once: state, cause, device, emergency stop, cutting mode.
        live: by state of the controller, those its next heartbeats may show in the session's epoch.
        stopped: those that they may show in another one, behind a stop.
    """

    rows: Mapping[tuple[str, str], tuple[TransitionRow, ...]]
    permissives: Mapping[str, tuple[str, ...]]
    views: tuple[tuple[frozenset[Any], ...], ...]
    live: Mapping[str, frozenset[str]]
    stopped: Mapping[str, frozenset[str]]

    @classmethod
    def parse(cls, data: bytes) -> "Transitions":
        """The file's content."""
        content = json.loads(data)
        rows: dict[tuple[str, str], list[TransitionRow]] = defaultdict(list)
        for one in content["runtime"]:
            views = one.get("shows")
            boxes = None if views is None else tuple(map(_any_of, views, VIEW_PARTS))
            for phase in one["in"]:
                to = phase if one["to"] == STAYS else one["to"]
                taken = StepTaken(to, tuple(one["leaves"]), one["first_out"], one["permissives"])
                rows[phase, one["on"]].append(TransitionRow(boxes, taken))
        controller = content["controller"]
        return cls(
            rows={key: tuple(found) for key, found in rows.items()},
            permissives={phase: tuple(names) for phase, names in content["permissives"].items()},
            views=tuple(tuple(map(frozenset, one)) for one in controller["shows"]),
            live={state: frozenset(after) for state, after in controller["in the session"].items()},
            stopped={state: frozenset(after) for state, after in controller["behind a stop"].items()},
        )

    def step(self, phase: str, condition: str, view: HeartbeatView | None, taken: StepTaken) -> str | None:
        """None where this step is a transition; else what the table has instead, in words."""
        rows = [row.taken for row in self.rows.get((phase, condition), ()) if row.fits(view)]
        if any(_is(taken, row) for row in rows):
            return None
        told = [row for row in rows if row.permissives != SILENT] or rows
        return "; or ".join(dict.fromkeys(map(str, told))) or "nothing: it does not happen there"

    def silent(self, phase: str, view: HeartbeatView) -> bool:
        """Whether such a heartbeat may pass in this phase without a record of a step."""
        rows = self.rows.get((phase, HEARTBEAT), ())
        return any(row.taken.permissives == SILENT and row.fits(view) for row in rows)

    def shows(self, state: str, cause: str, *, device: bool, clear: bool, cutting_mode: bool) -> bool:
        """Whether a heartbeat of the controller may say all of this at once."""
        seen = (state, shown_cause(cause), device, clear, cutting_mode)
        return any(all(part in box for part, box in zip(seen, view, strict=True)) for view in self.views)


def _any_of(allowed: list[str] | None, every: tuple[str, ...]) -> frozenset[str]:
    return frozenset(every if allowed is None else allowed)


def _is(taken: StepTaken, row: StepTaken) -> bool:
    """All equal; permissives that all hold are those of a row that asks for no more than the list."""
    listed = taken.permissives == row.permissives or (taken.permissives, row.permissives) == (HOLD, SHOWN)
    return listed and taken[:3] == row[:3]


def data() -> bytes:
    """The file as it is installed."""
    return files("cutgate.runtime.audit.recomputed").joinpath(NAME).read_bytes()


@cache
def transitions() -> Transitions:
    """The tables, read once."""
    return Transitions.parse(data())


@cache
def transitions_sha256() -> str:
    """The file's SHA-256 in hex, by which a log names it."""
    return sha256(data()).hexdigest()
