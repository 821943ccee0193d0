"""A program of ours as a process: what it says, line by line, and what is typed at it. Every wait has an end."""

import os
import re
import subprocess
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Final

from cutgate.config.screen import printable

WAIT_S: Final = 20.0
"""What a line, or an end, may take on the slowest machine before the program counts as hung."""
LINES_MAX: Final = 20_000
LINE_MAX: Final = 2000
DOCUMENT_MAX: Final = 4_000_000
"""Lines kept, characters of each, and characters of a document: the rest is read and dropped."""
TOLD_LINES: Final = 200


class HilTimeoutError(AssertionError):
    """What was waited for did not come; the text holds the last lines that did."""


class HilProcess:
    """One process. Nothing that it says holds it up: it is read all the time.

    Args:
        name: in messages.
        command: what to start.
        environment: of the process.
        document: its standard output is one document, kept apart from the lines of standard error.
    """

    def __init__(
        self, name: str, command: Sequence[str], environment: Mapping[str, str], *, document: bool = False
    ) -> None:
        self.name = name
        self.document = ""
        self._lines: list[str] = []
        self._seen = 0
        self._changed = threading.Condition()
        self._process = subprocess.Popen(  # noqa: S603 - our own programs
            [*command],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE if document else subprocess.STDOUT,
            env=dict(environment),
            start_new_session=True,  # Ctrl-C at pytest ends the test, which ends this in order
        )
        spoken, apart = self._process.stdout, self._process.stderr
        assert spoken is not None  # noqa: S101 - a pipe was asked for
        self._readers = [self._reader(spoken if apart is None else apart, self._read_lines)]
        if apart is not None:
            self._readers.append(self._reader(spoken, self._read_document))

    def _reader(self, stream: IO[bytes], read: Callable[[IO[bytes]], None]) -> threading.Thread:
        thread = threading.Thread(target=read, args=(stream,), name=f"{self.name}-output", daemon=True)
        thread.start()
        return thread

    def _read_lines(self, stream: IO[bytes]) -> None:
        while line := stream.readline(LINE_MAX):
            with self._changed:
                if len(self._lines) < LINES_MAX:
                    self._lines.append(printable(line.decode("utf-8", "replace").rstrip("\r\n")))
                self._changed.notify_all()
        with self._changed:
            self._changed.notify_all()

    def _read_document(self, stream: IO[bytes]) -> None:
        while data := stream.read(65536):
            if len(self.document) < DOCUMENT_MAX:
                self.document += data.decode("utf-8", "replace")

    # ------------------------------------------------------------ what a test does

    @property
    def pid(self) -> int:
        """Its process number."""
        return self._process.pid

    @property
    def lines(self) -> tuple[str, ...]:
        """Everything it has said so far."""
        with self._changed:
            return tuple(self._lines)

    @property
    def told(self) -> str:
        """The last lines, for a person."""
        return "\n".join(self.lines[-TOLD_LINES:])

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        return self._process.poll() is None

    def type(self, command: str) -> None:
        """Type one line at its terminal. Of a program that has ended the exit code tells."""
        stream = self._process.stdin
        assert stream is not None  # noqa: S101 - a pipe was asked for
        with suppress(BrokenPipeError, ValueError):  # its end has been seen: the stream is closed
            stream.write(f"{command}\n".encode())
            stream.flush()

    def expect(self, pattern: str, timeout_s: float = WAIT_S) -> str:
        """The next line that matches; lines before it are passed over.

        Args:
            pattern: a regular expression, found anywhere in the line.
            timeout_s: how long to wait.

        Raises:
            HilTimeoutError: no such line, or the program ended before.
        """
        __tracebackhide__ = True  # of a test that fails its own line is shown
        until_s = time.monotonic() + timeout_s
        with self._changed:
            while True:
                while self._seen < len(self._lines):
                    line = self._lines[self._seen]
                    self._seen += 1
                    if re.search(pattern, line):
                        return line
                left_s = until_s - time.monotonic()
                if left_s <= 0.0 or not self._readers[0].is_alive():
                    break
                self._changed.wait(min(left_s, 0.5))
        raise HilTimeoutError(f"{self.name} did not say {pattern!r}; it said\n{self.told}")

    def exit_code(self, timeout_s: float = WAIT_S) -> int:
        """Wait for its end; negative for a signal.

        Raises:
            HilTimeoutError: it goes on.
        """
        try:
            code = self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            raise HilTimeoutError(f"{self.name} did not end; it said\n{self.told}") from None
        for reader in self._readers:
            reader.join(WAIT_S)
        return code

    def end(self, timeout_s: float = WAIT_S) -> int:
        """Have it end as Ctrl-C would, and if it does not, kill it. Returns its exit code."""
        if self.running:
            self._process.terminate()
        try:
            self.exit_code(timeout_s)
        except HilTimeoutError:
            self._process.kill()
        code = self.exit_code()
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None:
                with suppress(BrokenPipeError):
                    stream.close()
        return code


def environment(state: Path) -> dict[str, str]:
    """This process's, with a folder of its own for what a user's account would keep, as the keys of logs."""
    return {**os.environ, "XDG_STATE_HOME": str(state)}
