"""What a session shows to a person as it goes."""

from typing import Protocol

from cutgate.runtime.interlock.state import Effect, Event, Interlock
from cutgate.runtime.session.check import Answer
from cutgate.runtime.verification.advice import Guidance


class View(Protocol):
    """Shows the session to a person; never waits for one."""

    def step(
        self, before: Interlock, event: Event, after: Interlock, effects: tuple[Effect, ...], now_s: float
    ) -> None:
        """One step of the interlock."""

    def verdict(self, answer: Answer) -> None:
        """The verdict, as soon as it counts."""

    def guidance(self, found: Guidance | None, note: str) -> None:
        """Where to move the bone; else why nothing is said of it."""

    def progress(self, segment: int, segments: int) -> None:
        """The controller is on this segment."""

    def note(self, text: str) -> None:
        """One line."""
