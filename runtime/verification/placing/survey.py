"""Every position of a grid judged, by as many processes as there are cores."""

import multiprocessing
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

from cutgate.protocol import records
from cutgate.protocol.arrays import Floats, Vector
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.placing import reach
from cutgate.runtime.verification.placing.guidance import Quantise
from cutgate.runtime.verification.placing.reach import Grid, Position
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.verdict import Boundary

CHUNK: Final = 32
"""Positions judged in one go, a fraction of a second: what the progress bar moves by."""


@dataclass(frozen=True, slots=True)
class Work:
    """What every worker knows: the path where the bone stands, and how it is quantised."""

    problem: Problem
    feed_mm_s: float
    tool_length_mm: float

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

    def judge(self, yaw_deg: float, translations_mm: list[Vector]) -> list[Position]:
        """Positions by the certified method."""
        quantise: Quantise = self.quantise
        return [reach.judged(self.problem, quantise, yaw_deg, t) for t in translations_mm]


def survey(work: Work, grid: Grid, cores: int, done: Callable[[int], None]) -> list[Position]:
    """Judges every position of a grid, in the order yaw, lift, y, x.

    Args:
        work: the path.
        grid: the positions.
        cores: how many processes; with one, this one.
        done: told how many positions are judged since the last call.
    """
    unrecoverable = reach.unrecoverable(work.problem, certified.verify(work.problem))
    if unrecoverable is not None:
        return [_unrecoverable(unrecoverable, *where) for where in _everywhere(grid)]
    found: list[Position | Vector] = []
    chunks: list[tuple[list[int], float, list[Vector]]] = []
    for yaw in grid.yaw_deg:
        for lift in grid.lift_mm:
            layer = reach.excluded(work.problem, grid, yaw, lift)
            open_ = [i for i, item in enumerate(layer) if isinstance(item, tuple)]
            for k in range(0, len(open_), CHUNK):
                part = open_[k : k + CHUNK]
                places = [item for i in part if isinstance(item := layer[i], tuple)]
                chunks.append(([len(found) + i for i in part], yaw, places))
            found += layer
            done(len(layer) - len(open_))
    for numbers, positions in _judged(work, chunks, cores):
        for i, position in zip(numbers, positions, strict=True):
            found[i] = position
        done(len(numbers))
    return [item for item in found if isinstance(item, Position)]


def _everywhere(grid: Grid) -> Iterator[tuple[float, float, float, float]]:
    for yaw in grid.yaw_deg:
        for lift in grid.lift_mm:
            yield from ((x, y, yaw, lift) for y in grid.y_mm for x in grid.x_mm)


def _unrecoverable(b: Boundary, x: float, y: float, yaw: float, lift: float) -> Position:
    ratio = None if b.certified is None else b.certified / b.deadband
    return Position(x, y, yaw, lift, False, "pose", b.name, b.unit, b.certified, b.deadband, ratio)


def _judged(
    work: Work, chunks: list[tuple[list[int], float, list[Vector]]], cores: int
) -> Iterator[tuple[list[int], list[Position]]]:
    """Each chunk's numbers and positions, in the order in which they are ready."""
    if cores == 1 or len(chunks) < 2:
        for numbers, yaw, places in chunks:
            yield numbers, work.judge(yaw, places)
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(cores, len(chunks)), context, _begin, (work,))
    try:
        with _held_back(signal.SIGINT):  # the workers inherit it: Ctrl-C is this process's to handle
            waiting: dict[Future[list[Position]], list[int]] = {
                pool.submit(_judge, yaw, places): numbers for numbers, yaw, places in chunks
            }
        for future in as_completed(waiting):
            yield waiting[future], future.result()
    except BaseException:  # Ctrl-C or a failure: what the workers still do is of no use
        for worker in multiprocessing.active_children():
            worker.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


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


def _judge(yaw_deg: float, translations_mm: list[Vector]) -> list[Position]:
    return _WORK[0].judge(yaw_deg, translations_mm)
