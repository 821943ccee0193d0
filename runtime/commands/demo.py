"""``cutgate demo``: the whole story in one go, with every part in a process of its own.

Hub (or vcan0), simulated controller and runtime are started as a user would start them, and driven by the words
a user would type. A first registration is refused and explained, a second one is admitted and cut to the end.
"""

import json as json_format
import os
import secrets
import selectors
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Annotated, Any, Final

import typer
from rich.text import Text

from cutgate.config.bus import LOCAL_INTERFACE, default_interface, runtime_directory
from cutgate.config.exits import SIGNALLED, STOPPED
from cutgate.config.interpreter import program
from cutgate.config.key import new_key_file
from cutgate.config.load import EXAMPLES
from cutgate.config.screen import printable
from cutgate.config.signals import ENDING, handled, name_of
from cutgate.protocol.permit import KEY_BYTES
from cutgate.protocol.states import StopCause
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.reading import candump_of, reading
from cutgate.runtime.audit.replay import Outcome, replay
from cutgate.runtime.commands.example import fill
from cutgate.runtime.commands.screen import echo, messages, output
from cutgate.runtime.commands.verdict_view import BAD, GOOD
from cutgate.runtime.review.comparison import print_comparison
from cutgate.runtime.review.show import print_time_line
from cutgate.runtime.review.story import story
from cutgate.runtime.session.job import VERIFIER
from cutgate.runtime.verification import certified

PLAN: Final = "hip-stem.plan.json"
STORY: Final = {
    "registration-first.json": ("inadmissible", "not_admitted"),
    "registration-second.json": ("admissible", "completed"),
}
"""Each session's registration, its verdict and how it is to end."""
SETTINGS: Final = ("robot.toml", "site.toml")
TIME_SCALE: Final = 100
DEADLINE_S: Final = 60.0
END_S: Final = 10.0
SCHEMA: Final = "cutgate.demo/1"


@dataclass(frozen=True)
class Cue:
    """When a line of one process holds ``text``, say ``word`` to another."""

    text: str
    to: str
    word: str


CUES: Final = (
    Cue(
        "say acknowledge", "runtime", "acknowledge"
    ),  # of a stop that came late to the session before, if any did
    Cue("permitted: cutting mode is on", "controller", "hold"),
    Cue("enabling device is held: say start", "runtime", "start"),
)
"""The operator and the person at the controller, as a table."""


LATE: Final = frozenset({StopCause.HEARTBEAT_LOST.name, StopCause.LOOP_STALLED.name})
STALLED: Final = "this computer stood still"
"""What the controller says of its own lateness."""
TOO_BUSY: Final = (
    "runtime and controller share this machine, and one of them did not get the processor in time: run the demo again with "
    "less beside it, or with priority: chrt --rr 10 cutgate demo (docs/timing.md says who may)"
)


class DemoError(Exception):
    """A part of the demo did not do what it should; the message says which."""


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
            _bus(folder, say) as where,
            _controller(folder, [*where, *framing], say) as controller,
        ):
            for registration in STORY:
                run = _run(folder, registration, [*where, *framing], controller, say)
                runs.append(run)
                why = departure(registration, run, say.stalled)
                if why:  # what follows needs this one
                    break
    except DemoError as error:
        why = [str(error)]
    as_told = not why
    reviews = [_review(Path(run["log"]["mcap"])) for run in runs]
    why += [
        f"{review['log']}: verify {review['verify']}, replay {review['replay']}"
        for review in reviews
        if (review["verify"], review["replay"]) != ("OK", Outcome.IDENTICAL.name)
    ]
    elapsed_s = time.monotonic() - began_s
    if json:
        document = {
            "schema": SCHEMA,
            "as_told": not why,
            "why": why,
            "sessions": runs,
            "reviews": [{key: review[key] for key in ("log", "verify", "replay")} for review in reviews],
            "elapsed_s": elapsed_s,
        }
        echo(json_format.dumps(document, allow_nan=False, indent=2))
    elif as_told:
        _summary(runs, reviews, folder, elapsed_s)
    if why:
        _otherwise(why, runs, folder)
    raise typer.Exit(STOPPED if why else 0)


# ---------------------------------------------------------------- parts


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


@contextmanager
def _bus(folder: Path, say: _Teller) -> Iterator[list[str]]:
    """vcan0 where the kernel has it, else a hub of our own; as options of a command."""
    interface, channel = default_interface()
    if interface != LOCAL_INTERFACE:
        say("demo", f"using {interface}/{channel}")
        yield ["--interface", interface, "--channel", channel]
        return
    socket = runtime_directory() / f"demo-{os.getpid()}.sock"
    command = ["bus", "serve", "--socket", str(socket), "--log", str(folder / "bus.candump.log")]
    with _process("bus", program("cutgate.firmware_sim", *command)) as hub:
        _wait_for(hub, "serving on", "bus", say)
        yield ["--interface", LOCAL_INTERFACE, "--channel", str(socket)]


@contextmanager
def _controller(folder: Path, where: list[str], say: _Teller) -> Iterator[subprocess.Popen[str]]:
    command = ["sim", "--robot", "robot.toml", "--key", "site.key", "--time-scale", str(TIME_SCALE)]
    arguments = program("cutgate.firmware_sim", *command, *where)
    with _process("controller", arguments, cwd=folder) as controller:
        _wait_for(controller, "enabling device released", "controller", say)
        yield controller


@contextmanager
def _process(name: str, arguments: list[str], *, cwd: Path | None = None) -> Iterator[subprocess.Popen[str]]:
    """A process that is ended by SIGINT after the block, and killed if it does not end."""
    child = subprocess.Popen(  # noqa: S603 - our own program
        arguments,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT if name != "runtime" else subprocess.PIPE,
        text=True,
        bufsize=1,
        cwd=cwd,
    )
    try:
        yield child
    finally:
        if child.poll() is None:
            child.send_signal(signal.SIGINT)
        try:
            child.wait(END_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait(END_S)


def _wait_for(child: subprocess.Popen[str], text: str, name: str, say: _Teller) -> None:
    """Show the child's lines until one holds ``text``."""
    assert child.stdout is not None  # noqa: S101 - a pipe was asked for
    for line in child.stdout:
        say(name, line.rstrip())
        if text in line:
            return
    raise DemoError(f"the {name} ended with code {child.wait(END_S)} before it was ready")


def _run(
    folder: Path,
    registration: str,
    where: list[str],
    controller: subprocess.Popen[str],
    say: _Teller,
) -> dict[str, Any]:
    """One ``cutgate run --json``, with the words of operator and controller given on their cues."""
    say("demo", f"session with {registration}")
    files = [
        "--robot",
        "robot.toml",
        "--registration",
        registration,
        "--site",
        "site.toml",
        "--key",
        "site.key",
        "--allow-simulated",
    ]
    options = [*files, *where, "--log-dir", "logs", "--json"]
    arguments = program("cutgate.runtime.cli", "run", PLAN, *options)
    with _process("runtime", arguments, cwd=folder) as runtime:
        _converse({"runtime": runtime, "controller": controller}, say)
        assert runtime.stdout is not None  # noqa: S101 - a pipe was asked for
        text = runtime.stdout.read()
        code = runtime.wait(END_S)
    if not text:
        raise DemoError(f"the runtime ended with code {code} and no result")
    result: dict[str, Any] = json_format.loads(text)
    result["exit_code"] = code
    for name in ("mcap", "candump"):
        result["log"][name] = str(folder / result["log"][name])
    return result


def _converse(children: dict[str, subprocess.Popen[str]], say: _Teller) -> None:
    """Show what both say and answer the cues until the runtime's standard error ends."""
    cues = list(CUES)
    talk: dict[int, tuple[str, IO[str]]] = {}
    with selectors.DefaultSelector() as selector:
        for name, child in children.items():
            stream = child.stderr if name == "runtime" else child.stdout
            assert stream is not None  # noqa: S101 - pipes were asked for
            selector.register(stream.fileno(), selectors.EVENT_READ)
            talk[stream.fileno()] = (name, stream)
        rest, last = dict.fromkeys(talk, b""), dict.fromkeys(talk, "nothing")
        until_s = time.monotonic() + DEADLINE_S
        while (left_s := until_s - time.monotonic()) > 0.0:
            for key, _ in selector.select(left_s):
                name, _stream = talk[key.fd]
                data = os.read(key.fd, 65536)
                if not data and name == "runtime":
                    return
                if not data:
                    raise DemoError(f"the controller ended; it last said: {last[key.fd]}")
                *lines, rest[key.fd] = (rest[key.fd] + data).split(b"\n")
                for line in lines:
                    last[key.fd] = text = line.decode("utf-8", "replace").rstrip()
                    say(name, text)
                    _answer(cues, text, children, say)
        said = "; ".join(f"the {name} last said: {last[number]}" for number, (name, _) in talk.items())
    raise DemoError(f"the session did not end within {DEADLINE_S:g} s; {said}")


def _answer(cues: list[Cue], text: str, children: dict[str, subprocess.Popen[str]], say: _Teller) -> None:
    for cue in [cue for cue in cues if cue.text in text]:
        cues.remove(cue)
        say("demo", f"says to the {cue.to}: {cue.word}")
        stream = children[cue.to].stdin
        assert stream is not None  # noqa: S101 - a pipe was asked for
        with suppress(BrokenPipeError):  # it has just ended, and its last lines say why
            os.write(stream.fileno(), f"{cue.word}\n".encode())


# ---------------------------------------------------------------- what came of it


def departure(registration: str, run: dict[str, Any], stalled: list[str]) -> list[str]:
    """Why a session did not end as it was to, and what to do; nothing where it did.

    Args:
        registration: the session's.
        run: what ``run --json`` said.
        stalled: what the controller said of its own lateness.
    """
    ended = ((run["verdict"] or {}).get("verdict", "no verdict"), run["outcome"])
    if ended == STORY[registration]:
        return []
    was_to_be, became = (", ".join(words).replace("_", " ") for words in (STORY[registration], ended))
    why = [f"the session with {registration} was to be {was_to_be}, and became {became}: {run['reason']}"]
    if run["cause"] in LATE:
        why += [*stalled, TOO_BUSY]
    return why


def _otherwise(why: list[str], runs: list[dict[str, Any]], folder: Path) -> None:
    """What went otherwise than told, and what is left behind."""
    console = messages()
    for reason in why:
        console.print(Text(printable(f"demo: {reason}"), BAD), soft_wrap=True)
    logs = ", ".join(Path(run["log"]["mcap"]).name for run in runs) or "no log"
    left = (
        f"Left behind: {folder} with key, inputs and logs of whole sessions ({logs}); nothing runs any more."
    )
    console.print(printable(left), soft_wrap=True)
    if runs:
        console.print(printable(f"Next: cutgate audit show {runs[-1]['log']['mcap']}"), soft_wrap=True)


def _review(path: Path) -> dict[str, Any]:
    """The log verified, replayed and told."""
    with reading(path) as log:
        again = replay(log, certified.verify, verifier=VERIFIER)
        told = story(log, path, candump_of(path))
    return {
        "log": str(path),
        "verify": "OK" if log.report.status is Status.OK else log.report.status.name,
        "headline": log.report.headline,
        "replay": again.outcome.name,
        "why": [*log.report.reasons, *again.differences],
        "story": told,
    }


def _summary(
    runs: list[dict[str, Any]], reviews: list[dict[str, Any]], folder: Path, elapsed_s: float
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
        words = f"{review['headline']}, replay {review['replay']}"
        style = GOOD if review["verify"] == "OK" and review["replay"] == Outcome.IDENTICAL.name else BAD
        console.print(Text.assemble(printable(f"{review['log']}: "), (words, style)), soft_wrap=True)
        for reason in review["why"]:
            console.print(printable(f"  {reason}"), soft_wrap=True)
    console.print(f"Plant time ran {TIME_SCALE} times faster than the clock; the logs say so.")
    console.print(printable(f"Everything is in {folder}; {elapsed_s:.1f} s in all."), soft_wrap=True)
    console.print(printable(f"Next: cutgate audit show {reviews[-1]['log']}"), soft_wrap=True)


def _move(verdict: dict[str, Any] | None) -> str:
    """Where the guidance says the bone should go, as a line; empty where there is none."""
    guidance = verdict and verdict["guidance"]
    if not guidance or guidance["translation_mm"] is None:
        return ""
    x, y, z = guidance["translation_mm"]
    word = "verified" if guidance["verified"] else "NOT verified"
    return f"  smallest move of the bone: x {x:+.1f}  y {y:+.1f}  z {z:+.1f} mm ({word})\n"


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command("demo")(demo)
