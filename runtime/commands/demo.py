"""``cutgate demo``: the whole story in one go, with every part in a process of its own.

Hub (or vcan0), simulated controller and runtime are started as a user would start them, and driven by the commands
a user would type. A first registration is refused and explained, a second one is admitted and cut to the end.
"""

import json as json_format
import secrets
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from rich.text import Text

from cutgate.config.exits import SIGNALLED, STOPPED
from cutgate.config.key import new_key_file
from cutgate.config.load import EXAMPLES, InputError
from cutgate.config.screen import printable
from cutgate.config.signals import ENDING, handled, name_of
from cutgate.protocol.codes import KEY_BYTES
from cutgate.runtime.audit.replay import ReplayOutcome
from cutgate.runtime.commands.audit_report import write_report
from cutgate.runtime.commands.example import fill
from cutgate.runtime.commands.screen import echo, messages, output
from cutgate.runtime.commands.verdict_view import BAD, GOOD
from cutgate.runtime.demo.processes import DemoError, run_controller, run_session, serve_bus
from cutgate.runtime.demo.reviews import reviewed
from cutgate.runtime.demo.script import PLAN, STALLED, STORY, TIME_SCALE, departure
from cutgate.runtime.review.comparison import print_comparison
from cutgate.runtime.review.show import print_time_line

SETTINGS: Final = ("robot.toml", "site.toml")
SCHEMA: Final = "cutgate.demo/1"
WHY: Final = "Why, as a page for a browser: {}"


def demo(
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for key, logs and inputs, new or empty. Default: a new one here."),
    ] = None,
    fd: Annotated[bool, typer.Option("--fd", help="Bulk records in CAN FD frames.")] = False,
    json: Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")] = False,
) -> None:
    """Refuse a first registration, explain where to move the bone, admit a second one and cut to the end.

    A session that ends otherwise ends the demo: it says why, what to do and what is left behind.
    Exit code: 0 if all went as told here, 3 if a session was stopped, or anything else went otherwise.
    """
    began_s = time.monotonic()
    folder = _folder(out)
    say = _Teller(messages().print)
    framing = ["--fd"] if fd else []
    runs: list[dict[str, Any]] = []
    why: list[str] = []
    try:
        with (
            _ended_in_order(say),
            serve_bus(folder, say) as where,
            run_controller(folder, [*where, *framing], say) as controller,
        ):
            for registration in STORY:
                runs.append(run_session(folder, registration, [*where, *framing], controller, say))
                why = departure(registration, runs[-1], say.stalled)
                if why:  # what follows needs this one
                    break
    except DemoError as error:
        why = [str(error)]
    as_told = not why
    reviews = [reviewed(Path(run["log"]["mcap"])) for run in runs]
    why += [
        f"{review['log']}: verify {review['verify']}, replay {review['replay']}"
        for review in reviews
        if (review["verify"], review["replay"]) != ("OK", ReplayOutcome.IDENTICAL.name)
    ]
    reports = _reported([Path(review["log"]) for review in reviews], why)
    elapsed_s = time.monotonic() - began_s
    if json:
        document = {
            "schema": SCHEMA,
            "as_told": not why,
            "why": why,
            "sessions": runs,
            "reviews": [{key: review[key] for key in ("log", "verify", "replay")} for review in reviews],
            "reports": [str(report) for report in reports],
            "elapsed_s": elapsed_s,
        }
        echo(json_format.dumps(document, allow_nan=False, indent=2))
    elif as_told:
        _summary(runs, reviews, reports, folder, elapsed_s)
    if why:
        _otherwise(why, runs, reports, folder)
    raise typer.Exit(STOPPED if why else 0)


# ---------------------------------------------------------------- what is shown meanwhile


class _Teller:
    """Lines of every process, each with its name and the time, on standard error; ``stalled``: those of lateness."""

    def __init__(self, print_line: Callable[..., None]) -> None:
        self.stalled: list[str] = []
        self._print = print_line
        self._began_s = time.monotonic()

    def __call__(self, who: str, text: str) -> None:
        if who == "controller" and STALLED in text:  # the runtime says it in its reason
            self.stalled.append(f"{who}: {text}")
        elapsed = f"{time.monotonic() - self._began_s:6.2f} s "
        self._print(Text.assemble((elapsed, "dim"), (f"{who:<11}", "cyan"), printable(text)), soft_wrap=True)


def _folder(out: Path | None) -> Path:
    """A folder, new or empty, with key, site and the example's files. Nothing that exists is touched."""
    folder = out or Path(f"cutgate-demo-{time.strftime('%Y%m%dT%H%M%S')}")
    fill(folder, "--out", {name: (EXAMPLES / name).read_bytes() for name in (PLAN, *STORY, *SETTINGS)})
    new_key_file(folder / "site.key", secrets.token_bytes(KEY_BYTES))
    return folder


@contextmanager
def _ended_in_order(say: _Teller) -> Iterator[None]:
    """Whatever ends the demo ends its processes first, the runtime before all: it stops the arm and closes its log."""
    first = True

    def end(number: int) -> None:
        nonlocal first
        if first:  # a second one must not cut short what the first has begun
            first = False
            say("demo", f"{name_of(number)}: ending runtime, controller and bus")
            raise typer.Exit(SIGNALLED + number)

    with handled(ENDING - {signal.SIGINT}, end):
        yield


# ---------------------------------------------------------------- what came of it


def _reported(logs: list[Path], why: list[str]) -> list[Path]:
    """A page of each session, beside its log and named after it; one that cannot be written is among what went otherwise."""
    pages = []
    for log in logs:
        page = log.with_suffix(".html")
        try:
            write_report([log], page)
        except InputError as error:
            why.append(str(error))
        else:
            pages.append(page)
    return pages


def _otherwise(why: list[str], runs: list[dict[str, Any]], reports: list[Path], folder: Path) -> None:
    """What went otherwise than told, and what is left behind."""
    console = messages()
    for reason in why:
        console.print(Text(printable(f"demo: {reason}"), BAD), soft_wrap=True)
    logs = ", ".join(Path(run["log"]["mcap"]).name for run in runs) or "no log"
    left = (
        f"Left behind: {folder} with key, inputs and logs of whole sessions ({logs}); nothing runs any more."
    )
    console.print(printable(left), soft_wrap=True)
    for report in reports:
        console.print(printable(WHY.format(report)), soft_wrap=True)
    if runs:
        console.print(printable(f"Next: cutgate audit show {runs[-1]['log']['mcap']}"), soft_wrap=True)


def _summary(
    runs: list[dict[str, Any]],
    reviews: list[dict[str, Any]],
    reports: list[Path],
    folder: Path,
    elapsed_s: float,
) -> None:
    """What a person wants to know afterwards."""
    console = output()
    console.print()
    for run, name in zip(runs, ("first registration", "second registration"), strict=True):
        verdict = (run["verdict"] or {}).get("verdict", "no verdict")
        style = GOOD if verdict == "admissible" else BAD
        console.print(Text.assemble(f"{name}: ", (verdict.upper(), style), f", session {run['outcome']}"))
        console.print(_move(run["verdict"]), end="")
    console.print()
    print_comparison(console, [run["verdict"] for run in runs if run["verdict"]], ("first", "second"))
    for review, name in zip(reviews, ("first", "second"), strict=True):
        print_time_line(console, review["story"]["decisions"], f"Time line of the {name} session")
    console.print()
    for review in reviews:
        judgement = f"{review['headline']}, replay {review['replay']}"
        style = GOOD if review["verify"] == "OK" and review["replay"] == ReplayOutcome.IDENTICAL.name else BAD
        console.print(Text.assemble(printable(f"{review['log']}: "), (judgement, style)), soft_wrap=True)
        for reason in review["why"]:
            console.print(printable(f"  {reason}"), soft_wrap=True)
    for report in reports:
        console.print(printable(WHY.format(report)), soft_wrap=True)
    console.print(f"Plant time ran {TIME_SCALE} times faster than the clock; the logs say so.")
    console.print(printable(f"Everything is in {folder}; {elapsed_s:.1f} s in all."), soft_wrap=True)
    console.print(printable(f"Next: cutgate audit show {reviews[-1]['log']}"), soft_wrap=True)


def _move(verdict: dict[str, Any] | None) -> str:
    """Where the guidance says the bone should go, as a line; empty where there is none."""
    guidance = verdict and verdict["guidance"]
    if not guidance or guidance["translation_mm"] is None:
        return ""
    x, y, z = guidance["translation_mm"]
    how = "verified" if guidance["verified"] else "NOT verified"
    return f"  smallest move of the bone: x {x:+.1f}  y {y:+.1f}  z {z:+.1f} mm ({how})\n"


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command("demo")(demo)
