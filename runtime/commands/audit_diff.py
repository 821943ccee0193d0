"""``cutgate audit diff``: two sessions side by side."""

import json as json_format
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from cutgate.config.load import InputError
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.reading import candump_of, reading
from cutgate.runtime.commands.screen import echo, output, working
from cutgate.runtime.review.comparable import Values, comparable, timing
from cutgate.runtime.review.difference import SCHEMA, difference, equal, time_difference
from cutgate.runtime.review.show_difference import print_difference
from cutgate.runtime.review.story import story

EQUAL: Final = 0
DIFFERENT: Final = 1


def diff(
    first: Annotated[Path, typer.Argument(metavar="A", help="A session's log (.mcap).")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another one.")],
    *,
    json: Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")] = False,
) -> None:
    """Hold two sessions against each other: inputs, decisions and what came of them, value by value.

    What differs between any two sessions is left out: ids, times of day, nonces, codes, chain and tree, running
    numbers. Measures of verdict and approach are equal within 1e-9 mm or deg. Ages and distances that permissives
    measured do not count, only whether they held and against which bound. Durations and counts of frames are listed as
    timing and make no sessions different.

    Exit code: 0 equal, 1 different, 2 a file that is no log.
    """
    (a, values_a, times_a), (b, values_b, times_b) = _read(first), _read(second)
    sections = difference(values_a, values_b)
    document = {
        "schema": SCHEMA,
        "equal": equal(sections),
        "a": a,
        "b": b,
        "sections": sections,
        "timing": time_difference(times_a, times_b),
    }
    if json:
        echo(json_format.dumps(document, indent=2, default=str))
    else:
        print_difference(output(), document)
    raise typer.Exit(EQUAL if document["equal"] else DIFFERENT)


def _read(log: Path) -> tuple[dict[str, Any], dict[str, Values], Values]:
    """What names the log, what counts of it, and its times."""
    with working(f"reading {log}"), reading(log) as read:
        report = read.report
        if report.status is Status.UNREADABLE:
            raise InputError(log, "", None, report.reasons[0], "name a session's .mcap file")
        candump = candump_of(log)
        told = story(read, log, candump if candump.is_file() else None)
        values = comparable(read, told)
    named = {
        "log": str(log),
        "log_id": report.log_id,
        "judgement": report.headline,
        "reasons": list(report.reasons),
        "opened_ns": told["opened"].get("utc_ns", 0),
    }
    return named, values, timing(told)
