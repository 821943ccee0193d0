"""A bus in virtual time, as who takes part in it sees it; the fixture `cutgate_virtual` is one (docs/hil.md)."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Protocol

import can


class InputPaths(Protocol):
    """The files that a session reads."""

    @property
    def plan(self) -> Path: ...  # noqa: D102
    @property
    def robot(self) -> Path: ...  # noqa: D102
    @property
    def registration(self) -> Path: ...  # noqa: D102
    @property
    def site(self) -> Path | None: ...  # noqa: D102
    @property
    def key(self) -> Path: ...  # noqa: D102


class BusInVirtualTime(Protocol):
    """Who takes part lets time pass while it waits."""

    key: Path
    site: Path | None

    def open(self, name: str = "", *, fd: bool = False) -> can.BusABC:
        """One more node."""

    def now_s(self) -> float:
        """Monotonic seconds of it."""

    def wait(self, bus: can.BusABC, seconds: float) -> None:
        """Let time pass until this node has something to read, at most so long."""

    def random(self, size: int) -> bytes:
        """Bytes that are the same in every run."""


class BenchInVirtualTime(BusInVirtualTime, Protocol):
    """Such a bus with a folder for logs, a day, a controller, and loops that take turns."""

    folder: Path

    @property
    def files(self) -> InputPaths:
        """What sessions read."""

    @property
    def sessions(self) -> list[Any]:
        """Those that have joined."""

    def monotonic_ns(self) -> int:
        """Nanoseconds."""

    def utc_ns(self) -> int:
        """The time of day there."""

    def until(self, condition: Callable[[], bool], timeout_s: float = 20.0) -> None:
        """Let time pass until it holds; raises where it does not in time."""

    def type(self, command: str) -> None:
        """One operator command at the controller."""

    def join(
        self,
        bus: can.BusABC,
        turn: Callable[[], None],
        wait_s: Callable[[], float],
        session: Any = None,
    ) -> None:
        """One more program, and the session that it runs."""


LogRead = tuple[Iterable[str], Iterable[tuple[str, Mapping[str, Any]]]]
"""Why a log is not whole, empty where it is; its records, each with its topic."""
