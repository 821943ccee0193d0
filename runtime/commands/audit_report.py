"""``cutgate audit report``: one session, or two side by side, as a page that shows why."""

from contextlib import ExitStack
from dataclasses import dataclass
from functools import reduce
from operator import or_
from pathlib import Path
from time import monotonic
from typing import Annotated, Any, Final

import typer

from cutgate.config.load import InputError, open_input
from cutgate.config.screen import printable
from cutgate.runtime.audit.inspect import Log, Status
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
from cutgate.runtime.review.report.redact import Redaction
from cutgate.runtime.review.story import story
from cutgate.runtime.session.job import VERIFIER
from cutgate.runtime.verification import certified

OPTION: Final = "--out"
_PREFIXES: Final = ("c", "d")
_NAMES: Final = {"c": "first session", "d": "second session"}
"""What a session is called whose file's name is left out."""
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
    redact: Annotated[
        bool,
        typer.Option(
            "--redact", help="Leave out what names persons, bones, files and sessions, to show it to others."
        ),
    ] = False,
) -> None:
    """Write a page: was it allowed and why, what stopped it, how close did it come; and the session, played.

    It works from a USB stick: nothing is loaded. Exit code: 0, 2 for a file that is no log, or a page that cannot be
    written.
    """
    trust = trust_of(public_key, anchor, cosigner)
    began_s = monotonic()
    size = write_report([log] if other is None else [log, other], out, trust, again=again, redact=redact)
    echo(f"{printable(str(out))}: written, {size / 1000:.0f} kB, {monotonic() - began_s:.1f} s")


def write_report(
    logs: list[Path], out: Path, trust: Trust = NOBODY, *, again: bool = True, redact: bool = False
) -> int:
    """Write the page of one or two logs.

    Args:
        logs: their files.
        out: where it goes; an older page there is replaced.
        trust: what the reviewer brings.
        again: decide again from each log alone.
        redact: leave out names.

    Returns:
        Its size, bytes.

    Raises:
        InputError: a file that is no log, or the page cannot be written.
    """
    if out.suffix.lower() != ".html":
        raise InputError(out, OPTION, out.suffix or "without extension", ".html", "name another file")
    with ExitStack() as files, working("making the report"):
        opened = [_opened(log, trust, files) for log in logs]
        redaction = _redaction(opened) if redact else None
        read = [
            _read(one, prefix, files, redaction, again=again)
            for one, prefix in zip(opened, _PREFIXES, strict=False)
        ]
        different = _difference(opened) if len(opened) > 1 else None
        if redaction is not None:
            different = redaction.apply(different)
        content = page(read, different, redaction).encode()
    write_whole(out, content, OPTION)
    return len(content)


@dataclass(frozen=True, eq=False)
class _Opened:
    """A log, its file, and all that it tells."""

    path: Path
    log: Log
    told: dict[str, Any]


def _opened(path: Path, trust: Trust, files: ExitStack) -> _Opened:
    log = files.enter_context(reading(path, beside(trust, path)))
    if log.report.status is Status.UNREADABLE:
        raise InputError(path, "", None, log.report.reasons[0], _REMEDY)
    return _Opened(path, log, story(log, path, None))


def _redaction(opened: list[_Opened]) -> Redaction:
    """What is left out of both: a session names the one before it."""
    return reduce(or_, (Redaction.of(one.log, str(one.path), str(candump_of(one.path))) for one in opened))


def _read(
    one: _Opened, prefix: str, files: ExitStack, redaction: Redaction | None, *, again: bool
) -> ReportedSession:
    candump = candump_of(one.path)
    raw = files.enter_context(open_input(candump)) if candump.is_file() else None
    found = replay(one.log, certified.verify, verifier=VERIFIER) if again else None
    name = one.path.name if redaction is None else _NAMES[prefix]
    return reported(one.log, name, one.told, raw, found, prefix, redaction)


def _difference(opened: list[_Opened]) -> dict[str, Any]:
    """As ``audit diff --json`` has it; of all that both tell, for two names that are left out are not equal."""
    first, second = opened
    sections = difference(comparable(first.log, first.told), comparable(second.log, second.told))
    return {
        "schema": SCHEMA,
        "equal": equal(sections),
        "sections": sections,
        "timing": time_difference(timing(first.told), timing(second.told)),
    }
