"""``cutgate bus``: the hub as a process of its own, what it counts, and the errors it can be told to make."""

import argparse
import json
import re
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Final, TextIO

from cutgate.config.bus import LOCAL_CHANNEL, RuntimeDirectoryError, socket_path
from cutgate.config.exits import OK, REFUSED
from cutgate.config.screen import STDERR, STDOUT, diverted, last_words, printable, screens, write_nowhere
from cutgate.config.signals import ENDING, handled
from cutgate.config.terminal import STDIN
from cutgate.firmware_sim.bus import stat
from cutgate.firmware_sim.bus.ask import NotAnsweredError, counts, let_err
from cutgate.firmware_sim.bus.carriers import Paced
from cutgate.firmware_sim.bus.hub import Hub, HubError
from cutgate.firmware_sim.bus.medium.bits import Rates
from cutgate.firmware_sim.bus.medium.errors import WireFault
from cutgate.firmware_sim.bus.medium.medium import QUEUE_FRAMES


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve until Ctrl-C or another signal that ends programs.

    Returns:
        0 after a clean end, 2 when the socket or the log cannot be had (one line on stderr).
    """
    options = _parser().parse_args(arguments)
    try:
        return int(COMMANDS[options.command](options))
    except (HubError, NotAnsweredError, RuntimeDirectoryError, ValueError) as error:
        last_words(f"cutgate bus: {error}")
        return REFUSED


def _serve(options: argparse.Namespace) -> int:
    pace = None
    if options.bitrate is not None:
        rates = Rates(options.bitrate, options.fd)
        restart_s = None if options.restart_ms == 0 else options.restart_ms / 1000
        pace = partial(_paced, rates, options.queue, restart_s)
    elif options.fd is not None:
        raise ValueError("--fd is the bit rate of the data phase; give --bitrate as well")
    serve(options.socket, options.log, pace=pace, until_stdin_closes=options.until_stdin_closes)
    return OK


def _paced(rates: Rates, queue: int, restart_s: float | None, report: Callable[[str], None]) -> Paced:
    return Paced(rates, queue_frames=queue, restart_s=restart_s, report=report)


class _ToldToEnd(Exception):  # noqa: N818 - no error
    """A signal that ends programs has come."""


def _told_to_end(_number: int) -> None:
    raise _ToldToEnd


def _stat(options: argparse.Namespace) -> int:
    """Counts between two looks, again and again; of one document with --json."""
    path = socket_path(options.socket)
    if options.json:
        _say(json.dumps(counts(path), indent=2).splitlines())
        return OK
    try:
        with handled(ENDING, _told_to_end):
            _look_again_and_again(path, options.count, options.interval)
    except _ToldToEnd:
        write_nowhere(STDOUT)  # what a reader who does not read was still to have
    return OK


def _look_again_and_again(path: Path, count: int | None, interval_s: float) -> None:
    before, since_s = counts(path), time.monotonic()
    looked = 0
    while looked != count:
        time.sleep(interval_s)
        after, now_s = counts(path), time.monotonic()
        if not _say(stat.page(before, after, now_s - since_s)):
            return
        before, since_s, looked = after, now_s, looked + 1


def _say(lines: Iterable[str]) -> bool:
    """Print lines; False where they cannot be written: the program's end says why."""
    try:
        print("\n".join(map(printable, lines)), flush=True)  # noqa: T201 - what was asked for
    except OSError:
        return False
    return True


def _inject(options: argparse.Namespace) -> int:
    wanted = {
        "error": options.error,
        "identifier": options.id,
        "sender": options.sender,
        "receiver": options.receiver,
        "skip": options.skip,
        "count": options.count,
    }
    answer = let_err(
        socket_path(options.socket), {key: value for key, value in wanted.items() if value is not None}
    )
    if answer.startswith("refused"):
        raise ValueError(answer)
    _say([answer])
    return OK


COMMANDS: Final = {"serve": _serve, "stat": _stat, "inject": _inject}


def serve(
    channel: str = LOCAL_CHANNEL,
    log: str | None = None,
    *,
    pace: Callable[[Callable[[str], None]], Paced] | None = None,
    until_stdin_closes: bool = False,
) -> None:
    """Run a hub in this process's main thread until Ctrl-C or another signal that ends programs.

    Prints `serving on PATH` once clients can connect.

    Args:
        channel: the socket's path, or a name in the user's runtime directory.
        log: a new file for the frames, in the form of `candump -L`; an existing one is refused.
        pace: makes what carries the frames at the speed of a wire; without it they are carried at once.
        until_stdin_closes: end as well when standard input is closed.

    Raises:
        HubError: the socket or the log cannot be had.
        RuntimeDirectoryError: the runtime directory is not this user's own.
        ValueError: `channel` is neither a path nor a name.
    """
    with ExitStack() as stack:
        output, messages = stack.enter_context(screens(STDOUT, STDERR))
        stack.enter_context(diverted(messages))
        hub = stack.enter_context(
            Hub(socket_path(channel), pace=pace, report=lambda line: messages.say(f"bus: {line}"))
        )
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
    _add_socket(serve_)
    serve_.add_argument("--log", metavar="FILE", help="write every frame to FILE as candump -L does")
    serve_.add_argument(
        "--bitrate", type=rate_bit_s, metavar="RATE", help="model the wire at this rate, e.g. 1M or 250k"
    )
    serve_.add_argument("--fd", type=rate_bit_s, metavar="RATE", help="of the data of FD frames, e.g. 5M")
    serve_.add_argument(
        "--queue",
        type=queue_frames,
        default=QUEUE_FRAMES,
        metavar="FRAMES",
        help="that each transmit queue holds, 10",
    )
    serve_.add_argument(
        "--restart-ms",
        type=_whole(0, 60_000),
        default=0,
        metavar="MS",
        help="after which a node that is bus-off comes back; 0: never",
    )
    serve_.add_argument(
        "--until-stdin-closes", action="store_true", help="end with whoever holds standard input"
    )
    stat_ = commands.add_parser(
        "stat", help="load, error counters, queues and who talks most", allow_abbrev=False
    )
    _add_socket(stat_)
    stat_.add_argument("--interval", type=_seconds, default=1.0, metavar="S", help="between two looks, 1 s")
    stat_.add_argument(
        "--count", type=_whole(1, 10**9), metavar="N", help="looks; without it until Ctrl-C", default=None
    )
    stat_.add_argument("--json", action="store_true", help="one look: everything counted since it began")
    inject_ = commands.add_parser("inject", help="let errors of the wire come", allow_abbrev=False)
    _add_socket(inject_)
    inject_.add_argument("error", choices=[*WireFault], help="which one")
    inject_.add_argument("--id", type=_hexadecimal, metavar="HEX", help="of frames with this identifier")
    inject_.add_argument("--sender", type=_whole(1, 10**9), metavar="CLIENT", help="of frames of this client")
    inject_.add_argument(
        "--receiver", type=_whole(1, 10**9), metavar="CLIENT", help="seen by this client alone"
    )
    inject_.add_argument("--skip", type=_whole(0, 10**6), metavar="N", help="frames that pass first")
    inject_.add_argument("--count", type=_whole(1, 10**6), metavar="N", help="how many, 1")
    return parser


def _add_socket(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--socket", default=LOCAL_CHANNEL, metavar="S", help="socket path, or a name in the runtime directory"
    )


RATE_BIT_S: Final = (10_000, 8_000_000)
_RATE: Final = re.compile(r"([0-9]{1,8})([kM]?)")


def rate_bit_s(text: str) -> int:
    """A bit rate as people write it, bit/s. Raises argparse.ArgumentTypeError for what is none."""
    found = _RATE.fullmatch(text)
    low, high = RATE_BIT_S
    bit_s = int(found[1]) * {"": 1, "k": 1000, "M": 1_000_000}[found[2]] if found else 0
    if not low <= bit_s <= high:
        raise argparse.ArgumentTypeError(f"{text!r}: give 10k to 8M, in bit/s, with k or M behind it")
    return bit_s


def _whole(low: int, high: int) -> Callable[[str], int]:
    def parse(text: str) -> int:
        if not re.fullmatch("[0-9]{1,10}", text) or not low <= int(text) <= high:
            raise argparse.ArgumentTypeError(f"{text!r}: give a whole number of {low} to {high}")
        return int(text)

    return parse


def queue_frames(text: str) -> int:
    """So many frames a transmit queue may hold. Raises argparse.ArgumentTypeError for any other number."""
    return _whole(1, 10_000)(text)


def _hexadecimal(text: str) -> int:
    if not re.fullmatch("[0-9A-Fa-f]{1,8}", text):
        raise argparse.ArgumentTypeError(f"{text!r}: give an identifier in hexadecimal, e.g. 080")
    return int(text, 16)


def _seconds(text: str) -> float:
    if not re.fullmatch(r"[0-9]{1,4}(\.[0-9]{1,3})?", text) or float(text) <= 0.0:
        raise argparse.ArgumentTypeError(f"{text!r}: give seconds above 0, e.g. 0.5")
    return float(text)
