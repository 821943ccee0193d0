"""``cutgate bus serve``: the hub as a process of its own."""

import argparse
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TextIO

from cutgate.config.bus import LOCAL_CHANNEL, RuntimeDirectoryError, socket_path
from cutgate.config.exits import OK, REFUSED
from cutgate.config.screen import STDERR, STDOUT, diverted, last_words, screens
from cutgate.config.signals import ENDING, handled
from cutgate.config.terminal import STDIN
from cutgate.firmware_sim.bus.hub import Hub, HubError


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve until Ctrl-C or another signal that ends programs.

    Returns:
        0 after a clean end, 2 when the socket or the log cannot be had (one line on stderr).
    """
    options = _parser().parse_args(arguments)
    try:
        serve(options.socket, options.log, until_stdin_closes=options.until_stdin_closes)
    except (HubError, RuntimeDirectoryError, ValueError) as error:
        last_words(f"cutgate bus: {error}")
        return REFUSED
    return OK


def serve(channel: str = LOCAL_CHANNEL, log: str | None = None, *, until_stdin_closes: bool = False) -> None:
    """Run a hub in this process's main thread until Ctrl-C or another signal that ends programs.

    Prints `serving on PATH` once clients can connect.

    Args:
        channel: the socket's path, or a name in the user's runtime directory.
        log: a new file for the frames, in the form of `candump -L`; an existing one is refused.
        until_stdin_closes: end as well when standard input is closed.

    Raises:
        HubError: the socket or the log cannot be had.
        RuntimeDirectoryError: the runtime directory is not this user's own.
        ValueError: `channel` is neither a path nor a name.
    """
    with ExitStack() as stack:
        output, messages = stack.enter_context(screens(STDOUT, STDERR))
        stack.enter_context(diverted(messages))
        hub = stack.enter_context(Hub(socket_path(channel), report=lambda line: messages.say(f"bus: {line}")))
        stack.enter_context(handled(ENDING, lambda _number: hub.stop(), hub.wake))
        if log is not None:
            hub.log_to(stack.enter_context(_new_log(log)))
        if until_stdin_closes:
            hub.stop_when_closed(STDIN)
        output.say(f"serving on {hub.path}")
        hub.serve()


def _new_log(name: str) -> TextIO:
    try:
        return Path(name).open("x", encoding="ascii")
    except OSError as error:
        raise HubError(f"log {name}: {error.strerror}; give a new file in a directory that exists") from error


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="cutgate bus", description="The local virtual CAN bus.", allow_abbrev=False
    )
    commands = parser.add_subparsers(dest="command", required=True)
    serve_ = commands.add_parser(
        "serve", help="run the hub until Ctrl-C or another signal that ends programs", allow_abbrev=False
    )
    serve_.add_argument(
        "--socket", default=LOCAL_CHANNEL, metavar="S", help="socket path, or a name in the runtime directory"
    )
    serve_.add_argument("--log", metavar="FILE", help="write every frame to FILE as candump -L does")
    serve_.add_argument(
        "--until-stdin-closes", action="store_true", help="end with whoever holds standard input"
    )
    return parser
