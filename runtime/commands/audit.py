"""``cutgate audit``: review of session logs."""

import json as json_format
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from cutgate.config.load import InputError
from cutgate.config.screen import printable
from cutgate.runtime.audit.inspect import Log, Status
from cutgate.runtime.audit.reading import candump_of, reading
from cutgate.runtime.audit.replay import Outcome, replay
from cutgate.runtime.commands.screen import echo, output, working
from cutgate.runtime.review.show import print_story
from cutgate.runtime.review.story import story
from cutgate.runtime.session.job import VERIFIER
from cutgate.runtime.verification import certified

app = typer.Typer(help="Review session logs: what was decided, and whether it stands.", no_args_is_help=True)

LogFile = Annotated[Path, typer.Argument(metavar="LOG", help="A session's log (.mcap).")]
Json = Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")]


class VerifyCommand(TyperCommand):
    """A usage error of ``audit verify`` says UNREADABLE by its exit code: 2 would mean TAMPERED."""

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Parse the arguments; a mistake in them is said and ends the command."""
        try:
            return super().make_context(info_name, args, parent, **extra)
        except typer.TyperException as error:
            echo(f"cutgate audit verify: {error.format_message()}", err=True)
            raise typer.Exit(Status.UNREADABLE) from None


@app.command("verify", cls=VerifyCommand)
def verify(log: LogFile, *, json: Json = False) -> None:
    """Check structure, chain and attachments of a log.

    Exit code: 0 OK, 1 INCOMPLETE, 2 TAMPERED, 3 UNREADABLE (or no such file).
    """
    try:
        with _reading(log) as read:
            report = read.report
    except InputError as error:
        echo(str(error), err=True)
        raise typer.Exit(Status.UNREADABLE) from None
    if json:
        echo(_json({**asdict(report), "status": report.status.name, "headline": report.headline}))
    else:
        echo(f"{printable(report.headline)}: {printable(str(log))}")
        for line in (*report.reasons, *report.notes):
            echo(f"  {printable(line)}")
        echo(f"  {report.messages} records, chain head {report.head}")
        if report.dropped_bytes:
            echo(f"  {report.dropped_bytes} bytes at the end are no whole record")
    raise typer.Exit(report.status)


@app.command("show")
def show(log: LogFile, *, json: Json = False) -> None:
    """Show a session: verdicts with every boundary, the time line of decisions, and where the files are.

    Exit code: 0, or 2 for a file that is no log.
    """
    with _reading(log) as read:
        if read.report.status is Status.UNREADABLE:
            raise InputError(log, "", None, read.report.reasons[0], "name a session's .mcap file")
        candump = candump_of(log)
        document = story(read, log, candump if candump.is_file() else None)
    if json:
        echo(_json(document))
    else:
        print_story(output(), document)


@app.command("replay")
def replay_command(log: LogFile, *, json: Json = False) -> None:
    """Decide again from the log alone, and compare.

    Exit code: 0 identical, 1 differs, 2 not a log that can be replayed.
    """
    with _reading(log) as read, working(f"deciding {log} again"):
        result = replay(read, certified.verify, verifier=VERIFIER)
    if json:
        echo(_json({**asdict(result), "outcome": result.outcome.name}))
    else:
        word = {Outcome.IDENTICAL: "IDENTICAL", Outcome.DIFFERS: "DIFFERS", Outcome.BAD_INPUT: "BAD INPUT"}
        echo(f"{word[result.outcome]}: {printable(str(log))}")
        for line in (*result.differences, *result.notes):
            echo(f"  {printable(line)}")
        if result.verdict is not None:
            echo(f"  recomputed verdict: {result.verdict['verdict']}")
    raise typer.Exit(result.outcome)


def register(root: typer.Typer) -> None:
    """Adds the command."""
    root.add_typer(app, name="audit")


@contextmanager
def _reading(log: Path) -> Iterator[Log]:
    """The log, read with a sign of life; errors as ``reading``."""
    with ExitStack() as files:
        with working(f"reading {log}"):
            read = files.enter_context(reading(log))
        yield read


def _json(document: dict[str, Any]) -> str:
    return json_format.dumps(document, allow_nan=False, indent=2, default=str)
