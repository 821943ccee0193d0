"""A log's records, one after the other, as what viewers draw and plot. Pure."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Final, TypeVar

import numpy as np
from pydantic import ValidationError

from cutgate.config.screen import printable
from cutgate.protocol.arrays import Floats
from cutgate.protocol.frames import FRACTION_MAX, Progress
from cutgate.protocol.records import session_tag
from cutgate.runtime.audit.container.stored import Stored
from cutgate.runtime.audit.records import (
    NANOSECONDS,
    AuditClose,
    AuditController,
    AuditDecision,
    AuditFault,
    AuditOperator,
    AuditPermit,
    AuditSession,
    AuditVerdict,
    CanFrame,
    Entry,
    LogRecord,
    LoopTiming,
    Time,
    TrackingSample,
)
from cutgate.runtime.commands.foxglove.arm import ShownArm, bone_transform
from cutgate.runtime.commands.foxglove.decided import DrawnDecision
from cutgate.runtime.commands.foxglove.schemas import (
    FoxgloveLog,
    FoxgloveLogLevel,
    JointValues,
    SessionState,
)
from cutgate.runtime.interlock.phases import STOPPING
from cutgate.runtime.interlock.tracking import ReferenceTrajectory
from cutgate.runtime.review.joint_samples import JointSamples
from cutgate.runtime.session.telemetry import RateLimit

TEXT_MAX: Final = 2000
"""Characters of a line of the log that are shown."""
Q: Final = ("q0_{}_deg", "q1_{}_deg", "q2_{}_mm", "q3_{}_deg", "q4_{}_deg")
_DECIMALS: Final = 4
_PREFIX: Final = 4
"""Bytes of a session's digest that are its tag."""
Level = FoxgloveLogLevel
Kind = TypeVar("Kind", bound=LogRecord)
Viewed = tuple[str, Entry]
"""A topic and its message."""


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of the session beside its records, as far as the log holds it.

    Attributes:
        name: of the log.
        arm: the true arm.
        decision: what is drawn of the last verdict.
        trajectory: what the moving arm was held against.
        follows: the log has records of tracking: where the arm may move these tell of joints, not the frames.
    """

    name: str
    arm: ShownArm | None = None
    decision: DrawnDecision | None = None
    trajectory: ReferenceTrajectory | None = None
    follows: bool = False


@dataclass
class Streams:
    """Record by record; what is kept does not grow with the log.

    Attributes:
        known: of the session.
        verdicts: how many there are: the scene comes with the last.
        strange: records that are none of their topic, left out.
    """

    known: Known
    verdicts: int
    strange: int = 0
    _samples: JointSamples = field(default_factory=JointSamples)
    _limits: dict[str, tuple[int, RateLimit]] = field(default_factory=dict)
    """Of each topic the time of the last record that asked, ns, and the limit."""
    _state: SessionState = field(default_factory=lambda: SessionState(phase="waiting", controller="UNKNOWN"))
    _tracked: bool = False
    """The last joints were those of a record of tracking: frames are passed over until the phase changes."""
    _progress: tuple[int, int] = (0, 0)

    def take(self, message: Stored) -> Iterator[Viewed]:
        """What becomes of a record."""
        handler = HANDLERS.get(message.topic)
        if handler is None:
            return
        model, act = handler
        try:
            record = model.model_validate_json(message.data)
            found = list(act(self, record, message))
        except (ValidationError, ValueError):  # it is data
            self.strange += 1
            return
        yield from found

    # ------------------------------------------------------------ words

    def _line(self, message: Stored, level: FoxgloveLogLevel, text: str) -> Viewed:
        shown = printable(text)
        shown = shown if len(shown) <= TEXT_MAX else f"{shown[:TEXT_MAX]} ..."
        return "/log", FoxgloveLog(
            timestamp=Time.of(message.log_time),
            level=level,
            message=shown,
            name=message.topic,
            file=printable(self.known.name),
            line=message.sequence,
        )

    def decision(self, record: AuditDecision, message: Stored) -> Iterator[Viewed]:
        """A step of the interlock: a line, and the phase where it is another."""
        self._session(record.session)
        stops = record.to_state in STOPPING and record.from_state not in STOPPING
        held = record.disposition == "withheld" or record.to_state == "refused"
        level = Level.ERROR if stops else Level.WARNING if held else Level.INFO
        text = f"{record.from_state} -> {record.to_state}: {record.event}, {record.disposition}"
        yield self._line(message, level, _because(text, record.first_out if stops else None, record.reason))
        yield from self._now(
            SessionState(phase=printable(record.to_state), controller=self._state.controller)
        )

    def controller(self, record: AuditController, message: Stored) -> Iterator[Viewed]:
        """The controller's state."""
        text = f"controller {record.state}, device {'pressed' if record.device_pressed else 'released'}"
        cause = None if record.cause == "NONE" else record.cause
        yield self._line(message, Level.DEBUG if cause is None else Level.WARNING, _because(text, cause))
        yield from self._now(SessionState(phase=self._state.phase, controller=printable(record.state)))

    def _now(self, state: SessionState) -> Iterator[Viewed]:
        if state != self._state:
            self._tracked = self._tracked and state.phase == self._state.phase
            self._state = state
            yield "/state", state

    def fault(self, record: AuditFault, message: Stored) -> Iterator[Viewed]:
        """A fault of either side."""
        text = f"fault of the {record.source}: {record.code} {record.cause}"
        yield self._line(message, Level.ERROR, _because(text, record.detail))

    def operator(self, record: AuditOperator, message: Stored) -> Iterator[Viewed]:
        """A command of the operator."""
        text = f"operator: {record.word}{f' {record.what}' if record.what else ''}"
        level = Level.INFO if record.accepted else Level.WARNING
        yield self._line(
            message, level, _because(text, None if record.accepted else "refused", record.reason)
        )

    def permit(self, record: AuditPermit, message: Stored) -> Iterator[Viewed]:
        """A permit, start or reset on its way."""
        level = Level.WARNING if record.stage in ("withheld", "refused") else Level.INFO
        text = f"{record.kind} {record.stage}"
        yield self._line(message, level, _because(text, record.reply, record.reason))

    def close(self, record: AuditClose, message: Stored) -> Iterator[Viewed]:
        """The end."""
        text = f"log closed, {record.final_state}"
        yield self._line(message, Level.INFO if record.clean else Level.ERROR, _because(text, record.outcome))

    # ------------------------------------------------------------ what stands still

    def verdict(self, record: AuditVerdict, message: Stored) -> Iterator[Viewed]:
        """The verdict; with the last one all that is drawn of it."""
        level = Level.INFO if record.verdict == "admissible" else Level.WARNING
        yield self._line(message, level, _because(f"verdict: {record.verdict}", record.reason))
        self.verdicts -= 1
        at, known = Time.of(message.log_time), self.known
        if self.verdicts:
            return
        if known.arm is not None:
            yield "/arm", known.arm.drawn(at)
        if known.decision is not None:
            yield "/scene", known.decision.drawn(at)
            yield "/plan", known.decision.plan(at)
            if known.decision.place is not None:
                yield "/transforms/bone", bone_transform(known.decision.place, at)

    # ------------------------------------------------------------ what moves

    def session(self, record: AuditSession, _: Stored) -> Iterator[Viewed]:
        """The session, whose frames are listened to from now on."""
        self._session(record.session)
        return iter(())

    def _session(self, digest: str | None) -> None:
        if digest:
            self._samples.tag = session_tag(bytes.fromhex(digest))

    def frame(self, record: CanFrame, message: Stored) -> Iterator[Viewed]:
        """Joints and progress, as the controller sent them."""
        strange = record.is_extended or record.is_rtr or record.is_error
        if record.direction != "received" or strange:
            return
        found = self._samples.take(record.id, bytes.fromhex(record.data))
        if isinstance(found, Progress):
            yield from self._cut(found, message)
        elif found is not None and not self._tracked:
            yield from self._joints(found, None, message)

    def _cut(self, found: Progress, message: Stored) -> Iterator[Viewed]:
        place, decision = (found.segment, found.fraction), self.known.decision
        if decision is None or place == self._progress or not self._allows("/clearance", message):
            return
        self._progress = place
        clearances = decision.clearances(found.segment, round(found.fraction / FRACTION_MAX, 6))
        if clearances is not None:
            yield "/clearance", clearances

    def tracking(self, record: TrackingSample, message: Stored) -> Iterator[Viewed]:
        """As it is; and with the reference that it was held against, the joints."""
        yield message.topic, record
        trajectory = self.known.trajectory
        if trajectory is None or not 0.0 <= record.reference_s <= trajectory.end_s + 1.0:
            return
        self._tracked = True
        reference = trajectory.joints_at(min(record.reference_s, trajectory.end_s))
        off = np.array([getattr(record, name.format("deviation")) for name in Q])
        off[[0, 1, 3, 4]] = np.radians(off[[0, 1, 3, 4]])
        yield from self._joints(reference + off, reference, message)

    def timing(self, record: LoopTiming, message: Stored) -> Iterator[Viewed]:
        """As it is."""
        yield message.topic, record

    def _joints(self, measured: Floats, reference: Floats | None, message: Stored) -> Iterator[Viewed]:
        if not self._allows("/joints", message):
            return
        values = _named("measured", measured) | ({} if reference is None else _named("reference", reference))
        yield "/joints", JointValues(**values)
        if self.known.arm is not None:
            yield "/transforms", self.known.arm.transforms(measured, Time.of(message.log_time))

    def _allows(self, topic: str, message: Stored) -> bool:
        before_ns, limit = self._limits.get(topic, (0, RateLimit()))
        if message.log_time < before_ns:  # this computer's clock was set back
            limit = RateLimit()
        self._limits[topic] = message.log_time, limit
        return limit.allows(message.log_time / NANOSECONDS)


def _because(text: str, *reasons: str | None) -> str:
    told = ", ".join(reason for reason in reasons if reason)
    return f"{text}; {told}" if told else text


def _named(kind: str, joints: Floats) -> dict[str, Any]:
    """Joints, rad and mm, by their names with units."""
    values = np.where(np.arange(5) == 2, joints, np.degrees(joints))
    if not np.isfinite(values).all():
        raise ValueError("joints that are no numbers")
    return {
        name.format(kind): round(value, _DECIMALS) for name, value in zip(Q, values.tolist(), strict=True)
    }


HANDLERS: Final[dict[str, tuple[type[LogRecord], Callable[[Streams, Any, Stored], Iterator[Viewed]]]]] = {
    AuditDecision.TOPIC: (AuditDecision, Streams.decision),
    AuditController.TOPIC: (AuditController, Streams.controller),
    AuditFault.TOPIC: (AuditFault, Streams.fault),
    AuditOperator.TOPIC: (AuditOperator, Streams.operator),
    AuditPermit.TOPIC: (AuditPermit, Streams.permit),
    AuditVerdict.TOPIC: (AuditVerdict, Streams.verdict),
    AuditSession.TOPIC: (AuditSession, Streams.session),
    AuditClose.TOPIC: (AuditClose, Streams.close),
    CanFrame.TOPIC: (CanFrame, Streams.frame),
    TrackingSample.TOPIC: (TrackingSample, Streams.tracking),
    LoopTiming.TOPIC: (LoopTiming, Streams.timing),
}
"""What becomes of each topic's records; the others are for reading, not for drawing."""
