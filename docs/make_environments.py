"""Writes ``docs/environments.md``: ``python -m docs.make_environments``.

Every command is started in every surrounding that a person, a shell or a service may give it, as a process of its own;
the page holds its exit codes. The script fails where one is not what it must be, or where a traceback is seen.
"""
# ruff: noqa: INP001, S603

import fcntl
import os
import pty
import select
import signal
import struct
import subprocess
import sys
import tempfile
import termios
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import can

from cutgate.config.bus import LOCAL_INTERFACE, open_bus
from cutgate.config.exits import NOT_WRITTEN, READER_GONE
from cutgate.config.interpreter import program
from cutgate.config.load import EXAMPLES
from tests.runtime.audit.build import session_log

PAGE: Final = Path(__file__).parent / "environments.md"
WAIT_S: Final = 60.0
"""A bound, not an expectation."""
AT_ONCE: Final = 2
"""Columns that are tried at the same time: the cores of a small machine."""


class Seen(NamedTuple):
    """What came of one command."""

    code: int
    told: str


@dataclass(frozen=True)
class Surrounding:
    """Where and how a command is started.

    Attributes:
        name: as the page calls it.
        code: what the exit code must be, by the ordinary one.
        line: of the shell, with what it does to the streams; ``"$@"`` is the command.
        before: what the shell does first, in the working directory.
        environment: variables set, or with None removed.
        columns: of a terminal, None without one.
        reader_gone: nobody reads standard output.
        folder: prepares the working directory.
    """

    name: str
    code: Callable[[int], int] = lambda ordinary: ordinary
    line: str = 'exec "$@"'
    before: str = ":"
    environment: Mapping[str, str | None] = field(default_factory=dict)
    columns: int | None = None
    reader_gone: bool = False
    folder: Callable[[Path], None] = lambda _folder: None


def _planted(folder: Path) -> None:
    """Modules of common names that must not be taken."""
    for name in (
        "can",
        "config",
        "json",
        "numpy",
        "runtime",
        "signal",
        "multiprocessing",
    ):
        (folder / f"{name}.py").write_text("raise SystemExit(99)\n", encoding="utf-8")


def _gone(_ordinary: int) -> int:
    return READER_GONE


def _full(_ordinary: int) -> int:
    return NOT_WRITTEN


SURROUNDINGS: Final = (
    Surrounding("ordinary: three pipes"),
    Surrounding("standard input closed", line='exec "$@" <&-'),
    Surrounding("standard output closed", line='exec "$@" >&-'),
    Surrounding("standard error closed", line='exec "$@" 2>&-'),
    Surrounding("all three closed", line='exec "$@" <&- >&- 2>&-'),
    Surrounding("reader of the output gone", code=_gone, reader_gone=True),
    Surrounding("output to a full disk", code=_full, line='exec "$@" > /dev/full'),
    Surrounding("standard error to a full disk", line='exec "$@" 2> /dev/full'),
    *(Surrounding(f"terminal of {columns} columns", columns=columns) for columns in (20, 40, 80, 120, 200)),
    Surrounding("terminal, TERM=dumb", columns=80, environment={"TERM": "dumb"}),
    Surrounding("terminal, NO_COLOR=1", columns=80, environment={"NO_COLOR": "1"}),
    Surrounding("pipe, FORCE_COLOR=1", environment={"FORCE_COLOR": "1"}),
    *(
        Surrounding(f"locale {name}", environment={"LC_ALL": name, "PYTHONUTF8": "0"})
        for name in ("C", "POSIX", "de_DE.ISO-8859-1")
    ),
    Surrounding("PYTHONIOENCODING=ascii", environment={"PYTHONIOENCODING": "ascii"}),
    Surrounding("no HOME, no PATH", environment={"HOME": None, "PATH": ""}),
    Surrounding("TMPDIR does not exist", environment={"TMPDIR": "/nonexistent"}),
    Surrounding("no XDG_RUNTIME_DIR", environment={"XDG_RUNTIME_DIR": None}),
    Surrounding("working directory with modules of our names", folder=_planted),
    Surrounding("the same, and PYTHONPATH=.", folder=_planted, environment={"PYTHONPATH": "."}),
    Surrounding("working directory removed", before='rmdir "$PWD"'),
    Surrounding("1.5 GB of address space", before="ulimit -v 1500000"),
    Surrounding("64 open files", before="ulimit -n 64"),
    Surrounding("SIGPIPE, SIGHUP, SIGINT ignored", before="trap '' PIPE HUP INT"),
)


def one_shot(files: Path) -> dict[str, tuple[Sequence[str], int]]:
    """Commands that answer and end, with their ordinary exit codes; those that write do so into a fresh folder."""
    robot = ["--robot", str(EXAMPLES / "robot.toml")]
    plan = [str(EXAMPLES / "hip-stem.plan.json"), *robot]
    second = ["--registration", str(EXAMPLES / "registration-second.json")]
    log = str(next(files.glob("*.mcap")))
    logs = files / "demo" / "logs"
    cut = str(max(logs.glob("*.mcap")))
    wire = str(files / WIRE)
    return {
        "--help": (["--help"], 0),
        "verify": (["verify", *plan, *second], 0),
        "verify --json": (["verify", *plan, *second, "--json"], 0),
        "recheck": (["recheck", str(files / "proof"), *plan, *second], 0),
        "reach": (
            ["reach", *plan, *second, "--step-mm", "400", "--cores", "1", "--out", "{fresh}/map.csv"],
            0,
        ),
        "register": (["register", str(files / "landmarks.csv"), "--out", "{fresh}/registration.json"], 0),
        "example": (["example", "{fresh}/example"], 0),
        "key new": (["key", "new", "{fresh}/key"], 0),
        "key session": (
            [
                "key",
                "session",
                cut,
                "--key",
                str(files / "demo" / "site.key"),
                "--out",
                "{fresh}/session.key",
            ],
            0,
        ),
        "key fingerprint": (["key", "fingerprint", str(files / "site.key")], 0),
        "config show": (["config", "show", "--site", str(EXAMPLES / "site.toml")], 0),
        "config check": (["config", "check", *plan[:1], str(EXAMPLES / "site.toml")], 0),
        "audit verify": (["audit", "verify", log], 0),
        "audit show": (["audit", "show", log], 0),
        "audit replay": (["audit", "replay", log], 0),
        "audit diff": (["audit", "diff", log, log], 0),
        "audit export": (["audit", "export", log, "--to", "jsonl"], 0),
        "audit report": (["audit", "report", cut, "-o", "{fresh}/report.html"], 0),
        "audit list": (["audit", "list", str(logs)], 0),
        "audit archive": (
            ["audit", "archive", str(logs), "--to", "{fresh}/old", "--before", "2001-01-01"],
            0,
        ),
        "audit prove": (["audit", "prove", cut, "--record", "1", "--out", "{fresh}/record.proof"], 0),
        "audit check-proof": (["audit", "check-proof", str(files / "record.proof")], 0),
        "audit recover": (
            ["audit", "recover", str(files / "torn.mcap"), "--out", "{fresh}/recovered.mcap"],
            0,
        ),
        "decode": (["decode", str(files / "bus.log")], 0),
        "bus stat": (["bus", "stat", "--socket", wire, "--count", "1", "--interval", "0.1"], 0),
        "bus stat --json": (["bus", "stat", "--socket", wire, "--json"], 0),
        "bus inject": (["bus", "inject", "bit", "--id", "7ff", "--socket", wire], 0),
    }


WIRE: Final = "wire.sock"
"""Of a hub that models the wire."""
UNREAD: Final = ("key new", "key session", "audit prove")
"""Say nothing on standard output: whoever does not read it misses nothing."""


# ---------------------------------------------------------------- one command in one surrounding


def started(
    arguments: Sequence[str], where: Surrounding, fresh: Path, **streams: Any
) -> subprocess.Popen[bytes]:
    """The installed command, as a shell starts it in this surrounding."""
    folder = fresh / "here"
    folder.mkdir()
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    for name, value in where.environment.items():
        environment.pop(name, None)
        if value is not None:
            environment[name] = value
    command = [
        str(Path(sys.executable).with_name("cutgate")),
        *(one.format(fresh=fresh) for one in arguments),
    ]
    where.folder(folder)

    go = f'cd "{folder}"; {where.before}; {where.line}'
    return subprocess.Popen(["/bin/sh", "-c", go, "sh", *command], env=environment, **streams)


Meanwhile = Callable[[subprocess.Popen[bytes], Path], None]
"""What is done to a command while it runs, and with its fresh folder."""


def tried(
    arguments: Sequence[str], where: Surrounding, meanwhile: Meanwhile = lambda _process, _fresh: None
) -> Seen:
    """The exit code and everything that was said."""
    with tempfile.TemporaryDirectory() as fresh:
        if where.columns is not None:
            return _in_a_terminal(arguments, where, Path(fresh), meanwhile)
        output: int = subprocess.PIPE
        if where.reader_gone:
            reading, output = os.pipe()
            os.close(reading)
        process = started(
            arguments, where, Path(fresh), stdin=subprocess.PIPE, stdout=output, stderr=subprocess.PIPE
        )
        if where.reader_gone:
            os.close(output)
        meanwhile(process, Path(fresh))
        out, err = process.communicate(timeout=WAIT_S)
        return Seen(process.returncode, ((out or b"") + err).decode("utf-8", "replace"))


def _in_a_terminal(arguments: Sequence[str], where: Surrounding, fresh: Path, meanwhile: Meanwhile) -> Seen:
    """All three streams are one terminal of so many columns."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, where.columns or 80, 0, 0))
    process = started(arguments, where, fresh, stdin=theirs, stdout=theirs, stderr=theirs)
    os.close(theirs)
    meanwhile(process, fresh)
    told = b""
    until_s = time.monotonic() + WAIT_S
    while time.monotonic() < until_s and select.select([ours], [], [], WAIT_S)[0]:
        try:
            data = os.read(ours, 65536)
        except OSError:  # everybody has left the terminal
            break
        told += data
    os.close(ours)
    return Seen(process.wait(WAIT_S), told.decode("utf-8", "replace"))


def wrong(seen: Seen, expected: int, where: Surrounding) -> str:
    """What must not be; empty where all is as it must be."""
    if seen.code != expected:
        return f"exit code {seen.code}, must be {expected}"
    if "Traceback" in seen.told or "internal error" in seen.told:
        return "a traceback"
    if where.columns is None and "\x1b" in seen.told:
        return "a sequence for terminals in a pipe"
    return ""


# ---------------------------------------------------------------- programs that go on


def serves(fresh: Path, _places: Mapping[str, str]) -> bool:
    """Whether the hub takes a client."""
    with suppress(can.CanInitializationError):
        open_bus(LOCAL_INTERFACE, str(fresh / "bus")).shutdown()
        return True
    return False


def speaks(_fresh: Path, places: Mapping[str, str]) -> bool:
    """Whether the controller is heard on the bus."""
    with open_bus(LOCAL_INTERFACE, places["bus"]) as bus:
        return bus.recv(1.0) is not None


def logs(fresh: Path, _places: Mapping[str, str]) -> bool:
    """Whether the session's log is there: it waits for a controller."""
    return bool(list(fresh.glob("logs/*.mcap")))


class Lasting(NamedTuple):
    """A program that goes on until it is told to end: how it is seen to be there, and its exit code then."""

    arguments: tuple[str, ...]
    there: Callable[[Path, Mapping[str, str]], bool]
    code: int


LASTING: Final = {
    "bus serve": Lasting(("bus", "serve", "--socket", "{fresh}/bus"), serves, 0),
    "sim": Lasting(
        ("sim", "--robot", "example", "--interface", "cutgate", "--channel", "{bus}", "--key", "{key}"),
        speaks,
        0,
    ),
    "run": Lasting(
        (
            *("run", "hip-stem", "--robot", "example", "--registration", "registration-second"),
            *("--interface", "cutgate", "--channel", "{bus}", "--key", "{key}", "--log-dir", "{fresh}/logs"),
        ),
        logs,
        3,
    ),
}
ENDINGS: Final = (
    *(signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGUSR1, signal.SIGALRM),
    signal.SIGXCPU,
)


def ended(
    what: Lasting, number: signal.Signals, places: Mapping[str, str], where: Surrounding = SURROUNDINGS[0]
) -> Seen:
    """It is started, and once it is there the signal comes."""

    def meanwhile(process: subprocess.Popen[bytes], fresh: Path) -> None:
        until_there(process, what, fresh, places)
        process.send_signal(number)

    return tried(asked(what, places), where, meanwhile)


def asked(what: Lasting, places: Mapping[str, str]) -> list[str]:
    """Its arguments, but for the fresh folder."""
    return [one.format(fresh="{fresh}", **places) for one in what.arguments]


def until_there(
    process: subprocess.Popen[bytes], what: Lasting, fresh: Path, places: Mapping[str, str]
) -> None:
    """Wait until it is there, or has ended."""
    until_s = time.monotonic() + WAIT_S
    while process.poll() is None and not what.there(fresh, places) and time.monotonic() < until_s:
        select.select([], [], [], 0.01)


def new_key(folder: Path) -> Path:
    """A key in this folder."""
    key = folder / "site.key"
    command = [Path(sys.executable).with_name("cutgate"), "key", "new", key]
    subprocess.run(command, check=True, capture_output=True)
    return key


@contextmanager
def a_bus(files: Path) -> Iterator[dict[str, str]]:
    """A hub and a key for those that need them."""
    key, bus = new_key(files), files / "bus"
    with a_hub(bus):
        yield {"bus": str(bus), "key": str(key)}


@contextmanager
def a_hub(place: Path, *options: str) -> Iterator[None]:
    """A hub at this place."""
    serve = ("bus", "serve", "--socket", str(place), "--until-stdin-closes", *options)
    with subprocess.Popen(
        program("cutgate.firmware_sim", *serve), stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as hub:
        assert hub.stdout is not None and hub.stdin is not None  # noqa: S101, PT018 - they are pipes
        hub.stdout.readline()
        try:
            yield
        finally:
            hub.stdin.close()


# ---------------------------------------------------------------- what it costs


METER: Final = """
import os, signal, sys
file, *command = sys.argv[1:]
process = os.fork() or os.execv(command[0], command)
signal.signal(signal.SIGTERM, lambda *_: os.kill(process, signal.SIGTERM))
_, _, used = os.wait4(process, 0)
with open(file, "w") as file:
    file.write(f"{used.ru_utime + used.ru_stime} {used.ru_maxrss / 1024}")
"""
"""Starts a command from a small process: Linux counts the memory of whoever starts a process as that process's own."""


def metered(
    arguments: Sequence[str], fresh: Path, stdout: int = subprocess.DEVNULL
) -> subprocess.Popen[bytes]:
    """A command that is measured; what it is told to end by goes through the meter."""
    command = [
        *(sys.executable, "-I", "-S", "-c", METER, str(fresh / "used")),
        str(Path(sys.executable).with_name("cutgate")),
        *(one.format(fresh=fresh) for one in arguments),
    ]
    return subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=stdout, stderr=subprocess.DEVNULL, cwd=fresh
    )


def used(process: subprocess.Popen[bytes], fresh: Path) -> tuple[float, float]:
    """Processor seconds and peak memory, MiB, of one command and all that it waits for, once it has ended."""
    process.communicate(timeout=10 * WAIT_S)  # a controller on trial takes minutes
    seconds, memory = (fresh / "used").read_text(encoding="ascii").split()
    return float(seconds), float(memory)


def least(found: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Of each."""
    return min(seconds for seconds, _ in found), min(memory for _, memory in found)


def cost(arguments: Sequence[str], times: int = 3) -> tuple[float, float]:
    """The least of so many times."""
    found = []
    for _ in range(times):
        with tempfile.TemporaryDirectory() as fresh:
            found.append(used(metered(arguments, Path(fresh)), Path(fresh)))
    return least(found)


def cost_of_lasting(what: Lasting, places: Mapping[str, str], times: int = 3) -> tuple[float, float]:
    """The same of a program that goes on: to the moment when it is there, and to its end."""
    found = []
    for _ in range(times):
        with tempfile.TemporaryDirectory() as fresh:
            process = metered(asked(what, places), Path(fresh))
            until_there(process, what, Path(fresh), places)
            process.terminate()
            found.append(used(process, Path(fresh)))
    return least(found)


def conformance(files: Path) -> dict[str, tuple[float, float]]:
    """A controller on trial, with the bus between."""
    on_trial, trying = files / "trial", files / "trying"
    on_trial.mkdir()
    trying.mkdir()
    with a_bus(on_trial) as places:
        where = ["--interface", "cutgate", "--channel", places["bus"], "--key", places["key"]]
        controller = metered(["sim", "--robot", "example", *where], on_trial, subprocess.PIPE)
        assert controller.stdout is not None  # noqa: S101 - it is a pipe
        controller.stdout.readline()
        trial = used(metered(["conform", *where, "--plant-disconnected"], trying), trying)
        controller.terminate()
        return {"conform": trial, "sim (on trial)": used(controller, on_trial)}


# ---------------------------------------------------------------- the page


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Of Markdown."""
    return [f"| {' | '.join(head)} |", "|---" * len(head) + "|", *(f"| {' | '.join(row)} |" for row in rows)]


Column = Callable[[], list[tuple[Seen, int]]]
"""What came of one command in every surrounding, and what the exit code must be."""


def of_one_shot(name: str, arguments: Sequence[str], ordinary: int) -> list[tuple[Seen, int]]:
    """Of a command that answers and ends."""
    codes = [ordinary if name in UNREAD else where.code(ordinary) for where in SURROUNDINGS]
    return [(tried(arguments, where), code) for where, code in zip(SURROUNDINGS, codes, strict=True)]


def of_lasting(what: Lasting) -> list[tuple[Seen, int]]:
    """Of a program that goes on, until SIGTERM; it is not there for its output, so that no reader is missed."""
    with tempfile.TemporaryDirectory() as own, a_bus(Path(own)) as places:
        return [(ended(what, signal.SIGTERM, places, where), what.code) for where in SURROUNDINGS]


def surroundings(files: Path, problems: list[str]) -> list[str]:
    """Every command in every surrounding."""
    columns: dict[str, Column] = {
        name: partial(of_one_shot, name, *asked_for) for name, asked_for in one_shot(files).items()
    }
    columns |= {name: partial(of_lasting, what) for name, what in LASTING.items()}
    with ThreadPoolExecutor(AT_ONCE) as pool:
        begun = {name: pool.submit(column) for name, column in columns.items()}
        found = {name: column.result() for name, column in begun.items()}
    rows = []
    for number, where in enumerate(SURROUNDINGS):
        row = [where.name]
        for name, column in found.items():
            seen, expected = column[number]
            bad = wrong(seen, expected, where)
            if bad:
                problems.append(f"{name}, {where.name}: {bad}: {seen.told[-400:]}")
            row.append(f"{seen.code}{' WRONG' if bad else ''}")
        rows.append(row)
    return table(("surrounding", *(f"`{name}`" for name in columns)), rows)


def endings(problems: list[str]) -> list[str]:
    """Every program that goes on, and every signal that ends programs."""
    rows = []
    with tempfile.TemporaryDirectory() as own, a_bus(Path(own)) as places:
        for number in ENDINGS:
            row = [number.name]
            for name, what in LASTING.items():
                seen = ended(what, number, places)
                found = wrong(seen, what.code, SURROUNDINGS[0])
                if found:
                    problems.append(f"{name}, {number.name}: {found}: {seen.told[-400:]}")
                row.append(f"{seen.code}{' WRONG' if found else ''}")
            rows.append(row)
    return table(("signal", *(f"`{name}`" for name in LASTING)), rows)


def costs(files: Path) -> list[str]:
    """What each command costs."""
    found = {name: cost(arguments) for name, (arguments, _) in one_shot(files).items()}
    found["demo (hub, controller, two sessions)"] = cost(["demo", "--out", "{fresh}/demo"], 1)
    with tempfile.TemporaryDirectory() as own, a_bus(Path(own)) as places:
        for name in ("bus serve", "run"):
            found[f"{name} (begun and ended)"] = cost_of_lasting(LASTING[name], places)
    found |= conformance(files)
    rows = [[f"`{name}`", f"{seconds:.2f}", f"{memory:.0f}"] for name, (seconds, memory) in found.items()]
    return table(("command", "processor s", "peak MiB of one process"), rows)


def made(files: Path) -> None:
    """A log, a folder of sessions, a torn one, frames, a key, proofs and landmarks to work on."""
    cutgate = Path(sys.executable).with_name("cutgate")
    session_log(files)
    subprocess.run([cutgate, "demo", "--out", files / "demo"], check=True, capture_output=True)
    signed = max((files / "demo" / "logs").glob("*.mcap"))
    (files / "torn.mcap").write_bytes(signed.read_bytes()[:-1000])
    prove = [cutgate, "audit", "prove", signed, "--record", "1", "--out", files / "record.proof"]
    subprocess.run(prove, check=True, capture_output=True)
    (files / "bus.log").write_text("(1.000000) can0 080#0011223344556677\n" * 20, encoding="utf-8")
    (files / "landmarks.csv").write_text(LANDMARKS, encoding="utf-8")
    new_key(files)
    robot = ["--robot", str(EXAMPLES / "robot.toml")]
    placed = ["--registration", str(EXAMPLES / "registration-second.json")]
    command = [cutgate, "verify", str(EXAMPLES / "hip-stem.plan.json"), *robot]
    subprocess.run([*command, *placed, "--certificate", files / "proof"], check=True, capture_output=True)


LANDMARKS: Final = """id,ct_x,ct_y,ct_z,robot_x,robot_y,robot_z,use
P1,40,-30,10,640,-30,210,fit
P2,-35,-28,5,565,-28,205,fit
P3,2,45,-12,602,45,188,fit
P4,5,3,60,605,3,260,check
"""

INTRODUCTION: Final = """# Surroundings

Every command as a process of its own, in every surrounding that somebody may start it in: its exit codes, made by
`python -m docs.make_environments`, which fails where one is not what it must be, where a traceback is seen, or a
sequence for terminals in a pipe. 141 means that nobody reads the output any more, 74 that it finds no room; they claim
nothing. `bus serve`, `sim` and `run` go on: once a client is taken, the controller is heard, the session's log is there,
they are ended by SIGTERM; who does not read them misses nothing. `demo` starts all three.

What is done to a session that cuts (unread screens, readers that go, terminals that hang up, full transmit queues and
disks) is in [terminal.md](terminal.md) and in `tests/system`."""


COSTS: Final = (
    "On the shipped hip stem (2000 poses), a map of 400 mm steps on one core, and the log of a session of 6 poses; start-up",
    "is in it. One run, two shared cores, the least of three. `bus serve` and `run` are ended as soon as they are there. A",
    "session's processes: `bus serve`, `sim`, `run` and its verification process; `demo` starts and waits for all of them.",
)


def page(problems: list[str]) -> str:
    """The whole page; what must not be is added to the problems."""
    with tempfile.TemporaryDirectory() as folder, a_hub(Path(folder) / WIRE, "--bitrate", "1M"):
        files = Path(folder)
        made(files)
        told = "To programs that go on until they are told to end; `run` waits for a controller."
        parts = [
            *(INTRODUCTION, "", *surroundings(files, problems)),
            *("", "## Signals", "", told, "", *endings(problems)),
            *("", "## What it costs", "", *COSTS, "", *costs(files)),
        ]
    return "\n".join(parts) + "\n"


def main() -> int:
    """Write the page; 1 where something is not as it must be."""
    problems: list[str] = []
    # Where whoever starts this ignores a signal (nohup, a job in the background), every program would inherit that.
    for number in ENDINGS:
        signal.signal(number, signal.SIG_DFL)
    PAGE.write_text(page(problems), encoding="utf-8")
    for problem in problems:
        print(problem, file=sys.stderr)  # noqa: T201 - a program of its own
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
