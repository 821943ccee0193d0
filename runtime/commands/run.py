"""``cutgate run``: one session with a controller, from announcement to the end of the cut."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Final

import can
import typer

from cutgate.config.bus import RuntimeDirectoryError, default_interface, open_bus
from cutgate.config.exits import READER_GONE, STOPPED
from cutgate.config.key import load_key
from cutgate.config.load import InputError
from cutgate.config.screen import printable
from cutgate.protocol.codes import fingerprint
from cutgate.runtime.audit.configuration import ALLOW_SIMULATED
from cutgate.runtime.audit.log import AuditLog
from cutgate.runtime.audit.log_keys import public_path
from cutgate.runtime.commands.registration_options import (
    DirectionOption,
    FrameOption,
    ResidualOption,
    TakenAtOption,
    how_read,
)
from cutgate.runtime.commands.screen import delivered, working
from cutgate.runtime.commands.session_view import SessionView, run_document, stopped
from cutgate.runtime.commands.tool_path_options import (
    ArcToleranceOption,
    AxisToleranceOption,
    CutcomOption,
    RotaryOption,
)
from cutgate.runtime.commands.verdict_view import BAD
from cutgate.runtime.commands.verify import (
    PLAN_HELP,
    REGISTRATION_HELP,
    ROBOT_HELP,
    Q0TurnsOption,
    RollTurnsOption,
)
from cutgate.runtime.interlock.phases import ENDINGS
from cutgate.runtime.interlock.state import Interlock
from cutgate.runtime.plan.registrations.declared import Declared
from cutgate.runtime.plan.toolpath.model import ARC_TOLERANCE_MM, AXIS_TOLERANCE_DEG, Reading
from cutgate.runtime.session.check import Check
from cutgate.runtime.session.conduct import Given, conduct
from cutgate.runtime.session.interruption import signals_wake
from cutgate.runtime.session.job import InputFiles, make_job, read_files, utc_now
from cutgate.runtime.session.new_log import new_log
from cutgate.runtime.session.withdrawal import listed_before
from cutgate.runtime.session.withdrawn import refusal
from cutgate.runtime.verification.asked import AskedTurns
from cutgate.runtime.verification.report.document import document_text

OPERATOR_MAX: Final = 64


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
    log_key: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The log directory's signing key; else log.key_file of site.toml."),
    ] = None,
    operator: Annotated[
        str | None, typer.Option(callback=_name, metavar="NAME", help="Who runs the session, for the log.")
    ] = None,
    feed_mm_s: Annotated[
        float | None, typer.Option(min=0.001, max=10_000.0, help="Feed where the file has none (default 10).")
    ] = None,
    cutcom_is_tool_centre: CutcomOption = False,
    rotary: RotaryOption = None,
    arc_tolerance_mm: ArcToleranceOption = ARC_TOLERANCE_MM,
    axis_tolerance_deg: AxisToleranceOption = AXIS_TOLERANCE_DEG,
    q0_turns: Q0TurnsOption = None,
    roll_turns: RollTurnsOption = None,
    registration_frame: FrameOption = None,
    registration_direction: DirectionOption = None,
    taken_at: TakenAtOption = None,
    registration_residual_mm: ResidualOption = None,
    json: Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")] = False,
) -> None:
    """Verify the path against the controller on the bus, permit it, start it, watch it to its end.

    Commands on the terminal or standard input: start, stop, acknowledge, reset, withdraw, confirm CODE, quit. Ctrl-C, Ctrl-Z
    and a terminal that hangs up stop as well; a screen that nobody reads does not.
    Exit code: 0 cut completed, 1 not admitted, 2 refused input, 3 stopped, fault, or a log that could not be closed;
    141 --json without a reader.
    """
    try:
        with working(f"reading {path}"):
            declared = Declared(
                registration_frame, registration_direction, taken_at, registration_residual_mm
            )
            reading = Reading(cutcom_is_tool_centre, rotary, arc_tolerance_mm, axis_tolerance_deg)
            files = read_files(
                path,
                robot,
                registration,
                site,
                feed_mm_s,
                reading=reading,
                allow_simulated=allow_simulated,
                declared=declared,
            )
            secret = _key(key, files)
            asked = AskedTurns(q0_turns, roll_turns)
            job = make_job(files, now=utc_now(), asked=asked, key_fingerprint=fingerprint(secret))
            check = Check(job, files.prepared.robot, files.placed)
    except KeyboardInterrupt:
        raise typer.Exit(STOPPED) from None
    fd = fd or files.settings.bus.fd
    with SessionView(quiet_output=json) as view, signals_wake(view.interrupted) as signals:
        view.note(f"key fingerprint {job.key_fingerprint}: the controller's key must have the same")
        if how := how_read(files.prepared.registration):
            view.note(f"registration read {how}")
        view.check_points(job.check_points)
        if job.simulation_allowed_by:
            view.note(f"simulation: a simulated controller is allowed by {job.simulation_allowed_by}", BAD)
        directory = log_dir or Path(files.settings.log.directory)
        log_id = os.urandom(16)
        bus, name = _bus(interface, channel, files, fd=fd)
        try:
            with working(f"opening a log in {directory}; what a crash has left there is read first"):
                log = new_log(
                    directory, files, job.path, name, asked, operator, log_id=log_id, log_key=log_key
                )
            _tell(log, view)
            with working("reading the list of withdrawn registrations"):
                listed = listed_before(log)
            against = refusal(listed, files.prepared.digests, files.registration, files.settings.clock_skew_s)
            if against:
                view.note(against)
            state = Interlock(replace(job, withdrawal=against))
            given = Given(files, check, state, secret, bus, name, log, log_id, listed, fd)
            session, paths = conduct(given, view, signals)
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


def _tell(log: AuditLog, view: SessionView) -> None:
    """A key that was enrolled, and what is not as it should be with the session before: it is in record 0 as well."""
    previous, held = log.previous, log.held
    if held.enrolled:
        where = (
            f"; its public half is in {public_path(held.path)}: keep a copy elsewhere" if held.made else ""
        )
        view.note(f"log key {held.key.public.fingerprint} {held.enrolled}{where}")
    if previous.crashed:
        view.note(
            f"the session before this one ({previous.log or 'its log is unknown'}) did not end in order"
        )
    if previous.note:
        view.note(f"the log directory: {previous.note}")


def _bus(
    interface: str | None, channel: str | None, files: InputFiles, *, fd: bool
) -> tuple[can.BusABC, str]:
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


def _key(option: Path | None, files: InputFiles) -> bytes:
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


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command("run")(run)
