"""A runtime and a simulated controller on a bus that takes its time: arbitration, bit time, queues, errors.

Both loops wait as the programs do, and time passes when both wait.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cutgate.firmware_sim.bus.medium.bits import Rates
from cutgate.firmware_sim.bus.medium.medium import Carried, Event
from cutgate.firmware_sim.bus.virtual_time import VirtualTime, VirtualTimeBus
from cutgate.protocol.records import Side
from cutgate.runtime.interlock.phases import ENDED
from tests.runtime.session.pair import Pair, _readable
from tests.runtime.session.wire import CONTROLLER, RUNTIME, Clock

CLASSIC, FLEXIBLE = Rates(1_000_000), Rates(1_000_000, 5_000_000)
LOOK_S = 0.02
"""A loop that would wait longer looks all the same: disk and people do not wake it here."""


class TimelineClock(Clock):
    """The clock of the bus."""

    def __init__(self, time: VirtualTime) -> None:
        self._time = time

    def __call__(self) -> float:
        return self._time.clock()

    def monotonic_ns(self) -> int:
        return self._time.now_ns

    @property  # type: ignore[override]
    def now_s(self) -> float:
        return self._time.clock()

    @now_s.setter
    def now_s(self, value: float) -> None:
        self._time.now_ns = round(value * 1e9)


class Bench:
    """In place of the bus in memory: two nodes on a wire, and what was on it."""

    def __init__(self, time: VirtualTime, fd: bool) -> None:
        self.time = time
        self.nodes: dict[Side, VirtualTimeBus] = {side: time.join(side.name, fd=fd) for side in Side}
        self.carried: list[Carried] = []
        time.watchers.append(self._seen)

    def _seen(self, event: Event) -> None:
        if isinstance(event, Carried):
            self.carried.append(event)


class WiredPair(Pair):
    """A pair on such a bus."""

    rates = CLASSIC
    queue_frames = 10
    restart_s: float | None = None

    def _clock(self) -> Clock:
        rates = FLEXIBLE if self.fd and self.rates is CLASSIC else self.rates
        self.time = VirtualTime(rates, queue_frames=self.queue_frames, restart_s=self.restart_s)
        return TimelineClock(self.time)

    def _wire(self) -> Any:
        return Bench(self.time, bool(self.fd))

    def power_up(self, *faults: str, **options: Any) -> None:
        super().power_up(*faults, **options)
        self._loop(CONTROLLER, self._controller_turns, self.process._wait_s)

    def begin(self, job: Any = None) -> Pair:
        super().begin(job)
        self._loop(RUNTIME, self._runtime_turns, self._runtime_waits_s)
        return self

    def _loop(self, side: Side, turn: Callable[[], None], wait_s: Callable[[], float]) -> None:
        bus = self.wire.nodes[side]
        self.time.remove(bus)
        self.time.add(bus, turn, lambda: min(LOOK_S, wait_s()))

    def _controller_turns(self) -> None:
        if self.controller_runs:
            self.process.run_cycle(_readable(self.controller_terminal.reader.descriptor))

    def _runtime_turns(self) -> None:
        if self.runtime_runs and self.phase not in ENDED:
            assert self.session is not None
            self.session.run_cycle(_readable(self.terminal.reader.descriptor, self.prover.fileno()))

    def _runtime_waits_s(self) -> float:
        assert self.session is not None
        return 0.0 if self.session._verifying.busy else self.session._cycle.wait_s()

    def run_cycle(self) -> None:
        """A little time passes, in which both loops turn as often as they do."""
        self.time.run(self.cycle_s)


@contextmanager
def wired(directory: Path, files: Any, job: Any, fd: Any = (), **options: Any) -> Iterator[WiredPair]:
    """A pair on a wire with these rates, queues or pauses."""
    kind = type("WiredPair", (WiredPair,), options)
    pair = kind(directory, files, job, fd)
    try:
        yield pair
    finally:
        for close in pair.closing:
            close()
