"""``cutgate audit report``: one session, or two side by side, as a page that shows why."""

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from cutgate.config.load import InputError, open_input
from cutgate.config.screen import printable
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.reading import candump_of, reading
from cutgate.runtime.audit.replay import replay
from cutgate.runtime.audit.trust import NOBODY, Trust
from cutgate.runtime.commands.audit_trust import (
    AnchorOption,
    CosignerOption,
    PublicKeyOption,
    beside,
    trust_of,
)
from cutgate.runtime.commands.reach_files import write_whole
from cutgate.runtime.commands.report.page import page
from cutgate.runtime.commands.report.session import ReportedSession, reported
from cutgate.runtime.commands.screen import echo, working
from cutgate.runtime.review.comparable import comparable, timing
from cutgate.runtime.review.difference import SCHEMA, difference, equal, time_difference
from cutgate.runtime.review.story import story
from cutgate.runtime.session.job import VERIFIER
from cutgate.runtime.verification import certified

OPTION: Final = "--out"
_PREFIXES: Final = ("c", "d")
_REMEDY: Final = "name a session's .mcap file"


def report(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A session's log (.mcap).")],
    other: Annotated[
        Path | None, typer.Argument(metavar="[LOG2]", help="Another one, to be held against it.")
    ] = None,
    *,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="The page, .html; written whole.")],
    public_key: PublicKeyOption = None,
    anchor: AnchorOption = None,
    cosigner: CosignerOption = None,
    again: Annotated[
        bool,
        typer.Option(
            "--replay/--no-replay", help="Decide again from the log alone, and say what came of it."
        ),
    ] = True,
) -> None:
    """Write a page: was it allowed and why, what stopped it, how close did it come; and the session, played.

    It works from a USB stick: nothing is loaded. Exit code: 0, 2 for a file that is no log, or a page that cannot be
    written.
    """
    trust = trust_of(public_key, anchor, cosigner)
    size = write_report([log] if other is None else [log, other], out, trust, again=again)
    echo(f"{printable(str(out))}: written, {size / 1000:.0f} kB")


def write_report(logs: list[Path], out: Path, trust: Trust = NOBODY, *, again: bool = True) -> int:
    """Write the page of one or two logs.

    Args:
        logs: their files.
        out: where it goes; an older page there is replaced.
        trust: what the reviewer brings.
        again: decide again from each log alone.

    Returns:
        Its size, bytes.

    Raises:
        InputError: a file that is no log, or the page cannot be written.
    """
    if out.suffix.lower() != ".html":
        raise InputError(out, OPTION, out.suffix or "without extension", ".html", "name another file")
    with ExitStack() as files, working("making the report"):
        read = [
            _read(log, trust, prefix, files, again=again)
            for log, prefix in zip(logs, _PREFIXES, strict=False)
        ]
        content = page(read, _difference(read) if len(read) > 1 else None).encode()
    write_whole(out, content, OPTION)
    return len(content)


def _read(path: Path, trust: Trust, prefix: str, files: ExitStack, *, again: bool) -> ReportedSession:
    log = files.enter_context(reading(path, beside(trust, path)))
    if log.report.status is Status.UNREADABLE:
        raise InputError(path, "", None, log.report.reasons[0], _REMEDY)
    candump = candump_of(path)
    raw = files.enter_context(open_input(candump)) if candump.is_file() else None
    found = replay(log, certified.verify, verifier=VERIFIER) if again else None
    return reported(log, path.name, story(log, path, None), raw, found, prefix)


def _difference(read: list[ReportedSession]) -> dict[str, Any]:
    """As ``audit diff --json`` has it."""
    first, second = read
    sections = difference(comparable(first.log, first.told), comparable(second.log, second.told))
    return {
        "schema": SCHEMA,
        "equal": equal(sections),
        "sections": sections,
        "timing": time_difference(timing(first.told), timing(second.told)),
    }
