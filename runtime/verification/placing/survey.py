"""A whole map of bone positions: first squares of which something is proved as a whole, then each position of the grid.

By as many processes as there are cores; the result does not depend on how many.
"""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np

from cutgate.protocol import records
from cutgate.protocol.arrays import Bools, Floats, Ints
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.placing import reach
from cutgate.runtime.verification.placing.cells import (
    PART,
    SQUARE,
    WORK,
    Lattice,
    PathAtYaw,
    Quadtree,
    Squares,
    State,
    everywhere,
)
from cutgate.runtime.verification.placing.reach import Cell, Grid, Position, Surveyed
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.verdict import Boundary, Verdict

CHUNK: Final = 64
"""Squares judged in one go, ..."""

CHUNK_POSITIONS: Final = 512
"""... and positions: a fraction of a second, what the progress bar moves by."""

KEPT_POSES: Final = 100_000
"""Of paths at other yaws: some hundred bytes each."""

ALONE: Final = 4
"""Fewer chunks than this are not worth another process, which takes half a second to start."""


@dataclass(slots=True)
class Work:
    """What every worker knows: the path where the bone stands, and how it is quantised."""

    problem: Problem
    feed_mm_s: float
    tool_length_mm: float
    _planes: dict[float, PathAtYaw] = field(default_factory=dict, repr=False)
    _verdict: Verdict | None = field(default=None, repr=False)

    def quantise(self, tips_mm: Floats, axes: Floats) -> tuple[Floats, Floats]:
        """What the wire does to poses."""
        path = records.Path.quantised(
            tips_mm,
            axes,
            feed_mm_s=self.feed_mm_s,
            tool_length_mm=self.tool_length_mm,
            elbow=self.problem.arm.elbow,
        )
        return path.tips_mm, path.axes

    def plane(self, yaw_deg: float) -> PathAtYaw:
        """The path at a yaw; a few of them are kept."""
        if yaw_deg not in self._planes:
            if sum(len(plane) for plane in self._planes.values()) > KEPT_POSES:
                self._planes.clear()
            self._planes[yaw_deg] = PathAtYaw(self.problem, yaw_deg)
        return self._planes[yaw_deg]

    @property
    def verdict(self) -> Verdict:
        """Of the path where the bone stands."""
        if self._verdict is None:
            self._verdict = certified.verify(self.problem)
        return self._verdict

    def states(self, yaw_deg: float, lift_mm: float, side_mm: float, middles_mm: Floats) -> Ints:
        """What is proved of squares."""
        return self.plane(yaw_deg).states(middles_mm, side_mm, lift_mm)

    def judge(
        self, yaw_deg: float, lift_mm: float, places_mm: Floats, proved: Bools, cells: list[Cell]
    ) -> list[Position]:
        """Positions, some of them proved admissible already."""
        judge = reach.PositionJudge(self.problem, self.plane(yaw_deg), self.verdict, self.quantise)
        return judge.positions(yaw_deg, lift_mm, places_mm, proved, cells)

    def bare(self) -> Work:
        """Without what is found anew: what is sent to a worker."""
        return Work(self.problem, self.feed_mm_s, self.tool_length_mm)


def squares(work: Work, workers: Workers, grid: Grid, done: Callable[[int], None]) -> list[Squares]:
    """What is proved between the positions, for each yaw and lift.

    Args:
        work: the path.
        workers: who does it.
        grid: what is to be covered.
        done: told how many positions lie in squares of which something is proved, since the last call.
    """
    lattice = Lattice.over(grid.x_mm, grid.y_mm, grid.step_mm)
    if reach.unrecoverable(work.problem, work.verdict) is not None:
        return [everywhere(yaw, lift, lattice, State.INADMISSIBLE) for yaw, lift in grid.layers]
    growing = [Quadtree(yaw, lift, lattice) for yaw, lift in grid.layers]
    each = SQUARE + len(work.plane(grid.yaw_deg[0]))
    left = max(WORK, each * len(grid) // PART)
    while open_ := [one for one in growing if len(one.open)]:
        if each * sum(len(one.open) for one in open_) > left:  # a level is judged as a whole or not at all
            for one in open_:
                one.end()
            break
        tasks = [
            (n, part, (one.yaw_deg, one.lift_mm, lattice.side_mm(one.level), middles))
            for n, one in enumerate(open_)
            for part, middles in _parts(lattice.middles_mm(one.open, one.level), CHUNK)
        ]
        states = [np.zeros(len(one.open), dtype=np.int64) for one in open_]
        for k, found in workers.each("states", [arguments for *_, arguments in tasks]):
            n, part, _ = tasks[k]
            states[n][part] = found
            per_square = (lattice.side_mm(open_[n].level) / grid.step_mm) ** 2
            done(int((found != State.UNKNOWN).sum() * per_square))
        for one, found in zip(open_, states, strict=True):
            left -= each * int((found != State.INADMISSIBLE).sum())  # to exclude one takes a few poses
            one.judged(found)
    return [one.done() for one in growing]


def positions(
    work: Work, workers: Workers, grid: Grid, squares_: list[Squares], done: Callable[[int], None]
) -> Surveyed:
    """What decides at every position of the grid, and in the middle of each square smaller than the step.

    Args:
        work: the path.
        workers: who does it.
        grid: the positions.
        squares_: what is proved between them.
        done: told how many positions are judged since the last call.
    """
    b = reach.unrecoverable(work.problem, work.verdict)
    if b is not None:
        found = [_unrecoverable(b, *where) for where in _everywhere(grid)]
        done(len(found))
        return Surveyed(found, squares_, [[] for _ in squares_])
    xy = np.array([(x, y) for y in grid.y_mm for x in grid.x_mm])
    judged: list[list[Position]] = []
    middles: list[list[Position]] = []
    tasks: list[tuple[list[Position], int, tuple[float, float, Floats, Bools, list[Cell]]]] = []
    for one in squares_:
        cells, itself = one.of_positions()
        fine = one.smaller
        names: list[Cell] = [reach.CELLS[state] for state in one.states[fine].tolist()]
        for lists, places, proved, cells_of in (
            (judged, xy, itself.ravel(), [reach.CELLS[state] for state in cells.ravel().tolist()]),
            (middles, one.middles_mm[fine], one.states[fine] == State.ADMISSIBLE, names),
        ):
            lists.append([])
            for part, some in _parts(places, CHUNK_POSITIONS):
                count = len(some) if lists is judged else 0
                tasks.append(
                    (lists[-1], count, (one.yaw_deg, one.lift_mm, some, proved[part], cells_of[part]))
                )
    found_of: list[list[Position]] = [[] for _ in tasks]
    for k, found in workers.each("judge", [arguments for *_, arguments in tasks]):
        found_of[k] = found
        done(tasks[k][1])
    for (into, *_), found in zip(tasks, found_of, strict=True):
        into.extend(found)
    return Surveyed([p for layer in judged for p in layer], squares_, middles)


def _parts(rows: Floats, size: int) -> Iterator[tuple[slice, Floats]]:
    return ((slice(i, min(i + size, len(rows))), rows[i : i + size]) for i in range(0, len(rows), size))


def _everywhere(grid: Grid) -> Iterator[tuple[float, float, float, float]]:
    for yaw, lift in grid.layers:
        yield from ((x, y, yaw, lift) for y in grid.y_mm for x in grid.x_mm)


def _unrecoverable(b: Boundary, x: float, y: float, yaw: float, lift: float) -> Position:
    ratio = None if b.certified is None else b.certified / b.deadband
    return Position(
        x, y, yaw, lift, False, "pose", b.name, b.unit, b.certified, b.deadband, ratio, "inadmissible"
    )


class Workers:
    """Those who work: processes, started when there is enough to do, or this one alone.

    Args:
        work: what they know.
        cores: how many.
    """

    def __init__(self, work: Work, cores: int) -> None:
        self._work, self._cores = work, cores
        self._pool: ProcessPoolExecutor | None = None

    def each(
        self, what: Literal["states", "judge"], tasks: Sequence[tuple[Any, ...]]
    ) -> Iterator[tuple[int, Any]]:
        """Each task's number and result, in the order in which they are ready.

        Args:
            what: method of `Work`.
            tasks: its arguments.
        """
        if self._cores == 1 or (len(tasks) < ALONE and self._pool is None):
            for number, arguments in enumerate(tasks):
                yield number, getattr(self._work, what)(*arguments)
            return
        if self._pool is None:
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self._cores, context, _begin, (self._work.bare(),))
        with _held_back(signal.SIGINT):  # the workers inherit it: Ctrl-C is this process's to handle
            waiting: dict[Future[Any], int] = {
                self._pool.submit(_do, what, arguments): number for number, arguments in enumerate(tasks)
            }
        for future in as_completed(waiting):
            yield waiting[future], future.result()

    def leave(self, *, at_once: bool) -> None:
        """Ends the processes; at once where what they still do is of no use."""
        if self._pool is None:
            return
        if at_once:
            for worker in multiprocessing.active_children():
                worker.terminate()
        self._pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def workers_for(work: Work, cores: int) -> Iterator[Workers]:
    """Those who work, for as long as they are needed."""
    workers = Workers(work, cores)
    try:
        yield workers
    except BaseException:  # Ctrl-C or a failure
        workers.leave(at_once=True)
        raise
    else:
        workers.leave(at_once=False)


_WORK: list[Work] = []


def _begin(work: Work) -> None:
    """In a worker: keeps the path."""
    _WORK.append(work)


@contextmanager
def _held_back(number: signal.Signals) -> Iterator[None]:
    """A signal that arrives meanwhile is delivered afterwards; processes started meanwhile never get it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {number})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _do(what: str, arguments: tuple[Any, ...]) -> Any:
    return getattr(_WORK[0], what)(*arguments)
