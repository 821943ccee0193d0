"""``cutgate audit``: review of session logs."""

import json as json_format
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from cutgate.config.load import InputError, open_input
from cutgate.config.screen import printable
from cutgate.config.session_keys import SessionKeys, load_review_key
from cutgate.runtime.audit.inspect import Log, Status
from cutgate.runtime.audit.reading import candump_of, reading
from cutgate.runtime.audit.recomputed.authenticated import CodesFound, check_codes
from cutgate.runtime.audit.replay import ReplayOutcome, replay
from cutgate.runtime.audit.series_rules import worst
from cutgate.runtime.audit.trust import NOBODY, NOT_FOUND, Trust
from cutgate.runtime.commands import audit_prove
from cutgate.runtime.commands.audit_archive import archive_sessions
from cutgate.runtime.commands.audit_diff import diff
from cutgate.runtime.commands.audit_export import export
from cutgate.runtime.commands.audit_folder import list_sessions, verify_folder
from cutgate.runtime.commands.audit_recover import recover
from cutgate.runtime.commands.audit_report import report
from cutgate.runtime.commands.audit_trust import (
    AnchorOption,
    Certificates,
    CosignerOption,
    PublicKeyOption,
    beside,
    trust_of,
)
from cutgate.runtime.commands.screen import echo, output, working
from cutgate.runtime.review.show import print_story
from cutgate.runtime.review.story import story
from cutgate.runtime.session.job import VERIFIER
from cutgate.runtime.verification import certified

app = typer.Typer(help="Review session logs: what was decided, and whether it stands.", no_args_is_help=True)

LogFiles = Annotated[
    list[Path],
    typer.Argument(metavar="LOG...", help="Sessions' logs (.mcap), one or several, or folders of them."),
]
Json = Annotated[
    bool, typer.Option("--json", help="One JSON document on standard output; of several logs a list of them.")
]

REPLAY_WORST = (ReplayOutcome.DIFFERS, ReplayOutcome.BAD_INPUT, ReplayOutcome.IDENTICAL)
"""Of several logs the first of these is the exit code."""


class VerifyCommand(TyperCommand):
    """A usage error of ``audit verify`` or ``list`` says UNREADABLE by its exit code: 2 would mean TAMPERED."""

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Parse the arguments; a mistake in them is said and ends the command."""
        try:
            return super().make_context(info_name, args, parent, **extra)
        except typer.TyperException as error:
            echo(f"cutgate audit {info_name}: {error.format_message()}", err=True)
            raise typer.Exit(Status.UNREADABLE) from None


@app.command("verify", cls=VerifyCommand)
def verify(
    logs: LogFiles,
    *,
    public_key: PublicKeyOption = None,
    anchor: AnchorOption = None,
    cosigner: CosignerOption = None,
    key: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Check the codes as well: with the pre-shared key, or one session's keys alone.",
        ),
    ] = None,
    explain: Annotated[
        bool, typer.Option("--explain", help="Say as well what no verification of a log can find.")
    ] = False,
    json: Json = False,
) -> None:
    """Check structure, chain, tree and signatures of logs, and by which key.

    Exit code: 0 OK, 1 INCOMPLETE, 2 TAMPERED, 3 UNREADABLE (or no such file); of several logs the worst: 2, 3, 1, 0.
    """
    told = _Documents(json=json, several=len(logs) > 1)
    try:
        trust = trust_of(public_key, anchor, cosigner)
        held = None if key is None else load_review_key(key)
    except InputError as error:
        echo(str(error), err=True)
        raise typer.Exit(Status.UNREADABLE) from None
    known: dict[Path, Certificates] = {}  # a folder of logs is looked into once, not for each of them
    found = [_verified(log, told, beside(trust, log, known), held) for log in logs]
    if explain and not json:
        echo(NOT_FOUND)
    told.end()
    raise typer.Exit(worst(found))


def _verified(log: Path, told: "_Documents", trust: Trust, key: bytes | SessionKeys | None) -> Status:
    if log.is_dir():
        codes_of = None if key is None else partial(_codes, key=key)
        return verify_folder(log, told.add if told.json else None, trust, codes_of)
    try:
        with _reading(log, trust) as read:
            report = read.report
            codes = None if key is None else _codes(log, read, key)
    except InputError as error:
        echo(str(error), err=True)
        told.add({"log": str(log), "status": Status.UNREADABLE.name, "headline": str(error)})
        return Status.UNREADABLE
    if codes is not None and codes.answer == "no":
        report = report.tampered(codes.line)
    if told.json:
        checked = {} if codes is None else {"codes": asdict(codes)}
        told.add({"log": str(log), **report.document(), **checked})
        return report.status
    echo(f"{printable(report.headline)}: {printable(str(log))}")
    for line in (*report.reasons, *report.notes):
        echo(f"  {printable(line)}")
    for step in report.steps:
        echo(f"  {printable(str(step))}")
    if codes is not None:
        echo(f"  {printable(codes.line)}")
    if report.dropped_bytes:
        echo(f"  {report.dropped_bytes} bytes at the end are no whole record")
    return report.status


def _codes(log: Path, read: Log, key: bytes | SessionKeys) -> CodesFound:
    candump = candump_of(log)
    if not candump.is_file():
        return check_codes(read, None, key)
    with open_input(candump) as frames:
        return check_codes(read, frames, key)


app.command("list", cls=VerifyCommand)(list_sessions)
app.command("archive")(archive_sessions)


@app.command("show")
def show(logs: LogFiles, *, json: Json = False) -> None:
    """Show sessions: verdicts with every boundary, the time line of decisions, and where the files are.

    Exit code: 0, or 2 for a file that is no log.
    """
    logs = each_log(logs)
    told = _Documents(json=json, several=len(logs) > 1)
    for number, log in enumerate(logs):
        with _reading(log) as read:
            if read.report.status is Status.UNREADABLE:
                raise InputError(log, "", None, read.report.reasons[0], "name a session's .mcap file")
            candump = candump_of(log)
            document = story(read, log, candump if candump.is_file() else None)
        if json:
            told.add(document)
            continue
        if number:
            echo("")
        print_story(output(), document)
    told.end()


@app.command("replay")
def replay_command(logs: LogFiles, *, json: Json = False) -> None:
    """Decide again from each log alone, and compare.

    Exit code: 0 identical, 1 differs, 2 not a log that can be replayed; of several logs the worst: 1, 2, 0.
    """
    logs = each_log(logs)
    told = _Documents(json=json, several=len(logs) > 1)
    found = [_replayed(log, told) for log in logs]
    told.end()
    raise typer.Exit(min(found, key=REPLAY_WORST.index))


def _replayed(log: Path, told: "_Documents") -> ReplayOutcome:
    try:
        with _reading(log) as read, working(f"deciding {log} again"):
            result = replay(read, certified.verify, verifier=VERIFIER)
    except InputError as error:
        echo(str(error), err=True)
        told.add({"log": str(log), "outcome": ReplayOutcome.BAD_INPUT.name, "notes": [str(error)]})
        return ReplayOutcome.BAD_INPUT
    if told.json:
        told.add({"log": str(log), **asdict(result), "outcome": result.outcome.name})
        return result.outcome
    headline = {
        ReplayOutcome.IDENTICAL: "IDENTICAL",
        ReplayOutcome.DIFFERS: "DIFFERS",
        ReplayOutcome.BAD_INPUT: "BAD INPUT",
    }
    echo(f"{headline[result.outcome]}: {printable(str(log))}")
    for line in (*result.differences, *result.notes):
        echo(f"  {printable(line)}")
    if result.verdict is not None:
        echo(f"  recomputed verdict: {result.verdict['verdict']}")
    return result.outcome


audit_prove.add_to(app)


def each_log(paths: list[Path]) -> list[Path]:
    """The logs, of a folder those in it, in the order of their names.

    Raises:
        InputError: a folder holds none.
    """
    found = []
    for path in paths:
        inside = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
        if not inside:
            raise InputError(
                path, "", None, "a folder without logs (*.mcap)", "name a log, or the folder of logs"
            )
        found += inside
    return found


class _Documents:
    """What ``--json`` prints in the end: the document of the one log, or a list of those of several."""

    def __init__(self, *, json: bool, several: bool) -> None:
        self.json = json
        self._several = several
        self._documents: list[dict[str, Any]] = []

    def add(self, document: dict[str, Any]) -> None:
        self._documents.append(document)

    def end(self) -> None:
        if self.json:
            echo(_json(self._documents if self._several else self._documents[0]))


app.command("diff")(diff)
app.command("export")(export)


def register(root: typer.Typer) -> None:
    """Adds the command."""
    app.command("recover")(recover)
    app.command("report")(report)
    root.add_typer(app, name="audit")


@contextmanager
def _reading(log: Path, trust: Trust = NOBODY) -> Iterator[Log]:
    """The log, read with a sign of life; errors as ``reading``."""
    with ExitStack() as files:
        with working(f"reading {log}"):
            read = files.enter_context(reading(log, trust))
        yield read


def _json(document: dict[str, Any] | list[dict[str, Any]]) -> str:
    return json_format.dumps(document, allow_nan=False, indent=2, default=str)
