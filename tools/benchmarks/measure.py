"""Clocks and memory: medians of works taken in turn, peaks of child processes, and the machine's name."""

import multiprocessing
import os
import platform
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

RUNS = 7


def seconds(*works: Callable[[], object]) -> list[float]:
    """Median seconds of each, the works taken in turn so that a drifting machine hits all alike."""
    times: list[list[float]] = [[] for _ in works]
    for run in range(RUNS + 1):
        for work, kept in zip(works, times, strict=True):
            began = time.perf_counter()
            work()
            if run:  # the first warms up
                kept.append(time.perf_counter() - began)
    return [median(kept) for kept in times]


def in_a_child(work: Callable[..., Any], *arguments: object) -> tuple[Any, float]:
    """What a function returns in a fresh process, and the peak memory of that process, MiB."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe(duplex=False)
    child = context.Process(target=_answer, args=(there, work, arguments))
    child.start()
    there.close()
    answer: tuple[Any, float] = here.recv()
    child.join()
    return answer


def _answer(out: Connection, work: Callable[..., Any], arguments: tuple[object, ...]) -> None:
    found = work(*arguments)
    out.send((found, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024))


def a_command(*words: str) -> float:
    """Processor seconds of a command of ``cutgate``, user and system, the least of a few runs."""
    took = []
    for _ in range(RUNS):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [sys.executable, "-m", "cutgate.runtime.cli", *words]
        subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        took.append(after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)
    return min(took)


def machine() -> str:
    """CPU model, cores, Python and numpy."""
    model = platform.processor() or platform.machine()
    about = Path("/proc/cpuinfo")
    if about.exists():
        names = [
            line.split(":", 1)[1].strip() for line in about.read_text().splitlines() if "model name" in line
        ]
        model = names[0] if names else model
    return (
        f"{model}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}, "
        f"Python {platform.python_version()}, numpy {np.__version__}"
    )
