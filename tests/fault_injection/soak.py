"""The soak: cut after cut in virtual time, under disturbances that the protocol tolerates; none may stop a session.

What is benign, and why, is a table in docs/fault-injection.md. One thing happens at a time: what is tolerated alone may
stop where it comes together with another.
"""

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from random import Random

import can

from cutgate.firmware_sim.console import ConsoleCommand
from cutgate.protocol.frames import FRAMES
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.replay import ReplayOutcome, replay
from cutgate.runtime.interlock.phases import ENDED
from cutgate.runtime.interlock.state import Job, OperatorCommand, Phase
from cutgate.runtime.session.job import VERIFIER, InputFiles
from cutgate.runtime.verification import certified
from tests.fault_injection.injection import with_data
from tests.fault_injection.tap import SENDER
from tests.runtime.session.pair import Pair, pair_of

CYCLES = 2
"""Of both loops, in a heartbeat."""
TIME_SCALE = 0.2
"""Of the plant: a cut of some fifteen seconds."""
APART_S = (0.5, 1.5)
"""From one disturbance to the next, s: two frames that fail their CRC in a second are tolerated, and one comes at most."""
DELAY_HEARTBEATS = 0.9
"""A frame is late by less than a heartbeat."""
PAUSE_TIMEOUTS = 0.5
"""A loop stands still for half the time-out at most."""
DISK_S = (0.0, 0.2)
"""The disk takes so long for each job, s: enabling commits have a second, others five."""
PATIENCE_S = 60.0
SESSIONS_EACH = 10
"""With one pair; then everything is made anew, which bounds what a pair remembers."""
WITHOUT_EFFECT = ("start", "acknowledge", "reset", f"{OperatorCommand.CONFIRM} WITNESS")
"""Commands of the operator that apply to nothing while the arm moves."""


@dataclass
class SoakTally:
    """What happened.

    Attributes:
        sessions, cuts: begun, and completed to their end.
        frames: that passed the bus.
        disturbances: how often each was made.
        false_stops: how a session ended that was not to stop.
        logs: that are not whole, or do not fit.
        virtual_s, real_s: on the virtual clock, and of the processor.
    """

    sessions: int = 0
    cuts: int = 0
    frames: int = 0
    disturbances: Counter[str] = field(default_factory=Counter)
    false_stops: list[str] = field(default_factory=list)
    logs: list[str] = field(default_factory=list)
    virtual_s: float = 0.0
    real_s: float = 0.0

    @property
    def speed(self) -> float:
        """Virtual seconds for each of the processor."""
        return self.virtual_s / self.real_s

    def __str__(self) -> str:
        """For people."""
        kinds = ", ".join(f"{number} {name}" for name, number in self.disturbances.most_common())
        per_hour = 3600.0 * len(self.false_stops) / self.virtual_s if self.virtual_s else 0.0
        return "\n".join(
            (
                f"{self.sessions} sessions, {self.cuts} cuts completed, {self.frames} frames",
                f"disturbances: {self.disturbances.total()}: {kinds}",
                f"false stops: {len(self.false_stops)}, {per_hour:g} an hour",
                *self.false_stops[:20],
                f"logs that are not whole or do not fit: {len(self.logs)}",
                *self.logs[:20],
                f"{self.virtual_s:.0f} s of virtual time, {self.speed:.1f} for each second of the processor",
            )
        )


@dataclass
class Disturbed:
    """A pair with one disturbance after the other.

    Attributes:
        waits: what the next frame of its kind is to suffer; None where nothing waits.
    """

    pair: Pair
    draw: Random
    tally: SoakTally
    waits: tuple[str, Callable[[can.Message], list[can.Message]]] | None = None
    next_s: float = 0.0
    until_s: float = 0.0

    def __post_init__(self) -> None:
        self.pair.wire.rules.append(self._frame)
        self._next()

    def _next(self) -> None:
        self.next_s = self.pair.clock() + self.draw.uniform(*APART_S)

    def _frame(self, message: can.Message) -> list[can.Message]:
        """Single frames alone: what a transfer loses ends it, and the conversation with it."""
        self.tally.frames += 1
        if self.waits is None or message.arbitration_id not in FRAMES:
            return [message]
        (name, act), self.waits = self.waits, None
        self.tally.disturbances[name] += 1
        self._next()
        return act(message)

    def turn(self) -> None:
        """What begins and ends in this cycle."""
        pair, now_s = self.pair, self.pair.clock()
        if now_s >= self.until_s:
            pair.runtime_runs = pair.controller_runs = True
        if (
            now_s < self.next_s
            or self.waits is not None
            or pair.phase not in (Phase.CUTTING, Phase.PERMITTED)
        ):
            return
        name = self.draw.choice([*self.FRAME, *self.ACTS])
        if name in self.FRAME:
            self.waits = name, lambda message: self.FRAME[name](self, message)
        else:
            self.tally.disturbances[name] += 1
            self.ACTS[name](self)
            self._next()

    # ------------------------------------------------------------ what may happen to a frame

    def late(self, message: can.Message) -> list[can.Message]:
        """It arrives before the next of its kind is sent."""
        wire = self.pair.wire
        due_s = self.pair.clock() + self.draw.uniform(
            0.0, DELAY_HEARTBEATS * self.pair.job.timing.heartbeat_s
        )
        wire.late.append((due_s, wire.nodes[SENDER[message.arbitration_id].peer], message))
        return []

    def corrupted(self, message: can.Message) -> list[can.Message]:
        """A bit is another one."""
        data = bytearray(message.data)
        data[self.draw.randrange(len(data))] ^= 1 << self.draw.randrange(8)
        return [with_data(message, bytes(data))]

    # ------------------------------------------------------------ what else

    def pause(self, which: str) -> None:
        """One of the loops stands still."""
        setattr(self.pair, which, False)
        self.until_s = self.pair.clock() + self.draw.uniform(
            0.0, PAUSE_TIMEOUTS * self.pair.job.timing.timeout_s
        )

    def disk(self) -> None:
        """It takes its time from now on."""
        self.pair.disk.delay_s = self.draw.uniform(*DISK_S)

    def command(self) -> None:
        """The operator says what applies to nothing."""
        if self.pair.phase is Phase.CUTTING:
            self.pair.terminal.type(self.draw.choice(WITHOUT_EFFECT))

    def hold(self) -> None:
        """The enabling device is held already."""
        if self.pair.phase is Phase.CUTTING:
            self.pair.controller_terminal.type(ConsoleCommand.HOLD)

    FRAME = {  # noqa: RUF012 - a table of the methods above
        "frame late": late,
        "frame lost": lambda _self, _message: [],
        "frame corrupted": corrupted,
        "frame twice": lambda _self, message: [message, message],
    }
    ACTS = {  # noqa: RUF012 - likewise
        "runtime pauses": lambda self: self.pause("runtime_runs"),
        "controller pauses": lambda self: self.pause("controller_runs"),
        "disk slow": disk,
        "command without effect": command,
        "device held again": hold,
    }


def with_timing(job: Job, heartbeat_ms: int, timeout_ms: int) -> Job:
    """The job with another heartbeat and time-out."""
    return replace(job, timing=replace(job.timing, heartbeat_ms=heartbeat_ms, timeout_ms=timeout_ms))


def soak(folder: Path, files: InputFiles, job: Job, seconds: float, seed: int = 1) -> SoakTally:
    """Cut after cut until so much virtual time has passed."""
    tally, draw, begun_s = SoakTally(), Random(seed), time.process_time()
    while tally.virtual_s < seconds:
        place = folder / f"{tally.sessions}"
        place.mkdir()
        with pair_of(place, files, job) as pair:
            pair.cycle_s = job.timing.heartbeat_s / CYCLES
            pair.power_up(time_scale=TIME_SCALE)
            disturbed = Disturbed(pair, draw, tally)
            for _ in range(SESSIONS_EACH):
                if tally.virtual_s < seconds:
                    _session(pair, disturbed, tally)
        _remove(place)
    tally.real_s = time.process_time() - begun_s
    return tally


def _session(pair: Pair, disturbed: Disturbed, tally: SoakTally) -> None:
    begun_s = pair.clock()
    pair.begin()
    tally.sessions += 1
    while pair.phase not in ENDED and pair.clock() - begun_s < PATIENCE_S:
        disturbed.turn()
        pair._lead()
        pair.run_cycle()
    if pair.phase is Phase.DONE:
        tally.cuts += 1
    else:
        tally.false_stops.append(f"session {tally.sessions}: {pair.phase}, {pair.state.reason}")
    pair.runtime_runs = pair.controller_runs = True
    pair.disk.delay_s = 0.0
    pair.run(0.3)  # what the disk has been asked for, and the controller's own end
    _judge(pair, tally)
    pair.wire.seen.clear()
    tally.virtual_s += pair.clock() - begun_s


def _judge(pair: Pair, tally: SoakTally) -> None:
    """Whole, decided the same again, and every step a transition of the tables."""
    if not pair.close().closed:
        tally.logs.append(f"session {tally.sessions}: {pair.paths.reason}")
        return
    log = pair.read()
    found = replay(log, certified.verify, verifier=VERIFIER)
    if log.report.status is not Status.OK or found.outcome is not ReplayOutcome.IDENTICAL:
        tally.logs.append(f"session {tally.sessions}: {log.report.reasons} {found.differences}")


def _remove(place: Path) -> None:
    for path in sorted(place.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    place.rmdir()
