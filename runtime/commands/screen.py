"""What people see: consoles, a sign of life for work that takes longer than half a second, and screens for a loop."""

import errno
import io
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final

import typer
from rich.console import Console, RenderableType

from cutgate.config.screen import STDERR, STDOUT, Screen

PATIENCE_S: Final = 0.5
PLAIN_WIDTH: Final = 100


def output() -> Console:
    """Standard output; without colours and of fixed width when it is no terminal."""
    return _console(sys.stdout.isatty(), stderr=False)


def messages() -> Console:
    """Standard error, for progress and refusals."""
    return _console(sys.stderr.isatty(), stderr=True)


def _console(terminal: bool, *, stderr: bool) -> Console:
    return Console(stderr=stderr, **_style(terminal=terminal))


def _style(*, terminal: bool) -> dict[str, Any]:
    """How a console writes. What is no terminal gets no colours, whatever the environment forces, and a fixed width."""
    if terminal:
        return {"highlight": False}
    return {"highlight": False, "force_terminal": False, "no_color": True, "width": PLAIN_WIDTH}


def delivered(text: str, *, err: bool = False) -> bool:
    """Print it on standard output or error; False when nobody is there to read it, nor what is printed after it."""
    try:
        typer.echo(text, err=err)
    except OSError as error:
        if error.errno not in (errno.EPIPE, errno.EIO):
            raise
        nowhere = os.open(os.devnull, os.O_WRONLY)  # for what the stream still holds
        os.dup2(nowhere, STDERR if err else STDOUT)
        os.close(nowhere)
        return False
    return True


@contextmanager
def working(what: str) -> Iterator[None]:
    """Says on standard error what is being done once it has taken half a second; silent before."""
    console = messages()
    status = console.status(what) if console.is_terminal else None
    begin = status.start if status else lambda: console.print(f"{what} ...")
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
        self._console = Console(
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
