"""A person's screen, as seen from a loop that must never wait for it.

The loop hands over and goes on; a thread of its own owns the descriptor. Whoever looks on may stop reading, be slow or
go away, and the terminal may belong to another job: nothing of it reaches the loop.
"""

import errno
import io
import os
import select
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from queue import Empty, SimpleQueue
from threading import RLock, Thread
from typing import Final

from cutgate.config.exits import NOT_WRITTEN, READER_GONE
from cutgate.config.signals import none_here

STDOUT: Final = 1
STDERR: Final = 2
WAITING_MAX: Final = 500
"""Lines, or whole answers, that wait for a screen. Of more the oldest are dropped."""
LINE_MAX: Final = 2000
"""Characters of one line."""
SHOWN_MAX: Final = 50_000
"""Characters of one answer."""
FLUSH_S: Final = 1.0
"""How long the end of a program waits for its screens."""


def printable(text: str) -> str:
    """The text with control characters, line ends and what turns the reading direction escaped: it is data."""
    return "".join(one if one.isprintable() else ascii(one)[1:-1] for one in text)


class Screen:
    """One screen. Handing something over to it never waits, raises or is refused.

    If it cannot keep up, the oldest that waits is dropped, and it says how much; once nobody is there any more (a
    closed pipe, a terminal that is gone) it is silent.

    Args:
        descriptor: where to.
    """

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._waiting: SimpleQueue[tuple[int, str | Callable[[], str]] | None] = SimpleQueue()
        self._lock = RLock()
        self._handed_over = 0
        self._gone = False
        # A daemon: a screen that nobody reads must not keep the process from ending.
        self._thread = Thread(target=self._run, name=f"screen-{descriptor}", daemon=True)
        self._thread.start()

    def say(self, line: str) -> None:
        """One line, with what is not printable escaped."""
        self._hand_over(line if len(line) <= LINE_MAX else f"{line[:LINE_MAX]}...")

    def show(self, answer: Callable[[], str]) -> None:
        """What this returns, line ends included; the screen's thread calls it, for making it takes time."""
        self._hand_over(answer)

    def end(self) -> None:
        """Nothing more will be handed over."""
        self._waiting.put(None)

    def wait(self, timeout_s: float) -> bool:
        """After the end, wait until everything is written, at most so long; whether it is."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _hand_over(self, item: str | Callable[[], str]) -> None:
        with self._lock:  # nobody does anything slow in it
            if self._waiting.qsize() >= WAITING_MAX:
                with suppress(Empty):  # the thread has taken it meanwhile
                    self._waiting.get_nowait()
            self._waiting.put((self._handed_over, item))
            self._handed_over += 1

    # ------------------------------------------------------------ the thread

    def _run(self) -> None:
        none_here()  # a terminal of another job, which would suspend who writes to it, lets this thread write
        expected = 0
        while (taken := self._waiting.get()) is not None:
            number, item = taken
            if number > expected:
                self._write(f"({number - expected} lines dropped here: the screen did not keep up)\n")
            self._write(_text(item))
            expected = number + 1

    def _write(self, text: str) -> None:
        data = text.encode(getattr(sys.__stderr__, "encoding", "utf-8"), "backslashreplace")
        while data and not self._gone:
            try:
                data = data[os.write(self.descriptor, data) :]
            except BlockingIOError:  # somebody who shares it has made it so
                self._wait_for_room()
            except OSError:
                self._gone = True

    def _wait_for_room(self) -> None:
        poller = select.poll()
        poller.register(self.descriptor, select.POLLOUT)
        poller.poll()


def _text(item: str | Callable[[], str]) -> str:
    """What is written, of a bounded length."""
    if isinstance(item, str):
        return f"{printable(item)}\n"
    try:
        text = item()
    except Exception as error:  # noqa: BLE001 - the thread goes on, and whoever looks on is told
        return f"{printable(f'(cannot be shown: {type(error).__name__}: {error})'[:LINE_MAX])}\n"
    return text if len(text) <= SHOWN_MAX else f"{text[:SHOWN_MAX]}\n(and more than a screen holds)\n"


@contextmanager
def screens(*descriptors: int) -> Iterator[tuple[Screen, ...]]:
    """A screen for each; the same one for two that lead to the same place, where lines must keep their order.

    Leaving the block waits for all of them together, for a bounded time.
    """
    made: list[Screen] = []
    for descriptor in descriptors:
        same = (one for one in made if os.path.sameopenfile(one.descriptor, descriptor))
        made.append(next(same, None) or Screen(descriptor))
    try:
        yield tuple(made)
    finally:
        until_s = time.monotonic() + FLUSH_S
        for screen in made:
            screen.end()
        for screen in made:
            screen.wait(max(0.0, until_s - time.monotonic()))


@contextmanager
def diverted(screen: Screen) -> Iterator[None]:
    """Nothing in this block prints but through the screen: libraries and the interpreter neither."""
    stream = _Diverted(screen)
    with redirect_stdout(stream), redirect_stderr(stream):
        yield


class _Diverted(io.TextIOBase):
    """Stands for ``sys.stdout`` and ``sys.stderr``, and hands lines over."""

    def __init__(self, screen: Screen) -> None:
        super().__init__()
        self._screen = screen
        self._rest = ""

    def writable(self) -> bool:
        return True

    def write(self, text: str) -> int:
        *lines, rest = (self._rest + text).split("\n")
        self._rest = rest[:LINE_MAX]
        for line in lines:
            self._screen.say(line)
        return len(text)


def nobody_reads(error: OSError) -> bool:
    """Whether an error says that a pipe has no reader any more, or a terminal is gone."""
    return error.errno in (errno.EPIPE, errno.EIO)


def write_nowhere(descriptor: int) -> None:
    """From now on; also what the stream still holds."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, descriptor)
    os.close(nowhere)


def ended(code: int) -> int:
    """The exit code of a program whose own is this one, once its standard output is written: or another, if it is not."""
    try:
        sys.stderr.flush()
    except OSError:  # messages that nobody reads change no code
        write_nowhere(STDERR)
    try:
        sys.stdout.flush()
    except OSError as error:
        write_nowhere(STDOUT)
        if nobody_reads(error):
            return READER_GONE
        last_words(f"cutgate: what was to be written is not whole: {error.strerror}")
        return NOT_WRITTEN
    return code


def last_words(text: str) -> None:
    """Lines on standard error before the program ends, whether or not anybody reads them."""
    with screens(STDERR) as (screen,):
        for line in text.split("\n"):
            screen.say(line)
