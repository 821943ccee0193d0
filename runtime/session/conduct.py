"""One session from its beginning to its closed log: its parts put together, run and ended whatever happens."""

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime

import can

from cutgate.config.terminal import CommandReader, typed
from cutgate.protocol.endpoint import Endpoint
from cutgate.protocol.port import Port
from cutgate.protocol.records import Side
from cutgate.protocol.times import since_1970_us
from cutgate.runtime.audit.log import AuditLog, Paths
from cutgate.runtime.interlock.state import Interlock, OperatorCommand
from cutgate.runtime.session.check import Check
from cutgate.runtime.session.interruption import Signals
from cutgate.runtime.session.job import InputFiles, utc_now
from cutgate.runtime.session.journal import Journal
from cutgate.runtime.session.loop import Session
from cutgate.runtime.session.view import View
from cutgate.runtime.session.withdrawal import list_withdrawal, of_session
from cutgate.runtime.session.withdrawn import Withdrawal, barrier
from cutgate.runtime.session.witness import WitnessSearch
from cutgate.runtime.session.worker import Worker


@dataclass(frozen=True)
class Given:
    """What a session is begun with.

    Attributes:
        files: what was read.
        check: the verification of the cut.
        state: where the session begins.
        key: the pre-shared key, 32 bytes.
        bus: an open python-can bus.
        bus_name: interface and channel.
        log: the session's.
        log_id: of the log, 16 bytes.
        listed: every withdrawal that this site knows of.
        fd: bulk records in CAN FD frames.
    """

    files: InputFiles
    check: Check
    state: Interlock
    key: bytes
    bus: can.BusABC
    bus_name: str
    log: AuditLog
    log_id: bytes
    listed: Sequence[Withdrawal]
    fd: bool


@dataclass(frozen=True)
class Conducted:
    """A session, not begun, with what is ended with it.

    Attributes:
        session: itself.
        port: its side of the bus.
        worker: what verifies the path beside its loop.
    """

    session: Session
    port: Port
    worker: Worker
    _given: Given
    _journal: Journal

    def begin(self) -> None:
        """The log is told which processes there are."""
        self._journal.processes(self.worker.pid)

    def close(self, view: View, *, clean: bool) -> Paths:
        """What it has withdrawn is listed, the worker ended, the log closed."""
        session, log, files = self.session, self._given.log, self._given.files
        try:
            for entry in of_session(
                session.state, log.path.name, files.registration, files.settings.clock_skew_s
            ):
                list_withdrawal(log, entry, view.note)
        finally:
            self.worker.close()
        verdict = session.answer.document["verdict"] if session.answer else None
        return self._journal.close(session.state, verdict, self.port.endpoint.link.statistics, clean=clean)


def put_together(
    given: Given,
    view: View,
    worker: Worker,
    witness: WitnessSearch,
    commands: CommandReader[OperatorCommand] | None,
    *,
    now: Callable[[], datetime] = utc_now,
    clock: Callable[[], float] = time.monotonic,
    random: Callable[[int], bytes] = os.urandom,
) -> Conducted:
    """A session of its parts.

    Args:
        given: what it is begun with.
        view: shows what happens.
        worker: what verifies the path beside its loop.
        witness: looks up the log that the controller saw last.
        commands: the operator's terminal, None without one.
        now: the time of day, aware.
        clock: monotonic seconds.
        random: a generator of bytes.
    """
    files, job = given.files, given.state.job
    channel = given.bus_name.partition("/")[2].rpartition("/")[2] or "can0"
    journal = Journal(given.log, channel, job.timing)
    endpoint = Endpoint(
        Side.RUNTIME,
        given.key,
        heartbeat_s=job.timing.heartbeat_s,
        timeout_s=job.timing.timeout_s,
        transfer_timeout_s=job.deadlines.reply_timeout_s,
        fd=given.fd,
    )

    def barrier_us(motion_age_s: int | None) -> int:
        skew_s = files.settings.clock_skew_s
        return since_1970_us(barrier(now(), motion_age_s, files.registration, given.listed, skew_s))

    port = Port(given.bus, endpoint, journal.frame)
    session = Session(
        given.state,
        check=given.check,
        port=port,
        journal=journal,
        worker=worker,
        view=view,
        commands=commands,
        log_id=given.log_id,
        barrier_us=barrier_us,
        witness=witness,
        checkpoint_deadline_s=files.settings.log.checkpoint_deadline_ms / 1000,
        clock=clock,
        random=random,
    )
    return Conducted(session, port, worker, given, journal)


def conduct(given: Given, view: View, signals: Signals) -> tuple[Session, Paths]:
    """Run one session; the log is closed and the worker ended whatever happens.

    Args:
        given: what it is begun with.
        view: shows what happens.
        signals: what interrupts it.

    Raises:
        OSError: the verification process cannot be started; the log is closed.
    """
    state, log = given.state, given.log
    try:
        worker = Worker.start(state.job.path)
    except OSError:
        log.close(final_state=state.phase, outcome="the verification process cannot be started", clean=False)
        raise
    witness = WitnessSearch(log.path.parent)
    conducted = put_together(given, view, worker, witness, typed(OperatorCommand))
    clean, session = False, conducted.session
    signals.interrupts(session)
    try:
        conducted.begin()
        session.run(signals.wake)
        clean = True
        session.guidance(signals.wake)
    finally:
        paths = conducted.close(view, clean=clean)
    return session, paths
