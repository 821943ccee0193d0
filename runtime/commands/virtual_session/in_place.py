"""What a session starts beside its loop, done in the loop's place: in virtual time nothing runs beside it."""

import os
import socket
from typing import Any

from cutgate.protocol.records import TreeHead
from cutgate.runtime.session.messages import Request, framed
from cutgate.runtime.session.prover import answered
from cutgate.runtime.session.witness import WitnessSearch
from cutgate.runtime.session.worker import Line, Worker


class ThisProcess:
    """Stands for the verification process."""

    def __init__(self) -> None:
        self.pid = os.getpid()
        self.stderr: Any = None

    def poll(self) -> int | None:
        """It runs."""
        return None

    def wait(self, timeout: float | None = None) -> int:  # noqa: ARG002 - as Popen's
        """Nothing is waited for."""
        return 0

    def kill(self) -> None:
        """Nobody is killed."""


class VerifierInPlace(Worker):
    """The verification process without the process: what it says crosses a socket all the same.

    Args:
        path: the canonical path.
    """

    def __init__(self, path: bytes) -> None:
        ours, self._theirs = socket.socketpair()
        super().__init__(ThisProcess(), Line(ours))
        self._path = path

    def submit(self, request: Request) -> None:
        """Verify, and have it answered when this returns."""
        for answer in answered(request.body(), self._path):
            self._theirs.sendall(framed(answer.model_dump_json().encode()))

    def close(self) -> None:
        """Hang up."""
        self._theirs.close()
        super().close()


class WitnessInPlace(WitnessSearch):
    """The look-up without its thread: its answer is heard in the next cycle."""

    def begin(self, log: TreeHead) -> None:
        """Look up this log."""
        self._run(log)
