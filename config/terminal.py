"""Words from a keyboard or a pipe, for a loop that must never wait for them."""

import os
import sys
import time
from contextlib import suppress
from enum import StrEnum
from threading import Thread
from typing import Final, Generic, TypeVar

from cutgate.config.signals import none_here

STDIN: Final = 0
READ_BYTES: Final = 64
"""In one cycle of a loop, a dozen words: each may become a record, and somebody may paste thousands."""
PASSED_ON_BYTES: Final = 4096
LINE_BYTES_MAX: Final = 256
CUT: Final = b"..."
"""Stands for what a line is too long by."""
AGAIN_S: Final = 0.2
"""How often a terminal that belongs to another job is asked again."""
TRIES: Final = 5
"""So often in a row reading must fail in the foreground until nobody is listened to any more."""

W = TypeVar("W", bound=StrEnum)


def open_standard_streams() -> None:
    """Whichever of the three standard streams is closed leads nowhere from now on: at the start of every program.

    Else the next file or socket takes its number, and what is said to a person is written into that.
    """
    for descriptor, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(descriptor)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)  # the lowest number that is free: this one
            os.set_inheritable(opened, True)
        if getattr(sys, name) is None:
            stream = open(descriptor, "w" if descriptor else "r", closefd=False)  # noqa: SIM115
            setattr(sys, name, stream)


class CommandReader(Generic[W]):
    """Splits what arrives on a descriptor into words of one vocabulary.

    Args:
        descriptor: file descriptor to read from; poll it, then call :meth:`read`.
        vocabulary: the commands there are.
    """

    def __init__(self, descriptor: int, vocabulary: type[W]) -> None:
        self.descriptor: int | None = descriptor
        self._vocabulary = vocabulary
        self._rest = b""

    def read(self) -> list[W | str]:
        """The words that have arrived; what is not in the vocabulary comes back as text, to be refused.

        Call it only when the descriptor is readable. At end of file ``descriptor`` becomes None.
        """
        if self.descriptor is None:
            return []
        try:
            data = os.read(self.descriptor, READ_BYTES)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:  # the end of the file ends its last line
            self.descriptor = None
            data = b"\n"
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[: LINE_BYTES_MAX + 1]  # one byte too many says that it is too long
        texts = [_text(line) for line in lines]
        return [self._command(text) for text in texts if text]

    def _command(self, text: str) -> W | str:
        try:
            return self._vocabulary(text)
        except ValueError:
            return text[:LINE_BYTES_MAX]


def _text(line: bytes) -> str:
    """No word is so long, padding included, however the line arrived: what is cut off must not make one of it."""
    whole = line if len(line) <= LINE_BYTES_MAX else line[:LINE_BYTES_MAX] + CUT
    return whole.decode("ascii", "replace").strip().lower()


def typed(vocabulary: type[W], descriptor: int = STDIN) -> CommandReader[W]:
    """The words that arrive on a descriptor which others may share: a thread of its own reads it, through a pipe.

    Between the news that something has arrived and the reading of it, another program may take it away, and the
    reader waits; and a terminal that belongs to another job suspends whoever reads it. Neither may happen to a loop.
    """
    reading, writing = os.pipe2(os.O_CLOEXEC)
    os.set_blocking(reading, False)
    Thread(target=_pass_on, args=(descriptor, writing), name="commands", daemon=True).start()
    return CommandReader(reading, vocabulary)


def _pass_on(source: int, sink: int) -> None:
    """Everything from the one to the other, until either ends."""
    none_here()  # a terminal of another job then fails, instead of suspending the whole program
    with suppress(BrokenPipeError):
        while data := _read(source):
            os.write(sink, data)
    os.close(sink)


def _read(source: int) -> bytes:
    """What arrives next; empty at the end of the file, or when it cannot be read any more."""
    failed = 0
    while failed < TRIES:
        try:
            return os.read(source, PASSED_ON_BYTES)
        except OSError as error:
            # Somebody who shares it may have made it fail instead of wait; and a terminal that belonged to another job
            # when it was read may be ours by now.
            passes = isinstance(error, BlockingIOError) or _in_background(source)
            failed = 0 if passes else failed + 1
        time.sleep(AGAIN_S)
    return b""


def _in_background(terminal: int) -> bool:
    """Whether it is a terminal that belongs to another job."""
    try:
        return os.tcgetpgrp(terminal) != os.getpgrp()
    except OSError:
        return False
