"""``cutgate run``: one session with a controller, from announcement to the end of the cut."""

import importlib.resources
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from socket import gethostname
from threading import Thread
from typing import Annotated, Final

import can
import typer

from cutgate.config.bus import RuntimeDirectoryError, default_interface, open_bus
from cutgate.config.exits import READER_GONE, STOPPED
from cutgate.config.key import load_key
from cutgate.config.load import InputError
from cutgate.config.ours import user
from cutgate.config.screen import printable
from cutgate.config.signals import ENDING, SUSPENDING, handled, name_of, wake_pipe
from cutgate.config.signals import wake as write_wake
from cutgate.config.terminal import typed
from cutgate.protocol.endpoint import Endpoint
from cutgate.protocol.permit import fingerprint
from cutgate.protocol.port import Port
from cutgate.protocol.records import Side
from cutgate.runtime.audit import names
from cutgate.runtime.audit.configuration import ALLOW_SIMULATED, SIMULATED
from cutgate.runtime.audit.directory import Listed, Previous
from cutgate.runtime.audit.log import AuditLog, OpenInfo, Paths
from cutgate.runtime.commands.screen import delivered, working
from cutgate.runtime.commands.session_view import SessionView, run_document, stopped
from cutgate.runtime.commands.verdict_view import BAD
from cutgate.runtime.commands.verify import (
    PLAN_HELP,
    REGISTRATION_HELP,
    ROBOT_HELP,
    Q0TurnsOption,
    RollTurnsOption,
)
from cutgate.runtime.interlock.phases import ENDINGS
from cutgate.runtime.interlock.state import Interlock, Phase, Word
from cutgate.runtime.session import withdrawn
from cutgate.runtime.session.check import Check
from cutgate.runtime.session.job import VERIFIER, Files, make_job, read_files, utc_now
from cutgate.runtime.session.journal import Journal, plain
from cutgate.runtime.session.loop import Session
from cutgate.runtime.session.worker import Worker
from cutgate.runtime.verification.asked import AskedTurns
from cutgate.runtime.verification.report.document import document_text

OPERATOR_MAX: Final = 64
BRANCH: Final = "joint branch"
"""Name of record 0's option that says which turns were asked for; the path and the permit hold the branch itself."""
WITHDRAW_S: Final = 5.0
"""So long is the disk waited for that is to list a withdrawal."""
TOLD: Final[dict[int, str]] = {
    signal.SIGINT: "",
    signal.SIGHUP: "SIGHUP: the terminal hung up, and nobody can say stop any more",
    signal.SIGTSTP: "SIGTSTP (Ctrl-Z): a suspended runtime could not watch the arm",
    signal.SIGTTIN: "SIGTTIN (reading in the background): a suspended runtime could not watch the arm",
    signal.SIGTTOU: "SIGTTOU (writing in the background): a suspended runtime could not watch the arm",
}
"""What is said of a signal that ends the session, where its name is not enough; Ctrl-C needs no telling."""


def _name(text: str | None) -> str | None:
    """A person's name, on one line."""
    if text is not None and not (0 < len(text) <= OPERATOR_MAX and text.isprintable() and text.strip()):
        raise InputError(
            "--operator",
            "",
            printable(text[:OPERATOR_MAX]),
            f"1 to {OPERATOR_MAX} printable characters",
            "say a name",
        )
    return text


def run(
    path: Annotated[Path, typer.Argument(metavar="PATH", help=PLAN_HELP)],
    robot: Annotated[Path, typer.Option(help=f"The site's approved {ROBOT_HELP}.")],
    registration: Annotated[Path, typer.Option(help=f"{REGISTRATION_HELP}.")],
    site: Annotated[
        Path | None, typer.Option(help="Timing, bus and log directory; see docs/files.md.")
    ] = None,
    key: Annotated[Path | None, typer.Option(help="Pre-shared key; else key_file of site.toml.")] = None,
    interface: Annotated[str | None, typer.Option(help="python-can interface.")] = None,
    channel: Annotated[str | None, typer.Option(help="Its channel.")] = None,
    fd: Annotated[
        bool,
        typer.Option("--fd", help="Bulk records in CAN FD frames, as the controller; also in site.toml."),
    ] = False,
    allow_simulated: Annotated[
        bool,
        typer.Option(
            ALLOW_SIMULATED,
            help="The controller may be a simulation, whose plant runs at another speed than the clock; also in "
            "site.toml. Never where there is a robot or a bone.",
        ),
    ] = False,
    log_dir: Annotated[Path | None, typer.Option(help="Where the audit log goes.")] = None,
    operator: Annotated[
        str | None, typer.Option(callback=_name, metavar="NAME", help="Who runs the session, for the log.")
    ] = None,
    feed_mm_s: Annotated[
        float | None, typer.Option(min=0.001, max=10_000.0, help="Feed where the file has none (default 10).")
    ] = None,
    q0_turns: Q0TurnsOption = None,
    roll_turns: RollTurnsOption = None,
    json: Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")] = False,
) -> None:
    """Verify the path against the controller on the bus, permit it, start it, watch it to its end.

    Words on the terminal or standard input: start, stop, acknowledge, reset, withdraw, confirm CODE, quit. Ctrl-C, Ctrl-Z
    and a terminal that hangs up stop as well; a screen that nobody reads does not.
    Exit code: 0 cut completed, 1 not admitted, 2 refused input, 3 stopped, fault, or a log that could not be closed;
    141 --json without a reader.
    """
    try:
        with working(f"reading {path}"):
            files = read_files(path, robot, registration, site, feed_mm_s, allow_simulated=allow_simulated)
            secret = _key(key, files)
            asked = AskedTurns(q0_turns, roll_turns)
            job = make_job(files, now=utc_now(), asked=asked, key_fingerprint=fingerprint(secret))
            check = Check(job, files.robot.value, files.placed)
    except KeyboardInterrupt:
        raise typer.Exit(STOPPED) from None
    fd = fd or files.settings.bus.fd
    with SessionView(quiet_output=json) as view, _signals(view) as signals:
        view.note(f"key fingerprint {job.key_fingerprint}: the controller's key must have the same")
        if job.simulation_allowed_by:
            view.note(f"simulation: a simulated controller is allowed by {job.simulation_allowed_by}", BAD)
        directory = log_dir or Path(files.settings.log.directory)
        bus, name = _bus(interface, channel, files, fd=fd)
        try:
            log = _log(directory, files, job.path, name, asked, operator)
            _tell(log.previous, view)
            withdrawn_in = _withdrawn_in(log, job.registration)
            if withdrawn_in is not None:
                view.note(f"this registration was withdrawn in {withdrawn_in}: register the bone anew")
            state = Interlock(job, registration_withdrawn=withdrawn_in is not None)
            session, paths = _session(files, check, state, secret, bus, name, log, view, signals, fd=fd)
        finally:
            bus.shutdown()
        if not json:
            view.outcome(session.state, paths, stopped(session))
        view.close()
    if json and not delivered(
        document_text(run_document(session.state, session.answer, paths, stopped(session)))
    ):
        raise typer.Exit(READER_GONE)
    # A cut that nobody can prove is never a success, nor a log that is not whole one of a session that was not admitted.
    raise typer.Exit(ENDINGS[session.state.phase].exit_code if paths.closed else STOPPED)


def _session(
    files: Files,
    check: Check,
    state: Interlock,
    key: bytes,
    bus: can.BusABC,
    bus_name: str,
    log: AuditLog,
    view: SessionView,
    signals: "Signals",
    *,
    fd: bool,
) -> tuple[Session, Paths]:
    """Run one session; the log is closed and the worker ended whatever happens."""
    timing, deadlines = state.job.timing, state.job.deadlines
    journal = Journal(log, bus_name.partition("/")[2].rpartition("/")[2] or "can0")
    endpoint = Endpoint(
        Side.RUNTIME,
        heartbeat_s=timing.heartbeat_s,
        timeout_s=timing.timeout_s,
        transfer_timeout_s=deadlines.reply_timeout_s,
        fd=fd,
    )
    try:
        worker = Worker.start(state.job.path)
    except OSError:
        log.close(final_state=state.phase, outcome="the verification process cannot be started", clean=False)
        raise
    clean = False
    session = Session(
        state,
        check=check,
        key=key,
        port=Port(bus, endpoint, journal.frame),
        journal=journal,
        worker=worker,
        view=view,
        words=typed(Word),
        checkpoint_deadline_s=files.settings.log.checkpoint_deadline_ms / 1000,
    )
    signals.interrupts(session)
    try:
        journal.processes(worker.pid)
        session.run(signals.wake)
        clean = True
        session.guidance(signals.wake)
    finally:
        worker.close()
        if session.state.registration_withdrawn and not state.registration_withdrawn:
            _withdraw(log, state.job.registration, view)
        verdict = session.answer.document["verdict"] if session.answer else None
        paths = journal.close(session.state, verdict, endpoint.link.statistics, clean=clean)
    return session, paths


def _withdrawn_in(log: AuditLog, registration: bytes) -> str | None:
    """The log that tells why this registration was withdrawn, None if it was not; the list is read under the lock."""
    try:
        return withdrawn.load(log.path.parent).get(registration)
    except InputError as error:
        log.close(final_state=Phase.REFUSED, outcome=plain(str(error)), clean=True)
        raise


def _withdraw(log: AuditLog, registration: bytes, view: SessionView) -> None:
    """List it for every session to come, whether or not the controller has heard of it; a silent disk is left behind."""
    answers: SimpleQueue[Listed | Exception] = SimpleQueue()

    def add() -> None:
        try:
            answers.put(withdrawn.add(log.path.parent, registration, log.path.name, log.listed))
        except Exception as error:  # noqa: BLE001 - whatever it is, it is told below
            answers.put(error)

    Thread(target=add, name="withdraw", daemon=True).start()
    trouble: object = f"the disk did not answer within {WITHDRAW_S:g} s"
    with suppress(Empty):
        match answers.get(timeout=WITHDRAW_S):
            case Listed() as listed:
                log.listed = listed
                return
            case error:
                trouble = error
    view.note(f"the withdrawal could not be listed ({trouble}): never use this registration again")


def _tell(previous: Previous, view: SessionView) -> None:
    """What is not as it should be with the session before: it is in record 0, and the operator should know."""
    if previous.crashed:
        view.note(
            f"the session before this one ({previous.log or 'its log is unknown'}) did not end in order"
        )
    if previous.note:
        view.note(f"the log directory: {previous.note}")


@dataclass
class Signals:
    """What a signal does: it interrupts the session, now or as soon as there is one, and wakes its loop."""

    wake: int
    arrived: str | None = None
    """The signal's name; empty for Ctrl-C."""
    session: Session | None = None

    def interrupts(self, session: Session) -> None:
        """This is the session to interrupt; one that arrived before counts."""
        self.session = session
        if self.arrived is not None:
            session.interrupt(self.arrived)


@contextmanager
def _signals(view: SessionView) -> Iterator[Signals]:
    """Signals that would end or suspend the program only wake the loop; the table decides what they mean.

    From before the log is made until after it is closed: no Ctrl-C leaves it open.
    """
    reading, writing = wake_pipe()
    signals = Signals(reading)

    def interrupt(number: int) -> None:
        signals.arrived = "" if number == signal.SIGINT else name_of(number)
        view.interrupted_by = TOLD.get(number, name_of(number))
        if signals.session is not None:
            signals.session.interrupt(signals.arrived)
        write_wake(writing)

    try:
        with handled(ENDING | SUSPENDING, interrupt):
            yield signals
    finally:
        os.close(reading)
        os.close(writing)


def _bus(interface: str | None, channel: str | None, files: Files, *, fd: bool) -> tuple[can.BusABC, str]:
    """The bus of the options, of site.toml, or the default; and its name."""
    site = files.settings.bus
    chosen = (interface or site.interface, channel or site.channel)
    try:
        if chosen[0] is None:
            default = default_interface()
            chosen = (default[0], chosen[1] or default[1])
        elif chosen[1] is None:
            raise InputError("--channel", "", None, "is needed with --interface", "name the channel")
        bus = open_bus(str(chosen[0]), str(chosen[1]), fd=fd, bitrate_bit_s=site.bitrate_bit_s)
    except (can.CanInitializationError, RuntimeDirectoryError) as error:
        raise InputError("bus", "", None, str(error)) from None
    return bus, f"{chosen[0]}/{chosen[1]}"


def _key(option: Path | None, files: Files) -> bytes:
    """The pre-shared key; there is no built-in one."""
    file = option or (Path(files.settings.key_file) if files.settings.key_file else None)
    if file is None:
        raise InputError(
            "--key",
            "",
            None,
            "no key file is given",
            "name the one that the controller has too, or make one for both with: cutgate key new FILE",
        )
    return load_key(file)


def _log(
    directory: Path, files: Files, path: bytes, bus: str, asked: AskedTurns, operator: str | None
) -> AuditLog:
    """A new log with every input file attached: the bytes that were parsed."""
    with working(f"opening a log in {directory}; what a crash has left there is read first"):
        log = AuditLog.create(
            directory,
            log_id=os.urandom(16).hex(),
            opened=OpenInfo(
                VERIFIER,
                VERIFIER,
                _options(files, bus, asked),
                plain(user(os.getuid())),
                plain(gethostname()),
                operator,
            ),
            chunk_period_s=files.settings.log.chunk_period_ms / 1000,
        )
    prepared = files.prepared
    log.attach(f"{names.PLAN}{prepared.plan.path.suffix}", "application/octet-stream", prepared.plan.data)
    if prepared.registration is not None:
        log.attach(f"{names.REGISTRATION}.json", "application/json", prepared.registration.data)
    log.attach(names.ROBOT, "application/toml", files.robot.data)
    if files.site is not None:
        log.attach(names.SITE, "application/toml", files.site.data)
    log.attach(names.PATH, "application/octet-stream", path)
    dbc = importlib.resources.files("cutgate.protocol").joinpath("cutgate.dbc").read_bytes()
    log.attach(names.DBC, "text/plain", dbc)
    return log


def _options(files: Files, bus: str, asked: AskedTurns) -> tuple[tuple[str, str], ...]:
    """What record 0 says of the bus, of a joint branch that was asked for, and of a simulation where one is allowed."""
    allowed_by = files.simulation_allowed_by
    allowed = ((SIMULATED, f"allowed by {allowed_by}"),) if allowed_by else ()
    branch = ((BRANCH, f"asked for: {asked}"),) if str(asked) else ()
    return (("bus", plain(bus)), *branch, *allowed)


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command("run")(run)
