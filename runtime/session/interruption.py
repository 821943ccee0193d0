"""Signals that would end or suspend the program only wake the session's loop; the table decides what they mean."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

from cutgate.config.signals import ENDING, SUSPENDING, handled, name_of, wake_pipe
from cutgate.config.signals import wake as write_wake
from cutgate.runtime.session.loop import Session

TOLD: Final[dict[int, str]] = {
    signal.SIGINT: "",
    signal.SIGHUP: "SIGHUP: the terminal hung up, and nobody can say stop any more",
    signal.SIGTSTP: "SIGTSTP (Ctrl-Z): a suspended runtime could not watch the arm",
    signal.SIGTTIN: "SIGTTIN (reading in the background): a suspended runtime could not watch the arm",
    signal.SIGTTOU: "SIGTTOU (writing in the background): a suspended runtime could not watch the arm",
}
"""What is said of a signal that ends the session, where its name is not enough; Ctrl-C needs no telling."""


@dataclass
class Signals:
    """What a signal does: it interrupts the session, now or as soon as there is one, and wakes its loop."""

    wake: int
    arrived: str | None = None
    """The signal's name; empty for Ctrl-C."""
    session: Session | None = None

    def interrupts(self, session: Session) -> None:
        """This is the session to interrupt; one that arrived before counts."""
        self.session = session
        if self.arrived is not None:
            session.interrupt(self.arrived)


@contextmanager
def signals_wake(tell: Callable[[str], None]) -> Iterator[Signals]:
    """From before the log is made until after it is closed: no Ctrl-C leaves it open.

    Args:
        tell: told what is to be said of a signal, as soon as it arrives; must not wait.
    """
    reading, writing = wake_pipe()
    signals = Signals(reading)

    def interrupt(number: int) -> None:
        signals.arrived = "" if number == signal.SIGINT else name_of(number)
        tell(TOLD.get(number, name_of(number)))
        if signals.session is not None:
            signals.session.interrupt(signals.arrived)
        write_wake(writing)

    try:
        with handled(ENDING | SUSPENDING, interrupt):
            yield signals
    finally:
        os.close(reading)
        os.close(writing)
