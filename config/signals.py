"""Signals that would end a program by default, and what its loop makes of them: an end in order."""

import contextlib
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, Final

_LEFT_ALONE: Final = frozenset(
    {signal.SIGKILL, signal.SIGSTOP}  # cannot be caught
    | {signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL}  # what they interrupt cannot go on
    | {signal.SIGCHLD, signal.SIGCONT, signal.SIGURG, signal.SIGWINCH}  # do nothing by default
    | {signal.SIGPIPE, signal.SIGXFSZ}  # Python ignores them: the write fails instead
    | {signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU}  # suspend
)  # fmt: skip
ENDING: Final = frozenset(signal.valid_signals() - _LEFT_ALONE)
"""End a process by default: Ctrl-C, a terminal that hangs up, kill, a limit of processor time, and the rest.

Of faults of the program itself those after which it goes on; abort() ends it all the same once it was told so.
"""
SUSPENDING: Final = frozenset({signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU})
"""Ctrl-Z, and a terminal that belongs to another job, of which a program of the same job reads or writes."""


def name_of(number: int) -> str:
    """As people know it; most real-time signals have no name of their own."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


@contextmanager
def handled(numbers: frozenset[int], act: Callable[[int], None], wake: int | None = None) -> Iterator[None]:
    """Each of these signals does this and nothing else, in the main thread, between two steps of the program.

    A hang-up that is ignored stays ignored: who starts a program behind ``nohup`` means it. One that has been acted
    on is ignored from then on: kernel and shell both send it, and the second must not change the exit code.

    Args:
        numbers: the signals.
        act: told the signal's number; it waits for nothing and raises nothing.
        wake: a non-blocking pipe, into which each signal at once writes a byte. Who waits without a bound must wait
            for its other end as well: a signal that comes just before it begins to wait does not end the waiting.
    """
    before: dict[int, Any] = {}

    def arrived(number: int, _frame: FrameType | None) -> None:
        if number == signal.SIGHUP:
            before[number] = signal.SIG_IGN
        act(number)

    woken = None if wake is None else signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    for number in numbers:
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
            before[number] = signal.signal(number, arrived)
    try:
        yield
    finally:
        if woken is not None:
            signal.set_wakeup_fd(woken)
        for number, handler in before.items():
            signal.signal(number, handler or signal.SIG_DFL)  # None: it was not Python's


def wake_pipe() -> tuple[int, int]:
    """A non-blocking pipe for signal handlers: (read end, write end)."""
    reading, writing = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    return reading, writing


def wake(descriptor: int) -> None:
    """Make the other end of a non-blocking pipe readable. One that is full is readable already."""
    with contextlib.suppress(BlockingIOError):
        os.write(descriptor, b"\0")


def none_here() -> None:
    """The calling thread handles no signal: it neither delays one for the main thread nor is suspended by one."""
    signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
