"""``cutgate conform``: the negative suite against a controller whose plant is disconnected."""

import os
import select
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Final

import can
import typer
from rich.table import Table

from cutgate.config.bus import RuntimeDirectoryError, open_bus
from cutgate.config.constants import CONSTANTS
from cutgate.config.durable import create_durably
from cutgate.config.key import load_key
from cutgate.config.load import InputError, load_robot, load_site
from cutgate.config.model import Site
from cutgate.config.records import calibration_record, limits_record, timing_record, tool_record
from cutgate.config.screen import printable
from cutgate.protocol import records
from cutgate.protocol.frames import IDS, SENT_BY, ControllerHeartbeat
from cutgate.protocol.records import Side
from cutgate.runtime.commands.screen import echo, messages, output
from cutgate.runtime.conform.bench import Bench
from cutgate.runtime.conform.cases import Case
from cutgate.runtime.conform.failures import HaltError
from cutgate.runtime.conform.report import ABOUT, document, milliseconds, summary
from cutgate.runtime.conform.suite import CaseVerdict, Result, SuiteOutcome, run
from cutgate.runtime.conform.table import cases
from cutgate.runtime.verification.report.document import document_text

PASSED, FAILED, INTERRUPTED = 0, 1, 3
LISTEN_S: Final = 0.6
"""The bus is listened to before anything is said: longer than any period of a session's frames."""

Approved = tuple[bytes, bytes, bytes]


def conform(
    interface: Annotated[str, typer.Option(help="python-can interface.")],
    channel: Annotated[str, typer.Option(help="Its channel.")],
    key: Annotated[Path, typer.Option(help="Pre-shared key of this controller.")],
    plant_disconnected: Annotated[
        bool, typer.Option("--plant-disconnected", help="You say: axes and cutter have no power.")
    ] = False,
    robot: Annotated[
        Path | None, typer.Option(help="The approved robot.toml or preset, which it must report.")
    ] = None,
    site: Annotated[Path | None, typer.Option(help="site.toml: heartbeat, time-out, reply time.")] = None,
    fd: Annotated[
        bool,
        typer.Option("--fd", help="Bulk records in CAN FD frames, as the controller; also in site.toml."),
    ] = False,
    only: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Only this case; repeatable.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Write the report as JSON to this new file.")] = None,
    json: Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")] = False,
) -> None:
    """Show that a controller refuses what it must. Its plant must be disconnected; see docs/controllers.md.

    Exit code: 0 every case passed, 1 a case failed or could not be run, 2 refused input, bus or key, 3 Ctrl-C.
    """
    if not plant_disconnected:
        raise InputError(
            "--plant-disconnected",
            "",
            None,
            f"is not given. {' '.join(ABOUT.split())}",
            "disconnect it, then say so",
        )
    settings = load_site(site).value if site else Site()
    fd = fd or settings.bus.fd
    chosen, secret = _inputs(robot, only, key)
    _refuse_existing(out)
    bus = open_unused_bus(interface, channel, fd=fd, bitrate_bit_s=settings.bus.bitrate_bit_s)
    try:
        messages().print(ABOUT, soft_wrap=True)
        bench = bench_on(bus, secret, settings, fd=fd)
        outcome = _run(bench, chosen)
    except KeyboardInterrupt:
        messages().print("interrupted: the controller was told to stop; there is no report", soft_wrap=True)
        raise typer.Exit(INTERRUPTED) from None
    finally:
        bus.shutdown()
    report = document(outcome, bench.announce, bench.timing, bus=f"{interface}/{channel}", whole=not only)
    text = document_text(report)
    _write(out, text)
    if json:
        echo(text)
    else:
        _print(outcome, whole=not only)
    raise typer.Exit(PASSED if outcome.passed else FAILED)


def _inputs(robot: Path | None, only: list[str] | None, key: Path) -> tuple[tuple[Case, ...], bytes]:
    """Cases and key. Raises InputError for anything that is not as it must be."""
    approved = approved_records(robot)
    known = tuple(case for case in cases(approved) if approved is not None or not case.approved)
    names = {case.name for case in known}
    for name in only or ():
        if name not in names:
            raise InputError("--only", "", name, "is no case's name", f"one of: {', '.join(sorted(names))}")
    chosen = tuple(case for case in known if not only or case.name in only)
    return chosen, load_key(key)


def approved_records(robot: Path | None) -> Approved | None:
    """What a robot file approves, as a controller must report it; None without one. Raises InputError."""
    if robot is None:
        return None
    found = load_robot(robot).value
    return limits_record(found).body(), calibration_record(found).body(), tool_record(found).body()


def _timing(site: Site) -> records.Timing:
    """The site's timing, with both lifetimes at their lower bounds: the suite waits for them to end."""
    return replace(
        timing_record(site),
        permit_lifetime_s=round(CONSTANTS["permit_lifetime_s"].low),
        start_lifetime_ms=round(CONSTANTS["start_lifetime_ms"].low),
    )


def _refuse_existing(out: Path | None) -> None:
    if out is not None and out.exists():
        raise InputError(str(out), "", None, "exists and is not overwritten", "name a new file")


def _write(out: Path | None, text: str) -> None:
    if out is None:
        return
    try:
        create_durably(out, f"{text}\n".encode(), ours=False)
    except OSError as error:
        raise InputError(str(out), "", None, f"cannot be written: {error.strerror}") from None


def open_unused_bus(interface: str, channel: str, *, fd: bool, bitrate_bit_s: int) -> can.BusABC:
    """The bus, on which no session is under way. Raises InputError otherwise."""
    try:
        bus = open_bus(interface, channel, fd=fd, bitrate_bit_s=bitrate_bit_s)
    except (can.CanInitializationError, RuntimeDirectoryError, ValueError) as error:
        raise InputError("bus", "", None, str(error)) from None
    try:
        _refuse_a_session(bus)
    except can.CanError as error:
        bus.shutdown()
        raise InputError("bus", "", None, f"failed: {error}") from None
    except BaseException:
        bus.shutdown()
        raise
    return bus


def _refuse_a_session(bus: can.BusABC) -> None:
    """Another runtime, or a controller in a session, must not be disturbed."""
    busy = SENT_BY[Side.RUNTIME] | {IDS[ControllerHeartbeat]}
    until_s = time.monotonic() + LISTEN_S
    while (left_s := until_s - time.monotonic()) > 0.0:
        message = bus.recv(timeout=left_s)
        if message is not None and not message.is_extended_id and message.arbitration_id in busy:
            raise InputError(
                "bus", "", None, f"a session is under way (0x{message.arbitration_id:03X})", "end it first"
            )


def bench_on(
    bus: can.BusABC,
    key: bytes,
    settings: Site,
    *,
    fd: bool,
    clock: Callable[[], float] = time.monotonic,
    wait: Callable[[float], None] | None = None,
    random: Callable[[int], bytes] = os.urandom,
) -> Bench:
    """A bench on an open bus, in real time unless told otherwise.

    Args:
        bus: an open python-can bus.
        key: the pre-shared key, 32 bytes.
        settings: of the site.
        fd: bulk records in CAN FD frames.
        clock: monotonic seconds.
        wait: waits until a frame may have come, at most so many seconds; None for the bus's descriptor.
        random: the operating system's generator.
    """
    return Bench(
        bus,
        key,
        _timing(settings),
        reply_s=settings.timing.reply_timeout_ms / 1000,
        clock=clock,
        wait=wait or _waiting(bus),
        random=random,
        fd=fd,
    )


def _waiting(bus: can.BusABC) -> Callable[[float], None]:
    poller = select.poll()
    poller.register(bus.fileno(), select.POLLIN)

    def wait(seconds: float) -> None:
        poller.poll(seconds * 1000.0)

    return wait


def _run(bench: Bench, chosen: tuple[Case, ...]) -> SuiteOutcome:
    """The suite; whatever ends it early stops the controller first."""
    try:
        bench.hello()
        return run(bench, chosen, _tell)
    except HaltError as error:
        raise InputError("bus", "", None, str(error)) from None
    except can.CanError as error:
        raise InputError(
            "bus", "", None, f"failed: {error}; the controller stops within its time-out"
        ) from None
    except BaseException:
        _stop(bench)
        raise


def _stop(bench: Bench) -> None:
    """One stop frame at once; the heartbeats have ended as well."""
    with suppress(can.CanError):
        bench.stop_now()


def _tell(result: Result) -> None:
    messages().print(f"{result.verdict.value:8}{result.case.name}", soft_wrap=True)


def _print(outcome: SuiteOutcome, *, whole: bool) -> None:
    console = output()
    table = Table("verdict", "case", "came", "ms", box=None, pad_edge=False)
    for result in outcome.results:
        latency = milliseconds(result.latency_s)
        shown = "" if latency is None else f"{latency:.0f}"
        table.add_row(result.verdict.value, result.case.name, printable(result.came), shown)
    console.print(table)
    for result in outcome.results:
        if result.verdict is not CaseVerdict.PASS:
            case = result.case
            console.print(
                f"\n{result.verdict.value}: {case.name} (docs/protocol.md: {case.requirement})\n"
                f"  sent      {case.sent}\n  expected  {case.expected}\n  came      {printable(result.came)}",
                soft_wrap=True,
            )
    console.print(f"\n{summary(outcome, whole=whole)}", soft_wrap=True)


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command("conform")(conform)
