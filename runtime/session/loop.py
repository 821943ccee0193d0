"""The session's loop: bus, clock, disk, worker and terminal wired to the interlock. It decides nothing.

One cycle: look at the clocks, read the bus, the disk, the worker and the terminal, feed the table, send the
heartbeat, flush. The heartbeat is the last act of a cycle in which the table was evaluated; nothing else sends it.
"""

import os
import select
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import assert_never

import can

from cutgate.config.terminal import CommandReader
from cutgate.protocol import records
from cutgate.protocol.cycle import Cycle
from cutgate.protocol.endpoint import RecordReceived, Sent, Undelivered
from cutgate.protocol.frames import (
    ControllerFault,
    ControllerHeartbeat,
    Progress,
    RuntimeHeartbeat,
    RuntimeStop,
)
from cutgate.protocol.link import Accepted, JointSample, Violation
from cutgate.protocol.path import PathHeader
from cutgate.protocol.port import Port
from cutgate.protocol.states import StopCause, StopCode, claimable
from cutgate.runtime.audit import names
from cutgate.runtime.audit.commit import Durable, LogFailed, Reserved
from cutgate.runtime.interlock.phases import ENDED, PHASES, STOPPING
from cutgate.runtime.interlock.state import (
    CommandGiven,
    Commit,
    Crowd,
    Dropped,
    Effect,
    Event,
    Failed,
    FaultReceived,
    Gone,
    HeartbeatLost,
    HeartbeatReceived,
    Interlock,
    JointsMeasured,
    LogChanged,
    LogHealth,
    OpenLink,
    OperatorCommand,
    Phase,
    ProgressReported,
    RecordDurable,
    Refused,
    SeekWitness,
    Send,
    SendBlock,
    SendStop,
    SendWithdraw,
    Tick,
    UseSession,
    VerdictReady,
    Verify,
    WithdrawalSent,
    Withheld,
    WitnessSought,
)
from cutgate.runtime.interlock.table import step
from cutgate.runtime.interlock.tracking import Deviation
from cutgate.runtime.session import events
from cutgate.runtime.session.check import Answer, Check, with_guidance
from cutgate.runtime.session.journal import Journal
from cutgate.runtime.session.pauses import Pauses
from cutgate.runtime.session.space import estimated_s
from cutgate.runtime.session.verifying import NotVerified, Verifying
from cutgate.runtime.session.view import View
from cutgate.runtime.session.witness import WitnessSearch
from cutgate.runtime.session.worker import Worker
from cutgate.runtime.verification.advice import Guidance

CHECK_HEARTBEATS = 1 / 8
"""So long does this side's own check hold up a cycle; its steps are far shorter."""
GUIDANCE_S = 5.0
"""So long is a move of the bone waited for, after the session; 2 s of processor time are given to its search."""


class Session:
    """One session with one controller.

    Args:
        state: the interlock with its job.
        check: this side's own verification of the job.
        port: this side of the bus.
        journal: the audit log.
        worker: the verification process.
        view: shows what happens.
        commands: the operator's terminal, None without one.
        log_id: the audit log's, 16 bytes.
        barrier_us: of a withdrawal, by how long ago the bone moved (``withdrawn.barrier``), since 1970, UTC.
        witness: looks up the log that the controller saw last.
        clock: monotonic seconds.
        random: the operating system's generator.
    """

    def __init__(
        self,
        state: Interlock,
        *,
        check: Check,
        port: Port,
        journal: Journal,
        worker: Worker,
        view: View,
        commands: CommandReader[OperatorCommand] | None = None,
        log_id: bytes,
        barrier_us: Callable[[int | None], int],
        witness: WitnessSearch,
        checkpoint_deadline_s: float,
        clock: Callable[[], float] = time.monotonic,
        random: Callable[[int], bytes] = os.urandom,
    ) -> None:
        self.state = state
        self.answer: Answer | None = None
        self.stopped_in: Phase | None = None
        """Where the session stood when it was stopped."""
        self._verifying = Verifying(check, worker)
        self._port = port
        self._journal = journal
        self._worker = worker
        self._view = view
        self._commands = commands
        self._log_id = log_id
        self._barrier_us = barrier_us
        self._withdrawn_us: int | None = None
        """Barrier of a Withdraw that the table has not been told of."""
        self._witness = witness
        self._checkpoint_deadline_s = checkpoint_deadline_s
        self._clock = clock
        self._random = random
        self._segments = PathHeader.of(state.job.path).count - 1
        self._cycle = Cycle(port, clock)
        self._pauses = Pauses(state.job.timing)
        self._crowd_told = False
        self._interrupted: str | None = None
        self._bus_error: can.CanError | None = None
        self._poller = select.poll()
        self._polls_worker = True

    @property
    def last_seen(self) -> tuple[tuple[int, int] | None, tuple[int, ...] | None]:
        """Progress and joints as last heard, whether or not in time; for telling only (``LastSeen``)."""
        session, seen = self.state.session, self._journal.last_seen
        return (None, None) if session is None else (seen.progress(session.tag), seen.joints_u(session.tag))

    # ------------------------------------------------------------ the loop

    def interrupt(self, signal: str = "") -> None:
        """Quit at the next cycle. Safe in a signal handler.

        Args:
            signal: its name, for the log; empty for Ctrl-C, which is the operator's own.
        """
        self._interrupted = signal

    def run(self, wake: int) -> Interlock:
        """Run cycles until the session has ended; its final state.

        Args:
            wake: descriptor that becomes readable when a signal has arrived.
        """
        self.begin(wake)
        try:
            while self.state.phase not in ENDED:
                self.run_cycle(self._waited(wake))
        finally:
            self._leave_last()
        return self.state

    def begin(self, wake: int) -> None:
        """Before the first cycle: what to wait for, space for the log, and the one look at the whole path."""
        for descriptor in (wake, self._port.bus.fileno(), self._journal.log.fileno(), self._worker.fileno()):
            self._poller.register(descriptor, select.POLLIN)
        if self._commands is not None and self._commands.descriptor is not None:
            self._poller.register(self._commands.descriptor, select.POLLIN)
        job = self.state.job
        needed = self._journal.reserve(estimated_s(job), job)
        self.state = replace(self.state, log=LogHealth(writable=True, needed_bytes=needed))
        _ = self.state.job.path_digest

    def _waited(self, wake: int) -> set[int]:
        """What can be read once something can, or the next cycle is due; an error in it is one of a cycle."""
        try:
            return self._wait(wake)
        except BaseException as error:
            self._give_up(error)
            raise

    @property
    def wait_s(self) -> float:
        """So long the next cycle may wait for something to arrive; 0 while this side's own check goes on."""
        return 0.0 if self._verifying.busy else self._cycle.wait_s()

    def _wait(self, wake: int) -> set[int]:
        return self.ready(wake, self.wait_s)

    def ready(self, wake: int, wait_s: float) -> set[int]:
        """Descriptors that can be read, as soon as any can.

        Args:
            wake: as for `run`.
            wait_s: for so long it is waited.
        """
        if self._polls_worker and not self._verifying.listening:
            self._polls_worker = False
            self._poller.unregister(self._worker.fileno())
        ready = {descriptor for descriptor, _ in self._poller.poll(wait_s * 1000.0)}
        if wake in ready:
            os.read(wake, 4096)
        return ready

    def run_cycle(self, ready: set[int]) -> None:
        """One cycle. Whatever goes wrong in it stops the session; what cannot be mended is raised after the stop.

        Args:
            ready: descriptors that can be read.
        """
        try:
            self._run_cycle(ready)
        except BaseException as error:
            self._give_up(error)
            raise

    def _run_cycle(self, ready: set[int]) -> None:
        cycle = self._cycle
        cycle.begin()
        self._pauses.cycle(cycle.gap_s, cycle.now_s)
        self._journal.telemetry.cycle(cycle.gap_s)
        self._journal.strangers.cycle(cycle.now_s)
        try:
            self._look_at_clocks()
            for item in cycle.read():
                self._item(item)
            self._read_disk(cycle.now_s)
            self._hear_witness()
            self._verdict(ready)
            self._read_commands(ready)
            beats = self._heartbeat()
            self._port.flush()
            if beats:  # behind it, so that it holds nothing up
                self._journal.timing(self._port.endpoint.link, cycle)
            self._go_on_verifying()
            if self._bus_error is not None:
                raise self._bus_error
        except can.CanError as error:
            self._bus_error = error
            self._feed(Gone(StopCause.BUS_FAILED, f"the bus failed: {error}"))

    def _give_up(self, error: BaseException) -> None:
        """The program itself failed: nothing that waits may leave, the stop does, and no heartbeat follows it."""
        event = Gone(StopCause.INTERNAL_ERROR, f"internal error: {type(error).__name__}: {error}")
        before = self.state
        with suppress(Exception):  # the log may be what fails
            self._void()
        self._port.endpoint.abort()
        try:
            effects = self._decide(event, self._clock())
            if not any(
                isinstance(effect, SendStop) for effect in effects
            ):  # it had ended, perhaps without a word
                self._stop_now(event.cause)
        except BaseException:  # noqa: BLE001 - the table or the journal are what fails: it ends without them
            self._end_without_the_table(before, event)

    def _end_without_the_table(self, before: Interlock, event: Gone) -> None:
        """The last resort. What disables waits for nothing; then the log is told, if it still takes anything."""
        if self.state.phase not in ENDED:
            cause = before.cause or event.cause
            ended = replace(before, phase=Phase.STOPPED, cause=cause, reason=event.reason)
            self.state = replace(ended, permit=None, nonce=None, tracking=None)
            self._note_stop(before)
        with suppress(Exception):  # without heartbeats the controller stops as well
            self._stop_now(event.cause)
        with suppress(Exception):  # the log will not be called clean
            self._journal.ended_without_the_table(before, self.state, event)

    def _stop_now(self, cause: StopCause) -> None:
        endpoint = self._port.endpoint
        if endpoint.link.is_open:
            endpoint.send_frame(RuntimeStop(StopCode.STOP, claimable(cause)), self._clock())
            self._leave_now()

    def _look_at_clocks(self) -> None:
        """Clocks first: a stalled loop, a lost peer, a late transfer, a slow disk, what the table waits for."""
        now_s = self._cycle.now_s
        for violation in self._cycle.late():
            lost = violation.cause is StopCause.HEARTBEAT_LOST
            paused_ms, crowd = self._lateness(now_s)
            told = f"{violation.detail}; {crowd}" if crowd else violation.detail
            failed = Failed(violation.cause, told)
            self._feed(HeartbeatLost(paused_ms, crowd) if lost else failed)
        if not self._journal.log.oldest_pending_s(now_s) <= self._checkpoint_deadline_s:
            reason = f"the disk has not answered for {self._checkpoint_deadline_s:g} s"
            self._feed(Failed(StopCause.AUDIT_FAILED, reason))
        self._tell_crowd(now_s)
        self._feed(Tick())

    def _tell_crowd(self, now_s: float) -> None:
        """Once, and also before there is a session that it could stop."""
        crowd = self._journal.strangers.crowd(now_s)
        if crowd is not None and not self._crowd_told:
            self._crowd_told = True
            self._view.note(str(crowd))

    def _lateness(self, now_s: float) -> tuple[int, Crowd | None]:
        """What a lost heartbeat may come of: how long this loop stood still, and who takes the bus."""
        return self._pauses.longest_ms(now_s), self._journal.strangers.crowd(now_s)

    # ------------------------------------------------------------ what arrives

    def _item(self, item: object) -> None:
        match item:
            case Accepted(frame=ControllerHeartbeat() as beat, fresh=fresh):
                # Before it is answered, the controller would refuse what is enabled on it.
                young = fresh and self._port.endpoint.link.answered
                self._feed(HeartbeatReceived(events.view_of(beat), young))
            case Accepted(sample=JointSample() as sample):
                self._feed(JointsMeasured(records.joints_to_counts(sample.joints), sample.measured_s))
            case Accepted(frame=ControllerFault() as fault):
                self._feed(FaultReceived(fault.code, fault.cause, *self._lateness(self._cycle.now_s)))
            case Accepted(frame=Progress() as progress):
                self._view.progress(progress.segment, self._segments)
                self._feed(ProgressReported(progress.segment, progress.fraction))
            case Violation():
                self._feed(Failed(item.cause, item.detail))
            case Undelivered():
                self._view.note(item.detail)
            case RecordReceived():
                self._journal.record_received(item)
                self._feed(events.of_record(item, self._random))

    def _read_disk(self, now_s: float) -> None:
        log = self._journal.log
        log.tick(now_s)
        for event in log.events():
            match event:
                case Durable(token=token, size=size, root=root) if token is not None:
                    self._feed(RecordDurable(token, records.TreeHead(self._log_id, size, root)))
                case LogFailed(reason=reason):
                    self._view.note(f"audit log: {reason}")
                    self._feed(LogChanged(replace(self.state.log, writable=False)))
                case Reserved(reservation=reservation):
                    if not reservation.reserved:
                        self._view.note(f"space for the audit log: {reservation.how}")
                    self._feed(LogChanged(replace(self.state.log, reserved_bytes=reservation.size)))

    def _hear_witness(self) -> None:
        """Whether the log that the controller saw last is here: recorded, and shown where it is not."""
        found, opened = self._witness.answer(), self.state.opened
        if found is None or opened is None:
            return
        self._journal.witness(opened.log, found)
        if found.log is None:
            self._view.note(f"the log that the controller saw last, at a start, is not found: {found.reason}")
        text = found.reason if found.log is None else "; ".join(filter(None, (found.log, found.reason)))
        self._feed(WitnessSought(found.log is not None, text))

    def _verdict(self, ready: set[int]) -> None:
        """What the verification process says; and the verdict, once it is known on both sides."""
        if self._verifying.listening and self._worker.fileno() in ready:
            self._found(self._verifying.hear())
        self._found(self._verifying.agreed())

    def _found(self, found: Answer | NotVerified | None) -> None:
        match found:
            case Answer():
                self._keep(found)
                self._feed(VerdictReady(found.verdict))
            case NotVerified(reason=reason):
                self._feed(Failed(StopCause.INTERNAL_ERROR, f"verification failed: {reason}"))

    def _go_on_verifying(self) -> None:
        """Some steps of this side's own check: a small part of a heartbeat, when the cycle's work is done."""
        until_s = self._clock() + CHECK_HEARTBEATS * self._port.endpoint.link.heartbeat_s
        match self._verifying.go_on(self._clock, until_s):
            case Answer() as own:
                self._reserve(own)
            case otherwise:
                self._found(otherwise)

    def _reserve(self, own: Answer) -> None:
        """Space for what an admissible verdict brings from now on; if it is more than was asked for, it is waited for."""
        trajectory, session, log = own.verdict.trajectory, self.state.session, self.state.log
        if trajectory is None or session is None:
            return
        needed = self._journal.reserve(trajectory.end_s / session.time_scale, self.state.job)
        reserved = log.reserved_bytes if needed <= log.needed_bytes else 0
        self._feed(LogChanged(replace(log, reserved_bytes=reserved, needed_bytes=needed)))

    def _keep(self, answer: Answer) -> None:
        """The verdict: recorded and shown."""
        self.answer = answer
        if answer.proof is not None:
            self._journal.log.attach(names.PROOF, "application/octet-stream", answer.proof)
        self._journal.verdict(answer.document, self.state.job.tool, answer.verdict.reason)
        if answer.approach_document is not None:
            self._journal.approach(
                answer.approach_document,
                answer.verdict.start_joints_u,
                answer.verdict.approach,
                answer.verdict.approach_reason,
            )
        self._view.verdict(answer)

    def guidance(self, wake: int, timeout_s: float = GUIDANCE_S) -> None:
        """After a session that ended for an inadmissible cut: where to move the bone, if that is found in time.

        Args:
            wake: as for `run`; whoever wants to leave is not kept.
            timeout_s: for so long it is waited.
        """
        answer = self.answer
        if answer is None or answer.verdict.admissible:
            return
        self._view.note("looking for the smallest move of the bone")
        told = self._verifying.guided(wake, timeout_s, answer.verdict.request)
        found: Guidance | None = None
        if isinstance(told, NotVerified):
            note = told.reason
        else:
            found = None if told.guidance is None else told.guidance.value
            note = "nothing is known that could be said"
        self.answer = with_guidance(answer, found, note)
        self._journal.guidance(self.answer.document)
        self._view.guidance(found, note)

    def _read_commands(self, ready: set[int]) -> None:
        if self._interrupted is not None:
            signal, self._interrupted = self._interrupted, None
            self._feed(CommandGiven(OperatorCommand.QUIT, signal))
        commands = self._commands
        if commands is None or commands.descriptor not in ready:
            return
        descriptor = commands.descriptor
        for text in commands.read():
            given = events.of_operator(text)
            if given is not None:
                self._feed(given)
            else:
                self._view.note(f"{text!r} is no command here; say one of {', '.join(OperatorCommand)}")
        if commands.descriptor is None and descriptor is not None:
            self._poller.unregister(descriptor)

    # ------------------------------------------------------------ the table and its effects

    def _feed(self, event: Event) -> None:
        before, now_s = self.state, self._clock()
        effects = self._decide(event, now_s)
        self._view.step(before, event, self.state, effects, now_s)
        if self._withdrawn_us is not None:
            told, self._withdrawn_us = WithdrawalSent(self._withdrawn_us), None
            self._feed(told)

    def _decide(self, event: Event, now_s: float) -> tuple[Effect, ...]:
        """One step of the table, carried out and recorded; nothing else changes the phase."""
        before = self.state
        self.state, effects = step(before, event, now_s)
        self._note_stop(before)
        effects = tuple(self._carry_out(effect) for effect in effects)
        self._journal.step(before, event, self.state, effects, now_s)
        return effects

    def _note_stop(self, before: Interlock) -> None:
        if before.phase not in STOPPING and self.state.phase in STOPPING:
            self.stopped_in = before.phase

    def _carry_out(self, effect: Effect) -> Effect:
        """Do it; as it was done: what was signed on its way out has its code."""
        endpoint, now_s = self._port.endpoint, self._clock()
        match effect:
            case SendStop():
                self._send_stop(effect)
            case Send(record=record):
                sent = self._send(record)
                return Send(sent.record, sent.sequence)
            case SendBlock(index=index):
                self._send(records.path_block(self.state.job.path, index))
            case SendWithdraw():
                self._send(self._withdraw(effect))
            case SeekWitness(log=log):
                self._witness.begin(log)
            case UseSession(session=session):
                endpoint.use_session(session.digest)
            case OpenLink():
                endpoint.open_link(now_s)
                self._cycle.next_heartbeat_s = now_s
            case Verify():
                self._verify(effect)
            case Commit() | Withheld() | Refused() | Dropped() | Deviation():
                pass  # the journal's business
            case _:
                assert_never(effect)
        return effect

    def _send_stop(self, effect: SendStop) -> None:
        endpoint = self._port.endpoint
        self._void()  # a permit that waits behind the stop must not follow it
        if endpoint.link.is_open:
            endpoint.send_frame(RuntimeStop(effect.code, claimable(effect.cause)), self._clock())
            self._leave_now()

    def _withdraw(self, effect: SendWithdraw) -> records.Withdraw:
        """With its barrier, of which the table is told behind this step; one that hangs gives way to it."""
        self._void()
        self._withdrawn_us = self._barrier_us(effect.motion_age_s)
        return records.Withdraw(effect.place, self._withdrawn_us)

    def _void(self) -> None:
        """Nothing that waits may leave; the log says so of what it called sent."""
        if self._port.endpoint.control_waits:
            self._journal.voided()
        self._port.endpoint.stop_sending()

    def _leave_now(self) -> None:
        """A bus that fails here stops this cycle, after the step that ordered it is recorded."""
        self._bus_error = self._port.leave_now() or self._bus_error

    def _leave_last(self) -> None:
        """No cycle follows: a stop or end that waits for room on the bus is tried for a bounded time."""
        with suppress(can.CanError):  # the controller finds out by the missing heartbeat
            self._port.flush_last()

    def _send(self, record: records.Record) -> Sent:
        """The record as it leaves, with its code."""
        session = None
        if isinstance(record, records.Open):  # one sent before may wait for a flow control that never comes
            self._port.endpoint.stop_sending()
            session = 0
        sent = self._port.endpoint.send_record(record, self._clock(), session=session)
        self._journal.record_sent(sent)
        return sent

    def _verify(self, wanted: Verify) -> None:
        """What is proved is what the controller reported and what was uploaded."""
        held = self.state.collected
        assert held.limits is not None and held.calibration is not None and held.tool is not None  # noqa: S101, PT018
        attached = (
            (names.LIMITS, held.limits),
            (names.CALIBRATION, held.calibration),
            (names.TOOL, held.tool),
        )
        for name, data in attached:
            self._journal.log.attach(name, "application/octet-stream", data)
        self._verifying.begin(wanted, held)

    def _heartbeat(self) -> bool:
        """What leaves was made in this cycle; whether one was made."""
        endpoint, state = self._port.endpoint, self.state
        due = self._cycle.heartbeat_due() and endpoint.link.is_open
        if due:
            beat = RuntimeHeartbeat(PHASES[state.phase].heartbeat, state.epoch, state.told(state.cause))
            endpoint.send_frame(beat, self._cycle.now_s)
        return due
