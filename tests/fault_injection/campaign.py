"""The campaign: many short scenarios, each one session under faults of its own, in virtual time; and what became of them.

A scenario is one seed. It draws how the controller stands at the beginning, what happens, how often, when it begins and how
long it lasts. The oracle looks after every cycle and judges the log, and every recorded step is held against the tables.
"""

import re
import time
from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from random import Random

from cutgate.firmware_sim.console import ConsoleCommand
from cutgate.firmware_sim.fault_language import ACTIONS
from cutgate.protocol.states import LATCHING, StopCause
from cutgate.runtime.interlock.state import Job, Phase
from cutgate.runtime.session.job import InputFiles
from tests.fault_injection.play import Play
from tests.runtime.session.pair import Pair, pair_of

WAITS = {
    "transfer_timeout_s": 1.5,
    "announce_wait_s": 1.0,
    "operator_wait_s": 1.5,
    "verify_timeout_s": 2.0,
    "reply_timeout_s": 0.8,
}
"""Deadlines of a scenario: it is to be short, whatever it waits for."""
TIME_SCALE = 12.0
"""Of the plant: a cut is over in a fraction of a second."""
BEGIN_S = 0.36
"""So long is a session that nothing befalls; the faults begin somewhere in it, s."""
LASTS_S = (0.02, 1.0)
"""Faults last so long, s."""
_NOTED = re.compile(r" *[\d.]+ s  (faults begin, )?(?:[0-9A-F]{3} [0-9a-f]* )?(.*)", re.DOTALL)
"""A line of what happened: the faults' beginning and in which phase, or one of them, of a frame behind the frame."""
UNSAFE = "the arm moved"
AFTER_S = 0.25
"""What had begun goes on for so long, longer than any time-out, after the runtime is gone, s."""
DISK = ("the disk is slow", "the disk answers no more")
"""These may keep a log from being closed in the time that is waited for."""
KILLED, SILENT, WHOLE, CUT_SHORT = (
    "of a killed runtime",
    "of a disk that did not answer in time",
    "whole",
    "cut short",
)
"""What a log is: cut by nature, for the runtime was killed or the disk did not answer; closed and whole; none of these."""


def _latched(pair: Pair, draw: Random) -> None:
    pair.latch(draw.choice(sorted(LATCHING)))


def _touched(pair: Pair, draw: Random) -> None:
    """Somebody has done something at the controller before."""
    for _ in range(draw.randint(1, 3)):
        pair.controller_terminal.type(draw.choice([*ConsoleCommand]))
    pair.run(0.1)


BEGINNINGS = (*(lambda _pair, _draw: None,) * 6, _latched, _touched)
"""How the controller stands when the session begins; most often as it was switched on."""


class Scenario(Play):
    """One session, in which the faults begin anywhere."""

    def _wait_s(self) -> float:
        return self.injection.draw.uniform(0.0, BEGIN_S)


@dataclass
class Tally:
    """What became of scenarios.

    Attributes:
        ends: how sessions ended: done, refused, stopped, killed.
        causes: the first cause of those that were stopped.
        logs: by `KILLED`, `SILENT`, `WHOLE`, `CUT_SHORT`.
        began: in which phase the faults began.
        faults: how often each thing happened.
        wrong: by seed, what the oracle found.
        moved: cycles in which the arm moved.
        steps: recorded steps that were held against the tables.
        virtual_s, real_s: how long they lasted on the virtual clock, and of the processor.
    """

    ends: Counter[str] = field(default_factory=Counter)
    causes: Counter[str] = field(default_factory=Counter)
    logs: Counter[str] = field(default_factory=Counter)
    began: Counter[str] = field(default_factory=Counter)
    faults: Counter[str] = field(default_factory=Counter)
    wrong: dict[int, str] = field(default_factory=dict)
    moved: int = 0
    steps: int = 0
    virtual_s: float = 0.0
    real_s: float = 0.0

    @property
    def unsafe(self) -> int:
        """Scenarios in which the arm moved and must not have."""
        return sum(UNSAFE in text for text in self.wrong.values())

    def __add__(self, other: "Tally") -> "Tally":
        """Both together."""
        return Tally(
            self.ends + other.ends,
            self.causes + other.causes,
            self.logs + other.logs,
            self.began + other.began,
            self.faults + other.faults,
            self.wrong | other.wrong,
            self.moved + other.moved,
            self.steps + other.steps,
            self.virtual_s + other.virtual_s,
            self.real_s + other.real_s,
        )

    def __str__(self) -> str:
        """For people."""
        return "\n".join(
            (
                f"{self.ends.total()} scenarios: {_told(self.ends)}",
                f"first causes of the stopped: {_told(self.causes)}",
                f"faults began in: {_told(self.began)}",
                f"faults that happened, {len(self.faults)} kinds: {_told(self.faults)}",
                f"logs: {_told(self.logs)}; {self.logs[CUT_SHORT]} incomplete that need not be",
                f"steps held against the tables: {self.steps}",
                f"the arm moved in {self.moved} cycles; unsafe motion in {self.unsafe} scenarios",
                f"wrong: {len(self.wrong)}{''.join(f'{chr(10)}  seed {seed}: {text}' for seed, text in self.wrong.items())}",
                f"{self.virtual_s:.0f} s of virtual time in {self.real_s:.0f} s of the processor",
            )
        )


def _told(counted: Counter[str]) -> str:
    return ", ".join(f"{number} {name}" for name, number in counted.most_common()) or "none"


def scenario(
    folder: Path, files: InputFiles, job: Job, seed: int, tally: Tally, only: Collection[str] = ()
) -> None:
    """One; what became of it is added to the tally.

    Raises:
        AssertionError: the oracle has found something, or the session does not end.
    """
    with pair_of(folder, files, job) as pair:
        pair.power_up(time_scale=TIME_SCALE)
        play = Scenario(pair, seed, only)
        play.job = replace(job, deadlines=replace(job.deadlines, **WAITS))
        draw = play.injection.draw
        draw.choice(BEGINNINGS)(pair, draw)
        begun_s = pair.clock()
        phase = play.session(injection_s=draw.uniform(*LASTS_S))
        cause = pair.state.cause
        pair.session = None
        for _ in range(round(AFTER_S / pair.cycle_s)):
            play.run_cycle()
        play.oracle.at_rest()
        tally.virtual_s += pair.clock() - begun_s
        _count(tally, play, phase, cause)
        assert not play.oracle.wrong, "\n".join([*play.injection.fell, *play.oracle.wrong])


def _count(tally: Tally, play: Play, phase: Phase | None, cause: StopCause) -> None:
    pair = play.pair
    tally.ends["killed" if phase is None else str(phase)] += 1
    if phase is Phase.STOPPED:
        tally.causes[cause.name] += 1
    if phase is None:
        log = KILLED
    elif pair.paths.closed:
        log = WHOLE
    else:
        slow = any(text.endswith(DISK) for text in play.injection.fell)
        log = SILENT if slow else CUT_SHORT
    if log == CUT_SHORT:
        play.oracle.wrong.append(f"the log is incomplete though the disk answers: {pair.paths.reason}")
    tally.logs[log] += 1
    for text in play.injection.fell:
        noted = _NOTED.fullmatch(text)
        if noted is None:  # which faults were drawn stands before what happened
            continue
        begins, name = noted[1], noted[2]
        action = name.partition(" ")[0]
        name = action if action in ACTIONS else name  # of a line of the fault language, what it does
        if begins:
            tally.began[name] += 1
        elif not name.startswith(("session ", "it clears")):
            tally.faults[name] += 1
    tally.moved += play.oracle.moved
    tally.steps += play.oracle.steps


def campaign(
    folder: Path, files: InputFiles, job: Job, seeds: Iterable[int], only: Collection[str] = ()
) -> Tally:
    """All of these seeds, one after the other; what is wrong stands in the tally. ``only`` these faults, or any."""
    tally, begun_s = Tally(), time.process_time()
    for seed in seeds:
        place = folder / f"{seed}"
        place.mkdir()
        try:
            scenario(place, files, job, seed, tally, only)
        except AssertionError as found:
            tally.wrong[seed] = str(found)
        _remove(place)
    tally.real_s = time.process_time() - begun_s
    return tally


def _remove(place: Path) -> None:
    for path in sorted(place.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    place.rmdir()
