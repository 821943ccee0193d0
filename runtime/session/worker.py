"""The verification process, seen from the loop: a program of its own, so that heartbeats never wait for it.

It is started before the session opens, answers one request after the other, and ends when its socket does, so it
cannot outlive the runtime. What it says is read as bounded plain data (`messages`), and believed in nothing (`check`).
"""

import os
import select
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, Final, Protocol, Self

from cutgate.config.interpreter import program
from cutgate.runtime.session.messages import (
    ANSWER_BYTES_MAX,
    SHOWN_MAX,
    Answer,
    Broken,
    Frames,
    MessageError,
    Request,
    framed,
    parse_answer,
    shown,
)

JOIN_S = 0.5
"""It has nothing to lose: one that is busy is killed."""
KILLED_S = 5.0
"""What is killed ends at once; on a busy computer it is gone a little later."""
LAST_LINES_BYTES: Final = 1 << 16
"""So much of what the process has said on its standard error is looked at when it has failed: what a pipe holds."""


class StartedProcess(Protocol):
    """What is asked of the process itself; `subprocess.Popen` has it."""

    pid: int
    stderr: Any

    def poll(self) -> int | None: ...  # noqa: D102 - as in Popen
    def wait(self, timeout: float | None = None) -> int: ...  # noqa: D102
    def kill(self) -> None: ...  # noqa: D102


def launch(path: int, line: int) -> StartedProcess:
    """Start the verification process.

    Args:
        path: descriptor of the canonical path, to be read from its beginning.
        line: descriptor of its end of the socket.
    """
    process = subprocess.Popen(  # noqa: S603 - our own interpreter on our own module
        program("cutgate.runtime.session.prover"),
        bufsize=0,
        stdin=path,
        stdout=line,
        stderr=subprocess.PIPE,
        start_new_session=True,  # Ctrl-C is typed to the runtime's
    )
    give_priority_back(process.pid)
    return process


def give_priority_back(pid: int) -> None:
    """Seconds of arithmetic at the loop's real-time priority would take the processor from the loop."""
    with suppress(OSError):  # it has ended already
        policy = os.sched_getscheduler(pid) & ~os.SCHED_RESET_ON_FORK
        if policy in (os.SCHED_FIFO, os.SCHED_RR):
            os.sched_setscheduler(pid, os.SCHED_OTHER, os.sched_param(0))


@contextmanager
def _signals_wait() -> Iterator[None]:
    """A process started in here never sees SIGINT and SIGTERM, nor does its interpreter while it starts."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _in_memory(data: bytes) -> Iterator[int]:
    """A descriptor from which the data can be read; nobody waits until they are."""
    descriptor = os.memfd_create("cutgate-path", os.MFD_CLOEXEC)
    try:
        with open(descriptor, "wb", closefd=False) as stored:
            stored.write(data)
        os.lseek(descriptor, 0, os.SEEK_SET)
        yield descriptor
    finally:
        os.close(descriptor)


class Line:
    """This side's end of the socket.

    Args:
        connected: the socket; closed with this.
    """

    def __init__(self, connected: socket.socket) -> None:
        connected.setblocking(False)
        self._socket = connected
        self._frames = Frames(ANSWER_BYTES_MAX)

    def fileno(self) -> int:
        """Readable when an answer waits, or when nobody is at the other end any more."""
        return self._socket.fileno()

    def submit(self, request: Request) -> None:
        """Send a request; never waits for its answer."""
        with suppress(OSError):  # nobody is there: poll() says so; or nobody reads: no verdict comes in time
            self._socket.send(framed(request.body()))

    def poll(self) -> Answer | None:
        """The next answer, once all of it is there; nothing of the one after it. Never waits.

        Raises:
            MessageError: what came is no message.
            ConnectionResetError: nobody is at the other end any more.
        """
        while True:
            try:
                came = self._socket.recv(self._frames.missing)
            except BlockingIOError:
                return None
            if not came:
                raise ConnectionResetError
            body = self._frames.add(came)
            if body is not None:
                return parse_answer(body)

    def close(self) -> None:
        """Hang up."""
        self._socket.close()


class Worker:
    """The verification process: submit, poll ``fileno``, collect.

    Args:
        process: itself.
        line: what it is spoken with over.
    """

    def __init__(self, process: StartedProcess, line: Line) -> None:
        self._process = process
        self._line = line

    @classmethod
    def start(cls, path: bytes) -> Self:
        """A new one; requests to it are about this path."""
        ours, theirs = socket.socketpair()
        with theirs, _in_memory(path) as stored, _signals_wait():
            return cls(launch(stored, theirs.fileno()), Line(ours))

    @property
    def pid(self) -> int:
        """The worker's process number."""
        return self._process.pid

    def fileno(self) -> int:
        """Readable when an answer waits, or when the worker has died."""
        return self._line.fileno()

    def submit(self, request: Request) -> None:
        """Send a request; never waits for its answer."""
        self._line.submit(request)

    def poll(self) -> Answer | None:
        """The next answer, once all of it is there; Broken if it is none, or the worker has died. Never waits."""
        try:
            return self._line.poll()
        except MessageError as error:
            return Broken(reason=f"the verification process's answer is none: {error}")
        except OSError:
            return Broken(reason=f"the verification process ended{self._code}{self._last_line}")

    def wait(self, wake: int, timeout_s: float) -> Answer | None:
        """The next answer; None if it is not there in time, or somebody wants to leave.

        Args:
            wake: descriptor that becomes readable when somebody does.
            timeout_s: for so long.
        """
        until_s = time.monotonic() + timeout_s
        poller = select.poll()
        for descriptor in (wake, self.fileno()):
            poller.register(descriptor, select.POLLIN)
        while True:  # what is there already counts, however late it is by now
            left_s = max(0.0, until_s - time.monotonic())
            ready = {descriptor for descriptor, _ in poller.poll(left_s * 1000.0)}
            if wake in ready:
                return None
            answer = self.poll() if ready else None
            if answer is not None or left_s <= 0.0:
                return answer

    @property
    def _code(self) -> str:
        code = self._process.poll()
        return "" if code is None else f" with code {code}"

    @property
    def _last_line(self) -> str:
        """The last line that it said on its standard error, for people."""
        if self._process.stderr is None:
            return ""
        os.set_blocking(self._process.stderr.fileno(), False)
        printed = self._process.stderr.read(LAST_LINES_BYTES) or b""
        lines = printed.decode("utf-8", "replace").split("\n")
        last = next((line.strip() for line in reversed(lines) if line.strip()), "")
        return f": {shown(last, SHOWN_MAX)}" if last else ""

    def close(self) -> None:
        """End the worker; killed if it does not end by itself within a bounded time."""
        self._line.close()
        try:
            self._process.wait(JOIN_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(KILLED_S)
        if self._process.stderr is not None:
            self._process.stderr.close()
