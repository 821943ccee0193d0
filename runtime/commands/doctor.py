"""``cutgate doctor``: whether this machine can do what a session needs, in one table."""

import json as json_format
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

from cutgate.config.exits import OK
from cutgate.config.refusal import InputError
from cutgate.config.screen import printable
from cutgate.runtime.commands.screen import echo, output, working
from cutgate.runtime.doctor.finding import Condition, Finding

SCHEMA: Final = "cutgate.doctor/1"
FAILED: Final = 1
TABLE_COLUMNS: Final = 72
"""On a narrower screen each check is a line."""
WORST_FIRST: Final = (Condition.FAIL, Condition.WARNING, Condition.UNKNOWN, Condition.OK)
STYLES: Final = {
    Condition.OK: "green",
    Condition.UNKNOWN: "cyan",
    Condition.WARNING: "yellow",
    Condition.FAIL: "bold red",
}


def doctor(
    site: Annotated[
        Path | None, typer.Option(metavar="FILE", help="site.toml; without it the defaults.")
    ] = None,
    key: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Pre-shared key; else key_file of site.toml.")
    ] = None,
    interface: Annotated[str | None, typer.Option(help="python-can interface.")] = None,
    channel: Annotated[str | None, typer.Option(help="Its channel.")] = None,
    log_dir: Annotated[Path | None, typer.Option(metavar="DIR", help="Where the audit log would go.")] = None,
    json: Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")] = False,
) -> None:
    """Look at installation, bus, clock, priority, key, log directory and disk: can a session run here?

    Takes about two seconds. Changes nothing: a file written to time the disk is removed again.
    Exit code: 0 nothing fails, 1 something does, 2 an option or site.toml was refused.
    """
    with working("looking at this machine"):
        found = [*_installation(), *_machine(site, key, interface, channel, log_dir)]
    failed = any(one.state is Condition.FAIL for one in found)
    if json:
        document = {"schema": SCHEMA, "ok": not failed, "checks": [asdict(one) for one in found]}
        echo(json_format.dumps(document, allow_nan=False, indent=2))
    else:
        _print(output(), found)
    raise typer.Exit(FAILED if failed else OK)


def _installation() -> Iterable[Finding]:
    """The checks that are made first, and even where a package is missing."""
    try:
        from cutgate.runtime.doctor.checks import findings  # noqa: PLC0415 - a package may be missing
        from cutgate.runtime.doctor.installation import DISTRIBUTION, INSTALLATION  # noqa: PLC0415
    except ImportError as error:
        return [_not_imported("packages", error)]
    return findings(INSTALLATION, DISTRIBUTION)


def _machine(
    site: Path | None, key: Path | None, interface: str | None, channel: str | None, log_dir: Path | None
) -> Iterator[Finding]:
    """The checks of the machine, if what they need can be imported.

    Raises:
        InputError: site.toml or an option is refused.
    """
    try:
        from cutgate.config.bus import default_interface  # noqa: PLC0415 - a package may be missing
        from cutgate.config.load import load_site  # noqa: PLC0415
        from cutgate.config.model import Site  # noqa: PLC0415
        from cutgate.runtime.doctor.checks import findings  # noqa: PLC0415
        from cutgate.runtime.doctor.examined import Examined  # noqa: PLC0415
        from cutgate.runtime.doctor.machine import MACHINE  # noqa: PLC0415
    except ImportError as error:
        yield _not_imported("machine", error)
        return
    settings = Site() if site is None else load_site(site).value
    bus = (interface or settings.bus.interface, channel or settings.bus.channel)
    if bus[0] is not None and bus[1] is None:
        raise InputError("--channel", "", None, "is needed with --interface", "name the channel")
    default = default_interface() if bus[0] is None else ("", "")
    named = key or (Path(settings.key_file) if settings.key_file else None)
    examined = Examined(
        settings, named, bus[0] or default[0], bus[1] or default[1], log_dir or Path(settings.log.directory)
    )
    yield from findings(MACHINE, examined)


def _not_imported(name: str, error: ImportError) -> Finding:
    remedy = "install what was tested: pip install --no-deps --require-hashes -r requirements.txt"
    return Finding(name, Condition.FAIL, f"not looked at: {error}", "everything can be imported", remedy)


# ---------------------------------------------------------------- the screen


def _print(console: Console, found: list[Finding]) -> None:
    """The table, what to do, and how many there are of each."""
    if console.width >= TABLE_COLUMNS:
        console.print(_table(found))
    else:
        for one in found:
            console.print(_line(one))
    told = sorted((one for one in found if one.remedy), key=lambda one: WORST_FIRST.index(one.state))
    if told:
        console.print(Text("\nWhat to do", "bold"))
    for one in told:
        # Left to the terminal to break, so that a command can be copied as it stands.
        state = _state(one)
        state.pad_right(max(map(len, Condition)) - len(state))
        console.print(state, f"{printable(one.name)}: {printable(one.remedy)}", soft_wrap=True)
    counts = Counter(one.state for one in found)
    summary = ", ".join(f"{counts[state]} {state}" for state in Condition if counts[state])
    console.print(f"\n{len(found)} checks: {summary}")


def _table(found: list[Finding]) -> RenderableType:
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    table.add_column("", no_wrap=True)
    table.add_column("check", overflow="fold", max_width=22)
    table.add_column("found", overflow="fold", ratio=3)
    table.add_column("must be", overflow="fold", ratio=2)
    for one in found:
        table.add_row(_state(one), *(printable(text) for text in (one.name, one.found, one.bound)))
    return table


def _line(one: Finding) -> Text:
    text = f" {printable(one.name)}: {printable(one.found)} (must be: {printable(one.bound)})"
    return Text.assemble(_state(one), text)


def _state(one: Finding) -> Text:
    return Text(one.state, STYLES[one.state])


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command("doctor")(doctor)
