"""Bus, simulated controller and runtime as processes of their own, and what is said to them on their cues."""

import json
import os
import selectors
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, Final

from cutgate.config.bus import LOCAL_INTERFACE, default_interface, runtime_directory
from cutgate.config.interpreter import program
from cutgate.runtime.demo.script import CUES, PLAN, TIME_SCALE, Cue

DEADLINE_S: Final = 60.0
END_S: Final = 10.0

Say = Callable[[str, str], None]
"""Shows a line: whose, and what it says."""


class DemoError(Exception):
    """A part of the demo did not do what it should; the message says which."""


@contextmanager
def serve_bus(folder: Path, say: Say) -> Iterator[list[str]]:
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
def run_controller(folder: Path, where: list[str], say: Say) -> Iterator[subprocess.Popen[str]]:
    """The simulated controller, once its enabling device can be held."""
    command = ["sim", "--robot", "robot.toml", "--key", "site.key", "--time-scale", str(TIME_SCALE)]
    arguments = program("cutgate.firmware_sim", *command, *where)
    with _process("controller", arguments, cwd=folder) as child:
        _wait_for(child, "enabling device released", "controller", say)
        yield child


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


def _wait_for(child: subprocess.Popen[str], text: str, name: str, say: Say) -> None:
    """Show the child's lines until one holds ``text``."""
    assert child.stdout is not None  # noqa: S101 - a pipe was asked for
    for line in child.stdout:
        say(name, line.rstrip())
        if text in line:
            return
    raise DemoError(f"the {name} ended with code {child.wait(END_S)} before it was ready")


def run_session(
    folder: Path,
    registration: str,
    where: list[str],
    controller: subprocess.Popen[str],
    say: Say,
) -> dict[str, Any]:
    """One ``cutgate run --json``, with the commands of operator and controller given on their cues."""
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
        converse({"runtime": runtime, "controller": controller}, say)
        assert runtime.stdout is not None  # noqa: S101 - a pipe was asked for
        text = runtime.stdout.read()
        code = runtime.wait(END_S)
    if not text:
        raise DemoError(f"the runtime ended with code {code} and no result")
    result: dict[str, Any] = json.loads(text)
    result["exit_code"] = code
    for name in ("mcap", "candump"):
        result["log"][name] = str(folder / result["log"][name])
    return result


def converse(children: dict[str, subprocess.Popen[str]], say: Say) -> None:
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
                    answer(cues, text, children, say)
        last_lines = "; ".join(f"the {name} last said: {last[number]}" for number, (name, _) in talk.items())
    raise DemoError(f"the session did not end within {DEADLINE_S:g} s; {last_lines}")


def answer(cues: list[Cue], text: str, children: dict[str, subprocess.Popen[str]], say: Say) -> None:
    """Give the commands whose cue this line is, each once."""
    for cue in [cue for cue in cues if cue.text in text]:
        cues.remove(cue)
        say("demo", f"says to the {cue.to}: {cue.command}")
        stream = children[cue.to].stdin
        assert stream is not None  # noqa: S101 - a pipe was asked for
        with suppress(BrokenPipeError):  # it has just ended, and its last lines say why
            os.write(stream.fileno(), f"{cue.command}\n".encode())
