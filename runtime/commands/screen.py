"""What people see: consoles, and a sign of life for work that takes longer than half a second."""

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from rich.console import Console

PATIENCE_S: Final = 0.5
PLAIN_WIDTH: Final = 100


def output() -> Console:
    """Standard output; without colours and of fixed width when it is no terminal."""
    return _console(sys.stdout.isatty(), stderr=False)


def messages() -> Console:
    """Standard error, for progress and refusals."""
    return _console(sys.stderr.isatty(), stderr=True)


def _console(terminal: bool, *, stderr: bool) -> Console:
    if terminal:
        return Console(stderr=stderr, highlight=False)
    return Console(stderr=stderr, highlight=False, no_color=True, width=PLAIN_WIDTH, soft_wrap=False)


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
