"""What people see: consoles, a sign of life for work that takes longer than half a second, and screens for a loop.

What is printed is data. Nothing in it is markup, and no control character of a file, a name or the bus reaches a
terminal: consoles and `echo` show each as an escape. A line end in a value must not begin a line of its own, and only
who prints the value knows that it is one: `printable`.
"""

import errno
import io
import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import IO, Any, Final, TextIO, cast

import typer
from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

from cutgate.config.exits import READER_GONE
from cutgate.config.screen import STDERR, STDOUT, Screen, nobody_reads, printable, write_nowhere

PATIENCE_S: Final = 0.5
PLAIN_WIDTH: Final = 100


class LiteralConsole(Console):
    """A console that shows what it is given as it stands."""

    def __init__(self, **options: Any) -> None:
        super().__init__(markup=False, emoji=False, highlight=False, **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """What rich makes of it, with the control characters of its text escaped."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(literal(segment.text), segment.style)

    def on_broken_pipe(self) -> None:
        """Nobody reads any more: that is no verdict, and of messages alone no matter."""
        self.quiet = True
        write_nowhere(STDERR if self.stderr else STDOUT)
        if not self.stderr:
            raise typer.Exit(READER_GONE)


def literal(text: str) -> str:
    """The text with everything escaped but what is printable, and the ends of its lines."""
    return "\n".join(printable(line) for line in text.split("\n"))


def output() -> Console:
    """Standard output; without colours and of fixed width when it is no terminal."""
    return LiteralConsole(**_style(terminal=sys.stdout.isatty()))


def messages() -> Console:
    """Standard error, for progress and refusals: what cannot be written there is of no matter."""
    return LiteralConsole(
        stderr=True, file=cast("IO[str]", _Unheard(sys.stderr)), **_style(terminal=sys.stderr.isatty())
    )


class _Unheard:
    """A stream whose reader may be gone, and its disk full. It is not ours to close."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    @property
    def encoding(self) -> str:
        return self._stream.encoding

    def isatty(self) -> bool:
        return self._stream.isatty()

    def fileno(self) -> int:
        return self._stream.fileno()

    def write(self, text: str) -> int:
        with suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except OSError:
            write_nowhere(self._stream.fileno())


def _style(*, terminal: bool) -> dict[str, Any]:
    """How a console writes. What is no terminal gets no colours, whatever the environment forces, and a fixed width."""
    return {} if terminal else {"force_terminal": False, "no_color": True, "width": PLAIN_WIDTH}


def delivered(text: str, *, err: bool = False) -> bool:
    """Print it on standard output or error; False when nobody is there to read it, nor what is printed after it."""
    try:
        typer.echo(literal(text), err=err)
    except OSError as error:
        if not err and not nobody_reads(error):
            raise
        write_nowhere(STDERR if err else STDOUT)
        return False
    return True


def echo(text: str, *, err: bool = False) -> None:
    """Print lines of text.

    Raises:
        typer.Exit: nobody reads standard output any more; with a code that is no verdict's.
    """
    if not delivered(text, err=err) and not err:
        raise typer.Exit(READER_GONE)


def no_room(error: BaseException) -> bool:
    """Whether an error says that what was to be written does not fit where it goes; nothing more is written there."""
    if not isinstance(error, OSError) or error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return False
    write_nowhere(STDOUT)
    return True


@contextmanager
def working(what: str) -> Iterator[None]:
    """Says on standard error what is being done once it has taken half a second; silent before."""
    console = messages()
    told = Text(printable(what))
    status = console.status(told) if console.is_terminal else None
    begin = status.start if status else lambda: console.print(told, "...")
    timer = threading.Timer(PATIENCE_S, begin)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()
        if status:
            status.stop()


class LiveConsole:
    """A console for a loop: it hands over what to print, and the screen's own thread makes and prints it.

    Args:
        screen: standard output or error.
    """

    def __init__(self, screen: Screen) -> None:
        terminal = os.isatty(screen.descriptor)
        self._screen = screen
        self._console = LiteralConsole(
            file=io.StringIO(), **{"force_terminal": terminal, **_style(terminal=terminal)}
        )

    def print(self, make: Callable[[], RenderableType], *, soft_wrap: bool = False) -> None:
        """Print what this returns, out of data that do not change any more.

        Args:
            make: makes what is printed.
            soft_wrap: leave it to the terminal where a line is broken.
        """
        self._screen.show(lambda: self._printed(make(), soft_wrap=soft_wrap))

    def _printed(self, what: RenderableType, *, soft_wrap: bool) -> str:
        with self._console.capture() as capture:
            self._console.print(what, soft_wrap=soft_wrap)
        return capture.get()
