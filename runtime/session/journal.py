"""Steps of the interlock as audit records: what is written, and when it is handed to the disk."""

import os
import sys
from collections.abc import Callable
from typing import Any, Literal

from cutgate.protocol import candump, records
from cutgate.protocol.cycle import Cycle
from cutgate.protocol.differences import differences
from cutgate.protocol.endpoint import RecordReceived, Sent
from cutgate.protocol.frames import BULK_IDS, CONTROL_IDS
from cutgate.protocol.link import Link, Statistics
from cutgate.protocol.port import Passed
from cutgate.protocol.records import Timing
from cutgate.protocol.states import Purpose, Refusal, StopCause
from cutgate.runtime.audit import names
from cutgate.runtime.audit import records as audit
from cutgate.runtime.audit.log import AuditLog, Paths
from cutgate.runtime.audit.witness import WitnessFound
from cutgate.runtime.interlock.permissives import evaluate, utc
from cutgate.runtime.interlock.phases import PHASES
from cutgate.runtime.interlock.state import (
    Announced,
    BlockConfirmed,
    CommandGiven,
    Commit,
    ControllerView,
    Dropped,
    Effect,
    Event,
    Failed,
    FaultReceived,
    Gone,
    HeartbeatLost,
    HeartbeatReceived,
    Interlock,
    Job,
    JointsMeasured,
    LogChanged,
    NonceReceived,
    OtherVersionAnnounced,
    ParameterReceived,
    PathConfirmed,
    Phase,
    ProgressReported,
    RecordDurable,
    Refused,
    ReplyReceived,
    Send,
    SendBlock,
    SendStop,
    SendWithdraw,
    SessionOpened,
    Tick,
    VerdictReady,
    WithdrawalSent,
    Withheld,
    WitnessSought,
)
from cutgate.runtime.interlock.tracking import Deviation
from cutgate.runtime.review.last_seen import LastSeen
from cutgate.runtime.session.job import VERIFIER
from cutgate.runtime.session.space import space, waiting_s
from cutgate.runtime.session.strangers import Strangers
from cutgate.runtime.session.telemetry import Telemetry

Kind = Literal["permit", "start", "reset"]

ATTACHED = {"limits": names.LIMITS, "calibration": names.CALIBRATION, "tool": names.TOOL}

QUIET = (HeartbeatReceived, JointsMeasured, ProgressReported, Tick)
"""Events that are recorded only when they change the phase or order something."""

TRANSFER_FRAMES = frozenset((*CONTROL_IDS, *BULK_IDS))
"""Recorded as whole records; their frames are in the candump log."""

KINDS: dict[Purpose, Kind] = {Purpose.PERMIT: "permit", Purpose.START: "start", Purpose.RESET: "reset"}
SIGNED: dict[type[records.Record], Kind] = {
    records.Permit: "permit",
    records.Start: "start",
    records.Reset: "reset",
}
BY_TYPE = {kind.TYPE: name for kind, name in SIGNED.items()}
REQUESTS = {
    **BY_TYPE,
    records.Open.TYPE: "open",
    records.Acknowledge.TYPE: "acknowledge",
    records.Withdraw.TYPE: "withdraw",
}
"""What is answered by a Reply."""
SHOWN: dict[Phase, tuple[Kind, frozenset[Phase]]] = {
    Phase.PERMITTING: ("permit", frozenset({Phase.PERMITTED})),
    Phase.STARTING: ("start", frozenset({Phase.CUTTING, Phase.FINISHING})),
    Phase.RESETTING: ("reset", frozenset({Phase.HELD, Phase.COLLECTING})),
}
"""Where a heartbeat shows that the controller has accepted what was sent, and where the session goes on then."""
CLAIMED = "claimed: a fault frame carries no code"


def plain(text: str) -> str:
    """Text that every file can hold: names of files and messages of errors may carry bytes that are no UTF-8."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


NAMES: dict[type, Callable[[Any], str]] = {
    Announced: lambda _: "controller announced",
    OtherVersionAnnounced: lambda e: f"controller of protocol version {e.version} announced",
    SessionOpened: lambda e: "session opened" if e.authentic else "session called open, with a wrong code",
    WitnessSought: lambda e: f"controller's witness {'found' if e.found else 'not found'}",
    ParameterReceived: lambda e: f"{type(e.record).__name__.lower()} received",
    BlockConfirmed: lambda _: "path block stored",
    PathConfirmed: lambda _: "path stored",
    VerdictReady: lambda e: "verdict admissible" if e.verdict.admissible else "verdict inadmissible",
    NonceReceived: lambda e: f"nonce for {KINDS[e.purpose]}",
    ReplyReceived: lambda e: f"reply {e.refusal.name} to {REQUESTS.get(e.request_type, hex(e.request_type))}",
    HeartbeatReceived: lambda _: "heartbeat",
    HeartbeatLost: lambda _: "heartbeat lost",
    FaultReceived: lambda _: "controller's fault",
    JointsMeasured: lambda _: "joints measured",
    ProgressReported: lambda _: "progress reported",
    RecordDurable: lambda _: "record durable",
    WithdrawalSent: lambda _: "withdrawal sent",
    LogChanged: lambda _: "log's health",
    Failed: lambda e: f"failed {e.cause.name}",
    Gone: lambda e: f"gave up {e.cause.name}",
    CommandGiven: lambda e: f"said {e.command} {plain(e.what)}".strip(),
    Tick: lambda _: "time passed",
}
"""What each event is called in the log."""


class Journal:
    """Writes what happens to the log. It decides nothing and waits for nothing.

    Args:
        log: the session's log.
        interface: the bus's name in the candump file.
        timing: the session's.
    """

    def __init__(self, log: AuditLog, interface: str, timing: Timing) -> None:
        self.log = log
        self.strangers = Strangers(timing)
        self.last_seen = LastSeen()
        self.telemetry = Telemetry()
        self._interface = plain(interface)
        self._sequence = 0
        self._view: ControllerView | None = None
        self._authorised: Kind = "permit"
        self._sent: tuple[Kind, int | None] | None = None
        """What was sent last and has not been answered."""
        self._open = self._opened = b""
        """The OPEN that was sent last, and the OPENED that came last, as they crossed the bus."""

    # ------------------------------------------------------------ decisions

    def step(
        self, before: Interlock, event: Event, after: Interlock, effects: tuple[Effect, ...], now_s: float
    ) -> None:
        """Record one step, if it changed anything that matters; and each sample of the moving arm, as it was judged."""
        sample = self.telemetry.tracking(before, after, now_s)
        if sample is not None:
            self.log.write(sample)
        self._facts(before, event, after, effects)
        self._controller(event)
        if isinstance(event, QUIET) and before.phase is after.phase and not effects:
            return
        for effect in effects:
            self._signed(effect, after)
        self._decision(before, event, after, effects, now_s)
        for effect in effects:
            if isinstance(effect, Commit):
                self.log.commit(effect.token)

    def _decision(
        self, before: Interlock, event: Event, after: Interlock, effects: tuple[Effect, ...], now_s: float
    ) -> None:
        self._sequence += 1
        commit = next((effect for effect in effects if isinstance(effect, Commit)), None)
        shown = evaluate(PHASES[before.phase].permissives, after, now_s) if after.collected.complete else ()
        deviation = next((effect for effect in effects if isinstance(effect, Deviation)), None)
        shown = deviation.judged if deviation else shown
        self.log.write(
            audit.AuditDecision(
                sequence=self._sequence,
                session=after.session.digest.hex() if after.session else None,
                event=NAMES[type(event)](event),
                from_state=before.phase,
                to_state=after.phase,
                disposition="acknowledged" if _shown(before, event, after) else _disposition(effects),
                effects=tuple(effect_name(effect) for effect in effects),
                permissives=tuple(audit.PermissiveValue.of(permissive) for permissive in shown),
                first_out=None if after.cause is StopCause.NONE else after.cause.name,
                reason=plain(_reason(event, effects) or after.reason) or None,
                token=commit.token if commit else None,
            )
        )

    def voided(self) -> None:
        """The permit, start or reset that was sent last has not left whole, and never will."""
        if self._sent is not None:
            kind, token = self._sent
            reason = "void: it had not left the transmit queue when a stop was ordered"
            self.log.write(audit.AuditPermit(kind=kind, stage="withheld", token=token, reason=reason))
        self._sent = None

    def ended_without_the_table(self, before: Interlock, after: Interlock, event: Gone) -> None:
        """Record the end where the table, or `step` above, is what failed: nothing is asked, nothing evaluated."""
        self._fault(event.cause, event.reason)
        self._sequence += 1
        self.log.write(
            audit.AuditDecision(
                sequence=self._sequence,
                event=NAMES[Gone](event),
                from_state=before.phase,
                to_state=after.phase,
                disposition="decided",
                first_out=after.cause.name,
                reason=plain(f"without the table: {event.reason}"),
            )
        )

    def _signed(self, effect: Effect, after: Interlock) -> None:
        """The way of a permit, start or reset: authorised, sent or withheld."""
        match effect:
            case Commit(token=token, purpose=purpose, record=record):
                self._authorised = KINDS[purpose]
                self.log.write(_permit_record(record, stage="authorised", token=token))
            case Send(record=record, sequence=sequence) if type(record) in SIGNED:
                sent = _permit_record(record, stage="sent", token=after.token, sequence=sequence)
                self.log.write(sent)
                self._sent = (sent.kind, after.token)
            case SendWithdraw():
                self._sent = None  # what waits from now on is this
            case Withheld(token=token):
                self.log.write(
                    audit.AuditPermit(
                        kind=self._authorised,
                        stage="withheld",
                        token=token,
                        reason=plain(after.reason) or None,
                    )
                )

    # ------------------------------------------------------------ facts

    def _facts(self, before: Interlock, event: Event, after: Interlock, effects: tuple[Effect, ...]) -> None:
        shown = _shown(before, event, after)
        if shown is not None:
            self._sent = None
            self.log.write(audit.AuditPermit(kind=shown, stage="acknowledged"))
        match event:
            case SessionOpened() if after.opened is not before.opened:
                self._session(after)
            case ParameterReceived(record=record):
                self._collected(before, record)
            case ReplyReceived() if event.request_type in BY_TYPE and event.refusal is not Refusal.ACCEPTED:
                self._sent = None
                kind = BY_TYPE[event.request_type]
                self.log.write(audit.AuditPermit(kind=kind, stage="refused", reply=event.refusal.name))
            case FaultReceived():
                self.log.write(
                    audit.AuditFault(
                        source="controller", code=event.code.name, cause=event.cause.name, detail=CLAIMED
                    )
                )
            case Failed() | Gone():
                self._fault(event.cause, event.reason)
            case CommandGiven(command=command, what=what):
                refused = next((effect.reason for effect in effects if isinstance(effect, Refused)), None)
                reason = None if refused is None else plain(refused)
                self.log.write(
                    audit.AuditOperator(
                        word=command, what=plain(what) or None, accepted=refused is None, reason=reason
                    )
                )
        for effect in effects:
            if isinstance(effect, Deviation):
                self._fault(StopCause.TRACKING_DEVIATION, effect.reason)

    def _session(self, opened: Interlock) -> None:
        """What the session was opened with, on both sides: with it and the key every code can be checked later."""
        assert opened.session is not None  # noqa: S101 - it is open
        self.log.write(
            audit.AuditSession(
                session=opened.session.digest.hex(),
                open=self._open.hex(),
                opened=self._opened.hex(),
                key_fingerprint=opened.job.key_fingerprint or None,
            )
        )

    def _fault(self, cause: StopCause, reason: str) -> None:
        """What this side itself has found."""
        self.log.write(
            audit.AuditFault(source="runtime", code="STOP", cause=cause.name, detail=plain(reason))
        )

    def _collected(self, before: Interlock, record: records.Record) -> None:
        data, job = record.body(), before.job
        kind, approved = {
            records.Limits.TYPE: ("limits", job.limits),
            records.Calibration.TYPE: ("calibration", job.calibration),
            records.Tool.TYPE: ("tool", job.tool),
        }[record.TYPE]
        matches = data == approved
        unequal = () if matches else differences(record, type(record).parse(approved))  # type: ignore[arg-type]
        if not matches and getattr(before.collected, kind) is None:
            # Nothing will be verified with them, and what they were is what decided.
            self.log.attach(ATTACHED[kind], "application/octet-stream", data)
        self.log.write(
            audit.AuditCollected(
                kind=kind,  # type: ignore[arg-type]
                sha256=records.digest(data).hex(),
                matches_approved=matches,
                difference="; ".join(unequal) or None,
            )
        )

    def _controller(self, event: Event) -> None:
        """The controller's state, whenever its heartbeat shows another."""
        if not isinstance(event, HeartbeatReceived) or event.view == self._view:
            return
        self._view = event.view
        self.log.write(
            audit.AuditController(
                state=event.view.state.name,
                cause=event.view.cause.name,
                epoch=event.view.epoch,
                device_pressed=event.view.device_pressed,
                emergency_stop_clear=event.view.emergency_stop_clear,
                cutting_mode=event.view.cutting_mode,
                fresh=event.fresh,
            )
        )

    def witness(self, log: records.TreeHead, found: WitnessFound) -> None:
        """Whether the log that the controller saw last is here."""
        self.log.write(
            audit.AuditWitness(
                log_id=log.log_id.hex(),
                log_size=log.size,
                log_root=log.root.hex(),
                found=found.log is not None,
                log=found.log,
                reason=plain(found.reason) or None,
            )
        )

    def verdict(self, document: dict[str, Any], tool: bytes, reason: str) -> None:
        """The verdict and each boundary's worst place."""
        self.log.write(
            audit.AuditVerdict.of(
                document, verifier=VERIFIER, tool_sha256=records.digest(tool).hex(), reason=reason
            )
        )
        for boundary in audit.boundaries_of(document):
            self.log.write(boundary)

    def guidance(self, document: dict[str, Any]) -> None:
        """Where to move the bone, once the verdict's document says it, or why it does not."""
        self.log.write(audit.AuditGuidance.of(document))

    def approach(
        self,
        document: dict[str, Any],
        start_joints_u: tuple[int, ...],
        bound: records.Approach | None,
        reason: str,
    ) -> None:
        """The verdict on approach and retract, and what a permit binds of them."""
        self.log.write(
            audit.AuditApproach.of(document, start_joints_u=start_joints_u, bound=bound, reason=reason)
        )

    def reserve(self, seconds: float, job: Job) -> int:
        """Ask for twice the space that a session takes from its verdict on; the bytes that it takes once.

        Args:
            seconds: of the arm's way, on the clock.
            job: the session's.
        """
        seconds += waiting_s(job)
        needed = space(
            seconds, job.timing, chunk_period_s=self.log.hand_over_after_s, interface=self._interface
        )
        self.log.reserve(2 * needed.log, 2 * needed.frames)
        return needed.total

    def close(self, state: Interlock, verdict: str | None, counted: Statistics, *, clean: bool) -> Paths:
        """End the log with the session's last state; waits for the disk for a bounded time.

        Args:
            state: the interlock's last state.
            verdict: the verdict in one word, None if there was none.
            counted: by the link, of the controller's frames.
            clean: the session ended as the table ordered, not by an error of the program.
        """
        return self.log.close(
            final_state=state.phase,
            verdict=verdict,
            outcome=plain(state.reason) or state.phase,
            clean=clean,
            bus=audit.BusCounts.of(counted),
        )

    def processes(self, worker_pid: int) -> None:
        """Who takes part, by process number."""
        self.log.write(audit.AuditProcess(role="runtime", pid=os.getpid(), argv=tuple(map(plain, sys.argv))))
        self.log.write(audit.AuditProcess(role="verifier", pid=worker_pid))

    # ------------------------------------------------------------ the bus

    def timing(self, link: Link, cycle: Cycle) -> None:
        """How loop, bus and disk keep their time, in a cycle that has sent a heartbeat."""
        found = self.telemetry.timing(link, cycle, self.log)
        if found is not None:
            self.log.write(found)

    def frame(self, passed: Passed) -> None:
        """One frame that passed the bus; transfers' frames go to the candump file only."""
        if passed.direction == "received" and not passed.is_error:
            self.strangers.frame(passed.can_id, is_extended=passed.is_extended)
            if not (passed.is_extended or passed.is_remote):
                self.last_seen.frame(passed.can_id, passed.data)
        utc_ns = self.log.utc_ns()
        line = candump.line(
            utc_ns,
            self._interface,
            passed.can_id,
            passed.data,
            is_extended=passed.is_extended,
            is_remote=passed.is_remote,
            is_error=passed.is_error,
            is_fd=passed.is_fd,
            bit_rate_switch=passed.bit_rate_switch,
        )
        self.log.raw_frame(line.encode())
        if passed.can_id in TRANSFER_FRAMES and not (passed.is_extended or passed.is_error):
            return
        self.log.write(
            audit.CanFrame(
                stamp=audit.Time.of(utc_ns),
                direction=passed.direction,
                id=passed.can_id,
                is_rtr=passed.is_remote,
                is_extended=passed.is_extended,
                is_error=passed.is_error,
                dlc=len(passed.data),
                data=passed.data.hex(),
            ),
            log_time_ns=utc_ns,
        )

    def record_received(self, item: RecordReceived) -> None:
        """One whole record from the controller."""
        if isinstance(item.record, records.Opened):
            self._opened = records.pack(item.record, item.session, item.sequence)
        self._transfer("received", item.record, item.size, item.digest)

    def record_sent(self, sent: Sent) -> None:
        """One whole record to the controller."""
        if isinstance(sent.record, records.Open):
            self._open = sent.payload
        self._transfer("sent", sent.record, len(sent.payload), records.digest(sent.payload))

    def _transfer(self, direction: str, record: records.Record, length: int, digest: bytes) -> None:
        self.log.write(
            audit.CanTransfer(
                stamp=audit.Time.of(self.log.utc_ns()),
                direction=direction,  # type: ignore[arg-type]
                channel=record.CHANNEL.name.lower(),
                record=type(record).__name__,
                length=length,
                sha256=digest.hex(),
            )
        )


def _permit_record(
    record: records.Record, *, stage: audit.Stage, token: int, sequence: int | None = None
) -> audit.AuditPermit:
    kind = SIGNED[type(record)]
    digests: dict[str, str] = {}
    if isinstance(record, records.Permit):
        digests = {
            f"{name}_sha256": getattr(record, f"{name}_digest").hex()
            for name in ("path", "limits", "calibration", "tool", "registration", "configuration")
        }
    sent: dict[str, Any] = {}
    if stage == "sent":
        sent |= {"code": record.code.hex(), "sequence": sequence}  # type: ignore[attr-defined]
        if isinstance(record, records.Permit | records.Start):
            sent |= {"log_size": record.log.size, "log_root": record.log.root.hex()}
    return audit.AuditPermit(
        kind=kind,
        stage=stage,
        token=token,
        nonce=record.nonce.hex(),  # type: ignore[attr-defined]
        record=record.canonical().hex(),  # type: ignore[attr-defined]
        **digests,  # type: ignore[arg-type]
        **sent,
    )


def _shown(before: Interlock, event: Event, after: Interlock) -> Kind | None:
    """What the controller's heartbeat shows here to be accepted: permit, start or reset."""
    kind, following = SHOWN.get(before.phase, (None, frozenset()))
    return kind if isinstance(event, HeartbeatReceived) and after.phase in following else None


def _disposition(effects: tuple[Effect, ...]) -> audit.Disposition:
    kinds = {type(effect) for effect in effects}
    if Commit in kinds:
        return "authorised"
    if Withheld in kinds:
        return "withheld"
    if any(isinstance(effect, Send) and type(effect.record) in SIGNED for effect in effects):
        return "sent"
    return "decided"


def effect_name(effect: Effect) -> str:
    """What an effect is called in the log."""
    match effect:
        case Send(record=record):
            return f"send {type(record).__name__}"
        case SendStop():
            return f"send {effect.code.name} {effect.cause.name}"
        case SendBlock(index=index):
            return f"send path block {index}"
        case SendWithdraw():
            return "send Withdraw"
        case Commit():
            return f"commit {KINDS[effect.purpose]} as record {effect.token}"
    return type(effect).__name__


def simulation(announce: records.Announce) -> str:
    """What a controller says of its plant that only a simulated one may, else nothing."""
    if announce.time_scale == 1.0:
        return ""
    return f"; simulation only: its plant runs {announce.time_scale:g} times as fast as the clock"


def _reason(event: Event, effects: tuple[Effect, ...]) -> str:
    """What a person wants to read beside the step."""
    for effect in effects:
        match effect:
            case Refused():
                return effect.reason
            case Dropped():
                return f"dropped {effect.what}"
    return _told(event)


def _told(event: Event) -> str:
    """What the event says for itself."""
    match event:
        case Announced(announce=announce):
            return (
                f"controller {announce.serial}, firmware {announce.firmware_version}, "
                f"protocol {announce.protocol_version}{simulation(announce)}"
            )
        case VerdictReady():
            return event.verdict.reason
        case WitnessSought():
            return event.text
        case WithdrawalSent():
            return f"only a registration later than {utc(event.barrier_us)} counts from now on"
        case Gone():
            return event.reason
    return ""
