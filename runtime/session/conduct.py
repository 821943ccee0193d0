"""One session from its beginning to its closed log: its parts put together, run and ended whatever happens."""

from collections.abc import Sequence

import can

from cutgate.config.terminal import typed
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


def conduct(
    files: InputFiles,
    check: Check,
    state: Interlock,
    key: bytes,
    bus: can.BusABC,
    bus_name: str,
    log: AuditLog,
    view: View,
    signals: Signals,
    *,
    log_id: bytes,
    listed: Sequence[Withdrawal],
    fd: bool,
) -> tuple[Session, Paths]:
    """Run one session; the log is closed and the worker ended whatever happens.

    Args:
        files: what was read.
        check: the verification of the cut.
        state: where the session begins.
        key: the pre-shared key, 32 bytes.
        bus: an open python-can bus.
        bus_name: interface and channel.
        log: the session's.
        view: shows what happens.
        signals: what interrupts it.
        log_id: of the log, 16 bytes.
        listed: every withdrawal that this site knows of.
        fd: bulk records in CAN FD frames.

    Raises:
        OSError: the verification process cannot be started; the log is closed.
    """
    timing = state.job.timing
    journal = Journal(log, bus_name.partition("/")[2].rpartition("/")[2] or "can0")
    endpoint = Endpoint(
        Side.RUNTIME,
        key,
        heartbeat_s=timing.heartbeat_s,
        timeout_s=timing.timeout_s,
        transfer_timeout_s=state.job.deadlines.reply_timeout_s,
        fd=fd,
    )
    try:
        worker = Worker.start(state.job.path)
    except OSError:
        log.close(final_state=state.phase, outcome="the verification process cannot be started", clean=False)
        raise
    skew_s = files.settings.clock_skew_s

    def barrier_us(motion_age_s: int | None) -> int:
        return since_1970_us(barrier(utc_now(), motion_age_s, files.registration, listed, skew_s))

    clean = False
    session = Session(
        state,
        check=check,
        port=Port(bus, endpoint, journal.frame),
        journal=journal,
        worker=worker,
        view=view,
        commands=typed(OperatorCommand),
        log_id=log_id,
        barrier_us=barrier_us,
        witness=WitnessSearch(log.path.parent),
        checkpoint_deadline_s=files.settings.log.checkpoint_deadline_ms / 1000,
    )
    signals.interrupts(session)
    try:
        journal.processes(worker.pid)
        session.run(signals.wake)
        clean = True
        session.guidance(signals.wake)
    finally:
        try:
            for entry in of_session(session.state, log.path.name, files.registration, skew_s):
                list_withdrawal(log, entry, view.note)
        finally:
            worker.close()
        verdict = session.answer.document["verdict"] if session.answer else None
        paths = journal.close(session.state, verdict, endpoint.link.statistics, clean=clean)
    return session, paths
