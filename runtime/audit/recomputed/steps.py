"""Each recorded step of a session held against the frozen tables (``transitions``), record after record.

    steps = Steps(transitions())
    for record in the log, in its order:
        differences += steps.opened(...), steps.controller(...), steps.fault(...), steps.decision(...)

Rules. Decisions are numbered from 1 and each begins in the phase in which the one before it ended. On its event a decision
goes where the table goes; what the table orders leaves, all of it, in its order and nothing else; the first cause is the
table's and is kept; it lists the permissives of its phase, and goes on only where the table does not need them to hold or all
do. A heartbeat on which the table takes a step has its decision. What the controller shows in its heartbeats is what its
own table lets be seen, and follows from what it showed before. The log closes in the phase that the last decision has led to.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from cutgate.protocol import records as wire
from cutgate.protocol.states import ControllerState, StopCause
from cutgate.runtime.audit import records
from cutgate.runtime.audit.recomputed.opening import Opening
from cutgate.runtime.audit.recomputed.transitions import (
    HEARTBEAT,
    HOLD,
    NO_EPOCH,
    NOT_SHOWN,
    SHOWN,
    HeartbeatView,
    StepTaken,
    Transitions,
    condition_of,
    first_out_of,
    leaves_of,
    opened_as,
)

FIRST: Final = "waiting"
OPENING: Final = "opening"
STOPPED: Final = "stopped"
OPENED: Final = "session opened"
FAULT: Final = "controller's fault"
GAVE_UP: Final = "gave up"
WITHOUT: Final = "without the table: "
"""So begins the reason of an end that the program took because its table, or its journal, had failed."""
ENABLED_BY: Final = {ControllerState.PERMITTED.name: "permit", ControllerState.CUTTING.name: "start"}
"""What must have left before the controller shows that it has got there."""
DEVIATION: Final = "Deviation"
"""An effect that lists what deviates in place of the phase's permissives."""


class Stood(NamedTuple):
    """How the controller stood."""

    state: str
    cause: str
    epoch: int


@dataclass
class Steps:
    """What the records so far have led to.

    Args:
        table: the transitions.
    """

    table: Transitions
    phase: str = FIRST
    _number: int = 0
    _first_out: str | None = None
    _epoch: int = NO_EPOCH
    _opened: str = ""
    """How the controller stood as it opened the session, from its OPENED to the decision on it."""
    _fault: str | None = None
    """The cause that the last fault frame claimed."""
    _stood: Stood | None = None
    """The controller, by its last heartbeat; by its OPENED before the first."""
    _view: records.AuditController | None = None
    _left: set[str] = field(default_factory=set)
    """Of permit, start and reset."""
    _acknowledged: bool = False
    _due: bool = field(default=False)
    """A heartbeat has shown something else, and no decision on it has come yet."""

    def opened(self, data: bytes) -> Iterator[str]:
        """OPEN and OPENED as they crossed the bus."""
        try:
            answer = Opening.parse(data).answer
        except ValueError as error:
            yield f"{records.AuditSession.TOPIC} cannot be read: {error}"
            return
        self._epoch = answer.epoch
        self._stood = Stood(answer.state.name, answer.cause.name, answer.epoch)
        self._opened = opened_as(
            at_rest=answer.state is ControllerState.OPEN and answer.cause is StopCause.NONE,
            withdrawal_due=bool(answer.withdrawal_due),
            witness=answer.log != wire.NO_TREE_HEAD,
        )

    def fault(self, record: records.AuditFault) -> Iterator[str]:
        """A fault; of the controller's the claimed cause is the next decision's."""
        if record.source == "controller":
            self._fault = record.cause
        yield from ()

    def permit(self, record: records.AuditPermit) -> Iterator[str]:
        """A permit, start or reset on its way."""
        if record.stage == "sent":
            self._left.add(record.kind)
        yield from ()

    def operator(self, command: records.AuditOperator) -> Iterator[str]:
        """A command of the operator."""
        self._acknowledged |= command.word == "acknowledge" and command.accepted
        yield from ()

    def controller(self, record: records.AuditController) -> Iterator[str]:
        """What the controller shows from now on."""
        yield from self._passed()
        before, self._stood = self._stood, Stood(record.state, record.cause, record.epoch)
        self._view = record
        self._due = True
        shown = f"the controller shows {_told(record)}"
        if not self.table.shows(
            record.state,
            record.cause,
            device=record.device_pressed,
            clear=record.emergency_stop_clear,
            cutting_mode=record.cutting_mode,
        ):
            yield f"{shown} behind decision {self._number}, which its table never lets be seen"
        if before is not None:
            yield from self._goes_on(before, record, shown)

    def _goes_on(self, before: Stood, record: records.AuditController, shown: str) -> Iterator[str]:
        """From what it showed before; what enables it or lets go of it has left this side."""
        stopped = record.epoch != self._epoch
        if not stopped and before.epoch != self._epoch:
            yield f"{shown} behind decision {self._number}, after a stop has ended that epoch"
            return
        after = (self.table.stopped if stopped else self.table.live).get(before.state, frozenset())
        if record.state not in after:
            yield (
                f"{shown} behind decision {self._number}, after {before.state}{' and a stop' if stopped else ''}: its "
                f"table goes from there to {', '.join(sorted(after)) or 'nothing'}"
            )
        for what, needed in self._needed(before, record):
            if not needed:
                yield f"{shown} behind decision {self._number}, and {what}"

    def _needed(self, before: Stood, record: records.AuditController) -> Iterator[tuple[str, bool]]:
        """What must not be so, and whether it is not."""
        kind = ENABLED_BY.get(record.state)
        if kind is not None:
            yield f"no {kind} had left", kind in self._left
        if before.state == ControllerState.FAULT.name != record.state and record.epoch == self._epoch:
            yield "no reset had left", "reset" in self._left
        if before.cause != StopCause.NONE.name == record.cause:
            yield "nobody had said acknowledge", self._acknowledged

    def decision(self, record: records.AuditDecision) -> Iterator[str]:
        """One step."""
        beat = record.event == HEARTBEAT
        if not beat:
            yield from self._passed()
        self._due = False
        yield from self._follows(record)
        before, self.phase, self._number = record.from_state, record.to_state, record.sequence
        first_out, self._first_out = self._first_out, record.first_out
        opened, self._opened = (self._opened, "") if record.event == OPENED else ("", self._opened)
        if _without_the_table(record):
            return
        condition = condition_of(record.event, opened if before == OPENING else "")
        listed = [permissive.name for permissive in record.permissives]
        deviates = DEVIATION in record.effects
        taken = StepTaken(
            record.to_state,
            leaves_of(record.effects),
            first_out_of(record.first_out, first_out, self._named(record.event)),
            _permissives(record) if listed and not deviates else NOT_SHOWN,
        )
        instead = self.table.step(before, condition, self._shown if beat else None, taken)
        where = f"decision {record.sequence}, {before} on {record.event}"
        if instead is not None:
            view = f" ({self._shown})" if beat else ""
            yield f"{where}{view}: {taken}; the table has {instead}"
        wanted = list(self.table.permissives.get(before, ()))
        if listed and not deviates and listed != wanted:
            odd = [name for name in wanted if name not in listed] or [
                name for name in listed if name not in wanted
            ]
            yield f"{where}: it lists other permissives than the table: {', '.join(odd) or 'in another order'}"

    def closed(self, record: records.AuditClose) -> Iterator[str]:
        """The end."""
        yield from self._passed()
        if record.final_state != self.phase:
            yield f"the log closes in {record.final_state}; decision {self._number} has led to {self.phase}"

    def _follows(self, record: records.AuditDecision) -> Iterator[str]:
        """It is the next one; but where the journal failed the step before has no record."""
        if record.event.startswith(GAVE_UP):
            return
        if record.sequence != self._number + 1:
            yield f"decision {record.sequence} stands behind decision {self._number}"
        if record.from_state != self.phase:
            yield (
                f"decision {record.sequence}, on {record.event}, begins in {record.from_state}; the one before it has led "
                f"to {self.phase}"
            )

    def _passed(self) -> Iterator[str]:
        """A heartbeat that has no decision must be one on which the table takes no step."""
        view = self._shown
        if self._due and view is not None and not self.table.silent(self.phase, view):
            yield (
                f"the controller shows {view} in {self.phase}, behind decision {self._number}, and no decision follows: "
                "the table takes a step there"
            )

    @property
    def _shown(self) -> HeartbeatView | None:
        view = self._view
        if view is None:
            return None
        return HeartbeatView.of(
            view.state,
            view.cause,
            view.epoch,
            self._epoch,
            device_pressed=view.device_pressed,
            emergency_stop_clear=view.emergency_stop_clear,
        )

    def _named(self, event: str) -> str | None:
        """The cause that an event names."""
        if event == HEARTBEAT:
            return self._view.cause if self._view else None
        if event == FAULT:
            return self._fault
        return event.rpartition(" ")[2] if event.startswith(("failed ", GAVE_UP)) else None


def _permissives(record: records.AuditDecision) -> str:
    return HOLD if all(permissive.holds for permissive in record.permissives) else SHOWN


def _without_the_table(record: records.AuditDecision) -> bool:
    """The last resort of a program whose table or journal has failed: it stops, and orders nothing through the table."""
    return (
        record.event.startswith(GAVE_UP)
        and (record.reason or "").startswith(WITHOUT)
        and record.to_state == STOPPED
        and not record.effects
    )


def _told(record: records.AuditController) -> str:
    return (
        f"{record.state}, cause {record.cause}, epoch {record.epoch}, device {'held' if record.device_pressed else 'released'}, "
        f"emergency stop {'clear' if record.emergency_stop_clear else 'pressed'}, cutting mode "
        f"{'on' if record.cutting_mode else 'off'}"
    )
